-- The engine agrees with the oracle: plain, interrupted, and with every extension.

local helper = require "spec.helper"

local MODES = { "", "RFSM_INTERRUPTS=1", "RFSM_FUZZ_WITH=all" }

local function run_mode(mode, n, seed)
  local text = helper.text_of(("%s '%s' spec/support/fuzz.lua %d %d 2>&1"):format(mode,
    arg[-1], n, seed))
  local passed = tonumber(text:match("(%d+) passed, %d failed\n$")) or 0
  return passed, passed < n and (mode .. "\n" .. text) or nil
end

local function run(n, seed)
  local cases = 0
  for _, mode in ipairs(MODES) do
    local passed, problem = run_mode(mode, n, seed)
    cases = cases + passed
    if problem then return cases, problem end
  end
  return cases
end

return { name = "engine", run = run }
