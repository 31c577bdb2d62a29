-- A connector decides where a load goes.
local rfsm = require "rfsm"

local function is_heavy() return scale.kilograms() > 900 end

return rfsm.state {
  waiting = rfsm.state {}, heavy = rfsm.state {}, light = rfsm.state {},
  sort = rfsm.conn {},
  rfsm.trans { src = "initial", tgt = "waiting" },
  rfsm.trans { src = "waiting", tgt = "sort", events = { "e_load" } },
  rfsm.trans { src = "sort", tgt = "heavy", guard = is_heavy, pn = 1 },
  rfsm.trans { src = "sort", tgt = "light" },
  rfsm.trans { src = "heavy", tgt = "waiting", events = { "e_put_down" } },
  rfsm.trans { src = "light", tgt = "waiting", events = { "e_put_down" } },
}
