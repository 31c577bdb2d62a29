-- Attaches cups. A loop in a doo does not yield.
local rfsm = require "rfsm"

return rfsm.state {
  waiting = rfsm.state {},
  attaching = rfsm.state { doo = function()
    while true do -- MISTAKE
      local x, y = math.random(), math.random()
      if x > y then print(x, y) end
    end
  end },
  milking = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "waiting" },
  rfsm.trans { src = "waiting", tgt = "attaching", events = { "e_cow" } },
  rfsm.trans { src = "attaching", tgt = "milking", events = { "e_attached" } },
  rfsm.trans { src = "milking", tgt = "waiting", events = { "e_empty" } },
}
