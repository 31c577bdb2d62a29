--- What `rfsm.postgres.host` needs of the server, if it runs inside, in PL/Lua.
--
-- @module rfsm.postgres.pllua
-- @license BSD-3-Clause

local next, pairs, require, tonumber = next, pairs, require, tonumber
local tostring, type = tostring, type
local math_type, unpack = rawget(math, "type"), rawget(table, "unpack")

-- Statements that only this module executes.
local NEWEST = "SELECT obj_description('rfsm.call'::regproc, 'pg_proc') AS library"
local CALL = "SELECT rfsm.call($1, $2, $3, $4) AS reply"

local function executor(spi, statements)
  local prepared = {}
  return function(name, ...)
    prepared[name] = prepared[name] or spi.prepare(statements[name])
    return prepared[name]:execute(...)
  end
end

-- Returns the functions for JSON; they make values of the type jsonb.
local function new_json(pgtype)
  local jsonb = require "pllua.jsonb"
  local PLAIN = { map = function(key, value)
    if type(value) == "table" then jsonb.set_as_unknown(value) end
    return key, value
  end }
  local json = {}

  -- Returns a copy that jsonb stores exactly: a table with a key such as "2" stays an
  -- object, and numbers keep all their digits.
  local function exact(value)
    if math_type(value) == "float" and tonumber(("%.14g"):format(value)) ~= value
      and value - value == 0 then
      return pgtype.numeric(("%.17g"):format(value))
    elseif type(value) ~= "table" then
      return value
    end
    local copy, is_object = {}, next(value) == nil
    for key, inner in pairs(value) do -- any order: a copy
      copy[key] = exact(inner)
      is_object = is_object or type(key) == "string"
    end
    return is_object and jsonb.set_as_object(copy) or copy
  end

  -- Returns a table without metatables.
  function json.list_of(datum) return datum(PLAIN) end

  function json.encode(value) return pgtype.jsonb(exact(value)) end

  function json.datum(text) return pgtype.jsonb:fromstring(text) end

  function json.decode(text) return json.list_of(json.datum(text)) end

  return json
end

--- Return the functions for JSON, and a function that makes `rfsm.call` of a library
-- and its globals. `host` is the module `rfsm.postgres.host`, `id` the id of the
-- library.
return function(host, spi, pgtype, id)
  local json, newest, call, given = new_json(pgtype), nil, nil, nil
  local server = { execute = executor(spi, host.STATEMENTS), json = json,
    warn = spi.warning }

  -- A call that began before a newer library was loaded may find a machine that has
  -- moved to it, and fail. Then the call is made again, by the newer library.
  function server.refuse(text)
    newest = newest or spi.prepare(NEWEST)
    if newest:execute()[1].library == "library " .. id then
      return spi.error("raise_exception", text)
    end
    call = call or spi.prepare(CALL)
    return call:execute(unpack(given, 1, 4))[1].reply
  end

  local function log(line) spi.elog("log", line) end

  return json, function(library, globals)
    local answer
    return function(name, key, list, event_id)
      answer = answer or host.new(server, library(log, globals))
      given = { name, key, list, event_id }
      local args = list and list { null = "" } or {}
      if event_id then args[#args + 1], args[#args + 2] = "ID", event_id end
      local reply = answer(name, key, args)
      if type(reply) == "number" then return { tostring(reply) } end
      return reply or nil -- a table, or what the newer library has returned
    end
  end
end
