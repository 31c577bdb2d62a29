--- Bundles charts with the core as one library of Redis functions.
--
-- The command `rfsm redis CHART...` calls it. Redis 7 loads the text with FUNCTION
-- LOAD. The functions are those of `rfsm.server.functions`.
--
-- @module rfsm.redis
-- @license BSD-3-Clause

local library = require "rfsm.server.library"

local redis = {}

--- Return the name of the chart in a file, and the file, of an argument such as
-- `lamp.lua` or `lamp=old/lamp.lua`.
---@param argument string
---@return string name
---@return string file
function redis.name_of(argument) return library.name_of(argument) end

--- Return the text of a library for FUNCTION LOAD.
-- @raise if a chart has a problem, in one line
---@param arguments string[] see `name_of`; a later version of a name is newer
---@param options? rfsm.server.Options
---@return string text
---@return string[] warnings
---@nodiscard
function redis.bundle(arguments, options)
  options = options or {}
  local text, warnings = library.text(arguments, "Redis", { index = options.index,
    history = options.history, notes = options.history ~= nil, ids = options.ids,
    ids_for = options.ids_for })
  return "#!lua name=rfsm\n" .. text, warnings
end

return redis
