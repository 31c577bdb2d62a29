--- The clock of the machines in a server.
--
-- A running machine does not see the server's clock, but this clock. This clock begins
-- at the time at which the machine was saved, jumps to each time at which a timer or an
-- event was due, and ends at the time of the call.
--
-- @module rfsm.server.times
-- @license BSD-3-Clause

local clock = require "rfsm.clock"

local floor, max = math.floor, math.max

local times = {}

-- `host` is the server, from which the time of a call is read when it is needed. `sec`
-- and `nsec` are the time that machines see. A time that was not read yet is false.
local host, call_sec, call_nsec = nil, false, 0
local sec, nsec = false, 0

local function read()
  if not call_sec then call_sec, call_nsec = host.time() end
  return call_sec, call_nsec
end

--- Return the time that machines see: seconds and nanoseconds.
function times.get()
  if not sec then sec, nsec = read() end
  return sec, nsec
end

--- Return the time that machines see, as one number of seconds.
function times.seen()
  local seconds, nanoseconds = times.get()
  return seconds + nanoseconds / 1e9
end

--- Return the time of the call, as one number of seconds.
function times.now()
  if not call_sec then read() end
  return call_sec + call_nsec / 1e9
end

--- Set the time that machines see; false stands for the time of the call.
function times.set(seconds, nanoseconds) sec, nsec = seconds, nanoseconds or 0 end

--- Let seconds pass for machines.
function times.advance(seconds)
  times.get()
  local whole = floor(seconds)
  local rest = nsec + floor((seconds - whole) * 1e9 + 0.5)
  sec, nsec = sec + whole + floor(rest / 1e9), rest % 1e9
end

--- Let time pass until `seconds`, a time as one number, exact to the microsecond.
function times.advance_to(seconds)
  local whole = floor(seconds)
  local rest = floor((seconds - whole) * 1e6 + 0.5) * 1000
  times.advance(max(0, whole - times.get() + (rest - nsec) / 1e9))
end

--- Begin a call: the time is read anew.
function times.begin() call_sec, sec = false, false end

--- Have all machines use this clock, and read the times of calls from a server.
function times.open(server)
  host = server
  clock.set_hook(times.get, read)
end

return times
