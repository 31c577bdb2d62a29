-- Verdicts: nothing is said to hold that does not, and each names its premises.

local ab = require "spec.support.ab"
local claim = require "spec.support.claims.after"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local share = require "spec.support.share"
require "rfsm_timeevent"
require "rfsm.await"

local state, conn = rfsm.state, rfsm.conn
local never, always = rfsm_checks.never, rfsm_checks.always
local after, from = rfsm_checks.after, rfsm_checks.from
local chart, go, verdict = ab.chart, ab.go, ab.verdict

local VIOLATED = "p: does not hold [violated]\n"

local function silent(members)
  members.info, members.warn, members.err = false, false, false
  return state(members)
end

local function yes() return true end

describe("a verdict", function()
  local function light()
    return silent { red = state {}, green = state {}, go("initial", "red"),
      go("red", "green", "e_after(20)"), go("green", "red", { "e_button", "e_at(9)" }) }
  end

  it("has time events, whatever the alphabet is", function()
    assert.equal(VIOLATED .. "  1. no event: root.trans[1] -> root.red\n"
      .. "  2. +20.001 s, e_after(20)@root.red: root.trans[2] -> root.green",
      verdict(light(), never "root.green", { alphabet = { "e_button" } }))
  end)

  local send, api = rfsm.send_events, { post = rfsm.send_events }
  local SENDERS = {
    ["the library's name"] = function(fsm) rfsm.send_events(fsm, "e_q") end,
    ["a name of its own"] = function(fsm) send(fsm, "e_q") end,
    ["a table of its own"] = function(fsm) api.post(fsm, "e_q") end,
  }
  for name, sends in pairs(SENDERS) do -- any order: each stands alone
    it("knows that callbacks send outside of the alphabet, by " .. name, function()
      local function model() return chart { c = state {}, b = state { entry = sends },
        [2] = go("a", "b", "e_p"), [3] = go("b", "c", "e_q") } end
      local function said(options)
        options.alphabet, options.properties = { "e_p" }, { never "root.c" }
        return rfsm_checks.explore(model(), options)
      end
      local result = said {}
      assert.is_nil(result.properties[1].holds)
      assert.equal("events that the entry root.b may send, which sends does not name",
        result.untried[1])
      assert.is_true(said({ sends = { ["entry root.b"] = {} } }).properties[1].holds)
      assert.is_false(said({ dry_run = true }).properties[1].holds)
    end)
  end

  -- Explores a chart with properties. Each has to have the verdict that it has alone.
  -- Returns the names of those that hold.
  local function holding(model, given)
    local names = {}
    for _, judged in ipairs(rfsm_checks.explore(model, { properties = given })
      .properties) do
      local name = judged.name
      local own = { properties = { [name] = given[name] } }
      local alone = rfsm_checks.explore(model, own)
      assert.equal(tostring(alone.properties[1]), tostring(judged))
      if judged.holds then names[#names + 1] = name end
    end
    return table.concat(names, " ")
  end

  it("is the same beside other properties, which may share a walk", function()
    assert.equal("first heard left short", holding(chart { c = state {}, [2] = go("a",
      "b", "e_x"), [3] = go("b", "a", "e_after(2)"), [4] = go("b", "c", "e_y"),
      [5] = go("c", "a", "e_x") }, { late = from "root.b".left_within(1),
      left = from "root.b".left_within(3), short = from "root.b".left_within(2),
      early = from "root.b".stays(2), few = rfsm_checks.at_most(2, "e_x").within(1),
      soon = after "e_x".reach "root.b".within(9), none = after "e_z".never "root.b",
      long = after "e_y".reach "root.a".within(9), later = after "e_y".never "root.b",
      first = rfsm_checks.precedes("root.b", "root.c"),
      other = rfsm_checks.precedes("root.c", "root.b"),
      heard = rfsm_checks.precedes("e_x", "entry root.b"),
      again = rfsm_checks.precedes("entry root.b", "root.c").since("e_x") }))
  end)

  it("is the same beside an `after` whose event is outside of the alphabet", function()
    local model = chart { c = state {}, [4] = go("b", "c", "e_y") }
    local result = rfsm_checks.explore(model, { alphabet = { "e_x" }, together = 1,
      properties = { off = never "root.c", out = after "e_y".reach "root.a",
        on = from "root.b".after "e_y".reach "root.c",
        to = from "root.b".can_reach "root.c" } })
    local holds = {}
    for _, judged in ipairs(result.properties) do holds[judged.name] = judged.holds end
    assert.same({ off = true, on = true, out = false, to = false }, holds)
    assert.matches("root.c: active in no configuration", tostring(result), 1, true)
  end)

  it("is the same beside a property of time that ends sooner", function()
    assert.equal("nine", holding(chart { [2] = go("a", "b", "e_x"), [3] = go("b", "a",
      "e_after(9)") }, { nine = from "root.b".left_within(9),
      one = from "root.b".left_within(1), three = from "root.b".left_within(3) }))
  end)

  it("is the same if the monitors are too many for one walk", function()
    local members, given = { c = state {} }, {}
    for i = 1, 5 do
      members[3 + i] = go("a", "a", "e_" .. i)
      given["p" .. i] = after("e_" .. i).never "root.c"
    end
    assert.equal("p1 p2 p3 p4 p5", holding(chart(members), given))
    given.p3 = after("e_3").never "root.b"
    assert.equal("p1 p2 p4 p5", holding(chart(members), given))
  end)

  it("names the property that has the same premises", function()
    local result = rfsm_checks.explore(light(), { properties = {
      b = always "root", a = never { "root.red", "root.green" },
      c = after "e_button".reach "root" } })
    local premises = "; stepped between any two deadlines; steps take no time; timers "
      .. "free"
    assert.same({ "a: holds (two events a step" .. premises .. ")",
      "b: holds (premises of 'a')", "c: holds (premises of 'a')" }, result:summary())
  end)

  it("of a machine that takes one event has one event a step", function()
    local model = chart { [2] = go("a", "b", "e_x"), [3] = go("b", "a", "e_y") }
    assert.is_false(rfsm_checks.explore(model, { properties = {
      after "e_y".reach "root.a" } }).properties[1].holds)
    model.read = "one"
    assert.is_true(rfsm_checks.explore(model, { properties = {
      after "e_y".reach "root.a" } }).properties[1].holds)
  end)

  it("has awaits that are complete, and only those", function()
    local function waiting()
      return chart { [2] = go("a", "b", "await(e_p, e_q)") }
    end
    assert.equal(VIOLATED .. "  1. no event: root.trans[1] -> root.a\n"
      .. "  2. e_p: no transition -> root.a\n  3. e_q: root.trans[2] -> root.b",
      verdict(waiting(), never "root.b", { alphabet = { "e_p", "e_q" } }))
    assert.equal("p: holds (one event a step; no event outside of the alphabet)",
      verdict(waiting(), never "root.b", { alphabet = { "e_p" } }))
  end)

  it("has awaits of many events, in any order", function()
    local model = chart { [2] = go("a", "b", "await(e_p, e_q, e_r)"),
      [4] = go("a", "c", "await(e_q, e_s)"), c = state {}, [5] = go("c", "a", "e_x") }
    assert.equal(VIOLATED .. "  1. no event: root.trans[1] -> root.a\n"
      .. "  2. e_p: no transition -> root.a\n  3. e_q: no transition -> root.a\n"
      .. "  4. e_r: root.trans[2] -> root.b", verdict(model, never "root.b"))
    assert.equal(VIOLATED .. "  1. no event: root.trans[1] -> root.a\n"
      .. "  2. e_q: no transition -> root.a\n  3. e_s: root.trans[4] -> root.c",
      verdict(model, never "root.c"))
    assert.equal("p: holds (one event a step; no event outside of the alphabet)",
      verdict(model, never { "root.b" }, { alphabet = { "e_p", "e_q", "e_s" } }))
  end)

  it("forgets what an await has received when its state is left", function()
    local model = silent { a = state {}, b = state {}, c = state {}, go("initial", "a"),
      go("a", "b", "await(e_p, e_q)"), go("a", "c", "e_p", { pn = 1 }),
      go("c", "a", "e_x"), go("b", "a", "e_x") }
    assert.equal("p: holds (one event a step)", verdict(model, never "root.b"))
  end)

  it("has predicates that may accept any event, also one that nothing names", function()
    local function joystick(event) return event:match("^e_joy_") ~= nil end
    local model = silent { parked = state {}, moving = state {},
      go("initial", "parked"), go("parked", "moving", { joystick }),
      go("moving", "parked", "e_stop") }
    assert.equal(VIOLATED .. "  1. no event: root.trans[1] -> root.parked\n"
      .. "  2. no event (root.trans[2] predicate true): root.trans[2] -> root.moving",
      verdict(model, never "root.moving"))
    assert.equal("p: holds (one event a step; predicates free)",
      verdict(model, never { "root.moving", "root.parked" }))
    local fsm = helper.started(model)
    assert.equal("root.moving", helper.leaf_after(fsm, "e_joy_left"))
  end)

  it("calls no predicate, so that one without end does no harm", function()
    local model = chart { [2] = go("a", "b", { function() while true do end end }) }
    assert.equal("p: holds (one event a step; predicates free)",
      verdict(model, always "root"))
  end)

  it("has the predicates of regions, too", function()
    local region = state { warn = false, info = false, x = state {}, y = state {},
      go("initial", "x"), go("x", "y", { yes }), go("y", "x", "e_y") }
    local model = chart { b = rfsm.seqand { left = region } }
    assert.equal(VIOLATED, verdict(model, never "root.b.left.y"):sub(1, #VIOLATED))
    assert.equal(yes, region[2].events[1])
  end)

  it("names the number of events, and what is free", function()
    local model = chart { [4] = go("a", "b", { "e_x", "e_after(1)" }, { guard = yes }),
      [5] = go("b", "c", "e_c"), c = state { doo = yes }, [6] = go("c", "a", "e_x") }
    local premises = "; stepped between any two deadlines; steps take no time; doos "
      .. "and guards free)"
    local holds = always "root"
    assert.equal("p: holds (one event a step; doos, guards and timers free)",
      verdict(model, holds, { timers = "free" }))
    assert.equal("p: holds (one event a step; stepped every 0.5 s; steps take no time; "
      .. "doos and guards free)", verdict(model, holds, { period = 0.5 }))
    assert.equal("p: holds (one event a step" .. premises, verdict(model, holds))
    assert.equal("p: holds (two events a step" .. premises,
      verdict(model, holds, { together = 2 }))
    assert.equal("p: holds (4 events a step" .. premises,
      verdict(model, holds, { together = 4 }))
    assert.equal("p: holds (two events a step" .. premises,
      verdict(model, after "e_x".reach "root"))
  end)

  it("of after tries two events, unless the options say otherwise", function()
    local model = silent { idle = state {}, moving = state {}, stopped = state {},
      go("initial", "idle"), go("idle", "moving", "e_go"),
      go("idle", "stopped", "e_stop"), go("moving", "stopped", "e_stop", { pn = 1 }),
      go("stopped", "idle", "e_reset") }
    local stops = after "e_stop".reach "root.stopped"
    assert.equal("p: holds (one event a step)", verdict(model, stops, { together = 1 }))
    assert.equal(VIOLATED .. "  1. no event: root.trans[1] -> root.idle\n"
      .. "  2. e_go, e_stop: root.trans[2] -> root.moving", verdict(model, stops))
  end)

  -- A chart with a path that needs one of `count` events and one of as many others, and
  -- another path behind it.
  local function many_sets(count)
    local first, second = {}, {}
    for i = 1, count do first[i], second[i] = "e_f" .. i, "e_s" .. i end
    return chart { k = conn {}, j = conn {}, c = state {},
      [4] = go("a", "k", first), [5] = go("k", "b", second),
      [6] = go("a", "j", "e_j"), [7] = go("j", "c", "e_c"), [8] = go("c", "a", "e_x") }
  end

  it("is not known if some sets of events were not tried", function()
    assert.equal("p: not known", verdict(many_sets(40), never "root.c"))
    local result = rfsm_checks.explore(many_sets(40))
    assert.equal("sets", result.bound)
    assert.same({ "some sets of events that paths from root.a need" }, result.untried)
    assert.matches("\nnot tried: some sets of events that paths from root.a need; "
      .. "unreached states, ", tostring(result))
  end)

  it("tries more than a hundred sets", function()
    assert.equal(VIOLATED .. "  1. no event: root.trans[1] -> root.a\n"
      .. "  2. e_j, e_c: root.trans[6], root.trans[7] -> root.c",
      verdict(many_sets(11), never "root.c"))
  end)

  it("is not known if a step has too many choices", function()
    local members = { k = conn {}, [4] = go("a", "k", "e_y") }
    for i = 5, 18 do members[i] = go("k", "b", nil, { guard = yes }) end
    local result = rfsm_checks.explore(chart(members))
    assert.equal("choices", result.bound)
    assert.same({ "more than 4096 choices of one step" }, result.untried)
  end)

  it("is not known if steps have too many choices for the bound", function()
    local members = { k = conn {}, [4] = go("a", "k", "e_y") }
    for i = 5, 14 do members[i] = go("k", "b", nil, { guard = yes }) end
    local options, model = { configurations = 10 }, chart(members)
    for _, result in ipairs { rfsm_checks.explore(model, options),
      require "rfsm.system" { one = model, wires = {} }:explore(options) } do
      assert.equal("choices", result.bound)
      assert.same({ "more than 1000 steps, since some have very many choices" },
        result.untried)
    end
  end)

  it("has the events that enter a sequential AND state come to its regions", function()
    local arm = state { warn = false, info = false, left = state {},
      go("initial", "left", "e_left") }
    local model = chart { a = state { doo = yes }, [2] = go("a", "b"),
      b = rfsm.seqand { arm = arm } }
    assert.equal(VIOLATED .. "  1. no event: root.trans[1] -> root.a\n"
      .. "  2. e_left: root.trans[2] -> root.b\n"
      .. "  3. no event: root.b.arm.trans[1] -> root.b",
      verdict(model, never "root.b.arm.left"))
  end)

  it("has what callbacks send around a sequential AND state come to its regions",
    function()
    local function arm()
      return chart { b = rfsm.seqand { arm = state { warn = false, info = false,
        left = state {}, right = state {}, go("initial", "left"),
        go("left", "right", "e_right") } } }
    end
    for _, name in ipairs { "entry root.b", "exit root.a", "effect root.trans[2]" } do
      assert.equal(VIOLATED, verdict(arm(), never "root.b.arm.right",
        { alphabet = { "e_x" }, sends = { [name] = { "e_right" } } }):sub(1, #VIOLATED))
    end
  end)

  it("has the time events of regions come to them alone", function()
    local model = chart { b = rfsm.seqand { arm = state { warn = false, info = false,
      left = state {}, right = state {}, go("initial", "left"),
      go("left", "right", "e_after(1)") } }, c = state {}, [4] = go("b", "c"),
      [5] = go("c", "b", "e_x") }
    local text = verdict(model, never "root.b.arm.right", { alphabet = {} })
    assert.equal("p: holds (one event a step; no event outside of the alphabet; "
      .. "stepped between any two deadlines; steps take no time)", text)
    text = verdict(model, never "root.b.arm.right")
    assert.matches("3. %+1.001 s, e_after%(1%)@root.left in root.b.arm: "
      .. "root.b.arm.trans%[2%] %-> root.b", text)
  end)

  it("is vacuous if nothing is there to be judged, and has the reason", function()
    local members = { dead = state {}, [4] = go("dead", "a", "e_q") }
    assert.equal("p: holds vacuously, no configuration has root.dead (one event a "
      .. "step)", verdict(chart(members), from "root.dead".can_reach "root.b"))
    assert.equal("p: holds vacuously, no transition names e_nobody (there are 'e_x', "
      .. "'e_q') (two events a step)",
      verdict(chart(members), after "e_nobody".reach "root"))
    assert.equal("p: holds vacuously, e_done@root.dead never comes (two events a "
      .. "step)", verdict(chart(members), after "e_done@root.dead".reach "root.b"))
    assert.equal("p: holds (two events a step)",
      verdict(chart(members), after "e_x".reach "root"))
  end)

  it("is not vacuous if what it asks for holds at once", function()
    assert.equal("p: holds (two events a step)",
      verdict(chart(), after "entry root.b".reach "root.b"))
    assert.equal("p: holds (two events a step)",
      verdict(chart(), after "taken root.trans[2]".reach "root.b"))
    assert.equal("p: holds (one event a step)",
      verdict(chart(), after "entry root.b".never "root.a".until_ "root.b"))
    assert.equal("p: holds vacuously, entry root.dead never comes (one event a step)",
      verdict(chart { dead = state {} },
        after "entry root.dead".never "root.a".until_ "root.dead"))
  end)

  it("is not vacuous if a transition on any event or behind a connector has it",
    function()
    assert.equal("p: holds (two events a step)", verdict(chart { [4] = go("b", "b") },
      after "e_nobody".reach "root"))
    assert.equal("p: holds (two events a step)", verdict(chart { k = rfsm.conn {},
      [4] = go("b", "k", { "e_y", "e_z" }), [5] = go("k", "a", "e_y"),
      [6] = go("k", "b", "e_z", { pn = -1 }) }, after "e_y".reach { "root" }))
  end)

  it("is vacuous for a machine that is never entered", function()
    local model = chart { [1] = go("initial", "a", "e_no") }
    assert.equal("p: holds vacuously, the machine is never entered (one event a step; "
      .. "no event outside of the alphabet)", verdict(model, never "root.a",
      { alphabet = {} }))
  end)

  it("of after has time events and e_done where they come", function()
    local members = { c = state { doo = yes }, [4] = go("b", "c", "e_after(2)"),
      [5] = go("c", "a", "e_done"), [6] = go("root", "a", "e_z") }
    local free = " (two events a step; stepped between any two deadlines; steps take "
      .. "no time; doos free)"
    local function not_in(name)
      return function(active) return not active(name) end
    end
    assert.equal("p: holds" .. free,
      verdict(chart(members), after "e_done@root.c".reach(not_in "root.c")))
    assert.equal(VIOLATED, verdict(chart(members),
      after "e_after(2)@root.b".reach "root.c"):sub(1, #VIOLATED))
    members[6] = nil
    members[3] = go("b", "b", "e_x", { pn = -1 })
    assert.equal("p: holds" .. free,
      verdict(chart(members), after "e_after(2)@root.b".reach(not_in "root.b")))
  end)

  it("sees the states that a step passes through", function()
    local function passing()
      return chart { c = state { x = state {}, go("initial", "root.b") },
        [2] = go("a", "c", "e_x") }
    end
    local shown = VIOLATED .. "  1. no event: root.trans[1] -> root.a\n"
      .. "  2. e_x: root.trans[2], root.c.trans[1] -> root.b"
    assert.equal(shown, verdict(passing(), never "root.c"))
    assert.equal(shown, verdict(passing(), never { "root.c", "on" },
      { flags = { on = { on = { "effect root.trans[2]" } } } }))
    assert.equal("p: holds (one event a step)",
      verdict(passing(), never { "root.c", "root.b" }))
    assert.equal("p: holds (one event a step)",
      verdict(passing(), from "root.a".can_reach "root.c"))
    assert.equal("p: holds (one event a step)",
      verdict(passing(), from "root.c".can_reach "root.a"))
    assert.is_nil(tostring(rfsm_checks.explore(passing())):find("root.c: active in no",
      1, true))
  end)

  it("sees the states that several steps pass through on their way to one state",
    function()
      local model = chart { c = state { x = state {}, go("initial", "root.d") },
        d = state {}, [2] = go("a", "c", "e_x"), [3] = go("a", "b", "e_y"),
        [4] = go("b", "c", "e_x") }
      assert.equal("p: holds (one event a step)",
        verdict(model, from "root.b".can_reach "root.c"))
    end)

  it("sees the states that a step passes through by a transition of another state",
    function()
    local model = chart { c = state { k = conn {}, x = state {}, go("initial", "x") },
      [2] = go("a", "root.c.k", "e_x"), [4] = go("root.c.k", "b") }
    assert.equal(VIOLATED .. "  1. no event: root.trans[1] -> root.a\n"
      .. "  2. e_x: root.trans[2], root.trans[4] -> root.b",
      verdict(model, never "root.c"))
  end)

  it("sees the states that a region passes through", function()
    local model = chart { b = rfsm.seqand { run = true, arm = state { warn = false,
      info = false, x = state {}, y = state {}, go("initial", "x"),
      go("x", "y", "e_done") } } }
    assert.equal(VIOLATED, verdict(model, never "root.b.arm.x"):sub(1, #VIOLATED))
  end)

  it("is not known if a callback may write the target of a transition", function()
    local model = chart { [4] = go("b", "c", "e_c", { effect = function(fsm)
      fsm[2].tgt = fsm.c
    end }), c = state {}, [5] = go("c", "a", "e_x") }
    local result = rfsm_checks.explore(model,
      { properties = { never { "root.a", "root.b" } } })
    assert.equal("targets", result.bound)
    assert.same({ "transitions that the effect root.trans[4] may change or add" },
      result.untried)
    assert.is_nil(result.properties[1].holds)
  end)
end)

describe("a callback that may write a target", function()
  local function writer(fsm) fsm[2]["tgt"] = fsm.c end
  local function calls_writer(fsm) writer(fsm) end
  local function reader(fsm) return fsm[2].tgt == fsm.c and { tgt = fsm.c } end

  local CASES = {
    { name = "by an index", effect = writer, is_known = false },
    { name = "by a function that it calls", effect = calls_writer, is_known = false },
    { name = "by a merge", is_known = false, effect = function(fsm)
      rfsm.fsm_merge(fsm, fsm, rfsm.trans { src = "b", tgt = "c", events = { "e_d" } })
    end },
    { name = "by a global function", is_known = false,
      effect = function(fsm) return rawget(_G, "write_target")(fsm) end },
    { name = "no target that is read", effect = reader, is_known = true },
    { name = "no target, as a function of C", effect = print, is_known = true },
  }
  for _, case in ipairs(CASES) do
    it("is found: " .. case.name, function()
      rawset(_G, "write_target", writer)
      local result = rfsm_checks.explore(chart { c = state {}, [4] = go("b", "c", "e_c",
        { effect = case.effect }), [5] = go("c", "a", "e_x") })
      rawset(_G, "write_target", nil)
      assert.equal(case.is_known, result.bound == nil)
    end)
  end

  it("may be an entry, exit, guard, doo or predicate", function()
    local function untried(members)
      return rfsm_checks.explore(chart(members)).untried[1]
    end
    local before = "transitions that the "
    assert.equal(before .. "entry root.b may change or add",
      untried { b = state { entry = writer } })
    assert.equal(before .. "exit root.b may change or add",
      untried { b = state { exit = writer } })
    assert.equal(before .. "doo root.b may change or add",
      untried { b = state { doo = writer } })
    assert.equal(before .. "guard root.trans[4] may change or add",
      untried { [4] = go("a", "b", "e_y", { guard = writer }) })
    assert.matches("^transitions that the predicate of .*root.trans%[4%] %(a %-> b%) ",
      untried { [4] = go("a", "b", { writer }) })
  end)
end)

describe("options of an exploration", function()
  it("have a function that is called now and then", function()
    local members, calls = {}, {}
    for i = 1, 600 do
      members["s" .. i] = state {}
      members[3 + i] = go(i == 1 and "a" or "s" .. i - 1, "s" .. i, "e_go")
    end
    rfsm_checks.explore(chart(members), { progress = function(count, depth)
      calls[#calls + 1] = count + depth
    end })
    assert.equal(2, #calls)
    assert.is_true(calls[2] > calls[1])
  end)

  it("are conditions of the right types", function()
    local CASES = {
      { f = rfsm_checks.never, text = "rfsm_checks.never: path of a state, name of a "
        .. "flag, list of them or function expected, got number" },
      { f = rfsm_checks.always, text = "rfsm_checks.always: path" },
      { f = rfsm_checks.from, text = "rfsm_checks.from: path" },
      { f = from "root.a".can_reach, text = "rfsm_checks.from(...).can_reach: path" },
      { f = after "e_x".reach, text = "rfsm_checks.after(...).reach: path" },
    }
    for _, case in ipairs(CASES) do
      for _, wrong in ipairs { 7, {}, { 7 }, { "root.a", 7 },
        { "root.a", nil, "root.b" }, { "root.a", b = "root.b" } } do
        local ok, text = pcall(function() return (case.f(wrong)) end)
        assert.is_false(ok)
        if wrong == 7 then
          assert.matches("^[^\n]*verdict_spec.lua:%d+: ", text)
          assert.is_truthy(text:find(case.text, 1, true))
        end
      end
    end
    local _, text = pcall(function() return (after(nil)) end)
    assert.matches("verdict_spec.lua:%d+: rfsm_checks.after: event expected, got nil",
      text)
    assert.equal("after e_x reach root.a and root.b",
      tostring(after "e_x".reach { "root.a", "root.b" }))
    assert.equal("from a function can reach root.a",
      tostring(from(print).can_reach "root.a"))
  end)

  for _, property in ipairs {
    never(rfsm.named "e_x"), from "root.a".can_reach(rfsm.named "e_x"),
    after "e_x".reach(rfsm.named "e_x"), after "e_x".never(rfsm.named "e_x") } do
    it("are conditions, no events: " .. tostring(property), function()
      local options = { properties = { property } }
      local ok, text = pcall(rfsm_checks.explore, chart {}, options)
      assert.is_false(ok)
      assert.matches("^[^\n]*verdict_spec.lua:%d+: rfsm_checks.explore: property .*: "
        .. "state, flag or function expected, got the event e_x$", text)
    end)
  end

  for _, f in ipairs { always "root.a".unless, after "e_x".never "root.b".until_,
    rfsm_checks.precedes("root.a", "root.b").since } do
    it("are endings that may come", function()
      local ok, text = pcall(f, {})
      assert.is_false(ok)
      assert.matches("event or condition expected, got an empty list$", text)
    end)
  end

  it("refuse other types", function()
    local CASES = {
      { dry_run = 1 }, { depth = "x" }, { seconds = "x" }, { progress = 1 },
      { properties = 1 }, { flags = 1 }, { sends = 1 },
    }
    local EXPECTED = { dry_run = "boolean", depth = "number", seconds = "number",
      progress = "function", properties = "table", flags = "table of flags",
      sends = "table of lists" }
    for _, options in ipairs(CASES) do
      local name = next(options)
      local ok, text = pcall(rfsm_checks.explore, chart(), options)
      assert.is_false(ok)
      assert.is_truthy(text:find(name .. ": " .. EXPECTED[name] .. " expected, got", 1,
        true), text)
    end
  end)

  -- Options, the message.
  local REFUSED = {
    { options = { together = 0 }, text = "together: whole number above 0 expected, got "
      .. "0" },
    { options = { together = 1.5 }, text = "together: whole number above 0 expected, "
      .. "got 1.5" },
    { options = { configurations = 0 }, text = "configurations: whole number above 0 "
      .. "expected, got 0" },
    { options = { flags = { lit = { On = { "entry root.b" } } } },
      text = "flags: lit: no field 'On' (did you mean 'on'?)" },
    { options = { flags = { lit = { on = "entry root.b" } } },
      text = "flags: lit.on: list of callbacks expected, got string 'entry root.b'" },
    { options = { flags = { lit = "on" } },
      text = "flags: lit: table with the lists 'on' and 'off' expected, got string "
        .. "'on'" },
    { options = { flags = { lit = { off = { "entry root.b" } } } },
      text = "flags: lit.on: callbacks or events that switch it on expected, got "
        .. "none" },
    { options = { flags = { lit = { on = {} } } },
      text = "flags: lit.on: callbacks or events that switch it on expected, got "
        .. "none" },
    { options = { sends = { ["entry root.b"] = "e_x" } },
      text = "sends: ['entry root.b']: list of events expected, got string 'e_x'" },
    { options = { alphabet = { e_x = true } }, text = "alphabet: list expected, got "
      .. "table" },
  }
  for _, case in ipairs(REFUSED) do
    it("are refused: " .. case.text, function()
      local ok, text = pcall(rfsm_checks.explore, chart(), case.options)
      assert.is_false(ok)
      assert.equal("rfsm_checks.explore: " .. case.text, (text:gsub("^%S+:%d+: ", "")))
    end)
  end

  it("have no flag that is named like a state", function()
    local ok, text = pcall(rfsm_checks.explore, chart(), { flags = { ["root.b"] = {
      on = { "entry root.a" } } } })
    assert.is_false(ok)
    assert.equal("flags: 'root.b' is the path of a state, use another name", text)
  end)

  it("have no event in the alphabet that no transition names", function()
    local function explore(members, alphabet)
      return select(2, pcall(rfsm_checks.explore, chart(members),
        { alphabet = alphabet }))
    end
    assert.equal("alphabet: no transition names the event 'e_y' (did you mean 'e_x'?)",
      explore({}, { "e_x", "e_y" }))
    assert.equal("table", type(explore({ [4] = go("a", "b", "await(e_y)") },
      { "e_y" })))
    assert.equal("table", type(explore({ [4] = go("a", "b", { yes }) }, { "e_y" })))
    assert.equal("table", type(explore({ properties = {
      after "e_y".never "root.b" } }, { "e_x", "e_y" })))
  end)

  it("have no event of after that a machine would make itself, and does not", function()
    local ok, text = pcall(rfsm_checks.explore, chart { [4] = go("a", "b", "e_after(2)")
    }, { properties = { p = after "e_after(3)@root.a".reach "root.b" } })
    assert.is_false(ok)
    assert.equal("rfsm_checks.explore: property 'p': no transition names the event "
      .. "'e_after(3)@root.a' (did you mean 'e_after(2)@root.a'?)",
      (text:gsub("^spec/verdict_spec.lua:%d+: ", "")))
  end)
end)

describe(claim.name, function()
  it("agree on random charts", function()
    assert.is_nil(share.problem(claim, 10))
  end)
end)

describe("a witness of any finding", function()
  -- Models whose findings have witnesses.
  local CASES = {
    { name = "an event that nothing names", model = chart { [2] = go("a", "b") } },
    { name = "a predicate", model = chart { [2] = go("a", "b", { yes }) } },
    { name = "a time event", model = chart { [2] = go("a", "b", "e_after(3)") } },
    { name = "an await", model = chart { [2] = go("a", "b", "await(e_p, e_q)") } },
    { name = "what a callback sends", sends = { ["effect root.trans[3]"] = { "e_x" } },
      alphabet = { "e_go" }, model = chart { c = state {}, [2] = go("c", "b", "e_x"),
        [3] = go("a", "c", "e_go", { effect = yes }) } },
  }
  for _, case in ipairs(CASES) do
    it("replays " .. case.name, function()
      local options = { properties = { never "root.b" }, sends = case.sends,
        alphabet = case.alphabet }
      local result = rfsm_checks.explore(case.model, options)
      local witness, records = result.properties[1].witness, {}
      rfsm_checks.record_witness(case.model, witness, records)
      local fsm = assert(require("rfsm.record").replay(case.model, records,
        { dry = true }))
      assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    end)
  end

  -- par, with a region that has s1 --e_s--> s2
  local function sending(fields)
    local region = state { s1 = state { entry = yes }, s2 = state {},
      go("initial", "s1"), go("s1", "s2", "e_s") }
    fields.r = region
    return state { info = false, warn = false, par = rfsm.seqand(fields),
      go("initial", "par") }
  end

  local function record(model)
    local result, list = rfsm_checks.explore(model, { alphabet = {},
      sends = { ["entry root.par.r.s1"] = { "e_s" } },
      properties = { never "root.par.r.s2" } }), {}
    rfsm_checks.record_witness(model, result.properties[1].witness, list)
    return assert(require("rfsm.record").replay(model, list, { dry = true }))
  end

  it("replays what a callback in a region sends, unless it takes steps", function()
    assert.equal("root.s2", rfsm.get_actleaf_fqn(record(sending {}).par.substates.r))
    assert.error_matches(function() record(sending { step = 2 }) end,
      "^rfsm_checks.record_witness: a callback in root.par.r sends 'e_s' while the "
      .. "region takes several steps in one: no recording has that$")
  end)

  it("leaves the clock of the process as it is", function()
    local rfsm_timeevent = require "rfsm_timeevent"
    local model = chart { [2] = go("a", "b", "e_after(3)") }
    local result = rfsm_checks.explore(model, { properties = { never "root.b" } })
    rfsm_timeevent.set_gettime_hook(function() return 77, 0 end)
    rfsm_checks.record_witness(model, result.properties[1].witness, {})
    local fsm = helper.started(chart { [2] = go("a", "b", "e_at(70)") })
    rfsm_timeevent.set_gettime_hook(nil)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)
end)
