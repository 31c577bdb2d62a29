--- Machines launched in the components and services of Orocos RTT-Lua.
--
-- `service_launch_rfsm` puts a chart into the Lua service of a component,
-- `component_launch_rfsm` into a new Lua component. Both are fields of `rfsm.rtt`. They
-- execute a program in the Lua of that service or component. The program loads
-- `rfsm.rtt.component` there.
--
-- @submodule rfsm.rtt
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local component = require "rfsm.rtt.component"
local files = require "rfsm.shared.files"
local rfsm_rtt = require "rfsm.rtt"
local settings = require "rfsm.rtt.settings"

local debug, error, ipairs, os = debug, error, ipairs, os
local package, pairs, pcall, tostring = package, pairs, pcall, tostring
local type = type
local concat, dump = table.concat, string.dump

local rtt_launch = {}

-- The text that the other Lua executes ---------------------------------------------

-- Returns the upvalue of a function, but for the table of globals, which a function has
-- as an upvalue since Lua 5.2.
local function upvalue_of(f)
  local name = debug.getupvalue(f, 1)
  if name == "_ENV" then name = debug.getupvalue(f, 2) end
  return name
end

-- Returns a function as Lua source. The other Lua has none of its upvalues.
local function code_of(f, where)
  local ok, code = pcall(dump, f)
  if not ok then
    error(where .. "function in Lua expected, "
      .. (type(f) == "function" and "got one in C" or rfsm.got(f)), 0)
  end
  local name = upvalue_of(f)
  if not name then return ("assert((loadstring or load)(%q))"):format(code) end
  error(("%sfunction that uses no local of its surroundings expected, it uses '%s'")
    :format(where, name), 0)
end

--- Return a value as Lua source, for the Lua of another component. `path` is its place,
--- "" for the value itself.
-- @raise for userdata, NaN, and functions but those in `ports`
---@param value any
---@param path string
---@return string source
function rtt_launch.to_text(value, path)
  local kind, number = type(value), path:match("^%.inputs%.(%d+)%.event$")
  if kind == "string" then return ("%q"):format(value) end
  if number then return code_of(value, "ports[" .. number .. "]: event: ") end
  if kind == "boolean" then return tostring(value) end
  if kind == "number" and value - value == 0 then
    return rfsm.number_text(value, "%.17g")
  end
  if kind ~= "table" or #path > 100 then
    error(("%s: string, finite number, boolean or table of these expected, %s"):format(
      path:sub(2), rfsm.got(value)), 0)
  end
  local texts = {}
  for i, key in ipairs(rfsm.sorted_keys(value)) do
    local inner = path .. "." .. rfsm.text_of(key)
    texts[i] = ("[%s] = %s"):format(rtt_launch.to_text(key, inner),
      rtt_launch.to_text(value[key], inner))
  end
  return "{ " .. concat(texts, ", ") .. " }"
end

-- This library's modules are found first, since another rfsm may be installed. The
-- reason of a failure is written to a file, since `exec_str` only returns false. The
-- hook is enabled last: OCL takes no lock, so the hook may run from then on.
local PROGRAM = [[
local launch = %s
local ok, hook = pcall(function()
  package.path = %q .. package.path .. %q
  for name, value in pairs(launch.env) do rawset(_G, name, value) end
  if launch.stripped ~= nil then rawset(_G, "RFSM_STRIPPED", launch.stripped) end
  require "rfsm.rtt"
  return require("rfsm.rtt.component").start(launch)
end)
local why = hook
if ok then ok, why = pcall(launch.finish, launch) end
if not ok then
  pcall(collectgarbage)
  local file = io.open(%q, "w")
  if file then
    file:write(tostring(why))
    file:close()
  end
  error(why, 0)
end
if hook then hook:enable() end
]]

-- Launch ----------------------------------------------------------------------------

local NO_REASON = "RTT's log has the reason"

-- Executes PROGRAM through the operation `exec_str`. If it fails, raises the reason.
local function execute(exec_str, launch)
  local fields, file = rtt_launch.to_text(launch, ""), os.tmpname()
  local own_template = rfsm_rtt.folder and rfsm_rtt.folder .. "?.lua;" or ""
  local program = PROGRAM:format(fields, own_template, ";" .. package.path, file)
  local is_called, is_done = pcall(exec_str, program)
  local reason = files.read(file)
  os.remove(file)
  if not is_called then error(is_done, 0) end
  if is_done ~= false then return end
  error(reason and reason ~= "" and rfsm_rtt.reason(reason) or NO_REASON, 0)
end

--- Launch a machine in a Lua service of a component.
--
-- The component gets the port `fqn`, and `events_in` unless the chart has a getevents.
-- The service's Lua gets the globals `fsm`, `trigger`, `setfqn`, `eehook`. With
-- `eehook` the machine takes a step at each update, otherwise at each `trigger()`.
--
-- `more` can have the fields of rfsm.rtt.Launch from `fsmfile` on.
--
-- @usage
--    local exec_str = component:provides("Lua"):getOperation("exec_str")
--    rfsm_rtt.service_launch_rfsm("gripper.lua", exec_str, true)
--
-- @raise when an argument is wrong or the launch fails; then no port remains
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
    local launch = settings.read("service", args)
    launch.exec_str = nil
    execute(exec_str, launch)
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
    sleep(0, millisecond) -- the thread sets the value before it leaves this Lua
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

-- Returns the peer of a component that has the given name; nil if there is none.
function rtt_launch.peer_of(owner, name)
  local ok, found = pcall(function() return owner:getPeer(name) end)
  return ok and found or nil
end

-- Returns the deployer: the given component, or the peer that has the given name.
function rtt_launch.find_deployer(wanted)
  wanted = wanted or "Deployer"
  local found = type(wanted) == "string"
    and rtt_launch.peer_of(package.loaded.rtt.getTC(), wanted) or wanted
  local is_deployer = pcall(function() found:getOperation("loadComponent") end)
  return is_deployer and found or error("deployer: a deployer or the name of a peer "
    .. "expected, " .. rfsm.got(wanted), 0)
end

-- Does what `component_launch_rfsm` does. An error has no name of a function in front.
function rtt_launch.launch_component(args)
  local launch = settings.read("component", args)
  local name, kind = launch.name, launch.luatype or "OCL::LuaComponent"
  local deployer = rtt_launch.find_deployer(launch.deployer)
  launch.deployer = deployer:getName()
  rtt_launch.to_text(launch, "") -- raises an error before anything is loaded
  if not deployer:getOperation("loadComponent")(name, kind) then
    error(("the deployer loads no '%s' of type '%s', %s"):format(name, kind, NO_REASON),
      0)
  end
  local target = deployer:getPeer(name)
  local ok, why = pcall(function()
    if not target:hasOperation("exec_str") then
      error("luatype: type of a Lua component expected, got '" .. kind .. "'", 0)
    end
    target:addPeer(deployer)
    execute(target:getOperation("exec_str"), launch)
  end)
  if ok then return target end
  deployer:getOperation("unloadComponent")(name)
  error(why, 0)
end

--- Launch a machine in a new component.
--
-- The component has the machine, the port `fqn`, and `events_in` unless the chart has a
-- getevents. Set its activity, connect its ports, configure and start it. An event
-- triggers an update, and an update runs the machine.
--
-- @usage
--    local gripper = rfsm_rtt.component_launch_rfsm {
--      name = "gripper", fsmfile = "gripper.lua", deployer = deployer,
--    }
--    gripper:configure()
--    gripper:start()
--
-- @raise when an argument is wrong or the launch fails; then no component remains
---@param args rfsm.rtt.Launch
---@return any component the new component, which is not configured
function rtt_launch.component_launch_rfsm(args)
  local ok, result = pcall(rtt_launch.launch_component, args)
  if ok then return result end
  error("rfsm.rtt.component_launch_rfsm: " .. rfsm.text_of(result), 2)
end

return rtt_launch
