--- The hooks of a launched component: what its ports, attributes and machine need when
-- the component is configured, started and cleaned up.
--
-- A launch loads this module, and forgets it. So the hooks load it again: a component
-- that runs does without it. It needs no other module of a launch.
--
-- @module rfsm.rtt.hooks
-- @license BSD-3-Clause

local rfsm_rtt = require "rfsm.rtt"
local rfsm = require "rfsm"

local collectgarbage, error, ipairs = collectgarbage, error, ipairs
local package, pcall, rawget, rawset = package, pcall, rawget, rawset
local require = require

local hooks = {}

-- Ports and attributes ---------------------------------------------------------------

-- Looks the ports of the launch up again. With `is_made`, missing ports are made.
local function find_ports(launch, is_made)
  for _, held in ipairs(launch.held) do
    if held:find() then
      held:check()
    elseif is_made then
      held:make()
    end
    if held.global then rawset(_G, held.global, held.real or nil) end
  end
  for _, held in ipairs(launch.extra) do held:find() end
end

-- Returns a function that loads this module and calls hooks[name](launch). It forgets
-- the module, before it, too: Lua 5.1 never loads one again if that failed once.
local function later(launch, name)
  return function()
    rfsm_rtt.forget_modules()
    pcall(collectgarbage) -- a pool may be nearly full
    require("rfsm.rtt.hooks")[name](launch)
    rfsm_rtt.forget_modules()
  end
end

-- Name of an attribute -> its type. OF_SERVICE: attributes that only a service adds.
local ATTRIBUTES = {
  rfsm_errors = "uint", rfsm_overruns = "uint", rfsm_failures = "uint",
  rfsm_live = "double", rfsm_peak = "double", rfsm_state = "uint",
}
local OF_SERVICE = { rfsm_halt = "bool", rfsm_halted = "bool" }

-- Adds the attributes that the component does not have. Their values are Variables,
-- which stay when `rttlib.tc_cleanup` removes the attributes. An attribute that another
-- service has added is shared with it.
local function add_attributes(launch, types)
  for _, name in ipairs(rfsm.sorted_keys(types)) do
    local ok, attribute = pcall(function()
      return launch.component:getAttribute(name)
    end)
    if not ok then
      attribute = launch.rtt.Attribute.new(types[name], name)
      launch.component:addAttribute(attribute)
      launch.attributes[#launch.attributes + 1] = name
    end
    local value, before = attribute:getRaw(), launch.variables[name]
    if launch.is_own and not before then value:assign(0) end -- a new launch
    if before and not ok then value:assign(before) end
    launch.variables[name] = value
  end
end

--- Add the attributes of a launch to its component.
function hooks.connect(launch)
  launch.make_ready = later(launch, "make_ready")
  add_attributes(launch, ATTRIBUTES)
  if launch.is_component then return end
  add_attributes(launch, OF_SERVICE)
  launch.variables.rfsm_halted:assign(not launch.eehook)
end

-- Hooks of RTT -----------------------------------------------------------------------

-- Enters the machine without reading ports: the entry would discard most events.
local function enter(launch, fsm)
  if launch.enter ~= "start" or rfsm.get_sta_mode(fsm) ~= "inactive" then return end
  local getevents = rawget(fsm, "getevents")
  local function no_events() end
  fsm.getevents = no_events
  function launch.hear()
    if fsm.getevents == no_events then fsm.getevents = getevents end
    launch.hear = nil
  end
  local ok, problem = pcall(rfsm.step, fsm)
  launch.hear()
  if not ok then launch:report(problem) end
end

-- Logs a warning if time events are late, since nothing wakes the component for them.
local function warn_of_timers(launch)
  local timeevent = not launch.timer and package.loaded.rfsm_timeevent
  if not timeevent or launch.component:getOperation("getPeriod")() > 0 then return end
  for _, tr in ipairs(rfsm.elements(launch.fsm, rfsm.is_trans)) do
    for _, event in ipairs(tr.events or {}) do
      if timeevent.is_timeevent(event) then
        local text = "%s is late: a component without a period needs timer = true"
        return launch.log("Warning", text:format(event))
      end
    end
  end
end

--- Make RTT's hook `name` call the program's hook, if there is one, and then `ours`, if
-- given. With `always` it calls `ours` also when the program's hook fails or returns
-- false. It raises texts only, since OCL mutes the log of the whole process at an error
-- that is no text. RTT calls no hook inside of another one, but for the stopHook of a
-- component that stops itself.
function hooks.wrap(launch, name, ours, always)
  local theirs = rawget(_G, name)
  if theirs == launch.hooks[name] and theirs then return end
  launch.theirs[name] = theirs
  launch.hooks[name] = function()
    local ok, result = true, true
    if name ~= "stopHook" then launch:notice_exception() end
    if theirs then ok, result = pcall(theirs) end
    if ours and (always or ok and result ~= false) then ours() end
    if not ok then error(rfsm.text_of(result), 0) end
    return result
  end
  rawset(_G, name, launch.hooks[name])
end

--- Wrap the hooks, but not the configureHook in which a component launches by itself.
function hooks.wrap_all(launch)
  local wrap = hooks.wrap
  if not launch.is_own then wrap(launch, "configureHook", launch.make_ready) end
  wrap(launch, "startHook", later(launch, "start"))
  wrap(launch, "cleanupHook", later(launch, "clean_up"), true)
  for _, name in ipairs { "activateHook", "updateHook", "errorHook", "stopHook" } do
    if rawget(_G, name) then wrap(launch, name) end
  end
end

--- Make the ports and attributes that are missing, and wrap hooks that a `lua_file` has
-- defined after the launch. This happens in configureHook, in startHook, and at the
-- first update after a launch or a clean-up.
function hooks.make_ready(launch)
  find_ports(launch, true)
  add_attributes(launch, ATTRIBUTES)
  hooks.wrap_all(launch)
  launch.is_ready = true
end

function hooks.start(launch)
  hooks.make_ready(launch)
  warn_of_timers(launch)
  enter(launch, launch.fsm)
end

function hooks.clean_up(launch)
  launch.is_ready = false
  find_ports(launch, false) -- they may be gone
end

return hooks
