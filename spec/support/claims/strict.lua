-- A strict machine against one that is not: random charts whose elements have fields of
-- odd names leave the same trace, and nobody calls these fields.

local charts = require "spec.support.claims.explore"
local independence = require "spec.support.claims.independence"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local run_seeds = require "spec.support.run_seeds"
local watching = require "spec.support.claims.watching"

local claim = { name = "a strict machine, and one that is not", steps = 12 }

local NAMES = { "type", "new", "rfsm", "events", "a b", "", "run", "step", "enter",
  "on exit", "final_", "checks", "strict", "_mine", 97, 3.5, true }

-- Gives the elements of a model fields of odd names, the same for the same seed. Values
-- that can be called note that they were.
local function add_fields(model, trace, random)
  local function called(_, ...)
    trace[#trace + 1] = "called"
    return ...
  end
  local VALUES = { 1, "x", {}, called, setmetatable({}, { __call = called }), false,
    setmetatable({}, { __eq = called, __index = called, __len = called }) }
  rfsm.mapfsm(function(obj)
    for _ = 1, random(3) do
      local name, value = NAMES[random(#NAMES)], VALUES[random(#VALUES)]
      -- `run = 1` in a state with regions may advance one that is never idle, for ever
      local is_own = name == "events" and rfsm.is_trans(obj)
        or (name == "run" or name == "step") and rfsm.is_state(obj)
        or name == "strict" and obj == model
      if rawget(obj, name) == nil and not is_own then obj[name] = value end
    end
  end, model, rfsm.is_fsmobj)
  return model
end

-- Returns the trace of a random run of a chart, strict or not.
local function trace_of(chart, seed, is_strict)
  local trace, random = {}, new_random(seed + 41)
  local model = charts.model_of(chart, watching.noting(trace, random), "")
  model.strict, model.warn = is_strict, function() end
  add_fields(model, trace, new_random(seed + 43))
  local fsm = rfsm.init(model)
  if not fsm then return nil end
  watching.note_records(fsm, seed, trace)
  rfsm.step(fsm)
  for _ = 1, claim.steps do
    -- not before the entry: the core reports such events, and asks predicates for that
    for _ = 1, fsm._act_leaf and random(3) - 1 or 0 do
      rfsm.send_events(fsm, chart.events[random(#chart.events)])
    end
    rfsm.step(fsm, random(2))
    for _, text in ipairs(charts.stands_of(fsm, {})) do trace[#trace + 1] = text end
    if random(9) == 1 then
      rfsm.reset(fsm)
      rfsm.step(fsm)
    end
  end
  return table.concat(trace, "\n")
end

local function compare(seed, list)
  local chart = independence.chart(seed)
  local trace = chart and trace_of(chart, seed, false)
  if not trace then return false end
  local is_called = trace:find("called", 1, true)
  if is_called then list[#list + 1] = seed .. ": a field is called" end
  if trace_of(chart, seed, true) ~= trace then
    list[#list + 1] = seed .. ": strict, another trace"
  end
  return true
end

claim.run = run_seeds(compare)

return claim
