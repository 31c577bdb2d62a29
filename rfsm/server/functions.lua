--- The functions that run inside Redis: each restores a machine, advances it and saves
-- it, in one piece.
--
-- `rfsm.redis` bundles this module with the core and the charts. An error changes
-- nothing: all that can fail comes before the first write, also the types of the keys
-- that will be written, and the rights to do so.
--
-- The value of a machine's key is a list in MessagePack. Its first item is "rfsm", for
-- the others see "Load".
--
-- A call moves its machine: first what was due runs, in the order of its times and at
-- these, then what was sent.
--
-- The file reads in the order of a call: arguments, load, move, save, functions.
--
-- @module rfsm.server.functions
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local calls = require "rfsm.shared.calls"
local charts = require "rfsm.server.charts"
local encoding = require "rfsm.snapshot.encoding"
local keys_of = require "rfsm.server.keys"
local rfsm = require "rfsm"
local snapshot = require "rfsm.snapshot"
local timeevent = require "rfsm_timeevent"
local times = require "rfsm.server.times"
local why = require "rfsm.observe.why"
require "rfsm.await"

local ipairs, pairs, pcall, rawget = ipairs, pairs, pcall, rawget
local select, tonumber, tostring, type = select, tonumber, tostring, type
local char = string.char
local floor, huge, min = math.floor, math.huge, math.min
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local concat, insert, remove = table.concat, table.insert, table.remove
local fail, now, open, put = encoding.fail, times.now, charts.open, charts.put

local MAX_DATA, MAX_VALUE = 65536, 1048576 -- bytes
local MAX_STEPS, MAX_LOG = 1000, 1000
local MAX_DUE, RESTLESS = 200, 20 -- steps of a move; so many is one that does not rest
local LEAST_PASSED = 0.1 -- seconds that such a move gets on, unless it skips some
local TIME = "(time)" -- by what a machine moves if there is no event
local SAME = 1e-6 -- seconds: a timer fires a nanosecond after its time
local MAX_ID, MAX_LATER = 64, 100 -- bytes, events of a machine
local OVERDUE = 60 -- seconds after which nobody seems to wake machines
local ASIDE = 60 -- seconds until a machine that cannot be run is tried again

--- What the functions use of Redis.
---@class rfsm.server.Host
---@field call function redis.call
---@field may function redis.acl_check_cmd
---@field error_reply function redis.error_reply
---@field json table cjson
---@field pack table cmsgpack

--- What a library is made with.
---@class rfsm.server.Options
---@field index? boolean machines are found by their state
---@field history? integer so many moves of each machine are kept
---@field notes? boolean also the events that moved nothing
---@field ids? integer so many ids of events each machine keeps (16)
---@field ids_for? integer ids are kept for so many seconds, at most `ids` (1000)

-- What the library was made with: versions of charts by name, the newest last. One
-- library runs in a server, so it is kept here.
local host, versions, options

-- Arguments ----------------------------------------------------------------------

local key_of, shown = keys_of.machine, keys_of.shown

local function reason_of(failure)
  return calls.line(type(failure) == "table" and failure.err
    or encoding.reason(failure))
end

local function versions_of(name)
  return versions[name] or fail("no chart is named '%s'%s", shown(name),
    advice.nearest_name(shown(name), rfsm.sorted_keys(versions)))
end

-- Takes `ID id` away from the end of arguments; returns the id, nil if there is none.
local function take_id(args)
  if args[#args - 1] ~= "ID" then return nil end
  local id = remove(args)
  remove(args)
  if #id == 0 or #id > MAX_ID then
    fail("ID: 1 to %d bytes expected, got %d", MAX_ID, #id)
  end
  return id
end

-- Returns a time in seconds: of the clock, or from now on with a + in front.
local function time_of(text)
  local offset, number = text:match("^(%+?)(%d+%.?%d*)$")
  if not number then fail("seconds, or +seconds expected, got '%s'", shown(text)) end
  return tonumber(number) + (offset == "+" and now() or 0)
end

local function whole_of(text, default, most)
  local number = tonumber(text or default)
  if not number or number < 1 or number > most or number % 1 ~= 0 then
    fail("a whole number from 1 to %d expected, got '%s'", most, shown(text))
  end
  return number
end

-- Load: the value of a key becomes a machine ----------------------------------------

-- Positions in the value of a machine: the name of its chart, the snapshot, when that
-- was taken and when the machine is due, if it is; the ids of the latest events, the
-- oldest first, each before its time if it is kept for a time; the events that come
-- later, in their order: { time, id, event, ... }; true if the machine is held.
local NAME, SNAP, SEC, NSEC, DUE, IDS, LATER, HELD = 2, 3, 4, 5, 6, 7, 8, 9

--- A machine that a call works on.
---@class rfsm.server.Machine
---@field key string
---@field chart rfsm.server.Chart
---@field fsm rfsm.Machine
---@field list any[] in the value of the key; the new one is made of it
---@field leaf string|false|nil where it was, as the index knows it: before a rename
---@field at string where it is; "": it was not entered
---@field moves { by: string, from: string, to: string }[] of this call
---@field is_idle boolean after the last step
---@field outcome string|false what became of the events: "taken", "kept" or "dropped";
--- false: not taken
---@field base rfsm.snapshot.Snapshot|false before the events were sent; false: what was
--- due has run since then
---@field base_sec integer|false the time of that snapshot
---@field base_nsec integer

local NONE = {}

local function new_machine(key, chart, list, leaf)
  charts.set_effects()
  return { key = key, chart = chart, fsm = chart.fsm, list = list, leaf = leaf,
    at = leaf or "", moves = {}, is_idle = true, outcome = false, base = list[SNAP],
    base_sec = list[SEC], base_nsec = list[NSEC] }
end

local function list_of(key, value)
  local ok, list = pcall(host.pack.unpack, value)
  if not ok or type(list) ~= "table" or list[1] ~= "rfsm" then
    fail("what is at '%s' is no machine", shown(key))
  end
  return list
end

local function read_value(key)
  local value = host.call("GET", key)
  if not value then
    fail("no machine is at '%s' (rfsm_create makes one)", shown(key))
  end
  return list_of(key, value)
end

-- Has the newest version of a chart take a snapshot, if it is of that version or moves
-- to it; else the version that it is of.
local function place(list, snap)
  local newest, own = open(list[#list]), nil
  if snap.chart ~= newest.blank.chart then
    for _, chart in ipairs(list) do
      if open(chart).blank.chart == snap.chart then own = chart end
    end
    newest.options.old = own and own.fsm
  end
  local ok, problem = put(newest, snap)
  if ok or not own then return newest, ok, problem end
  return own, put(own, snap)
end

-- Loads a machine; it sees the time at which it was saved.
local function load_machine(key, list)
  times.set(list[SEC], list[NSEC])
  local chart, ok, problem = place(versions_of(list[NAME]), list[SNAP])
  if not ok then fail("the machine at '%s': %s", shown(key), problem) end
  return new_machine(key, chart, list, list[SNAP].leaf)
end

-- Move: what is due, then what was sent -----------------------------------------------

-- Was an event with this id applied, or is it to come?
local function has_id(list, id)
  for _, known in ipairs(list[IDS] or {}) do
    if known == id then return true end
  end
  for _, entry in ipairs(list[LATER] or {}) do
    if entry[2] == id then return true end
  end
  return false
end

-- Forgets the oldest id of a list, and its time; returns how many are left.
local function drop_id(ids, count)
  remove(ids, 1)
  if type(ids[1]) == "number" then remove(ids, 1) end
  return count - 1
end

local function add_id(machine, id)
  if not id then return end
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

-- Steps a machine at the time that it sees, and notes where it moves; returns whether
-- it has taken a path.
local function step(machine, by)
  local is_idle, is_taken = charts.step(machine.chart, MAX_STEPS)
  local leaf = machine.fsm._act_leaf
  local at = leaf and leaf._fqn or ""
  machine.is_idle = is_idle
  if at ~= machine.at or options.notes and by ~= TIME then
    machine.moves[#machine.moves + 1] = { by = by, from = machine.at, to = at }
    machine.at = at
  end
  return is_taken
end

local function send(machine, events)
  for _, event in ipairs(events) do rfsm.send_events(machine.fsm, event) end
end

-- Has events wait, behind those that wait for the same time.
local function add_later(machine, time, id, texts)
  local later = machine.list[LATER] or {}
  local at = #later + 1
  if at > MAX_LATER then fail("at most %d events may wait", MAX_LATER) end
  while at > 1 and later[at - 1][1] > time do at = at - 1 end
  insert(later, at, { time, id or "", unpack(texts) })
  machine.list[LATER] = later
end

-- Sends events whose time has come. One that is not known any more goes to the log.
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

-- Lets time pass until the next thing is due, a timer or events that wait, unless that
-- is later than now. Returns by what the machine is to be stepped, else nil.
local function advance_to_due(machine)
  local later, seen = machine.list[LATER] or NONE, times.seen()
  local left, entry = timeevent.next_deadline(machine.fsm) or huge, later[1]
  if entry and (entry[1] <= seen or entry[1] + SAME < seen + left) then
    if entry[1] > now() then return nil end
    times.advance_to(entry[1])
    return send_entry(machine, remove(later, 1))
  end
  if seen + left > now() + SAME then return nil end
  times.advance(left)
  return TIME
end

-- Returns when the first thing is due: as it was saved, or has been sent since.
local function first_due(list)
  local due, later = list[DUE] or huge, list[LATER]
  return later and later[1] and min(due, later[1][1]) or due
end

-- Was a machine saved before it had come to rest?
local function was_restless(list)
  return list[DUE] and list[DUE] <= times.seen()
end

-- Runs what is due as if the host had been punctual: each at its time, until the
-- machine rests. Then it sees the present. Returns false if that is too much: it sees
-- the time that it has reached, and is due. If its timers are too fast it skips some.
local function run_due(machine)
  local budget, begun = MAX_DUE, times.seen()
  local by = was_restless(machine.list) and TIME or advance_to_due(machine)
  while by and budget > 0 do
    if step(machine, by) then machine.outcome = "taken" end
    budget = budget - (machine.is_idle and 1 or RESTLESS)
    by = budget > 0 and advance_to_due(machine)
  end
  machine.base = false
  if budget > 0 or times.seen() - begun < LEAST_PASSED then times.set(false) end
  return budget > 0
end

-- Brings a machine to the present; returns false if it has not got there.
local function catch_up(machine)
  if machine.list[HELD] then return false end
  local due = first_due(machine.list)
  if due < huge and due <= now() + SAME then return run_due(machine) end
  times.set(false)
  return true
end

-- Runs what is due, then sends events, all at once; if there is too much due they wait.
local function move(machine, texts, id)
  local events = charts.events(machine.chart, texts)
  if not catch_up(machine) then
    add_later(machine, now(), id, texts)
    machine.outcome = "kept"
    return
  end
  if not machine.base then
    machine.base = snapshot.take(machine.fsm)
    machine.base_sec, machine.base_nsec = times.get()
  end
  send(machine, events)
  machine.outcome = step(machine, concat(texts, " ")) and "taken" or false
end

-- Runs what is due. Else, or if it does not rest, the machine runs now.
local function run(machine)
  local is_present = catch_up(machine)
  machine.outcome = machine.outcome or "kept"
  if not is_present or not machine.base and machine.is_idle then return end
  if step(machine, TIME) then machine.outcome = "taken" end
end

-- Has an event that no transition took changed what the machine keeps? As timers run
-- on, the machine goes back to where it was, until now.
local function has_changed(machine, snap)
  local sec, nsec = times.get()
  local emitted, printed = charts.effects()
  charts.set_effects({}, {}) -- those of a function `load` do not count
  times.set(machine.base_sec, machine.base_nsec)
  local ok = put(machine.chart, machine.base)
  times.set(sec, nsec)
  local before = ok and snapshot.take(machine.fsm)
  charts.set_effects(emitted, printed)
  return not ok or snapshot.encode(before) ~= snapshot.encode(snap)
end

-- Save: first all that may fail, then the writes -----------------------------------

-- Returns when a machine is to be woken; nil: not before an event comes.
local function due_of(machine)
  if not machine.is_idle and machine.fsm._act_leaf then return times.seen() end
  local snap, later = machine.list[SNAP], machine.list[LATER]
  local left = (snap.ext or snap.regions) and timeevent.next_deadline(machine.fsm)
  local due = left and times.seen() + left or nil
  later = later and later[1]
  if later then due = min(due or later[1], later[1]) end
  return due
end

-- Returns the value of a machine; its list ends with what is there.
local function pack_machine(list, due)
  if list[LATER] and not list[LATER][1] then list[LATER] = nil end
  if list[HELD] then list[LATER] = list[LATER] or {} end
  if list[LATER] then list[IDS] = list[IDS] or false end
  if due then
    list[SEC], list[NSEC] = times.get()
    list[DUE] = due
  elseif list[IDS] ~= nil then
    list[SEC], list[NSEC], list[DUE] = false, false, false
  elseif list[DUE] ~= nil then
    list[SEC], list[NSEC], list[DUE] = nil, nil, nil
  end
  local value = host.pack.pack(list)
  if #value > MAX_VALUE then
    fail("a machine takes at most %d bytes, this one %d", MAX_VALUE, #value)
  end
  return value
end

-- The writes of a machine, and the keys whose type and right were checked: they are
-- checked once for all machines that a call wakes.
local writes, asked = {}, {}

-- Adds a write. If it fails others would have been made before, so it is asked first
-- whether its key is of a type, or absent, and whether the user has the right.
local function add_write(kind, name, key, ...)
  writes[#writes + 1] = { name, key, ... }
  if writes[2] == nil or asked[key] == name then return end -- the first may fail
  if not host.may(name, key, ...) then
    fail("no right to do %s %s", name, shown(key))
  end
  local found = kind and host.call("TYPE", key).ok
  if kind and found ~= kind and found ~= "none" then
    fail("%s expected at '%s', got %s", kind, shown(key), found)
  end
  asked[key] = name
end

local function add_due(machine, due)
  if due and not machine.list[HELD] then
    add_write("zset", "ZADD", keys_of.due(machine.key), ("%.6f"):format(due),
      machine.key)
  elseif machine.list[DUE] then
    add_write("zset", "ZREM", keys_of.due(machine.key), machine.key)
  end
end

-- Adds what callbacks emitted to the stream of the tag, their errors to the log.
local function add_streams(machine, emitted, errors)
  for _, entry in ipairs(emitted) do
    add_write("stream", "XADD", keys_of.out(machine.key), "*", "machine", machine.key,
      "what", entry[1], "data", entry[2])
  end
  for _, text in ipairs(errors) do
    add_write("stream", "XADD", keys_of.log(machine.key), "MAXLEN", "~", MAX_LOG, "*",
      "error", text)
  end
end

-- Returns the first text behind all those with a head. A key may begin with any byte.
local function behind(head) return head:sub(1, -2) .. char(head:byte(-1) + 1) end

-- Lists how members of an index begin: with chart and state, and a tab behind each.
local function heads_of(index)
  local heads, from = {}, ""
  repeat
    local member = host.call("ZRANGEBYLEX", index, "[" .. from, "+", "LIMIT", 0, 1)[1]
    local head = member and member:match("^[^\t]*\t[^\t]*\t")
    heads[#heads + 1], from = head, head and behind(head)
  until not head
  return heads
end

-- Lists the members that the index may have of a machine: where it was, or, if it is
-- new, where one with its key was that ended by DEL.
local function old_members(machine, index)
  if machine.leaf then
    return { keys_of.member(machine.chart.name, machine.leaf, machine.key) }
  end
  local members = heads_of(index)
  for i, head in ipairs(members) do members[i] = head .. machine.key end
  return members
end

local function add_to_index(machine)
  local index, name = keys_of.index(machine.key), machine.chart.name
  local old = old_members(machine, index)
  if old[1] then add_write("zset", "ZREM", index, unpack(old)) end
  add_write("zset", "ZADD", index, 0, keys_of.member(name, machine.at, machine.key))
  add_write("zset", "ZADD", keys_of.since(machine.key), ("%.6f"):format(now()),
    machine.key)
end

-- Adds what index, history and channel say of new active leaves.
local function add_moves(machine)
  local key = machine.key
  if options.index and machine.at ~= (machine.leaf or "") then add_to_index(machine) end
  for _, at in ipairs(machine.moves) do
    if options.history then
      add_write("stream", "XADD", keys_of.history(key), "MAXLEN", options.history, "*",
        "event", at.by, "from", at.from, "to", at.to)
    end
    if at.from ~= at.to then add_write(nil, "SPUBLISH", keys_of.channel(key), at.to) end
  end
end

-- Writes all that has changed, and returns the reply: leaf, mode, errors, and what
-- became of the events. The id of events that were dropped is not kept.
local function save(machine, id)
  local chart, list, leaf = machine.chart, machine.list, machine.fsm._act_leaf
  list[SNAP] = snapshot.take(machine.fsm)
  chart.options.is_tidy = list[SNAP].targets == nil
  local due, emitted, errors = due_of(machine), charts.effects()
  local reply = { machine.at, leaf and leaf._mode or "inactive" }
  if not machine.outcome then
    machine.outcome = has_changed(machine, list[SNAP]) and "kept" or "dropped"
  end
  if machine.outcome ~= "dropped" then add_id(machine, id) end
  writes = {}
  add_due(machine, due)
  add_streams(machine, emitted, errors)
  add_write(nil, "SET", machine.key, pack_machine(list, due))
  add_moves(machine)
  local ok, problem = pcall(host.call, unpack(writes[1]))
  if not ok then
    fail("%s %s: %s", writes[1][1], shown(writes[1][2]), reason_of(problem))
  end
  for i = 2, #writes do host.call(unpack(writes[i])) end
  for _, text in ipairs(errors) do reply[#reply + 1] = text end
  reply[#reply + 1] = machine.outcome
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
      fail("data: the root of the chart does not keep '%s'", tostring(name))
    end
    fsm[name] = data[name]
  end
end

-- Returns leaf and mode of a machine as it was saved, and whatever follows.
local function reply_of(list, ...)
  local snap = list[SNAP]
  return { snap.leaf or "", snap.leaf and (snap.done and "done" or "active")
    or "inactive", ... }
end

-- rfsm_create KEY chart [data] [ID id]: makes a machine and runs it.
function functions.rfsm_create(keys, args)
  local key, id = key_of(keys), take_id(args)
  local found = versions_of(args[1] or "")
  local chart = open(found[#found])
  if host.call("EXISTS", key) == 1 then
    local list = id and read_value(key)
    if list and has_id(list, id) then return reply_of(list, "known") end
    fail("something is at '%s'", shown(key))
  end
  times.set(false)
  local ok, problem = put(chart, chart.blank)
  if not ok then fail("%s", problem) end
  set_data(chart.fsm, args[2])
  local machine = new_machine(key, chart, { "rfsm", args[1] }, false)
  machine.outcome = step(machine, "") and "taken" or "kept"
  return save(machine, id)
end

-- rfsm_send KEY event... [ID id]: sends events to a machine and runs it.
function functions.rfsm_send(keys, args)
  local key, id = key_of(keys), take_id(args)
  if not args[1] then fail("an event expected, got none") end
  local list = read_value(key)
  if id and has_id(list, id) then return reply_of(list, "known") end
  local machine = load_machine(key, list)
  move(machine, args, id)
  return save(machine, machine.outcome ~= "kept" and id)
end

-- rfsm_send_at KEY time event... ID id: sends events when a time has come.
function functions.rfsm_send_at(keys, args)
  local key, id = key_of(keys), take_id(args)
  local text = remove(args, 1)
  if not (id and args[1]) then fail("a time, events and ID id expected") end
  local list = read_value(key)
  if has_id(list, id) then return reply_of(list, "known") end
  local machine = load_machine(key, list)
  charts.events(machine.chart, args)
  add_later(machine, time_of(text), id, args)
  catch_up(machine)
  machine.outcome = machine.outcome or "kept"
  return save(machine)
end

-- Removes the events with an id from those that wait; returns whether they were there.
local function remove_later(list, id)
  for i, entry in ipairs(list[LATER] or NONE) do
    if entry[2] == id then return remove(list[LATER], i) ~= nil end
  end
  return false
end

-- rfsm_cancel KEY id: takes back what rfsm_send_at has sent, unless its time has come;
-- returns whether it was.
function functions.rfsm_cancel(keys, args)
  local key, is_there = key_of(keys), false
  local list = read_value(key)
  for _, entry in ipairs(list[LATER] or NONE) do
    is_there = is_there or entry[2] == args[1]
  end
  if not is_there then return 0 end
  local machine = load_machine(key, list)
  run(machine)
  is_there = remove_later(list, args[1])
  save(machine)
  return is_there and 1 or 0
end

local function tick(key)
  local value = host.call("GET", key)
  if not value then
    host.call("ZREM", keys_of.due(key), key)
    return false
  end
  local machine = load_machine(key, list_of(key, value))
  run(machine)
  return save(machine)
end

-- rfsm_tick KEY: runs a machine, because it is due. One that is gone is due no more.
function functions.rfsm_tick(keys)
  local key = key_of(keys)
  local reply = tick(key)
  host.call("ZREM", keys_of.aside(key), key)
  return reply
end

-- Has a machine that cannot be run wait, so that others are not held up: for a minute,
-- counted, and noted in its log.
local function put_aside(due, key, problem)
  local text = "rfsm_wake: " .. reason_of(problem)
  host.call("ZADD", due, ("%.6f"):format(now() + ASIDE), key)
  host.call("ZINCRBY", keys_of.aside(due), 1, key)
  pcall(host.call, "XADD", keys_of.log(key), "MAXLEN", "~", MAX_LOG, "*", "error", text)
end

local function is_elsewhere(problem)
  return reason_of(problem):find("non local key", 1, true) ~= nil
end

-- rfsm_wake KEY [limit]: runs the machines that are due, of those that share the hash
-- tag of the key; returns how many ran, and how many could not.
function functions.rfsm_wake(keys, args)
  local due, limit = keys_of.due(keys[1]), whole_of(args[1], 100, 10000)
  local aside = keys_of.aside(due)
  local list = host.call("ZRANGEBYSCORE", due, "-inf", ("%.6f"):format(now()), "LIMIT",
    0, limit)
  if not list[1] then return { 0, 0 } end
  local has_aside, count, failed = host.call("EXISTS", aside) == 1, 0, 0
  for _, key in ipairs(list) do
    local ok, problem = pcall(tick, key)
    if ok then
      count = count + 1
      if has_aside then host.call("ZREM", aside, key) end
    elseif not is_elsewhere(problem) then
      failed = failed + 1
      put_aside(due, key, problem)
    end
  end
  return { count, failed }
end

-- rfsm_due KEY [limit [seconds]]: the machines, of those that share the hash tag of the
-- key, that are due now, or at a time.
function functions.rfsm_due(keys, args)
  local limit, at = tonumber(args[1] or 100), tonumber(args[2] or now())
  if not limit or not at then fail("a number expected") end
  return host.call("ZRANGEBYSCORE", keys_of.due(keys[1]), "-inf", ("%.6f"):format(at),
    "LIMIT", 0, limit)
end

-- Returns what a snapshot keeps, by the location of the state, as JSON shows it.
local function data_of(snap)
  local data = {}
  local function add(part, prefix)
    for fqn, fields in pairs(part.data or {}) do -- any order: a copy
      data[prefix .. fqn:sub(5)] = encoding.unpack(fields, 0)
    end
  end
  add(snap, "root")
  for prefix, part in pairs(snap.regions or {}) do add(part, prefix) end -- any order
  return data
end

-- rfsm_get KEY: names and values.
function functions.rfsm_get(keys)
  local list = read_value(key_of(keys))
  local snap, names, queue = list[SNAP], {}, {}
  local leaf = snap.leaf or ""
  for i, event in ipairs(snap.queue or {}) do queue[i] = encoding.unpack(event, 0) end
  for i in leaf:gmatch("()%.") do names[#names + 1] = leaf:sub(1, i - 1) end
  names[#names + 1] = snap.leaf
  local due = list[DUE] and not list[HELD] and ("%.6f"):format(list[DUE]) or ""
  return { "chart", list[NAME], "version", snap.chart, "leaf", leaf,
    "mode", reply_of(list)[2],
    "configuration", concat(names, " "), "data", charts.json_of(data_of(snap)),
    "queue", queue[1] ~= nil and charts.json_of(queue) or "[]", "due", due,
    "held", list[HELD] and "yes" or "" }
end

-- The verbs of an operator.

-- rfsm_hold KEY: has a machine rest; its events wait, and its timers.
function functions.rfsm_hold(keys)
  local key = key_of(keys)
  local list = read_value(key)
  if list[HELD] then fail("the machine at '%s' is held already", shown(key)) end
  local machine = load_machine(key, list)
  run(machine)
  list[HELD] = true
  return save(machine)
end

-- rfsm_release KEY: lets it go on: what has come due meanwhile runs in order.
function functions.rfsm_release(keys)
  local key = key_of(keys)
  local list = read_value(key)
  if not list[HELD] then fail("the machine at '%s' is not held", shown(key)) end
  list[HELD] = nil
  local machine = load_machine(key, list)
  run(machine)
  return save(machine)
end

-- rfsm_force KEY state: puts a machine into a leaf. No callback of a way there runs.
function functions.rfsm_force(keys, args)
  local key = key_of(keys)
  local machine = load_machine(key, read_value(key))
  times.set(false)
  charts.force(machine.chart, args[1] or "")
  machine.outcome = step(machine, "(force)") and "taken" or "kept"
  return save(machine)
end

-- rfsm_remove KEY: ends a machine, with its timers, its place in the index and its
-- streams. Returns whether it was there.
function functions.rfsm_remove(keys)
  local key = key_of(keys)
  if host.call("DEL", key) == 0 then return 0 end
  host.call("ZREM", keys_of.due(key), key)
  host.call("ZREM", keys_of.aside(key), key)
  host.call("DEL", keys_of.log(key), keys_of.history(key))
  if options.index then
    local members = old_members({ key = key }, keys_of.index(key))
    if members[1] then host.call("ZREM", keys_of.index(key), unpack(members)) end
    host.call("ZREM", keys_of.since(key), key)
  end
  return 1
end

-- rfsm_why KEY event: the answer of each transition, from the outermost state inwards.
function functions.rfsm_why(keys, args)
  if #args ~= 1 then fail("one event expected, got %d", #args) end
  local key, lines = key_of(keys), {}
  local machine = load_machine(key, read_value(key))
  times.set(false)
  local _, text = why.why(machine.fsm, charts.events(machine.chart, args)[1])
  for line in text:gmatch("[^\n]+") do lines[#lines + 1] = line end
  return lines
end

-- Is a machine there? DEL ends one and leaves the index as it is. While a slot moves to
-- another node, which may have the machine, the index is believed.
local function is_there(key)
  local ok, count = pcall(host.call, "EXISTS", key)
  return not ok or count == 1
end

-- Has a machine been in its leaf since a time, or longer?
local function is_since(key, time)
  local since = time and host.call("ZSCORE", keys_of.since(key), key)
  return not time or since and tonumber(since) <= time
end

-- Lists the keys of machines, at most so many, whose members have a head.
local function keys_with(index, head, limit, time)
  local found, count = {}, min(limit, 1000)
  local from, to = "[" .. head, "(" .. behind(head)
  repeat
    local members = host.call("ZRANGEBYLEX", index, from, to, "LIMIT", 0, count)
    for _, member in ipairs(members) do
      local key = member:match("\t[^\t]*\t(.*)$")
      local is_one = #found < limit and is_since(key, time) and is_there(key)
      found[#found + 1] = is_one and key or nil
    end
    from = "(" .. (members[count] or "")
  until #found == limit or not members[count]
  return found
end

-- rfsm_find KEY chart state [limit [seconds]]: the machines, of those that share the
-- hash tag of the key, whose active leaf is the state, or in it, for so many seconds.
function functions.rfsm_find(keys, args)
  if not options.index then fail("the library was made without --index") end
  local index, limit = keys_of.index(keys[1]), whole_of(args[3], 100, 100000)
  if not args[2] then fail("a chart and a state expected") end
  local head, time = args[1] .. "\t" .. args[2], nil
  if args[4] then time = now() - whole_of(args[4], 0, 1e9) end
  local found = keys_with(index, head .. "\t", limit, time) -- the state itself
  for _, key in ipairs(keys_with(index, head .. ".", limit - #found, time)) do
    found[#found + 1] = key
  end
  return found
end

-- rfsm_stats KEY: for the machines that share the hash tag of the key: chart, state and
-- number, and so on; then numbers of those with a time at which they are due, of those
-- put aside, of entries, of those overdue for a minute, and of dead entries.
function functions.rfsm_stats(keys)
  local index, reply = keys_of.index(keys[1]), {}
  for _, head in ipairs(options.index and heads_of(index) or {}) do
    local name, leaf = head:match("^([^\t]*)\t([^\t]*)")
    local count = #keys_with(index, head, huge)
    for _, value in ipairs(count > 0 and { name, leaf, count } or {}) do
      reply[#reply + 1] = value
    end
  end
  return { reply, host.call("ZCARD", keys_of.due(keys[1])),
    host.call("ZCARD", keys_of.aside(keys[1])),
    host.call("XLEN", keys_of.out(keys[1])),
    host.call("ZCOUNT", keys_of.due(keys[1]), "-inf", ("%.6f"):format(now() - OVERDUE)),
    host.call("XLEN", keys_of.dead(keys[1])) }
end

-- rfsm_history KEY [count]: the latest moves of a machine, the newest first: time,
-- events, from, to, and so on.
function functions.rfsm_history(keys, args)
  if not options.history then fail("the library was made without --history") end
  local reply, count = {}, whole_of(args[1], 10, 10000)
  local entries = host.call("XREVRANGE", keys_of.history(key_of(keys)), "+", "-",
    "COUNT", count)
  for _, entry in ipairs(entries) do
    local ms, fields = entry[1]:match("^%d+"), entry[2]
    for _, value in ipairs { ("%.3f"):format(ms / 1000), fields[2], fields[4],
      fields[6] } do
      reply[#reply + 1] = value
    end
  end
  return reply
end

--- Return the functions for Redis, by name, as it calls them. Of charts with one name
-- in the list of { name =, make = }, the last is the newest.
---@param redis rfsm.server.Host
---@param settings? rfsm.server.Options
return function(redis, list, settings)
  local made = {}
  host, versions, options = redis, {}, settings or {}
  options.ids = options.ids or options.ids_for and 1000 or 16
  times.open(host)
  charts.use(function(text) return host.json.decode(text) end)
  for _, chart in ipairs(list) do
    versions[chart.name] = versions[chart.name] or {}
    versions[chart.name][#versions[chart.name] + 1] = chart
  end
  for name, f in pairs(functions) do -- any order: each stands alone
    made[name] = function(keys, args)
      times.begin()
      asked = {}
      local ok, reply = pcall(f, keys, args)
      if ok then return reply end
      return host.error_reply("ERR " .. name .. ": " .. reason_of(reply))
    end
  end
  return made
end
