-- Counts boxes; a full pallet is taken away.
local rfsm = require "rfsm"

local function is_full(tr) return tr.src.count >= 12 end

return rfsm.state {
  loading = rfsm.state {
    count = 0,
    entry = function(fsm) fsm.loading.count = 0 end,
  },
  leaving = rfsm.state { doo = function() belt.run(3.5) end },
  rfsm.trans { src = "initial", tgt = "loading" },
  rfsm.trans { src = "loading", tgt = "leaving", events = { "e_box" }, guard = is_full,
    pn = 1 },
  rfsm.trans { src = "loading", tgt = "internal", events = { "e_box" },
    effect = function(fsm) fsm.loading.count = fsm.loading.count + 1 end },
  rfsm.trans { src = "leaving", tgt = "loading", events = { "e_done" } },
}
