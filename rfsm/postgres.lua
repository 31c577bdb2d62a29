--- A fleet of machines in PostgreSQL: the client, for servers without PL/Lua.
--
-- This process runs the functions that Redis and PL/Lua run in the server. It uses the
-- tables that the command `rfsm postgres` makes. A call locks the row of its machine,
-- runs the machine and saves it, in one transaction. So several clients, and functions
-- in the server, may drive the same machine.
--
-- Statements are run by a connection of LuaSQL, or by a function of the user.
--
-- @module rfsm.postgres
-- @license BSD-3-Clause

local script = require "rfsm.postgres.script"
local Base = require "rfsm.server.client"
local host = require "rfsm.postgres.host"
local lease = require "rfsm.server.lease"
local codec = require "rfsm.server.codec"
local digits_of = require("rfsm.shared.exact_json").digits_of
local opts = require "rfsm.shared.options"
local rfsm = require "rfsm"
local sandbox = require "rfsm.server.sandbox"
local try = require("rfsm.shared.calls").try

local error, ipairs, pairs, pcall = error, ipairs, pairs, pcall
local select = select
local setmetatable, tonumber, tostring = setmetatable, tonumber, tostring
local type = type

local postgres = {}

-- Statements ----------------------------------------------------------------------

-- Returns a statement that reads machines, and then the time, since it may have to wait
-- for a lock. If there is no machine, it returns one row that has only the time.
local function reading(rows)
  return ([[SELECT value::text, key,
    (extract(epoch FROM clock_timestamp()) * 1e6)::text AS us
    FROM (SELECT 1) one LEFT JOIN (SELECT key, value FROM rfsm.%s) m ON true]])
    :format(rows)
end

local READ = reading "machines WHERE key = $1"
local LOCK = reading "machines WHERE key = $1 FOR UPDATE"
local LEASED = reading "leased($1)"
local LEASE = "SELECT key, leases FROM rfsm.lease()"
local ASIDE = "UPDATE rfsm.machines SET due = clock_timestamp() + interval '1 minute', "
  .. "leases = 0 WHERE key = $1"

-- Charts --------------------------------------------------------------------------

--- Charts loaded in this process, for the machines of any number of connections.
---@class rfsm.postgres.Charts
---@field answer function calls a function such as "rfsm_tick" for a machine

local NUMBER = opts.whole(1, 1e6)
local CHART_OPTIONS = { ids = NUMBER, ids_for = NUMBER,
  history = { "boolean", opts.is_a "boolean" } }

--- Load charts as `rfsm postgres` does, with the globals that they have in the server.
-- @raise if a chart has a problem; its text is one line
---@param arguments string[] files, or NAME=FILE; if a name occurs again, the later file
--- is the newer version of the chart
---@param options? rfsm.postgres.Options `ids`, `ids_for`; `history` if the tables were
--- made with --history: then events without a move are noted in the history, too
---@return rfsm.postgres.Charts charts for any number of connections
---@return string[] warnings
function postgres.charts(arguments, options)
  if type(arguments) ~= "table" or arguments[1] == nil then
    error("rfsm.postgres.charts: list of files expected, " .. opts.got(arguments), 2)
  end
  local settings = opts.take("rfsm.postgres.charts", CHART_OPTIONS, options)
  local text, warnings = script.library(arguments, settings)
  local json = { encode = codec.encode, decode = codec.decode, datum = rfsm.text_of }
  local answer = host.new({ json = json, warn = function() end,
    refuse = function(reason) error(reason, 0) end,
  }, sandbox.run(text, { cjson = json }, "PostgreSQL", function(line) print(line) end))
  return { answer = answer }, warnings
end

-- Connect -------------------------------------------------------------------------

-- Returns a function that runs statements in a connection of LuaSQL. LuaSQL knows no
-- parameters, so the values are put into the text.
local function of_luasql(connection)
  return function(sql, ...)
    local values, is_text = { ... }, true
    sql = sql:gsub("%$(%d+)", function(number)
      local value = values[tonumber(number)]
      if value == nil then return "NULL" end
      value = type(value) == "number" and digits_of(value) or tostring(value)
      local text = not value:find("\0", 1, true) and connection:escape(value) or nil
      is_text = is_text and text ~= nil
      return text and "'" .. text .. "'"
    end)
    if not is_text then return nil, "a text is not valid in the server's encoding" end
    local cursor, problem = connection:execute(sql)
    if not cursor then return nil, problem end
    local rows = {}
    if type(cursor) == "number" then return rows end
    for i = 1, cursor:numrows() do rows[i] = cursor:fetch({}, "a") end
    cursor:close()
    return rows
  end
end

--- Runs a statement; `...` has the values of its parameters $1, $2 and so on. Returns
--- its rows, or nil and the problem.
---@alias rfsm.postgres.Query fun(sql: string, ...: string?): table[]?, string?

--- A connection to the machines in a server.
---@class rfsm.postgres.Client : rfsm.server.Client
---@field charts rfsm.postgres.Charts
---@field open fun(): any, string? opens a connection, the argument of `connect`
---@field query rfsm.postgres.Query|false false: the connection is lost
---@field options table `patience` and `sleep`, the options of `connect`
---@field failure string|false the first error in a call of `transaction`
---@field is_open boolean a call of `transaction` is under way
local Client = { where = "rfsm.postgres" }
Client.__index = Client
for name, f in pairs(Base) do Client[name] = f end -- any order: a copy

-- Returns the text of an error in one line, without the prefix that a driver adds.
local function reason_of(problem)
  local text = rfsm.text_of(problem)
  return text:match("ERROR:%s+([^\n]*)") or text:match("[^\n]+") or text
end

local function connect(self)
  if self.query then return end
  local made, problem = self.open()
  if not made then error("cannot connect: " .. reason_of(problem), 0) end
  self.query = type(made) == "function" and made or of_luasql(made)
end

local function query(self, sql, ...)
  local rows, problem = self.query(sql, ...)
  if not rows then error(reason_of(problem), 0) end
  return rows
end

local LIMIT = opts.whole(1, 10000)

local OPTIONS = {
  patience = { "seconds", opts.is_seconds, 10 },
  sleep = { "function", opts.is_a "function" },
}

--- Connect to a server that has the tables of the command `rfsm postgres`.
--
-- Those of `rfsm postgres --client` are enough.
--
-- @usage
--    local charts = postgres.charts { "order.lua" }
--    local orders = postgres.connect(charts, function()
--      return require("luasql.postgres").postgres():connect("shop")
--    end)
--
-- @raise if there is no server
---@param charts rfsm.postgres.Charts
---@param open fun(): any, string? returns a connection of LuaSQL, or a function
--- `query(sql, ...)` for another driver; it is called again when the connection is lost
---@param options? table `patience`: for how many seconds a call tries to reach a server
--- (10); `sleep`: a function that waits for some seconds (default: that of luasocket)
---@return rfsm.postgres.Client client
function postgres.connect(charts, open, options)
  local settings = opts.take("rfsm.postgres.connect", OPTIONS, options)
  if type(charts) ~= "table" or not charts.answer then
    error("rfsm.postgres.connect: result of rfsm.postgres.charts expected, "
      .. opts.got(charts), 2)
  end
  if type(open) ~= "function" then
    error("rfsm.postgres.connect: function expected that opens a connection, "
      .. opts.got(open), 2)
  end
  local self = setmetatable({ charts = charts, open = open, query = false,
    options = settings, failure = false, is_open = false, id = Base.new_id(),
    count = 0 }, Client)
  connect(self)
  return self
end

-- Transactions --------------------------------------------------------------------

-- Rolls a failed transaction back. If the rollback fails, too, the connection is lost.
local function roll_back(self)
  if not self.query then return end
  local ok, rows = pcall(self.query, "ROLLBACK")
  if not (ok and rows) then self.query = false end
end

-- Calls f(self, ...) in a transaction; returns true and its result, or false and the
-- error, as pcall does. An interrupt is raised.
local function in_transaction(self, f, ...)
  local ok, result = pcall(function(...)
    connect(self)
    query(self, "BEGIN")
    local reply = f(self, ...)
    query(self, "COMMIT")
    return reply
  end, ...)
  if not ok then
    roll_back(self)
    if rfsm.is_interrupt(result) then error(result, 0) end
  end
  return ok, result
end

-- Waits for a moment; returns false if there is no function that sleeps.
local function pause(self)
  local socket = not self.options.sleep and opts.find_package("socket")
  local sleep = self.options.sleep or socket and socket.sleep
  if not sleep then return false end
  sleep(0.1)
  return true
end

-- Calls f(self, ...) in a transaction. If the connection is lost, tries again as long
-- as `patience` allows. In a call of `transaction`, f is called once, without another
-- transaction, and the user has to try again.
local function run(self, f, ...)
  if self.is_open then
    local ok, result = try(f, self, ...)
    if not ok then self.failure = self.failure or result end
    return ok, result
  end
  local ok, result = in_transaction(self, f, ...)
  for _ = 1, self.options.patience * 10 do
    if ok or self.query or not pause(self) then break end
    ok, result = in_transaction(self, f, ...)
  end
  return ok, result
end

--- Call `f(query)` in a transaction. If anything fails, all that `f` has done with
-- machines of this client, and by `query`, is undone.
---@param f fun(query: rfsm.postgres.Query)
---@return boolean ok
---@return string? problem
function Client:transaction(f)
  if self.is_open then
    error("rfsm.postgres.transaction: one runs already", 2)
  end
  local ok, problem = in_transaction(self, function()
    self.is_open, self.failure = true, false
    f(function(sql, ...) return query(self, sql, ...) end)
    if self.failure then error(self.failure, 0) end
  end)
  self.is_open, self.failure = false, false
  return ok, not ok and reason_of(problem) or nil
end

-- Machines ------------------------------------------------------------------------

-- Calls a function of the charts for a machine whose row was read.
local function answer(self, name, key, args, row)
  return self.charts.answer(name, key, args, {
    list = row.value and codec.decode(row.value), us = tonumber(row.us),
    execute = function(statement, ...)
      return query(self, host.STATEMENTS[statement], ...)
    end,
  })
end

local function call(self, name, key, ...)
  local row = query(self, host.READ_ONLY[name] and READ or LOCK, key)[1]
  return answer(self, name, key, { ... }, row)
end

--- Call a function of `rfsm.server.functions` for a machine.
---@param name string
---@param key any
---@param ... any
---@return any? reply
---@return string? problem
function Client:ask(name, key, ...)
  if key == nil or type(key) == "table" then
    error("rfsm.postgres: key of a machine expected, got " .. type(key), 0)
  end
  local ok, reply = run(self, call, name, rfsm.text_of(key), ...)
  if ok then return reply, not reply and "no machine" or nil end
  return nil, reason_of(reply)
end

-- Workers -------------------------------------------------------------------------

-- Delays a machine that cannot be run by a minute, and writes the reason to the log.
local function put_aside(self, key, problem)
  query(self, ASIDE, key)
  query(self, host.STATEMENTS.log, key, reason_of(problem))
end

-- Runs a leased machine, unless another session has it. Returns the name of a count;
-- nil if it was not run.
local function run_leased(self, key)
  local row = key and query(self, LEASED, key)[1]
  if not (row and row.key) then return nil end
  local ok, problem = try(answer, self, "rfsm_tick", key, { "due" }, row)
  if not ok and not try(put_aside, self, key, problem) then error(problem, 0) end
  return ok and "woken" or "failed"
end

-- Leases the machine that is due first; returns its key, or nil. A machine that had too
-- many leases is held.
local function lease_next(self)
  local key
  repeat
    local row = query(self, LEASE)[1]
    key = row and row.key
    local has_ended = not key or tonumber(row.leases) <= lease.MOST
    if not has_ended then call(self, "rfsm_hold", key, lease.REASON) end
  until has_ended
  return key
end

-- Runs the machine that the transaction before has leased, and leases the next one.
local function run_next(self, key, is_last)
  local name = run_leased(self, key)
  return { name = name, key = not is_last and lease_next(self) or nil }
end

-- The same in a transaction. If a statement fails, the transaction fails, and the
-- machine is put aside in another one. Returns the name of a count or nil, and the key
-- of the next machine.
local function wake_one(self, key, is_last)
  local ok, done = run(self, run_next, key, is_last)
  if ok then return done.name, done.key end
  local can_go_on = key and self.query and not self.is_open
  if not (can_go_on and run(self, put_aside, key, done)) then
    error("rfsm.postgres.wake: " .. reason_of(done), 0)
  end
  return "failed", select(2, wake_one(self, nil, is_last))
end

--- Run the machines whose timers are due, each in a transaction. It is leased in the
-- one before, so that a machine that comes to no end does not hold up the others after
-- this process has ended. A failed one is put aside for a minute.
-- @raise if no server answers
---@param limit? integer how many machines are run at most (100)
---@return integer count machines that were run
---@return integer failed machines that were put aside
function Client:wake(limit)
  limit = limit or 100
  if not LIMIT[2](limit) then
    error(("rfsm.postgres.wake: %s expected, %s"):format(LIMIT[1], opts.got(limit)), 2)
  end
  local counts, key = { woken = 0, failed = 0 }, nil
  for i = 0, limit do
    local name, next_key = wake_one(self, key, i == limit)
    if name then counts[name] = counts[name] + 1 end
    if not next_key then break end
    key = next_key
  end
  return counts.woken, counts.failed
end

-- Questions -----------------------------------------------------------------------

-- Returns the rows of a statement, which is a transaction unless one is open.
local function ask_rows(self, where, sql, ...)
  local ok, rows = run(self, query, sql, ...)
  if ok then return rows end
  error("rfsm.postgres." .. where .. ": " .. reason_of(rows), 0)
end

--- Return the latest errors of a machine, the newest first.
-- @raise if no server answers, as the methods below do
---@param key any
---@param count? integer default 10
---@return { time: number, error: string }[] lines
function Client:log(key, count)
  local lines = ask_rows(self, "log", [[SELECT extract(epoch FROM at)::text AS time,
    error FROM rfsm.log($1, $2::integer)]], rfsm.text_of(key), count or 10)
  for _, line in ipairs(lines) do line.time = tonumber(line.time) end
  return lines
end

local function keys_of(rows)
  for i, row in ipairs(rows) do rows[i] = row.key end
  return rows
end

--- Return the keys of machines that are due.
---@param limit? integer default 100
---@return string[] keys
function Client:due(limit)
  return keys_of(ask_rows(self, "due", "SELECT key FROM rfsm.due($1::integer)",
    limit or 100))
end

--- Return the keys of machines in a state.
---@param chart string
---@param state string FQN of a leaf or composite
---@param limit? integer default 100
---@param seconds? number return only machines that are in their leaf for so long
---@return string[] keys
function Client:find(chart, state, limit, seconds)
  return keys_of(ask_rows(self, "find", "SELECT key FROM rfsm.find($1, $2, "
    .. "$3::integer, $4::interval) key", chart, state, limit or 100,
    (seconds or 0) .. " s"))
end

--- Count the machines of each version of each chart.
---@return { chart: string, version: string, count: integer }[] list
function Client:versions()
  local list = ask_rows(self, "versions", "SELECT chart, version, machines AS count "
    .. "FROM rfsm.versions()")
  for _, row in ipairs(list) do row.count = tonumber(row.count) end
  return list
end

-- Entries -------------------------------------------------------------------------

--- An event that a machine has emitted.
---@class rfsm.postgres.Entry
---@field id string for `answer` and `send_once`
---@field number integer its id in the tables rfsm.out and rfsm.dead
---@field machine string its key
---@field what string
---@field data any
---@field tries integer how often a worker got it
---@field error string? of a dead entry: the error of the last try

local function entry_of(row)
  return { id = "out-" .. row.id, number = tonumber(row.id), machine = row.key,
    what = row.what, data = row.data and codec.decode(row.data),
    tries = tonumber(row.tries), error = row.error }
end

local function ask_entries(self, where, sql, ...)
  local entries = {}
  for i, row in ipairs(ask_rows(self, where, sql, ...)) do
    entries[i] = entry_of(row)
  end
  return entries
end

-- Calls a function of SQL for an entry, or its number; returns what that returns, a
-- boolean.
local function ask_about(self, name, entry, ...)
  local number = type(entry) == "table" and entry.number or entry
  if type(number) ~= "number" or number % 1 ~= 0 then
    error(("rfsm.postgres.%s: an entry or its number expected, %s"):format(name,
      rfsm.got(entry)), 0)
  end
  local sql = ("SELECT rfsm.%s($1::bigint%s)::text AS answer"):format(name,
    select("#", ...) > 0 and ", $2" or "")
  return ask_rows(self, name, sql, ("%d"):format(number), ...)[1].answer == "true"
end

local WORK = {
  count = opts.whole(1, 1e6, 1),
  lease = { "seconds", opts.is_seconds, 30 },
  tries = opts.whole(1, 1000, 5),
}

local function take(self, where, options)
  local settings = opts.take("rfsm.postgres." .. where, WORK, options, 4)
  return ask_entries(self, where, [[SELECT id, key, what, data::text, try AS tries
    FROM rfsm.take($1::integer, $2::interval, $3::integer)]], settings.count,
    settings.lease .. " s", settings.tries)
end

--- Take entries, each of which the caller ends by `done` or `fail`. No other worker
-- gets them until their lease is over: `lease` seconds, twice as long with each try.
---@param options? { count: integer?, lease: number?, tries: integer? } by default
--- `count` is 1, `lease` is 30, and `tries` is 5
---@return rfsm.postgres.Entry[] entries
function Client:take(options)
  local entries = take(self, "take", options) -- no tail call: it blames the caller
  return entries
end

--- An entry is done. Call it in the transaction that sends the answer.
---@param entry rfsm.postgres.Entry
---@return boolean was_there
function Client:done(entry) return ask_about(self, "done", entry) end

--- The try has failed: the entry comes again when its lease is over.
---@param entry rfsm.postgres.Entry
---@param reason string
---@return boolean was_there
function Client:fail(entry, reason)
  return ask_about(self, "fail", entry, rfsm.text_of(reason))
end

--- Call `f(entry)` for each entry that no other worker has. If `f` raises an error, or
-- the worker dies, the entry comes again, see `take`. After `tries` calls it is dead.
---@param f fun(entry: rfsm.postgres.Entry)
---@param options? { count: integer?, lease: number?, tries: integer? } as for `take`
---@return integer count entries that are done
---@return string[] failures errors of `f`
function Client:work(f, options)
  local count, failures = 0, {}
  for _, entry in ipairs(take(self, "work", options)) do
    local ok, problem = try(f, entry)
    if ok then
      count = count + (self:done(entry) and 1 or 0)
    else
      failures[#failures + 1] = rfsm.text_of(problem)
      self:fail(entry, problem)
    end
  end
  return count, failures
end

--- Return dead entries, the oldest first.
---@param limit? integer greatest number of entries (100)
---@return rfsm.postgres.Entry[] entries
function Client:dead(limit)
  return ask_entries(self, "dead", [[SELECT id, key, what, data::text, tries, error
    FROM rfsm.dead ORDER BY id LIMIT $1::integer]], limit or 100)
end

--- Send a dead entry again; it keeps its id.
---@param number integer
---@return boolean was_there
function Client:again(number) return ask_about(self, "again", number) end

--- Drop a dead entry.
---@param number integer
---@return boolean was_there
function Client:drop(number) return ask_about(self, "drop", number) end

return postgres
