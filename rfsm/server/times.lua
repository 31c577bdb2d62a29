--- The clock of the machines in a server.
--
-- While a machine runs it does not follow the server's clock. It begins at the time at
-- which the machine was saved, jumps to each time at which something was due, and ends
-- at the time of the call.
--
-- @module rfsm.server.times
-- @license BSD-3-Clause

local clock = require "rfsm.clock"

local floor, max = math.floor, math.max

local times = {}

-- The time of the call, false until it is needed, and the time that machines see.
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

--- Return the same in one number.
function times.seen()
  if not sec then sec, nsec = read() end
  return sec + nsec / 1e9
end

--- Return the time of the call in one number.
function times.now()
  if not call_sec then read() end
  return call_sec + call_nsec / 1e9
end

--- Set the time that machines see; false: to that of the call.
function times.set(seconds, nanoseconds) sec, nsec = seconds, nanoseconds or 0 end

--- Let seconds pass for machines.
function times.advance(seconds)
  times.get()
  local whole = floor(seconds)
  local rest = nsec + floor((seconds - whole) * 1e9 + 0.5)
  sec, nsec = sec + whole + floor(rest / 1e9), rest % 1e9
end

--- Let time pass until a time in one number, which is exact to the microsecond.
function times.advance_to(seconds)
  local whole = floor(seconds)
  local rest = floor((seconds - whole) * 1e6 + 0.5) * 1000
  times.advance(max(0, whole - times.get() + (rest - nsec) / 1e9))
end

--- Begin a call: the time is read anew.
function times.begin() call_sec, sec = false, false end

--- Have machines read this clock, whose time is that of a server.
function times.open(server)
  host = server
  clock.set_hook(times.get)
end

return times
