-- Machines in PostgreSQL:  LUA bench/postgres.lua [EVENTS [MACHINES]]
--
-- Microseconds of processor time of the server's sessions, calls in a second, and bytes
-- of the write-ahead log for each call, by 20 clients: a transaction that does nothing,
-- one that reads a machine, a plain UPDATE of a row of the same size, and events. Then
-- the bytes that a machine takes.

package.path = "./?.lua;" .. package.path

local helper = require "spec.helper"
local script = require "rfsm.postgres.script"
local servers = require "spec.support.servers"

local EVENTS, MACHINES = tonumber(arg[1]) or 20000, tonumber(arg[2]) or 1000
local CLIENTS = 20

local CHART = helper.file_with [[
local function count(fsm) fsm.count = fsm.count + 1 end
return rfsm.state {
  keep = { "order", "count" }, order = "A-4711", count = 0,
  even = rfsm.state { entry = count }, odd = rfsm.state { entry = count },
  rfsm.trans { src = "initial", tgt = "even" },
  rfsm.trans { src = "even", tgt = "odd", events = { "e_next" } },
  rfsm.trans { src = "odd", tgt = "even", events = { "e_next" } },
}]]

-- The row of a machine after many events with ids.
local PLAIN = [[
CREATE TABLE plain (LIKE rfsm.machines INCLUDING ALL) WITH (fillfactor = 80);
SELECT rfsm.send('m1', 'e_next', 'id-00000000-' || i) FROM generate_series(1, 20) i
  \g /dev/null
INSERT INTO plain SELECT 'm' || i, chart, version, state, mode, since, event, due, data,
  value FROM rfsm.machines, generate_series(1, %d) i WHERE key = 'm1';
]]

local UPDATE = [[
UPDATE plain SET chart = 'c', version = '%s',
  state = CASE state WHEN 'root.odd' THEN 'root.even' ELSE 'root.odd' END,
  mode = 'done', since = clock_timestamp(), event = 'e_next', due = NULL,
  data = '%s', value = '%s' WHERE key = 'm' || :m;]]

local server = servers.postgres()

local function load_chart(options)
  assert(server:sql((script.sql({ "c=" .. CHART }, options))) == "")
end

-- Processor time of the sessions that have ended, in seconds.
local function cpu()
  local pid = helper.content(server.folder .. "/data/postmaster.pid"):match("^%d+")
  local fields = {}
  local stat = helper.content("/proc/" .. pid .. "/stat"):match("%) (.*)")
  for field in stat:gmatch("%S+") do
    fields[#fields + 1] = tonumber(field) or 0
  end
  return (fields[14] + fields[15]) / 100
end

local function wal()
  return tonumber(server:sql("SELECT pg_current_wal_lsn() - '0/0'"))
end

-- Has each client call a statement so often. Returns seconds of the processor, bytes of
-- the log, and calls in a second.
local function run(commands, calls)
  local command = server:command("pgbench", ("-n -M prepared -c %d -j 2 -t %d -f %s "
    .. "2>&1"):format(CLIENTS, calls, commands))
  local log, before = wal(), cpu()
  local text = table.concat(helper.lines_of(command), "\n")
  log = wal() - log -- a session, in whose time those of the clients end
  return cpu() - before, log, assert(text:match("tps = (%d+)"), text)
end

-- The first call of each session loads the library, and is not counted.
local function measure(name, statement)
  statement = statement:gsub("\n", " ")
  local commands = helper.file_with(("\\set m random(1, %d)\n"
    .. "\\set i random(1, 1000000000)\n%s\n"):format(MACHINES, statement))
  local calls = math.floor(EVENTS / CLIENTS)
  local first = run(commands, 1)
  local seconds, log, rate = run(commands, calls + 1)
  print(("%-30s %7.0f us %7d/s %7.0f bytes"):format(name, (seconds - first) / calls
    / CLIENTS * 1e6, rate, log / calls / CLIENTS))
end

local EVENT = "SELECT rfsm.send('m' || :m, 'e_next');"
local WITH_ID = "SELECT rfsm.send('m' || :m, 'e_next', 'id-' || :client_id || '-' "
  .. "|| :i);"

load_chart()
server:sql(("SELECT rfsm.create('m' || i, 'c') FROM generate_series(1, %d) i")
  :format(MACHINES))
server:sql(PLAIN:format(MACHINES))
local version, data, value = server:sql("SELECT version, data, value FROM plain "
  .. "LIMIT 1")
  :match("([^|]*)|([^|]*)|([^|\n]*)")
measure("a transaction", "SELECT 1;")
measure("a machine is read", "SELECT rfsm.call('rfsm_get', 'm' || :m, NULL, NULL);")
measure("a plain UPDATE", UPDATE:format(version, data, value))
measure("an event", EVENT)
measure("an event with an id", WITH_ID)
load_chart { history = true }
measure("an event, --history", EVENT)
load_chart { history = true, notify = true }
measure("an event, --history --notify", EVENT)
print(server:sql([[
VACUUM FULL rfsm.machines;
SELECT format('a machine of %s bytes takes %s, its indexes %s',
  avg(pg_column_size(m.*))::int, pg_relation_size('rfsm.machines') / count(*),
  pg_indexes_size('rfsm.machines') / count(*))
FROM rfsm.machines m]]))
servers.stop_all()
helper.remove_files()
