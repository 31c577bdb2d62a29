--- Functions that `rfsm.postgres.host` needs when it runs in PostgreSQL, in PL/Lua.
--
-- @module rfsm.postgres.pllua
-- @license BSD-3-Clause

local require, tostring, type = require, tostring, type
local unpack, utf8 = rawget(table, "unpack"), rawget(_G, "utf8")

local function executor(spi, statements)
  local prepared = {}
  return function(name, ...)
    prepared[name] = prepared[name] or spi.prepare(statements[name])
    return prepared[name]:execute(...)
  end
end

-- Returns the functions that convert texts and tables to and from the type jsonb.
local function new_json(spi, pgtype)
  local jsonb, kind = require "pllua.jsonb", pgtype.jsonb
  local PLAIN = { map = function(key, value)
    if type(value) == "table" then jsonb.set_as_unknown(value) end
    return key, value
  end }
  local json = {}

  -- Converts a value of the type jsonb into a table without metatables.
  function json.list_of(datum) return datum(PLAIN) end

  function json.datum(text)
    local is_valid, at = utf8.len(text)
    if is_valid then return kind:fromstring(text) end
    return spi.error("character_not_in_repertoire",
      ('invalid byte sequence for encoding "UTF8": 0x%02x'):format(text:byte(at)))
  end

  function json.decode(text) return json.list_of(json.datum(text)) end

  return json
end

--- Return a function f(library, globals) that returns the function behind `rfsm.call`.
-- `host` is the module `rfsm.postgres.host`, and `id` is the id of the library.
return function(host, spi, pgtype, id)
  local json, given = new_json(spi, pgtype), nil
  local server = { execute = executor(spi, host.STATEMENTS), json = json,
    warn = spi.warning }

  -- Raises `text` as the error of a call. But if a newer library was loaded during the
  -- call, the machine may have moved to it: then the newer library repeats the call.
  function server.refuse(text)
    if server.execute("newest")[1].library == "library " .. id then
      return spi.error("raise_exception", text)
    end
    return server.execute("call", unpack(given, 1, 4))[1].reply
  end

  local function log(line) spi.elog("log", line) end

  return function(library, globals)
    local answer
    globals.cjson = { decode = json.decode }
    return function(name, key, list, event_id)
      if not answer then
        local find, charts, options = library(log, globals)
        globals.cjson.encode = find("rfsm.shared.exact_json").encode
        answer = host.new(server, find, charts, options)
      end
      given = { name, key, list, event_id }
      local args = list and list { null = "" } or {}
      if event_id then args[#args + 1], args[#args + 2] = "ID", event_id end
      local reply = answer(name, key, args)
      if type(reply) == "number" or type(reply) == "string" then
        return { tostring(reply) }
      end
      return reply or nil -- a table, or what the newer library has returned
    end
  end
end
