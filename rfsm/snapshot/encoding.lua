--- Plain data: values in a form that each encoder can write, and each Lua reads back.
--
-- A value is *packed* as plain data, and unpacked. Texts, booleans, most numbers,
-- lists, and tables with texts as keys are plain data already. Any other value becomes
-- a list whose first item begins with %:
--
--    { "%n", digits }            a number that JSON would change
--    { "%t", key, value, ... }   a table that is not plain data
--    { "%z" }                    nil in a field whose first value is not nil
--
-- @module rfsm.snapshot.encoding
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local exact_json = require "rfsm.shared.exact_json"
local each = require("rfsm.shared.order").each
local rfsm = require "rfsm"

local error, getmetatable, ipairs, pcall = error, getmetatable, ipairs, pcall
local rawequal, rawget, tonumber, type = rawequal, rawget, tonumber, type
local floor, huge, min = math.floor, math.huge, math.min
local math_type, to_integer = rawget(math, "type"), rawget(math, "tointeger")
local is_null, text_of = exact_json.is_null, rfsm.text_of

-- How deep tables may be nested in packed data, and in the value of a field. The second
-- limit is due to Redis: MessagePack there drops tables deeper than 16. Six tables may
-- be around a field: the value of the key, the snapshot, its regions, one region, its
-- data, and the fields of the state. A number packed as a list is one more.
local MAX_PACKED_DEPTH, MAX_DEPTH = 40, 9

-- The value that represents nil in a field whose first value is not nil.
local NIL = {}

--- Raise a table with the field `text`. Public functions report it as a one-line error.
local function fail(form, ...) error({ text = form:format(...) }, 0) end

-- Returns the text of an error that was raised by `fail`; nil for any other error.
local function text_of_fail(failure)
  return type(failure) == "table" and rawget(failure, "text") or nil
end

--- Return the text of an error, also of one that was raised by `fail`.
local function reason(failure) return text_of_fail(failure) or text_of(failure) end

--- Return f(...). If `fail` has raised an error in it, return nil and the text of the
-- error. Any other error, such as that of a debug hook, is raised again.
local function attempt(f, ...)
  local ok, result = pcall(f, ...)
  if ok then return result end
  return nil, text_of_fail(result) or error(result, 0)
end

--- Return f(...), for a function of the chart. If it raises an error, `fail` raises the
-- text of the error with `what` in front.
local function try(what, f, ...)
  local ok, result = calls.try(f, ...)
  if not ok then fail("%s: %s", what, text_of(result)) end
  return result
end

--- The keys that lead to a value. Messages show them.
---@class rfsm.snapshot.Path
---@field owner string|false where the keys begin, as a text: "queue", "save of root.a";
-- false: at the state of `keeper`
---@field keeper rfsm.snapshot.Keeper|false unused if `owner` is a text
---@field prefix string location of the machine: "root", "root.arms.left"
---@field seen table<table, true>|false tables that were packed already; with
-- `is_by_value` only those around the value
---@field is_by_value boolean? a table may stand in several places: each gets a copy
---@field [integer] any the keys, the outermost first

--- Return the location to which the first `depth` keys lead, such as "root.a.list[2]".
local function location_of(path, depth)
  local location = path.owner or path.prefix .. path.keeper.fqn:sub(5)
  for i = 1, depth do
    local key = path[i]
    location = location .. (type(key) == "number" and "[" .. text_of(key) .. "]"
      or (location == "" and "" or ".") .. text_of(key))
  end
  return location
end

--- Is a value a text, a number or a boolean?
local function is_scalar(value)
  local kind = type(value)
  return kind == "string" or kind == "number" or kind == "boolean"
end

--- Can an event be kept? A text, a number and a boolean can, and an event with data.
local function is_event(value)
  return is_scalar(value) and value == value or rfsm.name_with_data(value) ~= nil
end

--- Return a copy of a value, in which tables without metatables are copied at any
--- depth. `copies` is a table original -> copy, of the copies made before.
local function copy_of(value, copies)
  if type(value) ~= "table" or getmetatable(value) ~= nil then return value end
  copies = copies or {}
  if copies[value] then return copies[value] end
  local copy = {}
  copies[value] = copy
  for key, inner in each(value) do -- any order: a copy
    copy[key] = copy_of(inner, copies)
  end
  return copy
end

-- Pack --------------------------------------------------------------------------

-- Does JSON with 14 digits keep the value of a number, and its type (integer, float)?
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

-- Returns a number as text, from which any Lua reads the same number: 1.0, not 1.
local function digits_of(n)
  if n ~= n then return "nan" end
  if n - n ~= 0 then return n > 0 and "inf" or "-inf" end
  if math_type and math_type(n) == "integer" then return ("%d"):format(n) end
  local digits = rfsm.number_text(n, "%.17g")
  return digits:find("[.e]") and digits or digits .. ".0"
end

local pack

-- Returns { "%t", key, value, ... }, sorted by key, for a table of packed values.
local function to_pairs(packed, path, depth)
  local list = { "%t" }
  for _, key in ipairs(rfsm.sorted_keys(packed)) do
    if not is_scalar(key) then
      fail("%s: a key that is a %s cannot be saved", location_of(path, depth),
        type(key))
    end
    list[#list + 1], list[#list + 2] = pack(key, path, depth), packed[key]
  end
  return list
end

-- Is a table plain data already? A list is, and a table whose keys are texts.
local function is_plain(t)
  local count, has_texts, has_others = 0, false, false
  for key in each(t) do -- any order: all of them count
    count = count + 1
    if type(key) == "string" then has_texts = true else has_others = true end
  end
  if has_texts or count == 0 then -- dkjson takes a number in `n` for the length
    return has_texts and not has_others and type(t.n) ~= "number"
  end
  local first = t[1]
  return count == #t and not (type(first) == "string" and first:byte() == 37)
end

-- Raises an error for a table that is too deep, has a metatable, or was packed before.
-- If a table were packed twice, unpacking would make two tables of it.
local function check_table(t, path, depth)
  path.seen = path.seen or {}
  if getmetatable(t) ~= nil then
    fail("%s: a table with a metatable cannot be saved", location_of(path, depth))
  elseif path.seen[t] then
    fail("%s: this table stands elsewhere in the data, too, and can only be saved once",
      location_of(path, depth))
  elseif depth > MAX_DEPTH then
    fail("%s: at most %d tables inside each other expected",
      location_of(path, min(depth, 1)), MAX_DEPTH)
  end
  path.seen[t] = true
end

local function pack_table(t, path, depth)
  check_table(t, path, depth)
  local copy = {}
  for key, inner in each(t) do -- any order: each is independent
    path[depth + 1] = key
    copy[key] = pack(inner, path, depth + 1)
  end
  if path.is_by_value then path.seen[t] = nil end
  return is_plain(copy) and copy or to_pairs(copy, path, depth)
end

--- Return a value as plain data; nil for null of JSON. The first `depth` keys of `path`
-- lead to the value. Raises an error with the location of a value that cannot be saved:
-- a function, a userdata, a table with a metatable, or a table that comes twice.
function pack(value, path, depth)
  local kind = type(value)
  if kind == "string" or kind == "boolean" then return value end
  if kind == "number" then
    return is_safe(value) and value or { "%n", digits_of(value) }
  elseif value == nil or is_null(value) then
    return nil
  elseif kind ~= "table" then
    fail("%s: a %s cannot be saved", location_of(path, depth), kind)
  end
  if rawequal(value, NIL) then return { "%z" } end
  return pack_table(value, path, depth)
end

--- Return a copy of a value for an encoder of JSON. If a table is no list, its keys
-- become texts. Infinite numbers and NaN become texts, too.
local function to_json(value)
  if type(value) == "number" and value - value ~= 0 then return digits_of(value) end
  if type(value) ~= "table" or is_null(value) then return value end
  local copy, count = {}, 0
  for key, inner in each(value) do -- any order: a copy
    count = count + 1
    if not rawequal(inner, NIL) then copy[key] = to_json(inner) end
  end
  if count == #value then return copy end
  local texts = {}
  for key, inner in each(copy) do texts[text_of(key)] = inner end -- any order: a copy
  return texts
end

-- Unpack ------------------------------------------------------------------------

local NUMBERS = { nan = 0 / 0, inf = huge, ["-inf"] = -huge }

local function unpack_number(digits)
  local number = NUMBERS[digits] or type(digits) == "string"
    and rfsm.number_of(digits)
  if not number then fail("a number as text expected, got %s", type(digits)) end
  local is_whole = not math_type and digits:find("^%-?%d+$")
  if is_whole and ("%.0f"):format(number) ~= digits then
    fail("the number %s: this Lua has only whole numbers up to 2^53 exactly", digits)
  end
  return number
end

local unpack

local function unpack_pairs(list, depth)
  local t = {}
  for i = 2, #list, 2 do
    local key = list[i]
    if type(key) ~= "string" then
      key = unpack(key, depth)
      if not is_scalar(key) or key ~= key then
        fail("a key expected, got %s", text_of(key))
      end
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
  elseif first == "%z" then
    return NIL
  end
  local t = {}
  for key, value in each(packed) do -- any order: each is independent
    if not is_scalar(key) then fail("a text as key expected, got %s", type(key)) end
    t[key] = unpack(value, depth + 1)
  end
  return t
end

--- Return the value that was packed as plain data, in new tables. `depth` is the number
-- of tables around it. Raises an error if `packed` is not plain data.
function unpack(packed, depth)
  local kind = type(packed)
  if kind == "string" or kind == "boolean" or packed == nil then return packed end
  if kind == "number" then
    if packed ~= packed then fail("a number expected, got NaN") end
    return to_integer and to_integer(packed) or packed -- decoders may return floats
  end
  if is_null(packed) then return nil end
  if kind == "table" then return unpack_table(packed, depth) end
  fail("text, number, boolean or table expected, got %s", kind)
end

return {
  NIL = NIL, attempt = attempt, copy_of = copy_of, fail = fail,
  is_event = is_event, is_null = is_null, is_scalar = is_scalar,
  location_of = location_of, pack = pack, reason = reason,
  to_json = to_json, try = try, unpack = unpack,
}
