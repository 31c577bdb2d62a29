-- The programs of bench/ run and print what they say they do. No figure is looked at.

local helper = require "spec.helper"

-- Runs a program of bench/; returns its output, errors and status too, line by line.
local function output_of(command, settings)
  return helper.lines_of(("%s %s bench/%s 2>&1; echo status $?"):format(settings or "",
    helper.interpreter(), command))
end

-- Each of `patterns` matches a line, in this order.
local function assert_lines(patterns, lines)
  local at = 1
  for _, line in ipairs(lines) do
    if patterns[at] and line:find(patterns[at]) then at = at + 1 end
  end
  assert.is_nil(patterns[at], table.concat(lines, "\n"))
end

local QUICK = "ROUNDS=1 SECONDS=0.001 MOST=100"

describe("bench/run.lua", function()
  it("has a row for a workload", function()
    assert_lines({ "^rfsm .*, 1 rounds$", "^workload ", "^W1 +[%d.]+ %%",
      "^status 0$" }, output_of("run.lua W1", QUICK))
  end)

  it("tells the memory of a machine in copies of its model", function()
    assert_lines({ "^workload ", "^W6 flat 20 .* [%d.]+ copies$", "^status 0$" },
      output_of("run.lua 'W6 flat 20'", QUICK))
  end)

  it("says which workloads there are", function()
    assert.same({ "bench/run.lua: nothing is named 'W0' here (there is 'W1', 'W1r', "
      .. "'W2', 'W3', 'W4', 'W5', 'W6 flat 20', 'W6 tree 20', 'W6 deep 20', "
      .. "'W6 flat 1000', 'W6 tree 1000', 'W6 deep 1000', 'W6 flat 10000', "
      .. "'W6 tree 10000', 'W6 deep 10000', 'W6 flat 20 first', 'W6 tree 20 first', "
      .. "'W6 deep 20 first', 'W6 flat 1000 first', 'W6 tree 1000 first', "
      .. "'W6 deep 1000 first', 'W7')", "status 1" },
      output_of("run.lua W0"))
  end)

  it("says what a setting must be", function()
    assert.same({ "bench/run.lua: ROUNDS: whole number expected, got '1.5'",
      "status 1" }, output_of("run.lua W1", "ROUNDS=1.5"))
    assert.same({ "bench/run.lua: SECONDS: number greater than 0 expected, got 'x'",
      "status 1" }, output_of("run.lua W1", "SECONDS=x"))
  end)
end)

describe("bench/latency.lua", function()
  it("has the core, the limit and the clock", function()
    local figures = " +%d+ +%d+ +%d+ +%d+$"
    assert_lines({ "W2: 2000 events, nanoseconds each, clock: %w",
      "p50 .*p99%.9 .*max$", "^core" .. figures, "^limit" .. figures,
      "^the clock itself" .. figures, "^status 0$" },
      output_of("latency.lua", "STEPS=2000"))
  end)
end)

describe("bench/growth.lua", function()
  it("has a table for each kind of growth", function()
    assert_lines({ "best of 1 rounds$", "^states elsewhere", "^ +100 +[%d.]+ +[%d.]+$",
      "^transitions elsewhere", "^ +100 ", "^transitions of active states", "^ +100 ",
      "^timers that run", "^ +100 ", "^levels left and entered",
      "^ +64 +[%d.]+ +[%d.]+ +[%d.]+ +%-?[%d.]+$", "^status 0$" },
      output_of("growth.lua", QUICK))
  end)
end)

describe("bench/scale.lua", function()
  it("has many iterations, and init by size", function()
    assert_lines({ "^run: 1000 iterations", "^    10 states: init",
      "^ 10000 states: init", "^status 0$" }, output_of("scale.lua", "ITERATIONS=1000"))
  end)
end)

describe("bench/extensions.lua", function()
  it("has a row for each extension", function()
    local patterns = { "^the core alone +[%d.]+  100%.0 %%$" }
    for name in ([[rfsm_timeevent rfsm_seqand rfsm.monitor rfsm.await rfsm.preview
      rfsm_checks rfsm.proto rfsm.rtt rfsmpp rfsm.marsh rfsm.json rfsm.plantuml rfsm.dot
      rfsm.mermaid rfsm.emem rfsm.checkevents]]):gmatch("%S+") do
      patterns[#patterns + 1] = "^%+ " .. name .. " +[%d.]+ +[%d.]+ %%$"
      if name == "rfsm.emem" or name == "rfsm.checkevents" then
        patterns[#patterns + 1] = "^%+ " .. name .. " off +[%d.]+ +[%d.]+ %%$"
      end
    end
    for _ = 1, 7 do -- in use
      patterns[#patterns + 1] = "^%+ rfsm[%w_.]*: [%a ]+ +[%d.]+ +[%d.]+ %%$"
    end
    patterns[#patterns + 1] = "^status 0$"
    assert_lines(patterns, output_of("extensions.lua", QUICK))
  end)

  it("measures those that are named", function()
    assert_lines({ "^the core alone ", "^%+ rfsm.emem off ", "^status 0$" },
      output_of("extensions.lua 'rfsm.emem off'", QUICK))
  end)
end)

describe("bench/rtt.lua", function()
  it("wants RTT", function()
    assert.same({ "bench/rtt.lua: RTT expected: rttlua bench/rtt.lua", "status 1" },
      output_of("rtt.lua"))
  end)
end)
