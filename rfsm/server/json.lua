--- JSON for clients of a server, by the package dkjson.
--
-- @module rfsm.server.json
-- @license BSD-3-Clause

local opts = require "rfsm.shared.options"

local pairs, setmetatable, type = pairs, setmetatable, type

local json = {}

local function need() return opts.need("rfsm.server", "dkjson", "lua-dkjson") end

-- Returns a copy of data. A number `n` is in a table: for dkjson it is the length of a
-- list.
local function for_json(value)
  if type(value) ~= "table" then return value end
  local copy, n = {}, value.n
  for key, inner in pairs(value) do copy[key] = for_json(inner) end -- any order: a copy
  if type(n) == "number" then
    copy.n = setmetatable({}, { __tojson = function() return json.encode(n) end })
  end
  return copy
end

--- Return data as JSON.
-- @raise if it has what JSON has not, or dkjson is missing
---@param data any
---@return string text
function json.encode(data) return need().encode(for_json(data)) end

--- Return what a text of JSON stands for, in tables without metatables.
---@param text string
---@return any data nil if it is no JSON
function json.decode(text) return (need().decode(text, 1, nil, nil, nil)) end

return json
