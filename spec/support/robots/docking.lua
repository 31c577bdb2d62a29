-- Requests to a dock, each with an answer or a timeout. One event was forgotten.
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans

local function request(name)
  return state { entry = function() dock:send(name) end }
end

return state {
  idle = state {},
  follow = request "follow", find = request "find", latch = request "latch",
  failed = state { entry = function() dock:send("abort") end },

  trans { src = "initial", tgt = "idle" },
  trans { src = "idle", tgt = "find", events = { "e_dock" } },
  trans { src = "find", tgt = "follow", events = { "e_found" } },
  trans { src = "find", tgt = "failed", events = { "e_timeout" } },
  trans { src = "follow", tgt = "latch", events = { "e_near" } },
  trans { src = "follow", tgt = "failed" }, -- MISTAKE: e_timeout was forgotten
  trans { src = "latch", tgt = "idle", events = { "e_latched" } },
  trans { src = "latch", tgt = "failed", events = { "e_timeout" } },
  trans { src = "failed", tgt = "idle", events = { "e_reset" } },
}
