local system = require "rfsm.system"

return system { sup = system.load "sup.lua", arm = system.load "arm.lua",
  wires = { { from = "sup", event = "e_grasp", to = "arm" },
    { from = "arm", event = "e_lost", to = "sup" } } }
