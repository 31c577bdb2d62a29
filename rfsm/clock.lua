--- Clocks: how the library reads the time, and a simulated clock for tests.
--
-- A clock is a function that returns seconds and nanoseconds, or nanoseconds in one
-- number. A machine reads the clock in its field `gettime` or in this field of a parent
-- machine. If there is none, it reads the clock of the process, by default the best
-- clock installed. e_after needs a monotonic clock (`is_relative`); e_at needs the time
-- of day.
--
-- @module rfsm.clock
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, getmetatable, ipairs = error, getmetatable, ipairs
local pcall, rawequal, rawget = pcall, rawequal, rawget
local setmetatable, type = setmetatable, type
local abs = math.abs

local clock = {}

local MONOTONIC, REALTIME = "CLOCK_MONOTONIC", "CLOCK_REALTIME"

--- A clock of the library; callbacks and users may call it, too. A simulated clock has
-- whole seconds in `sec`, and nanoseconds below a billion in `nsec`.
---@class rfsm.clock.Clock
---@field read fun(self: any, is_relative: boolean): boolean, any, number? returns true,
-- seconds, nanoseconds; or false and an error
local Clock = {}
Clock.__index = Clock

function Clock:__call(id)
  local ok, sec, nsec = self:read(id ~= REALTIME)
  if not ok then error(sec, 0) end
  return sec, nsec
end

--- Return a clock with `read` as its method.
---@return rfsm.clock.Clock
function clock.new(read) return setmetatable({ read = read }, Clock) end

-- The best clock installed -----------------------------------------------------------

-- Returns a module, else the global table of its name, else an empty table. `rtt` and
-- `os` are taken from their globals only.
local function find_module(name)
  local ok, module = true, rawget(_G, name)
  if name ~= "rtt" and name ~= "os" then
    ok, module = pcall(rfsm.find_module, name)
    if rfsm.is_interrupt(module) then error(module, 0) end
  end
  if ok and type(module) ~= "table" then module = rawget(_G, name) end
  return ok and type(module) == "table" and module or {}
end

-- Modules with a clock, and functions that read it; the best one comes first. The time
-- of RTT is not the time of day, so RTT is used only if a monotonic time is wanted.
local INSTALLED = {
  { "rtt", function(rtt, is_monotonic)
    if is_monotonic then return rtt.getTime() end
  end },
  { "rtp", function(rtp, is_monotonic)
    return rtp.clock.gettime(is_monotonic and MONOTONIC or REALTIME)
  end },
  { "rtp", function(rtp) return rtp.clock.gettime() end }, -- an rtp without clock ids
  { "posix.time", function(time, is_monotonic)
    local now = time.clock_gettime(time[is_monotonic and MONOTONIC or REALTIME])
    return now.tv_sec, now.tv_nsec
  end },
  { "posix", function(posix, is_monotonic) -- old versions
    return posix.clock_gettime(is_monotonic and "monotonic" or "realtime")
  end },
  { "socket", function(socket) return socket.gettime(), 0 end },
  { "os", function(os) return os.time(), 0 end },
}

local function find(is_monotonic)
  for _, installed in ipairs(INSTALLED) do
    local module, read = find_module(installed[1]), installed[2]
    local ok, sec = pcall(read, module, is_monotonic)
    if rfsm.is_interrupt(sec) then error(sec, 0) end
    if ok and sec then
      return function() return true, read(module, is_monotonic) end
    end
  end
  return function() return false, "no clock is installed" end
end

local found = {} -- functions that `find` has returned, by its argument

local best = clock.new(function(_, is_relative)
  found[is_relative] = found[is_relative] or find(is_relative)
  return found[is_relative]()
end)

-- Read -------------------------------------------------------------------------------
--
-- Only functions of the user are called in pcall. An error from elsewhere, such as from
-- a debug hook, reaches the caller of `step`.

local function read_plain(gettime) return pcall(gettime) end

local function read_by_id(gettime, is_relative)
  return pcall(gettime, is_relative and MONOTONIC or REALTIME)
end

local function read_own(gettime, is_relative) return gettime:read(is_relative) end

local readers = setmetatable({}, { __mode = "k" }) -- for each clock, a function above

-- Warns of a clock that returns one number if the number must be seconds and cannot be
-- nanoseconds: it is below a million, or at most a day from the time of day.
local function check_unit(fsm, number)
  local os = find_module("os")
  local is_day = os.time and abs(number - os.time()) < 86400
  if not (is_day or number > 0 and number < 1e6) then return end
  rfsm.report(fsm, "warn", ("WARNING: the clock returned one number, %s, which "
    .. "means nanoseconds; seconds need two: function() return os.time(), 0 end")
    :format(rfsm.text_of(number)))
end

-- Finds the function above that can read a clock, notes it, and reads the clock. If the
-- clock returns a single 0, nothing is noted: 0 does not show the unit.
local function read_first(gettime, is_relative, fsm)
  local is_own, rtt = rawequal(getmetatable(gettime), Clock), find_module("rtt")
  if rawequal(gettime, rtt.getTime) then return best:read(is_relative) end
  local read = is_own and read_own or read_plain
  local ok, sec, nsec = read(gettime, is_relative)
  if not (ok or is_own) and read_by_id(gettime, is_relative) then
    read = read_by_id
    ok, sec, nsec = read(gettime, is_relative)
  end
  if ok and (nsec or sec ~= 0) then readers[gettime] = read end
  if type(sec) == "number" and nsec == nil then check_unit(fsm, sec) end
  return ok, sec, nsec
end

-- Returns the results of `clock.read`, if a clock did not return two finite numbers.
local function read_unusual(ok, sec, nsec)
  if not ok then
    if rfsm.is_interrupt(sec) then error(sec, 0) end
    return false, sec
  elseif type(sec) == "number" and sec - sec == 0 and nsec == nil then
    return sec * 1e-9, 0, sec
  end
  local wrong = type(type(sec) == "number" and nsec or sec)
  return false, wrong == "number" and "a time must be finite"
    or "seconds and nanoseconds expected, got " .. wrong
end

local process = best

-- Returns the present, if the clock of the process shows an earlier time.
local present = nil

local function inherited(fsm)
  local owner = fsm._owner
  return owner and (owner.gettime or inherited(owner))
end

--- Read the clock of a machine.
---@param fsm rfsm.Machine|{} {}: read the clock of the process
---@param is_relative boolean true: a monotonic clock; false: the time of day
---@return number|false time in seconds, in one number; false if the clock fails
---@return number|any sec the exact seconds; the error if the clock fails
---@return number nsec nanoseconds to be added to `sec`, perhaps more than a second
function clock.read(fsm, is_relative)
  local gettime = fsm.gettime or fsm._owner and inherited(fsm) or process
  local ok, sec, nsec = (readers[gettime] or read_first)(gettime, is_relative, fsm)
  if type(sec) == "number" and type(nsec) == "number" then
    local time = sec + nsec * 1e-9
    if time - time == 0 then return time, sec, nsec end
  end
  return read_unusual(ok, sec, nsec)
end

--- Set the clock of the process; nil sets the best clock that is installed.
--
-- A host that catches up, so that machines see times of the past one by one, also gives
-- a function that returns the present.
--
---@param gettime? fun(id?: string): number, number?
---@param of_present? fun(): number, number seconds and nanoseconds
function clock.set_hook(gettime, of_present)
  process, present = gettime or best, of_present
  found[true], found[false] = nil, nil
end

--- Return the present, which is the time given unless a host catches up.
---@param sec number the time that a machine sees, in seconds
---@param nsec number nanoseconds in addition
---@return number sec
---@return number nsec
function clock.present(sec, nsec)
  if not present then return sec, nsec end
  local now, now_nsec = present()
  if now + now_nsec * 1e-9 < sec + nsec * 1e-9 then return sec, nsec end
  return now, now_nsec
end

--- Return a function that returns how many seconds have passed since this call.
---@return fun(): number
function clock.from_now()
  local start = clock.read({}, true)
  return function() return clock.read({}, true) - start end
end

--- Return the seconds until the next timer of a machine can fire.
-- @raise on an interrupt (Control-C)
---@return number? seconds nil if no timer is armed, or if the clock fails
---@return any failure of the clock
function clock.until_timer(fsm)
  local timeevent = rawget(_G, "package").loaded.rfsm_timeevent
  if not timeevent then return nil end
  local ok, seconds = pcall(timeevent.next_deadline, fsm)
  if rfsm.is_interrupt(seconds) then error(seconds, 0) end
  if not ok then return nil, seconds end
  return seconds
end

-- A simulated clock is made by a file of its own: a robot needs none.
setmetatable(clock, { __index = function(_, name)
  if name ~= "simulated" then return nil end
  clock.simulated = rfsm.find_module("rfsm.clock.simulated")(clock, Clock)
  return clock.simulated
end })

return clock
