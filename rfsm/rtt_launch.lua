--- Machines launched in the components and services of Orocos RTT-Lua.
--
-- `service_launch_rfsm` puts a chart into the Lua service of a component,
-- `component_launch_rfsm` into a Lua component of its own. Both are fields of
-- `rfsm.rtt`. They execute a text in the other Lua, which loads this module there.
--
-- @submodule rfsm.rtt
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local rfsm_rtt = require "rfsm.rtt"

local error, ipairs, loadfile, pairs, pcall = error, ipairs, loadfile, pairs, pcall
local rawget, rawset, require, select = rawget, rawset, require, select
local tostring, type = tostring, type
local collectgarbage, package = collectgarbage, package
local concat = table.concat
local loadstring = rawget(_G, "loadstring") or rawget(_G, "load")
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local rtt_launch = {}

-- In the other Lua: the ports, the machine, its updates --------------------------

-- Returns a printer to RTT's log. It logs texts only, since OCL mutes the log of the
-- whole process at an error that is no text.
local function printer(rtt, level)
  return function(...)
    local texts = {}
    for i = 1, select("#", ...) do texts[i] = rfsm.text_of((select(i, ...))) end
    rtt.logl(level, concat(texts, " "))
  end
end

-- Returns the machine, and the getevents of the chart.
local function load_machine(rtt, file)
  local model = rfsm.load(file)
  for name, level in pairs { err = "Error", warn = "Warning", info = "Info" } do
    if model[name] == nil then model[name] = printer(rtt, level) end -- any order
  end
  local fsm, problems = rfsm.init(model)
  if not fsm then error("no machine, problems of the chart: " .. #problems, 0) end
  return fsm, model.getevents
end

local function run(file, text)
  local chunk, problem
  if file then chunk, problem = loadfile(file) end
  if text then chunk, problem = loadstring(text) end
  if problem then error(problem, 0) end
  if chunk then chunk() end
end

local function has_port(component, name)
  return (pcall(function() return component:getPort(name) end))
end

-- Adds a port. RTT would replace and disconnect one whose name is used again.
local function add_port(launch, direction, name, text)
  local component = launch.component
  if has_port(component, name) then
    error(("'%s' has a port '%s' already"):format(component:getName(), name), 0)
  end
  local port = launch.rtt[direction].new("string", name, text)
  local is_trigger = direction == "InputPort" and launch.is_component
  component[is_trigger and "addEventPort" or "addPort"](component, port)
  launch.ports[#launch.ports + 1] = port
  return port
end

-- Ports of Lua are no garbage. One deleted before it is removed ends the process.
local function remove_ports(launch)
  for _, port in ipairs(launch.ports) do
    launch.component:removePort(port:info().name)
    port:delete()
  end
end

local function add_out_ports(launch, fqn_name, events_name)
  local port = add_port(launch, "OutputPort", fqn_name or "fqn", "FQN of active leaf")
  rawset(_G, "fqn", port)
  rawset(_G, "setfqn", rfsm_rtt.gen_write_fqn(port))
  if not events_name then return end
  if events_name == true then events_name = "events_out" end
  port = add_port(launch, "OutputPort", events_name, "events of the machine")
  rawset(_G, "ev_outport", port)
  rawset(_G, "emit_event", rfsm_rtt.gen_raise_event(port))
end

-- By default, a chart with a getevents gets no port for events, nor does a component
-- that has one of that name. The global `extra_in_ports` lists ports of a prefile.
local function add_events_port(launch, name, fsm, getevents)
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

-- Returns a function that advances the machine. It returns true whatever happens: RTT
-- removes a hook that does not.
local function new_trigger(launch, fsm)
  local args, log = launch.args, printer(launch.rtt, "Error")
  local runs = args.run or launch.is_component and not args.sync
  local advance = runs and rfsm.run or rfsm.step
  return function()
    local is_off = args.running_only and launch.component:getState() ~= "Running"
    local ok, why = pcall(is_off and type or advance, fsm)
    if not ok then log("rfsm.rtt:", why) end
    return true
  end
end

-- RTT looks the function up by its name at each update. It ends the process if the
-- function is not there, or if the hook was collected. So the name is one that no chart
-- uses, and the function holds the hook.
local HOOK = "rfsm.rtt: function of the EEHook"

local function enable_hook(launch, trigger)
  rawset(_G, HOOK, trigger)
  launch.hook = launch.rtt.EEHook.new(HOOK)
  rawset(_G, "eehook", launch.hook)
  launch.hook:enable()
end

local function set_up(launch)
  local args = launch.args
  run(args.prefile)
  run(nil, args.prestr)
  add_out_ports(launch, args.fqn_port, args.ev_outport)
  local fsm, getevents = load_machine(launch.rtt, args.fsmfile)
  rfsm.post_step_hook_add(fsm, rawget(_G, "setfqn"))
  add_events_port(launch, args.ev_inport, fsm, getevents)
  local trigger = new_trigger(launch, fsm)
  rawset(_G, "fsm", fsm)
  rawset(_G, "trigger", trigger)
  if launch.is_component then rawset(_G, "updateHook", function() trigger() end) end
  run(args.postfile)
  run(nil, args.poststr)
  if args.eehook then enable_hook(launch, trigger) end
end

-- Is called in the other Lua. Charts rely on rttlib, which makes constructors callable
-- and operations methods, and on utils: both are loaded if they can be had.
function rtt_launch.launch(is_component, args)
  local rtt = package.loaded.rtt
  if not rtt then error("no module 'rtt' in this Lua", 0) end
  if rfsm.is_initialized_root(rawget(_G, "fsm")) then
    error("a machine was launched here before, it is the global 'fsm'", 0)
  end
  pcall(require, "rttlib")
  local has_utils, utils = pcall(require, "utils")
  if has_utils and not rawget(_G, "utils") then rawset(_G, "utils", utils) end
  local launch = {
    args = args, rtt = rtt, component = rtt.getTC(), ports = {},
    is_component = is_component,
  }
  local ok, why = pcall(set_up, launch)
  package.loaded["rfsm.rtt_launch"] = nil -- not needed here any more
  collectgarbage()
  if ok then return end
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

-- Returns a value as Lua writes it; nil unless it is a string, a number, a boolean, or
-- a list of these.
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

-- The pool of a TLSF component fails when it is full, before the collector is due.
local PROGRAM = [[
if rawget(_G, "tlsf") then pcall(collectgarbage, "setpause", 110) end
%s
if not pcall(require, "rfsm") then package.path = package.path .. %q end
require("rfsm.rtt_launch").launch(%s, { %s })
]]

-- Returns the text that launches a machine; raises if `env` cannot be written.
local function program(args, is_component)
  local env, globals, fields = args.env or {}, {}, {}
  for i, name in ipairs(rfsm.sorted_keys(env)) do
    local text = type(name) == "string" and to_text(env[name])
    if not text then
      error(("env: %s: a name and a string, number, boolean or list of these expected")
        :format(tostring(name)), 0)
    end
    globals[i] = ("rawset(_G, %q, %s)"):format(name, text)
  end
  for _, name in ipairs(rfsm.sorted_keys(args)) do
    local text = simple_text(args[name]) -- nil for the deployer and the like
    if text then fields[#fields + 1] = name .. " = " .. text end
  end
  return PROGRAM:format(concat(globals, "\n"), ";" .. package.path,
    tostring(is_component), concat(fields, ", "))
end

-- In the Lua of the caller: arguments ----------------------------------------------

local FIELDS = { -- with types, or words for values that are not checked
  deployer = "deployer", exec_str = "operation exec_str", env = "table",
  eehook = "boolean", ev_inport = "name", ev_outport = "name", fqn_port = "string",
  fsmfile = "file name", luatype = "string", name = "string", postfile = "file name",
  poststr = "string", prefile = "file name", prestr = "string", run = "boolean",
  running_only = "boolean", sync = "boolean",
}
local CHECKED = { boolean = true, string = true, table = true, ["file name"] = true }

local function problem_of(kind, value)
  local actual = type(value)
  if kind == "file name" and actual == "string" then
    return (select(2, loadfile(value)))
  elseif actual == kind or value ~= nil and not CHECKED[kind] then
    return nil
  end
  return kind .. " expected, got " .. actual
end

-- Raises the first problem of the arguments of a launch. Two of them must be given.
local function check(args, first, second)
  if type(args) ~= "table" then error("table expected, got " .. type(args), 0) end
  for _, name in ipairs(rfsm.sorted_keys(args)) do
    if not FIELDS[name] then error("unknown field '" .. tostring(name) .. "'", 0) end
  end
  for _, name in ipairs(rfsm.sorted_keys(FIELDS)) do
    local problem = (args[name] ~= nil or name == first or name == second)
      and problem_of(FIELDS[name], args[name])
    if problem then error(name .. ": " .. problem, 0) end
  end
end

-- Launch ----------------------------------------------------------------------------

-- Returns whether `f(...)` went well, and why not: it raised, or returned false.
local function succeeds(f, ...)
  local ok, result = pcall(f, ...)
  if not ok then return false, rfsm.text_of(result) end
  return result ~= false, "RTT's log has the reason"
end

--- Launch a machine in a Lua service of a component.
--
-- The component gets the port `fqn`, and `events_in` unless the chart has a getevents.
-- The service's Lua gets the globals `fsm`, `trigger`, `setfqn`, `eehook`. With
-- `eehook` the machine takes a step at each update, otherwise at each `trigger()`.
--
-- Fields of `options`: `run` (run the machine, do not only step), `running_only` (not
-- while the component is stopped or not configured), and the fields of rfsm.rtt.Launch
-- for ports and programs.
--
-- @usage
--    local exec_str = component:provides("Lua"):getOperation("exec_str")
--    rfsm_rtt.service_launch_rfsm("gripper.lua", exec_str, true)
--
-- @raise when an argument is wrong or the launch fails; then no port is left
---@param file string the chart
---@param exec_str fun(code: string): boolean the service's operation
---@param eehook? boolean
---@param env? table<string, any> globals: strings, numbers, booleans, lists of these
---@param options? table
---@return boolean launched true
function rtt_launch.service_launch_rfsm(file, exec_str, eehook, env, options)
  local args = { fsmfile = file, exec_str = exec_str, eehook = eehook, env = env }
  for name, value in pairs(options or {}) do args[name] = value end -- any order: a set
  local ok, why = succeeds(function()
    check(args, "fsmfile", "exec_str")
    return exec_str(program(args, false))
  end)
  if not ok then error("rfsm.rtt.service_launch_rfsm: " .. why, 2) end
  return true
end

-- Loads the component, and launches the machine in it.
local function launch_component(args)
  check(args, "name", "fsmfile")
  local text = program(args, true)
  local name, deployer = args.name, args.deployer or "Deployer"
  if type(deployer) == "string" then
    deployer = package.loaded.rtt.getTC():getPeer(deployer)
  end
  local ok, why = succeeds(deployer:getOperation("loadComponent"), name,
    args.luatype or "OCL::LuaComponent")
  if not ok then error(why, 0) end
  local component = deployer:getPeer(name)
  ok, why = succeeds(function()
    component:addPeer(deployer)
    return component:getOperation("exec_str")(text)
  end)
  if ok then return component end
  succeeds(deployer:getOperation("unloadComponent"), name)
  error(why, 0)
end

--- The arguments of component_launch_rfsm.
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
---@field env? table<string, any> globals: strings, numbers, booleans, lists of these

--- Launch a machine in a component of its own.
--
-- The component is loaded and has the machine, with the port `fqn`, and `events_in`
-- unless the chart has a getevents. Set its activity, connect its ports, configure and
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
  local ok, result = pcall(launch_component, args)
  if ok then return result end
  error("rfsm.rtt.component_launch_rfsm: " .. rfsm.text_of(result), 2)
end

return rtt_launch
