--- The ports of a machine that `rfsm.rtt.launch_system` launches, one for each wire.
-- This module is loaded in the Lua of the machine's component.
--
-- @module rfsm.rtt.launch_system_ports
-- @license BSD-3-Clause

local rfsm_rtt = require "rfsm.rtt"
local rfsm = require "rfsm"
local held_port = require "rfsm.rtt.port"

local ipairs, package, rawget = ipairs, package, rawget

local launch_system_ports = {}

-- Returns the port of a wire. A component that is launched again has it already.
local function port_of(component, way, wire)
  local held = held_port.reserve(component, { name = wire.port, type = "string",
    porttype = way, desc = wire.desc })
  held.is_trigger = way == "in"
  held_port.provide(held, true)
  return held
end

-- Has the machine write what it emits, one wire after the other. An event that no wire
-- carries goes nowhere.
local function write_to(component, fsm, wires)
  local writers_of, told = {}, {}
  for _, wire in ipairs(wires) do
    local write = rfsm_rtt.gen_raise_event(port_of(component, "out", wire))
    for _, event in ipairs(wire.events) do
      writers_of[event] = writers_of[event] or {}
      table.insert(writers_of[event], write)
    end
  end
  rfsm.set_emit(fsm, function(event, data)
    local writers = writers_of[event]
    if writers and data ~= nil and not told[event] and fsm.warn then
      told[event] = true
      fsm.warn(("WARNING: a string port carries '%s' without its data"):format(event))
    end
    for i = 1, writers and #writers or 0 do writers[i](event) end
  end)
end

local MOST = 64 -- readings of all ports, until none has anything new

-- Returns a function that appends to a list what waits in all wires at one moment: the
-- ports are read until none has a new sample. So what a reader sees of one wire is not
-- older than what it sees of the next.
local function new_snapshot(fsm, readers, wires)
  local found, is_told = {}, false
  for i in ipairs(readers) do found[i] = {} end

  local function read_all()
    local is_new = false
    for i, read in ipairs(readers) do
      local list = found[i]
      for _, event in ipairs(read()) do
        list[wires[i].kind == "data" and 1 or #list + 1] = event
        is_new = true
      end
    end
    return is_new
  end

  return function(events)
    local count = 1
    while read_all() and count < MOST do count = count + 1 end
    if count == MOST and not is_told then
      is_told = true
      fsm.warn("WARNING: events come faster than all ports are read")
    end
    for _, list in ipairs(found) do
      for i = 1, #list do events[#events + 1], list[i] = list[i], nil end
    end
  end
end

-- Returns a function that appends to a list one event, of the next wire that has one.
local function new_turns(readers)
  local last = #readers
  return function(events)
    for i = 1, #readers do
      local at = (last + i - 1) % #readers + 1
      local event = readers[at]()[1]
      if event ~= nil then
        last, events[1] = at, event
        return
      end
    end
  end
end

-- Does an event wait in the machine itself, or is one current?
local function is_busy(fsm) return fsm._curq[1] ~= nil or fsm._intq[1] ~= nil end

-- Has the machine read its wires, and then its other ports. A machine that takes one
-- event an iteration reads one, and none while an event waits in itself.
local function read_from(component, fsm, wires)
  local readers, is_one = {}, fsm.read == "one"
  for i, wire in ipairs(wires) do
    local port = port_of(component, "in", wire)
    readers[i] = rfsm_rtt.gen_read_str_events(is_one and 1 or wire.size, port)
  end
  if not readers[1] then return end
  local read = is_one and new_turns(readers) or new_snapshot(fsm, readers, wires)
  local outside, events = rawget(fsm, "getevents"), {}
  function fsm.getevents(...)
    for i = #events, 1, -1 do events[i] = nil end
    if is_one and is_busy(fsm) then return events end
    read(events)
    if is_one and events[1] ~= nil or not outside then return events end
    for _, event in ipairs(outside(...) or {}) do events[#events + 1] = event end
    return events
  end
end

--- Join the machine of this Lua to its wires.
---@param outgoing { port: string, desc: string, events: string[] }[]
---@param incoming { port: string, desc: string, kind: string, size: integer }[]
function launch_system_ports.join(outgoing, incoming)
  local component, fsm = package.loaded.rtt.getTC(), rawget(_G, "fsm")
  write_to(component, fsm, outgoing)
  read_from(component, fsm, incoming)
end

return launch_system_ports
