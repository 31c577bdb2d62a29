--- Order: loops over the keys of a table that skip no key, on every Lua.
--
-- `rfsm.sorted_keys` returns the keys of a table in order. `order.each` is for loops in
-- which the order does not matter.
--
-- LuaJIT 2.1.0-beta3 may compile `next` wrongly. A traversal inside another one skips
-- keys. If the machine code swaps the two results, a pointer loses its upper half, and
-- the process crashes. LuaJIT compiles no loop over `order.each`, and no loop around
-- such a loop, so loops that run often use `order.each`. In other Luas, `order.each` is
-- the same as a loop with `next`.
--
-- @module rfsm.shared.order
-- @license BSD-3-Clause

local ipairs, next, rawget = ipairs, next, rawget
local jit = rawget(_G, "jit")

local order = {}

local step = next
if jit then
  function step(t, key) return next(t, key) end
  jit.off(step)
end

--- Traverse a table as `pairs` does, but without metamethods.
function order.each(t) return step, t end

--- Has a table no keys?
function order.is_empty(t) return step(t) == nil end

--- Is f(value) true for each value of a list?
function order.all(list, f)
  for _, value in ipairs(list) do
    if not f(value) then return false end
  end
  return true
end

--- Is f(value) true for a value of a list?
function order.any(list, f)
  for _, value in ipairs(list) do
    if f(value) then return true end
  end
  return false
end

--- List what f(value, ...) returns for each value of a list.
function order.map(list, f, ...)
  local results = {}
  for i, value in ipairs(list) do results[i] = f(value, ...) end
  return results
end

--- Append a value to the list t[key], which is made if it is absent.
function order.append(t, key, value)
  local list = t[key] or {}
  t[key], list[#list + 1] = list, value
end

return order
