-- Random charts, and the same charts in which half of the events are named with data:
-- verdicts, witnesses, written tests and pictures are the same up to the form of the
-- event, and so are runs.

local bare = require "spec.support.bare"
local charts = require "spec.support.charts"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local run_seeds = require "spec.support.run_seeds"

local claim = { name = "charts with plain events, and with events with data" }

local EVENTS, NAMED = { "e1", "e2", "e3", "e4" }, { e1 = true, e3 = true }
local EXPORTERS = { "dot", "mermaid", "plantuml", "json" }

local function no() return false end
local function make() return no end

-- Gives the events of a transition their form in a chart with data.
local function with_data(tr)
  for i, event in ipairs(tr.events or {}) do
    if NAMED[event] then tr.events[i] = rfsm.named(event) end
  end
end

local function model_of(chart, has_data)
  local model = bare.model_of(chart, { guard = make, predicate = make, doo = make })
  local function visit(state)
    for _, key in ipairs(rfsm.sorted_keys(state)) do
      local value = state[key]
      if rfsm.is_trans(value) and has_data then with_data(value) end
      if rfsm.is_state(value) then visit(value) end
    end
  end
  visit(model)
  return model
end

local function properties_of(chart)
  local properties = {}
  for i, fqn in ipairs(chart.names) do
    if chart.nodes[fqn].kind == "state" and fqn ~= "root" then
      local event = EVENTS[i % #EVENTS + 1]
      properties[#properties + 1] = rfsm_checks.after(event).reach(fqn)
      properties[#properties + 1] = rfsm_checks.never(fqn)
    end
  end
  return properties
end

-- Returns what the tools say of a model, as texts by their names.
local function sayings_of(model, properties)
  local result = rfsm_checks.explore(model,
    { configurations = 300, properties = properties })
  local said = { explore = tostring(result) }
  said.tests = not result.bound
    and require("rfsm.tests.tests").busted("a.lua", model)
      :gsub('{ name = ("[^"]*") }', "%1"):gsub("%s+", " ")
  local fsm = rfsm.init(model)
  for _, name in ipairs(EXPORTERS) do
    said[name] = require("rfsm." .. name).encode(fsm)
      :gsub(',%s*"with_data":%b[]', "")
  end
  return said
end

-- Runs a machine with random events. Returns the leaves, each in a line.
local function run_of(model, seed, has_data)
  local fsm, random, leaves = rfsm.init(model), new_random(seed), {}
  fsm.gettime = function() return 0, 0 end
  for i = 1, 30 do
    local event = EVENTS[random(#EVENTS)]
    local is_named = has_data and NAMED[event]
    rfsm.send_events(fsm, is_named and { name = event, n = i } or event)
    rfsm.step(fsm, 2)
    leaves[i] = tostring(fsm._act_leaf and fsm._act_leaf._fqn)
  end
  return table.concat(leaves, "\n")
end

local function compare(seed, list)
  local chart = charts.generate(seed)
  local plain, named = model_of(chart, false), model_of(chart, true)
  if not rfsm.init(plain) then return false end
  local properties = properties_of(chart)
  local expected, got = sayings_of(plain, properties), sayings_of(named, properties)
  expected.run, got.run = run_of(plain, seed, false), run_of(named, seed, true)
  for _, what in ipairs(rfsm.sorted_keys(expected)) do
    if expected[what] ~= got[what] then
      list[#list + 1] = ("%d: %s differs"):format(seed, what)
    end
  end
  return true
end

claim.run = run_seeds(compare)

return claim
