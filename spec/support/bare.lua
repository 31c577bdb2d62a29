-- Charts of charts.lua as models without programs: guards, entries, exits, effects and
-- doos are made by the caller.

local charts = require "spec.support.charts"
local rfsm = require "rfsm"

local bare = {}

-- The events of a transition, with another predicate.
local function events_of(tr, i, make)
  local events = {}
  for n, event in ipairs(tr.events_ref or {}) do
    events[n] = type(event) == "function" and make.predicate and make.predicate(i)
    if not events[n] then events[n] = event end
  end
  return tr.events_ref and events
end

--- A silent model of a chart. `make` has functions that return callbacks: entry, exit
-- and doo of a name; guard, effect and predicate of the number of a transition.
function bare.model_of(chart, make)
  local root = charts.assemble(chart, function(fqn, node)
    if node.kind == "connector" then return rfsm.conn {} end
    return rfsm.state {
      entry = make.entry and make.entry(fqn), exit = make.exit and make.exit(fqn),
      doo = node.doo and make.doo and make.doo(fqn) or nil,
      history = node.history, final = node.final, defer = node.defer,
    }
  end, function(tr, i)
    return rfsm.trans {
      src = tr.src_ref, tgt = tr.tgt_ref, pn = tr.pn, events = events_of(tr, i, make),
      guard = tr.guard and make.guard and make.guard(i) or nil,
      effect = make.effect and make.effect(i) or nil, number = i,
      always = tr.always and (tr.events_ref or {})[1] == nil or nil,
    }
  end)
  root.info, root.warn, root.err = false, false, false
  return root
end

return bare
