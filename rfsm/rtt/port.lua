--- A port of RTT that is found again by its name.
--
-- `rttlib.tc_cleanup` deletes the ports of a component. If Lua code uses a deleted
-- port, the process ends. So a launch holds each port in an object of this module. The
-- object looks the port up by name.
--
-- @module rfsm.rtt.port
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, getmetatable, package, pcall = error, getmetatable, package, pcall
local setmetatable, type = setmetatable, type

local port = {}

--- By the name of a type of RTT: the type of Lua that its samples become.
port.LUA_TYPES = { bool = "boolean", char = "string", string = "string" }
for name in ("double float int uint long int8 uint8 int16 uint16 int32 uint32 int64 "
  .. "uint64 llong ullong"):gmatch("%S+") do
  port.LUA_TYPES[name] = "number"
end

--- Can `value:name(...)` be called? Reading a field of a Variable may raise an error.
function port.has_method(value, name)
  local ok, method = pcall(function() return value[name] end)
  return ok and rfsm.is_callable(method)
end

--- Return the table `real:info()`; an empty table if `real` is no port of RTT.
function port.info_of(real)
  local ok, info = pcall(function() return real:info() end)
  return ok and type(info) == "table" and info or {}
end

--- Return a Variable for the samples of a port; nil if RTT is not loaded, or if no type
-- of Lua matches the port's type. Also return a second Variable, of type double, if
-- RTT-Lua converts the port's type only from and to such a Variable.
function port.new_variables(real)
  local kind, rtt = port.info_of(real).type, package.loaded.rtt
  if not (port.LUA_TYPES[kind] and rtt) then return nil end
  return rtt.Variable.new(kind), kind:find("llong") and rtt.Variable.new("double")
end

local DIRECTIONS = { read = "input port", write = "output port" }
local GOT = { ["in"] = "got an input port", out = "got an output port" }

--- Return the problem if a port does not have the method "read" or "write", or is not
-- of type `kind` (nil: any type); nil if the port is right.
function port.problem(real, method, kind)
  local info = port.info_of(real)
  local got = not port.has_method(real, method)
    and (GOT[info.porttype] or rfsm.got(real))
    or kind and info.type and info.type ~= kind and "got one of type " .. info.type
  return got and ("%s%s expected, %s"):format(DIRECTIONS[method],
    kind and " of type " .. kind or "", got) or nil
end

--- Return a function that writes a value to a port. A Variable is written as it is.
function port.new_writer(real)
  local var, double = port.new_variables(real)
  local lua_type = port.LUA_TYPES[port.info_of(real).type]
  return function(value)
    if not var or type(value) ~= lua_type then return real:write(value) end
    if double then double:assign(value) end
    var:assign(double or value)
    real:write(var)
  end
end

-- Returns the port of a component that has a name; nil if there is no such port.
local function port_of(component, name)
  local ok, found = pcall(function() return component:getPort(name) end)
  return ok and found or nil
end

port.of = port_of -- a local, so that objects below do not hold the module

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
  local found = port_of(self.component, self.name)
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

--- Raise an error if the port that was found has another direction or type.
function Port:check()
  local wanted, found = self.facts, self.real:info()
  if found.porttype == wanted.porttype and found.type == wanted.type then return end
  error(("port '%s': %sput port of type %s expected, got an %sput port of type %s")
    :format(self.name, wanted.porttype, wanted.type, found.porttype, found.type), 0)
end

--- Make the port of an object. With `is_kept` a port that the component has already is
-- taken, such as that of its last launch, else it is an error: RTT would replace it.
---@param held rfsm.rtt.Port
---@param is_kept boolean
function port.provide(held, is_kept)
  if is_kept and held:find() then return held:check() end
  local owner, name = held.component, held.name
  if port_of(owner, name) then
    error(("'%s' has a port '%s' already"):format(owner:getName(), name), 0)
  end
  held:make()
end

--- Remove a port that was made here: Lua does not collect ports.
---@param held rfsm.rtt.Port
function port.remove(held)
  if not (held.is_made and held.real) then return end
  held.component:removePort(held.name) -- else `delete` ends the process
  held.real:delete()
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
  held.was_found = port_of(held.component, held.name) ~= nil
  return held
end

--- Return the function that makes events of the samples of a port; nil if the samples
-- are the events.
function port.converter(held)
  return getmetatable(held) == Port and held.convert or nil
end

return port
