-- A gripper. The arm that has it leaves it when it is open or holds something.
local rfsm = require "rfsm"

return rfsm.state {
  opening = rfsm.state { entry = function() hand:move(0.08) end },
  closing = rfsm.state { entry = function() hand:grasp(12) end },
  open = rfsm.state {},
  holding = rfsm.state {},

  rfsm.trans { src = "initial", tgt = "opening" },
  rfsm.trans { src = "opening", tgt = "open", events = { "e_hand_idle" } },
  rfsm.trans { src = "open", tgt = "closing", events = { "e_object_seen" } },
  rfsm.trans { src = "closing", tgt = "holding", events = { "e_hand_idle" } },
}
