--- Machines in rows of PostgreSQL: the host through which `rfsm.server.functions` reads
--- and writes them.
--
-- The functions run inside the server (`rfsm.postgres.pllua`), or in a client
-- (`rfsm.postgres`). The row is saved after a function has ended. So a client whose
-- statements wait in coroutines does not enter a function twice. An error ends the
-- transaction, so that nothing is changed.
--
-- @module rfsm.postgres.host
-- @license BSD-3-Clause

local verbs_of = require "rfsm.server.verbs"

local ipairs = ipairs
local floor = math.floor

--- The row of the machine for which a function was called.
---@class rfsm.postgres.Row
---@field is_read boolean? the row is only read, so it is not locked
---@field list any[]|nil the column `value`, which is the saved machine
---@field us number|nil the time in microseconds; given if the row was read before
---@field execute function runs a statement, see `rfsm.postgres.Server`
---@field change rfsm.postgres.Change|nil what is to be written

--- The arguments with which a function has called `write`; they are saved when it ends.
---@class rfsm.postgres.Change
---@field machine rfsm.server.Machine
---@field due string|nil seconds at which the machine has something to do
---@field emitted string[][] each { name, data }, where data is JSON or ""
---@field errors string[] texts of errors
---@field data? string JSON for the column `data`; nil: what is in the snapshot
---@field counter? string the sequence that counts the call

--- Functions of the server, or of a client, that the host uses.
---@class rfsm.postgres.Server
---@field execute fun(name: string, ...: any): table[] runs a statement, returns rows
---@field json table `decode`; `list_of` returns the column `value` as a list; `datum`
--- returns a JSON text as an argument of a statement
---@field warn fun(text: string) reports an error of a callback
---@field refuse fun(text: string): any raises the text as an error, or returns the
--- reply of a newer library

local host = {}

--- Functions that only read the machine, so that its row needs no lock.
host.READ_ONLY = {}
for _, verb in ipairs(verbs_of) do
  host.READ_ONLY["rfsm_" .. verb.name] = verb.reads
end

-- Counts a call in the sequence $10, if there is one, and returns 0.
local COUNT = [[CASE $10::text WHEN 'rfsm.events' THEN 0 * nextval('rfsm.events')
    WHEN 'rfsm.dropped' THEN 0 * nextval('rfsm.dropped') ELSE 0 END]]

-- The column `data`: $8, or what is in the snapshot.
local DATA = "coalesce($8::jsonb, own.value #> '{2,data}', '{}')"

--- Statements by their names. `insert` returns a row if it has written one; `update`
-- writes a row that is locked. The casts are for drivers that give all parameters the
-- type text.
host.STATEMENTS = {
  read = "SELECT value FROM rfsm.machines WHERE key = $1",
  lock = "SELECT value FROM rfsm.machines WHERE key = $1 FOR UPDATE",
  time = "SELECT extract(epoch FROM clock_timestamp())::float8 * 1e6 AS us",
  insert = [[INSERT INTO rfsm.machines
    (key, chart, version, state, mode, event, due, data, value, leases, since)
    SELECT $1, $2, $3, $4, $5, coalesce($6, ''), to_timestamp($7::text::float8),
      ]] .. DATA .. [[, own.value, ]] .. COUNT .. [[, clock_timestamp()
    FROM (SELECT $9::jsonb AS value) own
    ON CONFLICT (key) DO NOTHING RETURNING key]],
  update = [[UPDATE rfsm.machines SET chart = $2, version = $3, state = $4, mode = $5,
    event = coalesce($6, event), due = to_timestamp($7::text::float8),
    data = ]] .. DATA .. [[, value = own.value, leases = ]] .. COUNT .. [[,
    since = CASE WHEN state = $4 THEN since ELSE clock_timestamp() END
    FROM (SELECT $9::jsonb AS value) own WHERE key = $1]],
  move = [[UPDATE rfsm.machines SET state = $2, event = $3, since = clock_timestamp()
    WHERE key = $1]],
  history = [[SELECT extract(epoch FROM at)::text AS time, coalesce(event, '') AS event,
    coalesce(src, '') AS src, coalesce(tgt, '') AS tgt,
    coalesce(snapshot, '{}')::text AS snapshot FROM rfsm.history
    WHERE key = $1 ORDER BY id DESC LIMIT $2::integer]],
  note = [[INSERT INTO rfsm.history (key, event, src, tgt, snapshot)
    VALUES ($1, $3, $2, $2, $4::jsonb->2)]],
  -- The trigger has noted that the row is gone.
  removed = [[UPDATE rfsm.history SET event = $2
    WHERE id = (SELECT max(id) FROM rfsm.history WHERE key = $1)]],
  remove = [[WITH log AS (DELETE FROM rfsm.log WHERE key = $1)
    DELETE FROM rfsm.machines WHERE key = $1 RETURNING key]],
  emit = "INSERT INTO rfsm.out (key, what, data) VALUES ($1, $2, $3::jsonb)",
  log = [[WITH trimmed AS (DELETE FROM rfsm.log WHERE key = $1 AND id <= (SELECT id
      FROM rfsm.log WHERE key = $1 ORDER BY id DESC OFFSET 999 LIMIT 1))
    INSERT INTO rfsm.log (key, error) VALUES ($1, $2)]],
  newest = "SELECT obj_description('rfsm.call'::regproc, 'pg_proc') AS library",
  call = "SELECT rfsm.call($1, $2, $3, $4) AS reply",
}

-- Writes what callbacks have emitted, and their errors.
local function save_effects(server, execute, key, change)
  for _, entry in ipairs(change.emitted) do
    local data = entry[2] ~= "" and server.json.datum(entry[2]) or nil
    execute("emit", key, entry[1], data)
  end
  for _, text in ipairs(change.errors) do
    execute("log", key, text)
    server.warn(key .. ": " .. text)
  end
end

-- Returns the machine after a move as JSON; a list without a snapshot if that is not
-- known, since other moves of the call follow.
local function value_after(machine, i)
  return machine.moves[i + 1] and "[]" or machine.value
end

-- Writes the row of a machine. Returns false if a new machine's key is taken. Each
-- move is an UPDATE, so that triggers see it. Events that moved nothing are noted.
local function save(server, execute, key, change)
  local machine, datum, by = change.machine, server.json.datum, nil
  local is_new = machine.leaf == false
  for i, move in ipairs(machine.moves) do
    if is_new or move.from ~= move.to and not machine.moves[i + 1] then
      by = move.by
    elseif move.from ~= move.to then
      execute("move", key, move.to, move.by)
    else
      execute("note", key, move.to, move.by, datum(value_after(machine, i)))
    end
  end
  local written = execute(is_new and "insert" or "update", key, machine.chart.name,
    machine.list[3].chart, machine.at, machine.mode, by,
    change.due, change.data and datum(change.data), datum(machine.value),
    change.counter)
  if is_new and not written[1] then return false end
  save_effects(server, execute, key, change)
  return true
end

-- Returns the text of an error with the names that functions have in SQL.
local function in_sql(text)
  return (text:gsub("^rfsm_(%l[%l_]*): ", "rfsm.%1: ")
    :gsub("%(rfsm_create makes one%)$", "(rfsm.create makes one)"))
end

--- Return a function `answer(name, key, args, found)` that calls the function `name`
-- for the machine at a key. If the row was read before, `found` has its `list`, `us`
-- and `execute`. `require`, `charts` and `options` come from the bundled library.
---@param server rfsm.postgres.Server
---@param require fun(name: string): any
---@param charts table
---@param options table
function host.new(server, require, charts, options)
  local data_of = require("rfsm.server.charts").data_of
  local number_text = require("rfsm").number_text
  local row ---@type rfsm.postgres.Row
  local verbs = { FORCE = "force => true", decode = server.json.decode,
    pack = require("rfsm.shared.exact_json").encode }

  function verbs.time()
    local us = row.us or row.execute("time")[1].us
    local sec = floor(us / 1e6)
    return sec, (us - sec * 1e6) * 1000
  end

  function verbs.read(key)
    if row.list or row.us then return row.list end
    local found = row.execute(row.is_read and "read" or "lock", key)[1]
    return found and server.json.list_of(found.value)
  end

  -- The data in the snapshot are plain if it has no regions and no list of a packed
  -- value, whose first item begins with %.
  function verbs.write(machine, due, emitted, errors)
    local snap = machine.list[3]
    local is_packed = snap.regions or machine.value:find('["%', 1, true)
    row.change = { machine = machine, due = due and number_text(due, "%.6f"),
      emitted = emitted, errors = errors, data = is_packed and data_of(snap) or nil }
  end

  function verbs.history(key, count)
    local items = {}
    for _, move in ipairs(row.execute("history", key, count)) do
      local n = #items
      items[n + 1], items[n + 2] = move.time, move.event
      items[n + 3], items[n + 4] = move.src, move.tgt
      local snap = server.json.decode(move.snapshot)
      items[n + 5] = snap.version and snap or false
    end
    return items
  end

  function verbs.remove(key, what)
    local is_gone = row.execute("remove", key)[1] ~= nil
    if is_gone and what then row.execute("removed", key, what) end
    return is_gone
  end

  -- Notes which counter the UPDATE of the row is to raise.
  function verbs.count(machine)
    if not machine.is_sent_to then return end
    row.change.counter = machine.outcome == "dropped" and "rfsm.dropped"
      or "rfsm.events"
  end

  function verbs.refuse(name, reason)
    return server.refuse(in_sql(name .. ": " .. reason))
  end

  local functions = require "rfsm.server.functions" (verbs, charts, options)

  return function(name, key, args, found)
    row = found or {}
    row.is_read, row.execute = host.READ_ONLY[name], row.execute or server.execute
    local own, reply = row, functions[name]({ key }, args)
    if own.change and not save(server, own.execute, key, own.change) then
      return server.refuse("rfsm.create: something is at '" .. key .. "'")
    end
    return reply
  end
end

return host
