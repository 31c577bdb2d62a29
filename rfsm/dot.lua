--- A machine as a Graphviz graph.
--
-- Composites and regions are clusters. A label is a node of its own in the middle of
-- its arrow, so that Graphviz lets nothing run through it. It stands in the frame of
-- the composite around both ends. All edges point onward in the order of the walk from
-- `initial`: those of arrows that lead back are reversed, and drawn backwards.
--
-- In the SVG each state, connector and transition is an element whose id is its FQN or
-- key; the two halves of an arrow with a label are `KEY/src` and `KEY/tgt`. Classes are
-- `state`, `connector`, `initial`, `region`, `transition`, `active`, `done`.
--
-- @module rfsm.dot
-- @license BSD-3-Clause

local diagram = require "rfsm.pictures.diagram"

local io, ipairs, os = io, ipairs, os
local max, min = math.max, math.min
local concat, add = table.concat, diagram.add

local FONT = '"Helvetica,Arial,sans-serif"'
local HEAD = ([=[
  graph [compound=true, fontname=FONT, fontsize=12, nodesep=0.3, ranksep=0.25]
  graph [rankdir=DIRECTION, style=rounded, color="#555555"]
  node [fontname=FONT, fontsize=12, color="#555555", fillcolor=white]
  node [shape=box, style="rounded,filled", height=0.4, margin="0.15,0.07"]
  edge [fontname=FONT, fontsize=10, color="#555555", arrowsize=0.7]]=])
  :gsub("FONT", FONT)

-- Text ------------------------------------------------------------------------

local CODES = { ["&"] = "&amp;", ["<"] = "&lt;", [">"] = "&gt;", ['"'] = "&quot;" }

-- A quoted string; Graphviz reads "&amp;" in it as HTML does.
local function quoted(text)
  return '"' .. text:gsub("&", "&amp;"):gsub('[\\"]', "\\%0"):gsub("\n", "\\n") .. '"'
end

-- The id of an FQN or a key in the SVG: a line feed is "\n".
local function id_of(text) return "id=" .. quoted(diagram.clean(text)) end

local function lines_of(text, width)
  return concat(diagram.wrap({ text }, width), "\n")
end

-- Lines of HTML, each at the left.
local function html(text)
  return text:gsub('[&<>"]', CODES):gsub("\n", '<BR ALIGN="LEFT"/>')
end

-- The name of a state over the rows of what it does.
local function state_label(node)
  local name = lines_of(node.name .. (node.is_cut and " …" or ""), 28)
  if not node.rows[1] then return quoted(name) end
  local rows = {}
  for i, row in ipairs(node.rows) do rows[i] = lines_of(row, 40) end
  local line = node.kind == "leaf" and "<HR/>" or ""
  return '<<TABLE BORDER="0" CELLBORDER="0" CELLSPACING="0"><TR><TD>'
    .. html(name):gsub(' ALIGN="LEFT"', "") .. "</TD></TR>" .. line
    .. '<TR><TD ALIGN="LEFT" BALIGN="LEFT"><FONT POINT-SIZE="10">'
    .. html(concat(rows, "\n")) .. '<BR ALIGN="LEFT"/></FONT></TD></TR></TABLE>>'
end

-- Nodes: composites are clusters ------------------------------------------------

local INITIAL = 'shape=circle, label="", width=0.15, height=0.15, color="#222222", '
  .. 'fillcolor="#222222"'
local CONNECTOR = 'shape=plain, style="", label=<<TABLE BORDER="0" CELLBORDER="0" '
  .. 'CELLSPACING="0" CELLPADDING="0"><TR><TD PORT="p" BORDER="1" STYLE="ROUNDED" '
  .. 'FIXEDSIZE="TRUE" WIDTH="10" HEIGHT="10" BGCOLOR="%s"></TD><TD>'
  .. '<FONT POINT-SIZE="9">&#160;%s</FONT></TD></TR></TABLE>>'
-- What is active or marked; the colours are told apart without red and green.
local LOOKS = {
  plain = ', color="#555555", penwidth=1', active = ', color="#0072B2", penwidth=2',
  missed = ', color="#D55E00", fontcolor="#D55E00"', covered = "",
  traced = ', color="#D55E00", penwidth=2',
}

local function class_of(element, kind)
  return (', class="%s%s%s%s"'):format(kind, element.is_region and " region" or "",
    element.mode and " " .. element.mode or "",
    element.mark and " " .. element.mark or "")
end

-- Returns class and look of a state or an arrow.
local function look_of(element, kind)
  return class_of(element, kind) .. (element.mode and LOOKS.active or "")
    .. (element.mark and LOOKS[element.mark] or "")
end

-- Connectors that arrows across the border of their composite use are rings.
local function is_on_border(chart, node)
  for _, arrow in ipairs(chart.all) do
    local other = arrow.src == node and arrow.tgt or arrow.tgt == node and arrow.src
    if other and not diagram.is_inside(other, node.parent) then return true end
  end
  return false
end

local function leaf_text(chart, node)
  if node.kind == "initial" then return INITIAL .. class_of(node, "initial") end
  if node.kind == "connector" then
    return CONNECTOR:format(is_on_border(chart, node) and "white" or "#555555",
      html(node.name)) .. class_of(node, "connector")
  end
  return "label=" .. state_label(node) .. look_of(node, "state")
    .. (node.is_final and ", peripheries=2" or "")
    .. (node.is_region and ', style="filled,dashed"' or "")
    .. (node.mode and ', fillcolor="#D6EAF8"' or "")
end

local LABEL = 'node [shape=box, style="", penwidth=0, fontsize=10, width=0, height=0, '
  .. 'margin="0.04,0.03"]'

local function add_labels(lines, depth, composite)
  local has_labels = false
  for _, arrow in ipairs(composite.arrows) do
    if arrow.label then
      if not has_labels then add(lines, depth, "{ " .. LABEL) end
      has_labels = true
      add(lines, depth + 1, ("%s [%s, label=%s%s%s]"):format(arrow.label.id,
        id_of(arrow.key), arrow.label.text, class_of(arrow, "transition"),
        arrow.mark == "missed" and ', fontcolor="#D55E00"' or ""))
    end
  end
  if has_labels then add(lines, depth, "}") end
end

local function add_node(lines, depth, chart, node)
  local id = id_of(node.fqn) .. ", "
  if node.kind ~= "composite" then
    return add(lines, depth, ("%s [%s%s]"):format(node.id, id, leaf_text(chart, node)))
  end
  add(lines, depth, "subgraph cluster_" .. node.id .. " {")
  add(lines, depth + 1, ("graph [%slabel=%s, margin=10, style=%s%s%s]"):format(id,
    state_label(node), node.is_region and "dashed" or "rounded", LOOKS.plain,
    look_of(node, "state")))
  for _, subnode in ipairs(node.nodes) do add_node(lines, depth + 1, chart, subnode) end
  add_labels(lines, depth + 1, node)
  add(lines, depth, "}")
end

-- Arrows ----------------------------------------------------------------------

local function index_in(node, home)
  while node.parent ~= home do node = node.parent end
  return node.index or 0
end

-- Returns how many ranks a node takes, about, and notes the lowest node of composites.
local function measure(node)
  if node.kind ~= "composite" then return 1 end
  local below, tops, height = {}, {}, 0
  for _, arrow in ipairs(node.arrows) do
    local i, j = index_in(arrow.src, node), index_in(arrow.tgt, node)
    local list = below[min(i, j)] or {}
    below[min(i, j)], list[#list + 1] = list, max(i, j)
  end
  for i, subnode in ipairs(node.nodes) do
    local bottom = (tops[i] or 0) + measure(subnode)
    if bottom >= height then height, node.lowest = bottom, subnode end
    for _, j in ipairs(below[i] or {}) do tops[j] = max(tops[j] or 0, bottom + 1) end
  end
  return height
end

-- Returns the node to which edges of a node are tied: of a composite the lowest one for
-- a tail, the first one for a head.
local function anchor_of(node, is_tail)
  while node.kind == "composite" do
    node = is_tail and node.lowest or node.initial or node.nodes[1]
  end
  return node.id .. (node.kind == "connector" and ":p" or "")
end

-- Returns how many ranks an edge goes down from a node: the labels of loops in a
-- composite come before those of its own arrows.
local function length_of(node)
  local length = 1
  while node.kind == "composite" do
    node = node.lowest
    if node.has_loop then length = length + 1 end
  end
  return length
end

-- Does an arrow lead from a node to itself, or into it?
local function is_loop(arrow)
  return arrow.src == arrow.tgt or diagram.is_inside(arrow.tgt, arrow.src)
end

-- Does an arrow lead to a node that comes earlier in the walk?
local function leads_back(arrow)
  return index_in(arrow.src, arrow.home) > index_in(arrow.tgt, arrow.home)
end

-- Gives an arrow a node for its label, unless it needs none.
local function place_label(chart, arrow)
  arrow.src.has_loop = arrow.src.has_loop or is_loop(arrow)
  if not (arrow.parts[1] or is_loop(arrow)) then return end
  arrow.label = {
    id = diagram.new_id(chart, arrow.src.id .. "_to_" .. arrow.tgt.id),
    text = quoted(arrow.parts[1] and diagram.label_of(arrow) or "any event"),
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

-- Adds an edge of an arrow, from an upper node to a lower one; `half` is "", "/src" or
-- "/tgt", `dir` that of Graphviz.
local function add_edge(lines, arrow, half, upper, lower, dir)
  local length = min_length(upper, lower)
  add(lines, 1, ("%s -> %s [%s%s%s%s%s%s]"):format(
    anchor_of(upper, true), anchor_of(lower), id_of(arrow.key .. half),
    look_of(arrow, "transition"),
    upper.kind == "composite" and ", ltail=cluster_" .. upper.id or "",
    lower.kind == "composite" and ", lhead=cluster_" .. lower.id or "",
    length > 1 and ", minlen=" .. length or "",
    dir ~= "forward" and ", dir=" .. dir or ""))
end

-- Adds the edge of an arrow, or one to its label and one from there. The label of a
-- loop is below both its ends.
local function add_arrow(lines, arrow)
  local src, tgt, label = arrow.src, arrow.tgt, arrow.label
  local is_back = leads_back(arrow)
  local function add_half(half, upper, lower, is_turned, dir)
    if is_turned then upper, lower = lower, upper end
    add_edge(lines, arrow, half, upper, lower, dir or is_turned and "back" or "forward")
  end
  if not label then return add_half("", src, tgt, is_back) end
  add_half("/src", src, label, is_back, "none")
  add_half("/tgt", label, tgt, is_back or is_loop(arrow))
end

local LARGE = 500 -- nodes

local function draw(chart)
  local root = chart.root
  for _, arrow in ipairs(chart.all) do place_label(chart, arrow) end
  measure(root)
  root.name = chart.title or root.name
  local lines = { "digraph " .. quoted(root.name) .. " {",
    (HEAD:gsub("DIRECTION", chart.direction)) }
  -- so that Graphviz takes seconds, not a minute; the picture is hardly wider
  if #chart.nodes > LARGE then add(lines, 1, "graph [nslimit=1]") end
  add_node(lines, 1, chart, root)
  add_labels(lines, 1, chart)
  for _, arrow in ipairs(chart.all) do add_arrow(lines, arrow) end
  add(lines, 0, "}")
  return concat(lines, "\n") .. "\n"
end

-- Pictures: Graphviz makes them -----------------------------------------------

local function succeeds(command)
  local status = os.execute(command)
  return status == true or status == 0
end

-- Returns the content of a temporary file, and removes it.
local function take(file)
  local handle = io.open(file, "rb")
  local text = handle and handle:read("*a") or ""
  if handle then handle:close() end
  os.remove(file)
  return text
end

-- Public functions ------------------------------------------------------------

local dot = diagram.exporter("rfsm.dot", "rfsm2dot", draw)

--- Have Graphviz lay out a graph.
---@param text string of a graph
---@param format string "svg", "png", "pdf" or another format of Graphviz
---@return string? picture
---@return string? problem in one line
---@nodiscard
function dot.render(text, format)
  if not succeeds("command -v dot >/dev/null 2>&1") then
    return nil, "Graphviz is missing (on Debian: apt-get install graphviz)"
  end
  local graph, picture, log = os.tmpname(), os.tmpname(), os.tmpname()
  local ok, problem = diagram.write(graph, text)
  if ok then
    ok = succeeds(("dot -T%s -o '%s' '%s' 2>'%s' </dev/null"):format(format, picture,
      graph, log))
  end
  local result, complaint = take(picture), take(log)
  os.remove(graph)
  if ok and result ~= "" then return result end
  return nil, problem or "dot: " .. (complaint:match("[^\n]+") or "no picture")
end

return dot
