--- Wires: queues between machines, which do as connections of Orocos.
--
-- A queue is a plain list, the oldest event first. Nothing else is kept of a wire.
--
-- @module rfsm.system.wires
-- @license BSD-3-Clause

local encoding = require "rfsm.snapshot.encoding"

local ipairs, remove, type = ipairs, table.remove, type

local wires = {}

--- A wire, from one machine to another or to itself.
---@class rfsm.system.Wire
---@field number integer its position
---@field from string machine
---@field event string
---@field to string machine
---@field kind "buffer"|"data" buffer: full, the new event is lost; data: the old one
---@field size integer of the buffer; of data 1
---@field read "all"|"one" how much a move of its reader takes
---@field location string "cell.lua:7"

--- Return the event that `fsm.emit(name, data)` means: its name; with data, a table
--- that `rfsm.named` accepts. Data that is no table is its field `data`.
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
---@return rfsm.system.Wire[] by the wire of each
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
