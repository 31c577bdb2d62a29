--- Time events: e_after(seconds) and e_at(time).
--
-- Once this module is loaded, each machine initialised afterwards understands the
-- events `"e_after(T)"` and `"e_at(T)"` in its transitions. A timer is armed when the
-- source of its transition is entered and disarmed when it is left; the event
-- `e_after(T)@F` comes in the first iteration that finds it expired, once per entry. F
-- is the name of the source.
--
-- Times are kept as two whole numbers, seconds and nanoseconds, never as one float, and
-- armed timers in a heap per machine: an iteration looks only at the earliest.
--
-- @module rfsm_timeevent
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, getmetatable, pcall, print = error, getmetatable, pcall, print
local pairs, rawget, rawset, require = pairs, rawget, rawset, require
local setmetatable, tonumber, tostring, type = setmetatable, tonumber, tostring, type
local floor, huge, max, min = math.floor, math.huge, math.max, math.min
local insert, remove = table.insert, table.remove

local rfsm_timeevent = {}

-- Time: seconds and nanoseconds -----------------------------------------------

local BILLION = 1000000000

local function is_finite(x) return x - x == 0 end

-- Returns whole seconds, and whole nanoseconds from 0 below a billion.
local function normalise(sec, nsec)
  local whole = floor(sec)
  nsec = floor(nsec) + floor((sec - whole) * BILLION + 0.5)
  local carry = floor(nsec / BILLION)
  return whole + carry, nsec - carry * BILLION
end

-- Splits seconds in one number; it may be infinite.
local function from_number(seconds)
  if not is_finite(seconds) then return seconds, 0 end
  return normalise(seconds, 0)
end

-- Splits a text such as "0.25", digit by digit; nil when it is no number of seconds.
local function from_text(text)
  local whole, fraction = text:match("^%s*(%d*)%.?(%d*)%s*$")
  if not whole then
    local number = text:match("^%s*%d*%.?%d*[eE][+-]?%d+%s*$") and tonumber(text)
    if number then return from_number(number) end
    return nil
  end
  if whole == "" and fraction == "" then return nil end
  local digits = (fraction .. ("0"):rep(10)):sub(1, 10) -- the tenth only rounds
  return normalise(tonumber("0" .. whole), floor(tonumber(digits) / 10 + 0.5))
end

-- Splits nanoseconds in one number; exact, since the remainder is taken off first.
local function from_nanoseconds(ns)
  ns = floor(ns)
  local nsec = ns % BILLION
  if nsec < 0 then nsec = nsec + BILLION end -- Lua 5.1 rounds large quotients up
  return (ns - nsec) / BILLION, nsec
end

-- Clock: the one handed in, or the best that is installed ----------------------

-- Returns a module by its name, or by the global that it sets; nil when there is none.
local function find_module(name)
  local ok, module = pcall(require, name)
  if not ok then return nil end
  if type(module) ~= "table" then module = rawget(_G, name) end
  return type(module) == "table" and module or nil
end

local function find_rtp_clock(is_monotonic)
  local rtp = find_module("rtp")
  local gettime = rtp and type(rtp.clock) == "table" and rtp.clock.gettime
  if not gettime then return nil end
  local id = is_monotonic and "CLOCK_MONOTONIC" or "CLOCK_REALTIME"
  if pcall(gettime, id) then return function() return gettime(id) end end
  return gettime
end

local function find_posix_clock(is_monotonic)
  local time = find_module("posix.time")
  if time and time.clock_gettime then
    local id = is_monotonic and time.CLOCK_MONOTONIC or time.CLOCK_REALTIME
    return function()
      local now = time.clock_gettime(id)
      return now.tv_sec, now.tv_nsec
    end
  end
  local posix = find_module("posix")
  local gettime = posix and posix.clock_gettime
  if not gettime then return nil end
  local id = is_monotonic and "monotonic" or "realtime"
  return function() return gettime(id) end
end

local function find_socket_clock()
  local socket = find_module("socket")
  local gettime = socket and socket.gettime
  return gettime and function() return gettime(), 0 end
end

local function find_os_clock()
  local os = rawget(_G, "os")
  return os and os.time and function() return os.time(), 0 end
end

local function no_clock() error("no clock is installed", 0) end

local FINDERS = { find_rtp_clock, find_posix_clock, find_socket_clock, find_os_clock }

local function find_clock(is_monotonic)
  for i = 1, #FINDERS do
    local clock = FINDERS[i](is_monotonic)
    if clock and pcall(clock) then return clock end
  end
  return no_clock
end

local clock_hook = nil
local default_clocks = {} -- by is_monotonic, found when they are first needed

local function clock_for(is_monotonic)
  if clock_hook then return clock_hook end
  local clock = default_clocks[is_monotonic]
  if not clock then
    clock = find_clock(is_monotonic)
    default_clocks[is_monotonic] = clock
  end
  return clock
end

-- Returns the time as seconds and nanoseconds; nil and why when the clock fails.
local function read_clock(is_monotonic)
  local ok, sec, nsec = pcall(clock_for(is_monotonic))
  if not ok then return nil, sec end
  if type(sec) ~= "number" or nsec ~= nil and type(nsec) ~= "number" then
    local got = type(sec) == "number" and type(nsec) or type(sec)
    return nil, "seconds and nanoseconds expected, got " .. got
  end
  if not is_finite(sec) or nsec and not is_finite(nsec) then
    return nil, "a time must be finite"
  end
  if nsec then return normalise(sec, nsec) end
  return from_nanoseconds(sec)
end

-- Time events: objects and texts ----------------------------------------------

--- A time event made by `e_after` or `e_at`, for the events of a transition.
---@class rfsm_timeevent.Timeevent
---@field is_relative boolean e_after, not e_at
---@field name string what the event is called
---@field sec? number seconds
---@field nsec? number nanoseconds
---@field program? fun(id: any): number gives the seconds at each entry
---@field id? any what it is called with
local Timeevent = {}
Timeevent.__index = Timeevent

function Timeevent.__tostring(event) return event.name end

local function is_callable(value)
  if type(value) == "function" then return true end
  local class = getmetatable(value)
  return type(class) == "table" and rawget(class, "__call") ~= nil
end

local function text_of(value)
  if type(value) == "number" then return ("%.14g"):format(value) end
  return tostring(value)
end

local function new_event(kind, sec, nsec)
  return setmetatable({
    is_relative = kind == "e_after", name = false, sec = sec, nsec = nsec,
    program = false, id = nil,
  }, Timeevent)
end

-- Makes an object; blames the caller of e_after or e_at for what cannot be a time.
local function define(kind, x, id)
  local event
  if is_callable(x) then
    event = new_event(kind, false, false)
    event.program, event.id = x, id
    event.name = kind .. "(" .. (id == nil and "function" or text_of(id)) .. ")"
    return event
  end
  if type(x) ~= "number" or x < 0 or x ~= x then
    local got = type(x) == "number" and text_of(x) or type(x)
    error("rfsm_timeevent." .. kind .. ": seconds, a number not below 0, or a function "
      .. "expected, got " .. got, 3)
  end
  event = new_event(kind, from_number(x))
  event.name = kind .. "(" .. text_of(x) .. ")"
  return event
end

-- Returns what a text such as "e_after(3)" means; nil for any other event, and false
-- and the reason for one that was meant so.
local function parse(text)
  local kind = text:match("^(e_after)%s*%(") or text:match("^(e_at)%s*%(")
  if not kind or text:find("@", 1, true) then return nil end
  local argument = text:match("^e_%a+%s*%((.*)%)$")
  local sec, nsec = from_text(argument or "")
  if not sec then
    return false, ("%s: seconds expected, got '%s' (%s(0.5) would be right)"):format(
      kind, text, kind)
  end
  local event = new_event(kind, sec, nsec)
  event.name = text
  return event
end

-- Heap: the armed timers of one clock, the earliest first ----------------------
--
-- heap[i] expires no later than heap[2 * i] and heap[2 * i + 1]; timer.at is its place
-- there, 0 when it is not armed.

local function is_before(a, b)
  if a.sec ~= b.sec then return a.sec < b.sec end
  if a.nsec ~= b.nsec then return a.nsec < b.nsec end
  return a.rank < b.rank
end

local function put(heap, i, timer) heap[i], timer.at = timer, i end

local function sift_up(heap, i, timer)
  while i > 1 do
    local above = floor(i / 2)
    if not is_before(timer, heap[above]) then break end
    put(heap, i, heap[above])
    i = above
  end
  put(heap, i, timer)
end

local function sift_down(heap, i, timer)
  local n = heap.n
  while 2 * i <= n do
    local below = 2 * i
    if below < n and is_before(heap[below + 1], heap[below]) then below = below + 1 end
    if not is_before(heap[below], timer) then break end
    put(heap, i, heap[below])
    i = below
  end
  put(heap, i, timer)
end

local function heap_add(heap, timer)
  heap.n = heap.n + 1
  sift_up(heap, heap.n, timer)
end

local function heap_remove(heap, timer)
  local i, n = timer.at, heap.n
  local last = heap[n]
  heap[n], heap.n, timer.at = nil, n - 1, 0
  if last == timer then return end
  if i > 1 and is_before(last, heap[floor(i / 2)]) then
    sift_up(heap, i, last)
  else
    sift_down(heap, i, last)
  end
end

-- Run: arm, disarm, raise ------------------------------------------------------

--- The timers of a machine, in its field `_timeevent`; `_timers` has those of a state.
---@class rfsm_timeevent.Timers
---@field relative table the heap of e_after
---@field absolute table the heap of e_at
---@field waiting table[] lists of timers to arm when the clock works again
---@field count integer how many timers the machine has
---@field has_failure boolean a printer raised; kept until all is armed or raised
---@field failure any what it raised

local function report(fsm, printer, ...)
  local f = fsm[printer]
  if f == true then f = print end
  if not f then return end
  local ok, failure = pcall(f, ...)
  local own = fsm._timeevent
  if ok or own.has_failure then return end
  own.has_failure, own.failure = true, failure
end

local function raise_failure(own)
  if not own.has_failure then return end
  local failure = own.failure
  own.has_failure, own.failure = false, nil
  error(failure, 0)
end

-- Reads the clock; says so to `err` and returns nil when it fails.
local function time_for(fsm, is_relative)
  local sec, nsec = read_clock(is_relative)
  if sec then return sec, nsec end
  report(fsm, "err", "TIMEEVENT", "the clock failed: ", nsec)
end

-- Returns what the timeout function says; nil when it fails or says nothing of use.
local function call_program(fsm, timer)
  local event = timer.event
  local ok, seconds = pcall(event.program, event.id)
  if ok and type(seconds) == "number" and seconds == seconds then
    return from_number(max(seconds, 0))
  end
  if ok then
    seconds = "number of seconds expected, got "
      .. (seconds ~= seconds and "NaN" or type(seconds))
  end
  report(fsm, "err", "TIMEEVENT", "error executing timeout of " .. timer.name .. ": ",
    seconds)
end

local function heap_of(own, timer)
  return timer.is_relative and own.relative or own.absolute
end

local function disarm(own, timer)
  if timer.at > 0 then heap_remove(heap_of(own, timer), timer) end
end

-- Arms a timer: what its event says, counted from `sec`, `nsec`.
local function arm(fsm, timer, sec, nsec)
  local own, event = fsm._timeevent, timer.event
  disarm(own, timer)
  local delay, rest = event.sec, event.nsec
  if event.program then delay, rest = call_program(fsm, timer) end
  if not delay or delay == huge then return end -- huge: never
  timer.sec, timer.nsec = normalise(sec + delay, nsec + rest)
  heap_add(heap_of(own, timer), timer)
end

local function arm_all(fsm, timers, is_relative, sec, nsec)
  for i = 1, #timers do
    if timers[i].is_relative == is_relative then arm(fsm, timers[i], sec, nsec) end
  end
end

-- Arms timers at the present time; without a clock, the relative ones later.
local function arm_now(fsm, timers)
  arm_all(fsm, timers, false, 0, 0)
  if not timers.has_relative then return end
  local sec, nsec = time_for(fsm, true)
  if sec then return arm_all(fsm, timers, true, sec, nsec) end
  local waiting = fsm._timeevent.waiting
  waiting[#waiting + 1] = timers
end

local function enter_state(fsm, state)
  arm_now(fsm, state._timers)
  raise_failure(fsm._timeevent)
end

local function leave_state(fsm, state)
  local own, timers = fsm._timeevent, state._timers
  for i = 1, #timers do disarm(own, timers[i]) end
  for i = #own.waiting, 1, -1 do
    if own.waiting[i].state == state then remove(own.waiting, i) end
  end
end

local function reset_heap(heap)
  for i = 1, heap.n do heap[i].at, heap[i] = 0, nil end
  heap.n = 0
end

local function reset(fsm)
  local own = fsm._timeevent
  reset_heap(own.relative)
  reset_heap(own.absolute)
  own.waiting = {}
end

-- Arms what could not be armed before; false when the clock still fails.
local function arm_waiting(fsm, own)
  if not own.waiting[1] then return true end
  local sec, nsec = time_for(fsm, true)
  if not sec then return false end
  local waiting = own.waiting
  own.waiting = {}
  for i = 1, #waiting do arm_all(fsm, waiting[i], true, sec, nsec) end
  return true
end

-- Appends the events of the timers that expired before now.
local function expire(fsm, heap, is_relative, events)
  if heap.n == 0 then return end
  local sec, nsec = time_for(fsm, is_relative)
  if not sec then return end
  local first = heap[1]
  while first and (first.sec < sec or first.sec == sec and first.nsec < nsec) do
    heap_remove(heap, first)
    events[#events + 1] = first.name
    report(fsm, "dbg", "TIMEEVENT", first.name)
    first = heap[1]
  end
end

local function raise_expired(fsm)
  local own, events = fsm._timeevent, fsm._curq
  if arm_waiting(fsm, own) then expire(fsm, own.relative, true, events) end
  expire(fsm, own.absolute, false, events)
  raise_failure(own)
end

-- Prepare: the events of a model become timers ---------------------------------

local function new_heap() return { n = 0 } end

-- Returns the timers of a machine; the first makes it look for expired ones.
local function timers_of_machine(fsm)
  if not fsm._timeevent then
    fsm._timeevent = {
      relative = new_heap(), absolute = new_heap(), waiting = {}, count = 0,
      has_failure = false, failure = nil,
    }
    rfsm.pre_step_hook_add(fsm, raise_expired, "before") -- other hooks see the events
    rfsm.reset_hook_add(fsm, reset)
  end
  return fsm._timeevent
end

local function timers_of_state(fsm, state)
  if not state._timers then
    state._timers = { state = state, by_name = {}, has_relative = false }
    rfsm.entry_hook_add(fsm, state, enter_state)
    rfsm.exit_hook_add(fsm, state, leave_state)
  end
  return state._timers
end

-- Do two events of one source always expire together?
local function is_same(a, b)
  if a.program or b.program then return a == b end
  return a.is_relative == b.is_relative and a.sec == b.sec and a.nsec == b.nsec
end

-- Returns what to call an event at its source: a name of its own, or that of one that
-- expires together with it.
local function find_name(timers, event, fqn)
  local name, n = event.name .. "@" .. fqn, 1
  while timers.by_name[name] and not is_same(timers.by_name[name].event, event) do
    n = n + 1
    name = event.name .. "#" .. n .. "@" .. fqn
  end
  return name
end

local function new_timer(own, event, name)
  own.count = own.count + 1
  return {
    name = name, event = event, is_relative = event.is_relative, rank = own.count,
    sec = 0, nsec = 0, at = 0,
  }
end

local function add_timer(fsm, state, event)
  local own, timers = timers_of_machine(fsm), timers_of_state(fsm, state)
  local name = find_name(timers, event, state._fqn)
  if timers.by_name[name] then return name end
  local timer = new_timer(own, event, name)
  timers[#timers + 1], timers.by_name[name] = timer, timer
  timers.has_relative = timers.has_relative or timer.is_relative
  if rfsm.get_sta_mode(state) ~= "inactive" then -- merged into a live machine
    arm_now(fsm, { timer, state = state, has_relative = timer.is_relative })
  end
  return name
end

local function place_of(tr)
  local key = type(tr._id) == "number" and "trans[" .. text_of(tr._id) .. "]" or tr._id
  return tr._parent._fqn .. "." .. key
end

-- Returns the name of a time event at the source of `tr`.
local function expand(fsm, tr, event)
  local src = tr.src
  if rfsm.is_state(src) then return add_timer(fsm, src, event) end
  fsm.warn(("WARNING: %s: '%s' never fires here, '%s' is no state"):format(place_of(tr),
    event.name, src._fqn))
  return event.name .. "@" .. src._fqn
end

-- Puts f(event) in the place of each time event in "await(e_a, e_after(2))".
local function map_awaited(text, f)
  return (text:gsub("%f[%w_](e_%a+%s*%b())(@?)", function(inner, at)
    local event = at == "" and parse(inner)
    return event and f(event) .. at or nil
  end))
end

local function is_await(event)
  return type(event) == "string" and event:find("^await%(") ~= nil
end

-- Returns the time event that `event` is or stands for; else as `parse`.
local function event_of(event)
  if getmetatable(event) == Timeevent then return event end
  if type(event) == "string" then return parse(event) end
end

local function check_transition(tr, problems)
  for i = 1, tr.events and #tr.events or 0 do
    local event, reason = event_of(tr.events[i])
    if event == false then
      problems[#problems + 1] = place_of(tr) .. ".events[" .. i .. "]: " .. reason
    end
  end
end

local function prepare_transition(fsm, tr)
  local events = tr.events
  for i = 1, events and #events or 0 do
    local event = event_of(events[i])
    if event then
      events[i] = expand(fsm, tr, event)
    elseif is_await(events[i]) then
      events[i] = map_awaited(events[i], function(inner)
        return expand(fsm, tr, inner)
      end)
    end
  end
end

local function itself(obj) return obj end

-- The transitions in what was initialised or merged.
local function transitions_in(obj)
  if rfsm.is_trans(obj) then return { obj } end
  return rfsm.is_state(obj) and rfsm.mapfsm(itself, obj, rfsm.is_trans) or {}
end

local function prepare(fsm, merged)
  local transitions, problems = transitions_in(merged or fsm), {}
  for i = 1, #transitions do
    local tr = transitions[i]
    if type(tr.events) == "string" then tr.events = { tr.events } end
    check_transition(tr, problems)
  end
  if problems[1] then return problems end
  for i = 1, #transitions do prepare_transition(fsm, transitions[i]) end
  if fsm._timeevent then raise_failure(fsm._timeevent) end
end

-- Public functions ------------------------------------------------------------

--- Make an event that comes when its state has been active for more than `x` seconds.
--
-- @usage
--    local e_after = rfsm_timeevent.e_after
--    rfsm.trans { src = "green", tgt = "red", events = { e_after(2.5) } }
--
---@param x number|fun(id: any): number seconds, or a function called at each entry
---@param id? any what the function is called with; part of the event's name
---@return rfsm_timeevent.Timeevent event
---@nodiscard
function rfsm_timeevent.e_after(x, id) return (define("e_after", x, id)) end

--- Make an event that comes when the clock says more than `x`, if its state is active.
---@param x number|fun(id: any): number seconds, or a function called at each entry
---@param id? any what the function is called with; part of the event's name
---@return rfsm_timeevent.Timeevent event
---@nodiscard
function rfsm_timeevent.e_at(x, id) return (define("e_at", x, id)) end

--- Is `value` a time event: an object, or a text such as "e_after(3)"?
---@param value any
---@return boolean
function rfsm_timeevent.is_timeevent(value)
  if getmetatable(value) == Timeevent then return true end
  if type(value) ~= "string" then return false end
  return (parse((value:gsub("@.*$", "")))) and true or false
end

--- Set the clock that all machines use, for e_after and e_at alike.
--
-- Set it before machines run: armed timers keep the times of the clock before. A
-- clock returns seconds and nanoseconds, or nanoseconds in one number.
--
---@param gettime? fun(): number, number? nil for the best clock that is installed
function rfsm_timeevent.set_gettime_hook(gettime)
  if gettime ~= nil and not is_callable(gettime) then
    error("rfsm_timeevent.set_gettime_hook: function expected, got " .. type(gettime),
      2)
  end
  clock_hook = gettime
end

-- Returns the seconds until the first timer of `heap` can fire, at most `least`.
local function sooner(heap, is_relative, least)
  local first = heap[1]
  if not first then return least end
  local sec, nsec = read_clock(is_relative)
  if not sec then
    error("rfsm_timeevent.next_deadline: the clock failed: " .. tostring(nsec), 0)
  end
  sec, nsec = normalise(first.sec - sec, first.nsec - nsec + 1)
  return min(max(sec + nsec / BILLION, 0), least)
end

local function soonest_of(fsm, least)
  local own = fsm._timeevent
  if own then
    if own.waiting[1] then return 0 end
    least = sooner(own.relative, true, sooner(own.absolute, false, least))
  end
  local state = fsm
  while state do
    local subs = state.substates -- those of a sequential AND state
    for _, sub in pairs(type(subs) == "table" and subs or {}) do -- any order: a minimum
      if rfsm.is_initialized_root(sub) then least = soonest_of(sub, least) end
    end
    state = rfsm.actchild_get(state)
  end
  return least
end

--- Return how long a host may sleep: seconds until the next timer can fire.
--
-- A step before that finds no time event; the first one after it does. The timers of
-- machines in an active sequential AND state count.
--
-- @raise when the clock fails
---@param fsm rfsm.Machine
---@return number? seconds 0 when one has expired already, nil when none is armed
function rfsm_timeevent.next_deadline(fsm)
  if not rfsm.is_initialized_root(fsm) then
    error("rfsm_timeevent.next_deadline: initialised fsm expected, got " .. type(fsm),
      2)
  end
  local least = soonest_of(fsm, huge)
  return least < huge and least or nil
end

insert(rfsm.preproc, 1, prepare) -- first: awaited time events become names here

if not rawget(_G, "RFSM_NO_GLOBALS") then
  rawset(_G, "rfsm_timeevent", rfsm_timeevent)
end

return rfsm_timeevent
