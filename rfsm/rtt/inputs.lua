--- The input ports of a launch whose samples become events: its field `ports`.
--
-- @module rfsm.rtt.inputs
-- @license BSD-3-Clause

local rfsm_rtt = require "rfsm.rtt" -- first: it adapts Lua to a TLSF pool
local rfsm = require "rfsm"
local calls = require "rfsm.shared.calls"
local held_port = require "rfsm.rtt.port"
local options = require "rfsm.shared.options"
local update = require "rfsm.rtt.update"

local debug, error, ipairs, next = debug, error, ipairs, next
local package, pcall, rawget = package, pcall, rawget
local setmetatable, type = setmetatable, type

-- The functions that stay use these locals, so that the modules can be collected.
local got, try = rfsm.got, calls.try

local inputs = {}

--- A port of a launch. It is read after the ports before it in the list, and each read
-- takes at most `samples` samples of it. So a stop stands first, at a port of its own.
---@class rfsm.rtt.Input
---@field [1] string name of the port
---@field type? string type of its samples ("string")
---@field prefix? string put in front of the names of its events: "arm" makes arm.e_done
---@field event? fun(sample: any): any makes the event of a sample: a text, a table with
-- a `name`, or nil or false for no event
---@field edge? boolean make an event only when the answer, or its name, changes

--- What `rfsm.rtt.ports` has made.
---@class rfsm.rtt.Declared
---@field list rfsm.rtt.Input[] the list that was given
---@field inputs rfsm.rtt.Input[] the list that was read

-- Reading the list -----------------------------------------------------------------

local function is_anything() return true end

local function is_prefix(value)
  return type(value) == "string" and value:find("^[^.%c%s(),][^%c%s(),]*$")
    and value:sub(-1) ~= "."
end

local FIELDS = {
  { "name of a port", is_anything },
  type = { "name of a type", options.is_text, "string" },
  prefix = { "name without blanks or a dot at an end", is_prefix },
  event = { "function of a sample", rfsm.is_callable },
  edge = { "boolean", options.is_a "boolean" },
}

-- Returns the problem if a port has a field that needs a function `event`.
local function type_problem(input)
  local kind = held_port.LUA_TYPES[input.type]
  local field = input.prefix and kind ~= "string" and "prefix"
    or input.edge and not kind and "edge"
  if input.event or not field then return nil end
  return ("%s: function in `event` expected at a port of type %s"):format(field,
    input.type)
end

-- Returns the problem if a port has the name or prefix of one before it.
local function twin_problem(input, before)
  for i, other in ipairs(before) do
    if other[1] == input[1] then
      return ("'%s' is the name of ports[%d]"):format(input[1], i)
    elseif input.prefix and other.prefix == input.prefix then
      return ("prefix: '%s' is that of ports[%d], so one name has two senders"):format(
        input.prefix, i)
    end
  end
end

-- Returns an entry of the list with defaults; nil and the problem if it is wrong.
local function read_entry(entry, before)
  if type(entry) ~= "table" then
    local name = type(entry) == "string" and entry or "stop_in"
    return nil, ("table such as { '%s' } expected, %s"):format(name, got(entry))
  elseif not options.is_text(entry[1]) then
    return nil, "name of a port expected, " .. got(entry[1])
  end
  local input, problem = options.read(FIELDS, entry)
  if not input then return nil, problem end
  problem = type_problem(input) or twin_problem(input, before)
  return not problem and input or nil, problem
end

--- Return the list of ports with defaults; raise an error if one is wrong.
---@param list rfsm.rtt.Input[]
---@return rfsm.rtt.Input[] inputs
function inputs.read(list)
  if type(list) ~= "table" then
    error("list of ports expected, " .. options.got(list), 0)
  end
  local read = {}
  for i, key in ipairs(rfsm.sorted_keys(list)) do
    if key ~= i then
      error(("ports: list of ports expected, got the key '%s'"):format(
        rfsm.text_of(key)), 0)
    end
    local input, problem = read_entry(list[i], read)
    if not input then error(("ports[%d]: %s"):format(i, problem), 0) end
    read[i] = input
  end
  return read
end

-- Making the ports -------------------------------------------------------------------

--- Make the ports in a component; return a list of objects of rfsm.rtt.port. If one
-- cannot be made, none is left.
---@param owner any the component
---@param read rfsm.rtt.Input[]
---@param is_trigger boolean does a sample trigger an update of the component?
---@param is_kept boolean are ports taken that the component has already?
function inputs.make(owner, read, is_trigger, is_kept)
  local made = {}
  for i, input in ipairs(read) do
    local held = held_port.reserve(owner, { name = input[1], type = input.type,
      desc = "events for the machine", porttype = "in" })
    held.is_trigger, made[i] = is_trigger, held
    local ok, problem = pcall(held_port.provide, held, is_kept)
    if not ok then
      for _, port in ipairs(made) do held_port.remove(port) end
      error(("ports[%d]: %s"):format(i, rfsm.text_of(problem)), 0)
    end
  end
  return made
end

-- Raises an error if a list of ports lacks one of the list before: it would stay, and
-- nobody would read it.
local function check_complete(read, declared)
  local names = {}
  for _, input in ipairs(read) do names[input[1]] = true end
  for _, input in ipairs(declared and declared.inputs or {}) do
    if not names[input[1]] then
      error(("one list of all ports expected, '%s' of an earlier call is missing")
        :format(input[1]), 0)
    end
  end
end

--- Make the ports before the launch, as `rfsm.rtt.ports` does.
function inputs.declare(list)
  local rtt = package.loaded.rtt
  if not rtt then error("no module 'rtt' in this Lua", 0) end
  local owner, read = rtt.getTC(), inputs.read(list)
  check_complete(read, rfsm_rtt.declared)
  inputs.make(owner, read, owner:hasOperation("exec_str"), true)
  rfsm_rtt.declared = { list = list, inputs = read }
end

-- Samples become events --------------------------------------------------------------

-- Returns the name of an event, also of one that carries data.
local function name_of(event)
  if type(event) == "table" then return rawget(event, "name") end
  return event
end

-- Returns what `event` answers to a sample, raises an error if that is no event.
local function ask(event, sample)
  local answer = event(sample)
  if not answer then return nil end
  local kind = type(answer)
  local name = (kind == "table" or kind == "string") and name_of(answer)
  if type(name) == "string" and name ~= "" then return answer end
  error("event: text, table with a name or nothing expected, " .. got(answer), 0)
end

-- Returns an event with a prefix. An event that carries data is copied, since the
-- function may answer the same table again.
local function prefixed(prefix, event)
  if type(event) ~= "table" then return prefix .. "." .. event end
  local copy = {}
  for key, value in next, event do copy[key] = value end -- any order: a copy
  copy.name = prefix .. "." .. event.name
  return setmetatable(copy, debug.getmetatable(event))
end

--- Return a function that makes the event of a sample; nil if the samples are events.
--
-- If the function `event` fails, the sample is dropped. That is counted as an error of
-- the machine, and logged once a second.
---@param launch rfsm.rtt.Launched
---@param fsm rfsm.Machine
---@param input rfsm.rtt.Input
function inputs.converter(launch, fsm, input)
  local event, prefix, edge = input.event, input.prefix, input.edge
  if not (event or prefix or edge) then return nil end
  local where, last = "rfsm.rtt: port '" .. input[1] .. "': a sample is dropped:", nil
  local tell = update.counted(launch, function(problem)
    launch.log_as(where, "Error", where, problem)
  end)
  if edge then rfsm.reset_hook_add(fsm, function() last = nil end) end
  return function(sample)
    local ok, answer = true, sample
    if event then ok, answer = try(ask, event, sample) end
    if not ok then return tell(answer) end
    local name = name_of(answer)
    if edge and name == last then return nil end
    last = name
    if answer == nil or not prefix then return answer end
    return prefixed(prefix, answer)
  end
end

return inputs
