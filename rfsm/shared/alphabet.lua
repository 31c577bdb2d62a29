--- The alphabet of machines: the events that their transitions name.
--
-- @module rfsm.shared.alphabet
-- @license BSD-3-Clause

local match = require "rfsm.shared.match"
local rfsm = require "rfsm"

local ipairs, type = ipairs, type

local alphabet = {}

--- The events that a machine knows.
---@class rfsm.Alphabet
---@field list any[] events that transitions name, in the order of the tree
---@field reactions any[] further events, to which extensions react
---@field predicates function[] predicates among the events of both
---@field set table<any, boolean> all events and predicates of the three lists
---@field takes_any boolean does a state have a transition that any event triggers?

local function add(known, list, event)
  if known.set[event] or event ~= event then return end -- NaN is no event
  list[#list + 1], known.set[event] = event, true
end

local function add_all(known, list, events)
  for _, event in ipairs(events) do
    add(known, type(event) == "function" and known.predicates or list, event)
  end
end

local function add_machine(known, fsm)
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    if match.begins_on_any(tr) then known.takes_any = true end
    add_all(known, known.list, tr.events or {})
  end
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    add_all(known, known.reactions, rfsm.reactions(fsm, state))
  end
end

local function collect(machines)
  local known = { list = {}, reactions = {}, predicates = {}, set = {},
    takes_any = false }
  for _, at in ipairs(machines) do add_machine(known, at.machine) end
  return known
end

--- Collect the events that the transitions of a machine name.
function alphabet.of(fsm) return collect { { machine = fsm } } end

--- Collect the events that the transitions of a machine and its regions name.
function alphabet.of_all(fsm) return collect(rfsm.machines(fsm)) end

--- Does a machine know an event, or may one of its predicates accept it?
---@param known rfsm.Alphabet
---@param event any
---@return boolean
function alphabet.has(known, event)
  return known.set[event] or match.may_accept(known.predicates, event)
end

--- Does a machine take an event only with data?
---@param fsm rfsm.Machine
---@param event string
---@return boolean
function alphabet.needs_data(fsm, event)
  local known = alphabet.of_all(fsm)
  return not (known.takes_any or known.set[event]) and known.set[rfsm.named(event)]
    or false
end

return alphabet
