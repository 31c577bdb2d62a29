-- A lamp with a push button: one event, two meanings.
--
--   (initial) --> off --e_push--> on
--                  ^               |
--                  +----e_push-----+
--
-- In rfsm-sim:  run()  ser("e_push")  ser("e_push")

local rfsm = require "rfsm"

return rfsm.state {
  off = rfsm.state { entry = function() print("dark") end },
  on = rfsm.state { entry = function() print("bright") end },

  rfsm.trans { src = "initial", tgt = "off" },
  rfsm.trans { src = "off", tgt = "on", events = { "e_push" } },
  rfsm.trans { src = "on", tgt = "off", events = { "e_push" } },
}
