--- Make SQL from charts and the core: a schema of PostgreSQL with functions in PL/Lua.
--
-- The command `rfsm postgres` calls this. The functions are the same as in Redis.
--
-- @module rfsm.postgres.script
-- @license BSD-3-Clause

local bundle = require "rfsm.server.bundle"
local host = require "rfsm.postgres.host"
local lease = require "rfsm.server.lease"
local library = require "rfsm.server.library"
local schema = require "rfsm.postgres.schema"
local sums = require "rfsm.shared.sums"

local ipairs, concat = ipairs, table.concat

local script = {}

-- The text in front of the library. It makes the globals of the library, and begins a
-- function whose body is the library. `pcall` of PL/Lua makes a subtransaction, and
-- catches the error by which a call is cancelled; `lpcall` does neither, so it is the
-- `pcall` of charts. No name of the host, such as `spi`, may be in the scope of charts,
-- or of a text that they load.
local HEAD = [[
local globals, sandbox
do
  local load, pcall, outer_require = load, lpcall, require
  %s
  self.serve = require "rfsm.postgres.pllua" (require "rfsm.postgres.host", spi, pgtype,
    "$ID")
  local function finish(handler, ok, ...)
    if ok then return ok, ... end
    return ok, handler((...))
  end
  globals = { os = { clock = os.clock }, pcall = pcall }
  function globals.xpcall(f, handler, ...) return finish(handler, pcall(f, ...)) end
  for name in ([=[assert collectgarbage error getmetatable ipairs next pairs rawequal
    rawget rawset select setmetatable tonumber tostring type coroutine string table math
    _VERSION]=]):gmatch("%%S+") do
    globals[name] = self[name]
  end
  function globals.load(text, name, _, own)
    return load(text, name, "t", own == nil and sandbox or own)
  end
  sandbox = setmetatable({}, {
    __metatable = false,
    __index = function(_, name)
      if globals[name] ~= nil then return globals[name] end
      error("global '" .. tostring(name) .. "' does not exist in PostgreSQL", 2)
    end,
    __newindex = function(_, name)
      error("global '" .. tostring(name) .. "' cannot be set in PostgreSQL", 2)
    end,
  })
end
self.answer = self.serve(function(...)
local self, globals, _ENV = nil, nil, sandbox
]]

local FOOT = "end, globals)\n"

-- Returns a quote of SQL, such as $rfsm$, that the text does not contain.
local function quote_for(text)
  local tag = "$rfsm$"
  while text:find(tag, 1, true) do tag = tag:sub(1, -2) .. "_$" end
  return tag
end

--- Options of the schema.
---@class rfsm.postgres.Options
---@field history? boolean moves, and events that moved nothing, are noted in the table
--- rfsm.history
---@field history_days? integer workers remove what is older from rfsm.history
---@field notify? boolean a trigger reports each move to sessions that LISTEN to rfsm
---@field ids? integer how many ids of events are kept for each machine (16)
---@field ids_for? integer for how many seconds ids are kept (1000)

--- Return the text of the library for machines in a table of PostgreSQL, and a list of
-- warnings. `arguments` are chart files, or NAME=FILE. A wrong chart raises an error.
function script.library(arguments, options)
  return library.text(arguments, "PostgreSQL", options)
end

-- Words of the schema. Functions in SQL run with the rights of their owner, not of
-- their caller.
local RIGHTS = "SECURITY DEFINER SET search_path = pg_catalog, pg_temp"
local WORDS = { SECONDS = lease.SECONDS, MOST = lease.MOST, REASON = lease.REASON,
  OWNER = "LANGUAGE sql " .. RIGHTS, BY = "LANGUAGE plpgsql " .. RIGHTS }

local function schema_of(functions, options)
  local triggers = schema.TRIGGERS:gsub("%$(%u+)", {
    HISTORY = options.history and "true" or "false",
    NOTIFY = options.notify and "true" or "false" })
  local outbox = schema.OUTBOX:gsub("%$(%u+)", WORDS)
  return concat { schema.HEAD, functions, outbox,
    options.history and schema.HISTORY or "", options.notify and schema.NOTIFY or "",
    triggers, schema.FOOT }
end

--- Return SQL that makes the schema `rfsm` with tables and without functions, as
-- `rfsm.postgres` needs it.
function script.tables(options) return schema_of("", options or {}) end

--- Return SQL, and a list of warnings. The SQL makes the schema `rfsm` with functions,
-- or gives other charts to this schema. A wrong chart raises an error.
function script.sql(arguments, options)
  options = options or {}
  local text, warnings = script.library(arguments, options)
  local parts = { bundle.HEAD }
  for _, name in ipairs { "server.verbs", "postgres.host", "postgres.pllua" } do
    bundle.add(parts, "rfsm." .. name)
  end
  local code = HEAD:format(concat(parts)) .. text .. FOOT
  local id = ("%.0f"):format(sums.of(code)) -- two libraries most likely differ in it
  local values = { TAG = quote_for(code), CODE = code:gsub("%$ID", id, 1), ID = id,
    LOG = (host.STATEMENTS.log:gsub("%$%d", { ["$1"] = "each", ["$2"] = "SQLERRM" })) }
  values.TRIM = options.history_days and ("PERFORM rfsm.trim('%d days');"):format(
    options.history_days) or ""
  local names = {}
  for i, argument in ipairs(arguments) do
    names[i] = "'" .. library.name_of(argument):gsub("'", "''") .. "'"
  end
  values.NAMES = concat(names, ", ")
  local functions = schema.FUNCTIONS:gsub("%$(%u+)", WORDS):gsub("%$(%u+)", values)
  return schema_of(functions, options), warnings
end

return script
