-- Hello, world: one state prints "hello" in its exit, the other "world" in its entry.
--
--      initial
--         |
--         v      e_done
--     [ hello ] ---------> [ world ]
--         ^                    |
--         +----- e_restart ----+
--
-- A leaf state without a doo is done when it is entered, and sends the event e_done. So
-- the second step leaves hello.
--
-- In rfsm-sim:  step()  step()  ses("e_restart")

local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans

return state {
  hello = state {
    exit = function() print("hello") end,
  },

  world = state {
    entry = function() print("world") end,
  },

  trans { src = "initial", tgt = "hello" },
  trans { src = "hello", tgt = "world", events = { "e_done" } },
  trans { src = "world", tgt = "hello", events = { "e_restart" } },
}
