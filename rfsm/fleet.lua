--- A fleet of machines in Redis: the client.
--
-- The machines live in a server that has loaded a library of `rfsm.redis`. The client
-- chooses their keys, so that machines spread over the slots of a cluster. It gives
-- each event an id, so that the event is applied once even if it is sent again. It runs
-- machines whose timers are due, and reads the events that machines have emitted. Needs
-- the packages lua-redis and dkjson.
--
-- The file reads in this order: connect, calls, machines, workers. The methods that the
-- clients of all servers share are in `rfsm.server.client`.
--
-- @module rfsm.fleet
-- @license BSD-3-Clause

local try = require("rfsm.shared.calls").try
local Client = require "rfsm.server.client"
local connection = require "rfsm.redis.connection"
local codec = require "rfsm.server.codec"
local keys_of = require "rfsm.server.keys"
local opts = require "rfsm.shared.options"
local order = require "rfsm.shared.order"
local rfsm = require "rfsm"

local error, ipairs, pcall = error, ipairs, try
local pairs, rawget, rawset = pairs, rawget, rawset
local setmetatable, type = setmetatable, type
local concat, sort = table.concat, table.sort
local max, min = math.max, math.min
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local fleet = {}

-- Connect ------------------------------------------------------------------------

--- A connection to a fleet.
---@class rfsm.fleet.Fleet : rfsm.server.Client
---@field name string the keys of the machines begin with this name
---@field tags integer number of hash tags, the parts of keys that choose the node
---@field more_tags? string[] those of other clients, see `find_tags`
---@field connection rfsm.redis.Connection
---@field trimmed table<string, true> hash tags whose stream has no entry that is done
local Fleet = { where = "rfsm.fleet" }
Fleet.__index = Fleet
for name, f in pairs(Client) do Fleet[name] = f end -- any order: it copies

local function is_positive(x) return type(x) == "number" and x > 0 end

local OPTIONS = {
  name = { "text", opts.is_text, "machine" },
  tags = opts.whole(1, 16384, 64),
  timeout = { "seconds above 0", is_positive, 5 },
  patience = { "seconds", opts.is_seconds, 10 },
  tls = { "table", opts.is_a "table" },
}

--- Connect to a server, or to any node of a cluster.
--
-- @usage
--    local robots = fleet.connect("redis://localhost:6379", { name = "robot" })
--
-- @raise if there is no server
---@param url? string|string[] redis[s]://[USER:PASSWORD@]HOST[:PORT][/DB], default
--- redis://127.0.0.1:6379; in a list, a later URL is tried if the earlier ones fail
---@param options? table `name` ("machine"), `tags` (64), `timeout`: seconds for a call
--- (5), `patience`: seconds while no server answers (10), `tls`: parameters of luasec
---@return rfsm.fleet.Fleet fleet
function fleet.connect(url, options)
  local settings = opts.take("rfsm.fleet.connect", OPTIONS, options)
  local ok, made = pcall(connection.connect, url or "redis://127.0.0.1", settings)
  if not ok then
    error(made, made:find("^rfsm.fleet.connect") and 2 or 0)
  end
  return setmetatable({ name = settings.name, tags = settings.tags, connection = made,
    id = Fleet.new_id(), count = 0, trimmed = {} }, Fleet)
end

--- Send a command to the node that has the keys of a hash tag. The command may arrive
-- twice, if the connection was lost before the reply came.
-- @raise the error that the server returns
---@param tag string
---@param name string
---@param ... any
---@return any reply
function Fleet:call(tag, name, ...) return self.connection:call(tag, name, ...) end

-- Turns a list { name, value, name, value, ... } into a table of values by name.
local function fields_of(list)
  local fields = {}
  for i = 1, #list, 2 do fields[list[i]] = list[i + 1] end
  return fields
end

-- Turns a list of values into a list of tables, in each of which the next values have
-- these names. Returns nil and the problem if there is no list.
local function rows_of(names, list, problem)
  if not list then return nil, problem end
  local rows = {}
  for i = 1, #list, #names do
    local row = {}
    for k, name in ipairs(names) do row[name] = list[i + k - 1] end
    row.time = rfsm.number_of(row.time)
    rows[#rows + 1] = row
  end
  return rows
end

-- Calls: keys and replies ---------------------------------------------------------

--- Return a machine's key in Redis. An id with a hash tag in braces is already a key.
---@param id any
---@return string key
---@return string tag
function Fleet:key_of(id)
  if id == nil or type(id) == "table" then
    error("rfsm.fleet: id of a machine expected, got " .. type(id), 2)
  end
  id = rfsm.text_of(id)
  local tag, hash = id:match("{([^}]+)}"), 7
  if tag then return id, tag end
  for i = 1, #id do hash = (hash * 31 + id:byte(i)) % 16777213 end
  tag = ("%d"):format(hash % self.tags)
  return self.name .. ":{" .. tag .. "}:" .. id, tag
end

--- Call a function of the loaded library for a machine. The command lists all keys that
-- the function may write, because a cluster requires that.
---@param name string
---@param id any
---@param ... any
---@return any? reply
---@return string? problem
function Fleet:ask(name, id, ...)
  local key, tag = self:key_of(id)
  local ok, reply = pcall(self.call, self, tag, "FCALL", name, 7, key,
    keys_of.due(key), keys_of.out(key), keys_of.log(key), keys_of.index(key),
    keys_of.history(key), keys_of.since(key), ...)
  if ok then return reply or nil, not reply and "no machine" or nil end
  return nil, reply
end

-- Machines -----------------------------------------------------------------------

--- Return the latest moves of a machine, the newest first. Return a problem if the
-- library that Redis has loaded was made without `--history`.
---@param id any
---@param count? integer default 10
---@return { time: number, event: string, from: string, to: string }[]? moves
---@return string? problem
function Fleet:history(id, count)
  return rows_of({ "time", "event", "from", "to" },
    self:ask("rfsm_history", id, count or 10))
end

--- Return the latest errors of a machine, the newest first.
---@param id any
---@param count? integer default 10
---@return { time: number, error: string }[]? lines
---@return string? problem
function Fleet:log(id, count)
  return rows_of({ "time", "error" }, self:ask("rfsm_log", id, count or 10))
end

--- Call `f(leaf)` each time the active leaf of a machine changes, until `f` returns
-- true. The method returns only then.
---@param id any
---@param f fun(leaf: string): boolean?
function Fleet:watch(id, f)
  local key, tag = self:key_of(id)
  self:call(tag, "EXISTS", key) -- finds the node that has the tag
  self.connection:subscribe(tag, keys_of.channel(key), f)
end

-- Workers ------------------------------------------------------------------------

local function all_tags(self)
  local tags = {}
  for i = 1, self.tags do tags[i] = ("%d"):format(i - 1) end
  for _, tag in ipairs(self.more_tags or {}) do tags[#tags + 1] = tag end
  return tags
end

-- Calls `f(tag)` once for each hash tag in the keys of a server.
local function scan_tags(call, f)
  local at, is_known = "0", {}
  repeat
    local reply = call("SCAN", at, "MATCH", "rfsm:*:{*}", "COUNT", 1000)
    at = reply[1]
    for _, key in ipairs(reply[2]) do
      local tag = key:match("{(.*)}$")
      if not is_known[tag] then f(tag) end
      is_known[tag] = true
    end
  until at == "0"
end

--- Look for the hash tags that the keys of other clients have. `find`, `due`, `dead`,
-- `wake`, `work` and `take` ask these, too, from now on. All keys of the server are
-- scanned once.
-- @raise the error that a server returns
---@return string[] more those that are not the client's
function Fleet:find_tags()
  local found = {}
  self.connection:each_master(function(call)
    scan_tags(call, function(tag) found[tag] = true end)
  end)
  self.more_tags = nil
  for _, tag in ipairs(all_tags(self)) do found[tag] = nil end
  self.more_tags = rfsm.sorted_keys(found)
  return self.more_tags
end

-- Returns a call of a function of the loaded library for a hash tag. `keys` lists
-- functions of `rfsm.server.keys`; each makes one key of the call.
local function call_of(name, keys, tag, ...)
  local call = { "FCALL", name, #keys }
  for _, of in ipairs(keys) do call[#call + 1] = of("{" .. tag .. "}") end
  for _, value in ipairs { ... } do call[#call + 1] = value end
  return call
end

-- Calls a function of the loaded library for each hash tag of a list, in parallel.
-- Returns the replies.
local function call_tags(self, tags, name, keys, ...)
  local calls = {}
  for i, tag in ipairs(tags) do calls[i] = call_of(name, keys, tag, ...) end
  return self.connection:call_all(tags, calls)
end

-- The keys of a call of rfsm_wake.
local WAKE = { keys_of.due, keys_of.out, keys_of.aside, keys_of.lease }

-- Calls rfsm_wake for each hash tag in a list, in which a tag may come again. Adds
-- to the counts; returns a table hash tag -> how many machines are still due.
local function wake_tags(self, tags, limit, counts)
  local left = {}
  for i, reply in ipairs(call_tags(self, tags, "rfsm_wake", WAKE, limit)) do
    counts.woken, counts.failed = counts.woken + reply[1], counts.failed + reply[2]
    counts[tags[i]] = (counts[tags[i]] or 0) + reply[1] + reply[2]
    left[tags[i]] = reply[3] or 0 -- an older library has run all of them
  end
  return left
end

-- Calls rfsm_wake for each hash tag, and then for each machine that is still due.
local function wake_all(self, limit, counts)
  local more = {}
  local left = wake_tags(self, all_tags(self), limit, counts)
  for _, tag in ipairs(all_tags(self)) do
    for _ = 1, min(left[tag], limit - counts[tag]) do more[#more + 1] = tag end
  end
  wake_tags(self, more, limit, counts)
end

--- Run the machines whose timers are due. Each call for a machine leases the next, so
-- that a machine that comes to no end does not hold up the others. A failed machine is
-- put aside for a minute.
---@param limit? integer greatest number of machines for each hash tag (100)
---@return integer count machines that ran
---@return integer failed machines that were put aside
---@return string? problem the server is busy, or has no memory: the machines wait
function Fleet:wake(limit)
  local counts = { woken = 0, failed = 0 }
  local ok, problem = pcall(wake_all, self, limit or 100, counts)
  if not ok and not connection.has_to_wait(problem) then error(problem, 0) end
  return counts.woken, counts.failed, problem
end

-- Calls a function for each hash tag; returns the first keys of all replies, at most
-- `limit`, or nil and the problem.
local function joined(self, limit, name, keys, ...)
  local ok, replies = pcall(call_tags, self, all_tags(self), name, keys, ...)
  if not ok then return nil, replies end
  local found = {}
  for _, reply in ipairs(replies) do
    for _, key in ipairs(reply) do
      found[#found + 1] = #found < limit and key or nil
    end
  end
  return found
end

--- Return the keys of machines in a state. The library must be made with `--index`.
---@param chart string
---@param state string FQN of a leaf or composite
---@param limit? integer default 100
---@param seconds? integer return only machines that are in their leaf for so long
---@return string[]? keys
---@return string? problem
function Fleet:find(chart, state, limit, seconds)
  return joined(self, limit or 100, "rfsm_find", { keys_of.index, keys_of.since },
    chart, state, limit or 100, seconds)
end

--- Return the keys of machines that are due.
---@param limit? integer default 100
---@param time? number seconds; default: now
---@return string[]? keys
---@return string? problem
function Fleet:due(limit, time)
  return joined(self, limit or 100, "rfsm_due", { keys_of.due }, limit or 100, time)
end

-- Calls f(call, keys) for the keys of a server that may be machines, in groups with the
-- same hash tag, or for those that match a pattern. call(name, ...) sends a command
-- to the server.
local function each_group(self, f, pattern)
  local seen = {} -- SCAN may list a key twice
  self.connection:each_master(function(call)
    local at = "0"
    repeat
      local reply = call("SCAN", at, "COUNT", 1000, "TYPE", "string",
        "MATCH", pattern or "*")
      at = reply[1]
      local groups = {}
      for _, key in ipairs(reply[2]) do
        if not seen[key] and pcall(keys_of.machine, { key }) then
          order.append(groups, keys_of.tag(key), key)
          seen[key] = true
        end
      end
      for _, tag in ipairs(rfsm.sorted_keys(groups)) do f(call, groups[tag]) end
    until at == "0"
  end)
end

--- Put all machines into the index as they are, also those that have moved while the
-- library was loaded without `--index`.
---@return integer? count machines
---@return string? problem
function Fleet:reindex()
  local count = 0
  local ok, problem = pcall(each_group, self, function(call, keys)
    count = count + call("FCALL", "rfsm_reindex", #keys, unpack(keys))
  end)
  return ok and count or nil, not ok and problem or nil
end

--- Count the machines of each version of each chart.
---@return { chart: string, known: string, version: string, count: integer }[]? list
--- `known` is "newest", "bundled" (in the library), "gone", or "broken": overwritten by
--- another program
---@return string? problem
function Fleet:versions()
  local counts, list = {}, {}
  local ok, problem = pcall(each_group, self, function(call, keys)
    local reply = call("FCALL", "rfsm_versions", #keys, unpack(keys))
    for i = 1, #reply, 4 do
      local name = concat(reply, "\t", i, i + 2)
      counts[name] = (counts[name] or 0) + reply[i + 3]
    end
  end)
  if not ok then return nil, problem end
  for i, name in ipairs(rfsm.sorted_keys(counts)) do
    local chart, known, version = name:match("^(.-)\t(.-)\t(.*)$")
    list[i] = { chart = chart, known = known, version = version, count = counts[name] }
  end
  return list
end

--- Return the states of each chart in the library, of all its versions.
---@return table<string, string[]>? charts the name of a chart -> FQNs of its states
---@return string? problem
function Fleet:charts()
  local list, problem = self:ask("rfsm_charts", "{0}")
  if not list then return nil, problem end
  local charts = {}
  for i = 1, #list, 2 do
    order.append(charts, list[i], list[i + 1])
  end
  return charts
end

--- What a machine has to be, for `select`. An absent field stands for any.
---@class rfsm.fleet.Filter
---@field chart? string
---@field state? string FQN of its leaf, or of a state around it
---@field version? string "newest", "bundled", "gone", "broken", or a fingerprint
---@field age? integer seconds in its leaf, at least; the library needs `--index`
---@field held? string "yes" or "no"
---@field key? string its key, or a pattern of Redis, such as m:{7}:*
---@field reason? string why it is held

--- A machine that `select` has found.
---@class rfsm.fleet.Found
---@field key string
---@field chart string
---@field leaf string
---@field known string of which version it is: "newest", "bundled", "gone", "broken"
---@field seconds? integer how long it has been in its leaf
---@field held boolean
---@field reason? string why it is held

local FOUND = { "key", "chart", "leaf", "known", "seconds", "held" }

-- Adds what rfsm_select has found among keys. If the first is gone meanwhile, the reply
-- has all machines of its hash tag.
local function add_found(found, reply, keys, reason)
  for _, one in ipairs(rows_of(FOUND, reply)) do
    one.seconds, one.reason = rfsm.number_of(one.seconds), one.held:match "^yes: (.*)$"
    one.held = one.held ~= ""
    if keys[one.key] and (not reason or reason == one.reason) then
      found[#found + 1] = one
    end
  end
end

local function by_key(a, b) return rfsm.text_before(a.key, b.key) end

--- Return the machines that a filter lets through, in the order of their keys. All
-- machines of the server are read for it.
---@param filter rfsm.fleet.Filter
---@return rfsm.fleet.Found[]? found
---@return string? problem
function Fleet:select(filter)
  local found = {}
  local ok, problem = pcall(each_group, self, function(call, keys)
    local command, asked = { "FCALL", "rfsm_select", #keys }, {}
    for _, key in ipairs(keys) do command[#command + 1], asked[key] = key, true end
    for _, name in ipairs { "chart", "state", "version", "age", "held" } do
      command[#command + 1] = filter[name] or ""
    end
    add_found(found, call(unpack(command)), asked, filter.reason)
  end, filter.key)
  if not ok then return nil, problem end
  sort(found, by_key)
  return found
end

-- Messages ------------------------------------------------------------------------

--- The work of one worker on one hash tag: it reads the stream of emitted events.
---@class rfsm.fleet.Work
---@field fleet rfsm.fleet.Fleet
---@field tag string
---@field stream string
---@field group string
---@field worker string the name of the worker
---@field options table the options of `Fleet:work`
---@field count integer number of entries that were handled
---@field failures string[]

-- Sends a command for the stream of a worker.
local function ask_stream(work, name, ...)
  return work.fleet:call(work.tag, name, work.stream, ...)
end

-- For each entry that a worker has: `work`, the `raw` entry, the connection by which it
-- came, its `deliveries`. Entries are plain tables, which callbacks may print.
local taken = setmetatable({}, { __mode = "k" })

-- Returns an entry as workers get it. Its id is unique among all groups and streams, so
-- that the worker may send an event with this id. An entry that was dead and is sent
-- again has the id that it had at first.
local function entry_of(work, raw, client, deliveries)
  local fields = fields_of(raw[2])
  local entry = { machine = fields.machine, what = fields.what,
    id = concat({ work.group, work.tag, fields.id or raw[1] }, ":"),
    data = fields.data and fields.data ~= "" and codec.decode(fields.data) or nil }
  taken[entry] = { work = work, raw = raw, client = client, fields = fields,
    deliveries = deliveries }
  return entry
end

-- Sends a command about an entry by the connection by which the entry came. After a
-- failover the answer to the entry may be lost, so the entry has to come again.
local function ask_by(own, name, stream, ...)
  return own.work.fleet.connection:call_by(own.client, name, stream, ...)
end

-- The stream has to be trimmed, too.
local function acknowledge(own)
  own.work.fleet.trimmed[own.work.tag] = nil
  return (ask_by(own, "XACK", own.work.stream, own.work.group, own.raw[1]))
end

-- Moves an entry that has failed too often to the stream of dead entries.
local function bury(own, problem)
  local work, fields = own.work, own.fields
  local dead = keys_of.dead("{" .. work.tag .. "}")
  local is_there = ask_by(own, "XADD", dead, "*", "machine", fields.machine, "what",
    fields.what, "data", fields.data, "group", work.group, "id",
    fields.id or own.raw[1], "deliveries", min(own.deliveries, work.options.tries),
    "error", problem)
  return is_there and acknowledge(own)
end

local function own_of(self, entry, where)
  local own = taken[entry]
  if own and own.work.fleet == self then return own end
  error("rfsm.fleet." .. where .. ": an entry of take expected, " .. opts.got(entry), 3)
end

--- An entry is done: its group does not get it again.
---@param entry rfsm.fleet.Entry
---@return boolean was_there false: the connection by which the entry came is lost, so
--- the entry comes again
function Fleet:done(entry)
  return acknowledge(own_of(self, entry, "done"))
end

--- The try has failed: the entry comes again later, or, after the last try, moves to
-- the stream of dead entries.
---@param entry rfsm.fleet.Entry
---@param reason string
---@return boolean is_dead was it the last try?
function Fleet:fail(entry, reason)
  local own = own_of(self, entry, "fail")
  return own.deliveries >= own.work.options.tries and bury(own, rfsm.text_of(reason))
end

-- Calls f with an entry that has a try left and is for this group.
local function hand_on(work, f, raw, client, deliveries)
  local entry = entry_of(work, raw, client, deliveries)
  local own = taken[entry]
  if own.fields.group and own.fields.group ~= work.group then
    acknowledge(own)
  elseif deliveries > work.options.tries then
    work.failures[#work.failures + 1] = "no worker has finished it"
    bury(own, "no worker has finished it")
  else
    f(entry)
  end
end

-- Makes a group that gets all entries of the stream, unless another worker has made it.
local function make_group(work)
  local ok, reply = pcall(work.fleet.call, work.fleet, work.tag, "XGROUP", "CREATE",
    work.stream, work.group, "0", "MKSTREAM")
  if not ok and not reply:find("^BUSYGROUP") then error(reply, 0) end -- it exists
end

-- Lists the entries that workers of the group got at least `idle` milliseconds ago, and
-- have not finished.
local function pending(work)
  local ok, reply = pcall(ask_stream, work, "XPENDING", work.group, "IDLE",
    work.options.idle, "-", "+", work.options.count)
  if ok then return reply end
  if not reply:find("^NOGROUP") then error(reply, 0) end
  make_group(work)
  return {}
end

-- Hands on pending entries again, each after a wait that doubles with each try.
local function retry(work, f)
  for _, entry in ipairs(pending(work)) do
    local id, idle, deliveries = entry[1], entry[3], entry[4]
    local wait = work.options.idle * 2 ^ (deliveries - 1)
    if idle >= wait then
      local claimed, client = ask_stream(work, "XCLAIM", work.group, work.worker,
        ("%d"):format(wait), id)
      for _, raw in ipairs(claimed) do
        hand_on(work, f, raw, client, deliveries + 1)
      end
    end
  end
end

-- Pads the numbers in the id of an entry with zeros, so that ids compare as texts.
local function sortable(id)
  return (id:gsub("%d+", function(digits) return ("0"):rep(20 - #digits) .. digits end))
end

local function next_id(id)
  return (id:gsub("%d+$", function(digits) return ("%.0f"):format(digits + 1) end))
end

-- Removes from the stream the entries that all groups have finished, unless this was
-- done since one was last acknowledged.
local function trim(work)
  local least, trimmed = nil, work.fleet.trimmed
  if trimmed[work.tag] then return end
  for _, info in ipairs(work.fleet:call(work.tag, "XINFO", "GROUPS", work.stream)) do
    local group = fields_of(info)
    local id = group.pending > 0 and ask_stream(work, "XPENDING", group.name)[2]
      or next_id(group["last-delivered-id"])
    if not least or sortable(id) < sortable(least) then least = id end
  end
  if least then ask_stream(work, "XTRIM", "MINID", least) end
  trimmed[work.tag] = true
end

-- Calls f with each entry of a stream that a worker may try now.
local function each_entry(work, f)
  retry(work, f)
  trim(work)
  local new, client = work.fleet:call(work.tag, "XREADGROUP", "GROUP", work.group,
    work.worker, "COUNT", work.options.count, "STREAMS", work.stream, ">")
  for _, raw in ipairs(new and new[1][2] or {}) do hand_on(work, f, raw, client, 1) end
end

local WORK = {
  count = opts.whole(1, 1e6, 100),
  idle = { "milliseconds", opts.is_seconds, 30000 },
  tries = opts.whole(1, 1000, 5),
}

-- Returns a list with the work of a worker on each hash tag.
local function works_of(self, where, group, worker, options)
  local settings = opts.take("rfsm.fleet." .. where, WORK, options, 4)
  if type(group) ~= "string" or type(worker) ~= "string" then
    error(("rfsm.fleet.%s: names of a group and of a worker expected, got %s and %s")
      :format(where, rfsm.text_of(group), rfsm.text_of(worker)), 3)
  end
  local works, failures = {}, {}
  for i, tag in ipairs(all_tags(self)) do
    works[i] = { fleet = self, tag = tag, stream = keys_of.out("{" .. tag .. "}"),
      group = group, worker = worker, options = settings, count = 0,
      failures = failures }
  end
  return works, failures
end

--- An event that a machine has emitted.
---@class rfsm.fleet.Entry
---@field id string for `answer` and `send_once`
---@field machine string its key
---@field what string
---@field data any

--- Take entries, each of which the caller ends by `done` or `fail`. Other workers of
-- the group do not get them meanwhile, see `work`.
---@param group string
---@param worker string a name that no other worker of the group has
---@param options? { count: integer?, idle: integer?, tries: integer? } as for `work`
---@return rfsm.fleet.Entry[] entries
---@return string[] failures a text for each entry that is dead now
function Fleet:take(group, worker, options)
  local works, failures = works_of(self, "take", group, worker, options)
  local entries = {}
  for _, work in ipairs(works) do
    each_entry(work, function(entry) entries[#entries + 1] = entry end)
  end
  return entries, failures
end

-- Does what a worker can do now on one hash tag, and removes what all groups have done.
local function run_worker(work, f)
  local failures = work.failures
  each_entry(work, function(entry)
    local ok, problem = pcall(f, entry)
    if not ok then
      failures[#failures + 1] = rfsm.text_of(problem)
      work.fleet:fail(entry, problem)
    elseif work.fleet:done(entry) then
      work.count = work.count + 1
    end
  end)
  trim(work)
end

--- Call `f(entry)` for each event that machines have emitted, at least once in a group.
--
-- An entry has `machine`, `what`, `data`, and an `id` for `answer`. If `f` raises an
-- error, or the worker dies, a worker of the group gets the entry again: after `idle`
-- milliseconds, then after twice as long, and so on. After `tries` calls it moves to
-- the stream rfsm:dead:{tag}. An entry that all groups have finished leaves its stream.
-- While a server is busy or has no memory, its entries wait.
--
---@param group string
---@param worker string a name that no other worker of the group has
---@param f fun(entry: rfsm.fleet.Entry)
---@param options? { count: integer?, idle: integer?, tries: integer? } by default
-- `count` is 100, `idle` is 30000, and `tries` is 5
---@return integer count entries that were handled
---@return string[] failures errors of `f`, and a text for each entry never finished
function Fleet:work(group, worker, f, options)
  local works, failures = works_of(self, "work", group, worker, options)
  local total = 0
  for _, work in ipairs(works) do
    local ok, problem = pcall(run_worker, work, f)
    if not ok and not connection.has_to_wait(problem) then error(problem, 0) end
    if not ok then failures[#failures + 1] = problem end
    total = total + work.count
  end
  return total, failures
end

-- Dead entries ---------------------------------------------------------------------

--- An entry that failed too often.
---@class rfsm.fleet.Dead
---@field tag string
---@field id string
---@field machine string
---@field what string the emitted event
---@field data string the event's data, in JSON
---@field deliveries string how often a worker got the entry
---@field error string the error of the last try
---@field group string the group in which the entry failed

--- Return dead entries, the oldest of each hash tag first.
---@param limit? integer greatest number of entries for each hash tag (100)
---@return rfsm.fleet.Dead[] entries
function Fleet:dead(limit)
  local entries = {}
  for _, tag in ipairs(all_tags(self)) do
    for _, raw in ipairs(self:call(tag, "XRANGE", keys_of.dead("{" .. tag .. "}"), "-",
      "+", "COUNT", limit or 100)) do
      local entry = fields_of(raw[2])
      entry.tag, entry.id = tag, raw[1]
      entries[#entries + 1] = entry
    end
  end
  return entries
end

--- Drop a dead entry.
---@param tag string
---@param id string
---@return boolean was_there
function Fleet:drop(tag, id)
  return self:call(tag, "XDEL", keys_of.dead("{" .. rfsm.text_of(tag) .. "}"), id) == 1
end

--- Put a dead entry back into its stream, for the group in which it has failed. It
-- keeps its id, so that an answer which was sent before it failed counts once.
---@param tag string
---@param id string
---@return boolean was_there
function Fleet:again(tag, id)
  local key = "{" .. rfsm.text_of(tag) .. "}"
  local raw = self:call(tag, "XRANGE", keys_of.dead(key), id, id)[1]
  if not raw then return false end
  local entry = fields_of(raw[2])
  self:call(tag, "XADD", keys_of.out(key), "*", "machine", entry.machine, "what",
    entry.what, "data", entry.data, "group", entry.group, "id", entry.id)
  return self:drop(tag, id)
end

-- Libraries and numbers --------------------------------------------------------------

--- Load a library into the server, or into each node of the cluster. It replaces the
-- library that was loaded before.
---@param text string the library, made by `rfsm.redis.bundle`
---@return boolean ok
---@return string? problem
function Fleet:load(text)
  local ok, problem = pcall(self.connection.each_master, self.connection,
    function(call) call("FUNCTION", "LOAD", "REPLACE", text) end)
  return ok, not ok and problem or nil
end

local function label(text) return (text:gsub('[\\"\n]', { ["\\"] = "\\\\",
  ['"'] = '\\"', ["\n"] = "\\n" })) end

-- Adds to the number of a metric with labels, such as { chart = "c" }.
local function add_number(metrics, name, labels, number)
  local texts = {}
  for _, key in ipairs(rfsm.sorted_keys(labels)) do
    texts[#texts + 1] = ('%s="%s"'):format(key, label(labels[key]))
  end
  local text = name .. (texts[1] and "{" .. concat(texts, ",") .. "}" or "")
  metrics[text] = (metrics[text] or 0) + number
end

-- The numbers in the reply of rfsm_stats, from the second result on.
local GAUGES = { "rfsm_timers", "rfsm_aside", "rfsm_entries", "rfsm_overdue",
  "rfsm_dead" }

local function set_most(metrics, name, seconds)
  metrics[name] = max(metrics[name] or 0, rfsm.number_of(seconds) or 0)
end

local function add_tag(metrics, reply)
  for i = 1, #reply[1], 3 do
    add_number(metrics, "rfsm_machines", { chart = reply[1][i],
      state = reply[1][i + 1] }, reply[1][i + 2])
  end
  for i, name in ipairs(GAUGES) do add_number(metrics, name, {}, reply[i + 1] or 0) end
  set_most(metrics, "rfsm_oldest_entry_seconds", reply[7])
  set_most(metrics, "rfsm_oldest_timer_seconds", reply[8])
end

-- Adds the counters of a server, which each of its replies has.
local function add_counters(metrics, list)
  for i = 1, #list, 3 do
    add_number(metrics, list[i], { chart = list[i + 1] }, list[i + 2])
  end
end

-- Returns the lines of metrics, those with one name together, behind a line that tells
-- what they are.
local function metric_lines(metrics)
  local lines, last = {}, nil
  for _, text in ipairs(rfsm.sorted_keys(metrics)) do
    local name = text:match("^[%w_]+")
    if name ~= last then
      lines[#lines + 1] = ("# TYPE %s %s"):format(name, name:find("_total$")
        and "counter" or "gauge")
    end
    lines[#lines + 1] = text .. " " .. rfsm.number_text(metrics[text], "%.14g")
    last = name
  end
  return lines
end

--- Return statistics of the fleet in the text format of Prometheus: machines by
-- version and, if the library was made with `--index`, by state; those with a timer,
-- put aside, overdue for a minute; entries and dead entries; the age of the oldest
-- entry and of the latest timer; counters of events, of dropped ones, of errors.
---@return string text
function Fleet:stats()
  local metrics = {}
  for _, name in ipairs(GAUGES) do metrics[name] = 0 end
  self.connection:each_master(function(call)
    local counters
    scan_tags(call, function(tag)
      local reply = call("FCALL", "rfsm_stats", 1, keys_of.index("{" .. tag .. "}"))
      add_tag(metrics, reply)
      counters = reply[9]
    end)
    add_counters(metrics, counters or {})
  end)
  local versions, problem = self:versions()
  if not versions then error(problem, 0) end
  for _, version in ipairs(versions) do
    add_number(metrics, "rfsm_version_machines", { chart = version.chart,
      known = version.known, version = version.version }, version.count)
  end
  return concat(metric_lines(metrics), "\n") .. "\n"
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_fleet", fleet) end

return fleet
