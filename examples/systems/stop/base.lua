-- The base drives until it has to halt.

local rfsm = require "rfsm"

return rfsm.state {
  info = false,

  driving = rfsm.state {},
  halted = rfsm.state { final = true,
    entry = function(fsm) fsm.emit "e_base_halted" end },

  rfsm.trans { src = "initial", tgt = "driving" },
  rfsm.trans { src = "driving", tgt = "halted", events = { "e_halt_base" } },
}
