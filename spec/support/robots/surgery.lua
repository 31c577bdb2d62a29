-- A holder for a camera: states inherit what they do from a base.
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans

local held = state {
  entry = function() brake(true) end,
  exit = function() brake(false) end,
}

return state {
  locked = held:new {},
  moving = state {
    by_hand = state {}, by_voice = state {},
    trans { src = "initial", tgt = "by_hand" },
    trans { src = "by_hand", tgt = "by_voice", events = { "e_voice" } },
    trans { src = "by_voice", tgt = "by_hand", events = { "e_button" } },
  },
  parked = held:new { doc = "far from the table" },
  trans { src = "initial", tgt = "parked" },
  trans { src = "parked", tgt = "moving", events = { "e_button" } },
  trans { src = "moving", tgt = "locked", events = { "e_released" } },
  trans { src = "locked", tgt = "moving", events = { "e_button" } },
  trans { src = "locked", tgt = "parked", events = { "e_park" } },
}
