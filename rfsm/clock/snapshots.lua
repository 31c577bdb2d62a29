--- Snapshots of time: they keep the time left until an e_after or a send, and the
-- deadline of an e_at.
--
-- rfsm_timeevent loads this file when a machine is saved or restored, because a robot
-- takes no snapshots.
--
-- @module rfsm.clock.snapshots
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, ipairs, type = error, ipairs, type
local abs, huge = math.abs, math.huge

---@param engine table<string, function> functions of rfsm_timeevent
---@return table<string, function> functions for `rfsm.snapshot_hook_add`
return function(engine)
  local add_send, normalise, set = engine.add_send, engine.normalise, engine.set

  local MAX_EXACT = 1000000 -- seconds; a float below this is exact to the nanosecond

  local function kept_time(sec, nsec)
    sec, nsec = normalise(sec, nsec)
    if abs(sec) >= MAX_EXACT then return { sec, nsec } end
    return nsec == 0 and sec or sec + nsec / 1e9
  end

  -- Raises a table with `text`: then the machine cannot be saved, and an observer does
  -- without.
  local function fail(text) error({ text = text }, 0) end

  -- Returns the time, which is the same for all timers of a save or load: times that
  -- are equal stay so.
  local function time_of(fsm)
    local own = fsm._timeevent
    if not own.now then
      own.now, own.now_nsec = engine.read_or_raise(fsm, true, fail)
    end
    return own.now, own.now_nsec
  end

  -- The name under which snapshots have the seconds since the entry of a timed state.
  local function name_of_time(state) return "time_in@" .. state._fqn end

  -- Returns what a snapshot keeps of a timer; nil if it is not armed.
  local function kept_timer(fsm, timer)
    local sec, nsec = engine.deadline_of(timer)
    if not sec then return true end
    if sec == huge then return nil end
    if timer.event.is_relative then
      local since, rest = time_of(fsm)
      sec, nsec = sec - since, nsec - rest
    end
    return kept_time(sec, nsec)
  end

  -- Adds what a snapshot keeps of the timers of a state to a list, or makes one (nil:
  -- none yet); of a timed state also the seconds since its entry. Returns the list.
  local function save_state(fsm, state, left)
    local timers = state._timers
    for i = 1, #timers do
      local kept = kept_timer(fsm, timers[i])
      if kept ~= nil then
        left = left or {}
        left[timers[i].name] = kept
      end
    end
    if timers.sec and state.timed == true then
      local sec, nsec = time_of(fsm)
      left = left or {}
      left[name_of_time(state)] = kept_time(sec - timers.sec, nsec - timers.nsec)
    end
    return left
  end

  local function save(fsm)
    fsm._timeevent.now = false
    local state, left = fsm._mode ~= "inactive" and fsm, nil
    while state do
      if state._timers then left = save_state(fsm, state, left) end
      state = state._actchild
    end
    return left
  end

  -- Returns the seconds and nanoseconds of a time in a snapshot. There the time is a
  -- number of seconds, or a list of seconds and nanoseconds.
  local function loaded_time(left, what, name)
    local sec, nsec = left, 0
    if type(left) == "table" then sec, nsec = left[1], left[2] end
    if type(sec) ~= "number" or type(nsec) ~= "number" or sec - sec ~= nsec - nsec then
      error("seconds and nanoseconds expected for " .. what
        .. (name and name .. "'" or ""), 0)
    end
    return normalise(sec, nsec)
  end

  -- Arms a timer with the time `left` from a snapshot. `left` is `true` if the deadline
  -- was not known when the snapshot was taken.
  local function load_timer(fsm, timer, left)
    if left == true then return set(fsm, timer, false, 0) end
    local sec, nsec = loaded_time(left, "timer '", timer.name)
    if not timer.event.is_relative then return set(fsm, timer, sec, nsec) end
    local since, rest = time_of(fsm)
    set(fsm, timer, sec + since, nsec + rest)
  end

  -- Loads a timer, or arms it from now on if it is new in a changed chart. The deadline
  -- of an e_after tells the time of the entry.
  local function load_or_arm(fsm, timer, left, how)
    local timers, event = timer.timers, timer.event
    if left ~= nil then
      load_timer(fsm, timer, left)
    elseif how.is_migrated and how.is_new(timer.name) then
      engine.arm_now(fsm, timer)
    else
      return set(fsm, timer, huge, 0)
    end
    if not event.is_repeated and engine.is_usual(event) and timer.sec
      and timer.sec < huge then
      timers.sec, timers.nsec = timer.sec - event.sec, timer.nsec - event.nsec
    end
  end

  -- Loads the timers of a state. Removes what it has loaded from `left`.
  local function load_state(fsm, state, left, how)
    local timers, name = state._timers, state.timed == true and name_of_time(state)
    timers.sec = false
    for i = 1, #timers do
      local timer = timers[i]
      load_or_arm(fsm, timer, left[timer.name], how)
      left[timer.name] = nil
    end
    if name and left[name] ~= nil then
      local sec, nsec = loaded_time(left[name], "'", name)
      local since, rest = time_of(fsm)
      timers.sec, timers.nsec, left[name] = since - sec, rest - nsec, nil
    end
  end

  -- Loads the timers of a snapshot. In a migration to a changed chart, a timer that is
  -- new in the chart is armed from now on, and one that the chart lacks is dropped.
  local function load(fsm, left, how)
    local own, state = fsm._timeevent, fsm._mode ~= "inactive" and fsm
    left, own.now = left or {}, false
    own[true], own[false] = own.sends[1] and -huge or huge, huge
    while state do
      if state._timers then load_state(fsm, state, left, how) end
      state = state._actchild
    end
    local name = rfsm.sorted_keys(left)[1]
    if how.is_migrated or name == nil then return end
    error("no active state has a timer '" .. rfsm.text_of(name) .. "'", 0)
  end

  local function save_sends(fsm)
    if not fsm._timeevent then return nil end
    fsm._timeevent.now = false
    return engine.list_sends(fsm, function(send)
      local since, rest = time_of(fsm)
      return { event = send.event, id = send.id,
        after = kept_time(send.sec - since, send.nsec - rest) }
    end)
  end

  local function load_sends(fsm, kept)
    if fsm._timeevent then engine.drop_sends(fsm) end
    if kept == nil then return end
    engine.prepare_machine(fsm)
    fsm._timeevent.now = false
    local since, rest = time_of(fsm)
    for _, send in ipairs(kept) do
      if type(send) ~= "table" or send.event == nil then
        error("list of events with `after` expected", 0)
      end
      local sec, nsec = loaded_time(send.after, "an event that is sent later")
      add_send(fsm, send.event, send.id, normalise(sec + since, nsec + rest))
    end
  end

  return { save = save, load = load, save_sends = save_sends, load_sends = load_sends }
end
