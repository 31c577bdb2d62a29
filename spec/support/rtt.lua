-- Stands in for the module `rtt` of Orocos RTT-Lua (OCL 2.10): as much of it as its
-- users meet, with its traps:
--
--   - constructors can be called, and operations are methods, only in a Lua that has
--     loaded `rttlib`; `.new` and `getOperation` are always there
--   - `port:connect(other, policy)` ignores the policy, the deployer's does not
--   - `port:read()` returns a value also with "NoData" and "OldData"; `port:read(var)`
--     only the status, and always "NoData" when the type of the Variable is another one
--   - `port:write(a, b)` writes a; a Variable of another type is logged and not written
--   - a data connection keeps the last sample only, a full buffer drops what comes
--   - a port added under a name in use disconnects and replaces the one that has it
--   - strings end at "\0"; numbers wrap as C casts them; no text is a number
--   - an error that is no text mutes the log of the whole process
--   - operations such as exec_str return false, and the log has the reason
--   - each component and each Lua service has a Lua of its own
--   - an EEHook that does not return true is removed; it runs in every state of the
--     component; one without its function, or that was collected, ends the process
--   - configure() of a stopped component calls configureHook again, without cleanupHook
--   - threads: nothing runs at a write or a trigger, see `standin.spin`
--
-- Compared with the real one by spec/rtt_standin_spec.lua, which runs in a rttlua, too.
--
-- The field `standin`, which the real one has not, is for the specs' helper: the clock,
-- the log, the turn of the threads.

local lua_state = require "spec.support.lua_state"

local floor = math.floor
local BILLION = 1000000000

local standin = { log = {} }
local rtt = { standin = standin }

local now = 0         -- nanoseconds
local components = {} -- in the order of their making
local current         -- the Lua that runs: { has_rttlib, ... }

-- Log -------------------------------------------------------------------------

local LEVELS = {
  Never = true, Fatal = true, Critical = true, Error = true, Warning = true,
  Info = true, Debug = true, RealTime = true,
}

local log_is_dead, pending = false, ""

-- Strings of C end at the first zero.
local function c_string(value) return (value:gsub("%z.*", "")) end

local function check_string(value, what)
  if type(value) == "number" then return tostring(value) end
  if type(value) == "string" then return c_string(value) end
  error(("bad argument to '%s' (string expected, got %s)"):format(what, type(value)), 3)
end

local function log(level, text)
  text, pending = pending .. text, ""
  standin.log[#standin.log + 1] = level .. ": " .. (log_is_dead and "" or text)
end

local function refuse(problem)
  log("Error", problem)
  return false
end

-- Logs an error of Lua; one that is no text is the last thing that is logged.
local function log_failure(where, problem)
  local is_text = type(problem) == "string" or type(problem) == "number"
  log("Error", where .. (is_text and check_string(problem, "") or ""))
  log_is_dead = log_is_dead or not is_text
end

-- A bad argument raises when those before it are in the buffer already.
function rtt.logl(level, ...)
  if not LEVELS[level] then error("unknown loglevel " .. tostring(level), 2) end
  for i = 1, select("#", ...) do
    pending = pending .. check_string((select(i, ...)), "logl")
  end
  log(level, "")
end

-- Types and Variables ---------------------------------------------------------

local function cut(number) return number < 0 and -floor(-number) or floor(number) end

-- Casts of C, as the machine does them; NaN is in no range.
local function to_int(number)
  return number > -2147483649 and number < 2147483648 and cut(number) or -2147483648
end

local function to_uint(number)
  return number > -2 ^ 63 and number < 2 ^ 63 and cut(number) % 4294967296 or 0
end

local function same(value) return value end

local function basic(lua, default, convert)
  return { lua = lua, default = default, convert = convert }
end

-- By type: the type of Lua that becomes one, what a new Variable holds, and how. A type
-- that is not basic has no value of Lua; wide integers are converted by others only.
local BASIC = {
  bool = basic("boolean", false, same), string = basic("string", "", c_string),
  char = basic("string", "\0", function(value)
    return value == "" and "\0" or value:sub(1, 1)
  end),
  double = basic("number", 0, same), float = basic("number", 0, same),
  int = basic("number", 0, to_int), uint = basic("number", 0, to_uint),
}
for name in ("long int8 uint8 int16 uint16 int32 uint32 int64 uint64"):gmatch("%S+") do
  BASIC[name] = basic("number", 0, cut) -- as typekits bring them
end
local WIDE = {
  llong = basic(nil, 0, cut),
  ullong = basic(nil, 0, function(number)
    return number < 0 and cut(number) + 2 ^ 64 or cut(number)
  end),
}

local STRUCTS = { -- by type: names of members -> their types; those that users set
  ConnPolicy = { type = "int", size = "int", init = "bool", name_id = "string" },
}

local function default_of(name)
  local simple = BASIC[name] or WIDE[name]
  if simple then return simple.default end
  local value = {}
  for member, inner in pairs(STRUCTS[name]) do value[member] = default_of(inner) end
  return value
end

-- The default of a type; raises if there is no such type.
local function checked_default(name, where)
  if type(name) ~= "string" or not (BASIC[name] or WIDE[name] or STRUCTS[name]) then
    error(where .. ": unknown type " .. tostring(name), 3)
  end
  return default_of(name)
end

local function copy_of(value)
  if type(value) ~= "table" then return value end
  local result = {}
  for member, inner in pairs(value) do result[member] = inner end -- none is a table
  return result
end

-- Returns the value to keep of a value of Lua in something of type `name`.
local function from_lua(name, value)
  local simple, kind = BASIC[name], type(value)
  if name == "bool" and kind == "number" then return value ~= 0 end
  if not simple or simple.lua ~= kind then
    error(("__lua_todsb: can't convert lua %s to %s variable"):format(kind, name), 3)
  end
  return simple.convert(value)
end

-- A Variable holds { name of its type, value }.
local Variable = {}

local function is_variable(value) return getmetatable(value) == Variable end

local function new_variable(name, value)
  return setmetatable({ name, value }, Variable)
end

-- Basic types as values of Lua, others as a Variable of their own.
local function push(name, value)
  if BASIC[name] then return value end
  return new_variable(name, copy_of(value))
end

local methods = {}

function methods.getType(var) return rawget(var, 1) end

function methods.toString(var) return ("%.17g"):format(rawget(var, 2)) end

function methods.tolua(var)
  if BASIC[rawget(var, 1)] then return rawget(var, 2) end
  error("Variable.tolua: can't convert type " .. rawget(var, 1), 2)
end

local function is_numeric(name)
  return name == "bool" or WIDE[name] or BASIC[name] and BASIC[name].lua == "number"
end

-- Assigns a sample of another type; false when RTT does not convert it.
local function assign_other(var, from, value)
  local to = rawget(var, 1)
  if to == "string" and from == "int" then
    log("Warning", "Conversion from int to string")
    rawset(var, 2, "")
    return true
  end
  if not (is_numeric(from) and is_numeric(to)) then return false end
  if from == "double" and to == "int" then
    log("Warning", "Conversion from double to int")
  end
  if type(value) == "boolean" then value = value and 1 or 0 end
  if to == "bool" then value = value ~= 0 end
  rawset(var, 2, (BASIC[to] or WIDE[to]).convert(value))
  return true
end

function methods.assign(var, value)
  local name = rawget(var, 1)
  if not is_variable(value) then
    rawset(var, 2, from_lua(name, value))
  elseif rawget(value, 1) == name then
    rawset(var, 2, copy_of(rawget(value, 2)))
  elseif not assign_other(var, rawget(value, 1), rawget(value, 2)) then
    error("Variable.assign: assignment failed", 2)
  end
end

local function check_member(var, member)
  local struct = STRUCTS[rawget(var, 1)]
  if struct and struct[member] then return struct[member] end
  error("Variable.getMember: indexing failed, no member " .. tostring(member), 3)
end

function Variable.__index(var, member)
  if methods[member] then return methods[member] end
  return push(check_member(var, member), rawget(var, 2)[member])
end

function Variable.__newindex(var, member, value)
  rawget(var, 2)[member] = from_lua(check_member(var, member), value)
end

-- Makes rtt.X with X.new, which can be called where rttlib was loaded.
local function class(name, new)
  return setmetatable({ new = new }, { __call = function(_, ...)
    if current.has_rttlib then return new(...) end
    error("attempt to call field '" .. name .. "' (a table value)", 2)
  end })
end

rtt.Variable = class("Variable", function(name, value)
  local var = new_variable(name, checked_default(name, "Variable.new"))
  if value ~= nil then methods.assign(var, value) end
  return var
end)

-- Connections: one sample, or a buffer -----------------------------------------

-- A connection keeps one sample (DATA), or several and drops what comes when it is full
-- (1), or what it had first (CIRCULAR).
local DATA, CIRCULAR = 0, 2

local default_policy -- a Variable

function rtt.globals_get(name)
  return name == "DefaultConnPolicy" and default_policy or nil
end

local function policy_of(var)
  local value = rawget(var, 2)
  return { type = value.type, size = math.max(value.size, 1), init = value.init }
end

local function connection_write(connection, value)
  local is_data = connection.kind == DATA
  if is_data or connection.kind == CIRCULAR and #connection == connection.size then
    table.remove(connection, 1)
  end
  if is_data or #connection < connection.size then
    connection[#connection + 1] = value
  end
end

-- Ports -----------------------------------------------------------------------

local Port = {}
local InputPort = setmetatable({}, { __index = Port })
local OutputPort = setmetatable({}, { __index = Port })

InputPort.__index, OutputPort.__index = InputPort, OutputPort

-- What a port is from its deletion on.
local DEAD = { __index = function()
  error("attempt to index local 'port' (a userdata value)", 2)
end }

local function is_port(value)
  return getmetatable(value) == InputPort or getmetatable(value) == OutputPort
end

local function check_port(port, metatable, where)
  if getmetatable(port) ~= metatable then error(where .. ": port expected", 3) end
end

function Port.info(port)
  return {
    name = port.name, desc = port.desc, connected = #port.connections > 0,
    type = port.type, porttype = getmetatable(port) == InputPort and "in" or "out",
    isLocal = true,
  }
end

-- Makes rtt.InputPort or rtt.OutputPort. `last` is nil as long as there is none.
local function port_class(name, metatable)
  return class(name, function(kind, port_name, desc)
    checked_default(kind, name .. ".new")
    return setmetatable({
      type = kind, name = port_name or "", desc = desc or "", connections = {},
      component = false, is_event = false, policy = policy_of(default_policy),
    }, metatable)
  end)
end

rtt.InputPort = port_class("InputPort", InputPort)
rtt.OutputPort = port_class("OutputPort", OutputPort)

-- Returns the status, and the sample.
local function read_sample(port)
  for _, connection in ipairs(port.connections) do
    if connection[1] ~= nil then
      port.last = table.remove(connection, 1)
      return "NewData", port.last
    end
  end
  if rawget(port, "last") ~= nil and port.connections[1] then
    return "OldData", port.last
  end
  return "NoData", default_of(port.type)
end

function InputPort.read(port, var)
  check_port(port, InputPort, "InputPort.read")
  if is_variable(var) and rawget(var, 1) ~= port.type then
    log("Error", "trying to read to an incompatible data source")
    return "NoData"
  end
  local status, value = read_sample(port)
  if not is_variable(var) then return status, push(port.type, value) end
  if status ~= "NoData" then rawset(var, 2, copy_of(value)) end
  return status
end

function OutputPort.write(port, value)
  check_port(port, OutputPort, "OutputPort.write")
  if not is_variable(value) then
    value = from_lua(port.type, value)
  elseif rawget(value, 1) == port.type then
    value = copy_of(rawget(value, 2))
  else
    return log("Error", "trying to write from an incompatible data source")
  end
  port.last = value
  for _, connection in ipairs(port.connections) do
    connection_write(connection, value)
    local component = connection.to.is_event and connection.to.component
    if component and component.state == "Running" then component.is_triggered = true end
  end
end

-- Connects in either direction; false and a word in the log when that cannot be.
local function connect_ports(port, other, policy)
  local out, into = port, other
  if getmetatable(port) == InputPort then out, into = other, port end
  if getmetatable(out) ~= OutputPort or getmetatable(into) ~= InputPort
    or out.type ~= into.type then
    return refuse("Port " .. port.name .. " is not compatible with " .. other.name)
  end
  policy = policy or into.policy
  local connection = { kind = policy.type, size = policy.size, from = out, to = into }
  table.insert(out.connections, connection)
  table.insert(into.connections, connection)
  local last = rawget(out, "last")
  if policy.init and last ~= nil then connection_write(connection, last) end
  return true
end

-- A policy is ignored.
function Port.connect(port, other)
  if is_port(other) then return connect_ports(port, other) end
  error("Port.connect: invalid argument 2, expected Port, got userdata", 2)
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
  setmetatable(port, DEAD)
end

-- Properties ------------------------------------------------------------------

local Property = {}
Property.__index = Property

rtt.Property = class("Property", function(kind, name, desc)
  return setmetatable({ type = kind, name = name, desc = desc,
    value = checked_default(kind, "Property.new") }, Property)
end)

function Property:get() return push(self.type, self.value) end

function Property:set(value)
  self.value = is_variable(value) and copy_of(rawget(value, 2))
    or from_lua(self.type, value)
end

-- Operations and services -----------------------------------------------------

local Operation = {}
Operation.__index = Operation

function Operation.__call(operation, ...)
  if select("#", ...) == operation.arity then return operation.f(...) end
  error(("Operation.call: wrong number of args. expected %d, got %d"):format(
    operation.arity, select("#", ...)), 2)
end

local function add_operation(owner, name, arity, f)
  owner.operations[name] = setmetatable({ arity = arity, f = f }, Operation)
end

-- What components and services have.
local Service = {}

function Service.getName(service) return service.name end

function Service.hasOperation(service, name) return service.operations[name] ~= nil end

function Service.getOperation(service, name)
  if service.operations[name] then return service.operations[name] end
  log("Warning", "No such operation in service '" .. service.name .. "': " .. name)
  error(("Service_getOperation: service %s has no operation %s"):format(service.name,
    name), 2)
end

-- Finds methods first; then operations, as methods, in a Lua that has rttlib.
local function new_metatable(class_methods)
  return { __index = function(owner, name)
    local method = class_methods[name] or Service[name]
    if method then return method end
    local operation = current.has_rttlib and rawget(owner, "operations")[name]
    return operation and function(_, ...) return operation(...) end or nil
  end }
end

local SERVICE = new_metatable(Service)

-- TaskContext: ports, properties, peers ----------------------------------------

local TaskContext = {}
local TASK_CONTEXT = new_metatable(TaskContext)

local function new_component(name)
  local component = setmetatable({
    name = name, state = "PreOperational", lua = false, is_triggered = false,
    period = 0, due = false,
    ports = {}, port_names = {}, properties = {}, peers = {},
    operations = {}, services = {},
    hooks = setmetatable({}, { __mode = "v" }), hook_names = {}, hook_count = 0,
  }, TASK_CONTEXT)
  components[#components + 1] = component
  return component
end

function TaskContext.getPortNames(component)
  local names = {}
  for i, name in ipairs(component.port_names) do
    if getmetatable(component.ports[name]) == DEAD then
      error("the process dies: a port was deleted before it was removed", 0)
    end
    names[i] = name
  end
  return names
end

function TaskContext.removePort(component, name)
  local port = component.ports[name]
  if not port then return end
  Port.disconnect(port)
  port.component, component.ports[name] = false, nil
  remove_from(component.port_names, name)
end

function TaskContext.addPort(component, port, name, desc)
  if not is_port(port) then error("addPort: invalid argument, not a Port", 2) end
  if not port.connections[1] then port.name = name or port.name end
  port.desc = desc or port.desc
  if component.ports[port.name] then
    log("Warning", "'addPort' " .. port.name .. ": name already in use. Disconnecting "
      .. "and replacing previous port with new one.")
    TaskContext.removePort(component, port.name)
  end
  port.component, port.is_event = component, false
  component.ports[port.name] = port
  table.insert(component.port_names, port.name)
end

function TaskContext.addEventPort(component, port, name, desc)
  if getmetatable(port) ~= InputPort then error("addEventPort: no InputPort", 2) end
  TaskContext.addPort(component, port, name, desc)
  port.is_event = true
end

-- Getters of what a component has under names; they raise for others.
for kind, field in pairs { Port = "ports", Property = "properties", Peer = "peers" } do
  TaskContext["get" .. kind] = function(component, name) -- any order: each alone
    local found = component[field][name]
    if found then return found end
    error(("TaskContext.get%s: no %s %s"):format(kind, kind:lower(), tostring(name)), 2)
  end
end

function TaskContext.addProperty(component, property)
  component.properties[property.name] = property
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

function TaskContext.provides(component, name)
  if not name then return component end
  if component.services[name] then return component.services[name] end
  error(("Service.provides: no subservice %s of service %s"):format(tostring(name),
    component.name), 2)
end

-- TaskContext: life cycle and engine -------------------------------------------

-- Runs `f(...)` as the Lua `lua`; returns what pcall does.
local function run_in(lua, f, ...)
  local before = current
  current = lua
  local ok, result, why = pcall(f, ...)
  current = before
  if not ok then return false, result end
  return result, why -- those of lua_state
end

-- Calls a global function of a Lua; false and a word in the log when it fails.
local function call_function(component, lua, name, wants_result)
  local ok, result = run_in(lua, lua.call, lua, name)
  local where = "LuaComponent '" .. component.name .. "': "
  if not ok then
    log_failure(where .. "error calling function " .. name .. ": ", result)
    return false
  end
  if not wants_result then return true end
  if type(result) == "boolean" then return result end
  return refuse(where .. name .. " must return a bool but returned a " .. type(result))
end

-- Calls a hook of the component's program, if there is one.
local function call_hook(component, name, wants_result)
  local lua = component.lua
  if not lua or lua.globals[name] == nil then return true end
  return call_function(component, lua, name, wants_result)
end

function TaskContext.getState(component) return component.state end

-- The properties are executed each time; their errors are logged, and no more.
function TaskContext.configure(component)
  if component.state ~= "Stopped" and component.state ~= "PreOperational" then
    return false
  end
  for _, kind in ipairs(component.lua and { "str", "file" } or {}) do
    local name = kind == "str" and "lua_string" or "lua_file"
    local value = component.properties[name]:get()
    if value ~= "" then component.operations["exec_" .. kind](value) end
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

-- Makes stop and cleanup: they lead from a state to another one, and call a hook.
local function leave(from, to, hook)
  return function(component)
    if component.state ~= from then return false end
    component.state = to
    call_hook(component, hook, false)
    return true
  end
end

TaskContext.stop = leave("Running", "Stopped", "stopHook")
TaskContext.cleanup = leave("Stopped", "PreOperational", "cleanupHook")

-- One turn of the thread: hooks, in every state, then updateHook.
local function execute(component)
  component.is_triggered = false
  for i = 1, component.hook_count do
    local hook, is_enabled = component.hooks[i], component.hook_names[i]
    if is_enabled and not hook then
      error("the process dies: an EEHook was collected while it was enabled", 0)
    end
    if is_enabled and not hook.run() then component.hook_names[i] = nil end
  end
  if component.state == "Running" then call_hook(component, "updateHook", false) end
end

-- Gives each thread that was triggered its turn, until none is.
function standin.spin()
  local i, turns = 1, 0
  while components[i] do
    local component = components[i]
    if component.is_triggered and component.period == 0 then
      turns = turns + 1
      assert(turns <= 10000, "standin.spin: components trigger each other for ever")
      execute(component)
      i = 0
    end
    i = i + 1
  end
end

-- Returns the periodic component that is next, no later than `limit`.
local function next_due(limit)
  local found
  for _, component in ipairs(components) do
    local due = component.due
    if due and due <= limit and not (found and found.due <= due) then
      found = component
    end
  end
  return found
end

--- Lets time pass: periodic components have their turns, then those triggered.
function standin.advance(seconds)
  local limit = now + floor(seconds * BILLION + 0.5)
  standin.spin()
  for component in next_due, limit do
    now, component.due = component.due, component.due + component.period
    execute(component)
    standin.spin()
  end
  now = limit
end

function rtt.getTime()
  return floor(now / BILLION), now % BILLION
end

function rtt.sleep(s, ns) standin.advance(floor(s) + ns / BILLION) end

local function set_period(component, period)
  local ns = floor(period * BILLION + 0.5)
  component.period, component.due = ns, ns > 0 and now + ns
  return true
end

-- A component with the operation that each one has.
local function new_engine(name)
  local component = new_component(name)
  add_operation(component, "trigger", 0, function()
    component.is_triggered = component.period == 0
    return component.is_triggered
  end)
  return component
end

-- Lua in components: the component, the service, EEHook ------------------------

-- Makes rtt.EEHook for the Lua `lua` of `component`.
local function eehook_class(component, lua)
  local EEHook = {}
  EEHook.__index = EEHook
  function EEHook:enable()
    local i = component.hook_count + 1
    component.hook_count, component.hooks[i] = i, self
    component.hook_names[i] = self.name
    return true
  end
  function EEHook:disable()
    for i = 1, component.hook_count do
      if component.hooks[i] == self then component.hook_names[i] = nil end
    end
    return true
  end
  return class("EEHook", function(name)
    name = check_string(name, "EEHook")
    return setmetatable({ name = name, run = function()
      if lua.globals[name] == nil then
        error("the process dies: " .. component.name .. ": no (required) Lua function "
          .. name, 0)
      end
      return call_function(component, lua, name, true)
    end }, EEHook)
  end)
end

-- Stands in for rttlib: what its loading does, and the functions that charts use.
local function new_rttlib(lua)
  local rttlib, globals = {}, lua.globals
  lua.has_rttlib = true

  function rttlib.port_clone_conn(port, suffix, name)
    local info = port:info()
    local new = info.porttype == "in" and rtt.OutputPort.new or rtt.InputPort.new
    local clone = new(info.type, name or info.name .. (suffix or "_inv"))
    port:connect(clone)
    return clone
  end

  function rttlib.tc_cleanup()
    local component = globals.rtt.getTC()
    for _, name in ipairs(component:getPortNames()) do
      local port = component:getPort(name)
      component:removePort(name)
      port:delete()
    end
  end

  globals.rttlib, globals.utils = rttlib, { tab2str = tostring }
  globals.package.loaded.utils = globals.utils
  globals.rtt.globals = setmetatable({}, { __index = function(_, name)
    return rtt.globals_get(name)
  end })
  return rttlib
end

-- Makes a Lua with the module `rtt` of a component.
local function new_lua(component)
  local lua = lua_state.new()
  local bound = setmetatable({
    getTC = function() return component end, EEHook = eehook_class(component, lua),
  }, { __index = rtt })
  lua.has_rttlib = false
  lua.globals.rtt, lua.globals.package.loaded.rtt = bound, bound
  lua.globals.package.preload.rttlib = function() return new_rttlib(lua) end
  return lua
end

-- Adds the operations that run a text or a file, return whether that went well, and log
-- why not.
local function add_lua_operations(owner, lua, where)
  for name, run in pairs { exec_str = lua.run, exec_file = lua.run_file } do
    add_operation(owner, name, 1, function(argument) -- any order: two operations
      if type(argument) ~= "string" then
        error("__lua_todsb: can't convert lua " .. type(argument)
          .. " to string variable", 2)
      end
      local ok, problem = run_in(lua, run, lua, c_string(argument))
      if not ok then log_failure(where, problem) end
      return ok
    end)
  end
end

-- Deployer --------------------------------------------------------------------

local FACTORIES = {} -- by type: what makes a component

FACTORIES["OCL::LuaComponent"] = function(name)
  local component = new_engine(name)
  component.lua = new_lua(component)
  add_lua_operations(component, component.lua, "LuaComponent '" .. name .. "': ")
  for _, property in ipairs { "lua_string", "lua_file" } do
    TaskContext.addProperty(component, rtt.Property.new("string", property))
  end
  return component
end

-- Its pool is not: `tlsf` is all that is different.
FACTORIES["OCL::LuaTLSFComponent"] = function(name)
  local component = FACTORIES["OCL::LuaComponent"](name)
  component.lua.globals.tlsf = {
    stats = function() end, trace = function() end, warn = function() end,
  }
  return component
end

FACTORIES["OCL::HelloWorld"] = function(name)
  local component = new_engine(name)
  TaskContext.addPort(component, rtt.OutputPort.new("string", "the_results"))
  TaskContext.addPort(component, rtt.InputPort.new("string", "the_buffer_port"))
  set_period(component, 0.1)
  return component
end

local DEPLOYER = {} -- its operations

function DEPLOYER.loadComponent(deployer, name, kind)
  if deployer.peers[name] then
    return refuse("Failed to load component with name " .. name
      .. ": already present as peer or loaded.")
  end
  local make = FACTORIES[kind]
  if not make then return refuse("Unable to locate Orocos plugin '" .. kind .. "'") end
  TaskContext.addPeer(deployer, make(name))
  return true
end

function DEPLOYER.unloadComponent(deployer, name)
  local component = deployer.peers[name]
  if not component then return refuse("Can't unload component '" .. name .. "'") end
  if component.state == "Running" then
    return refuse("Could not unload Component " .. name .. ": still running.")
  end
  TaskContext.cleanup(component)
  for i = #component.port_names, 1, -1 do
    TaskContext.removePort(component, component.port_names[i])
  end
  TaskContext.removePeer(deployer, name)
  remove_from(components, component)
  return true
end

function DEPLOYER.setActivity(deployer, name, period)
  local component = deployer.peers[name]
  if not component then
    return refuse("Can't create Activity: component " .. name .. " not found.")
  elseif component.state == "Running" then
    return refuse("Can't change activity of component " .. name
      .. " since it is still running.")
  end
  return set_period(component, period)
end

function DEPLOYER.loadService(deployer, name, kind)
  local component = deployer.peers[name]
  if not component then return refuse("No such component " .. name) end
  if kind ~= "Lua" then return refuse("No such service " .. kind) end
  local service = setmetatable({ name = kind, operations = {} }, SERVICE)
  component.services[kind] = service
  add_lua_operations(service, new_lua(component), "LuaService '" .. name .. "': ")
  return true
end

-- Returns the port of "component.port"; nil when there is none.
local function find_port(deployer, path)
  local name, port = path:match("^(.-)%.(.*)$")
  local component = name and deployer.peers[name]
  return component and component.ports[port]
end

function DEPLOYER.connect(deployer, from, to, policy)
  local a, b = find_port(deployer, from), find_port(deployer, to)
  if not a or not b then return refuse("no such port: " .. (a and to or from)) end
  return connect_ports(a, b, policy_of(policy))
end

local ARITY = {
  loadComponent = 2, unloadComponent = 1, loadService = 2, setActivity = 4, connect = 3,
}

local function new_deployer()
  local deployer = new_component("Deployer")
  deployer.state = "Running"
  for name, arity in pairs(ARITY) do -- any order: distinct operations
    add_operation(deployer, name, arity, function(...)
      return DEPLOYER[name](deployer, ...)
    end)
  end
  return deployer
end

-- The process: the program that starts it is the component "lua" ----------------

local main

function rtt.getTC() return main end

--- Starts again: a process with a deployer and nothing else.
function standin.reset()
  now, components = 0, {}
  standin.log, log_is_dead, pending = {}, false, ""
  current = { has_rttlib = false, globals = { rtt = rtt, package = package } }
  default_policy = new_variable("ConnPolicy", default_of("ConnPolicy"))
  main = new_component("lua")
  local deployer, this_lua = new_deployer(), current
  TaskContext.addPeer(main, deployer)
  TaskContext.addPeer(deployer, main)
  package.loaded.rttlib = nil
  package.preload.rttlib = function() return new_rttlib(this_lua) end
end

standin.reset()

return rtt
