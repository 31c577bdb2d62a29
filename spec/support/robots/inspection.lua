-- Looks at bottles. Nothing leads to a state that somebody meant to use.
local rfsm = require "rfsm"

return rfsm.state {
  waiting = rfsm.state {},
  lighting = rfsm.state { entry = function() lamp:on() end },
  photo = rfsm.state { entry = function() camera:grab() end },
  rejecting = rfsm.state { doo = function() flap.kick() end }, -- MISTAKE
  rfsm.trans { src = "initial", tgt = "waiting" },
  rfsm.trans { src = "waiting", tgt = "lighting", events = { "e_bottle" } },
  rfsm.trans { src = "lighting", tgt = "photo", events = { "e_light" } },
  rfsm.trans { src = "photo", tgt = "waiting", events = { "e_good", "e_bad" } },
  rfsm.trans { src = "rejecting", tgt = "waiting", events = { "e_done" } },
}
