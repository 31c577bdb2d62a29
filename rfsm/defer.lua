--- Defer: events that wait until the machine has time for them.
--
-- Once this module is loaded, a state may have a list `defer` of events and predicates.
-- Such an event is kept if it comes while the state is active and no transition takes
-- it. After a path, a load or a merge the kept events are looked at. The first one that
-- no active state defers, or that a transition of an active state accepts, is
-- *recalled*: it becomes the only event of an iteration, and the events that came later
-- wait. If nothing takes it and it is still deferred, it keeps its place until the next
-- path.
--
-- @module rfsm.defer
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local match = require "rfsm.shared.match"

local insert, ipairs, min = table.insert, ipairs, math.min
local rawequal, type = rawequal, type

local MOST = 64 -- events that a machine keeps, if `defer` of the state has no `max`

--- The field `_deferred` of a machine.
---@class rfsm.defer.Own
---@field list any[] the events that are kept
---@field at integer the place in the list where the next recall looks first
---@field is_done boolean the events of this iteration were looked at
---@field turn integer|false the iteration in which events were kept last
---@field count integer the number of events kept before that iteration
---@field plan rfsm.defer.Plan|false the latest change of the current events
---@field told table<string, boolean> the warnings that were given
---@field takers rfsm.Transition[]|false those of the machine and its regions

--- What the current events of an iteration become: to be done again after an interrupt.
---@class rfsm.defer.Plan
---@field turn integer the iteration
---@field events any[] the current events
---@field queue any[] the queue
---@field waiting integer how many events were in the queue before
---@field at integer the place of the recalled event in the list
---@field whole any[] the list with the recalled event
---@field rest any[] the list without it; the same list if no event is recalled

local function reset(fsm)
  fsm._again = false
  fsm._deferred = { list = {}, at = 1, is_done = false, turn = false, count = 0,
    plan = false, told = {}, takers = false }
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
  own.takers = own.takers or match.transitions_of(fsm)
  local list = own.list
  if not match.may_be_taken(own.takers, event) then
    warn(fsm, state, event, "'%s' is deferred, but no transition takes it")
  end
  if #list >= (state._defers.max or MOST) then
    return warn(fsm, state, event, "'%s' is lost, too many events are deferred")
  end
  list[#list + 1] = event
  rfsm.note_kept(fsm, event, state, "defers")
  rfsm.report(fsm, "dbg", "DEFERRED", event)
end

-- Returns the recalled event of this iteration with its plan; nil if there is none.
local function recalled(fsm)
  local plan = fsm._deferred.plan
  if not plan or plan.turn ~= fsm._turn or plan.whole == plan.rest then return nil end
  return plan.events[1], plan
end

-- Does a state defer an event that `tr` does not take?
local function is_kept(fsm, event, tr)
  if tr and match.takes(tr.events, event) then return nil end
  return deferrer(fsm, event)
end

-- Puts the recalled event back into its place if it is to be kept again.
local function put_back(fsm, events, tr)
  local event, plan = recalled(fsm)
  if not (plan and match.has(events, event) and match.has(plan.whole, event)
    and is_kept(fsm, event, tr)) then
    return
  end
  fsm._deferred.list = plan.whole
  fsm._deferred.at = plan.at + 1
  rfsm.note_kept(fsm, event)
  rfsm.report(fsm, "dbg", "DEFERRED", event)
end

-- Keeps the events of an iteration that a state defers, except those that `tr` takes.
local function keep_others(fsm, events, tr)
  local own = fsm._deferred
  if own.turn ~= fsm._turn then
    put_back(fsm, events, tr)
    own.count = #own.list
    own.turn = fsm._turn
  end
  local list, event, plan = own.list, recalled(fsm)
  for i = #list, own.count + 1, -1 do list[i] = nil end -- after an interrupt
  local is_back = plan -- or it was dropped meanwhile
  for i = 1, #events do
    local state = is_kept(fsm, events[i], tr)
    if is_back and rawequal(events[i], event) then
      is_back = false
    elseif state then
      keep(fsm, state, events[i])
    end
  end
end

-- Does a transition of an active state name the event, or none?
local function is_accepted(fsm, event)
  local state = fsm
  while state do
    for _, tr in ipairs(state._otrs) do
      if match.is_any(tr) or match.takes(tr.events, event) then return true end
    end
    state = state._actchild
  end
  return false
end

-- Looks for the next event to recall, and returns its place in the list; nil if none is
-- found before the next path.
local function find_recall(fsm)
  local own, last = fsm._deferred, nil
  for at = own.at, fsm._act_leaf and #own.list or 0 do
    local event = own.list[at]
    local is_other = not rawequal(event, last)
    last = event
    if is_other and (not deferrer(fsm, event) or is_accepted(fsm, event)) then
      return at
    end
  end
  own.at = #own.list + 1
end

-- Plans an iteration with the first `count` of the current events only.
local function plan_first(fsm, events, count)
  local own, first, queue = fsm._deferred, {}, {}
  for i = 1, #events do
    local list = i <= count and first or queue
    list[#list + 1] = events[i]
  end
  return { turn = fsm._turn, events = first, queue = match.joined(queue, fsm._intq),
    waiting = #fsm._intq, at = own.at, whole = own.list, rest = own.list }
end

-- Plans the current events: what comes again beside an internal transition is before a
-- recalled event. Returns nil if the events stay.
local function new_plan(fsm, events)
  local own, again = fsm._deferred, fsm._again
  local at = own.list[own.at] ~= nil and find_recall(fsm)
  if not at then return nil end
  if again and again.turn == fsm._turn - 1 then
    return plan_first(fsm, events, again.count)
  end
  local rest = match.joined({}, own.list)
  local event = table.remove(rest, at)
  return { turn = fsm._turn, events = { event }, waiting = #fsm._intq, at = at,
    queue = match.joined(match.joined({}, events), fsm._intq), whole = own.list,
    rest = rest }
end

-- Does what is planned; after an interrupt it is done again, and events that the
-- program has sent meanwhile go to the end of the queue.
local function follow(fsm, plan, events)
  local own, sent = fsm._deferred, fsm._intq
  if sent ~= plan.queue then
    for i = plan.waiting + 1, #sent do plan.queue[#plan.queue + 1] = sent[i] end
    fsm._intq = plan.queue
  end
  for at = #events, 1, -1 do events[at] = plan.events[at] end
  own.list, own.at = plan.rest, plan.at
  for at = 1, #plan.events do events[at] = plan.events[at] end
  if plan.whole ~= plan.rest then rfsm.report(fsm, "dbg", "RECALLED", events[1]) end
end

-- The pre step hook: recalls an event. Only hooks at the place "front" are called
-- before it, such as the hook of timers.
local function recall(fsm, events)
  local own = fsm._deferred
  own.is_done = not fsm._act_leaf
  if not own.plan or own.plan.turn ~= fsm._turn then
    own.plan = new_plan(fsm, events)
  end
  if own.plan then return follow(fsm, own.plan, events) end
end

-- The path hook: keeps events before the path leaves the states that defer them.
local function before_path(fsm, path)
  fsm._deferred.is_done = true
  local first = path[1] -- none if a root without states is entered
  if first and not match.is_any(first) then keep_others(fsm, fsm._curq, first) end
  fsm._deferred.at = 1
end

-- The post step hook. A machine that would recall an event next is not idle.
local function end_iteration(fsm, events)
  if not fsm._deferred.is_done then keep_others(fsm, events) end
  if fsm._outcome == "idle" and find_recall(fsm) then fsm._outcome = "counted" end
end

local function list_kept(fsm)
  local list = fsm._deferred.list
  return list[1] ~= nil and match.joined({}, list) or nil
end

-- Returns what snapshots contain: the list, with the number of events in the queue that
-- come before it. An exploration also keeps where the next recall looks first, and so
-- goes on as the machine does.
local function save(fsm, is_explored)
  local list, again = list_kept(fsm), fsm._again
  local count = list and again and again.turn == fsm._turn and again.count or nil
  if not (count or list and is_explored) then return list end
  return { list = list, again = count, at = is_explored and fsm._deferred.at or nil }
end

local function load(fsm, kept)
  reset(fsm)
  kept = kept or {}
  if kept.again then fsm._again = { turn = fsm._turn, count = kept.again } end
  for i, event in ipairs(kept.list or kept) do fsm._deferred.list[i] = event end
  fsm._deferred.at = kept.at or 1
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
  rfsm.snapshot_hook_add(fsm, "defer", save, load, true)
  rfsm.reaction_hook_add(fsm, list_deferred)
  rfsm.waiting_hook_add(fsm, list_kept)
end

-- Would the machine make this event, or that of the same words at a state?
local function is_made(event)
  return event == "e_done" or match.maker_of(event)
    or match.maker_of(rfsm.event_text(event) .. "@root")
end

-- Returns what `defer` is, if it is no list with perhaps a field `max`.
local function other_than_list(defer)
  if type(defer) ~= "table" then return rfsm.got(defer) end
  local count = #rfsm.sorted_keys(defer) - (defer.max ~= nil and 1 or 0)
  if count == 0 then return "got an empty list" end
  for i = 1, count do
    if defer[i] == nil then return "got a table with holes or keys" end
  end
end

local function problem_of(defer)
  local found = other_than_list(defer)
  if found then return ": list of events expected, " .. found end
  local max = defer.max
  if max ~= nil and not (type(max) == "number" and max >= 1 and max % 1 == 0) then
    return ".max: whole number from 1 expected, " .. rfsm.got(max)
  end
  for i, event in ipairs(defer) do
    if is_made(event) then
      return ("[%d]: '%s' is never deferred, the machine makes it"):format(i,
        rfsm.event_text(event))
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
  state._defers = { max = defer.max }
  for i, event in ipairs(defer) do state._defers[i] = event end
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
    fsm._deferred.takers, fsm._deferred.at = false, 1
  end
  return problems
end)

local defer = {}

local function without(list, is_dropped)
  local others = {}
  for _, event in ipairs(list) do
    if not match.takes(is_dropped, event) then others[#others + 1] = event end
  end
  return others
end

--- Drop the events that a machine keeps.
--
-- Its regions keep what they have.
--
-- @usage
--    rfsm_defer.drop(fsm, "e_job")
--
---@param fsm rfsm.Machine
---@param name? any only this event; a text is also the name of events with data
---@return integer count how many events were dropped
function defer.drop(fsm, name)
  rfsm.check_machine(fsm, "rfsm.defer.drop")
  local own = fsm._deferred
  if not own then return 0 end
  local names = { name, type(name) == "string" and rfsm.named(name) or nil }
  local count, plan = #own.list, own.plan
  own.list = name ~= nil and without(own.list, names) or {}
  own.count = min(own.count, #own.list)
  if #own.list < count then own.at = 1 end
  if plan and plan.whole ~= plan.rest then
    plan.whole = name ~= nil and without(plan.whole, names) or {}
  end
  return count - #own.list
end

return defer
