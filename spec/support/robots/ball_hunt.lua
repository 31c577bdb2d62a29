-- YARP: follows a ball. The program that runs it keeps its machine in the global fsm.
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans

ball_port = yarp.BufferedPortBottle()
ball_port:open("/hunt/ball:i")

function see()
  local bottle = ball_port:read(false)
  if bottle then
    rfsm.send_events(fsm, "e_ball")
  else
    rfsm.send_events(fsm, "e_no_ball")
  end
end

return state {
  searching = state {
    entry = function() gaze_look_around() end,
    doo = function()
      while true do
        see()
        rfsm.yield(true)
      end
    end,
  },
  following = state {
    doo = function()
      while true do
        see()
        gaze_follow(fsm.target)
        rfsm.yield(true)
      end
    end,
  },
  trans { src = "initial", tgt = "searching" },
  trans { src = "searching", tgt = "following", events = { "e_ball" } },
  trans { src = "following", tgt = "searching", events = { "e_no_ball" } },
}
