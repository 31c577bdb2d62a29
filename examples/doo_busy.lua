-- A busy doo: rfsm.yield() without a true value means that there is more to do, so
-- run() goes on with it. Events are handled between two cycles.
--
--   (initial) --> counting --e_done--> zero
--                    |
--                    +--e_abort--> aborted
--
-- In rfsm-sim:  step()  step()  se("e_abort")  step()    or just  run()

local rfsm = require "rfsm"

return rfsm.state {
  counting = rfsm.state {
    doo = function()
      for i = 3, 1, -1 do
        print(i)
        rfsm.yield()
      end
    end,
  },
  zero = rfsm.state { entry = function() print("lift off") end, final = true },
  aborted = rfsm.state { entry = function() print("aborted") end, final = true },

  rfsm.trans { src = "initial", tgt = "counting" },
  rfsm.trans { src = "counting", tgt = "zero", events = { "e_done" } },
  rfsm.trans { src = "counting", tgt = "aborted", events = { "e_abort" } },
}
