--- Source: finds mistakes in the text of callbacks, with the parser of luacheck.
--
-- Without luacheck nothing is found. Only what is certain is a warning. For example, a
-- loop that calls an unknown function is not reported, since the function may yield.
--
-- @module rfsm.checks.source
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local read = require("rfsm.shared.files").read
local bodies = require "rfsm.checks.bodies"
local instrument = require "rfsm.shared.instrument"
local location = require "rfsm.shared.location"
local match = require "rfsm.shared.match"
local order = require "rfsm.shared.order"
local stubs = require "rfsm.shared.stubs"
local syntax = require "rfsm.shared.syntax"

local ipairs, package, rawget = ipairs, package, rawget
local select, setmetatable, table = select, setmetatable, table
local tonumber, type = tonumber, type
local getinfo = (rawget(_G, "debug") or {}).getinfo

local source = {}

--- Can texts be read? This needs luacheck and Lua's debug library.
source.is_there = syntax.is_there

-- Files ...........................................................................

--- A file that was read.
---@class rfsm_checks.File
---@field functions rfsm.syntax.Function[]
---@field undefined { name: string, line: integer }[] globals that the file reads
---@field tested table<string, true> names whose existence is tested
---@field told table<string, true> undefined names that were reported
---@field lost table<integer, table[]> line of a table -> keys that the table has twice
---@field called table<integer, table[]> line of a table -> calls in place of callbacks

local walk, each_node, called_name = bodies.walk, bodies.each_node, bodies.called_name

local TESTS = { ["not"] = true, ["and"] = true, ["or"] = true, eq = true, ne = true }

-- Notes the names that are conditions, or operands of a test, such as `not` or `==`.
local function note_tested(node, tested)
  local first = node.tag == "Op" and TESTS[node[1]] and 2
    or (node.tag == "If" or node.tag == "While") and 1
  for i = first or #node + 1, #node do
    if node[i].tag == "Id" then tested[node[i][1]] = true end
  end
end

local function read_file(name)
  local text = name ~= "" and read(name)
  if not text then return nil end
  text = text:gsub("^#[^\n]*", "")
  local tree, functions = syntax.parse(text)
  if not tree then return nil end
  local file = { functions = functions, undefined = {}, tested = {}, told = {},
    lost = {}, called = {} }
  walk(tree, function(node)
    if node.tag == "Table" then bodies.note_table(file, node) end
    bodies.note_method(node)
    note_tested(node, file.tested)
  end)
  local options = { std = "min", allow_defined = true }
  for _, warning in ipairs(syntax.luacheck.check_strings({ text }, options)[1]) do
    if warning.code == "113" then
      file.undefined[#file.undefined + 1] = { name = warning.name, line = warning.line }
    end
  end
  return file
end

-- Checks ..........................................................................

-- The functions of rfsm that a callback may call without `rfsm.` by mistake. Others are
-- left out, since the host may have globals of these names, such as `report`.
local USED = { yield = true, send_events = true }

-- Returns the name of a defined global that looks like an undefined name. Modules do
-- not count: programs keep their machine in a global `fsm`, which looks like `rfsm`.
local function meant(name)
  if USED[name] then return "rfsm." .. name end
  for _, other in ipairs(rfsm.sorted_keys(_G)) do
    local is_other = type(other) == "string" and not package.loaded[other]
    if is_other and advice.is_near(name, other) then return other end
  end
end

-- Does a function use a global that was not reported before, and is neither defined nor
-- tested for?
local function is_new(file, info, global)
  local line, name = global.line, global.name
  return line >= info.linedefined and line <= info.lastlinedefined
    and not (file.tested[name] or file.told[name]) and rawget(_G, name) == nil
end

-- Finds globals that are not defined after the chart was loaded, each once. The host
-- may define them later, so only a name that looks like another one is a warning. If
-- stubs are in place of modules, other names are left out: modules may define them.
local function check_globals(file, info, add)
  for _, global in ipairs(file.undefined) do
    local name = global.name
    local other = is_new(file, info, global) and meant(name)
    if other or is_new(file, info, global) and not stubs.are_used then
      file.told[name] = true
      add("undefined", ("line %d reads the global '%s', which is not defined%s"):format(
        global.line, name, other and " (did you mean '" .. other .. "'?)" or ""),
        not other and "note")
    end
  end
end

-- Tag of a node in a loop of a doo -> what it may do: leave the loop, or yield true
-- ("idles").
local EFFECTS = {
  Return = "leaves", Break = "leaves", Goto = "leaves", Invoke = "idles",
}

-- Returns "yields" if a call yields nil or false, "idles" if it may yield a true value,
-- nil if it does not yield: a global function, or one in a global table or in `rfsm`.
local function effect_of_call(node)
  local name, library = called_name(node)
  if not name:find("yield") then
    local is_plain = library == "rfsm" or rawget(_G, library or name) ~= nil
    return not is_plain and "idles" or nil
  end
  local tag = node[2] and node[2].tag or "Nil"
  return tag ~= "Nil" and tag ~= "False" and "idles" or "yields"
end

-- Is a node a loop without an end? A loop in which nothing is called or assigned never
-- changes its condition.
local function is_endless(node, condition)
  if node.tag ~= "While" and node.tag ~= "Repeat" then return false end
  if condition.tag == (node.tag == "While" and "True" or "False") then return true end
  return not bodies.has({ node[1], node[2] }, function(inner)
    return EFFECTS[inner.tag] or inner.tag == "Call" or inner.tag == "Set"
      or inner.tag == "Index"
  end)
end

-- Notes in `seen` what a loop without an end does.
local function look_into(loop, seen)
  local has = {}
  walk(loop, function(node)
    local what = EFFECTS[node.tag] or node.tag == "Call" and effect_of_call(node)
    if what then has[what] = true end
  end)
  seen.has_loop = true
  seen.is_idle = seen.is_idle or has.idles or has.leaves
  seen.yields = seen.yields and (has.yields or has.idles or has.leaves)
end

local function check_doo(func, state, add)
  local seen = { yields = true, is_idle = false, has_loop = false }
  each_node(func, function(node)
    local is_while = node.tag == "While"
    local condition, loop = node[is_while and 1 or 2], node[is_while and 2 or 1]
    if is_endless(node, condition) then look_into(loop, seen) end
  end)
  if not seen.yields then
    add("no-yield", "a loop in the doo has no end and no yield")
  elseif seen.has_loop and not seen.is_idle then
    add("busy-doo", "the doo is never idle, it yields nothing")
  end
  local waits = order.any(state._otrs, function(tr)
    return match.triggers(tr, "e_done@" .. state._fqn) ~= false
  end)
  local is_last = state.final == true and rfsm.names_done(state._parent)
  if not (seen.has_loop or waits or is_last) then
    add("doo-ends", "the doo ends, and no transition waits for e_done")
  end
end

-- Returns the node of a function, its file, and where it is defined in it.
local function find_function(files, callback)
  local info = type(callback) == "function" and getinfo(callback, "S")
  local file = info and files[info.source:match("^@(.*)") or ""]
  local own = file and syntax.find(file.functions, callback)
  return own and own.node, file, info
end

-- Checks a callback of an element.
local function check_callback(files, fsm, obj, field, add)
  local func, file, info = find_function(files, obj[field])
  if not file then return end
  local function report(code, text, severity) add(code, obj, text, severity) end
  check_globals(file, info, report)
  if func then bodies.check(func, field, obj, fsm, report) end
  if func and field == "doo" then check_doo(func, obj, report) end
end

-- Finds an idle hook. One that calls nothing can neither wait nor end the run.
local function check_idle_hook(files, fsm, add)
  if not fsm.idle_hook or rfsm.parent(fsm) then return end
  local func, does_call = find_function(files, fsm.idle_hook), false
  if func then
    each_node(func, function(node)
      does_call = does_call or node.tag == "Call" or node.tag == "Invoke"
    end)
  end
  add("idle-hook", fsm, "an idle machine calls its idle_hook again and again, so that "
    .. "run returns only after an error", func and not does_call and "warning")
end

-- Returns for each line of code that calls constructors a list of the elements that
-- were made there. The list also has the fields `file` and `line`.
local function places_of(fsm)
  local places, by_text = {}, {}
  for _, obj in ipairs(rfsm.elements(fsm)) do
    local name, line = location.split(rfsm.location_of(obj)):match("^(.*):(%d+): $")
    local text = name and name .. ":" .. line
    if text and not by_text[text] then
      by_text[text] = { file = name, line = tonumber(line) }
      places[#places + 1] = by_text[text]
    end
    if text then table.insert(by_text[text], obj) end
  end
  return places
end

-- Returns a text about a call in place of a callback (`entry = f()`), and the cure.
local function text_of_call(call)
  local body = (call.name == "guard" and "return " or "") .. call.by .. "(...)"
  return ("%s was called while the chart was loaded, and left no %s (%s = function() "
    .. "%s end)"):format(call.by, call.name, call.name, body)
end

-- Finds mistakes in the tables that were given to constructors: keys that a table has
-- twice, and calls that return nil and stand in place of a callback (`entry = f()`).
local function check_tables(files, fsm, add)
  for _, place in ipairs(places_of(fsm)) do
    local file = files[place.file]
    for _, lost in ipairs(file and file.lost[place.line] or {}) do
      add("lost", place[1], ("'%s' stands twice, the first one is lost (the second is "
        .. "in line %d)"):format(lost.name, lost.line))
    end
    for _, call in ipairs(file and file.called[place.line] or {}) do
      local is_given = order.any(place, function(obj)
        return rfsm.model_of(obj)[call.name] ~= nil
      end)
      if not is_given then add("called", place[1], text_of_call(call)) end
    end
  end
end

--- Find mistakes in the text of callbacks.
---@type rfsm_checks.Check
function source.check(fsm, add)
  if not source.is_there then return end
  local files = setmetatable({}, { __index = function(files, name)
    files[name] = read_file(name) or false
    return files[name]
  end })
  check_tables(files, fsm, add)
  for _, obj in ipairs(rfsm.elements(fsm)) do
    for _, field in ipairs(select(2, rfsm.regions(obj)) and {}
      or instrument.CALLBACKS) do
      check_callback(files, fsm, obj, field, add)
    end
  end
  check_idle_hook(files, fsm, add)
end

return source
