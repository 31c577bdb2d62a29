--- How states, connectors and arrows look, in the language of Graphviz.
--
-- @module rfsm.pictures.looks
-- @license BSD-3-Clause

local diagram = require "rfsm.pictures.diagram"
local rfsm = require "rfsm"

local floor, ipairs = math.floor, ipairs
local concat, add = table.concat, diagram.add

local looks = {}

local FONT = '"Helvetica,Arial,sans-serif"'
local HEAD = ([=[
  graph [compound=true, fontname=FONT, fontsize=12, nodesep=0.3, ranksep=0.25]
  graph [rankdir=DIRECTION, style=rounded, color="#555555"]
  node [fontname=FONT, fontsize=12, color="#555555", fillcolor=white]
  node [shape=box, style="rounded,filled", height=0.4, margin="0.15,0.07"]
  edge [fontname=FONT, fontsize=10, color="#555555", arrowsize=0.7]]=])
  :gsub("FONT", FONT)

--- Return the attributes that all graphs begin with.
function looks.head(direction) return (HEAD:gsub("DIRECTION", direction)) end

-- Text ------------------------------------------------------------------------

--- Return a number with at most two decimals, the same text on each Lua: `%.2f` alone
-- rounds 0.125 up on LuaJIT, down on the others.
function looks.number_text(number)
  local rounded = floor(number * 100 + 0.5) / 100
  local text = rfsm.number_text(rounded, "%.2f"):gsub("%.?0+$", "")
  return text == "-0" and "0" or text
end

local CODES = { ["&"] = "&amp;", ["<"] = "&lt;", [">"] = "&gt;", ['"'] = "&quot;" }

--- Return a text as a quoted string for Graphviz, which reads "&amp;" in it as "&".
-- `ending` replaces a line feed; by default it is "\\n".
function looks.quoted(text, ending)
  if not text:find('[&\\"\n]') then return '"' .. text .. '"' end
  return '"' .. text:gsub("&", "&amp;"):gsub('[\\"]', "\\%0")
    :gsub("\n", ending or "\\n") .. '"'
end

local quoted = looks.quoted

--- Return the attribute `id` that an element gets in an SVG. The text is the FQN of a
-- node or the key of a transition; a line feed in it becomes "\n".
function looks.id_of(text)
  if not text:find("[^%w_%.%[%]/ ]") then return 'id="' .. text .. '"' end
  return "id=" .. quoted(diagram.clean(text))
end

local function lines_of(text, width)
  return concat(diagram.wrap({ text }, width), "\n")
end

-- Returns a text as HTML, its lines aligned at the left.
local function html(text)
  if not text:find('[&<>"\n]') then return text end
  return (text:gsub('[&<>"]', CODES):gsub("\n", '<BR ALIGN="LEFT"/>'))
end

local function centred(text) return (html(text):gsub(' ALIGN="LEFT"', "")) end

local function table_of(rows, attributes)
  return ('<<TABLE BORDER="0" CELLBORDER="0" CELLSPACING="0"%s>%s</TABLE>>'):format(
    attributes or "", rows)
end

-- The line below the name of a state. It is a cell, because Graphviz leaves out some
-- <HR/> in a PNG.
local RULE = '<TR><TD CELLPADDING="0" HEIGHT="1" BGCOLOR="#555555"></TD></TR>'

--- Return the label of a state: its name and marks, and rows such as "entry / f" below.
function looks.state_label(node)
  local name = lines_of(node.name .. (node.marks and " " .. node.marks or "")
    .. (node.is_cut and " …" or ""), 28)
  if not node.rows[1] then return quoted(name) end
  local rows = {}
  for i, row in ipairs(node.rows) do rows[i] = lines_of(row, 40) end
  return table_of("<TR><TD>" .. centred(name) .. "</TD></TR>" .. RULE
    .. '<TR><TD ALIGN="LEFT" BALIGN="LEFT"><FONT POINT-SIZE="10">'
    .. html(concat(rows, "\n")) .. '<BR ALIGN="LEFT"/></FONT></TD></TR>')
end

-- Returns the label of an arrow. Each of several lines ends in a line feed, so that all
-- of them are aligned at the left.
local function label_of(arrow)
  local text = diagram.label_of(arrow)
  return text:find("\n", 1, true) and text .. "\n" or text
end

--- Return the label of an arrow.
function looks.arrow_label(arrow) return quoted(label_of(arrow), "\\l") end

--- Return the label of an arrow, with so many points of room around it.
function looks.roomy_label(arrow, room)
  return table_of("<TR><TD>" .. html(label_of(arrow)) .. "</TD></TR>",
    (' CELLPADDING="%d"'):format(room))
end

--- Return the attributes of a node with the size of the label of an arrow.
function looks.label_text(arrow)
  return "shape=plain, fontsize=10, label="
    .. (arrow.parts[1] and looks.roomy_label(arrow, 0) or '""')
end

-- Nodes -----------------------------------------------------------------------

local INITIAL = 'shape=circle, label="", width=0.15, height=0.15, color="#222222", '
  .. 'fillcolor="#222222"'
local CONNECTOR = 'shape=plain, style="", label=<<TABLE BORDER="0" CELLBORDER="0" '
  .. 'CELLSPACING="0" CELLPADDING="0"><TR><TD PORT="p" BORDER="1" STYLE="ROUNDED" '
  .. 'FIXEDSIZE="TRUE" WIDTH="10" HEIGHT="10" BGCOLOR="%s"></TD><TD>'
  .. '<FONT POINT-SIZE="10">&#160;%s</FONT></TD></TR></TABLE>>'
-- Looks of active and of marked elements. No two of them differ only in red and green,
-- for colour-blind readers.
local LOOKS = {
  plain = ', color="#555555", penwidth=1', active = ', color="#0072B2", penwidth=2',
  missed = ', color="#D55E00", fontcolor="#D55E00"', covered = "",
  traced = ', color="#D55E00", penwidth=2',
}

--- The address of a state that is drawn in another picture begins so, before its FQN.
looks.URL = "#"

local function tooltip_of(element)
  return element.at ~= "" and ", tooltip=" .. quoted(element.at) or ""
end

-- Returns a class that notes the row of a state on a sheet, for the next picture.
local function row_of(node) return node.row and " row" .. node.row or "" end

local function look_of(element, kind)
  return ('class="%s%s%s%s%s"%s%s%s'):format(kind,
    element.is_region and " region" or "", row_of(element),
    element.mode and " " .. element.mode or "",
    element.mark and " " .. element.mark or "",
    element.mode and LOOKS.active or "", element.mark and LOOKS[element.mark] or "",
    tooltip_of(element))
end

-- Returns the attributes of a state that another picture shows, if there is one.
local function address_of(node)
  local is_elsewhere = node.is_linked and (node.is_cut or node.is_outside)
  return (node.is_outside and ', style="rounded,dashed"' or "")
    .. (is_elsewhere and ", URL=" .. quoted(looks.URL .. node.fqn) or "")
end

--- Return the attributes of a node that is not a composite.
function looks.leaf_text(node)
  if node.kind == "initial" then
    return INITIAL .. (', class="initial%s"'):format(row_of(node))
  end
  if node.kind == "connector" then
    return CONNECTOR:format(node.is_on_border and "white" or "#555555", html(node.name))
      .. (', class="connector%s"'):format(row_of(node))
  end
  return ("label=%s, %s%s%s%s%s%s"):format(looks.state_label(node),
    look_of(node, "state"), node.least or "",
    node.is_final and ", peripheries=2" or "",
    node.is_region and ', style="filled,dashed"' or "",
    node.mode and ', fillcolor="#D6EAF8"' or "",
    address_of(node))
end

--- Return the distance in points from the frame of a composite to what is in it.
function looks.margin_of(node) return node.depth > 0 and 10 or 4 end

--- Return the attributes of the frame of a composite. The root has a tint, and no line.
function looks.frame_text(node)
  local style = node.is_region and "dashed" or "rounded"
  return ('label=%s, margin=%d, style="%s,filled", fillcolor="%s"%s, %s%s'):format(
    looks.state_label(node), looks.margin_of(node), style,
    node.depth % 2 == 1 and "white" or "#F4F6F8", LOOKS.plain, look_of(node, "state"),
    node.depth == 0 and ", color=none" or "")
end

--- Append the lines of a node and of the nodes in it. A composite is a cluster.
-- `add_labels(lines, depth, node)` appends further lines in a composite.
function looks.add_node(lines, depth, node, add_labels)
  local id, position = looks.id_of(node.fqn), node.position or ""
  if node.kind ~= "composite" then
    return add(lines, depth, ("%s [%s, %s%s]"):format(node.id, id,
      looks.leaf_text(node), position))
  end
  add(lines, depth, "subgraph cluster_" .. node.id .. " {")
  add(lines, depth + 1, ("graph [%s, %s%s]"):format(id, looks.frame_text(node),
    position))
  for _, subnode in ipairs(node.nodes) do
    looks.add_node(lines, depth + 1, subnode, add_labels)
  end
  if add_labels then add_labels(lines, depth + 1, node) end
  add(lines, depth, "}")
end

-- Returns the node at which Graphviz shall end an edge. In a composite it is the last
-- node if the edge begins there, else the first node, because nodes are drawn in about
-- this order from top to bottom.
local function anchor_of(node, is_tail)
  if node.text then return node.id .. (is_tail and node.tail or node.head) end
  while node.kind == "composite" do
    node = node.nodes[is_tail and #node.nodes or 1]
  end
  return node.id .. (node.kind == "connector" and ":p" or "")
end

--- Return an edge of an arrow, with further attributes. In Graphviz no edge ends at a
-- cluster, so the edge of a composite ends at a node in it.
function looks.edge_text(arrow, tail, head, key, more)
  return ("%s -> %s [%s, %s%s%s%s]"):format(anchor_of(tail, true), anchor_of(head),
    looks.id_of(key), look_of(arrow, "transition"),
    tail.kind == "composite" and ", ltail=cluster_" .. tail.id or "",
    head.kind == "composite" and ", lhead=cluster_" .. head.id or "", more)
end

local FOOT = '<TD PORT="%s" WIDTH="1" HEIGHT="1"></TD>'

-- Returns the attributes of a label that is a separate node for Graphviz. `feet` lists
-- its cells: "text", and the names of ports, which are tiny cells where lines end.
-- `sides` are the sides of the text cell that are drawn.
local function label_node(arrow, direction, feet, sides)
  local cells = {}
  local text = ('<TD CELLPADDING="4"%s>%s</TD>'):format(sides
    and (' BORDER="1" SIDES="%s"'):format(sides) or "",
    html(arrow.parts[1] and label_of(arrow) or " "))
  for i, foot in ipairs(feet) do
    cells[i] = foot == "text" and text or FOOT:format(foot)
  end
  local row = concat(cells, direction == "TB" and "" or "</TR><TR>")
  return ('shape=plain, style="", fontsize=10, label=%s, %s'):format(table_of(
    "<TR>" .. row .. "</TR>", ' CELLPADDING="0"'), look_of(arrow, "transition"))
end

--- Return the attributes of a label at the far end of a loop: three of its sides are
-- drawn, as a part of the loop.
function looks.hung_label(arrow, direction)
  return label_node(arrow, direction, { "l", "text", "r" },
    direction == "TB" and "LBR" or "TRB")
end

--- Return the attributes of a label beside a line: one side is drawn, as a part of the
-- line.
function looks.line_label(arrow, direction)
  if direction == "TB" then
    return label_node(arrow, direction, { "l", "text" }, "L")
  end
  return label_node(arrow, direction, { "text", "l" }, "B")
end

return looks
