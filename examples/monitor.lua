-- A monitor state: it watches conditions and sends the event of each that holds.
--
--   (initial) --> flying --e_low, e_hot--> landing --e_repaired--> flying
--
-- In rfsm-sim:  step(3)  drone.volt = 10  run()  drone.volt = 12  ses("e_repaired")

-- luacheck: globals drone

local rfsm = require "rfsm"
local monitor = require "rfsm.monitor"

drone = { volt = 12, celsius = 40 } -- global, so that you can change it

return rfsm.state {
  flying = monitor.gen_monitor_state {
    montab = {
      e_hot = function() return drone.celsius > 80 end,
      e_low = function() return drone.volt < 11 end,
    },
    entry = function() print("flying") end,
  },
  landing = rfsm.state { entry = function() print("landing") end },

  rfsm.trans { src = "initial", tgt = "flying" },
  rfsm.trans { src = "flying", tgt = "landing", events = { "e_low", "e_hot" } },
  rfsm.trans { src = "landing", tgt = "flying", events = { "e_repaired" } },
}
