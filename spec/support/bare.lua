-- Charts of charts.lua as models without programs: guards, entries, exits, effects and
-- doos are made by the caller.

local charts = require "spec.support.charts"
local rfsm = require "rfsm"

local bare = {}

--- A silent model of a chart. `make` has functions that return callbacks: entry, exit
-- and doo of a name, guard and effect of the number of a transition.
function bare.model_of(chart, make)
  local root = charts.assemble(chart, function(fqn, node)
    if node.kind == "connector" then return rfsm.conn {} end
    return rfsm.state {
      entry = make.entry and make.entry(fqn), exit = make.exit and make.exit(fqn),
      doo = node.doo and make.doo and make.doo(fqn) or nil,
    }
  end, function(tr, i)
    return rfsm.trans {
      src = tr.src_ref, tgt = tr.tgt_ref, pn = tr.pn, events = tr.events_ref,
      guard = tr.guard and make.guard and make.guard(i) or nil,
      effect = make.effect and make.effect(i) or nil, number = i,
    }
  end)
  root.info, root.warn, root.err = false, false, false
  return root
end

return bare
