-- Compares core and oracle on random charts:  LUA spec/support/fuzz.lua N SEED
--
-- RFSM_FUZZ_WITH="rfsm_timeevent rfsm_seqand" loads these modules first, "all" every
-- one there is: they must not change a thing for charts that do not use them, but for
-- the warnings of rfsm.checkevents, which are left out. RFSM_WITHOUT="rfsm.fast"
-- names optional modules that are to be missing, or the library debug. A difference
-- prints the seed, both traces around it, and the chart shrunk to what is needed.
--
-- RFSM_INTERRUPTS=1 interrupts the core instead: see runs.interrupt and
-- runs.interrupt_once.

package.path = "./?.lua;" .. package.path

local function hide(name)
  package.preload[name] = function() error("module '" .. name .. "' not found", 0) end
  if name == "debug" then rawset(_G, name, nil) end
end

require "spec.support.interrupts" -- needs what may be hidden

for name in (os.getenv("RFSM_WITHOUT") or ""):gmatch("[%w_.]+") do hide(name) end

local function names_of_all()
  package.loaded.rtt = require "spec.support.rtt"
  local pipe = assert(io.popen("ls rfsm?*.lua rfsm/*.lua"))
  local names = pipe:read("*a"):gsub("%.lua", ""):gsub("/", ".")
  pipe:close()
  return names
end

local function load_modules(names)
  if names == "all" then names = names_of_all() end
  if names ~= "" then require "rfsm" end -- which finds the older names
  for name in names:gmatch("[%w_.]+") do require(name) end
end

load_modules(os.getenv("RFSM_FUZZ_WITH") or "")

local charts = require "spec.support.charts"
local runs = require "spec.support.runs"
local shrink = require "spec.support.shrink"

local count = tonumber(arg[1]) or 2000
local first = tonumber(arg[2]) or 1

local function differs(chart) return runs.compare(chart) ~= nil end

local function print_around(title, trace, at)
  print(title)
  for i = math.max(at == 0 and 0 or 1, at - 5), math.min(#trace, at + 1) do
    print((i == at and "> " or "  ") .. trace[i])
  end
end

-- Shrinking must not end at another fault: a chart that init refuses.
local function tell(seed, chart)
  local is_refused = runs.compare(chart) == 0
  local small = shrink.smallest(chart, function(candidate)
    local at = runs.compare(candidate)
    return at and (at == 0) == is_refused
  end)
  local at, expected, actual = runs.compare(small)
  print(("seed %d: core and oracle differ"):format(seed))
  print_around("oracle:", expected, at)
  print_around("core:", actual, at)
  print("the chart, shrunk:")
  print(shrink.to_lua(small))
end

local has_interrupts = os.getenv("RFSM_INTERRUPTS")
local jit = rawget(_G, "jit") or { off = function() end }
if has_interrupts then
  jit.off() -- compiled code calls no hook
  for seed = 1, 3 do runs.compare(charts.generate(seed)) end -- loads what is optional
end

-- Runs a chart; has it passed?
local function pass(seed)
  local chart = charts.generate(seed)
  if not has_interrupts then
    local is_wrong = differs(chart)
    if is_wrong then tell(seed, chart) end
    return not is_wrong
  end
  local wrong = runs.interrupt(chart) or runs.interrupt_once(chart)
  if wrong then print(("seed %d: %s"):format(seed, wrong)) end
  return not wrong
end

for i = 0, count - 1 do
  if not pass(first + i) then
    print(("%d passed, 1 failed"):format(i))
    os.exit(1)
  end
  if (i + 1) % 10000 == 0 then print(("%d ..."):format(i + 1)) end
end
print(("%d passed, 0 failed"):format(count))
