-- Sends two items, and waits until both were received. It takes one event an iteration.

local rfsm = require "rfsm"

local function send_both(fsm)
  fsm.emit "e_item"
  fsm.emit "e_item"
end

return rfsm.state {
  info = false,
  read = "one",

  sending = rfsm.state { entry = send_both },
  half = rfsm.state {},
  sent = rfsm.state { final = true },

  rfsm.trans { src = "initial", tgt = "sending" },
  rfsm.trans { src = "sending", tgt = "half", events = { "e_received" } },
  rfsm.trans { src = "half", tgt = "sent", events = { "e_received" } },
}
