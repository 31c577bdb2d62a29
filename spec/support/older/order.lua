-- open --e_pay--> paid --e_ship or an hour--> late; paid emits, and keeps a number
local rfsm = require "rfsm"
return rfsm.state {
  keep = { "n", "item" }, n = 0, item = "",
  open = rfsm.state {},
  paid = rfsm.state { entry = function(fsm)
    fsm.n = fsm.n + 1
    fsm.emit("pick", { item = fsm.item, n = fsm.n })
  end },
  late = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "open" },
  rfsm.trans { src = "open", tgt = "paid", events = { "e_pay" } },
  rfsm.trans { src = "paid", tgt = "open", events = { "e_ship" } },
  rfsm.trans { src = "paid", tgt = "late", events = { "e_after(3600)" } },
  rfsm.trans { src = "late", tgt = "open", events = { "e_ship" } },
}
