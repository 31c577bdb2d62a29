-- How size shows:  LUA bench/scale.lua
--
-- 10^7 iterations in one call of run, with the memory they leave; then the time of init
-- per state in charts of 10 to 10,000 states. What an event costs there: growth.lua.

package.path = "./?.lua;" .. package.path

local measure = require "bench.measure"
local rfsm = require "rfsm"

local function silent(model)
  model.info, model.warn = false, false
  return rfsm.state(model)
end

local function many_iterations(count)
  local left = count
  local function busy()
    while left > 0 do
      left = left - 1
      rfsm.yield()
    end
  end
  local fsm = rfsm.init(silent {
    a = rfsm.state { doo = busy }, rfsm.trans { src = "initial", tgt = "a" },
  })
  rfsm.step(fsm, 2)
  collectgarbage()
  local before, start = collectgarbage("count"), os.clock()
  rfsm.run(fsm)
  local seconds = os.clock() - start
  collectgarbage()
  print(("run: %d iterations, %.2f s, %+.1f KiB"):format(count, seconds,
    collectgarbage("count") - before))
end

-- A ring of leaves in one composite.
local function ring(size)
  local model = {}
  for i = 1, size do
    model["s" .. i] = rfsm.state {}
    model[i] = rfsm.trans {
      src = "s" .. i, tgt = "s" .. i % size + 1, events = { "e_" .. i % 2 },
    }
  end
  model[size + 1] = rfsm.trans { src = "initial", tgt = "s1" }
  return silent(model)
end

local function time_init(size)
  local model = ring(size)
  collectgarbage()
  local seconds = measure.time(rfsm.init, model)
  print(("%6d states: init %.2f us a state"):format(size, seconds / size * 1e6))
end

print(measure.engine())
many_iterations(measure.count("ITERATIONS", 10000000))
for _, size in ipairs({ 10, 100, 1000, 10000 }) do time_init(size) end
