--- Swaps: fields of machines and their elements that a tool replaces for a while.
--
-- @module rfsm.shared.swap
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local rfsm = require "rfsm"

local rawequal, rawget = rawequal, rawget

local swap = {}

--- Replace a field, and note that in a list.
---@param swaps table[]
---@param obj table
---@param field string
---@param value any
---@return { own: any, new: any } done the value before, and that of now
function swap.put(swaps, obj, field, value)
  local done = { obj = obj, field = field, own = rawget(obj, field), new = value }
  swaps[#swaps + 1] = done
  obj[field] = value
  return done
end

--- Have a printer of a machine call a function first.
---@param swaps table[]
---@param fsm rfsm.Machine
---@param name "dbg"|"info"|"warn"|"err"
---@param note fun(...)
function swap.listen(swaps, fsm, name, note)
  local own = fsm[name]
  swap.put(swaps, fsm, name, function(...)
    note(...)
    if rfsm.is_callable(own) then return own(...) end
    if own then rawget(_G, "print")(calls.text("\t", ...)) end -- true prints
  end)
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
