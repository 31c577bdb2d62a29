--- Charts as graphs from which Graphviz draws pictures.
--
-- There are two layouts: `rfsm.pictures.sheet` lays out composite by composite, and in
-- the plain layout Graphviz lays out the graph of `rfsm.dot.encode`. The better one is
-- drawn. In the plain one an arrow with a label has three elements, as in that graph.
--
-- @module rfsm.pictures.layout
-- @license BSD-3-Clause

local choice = require "rfsm.pictures.choice"
local diagram = require "rfsm.pictures.diagram"
local graphs = require "rfsm.pictures.graphs"
local lines = require "rfsm.pictures.lines"
local links = require "rfsm.pictures.links"
local looks = require "rfsm.pictures.looks"
local rfsm = require "rfsm"
local sheet = require "rfsm.pictures.sheet"

local ipairs, select = ipairs, select
local concat, add = table.concat, diagram.add
local number_of = rfsm.number_of

local layout = {}

--- A layout: the position of everything, in points from the lower left corner.
---@class rfsm.pictures.Layout
---@field kind "levels"|"plain"|"sheet"
---@field left number
---@field bottom number
---@field width number
---@field height number
---@field lines { points: number[][], tip: number[], label?: number[] }[]
---@field places? table<rfsm.pictures.Node, rfsm.pictures.Place> absent if it is plain

--- The place of a node. Only a composite has a frame.
---@class rfsm.pictures.Place
---@field x number the middle of the node, or of the header of a composite
---@field y number
---@field left? number left edge of the frame; absent if the node is no composite
---@field bottom? number
---@field width? number
---@field height? number

-- Levels: positions in a level become positions in the picture -----------------

-- Places a composite, whose lower left corner is given, and all nodes in it.
local function move(places, composite, left, bottom)
  local level = composite.level
  local header = level.header or { x = 0, y = 0 }
  level.left, level.bottom = left + level.x, bottom + level.y
  places[composite] = { left = left, bottom = bottom, width = level.width,
    height = level.height, x = level.left + header.x, y = level.bottom + header.y }
  for i, node in ipairs(composite.nodes) do
    local box, inner = level.boxes[i], node.level
    local x, y = level.left + box.x, level.bottom + box.y
    if inner then
      move(places, node, x - inner.width / 2, y - inner.height / 2)
    else
      places[node] = { x = x, y = y }
    end
  end
end

-- Joins the links of an arrow, its parts in single levels, to one line.
local function line_of(arrow, direction)
  local line, tip, label, axis = {}, nil, nil, direction == "TB" and 1 or 2
  for _, part in ipairs(arrow.links) do
    local level = part.composite.level -- a shape
    local link = level.links[part.id]
    local function place(point)
      return { level.left + point[1], level.bottom + point[2] }
    end
    lines.join(line, lines.moved(link.points, level.left, level.bottom, link.is_turned),
      axis)
    tip = link.has_head and place(link.tip) or tip
    if link.label_at then
      lines.attract(link.label_at, diagram.label_of(arrow), link.points,
        level.direction == "TB" and 1 or 2)
      label = place(link.label_at)
    end
  end
  return { points = line, tip = tip, label = label }
end

-- Returns the layout of a chart whose levels are laid out.
local function layout_of(chart, kind)
  local places, arrows, outer = {}, {}, chart.outer.composite
  move(places, outer, 0, 0)
  for i, arrow in ipairs(chart.all) do arrows[i] = line_of(arrow, chart.direction) end
  return { kind = kind, left = 0, bottom = 0, width = outer.level.width,
    height = outer.level.height, places = places, lines = arrows }
end

-- Returns the plain layout in an answer of Graphviz; nil if an edge is missing in it.
local function plain_layout(chart, answer)
  local list, count = {}, 0
  local width, height = answer:match('bb="0,0,([%d.e+]+),([%d.e+]+)"')
  for position in answer:gmatch('\n%s*pos="([^" ]+ [^"]+)"') do
    list[#list + 1] = graphs.line_of(position)
  end
  for _, arrow in ipairs(chart.all) do count = count + (arrow.label and 2 or 1) end
  return #list == count and { kind = "plain", width = number_of(width),
    height = number_of(height), lines = list,
    crossings = choice.count_crossings(list) } or nil
end

-- The graph -------------------------------------------------------------------

local function point_text(x, y)
  return looks.number_text(x) .. "," .. looks.number_text(y)
end

local function box_text(box)
  return ('bb="%s,%s"'):format(point_text(box.left, box.bottom),
    point_text(box.left + box.width, box.bottom + box.height))
end

local PAD = 4 -- points of Graphviz around a picture

-- Makes a picture as large as its box: Graphviz makes room for control points of lines,
-- too, even if the lines themselves are in the box.
local function view_text(box)
  return (', notranslate=true, viewport="%s,1,%s"'):format(
    point_text(box.width + 2 * PAD, box.height + 2 * PAD),
    point_text(box.left + box.width / 2, box.bottom + box.height / 2))
end

local function position_text(place)
  local point = point_text(place.x, place.y)
  if not place.left then return (', pos="%s"'):format(point) end
  return (', %s, lp="%s"'):format(box_text(place), point)
end

-- Returns the identifier of the node at which an arrow ends. In Graphviz no edge ends
-- at a cluster, so the arrow of a composite ends at the first leaf in it.
local function anchor_of(node)
  while node.nodes[1] do node = node.nodes[1] end
  return node.id
end

local function end_text(name, node)
  return node.nodes[1] and (", %s=cluster_%s"):format(name, node.id) or ""
end

local function add_arrow(texts, arrow, line)
  local points, tip, label = {}, line.tip, line.label
  for i, point in ipairs(line.points) do
    points[i] = point_text(point[1], point[2])
  end
  add(texts, 1, ('%s -> %s [%s, %s%s%s, pos="e,%s %s"%s]'):format(
    anchor_of(arrow.src), anchor_of(arrow.tgt), looks.id_of(arrow.key),
    looks.arrow_text(arrow), end_text("ltail", arrow.src), end_text("lhead", arrow.tgt),
    point_text(tip[1], tip[2]), concat(points, " "),
    arrow.parts[1] and (', lp="%s", label=%s'):format(point_text(label[1], label[2]),
      looks.arrow_label(arrow)) or ""))
end

local FOOT = 10 -- points from the picture down to the text below it

local function foot_text(chart, positions)
  return ('foot [shape=plain, style="", fontsize=10, label=%s, pos="%s"]'):format(
    looks.quoted(diagram.clean(chart.foot)), point_text(positions.left
    + positions.width / 2, positions.bottom - FOOT))
end

local function graph_of(chart, positions)
  local root, places = chart.root, positions.places
  local texts = { "digraph " .. looks.quoted(root.name) .. " {",
    looks.head(chart.direction), ('  graph [layout=nop2, outputorder=nodesfirst, '
    .. 'class=%s, %s%s]'):format(positions.kind, box_text(positions),
    chart.foot and "" or view_text(positions)) }
  looks.add_node(texts, 1, root, function(node) return position_text(places[node]) end)
  for i, arrow in ipairs(chart.all) do
    add_arrow(texts, arrow, positions.lines[i])
  end
  if chart.foot then add(texts, 1, foot_text(chart, positions)) end
  add(texts, 0, "}")
  return concat(texts, "\n") .. "\n"
end

-- Returns the graph of `rfsm.dot.encode` for a picture in the plain layout.
local function plain_graph(chart, graph)
  return ("%s  graph [outputorder=nodesfirst, class=plain, label=%s]\n}\n"):format(
    graph:sub(1, -3), looks.quoted(diagram.clean(chart.foot or "")))
end

-- Layouts ---------------------------------------------------------------------

local MOST = 1000 -- nodes; Graphviz needs about a second to lay out so many

-- Returns the leaves of a chart, and a graph with all of them.
local function leaves_of(chart)
  local leaves, texts = {}, {}
  for _, node in ipairs(chart.nodes) do
    if not node.level then
      leaves[#leaves + 1], texts[#texts + 1] = node, looks.leaf_text(node)
    end
  end
  return leaves, graphs.nodes_text(texts)
end

-- Returns a function that has Graphviz lay out graphs. In its first run it measures
-- leaves, too, and sets `chart.whole` to the plain layout if that does not fail.
--
-- Graphviz visits clusters in the order of the addresses of their names. These ascend
-- in each run only if a new process reads the graph of the chart first.
local function runner(chart, graph, ask)
  local is_begun = false
  graph = #chart.nodes <= MOST and graph:gsub("^[^\n]*", "digraph {", 1) or ""
  return function(text)
    if is_begun then return ask(text) end
    local leaves, sizes = leaves_of(chart)
    local answer, problem = ask(graph .. sizes .. text)
    if not answer and graph ~= "" then
      graph = ""
      answer, problem = ask(sizes .. text)
    end
    if not answer then return nil, problem end
    local stop = graph ~= "" and select(2, answer:find("\n}\n", 1, true)) or 0
    local boxes, behind = graphs.read_nodes(answer, stop + 1)
    for i, node in ipairs(leaves) do node.size = boxes[i] end
    chart.whole = stop > 0 and plain_layout(chart, answer:sub(1, stop)) or nil
    is_begun = true
    return answer:sub(behind)
  end
end

--- Return the graph of a chart, then nil and the size of its text on the sheet, in
-- points. Return nil and the problem if that fails. The graph has positions, or it is
-- `graph`, the result of `rfsm.dot.encode`. `run(text)` has Graphviz lay out a graph.
function layout.draw(chart, graph, run)
  links.prepare(chart)
  local problem = sheet.lay_out(chart, runner(chart, graph, function(text)
    local answer, why = run(text)
    return answer and answer:gsub("\\\r?\n", "") or nil, why
  end))
  if problem then return nil, problem end
  local best = sheet.best(chart)
  if best ~= chart.whole then
    sheet.put(best)
    best = layout_of(chart, best == chart.outer.kept.first and "levels" or "sheet")
  end
  local text = best.places and graph_of(chart, best) or plain_graph(chart, graph)
  return text, nil, 10 * choice.scale(chart.sheet, best.width, best.height)
end

return layout
