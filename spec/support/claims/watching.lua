-- A machine whose properties are watched against one that nobody watches, and one that
-- was watched before: random charts with regions leave the same trace, and what is no
-- longer watched has the hooks that it had.

local charts = require "spec.support.claims.explore"
local driven = require "spec.support.driven"
local independence = require "spec.support.claims.independence"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local run_seeds = require "spec.support.run_seeds"

local claim = { name = "a machine that is watched, and one that is not", steps = 20 }

--- Returns makers of callbacks that note their calls and the events that they get.
function claim.noting(trace, random)
  local make = { doo = driven.yielding(random) }
  for _, kind in ipairs { "guard", "predicate", "effect", "entry", "exit" } do
    make[kind] = function(id)
      return function(_, _, events)
        if type(events) ~= "table" then events = {} end
        trace[#trace + 1] = ("%s %s %s"):format(kind, tostring(id),
          table.concat(events, ", "))
        return random(2) == 1
      end
    end
  end
  return make
end

--- Returns the hooks and effects of a machine and its regions, as a text.
function claim.hooks_of(fsm)
  local texts = {}
  for _, entry in ipairs(rfsm.machines(fsm)) do
    local machine = entry.machine
    for _, list in ipairs { machine._pre_hooks, machine._post_hooks,
      machine._reset_hooks, machine._path_hooks } do
      for _, hook in ipairs(list or {}) do texts[#texts + 1] = tostring(hook) end
    end
    for _, state in ipairs(rfsm.elements(machine, rfsm.is_state)) do
      for _, hook in ipairs((machine._entry_hooks or {})[state] or {}) do
        texts[#texts + 1] = tostring(hook)
      end
    end
    for _, tr in ipairs(rfsm.elements(machine, rfsm.is_trans)) do
      texts[#texts + 1] = tostring(tr.effect)
    end
  end
  return table.concat(texts, "\n")
end

--- Has a machine with an even seed note its records, without addresses of predicates.
function claim.note_records(fsm, seed, trace)
  if seed % 2 ~= 0 then return end
  fsm.dbg = function(...)
    trace[#trace + 1] = table.concat({ ... }, " "):gsub("function: [^,' ]+", "f")
  end
end

--- Drives a machine at random for a number of steps: sends events, calls `step`, lets
--- time pass, notes where the machine is, and resets it now and then.
function claim.drive(fsm, chart, random, trace, steps, step)
  local now = 0
  fsm.gettime = function() return now, 0 end
  for _ = 1, steps do
    for _ = 1, random(3) - 1 do
      rfsm.send_events(fsm, chart.events[random(#chart.events)])
    end
    step()
    now = now + random(2) - 1
    for _, text in ipairs(charts.stands_of(fsm, {})) do trace[#trace + 1] = text end
    if random(9) == 1 then rfsm.reset(fsm) end
  end
end

-- Returns the trace of a random run of a chart; `watch` is called with the machine.
local function trace_of(chart, seed, watch)
  local trace, random = {}, new_random(seed + 37)
  local fsm = rfsm.init(charts.model_of(chart, claim.noting(trace, random), ""))
  fsm.err = function(text)
    if not tostring(text):find("^property '") then trace[#trace + 1] = text end
  end
  claim.note_records(fsm, seed, trace)
  watch(fsm)
  claim.drive(fsm, chart, random, trace, claim.steps, function()
    rfsm.step(fsm, random(2))
  end)
  return table.concat(trace, "\n")
end

-- Appends what is wrong. Returns whether the chart was compared.
local function compare(seed, list)
  local chart = independence.chart(seed)
  if not chart then return false end
  local properties = independence.watchable(
    independence.properties_of(chart, new_random(seed + 31)))
  local trace = trace_of(chart, seed, function() end)
  local watched = trace_of(chart, seed, function(fsm)
    rfsm_checks.watch_properties(fsm, properties)
  end)
  local stopped = trace_of(chart, seed, function(fsm)
    local before = claim.hooks_of(fsm)
    rfsm_checks.watch_properties(fsm, properties):stop()
    if claim.hooks_of(fsm) ~= before then list[#list + 1] = seed .. ": other hooks" end
  end)
  if watched ~= trace then list[#list + 1] = seed .. ": watched, another trace" end
  if stopped ~= trace then list[#list + 1] = seed .. ": stopped, another trace" end
  return true
end

claim.run = run_seeds(compare)

return claim
