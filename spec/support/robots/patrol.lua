-- YARP: a program that goes round, and runs its machine itself.
require "yarp"
require "rfsm_timeevent"
local rfsm = require "rfsm"

yarp.Network()
local base = yarp.Port()
base:open("/patrol/base:o")

local function go_to(place)
  return function()
    local bottle = yarp.Bottle()
    bottle:addString(place)
    base:write(bottle)
  end
end

fsm = rfsm.init(rfsm.state {
  kitchen = rfsm.state { entry = go_to("kitchen") },
  hall = rfsm.state { entry = go_to("hall") },
  lab = rfsm.state { entry = go_to("lab") },
  stuck = rfsm.state { entry = function() print "help" end },
  rfsm.trans { src = "initial", tgt = "hall" },
  rfsm.trans { src = "hall", tgt = "kitchen", events = { "e_arrived" } },
  rfsm.trans { src = "kitchen", tgt = "lab", events = { "e_arrived" } },
  rfsm.trans { src = "lab", tgt = "hall", events = { "e_arrived" } },
  rfsm.trans { src = "hall", tgt = "stuck", events = { "e_after(120)" } },
  rfsm.trans { src = "stuck", tgt = "hall", events = { "e_freed" } },
})

while true do
  rfsm.run(fsm)
  yarp.Time_delay(0.1)
end
