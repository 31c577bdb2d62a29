--- The updates of a machine in a component of Orocos RTT: steps, attributes, memory.
--
-- Whatever is made here is made by a launch. An update allocates nothing.
--
-- @module rfsm.rtt.update
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local rfsm = require "rfsm"

local collectgarbage, ipairs, pcall, rawget = collectgarbage, ipairs, pcall, rawget
local require, select, type = require, select, type
local huge, max = math.huge, math.max

local update = {}

-- Memory: a pool of a fixed size -------------------------------------------------

-- Lua 5.1 collects when the heap has grown by a factor, not when memory is short. So a
-- pool that is full stays full: even the report of the error fails.
function update.make_room(problem)
  if type(problem) == "string" and problem:find("not enough memory", 1, true) then
    collectgarbage()
  end
end

local make_room = update.make_room

-- Returns a function that returns the KiB in use, and the most that ever were; in a
-- TLSF pool also its size. Those of a pool count what it adds to each block.
local function new_gauge()
  local tlsf = rawget(_G, "tlsf")
  if not (tlsf and tlsf.stats) then
    local most = 0
    return function()
      local kib = collectgarbage("count")
      most = max(most, kib)
      return kib, most, huge
    end
  end
  local stats = tlsf.stats
  return function()
    local used, most, size = stats()
    return used / 1024, most / 1024, size / 1024
  end
end

--- Are three quarters of the pool in use? False if this Lua has none.
function update.is_short_of_memory()
  collectgarbage()
  local used, _, size = new_gauge()()
  return used > 3 / 4 * size
end

-- Returns a function that notes the memory in use. It is called first when all garbage
-- was collected. It collects when nine tenths of the rest of the pool are in use.
function update.new_meter(launch)
  local gauge, variables = new_gauge(), launch.variables
  local before, highest, limit = huge, 0, false
  return function()
    local used, most, size = gauge()
    if limit and used > limit then
      collectgarbage()
      used, limit = gauge(), false
    end
    limit = limit or used + 0.9 * (size - used)
    if used < before then variables.rfsm_live:assign(used) end
    if most > highest then variables.rfsm_peak:assign(most) end
    before, highest = used, max(highest, most)
  end
end

-- Attributes ---------------------------------------------------------------------

--- The attributes of each launch, by name, and those of a service: their types.
update.ATTRIBUTES = {
  rfsm_overruns = "uint", rfsm_failures = "uint", rfsm_live = "double",
  rfsm_peak = "double",
}
update.OF_SERVICE = { rfsm_halt = "bool", rfsm_halted = "bool" }

-- Gives the component attributes that it has not. Their values are Variables, which
-- stay when `rttlib.tc_cleanup` removes the attributes. Another service may have added
-- some; they are shared.
function update.add_attributes(launch, types)
  for _, name in ipairs(rfsm.sorted_keys(types)) do
    local ok, attribute = pcall(function()
      return launch.component:getAttribute(name)
    end)
    if not ok then
      attribute = launch.rtt.Attribute.new(types[name], name)
      launch.component:addAttribute(attribute)
      launch.attributes[#launch.attributes + 1] = name
    end
    local value, before = attribute:getRaw(), launch.variables[name]
    if before and not ok then value:assign(before) end
    launch.variables[name] = value
  end
end

-- Returns a function that counts in an attribute.
local function new_counter(launch, name)
  local count, variables = 0, launch.variables
  return function()
    count = count + 1
    variables[name]:assign(count)
  end
end

-- Log ----------------------------------------------------------------------------

-- Returns a printer to RTT's log. It logs texts only, since OCL mutes the log of the
-- whole process at an error that is no text.
function update.printer(rtt, level)
  return function(...)
    for i = 1, select("#", ...) do make_room((select(i, ...))) end
    rtt.logl(level, calls.text(" ", ...))
  end
end

local printer = update.printer

-- Returns a function that reports what an update raised. It never raises, since RTT
-- removes a hook that fails.
function update.new_reporter(launch)
  local log, count = printer(launch.rtt, "Error"), new_counter(launch, "rfsm_failures")
  return function(problem)
    make_room(problem)
    count()
    pcall(log, "rfsm.rtt:", problem)
  end
end

-- Updates ------------------------------------------------------------------------

local STEPS = 1000 -- of an update that runs the machine; a run that is longer goes on

-- Returns a function that wakes an event-driven component for the next time event.
local function new_alarm(launch, fsm)
  local next_deadline = launch.ports.timer and require("rfsm_timeevent").next_deadline
  if not next_deadline then return function() end end
  local arm = launch.component:getPeer(launch.timer):getOperation("arm")
  local id, delay = launch.rtt.Variable.new("int"), launch.rtt.Variable.new("double")
  return function()
    local seconds = next_deadline(fsm)
    if not seconds then return end
    delay:assign(seconds)
    arm(id, delay)
  end
end

-- Returns a function that makes the steps of an update.
local function new_update(launch, fsm, again, make_ready)
  local count, alarm = new_counter(launch, "rfsm_overruns"), new_alarm(launch, fsm)
  local runs = launch.run or launch.is_component and not launch.sync
  local steps = launch.steps or runs and STEPS or 1
  return function()
    if not launch.is_ready then make_ready(launch) end
    local is_idle = rfsm.step(fsm, steps)
    if not is_idle and steps > 1 and rfsm.get_sta_mode(fsm) ~= "inactive" then
      count()
      again()
    end
    alarm()
  end
end

-- Returns a function that advances the machine. It returns true whatever happens. The
-- next update finishes a step that was cut short, and the one behind it reads what came
-- meanwhile: so one is triggered when failures begin and when they end.
function update.new_trigger(launch, fsm, make_ready)
  -- triggers the next update of a component, which otherwise waits for an event
  local again = launch.is_component and launch.component:getOperation("trigger")
    or function() end
  local report = update.new_reporter(launch)
  local advance = new_update(launch, fsm, again, make_ready)
  local meter, target = launch.meter, launch.component
  local running_only, has_failed = launch.running_only, false
  return function()
    if running_only and target:getState() ~= "Running" then return true end
    local ok, problem = pcall(advance)
    if not ok then report(problem) end
    if ok == has_failed then pcall(again) end
    has_failed = not ok
    meter()
    return true
  end
end

return update
