--- A machine as a Graphviz graph.
--
-- Composites and regions are clusters. A label is a node of its own in the middle of its
-- arrow, so that Graphviz lets nothing run through it, and puts it into the frame of the
-- composite around both ends. All edges point onward in the order of the walk from
-- `initial`: those of arrows that lead back are reversed, and drawn backwards.
--
-- In the SVG each state, connector and transition is an element whose id is its FQN or
-- key; the two halves of an arrow with a label are `KEY/src` and `KEY/tgt`. Classes are
-- `state`, `connector`, `initial`, `region`, `transition`, `active`, `done`.
--
-- @module rfsm.dot
-- @license BSD-3-Clause

local diagram = require "rfsm.diagram"

local io, ipairs, os = io, ipairs, os
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

local function lines_of(...) return concat(diagram.wrap { ... }, "\n") end

-- Lines of HTML, each at the left.
local function html(text)
  return text:gsub('[&<>"]', CODES):gsub("\n", '<BR ALIGN="LEFT"/>')
end

-- The name of a state over the rows of what it does.
local function state_label(node)
  local name = lines_of(node.name .. (node.is_cut and " …" or ""))
  if not node.rows[1] then return quoted(name) end
  local rows = {}
  for i, row in ipairs(node.rows) do rows[i] = lines_of(row) end
  local line = node.kind == "leaf" and "<HR/>" or ""
  return '<<TABLE BORDER="0" CELLBORDER="0" CELLSPACING="0"><TR><TD>'
    .. html(name):gsub(' ALIGN="LEFT"', "") .. "</TD></TR>" .. line
    .. '<TR><TD ALIGN="LEFT" BALIGN="LEFT"><FONT POINT-SIZE="10">'
    .. html(concat(rows, "\n")) .. '<BR ALIGN="LEFT"/></FONT></TD></TR></TABLE>>'
end

-- Nodes: composites are clusters ------------------------------------------------

local CONNECTOR = 'shape=circle, label="", width=0.15, height=0.15'
local INITIAL = CONNECTOR .. ', fillcolor="#222222", color="#222222"'
local ACTIVE = ', color="#0072B2", penwidth=2, fillcolor="#D6EAF8"'

local function class_of(node, kind)
  return (', class="%s%s%s"'):format(kind, node.is_region and " region" or "",
    node.mode and " " .. node.mode or "")
end

-- Connectors that arrows across the border of their composite use are rings.
local function is_on_border(chart, node)
  for _, arrow in ipairs(chart.all) do
    local other = arrow.src == node and arrow.tgt or arrow.tgt == node and arrow.src
    if other and not diagram.is_inside(other, node.parent) then return true end
  end
  return false
end

local function look_of(chart, node)
  if node.kind == "initial" then return INITIAL .. class_of(node, "initial") end
  if node.kind == "connector" then
    return CONNECTOR .. ", fontsize=9, xlabel=" .. quoted(lines_of(node.name))
      .. (is_on_border(chart, node) and "" or ', fillcolor="#555555"')
      .. class_of(node, "connector")
  end
  return "label=" .. state_label(node) .. class_of(node, "state")
    .. (node.is_final and ", peripheries=2" or "") .. (node.mode and ACTIVE or "")
end

local function add_node(lines, depth, chart, node)
  local id = "id=" .. quoted(node.fqn) .. ", "
  if node.kind ~= "composite" then
    return add(lines, depth, ("%s [%s%s]"):format(node.id, id, look_of(chart, node)))
  end
  add(lines, depth, "subgraph cluster_" .. node.id .. " {")
  local is_plain = not node.mode
  add(lines, depth + 1, ("graph [%slabel=%s, margin=10, style=%s%s%s]"):format(id,
    state_label(node), node.is_region and "dashed" or "rounded",
    class_of(node, "state"), is_plain and ', color="#555555", penwidth=1'
    or ', color="#0072B2", penwidth=2'))
  for _, subnode in ipairs(node.nodes) do add_node(lines, depth + 1, chart, subnode) end
  for _, arrow in ipairs(node.arrows) do
    if arrow.label_id then add(lines, depth + 1, arrow.label_line) end
  end
  add(lines, depth, "}")
end

-- Arrows ----------------------------------------------------------------------

-- The nodes to which the ends of arrows at a composite are tied: its first, its last.
local function first_of(node)
  while node.kind == "composite" do node = node.initial or node.nodes[1] end
  return node.id
end

local function last_of(node)
  while node.kind == "composite" do node = node.nodes[#node.nodes] end
  return node.id
end

-- An arrow from a composite to itself, or into it, leaves by the border.
local function is_loop(arrow)
  local src, tgt = arrow.src, arrow.tgt
  return src.kind == "composite" and (src == tgt or diagram.is_inside(tgt, src))
end

local function position_of(node, home)
  while node.parent ~= home do node = node.parent end
  for i, subnode in ipairs(home and home.nodes or {}) do
    if subnode == node then return i end
  end
  return 0
end

-- Does an arrow lead to what comes earlier in the walk?
local function leads_back(arrow)
  return position_of(arrow.src, arrow.home) > position_of(arrow.tgt, arrow.home)
end

-- Gives an arrow a node for its label, unless it needs none.
local function place_label(chart, arrow)
  local has_text, is_own = arrow.parts[1], arrow.src == arrow.tgt
  if not (has_text and not is_own or is_loop(arrow)) then return end
  arrow.label_id = diagram.new_id(chart, arrow.src.id .. "_to_" .. arrow.tgt.id)
  arrow.label_line = ("%s [id=%s, class=transition, %s]"):format(arrow.label_id,
    quoted(arrow.key), has_text and 'shape=box, style="", penwidth=0, fontsize=10, '
    .. 'width=0, height=0, margin="0.04,0.03", label='
    .. quoted(concat(diagram.wrap(arrow.parts), "\n")) or "shape=point, width=0.02")
end

-- Adds an edge; `src` and `tgt` are { id, cluster } or { id }, `head` is where its arrow
-- is: at "src", at "tgt" or at neither.
local function add_edge(lines, id, src, tgt, head, attributes)
  local text = { "id=" .. quoted(id), "class=transition" }
  local function tail(name, node)
    if node.kind == "composite" then text[#text + 1] = name .. "=cluster_" .. node.id end
  end
  tail("ltail", src)
  tail("lhead", tgt)
  if head ~= "tgt" then text[#text + 1] = head == "src" and "dir=back" or "dir=none" end
  text[#text + 1] = attributes
  add(lines, 1, ("%s -> %s [%s]"):format(last_of(src), first_of(tgt), concat(text, ", ")))
end

local function add_arrow(lines, arrow)
  local src, tgt, key = arrow.src, arrow.tgt, arrow.key
  local is_back = is_loop(arrow) and true or leads_back(arrow)
  if not arrow.label_id then
    local label = arrow.parts[1]
      and "label=" .. quoted(concat(diagram.wrap(arrow.parts), "\n")) or nil
    if is_back then return add_edge(lines, key, tgt, src, "src", label) end
    return add_edge(lines, key, src, tgt, "tgt", label)
  end
  local label = { id = arrow.label_id }
  if is_loop(arrow) then
    add_edge(lines, key .. "/src", src, label, "none")
    return add_edge(lines, key .. "/tgt", tgt, label, "src")
  elseif is_back then
    add_edge(lines, key .. "/src", label, src, "none")
    return add_edge(lines, key .. "/tgt", tgt, label, "src")
  end
  add_edge(lines, key .. "/src", src, label, "none")
  add_edge(lines, key .. "/tgt", label, tgt, "tgt")
end

local function draw(chart)
  for _, arrow in ipairs(chart.all) do place_label(chart, arrow) end
  local lines = { "digraph " .. quoted(chart.title or chart.root.name) .. " {",
    (HEAD:gsub("DIRECTION", chart.direction)) }
  chart.root.name = chart.title or chart.root.name
  add_node(lines, 1, chart, chart.root)
  for _, arrow in ipairs(chart.arrows) do
    if arrow.label_id then add(lines, 1, arrow.label_line) end
  end
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
