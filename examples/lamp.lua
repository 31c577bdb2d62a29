-- lamp.lua
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans

local function says(text) return function() print(text) end end

return state {
  info = false, -- print no notes

  off = state { entry = says "off" },
  on = state {
    entry = says "power on", exit = says "power off",
    idle = state {},
    moving = state { entry = says "motor starts", exit = says "motor stops" },
    trans { src = "initial", tgt = "idle" },
    trans { src = "idle", tgt = "moving", events = { "e_go" } },
    trans { src = "moving", tgt = "idle", events = { "e_halt" } },
  },
  trans { src = "initial", tgt = "off" },
  trans { src = "off", tgt = "on", events = { "e_switch" } },
  trans { src = "on", tgt = "off", events = { "e_switch" } },
}
