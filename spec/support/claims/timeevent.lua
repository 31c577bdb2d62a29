-- Time events against a list of deadlines: those that come in each iteration, in their
-- order, and the result of next_deadline. The clock moves at random, also back, and
-- fails.

local driven = require "spec.support.driven"
local match = require "rfsm.shared.match"
local order = require "rfsm.shared.order"
local rfsm = require "rfsm"
local timeevent = require "rfsm_timeevent"

local BILLION = 1000000000
local START = 1000 * BILLION
local fail = driven.fail

-- Charts ------------------------------------------------------------------------------

local DELAYS = { "0", "1e-9", "0.5", "1", "2.25", "3", "0.000000002", "20" }
local RETURNED = { 0, 0.25, 1, 3.5, -1, math.huge, "no number" }

-- Returns a time event with a function, which notes in the timer what it returns.
local function new_function(chart, random, timer)
  chart.count = chart.count + 1
  return timeevent[timer.kind](function()
    local seconds = random:pick(RETURNED)
    local is_number = type(seconds) == "number"
    if is_number and timer.kind == "e_at" then seconds = seconds + 1000 end
    timer.returned = is_number and math.max(seconds, 0) * BILLION or math.huge
    return seconds
  end, "f" .. chart.count)
end

-- Returns a time event with a number, as a text or as an object.
local function new_number(random, timer)
  local number = tonumber(random:pick(DELAYS))
  if timer.kind == "e_at" then number = number + 1000 end
  timer.ns = math.floor(number * BILLION + 0.5)
  if random:chance(50) then return ("%s(%.9f)"):format(timer.kind, number) end
  return timeevent[timer.kind](number)
end

-- Makes a time event for a state, and notes it in the list of timers.
local function add_timer(chart, random, fqn)
  local timer = { fqn = fqn, kind = random:chance(70) and "e_after" or "e_at",
    deadline = math.huge }
  local event = random:chance(30) and new_function(chart, random, timer)
    or new_number(random, timer)
  timer.name = tostring(event) .. "@" .. fqn
  local timers = chart.timers
  if not timers[timer.name] then
    timers[#timers + 1], timers[timer.name] = timer, timer
  end
  return event
end

local function add_timers(chart, random)
  chart.timers, chart.count = {}, 0
  for _, tr in ipairs(chart.transitions) do
    if chart.nodes[tr.src].kind == "state" and tr.events_ref and random:chance(60) then
      tr.events_ref = { add_timer(chart, random, tr.src), "e4" }
      if random:chance(30) then
        tr.events_ref[3] = add_timer(chart, random, tr.src)
      end
    end
  end
end

-- The model: a list of deadlines ------------------------------------------------------

-- Sets a timer; `now` is nil while the clock fails.
local function arm(timer, now)
  local is_relative = timer.kind == "e_after"
  timer.is_waiting, timer.deadline = is_relative and not now, math.huge
  if timer.is_waiting then return end
  timer.deadline = (timer.ns or timer.returned) + (is_relative and now or 0)
end

-- Lists the timers of active states. Those that wait are armed if the clock works.
local function list_active(run, now)
  local list = {}
  for _, timer in ipairs(run.chart.timers) do
    if run.active[timer.fqn] then list[#list + 1] = timer end
    if run.active[timer.fqn] and timer.is_waiting and now then arm(timer, now) end
  end
  return list
end

local function is_behind(timer, other)
  if timer.kind ~= other.kind then return timer.kind > other.kind end
  return timer.deadline >= other.deadline
end

-- Does the event come again? An event may be there twice.
local function comes_again(again, event)
  local count = again[event]
  if count then again[event] = count > 1 and count - 1 or nil end
  return count
end

-- Checks that a time event is among the timers that are due, and in its place.
local function check_event(run, timer, due, last)
  if not due[timer] then
    fail(run, "%s came early or twice", timer.name)
  elseif not is_behind(timer, last) then
    fail(run, "%s came behind %s", timer.name, last.name)
  end
end

-- May the event trigger a transition of an active state? A predicate may.
local function is_awaited(run, event)
  for _, tr in ipairs(rfsm.elements(run.fsm, rfsm.is_trans)) do
    local is_from_active = tr.src == run.fsm or run.active[tr.src._fqn]
    for _, wanted in ipairs(is_from_active and tr.events or {}) do
      if wanted == event or type(wanted) == "function" then return true end
    end
    if is_from_active and match.is_any(tr) then return true end
  end
  return false
end

-- The path hook: notes the time events that an internal transition lets go. They come
-- again, first, in the next iteration.
local function note_again(run, path)
  local tr = path[1]
  if not tr or tr.always or rfsm.target_of(tr) ~= "internal" or tr.tgt ~= tr.src
    or match.is_any(tr) then
    return
  end
  for _, event in ipairs(run.current) do
    local is_timer = type(event) == "string" and run.chart.timers[event]
    if is_timer and not match.takes(tr.events, event) and is_awaited(run, event) then
      run.again[event] = (run.again[event] or 0) + 1
    end
  end
end

-- Compares the time events among `events` with the timers that have expired: those of
-- e_after first, each kind in the order of deadlines.
local function check_events(run, events, now)
  local due, last = {}, { kind = "e_after", deadline = -math.huge }
  for _, timer in ipairs(list_active(run, now)) do
    if now and timer.deadline < now then due[timer] = true end
  end
  local again = run.again
  run.current, run.again = events, {}
  for _, event in ipairs(events) do
    local timer = type(event) == "string" and run.chart.timers[event]
    if timer and not comes_again(again, event) then
      check_event(run, timer, due, last)
      last, due[timer] = { kind = timer.kind, deadline = timer.deadline }, nil
      timer.deadline = math.huge
    end
  end
  for name in order.each(again) do fail(run, "%s did not come again", name) end
  for timer in order.each(due) do fail(run, "%s did not come", timer.name) end
end

-- Returns the nanoseconds until the next timer fires; nil if none is armed.
local function remaining(run, now)
  local least = math.huge
  for _, timer in ipairs(list_active(run, now)) do
    least = math.min(least, math.max(timer.deadline + 1 - now, 0))
  end
  return least < math.huge and least or nil
end

-- Runs -------------------------------------------------------------------------------

-- Moves the clock: to the next timer or a nanosecond less, forward, back, into failure.
local function move(clock, random, run)
  local choice, left = random(8), clock.now and remaining(run, clock.now)
  clock.now = clock.now or clock.last
  if choice == 1 then
    clock.last, clock.now = clock.now, nil
  elseif choice == 2 then
    clock.now = clock.now - random(4) * BILLION / 2
  elseif choice <= 5 and left then
    clock.now = clock.now + left - random(2) + 1
  else
    clock.now = clock.now + random(3) * BILLION / 4 + random(3) - 2
  end
end

-- The clock, in one of the ways in which a clock may return the time.
local function reader(clock, random)
  local way = random(3)
  return function()
    if not clock.now then error("out of order", 0) end
    local nsec = clock.now % BILLION
    if way == 1 then return clock.now end
    if way == 2 then return (clock.now - nsec) / BILLION - 1, nsec + BILLION end
    return (clock.now - nsec) / BILLION, nsec
  end
end

local function check_deadline(run, now)
  local found = timeevent.next_deadline(run.fsm) -- it may call functions of timers
  local left = remaining(run, now)
  if (left == nil) ~= (found == nil) or left
    and math.abs(left - found * BILLION) > 0.4 then
    fail(run, "next_deadline is %s, expected: %s", tostring(found),
      tostring(left and left / BILLION))
  end
end

return { name = "time events and deadlines", run = driven.claim(function(seed)
  local run, clock = driven.new(seed, add_timers), { now = START }
  run.fsm.gettime = reader(clock, run.random)
  run.current, run.again = {}, {}
  rfsm.path_hook_add(run.fsm, function(_, path) note_again(run, path) end)
  function run.reset() run.again = {} end
  function run.enter(fqn)
    for _, timer in ipairs(run.chart.timers) do
      if timer.fqn == fqn then arm(timer, clock.now) end
    end
  end
  function run.iterate(events) check_events(run, events, clock.now) end
  for _ = 1, 20 do
    driven.step(run)
    if clock.now then check_deadline(run, clock.now) end
    if run.problem then return run.problem end
    move(clock, run.random, run)
  end
end) }
