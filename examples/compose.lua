-- Composition: a chart in a file of its own becomes a state of another one, twice.
--
--   (initial) --> hall --e_next--> kitchen
--   both are examples/on_off.lua
--
-- The file is found beside this one, because rfsm.load passes the file name.
--
-- In rfsm-sim:  run()  ser("e_push")  ser("e_next")  ser("e_push")

local rfsm = require "rfsm"

local file = ... or "" -- the name of this one
local here = file:match("^(.*[/\\])") or ""
local lamp = rfsm.load(here .. "on_off.lua")

return rfsm.state {
  hall = lamp,
  kitchen = lamp,

  rfsm.trans { src = "initial", tgt = "hall" },
  rfsm.trans { src = "hall", tgt = "kitchen", events = { "e_next" } },
  rfsm.trans { src = "kitchen", tgt = "hall", events = { "e_next" } },
}
