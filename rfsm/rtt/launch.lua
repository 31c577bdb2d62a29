--- Machines launched in the components and services of Orocos RTT-Lua.
--
-- `service_launch_rfsm` puts a chart into the Lua service of a component,
-- `component_launch_rfsm` into a Lua component of its own. Both are fields of
-- `rfsm.rtt`. They execute a text in the other Lua, which loads
-- `rfsm.rtt.component` there.
--
-- @submodule rfsm.rtt
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local component = require "rfsm.rtt.component"
local options = require "rfsm.shared.options"

local debug, error, ipairs, loadfile = debug, error, ipairs, loadfile
local package, pairs, pcall, tostring = package, pairs, pcall, tostring
local type = type
local concat, huge = table.concat, math.huge

local rtt_launch = {}

-- Arguments, and the text that the other Lua executes ------------------------------

local function is_anything() return true end
local function is_env(value) return type(value) == "table" and value[1] == nil end
local function is_file(value)
  if type(value) == "string" then return loadfile(value) end
end

local function is_word(word)
  return function(value) return value == word end
end

local BOOLEAN = { "boolean", options.is_a "boolean" }
local STRING = { "string", options.is_a "string" }
local FILE, NAME = { "file name", is_file }, { "name", is_anything }

-- Fields of both launches, for options.read.
local COMMON = {
  env = { "table of globals by name", is_env, {} },
  fsmfile = FILE, prefile = FILE, postfile = FILE, prestr = STRING, poststr = STRING,
  fqn_port = { "string", options.is_a "string", "fqn" },
  ev_inport = NAME, ev_outport = NAME,
  run = BOOLEAN, running_only = BOOLEAN, sync = BOOLEAN,
  steps = { "whole number, at least 1", options.is_whole(1, huge) },
}

local function with_common(fields)
  for name, field in pairs(COMMON) do fields[name] = field end -- any order: a set
  return fields
end

local SERVICE = with_common {
  exec_str = { "operation exec_str", is_anything }, eehook = BOOLEAN,
}
local COMPONENT = with_common {
  name = STRING, deployer = NAME, luatype = STRING, timer = BOOLEAN,
  enter = { "'start'", is_word "start" },
  ports = { "'configure'", is_word "configure" },
}

-- Returns a value as Lua writes it; raises if Lua cannot write it, or if it has no end.
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
    local inner = path .. "." .. rfsm.text_of(key)
    texts[i] = ("[%s] = %s"):format(to_text(key, inner), to_text(value[key], inner))
  end
  return "{ " .. concat(texts, ", ") .. " }"
end

-- Our modules come first, from where this one is: another rfsm may be installed.
-- Nothing is done in this Lua after the hook is enabled, since OCL takes no lock.
local PROGRAM = [[
local launch = %s
package.path = %q .. package.path .. %q
for name, value in pairs(launch.env) do rawset(_G, name, value) end
local ok, component = pcall(require, "rfsm.rtt.component")
if not ok then error("launch of '" .. launch.fsmfile .. "': " .. component, 0) end
local hook = component.launch(launch)
if hook then hook:enable() end
]]

-- Returns the template of our modules, with a semicolon; empty if it is not known.
local function own_template()
  local source = debug and debug.getinfo(1, "S").source
  local folder = source and source:match("^@(.*)rfsm[/\\]rtt[/\\]launch%.lua$")
  return folder and folder .. "?.lua;" or ""
end

-- Returns the settings of a launch; raises if one is wrong, or a named one is missing.
local function read(fields, args, ...)
  local launch, problem = options.read(fields, args)
  if not launch then error(problem, 0) end
  for _, name in ipairs { ... } do
    if launch[name] == nil then
      error(name .. ": " .. fields[name][1] .. " expected, got nil", 0)
    end
  end
  if launch.steps and (launch.sync or launch.run) then
    error("steps: expected without sync and run, which are numbers of steps", 0)
  end
  return launch
end

local function program(launch)
  return PROGRAM:format(to_text(launch, ""), own_template(), ";" .. package.path)
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
-- Fields of `options`: `run` (run the machine, do not only step), `steps`,
-- `running_only` (not while the component is stopped or not configured), and the fields
-- of rfsm.rtt.Launch for ports and programs.
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
---@param more? table options
---@return boolean launched true
function rtt_launch.service_launch_rfsm(file, exec_str, eehook, env, more)
  local ok, why = pcall(function()
    local args = { fsmfile = file, exec_str = exec_str, eehook = eehook, env = env }
    if more ~= nil and type(more) ~= "table" then
      error("options: table expected, " .. rfsm.got(more), 0)
    end
    for name, value in pairs(more or {}) do args[name] = value end -- any order
    local launch = read(SERVICE, args, "fsmfile", "exec_str")
    launch.exec_str, launch.is_component = nil, false
    call(exec_str, program(launch))
  end)
  if ok then return true end
  error("rfsm.rtt.service_launch_rfsm: " .. rfsm.text_of(why), 2)
end

--- Halt the machine of a service, so that `exec_str` can be used.
--
-- OCL takes no lock between `exec_str` and a hook. So the component's thread itself
-- removes the hook, at its next update, and this function waits for it.
--
-- @usage
--    if rfsm_rtt.service_halt_rfsm(component) then
--      exec_str("print(rfsm.get_actleaf_fqn(fsm))")
--      rfsm_rtt.service_resume_rfsm(exec_str)
--    end
--
-- @raise when there is no machine in a service of the component
---@param target any the component
---@param seconds? number how long to wait, default 1
---@return boolean halted false if the component did not update in that time
function rtt_launch.service_halt_rfsm(target, seconds)
  local ok, halt, halted = pcall(function()
    return target:getAttribute("rfsm_halt"), target:getAttribute("rfsm_halted")
  end)
  if not ok then
    error("rfsm.rtt.service_halt_rfsm: component with a machine in its Lua service "
      .. "expected, " .. rfsm.got(target), 2)
  end
  local sleep, millisecond = package.loaded.rtt.sleep, 1000000
  halt:set(true)
  for _ = 1, (seconds or 1) * 1000 do
    local is_halted = halted:get()
    sleep(0, millisecond) -- the thread leaves this Lua after the value is set
    if is_halted then return true end
  end
  halt:set(false)
  return halted:get()
end

--- Have the machine of a service go on after `service_halt_rfsm`.
--
-- @raise if the service has no machine that is halted
---@param exec_str fun(code: string): boolean the service's operation
function rtt_launch.service_resume_rfsm(exec_str)
  if exec_str(("rawget(_G, %q)()"):format(component.RESUME)) then return end
  error("rfsm.rtt.service_resume_rfsm: RTT's log has the reason", 2)
end

-- Loads a component that writes to its port when a time has passed.
local function load_timer(deployer, name)
  call(deployer:getOperation("loadComponent"), name, "OCL::TimerComponent")
  local timer = deployer:getPeer(name)
  timer:configure()
  timer:start()
  return timer
end

local function unload(deployer, name)
  pcall(function() deployer:getPeer(name):stop() end)
  pcall(deployer:getOperation("unloadComponent"), name)
end

local function launch_component(args)
  local launch = read(COMPONENT, args, "name", "fsmfile")
  local name, kind = launch.name, launch.luatype or "OCL::LuaComponent"
  local deployer = launch.deployer or "Deployer"
  local timer = launch.timer and name .. "_timer" or nil
  launch.deployer, launch.is_component, launch.timer = nil, true, timer
  local text = program(launch)
  if type(deployer) == "string" then
    deployer = package.loaded.rtt.getTC():getPeer(deployer)
  end
  call(deployer:getOperation("loadComponent"), name, kind)
  local target = deployer:getPeer(name)
  local ok, why = pcall(function()
    target:addPeer(deployer)
    if timer then target:addPeer(load_timer(deployer, timer)) end
    call(target:getOperation("exec_str"), text)
  end)
  if ok then return target end
  unload(deployer, name)
  if timer then unload(deployer, timer) end
  error(why, 0)
end

--- The arguments of component_launch_rfsm.
---@class rfsm.rtt.Launch
---@field name string of the new component
---@field fsmfile string the chart
---@field deployer? any the deployer, or the name of a peer ("Deployer")
---@field luatype? string type of the component ("OCL::LuaComponent")
---@field sync? boolean an update is one step; default: it runs the machine
---@field steps? integer an update is as many at most; default of a run: 1000
---@field enter? "start" enter the machine in startHook; default: in the first update
---@field ports? "configure" make ports in configureHook; default: in the launch
---@field timer? boolean wake an event-driven component for time events
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
