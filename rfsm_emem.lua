--- Event memory: how often each event came while a state was active.
--
-- Once this module is loaded, each state of a machine initialised afterwards has a
-- table `emem`: `state.emem[event]` counts the events of all iterations that found the
-- state active, before guards are asked. An event that never came is nil there. The
-- counts are set to 0 when the state is left. `emem = false` in a state, or in the root
-- for the whole machine, does without.
--
-- @module rfsm_emem
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, pairs, rawget, rawset, setmetatable, type = error, pairs, rawget, rawset,
  setmetatable, type

local rfsm_emem = {}

-- Events that are objects are forgotten with the object.
local WEAK = { __mode = "k" }

-- Counts the events for each active state. This runs in every iteration, hence the
-- fields instead of the functions that read them.
local function count(fsm, events)
  if events[1] == nil or fsm._mode == "inactive" then return end
  local n, state = #events, fsm
  repeat
    local emem = state.emem
    if emem then
      for i = 1, n do
        local event = events[i]
        local before = emem[event]
        if before then
          emem[event] = before + 1
        elseif event == event then -- no NaN
          emem[event] = 1
        end
      end
    end
    state = state._actchild
  until not state
end

local function forget(emem)
  for event in pairs(emem) do emem[event] = 0 end -- any order: all of them
end

local function leave_state(_, state)
  if state.emem then forget(state.emem) end
end

local function reset(fsm)
  leave_state(fsm, fsm)
  rfsm.mapfsm(function(state) leave_state(fsm, state) end, fsm, rfsm.is_state)
end

-- The first state that counts makes the machine do so.
local function prepare_state(fsm, state)
  if state.emem == false then return end
  if not fsm._emem then
    fsm._emem = true
    rfsm.pre_step_hook_add(fsm, count)
    rfsm.reset_hook_add(fsm, reset)
  end
  state.emem = setmetatable({}, WEAK)
  rfsm.exit_hook_add(fsm, state, leave_state)
end

local function prepare(fsm, merged)
  local obj = merged or fsm
  if fsm.emem == false or not rfsm.is_state(obj) then return end
  prepare_state(fsm, obj)
  rfsm.mapfsm(function(state) prepare_state(fsm, state) end, obj, rfsm.is_state)
end

rfsm.preproc[#rfsm.preproc + 1] = prepare

--- Set the counts of a state to 0.
---@param state rfsm.State
function rfsm_emem.emem_reset(state)
  local emem = rfsm.is_state(state) and rawget(state, "emem")
  if type(emem) ~= "table" then
    error("rfsm_emem.emem_reset: state with an event memory expected, got "
      .. type(state), 2)
  end
  forget(emem)
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_emem", rfsm_emem) end

return rfsm_emem
