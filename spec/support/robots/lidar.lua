-- Starts a sensor; guards ask the device, which is polled.
local rfsm = require "rfsm"

local function is_warm() return device:temperature() > 30 end

return rfsm.state {
  off = rfsm.state {},
  warming = rfsm.state { doo = function() while true do rfsm.yield(true) end end },
  scanning = rfsm.state { entry = function() device:start() end },
  rfsm.trans { src = "initial", tgt = "off" },
  rfsm.trans { src = "off", tgt = "warming", events = { "e_on" } },
  rfsm.trans { src = "warming", tgt = "scanning", guard = is_warm },
  rfsm.trans { src = "warming", tgt = "off", events = { "e_off" } },
  rfsm.trans { src = "scanning", tgt = "off", events = { "e_off" } },
}
