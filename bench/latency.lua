-- How long does a single event take, and how long at worst?
--
--   LUA bench/latency.lua [WORKLOAD]      (W2; env STEPS=1000000)
--
-- Each send_events and step is timed by itself, with the collector as it is by default,
-- and beside it the limit of the workload: the same callbacks called by hand.

package.path = "./?.lua;" .. package.path

local clock = require "bench.clock"
local measure = require "bench.measure"
local rfsm = require "rfsm"
local workloads = require "bench.workloads"

local BLOCK = 1000

-- The samples stand in blocks: the collector looks at a table in one go, and one of a
-- million would be a pause that belongs to the measurement.
local function new_samples(blocks)
  local samples = {}
  for i = 1, blocks do
    local block = {}
    for j = 1, BLOCK do block[j] = 0 end
    samples[i] = block
  end
  return samples
end

local function fill(block, subject, now)
  for i = 1, BLOCK do
    local start = now()
    subject(1)
    block[i] = now() - start
  end
end

local function sorted(samples)
  local list = {}
  for _, block in ipairs(samples) do
    for i = 1, BLOCK do list[#list + 1] = block[i] end
  end
  table.sort(list)
  return list
end

-- The value that the share `p` of the samples does not exceed.
local function percentile(list, p) return list[math.max(1, math.ceil(p * #list))] end

local function print_row(name, list)
  print(("%-18s %10.0f %10.0f %10.0f %12.0f"):format(name, percentile(list, 0.5),
    percentile(list, 0.99), percentile(list, 0.999), list[#list]))
end

local function nothing() end

-- Core, limit and the bare clock in turn, a block each.
local function measure_all(subjects, blocks, now)
  local samples = {}
  for i = 1, #subjects do
    samples[i] = new_samples(blocks)
    subjects[i](BLOCK)
  end
  collectgarbage()
  local before = collectgarbage("count")
  for block = 1, blocks do
    for i = 1, #subjects do fill(samples[i][block], subjects[i], now) end
  end
  return samples, collectgarbage("count") - before
end

local source = clock.find()
  or measure.fail("no clock finer than os.clock, please install lua-luv or lua-socket")
local blocks = math.ceil(measure.count("STEPS", 1000000) / BLOCK)
local name = arg[1] or "W2"
local workload = measure.select(workloads, { name })[1]
local subject, limit = workload.make(rfsm)
local samples, grown = measure_all({ subject, limit, nothing }, blocks, source.now)

print(("%s, %s: %d events, nanoseconds each, clock: %s"):format(measure.engine(), name,
  blocks * BLOCK, source.name))
print(("%-18s %10s %10s %10s %12s"):format("", "p50", "p99", "p99.9", "max"))
print_row("core", sorted(samples[1]))
print_row("limit", sorted(samples[2]))
print_row("the clock itself", sorted(samples[3]))
print(("the clock is not subtracted; the heap grew by %.1f KiB meanwhile"):format(
  grown))
