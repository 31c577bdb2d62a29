--- A machine as a Mermaid state diagram, which many web pages draw, GitHub's too.
--
-- The root gets a frame only when an arrow begins or ends at it: Mermaid draws the
-- better the less is nested.
--
-- @module rfsm2mermaid
-- @license BSD-3-Clause

require "rfsm"
local diagram = require "rfsm_diagram"

local ipairs, rawget, rawset = ipairs, rawget, rawset
local concat = table.concat

local rfsm2mermaid = {}

-- Text ------------------------------------------------------------------------

-- All that might mean something to Mermaid, Markdown or HTML goes by its number.
local function code(character) return "#" .. character:byte() .. ";" end

local function text_of(text)
  text = text:gsub("[^%w %.,_/@%[%]%(%)%-\n\128-\255]", code)
  text = text:gsub("%-%-", code("-") .. code("-"))
  text = text:gsub("%f[%w_]_", code("_")):gsub("_%f[^%w_]", code("_")) -- emphasis
  return (text:gsub("\n", "<br>"))
end

-- The title stands in a front matter of YAML.
local function title_of(text)
  return '"' .. text:gsub('[\\"]', "\\%0"):gsub("\n", " ") .. '"'
end

-- Lines -----------------------------------------------------------------------

local function add(lines, depth, text)
  lines[#lines + 1] = ("  "):rep(depth) .. text
end

-- An initial is [*] where its composite begins; everywhere else that stands for it.
local function end_of(node, is_start)
  if node.kind ~= "initial" then return node.id end
  return is_start and "[*]" or node.parent.id
end

local function add_arrows(lines, depth, composite)
  for _, arrow in ipairs(composite.arrows) do
    local is_start = arrow.src.parent == composite
    local label = arrow.label ~= "" and " : " .. text_of(arrow.label) or ""
    add(lines, depth, end_of(arrow.src, is_start) .. " --> " .. end_of(arrow.tgt)
      .. label)
  end
end

local add_node

local function add_members(lines, depth, composite)
  for _, node in ipairs(composite.nodes) do add_node(lines, depth, node) end
  add_arrows(lines, depth, composite)
end

function add_node(lines, depth, node)
  if node.kind == "initial" then return end
  if node.kind == "connector" then
    return add(lines, depth, "state " .. node.id .. " <<choice>>")
  end
  local head = ('state "%s" as %s'):format(text_of(node.name), node.id)
  if node.kind == "leaf" then return add(lines, depth, head) end
  add(lines, depth, head .. " {")
  add_members(lines, depth + 1, node)
  add(lines, depth, "}")
end

local function draw(chart)
  local lines, root = {}, chart.root
  if chart.title then
    lines = { "---", "title: " .. title_of(chart.title), "---" }
  end
  add(lines, 0, "stateDiagram-v2")
  if root.kind == "leaf" or chart.arrows[1] then
    add_node(lines, 1, root)
    add_arrows(lines, 1, chart)
  else
    add_members(lines, 1, root)
  end
  return concat(lines, "\n") .. "\n"
end

-- Public functions ------------------------------------------------------------

--- Return a machine as the text of a Mermaid diagram.
-- @raise when `fsm` was not initialised
---@param fsm rfsm.Machine
---@param title? string
---@return string mermaid
---@nodiscard
function rfsm2mermaid.encode(fsm, title)
  local chart = diagram.read(fsm, "rfsm2mermaid.encode", title)
  return draw(chart)
end

--- Write a machine as a Mermaid diagram to a file.
-- @raise when `fsm` was not initialised, or the file cannot be written
---@param fsm rfsm.Machine
---@param file string
---@param title? string
function rfsm2mermaid.save(fsm, file, title)
  local chart = diagram.read(fsm, "rfsm2mermaid.save", title)
  diagram.save("rfsm2mermaid.save", file, draw(chart))
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm2mermaid", rfsm2mermaid) end

return rfsm2mermaid
