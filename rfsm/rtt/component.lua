--- A machine in a component of Orocos RTT: its ports, its hooks, its launch.
-- A launch loads this module in the Lua of the component, or of its service.
--
-- @module rfsm.rtt.component
-- @license BSD-3-Clause

local rfsm_rtt = require "rfsm.rtt" -- first: it adapts Lua to a TLSF pool
local rfsm = require "rfsm"
local held_port = require "rfsm.rtt.port"
local update = require "rfsm.rtt.update"

local assert, collectgarbage, coroutine = assert, collectgarbage, coroutine
local debug = debug
local error, ipairs, loadfile, package = error, ipairs, loadfile, package
local os, pairs, pcall, rawequal = os, pairs, pcall, rawequal
local rawget, rawset, require = rawget, rawset, require
local concat = table.concat
local loadstring = rawget(_G, "loadstring") or rawget(_G, "load")
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

-- Functions that are needed after the launch use these locals, so that the rest of the
-- module `update` can be collected.
local add_attributes, ATTRIBUTES = update.add_attributes, update.ATTRIBUTES
local collect, remove_port = update.collect, held_port.remove
local notice_exception, report = update.notice_exception, update.report

local component = { RESUME = "rfsm.rtt: resume" } -- the name of a global

--- A launch: its settings, and all that was made for its machine.
---@class rfsm.rtt.Launched : rfsm.rtt.Launch
---@field is_component boolean is it in a component, and not in a service?
---@field is_own boolean does the component launch its machine in its configureHook?
---@field theirs table<string, function> the program's hooks, by name
---@field log fun(level: string, ...) writes to RTT's log
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

-- Ports --------------------------------------------------------------------------

-- For each setting of a launch that asks for a port: the class of the port, its default
-- name, the name of its global variable, its description, and its type if not string.
local PORTS = {
  fqn_port = { "out", "fqn", "fqn", "FQN of the active leaf" },
  ev_outport = { "out", "events_out", "ev_outport", "events of the machine" },
  ev_inport = { "in", "events_in", "ev_inport", "events for the machine" },
  timer = { "in", "rfsm_timer", "rfsm_timer", "wakes for time events", "int" },
}

-- Adds a port to the launch. With `ports = "configure"` it is made later, when the
-- component is configured.
local function add(launch, facts, is_kept)
  local held = held_port.reserve(launch.component, facts)
  held.is_trigger = facts.porttype == "in" and launch.is_component
  launch.held[#launch.held + 1] = held
  held.timer = facts.name == "rfsm_timer" and launch.timer or nil
  if launch.ports_at ~= "configure" then held_port.provide(held, is_kept) end
  return held
end

-- Returns the module that few launches need.
local function inputs() return require("rfsm.rtt.inputs") end

-- Adds the ports in `ports`, or those that `rfsm.rtt.ports` has made before.
local function add_inputs(launch)
  local declared = rfsm_rtt.declared
  if declared and launch.inputs and not launch.is_declared then
    error("ports: expected once, rfsm_rtt.ports has made some", 0)
  end
  launch.inputs = launch.inputs or declared and declared.inputs
  launch.sources = launch.inputs and inputs().make(launch.component, launch.inputs,
    launch.is_component, launch.is_own or declared ~= nil) or {}
  for _, held in ipairs(launch.sources) do launch.held[#launch.held + 1] = held end
end

-- Adds the port that a setting of the launch asks for, by true or by a name.
local function add_port(launch, field)
  local wanted = launch[field]
  if not wanted then return nil end
  local way, name, global, text, kind = unpack(PORTS[field], 1, 5)
  if wanted ~= true and field ~= "timer" then name = wanted end
  local held = add(launch, { name = name, type = kind or "string", desc = text,
    porttype = way }, launch.is_own)
  held.keeps_last, held.global = field == "fqn_port", global
  launch.ports[field] = held
  rawset(_G, global, held.real or nil)
  return held
end

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

-- The machine --------------------------------------------------------------------

-- Returns an object that is read like a port. Its samples are events from `getevents`.
local function port_of(getevents)
  local list, i = false, 0
  return { read = function()
    list = list or getevents() or {}
    i = i + 1
    if list[i] ~= nil then return "NewData", list[i] end
    list, i = false, 0
    return "NoData"
  end }
end

-- Adds to the launch the ports that its prefile has listed in `extra_in_ports`.
local function hold_extra_ports(launch)
  local extra = rawget(_G, "extra_in_ports") or {}
  if extra[1] then rfsm_rtt.gen_read_events(unpack(extra)) end -- raises if one is wrong
  for i, real in ipairs(extra) do
    launch.extra[i] = held_port.hold(real, real:info())
  end
end

-- Adds the port for events, unless it is one of the ports in `ports`. Returns what is
-- read after those: the port, or the function `getevents` of the chart in its place.
local function add_event_port(launch, getevents)
  if launch.ev_inport == nil and not getevents then
    launch.ev_inport = launch.is_own or not held_port.of(launch.component, "events_in")
  end
  local name = launch.ev_inport == true and PORTS.ev_inport[2] or launch.ev_inport
  for _, held in ipairs(launch.sources) do
    if held.name == name then return nil end
  end
  return add_port(launch, "ev_inport") or getevents and port_of(getevents) or nil
end

-- Sets the function `getevents` of the machine, which reads ports. If the launch has a
-- port for events, the function `getevents` of the chart is not called.
local function add_getevents(launch, fsm, getevents)
  local sources, make = launch.sources, launch.inputs and inputs().converter
  for i, held in ipairs(sources) do
    held.convert = make(launch, fsm, launch.inputs[i])
  end
  hold_extra_ports(launch)
  sources[#sources + 1] = add_event_port(launch, getevents)
  for _, held in ipairs(launch.extra) do sources[#sources + 1] = held end
  local has_port = launch.inputs or launch.extra[1] or launch.ev_inport
  launch.inputs, launch.sources = nil, nil
  if not has_port then return end
  fsm.getevents = rfsm_rtt.gen_read_events(launch.samples, unpack(sources))
end

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

-- Hooks --------------------------------------------------------------------------

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
  if not ok then report(launch, problem) end
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

-- Makes RTT's hook `name` call the program's hook, if there is one, and then `ours`, if
-- given. With `always` it calls `ours` also when the program's hook fails or returns
-- false. It raises texts only, since OCL mutes the log of the whole process at an error
-- that is no text. RTT calls no hook inside of another one, but for the stopHook of a
-- component that stops itself.
local function wrap(launch, name, ours, always)
  local theirs = rawget(_G, name)
  if theirs == launch.hooks[name] and theirs then return end
  launch.theirs[name] = theirs
  launch.hooks[name] = function()
    local ok, result = true, true
    if name ~= "stopHook" then notice_exception(launch) end
    if theirs then ok, result = pcall(theirs) end
    if ours and (always or ok and result ~= false) then ours() end
    if not ok then error(rfsm.text_of(result), 0) end
    return result
  end
  rawset(_G, name, launch.hooks[name])
end

-- Wraps the hooks, but not the configureHook in which a component launches by itself.
local function wrap_hooks(launch)
  if not launch.is_own then
    wrap(launch, "configureHook", function() launch:make_ready() end)
  end
  wrap(launch, "startHook", function()
    launch:make_ready()
    warn_of_timers(launch)
    enter(launch, launch.fsm)
  end)
  wrap(launch, "cleanupHook", function() -- the ports may be gone
    launch.is_ready = false
    find_ports(launch, false)
  end, true)
  for _, name in ipairs { "activateHook", "updateHook", "errorHook", "stopHook" } do
    if rawget(_G, name) then wrap(launch, name) end
  end
end

-- Makes the ports and attributes that are missing, and wraps hooks that a `lua_file`
-- has defined after the launch. This happens in configureHook, in startHook, and at the
-- first update after a launch or a clean-up.
local function make_ready(launch)
  find_ports(launch, true)
  add_attributes(launch, ATTRIBUTES)
  wrap_hooks(launch)
  launch.is_ready = true
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
      notice_exception(launch)
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

-- Returns the global `trigger` of a service without a hook. A callback may call it,
-- too, so a call that finds a step under way reports that, and takes none.
local function new_outer_trigger(launch, trigger)
  return function() return notice_exception(launch) or trigger() end
end

-- Launch -------------------------------------------------------------------------

local function run(load, source, name)
  if source then assert(load(source, name))() end
end

-- Makes the deployer, which must be a peer, load a timer component. The timer component
-- writes to its port when a time has passed.
local function add_timer(launch)
  if not launch.timer then return end
  local target, name = launch.component, launch.deployer or "Deployer"
  local found, deployer = pcall(target.getPeer, target, name)
  if not found then
    error(("timer: a deployer that is a peer of '%s' expected, there is no '%s'")
      :format(target:getName(), name), 0)
  end
  launch.timer = target:getName() .. "_timer"
  if pcall(target.getPeer, target, launch.timer) then return end
  local load = deployer:getOperation("loadComponent")
  if not load(launch.timer, "OCL::TimerComponent") then
    error("timer: the deployer does not load '" .. launch.timer .. "'", 0)
  end
  launch.unload_timer = function()
    deployer:getPeer(launch.timer):stop()
    deployer:getOperation("unloadComponent")(launch.timer)
  end
  local timer = deployer:getPeer(launch.timer)
  target:addPeer(timer)
  timer:configure()
  timer:start()
end

-- Adds the ports for FQN, events and timer; returns the function that writes the FQN.
local function add_outputs(launch)
  local fqn, out = add_port(launch, "fqn_port"), add_port(launch, "ev_outport")
  add_port(launch, "timer")
  add_inputs(launch)
  local write_fqn = rfsm_rtt.gen_write_fqn(fqn)
  launch.emit = out and rfsm_rtt.gen_raise_event(out)
  set_globals { setfqn = write_fqn, emit_event = launch.emit }
  return write_fqn
end

-- Has the attribute `rfsm_state` follow the active leaf, as a number, because OCL's
-- reporters write a text with a column for each letter. The log has the list.
local function number_states(launch, fsm)
  local variable, numbers, texts = launch.variables.rfsm_state, {}, { "0 <none>" }
  for i, leaf in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do
    numbers[leaf], texts[i + 1] = i, ("%d %s"):format(i, leaf._fqn)
  end
  launch.rtt.logl("Info", ("rfsm.rtt: rfsm_state of '%s': %s"):format(
    launch.component:getName(), concat(texts, ", ")))
  local last = 0
  local follow = rfsm.borrows(function(machine)
    local number = numbers[machine._act_leaf] or 0
    if number ~= last then variable:assign(number) end
    last = number
  end)
  variable:assign(0)
  rfsm.post_step_hook_add(fsm, follow)
  rfsm.reset_hook_add(fsm, follow)
end

-- Connects the machine with its ports. FQNs are converted to Variables once, here.
local function connect(launch, fsm, getevents, write_fqn)
  rfsm.post_step_hook_add(fsm, write_fqn)
  local emit = launch.emit
  if emit then rfsm.set_emit(fsm, function(name) emit(name) end) end -- no data
  for _, leaf in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do
    launch.ports.fqn_port.samples[leaf._fqn] =
      launch.rtt.Variable.new("string", leaf._fqn)
  end
  add_getevents(launch, fsm, getevents)
  add_attributes(launch, ATTRIBUTES)
  number_states(launch, fsm)
  if launch.is_component then return end
  add_attributes(launch, update.OF_SERVICE)
  launch.variables.rfsm_halted:assign(not launch.eehook)
end

local function set_up(launch)
  if launch.pool then update.enlarge_pool(launch, launch.pool) end
  run(loadfile, launch.prefile)
  run(loadstring, launch.prestr, "=prestr")
  add_timer(launch)
  local write_fqn = add_outputs(launch)
  launch.stage = "the chart is loaded"
  collect()
  local fsm, getevents = load_machine(launch)
  launch.stage = "the machine is connected"
  collect()
  connect(launch, fsm, getevents, write_fqn)
  launch.fsm, launch.meter = fsm, update.new_meter(launch)
  local trigger = update.new_trigger(launch, fsm)
  local by_hand = not (launch.is_component or launch.eehook)
  set_globals { fsm = fsm,
    trigger = by_hand and new_outer_trigger(launch, trigger) or trigger }
  if launch.is_component and not rawget(_G, "updateHook") then
    wrap(launch, "updateHook", trigger)
  end
  run(loadfile, launch.postfile)
  run(loadstring, launch.poststr, "=poststr")
  fsm.err = update.counted(launch, fsm.err)
  if launch.is_component then wrap_hooks(launch) end
  return launch.eehook and new_hook(launch, trigger) or nil
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
  local rtt = package.loaded.rtt
  launch.rtt, launch.component = rtt, rtt.getTC()
  launch.hooks, launch.theirs = {}, {}
  launch.ports_at, launch.ports, launch.extra = launch.ports, {}, {}
  launch.held = {}
  launch.variables, launch.attributes = {}, {}
  launch.counts = { rfsm_errors = 0, rfsm_failures = 0, rfsm_overruns = 0 }
  launch.is_ready = launch.is_own or not launch.is_component
  launch.log, launch.flush, launch.log_as = update.new_log(rtt)
  launch.make_ready, launch.forget = make_ready, forget
  launch.undo, launch.finish = undo, update.finish
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
  local is_harder, usual = false, nil
  if rawget(_G, "tlsf") then -- Lua 5.5 has no such option
    is_harder, usual = pcall(collectgarbage, "setstepmul", 10000)
  end
  local ok, result = pcall(function()
    begin(launch)
    load_libraries(launch)
    rfsm_rtt.launched = launch -- now: an exception of C++ may end the launch
    local hook = set_up(launch)
    if rfsm_rtt.launched == launch then return hook end
    error("another launch began inside of it", 0)
  end)
  if is_harder then collectgarbage("setstepmul", usual) end
  rfsm_rtt.forget_modules()
  if not ok then update.fail(launch, result) end
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
