--- A machine as a Graphviz graph.
--
-- Composites are clusters. An arrow that leaves or enters a composite as a whole begins
-- or ends at its border. In Graphviz it connects two nodes, and is cut off at the
-- clusters named by `ltail` and `lhead`.
--
-- @module rfsm.dot
-- @license BSD-3-Clause

local diagram = require "rfsm.diagram"

local io, ipairs, os = io, ipairs, os
local concat, add = table.concat, diagram.add

local HEAD = [=[
  compound=true
  fontname="Helvetica"
  node [shape=box, style=rounded, fontname="Helvetica"]
  edge [fontname="Helvetica", fontsize=11]]=]

-- Text ------------------------------------------------------------------------

-- A quoted string; Graphviz reads "&amp;" in it as HTML does.
local function quoted(text)
  return '"' .. text:gsub("&", "&amp;"):gsub('[\\"]', "\\%0"):gsub("\n", "\\n") .. '"'
end

-- Nodes: composites are clusters ------------------------------------------------

local DOT = "shape=point, width=0.15"
local DIAMOND = 'shape=diamond, style="", width=0.25, height=0.25, label="", '
  .. "fontsize=11"

local function look_of(node)
  if node.kind == "initial" then return DOT end
  local name = quoted(node.name)
  return node.kind == "connector" and DIAMOND .. ", xlabel=" .. name or "label=" .. name
end

-- An arrow from a composite to itself, or into it, leaves by the border: it goes to a
-- point beside the composite, and from there back in.
local function is_loop(arrow)
  local src, tgt = arrow.src, arrow.tgt
  return src.kind == "composite" and (src == tgt or diagram.is_inside(tgt, src))
end

-- Gives each such arrow its point; returns the lists of them by composite.
local function place_points(chart)
  local points, by_src = {}, {}
  for _, arrow in ipairs(chart.all) do
    if is_loop(arrow) then
      points[arrow] = diagram.new_id(chart, arrow.src.id .. "_loop")
      local list = by_src[arrow.src] or {}
      by_src[arrow.src] = list
      list[#list + 1] = points[arrow]
    end
  end
  return points, by_src
end

local function add_node(lines, depth, node, points_by_src)
  if node.kind ~= "composite" then
    return add(lines, depth, node.id .. " [" .. look_of(node) .. "]")
  end
  add(lines, depth, "subgraph cluster_" .. node.id .. " {")
  add(lines, depth + 1, "label=" .. quoted(node.name) .. " style=rounded")
  for _, subnode in ipairs(node.nodes) do
    add_node(lines, depth + 1, subnode, points_by_src)
  end
  add(lines, depth, "}")
  for _, point in ipairs(points_by_src[node] or {}) do
    add(lines, depth, point .. " [shape=point, width=0.02]")
  end
end

-- Arrows ----------------------------------------------------------------------

-- The node to which an arrow of a composite is tied: the dot where it begins, if any.
local function anchor_of(node)
  while node.kind == "composite" do node = node.initial or node.nodes[1] end
  return node.id
end

local function add_edge(lines, src, tgt, attributes)
  local text = attributes[1] and " [" .. concat(attributes, ", ") .. "]" or ""
  add(lines, 1, src .. " -> " .. tgt .. text)
end

local function add_arrow(lines, arrow, point)
  local src, tgt = arrow.src, arrow.tgt
  local tail = { arrow.label ~= "" and "label=" .. quoted(arrow.label) or nil }
  local head = point and {} or tail
  if src.kind == "composite" then tail[#tail + 1] = "ltail=cluster_" .. src.id end
  if tgt.kind == "composite" then head[#head + 1] = "lhead=cluster_" .. tgt.id end
  if not point then return add_edge(lines, anchor_of(src), anchor_of(tgt), tail) end
  tail[#tail + 1] = "arrowhead=none"
  add_edge(lines, anchor_of(src), point, tail)
  add_edge(lines, point, anchor_of(tgt), head)
end

local function draw(chart)
  local points, points_by_src = place_points(chart)
  local lines = { "digraph " .. quoted(chart.title or chart.root.name) .. " {", HEAD }
  if chart.title then
    add(lines, 1, "label=" .. quoted(chart.title) .. " labelloc=t")
  end
  add_node(lines, 1, chart.root, points_by_src)
  for _, arrow in ipairs(chart.all) do add_arrow(lines, arrow, points[arrow]) end
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
