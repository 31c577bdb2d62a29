-- The left arm puts one part down in the zone, then it is parked.

local rfsm = require "rfsm"

return rfsm.state {
  info = false,

  asking = rfsm.state { entry = function(fsm) fsm.emit "e_left_asks" end },
  inside = rfsm.state {},
  parked = rfsm.state { final = true,
    entry = function(fsm) fsm.emit "e_left_is_out" end },

  rfsm.trans { src = "initial", tgt = "asking" },
  rfsm.trans { src = "asking", tgt = "inside", events = { "e_left_may" } },
  rfsm.trans { src = "inside", tgt = "parked", events = { "e_done" } },
}
