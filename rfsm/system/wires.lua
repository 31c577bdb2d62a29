--- Wires: queues between machines, which behave as the connections of Orocos do.
--
-- A queue is a plain list of events, the oldest first.
--
-- @module rfsm.system.wires
-- @license BSD-3-Clause

local encoding = require "rfsm.snapshot.encoding"

local ipairs, remove, type = ipairs, table.remove, type

local wires = {}

--- A wire, from one machine to another or to itself.
---@class rfsm.system.Wire
---@field number integer its position in the description
---@field from string name of the machine that emits the event
---@field event string
---@field to string name of the machine that reads the wire
---@field kind "buffer"|"data" a full buffer loses a new event; data keeps the newest
---@field size integer how many events a buffer holds; 1 for data
---@field read "all"|"one" how many events the reader takes from the queue at once
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

--- Take the events for a machine from the queues of its wires, wire by wire.
---@param list rfsm.system.Wire[]
---@param queues any[][] the queue of each wire in the list
---@param to string the machine
---@return any[] events
---@return rfsm.system.Wire[] by the wire from which each event comes
function wires.take(list, queues, to)
  local events, by = {}, {}
  for i, wire in ipairs(list) do
    local waiting = wire.to == to and #queues[i] or 0
    for _ = 1, wire.read == "one" and waiting > 0 and 1 or waiting do
      events[#events + 1], by[#by + 1] = remove(queues[i], 1), wire
    end
  end
  return events, by
end

return wires
