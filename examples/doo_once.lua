-- A doo that runs once: when it returns, the state is done and e_done is sent.
--
--   (initial) --> calibrate --e_done--> ready
--
-- In rfsm-sim:  step()  step()  step()

local rfsm = require "rfsm"

return rfsm.state {
  calibrate = rfsm.state {
    doo = function() print("calibrating") end,
  },
  ready = rfsm.state { entry = function() print("ready") end, final = true },

  rfsm.trans { src = "initial", tgt = "calibrate" },
  rfsm.trans { src = "calibrate", tgt = "ready", events = { "e_done" } },
}
