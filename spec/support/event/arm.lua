-- never grasps: it always tells e_lost, with data
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans

return state { info = false,
  ready = state {},
  empty = state { final = true,
    entry = function(fsm) fsm.emit("e_lost", { n = 1 }) end },
  trans { src = "initial", tgt = "ready" },
  trans { src = "ready", tgt = "empty", events = { "e_grasp" } },
}
