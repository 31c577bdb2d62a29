-- Orocos: tightens a screw; the events come from a port, ends are named FAILED and OK.
require "rttlib"
local rfsm = require "rfsm"

event_in = rtt.InputPort("string")
rtt.getTC():addEventPort(event_in, "events")

return rfsm.state {
  getevents = rfsm_rtt.gen_read_str_events(event_in),
  approach = rfsm.state { entry = function() driver.down() end },
  turning = rfsm.state { entry = function() driver.turn(2.5) end,
    exit = function() driver.turn(0) end },
  OK = rfsm.state { entry = function() report("ok") end },
  FAILED = rfsm.state { entry = function() report("failed") end },
  rfsm.trans { src = "initial", tgt = "approach" },
  rfsm.trans { src = "approach", tgt = "turning", events = { "e_thread" } },
  rfsm.trans { src = "turning", tgt = "OK", events = { "e_torque" } },
  rfsm.trans { src = "turning", tgt = "FAILED", events = { "e_slip", "e_angle" } },
}
