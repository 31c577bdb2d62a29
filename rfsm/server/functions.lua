--- The functions that run inside a database server (Redis, PostgreSQL). Each restores a
-- machine, runs it and saves it, in one atomic call.
--
-- `rfsm.server.library` bundles this module with the core and the charts. The module
-- does not depend on a server: a host object reads and writes machines. If an error
-- occurs nothing is changed, since everything that may fail comes before the write.
--
-- A machine is saved under its key as a list. The first item is "rfsm"; the section
-- "Load" below describes the others.
--
-- A call first runs the timers and waiting events that are due, in order, each at its
-- own time. Then it sends its own events.
--
-- The sections follow the order of a call: arguments, load, move, save, functions.
--
-- @module rfsm.server.functions
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local charts = require "rfsm.server.charts"
local desk = require "rfsm.server.desk"
local encoding = require "rfsm.snapshot.encoding"
local keys_of = require "rfsm.server.keys"
local migrate = require "rfsm.snapshot.migrate"
local order = require "rfsm.shared.order"
local rfsm = require "rfsm"
local snapshot = require "rfsm.snapshot"
local timeevent = require "rfsm_timeevent"
local times = require "rfsm.server.times"
local why = require "rfsm.observe.why"
require "rfsm.always" -- which the core loads by name, like some below
require "rfsm.await"
require "rfsm.clock.snapshots"
require "rfsm.fates"
require "rfsm.merge"
require "rfsm.prepare"
require "rfsm.tools"
require "rfsmpp"

local ipairs, pairs, pcall, rawget = ipairs, pairs, pcall, rawget
local select, tonumber, tostring, type = select, tonumber, tostring, type
local floor, huge, min = math.floor, math.huge, math.min
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local concat, insert, remove = table.concat, table.insert, table.remove
local fail, now, open, put = encoding.fail, times.now, charts.open, charts.put

local MAX_DATA, MAX_VALUE = 65536, 1048576 -- bytes: data of a new machine, a saved one
local MAX_STEPS = 1000
-- The greatest number of steps for due timers and events in a call. If the machine is
-- not idle after a step, this step counts as RESTLESS steps.
local MAX_DUE, RESTLESS = 200, 20
-- Seconds. If MAX_DUE steps advance the clock less, it jumps to the present.
local LEAST_PASSED = 0.1
local TIME = "(time)" -- in the history: the name of a step without an event
local SAME = 1e-6 -- seconds; closer times are equal, since timers fire 1 ns late
local MAX_ID, MAX_LATER = 64, 100 -- bytes of an id; waiting events of a machine

--- The functions by which this module uses a server.
---@class rfsm.server.Host
---@field time fun(): integer, integer returns the time: seconds and nanoseconds
---@field read fun(key: string): any[]? returns the saved list of a machine
---@field pack fun(list: any[]): any returns the value that the server stores for a list
---@field write fun(machine: rfsm.server.Machine, due: number?, emitted: string[][],
--- errors: string[]) writes all arguments, or raises an error and writes nothing
---@field remove fun(key: string, what: string|false|nil): boolean removes a machine;
--- notes `what` in a history that outlives it; returns whether it existed
---@field FORCE string how a person writes the option 'force' there
---@field decode fun(text: string): any decodes JSON
---@field refuse fun(name: string, reason: string): any returns the reply of an error
---@field history? fun(key: string, count: integer): any[] the latest moves, the newest
--- first, each as five items: time, events, from, to, and the snapshot after it; false
--- if only a later move of the same call has one
---@field count fun(machine: rfsm.server.Machine, errors: integer) counts a call for
--- monitoring, after it was written
---@field add? fun(functions: table, options: rfsm.server.Options) adds functions that
--- only this server has

--- The options with which a library is made.
---@class rfsm.server.Options
---@field index? boolean keep an index by which machines are found by their state
---@field history? integer|boolean keep the moves of each machine, and the events that
--- moved nothing; a number: keep at most so many of them
---@field ids? integer how many ids of events are kept for each machine (16)
---@field ids_for? integer seconds for which ids are kept; then `ids` is 1000 by default

-- `versions` has for each name of a chart the list of its versions, the newest last.
-- These are locals of the module because only one library runs in a server.
-- `step_chart` is `charts.step`, or `charts.step_noting` if there is a history.
local host, versions, options, step_chart

-- Arguments ----------------------------------------------------------------------

local key_of, shown = keys_of.machine, keys_of.shown

local function versions_of(name)
  return versions[name] or fail("no chart is named '%s'%s", shown(name),
    advice.nearest_name(shown(name), rfsm.sorted_keys(versions)))
end

-- Removes `ID id` from the end of the arguments. Returns the id; nil if it is missing.
local function take_id(args)
  if args[#args - 1] ~= "ID" then return nil end
  local id = remove(args)
  remove(args)
  if #id == 0 or #id > MAX_ID then
    fail("ID: 1 to %d bytes expected, got %d", MAX_ID, #id)
  end
  return id
end

-- Removes `BY who` from the end of an operator's arguments. Returns the end of what is
-- noted: " by who", or "" if it is missing.
local function take_by(args)
  if args[#args - 1] ~= "BY" then return "" end
  local who = remove(args)
  remove(args)
  return who ~= "" and " by " .. shown(who) or ""
end

-- Returns the time that a text means: "12.5" is a time of the clock in seconds, "+12.5"
-- is 12.5 seconds from now.
local function time_of(text)
  local offset, number = text:match("^(%+?)(%d+%.?%d*)$")
  if not number then fail("seconds, or +seconds expected, got '%s'", shown(text)) end
  return rfsm.number_of(number) + (offset == "+" and now() or 0)
end

-- Load: the value of a key becomes a machine ----------------------------------------

-- Positions in the list of a machine. NAME: the name of its chart. SNAP, SEC, NSEC: the
-- snapshot, and the time of the snapshot if timers need it. DUE: when the machine is to
-- be woken. IDS: the ids of the latest events, the oldest first; with `ids_for` each is
-- followed by its time. LATER: the waiting events in the order in which they will be
-- sent, each { time, id, event, ... }. HELD: the time at which the machine was held, or
-- at which it last kept an event while it was held. HOLD: { the time at which it was
-- held, the reason }.
local NAME, SNAP, SEC, NSEC, DUE, IDS, LATER, HELD, HOLD = 2, 3, 4, 5, 6, 7, 8, 9, 10

--- A machine that a call works on.
---@class rfsm.server.Machine
---@field key string
---@field chart rfsm.server.Chart
---@field fsm rfsm.Machine|nil nil: it is not loaded
---@field list any[] the list under its key; the call changes it, and then saves it
---@field leaf string|false|nil FQN of the active leaf before the call, in the version
--- of the chart that saved it; nil: it was not entered; false: the machine is new
---@field at string FQN of the active leaf; "": the machine was not entered
---@field mode string mode of the active leaf
---@field was_due number|false|nil the item DUE of `list` before the call
---@field value any `list` after the call, packed by the host
---@field moves { by: string, from: string, to: string }[] the moves of this call
---@field is_idle boolean was the machine idle after its last step, in any call?
---@field outcome string|false what became of the events: "taken", "kept" or "dropped";
--- false: no transition took them, and it is not yet known if they were kept or dropped
---@field has_run boolean did due timers or events run in this call?
---@field is_sent_to boolean is this a call that sends events?
---@field is_moved true? did it come to another version of its chart in this call?
---@field said string|nil what a person has done, for the history or the log

local NONE = {}

local function new_machine(key, chart, list, leaf)
  return { key = key, chart = chart, fsm = chart.fsm, list = list, leaf = leaf,
    at = leaf or "", mode = "inactive", was_due = list[DUE], value = false, moves = {},
    is_idle = true, outcome = false, has_run = false,
    is_sent_to = false }
end

local function read(key)
  local list = host.read(key)
    or fail("no machine is at '%s' (rfsm_create makes one)", shown(key))
  if list[HELD] == true then list[HELD] = now() end -- an older release noted no time
  return list
end

-- Puts a snapshot into the newest version of its chart. If it does not fit there, it is
-- put into the version from which it was taken. Returns the version that was used, the
-- results of `put`, and whether this version is not the one of the snapshot. A snapshot
-- that `is_foreign` is checked.
local function place(list, snap, is_foreign)
  local newest, own = open(list[#list]), nil
  local is_other = not charts.is_of(newest, snap)
  if is_other then
    for _, chart in ipairs(list) do
      if charts.is_of(open(chart), snap) then own = chart end
    end
    newest.options.old = own and own.fsm
  end
  local ok, problem = put(newest, snap, is_foreign)
  if ok or not own then return newest, ok, problem, is_other end
  return own, put(own, snap, is_foreign)
end

-- A machine that has moved to another version may have other timers, which may be due
-- before the time for which it was saved.
local function note_new_timers(machine)
  machine.is_moved = true
  local left = timeevent.next_deadline(machine.fsm)
  if not left then return end
  machine.list[DUE] = min(machine.list[DUE] or huge, times.seen() + left)
end

-- Was a machine saved before it was idle? Its clock must show the time of the snapshot.
local function was_restless(list)
  return list[DUE] and list[DUE] <= times.seen()
end

-- Loads a machine. Its clock shows the time at which it was saved.
local function load_machine(key, list)
  times.set(list[SEC], list[NSEC])
  local chart, ok, problem, has_moved = place(versions_of(list[NAME]), list[SNAP])
  if not ok then fail("the machine at '%s': %s", shown(key), problem) end
  local machine = new_machine(key, chart, list, list[SNAP].leaf)
  machine.is_idle = not was_restless(list)
  if has_moved then note_new_timers(machine) end
  return machine
end

-- Puts a snapshot that a person has changed into the machine at a key.
local function place_at(key, list, snap)
  local chart, ok, problem = place(versions_of(list[NAME]), snap, true)
  if not ok then fail("file: %s", problem) end
  return new_machine(key, chart, list, list[SNAP].leaf)
end

-- Move: first run what is due, then send new events ---------------------------------

-- Returns the position of an id in the list of waiting events; nil if it is missing.
local function find_later(list, id)
  for i, entry in ipairs(list[LATER] or NONE) do
    if entry[2] == id then return i end
  end
end

-- Was an event with this id sent before, or does such an event wait?
local function has_id(list, id)
  for _, known in ipairs(list[IDS] or NONE) do
    if known == id then return true end
  end
  return find_later(list, id) ~= nil
end

-- Removes the oldest id and its time from a list of `count` ids; returns the new count.
local function drop_id(ids, count)
  remove(ids, 1)
  if type(ids[1]) == "number" then remove(ids, 1) end
  return count - 1
end

local function add_id(machine, id)
  local ids, count = machine.list[IDS] or {}, 0
  machine.list[IDS], ids[#ids + 1] = ids, id
  if options.ids_for then ids[#ids + 1] = floor(now()) end
  for _, known in ipairs(ids) do
    if type(known) == "string" then count = count + 1 end
  end
  while count > options.ids do count = drop_id(ids, count) end
  while options.ids_for and (tonumber(ids[2]) or 0) < now() - options.ids_for do
    count = drop_id(ids, count)
  end
end

-- Notes that a machine has come to a leaf. If it was there, this is only for a history,
-- which has no timers that moved nothing, neither the machine nor a region.
local function add_move(machine, by, at, has_region_moved)
  local from, moves = machine.at, machine.moves
  local is_move = at ~= from or has_region_moved or by ~= TIME and options.history
  if not is_move then return end
  moves[#moves + 1] = { by = by, from = from, to = at }
  machine.at = at
end

-- Returns the FQN of the active leaf; "" if the machine was not entered.
local function leaf_of(fsm)
  local leaf = fsm._act_leaf
  return leaf and leaf._fqn or ""
end

-- Steps a machine, and notes its move. `by` is the name of the events in the history,
-- which also has those that were deferred before and have run now. Returns whether a
-- path was taken.
local function step(machine, by)
  local is_idle, is_taken, has_region_moved, recalled =
    step_chart(machine.chart, MAX_STEPS)
  if recalled then by = by .. recalled end
  machine.is_idle = is_idle
  add_move(machine, by, leaf_of(machine.fsm), has_region_moved)
  return is_taken
end

-- Notes what a person has done with a machine: in its history, or, if there is none, in
-- its log. It is the end of the reply, too.
local function note(machine, what)
  add_move(machine, what, machine.fsm and leaf_of(machine.fsm) or machine.at)
  machine.said = what
end

local function send(machine, events)
  for _, event in ipairs(events) do rfsm.send_events(machine.fsm, event) end
end

-- Inserts events into the list of waiting events, behind others of the same time.
local function add_later(machine, time, id, texts)
  local later = machine.list[LATER] or {}
  local at = #later + 1
  if at > MAX_LATER then fail("at most %d events may wait", MAX_LATER) end
  while at > 1 and later[at - 1][1] > time do at = at - 1 end
  insert(later, at, { time, id or "", unpack(texts) })
  machine.list[LATER] = later
end

-- If the clock has gone back, lowers the times of the due events of a held machine to
-- the present. So these events stay due, and later events come behind them.
local function keep_due(list)
  for _, entry in ipairs(list[LATER] or NONE) do
    if entry[1] <= list[HELD] then entry[1] = min(entry[1], now()) end
  end
  list[HELD] = now()
end

-- Sends waiting events whose time has come, and returns their texts. Events that the
-- chart no longer knows are reported as an error.
local function send_entry(machine, entry)
  local texts = { select(3, unpack(entry)) }
  local ok, events = pcall(charts.events, machine.chart, texts)
  if entry[2] ~= "" then add_id(machine, entry[2]) end
  if ok then
    send(machine, events)
  else
    charts.note("rfsm_send_at: " .. encoding.reason(events))
  end
  return concat(texts, " ")
end

-- Advances the clock of a machine to its next timer or waiting events, if they are due
-- now, and sends these events. Returns the name in the history for the step that has to
-- follow, or nil if nothing is due.
local function advance_to_due(machine)
  local later, seen = machine.list[LATER] or NONE, times.seen()
  local left, entry = timeevent.next_deadline(machine.fsm) or huge, later[1]
  if entry and entry[1] + SAME < seen + left then
    if entry[1] > now() then return nil end
    times.advance_to(entry[1])
    return send_entry(machine, remove(later, 1))
  end
  if seen + left > now() + SAME then return nil end
  times.advance(left)
  return TIME
end

-- Returns `time` (nil or false: never), or the time of the first waiting events if that
-- is earlier.
local function earliest(time, list)
  local first = (list[LATER] or NONE)[1]
  return first and min(time or huge, first[1]) or time
end

-- Runs the due timers and events, each at its own time, until the machine is idle. Then
-- the clock of the machine shows the present. Returns false if this takes too many
-- steps: the clock shows the time that was reached, and the machine is due at once. If
-- the clock has advanced less than LEAST_PASSED, it jumps to the present.
local function run_due(machine)
  local budget, begun = MAX_DUE, times.seen()
  local by = was_restless(machine.list) and TIME or advance_to_due(machine)
  while by and budget > 0 do
    if step(machine, by) then machine.outcome = "taken" end
    budget = budget - (machine.is_idle and 1 or RESTLESS)
    by = budget > 0 and advance_to_due(machine)
  end
  machine.has_run = true
  if budget > 0 or times.seen() - begun < LEAST_PASSED then times.set(false) end
  return budget > 0
end

local function is_due(list)
  local due = earliest(list[DUE], list)
  return due and due <= now() + SAME
end

-- Runs the due timers and events until the clock of the machine shows the present.
-- Returns false if the machine is held, or if too much was due for one call.
local function catch_up(machine)
  local list = machine.list
  if list[HELD] then return false end
  if is_due(list) then return run_due(machine) end
  times.set(false)
  return true
end

-- Runs the due timers and events, then sends the events in `texts`, all in one step. If
-- the machine is held, or too much was due, the events in `texts` wait. `by` is who has
-- sent them, for the history.
local function move(machine, texts, id, by)
  local events, list = charts.events(machine.chart, texts), machine.list
  if not catch_up(machine) then
    if list[HELD] then keep_due(list) end
    add_later(machine, now(), id, texts)
    add_move(machine, concat(texts, " ") .. " (waits)" .. by, machine.at)
    machine.outcome = "kept"
    return
  end
  if machine.has_run then
    list[SNAP], list[SEC], list[NSEC] = snapshot.take(machine.fsm), times.get()
  end
  send(machine, events)
  machine.outcome = step(machine, concat(texts, " ") .. by) and "taken" or false
end

-- Runs the due timers and events. If none were due, or if the machine is not idle after
-- them, steps it once more.
local function run(machine)
  local is_present = catch_up(machine)
  machine.outcome = machine.outcome or "kept"
  if not is_present or machine.has_run and machine.is_idle then return end
  if step(machine, TIME) then machine.outcome = "taken" end
end

-- Returns the outcome of events that no transition took: have they changed the snapshot
-- of the machine? Timers have run on since it was saved. So the saved snapshot is
-- loaded at its time, taken again at the present, and compared with `snap`.
local function outcome_of(machine, snap)
  local list, sec, nsec = machine.list, times.get()
  charts.forget_effects() -- effects of a function `load` are not reported
  times.set(list[SEC], list[NSEC])
  local ok = put(machine.chart, list[SNAP])
  times.set(sec, nsec)
  return ok and snapshot.encode(snapshot.take(machine.fsm)) == snapshot.encode(snap)
    and "dropped" or "kept"
end

-- Save: first all that may fail, then the writes -----------------------------------

-- Returns the time at which to wake a machine; nil if only an event can move it.
local function due_of(machine, snap)
  if not machine.is_idle and machine.fsm._act_leaf then return times.seen() end
  local left = (snap.ext or snap.regions) and timeevent.next_deadline(machine.fsm)
  return earliest(left and times.seen() + left or nil, machine.list)
end

-- Packs the list of a machine. Empty positions are false; those behind the last value
-- are nil.
local function pack_machine(machine, due)
  local list, empty = machine.list, nil
  list[SEC], list[NSEC], list[DUE] = false, false, due
  if due then list[SEC], list[NSEC] = times.get() end
  if list[LATER] and not list[LATER][1] then list[LATER] = false end
  for i = HOLD, SEC, -1 do
    if list[i] then empty = false else list[i] = empty end
  end
  machine.value = host.pack(list)
  local size = #machine.value
  if size > MAX_VALUE then
    fail("a machine takes at most %d bytes, this one %d", MAX_VALUE, size)
  end
end

-- Returns what goes to the log: errors, and what a person has done, unless a history
-- has that.
local function log_of(machine, errors)
  if options.history or not machine.said then return errors end
  return { machine.said, unpack(errors) }
end

-- Marks the events of a call in the history if callbacks have failed, such as a guard
-- or an entry. If something due ran before, that may have failed.
local function mark_error(machine)
  local last = machine.moves[#machine.moves]
  if machine.has_run or not machine.is_sent_to or not last then return end
  last.by = last.by .. " (error)"
end

-- Calls the host to write all changes, and returns the reply: leaf, mode, errors,
-- outcome. The id of dropped events is not kept, so that they may be sent again.
local function save(machine, id)
  local list, leaf = machine.list, machine.fsm._act_leaf
  local snap = snapshot.take(machine.fsm)
  local due, emitted, errors = due_of(machine, snap), charts.effects()
  if errors[1] then mark_error(machine) end
  local at = leaf_of(machine.fsm)
  if at ~= machine.at then add_move(machine, "(move)", at) end -- it has a new name only
  machine.mode = leaf and leaf._mode or "inactive"
  machine.outcome = machine.outcome or outcome_of(machine, snap)
  list[SNAP] = snap
  if id and machine.outcome ~= "dropped" then add_id(machine, id) end
  pack_machine(machine, due)
  host.write(machine, not list[HELD] and due or nil, emitted, log_of(machine, errors))
  host.count(machine, #errors)
  local reply = { machine.at, machine.mode, unpack(errors) }
  reply[#reply + 1] = machine.said or machine.outcome
  return reply
end

-- Functions ----------------------------------------------------------------------

local functions = {}

local function set_data(fsm, text)
  if not text then return end
  local data, is_kept = charts.read_json("data", text, MAX_DATA), {}
  for _, name in ipairs(fsm.keep or {}) do is_kept[name] = true end
  for _, name in ipairs(rfsm.sorted_keys(data)) do
    if not is_kept[name] then
      fail("data: the root of the chart does not keep '%s'%s", tostring(name),
        advice.nearest_name(tostring(name), rfsm.sorted_keys(is_kept)))
    end
    desk.check_kind(name, data[name], fsm[name], nil, "")
    fsm[name] = data[name]
  end
end

-- Returns a reply: leaf and mode of a saved machine, and the further arguments.
local function reply_of(list, ...)
  local snap = list[SNAP]
  return { snap.leaf or "", snap.leaf and (snap.done and "done" or "active")
    or "inactive", ... }
end

local function time_text(time) return time and rfsm.number_text(time, "%.6f") or "" end

local function list_json(list)
  return list[1] ~= nil and charts.json_of(list) or "[]"
end

-- A machine that an older release has held does not know since when.
local function held_since(list) return (list[HOLD] or NONE)[1] or list[HELD] end

-- rfsm_create KEY chart [data] [ID id]: makes a machine and runs it.
function functions.rfsm_create(keys, args)
  local key, id = key_of(keys), take_id(args)
  local found = versions_of(args[1] or "")
  local chart = open(found[#found])
  local list = host.read(key)
  if list and id and has_id(list, id) then return reply_of(list, "known") end
  if list then fail("something is at '%s'", shown(key)) end
  times.set(false)
  local ok, problem = put(chart, chart.blank)
  if not ok then fail("%s", problem) end
  set_data(chart.fsm, args[2])
  local machine = new_machine(key, chart, { "rfsm", args[1] }, false)
  machine.outcome = step(machine, "") and "taken" or "kept"
  return save(machine, id)
end

-- rfsm_send KEY event... [[BY who] ID id]: sends events to a machine and runs it. A
-- history has who has sent them.
function functions.rfsm_send(keys, args)
  local key, id = key_of(keys), take_id(args)
  local by = id and take_by(args) or ""
  if not args[1] then fail("an event expected, got none") end
  local list = read(key)
  if id and has_id(list, id) then return reply_of(list, "known") end
  local machine = load_machine(key, list)
  machine.is_sent_to = true
  move(machine, args, id, by)
  return save(machine, machine.outcome ~= "kept" and id)
end

-- rfsm_send_at KEY time event... ID id: keeps events, and sends them at a time.
function functions.rfsm_send_at(keys, args)
  local key, id = key_of(keys), take_id(args)
  local text = remove(args, 1)
  if not (id and args[1]) then fail("a time, events and ID id expected") end
  local list = read(key)
  if has_id(list, id) then return reply_of(list, "known") end
  local machine = load_machine(key, list)
  charts.events(machine.chart, args)
  add_later(machine, time_of(text), id, args)
  catch_up(machine)
  machine.outcome = machine.outcome or "kept"
  return save(machine)
end

-- rfsm_cancel KEY id: removes waiting events of rfsm_send_at. Returns 1, or 0 if no
-- events with this id wait.
function functions.rfsm_cancel(keys, args)
  local key = key_of(keys)
  local list = read(key)
  if not find_later(list, args[1]) then return 0 end
  local machine = load_machine(key, list)
  run(machine)
  local at = find_later(list, args[1])
  if at then remove(list[LATER], at) end
  save(machine)
  return at and 1 or 0
end

-- rfsm_tick KEY ["due"]: runs a machine, with "due" only if something is due, since
-- another call may have run that meanwhile. Returns false if there is no machine.
function functions.rfsm_tick(keys, args)
  local key = key_of(keys)
  local list = host.read(key)
  if not list then return false end
  local machine = load_machine(key, list)
  if args[1] == "due" and not is_due(list) then
    machine.outcome = "kept"
  else
    run(machine)
  end
  return save(machine)
end

-- Returns the events of `later` that came before a time, or after it, as JSON.
local function later_json(list, is_past)
  local entries = {}
  for _, entry in ipairs(list[LATER] or NONE) do
    if (entry[1] <= now()) == is_past then
      entries[#entries + 1] = { time = entry[1], id = entry[2],
        events = { select(3, unpack(entry)) } }
    end
  end
  return list_json(entries)
end

-- Returns the ids that a machine knows, the oldest first.
local function ids_of(list)
  local ids = {}
  for _, id in ipairs(list[IDS] or NONE) do
    if type(id) == "string" then ids[#ids + 1] = id end
  end
  return ids
end

-- Returns the events that a machine and its regions have deferred.
local function kept_of(snap)
  local events = {}
  migrate.each_part(snap, function(part)
    local kept = part.ext and part.ext.defer and encoding.unpack(part.ext.defer, 0)
    for _, event in ipairs(kept or NONE) do events[#events + 1] = event end
  end)
  return events
end

-- Returns the FQNs of the active leaves of regions.
local function region_leaves(snap)
  local leaves = {}
  migrate.each_part(snap, function(part, prefix)
    local is_one = part.leaf and prefix ~= "root"
    leaves[#leaves + 1] = is_one and prefix .. part.leaf:sub(5) or nil
  end)
  return leaves
end

-- rfsm_move KEY [BY who]: moves a machine to the newest version of its chart without
-- running it, so that it is woken in time for the timers of this version.
function functions.rfsm_move(keys, args)
  local key, by = key_of(keys), take_by(args)
  local list = read(key)
  local machine, known = load_machine(key, list), versions_of(list[NAME])
  if machine.chart ~= known[#known] then
    local _, problem = put(known[#known], list[SNAP])
    fail("the machine at '%s' keeps its version: %s", shown(key), problem)
  end
  note(machine, (machine.is_moved and "(move)" or "(move: it was the newest)") .. by)
  machine.outcome = "kept"
  return save(machine)
end

-- rfsm_get KEY: returns a list in which each name is followed by its value.
function functions.rfsm_get(keys)
  local list = read(key_of(keys))
  local snap, names, queue = list[SNAP], {}, {}
  local leaf = snap.leaf or ""
  for i, event in ipairs(snap.queue or {}) do queue[i] = encoding.unpack(event, 0) end
  for i in leaf:gmatch("()%.") do names[#names + 1] = leaf:sub(1, i - 1) end
  names[#names + 1] = snap.leaf
  return { "chart", list[NAME], "version", snap.chart, "leaf", leaf,
    "mode", reply_of(list)[2],
    "configuration", concat(names, " "), "data", charts.data_of(snap),
    "queue", list_json(queue), "due", time_text(list[DUE]),
    "held", list[HELD] and "yes" or "", "held_since", time_text(held_since(list)),
    "held_because", (list[HOLD] or NONE)[2] or "",
    "revision", ("%d"):format(desk.revision_of(list)),
    "kept", list_json(kept_of(snap)), "later", later_json(list, false),
    "waiting", later_json(list, true), "ids", list_json(ids_of(list)),
    "regions", concat(region_leaves(snap), " ") }
end

-- Functions for an operator: hold, release, force, remove, why.

-- rfsm_hold KEY [reason] [BY who]: holds a machine: from now on its events and timers
-- wait, also those that are due. No machine is loaded, since one of its callbacks may
-- never end. The reason of a worker goes to the log.
function functions.rfsm_hold(keys, args)
  local key, by = key_of(keys), take_by(args)
  local list, reason = read(key), keys_of.line(args[1] or "")
  if reason == "" then reason = nil end
  if list[HELD] then fail("the machine at '%s' is held already", shown(key)) end
  local machine = new_machine(key, { name = list[NAME] }, list, list[SNAP].leaf)
  note(machine, (reason and "(hold: " .. reason .. ")" or "(hold)") .. by)
  local reply = reply_of(list, machine.said)
  machine.mode, list[HELD], list[HOLD] = reply[2], now(), { now(), reason }
  times.set(list[SEC], list[NSEC])
  pack_machine(machine, list[DUE])
  host.write(machine, nil, NONE, by == "" and { reason } or log_of(machine, NONE))
  return reply
end

-- rfsm_release KEY [BY who]: ends the hold. Events and timers that are due now run, in
-- order.
function functions.rfsm_release(keys, args)
  local key, by = key_of(keys), take_by(args)
  local list = read(key)
  if not list[HELD] then fail("the machine at '%s' is not held", shown(key)) end
  keep_due(list)
  list[HELD], list[HOLD] = nil, nil
  local machine = load_machine(key, list)
  note(machine, "(release)" .. by)
  run(machine)
  return save(machine)
end

-- rfsm_force KEY state [BY who]: puts a machine into a leaf without calling entries and
-- exits. The leaf may be in a region.
function functions.rfsm_force(keys, args)
  local key, by = key_of(keys), take_by(args)
  local machine = load_machine(key, read(key))
  times.set(false)
  note(machine, charts.force(machine.chart, args[1] or "") .. by)
  local moves = machine.moves
  local count = #moves
  machine.outcome = step(machine, TIME) and "taken" or "kept"
  if moves[count + 1] then moves[count + 1].by = machine.said end
  return save(machine)
end

-- rfsm_remove KEY [BY who]: ends a machine, and removes its timers and streams. Returns
-- 1 if the machine was there.
function functions.rfsm_remove(keys, args)
  local what = "(remove)" .. take_by(args)
  return host.remove(key_of(keys), options.history and what) and 1 or 0
end

-- rfsm_why KEY event: returns lines that report for each transition, from the outermost
-- state inwards, whether it would be taken on the event, and if not, why.
function functions.rfsm_why(keys, args)
  if #args ~= 1 then fail("one event expected, got %d", #args) end
  local key, lines = key_of(keys), {}
  local list = read(key)
  local machine = load_machine(key, list)
  times.set(false)
  if list[HELD] then
    lines[1] = ("held for %.0f s: events wait until it is released; then:"):format(
      now() - held_since(list))
  end
  local _, text = why.why(machine.fsm, charts.events(machine.chart, args)[1])
  for line in text:gmatch("[^\n]+") do lines[#lines + 1] = line end
  return lines
end

-- rfsm_charts: returns two items for each state that a chart of the library has in any
-- of its versions: the name of the chart, and the FQN of the state.
function functions.rfsm_charts()
  local reply = {}
  for _, name in ipairs(rfsm.sorted_keys(versions)) do
    local paths = {}
    for _, chart in ipairs(versions[name]) do
      for _, state in ipairs(rfsm.elements(open(chart).fsm, rfsm.is_state)) do
        paths[state._fqn] = true
      end
    end
    for _, path in ipairs(rfsm.sorted_keys(paths)) do
      reply[#reply + 1], reply[#reply + 2] = name, path
    end
  end
  return reply
end

-- rfsm_hint chart state: returns a text about a chart, or a state, that the library
-- does not have; "" if it has both.
function functions.rfsm_hint(_, args)
  local library, list = {}, functions.rfsm_charts()
  for i = 1, #list, 2 do
    order.append(library, list[i], list[i + 1])
  end
  return { advice.in_library(library, args[1], args[2]) }
end

-- Returns of which version of a chart a snapshot is: "newest", "bundled" or "gone".
local function version_of(name, snap)
  local list = versions[name] or NONE
  for i = #list, 1, -1 do
    if charts.is_of(open(list[i]), snap) then
      return i == #list and "newest" or "bundled"
    end
  end
  return "gone"
end

--- Return the functions by name. Each takes a list of keys and a list of arguments.
-- Charts in `list` ({ name =, make = }) that have the same name are versions of one
-- chart, the newest last.
---@param server rfsm.server.Host
---@param list table
---@param settings? rfsm.server.Options
return function(server, list, settings)
  local made = {}
  host, versions, options = server, {}, settings or {}
  options.ids = options.ids or options.ids_for and 1000 or 16
  step_chart = options.history and charts.step_noting or charts.step
  times.open(host)
  charts.use(host.decode)
  for _, chart in ipairs(list) do
    order.append(versions, chart.name, chart)
  end
  desk.add(functions, { key_of = key_of, read = read, load_machine = load_machine,
    place_at = place_at, note = note, save = save, take_by = take_by,
    FORCE = host.FORCE, NAME = NAME, SNAP = SNAP, SEC = SEC, NSEC = NSEC,
    history = options.history and host.history })
  if host.add then host.add(functions, options, version_of) end
  for name, f in pairs(functions) do -- any order: each stands alone
    made[name] = function(keys, args)
      times.begin()
      charts.forget_effects()
      local ok, reply = pcall(f, keys, args or NONE)
      if ok then return reply end
      return host.refuse(name, charts.reason_of(reply))
    end
  end
  return made
end
