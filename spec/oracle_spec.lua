-- Core and oracle agree on random charts: N of them, or the share of this Lua.

local charts = require "spec.support.charts"
local compiling = require "spec.support.compiling"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local runs = require "spec.support.runs"
local share = require "spec.support.share"
local shrink = require "spec.support.shrink"

local jit = rawget(_G, "jit")
local count = tonumber(os.getenv("N")) or share.count(900)
local seed = share.seed(count)

local function differs(chart) return runs.compare(chart) ~= nil end

-- Runs `f` with the core's `name` replaced by a wrong one.
local function with_broken(name, broken, f)
  local right = rfsm[name]
  rfsm[name] = function(...) return broken(right, ...) end
  local ok, problem = pcall(f)
  rfsm[name] = right
  if not ok then error(problem, 0) end
end

-- The first chart from `from` on that shows a difference.
local function find_difference(from)
  for s = from, from + 200 do
    local chart = charts.generate(s)
    if differs(chart) then return chart end
  end
end

local function keep_one_event(right, fsm, first) right(fsm, first) end

teardown(function() if jit then jit.on() end end)

describe("the oracle", function()
  it(("agrees with the core on %d charts from seed %d"):format(count, seed), function()
    for s = seed, seed + count - 1 do
      -- charts are too small for compiled code to pay, but some of it must run
      if s == seed + math.ceil(count / 3) and jit then jit.off() end
      local at, expected, actual = runs.compare(charts.generate(s))
      if at then
        error(("seed %d, line %d: oracle '%s', core '%s' (make fuzz N=1 SEED=%d "
          .. "shrinks it)"):format(s, at, tostring(expected[at]), tostring(actual[at]),
          s))
      end
    end
  end)

  -- In processes of their own: modules stay loaded.
  local CASES = {
    { name = "agrees while all extensions are loaded", count = 150,
      setting = "RFSM_FUZZ_WITH=all" },
    { name = "agrees where rfsm/fast.lua is missing", count = 150,
      setting = "RFSM_WITHOUT=rfsm.fast" },
    { name = "agrees where there is no debug", count = 150,
      setting = "RFSM_WITHOUT=debug" },
    { name = "agrees with a machine that leaves out one call where it is interrupted",
      count = 60, setting = "RFSM_INTERRUPTS=1" },
    { name = "agrees with one that is interrupted, without rfsm/fast.lua and debug",
      count = 60, setting = "RFSM_INTERRUPTS=1 RFSM_WITHOUT='rfsm.fast debug'" },
  }
  for _, case in ipairs(CASES) do
    local own = share.count(case.count)
    it(("%s, %d charts"):format(case.name, own), function()
      assert.equal(own .. " passed, 0 failed", table.concat(helper.lines_of(
        ("%s %s spec/support/fuzz.lua %d %d 2>&1"):format(case.setting,
        helper.interpreter(), own, share.seed(own))), "\n"))
    end)
  end

  it("agrees with a core on a Lua without compiler", function()
    compiling.with(nil, function()
      local compare = dofile("spec/support/runs.lua").compare
      local own = share.count(200)
      for s = share.seed(own), share.seed(own) + own - 1 do
        assert.is_nil((compare(charts.generate(s))))
      end
    end)
  end)

  it("tells a core that drops an event", function()
    with_broken("send_events", keep_one_event, function()
      assert.is_table(find_difference(1))
    end)
  end)

  it("tells a core that resets at the wrong time", function()
    local function reset_between_steps(right, fsm)
      if rfsm.get_active_conf(fsm)[1] then right(fsm) end
    end
    with_broken("reset", reset_between_steps, function()
      assert.is_table(find_difference(1))
    end)
  end)
end)

describe("the shrinker", function()
  it("leaves little of a chart", function()
    with_broken("send_events", keep_one_event, function()
      local chart = find_difference(1)
      local small = shrink.smallest(chart, differs)
      assert.is_true(differs(small))
      assert.is_true(#small.ops <= 3)
      assert.is_true(#shrink.to_lua(small) < #shrink.to_lua(chart))
    end)
  end)

  it("writes Lua", function()
    local load_text = loadstring or load -- luacheck: ignore 113
    for s = 1, 50 do
      assert.is_function(load_text(shrink.to_lua(charts.generate(s))))
    end
  end)
end)

-- What a chart's trace or data must show in some of the charts.
local FEATURES = {
  ["entry after first"] = "^entry root%.", exit = "^exit ", effect = "^effect ",
  guard = "^guard ", doo = "^doo ", ["busy doo"] = "^doo .* [2-9]$",
  ["new doo"] = "^dbg DOO created", ["done doo"] = "^dbg DOO removing",
  ["failing entry"] = "^err ENTRY", ["failing exit"] = "^err EXIT",
  ["failing effect"] = "^err EFFECT", ["failing guard"] = "^err GUARD",
  ["failing doo"] = "^err DOO", conflict = "^warn conflicting",
  ["no way in"] = "^err ERROR: cannot enter", getevents = "^getevents",
  ["pre hook"] = "^pre_hook", ["post hook"] = "^post_hook", hibernating = "HIBERNATING",
  ["idle hook"] = "^idle_hook", ["error to the caller"] = "^= step raised",
  run = "^= run", reset = "^= reset", ["idle step"] = "^= step ok true",
  ["depth 5"] = "^active .*%.%l%.%l%.%l%.%l%.%l", ["an object"] = "OBJECT",
  ["a liar"] = "OTHER_LIAR", retargeting = "^retarget", merging = "^= merge ok",
  ["a new entry"] = "^entry .* [1-9]$", ["a new guard"] = "^guard .* [1-9]$",
  ["path of connectors"] = "^dbg EXEC_PATH .*%->.*%->.*%->",
}

describe("the generator", function()
  it("gives the same chart for the same seed", function()
    assert.equal(shrink.to_lua(charts.generate(42)), shrink.to_lua(charts.generate(42)))
    assert.not_equal(shrink.to_lua(charts.generate(42)),
      shrink.to_lua(charts.generate(43)))
  end)

  it("gives the same chart on every Lua", function()
    local chart = charts.generate(3)
    assert.equal("root root.a root.b root.c root.c.a root.d root.d.a root.d.b "
      .. "root.initial root.c.initial root.d.initial", table.concat(chart.names, " "))
    assert.equal(7, #chart.transitions)
  end)

  it("covers what the contract speaks of", function()
    local missing = {}
    for feature in pairs(FEATURES) do missing[feature] = true end -- a set
    for s = 1, 1500 do
      if next(missing) == nil then break end
      for _, line in ipairs(runs.on_core(charts.generate(s)) or {}) do
        for feature in pairs(missing) do -- any order: a set
          if line:find(FEATURES[feature]) then missing[feature] = nil end
        end
      end
    end
    assert.same({}, missing)
  end)
end)
