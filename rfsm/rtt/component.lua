--- A machine in a component of Orocos RTT: its ports, its hooks, its launch.
-- A launch loads this module in the Lua of the component, or of its service.
--
-- @module rfsm.rtt.component
-- @license BSD-3-Clause

local rfsm_rtt = require "rfsm.rtt" -- first: it adapts Lua to a TLSF pool
local rfsm = require "rfsm"

local assert, collectgarbage, coroutine = assert, collectgarbage, coroutine
local debug, error = debug, error
local ipairs, loadfile, os, package = ipairs, loadfile, os, package
local pairs, pcall, rawequal, rawget = pairs, pcall, rawequal, rawget
local rawset, require = rawset, require
local concat = table.concat
local loadstring = rawget(_G, "loadstring") or rawget(_G, "load")

-- Other modules of a launch are required where they are used, so that they can be
-- collected while a pool needs the room for the chart and its machine. But a failure
-- is reported by what is there.
local remove_port = require("rfsm.rtt.port").remove
local collect = require("rfsm.rtt.update").collect
local fail = require("rfsm.rtt.update").fail

local component = { RESUME = "rfsm.rtt: resume" } -- the name of a global

--- A launch: its settings, and all that was made for its machine.
---@class rfsm.rtt.Launched : rfsm.rtt.Launch
---@field is_component boolean is it in a component, and not in a service?
---@field is_own boolean does the component launch its machine in its configureHook?
---@field theirs table<string, function> the program's hooks, by name
---@field log fun(level: string, ...) writes to RTT's log
---@field make_ready fun() makes what is missing; loads a module
---@field notice_exception fun(self: rfsm.rtt.Launched): boolean
---@field report fun(self: rfsm.rtt.Launched, problem: any)
---@field rtt table the module of RTT
---@field component any the TaskContext
---@field ports table<string, rfsm.rtt.Port> ports, by the setting that asks for them
---@field held rfsm.rtt.Port[] these and those in `ports`, in the order of their making
---@field inputs? rfsm.rtt.Input[] what is to be known of the ports in `ports`
---@field sources? rfsm.rtt.Port[] those ports, then all that are read
---@field is_declared? boolean are they those that `rfsm.rtt.ports` has made?
---@field log_as fun(key: any, level: string, ...) likewise; one line for each key
---@field extra rfsm.rtt.Port[] the ports in the global `extra_in_ports`
---@field variables table<string, any> the values of the attributes, by name
---@field attributes string[] names of the attributes that this launch has added
---@field counts table<string, integer> the values of those attributes that are counters
---@field emit? fun(...) writes events to the event port; also global `emit_event`
---@field is_ready boolean do all ports exist, and are the program's hooks wrapped?
---@field stepmul? integer the speed of the collector before the launch
---@field has_failed boolean did the last update fail?
---@field hear? fun() has the machine read its ports again, during its entry

local function set_globals(globals)
  for name, value in pairs(globals) do rawset(_G, name, value) end -- any order: a set
end

-- Makes modules garbage that have been used, so that a pool has more room for the rest.
-- They are loaded again if they are needed again.
local function drop(...)
  for _, name in ipairs { ... } do package.loaded[name] = nil end
end

-- Makes garbage what a stage of the launch has loaded.
local function forget_stage()
  drop("rfsm.rtt.wiring", "rfsm.rtt.update", "rfsm.rtt.events", "rfsm.rtt.inputs",
    "rfsm.rtt.hooks", "rfsm.shared.calls")
  collect()
end

-- The machine --------------------------------------------------------------------

-- Returns the machine, and the getevents of the chart.
local function load_machine(launch)
  if launch.timer then require "rfsm_timeevent" end -- the chart may not require it
  local ok, model = require("rfsm.shared.limit").load(rfsm.load, launch.fsmfile,
    { os.time })
  if not ok then error(model, 0) end
  local log = launch.log
  for name, level in pairs { err = "Error", warn = "Warning", info = "Info" } do
    if model[name] == nil then -- any order
      model[name] = function(...) log(level, ...) end
    end
  end
  launch.stage = "the machine is made"
  drop("rfsm.shared.limit", "rfsm.shared.calls")
  collect()
  local fsm, _, problems = rfsm.init(model)
  if not fsm then error("no machine:\n  " .. concat(problems, "\n  "), 0) end
  return fsm, model.getevents
end

-- Launch -------------------------------------------------------------------------

local function run(load, source, name)
  if source then assert(load(source, name))() end
end

-- The name of the global function that RTT's EEHook calls at each update. RTT ends the
-- process if there is no such function, or if the hook was collected. So the name is
-- one that charts do not use, and the function refers to the hook.
local HOOK = "rfsm.rtt: function of the EEHook"

-- Returns a hook that the component's thread runs. Since OCL takes no lock, the hook
-- must be enabled when nothing else is left to do in this Lua. It is made in a new Lua
-- thread, so that it has its own stack. A halt removes it, in the component's thread.
local function new_hook(launch, trigger)
  local halt, halted = launch.variables.rfsm_halt, launch.variables.rfsm_halted
  local thread = coroutine.create(function() return launch.rtt.EEHook.new(HOOK) end)
  local _, hook = assert(coroutine.resume(thread))
  launch.hook, launch.thread = hook, thread
  set_globals { eehook = hook, [HOOK] = function()
    if launch.hook and not halt:tolua() then
      launch:notice_exception()
      return trigger()
    end
    halted:assign(true)
    return false
  end, [component.RESUME] = function()
    if not halted:tolua() then error("the machine is not halted", 0) end
    halt:assign(false)
    halted:assign(false)
    hook:enable()
  end }
  return hook
end

-- Makes what an update calls. Returns the function `trigger` of the launch.
local function new_trigger(launch)
  local update = require "rfsm.rtt.update"
  launch.notice_exception, launch.report = update.notice_exception, update.report
  launch.counted, launch.meter = update.counted, update.new_meter(launch)
  local trigger = update.new_trigger(launch, launch.fsm)
  if launch.is_component or launch.eehook then return trigger end
  -- a callback may call it, too: a step that is under way is reported, none is taken
  return function() return launch:notice_exception() or trigger() end
end

-- Has RTT call the machine. Returns the hook that the launch needs; nil if none.
local function connect(launch, getevents, write_fqn)
  require("rfsm.rtt.hooks").connect(launch)
  forget_stage()
  require("rfsm.rtt.wiring").connect(launch, getevents, write_fqn)
  forget_stage()
  local trigger, fsm = new_trigger(launch), launch.fsm
  forget_stage()
  local hooks = require "rfsm.rtt.hooks"
  set_globals { fsm = fsm, trigger = trigger }
  if launch.is_component and not rawget(_G, "updateHook") then
    hooks.wrap(launch, "updateHook", trigger)
  end
  run(loadfile, launch.postfile)
  run(loadstring, launch.poststr, "=poststr")
  fsm.err, launch.counted = launch:counted(fsm.err), nil
  if launch.is_component then hooks.wrap_all(launch) end
  return launch.eehook and new_hook(launch, trigger) or nil
end

local function set_up(launch)
  run(loadfile, launch.prefile)
  run(loadstring, launch.prestr, "=prestr")
  local write_fqn = require("rfsm.rtt.wiring").add_outputs(launch)
  launch.stage = "the chart is loaded"
  forget_stage()
  local fsm, getevents = load_machine(launch)
  launch.fsm, launch.stage = fsm, "the machine is connected"
  collect()
  return connect(launch, getevents, write_fqn)
end

-- Returns why nothing can be launched in this Lua; nil if it can.
local function obstacle(launch)
  if not rfsm.got then return "another rfsm is loaded in this Lua" end
  local is_stripped = debug.getinfo(rfsm.init, "S").source == "=?"
  if launch.stripped and not is_stripped then
    return "stripped: no modules in rfsm/stripped beside the library, or it was loaded "
      .. "before from source"
  elseif launch.stripped == false and is_stripped then
    return "stripped: the library has been loaded without debug information "
      .. "(RFSM_STRIPPED = false before that)"
  end
  if not package.loaded.rtt then return "no module 'rtt' in this Lua" end
  if not rfsm.is_initialized_root(rawget(_G, "fsm")) then return nil end
  return "a machine was launched here before, it is the global 'fsm'"
end

-- Restores the program's hooks, except hooks that the program has redefined since, and
-- drops the machine, since a pool may not have room for two machines.
local function forget(launch)
  for name, hook in pairs(launch.hooks) do -- any order: different globals
    if rawget(_G, name) == hook then rawset(_G, name, launch.theirs[name]) end
  end
  if rawequal(rawget(_G, "fsm"), launch.fsm) then rawset(_G, "fsm", nil) end
  for _, name in ipairs { "trigger", "setfqn" } do rawset(_G, name, nil) end
  launch.fsm, launch.hooks, launch.theirs = nil, {}, {}
  collect()
end

-- Removes what a launch has made: Lua does not collect ports and attributes.
local function undo(launch)
  for _, held in ipairs(launch.held) do remove_port(held) end
  for _, name in ipairs(launch.attributes) do
    launch.component:removeAttribute(name)
  end
  if launch.unload_timer then pcall(launch.unload_timer) end
  launch:forget()
  if rfsm_rtt.launched then rfsm_rtt.launched:forget() end -- perhaps one inside of it
end

-- Logs that rttlib is loaded after the launch.
local function warn_of_use()
  local launched = rfsm_rtt.launched
  if not launched or launched.finish then return end
  pcall(launched.log, "Warning", "rfsm.rtt: rttlib is loaded now, after the "
    .. "launch; with rttlib = true the launch loads it")
end

-- Charts rely on utils, and on rttlib, which makes constructors callable and operations
-- methods. Both are loaded if they are installed, in a pool when they are first used.
local function load_libraries(launch)
  if launch.rttlib == false then return end
  if launch.rttlib == nil and rawget(_G, "tlsf") then
    if rawget(_G, "rttlib") then return end
    return require("rfsm.rtt.rttlib").put(launch.rtt, warn_of_use)
  end
  pcall(require, "rttlib")
  local has_utils, utils = pcall(require, "utils")
  if has_utils and not rawget(_G, "utils") then set_globals { utils = utils } end
end

-- Adds the fields that a launch needs besides its settings.
local function begin(launch)
  local rtt, update = package.loaded.rtt, require "rfsm.rtt.update"
  launch.rtt, launch.component = rtt, rtt.getTC()
  launch.hooks, launch.theirs = {}, {}
  launch.ports_at, launch.ports, launch.extra = launch.ports, {}, {}
  launch.held = {}
  launch.variables, launch.attributes = {}, {}
  launch.counts = { rfsm_errors = 0, rfsm_failures = 0, rfsm_overruns = 0 }
  launch.is_ready = launch.is_own or not launch.is_component
  launch.log, launch.flush, launch.log_as = update.new_log(rtt)
  launch.forget, launch.undo, launch.finish = forget, undo, update.finish
  if launch.pool then update.enlarge_pool(launch, launch.pool) end
end

--- Launch a machine in this Lua; return its hook, which the caller must enable last, or
-- nil if it needs no hook. An error has the name of the chart. Call `launch:finish()`
-- afterwards, when most of this module is garbage. A pool has less garbage meanwhile.
---@param launch rfsm.rtt.Launched
function component.start(launch)
  launch.where = "launch of '" .. launch.fsmfile .. "': "
  local problem = obstacle(launch)
  if problem then error(launch.where .. problem, 0) end
  launch.stage = "the launch begins"
  if rawget(_G, "tlsf") then -- Lua 5.5 has no such option
    local ok, usual = pcall(collectgarbage, "setstepmul", 10000)
    launch.stepmul = ok and usual
  end
  local ok, result = pcall(function()
    begin(launch)
    load_libraries(launch)
    rfsm_rtt.launched = launch -- now: an exception of C++ may end the launch
    local hook = set_up(launch)
    if rfsm_rtt.launched == launch then return hook end
    error("another launch began inside of it", 0)
  end)
  rfsm_rtt.forget_modules()
  if not ok then fail(launch, result) end
  return result
end

--- Launch a machine in the component of this Lua, as `rfsm.rtt.launch` does.
---@param args rfsm.rtt.Launch
function component.launch(args)
  local launch = require("rfsm.rtt.settings").read("own", args)
  local declared = rfsm_rtt.declared
  launch.is_declared = declared and declared.list == args.ports
  drop("rfsm.rtt.settings", "rfsm.shared.options")
  set_globals(launch.env)
  component.start(launch)
end

return component
