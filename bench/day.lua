-- A day of production:  LUA bench/day.lua [ORDERS [EVENTS]]
--
-- Orders get numbered events with data, in Redis, then in PostgreSQL. Each order has a
-- timer at any time, and both come together all the time. Some calls are made again;
-- others are for later; in PostgreSQL a worker wakes orders beside them. Meanwhile the
-- server is killed in the middle of calls, its clock jumps forwards and back, a new
-- version of the chart is loaded, and the one before it again. At the end each order
-- says what it has seen: how many events are lost, came twice or out of order, and
-- which order is without a timer. The exit code is 1 if there is any.

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

-- waiting --TIMER--> $NAME --TIMER--> waiting; around them e_n with its number
local CHART = [[
local function count(fsm, _, _, events)
  for _, event in ipairs(events) do
    local n = type(event) == "table" and event.n
    if n and n == fsm.last + 1 then fsm.last = n
    elseif n then fsm.wrong = fsm.wrong .. " " .. n .. " after " .. fsm.last end
  end
end
return rfsm.state {
  keep = { "last", "wrong" }, last = 0, wrong = "", rename = $RENAME,
  live = rfsm.state {
    waiting = rfsm.state {}, $NAME = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "waiting" },
    rfsm.trans { src = "waiting", tgt = "$NAME", events = { "e_after($TIMER)" } },
    rfsm.trans { src = "$NAME", tgt = "waiting", events = { "e_after($TIMER)" } },
  },
  rfsm.trans { src = "initial", tgt = "live" },
  rfsm.trans { src = "live", tgt = "internal", events = { rfsm.named "e_n" },
    effect = count },
}]]

-- Returns the argument for a version: its state is called `name`, before that `old`.
local function version(name, old)
  local rename = ("{ ['root.live.%s'] = 'root.live.%s' }"):format(old, name)
  return "order=" .. helper.file_with((CHART:gsub("$(%u+)", { NAME = name,
    RENAME = rename, TIMER = TIMER })))
end

local FIRST, SECOND, AGAIN = version("busy", "none"), version("picking", "busy"),
  version("busy", "picking")

-- Servers --------------------------------------------------------------------------

local function in_redis()
  local server = servers.redis("--appendonly yes --appendfsync always")
  local client = fleet.connect(server:url(), { name = "o", tags = 4, patience = 60 })
  return {
    server = server,
    load = function(...)
      assert(client:load(servers.with_clock((redis.bundle { ... }))))
    end,
    create = function(id) assert(client:create(id, "order")) end,
    send = function(id, key, event)
      return assert(client:send_once(key, id, event)).outcome
    end,
    send_at = function(id, event) assert(client:send_after(id, TIMER / 2, event)) end,
    wake = function() client:wake() end,
    get = function(id)
      local view = client:get(id)
      return view.data.root.last, view.data.root.wrong, view.due
    end,
  }
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
  local file = helper.file_with("CALL rfsm.work(0.05);")
  os.execute(("while [ -e %s ]; do %s; sleep 0.5; done >/dev/null 2>&1 &"):format(file,
    server:command("psql", "-qf " .. file)))

  return {
    server = server,
    load = function(...)
      local options = { history = true, notify = true }
      local output = server:sql((script.sql({ ... }, options)))
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
    wake = function() value("SELECT rfsm.wake()") end,
    get = function(id)
      local root = codec.decode(value("SELECT data->'root' FROM rfsm.machines WHERE "
        .. "key = '%d'", id))
      return root.last, root.wrong, value("SELECT due FROM rfsm.machines WHERE key = "
        .. "'%d'", id)
    end,
  }
end

-- The day -----------------------------------------------------------------------------

-- Sends event number `n` to each order; every third comes twice, the last one later.
local function send_all(fleet_of, n)
  for id = 1, ORDERS do
    local key, event = ("n%d"):format(n), { name = "e_n", n = n }
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
end

-- Prints what the orders have seen; is all of it right?
local function print_result(name, fleet_of, seconds)
  local lost, wrong, still = 0, 0, 0
  for id = 1, ORDERS do
    local last, text, due = fleet_of.get(id)
    lost = lost + EVENTS - last
    if text ~= "" then wrong = wrong + 1 end
    if not due or due == "" then still = still + 1 end
  end
  print(("%s: %d orders, %d events in %.0f s; lost %d, twice or out of order %d, "
    .. "without their timer %d"):format(name, ORDERS, ORDERS * EVENTS, seconds, lost,
    wrong, still))
  return lost == 0 and wrong == 0 and still == 0
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
    [1 / 4] = function() fleet_of.load(FIRST, SECOND) end,
    [1 / 2] = function() fleet_of.server:move_clock(-JUMP) end,
    [3 / 4] = function() fleet_of.load(SECOND, AGAIN) end,
    [5 / 6] = function() fleet_of.server:move_clock(0) end }
  for share, f in pairs(at) do -- any order: they come at different times
    if n == math.ceil(EVENTS * share) then f() end
  end
end

local function day(name, fleet_of)
  local started = socket.gettime()
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
