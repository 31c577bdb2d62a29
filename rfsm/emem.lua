--- Event memory: the number of times each event occurred while a state was active.
--
-- Once this module is loaded, each state of a machine initialised afterwards has a
-- table `emem`: `state.emem[event]` counts the events of all iterations that found the
-- state active, before guards are called. An event that was never received is nil
-- there. The counts are set to 0 when the state is left. `emem = false` switches this
-- off, for a state or, in the root, for the machine.
--
-- @module rfsm.emem
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, ipairs, next, pairs = error, ipairs, next, pairs
local rawget, rawset, setmetatable, type = rawget, rawset, setmetatable, type
local jit = rawget(_G, "jit")

local rfsm_emem = {}

-- The counts forget an event with its object.
local WEAK = { __mode = "k" }

local function clear(_, state)
  local emem = state.emem
  if not emem then return end
  for event in pairs(emem) do emem[event] = 0 end -- any order: all of them
end

if jit then jit.off(clear) end -- compiled traversals of LuaJIT 2.1 may skip keys

-- This runs in every iteration.
local function count(fsm)
  local events, state = fsm._curq, fsm._act_leaf and fsm
  while state do
    local emem = state.emem
    for i = 1, emem and #events or 0 do
      local event = events[i]
      if event == event then emem[event] = (emem[event] or 0) + 1 end -- no NaN
    end
    state = state._actchild
  end
end

local function has_emem(obj) return rfsm.is_state(obj) and obj.emem ~= false end

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
  return next(counts) and counts
end

local function load(fsm, counts)
  for _, state in ipairs(rfsm.elements(fsm, has_emem)) do
    local emem, kept = state.emem or {}, counts and counts[state._fqn] or {}
    if type(kept) ~= "table" then error("table of counts expected", 0) end
    for _, event in ipairs(rfsm.sorted_keys(emem)) do emem[event] = nil end
    for _, event in ipairs(rfsm.sorted_keys(kept)) do
      if type(kept[event]) ~= "number" then error("number of events expected", 0) end
      emem[event] = kept[event]
    end
  end
end

rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  if fsm.emem == false then return end
  for _, state in ipairs(rfsm.elements(merged or fsm, has_emem)) do
    state.emem = setmetatable({}, WEAK)
    rfsm.exit_hook_add(fsm, state, clear)
    if not fsm._has_emem then
      fsm._has_emem = true
      rfsm.pre_step_hook_add(fsm, count)
      rfsm.reset_hook_add(fsm, reset)
      rfsm.snapshot_hook_add(fsm, "emem", save, load)
    end
  end
end

--- Set the counts of a state to 0.
---@param state rfsm.State
function rfsm_emem.emem_reset(state)
  if not rfsm.is_state(state) or type(state.emem) ~= "table" then
    error("rfsm.emem.emem_reset: state with an event memory expected, got "
      .. type(state), 2)
  end
  clear(nil, state)
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_emem", rfsm_emem) end

return rfsm_emem
