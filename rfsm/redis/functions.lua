--- The functions that run inside Redis: each restores a machine, advances it and saves
-- it, in one piece.
--
-- `rfsm.redis` bundles this module with the core and the charts. An error changes
-- nothing: all that can fail comes before the first write, also the types of the keys
-- that will be written, and the rights to do so.
--
-- The value of a machine's key is a list in MessagePack: "rfsm", the name of the chart,
-- the snapshot, when it was taken (seconds, nanoseconds) and when it is due, if it is,
-- the ids of the latest events, and the events of `rfsm_send_at`.
--
-- The file reads in the order of a call: charts, arguments, load, run, save, functions.
--
-- @module rfsm.redis.functions
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local alphabet = require "rfsm.shared.alphabet"
local calls = require "rfsm.shared.calls"
local clock = require "rfsm.clock"
local keys_of = require "rfsm.redis.keys"
local plain = require "rfsm.snapshot.plain"
local rfsm = require "rfsm"
local short = require "rfsm.redis.short"
local snapshot = require "rfsm.snapshot"
local timeevent = require "rfsm_timeevent"
local why = require "rfsm.checks.why"
require "rfsm.await"

local error, getmetatable, ipairs, next = error, getmetatable, ipairs, next
local pairs, pcall, rawget, rawset = pairs, pcall, rawget, rawset
local select, tonumber, type = select, tonumber, type
local min = math.min
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local concat, remove, sort = table.concat, table.remove, table.sort
local copy_of, fail, is_meta, text_of = plain.copy_of, plain.fail, rfsm.is_meta,
  rfsm.text_of

local MAX_EVENT, MAX_DATA, MAX_VALUE = 256, 65536, 1048576 -- bytes
local MAX_STEPS, MAX_LOG = 1000, 1000
local MAX_ID, MAX_LATER = 64, 100 -- bytes, events of a machine
local ASIDE = 60 -- seconds until a machine that cannot be run is tried again

--- What the functions use of Redis.
---@class rfsm.redis.Host
---@field call function redis.call
---@field may function redis.acl_check_cmd
---@field error_reply function redis.error_reply
---@field json table cjson
---@field pack table cmsgpack

--- What a library is made with.
---@class rfsm.redis.Options
---@field index? boolean machines are found by their state
---@field history? integer so many moves of each machine are kept
---@field ids? integer so many ids of events each machine keeps (16)

-- Charts: a machine of each version, which stands where a call wants it ------------

--- One version of a chart.
---@class rfsm.redis.Chart
---@field name string
---@field make fun(): rfsm.State
---@field fsm rfsm.Machine|nil made at the first call
---@field fingerprint string of its structure
---@field blank rfsm.snapshot.Snapshot of a new machine
---@field fields rfsm.redis.Fields as they were at first
---@field added any[] element, name and so on of fields that were added since
---@field machines table<rfsm.Machine, table<any, true>> their fields at first
---@field events table<string, any> what it knows, by text
---@field short rfsm.redis.Short|false what the short way knows, when it was taken
---@field takes_all boolean a transition that any event triggers, or a predicate

-- Notes the events that a chart knows.
local function note_events(chart, fsm)
  local known = alphabet.of_all(fsm)
  for _, event in ipairs(known.list) do
    local text = text_of(event)
    if #text <= MAX_EVENT then chart.events[text] = event end
  end
  for _, name in ipairs(known.awaited) do chart.events[name] = name end
  chart.takes_all = known.takes_any or known.predicates[1] ~= nil
end

-- What callbacks do goes here, as long as the call lasts.
local emitted, printed = {}, {}

local function emit_with(json)
  return function(what, data)
    if type(what) ~= "string" then
      error("emit: name expected, got " .. type(what), 2)
    end
    emitted[#emitted + 1] = { what, data ~= nil and json.encode(data) or "" }
  end
end

local function collect_print(...)
  printed[#printed + 1] = calls.text(" ", ...)
end

-- One machine of a chart serves all: what callbacks have left in its fields, and the
-- chart does not keep, is taken away before the next one stands there. Elements report
-- fields that are added; those of machines are compared.

--- Fields of elements as they were at first, in lists side by side. Those that hold
-- plain tables, which callbacks may change, are in lists of the same kind.
---@class rfsm.redis.Fields
---@field objs table[]
---@field keys any[]
---@field values any[]
---@field tables rfsm.redis.Fields?

local function new_fields(tables)
  return { objs = {}, keys = {}, values = {}, tables = tables }
end

local function add_field(fields, obj, key, value)
  local is_table = type(value) == "table" and getmetatable(value) == nil
  if is_table then fields, value = fields.tables, copy_of(value) end
  local n = #fields.objs + 1
  fields.objs[n], fields.keys[n], fields.values[n] = obj, key, value
end

-- Is a field another than those known: none of the engine's, and no element?
local function is_new(known, key, value)
  if known[key] then return false end
  known[key] = is_meta(key) or rfsm.is_fsmobj(value)
  return not known[key]
end

-- Notes the fields of an element.
local function watch(chart, obj)
  local known, is_kept, added = {}, { keep = true }, chart.added
  for _, name in ipairs(obj.keep or {}) do is_kept[name] = true end
  for key, value in pairs(obj) do -- any order: each stands alone
    if is_new(known, key, value) and not is_kept[key] then
      add_field(chart.fields, obj, key, value)
    end
    known[key] = true
  end
  for name in pairs(is_kept) do known[name] = true end -- any order: a set
  if rfsm.is_initialized_root(obj) then
    chart.machines[obj] = known
    return
  end
  getmetatable(obj).__newindex = function(element, key, value)
    rawset(element, key, value)
    if is_new(known, key, value) then
      added[#added + 1], added[#added + 2] = element, key
    end
  end
end

-- Gives the elements the fields back that they had at first. This runs in each call.
local function clean(chart)
  local added, fields = chart.added, chart.fields
  for i = #added, 2, -2 do
    rawset(added[i - 1], added[i], nil)
    added[i - 1], added[i] = nil, nil
  end
  for machine, known in pairs(chart.machines) do -- any order: each stands alone
    for key, value in next, machine do
      if not known[key] and is_new(known, key, value) then
        rawset(machine, key, nil)
      end
    end
  end
  local objs, keys, values = fields.objs, fields.keys, fields.values
  for i = 1, #objs do
    local obj, key, value = objs[i], keys[i], values[i]
    if obj[key] ~= value then rawset(obj, key, value) end
  end
  objs, keys, values = fields.tables.objs, fields.tables.keys, fields.tables.values
  for i = 1, #objs do rawset(objs[i], keys[i], copy_of(values[i])) end
end

-- Returns the machine of a chart; it is made when it is first needed.
local function open(host, chart)
  if chart.fsm then return chart.fsm end
  local ok, model = pcall(chart.make)
  if not ok then fail("chart '%s': %s", chart.name, text_of(model)) end
  model.info, model.warn, model.err = false, false, collect_print
  local fsm, _, problems = rfsm.init(model)
  if not fsm then fail("chart '%s': %s", chart.name, problems[1]) end
  fsm.emit, chart.blank = emit_with(host.json), snapshot.take(fsm)
  chart.events = {}
  note_events(chart, fsm)
  chart.fields, chart.added = new_fields(new_fields()), {}
  chart.machines, chart.short = {}, false
  for _, at in ipairs(rfsm.machines(fsm)) do
    for _, obj in ipairs(rfsm.elements(at.machine)) do
      watch(chart, obj)
    end
  end
  chart.fingerprint, chart.fsm = chart.blank.chart, fsm
  return fsm
end

-- Arguments ----------------------------------------------------------------------

local key_of, shown = keys_of.machine, keys_of.shown

local function versions_of(charts, name)
  return charts[name] or fail("no chart is named '%s'%s", shown(name),
    advice.nearest_name(shown(name), rfsm.sorted_keys(charts)))
end

-- Returns the events that texts stand for.
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

-- Load: the value of a key becomes a machine that stands there ----------------------

-- The clock of the machines: it stands still during a call. It is read when it is first
-- needed, from the host in `unread`.
local sec, nsec, unread = 0, 0, false

local function set_clock(time)
  sec, nsec, unread = tonumber(time[1]), tonumber(time[2]) * 1000, false
end

-- Has the clock show the time again; the same for all machines of a call that has a
-- `lib.time`.
local function read_clock(host, lib)
  if lib and lib.time then return set_clock(lib.time) end
  unread = host
end

local function gettime()
  if unread then set_clock(unread.call("TIME")) end
  return sec, nsec
end

local function now()
  gettime()
  return sec + nsec / 1e9
end

--- A machine that a call works on.
---@class rfsm.redis.Machine
---@field key string
---@field chart rfsm.redis.Chart
---@field fsm rfsm.Machine
---@field leaf string|false where it was
---@field is_due boolean it was due some time
---@field ids string[]|false of the latest events, the oldest first
---@field later any[]|false events that come at a time: { time, id, event, ... }
---@field moved_by string the events of this call

-- Returns the list in the value of a key, see above.
local function list_of(host, key, value)
  local ok, list = pcall(host.pack.unpack, value)
  if not ok or type(list) ~= "table" or list[1] ~= "rfsm" then
    fail("what is at '%s' is no machine", shown(key))
  end
  return list
end

local function read_value(host, key)
  local value = host.call("GET", key)
  if not value then
    fail("no machine is at '%s' (rfsm_create makes one)", shown(key))
  end
  return list_of(host, key, value)
end

local function put(chart, snap, options)
  clean(chart)
  return snapshot.put(chart.fsm, snap, options)
end

-- Has the newest version of a chart take a snapshot, if it is of that version or moves
-- to it; else the version that it is of.
local function place(host, versions, snap)
  local newest = versions[#versions]
  local fsm, own = open(host, newest), nil
  if snap.chart == newest.fingerprint then
    clean(newest)
    if short.put(newest, snap) then return newest, true end
    return newest, snapshot.put(fsm, snap)
  end
  for _, chart in ipairs(versions) do
    open(host, chart)
    if snap.chart == chart.fingerprint then own = chart end
  end
  local ok, problem = put(newest, snap, { migrate = fsm.migrate,
    rename = fsm.rename, old = own and snapshot.structure(own.fsm) })
  if ok or not own or own == newest then return newest, ok, problem end
  return own, put(own, snap)
end

local function load_machine(host, lib, key, list)
  list = list or read_value(host, key)
  local is_timed = list[4]
  if is_timed then
    sec, nsec, unread = list[4], list[5], false
  else
    read_clock(host, lib)
  end
  local chart, ok, problem = place(host, versions_of(lib.charts, list[2]), list[3])
  if not ok then fail("the machine at '%s': %s", shown(key), problem) end
  if is_timed then read_clock(host, lib) end
  local fsm, leaf = chart.fsm, chart.fsm._act_leaf
  return { key = key, chart = chart, fsm = fsm, leaf = leaf and leaf._fqn,
    is_due = (list[6] or false) ~= false, ids = list[7], later = list[8],
    moved_by = "" }
end

-- Run ----------------------------------------------------------------------------

-- Runs a machine until it is idle; one that never is goes on when it is due. If it is
-- cut short the chart is left without a machine, and gets a new one.
local function run(machine)
  emitted, printed, machine.chart.fsm = {}, machine.notes or {}, nil
  machine.is_idle = rfsm.step(machine.fsm, MAX_STEPS)
  machine.chart.fsm = machine.fsm
end

-- Was an event with this id applied, or is it to come?
local function has_id(list, id)
  for _, known in ipairs(list[7] or {}) do
    if known == id then return true end
  end
  for _, entry in ipairs(list[8] or {}) do
    if entry[2] == id then return true end
  end
  return false
end

local function add_id(lib, machine, id)
  if not id then return end
  machine.ids = machine.ids or {}
  machine.ids[#machine.ids + 1] = id
  if #machine.ids > lib.options.ids then remove(machine.ids, 1) end
end

local function send(machine, texts)
  for _, event in ipairs(events_of(machine.chart, texts)) do
    rfsm.send_events(machine.fsm, event)
  end
  machine.moved_by = (machine.moved_by == "" and "" or machine.moved_by .. " ")
    .. concat(texts, " ")
end

-- Sends the events whose time has come. One that the chart does not know any more is
-- noted in the log.
local function send_later(lib, machine)
  local later = machine.later
  while later and later[1] and later[1][1] <= now() do
    local entry = remove(later, 1)
    local id, texts = entry[2], { select(3, unpack(entry)) }
    local ok, problem = pcall(send, machine, texts)
    add_id(lib, machine, id)
    if not ok then
      machine.notes = machine.notes or {}
      machine.notes[#machine.notes + 1] = "rfsm_send_at: " .. plain.reason(problem)
    end
  end
end

-- Save: first all that may fail, then the writes -----------------------------------

-- When a machine is to be woken; nil: not before an event comes.
local function due_of(machine, timers)
  if not machine.is_idle and machine.fsm._act_leaf then return now() end
  local due = nil
  if not timers then
    local left = timeevent.next_deadline(machine.fsm)
    due = left and now() + left or nil
  elseif next(timers) ~= nil then
    due = short.next_expiry(timers, now())
  end
  local later = machine.later and machine.later[1]
  if later then due = min(due or later[1], later[1]) end
  return due
end

-- Returns the value of a machine, and when it is due.
local function pack_machine(host, machine)
  local snap, timers = short.take(machine.chart)
  local due = due_of(machine, timers)
  local list = { "rfsm", machine.chart.name, snap or snapshot.take(machine.fsm) }
  local ids, later = machine.ids, machine.later
  later = later and later[1] and later or nil
  if due then
    list[4], list[5] = gettime()
    list[6] = due
  end
  if ids or later then
    for i = 4, 6 do list[i] = list[i] or false end
    list[7] = ids or false
    list[8] = later
  end
  local value = host.pack.pack(list)
  if #value > MAX_VALUE then
    fail("a machine takes at most %d bytes, this one %d", MAX_VALUE, #value)
  end
  return value, due
end

-- The writes of a machine, and what was asked in this call: one may wake many machines.
local writes, asked = {}, {}

-- Adds a write; its key must be of a type, or absent, and the user must have the right.
local function add_write(host, kind, name, key, ...)
  writes[#writes + 1] = { name, key, ... }
  if asked[key] == name then return end
  if not host.may(name, key, ...) then
    fail("no right to do %s %s", name, shown(key))
  end
  local found = kind and host.call("TYPE", key).ok
  if kind and found ~= kind and found ~= "none" then
    fail("%s expected at '%s', got %s", kind, shown(key), found)
  end
  asked[key] = name
end

local function add_due(host, machine, due)
  local key = keys_of.due(machine.key)
  if due then
    add_write(host, "zset", "ZADD", key, ("%.6f"):format(due), machine.key)
  elseif machine.is_due then
    add_write(host, "zset", "ZREM", key, machine.key)
  end
end

-- Streams: what is to be done outside, and what has failed.
local function add_streams(host, machine)
  for _, entry in ipairs(emitted) do
    add_write(host, "stream", "XADD", keys_of.out(machine.key), "*", "machine",
      machine.key, "what", entry[1], "data", entry[2])
  end
  for _, text in ipairs(printed) do
    add_write(host, "stream", "XADD", keys_of.log(machine.key), "MAXLEN", "~",
      MAX_LOG, "*", "error", text)
  end
end

-- What is to be noted when the machine has got another active leaf.
local function add_move(host, lib, machine, leaf)
  if lib.options.index then
    local key, name = keys_of.index(machine.key), machine.chart.name
    if machine.leaf then
      add_write(host, "zset", "ZREM", key,
        keys_of.member(name, machine.leaf, machine.key))
    end
    add_write(host, "zset", "ZADD", key, 0,
      keys_of.member(name, leaf, machine.key))
  end
  if lib.options.history then
    add_write(host, "stream", "XADD", keys_of.history(machine.key), "MAXLEN",
      lib.options.history, "*", "event", machine.moved_by, "from", machine.leaf or "",
      "to", leaf)
  end
  add_write(host, nil, "SPUBLISH", keys_of.channel(machine.key), leaf)
end

-- Writes all that has changed, and returns the reply: leaf, mode, errors.
local function save(host, lib, machine)
  local value, due = pack_machine(host, machine)
  local leaf = machine.fsm._act_leaf
  local reply = { leaf and leaf._fqn or "", leaf and leaf._mode or "inactive" }
  writes = {}
  add_due(host, machine, due)
  add_streams(host, machine)
  if reply[1] ~= (machine.leaf or "") then
    add_move(host, lib, machine, reply[1])
  end
  host.call("SET", machine.key, value)
  for i = 1, #writes do host.call(unpack(writes[i])) end
  for _, text in ipairs(printed) do reply[#reply + 1] = text end
  return reply
end

-- Functions ----------------------------------------------------------------------

local functions = {}

-- Gives a new machine the data that its chart keeps in the root.
local function set_data(host, fsm, text)
  if not text then return end
  if #text > MAX_DATA then
    fail("data: at most %d bytes expected, got %d", MAX_DATA, #text)
  end
  local ok, data = pcall(host.json.decode, text)
  if not ok or type(data) ~= "table" then fail("data: a JSON object expected") end
  data = plain.without_nulls(data)
  local is_kept = {}
  for _, name in ipairs(fsm.keep or {}) do is_kept[name] = true end
  for _, name in ipairs(rfsm.sorted_keys(data)) do
    if not is_kept[name] then
      fail("data: the root of the chart does not keep '%s'", tostring(name))
    end
    fsm[name] = data[name]
  end
end

-- The reply for an event that was applied before.
local function reply_of(list)
  local snap = list[3]
  return { snap.leaf or "", snap.leaf and (snap.done and "done" or "active")
    or "inactive" }
end

-- rfsm_create KEY chart [data] [ID id]: makes a machine and runs it.
function functions.rfsm_create(host, lib, keys, args)
  local key, id = key_of(keys), take_id(args)
  local versions = versions_of(lib.charts, args[1] or "")
  local chart = versions[#versions]
  local fsm = open(host, chart)
  if host.call("EXISTS", key) == 1 then
    local list = id and read_value(host, key)
    if list and has_id(list, id) then return reply_of(list) end
    fail("something is at '%s'", shown(key))
  end
  read_clock(host)
  local ok, problem = put(chart, chart.blank)
  if not ok then fail("%s", problem) end
  set_data(host, fsm, args[2])
  local machine = { key = key, chart = chart, fsm = fsm, leaf = false, is_due = false,
    ids = false, later = false, moved_by = "" }
  add_id(lib, machine, id)
  run(machine)
  return save(host, lib, machine)
end

-- rfsm_send KEY event... [ID id]: sends events to a machine and runs it.
function functions.rfsm_send(host, lib, keys, args)
  local key, id = key_of(keys), take_id(args)
  if not args[1] then fail("an event expected, got none") end
  local list = read_value(host, key)
  if id and has_id(list, id) then return reply_of(list) end
  local machine = load_machine(host, lib, key, list)
  send_later(lib, machine)
  send(machine, args)
  add_id(lib, machine, id)
  run(machine)
  return save(host, lib, machine)
end

-- rfsm_send_at KEY time event... ID id: sends events when a time has come.
function functions.rfsm_send_at(host, lib, keys, args)
  local key, id = key_of(keys), take_id(args)
  local text = remove(args, 1)
  if not (id and args[1]) then fail("a time, events and ID id expected") end
  local list = read_value(host, key)
  if has_id(list, id) then return reply_of(list) end
  local machine = load_machine(host, lib, key, list)
  read_clock(host)
  events_of(machine.chart, args)
  local later = machine.later or {}
  if #later >= MAX_LATER then fail("at most %d events may wait", MAX_LATER) end
  later[#later + 1] = { time_of(text, now()), id, unpack(args) }
  sort(later, function(a, b)
    if a[1] ~= b[1] then return a[1] < b[1] end
    return a[2] < b[2]
  end)
  machine.later = later
  send_later(lib, machine)
  run(machine)
  return save(host, lib, machine)
end

-- rfsm_cancel KEY id: takes back what rfsm_send_at has sent; returns whether it was.
function functions.rfsm_cancel(host, lib, keys, args)
  local key = key_of(keys)
  local list = read_value(host, key)
  for i, entry in ipairs(list[8] or {}) do
    if entry[2] == args[1] then
      local machine = load_machine(host, lib, key, list)
      remove(machine.later, i)
      run(machine)
      save(host, lib, machine)
      return 1
    end
  end
  return 0
end

local function tick(host, lib, key)
  local value = host.call("GET", key)
  if not value then
    host.call("ZREM", keys_of.due(key), key)
    return false
  end
  local machine = load_machine(host, lib, key, list_of(host, key, value))
  send_later(lib, machine)
  if machine.moved_by == "" then machine.moved_by = "(time)" end
  run(machine)
  return save(host, lib, machine)
end

-- rfsm_tick KEY: runs a machine, because it is due. One that is gone is due no more.
function functions.rfsm_tick(host, lib, keys)
  local key = key_of(keys)
  local reply = tick(host, lib, key)
  host.call("ZREM", keys_of.aside(key), key)
  return reply
end

-- Has a machine that cannot be run wait, so that others are not held up: for a minute,
-- counted, and noted in its log.
local function put_aside(host, due, key, problem)
  local text = "rfsm_wake: " .. plain.reason(problem)
  host.call("ZADD", due, ("%.6f"):format(now() + ASIDE), key)
  host.call("ZINCRBY", keys_of.aside(due), 1, key)
  pcall(host.call, "XADD", keys_of.log(key), "MAXLEN", "~", MAX_LOG, "*", "error", text)
end

local function is_elsewhere(problem)
  return plain.reason(problem):find("non local key", 1, true) ~= nil
end

-- rfsm_wake KEY [limit]: runs the machines that are due, of those that share the hash
-- tag of the key; returns how many ran, and how many could not.
function functions.rfsm_wake(host, lib, keys, args)
  local due, limit = keys_of.due(keys[1]), whole_of(args[1], 100, 10000)
  local aside = keys_of.aside(due)
  lib.time = host.call("TIME")
  read_clock(host, lib)
  local list = host.call("ZRANGEBYSCORE", due, "-inf", ("%.6f"):format(now()), "LIMIT",
    0, limit)
  if not list[1] then return { 0, 0 } end
  local has_aside, count, failed = host.call("EXISTS", aside) == 1, 0, 0
  for _, key in ipairs(list) do
    local ok, problem = pcall(tick, host, lib, key)
    read_clock(host, lib)
    if ok then
      count = count + 1
      if has_aside then host.call("ZREM", aside, key) end
    elseif not is_elsewhere(problem) then
      failed = failed + 1
      put_aside(host, due, key, problem)
    end
  end
  return { count, failed }
end

-- rfsm_due KEY [limit [seconds]]: the machines, of those that share the hash tag of the
-- key, that are due now, or at a time.
function functions.rfsm_due(host, _, keys, args)
  read_clock(host)
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
      data[prefix .. fqn:sub(5)] = plain.to_json(plain.unpack(fields, 0))
    end
  end
  add(snap, "root")
  for prefix, part in pairs(snap.regions or {}) do add(part, prefix) end -- any order
  return data
end

-- rfsm_get KEY: names and values.
function functions.rfsm_get(host, _, keys)
  local list = read_value(host, key_of(keys))
  local snap, names, queue = list[3], {}, {}
  local leaf = snap.leaf or ""
  for i, event in ipairs(snap.queue or {}) do queue[i] = plain.unpack(event, 0) end
  for i in leaf:gmatch("()%.") do names[#names + 1] = leaf:sub(1, i - 1) end
  names[#names + 1] = snap.leaf
  local due = list[6] and ("%.6f"):format(list[6]) or ""
  return { "chart", list[2], "version", snap.chart, "leaf", leaf,
    "mode", reply_of(list)[2],
    "configuration", concat(names, " "), "data", host.json.encode(data_of(snap)),
    "queue", queue[1] ~= nil and host.json.encode(queue) or "[]", "due", due }
end

-- rfsm_why KEY event: the answer of each transition, from the outermost state inwards.
function functions.rfsm_why(host, lib, keys, args)
  if #args ~= 1 then fail("one event expected, got %d", #args) end
  local machine, lines = load_machine(host, lib, key_of(keys)), {}
  local _, text = why.why(machine.fsm, events_of(machine.chart, args)[1])
  for line in text:gmatch("[^\n]+") do lines[#lines + 1] = line end
  return lines
end

-- Lists the members of the index from one text to another.
local function members(host, key, from, to, limit)
  return host.call("ZRANGEBYLEX", key, "[" .. from, "(" .. to, "LIMIT", 0, limit)
end

-- rfsm_find KEY chart state [limit]: the machines, of those that share the hash tag of
-- the key, whose active leaf is the state, or in it.
function functions.rfsm_find(host, lib, keys, args)
  if not lib.options.index then fail("the library was made without --index") end
  local key, limit = keys_of.index(keys[1]), whole_of(args[3], 100, 100000)
  if not args[2] then fail("a chart and a state expected") end
  local head, found = args[1] .. "\t" .. args[2], {}
  for _, mark in ipairs { "\t", "." } do -- the state itself, and those in it
    local list = members(host, key, head .. mark, head .. mark .. "\255",
      limit - #found)
    for _, member in ipairs(limit > #found and list or {}) do
      found[#found + 1] = member:match("^[^\t]*\t[^\t]*\t(.*)$")
    end
  end
  return found
end

-- rfsm_stats KEY: for the machines that share the hash tag of the key: chart, state and
-- number, and so on; then numbers of those that are due, put aside, and of entries.
function functions.rfsm_stats(host, lib, keys)
  local key, reply, at = keys_of.index(keys[1]), {}, ""
  while lib.options.index do
    local member = members(host, key, at, "\255", 1)[1]
    if not member then break end
    local head, name, leaf = member:match("^(([^\t]*)\t([^\t]*)\t)")
    at = head .. "\255"
    for _, value in ipairs { name, leaf, host.call("ZLEXCOUNT", key, "[" .. head,
      "(" .. at) } do
      reply[#reply + 1] = value
    end
  end
  return { reply, host.call("ZCARD", keys_of.due(keys[1])),
    host.call("ZCARD", keys_of.aside(keys[1])),
    host.call("XLEN", keys_of.out(keys[1])) }
end

-- rfsm_history KEY [count]: the latest moves of a machine, the newest first: time,
-- events, from, to, and so on.
function functions.rfsm_history(host, lib, keys, args)
  if not lib.options.history then fail("the library was made without --history") end
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

local function problem_of(failure)
  local text = type(failure) == "table" and (failure.text or failure.err)
    or text_of(failure)
  return (text:gsub(":\n%s*", ": "):gsub("[\r\n]+%s*", "; "))
end

--- Return the functions for Redis, by name, as it calls them.
---@param host rfsm.redis.Host
---@param list { name: string, make: function }[] later ones of a name are newer
---@param options? rfsm.redis.Options
---@return table<string, fun(keys: string[], args: string[]): any>
return function(host, list, options)
  local lib, made = { charts = {}, options = options or {}, time = nil }, {}
  local charts = lib.charts
  lib.options.ids = lib.options.ids or 16
  clock.set_hook(gettime)
  for _, chart in ipairs(list) do
    charts[chart.name] = charts[chart.name] or {}
    charts[chart.name][#charts[chart.name] + 1] = chart
  end
  for name, f in pairs(functions) do -- any order: each stands alone
    made[name] = function(keys, args)
      lib.time, asked = nil, {}
      local ok, reply = pcall(f, host, lib, keys, args)
      if ok then return reply end
      return host.error_reply("ERR " .. name .. ": " .. problem_of(reply))
    end
  end
  return made
end
