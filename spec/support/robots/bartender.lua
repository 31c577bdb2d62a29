-- Mixes what was ordered: a chart that is made of data, in a loop.
local rfsm = require "rfsm"

local STEPS = { "glass", "ice", "gin", "tonic", "stir" }

local mixer = { ready = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "ready" },
  rfsm.trans { src = "ready", tgt = STEPS[1], events = { "e_order" } },
}
for i, step in ipairs(STEPS) do
  mixer[step] = rfsm.state { doo = function() bar.perform(step) end }
  mixer[#mixer + 1] = rfsm.trans { src = step, tgt = STEPS[i + 1] or "ready",
    events = { "e_done" } }
  mixer[#mixer + 1] = rfsm.trans { src = step, tgt = "ready", events = { "e_cancel" } }
end

return rfsm.state(mixer)
