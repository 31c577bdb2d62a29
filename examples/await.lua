-- Await: a robot starts when all its parts are ready, in any order, or at e_force.
--
--   (initial) --> booting --await(e_arm, e_base, e_camera), e_force--> ready
--                    ^                                                   |
--                    +---------------------- e_reboot -------------------+
--
-- In rfsm-sim:  run()  ser("e_camera")  ser("e_arm")  ser("e_base")  ser("e_reboot")

local rfsm = require "rfsm"
require "rfsm.await"

return rfsm.state {
  booting = rfsm.state { entry = function() print("booting") end },
  ready = rfsm.state { entry = function() print("ready") end },

  rfsm.trans { src = "initial", tgt = "booting" },
  rfsm.trans { src = "booting", tgt = "ready",
    events = { "await(e_arm, e_base, e_camera)", "e_force" } },
  rfsm.trans { src = "ready", tgt = "booting", events = { "e_reboot" } },
}
