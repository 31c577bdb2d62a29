-- Preview: likely transitions have their targets prepared.

local helper = require "spec.helper"
local rfsm = require "rfsm"
require "rfsm.preview"

local state, trans = rfsm.state, rfsm.trans

-- (initial) -> c[ (initial) -> a ] --e_b--> b, --e_d--> d[ (initial) -> x ]
local function chart(trace)
  local function noting(name)
    return function(fsm) trace[#trace + 1] = name .. " " .. fsm._fqn end
  end
  return state {
    warn = false, info = false,
    c = state { a = state {}, trans { src = "initial", tgt = "a" } },
    b = state { prepare = noting("b") },
    d = state {
      prepare = noting("d"), x = state {}, trans { src = "initial", tgt = "x" },
    },
    trans { src = "initial", tgt = "c" },
    trans { src = "c", tgt = "b", events = { "e_b" } },
    trans { src = ".c.a", tgt = "d", events = { "e_d" } },
  }
end

local function yes() return true end

describe("a transition that is likely", function()
  it("has its target prepared after each iteration", function()
    local trace = {}
    local model = chart(trace)
    model[2].likely = yes
    local fsm = helper.init(model)
    rfsm.step(fsm) -- enters; the next call drops e_done, then finds nothing to do
    rfsm.step(fsm)
    assert.same({ "b root", "b root", "b root" }, trace)
  end)

  it("has its target prepared when that is a composite", function()
    local trace = {}
    local model = chart(trace)
    model[3].likely = yes
    rfsm.step(helper.init(model))
    assert.same({ "d root" }, trace)
  end)

  it("is asked from the outside in", function()
    local trace = {}
    local model = chart(trace)
    model[2].likely, model[3].likely = yes, yes
    rfsm.step(helper.init(model))
    assert.same({ "b root", "d root" }, trace)
  end)

  it("is asked with the machine", function()
    local model, seen = chart {}, nil
    model[2].likely = function(...) seen = { ... } end
    local fsm = helper.init(model)
    rfsm.step(fsm)
    assert.equal(fsm, seen[1])
  end)

  it("is not prepared when it says no", function()
    local trace = {}
    local model = chart(trace)
    model[2].likely = function() return false end
    rfsm.step(helper.init(model))
    assert.same({}, trace)
  end)

  it("is not asked when its source is inactive", function()
    local trace = {}
    local model = chart(trace)
    model[3].likely = yes
    local fsm = helper.init(model)
    rfsm.run(fsm)
    helper.clear(trace)
    helper.post_and_run(fsm, "e_b")
    assert.same({}, trace)
  end)

  it("is not asked when its source is the root", function()
    local trace = {}
    local model = chart(trace)
    model[4] = trans { src = "root", tgt = "b", events = { "e_r" }, likely = yes }
    rfsm.step(helper.init(model))
    assert.same({}, trace)
  end)

  it("needs no prepare in its target", function()
    local model = chart {}
    model[2].likely, model.b.prepare = yes, nil
    assert.has_no_error(function() rfsm.step(helper.init(model)) end)
  end)

  it("may be merged into a live machine", function()
    local trace = {}
    local fsm = helper.init(chart(trace))
    rfsm.run(fsm)
    rfsm.fsm_merge(fsm, fsm, trans { src = "c", tgt = "b", events = { "e_z" },
      likely = yes })
    rfsm.step(fsm)
    assert.same({ "b root" }, trace)
  end)

  it("whose likely fails goes to err, and others are asked", function()
    local trace, errors = {}, {}
    local model = chart(trace)
    model[2].likely, model[3].likely = function() error("no idea", 0) end, yes
    model.err = function(...) errors[#errors + 1] = table.concat({ ... }, "|") end
    rfsm.step(helper.init(model))
    assert.same({ "PREVIEW|error executing likely of T={ src='root.c', tgt='root.b', "
      .. "events='e_b' }: |no idea" }, errors)
    assert.same({ "d root" }, trace)
  end)

  it("whose prepare fails goes to err", function()
    local errors, model = {}, chart {}
    model[3].likely, model.d.prepare = yes, function() error("no disk", 0) end
    model.err = function(...) errors[#errors + 1] = table.concat({ ... }, "|") end
    rfsm.step(helper.init(model))
    assert.same({ "PREVIEW|error executing prepare of root.d: |no disk" }, errors)
  end)

  it("that is no function is a problem of the model", function()
    local model = chart {}
    model[2].likely, model.err = "often", false
    local _, _, problems = rfsm.init(model)
    assert.equal(1, #problems)
    assert.equal("root.trans[2].likely (c -> b): function expected, got string",
      helper.without_file(problems[1]))
  end)
end)

describe("a machine without likely transitions", function()
  it("has nothing of this extension", function()
    assert.is_nil(helper.init(chart {})._has_preview)
  end)
end)

it("a state named prepare is not called", function()
  local model = state { warn = false, info = false, b = state {},
    a = state { prepare = state {}, trans { src = "initial", tgt = "prepare" } },
    trans { src = "initial", tgt = "b" },
    trans { src = "b", tgt = "a", events = { "e" }, likely = yes } }
  local errors = helper.said(model, "err")
  assert.equal("root.a.prepare", helper.leaf_after(helper.started(model), "e"))
  assert.same({}, errors)
end)
