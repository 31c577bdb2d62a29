-- A sequence: it ends when the arm is calibrated.
local rfsm = require "rfsm"

return rfsm.state {
  unlock = rfsm.state { doo = function() arm_unlock() end },
  find_zero = rfsm.state { doo = function() arm_find_zero() end },
  park = rfsm.state { doo = function() arm_move_to("park") end },
  parked = rfsm.state { entry = function() print("calibrated") end },

  rfsm.trans { src = "initial", tgt = "unlock" },
  rfsm.trans { src = "unlock", tgt = "find_zero", events = { "e_done" } },
  rfsm.trans { src = "find_zero", tgt = "park", events = { "e_done" } },
  rfsm.trans { src = "park", tgt = "parked", events = { "e_done" } },
}
