-- A protocol without a lost message: each machine takes one event an iteration.

local system = require "rfsm.system"

return system {
  sender = system.load "sender_mended.lua",
  receiver = system.load "receiver_mended.lua",

  wires = {
    { from = "sender", event = "e_item", to = "receiver" },
    { from = "receiver", event = "e_received", to = "sender" },
  },
}
