--- Prints values for a person.
--
-- @module rfsm.observe.values
-- @license BSD-3-Clause

local rfsmpp = require "rfsmpp"

local print, select = print, select
local concat = table.concat

local values = {}

--- Return a value as a text for a person.
values.value = rfsmpp.value_text

--- Print values in one line, if there are any.
function values.print_values(...)
  local texts = {}
  for i = 1, select("#", ...) do texts[i] = values.value((select(i, ...))) end
  if texts[1] then print(concat(texts, "\t")) end
end

return values
