--- A machine as a PlantUML state diagram.
--
-- @module rfsm2plantuml
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local marsh = require "rfsm_marsh"

local error, ipairs, rawget, rawset = error, ipairs, rawget, rawset
local io, tostring, type = io, tostring, type
local concat = table.concat

local rfsm2plantuml = {}

-- Gives F an identifier of letters, digits and underscores that no other F has.
local function identifier_of(drawing, fqn)
  local id = drawing.ids[fqn]
  if id then return id end
  local plain = fqn:gsub("[^%w]", "_")
  id = plain
  local count = 1
  while drawing.taken[id] do
    count = count + 1
    id = plain .. "_" .. count
  end
  drawing.ids[fqn], drawing.taken[id] = id, true
  return id
end

local function add(drawing, depth, text)
  drawing.lines[#drawing.lines + 1] = ("  "):rep(depth) .. text
end

local function label_of(tr)
  if not tr.events[1] then return "" end
  local texts = {}
  for i, event in ipairs(tr.events) do texts[i] = tostring(event) end
  return " : " .. concat(texts, ", ")
end

local function is_initial(fqn) return fqn:match("[^.]*$") == "initial" end

-- The end of an arrow that is drawn in `composite`: its own `initial` is the pseudo
-- state where the arrow starts there; any other stands for the composite it enters.
local function end_of(drawing, fqn, composite)
  if not is_initial(fqn) then return identifier_of(drawing, fqn) end
  local owner = fqn:match("^(.*)%.initial$")
  return owner == composite and "[*]" or identifier_of(drawing, owner)
end

local function add_transition(drawing, depth, composite, tr)
  add(drawing, depth, end_of(drawing, tr.src, composite) .. " --> "
    .. end_of(drawing, tr.tgt, nil) .. label_of(tr))
end

local add_node

local function add_members(drawing, depth, fqn, node)
  for _, subnode in ipairs(node.subnodes or {}) do
    add_node(drawing, depth, fqn .. "." .. subnode.id, subnode)
  end
  for _, tr in ipairs(node.transitions or {}) do
    add_transition(drawing, depth, fqn, tr)
  end
end

function add_node(drawing, depth, fqn, node)
  local id = identifier_of(drawing, fqn)
  if node.type == "connector" then
    if node.id == "initial" then return end
    return add(drawing, depth, "state " .. id .. " <<choice>>")
  end
  local head = ('state "%s" as %s'):format(node.id:gsub('"', "'"), id)
  if not node.subnodes then return add(drawing, depth, head) end
  add(drawing, depth, head .. " {")
  add_members(drawing, depth + 1, fqn, node)
  add(drawing, depth, "}")
end

local function check_machine(fsm, name)
  if rfsm.is_initialized_root(fsm) then return end
  error("rfsm2plantuml." .. name .. ": initialised fsm expected, got " .. type(fsm), 3)
end

local function draw(fsm, title)
  local drawing = { lines = {}, ids = {}, taken = {} }
  add(drawing, 0, "@startuml")
  if title then add(drawing, 0, "title " .. title) end
  add_node(drawing, 0, "root", marsh.model2tab(fsm))
  add(drawing, 0, "@enduml")
  return concat(drawing.lines, "\n") .. "\n"
end

--- Return a machine as the text of a PlantUML diagram.
-- @raise when `fsm` was not initialised
---@param fsm rfsm.Machine
---@param title? string
---@return string plantuml
---@nodiscard
function rfsm2plantuml.encode(fsm, title)
  check_machine(fsm, "encode")
  return draw(fsm, title)
end

--- Write a machine as a PlantUML diagram to a file.
-- @raise when `fsm` was not initialised, or the file cannot be written
---@param fsm rfsm.Machine
---@param file string
---@param title? string
function rfsm2plantuml.save(fsm, file, title)
  check_machine(fsm, "save")
  local handle, problem = io.open(file, "w")
  if not handle then error("rfsm2plantuml.save: " .. problem, 2) end
  handle:write(draw(fsm, title))
  handle:close()
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm2plantuml", rfsm2plantuml) end

return rfsm2plantuml
