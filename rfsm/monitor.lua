--- The monitor state: a leaf whose doo turns conditions into events.
--
-- @module rfsm.monitor
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, pairs, rawget, rawset, setmetatable = error, pairs, rawget, rawset,
  setmetatable
local tostring, type = tostring, type
local sort = table.sort

local monitor = {}

--- The fields for `gen_monitor_state`. All others become fields of the state.
---@class rfsm.monitor.Monitor
---@field montab table<any, fun(fsm: rfsm.Machine, state: rfsm.State): any> by event
---@field break_first? boolean send at most one event in each cycle; also `breakfirst`
---@field entry? function
---@field exit? function

-- Numbers before all else, each ascending.
local function event_before(a, b)
  local a_number, b_number = type(a) == "number", type(b) == "number"
  if a_number ~= b_number then return a_number end
  if a_number then return a < b end
  return tostring(a) < tostring(b)
end

-- Returns the monitored events, sorted, and the function of each.
local function monitors_of(montab)
  local events, checks = {}, {}
  for event in pairs(montab) do events[#events + 1] = event end -- any order: sorted
  sort(events, event_before)
  for i = 1, #events do checks[i] = montab[events[i]] end
  return events, checks
end

local function new_doo(events, checks, is_first_only)
  return function(fsm, state)
    while true do
      for i = 1, #events do
        if checks[i](fsm, state) then
          rfsm.send_events(fsm, events[i])
          if is_first_only then break end
        end
      end
      rfsm.yield(false)
    end
  end
end

local function check_monitor(t)
  if type(t) ~= "table" then return "table expected, got " .. type(t) end
  if type(t.montab) ~= "table" then
    return "montab: table of functions by event expected, got " .. type(t.montab)
  end
  if t.doo ~= nil then return "doo: is the state's own, and cannot be set" end
  local events, checks = monitors_of(t.montab)
  for i = 1, #events do
    if type(checks[i]) ~= "function" then
      return "montab: function expected for event '" .. tostring(events[i]) .. "', got "
        .. type(checks[i])
    end
  end
end

local OWN = { montab = true, break_first = true, breakfirst = true }

--- Make a state that watches conditions.
--
-- In each cycle every function of `montab` is called, events sorted, and where it
-- returns a true value its event is sent. The state is never idle.
--
-- @usage
--    watch = monitor.gen_monitor_state { montab = { e_low = battery_is_low } }
--
-- @raise when montab is not a table of functions
---@param t rfsm.monitor.Monitor
---@return rfsm.State state
---@nodiscard
function monitor.gen_monitor_state(t)
  local problem = check_monitor(t)
  if problem then error("rfsm.monitor.gen_monitor_state: " .. problem, 2) end
  local state = {}
  for key, value in pairs(t) do -- any order: each stands alone
    if not OWN[key] then state[key] = value end
  end
  local events, checks = monitors_of(t.montab)
  state.doo = new_doo(events, checks, t.break_first or t.breakfirst)
  return rfsm.state(state)
end

-- rfsm.monitor.seqand is rfsm.seqand, which the core loads when it is first used.
setmetatable(monitor, {
  __index = function(_, name) return name == "seqand" and rfsm.seqand or nil end,
})

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_ext", monitor) end

return monitor
