--- Deployments by hand: what a file of Orocos deploys, as far as its text shows.
--
-- XML (`.xml`, `.cpf`) and scripts (`.ops`) of the deployer are read, and Lua files
-- that return the table. Nothing of XML and scripts is run.
--
-- @module rfsm.rtt.launch_system_files
-- @license BSD-3-Clause

local files = require "rfsm.shared.files"
local opts = require "rfsm.shared.options"
local rfsm = require "rfsm"

local error, ipairs, loadfile, select = error, ipairs, loadfile, select
local tonumber, type = tonumber, type

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

local VALUE = "<simple[^>]-name=\"([^\"]+)\"[^>]*>%s*<value>%s*(.-)%s*</value>"

local ENTITIES = { lt = "<", gt = ">", quot = '"', apos = "'", amp = "&" }

local function line_at(text, at)
  return select(2, text:sub(1, at - 1):gsub("\n", "")) + 1
end

local function blank(text) return (text:gsub("[^\n]", " ")) end

-- Calls f(name, type, text, line) for each outermost struct of a text.
local function each_struct(text, f)
  local depth, name, kind, from = 0, nil, nil, nil
  for at, slash, fields, behind in text:gmatch("()<(/?)struct([^>]*)>()") do
    if slash == "/" then depth = depth - 1 else depth = depth + 1 end
    if depth == 1 and slash == "" then
      name, kind, from = fields:match("name=\"([^\"]*)\""),
        fields:match("type=\"([^\"]*)\""), behind
    elseif depth == 0 and slash == "/" and name then
      f(name, kind, text:sub(from, at - 1), line_at(text, from))
    end
  end
end

local function values_of(text)
  local values = {}
  for name, value in text:gmatch(VALUE) do
    values[name] = value:gsub("&(%a+);", ENTITIES)
  end
  return values
end

local function read_component(found, name, text, line)
  local component = component_of(found, name, line)
  local values = values_of(text)
  add_text(found, name, values.lua_string or "")
  each_struct(text, function(bag, _, inner)
    for port, connection in (bag == "Ports" and inner or ""):gmatch(VALUE) do
      component.ports[#component.ports + 1] = { port = port, connection = connection }
    end
  end)
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
  each_struct((text:gsub("<!%-%-.-%-%->", blank)), function(name, kind, inner, line)
    if kind == "ConnPolicy" then
      policies[name] = values_of(inner)
    elseif kind ~= "PropertyBag" then
      read_component(found, name, inner, line)
    end
  end)
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
