-- Time and memory of an exploration:  LUA bench/explore.lua [REGIONS [LEAVES]]
--
-- The chart has so many machines side by side in a sequential AND state, each a ring of
-- so many leaves with events of its own. It has a configuration for each combination.

package.path = "./?.lua;" .. package.path

local rfsm = require "rfsm"
local explore = require "rfsm.checks.explore"

local regions, leaves = tonumber(arg[1]) or 5, tonumber(arg[2]) or 10

local function ring(name)
  local model = { info = false, warn = false }
  for i = 1, leaves do
    model["s" .. i] = rfsm.state {}
    model[i] = rfsm.trans { src = "s" .. i, tgt = "s" .. i % leaves + 1,
      events = { "e_" .. name .. "_" .. i % 2 } }
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

collectgarbage()
collectgarbage()
local kib, began = collectgarbage("count"), os.clock()
local walk = explore.walk(model, {})
local seconds = os.clock() - began
collectgarbage()
collectgarbage()
kib = collectgarbage("count") - kib
print(("%s: %d configurations, %d steps, %.1f s of processor, %.0f bytes each"):format(
  (rawget(_G, "jit") or {}).version or _VERSION, #walk.keys, walk.count, seconds,
  kib * 1024 / #walk.keys))
