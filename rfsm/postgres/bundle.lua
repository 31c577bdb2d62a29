--- Bundles charts with the core as a schema of PostgreSQL, with functions in PL/Lua.
--
-- The command `rfsm postgres CHART...` calls it. The functions are those that run in
-- Redis; `rfsm.postgres.host` stands for Redis.
--
-- @module rfsm.postgres.bundle
-- @license BSD-3-Clause

local add_module = require("rfsm.server.bundle").add
local redis = require "rfsm.redis"
local schema = require "rfsm.postgres.schema"

local error, ipairs, pcall = error, ipairs, pcall
local concat = table.concat

local bundle = {}

-- In front of the library: what it finds in place of Redis and of globals. `pcall` of
-- PL/Lua makes a subtransaction, and catches that a call is cancelled; `lpcall` does
-- neither.
local HEAD = [[
local bundled = {}
%s
local host = bundled["rfsm.postgres.host"]()(spi, pgtype, "$ID")
local redis, cjson, cmsgpack, pcall = host.redis, host.cjson, host.cmsgpack, lpcall
local function finish(handler, ok, ...)
  if ok then return ok, ... end
  return ok, handler((...))
end
local function xpcall(f, handler, ...) return finish(handler, pcall(f, ...)) end
local _G = { os = { clock = os.clock }, pcall = pcall, xpcall = xpcall, redis = redis,
  cjson = cjson, cmsgpack = cmsgpack }
for name in ([=[assert collectgarbage error getmetatable ipairs next pairs rawequal
  rawget rawset select setmetatable tonumber tostring type coroutine string table math
  load _VERSION]=]):gmatch("%%S+") do
  _G[name] = self[name]
end
self.answer = host.answer
setmetatable(self, {
  __index = function(_, name)
    if _G[name] ~= nil then return _G[name] end
    error("global '" .. tostring(name) .. "' does not exist in PostgreSQL", 2)
  end,
  __newindex = function(_, name)
    error("global '" .. tostring(name) .. "' cannot be set in PostgreSQL", 2)
  end,
})
]]

local function in_postgres(text) return (text:gsub("in Redis", "in PostgreSQL")) end

-- Returns a text that another library does not have, most likely.
local function id_of(text)
  local sum = 0
  for i = 1, #text do sum = (sum * 31 + text:byte(i)) % 16777213 end
  return ("%06x-%x"):format(sum, #text)
end

-- Returns a quote for a text that does not contain it.
local function quote_for(text)
  local tag = "$rfsm$"
  while text:find(tag, 1, true) do tag = tag:sub(1, -2) .. "_$" end
  return tag
end

--- What the schema has besides machines.
---@class rfsm.postgres.Options
---@field history? boolean a trigger notes each move in rfsm.history
---@field notify? boolean a trigger reports each move to those who LISTEN to rfsm
---@field ids? integer as in `rfsm.server.Options`
---@field ids_for? integer likewise

--- Return SQL that makes the schema `rfsm`, or gives it other charts.
-- @raise if a chart has a problem, in one line
---@param arguments string[] see `rfsm.redis.name_of`; a later one of a name is newer
---@param options? rfsm.postgres.Options
---@return string text
---@return string[] warnings
---@nodiscard
function bundle.sql(arguments, options)
  options = options or {}
  local ok, library, warnings = pcall(redis.bundle, arguments, { history = 1,
    ids = options.ids, ids_for = options.ids_for })
  if not ok then error(in_postgres(library), 0) end
  for i, text in ipairs(warnings) do warnings[i] = in_postgres(text) end
  local parts = {}
  add_module(parts, "rfsm.postgres.host")
  local code = HEAD:format(concat(parts)) .. library:gsub("^#[^\n]*", "")
  local id = id_of(code)
  local values = { TAG = quote_for(code), CODE = code:gsub("%$ID", id, 1),
    ID = id }
  local text = concat { schema.HEAD, "$CODE", schema.FUNCTIONS,
    options.history and schema.HISTORY or "", options.notify and schema.NOTIFY or "",
    schema.FOOT }
  return (text:gsub("%$(%u+)", values)), warnings
end

return bundle
