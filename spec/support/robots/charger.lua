-- Docks at a charger; the times are those of the robot's configuration.
require "rfsm_timeevent"
local config = require "robot_config"
local rfsm = require "rfsm"

return rfsm.state {
  driving = rfsm.state {},
  docking = rfsm.state { entry = function() base.creep() end },
  charging = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "driving" },
  rfsm.trans { src = "driving", tgt = "docking", events = { "e_battery_low" } },
  rfsm.trans { src = "docking", tgt = "charging", events = { "e_plugged" } },
  rfsm.trans { src = "docking", tgt = "driving",
    events = { "e_after(" .. config.docking_time .. ")" } },
  rfsm.trans { src = "charging", tgt = "driving", events = { "e_full" } },
}
