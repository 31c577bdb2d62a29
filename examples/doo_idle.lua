-- An idle doo: rfsm.yield(true) means that one cycle per call is enough. run() returns
-- after it, and the next call runs the next cycle: a periodic control loop.
--
--   (initial) --> holding --e_stop--> stopped
--
-- In rfsm-sim:  run()  run()  run()  ser("e_stop")

local rfsm = require "rfsm"

return rfsm.state {
  holding = rfsm.state {
    doo = function()
      local cycle = 0
      while true do
        cycle = cycle + 1
        print("control cycle " .. cycle)
        rfsm.yield(true)
      end
    end,
  },
  stopped = rfsm.state { entry = function() print("stopped") end, final = true },

  rfsm.trans { src = "initial", tgt = "holding" },
  rfsm.trans { src = "holding", tgt = "stopped", events = { "e_stop" } },
}
