-- A supervisor, an arm and a base, and a stop that must arrive. The defect: the arm
-- discards the stop that comes while it grasps.

local system = require "rfsm.system"

return system {
  supervisor = system.load "supervisor.lua",
  arm = system.load "arm.lua",
  base = system.load "base.lua",

  wires = {
    { from = "supervisor", event = "e_grasp", to = "arm" },
    { from = "supervisor", event = "e_halt_base", to = "base" },
    { from = "supervisor", event = "e_halt_arm", to = "arm" },
    { from = "base", event = "e_base_halted", to = "supervisor" },
    { from = "arm", event = "e_arm_halted", to = "supervisor" },
  },
}
