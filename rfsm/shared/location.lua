--- Locations: path and name of an element, its ancestors, its regions.
--
-- @module rfsm.shared.location
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"

local error, ipairs, table, type = error, ipairs, table, type
local concat, sort = table.concat, table.sort
local text_of = rfsm.text_of

local location = {}

--- Split a text that begins with a location into the file and the rest.
---@param text string "chart.lua:7: root.trans[2]"
---@return string file "chart.lua:7: "; empty if it is not known
---@return string rest "root.trans[2]"
function location.split(text)
  local file, rest = text:match("^(.-:%d+: )(root.*)$")
  return file or "", rest or text
end

--- Return the location of an element without file and line.
function location.of(obj)
  local _, rest = location.split(rfsm.location_of(obj))
  return rest
end

--- Return the path of an element: "root.a.trans[2]", in a region "root.par.left.a".
---@param obj rfsm.State|rfsm.Transition|rfsm.Connector
---@param prefix? string prefix of the element's machine, from `rfsm.machines`
function location.path(obj, prefix)
  local path = obj._fqn or location.of(obj):gsub(" %(.* %-> .*%)$", "")
  return prefix and prefix .. path:sub(5) or path
end

--- Traverse the elements of a machine and its regions. `for at, element in` has the
--- entry of `rfsm.machines` for the machine of each element.
---@param fsm rfsm.Machine
---@param is_wanted? fun(element: table): boolean
function location.each(fsm, is_wanted)
  local places, number, list, i = rfsm.machines(fsm), 0, {}, 0
  return function()
    i = i + 1
    while list[i] == nil and places[number + 1] do
      number, i = number + 1, 1
      list = rfsm.elements(places[number].machine, is_wanted)
    end
    return list[i] and places[number], list[i]
  end
end

--- List the nodes from `fsm`, a machine or composite, down to a node inside it.
function location.line(fsm, node)
  local line = { node }
  while line[1] ~= fsm do table.insert(line, 1, line[1]._parent) end
  return line
end

--- List the nodes whose transitions are tried while a leaf is active, in order. If
--- `leaf` is false, the machine was not entered: its initial connector is tried.
function location.tried(fsm, leaf)
  if leaf then return location.line(fsm, leaf) end
  return { rfsm.is_composite(fsm) and fsm.initial or nil }
end

--- List the transitions that are tried while a leaf is active, in order. If `leaf` is
--- false, the machine was not entered.
function location.transitions(fsm, leaf)
  local list = {}
  for _, node in ipairs(location.tried(fsm, leaf)) do
    for _, tr in ipairs(node._otrs) do list[#list + 1] = tr end
  end
  return list
end

--- List the regions of a state with their names, sorted by name.
---@return { name: string, machine: rfsm.Machine }[] regions
function location.regions_of(state)
  local regions, machines = {}, {}
  local list, own = rfsm.regions(state)
  for i, machine in ipairs(list) do machines[own.names[i]] = machine end
  for i, name in ipairs(rfsm.sorted_keys(machines)) do
    regions[i] = { name = text_of(name), machine = machines[name] }
  end
  return regions
end

--- Return the text in front of findings about a region, such as "root.par.left: ";
--- empty for findings about the machine itself.
function location.prefix(prefix) return prefix ~= "root" and prefix .. ": " or "" end

--- Return the location of an element, such as "root.par.left: root.a" in a region.
function location.in_words(obj, prefix)
  return location.prefix(prefix) .. location.of(obj)
end

--- Raise an error which says that no element of a kind has the name.
---@param name any
---@param kind string such as "state"
---@param names string[] the names that exist
function location.refuse_name(name, kind, names)
  local hint = type(name) == "string" and advice.nearest_name(name, names) or ""
  for _, other in ipairs(names) do
    local is_end = type(name) == "string" and other:sub(-#name - 1) == "." .. name
    if is_end then hint = (" (did you mean '%s'?)"):format(other) end
  end
  error(("no %s is named '%s'%s"):format(kind, rfsm.text_of(name), hint), 0)
end

--- Is a node the state itself, or inside the state?
function location.is_inside(node, state)
  local prefix = state._fqn .. "."
  return (node._fqn .. "."):sub(1, #prefix) == prefix
end

--- Does a transition lead from a connector in a composite out of the composite? Then
--- one step may enter and leave the composite.
---@param state rfsm.State
---@return boolean
function location.is_passable(state)
  local is_found = false
  rfsm.mapfsm(function(connector)
    for _, tr in ipairs(connector._otrs) do
      is_found = is_found or not location.is_inside(tr.tgt, state)
    end
  end, state, rfsm.is_conn)
  return is_found
end

-- Names without numbers, so that tests stay right if a chart is reordered .............

--- Return the name of a node: its FQN without "root.". As a target, `initial` has the
--- name of its composite.
---@param node rfsm.State|rfsm.Connector
---@param prefix string prefix of the node's machine
---@param is_target? boolean
function location.name_of(node, prefix, is_target)
  if is_target and rfsm.is_conn(node) and node._id == "initial" then
    node = node._parent
  end
  return (location.path(node, prefix):gsub("^root%.", ""))
end

-- Returns the text of an event, without "@" and the FQN of its transition's source.
local function short_name(event, tr)
  local text, behind = rfsm.event_text(event), "@" .. tr.src._fqn
  return text:sub(-#behind) == behind and text:sub(1, -#behind - 1) or text
end

local function transition_name(tr, prefix)
  local texts = {}
  for i, event in ipairs(tr.events or {}) do texts[i] = short_name(event, tr) end
  sort(texts, rfsm.text_before)
  return location.name_of(tr.src, prefix) .. " -" .. concat(texts, ", ") .. "-> "
    .. (rfsm.target_of(tr) == "internal" and "internal"
      or location.name_of(tr.tgt, prefix, true))
end

--- Set the field `name` of transitions: "off -e_on-> on". If two transitions of a node
--- have the same source, target and events, the name of the second ends in " #2".
---@param entries { tr: rfsm.Transition, prefix: string, name: string }[]
function location.add_names(entries)
  for _, entry in ipairs(entries) do
    local name = transition_name(entry.tr, entry.prefix)
    local rank = 1
    for _, other in ipairs(entry.tr.src._otrs) do
      if other == entry.tr then break end
      if transition_name(other, entry.prefix) == name then rank = rank + 1 end
    end
    entry.name = rank > 1 and name .. " #" .. rank or name
  end
end

return location
