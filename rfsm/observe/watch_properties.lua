--- Judge properties of a running machine. Explorations judge the same properties.
--
-- Monitors look at the end of each iteration, and at the states that it enters and
-- leaves again. Their clocks use the time of the machine: a clock is started when an
-- iteration is over, and is read when one begins, before the timers of the machine.
--
-- An interrupt may cut each hook short. So a hook is called again, and what it notes
-- counts by one assignment: a note in the log, or the next step.
--
-- @module rfsm.observe.watch_properties
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local alphabet = require "rfsm.shared.alphabet"
local clock = require "rfsm.clock"
local match = require "rfsm.shared.match"
local monitors = require "rfsm.explore.monitors"
local observers = require "rfsm.explore.observers"
local opts = require "rfsm.shared.options"
local location = require "rfsm.shared.location"
local properties = require "rfsm.explore.properties"
local order = require "rfsm.shared.order"
local stream = require "rfsm.observe.stream"

local error, ipairs, pcall, type = error, ipairs, pcall, type
local concat, remove = table.concat, table.remove
local kinds = monitors.kinds

local watch_properties = {}

--- A property of a machine that is watched.
---@class rfsm_checks.Monitor
---@field name string
---@field property rfsm_checks.Property
---@field event any the event that the property means
---@field state string of the monitor: a word such as "first", for `monitors.look`
---@field clocks number[] the times at which the clocks were started
---@field observer? rfsm_checks.Observer
---@field is_in_scope boolean does the condition of the property hold before the step?
---@field is_told boolean the last step broke the property, and was reported

--- A machine that is watched, and the state of the watch.
---@class rfsm_checks.Watched
---@field fsm rfsm.Machine
---@field active fun(name: string): boolean is the state with this path active?
---@field is_timed boolean does a property have a time limit?
---@field now number the time at which the iteration began, in seconds
---@field leaf rfsm.State|false the active leaf when the iteration began
---@field snapshot fun(): fun(name: string): boolean `active`, whose answers stay
---@field hears table<any, true> the words that observers hear
---@field hears_more boolean is there such a word?
---@field done table<string, true> the events e_done@F that the machine can make
---@field path_of table<table, string> transition -> its path
---@field stream rfsm.observe.Stream
---@field step rfsm_checks.WatchedStep

--- What is known when an iteration ends, and is noted until the next one ends.
---@class rfsm_checks.WatchedStep
---@field monitors rfsm_checks.Monitor[]
---@field phase "new"|"begun"|"over" of the iteration
---@field forwarded any[] events of earlier iterations that belong to this step
---@field log rfsm_checks.WatchedNote[] what the step has done
---@field trace { text: string, at: number|false }[] the latest steps
---@field reports string[] what is to be reported

--- A note of a hook. The same note twice is that of a hook that was called again.
---@class rfsm_checks.WatchedNote
---@field at table the entry of `rfsm.machines`
---@field kind "began"|"taken"|"entered"|"left"|"passed"
---@field subject any state, or first transition of the path
---@field words rfsm_checks.Heard[] the field `passed` is the state of a word "pass"
---@field has_events? boolean the events of the iteration are in the words
---@field moment? function what was active when a state was entered that this step may
-- leave again
local Watched = {}
Watched.__index = Watched

local NOTHING = {}

local LONG = 10 -- how many steps a report lists at most

local MARGIN = 1e-6 -- seconds; larger than the rounding error of a difference of times

local function read_clock(own)
  if not own.is_timed then return 0 end
  local time, failure = clock.read(own.fsm, true)
  return time or error(failure, 0)
end

-- Returns two functions. `active(path)` returns whether a state is active now.
-- `snapshot()` returns a function like it, whose answers stay as they are at that call.
local function views_of(fsm)
  local states = {}
  for at, state in location.each(fsm, rfsm.is_state) do
    states[location.path(state, at.prefix)] = state
  end
  return function(name)
    if not states[name] then
      location.refuse_name(name, "state", rfsm.sorted_keys(states))
    end
    return states[name]._mode ~= "inactive"
  end, function()
    local is_active = {}
    for path, state in order.each(states) do -- any order: a set
      is_active[path] = state._mode ~= "inactive"
    end
    return function(name) return is_active[name] end
  end
end

-- Is the machine idle until an event comes? No event waits, and no doo goes on.
local function is_idle(fsm)
  return rfsm.check_events(fsm) == 0 and fsm._act_leaf._mode == "done"
end

-- Is no timer of the machine armed? If its clock fails, that is not known.
local function has_no_timer(fsm)
  local left, failure = clock.until_timer(fsm)
  local is_cut = failure ~= nil and clock.read(fsm, true) and clock.read(fsm, false)
  if is_cut then error(failure, 0) end -- of a host: the clock works
  return left == nil and failure == nil
end

-- Do all events come from the engine itself, as e_done does?
local function are_internal(events)
  for i = 1, #events do
    if match.maker_of(events[i]) ~= "engine" then return false end
  end
  return true
end

-- Returns the latest steps with this one, if an event came from outside or the leaf has
-- changed.
local function trace_with(own, old, events)
  local leaf, trace = own.fsm._act_leaf, {}
  if leaf == own.leaf and are_internal(events) then return old end
  local texts = order.map(events, rfsm.event_text, true)
  local text = (texts[1] and concat(texts, ", ") or "no event") .. ": "
    .. (own.leaf and own.leaf._fqn .. " -> " or "") .. leaf._fqn
  for i = #old < LONG and 1 or 2, #old do trace[#trace + 1] = old[i] end
  trace[#trace + 1] = { text = text, at = own.is_timed and own.now }
  return trace
end

local function seconds(wait) return rfsm.number_text(wait, "%.3g") .. " s" end

local function report_of(own, monitor, trace)
  local lines, before = {}, trace[1] and trace[1].at
  for i, step in ipairs(trace) do
    local wait = step.at and step.at - before or 0
    lines[i] = ("  %d. %s%s"):format(i, wait > 0 and "+" .. seconds(wait) .. " " or "",
      step.text)
    before = step.at
  end
  local wait = own.is_timed and before and own.now - before or 0
  if wait > 0 then lines[#lines + 1] = "  and then " .. seconds(wait) end
  return ("property '%s' does not hold\n%s"):format(monitor.name, concat(lines, "\n"))
end

-- Returns how many clocks of a monitor have expired.
local function count_expired(own, monitor)
  local expired = 0
  for _, began in ipairs(monitor.clocks) do
    if own.now - began > monitor.property.seconds + MARGIN then
      expired = expired + 1
    end
  end
  return expired
end

-- Sets the clocks of a monitor. `numbers` has the index of each clock that stays, and 0
-- for each new clock.
local function set_clocks(monitor, numbers, now)
  local clocks = {}
  for i, number in ipairs(numbers) do clocks[i] = monitor.clocks[number] or now end
  monitor.clocks = clocks
end

-- Returns the event that a property means. It may be only the name of an event with
-- data, if no transition has a text of that name.
local function meant(set, event)
  local is_name = type(event) == "string" and not set[event] and set[rfsm.named(event)]
  return match.example_of(is_name and rfsm.named(event) or event)
end

local function has_come(monitor, events)
  return match.has(events, monitor.property.event)
    or rfsm.name_with_data(monitor.event) ~= nil and order.any(events, function(other)
      return match.example_of(other) == monitor.event
    end)
end

-- Makes a monitor look at the end of a step, or at a state that the step only passes.
local function look_at(own, step, monitor, look, events)
  local property = monitor.property
  look.came = property.event ~= nil and own.leaf
    and has_come(monitor, events) or false
  look.came = look.came and monitor.is_in_scope
  look.expired, look.count = count_expired(own, monitor), #monitor.clocks
  look.observer, look.heard = monitor.observer, step.heard
  local state, clocks = monitors.look(property, monitor.state, look)
  if clocks then set_clocks(monitor, clocks, look.now) end
  local is_violated = state == "violated"
  monitor.state = is_violated and (kinds[property.kind].next or "first") or state
  if is_violated and not monitor.is_told then
    step.reports[#step.reports + 1] = report_of(own, monitor, step.trace)
  end
  monitor.is_told = is_violated
end

-- Appends a note to the log, unless it is the last one already.
local function note(own, at, kind, subject, fields)
  local log = own.step.log
  local last = log[#log]
  if last and last.at == at and last.kind == kind and last.subject == subject then
    return
  end
  fields.at, fields.kind, fields.subject = at, kind, subject
  fields.words = fields.words or NOTHING
  log[#log + 1] = fields
end

local function begin_iteration(own, at)
  if own.hears_more then note(own, at, "began", nil, {}) end
  if at.machine ~= own.fsm then return end
  local step = own.step
  own.now, own.leaf = read_clock(own), own.fsm._act_leaf or false
  local is_unseen = step.phase == "new" and own.leaf -- what was before is not known
  for _, monitor in ipairs(step.forwarded[1] == nil and step.monitors or NOTHING) do
    local kind, scope = kinds[monitor.property.kind], monitor.property.scope
    if is_unseen then monitor.state = kind.unseen or kind.next or "first" end
    monitor.is_in_scope = scope == nil or monitors.holds(scope, own.active)
  end
  step.phase = "begun"
end

-- Appends a word if an observer hears it; `passed` is the state of a word "pass".
local function add_word(own, words, word, passed)
  if not own.hears[word] then return end
  words[#words + 1] = { word = word, active = own.snapshot(), passed = passed }
end

-- Are the events of this iteration in the log?
local function has_events(log)
  for i = #log, 1, -1 do
    if log[i].kind == "began" or log[i].has_events then return log[i].has_events end
  end
end

-- Appends the events of an iteration once: before a path is taken, or at its end. Of a
-- region, these are the events that it makes and that it alone knows.
local function add_heard(own, at, words, events)
  if has_events(own.step.log) or not own.leaf then return nil end
  local is_region = at.machine ~= own.fsm
  for i = 1, #events do
    local event = events[i]
    local is_own = is_region and match.maker_among(event, own.done)
      and not alphabet.of(own.fsm).set[event]
    if is_own or not is_region then
      add_word(own, words, rfsm.name_with_data(event) or event)
    end
  end
  return true
end

local function note_path(own, at, path, events)
  local words = {}
  local is_heard = add_heard(own, at, words, events)
  for _, tr in ipairs(path) do add_word(own, words, "taken " .. own.path_of[tr]) end
  note(own, at, "taken", path[1], { words = words, has_events = is_heard })
end

-- Does the next iteration have the events of this one again, so that both count as one
-- step? It does if no transition was taken, and the events are forwarded to regions of
-- the active leaf, or an extension has put some events back into the queue.
local function are_forwarded(fsm)
  return rfsm.is_free(fsm) and (rfsm.regions(fsm._act_leaf)[1] or fsm._intq[1] ~= nil)
end

-- Returns the words of a step, without entries of states that it has not left again,
-- and the events with these words.
local function words_of(own, log, events)
  local heard = {}
  for _, noted in ipairs(log) do
    for _, each in ipairs(noted.words) do
      if not each.passed or each.passed._mode == "inactive" then
        heard[#heard + 1], events = each, match.with(events, each.word)
      end
    end
  end
  heard[#heard + 1] = { word = "step", active = own.active }
  return heard, events
end

-- Has the monitors of the next step look at the states that this one passes, and at its
-- end.
local function judge(own, log, step, events)
  step.heard, events = words_of(own, log, events)
  for _, noted in ipairs(log) do
    local is_passed = noted.moment and noted.subject._mode == "inactive"
    local look = { active = noted.moment, is_end = false, now = own.now }
    for _, monitor in ipairs(is_passed and step.monitors or NOTHING) do
      look_at(own, step, monitor, look, NOTHING)
    end
  end
  local look = { active = own.active, is_end = true, now = read_clock(own),
    is_idle = is_idle(own.fsm) }
  look.is_at_rest = look.is_idle and has_no_timer(own.fsm)
  for _, monitor in ipairs(step.monitors) do
    look_at(own, step, monitor, look, events)
  end
end

-- Field by field: LuaJIT compiles no loop over `order.each`, nor a host's loop around.
local function copy_of(monitor)
  return { name = monitor.name, property = monitor.property, event = monitor.event,
    observer = monitor.observer, state = monitor.state, clocks = monitor.clocks,
    is_told = monitor.is_told, is_in_scope = monitor.is_in_scope }
end

-- Returns the step that follows when an iteration is over.
local function step_after(own, step, events)
  local is_over, trace = not are_forwarded(own.fsm), trace_with(own, step.trace, events)
  events = match.joined(step.forwarded, events)
  if not is_over then
    return { phase = "over", forwarded = events, monitors = step.monitors,
      log = step.log, trace = trace, reports = {} }
  end
  local after = { phase = "over", forwarded = {}, monitors = {}, log = {},
    trace = trace, reports = {} }
  for i, monitor in ipairs(step.monitors) do after.monitors[i] = copy_of(monitor) end
  judge(own, step.log, after, events)
  return after
end

local function end_iteration(own, at, events)
  local is_inner = at.machine ~= own.fsm
  if own.hears_more and (is_inner or own.step.phase ~= "over") then
    local words = {}
    if add_heard(own, at, words, events) then
      note(own, at, "passed", nil, { words = words, has_events = true })
    end
  end
  if is_inner or not own.fsm._act_leaf then return end
  if own.step.phase ~= "over" then own.step = step_after(own, own.step, events) end
  local reports = own.step.reports
  while reports[1] do -- rather twice than never
    rfsm.report(own.fsm, "err", reports[1])
    remove(reports, 1)
  end
end

local function is_nameless(predicate) return not rfsm.event_name(predicate) end

-- Returns what an observer may hear, and ask of the machine.
local function audible_of(own)
  local known, states, transitions = alphabet.of_all(own.fsm), {}, {}
  for at, state in location.each(own.fsm, rfsm.is_state) do
    states[#states + 1] = location.path(state, at.prefix)
    if rfsm.is_leaf(state) or rfsm.can_be_done(state) then
      own.done["e_done@" .. state._fqn] = true
    end
  end
  for at, tr in location.each(own.fsm, rfsm.is_trans) do
    own.path_of[tr] = location.path(tr, at.prefix)
    transitions[#transitions + 1] = own.path_of[tr]
  end
  local all = match.joined(match.joined(known.list, known.predicates), known.reactions)
  return observers.hearing(all, own.done, { states = states, transitions = transitions,
    takes_any = known.takes_any or order.any(known.predicates, is_nameless),
    flags = NOTHING, active = own.active })
end

-- Warns if no transition names the event of a property: then it may never come.
local function warn_of_unnamed(own, where, monitor, audible)
  local problem = properties.text_of_unnamed(monitor.property.event, audible)
  if not problem then return end
  rfsm.report(own.fsm, "warn", ("WARNING: %s%s: property '%s': %s"):format(
    monitor.property.location, where, monitor.name, problem))
end

-- Returns a monitor for each of the given properties. An error names the function
-- `where`.
local function monitors_of(own, where, given)
  local audible, set = audible_of(own), alphabet.of_all(own.fsm).set
  local list = properties.heard_in(where, given, audible)
  for _, monitor in ipairs(list) do
    warn_of_unnamed(own, where, monitor, audible)
    for _, word in ipairs(properties.words_of(monitor)) do own.hears[word] = true end
    monitor.event = meant(set, monitor.property.event)
    monitor.state, monitor.clocks = "first", {}
    monitor.is_told, monitor.is_in_scope = false, false
    if not kinds[monitor.property.kind].see then
      error(("%s: property '%s' is about runs that might be: explore it"):format(where,
        monitor.name), 0)
    end
  end
  return list
end

local function is_timed(monitor) return monitor.property.seconds ~= nil end

local function sees_passages(monitor) return kinds[monitor.property.kind].passes end

-- May a step leave a state again that it enters? It may leave a composite, and any
-- state of a region, which may take several steps in one.
local function may_pass(at, state)
  return at.owner or rfsm.is_composite(state) and not rfsm.is_root(state)
    and location.is_passable(state)
end

-- Sets all monitors to their first state, in which no clock runs.
local function begin(own, list)
  local step = { phase = "new", trace = {}, forwarded = {}, log = {}, reports = {},
    monitors = {} }
  for i, monitor in ipairs(list) do step.monitors[i] = copy_of(monitor) end
  own.step = step
end

--- End the watch, and remove its hooks from the machine.
function Watched:stop() self.stream:stop() end

--- Return the seconds until the next time limit of a property; nil if no limit runs. A
-- host that sleeps until the next timer of the machine may wake up for this limit, too.
---@return number? seconds
function Watched:next_deadline()
  local least
  for _, monitor in ipairs(self.step.monitors) do
    for _, began in ipairs(monitor.clocks) do
      local left = began + monitor.property.seconds - read_clock(self)
      if not least or left < least then least = left end
    end
  end
  return least
end

-- Returns a function of the listener. If it fails it is called again, which is as good
-- as once: then it was cut short by an interrupt, or something of the user's fails.
local function steadfast(own, f)
  return function(...)
    local ok, failure = pcall(f, own, ...)
    if ok then return end
    if pcall(f, own, ...) then error(failure, 0) end
    rfsm.keep_failure(own.fsm, failure)
  end
end

-- Adds what the monitors need to a listener: entries of states that a step may leave
-- again, and what observers hear.
local function listen(own, listener)
  local sees_more = own.hears.pass or order.any(own.step.monitors, sees_passages)
  if own.hears_more or sees_more then
    function listener.entered(_, at, state)
      local words, moment = {}, nil
      add_word(own, words, "entry " .. location.path(state, at.prefix))
      if sees_more and may_pass(at, state) then
        moment = own.snapshot()
        add_word(own, words, "pass", state)
      end
      note(own, at, "entered", state, { words = words, moment = moment })
    end
  end
  function listener.taken(_, at, path, events)
    -- before a transition that needs no event no step hook is called
    if own.step.phase ~= "begun" then begin_iteration(own, at) end
    if own.hears_more then note_path(own, at, path, events) end
  end
  if not own.hears_more then return end
  function listener.left(_, at, state)
    local words = {}
    add_word(own, words, "exit " .. location.path(state, at.prefix))
    note(own, at, "left", state, { words = words })
  end
end

--- Have a machine report to `err` if a property does not hold, with the latest steps.
--
-- The properties are as in an exploration, except that `from(...).can_reach(...)` and
-- flags are not possible. If an event has to lead to a condition and has not, this is
-- reported when nothing more can happen before the next event. After a report the
-- property is watched anew. Nothing is reported that rests on what happened before the
-- watch, if the machine was entered before, or before a snapshot was put into it.
--
-- @raise if a property is wrong, or names a state that does not exist
---@param fsm rfsm.Machine
---@param given? table<any, rfsm_checks.Property> default: the field `properties`
---@return rfsm_checks.Watched watched its method `stop` ends the watch
function watch_properties.watch_properties(fsm, given)
  local where = "rfsm_checks.watch_properties"
  rfsm.check_machine(fsm, where)
  if given == nil then given = fsm.properties end
  if type(given) ~= "table" then
    error(where .. ": table of properties expected, " .. opts.got(given), 2)
  end
  local active, snapshot = views_of(fsm)
  local own = setmetatable({ fsm = fsm, active = active, now = 0, leaf = false,
    is_timed = false, snapshot = snapshot, hears = {}, path_of = {},
    done = {} }, Watched)
  local list = monitors_of(own, where, given)
  own.is_timed = order.any(list, is_timed)
  own.hears_more = not order.is_empty(own.hears)
  begin(own, list)
  local parts = { began = begin_iteration, passed = end_iteration,
    reset = function(_, at) if at.machine == fsm then begin(own, list) end end }
  listen(own, parts)
  local listener = { is_repeatable = true }
  for name, part in order.each(parts) do -- any order: independent entries
    listener[name] = steadfast(own, part)
  end
  own.stream = stream.follow(fsm, listener)
  return own
end

return watch_properties
