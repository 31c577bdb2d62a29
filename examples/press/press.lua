-- A robot that loads a press: horn, move, see, grip. A door, a stop and heat stop it.
-- press_properties.lua has what an engineer says of it, one sentence each.
local rfsm = require "rfsm"
require "rfsm_timeevent"
local state, trans = rfsm.state, rfsm.trans

return state {
  closed = state { -- the door is closed
    off = state {},
    homing = state {},
    on = state {
      ready = state {},
      horn = state {},
      moving = state {},
      seen = state {},
      gripping = state {},
      asked = state {}, -- for a report, which the host gives
      trans { src = "initial", tgt = "ready" },
      trans { src = "ready", tgt = "horn", events = { "e_start" } },
      trans { src = "horn", tgt = "moving", events = { "e_after(1)" } },
      trans { src = "moving", tgt = "seen", events = { "e_part" } },
      trans { src = "seen", tgt = "gripping", events = { "e_grip" } },
      trans { src = "gripping", tgt = "ready", events = { "e_release" } },
      trans { src = "ready", tgt = "asked", events = { "e_request" } },
      trans { src = "asked", tgt = "ready", events = { "e_reported" } },
    },
    braking = state {},
    stopped = state {},
    trans { src = "initial", tgt = "off" },
    trans { src = "off", tgt = "homing", events = { "e_power" } },
    trans { src = "homing", tgt = "homing", events = { "e_after(3)" } },
    trans { src = "homing", tgt = "on", events = { "e_homed" } },
    trans { src = "on", tgt = "braking", events = { "e_stop" } },
    trans { src = "on", tgt = "braking", events = { rfsm.named "e_heat" },
      guard = function(_, _, event) return event.celsius > 80 end },
    trans { src = "braking", tgt = "stopped", events = { "e_after(0.4)" } },
    trans { src = "stopped", tgt = "on", events = { "e_reset" } },
  },
  open = state {},
  trans { src = "initial", tgt = "closed" },
  trans { src = "closed", tgt = "open", events = { "e_open" } },
  trans { src = "open", tgt = "closed", events = { "e_close" } },
  trans { src = "closed", tgt = "closed", events = { "e_power_off" } }, -- to `off`
}
