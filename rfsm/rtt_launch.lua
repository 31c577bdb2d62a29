--- Machines launched in the components and services of Orocos RTT-Lua.
--
-- `service_launch_rfsm` puts a chart into the Lua service of a component,
-- `component_launch_rfsm` into a Lua component of its own. Both are fields of
-- `rfsm.rtt`. They execute a text in the other Lua, which loads this module there, too.
-- If that fails, RTT's log has the reason.
--
-- @module rfsm.rtt_launch
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local rfsm_rtt = require "rfsm.rtt"

local collectgarbage, error, ipairs, loadfile = collectgarbage, error, ipairs, loadfile
local loadstring = rawget(_G, "loadstring") or rawget(_G, "load")
local pairs, pcall, rawget, rawset, require = pairs, pcall, rawget, rawset, require
local select, tostring, type = select, tostring, type
local concat, sort = table.concat, table.sort
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local package = package

local rtt_launch = {}

-- In the other Lua: the ports, the machine, its updates --------------------------

-- Returns a printer to RTT's log. OCL mutes the log of the whole process at an error
-- that is no text; here everything is.
local function printer(rtt, level)
  return function(...)
    local texts = {}
    for i = 1, select("#", ...) do texts[i] = rfsm.text_of((select(i, ...))) end
    rtt.logl(level, concat(texts, " "))
  end
end

local LEVELS = { err = "Error", warn = "Warning", info = "Info" }

-- Returns the machine, and the getevents of the chart. Printers that the chart leaves
-- open print to RTT's log.
local function load_machine(rtt, file)
  local model = rfsm.load(file)
  for name, level in pairs(LEVELS) do -- any order: each stands alone
    if model[name] == nil then model[name] = printer(rtt, level) end
  end
  local fsm, problems = rfsm.init(model)
  if not fsm then error("no machine, problems of the chart: " .. #problems, 0) end
  return fsm, model.getevents
end

local function run(chunk, problem)
  if not chunk then error(problem, 0) end
  chunk()
end

local function run_both(file, text)
  if file then run(loadfile(file)) end
  if text then run(loadstring(text)) end
end

local function has_port(component, name)
  for _, other in ipairs(component:getPortNames()) do
    if other == name then return true end
  end
  return false
end

-- Adds a port to the component of a launch, which notes it. RTT would replace and
-- disconnect a port whose name is used again.
local function add_port(launch, direction, name, text)
  local component = launch.component
  if has_port(component, name) then
    error(("'%s' has a port '%s' already"):format(component:getName(), name), 0)
  end
  local port = launch.rtt[direction].new("string", name, text)
  if direction == "InputPort" and launch.is_component then
    component:addEventPort(port)
  else
    component:addPort(port)
  end
  launch.ports[#launch.ports + 1] = port
  return port
end

-- Ports of Lua are no garbage. One that is deleted before it is removed ends the process.
local function remove_ports(launch)
  for _, port in ipairs(launch.ports) do
    launch.component:removePort(port:info().name)
    port:delete()
  end
end

-- Adds the port for events, unless it is unwanted: by default by a chart that has a
-- getevents, or beside a port of that name. The global `extra_in_ports` is a list of
-- ports that a prefile has made.
local function add_events_port(launch, fsm, getevents)
  local name = launch.args.ev_inport
  if name == nil then
    name = not getevents and not has_port(launch.component, "events_in")
  end
  if not name then return end
  if name == true then name = "events_in" end
  local port = add_port(launch, "InputPort", name, "events for the machine")
  local ports = { port }
  for i, extra in ipairs(rawget(_G, "extra_in_ports") or {}) do ports[i + 1] = extra end
  rawset(_G, "ev_inport", port)
  fsm.getevents = rfsm_rtt.gen_read_events(unpack(ports))
end

local function add_out_ports(launch)
  local name = launch.args.ev_outport
  local port = add_port(launch, "OutputPort", launch.args.fqn_port or "fqn",
    "fully qualified name of the active leaf")
  rawset(_G, "fqn", port)
  rawset(_G, "setfqn", rfsm_rtt.gen_write_fqn(port))
  if not name then return end
  port = add_port(launch, "OutputPort", name == true and "events_out" or name,
    "events of the machine")
  rawset(_G, "ev_outport", port)
  rawset(_G, "emit_event", rfsm_rtt.gen_raise_event(port))
end

-- Returns a function that advances the machine. It returns true whatever happens: RTT
-- removes a hook that does not.
local function new_trigger(launch, fsm)
  local args, log = launch.args, printer(launch.rtt, "Error")
  local runs = args.run or launch.is_component and not args.sync
  local advance = runs and rfsm.run or rfsm.step
  return function()
    if args.running_only and launch.component:getState() ~= "Running" then
      return true
    end
    local ok, why = pcall(advance, fsm)
    if not ok then log("rfsm.rtt:", why) end
    return true
  end
end

-- RTT looks the function up by its name at each update, and ends the process if it is
-- not there. So its name is one that no chart uses.
local HOOK = "rfsm.rtt: function of the EEHook"

local held -- a hook that is garbage while it is enabled ends the process, too

local function enable_hook(rtt, trigger)
  rawset(_G, HOOK, trigger)
  held = rtt.EEHook.new(HOOK)
  rawset(_G, "eehook", held)
  held:enable()
end

local function set_up(launch)
  local args = launch.args
  run_both(args.prefile, args.prestr)
  add_out_ports(launch)
  local fsm, getevents = load_machine(launch.rtt, args.fsmfile)
  rfsm.post_step_hook_add(fsm, rawget(_G, "setfqn"))
  add_events_port(launch, fsm, getevents)
  local trigger = new_trigger(launch, fsm)
  rawset(_G, "fsm", fsm)
  rawset(_G, "trigger", trigger)
  if launch.is_component then rawset(_G, "updateHook", function() trigger() end) end
  run_both(args.postfile, args.poststr)
  if args.eehook then enable_hook(launch.rtt, trigger) end
end

-- Is called in the other Lua. Charts rely on rttlib, which makes constructors callable
-- and operations methods, and on utils: both are loaded if they can be had.
function rtt_launch.launch(args)
  local rtt = package.loaded.rtt
  if not rtt then error("no module 'rtt' in this Lua", 0) end
  if rfsm.is_initialized_root(rawget(_G, "fsm")) then
    error("a machine was launched here before, it is the global 'fsm'", 0)
  end
  pcall(require, "rttlib")
  local ok, utils = pcall(require, "utils")
  if ok and rawget(_G, "utils") == nil then rawset(_G, "utils", utils) end
  local launch = {
    args = args, rtt = rtt, component = rtt.getTC(), ports = {},
    is_component = args.name ~= nil,
  }
  local is_set_up, why = pcall(set_up, launch)
  collectgarbage()
  if is_set_up then return end
  remove_ports(launch)
  error(rfsm.text_of(why), 0)
end

-- Texts of Lua: what the other Lua executes ----------------------------------------

local function simple_text(value)
  if type(value) == "string" then return ("%q"):format(value) end
  if type(value) == "boolean" then return tostring(value) end
  local is_finite = type(value) == "number" and value - value == 0
  return is_finite and ("%.17g"):format(value) or nil
end

-- Returns a value as Lua writes it; nil unless it is a string, a number, a boolean, or a
-- list of these.
local function to_text(value)
  if type(value) ~= "table" then return simple_text(value) end
  local texts, count = {}, 0
  for _ in pairs(value) do count = count + 1 end -- any order: only counted
  for i = 1, count do
    texts[i] = simple_text(value[i])
    if not texts[i] then return nil end
  end
  return "{" .. concat(texts, ",") .. "}"
end

local function sorted_names(t)
  local names = {}
  for name in pairs(t) do names[#names + 1] = name end -- any order: sorted
  sort(names, function(a, b) return tostring(a) < tostring(b) end)
  return names
end

-- The pool of a TLSF component fails when it is full, before the collector is due.
local PROGRAM = [[
if rawget(_G, "tlsf") then collectgarbage("setpause", 110) end
%s
if not pcall(require, "rfsm.rtt_launch") then package.path = package.path .. %q end
require("rfsm.rtt_launch").launch { %s }
]]

local function program(args)
  local env, globals, fields = args.env or {}, {}, {}
  for i, name in ipairs(sorted_names(env)) do
    globals[i] = ("rawset(_G, %q, %s)"):format(name, to_text(env[name]))
  end
  for _, name in ipairs(sorted_names(args)) do
    local text = name ~= "env" and simple_text(args[name])
    if text then fields[#fields + 1] = name .. " = " .. text end
  end
  return PROGRAM:format(concat(globals, "\n"), ";" .. package.path, concat(fields, ", "))
end

-- In the Lua of the caller: arguments ----------------------------------------------

local function got(value)
  local text = simple_text(value)
  return "got " .. type(value) .. (text and " " .. text or "")
end

local function env_problem(env)
  for _, name in ipairs(sorted_names(env)) do
    if type(name) ~= "string" then return "names expected as keys, " .. got(name) end
    if not to_text(env[name]) then
      return ("%s: string, number, boolean or a list of these expected, %s"):format(name,
        got(env[name]))
    end
  end
end

local SERVICE = {
  fsmfile = "file name", exec_str = "operation", eehook = "boolean", env = "table",
  run = "boolean", running_only = "boolean", ev_inport = "string or boolean",
  fqn_port = "string",
}
local COMPONENT = {
  name = "string", fsmfile = "file name", deployer = "deployer", luatype = "string",
  sync = "boolean", ev_inport = "string or boolean", ev_outport = "string or boolean",
  fqn_port = "string", prefile = "file name", prestr = "string",
  postfile = "file name", poststr = "string", env = "table",
}
local REQUIRED = { fsmfile = true, exec_str = true, name = true }

local function problem_of(kind, value)
  local is_string = type(value) == "string"
  if kind == "deployer" then return nil end
  if kind == "file name" and is_string then return (select(2, loadfile(value))) end
  if kind == "table" and type(value) == "table" then return env_problem(value) end
  if kind == "operation" and (type(value) == "userdata" or rfsm.is_callable(value))
    or kind:find(type(value), 1, true) then
    return nil
  end
  return kind .. " expected, " .. got(value)
end

-- Returns what is wrong with the arguments of a launch, the first by name.
local function problem_in(args, kinds)
  if type(args) ~= "table" then return "table expected, " .. got(args) end
  for _, name in ipairs(sorted_names(args)) do
    if not kinds[name] then return "unknown field '" .. tostring(name) .. "'" end
  end
  for _, name in ipairs(sorted_names(kinds)) do
    local problem = (args[name] ~= nil or REQUIRED[name])
      and problem_of(kinds[name], args[name])
    if problem then return name .. ": " .. problem end
  end
end

-- Returns whether `f(...)` went well, and why not: it raised, or returned false.
local function succeeds(f, ...)
  local ok, result = pcall(f, ...)
  if not ok then return false, rfsm.text_of(result) end
  return result ~= false, "RTT's log has the reason"
end

-- Launch ----------------------------------------------------------------------------

--- Launch a machine in a Lua service of a component.
--
-- The component gets the ports `fqn` and, unless the chart has a getevents, `events_in`,
-- the service's Lua the globals `fsm`, `trigger`, `setfqn` and `eehook`. With `eehook`
-- the machine takes a step at each update, otherwise when `trigger()` is executed.
--
-- Fields of `options`: `run` (boolean: run the machine, do not only step), `running_only`
-- (boolean: not while the component is stopped or not configured), `ev_inport` and
-- `fqn_port` (as those of `component_launch_rfsm`).
--
-- @usage
--    local exec_str = component:provides("Lua"):getOperation("exec_str")
--    rfsm_rtt.service_launch_rfsm("gripper.lua", exec_str, true)
--
-- @raise when an argument is wrong or the launch fails; then no port is left
---@param file string the chart
---@param exec_str fun(code: string): boolean the service's operation
---@param eehook? boolean
---@param env? table<string, any> globals to define first: strings, numbers, booleans,
--- lists of these
---@param options? table
---@return boolean launched true
function rtt_launch.service_launch_rfsm(file, exec_str, eehook, env, options)
  local where = "rfsm.rtt.service_launch_rfsm: "
  local args = { fsmfile = file, exec_str = exec_str, eehook = eehook, env = env }
  for name, value in pairs(options or {}) do args[name] = value end -- any order: a set
  local problem = problem_in(args, SERVICE)
  if problem then error(where .. problem, 2) end
  local ok, why = succeeds(exec_str, program(args))
  if not ok then error(where .. "exec_str fails: " .. why, 2) end
  return true
end

-- Returns the deployer, given as itself or as the name of a peer, and its operation.
local function find_deployer(deployer)
  if deployer == nil or type(deployer) == "string" then
    deployer = package.loaded.rtt.getTC():getPeer(deployer or "Deployer")
  end
  return deployer, deployer:getOperation("loadComponent")
end

--- What component_launch_rfsm takes.
---@class rfsm.rtt.Launch
---@field name string of the new component
---@field fsmfile string the chart
---@field deployer? any the deployer, or the name of a peer ("Deployer")
---@field luatype? string type of the component ("OCL::LuaComponent")
---@field sync? boolean an update is one step; default: it runs the machine
---@field ev_inport? string|boolean port for events ("events_in"), false: none
---@field ev_outport? string|boolean port ("events_out") to which `emit_event` writes
---@field fqn_port? string port for the FQN of the active leaf ("fqn")
---@field prefile? string file to run before the chart is loaded
---@field prestr? string text to run after prefile
---@field postfile? string file to run at the end, when the global `fsm` is there
---@field poststr? string text to run after postfile
---@field env? table<string, any> globals to define first

--- Launch a machine in a component of its own.
--
-- The component is loaded and has the machine, with the ports `fqn` and, unless the
-- chart has a getevents, `events_in`. Set its activity, connect its ports, configure and
-- start it. An event triggers an update, and an update runs the machine.
--
-- @usage
--    local gripper = rfsm_rtt.component_launch_rfsm {
--      name = "gripper", fsmfile = "gripper.lua", deployer = deployer,
--    }
--    gripper:configure()
--    gripper:start()
--
-- @raise when an argument is wrong or the launch fails; then no component is left
---@param args rfsm.rtt.Launch
---@return any component not configured
function rtt_launch.component_launch_rfsm(args)
  local where = "rfsm.rtt.component_launch_rfsm: "
  local problem = problem_in(args, COMPONENT)
  if problem then error(where .. problem, 2) end
  local is_found, deployer, load_component = pcall(find_deployer, args.deployer)
  if not is_found then
    error(where .. "deployer: none found: " .. rfsm.text_of(deployer), 2)
  end
  local name, component = args.name, nil
  local ok, why = succeeds(load_component, name, args.luatype or "OCL::LuaComponent")
  if ok then
    ok, why = succeeds(function()
      component = deployer:getPeer(name)
      component:addPeer(deployer)
      return component:getOperation("exec_str")(program(args))
    end)
    if not ok then succeeds(deployer:getOperation("unloadComponent"), name) end
  end
  if not ok then error(("%s'%s': %s"):format(where, name, why), 2) end
  return component
end

return rtt_launch
