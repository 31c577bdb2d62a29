-- Whatever it does, it comes up if there is a leak.
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans

return state {
  surface = state { entry = function() pump("out") end },
  diving = state {
    sinking = state { entry = function() pump("in") end },
    cruising = state { entry = function() propeller(0.5) end,
      exit = function() propeller(0) end },
    sampling = state { doo = function() arm_take_sample() end },
    trans { src = "initial", tgt = "sinking" },
    trans { src = "sinking", tgt = "cruising", events = { "e_depth" } },
    trans { src = "cruising", tgt = "sampling", events = { "e_sample" } },
    trans { src = "sampling", tgt = "cruising", events = { "e_done" } },
  },
  lost = state { entry = function() beacon(true) end },
  trans { src = "initial", tgt = "surface" },
  trans { src = "surface", tgt = "diving", events = { "e_dive" } },
  trans { src = "diving", tgt = "surface", events = { "e_leak", "e_up" } },
  trans { src = "diving", tgt = "lost", events = { "e_no_depth" } },
  trans { src = "lost", tgt = "surface", events = { "e_sky" } },
}
