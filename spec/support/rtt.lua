-- Stands in for the module `rtt` of Orocos RTT-Lua: as much of it as rfsm.rtt and its
-- users meet, with its traps:
--
--   - `port:read()` returns a value also with "NoData" and "OldData"; `port:read(var)`
--     only the status, and always "NoData" when the type of the Variable is another one
--   - `port:write(a, b)` writes a; a Variable of another type is logged and not written
--   - a data connection keeps the last sample only, a full buffer drops what comes
--   - a port added under a name in use disconnects and replaces the one that has it
--   - operations such as exec_str return false, and why goes to the log
--   - each component and each Lua service has a Lua of its own
--   - an EEHook that does not return true is removed, one not held is collected
--   - configure() of a stopped component calls configureHook again, without cleanupHook
--   - threads: nothing runs at a write or a trigger, see `standin.spin`
--
-- Written from knowledge of the API; it was not compared with a real RTT.
--
-- The field `standin`, which the real one has not, is for specs: the clock, the log,
-- the turn of the threads.

local lua_state = require "spec.support.lua_state"

local floor = math.floor
local BILLION = 1000000000

local standin = { log = {}, variables = 0 }
local rtt = { standin = standin }

local now = 0         -- nanoseconds
local components = {} -- in the order of their making
local imported = {}   -- what was imported by name

-- Log -------------------------------------------------------------------------

local LEVELS = {
  Never = true, Fatal = true, Critical = true, Error = true, Warning = true,
  Info = true, Debug = true, RealTime = true,
}

local function check_string(value, what)
  if type(value) == "number" then return tostring(value) end
  if type(value) == "string" then return value end
  error(("bad argument to '%s' (string expected, got %s)"):format(what, type(value)), 3)
end

local function log(level, text)
  standin.log[#standin.log + 1] = level .. ": " .. text
end

function rtt.logl(level, ...)
  if not LEVELS[level] then error("unknown loglevel " .. tostring(level), 2) end
  local texts = { ... }
  for i = 1, select("#", ...) do texts[i] = check_string(texts[i], "logl") end
  log(level, table.concat(texts, " "))
end

function rtt.log(...) rtt.logl("Info", ...) end

-- Types and Variables ---------------------------------------------------------

local function check_number(value)
  local number = tonumber(value)
  if not number then error("number expected, got " .. type(value), 0) end
  return number
end

local function whole(value)
  local number = check_number(value)
  return number < 0 and -floor(-number) or floor(number)
end

local function text(value)
  if type(value) == "number" then return tostring(value) end
  if type(value) ~= "string" then error("string expected, got " .. type(value), 0) end
  return value
end

-- By type: how a value of Lua becomes one of it, and what a new Variable holds.
local BASIC = {
  bool = { default = false, convert = function(value)
    if type(value) == "boolean" then return value end
    error("boolean expected, got " .. type(value), 0)
  end },
  char = { default = "\0", convert = function(value) return text(value):sub(1, 1) end },
  double = { default = 0, convert = check_number },
  float = { default = 0, convert = check_number },
  int = { default = 0, convert = whole },
  string = { default = "", convert = text },
  uint = { default = 0, convert = whole },
}

local STRUCTS = {} -- by type: names of members -> their types

local function check_type(name, where)
  if type(name) ~= "string" or not (BASIC[name] or STRUCTS[name]) then
    error(where .. ": unknown type " .. tostring(name), 3)
  end
end

local function default_of(name)
  if BASIC[name] then return BASIC[name].default end
  local value = {}
  for member, inner in pairs(STRUCTS[name]) do value[member] = default_of(inner) end
  return value
end

local function copy_of(value)
  if type(value) ~= "table" then return value end
  local result = {}
  for member, inner in pairs(value) do result[member] = copy_of(inner) end
  return result
end

-- A Variable holds { name of its type, value }.
local Variable = {}

local function is_variable(value) return getmetatable(value) == Variable end

local function new_variable(name, value)
  standin.variables = standin.variables + 1
  return setmetatable({ name, value }, Variable)
end

-- Basic types as values of Lua, others as a Variable of their own.
local function push(name, value)
  if BASIC[name] then return value end
  return new_variable(name, copy_of(value))
end

local methods = {}

function methods.getType(var) return rawget(var, 1) end

function methods.tolua(var)
  local name = rawget(var, 1)
  if BASIC[name] then return rawget(var, 2) end
  error("Variable.tolua: can't convert type " .. name, 2)
end

function methods.assign(var, value)
  local name = rawget(var, 1)
  if is_variable(value) then
    if rawget(value, 1) ~= name then error("Variable.assign: assignment failed", 2) end
    rawset(var, 2, copy_of(rawget(value, 2)))
    return
  end
  if not BASIC[name] then
    error(("Variable.assign: can't convert lua %s to %s variable"):format(type(value),
      name), 2)
  end
  local ok, result = pcall(BASIC[name].convert, value)
  if not ok then error("Variable.assign: " .. result, 2) end
  rawset(var, 2, result)
end

local function check_member(var, member)
  local struct = STRUCTS[rawget(var, 1)]
  if not struct or not struct[member] then
    error("Variable: no member " .. tostring(member), 3)
  end
  return struct[member]
end

function Variable.__index(var, member)
  if methods[member] then return methods[member] end
  return push(check_member(var, member), rawget(var, 2)[member])
end

function Variable.__newindex(var, member, value)
  local name = check_member(var, member)
  rawget(var, 2)[member] = BASIC[name] and BASIC[name].convert(value)
    or copy_of(rawget(value, 2))
end

function Variable.__tostring(var) return tostring(rawget(var, 2)) end

-- Makes rtt.X callable, with X.new beside.
local function class(new)
  return setmetatable({ new = new }, { __call = function(_, ...) return new(...) end })
end

rtt.Variable = class(function(name, value)
  check_type(name, "Variable.new")
  local var = new_variable(name, default_of(name))
  if value ~= nil then methods.assign(var, value) end
  return var
end)

-- Returns the value to write to something of type `name`.
local function from_lua(name, value, where)
  if value == nil then error(where .. ": value expected", 3) end
  if not BASIC[name] then
    local kind = type(value)
    error(("%s: can't convert lua %s to %s variable"):format(where, kind, name), 3)
  end
  local ok, result = pcall(BASIC[name].convert, value)
  if not ok then error(where .. ": " .. result, 3) end
  return result
end

--- Adds a type with members, as an imported typekit does.
function standin.add_type(name, members) STRUCTS[name] = members end

-- Connections: one sample, or a buffer -----------------------------------------

-- A connection keeps one sample (DATA), or several and drops what comes when it is full
-- (1), or what it had first (CIRCULAR).
local DATA, CIRCULAR = 0, 2

local function new_connection(policy)
  return { kind = policy.type, size = policy.size, first = 1, count = 0 }
end

-- Samples are at first, first + 1, ... below size + 1, then from 1 on.
local function connection_write(connection, value)
  if connection.kind == DATA then
    connection.count, connection[1] = 1, value
  elseif connection.count < connection.size then
    local place = (connection.first + connection.count - 1) % connection.size + 1
    connection[place], connection.count = value, connection.count + 1
  elseif connection.kind == CIRCULAR then
    connection[connection.first] = value
    connection.first = connection.first % connection.size + 1
  end
end

local function connection_read(connection)
  local value = connection[connection.first]
  connection.count = connection.count - 1
  if connection.kind ~= DATA then
    connection.first = connection.first % connection.size + 1
  end
  return value
end

-- Ports -----------------------------------------------------------------------

local Port = {}
local InputPort = setmetatable({}, { __index = Port })
local OutputPort = setmetatable({}, { __index = Port })

-- Raises for what is no port of this class, or one that was deleted.
local function check_port(port, metatable, where)
  if getmetatable(port) ~= metatable then error(where .. ": port expected", 3) end
  if port.is_deleted then error(where .. ": the port was deleted", 3) end
end

InputPort.__index, OutputPort.__index = InputPort, OutputPort

function Port.info(port)
  return {
    name = port.name, desc = port.desc, connected = #port.connections > 0,
    type = port.type, porttype = getmetatable(port) == InputPort and "in" or "out",
  }
end

function Port.connected(port) return #port.connections > 0 end

local function new_port(metatable, kind, name, desc, where)
  check_type(kind, where)
  return setmetatable({
    type = kind, name = name or "unnamed", desc = desc or "", connections = {},
    last = nil, component = false, is_event = false, is_deleted = false,
  }, metatable)
end

rtt.InputPort = class(function(kind, name, desc)
  return new_port(InputPort, kind, name, desc, "InputPort.new")
end)

rtt.OutputPort = class(function(kind, name, desc)
  return new_port(OutputPort, kind, name, desc, "OutputPort.new")
end)

-- Returns the status, and the sample.
local function read_sample(port)
  for _, connection in ipairs(port.connections) do
    if connection.count > 0 then
      port.last = connection_read(connection)
      return "NewData", port.last
    end
  end
  if port.last ~= nil then return "OldData", port.last end
  return "NoData", default_of(port.type)
end

function InputPort.read(port, var)
  check_port(port, InputPort, "InputPort.read")
  if not is_variable(var) then -- also when it is something else
    local status, value = read_sample(port)
    return status, push(port.type, value)
  end
  if rawget(var, 1) ~= port.type then
    log("Error", "trying to read to an incompatible data source")
    return "NoData"
  end
  local status, value = read_sample(port)
  if status ~= "NoData" then rawset(var, 2, copy_of(value)) end
  return status
end

function OutputPort.write(port, value)
  check_port(port, OutputPort, "OutputPort.write")
  if is_variable(value) then
    if rawget(value, 1) ~= port.type then
      log("Error", "trying to write from an incompatible data source")
      return
    end
    value = copy_of(rawget(value, 2))
  else
    value = from_lua(port.type, value, "OutputPort.write")
  end
  port.last = value
  for _, connection in ipairs(port.connections) do
    connection_write(connection, value)
    local component = connection.to.is_event and connection.to.component
    if component then component.is_triggered = true end
  end
end

STRUCTS.ConnPolicy = { type = "int", size = "int", init = "bool" }

local function policy_of(var)
  local value = var and rawget(var, 2) or { type = DATA, size = 0, init = false }
  return { type = value.type, size = math.max(value.size, 1), init = value.init }
end

-- Connects in either direction; false and a word in the log when that cannot be.
function Port.connect(port, other, policy_var)
  local out, into = port, other
  if getmetatable(port) == InputPort then out, into = other, port end
  if getmetatable(out) ~= OutputPort or getmetatable(into) ~= InputPort
    or out.type ~= into.type then
    log("Error", "cannot connect ports of these types")
    return false
  end
  local policy = policy_of(policy_var)
  local connection = new_connection(policy)
  connection.from, connection.to = out, into
  table.insert(out.connections, connection)
  table.insert(into.connections, connection)
  if policy.init and out.last ~= nil then connection_write(connection, out.last) end
  return true
end

local function remove_from(list, value)
  for i = #list, 1, -1 do
    if list[i] == value then table.remove(list, i) end
  end
end

function Port.disconnect(port)
  for i = #port.connections, 1, -1 do
    local connection = port.connections[i]
    remove_from(connection.from.connections, connection)
    remove_from(connection.to.connections, connection)
  end
end

function Port.delete(port)
  Port.disconnect(port)
  port.is_deleted = true
end

-- Properties ------------------------------------------------------------------

local Property = {}
Property.__index = Property

rtt.Property = class(function(kind, name, desc)
  check_type(kind, "Property.new")
  return setmetatable({ type = kind, name = name or "", desc = desc or "",
    value = default_of(kind) }, Property)
end)

function Property:get() return push(self.type, self.value) end

function Property:set(value)
  self.value = is_variable(value) and copy_of(rawget(value, 2))
    or from_lua(self.type, value, "Property.set")
end

function Property:info()
  return { name = self.name, desc = self.desc, type = self.type }
end

-- Operations and services -----------------------------------------------------

local Operation = {}
Operation.__index = Operation

function Operation.__call(operation, ...)
  if select("#", ...) ~= operation.arity then
    error(("Operation.call: wrong number of args. expected %d, got %d"):format(
      operation.arity, select("#", ...)), 2)
  end
  return operation.f(...)
end

function Operation:info() return self.name, "", "", self.arity end

local function add_operation(owner, name, arity, f)
  local operation = { name = name, arity = arity, f = f }
  owner.operations[name] = setmetatable(operation, Operation)
end

local Service = {}
Service.__index = Service

local function new_service(name)
  return setmetatable({ name = name, operations = {} }, Service)
end

function Service:getName() return self.name end

function Service:hasOperation(name) return self.operations[name] ~= nil end

function Service:getOperation(name)
  if not self.operations[name] then
    error("Service.getOperation: no such operation " .. tostring(name), 2)
  end
  return self.operations[name]
end

-- TaskContext: ports, properties, peers ----------------------------------------

local TaskContext = {}

-- Methods first, then operations, which can be called as methods.
local function index(component, name)
  if TaskContext[name] then return TaskContext[name] end
  local operation = rawget(component, "operations")[name]
  if operation then return function(_, ...) return operation(...) end end
  error("TaskContext: no such operation " .. tostring(name), 2)
end

local METATABLE = { __index = index }

local function new_component(name, state)
  local component = setmetatable({
    name = name, state = state, lua = false, is_triggered = false,
    activity = { kind = "Activity", period = 0, due = false },
    ports = {}, port_names = {}, properties = {}, property_names = {}, peers = {},
    operations = {}, services = {},
    hooks = setmetatable({}, { __mode = "v" }), hook_count = 0,
  }, METATABLE)
  components[#components + 1] = component
  return component
end

function TaskContext.getName(component) return component.name end

function TaskContext.getPortNames(component)
  local names = {}
  for i, name in ipairs(component.port_names) do names[i] = name end
  return names
end

function TaskContext.removePort(component, name)
  local port = component.ports[name]
  if not port then return end
  Port.disconnect(port)
  port.component, component.ports[name] = false, nil
  remove_from(component.port_names, name)
end

local function add_port(component, port, name, desc, is_event)
  if getmetatable(port) ~= InputPort and getmetatable(port) ~= OutputPort then
    error("addPort: invalid port object", 3)
  end
  port.name, port.desc = name or port.name, desc or port.desc
  if component.ports[port.name] then
    log("Warning", "'addPort' " .. port.name .. ": name already in use. Disconnecting "
      .. "and replacing previous port with new one.")
    TaskContext.removePort(component, port.name)
  end
  port.component, port.is_event = component, is_event
  component.ports[port.name] = port
  table.insert(component.port_names, port.name)
end

function TaskContext.addPort(component, port, name, desc)
  add_port(component, port, name, desc, false)
end

function TaskContext.addEventPort(component, port, name, desc)
  if getmetatable(port) ~= InputPort then error("addEventPort: no InputPort", 2) end
  add_port(component, port, name, desc, true)
end

function TaskContext.getPort(component, name)
  if not component.ports[name] then
    error("TaskContext.getPort: no port " .. tostring(name), 2)
  end
  return component.ports[name]
end

function TaskContext.addProperty(component, property)
  component.properties[property.name] = property
  table.insert(component.property_names, property.name)
end

function TaskContext.getProperty(component, name)
  if not component.properties[name] then
    error("TaskContext.getProperty: no property " .. tostring(name), 2)
  end
  return component.properties[name]
end

function TaskContext.getPropertyNames(component) return component.property_names end

function TaskContext.removeProperty(component, name)
  component.properties[name] = nil
  remove_from(component.property_names, name)
end

function TaskContext.addPeer(component, peer)
  component.peers[peer.name] = peer
  table.insert(component.peers, peer.name)
end

function TaskContext.removePeer(component, name)
  component.peers[name] = nil
  remove_from(component.peers, name)
end

function TaskContext.getPeers(component)
  local names = {}
  for i, name in ipairs(component.peers) do names[i] = name end
  return names
end

function TaskContext.getPeer(component, name)
  if not component.peers[name] then
    error("TaskContext.getPeer: no peer " .. tostring(name), 2)
  end
  return component.peers[name]
end

function TaskContext.hasOperation(component, name)
  return component.operations[name] ~= nil
end

function TaskContext.getOperation(component, name)
  if not component.operations[name] then
    error("TaskContext.getOperation: no such operation " .. tostring(name), 2)
  end
  return component.operations[name]
end

-- As in C++, asking for a service makes it.
function TaskContext.provides(component, name)
  if not name then return component end
  component.services[name] = component.services[name] or new_service(name)
  return component.services[name]
end

-- TaskContext: life cycle and engine -------------------------------------------

-- Calls a function of the component's program, if there is one.
local function call_hook(component, name, wants_result)
  local lua = component.lua
  if not lua or lua.globals[name] == nil then return true end
  local ok, result = lua:call(name)
  local where = "LuaComponent '" .. component.name .. "': "
  if not ok then
    log("Error", where .. "error calling function " .. name .. ": " .. tostring(result))
    return false
  end
  if not wants_result then return true end
  if type(result) == "boolean" then return result end
  log("Error", where .. name .. " must return a bool but returned a " .. type(result))
  return false
end

function TaskContext.getState(component) return component.state end

function TaskContext.isRunning(component) return component.state == "Running" end

function TaskContext.configure(component)
  if component.state ~= "Stopped" and component.state ~= "PreOperational" then
    return false
  end
  local ok = call_hook(component, "configureHook", true)
  component.state = ok and "Stopped" or "PreOperational"
  return ok
end

function TaskContext.start(component)
  if component.state ~= "Stopped" then return false end
  if not call_hook(component, "startHook", true) then return false end
  component.state, component.is_triggered = "Running", true
  return true
end

function TaskContext.stop(component)
  if component.state ~= "Running" then return false end
  component.state = "Stopped"
  call_hook(component, "stopHook", false)
  return true
end

function TaskContext.cleanup(component)
  if component.state ~= "Stopped" then return false end
  component.state = "PreOperational"
  call_hook(component, "cleanupHook", false)
  return true
end

-- One turn of the thread: hooks, then updateHook.
local function execute(component)
  component.is_triggered = false
  for i = 1, component.hook_count do
    local hook = component.hooks[i] -- nil when it was collected
    if hook and not hook.run() then
      log("Error", "EEHook '" .. hook.name .. "' removed")
      component.hooks[i] = nil
    end
  end
  if component.state == "Running" then call_hook(component, "updateHook", false) end
end

--- Executes a component that has no thread; false for one that has.
function TaskContext.update(component)
  if component.activity.kind ~= "SlaveActivity" then return false end
  execute(component)
  return true
end

--- Asks the thread of a component for a turn; false when there is none, or a period.
function TaskContext.trigger(component)
  if component.activity.kind ~= "Activity" or component.activity.period > 0 then
    return false
  end
  component.is_triggered = true
  return true
end

local function is_waiting(component)
  return component.is_triggered and component.activity.kind == "Activity"
    and component.activity.period == 0
end

--- Gives each thread that was triggered its turn, until none is.
function standin.spin()
  local i, turns = 1, 0
  while components[i] do
    if is_waiting(components[i]) then
      turns = turns + 1
      assert(turns <= 10000, "standin.spin: components trigger each other for ever")
      execute(components[i])
      i = 0
    end
    i = i + 1
  end
end

-- Returns the periodic component that is next, no later than `limit`.
local function next_due(limit)
  local found
  for _, component in ipairs(components) do
    local due = component.activity.due
    if due and due <= limit and not (found and found.activity.due <= due) then
      found = component
    end
  end
  return found
end

--- Lets time pass: periodic components have their turns, then those triggered.
function standin.advance(seconds)
  local limit = now + floor(seconds * BILLION + 0.5)
  local component = next_due(limit)
  while component do
    local activity = component.activity
    now, activity.due = activity.due, activity.due + activity.period
    execute(component)
    standin.spin()
    component = next_due(limit)
  end
  now = limit
  standin.spin()
end

function rtt.getTime()
  return floor(now / BILLION), now % BILLION
end

-- Lua in components: the component, the service, EEHook ------------------------

-- Makes rtt.EEHook for the Lua `lua` of `component`.
local function eehook_class(component, lua)
  local EEHook = {}
  EEHook.__index = EEHook
  function EEHook:enable()
    component.hook_count = component.hook_count + 1
    component.hooks[component.hook_count] = self
    return true
  end
  function EEHook:disable()
    for i = 1, component.hook_count do
      if component.hooks[i] == self then component.hooks[i] = nil end
    end
    return true
  end
  return class(function(name)
    name = check_string(name, "EEHook")
    return setmetatable({ name = name, run = function()
      if type(lua.globals[name]) ~= "function" then return false end
      local ok, result = lua:call(name)
      if not ok then log("Error", "EEHook '" .. name .. "': " .. tostring(result)) end
      return ok and result == true
    end }, EEHook)
  end)
end

-- Gives a Lua the module `rtt` of a component.
local function bind(lua, component)
  local bound = setmetatable({
    getTC = function() return component end, EEHook = eehook_class(component, lua),
  }, { __index = rtt })
  lua.globals.rtt, lua.globals.package.loaded.rtt = bound, bound
  return lua
end

-- Makes an operation of what returns whether it went well, and why not.
local function add_exec(owner, name, where, run)
  add_operation(owner, name, 1, function(argument)
    local ok, problem = run(check_string(argument, name))
    if not ok then log("Error", where .. ": " .. tostring(problem)) end
    return ok
  end)
end

local function add_lua_operations(owner, lua, where)
  add_exec(owner, "exec_str", where, function(code) return lua:run(code) end)
  add_exec(owner, "exec_file", where, function(name) return lua:run_file(name) end)
end

local function new_lua_component(name)
  local component = new_component(name, "PreOperational")
  component.lua = bind(lua_state.new(), component)
  add_lua_operations(component, component.lua, "LuaComponent '" .. name .. "'")
  return component
end

local function add_lua_service(component)
  local service = TaskContext.provides(component, "Lua")
  service.lua = bind(lua_state.new(), component)
  add_lua_operations(service, service.lua, "LuaService '" .. component.name .. "'")
end

-- Deployer --------------------------------------------------------------------

-- By type: what makes a component; those of ocl are there once it is imported.
local FACTORIES = {
  ["OCL::LuaComponent"] = new_lua_component,
  ["OCL::LuaTLSFComponent"] = new_lua_component,
  ["OCL::HelloWorld"] = function(name) return new_component(name, "Stopped") end,
}

local function refuse(problem)
  log("Error", problem)
  return false
end

local function load_component(deployer, name, kind)
  if deployer.peers[name] then
    return refuse("Failed to load component with name " .. name
      .. ": already present as peer or loaded.")
  end
  local make = imported.ocl and FACTORIES[kind]
  if not make then return refuse("Unable to locate Orocos plugin '" .. kind .. "'") end
  TaskContext.addPeer(deployer, make(name))
  return true
end

local function unload_component(deployer, name)
  local component = deployer.peers[name]
  if not component then return refuse("Can't unload component '" .. name .. "'") end
  if component.state == "Running" then
    return refuse("Could not unload Component " .. name .. ": still running.")
  end
  if component.state == "Stopped" then TaskContext.cleanup(component) end
  for i = #component.port_names, 1, -1 do
    TaskContext.removePort(component, component.port_names[i])
  end
  TaskContext.removePeer(deployer, name)
  remove_from(components, component)
  return true
end

local function set_activity(deployer, name, kind, period)
  local component = deployer.peers[name]
  if not component then
    return refuse("Can't create Activity: component " .. name .. " not found.")
  end
  if component.state == "Running" then
    return refuse("Can't change activity of component " .. name
      .. " since it is still running.")
  end
  local ns = floor(period * BILLION + 0.5)
  component.activity = {
    kind = kind, period = ns, due = kind == "Activity" and ns > 0 and now + ns,
  }
  return true
end

local function load_service(deployer, name, service)
  local component = deployer.peers[name]
  if not component then return refuse("No such component " .. name) end
  if service ~= "Lua" then return refuse("No such service " .. service) end
  add_lua_service(component)
  return true
end

-- Returns the port of "component.port"; nil when there is none.
local function find_port(deployer, path)
  local name, port = path:match("^(.-)%.(.*)$")
  local component = name and deployer.peers[name]
  return component and component.ports[port]
end

local function connect(deployer, from, to, policy)
  local a, b = find_port(deployer, from), find_port(deployer, to)
  if not a or not b then return refuse("no such port: " .. (a and to or from)) end
  return Port.connect(a, b, policy)
end

local function new_deployer()
  local deployer = new_component("Deployer", "Running")
  local function operation(name, arity, f)
    add_operation(deployer, name, arity, function(...) return f(deployer, ...) end)
  end
  operation("import", 1, function(_, name)
    imported[name] = true
    return true
  end)
  operation("loadComponent", 2, load_component)
  operation("unloadComponent", 1, unload_component)
  operation("loadService", 2, load_service)
  operation("setActivity", 4, function(_, name, period)
    return set_activity(deployer, name, "Activity", period)
  end)
  operation("setSlaveActivity", 2, function(_, name, period)
    return set_activity(deployer, name, "SlaveActivity", period)
  end)
  operation("connect", 3, connect)
  return deployer
end

-- The process: the program that starts it is the component "lua" ----------------

local main

function rtt.getTC() return main end

--- Starts again: a process with a deployer and nothing else.
function standin.reset()
  now, components, imported = 0, {}, {}
  standin.log, standin.variables = {}, 0
  main = new_component("lua", "Running")
  TaskContext.addPeer(main, new_deployer())
end

standin.reset()

return rtt
