--- Places of findings: location, path, the line of nodes above, machines inside of
--- states; for the other checks.
--
-- @module rfsm.checks.place
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local ipairs, table = ipairs, table
local text_of = rfsm.text_of

local place = {}

--- Split a location, or a text that begins with one, at the root.
---@param text string "chart.lua:7: root.trans[2]"
---@return string file "chart.lua:7: "; empty if it is not known
---@return string rest "root.trans[2]"
function place.split(text)
  local file, rest = text:match("^(.-:%d+: )(root.*)$")
  return file or "", rest or text
end

--- Return where an element stands in the model, without file and line.
function place.of(obj)
  local _, rest = place.split(rfsm.location_of(obj))
  return rest
end

--- Return the path of an element: "root.a.trans[2]", in a region "root.par.left.a".
---@param obj rfsm.State|rfsm.Transition|rfsm.Connector
---@param prefix? string of its machine, see `rfsm.machines`
---@return string path
function place.path(obj, prefix)
  local path = obj._fqn or place.of(obj):gsub(" %(.* %-> .*%)$", "")
  return prefix and prefix .. path:sub(5) or path
end

--- List the nodes from a machine, or a part of one, down to one of its nodes.
function place.line(fsm, node)
  local line = { node }
  while line[1] ~= fsm do table.insert(line, 1, line[1]._parent) end
  return line
end

--- List the nodes whose transitions are tried in a leaf, in order; false: the way in.
function place.tried(fsm, leaf)
  if leaf then return place.line(fsm, leaf) end
  return { rfsm.is_composite(fsm) and fsm.initial or nil }
end

--- List the regions of a state with their names, sorted by name.
---@param state rfsm.State
---@return { name: string, machine: rfsm.Machine }[] regions
function place.regions_of(state)
  local regions, machines = {}, {}
  for i, machine in ipairs(rfsm.regions(state)) do
    machines[state._regions.names[i]] = machine
  end
  for i, name in ipairs(rfsm.sorted_keys(machines)) do
    regions[i] = { name = text_of(name), machine = machines[name] }
  end
  return regions
end

--- Return the path of a region in front of findings about it: "root.par.left: "; empty
--- for the machine itself.
function place.location_of(prefix) return prefix ~= "root" and prefix .. ": " or "" end

return place
