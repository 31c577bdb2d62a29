-- The share of each Lua in what is slow and the same on all of them: `make test` runs
-- them all, and each checks other cases.

local LUAS = { "Lua 5.1", "LuaJIT", "Lua 5.2", "Lua 5.3", "Lua 5.4", "Lua 5.5" }

local own = rawget(_G, "jit") and "LuaJIT" or _VERSION
local number = 0
for i, name in ipairs(LUAS) do number = name == own and i or number end

local share = {}

--- Returns the seed of n random cases, which no other Lua has; `SEED` moves all.
function share.seed(n)
  return (tonumber(os.getenv("SEED")) or 1) + n * math.max(number - 1, 0)
end

--- Is case i checked here? Two of the six Luas check it.
function share.has(i) return (i + number) % 3 == 0 end

return share
