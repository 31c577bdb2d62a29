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
-- The file reads in the order of a call: charts, arguments, load, run, save, functions.
--
-- @module rfsm.server.functions
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local alphabet = require "rfsm.shared.alphabet"
local calls = require "rfsm.shared.calls"
local clock = require "rfsm.clock"
local keys_of = require "rfsm.server.keys"
local encoding = require "rfsm.snapshot.encoding"
local rfsm = require "rfsm"
local snapshot = require "rfsm.snapshot"
local timeevent = require "rfsm_timeevent"
local why = require "rfsm.observe.why"
require "rfsm.await"

local error, getmetatable, ipairs, pairs = error, getmetatable, ipairs, pairs
local pcall, rawget, rawset, select = pcall, rawget, rawset, select
local setmetatable, tonumber, type = setmetatable, tonumber, type
local char = string.char
local floor, huge, min = math.floor, math.huge, math.min
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local concat, remove, sort = table.concat, table.remove, table.sort
local copy_of, fail, is_meta, text_of = encoding.copy_of, encoding.fail, rfsm.is_meta,
  rfsm.text_of

local MAX_EVENT, MAX_DATA, MAX_VALUE = 256, 65536, 1048576 -- bytes
local MAX_STEPS, MAX_LOG = 1000, 1000
local MAX_ID, MAX_LATER = 64, 100 -- bytes, events of a machine
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
---@field ids? integer so many ids of events each machine keeps (16)
---@field ids_for? integer ids are kept for so many seconds, at most `ids` (1000)

-- What the library was made with. One library runs in a server, so it is kept here.
local host, charts, options

-- Charts: one machine of each version, into which each call puts a snapshot --------

--- One version of a chart.
---@class rfsm.server.Chart
---@field name string
---@field make fun(): rfsm.State
---@field fsm rfsm.Machine|nil made at the first call
---@field blank rfsm.snapshot.Snapshot of a new machine
---@field options rfsm.snapshot.Options how snapshots are put into it
---@field fields rfsm.server.Fields as they were at first
---@field events table<string, any> what it knows, by text
---@field takes_all boolean a transition that any event triggers, or a predicate

local function note_events(chart, fsm)
  local known = alphabet.of_all(fsm)
  chart.events = {}
  for _, list in ipairs { known.list, known.reactions } do
    for _, event in ipairs(list) do
      local text = text_of(event)
      if #text <= MAX_EVENT then chart.events[text] = event end
    end
  end
  chart.takes_all = known.takes_any or known.predicates[1] ~= nil
end

-- Entries for the stream, and errors, that callbacks of this call have caused.
local emitted, printed = {}, {}

local function emit(what, data)
  if type(what) ~= "string" then
    error("emit: name expected, got " .. type(what), 2)
  end
  emitted[#emitted + 1] = { what, data ~= nil and host.json.encode(data) or "" }
end

local function collect_print(...)
  printed[#printed + 1] = calls.text(" ", ...)
end

-- One machine of a chart serves all. Callbacks may have changed fields that the chart
-- does not keep: `clean` undoes that before each call. New fields are noted when they
-- are set, the others are compared.

-- Pairs of element and new field, in a flat list; the first fields of each element.
local added, known_of = {}, setmetatable({}, { __mode = "k" })

-- Has a metatable note the fields that are added.
local function watch(class)
  if rawget(class, "is_watched") then return end
  local set = class.__newindex or rawset
  class.is_watched = true
  function class.__newindex(obj, key, value)
    set(obj, key, value)
    local known = not is_meta(key) and known_of[obj]
    if known and not (known[key] or rfsm.is_fsmobj(value)) then
      added[#added + 1], added[#added + 2] = obj, key
    end
  end
end

--- Fields of elements as they were at first, in lists side by side. Those that hold
-- plain tables, which callbacks may change, are in lists of the same kind.
---@class rfsm.server.Fields
---@field objs table[]
---@field keys any[]
---@field values any[]
---@field tables rfsm.server.Fields?

local function new_fields(tables)
  return { objs = {}, keys = {}, values = {}, tables = tables }
end

local function note_fields(fields, obj)
  local known, is_kept = {}, { keep = true }
  for _, name in ipairs(obj.keep or {}) do is_kept[name] = true end
  for key, value in pairs(obj) do -- any order: each stands alone
    known[key] = true
    if not (is_meta(key) or rfsm.is_fsmobj(value) or is_kept[key]) then
      local is_table = type(value) == "table" and getmetatable(value) == nil
      local list = is_table and fields.tables or fields
      local n = #list.objs + 1
      list.objs[n], list.keys[n], list.values[n] = obj, key, copy_of(value)
    end
  end
  for name in pairs(is_kept) do known[name] = true end -- any order: a set
  known_of[obj] = known
  watch(getmetatable(obj))
end

-- Gives the elements the fields back that they had at first. This runs in each call.
local function clean(chart)
  for i = #added, 2, -2 do
    rawset(added[i - 1], added[i], nil)
    added[i - 1], added[i] = nil, nil
  end
  local fields = chart.fields
  local objs, keys, values = fields.objs, fields.keys, fields.values
  for i = 1, #objs do
    if objs[i][keys[i]] ~= values[i] then rawset(objs[i], keys[i], values[i]) end
  end
  objs, keys, values = fields.tables.objs, fields.tables.keys, fields.tables.values
  for i = 1, #objs do rawset(objs[i], keys[i], copy_of(values[i])) end
end

-- Makes the machine of a chart when it is first needed; returns the chart.
local function open(chart)
  if chart.fsm then return chart end
  local ok, model = pcall(chart.make)
  if not ok then fail("chart '%s': %s", chart.name, text_of(model)) end
  model.info, model.warn, model.err = false, false, collect_print
  local fsm, _, problems = rfsm.init(model)
  if not fsm then fail("chart '%s': %s", chart.name, problems[1]) end
  fsm.emit, chart.blank = emit, snapshot.take(fsm)
  note_events(chart, fsm)
  chart.options = { migrate = fsm.migrate, rename = fsm.rename, trusted = true }
  chart.fields = new_fields(new_fields())
  for _, at in ipairs(rfsm.machines(fsm)) do
    for _, obj in ipairs(rfsm.elements(at.machine)) do
      note_fields(chart.fields, obj)
    end
  end
  chart.fsm = fsm
  return chart
end

-- Arguments ----------------------------------------------------------------------

local key_of, shown = keys_of.machine, keys_of.shown

local function reason_of(failure)
  return calls.line(type(failure) == "table" and failure.err
    or encoding.reason(failure))
end

local function versions_of(name)
  return charts[name] or fail("no chart is named '%s'%s", shown(name),
    advice.nearest_name(shown(name), rfsm.sorted_keys(charts)))
end

local function events_of(chart, texts)
  local events = {}
  for i, text in ipairs(texts) do
    if #text > MAX_EVENT then
      fail("event %d: at most %d bytes expected, got %d", i, MAX_EVENT, #text)
    end
    local event = chart.events[text]
    if event == nil and not chart.takes_all then
      fail("no transition of chart '%s' has the event '%s'%s", chart.name, text,
        advice.nearest_name(text, rfsm.sorted_keys(chart.events)))
    end
    events[i] = event == nil and text or event
  end
  return events
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
local function time_of(text, now)
  local offset, number = text:match("^(%+?)(%d+%.?%d*)$")
  if not number then fail("seconds, or +seconds expected, got '%s'", shown(text)) end
  return tonumber(number) + (offset == "+" and now or 0)
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
-- later: { time, id, event, ... }.
local NAME, SNAP, SEC, NSEC, DUE, IDS, LATER = 2, 3, 4, 5, 6, 7, 8

-- The clock of the machines, read once a call: `sec` is false until it is needed.
local sec, nsec, time = false, 0, nil

local function gettime()
  if not sec then
    time = time or host.call("TIME")
    sec, nsec = tonumber(time[1]), tonumber(time[2]) * 1000
  end
  return sec, nsec
end

local function now()
  gettime()
  return sec + nsec / 1e9
end

--- A machine that a call works on.
---@class rfsm.server.Machine
---@field key string
---@field chart rfsm.server.Chart
---@field fsm rfsm.Machine
---@field list any[] in the value of the key; the new one is made of it
---@field leaf string|false|nil where it was, as the index knows it: before a rename
---@field moved_by string the events of this call
---@field notes string[]|nil for the log

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

local function put(chart, snap)
  clean(chart)
  local ok, problem = snapshot.put(chart.fsm, snap, chart.options)
  chart.options.is_tidy = false
  return ok, problem
end

-- Has the newest version of a chart take a snapshot, if it is of that version or moves
-- to it; else the version that it is of.
local function place(versions, snap)
  local newest, own = open(versions[#versions]), nil
  if snap.chart ~= newest.blank.chart then
    for _, chart in ipairs(versions) do
      if open(chart).blank.chart == snap.chart then own = chart end
    end
    newest.options.old = own and own.fsm
  end
  local ok, problem = put(newest, snap)
  if ok or not own then return newest, ok, problem end
  return own, put(own, snap)
end

local function load_machine(key, list)
  sec, nsec = list[SEC] or false, list[NSEC]
  local leaf = list[SNAP].leaf
  local chart, ok, problem = place(versions_of(list[NAME]), list[SNAP])
  if not ok then fail("the machine at '%s': %s", shown(key), problem) end
  sec = false
  return { key = key, chart = chart, fsm = chart.fsm, list = list, leaf = leaf,
    moved_by = "" }
end

-- Run ----------------------------------------------------------------------------

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

local function send(machine, texts)
  for _, event in ipairs(events_of(machine.chart, texts)) do
    rfsm.send_events(machine.fsm, event)
  end
  machine.moved_by = (machine.moved_by == "" and "" or machine.moved_by .. " ")
    .. concat(texts, " ")
end

-- Sends events whose time has come. One that is not known any more goes to the log.
local function send_later(machine)
  local later = machine.list[LATER]
  while later and later[1] and later[1][1] <= now() do
    local entry = remove(later, 1)
    local ok, problem = pcall(send, machine, { select(3, unpack(entry)) })
    add_id(machine, entry[2])
    if not ok then
      machine.notes = machine.notes or {}
      machine.notes[#machine.notes + 1] = "rfsm_send_at: " .. encoding.reason(problem)
    end
  end
end

-- Save: first all that may fail, then the writes -----------------------------------

-- Returns when a machine is to be woken; nil: not before an event comes.
local function due_of(machine, is_idle)
  if not is_idle and machine.fsm._act_leaf then return now() end
  local snap, later = machine.list[SNAP], machine.list[LATER]
  local left = (snap.ext or snap.regions) and timeevent.next_deadline(machine.fsm)
  local due = left and now() + left or nil
  later = later and later[1]
  if later then due = min(due or later[1], later[1]) end
  return due
end

-- Returns the value of a machine; its list ends with what is there.
local function pack_machine(list, due)
  if list[LATER] then
    list[IDS] = list[IDS] or false
    if not list[LATER][1] then list[LATER] = nil end
  end
  if due then
    list[SEC], list[NSEC] = gettime()
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
  if due then
    add_write("zset", "ZADD", keys_of.due(machine.key), ("%.6f"):format(due),
      machine.key)
  elseif machine.list[DUE] then
    add_write("zset", "ZREM", keys_of.due(machine.key), machine.key)
  end
end

-- Adds what callbacks emitted to the stream of the tag, their errors to the log.
local function add_streams(machine)
  for _, entry in ipairs(emitted) do
    add_write("stream", "XADD", keys_of.out(machine.key), "*", "machine", machine.key,
      "what", entry[1], "data", entry[2])
  end
  for _, text in ipairs(printed) do
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

-- Adds what index, history and channel say of a new active leaf.
local function add_move(machine, leaf)
  local key, name = machine.key, machine.chart.name
  if options.index then
    local index = keys_of.index(key)
    local old = old_members(machine, index)
    if old[1] then add_write("zset", "ZREM", index, unpack(old)) end
    add_write("zset", "ZADD", index, 0, keys_of.member(name, leaf, key))
  end
  if options.history then
    add_write("stream", "XADD", keys_of.history(key), "MAXLEN", options.history, "*",
      "event", machine.moved_by, "from", machine.leaf or "", "to", leaf)
  end
  add_write(nil, "SPUBLISH", keys_of.channel(key), leaf)
end

-- Runs a machine until it is idle; one that never is goes on when it is due. If it is
-- cut short the chart is left without a machine, and gets a new one. Writes all that
-- has changed, and returns the reply: leaf, mode, errors.
local function advance(machine)
  emitted, printed, machine.chart.fsm = {}, machine.notes or {}, nil
  local fsm, chart, list = machine.fsm, machine.chart, machine.list
  local is_idle, leaf = rfsm.step(fsm, MAX_STEPS), fsm._act_leaf
  chart.fsm = fsm
  list[SNAP] = snapshot.take(fsm)
  chart.options.is_tidy = list[SNAP].targets == nil
  local due = due_of(machine, is_idle)
  local reply = { leaf and leaf._fqn or "", leaf and leaf._mode or "inactive" }
  writes = {}
  add_due(machine, due)
  add_streams(machine)
  add_write(nil, "SET", machine.key, pack_machine(list, due))
  if reply[1] ~= (machine.leaf or "") then add_move(machine, reply[1]) end
  local ok, problem = pcall(host.call, unpack(writes[1]))
  if not ok then
    fail("%s %s: %s", writes[1][1], shown(writes[1][2]), reason_of(problem))
  end
  for i = 2, #writes do host.call(unpack(writes[i])) end
  for _, text in ipairs(printed) do reply[#reply + 1] = text end
  return reply
end

-- Functions ----------------------------------------------------------------------

local functions = {}

local function set_data(fsm, text)
  if not text then return end
  if #text > MAX_DATA then
    fail("data: at most %d bytes expected, got %d", MAX_DATA, #text)
  end
  local ok, data = pcall(host.json.decode, text)
  if not ok or type(data) ~= "table" then fail("data: a JSON object expected") end
  local about = { owner = "data", base = 0, seen = {} }
  data = encoding.unpack(encoding.pack(data, about, 0), 0)
  local is_kept = {}
  for _, name in ipairs(fsm.keep or {}) do is_kept[name] = true end
  for _, name in ipairs(rfsm.sorted_keys(data)) do
    if not is_kept[name] then
      fail("data: the root of the chart does not keep '%s'", tostring(name))
    end
    fsm[name] = data[name]
  end
end

-- Returns the reply for an event that was applied before.
local function reply_of(list)
  local snap = list[SNAP]
  return { snap.leaf or "", snap.leaf and (snap.done and "done" or "active")
    or "inactive" }
end

-- rfsm_create KEY chart [data] [ID id]: makes a machine and runs it.
function functions.rfsm_create(keys, args)
  local key, id = key_of(keys), take_id(args)
  local versions = versions_of(args[1] or "")
  local chart = open(versions[#versions])
  local fsm = chart.fsm
  if host.call("EXISTS", key) == 1 then
    local list = id and read_value(key)
    if list and has_id(list, id) then return reply_of(list) end
    fail("something is at '%s'", shown(key))
  end
  local ok, problem = put(chart, chart.blank)
  if not ok then fail("%s", problem) end
  set_data(fsm, args[2])
  local machine = { key = key, chart = chart, fsm = fsm, list = { "rfsm", args[1] },
    leaf = false, moved_by = "" }
  add_id(machine, id)
  return advance(machine)
end

-- rfsm_send KEY event... [ID id]: sends events to a machine and runs it.
function functions.rfsm_send(keys, args)
  local key, id = key_of(keys), take_id(args)
  if not args[1] then fail("an event expected, got none") end
  local list = read_value(key)
  if id and has_id(list, id) then return reply_of(list) end
  local machine = load_machine(key, list)
  send_later(machine)
  send(machine, args)
  add_id(machine, id)
  return advance(machine)
end

-- rfsm_send_at KEY time event... ID id: sends events when a time has come.
function functions.rfsm_send_at(keys, args)
  local key, id = key_of(keys), take_id(args)
  local text = remove(args, 1)
  if not (id and args[1]) then fail("a time, events and ID id expected") end
  local list = read_value(key)
  if has_id(list, id) then return reply_of(list) end
  local machine = load_machine(key, list)
  events_of(machine.chart, args)
  local later = list[LATER] or {}
  if #later >= MAX_LATER then fail("at most %d events may wait", MAX_LATER) end
  later[#later + 1] = { time_of(text, now()), id, unpack(args) }
  sort(later, function(a, b)
    if a[1] ~= b[1] then return a[1] < b[1] end
    return a[2] < b[2]
  end)
  list[LATER] = later
  send_later(machine)
  return advance(machine)
end

-- rfsm_cancel KEY id: takes back what rfsm_send_at has sent; returns whether it was.
function functions.rfsm_cancel(keys, args)
  local key = key_of(keys)
  local list = read_value(key)
  for i, entry in ipairs(list[LATER] or {}) do
    if entry[2] == args[1] then
      remove(list[LATER], i)
      advance(load_machine(key, list))
      return 1
    end
  end
  return 0
end

local function tick(key)
  local value = host.call("GET", key)
  if not value then
    host.call("ZREM", keys_of.due(key), key)
    return false
  end
  local machine = load_machine(key, list_of(key, value))
  send_later(machine)
  if machine.moved_by == "" then machine.moved_by = "(time)" end
  return advance(machine)
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
    sec = false
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
      data[prefix .. fqn:sub(5)] = encoding.to_json(encoding.unpack(fields, 0))
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
  local due = list[DUE] and ("%.6f"):format(list[DUE]) or ""
  return { "chart", list[NAME], "version", snap.chart, "leaf", leaf,
    "mode", reply_of(list)[2],
    "configuration", concat(names, " "), "data", host.json.encode(data_of(snap)),
    "queue", queue[1] ~= nil and host.json.encode(queue) or "[]", "due", due }
end

-- rfsm_why KEY event: the answer of each transition, from the outermost state inwards.
function functions.rfsm_why(keys, args)
  if #args ~= 1 then fail("one event expected, got %d", #args) end
  local key, lines = key_of(keys), {}
  local machine = load_machine(key, read_value(key))
  local _, text = why.why(machine.fsm, events_of(machine.chart, args)[1])
  for line in text:gmatch("[^\n]+") do lines[#lines + 1] = line end
  return lines
end

-- Is a machine there? DEL ends one and leaves the index as it is. While a slot moves to
-- another node, which may have the machine, the index is believed.
local function is_there(key)
  local ok, count = pcall(host.call, "EXISTS", key)
  return not ok or count == 1
end

-- Lists the keys of machines, at most so many, whose members have a head.
local function keys_with(index, head, limit)
  local found, count = {}, min(limit, 1000)
  local from, to = "[" .. head, "(" .. behind(head)
  repeat
    local members = host.call("ZRANGEBYLEX", index, from, to, "LIMIT", 0, count)
    for _, member in ipairs(members) do
      local key = member:match("\t[^\t]*\t(.*)$")
      found[#found + 1] = #found < limit and is_there(key) and key or nil
    end
    from = "(" .. (members[count] or "")
  until #found == limit or not members[count]
  return found
end

-- rfsm_find KEY chart state [limit]: the machines, of those that share the hash tag of
-- the key, whose active leaf is the state, or in it.
function functions.rfsm_find(keys, args)
  if not options.index then fail("the library was made without --index") end
  local index, limit = keys_of.index(keys[1]), whole_of(args[3], 100, 100000)
  if not args[2] then fail("a chart and a state expected") end
  local head = args[1] .. "\t" .. args[2]
  local found = keys_with(index, head .. "\t", limit) -- the state itself, those in it
  for _, key in ipairs(keys_with(index, head .. ".", limit - #found)) do
    found[#found + 1] = key
  end
  return found
end

-- rfsm_stats KEY: for the machines that share the hash tag of the key: chart, state and
-- number, and so on; then numbers of those that are due, put aside, and of entries.
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
    host.call("XLEN", keys_of.out(keys[1])) }
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
  host, charts, options = redis, {}, settings or {}
  options.ids = options.ids or options.ids_for and 1000 or 16
  clock.set_hook(gettime)
  for _, chart in ipairs(list) do
    charts[chart.name] = charts[chart.name] or {}
    charts[chart.name][#charts[chart.name] + 1] = chart
  end
  for name, f in pairs(functions) do -- any order: each stands alone
    made[name] = function(keys, args)
      sec, time, asked = false, nil, {}
      local ok, reply = pcall(f, keys, args)
      if ok then return reply end
      return host.error_reply("ERR " .. name .. ": " .. reason_of(reply))
    end
  end
  return made
end
