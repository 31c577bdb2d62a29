-- Composite states: what is common to several states is said once, around them.
--
--   (initial) --> off --e_power--> +- playing ------------------------------+
--                  ^               | (initial) --> radio --e_mode--> tape   |
--                  +----e_power----|                 ^---- e_mode ----+     |
--                                  +----------------------------------------+
--
-- e_power leaves `playing` from whatever is active in it; its exit runs last.
--
-- In rfsm-sim:  run()  ser("e_power")  ser("e_mode")  ser("e_power")

local rfsm = require "rfsm"

local function says(text) return function() print(text) end end

local playing = rfsm.state {
  entry = says("amplifier on"),
  exit = says("amplifier off"),

  radio = rfsm.state { entry = says("radio on"), exit = says("radio off") },
  tape = rfsm.state { entry = says("tape on"), exit = says("tape off") },

  rfsm.trans { src = "initial", tgt = "radio" },
  rfsm.trans { src = "radio", tgt = "tape", events = { "e_mode" } },
  rfsm.trans { src = "tape", tgt = "radio", events = { "e_mode" } },
}

return rfsm.state {
  off = rfsm.state {},
  playing = playing,

  rfsm.trans { src = "initial", tgt = "off" },
  rfsm.trans { src = "off", tgt = "playing", events = { "e_power" } },
  rfsm.trans { src = "playing", tgt = "off", events = { "e_power" } },
}
