--- Plain data: values as any encoder takes them and any Lua gets them back.
--
-- Texts, booleans, most numbers, lists and tables with texts as keys stand for
-- themselves. A list whose first item begins with % is one of these:
--
--    { "%n", digits }            a number that JSON would spoil
--    { "%t", key, value, ... }   any other table
--    { "%s", text }              a table that stands too deep for MessagePack in Redis
--    { "%p", table }             in format 1: the snapshot of a region
--    { "%z" }                    nil in a field that is not nil at first
--
-- @module rfsm.snapshot.plain
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local rfsm = require "rfsm"

local error, getmetatable, ipairs, pairs = error, getmetatable, ipairs, pairs
local pcall, rawequal, rawget, tonumber = pcall, rawequal, rawget, tonumber
local type = type
local floor, huge, min = math.floor, math.huge, math.min
local concat = table.concat
local math_type, to_integer = rawget(math, "type"), rawget(math, "tointeger")
local text_of = rfsm.text_of

-- LuaJIT 2.1.0-beta3 compiles traversals inside of others wrongly: it skips keys, or
-- crashes. So nothing here is compiled.
local jit = rawget(_G, "jit")
if jit then jit.off(true, true) end

local plain = {}

-- So many tables stand inside each other at most, in the value of a field; so many in
-- packed data.
local MAX_DEPTH, MAX_PACKED_DEPTH = 13, 40

-- A table that has more than that around it becomes a text: cmsgpack leaves out what is
-- deeper than 16, and a number of two parts is a table, too.
local MAX_DIRECT = 15

--- Stands for nil in a field that is not nil at first.
plain.NIL = {}

--- Raise an error that the public functions of the caller turn into one line.
---@param form string
---@param ... any
function plain.fail(form, ...) error({ text = form:format(...) }, 0) end

local fail = plain.fail

--- Return the text of an error, also of one that was raised by `fail`.
---@param failure any
---@return string text
function plain.reason(failure)
  return type(failure) == "table" and failure.text or text_of(failure)
end

--- Call a function of the chart; its error is one of `fail`.
---@param what string in front of the error
---@param f function
---@param ... any
---@return any result
function plain.try(what, f, ...)
  local ok, result = calls.try(f, ...)
  if not ok then fail("%s: %s", what, text_of(result)) end
  return result
end

--- The keys that lead to a value, for messages.
---@class rfsm.snapshot.Path
---@field owner string such as the FQN of a state
---@field base integer how many tables there are around a value at depth 0
---@field seen table<table, true> tables that have come
---@field [integer] any keys

--- Return the location of a value.
---@param path rfsm.snapshot.Path
---@param depth integer how many of its keys count
---@return string text such as "root.a.list[2]"
function plain.place_of(path, depth)
  local place = path.owner
  for i = 1, depth do
    local key = path[i]
    place = place .. (type(key) == "number" and "[" .. text_of(key) .. "]"
      or (place == "" and "" or ".") .. text_of(key))
  end
  return place
end

local place_of = plain.place_of

--- Is a value a text, a number or a boolean?
---@param value any
---@return boolean
function plain.is_scalar(value)
  local kind = type(value)
  return kind == "string" or kind == "number" or kind == "boolean"
end

local is_scalar = plain.is_scalar

--- Is a value what decoders of JSON return for null?
---@param value any
---@return boolean
function plain.is_null(value)
  local kind = type(value)
  if kind == "userdata" then return text_of(value):find("[Nn][Ui][Ll]") ~= nil end
  local class = kind == "table" and getmetatable(value)
  local to_json = type(class) == "table" and rawget(class, "__tojson")
  if type(to_json) ~= "function" then return false end
  local ok, text = pcall(to_json, value)
  return ok and text == "null"
end

local is_null = plain.is_null

--- Return a value; a plain table as a copy, and those in it.
---@param value any
---@return any copy
function plain.copy_of(value)
  if type(value) ~= "table" or getmetatable(value) ~= nil then return value end
  local copy = {}
  for key, inner in pairs(value) do copy[key] = plain.copy_of(inner) end -- any order
  return copy
end

-- Pack --------------------------------------------------------------------------

--- Does JSON with 14 digits give back a number, as the integer or float that it is?
---@param n number
---@return boolean
function plain.is_safe(n)
  if n - n ~= 0 then return false end -- not finite
  local is_whole = floor(n) == n
  if math_type then
    if is_whole ~= (math_type(n) == "integer") then return false end
  elseif n == 0 then
    return 1 / n > 0
  end
  if is_whole then return n < 1e14 and n > -1e14 end
  return tonumber(("%.14g"):format(n)) == n
end

local is_safe = plain.is_safe

-- Digits from which any Lua reads the number; a whole float has a point.
local function digits_of(n)
  if n ~= n then return "nan" end
  if n - n ~= 0 then return n > 0 and "inf" or "-inf" end
  if math_type and math_type(n) == "integer" then return ("%d"):format(n) end
  local digits = ("%.17g"):format(n)
  return digits:find("[.e]") and digits or digits .. ".0"
end

local pack

-- Returns { "%t", key, value, ... }, sorted by key.
local function pack_pairs(t, path, depth)
  local list = { "%t" }
  for _, key in ipairs(rfsm.sorted_keys(t)) do
    if not is_scalar(key) then
      fail("%s: a key that is a %s cannot be saved", place_of(path, depth - 1),
        type(key))
    end
    path[depth] = key
    list[#list + 1] = pack(key, path, depth)
    list[#list + 1] = pack(t[key], path, depth)
  end
  return list
end

-- Does a table stand for itself: as a list, or with texts as keys?
local function is_plain(t)
  local count, has_texts, has_others = 0, false, false
  for key in pairs(t) do -- any order: all of them count
    count = count + 1
    if type(key) == "string" then has_texts = true else has_others = true end
  end
  if has_texts or count == 0 then -- a number `n` is a length for dkjson
    return has_texts and not has_others and type(t.n) ~= "number"
  end
  local first = t[1]
  return count == #t and not (type(first) == "string" and first:byte() == 37)
end

-- No table may come twice: the copies would no longer be one.
local function check_table(t, path, depth)
  if getmetatable(t) ~= nil then
    fail("%s: a table with a metatable cannot be saved", place_of(path, depth))
  elseif path.seen[t] then
    fail("%s: this table stands elsewhere in the data, too, and can only be saved once",
      place_of(path, depth))
  elseif depth > MAX_DEPTH then
    fail("%s: at most %d tables inside each other expected", place_of(path, min(depth,
      1)), MAX_DEPTH)
  end
  path.seen[t] = true
end

-- Returns a table without the nulls of JSON in it.
local function without_nulls(t)
  local copy = nil
  for key, value in pairs(t) do -- any order: a set
    if is_null(value) then
      copy = copy or {}
      copy[key] = true
    end
  end
  if not copy then return t end
  local rest = {}
  for key, value in pairs(t) do -- any order: a copy
    if not copy[key] then rest[key] = value end
  end
  return rest
end

--- Return data of JSON, in which null is nil.
---@param value any
---@return any value
function plain.without_nulls(value)
  if is_null(value) then return nil end
  if type(value) ~= "table" then return value end
  local copy = {}
  for key, inner in pairs(value) do -- any order: a copy
    copy[key] = plain.without_nulls(inner)
  end
  return copy
end

--- Return a value as encoders of JSON take it: keys that are texts, or a list; numbers
-- that JSON has not as texts.
---@param value any
---@return any value
function plain.to_json(value)
  if type(value) == "number" and value - value ~= 0 then return digits_of(value) end
  if type(value) ~= "table" then return value end
  local copy, count = {}, 0
  for key, inner in pairs(value) do -- any order: a copy
    count = count + 1
    if not rawequal(inner, plain.NIL) then copy[key] = plain.to_json(inner) end
  end
  if count == #value then return copy end
  local texts = {}
  for key, inner in pairs(copy) do texts[text_of(key)] = inner end -- any order: a copy
  return texts
end

local to_text

local function pack_table(t, path, depth)
  check_table(t, path, depth)
  t = without_nulls(t)
  if not is_plain(t) then return pack_pairs(t, path, depth + 1) end
  local copy = {}
  for key, inner in pairs(t) do -- any order: each stands alone
    path[depth + 1] = key
    copy[key] = pack(inner, path, depth + 1)
  end
  return copy
end

--- Return a value as plain data.
--
-- @raise what cannot be saved, with its location: a function, a userdata, a table with
-- a metatable or one that comes twice
---@param value any null of JSON is nil
---@param path rfsm.snapshot.Path
---@param depth integer how many of its keys lead to the value
---@return any packed
function plain.pack(value, path, depth)
  local kind = type(value)
  if kind == "string" or kind == "boolean" then return value end
  if kind == "number" then
    return is_safe(value) and value or { "%n", digits_of(value) }
  elseif value == nil or is_null(value) then
    return nil
  elseif kind ~= "table" then
    fail("%s: a %s cannot be saved", place_of(path, depth), kind)
  end
  if rawequal(value, plain.NIL) then return { "%z" } end
  if path.base + depth <= MAX_DIRECT or path.is_text then
    return pack_table(value, path, depth)
  end
  path.is_text = true -- the tables in it, too
  local packed = pack_table(value, path, depth)
  path.is_text = nil
  return { "%s", to_text(packed) }
end

pack = plain.pack

-- Text ----------------------------------------------------------------------------

-- Returns packed data as a text: `5:hello`, `#1.5;`, `+`, `-`, `{` key value ... `}`.
function to_text(packed)
  local kind = type(packed)
  if kind == "string" then return #packed .. ":" .. packed end
  if kind == "number" then return "#" .. digits_of(packed) .. ";" end
  if kind == "boolean" then return packed and "+" or "-" end
  local parts = { "{" }
  for _, key in ipairs(rfsm.sorted_keys(packed)) do
    parts[#parts + 1] = to_text(key) .. to_text(packed[key])
  end
  parts[#parts + 1] = "}"
  return concat(parts)
end

local NUMBERS = { nan = 0 / 0, inf = huge, ["-inf"] = -huge }

local function unpack_number(digits)
  local number = NUMBERS[digits] or type(digits) == "string" and tonumber(digits)
  if not number then fail("a number as text expected, got %s", type(digits)) end
  return number
end

-- Returns the packed data that begins at a position of a text, and where it ends.
local function from_text(text, at, depth)
  local mark = text:sub(at, at)
  if mark == "+" or mark == "-" then return mark == "+", at + 1 end
  if mark == "#" then
    local digits, last = text:match("^([^;]*);()", at + 1)
    return unpack_number(digits), last
  elseif mark ~= "{" then
    local size, first = text:match("^(%d+):()", at)
    local last = size and first + size - 1
    if not last or #text < last then fail("the text of a table expected") end
    return text:sub(first, last), last + 1
  elseif depth > MAX_PACKED_DEPTH then
    fail("at most %d tables inside each other expected", MAX_PACKED_DEPTH)
  end
  local t = {}
  at = at + 1
  while text:sub(at, at) ~= "}" do
    local key, behind = from_text(text, at, depth + 1)
    if type(key) == "table" or key ~= key then fail("a key expected") end
    t[key], at = from_text(text, behind, depth + 1)
  end
  return t, at + 1
end

-- Unpack ------------------------------------------------------------------------

local unpack

local function unpack_pairs(list, depth)
  local t = {}
  for i = 2, #list, 2 do
    local key = unpack(list[i], depth)
    if not is_scalar(key) or key ~= key then
      fail("a key expected, got %s", text_of(key))
    end
    t[key] = unpack(list[i + 1], depth)
  end
  return t
end

local function unpack_table(packed, depth)
  local first = rawget(packed, 1)
  if depth >= MAX_PACKED_DEPTH then
    fail("at most %d tables inside each other expected", MAX_PACKED_DEPTH)
  elseif first == "%t" then
    return unpack_pairs(packed, depth + 1)
  elseif first == "%n" then
    return unpack_number(packed[2])
  elseif first == "%s" and type(packed[2]) == "string" then
    return unpack((from_text(packed[2], 1, depth)), depth + 1)
  elseif first == "%p" then
    return packed[2]
  elseif first == "%z" then
    return plain.NIL
  end
  local t = {}
  for key, value in pairs(packed) do -- any order: each stands alone
    if not is_scalar(key) then fail("a text as key expected, got %s", type(key)) end
    t[key] = unpack(value, depth + 1)
  end
  return t
end

--- Return the value that plain data stands for, in new tables.
-- @raise if it is none
---@param packed any
---@param depth integer how many tables there are around it
---@return any value
function plain.unpack(packed, depth)
  local kind = type(packed)
  if kind == "table" then
    if is_null(packed) then return nil end
    return unpack_table(packed, depth)
  end
  if kind ~= "number" then
    if is_scalar(packed) or packed == nil then return packed end
    if is_null(packed) then return nil end
    fail("text, number, boolean or table expected, got %s", kind)
  elseif packed ~= packed then
    fail("a number expected, got NaN")
  end
  return to_integer and to_integer(packed) or packed -- some decoders know only floats
end

unpack = plain.unpack

return plain
