-- A sequential AND state: two arms at work side by side, advanced one after the other.
--
--   (initial) --> working --e_stop--> stopped --e_start--> working
--
--   working: left | right, each
--            (initial) --> open --e_grasp--> closed --e_open--> open
--
-- Events go to both arms, except the one that makes working leave; each entry begins
-- anew. In rfsm-sim:  run()  ser("e_grasp")  run()  ser("e_stop")  ser("e_start")

local rfsm = require "rfsm"

local state, trans = rfsm.state, rfsm.trans

local function arm(name)
  local function say(text) return function() print(name .. " " .. text) end end
  return state {
    open = state { entry = say("open") },
    closed = state { entry = say("closed"), exit = say("lets go") },

    trans { src = "initial", tgt = "open" },
    trans { src = "open", tgt = "closed", events = { "e_grasp" } },
    trans { src = "closed", tgt = "open", events = { "e_open" } },
  }
end

return state {
  working = rfsm.seqand {
    order = { "right" }, -- then the others by name
    idle_doo = "auto", -- run() goes on until both arms are idle
    left = arm("left"),
    right = arm("right"),
  },
  stopped = state { entry = function() print("stopped") end },

  trans { src = "initial", tgt = "working" },
  trans { src = "working", tgt = "stopped", events = { "e_stop" } },
  trans { src = "stopped", tgt = "working", events = { "e_start" } },
}
