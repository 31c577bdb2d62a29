--- Events from ports and to ports of Orocos RTT, and the FQN of the active leaf.
--
-- RTT's Variables are made once and reused, so that reading, raising and writing
-- allocate nothing in the steady state. rfsm.rtt loads this file when it is used, and
-- forgets it after a launch.
--
-- @submodule rfsm.rtt
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local held_port = require "rfsm.rtt.port"

local error, package, select, setmetatable = error, package, select, setmetatable
local tostring, type = tostring, type
local min = math.min

local new_variables, port_problem = held_port.new_variables, held_port.problem

local rfsm_rtt = {}

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

-- Returns the problem if a port of type `kind` cannot take an event; nil if it can.
local function event_problem(kind, event)
  if event == nil or not kind then return nil end
  local wanted, actual = held_port.LUA_TYPES[kind], type(event)
  if actual == wanted or kind == "bool" and actual == "number" then return nil end
  actual = held_port.has_method(event, "getType") and event:getType()
  if actual == kind then return nil end
  return (wanted or "Variable of type " .. kind) .. " expected, "
    .. (actual and "got a Variable of type " .. tostring(actual) or rfsm.got(event))
end

--- Make a function that writes each of its arguments to an output port.
--
-- With `fsm`, the function also sends the arguments to this machine. It skips nil. If
-- the port cannot take one of the events, it raises an error and writes none.
--
-- @usage
--    local raise_event = rfsm_rtt.gen_raise_event(port)
--    raise_event("e_grasped", "e_ready")
--
-- @raise when the port is no output port, or `fsm` no machine
---@param port any output port
---@param fsm? rfsm.Machine
---@return fun(...: any) raise_event
---@nodiscard
function rfsm_rtt.gen_raise_event(port, fsm)
  local problem = held_port.problem(port, "write")
  if problem then error("rfsm.rtt.gen_raise_event: " .. problem, 2) end
  if fsm ~= nil then rfsm.check_machine(fsm, "rfsm.rtt.gen_raise_event") end
  local kind, write = held_port.info_of(port).type, held_port.new_writer(port)
  return function(...)
    local n = select("#", ...)
    for i = 1, n do
      local obstacle = event_problem(kind, (select(i, ...)))
      if obstacle then
        error(("rfsm.rtt.raise_event: event %d: %s"):format(i, obstacle), 2)
      end
    end
    for i = 1, n do
      local event = select(i, ...)
      if event ~= nil then
        write(event)
        if fsm then rfsm.send_events(fsm, event) end
      end
    end
  end
end

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
  local held = held_port.hold(port, held_port.info_of(port))
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

return rfsm_rtt
