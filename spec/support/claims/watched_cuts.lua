-- A machine whose properties are watched, interrupted anywhere in the hooks of the
-- watch, goes the way of one that is not, and the same properties are reported. A
-- report may come twice if the interrupt comes while it is given.
-- What is interrupted is stepped again. Regions are watched, but not interrupted in the
-- cycle of their state: an interrupt ends that cycle, so they are a cycle behind.

local charts = require "spec.support.claims.explore"
local independence = require "spec.support.claims.independence"
local interrupts = require "spec.support.interrupts"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local run_seeds = require "spec.support.run_seeds"
local watching = require "spec.support.claims.watching"

local claim = { name = "a watch that is cut short", raised = 0, reports = 0 }

local STEPS = 12

-- Does the watch run, called by a hook of its own, not of a region, and no printer?
local function is_watch()
  local level, info, is_found = 3, debug.getinfo(3, "S"), false
  if info.short_src:find("spec/", 1, true) then return false end
  while info do
    if info.short_src:find("rfsm_seqand.lua", 1, true) then return false end
    is_found = is_found or info.short_src:find("watch_properties.lua", 1, true) ~= nil
    level = level + 1
    info = debug.getinfo(level, "S")
  end
  return is_found
end

-- Has the machine interrupted at an instruction of the watch. A step whose second
-- iteration is cut short before its search has one more, so this is left out.
local function arm(fsm, random, cut)
  local skip = random(400)
  debug.sethook(function()
    if not is_watch() or rfsm.is_free(fsm) and fsm._phase ~= "finish" then return end
    skip = skip - 1
    if skip > 0 then return end
    debug.sethook()
    cut.raised = cut.raised + 1
    error(random:pick(interrupts.VALUES), 0)
  end, "", 1 + random(5))
end

-- Steps a machine. With `cut`, it is interrupted by chance, then stepped again.
local function step(fsm, cut)
  if cut and cut.random:chance(60) then arm(fsm, cut.random, cut) end
  local ok, failure = pcall(rfsm.step, fsm)
  debug.sethook()
  if ok then return end
  if not (cut and interrupts.is_known(failure)) then error(failure, 0) end
  if fsm._phase ~= "idle" then step(fsm) end
end

-- Returns the trace of a random run with the reports of the watch.
local function trace_of(chart, properties, seed, cut)
  local trace, random = {}, new_random(seed + 37)
  local make = watching.noting(trace, random)
  local fsm = rfsm.init(charts.model_of(chart, make, ""))
  fsm.err = function(text)
    if cut and trace[#trace] == text then return end
    trace[#trace + 1] = tostring(text)
  end
  rfsm_checks.watch_properties(fsm, properties)
  watching.drive(fsm, chart, random, trace, STEPS, function() step(fsm, cut) end)
  return trace
end

local function compare(seed, list)
  local chart = independence.chart(seed)
  if not chart then return false end
  local properties = independence.watchable(
    independence.properties_of(chart, new_random(seed + 31)))
  local cut = { random = new_random(seed + 41), raised = 0 }
  local expected = trace_of(chart, properties, seed)
  local got = trace_of(chart, properties, seed, cut)
  claim.raised = claim.raised + cut.raised
  for i = 1, math.max(#expected, #got) do
    if expected[i] and expected[i]:find("^property '") then
      claim.reports = claim.reports + 1
    end
    if expected[i] ~= got[i] then
      list[#list + 1] = ("%d: line %d: expected %s, got %s"):format(seed, i,
        tostring(expected[i]), tostring(got[i]))
      break
    end
  end
  return true
end

local run = run_seeds(compare)

function claim.run(n, seed) return interrupts.without_jit(run, n, seed) end

return claim
