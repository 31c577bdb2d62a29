--- Zones: sets of values of clocks that run at the same speed.
--
-- A zone of n clocks is a difference bound matrix (Dill 1989): for each pair i, j from
-- 0 to n it has a bound on x_i - x_j, where x_0 is always 0. The matrix is a list, row
-- by row. It is closed: no bound becomes less if other bounds are combined. A bound is
-- a number: 2b + 1 means "at most b", 2b means "less than b", and infinity is no bound.
--
-- @module rfsm.explore.zones
-- @license BSD-3-Clause

local ipairs = ipairs
local huge, min = math.huge, math.min

local zones = {}

--- Return the bound "at most b".
function zones.at_most(b) return 2 * b + 1 end

--- Return the bound "less than b".
function zones.below(b) return 2 * b end

--- Return a bound that is higher by `time`, which may be negative.
function zones.later(bound, time) return bound + 2 * time end

local ZERO = zones.at_most(0)

local function sum(a, b)
  if a == huge or b == huge then return huge end
  if a % 2 == 1 and b % 2 == 1 then return a + b - 1 end
  return a + b - a % 2 - b % 2
end

--- Return the zone that has no clocks.
function zones.new() return { ZERO } end

--- Return the zone of all values that the clocks may have as time goes on.
---@param zone number[]
---@param count integer clocks
---@return number[] zone a new list
function zones.up(zone, count)
  local later, size = {}, count + 1
  for at, bound in ipairs(zone) do
    later[at] = at > size and at % size == 1 and huge or bound
  end
  return later
end

--- Return a zone with one more bound, on x_i - x_j.
---@param zone number[]
---@param count integer clocks
---@param i integer
---@param j integer
---@param bound number
---@return number[]|nil zone nil if it is empty
function zones.bounded(zone, count, i, j, bound)
  local size, closed = count + 1, {}
  if bound >= zone[i * size + j + 1] then return zone end
  if sum(zone[j * size + i + 1], bound) < ZERO then return nil end
  for k = 0, count do
    local before = sum(zone[k * size + i + 1], bound)
    for l = 0, count do
      local at = k * size + l + 1
      closed[at] = min(zone[at], sum(before, zone[j * size + l + 1]))
    end
  end
  return closed
end

--- Return a zone that keeps some of the clocks, and has new clocks that begin at 0.
---@param zone number[]
---@param count integer clocks
---@param sources integer[] numbers of clocks that stay; 0 for a new one
---@return number[] zone
function zones.project(zone, count, sources)
  local size, result = count + 1, {}
  for k = 0, #sources do
    local from = (sources[k] or 0) * size
    for l = 0, #sources do
      result[#result + 1] = k == l and ZERO or zone[from + (sources[l] or 0) + 1]
    end
  end
  return result
end

--- Return a zone in which clock i has gone back by `time`.
---@param zone number[]
---@param count integer clocks
---@param i integer
---@param time number
---@return number[] zone
function zones.back(zone, count, i, time)
  if time == 0 then return zone end
  local size, result = count + 1, {}
  for k = 0, count do
    for l = 0, count do
      local at = k * size + l + 1
      local change = k == l and 0 or k == i and -time or l == i and time or 0
      result[at] = zones.later(zone[at], change)
    end
  end
  return result
end

--- Are all values of the second zone in the first one?
---@param zone number[]
---@param other number[] the second zone, which has the same number of clocks
---@return boolean
function zones.includes(zone, other)
  for at = 1, #zone do
    if other[at] > zone[at] then return false end
  end
  return true
end

return zones
