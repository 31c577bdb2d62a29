--- Event memory: the number of times each event occurred while a state was active.
--
-- Once this module is loaded, each state of a machine initialised afterwards has a
-- table `emem`: `state.emem[event]` counts the events of all iterations that found the
-- state active, before guards are called. An event that was never received is nil
-- there. The counts are set to 0 when the state is left. `emem = false` switches this
-- off, for a state or, in the root, for the machine.
--
-- Of the events that no transition names, a state remembers a thousand at most. When
-- one more comes, it forgets them and begins again.
--
-- @module rfsm.emem
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local alphabet = require "rfsm.shared.alphabet"
local order = require "rfsm.shared.order"

local error, ipairs = error, ipairs
local rawget, rawset, setmetatable, type = rawget, rawset, setmetatable, type

local rfsm_emem = {}

--- The field `_emem` of a machine.
---@class rfsm.emem.Own
---@field is_blocked table<rfsm.State, boolean> states with a node named `emem` in them
---@field others table<rfsm.State, integer> counted events that no transition names
---@field declared table<any, boolean>|false the events that transitions name; false
-- until they are collected

-- The counts do not keep an event that is a table from being collected.
local WEAK = { __mode = "k" }

-- So many events that no transition names are counted in a state, because events with
-- data in their names would take ever more memory.
local MOST_OTHERS = 1000

local function clear(_, state)
  local emem = state.emem
  for event in order.each(emem or {}) do emem[event] = 0 end
end

local function forget_others(emem, declared)
  for event in order.each(emem) do
    if not declared[event] then emem[event] = nil end
  end
end

-- Counts an event that has not come before.
local function count_new(fsm, state, event)
  local own, emem = fsm._emem, state.emem
  own.declared = own.declared or alphabet.of(fsm).set
  if not own.declared[event] then
    own.others[state] = (own.others[state] or 0) + 1
    if own.others[state] > MOST_OTHERS then
      forget_others(emem, own.declared)
      own.others[state] = 1
    end
  end
  emem[event] = 1
end

local function count_event(fsm, state, emem, event)
  local n = emem[event]
  if n then
    emem[event] = n + 1
  elseif event == event then -- not NaN
    count_new(fsm, state, event)
  end
end

-- This runs in every iteration.
local function count(fsm)
  local events, state = fsm._curq, fsm._act_leaf and fsm
  local is_blocked = fsm._emem.is_blocked
  while state do
    local emem = not is_blocked[state] and state.emem
    for i = 1, emem and #events or 0 do count_event(fsm, state, emem, events[i]) end
    state = state._actchild
  end
end

local function wants_emem(obj) return rfsm.is_state(obj) and obj.emem ~= false end

local function has_emem(obj) return wants_emem(obj) and not rfsm.is_fsmobj(obj.emem) end

local function reset(fsm)
  for _, state in ipairs(rfsm.elements(fsm, has_emem)) do clear(fsm, state) end
end

-- Snapshots hold the counts of each state in which an event was received.
local function save(fsm)
  local counts = {}
  for _, state in ipairs(rfsm.elements(fsm, has_emem)) do
    for _, event in ipairs(rfsm.sorted_keys(state.emem or {})) do
      counts[state._fqn] = counts[state._fqn] or {}
      counts[state._fqn][event] = state.emem[event]
    end
  end
  return not order.is_empty(counts) and counts or nil
end

local function load(fsm, counts)
  for _, state in ipairs(rfsm.elements(fsm, has_emem)) do
    local emem, kept = state.emem or {}, counts and counts[state._fqn] or {}
    if type(kept) ~= "table" then error("table of counts expected", 0) end
    for _, event in ipairs(rfsm.sorted_keys(emem)) do emem[event] = nil end
    fsm._emem.others[state] = #rfsm.sorted_keys(kept) -- at most
    for _, event in ipairs(rfsm.sorted_keys(kept)) do
      if type(kept[event]) ~= "number" then error("number of events expected", 0) end
      emem[event] = kept[event]
    end
  end
end

local function prepare_machine(fsm)
  fsm._emem = { is_blocked = {}, others = {}, declared = false }
  rfsm.pre_step_hook_add(fsm, rfsm.borrows(count))
  rfsm.reset_hook_add(fsm, reset)
  rfsm.snapshot_hook_add(fsm, "emem", save, load)
end

local function prepare_state(fsm, state)
  if not fsm._emem then prepare_machine(fsm) end
  if rfsm.is_fsmobj(state.emem) then
    fsm._emem.is_blocked[state] = true
    return rfsm.report(fsm, "warn", ("WARNING: %s: 'emem' is a %s here, so that "
      .. "rfsm.emem cannot count"):format(rfsm.location_of(state),
      rfsm.kind_of(state.emem)))
  end
  state.emem = setmetatable({}, WEAK)
  rfsm.exit_hook_add(fsm, state, clear)
end

rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  if fsm.emem == false then return end
  for _, state in ipairs(rfsm.elements(merged or fsm, wants_emem)) do
    prepare_state(fsm, state)
  end
  if fsm._emem then fsm._emem.declared = false end
end

--- Set the counts of a state to 0.
---@param state rfsm.State
function rfsm_emem.emem_reset(state)
  if not rfsm.is_state(state) or type(state.emem) ~= "table"
    or rfsm.is_fsmobj(state.emem) then
    error("rfsm.emem.emem_reset: state with an event memory expected, got "
      .. type(state), 2)
  end
  clear(nil, state)
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_emem", rfsm_emem) end

return rfsm_emem
