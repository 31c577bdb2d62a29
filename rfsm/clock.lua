--- Clocks: the clock of the process, or the best one that is installed.
--
-- The best one is that of a running RTT, then those of rtp, luaposix and luasocket,
-- then `os.time`. RTT, rtp and luaposix have a clock that is never set.
--
-- @module rfsm.clock
-- @license BSD-3-Clause

local error, getmetatable, pcall, rawequal = error, getmetatable, pcall, rawequal
local rawget, require, setmetatable, type = rawget, require, setmetatable, type

local clock = {}

-- Clocks that are installed ------------------------------------------------------

-- Returns a module by its name, or by the global that it sets; nil if there is none.
local function find_module(name)
  local ok, module = pcall(require, name)
  if not ok then return nil end
  if type(module) ~= "table" then module = rawget(_G, name) end
  return type(module) == "table" and module or nil
end

-- The Lua of RTT sets the global `rtt`. Its time begins with the computer.
local function find_rtt_clock(is_monotonic)
  local rtt = rawget(_G, "rtt")
  return is_monotonic and type(rtt) == "table" and rtt.getTime
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

local FINDERS = {
  find_rtt_clock, find_rtp_clock, find_posix_clock, find_socket_clock, find_os_clock,
}

--- Return the best clock that is installed.
---@param is_monotonic boolean prefer a clock that is never set to the time of day?
function clock.find(is_monotonic)
  for i = 1, #FINDERS do
    local found = FINDERS[i](is_monotonic)
    if found and pcall(found) then return found end
  end
  return no_clock
end

-- The clock in use ---------------------------------------------------------------

local hooks = {}

--- The function that reads the time, by whether the clock should be monotonic. It is
-- found when it is first needed.
---@type table<boolean, fun(): number, number?>
clock.in_use = setmetatable({}, { __index = function(in_use, is_monotonic)
  in_use[is_monotonic] = hooks[is_monotonic] or clock.find(is_monotonic)
  return in_use[is_monotonic]
end })

--- Set the clock of the process. It returns seconds and nanoseconds, or nanoseconds in
-- one number.
---@param gettime? fun(): number, number? nil: the best clock installed
---@param time_of_day? fun(): number, number? default the first one
function clock.set_hook(gettime, time_of_day)
  hooks[true], hooks[false] = gettime, time_of_day or gettime
  clock.in_use[true], clock.in_use[false] = nil, nil
end

-- A clock of two functions.
local Twofold = {}

function Twofold:__call(id) return self[id ~= "CLOCK_REALTIME"]() end

--- Return a clock for the field `gettime` of a machine from two functions.
---@param relative fun(): number, number? for e_after
---@param time_of_day fun(): number, number? for e_at
function clock.twofold(relative, time_of_day)
  return setmetatable({ [true] = relative, [false] = time_of_day }, Twofold)
end

--- Return the functions of a clock of the user, for e_after and for e_at.
--
-- If it wants a clock id, it is given one. The time of RTT is not the time of day. Any
-- other clock is for both.
--
---@return table<boolean, function> clocks true: for e_after
function clock.split(gettime)
  local rtt = rawget(_G, "rtt")
  if getmetatable(gettime) == Twofold then
    return gettime
  elseif type(rtt) == "table" and rawequal(rtt.getTime, gettime) then
    return { [true] = gettime, [false] = clock.find(false) }
  elseif pcall(gettime) or not pcall(gettime, "CLOCK_MONOTONIC") then
    return { [true] = gettime, [false] = gettime }
  end
  return {
    [true] = function() return gettime("CLOCK_MONOTONIC") end,
    [false] = function() return gettime("CLOCK_REALTIME") end,
  }
end

--- Return seconds and nanoseconds; an error of the clock is returned, not raised.
---@param is_monotonic boolean prefer a clock that is never set?
---@return number? sec nil if the clock fails
---@return number|any nsec the error in that case
function clock.read(is_monotonic)
  local ok, sec, nsec = pcall(clock.in_use[is_monotonic])
  if not ok then return nil, sec end
  if nsec == nil then return 0, sec end -- nanoseconds
  return sec, nsec
end

--- Return the seconds until the next timer of a machine can fire.
---@return number? seconds nil if none is armed, or if the clock fails
function clock.until_timer(fsm)
  local timeevent = rawget(_G, "package").loaded.rfsm_timeevent
  if not timeevent then return nil end
  local ok, seconds = pcall(timeevent.next_deadline, fsm)
  return ok and seconds or nil
end

--- Return a clock of seconds that begins now.
function clock.from_now()
  local sec, nsec = clock.read(true)
  return function()
    local now_sec, now_nsec = clock.read(true)
    return now_sec - sec + (now_nsec - nsec) / 1e9
  end
end

return clock
