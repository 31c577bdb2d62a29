-- Drives and looks at the same time; each part is a region.
require "rfsm_timeevent"
require "rfsm_seqand"
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans

return state {
  standing = state {},
  exploring = rfsm.seqand {
    drive = state {
      ahead = state { entry = function() wheels(1) end },
      turning = state { entry = function() wheels(0.2) end },
      trans { src = "initial", tgt = "ahead" },
      trans { src = "ahead", tgt = "turning", events = { "e_rock" } },
      trans { src = "turning", tgt = "ahead", events = { "e_free" } },
    },
    look = state {
      far = state {}, near = state {},
      trans { src = "initial", tgt = "far" },
      trans { src = "far", tgt = "near", events = { "e_after(2)" } },
      trans { src = "near", tgt = "far", events = { "e_after(1)" } },
    },
  },
  trans { src = "initial", tgt = "standing" },
  trans { src = "standing", tgt = "exploring", events = { "e_go" } },
  trans { src = "exploring", tgt = "standing", events = { "e_halt" } },
}
