--- Syntax: the trees of Lua texts, from the parser of luacheck, and the tree of a
--- function in them.
--
-- Debug information has only the first and the last line of a function. If several
-- functions begin and end in these lines, the right one is known by its parameters, its
-- upvalues, and its constants: names of fields and globals, and strings.
--
-- @module rfsm.shared.syntax
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local match = require "rfsm.shared.match"
local order = require "rfsm.shared.order"

local ipairs, package, pcall, rawget = ipairs, package, pcall, rawget
local require, setmetatable, string, type = require, setmetatable, string, type
local char = string.char
local getinfo = (rawget(_G, "debug") or {}).getinfo

local syntax = {}

-- Returns a module of luacheck, or false. Debian installs luacheck for Lua 5.1 only,
-- but it runs on each Lua.
local function find(name)
  if not package then return false end
  local path = package.path
  package.path = path .. ";" .. path:gsub("/5%.%d/", "/5.1/")
  local ok, module = pcall(require, name)
  package.path = path
  return ok and module
end

local parser, decoder = find "luacheck.parser", find "luacheck.decoder"

--- The module `luacheck`; false if it is not installed.
syntax.luacheck = find "luacheck"

--- Can texts be parsed? This needs luacheck and Lua's debug library.
syntax.is_there = syntax.luacheck and parser and decoder and getinfo ~= nil

-- Functions in a tree ...............................................................

--- A function in a text.
---@class rfsm.syntax.Function
---@field node table its tree
---@field text string
---@field upvalues table<string, true> names of local variables of functions around it
---@field locals table<string, true> names of its own local variables and parameters
---@field constants table<string, true> names of fields and globals, and strings
---@field is_vararg boolean
---@field outer rfsm.syntax.Function|false the function around it

local function inner(scope) return setmetatable({}, { __index = scope }) end

local function declare(scope, ids, owner)
  for _, id in ipairs(ids) do
    if id.tag == "Id" then scope[id[1]], owner.locals[id[1]] = owner, true end
  end
end

local visit

-- Visits the items of a list; a list in it is a block with its own local variables.
local function visit_all(list, scope, owner, found)
  for _, node in ipairs(list) do
    if type(node) == "table" and node.tag then
      visit(node, scope, owner, found)
    elseif type(node) == "table" then
      visit_all(node, inner(scope), owner, found)
    end
  end
end

-- Notes a text as a constant of a function and of the functions around it, whose code
-- includes the function's.
local function note_constant(owner, text)
  while owner do
    owner.constants[text], owner = true, owner.outer
  end
end

local VISITS = {}

function VISITS.Id(node, scope, owner)
  local name, declaring = node[1], scope[node[1]]
  if not declaring then return note_constant(owner, name) end
  while owner ~= declaring do
    owner.upvalues[name], owner = true, owner.outer
  end
end

function VISITS.String(node, _, owner) note_constant(owner, node[1]) end

function VISITS.Function(node, scope, owner, found)
  local own = { node = node, upvalues = {}, locals = {}, constants = {}, outer = owner }
  found[#found + 1], scope = own, inner(scope)
  declare(scope, node[1], own)
  visit_all(node[2], scope, own, found)
end

function VISITS.Local(node, scope, owner, found)
  visit_all(node[2] or {}, scope, owner, found)
  declare(scope, node[1], owner)
end

function VISITS.Localrec(node, scope, owner, found)
  declare(scope, node[1], owner)
  visit_all(node[2], scope, owner, found)
end

function VISITS.Forin(node, scope, owner, found)
  visit_all(node[2], scope, owner, found)
  scope = inner(scope)
  declare(scope, node[1], owner)
  visit_all(node[3], scope, owner, found)
end

function VISITS.Fornum(node, scope, owner, found)
  for i = 2, #node - 1 do visit(node[i], scope, owner, found) end
  scope = inner(scope)
  declare(scope, { node[1] }, owner)
  visit_all(node[#node], scope, owner, found)
end

function VISITS.Do(node, scope, owner, found)
  visit_all(node, inner(scope), owner, found)
end

function VISITS.Repeat(node, scope, owner, found)
  scope = inner(scope)
  visit_all(node[1], scope, owner, found)
  visit(node[2], scope, owner, found)
end

function visit(node, scope, owner, found)
  return (VISITS[node.tag] or visit_all)(node, scope, owner, found)
end

--- Parse a text.
---@param text string
---@return table? tree nil if the text cannot be parsed
---@return rfsm.syntax.Function[]? functions
function syntax.parse(text)
  local ok, characters, tree = pcall(function()
    local decoded = decoder.decode(text)
    return decoded, parser.parse(decoded)
  end)
  if not ok then return nil end
  local main = { upvalues = {}, locals = {}, constants = {}, outer = false }
  local functions = {}
  visit_all(tree, {}, main, functions)
  for _, own in ipairs(functions) do
    own.text = characters:get_substring(own.node.offset, own.node.end_offset)
  end
  return tree, functions
end

-- The tree of a function ............................................................

-- What each Lua has in front of a constant: its length as a byte, or as an integer of
-- four or eight bytes.
local function marks_of(size)
  local word = char(size + 1, 0, 0, 0)
  return { char(size + 1), char(size + 5), char(size + 129), word,
    word .. "\0\0\0\0" }
end

-- Is a text a constant in the code that string.dump has made?
local function has_constant(dump, text)
  return #text > 100 or order.any(marks_of(#text), function(mark)
    return dump:find(mark .. text, 1, true) ~= nil
  end)
end

-- Returns how many constants of a function in a text the code of a function has; nil if
-- one is missing. Names of local variables may be in any code, and do not count.
local function count_constants(own, dump, list)
  local count = 0
  for text in order.each(own.constants) do -- any order: it counts
    if text ~= "" and not has_constant(dump, text) then return nil end
    local is_sign = text ~= "" and not order.any(list, function(other)
      return other.locals[text]
    end)
    if is_sign then count = count + 1 end
  end
  return count
end

-- Returns the names of the upvalues of a function as a set.
local function upvalues_of(f)
  local names = {}
  for _, upvalue in ipairs(calls.upvalues_of(f)) do
    if upvalue.name ~= "_ENV" then names[upvalue.name] = true end
  end
  return names
end

-- Lists the functions of a text that begin and end as `f` does, and have its upvalues
-- and parameters.
local function candidates(functions, f, info)
  local list, upvalues = {}, upvalues_of(f)
  local count = getinfo(f, "u").nparams -- nil in Lua 5.1
  for _, own in ipairs(functions) do
    local node, last = own.node, own.node.end_range
    local parameters = #node[1]
    local dots = node[1][parameters]
    if dots and dots.tag == "Dots" then parameters = parameters - 1 end
    local is_there = node.line == info.linedefined
      and (not last or last.line == info.lastlinedefined)
    if is_there and (not count or count == parameters)
      and match.are_equal(own.upvalues, upvalues) then
      list[#list + 1] = own
    end
  end
  return list
end

--- Find the tree and text of a function among those of its file.
---@param functions rfsm.syntax.Function[]
---@param f function
---@return rfsm.syntax.Function? own nil if it cannot be told from others
function syntax.find(functions, f)
  local list = candidates(functions, f, getinfo(f, "S"))
  if not list[2] then return list[1] end
  local ok, dump = pcall(string.dump, f)
  local best, most, is_sure = nil, -1, false
  for _, own in ipairs(ok and list or {}) do
    local count = count_constants(own, dump, list)
    if count and count >= most then
      is_sure = count > most or is_sure and own.text == best.text
      best, most = own, count
    end
  end
  return is_sure and best or nil
end

return syntax
