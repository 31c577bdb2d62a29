-- Runs with and without the robot's middleware.
local rfsm = require "rfsm"
local is_there, bridge = pcall(require, "bridge")

local function speak(text)
  if is_there then bridge.say(text) else print(text) end
end

return rfsm.state {
  on_hook = rfsm.state { entry = function() speak("ready") end },
  ringing = rfsm.state { entry = function() speak("ring") end },
  talking = rfsm.state { doo = function()
    while camera and camera.is_open() do
      camera.show()
      rfsm.yield(true)
    end
  end },
  rfsm.trans { src = "initial", tgt = "on_hook" },
  rfsm.trans { src = "on_hook", tgt = "ringing", events = { "e_call" } },
  rfsm.trans { src = "ringing", tgt = "talking", events = { "e_pick_up" } },
  rfsm.trans { src = "ringing", tgt = "on_hook", events = { "e_hang_up" } },
  rfsm.trans { src = "talking", tgt = "on_hook", events = { "e_hang_up", "e_done" } },
}
