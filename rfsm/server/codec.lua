--- JSON for clients of a server, by the package dkjson.
--
-- @module rfsm.server.codec
-- @license BSD-3-Clause

local opts = require "rfsm.shared.options"

local pairs, rawget, setmetatable = pairs, rawget, setmetatable
local tonumber, type = tonumber, type
local math_type = rawget(math, "type")

local codec = {}

local function need() return opts.need("rfsm.server", "dkjson") end

-- Returns a value that dkjson encodes as this text.
local function as(text)
  return setmetatable({}, { __tojson = function() return text end })
end

-- Returns a copy of data for dkjson, to which a number `n` is the length of a list, and
-- which writes 14 digits of a float.
local function exact(value)
  if type(value) == "number" and tonumber(("%.14g"):format(value)) ~= value
    and value - value == 0 and not (math_type and math_type(value) == "integer") then
    return as(("%.17g"):format(value))
  elseif type(value) ~= "table" then
    return value
  end
  local copy, n = {}, value.n
  for key, inner in pairs(value) do copy[key] = exact(inner) end -- any order: a copy
  if type(n) == "number" then copy.n = as(codec.encode(n)) end
  return copy
end

--- Return data as JSON. Raises an error if it has what JSON has not.
function codec.encode(data) return need().encode(exact(data)) end

--- Return what a text of JSON stands for, in tables without metatables; else nil.
function codec.decode(text) return (need().decode(text, 1, nil, nil, nil)) end

return codec
