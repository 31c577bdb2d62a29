-- A machine with rfsm.history leaves the trace of the oracle, to whose transitions a
-- model of history gives their targets.

local charts = require "spec.support.charts"
local driven = require "spec.support.driven"
local reference = require "spec.support.reference"
local runs = require "spec.support.runs"
require "rfsm.history"

-- The model: where a transition into a composite leads, `leaf` having been active last.
local function way_into(nodes, composite, leaf)
  local child, initial = leaf, composite .. ".initial"
  while nodes[child].parent ~= composite do child = nodes[child].parent end
  local has_ended = child == leaf and nodes[leaf].final and nodes[initial]
  if has_ended or not nodes[composite].history then return initial end
  if child == leaf then return leaf end
  if nodes[composite].history == "shallow" then return way_into(nodes, child, leaf) end
  local inner = nodes[leaf].parent .. ".initial"
  return nodes[leaf].final and nodes[inner] and inner or leaf
end

local function is_inside(fqn, composite)
  return fqn:sub(1, #composite + 1) == composite .. "."
end

-- Calls f(tr, composite) for each transition that enters one with a history.
local function each_way_in(chart, first_targets, f)
  for _, tr in ipairs(chart.transitions) do
    first_targets[tr] = first_targets[tr] or tr.tgt
    local composite = first_targets[tr]:match("^(.*)%.initial$")
    if composite and chart.nodes[composite].history and not is_inside(tr.src, composite)
      and is_inside(tr.tgt, composite) then f(tr, composite) end
  end
end

local function add_model(calls, chart)
  local first_targets = {}
  local function nothing() end
  each_way_in(chart, first_targets, nothing)
  function calls.was_reset()
    each_way_in(chart, first_targets, function(tr, composite)
      reference.retarget(tr, composite .. ".initial")
    end)
  end
  function calls.entered(fqn)
    if not chart.nodes[fqn].is_leaf then return end
    each_way_in(chart, first_targets, function(tr, composite)
      if not is_inside(fqn, composite) then return end
      reference.retarget(tr, way_into(chart.nodes, composite, fqn))
    end)
  end
end

local run = driven.claim(function(seed)
  local chart = charts.generate(seed)
  charts.add_histories(chart)
  local at, expected, actual = runs.compare(chart, add_model)
  return at and ("line %d: model '%s', core '%s'"):format(at, tostring(expected[at]),
    tostring(actual[at]))
end)

return { name = "history and its model", add_model = add_model, run = run }
