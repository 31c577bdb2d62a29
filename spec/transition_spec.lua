local helper = require "spec.helper"
local rfsm = require "rfsm"

local state, trans = rfsm.state, rfsm.trans

-- The trace of one event in a machine that has been run before.
local function trace_of(model, event)
  local trace, fsm = helper.traced(model)
  rfsm.run(fsm)
  helper.clear(trace)
  helper.post_and_run(fsm, event)
  return trace
end

-- root: a{ x }  b{ y }, with one transition on "e".
local function two_branches(src, tgt)
  return state {
    a = state { x = state {}, trans { src = "initial", tgt = "x" } },
    b = state { y = state {}, trans { src = "initial", tgt = "y" } },
    trans { src = "initial", tgt = "a" },
    trans { src = src, tgt = tgt, events = "e" },
  }
end

describe("a transition", function()
  it("leaves the deepest first and enters the outermost first", function()
    assert.same({
      "exit root.a.x", "exit root.a", "effect root.a.x->root.b.y", "entry root.b",
      "entry root.b.y",
    }, trace_of(two_branches(".a.x", ".b.y"), "e"))
  end)

  it("to a composite goes through its initial, segment by segment", function()
    assert.same({
      "exit root.a.x", "exit root.a", "effect root.a->root.b.initial", "entry root.b",
      "effect root.b.initial->root.b.y", "entry root.b.y",
    }, trace_of(two_branches("a", "b"), "e"))
  end)

  it("from a composite to itself leaves it and enters it again", function()
    assert.same({
      "exit root.a.x", "exit root.a", "effect root.a->root.a.initial", "entry root.a",
      "effect root.a.initial->root.a.x", "entry root.a.x",
    }, trace_of(two_branches("a", "a"), "e"))
  end)

  it("from a composite into itself leaves it, too", function()
    assert.same({
      "exit root.a.x", "exit root.a", "effect root.a->root.a.x", "entry root.a",
      "entry root.a.x",
    }, trace_of(two_branches("a", ".a.x"), "e"))
  end)

  it("from a leaf to itself leaves it and enters it again", function()
    assert.same({ "exit root.a.x", "effect root.a.x->root.a.x", "entry root.a.x" },
      trace_of(two_branches(".a.x", ".a.x"), "e"))
  end)

  it("to an ancestor does not leave it", function()
    assert.same({
      "exit root.a.x", "effect root.a.x->root.a.initial",
      "effect root.a.initial->root.a.x", "entry root.a.x",
    }, trace_of(two_branches(".a.x", "a"), "e"))
  end)

  it("to 'initial' does not leave the composite", function()
    local model = state {
      a = state {
        x = state {}, trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "initial", events = "e" },
      },
      trans { src = "initial", tgt = "a" },
    }
    assert.same({
      "exit root.a.x", "effect root.a.x->root.a.initial",
      "effect root.a.initial->root.a.x", "entry root.a.x",
    }, trace_of(model, "e"))
  end)

  it("from the root leaves the root active", function()
    assert.same({
      "exit root.a.x", "exit root.a", "effect root->root.b.y", "entry root.b",
      "entry root.b.y",
    }, trace_of(two_branches("root", ".b.y"), "e"))
  end)

  it("of an outer state wins whatever the pn of an inner one", function()
    local model = two_branches("a", "b")
    model.a[2] = trans { src = "x", tgt = "x", events = "e", pn = 100 }
    assert.equal("effect root.a->root.b.initial", trace_of(model, "e")[3])
  end)

  it("without events fires on its own e_done", function()
    local trace, fsm = helper.traced(state {
      a = state {}, b = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b" },
    })
    rfsm.run(fsm)
    assert.same({
      "effect root.initial->root.a", "entry root.a", "exit root.a",
      "effect root.a->root.b", "entry root.b",
    }, trace)
  end)

  it("is not taken for events that nobody wants, which are dropped", function()
    local trace, fsm = helper.traced(two_branches("a", "b"))
    rfsm.run(fsm)
    helper.clear(trace)
    helper.post_and_run(fsm, "e_other", "e_more")
    assert.same({}, trace)
    assert.same({}, fsm._intq)
  end)

  it("takes one of several events in a step, the others are dropped", function()
    local model = two_branches("a", "b")
    model[3] = trans { src = "b", tgt = "a", events = "e_back" }
    local _, fsm = helper.traced(model)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_back", "e")
    assert.equal("root.b.y", rfsm.get_actleaf_fqn(fsm))
  end)

  it("gives its effect all events of the step", function()
    local seen
    local model = two_branches("a", "b")
    model[2].effect = function(_, _, what, events)
      seen = what .. " " .. table.concat(events, " ")
    end
    trace_of(model, "e")
    assert.equal("effect e", seen)
  end)
end)

describe("an entry", function()
  it("sees no active leaf, its own state active", function()
    local seen
    local model = two_branches("a", "b")
    model.b.y.entry = function(fsm, y)
      seen = { fsm._act_leaf, rfsm.get_sta_mode(y), rfsm.get_sta_mode(fsm.a) }
    end
    trace_of(model, "e")
    assert.same({ false, "active", "inactive" }, seen)
  end)
end)

describe("an exit", function()
  it("of a leaf still sees it as the active leaf, its own mode inactive", function()
    local seen
    local model = two_branches("a", "b")
    model.a.x.exit = function(fsm, x)
      seen = { fsm._act_leaf == x, rfsm.get_sta_mode(x) }
    end
    trace_of(model, "e")
    assert.same({ true, "inactive" }, seen)
  end)
end)

describe("a program that raises", function()
  local function failing() error("on purpose", 0) end

  -- Makes one program fail, and returns what err got and where the machine is.
  local function failing_at(edit)
    local said = {}
    local model = two_branches(".a.x", ".b.y")
    model.err = function(...) said[#said + 1] = table.concat({ ... }, " ") end
    edit(model)
    local trace, fsm = helper.traced(model)
    rfsm.run(fsm)
    helper.clear(trace)
    helper.post_and_run(fsm, "e")
    return said, trace, rfsm.get_actleaf_fqn(fsm)
  end

  it("as an exit is reported, and the rest goes on", function()
    local said, trace, leaf = failing_at(function(model) model.a.x.exit = failing end)
    assert.same({ "EXIT error executing exit of root.a.x:  on purpose" }, said)
    assert.same({
      "exit root.a", "effect root.a.x->root.b.y", "entry root.b", "entry root.b.y",
    }, trace)
    assert.equal("root.b.y", leaf)
  end)

  it("as an effect is reported, and the entries go on", function()
    local said, trace = failing_at(function(model) model[2].effect = failing end)
    assert.same({
      "EFFECT error executing effect of T={ src='root.a.x', tgt='root.b.y', "
        .. "events='e' }:  on purpose",
    }, said)
    assert.same({
      "exit root.a.x", "exit root.a", "entry root.b", "entry root.b.y",
    }, trace)
  end)

  it("as an entry is reported, and the inner entries go on", function()
    local said, trace, leaf = failing_at(function(model) model.b.entry = failing end)
    assert.same({ "ENTRY error executing entry of root.b:  on purpose" }, said)
    assert.same({
      "exit root.a.x", "exit root.a", "effect root.a.x->root.b.y", "entry root.b.y",
    }, trace)
    assert.equal("root.b.y", leaf)
  end)

  it("everywhere is reported everywhere, and the machine arrives", function()
    local said, trace, leaf = failing_at(function(model)
      model.a.x.exit, model.a.exit = failing, failing
      model.b.entry, model.b.y.entry = failing, failing
      model[2].effect = failing
    end)
    assert.equal(5, #said)
    assert.same({}, trace)
    assert.equal("root.b.y", leaf)
  end)

  it("as a guard is reported, and does not enable", function()
    local said, _, leaf = failing_at(function(model) model[2].guard = failing end)
    assert.same({
      "GUARD error executing guard of T={ src='root.a.x', tgt='root.b.y', "
        .. "events='e' }:  on purpose",
    }, said)
    assert.equal("root.a.x", leaf)
  end)
end)
