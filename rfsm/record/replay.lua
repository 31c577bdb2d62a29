--- Replay: runs a machine through a recording.
--
-- @module rfsm.record.replay
-- @license BSD-3-Clause

local order = require "rfsm.shared.order"
local calls = require "rfsm.shared.calls"
local clock = require "rfsm.clock"
local encoding = require "rfsm.snapshot.encoding"
local rfsm = require "rfsm"
local snapshot = require "rfsm.snapshot"
local instrument = require "rfsm.shared.instrument"
local match = require "rfsm.shared.match"
local migrate = require "rfsm.snapshot.migrate"
local tracks = require "rfsm.record.track"

local error, ipairs = error, ipairs
local rawequal, tostring, type = rawequal, tostring, type
local huge, min, remove = math.huge, math.min, table.remove
local reason, text_of = encoding.reason, rfsm.text_of
local list_text, leaf_text, same = tracks.list_text, tracks.leaf_text, tracks.same

--- A machine that is being replayed.
---@class rfsm.record.Session
---@field next_record fun(): rfsm.record.Record? the next record of the outermost
--- machine; nil at the end
---@field ahead rfsm.record.Record|nil the record that is replayed next
---@field taken rfsm.record.Record[] the records that the present step has replayed
---@field at integer how many records have been replayed
---@field last integer how many records are to be replayed at most
---@field is_dry boolean the functions of the chart are not called
---@field fsm rfsm.Machine|nil nil if `init` or the load of the first snapshot failed
---@field problem string|nil why there is no machine, or how it departs from the records
---@field snap rfsm.snapshot.Snapshot|nil the machine at the end; nil after a problem
---@field unsaved string|nil why the machine cannot be saved at the end
---@field clock rfsm.clock.Clock replaces the clocks of the machines
---@field readings any[]|nil the next readings of the clock in this iteration
---@field latest any[]|nil the reading that was returned last

-- The error that a pre step hook raises to end a step at the end of the recording.
local STOP = {}

local function depart(session, form, ...)
  session.problem = session.problem
    or ("step %d: "):format(session.at + 1) .. form:format(...)
end

-- Replaces the items of a list by recorded events, which are unpacked. If an event
-- cannot be replayed, the replay departs from the recording.
local function add_event(session, list, packed)
  local event = encoding.unpack(packed, 0)
  if encoding.is_scalar(event) or encoding.is_event(event) then
    list[#list + 1] = event
  else
    depart(session, "%s cannot be replayed", list_text({ packed }))
  end
end

local function replace(list, events)
  for i = #events + 1, #list do list[i] = nil end
  for i = 1, #events do list[i] = events[i] end
end

local function fill(session, list, events)
  replace(list, {})
  for i = 1, events and #events or 0 do add_event(session, list, events[i]) end
end

-- Returns the queue at the beginning of an iteration: what waits of the queue at the
-- end of the last one, and what came since. If an event cannot be replayed, a table is
-- there in its place, and the replay departs when it is read.
local function waiting_of(track)
  local list, rec = {}, track.rec
  local count = rec.events and #rec.events or 0
  local noted = rec.waiting or { #track.queue }
  for i = count + 1, min(count + noted[1], #track.queue) do
    list[#list + 1] = track.queue[i]
  end
  for i = 2, #noted do list[#list + 1] = encoding.unpack(noted[i], 0) end
  return list
end

-- Appends the events that a dry run lacks: callbacks had sent them for a later time.
local function add_sends(session, list, added)
  for i = 1, added and #added or 0 do
    if not match.maker_of(added[i]) then add_event(session, list, added[i]) end
  end
end

-- Returns true and the next recorded reading of the clock, or false and the recorded
-- error. When no readings are left, the last one is returned again.
local function read_again(session)
  local now = remove(session.readings or {}, 1) or session.latest or { 0, 0 }
  if type(now[1]) == "string" then return false, now[1] end
  session.latest = now
  return true, encoding.unpack(now[1], 0), encoding.unpack(now[2], 0)
end

-- Hands out the readings of the next iteration. With `read = "one"` the clock is read
-- before `began` is called. If the machine has to be put elsewhere first, there are
-- none; after that there are those of before `began`.
local function wind(session)
  local rec = session.ahead or {}
  local list = rec.clock
  if rec.from then list = session.tracks[1].is_put and rec.from.early end
  session.readings = match.joined({}, list or {})
end

-- Reads the next record. A damaged recording is replayed up to the damage.
local function look_ahead(session)
  local ok, rec = calls.try(session.next_record)
  session.ahead = ok and rec or nil
  if not ok then session.problem = text_of(rec) end
  wind(session)
end

local function is_over(session)
  return session.problem or session.at >= session.last or not session.ahead
end

-- Returns the record of the iteration that begins; raises STOP if there is none.
local function next_record(session, track)
  local rec = track.records[track.at + 1]
  if track.m == nil then
    rec = session.ahead
    if is_over(session) or rec.from and not track.is_put then error(STOP, 0) end
    track.is_put = false
    return rec
  elseif not rec then
    depart(session, "machine %d in a sequential AND state takes a step that was not "
      .. "recorded", track.m)
    error(STOP, 0)
  end
  track.at = track.at + 1
  return rec
end

-- Gives each region its records in an iteration of the outermost machine.
local function hand_out(session, inner)
  for i = 2, #session.tracks do
    session.tracks[i].at, session.tracks[i].records = 0, {}
  end
  for _, rec in ipairs(inner) do
    local track = session.tracks[rec.m + 1]
    if track then order.append(track, "records", rec) end
  end
end

local listener = {} -- functions that `tracks.attach` calls

local function begin(session, track)
  local rec = next_record(session, track)
  track.rec, track.guard_at = rec, 0
  if rec.had then snapshot.put_data(track.fsm, rec.had) end
  if track.m ~= nil then return end
  if rec.from then session.readings = match.joined({}, rec.clock or {}) end
  hand_out(session, rec.inner or {})
end

-- Fills the queue, and resets the machine of a dry run if a callback had done so. A
-- search behind `free` would see the reset, so it comes when the iteration is known.
local function go_on(session, track, count, is_known)
  replace(track.fsm._intq, waiting_of(track))
  tracks.note_queue(track, count)
  if is_known and track.rec.reset and session.is_dry then rfsm.reset(track.fsm) end
end

-- Forbids a transition that needs no event if there is no record for the iteration.
function listener.free(session, track)
  if track.is_free then return end
  if not calls.try(begin, session, track) then return false end
  go_on(session, track, 0, track.rec.always)
  track.is_free = true
end

function listener.began(session, track, events)
  if not track.is_free then begin(session, track) end
  track.is_free = false
  fill(session, events, track.rec.events)
  if session.is_dry then add_sends(session, events, track.rec.added) end
  go_on(session, track, #events, true)
end

local function data_text(value)
  if value == nil or rawequal(value, encoding.NIL) then return "nothing" end
  if type(value) == "string" then return ("'%s'"):format(value) end
  return type(value) == "table" and "a table" or text_of(value)
end

-- Returns the path of the first field in which data differs, and the two values.
local function find_difference(old, new, path)
  if type(old) ~= "table" or type(new) ~= "table" then return path, old, new end
  local all = {}
  for key in order.each(old) do all[key] = true end -- any order: they are sorted below
  for key in order.each(new) do all[key] = true end
  for _, key in ipairs(rfsm.sorted_keys(all)) do
    if not same(old[key], new[key]) then
      return find_difference(old[key], new[key], path
        .. (type(key) == "string" and "." .. key or "[" .. text_of(key) .. "]"))
    end
  end
end

local function values_of(packed) return packed and encoding.unpack(packed, 0) or {} end

local TARGETS = "the targets of transitions are not as they were"

-- Returns a text about the first difference between recorded data and present data.
local function difference(old, new)
  for _, part in ipairs { "data", "saved" } do
    local before, now = old[part] or {}, new[part] or {}
    for _, fqn in ipairs(rfsm.sorted_keys(same(before, now) and {} or before)) do
      if not same(before[fqn], now[fqn]) then
        local path, a, b = find_difference(values_of(before[fqn]), values_of(now[fqn]),
          part == "data" and fqn or "save of " .. fqn)
        return ("%s: %s expected, got %s"):format(path, data_text(a), data_text(b))
      end
    end
  end
  return same(old.targets, new.targets) and "there is data that was not there"
    or TARGETS
end

-- Returns packed events as they are compared: the traceback of a fault has lines of the
-- program that runs the machine.
local function comparable(packed)
  local events = {}
  for i = 1, packed and #packed or 0 do
    local event = encoding.unpack(packed[i], 0)
    local name = rfsm.name_with_data(event)
    if name and name:find "^e_fault@" then event.traceback = nil end
    events[i] = event
  end
  return events
end

local function compare(session, track)
  local fsm, rec, leaf = track.fsm, track.rec, track.fsm._act_leaf
  local present = leaf_text(leaf and leaf._fqn, leaf and leaf._mode == "done")
  local recorded = leaf_text(rec.leaf, rec.done)
  if track.is_free ~= (rec.always or false) then
    return depart(session, "a transition that needs no event %s", track.is_free
      and "was taken" or "expected, none was taken")
  elseif present ~= recorded then
    return depart(session, "active leaf %s expected, got %s", recorded, present)
  elseif session.is_dry then
    return
  end
  local sent = tracks.pack_events((tracks.sent_in(track)))
  if not same(comparable(sent), comparable(rec.sent)) then
    depart(session, "events sent: %s expected, got %s", list_text(rec.sent),
      list_text(sent))
  end
  if rec.kept and not same(rec.kept, snapshot.take_data(fsm)) then
    depart(session, "%s", difference(rec.kept, snapshot.take_data(fsm)))
  end
end

-- Has each region taken all of its steps?
local function compare_counts(session)
  for i = 2, #session.tracks do
    local track = session.tracks[i]
    if track.at < #track.records then
      depart(session, "machine %d in a sequential AND state: %d steps expected, got %d",
        track.m, #track.records, track.at)
    end
  end
end

-- Gives a machine its recorded data. Targets are noted by the numbers of transitions. A
-- chart that has changed may have given these to others, so nobody sets its targets.
local function put_data(session, fsm, kept)
  local targets = session.has_changed and snapshot.take_data(fsm).targets
  if session.has_changed and not same(kept.targets, targets) then
    return depart(session, TARGETS)
  end
  snapshot.put_data(fsm, kept)
end

-- Does in a dry run what callbacks had done: the queue and the data become what they
-- were.
local function do_again(session, track)
  local rec, sent, _, waiting = track.rec, tracks.sent_in(track, 1, 0)
  fill(session, sent, rec.sent)
  replace(track.fsm._intq, tracks.queue_of(sent, rec.ahead or 0, waiting))
  if rec.kept then put_data(session, track.fsm, rec.kept) end
  for i = 1, rec.regions and #rec.regions or 0, 2 do
    put_data(session, session.tracks[rec.regions[i] + 1].fsm, rec.regions[i + 1])
  end
end

function listener.finished(session, track)
  local rec = track.rec
  if not rec then return end
  local ok, failure = calls.try(compare, session, track)
  if not ok then depart(session, "%s", reason(failure)) end
  if session.is_dry then do_again(session, track) end
  track.rec, track.is_free = false, false
  track.queue = match.joined({}, track.fsm._intq)
  if track.m ~= nil then return end
  compare_counts(session)
  if session.problem then return end
  session.at = session.at + 1
  session.taken[#session.taken + 1] = rec
  look_ahead(session)
end

-- Returns the recorded result of a guard. With the option `guards`, the guard is also
-- called, and the two results are compared.
function listener.guard(session, track, number, guard, tr, events, event)
  if not track.rec then return guard(tr, events, event) end
  local list, at = track.rec.guards or {}, track.guard_at + 1
  local answer = list[at + 1]
  track.guard_at = at + 1
  if (track.numbers[list[at]] or list[at]) ~= number then
    depart(session, "the guard of %s was not called then", tostring(tr))
    return false
  elseif session.options.guards then
    local ok, now = calls.try(guard, tr, events, event)
    if (ok and now ~= false) ~= (answer == true) then
      depart(session, "the guard of %s behaves otherwise", tostring(tr))
    end
  end
  if type(answer) == "string" then error(answer, 0) end
  return answer
end

-- Returns a doo that ends when the recorded doo ended or failed. The event e_done is
-- one of the recorded events.
local function doo_again(track)
  return function(_, state)
    while true do
      local rec = track.rec
      if rec and rec.done and rec.leaf == state._fqn then return end
      rfsm.yield(not (track.m and track.records[track.at + 1]))
    end
  end
end

-- Returns a table: recorded number of a guard -> its present number. In a chart that
-- has changed, a guard is found by the text of its transition.
local function numbers_of(track, session)
  local now, numbers = {}, {}
  local then_texts = session.guards and session.guards[(track.m or 0) + 1] or {}
  for number, tr in ipairs(rfsm.elements(track.fsm, rfsm.is_trans)) do
    local text = tostring(tr)
    if tr.guard then order.append(now, text, number) end
  end
  for i = 1, #then_texts, 2 do
    local same_texts = now[then_texts[i + 1]]
    numbers[then_texts[i]] = same_texts and remove(same_texts, 1) or nil
  end
  return numbers
end

function listener.attached(session, track)
  track.numbers = numbers_of(track, session)
  track.at, track.guard_at = 0, 0
  track.records = {}
  if not session.is_dry then return end
  for _, state in ipairs(instrument.take_functions(track.changes, track.fsm)) do
    instrument.put(track.changes, state, "doo", doo_again(track))
  end
end

function listener.gettime(session) return session.clock end

local function no_events() return {} end

function listener.getevents() return no_events end

local function itself(snap) return snap end

-- Puts a machine into the snapshot with which a recording, or a part of it, begins.
local function put(session, fsm, from)
  session.readings = match.joined({}, from.clock or {})
  return snapshot.put(fsm, from.snapshot,
    { migrate = session.options.migrate and itself or nil })
end

-- Takes a step. Returns whether it went as recorded.
local function take_step(session, track)
  local before, from = session.at, session.ahead.from
  local ok, failure = true, nil
  if from then ok, failure = put(session, track.fsm, from) end
  track.is_put = ok
  wind(session)
  if from then for _, own in ipairs(session.tracks) do own.queue = {} end end
  if ok then ok, failure = calls.try(rfsm.step, track.fsm) end
  if not ok and not rawequal(failure, STOP) then
    depart(session, "%s", reason(failure))
  elseif session.at == before then
    depart(session, "the machine takes no step")
  end
  return not session.problem
end

-- Advances the machine until the recording ends, or the machine departs from it.
local function run(session, track)
  local each = session.options.each or function() end
  while not is_over(session) and take_step(session, track) do
    each(track.fsm, session.taken)
    session.taken = {}
  end
end

local function new_session(header, next_record_of, options)
  local session = { next_record = next_record_of, taken = {}, at = 0,
    options = options, last = options.to or huge,
    is_dry = options.dry and true or false, guards = header.guards }
  session.clock = clock.new(function() return read_again(session) end)
  return session
end

local function make(model, is_silent)
  if is_silent then return calls.silently(rfsm.init, model) end
  return rfsm.init(model)
end

local function go_through(session, header)
  local ok, problem = put(session, session.fsm, header)
  if not ok then
    session.fsm, session.problem = nil, problem
    return
  end
  session.has_changed = migrate.changes(session.fsm, header.snapshot) == "structure"
  if session.options.watch then session.options.watch(session.fsm) end
  look_ahead(session)
  run(session, session.tracks[1])
  if session.problem then return end
  session.snap, session.unsaved = snapshot.try_take(session.fsm)
end

--- Run a machine through a recording: its header, and a function that returns the next
-- record. The session that is returned has the machine and a snapshot of it at the end,
-- or a problem.
return function(model, header, next_of, options)
  local session = new_session(header, next_of, options)
  local fsm, problem = make(model, session.is_dry)
  session.problem = problem
  if not fsm then return session end
  session.fsm, session.tracks = fsm, tracks.attach(fsm, listener, session)
  calls.finally(function() tracks.detach(session.tracks) end, go_through, session,
    header)
  return session
end
