-- The cost of an extension: loaded and not used, and in use.
--
--   LUA bench/extensions.lua [NAME ...]
--
-- Each module is loaded alone, on a core of its own, and measured in turn with the core
-- alone. rfsm.emem and rfsm.checkevents are for all machines, used or not; the lines
-- "off" are of machines that do without. The lines with a colon are of a chart that
-- uses the module, or a hook of the core.

package.path = "./?.lua;" .. package.path

local measure = require "bench.measure"

local ROUNDS = measure.count("ROUNDS", 7)
local SECONDS = measure.setting("SECONDS", 0.1) -- per measurement

-- Loads a core, and one module besides; returns the core.
local function load_alone(module)
  measure.forget_modules()
  local rfsm = require "rfsm"
  if module then require(module) end
  return rfsm
end

-- Drives a machine of the core `rfsm`; `fields` are of its root, `change` has the chart
-- use an extension. The loop is a fresh one: LuaJIT gives up on a loop for good when it
-- could not compile it for one subject.
local function stepping(rfsm, fields, change)
  local model = rfsm.state {
    info = false, warn = false,
    c = rfsm.state {
      a = rfsm.state {}, b = rfsm.state {},
      rfsm.trans { src = "initial", tgt = "a" },
      rfsm.trans { src = "a", tgt = "b", events = { "e_next" } },
      rfsm.trans { src = "b", tgt = "a", events = { "e_next" } },
    },
    rfsm.trans { src = "initial", tgt = "c" },
  }
  for name, value in pairs(fields or {}) do model[name] = value end -- any order: a set
  if change then change(model, rfsm) end
  local fsm = assert(rfsm.init(model))
  rfsm.run(fsm)
  return dofile("bench/measure.lua").stepping(rfsm, fsm, "e_next")
end

-- Adds a transition that is never taken, with an event of an extension.
local function add(event, src)
  return function(model, rfsm)
    model[2] = rfsm.trans { src = src, tgt = "c", events = { event } }
  end
end

-- The clock has no cost: it is the user's choice.
local function add_timer(src)
  return function(model, rfsm)
    require("rfsm_timeevent").set_gettime_hook(function() return 0, 0 end)
    add("e_after(99999)", src)(model, rfsm)
  end
end

local function add_region(model, rfsm)
  model.c.a = rfsm.seqand { rfsm.state { info = false, warn = false } }
end

local MODULES = {
  { name = "rfsm_timeevent" }, { name = "rfsm_seqand" }, { name = "rfsm.monitor" },
  { name = "rfsm.await" }, { name = "rfsm.preview" }, { name = "rfsm_checks" },
  { name = "rfsm.proto" }, { name = "rfsm.rtt" }, { name = "rfsmpp" },
  { name = "rfsm.marsh" }, { name = "rfsm.json" }, { name = "rfsm.plantuml" },
  { name = "rfsm.dot" }, { name = "rfsm.mermaid" },
  { name = "rfsm.emem" },
  { name = "rfsm.emem off", fields = { emem = false } },
  { name = "rfsm.checkevents" },
  { name = "rfsm.checkevents off", fields = { checkevents = false } },
  { name = "rfsm: empty step hook", fields = { pre_step_hook = function() end } },
  { name = "rfsm: step hook with the events",
    fields = { pre_step_hook = function(_, events) return #events end } },
  { name = "rfsm: getevents", fields = { getevents = function() end } },
  { name = "rfsm_timeevent: pending timer", change = add_timer("c") },
  { name = "rfsm_timeevent: armed in turn", change = add_timer(".c.a") },
  { name = "rfsm_seqand: one region", change = add_region },
  { name = "rfsm.await: one await", change = add("await(e_next, e_x)", "c") },
}

-- What is measured; nil and why not, if a package is missing.
local function subject_of(module)
  local ok, answer = pcall(load_alone, module.name:match("[^%s:]+"))
  if not ok then return nil, tostring(answer):match("[^\n]*") end
  return stepping(answer, module.fields, module.change)
end

package.loaded.rtt = package.loaded.rtt or require "spec.support.rtt"

local labels, subjects, skipped = { "the core alone" }, { stepping(load_alone()) }, {}
for _, module in ipairs(measure.select(MODULES, arg)) do
  local subject, reason = subject_of(module)
  if subject then
    labels[#labels + 1], subjects[#subjects + 1] = "+ " .. module.name, subject
  else
    skipped[#skipped + 1] = ("- %s: not measured, %s"):format(module.name, reason)
  end
end
local best = measure.best_in_turn(subjects, ROUNDS, SECONDS)

print(("%s: microseconds per event, best of %d rounds"):format(measure.engine(),
  ROUNDS))
for i = 1, #labels do
  print(("%-44s %8.3f %6.1f %%"):format(labels[i], best[i], best[i] / best[1] * 100))
end
for _, line in ipairs(skipped) do print(line) end
