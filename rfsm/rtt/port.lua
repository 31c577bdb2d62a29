--- A port of RTT that is found again by its name.
--
-- `rttlib.tc_cleanup` deletes the ports of a component. If Lua code uses a deleted
-- port, the process ends. So a launch holds each port in an object of this module. The
-- object looks the port up by name.
--
-- @module rfsm.rtt.port
-- @license BSD-3-Clause

local error, getmetatable, package, pcall = error, getmetatable, package, pcall
local setmetatable = setmetatable

local port = {}

--- By the name of a type of RTT: the type of Lua that its samples become.
port.LUA_TYPES = { bool = "boolean", char = "string", string = "string" }
for name in ("double float int uint long int8 uint8 int16 uint16 int32 uint32 int64 "
  .. "uint64 llong ullong"):gmatch("%S+") do
  port.LUA_TYPES[name] = "number"
end

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
---@field is_trigger boolean? does a sample trigger an update of the component?
---@field keeps_last boolean? is `last` written to a port that is made later?
---@field timer string? name of the peer whose port "timer_0" the port is connected to
---@field convert? fun(sample: any): any makes the event of a sample; nil: none
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

--- Make the port in its component.
function Port:make()
  local facts = self.facts
  local class = facts.porttype == "in" and "InputPort" or "OutputPort"
  local ok, real = pcall(package.loaded.rtt[class].new, facts.type, facts.name,
    facts.desc)
  if not ok then
    error("type: a type of a loaded typekit expected, got '" .. facts.type .. "'", 0)
  end
  self.component[self.is_trigger and "addEventPort" or "addPort"](self.component, real)
  self.real, self.is_made = real, true
  if self.keeps_last and self.last then real:write(self.last) end
  if not self.timer then return end
  real:connect(self.component:getPeer(self.timer):getPort("timer_0"))
end

--- Remove a port that `make` has made: Lua does not collect ports.
function Port:remove()
  if not (self.is_made and self.real) then return end
  self.component:removePort(self.name) -- else `delete` ends the process
  self.real:delete()
end

--- Raise an error if the port that was found has another direction or type.
function Port:check()
  local wanted, found = self.facts, self.real:info()
  if found.porttype == wanted.porttype and found.type == wanted.type then return end
  error(("port '%s': %sput port of type %s expected, got an %sput port of type %s")
    :format(self.name, wanted.porttype, wanted.type, found.porttype, found.type), 0)
end

--- Make the port. With `is_kept` a port that the component has already is taken, such
-- as that of its last launch. Otherwise it is an error: RTT would replace the port.
function Port:provide(is_kept)
  if is_kept and self:find() then return self:check() end
  if port.of(self.component, self.name) then
    error(("'%s' has a port '%s' already"):format(self.component:getName(), self.name),
      0)
  end
  self:make()
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

--- Return the function that makes events of the samples of a port; nil if the samples
-- are the events.
function port.converter(held)
  return getmetatable(held) == Port and held.convert or nil
end

return port
