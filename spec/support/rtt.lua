-- Stands in for the module `rtt` of Orocos RTT-Lua (OCL 2.10): as much of it as its
-- users meet, with its traps. spec/rtt_standin_spec.lua names them; in a rttlua it
-- compares them with the real one.
--
-- There are no threads: nothing runs at a write or a trigger, but in `standin.spin`,
-- and components with a period as time passes. What another thread could meet is
-- forbidden instead: a call in a Lua of a service, once its hook is enabled. The field
-- `standin`, which the real one has not, is for the specs' helper.

local lua_state = require "spec.support.lua_state"

local floor = math.floor
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local BILLION = 1000000000

local standin = { log = {} }
local rtt = { standin = standin }

local now = 0         -- nanoseconds
local components = {} -- in the order of their making
local current         -- the Lua that runs: { registry, globals, ... }

-- Log -------------------------------------------------------------------------

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
  for i = 1, select("#", ...) do
    pending = pending .. check_string((select(i, ...)), "logl")
  end
  log(level, "")
end

-- The death of the process: nobody can catch it, `standin.check` raises it again.
local function die(how)
  standin.death = "the process dies: " .. how
  error(standin.death, 0)
end

-- An operation in C++ that throws, for components that are loaded while the field
-- `has_exceptions` is true.
function standin.throw() error(lua_state.EXCEPTION, 0) end

function standin.check() if standin.death then error(standin.death, 0) end end

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

-- By type: the type of Lua that becomes one, the value of a new Variable, conversion.
-- Wide integers are converted from other types only.
local TYPES = {
  bool = { "boolean", false, same }, string = { "string", "", c_string },
  char = { "string", "\0", function(value)
    return value == "" and "\0" or value:sub(1, 1)
  end },
  double = { "number", 0, same }, float = { "number", 0, same },
  int = { "number", 0, to_int }, uint = { "number", 0, to_uint },
  llong = { "none", 0, cut }, ullong = { "none", 0, function(number)
    return number < 0 and cut(number) + 2 ^ 64 or cut(number)
  end },
}
for name in ("long int8 uint8 int16 uint16 int32 uint32 int64 uint64"):gmatch("%S+") do
  TYPES[name] = { "number", 0, cut } -- as typekits bring them
end

-- The only struct, by members.
local POLICY = { type = "int", size = "int", init = "bool", name_id = "string" }

-- The default of a type; raises if there is no such type.
local function default_of(name, where)
  if TYPES[name] then return TYPES[name][2] end
  if name ~= "ConnPolicy" then
    error(where .. ": unknown type " .. tostring(name), 3)
  end
  local value = {}
  for member, kind in pairs(POLICY) do value[member] = TYPES[kind][2] end
  return value
end

local function copy_of(value)
  if type(value) ~= "table" then return value end
  local result = {}
  for member, inner in pairs(value) do result[member] = inner end -- none is a table
  return result
end

local function is_basic(name) return TYPES[name] and TYPES[name][1] ~= "none" end

-- Returns the value to keep of a value of Lua in something of type `name`.
local function from_lua(name, value)
  local kind = type(value)
  if name == "bool" and kind == "number" then return value ~= 0 end
  if not TYPES[name] or TYPES[name][1] ~= kind then
    error(("__lua_todsb: can't convert lua %s to %s variable"):format(kind, name), 3)
  end
  return TYPES[name][3](value)
end

-- A Variable holds { name of its type, value }.
local Variable = {}

local function is_variable(value) return getmetatable(value) == Variable end

local function new_variable(name, value)
  return setmetatable({ name, value }, Variable)
end

-- Basic types as values of Lua, others as a Variable of their own.
local function push(name, value)
  if is_basic(name) then return value end
  return new_variable(name, copy_of(value))
end

local methods = {}

function methods.getType(var) return rawget(var, 1) end

function methods.tolua(var)
  if is_basic(rawget(var, 1)) then return rawget(var, 2) end
  error("Variable.tolua: can't convert type " .. rawget(var, 1), 2)
end

local function is_numeric(name)
  return TYPES[name] and TYPES[name][1] ~= "string"
end

-- Assigns a sample of another type; false when RTT does not convert it.
local function assign_other(var, from, value)
  local to = rawget(var, 1)
  if not (is_numeric(from) and is_numeric(to)) then return false end
  if from == "double" and to == "int" then
    log("Warning", "Conversion from double to int")
  end
  if type(value) == "boolean" then value = value and 1 or 0 end
  if to == "bool" then value = value ~= 0 end
  rawset(var, 2, TYPES[to][3](value))
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

local function type_of_member(var, member)
  local kind = rawget(var, 1) == "ConnPolicy" and POLICY[member]
  if kind then return kind end
  error("Variable.getMember: indexing failed, no member " .. tostring(member), 3)
end

function Variable.__index(var, member)
  if methods[member] then return methods[member] end
  return push(type_of_member(var, member), rawget(var, 2)[member])
end

function Variable.__newindex(var, member, value)
  rawget(var, 2)[member] = from_lua(type_of_member(var, member), value)
end

-- Makes rtt.X with X.new, which rttlib makes callable. Each Lua has its own.
local function class(new) return { new = new } end

rtt.Variable = class(function(name, value)
  local var = new_variable(name, default_of(name, "Variable.new"))
  if value ~= nil then methods.assign(var, value) end
  return var
end)

-- Connections: one sample, or a buffer -----------------------------------------

local IS_ACTIVE = { Running = true, RunTimeError = true } -- states of a component

local DATA = 0 -- keeps one sample; a buffer drops what comes when it is full

local default_policy -- a Variable

function rtt.globals_get(name)
  return name == "DefaultConnPolicy" and default_policy or nil
end

local function policy_of(var)
  local value = rawget(var, 2)
  return { type = value.type, size = math.max(value.size, 1), init = value.init }
end

local function connection_write(connection, value)
  if connection.kind == DATA then connection[1] = nil end
  if #connection < connection.size then connection[#connection + 1] = value end
end

-- Ports -----------------------------------------------------------------------

local Port = {}
local InputPort = setmetatable({}, { __index = Port })
local OutputPort = setmetatable({}, { __index = Port })

InputPort.__index, OutputPort.__index = InputPort, OutputPort

-- What a port is from its deletion on: for who deleted it, and for others who have it.
local DEAD = { __index = function()
  error("attempt to index local 'port' (a userdata value)", 2)
end }
local FREED = { __index = function() die("a port was used that is deleted") end }

-- What `getPort` returns: one more pointer to the port.
local HANDLE = {}

local function real_of(port)
  return getmetatable(port) == HANDLE and rawget(port, 1) or port
end

local function delete(handle)
  rawget(handle, 1):disconnect()
  setmetatable(rawget(handle, 1), FREED)
  setmetatable(handle, DEAD)
end

local forward = setmetatable({}, { __index = function(made, name)
  made[name] = name == "delete" and delete or function(handle, other, ...)
    local real = rawget(handle, 1)
    return real[name](real, real_of(other), ...)
  end
  return made[name]
end })

function HANDLE.__index(handle, name)
  local value = rawget(handle, 1)[name]
  return type(value) == "function" and forward[name] or value
end

function Port.info(port)
  return {
    name = port.label, desc = port.desc, connected = #port.connections > 0,
    type = port.type, porttype = getmetatable(port) == InputPort and "in" or "out",
    isLocal = true,
  }
end

-- Makes rtt.InputPort or rtt.OutputPort. `last` is nil as long as there is none.
local function port_class(name, metatable)
  return class(function(kind, port_name, desc)
    default_of(kind, name .. ".new")
    return setmetatable({
      type = kind, label = port_name or "", desc = desc or "", connections = {},
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
    if component and IS_ACTIVE[component.state] then component.is_triggered = true end
  end
end

-- Connects in either direction; false and a word in the log when that cannot be.
local function connect_ports(port, other, policy)
  local out, into = port, other
  if getmetatable(port) == InputPort then out, into = other, port end
  if getmetatable(out) ~= OutputPort or getmetatable(into) ~= InputPort
    or out.type ~= into.type then
    return refuse("Port " .. port.label .. " is not compatible with " .. other.label)
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
function Port.connect(port, other) return connect_ports(port, real_of(other)) end

local function remove_from(list, value)
  for i = #list, 1, -1 do
    if list[i] == value then table.remove(list, i) end
  end
end

-- A list of names holds under each of them what has that name.
local function add_named(list, name, value)
  list[name] = value
  table.insert(list, name)
end

local function remove_named(list, name)
  list[name] = nil
  remove_from(list, name)
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

-- Attributes; properties of type string ------------------------------------------

-- Its value is in a Variable, which stays when the attribute is removed.
local Attribute = {}
Attribute.__index = Attribute

function Attribute:get() return push(rawget(self.value, 1), rawget(self.value, 2)) end

function Attribute:set(value) methods.assign(self.value, value) end

function Attribute:getRaw() return self.value end

rtt.Attribute = class(function(kind, name)
  return setmetatable({ label = name or "", value = rtt.Variable.new(kind) }, Attribute)
end)

local Property = {}
Property.__index = Property

function Property:get() return self.value end

function Property:set(value) self.value = from_lua("string", value) end

-- Operations and services -----------------------------------------------------

-- An operation counts its arguments.
local function operation(arity, f)
  return function(...)
    local n = select("#", ...)
    if n == arity then return f(...) end
    error(("Operation.call: %d arguments expected, got %d"):format(arity, n), 2)
  end
end

-- What components and services have.
local Service = {}

function Service.getName(service) return service.label end

function Service.hasOperation(service, name) return service.operations[name] ~= nil end

function Service.getOperation(service, name)
  if service.operations[name] then return service.operations[name] end
  error(("Service_getOperation: service %s has no operation %s"):format(service.label,
    name), 2)
end

-- In each Lua the class of a kind is in the registry. Its `__index` finds methods, and
-- with rttlib operations, too.
local function new_metatable(kind)
  return { __index = function(owner, name)
    return current.registry[kind].__index(owner, name)
  end, __tostring = function(owner)
    local to_text = current.registry[kind].__tostring
    return to_text and to_text(owner) or kind
  end }
end

local SERVICE = new_metatable("Service")

-- TaskContext: ports, properties, peers ----------------------------------------

local TaskContext = {}
local TASK_CONTEXT = new_metatable("TaskContext")

local function new_component(name)
  local component = setmetatable({
    label = name, state = "PreOperational", lua = false, is_triggered = false,
    period = 0, due = false, ports = {}, peers = {}, properties = {}, operations = {},
    services = {}, hooks = {}, attributes = {},
  }, TASK_CONTEXT)
  component.operations.trigger = operation(0, function()
    component.is_triggered = component.period == 0
    return component.is_triggered
  end)
  component.operations.getPeriod = operation(0, function()
    return component.period / BILLION
  end)
  components[#components + 1] = component
  return component
end

function TaskContext.getPortNames(component)
  for _, name in ipairs(component.ports) do
    local metatable = getmetatable(component.ports[name])
    if metatable == DEAD or metatable == FREED then
      die("a port was deleted before it was removed")
    end
  end
  return { unpack(component.ports) }
end

function TaskContext.removePort(component, name)
  local port = component.ports[name]
  if not port then return end
  Port.disconnect(port)
  port.component = false
  remove_named(component.ports, name)
end

function TaskContext.addPort(component, port, name, desc)
  port = real_of(port)
  if not port.connections[1] then port.label = name or port.label end
  port.desc = desc or port.desc
  if component.ports[port.label] then
    log("Warning", "'addPort' " .. port.label .. ": name already in use. Disconnecting "
      .. "and replacing previous port with new one.")
    TaskContext.removePort(component, port.label)
  end
  port.component, port.is_event = component, false
  add_named(component.ports, port.label, port)
end

function TaskContext.addEventPort(component, port, name, desc)
  port = real_of(port)
  if getmetatable(port) ~= InputPort then error("addEventPort: no InputPort", 2) end
  TaskContext.addPort(component, port, name, desc)
  port.is_event = true
end

-- Getters of what a component has under names; they raise for others.
for kind, field in pairs { Port = "ports", Property = "properties", Peer = "peers",
  Attribute = "attributes" } do
  TaskContext["get" .. kind] = function(component, name) -- any order: each alone
    local found = component[field][name]
    if found and kind == "Port" then return setmetatable({ found }, HANDLE) end
    if found then return found end
    error(("TaskContext.get%s: no %s %s"):format(kind, kind:lower(), tostring(name)), 2)
  end
end

function TaskContext.removeAttribute(component, name)
  if not component.attributes[name] then error("No such attribute", 2) end
  setmetatable(component.attributes[name], FREED)
  remove_named(component.attributes, name)
end

-- The first one of a name is found.
function TaskContext.addAttribute(component, attribute)
  if component.attributes[attribute.label] then return end
  add_named(component.attributes, attribute.label, attribute)
end

function TaskContext.getAttributeNames(component)
  return { unpack(component.attributes) }
end

function TaskContext.addPeer(component, peer)
  add_named(component.peers, peer.label, peer)
end

function TaskContext.getPeers(component)
  local names = { unpack(component.peers) }
  table.sort(names)
  return names
end

function TaskContext.provides(component, name)
  if not name then return component end
  if component.services[name] then return component.services[name] end
  error(("Service.provides: no subservice %s of service %s"):format(tostring(name),
    component.label), 2)
end

-- TaskContext: life cycle and engine -------------------------------------------

-- Runs `f(...)` as the Lua `lua`; returns what pcall does. A hook that it enables is
-- called by another thread from then on.
local function run_in(lua, f, ...)
  local before, sethook = current, debug.sethook
  current = lua
  local ok, result, why = pcall(f, ...)
  sethook()
  current = before
  if not ok then return false, result end
  return result, why -- those of lua_state
end

-- Calls a global function of a Lua; false and a word in the log when it fails.
local function call_function(component, lua, name, wants_result)
  local ok, result = run_in(lua, lua.call, lua, name)
  if result == lua_state.EXCEPTION then error(result, 0) end
  local where = "LuaComponent '" .. component.label .. "': "
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

-- What RTT does when an exception comes out of a hook.
local function fail(component, where)
  local before = component.state
  log("Error", "in " .. where
    .. "(): switching to exception state because of unhandled exception")
  component.state = "Exception"
  if IS_ACTIVE[before] then call_hook(component, "stopHook", false) end
  if before ~= "PreOperational" then call_hook(component, "cleanupHook", false) end
end

-- Calls a hook likewise; nil if an exception came out of it.
local function try_hook(component, name, wants_result)
  local ok, result = pcall(call_hook, component, name, wants_result)
  if ok then return result end
  if result ~= lua_state.EXCEPTION then error(result, 0) end
  return fail(component, name)
end

function TaskContext.getState(component) return component.state end

-- The properties are executed each time; their errors are logged, and no more.
local function run_properties(component)
  for _, kind in ipairs(component.lua and { "str", "file" } or {}) do
    local name = kind == "str" and "lua_string" or "lua_file"
    local value = component.properties[name]:get()
    if value ~= "" then component.operations["exec_" .. kind](value) end
  end
end

function TaskContext.configure(component)
  if component.state ~= "Stopped" and component.state ~= "PreOperational" then
    return false
  end
  run_properties(component)
  local ok = try_hook(component, "configureHook", true)
  if ok ~= nil then component.state = ok and "Stopped" or "PreOperational" end
  return ok or false
end

function TaskContext.start(component)
  if component.state ~= "Stopped" then return false end
  if not try_hook(component, "startHook", true) then return false end
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

-- errorHook is called in place of updateHook until somebody recovers.
function TaskContext.error(component)
  if component.state == "Running" then component.state = "RunTimeError" end
end

function TaskContext.recover(component)
  if not (component.state == "RunTimeError" or component.state == "Exception") then
    return false
  end
  component.state = component.state == "Exception" and "PreOperational" or "Running"
  return true
end

local stop = leave("Running", "Stopped", "stopHook")

function TaskContext.stop(component)
  if component.state == "RunTimeError" then TaskContext.recover(component) end
  return stop(component)
end
TaskContext.cleanup = leave("Stopped", "PreOperational", "cleanupHook")

-- An exception that comes out of an EEHook ends the thread.
local function stop_thread(component, problem)
  if problem ~= lua_state.EXCEPTION then error(problem, 0) end
  component.is_dead = true
  log("Critical", component.label .. " caught a C++ exception, stopped thread !")
end

-- One turn of the thread: hooks, in every state, then updateHook.
local function execute(component)
  component.is_triggered = false
  if component.is_dead then return end
  local i, hooks = 1, component.hooks
  while hooks[i] do
    local hook = hooks[i][1]
    if not hook then die("an enabled EEHook was collected") end
    table.remove(hooks, i)
    local ok, goes_on = pcall(hook.run)
    if not ok then return stop_thread(component, goes_on) end
    if goes_on then
      table.insert(hooks, i, setmetatable({ hook }, { __mode = "v" }))
      i = i + 1
    end
  end
  local hook = component.state == "Running" and "updateHook"
    or component.state == "RunTimeError" and "errorHook"
  if hook then try_hook(component, hook, false) end
end

-- Starts the thread again.
function TaskContext.activate(component)
  component.is_dead = false
  return true
end

-- Gives each thread that was triggered its turn, until none is.
function standin.spin()
  standin.check()
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
  standin.check()
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

-- Time passes: periodic components have their turns, then those triggered.
function rtt.sleep(s, ns)
  local limit = now + floor(s) * BILLION + ns
  standin.spin()
  for component in next_due, limit do
    now, component.due = component.due, component.period > 0
      and component.due + component.period
    if component.fire then component.fire() end
    execute(component)
    standin.spin()
  end
  now = limit
end

function rtt.getTime() return floor(now / BILLION), now % BILLION end

local function set_period(component, period)
  local ns = floor(period * BILLION + 0.5)
  component.period, component.due = ns, ns > 0 and now + ns
  return true
end

-- Lua in components: the component, the service, EEHook ------------------------

-- Makes rtt.EEHook for the Lua `lua` of `component`.
local function eehook_class(component, lua)
  local EEHook = {}
  EEHook.__index = EEHook
  function EEHook:enable() -- held by the chart, or by nobody
    table.insert(component.hooks, setmetatable({ self }, { __mode = "v" }))
    local sethook = debug.sethook
    sethook(function()
      if debug.getinfo(2, "f").func == sethook then return end
      sethook()
      die("two threads are in one Lua")
    end, "c")
    return true
  end
  function EEHook:disable()
    for i = #component.hooks, 1, -1 do
      if component.hooks[i][1] == self then table.remove(component.hooks, i) end
    end
    return true
  end
  return class(function(name)
    name = check_string(name, "EEHook")
    return setmetatable({ label = name, run = function()
      if lua.globals[name] == nil then
        die(component.label .. ": no (required) Lua function " .. name)
      end
      return call_function(component, lua, name, true)
    end }, EEHook)
  end)
end

local CLASSES = { "Variable", "Attribute", "InputPort", "OutputPort", "EEHook" }

local function find_method(owner, name)
  local methods_of = getmetatable(owner) == TASK_CONTEXT and TaskContext or Service
  return methods_of[name] or Service[name]
end

local function new_registry()
  local function class_of() return { __index = find_method } end
  return { TaskContext = class_of(), Service = class_of() }
end

-- Stands in for rttlib: what its loading does, and the functions that charts use.
local function new_rttlib(lua)
  local rttlib, globals = {}, lua.globals
  for _, class_of in pairs(lua.registry) do -- any order: two
    class_of.__index = function(owner, name)
      local method, call = find_method(owner, name), rawget(owner, "operations")[name]
      return method or call and function(_, ...) return call(...) end or nil
    end
    class_of.__tostring = function(owner) return "rttlib: " .. owner.label end
  end
  for _, name in ipairs(CLASSES) do
    setmetatable(globals.rtt[name], { __call = function(self, ...)
      return self.new(...)
    end })
  end

  function rttlib.port_clone_conn(port, suffix, name)
    local info = port:info()
    local new = info.porttype == "in" and rtt.OutputPort.new or rtt.InputPort.new
    local clone = new(info.type, (name or info.name) .. (suffix or ""))
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
    for _, name in ipairs(component:getAttributeNames()) do
      component:removeAttribute(name)
    end
  end

  assert(not globals.rttlib, "module() would change the table that is there")
  globals.rttlib, globals.utils = rttlib, { tab2str = tostring }
  globals.package.loaded.utils = globals.utils
  globals.rtt.globals = setmetatable({}, { __index = function(_, name)
    return rtt.globals_get(name)
  end })
  return rttlib
end

-- Makes a Lua with the module `rtt` of a component.
local function new_lua(component)
  local lua = lua_state.new(standin.has_exceptions)
  local bound = setmetatable({
    getTC = function() return component end, EEHook = eehook_class(component, lua),
  }, { __index = rtt })
  for _, name in ipairs(CLASSES) do
    rawset(bound, name, rawget(bound, name)
      or class(function(...) return rtt[name].new(...) end))
  end
  lua.registry = new_registry()
  lua.globals.debug.getregistry = function() return lua.registry end
  lua.globals.rtt, lua.globals.package.loaded.rtt = bound, bound
  lua.globals.package.preload.rttlib = function() return new_rttlib(lua) end
  return lua
end

-- Adds the operations that run a text or a file, return whether that went well, and log
-- why not.
local function add_lua_operations(owner, lua, where)
  for name, run in pairs { exec_str = lua.run, exec_file = lua.run_file } do
    owner.operations[name] = operation(1, function(argument) -- any order: two
      if type(argument) ~= "string" then
        error("__lua_todsb: can't convert lua " .. type(argument)
          .. " to string variable", 2)
      end
      local ok, problem = run_in(lua, run, lua, c_string(argument))
      if problem == lua_state.EXCEPTION then error(problem, 0) end
      if not ok then log_failure(where, problem) end
      return ok
    end)
  end
end

-- Deployer --------------------------------------------------------------------

local FACTORIES = {} -- by type: what makes a component

FACTORIES["OCL::LuaComponent"] = function(name)
  local component = new_component(name)
  component.lua = new_lua(component)
  add_lua_operations(component, component.lua, "LuaComponent '" .. name .. "': ")
  for _, property in ipairs { "lua_string", "lua_file" } do
    component.properties[property] = setmetatable({ value = "" }, Property)
  end
  return component
end

local POOL = 1048576 -- bytes

-- Its pool is one in name only. `tlsf.fill`, which the real one has not, fills it with
-- garbage: from then on what needs memory fails, until somebody collects.
FACTORIES["OCL::LuaTLSFComponent"] = function(name)
  local component = FACTORIES["OCL::LuaComponent"](name)
  local globals, used, size = component.lua.globals, POOL / 2, POOL
  globals.tlsf = {
    stats = function() return used, size, size end,
    fill = function(part) used = POOL * part end,
  }
  component.operations.tlsf_incmem = operation(1, function(bytes)
    if size > POOL then
      error("tlsf_rtt_incmem: region already increased, (increasing cur. only possible "
        .. "once)", 0)
    end
    size = size + methods.tolua(bytes)
    return false
  end)
  function globals.collectgarbage(what, ...)
    if what == nil or what == "collect" then used = POOL / 2 end
    return collectgarbage(what, ...)
  end
  for _, f in ipairs { "concat", "insert" } do -- examples of what needs memory
    globals.table[f] = function(...)
      if used == POOL then error("not enough memory", 0) end
      return table[f](...)
    end
  end
  return component
end

FACTORIES["OCL::TimerComponent"] = function(name)
  local component = new_component(name)
  local port = rtt.OutputPort.new("int", "timer_0")
  TaskContext.addPort(component, port)
  component.operations.arm = operation(2, function(_, seconds)
    if component.is_unloaded then error("RTT has ended the process", 0) end
    if is_variable(seconds) then seconds = methods.tolua(seconds) end
    component.due = now + floor(seconds * BILLION + 0.5)
    return true
  end)
  component.fire = function() port:write(0) end
  return component
end

FACTORIES["OCL::HelloWorld"] = function(name)
  local component = new_component(name)
  TaskContext.addPort(component, rtt.OutputPort.new("string", "the_results"))
  TaskContext.addPort(component, rtt.InputPort.new("string", "the_buffer_port"))
  set_period(component, 0.1)
  return component
end

local deployer -- a component
local DEPLOYER = {} -- its operations

DEPLOYER.loadComponent = operation(2, function(name, kind)
  if deployer.peers[name] then return refuse(name .. ": already present as peer") end
  local make = FACTORIES[kind]
  if not make then return refuse("Unable to locate Orocos plugin '" .. kind .. "'") end
  TaskContext.addPeer(deployer, make(name))
  return true
end)

-- What a program still has of a component that was unloaded.
local UNLOADED = { __index = function()
  error("TaskContext.provides: no default service", 2)
end }

DEPLOYER.unloadComponent = operation(1, function(name)
  local component = deployer.peers[name]
  if not component or IS_ACTIVE[component.state] then
    return refuse("Can't unload component '" .. name .. "'")
  end
  TaskContext.cleanup(component)
  for _, port in ipairs(TaskContext.getPortNames(component)) do
    TaskContext.removePort(component, port)
  end
  for _, other in ipairs(components) do remove_named(other.peers, name) end
  remove_named(deployer.peers, name)
  remove_from(components, component)
  component.is_unloaded = true
  setmetatable(component, UNLOADED)
  return true
end)

DEPLOYER.setActivity = operation(4, function(name, period)
  local component = deployer.peers[name]
  if not component or component.state == "Running" then
    return refuse("Can't change activity of component " .. name)
  end
  return set_period(component, period)
end)

DEPLOYER.loadService = operation(2, function(name, kind)
  local component = deployer.peers[name]
  if not component or kind ~= "Lua" then return refuse("No service " .. kind) end
  local service = setmetatable({ label = kind, operations = {} }, SERVICE)
  component.services[kind] = service
  add_lua_operations(service, new_lua(component), "LuaService '" .. name .. "': ")
  return true
end)

-- Returns the port of "component.port"; nil when there is none.
local function find_port(path)
  local name, port = path:match("^(.-)%.(.*)$")
  local component = name and deployer.peers[name]
  return component and component.ports[port]
end

DEPLOYER.connect = operation(3, function(from, to, policy)
  local a, b = find_port(from), find_port(to)
  if not a or not b then return refuse("no such port: " .. (a and to or from)) end
  return connect_ports(a, b, policy_of(policy))
end)

-- The process: the program that starts it is the component "lua" ----------------

local main

function rtt.getTC() return main end

--- Starts again: a process with a deployer and nothing else.
function standin.reset()
  now, components, standin.has_exceptions = 0, {}, false
  standin.log, log_is_dead, pending, standin.death = {}, false, "", nil
  current = { registry = new_registry(), globals = { rtt = rtt, package = package } }
  default_policy = new_variable("ConnPolicy", default_of("ConnPolicy"))
  main = new_component("lua")
  local this_lua = current
  deployer = new_component("Deployer")
  deployer.state, deployer.operations = "Running", DEPLOYER
  TaskContext.addPeer(main, deployer)
  TaskContext.addPeer(deployer, main)
  package.loaded.rttlib = nil
  package.preload.rttlib = function() return new_rttlib(this_lua) end
end

standin.reset()

return rtt
