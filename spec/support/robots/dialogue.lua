-- Speech: the events are what the recogniser has understood.
local rfsm = require "rfsm"

return rfsm.state {
  listening = rfsm.state { entry = function() say("yes?") end },
  walking = rfsm.state { entry = function() walk() end },
  sitting = rfsm.state { entry = function() sit() end },
  rfsm.trans { src = "initial", tgt = "listening" },
  rfsm.trans { src = "listening", tgt = "walking",
    events = { "come here", "walk on, please", "go to the kitchen" } },
  rfsm.trans { src = "listening", tgt = "sitting", events = { "sit down" } },
  rfsm.trans { src = "walking", tgt = "listening", events = { "stop", "stop it now" } },
  rfsm.trans { src = "sitting", tgt = "listening", events = { "stand up" } },
}
