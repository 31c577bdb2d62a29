-- Receives two items, and confirms each. It takes one event an iteration.

local rfsm = require "rfsm"

local function confirm(fsm) fsm.emit "e_received" end

return rfsm.state {
  info = false,
  read = "one",

  empty = rfsm.state {},
  half = rfsm.state { entry = confirm },
  full = rfsm.state { final = true, entry = confirm },

  rfsm.trans { src = "initial", tgt = "empty" },
  rfsm.trans { src = "empty", tgt = "half", events = { "e_item" } },
  rfsm.trans { src = "half", tgt = "full", events = { "e_item" } },
}
