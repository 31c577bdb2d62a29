--- Find in the text of functions the fields and variables to which they assign; for
--- checks, and for explorations, which do not call most callbacks.
--
-- The text of a function has no comments. If several functions stand in its lines, the
-- parser of luacheck finds it; without luacheck, it is the text of all of them.
-- Functions whose names occur in a text are searched, too. An assignment to a computed
-- key, and `rawset`, may write any field. Nothing is known of a function without text,
-- such as one whose file is not there; functions of Lua and of this library write
-- nothing.
--
-- @module rfsm.shared.writes
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local calls = require "rfsm.shared.calls"
local code = require "rfsm.shared.code"
local files = require "rfsm.shared.files"
local match = require "rfsm.shared.match"
local order = require "rfsm.shared.order"

local _G, getmetatable, io, ipairs, math = _G, getmetatable, io, ipairs, math
local rawequal, rawget, select = rawequal, rawget, select
local setmetatable, type = setmetatable, type
local concat, huge = table.concat, math.huge
local getinfo = (rawget(_G, "debug") or {}).getinfo

local writes = {}

-- Texts .............................................................................

-- Lists of lines by the field `source` of debug.getinfo; false: the text is not known.
-- Their field `functions` has the functions in them; nil: they are not parsed yet.
local sources = {}

local function keep_text(source, text)
  local lines = {}
  for line in (code.of(text, true) .. "\n"):gmatch("(.-)\r?\n") do
    lines[#lines + 1] = line
  end
  sources[source] = lines
end

-- Returns the function in some lines that is `f`, as the parser of luacheck finds it;
-- nil if there is no parser. To load it takes as long as to load all else of a command,
-- and few charts need it.
local function parsed(lines, f)
  local syntax = require "rfsm.shared.syntax"
  if not syntax.is_there then return nil end
  if not lines.functions then
    local _, functions = syntax.parse((concat(lines, "\n"):gsub("^#[^\n]*", "")))
    lines.functions = functions or {}
  end
  return syntax.find(lines.functions, f)
end

--- Keep the text of a chunk that has no file, such as "=stdin".
---@param source string the field `source` that debug.getinfo has for its functions
---@param text string
writes.keep_text = keep_text

-- Returns the text of a source; nil if it is not known. A source that names no file is
-- either a text or the name of a text.
local function read(source)
  local mark = source:sub(1, 1)
  if mark == "@" then return io and files.read(source:sub(2)) or nil end
  return mark ~= "=" and calls.load(source, "=text", {}) and source or nil
end

-- Returns the lines of a source; false if its text is not known.
local function lines_of(source)
  local text = sources[source] == nil and read(source)
  if text then keep_text(source, text) end
  sources[source] = sources[source] or false
  return sources[source]
end

-- The files of this library beside rfsm.lua: the ends of their names, after "rfsm".
local BESIDE = { ["_checks.lua"] = true, ["_seqand.lua"] = true,
  ["_timeevent.lua"] = true, ["pp.lua"] = true }

-- Is a function with this `source` from a file of this library? A chart in the same
-- folder may have a name that begins with rfsm_, too.
local function is_own(source)
  local core = getinfo(rfsm.init, "S").source
  local base = core:match("^(@.*rfsm)%.lua$")
  local rest = base and source:sub(1, #base) == base and source:sub(#base + 1) or ""
  local is_core = source == core and core ~= "=?" -- "=?": any function without a text
  return is_core or rest:sub(1, 1) == "/" or BESIDE[rest] == true
end

-- The words of Lua, and the names of its functions.
local OWN_NAMES = {}
for name in ([[and break do else elseif end false for function goto if in local nil not
  or repeat return then true until while assert collectgarbage dofile error getmetatable
  ipairs load loadfile loadstring next pairs pcall print rawequal rawget rawlen rawset
  require select setmetatable tonumber tostring type unpack xpcall]]):gmatch("%l+") do
  OWN_NAMES[name] = true
end

local LIBRARIES = { "bit", "bit32", "coroutine", "debug", "io", "math", "os", "package",
  "string", "table", "utf8" }

-- Is it a function of Lua itself?
local function is_standard(f)
  for name in order.each(OWN_NAMES) do -- any order: one is enough
    if rawequal(rawget(_G, name), f) then return true end
  end
  return order.any(LIBRARIES, function(name)
    local library = rawget(_G, name)
    for _, value in order.each(type(library) == "table" and library or {}) do
      if rawequal(value, f) then return true end -- any order, as above
    end
  end)
end

-- Returns the function that is called if a value is called.
local function function_of(value)
  if type(value) == "function" then return value end
  local class = getmetatable(value)
  return type(class) == "table" and rawget(class, "__call") or nil
end

local FUNCTION = "%f[%w_]function%f[^%w_]"

-- Returns the text of a function in the lines of its source; nil if the lines have no
-- such function. A file may have changed, and a chunk may have the name of a file. The
-- second result is true if other functions of these lines may be in the text.
local function text_in(lines, f, info)
  local last = lines[info.lastlinedefined] and info.lastlinedefined or 0
  local text = concat(lines, "\n", info.linedefined, last)
    :match(FUNCTION .. ".*%f[%w_]end%f[^%w_]")
  local has_names = order.all(calls.upvalues_of(f), function(upvalue)
    return upvalue.name == "_ENV" or text and upvalue.name:find("^[%w_]+$")
      and text:find("%f[%w_]" .. upvalue.name .. "%f[^%w_]")
  end)
  if not (has_names and text) then return nil end
  if select(2, text:gsub(FUNCTION, "")) < 2 then return text, false end
  local own = parsed(lines, f)
  return own and own.text or text, not own
end

--- Return the text of a function of the chart; nil if the text is not known, or if the
--- function is of C or of this library.
---@param callback any
---@return string? text
---@return boolean? is_shared the text may be that of several functions of a line
function writes.text_of(callback)
  local f = function_of(callback)
  local info = getinfo and type(f) == "function" and getinfo(f, "S")
  if not info or info.what == "C" or is_own(info.source) then return nil end
  local lines = lines_of(info.source)
  if lines and info.what == "main" then return concat(lines, "\n") end
  if lines then return text_in(lines, f, info) end
end

--- List the names of variables in a text, each once: names without a point or colon in
--- front, except words and functions of Lua.
---@return string[]
function writes.names_in(text)
  local list, is_listed = {}, setmetatable({}, { __index = OWN_NAMES })
  for before, name in (" " .. text):gmatch("([^%w_])([%a_][%w_]*)") do
    if before ~= "." and before ~= ":" and not is_listed[name] then
      is_listed[name], list[#list + 1] = true, name
    end
  end
  return list
end

-- Returns a field of a table, also one that its class has; the function that its class
-- calls for it.
local function field_of(owner, name)
  for _ = 1, 10 do
    if type(owner) ~= "table" then return type(owner) == "function" and owner or nil end
    local value, class = rawget(owner, name), getmetatable(owner)
    if value ~= nil then return value end
    owner = type(class) == "table" and rawget(class, "__index")
  end
end

-- Returns a text with points in place of plain keys, and without blanks around points:
-- arm.tool for arm["tool"].
local function dotted(text)
  return (text:gsub("%.%.+", ",")
    :gsub("%[%s*[\"']([%a_][%w_]*)[\"']%s*%]", ".%1"):gsub("%s*([.:])%s*", "%1"))
end

-- Lists the functions that a text names: upvalues, globals, and what is behind points
-- and colons: "arm.tool:open", arm["tool"].
local function called_by(text, upvalues)
  local list = {}
  local function add(value) list[#list + 1] = function_of(value) end
  for _, name in ipairs(rfsm.sorted_keys(upvalues)) do add(upvalues[name]) end
  for _, name in ipairs(writes.names_in(text)) do add(rawget(_G, name)) end
  local path = "%f[%w_]([%a_][%w_]*)([.:][%w_.:]*)%s*(=?)"
  for base, rest, sign in dotted(text):gmatch(path) do
    local value, class = upvalues[base] or rawget(_G, base), nil
    for name in rest:gmatch("[%w_]+") do
      class = type(value) == "table" and getmetatable(value)
      value = field_of(value, name)
      add(value)
    end
    if sign == "=" and type(class) == "table" then add(rawget(class, "__newindex")) end
  end
  return list
end

-- Methods of texts, and functions in a chart, that may be called through any variable.
local HARMLESS = {}
for name in ([[:byte :find :format :gmatch :gsub :len :lower :match :rep :sub :upper
  :type .emit .dbg .err .info .warn]]):gmatch("%S+") do
  HARMLESS[name] = true
end

-- Returns the set of the parameters and local variables in a text.
local function locals_in(text)
  local found = {}
  for _, before in ipairs { "function[%s%w_.:]*%(", "local%s", "for%s" } do
    for at in text:gmatch("%f[%w_]" .. before .. "()") do
      for name in text:match("^[%s%w_,]*", at):gsub("([%w_])%s+[%w_].*", "%1")
        :gmatch("[%w_]+") do
        found[name] = true
      end
    end
  end
  return found
end

-- Does a text call what it does not name: a parameter, a field of one, what another
-- call returns, or a local variable that is no function in the text?
local function calls_unnamed(text)
  text = code.of(dotted(text), '""')
  local is_local = locals_in(text)
  for _, caller in ipairs { "x?pcall", "coroutine%.wrap", "coroutine%.create" } do
    text = text:gsub("%f[%w_]" .. caller .. "%s*%(%s*([%w_.:]+)", "%1(")
  end
  local functions = text
  text = text:gsub("%f[%w_]function[%s%w_.:]*%b()", ";")
  for base, rest in text:gmatch("%f[%w_.:]([%a_][%w_]*)([%w_.:]*)%s*[({\"]") do
    local path = base .. rest:gsub("%p", "%%%0")
    local is_there = functions:find("%f[%w_]function%s+" .. path .. "%f[^%w_]")
      or functions:find("%f[%w_]" .. path .. "%s*=%s*function%f[^%w_]")
    if is_local[base] and not (is_there or HARMLESS[rest:match("[.:][%w_]+$")]) then
      return true
    end
  end
  for rest in text:gmatch("[)%]\"]%s*([.:%w_]*)%s*[({]") do
    local is_next = rest:find("^[%w_]") -- of the next statement
    if not (is_next or HARMLESS[rest:match("[.:][%w_]+$")]) then return true end
  end
  return false
end

-- Assignments .......................................................................

-- Patterns of the text between a name and the sign `=` of its assignment: nothing, an
-- index, or more names.
local BEHIND = { "%s*=[^=]", "%s*%b[]%s*=[^=]", "%s*,[%w_.,%s%[%]\"']-=[^=]" }

-- Functions of `table` that change their first argument.
local CHANGERS = { insert = true, remove = true, sort = true }

-- Does a text assign to a field of this name, or change the list in that field?
local function assigns(text, name)
  local short = text:gsub("%b[]", "[]") -- in an index may be anything
  for _, behind in ipairs(BEHIND) do
    if text:find("%.%s*" .. name .. "%f[^%w_]" .. behind)
      or short:find("%.%s*" .. name .. "%f[^%w_]" .. behind)
      or text:find("%[%s*[\"']" .. name .. "[\"']%s*%]" .. behind) then
      return true
    end
  end
  for called in text:gmatch("(%l+)%s*%(%s*[%w_.]*%." .. name .. "%f[^%w_]") do
    if CHANGERS[called] then return true end
  end
  return false
end

-- Is the value of a variable a table that the function makes, or a table outside of the
-- chart? If `names` contains the variable, the answer is no.
local function is_apart(text, upvalues, base, names)
  if base:find("[^%w_]") or match.has(names, base) then return false end
  local value = upvalues[base] or rawget(_G, base)
  return type(value) == "table" and not rfsm.is_fsmobj(value)
    or text:find("local%s+" .. base .. "%s*=%s*{") ~= nil
end

-- Is a key in brackets one string, or a number?
local function is_plain(key)
  return key:find("^%[%s*([\"'])[^\"'\\]*%1%s*%]$") ~= nil
    or key:find("^%[%s*[%d#]") ~= nil and not key:find("..", 1, true)
end

-- Does a text assign to a field of the chart by a key that it computes?
local function computes_key(text, upvalues, names)
  if text:find("%f[%w_]rawset%f[^%w_]") then return true end
  for _, behind in ipairs { "%s*=%f[^=]", "%s*,[%w_.,%s%[%]\"']-=%f[^=]" } do
    for base, key in text:gmatch("([%w_.]*[%w_%])])%s*(%b[])" .. behind) do
      local is_told = is_plain(key) or is_apart(text, upvalues, base, names)
      if not is_told then return true end
    end
  end
  return false
end

-- Does a text assign to a variable of this name, other than in `local name =`?
local function assigns_variable(text, name)
  local rest = " " .. text:gsub("local%s+[%w_,%s]+=", "")
  return order.any({ "%s*=[^=]", "%s*,[%w_.,%s%[%]\"']-=[^=]" }, function(sign)
    return rest:find("[^%w_.:]%s*" .. name .. sign)
  end)
end

--- Call f(text, callback, upvalues) for a function, and for the functions that its text
--- names, each once, until a call returns true.
---@param callback any
---@param f fun(text: string, callback: function, upvalues: table<string, any>): any
---@param seen table<function, true> functions that are left out; those for which `f` is
-- called are added
---@return boolean is_true did a call return true?
function writes.each(callback, f, seen)
  callback = function_of(callback)
  local text = not seen[callback or seen] and writes.text_of(callback)
  if not text then return false end
  seen[callback] = true
  local upvalues = {}
  for _, upvalue in ipairs(calls.upvalues_of(callback)) do
    upvalues[upvalue.name] = upvalue.value
  end
  if f(text, callback, upvalues) then return true end
  return order.any(called_by(text, upvalues), function(other)
    return writes.each(other, f, seen)
  end)
end

-- Is it known what a function writes? That of Lua and of this library writes nothing.
local function is_known(f)
  local info = getinfo and type(f) == "function" and getinfo(f, "S")
  return info and (is_own(info.source) or is_standard(f) or writes.text_of(f) ~= nil)
    or false
end

-- Is it a function of C? If a callback calls one, the callback is still known.
local function is_foreign(f) return getinfo and getinfo(f, "S").what == "C" end

--- Does a callback call what no text names, such as a parameter or a field of one?
---@param callback any
---@return boolean
function writes.calls_unnamed(callback)
  return writes.each(callback, calls_unnamed, {}) or false
end

--- Is it known what a callback does, as far as texts show it?
---@param callback any
---@return boolean
function writes.is_known(callback)
  return is_known(function_of(callback)) and not writes.each(callback,
    function(text, _, upvalues)
      return order.any(called_by(text, upvalues), function(f)
        return not (is_foreign(f) or is_known(f))
      end)
    end, {})
end

--- A pattern that matches all names, for `may_write` and `may_set`.
writes.ANY = "[%a_][%w_]*"

--- Does a text read fields by keys that it computes?
function writes.reads_any(text)
  return text:find("[%w_%])]%s*%[%s*[%a_]") ~= nil or text:find("%f[%w_]pairs%s*%(")
    or text:find("%f[%w_]next%s*%(") or text:find("%f[%w_]rawget%s*%(")
end

--- Does the text of a function show that it only reads? Such a function calls no other,
--- and assigns only to new local variables.
---@param callback any
---@return boolean
function writes.only_reads(callback)
  local text = writes.text_of(callback) or ""
  local body = text:gsub("^function[^(]*%b()", ""):gsub("local%s+[%w_,%s]+=", "")
  for word in ("and or not return if elseif while until in"):gmatch("%l+") do
    body = body:gsub("%f[%w_]" .. word .. "%f[^%w_]", "+")
  end
  return text ~= "" and not (body:find("[^=~<>]=[^=]") or body:find("%f[%w]function")
    or body:find("[%w_%])]%s*[({\"']"))
end

-- Does the text behind a list of parameters use one of the parameters `at` to `last`?
local function uses(text, parameters, at, last)
  local number = 0
  for name in parameters:gmatch("[%w_.]+") do
    number = number + 1
    if name == "..." then return text:find(name, 1, true) ~= nil end
    local is_asked = number >= at and number <= last
    if is_asked and text:find("%f[%w_]" .. name .. "%f[^%w_]") then return true end
  end
  return false
end

--- May a function read its arguments from number `at` on, up to number `last`? If
--- several functions begin in its line, it may be any of them.
---@param callback any
---@param at integer
---@param last? integer default: all
---@return boolean
function writes.may_read(callback, at, last)
  local text, more = writes.text_of(callback) or "", (last or huge) - at
  if type(callback) ~= "function" then at = at + 1 end -- `self` comes first
  local line, has_parameters = text:match("^[^\n]*"), false
  for name, parameters, from in line:gmatch("function%s*([%w_.:]*)%s*(%b())()") do
    local first = name:find(":", 1, true) and at - 1 or at
    if uses(text:sub(from), parameters, first, first + more) then return true end
    has_parameters = true
  end
  return not has_parameters
    and (text:find("^function") or text:find("...", 1, true)) ~= nil
end

--- May a callback call the function `name` of a module, as far as its text shows?
---@param callback any
---@param module table?
---@param name string
---@return boolean
function writes.may_call(callback, module, name)
  local f = module and module[name]
  return writes.each(callback, function(text, _, upvalues)
    return text:find("%f[%w_]" .. name .. "%f[^%w_]")
      or f and match.has(called_by(text, upvalues), f)
  end, {})
end

--- May a function write a field of one of these names?
---@param callback any
---@param names string[] names, or patterns such as `ANY`
---@return boolean
function writes.may_write(callback, names)
  return writes.each(callback, function(text, _, upvalues)
    return computes_key(text, upvalues, names)
      or order.any(names, function(name) return assigns(text, name) end)
  end, {})
end

--- May a function write an upvalue or global of one of these names?
---@param callback any
---@param names string[]
---@return boolean
function writes.may_set(callback, names)
  return writes.each(callback, function(text)
    return order.any(names, function(name) return assigns_variable(text, name) end)
  end, {})
end

return writes
