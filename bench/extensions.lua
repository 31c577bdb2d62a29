-- What does a step of a chart that uses no extension cost when they are loaded?
--
--   LUA bench/extensions.lua
--
-- Each machine is initialised after one more extension was loaded: what that adds to
-- machines which do not use it would show from there on. The last two are for all
-- machines, used or not.

package.path = "./?.lua;" .. package.path

local measure = require "bench.measure"
local rfsm = require "rfsm"

local ROUNDS = measure.count("ROUNDS", 7)
local SECONDS = measure.setting("SECONDS", 0.3) -- per measurement

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

local function stepping(fsm) return measure.stepping(rfsm, fsm, "e_next") end

local names = { "the core alone", "rfsm_timeevent", "rfsm_seqand", "rfsm_ext",
  "rfsm_await", "rfsm_preview", "rfsm_checks", "rfsm_emem", "rfsm_checkevents" }
local subjects = { stepping(new_machine()) }
for i = 2, #names do
  require(names[i])
  subjects[i] = stepping(new_machine())
end
local best = measure.best_in_turn(subjects, ROUNDS, SECONDS)

print(("%s: microseconds per event, best of %d rounds"):format(measure.engine(),
  ROUNDS))
for i = 1, #names do
  print(("%-20s %8.3f %6.1f %%"):format((i > 1 and "+ " or "") .. names[i], best[i],
    best[i] / best[1] * 100))
end
