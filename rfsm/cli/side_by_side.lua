--- The simulator (`rfsm sim`) for a system. It shows the machines, and the events that
--- wait in wires, and it takes back moves of all machines together.
--
-- @module rfsm.cli.side_by_side
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local commands = require "rfsm.sim.commands"
local common = require "rfsm.cli.common"
local encoding = require "rfsm.snapshot.encoding"
local files = require "rfsm.shared.files"
local history = require "rfsm.sim.history"
local rewind = require "rfsm.observe.rewind"
local session = require "rfsm.sim.session"
local snapshot = require "rfsm.snapshot"
local system = require "rfsm.system"

local concat = table.concat

local side_by_side = {}

--- A system and its prompt, with the fields of `rfsm.sim.Session` that the prompt uses.
---@class rfsm.cli.Side
---@field cell rfsm.System
---@field fsm rfsm.Machine the first machine of the system
---@field history rfsm.observe.Rewind history of the first machine; its places also have
-- snapshots of the other machines and of the wires
local Side = { check_event = session.check_event }
Side.__index = Side

-- Methods that the prompt calls, as those of a session ------------------------------

local function leaf_of(fsm) return rfsm.get_actleaf_fqn(fsm) or "<none>" end

-- Prints what a machine has emitted and has yet to put into wires.
local function show_unsent(cell, name)
  local texts = {}
  for i, put in ipairs(cell.unsent[name]) do
    local to = cell.wires[put.wire].to
    texts[i] = ("%s to %s"):format(rfsm.event_text(put.event, true), to)
  end
  if texts[1] then
    print(("%-15s %d to send (%s)"):format(name, #texts, concat(texts, ", ")))
  end
end

function Side:show()
  local cell = self.cell
  for _, name in ipairs(cell.names) do
    print(("%-15s %s"):format(name, leaf_of(cell.machines[name])))
  end
  for i, wire in ipairs(cell.wires) do
    local waiting, lost = #cell.queues[i], cell.lost[i]
    if waiting + lost > 0 then
      print(("%-15s %d waiting%s (%s from %s to %s)"):format("wires[" .. i .. "]",
        waiting, lost > 0 and ", " .. lost .. " lost" or "",
        concat(wire.events, ", "), wire.from, wire.to))
    end
  end
  for _, name in ipairs(cell.names) do show_unsent(cell, name) end
end

-- Prints the events that a machine got in a move, and the leaf to which they have led.
local function print_move(cell, name, came, by)
  local fsm, got = cell.machines[name], {}
  for i, event in ipairs(came) do
    got[i] = rfsm.event_text(event, true) .. " from "
      .. (by[i] and by[i].from or "outside")
  end
  if rfsm.took_path(fsm) or got[1] then
    print(name .. (got[1] and " gets " .. concat(got, ", ") or "") .. ": "
      .. leaf_of(fsm))
  end
end

-- Has one machine move, with events from outside.
function Side:move(name, events, wanted, holds)
  history.mark(self)
  print_move(self.cell, name, select(2, self.cell:move(name, events, wanted, holds)))
end

local MAX_RUN = 10000 -- steps: a system may have no end

function Side:advance(n)
  local is_idle, steps = false, 0
  while not is_idle and steps < (n or MAX_RUN) do
    is_idle = self.cell:step(function(...) print_move(self.cell, ...) end)
    steps = steps + 1
  end
  self:show()
  if not (n or is_idle) then print("stopped after 10,000 steps, 'run' goes on") end
end

function Side.guard_doos() return function() end end

function Side.set_dry() common.fail("--dry is for a chart, not for a system", 2) end

--- Make the moves that a file lists, such as a witness of an exploration. Return the
--- number of moves, and a problem if the file has no move.
function Side:replay(file)
  local text, problem = files.read(file)
  if not text then error(problem, 0) end
  local moves = require("rfsm.system.sequence").read(text)
  for _, each in ipairs(moves) do
    self:move(each.machine, each.events, each.wanted, each.holds)
  end
  return #moves, not moves[1] and "no line is a move" or nil
end

-- Commands --------------------------------------------------------------------------

-- Returns a command. Without `run` it has the function of the command for a chart that
-- has the same name.
local function command(usage, brief, run, fsm)
  local name = usage:match("^[%w_]+")
  return { name = name, usage = usage, brief = brief, fsm = fsm,
    completes = fsm and "now", run = run or commands.find(name).run }
end

local function reset(self)
  history.mark(self)
  self.cell:reset()
  self:show()
end

local function help(self)
  for _, each in ipairs(self.commands.list) do
    print(("  %-22s%s"):format(each.usage, each.brief))
  end
  print("Other lines are Lua: 'cell' is the system, cell.machines has the machines.")
end

-- Returns a command, named after a machine, that has this machine move.
local function machine_command(name, fsm)
  return command(name .. " [events]", "one machine moves, with events from outside",
    function(self, ...)
      for i, event in ipairs { ... } do self:check_event(event, i, fsm) end
      self:move(name, { ... })
      self:show()
    end, fsm)
end

local function commands_of(cell)
  local list = {
    command("step [n]", "each machine moves once, n times"),
    command("run", "until nothing is left to do"),
    command("show", "the machines, and what waits in wires", Side.show),
    command("back [n]", "undo the last n lines that moved"),
    command("forward [n]", "do them again"),
    command("reset", "as at the beginning", reset),
    command("quit", "end, as Control-D does"),
    command("help", "these lines", help),
  }
  for _, name in ipairs(cell.names) do
    list[#list + 1] = machine_command(name, cell.machines[name])
  end
  local function find(name)
    for _, each in ipairs(list) do
      if each.name == name then return each end
    end
  end
  return { list = list, find = find }
end

-- Open ------------------------------------------------------------------------------

-- Returns a snapshot of the wires and of all machines but the first. Its field
-- `problem` is set if a machine cannot be saved.
local function place_of(cell)
  local place = encoding.copy_of { queues = cell.queues, lost = cell.lost,
    unsent = cell.unsent, snaps = {} }
  for i = 2, #cell.names do
    local snap, problem = snapshot.try_take(cell.machines[cell.names[i]])
    place.snaps[i], place.problem = snap, place.problem or problem
  end
  return place
end

-- Puts the wires and all machines but the first into a place. Returns the problem if a
-- machine cannot be put there.
local function put_in_place(cell, place)
  if place.problem then return place.problem end
  local queued = encoding.copy_of { queues = place.queues, lost = place.lost,
    unsent = place.unsent }
  cell.queues, cell.lost, cell.unsent = queued.queues, queued.lost, queued.unsent
  for i = 2, #cell.names do
    local _, problem = snapshot.put(cell.machines[cell.names[i]], place.snaps[i])
    if problem then return problem end
  end
end

local function new_history(cell)
  return rewind.new(cell.machines[cell.names[1]], {
    about = function() return place_of(cell) end,
    prepare = function(place) return put_in_place(cell, place) end,
  })
end

local function new_side(cell, follows)
  return setmetatable({ cell = cell, fsm = cell.machines[cell.names[1]], missing = {},
    follows = follows, is_over = false, history = new_history(cell),
    commands = commands_of(cell) }, Side)
end

--- Open a chart or a system for the simulator; nil and the problems if it is wrong.
function side_by_side.open(file, follows, has_stubs, is_silent)
  local sim, problems = session.open(file, follows, has_stubs, is_silent, system.load,
    new_side)
  for i, problem in ipairs(problems or {}) do
    problems[i] = common.with_hint(problem, has_stubs)
  end
  return sim, problems
end

return side_by_side
