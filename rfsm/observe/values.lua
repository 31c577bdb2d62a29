--- Converts values to texts for a person, and prints them.
--
-- @module rfsm.observe.values
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local getmetatable, ipairs, print = getmetatable, ipairs, print
local select, type = select, type
local concat = table.concat
local text_of = rfsm.text_of

local values = {}

local MAX_SHOWN, MAX_DEPTH = 20, 3 -- table entries; levels of tables

local show

local function show_table(t, depth)
  local texts, is_item = {}, {}
  for i = 1, #t do texts[i], is_item[i] = show(t[i], depth + 1), true end
  for _, key in ipairs(rfsm.sorted_keys(t)) do
    local name = type(key) == "string" and key or "[" .. show(key, depth + 1) .. "]"
    if not is_item[key] then
      texts[#texts + 1] = name .. " = " .. show(t[key], depth + 1)
    end
  end
  if #texts > MAX_SHOWN then texts = { concat(texts, ", ", 1, MAX_SHOWN), "..." } end
  return texts[1] and "{ " .. concat(texts, ", ") .. " }" or "{}"
end

-- Returns a value as a text for a person. `depth` is the number of tables around it.
function show(value, depth)
  if type(value) == "string" and depth > 0 then return ("%q"):format(value) end
  if rfsm.is_node(value) then return text_of(value) end
  if type(value) ~= "table" or getmetatable(value) or depth >= MAX_DEPTH then
    return text_of(value)
  end
  return show_table(value, depth)
end

--- Return a value as a text for a person.
function values.value(value) return show(value, 0) end

--- Print values in one line, if there are any.
function values.print_values(...)
  local texts = {}
  for i = 1, select("#", ...) do texts[i] = show(select(i, ...), 0) end
  if texts[1] then print(concat(texts, "\t")) end
end

return values
