-- The arm grasps, and is ready again. It halts whatever it does: a transition of the
-- composite goes before those in it.

local rfsm = require "rfsm"

return rfsm.state {
  info = false,

  working = rfsm.state {
    ready = rfsm.state {},
    grasping = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "ready" },
    rfsm.trans { src = "ready", tgt = "grasping", events = { "e_grasp" } },
    rfsm.trans { src = "grasping", tgt = "ready", events = { "e_done" } },
  },
  halted = rfsm.state { final = true,
    entry = function(fsm) fsm.emit "e_arm_halted" end },

  rfsm.trans { src = "initial", tgt = "working" },
  rfsm.trans { src = "working", tgt = "halted", events = { "e_halt_arm" } },
}
