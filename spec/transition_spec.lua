local helper = require "spec.helper"
local rfsm = require "rfsm"

local state, trans = rfsm.state, rfsm.trans

-- The trace of one event in a machine that has been run before; the machine.
local function trace_of(model, ...)
  local trace, fsm = helper.traced(model)
  rfsm.run(fsm)
  helper.clear(trace)
  helper.post_and_run(fsm, ...)
  return trace, fsm
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
  local ENTER_A = "effect a.initial->a.x, entry a.x"
  -- What it does; its ends; the trace.
  for _, case in ipairs {
    { "leaves the deepest first and enters the outermost first", ".a.x", ".b.y",
      "exit a.x, exit a, effect a.x->b.y, entry b, entry b.y" },
    { "to a composite goes through its initial, segment by segment", "a", "b",
      "exit a.x, exit a, effect a->b.initial, entry b, effect b.initial->b.y, "
        .. "entry b.y" },
    { "from a composite to itself leaves it and enters it again", "a", "a",
      "exit a.x, exit a, effect a->a.initial, entry a, " .. ENTER_A },
    { "from a composite into itself leaves it, too", "a", ".a.x",
      "exit a.x, exit a, effect a->a.x, entry a, entry a.x" },
    { "from a leaf to itself leaves it and enters it again", ".a.x", ".a.x",
      "exit a.x, effect a.x->a.x, entry a.x" },
    { "to an ancestor does not leave it", ".a.x", "a",
      "exit a.x, effect a.x->a.initial, " .. ENTER_A },
    { "to the 'initial' of a composite does not leave that", ".a.x", ".a.initial",
      "exit a.x, effect a.x->a.initial, " .. ENTER_A },
    { "from the root leaves the root active", "root", ".b.y",
      "exit a.x, exit a, effect root->b.y, entry b, entry b.y" },
  } do
    it(case[1], function()
      local trace = trace_of(two_branches(case[2], case[3]), "e")
      assert.equal(case[4], (table.concat(trace, ", "):gsub("root%.", "")))
    end)
  end

  it("of an outer state wins whatever the pn of an inner one", function()
    local model = two_branches("a", "b")
    model.a[2] = trans { src = "x", tgt = "initial", events = "e", pn = 100 }
    assert.equal("effect root.a->root.b.initial", trace_of(model, "e")[3])
  end)

  it("without events fires on its own e_done", function()
    local trace, fsm = helper.traced(helper.chart())
    rfsm.run(fsm)
    assert.same({
      "effect root.initial->root.a", "entry root.a", "exit root.a",
      "effect root.a->root.b", "entry root.b",
    }, trace)
  end)

  it("is not taken for events that nobody wants, which are dropped", function()
    local trace, fsm = trace_of(two_branches("a", "b"), "e_other", "e_more")
    assert.same({ {}, {} }, { trace, fsm._intq })
  end)

  it("is one for several events in a step, which its effect gets; they are dropped",
    function()
      local model, seen = two_branches("a", "b"), nil
      model[3] = trans { src = "b", tgt = "a", events = "e_back" }
      model[2].effect = function(_, _, what, events)
        seen = what .. " " .. table.concat(events, " ")
      end
      local _, fsm = trace_of(model, "e_back", "e")
      assert.equal("effect e_back e", seen)
      assert.equal("root.b.y", rfsm.get_actleaf_fqn(fsm))
    end)
end)

it("an entry sees no active leaf, its own state active, an exit its leaf still",
  function()
    local seen = {}
    local model = two_branches("a", "b")
    model.b.y.entry = function(fsm, y)
      seen.entry = { fsm._act_leaf, rfsm.get_sta_mode(y), rfsm.get_sta_mode(fsm.a) }
    end
    model.a.x.exit = function(fsm, x)
      seen.exit = { fsm._act_leaf == x, rfsm.get_sta_mode(x) }
    end
    trace_of(model, "e")
    assert.same({
      entry = { false, "active", "inactive" }, exit = { true, "inactive" },
    }, seen)
  end)

describe("a callback that raises", function()
  local TR = "T={ src='root.a.x', tgt='root.b.y', events='e' }"
  local REST = {
    "exit root.a.x", "exit root.a", "effect root.a.x->root.b.y",
    "entry root.b", "entry root.b.y",
  }

  -- Where it stands, its location in the report, its position in REST.
  for _, case in ipairs {
    { "exit", function(model) return model.a.x end, "root.a.x", 1 },
    { "effect", function(model) return model[2] end, TR, 3 },
    { "entry", function(model) return model.b end, "root.b", 4 },
    { "guard", function(model) return model[2] end, TR, 0 },
  } do
    it("as " .. case[1] .. " is reported, and the rest goes on", function()
      local kind, model, expected = case[1], two_branches(".a.x", ".b.y"), {}
      local said = helper.said(model, "err")
      case[2](model)[kind] = function() error("on purpose", 0) end
      local trace, fsm = trace_of(model, "e")
      assert.same({ ("%s error executing %s of %s:  on purpose"):format(kind:upper(),
        kind, case[3]) }, said)
      for i, text in ipairs(kind == "guard" and {} or REST) do
        if i ~= case[4] then expected[#expected + 1] = text end
      end
      assert.same(expected, trace)
      assert.equal(kind == "guard" and "root.a.x" or "root.b.y",
        rfsm.get_actleaf_fqn(fsm))
    end)
  end
end)

it("leaves a state whose data have the names of a path's fields", function()
  local model = two_branches("a.x", "b.y")
  for _, name in ipairs { "from", "entered", "segment", "segments", "before", "actions",
    "args", "run", "used" } do
    model.a.x[name] = name
  end
  local _, fsm = trace_of(model, "e")
  assert.equal("root.b.y", rfsm.get_actleaf_fqn(fsm))
end)
