-- Event memory: a door that locks after the third wrong code.
--
--   (initial) --> closed --e_wrong [3 of them]--> locked --e_reset--> closed
--                   ^  |
--                   |  +--e_right--> open
--                   +----e_close------+
--
-- The count belongs to closed and begins anew on each entry. In rfsm-sim:
--   run()  then three times  ser("e_wrong")  then  ser("e_reset")  ser("e_right")

local rfsm = require "rfsm"
require "rfsm.emem"

local function say(text) return function() print(text) end end

local function is_third(tr) return tr.src.emem.e_wrong >= 3 end

return rfsm.state {
  closed = rfsm.state { entry = say("closed") },
  open = rfsm.state { entry = say("open") },
  locked = rfsm.state { entry = say("locked") },

  rfsm.trans { src = "initial", tgt = "closed" },
  rfsm.trans { src = "closed", tgt = "locked", events = { "e_wrong" },
    guard = is_third },
  rfsm.trans { src = "closed", tgt = "open", events = { "e_right" } },
  rfsm.trans { src = "open", tgt = "closed", events = { "e_close" } },
  rfsm.trans { src = "locked", tgt = "closed", events = { "e_reset" } },
}
