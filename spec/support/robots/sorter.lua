-- Sorts parcels. A transition stands before another one on the same event.
local rfsm = require "rfsm"

return rfsm.state {
  scan = rfsm.state {}, left = rfsm.state {}, right = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "scan" },
  rfsm.trans { src = "scan", tgt = "left", events = { "e_label" } },
  rfsm.trans { src = "scan", tgt = "right", events = { "e_label" } }, -- MISTAKE
  rfsm.trans { src = "left", tgt = "scan", events = { "e_gone" } },
  rfsm.trans { src = "right", tgt = "scan", events = { "e_gone" } },
}
