--- Defer: events that wait until the machine has time for them.
--
-- Once this module is loaded, a state may have a list `defer` of events and predicates.
-- Such an event is kept if it comes while the state is active and no transition takes
-- it. When no active state defers it any more, it is *recalled*: it becomes the only
-- event of an iteration, and the events that came later wait.
--
-- @module rfsm.defer
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local alphabet = require "rfsm.shared.alphabet"
local match = require "rfsm.shared.match"

local insert, ipairs, type = table.insert, ipairs, type

local MOST = 64 -- events that a machine keeps, if `defer` of the state has no `max`

-- A machine keeps its deferred events in the list `_deferred`. Other fields of that
-- table: `is_done`, whether the events of this iteration were looked at; `told`, the
-- warnings that were given; `known`, the alphabet of the machine.
local function reset(fsm) fsm._deferred = { is_done = false, told = {} } end

local function warn(fsm, state, event, text)
  local told, name = fsm._deferred.told, rfsm.event_text(event)
  if told[text] then return end
  told[text] = true
  rfsm.report(fsm, "warn", ("WARNING: %s: " .. text):format(
    rfsm.location_of(state, "defer"), name))
end

-- Returns the outermost active state that defers an event; no state defers events that
-- the machine makes.
local function deferrer(fsm, event)
  local state = not match.maker_of(event) and fsm._act_leaf and fsm
  while state and not (state._defers and match.takes(state._defers, event)) do
    state = state._actchild
  end
  return state
end

local function keep(fsm, state, event)
  local own, known = fsm._deferred, fsm._deferred.known or alphabet.of_all(fsm)
  own.known = known
  if not (known.takes_any or known.predicates[1] or match.has(known.list, event)) then
    warn(fsm, state, event, "'%s' is deferred, but no transition takes it")
  end
  if #own >= (state._defers.max or MOST) then
    return warn(fsm, state, event, "'%s' is lost, too many events are deferred")
  end
  own[#own + 1] = event
  rfsm.report(fsm, "dbg", "DEFERRED", event)
end

-- Keeps the events of an iteration that a state defers, except those that `tr` takes.
local function keep_others(fsm, events, tr)
  for _, event in ipairs(events) do
    local state = not (tr and match.takes(tr.events, event)) and deferrer(fsm, event)
    if state then keep(fsm, state, event) end
  end
end

-- The pre step hook: recalls the first event that no state defers any more. Only hooks
-- at the place "front" are called before it, such as the hook of timers.
local function recall(fsm, events)
  local own = fsm._deferred
  own.is_done = not fsm._act_leaf
  for i, event in ipairs(own) do
    if not deferrer(fsm, event) then
      table.remove(own, i)
      fsm._intq = match.joined(match.joined({}, events), fsm._intq)
      for at = #events, 2, -1 do events[at] = nil end
      events[1] = event
      return rfsm.report(fsm, "dbg", "RECALLED", event)
    end
  end
end

-- The path hook: keeps events before the path leaves the states that defer them.
local function before_path(fsm, path)
  fsm._deferred.is_done = true
  local first = path[1] -- none if a root without states is entered
  if first and not match.is_any(first) then keep_others(fsm, fsm._curq, first) end
end

local function end_iteration(fsm, events)
  if not fsm._deferred.is_done then keep_others(fsm, events) end
end

local function list_kept(fsm)
  return fsm._deferred[1] ~= nil and match.joined({}, fsm._deferred) or nil
end

local function load(fsm, kept)
  reset(fsm)
  for i, event in ipairs(kept or {}) do fsm._deferred[i] = event end
end

local function prepare_machine(fsm)
  reset(fsm)
  rfsm.pre_step_hook_add(fsm, rfsm.borrows(recall), "before")
  rfsm.path_hook_add(fsm, before_path)
  rfsm.post_step_hook_add(fsm, rfsm.borrows(end_iteration), "before")
  rfsm.reset_hook_add(fsm, reset)
  rfsm.snapshot_hook_add(fsm, "defer", list_kept, load, true)
  rfsm.reaction_hook_add(fsm, function(_, state) return state._defers end)
  rfsm.waiting_hook_add(fsm, list_kept)
end

local function problem_of(defer)
  if type(defer) ~= "table" or defer[1] == nil then
    return ": list of events expected, " .. rfsm.got(defer)
  end
  local max = defer.max
  if max ~= nil and not (type(max) == "number" and max >= 1 and max % 1 == 0) then
    return ".max: whole number from 1 expected, " .. rfsm.got(max)
  end
  for i, event in ipairs(defer) do
    if event == "e_done" or match.maker_of(event) then
      return ("[%d]: '%s' is never deferred, the machine makes it"):format(i, event)
    end
  end
end

-- Prepares a state with a list `defer`, or returns the problem of the list. The list is
-- read from the model, since the machine has copies of events that are tables.
local function prepare_state(fsm, state)
  local defer = rfsm.model_of(state).defer
  local problem = problem_of(defer)
  if problem then return rfsm.location_of(state, "defer") .. problem end
  if not fsm._deferred then prepare_machine(fsm) end
  state._defers = defer
end

local function has_defer(obj)
  return rfsm.is_state(obj) and obj.defer ~= nil and not rfsm.is_fsmobj(obj.defer)
end

-- This preproc function is the first one, so that its hook is called before the hooks
-- that count events.
insert(rfsm.preproc, 1, function(fsm, merged)
  local problems = {}
  for _, state in ipairs(rfsm.elements(merged or fsm, has_defer)) do
    problems[#problems + 1] = prepare_state(fsm, state)
  end
  if fsm._deferred then fsm._deferred.known = nil end -- merged: there are more events
  return problems
end)

return {}
