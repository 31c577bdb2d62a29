-- Time events: a pedestrian light. The timer of a composite runs across its inner
-- transitions.
--
--   (initial) --> lights --e_short, e_after(60)--> dark --e_after(2)--> lights
--
--   lights: (initial) --> stop --e_button--> wait --e_after(0.2)--> walk
--                          ^                                         |
--                          +------------- after walk_seconds --------+
--
-- Once a minute the lights go dark for two seconds.
--
-- In rfsm-sim:  run()  ser("e_button")  and then  run()  again and again. The clock is
-- the best one that is installed (luaposix, luasocket, ...).

local rfsm = require "rfsm"
local rfsm_timeevent = require "rfsm_timeevent"

local state, trans = rfsm.state, rfsm.trans
local e_after = rfsm_timeevent.e_after

local walk_seconds = 0.5

local function show(text) return function() print(text) end end

return state {
  lights = state {
    stop = state { entry = show("do not walk") },
    wait = state { entry = show("please wait") },
    walk = state { entry = show("walk") },

    trans { src = "initial", tgt = "stop" },
    trans { src = "stop", tgt = "wait", events = { "e_button" } },
    trans { src = "wait", tgt = "walk", events = { "e_after(0.2)" } },
    -- a function is asked at each entry
    trans { src = "walk", tgt = "stop",
      events = { e_after(function() return walk_seconds end, "walk_seconds") } },
  },

  dark = state { entry = show("dark") },

  trans { src = "initial", tgt = "lights" },
  trans { src = "lights", tgt = "dark", events = { "e_short", "e_after(60)" } },
  trans { src = "dark", tgt = "lights", events = { "e_after(2)" } },
}
