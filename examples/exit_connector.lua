-- Exit connectors: a composite has named ways out, and the chart around it decides
-- where they lead.
--
--   +- grasp ----------------------------------+
--   | (initial) --> close --e_firm--> (success) --> carrying
--   |                 |                        |
--   |                 +----e_slip---> (failure) --> home
--   +------------------------------------------+
--
-- In rfsm-sim:  run()  ser("e_slip")  ser("e_again")  ser("e_firm")

local rfsm = require "rfsm"

local function says(text) return function() print(text) end end

local grasp = rfsm.state {
  exit = says("grasp left"),

  close = rfsm.state { entry = says("closing fingers") },
  success = rfsm.conn {},
  failure = rfsm.conn {},

  rfsm.trans { src = "initial", tgt = "close" },
  rfsm.trans { src = "close", tgt = "success", events = { "e_firm" } },
  rfsm.trans { src = "close", tgt = "failure", events = { "e_slip" } },
}

return rfsm.state {
  grasp = grasp,
  carrying = rfsm.state { entry = says("carrying"), final = true },
  home = rfsm.state { entry = says("going home") },

  rfsm.trans { src = "initial", tgt = "grasp" },
  rfsm.trans { src = "grasp.success", tgt = "carrying" },
  rfsm.trans { src = "grasp.failure", tgt = "home" },
  rfsm.trans { src = "home", tgt = "grasp", events = { "e_again" } },
}
