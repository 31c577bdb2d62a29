--- Swaps: fields of machines and their elements that a tool replaces for a while.
--
-- @module rfsm.shared.swap
-- @license BSD-3-Clause

local rawequal, rawget = rawequal, rawget

local swap = {}

--- Replace a field, and note that in a list.
---@param swaps table[]
---@param obj table
---@param field string
---@param value any
---@return table done `own` is the value before
function swap.put(swaps, obj, field, value)
  local done = { obj = obj, field = field, own = rawget(obj, field), new = value }
  swaps[#swaps + 1] = done
  obj[field] = value
  return done
end

--- Give the fields in a list back, unless somebody has set others meanwhile.
---@param swaps table[]
function swap.give_back(swaps)
  for i = #swaps, 1, -1 do
    local done = swaps[i]
    if rawequal(rawget(done.obj, done.field), done.new) then
      done.obj[done.field] = done.own
    end
    swaps[i] = nil
  end
end

return swap
