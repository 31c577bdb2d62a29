-- A guard: patrols, sees the thief, hunts him, looks where he was last seen, and comes
-- back to the leg of the round that he had left. `fsm.goal` is where he goes.

local rfsm = require "rfsm"
require "rfsm_timeevent"
require "rfsm.history"

local function go_to(goal)
  return rfsm.state {
    doc = "to the " .. goal, entry = function(fsm) fsm.goal = goal end,
  }
end

return rfsm.state {
  info = false,
  patrol = rfsm.state {
    history = "shallow",
    north = go_to "north", east = go_to "east", west = go_to "west",
    rfsm.trans { src = "initial", tgt = "north" },
    rfsm.trans { src = "north", tgt = "east", events = { "e_there" } },
    rfsm.trans { src = "east", tgt = "west", events = { "e_there" } },
    rfsm.trans { src = "west", tgt = "north", events = { "e_there" } },
  },
  hunt = go_to "thief", search = go_to "trace",
  rfsm.trans { src = "initial", tgt = "patrol" },
  rfsm.trans { src = "patrol", tgt = "hunt", events = { "e_seen" } },
  rfsm.trans { src = "hunt", tgt = "search", events = { "e_lost" } },
  rfsm.trans { src = "search", tgt = "hunt", events = { "e_seen" } },
  rfsm.trans { src = "search", tgt = "patrol", events = { "e_after(1)" } },
}
