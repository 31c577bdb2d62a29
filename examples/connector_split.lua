-- A connector that splits: guards decide at one point where several paths lead.
--
--                              +--[small]--> shelf_a
--   waiting --e_parcel--> (sort)
--      ^                       +--(otherwise, lower pn)--> shelf_b
--      +---------e_done---------------------- both shelves
--
-- In rfsm-sim:  run()  parcel = { kg = 1 } ser("e_parcel")  parcel = { kg = 30 }
--               ser("e_parcel")

-- luacheck: globals parcel

local rfsm = require "rfsm"

parcel = { kg = 1 } -- global, so that you can weigh in

local function says(text) return function() print(text) end end

return rfsm.state {
  waiting = rfsm.state {},
  shelf_a = rfsm.state { entry = says("to shelf a") },
  shelf_b = rfsm.state { entry = says("to shelf b") },
  sort = rfsm.conn {},

  rfsm.trans { src = "initial", tgt = "waiting" },
  rfsm.trans { src = "waiting", tgt = "sort", events = { "e_parcel" } },
  rfsm.trans {
    src = "sort", tgt = "shelf_a", pn = 1, guard = function() return parcel.kg < 10 end,
  },
  rfsm.trans { src = "sort", tgt = "shelf_b" },
  rfsm.trans { src = "shelf_a", tgt = "waiting", events = { "e_done" } },
  rfsm.trans { src = "shelf_b", tgt = "waiting", events = { "e_done" } },
}
