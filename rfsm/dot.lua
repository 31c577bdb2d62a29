--- A machine as a Graphviz graph.
--
-- There are two graphs. `layout` has Graphviz lay out each composite, one after the
-- other, and returns a graph with the position of everything, or the other graph if its
-- arrows cross less. `encode` needs no Graphviz, and has no positions: composites
-- are clusters, and a label is a node in the line of its arrow, so that Graphviz draws
-- no other line through the label. All edges of this graph point onward in the order of
-- the walk from `initial`: the edge of an arrow that leads back is reversed, and is
-- drawn with its head at the other end.
--
-- In the SVG each state, connector and transition is an element whose id is its FQN or
-- key. In the SVG of `encode`, the lines before and behind a label are the elements
-- `KEY/src` and `KEY/tgt`. The classes of elements are `state`, `connector`, `initial`,
-- `region`, `transition`, `active`, `done`.
--
-- @module rfsm.dot
-- @license BSD-3-Clause

local diagram = require "rfsm.pictures.diagram"
local layout = require "rfsm.pictures.layout"
local looks = require "rfsm.pictures.looks"
local programs = require "rfsm.shared.programs"

local ipairs = ipairs
local concat, add = table.concat, diagram.add
local id_of = looks.id_of

-- Adds the labels of the arrows in a composite. Each label is a node of the graph.
local function add_labels(lines, depth, composite)
  for _, arrow in ipairs(composite.arrows) do
    if arrow.label then
      add(lines, depth, ("%s [%s, %s]"):format(arrow.label.id, id_of(arrow.key),
        arrow.label.text))
    end
  end
end

-- Arrows ----------------------------------------------------------------------

-- Returns over how many ranks an edge leads down from a node. If the last node of a
-- composite has a loop, the loop's label is one more rank.
local function length_of(node)
  local length = 1
  while node.kind == "composite" do
    node = node.nodes[#node.nodes]
    if node.has_loop then length = length + 1 end
  end
  return length
end

local function leads_back(arrow)
  local src, tgt = diagram.ends_in(arrow, arrow.home)
  return src.index > tgt.index
end

-- Gives an arrow a node for its label if the arrow has a text, or is a loop.
local function place_label(chart, arrow)
  local is_round = diagram.is_loop(arrow)
  if not (arrow.parts[1] or is_round) then return end
  local is_down = chart.direction == "TB"
  arrow.label = {
    is_round = is_round,
    id = diagram.new_id(chart, arrow.src.id .. "_to_" .. arrow.tgt.id),
    text = is_round and looks.hung_label(arrow, chart.direction)
      or looks.line_label(arrow, chart.direction),
    head = is_down and ":l:n" or ":l:w", tail = is_down and ":l:s" or ":l:e",
  }
end

local function crosses_frame(a, b)
  return a.parent ~= b.parent or a.kind == "composite" or b.kind == "composite"
end

local function min_length(upper, lower)
  local length = length_of(upper)
  if upper.text or lower.text then return length end
  return crosses_frame(upper, lower) and length + 1 or length
end

-- Adds an edge of an arrow, from an upper node to a lower one. `half` is "", "/src" or
-- "/tgt", behind each key of a bundle; `dir` is the attribute `dir` of Graphviz.
local function add_edge(lines, arrow, half, upper, lower, dir)
  local length = min_length(upper, lower)
  local key = concat(arrow.keys or { arrow.key }, half .. "\n") .. half
  add(lines, 1, looks.edge_text(arrow, upper, lower, key,
    (length > 1 and ", minlen=" .. length or "")
    .. (dir ~= "forward" and ", dir=" .. dir or "")))
end

-- Adds one edge for an arrow without a label, else two: to the label and from it.
-- The label of a loop is below both ends of the loop, and is its bottom.
local function add_arrow(lines, arrow)
  local src, tgt, label = arrow.src, arrow.tgt, arrow.label
  local is_back, is_round = leads_back(arrow), diagram.is_loop(arrow)
  local function add_half(half, upper, lower, is_turned, dir)
    if is_turned then upper, lower = lower, upper end
    add_edge(lines, arrow, half, upper, lower, dir or is_turned and "back" or "forward")
  end
  if not label then return add_half("", src, tgt, is_back) end
  add_half("/src", src, label, is_back, "none")
  if is_round then label.head = label.head:gsub("l", "r", 1) end
  add_half("/tgt", label, tgt, is_back or is_round)
end

local LARGE = 500 -- nodes; a chart with more is laid out with less effort

local function draw(chart)
  local root = chart.root
  for _, arrow in ipairs(chart.all) do place_label(chart, arrow) end
  root.name = chart.title or root.name
  local lines = { "digraph " .. looks.quoted(root.name) .. " {",
    looks.head(chart.direction) }
  -- so Graphviz takes seconds and not a minute, and the picture is hardly wider
  if #chart.nodes > LARGE then add(lines, 1, "graph [nslimit=1]") end
  looks.add_node(lines, 1, root, add_labels)
  add_labels(lines, 1, chart.top)
  for _, arrow in ipairs(chart.all) do add_arrow(lines, arrow) end
  add(lines, 0, "}")
  return concat(lines, "\n") .. "\n"
end

-- Public functions ------------------------------------------------------------

local dot = diagram.exporter("rfsm.dot", "rfsm2dot", draw)

-- Makes an SVG that is an image, or is opened alone, dark where its reader wants that:
-- light is dark, and each colour keeps its hue. In another document it does nothing.
local DARK = "\n<style>@media screen and (prefers-color-scheme: dark) "
  .. "{ svg:root { filter: invert(.93) hue-rotate(180deg) } }</style>"

local HELP = "; another direction or depth, or another version of Graphviz may help"

--- Have Graphviz draw a graph.
---@param text string the graph
---@param format string "svg", "png", "pdf" or another format of Graphviz
---@return string? picture
---@return string? problem in one line
---@nodiscard
function dot.render(text, format)
  local picture, problem = programs.filter("dot -T" .. format .. " %s", text,
    "Graphviz is missing (on Debian: apt-get install graphviz)")
  if not picture then
    return nil, problem:find("killed by", 1, true) and problem .. HELP or problem
  end
  return format == "svg" and picture:gsub("<svg[^>]*>", "%0" .. DARK) or picture
end

--- Have Graphviz lay out a machine, or a description.
---@param fsm rfsm.Machine
---@param options? rfsm.pictures.Options
---@param run? rfsm.pictures.Run runs Graphviz on a host without the program `dot`
---@return string? graph
---@return string? problem in one line
---@return number? text size of the text on the sheet, in points
---@nodiscard
function dot.layout(fsm, options, run)
  local chart = diagram.read(fsm, "rfsm.dot.layout", options)
  return layout.draw(chart, draw(chart), run or function(graphs)
    return dot.render(graphs, "dot")
  end)
end

return dot
