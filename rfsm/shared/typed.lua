--- Typed events: reads the form in which tools show an event, `e_paid{amount=12}`.
--
-- The data are a Lua table or JSON, of texts, numbers, booleans and tables. Nothing in
-- them is run. A field that is `nil` or `null` is left out.
--
-- @module rfsm.shared.typed
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, pcall, rawget, select = error, pcall, rawget, select
local tonumber, tostring, type = tonumber, tostring, type
local abs, char, floor, max = math.abs, string.char, math.floor, math.max
local math_type = rawget(math, "type")

local typed = {}

local LEVELS = 9 -- tables inside each other, as in snapshots

--- A text, and the position of the next character to read.
---@class rfsm.shared.Reader
---@field text string
---@field at integer
---@field last integer the end of what a person has typed
---@field key any the field whose value is read

-- Raises the problem in one line: what is expected, and what is there, or this word.
local function fail(reader, expected, word, hint)
  local rest = word or reader.text:sub(reader.at, reader.last)
  rest = rest:match("^%s*(.-)%s*$"):gsub("%c", " ")
  rest = #rest > 20 and rest:sub(1, 20):gsub("[\194-\244]?[\128-\191]*$", "") .. ".."
    or rest
  error({ ("data: %s expected, got %s%s"):format(expected,
    rest == "" and "the end" or "'" .. rest .. "'", hint or "") }, 0)
end

-- Returns what a pattern captures behind blanks, and goes behind it; nil if the text is
-- different there.
local function take(reader, pattern)
  local first, last, found = reader.text:find("^%s*" .. pattern, reader.at)
  if not first then return nil end
  reader.at = last + 1
  return found or true
end

-- Texts .............................................................................

local ESCAPES = { a = "\a", b = "\b", f = "\f", n = "\n", r = "\r", t = "\t", v = "\v" }

-- Returns a character of Unicode as UTF-8.
local function utf8_of(code)
  if code < 128 then return char(code) end
  local low = char(128 + code % 64)
  code = floor(code / 64)
  if code < 32 then return char(192 + code) .. low end
  low = char(128 + code % 64) .. low
  code = floor(code / 64)
  if code < 16 then return char(224 + code) .. low end
  return char(240 + floor(code / 64), 128 + code % 64) .. low
end

-- Two \uXXXX, a high and a low one, stand for one character.
local PAIR = "\237([\160-\175])([\128-\191])\237([\176-\191])([\128-\191])"

local function join_pair(a, b, c, d)
  return utf8_of(0x10000 + (a:byte() - 160) * 65536 + (b:byte() - 128) * 1024
    + (c:byte() - 176) * 64 + d:byte() - 128)
end

-- Returns what a backslash and the character behind it mean. The digits behind both
-- may belong to them.
local function meaning_of(character, digits)
  if character == "u" and #digits == 4 then return utf8_of(tonumber(digits, 16)) end
  local number, rest = (character .. digits):match("^(%d%d?%d?)(.*)$")
  if number and tonumber(number) < 256 then return char(tonumber(number)) .. rest end
  return (ESCAPES[character] or character) .. digits
end

local function unescape(text)
  return (text:gsub("\\(.)(%x?%x?%x?%x?)", meaning_of):gsub(PAIR, join_pair))
end

local function read_text(reader, quote)
  local from = reader.at
  while true do
    local at = reader.text:find("[\\" .. quote .. "]", reader.at)
    if not at then fail(reader, "the end of a text in quotes") end
    reader.at = at + (reader.text:sub(at, at) == "\\" and 2 or 1)
    if reader.text:sub(at, at) == quote then
      return unescape(reader.text:sub(from, at - 1))
    end
  end
end

-- Values ............................................................................

local WORDS = { ["true"] = true, ["false"] = false }

local read_value

-- Reads the key of a field, and the sign behind it. Returns nil if a value follows that
-- has no key.
local function read_key(reader, level)
  local from, key = reader.at, take(reader, "([%a_][%w_]*)%s*[=:]")
  if key then return key end
  local is_in_brackets = take(reader, "%[")
  local ok
  ok, key = pcall(read_value, reader, level)
  if ok and (not is_in_brackets or take(reader, "%]")) and take(reader, "[=:]") then
    return key
  end
  reader.at = from
end

-- Reads the fields of a table in braces, or the items of a list in square brackets. Its
-- beginning was read, `closing` is its end.
local function read_table(reader, closing, level)
  local fields, n = {}, 0
  if level == LEVELS then fail(reader, "at most 9 tables inside each other") end
  while not take(reader, "%" .. closing) do
    local key = nil
    if closing == "}" then key = read_key(reader, level + 1) end
    if key == nil then n = n + 1 end
    reader.key = key
    fields[key == nil and n or key] = read_value(reader, level + 1)
    if not take(reader, "[,;]")
      and not reader.text:find("^%s*%" .. closing, reader.at) then
      fail(reader, "',' or '" .. closing .. "'")
    end
  end
  return fields
end

-- Raises what is wrong with a value. A word behind a name was probably meant as a text.
local function refuse_value(reader)
  local key, expected = reader.key, "a text in quotes, a number, true, false or a table"
  if key == nil then fail(reader, expected) end
  local word = reader.text:sub(1, reader.last):match("^%s*([%w_][^,;{}%[%]\"']*)",
    reader.at)
  word = word and word:gsub("%s+$", "")
  fail(reader, ("field '%s': %s"):format(tostring(key), expected), word,
    word and not tonumber(word) and (' (did you mean "%s"?)'):format(word))
end

local function read_number(reader)
  local from, word = reader.at, take(reader, "(-?%.?%d[%w.+-]*)")
  local number = word and tonumber(word)
  local is_finite = number and number - number == 0
  local is_exact = is_finite and (abs(number) < 2 ^ 53 or word:find("[.eE]")
    or math_type and math_type(number) == "integer")
  if is_exact then return number end
  reader.at = from
  if is_finite then fail(reader, "a whole number below 2^53", word) end
  refuse_value(reader)
end

function read_value(reader, level)
  local quote = take(reader, "([\"'])")
  if quote then return read_text(reader, quote) end
  if take(reader, "{") then return read_table(reader, "}", level) end
  if take(reader, "%[") then return read_table(reader, "]", level) end
  local from, word = reader.at, take(reader, "(%a+)")
  if word == "nil" or word == "null" then return nil end
  if WORDS[word] ~= nil then return WORDS[word] end
  reader.at = from
  return read_number(reader)
end

-- Public functions ..................................................................

-- Reads a whole text by a function of a reader; returns nil and the problem if it is
-- wrong. `last` is the end of what a person has typed.
local function read_all(text, last, f)
  local reader = { text = text, at = 1, last = last }
  local ok, result = pcall(function()
    local value = f(reader)
    if reader.text:find("%S", reader.at) then fail(reader, "the end") end
    return value
  end)
  if ok then return result end
  if type(result) ~= "table" then error(result, 0) end
  return nil, result[1]
end

--- Read data: `{ amount = 12 }`, `{"amount": 12}`, or the fields without braces.
---@param text string
---@return table? data
---@return string? problem one line
function typed.data(text)
  local last = #text
  if not text:find("^%s*{") then
    text = "{" .. text .. "}"
    last = last + 1
  end
  return read_all(text, last, function(reader)
    take(reader, "{")
    return read_table(reader, "}", 0)
  end)
end

--- Read a value; a text without quotes that is no other value is itself.
---@param text string
---@return any value
function typed.value(text)
  local value = nil
  local ok, problem = read_all(text, #text, function(reader)
    value = read_value(reader, 1)
    return true
  end)
  if ok then return value end
  if text:find("^%s*[%[{\"']") then return nil, problem end
  return text
end

--- Return the event with a name and data; nil and the problem if it cannot be read.
---@param name string
---@param text? string the data; without it the event has none
---@return table? event
---@return string? problem
function typed.event(name, text)
  local event, problem = typed.data(text or "")
  if not event then return nil, problem end
  if event.name ~= nil and event.name ~= name then
    return nil, "data: 'name' is the name of the event, not a field of its data"
  end
  event.name = name
  return event
end

--- Read an event as a person types it: a text is itself, `e_paid{amount=12}` is a table
--- with the name `e_paid`, and so is JSON with a `name`.
---@param text string
---@return any event
---@return string? problem
function typed.read(text)
  local name, data = text:match("^%s*([^{%s@(][^{@(]*)({.*)$")
  name = name and name:gsub("%s+$", "")
  if name then return typed.event(name, data) end
  if not text:find("^%s*{") then return text end
  local event, problem = typed.data(text)
  if not event then return nil, problem end
  if type(event.name) ~= "string" then
    return nil, "data: a text 'name' expected, " .. (event.name == nil and "got none"
      or "got " .. type(event.name))
  end
  return event
end

--- Return the text of a history, whose events with data are JSON, with these as tools
--- show them. What a person has done, which is in parentheses, stays as it is.
---@param text string
---@return string
function typed.shown(text)
  local from, rest = text:find "{", nil
  if not from or text:find "^%(" then return text end
  local event = read_all(text:sub(from), #text, function(reader)
    local value = read_value(reader, 1)
    rest, reader.at = reader.text:sub(reader.at), #reader.text + 1
    return value
  end)
  if not rfsm.name_with_data(event) then return text end
  return text:sub(1, from - 1) .. rfsm.event_text(event, true) .. typed.shown(rest)
end

--- Split a line into words at blanks and commas. What is in braces behind a word is a
--- part of the word.
---@param text string
---@return string[] words
function typed.split(text)
  local words, at = {}, 1
  while true do
    local from, to = text:find("[^%s,{]*", text:find("[^%s,]", at) or #text + 1)
    local brace = select(2, text:find("^%s*%b{}", to + 1))
    if from > #text then return words end
    to = brace or max(to, from)
    words[#words + 1] = text:sub(from, to)
    at = to + 1
  end
end

return typed
