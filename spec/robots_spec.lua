-- Charts in the style of real ones: what the checks warn of, and specs made from them.

local chart = require "rfsm.shared.chart"
local codes = require "rfsm.checks.codes"
local helper = require "spec.helper"
local review = require "rfsm.cli.review"
local rfsm = require "rfsm"
local share = require "spec.support.share"
local tests = require "rfsm.tests.tests"
local rehearsal = require("rfsm_checks").rehearsal
require "rfsm_timeevent"
require "rfsm.await"

local FOLDER = "spec/support/robots/"

-- The codes of the warnings that are useful. Comments in the charts say why.
local MISTAKES = {
  docking = { "any-event" }, inspection = { "unreachable" }, mapping = { "undefined" },
  milking = { "no-yield" }, sorter = { "shadowed", "unreachable" },
  waiter = { "dead-end" }, welding = { "typo" },
}

-- Loads a chart with stubs, as rfsm check does.
local function load(file)
  local required, model, warnings
  helper.printed(function()
    required, model, warnings = review.noting_extensions(chart.load, file, true)
  end)
  assert(model, warnings)
  return model, warnings, required
end

local names = {}
for _, file in ipairs(helper.lines_of("ls " .. FOLDER .. "*.lua")) do
  names[#names + 1] = file:match("([^/]+)%.lua$")
end

-- Returns the lines that rfsm check prints about a chart.
local function reviewed(file)
  local model, warnings, required = load(file)
  local lines
  helper.printed(function()
    lines = review.of(file, model, warnings, {}, { required = required })
  end)
  return lines
end

describe("the warnings about thirty robots", function()
  local count, useful = {}, {} -- by code

  for _, name in ipairs(names) do
    it("are its mistakes: " .. name, function()
      local found = {}
      for _, line in ipairs(reviewed(FOLDER .. name .. ".lua")) do
        local code = line:match(": warning: .*%[([%l-]+)%]$")
          or line:match(": warning:")
        if code then
          found[#found + 1], count[code] = code, (count[code] or 0) + 1
          assert.is_nil(line:find("rfsm/shared", 1, true))
        end
      end
      for _, code in ipairs(MISTAKES[name] or {}) do
        useful[code] = (useful[code] or 0) + 1
      end
      assert.same(MISTAKES[name] or {}, found)
    end)
  end

  it("are useful in four of five cases of each code", function()
    for code, n in pairs(count) do -- any order: each stands alone
      assert.equal("warning", codes.of[code].severity == "note" and "warning"
        or codes.of[code].severity)
      assert.is_true((useful[code] or 0) >= 0.8 * n, code)
    end
  end)
end)

-- Do the runs of a chart have the same results on another model?
local function passes(result, model)
  for _, run in ipairs(result.runs) do
    local ok, own = pcall(rehearsal, model)
    if not ok then return false end
    for _, step in ipairs(run.steps) do
      local is_same, text = pcall(own.step, own, step.what)
      if not is_same or text ~= step.result then return false end
    end
  end
  return true
end

-- Lists the transitions of a model as { state, key }.
local function transitions_of(model)
  return rfsm.mapfsm(function(_, state, key) return { state, key } end, model,
    rfsm.is_trans)
end

-- Appends the transitions of a chart whose loss its tests do not notice.
local function survivors(file, result)
  local list = {}
  for i in ipairs(transitions_of((load(file)))) do
    local model = load(file)
    local at = transitions_of(model)[i]
    at[1][at[2]] = nil
    model.info, model.warn, model.err = false, false, false
    if passes(result, model) then list[#list + 1] = i end
  end
  return list
end

describe("the spec that is made of a robot", function()
  for i, name in ipairs(names) do
    if share.has(i) then
      it("passes, and fails without a transition that can be taken: " .. name,
        function()
        local file = FOLDER .. name .. ".lua"
        local result
        helper.printed(function()
          result = tests.plan(load(file), { stub = true, file = file })
        end)
        assert.equal(0, result.skipped)
        assert.is_true(passes(result, load(file)))
        local list = survivors(file, result)
        assert.equal(result.transitions - result.taken, #list, table.concat(list, " "))
      end)
    end
  end
end)

-- Last, since the examples share their globals with what is loaded later.
describe("the warnings about examples", function()
  it("are none", function()
    for _, file in ipairs(helper.lines_of("ls examples/*.lua examples/press/press.lua "
      .. "examples/warehouse/order.lua examples/warehouse/next/order.lua")) do
      for _, line in ipairs(reviewed(file)) do
        assert.is_nil(line:find(": warning:", 1, true), line)
      end
    end
  end)
end)
