-- Two arms and a zone that they share. The defect: an arm that asks while the other is
-- in the zone, or in the same iteration, is not heard, and waits for ever.

local system = require "rfsm.system"

return system {
  left = system.load "left.lua",
  right = system.load "right.lua",
  zone = system.load "zone.lua",

  wires = {
    { from = "left", event = "e_left_asks", to = "zone" },
    { from = "right", event = "e_right_asks", to = "zone" },
    { from = "zone", event = "e_left_may", to = "left" },
    { from = "zone", event = "e_right_may", to = "right" },
    { from = "left", event = "e_left_is_out", to = "zone" },
    { from = "right", event = "e_right_is_out", to = "zone" },
  },
}
