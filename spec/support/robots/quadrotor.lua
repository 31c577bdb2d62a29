-- Takes off, hovers, flies, lands; an empty battery lands it, too.
require "rfsm_timeevent"
local rfsm = require "rfsm"

return rfsm.state {
  ground = rfsm.state { entry = function() motors(0) end },
  flying = rfsm.state {
    rising = rfsm.state { entry = function() motors(0.7) end },
    hovering = rfsm.state { entry = function() hold_position() end },
    mission = rfsm.state { doo = function()
      for _, point in ipairs(waypoints) do
        fly_to(point)
        rfsm.yield()
      end
    end },
    rfsm.trans { src = "initial", tgt = "rising" },
    rfsm.trans { src = "rising", tgt = "hovering",
      events = { "e_altitude", "e_after(10)" } },
    rfsm.trans { src = "hovering", tgt = "mission", events = { "e_mission" } },
    rfsm.trans { src = "mission", tgt = "hovering", events = { "e_done", "e_hold" } },
  },
  landing = rfsm.state { entry = function() motors(0.3) end },
  crashed = rfsm.state { final = true, entry = function() motors(0) end },
  rfsm.trans { src = "initial", tgt = "ground" },
  rfsm.trans { src = "ground", tgt = "flying", events = { "e_take_off" } },
  rfsm.trans { src = "flying", tgt = "landing",
    events = { "e_land", "e_battery_empty" } },
  rfsm.trans { src = "landing", tgt = "ground", events = { "e_touch_down" } },
  rfsm.trans { src = "flying", tgt = "crashed", events = { "e_no_attitude" } },
}
