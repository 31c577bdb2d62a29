-- Welds a seam. An event is misspelt.
local rfsm = require "rfsm"

return rfsm.state {
  ready = rfsm.state {},
  welding = rfsm.state { entry = function() torch(true) end,
    exit = function() torch(false) end },
  cooling = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "ready" },
  rfsm.trans { src = "ready", tgt = "welding", events = { "e_start" } },
  rfsm.trans { src = "welding", tgt = "cooling", events = { "e_seam_done" } },
  rfsm.trans { src = "cooling", tgt = "ready", events = { "e_cold" } },
  rfsm.trans { src = "welding", tgt = "ready", events = { "e_emergency" } },
  rfsm.trans { src = "cooling", tgt = "ready", events = { "e_emergnecy" } }, -- MISTAKE
}
