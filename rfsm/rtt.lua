--- Machines and the ports of Orocos RTT-Lua.
--
-- `gen_read_events` and `gen_read_str_events` make a `getevents` that reads input
-- ports, `gen_raise_event` makes a function that sends events to an output port, and
-- `gen_write_fqn` makes a hook that writes the FQN of the active leaf. The launchers,
-- `rfsm.rtt.component` and `rfsm.rtt.launch`, are loaded when they are used.
--
-- RTT's Variables are made once and reused, so that reading, raising and writing
-- allocate nothing in the steady state. The module loads without RTT, and needs no
-- rttlib. In a Lua whose memory is a TLSF pool, loading this module makes the garbage
-- collector work harder, machines do not use rfsm.fast, and the modules are those
-- without debug information, where `make install` has put them beside the others. With
-- a global RFSM_STRIPPED that is true or false, these are taken always or never.
--
-- @module rfsm.rtt
-- @license BSD-3-Clause

local collectgarbage, debug, error = collectgarbage, debug, error
local ipairs, loadfile, package, pcall = ipairs, loadfile, package, pcall
local rawget, rawset, require, select = rawget, rawset, require, select
local setmetatable, type = setmetatable, type
local min = math.min

-- The folder of the library. The module without debug information does not know it.
local folder = select(3, ...)

if not folder then
  local is_wanted, stripped = rawget(_G, "RFSM_STRIPPED"), nil
  if is_wanted == nil then is_wanted = rawget(_G, "tlsf") ~= nil end
  folder = debug.getinfo(1, "S").source:match("^@(.*)rfsm[/\\]rtt%.lua$")
  if is_wanted and folder then
    stripped = loadfile(folder .. "rfsm/stripped/rfsm/rtt.lua")
  end
  if stripped then
    package.path = folder .. "rfsm/stripped/?.lua;" .. package.path
    return stripped((...), nil, folder)
  end
end

-- RTT's Lua 5.1 does not start a collection when memory is short, and a component fails
-- when its TLSF pool is full. So with a pool the collector never pauses, and completes
-- a cycle before 5 % of the heap are garbage.
if rawget(_G, "tlsf") then
  pcall(collectgarbage, "setpause", 100)
  pcall(collectgarbage, "setstepmul", 3000)
end

local rfsm = require "rfsm"
local held_port = require "rfsm.rtt.port"

local info_of, new_variables = held_port.info_of, held_port.new_variables
local port_problem = held_port.problem

-- What the core keeps in place of rfsm/advice.lua in a pool, where that would take more
-- than a chart of five states: it is loaded for problems, and dropped with the launch.
-- Fields of a state that may be mistakes are left to `rfsm check`.
local hints = setmetatable({ datum = function() return "" end }, {
  __index = function(self, topic)
    local loaded = package.loaded
    if loaded["rfsm.advice"] == self then loaded["rfsm.advice"] = nil end
    return require("rfsm.advice")[topic]
  end,
})

-- rfsm/fast.lua would generate code that takes 2 KiB of the pool for each state.
if rawget(_G, "tlsf") then
  rfsm.save_memory()
  package.loaded["rfsm.advice"] = hints
end

---@class rfsm.rtt
---@field folder string? the folder of the library, with a slash at its end
---@field launched rfsm.rtt.Launched? the latest launch in this Lua
---@field declared rfsm.rtt.Declared? what the latest call of `ports` has made
---@field gen_raise_event fun(port: any, fsm?: rfsm.Machine): fun(...: any)
---@field placeholders table? what stands for OCL's rttlib until it is used
---@field service_launch_rfsm fun(file: string, exec_str: function, ...): boolean
---@field component_launch_rfsm fun(args: rfsm.rtt.Launch): any
---@field launch_system fun(file: string, options?: table): rfsm.rtt.LaunchedSystem
---@field service_halt_rfsm fun(component: any, seconds?: number): boolean
---@field service_resume_rfsm fun(exec_str: function)
local rfsm_rtt = { folder = folder }

-- Reading ----------------------------------------------------------------------------

-- Does the status of a read mean a new sample? RTT returns the status as a string. The
-- keys of this table keep the three strings alive, so that no read allocates one.
local IS_NEW = { NewData = true, OldData = false, NoData = false }

-- Returns a function that appends new samples of a port to a list, at most as many as
-- the list needs to have `most` events. It returns true if the port may have more.
local function new_reader(port)
  local var, double = new_variables(port)
  local convert = held_port.converter(port)
  return function(events, most)
    for _ = #events + 1, most do
      local status, event = port:read(var)
      if not IS_NEW[status] then return false end
      if double then double:assign(var) end
      if var then event = (double or var):tolua() end
      if convert then event = convert(event) end
      events[#events + 1] = event
    end
    return true
  end
end

-- Returns a function that triggers one more update of the component in which this Lua
-- runs. The function does nothing without RTT, or if this Lua runs in a service.
local function new_trigger()
  local rtt = package.loaded.rtt
  local own = rtt and rtt.getTC()
  local is_lua_component = own and own:hasOperation("exec_str")
  return is_lua_component and own:getOperation("trigger") or function() end
end

-- The default limit of samples that one call reads from each port. Without a limit the
-- samples of a long burst might not fit in a TLSF pool.
local MOST = 64

-- Makes a `getevents` that reads ports. Errors about wrong ports blame the caller of
-- the public function. If a read raises an error, the events read before are kept for
-- the next call. Samples that are left trigger no update, so the call triggers one.
local function gen_reader(where, kind, ...)
  local bound, readers, is_taken = (...), {}, false
  local has_bound = type(bound) == "number" and bound >= 1
  local ports = { select(has_bound and 2 or 1, ...) }
  local n = select("#", ...) - (has_bound and 1 or 0)
  if not has_bound then bound = MOST end
  local events = { nil, nil, nil, nil, nil, nil, nil, nil } -- room for eight events
  if n == 0 then error(where .. ": at least one port expected, got none", 3) end
  for i = 1, n do
    local problem = port_problem(ports[i], "read", kind)
    if problem then error(("%s: port %d: %s"):format(where, i, problem), 3) end
    readers[i] = new_reader(ports[i])
  end
  local trigger = new_trigger()
  return function()
    for i = is_taken and #events or 0, 1, -1 do events[i] = nil end
    is_taken = false
    local has_more = false
    for i = 1, n do
      local most = min(#events + bound, i * bound) -- kept events count, too
      has_more = readers[i](events, most) or has_more
    end
    is_taken = true
    if has_more then trigger() end
    return events
  end
end

--- Make a `getevents` that reads new samples of input ports, in the order of the ports.
--
-- A call reads at most 64 samples of each port, or the number that is given before the
-- ports. If samples are left, the call triggers one more update of a Lua component.
--
-- A sample becomes a Lua value if a type of Lua matches its type; otherwise it is a new
-- Variable. The returned list is valid until the next call.
--
-- @usage
--    fsm.getevents = rfsm_rtt.gen_read_events(commands, alarms)
--
-- @raise when a port is no input port
---@param ... any one or more input ports, after an optional number of samples
---@return fun(): any[] getevents
---@nodiscard
function rfsm_rtt.gen_read_events(...)
  return (gen_reader("rfsm.rtt.gen_read_events", nil, ...))
end

--- Make a `getevents` as `gen_read_events` does, but for input ports of type string.
-- @raise when a port is no input port of type string
---@param ... any one or more input ports, after an optional number of samples
---@return fun(): string[] getevents
---@nodiscard
function rfsm_rtt.gen_read_str_events(...)
  return (gen_reader("rfsm.rtt.gen_read_str_events", "string", ...))
end

-- Writing ----------------------------------------------------------------------------

--- Make a post step hook that writes the FQN of the active leaf to a string port.
--
-- The hook writes only if the leaf has changed. It writes `<none>` at once and at each
-- reset. If the port was deleted, the hook writes to a port of the same name.
--
-- @usage
--    rfsm.post_step_hook_add(fsm, rfsm_rtt.gen_write_fqn(port))
--
-- @raise when the port is no output port of type string
---@param port any output port
---@return fun(fsm: rfsm.Machine) hook
---@nodiscard
function rfsm_rtt.gen_write_fqn(port)
  local problem = port_problem(port, "write", "string")
  if problem then error("rfsm.rtt.gen_write_fqn: " .. problem, 2) end
  local held = held_port.hold(port, info_of(port))
  local write, written = held_port.new_writer(held), setmetatable({}, { __mode = "k" })
  local function write_change(fsm)
    local leaf = fsm._act_leaf
    local fqn = leaf and leaf._fqn or "<none>"
    if fqn == written[fsm] then return end
    write(held.samples[fqn] or fqn) -- RTT needs long to convert a text
    written[fsm] = fqn
  end
  local function write_reset(fsm)
    held:find()
    write_change(fsm)
  end
  write("<none>")
  return rfsm.borrows(function(fsm)
    if not written[fsm or false] then
      rfsm.check_machine(fsm, "rfsm.rtt.write_fqn")
      written[fsm] = "<none>"
      rfsm.reset_hook_add(fsm, write_reset)
    end
    write_change(fsm)
  end)
end

-- Launchers: loaded when they are used ---------------------------------------------

--- Return the reason why a launch has failed; if memory was short, also a remedy.
---@param problem any
---@return string reason
function rfsm_rtt.reason(problem)
  pcall(collectgarbage)
  local text = rfsm.text_of(problem)
  if not text:find("not enough memory", 1, true) then return text end
  if not text:find(" KiB ", 1, true) then -- it was short before the launch began
    text = ("%s while the library is loaded, %.0f KiB in use without that"):format(text,
      collectgarbage("count"))
  end
  return text .. ": enlarge the pool by `pool = KIB` of the launch; 'rfsm size' prints "
    .. "how much a chart needs"
end

local NOT_NEEDED = {
  "rfsm.rtt.component", "rfsm.rtt.update", "rfsm.rtt.settings", "rfsm.rtt.inputs",
  "rfsm.rtt.rttlib", "rfsm.shared.options", "rfsm.shared.limit", "rfsm.shared.calls",
  "rfsm.advice",
}

--- Forget the modules that a launch has loaded, so that they become garbage. A launch
-- also calls this first: Lua 5.1 never loads a module again if loading it once failed.
-- This takes no memory, which may be why the launch has failed.
function rfsm_rtt.forget_modules()
  local loaded = package.loaded
  for _, name in ipairs(NOT_NEEDED) do
    if loaded[name] ~= nil then loaded[name] = nil end -- nil for a new key takes memory
  end
  if rawget(_G, "tlsf") then package.loaded["rfsm.advice"] = hints end
end

--- Make the input ports of a machine that this component will launch.
--
-- Say this where the file of the component begins. Then the ports are there before the
-- component is configured, and can be connected. `launch` takes them without a word.
--
-- @usage
--    rfsm_rtt.ports {
--      { "stop_in" },
--      { "arm_in", prefix = "arm" },
--      { "force_in", type = "Force", event = is_contact, edge = true },
--    }
--
-- @raise when an entry is wrong, or a port cannot be made: then none is left. Also when
-- one of an earlier call is missing.
---@param list rfsm.rtt.Input[]
function rfsm_rtt.ports(list)
  local ok, why = pcall(function() require("rfsm.rtt.inputs").declare(list) end)
  rfsm_rtt.forget_modules()
  if not ok then error("rfsm.rtt.ports: " .. rfsm.text_of(why), 2) end
end

--- Launch a machine in the component of this Lua, in its configureHook.
--
-- The component gets ports, attributes, and hooks that run the machine. A later call
-- loads the chart again and launches a new machine. Existing ports stay connected.
--
-- @usage
--    function configureHook()
--      return rfsm_rtt.launch { fsmfile = "gripper.lua" }
--    end
--
-- @raise when an argument is wrong or the launch fails; then no port is left
---@param args rfsm.rtt.Launch
---@return boolean launched true
function rfsm_rtt.launch(args)
  if rfsm_rtt.launched then rfsm_rtt.launched:forget() end
  rfsm_rtt.forget_modules()
  local ok, why = pcall(function() require("rfsm.rtt.component").launch(args) end)
  if ok then ok, why = pcall(rfsm_rtt.launched.finish, rfsm_rtt.launched) end
  rfsm_rtt.forget_modules()
  if not ok then error("rfsm.rtt.launch: " .. rfsm_rtt.reason(why), 2) end
  return true
end

local FILES = { gen_raise_event = "rfsm.rtt.raise" }
for _, name in ipairs { "service_launch", "service_halt", "service_resume",
  "component_launch" } do
  FILES[name .. "_rfsm"] = "rfsm.rtt.launch"
end

setmetatable(rfsm_rtt, { __index = function(_, name)
  if name == "launch_system" then return require("rfsm.rtt.launch_system").launch end
  return FILES[name] and require(FILES[name])[name]
end })

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_rtt", rfsm_rtt) end

return rfsm_rtt
