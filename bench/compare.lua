-- Two cores side by side:  LUA bench/compare.lua OLD.lua NEW.lua [WORKLOAD ...]
--
-- Each workload of bench/workloads.lua runs on both in turn (A B A B ...). Printed are
-- the rates and the share of the old one's that the new one reaches: median of the
-- rounds, lowest and highest. On LuaJIT each pair of figures moves from process to
-- process: run it several times.

package.path = "./?.lua;" .. package.path

local measure = require "bench.measure"

local ROUNDS = measure.count("ROUNDS", 9)
local SECONDS = measure.setting("SECONDS", 0.1) -- per measurement

-- Loads a core from its file, apart from any other.
local function load_core(file)
  measure.forget_modules()
  return assert(loadfile(file))()
end

if not arg[2] then measure.fail("usage: LUA bench/compare.lua OLD NEW [NAME ...]") end
local old, new = load_core(arg[1]), load_core(arg[2])

local names = {}
for i = 3, #arg do names[#names + 1] = arg[i] end
local selected = measure.select(require "bench.workloads", names)

print(("%s, %d rounds: %s against %s"):format(measure.engine(), ROUNDS, arg[2], arg[1]))
for _, workload in ipairs(selected) do
  local subjects = { (workload.make(old)), (workload.make(new)) }
  local counts, rates, shares = {}, { {}, {} }, {}
  for i = 1, 2 do counts[i] = measure.calibrate(subjects[i], SECONDS) end
  for round = 1, ROUNDS do
    for i = 1, 2 do
      collectgarbage()
      rates[i][round] = counts[i] / measure.time(subjects[i], counts[i])
    end
    shares[round] = rates[2][round] / rates[1][round]
  end
  local middle = math.ceil(ROUNDS / 2)
  for _, list in ipairs({ rates[1], rates[2], shares }) do table.sort(list) end
  print(("%-19s %12.0f %12.0f a second   %5.2f (%.2f .. %.2f)"):format(workload.name,
    rates[1][middle], rates[2][middle], shares[middle], shares[1], shares[ROUNDS]))
  io.stdout:flush()
end
