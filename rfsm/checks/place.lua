--- Locations of findings, and the machines inside of states; for the other checks.
--
-- @module rfsm.checks.place
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local ipairs, pairs, type = ipairs, pairs, type
local sort = table.sort
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
---@param obj rfsm.State|rfsm.Transition|rfsm.Connector
---@return string place
function place.of(obj)
  local _, rest = place.split(rfsm.location_of(obj))
  return rest
end

--- Return the path of an element: "root.a.trans[2]", in a region "root.par.left.a".
---@param obj rfsm.State|rfsm.Transition|rfsm.Connector
---@param prefix? string path of the region
---@return string path
function place.path(obj, prefix)
  local path = obj._fqn or place.of(obj):gsub(" %(.* %-> .*%)$", "")
  return prefix and prefix .. path:sub(5) or path
end

local function name_before(a, b) return text_of(a) < text_of(b) end

--- List the machines inside a state, its regions, sorted by name.
---@param state rfsm.State
---@return { name: string, machine: rfsm.Machine }[] regions
function place.regions_of(state)
  local machines = type(state.substates) == "table" and state.substates or {}
  local names, regions = {}, {}
  for name, machine in pairs(machines) do -- any order: sorted
    if rfsm.is_initialized_root(machine) then names[#names + 1] = name end
  end
  sort(names, name_before)
  for i, name in ipairs(names) do
    regions[i] = { name = text_of(name), machine = machines[name] }
  end
  return regions
end

return place
