-- The chart that specs of checks begin with, and a short way to write transitions.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"

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

--- What an exploration says of a property, its lines without files.
function ab.verdict(model, property, options)
  options = options or {}
  options.properties = { p = property }
  local text = helper.without_file(tostring(rfsm_checks.explore(model, options)))
  local lines = {}
  for line in text:gmatch("[^\n]+") do
    if line:find("^p: ") or lines[1] and line:find("^  ") then
      lines[#lines + 1] = line
    elseif lines[1] then
      break
    end
  end
  return table.concat(lines, "\n")
end

return ab
