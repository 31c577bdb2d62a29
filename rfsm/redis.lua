--- Bundles charts and the core into one library of Redis functions.
--
-- The command `rfsm redis CHART...` calls this module. Redis 7 loads the library with
-- FUNCTION LOAD. Its functions are those of `rfsm.server.functions`.
--
-- @module rfsm.redis
-- @license BSD-3-Clause

local library = require "rfsm.server.library"
local verbs = require "rfsm.server.verbs"

local concat = table.concat

local redis = {}

-- The library is made at the first call, since most globals are absent while Redis
-- loads the text.
local HEAD = "#!lua name=rfsm\nlocal library = function(...)\n"

local FOOT = [[
end

local functions

local function open()
  local function log(line) redis.log(redis.LOG_NOTICE, line) end
  local require, charts, options = library(log, _G)
  local store = require "rfsm.redis.store" (redis, cjson, cmsgpack)
  return require "rfsm.server.functions" (store, charts, options)
end

local function register(name, flag)
  redis.register_function {
    function_name = name, flags = { flag },
    callback = function(keys, args)
      if not functions then
        local ok, made = pcall(open)
        if not ok then return redis.error_reply("ERR rfsm: " .. tostring(made)) end
        functions = made
      end
      return functions[name](keys, args)
    end,
  }
end

]]

local REGISTER = 'register("rfsm_%s", %s)\n'

--- Return the name of a chart, and its file, from an argument of the command, such as
-- `lamp.lua` or `lamp=old/lamp.lua`.
---@param argument string
---@return string name
---@return string file
function redis.name_of(argument) return library.name_of(argument) end

--- Return the text of a library for FUNCTION LOAD.
-- @raise if a chart has a problem; the error has one line
---@param arguments string[] charts, as for `name_of`; if two have the same name, the
-- later one is the newer version
---@param options? rfsm.server.Options
---@return string text
---@return string[] warnings
---@nodiscard
function redis.bundle(arguments, options)
  local text, warnings = library.text(arguments, "Redis", options or {},
    "rfsm.redis.store")
  local names = verbs.map(function(verb)
    return REGISTER:format(verb.name, verb.reads and '"no-writes"' or "nil")
  end)
  return HEAD .. text .. FOOT .. concat(names), warnings
end

return redis
