--- A port of RTT that is found again by its name.
--
-- `rttlib.tc_cleanup` deletes the ports of a component. A Lua that uses a deleted port
-- ends the process. So what outlives a clean-up holds its port by name: the hook that
-- writes the FQN, and the ports of a launch.
--
-- @module rfsm.rtt.port
-- @license BSD-3-Clause

local getmetatable, package, pcall = getmetatable, package, pcall
local setmetatable = setmetatable

local port = {}

--- Return the port of a component, nil if it has none of that name.
function port.of(component, name)
  local ok, found = pcall(function() return component:getPort(name) end)
  return ok and found or nil
end

--- An object that holds a port, and is read and written like one.
---@class rfsm.rtt.Port
---@field name string
---@field component any|false in which the port is looked up; false: it never is
---@field facts table<string, any> what `info` returned first
---@field real any|false the port, false as long as there is none
---@field was_found boolean has the component ever had it?
---@field is_made boolean? true if the launch has made it
---@field last any the last value written
---@field samples table<string, any> Variables by the texts that are going to be written
local Port = {}
Port.__index = Port

--- Read a sample, "NoData" if there is no port.
function Port:read(var)
  local real = self.real
  if not real then return "NoData" end
  return real:read(var)
end

--- Write a value. It is kept in `last`, for a port that is made later.
function Port:write(value)
  self.last = value
  if not self.real then self:find() end
  if self.real then self.real:write(value) end
end

--- Return the information of the port that was held first.
function Port:info() return self.facts end

--- Look the port up in its component; return whether it is there.
function Port:find()
  local found = port.of(self.component, self.name)
  if found or self.was_found then self.real = found or false end
  self.was_found = self.was_found or found ~= nil
  return found ~= nil
end

--- Hold a port that is made later. `facts`: its name, type, porttype and desc.
function port.reserve(component, facts)
  return setmetatable({ name = facts.name, component = component, facts = facts,
    real = false, was_found = true, last = nil, samples = {} }, Port)
end

--- Hold a port of this Lua's component, or an object that is read and written like a
-- port, with its information. A port that is held already is returned as it is.
function port.hold(real, facts)
  if getmetatable(real) == Port then return real end
  local rtt = package.loaded.rtt
  local held = port.reserve(rtt and facts.name and rtt.getTC() or false, facts)
  held.real = real
  held.was_found = port.of(held.component, held.name) ~= nil
  return held
end

return port
