-- Every problem that `rfsm.init` reports, with its exact text.

local rfsm = require "rfsm"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn
local to_a = { src = "initial", tgt = "a" }

-- A chart  initial -> a  with more members; silent, so that only the result speaks.
local function chart(members)
  local model = { err = false, warn = false, info = false, a = state {}, trans(to_a) }
  for key, value in pairs(members) do model[key] = value end -- any order: a set
  return state(model)
end

local function problems_of(model)
  local fsm, problems = rfsm.init(model)
  assert.is_false(fsm)
  return problems
end

local function warnings_of(model)
  local said = {}
  model.warn = function(text) said[#said + 1] = text end
  assert.is_table((rfsm.init(model)))
  local warnings = {}
  for _, text in ipairs(said) do
    if not text:find("no outgoing transitions", 1, true) then
      warnings[#warnings + 1] = text
    end
  end
  return warnings
end

local function noop() end

describe("a reference", function()
  local function of(tr) return problems_of(chart { b = state {}, [2] = trans(tr) }) end

  it("is reported when src is missing", function()
    assert.same({
      "root.trans[2]: src is missing, the name of a state or connector expected",
    }, of { tgt = "a" })
  end)

  it("is reported when tgt is missing", function()
    assert.same({
      "root.trans[2]: tgt is missing, the name of a state or connector expected",
    }, of { src = "a" })
  end)

  it("is reported when it leads nowhere, with the nearest name", function()
    local model = chart { dim = state {}, [2] = trans { src = "a", tgt = "dimm" } }
    assert.same({
      "root.trans[2]: tgt 'dimm': no state or connector is named 'dimm' in 'root' "
        .. "(did you mean 'dim'?)",
    }, problems_of(model))
  end)

  it("names the part that fails", function()
    local inner = state { bx = state {}, by = state {} }
    local model = chart { m = inner, [2] = trans { src = "a", tgt = "root.m.bz.q" } }
    assert.same({
      "root.trans[2]: tgt 'root.m.bz.q': no state or connector is named 'bz' in "
        .. "'root.m' (did you mean 'bx'?)",
    }, problems_of(model))
  end)

  it("lists the names when they are few and none is near", function()
    assert.same({
      "root.trans[2]: tgt 'zzzzzz': no state or connector is named 'zzzzzz' in 'root' "
        .. "(there are 'a', 'b', 'initial')",
    }, of { src = "a", tgt = "zzzzzz" })
  end)

  it("is reported with the place of a node of that name elsewhere", function()
    local m = state { x = state {}, trans(to_a), trans { src = "x", tgt = "b" } }
    m[1] = trans { src = "initial", tgt = "x" }
    assert.same({
      "root.m.trans[2]: tgt 'b': no state or connector is named 'b' in 'root.m' "
        .. "(did you mean 'root.b'?)",
    }, problems_of(chart { b = state {}, m = m }))
  end)

  it("is reported when initial is misspelt", function()
    assert.same({
      "root.trans[2]: src 'intial': no state or connector is named 'intial' in 'root' "
        .. "(did you mean 'initial'?)",
    }, of { src = "intial", tgt = "a" })
  end)

  it("is reported when it stands under another name", function()
    assert.same({
      "root.trans[2]: src is missing, the name of a state or connector expected (there "
        .. "is 'from', did you mean 'src'?)",
      "root.trans[2]: tgt is missing, the name of a state or connector expected (there "
        .. "is 'to', did you mean 'tgt'?)",
    }, of { from = "a", to = "b" })
  end)

  it("is reported when it leads to something that is no node", function()
    assert.same({
      "root.trans[2]: tgt 'data': 'root.data' is no state or connector but a table"
        .. " (did you mean rfsm.state{...}?)",
    }, problems_of(chart { data = {}, [2] = trans { src = "a", tgt = "data" } }))
  end)

  it("is reported when it is no name at all", function()
    assert.same({
      "root.trans[2]: src: name of a state or connector expected, got number 5",
    }, of { src = 5, tgt = "a" })
  end)

  it("is reported when it is a table of another model", function()
    assert.same({ "root.trans[2]: src: the table given is no part of this model" },
      of { src = state {}, tgt = "a" })
  end)

  it("is reported when its table stands in two places at the same distance", function()
    local twin = state {}
    assert.same({
      "root.trans[2]: tgt: the table given stands in several places, use a name",
    }, problems_of(chart { b = twin, c = twin, [2] = trans { src = "a", tgt = twin } }))
  end)

  it("is reported when it is an internal transition", function()
    assert.same({
      "root.trans[2]: tgt 'internal': internal transitions are not supported",
    }, of { src = "a", tgt = "internal" })
  end)

  it("is reported when it ends on a composite without initial", function()
    local m = state { x = state {} }
    local model = chart { m = m, [2] = trans { src = "a", tgt = "m" } }
    assert.same({
      "root.trans[2]: tgt 'root.m': the composite has no initial transition "
        .. "(rfsm.trans{ src='initial', tgt=... })",
    }, problems_of(model))
  end)
end)

describe("an e_done", function()
  it("of a transition that leads nowhere is not looked at", function()
    local a = state {}
    assert.same({ false, { "root.trans[2]: tgt 'b': no state or connector is named 'b' "
      .. "in 'root' (there are 'a', 'initial')" }, {} }, { rfsm.verify_early(state {
        a = a, trans { src = "initial", tgt = "a" },
        trans { src = a, tgt = "b", events = { "e", "e_done" } },
      }) })
  end)
end)

describe("a node", function()
  it("called initial is a connector", function()
    assert.same({ "root.m.initial: connector expected, got state" },
      problems_of(chart { m = state { initial = state {} } }))
  end)

  it("has no dot in its name", function()
    assert.same({
      "root.x.y: the name of a state must not be empty, contain '.' or '\\' or start "
        .. "with '_'",
    }, problems_of(chart { ["x.y"] = state {} }))
  end)

  it("has no backslash in its name", function()
    assert.same({
      "root.x\\y: the name of a connector must not be empty, contain '.' or '\\' or "
        .. "start with '_'",
    }, problems_of(chart { ["x\\y"] = conn {} }))
  end)

  it("has no leading underscore in its name", function()
    assert.same({
      "root._x: the name of a state must not be empty, contain '.' or '\\' or start "
        .. "with '_'",
    }, problems_of(chart { _x = state {} }))
  end)

  it("needs a name", function()
    assert.same({ "root.trans[2]: a state needs a name (name = ...)" },
      problems_of(chart { [2] = state {} }))
  end)

  it("is not named like a field of every state", function()
    assert.same({
      "root.exit: a state cannot have this name, it is a field of every state",
    }, problems_of(chart { exit = state {} }))
  end)

  it("of the root is not named like a field of the root", function()
    assert.same({
      "root.getevents: a state cannot have this name, it is a field of every root",
    }, problems_of(chart { getevents = state {} }))
  end)

  it("deeper down may be named like a field of the root", function()
    assert.is_table((rfsm.init(chart { m = state { err = state {} } })))
  end)

  it("cannot contain itself", function()
    local m = state {}
    m.again = m
    assert.same({ "root.m.again: a state cannot contain itself" },
      problems_of(chart { m = m }))
  end)

  it("is called as its author likes otherwise", function()
    assert.is_table((rfsm.init(chart {
      ["a b"] = state {}, ["end"] = state {}, type = state {}, root = state {},
    })))
  end)
end)

describe("a program", function()
  it("is a function: entry", function()
    assert.same({ "root.b.entry: function expected, got string 'led'" },
      problems_of(chart { b = state { entry = "led" } }))
  end)

  it("is a function: exit", function()
    assert.same({ "root.b.exit: function expected, got number 1.5" },
      problems_of(chart { b = state { exit = 1.5 } }))
  end)

  it("is a function: doo", function()
    assert.same({ "root.b.doo: function expected, got boolean" },
      problems_of(chart { b = state { doo = true } }))
  end)

  it("is a function: guard", function()
    assert.same({ "root.trans[2].guard: function expected, got boolean" },
      problems_of(chart { [2] = trans { src = "a", tgt = "a", guard = true } }))
  end)

  it("is a function: effect", function()
    assert.same({ "root.go.effect: function expected, got table" },
      problems_of(chart { go = trans { src = "a", tgt = "a", effect = {} } }))
  end)

  it("is a function: getevents, hooks and printers of the root", function()
    assert.same({
      "root.dbg: function, true or false expected, got string 'yes'",
      "root.getevents: function expected, got number 1",
      "root.idle_hook: function expected, got number 2",
      "root.post_step_hook: function expected, got number 4",
      "root.pre_step_hook: function expected, got number 3",
    }, problems_of(chart {
      getevents = 1, idle_hook = 2, pre_step_hook = 3, post_step_hook = 4, dbg = "yes",
    }))
  end)

  it("may be anything that can be called", function()
    local callable = setmetatable({}, { __call = noop })
    assert.is_table((rfsm.init(chart { b = state { entry = callable } })))
  end)

  it("runs only in a leaf when it is a doo", function()
    assert.same({ "root.m.doo: only a leaf state can have a doo" },
      problems_of(chart { m = state { doo = noop, x = state {} } }))
  end)
end)

describe("a transition", function()
  local function of(fields)
    fields.src, fields.tgt = "a", "a"
    return problems_of(chart { [2] = trans(fields) })
  end

  it("has events in a list or one string", function()
    assert.same({
      "root.trans[2].events: list of events or a string expected, got number 5",
    }, of { events = 5 })
  end)

  it("has events in a list without keys", function()
    assert.same({
      "root.trans[2].events: list of events expected, got a table with holes or keys",
    }, of { events = { x = "e_a" } })
  end)

  it("has events in a list without holes", function()
    assert.same({
      "root.trans[2].events: list of events expected, got a table with holes or keys",
    }, of { events = { nil, "e_b" } })
  end)

  it("has no NaN among its events", function()
    assert.same({ "root.trans[2].events[2]: an event cannot be NaN" },
      of { events = { "e_a", 0 / 0 } })
  end)

  it("has a number as priority", function()
    assert.same({ "root.trans[2].pn: number expected, got string '3'" },
      of { pn = "3" })
  end)

  it("has a position or a name as its key", function()
    assert.same({ "root.true: the key of a transition is a position or a name" },
      problems_of(chart { [true] = trans { src = "a", tgt = "a" } }))
  end)
end)

describe("the root", function()
  it("needs a way in", function()
    assert.same({
      "root: the root needs an initial transition "
        .. "(rfsm.trans{ src='initial', tgt=... })",
    }, problems_of(state { err = false, a = state {} }))
  end)
end)

describe("a warning", function()
  it("tells of 'event' instead of 'events'", function()
    assert.same({
      "WARNING: root.trans[2]: a transition has no field 'event' (did you mean "
        .. "'events'?)",
    }, warnings_of(chart { [2] = trans { src = "a", tgt = "a", event = "e" } }))
  end)

  it("tells of a transition inside a leaf", function()
    local b = state { trans { src = "root.a", tgt = "root.b" } }
    assert.same({ "WARNING: root.b: a transition inside a leaf state" },
      warnings_of(chart { b = b }))
  end)

  it("tells of a forgotten rfsm.trans", function()
    assert.same({
      "WARNING: root.2: a plain table with 'src' and 'tgt' is ignored (did you mean "
        .. "rfsm.trans{...}?)",
    }, warnings_of(chart { [2] = { src = "a", tgt = "a" } }))
  end)

  it("tells of a forgotten rfsm.state", function()
    assert.same({
      "WARNING: root.m: a plain table that contains a state is ignored (did you mean "
        .. "rfsm.state{...}?)",
    }, warnings_of(chart { m = { x = state {} } }))
  end)

  it("tells of events on the only initial transition", function()
    assert.same({
      "WARNING: root.m.initial: each transition from here has events or a guard, "
        .. "'root.m' cannot be entered while none of them is enabled",
    }, warnings_of(chart {
      m = state { x = state {}, trans { src = "initial", tgt = "x", events = "e" } },
    }))
  end)

  it("tells of guards on all initial transitions", function()
    assert.same({
      "WARNING: root.m.initial: each transition from here has events or a guard, "
        .. "'root.m' cannot be entered while none of them is enabled",
    }, warnings_of(chart {
      m = state { x = state {}, trans { src = "initial", tgt = "x", guard = noop } },
    }))
  end)

  it("is silent when one initial transition is always open", function()
    assert.same({}, warnings_of(chart {
      m = state {
        x = state {},
        trans { src = "initial", tgt = "x", guard = noop, pn = 1 },
        trans { src = "initial", tgt = "x" },
      },
    }))
  end)

  it("tells of 'e_done' on a composite", function()
    local m = state { x = state {}, trans { src = "initial", tgt = "x" } }
    assert.same({
      "WARNING: root.trans[2]: 'e_done' never fires here, 'root.m' is no leaf state",
    }, warnings_of(chart {
      m = m, [2] = trans { src = "m", tgt = "a", events = "e_done" },
    }))
  end)

  it("tells of 'e_done' on a connector", function()
    assert.same({
      "WARNING: root.trans[2]: 'e_done' never fires here, 'root.k' is no leaf state",
    }, warnings_of(chart {
      k = conn {}, [2] = trans { src = "k", tgt = "a", events = "e_done" },
    }))
  end)

  it("tells of members of a connector", function()
    assert.same({ "WARNING: root.k: a connector holds no state, 'x' is ignored" },
      warnings_of(chart { k = conn { x = state {} } }))
  end)

  it("tells of nodes that nothing leaves", function()
    local said = {}
    local model = chart { b = state {}, [2] = trans { src = "a", tgt = "b" } }
    model.warn = function(text) said[#said + 1] = text end
    rfsm.init(model)
    assert.same({ "WARNING: no outgoing transitions from node 'root.b'" }, said)
  end)
end)

describe("init", function()
  -- Five mistakes in five places.
  local function five_problems()
    return chart {
      b = state { entry = 1 },
      [10] = trans { src = "a", tgt = "nowhere_near" },
      [2] = trans { src = "a", tgt = "a", pn = "x" },
      m = state { initial = state {} },
      ["q.r"] = conn {},
    }
  end

  local FIVE = {
    "root.b.entry: function expected, got number 1",
    "root.m.initial: connector expected, got state",
    "root.q.r: the name of a connector must not be empty, contain '.' or '\\' or start "
      .. "with '_'",
    "root.trans[2].pn: number expected, got string 'x'",
    "root.trans[10]: tgt 'nowhere_near': no state or connector is named 'nowhere_near' "
      .. "in 'root' (there are 'a', 'b', 'initial', 'm', 'q.r')",
  }

  it("reports five problems together, sorted by place", function()
    assert.same(FIVE, problems_of(five_problems()))
  end)

  it("hands them to err in one text", function()
    local said = {}
    local model = five_problems()
    model.err = function(...) said[#said + 1] = { ... } end
    rfsm.init(model)
    assert.same({
      { "rfsm.init: the model has 5 problems\n  " .. table.concat(FIVE, "\n  ") },
    }, said)
  end)

  it("counts a single problem as one", function()
    local said
    local model = chart { b = state { exit = 1 } }
    model.err = function(text) said = text end
    rfsm.init(model)
    assert.equal("rfsm.init: the model has 1 problem\n"
      .. "  root.b.exit: function expected, got number 1", said)
  end)

  it("raises only for what is no state, and blames the caller", function()
    local ok, problem = pcall(function() return (rfsm.init(nil)) end)
    assert.is_false(ok)
    assert.matches("check_spec.lua:%d+: invalid fsm model passed to rfsm.init: state "
      .. "expected, got nil$", problem)
  end)

  it("tells of each connector it created", function()
    local said = {}
    local m = state { x = state {}, trans { src = "initial", tgt = "x" } }
    local model = chart { m = m }
    model.info = function(text) said[#said + 1] = text end
    rfsm.init(model)
    assert.same({
      "INFO: created undeclared connector root.initial",
      "INFO: created undeclared connector root.m.initial",
    }, said)
  end)

  it("leaves the model as it was", function()
    local model = chart { b = state { data = { 1, { 2 } } } }
    rfsm.init(model)
    assert.is_nil(model.initial)
    assert.is_nil(rawget(model, "_fqn"))
    assert.same({ 1, { 2 } }, model.b.data)
    assert.equal("initial", to_a.src)
  end)

  it("counts what a preproc function finds among the problems", function()
    local function finds() return { "root.a: not to my taste" } end
    table.insert(rfsm.preproc, finds)
    local fsm, problems = rfsm.init(chart {})
    table.remove(rfsm.preproc)
    assert.is_false(fsm)
    assert.same({ "root.a: not to my taste" }, problems)
  end)
end)

describe("verify_early", function()
  it("tells problems and warnings without making a machine", function()
    local ok, problems, warnings = rfsm.verify_early(chart {
      b = state { exit = 1 }, [2] = trans { src = "a", tgt = "a", event = "e" },
    })
    assert.is_false(ok)
    assert.same({ "root.b.exit: function expected, got number 1" }, problems)
    assert.same({
      "root.trans[2]: a transition has no field 'event' (did you mean 'events'?)",
    }, warnings)
  end)
end)

describe("a field in other words", function()
  local function field(owner, name, meant)
    return ("WARNING: %s: a %s has no field '%s' (did you mean '%s'?)"):format(owner,
      owner:find("trans", 1, true) and "transition" or "state", name, meant)
  end

  for name, meant in pairs { enter = "entry", Exit = "exit", ["do"] = "doo",
    on_entry = "entry", eixt = "exit" } do -- any order: each stands alone
    it("is warned of in a state: " .. name, function()
      assert.same({ field("root.b", name, meant) },
        warnings_of(chart { b = state { [name] = noop } }))
    end)
  end

  for name, meant in pairs { gaurd = "guard", condition = "guard",
    efect = "effect" } do -- any order: each stands alone
    it("is warned of in a transition: " .. name, function()
      assert.same({ field("root.trans[2]", name, meant) }, warnings_of(chart {
        [2] = trans { src = "a", tgt = "a", events = { "e" }, [name] = noop },
      }))
    end)
  end

  it("is the user's when the right one is there, or it holds no function", function()
    assert.same({}, warnings_of(chart {
      b = state { entry = noop, enter = noop, exec = noop, edit = noop, exits = 1 },
    }))
  end)
end)

describe("the name of a transition", function()
  it("is none of the engine's, and no field of a state", function()
    local tr = { src = "root.a", tgt = "root.a", events = { "e" } }
    assert.same({
      "root._parent: the name of a transition must not start with '_'",
      "root.a.exit: a transition cannot have this name, it is a field of every state",
    }, problems_of(chart { _parent = trans(tr), a = state { exit = trans(tr) } }))
  end)
end)
