-- What an engineer says of the press: `rfsm check examples/press/press.lua` judges it.
local checks = require "rfsm_checks"
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans
local never, always, after = checks.never, checks.always, checks.after
local from, precedes, at_most = checks.from, checks.precedes, checks.at_most

local on = "root.closed.on"
local moving, gripping, ready = on .. ".moving", on .. ".gripping", on .. ".ready"

local function is_still(active)
  return active "root.open" or active "root.closed.off" or active "root.closed.homing"
    or active "root.closed.stopped"
end

-- free --asked--> asked --asked again--> bad; an answer, or leaving `on`, sets free.
local answered = state {
  free = state {}, asked = state {}, bad = state {},
  trans { src = "initial", tgt = "free" },
  trans { src = "free", tgt = "asked", events = { "entry " .. on .. ".asked" } },
  trans { src = "asked", tgt = "free", events = { "e_reported", "exit " .. on } },
  trans { src = "asked", tgt = "bad", events = { "entry " .. on .. ".asked" } },
}

-- A stop binds it until a reset, or until the power is off.
local held = state {
  free = state {}, held = state {}, bad = state {},
  trans { src = "initial", tgt = "free" },
  trans { src = "free", tgt = "held", events = { "e_stop" }, when = on },
  trans { src = "held", tgt = "free", events = { "e_reset", "entry root.closed.off" } },
  trans { src = "held", tgt = "bad", when = moving },
}

return {
  together = 1,
  classes = { e_heat = { { celsius = 20 }, { celsius = 90 } } },
  flags = { ["the door is open"] = { on = { "e_open" }, off = { "e_close" } } },
  properties = {
    ["nothing moves while the door is open"] =
      never { moving, "the door is open" },
    ["after a stop it stands still within 0.5 s"] =
      after "e_stop".reach(is_still).within(0.5),
    ["it grips only if a part was seen since the last release"] =
      precedes(on .. ".seen", gripping).since("exit " .. gripping),
    ["each request is answered before the next"] =
      checks.observer(answered),
    ["the horn sounds for 1 s at least before it moves"] =
      after("entry " .. on .. ".horn").never(moving).within(1),
    ["it is homed before it moves"] =
      precedes("root.closed.homing", moving),
    ["there is always a way back to ready"] =
      from "root".can_reach(ready),
    ["homing is tried again at most once in 2 s"] =
      at_most(1, "taken root.closed.trans[3]").within(2),
    ["after power off it is not on until power comes"] =
      after "e_power_off".never(on).until_ "e_power",
    ["a reset resumes at ready"] =
      from "root.closed.stopped".after "e_reset".reach(ready),
    ["it stands only after it has braked, each time"] =
      precedes("root.closed.braking", "root.closed.stopped")
        .since("exit root.closed.stopped"),
    ["it is always in one of these states"] =
      always(function(active)
        return is_still(active) or active(on) or active "root.closed.braking"
      end),
    ["no start is obeyed while it is homing"] =
      from "root.closed.homing".after "e_start".never(on .. ".horn").until_ "e_start",
    ["above 80 degrees it brakes"] =
      from(on).after { name = "e_heat", celsius = 90 }.reach "root.closed.braking",
    ["after a stop nothing moves until a reset"] =
      checks.observer(held),
    ["it is still unless power comes"] =
      always(is_still).unless "e_power",
  },
}
