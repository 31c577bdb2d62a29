-- A weather mast with a service mode; a fault is left by hand.
require "rfsm_timeevent"
local rfsm = require "rfsm"

return rfsm.state {
  measuring = rfsm.state { entry = function() mast.read_all() end },
  sending = rfsm.state { doo = function() radio.send(mast.values) end },
  fault = rfsm.state { entry = function() radio.alarm() end },
  service = rfsm.state {
    raised = rfsm.state {}, lowered = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "raised" },
    rfsm.trans { src = "raised", tgt = "lowered", events = { "e_crank" } },
    rfsm.trans { src = "lowered", tgt = "raised", events = { "e_crank" } },
  },
  rfsm.trans { src = "initial", tgt = "measuring" },
  rfsm.trans { src = "measuring", tgt = "sending", events = { "e_after(60)" } },
  rfsm.trans { src = "sending", tgt = "measuring", events = { "e_done" } },
  rfsm.trans { src = "sending", tgt = "fault", events = { "e_no_link" } },
  rfsm.trans { src = "measuring", tgt = "service", events = { "e_key" } },
  rfsm.trans { src = "fault", tgt = "service", events = { "e_key" } },
  rfsm.trans { src = "service", tgt = "measuring", events = { "e_key_out" } },
}
