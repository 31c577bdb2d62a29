-- The arm grasps, and is ready again. It halts when it is ready.

local rfsm = require "rfsm"

return rfsm.state {
  info = false,

  ready = rfsm.state {},
  grasping = rfsm.state {},
  halted = rfsm.state { final = true,
    entry = function(fsm) fsm.emit "e_arm_halted" end },

  rfsm.trans { src = "initial", tgt = "ready" },
  rfsm.trans { src = "ready", tgt = "grasping", events = { "e_grasp" } },
  rfsm.trans { src = "grasping", tgt = "ready", events = { "e_done" } },
  rfsm.trans { src = "ready", tgt = "halted", events = { "e_halt_arm" } },
}
