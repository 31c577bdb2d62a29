-- The chart that specs of checks begin with, and a short way to write transitions.

local rfsm = require "rfsm"

local ab = {}

--- A transition on an event, or a list of them.
function ab.go(src, tgt, event, fields)
  fields = fields or {}
  fields.src, fields.tgt = src, tgt
  fields.events = type(event) == "table" and event or event and { event } or nil
  return rfsm.trans(fields)
end

--- The silent chart (initial) -> a --e_x--> b --e_x--> a, with more members.
function ab.chart(members)
  local model = {
    warn = false, info = false, a = rfsm.state {}, b = rfsm.state {},
    ab.go("initial", "a"), ab.go("a", "b", "e_x"), ab.go("b", "a", "e_x"),
  }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a set
  return rfsm.state(model)
end

return ab
