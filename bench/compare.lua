-- Two cores side by side:  LUA bench/compare.lua OLD.lua NEW.lua [WORKLOAD ...]
--
-- Each workload of bench/workloads.lua runs on both in turn (A B A B ...). Printed are
-- the new one's rate and how many times the old one's it is: median of the rounds,
-- lowest and highest. On LuaJIT each pair of figures moves from process to
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
  local subject, before = (workload.make(new)), (workload.make(old))
  local shares, rates = measure.shares(subject, before, ROUNDS, SECONDS)
  local middle = math.ceil(ROUNDS / 2)
  print(("%-19s %12.0f a second   %5.2f (%.2f .. %.2f)"):format(workload.name,
    rates[middle], shares[middle], shares[1], shares[ROUNDS]))
  io.stdout:flush()
end
