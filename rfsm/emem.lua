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

local error, getmetatable, pairs, rawget, rawset = error, getmetatable, pairs, rawget,
  rawset
local setmetatable, type = setmetatable, type
local insert = table.insert

local rfsm_emem = {}

-- Keys: what to set to 0 in a table of counts ---------------------------------
--
-- `pairs` tells, but LuaJIT does not compile it. So the metatable of the counts lists
-- the keys, and notes each new one, whoever writes it. Objects are never listed: the
-- counts forget an event with its object. Where there are any, in a table that a user
-- put there and in one that he gave a metatable, it is `pairs`.

--- The metatable of a table of counts; the keys are in its array part.
---@class rfsm.emem.Keys
---@field n integer|false how many are listed; false when an object is among the keys
---@field limit integer how many may be, before those that are gone are sorted out

local IS_LISTED = { string = true, number = true, boolean = true }

local function list_keys(emem, keys)
  local n, has_objects = 0, false
  for key in pairs(emem) do -- any order: all of them
    if IS_LISTED[type(key)] then
      n = n + 1
      keys[n] = key
    else
      has_objects = true
    end
  end
  keys.n, keys.limit = not has_objects and n, 2 * n + 4
end

-- Writes a key that is not in the counts.
local function note(emem, key, value)
  if key == nil or key ~= key then
    error("table index is " .. (key == nil and "nil" or "NaN"), 2)
  end
  rawset(emem, key, value)
  local keys = getmetatable(emem)
  local n = keys.n
  if not n then return end
  if n == keys.limit or not IS_LISTED[type(key)] then return list_keys(emem, keys) end
  keys.n, keys[n + 1] = n + 1, key
end

local function new_keys()
  return { __mode = "k", __newindex = note, n = 0, limit = 4 }
end

-- Run -------------------------------------------------------------------------

local function count_first(emem, event)
  if event == event then emem[event] = 1 end -- no NaN
end

-- Counts the events from the third on.
local function count_rest(emem, events)
  for i = 3, #events do
    local event = events[i]
    local before = emem[event]
    if before then emem[event] = before + 1 else count_first(emem, event) end
  end
end

-- The states from the root to `leaf`, noted in it.
local function line_of(leaf)
  local line, state = {}, leaf
  while state do
    insert(line, 1, state)
    state = state._parent ~= state and state._parent
  end
  leaf._emem_line = line
  return line
end

-- Counts the events for the states of `line` from number `i` on. Mostly there are one
-- or two events, one of them an e_done; loops would keep LuaJIT from compiling a step
-- whole.
local function count_in(line, i, events, first, second)
  local state = line[i]
  if not state then return end
  local emem = state.emem
  if emem then
    local before = emem[first]
    if before then emem[first] = before + 1 else count_first(emem, first) end
    if second ~= nil then
      before = emem[second]
      if before then emem[second] = before + 1 else count_first(emem, second) end
      if events[3] ~= nil then count_rest(emem, events) end
    end
  end
  return count_in(line, i + 1, events, first, second)
end

-- This runs in every iteration, hence the fields instead of the functions that read
-- them.
local function count(fsm)
  local events, leaf = fsm._curq, fsm._act_leaf
  local first = events[1]
  if first == nil or not leaf then return end
  return count_in(leaf._emem_line or line_of(leaf), 1, events, first, events[2])
end

local function forget_unlisted(emem, keys)
  for key in pairs(emem) do emem[key] = 0 end -- any order: all of them
  if keys and getmetatable(emem) == keys then list_keys(emem, keys) end
end

local function forget(_, state)
  local emem, keys = state.emem, state._emem_keys
  if not emem then return end
  local n = keys and getmetatable(emem) == keys and keys.n
  if not n then return forget_unlisted(emem, keys) end
  for i = 1, n do
    local key = keys[i]
    if emem[key] ~= nil then emem[key] = 0 end
  end
end

local function reset(fsm)
  forget(fsm, fsm)
  rfsm.mapfsm(function(state) forget(fsm, state) end, fsm, rfsm.is_state)
end

-- Prepare ---------------------------------------------------------------------

-- The first state that counts makes the machine do so.
local function prepare_state(fsm, state)
  if state.emem == false then return end
  if not fsm._emem then
    fsm._emem = true
    rfsm.pre_step_hook_add(fsm, count)
    rfsm.reset_hook_add(fsm, reset)
  end
  state._emem_keys = new_keys()
  state.emem = setmetatable({}, state._emem_keys)
  rfsm.exit_hook_add(fsm, state, forget)
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
  if not rfsm.is_state(state) or type(state.emem) ~= "table" then
    error("rfsm.emem.emem_reset: state with an event memory expected, got "
      .. type(state), 2)
  end
  forget(nil, state)
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_emem", rfsm_emem) end

return rfsm_emem
