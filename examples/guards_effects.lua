-- Guards and effects: a guard decides if a transition may be taken, an effect runs when
-- it is taken. A turnstile that counts coins.
--
--             +--e_coin / count--+
--             v                  |
--   (initial) --> locked --------+
--                  ^  |
--                  |  +--e_push [enough coins] / pay--> open
--                  +----------------e_done----------------+
--
-- In rfsm-sim:  run()  ser("e_push")  ser("e_coin")  ser("e_coin")  ser("e_push")

local rfsm = require "rfsm"

local PRICE = 2
local paid = 0

return rfsm.state {
  entry = function() paid = 0 end,

  locked = rfsm.state {},
  open = rfsm.state { entry = function() print("please pass") end },

  rfsm.trans { src = "initial", tgt = "locked" },
  rfsm.trans {
    src = "locked", tgt = "locked", events = { "e_coin" },
    effect = function()
      paid = paid + 1
      print("paid " .. paid)
    end,
  },
  rfsm.trans {
    src = "locked", tgt = "open", events = { "e_push" },
    guard = function() return paid >= PRICE end,
    effect = function() paid = paid - PRICE end,
  },
  rfsm.trans { src = "open", tgt = "locked", events = { "e_done" } },
}
