-- A machine that sells drinks, for coins of different value.
local rfsm = require "rfsm"
require "rfsm_timeevent"
local state, trans, named = rfsm.state, rfsm.trans, rfsm.named

local PRICES = { cola = 150, water = 100 }

local function add(fsm, _, _, _, event) fsm.paid = fsm.paid + event.cents end

local function is_paid(tr, _, event)
  local price = PRICES[event.drink]
  return price ~= nil and tr._fsm.paid >= price
end

return state { info = false, read = "one", keep = { "paid" }, paid = 0,
  idle = state { entry = function(fsm) fsm.paid = 0 end },
  paying = state {}, delivering = state {}, out_of_order = state { final = true },
  trans { src = "initial", tgt = "idle" },
  trans { src = "idle", tgt = "paying", events = { named "e_coin" }, effect = add },
  trans { src = "paying", tgt = "internal", events = { named "e_coin" },
    effect = add },
  trans { src = "paying", tgt = "delivering", events = { named "e_choose" },
    guard = is_paid },
  trans { src = "paying", tgt = "idle", events = { "e_cancel", "e_after(30)" } },
  trans { src = "delivering", tgt = "idle", events = { "e_dropped" } },
  trans { src = "delivering", tgt = "out_of_order", events = { "e_after(5)" } },
}
