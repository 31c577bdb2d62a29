--- Names in the simulator: machines, states and events, and the nearest to a mistake.
--
-- A machine inside a state, a region, has a name behind that of the state. The state
-- `root.open` of the region `left` in `root.arms` is called `root.arms.left.open`.
--
-- @module rfsm.sim.names
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"

local ipairs, pairs, type = ipairs, pairs, type
local sort = table.sort
local text_of = rfsm.text_of

local names = {}

--- List the keys of a set, sorted by their texts.
---@param set table<any, any>
---@return any[] list
function names.sorted(set)
  local list = {}
  for key in pairs(set) do list[#list + 1] = key end -- any order: sorted below
  sort(list, function(a, b) return text_of(a) < text_of(b) end)
  return list
end

--- List the machines inside a state, its regions.
---@param state rfsm.State
---@return { name: string, machine: rfsm.Machine }[] regions sorted by name
function names.regions_of(state)
  local machines, regions = state.substates, {}
  for _, name in ipairs(type(machines) == "table" and names.sorted(machines) or {}) do
    if rfsm.is_initialized_root(machines[name]) then
      regions[#regions + 1] = { name = text_of(name), machine = machines[name] }
    end
  end
  return regions
end

--- Return the name of a node of a machine.
---@param prefix string the name of that machine
---@param fqn string
---@return string name
function names.full(prefix, fqn) return prefix .. fqn:sub(#"root" + 1) end

local function add_machines(list, fsm, prefix)
  list[#list + 1] = { fsm = fsm, prefix = prefix }
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do
    for _, region in ipairs(names.regions_of(state)) do
      add_machines(list, region.machine,
        names.full(prefix, state._fqn) .. "." .. region.name)
    end
  end
  return list
end

--- List a machine and those inside its states.
---@param fsm rfsm.Machine
---@return { fsm: rfsm.Machine, prefix: string }[] machines
function names.machines(fsm) return add_machines({}, fsm, "root") end

--- List the events that transitions name.
---@param fsm rfsm.Machine
---@return any[] events sorted by their texts
---@return table<any, boolean> set the same as a set
function names.events(fsm)
  local set = {}
  for _, machine in ipairs(names.machines(fsm)) do
    for _, tr in ipairs(rfsm.elements(machine.fsm, rfsm.is_trans)) do
      for _, event in ipairs(tr.events or {}) do set[event] = true end
    end
  end
  return names.sorted(set), set
end

--- Does a transition of a machine name an event? A predicate may stand for any.
---@param fsm rfsm.Machine
---@param event any
---@return boolean
function names.is_event(fsm, event)
  local list, set = names.events(fsm)
  if set[event] or event == "e_init_fsm" then return true end
  if type(event) == "string" and event:find("^e_done") then return true end
  for _, known in ipairs(list) do
    if rfsm.is_callable(known) then return true end
  end
  return false
end

--- List the states and connectors.
---@param fsm rfsm.Machine
---@return string[] list names
---@return table<string, { node: table, fsm: rfsm.Machine }> by_name
function names.nodes(fsm)
  local list, by_name = {}, {}
  for _, machine in ipairs(names.machines(fsm)) do
    for _, node in ipairs(rfsm.elements(machine.fsm, rfsm.is_nr_node)) do
      local name = names.full(machine.prefix, node._fqn)
      list[#list + 1], by_name[name] = name, { node = node, fsm = machine.fsm }
    end
  end
  return list, by_name
end

--- List the events that are texts and come from outside.
---@param fsm rfsm.Machine
---@return string[] events
function names.plain_events(fsm)
  local texts = {}
  for _, event in ipairs((names.events(fsm))) do
    if type(event) == "string" and not event:find("@", 1, true) then
      texts[#texts + 1] = event
    end
  end
  return texts
end

--- Return the hint " (did you mean 'e_go'?)", if there is one.
---@param name string
---@param list any[]
---@return string hint
function names.hint(name, list)
  return (advice.nearest_name(name, list))
end

return names
