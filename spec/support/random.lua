-- Random numbers (Lehmer's generator, exact in doubles): the same seed gives the same
-- ones on every Lua.

local Random = {}
Random.__index = Random

--- Returns a whole number from 1 to n; random(n) is the same.
function Random:below(n)
  self.state = self.state * 16807 % 2147483647
  return math.floor(self.state / 2147483647 * n) + 1
end

Random.__call = Random.below

function Random:chance(percent) return self:below(100) <= percent end

function Random:pick(list) return list[self:below(#list)] end

local function new_random(seed)
  local random = setmetatable({ state = seed % 2147483646 + 1 }, Random)
  for _ = 1, 5 do random:below(2) end -- the first ones follow the seed
  return random
end

return new_random
