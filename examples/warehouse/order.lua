-- An order in a warehouse: what is to be done outside it emits, for workers to do.
--
--   received --e_paid--> picking --e_picked--> packing --e_packed--> shipped
--
-- Nobody pays for three seconds: cancelled. A picker may find a shelf empty: the order
-- waits for the goods, and asks again each second.

local rfsm = require "rfsm"
require "rfsm_timeevent"

return rfsm.state {
  keep = { "item", "tries" }, tries = 0,

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
  packing = rfsm.state {
    entry = function(fsm) fsm.emit("pack", { item = fsm.item }) end,
  },
  shipped = rfsm.state { final = true },
  cancelled = rfsm.state { final = true },

  rfsm.trans { src = "initial", tgt = "received" },
  rfsm.trans { src = "received", tgt = "picking", events = { "e_paid" } },
  rfsm.trans { src = "received", tgt = "cancelled", events = { "e_after(3)" } },
  rfsm.trans { src = "picking", tgt = "packing", events = { "e_picked" } },
  rfsm.trans { src = "picking", tgt = "waiting", events = { "e_empty" } },
  rfsm.trans { src = "waiting", tgt = "picking", events = { "e_after(1)" } },
  rfsm.trans { src = "packing", tgt = "shipped", events = { "e_packed" } },
}
