--- Bundles charts with the core as one library of Redis functions.
--
-- The command `rfsm redis CHART...` calls it. Redis 7 loads the text with FUNCTION
-- LOAD. The functions are those of `rfsm.redis.functions`.
--
-- @module rfsm.redis
-- @license BSD-3-Clause

local bundle = require "rfsm.redis.bundle"
local chart = require "rfsm.shared.chart"
local rfsm = require "rfsm"
local sandbox = require "rfsm.redis.sandbox"

local error, ipairs, pcall, require = error, ipairs, pcall, require
local io = io
local concat = table.concat

local redis = {}

-- Modules that charts require, or get as a field; those that these need come along.
local ROOTS = {
  "rfsm.redis.functions", "rfsm_seqand", "rfsm.emem", "rfsm.monitor", "rfsm.preview",
}

-- Names that the library knows, see FOOT.
local ALIASES = { ["rfsm.ext"] = true, rfsm_emem = true, rfsm_await = true }

-- While Redis loads a library hardly any global is there; later none can be set, and
-- reading one that is absent is an error. So the modules see locals in their place, and
-- are made at the first call.
local HEAD = [[
#!lua name=rfsm
local function globals() return _G end
local _G, loadfile, print, io, os, debug, package, require, outer_require
local charts = {}
]] .. bundle.HEAD

local FOOT = [[

bundled["rfsm.ext"], bundled.rfsm_emem = bundled["rfsm.monitor"], bundled["rfsm.emem"]
bundled.rfsm_await = bundled["rfsm.await"]

local library

local function open()
  _G = { RFSM_NO_GLOBALS = true }
  for name, value in pairs(globals()) do _G[name] = value end
  function print(...)
    local texts = { ... }
    for i = 1, select("#", ...) do texts[i] = tostring(texts[i]) end
    redis.log(redis.LOG_NOTICE, table.concat(texts, " "))
  end
  _G.print = print
  return require "rfsm.redis.functions" ({ call = redis.call, json = cjson,
    error_reply = redis.error_reply, pack = cmsgpack, may = redis.acl_check_cmd },
    charts, options)
end

local function register(name, flag)
  redis.register_function {
    function_name = name, flags = { flag },
    callback = function(keys, args)
      if not library then
        local ok, made = pcall(open)
        if not ok then
          loaded = {}
          return redis.error_reply("ERR rfsm: " .. tostring(made))
        end
        library = made
      end
      return library[name](keys, args)
    end,
  }
end

register("rfsm_create")
register("rfsm_send")
register("rfsm_send_at")
register("rfsm_cancel")
register("rfsm_tick")
register("rfsm_wake")
register("rfsm_get", "no-writes")
register("rfsm_due", "no-writes")
register("rfsm_why", "no-writes")
register("rfsm_find", "no-writes")
register("rfsm_stats", "no-writes")
register("rfsm_history", "no-writes")
]]

local CHART = [[
charts[#charts + 1] = { name = %q, make = function()
local rfsm, rfsm_timeevent = require "rfsm", require "rfsm_timeevent"
return (function(...) %s
end)(%q)
end }
]]

-- Appends modules, and those that they require. A chart's own are plain Lua.
local function add_modules(parts, names, is_there, where)
  for _, name in ipairs(names) do
    if not is_there[name] then
      is_there[name] = true
      local text = bundle.add(parts, name)
      if not text then
        error(("%s: module '%s' is not there as plain Lua, so it cannot run in Redis")
          :format(where, name), 0)
      end
      local needed = {}
      for called, other in text:gmatch('([%l_]+) *%(?"(rfsm[%w_.]*)"') do
        local is_needed = called == "require" or called == "find_module"
        needed[#needed + 1] = is_needed and other or nil
      end
      if not name:find("^rfsm") then
        for _, module in ipairs(sandbox.required(text)) do
          needed[#needed + 1] = module.name
        end
      end
      add_modules(parts, needed, is_there, name)
    end
  end
end

--- Return the name of the chart in a file, and the file, of an argument such as
-- `lamp.lua` or `lamp=old/lamp.lua`.
---@param argument string
---@return string name
---@return string file
function redis.name_of(argument)
  local name, file = argument:match("^([%w_.-]+)=(.+)$")
  file = file or argument
  return name or (file:match("([^/]*)$"):gsub("%.lua$", "")), file
end

local function read_chart(file)
  local handle, problem = io.open(file)
  if not handle then error("cannot open " .. problem, 0) end
  local text = handle:read("*a"):gsub("^#[^\n]*", "")
  handle:close()
  return text
end

-- Raises what is wrong with a chart, here or in Redis.
local function check_chart(file, text)
  local model, problem = chart.load(file)
  if not model then error(problem, 0) end
  model, problem = sandbox.load(text, file)
  if not model then error(problem, 0) end
  model.info, model.warn, model.err = false, false, false
  local ok, fsm, _, problems = pcall(rfsm.init, model)
  if not ok then error(chart.reason(file, fsm), 0) end
  if not fsm then error(chart.line(file, problems[1]), 0) end
  local kept, failure = pcall(require("rfsm.snapshot").take, fsm)
  if not kept then error(chart.reason(file, failure), 0) end
end

--- Return the text of a library for FUNCTION LOAD.
-- @raise if a chart has a problem, in one line
---@param arguments string[] see `name_of`; a later version of a name is newer
---@param options? rfsm.redis.Options
---@return string text
---@return string[] warnings
---@nodiscard
function redis.bundle(arguments, options)
  options = options or {}
  require "rfsm_timeevent"
  require "rfsm.await"
  local parts, is_there, warnings = { HEAD }, {}, {}
  add_modules(parts, ROOTS, is_there, "rfsm.redis")
  for _, argument in ipairs(arguments) do
    local name, file = redis.name_of(argument)
    local text = read_chart(file)
    for _, module in ipairs(sandbox.required(text)) do
      if not ALIASES[module.name] then
        add_modules(parts, { module.name }, is_there, file .. ":" .. module.line)
      end
    end
    check_chart(file, text)
    for _, line in ipairs(sandbox.endless(sandbox.code_of(text))) do
      warnings[#warnings + 1] = ("%s:%d: warning: this loop has no end: in Redis it "
        .. "would hold up all others"):format(file, line)
    end
    parts[#parts + 1] = CHART:format(name, text, file)
  end
  parts[#parts + 1] = ("\nlocal options = { index = %s, history = %s, ids = %s, "
    .. "ids_for = %s }"):format(options.index and "true" or "nil",
    options.history or "nil", options.ids or "nil", options.ids_for or "nil")
  parts[#parts + 1] = FOOT
  return concat(parts), warnings
end

return redis
