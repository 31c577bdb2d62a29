-- The finest clock there is, in nanoseconds: clock.find() returns { name =, now = }. A
-- reading leaves no garbage, so that a measurement does not set the collector to work.

local clock = {}

-- On LuaJIT the kernel's own. The fields are read as halves, because a whole 64 bit
-- integer is an object there, unless compiled.
local function from_ffi()
  local ffi = require "ffi"
  ffi.cdef "int clock_gettime(int id, void *spec);"
  local MONOTONIC, gettime, spec = 1, ffi.C.clock_gettime, ffi.new("int32_t[4]")
  local seconds = ffi.abi("64bit") and ffi.abi("be") and 1 or 0
  local nanoseconds = seconds + (ffi.abi("64bit") and 2 or 1)
  return { name = "clock_gettime(CLOCK_MONOTONIC), ffi", now = function()
    gettime(MONOTONIC, spec)
    return spec[seconds] * 1e9 + spec[nanoseconds]
  end }
end

local function from_luv()
  return { name = "luv.hrtime", now = require("luv").hrtime }
end

-- Microseconds only.
local function from_socket()
  local gettime = require("socket").gettime
  return { name = "socket.gettime", now = function() return gettime() * 1e9 end }
end

--- Returns the finest clock; nil when no package has one.
function clock.find()
  for _, make in ipairs({ from_ffi, from_luv, from_socket }) do
    local ok, found = pcall(make)
    if ok and pcall(found.now) then return found end
  end
end

return clock
