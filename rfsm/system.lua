--- Systems: several charts that talk over wires, and run side by side.
--
-- Each machine of a system is a machine as `rfsm.init` makes it. Its callbacks call
-- `fsm.emit` to put events into wires. In a move a machine reads its wires, takes one
-- step, and puts the first event that the step emits. Each further one is put by a move
-- of its own, so others may move in between. The whole description of a system is
-- checked before anything runs.
--
-- @module rfsm.system
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local calls = require "rfsm.shared.calls"
local description = require "rfsm.system.description"
local match = require "rfsm.shared.match"
local opts = require "rfsm.shared.options"
local order = require "rfsm.shared.order"
local search = require "rfsm.shared.search"
local wires = require "rfsm.system.wires"

local error, getmetatable, ipairs = error, getmetatable, ipairs
local rawget, rawset, setmetatable, type = rawget, rawset, setmetatable, type
local floor, huge, remove = math.floor, math.huge, table.remove
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local getinfo = (rawget(_G, "debug") or {}).getinfo

local system = {}

--- Machines and the wires between them.
---@class rfsm.System
---@field names string[] names of the machines, in the order in which they move
---@field models table<string, rfsm.State>
---@field machines table<string, rfsm.Machine> made when this field is first read
---@field wires rfsm.system.Wire[]
---@field queues any[][] for each wire the events that wait in it, the oldest first
---@field lost integer[] how many events each wire has lost, because it was full
---@field unsent table<string, table[]> by machine, the events that it has emitted and
-- that are not yet put into a wire, the oldest first: { wire = number, event = event }
---@field file string? the file that describes the system
---@field files table<string, string> by machine, the file of its chart; only of charts
-- that `system.load` has read
---@field places table<string, string> where each machine is described: "cell.lua:5"
---@field state number|false random state for the order of moves; false: a fixed order
local System = { -- the hint is for who loads a system as a chart
  rfsm_hint = " (it is a system, which rfsm check, rfsm sim and rfsm.system.load open)",
}

-- Raises an error if a method was called with a dot.
local function check_self(self, method)
  if getmetatable(self) == System then return end
  error(("rfsm.system.%s: system expected, got %s (cell:%s(...), with a colon)"):format(
    method, type(self), method), 3)
end

-- Raises an error that blames the caller of a method.
local function check(is_right, method, expected, value)
  if is_right then return end
  error("rfsm.system." .. method .. ": " .. expected .. " expected, "
    .. rfsm.got(value), 3)
end

local function is_number(x) return type(x) == "number" and x - x == 0 end

-- Notes for each wire that carries an event that a machine has emitted it.
local function emit(self, from, name, data)
  local unsent = self.unsent[from]
  for i, wire in ipairs(self.wires) do
    if wire.from == from and match.has(wire.events, name) then
      unsent[#unsent + 1] = { wire = i, event = wires.event_of(name, data) }
    end
  end
end

-- Puts the oldest of the events that a machine has emitted into its wire.
local function put_next(self, name)
  local put = remove(self.unsent[name], 1)
  if put and not wires.put(self.wires[put.wire], self.queues[put.wire], put.event) then
    self.lost[put.wire] = self.lost[put.wire] + 1
  end
end

-- Makes the machines when the field `machines` is first read.
function System:__index(key)
  if key ~= "machines" then return System[key] end
  local machines = {}
  for _, name in ipairs(self.names) do
    local fsm, text = rfsm.init(self.models[name])
    if not fsm then error(text, 0) end
    rfsm.set_emit(fsm, function(event, data) emit(self, name, event, data) end)
    machines[name] = fsm
  end
  rawset(self, "machines", machines)
  return machines
end

-- Returns a random number from 1 to n, the same on every Lua.
local function draw(self, n)
  self.state = self.state * 16807 % 2147483647
  return floor(self.state / 2147483647 * n) + 1
end

-- Returns the position of the wire to `name` that carries an event of a sender.
local function position_of(self, name, wanted)
  for at, wire in ipairs(self.wires) do
    if wire.to == name and wire.from == wanted.from
      and match.has(wire.events, wanted.event) then
      return at
    end
  end
  error(("rfsm.system.move: no wire carries '%s' from '%s' to '%s'"):format(
    rfsm.text_of(wanted.event), rfsm.text_of(wanted.from), name), 4)
end

-- Takes what a machine reads in a move. Before its entry, that is nothing. A machine
-- that takes one event an iteration reads one, and none while one waits in itself.
local function read_wires(self, name, fsm, wanted)
  local waiting = wires.waiting(self.wires, self.queues, name)
  if rfsm.get_sta_mode(fsm) == "inactive" then return {}, {} end
  if fsm.read ~= "one" then return wires.take(self.wires, self.queues, waiting) end
  if wanted == false or rfsm.check_events(fsm) > 0 or not waiting[1] then
    return {}, {}
  end
  local at = wanted and position_of(self, name, wanted)
    or waiting[waiting[2] and self.state and draw(self, #waiting) or 1]
  return wires.take(self.wires, self.queues, { at }, true)
end

--- Have one machine move: read its wires, take one step, and put the first event that
--- the step emits. If events of its last step are still to be put, it only puts one.
--
-- In its first move a machine is entered, and reads no wire, because the entry would
-- lose the events. A component of Orocos with `enter = "start"` does the same.
--
---@param name string
---@param events? any[] events from outside, queued after the events from the wires
---@param wanted? { from: string, event: string }|false only if the machine takes one
-- event an iteration: the sender and an event of the wire that it reads, or false to
-- read none; default: the first wire in which an event waits
---@param holds? boolean put nothing after the step, so that others move before that
---@return boolean idle the result of `rfsm.step`; false if events are still to be put
---@return any[] came the events from the wires, then the events from outside
---@return rfsm.system.Wire[] by for each event that came from a wire, this wire
function System:move(name, events, wanted, holds)
  check_self(self, "move")
  local is_name, problem = description.is_name(self.models, name)
  if not is_name then error("rfsm.system.move: " .. problem, 2) end
  check(events == nil or type(events) == "table", "move", "list of events", events)
  local fsm, unsent = self.machines[name], self.unsent[name]
  local has_to_put, came, by = unsent[1] ~= nil, {}, {}
  if not has_to_put then came, by = read_wires(self, name, fsm, wanted) end
  for _, event in ipairs(events or {}) do came[#came + 1] = event end
  rfsm.send_events(fsm, unpack(came))
  local is_idle = not has_to_put and rfsm.step(fsm)
  if has_to_put or not holds then put_next(self, name) end
  return is_idle and not unsent[1], came, by
end

--- Have the machines move in a new random order in each step. Without a seed, they move
--- in the fixed order again.
---@param seed? integer
function System:shuffle(seed)
  check_self(self, "shuffle")
  check(seed == nil or is_number(seed), "shuffle", "number", seed)
  self.state = seed and floor(seed) % 2147483646 + 1 or false
end

-- Returns the names in the order of the next step.
local function order_of(self)
  local names = {}
  for i, name in ipairs(self.names) do
    local at = self.state and draw(self, i) or i
    names[i] = names[at]
    names[at] = name
  end
  return names
end

local function has_event(queue) return queue[1] ~= nil end

--- Have each machine move once.
---@param watch? fun(name: string, came: any[], by: rfsm.system.Wire[]) called after
-- each move, with its results
---@return boolean idle true if no machine has anything left to do, and no event waits
function System:step(watch)
  check_self(self, "step")
  local are_idle = true
  for _, name in ipairs(order_of(self)) do
    local is_idle, came, by = self:move(name)
    if watch then watch(name, came, by) end
    are_idle = are_idle and is_idle
  end
  return are_idle and not order.any(self.queues, has_event)
end

--- Step until nothing is left to do.
---@param most? integer greatest number of steps; default: no limit
---@return boolean idle false if something is left to do after `most` steps
function System:run(most)
  check_self(self, "run")
  check(most == nil or is_number(most), "run", "number of steps", most)
  for _ = 1, most or huge do
    if self:step() then return true end
  end
  return false
end

local function empty_wires(self)
  self.queues, self.lost, self.unsent = {}, {}, {}
  for i in ipairs(self.wires) do self.queues[i], self.lost[i] = {}, 0 end
  for _, name in ipairs(self.names) do self.unsent[name] = {} end
end

--- Reset the machines and empty the wires.
--
-- After that no machine is entered, and no event waits.
function System:reset()
  check_self(self, "reset")
  for _, name in ipairs(self.names) do rfsm.reset(self.machines[name]) end
  empty_wires(self)
end

--- Explore every configuration that the machines can reach together.
---@param options? table the options of `explore` in `rfsm.system.report`
---@return rfsm.system.Report
function System:explore(options)
  check_self(self, "explore")
  return rfsm.find_module("rfsm.system.report").explore(self, options)
end

-- Public functions ------------------------------------------------------------------

--- Is a value a system?
---@param value any
---@return boolean
function system.is_system(value) return getmetatable(value) == System end

-- The files that `load` is reading, the innermost last; the files of the charts that it
-- has read.
local loading, file_of = {}, setmetatable({}, { __mode = "k" })

-- Returns the file that is being loaded; if there is none, the file that calls a
-- function of this module. The stack alone does not show the file, if it ends with the
-- tail call `return system {...}`.
local function calling_file()
  local info = getinfo and getinfo(3, "S")
  return loading[#loading] or info and info.source:match("^@(.*)")
end

-- Returns the path of `file` in the folder of `caller`, if the file exists there; else
-- `file` itself. A tool that loads charts searches the folder of the chart by itself.
local function beside(file, caller)
  local folder = caller and caller:match("^.*/") or ""
  local is_tools = caller and search.world_of("@" .. caller)
  return not is_tools and search.exists(folder .. file) and folder .. file or file
end

--- Load a chart or a system from a file. The folder of the calling file is tried first.
-- @raise when the file cannot be read or fails, or returns no chart and no system
---@param file string
---@return rfsm.State|rfsm.System loaded
---@nodiscard
function system.load(file)
  opts.check_file("rfsm.system.load", file)
  local path = beside(file, calling_file())
  loading[#loading + 1] = path
  local value = calls.finally(function() loading[#loading] = nil end, rfsm.load, path,
    system.is_system)
  if not system.is_system(value) then file_of[value] = path end
  return value
end

-- Makes a system: `system { arm = model, wires = { ... } }`. Raises an error with all
-- problems of the description, before anything runs.
local function new(_, given)
  local self, text, problems = description.read(given, calling_file())
  if not self then calls.fail(text, problems) end
  self.state, self.files = false, {}
  for _, name in ipairs(self.names) do self.files[name] = file_of[given[name]] end
  empty_wires(self)
  return setmetatable(self, System)
end

return setmetatable(system, { __call = new })
