-- Findings that are to the point: what is meant as an end, what a stub or the host of a
-- chart decides, and what a callback that is called really does.

local ab = require "spec.support.ab"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local review = require "rfsm.cli.review"
local chart = require "rfsm.shared.chart"

local state, go, concat = rfsm.state, ab.go, table.concat

after_each(helper.remove_files)

-- What rfsm check says of the text of a chart, with stubs, without file and remedies.
local function said(text, options)
  local file = helper.file_with(text)
  local required, model, warnings
  helper.printed(function()
    required, model, warnings = review.noting_extensions(chart.load, file, true)
  end)
  assert(model, warnings)
  options = options or {}
  options.required = required
  local lines = {}
  for _, line in ipairs(review.of(file, model, {}, {}, options)) do
    local kind, at, code = line:match("^%S+: (%l+): (%S+) .*%[(%S+)%]$")
    at = at and at:match("^(.-):?$")
    if kind then lines[#lines + 1] = concat({ kind, at, code }, " ") end
  end
  return lines
end

local CHART = [[
%s return rfsm.state { info = false, a = rfsm.state { %s }, b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { %s } },
  rfsm.trans { src = "b", tgt = "a", events = { "e_x" } }, %s
}
]]

describe("a leaf that nothing leaves", function()
  for name, severity in pairs { -- any order: each stands alone
    SUB_EXIT = "note", stopped = "note", failure = "note", ["all done"] = "note",
    refilling = "warning", stopping = "warning", exited_gate = "warning",
  } do
    it(("named '%s' is a %s"):format(name, severity), function()
      local model = ab.chart { [name] = state {}, [4] = go("a", name, "e_c") }
      for _, findings in ipairs { rfsm_checks.findings(model),
        rfsm_checks.explore(model).findings } do
        local finding = findings[1]
        assert.same({ "dead-end", severity }, { finding.code, finding.severity })
      end
    end)
  end
end)

describe("rfsm check", function()
  it("warns of an extension that a chart with requires forgot; else its host has it",
    function()
    local text = "e_after(1)"
    assert.same({ "warning root.trans[2] unknown-word" }, said(CHART:format(
      "local rfsm = require 'rfsm'", "", "'" .. text .. "'", "")))
    assert.same({}, said(CHART:format("-- require 'nothing'\n", "", "'" .. text .. "'",
      "")))
  end)

  it("notes each undefined global once, and none if a stub is in place of a module",
    function()
    local entry = "entry = function() drive() drive() stop() end"
    assert.same({ "note root.a undefined", "note root.a undefined" },
      said(CHART:format("", entry, "'e_x'", ""), { all = true, static = true }))
    assert.same({}, said(CHART:format("require 'robot'", entry, "'e_x'", ""),
      { all = true, static = true }))
    assert.same({ "warning root.a undefined" }, said(CHART:format("require 'robot'",
      "entry = function() pritn() end", "'e_x'", ""), { static = true }))
  end)

  it("warns of an empty list of events, but not behind a connector", function()
    local text = CHART:format("", "", "", "")
    assert.same({ "warning root.trans[2].events empty-events" },
      said(text, { static = true }))
    assert.same({}, said(CHART:format("", "", "'e_x'", [[k = rfsm.conn {},
      rfsm.trans { src = "b", tgt = "k", events = { "e_k" } },
      rfsm.trans { src = "k", tgt = "a", events = {} }, ]]), { static = true }))
  end)

  it("says nothing of the inside of a state that replaces a stub", function()
    assert.same({}, said(CHART:format("", "", "'e_x'", [[arm = rfsm.load "arm.lua",
      rfsm.trans { src = "b", tgt = "arm", events = { "e_arm" } },
      rfsm.trans { src = "arm.failed", tgt = "b", events = { "e_b" } },
      rfsm.trans { src = "arm.lifted", tgt = "b", events = { "e_c" } }, ]])))
    assert.same({ "warning root.arm unreachable" }, said(CHART:format("", "", "'e_x'",
      [[arm = rfsm.load "arm.lua",
      rfsm.trans { src = "arm.failed", tgt = "b", events = { "e_b" } }, ]])))
  end)
end)

describe("a callback that an exploration calls", function()
  -- b counts its visits in a field whose name is computed; options to follow it.
  local function explored(visit)
    local model = ab.chart { n1 = 0, c = state {}, [2] = go("a", "b", "e_x", {
      effect = visit }), [4] = go("c", "a", "e_x") }
    return rfsm_checks.explore(model, { vars = { n1 = { 0, 1 } }, run = { visit },
      properties = { rfsm_checks.never "root.c" } })
  end

  it("may compute the key of a field", function()
    local result = explored(function(fsm) fsm["n" .. 1] = 1 end)
    assert.same({}, result.untried)
    assert.is_true(result.properties[1].holds)
  end)

  it("is told if it changes the target of a transition, however it says so", function()
    for _, visit in ipairs {
      function(fsm) fsm[3].tgt = fsm.c end,
      function(fsm) fsm[3]["t" .. "gt"] = fsm.c end,
      function(fsm) rawset(fsm[3], "tgt", fsm.c) end,
    } do
      local result = explored(visit)
      assert.same({ "the target of root.trans[3], which vars does not name" },
        result.untried)
      assert.is_nil(result.properties[1].holds)
    end
  end)
end)
