-- New versions while clients work:  LUA bench/upgrade.lua [ROUNDS [EVENTS]]
--
-- PostgreSQL with --history --notify: an upgrade, a rollback and an upgrade, while six
-- clients send events, each to two machines in a transaction, and a reader that has
-- read all tables does not end its transaction. A line for each round: the seconds of
-- each load, and how many events came meanwhile, and in all. The exit code is 1 if a
-- load or a client has failed, or a machine has not taken each event once.

package.path = "./?.lua;" .. package.path

local helper = require "spec.helper"
local script = require "rfsm.postgres.script"
local servers = require "spec.support.servers"
local socket = require "socket"

local ROUNDS, EVENTS = tonumber(arg[1]) or 10, tonumber(arg[2]) or 300
local CLIENTS, MACHINES = 6, 40

local OLD = helper.file_with(servers.COUNTER)
local NEW = helper.file_with(servers.counter(1, "third = rfsm.state {}, "))

-- Returns a file that loads versions, the newest last.
local function library(...)
  local charts = { ... }
  for i, file in ipairs(charts) do charts[i] = "counter=" .. file end
  return helper.file_with((script.sql(charts, { history = true, notify = true })))
end

local FIRST, SECOND, AGAIN = library(OLD), library(OLD, NEW), library(NEW, OLD)

local server = servers.postgres()

local function load_file(file)
  return servers.output_of(server:command("psql",
    "-XAqt -v ON_ERROR_STOP=1 -f " .. file))
end

-- Lists the statements of a client. Machines are locked in the order of their keys.
local function statements(client)
  local lines = {}
  for i = 1, EVENTS do
    local a = (client * 7 + i * 3) % MACHINES
    local b = (a + 1 + i % (MACHINES - 1)) % MACHINES
    local parts = {}
    for j, key in ipairs { math.min(a, b), math.max(a, b) } do
      parts[j] = ("rfsm.send('m%02d', 'e_tick', '%d-%d-%d')"):format(key, client, i, j)
    end
    lines[i] = "SELECT " .. table.concat(parts, " || ") .. ";"
  end
  return lines
end

local function count_events()
  return tonumber((server:sql [[
SELECT count(*) FROM rfsm.history WHERE src IS NOT NULL]]))
end

-- Begins a transaction that has read all tables and goes on until it is cancelled.
local function begin_reader()
  return server:beside [[
SET application_name = 'reader';
BEGIN;
SELECT FROM rfsm.machines, rfsm.history, rfsm.out, rfsm.log;
SELECT pg_sleep(600)]]
end

-- Loads while clients work; returns a line, and whether all is well.
local function run_round()
  server:sql("DROP SCHEMA IF EXISTS rfsm CASCADE")
  assert(load_file(FIRST) == "")
  server:sql(("SELECT rfsm.create('m' || lpad(i::text, 2, '0'), 'counter') "
    .. "FROM generate_series(0, %d) i"):format(MACHINES - 1))
  local finish_reader = begin_reader()
  local lists, texts, problems = {}, {}, ""
  for i = 1, CLIENTS do lists[i] = statements(i) end
  local finish = server:storm(lists)
  server:wait_for("SELECT count(*) > 10 FROM rfsm.history WHERE src IS NOT NULL")
  for i, file in ipairs { SECOND, AGAIN, SECOND } do
    local began, before = socket.gettime(), count_events()
    problems = problems .. load_file(file)
    texts[i] = ("%.2f s, %d events"):format(socket.gettime() - began,
      count_events() - before)
  end
  problems = problems .. finish()
  server:sql("SELECT pg_cancel_backend(pid) FROM pg_stat_activity "
    .. "WHERE application_name = 'reader'")
  finish_reader()
  local taken = server:sql([[
SELECT sum((data->'root'->>'n')::int), (SELECT count(*) FROM rfsm.history
  WHERE src <> tgt) FROM rfsm.machines]]):match("[^\n]*")
  local all = 2 * CLIENTS * EVENTS
  return ("%s; %s of %d events%s"):format(table.concat(texts, "; "), taken, all,
    problems ~= "" and "\n" .. problems or ""),
    problems == "" and taken == all .. "|" .. all
end

local good = 0
for i = 1, ROUNDS do
  local line, is_good = run_round()
  print(("%2d  %s"):format(i, line))
  good = good + (is_good and 1 or 0)
end
print(("%d of %d rounds: each load has ended, each event was taken once"):format(
  good, ROUNDS))
servers.stop_all()
helper.remove_files()
os.exit(good == ROUNDS and 0 or 1)
