--- PL/Lua: what `rfsm.postgres.host` needs of the server that it runs in.
--
-- @module rfsm.postgres.pllua
-- @license BSD-3-Clause

local require, tostring, type = require, tostring, type
local unpack = rawget(table, "unpack")

-- Those that only PL/Lua executes.
local NEWEST = "SELECT obj_description('rfsm.call'::regproc, 'pg_proc') AS library"
local CALL = "SELECT rfsm.call($1, $2, $3, $4) AS reply"

-- Returns a function that executes statements.
local function executor(spi, statements)
  local prepared = {}
  return function(name, ...)
    prepared[name] = prepared[name] or spi.prepare(statements[name])
    return prepared[name]:execute(...)
  end
end

-- JSON: values of the type jsonb.
local function new_json(pgtype)
  local set_as_unknown = require("pllua.jsonb").set_as_unknown
  local PLAIN = { map = function(key, value)
    if type(value) == "table" then set_as_unknown(value) end
    return key, value
  end }
  local json = {}

  -- Returns a table without metatables.
  function json.list_of(datum)
    local t = datum(PLAIN)
    return type(t) == "table" and set_as_unknown(t) or t
  end

  function json.encode(value) return pgtype.jsonb(value) end

  function json.decode(text) return json.list_of(pgtype.jsonb:fromstring(text)) end

  return json
end

--- Return what a library needs of Redis, and the function `rfsm.call`.
---@param host table `rfsm.postgres.host`
---@param spi table
---@param pgtype table
---@param id string of the library
---@return table globals
---@return fun(name: string, key: string, args: any, id: string?): string[]? answer
return function(host, spi, pgtype, id)
  local newest, call, given
  local server = { execute = executor(spi, host.STATEMENTS), log = spi.elog,
    json = new_json(pgtype), warn = spi.warning }

  -- A call that began before another library was loaded may come to a machine that
  -- has been there: then the new one answers.
  function server.refuse(text)
    newest = newest or spi.prepare(NEWEST)
    if newest:execute()[1].library == "library " .. id then
      return spi.error("raise_exception", text)
    end
    call = call or spi.prepare(CALL)
    return call:execute(unpack(given, 1, 4))[1].reply
  end

  local globals, answer = host.new(server)
  return globals, function(name, key, list, event_id)
    given = { name, key, list, event_id }
    local args = list and list { null = "" } or {}
    if event_id then args[#args + 1], args[#args + 2] = "ID", event_id end
    local reply = answer(name, key, args)
    if not reply then return nil end
    return type(reply) == "table" and reply or { tostring(reply) }
  end
end
