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
local calls = require "rfsm.shared.calls"

local assert, collectgarbage, error, ipairs = assert, collectgarbage, error, ipairs
local loadfile, package, pairs, pcall = loadfile, package, pairs, pcall
local rawget, rawset, require = rawget, rawset, require
local tostring, type = tostring, type
local concat = table.concat
local loadstring = rawget(_G, "loadstring") or rawget(_G, "load")
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local rtt_launch = {}

-- In the other Lua: the ports, the machine, its updates --------------------------

-- Returns a printer to RTT's log. It logs texts only, since OCL mutes the log of the
-- whole process at an error that is no text.
local function printer(rtt, level)
  return function(...) rtt.logl(level, calls.text(" ", ...)) end
end

-- Returns the machine, and the getevents of the chart.
local function load_machine(rtt, file)
  local model = rfsm.load(file)
  for name, level in pairs { err = "Error", warn = "Warning", info = "Info" } do
    if model[name] == nil then model[name] = printer(rtt, level) end -- any order
  end
  local fsm, _, problems = rfsm.init(model)
  if not fsm then error("no machine, problems of the chart: " .. #problems, 0) end
  return fsm, model.getevents
end

-- Runs a file or a text, if there is one.
local function run(load, source)
  if source then assert(load(source))() end
end

local function set_globals(globals)
  for name, value in pairs(globals) do rawset(_G, name, value) end -- any order: a set
end

local PORTS = { -- by field of a launch: direction, name if it is true, description
  fqn_port = { "OutputPort", "fqn", "FQN of the active leaf" },
  ev_outport = { "OutputPort", "events_out", "events of the machine" },
  ev_inport = { "InputPort", "events_in", "events for the machine" },
}

local function has_port(component, name)
  return (pcall(function() return component:getPort(name) end))
end

-- Adds the port that a field of the launch asks for: true, or its name. RTT would
-- replace and disconnect one whose name is used again.
local function add_port(launch, field)
  local component, wanted = launch.component, launch[field]
  if not wanted then return nil end
  local direction, name, text = unpack(PORTS[field])
  if wanted ~= true then name = wanted end
  if has_port(component, name) then
    error(("'%s' has a port '%s' already"):format(component:getName(), name), 0)
  end
  local port = launch.rtt[direction].new("string", name, text)
  local is_trigger = direction == "InputPort" and launch.is_component
  component[is_trigger and "addEventPort" or "addPort"](component, port)
  launch.ports[#launch.ports + 1] = port
  return port
end

-- Returns a function that advances the machine. It returns true whatever happens: RTT
-- removes a hook that does not.
local function new_trigger(launch, fsm)
  local log = printer(launch.rtt, "Error")
  local runs = launch.run or launch.is_component and not launch.sync
  local advance = runs and rfsm.run or rfsm.step
  return function()
    local is_on = not launch.running_only or launch.component:getState() == "Running"
    local ok, why = pcall(is_on and advance or type, fsm)
    if not ok then log("rfsm.rtt:", why) end
    return true
  end
end

-- RTT looks the function up by its name at each update. It ends the process if the
-- function is not there, or if the hook was collected. So the name is one that no chart
-- uses, and the function holds the hook.
local HOOK = "rfsm.rtt: function of the EEHook"

local function enable_hook(launch, trigger)
  launch.hook = launch.rtt.EEHook.new(HOOK)
  set_globals { [HOOK] = trigger, eehook = launch.hook }
  launch.hook:enable()
end

-- By default, a chart with a getevents gets no port for events, nor does a component
-- that has one of that name. The global `extra_in_ports` lists ports of a prefile.
local function set_up(launch)
  run(loadfile, launch.prefile)
  run(loadstring, launch.prestr)
  local fqn, out = add_port(launch, "fqn_port"), add_port(launch, "ev_outport")
  local write_fqn = rfsm_rtt.gen_write_fqn(fqn)
  set_globals {
    fqn = fqn, setfqn = write_fqn, ev_outport = out,
    emit_event = out and rfsm_rtt.gen_raise_event(out),
  }
  local fsm, getevents = load_machine(launch.rtt, launch.fsmfile)
  rfsm.post_step_hook_add(fsm, write_fqn)
  if launch.ev_inport == nil then
    launch.ev_inport = not getevents and not has_port(launch.component, "events_in")
  end
  local input, extra = add_port(launch, "ev_inport"), rawget(_G, "extra_in_ports") or {}
  if input then fsm.getevents = rfsm_rtt.gen_read_events(input, unpack(extra)) end
  local trigger = new_trigger(launch, fsm)
  set_globals {
    fsm = fsm, trigger = trigger, ev_inport = input,
    updateHook = launch.is_component and function() trigger() end or nil,
  }
  run(loadfile, launch.postfile)
  run(loadstring, launch.poststr)
  if launch.eehook then enable_hook(launch, trigger) end
end

-- Is called in the other Lua. Charts rely on rttlib, which makes constructors callable
-- and operations methods, and on utils: both are loaded if they can be had.
function rtt_launch.launch(launch)
  local rtt = package.loaded.rtt
  if not rtt then error("no module 'rtt' in this Lua", 0) end
  if rfsm.is_initialized_root(rawget(_G, "fsm")) then
    error("a machine was launched here before, it is the global 'fsm'", 0)
  end
  pcall(require, "rttlib")
  local has_utils, utils = pcall(require, "utils")
  if has_utils and not rawget(_G, "utils") then set_globals { utils = utils } end
  launch.rtt, launch.component, launch.ports = rtt, rtt.getTC(), {}
  local ok, why = pcall(set_up, launch)
  package.loaded["rfsm.rtt.launch"] = nil -- not needed here any more
  collectgarbage()
  if ok then return end
  for _, port in ipairs(launch.ports) do -- which are no garbage for Lua
    launch.component:removePort(port:info().name) -- else `delete` ends the process
    port:delete()
  end
  error(rfsm.text_of(why), 0)
end

-- In the Lua of the caller: arguments, and the text that the other Lua executes -----

local function is(kind) return function(value) return type(value) == kind end end
local function is_anything() return true end
local function is_env(value) return type(value) == "table" and value[1] == nil end
local function is_file(value)
  if type(value) == "string" then return loadfile(value) end
end

local BOOLEAN, STRING = { "boolean", is "boolean" }, { "string", is "string" }
local FILE, NAME = { "file name", is_file }, { "name", is_anything }

local FIELDS = { -- for rfsm.shared.options
  name = STRING, deployer = NAME, exec_str = { "operation exec_str", is_anything },
  luatype = STRING, env = { "table of globals by name", is_env, {} },
  fsmfile = FILE, prefile = FILE, postfile = FILE, prestr = STRING, poststr = STRING,
  fqn_port = { "string", is "string", "fqn" }, ev_inport = NAME, ev_outport = NAME,
  eehook = BOOLEAN, run = BOOLEAN, running_only = BOOLEAN, sync = BOOLEAN,
}

-- Returns a value as Lua writes it; raises if there is something in it that Lua cannot
-- write, or if it has no end.
local function to_text(value, path)
  local kind = type(value)
  if kind == "string" then return ("%q"):format(value) end
  if kind == "boolean" then return tostring(value) end
  if kind == "number" and value - value == 0 then return ("%.17g"):format(value) end
  if kind ~= "table" or #path > 100 then
    error(("%s: string, finite number, boolean or table of these expected, %s"):format(
      path:sub(2), rfsm.got(value)), 0)
  end
  local texts = {}
  for i, key in ipairs(rfsm.sorted_keys(value)) do
    local place = path .. "." .. rfsm.text_of(key)
    texts[i] = ("[%s] = %s"):format(to_text(key, place), to_text(value[key], place))
  end
  return "{ " .. concat(texts, ", ") .. " }"
end

-- The pool of a TLSF component fails when it is full, so the collector begins early.
local PROGRAM = [[
local launch = %s
for name, value in pairs(launch.env) do rawset(_G, name, value) end
local tune = rawget(_G, "tlsf") and collectgarbage or type
pcall(tune, "setpause", 100)
pcall(tune, "setstepmul", 1000)
if not pcall(require, "rfsm") then package.path = package.path .. %q end
require("rfsm.rtt.launch").launch(launch)
]]

-- Returns the text that launches a machine. Raises if an argument is wrong, or one of
-- those named is missing.
local function program(args, ...)
  local launch, problem = require("rfsm.shared.options").read(FIELDS, args)
  if not launch then error(problem, 0) end
  for _, name in ipairs { ... } do
    if launch[name] == nil then
      error(name .. ": " .. FIELDS[name][1] .. " expected, got nil", 0)
    end
  end
  launch.is_component, launch.deployer, launch.exec_str = not launch.exec_str, nil, nil
  return PROGRAM:format(to_text(launch, ""), ";" .. package.path)
end

-- Launch ----------------------------------------------------------------------------

-- Calls an operation; raises if it returns false.
local function call(operation, ...)
  if operation(...) == false then error("RTT's log has the reason", 0) end
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
---@param env? table<string, any> globals: strings, numbers, booleans, tables of these
---@param options? table
---@return boolean launched true
function rtt_launch.service_launch_rfsm(file, exec_str, eehook, env, options)
  local ok, why = pcall(function()
    local args = { fsmfile = file, exec_str = exec_str, eehook = eehook, env = env }
    if options ~= nil and type(options) ~= "table" then
      error("options: table expected, " .. rfsm.got(options), 0)
    end
    for name, value in pairs(options or {}) do args[name] = value end -- any order
    call(exec_str, program(args, "fsmfile", "exec_str"))
  end)
  if ok then return true end
  error("rfsm.rtt.service_launch_rfsm: " .. rfsm.text_of(why), 2)
end

-- Loads the component, and launches the machine in it.
local function launch_component(args)
  local text = program(args, "name", "fsmfile")
  local name, kind = args.name, args.luatype or "OCL::LuaComponent"
  local deployer = args.deployer or "Deployer"
  if type(deployer) == "string" then
    deployer = package.loaded.rtt.getTC():getPeer(deployer)
  end
  call(deployer:getOperation("loadComponent"), name, kind)
  local component = deployer:getPeer(name)
  local ok, why = pcall(function()
    component:addPeer(deployer)
    call(component:getOperation("exec_str"), text)
  end)
  if ok then return component end
  pcall(deployer:getOperation("unloadComponent"), name)
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
---@field env? table<string, any> globals: strings, numbers, booleans, tables of these

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
