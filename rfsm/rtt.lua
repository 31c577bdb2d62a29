--- Machines and the ports of Orocos RTT-Lua.
--
-- `gen_read_events` and `gen_read_str_events` make a `getevents` that reads input
-- ports, `gen_raise_event` makes a function that sends events to an output port, and
-- `gen_write_fqn` makes a hook that writes the FQN of the active leaf. These, and the
-- launchers, are loaded when they are used, and garbage after a launch.
--
-- The module loads without RTT, and needs no rttlib. In a Lua whose memory is a TLSF
-- pool, loading this module makes the garbage collector work harder, machines do not
-- use rfsm.fast, and the modules are those without debug information, where `make
-- install` has put them beside the others. With a global RFSM_STRIPPED that is true or
-- false, these are taken always or never.
--
-- @module rfsm.rtt
-- @license BSD-3-Clause

local collectgarbage, debug, error = collectgarbage, debug, error
local ipairs, loadfile, package, pcall = ipairs, loadfile, package, pcall
local rawget, rawset, require, select = rawget, rawset, require, select
local setmetatable = setmetatable

-- The folder of the library. The module without debug information does not know it.
local folder = select(3, ...)

if not folder then
  local is_wanted, stripped = rawget(_G, "RFSM_STRIPPED"), nil
  if is_wanted == nil then is_wanted = rawget(_G, "tlsf") ~= nil end
  folder = debug.getinfo(1, "S").source:match("^@(.*)rfsm[/\\]rtt%.lua$")
  if is_wanted and folder then
    stripped = loadfile(folder .. "rfsm/stripped/rfsm/rtt.lua")
  end
  if stripped then
    package.path = folder .. "rfsm/stripped/?.lua;" .. package.path
    return stripped((...), nil, folder)
  end
end

-- RTT's Lua 5.1 does not start a collection when memory is short, and a component fails
-- when its TLSF pool is full. So with a pool the collector never pauses, and completes
-- a cycle before 5 % of the heap are garbage.
if rawget(_G, "tlsf") then
  pcall(collectgarbage, "setpause", 100)
  pcall(collectgarbage, "setstepmul", 3000)
end

local rfsm = require "rfsm"

-- What the core keeps in place of rfsm/advice.lua in a pool, where that would take more
-- than a chart of five states: it is loaded for problems, and dropped with the launch.
-- Fields of a state that may be mistakes are left to `rfsm check`.
local hints = setmetatable({ datum = function() return "" end }, {
  __index = function(self, topic)
    local loaded = package.loaded
    if loaded["rfsm.advice"] == self then loaded["rfsm.advice"] = nil end
    return require("rfsm.advice")[topic]
  end,
})

-- rfsm/fast.lua would generate code that takes 2 KiB of the pool for each state.
if rawget(_G, "tlsf") then
  rfsm.save_memory()
  package.loaded["rfsm.advice"] = hints
end

---@class rfsm.rtt
---@field folder string? the folder of the library, with a slash at its end
---@field launched rfsm.rtt.Launched? the latest launch in this Lua
---@field declared rfsm.rtt.Declared? what the latest call of `ports` has made
---@field gen_read_events fun(...: any): fun(): any[]
---@field gen_read_str_events fun(...: any): fun(): string[]
---@field gen_raise_event fun(port: any, fsm?: rfsm.Machine): fun(...: any)
---@field gen_write_fqn fun(port: any): fun(fsm: rfsm.Machine)
---@field placeholders table? what stands for OCL's rttlib until it is used
---@field service_launch_rfsm fun(file: string, exec_str: function, ...): boolean
---@field component_launch_rfsm fun(args: rfsm.rtt.Launch): any
---@field launch_system fun(file: string, options?: table): rfsm.rtt.LaunchedSystem
---@field service_halt_rfsm fun(component: any, seconds?: number): boolean
---@field service_resume_rfsm fun(exec_str: function)
local rfsm_rtt = { folder = folder }

-- Launchers: loaded when they are used ---------------------------------------------

--- Return the reason why a launch has failed; if memory was short, also a remedy.
---@param problem any
---@return string reason
function rfsm_rtt.reason(problem)
  pcall(collectgarbage)
  local text = rfsm.text_of(problem)
  if not text:find("not enough memory", 1, true) then return text end
  if not text:find(" KiB ", 1, true) then -- it was short before the launch began
    text = ("%s while the library is loaded, %.0f KiB in use without that"):format(text,
      collectgarbage("count"))
  end
  return text .. ": enlarge the pool by `pool = KIB` of the launch; 'rfsm size' prints "
    .. "how much a chart needs"
end

local NOT_NEEDED = {
  "rfsm.rtt.component", "rfsm.rtt.wiring", "rfsm.rtt.hooks", "rfsm.rtt.update",
  "rfsm.rtt.settings", "rfsm.rtt.inputs", "rfsm.rtt.rttlib", "rfsm.rtt.events",
  "rfsm.rtt.port", "rfsm.shared.options", "rfsm.shared.limit", "rfsm.shared.calls",
  "rfsm.advice",
}

-- Functions of rfsm.prepare that the core loads again if somebody reads them.
local USED_ONCE = { "prepare", "save_memory", "set_emit" }

--- Forget the modules that a launch has loaded, so that they become garbage. A launch
-- also calls this first: Lua 5.1 never loads a module again if loading it once failed.
-- This takes no memory, which may be why the launch has failed.
function rfsm_rtt.forget_modules()
  local loaded = package.loaded
  for _, name in ipairs(NOT_NEEDED) do
    if loaded[name] ~= nil then loaded[name] = nil end -- nil for a new key takes memory
  end
  if not rawget(_G, "tlsf") then return end
  loaded["rfsm.advice"] = hints
  for _, name in ipairs(USED_ONCE) do
    if rawget(rfsm, name) then rfsm[name] = nil end
  end
  if loaded["rfsm.prepare"] then loaded["rfsm.prepare"] = nil end
end

--- Make the input ports of a machine that this component will launch.
--
-- Say this where the file of the component begins. Then the ports are there before the
-- component is configured, and can be connected. `launch` takes them without a word.
--
-- @usage
--    rfsm_rtt.ports {
--      { "stop_in" },
--      { "arm_in", prefix = "arm" },
--      { "force_in", type = "Force", event = is_contact, edge = true },
--    }
--
-- @raise when an entry is wrong, or a port cannot be made: then none is left. Also when
-- one of an earlier call is missing.
---@param list rfsm.rtt.Input[]
function rfsm_rtt.ports(list)
  local ok, why = pcall(function() require("rfsm.rtt.inputs").declare(list) end)
  rfsm_rtt.forget_modules()
  if not ok then error("rfsm.rtt.ports: " .. rfsm.text_of(why), 2) end
end

--- Launch a machine in the component of this Lua, in its configureHook.
--
-- The component gets ports, attributes, and hooks that run the machine. A later call
-- loads the chart again and launches a new machine. Existing ports stay connected.
--
-- @usage
--    function configureHook()
--      return rfsm_rtt.launch { fsmfile = "gripper.lua" }
--    end
--
-- @raise when an argument is wrong or the launch fails; then no port is left
---@param args rfsm.rtt.Launch
---@return boolean launched true
function rfsm_rtt.launch(args)
  if rfsm_rtt.launched then rfsm_rtt.launched:forget() end
  rfsm_rtt.forget_modules()
  local ok, why = pcall(function() require("rfsm.rtt.component").launch(args) end)
  if ok then ok, why = pcall(rfsm_rtt.launched.finish, rfsm_rtt.launched) end
  rfsm_rtt.forget_modules()
  if not ok then error("rfsm.rtt.launch: " .. rfsm_rtt.reason(why), 2) end
  return true
end

setmetatable(rfsm_rtt, { __index = function(_, name)
  if name == "launch_system" then return require("rfsm.rtt.launch_system").launch end
  name = rfsm.text_of(name)
  local file = name:find("^gen_") and "rfsm.rtt.events"
    or name:find("_rfsm$") and "rfsm.rtt.launch"
  return file and require(file)[name] or nil
end })

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_rtt", rfsm_rtt) end

return rfsm_rtt
