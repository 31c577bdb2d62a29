--- Machines in the components and services of Orocos RTT-Lua.
--
-- Ports feed machines: `gen_read_events` and `gen_read_str_events` make a getevents of
-- input ports, `gen_raise_event` sends events to an output port, `gen_write_fqn` makes
-- a hook that writes the name of the active leaf. `service_launch_rfsm` puts a chart
-- into a Lua service, `component_launch_rfsm` into a component of its own.
--
-- Variables are made once and used again, so that reading, raising and writing allocate
-- nothing in the steady state. The module loads without RTT; only what needs it asks
-- for it.
--
-- @module rfsm.rtt
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, getmetatable, ipairs, loadfile = error, getmetatable, ipairs, loadfile
local pairs, pcall, rawget, rawset = pairs, pcall, rawget, rawset
local require, select, tostring, type = require, select, tostring, type
local huge, min = math.huge, math.min
local math_type = rawget(math, "type")
local concat, sort = table.concat, table.sort
local io, os, package = io, os, package

local rfsm_rtt = {}

-- What was handed in -----------------------------------------------------------

local function find_rtt()
  local ok, rtt = pcall(require, "rtt")
  if not ok or type(rtt) ~= "table" then rtt = rawget(_G, "rtt") end
  return type(rtt) == "table" and rtt or nil
end

local function is_callable(value)
  if type(value) == "function" then return true end
  local class = getmetatable(value)
  return type(class) == "table" and rawget(class, "__call") ~= nil
end

local function get(value, name) return value[name] end

-- Returns a field of any value; nil where there is none, or asking for it raises, as
-- that of a TaskContext may.
local function field(value, name)
  if type(value) ~= "table" and type(value) ~= "userdata" then return nil end
  local ok, found = pcall(get, value, name)
  if ok then return found end
end

local function has_method(value, name) return is_callable(field(value, name)) end

-- Returns what a port says of itself; an empty table when it says nothing.
local function info_of(port)
  if not has_method(port, "info") then return {} end
  local ok, info = pcall(port.info, port)
  return ok and type(info) == "table" and info or {}
end

local function got(value)
  if type(value) == "string" then return "got string '" .. value .. "'" end
  if type(value) == "number" then return ("got number %.14g"):format(value) end
  local direction = info_of(value).porttype
  if direction == "in" then return "got an input port" end
  if direction == "out" then return "got an output port" end
  return "got " .. type(value)
end

-- Levenshtein's, on two rows.
local function edit_distance(a, b)
  local row = {}
  for j = 0, #b do row[j] = j end
  for i = 1, #a do
    local diagonal = row[0]
    row[0] = i
    for j = 1, #b do
      local cost = a:byte(i) == b:byte(j) and 0 or 1
      diagonal, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, diagonal + cost)
    end
  end
  return row[#b]
end

-- Returns " (did you mean 'x'?)" for the nearest of `names`, the first of several.
local function suggestion(name, names)
  local nearest, least = nil, #name / 2 + 1
  for _, candidate in ipairs(names) do
    local distance = edit_distance(name:lower(), candidate:lower())
    if distance < least then nearest, least = candidate, distance end
  end
  return nearest and " (did you mean '" .. nearest .. "'?)" or ""
end

-- Ports: checks, reading, writing ----------------------------------------------

-- The types of RTT that have a type of Lua.
local LUA_TYPES = {
  bool = "boolean", char = "string", double = "number", float = "number",
  int = "number", string = "string", uint = "number",
}

local DIRECTIONS = { read = "input port", write = "output port" }

-- Returns why `port` cannot `method` samples of type `kind` (nil: any); nil if it can.
local function port_problem(port, method, kind)
  local wanted = DIRECTIONS[method] .. (kind and " of type " .. kind or "")
  if not has_method(port, method) then return wanted .. " expected, " .. got(port) end
  local actual = info_of(port).type
  if kind and actual and actual ~= kind then
    return wanted .. " expected, got one of type " .. tostring(actual)
  end
end

-- Returns a Variable to use again and again. None for what Lua has no type for: there
-- the sample itself is the event, and each must stay what it is. None for ports that
-- are not RTT's.
local function new_variable(port)
  local kind = info_of(port).type
  local rtt = LUA_TYPES[kind] and find_rtt()
  return rtt and rtt.Variable and rtt.Variable(kind)
end

-- Returns a function that appends what a port has to a list.
local function new_reader(port)
  local var = new_variable(port)
  if var then
    return function(events)
      while port:read(var) == "NewData" do events[#events + 1] = var:tolua() end
    end
  end
  return function(events)
    local status, event = port:read()
    while status == "NewData" do
      events[#events + 1] = event
      status, event = port:read()
    end
  end
end

local function new_writer(port)
  local var = new_variable(port)
  if not var then return function(value) port:write(value) end end
  return function(value)
    var:assign(value)
    port:write(var)
  end
end

local function clear(list)
  for i = #list, 1, -1 do list[i] = nil end
end

-- Returns a getevents that lets each of `sources` append to one list. When one raises,
-- what the others had is kept for the next call.
local function gather(sources)
  local events, is_taken = {}, false
  return function()
    if is_taken then clear(events) end
    is_taken = false
    for i = 1, #sources do sources[i](events) end
    is_taken = true
    return events
  end
end

-- Makes a getevents of ports; blames the caller of the public function for wrong ones.
local function gen_reader(where, kind, ...)
  local n, readers = select("#", ...), {}
  if n == 0 then error(where .. ": at least one port expected, got none", 3) end
  for i = 1, n do
    local port = (select(i, ...))
    local problem = port_problem(port, "read", kind)
    if problem then error(("%s: port %d: %s"):format(where, i, problem), 3) end
    readers[i] = new_reader(port)
  end
  return gather(readers)
end

--- Make a getevents that reads all new samples of input ports, in the order given.
--
-- Samples of RTT's basic types become values of Lua; any other is a Variable of its
-- own. The list returned is valid until the next call.
--
-- @usage
--    fsm.getevents = rfsm_rtt.gen_read_events(commands, alarms)
--
-- @raise when a port is no input port
---@param ... any input ports, at least one
---@return fun(): any[] getevents
---@nodiscard
function rfsm_rtt.gen_read_events(...)
  return (gen_reader("rfsm.rtt.gen_read_events", nil, ...))
end

--- Make a getevents that reads all new samples of input ports of type string.
-- @raise when a port is no input port, or one of another type
---@param ... any input ports, at least one
---@return fun(): string[] getevents
---@nodiscard
function rfsm_rtt.gen_read_str_events(...)
  return (gen_reader("rfsm.rtt.gen_read_str_events", "string", ...))
end

-- Returns why a port of type `kind` cannot take an event; nil if it can.
local function event_problem(kind, event)
  if event == nil or not kind then return nil end
  if LUA_TYPES[kind] then
    if type(event) == LUA_TYPES[kind] then return nil end
    return LUA_TYPES[kind] .. " expected, " .. got(event)
  end
  local actual = has_method(event, "getType") and event:getType()
  if actual == kind then return nil end
  return "Variable of type " .. kind .. " expected, "
    .. (actual and "got one of type " .. tostring(actual) or got(event))
end

local function check_events(kind, n, ...)
  for i = 1, n do
    local problem = event_problem(kind, (select(i, ...)))
    if problem then
      error(("rfsm.rtt.raise_event: event %d: %s"):format(i, problem), 3)
    end
  end
end

--- Make a function that writes each of its arguments to an output port.
--
-- With `fsm`, it sends them to that machine as well. nil is skipped. An event that the
-- port cannot take is an error, and then none is written.
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
  local where = "rfsm.rtt.gen_raise_event: "
  local problem = port_problem(port, "write")
  if problem then error(where .. problem, 2) end
  if fsm ~= nil and not rfsm.is_initialized_root(fsm) then
    error(where .. "machine (the result of rfsm.init) expected, " .. got(fsm), 2)
  end
  local kind, write = info_of(port).type, new_writer(port)
  return function(...)
    local n = select("#", ...)
    check_events(kind, n, ...)
    for i = 1, n do
      local event = (select(i, ...))
      if event ~= nil then
        write(event)
        if fsm then rfsm.send_events(fsm, event) end
      end
    end
  end
end

-- Writes the leaf of `fsm`, if it is not what `written` has.
local function write_change(fsm, written, write)
  local leaf = fsm._act_leaf or false
  if leaf == written.leaf then return end
  write(leaf and leaf._fqn or "<none>")
  written.leaf = leaf
end

-- Returns what was written of `fsm` by the hook that `key` stands for.
local function written_of(fsm, key, write)
  local own = rawget(fsm, "_rtt")
  if not own then
    own = {}
    rawset(fsm, "_rtt", own)
  end
  if not own[key] then
    own[key] = { leaf = false }
    rfsm.reset_hook_add(fsm, function() write_change(fsm, own[key], write) end)
  end
  return own[key]
end

--- Make a post step hook that writes the name of the active leaf to a string port.
--
-- It writes on change only, and `<none>` at once and when the machine is reset.
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
  local write, key = new_writer(port), {}
  write("<none>")
  return function(fsm)
    if not rfsm.is_initialized_root(fsm) then
      error("rfsm.rtt.write_fqn: machine expected, " .. got(fsm), 2)
    end
    local own = rawget(fsm, "_rtt")
    write_change(fsm, own and own[key] or written_of(fsm, key, write), write)
  end
end

-- In the Lua of the component or service: what the launchers call there --------

local EVENTS_PORT, FQN_PORT = "rFSM_events", "rFSM_cur_fqn"

local function printer_to_log(rtt, level)
  return function(...)
    local texts = { ... }
    for i = 1, select("#", ...) do texts[i] = tostring(texts[i]) end
    rtt.logl(level, concat(texts, " "))
  end
end

local function problems_text(problems)
  return ("rfsm.init: the model has %d problem%s\n  %s"):format(#problems,
    #problems == 1 and "" or "s", concat(problems, "\n  "))
end

local PRINTERS = { "err", "warn", "info" }
local LEVELS = { err = "Error", warn = "Warning", info = "Info" }

-- Returns the printers that a model leaves open, by name, and puts them into it. The
-- problems of the model are raised later, so that `err` has not to print them as well.
local function add_printers(rtt, model)
  local added = {}
  for _, name in ipairs(PRINTERS) do
    if model[name] == nil then
      added[name] = printer_to_log(rtt, LEVELS[name])
      model[name] = name ~= "err" and added[name]
    end
  end
  return added
end

-- Makes the machine; printers that the chart leaves open print to RTT's log. The model
-- may be in use elsewhere and is left as it was.
local function load_machine(rtt, file)
  local model = rfsm.load(file)
  local added = add_printers(rtt, model)
  local ok, fsm, problems = pcall(rfsm.init, model)
  for name in pairs(added) do model[name] = nil end -- any order: all of them
  if not ok then error(fsm, 0) end
  if not fsm then error(problems_text(problems), 0) end
  fsm.err = added.err or fsm.err
  return fsm, model.getevents
end

-- What a launch has made, to be taken back.
---@class rfsm.rtt.Launched
---@field component any the TaskContext
---@field fsm rfsm.Machine|false
---@field ports { name: string, port: any }[] those that were added
---@field globals { name: string, before: any }[] those that were set

local function has_port(component, name)
  for _, other in ipairs(component:getPortNames()) do
    if other == name then return true end
  end
  return false
end

-- RTT replaces and disconnects a port whose name is used again; that is never meant.
local function check_free(component, name)
  if has_port(component, name) then
    error("'" .. component:getName() .. "' has a port '" .. name .. "' already", 0)
  end
end

local function add_port(launched, port, name, text, is_trigger)
  local component = launched.component
  if is_trigger then
    component:addEventPort(port, name, text)
  else
    component:addPort(port, name, text)
  end
  launched.ports[#launched.ports + 1] = { name = name, port = port }
  return port
end

local function set_global(launched, name, value)
  launched.globals[#launched.globals + 1] = { name = name, before = rawget(_G, name) }
  rawset(_G, name, value)
end

-- Takes a launch back. Ports that Lua made are no garbage: they are removed and deleted
-- by hand, unless somebody (rttlib.tc_cleanup) was faster.
local function detach(launched)
  for _, entry in ipairs(launched.ports) do
    if has_port(launched.component, entry.name) then
      launched.component:removePort(entry.name)
      entry.port:delete()
    end
  end
  for i = #launched.globals, 1, -1 do
    rawset(_G, launched.globals[i].name, launched.globals[i].before)
  end
end

-- Returns the name of the port for events; nil for none.
local function events_port_name(args, getevents)
  local name = args.ev_inport
  if name == nil then name = not getevents end
  return name == true and EVENTS_PORT or name or nil
end

-- Makes a source, for `gather`, of a getevents.
local function source_of(getevents)
  return function(events)
    local list = getevents()
    for i = 1, type(list) == "table" and #list or 0 do
      events[#events + 1] = list[i] -- nil is skipped
    end
  end
end

local function add_events_port(launched, rtt, args, name, getevents)
  local port = add_port(launched, rtt.InputPort("string"), name,
    "events for the machine", args.is_trigger)
  local sources = { new_reader(port) }
  if getevents then sources = { source_of(getevents), sources[1] } end
  launched.fsm.getevents = gather(sources)
end

local function run_file(file)
  if not file then return end
  local chunk, problem = loadfile(file)
  if not chunk then error(problem, 0) end
  chunk(file)
end

local function set_up(launched, rtt, args, finish)
  run_file(args.prefile)
  local fsm, getevents = load_machine(rtt, args.file)
  launched.fsm = fsm
  local component, name = launched.component, events_port_name(args, getevents)
  check_free(component, FQN_PORT)
  if name then check_free(component, name) end
  local port = add_port(launched, rtt.OutputPort("string"), FQN_PORT,
    "fully qualified name of the active leaf")
  rfsm.post_step_hook_add(fsm, rfsm_rtt.gen_write_fqn(port))
  if name then add_events_port(launched, rtt, args, name, getevents) end
  set_global(launched, "fsm", fsm)
  run_file(args.postfile)
  if finish then finish(launched, rtt) end
end

-- Returns the machine with what belongs to it; raises when that fails, and leaves
-- nothing.
local function launch(args, finish)
  local rtt = find_rtt()
  if not rtt then error("module 'rtt' is not there, this is no Lua of RTT", 0) end
  local launched = { component = rtt.getTC(), fsm = false, ports = {}, globals = {} }
  local ok, why = pcall(set_up, launched, rtt, args, finish)
  if ok then return launched end
  detach(launched)
  error(why, 0)
end

local function log_error(why)
  local rtt = find_rtt()
  if rtt then rtt.logl("Error", "rfsm.rtt: " .. tostring(why)) end
end

-- Advances a machine; what escapes goes to the log, or RTT would drop the hook.
local function advance(f, fsm)
  local ok, why = pcall(f, fsm)
  if not ok then log_error(why) end
  return true
end

local function launch_in_service(args)
  if rfsm.is_initialized_root(rawget(_G, "fsm")) then
    error("a machine was launched here before, it is the global 'fsm'", 0)
  end
  launch(args, function(launched, rtt)
    local function update() return advance(rfsm.run, launched.fsm) end
    set_global(launched, "rfsm_update", update)
    if not args.eehook then return end
    local eehook = rtt.EEHook("rfsm_update")
    set_global(launched, "rfsm_eehook", eehook) -- one that nobody holds is collected
    eehook:enable()
  end)
end

local function launch_in_component(args)
  local launched
  local function leave()
    if launched then detach(launched) end
    launched = nil
  end
  rawset(_G, "configureHook", function()
    leave() -- a stopped component may be configured again
    local ok, result = pcall(launch, args)
    if ok then launched = result else log_error(result) end
    if not ok and args.tell then args.tell(result) end
    args.tell = nil -- the launcher waits for the first call only
    return ok
  end)
  rawset(_G, "updateHook", function()
    if not launched then return end -- somebody replaced configureHook
    advance(args.is_trigger and rfsm.run or rfsm.step, launched.fsm)
  end)
  rawset(_G, "cleanupHook", leave)
end

rfsm_rtt._launch = { service = launch_in_service, component = launch_in_component }

-- Texts of Lua: what is handed to another Lua must be written out ----------------

local to_text

local function number_text(value)
  if value ~= value then return "0/0" end
  if value == huge then return "math.huge" end
  if value == -huge then return "-math.huge" end
  if math_type and math_type(value) == "integer" then return ("%d"):format(value) end
  local text = ("%.17g"):format(value)
  return math_type and text:match("^-?%d+$") and text .. ".0" or text
end

local function key_before(a, b)
  if type(a) ~= type(b) then return type(a) == "number" end
  return a < b
end

-- Returns the keys in a fixed order; nil and a problem when one is of another type.
local function keys_of(t, place)
  local keys = {}
  for key in pairs(t) do -- any order: sorted
    if type(key) ~= "string" and type(key) ~= "number" then
      return nil, place .. ": strings or numbers expected as keys, got " .. type(key)
    end
    keys[#keys + 1] = key
  end
  sort(keys, key_before)
  return keys
end

local function table_text(t, place, outer)
  if outer[t] then return nil, place .. ": a table that contains itself" end
  local keys, problem = keys_of(t, place)
  if not keys then return nil, problem end
  outer[t] = true
  local parts = {}
  for i, key in ipairs(keys) do
    local text
    text, problem = to_text(t[key], place .. "." .. tostring(key), outer)
    if not text then return nil, problem end
    parts[i] = "[" .. to_text(key) .. "]=" .. text
  end
  outer[t] = nil
  return "{" .. concat(parts, ",") .. "}"
end

-- Returns `value` as Lua writes it; nil and a problem when that cannot be.
function to_text(value, place, outer)
  if type(value) == "string" then return ("%q"):format(value) end
  if type(value) == "number" then return number_text(value) end
  if type(value) == "boolean" then return tostring(value) end
  if type(value) == "table" then return table_text(value, place, outer) end
  return nil, place .. ": string, number, boolean or a table of these expected, got "
    .. type(value)
end

-- Returns why `env` cannot be defined elsewhere; nil when it can.
local function env_problem(env)
  if env == nil then return nil end
  if type(env) ~= "table" then return "env: table expected, " .. got(env) end
  local keys, problem = keys_of(env, "env")
  if not keys then return problem end
  if type(keys[1]) == "number" then
    return "env: names expected as keys, " .. got(keys[1])
  end
  return (select(2, to_text(env, "env", {})))
end

-- What is executed in the other Lua. The operation returns no more than false when it
-- fails: why is written to a file, `report`, which the launcher reads.
local PROGRAM = [[
local args = %s
function args.tell(why)
  local file = args.report and io.open(args.report, "w")
  if not file then return end
  file:write(tostring(why))
  file:close()
end
local before = {}
for name, value in pairs(args.env) do -- any order: different names
  before[name] = rawget(_G, name)
  rawset(_G, name, value)
end
local ok, why = pcall(function()
  local is_there, rfsm_rtt = pcall(require, "rfsm.rtt")
  if not is_there then
    package.path = package.path .. ";" .. args.path
    rfsm_rtt = require "rfsm.rtt"
  end
  rfsm_rtt._launch[args.kind](args)
end)
if ok then return true end
for name in pairs(args.env) do -- any order, again
  rawset(_G, name, before[name])
end
args.tell(why)
error(why, 0)
]]

-- Launch, in the Lua of the caller ----------------------------------------------

-- Returns why a file cannot be loaded; nil when it can.
local function file_problem(what, name)
  if type(name) ~= "string" then
    return what .. ": file name expected, " .. got(name)
  end
  local file, problem = io.open(name)
  if not file then
    return ("%s '%s': %s"):format(what, name, (problem:gsub("^.*: ", "")))
  end
  file:close()
  local chunk
  chunk, problem = loadfile(name)
  if not chunk then return ("%s '%s': %s"):format(what, name, problem) end
end

local function call(object, method, ...) return object[method](object, ...) end

local function new_report()
  local ok, name = pcall(os.tmpname)
  return ok and name
end

-- Returns what the other Lua wrote; nil when it wrote nothing.
local function read_report(name)
  local file = name and io.open(name)
  if not file then return nil end
  local text = file:read("*a")
  file:close()
  return text ~= "" and text or nil
end

-- Returns whether `f(...)` went well: it did not raise, nor return false.
local function succeeds(f, ...)
  local ok, result = pcall(f, ...)
  return ok and result ~= false, not ok and result or nil
end

-- Executes the program with `args`, then `after`; returns whether both went well, and
-- why not.
local function execute(args, exec_str, after)
  args.report, args.path = new_report(), package.path
  local ok, why = succeeds(exec_str, PROGRAM:format((to_text(args, "args", {}))))
  if ok and after then ok, why = after() end
  local report = read_report(args.report)
  if args.report then os.remove(args.report) end
  if ok then return true end
  return false, report or why and tostring(why)
    or "the other Lua reports a failure, RTT's log says which"
end

local function exec_problem(exec_str)
  if is_callable(exec_str) then return nil end
  return "exec_str: the operation exec_str expected, " .. got(exec_str)
    .. " (component:provides(\"Lua\"):getOperation(\"exec_str\") would be right)"
end

local function boolean_problem(what, value)
  if value == nil or type(value) == "boolean" then return nil end
  return what .. ": boolean expected, " .. got(value)
end

--- Launch a machine in a Lua service of a component.
--
-- The component gets the ports `rFSM_events` (unless the chart has a getevents) and
-- `rFSM_cur_fqn`, the service's Lua the globals `fsm` and `rfsm_update`. With `eehook`
-- the machine runs at each update of the component; otherwise when `rfsm_update()` is
-- executed in the service.
--
-- @usage
--    local lua = component:provides("Lua")
--    rfsm_rtt.service_launch_rfsm("gripper.lua", lua:getOperation("exec_str"), true)
--
-- @raise when an argument is wrong or the machine cannot be made; then nothing is left
---@param file string the chart
---@param exec_str fun(code: string): boolean the service's operation
---@param eehook? boolean
---@param env? table<string, any> globals to define first: strings, numbers, booleans,
--- tables of these
---@return boolean launched true
function rfsm_rtt.service_launch_rfsm(file, exec_str, eehook, env)
  local problem = file_problem("file", file) or exec_problem(exec_str)
    or boolean_problem("eehook", eehook) or env_problem(env)
  if problem then error("rfsm.rtt.service_launch_rfsm: " .. problem, 2) end
  local ok, why = execute({
    kind = "service", file = file, eehook = eehook or false, env = env or {},
  }, exec_str)
  if not ok then error("rfsm.rtt.service_launch_rfsm: " .. why, 2) end
  return true
end

-- Returns the peer of a component; nil when it has none of that name.
local function find_peer(component, name)
  local ok, peer = pcall(call, component, "getPeer", name)
  return ok and peer or nil
end

-- Returns the deployer, given as itself or as the name of a peer; nil and why not.
local function find_deployer(deployer)
  if deployer == nil or type(deployer) == "string" then
    local rtt, name = find_rtt(), deployer or "Deployer"
    if not rtt then
      return nil, "deployer: to look for a peer '" .. name
        .. "' takes RTT, but module 'rtt' is not there"
    end
    local own = rtt.getTC()
    deployer = find_peer(own, name)
    if not deployer then
      return nil, ("deployer: '%s' has no peer '%s'%s"):format(own:getName(), name,
        suggestion(name, own:getPeers()))
    end
  end
  if has_method(deployer, "loadComponent") and has_method(deployer, "getPeer") then
    return deployer
  end
  return nil, "deployer: a component with the operation loadComponent expected, "
    .. got(deployer)
end

local function string_problem(what, value)
  if type(value) == "string" and value ~= "" then return nil end
  return what .. ": string expected, " .. got(value)
end

local function ev_inport_problem(what, value)
  if type(value) == "boolean" then return nil end
  if type(value) == "string" and value ~= "" and value ~= FQN_PORT then return nil end
  return what .. ": name for a port, or boolean, expected, " .. got(value)
end

local function any() end

-- The fields of component_launch_rfsm, in the order in which they are checked.
local FIELDS = {
  "name", "fsmfile", "deployer", "luatype", "sync", "ev_inport", "prefile", "postfile",
  "env",
}
local REQUIRED = { name = true, fsmfile = true }
local CHECKS = {
  name = string_problem, fsmfile = file_problem, deployer = any,
  luatype = string_problem, sync = boolean_problem, ev_inport = ev_inport_problem,
  prefile = file_problem, postfile = file_problem,
  env = function(_, value) return env_problem(value) end,
}

-- Returns what is wrong with a field that is not known; the first by name.
local function unknown_field_problem(args)
  local unknown
  for key in pairs(args) do -- any order: the least by name
    local name = tostring(key)
    if not CHECKS[key] and not (unknown and unknown < name) then unknown = name end
  end
  return unknown and "unknown field '" .. unknown .. "'" .. suggestion(unknown, FIELDS)
end

local function args_problem(args)
  if type(args) ~= "table" then return "table expected, " .. got(args) end
  local problem = unknown_field_problem(args)
  for i = 1, #FIELDS do
    local name = FIELDS[i]
    if problem then return problem end
    if args[name] ~= nil or REQUIRED[name] then
      problem = CHECKS[name](name, args[name])
    end
  end
  return problem
end

local function load_component(deployer, name, luatype)
  if find_peer(deployer, name) then
    return false, "the deployer has a component of this name already"
  end
  if succeeds(call, deployer, "loadComponent", name, luatype) then return true end
  return false, ("the deployer does not load a component of type '%s' (is 'ocl' "
    .. "imported?), RTT's log says why"):format(luatype)
end

-- Puts the machine into the component that was loaded; false and why when that fails.
local function launch_into(component, args)
  local ok, exec_str = pcall(call, component, "getOperation", "exec_str")
  if not ok or not is_callable(exec_str) then
    return false, "it has no operation exec_str, a luatype with Lua in it expected"
  end
  return execute({
    kind = "component", file = args.fsmfile, env = args.env or {},
    is_trigger = not args.sync, ev_inport = args.ev_inport, prefile = args.prefile,
    postfile = args.postfile,
  }, exec_str, function() return succeeds(call, component, "configure") end)
end

-- Unloads a component again; returns `why`, with a word when it stays.
local function give_up(deployer, name, why)
  if succeeds(call, deployer, "unloadComponent", name) then return why end
  return why .. " (and the deployer does not unload the component)"
end

-- Returns the component; nil and why when there is none, and then nothing is left.
local function launch_component(args, deployer)
  local name, luatype = args.name, args.luatype or "OCL::LuaComponent"
  local ok, why = load_component(deployer, name, luatype)
  if not ok then return nil, why end
  local component = find_peer(deployer, name)
  if not component then
    return nil, give_up(deployer, name, "the deployer loads it, but is no peer of it")
  end
  ok, why = launch_into(component, args)
  if ok then return component end
  return nil, give_up(deployer, name, why)
end

--- What component_launch_rfsm takes.
---@class rfsm.rtt.Launch
---@field name string of the new component
---@field fsmfile string the chart
---@field deployer? any the deployer, or the name of a peer ("Deployer")
---@field luatype? string type of the component ("OCL::LuaComponent")
---@field sync? boolean one step at each update, events do not trigger any (false)
---@field ev_inport? string|boolean name of the port for events ("rFSM_events")
---@field prefile? string program to run before the chart is loaded
---@field postfile? string program to run after, when the global `fsm` is there
---@field env? table<string, any> globals to define first

--- Launch a machine in a component of its own.
--
-- The component is loaded and configured, with ports for events and for `rFSM_cur_fqn`;
-- set its activity, connect its ports and start it. An event triggers an update, and an
-- update runs the machine until nothing is left to do. With `sync` an update is one
-- step, and only the component's period, or who executes it, makes updates.
--
-- @usage
--    local gripper = rfsm_rtt.component_launch_rfsm {
--      name = "gripper", fsmfile = "gripper.lua", deployer = deployer,
--    }
--    gripper:start()
--
-- @raise when an argument is wrong or the machine cannot be made; then no component is
-- left
---@param args rfsm.rtt.Launch
---@return any component configured, not started
function rfsm_rtt.component_launch_rfsm(args)
  local where = "rfsm.rtt.component_launch_rfsm: "
  local problem = args_problem(args)
  if problem then error(where .. problem, 2) end
  local deployer, obstacle = find_deployer(args.deployer)
  if not deployer then error(where .. obstacle, 2) end
  local component, why = launch_component(args, deployer)
  if not component then error(("%s'%s': %s"):format(where, args.name, why), 2) end
  return component
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_rtt", rfsm_rtt) end

return rfsm_rtt
