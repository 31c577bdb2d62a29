-- A protocol with a lost message. The defect: two items that are read in one iteration
-- are one transition.

local system = require "rfsm.system"

return system {
  sender = system.load "sender.lua",
  receiver = system.load "receiver.lua",

  wires = {
    { from = "sender", event = "e_item", to = "receiver" },
    { from = "receiver", event = "e_received", to = "sender" },
  },
}
