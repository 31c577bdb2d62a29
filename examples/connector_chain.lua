-- A chain of connectors: one transition in several segments, each with its own effect.
-- The path is taken only if each segment is enabled.
--
--   cold --e_start--> (checked) --[fuel]--> (primed) --> running
--
-- In rfsm-sim:  run()  ser("e_start")   -- no fuel: nothing happens
--               tank.fuel = 1
--               ser("e_start")          -- all three segments

-- luacheck: globals tank

local rfsm = require "rfsm"

tank = { fuel = 0 } -- global, so that you can fill it

return rfsm.state {
  cold = rfsm.state {},
  running = rfsm.state { entry = function() print("engine running") end, final = true },
  checked = rfsm.conn {},
  primed = rfsm.conn {},

  rfsm.trans { src = "initial", tgt = "cold" },
  rfsm.trans {
    src = "cold", tgt = "checked", events = { "e_start" },
    effect = function() print("oil checked") end,
  },
  rfsm.trans {
    src = "checked", tgt = "primed", guard = function() return tank.fuel > 0 end,
    effect = function() print("pump primed") end,
  },
  rfsm.trans {
    src = "primed", tgt = "running", effect = function() print("ignition") end,
  },
}
