--- A machine in a component of Orocos RTT: its ports, its hooks, its launch.
--
-- A launch loads this module in the Lua of the component, or of its service.
--
-- @module rfsm.rtt.component
-- @license BSD-3-Clause

local rfsm_rtt = require "rfsm.rtt" -- first: it sets the collector of a pool
local rfsm = require "rfsm"
local held_port = require "rfsm.rtt.port"
local update = require "rfsm.rtt.update"

local assert, collectgarbage, coroutine = assert, collectgarbage, coroutine
local error, ipairs, loadfile, package = error, ipairs, loadfile, package
local pairs, pcall, rawget, rawset = pairs, pcall, rawget, rawset
local require, type = require, type
local loadstring = rawget(_G, "loadstring") or rawget(_G, "load")
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

-- What stays after the launch holds these, and not all of the module.
local add_attributes, ATTRIBUTES = update.add_attributes, update.ATTRIBUTES
local make_room, new_reporter, printer =
  update.make_room, update.new_reporter, update.printer

local component = { RESUME = "rfsm.rtt: resume" } -- the name of a global

--- What a launch has asked for, and what belongs to its machine.
---@class rfsm.rtt.Launched : rfsm.rtt.Launch
---@field is_component boolean false: a service
---@field rtt table the module of RTT
---@field component any the TaskContext
---@field ports table<string, rfsm.rtt.Port> by field of the launch
---@field extra rfsm.rtt.Port[] those of `extra_in_ports`
---@field variables table<string, any> the values of the attributes, by name
---@field attributes string[] names of those that this launch has added
---@field is_ready boolean are the ports there, and the hooks those of the launch?

local function set_globals(globals)
  for name, value in pairs(globals) do rawset(_G, name, value) end -- any order: a set
end

-- Ports --------------------------------------------------------------------------

-- By field of a launch: class, name if the field is true, global, description.
local PORTS = {
  fqn_port = { "OutputPort", "fqn", "fqn", "FQN of the active leaf" },
  ev_outport = { "OutputPort", "events_out", "ev_outport", "events of the machine" },
  ev_inport = { "InputPort", "events_in", "ev_inport", "events for the machine" },
  timer = { "InputPort", "rfsm_timer", "rfsm_timer", "wakes for time events", "int" },
}
local FIELDS = { "fqn_port", "ev_outport", "ev_inport", "timer" }

local function new_port(launch, field, held)
  local facts, class = held.facts, PORTS[field][1]
  local real = launch.rtt[class].new(facts.type, facts.name, facts.desc)
  local is_trigger = class == "InputPort" and launch.is_component
  launch.component[is_trigger and "addEventPort" or "addPort"](launch.component, real)
  held.real = real
  if held.last and field == "fqn_port" then real:write(held.last) end
  if field ~= "timer" then return end
  real:connect(launch.component:getPeer(launch.timer):getPort("timer_0"))
end

-- Holds the port that a field of the launch asks for: true, or its name. RTT would
-- replace and disconnect one whose name is used again. With `ports = "configure"`, the
-- port is made when the component is configured.
local function add_port(launch, field)
  local wanted, target = launch[field], launch.component
  if not wanted then return nil end
  local class, name, _, text, kind = unpack(PORTS[field], 1, 5)
  if wanted ~= true and field ~= "timer" then name = wanted end
  local held = held_port.reserve(target, { name = name, type = kind or "string",
    desc = text, porttype = class == "InputPort" and "in" or "out" })
  if launch.ports_at ~= "configure" then
    if held_port.of(target, name) then
      error(("'%s' has a port '%s' already"):format(target:getName(), name), 0)
    end
    new_port(launch, field, held)
  end
  launch.ports[field] = held
  return held
end

-- Raises if a port that was found has another direction or type than that of a launch.
local function check_port(held)
  local wanted, found = held.facts, held.real:info()
  if found.porttype == wanted.porttype and found.type == wanted.type then return end
  error(("port '%s': %sput port of type %s expected, got an %sput port of type %s")
    :format(held.name, wanted.porttype, wanted.type, found.porttype, found.type), 0)
end

local function set_port_globals(launch)
  for field, held in pairs(launch.ports) do -- any order: each is a global of its own
    rawset(_G, PORTS[field][3], held.real or nil)
  end
end

-- Finds the ports again, and makes them if they shall be there.
local function find_ports(launch, is_made)
  for _, field in ipairs(FIELDS) do
    local held = launch.ports[field]
    if held and held:find() then
      check_port(held)
    elseif held and is_made then
      new_port(launch, field, held)
    end
  end
  set_port_globals(launch)
  for _, held in ipairs(launch.extra) do held:find() end
end

-- The machine --------------------------------------------------------------------

-- Returns what is read like a port: the events of a getevents, one by one.
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

-- Makes the getevents of the machine: the port for events replaces that of the chart.
-- The global `extra_in_ports` lists more ports, of a prefile.
local function add_getevents(launch, fsm, getevents)
  if launch.ev_inport == nil then
    launch.ev_inport = not getevents and not held_port.of(launch.component, "events_in")
  end
  local extra = rawget(_G, "extra_in_ports") or {}
  if extra[1] then rfsm_rtt.gen_read_events(unpack(extra)) end -- raises for wrong ones
  for i, real in ipairs(extra) do
    launch.extra[i] = held_port.hold(real, real:info())
  end
  local input = add_port(launch, "ev_inport")
  if not input and not extra[1] then return end
  local first = input or getevents and port_of(getevents)
  local sources = first and { first, unpack(launch.extra) } or launch.extra
  fsm.getevents = rfsm_rtt.gen_read_events(unpack(sources))
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

-- Logs the cycles on which the machine never becomes idle. Exploring the chart, and
-- even all static checks, would need more memory than the pool of a component has.
local function report_endless(launch, fsm)
  local is_kept = {}
  for name in pairs(package.loaded) do is_kept[name] = true end -- any order: a set
  local log = printer(launch.rtt, "Warning")
  local function add(code, state, text)
    local silences = type(state.checks) == "table" and state.checks or {}
    if not silences[code] then
      log(("%s: %s [%s]"):format(state._fqn, text, code))
    end
  end
  local ok, problem = pcall(function() require("rfsm.checks.loops").check(fsm, add) end)
  if not ok then
    make_room(problem)
    log("not checked for cycles without an event:", problem)
  end
  for name in pairs(package.loaded) do -- any order: each alone
    if not is_kept[name] then package.loaded[name] = nil end
  end
end

-- Has the machine compiled now. A pool that is three quarters full does without text of
-- rfsm/fast.lua, which takes up to 2 KiB a transition.
local function prepare(fsm)
  if update.is_short_of_memory() then rfsm.save_memory() end
  rfsm.prepare(fsm)
end

-- Hooks --------------------------------------------------------------------------

local make_ready

-- Events that wait in ports stay there: the entry would not name them.
local function enter(launch, fsm)
  if launch.enter ~= "start" or rfsm.get_sta_mode(fsm) ~= "inactive" then return end
  local getevents = rawget(fsm, "getevents")
  local function no_events() end
  fsm.getevents = no_events
  local ok, problem = pcall(rfsm.step, fsm)
  if fsm.getevents == no_events then fsm.getevents = getevents end
  if not ok then new_reporter(launch)(problem) end
end

-- Logs that time events wait for other events if nothing wakes the component.
local function warn_of_timers(launch)
  if launch.timer or launch.component:getOperation("getPeriod")() > 0 then return end
  for _, tr in ipairs(rfsm.elements(launch.fsm, rfsm.is_trans)) do
    for _, event in ipairs(tr.events or {}) do
      local name = rfsm.text_of(event)
      if name:find("^e_after%(") or name:find("^e_at%(") then
        local text = "%s is late: a component without a period needs timer = true"
        return printer(launch.rtt, "Warning")(text:format(name))
      end
    end
  end
end

-- Has RTT's hook `name` call that of the program, if there is one, and then `ours`, if
-- given: also after a failure or false if it is to come `always`. It raises texts only,
-- since OCL mutes the log of the whole process at an error that is no text.
local function wrap(launch, name, ours, always)
  local theirs = rawget(_G, name)
  if theirs == launch.hooks[name] and theirs then return end
  launch.hooks[name] = function()
    local ok, result = true, true
    if theirs then ok, result = pcall(theirs) end
    if ours and (always or ok and result ~= false) then ours() end
    if not ok then error(rfsm.text_of(result), 0) end
    return result
  end
  rawset(_G, name, launch.hooks[name])
end

local function wrap_hooks(launch)
  wrap(launch, "configureHook", function() make_ready(launch) end)
  wrap(launch, "startHook", function()
    make_ready(launch)
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

-- Makes the ports and attributes that are not there, and wraps hooks which a `lua_file`
-- has defined since. This happens in configureHook, in startHook, and at the first
-- update after a launch or a clean-up.
function make_ready(launch)
  find_ports(launch, true)
  add_attributes(launch, ATTRIBUTES)
  wrap_hooks(launch)
  launch.is_ready = true
end

-- RTT looks the function up by its name at each update. It ends the process if the
-- function is not there, or if the hook was collected. So the name is one that no chart
-- uses, and the function holds the hook.
local HOOK = "rfsm.rtt: function of the EEHook"

-- Returns a hook for the component's thread, to be enabled when nothing else is left to
-- do in this Lua: OCL takes no lock. The hook has a stack of its own, that of the Lua
-- thread in which it is made. A halt removes it, in the component's thread.
local function new_hook(launch, trigger)
  local halt, halted = launch.variables.rfsm_halt, launch.variables.rfsm_halted
  local thread = coroutine.create(function() return launch.rtt.EEHook.new(HOOK) end)
  local _, hook = assert(coroutine.resume(thread))
  launch.hook, launch.thread = hook, thread
  set_globals { eehook = hook, [HOOK] = function()
    if launch.hook and not halt:tolua() then return trigger() end
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

-- Launch -------------------------------------------------------------------------

local function run(load, source, name)
  if source then assert(load(source, name))() end
end

-- Adds ports to which the machine writes; returns the function that writes the FQN.
local function add_outputs(launch)
  local fqn, out = add_port(launch, "fqn_port"), add_port(launch, "ev_outport")
  add_port(launch, "timer")
  local write_fqn = rfsm_rtt.gen_write_fqn(fqn)
  set_globals { setfqn = write_fqn,
    emit_event = out and rfsm_rtt.gen_raise_event(out) }
  set_port_globals(launch)
  return write_fqn
end

-- Connects the machine with its ports. The texts that it writes are converted now.
local function connect(launch, fsm, getevents, write_fqn)
  rfsm.post_step_hook_add(fsm, write_fqn)
  for _, leaf in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do
    launch.ports.fqn_port.samples[leaf._fqn] =
      launch.rtt.Variable.new("string", leaf._fqn)
  end
  add_getevents(launch, fsm, getevents)
  add_attributes(launch, ATTRIBUTES)
  if launch.is_component then return end
  add_attributes(launch, update.OF_SERVICE)
  launch.variables.rfsm_halted:assign(not launch.eehook)
end

local function set_up(launch)
  run(loadfile, launch.prefile)
  run(loadstring, launch.prestr, "=prestr")
  local write_fqn = add_outputs(launch)
  local fsm, getevents = load_machine(launch.rtt, launch.fsmfile)
  connect(launch, fsm, getevents, write_fqn)
  set_port_globals(launch)
  launch.fsm, launch.meter = fsm, update.new_meter(launch)
  local trigger = update.new_trigger(launch, fsm, make_ready)
  launch.hooks.updateHook = launch.is_component and function() trigger() end or nil
  set_globals { fsm = fsm, trigger = trigger, updateHook = launch.hooks.updateHook }
  run(loadfile, launch.postfile)
  run(loadstring, launch.poststr, "=poststr")
  report_endless(launch, fsm)
  prepare(fsm)
  return launch.eehook and new_hook(launch, trigger) or nil
end

-- Takes away what a launch has made. Ports and attributes are no garbage for Lua.
local function undo(launch)
  for _, field in ipairs(FIELDS) do
    local real = launch.ports[field] and launch.ports[field].real
    if real then
      launch.component:removePort(real:info().name) -- else `delete` ends the process
      real:delete()
    end
  end
  for _, name in ipairs(launch.attributes) do
    launch.component:removeAttribute(name)
  end
end

--- Launch a machine in this Lua; return the hook to enable as the last act, if there is
-- one. Raises an error with the name of the chart.
--
-- Charts rely on rttlib, which makes constructors callable and operations methods, and
-- on utils: both are loaded if they can be had.
function component.launch(launch)
  local where = "launch of '" .. launch.fsmfile .. "': "
  if not rfsm.prepare then error(where .. "another rfsm is loaded in this Lua", 0) end
  local rtt = package.loaded.rtt
  if not rtt then error(where .. "no module 'rtt' in this Lua", 0) end
  if rfsm.is_initialized_root(rawget(_G, "fsm")) then
    error(where .. "a machine was launched here before, it is the global 'fsm'", 0)
  end
  pcall(require, "rttlib")
  local has_utils, utils = pcall(require, "utils")
  if has_utils and not rawget(_G, "utils") then set_globals { utils = utils } end
  launch.rtt, launch.component, launch.hooks = rtt, rtt.getTC(), {}
  launch.ports_at, launch.ports, launch.extra = launch.ports, {}, {}
  launch.variables, launch.attributes = {}, {}
  launch.is_ready = not launch.is_component
  local ok, result = pcall(set_up, launch)
  for _, name in ipairs { "component", "update" } do -- most is not needed any more
    package.loaded["rfsm.rtt." .. name] = nil
  end
  if ok and launch.is_component then wrap_hooks(launch) end
  if not ok then undo(launch) end
  collectgarbage()
  if not ok then error(where .. rfsm.text_of(result), 0) end
  launch.meter()
  return result
end

return component
