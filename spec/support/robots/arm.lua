-- Picks objects; its gripper is a part with a file of its own.
local rfsm = require "rfsm"

local gripper = dofile "gripper.lua"

return rfsm.state {
  idle = rfsm.state { entry = function() print "idle" end },
  picking = gripper,
  lifting = rfsm.state { entry = function() arm.moveTo("above") end },

  rfsm.trans { src = "initial", tgt = "idle" },
  rfsm.trans { src = "idle", tgt = "picking", events = { "e_pick" } },
  rfsm.trans { src = "picking", tgt = "lifting", events = { "e_grasped" } },
  rfsm.trans { src = "lifting", tgt = "idle", events = { "e_arm_idle" } },
  rfsm.trans { src = "picking", tgt = "idle", events = { "e_abort" } },
}
