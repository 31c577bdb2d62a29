-- Drives and makes a map. A function of Lua is misspelt.
local rfsm = require "rfsm"

return rfsm.state {
  driving = rfsm.state {
    entry = function() slam.resume() end,
    exit = function() pritn("map", slam.size()) end, -- MISTAKE
  },
  saving = rfsm.state { doo = function() slam.save("/tmp/map") end },
  rfsm.trans { src = "initial", tgt = "driving" },
  rfsm.trans { src = "driving", tgt = "saving", events = { "e_save" } },
  rfsm.trans { src = "saving", tgt = "driving", events = { "e_done" } },
}
