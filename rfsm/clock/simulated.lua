--- A simulated clock, for tests and tools. rfsm.clock loads this file when it is used.
--
-- @submodule rfsm.clock
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, getmetatable, ipairs, rawequal = error, getmetatable, ipairs, rawequal
local setmetatable, type = setmetatable, type
local floor, max = math.floor, math.max

-- Adds the methods of a simulated clock to those of all clocks.
return function(clock, Clock)
  -- Adds seconds to a simulated clock. If `self` is no such clock, or the seconds are
  -- no finite number, raises an error at the caller of the method `where`.
  local function add(self, where, seconds)
    local expected, got = "simulated clock", self
    if rawequal(getmetatable(self), Clock) then
      expected, got = "finite number of seconds", seconds
    end
    if rawequal(got, self) or type(got) ~= "number" or got - got ~= 0 then
      error(("rfsm.clock.%s: %s expected, %s"):format(where, expected,
        rfsm.got(got)), 3)
    end
    local whole = floor(seconds)
    local nsec = self.nsec + floor((seconds - whole) * 1e9 + 0.5)
    self.sec, self.nsec = self.sec + whole + floor(nsec / 1e9), floor(nsec % 1e9)
  end

  function Clock:read() return true, self.sec, self.nsec end

  --- Let seconds pass. A number below 0 sets the clock back.
  ---@param seconds number
  function Clock:advance(seconds) return (add(self, "advance", seconds)) end

  --- Return the time, as one number of seconds.
  ---@return number seconds
  function Clock:now()
    add(self, "now", 0)
    return self.sec + self.nsec / 1e9
  end

  --- Go to the time at which the next timer of a machine or its regions fires.
  -- @raise if the machine reads another clock
  ---@param fsm rfsm.Machine
  ---@return number? seconds that have passed; nil if no timer is armed
  function Clock:advance_to_timer(fsm)
    add(self, "advance_to_timer", 0)
    rfsm.check_machine(fsm, "rfsm.clock.advance_to_timer")
    local seconds, sec, nsec = clock.until_timer(fsm), self.sec, self.nsec
    if not seconds then return nil end
    self:advance(max(floor(seconds) - 1, 0)) -- a float of many years is not exact
    self:advance(clock.until_timer(fsm))
    if clock.until_timer(fsm) == 0 then return seconds end
    self.sec, self.nsec = sec, nsec
    error("rfsm.clock.advance_to_timer: the machine reads another clock", 2)
  end

  --- Make a clock for the field `gettime` of machines. It is exact to the nanosecond,
  -- and its time passes only by calls of `advance` and `advance_to_timer`.
  --
  -- @usage
  --    local now = clock.simulated { now = 0 }
  --    fsm.gettime = now
  --    now:advance(2.5)
  --
  ---@param options? { now: number } the time at first, in seconds (0)
  ---@return rfsm.clock.Clock
  ---@nodiscard
  function clock.simulated(options)
    local self, now = setmetatable({ sec = 0, nsec = 0 }, Clock), 0
    local given = type(options) == "table" and options or { options }
    for _, name in ipairs(rfsm.sorted_keys(given)) do
      if name ~= "now" then error("rfsm.clock.simulated: { now = 0 } expected", 2) end
      now = given.now
    end
    add(self, "simulated: now", now)
    return self
  end

  return clock.simulated
end
