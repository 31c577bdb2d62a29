-- The claim of spec/support/claims/fleet.lua for a real PostgreSQL: calls go to its
-- functions or to a client that runs the charts, one or the other at random. A worker
-- takes what is emitted; some entries fail, and come again; dead ones are sent again.

local codec = require "rfsm.server.codec"
local helper = require "spec.helper"
local new_random = require "spec.support.random"
local punctual = require "spec.support.punctual"
local servers = require "spec.support.servers"

local Fleet = {}
Fleet.__index = Fleet

local function quoted(text) return "'" .. tostring(text):gsub("'", "''") .. "'" end

-- Returns the rows of a query.
local function rows_of(self, query)
  local cursor, problem = self.connection:execute(query)
  if not cursor then error(problem, 0) end
  local rows = {}
  if type(cursor) ~= "userdata" then return rows end
  local row = cursor:fetch({}, "a")
  while row do
    rows[#rows + 1] = row
    row = cursor:fetch({}, "a")
  end
  cursor:close()
  return rows
end

function Fleet:pass(seconds)
  self.now = self.now + seconds
  rows_of(self, ("UPDATE clock.state SET at = to_timestamp(%.6f)"):format(self.now))
end

-- Calls a function inside the server; one that replies with a number has a text here.
local function call(self, name, ...)
  local list, id = { ... }, nil
  if list[#list - 1] == "ID" then id = table.remove(list) table.remove(list) end
  for i, text in ipairs(list) do list[i] = quoted(text) end
  local rows = rows_of(self, ("SELECT to_json(rfsm.call('rfsm_%s', 'm', "
    .. "ARRAY[%s]::text[], %s)) AS reply"):format(name, table.concat(list, ", "),
    id and quoted(id) or "NULL"))
  local reply = codec.decode(rows[1].reply)
  return #reply == 1 and tonumber(reply[1]) or reply
end

function Fleet:ask(name, ...)
  if self.random:chance(50) then return call(self, name, ...) end
  local reply, problem = self.client:ask("rfsm_" .. name, "m", ...)
  if problem then error(problem, 0) end
  return reply
end

function Fleet:wake()
  if self.random:chance(50) then self.client:wake() end
  rows_of(self, "SELECT rfsm.wake()")
end

-- Takes what was emitted, until all is done; returns the texts as they were done. What
-- has failed comes again after a minute; what has failed twice is among the dead.
local function take_all(self)
  local done = {}
  for _ = 1, 1000 do
    if rows_of(self, "SELECT count(*) FROM rfsm.out")[1].count == "0" then break end
    local taken = rows_of(self, "SELECT * FROM rfsm.take(3, '10 seconds', 2)")
    for _, row in ipairs(taken) do
      if self.random:chance(60) then
        rows_of(self, ("SELECT rfsm.done(%s)"):format(row.id))
        done[#done + 1] = codec.decode(row.data).by
      else
        rows_of(self, ("SELECT rfsm.fail(%s, 'no paper')"):format(row.id))
      end
    end
    self:pass(60)
    rows_of(self, "SELECT rfsm.again(id) FROM rfsm.dead")
  end
  return done
end

function Fleet:result()
  local view, trace, written = self.client:get("m"), {}, {}
  for i, row in ipairs(rows_of(self, "SELECT tgt FROM rfsm.history "
    .. "WHERE src IS DISTINCT FROM tgt ORDER BY id")) do
    trace[i] = row.tgt
  end
  for i, row in ipairs(rows_of(self, "SELECT data->>'by' AS by FROM rfsm.out "
    .. "ORDER BY id")) do
    written[i] = row.by
  end
  local done, sorted = take_all(self), {}
  for i, text in ipairs(written) do sorted[i] = text end
  table.sort(done)
  table.sort(sorted)
  if table.concat(done) ~= table.concat(sorted) then
    error("done: " .. table.concat(done, " "), 0)
  end
  self.client:remove("m")
  rows_of(self, "TRUNCATE rfsm.history")
  return { data = view.data.root, trace = trace, out = written }
end

-- Returns what makes fleets of the charts with seeds.
local function open(server, seeds)
  server:stop_clock(1000)
  local files, options = punctual.files(seeds), { ids = 1000, history = true }
  local output = server:sql((require("rfsm.postgres.script").sql(files, options)))
  assert(output == "", output)
  local function connect()
    return require("luasql.postgres").postgres():connect("postgres", "postgres", "",
      server.folder)
  end
  local postgres = require "rfsm.postgres"
  local client = postgres.connect(postgres.charts(files, { ids = 1000 }), connect)
  local connection = assert(connect())
  return function(seed)
    server:stop_clock(1000)
    return setmetatable({ now = 1000, client = client, connection = connection,
      random = new_random(seed * 17) }, Fleet)
  end
end

return { name = "a fleet in PostgreSQL", run = function(n, seed)
  if servers.no_postgres() or not helper.package "luasql.postgres" then return 0 end
  return punctual.compare_server(n, seed,
    servers.postgres("-c synchronous_commit=off"), open)
end }
