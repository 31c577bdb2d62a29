--- Stores machines in the keys of Redis: the host object of `rfsm.server.functions`,
-- and the functions for many machines.
--
-- `rfsm.redis` bundles this module. A call that fails changes nothing, since all checks
-- come before the first write, also those of the user's rights and of the types of the
-- keys that will be written.
--
-- @module rfsm.redis.store
-- @license BSD-3-Clause

local charts = require "rfsm.server.charts"
local encoding = require "rfsm.snapshot.encoding"
local keys_of = require "rfsm.server.keys"
local lease = require "rfsm.server.lease"
local migrate = require "rfsm.snapshot.migrate"
local rfsm = require "rfsm"
local times = require "rfsm.server.times"

local ipairs, pairs, pcall, rawget = ipairs, pairs, pcall, rawget
local tonumber, type = tonumber, type
local char, huge, min = string.char, math.huge, math.min
local concat = table.concat
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local fail, now, reason_of, shown = encoding.fail, times.now, charts.reason_of,
  keys_of.shown

local MAX_LOG = 1000
local OVERDUE = 60 -- seconds; a machine that is due for longer counts as overdue
local ASIDE = 60 -- seconds until a machine that cannot be run is tried again

-- The objects that Redis passes to libraries, the functions rfsm_tick and rfsm_hold, a
-- function that tells of which version a snapshot is, and the options of the library.
-- They are locals of the module, since a server runs one such library.
local redis, call, cmsgpack, tick_machine, hold_machine, version_of, options

local store = { FORCE = "--force" }

local function score(time) return rfsm.number_text(time, "%.6f") end

-- One machine ----------------------------------------------------------------------

--- Return the time of the server: seconds and nanoseconds.
function store.time()
  local time = call("TIME")
  return tonumber(time[1]), tonumber(time[2]) * 1000
end

--- Return the list that is stored for a machine; nil if there is no machine.
function store.read(key)
  local value = call("GET", key)
  if not value then return nil end
  local ok, list = pcall(cmsgpack.unpack, value)
  if not ok or type(list) ~= "table" or list[1] ~= "rfsm" then
    fail("what is at '%s' is no machine", shown(key))
  end
  return list
end

function store.pack(list) return cmsgpack.pack(list) end

-- `writes`: the commands that store a machine, each { name, key, ... }. `asked`: key ->
-- command whose check is done, since several may write one stream.
local writes, asked = {}, {}

-- Adds a command. Only the first one may fail, since earlier commands are not undone.
-- So the others are checked: the key must be absent or of the type `kind`, and the user
-- must have the right to do the command.
local function add_write(kind, name, key, ...)
  writes[#writes + 1] = { name, key, ... }
  if writes[2] == nil or asked[key] == name then return end -- the first may fail
  if not redis.acl_check_cmd(name, key, ...) then
    fail("no right to do %s %s", name, shown(key))
  end
  local found = kind and call("TYPE", key).ok
  if kind and found ~= kind and found ~= "none" then
    fail("%s expected at '%s', got %s", kind, shown(key), found)
  end
  asked[key] = name
end

local function add_due(machine, due)
  if due then
    add_write("zset", "ZADD", keys_of.due(machine.key), score(due), machine.key)
  elseif machine.was_due then
    add_write("zset", "ZREM", keys_of.due(machine.key), machine.key)
  end
end

-- Adds emitted events to the stream that all machines with the same hash tag share, and
-- errors to the log of the machine.
local function add_streams(machine, emitted, errors)
  for i = 1, #emitted do
    add_write("stream", "XADD", keys_of.out(machine.key), "*", "machine", machine.key,
      "what", emitted[i][1], "data", emitted[i][2])
  end
  for i = 1, #errors do
    add_write("stream", "XADD", keys_of.log(machine.key), "MAXLEN", "~", MAX_LOG, "*",
      "error", errors[i])
  end
end

-- Returns the least text that is greater than all texts that begin with `head`.
local function behind(head) return head:sub(1, -2) .. char(head:byte(-1) + 1) end

-- Lists the different beginnings, "chart TAB state TAB", of the members of an index.
local function heads_of(index)
  local heads, from = {}, ""
  repeat
    local member = call("ZRANGEBYLEX", index, "[" .. from, "+", "LIMIT", 0, 1)[1]
    local head = member and member:match("^[^\t]*\t[^\t]*\t")
    heads[#heads + 1], from = head, head and behind(head)
  until not head
  return heads
end

-- Lists the members that the index may have for a key, one for each chart and state.
-- The state may be unknown, since a machine that is removed by DEL leaves its member.
local function members_of(key)
  local members = heads_of(keys_of.index(key))
  for i, head in ipairs(members) do members[i] = head .. key end
  return members
end

local function add_to_index(machine)
  local key, index, name = machine.key, keys_of.index(machine.key), machine.chart.name
  local old = machine.leaf and { keys_of.member(name, machine.leaf, key) }
    or members_of(key)
  if old[1] then add_write("zset", "ZREM", index, unpack(old)) end
  add_write("zset", "ZADD", index, 0, keys_of.member(name, machine.at, key))
  add_write("zset", "ZADD", keys_of.since(key), score(now()), key)
end

-- Adds the moves of a call to the index, the history and the channel.
local function add_moves(machine)
  local key = machine.key
  if options.index and machine.at ~= (machine.leaf or "") then add_to_index(machine) end
  for i, at in ipairs(machine.moves) do
    if options.history then
      add_write("stream", "XADD", keys_of.history(key), "MAXLEN", options.history, "*",
        "event", at.by, "from", at.from, "to", at.to, "snapshot",
        machine.moves[i + 1] and "" or cmsgpack.pack(machine.list[3]))
    end
    if at.from ~= at.to then add_write(nil, "SPUBLISH", keys_of.channel(key), at.to) end
  end
end

--- Write a machine, its timers, its streams and its moves.
function store.write(machine, due, emitted, errors)
  writes, asked = {}, {}
  add_due(machine, due)
  add_streams(machine, emitted, errors)
  add_write(nil, "SET", machine.key, machine.value)
  add_moves(machine)
  local ok, problem = pcall(call, unpack(writes[1]))
  if not ok then
    fail("%s %s: %s", writes[1][1], shown(writes[1][2]), reason_of(problem))
  end
  for i = 2, #writes do call(unpack(writes[i])) end
end

--- Remove a machine with its timers, its member of the index and its streams. Return
-- whether the machine existed.
function store.remove(key)
  if call("DEL", key) == 0 then return false end
  call("ZREM", keys_of.due(key), key)
  call("ZREM", keys_of.aside(key), key)
  call("ZREM", keys_of.lease(key), key)
  call("DEL", keys_of.log(key), keys_of.history(key))
  if options.index then
    local members = members_of(key)
    if members[1] then call("ZREM", keys_of.index(key), unpack(members)) end
    call("ZREM", keys_of.since(key), key)
  end
  return true
end

-- Counters: text such as "rfsm_events_total TAB chart" -> number. They begin anew when
-- the server or the library does, as counters may, and cost no write.
local counters = {}

local function add_count(name, chart, number)
  local text = name .. "\t" .. chart
  counters[text] = (counters[text] or 0) + number
end

--- Count a call for monitoring.
function store.count(machine, errors)
  local name = machine.chart.name
  if machine.is_sent_to then add_count("rfsm_events_total", name, 1) end
  if machine.outcome == "dropped" then add_count("rfsm_dropped_total", name, 1) end
  if errors > 0 then add_count("rfsm_errors_total", name, errors) end
end

-- Many machines --------------------------------------------------------------------

local more = {}

local function whole_of(text, default, most, least)
  local number = rfsm.number_of(text or default)
  least = least or 1
  if not number or number < least or number > most or number % 1 ~= 0 then
    fail("a whole number from %d to %d expected, got '%s'", least, most, shown(text))
  end
  return number
end

-- rfsm_tick KEY: runs a machine. It is no longer put aside, and its lease ends. If the
-- machine does not exist, its key is removed from the keys of due machines.
function more.rfsm_tick(keys, arguments)
  local key, reply = keys[1], tick_machine(keys, arguments)
  if not reply then call("ZREM", keys_of.due(key), key) end
  call("ZREM", keys_of.aside(key), key)
  call("ZREM", keys_of.lease(key), key)
  return reply
end

-- Has a machine that cannot be run wait for a minute, so that others are not held up.
-- The failure is counted, and the reason is added to the log of the machine.
local function put_aside(due, key, problem)
  local text = "rfsm_wake: " .. reason_of(problem)
  call("ZADD", due, score(now() + ASIDE), key)
  call("ZREM", keys_of.lease(due), key)
  call("ZINCRBY", keys_of.aside(due), 1, key)
  pcall(call, "XADD", keys_of.log(key), "MAXLEN", "~", MAX_LOG, "*", "error", text)
end

-- Calls f({ key }, { argument }). Returns 1 and 0; if it fails, puts the machine aside
-- and returns 0 and 1. A machine may have moved to another node of the cluster.
local function try(f, due, key, argument)
  local ok, problem = pcall(f, { key }, { argument })
  if ok then return 1, 0 end
  if reason_of(problem):find("non local key", 1, true) then return 0, 0 end
  put_aside(due, key, problem)
  return 0, 1
end

-- Holds a machine because of its leases.
local function hold(keys, arguments)
  local key = keys[1]
  hold_machine(keys, arguments)
  call("ZREM", keys_of.lease(key), key)
  call("ZINCRBY", keys_of.aside(key), 1, key)
end

-- Leases the machine that is due first. Returns its key; nil if none is due. If it had
-- too many leases, it is held, and the second result is 1.
local function lease_next(due)
  local key = call("ZRANGEBYSCORE", due, "-inf", score(now()), "LIMIT", 0, 1)[1]
  if not key then return nil, 0 end
  if tonumber(call("ZINCRBY", keys_of.lease(due), 1, key)) > lease.MOST then
    try(hold, due, key, lease.REASON)
    return nil, 1
  end
  call("ZADD", due, score(now() + lease.SECONDS), key)
  return key, 0
end

-- The machine that the call before has leased, by the key of its due machines. It is
-- not written, since a call that is killed cannot write that it has begun.
local leased = {}

-- rfsm_wake KEY [limit]: runs the machine that the call before has leased, and leases
-- the one that is due first, among those with the {hash tag} of KEY. Returns how many
-- ran, how many failed, and how many are still due, at most `limit`. No call runs two,
-- since a call that has written cannot be killed.
function more.rfsm_wake(keys, args)
  local due, limit = keys_of.due(keys[1]), whole_of(args[1], 100, 10000)
  local key, count, failed = leased[due], 0, 0
  leased[due] = nil
  if key then count, failed = try(more.rfsm_tick, due, key, "due") end
  local next_key, held = lease_next(due)
  leased[due] = next_key
  local left = call("ZCOUNT", due, "-inf", score(now())) + (next_key and 1 or 0)
  return { count, failed + held, min(limit, left) }
end

-- rfsm_due KEY [limit [seconds]]: returns the keys of machines that are due now, or
-- at a time in seconds, and that have the {hash tag} of KEY.
function more.rfsm_due(keys, args)
  local limit, at = rfsm.number_of(args[1] or 100), rfsm.number_of(args[2] or now())
  if not limit or not at then fail("a number expected") end
  return call("ZRANGEBYSCORE", keys_of.due(keys[1]), "-inf", score(at), "LIMIT", 0,
    limit)
end

-- Does a machine of the index exist? A machine that was removed by DEL leaves its
-- member in the index. EXISTS may fail while the slot of the key moves to another node;
-- then the machine counts as existing.
local function is_there(key)
  local ok, count = pcall(call, "EXISTS", key)
  return not ok or count == 1
end

-- Has a machine been in its active leaf since a time, or longer? Without a time: yes.
-- If it is not known since when, yes: it came there before times were noted.
local function is_since(key, time)
  local since = time and call("ZSCORE", keys_of.since(key), key)
  return not since or rfsm.number_of(since) <= time
end

-- Lists at most `limit` keys of machines whose members of the index begin with `head`,
-- and which have been in their active leaf since `time`, if that is given.
local function keys_with(index, head, limit, time)
  local found, count = {}, min(limit, 1000)
  local from, to = "[" .. head, "(" .. behind(head)
  repeat
    local members = call("ZRANGEBYLEX", index, from, to, "LIMIT", 0, count)
    for _, member in ipairs(members) do
      local key = member:match("\t[^\t]*\t(.*)$")
      local is_one = #found < limit and is_since(key, time) and is_there(key)
      found[#found + 1] = is_one and key or nil
    end
    from = "(" .. (members[count] or "")
  until #found == limit or not members[count]
  return found
end

-- rfsm_find KEY chart state [limit [seconds]]: returns the keys of the machines that
-- have the {hash tag} of KEY, and whose active leaf is the state or inside of it. With
-- `seconds`, only machines that have been in this leaf for so long.
function more.rfsm_find(keys, args)
  if not options.index then fail("the library was made without --index") end
  local index, limit = keys_of.index(keys[1]), whole_of(args[3], 100, 100000)
  if not args[2] then fail("a chart and a state expected") end
  local head, time = keys_of.head(args[1], args[2]), nil
  if args[4] then time = now() - whole_of(args[4], 0, 1e9, 0) end
  local found = keys_with(index, head .. "\t", limit, time) -- the state itself
  for _, key in ipairs(keys_with(index, head .. ".", limit - #found, time)) do
    found[#found + 1] = key
  end
  return found
end

-- Lists the newest entries of a stream: the time of each, and its first values.
local function list_stream(stream, count, most)
  local reply = {}
  for _, entry in ipairs(call("XREVRANGE", stream, "+", "-", "COUNT",
    whole_of(count, 10, 10000))) do
    reply[#reply + 1] = rfsm.number_text(entry[1]:match("^%d+") / 1000, "%.3f")
    for i = 2, 2 * most, 2 do reply[#reply + 1] = entry[2][i] or "" end
  end
  return reply
end

--- Return the latest moves of a machine, each with the snapshot after it.
function store.history(key, count)
  local moves = list_stream(keys_of.history(key), count, 4)
  for i = 5, #moves, 5 do moves[i] = moves[i] ~= "" and cmsgpack.unpack(moves[i]) end
  return moves
end

-- Returns for how many seconds the first entry of a stream is there, as a text.
local function age_of_entry(stream)
  local first = call("XRANGE", stream, "-", "+", "COUNT", 1)[1]
  if not first then return "0" end
  return rfsm.number_text(now() - first[1]:match("^%d+") / 1000, "%.3f")
end

-- Returns for how many seconds the first due machine is late, as a text.
local function age_of_timer(due)
  local first = call("ZRANGE", due, 0, 0, "WITHSCORES")[2]
  local late = first and now() - rfsm.number_of(first) or 0
  return rfsm.number_text(late > 0 and late or 0, "%.3f")
end

-- Lists the counters: name, chart, number, name ...
local function list_counters()
  local list = {}
  for _, text in ipairs(rfsm.sorted_keys(counters)) do
    local n = #list
    list[n + 1], list[n + 2] = text:match("^(.-)\t(.*)$")
    list[n + 3] = counters[text]
  end
  return list
end

-- rfsm_stats KEY: returns nine results for the machines with the {hash tag} of KEY: a
-- list (chart, state, number of machines, chart ...); five numbers: machines with a
-- deadline, machines put aside, events in the stream, overdue machines, dead events;
-- two texts: seconds since the oldest event came into the stream, seconds by which the
-- first machine is late; the counters of the server: name, chart, number, name ...
function more.rfsm_stats(keys)
  local key, reply = keys[1], {}
  local index, due = keys_of.index(key), keys_of.due(key)
  for _, head in ipairs(options.index and heads_of(index) or {}) do
    local name, leaf = keys_of.read_head(head)
    local count = #keys_with(index, head, huge)
    for _, value in ipairs(count > 0 and { name, leaf, count } or {}) do
      reply[#reply + 1] = value
    end
  end
  return { reply, call("ZCARD", due), call("ZCARD", keys_of.aside(key)),
    call("XLEN", keys_of.out(key)), call("ZCOUNT", due, "-inf", score(now() - OVERDUE)),
    call("XLEN", keys_of.dead(key)), age_of_entry(keys_of.out(key)), age_of_timer(due),
    list_counters() }
end

-- The list for a key that another program has overwritten.
local BROKEN = { "rfsm", "(broken)", { chart = "(broken)" } }

-- Reads a machine. Returns BROKEN if something else is at its key: there was a machine
-- if the key has a timer, a place in the index, or a log.
local function read_any(key)
  local ok, list = pcall(store.read, key)
  local is_one = list and type(list[2]) == "string" and pcall(migrate.checked, list[3])
  if ok and (is_one or not list) then return list end
  local was_machine = call("ZSCORE", keys_of.due(key), key)
    or call("ZSCORE", keys_of.since(key), key)
    or call("EXISTS", keys_of.log(key), keys_of.history(key)) > 0
  return was_machine and BROKEN
end

-- Calls f(key, list) for each machine in a list of keys. If there is no machine at the
-- first key, calls it for all machines with its hash tag. Returns how many there are.
local function each_machine(keys, f)
  local count, found, seen = 0, keys, {}
  local function see(key)
    if seen[key] then return end -- SCAN may list a key twice
    local list = read_any(key)
    if not list then return end
    count, seen[key] = count + 1, true
    f(key, list)
  end
  if call("TYPE", keys[1]).ok ~= "string" then
    local tag, at = keys_of.tag(keys[1]), "0"
    found = { tag }
    repeat
      local page = call("SCAN", at, "MATCH", "*{" .. tag:gsub("[%[%]*?\\]", "\\%0")
        .. "}*", "COUNT", 1000, "TYPE", "string")
      at = page[1]
      for _, key in ipairs(page[2]) do found[#found + 1] = key end
    until at == "0"
  end
  for _, key in ipairs(found) do see(key) end
  return count
end

-- rfsm_reindex KEY...: puts machines into the index as they are, also those that have
-- moved while the library was loaded without --index. Returns how many.
function more.rfsm_reindex(keys)
  if not options.index then fail("the library was made without --index") end
  return each_machine(keys, function(key, list)
    local old = members_of(key)
    if old[1] then call("ZREM", keys_of.index(key), unpack(old)) end
    local member = keys_of.member(list[2], list[3].leaf or "", key)
    call("ZADD", keys_of.index(key), 0, member)
  end)
end

-- Returns how the version of a machine is known.
local function known_of(list)
  return list == BROKEN and "broken" or version_of(list[2], list[3])
end

-- rfsm_versions KEY...: returns four items for each version of a chart: its name, how
-- the version is known ("newest", "bundled", "gone", "broken": overwritten), its
-- fingerprint, and how many machines are of this version.
function more.rfsm_versions(keys)
  local counts, reply = {}, {}
  each_machine(keys, function(_, list)
    local name = concat({ list[2], known_of(list), list[3].chart }, "\t")
    counts[name] = (counts[name] or 0) + 1
  end)
  for _, name in ipairs(rfsm.sorted_keys(counts)) do
    for text in name:gmatch("[^\t]+") do reply[#reply + 1] = text end
    reply[#reply + 1] = counts[name]
  end
  return reply
end

-- Returns a function that tells if a list of a machine is what the arguments of
-- `rfsm_select` ask for, and how its version is known. An empty text stands for any. A
-- broken machine is found by its version, or if all are asked for.
local function filter_of(args)
  local name, state, version, _, held = unpack(args, 1, 5)
  local is_all = concat(args) == ""
  return function(list)
    if name ~= "" and name ~= list[2] then return false end
    if held == (list[9] and "no" or "yes") then return false end
    local path = (list[3].leaf or "") .. "."
    if state ~= "" and path:sub(1, #state + 1) ~= state .. "." then return false end
    local known = known_of(list)
    if version == "" then return is_all or list ~= BROKEN, known end
    return version == known or version == list[3].chart, known
  end
end

-- rfsm_select KEY... chart state version seconds held: returns six items for each
-- machine that is of the chart, in the state, of the version (how it is known, or its
-- fingerprint), so long in its leaf, and held ("yes") or not ("no"): its key, chart,
-- leaf, how its version is known, seconds in the leaf ("": not known), "yes" or "yes:
-- reason" if it is held.
function more.rfsm_select(keys, args)
  local is_wanted, time, reply = filter_of(args), nil, {}
  if args[4] ~= "" then
    if not options.index then fail("age: the library was made without --index") end
    time = now() - whole_of(args[4], 0, 1e9, 0)
  end
  each_machine(keys, function(key, list)
    local is_one, known = is_wanted(list)
    if not is_one or not is_since(key, time) then return end
    local n, since = #reply, options.index and call("ZSCORE", keys_of.since(key), key)
    reply[n + 1], reply[n + 2], reply[n + 3] = key, list[2], list[3].leaf or ""
    reply[n + 4] = known
    reply[n + 5] = since and ("%.0f"):format(now() - rfsm.number_of(since)) or ""
    reply[n + 6] = list[9] and concat({ "yes", list[10] and list[10][2] }, ": ") or ""
  end)
  return reply
end

-- rfsm_log KEY [count]: returns the latest errors of a machine, the newest first, each
-- as two items: time and text.
function more.rfsm_log(keys, args)
  return list_stream(keys_of.log(keys_of.machine(keys)), args[1], 1)
end

-- rfsm_history KEY [count]: returns the latest moves of a machine, the newest first,
-- each as four items: time, events, from, to.
function more.rfsm_history(keys, args)
  if not options.history then fail("the library was made without --history") end
  return list_stream(keys_of.history(keys_of.machine(keys)), args[1], 3)
end

--- Add the functions for many machines to `all`.
function store.add(all, settings, find_version)
  tick_machine, hold_machine, options = all.rfsm_tick, all.rfsm_hold, settings
  version_of = find_version
  for name, f in pairs(more) do all[name] = f end -- any order: a copy
end

--- Return the error reply of a call that fails.
function store.refuse(name, reason)
  return redis.error_reply("ERR " .. name .. ": " .. reason)
end

--- Return the host object. The arguments are `redis`, `cjson`, `cmsgpack` of Redis.
return function(server, cjson, pack)
  redis, call, cmsgpack = server, server.call, pack
  function store.decode(text) return cjson.decode(text) end
  return store
end
