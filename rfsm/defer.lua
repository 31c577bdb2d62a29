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

--- The field `_deferred` of a machine.
---@class rfsm.defer.Own
---@field list any[] the events that are kept
---@field is_done boolean the events of this iteration were looked at
---@field checked rfsm.State|false the leaf in which nothing was to be recalled
---@field turn integer|false the iteration in which events were kept last
---@field count integer the number of events kept before that iteration
---@field plan table|false the latest recall, to be done again after an interrupt
---@field told table<string, boolean> the warnings that were given
---@field known rfsm.Alphabet|false the alphabet of the machine

local function reset(fsm)
  fsm._deferred = { list = {}, is_done = false, checked = false, turn = false,
    count = 0, plan = false, told = {}, known = false }
end

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
  local own = fsm._deferred
  own.known = own.known or alphabet.of_all(fsm)
  local known, list = own.known, own.list
  if not (known.takes_any or known.predicates[1] or match.has(known.list, event)) then
    warn(fsm, state, event, "'%s' is deferred, but no transition takes it")
  end
  if #list >= (state._defers.max or MOST) then
    return warn(fsm, state, event, "'%s' is lost, too many events are deferred")
  end
  list[#list + 1] = event
  rfsm.note_kept(fsm, event, state, "defers")
  rfsm.report(fsm, "dbg", "DEFERRED", event)
end

-- Keeps the events of an iteration that a state defers, except those that `tr` takes.
local function keep_others(fsm, events, tr)
  local own, list = fsm._deferred, fsm._deferred.list
  if own.turn ~= fsm._turn then
    own.count = #list
    own.turn = fsm._turn
  end
  for i = #list, own.count + 1, -1 do list[i] = nil end -- after an interrupt
  for _, event in ipairs(events) do
    local state = not (tr and match.takes(tr.events, event)) and deferrer(fsm, event)
    if state then keep(fsm, state, event) end
  end
end

-- Does a recall; after an interrupt it is done again, and events that the program has
-- sent meanwhile go to the end of the queue.
local function recall_by(fsm, plan, events)
  local sent = fsm._intq
  if sent ~= plan.queue then
    for i = plan.waiting + 1, #sent do plan.queue[#plan.queue + 1] = sent[i] end
    fsm._intq = plan.queue
  end
  for at = #events, 2, -1 do events[at] = nil end
  events[1] = plan.event
  fsm._deferred.list = plan.rest
  rfsm.report(fsm, "dbg", "RECALLED", plan.event)
end

-- The pre step hook: recalls the first event that no state defers any more. Only hooks
-- at the place "front" are called before it, such as the hook of timers.
local function recall(fsm, events)
  local own = fsm._deferred
  own.is_done = not fsm._act_leaf
  if own.plan and own.plan.turn == fsm._turn then
    return recall_by(fsm, own.plan, events)
  elseif own.checked and own.checked == fsm._act_leaf then
    return
  end
  for i, event in ipairs(own.list) do
    if not deferrer(fsm, event) then
      local rest = match.joined({}, own.list)
      table.remove(rest, i)
      own.plan = { turn = fsm._turn, event = event, rest = rest, waiting = #fsm._intq,
        queue = match.joined(match.joined({}, events), fsm._intq) }
      return recall_by(fsm, own.plan, events)
    end
  end
  own.checked = fsm._act_leaf
end

-- The path hook: keeps events before the path leaves the states that defer them.
local function before_path(fsm, path)
  fsm._deferred.is_done, fsm._deferred.checked = true, false
  local first = path[1] -- none if a root without states is entered
  if first and not match.is_any(first) then keep_others(fsm, fsm._curq, first) end
end

local function end_iteration(fsm, events)
  if not fsm._deferred.is_done then keep_others(fsm, events) end
end

local function list_kept(fsm)
  local list = fsm._deferred.list
  return list[1] ~= nil and match.joined({}, list) or nil
end

local function load(fsm, kept)
  reset(fsm)
  for i, event in ipairs(kept or {}) do fsm._deferred.list[i] = event end
end

-- The reaction hook: lists the events that a state defers.
local function list_deferred(_, state, events)
  if not (events and state._defers) then return state._defers, "defer" end
  local list = {}
  for _, event in ipairs(events) do
    local is_deferred = not match.maker_of(event) and match.takes(state._defers, event)
    if is_deferred then list[#list + 1] = event end
  end
  return list, "defers"
end

local function prepare_machine(fsm)
  reset(fsm)
  rfsm.pre_step_hook_add(fsm, rfsm.repeatable(recall), "before")
  rfsm.path_hook_add(fsm, rfsm.repeatable(before_path))
  rfsm.post_step_hook_add(fsm, rfsm.repeatable(end_iteration), "before")
  rfsm.reset_hook_add(fsm, reset)
  rfsm.snapshot_hook_add(fsm, "defer", list_kept, load, true)
  rfsm.reaction_hook_add(fsm, list_deferred)
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
  if fsm._deferred then -- merged: there are more events
    fsm._deferred.known, fsm._deferred.checked = false, false
  end
  return problems
end)

return {}
