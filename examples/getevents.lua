-- Events from outside: the machine calls getevents in each iteration. Here it drains a
-- mailbox, as it would drain a port, a socket or a queue.
--
--   (initial) --> idle --e_job--> busy --e_done--> idle
--
-- In rfsm-sim:  run()  mailbox[1] = "e_job"  run()

-- luacheck: globals mailbox

local rfsm = require "rfsm"

mailbox = {} -- global, so that you can put events in

local function drain()
  local events = mailbox
  mailbox = {}
  return events
end

return rfsm.state {
  getevents = drain,

  idle = rfsm.state { entry = function() print("waiting") end },
  busy = rfsm.state { entry = function() print("working") end },

  rfsm.trans { src = "initial", tgt = "idle" },
  rfsm.trans { src = "idle", tgt = "busy", events = { "e_job" } },
  rfsm.trans { src = "busy", tgt = "idle", events = { "e_done" } },
}
