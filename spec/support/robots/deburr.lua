-- Orocos: a component with this chart moves a tool along an edge.
require "rttlib"
local rfsm = require "rfsm"

local tc = rtt.getTC()
local setpoint = rtt.OutputPort("double")
tc:addPort(setpoint, "setpoint", "velocity of the tool")

return rfsm.state {
  dbg = false,
  configuring = rfsm.state {
    doo = function()
      tc:getPeer("Controller"):configure()
    end,
  },
  running = rfsm.state {
    approach = rfsm.state { entry = function() setpoint:write(0.1) end },
    contact = rfsm.state { entry = function() setpoint:write(0.02) end },
    rfsm.trans { src = "initial", tgt = "approach" },
    rfsm.trans { src = "approach", tgt = "contact", events = { "e_contact" } },
    rfsm.trans { src = "contact", tgt = "approach", events = { "e_lost_contact" } },
  },
  stopped = rfsm.state { entry = function() setpoint:write(0) end },
  rfsm.trans { src = "initial", tgt = "configuring" },
  rfsm.trans { src = "configuring", tgt = "stopped", events = { "e_done" } },
  rfsm.trans { src = "stopped", tgt = "running", events = { "e_start" } },
  rfsm.trans { src = "running", tgt = "stopped", events = { "e_stop" } },
}
