-- Dynamic change: a machine learns a new skill while it runs. rfsm.fsm_merge adds a
-- state and its transitions.
--
--   (initial) --> resting --e_learn--> resting      (adds `dancing`)
--                  ^   |
--                  |   +--e_music--> dancing        (only after e_learn)
--                  +------e_done-------+
--
-- In rfsm-sim:  run()  ser("e_music")  ser("e_learn")  ser("e_music")

local rfsm = require "rfsm"

local function learn(fsm)
  if fsm.dancing then return end
  local dancing = rfsm.state { entry = function() print("dancing") end }
  rfsm.fsm_merge(fsm, fsm, dancing, "dancing")
  rfsm.fsm_merge(fsm, fsm,
    rfsm.trans { src = "resting", tgt = "dancing", events = { "e_music" } })
  rfsm.fsm_merge(fsm, fsm,
    rfsm.trans { src = "dancing", tgt = "resting", events = { "e_done" } })
  print("learned to dance")
end

return rfsm.state {
  warn = false, -- fsm_merge warns of `dancing` before its way out is there

  resting = rfsm.state { entry = function() print("resting") end },

  rfsm.trans { src = "initial", tgt = "resting" },
  rfsm.trans {
    src = "resting", tgt = "resting", events = { "e_learn" }, effect = learn,
  },
}
