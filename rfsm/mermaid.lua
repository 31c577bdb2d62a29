--- A machine as a Mermaid state diagram, which GitHub and other web pages draw.
--
-- The root has no frame, because Mermaid draws shallow diagrams better. An arrow from
-- or to the root begins or ends at a box with the root's name.
--
-- @module rfsm.mermaid
-- @license BSD-3-Clause

local diagram = require "rfsm.pictures.diagram"

local ipairs = ipairs
local concat, add = table.concat, diagram.add

-- Text ------------------------------------------------------------------------

-- A character that Mermaid, Markdown or HTML may interpret is written as its number.
local function code(character) return "#" .. character:byte() .. ";" end

local function text_of(text)
  text = text:gsub("[^%w %.,_/@%[%]%(%)%-\n\128-\255]", code)
  text = text:gsub("%-%-", code("-") .. code("-"))
  text = text:gsub("%f[%w_]_", code("_")):gsub("_%f[^%w_]", code("_")) -- emphasis
  return (text:gsub("\n", "<br>"))
end

-- The title is a string of YAML, in lines before the diagram.
local function title_of(text)
  return '"' .. text:gsub('[\\"]', "\\%0"):gsub("\n", " ") .. '"'
end

-- Lines -----------------------------------------------------------------------

-- Returns the initial connectors that are drawn as [*] with a diamond behind it. In
-- Mermaid no arrow can end at the [*] of a composite, or leave the composite from it.
local function find_diamonds(chart)
  local diamonds = {}
  local function note(node, is_plain)
    if node.kind == "initial" and not is_plain then diamonds[node] = true end
  end
  for _, arrow in ipairs(chart.all) do
    note(arrow.src, diagram.is_inside(arrow.tgt, arrow.src.parent))
    note(arrow.tgt)
  end
  return diamonds
end

-- The root gets the id "root_", because Mermaid uses "root" itself. The id is unique.
local function id_of(node) return node.depth > 0 and node.id or node.id .. "_" end

local function start_of(node, diamonds)
  return node.kind == "initial" and not diamonds[node] and "[*]" or id_of(node)
end

local function add_arrows(lines, depth, composite, diamonds)
  for _, arrow in ipairs(composite.arrows) do
    local label = arrow.parts[1] and " : " .. text_of(diagram.label_of(arrow)) or ""
    add(lines, depth, start_of(arrow.src, diamonds) .. " --> " .. id_of(arrow.tgt)
      .. label)
  end
end

local function add_diamond(lines, depth, node)
  add(lines, depth, "state " .. id_of(node) .. " <<choice>>")
  if node.kind == "initial" then add(lines, depth, "[*] --> " .. id_of(node)) end
end

local function add_state(lines, depth, node, ending)
  add(lines, depth, ('state "%s" as %s%s'):format(text_of(node.name), id_of(node),
    ending or ""))
end

local function add_leaf(lines, depth, node)
  add_state(lines, depth, node)
  for _, row in ipairs(node.rows) do
    add(lines, depth, id_of(node) .. " : " .. text_of(row))
  end
end

-- In Mermaid a composite has no rows of text, so the rows become a note beside it.
local function add_composite(lines, depth, node, add_members, diamonds)
  add_state(lines, depth, node, " {")
  add_members(lines, depth + 1, node, diamonds)
  add(lines, depth, "}")
  if not node.rows[1] then return end
  add(lines, depth, "note right of " .. id_of(node) .. " : "
    .. text_of(concat(node.rows, "\n")))
end

local function add_members(lines, depth, composite, diamonds)
  for i, node in ipairs(composite.nodes) do
    if node.is_region and i > 1 then add(lines, depth, "--") end
    if node.kind == "composite" then
      add_composite(lines, depth, node, add_members, diamonds)
    elseif node.kind == "connector" or diamonds[node] then
      add_diamond(lines, depth, node)
    elseif node.kind == "leaf" then
      add_leaf(lines, depth, node)
    end
  end
  add_arrows(lines, depth, composite, diamonds)
end

local function add_class(lines, chart)
  local ids = {}
  for _, node in ipairs(chart.nodes) do
    if node.mode and node.depth > 0 then ids[#ids + 1] = id_of(node) end
  end
  if not ids[1] then return end
  add(lines, 1, "classDef active fill:#D6EAF8,stroke:#0072B2,stroke-width:2px")
  add(lines, 1, "class " .. concat(ids, ",") .. " active")
end

local function draw(chart)
  local lines, root = {}, chart.root
  if chart.title then
    lines = { "---", "title: " .. title_of(chart.title), "---" }
  end
  add(lines, 0, "stateDiagram-v2")
  if chart.direction == "LR" then add(lines, 1, "direction LR") end
  if root.kind == "leaf" or chart.top.arrows[1] or root.rows[1] then
    add_leaf(lines, 1, root)
  end
  local diamonds = find_diamonds(chart)
  add_members(lines, 1, root, diamonds)
  add_arrows(lines, 1, chart.top, diamonds)
  add_class(lines, chart)
  return concat(lines, "\n") .. "\n"
end

return diagram.exporter("rfsm.mermaid", "rfsm2mermaid", draw)
