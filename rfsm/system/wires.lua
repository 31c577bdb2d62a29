--- Wires: queues between machines, which behave as the connections of Orocos do.
--
-- A queue is a plain list of events, the oldest first, in the order in which the sender
-- has put them there. An event is put into one queue after the other.
--
-- @module rfsm.system.wires
-- @license BSD-3-Clause

local encoding = require "rfsm.snapshot.encoding"

local ipairs, type = ipairs, type
local min, remove = math.min, table.remove

local wires = {}

--- A connection, from one machine to another or to itself.
---@class rfsm.system.Wire
---@field number integer its position in the description
---@field from string name of the machine that emits the events
---@field events string[] the events that it carries
---@field to string name of the machine that reads the queue
---@field kind "buffer"|"data" a full buffer loses a new event; data keeps the newest
---@field size integer how many events a buffer holds; 1 for data
---@field location string where it is described, such as "cell.lua:7"

--- Return the event that `fsm.emit(name, data)` sends: the name if there is no data; a
--- copy of `data` with the field `name` if `data` is a table; otherwise a table with
--- the fields `name` and `data`.
function wires.event_of(name, data)
  if data == nil then return name end
  local event = encoding.copy_of(type(data) == "table" and data or { data = data })
  event.name = name
  return event
end

--- Put an event into the queue of a wire, unless the wire is a full buffer.
---@param wire rfsm.system.Wire
---@param queue any[]
---@param event any
---@return boolean is_put
function wires.put(wire, queue, event)
  local is_full = wire.kind == "buffer" and #queue >= wire.size
  if not is_full then queue[wire.kind == "data" and 1 or #queue + 1] = event end
  return not is_full
end

--- List the positions of the wires to a machine in which an event waits.
---@param list rfsm.system.Wire[]
---@param queues any[][] the queue of each wire in the list
---@param to string the machine
---@return integer[] positions
function wires.waiting(list, queues, to)
  local found = {}
  for at, wire in ipairs(list) do
    if wire.to == to and queues[at][1] ~= nil then found[#found + 1] = at end
  end
  return found
end

--- Take events from queues: all that wait, or one of them.
---@param list rfsm.system.Wire[]
---@param queues any[][] the queue of each wire in the list
---@param positions integer[] the wires to take events from, one after the other
---@param is_one? boolean take one event of each wire
---@return any[] events
---@return rfsm.system.Wire[] by the wire from which each event comes
function wires.take(list, queues, positions, is_one)
  local events, by = {}, {}
  for _, at in ipairs(positions) do
    for _ = 1, is_one and min(1, #queues[at]) or #queues[at] do
      events[#events + 1], by[#by + 1] = remove(queues[at], 1), list[at]
    end
  end
  return events, by
end

return wires
