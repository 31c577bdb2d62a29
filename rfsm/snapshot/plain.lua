--- Plain data: values as any encoder takes them and any Lua gets them back.
--
-- Texts, booleans, most numbers, lists and tables with texts as keys stand for
-- themselves. A list whose first item begins with % is one of these:
--
--    { "%n", digits }            a number that JSON would spoil
--    { "%t", key, value, ... }   any other table
--    { "%p", table }             plain data as it is: a snapshot in a snapshot
--
-- @module rfsm.snapshot.plain
-- @license BSD-3-Clause

local order = require "rfsm.shared.order"
local rfsm = require "rfsm"
local calls = require "rfsm.shared.calls"

local error, getmetatable, ipairs = error, getmetatable, ipairs
local rawget, tonumber, type = rawget, tonumber, type
local floor, huge = math.floor, math.huge
local math_type, to_integer = rawget(math, "type"), rawget(math, "tointeger")
local text_of = rfsm.text_of

local plain = {}

-- So many tables stand inside each other at most, with those of a snapshot around them:
-- cmsgpack leaves out what is deeper than 16, numbers of two parts included.
local MAX_DEPTH, MAX_PACKED_DEPTH = 13, 20

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
---@field base integer how many tables there are around the owner's
---@field seen table<table, true> tables that have come
---@field packed table<table, true> tables that are plain data already
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

local SCALARS = { boolean = true, number = true, string = true }

--- Is a value a text, a number or a boolean?
---@param value any
---@return boolean
function plain.is_scalar(value) return SCALARS[type(value)] ~= nil end

local is_scalar = plain.is_scalar

-- Pack --------------------------------------------------------------------------

-- Does JSON with 14 digits give back the number, as the integer or float that it is?
local function is_safe(n)
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
  for key in order.each(t) do -- any order: all of them count
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
  elseif depth + path.base >= MAX_DEPTH then
    fail("%s: a snapshot holds at most %d tables inside each other",
      place_of(path, depth), MAX_DEPTH)
  end
  path.seen[t] = true
end

--- Return a value as plain data.
--
-- @raise what cannot be saved, with its location: a function, a userdata, a table with
-- a metatable or one that comes twice
---@param value any
---@param path rfsm.snapshot.Path
---@param depth integer how many of its keys lead to the value
---@return any packed
function plain.pack(value, path, depth)
  local kind = type(value)
  if kind == "string" or kind == "boolean" then return value end
  if kind == "number" then
    return is_safe(value) and value or { "%n", digits_of(value) }
  elseif kind ~= "table" then
    fail("%s: a %s cannot be saved", place_of(path, depth), kind)
  end
  if path.packed[value] then return { "%p", value } end
  check_table(value, path, depth)
  if not is_plain(value) then return pack_pairs(value, path, depth + 1) end
  local copy = {}
  for key, inner in order.each(value) do -- any order: each stands alone
    path[depth + 1] = key
    copy[key] = pack(inner, path, depth + 1)
  end
  return copy
end

pack = plain.pack

-- Unpack ------------------------------------------------------------------------

local NUMBERS = { nan = 0 / 0, inf = huge, ["-inf"] = -huge }

local function unpack_number(digits)
  local number = NUMBERS[digits] or type(digits) == "string" and tonumber(digits)
  if not number then fail("a number as text expected, got %s", type(digits)) end
  return number
end

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
  elseif first == "%p" then
    return packed[2]
  end
  local t = {}
  for key, value in order.each(packed) do -- any order: each stands alone
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
  if kind == "table" then return unpack_table(packed, depth) end
  if kind ~= "number" then
    if is_scalar(packed) or packed == nil then return packed end
    fail("text, number, boolean or table expected, got %s", kind)
  elseif packed ~= packed then
    fail("a number expected, got NaN")
  end
  return to_integer and to_integer(packed) or packed -- some decoders know only floats
end

unpack = plain.unpack

return plain
