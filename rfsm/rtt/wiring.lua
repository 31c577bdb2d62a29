--- The ports of a launch: those that its settings ask for, and what is read from them.
--
-- A launch loads this module to make the ports, and again to connect the machine. It is
-- forgotten in between, so that a pool has more room for the chart.
--
-- @module rfsm.rtt.wiring
-- @license BSD-3-Clause

local rfsm_rtt = require "rfsm.rtt" -- first: it adapts Lua to a TLSF pool
local rfsm = require "rfsm"
local held_port = require "rfsm.rtt.port"

local error, ipairs, pcall = error, ipairs, pcall
local rawget, rawset, require = rawget, rawset, require
local concat = table.concat
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local wiring = {}

-- Making the ports -------------------------------------------------------------------

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

--- Make the ports and the timer of a launch; return the function that writes the FQN.
function wiring.add_outputs(launch)
  add_timer(launch)
  local fqn, out = add_port(launch, "fqn_port"), add_port(launch, "ev_outport")
  add_port(launch, "timer")
  add_inputs(launch)
  local write_fqn = rfsm_rtt.gen_write_fqn(fqn)
  launch.emit = out and rfsm_rtt.gen_raise_event(out)
  rawset(_G, "setfqn", write_fqn)
  if out then rawset(_G, "emit_event", launch.emit) end
  return write_fqn
end

-- Reading them -----------------------------------------------------------------------

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

-- Connecting the machine -------------------------------------------------------------

-- Has the attribute `rfsm_state` follow the active leaf, as a number, because OCL's
-- reporters write a text with a column for each letter. The log has the list.
local function number_states(launch, fsm)
  local variable, numbers, texts = launch.variables.rfsm_state, {}, { "0 <none>" }
  for i, leaf in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do
    numbers[leaf._index], texts[i + 1] = i, ("%d %s"):format(i, leaf._fqn)
  end
  launch.rtt.logl("Info", ("rfsm.rtt: rfsm_state of '%s': %s"):format(
    launch.component:getName(), concat(texts, ", ")))
  local last = 0
  local follow = rfsm.borrows(function(machine)
    local leaf = machine._act_leaf
    local number = leaf and numbers[leaf._index] or 0
    if number ~= last then variable:assign(number) end
    last = number
  end)
  variable:assign(0)
  rfsm.post_step_hook_add(fsm, follow)
  rfsm.reset_hook_add(fsm, follow)
end

--- Connect the machine with its ports. FQNs are converted to Variables once, here.
function wiring.connect(launch, getevents, write_fqn)
  local fsm, emit = launch.fsm, launch.emit
  rfsm.post_step_hook_add(fsm, write_fqn)
  if emit then rfsm.set_emit(fsm, function(name) emit(name) end) end -- no data
  for _, leaf in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do
    launch.ports.fqn_port.samples[leaf._fqn] =
      launch.rtt.Variable.new("string", leaf._fqn)
  end
  add_getevents(launch, fsm, getevents)
  number_states(launch, fsm)
end

return wiring
