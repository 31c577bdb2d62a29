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

-- The graph -------------------------------------------------------------------

local function point_text(x, y)
  return looks.number_text(x) .. "," .. looks.number_text(y)
end

local function box_text(left, bottom, width, height)
  return ('bb="%s,%s"'):format(point_text(left, bottom),
    point_text(left + width, bottom + height))
end

-- Gives a composite, whose lower left corner is given, and all nodes in it their
-- positions in the picture.
local function place(composite, left, bottom)
  local level = composite.level
  local header = level.header or { x = 0, y = 0 }
  level.left, level.bottom = left + level.x, bottom + level.y
  composite.position = (', %s, lp="%s"'):format(
    box_text(left, bottom, level.width, level.height),
    point_text(level.left + header.x, level.bottom + header.y))
  for i, node in ipairs(composite.nodes) do
    local box, inner = level.boxes[i], node.level
    local x, y = level.left + box.x, level.bottom + box.y
    node.position = (', pos="%s"'):format(point_text(x, y))
    if inner then place(node, x - inner.width / 2, y - inner.height / 2) end
  end
end

-- Returns where an arrow begins that leads into its source: at the inner side of the
-- frame, beside its gate.
local function inner_start(level, gate)
  local at, left, bottom = level.gates[gate.index].at, level.left, level.bottom
  if level.direction == "TB" then
    return { left + at[1], bottom + level.height - level.y }
  end
  return { left - level.x, bottom + at[2] }
end

-- Joins the links of an arrow, its parts in single levels, to one line. Returns its
-- points as a text, its tip, and the position of its label.
local function line_of(arrow, direction)
  local line, tip, label, texts = {}, nil, nil, {}
  for _, part in ipairs(arrow.links) do
    local level = part.composite.level -- a shape
    local link, axis = level.links[part.id], lines.axis_of(level)
    local function text_of(point)
      return point_text(level.left + point[1], level.bottom + point[2])
    end
    line[1] = link.is_inner and inner_start(level, link.upper.gate) or line[1]
    lines.join(line, lines.moved(link.points, level.left, level.bottom, link.is_turned),
      direction == "TB" and 1 or 2)
    tip = link.has_head and text_of(link.tip) or tip
    if link.label_at then
      lines.attract(link.label_at, arrow.size, link.points, axis)
      label = text_of(link.label_at)
    end
  end
  for i, point in ipairs(line) do texts[i] = point_text(point[1], point[2]) end
  return concat(texts, " "), tip, label
end

local function add_arrow(texts, arrow, direction)
  local line, tip, label = line_of(arrow, direction)
  add(texts, 1, looks.edge_text(arrow, arrow.src, arrow.tgt, arrow.key,
    (', pos="e,%s %s"%s'):format(tip, line, arrow.parts[1]
    and (', lp="%s", label=%s'):format(label, looks.arrow_label(arrow)) or "")))
end

local PAD = 4 -- points of Graphviz around a picture

-- Makes a picture as large as its box: Graphviz makes room for control points of lines,
-- too, even if the lines themselves are in the box.
local function view_text(box)
  return (', notranslate=true, viewport="%s,1,%s"'):format(
    point_text(box.width + 2 * PAD, box.height + 2 * PAD),
    point_text(box.width / 2, box.height / 2))
end

local FOOT = 10 -- points from the picture down to the text below it

local function foot_text(chart, width)
  return ('foot [shape=plain, style="", fontsize=10, label=%s, pos="%s"]'):format(
    looks.quoted(diagram.clean(chart.foot)), point_text(width / 2, -FOOT))
end

-- Returns the graph of a chart whose levels are laid out.
local function graph_of(chart, outer, kind)
  place(outer.composite, 0, 0)
  local texts = { "digraph " .. looks.quoted(chart.root.name) .. " {",
    looks.head(chart.direction), ('  graph [layout=nop2, outputorder=nodesfirst, '
    .. 'class=%s, %s%s]'):format(kind, box_text(0, 0, outer.width, outer.height),
    chart.foot and "" or view_text(outer)) }
  looks.add_node(texts, 1, chart.root)
  for _, arrow in ipairs(chart.all) do add_arrow(texts, arrow, chart.direction) end
  if chart.foot then add(texts, 1, foot_text(chart, outer.width)) end
  add(texts, 0, "}")
  return concat(texts, "\n") .. "\n"
end

-- Returns the graph of `rfsm.dot.encode` for a picture in the plain layout.
local function plain_graph(chart, graph)
  return ("%s  graph [outputorder=nodesfirst, class=plain, label=%s]\n}\n"):format(
    graph:sub(1, -3), looks.quoted(diagram.clean(chart.foot or "")))
end

-- Layouts ---------------------------------------------------------------------

-- Returns the plain layout in an answer of Graphviz; nil if an edge is missing in it.
local function plain_layout(chart, answer)
  local list, count = {}, 0
  local width, height = answer:match('bb="0,0,([%d.e+]+),([%d.e+]+)"')
  for position in answer:gmatch('\n%s*pos="([^" ]+ [^"]+)"') do
    list[#list + 1] = graphs.line_of(position)
  end
  for _, arrow in ipairs(chart.all) do count = count + (arrow.label and 2 or 1) end
  return #list == count and { width = number_of(width), height = number_of(height),
    crossings = choice.count_crossings(list) } or nil
end

local MOST = 1000 -- nodes; Graphviz needs about a second to lay out so many

-- Returns a function that has Graphviz lay out graphs. In its first run it measures
-- leaves and labels, too, and sets `chart.whole` to the plain layout, if there is one.
--
-- Graphviz visits clusters in the order of the addresses of their names. These ascend
-- in each run only if a new process reads the graph of the chart first.
local function runner(chart, graph, ask)
  local is_begun = false
  graph = #chart.nodes <= MOST and graph:gsub("^[^\n]*", "digraph {", 1) or ""
  return function(text)
    if is_begun then return ask(text) end
    local sizes, read_sizes = graphs.sizes_of(chart)
    local answer, problem = ask(graph .. sizes .. text)
    if not answer and graph ~= "" then
      graph = ""
      answer, problem = ask(sizes .. text)
    end
    if not answer then return nil, problem end
    local stop = graph ~= "" and select(2, answer:find("\n}\n", 1, true)) or 0
    chart.whole = stop > 0 and plain_layout(chart, answer:sub(1, stop)) or nil
    is_begun = true
    return answer:sub(read_sizes(answer, stop + 1))
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
  local text_size = 10 * choice.scale(chart.sheet, best.width, best.height)
  if best == chart.whole then return plain_graph(chart, graph), nil, text_size end
  sheet.put(best)
  return graph_of(chart, best.composite.level,
    best == chart.outer.kept.first and "levels" or "sheet"), nil, text_size
end

return layout
