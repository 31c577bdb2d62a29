--- Charts as graphs in which everything has its position, so that Graphviz only draws.
--
-- There are two layouts. `rfsm.pictures.sheet` lays out composite by composite, and
-- `rfsm.pictures.plain` reads Graphviz' layout of the chart. The better one is drawn.
--
-- @module rfsm.pictures.layout
-- @license BSD-3-Clause

local choice = require "rfsm.pictures.choice"
local diagram = require "rfsm.pictures.diagram"
local graphs = require "rfsm.pictures.graphs"
local lines = require "rfsm.pictures.lines"
local links = require "rfsm.pictures.links"
local looks = require "rfsm.pictures.looks"
local plain = require "rfsm.pictures.plain"
local sheet = require "rfsm.pictures.sheet"

local ipairs = ipairs
local concat, add = table.concat, diagram.add

local layout = {}

--- A layout: the position of everything, in points from the lower left corner.
---@class rfsm.pictures.Layout
---@field kind "levels"|"plain"|"sheet"
---@field left number
---@field bottom number
---@field width number
---@field height number
---@field places table<rfsm.pictures.Node, rfsm.pictures.Place>
---@field lines { points: number[][], tip: number[], label?: number[] }[] one per arrow
---@field leasts table<rfsm.pictures.Node, string> the fields `least` of nodes

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
  for _, link in ipairs(arrow.links) do
    local level, arch = link.level, link.arch
    local function place(point)
      return { level.left + point[1], level.bottom + point[2] }
    end
    local points = lines.moved(link.points, level.left, level.bottom, link.is_turned)
    if arch and link == arch.legs[2] then
      local box = level.arches[arch.id]
      label = place { box.x, box.y }
      lines.join(line, lines.around(line[#line], points[1], level.direction == "TB"
        and label[2] + box.height / 2 or label[1] - box.width / 2, level.direction),
        axis)
    end
    lines.join(line, points, axis)
    tip = link.has_head and place(link.tip) or tip
    label = link.label_at and place(link.label_at) or label
  end
  return { points = line, tip = tip, label = label }
end

-- Returns the layout of a chart whose levels are laid out.
local function layout_of(chart, kind)
  local places, arrows, leasts, top = {}, {}, {}, chart.top.level
  move(places, chart.top, 0, 0)
  for i, arrow in ipairs(chart.all) do arrows[i] = line_of(arrow, chart.direction) end
  for _, node in ipairs(chart.nodes) do leasts[node] = node.least end
  return { kind = kind, left = 0, bottom = 0, width = top.width,
    height = top.height, places = places, lines = arrows, leasts = leasts }
end

-- The graph -------------------------------------------------------------------

local function point_text(x, y)
  return looks.number_text(x) .. "," .. looks.number_text(y)
end

local function box_text(box)
  return ('bb="%s,%s"'):format(point_text(box.left, box.bottom),
    point_text(box.left + box.width, box.bottom + box.height))
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

local function add_arrow(texts, arrow, line, frame)
  local points, tip, label = {}, line.tip, line.label
  for i, point in ipairs(lines.inside(line.points, frame)) do
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

local function graph_of(chart, positions)
  local root, places = chart.root, positions.places
  for _, node in ipairs(chart.nodes) do node.least = positions.leasts[node] end
  local frame = places[root].left and places[root] or positions
  local texts = { "digraph " .. looks.quoted(root.name) .. " {",
    looks.head(chart.direction), ('  graph [layout=nop2, outputorder=nodesfirst, '
    .. 'class=%s, %s]'):format(positions.kind, box_text(positions)) }
  looks.add_node(texts, 1, root, function(node) return position_text(places[node]) end)
  for i, arrow in ipairs(chart.all) do
    add_arrow(texts, arrow, positions.lines[i], frame)
  end
  if chart.foot then
    add(texts, 1, ('foot [shape=plain, style="", fontsize=10, label=%s, pos="%s"]')
      :format(looks.quoted(diagram.clean(chart.foot)), point_text(positions.left
      + positions.width / 2, positions.bottom - FOOT)))
  end
  add(texts, 0, "}")
  return concat(texts, "\n") .. "\n"
end

-- Layouts ---------------------------------------------------------------------

local MOST = 1000 -- nodes; Graphviz needs about a second to lay out so many

-- Has Graphviz measure leaves and the labels of loops and, in the same run, lay out the
-- chart. Returns a problem if there is one, then this layout; nil if there is none.
local function measure(chart, graph, run)
  local elements, labels = {}, {}
  local function add_label(element, label)
    elements[#elements + 1], labels[#labels + 1] = element, label
  end
  for _, node in ipairs(chart.nodes) do
    if not node.level then add_label(node, looks.leaf_text(node)) end
  end
  for _, arrow in ipairs(chart.all) do
    if arrow.links[1].is_loop then
      add_label(arrow, 'shape=plain, style="", fontsize=10, label='
        .. looks.arrow_label(arrow))
    end
  end
  graph = #chart.nodes <= MOST and graph:gsub("^[^\n]*", "digraph {", 1) or ""
  local boxes, rest = graphs.sizes_of(labels, graph, run)
  for i, box in ipairs(boxes or {}) do elements[i].size = box end
  if not boxes then return rest end
  return nil, rest and plain.read(chart, rest)
end

--- Return the graph of a chart, with positions, then nil and the size of its text on
-- the sheet, in points. Return nil and the problem if that fails.
-- `graph` is the result of `rfsm.dot.encode`, which the plain layout needs. `run(text)`
-- has Graphviz lay out a graph.
function layout.draw(chart, graph, run)
  local function ask(text)
    local answer, problem = run(text)
    return answer and answer:gsub("\\\r?\n", "") or nil, problem
  end
  local size, was_sheet = chart.sheet, chart.kind == "sheet"
  links.prepare(chart)
  local problem, whole = measure(chart, graph, ask)
  local is_large = was_sheet or not (whole and choice.is_readable(whole, size))
  problem = problem or sheet.lay_out(chart, is_large, ask)
  if problem then return nil, problem end
  sheet.put(chart)
  local best = layout_of(chart, "levels")
  best = whole and choice.of(best, whole, chart.kind, size) or best
  if is_large and (was_sheet or not choice.is_readable(best, size)) then
    local shape = sheet.best(chart, best)
    if shape then
      sheet.put(chart, shape)
      best = layout_of(chart, "sheet")
    end
  end
  return graph_of(chart, best), nil, 10 * choice.scale(size, best.width, best.height)
end

return layout
