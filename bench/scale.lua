-- How size shows:  LUA bench/scale.lua
--
-- 10^7 iterations in one call of run, with the memory they leave; then the time of init
-- per state, and of an event, in charts of 10 to 10,000 states.

package.path = "./?.lua;" .. package.path

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

local function per_state(size)
  local model = ring(size)
  collectgarbage()
  local start = os.clock()
  local fsm = rfsm.init(model)
  local init = (os.clock() - start) / size
  rfsm.run(fsm)
  local count = 200000
  start = os.clock()
  for i = 1, count do
    rfsm.send_events(fsm, i % 2 == 1 and "e_1" or "e_0")
    rfsm.step(fsm)
  end
  print(("%6d states: init %.2f us a state, %.3f us an event"):format(size, init * 1e6,
    (os.clock() - start) / count * 1e6))
end

many_iterations(1e7)
for _, size in ipairs({ 10, 100, 1000, 10000 }) do per_state(size) end
