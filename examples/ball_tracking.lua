-- A robot that follows a ball with its head: the coordination of three components
-- (camera, estimator, head controller), which here only print.
--
--   (initial) --> setup --e_done--> +- operational -------------------------+
--                   |               | (initial) --> searching               |
--        e_setup_failed             |     ^ e_lost   | e_ball               |
--                   v               |     +-- tracking <--+                 |
--                 fatal             +--|------------------------------------+
--                                      +--e_stop--> stopped --e_start--> operational
--
-- In rfsm-sim:  run()  ser("e_ball")  ser("e_lost")  ser("e_ball")  ser("e_stop")

local rfsm = require "rfsm"

local function says(text) return function() print(text) end end

local searching = rfsm.state {
  entry = says("head: sweep"),
  exit = says("head: stop sweeping"),
}

-- One control cycle per call: predict where the ball will be and turn the head there.
local tracking = rfsm.state {
  entry = says("estimator: start"),
  doo = function()
    while true do
      print("head: follow")
      rfsm.yield(true)
    end
  end,
  exit = says("estimator: stop"),
}

local operational = rfsm.state {
  entry = says("camera: on"),
  exit = says("camera: off"),

  searching = searching,
  tracking = tracking,

  rfsm.trans { src = "initial", tgt = "searching" },
  rfsm.trans { src = "searching", tgt = "tracking", events = { "e_ball" } },
  rfsm.trans { src = "tracking", tgt = "searching", events = { "e_lost" } },
}

return rfsm.state {
  setup = rfsm.state { entry = says("components: configured") },
  operational = operational,
  stopped = rfsm.state { entry = says("head: park") },
  fatal = rfsm.state { entry = says("operator: please help") },

  rfsm.trans { src = "initial", tgt = "setup" },
  rfsm.trans { src = "setup", tgt = "operational", events = { "e_done" } },
  rfsm.trans { src = "setup", tgt = "fatal", events = { "e_setup_failed" }, pn = 1 },
  rfsm.trans { src = "operational", tgt = "stopped", events = { "e_stop" } },
  rfsm.trans { src = "stopped", tgt = "operational", events = { "e_start" } },
}
