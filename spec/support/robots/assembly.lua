-- Two arms; both have to be there before the part is handed over.
require "rfsm_await"
local rfsm = require "rfsm"

return rfsm.state {
  approach = rfsm.state {
    entry = function() left.go("table") right.go("table") end },
  hand_over = rfsm.state { doo = function() right.grasp() left.release() end },
  retreat = rfsm.state { entry = function() left.go("home") right.go("home") end },
  rfsm.trans { src = "initial", tgt = "approach" },
  rfsm.trans { src = "approach", tgt = "hand_over",
    events = { "await(e_left_there, e_right_there)" } },
  rfsm.trans { src = "hand_over", tgt = "retreat", events = { "e_done" } },
  rfsm.trans { src = "retreat", tgt = "approach", events = { "e_next_part" } },
}
