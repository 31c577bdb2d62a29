--- The moves of a machine in the file that a fleet has returned.
--
-- A move may have a snapshot of the machine after it. Where there is none, the machine
-- gets the data of now, and its regions are not known.
--
-- @module rfsm.observe.moves
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local files_of = require "rfsm.snapshot.file"
local location = require "rfsm.shared.location"
local rfsm = require "rfsm"
local shape = require "rfsm.snapshot.shape"
local snapshot = require "rfsm.snapshot"
local typed = require "rfsm.shared.typed"

local error, ipairs, os = error, ipairs, os
local floor = math.floor

local moves = {}

-- Puts a machine into a snapshot, as a server does. Raises an error if it cannot.
local function put(fsm, snap)
  local ok, problem = snapshot.put(fsm, snap,
    { migrate = fsm.migrate, rename = fsm.rename })
  if not ok then error(problem, 0) end
end

-- Returns what is known of a machine without a snapshot of then. One that was not made
-- yet has no data. A doo begins anew, and so do regions.
local function snap_in(fsm, snap, leaf)
  if leaf == "" then return { version = snap.version, chart = snap.chart } end
  local state = shape.find_state(fsm, leaf)
  return { version = snap.version, chart = snap.chart, data = snap.data, leaf = leaf,
    done = not (state and state.doo) }
end

-- Puts a machine where it was before a move. Returns whether that was possible, and
-- what is not known of it then, as a text.
local function go_before(fsm, snap, move, before)
  local is_known = before.to == move.from and before.snap
    and calls.try(put, fsm, before.snap)
  if is_known then return true end
  if not calls.try(put, fsm, snap_in(fsm, snap, move.from)) then return false end
  if move.from == "" then return true end
  return true, "with the data of now, not those of this move"
    .. (location.regions_of(fsm._act_leaf)[1]
      and "; where its regions were is not known" or "")
end

local function go_through(fsm, snap, list, leave, restart)
  local count, before = 0, {}
  for _, move in ipairs(list) do
    local ok, unknown = go_before(fsm, snap, move, before)
    if ok then leave(move, unknown) else restart() end
    count, before = ok and count + 1 or 0, move
  end
  put(fsm, snap)
  return count
end

--- Return the time in UTC and the events of a move.
function moves.text_of(move)
  return os.date("!%Y-%m-%d %H:%M:%S ", floor(move.time)) .. typed.shown(move.event)
end

--- Put a machine where a file has it. Call `leave(move, unknown)` before each move in
-- the file, with the machine as it was then; `unknown` is what is not known of it. If
-- the chart does not know a state, call `restart()`: the moves before are left out.
-- Return how many moves were left in, and of which machine the file is. The error of a
-- wrong file names it.
---@param fsm rfsm.Machine
---@param name string
---@param leave fun(move: table, unknown: string?)
---@param restart fun()
function moves.follow(fsm, name, leave, restart)
  local snap, problem = files_of.read(name)
  if not snap then error(problem, 0) end
  local fleet = snap.fleet or {}
  snap.fleet = nil
  local ok, count = calls.try(function()
    put(fsm, snap)
    return go_through(fsm, snap, fleet.history or {}, leave, restart)
  end)
  if not ok then
    local about = fleet.chart and ("a machine of chart '%s': "):format(
      rfsm.text_of(fleet.chart)) or ""
    error(name .. ": " .. about .. rfsm.text_of(count), 0)
  end
  return count, fleet
end

return moves
