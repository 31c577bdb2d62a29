-- The zone has room for one arm: who asks may enter.

local rfsm = require "rfsm"

return rfsm.state {
  info = false,

  free = rfsm.state {},
  left = rfsm.state { entry = function(fsm) fsm.emit "e_left_may" end },
  right = rfsm.state { entry = function(fsm) fsm.emit "e_right_may" end },

  rfsm.trans { src = "initial", tgt = "free" },
  rfsm.trans { src = "free", tgt = "left", events = { "e_left_asks" } },
  rfsm.trans { src = "left", tgt = "free", events = { "e_left_is_out" } },
  rfsm.trans { src = "free", tgt = "right", events = { "e_right_asks" } },
  rfsm.trans { src = "right", tgt = "free", events = { "e_right_is_out" } },
}
