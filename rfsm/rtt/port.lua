--- A port of RTT that is found again by its name.
--
-- `rttlib.tc_cleanup` deletes the ports of a component. If Lua code uses a deleted
-- port, the process ends. So a launch holds each port in an object of this module. The
-- object looks the port up by name.
--
-- @module rfsm.rtt.port
-- @license BSD-3-Clause

local getmetatable, package, pcall = getmetatable, package, pcall
local setmetatable = setmetatable

local port = {}

--- Return the port of a component that has a name; nil if there is no such port.
function port.of(component, name)
  local ok, found = pcall(function() return component:getPort(name) end)
  return ok and found or nil
end

--- An object that holds a port, and is read and written like a port.
---@class rfsm.rtt.Port
---@field name string name of the port
---@field component any its component; false or nil without RTT
---@field facts table<string, any> the information of the port that was held first
---@field real any|false the port; false while there is no such port
---@field was_found boolean has the component ever had the port?
---@field is_made boolean? true if the launch has made the port
---@field last any the last value written
---@field samples table<string, any> text to write -> an RTT Variable with the text
local Port = {}
Port.__index = Port

--- Read a sample into `var`; return the status, "NoData" if there is no port.
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

--- Return the information of the port that was held first, such as its type.
function Port:info() return self.facts end

--- Look the port up in its component; return whether it is there.
function Port:find()
  local found = port.of(self.component, self.name)
  if found or self.was_found then self.real = found or false end
  self.was_found = self.was_found or found ~= nil
  return found ~= nil
end

--- Make an object for a port that is made later. `facts` has the name, type, porttype
-- and desc of the port.
function port.reserve(component, facts)
  return setmetatable({ name = facts.name, component = component, facts = facts,
    real = false, was_found = true, last = nil, samples = {} }, Port)
end

--- Make an object that holds `real`: a port of the component that runs this Lua, or an
-- object that is read and written like a port. `facts` is the information of the port.
-- If `real` is an object of this module already, it is returned unchanged.
function port.hold(real, facts)
  if getmetatable(real) == Port then return real end
  local rtt = package.loaded.rtt
  local held = port.reserve(rtt and rtt.getTC(), facts)
  held.real = real
  held.was_found = port.of(held.component, held.name) ~= nil
  return held
end

return port
