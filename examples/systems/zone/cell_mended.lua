-- Two arms and a zone that they share, mended: the zone lets them enter in turn.

local system = require "rfsm.system"

return system {
  left = system.load "left.lua",
  right = system.load "right.lua",
  zone = system.load "turns.lua",

  wires = {
    { from = "zone", event = "e_left_may", to = "left" },
    { from = "zone", event = "e_right_may", to = "right" },
    { from = "left", event = "e_left_is_out", to = "zone" },
    { from = "right", event = "e_right_is_out", to = "zone" },
  },
}
