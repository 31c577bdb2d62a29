--- The functions that run inside Redis: each restores a machine, advances it and saves
-- it, in one piece.
--
-- `rfsm.redis` bundles this module with the core and the charts. Nothing is written
-- before all of a call has succeeded, so that an error changes nothing.
--
-- The value of a machine's key is a list in MessagePack: "rfsm", the name of the chart,
-- the snapshot, and, if timers run, when it was taken and when it is due.
--
-- The file reads in the order of a call: charts, arguments, load, run, save, functions.
--
-- @module rfsm.redis.functions
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local calls = require "rfsm.shared.calls"
local clock = require "rfsm.clock"
local alphabet = require "rfsm.shared.alphabet"
local plain = require "rfsm.snapshot.plain"
local rfsm = require "rfsm"
local snapshot = require "rfsm.snapshot"
local timeevent = require "rfsm_timeevent"
local why = require "rfsm.checks.why"
require "rfsm.await"

local error, getmetatable, ipairs, next = error, getmetatable, ipairs, next
local pairs, pcall, rawset = pairs, pcall, rawset
local tonumber, tostring, type = tonumber, tostring, type
local concat = table.concat
local fail, is_meta, text_of = plain.fail, rfsm.is_meta, rfsm.text_of

local MAX_EVENT, MAX_DATA, MAX_VALUE = 256, 65536, 1048576 -- bytes
local MAX_STEPS, MAX_LOG = 1000, 1000

--- What the functions use of Redis.
---@class rfsm.redis.Host
---@field call function redis.call
---@field error_reply function redis.error_reply
---@field json table cjson
---@field pack table cmsgpack

-- Charts: a machine of each version, which stands where a call wants it ------------

--- One version of a chart.
---@class rfsm.redis.Chart
---@field name string
---@field make fun(): rfsm.State
---@field fsm rfsm.Machine|nil made at the first call
---@field fingerprint string of its structure
---@field blank rfsm.snapshot.Snapshot of a new machine
---@field fields rfsm.redis.Field[] as they were at first
---@field added any[] element, name and so on of fields that were added since
---@field machines table<rfsm.Machine, table<any, true>> their fields at first
---@field events table<string, any> what it knows, by text
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

--- A field of an element as it was at first.
---@class rfsm.redis.Field
---@field obj table
---@field key any
---@field value any
---@field is_table boolean it is a plain table, which callbacks may change

-- Returns a value; a plain table as a copy.
local function copy_of(value)
  if type(value) ~= "table" or getmetatable(value) ~= nil then return value end
  local copy = {}
  for key, inner in pairs(value) do copy[key] = copy_of(inner) end -- any order: a copy
  return copy
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
      chart.fields[#chart.fields + 1] = { obj = obj, key = key, value = copy_of(value),
        is_table = type(value) == "table" and getmetatable(value) == nil }
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
  for i = 1, #fields do
    local field = fields[i]
    local obj, key, value = field.obj, field.key, field.value
    if field.is_table then value = copy_of(value) end
    if obj[key] ~= value then rawset(obj, key, value) end
  end
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
  chart.fields, chart.added, chart.machines = {}, {}, {}
  note_events(chart, fsm)
  for _, place in ipairs(rfsm.machines(fsm)) do
    for _, obj in ipairs(rfsm.elements(place.machine)) do watch(chart, obj) end
  end
  chart.fingerprint, chart.fsm = chart.blank.chart, fsm
  return fsm
end

-- Arguments ----------------------------------------------------------------------

-- Returns a name or a key for a message.
local function shown(text) return tostring(text):sub(1, 80) end

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

-- Returns the hash tag of a key: what stands in braces, or the whole key.
local function tag_of(key)
  local tag = key:match("{([^}]+)}") or not key:find("[{}]") and key
  if not tag or key:match("{([^}]*)}") == "" then
    fail("key '%s': a key without braces, or with a hash tag expected", shown(key))
  end
  return tag
end

local function due_key(key) return "rfsm:due:{" .. tag_of(key) .. "}" end

local function log_key(key)
  return (key:find("{", 1, true) and key or "{" .. key .. "}") .. ":log"
end

-- The key of the machine. A cluster has to know the others that are written, too.
local function key_of(keys)
  return keys[1] or fail("the key of a machine expected, got none")
end

-- Load: the value of a key becomes a machine that stands there ----------------------

-- The clock of the machines: it stands still during a call.
local sec, nsec = 0, 0

local function read_clock(host)
  local time = host.call("TIME")
  sec, nsec = tonumber(time[1]), tonumber(time[2]) * 1000
end

--- A machine that a call works on.
---@class rfsm.redis.Machine
---@field key string
---@field chart rfsm.redis.Chart
---@field fsm rfsm.Machine
---@field leaf string|false where it stood
---@field is_due boolean it was due some time

-- Returns what a key holds: name of the chart, snapshot, seconds, nanoseconds, due.
local function read_value(host, key)
  local value = host.call("GET", key)
  if not value then
    fail("no machine is at '%s' (rfsm_create makes one)", shown(key))
  end
  local ok, list = pcall(host.pack.unpack, value)
  if not ok or type(list) ~= "table" or list[1] ~= "rfsm" then
    fail("what is at '%s' is no machine", shown(key))
  end
  return list
end

local function put(chart, snap, options)
  clean(chart)
  return snapshot.put(chart.fsm, snap, options)
end

-- Has the newest version of a chart stand where the snapshot says, if it is of that
-- version or moves to it; else the version that it is of.
local function place(host, versions, snap)
  local newest = versions[#versions]
  local fsm, own = open(host, newest), nil
  if snap.chart == newest.fingerprint then return newest, put(newest, snap) end
  for _, chart in ipairs(versions) do
    open(host, chart)
    if snap.chart == chart.fingerprint then own = chart end
  end
  if fsm.migrate or fsm.rename or not own then
    local ok, problem = put(newest, snap, { migrate = fsm.migrate,
      rename = fsm.rename, old = own and snapshot.structure(own.fsm) })
    if ok or not own then return newest, ok, problem end
  end
  return own, put(own, snap)
end

local function load_machine(host, charts, key)
  local list = read_value(host, key)
  if list[4] then sec, nsec = list[4], list[5] else read_clock(host) end
  local chart, ok, problem = place(host, versions_of(charts, list[2]), list[3])
  if not ok then fail("the machine at '%s': %s", shown(key), problem) end
  if list[4] then read_clock(host) end
  local fsm = chart.fsm
  return { key = key, chart = chart, fsm = fsm, leaf = rfsm.get_actleaf_fqn(fsm),
    is_due = list[6] ~= nil }
end

-- Run and save -------------------------------------------------------------------

-- Runs a machine until it is idle; one that never is goes on when it is due. If it is
-- cut short the chart is left without a machine, and gets a new one.
local function run(machine)
  emitted, printed, machine.chart.fsm = {}, {}, nil
  machine.is_idle = rfsm.step(machine.fsm, MAX_STEPS)
  machine.chart.fsm = machine.fsm
end

-- When a machine is to be woken; nil: not before an event comes.
local function due_of(machine)
  if not machine.is_idle and machine.fsm._act_leaf then return sec + nsec / 1e9 end
  local left = timeevent.next_deadline(machine.fsm)
  return left and sec + nsec / 1e9 + left
end

local function pack_machine(host, machine, due)
  local snap = snapshot.take(machine.fsm)
  local list = { "rfsm", machine.chart.name, snap }
  if due then list[4], list[5], list[6] = sec, nsec, due end
  local value = host.pack.pack(list)
  if #value > MAX_VALUE then
    fail("a machine takes at most %d bytes, this one %d", MAX_VALUE, #value)
  end
  return value
end

local function write_due(host, machine, due)
  local key = due_key(machine.key)
  if due then
    host.call("ZADD", key, ("%.6f"):format(due), machine.key)
  elseif machine.is_due then
    host.call("ZREM", key, machine.key)
  end
end

-- Streams: what is to be done outside, and what has failed.
local function write_streams(host, machine)
  for _, entry in ipairs(emitted) do
    host.call("XADD", "rfsm:out:{" .. tag_of(machine.key) .. "}", "*", "machine",
      machine.key, "what", entry[1], "data", entry[2])
  end
  for _, text in ipairs(printed) do
    host.call("XADD", log_key(machine.key), "MAXLEN", "~", MAX_LOG, "*", "error", text)
  end
end

-- Writes all that has changed, and returns the reply: leaf, mode, errors.
local function save(host, machine)
  local due = due_of(machine)
  local value = pack_machine(host, machine, due)
  local leaf = machine.fsm._act_leaf
  local reply = { leaf and leaf._fqn or "", leaf and leaf._mode or "inactive" }
  host.call("SET", machine.key, value)
  write_due(host, machine, due)
  write_streams(host, machine)
  if reply[1] ~= machine.leaf then
    local channel = "rfsm:{" .. tag_of(machine.key) .. "}:" .. machine.key
    host.call("SPUBLISH", channel, reply[1])
  end
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
  local is_kept = {}
  for _, name in ipairs(fsm.keep or {}) do is_kept[name] = true end
  for _, name in ipairs(rfsm.sorted_keys(data)) do
    if not is_kept[name] then
      fail("data: the root of the chart does not keep '%s'", tostring(name))
    end
    fsm[name] = data[name]
  end
end

-- rfsm_create KEY chart [data]: makes a machine and runs it.
function functions.rfsm_create(host, charts, keys, args)
  local key, versions = key_of(keys), versions_of(charts, args[1] or "")
  local chart = versions[#versions]
  local fsm = open(host, chart)
  tag_of(key)
  if host.call("EXISTS", key) == 1 then fail("something is at '%s'", shown(key)) end
  read_clock(host)
  local ok, problem = put(chart, chart.blank)
  if not ok then fail("%s", problem) end
  set_data(host, fsm, args[2])
  local machine = { key = key, chart = chart, fsm = fsm, leaf = false, is_due = false }
  run(machine)
  return save(host, machine)
end

-- rfsm_send KEY event...: sends events to a machine and runs it.
function functions.rfsm_send(host, charts, keys, args)
  local key = key_of(keys)
  if not args[1] then fail("an event expected, got none") end
  local machine = load_machine(host, charts, key)
  for _, event in ipairs(events_of(machine.chart, args)) do
    rfsm.send_events(machine.fsm, event)
  end
  run(machine)
  return save(host, machine)
end

-- rfsm_tick KEY: runs a machine, because it is due. One that is gone is due no more.
function functions.rfsm_tick(host, charts, keys)
  local key = key_of(keys)
  if host.call("EXISTS", key) == 0 then
    host.call("ZREM", due_key(key), key)
    return false
  end
  local machine = load_machine(host, charts, key)
  run(machine)
  return save(host, machine)
end

-- rfsm_due KEY [limit [seconds]]: the machines, of those that share the hash tag of the
-- key, that are due now, or at a time.
function functions.rfsm_due(host, _, keys, args)
  read_clock(host)
  local limit, at = tonumber(args[1] or 100), tonumber(args[2] or sec + nsec / 1e9)
  if not limit or not at then fail("a number expected") end
  return host.call("ZRANGEBYSCORE", due_key(key_of(keys)), "-inf", ("%.6f"):format(at),
    "LIMIT", 0, limit)
end

-- rfsm_get KEY: names and values.
function functions.rfsm_get(host, _, keys)
  local list = read_value(host, key_of(keys))
  local snap, names = list[3], {}
  local leaf = snap.leaf or ""
  for i in leaf:gmatch("()%.") do names[#names + 1] = leaf:sub(1, i - 1) end
  names[#names + 1] = snap.leaf
  local due = list[6] and ("%.6f"):format(list[6]) or ""
  return { "chart", list[2], "version", snap.chart, "leaf", leaf,
    "mode", snap.leaf and (snap.done and "done" or "active") or "inactive",
    "configuration", concat(names, " "), "data", host.json.encode(snap.data or {}),
    "queue", snap.queue and host.json.encode(snap.queue) or "[]", "due", due }
end

-- rfsm_why KEY event: the answer of each transition, from the outermost state inwards.
function functions.rfsm_why(host, charts, keys, args)
  if #args ~= 1 then fail("one event expected, got %d", #args) end
  local machine, lines = load_machine(host, charts, key_of(keys)), {}
  local _, text = why.why(machine.fsm, events_of(machine.chart, args)[1])
  for line in text:gmatch("[^\n]+") do lines[#lines + 1] = line end
  return lines
end

--- Return the functions for Redis, by name, as it calls them.
---@param host rfsm.redis.Host
---@param list { name: string, make: function }[] later ones of a name are newer
---@return table<string, fun(keys: string[], args: string[]): any>
return function(host, list)
  local charts, made = {}, {}
  clock.set_hook(function() return sec, nsec end)
  for _, chart in ipairs(list) do
    charts[chart.name] = charts[chart.name] or {}
    charts[chart.name][#charts[chart.name] + 1] = chart
  end
  for name, f in pairs(functions) do -- any order: each stands alone
    made[name] = function(keys, args)
      local ok, reply = pcall(f, host, charts, keys, args)
      if ok then return reply end
      reply = type(reply) == "table" and (reply.text or reply.err) or text_of(reply)
      reply = reply:gsub(":\n%s*", ": "):gsub("[\r\n]+%s*", "; ")
      return host.error_reply("ERR " .. name .. ": " .. reply)
    end
  end
  return made
end
