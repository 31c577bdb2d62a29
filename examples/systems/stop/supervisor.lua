-- Lets the arm grasp. At e_stop it stops the base, then the arm.

local rfsm = require "rfsm"

return rfsm.state {
  info = false,

  working = rfsm.state { entry = function(fsm) fsm.emit "e_grasp" end },
  stopping_base = rfsm.state { entry = function(fsm) fsm.emit "e_halt_base" end },
  stopping_arm = rfsm.state { entry = function(fsm) fsm.emit "e_halt_arm" end },
  stopped = rfsm.state { final = true },

  rfsm.trans { src = "initial", tgt = "working" },
  rfsm.trans { src = "working", tgt = "stopping_base", events = { "e_stop" } },
  rfsm.trans { src = "stopping_base", tgt = "stopping_arm",
    events = { "e_base_halted" } },
  rfsm.trans { src = "stopping_arm", tgt = "stopped", events = { "e_arm_halted" } },
}
