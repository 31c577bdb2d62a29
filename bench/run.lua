-- The figures of doc/performance.md:  LUA bench/run.lua [WORKLOAD ...]
--
-- Each workload runs in turn with its limit (A B A B ...): the same callbacks, called
-- by a hand-written table, each through pcall, with no queue, hierarchy or hooks.
-- Printed is the share of the limit's rate that the core reaches: median of the rounds,
-- lowest and highest. The last column is the garbage of an event; of W6, how many times
-- the memory of the limit is kept. Several workloads run in a process each: what LuaJIT
-- compiled for one would change the next.

package.path = "./?.lua;" .. package.path

local measure = require "bench.measure"
local rfsm = require "rfsm"
local workloads = require "bench.workloads"

local ROUNDS = measure.count("ROUNDS", 7)
local SECONDS = measure.setting("SECONDS", 0.1) -- per measurement

-- Bytes an event leaves behind, or the memory that a machine keeps, in copies.
local function memory_of(workload, subject, limit)
  if not workload.name:find("^W6") then
    return ("%.1f"):format(measure.bytes_grown(subject, 1000) / 1000)
  end
  local bytes = measure.bytes_kept(subject, 20)
  return ("%.2f copies"):format(bytes / measure.bytes_kept(limit, 4))
end

local function row_of(workload)
  local subject, limit = workload.make(rfsm)
  local shares, rates = measure.shares(subject, limit, ROUNDS, SECONDS)
  local middle = math.ceil(ROUNDS / 2)
  return ("%-19s %6.1f %%   (%.1f .. %.1f)%20.3f %12s"):format(workload.name,
    shares[middle] * 100, shares[1] * 100, shares[ROUNDS] * 100,
    1e6 / rates[middle], memory_of(workload, subject, limit))
end

-- Returns the row that this script prints for one workload in a process of its own.
local function row_from_process(workload)
  local lua = 0
  while arg[lua - 1] do lua = lua - 1 end
  local pipe = assert(io.popen(("%s %s '%s' 2>&1"):format(arg[lua], arg[0],
    workload.name)))
  local row = ""
  for line in pipe:lines() do row = line end
  pipe:close()
  return row
end

local selected = measure.select(workloads, arg)
local row = selected[2] and row_from_process or row_of
print(("%s, %s, %d rounds"):format(rfsm._VERSION, measure.engine(), ROUNDS))
print("workload         share of the limit (low .. high)      us/event        memory")
for _, workload in ipairs(selected) do
  print(row(workload))
  io.stdout:flush()
end
