--- Places of findings: location, path, the line of nodes above, machines inside of
--- states; for the other checks.
--
-- @module rfsm.checks.place
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local ipairs, table, type = ipairs, table, type
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
---@param prefix? string path of the region
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

--- List the machines inside a state, its regions, sorted by name.
---@param state rfsm.State
---@return { name: string, machine: rfsm.Machine }[] regions
function place.regions_of(state)
  local machines = type(state.substates) == "table" and state.substates or {}
  local regions = {}
  for i, name in ipairs(rfsm.sorted_keys(machines, rfsm.is_initialized_root)) do
    regions[i] = { name = text_of(name), machine = machines[name] }
  end
  return regions
end

local function add_machine(list, machine)
  list[#list + 1] = machine
  for _, leaf in ipairs(rfsm.elements(machine.fsm, rfsm.is_leaf)) do
    for _, region in ipairs(place.regions_of(leaf)) do
      local name = "." .. region.name
      add_machine(list, { fsm = region.machine, owner = machine, leaf = leaf,
        prefix = place.path(leaf, machine.prefix) .. name,
        location = machine.location .. leaf._fqn .. name .. ": " })
    end
  end
  return list
end

--- A machine, or one inside of it.
---@class rfsm_checks.Inner
---@field fsm rfsm.Machine
---@field prefix? string path of the region: "root.par.left"
---@field location string in front of findings: "root.par.left: "; "" for the outermost
---@field owner? rfsm_checks.Inner the machine around it
---@field leaf? rfsm.State where it is in that machine

--- List a machine and those inside of it, each before those inside of its states.
function place.machines(fsm)
  return add_machine({}, { fsm = fsm, prefix = nil, location = "" })
end

return place
