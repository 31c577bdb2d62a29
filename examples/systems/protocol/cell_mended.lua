-- A protocol without a lost message: one event is read in an iteration.

local system = require "rfsm.system"

return system {
  sender = system.load "sender.lua",
  receiver = system.load "receiver.lua",

  wires = {
    { from = "sender", event = "e_item", to = "receiver", read = "one" },
    { from = "receiver", event = "e_received", to = "sender", read = "one" },
  },
}
