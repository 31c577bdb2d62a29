-- A table in place of PostgreSQL: it knows the statements of the client. Connections to
-- it may be lost.

local encoding = require "rfsm.snapshot.encoding"
local rfsm = require "rfsm"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local net = {}

--- A stand-in server.
---@class PostgresNet
---@field tables table `machines` by key, `out`, `log`: as of the last COMMIT
---@field trace string[] first words of statements
---@field now number seconds
---@field opened integer connections that were opened
---@field fault fun(words: string, when: string): string? called "before" and "after" a
--- statement: "lost", or the text of an error
local Net = {}
Net.__index = Net

local COLUMNS = { "key", "chart", "version", "state", "mode", "event", "due", "data",
  "value" }

local statements = {}

function statements.read(self, tables, key)
  local row = tables.machines[key]
  return { { value = row and row.value, us = ("%.6f"):format(self.now * 1e6) } }
end

function statements.leased(self, tables, key)
  local row = statements.read(self, tables, key)[1]
  row.key = row.value and key
  return { row }
end

function statements.lease(self, tables)
  for _, key in ipairs(rfsm.sorted_keys(tables.machines)) do
    local row = tables.machines[key]
    if row.due and tonumber(row.due) <= self.now then
      row.leases, row.due = (row.leases or 0) + 1, self.now + 10
      return { { key = key, leases = row.leases } }
    end
  end
  return { {} }
end

function statements.write(_, tables, is_new, ...)
  local row, key = {}, (...)
  for i, name in ipairs(COLUMNS) do row[name] = (select(i, ...)) end
  if is_new == (tables.machines[key] ~= nil) then return {} end
  tables.machines[key] = row
  return { { key = key } }
end

function statements.aside(self, tables, key)
  tables.machines[key].due = self.now + 60
  return {}
end

function statements.note(_, tables, name, ...)
  table.insert(tables[name], { ... })
  return {}
end

-- No spec looks at what this changes.
function statements.move() return {} end

local IS_READING = { read = true, leased = true }

-- Returns what a statement does.
local function find(sql)
  if sql:find("^UPDATE rfsm.machines SET state") then return "move" end
  if sql:find("^WITH trimmed") then return "note", "log" end
  if sql:find("rfsm.lease()", 1, true) then return "lease" end
  if sql:find("rfsm.leased", 1, true) then return "leased" end
  if sql:find("^SELECT value") then return "read" end
  if sql:find("^INSERT INTO rfsm.machines") then return "write", true end
  if sql:find("^UPDATE rfsm.machines SET chart") then return "write", false end
  if sql:find("^UPDATE rfsm.machines SET due") then return "aside" end
  local name = sql:match("^INSERT INTO rfsm%.(%l+)")
  if name then return "note", name end
  error("unknown statement: " .. sql)
end

-- Does what a transaction has written once more, to what is there now.
local function commit(self, connection)
  local tables = encoding.copy_of(self.tables)
  for _, write in ipairs(connection.writes) do
    statements[write.name](self, tables, unpack(write, 1, write.n))
  end
  self.tables = tables
end

local function execute(self, connection, sql, ...)
  if sql == "BEGIN" then
    connection.tables, connection.writes = encoding.copy_of(self.tables), {}
  elseif sql == "COMMIT" then
    commit(self, connection)
  elseif sql ~= "ROLLBACK" then
    local name, argument = find(sql)
    local call = { name = name, n = select("#", ...), ... }
    if argument ~= nil then call = { name = name, n = call.n + 1, argument, ... } end
    if not IS_READING[name] then table.insert(connection.writes, call) end
    return statements[name](self, connection.tables, unpack(call, 1, call.n))
  end
  return {}
end

--- Opens a connection: a function that runs statements.
function Net:open()
  local connection = { tables = false, writes = false, is_lost = false,
    is_broken = false }
  self.opened = self.opened + 1
  local function fail(kind)
    connection.is_lost = kind == "lost" or connection.is_lost
    connection.is_broken = true
    return nil, kind == "lost" and "server closed the connection\n  LINE 1"
      or "driver: ERROR:  " .. kind .. "\nCONTEXT: x"
  end
  return function(sql, ...)
    local words = sql:match("^%u[%u ]*%l*%.?%l*")
      .. (sql:match(" FOR UPDATE[%u ]*") or "")
    self.trace[#self.trace + 1] = words
    if connection.is_lost then return fail "lost" end
    local kind = self.fault(words, "before")
    if kind then return fail(kind) end
    if connection.is_broken and sql ~= "ROLLBACK" then return fail "aborted" end
    connection.is_broken = false
    local rows = execute(self, connection, sql, ...)
    kind = self.fault(words, "after")
    if kind then return fail(kind) end
    return rows
  end
end

function net.new()
  return setmetatable({ tables = { machines = {}, out = {}, log = {} }, trace = {},
    now = 1000, opened = 0, fault = function() end }, Net)
end

return net
