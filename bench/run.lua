-- The figures of doc/performance.md:  LUA bench/run.lua [WORKLOAD ...]
--
-- Each workload runs in turn with its limit (A B A B ...): the same callbacks, called
-- by a hand-written table, each through pcall, with no queue, hierarchy or hooks.
-- Printed is the share of the limit's rate that the core reaches: median of the rounds,
-- lowest and highest.

package.path = "./?.lua;" .. package.path

local rfsm = require "rfsm"
local workloads = require "bench.workloads"

local ROUNDS = tonumber(os.getenv("ROUNDS")) or 7
local SECONDS = tonumber(os.getenv("SECONDS")) or 0.1 -- per measurement

local function time(f, n)
  local start = os.clock()
  f(n)
  return os.clock() - start
end

-- How many events take about SECONDS.
local function calibrate(f)
  local n = 1
  while true do
    local seconds = time(f, n)
    if seconds > SECONDS / 4 then return math.ceil(n * SECONDS / seconds) end
    n = n * 4
  end
end

-- Rates of both sides, measured in turn: returns the sorted shares and median rates.
local function compare(subject, limit)
  local subject_n, limit_n = calibrate(subject), calibrate(limit)
  local shares, rates = {}, {}
  for i = 1, ROUNDS do
    collectgarbage()
    local limit_rate = limit_n / time(limit, limit_n)
    collectgarbage()
    local rate = subject_n / time(subject, subject_n)
    shares[i], rates[i] = rate / limit_rate, rate
  end
  table.sort(shares)
  table.sort(rates)
  return shares, rates
end

-- What 1,000 events leave on the heap; not asked of workloads that init machines.
local function bytes_per_event(subject)
  collectgarbage()
  collectgarbage()
  collectgarbage("stop")
  subject(10)
  local before = collectgarbage("count")
  subject(1000)
  local grown = collectgarbage("count") - before
  collectgarbage("restart")
  return grown * 1024 / 1000
end

local function wanted(name)
  if #arg == 0 then return true end
  for _, other in ipairs(arg) do
    if other == name then return true end
  end
  return false
end

local jit = rawget(_G, "jit")
print(("%s, %s, %d rounds"):format(rfsm._VERSION, jit and jit.version or _VERSION,
  ROUNDS))
print("workload   share of the limit (low .. high)      us/event   bytes/event")
for _, workload in ipairs(workloads) do
  if wanted(workload.name) then
    local subject, limit = workload.make(rfsm)
    local shares, rates = compare(subject, limit)
    local middle = math.ceil(ROUNDS / 2)
    local bytes = workload.name:find("^W6") and "-"
      or ("%.1f"):format(bytes_per_event(subject))
    print(("%-13s %6.1f %%   (%.1f .. %.1f)%20.3f %12s"):format(workload.name,
      shares[middle] * 100, shares[1] * 100, shares[ROUNDS] * 100,
      1e6 / rates[middle], bytes))
  end
end
