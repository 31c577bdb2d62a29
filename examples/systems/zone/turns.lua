-- The zone has room for one arm: they enter in turn, and need not ask.

local rfsm = require "rfsm"

return rfsm.state {
  info = false,

  left = rfsm.state { entry = function(fsm) fsm.emit "e_left_may" end },
  right = rfsm.state { entry = function(fsm) fsm.emit "e_right_may" end },
  empty = rfsm.state { final = true },

  rfsm.trans { src = "initial", tgt = "left" },
  rfsm.trans { src = "left", tgt = "right", events = { "e_left_is_out" } },
  rfsm.trans { src = "right", tgt = "empty", events = { "e_right_is_out" } },
}
