-- asks the arm to grasp
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans

return state { info = false,
  asking = state { entry = function(fsm) fsm.emit "e_grasp" end },
  holding = state { final = true }, failed = state { final = true },
  trans { src = "initial", tgt = "asking" },
  trans { src = "asking", tgt = "holding", events = { rfsm.named "e_grasped" } },
  trans { src = "asking", tgt = "failed", events = { rfsm.named "e_lost" } },
}
