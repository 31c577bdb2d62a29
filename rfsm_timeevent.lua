--- Time events: e_after(seconds) and e_at(time).
--
-- Once this module is loaded, each machine initialised afterwards understands the
-- events `"e_after(T)"` and `"e_at(T)"` in its transitions. A timer is armed when the
-- source of its transition is entered. The event `e_after(T)@FQN` comes in the first
-- iteration that finds the timer expired, once per entry.
--
-- An entry notes the time for all timers of the state. Most iterations only compare the
-- clock with one number, before which no timer expires.
--
-- @module rfsm_timeevent
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, getmetatable, ipairs = error, getmetatable, ipairs
local pcall, rawequal, rawget, rawset = pcall, rawequal, rawget, rawset
local require, setmetatable, tonumber, type = require, setmetatable, tonumber, type
local abs, floor, huge, max = math.abs, math.floor, math.huge, math.max
local min, insert, sort = math.min, table.insert, table.sort
local is_callable, report, text_of = rfsm.is_callable, rfsm.report, rfsm.text_of

local rfsm_timeevent = {}

-- Times: whole seconds, and whole nanoseconds from 0 below a billion ---------------

local BILLION = 1000000000

-- Carries whole seconds from nanoseconds to seconds. Both may have a fraction. The
-- remainder is subtracted before the division, which then is exact.
local function normalise(sec, nsec)
  local whole = floor(sec)
  if whole == sec and nsec >= 0 and nsec < BILLION and nsec % 1 == 0 then
    return whole, nsec
  end
  nsec = floor(nsec) + floor((sec - whole) * BILLION + 0.5)
  local rest = nsec % BILLION
  if rest < 0 then rest = rest + BILLION end -- Lua 5.1 rounds large quotients up
  return whole + floor((nsec - rest) / BILLION), rest
end

-- Splits seconds in one number, which may be infinite.
local function from_number(seconds)
  if seconds - seconds ~= 0 then return seconds, 0 end
  return normalise(seconds, 0)
end

-- Splits a text such as "0.25", digit by digit; nil if it is no number of seconds.
local function from_text(text)
  local whole, fraction = text:match("^%s*(%d*)%.?(%d*)%s*$")
  if not whole then
    local number = text:match("^%s*%d*%.?%d*[eE][+-]?%d+%s*$") and tonumber(text)
    if number then return from_number(number) end
    return nil
  elseif whole == "" and fraction == "" then
    return nil
  end
  local digits = (fraction .. ("0"):rep(10)):sub(1, 10) -- the tenth only rounds
  return normalise(tonumber("0" .. whole), floor(tonumber(digits) / 10 + 0.5))
end

-- Clocks: the machine's, its parent machine's, or the process's ---------------------
--
-- Each is a pair of functions: `true` for e_after, which wants a clock that is never
-- set, `false` for e_at, which wants the time of day.

local function read_standard()
  local os = rawget(_G, "os")
  if not (os and os.time) then error("no clock is installed", 0) end
  return os.time(), 0
end

-- Replaces rfsm.clock in a folder without that file.
local function new_standard_clock()
  local function find() return read_standard end
  local in_use = setmetatable({}, { __index = find })
  local function set_hook(relative, absolute)
    in_use[true], in_use[false] = relative, absolute or relative
  end
  local function split(gettime) return { [true] = gettime, [false] = gettime } end
  return { in_use = in_use, set_hook = set_hook, split = split }
end

local has_clock, clock = pcall(require, "rfsm.clock")
if not has_clock then clock = new_standard_clock() end

local in_use = clock.in_use

-- Returns the clock of a machine: its field `gettime`, or that of a machine around it.
local function clock_of(fsm, is_relative)
  local own, owner, gettime = fsm._timeevent, fsm, fsm.gettime
  while not gettime and owner._owner do
    owner = owner._owner
    gettime = owner.gettime
  end
  if not gettime then return in_use[is_relative] end
  if not rawequal(own.gettime, gettime) then
    own.gettime, own.clocks = gettime, clock.split(gettime)
  end
  return own.clocks[is_relative]
end

-- Returns the time; nil and the error of a clock that fails.
local function read(fsm, is_relative)
  local ok, sec, nsec = pcall(clock_of(fsm, is_relative))
  if not ok then
    return nil, sec
  elseif type(sec) ~= "number" or nsec ~= nil and type(nsec) ~= "number" then
    local got = type(sec) == "number" and type(nsec) or type(sec)
    return nil, "seconds and nanoseconds expected, got " .. got
  elseif sec - sec ~= 0 or nsec and nsec - nsec ~= 0 then
    return nil, "a time must be finite"
  elseif nsec then
    return normalise(sec, nsec)
  end
  return normalise(0, sec) -- nanoseconds
end

local function read_or_raise(fsm, is_relative)
  local sec, nsec = read(fsm, is_relative)
  if sec then return sec, nsec end
  error("rfsm_timeevent: the clock failed: " .. text_of(nsec), 0)
end

local function report_clock(fsm, reason)
  report(fsm, "err", "TIMEEVENT", "the clock failed: ", reason)
end

-- Clocks that were reported to return seconds in one number.
local suspects = setmetatable({}, { __mode = "k" })

local DAY = 86400

-- Warns of a clock that returns one number, nanoseconds, which can only be seconds: it
-- is below a million, or the time of day in seconds.
local function check_unit(fsm, number)
  local os, gettime = rawget(_G, "os"), clock_of(fsm, true)
  local is_small = number > 0 and number < 1e6
  local is_day = os and os.time and abs(number - os.time()) < DAY
  if suspects[gettime] or not (is_small or is_day) then return end
  suspects[gettime] = true
  report(fsm, "warn", ("WARNING: the clock returned one number, %.14g, which means "
    .. "nanoseconds; seconds need two: function() return os.time(), 0 end"):format(
    number))
end

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

-- Makes an object. Blames the caller of e_after or e_at for a wrong value.
local function new_event(kind, x, id)
  local event = setmetatable({ is_relative = kind == "e_after" }, Timeevent)
  if is_callable(x) then
    event.timeout, event.id = x, id
    event.name = kind .. "(" .. (id == nil and "function" or text_of(id)) .. ")"
  elseif type(x) == "number" and x >= 0 then
    event.sec, event.nsec = from_number(x)
    event.name = kind .. "(" .. text_of(x) .. ")"
  else
    local got = type(x) == "number" and text_of(x) or type(x)
    error("rfsm_timeevent." .. kind .. ": seconds, a number not below 0, or a function "
      .. "expected, got " .. got, 3)
  end
  return event
end

-- Returns the event of a text such as "e_after(3)"; nil for any other text, and the
-- problem if it looks like a time event.
local function parse(text)
  local kind = text:match("^(e_after)%s*%(") or text:match("^(e_at)%s*%(")
  if not kind or text:find("@", 1, true) then return nil end
  local sec, nsec = from_text(text:match("%((.*)%)$") or "")
  if not sec then
    return nil, ("'%s': seconds expected, as in %s(0.5)"):format(text, kind)
  end
  return setmetatable({ is_relative = kind == "e_after", name = text, sec = sec,
    nsec = nsec }, Timeevent)
end

-- Run: arm, raise ----------------------------------------------------------------

--- The field `_timeevent` of a machine. Its fields `true` and `false` are times in
-- seconds before which no e_after or e_at expires. huge: none is armed, -huge: some
-- wait for the clock to work again.
---@class rfsm_timeevent.Own
---@field count integer number of timers
---@field gettime any the clock of the machine
---@field clocks table<boolean, function> the two functions of that clock

--- The timers of a state, as a list and by name; its field `_timers`.
---@class rfsm_timeevent.Timers
---@field entry integer number of times the state was entered
---@field sec number|false the time of the latest entry; false: the clock failed
---@field nsec number
---@field delay number|false the shortest e_after; huge: functions only, false: none
---@field time number|false the earliest e_at

--- A timer. It is armed with all timers of its state when that is entered, unless it
-- has been set alone since.
---@class rfsm_timeevent.Timer
---@field name string of the event that it raises
---@field event rfsm_timeevent.Timeevent
---@field is_relative boolean
---@field rank integer its position among the timers of the machine
---@field timers rfsm_timeevent.Timers the list that it is in
---@field entry integer the entry of the state for which it was set alone
---@field sec number|false the deadline set; huge: not armed, false: it waits
---@field nsec number

local MARGIN = 0.001 -- seconds; more than the error of a time as one number

-- Returns the deadline of a timer: values of its fields `sec` and `nsec`.
local function deadline_of(timer)
  local timers, event = timer.timers, timer.event
  if timer.entry == timers.entry then return timer.sec, timer.nsec end
  if not timer.is_relative then return event.sec, event.nsec end
  if not timers.sec then return false, 0 end
  return normalise(timers.sec + event.sec, timers.nsec + event.nsec)
end

-- Notes that a timer may expire at a time.
local function note_deadline(fsm, is_relative, sec, nsec)
  local own = fsm._timeevent
  own[is_relative] = min(own[is_relative], sec + nsec * 1e-9 - MARGIN)
end

local function set(fsm, timer, sec, nsec)
  timer.entry, timer.sec, timer.nsec = timer.timers.entry, sec, nsec
  note_deadline(fsm, timer.is_relative, sec or -huge, nsec)
end

local function disarm(timer) timer.entry, timer.sec = timer.timers.entry, huge end

-- Returns the time for which a timer is set; huge if a timeout function fails.
local function duration_of(fsm, timer)
  local event = timer.event
  if not event.timeout then return event.sec, event.nsec end
  local ok, seconds = pcall(event.timeout, event.id)
  if ok and type(seconds) == "number" and seconds == seconds then
    return from_number(max(seconds, 0))
  elseif ok then
    seconds = "number of seconds expected, got "
      .. (seconds ~= seconds and "NaN" or type(seconds))
  end
  report(fsm, "err", "TIMEEVENT", "error executing timeout of " .. timer.name .. ": ",
    seconds)
  return huge, 0
end

-- Arms a timer alone, counting from `sec`, `nsec` if it is relative.
local function arm(fsm, timer, sec, nsec)
  if timer.is_relative and not sec then return set(fsm, timer, false, 0) end
  local delay, rest = duration_of(fsm, timer)
  if delay == huge then return disarm(timer) end
  if timer.is_relative then delay, rest = normalise(sec + delay, nsec + rest) end
  set(fsm, timer, delay, rest)
end

-- Arms a timer alone, from now on.
local function arm_now(fsm, timer)
  local sec, nsec = nil, nil
  if timer.is_relative then
    sec, nsec = read(fsm, true)
    if not sec then report_clock(fsm, nsec) end
  end
  arm(fsm, timer, sec, nsec)
end

-- Returns the time as one number, then seconds and nanoseconds; seconds are nil if the
-- clock returned one number. Raises an error or returns false for a wrong time.
local function time_of(gettime)
  local sec, nsec = gettime()
  if not nsec then return sec < huge and sec * 1e-9, nil, sec end
  local time = sec + nsec * 1e-9
  return sec < huge and time - time == 0 and time, sec, nsec
end

-- A clock that returns one number, or that fails, is read once more and reported.
local function read_unusual(fsm, time, nsec)
  if time then
    check_unit(fsm, nsec)
    return time, 0, nsec
  end
  local sec, reason = read(fsm, true)
  if sec then return sec + reason * 1e-9, sec, reason end
  report_clock(fsm, reason)
  return -huge, false, 0
end

-- Notes the time of entry for the timers of a state.
local function note_entry(fsm, timers, own)
  local gettime = (fsm.gettime or fsm._owner) and clock_of(fsm, true) or in_use[true]
  local ok, time, sec, nsec = pcall(time_of, gettime)
  if not (ok and sec and time) then
    time, sec, nsec = read_unusual(fsm, ok and time, nsec)
  end
  timers.sec, timers.nsec = sec, nsec
  time = time + timers.delay
  if time < own[true] then own[true] = time end
end

local function enter_state(fsm, state)
  local timers, own = state._timers, fsm._timeevent
  timers.entry = timers.entry + 1
  if timers.delay then note_entry(fsm, timers, own) end
  if not timers.time then return end
  if timers.time < own[false] then own[false] = timers.time end
  for _, timer in ipairs(timers) do
    if timer.event.timeout then arm(fsm, timer, timers.sec, timers.nsec) end
  end
end

local function list_timers(fsm)
  local list, state = {}, fsm._mode ~= "inactive" and fsm
  while state do
    local timers = state._timers
    if timers then
      for i = 1, #timers do list[#list + 1] = timers[i] end
    end
    state = state._actchild
  end
  return list
end

-- Arms the timers that wait for the clock.
local function arm_waiting(fsm, sec, nsec)
  for _, timer in ipairs(list_timers(fsm)) do
    if not deadline_of(timer) then arm(fsm, timer, sec, nsec) end
  end
end

local function is_before(sec, nsec, than_sec, than_nsec)
  if sec ~= than_sec then return sec < than_sec end
  return nsec < than_nsec
end

-- Orders timers that have expired, each with its deadline.
local function expires_before(a, b)
  if a.sec ~= b.sec or a.nsec ~= b.nsec then
    return is_before(a.sec, a.nsec, b.sec, b.nsec)
  end
  return a.timer.rank < b.timer.rank
end

-- Disarms and lists the expired timers of one kind. Notes the deadlines of the others.
local function take_expired(fsm, is_relative, sec, nsec)
  local expired = {}
  fsm._timeevent[is_relative] = huge
  for _, timer in ipairs(list_timers(fsm)) do
    local at, rest = deadline_of(timer)
    local is_meant = timer.is_relative == is_relative
    if is_meant and is_before(at, rest, sec, nsec) then
      disarm(timer)
      expired[#expired + 1] = { timer = timer, sec = at, nsec = rest }
    elseif is_meant then
      note_deadline(fsm, is_relative, at, rest)
    end
  end
  sort(expired, expires_before)
  return expired
end

-- Raises the events of the timers of one kind that have expired.
local function raise_expired(fsm, is_relative)
  local sec, nsec = read(fsm, is_relative)
  if not sec then return report_clock(fsm, nsec) end
  if is_relative then arm_waiting(fsm, sec, nsec) end
  local events = fsm._curq
  for _, at in ipairs(take_expired(fsm, is_relative, sec, nsec)) do
    events[#events + 1] = at.timer.name
    report(fsm, "dbg", "TIMEEVENT", at.timer.name)
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
  local own = fsm._timeevent
  local soon, soon_at = own[true], own[false]
  if soon < huge then
    local gettime = (fsm.gettime or fsm._owner) and clock_of(fsm, true) or in_use[true]
    local ok, is_nothing_due = pcall(is_early, gettime, soon)
    if not (ok and is_nothing_due) then raise_expired(fsm, true) end
  end
  if soon_at < huge then
    local ok, is_nothing_due = pcall(is_early, clock_of(fsm, false), soon_at)
    if not (ok and is_nothing_due) then raise_expired(fsm, false) end
  end
end

-- Snapshots: timers are kept with the time that is left, by their names ----------

local MAX_EXACT = 1000000 -- seconds, of which one number has the nanoseconds

-- Returns a time for a snapshot; true if it is not known yet.
local function kept_time(sec, nsec)
  if not sec then return true end
  if abs(sec) >= MAX_EXACT then return { sec, nsec } end
  return nsec == 0 and sec or sec + nsec / BILLION
end

local function save(fsm)
  local left, now, now_nsec = nil, nil, nil
  for _, timer in ipairs(list_timers(fsm)) do
    local sec, nsec = deadline_of(timer)
    if sec and sec < huge and timer.is_relative then
      if not now then now, now_nsec = read_or_raise(fsm, true) end
      sec, nsec = normalise(sec - now, nsec - now_nsec)
    end
    if sec ~= huge then
      left = left or {}
      left[timer.name] = kept_time(sec, nsec)
    end
  end
  return left
end

-- Arms a timer with the time of a snapshot: a number, seconds and nanoseconds, or true.
local function load_timer(fsm, timer, left)
  local sec, nsec, now, now_nsec = left, 0, 0, 0
  if left == true then return set(fsm, timer, false, 0) end
  if type(left) == "table" then sec, nsec = left[1], left[2] end
  if type(sec) ~= "number" or type(nsec) ~= "number" or sec - sec ~= nsec - nsec then
    error("seconds and nanoseconds expected for timer '" .. timer.name .. "'", 0)
  end
  if timer.is_relative then now, now_nsec = read_or_raise(fsm, true) end
  set(fsm, timer, normalise(sec + now, nsec + now_nsec))
end

-- Timers follow the chart: in a migration a new timer is armed from now on, and a timer
-- that the chart does not have is dropped.
local function load(fsm, left, how)
  local own, is_known = fsm._timeevent, {}
  left = left or {}
  own[true], own[false] = huge, huge
  for _, timer in ipairs(list_timers(fsm)) do
    is_known[timer.name] = true
    disarm(timer)
    if left[timer.name] ~= nil then
      load_timer(fsm, timer, left[timer.name])
    elseif how.is_migrated and how.is_new(timer.name) then
      arm_now(fsm, timer)
    end
  end
  for _, name in ipairs(how.is_migrated and {} or rfsm.sorted_keys(left)) do
    if not is_known[name] then
      error("no active state has a timer '" .. text_of(name) .. "'", 0)
    end
  end
end

-- Prepare: the events of a model become timers ---------------------------------

-- Adds the hook for expired timers to a machine, and that for entries to a state.
local function prepare_timers(fsm, state)
  if not fsm._timeevent then
    fsm._timeevent = { [true] = huge, [false] = huge, count = 0, gettime = false,
      clocks = false }
    -- before other hooks, so that they see the events
    rfsm.pre_step_hook_add(fsm, rfsm.borrows(check_timers), "before")
    rfsm.snapshot_hook_add(fsm, "timers", save, load)
  end
  if not state._timers then
    state._timers = { entry = 0, sec = false, nsec = 0, delay = false, time = false }
    rfsm.entry_hook_add(fsm, state, enter_state)
  end
  return fsm._timeevent, state._timers
end

-- Notes the shortest time of a list, for entries.
local function note_shortest(timers, event)
  local field = event.is_relative and "delay" or "time"
  local seconds = event.timeout and huge or event.sec + event.nsec * 1e-9 - MARGIN
  timers[field] = min(timers[field] or huge, seconds)
  if event.timeout then timers.time = timers.time or huge end
end

local function is_same(a, b)
  if a.timeout or b.timeout then return a == b end
  return a.is_relative == b.is_relative and a.sec == b.sec and a.nsec == b.nsec
end

-- Returns the name of an event at its source. If a timer always expires together with
-- it, it is that of the timer, which is the second result.
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
    rank = own.count, timers = timers, entry = timers.entry, sec = huge, nsec = 0 }
  timers[#timers + 1], timers[name] = timer, timer
  note_shortest(timers, event)
  if state._mode ~= "inactive" then arm_now(fsm, timer) end -- merged
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

--- Set the clock of the process: that of each machine without a field `gettime`.
--
-- Set it before machines run: armed timers keep their times. A clock returns seconds
-- and nanoseconds, or nanoseconds in one number. It is for e_after and e_at. One that
-- wants a clock id is given "CLOCK_MONOTONIC" or "CLOCK_REALTIME"; that of RTT is for
-- e_after alone.
--
---@param gettime? fun(id?: string): number, number? nil for the best clock installed
function rfsm_timeevent.set_gettime_hook(gettime)
  if gettime ~= nil and not is_callable(gettime) then
    error("rfsm_timeevent.set_gettime_hook: function expected, got " .. type(gettime),
      2)
  end
  local clocks = gettime and clock.split(gettime) or {}
  clock.set_hook(clocks[true], clocks[false])
end

-- Returns the seconds until the first timer of one kind can fire; huge: there is none.
local function remaining(fsm, is_relative)
  local first, first_nsec = huge, 0
  for _, timer in ipairs(list_timers(fsm)) do
    local sec, nsec = deadline_of(timer)
    local is_meant = timer.is_relative == is_relative
    if is_meant and is_before(sec, nsec, first, first_nsec) then
      first, first_nsec = sec, nsec
    end
  end
  if first == huge then return huge end
  local sec, nsec = read_or_raise(fsm, is_relative)
  sec, nsec = normalise(first - sec, first_nsec - nsec + 1)
  return max(sec + nsec / 1e9, 0)
end

-- Likewise of a machine and its active regions.
local function earliest_deadline(fsm)
  local least, state = huge, fsm._mode ~= "inactive" and fsm
  local own = fsm._timeevent
  if own then
    if own[true] == -huge then arm_waiting(fsm, read_or_raise(fsm, true)) end
    if own[true] < huge then least = remaining(fsm, true) end
    if own[false] < huge then least = min(least, remaining(fsm, false)) end
  end
  while state do
    local regions = state._regions and rfsm.regions(state)
    for i = 1, regions and #regions or 0 do
      least = min(least, earliest_deadline(regions[i]))
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
