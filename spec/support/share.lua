-- What a Lua checks of cases that are slow and the same on all Luas. RFSM_SHARE=2/6 is
-- the second share of six: tools/test.sh gives each of the Luas that it runs its own,
-- and one of thirty to a quick run. Without it, as for a spec by hand, all are checked.

local number, luas = (os.getenv("RFSM_SHARE") or "1/1"):match("^(%d+)/(%d+)$")
number, luas = assert(tonumber(number), "RFSM_SHARE: 2/6 expected"), tonumber(luas)

local LEAST = 3 -- random cases: a claim that may leave out charts has one to compare
local PARTS = math.max(math.floor(luas / 2), 1) -- two Luas check each case of a table

local share = {}

--- Is case i checked here?
function share.has(i) return (i + number) % PARTS == 0 end

--- Returns which of a list are checked here: at least the first.
function share.of(list)
  local own = {}
  for i, item in ipairs(list) do own[#own + 1] = share.has(i) and item or nil end
  return own[1] and own or { list[1] }
end

--- Returns how many of n random cases are checked here: all Luas together try n.
function share.count(n) return math.max(math.ceil(n / luas), math.min(n, LEAST)) end

--- Returns the first seed of the n random cases here, which no other Lua has; `SEED`
--- moves all.
function share.seed(n) return (tonumber(os.getenv("SEED")) or 1) + n * (number - 1) end

--- For cases from a number to the next, `step` apart: returns the step here, and the
--- first number.
function share.every(step) return step * PARTS, 1 + step * (number % PARTS) end

--- Tries a claim of spec/support/claims/ on random charts: RFSM_N, or the share of n.
--- Returns what is wrong; nil if the claim holds. A claim that `is_partial` may leave
--- out charts, but not all.
function share.problem(claim, n, is_partial)
  n = tonumber(os.getenv("RFSM_N")) or share.count(n)
  local count, problem = claim.run(n, share.seed(n))
  if problem or count >= (is_partial and 1 or n) then return problem end
  return ("%d of %d charts were compared"):format(count, n)
end

return share
