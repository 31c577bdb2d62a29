-- The next version of an order: it counts parcels, is wrapped in place of packed, and
-- waits two seconds for its payment.
--
--   received --e_paid--> picking --e_picked--> wrapping --e_packed--> shipped

local rfsm = require "rfsm"
require "rfsm_timeevent"

return rfsm.state {
  keep = { "item", "tries", "parcels" }, tries = 0, parcels = 1,

  -- Orders of the version before move by this.
  rename = { ["root.packing"] = "root.wrapping" },

  -- Redis replaces it by one that writes to a stream.
  emit = function(what, data) print("emit " .. what, data and data.item) end,

  received = rfsm.state {},
  picking = rfsm.state {
    entry = function(fsm)
      fsm.tries = fsm.tries + 1
      fsm.emit("pick", { item = fsm.item, try = fsm.tries })
    end,
  },
  waiting = rfsm.state {},
  wrapping = rfsm.state {
    entry = function(fsm)
      fsm.emit("pack", { item = fsm.item, parcels = fsm.parcels })
    end,
  },
  shipped = rfsm.state { final = true },
  cancelled = rfsm.state { final = true },

  rfsm.trans { src = "initial", tgt = "received" },
  rfsm.trans { src = "received", tgt = "picking", events = { "e_paid" } },
  rfsm.trans { src = "received", tgt = "cancelled", events = { "e_after(2)" } },
  rfsm.trans { src = "picking", tgt = "wrapping", events = { "e_picked" } },
  rfsm.trans { src = "picking", tgt = "waiting", events = { "e_empty" } },
  rfsm.trans { src = "waiting", tgt = "picking", events = { "e_after(1)" } },
  rfsm.trans { src = "wrapping", tgt = "shipped", events = { "e_packed" } },
}
