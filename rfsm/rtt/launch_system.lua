--- A system launched in Orocos: each machine in a component, each wire a connection.
--
-- So the deployment is the one that `rfsm check` of the system judges. Each machine is
-- entered in startHook, so it loses no event that comes before its first update. What
-- is wrong is reported at its line in the system's file. A launch that fails leaves no
-- component, port or connection.
--
-- @submodule rfsm.rtt
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local alphabet = require "rfsm.shared.alphabet"
local json = require "rfsm.json"
local match = require "rfsm.shared.match"
local opts = require "rfsm.shared.options"
local order = require "rfsm.shared.order"
local replacements = require "rfsm.explore.replacements"
local rtt_launch = require "rfsm.rtt.launch"
local static = require "rfsm.checks.static"
local system = require "rfsm.system"

local error, ipairs, package = error, ipairs, package
local pcall, setmetatable, tostring, type = pcall, setmetatable, tostring, type
local concat, insert, remove = table.concat, table.insert, table.remove

local launch_system = {}

--- A system that runs in components.
---@class rfsm.rtt.LaunchedSystem
---@field cell rfsm.System its description; the machines of this table do not run
---@field components table<string, any> the component of each machine, configured
---@field order string[] machines in the order in which `start` starts them
---@field deployer any
---@field made fun()[] undo what the launch has made, the first first
local Launched = {}
Launched.__index = Launched

-- The settings of a machine that are not settings of its launch.
local OWN = {
  component = { "boolean", opts.is_a "boolean", false },
  after = { "list of machines", opts.is_a "table", {} },
  period = { "seconds", opts.is_seconds, false },
  priority = { "number", opts.is_a "number", 0 },
  scheduler = { "number", opts.is_a "number", 0 },
}

-- What the launch of a system sets itself.
local TAKEN = { name = "the name of the machine", fsmfile = "the file of its chart",
  deployer = "the option deployer of the system", enter = "always 'start'",
  ev_outport = "the wires", samples = "the wires" }

-- Check: every problem with its place, before anything is made -----------------------

local function add(launch, place, text)
  insert(launch.problems, (place ~= "" and place .. ": " or "") .. text)
end

local function report(launch, name, text, ...)
  add(launch, launch.cell.places[name], name .. ": " .. text:format(...))
end

-- Returns the settings of a machine, and the table of options for its launch.
local function read_machine(launch, name, given)
  local own, args = opts.read(OWN, {}), {}
  launch.own[name], launch.args[name] = own, args
  if type(given) ~= "table" then
    return report(launch, name, "table of options expected, %s", opts.got(given))
  end
  for _, field in ipairs(rfsm.sorted_keys(given)) do
    local right, problem = opts.read(OWN, { [field] = given[field] })
    if TAKEN[field] then
      report(launch, name, "%s: not an option here, it is %s", field, TAKEN[field])
    elseif not OWN[field] then
      args[field] = given[field]
    elseif right then
      own[field] = right[field]
    else
      report(launch, name, "%s", problem)
    end
  end
end

local function text_of_chart(model)
  local fsm = static.init(model, false)
  return fsm and json.encode(fsm) .. tostring(fsm.read)
end

-- The component loads the chart from its file, so the file has to be the chart.
local function check_file(launch, name)
  local cell, file = launch.cell, launch.cell.files[name]
  if not file then
    return report(launch, name, "its component loads the chart, expected system.load "
      .. "'FILE'")
  end
  local ok, model = pcall(rfsm.load, file)
  if not ok or text_of_chart(model) ~= text_of_chart(cell.models[name]) then
    report(launch, name, "the system has changed the chart of %s, which its component "
      .. "loads", file)
  end
end

local LARGEST = 2147483647 -- the field `size` of a ConnPolicy is an int

local function check_wire(launch, wire)
  local function tell(text)
    add(launch, wire.location, ("wires[%d]%s"):format(wire.number, text))
  end
  if wire.size > LARGEST then
    tell((".size: a policy of RTT has at most %d, got %.0f"):format(LARGEST,
      wire.size))
  end
  local _, with_data = replacements.emitted_by(launch.machines[wire.from])
  for _, event in ipairs(wire.events) do
    if alphabet.needs_data(launch.machines[wire.to], event) then
      tell((": a string port carries no data, and '%s' takes '%s' with data only")
        :format(wire.to, event))
    elseif with_data[event] then
      tell((": a string port carries no data, and '%s' emits '%s' with data"):format(
        wire.from, event))
    end
  end
end

-- Appends a machine and before it those that it starts after.
local function add_to_order(launch, name, path)
  if match.has(launch.order, name) then return end
  if match.has(path, name) then
    return report(launch, name, "after: a cycle, %s",
      concat(match.with(path, name), " after "))
  end
  for _, other in ipairs(launch.own[name].after) do
    if launch.cell.models[other] then
      add_to_order(launch, other, match.with(path, name))
    else
      report(launch, name, "after: no machine is named '%s'%s", rfsm.text_of(other),
        advice.nearest_name(rfsm.text_of(other), launch.cell.names))
    end
  end
  if not match.has(launch.order, name) then insert(launch.order, name) end
end

-- Is there a component for a machine, if and only if the options say so?
local function check_component(launch, name)
  local found = rtt_launch.peer_of(launch.deployer, name)
  local is_wanted = launch.own[name].component
  if found and not is_wanted then
    report(launch, name, "the deployer has a component '%s' (component = true takes "
      .. "it)", name)
  elseif is_wanted and not (found and found:hasOperation("exec_str")) then
    report(launch, name, "component: the deployer has no %s '%s'",
      found and "Lua component" or "component", name)
  end
end

local function check(launch, machines)
  local cell = launch.cell
  for _, name in ipairs(rfsm.sorted_keys(machines)) do
    if not cell.models[name] then
      add(launch, cell.file or "", ("machines: no machine is named '%s'%s"):format(
        rfsm.text_of(name), advice.nearest_name(rfsm.text_of(name), cell.names)))
    end
  end
  for _, name in ipairs(cell.names) do
    read_machine(launch, name, machines[name] or {})
    launch.machines[name] = static.init(cell.models[name], false)
    check_file(launch, name)
    check_component(launch, name)
  end
  for _, name in ipairs(cell.names) do add_to_order(launch, name, {}) end
  for _, wire in ipairs(cell.wires) do check_wire(launch, wire) end
  if launch.problems[1] then
    error("the system is not launched\n  " .. concat(launch.problems, "\n  "), 0)
  end
end

-- Make: components, ports, connections -----------------------------------------------

local function port_name(wire, is_in)
  return ("wire%d_%s"):format(wire.number, is_in and "in" or "out")
end

-- Returns the text of a list of wires for `launch_system_ports.join`.
local function wires_text(cell, name, is_in)
  local list = {}
  for _, wire in ipairs(cell.wires) do
    if wire[is_in and "to" or "from"] == name then
      insert(list, { port = port_name(wire, is_in), kind = wire.kind, size = wire.size,
        events = wire.events, desc = ("%s from %s to %s"):format(
          concat(wire.events, ", "), wire.from, wire.to) })
    end
  end
  return rtt_launch.to_text(list, "")
end

-- Does the machine react to time events, which must wake its component?
local function has_timers(fsm)
  return order.any(alphabet.of_all(fsm).list, function(event)
    return advice.module_for(event) == "rfsm_timeevent"
  end)
end

-- Completes the arguments of the launch of a machine.
local function arguments(launch, name)
  local args, cell = launch.args[name], launch.cell
  args.fsmfile, args.enter = cell.files[name], "start"
  if args.ev_inport == nil then args.ev_inport = true end
  if args.timer == nil and not launch.own[name].period then
    args.timer = has_timers(launch.machines[name]) or nil
  end
  args.poststr = ("%s\nrequire('rfsm.rtt.launch_system_ports').join(%s, %s)"):format(
    args.poststr or "", wires_text(cell, name, false), wires_text(cell, name, true))
  return args
end

-- Stops a component, unless it was unloaded meanwhile. Returns whether it is there.
local function stop(launch, name)
  local component = rtt_launch.peer_of(launch.deployer, name)
  if component then component:stop() end
  return component ~= nil
end

-- Launches a machine in a component of its own.
local function make_component(launch, name, args)
  args.name, args.deployer = name, launch.deployer
  launch.components[name] = rtt_launch.launch_component(args)
  insert(launch.made, function()
    for _, own in ipairs { name, args.timer and name .. "_timer" or nil } do
      if stop(launch, own) then launch.deployer:getOperation("unloadComponent")(own) end
    end
  end)
end

local FORGET = "local launched = require('rfsm.rtt').launched\n"
  .. "if launched then launched:forget() end"

-- Launches a machine in a component that is there.
local function take_component(launch, name, args)
  local component = launch.deployer:getPeer(name)
  local run = component:getOperation("exec_str")
  local names = component:getPortNames()
  insert(launch.made, function()
    if not stop(launch, name) then return end
    run(FORGET)
    for _, port in ipairs(component:getPortNames()) do
      if not match.has(names, port) then component:removePort(port) end
    end
  end)
  component:addPeer(launch.deployer)
  local program = "require('rfsm.rtt').launch " .. rtt_launch.to_text(args, "")
  if run(program) == false then error("RTT's log has the reason", 0) end
  launch.components[name] = component
end

local function make_machine(launch, name)
  local own, args = launch.own[name], arguments(launch, name)
  local make = own.component and take_component or make_component
  make(launch, name, args)
  if own.period and not launch.deployer:getOperation("setActivity")(name, own.period,
    own.priority, own.scheduler) then
    error("period: the deployer does not set the activity", 0)
  end
end

local function connect(launch, wire)
  local policy = package.loaded.rtt.Variable.new("ConnPolicy")
  policy.type, policy.size = wire.kind == "data" and 0 or 1, wire.size
  policy.init = false
  local from = wire.from .. "." .. port_name(wire, false)
  local into = wire.to .. "." .. port_name(wire, true)
  if not launch.deployer:getOperation("connect")(from, into, policy) then
    error(("the deployer does not connect %s to %s"):format(from, into), 0)
  end
end

-- Calls f(launch, item), with the place in front of its error.
local function at(place, f, launch, item, label)
  local ok, problem = pcall(f, launch, item)
  if ok then return end
  error(("%s%s: %s"):format(place ~= "" and place .. ": " or "", label,
    rfsm.text_of(problem)), 0)
end

local function configure(launch, name)
  if not launch.components[name]:configure() then
    error("the component is not configured, RTT's log has the reason", 0)
  end
end

local function make(launch)
  local cell = launch.cell
  for _, name in ipairs(launch.order) do
    at(cell.places[name], make_machine, launch, name, name)
  end
  for _, wire in ipairs(cell.wires) do
    at(wire.location, connect, launch, wire, ("wires[%d]"):format(wire.number))
  end
  for _, name in ipairs(launch.order) do
    at(cell.places[name], configure, launch, name, name)
  end
end

-- Public functions -------------------------------------------------------------------

--- Start the components, in their order. Each machine is entered then.
--
-- @raise if a component does not start; then those that were started are stopped
function Launched:start()
  for i, name in ipairs(self.order) do
    local component = rtt_launch.peer_of(self.deployer, name)
    if not (component and component:start()) then
      for n = i - 1, 1, -1 do stop(self, self.order[n]) end
      error(("rfsm.rtt.launch_system: %s: '%s' %s"):format(self.cell.places[name], name,
        component and "does not start" or "is not there, it was unloaded"), 2)
    end
  end
end

--- Stop the components, the last started first.
function Launched:stop()
  for i = #self.order, 1, -1 do stop(self, self.order[i]) end
end

--- Stop the components, and unload those that the launch has loaded.
function Launched:unload()
  while self.made[1] do remove(self.made)() end
end

local OPTIONS = {
  deployer = { "deployer or the name of a peer", function() return true end },
  machines = { "table of options by machine", opts.is_a "table", {} },
}

local function launch_cell(file, options)
  local settings, problem = opts.read(OPTIONS, options or {})
  if not settings then error(problem, 0) end
  if not package.loaded.rtt then error("no module 'rtt' in this Lua", 0) end
  local cell = system.load(file)
  if not system.is_system(cell) then
    error(("file of a system expected, '%s' returns a chart"):format(file), 0)
  end
  local self = setmetatable({ cell = cell, components = {}, order = {}, made = {},
    deployer = rtt_launch.find_deployer(settings.deployer), own = {}, args = {},
    machines = {}, problems = {} }, Launched)
  check(self, settings.machines)
  local ok, why = pcall(make, self)
  if not ok then self:unload() end
  self.own, self.args, self.machines, self.problems = nil, nil, nil, nil
  return ok and self or error(why, 0)
end

--- Launch a system: a component for each machine, a pair of ports and a connection for
-- each wire. Call `start` of the result.
--
-- @usage
--    local cell = rfsm_rtt.launch_system("cell.lua", {
--      machines = { arm = { luatype = "OCL::LuaTLSFComponent", pool = 600 } },
--    })
--    cell:start()
--
-- @raise when the system or an option is wrong, or the launch fails; nothing is left
---@param file string the system, whose charts are loaded by `system.load`
---@param options? table `deployer`; `machines`: by name the fields of rfsm.rtt.Launch,
-- and `component` (true: it is there), `after` (machines that start before it), and
-- `period`, `priority`, `scheduler` of its activity
---@return rfsm.rtt.LaunchedSystem launched
function launch_system.launch(file, options)
  local ok, result = pcall(launch_cell, file, options)
  if ok then return result end
  error("rfsm.rtt.launch_system: " .. rfsm.text_of(result), 2)
end

return launch_system
