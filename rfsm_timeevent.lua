--- Time events: e_after(seconds), e_every(seconds) and e_at(time).
--
-- Once this module is loaded, each machine initialised afterwards understands the
-- events `"e_after(T)"`, `"e_every(T)"` and `"e_at(T)"` in its transitions. A timer is
-- armed when the source of its transition is entered. The event `e_after(T)@FQN` comes
-- in the first iteration that finds the timer expired, once per entry; `e_every(T)@FQN`
-- comes again each T seconds after the entry, but never twice for one iteration.
--
-- The entry of a state notes the time once for all its timers. Most iterations only
-- compare the clock with one number, a time before which no timer expires. The number
-- is -huge during an entry. If an interrupt ends the entry, the number stays -huge, so
-- that the next iteration searches all timers.
--
-- `send_after` sends an event later, whatever state is active then. `time_in` returns
-- the seconds since the entry of a state: one with timers, or with the field `timed`.
--
-- @module rfsm_timeevent
-- @license BSD-3-Clause

local home = tostring((...)):match("^(.+[./])rfsm_timeevent$") -- "libs."
if home then require(home .. "rfsm") return require "rfsm_timeevent" end -- one copy

local rfsm = require "rfsm"

local error, getmetatable, ipairs, pcall = error, getmetatable, ipairs, pcall
local rawget, rawset = rawget, rawset
local setmetatable, tonumber, type = setmetatable, tonumber, type
local ceil, floor, huge = math.ceil, math.floor, math.huge
local max, min = math.max, math.min
local insert, remove = table.insert, table.remove
local is_callable, report, text_of = rfsm.is_callable, rfsm.report, rfsm.text_of

local rfsm_timeevent = {}

-- Makes the clock that is used if rfsm/clock.lua is missing. It calls `gettime` of the
-- machine, or the hook of the process, without a clock id; without both, os.time.
local function new_clock()
  local function read_day() return rawget(_G, "os").time(), 0 end
  local hook = read_day
  local function read(fsm)
    while not fsm.gettime and fsm._owner do fsm = fsm._owner end
    local ok, sec, nsec = pcall(fsm.gettime or hook)
    if not (ok and tonumber(sec)) then return false, sec end
    if not nsec then sec, nsec = 0, sec end
    return sec + nsec * 1e-9, sec, nsec
  end
  return { read = read, set_hook = function(gettime) hook = gettime or read_day end,
    present = function(sec, nsec) return sec, nsec end }
end

local clock = rfsm.find_module "rfsm.clock" or new_clock()
local read = clock.read

local BILLION = 1000000000 -- an integer: a float rounds the nanoseconds of Lua 5.3

-- Time events: objects and texts ---------------------------------------------------

-- Returns a time as whole seconds, which may be infinite, and whole nanoseconds from 0
-- to below a billion: times that are equal have equal numbers.
local function normalise(sec, nsec)
  if sec % 1 == 0 and nsec % 1 == 0 and nsec < 1e9 and nsec >= 0 then
    return sec, nsec
  elseif sec - sec ~= 0 then
    return sec, 0
  end
  local whole, below = floor(sec), floor(nsec)
  nsec = below + floor((sec - whole) * 1e9 + (nsec - below) + 0.5)
  local rest = floor(nsec % BILLION)
  return whole + floor((nsec - rest) / BILLION), rest
end

-- Returns the whole seconds and nanoseconds of a text such as "0.25" or "1e-3"; nil if
-- the text is no number. Digits such as "0.25" are split as text to avoid rounding.
local function from_text(text)
  local whole, fraction = text:match("^%s*(%d*)%.?(%d*)%s*$")
  if not whole then
    local number = text:match("^%s*%d*%.?%d*[eE][+-]?%d+%s*$")
      and rfsm.number_of(text)
    if number then return normalise(number, 0) end
  elseif whole .. fraction ~= "" then
    local digits = (fraction .. ("0"):rep(10)):sub(1, 10) -- the tenth rounds the ninth
    return normalise(tonumber("0" .. whole), floor(tonumber(digits) / 10 + 0.5))
  end
end

--- A time event, made by `e_after`, `e_every` or `e_at`, or parsed from a text.
---@class rfsm_timeevent.Timeevent
---@field name string the text of the event: "e_after(3)"
---@field is_relative boolean true for e_after and e_every, false for e_at
---@field is_repeated boolean true for e_every
---@field sec? number whole seconds; absent if `timeout` returns the time
---@field nsec? number nanoseconds in addition to `sec`
---@field timeout? fun(id: any): number called at each entry, returns the seconds
---@field id? any the argument of `timeout`
local Timeevent = { rfsm_copy = rfsm }

function Timeevent.__tostring(event) return event.name end

local function new_event(kind, name, sec, nsec)
  return setmetatable({ name = name, is_relative = kind ~= "e_at",
    is_repeated = kind == "e_every", sec = sec, nsec = nsec }, Timeevent)
end

-- Is the number of seconds too small for a time event of this kind?
local function is_too_small(kind, seconds)
  return seconds < 0 or kind == "e_every" and seconds < 1e-9
end

-- Makes an event. A wrong `x` raises an error in the caller of `e_after` and others.
local function new_object(kind, x, id)
  if is_callable(x) then
    local shown = id == nil and "function" or text_of(id)
    local event = new_event(kind, kind .. "(" .. shown .. ")")
    event.timeout, event.id = x, id
    return event
  elseif type(x) == "number" and x == x and not is_too_small(kind, x) then
    return new_event(kind, kind .. "(" .. text_of(x) .. ")", normalise(x, 0))
  end
  error(("rfsm_timeevent.%s: seconds, a number %s 0, or a function expected, got %s")
    :format(kind, kind == "e_every" and "above" or "not below",
    type(x) == "number" and text_of(x) or type(x)), 3)
end

local parsed = setmetatable({}, { __mode = "v" }) -- time events by their texts

-- Returns the time event that a text such as "e_after(3)" describes; nil for any other
-- text. Also returns the problem if the text is a time event with wrong seconds.
local function parse(text)
  if parsed[text] then return parsed[text] end
  local kind = text:match("^(e_after)%s*%(") or text:match("^(e_every)%s*%(")
    or text:match("^(e_at)%s*%(")
  if not kind or text:find("@", 1, true) then return nil end
  local sec, nsec = from_text(text:match("%((.*)%)$") or "")
  if not sec or is_too_small(kind, sec + nsec) then
    return nil, ("'%s': seconds%s expected, as in %s(0.5)"):format(text,
      sec and " above 0" or "", kind)
  end
  local event = new_event(kind, text, sec, nsec)
  parsed[text] = event
  return event
end

-- Run: arm, raise ------------------------------------------------------------------

--- The field `_timeevent` of a machine. Before the time `[true]`, in seconds, no timer
-- of an e_after or e_every expires and no event of `send_after` is sent. Before
-- `[false]` no timer of an e_at expires. A time is huge if nothing is armed.
---@class rfsm_timeevent.Own
---@field has_timers boolean a state of the machine has timers
---@field has_at boolean a timer of the machine is an e_at
---@field is_unusual boolean a timer is an e_at or has a timeout function
---@field sends rfsm_timeevent.Send[] events to be sent later; the last is sent first
---@field raised rfsm_timeevent.Timer|false the timer whose event came last
---@field turn integer the iteration in which this event came
---@field at integer the place of this event among the current events
---@field now number|false the seconds of the latest save or load; false: not read yet
---@field now_nsec number nanoseconds in addition to `now`

--- The timers of a state, in a list: the field `_timers` of the state.
---@class rfsm_timeevent.Timers
---@field sec number|false seconds on the clock at the latest entry; false: not known
---@field nsec number nanoseconds in addition to `sec`
---@field delay number seconds of the shortest e_after or e_every without a function,
-- less MARGIN; huge if there is none
---@field entry integer how often the state has been entered

--- A timer. The entry of a state arms all timers of the state.
---@class rfsm_timeevent.Timer
---@field name string the event that the timer raises: "e_after(3)@root.a"
---@field event rfsm_timeevent.Timeevent
---@field timers rfsm_timeevent.Timers the list that has this timer
---@field entry integer|false the number of the entry for which `sec` and `nsec` hold
---@field sec? number|false seconds of the deadline; absent or huge: not armed, false:
-- not known
---@field nsec? number nanoseconds in addition to `sec`

local MARGIN = 0.001 -- seconds; above the rounding error of a time stored as a float

local function report_clock(fsm, reason)
  report(fsm, "err", "TIMEEVENT", "the clock failed: ", reason)
end

-- Is it relative, without a function? Its deadline follows from the time of the entry.
local function is_usual(event) return event.is_relative and event.sec end

-- Returns the deadline of a timer; false if it is not known.
local function deadline_of(timer)
  local timers, event = timer.timers, timer.event
  if timer.entry == timers.entry then
    local sec = timer.sec
    if sec == nil then return huge, 0 end
    return sec, timer.nsec
  elseif not (timers.sec and is_usual(event)) then
    return false, 0
  end
  return timers.sec + event.sec, timers.nsec + event.nsec
end

-- Sets the deadline of one timer, and returns it. `timer.entry` makes the deadline
-- valid. It is written last, so that an interrupt leaves no half-written deadline. Most
-- timers expire once in an entry: they never get the other fields.
local function set(fsm, timer, sec, nsec)
  if timer.sec == nil and sec == huge then
    timer.entry = timer.timers.entry
    return sec, nsec
  end
  local own, kind = fsm._timeevent, timer.event.is_relative
  timer.entry = false
  timer.sec, timer.nsec = sec, nsec
  timer.entry = timer.timers.entry
  own[kind] = min(own[kind], (sec or -huge) + nsec * 1e-9 - MARGIN)
  return sec, nsec
end

-- Returns the seconds and nanoseconds of a timer's event, from its function if it has
-- one; huge if the function fails.
local function duration_of(fsm, timer)
  local event = timer.event
  if not event.timeout then return event.sec, event.nsec end
  local ok, seconds = pcall(event.timeout, event.id)
  if ok and type(seconds) == "number" and seconds == seconds then
    return normalise(max(seconds, event.is_repeated and 1e-9 or 0), 0)
  elseif ok then
    seconds = "number of seconds expected, got "
      .. (seconds ~= seconds and "NaN" or type(seconds))
  elseif rfsm.is_interrupt(seconds) then
    error(seconds, 0)
  end
  report(fsm, "err", "TIMEEVENT", "error executing timeout of " .. timer.name .. ": ",
    seconds)
  return huge, 0
end

-- Arms one timer, and returns its deadline. An e_after counts from the time `sec`,
-- `nsec`; if `sec` is false, its deadline stays unknown.
local function arm(fsm, timer, sec, nsec)
  local is_relative = timer.event.is_relative
  if is_relative and not sec then return set(fsm, timer, false, 0) end
  local delay, rest = duration_of(fsm, timer)
  if is_relative then delay, rest = sec + delay, nsec + rest end
  return set(fsm, timer, delay, rest)
end

local function arm_now(fsm, timer)
  local time, sec, nsec = read(fsm, timer.event.is_relative)
  if not time then
    report_clock(fsm, sec)
    return arm(fsm, timer, false, 0)
  end
  arm(fsm, timer, normalise(sec, nsec))
end

-- Arms the timers of a state that have a function or an e_at.
local function arm_unusual(fsm, timers)
  for _, timer in ipairs(timers) do
    if not is_usual(timer.event) then arm(fsm, timer, timers.sec, timers.nsec) end
  end
end

local function enter_state(fsm, state)
  local timers, own = state._timers, fsm._timeevent
  local is_unusual = own.is_unusual
  if is_unusual and own.has_at then own[false] = -huge end
  local soon = own[true]
  own[true] = -huge
  timers.sec, timers.entry = false, timers.entry + 1
  local time, sec, nsec = read(fsm, true)
  if time then
    timers.sec, timers.nsec = normalise(sec, nsec)
    time = time + timers.delay
    if not is_unusual then own[true] = time < soon and time or soon end
  else
    report_clock(fsm, sec)
  end
  if is_unusual then arm_unusual(fsm, timers) end
end

-- Returns the nanoseconds from the time `now` until the time `sec`, negative if `sec`
-- has passed. Each time is given as seconds and nanoseconds.
local function time_left(sec, nsec, now, now_nsec)
  return floor((sec - now) * 1e9 + (nsec - now_nsec) + 0.5)
end

-- Returns the nanoseconds until a timer expires. One without a known deadline is armed.
local function left_of(fsm, timer, now, now_nsec)
  local sec, nsec = deadline_of(timer)
  if not sec then sec, nsec = arm(fsm, timer, now, now_nsec) end
  return time_left(sec, nsec, now, now_nsec)
end

-- Returns where a timer belongs in a list of expired ones up to number `at`: the
-- earliest is first.
local function place_of(list, at, fsm, left, now, now_nsec)
  if at < 1 or left_of(fsm, list[at], now, now_nsec) <= left then return at + 1 end
  return place_of(list, at - 1, fsm, left, now, now_nsec)
end

-- An expiry has no loop: LuaJIT would give up a host's loop around loops that mostly
-- turn once. So the functions from here to `raise_expired` recurse.

-- Appends the expired timers of one kind to a list: those of a state from number `i`
-- on, then of its active child. Returns the least of `least` and the nanoseconds that
-- others have left.
local function append_expired(list, state, i, least, fsm, is_relative, now, now_nsec)
  local timers, child = state._timers, state._actchild
  local timer = timers and timers[i]
  if not timer then
    if not child then return least end
    return append_expired(list, child, 1, least, fsm, is_relative, now, now_nsec)
  elseif timer.event.is_relative == is_relative then
    local left = left_of(fsm, timer, now, now_nsec)
    if left >= 0 then
      least = min(least, left)
    elseif list[1] == nil then
      list[1] = timer
    else
      insert(list, place_of(list, #list, fsm, left, now, now_nsec), timer)
    end
  end
  return append_expired(list, state, i + 1, least, fsm, is_relative, now, now_nsec)
end

-- Lists the expired timers of one kind, e_after or e_at, the earliest first. Also
-- returns the nanoseconds to the next expiry.
local function find_expired(fsm, is_relative, now, now_nsec)
  local list = {}
  if fsm._mode == "inactive" then return list, huge end
  return list, append_expired(list, fsm, 1, huge, fsm, is_relative, now, now_nsec)
end

-- Returns the next send and the nanoseconds until its time; nil and huge if none waits.
local function next_send(fsm, sec, nsec)
  local sends = fsm._timeevent.sends
  local send = sends[#sends]
  return send, send and time_left(send.sec, send.nsec, sec, nsec) or huge
end

-- Moves due sends to the list `events`. Returns the nanoseconds until the next send. A
-- send notes its position there, so that after an interrupt it comes once.
local function raise_sends(fsm, events, sec, nsec)
  local send, left = next_send(fsm, sec, nsec)
  if left >= 0 then return left end
  send.at = send.at or #events + 1
  events[send.at] = send.event
  remove(fsm._timeevent.sends)
  report(fsm, "dbg", "TIMEEVENT", send.event)
  return raise_sends(fsm, events, sec, nsec)
end

-- Arms an expired timer for its next time, if it is repeated. Times that have passed
-- are skipped; `now` is the present. Returns the deadline, which is huge if none is to
-- come.
local function arm_again(fsm, timer, now, now_nsec)
  if not timer.event.is_repeated then return set(fsm, timer, huge, 0) end
  local sec, nsec = deadline_of(timer)
  local period, rest = duration_of(fsm, timer)
  local missed = -time_left(sec, nsec, now, now_nsec) / (period * 1e9 + rest)
  local count = max(ceil(missed), 1)
  return set(fsm, timer, normalise(sec + count * period, nsec + count * rest))
end

local function has(events, i, name)
  if events[i] == nil then return false end
  return events[i] == name or has(events, i + 1, name)
end

-- Appends the event of an expired timer to the current events, after an interrupt at
-- the same place again. A time of an e_every is missed while the event of one waits.
local function raise_timer(fsm, timer)
  local events, own = fsm._curq, fsm._timeevent
  if timer.event.is_repeated and has(events, 1, timer.name) then return false end
  if own.raised ~= timer or own.turn ~= fsm._turn then
    own.at = #events + 1
    own.raised = timer
    own.turn = fsm._turn
  end
  events[own.at] = timer.name
  return true
end

-- Appends the events of a list of expired timers, from number `i` on, to the current
-- events, and arms them again. Returns the least of `least` and the nanoseconds that
-- these have left.
local function raise_timers(fsm, expired, i, least, sec, nsec)
  local timer = expired[i]
  if not timer then return least end
  local is_raised = raise_timer(fsm, timer)
  local again, rest = arm_again(fsm, timer, clock.present(sec, nsec))
  if again < huge then least = min(least, time_left(again, rest, sec, nsec)) end
  if is_raised then report(fsm, "dbg", "TIMEEVENT", timer.name) end
  return raise_timers(fsm, expired, i + 1, least, sec, nsec)
end

-- Appends the events of expired timers, and sends that are due, to the current events.
local function raise_expired(fsm, is_relative, time, sec, nsec)
  if not time then return report_clock(fsm, sec) end
  sec, nsec = normalise(sec, nsec)
  local expired, least = find_expired(fsm, is_relative, sec, nsec)
  least = raise_timers(fsm, expired, 1, least, sec, nsec)
  if is_relative then least = min(least, raise_sends(fsm, fsm._curq, sec, nsec)) end
  fsm._timeevent[is_relative] = time + least * 1e-9 - MARGIN
end

-- Raises the time events of an iteration. Every iteration calls this function, so it
-- compares with the literal 1e300, which is faster than the upvalue `huge`.
local function check_timers(fsm)
  local own = fsm._timeevent
  local soon, soon_at = own[true], own[false]
  if soon < 1e300 then
    local time, sec, nsec = read(fsm, true)
    if not time or time >= soon then raise_expired(fsm, true, time, sec, nsec) end
  end
  if soon_at < 1e300 then
    local time, sec, nsec = read(fsm, false)
    if not time or time >= soon_at then raise_expired(fsm, false, time, sec, nsec) end
  end
end

-- Returns the time. If the clock fails, calls `raise` with the text and 0.
local function read_or_raise(fsm, is_relative, raise)
  local time, sec, nsec = read(fsm, is_relative)
  if time then return normalise(sec, nsec) end
  raise("rfsm_timeevent: the clock failed: " .. text_of(sec), 0)
end

-- Returns the machine of a state.
local function machine_of(state)
  while state._parent ~= state do state = state._parent end
  return state
end

-- Sends: events whose time comes later ---------------------------------------------

--- A send: an event of `send_after` that waits for its time.
---@class rfsm_timeevent.Send
---@field event any
---@field id any the id by which `cancel` finds the event, or nil
---@field sec number the time at which the event is sent, in whole seconds
---@field nsec number nanoseconds in addition to `sec`

local function drop_sends(fsm) fsm._timeevent.sends = {} end

-- After a reset no timer is armed.
local function disarm(fsm)
  local own = fsm._timeevent
  drop_sends(fsm)
  own[true], own[false] = huge, huge
end

-- Lists f(send) for each waiting send, the earliest first. Returns nil if none waits.
local function list_sends(fsm, f)
  local own, list = fsm._timeevent, nil
  for at = own and #own.sends or 0, 1, -1 do
    list = list or {}
    list[#list + 1] = f(own.sends[at])
  end
  return list
end

local function event_of(send) return send.event end

local function list_waiting(fsm) return list_sends(fsm, event_of) end

-- Gives a machine the hook that raises its time events. The hook is called before all
-- hooks that look at the events.
local function prepare_machine(fsm)
  if fsm._timeevent then return end
  fsm._timeevent = { [true] = huge, [false] = huge, has_timers = false, has_at = false,
    is_unusual = false, sends = {}, raised = false, turn = 0, at = 0, now = false,
    now_nsec = 0 }
  rfsm.source_hook_add(fsm, rfsm.repeatable(check_timers))
  rfsm.reset_hook_add(fsm, disarm)
  rfsm.waiting_hook_add(fsm, list_waiting)
end

-- Inserts a send into the list, which is sorted by time, the latest first. Of sends
-- with the same time the one added first comes last, so it is sent first. `own[true]`
-- is set before the insertion, so that an interrupt cannot hide the send.
local function add_send(fsm, event, id, sec, nsec)
  local own = fsm._timeevent
  local sends, from, to = own.sends, 1, #own.sends
  while from <= to do
    local at = floor((from + to) / 2)
    if time_left(sends[at].sec, sends[at].nsec, sec, nsec) > 0 then
      from = at + 1
    else
      to = at - 1
    end
  end
  own[true] = min(own[true], sec + nsec * 1e-9 - MARGIN)
  insert(sends, from, { event = event, id = id, sec = sec, nsec = nsec })
end

local function find_send(fsm, id)
  for at, send in ipairs(fsm._timeevent and fsm._timeevent.sends or {}) do
    if rawequal(send.id, id) then return at end
  end
end

-- Snapshots keep the times of timers and sends. A robot takes none.
local snapshots

do
  local engine = { add_send = add_send, arm_now = arm_now, deadline_of = deadline_of,
    drop_sends = drop_sends, is_usual = is_usual, list_sends = list_sends,
    normalise = normalise, prepare_machine = prepare_machine,
    read_or_raise = read_or_raise, set = set }

  -- Returns the function of rfsm/clock/snapshots.lua that has the given name.
  function snapshots(name)
    return function(...)
      local f = engine[name]
      if f then return f(...) end
      engine[name] = rfsm.find_module("rfsm.clock.snapshots")(engine)[name]
      return engine[name](...)
    end
  end
end

local save, load = snapshots "save", snapshots "load"
local save_sends, load_sends = snapshots "save_sends", snapshots "load_sends"

-- Prepare: the events of a model become timers -------------------------------------

-- Returns the list of timers of a state. The first call makes the list, and adds the
-- entry hook that arms the timers.
local function prepare_timers(fsm, state)
  prepare_machine(fsm)
  if not fsm._timeevent.has_timers then
    fsm._timeevent.has_timers = true
    rfsm.snapshot_hook_add(fsm, "timers", save, load)
  end
  if not state._timers then
    state._timers = { sec = false, nsec = 0, delay = huge, entry = 0 }
    rfsm.entry_hook_add(fsm, state, rfsm.repeatable(enter_state))
  end
  return state._timers
end

-- Returns the name of an event in the state `fqn`: "e_after(3)@root.a", with a number
-- if the name is taken. Also returns true if the event can share a timer of this name
-- in `timers`, because both always expire at the same time.
local function find_name(timers, event, fqn)
  local name, count = event.name .. "@" .. fqn, 1
  for _, timer in ipairs(timers) do
    local other = timer.event
    if timer.name == name then
      local is_same = event.sec and event.sec == other.sec and event.nsec == other.nsec
      if is_same or event == other then return name, true end
      count = count + 1
      name = ("%s#%d@%s"):format(event.name, count, fqn)
    end
  end
  return name, false
end

local function add_timer(fsm, state, name, event)
  local own, timers = fsm._timeevent, state._timers
  local timer = { name = name, event = event, timers = timers, entry = false }
  timers[#timers + 1] = timer
  if is_usual(event) then
    timers.delay = min(timers.delay, event.sec + event.nsec * 1e-9 - MARGIN)
  end
  own.has_at = own.has_at or not event.is_relative
  own.is_unusual = own.is_unusual or not is_usual(event)
  if state._mode ~= "inactive" then arm_now(fsm, timer) end -- a merge
end

-- Gives the source state of `tr` a timer for a time event. Returns the name of the
-- event with the FQN of this state.
local function expand(fsm, tr, event)
  local src = tr.src
  if not rfsm.is_state(src) then
    rfsm.warn(fsm, "init", ("%s: '%s' never fires here, '%s' is no state"):format(
      rfsm.location_of(tr, "events"), event.name, src._fqn))
    return event.name .. "@" .. src._fqn
  end
  local name, is_there = find_name(prepare_timers(fsm, src), event, src._fqn)
  if not is_there then add_timer(fsm, src, name, event) end
  return name
end

-- Expands each time event in a text, also in a text such as "await(e_a, e_after(2))".
-- A time event may have the FQN of its source already.
local function expand_text(fsm, tr, text)
  local own = "@" .. tr.src._fqn
  local plain = text:sub(-#own) == own and text:sub(1, -#own - 1) or text
  local event, problem = parse(plain)
  if event then return expand(fsm, tr, event) end
  local expanded = text:gsub("%f[%w_](e_%a+%s*%b())(@?)", function(inner, at)
    local other, wrong = parse(inner)
    problem = problem or wrong
    return other and at == "" and not problem and expand(fsm, tr, other) or nil
  end)
  if not problem then return expanded end
  rfsm.warn(fsm, "init", rfsm.location_of(tr, "events") .. ": " .. problem)
  return text
end

local function is_timed(obj) return rfsm.is_state(obj) and obj.timed == true end

-- This is the first preproc function, because the time events inside an "await(...)"
-- must have their names before rfsm.await reads them.
insert(rfsm.preproc, 1, function(fsm, merged)
  -- Each machine gets this hook: it may load a snapshot with sends before it has any.
  if not merged then rfsm.snapshot_hook_add(fsm, "sends", save_sends, load_sends) end
  for _, state in ipairs(rfsm.elements(merged or fsm, is_timed)) do
    prepare_timers(fsm, state)
  end
  for _, tr in ipairs(rfsm.elements(merged or fsm, rfsm.is_trans)) do
    for i, event in ipairs(tr.events) do
      if getmetatable(event) == Timeevent then
        tr.events[i] = expand(fsm, tr, event)
      elseif type(event) == "string" then
        tr.events[i] = expand_text(fsm, tr, event)
      end
    end
  end
end)

rfsm.makers[#rfsm.makers + 1] = function(event)
  local fqn = event:match("^e_after%s*%(.*@(root.*)$")
    or event:match("^e_every%s*%(.*@(root.*)$")
    or event:match("^e_at%s*%(.*@(root.*)$")
  if fqn then return "timer", fqn end
end

-- Public functions -----------------------------------------------------------------

--- Make an event that comes when its state has been active for more than `x` seconds.
--
-- @usage
--    local e_after = rfsm_timeevent.e_after
--    rfsm.trans { src = "green", tgt = "red", events = { e_after(2.5) } }
--
---@param x number|fun(id: any): number seconds, or a function that is called at each
-- entry and returns the seconds
---@param id? any argument of this function; it is also part of the event's name
---@return rfsm_timeevent.Timeevent event
---@nodiscard
function rfsm_timeevent.e_after(x, id) return (new_object("e_after", x, id)) end

--- Make an event that comes each `x` seconds while its state is active.
--
-- The times are counted from the entry, so they do not drift. Times that were missed
-- come once.
--
-- @usage
--    rfsm.trans { src = "on", tgt = "internal", events = { e_every(1) }, effect = log }
--
---@param x number|fun(id: any): number seconds, or a function that returns them
---@param id? any argument of this function; it is also part of the event's name
---@return rfsm_timeevent.Timeevent event
---@nodiscard
function rfsm_timeevent.e_every(x, id) return (new_object("e_every", x, id)) end

--- Make an event that comes when the clock shows more than `x`, if its state is active.
---@param x number|fun(id: any): number seconds on the clock, or a function that is
-- called at each entry and returns them
---@param id? any argument of this function; it is also part of the event's name
---@return rfsm_timeevent.Timeevent event
---@nodiscard
function rfsm_timeevent.e_at(x, id) return (new_object("e_at", x, id)) end

--- Is `value` a time event: an object, or a text such as "e_after(3)"?
---@param value any
---@return boolean
function rfsm_timeevent.is_timeevent(value)
  if getmetatable(value) == Timeevent then return true end
  return type(value) == "string" and parse((value:gsub("@.*$", ""))) ~= nil
end

--- Set the clock of the process, which machines without a field `gettime` read.
--
-- Set it before machines run, because armed timers keep their deadlines. A clock
-- returns seconds and nanoseconds, or one number of nanoseconds. It serves e_after and
-- e_at. A clock that needs a clock id is called with "CLOCK_MONOTONIC" for e_after and
-- "CLOCK_REALTIME" for e_at. The clock of RTT serves e_after only.
--
---@param gettime? fun(id?: string): number, number? nil for the best clock installed
function rfsm_timeevent.set_gettime_hook(gettime)
  if gettime ~= nil and not is_callable(gettime) then
    error("rfsm_timeevent.set_gettime_hook: function expected, got " .. type(gettime),
      2)
  end
  clock.set_hook(gettime)
end

-- Returns the least of `least` and of the nanoseconds that timers of a state have left.
local function least_left(fsm, timers, least)
  local own, is_relative, now, now_nsec = fsm._timeevent, nil, nil, nil
  for i = 1, #timers do
    local kind = timers[i].event.is_relative
    if own[kind] ~= huge then
      if kind ~= is_relative then
        is_relative, now, now_nsec = kind, read_or_raise(fsm, kind, error)
      end
      least = min(least, left_of(fsm, timers[i], now, now_nsec))
    end
  end
  return least
end

-- Returns the nanoseconds until a machine, or an active region in it, raises its next
-- time event or sends an event; huge if neither is to come.
local function earliest(fsm)
  local own, state, least = fsm._timeevent, fsm._mode ~= "inactive" and fsm, huge
  if own and own.sends[1] then
    local _, left = next_send(fsm, read_or_raise(fsm, true, error))
    least = left
  end
  while state do
    local regions = state._regions
    if state._timers then least = least_left(fsm, state._timers, least) end
    for i = 1, regions and #regions or 0 do least = min(least, earliest(regions[i])) end
    state = state._actchild
  end
  return least
end

--- Send an event to a machine when more than `seconds` have passed.
--
-- The time is measured by the machine's clock. The event is sent whatever state is
-- active then. Events with the same time are sent in the order of the calls.
--
-- @usage
--    rfsm_timeevent.send_after(fsm, 5, "e_retry", "retry")
--    rfsm_timeevent.cancel(fsm, "retry") --> true
--
-- @raise if `seconds` is infinite or below 0, if an event with this id already waits,
-- or if the clock fails
---@param fsm rfsm.Machine
---@param seconds number finite, not below 0
---@param event any
---@param id? any by which `cancel` finds the event
function rfsm_timeevent.send_after(fsm, seconds, event, id)
  local where = "rfsm_timeevent.send_after: "
  rfsm.check_machine(fsm, "rfsm_timeevent.send_after")
  if type(seconds) ~= "number" or not (seconds >= 0 and seconds < huge) then
    error(where .. "seconds, a finite number not below 0, expected, "
      .. rfsm.got(seconds), 2)
  elseif event == nil then
    error(where .. "event expected, got nil", 2)
  elseif id ~= nil and find_send(fsm, id) then
    error(where .. "an event with the id " .. text_of(id) .. " is waiting", 2)
  end
  local now, sec, nsec = read(fsm, true)
  if not now then error(where .. "the clock failed: " .. text_of(sec), 2) end
  prepare_machine(fsm)
  sec, nsec = normalise(sec, nsec)
  local delay, rest = normalise(seconds, 0)
  add_send(fsm, event, id, normalise(sec + delay, nsec + rest))
end

--- Drop an event of `send_after` that has not been sent yet.
---@param fsm rfsm.Machine
---@param id any the `id` given to `send_after`
---@return boolean was_there false if no event with this id waits
function rfsm_timeevent.cancel(fsm, id)
  rfsm.check_machine(fsm, "rfsm_timeevent.cancel")
  local at = id ~= nil and find_send(fsm, id)
  if at then remove(fsm._timeevent.sends, at) end
  return at and true or false
end

--- Return the seconds since a state was entered.
--
-- They are known if a time event leaves the state, or if the state has `timed = true`.
--
-- @raise if they are not known, or if the clock fails
---@param state rfsm.State a state of a machine
---@return number? seconds nil while the state is inactive
function rfsm_timeevent.time_in(state)
  if not rfsm.is_state(state) or not state._mode then
    error("rfsm_timeevent.time_in: state of a machine expected, " .. rfsm.got(state), 2)
  end
  local timers = rawget(state, "_timers")
  if timers and state._mode == "inactive" then return nil end
  if not (timers and timers.sec) then
    local was_missed = timers and is_timed(state)
    error(("rfsm_timeevent.time_in: the time of '%s' is not known (%s)"):format(
      state._fqn, was_missed and "an interrupt or a failed clock at its entry, or a "
      .. "snapshot without it" or "timed = true in the state"), 2)
  end
  local sec, nsec = read_or_raise(machine_of(state), true, error)
  return sec - timers.sec + (nsec - timers.nsec) / 1e9
end

--- Have an inactive machine begin in a leaf, as if entered, but without callbacks.
--
-- For programs that keep only the name of the state. The timers of the leaf and of the
-- states around it are armed, e_done comes as after an entry, regions begin anew. The
-- queue loses `e_init_fsm`; other events stay.
--
-- @raise if the machine is active, or has no such leaf
---@param fsm rfsm.Machine
---@param leaf rfsm.State|string a leaf of the machine, or its FQN
function rfsm_timeevent.enter_at(fsm, leaf)
  rfsm.check_machine(fsm, "rfsm_timeevent.enter_at")
  local sends = fsm._timeevent and fsm._timeevent.sends
  rfsm.begin_in(fsm, leaf, "rfsm_timeevent.enter_at")
  if sends and sends[1] then
    fsm._timeevent.sends, fsm._timeevent[true] = sends, -huge
  end
end

--- Return how long a host may sleep: seconds until the next timer can fire.
--
-- A step before that time finds no time event, the first step after it does. The timers
-- of regions in an active sequential AND state are included.
--
-- @raise if the clock fails
---@param fsm rfsm.Machine
---@return number? seconds 0 if a timer has expired already; nil if no timer is armed
-- and no event of `send_after` waits
function rfsm_timeevent.next_deadline(fsm)
  rfsm.check_machine(fsm, "rfsm_timeevent.next_deadline")
  local least = earliest(fsm)
  if least < 0 then return 0 end
  return least < huge and (least + 1) / 1e9 or nil
end

if not rawget(_G, "RFSM_NO_GLOBALS") then
  rawset(_G, "rfsm_timeevent", rfsm_timeevent)
end

return rfsm_timeevent
