-- Time and memory of an exploration:  LUA bench/explore.lua [REGIONS [LEAVES [run]]]
--
-- The chart has so many machines side by side in a sequential AND state, each a ring of
-- so many leaves with events of its own. It has a configuration for each combination.
-- With `run` each transition has a guard that is called, so that data are compared.

package.path = "./?.lua;" .. package.path

local measure = require "bench.measure"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"

local regions, leaves = tonumber(arg[1]) or 5, tonumber(arg[2]) or 10

local function is_open(tr) return tr.src._parent.n == 0 end

local guard = arg[3] == "run" and is_open or nil

local function ring(name)
  local model = { info = false, warn = false, n = 0 }
  for i = 1, leaves do
    model["s" .. i] = rfsm.state {}
    model[i] = rfsm.trans { src = "s" .. i, tgt = "s" .. i % leaves + 1,
      events = { "e_" .. name .. "_" .. i % 2 }, guard = guard }
  end
  model[leaves + 1] = rfsm.trans { src = "initial", tgt = "s1" }
  return rfsm.state(model)
end

local together = {}
for i = 1, regions do together["r" .. i] = ring(i) end

local model = rfsm.state {
  info = false, warn = false, all = rfsm.seqand(together),
  rfsm.trans { src = "initial", tgt = "all" },
}

-- The most memory that the process has had, where Linux tells.
local function peak()
  local file = io.open("/proc/self/status")
  local kib = file and file:read("*a"):match("VmHWM:%s*(%d+)")
  if file then file:close() end
  return kib and ("%.0f MB at the peak"):format(kib * 1024 / 1e6) or "peak not known"
end

local began = os.clock()
local result = rfsm_checks.explore(model, { multiply = true, configurations = 1e8,
  run = guard and { guard } })
print(("%s: %d configurations, %d steps, %.1f s of processor, %s"):format(
  measure.engine(), result.configurations, result.steps, os.clock() - began, peak()))
