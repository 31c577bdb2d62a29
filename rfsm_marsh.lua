--- A machine as plain tables: what every exporter reads.
--
-- All lists are in a fixed order: nodes sorted by name, transitions as `rfsm.mapfsm`
-- meets them.
--
-- @module rfsm_marsh
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, rawget, rawset, setmetatable = error, rawget, rawset, setmetatable
local tostring, type = tostring, type

local rfsm_marsh = {}

--- A transition as a plain table.
---@class rfsm_marsh.Transition
---@field type "transition"
---@field src string F
---@field tgt string F; a composite stands as its `initial`
---@field pn? number
---@field events any[] empty when any event triggers

--- A node as a plain table; only a composite has the two lists.
---@class rfsm_marsh.Node
---@field id string
---@field type "state"|"connector"
---@field transitions? rfsm_marsh.Transition[]
---@field subnodes? rfsm_marsh.Node[]

local function check_machine(fsm, name)
  if rfsm.is_initialized_root(fsm) then return end
  error("rfsm_marsh." .. name .. ": initialised fsm expected, got " .. type(fsm), 3)
end

local function transition_table(tr)
  local events = {}
  for i = 1, tr.events and #tr.events or 0 do events[i] = tr.events[i] end
  return {
    type = "transition", src = tr.src._fqn, tgt = tr.tgt._fqn, pn = tr.pn,
    events = events,
  }
end

local function node_table(node)
  if rfsm.is_conn(node) then return { id = node._id, type = "connector" } end
  if rfsm.is_leaf(node) then return { id = node._id, type = "state" } end
  return {
    id = node._id, type = "state",
    transitions = rfsm.mapfsm(transition_table, node, rfsm.is_trans, 1),
    subnodes = rfsm.mapfsm(node_table, node, rfsm.is_node, 1),
  }
end

--- Return the structure of a machine.
-- @raise when `fsm` was not initialised
---@param fsm rfsm.Machine
---@return rfsm_marsh.Node root
---@nodiscard
function rfsm_marsh.model2tab(fsm)
  check_machine(fsm, "model2tab")
  return node_table(fsm)
end

-- JSON knows strings, finite numbers and booleans; other events become their text.
local function plain_event(event)
  local kind = type(event)
  if kind == "number" and event - event == 0 then return event end
  return kind ~= "boolean" and tostring(event) or event
end

-- Marks a list, so that an empty one is no object.
local function as_array(list) return setmetatable(list, { __jsontype = "array" }) end

local function mark_lists(node)
  local transitions, subnodes = node.transitions, node.subnodes
  if not transitions then return node end
  for i = 1, #transitions do
    local events = as_array(transitions[i].events)
    for j = 1, #events do events[j] = plain_event(events[j]) end
  end
  for i = 1, #subnodes do mark_lists(subnodes[i]) end
  as_array(transitions)
  as_array(subnodes)
  return node
end

--- Return the structure of a machine as dkjson should write it.
--
-- As `model2tab`, but the lists are marked as arrays, and events that JSON does not
-- know are their text.
--
-- @raise when `fsm` was not initialised
---@param fsm rfsm.Machine
---@return rfsm_marsh.Node root
---@nodiscard
function rfsm_marsh.jsontab(fsm)
  check_machine(fsm, "jsontab")
  return mark_lists(node_table(fsm))
end

--- Return what is active in a machine.
-- @raise when `fsm` was not initialised
---@param fsm rfsm.Machine
---@return string|false fqn F of the active leaf, false when there is none
---@return string|false mode
---@return false path
---@nodiscard
function rfsm_marsh.actinfo2tab(fsm)
  check_machine(fsm, "actinfo2tab")
  local leaf = fsm._act_leaf
  if not leaf then return false, false, false end
  return leaf._fqn, rfsm.get_sta_mode(leaf), false
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_marsh", rfsm_marsh) end

return rfsm_marsh
