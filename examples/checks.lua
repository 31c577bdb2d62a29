-- Undeclared events: with `checkevents` set, a machine warns of each event that no
-- transition names, such as one that is misspelt. (require "rfsm.checkevents" sets it
-- for every machine.)
--
--   (initial) --> off --e_push--> on --e_push--> off
--
-- In rfsm-sim:  run()  ser("e_push")  ser("e_pusch")
-- and, without the field `checks` of the state `spare`,
--               print(table.concat(rfsm_checks.check(fsm), "\n"))

local rfsm = require "rfsm"
require "rfsm_checks"

return rfsm.state {
  checkevents = true,

  off = rfsm.state { entry = function() print("dark") end },
  on = rfsm.state { entry = function() print("bright") end },
  -- the static check would find that nothing leads here, if it were not expected
  spare = rfsm.state { checks = { unreachable = "for a second lamp, to be wired" } },

  rfsm.trans { src = "initial", tgt = "off" },
  rfsm.trans { src = "off", tgt = "on", events = { "e_push" } },
  rfsm.trans { src = "on", tgt = "off", events = { "e_push" } },
}
