-- Transitions that lead back to their state, into it, and across its frame.
--
--   (initial) --> idle --e_start--> work{ (initial) --> warm_up --e_ready--> run }

local rfsm = require "rfsm"

local state, trans = rfsm.state, rfsm.trans

local count = 0
local function is_last() return count == 3 end

return state {
  idle = state {},
  work = state {
    entry = function() count = count + 1 end,
    warm_up = state {}, run = state {},
    trans { src = "initial", tgt = "warm_up" },
    trans { src = "warm_up", tgt = "run", events = { "e_ready" } },
    trans { src = "run", tgt = "warm_up", events = { "e_cold" } },
  },
  trans { src = "initial", tgt = "idle" },
  trans { src = "idle", tgt = "idle", events = { "e_ping" } },
  trans { src = "idle", tgt = "idle", events = { "e_config" }, guard = is_last },
  trans { src = "idle", tgt = "work", events = { "e_start" } },
  trans { src = "idle", tgt = ".work.run", events = { "e_resume" } },
  trans { src = "work", tgt = "work", events = { "e_restart" } },
  trans { src = "work", tgt = ".work.run", events = { "e_skip" } },
  trans { src = ".work.run", tgt = "idle", events = { "e_finished" } },
  trans { src = "work", tgt = "idle", events = { "e_stop" }, pn = 1 },
}
