-- A program with a machine for the windows and one for the lamps.
local rfsm = require "rfsm"

local function toggle(on, off)
  return rfsm.init(rfsm.state {
    off = rfsm.state {}, on = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "off" },
    rfsm.trans { src = "off", tgt = "on", events = { on } },
    rfsm.trans { src = "on", tgt = "off", events = { off } },
  })
end

local windows = toggle("e_warm", "e_cold")
local lamps = toggle("e_dark", "e_bright")

while true do
  rfsm.step(windows)
  rfsm.step(lamps)
  os.execute("sleep 0.5")
end
