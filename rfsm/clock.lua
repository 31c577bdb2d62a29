--- Clocks: the time as two whole numbers, seconds and nanoseconds, never as one float.
--
-- `clock.read` reads the clock that was given to `clock.set_hook`. Without one it reads
-- the best clock that is installed: rtp, luaposix, luasocket, `os.time`.
--
-- @module rfsm.clock
-- @license BSD-3-Clause

local error, pcall, rawget, require = error, pcall, rawget, require
local setmetatable, tonumber, type = setmetatable, tonumber, type
local floor = math.floor

local clock = {}

-- Times: whole seconds, and whole nanoseconds from 0 below a billion -------------

local BILLION = 1000000000

local function is_finite(x) return x - x == 0 end

--- Carry whole seconds from nanoseconds to seconds. Both may have a fraction.
---@param sec number
---@param nsec number
---@return number sec
---@return number nsec
function clock.normalise(sec, nsec)
  local whole = floor(sec)
  nsec = floor(nsec) + floor((sec - whole) * BILLION + 0.5)
  local carry = floor(nsec / BILLION)
  return whole + carry, nsec - carry * BILLION
end

--- Split seconds in one number, which may be infinite.
---@param seconds number
---@return number sec
---@return number nsec
function clock.from_number(seconds)
  if not is_finite(seconds) then return seconds, 0 end
  return clock.normalise(seconds, 0)
end

--- Split a text such as "0.25", digit by digit.
---@param text string
---@return number? sec nil if the text is no number of seconds
---@return number? nsec
function clock.from_text(text)
  local whole, fraction = text:match("^%s*(%d*)%.?(%d*)%s*$")
  if not whole then
    local number = text:match("^%s*%d*%.?%d*[eE][+-]?%d+%s*$") and tonumber(text)
    if number then return clock.from_number(number) end
    return nil
  elseif whole == "" and fraction == "" then
    return nil
  end
  local digits = (fraction .. ("0"):rep(10)):sub(1, 10) -- the tenth only rounds
  return clock.normalise(tonumber("0" .. whole), floor(tonumber(digits) / 10 + 0.5))
end

-- Splits nanoseconds in one number; exact, since the remainder is taken off first.
local function from_nanoseconds(ns)
  ns = floor(ns)
  local nsec = ns % BILLION
  if nsec < 0 then nsec = nsec + BILLION end -- Lua 5.1 rounds large quotients up
  return (ns - nsec) / BILLION, nsec
end

-- Clocks that are installed ------------------------------------------------------

-- Returns a module by its name, or by the global that it sets; nil if there is none.
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
  local id = is_monotonic and "monotonic" or "realtime"
  return gettime and function() return gettime(id) end
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
    local found = FINDERS[i](is_monotonic)
    if found and pcall(found) then return found end
  end
  return no_clock
end

-- The clock in use ---------------------------------------------------------------

local hook = nil

--- The function that reads the time, by whether the clock should be monotonic. It is
-- found when it is first needed.
---@type table<boolean, fun(): number, number?>
clock.in_use = setmetatable({}, { __index = function(in_use, is_monotonic)
  in_use[is_monotonic] = hook or find_clock(is_monotonic)
  return in_use[is_monotonic]
end })

--- Set the clock.
--
-- It returns seconds and nanoseconds, or nanoseconds in one number. One that fails
-- without an argument, and works with "CLOCK_MONOTONIC", is called with that.
--
---@param gettime? fun(id?: string): number, number? nil: the best clock installed
function clock.set_hook(gettime)
  hook = gettime
  if gettime and not pcall(gettime) and pcall(gettime, "CLOCK_MONOTONIC") then
    hook = function() return gettime("CLOCK_MONOTONIC") end
  end
  clock.in_use[true], clock.in_use[false] = nil, nil
end

--- Return the time; an error of the clock is returned, not raised.
---@param is_monotonic boolean prefer a clock that is never set?
---@return number? sec nil if the clock fails
---@return number|any nsec the error in that case
function clock.read(is_monotonic)
  local ok, sec, nsec = pcall(clock.in_use[is_monotonic])
  if not ok then
    return nil, sec
  elseif type(sec) ~= "number" or nsec ~= nil and type(nsec) ~= "number" then
    local got = type(sec) == "number" and type(nsec) or type(sec)
    return nil, "seconds and nanoseconds expected, got " .. got
  elseif not (is_finite(sec) and is_finite(nsec or 0)) then
    return nil, "a time must be finite"
  elseif nsec then
    return clock.normalise(sec, nsec)
  end
  return from_nanoseconds(sec)
end

return clock
