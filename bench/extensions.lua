-- What does a step of a chart that uses no extension cost when they are loaded?
--
--   LUA bench/extensions.lua
--
-- Each machine is initialised after one more extension was loaded: what that adds to
-- machines which do not use it would show from there on. The last two are for all
-- machines, used or not.

package.path = "./?.lua;" .. package.path

local rfsm = require "rfsm"

local EVENTS, ROUNDS = 200000, 7

local function new_machine()
  local fsm = assert(rfsm.init(rfsm.state {
    info = false, warn = false,
    c = rfsm.state {
      a = rfsm.state {}, b = rfsm.state {},
      rfsm.trans { src = "initial", tgt = "a" },
      rfsm.trans { src = "a", tgt = "b", events = { "e_next" } },
      rfsm.trans { src = "b", tgt = "a", events = { "e_next" } },
    },
    rfsm.trans { src = "initial", tgt = "c" },
  }))
  rfsm.run(fsm)
  return fsm
end

local function microseconds_per_event(fsm)
  local start = os.clock()
  for _ = 1, EVENTS do
    rfsm.send_events(fsm, "e_next")
    rfsm.step(fsm)
  end
  return (os.clock() - start) / EVENTS * 1e6
end

local names = { "the core alone", "rfsm_timeevent", "rfsm_seqand", "rfsm_ext",
  "rfsm_await", "rfsm_preview", "rfsm_checks", "rfsm_emem", "rfsm_checkevents" }
local machines, best = { new_machine() }, {}
for i = 2, #names do
  require(names[i])
  machines[i] = new_machine()
end
for i = 1, #machines do best[i] = math.huge end
for _ = 1, ROUNDS do -- in turn, so that a busy machine hits all alike
  for i = 1, #machines do
    collectgarbage()
    best[i] = math.min(best[i], microseconds_per_event(machines[i]))
  end
end

local jit = rawget(_G, "jit")
print(("%s: microseconds per event, best of %d rounds"):format(
  jit and jit.version or _VERSION, ROUNDS))
for i = 1, #names do
  print(("%-20s %8.3f %6.1f %%"):format((i > 1 and "+ " or "") .. names[i], best[i],
    best[i] / best[1] * 100))
end
