-- A gripper, for a component of Orocos RTT-Lua. The chart knows nothing of RTT: events
-- come from wherever the host has them, here a port.
--
--   (initial) --> open --e_close--> closing --e_contact--> holding
--                  ^                   |                       |
--                  +----- e_open ------+------- e_open --------+
--                  +----- e_slip ------------------------------+
--
-- In rfsm-sim:  run()  ser("e_close")  ser("e_contact")  ser("e_slip")
--
-- examples/hosts/rtt_host.lua launches it in a component and drives it through ports.

local rfsm = require "rfsm"

local state, trans = rfsm.state, rfsm.trans

local function show(text) return function() print(text) end end

return state {
  open = state { entry = show("fingers open") },
  closing = state { entry = show("fingers closing") },
  holding = state { entry = show("motor holds"), exit = show("motor off") },

  trans { src = "initial", tgt = "open" },
  trans { src = "open", tgt = "closing", events = { "e_close" } },
  trans { src = "closing", tgt = "holding", events = { "e_contact" } },
  trans { src = "closing", tgt = "open", events = { "e_open" } },
  trans { src = "holding", tgt = "open", events = { "e_open", "e_slip" } },
}
