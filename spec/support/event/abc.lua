-- a --e_coin{..}--> b --e_cancel--> a --e_stop--> c
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans

return state { info = false,
  a = state {}, b = state {}, c = state { final = true },
  trans { src = "initial", tgt = "a" },
  trans { src = "a", tgt = "b", events = { rfsm.named "e_coin" } },
  trans { src = "b", tgt = "a", events = { "e_cancel" } },
  trans { src = "a", tgt = "c", events = { "e_stop" } },
}
