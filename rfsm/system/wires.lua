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
---@field from string machine
---@field event string
---@field to string machine
---@field kind "buffer"|"data" a full buffer loses a new event, data the old one
---@field size integer of the buffer; of data 1
---@field read "all"|"one" how many events a move of the reader takes from the queue
---@field location string "cell.lua:7"

--- Return the event that `fsm.emit(name, data)` sends: without data the name; otherwise
--- a table that `rfsm.named` accepts. Data that is no table becomes its field `data`.
function wires.event_of(name, data)
  if data == nil then return name end
  local event = encoding.copy_of(type(data) == "table" and data or { data = data })
  event.name = name
  return event
end

--- Put an event into the queue of a wire; return whether it found room.
---@param wire rfsm.system.Wire
---@param queue any[]
---@param event any
---@return boolean is_put
function wires.put(wire, queue, event)
  local is_full = wire.kind == "buffer" and #queue >= wire.size
  if not is_full then queue[wire.kind == "data" and 1 or #queue + 1] = event end
  return not is_full
end

--- Take the events for a machine from the queues of its wires, in their order.
---@param list rfsm.system.Wire[]
---@param queues any[][] of these wires
---@param to string the machine
---@return any[] events
---@return rfsm.system.Wire[] by for each event the wire from which it comes
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
