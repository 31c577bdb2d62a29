-- A day of production:  LUA bench/day.lua [ORDERS [EVENTS]]
--
-- Orders get numbered events with data, in Redis, then in PostgreSQL. Each order has a
-- timer at any time, and both come together all the time. Some calls are made again;
-- others are for later; in PostgreSQL a worker wakes orders beside them. For each
-- event an order emits an entry; a worker answers it, and fails now and then after the
-- answer, so that entries die and are sent again. Meanwhile the server is killed in
-- the middle of calls, its clock jumps forwards and back, a new version of the chart
-- is loaded, in which the timer is shorter and the event has another name, and the one
-- before it again. One machine has a timer whose effect never ends. Redis fails over
-- to a replica that lacks the latest answers, PostgreSQL is dumped and restored. At
-- the end each order says what it has seen: how many events and answers are lost, came
-- twice or out of order, and which order is without a timer. The exit code is 1 if
-- there is any.

package.path = "./?.lua;" .. package.path

local helper = require "spec.helper"
local servers = require "spec.support.servers"

local missing = servers.no_redis() or servers.no_postgres()
  or not helper.package "luasql.postgres" and "lua-sql-postgres is missing"
if missing then
  io.stderr:write("bench/day.lua: ", missing, "\n")
  os.exit(1)
end

local fleet = require "rfsm.fleet"
local luasql = require "luasql.postgres"
local redis = require "rfsm.redis"
local script = require "rfsm.postgres.script"
local socket = require "socket"

local ORDERS, EVENTS = tonumber(arg[1]) or 200, tonumber(arg[2]) or 12

-- Seconds: a timer runs so long that events and timers are about as many. A clock jumps
-- as far as some of them.
local TIMER = ORDERS / 400
local JUMP = 10 * TIMER

-- waiting --TIMER--> $NAME --TIMER--> waiting; around them the event with its number,
-- and the answers, each with the number of its entry
local CHART = [[
local function count(fsm, _, _, events)
  for _, event in ipairs(events) do
    local n = type(event) == "table" and event.n
    if n and n == fsm.last + 1 then
      fsm.last = n
      fsm.emit("done", { n = n })
    elseif n then
      fsm.wrong = fsm.wrong .. " " .. n .. " after " .. fsm.last
    end
  end
end
local function note_answer(fsm, _, _, events)
  for _, event in ipairs(events) do
    local n = type(event) == "table" and event.answer
    if n and fsm.answers[n] then
      fsm.wrong = fsm.wrong .. " answer " .. n .. " twice"
    end
    if n then fsm.answers[n] = true end
  end
end
return rfsm.state {
  keep = { "last", "wrong", "answers" }, last = 0, wrong = "", answers = {},
  rename = $RENAME,
  live = rfsm.state {
    waiting = rfsm.state {}, $NAME = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "waiting" },
    rfsm.trans { src = "waiting", tgt = "$NAME", events = { "e_after($TIMER)" } },
    rfsm.trans { src = "$NAME", tgt = "waiting", events = { "e_after($TIMER)" } },
  },
  rfsm.trans { src = "initial", tgt = "live" },
  rfsm.trans { src = "live", tgt = "internal", events = { $EVENTS }, effect = count },
  rfsm.trans { src = "live", tgt = "internal", events = { rfsm.named "e_answer" },
    effect = note_answer },
}]]

local HANGING = "hanging=" .. helper.file_with(servers.ENDLESS)

-- Returns the argument for a version: its state is called `name`, before that `old`. It
-- takes the events with the names that follow.
local function version(name, old, timer, ...)
  local rename = ("{ ['root.live.%s'] = 'root.live.%s' }"):format(old, name)
  local events = { ... }
  for i, event in ipairs(events) do events[i] = ("rfsm.named %q"):format(event) end
  return "order=" .. helper.file_with((CHART:gsub("$(%u+)", { NAME = name,
    RENAME = rename, TIMER = timer, EVENTS = table.concat(events, ", ") })))
end

local FIRST = version("busy", "none", TIMER, "e_n")
local SECOND = version("picking", "busy", TIMER / 3, "e_number", "e_n")
local AGAIN = version("busy", "picking", TIMER, "e_n", "e_number")
local event_name = "e_n"

-- Servers --------------------------------------------------------------------------

local function in_redis()
  local options = "--appendonly yes --appendfsync always --busy-reply-threshold 100 "
  local server = servers.redis(options)
  local replica = servers.redis(options)
  replica:kill() -- until it is needed
  local client = fleet.connect({ server:url(), replica:url() }, { name = "o", tags = 4,
    patience = 60 })

  -- Kills calls that never end, until its file is gone.
  local file, ports = helper.file_with(""), server.port .. " " .. replica.port
  os.execute(("while [ -e %s ]; do for port in %s; do redis-cli -p $port FUNCTION "
    .. "KILL; done; sleep 0.3; done >/dev/null 2>&1 &"):format(file, ports))

  local self
  self = {
    server = server,
    load = function(...)
      assert(client:load(servers.with_clock((redis.bundle { HANGING, ... }))))
    end,
    create_hanging = function() client:create("bad", "hanging", { bad = true }) end,
    -- A replica becomes the master while a worker sends answers, which only the old
    -- master has: it is killed then.
    move_house = function()
      replica:launch()
      server:cli("CONFIG SET repl-diskless-sync-delay 0")
      replica:cli("REPLICAOF 127.0.0.1 " .. server.port)
      client:call("0", "WAIT", 1, 10000)
      local is_first = true
      self.work(function()
        if is_first then replica:cli("REPLICAOF NO ONE") end
        is_first = false
      end, function() servers.stop(server) end)
      self.server = replica
    end,
    work = function(before, after)
      local count = 0
      local _, failures = client:work("g", "w", function(entry)
        if before then before() end
        assert(client:answer(entry, { name = "e_answer", answer = entry.data.n }))
        count = count + 1
        if after and count == 20 then after() end
        if not before and count % 9 == 0 then error("no mail", 0) end
      end, { idle = 10, tries = 2 })
      return count, #failures
    end,
    revive = function()
      for _, entry in ipairs(client:dead(10000)) do
        client:again(entry.tag, entry.id)
      end
    end,
    create = function(id) assert(client:create(id, "order")) end,
    send = function(id, key, event)
      return assert(client:send_once(key, id, event)).outcome
    end,
    send_at = function(id, event) assert(client:send_after(id, TIMER / 2, event)) end,
    wake = function() client:wake() end,
    get = function(id)
      local view = client:get(id)
      local root = view.data.root
      return root.last, root.wrong, view.due, root.answers or {}
    end,
  }
  return self
end

local function in_postgres()
  local server, connection = servers.postgres(), nil
  local codec = require "rfsm.server.codec"

  -- Runs a statement until a server answers; returns the first column.
  local function value(form, ...)
    local problem
    for _ = 1, 600 do
      connection = connection or luasql.postgres():connect("postgres", "postgres", "",
        server.folder)
      local cursor
      if connection then
        cursor, problem = connection:execute(form:format(...))
        if cursor then return type(cursor) == "userdata" and cursor:fetch() end
        connection:close()
        connection = nil
      end
      socket.sleep(0.05)
    end
    error(problem)
  end

  -- Wakes machines beside the calls, until its file is gone.
  local function begin_waking()
    local file = helper.file_with("SET statement_timeout = 3000; CALL rfsm.work(0.05);")
    os.execute(("while [ -e %s ]; do %s; sleep 0.1; done >/dev/null 2>&1 &"):format(
      file, server:command("psql", "-qf " .. file)))
    return file
  end
  local waking = begin_waking()

  local self
  self = {
    server = server,
    create_hanging = function()
      value("SELECT rfsm.create('bad', 'hanging', '{\"bad\": true}', 'new')")
    end,
    -- Everything is dumped, dropped and restored.
    move_house = function()
      os.remove(waking)
      server:sql("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE query "
        .. "LIKE '%rfsm.work%' AND pid <> pg_backend_pid();")
      if connection then connection:close() end
      connection = nil
      local file = server.folder .. "/dump"
      local output = servers.output_of(("{ %s && %s && %s; }"):format(
        server:command("pg_dump", "-n rfsm -Fc -f " .. file),
        server:command("psql", "-qc 'SET client_min_messages = error' -c 'DROP SCHEMA "
          .. "rfsm CASCADE'"),
        server:command("pg_restore", "-d postgres " .. file)))
      assert(output == "", output)
      waking = begin_waking()
    end,
    work = function()
      local count = 0
      while true do
        local entry = value("SELECT id || ' ' || key || ' ' || (data->>'n') FROM "
          .. "rfsm.take(1, '0.01', 2)")
        if not entry then return count, 0 end
        local id, key, n = entry:match("(%d+) (%S+) (%d+)")
        local outcome = value("SELECT outcome FROM rfsm.reply('%s', ARRAY['%s'], "
          .. "'out-%s')", key, codec.encode { name = "e_answer", answer = tonumber(n) },
          id)
        assert(outcome ~= "dropped", outcome)
        count = count + 1
        if count % 9 == 0 then
          value("SELECT rfsm.fail(%s, 'no mail')", id)
        else
          value("SELECT rfsm.done(%s)", id)
        end
      end
    end,
    revive = function() value("SELECT count(rfsm.again(id)) FROM rfsm.dead") end,
    load = function(...)
      local options = { history = true, notify = true }
      local output = server:sql((script.sql({ HANGING, ... }, options)))
      assert(output == "", output)
    end,
    create = function(id)
      value("SELECT rfsm.create('%d', 'order', id => 'new')", id)
    end,
    send = function(id, key, event)
      return value("SELECT outcome FROM rfsm.reply('%d', ARRAY['%s'], '%s')", id,
        codec.encode(event), key)
    end,
    send_at = function(id, event)
      value("SELECT rfsm.send_at('%d', clock_timestamp() + interval '%g s', '%s', "
        .. "'at%d')", id, TIMER / 2, codec.encode(event), event.n)
    end,
    wake = function() end, -- rfsm.work does it; rfsm.wake has no lease
    get = function(id)
      local root = codec.decode(value("SELECT data->'root' FROM rfsm.machines WHERE "
        .. "key = '%d'", id))
      return root.last, root.wrong, value("SELECT due FROM rfsm.machines WHERE key = "
        .. "'%d'", id), root.answers or {}
    end,
  }
  return self
end

-- The day -----------------------------------------------------------------------------

-- Sends event number `n` to each order; every third comes twice, the last one later.
local function send_all(fleet_of, n)
  for id = 1, ORDERS do
    local key, event = ("n%d"):format(n), { name = event_name, n = n }
    if n == EVENTS then
      fleet_of.send_at(id, event)
    else
      local outcome = fleet_of.send(id, key, event)
      assert(outcome == "taken" or outcome == "known" or outcome == "kept", outcome)
    end
    if id % 3 == 0 and n < EVENTS then
      assert(fleet_of.send(id, key, event) == "known")
    end
    if id % 50 == 0 then fleet_of.wake() end
  end
  fleet_of.work()
end

-- Prints what the orders have seen; is all of it right?
local function print_result(name, fleet_of, seconds)
  local lost, unanswered, wrong, still = 0, 0, 0, 0
  for id = 1, ORDERS do
    local last, text, due, answers = fleet_of.get(id)
    lost = lost + EVENTS - last
    for n = 1, EVENTS do
      if not (answers[n] or answers[tostring(n)]) then unanswered = unanswered + 1 end
    end
    if text ~= "" then wrong = wrong + 1 end
    if not due or due == "" then still = still + 1 end
  end
  print(("%s: %d orders, %d events in %.0f s; lost %d, answers lost %d, twice or out "
    .. "of order %d, stuck %d"):format(name, ORDERS, ORDERS * EVENTS, seconds, lost,
    unanswered, wrong, still))
  return lost + unanswered + wrong + still == 0
end

-- Wakes orders until each has seen its last event, which is for later, but no longer
-- than half a minute. A worker that has them at the moment hides them from a wake.
local function wait_for_the_last(fleet_of)
  local limit = socket.gettime() + 30
  for id = 1, ORDERS do
    while fleet_of.get(id) < EVENTS and socket.gettime() < limit do
      socket.sleep(TIMER / 10)
      fleet_of.wake()
    end
  end
end

-- What happens before event number n: a version is loaded, or the clock jumps.
local function disturb(fleet_of, n)
  local at = { [1 / 6] = function() fleet_of.server:move_clock(JUMP) end,
    [1 / 4] = function()
      fleet_of.load(FIRST, SECOND)
      event_name = "e_number"
    end,
    [1 / 3] = fleet_of.create_hanging, [2 / 3] = fleet_of.move_house,
    [1 / 2] = function() fleet_of.server:move_clock(-JUMP) end,
    [3 / 4] = function()
      fleet_of.load(SECOND, AGAIN)
      event_name = "e_n"
    end,
    [5 / 6] = function() fleet_of.server:move_clock(0) end }
  for share, f in pairs(at) do -- any order: they come at different times
    if n == math.ceil(EVENTS * share) then f() end
  end
end

local function day(name, fleet_of)
  local started = socket.gettime()
  event_name = "e_n"
  fleet_of.server:move_clock(0)
  fleet_of.load(FIRST)
  for id = 1, ORDERS do fleet_of.create(id) end
  for n = 1, EVENTS do
    disturb(fleet_of, n)
    local finish = n % 3 == 0 and servers.crash_after(TIMER / 4, fleet_of.server)
    send_all(fleet_of, n)
    if finish then finish() end
  end
  wait_for_the_last(fleet_of)
  for _ = 1, 40 do -- until no entry is left, and none is dead
    fleet_of.revive()
    if fleet_of.work() == 0 then break end
    socket.sleep(0.1)
  end
  return print_result(name, fleet_of, socket.gettime() - started)
end

local ok, is_right = pcall(function()
  local is_right = day("Redis", in_redis())
  return day("PostgreSQL", in_postgres()) and is_right
end)
servers.stop_all()
helper.remove_files()
if not ok then io.stderr:write("bench/day.lua: ", tostring(is_right), "\n") end
os.exit(ok and is_right and 0 or 1)
