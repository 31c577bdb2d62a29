--- What stands for Redis at a table of PostgreSQL: `rfsm.server.functions` runs here as
-- it is, on a row of rfsm.machines in place of a key.
--
-- The functions run inside the server (`rfsm.postgres.pllua`), or in a client
-- (`rfsm.postgres`). A call collects what the function writes, then one
-- statement saves the row. An error changes nothing: the transaction ends with it.
--
-- @module rfsm.postgres.host
-- @license BSD-3-Clause

local ipairs, tostring, type = ipairs, tostring, type
local floor = math.floor
local remove = table.remove

--- What a call has to do with one machine.
---@class rfsm.postgres.Row
---@field key string
---@field list any[]|nil the value of the machine
---@field us number|nil the time in microseconds, if the row was read before the call
---@field execute function|nil then also, in place of the server's
---@field packed any[]|nil the new one, and the same as JSON
---@field datum any
---@field is_new boolean
---@field is_changed boolean
---@field moves { by: string, to: string }[] of the machine, in their order
---@field emitted { what: string, data: any }[]
---@field errors string[] for the log

--- What runs statements.
---@class rfsm.postgres.Server
---@field execute fun(name: string, ...: any): table[] the rows of a statement of `host`
---@field json table `encode`, `decode`; `list_of`: a value of the column `value`;
--- `datum`: JSON for a statement
---@field log fun(...: any)
---@field warn fun(text: string)
---@field refuse fun(text: string): any raises what is wrong with the call, or returns
--- the reply of another library

local host = {}

--- Functions that need no lock.
host.READ_ONLY = { rfsm_get = true, rfsm_why = true }

--- Statements by their name. Those that write return a row for each that they write.
-- Some drivers give each parameter the type text.
host.STATEMENTS = {
  read = "SELECT value FROM rfsm.machines WHERE key = $1",
  lock = "SELECT value FROM rfsm.machines WHERE key = $1 FOR UPDATE",
  time = "SELECT extract(epoch FROM clock_timestamp())::float8 * 1e6 AS us",
  insert = [[INSERT INTO rfsm.machines
    (key, chart, version, state, mode, event, due, data, value, since)
    VALUES ($1, $2, $3, $4, $5, coalesce($6, ''), to_timestamp($7::text::float8),
      $8::jsonb, $9::jsonb, clock_timestamp())
    ON CONFLICT (key) DO NOTHING RETURNING key]],
  update = [[UPDATE rfsm.machines SET chart = $2, version = $3, state = $4, mode = $5,
    event = coalesce($6, event), due = to_timestamp($7::text::float8),
    data = $8::jsonb, value = $9::jsonb,
    since = CASE WHEN state = $4 THEN since ELSE clock_timestamp() END
    WHERE key = $1 RETURNING key]],
  move = [[UPDATE rfsm.machines SET state = $2, event = $3, since = clock_timestamp()
    WHERE key = $1]],
  remove = [[WITH log AS (DELETE FROM rfsm.log WHERE key = $1)
    DELETE FROM rfsm.machines WHERE key = $1 RETURNING key]],
  emit = "INSERT INTO rfsm.out (key, what, data) VALUES ($1, $2, $3::jsonb)",
  log = [[WITH trimmed AS (DELETE FROM rfsm.log WHERE key = $1 AND id <= (SELECT id
      FROM rfsm.log WHERE key = $1 ORDER BY id DESC OFFSET 999 LIMIT 1))
    INSERT INTO rfsm.log (key, error) VALUES ($1, $2)]],
}

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
local function new_commands(server, row_of)
  local commands = {}

  function commands.GET()
    local row = row_of()
    if not (row.list or row.us) then
      local found = server.execute(row.is_read and "read" or "lock", row.key)[1]
      row.list = found and server.json.list_of(found.value)
    end
    return row.list ~= nil
  end

  function commands.EXISTS() return commands.GET() and 1 or 0 end

  function commands.SET()
    local row = row_of()
    row.is_new, row.is_changed, row.list = row.list == nil, true, row.packed
  end

  function commands.DEL(key)
    local row = row_of()
    if key ~= row.key then return 1 end -- its log is gone with it
    return #(row.execute or server.execute)("remove", key)
  end

  function commands.TIME()
    local us = row_of().us or server.execute("time")[1].us
    local sec = floor(us / 1e6)
    return { ("%.0f"):format(sec), ("%.0f"):format(us - sec * 1e6) }
  end

  function commands.TYPE() return { ok = "none" } end

  function commands.XADD(_, ...)
    local row, fields = row_of(), fields_of(...)
    if fields.what then
      row.emitted[#row.emitted + 1] = { what = fields.what, data = fields.data }
    elseif fields.event then
      row.moves[#row.moves + 1] = { by = fields.event, to = fields.to }
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

-- Writes what callbacks have emitted, and their errors.
local function save_effects(server, row, execute)
  for _, entry in ipairs(row.emitted) do
    execute("emit", row.key, entry.what,
      entry.data ~= "" and server.json.datum(entry.data) or nil)
  end
  for _, text in ipairs(row.errors) do
    execute("log", row.key, text)
    server.warn(row.key .. ": " .. text)
  end
end

-- Writes a row, of which `view` is what rfsm_get shows; false if a new one is there.
-- Each move is one of the row, so that triggers see it.
local function save(server, row, view)
  local execute, fields = row.execute or server.execute, {}
  local last = remove(row.moves)
  for i = 1, #view, 2 do fields[view[i]] = view[i + 1] end
  for _, move in ipairs(row.moves) do execute("move", row.key, move.to, move.by) end
  local written = execute(row.is_new and "insert" or "update", row.key, fields.chart,
    fields.version, fields.leaf, fields.mode, last and last.by,
    fields.due ~= "" and fields.due or nil, server.json.datum(fields.data), row.datum)
  if written[1] then save_effects(server, row, execute) end
  return written[1] ~= nil
end

--- Return what a library needs of Redis: the globals `redis`, `cjson`, `cmsgpack`; and
-- a function `answer(name, key, args, found)` that calls a function for the machine at
-- a key. `found` has what was read before, and `execute`.
---@param server rfsm.postgres.Server
function host.new(server)
  local functions, row, json = {}, nil, server.json
  local commands = new_commands(server, function() return row end)
  local globals = { cjson = json }

  globals.redis = {
    LOG_NOTICE = "log", log = server.log,
    register_function = function(f) functions[f.function_name] = f.callback end,
    call = function(name, ...) return commands[name] and commands[name](...) end,
    acl_check_cmd = function() return true end,
    error_reply = function(text) return { err = text } end,
  }

  globals.cmsgpack = {
    pack = function(list)
      row.packed, row.datum = list, json.encode(list)
      return tostring(row.datum)
    end,
    unpack = function() return row.list end,
  }

  return globals, function(name, key, args, found)
    local own = { key = key, is_read = host.READ_ONLY[name], emitted = {}, errors = {},
      moves = {}, list = found and found.list, us = found and found.us,
      execute = found and found.execute }
    row = own
    local reply, view = functions[name]({ key }, args), nil
    if type(reply) == "table" and reply.err then
      return server.refuse(in_sql(reply.err))
    end
    if own.is_changed then view = functions.rfsm_get({ key }, {}) end
    row = nil
    if view and not save(server, own, view) then
      return server.refuse("rfsm.create: something is at '" .. key .. "'")
    end
    return reply
  end
end

return host
