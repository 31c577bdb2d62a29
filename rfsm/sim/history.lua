--- The history of a simulation: the machine after each advance, and recordings.
--
-- An *advance* is all that one command does to the machine, such as `step` or `run`. In
-- a replay each step of the recording is one.
--
-- @module rfsm.sim.history
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local calls = require "rfsm.shared.calls"
local moves = require "rfsm.observe.moves"
local files_of = require "rfsm.snapshot.file"
local record = require "rfsm.record"
local replay = require "rfsm.record.replay"
local rewind = require "rfsm.observe.rewind"
local snapshot = require "rfsm.snapshot"
local tracks = require "rfsm.record.track"

local error, ipairs, type = error, ipairs, type
local max, min = math.max, math.min
local print = print
local concat = table.concat
local text_of = rfsm.text_of

local history = { BYTES = nil } -- most bytes of a history; nil: the default of rewind

local START = { sec = 0, nsec = 0 } -- the time if there is no simulated clock

local function about(sim, snap)
  local now = sim.time and sim.time.passed or START
  local leaf = rfsm.get_actleaf_fqn(sim.fsm)
  local is_done = leaf and sim.fsm._act_leaf._mode == "done"
  if snap then leaf, is_done = snap.leaf, snap.done end
  return { came = sim.came, sec = now.sec, nsec = now.nsec, unknown = sim.unknown,
    leaf = leaf and tracks.leaf_text(leaf, is_done) or "<none>" }
end

--- Begin a history. If a recording is on, a new run begins in its file.
function history.start(sim)
  sim.came = {}
  sim.history = rewind.new(sim.fsm, { bytes = history.BYTES,
    about = function(snap) return about(sim, snap) end,
    prepare = function(place)
      local now = sim.time and sim.time.passed or {}
      now.sec, now.nsec = place.sec, place.nsec
    end })
  if not sim.recorder then return end
  sim.recorder:stop()
  sim.recorder = record.record(sim.fsm, sim.recorder.name)
end

--- Note that an advance begins. `snap` is the machine as it is, if it is known.
function history.mark(sim, snap)
  sim.history:leave(snap)
  sim.came = {}
  if sim.recorder then sim.recorder:go_on() end
end

--- Pause a recording until the next advance. The machine gets its own guards back.
function history.pause(sim)
  if sim.recorder then sim.recorder:pause() end
end

local function note_packed(sim, list)
  for _, event in ipairs(list or {}) do
    sim.came[#sim.came + 1] = tracks.event_text(event)
  end
end

--- Note the events of the present advance.
function history.note_events(sim, events)
  note_packed(sim, tracks.pack_events(events))
end

-- Go to ---------------------------------------------------------------------------

local function go(sim, name, number)
  local place, problem = sim.history:go(number)
  if not place then error(name .. ": " .. text_of(problem), 0) end
  sim.came, sim.unknown = place.about.came, place.about.unknown
end

--- Put the machine back to the end of advance n.
function history.go_to(sim, n)
  local way = sim.history
  if type(n) ~= "number" or n < way.first or n > way.last or n % 1 ~= 0 then
    error(("goto: number of an advance from %d to %d expected, got %s"):format(
      way.first, way.last, text_of(n)), 0)
  end
  go(sim, "goto", n)
end

local function check_count(name, n)
  if type(n) ~= "number" or n < 1 or n % 1 ~= 0 then
    error(name .. ": number from 1 expected, got " .. text_of(n), 0)
  end
end

--- Undo the last n advances.
function history.back(sim, n)
  local way = sim.history
  check_count("back", n)
  if way.at == way.first then error("back: nothing was done", 0) end
  go(sim, "back", max(way.at - n, way.first))
end

--- Do n advances again that `back` has undone.
function history.forward(sim, n)
  local way = sim.history
  check_count("forward", n)
  if way.at == way.last then return print("forward: this is the last advance") end
  go(sim, "forward", min(way.at + n, way.last))
end

-- Recordings ----------------------------------------------------------------------

--- Record the next advances in a file, behind what is there, as its last run. Without a
--- name, end the recording.
function history.save(sim, name)
  if sim.recorder then sim.recorder:stop() end
  sim.recorder = nil
  if not name then return end
  local ok, recorder = calls.try(record.record, sim.fsm, name)
  if not ok then error(text_of(recorder):gsub("^rfsm%.record%.", ""), 0) end
  sim.recorder = recorder
end

--- Run the chart through the recording in a file. Each step counts as an advance.
-- Return the number of steps, and a problem if the chart departs from the recording.
function history.replay(sim, name)
  local header, next_record, run = record.open(name)
  local model = sim.model
  local info, warn = model.info, model.warn
  model.info, model.warn = false, false
  local snap -- the machine of the replay between two steps
  local ok, session = calls.try(replay, model, header, next_record, {
    dry = sim.saved ~= nil, migrate = true, each = function(fsm, records)
      history.mark(sim, snap)
      for _, rec in ipairs(records) do
        note_packed(sim, rec.events)
        note_packed(sim, rec.added)
      end
      local now, problem = snapshot.try_take(fsm)
      snap = now or error(problem, 0)
    end })
  model.info, model.warn = info, warn
  if snap then
    local is_put, problem = snapshot.put(sim.fsm, snap)
    if not is_put then error(problem, 0) end
  end
  if not ok then error(session, 0) end
  return session.at, session.problem or session.unsaved
    or run.is_cut and "the last line was cut off" or nil
end

-- Machines of a fleet -------------------------------------------------------------

--- Put the machine where a file has it that a fleet has returned, or `history.keep`.
-- Each move that the file tells of is an advance. Return how many there are, and the
-- key of the machine. The error of a wrong file names it.
function history.from(sim, name)
  local count, fleet = moves.follow(sim.fsm, name, function(move, unknown)
    sim.unknown = unknown
    history.mark(sim)
    sim.came = { moves.text_of(move) }
  end, function() history.start(sim) end)
  sim.unknown = nil
  sim.fleet = { machine = fleet.machine, chart = fleet.chart,
    revision = fleet.revision }
  return count, fleet.machine
end

--- Write the machine into a file, which `history.from` and `rfsm fleet` read. Timers go
-- on from the moment at which it is put into a fleet.
function history.keep(sim, name)
  local snap = snapshot.take(sim.fsm, { structure = true })
  snap.fleet = sim.fleet
  local ok, problem = files_of.write(name, snap)
  if not ok then error("save: " .. problem, 0) end
end

--- Print what is not known of the machine, where only the history of a fleet has the
--- place where it is, or began.
function history.show_unknown(sim)
  if sim.unknown then print(sim.unknown .. ":") end
end

-- Show ----------------------------------------------------------------------------

--- Print a line for each of the last advances, at most `last` lines, and for as many of
-- those that `back` has undone (default: none). Then the present one is marked.
function history.show(sim, last, undone)
  local way = sim.history
  local problem = way:note().problem
  for number = max(way.first, way.at - last + 1, 1),
    min(way.at + (undone or 0), way.last) do
    local place = way[number].about
    local mark = number == way.at and number < way.last and ">" or ""
    print(("%4s  %-30s  %s"):format(mark .. number, concat(place.came, ", "),
      place.leaf))
  end
  if problem then print(problem) end
end

return history
