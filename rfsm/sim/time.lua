--- The simulated clock of a session.
--
-- It goes on from the time of the real clock, so that armed timers keep their
-- deadlines. Time passes only by `pass` and `go_to_timer`.
--
-- @module rfsm.sim.time
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local clock = require "rfsm.clock"
local history = require "rfsm.sim.history"
local instrument = require "rfsm.shared.instrument"

local error, pcall = error, pcall
local floor, min = math.floor, math.min
local print, rawget = print, rawget
local text_of = rfsm.text_of

local time = {}

--- The time that has passed, and the times at which the two clocks began.
---@class rfsm.sim.Time
---@field sec number
---@field nsec number
---@field starts table<boolean, { sec: number, nsec: number }> true: for e_after
---@field changes table[] the real clock of the machine

--- Have the timers of a machine read the simulated clock, if a session has one.
function time.install(sim, fsm)
  local now = sim.time
  if not now then return end
  local function simulated(start)
    return function() return start.sec + now.sec, start.nsec + now.nsec end
  end
  instrument.put(now.changes, fsm, "gettime", clock.twofold(simulated(now.starts[true]),
    simulated(now.starts[false])))
end

local function read(fsm, is_monotonic)
  local own = rawget(fsm, "gettime")
  local ok, sec, nsec = pcall((own and clock.split(own) or clock.in_use)[is_monotonic])
  if not ok then error("clock: the clock failed: " .. text_of(sec), 0) end
  return { sec = nsec and sec or 0, nsec = nsec or sec }
end

local function start(sim)
  if sim.time then return end
  local starts = { [true] = read(sim.fsm, true), [false] = read(sim.fsm, false) }
  history.pause(sim, function()
    sim.time = { sec = 0, nsec = 0, changes = {}, starts = starts }
    time.install(sim, sim.fsm)
  end)
end

--- Go on with the real clock.
function time.use_real(sim)
  if not sim.time then return end
  history.pause(sim, function()
    instrument.give_back(sim.time.changes)
    sim.time = nil
  end)
end

--- Return seconds for a reader.
function time.text(seconds)
  if seconds < 1 then return ("%.6g s"):format(seconds) end
  return (("%.3f"):format(seconds):gsub("%.?0+$", "")) .. " s"
end

local function leap(now, seconds)
  local nsec = now.nsec + floor(seconds % 1 * 1e9 + 0.5)
  now.sec = now.sec + floor(seconds) + floor(nsec / 1e9)
  now.nsec = nsec % 1e9
end

--- Print the time.
function time.show(sim)
  local now = sim.time
  print("clock:  " .. (now and time.text(now.sec + now.nsec / 1e9) or "real time"))
end

local MAX_STEPS = 1000 -- a doo that is never idle would take all others

--- Let simulated seconds pass.
--
-- The machine is advanced at each timer on the way, and at the end.
function time.pass(sim, seconds)
  start(sim)
  history.mark(sim)
  repeat
    local step = min(seconds, clock.until_timer(sim.fsm) or seconds)
    leap(sim.time, step)
    seconds = seconds - step
    time.show(sim)
    sim:advance(MAX_STEPS)
  until seconds <= 0
end

--- Go to the next timer.
function time.go_to_timer(sim)
  start(sim)
  local seconds = clock.until_timer(sim.fsm)
  if not seconds then error("next: no timer is armed", 0) end
  time.pass(sim, seconds)
end

return time
