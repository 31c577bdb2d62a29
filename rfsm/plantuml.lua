--- A machine as a PlantUML state diagram.
--
-- @module rfsm.plantuml
-- @license BSD-3-Clause

local diagram = require "rfsm.pictures.diagram"

local ipairs = ipairs
local concat, add = table.concat, diagram.add

-- Text: a character that PlantUML may interpret becomes a code such as <U+0022> ---

local function code(character) return ("<U+%04X>"):format(character:byte()) end

local function text_of(text)
  text = text:gsub('[\\"<&~%%]', code):gsub("/'", "/" .. code("'")):gsub("^ +$", code)
  -- Pairs of these characters begin or end bold, italic or other marked text.
  text = text:gsub("([*/_-])%1", function(one) return one .. code(one) end)
  return (text:gsub("\n", "\\n"))
end

-- Lines -----------------------------------------------------------------------

-- Returns the text for an end of an arrow. An initial connector is written as [*] if an
-- arrow of its composite begins there, and otherwise as its composite.
local function end_of(node, is_start)
  if node.kind ~= "initial" then return node.id end
  return is_start and "[*]" or node.parent.id
end

local function add_arrows(lines, depth, composite)
  for _, arrow in ipairs(composite.arrows) do
    local is_start = arrow.src.parent == composite
    local label = arrow.parts[1] and " : " .. text_of(diagram.label_of(arrow)) or ""
    add(lines, depth, end_of(arrow.src, is_start) .. " --> " .. end_of(arrow.tgt)
      .. label)
  end
end

-- Regions are frames, with a dashed line between them.
local function add_members(lines, depth, composite, add_node)
  for i, subnode in ipairs(composite.nodes) do
    if subnode.is_region and i > 1 then add(lines, depth, "||") end
    add_node(lines, depth, subnode)
  end
  add_arrows(lines, depth, composite)
end

local function add_node(lines, depth, node)
  if node.kind == "initial" then return end
  if node.kind == "connector" then
    return add(lines, depth, "state " .. node.id .. " <<choice>>")
  end
  local head = ('state "%s" as %s%s'):format(text_of(node.name), node.id,
    node.mode and " #D6EAF8" or "")
  if node.kind == "composite" then
    add(lines, depth, head .. " {")
    add_members(lines, depth + 1, node, add_node)
    add(lines, depth, "}")
  else
    add(lines, depth, head)
  end
  for _, row in ipairs(node.rows) do
    add(lines, depth, node.id .. " : " .. text_of(row))
  end
end

local function draw(chart)
  local lines = { "@startuml" }
  if chart.title then add(lines, 0, "title " .. text_of(chart.title)) end
  if chart.direction == "LR" then add(lines, 0, "left to right direction") end
  add_node(lines, 0, chart.root)
  add_arrows(lines, 0, chart.top)
  add(lines, 0, "@enduml")
  return concat(lines, "\n") .. "\n"
end

return diagram.exporter("rfsm.plantuml", "rfsm2plantuml", draw)
