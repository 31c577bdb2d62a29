--- JSON that is the same on every Lua: sorted keys, numbers with all their digits.
--
-- A list is a table whose keys are 1 to n; the empty table is an object. Other keys
-- that are numbers become texts.
--
-- @module rfsm.shared.exact_json
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, getmetatable, next = error, getmetatable, next
local pcall, rawget, tonumber, tostring = pcall, rawget, tonumber, tostring
local type = type
local floor = math.floor
local concat, sort = table.concat, table.sort
local number_text, text_of = rfsm.number_text, rfsm.text_of
local jit, math_type = rawget(_G, "jit"), rawget(math, "type")

local exact_json = {}

local EXACT = 2 ^ 53 -- every Lua has all whole numbers up to this one
local MAX_DEPTH = 100

--- Is a value the null of a JSON decoder?
local function is_null(value)
  local kind = type(value)
  if kind == "userdata" then return text_of(value):find("[Nn][Ui][Ll]") ~= nil end
  local class = kind == "table" and getmetatable(value)
  if not class then return false end
  local to_json = type(class) == "table" and rawget(class, "__tojson")
  if type(to_json) ~= "function" then return false end
  local ok, text = pcall(to_json, value)
  return ok and text == "null"
end

exact_json.is_null = is_null

--- Return the digits of a number, enough of them to read it back. They are the same on
--- every Lua (5.3 prints 5.0) and in every locale. An infinite number is an error.
---@param n number
---@return string digits
function exact_json.digits_of(n)
  if n - n ~= 0 then error("the number " .. tostring(n) .. " has no JSON", 0) end
  if math_type and math_type(n) == "integer" then return ("%d"):format(n) end
  if floor(n) == n and n <= EXACT and n >= -EXACT then return ("%.0f"):format(n) end
  local format
  for digits = 14, 17 do
    format = "%." .. digits .. "g"
    if tonumber(format:format(n)) == n then break end -- both have the host's point
  end
  return number_text(n, format)
end

local ESCAPES = { ['"'] = '\\"', ["\\"] = "\\\\", ["\n"] = "\\n", ["\t"] = "\\t" }

local function escape(char)
  return ESCAPES[char] or ("\\u%04x"):format(char:byte())
end

local function quote(text)
  if not text:find('[%c"\\]') then return '"' .. text .. '"' end
  return '"' .. text:gsub('[%c"\\]', escape) .. '"'
end

local encode

local function encode_list(list, depth)
  local texts = {}
  for i = 1, #list do texts[i] = encode(list[i], depth) end
  return "[" .. concat(texts, ",") .. "]"
end

-- Returns the keys of an object in order. Most objects have only texts as keys, and in
-- most locales `sort` orders them by their bytes.
local function keys_of(object)
  local keys, count = {}, 0
  for key in next, object do -- any order: they are sorted
    if type(key) ~= "string" then return rfsm.sorted_keys(object) end
    count = count + 1
    keys[count] = key
  end
  sort(keys, "B" > "a" and rfsm.text_before or nil)
  return keys
end

local function encode_object(object, depth)
  local fields = keys_of(object)
  for i = 1, #fields do
    local key = fields[i]
    local kind = type(key)
    if kind ~= "string" and kind ~= "number" then
      error("a text or number as key expected, got " .. kind, 0)
    end
    local name = kind == "number" and text_of(key) or key
    fields[i] = quote(name) .. ":" .. encode(object[key], depth)
  end
  return "{" .. concat(fields, ",") .. "}"
end

-- Is a table a list? A list has the keys 1 to n, at least one, and no other keys.
local function is_list(t)
  if rawget(t, 1) == nil then return false end
  local count = 0
  for _ in next, t do count = count + 1 end -- any order: they are counted
  return count == #t
end

for _, f in ipairs(jit and { keys_of, is_list } or {}) do
  jit.off(f) -- LuaJIT may compile `next` wrongly
end

local ENCODERS = { string = quote, number = exact_json.digits_of, boolean = tostring }

function ENCODERS.table(t, depth)
  if getmetatable(t) and is_null(t) then return "null" end
  if depth == MAX_DEPTH then
    error("at most " .. MAX_DEPTH .. " tables inside each other expected", 0)
  end
  return (is_list(t) and encode_list or encode_object)(t, depth + 1)
end

function encode(value, depth)
  local encoder = ENCODERS[type(value)]
  if encoder then return encoder(value, depth) end
  if is_null(value) then return "null" end
  error("a " .. type(value) .. " has no JSON", 0)
end

--- Return a value as a text of JSON.
-- @raise if the value has a part that JSON lacks: a function, NaN, a table in itself
---@param value any
---@return string text
function exact_json.encode(value) return encode(value, 0) end

return exact_json
