--- Recordings: the inputs of a machine are noted, and the same run is repeated.
--
-- For each iteration, `record` notes the events, the readings of the clock and the
-- results of guards. It also notes the effect: the events that the machine sent itself,
-- its leaf, and the data that its chart keeps. `replay` runs a machine through a
-- recording, and calls the user's callbacks unless the option `dry` is set. A recording
-- is a list of records. In a file each record is a line of JSON. Only the reading of a
-- file needs the package dkjson.
--
-- An iteration that an interrupt has cut short is in no record. After such an
-- iteration, a reset or a move of the machine, the next record has a snapshot.
--
-- @module rfsm.record
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local clock = require "rfsm.clock"
local journal = require "rfsm.record.journal"
local encoding = require "rfsm.snapshot.encoding"
local opts = require "rfsm.shared.options"
local order = require "rfsm.shared.order"
local replay = require "rfsm.record.replay"
local rfsm = require "rfsm"
local snapshot = require "rfsm.snapshot"
local tracks = require "rfsm.record.track"

local error, ipairs, pcall = error, ipairs, pcall
local rawequal, rawget, rawset = rawequal, rawget, rawset
local setmetatable, type = setmetatable, type
local concat = table.concat
local text_of = rfsm.text_of

local record = { VERSION = journal.VERSION }

-- Records -----------------------------------------------------------------------

--- The first record of a recording.
---@class rfsm.record.Header
---@field record integer version of the format, 1
---@field file? string file of the chart, if it is known
---@field clock? any[] readings of the clock while the snapshot was taken
---@field guards? any[] for each machine a list { number, text, number, text ... } of
-- the transitions that have a guard
---@field snapshot rfsm.snapshot.Snapshot the machine at the beginning

--- One iteration of one machine. An absent field is empty or false.
---@class rfsm.record.Record
---@field m? integer number of the region; absent for the outermost machine
---@field inner? rfsm.record.Record[] iterations of regions within this iteration
---@field from? { snapshot: rfsm.snapshot.Snapshot, clock: any[]?, early: any[]? } the
-- machine before the iteration, if its state does not follow from the earlier records;
-- `early` are readings before the snapshot: a machine put there may need fewer
---@field events? any[] the events of the iteration, before hooks have changed them
---@field added? any[] events that hooks have added, such as time events. A replay does
-- not use them: its own hooks add events
---@field had? table the kept data at the beginning, if the last record has other data
---@field clock? any[] readings of the clock: { seconds, nanoseconds } or { failure }
---@field guards? any[] { number, result, number, result ... }: numbers of transitions,
-- and the results of their guards; for a guard that failed, the text of its error
---@field always? true a transition that needs no event was taken, and no event
---@field reset? true a callback has reset the machine
---@field waiting? any[] { n, event, event ... }: at the beginning n events of the queue
-- at the end of the last iteration wait, and these; absent if all of these n wait alone
---@field sent? any[] events in the queue at the end that the machine has sent itself
---@field ahead? integer how many of these are ahead of the events that waited
---@field leaf? string FQN of the active leaf at the end
---@field done? true the leaf is done at the end
---@field kept? table the kept data at the end, if the iteration has changed it
---@field regions? any[] { number, data, number, data ... }: regions whose kept data has
-- changed outside of their iterations

-- Record -------------------------------------------------------------------------

--- A machine that is being recorded.
---@class rfsm.record.Recorder
---@field count integer how many iterations were recorded
---@field name? string name of the file that the recorder has opened
---@field timed table|false the record that gets the readings of the clock
---@field early table|false gets the readings ahead of the record: with `read = "one"`
---@field is_moved boolean the machine was reset or moved since the last iteration
---@field cuts integer how many iterations had been cut short at the last snapshot
---@field tracks rfsm.record.Track[] for each machine; empty while nothing is recorded
local Recorder = {}
Recorder.__index = Recorder

local function writer_to(sink)
  if type(sink) == "function" then return sink end
  if type(sink) == "table" and type(sink.write) ~= "function" then
    return function(rec) sink[#sink + 1] = rec end
  end
  return journal.writer(sink), true
end

local listener = {} -- functions that `tracks.attach` calls

-- Returns a clock that calls `gettime` and notes each reading in the present record.
function listener.gettime(recorder, track, gettime)
  local other = { gettime = gettime, warn = track.fsm.warn }
  return clock.new(function(_, is_relative)
    local time, sec, nsec = clock.read(other, is_relative)
    local rec = recorder.timed or track.fsm._phase ~= "idle" and recorder.early
    if rec then
      order.append(rec, "clock", time and { encoding.pack(sec),
        encoding.pack(nsec) } or { text_of(sec) })
    end
    return time ~= false, sec, nsec
  end)
end

function listener.getevents(recorder, track, own)
  return function()
    local early, timed = recorder.early, recorder.timed
    recorder.early, recorder.timed = false, false -- a replay does not call getevents
    local ok, events = calls.try(own)
    recorder.early, recorder.timed = early, timed
    if not ok then error(events, 0) end
    local waiting = #track.fsm._intq
    if track.rec and type(events) == "table" then
      track.first, track.last = waiting + 1, waiting + #events
    end
    return events
  end
end

-- Notes the kept data of a machine in `field` of a record, if it has changed. If an
-- interrupt ends this function early, the data is noted in the next record.
local function note_change(track, rec, field)
  if not tracks.may_have_changed(track.observed) then return end
  local kept = encoding.attempt(snapshot.take_data, track.fsm)
  if kept and not tracks.same(kept, track.kept) then
    if field == "regions" then
      order.append(rec, field, track.m)
      order.append(rec, field, kept)
    else
      rec[field] = kept
    end
    track.kept = kept
  end
  tracks.note_values(track.observed)
end

-- Notes changed data of a machine. The record of the outermost machine also gets the
-- data of regions that changed outside of their iterations, as when a region is reset.
local function note_data(recorder, track, rec)
  note_change(track, rec, "kept")
  for i = 2, track.m == nil and #recorder.tracks or 0 do
    note_change(recorder.tracks[i], rec, "regions")
  end
end

local function has_doo(leaf) return leaf and leaf.doo and leaf._mode ~= "done" end

local NONE = {}

-- Returns how many iterations and resets were cut short. An iteration whose callback
-- has met an interrupt counts already, since it is going to be cut short.
local function count_cuts(recorder)
  local count, tracked = 0, recorder.tracks
  for i = 1, #tracked do
    local fsm = tracked[i].fsm
    count = count + fsm._cuts
    if fsm._failure and rfsm.is_interrupt(fsm._failure[1]) then count = count + 1 end
  end
  return count
end

-- Does the present state of the machine follow from the records, without a snapshot?
local function is_known(recorder)
  return not recorder.is_moved and recorder.cuts == count_cuts(recorder)
end

-- Notes a snapshot of the machine in a record, unless the machine cannot be saved, or a
-- region is in the middle of a step that was cut short.
local function note_place(recorder, rec)
  for i = 2, #recorder.tracks do
    if recorder.tracks[i].fsm._phase ~= "idle" then return end
  end
  rec.from, rec.clock = { early = rec.clock }, nil
  recorder.timed = rec.from
  rec.from.snapshot = snapshot.try_take(recorder.fsm)
  recorder.timed = rec
  if not rec.from.snapshot then return end
  for _, track in ipairs(recorder.tracks) do track.queue = {} end
  recorder.is_moved, recorder.cuts = false, count_cuts(recorder)
end

-- Is the iteration that begins the second one of a step? Behind one that enabled
-- nothing the doo runs although events are there. A step from a snapshot has none.
local function goes_on_to_doo(track)
  return track.held and track.fsm._act_leaf and rfsm.is_free(track.fsm)
end

-- Begins a record. If the track still has a record, its iteration was cut short or
-- refused, and that record is dropped.
local function begin(recorder, track)
  local dropped, leaf = track.rec or NONE, track.fsm._act_leaf
  local rec = { m = track.m, had = dropped.had }
  track.rec = rec
  if track.m == nil then
    track.leaf, track.mode, track.has_doo = leaf, leaf and leaf._mode, has_doo(leaf)
    rec.clock = recorder.early and recorder.early.clock or nil
    local goes_on = goes_on_to_doo(track)
    -- an error may have ended the step that a replay would go on with
    local is_over = track.was_free and not goes_on
    recorder.is_moved = recorder.is_moved or dropped.reset or is_over or false
    recorder.timed = rec
    if not (goes_on or is_known(recorder)) then note_place(recorder, rec) end
  end
  note_change(track, rec, "had")
  tracks.wrap(track)
end

-- Notes the events that wait while the iteration reads `count` events.
local function note_queue(track, count)
  local n, is_all = tracks.note_queue(track, count)
  track.first = nil
  if is_all then return end
  order.append(track.rec, "waiting", n)
  for i = n + 1, #track.held do
    order.append(track.rec, "waiting", tracks.pack_event(track.held[i]))
  end
end

-- Returns the transition that needs no event and is looked at first.
local function first_free(fsm)
  return fsm._act_leaf and (fsm._act_leaf._always or NONE)[1]
end

-- The record has the answers of all guards: it begins with the first transition.
function listener.free(recorder, track, tr)
  if not rawequal(tr, first_free(track.fsm)) then return end
  begin(recorder, track)
  note_queue(track, 0)
  track.is_free = true
end

-- If an interrupt has kept `free` from its work, there is no record.
function listener.began(recorder, track, events)
  if not track.is_free and first_free(track.fsm) then
    track.rec, recorder.is_moved = false, true
    return
  end
  if not track.is_free then begin(recorder, track) end
  track.is_free = false
  track.rec.events, track.rec.waiting = tracks.pack_events(events), nil
  note_queue(track, #events)
end

-- The fields of a record that show that its iteration had an effect.
local EFFECTS = { "events", "always", "sent", "kept", "had", "from", "reset",
  "regions" }

-- Is the record of an iteration left out? It is if the machine is the outermost one,
-- and the iteration had no event, resumed no doo, and changed nothing.
local function is_empty(track, rec)
  local leaf = track.fsm._act_leaf
  if track.m ~= nil or track.has_doo or leaf ~= track.leaf then return false end
  if leaf and leaf._mode ~= track.mode then return false end
  for _, field in ipairs(EFFECTS) do
    if rec[field] then return false end
  end
  return true
end

-- Notes the events that the machine has sent, and the events that hooks have added.
local function note_events(track, rec, events)
  local sent, ahead, waiting = tracks.sent_in(track, track.first, track.last)
  track.queue = tracks.queue_of(sent, ahead, waiting)
  rec.sent, rec.added = tracks.pack_events(sent), nil
  rec.ahead = ahead > 0 and ahead or nil
  for i = (rec.events and #rec.events or 0) + 1, #events do
    order.append(rec, "added", tracks.pack_event(events[i]))
  end
end

local function note_results(recorder, track, rec, events)
  local leaf = track.fsm._act_leaf
  if leaf then rec.leaf, rec.done = leaf._fqn, leaf._mode == "done" or nil end
  note_events(track, rec, events)
  note_data(recorder, track, rec)
end

-- Notes the results of an iteration. The record of a region becomes a part of the
-- record of the outermost machine, which is written at the end of its iteration.
function listener.finished(recorder, track, events)
  local rec, outer = track.rec, recorder.tracks[1].rec
  track.was_free = rfsm.is_free(track.fsm)
  if not rec then return end
  note_results(recorder, track, rec, events)
  rec.always = track.is_free or nil
  track.rec, track.is_free = false, false -- a later reset is not noted in this record
  if track.m ~= nil then
    if outer then order.append(outer, "inner", rec) end
    return
  end
  recorder.timed, recorder.early = false, {} -- a host may read the clock, too
  if is_known(recorder) and (events[1] ~= nil or not is_empty(track, rec)) then
    recorder.write(rec)
    recorder.count = recorder.count + 1
  end
end

function listener.guard(_, track, number, guard, tr, events, event)
  local ok, answer = calls.try(guard, tr, events, event)
  if track.rec then
    order.append(track.rec, "guards", number)
    order.append(track.rec, "guards", ok and answer ~= false or not ok
      and text_of(answer))
  end
  if ok then return answer end
  track.failing = tr
  error(answer, 0)
end

function listener.attached(_, track)
  track.kept = encoding.attempt(snapshot.take_data, track.fsm)
  track.observed = tracks.observe_data(track.fsm)
end

function listener.reset(recorder, track) -- between two iterations, or by a callback
  if not recorder.tracks[1].rec then recorder.is_moved = true end
  if track.rec then track.rec.reset = true end
end

-- Notes an interrupt, since the state after it does not follow from the records. A
-- failure is an interrupt if a state that runs regions has failed, or a guard whose
-- failure `listener.guard` has not seen. Only an interrupt makes these fail.
function listener.failed(recorder, track, element, name)
  local is_own = name == "guard" and not rawequal(element, track.failing)
  if is_own or select(2, rfsm.regions(element)) then recorder.is_moved = true end
  track.failing = nil
end

--- Stop recording until `go_on` is called. Put back the functions that were replaced.
function Recorder:pause()
  tracks.detach(self.tracks)
  self.tracks = {}
end

--- Continue a recording after `pause`.
function Recorder:go_on()
  if self.tracks[1] then return end
  self.timed, self.early, self.is_moved = false, {}, true
  self.tracks = tracks.attach(self.fsm, listener, self)
end

--- End the recording.
function Recorder:stop()
  self:pause()
  if self.is_journal then self.write(nil) end
  if self.file then self.file:close() end
  self.is_journal, self.file = false, nil
end

-- Public functions ------------------------------------------------------------

local SINKS = { table = true, ["function"] = true, userdata = true, string = true }

--- Record a machine from now on.
--
-- The sink is a list to which records are appended, a function that is called with each
-- record, a file, or a file name. A file gets a line of JSON for each record, and a new
-- run is appended. Iterations without an event and without a doo are left out.
--
-- @usage
--    local recorder = record.record(fsm, "run.jsonl")
--
-- @raise during a step, or if the machine cannot be saved or the file cannot be opened
---@param fsm rfsm.Machine
---@param sink table|function|file*|string
---@return rfsm.record.Recorder recorder
function record.record(fsm, sink)
  rfsm.check_between_steps(fsm, "rfsm.record.record")
  if not SINKS[type(sink)] then
    error("rfsm.record.record: list, function, file or its name expected, "
      .. opts.got(sink), 2)
  end
  local header = { record = record.VERSION }
  local recorder = setmetatable({ fsm = fsm, count = 0, tracks = {} }, Recorder)
  recorder:go_on()
  recorder.timed = header
  local ok, snap, problem = pcall(snapshot.try_take, fsm)
  if ok and snap and type(sink) == "string" then
    recorder.file, problem = journal.open(sink)
    recorder.name = sink
  end
  if not ok or problem then recorder:pause() end
  if not ok then error(snap, 0) end
  if problem then error("rfsm.record.record: " .. problem, 2) end
  header.snapshot, header.file = snap, rfsm.location_of(fsm):match("^(.*):%d+: root$")
  recorder.write, recorder.is_journal = writer_to(recorder.file or sink)
  header.guards = tracks.guard_texts(fsm)
  recorder.write(header)
  recorder.timed = false
  recorder.is_moved, recorder.cuts = false, count_cuts(recorder)
  return recorder
end

-- Returns f(...), which reads a file. Its error names the file.
local function reading(file, f, ...)
  local ok, result, more, about = pcall(f, ...)
  if ok then return result, more, about end
  local problem = text_of(result)
  if problem:sub(1, #file) ~= file then problem = file .. ": " .. problem end
  error("rfsm.record: " .. problem, 0)
end

-- Returns what is wrong with the records of a list; nil if nothing is.
local function problem_of(list)
  for i = 2, #list do
    if type(list[i]) ~= "table" then
      return ("rfsm.record: record %d: table expected, got %s"):format(i, type(list[i]))
    end
  end
end

-- Returns the header of a recording, which is a list or the name of a file, and a
-- function that returns the next record; nil and the problem if it is none.
local function open(recording)
  local header, next_record, problem
  if type(recording) == "string" then
    header, next_record = record.open(recording)
  elseif type(recording) == "table" then
    header, next_record = journal.reader_of(recording)
    problem = problem_of(recording)
  end
  if type(header) ~= "table" or header.record ~= record.VERSION then
    return nil, "rfsm.record: a recording of format 1 expected"
  end
  if problem then return nil, problem end
  return header, next_record
end

-- Returns the machine at the end of a replay, with its own clock.
local function result_of(session, model)
  if session.is_dry then
    if session.unsaved then return false, session.unsaved end
    return snapshot.restore(model, session.snap)
  end
  if session.snap and session.latest then snapshot.put(session.fsm, session.snap) end
  return session.fsm, session.unsaved
end

local boolean = { "boolean", opts.is_a "boolean" }
local callable = { "function", rfsm.is_callable }

local OPTIONS = { to = opts.whole(0), dry = boolean, migrate = boolean,
  guards = boolean, each = callable, watch = callable }
local OPTIONS_OF_SPEC = { chart = { "file name", opts.is_text }, dry = boolean }

--- How a recording is replayed.
---@class rfsm.record.Options
---@field to? integer stop after that many iterations
---@field dry? boolean call no callbacks
---@field migrate? boolean the chart may have changed: replay up to the first difference
---@field guards? boolean call guards, too, and compare their results
---@field each? fun(fsm: rfsm.Machine, records: table[]) called after each step
---@field watch? fun(fsm: rfsm.Machine) called before the first step; may set `dbg`

--- Run a machine through a recording.
--
-- Its callbacks run, unless the option `dry` is set. The events, the readings of the
-- clock and the results of guards are taken from the recording. A file is read line by
-- line. If a line is damaged, the replay goes up to it.
--
---@param model rfsm.State the chart that was recorded
---@param recording table[]|string records, or the name of a file
---@param options? rfsm.record.Options
---@return rfsm.Machine|false fsm with its own clock; false if the replay has failed or
-- differs from the recording
---@return string? problem the step and the difference
---@return integer? step number of the last step that agrees with the recording
function record.replay(model, recording, options)
  if not rfsm.is_state(model) then
    error("rfsm.record.replay: state expected, got " .. type(model), 2)
  end
  model = rfsm.model_of(model)
  options = opts.take("rfsm.record.replay", OPTIONS, options)
  local header, next_record = open(recording)
  if not header then return false, next_record end
  local session = replay(model, header, next_record, options)
  if session.problem then
    return false, session.problem, session.fsm and session.at
  end
  return result_of(session, model)
end

--- Read the records of a run in a file. An incomplete last line is left out.
-- @raise if the file cannot be read, a line is no record or is missing, or the file has
-- no run with this number
---@param file string
---@param run? integer number of the run; default: the last run in the file
---@return table[] recording
---@return { runs: integer, is_cut: boolean, has_end: boolean } about `runs`: how many
-- runs the file has; `is_cut`: the last line was left out, since it is incomplete;
-- `has_end`: the recorder was stopped, and no line is missing
---@nodiscard
function record.read(file, run)
  opts.check_file("rfsm.record.read", file)
  local recording, about = reading(file, journal.read, file, run)
  return recording, about
end

--- Open a run in a file that may be larger than the memory.
-- @raise as `read`; `next_record` raises if it comes to a damaged line
---@param file string
---@param run? integer number of the run; default: the last run in the file
---@return rfsm.record.Header header
---@return fun(): rfsm.record.Record? next_record returns nil at the end
---@return { runs: integer, is_cut: boolean, has_end: boolean } about as in `read`, when
-- the end is reached
---@nodiscard
function record.open(file, run)
  opts.check_file("rfsm.record.open", file)
  local header, next_record, about = reading(file, journal.reader, file, run)
  return header, function() return (reading(file, next_record)) end, about
end

local SPEC = [[
-- Made from a recording.

local json = require "rfsm.json"
local record = require "rfsm.record"
local rfsm = require "rfsm"
require "rfsm_timeevent"
require "rfsm.await"

local FILE = %q

-- A line for each iteration: its events, what followed, and the active leaf then.
local RECORDING = json.decode_all %s

describe(FILE, function()
  it("takes the steps that were recorded", function()
    assert(record.replay(rfsm.load(FILE), RECORDING, { dry = %s }))
  end)
end)
]]

--- Return a busted spec that checks if a chart takes the steps that were recorded.
-- @raise if `recording` is no recording, or the file of its chart is not known
---@param recording table[]|string records, or the name of a file
---@param options? { chart: string?, dry: boolean? } `chart`: file of the chart, if not
-- the one that the recording names; `dry`: call no callbacks
---@return string text
---@nodiscard
function record.to_spec(recording, options)
  options = opts.take("rfsm.record.to_spec", OPTIONS_OF_SPEC, options)
  local header, next_record = open(recording)
  if not header then error(next_record, 0) end
  local chart, texts, mark = options.chart or header.file, {}, "="
  if not chart then error("rfsm.record.to_spec: the file of the chart expected", 2) end
  texts[1] = journal.encode(header)
  for rec in next_record do texts[#texts + 1] = journal.encode(rec) end
  local text = concat(texts, "\n")
  while text:find("]" .. mark .. "]", 1, true) do mark = mark .. "=" end
  return SPEC:format(chart, ("[%s[\n%s\n]%s]"):format(mark, text, mark),
    text_of(options.dry and true or false))
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_record", record) end

return record
