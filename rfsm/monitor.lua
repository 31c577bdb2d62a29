--- The monitor state: a leaf whose doo turns conditions into events.
--
-- @module rfsm.monitor
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, ipairs, rawget = error, ipairs, rawget
local rawset, setmetatable, type = rawset, setmetatable, type
local text_of = rfsm.text_of

local monitor = {}

--- The fields for `gen_monitor_state`. All other fields become fields of the state.
---@class rfsm.monitor.Monitor
---@field montab table<any, fun(fsm: rfsm.Machine, state: rfsm.State): any> conditions,
-- by the event that is sent if the condition returns a true value
---@field break_first? boolean send at most one event in each cycle
---@field breakfirst? boolean another spelling of `break_first`
---@field entry? function
---@field exit? function
---@field [any] any

local function new_doo(montab, is_first_only)
  local events, checks = rfsm.sorted_keys(montab), {}
  for i, event in ipairs(events) do checks[i] = montab[event] end
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
  if type(t) ~= "table" then
    return "table expected, got " .. type(t)
  elseif type(t.montab) ~= "table" then
    return "montab: table of functions by event expected, got " .. type(t.montab)
  elseif t.doo ~= nil then
    return "doo: is the state's own, and cannot be set"
  end
  for _, event in ipairs(rfsm.sorted_keys(t.montab)) do
    if not rfsm.is_callable(t.montab[event]) then
      return "montab: function expected for event '" .. text_of(event) .. "', got "
        .. type(t.montab[event])
    end
  end
end

local OWN = { montab = true, break_first = true, breakfirst = true }

--- Make a state that watches conditions.
--
-- In each cycle the functions of `montab` are called, sorted by their events. If a
-- function returns a true value, its event is sent. The state is never idle.
--
-- @usage
--    watch = monitor.gen_monitor_state { montab = { e_low = battery_is_low } }
--
-- @raise if montab is not a table of functions
---@param t rfsm.monitor.Monitor
---@return rfsm.State state
---@nodiscard
function monitor.gen_monitor_state(t)
  local problem = check_monitor(t)
  if problem then error("rfsm.monitor.gen_monitor_state: " .. problem, 2) end
  local state = {}
  for _, key in ipairs(rfsm.sorted_keys(t)) do
    if not OWN[key] then state[key] = t[key] end
  end
  state.doo = new_doo(t.montab, t.break_first or t.breakfirst)
  return rfsm.state(state)
end

-- rfsm.monitor.seqand is rfsm.seqand, which the core loads when it is first used.
setmetatable(monitor, {
  __index = function(_, name) return name == "seqand" and rfsm.seqand or nil end,
})

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_ext", monitor) end

return monitor
