--- Make the library that Redis or PostgreSQL runs: one text with charts, the core, and
--- the functions of `rfsm.server.functions`.
--
-- `rfsm.redis` and `rfsm.postgres.script` put the library into a text for their server.
--
-- @module rfsm.server.library
-- @license BSD-3-Clause

local bundle = require "rfsm.server.bundle"
local chart = require "rfsm.shared.chart"
local files = require "rfsm.shared.files"
local rfsm = require "rfsm"
local sandbox = require "rfsm.server.sandbox"

local error, ipairs, pcall, rawget, require = error, ipairs, pcall, rawget, require
local concat = table.concat
local tostring = tostring
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local library = {}

-- Modules of each library: the functions, and modules that a chart may require or reach
-- as a field of `rfsm`. Modules that these require are added.
local ROOTS = {
  "rfsm.server.functions", "rfsm_seqand", "rfsm.emem", "rfsm.monitor", "rfsm.preview",
  "rfsm.strict",
}

-- The library is called with a function that writes a line to the log, and the globals.
-- It returns a `require`, the charts, and the options. Redis raises an error if a
-- global is set, or an absent one is read, so modules see locals in place of globals.
local HEAD = [[
local _G, loadfile, print, io, os, debug, package, require
do
  local log, globals = ...
  _G = { RFSM_NO_GLOBALS = true }
  for name, value in pairs(globals) do _G[name] = value end
  os = _G.os
  function print(...)
    local texts = { ... }
    for i = 1, select("#", ...) do texts[i] = tostring(texts[i]) end
    log(table.concat(texts, " "))
  end
  _G.print = print
end
local charts = {}

local function outer_require(name)
  local libraries = { string = string, table = table, math = math,
    coroutine = coroutine }
  return libraries[name] or error("module '" .. name .. "' not found", 3)
end

]] .. bundle.HEAD

local CHART = [[
charts[#charts + 1] = { name = %q, make = function()
local rfsm, rfsm_timeevent = require "rfsm", require "rfsm_timeevent"
return (function(...) %s
end)(%q)
end }
]]

local FOOT = [[

return require, charts, { index = %s, history = %s, ids = %s, ids_for = %s }
]]

-- Appends a module under its name; returns its text, or nil if no file of plain Lua is
-- found. If there is no file for a name such as rfsm_await, the file of rfsm.await is
-- taken.
local function add_text(parts, name)
  local dotted = name:match("^rfsm_(%a+)$")
  return bundle.add(parts, name)
    or dotted and bundle.add(parts, "rfsm." .. dotted, name)
end

-- Appends a module, and the modules that it requires. In modules of rFSM no comment
-- contains a `require`, so their text is searched with its comments.
local function add_module(parts, name, is_there, where, server)
  if is_there[name] then return end
  is_there[name] = true
  local text = add_text(parts, name)
  if not text then
    error(("%s: module '%s' is not there as plain Lua, so it cannot run in %s")
      :format(where, name, server), 0)
  end
  for _, other in ipairs(sandbox.required(text, name:find("^rfsm") and text)) do
    add_module(parts, other.name, is_there, where .. ": '" .. name .. "'", server)
  end
end

--- Return the name of a chart and its file from an argument such as `lamp.lua` or
-- `lamp=old/lamp.lua`.
---@param argument string
---@return string name
---@return string file
function library.name_of(argument)
  local name, file = argument:match("^([%w_.-]+)=(.+)$")
  file = file or argument
  return name or (file:match("([^/]*)$"):gsub("%.lua$", "")), file
end

local function read_chart(file)
  local text, problem = files.read(file)
  if not text then error("cannot open " .. problem, 0) end
  return (text:gsub("^#[^\n]*", ""))
end

local function check_chart(file, text, server)
  local model, problem = sandbox.load(text, file, server)
  if not model then error(chart.reason(file, problem), 0) end
  model.info, model.warn, model.err = false, false, false
  local ok, fsm, _, problems = pcall(rfsm.init, model)
  if not ok then error(chart.reason(file, fsm), 0) end
  if not fsm then error(chart.line(file, problems[1]), 0) end
  local kept, failure = pcall(require("rfsm.snapshot").take, fsm)
  if not kept then error(chart.reason(file, failure), 0) end
end

--- Return the text of the library for a server, and a list of warnings.
-- @raise if a chart has a problem, in one line
---@param arguments string[] see `name_of`; if a name occurs again, the later file is
--- the newer version of the chart
---@param server string the name of the server in messages
---@param options rfsm.server.Options
---@param host? string the module that connects the functions with the server, if the
--- library is to contain it
---@return string text
---@return string[] warnings
function library.text(arguments, server, options, host)
  require "rfsm_timeevent"
  require "rfsm.await"
  local parts, warnings = { HEAD }, {}
  local is_there = { string = true, table = true, math = true, coroutine = true }
  for _, name in ipairs { host or ROOTS[1], unpack(ROOTS) } do
    add_module(parts, name, is_there, "rfsm.server.library", server)
  end
  for _, argument in ipairs(arguments) do
    local name, file = library.name_of(argument)
    local text = read_chart(file)
    for _, module in ipairs(sandbox.required(text)) do
      add_module(parts, module.name, is_there, file .. ":" .. module.line,
        server)
    end
    check_chart(file, text, server)
    for _, line in ipairs(sandbox.endless(text)) do
      warnings[#warnings + 1] = ("%s:%d: warning: this loop has no end: in %s it "
        .. "would hold up all others"):format(file, line, server)
    end
    parts[#parts + 1] = CHART:format(name, text, file)
  end
  parts[#parts + 1] = FOOT:format(tostring(options.index), tostring(options.history),
    tostring(options.ids), tostring(options.ids_for))
  return concat(parts), warnings
end

return library
