-- Priorities: the order of several enabled transitions.
--
--   +- work ------------------------+
--   | (initial) --> a --e_go--> b   |   inside, pn 0 and pn 5
--   |               +--e_go--> c    |   the larger pn wins: c
--   +---------------|---------------+
--                   +--e_stop--> halted      e_stop is also wanted inside, with
--                                            pn 99: the outer one wins all the same
--
-- In rfsm-sim:  run()  ser("e_go")  ser("e_back")  ser("e_stop")

local rfsm = require "rfsm"

local function says(text) return function() print(text) end end

local work = rfsm.state {
  a = rfsm.state { entry = says("a") },
  b = rfsm.state { entry = says("b"),
    checks = { unreachable = "both transitions to it lose: that is to be shown" } },
  c = rfsm.state { entry = says("c") },

  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_go" },
    checks = { shadowed = "the larger pn below wins: that is to be shown" } },
  rfsm.trans { src = "a", tgt = "c", events = { "e_go" }, pn = 5 },
  rfsm.trans { src = "c", tgt = "a", events = { "e_back" } },
  rfsm.trans { src = "a", tgt = "b", events = { "e_stop" }, pn = 99,
    checks = { shadowed = "the outer transition wins: that is to be shown" } },
}

return rfsm.state {
  work = work,
  halted = rfsm.state { entry = says("halted"), final = true },

  rfsm.trans { src = "initial", tgt = "work" },
  rfsm.trans { src = "work", tgt = "halted", events = { "e_stop" } },
}
