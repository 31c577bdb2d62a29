--- Recordings: what came to a machine from outside, and the same run again.
--
-- `record` notes for each iteration the events, the readings of the clock and the
-- results of guards, and what followed: the events that the machine sent itself, its
-- leaf, the data that its chart keeps. `replay` runs a machine through that, with the
-- user's callbacks or, `dry`, without them. A recording is a list of records, in a file
-- one line of JSON each; only files need the package dkjson.
--
-- A machine in a sequential AND state has records of its own, before that of the
-- iteration around them.
--
-- The file reads in this order: records, what both watch, record, replay, public
-- functions.
--
-- @module rfsm.record
-- @license BSD-3-Clause

local clock = require "rfsm.clock"
local opts = require "rfsm.options"
local plain = require "rfsm.plain"
local rfsm = require "rfsm"
local snapshot = require "rfsm.snapshot"

local error, getmetatable, ipairs, pairs = error, getmetatable, ipairs, pairs
local pcall, rawequal, rawget, rawset = pcall, rawequal, rawget, rawset
local select, setmetatable = select, setmetatable
local require, tostring, type = require, tostring, type
local io = rawget(_G, "io")
local max, min = math.max, math.min
local concat = table.concat
local is_scalar, reason, text_of = plain.is_scalar, plain.reason, rfsm.text_of

local record = { VERSION = 1 }

-- Records -----------------------------------------------------------------------

--- The first record of a recording.
---@class rfsm.record.Header
---@field record integer version of the format, 1
---@field file? string the chart, if it is known
---@field clock? any[] readings while the snapshot was taken
---@field snapshot rfsm.snapshot.Snapshot where the machine stood

--- One iteration of one machine. What is absent is empty or false.
---@class rfsm.record.Record
---@field m? integer number of a machine in a sequential AND state
---@field fresh? true the machine was reset before
---@field events? any[] of the iteration, before hooks have changed them
---@field had? table the user's data, if it has changed since the iteration before
---@field got? any[] those that getevents returned since the iteration before
---@field clock? any[] readings: { seconds, nanoseconds } or { failure }
---@field guards? any[] number of a transition, result, number ...: a text is a failure
---@field reset? true a callback has reset the machine
---@field sent? any[] events that wait then, sent by the machine itself
---@field leaf? string FQN of the active leaf then
---@field done? true the leaf is done
---@field kept? table the user's data, if it has changed

local KEY_ORDER = {
  "record", "file", "m", "fresh", "had", "events", "got", "clock", "guards", "reset",
  "sent", "leaf", "done", "kept",
}

local PATH = { owner = "", base = 0, seen = {}, packed = {} }

-- An event as plain data; one that is none is noted by its type, and not replayed.
local function pack_event(event)
  if is_scalar(event) then return plain.pack(event, PATH, 0) end
  return { "%x", type(event) }
end

local function pack_events(events)
  local list = {}
  for i = 1, #events do list[i] = pack_event(events[i]) end
  return list[1] ~= nil and list or nil
end

local function list_text(list)
  local texts = {}
  for i = 1, list and #list or 0 do
    texts[i] = type(list[i]) == "table" and "an event that is a " .. text_of(list[i][2])
      or text_of(list[i])
  end
  return texts[1] and concat(texts, ", ") or "none"
end

local function place_text(leaf, is_done)
  return leaf and leaf .. (is_done and "(done)" or "(active)") or "none"
end

local function same(a, b)
  if type(a) ~= "table" or type(b) ~= "table" then return rawequal(a, b) end
  for key, value in pairs(a) do -- any order: all have to be the same
    if not same(value, b[key]) then return false end
  end
  for key in pairs(b) do -- likewise
    if a[key] == nil then return false end
  end
  return true
end

-- Appends to the list t[field].
local function note(t, field, ...)
  local list = t[field] or {}
  t[field] = list
  for i = 1, select("#", ...) do list[#list + 1] = (select(i, ...)) end
end

-- What record and replay watch: the clock, and a machine ----------------------------

-- Has clocks be read through wrap(read), instead of what the owner had before; nil: as
-- they are.
local function watch_clock(owner, wrap)
  local in_use = clock.in_use
  for kind, read in pairs(owner.clocks or {}) do -- any order: each stands alone
    if in_use[kind] == read.own then in_use[kind] = read.before end
  end
  owner.clocks = wrap and {}
  for _, kind in ipairs(wrap and { true, false } or {}) do
    owner.clocks[kind] = { own = wrap(in_use[kind]), before = in_use[kind] }
    in_use[kind] = owner.clocks[kind].own
  end
end

-- Calls f(...) meanwhile; returns whether it succeeded, and two results.
local function with_clock(owner, wrap, f, ...)
  watch_clock(owner, wrap)
  local is_whole, ok, result, problem = pcall(plain.pcall, f, ...)
  watch_clock(owner, nil)
  if not is_whole then error(ok, 0) end
  return ok, result, problem
end

--- A machine that is recorded or replayed, and what it calls.
---@class rfsm.record.Track
---@field fsm rfsm.Machine
---@field m integer|nil its number; nil for the machine around the others
---@field rec rfsm.record.Record|false of the iteration that is under way
---@field begin function the pre step hook
---@field finish function the post step hook
---@field reset function the reset hook
---@field guard function called in place of each guard: number, guard, arguments
---@field guards table<rfsm.Transition, { own: function, new: function }>
---@field getevents function|nil set on the machine, in place of its own
---@field own_getevents function|nil

-- Makes the tracks of a machine and of those in its states, by add(track).
local function attach(fsm, add)
  local tracks = {}
  for i, machine in ipairs(snapshot.machines(fsm)) do
    local track = { fsm = machine, m = i > 1 and i - 1 or nil, rec = false }
    track.guards = {}
    add(track)
    for number, tr in ipairs(rfsm.elements(machine, rfsm.is_trans)) do
      local own = tr.guard
      if own then
        local function guard(_, list) return track.guard(number, own, tr, list) end
        tr.guard, track.guards[tr] = guard, { own = own, new = guard }
      end
    end
    rfsm.pre_step_hook_add(machine, track.begin, "before")
    rfsm.post_step_hook_add(machine, track.finish, "before")
    rfsm.reset_hook_add(machine, track.reset)
    tracks[i] = track
  end
  return tracks
end

local function detach(tracks)
  for _, track in ipairs(tracks) do
    local fsm = track.fsm
    for tr, guard in pairs(track.guards) do -- any order: each stands alone
      if rawequal(tr.guard, guard.new) then tr.guard = guard.own end
    end
    if rawget(fsm, "getevents") == track.getevents then
      fsm.getevents = track.own_getevents
    end
    rfsm.pre_step_hook_rm(fsm, track.begin)
    rfsm.post_step_hook_rm(fsm, track.finish)
    rfsm.reset_hook_rm(fsm, track.reset)
  end
end

-- Record -------------------------------------------------------------------------

--- A machine that is being recorded.
---@class rfsm.record.Recorder
---@field count integer iterations so far
---@field sink any
local Recorder = {}
Recorder.__index = Recorder

-- Returns a function that appends a record to the sink.
local function writer_to(sink)
  if type(sink) == "function" then return sink end
  if type(sink) == "table" and type(sink.write) ~= "function" then
    return function(rec) sink[#sink + 1] = rec end
  end
  local encode = opts.need("rfsm.record", "dkjson", "lua-dkjson").encode
  return function(rec)
    sink:write(encode(rec, { keyorder = KEY_ORDER }), "\n")
    if sink.flush then sink:flush() end
  end
end

-- Has readings of the clock noted in t.clock.
local function noting(t)
  return function(read)
    return function(...)
      local ok, sec, nsec = plain.pcall(read, ...)
      if not ok then
        note(t, "clock", { text_of(sec) })
        error(sec, 0)
      end
      note(t, "clock", { plain.pack(sec, PATH, 0), nsec and plain.pack(nsec, PATH, 0) })
      return sec, nsec
    end
  end
end

-- Sees to it that what getevents returns is noted.
local function wrap_getevents(track)
  local fsm, getevents = track.fsm, rawget(track.fsm, "getevents")
  if not getevents or getevents == track.getevents then return end
  track.own_getevents = getevents
  function track.getevents()
    local events, waiting = getevents(), #fsm._intq
    if type(events) ~= "table" then return events end
    for i = 1, #events do note(track, "got", pack_event(events[i])) end
    if track.rec then track.first, track.last = waiting + 1, waiting + #events end
    return events
  end
  fsm.getevents = track.getevents
end

-- Notes the data that the chart keeps in a field of the record, if it has changed.
local function note_kept(track, field)
  local ok, kept = plain.pcall(snapshot.take_data, track.fsm)
  if not ok or same(kept, track.kept) then return end
  track.kept, track.rec[field] = kept, kept
end

-- Begins the record of an iteration. One that a hook has cut short has none.
local function begin(recorder, track, events)
  track.rec = { m = track.m, fresh = track.is_fresh or nil, got = track.got,
    events = pack_events(events) }
  note_kept(track, "had")
  track.got, track.is_fresh, track.first, track.last = nil, false, 1, 0
  wrap_getevents(track)
  if track.m == nil then watch_clock(recorder, noting(track.rec)) end
end

-- Notes what followed, and writes the record. An interrupt has to wait for that.
local function finish(recorder, track)
  local rec, queue, leaf = track.rec, track.fsm._intq, track.fsm._act_leaf
  if not rec then return end
  for i = 1, #queue do
    local is_got = i >= track.first and i <= track.last
    if not is_got then note(rec, "sent", pack_event(queue[i])) end
  end
  if leaf then rec.leaf, rec.done = leaf._fqn, leaf._mode == "done" or nil end
  local is_whole, interrupt = pcall(note_kept, track, "kept")
  track.rec = false
  if track.m == nil then
    watch_clock(recorder, nil)
    recorder.count = recorder.count + 1
  end
  recorder.write(rec)
  if not is_whole then error(interrupt, 0) end
end

local function call_guard(track, number, guard, tr, events)
  local ok, answer = plain.pcall(guard, tr, events)
  if track.rec then
    note(track.rec, "guards", number, ok and answer ~= false or not ok
      and text_of(answer))
  end
  if not ok then error(answer, 0) end
  return answer
end

local function add_recorder(recorder, track)
  track.is_fresh, track.kept = false, snapshot.take_data(track.fsm)
  function track.begin(_, events) begin(recorder, track, events) end
  function track.finish() finish(recorder, track) end
  function track.reset()
    if track.rec then track.rec.reset = true else track.is_fresh = true end
  end
  function track.guard(...) return call_guard(track, ...) end
  wrap_getevents(track)
end

--- Record no more.
function Recorder:stop()
  detach(self.tracks)
  watch_clock(self, nil)
  if self.file then self.file:close() end
  self.tracks, self.file = {}, nil
end

-- Replay -------------------------------------------------------------------------

--- A machine that is being replayed.
---@class rfsm.record.Session
---@field records rfsm.record.Record[] of the machine around the others
---@field inner table<integer, rfsm.record.Record[]> of the others
---@field step_of table<rfsm.record.Record, integer> the iteration around each of those
---@field at integer how many records have been replayed
---@field last integer how many are to be
---@field is_dry boolean
---@field problem string|nil where the run departs from the recording
---@field latest any[]|nil the reading of the clock

-- Raised by a pre step hook, to end a step that would go further than the recording.
local STOP = {}

local function depart(session, form, ...)
  session.problem = session.problem
    or ("step %d: "):format(session.at + 1) .. form:format(...)
end

-- Makes a list hold these events; departs from events that are no plain data.
local function fill(session, list, events)
  for i = #list, 1, -1 do list[i] = nil end
  for i = 1, events and #events or 0 do
    local event = plain.unpack(events[i], 0)
    if is_scalar(event) then
      list[i] = event
    else
      depart(session, "%s cannot be replayed", list_text({ events[i] }))
    end
  end
end

-- Has readings of the clock come from a list; behind its end, the latest one.
local function reading(session, readings)
  local i = 0
  local function read()
    i = i + 1
    local now = readings and readings[i] or session.latest or { 0, 0 }
    if type(now[1]) == "string" then error(now[1], 0) end
    session.latest = now
    return plain.unpack(now[1], 0), plain.unpack(now[2], 0)
  end
  return function() return read end
end

-- Returns the record of the iteration that begins; raises STOP if there is none.
local function next_record(session, track)
  local rec = track.records[track.at + 1]
  if track.m == nil then
    local is_over = session.problem or session.at >= session.last
    if is_over or rec.fresh and not track.is_fresh then error(STOP, 0) end
    track.is_fresh = false
  elseif not rec or session.step_of[rec] ~= session.at + 1 then
    depart(session, "machine %d in a sequential AND state takes a step that was not "
      .. "recorded", track.m)
    error(STOP, 0)
  end
  track.at = track.at + 1
  return rec
end

local function begin_again(session, track, events)
  local rec = next_record(session, track)
  track.rec, track.guard_at = rec, 0
  fill(session, events, rec.events)
  if rec.had then snapshot.put_data(track.fsm, rec.had) end
  if track.m == nil then watch_clock(session, reading(session, rec.clock)) end
  if rec.reset and session.is_dry then rfsm.reset(track.fsm) end
end

local function compare(session, track)
  local fsm, rec, leaf = track.fsm, track.rec, track.fsm._act_leaf
  local place = place_text(leaf and leaf._fqn, leaf and leaf._mode == "done")
  local recorded = place_text(rec.leaf, rec.done)
  if place ~= recorded then
    return depart(session, "active leaf %s expected, got %s", recorded, place)
  elseif session.is_dry then
    return
  end
  local sent = pack_events(fsm._intq)
  if not same(sent, rec.sent) then
    depart(session, "events sent: %s expected, got %s", list_text(rec.sent),
      list_text(sent))
  end
  if rec.kept and not same(rec.kept, snapshot.take_data(fsm)) then
    depart(session, "the data of the machine is not as it was")
  end
end

local function finish_again(session, track)
  local rec = track.rec
  if not rec then return end
  if track.m == nil then watch_clock(session, nil) end
  local ok, failure = plain.pcall(compare, session, track)
  if not ok then depart(session, "%s", reason(failure)) end
  if session.is_dry then
    fill(session, track.fsm._intq, rec.sent)
    if rec.kept then snapshot.put_data(track.fsm, rec.kept) end
  end
  track.rec = false
  if track.m == nil and not session.problem then session.at = session.at + 1 end
end

-- Returns what was recorded of a guard; with `is_called` it is called, and compared.
local function answer_again(session, track, is_called, number, guard, tr, events)
  if not track.rec then return guard(tr, events) end
  local list, at = track.rec.guards or {}, track.guard_at + 1
  local answer = list[at + 1]
  track.guard_at = at + 1
  if list[at] ~= number then
    depart(session, "the guard of %s was not called then", tostring(tr))
    return false
  elseif is_called then
    local ok, now = plain.pcall(guard, tr, events)
    if (ok and now ~= false) ~= (answer == true) then
      depart(session, "the guard of %s behaves otherwise", tostring(tr))
    end
  end
  if type(answer) == "string" then error(answer, 0) end
  return answer
end

-- A doo that ends when the recorded one did.
local function doo_again(session, track)
  return function(_, state)
    while true do
      local rec, following = track.rec, track.records[track.at + 1]
      if rec and rec.done and rec.leaf == state._fqn then
        for _, event in ipairs(rec.sent or {}) do
          if event == "e_done@" .. state._fqn then return end
        end
        error("the doo failed when it was recorded", 0)
      end
      rfsm.yield(not (track.m and session.step_of[following] == session.at + 1))
    end
  end
end

-- Takes the user's callbacks away.
local function dry(session, track)
  local fsm = track.fsm
  fsm.pre_step_hook, fsm.post_step_hook = nil, nil
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    local owner = state._seqand or state
    owner.entry, owner.exit = nil, nil
    if state.doo and not state._seqand then state.doo = doo_again(session, track) end
  end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    tr.effect, tr.likely = nil, nil
  end
end

local function add_player(session, track, options)
  local fsm = track.fsm
  track.at, track.guard_at = 0, 0
  track.records = track.m and (session.inner[track.m] or {}) or session.records
  track.own_getevents, fsm.getevents = rawget(fsm, "getevents"), nil
  if session.is_dry then dry(session, track) end
  function track.begin(_, events) begin_again(session, track, events) end
  function track.finish() finish_again(session, track) end
  function track.reset() end
  function track.guard(...) return answer_again(session, track, options.guards, ...) end
end

-- Advances the machine to the end of the recording, or to where it departs from it.
local function run(session, track)
  while session.at < session.last and not session.problem do
    local before = session.at
    track.is_fresh = session.records[before + 1].fresh
    if track.is_fresh then rfsm.reset(track.fsm) end
    local ok, failure = plain.pcall(rfsm.step, track.fsm)
    if not ok and not rawequal(failure, STOP) then
      depart(session, "%s", reason(failure))
    elseif session.at == before then
      depart(session, "the machine takes no step")
    end
  end
end

-- A model that says nothing, and is otherwise the same.
local function quiet(model)
  local copy = {}
  for key, value in pairs(model) do copy[key] = value end -- any order: a copy
  copy.dbg, copy.info, copy.warn, copy.err = false, false, false, false
  return setmetatable(copy, getmetatable(model))
end

-- Splits a recording: the records of the machine, and those of others by number.
local function new_session(recording, options)
  local session = { records = {}, inner = {}, step_of = {}, at = 0, last = 0,
    is_dry = options.dry and true or false, problem = nil }
  for i = 2, #recording do
    local rec = recording[i]
    session.step_of[rec] = #session.records + 1
    if rec.m then note(session.inner, rec.m, rec) else note(session, "records", rec) end
  end
  session.last = options.to or options["until"] or #session.records
  session.last = min(max(session.last, 0), #session.records)
  return session
end

-- Returns the machine as it stands, on the clock of now.
local function settle(session, model, fsm)
  local ok, snap = with_clock(session, reading(session), snapshot.take, fsm)
  if not ok then return not session.is_dry and fsm or nil, text_of(snap) end
  if session.is_dry then return snapshot.restore(model, snap) end
  if session.latest then snapshot.put(fsm, snap) end
  return fsm
end

local function replay(model, recording, options)
  local session, header = new_session(recording, options), recording[1]
  local ok, fsm, problem = with_clock(session, reading(session, header.clock),
    snapshot.restore, session.is_dry and quiet(model) or model, header.snapshot)
  if not ok or not fsm then return false, problem or text_of(fsm) end
  local tracks = attach(fsm, function(track) add_player(session, track, options) end)
  if options.watch then options.watch(fsm) end
  ok, problem = with_clock(session, reading(session), run, session, tracks[1])
  detach(tracks)
  if not ok then error(problem, 0) end
  if session.problem then return false, session.problem, session.at end
  return settle(session, model, fsm)
end

-- Public functions ------------------------------------------------------------

--- Record a machine from now on.
--
-- The sink is a list, which gets the records; a function, called with each; or a file
-- or its name, which gets a line of JSON for each.
--
-- @usage
--    local recorder = record.record(fsm, "run.jsonl")
--
-- @raise if a step is under way, the machine cannot be saved, or the file not opened
---@param fsm rfsm.Machine
---@param sink table|function|file*|string
---@return rfsm.record.Recorder recorder
function record.record(fsm, sink)
  rfsm.check_between_steps(fsm, "rfsm.record.record")
  local header = { record = record.VERSION }
  local recorder = setmetatable({ fsm = fsm, sink = sink, count = 0 }, Recorder)
  local ok, snap = with_clock(recorder, noting(header), snapshot.take, fsm)
  if not ok then error("rfsm.record.record: " .. text_of(snap), 2) end
  if type(sink) == "string" then
    local file, problem = io.open(sink, "a")
    if not file then error("rfsm.record.record: " .. problem, 2) end
    recorder.sink, recorder.file = file, file
  end
  header.snapshot, header.file = snap, rfsm.location_of(fsm):match("^(.*):%d+: root$")
  recorder.write = writer_to(recorder.sink)
  recorder.write(header)
  recorder.tracks = attach(fsm, function(track) add_recorder(recorder, track) end)
  return recorder
end

-- Drops the records after iteration number `count`.
local function truncate(records, count)
  local kept = 1
  for i = 2, #records do
    if not records[i].m then count = count - 1 end
    if count >= 0 and not records[i].m then kept = i end
  end
  for i = #records, kept + 1, -1 do records[i] = nil end
end

--- Have the machine stand where it stood `n` (1) iterations ago, and forget the records
-- since. No callback runs; what the chart does not keep stays as it is.
--
-- @raise if the sink is no list
---@param n? integer
---@return boolean ok
---@return string? problem
function Recorder:back(n)
  if type(self.sink) ~= "table" or self.sink[1] == nil then
    error("rfsm.record: back: a recording in a list expected", 2)
  end
  rfsm.check_between_steps(self.fsm, "rfsm.record.back")
  local count, model = max(self.count - (n or 1), 0), self.fsm._plan.model
  local fsm, problem = replay(model, self.sink, { dry = true, to = count })
  if not fsm then return false, problem end
  local ok, text = snapshot.put(self.fsm, snapshot.take(fsm))
  if not ok then return false, text end
  truncate(self.sink, count)
  self.count = count
  for _, track in ipairs(self.tracks) do
    track.is_fresh, track.got, track.rec = false, nil, false
    track.kept = snapshot.take_data(track.fsm)
  end
  return true
end

-- Returns the header of a recording; a text if it is none.
local function check_recording(recording)
  local header = type(recording) == "table" and recording[1]
  local version = type(header) == "table" and header.record
  if version ~= record.VERSION then
    return "rfsm.record: a recording of format 1 expected"
  end
  for i = 2, #recording do
    if type(recording[i]) ~= "table" then
      return ("rfsm.record: record %d: table expected, got %s"):format(i,
        type(recording[i]))
    end
  end
  return header
end

--- How a recording is replayed.
---@class rfsm.record.Options
---@field to? integer stop after that many iterations
---@field dry? boolean call no callback
---@field guards? boolean call guards, too, and compare their results
---@field watch? fun(fsm: rfsm.Machine) called before the first step, to set a `dbg`

--- Run a machine through a recording.
--
-- Its callbacks run, but getevents and the clock are those of the recording, and so are
-- the results of guards. `dry`: no callback runs.
--
---@param model rfsm.State the chart that was recorded
---@param recording table[]|string records, or the name of a file
---@param options? rfsm.record.Options
---@return rfsm.Machine|false fsm where it stands then, on the clock of now; false if it
-- has departed from the recording
---@return string? problem the step, and what differs
---@return integer? step the last one that was the same
function record.replay(model, recording, options)
  if not rfsm.is_state(model) then
    error("rfsm.record.replay: state expected, got " .. type(model), 2)
  end
  if rfsm.is_initialized_root(model) then model = model._plan.model end
  if type(recording) == "string" then recording = record.read(recording) end
  local header = check_recording(recording)
  if type(header) == "string" then return false, header end
  return replay(model, recording, options or {})
end

--- Read the records in a file. A last line that was cut off is left out.
-- @raise if the file cannot be read, or a line is no record
---@param file string
---@return table[] recording
---@nodiscard
function record.read(file)
  local handle, problem = io.open(file)
  if not handle then error("rfsm.record: " .. problem, 0) end
  local ok, recording = pcall(require("rfsm.json").decode_all, handle:read("*a"))
  handle:close()
  return ok and recording or error(("rfsm.record: %s: %s"):format(file, recording), 0)
end

local literal

-- Returns a table of plain data as Lua: the list, then its keys, sorted.
local function table_literal(t)
  local texts = {}
  for i = 1, #t do texts[i] = literal(t[i]) end
  local function is_name(_, key) return type(key) == "string" end
  for _, key in ipairs(rfsm.sorted_keys(t, is_name)) do
    local name = key:find("^%l+$") and key ~= "end" and key or ("[%q]"):format(key)
    texts[#texts + 1] = name .. " = " .. literal(t[key])
  end
  return texts[1] and "{ " .. concat(texts, ", ") .. " }" or "{}"
end

function literal(value)
  if type(value) == "table" then return table_literal(value) end
  if type(value) == "string" then return (("%q"):format(value):gsub("\n", "n")) end
  return text_of(value)
end

local SPEC = [[
-- Made from a recording.

local record = require "rfsm.record"
local rfsm = require "rfsm"
require "rfsm_timeevent"
require "rfsm.await"

local FILE = %s

-- Each comment: the iteration, its events, and the active leaf then.
local RECORDING = {
%s
}

describe(FILE, function()
  it("takes the steps that were recorded", function()
    assert(record.replay(rfsm.load(FILE), RECORDING, { dry = %s }))
  end)
end)
]]

--- Return a busted spec: the chart takes the steps that were recorded.
-- @raise if the recording is none, or its chart is not known
---@param recording table[]|string records, or the name of a file
---@param options? { chart: string?, dry: boolean? } `chart`: its file, if not the one
-- in the recording; `dry`: call no callbacks
---@return string text
---@nodiscard
function record.to_spec(recording, options)
  options = options or {}
  if type(recording) == "string" then recording = record.read(recording) end
  local header = check_recording(recording)
  if type(header) == "string" then error(header, 0) end
  local chart, lines, count = options.chart or header.file, {}, 0
  if not chart then error("rfsm.record.to_spec: the file of the chart expected", 2) end
  for i, rec in ipairs(recording) do
    lines[i] = "  " .. literal(rec) .. ","
    if i > 1 and not rec.m then
      count = count + 1
      lines[i] = ("%s -- %d: %s -> %s"):format(lines[i], count,
        (list_text(rec.events):gsub("[%c]", " ")), place_text(rec.leaf, rec.done))
    end
  end
  return SPEC:format(literal(chart), concat(lines, "\n"),
    text_of(options.dry and true or false))
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_record", record) end

return record
