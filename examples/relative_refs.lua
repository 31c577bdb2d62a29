-- Relative references: a parent adds transitions to states inside a machine, without a
-- change of that machine.
--
--   +- drive ----------------------+
--   | (initial) --> slow --e_fast--> fast        (the sub machine)
--   +------|-----------------------+
--          +--e_bump--> backing                  (layered on top, by the parent)
--
-- `.drive.slow` is a path from the composite that contains the transition.
--
-- In rfsm-sim:  run()  ser("e_bump")  ser("e_clear")  ser("e_fast")  ser("e_bump")

local rfsm = require "rfsm"

local function says(text) return function() print(text) end end

local drive = rfsm.state {
  slow = rfsm.state { entry = says("slow") },
  fast = rfsm.state { entry = says("fast"), final = true },

  rfsm.trans { src = "initial", tgt = "slow" },
  rfsm.trans { src = "slow", tgt = "fast", events = { "e_fast" } },
}

return rfsm.state {
  drive = drive,
  backing = rfsm.state { entry = says("backing off") },

  rfsm.trans { src = "initial", tgt = "drive" },
  rfsm.trans { src = ".drive.slow", tgt = "backing", events = { "e_bump" } },
  rfsm.trans { src = "backing", tgt = ".drive.slow", events = { "e_clear" } },
}
