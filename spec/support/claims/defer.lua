-- A machine with rfsm.defer leaves the trace of the oracle, also with histories.

local charts = require "spec.support.charts"
local driven = require "spec.support.driven"
local history = require "spec.support.claims.history"
local runs = require "spec.support.runs"
require "rfsm.defer"

return { name = "deferral and the oracle", run = driven.claim(function(seed)
  local chart = charts.generate(seed)
  charts.add_deferrals(chart)
  if seed % 2 == 0 then charts.add_histories(chart) end
  local at, expected, actual = runs.compare(chart, history.add_model)
  return at and ("line %d: oracle '%s', core '%s'"):format(at, tostring(expected[at]),
    tostring(actual[at]))
end) }
