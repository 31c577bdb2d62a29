--- What a deployment by hand does not do as the description of a system says.
--
-- @module rfsm.rtt.launch_system_deployed
-- @license BSD-3-Clause

local deployments = require "rfsm.rtt.launch_system_files"
local match = require "rfsm.shared.match"
local replacements = require "rfsm.explore.replacements"
local static = require "rfsm.checks.static"

local ipairs = ipairs
local concat = table.concat

local launch_system_deployed = {}

local function is_of(path, name) return path:match("^(.-)%.") == name end

-- Lists the connections of a deployment from one machine to another one.
local function between(deployed, from, to)
  local list = {}
  for _, each in ipairs(deployed.connections) do
    if is_of(each.from, from) and is_of(each.to, to) then list[#list + 1] = each end
  end
  return list
end

local function wires_between(cell, from, to)
  local list, numbers, events = {}, {}, {}
  for _, wire in ipairs(cell.wires) do
    if wire.from == from and wire.to == to then
      list[#list + 1], numbers[#numbers + 1] = wire, ("wires[%d]"):format(wire.number)
      events = match.joined(events, wire.events)
    end
  end
  return list, concat(numbers, ", "), events
end

local function name_of(connection) return connection.from .. " -> " .. connection.to end

local function size_text(each)
  return each.kind == "data" and "data" or "buffer of " .. each.size
end

-- Reports events that go from one machine to another one, though no wire carries them:
-- the connection begins at a port to which the machine writes all that it emits.
local function add_foreign(add, cell, deployed, connection, from, to, events)
  local component = deployed.components[from]
  if not component or connection.from ~= deployments.outport(component) then return end
  local emitted = replacements.emitted_by(static.init(cell.models[from], false))
  if not emitted then
    return add(connection, name_of(connection), ("what else '%s' emits is not known, "
      .. "and all of it goes to '%s'"):format(from, to))
  end
  for _, event in ipairs(emitted) do
    if not match.has(events, event) then
      add(connection, name_of(connection), ("'%s' goes to '%s', and no wire carries it")
        :format(event, to))
      events = match.with(events, event) -- told once
    end
  end
end

-- Compares the wires between two machines with the connections between them.
local function check_pair(add, cell, deployed, from, to)
  local list, numbers, events = wires_between(cell, from, to)
  local connections = between(deployed, from, to)
  if list[1] and not connections[1] then
    add(deployed.components[from], numbers, ("no connection leads from '%s' to '%s'")
      :format(from, to))
  elseif #list > #connections then
    add(connections[1], numbers, ("they share %s, so they are one queue"):format(
      name_of(connections[1])))
  end
  for i, connection in ipairs(connections) do
    local wire = #list == #connections and list[i]
    if wire and size_text(wire) ~= size_text(connection) then
      add(connection, ("wires[%d]"):format(wire.number), ("%s is %s, not %s"):format(
        name_of(connection), size_text(connection), size_text(wire)))
    elseif i > 1 and connection.from == connections[1].from then
      add(connection, name_of(connection), ("with %s each event comes twice"):format(
        name_of(connections[1])))
    end
    add_foreign(add, cell, deployed, connection, from, to, events)
  end
end

--- Add a finding for all that a deployment does not do as a system says.
---@param cell rfsm.System
---@param deployed rfsm.rtt.Deployment
---@param findings table a list of `rfsm.checks.static`
function launch_system_deployed.check(cell, deployed, findings)
  local function add(made, place, text)
    findings:add("deployed", nil, place, text, nil, ("%s:%d: "):format(deployed.file,
      made and made.line or 1))
  end
  for _, name in ipairs(cell.names) do
    local component = deployed.components[name]
    if not component then
      add(nil, name, "no component has this name")
    elseif not component.enters_at_start then
      add(component, name, "it is entered in its first update, and loses what comes "
        .. "before that")
    end
  end
  for _, from in ipairs(cell.names) do
    for _, to in ipairs(cell.names) do check_pair(add, cell, deployed, from, to) end
  end
end

return launch_system_deployed
