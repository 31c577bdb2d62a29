--- The settings of a launch: their names and older names, tests, and defaults.
--
-- @module rfsm.rtt.settings
-- @license BSD-3-Clause

local options = require "rfsm.shared.options"

local error, ipairs, loadfile, require = error, ipairs, loadfile, require
local type = type
local huge = math.huge

local settings = {}

--- The arguments of a launch, with defaults in parentheses. Only the launch of a new
-- component takes `name`, `luatype` and "configure" as `ports`. The launch of a service
-- takes no `name`, `deployer`, `luatype`, `enter`, `timer` and `pool`.
---@class rfsm.rtt.Launch
---@field name? string name of a new component
---@field deployer? any the deployer, or the name under which it is a peer ("Deployer")
---@field luatype? string type of a new component ("OCL::LuaComponent")
---@field enter? "start" enter the machine in startHook; default: in the first update
---@field ports? "configure"|rfsm.rtt.Input[] input ports whose samples become events,
-- in the order in which they are read; "configure": make ports in configureHook
---@field timer? boolean wake an event-driven component when a time event is due
---@field pool? integer the least size of a TLSF pool in KiB
---@field fsmfile string file of the chart
---@field steps? integer the most steps that one update makes (1000, in a service 1)
---@field samples? integer the most samples that one update reads from each port (64)
---@field running_only? boolean make no steps while the component is stopped
---@field error? boolean call error() of the component if the machine has an error
---@field ev_inport? string|boolean port for events ("events_in"); false: no port
---@field ev_outport? string|boolean name of the port to which `emit_event` writes
-- ("events_out"); false: none
---@field fqn_port? string name of the port for the FQN of the active leaf ("fqn")
---@field prefile? string Lua file to run before the chart is loaded
---@field prestr? string Lua code to run after `prefile`
---@field postfile? string Lua file to run at the end, when the global `fsm` is set
---@field poststr? string Lua code to run after `postfile`
---@field env? table<string, any> globals to set: strings, numbers, booleans, or tables
-- of these
---@field stripped? boolean have the library without its debug information, which takes
-- a third less memory, from where `make install` puts it (true in a pool)
---@field rttlib? boolean load rttlib and utils, which charts rely on (true; in a pool
-- at their first use)
---@field sync? boolean older name of `steps = 1`
---@field run? boolean older name of `steps = 1000`

local function is_anything() return true end
local function is_env(value) return type(value) == "table" and value[1] == nil end
local function is_file(value)
  if type(value) == "string" then return loadfile(value) end
end

local function is_word(word)
  return function(value) return value == word end
end

local function is_list(value) return type(value) == "table" end
local function is_list_or_word(value) return value == "configure" or is_list(value) end

local BOOLEAN = { "boolean", options.is_a "boolean" }
local STRING = { "string", options.is_a "string" }
local FILE, NAME = { "file name", is_file }, { "name", is_anything }
local COUNT = { "whole number, at least 1", options.is_whole(1, huge) }

-- Adds the settings of every launch to a table for `options.read`.
local function with_common(fields)
  fields.env = { "table of globals by name", is_env, {} }
  fields.ports = fields.ports or { "list of ports", is_list }
  fields.fqn_port = { "string", options.is_a "string", "fqn" }
  fields.fsmfile, fields.prefile, fields.postfile = FILE, FILE, FILE
  fields.prestr, fields.poststr = STRING, STRING
  fields.ev_inport, fields.ev_outport = NAME, NAME
  fields.run, fields.sync, fields.error = BOOLEAN, BOOLEAN, BOOLEAN
  fields.running_only, fields.rttlib, fields.stripped = BOOLEAN, BOOLEAN, BOOLEAN
  fields.steps, fields.samples = COUNT, COUNT
  return fields
end

local function with_own(fields)
  fields.deployer, fields.timer, fields.pool = NAME, BOOLEAN, COUNT
  fields.enter = { "'start'", is_word "start" }
  return with_common(fields)
end

-- The settings that each kind of launch accepts: of a machine in a service, in a new
-- component, or in the component that calls `rfsm.rtt.launch` (`own`).
local FIELDS = {
  service = with_common {
    exec_str = { "operation exec_str", is_anything }, eehook = BOOLEAN,
  },
  component = with_own {
    name = STRING, luatype = STRING,
    ports = { "list of ports", is_list_or_word },
  },
  own = with_own {},
}
local REQUIRED = { "name", "fsmfile", "exec_str" } -- if the kind of launch has it

local STEPS = 1000 -- the most steps of an update; the next update goes on from there

-- Sets `steps`, the most steps of an update. `sync` and `run` are its older names.
local function set_steps(launch)
  if launch.steps and (launch.sync or launch.run) then
    error("steps: expected without sync and run, which are numbers of steps", 0)
  end
  local runs = launch.run or launch.is_component and not launch.sync
  launch.steps = launch.steps or runs and STEPS or 1
end

-- Sets `inputs`, the list of the ports in `ports`.
local function set_inputs(launch)
  if type(launch.ports) ~= "table" then return end
  launch.inputs, launch.ports = require("rfsm.rtt.inputs").read(launch.ports), nil
end

--- Return the settings of a launch; raise an error if one is wrong or is missing.
---@param kind "service"|"component"|"own"
---@param args table
function settings.read(kind, args)
  local fields = FIELDS[kind]
  local launch, problem = options.read(fields, args)
  if not launch then error(problem, 0) end
  for _, name in ipairs(REQUIRED) do
    if fields[name] and launch[name] == nil then
      error(name .. ": " .. fields[name][1] .. " expected, got nil", 0)
    end
  end
  launch.is_component, launch.is_own = kind ~= "service", kind == "own"
  set_steps(launch)
  set_inputs(launch)
  launch.samples = launch.samples or 64
  return launch
end

return settings
