--- Deployments by hand: what a file of Orocos deploys, as far as its text shows.
--
-- XML (`.xml`, `.cpf`, with lua-expat) and scripts (`.ops`) of the deployer are read,
-- and Lua files that return the table. Nothing of XML and scripts is run.
--
-- @module rfsm.rtt.launch_system_files
-- @license BSD-3-Clause

local files = require "rfsm.shared.files"
local opts = require "rfsm.shared.options"
local rfsm = require "rfsm"

local error, ipairs, loadfile = error, ipairs, loadfile
local tonumber, type = tonumber, type
local insert, remove = table.insert, table.remove

local launch_system_files = {}

--- What a file deploys.
---@class rfsm.rtt.Deployment
---@field file string
---@field components table<string, rfsm.rtt.Deployed>
---@field connections rfsm.rtt.Connection[]

--- A component of a deployment.
---@class rfsm.rtt.Deployed
---@field name string
---@field line integer where the file loads it
---@field text string all that the file says of its launch
---@field enters_at_start boolean
---@field ports { port: string, connection: string }[] ports of XML

--- A connection of a deployment.
---@class rfsm.rtt.Connection
---@field line integer where the file makes it
---@field from string "component.port"
---@field to string
---@field kind "buffer"|"data"
---@field size integer

local KINDS = { ["0"] = "data", ["1"] = "buffer", DATA = "data", BUFFER = "buffer" }

-- Returns a connection with the policy of a table of texts; RTT's default is data.
local function new_connection(line, from, to, policy)
  local kind = KINDS[policy and policy.type or "0"] or "buffer"
  return { line = line, from = from, to = to, kind = kind,
    size = kind == "buffer" and tonumber(policy.size or 0) or 1 }
end

local function component_of(found, name, line)
  local component = found.components[name]
    or { name = name, line = line or 1, text = "", enters_at_start = false, ports = {} }
  found.components[name] = component
  return component
end

-- Adds to what is known of a component's launch. The text of a file that the component
-- executes is read as well.
local function add_text(found, name, text)
  local component = component_of(found, name)
  for file in text:gmatch("[\"']([^\"'%s]+%.lua)[\"']") do
    text = text .. "\n" .. (files.read(file) or "")
  end
  component.text = component.text .. "\n" .. text
  if text:find("enter%s*=%s*\\?[\"']start") then component.enters_at_start = true end
end

-- Returns the name of a port of a launch, which may be a setting of it.
local function port_of(component, setting, default)
  return component.text:match("%f[%w_]" .. setting .. "%s*=%s*\\?[\"']([%w_]+)")
    or default
end

--- Return the port of a component to which its machine writes all events.
function launch_system_files.outport(component)
  return component.name .. "." .. port_of(component, "ev_outport", "events_out")
end

-- XML ................................................................................

-- Returns the outermost element of a file: { tag =, name =, type =, line =, text = },
-- with the elements in it as items.
local function read_elements(file, text)
  local lxp, parser = opts.need("rfsm check --deployed", "lxp"), nil
  local around = { { text = "" } }
  parser = lxp.new {
    StartElement = function(_, tag, fields)
      local element = { tag = tag, name = fields.name, type = fields.type, text = "",
        line = (parser:pos()) }
      insert(around[#around], element)
      insert(around, element)
    end,
    CharacterData = function(_, part)
      around[#around].text = around[#around].text .. part
    end,
    EndElement = function() remove(around) end,
  }
  local is_read, problem, line = parser:parse(text)
  if is_read then is_read, problem, line = parser:parse() end
  return is_read and around[1][1] or error(("%s:%d: %s"):format(file, line, problem), 0)
end

-- Returns the values of the simple properties of a struct, by name and as a list.
local function values_of(struct)
  local values, list = {}, {}
  for _, simple in ipairs(struct) do
    for _, element in ipairs(simple.tag == "simple" and simple or {}) do
      if element.tag == "value" then
        values[simple.name] = element.text:match("^%s*(.-)%s*$")
        insert(list, { port = simple.name, connection = values[simple.name] })
      end
    end
  end
  return values, list
end

local function read_component(found, struct)
  local component = component_of(found, struct.name, struct.line)
  for _, bag in ipairs(struct) do
    local values, list = values_of(bag)
    add_text(found, struct.name, values.lua_string or "")
    if bag.name == "Ports" then component.ports = list end
  end
end

-- Lists all ports as { path =, connection =, is_out = }.
local function ports_of(found)
  local list = {}
  for _, name in ipairs(rfsm.sorted_keys(found.components)) do
    local component = found.components[name]
    local out = launch_system_files.outport(component)
    for _, each in ipairs(component.ports) do
      local path = name .. "." .. each.port
      list[#list + 1] = { path = path, connection = each.connection,
        is_out = path == out, line = component.line }
    end
  end
  return list
end

-- Adds a connection from each port for writing to each other port of its name.
local function join_ports(found, policies)
  local ports = ports_of(found)
  for _, from in ipairs(ports) do
    for _, to in ipairs(ports) do
      if from.is_out and not to.is_out and from.connection == to.connection then
        found.connections[#found.connections + 1] =
          new_connection(from.line, from.path, to.path, policies[from.connection])
      end
    end
  end
end

local function read_xml(found, text)
  local policies = {}
  for _, struct in ipairs(read_elements(found.file, text)) do
    if struct.type == "ConnPolicy" then
      policies[struct.name] = values_of(struct)
    elseif struct.tag == "struct" and struct.type ~= "PropertyBag" then
      read_component(found, struct)
    end
  end
  join_ports(found, policies)
end

-- Scripts ............................................................................

local CONNECT = "%f[%w_]connect%s*%(%s*\"([^\"]+)\"%s*,%s*\"([^\"]+)\"%s*,%s*([%w_]+)"

-- Returns a line of a script without its comment.
local function code_of(line)
  return (line:gsub("^%s*#.*", ""):gsub("%s//.*", ""):gsub("^//.*", ""))
end

local function read_ops(found, text)
  local policies, number = {}, 0
  for whole_line in (text .. "\n"):gmatch("(.-)\n") do
    local line = code_of(whole_line)
    number = number + 1
    local variable, field, value = line:match("([%w_]+)%.(%w+)%s*=%s*([%w_]+)")
    if field == "type" or field == "size" then
      policies[variable] = policies[variable] or {}
      policies[variable][field] = value
    end
    local from, to, policy = line:match(CONNECT)
    if from then
      found.connections[#found.connections + 1] =
        new_connection(number, from, to, policies[policy])
    end
    local name = line:match("loadComponent%s*%(%s*\"([^\"]+)\"")
    if name then component_of(found, name, number) end
    name = line:match("^%s*([%w_]+)%.")
    if name and found.components[name] then add_text(found, name, line) end
  end
end

-- Lua ................................................................................

local function read_lua(found, file)
  local chunk, problem = loadfile(file)
  local given = (chunk or error(problem, 0))()
  local is_right = type(given) == "table" and type(given.components) == "table"
    and type(given.connections) == "table"
  if not is_right then
    error(file .. ": table with components and connections expected, "
      .. opts.got(given), 0)
  end
  for _, name in ipairs(rfsm.sorted_keys(given.components)) do
    local component = component_of(found, name)
    component.enters_at_start = given.components[name].enter == "start"
  end
  for _, each in ipairs(given.connections) do
    found.connections[#found.connections + 1] = { line = 1, from = each.from,
      to = each.to,
      kind = each.kind or "buffer",
      size = each.kind == "data" and 1 or each.size or 16 }
  end
end

--- Read what a file deploys.
-- @raise if the file cannot be read, or its ending is not known
---@param file string
---@return rfsm.rtt.Deployment
function launch_system_files.read(file)
  local text, problem = files.read(file)
  if not text then error(problem, 0) end
  local found = { file = file, components = {}, connections = {} }
  local ending = file:match("%.(%w+)$")
  if ending == "xml" or ending == "cpf" then
    read_xml(found, text)
  elseif ending == "ops" or ending == "osd" then
    read_ops(found, text)
  elseif ending == "lua" then
    read_lua(found, file)
  else
    error(file .. ": a file .xml, .cpf, .ops or .lua expected", 0)
  end
  return found
end

return launch_system_files
