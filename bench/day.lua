-- A day of production:  LUA bench/day.lua [ORDERS [EVENTS]]
--
-- Orders get numbered events with data, in Redis, then in PostgreSQL. Each order has a
-- timer at any time, and both come together all the time. Some calls are made again;
-- others are for later. Meanwhile the server is killed, a new version of the chart is
-- loaded, and the one before it again. At the end each order says what it has seen: how
-- many events are lost, came twice or out of order, and which order is without a timer.

package.path = "./?.lua;" .. package.path

local fleet = require "rfsm.fleet"
local helper = require "spec.helper"
local luasql = require "luasql.postgres"
local redis = require "rfsm.redis"
local script = require "rfsm.postgres.script"
local servers = require "spec.support.servers"
local socket = require "socket"

local ORDERS, EVENTS = tonumber(arg[1]) or 200, tonumber(arg[2]) or 12

-- waiting --0.05 s--> $NAME --0.05 s--> waiting; around them e_n with its number
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
    rfsm.trans { src = "waiting", tgt = "$NAME", events = { "e_after(0.05)" } },
    rfsm.trans { src = "$NAME", tgt = "waiting", events = { "e_after(0.05)" } },
  },
  rfsm.trans { src = "initial", tgt = "live" },
  rfsm.trans { src = "live", tgt = "internal", events = { rfsm.named "e_n" },
    effect = count },
}]]

-- Returns the argument for a version: its state is called `name`, before that `old`.
local function version(name, old)
  local rename = ("{ ['root.live.%s'] = 'root.live.%s' }"):format(old, name)
  return "order=" .. helper.file_with((CHART:gsub("$(%u+)", { NAME = name,
    RENAME = rename })))
end

local FIRST, SECOND, AGAIN = version("busy", "none"), version("picking", "busy"),
  version("busy", "picking")

-- Servers --------------------------------------------------------------------------

local function in_redis()
  local server = servers.redis("--appendonly yes --appendfsync always")
  local client = fleet.connect(server:url(), { name = "o", tags = 4, patience = 60 })
  return {
    server = server,
    load = function(...) assert(client:load((redis.bundle { ... }))) end,
    create = function(id) assert(client:create(id, "order")) end,
    send = function(id, key, event)
      return assert(client:send_once(key, id, event)).outcome
    end,
    send_at = function(id, event) assert(client:send_after(id, 0.02, event)) end,
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
      value("SELECT rfsm.send_at('%d', clock_timestamp() + interval '20 ms', '%s', "
        .. "'at%d')", id, codec.encode(event), event.n)
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
end

local function day(name, fleet_of)
  local started = socket.gettime()
  fleet_of.load(FIRST)
  for id = 1, ORDERS do fleet_of.create(id) end
  for n = 1, EVENTS do
    if n == math.ceil(EVENTS / 4) then fleet_of.load(FIRST, SECOND) end
    if n == math.ceil(EVENTS * 3 / 4) then fleet_of.load(SECOND, AGAIN) end
    if n % 3 == 0 then
      fleet_of.server:kill()
      fleet_of.server:launch()
    end
    send_all(fleet_of, n)
  end
  socket.sleep(0.1)
  for _ = 1, 20 do fleet_of.wake() end
  print_result(name, fleet_of, socket.gettime() - started)
end

local ok, problem = pcall(function()
  day("Redis", in_redis())
  day("PostgreSQL", in_postgres())
end)
servers.stop_all()
helper.remove_files()
if not ok then error(problem, 0) end
