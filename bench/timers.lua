-- Does a step cost more when many timers are armed that are not due?
--
--   LUA bench/timers.lua [TIMERS ...]      (10 100 1000 10000)
--
-- A machine goes round between two states in a composite on e_next; the composite has
-- the timers, an hour and more away, and each step looks whether one is due.

package.path = "./?.lua;" .. package.path

local rfsm = require "rfsm"
local timeevent = require "rfsm_timeevent"

local EVENTS, ROUNDS = 200000, 5

local ticks = 0
timeevent.set_gettime_hook(function()
  ticks = ticks + 1
  return 1000, ticks % 1000
end)

local function machine_with(timers)
  local model = rfsm.state {
    info = false, warn = false,
    c = rfsm.state {
      a = rfsm.state {}, b = rfsm.state {},
      rfsm.trans { src = "initial", tgt = "a" },
      rfsm.trans { src = "a", tgt = "b", events = { "e_next" } },
      rfsm.trans { src = "b", tgt = "a", events = { "e_next" } },
    },
    out = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "c" },
  }
  for i = 1, timers do
    model[i + 1] = rfsm.trans { src = "c", tgt = "out",
      events = { ("e_after(%d)"):format(3600 + i * 7 % timers) } }
  end
  local fsm = assert(rfsm.init(model))
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

local counts = #arg > 0 and arg or { 10, 100, 1000, 10000 }
local machines, best = { machine_with(0) }, { math.huge }
for i = 1, #counts do
  machines[i + 1], best[i + 1] = machine_with(tonumber(counts[i])), math.huge
end
for _ = 1, ROUNDS do -- in turn, so that a busy machine hits all alike
  for i = 1, #machines do
    collectgarbage()
    best[i] = math.min(best[i], microseconds_per_event(machines[i]))
  end
end

local jit = rawget(_G, "jit")
print(("%s: microseconds per event, best of %d rounds"):format(
  jit and jit.version or _VERSION, ROUNDS))
print(("%8s timers %8.3f"):format("no", best[1]))
for i = 1, #counts do
  print(("%8s timers %8.3f"):format(counts[i], best[i + 1]))
end
