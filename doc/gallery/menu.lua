-- One state from which fourteen others are chosen.
--
--   (initial) --> menu --e_N--> task N --e_done--> menu

local rfsm = require "rfsm"

local TASKS = 14

local menu = rfsm.state {
  menu = rfsm.state {}, rfsm.trans { src = "initial", tgt = "menu" },
}

for i = 1, TASKS do
  menu["task " .. i] = rfsm.state {}
  menu[#menu + 1] = rfsm.trans { src = "menu", tgt = "task " .. i,
    events = { "e_" .. i } }
  menu[#menu + 1] = rfsm.trans { src = "task " .. i, tgt = "menu",
    events = { "e_done" } }
end

return menu
