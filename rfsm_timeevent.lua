--- Time events: e_after(seconds) and e_at(time).
--
-- Once this module is loaded, each machine initialised afterwards understands the
-- events `"e_after(T)"` and `"e_at(T)"` in its transitions. A timer is armed when the
-- source of its transition is entered. The event `e_after(T)@FQN` comes in the first
-- iteration that finds the timer expired, once per entry. F is the FQN of the source.
--
-- Most iterations find no timer expired. They read the clock and compare it with the
-- earliest deadline of the machine; only when that is past are timers looked at.
--
-- @module rfsm_timeevent
-- @license BSD-3-Clause

local clock = require "rfsm.clock"
local rfsm = require "rfsm"

local error, getmetatable, ipairs, next = error, getmetatable, ipairs, next
local pcall, rawget, rawset, setmetatable = pcall, rawget, rawset, setmetatable
local type = type
local huge, max, min = math.huge, math.max, math.min
local insert, sort = table.insert, table.sort
local is_callable, report, text_of = rfsm.is_callable, rfsm.report, rfsm.text_of
local read, gettimes = clock.read, clock.in_use

local rfsm_timeevent = {}

-- Time events: objects and texts ----------------------------------------------

--- A time event made by `e_after` or `e_at`, for the events of a transition.
---@class rfsm_timeevent.Timeevent
---@field is_relative boolean e_after, not e_at
---@field name string as a text: "e_after(3)"
---@field sec? number seconds
---@field nsec? number nanoseconds
---@field timeout? fun(id: any): number returns the seconds at each entry
---@field id? any its argument
local Timeevent = {}
Timeevent.__index = Timeevent

function Timeevent.__tostring(event) return event.name end

-- Makes an object. Blames the caller of e_after or e_at for a value that is no time.
local function new_event(kind, x, id)
  local event = setmetatable({ is_relative = kind == "e_after" }, Timeevent)
  if is_callable(x) then
    event.timeout, event.id = x, id
    event.name = kind .. "(" .. (id == nil and "function" or text_of(id)) .. ")"
  elseif type(x) == "number" and x >= 0 then
    event.sec, event.nsec = clock.from_number(x)
    event.name = kind .. "(" .. text_of(x) .. ")"
  else
    local got = type(x) == "number" and text_of(x) or type(x)
    error("rfsm_timeevent." .. kind .. ": seconds, a number not below 0, or a function "
      .. "expected, got " .. got, 3)
  end
  return event
end

-- Returns the event that a text such as "e_after(3)" stands for; nil for any other
-- text, and a second result if it was meant to be one.
local function parse(text)
  local kind = text:match("^(e_after)%s*%(") or text:match("^(e_at)%s*%(")
  if not kind or text:find("@", 1, true) then return nil end
  local sec, nsec = clock.from_text(text:match("%((.*)%)$") or "")
  if not sec then
    return nil, ("'%s': seconds expected, as in %s(0.5)"):format(text, kind)
  end
  return setmetatable({ is_relative = kind == "e_after", name = text, sec = sec,
    nsec = nsec }, Timeevent)
end

-- Run: arm, raise ----------------------------------------------------------------

--- The earliest deadline of one kind of timers; no armed timer has one before. The
-- field `_timeevent` of a machine has that of e_after at `true`, that of e_at at
-- `false`, and the number of its timers in `count`.
---@class rfsm_timeevent.Deadline
---@field is_relative boolean
---@field sec number huge if there is none
---@field nsec number
---@field soon number seconds; until then a look at the clock as one number is enough

--- A timer; they are the field `_timers` of the source, as a list and by name.
---@class rfsm_timeevent.Timer
---@field name string of the event that it raises
---@field event rfsm_timeevent.Timeevent
---@field is_relative boolean that of the event
---@field rank integer its position among the timers of the machine
---@field is_armed boolean
---@field is_waiting boolean to be armed when the clock works again
---@field sec number deadline
---@field nsec number

local NEVER, PAST = { sec = huge, nsec = 0 }, { sec = -huge, nsec = 0 }

local function is_before(a, b)
  if a.sec ~= b.sec then return a.sec < b.sec end
  return a.nsec < b.nsec
end

local function expires_before(a, b)
  if is_before(a, b) or is_before(b, a) then return is_before(a, b) end
  return a.rank < b.rank
end

local MARGIN = 0.001 -- seconds; more than the error of a time as one number

local function set(deadline, time)
  deadline.sec, deadline.nsec = time.sec, time.nsec
  deadline.soon = time.sec + time.nsec / 1e9 - MARGIN
end

local function new_deadline(is_relative)
  return { is_relative = is_relative, sec = huge, nsec = 0, soon = huge }
end

local function report_clock(fsm, reason)
  report(fsm, "err", "TIMEEVENT", "the clock failed: ", reason)
end

-- Returns the time for which a timer is set; nil if a timeout function fails.
local function duration_of(fsm, timer)
  local event = timer.event
  if not event.timeout then return event.sec, event.nsec end
  local ok, seconds = pcall(event.timeout, event.id)
  if ok and type(seconds) == "number" and seconds == seconds then
    return clock.from_number(max(seconds, 0))
  elseif ok then
    seconds = "number of seconds expected, got "
      .. (seconds ~= seconds and "NaN" or type(seconds))
  end
  report(fsm, "err", "TIMEEVENT", "error executing timeout of " .. timer.name .. ": ",
    seconds)
end

local function arm_at(fsm, timer, sec, nsec)
  timer.sec, timer.nsec = clock.normalise(sec, nsec)
  timer.is_armed = true
  local deadline = fsm._timeevent[timer.is_relative]
  if is_before(timer, deadline) then set(deadline, timer) end
end

-- Arms a timer, counting from `sec`, `nsec`.
local function arm(fsm, timer, sec, nsec)
  local delay, rest = duration_of(fsm, timer)
  timer.is_armed, timer.is_waiting = false, false
  if delay and delay < huge then arm_at(fsm, timer, sec + delay, nsec + rest) end
end

-- Has a timer wait for the clock to work again.
local function wait(fsm, timer)
  timer.is_armed, timer.is_waiting = false, true
  set(fsm._timeevent[true], PAST)
end

-- Arms the timers of a list; without a clock, the relative ones later.
local function arm_all(fsm, timers)
  local sec, nsec = false, nil -- not read yet
  for i = 1, #timers do
    if not timers[i].is_relative then
      arm(fsm, timers[i], 0, 0)
    else
      if sec == false then
        sec, nsec = read(true)
        if not sec then report_clock(fsm, nsec) end
      end
      if sec then arm(fsm, timers[i], sec, nsec) else wait(fsm, timers[i]) end
    end
  end
end

local function enter_state(fsm, state) arm_all(fsm, state._timers) end

-- Lists the timers of active states whose `flag` is set.
local function list_timers(fsm, flag)
  local list, state = {}, fsm._mode ~= "inactive" and fsm
  while state do
    local timers = state._timers
    for i = 1, timers and #timers or 0 do
      if timers[i][flag] then list[#list + 1] = timers[i] end
    end
    state = state._actchild
  end
  return list
end

-- Disarms and returns the timers of one kind that have expired. Notes the earliest
-- deadline of the others.
local function take_expired(fsm, deadline, now)
  local expired = {}
  set(deadline, NEVER)
  for _, timer in ipairs(list_timers(fsm, "is_armed")) do
    local is_meant = timer.is_relative == deadline.is_relative
    if is_meant and is_before(timer, now) then
      timer.is_armed = false
      expired[#expired + 1] = timer
    elseif is_meant and is_before(timer, deadline) then
      set(deadline, timer)
    end
  end
  sort(expired, expires_before)
  return expired
end

-- Raises the events of the timers of one kind that have expired.
local function raise_expired(fsm, deadline)
  local sec, nsec = read(deadline.is_relative)
  if not sec then return report_clock(fsm, nsec) end
  if deadline.is_relative then arm_all(fsm, list_timers(fsm, "is_waiting")) end
  if sec < deadline.sec or sec == deadline.sec and nsec <= deadline.nsec then return end
  local events = fsm._curq
  for _, timer in ipairs(take_expired(fsm, deadline, { sec = sec, nsec = nsec })) do
    events[#events + 1] = timer.name
    report(fsm, "dbg", "TIMEEVENT", timer.name)
  end
end

-- Is the time certainly before `soon`?
local function is_early(gettime, soon)
  local sec, nsec = gettime()
  if nsec then return sec + nsec * 1e-9 < soon end
  return sec < soon * 1e9 -- nanoseconds
end

-- This runs in every iteration. A clock that fails is read once more, and reported.
local function check_timers(fsm)
  local deadline = fsm._timeevent[true]
  for _ = 1, 2 do
    if deadline.soon < huge then
      local ok, is_nothing_due = pcall(is_early, gettimes[deadline.is_relative],
        deadline.soon)
      if not (ok and is_nothing_due) then raise_expired(fsm, deadline) end
    end
    deadline = fsm._timeevent[false]
  end
end

-- Snapshots: timers are kept with the time that is left, by their names ----------

local function read_or_raise(is_relative)
  local sec, nsec = read(is_relative)
  if sec then return sec, nsec end
  error("rfsm_timeevent: the clock failed: " .. text_of(nsec), 0)
end

local function save(fsm)
  local left, now, now_nsec = {}, nil, nil
  for _, timer in ipairs(list_timers(fsm, "is_waiting")) do left[timer.name] = true end
  for _, timer in ipairs(list_timers(fsm, "is_armed")) do
    local sec, nsec = timer.sec, timer.nsec
    if timer.is_relative then
      if not now then now, now_nsec = read_or_raise(true) end
      sec, nsec = clock.normalise(sec - now, nsec - now_nsec)
    end
    left[timer.name] = { sec, nsec }
  end
  return next(left) and left
end

-- Arms a timer of which `left` was kept: seconds and nanoseconds, or true.
local function load_timer(fsm, timer, left)
  local sec, nsec, now, now_nsec = left, 0, 0, 0
  if left == true then return wait(fsm, timer) end
  if type(left) == "table" then sec, nsec = left[1], left[2] end
  if type(sec) ~= "number" or type(nsec) ~= "number" or sec - sec ~= nsec - nsec then
    error("seconds and nanoseconds expected for timer '" .. timer.name .. "'", 0)
  end
  if timer.is_relative then now, now_nsec = read_or_raise(true) end
  arm_at(fsm, timer, sec + now, nsec + now_nsec)
end

-- Timers follow the chart: one that the chart of a snapshot did not have is armed from
-- now on, and one that this chart does not have is dropped.
local function load(fsm, left, how)
  local is_known = {}
  left = left or {}
  set(fsm._timeevent[true], NEVER)
  set(fsm._timeevent[false], NEVER)
  for _, timer in ipairs(list_timers(fsm, "name")) do
    is_known[timer.name] = true
    timer.is_armed, timer.is_waiting = false, false
    if left[timer.name] ~= nil then
      load_timer(fsm, timer, left[timer.name])
    elseif how.is_migrated and how.is_new(timer.name) then
      arm_all(fsm, { timer })
    end
  end
  for _, name in ipairs(how.is_migrated and {} or rfsm.sorted_keys(left)) do
    if not is_known[name] then
      error("no active state has a timer '" .. text_of(name) .. "'", 0)
    end
  end
end

-- Prepare: the events of a model become timers ---------------------------------

-- Makes a machine look for expired timers, and a state arm its own.
local function prepare_timers(fsm, state)
  if not fsm._timeevent then
    fsm._timeevent = { [true] = new_deadline(true), [false] = new_deadline(false),
      count = 0 }
    rfsm.pre_step_hook_add(fsm, check_timers, "before") -- other hooks see the events
    rfsm.snapshot_hook_add(fsm, "timers", save, load)
  end
  if not state._timers then
    state._timers = {}
    rfsm.entry_hook_add(fsm, state, enter_state)
  end
  return fsm._timeevent, state._timers
end

-- Do two events of one source always expire together?
local function is_same(a, b)
  if a.timeout or b.timeout then return a == b end
  return a.is_relative == b.is_relative and a.sec == b.sec and a.nsec == b.nsec
end

-- Returns the name of an event at its source: one of its own, or that of a timer that
-- expires together with it, which is the second result.
local function find_name(timers, event, fqn)
  local name, n = event.name .. "@" .. fqn, 1
  while timers[name] and not is_same(timers[name].event, event) do
    n = n + 1
    name = event.name .. "#" .. n .. "@" .. fqn
  end
  return name, timers[name]
end

-- Gives `state` a timer for an event; returns the name of the event there.
local function add_timer(fsm, state, event)
  local own, timers = prepare_timers(fsm, state)
  local name, timer = find_name(timers, event, state._fqn)
  if timer then return name end
  own.count = own.count + 1
  timer = { name = name, event = event, is_relative = event.is_relative,
    rank = own.count, is_armed = false, is_waiting = false, sec = huge, nsec = 0 }
  timers[#timers + 1], timers[name] = timer, timer
  if state._mode ~= "inactive" then arm_all(fsm, { timer }) end -- merged
  return name
end

-- Returns the name of a time event at the source of `tr`.
local function expand(fsm, tr, event)
  local src = tr.src
  if rfsm.is_state(src) then return add_timer(fsm, src, event) end
  report(fsm, "warn", ("WARNING: %s: '%s' never fires here, '%s' is no state"):format(
    rfsm.location_of(tr, "events"), event.name, src._fqn))
  return event.name .. "@" .. src._fqn
end

-- Expands a text; also the time events in one such as "await(e_a, e_after(2))".
local function expand_text(fsm, tr, text)
  local event, reason = parse(text)
  if event then return expand(fsm, tr, event) end
  if reason then
    report(fsm, "warn", "WARNING: " .. rfsm.location_of(tr, "events") .. ": " .. reason)
    return text
  end
  return (text:gsub("%f[%w_](e_%a+%s*%b())(@?)", function(inner, at)
    local found = at == "" and parse(inner)
    return found and expand(fsm, tr, found) or nil
  end))
end

local function prepare(fsm, merged)
  for _, tr in ipairs(rfsm.elements(merged or fsm, rfsm.is_trans)) do
    for i, event in ipairs(tr.events) do
      if getmetatable(event) == Timeevent then
        tr.events[i] = expand(fsm, tr, event)
      elseif type(event) == "string" then
        tr.events[i] = expand_text(fsm, tr, event)
      end
    end
  end
end

-- Public functions ------------------------------------------------------------

--- Make an event that comes when its state has been active for more than `x` seconds.
--
-- @usage
--    local e_after = rfsm_timeevent.e_after
--    rfsm.trans { src = "green", tgt = "red", events = { e_after(2.5) } }
--
---@param x number|fun(id: any): number seconds, or a function called at each entry
---@param id? any the argument of that function; part of the event's name
---@return rfsm_timeevent.Timeevent event
---@nodiscard
function rfsm_timeevent.e_after(x, id) return (new_event("e_after", x, id)) end

--- Make an event that comes when the clock shows more than `x`, if its state is active.
---@param x number|fun(id: any): number seconds, or a function called at each entry
---@param id? any the argument of that function; part of the event's name
---@return rfsm_timeevent.Timeevent event
---@nodiscard
function rfsm_timeevent.e_at(x, id) return (new_event("e_at", x, id)) end

--- Is `value` a time event: an object, or a text such as "e_after(3)"?
---@param value any
---@return boolean
function rfsm_timeevent.is_timeevent(value)
  if getmetatable(value) == Timeevent then return true end
  return type(value) == "string" and parse((value:gsub("@.*$", ""))) ~= nil
end

--- Set the clock that all machines use, for e_after and e_at alike.
--
-- Set it before machines run: armed timers keep the times of the clock before. A clock
-- returns seconds and nanoseconds, or nanoseconds in one number. One that wants a clock
-- id is given "CLOCK_MONOTONIC".
--
---@param gettime? fun(id?: string): number, number? nil for the best clock installed
function rfsm_timeevent.set_gettime_hook(gettime)
  if gettime ~= nil and not is_callable(gettime) then
    error("rfsm_timeevent.set_gettime_hook: function expected, got " .. type(gettime),
      2)
  end
  clock.set_hook(gettime)
end

-- Returns the seconds until the first timer of one kind can fire; huge: there is none.
local function remaining(fsm, deadline)
  take_expired(fsm, deadline, PAST)
  if deadline.sec == huge then return huge end
  local sec, nsec = read_or_raise(deadline.is_relative)
  sec, nsec = clock.normalise(deadline.sec - sec, deadline.nsec - nsec + 1)
  return max(sec + nsec / 1e9, 0)
end

-- Returns the seconds until the first timer of a machine can fire, also of machines in
-- its active states; huge: there is none.
local function earliest_deadline(fsm)
  local least, state = huge, fsm
  if fsm._timeevent then
    local waiting = list_timers(fsm, "is_waiting")
    if waiting[1] then read_or_raise(true) end
    arm_all(fsm, waiting)
    least = min(remaining(fsm, fsm._timeevent[true]),
      remaining(fsm, fsm._timeevent[false]))
  end
  while state do
    local machines = type(state.substates) == "table" and state.substates or {}
    for _, name in ipairs(rfsm.sorted_keys(machines, rfsm.is_initialized_root)) do
      least = min(least, earliest_deadline(machines[name]))
    end
    state = state._actchild
  end
  return least
end

--- Return how long a host may sleep: seconds until the next timer can fire.
--
-- A step before that finds no time event; the first one after it does. The timers of
-- machines in an active sequential AND state count.
--
-- @raise if the clock fails
---@param fsm rfsm.Machine
---@return number? seconds 0 if a timer has expired already, nil if none is armed
function rfsm_timeevent.next_deadline(fsm)
  rfsm.check_machine(fsm, "rfsm_timeevent.next_deadline")
  local least = earliest_deadline(fsm)
  return least < huge and least or nil
end

insert(rfsm.preproc, 1, prepare) -- first: awaited time events become names here

if not rawget(_G, "RFSM_NO_GLOBALS") then
  rawset(_G, "rfsm_timeevent", rfsm_timeevent)
end

return rfsm_timeevent
