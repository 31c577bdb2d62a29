--- The simulated clock of a session.
--
-- It begins at the time of the real clock, so that armed timers keep their deadlines.
-- Then time passes only by `pass` and `go_to_timer`.
--
-- @module rfsm.sim.time
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local clock = require "rfsm.clock"
local history = require "rfsm.sim.history"
local instrument = require "rfsm.shared.instrument"

local error, min, print = error, math.min, print
local text_of = rfsm.text_of

local time = {}

--- A simulated clock: the real time at which it began, and the time passed since.
---@class rfsm.sim.Time
---@field passed rfsm.clock.Clock the time that has passed
---@field starts table<boolean, { sec: number, nsec: number }> the real clock at the
-- beginning: `starts[true]` for e_after; `starts[false]` (time of day) for e_at
---@field changes table[] the replaced fields `gettime` of machines, to be restored

--- Have the timers of a machine read the simulated clock, if a session has one.
function time.install(sim, fsm)
  local now = sim.time
  if not now then return end
  instrument.put(now.changes, fsm, "gettime", clock.new(function(_, is_relative)
    local start = now.starts[is_relative]
    return true, start.sec + now.passed.sec, start.nsec + now.passed.nsec
  end))
end

local function read(fsm, is_relative)
  local seconds, sec, nsec = clock.read(fsm, is_relative)
  if not seconds then error("clock: the clock failed: " .. text_of(sec), 0) end
  return { sec = sec, nsec = nsec }
end

local function start(sim)
  if sim.time then return end
  local starts = { [true] = read(sim.fsm, true), [false] = read(sim.fsm, false) }
  history.pause(sim)
  sim.time = { passed = clock.simulated(), changes = {}, starts = starts }
  time.install(sim, sim.fsm)
end

--- Switch back from the simulated to the real clock.
function time.use_real(sim)
  if not sim.time then return end
  history.pause(sim)
  instrument.give_back(sim.time.changes)
  sim.time = nil
end

--- Return a number of seconds as a text for a person.
function time.text(seconds)
  if seconds < 1 then return rfsm.number_text(seconds, "%.6g") .. " s" end
  return (rfsm.number_text(seconds, "%.3f"):gsub("%.?0+$", "")) .. " s"
end

--- Print the simulated time, or that the clock is real.
function time.show(sim)
  local now = sim.time
  print("clock:  " .. (now and time.text(now.passed:now()) or "real time"))
end

local MAX_STEPS = 1000 -- limit for one advance, because a doo may never be idle

--- Let simulated seconds pass; advance the machine at each timer, and at the end.
function time.pass(sim, seconds)
  start(sim)
  history.mark(sim)
  repeat
    local step = min(seconds, clock.until_timer(sim.fsm) or seconds)
    sim.time.passed:advance(step)
    seconds = seconds - step
    time.show(sim)
    sim:advance(MAX_STEPS)
  until seconds <= 0
end

--- Let the time pass until the next timer expires.
function time.go_to_timer(sim)
  start(sim)
  local seconds = clock.until_timer(sim.fsm)
  if not seconds then error("next: no timer is armed", 0) end
  time.pass(sim, seconds)
end

return time
