-- Cleans a floor line by line; the doos yield while the robot moves.
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans

local function drive(distance)
  return function()
    wheels.start(distance)
    while not wheels.arrived() do rfsm.yield(true) end
  end
end

return state {
  cleaning = state {
    ahead = state { doo = drive(3) },
    aside = state { doo = drive(0.3) },
    trans { src = "initial", tgt = "ahead" },
    trans { src = "ahead", tgt = "aside", events = { "e_done", "e_wall" } },
    trans { src = "aside", tgt = "ahead", events = { "e_done" } },
  },
  lifted = state { entry = function() wheels.stop() end },
  empty = state { entry = function() beep() end },
  trans { src = "initial", tgt = "cleaning" },
  trans { src = "cleaning", tgt = "lifted", events = { "e_lifted" } },
  trans { src = "lifted", tgt = "cleaning", events = { "e_on_floor" } },
  trans { src = "cleaning", tgt = "empty", events = { "e_bag_full" } },
  trans { src = "empty", tgt = "cleaning", events = { "e_bag_changed" } },
}
