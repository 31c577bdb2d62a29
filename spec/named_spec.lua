-- Events with data, explored by their names.

local chart_of = require("spec.support.ab").chart
local claim = require "spec.support.claims.named"
local go = require("spec.support.ab").go
local rfsm = require "rfsm"
local checks = require "rfsm_checks"
local rehearsal = require "rfsm.tests.rehearsal"
local record = require "rfsm.record"
local share = require "spec.support.share"
local tests = require "rfsm.tests.tests"
local verdict = require("spec.support.ab").verdict

local state, named = rfsm.state, rfsm.named

-- a -e_coin{..}-> b -e_cancel-> a, a -e_stop-> c
local function vending(members)
  local model = { c = state { final = true }, [2] = go("a", "b", named "e_coin"),
    [3] = go("b", "a", "e_cancel"), [4] = go("a", "c", "e_stop") }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a set
  return chart_of(model)
end

describe("an exploration of events with data", function()
  it("takes no transition on a text, and none without an event", function()
    assert.equal("p: does not hold [violated]\n"
      .. "  1. no event: root.trans[1] -> root.a\n  2. e_coin: root.trans[2] -> root.b",
      verdict(vending(), checks.never "root.b"))
  end)

  it("knows the event of a property by its name, given as text, table or predicate",
    function()
      for _, event in ipairs { "e_coin", { name = "e_coin", n = 1 },
        { named "e_coin" } } do
        local meant = type(event) == "table" and event[1] or event
        assert.equal("p: holds (two events a step)", verdict(vending { [4] = false,
          [3] = false, c = false, b = state { final = true } },
          checks.after(meant).reach "root.b"))
      end
    end)

  it("keeps a text and a name apart that are the same", function()
    local model = vending { [4] = go("a", "c", "e_coin") }
    assert.equal("p: does not hold [violated]\n"
      .. "  1. no event: root.trans[1] -> root.a\n  2. e_coin: root.trans[4] -> root.c",
      verdict(model, checks.never "root.c"))
    assert.same({ "e_coin" }, checks.explore(model, { properties =
      { checks.never "root.c" } }).findings[1].witness[2].values)
  end)

  it("takes names in the alphabet, and refuses others", function()
    local function never_c(...)
      return verdict(vending(), checks.never "root.c", { alphabet = { ... } })
    end
    assert.equal("p: holds (one event a step; no event outside of the alphabet)",
      never_c("e_coin", "e_cancel"))
    local ok, problem = pcall(never_c, { name = "e_coins" })
    assert.same({ false, "alphabet: no transition names the event 'e_coins' "
      .. "(did you mean 'e_coin'?)" },
      { ok, (problem:gsub("^.*explore: ", "")) })
  end)

  it("follows what a callback sends with data", function()
    local sends = { ["entry root.a"] = { { name = "e_coin", n = 1 } } }
    assert.equal("p: holds (one event a step; no event outside of the alphabet)",
      verdict(vending(), checks.after("e_coin").reach "root.b",
        { alphabet = {}, sends = sends, together = 1 }))
  end)

  it("has runs that a machine replays", function()
    local r = checks.explore(vending(), { properties = { checks.never "root.b" } })
    local recording = {}
    rehearsal.record_witness(vending(), r.findings[1].witness, recording)
    local again = assert(record.replay(vending(), recording, { dry = true }))
    assert.equal("root.b", rfsm.get_actleaf_fqn(again))
  end)

  it("writes tests that send tables with the name", function()
    local text = tests.busted("n.lua", vending())
    assert.is_truthy(text:find('run:step { { name = "e_coin" } }', 1, true))
  end)
end)

describe("charts in which half of the events are named with data", function()
  it("have the verdicts, witnesses, tests, pictures and runs of plain events",
    function() assert.is_nil(share.problem(claim, 60, true)) end)
end)
