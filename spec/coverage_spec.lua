-- coverage: the states, transitions and guard outcomes that runs have seen.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"

local state, trans = rfsm.state, rfsm.trans

-- (initial) -> a --e_x [guard]--> b --e_y--> a
local function machine(guard)
  return helper.init(state {
    err = false, a = state {}, b = state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e_x" }, guard = guard },
    trans { src = "b", tgt = "a", events = { "e_y" } },
  })
end

describe("coverage", function()
  it("reports what a run has not seen", function()
    local fsm = machine(function() return false end)
    local seen = rfsm_checks.coverage(fsm)
    helper.post_and_run(fsm, "e_x")
    helper.post_and_run(fsm, "e_x")
    assert.equal(table.concat({
      "states 2 of 3, transitions 1 of 3, guard outcomes 1 of 2",
      "never: state root.b", "never: transition root.trans[2]",
      "never: transition root.trans[3]", "never: guard outcome root.trans[2] true",
    }, "\n"), tostring(seen))
    assert.same({ ["true"] = 0, ["false"] = 1, failed = 0 },
      seen.guards["root.trans[2]"])
  end)

  it("adds up over runs, also through JSON", function()
    local fsm = machine(function() return false end)
    local first = rfsm_checks.coverage(fsm)
    helper.post_and_run(fsm)
    helper.post_and_run(fsm, "e_x")
    local text = first:json()
    fsm = machine(function() return true end)
    local both = rfsm_checks.coverage(fsm, (require("dkjson").decode(text)))
    helper.post_and_run(fsm)
    helper.post_and_run(fsm, "e_x")
    helper.post_and_run(fsm, "e_y")
    assert.equal("states 3 of 3, transitions 3 of 3, guard outcomes 2 of 2",
      tostring(both))
    assert.equal(3, both.states["root.a"])
    assert.equal(1, first.states["root.a"])
  end)

  it("leaves callbacks what they are", function()
    local ran = {}
    local fsm = machine(function(tr, events)
      ran[#ran + 1] = tr.tgt._fqn .. " " .. events[1]
    end)
    fsm[2].effect = function(...) ran[#ran + 1] = select("#", ...) .. select(3, ...) end
    rfsm_checks.coverage(fsm)
    helper.post_and_run(fsm)
    helper.post_and_run(fsm, "e_x")
    assert.same({ "root.b e_x", "5effect" }, ran)
  end)

  it("counts a guard that fails", function()
    local fsm = machine(function() error("no") end)
    local seen = rfsm_checks.coverage(fsm)
    helper.post_and_run(fsm)
    helper.post_and_run(fsm, "e_x")
    assert.same({ ["true"] = 0, ["false"] = 0, failed = 1 },
      seen.guards["root.trans[2]"])
  end)

  it("counts in the machines of a sequential AND state", function()
    local region = state { warn = false, info = false, x = state {},
      trans { src = "initial", tgt = "x" } }
    local fsm = helper.init(state { par = rfsm.seqand { left = region },
      trans { src = "initial", tgt = "par" } })
    local seen = rfsm_checks.coverage(fsm)
    rfsm.run(fsm)
    assert.equal(1, seen.states["root.par.left.x"])
    assert.equal(1, seen.transitions["root.par.left.trans[1]"])
  end)

  it("blames the caller for what is no machine, and no record", function()
    local _, text = pcall(function() rfsm_checks.coverage(state {}) end)
    assert.matches("coverage_spec.lua:%d+: rfsm_checks.coverage: initialised fsm", text)
    _, text = pcall(function() rfsm_checks.coverage(machine(), {}) end)
    assert.matches("coverage_spec.lua:%d+: rfsm_checks.coverage: a record of an "
      .. "earlier run expected, got table", text)
  end)
end)
