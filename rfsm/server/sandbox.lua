--- Checks, while a chart is bundled, that it can run in a server. Finds globals that
-- the server lacks, modules that are not plain Lua, and loops without an end.
--
-- A chart is loaded with the globals that the server has. Loading does not run the
-- callbacks, so their text is searched for libraries that the server lacks.
--
-- @module rfsm.server.sandbox
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local code_of = require("rfsm.shared.code").of
local files = require "rfsm.shared.files"
local limit = require "rfsm.shared.limit"
local rfsm = require "rfsm"

local error, ipairs, pairs = error, ipairs, pairs
local os, rawget, require = os, rawget, require
local concat, sort = table.concat, table.sort
local setmetatable, type = setmetatable, type

local sandbox = {}

local function line_at(text, at)
  local _, count = text:sub(1, at):gsub("\n", "")
  return count + 1
end

-- Globals ---------------------------------------------------------------------------

local HERE = {}
for name in ([[assert collectgarbage error getmetatable ipairs loadstring next pairs
  pcall rawequal rawget rawset select setmetatable tonumber tostring type unpack xpcall
  coroutine string table math bit cjson cmsgpack struct redis print rfsm rfsm_timeevent
  _VERSION]]):gmatch("%S+") do
  HERE[name] = true
end

local NOWHERE = "os io debug package dofile loadfile setfenv getfenv"
local MISSING = { Redis = NOWHERE, PostgreSQL = NOWHERE .. " bit struct cmsgpack redis "
  .. "unpack loadstring" }

-- Is the name between two positions a field or a key of a table, so that it is not a
-- global?
local function is_key(code, from, behind)
  local before = code:sub(1, from - 1):match("(%S)%s*$")
  return before == "." or before == ":" or code:find("^%s*=[^=]", behind)
end

-- Returns position and name of the first library that a text uses and a server lacks.
local function find_missing(code, server)
  local first, found = nil, nil
  for name in MISSING[server]:gmatch("%l+") do
    local is_own = code:find("local[%w_, ]-%f[%w_]" .. name .. "%f[^%w_]")
    for from, behind in code:gmatch("%f[%w_]()" .. name .. "%f[^%w_]()") do
      local field, after = code:match("^%s*%.%s*([%w_]+)()", behind)
      local is_there = is_own or name == "os" and field == "clock"
      if not is_there and not is_key(code, from, after or behind)
        and (not first or from < first) then
        first, found = from, name .. (field and "." .. field or "")
      end
    end
  end
  return first, found
end

local OPENS = { ["function"] = true, ["if"] = true, ["do"] = true, ["repeat"] = true }
local LEAVES = { ["break"] = true, ["return"] = true, error = true, yield = true }

-- Returns true if no statement leaves the loop whose block begins at position `at`.
local function is_endless(code, at)
  local depth = 0
  for word, behind in code:sub(at):gmatch("([%a_][%w_]*)()") do
    if LEAVES[word] then return false end
    if OPENS[word] then depth = depth + 1 end
    if word == "end" or word == "until" then depth = depth - 1 end
    if depth == 0 then
      return word == "end" or code:find("^[%s(]*false%f[^%w_]", at + behind - 1)
        ~= nil
    end
  end
  return false
end

--- List the numbers of the lines in which a loop without an end begins.
function sandbox.endless(text)
  local lines, code = {}, code_of(text)
  for _, pattern in ipairs { "%f[%w_]while[%s(]+true[%s)]+()do%f[^%w_]",
    "%f[%w_]while[%s(]+1[%s)]+()do%f[^%w_]", "%f[%w_]()repeat%f[^%w_]",
    "%f[%w_]for[^\n,]+,%s*math%.huge%s+()do%f[^%w_]" } do
    for at in code:gmatch(pattern) do
      if is_endless(code, at) then lines[#lines + 1] = line_at(code, at) end
    end
  end
  sort(lines)
  return lines
end

-- Loading -----------------------------------------------------------------------------

-- Joins the pieces of a text that a function returns one by one, as Lua's `load` does.
local function text_from(pieces)
  local texts = {}
  for piece in pieces do
    if piece == "" then break end
    texts[#texts + 1] = piece
  end
  return concat(texts)
end

-- Returns the function `load` that charts get. It refuses binary chunks. A chunk has
-- the globals of the sandbox, unless the caller passes others.
local function new_load(globals)
  return function(text, name, _, own)
    if type(text) == "function" then text = text_from(text) end
    if type(text) ~= "string" then
      error("load: text expected, got " .. type(text), 2)
    end
    if text:byte() == 27 then return nil, "attempt to load a binary chunk" end
    return calls.load(text, name, own == nil and globals or own)
  end
end

-- The function `require` that charts get. It refuses a library that is not plain Lua.
local function find_module(name)
  local is_plain = HERE[name] or type(name) ~= "string" or name:find("^rfsm")
    or files.find((name:gsub("%.", "/")))
  if not is_plain then error("module '" .. name .. "' not found", 2) end
  return require(name)
end

-- Returns the globals of the sandbox, as far as this Lua has them.
local function new_globals(server)
  local globals = {}
  for name in pairs(HERE) do globals[name] = rawget(_G, name) end -- any order: a set
  globals.load = new_load(globals)
  globals.loadstring = globals.loadstring and globals.load
  globals.rfsm, globals._G, globals.os = rfsm, globals, { clock = os.clock }
  globals.rfsm_timeevent = require "rfsm_timeevent"
  for _, name in ipairs { "bit", "cjson", "cmsgpack", "struct", "redis" } do
    globals[name] = globals[name] or setmetatable({}, { __index = function()
      return function() end
    end })
  end
  return setmetatable(globals, {
    __metatable = false,
    __index = function(_, name)
      error("global '" .. rfsm.text_of(name) .. "' does not exist in " .. server, 2)
    end,
    __newindex = function(_, name)
      error("global '" .. rfsm.text_of(name) .. "' cannot be set in " .. server, 2)
    end,
  })
end

--- Load the chart in a text as a server ("Redis" or "PostgreSQL") will load it. Return
-- the model; nil and the problem, with file and line, if the chart cannot run there.
function sandbox.load(text, file, server)
  server = server or "Redis"
  local from, name = find_missing(code_of(text), server)
  if from then
    return nil, ("%s:%d: '%s' does not exist in %s"):format(file, line_at(text, from),
      name, server)
  end
  local globals = new_globals(server)
  rawset(globals, "require", find_module)
  local f, problem = calls.load(text, "@" .. file, globals)
  if not f then return nil, problem end
  local ok, model = limit.load(f, file, { os.time, os.clock }, function(source)
    return source == "@" .. file
  end)
  if not ok then return nil, rfsm.text_of(model) end
  if rfsm.is_state(model) then return model end
  return nil, ("%s: a state expected, got %s"):format(file, type(model))
end

--- Run the text of a library in this process, and return its results. The globals are
-- the server's and the fields of `here`. `log` is called with each printed line.
function sandbox.run(text, here, server, log)
  local globals = new_globals(server)
  globals.rfsm, globals.rfsm_timeevent, globals.bit, globals.struct = nil, nil, nil, nil
  rawset(globals, "jit", rawget(_G, "jit")) -- the core reads this global
  for name, value in pairs(here) do globals[name] = value end -- any order
  local f, problem = calls.load(text, "=rfsm", globals)
  if not f then error(problem, 0) end
  return f(log, globals)
end

--- List the modules that a text requires by name, and the line of each. `code` is the
-- text without comments, if the caller has it.
function sandbox.required(text, code)
  local modules = {}
  code = code or code_of(text)
  for at, name in text:gmatch("%f[%w_]()require%s*%(?%s*[\"']([%w_.%-]+)[\"']") do
    if code:sub(at, at + 6) == "require" then
      modules[#modules + 1] = { name = name, line = line_at(text, at) }
    end
  end
  return modules
end

return sandbox
