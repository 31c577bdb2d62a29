--- Event memory: the number of times each event occurred while a state was active.
--
-- Once this module is loaded, each state of a machine initialised afterwards has a
-- table `emem`. `state.emem[event]` is the number of times that the event came in an
-- iteration in which the state was active; it is counted before guards are called. An
-- event with data is counted by its name. The count is nil for an event that has never
-- come. When the state is left, the counts are set to 0. The field `emem = false`
-- switches counting off for a state, or, in the root, for the machine.
--
-- A state counts at most a thousand events that no transition names. When one more
-- comes, the counts of these events are removed.
--
-- @module rfsm.emem
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local alphabet = require "rfsm.shared.alphabet"
local order = require "rfsm.shared.order"

local error, ipairs, rawequal = error, ipairs, rawequal
local rawget, rawset, setmetatable, type = rawget, rawset, setmetatable, type

local rfsm_emem = {}

--- The field `_emem` of a machine.
---@class rfsm.emem.Own
---@field is_blocked table<rfsm.State, boolean> states without counts, since a node or
-- transition in them has the name `emem`
---@field others table<rfsm.State, integer> number of counted events not in `declared`
---@field turn integer|false the iteration whose events were counted last
---@field at integer the number of the count of that iteration that was set last
---@field values integer[] the counts of that iteration, so that each is set only once
---@field events any[] the events of that iteration
---@field declared table<any, boolean>|false the events that transitions name; false
-- until they are collected

-- Weak keys: an event that is a table can be collected although it was counted.
local WEAK = { __mode = "k" }

-- The greatest number of events that a state counts though no transition names them.
-- Without this limit, events with data in their names would take ever more memory.
local MOST_OTHERS = 1000

local NONE = {}

local function clear(_, state)
  local emem = state.emem
  for event in order.each(emem or {}) do emem[event] = 0 end
end

local function forget_others(emem, declared)
  for event in order.each(emem) do
    if not declared[event] then emem[event] = nil end
  end
end

-- Returns the set of the events that transitions name, events with data by their names.
local function declared_in(fsm)
  local known = alphabet.of(fsm)
  for _, predicate in ipairs(known.predicates) do
    known.set[rfsm.event_name(predicate) or predicate] = true
  end
  return known.set
end

-- Counts an event that has no count in a state yet.
local function count_new(fsm, state, event)
  local own, emem = fsm._emem, state.emem
  own.declared = own.declared or declared_in(fsm)
  if not own.declared[event] then
    own.others[state] = (own.others[state] or 0) + 1
    if own.others[state] > MOST_OTHERS then
      forget_others(emem, own.declared)
      own.others[state] = 1
    end
  end
  emem[event] = 1
end

-- Sets count number k of an iteration. After an interrupt it is set again.
local function count_event(fsm, state, event, k)
  if type(event) == "table" then event = rfsm.name_with_data(event) or event end
  local own, n = fsm._emem, state.emem[event]
  if k == own.at then
    state.emem[event] = own.values[k]
  elseif event == event then -- not NaN
    own.values[k] = (n or 0) + 1
    own.at = k
    if n then state.emem[event] = n + 1 else count_new(fsm, state, event) end
  end
end

-- Counts the events of an iteration in all active states. Runs in every iteration. If a
-- hook has refused the last one, its events come first, and were counted.
local function count(fsm) -- luacheck: ignore 561 (a call costs time)
  local own, events, state, k = fsm._emem, fsm._curq, fsm._act_leaf and fsm, 0
  local turn, counted = fsm._turn, fsm._outcome == "refused" and own.events or NONE
  if own.turn ~= turn then
    own.at = 0
    own.turn = turn
  end
  while state do
    for i = 1, own.is_blocked[state] and 0 or state.emem and #events or 0 do
      k = k + 1
      local is_due = k >= own.at and not rawequal(counted[i], events[i])
      if is_due then count_event(fsm, state, events[i], k) end
    end
    state = state._actchild
  end
  own.events = events
end

local function wants_emem(obj) return rfsm.is_state(obj) and obj.emem ~= false end

local function has_emem(obj) return wants_emem(obj) and not rfsm.is_fsmobj(obj.emem) end

local function reset(fsm)
  for _, state in ipairs(rfsm.elements(fsm, has_emem)) do clear(fsm, state) end
end

-- No other machine knows an object, so its count cannot be kept.
local IS_KEPT = { string = true, number = true, boolean = true }

-- Returns the counts for a snapshot, by the FQN of each state that has counts.
local function save(fsm)
  local counts = {}
  for _, state in ipairs(rfsm.elements(fsm, has_emem)) do
    for event, n in order.each(state.emem or {}) do -- any order: a copy
      if IS_KEPT[type(event)] then
        counts[state._fqn] = counts[state._fqn] or {}
        counts[state._fqn][event] = n
      end
    end
  end
  return not order.is_empty(counts) and counts or nil
end

local function load(fsm, counts)
  for _, state in ipairs(rfsm.elements(fsm, has_emem)) do
    local emem, kept = state.emem or {}, counts and counts[state._fqn] or {}
    if type(kept) ~= "table" then error("table of counts expected", 0) end
    for _, event in ipairs(rfsm.sorted_keys(emem)) do emem[event] = nil end
    fsm._emem.others[state] = #rfsm.sorted_keys(kept) -- or fewer: some are declared
    for _, event in ipairs(rfsm.sorted_keys(kept)) do
      if type(kept[event]) ~= "number" then error("number of events expected", 0) end
      emem[event] = kept[event]
    end
  end
end

local function prepare_machine(fsm)
  fsm._emem = { is_blocked = {}, others = {}, declared = false, turn = false, at = 0,
    values = {}, events = NONE }
  rfsm.pre_step_hook_add(fsm, rfsm.repeatable(count))
  rfsm.reset_hook_add(fsm, reset)
  rfsm.snapshot_hook_add(fsm, "emem", save, load)
end

local function prepare_state(fsm, state)
  if not fsm._emem then prepare_machine(fsm) end
  if rfsm.is_fsmobj(state.emem) then
    fsm._emem.is_blocked[state] = true
    return rfsm.warn(fsm, "init", ("%s: 'emem' is a %s here, so that "
      .. "rfsm.emem cannot count"):format(rfsm.location_of(state),
      rfsm.kind_of(state.emem)))
  end
  state.emem = setmetatable({}, WEAK)
  rfsm.exit_hook_add(fsm, state, rfsm.repeatable(clear))
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
