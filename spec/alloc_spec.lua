-- In steady state an event costs no garbage. With the JIT off and on: its traces would
-- count, and allocations that it sinks would not.

local measure = require "bench.measure"
local rfsm = require "rfsm"
local workloads = require "bench.workloads"

local jit = rawget(_G, "jit")

local function bytes_grown(subject)
  subject(25000) -- W7: each of its machines has been in each of its states
  return measure.bytes_grown(subject, 1000)
end

local function with_jit(mode, f)
  if not jit then return f() end
  jit[mode]()
  jit.flush()
  local result = f()
  jit.on()
  return result
end

-- On W4 where Lua can tell that the effects, without parameters, keep no events.
local FREE_OF_GARBAGE = {
  W1 = true, W1r = true, W2 = true, W3 = true, W5 = true, W7 = true,
  W4 = debug.getinfo(1, "u").nparams ~= nil,
}

describe("an event", function()
  for _, workload in ipairs(workloads) do
    if FREE_OF_GARBAGE[workload.name] then
      for _, mode in ipairs(jit and { "off", "on" } or { "on" }) do
        it(("costs no garbage on %s, JIT %s #alloc"):format(workload.name, mode),
          function()
            local grown = with_jit(mode, function()
              return bytes_grown((workload.make(rfsm)))
            end)
            assert.is_true(grown < 1000, grown .. " bytes in 1,000 events")
          end)
      end
    end
  end
end)
