-- Preview: the gripper warms up while an object is near, before it is asked to grasp.
--
--   (initial) --> searching --e_grasp--> grasping --e_release--> searching
--
-- In rfsm-sim:  run()  world.distance = 0.1  run()  ser("e_grasp")

-- luacheck: globals world

local rfsm = require "rfsm"
require "rfsm.preview"

world = { distance = 2 } -- global, so that you can change it

return rfsm.state {
  searching = rfsm.state { entry = function() print("searching") end },
  grasping = rfsm.state {
    prepare = function() print("gripper warms up") end,
    entry = function() print("grasping") end,
  },

  rfsm.trans { src = "initial", tgt = "searching" },
  rfsm.trans { src = "searching", tgt = "grasping", events = { "e_grasp" },
    likely = function() return world.distance < 0.5 end },
  rfsm.trans { src = "grasping", tgt = "searching", events = { "e_release" } },
}
