-- Deriving: load a base machine and change a part of it. Each rfsm.load returns a
-- model of its own, so the base does not change.
--
--   the base, examples/on_off.lua:  off --e_push--> on --e_push--> off
--   here: a third state, `dimmed`, between on and off
--
-- In rfsm-sim:  run()  ser("e_push")  ser("e_push")  ser("e_push")

local rfsm = require "rfsm"

local file = ... or "" -- the name of this one
local here = file:match("^(.*[/\\])") or ""
local lamp = rfsm.load(here .. "on_off.lua")

lamp.dimmed = rfsm.state { entry = function() print("dimmed") end }
lamp.on.entry = function() print("brighter than ever") end
lamp[3].tgt = "dimmed" -- on --e_push--> dimmed instead of off
lamp[4] = rfsm.trans { src = "dimmed", tgt = "off", events = { "e_push" } }

return lamp
