-- lamp.lua
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans

local function says(text) return function() print(text) end end

return state {
  info = false, -- print no notes

  off = state { entry = says "light off" },
  on = state { entry = says "light on",
    dim = state {},
    bright = state { entry = says "full light" },
    trans { src = "initial", tgt = "dim" },
    trans { src = "dim", tgt = "bright", events = { "e_more" } },
    trans { src = "bright", tgt = "dim", events = { "e_less" } },
  },
  trans { src = "initial", tgt = "off" },
  trans { src = "off", tgt = "on", events = { "e_switch" } },
  trans { src = "on", tgt = "off", events = { "e_switch" } },
}
