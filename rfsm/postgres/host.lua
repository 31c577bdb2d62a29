--- What stands for Redis inside PostgreSQL: `rfsm.server.functions` runs here as it is,
-- on a row of rfsm.machines in place of a key.
--
-- `rfsm.postgres.bundle` puts this text in front of a library of `rfsm.redis`. A call
-- collects what the function writes, then one statement saves the row. An error of the
-- function is an error of SQL, so the transaction changes nothing.
--
-- @module rfsm.postgres.host
-- @license BSD-3-Clause

local ipairs, setmetatable, tonumber = ipairs, setmetatable, tonumber
local tostring, type = tostring, type
local floor = math.floor

--- What a call has to do with one machine.
---@class rfsm.postgres.Row
---@field key string
---@field list any[]|nil the value of the machine
---@field is_new boolean
---@field is_changed boolean
---@field event string|nil by which the machine has moved
---@field emitted { what: string, data: any }[]
---@field errors string[] for the log

local READ_ONLY = { rfsm_get = true, rfsm_why = true }

-- Each statement by its name: text, types of arguments.
local STATEMENTS = {
  read = { "SELECT value FROM rfsm.machines WHERE key = $1", "text" },
  lock = { "SELECT value FROM rfsm.machines WHERE key = $1 FOR UPDATE", "text" },
  time = { "SELECT extract(epoch FROM clock_timestamp())::float8 * 1e6 AS us" },
  insert = { [[INSERT INTO rfsm.machines
    (key, chart, version, state, mode, event, due, data, value, since)
    VALUES ($1, $2, $3, $4, $5, coalesce($6, ''), to_timestamp($7), $8, $9,
      clock_timestamp())
    ON CONFLICT (key) DO NOTHING]],
    "text", "text", "text", "text", "text", "text", "float8", "jsonb", "jsonb" },
  update = { [[UPDATE rfsm.machines SET chart = $2, version = $3, state = $4, mode = $5,
    event = coalesce($6, event), due = to_timestamp($7), data = $8, value = $9,
    since = CASE WHEN state = $4 THEN since ELSE clock_timestamp() END
    WHERE key = $1]],
    "text", "text", "text", "text", "text", "text", "float8", "jsonb", "jsonb" },
  emit = { "INSERT INTO rfsm.out (key, what, data) VALUES ($1, $2, $3)",
    "text", "text", "jsonb" },
  newest = { "SELECT obj_description('rfsm.call'::regproc, 'pg_proc') AS library" },
  call = { "SELECT rfsm.call($1, $2, $3, $4) AS reply", "text", "text", "text[]",
    "text" },
  log = { "INSERT INTO rfsm.log (key, error) VALUES ($1, $2)", "text", "text" },
}

-- Returns a function that executes one of the statements.
local function executor(spi)
  local prepared = {}
  return function(name, ...)
    local statement = prepared[name]
    if not statement then
      local text, types = STATEMENTS[name][1], {}
      for i = 2, #STATEMENTS[name] do types[i - 1] = STATEMENTS[name][i] end
      statement = spi.prepare(text, types)
      prepared[name] = statement
    end
    return statement:execute(...)
  end
end

-- JSON: values of the type jsonb ----------------------------------------------

local function new_json(pgtype)
  local set_as_unknown = require("pllua.jsonb").set_as_unknown
  local PLAIN = { map = function(key, value)
    if type(value) == "table" then set_as_unknown(value) end
    return key, value
  end }
  local json = {}

  -- Returns a table without metatables.
  function json.to_table(datum)
    local t = datum(PLAIN)
    return type(t) == "table" and set_as_unknown(t) or t
  end

  function json.encode(value) return pgtype.jsonb(value) end

  function json.decode(text) return json.to_table(pgtype.jsonb:fromstring(text)) end

  return json
end

-- A value is the list itself; its length is that of its JSON.
local Value = {}

function Value:__len() return #tostring(self.datum) end

-- Commands of Redis -----------------------------------------------------------

-- Returns the fields of an entry of a stream: names and values after the "*".
local function fields_of(...)
  local list, fields, at = { ... }, {}, 1
  while list[at] ~= "*" do at = at + 1 end
  for i = at + 1, #list, 2 do fields[list[i]] = list[i + 1] end
  return fields
end

-- Returns the commands that a function calls; those that are not here have nothing to
-- do, as columns and triggers of the table do it.
local function new_commands(execute, json, row_of)
  local commands = {}

  function commands.GET()
    local row = row_of()
    if not row.list then
      local found = execute(row.is_read and "read" or "lock", row.key)[1]
      if not found then return false end
      row.list = json.to_table(found.value)
    end
    return setmetatable({ list = row.list }, Value)
  end

  function commands.EXISTS() return commands.GET() and 1 or 0 end

  function commands.SET(_, value)
    local row = row_of()
    row.is_new, row.is_changed = row.list == nil, true
    row.list, row.datum = value.list, value.datum
  end

  function commands.TIME()
    local us = execute("time")[1].us
    local sec = floor(us / 1e6)
    return { ("%.0f"):format(sec), ("%.0f"):format(us - sec * 1e6) }
  end

  function commands.TYPE() return { ok = "none" } end

  function commands.XADD(_, ...)
    local row, fields = row_of(), fields_of(...)
    if fields.what then
      row.emitted[#row.emitted + 1] = { what = fields.what, data = fields.data }
    elseif fields.event then
      row.event = fields.event
    else
      row.errors[#row.errors + 1] = fields.error
    end
  end

  return commands
end

-- Calls -----------------------------------------------------------------------

-- Returns the text of an error in the words of SQL.
local function in_sql(text)
  return (text:gsub("^ERR rfsm_(%l[%l_]*): ", "rfsm.%1: ")
    :gsub("%(rfsm_create makes one%)$", "(rfsm.create makes one)")
    :gsub("^ERR ", ""))
end

-- Writes a row; `view` is what rfsm_get shows of it.
local function save(spi, execute, row, view)
  local fields = {}
  for i = 1, #view, 2 do fields[view[i]] = view[i + 1] end
  local count = execute(row.is_new and "insert" or "update", row.key, fields.chart,
    fields.version, fields.leaf, fields.mode, row.event, tonumber(fields.due),
    fields.data, row.datum)
  if count ~= 1 then
    spi.error("raise_exception", "rfsm.create: something is at '" .. row.key .. "'")
  end
  for _, entry in ipairs(row.emitted) do
    execute("emit", row.key, entry.what, entry.data ~= "" and entry.data or nil)
  end
  for _, text in ipairs(row.errors) do
    execute("log", row.key, text)
    spi.warning(row.key .. ": " .. text)
  end
end

--- Return what a library needs of Redis, and the function that calls it.
---@param spi table
---@param pgtype table
---@param id string of the library
---@return table host `redis`, `cjson`, `cmsgpack`, `answer(name, key, args, id)`
return function(spi, pgtype, id)
  local functions, row = {}, nil
  local execute, json = executor(spi), new_json(pgtype)
  local commands = new_commands(execute, json, function() return row end)
  local host = { cjson = json }

  host.redis = {
    LOG_NOTICE = "log", log = spi.elog,
    register_function = function(f) functions[f.function_name] = f.callback end,
    call = function(name, ...) return commands[name] and commands[name](...) end,
    acl_check_cmd = function() return true end,
    error_reply = function(text) return { err = text } end,
  }

  host.cmsgpack = {
    pack = function(list)
      return setmetatable({ list = list, datum = json.encode(list) }, Value)
    end,
    unpack = function(value) return value.list end,
  }

  -- A call that began before another library was loaded may come to a machine that
  -- has been there: then the new one answers.
  local function fail(text, ...)
    if execute("newest")[1].library ~= "library " .. id then
      return execute("call", ...)[1].reply
    end
    spi.error("raise_exception", in_sql(text))
  end

  -- Calls a function of the library for the machine at a key; returns the reply as
  -- texts.
  function host.answer(name, key, list, event_id)
    local own = { key = key, is_read = READ_ONLY[name], emitted = {}, errors = {} }
    local args = list and list { null = "" } or {}
    if event_id then args[#args + 1], args[#args + 2] = "ID", event_id end
    row = own
    local reply, view = functions[name]({ key }, args), nil
    if type(reply) == "table" and reply.err then
      return fail(reply.err, name, key, list, event_id)
    end
    if own.is_changed then view = functions.rfsm_get({ key }, {}) end
    row = nil
    if view then save(spi, execute, own, view) end
    if not reply then return nil end
    return type(reply) == "table" and reply or { tostring(reply) }
  end

  return host
end
