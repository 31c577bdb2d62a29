-- Hello, world: two states and the event with which a state says that it is done.
--
--   (initial) --> hello --e_done--> world
--                   ^                 |
--                   +----e_restart----+
--
-- In rfsm-sim:  step()  step()  se("e_restart")  step()

local rfsm = require "rfsm"

return rfsm.state {
  hello = rfsm.state { exit = function() print("hello") end },
  world = rfsm.state { entry = function() print("world") end },

  rfsm.trans { src = "initial", tgt = "hello" },
  rfsm.trans { src = "hello", tgt = "world", events = { "e_done" } },
  rfsm.trans { src = "world", tgt = "hello", events = { "e_restart" } },
}
