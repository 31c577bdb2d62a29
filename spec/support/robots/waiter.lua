-- Serves drinks. A state has no way out, though the robot should go on.
local rfsm = require "rfsm"

return rfsm.state {
  roaming = rfsm.state {},
  offering = rfsm.state { entry = function() say("a drink?") end },
  refilling = rfsm.state { entry = function() drive("bar") end }, -- MISTAKE
  rfsm.trans { src = "initial", tgt = "roaming" },
  rfsm.trans { src = "roaming", tgt = "offering", events = { "e_person" } },
  rfsm.trans { src = "offering", tgt = "roaming", events = { "e_taken", "e_refused" } },
  rfsm.trans { src = "offering", tgt = "refilling", events = { "e_tray_empty" } },
}
