--- Check sums of JSON objects in files: each object ends with a field `sum`.
--
-- A sum finds each byte that is wrong, and of greater damage all but one case in four
-- thousand millions. An object without a sum is one of an older release.
--
-- @module rfsm.shared.sums
-- @license BSD-3-Clause

local sums = {}

local PRIME, FACTOR = 4294967291, 65599 -- below 2^32; a step stays below 2^53

--- Return the check sum of a text, a whole number below 2^32.
function sums.of(text)
  local sum, count = 0, #text
  for i = 1, count - 3, 4 do
    local a, b, c, d = text:byte(i, i + 3)
    sum = (sum * FACTOR + a) % PRIME
    sum = (sum * FACTOR + b) % PRIME
    sum = (sum * FACTOR + c) % PRIME
    sum = (sum * FACTOR + d) % PRIME
  end
  for i = count - count % 4 + 1, count do
    sum = (sum * FACTOR + text:byte(i)) % PRIME
  end
  return sum
end

local function digits_of(text)
  local sum = sums.of(text) -- %x takes no number from 2^31 on everywhere
  return ("%04x%04x"):format((sum - sum % 65536) / 65536, sum % 65536)
end

--- Return the text of a JSON object, which has fields, with its check sum.
function sums.add(text)
  return ('%s,"sum":"%s"}'):format(text:sub(1, -2), digits_of(text))
end

--- Return the text of a JSON object without its check sum, and whether it had one. If
--- the sum is wrong, return nil and the problem.
function sums.remove(text)
  local rest, digits = text:match('^(.*),"sum":"(%x%x%x%x%x%x%x%x)"}%s*$')
  if not rest then return text, false end
  rest = rest .. "}"
  if digits_of(rest) == digits then return rest, true end
  return nil, "the check sum is wrong: the text has changed since it was written"
end

return sums
