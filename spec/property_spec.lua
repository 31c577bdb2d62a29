-- Properties of runs: what an exploration says of them, and a machine that is watched.

local ab = require "spec.support.ab"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local share = require "spec.support.share"
local snapshot = require "rfsm.snapshot"
local watching = require "spec.support.claims.watching"
require "rfsm_timeevent"

local state = rfsm.state
local after, from = rfsm_checks.after, rfsm_checks.from
local precedes, until_ = rfsm_checks.precedes, rfsm_checks.until_
local chart, go, verdict = ab.chart, ab.go, ab.verdict

local function yes() return true end

local VIOLATED = "p: does not hold [violated]\n"

local function lines(...) return table.concat({ ... }, "\n") end

describe("a property of runs", function()
  -- a --e_x--> b --e_x--> a, a --e_c--> c
  local C = { c = state {}, [4] = go("a", "c", "e_c"), [5] = go("c", "b", "e_done") }
  local DOO = { c = state { doo = yes }, [4] = go("a", "c", "e_c"),
    [5] = go("c", "b", "e_done"), [6] = go("b", "b", "e_y") }
  local GUARDED = { c = state {}, [4] = go("a", "c", "e_c"),
    [5] = go("c", "b", "e_done", { guard = yes }) }
  local AGAIN = { c = state { doo = yes }, [4] = go("a", "c", "e_c"),
    [5] = go("c", "b", "e_done"), [6] = go("c", "c", "e_c") }
  local DEEP = { c = state { doo = yes }, d = state { doo = yes },
    [4] = go("a", "c", "e_c"), [5] = go("c", "d", "e_x"), [6] = go("d", "c", "e_x"),
    [7] = go("c", "b", "e_done"), [8] = go("d", "b", "e_done") }

  local CASES = {
    { name = "leads_to, by itself", members = C,
      property = after "e_c".leads_to "root.b",
      verdict = "p: holds (one event a step; doos end)" },
    { name = "leads_to, when a doo has ended", members = DOO,
      property = after "e_c".leads_to "root.b",
      verdict = "p: holds (one event a step; doos free; doos end)" },
    { name = "leads_to, if a guard says no", members = GUARDED,
      property = after "e_c".leads_to "root.b",
      verdict = lines(VIOLATED .. "  1. no event: root.trans[1] -> root.a",
        "  2. e_c: root.trans[4] -> root.c",
        "  3. no event (root.trans[5] false): no transition -> root.c",
        "  and nothing more has to come") },
    { name = "leads_to, if a doo begins again and again", members = AGAIN,
      property = after "e_c".leads_to "root.b",
      verdict = lines(VIOLATED .. "  1. no event: root.trans[1] -> root.a",
        "  2. e_c: root.trans[4] -> root.c",
        "  3. e_c: root.trans[6] -> root.c", "  and again from 3 on") },
    { name = "leads_to, if states come in turn", members = DEEP,
      property = after "e_c".leads_to "root.b",
      verdict = lines(VIOLATED .. "  1. no event: root.trans[1] -> root.a",
        "  2. e_c: root.trans[4] -> root.c",
        "  3. no event (root.c ends): no transition -> root.c",
        "  4. e_x: root.trans[5] -> root.d", "  5. e_x: root.trans[6] -> root.c",
        "  and again from 3 on") },
    { name = "leads_to, if another event comes in the same step", members = C,
      property = after "e_c".leads_to "root.c", together = 2,
      verdict = lines(VIOLATED .. "  1. no event: root.trans[1] -> root.a",
        "  2. e_x, e_c: root.trans[2] -> root.b",
        "  and nothing more has to come") },
    { name = "leads_to, if the event comes in vain", members = C,
      property = after "e_y".leads_to "root.c", is_violated = true },
    { name = "leads_to, if it never comes", members = { d = state {} },
      property = after "e_done@root.d".leads_to "root.d",
      verdict = "p: holds vacuously, e_done@root.d never comes (one event a step; doos "
        .. "end)" },
    { name = "never, from then on", members = C, property = after "e_c".never "root.a",
      verdict = lines(VIOLATED .. "  1. no event: root.trans[1] -> root.a",
        "  2. e_x: root.trans[2] -> root.b", "  3. e_c: no transition -> root.b",
        "  4. e_x: root.trans[3] -> root.a") },
    { name = "never, at once", members = C, property = after "e_x".never "root.b",
      verdict = lines(VIOLATED .. "  1. no event: root.trans[1] -> root.a",
        "  2. e_x: root.trans[2] -> root.b") },
    { name = "never, and it is so", property = after "e_x".never { "root.a", "root.b" },
      verdict = "p: holds (one event a step)" },
    { name = "precedes, and it does", members = C, property = precedes("root.a",
      "root.c"), verdict = "p: holds (one event a step)" },
    { name = "precedes, and it does not", members = C, property = precedes("root.b",
      "root.c"), verdict = lines(VIOLATED .. "  1. no event: root.trans[1] -> root.a",
        "  2. e_c: root.trans[4] -> root.c") },
    { name = "precedes, while a step passes through", members = { c = state {
      x = state {}, go("initial", "root.b") }, [2] = go("a", "c", "e_x") },
      property = precedes("root.b", "root.c"), is_violated = true },
    { name = "precedes, since a step passed through", members = { c = state {
      x = state {}, go("initial", "root.b") }, [2] = go("a", "c", "e_x") },
      property = precedes("root.c", "root.b"),
      verdict = "p: holds (one event a step)" },
    { name = "until_, by a doo", members = { a = state { doo = yes },
      [2] = go("a", "b", "e_done") }, property = until_("root.a", "root.b"),
      verdict = "p: holds (one event a step; doos free; doos end)" },
    { name = "until_, and another state comes", members = C,
      property = until_("root.a", "root.b"),
      verdict = lines(VIOLATED .. "  1. no event: root.trans[1] -> root.a",
        "  2. e_c: root.trans[4] -> root.c") },
    { name = "until_, and it never comes", property = until_("root.a", "root.b"),
      verdict = lines(VIOLATED .. "  1. no event: root.trans[1] -> root.a",
        "  and nothing more has to come") },
  }
  for _, case in ipairs(CASES) do
    it("is " .. case.name, function()
      local text = verdict(chart(case.members), case.property,
        { together = case.together or 1 })
      if case.is_violated then
        assert.matches("^p: does not hold", text)
      else
        assert.equal(case.verdict, text)
      end
    end)
  end

  it("is not known behind a bound", function()
    assert.equal("p: not known", verdict(chart(C), after "e_c".leads_to "root.b",
      { configurations = 2 }))
  end)

  it("may be given twice, without names: one finding", function()
    local never = rfsm_checks.never
    local result = rfsm_checks.explore(chart {}, {
      properties = { never "root.b", never "root.b" } })
    assert.equal(1, #result.findings)
    assert.equal("never root.b", result.findings[1].place)
    assert.is_false(result.properties[1].holds)
    assert.is_false(result.properties[2].holds)
  end)

  it("has a text", function()
    assert.equal("after e_x leads to root.a", tostring(after "e_x".leads_to "root.a"))
    assert.equal("after e_x never root.a", tostring(after "e_x".never "root.a"))
    assert.equal("root.a precedes a function", tostring(precedes("root.a", yes)))
    assert.equal("root.a until root.b and lit",
      tostring(until_("root.a", { "root.b", "lit" })))
  end)

  it("refuses what is no condition, and other names", function()
    local CASES_OF_ERRORS = {
      { f = function() return after "e_x".lead_to("root.a") end,
        text = "rfsm_checks.after(...): no 'lead_to' (did you mean 'leads_to'?), "
          .. "expected: leads_to, never, reach" },
      { f = function() return from "root.a".left_with(2) end,
        text = "rfsm_checks.from(...): no 'left_with' (did you mean 'left_within'?), "
          .. "expected: after, can_reach, left_within, stays" },
      { f = function() return from "root.a".reach "root.b" end,
        text = "rfsm_checks.from(...): no 'reach', "
          .. "expected: after, can_reach, left_within, stays" },
      { f = function() return (precedes("root.a")) end,
        text = "rfsm_checks.precedes: path of a state, name of a flag, list of them or "
          .. "function expected, got nil" },
      { f = function() return (until_("root.a", 7)) end,
        text = "rfsm_checks.until_: path of a state, name of a flag, list of them or "
          .. "function expected, got number" },
      { f = function() return (until_(nil, "root.a")) end,
        text = "rfsm_checks.until_: path of a state, name of a flag, list of them or "
          .. "function expected, got nil" },
    }
    for _, case in ipairs(CASES_OF_ERRORS) do
      local ok, text = pcall(case.f)
      assert.is_false(ok)
      assert.equal(case.text, (text:gsub("^[^\n]*property_spec.lua:%d+: ", "")))
    end
  end)
end)

describe("a machine that is watched", function()
  local fsm, told

  local function start(members, given)
    told = {}
    members.err = function(text) told[#told + 1] = text end
    fsm = rfsm.init(chart(members))
    local watched = rfsm_checks.watch_properties(fsm, given)
    rfsm.run(fsm)
    return watched
  end

  local function send(...)
    rfsm.send_events(fsm, ...)
    rfsm.run(fsm)
  end

  it("reports a violation with the latest steps, once", function()
    start({}, { ["not in b"] = rfsm_checks.never "root.b" })
    assert.same({}, told)
    send("e_x")
    rfsm.step(fsm)
    assert.same({ lines("property 'not in b' does not hold",
      "  1. e_init_fsm: root.a", "  2. e_x: root.a -> root.b") }, told)
    send("e_x")
    send("e_x")
    assert.equal(2, #told)
  end)

  local C = { c = state {}, [4] = go("a", "c", "e_c"), [5] = go("c", "b", "e_done",
    { guard = function() return false end }) }
  local CASES = {
    { name = "always", property = rfsm_checks.always "root.a", events = { "e_x" } },
    { name = "after, reach", property = after "e_c".reach "root.b",
      events = { "e_c" } },
    { name = "after, leads_to", property = after "e_c".leads_to "root.b",
      events = { "e_c" } },
    { name = "after, never", property = after "e_x".never "root.a",
      events = { "e_x", "e_x" } },
    { name = "precedes", property = precedes("root.b", "root.c"), events = { "e_c" } },
    { name = "until_", property = until_("root.b", "root.c"), events = {} },
  }
  for _, case in ipairs(CASES) do
    it("reports " .. case.name, function()
      local members = {}
      for key, value in pairs(C) do members[key] = value end
      start(members, { p = case.property })
      for _, event in ipairs(case.events) do send(event) end
      assert.equal("property 'p' does not hold\n", (told[1] or ""):match("^[^\n]*\n"))
      assert.equal(1, #told)
    end)
  end

  it("sees a composite that a step passes, as an exploration does", function()
    local members = { c = state { k = rfsm.conn {} }, d = state {},
      [4] = go("a", "root.c.k", "e_c"), [5] = go("root.c.k", "d"), [6] = go("d", "a") }
    local properties = { left = rfsm_checks.never { "root.a", "root.c" },
      passed = rfsm_checks.never "root.c", before = precedes("root.c", "root.d"),
      after = after "e_c".reach "root.c" }
    start(members, properties)
    send("e_c")
    local names = {}
    for i, text in ipairs(told) do names[i] = text:match("^property '(%l+)'") end
    assert.same({ "passed", "after" }, names)
    local result = rfsm_checks.explore(chart(members), { properties = properties })
    for i, holds in ipairs { false, true, true, false } do -- sorted by name
      assert.equal(holds, result.properties[i].holds)
    end
  end)

  it("takes the properties of its model, and watches until it is told to stop",
    function()
    start({ properties = { rfsm_checks.never "root.b" } }):stop()
    send("e_x")
    assert.same({}, told)
  end)

  it("has its own effects, and when that is over its own hooks", function()
    local effect = function() end
    local machine = rfsm.init(chart { properties = { rfsm_checks.never "root.b" },
      c = state { k = rfsm.conn {} }, [4] = go("a", "root.c.k", "e_c"),
      [5] = go("root.c.k", "b"), p = rfsm.seqand { r = chart() },
      [6] = go("p", "internal", "e_i", { effect = effect }) })
    local before = watching.hooks_of(machine)
    local one = rfsm_checks.watch_properties(machine)
    local other = rfsm_checks.watch_properties(machine)
    assert.equal(effect, machine[6].effect)
    one:stop()
    assert.not_equal(before, watching.hooks_of(machine))
    other:stop()
    assert.equal(before, watching.hooks_of(machine))
    one:stop() -- again: nothing is left to be done
    for _, case in ipairs {
      { property = rfsm_checks.never "root.b", looks = true },
      { property = rfsm_checks.after("e_c").never "root.b", looks = true },
      { property = rfsm_checks.precedes("root.c", "root.b"), looks = true },
      { property = rfsm_checks.always "root.b", looks = false },
      { property = rfsm_checks.after("e_c").reach "root.b", looks = false },
    } do -- at states that a step passes
      local watched = rfsm_checks.watch_properties(machine, { case.property })
      local hooks = machine._entry_hooks and machine._entry_hooks[machine] or false
      assert.equal(case.looks, hooks ~= false, tostring(case.property))
      watched:stop()
    end
  end)

  it("does what it would do", function()
    assert.is_nil(share.problem(watching, 30, true))
  end)

  it("is not reported for what may have happened before the watch", function()
    local now, given = 0, { rfsm_checks.precedes("root.a", "root.b"),
      rfsm_checks.precedes("e_c", "e_x"), rfsm_checks.until_("root.c", "root.a"),
      rfsm_checks.always("root.c").unless "root.a", from "root.a".stays(5) }
    local members = { gettime = function() return now, 0 end }
    for key, value in pairs(C) do members[key] = value end
    start(members, {})
    local snap = snapshot.take(fsm)
    now = 9
    send("e_x")
    send("e_x")
    rfsm_checks.watch_properties(fsm, given)
    send("e_x")
    assert.same({}, told)
    start(members, given)
    told = {}
    assert(snapshot.put(fsm, snap))
    send("e_x")
    assert.same({}, told)
    send("e_x")
    send("e_x")
    assert.equal("property 'from root.a stays 5 s' does not hold",
      (told[1] or ""):match("^[^\n]*"))
    assert.equal(1, #told)
  end)

  it("may do what it owes if its clock fails: a timer may be armed", function()
    local is_broken = false
    start({ gettime = function()
      if is_broken then error("no time") end
      return 0, 0
    end, c = state {}, [4] = go("a", "c", "e_c"), [5] = go("c", "b", "e_after(9)") },
      { p = after "e_c".leads_to "root.b" })
    send("e_c")
    is_broken = true
    rfsm.run(fsm)
    assert.is_nil(table.concat(told, "\n"):match("property.*"))
  end)

  it("misses no step that an interrupt cuts short in its own hook", function()
    assert.is_nil(share.problem(require "spec.support.claims.watched_cuts", 30, true))
  end)

  it("owes nothing any more when what was waited for has come", function()
    local function wait() while true do rfsm.yield(true) end end
    start({ a = state { doo = wait }, c = state {}, [3] = go("b", "c", "e_x") },
      { p = until_("root.a", "root.b") })
    send("e_x")
    send("e_x")
    assert.equal("root.c", rfsm.get_actleaf_fqn(fsm))
    assert.same({}, told)
  end)

  it("looks at a state without regions before more events come in a step", function()
    local lists = {}
    start({ getevents = function() return table.remove(lists, 1) or {} end },
      { p = after "e_y".reach "root.a" })
    lists = { { "e_y" }, { "e_x" } }
    rfsm.step(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    rfsm.run(fsm)
    assert.same({}, told)
  end)

  it("reports once what can be violated once", function()
    start({ c = state {}, [4] = go("b", "c", "e_c") },
      { precedes("root.c", "root.b") })
    for _ = 1, 3 do send("e_x") end
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    assert.equal(1, #told)
  end)

  it("reports the ten latest steps", function()
    start({ c = state {}, [4] = go("b", "c", "e_c") }, { rfsm_checks.never "root.c" })
    for _ = 1, 11 do send("e_x") end
    send("e_c")
    local _, count = told[1]:gsub("\n  %d+%. e_[xc]: ", "")
    assert.same({ 1, 10 }, { #told, count })
  end)

  it("begins anew when the machine is reset", function()
    start({ [4] = go("a", "internal", "e_r", { effect = rfsm.reset }) },
      { rfsm_checks.never "root.b" })
    send("e_r")
    send("e_x")
    assert.same({ lines("property 'never root.b' does not hold",
      "  1. e_init_fsm: root.a", "  2. e_x: root.a -> root.b") }, told)
  end)

  it("has the iteration in which regions get an event as a part of the same step",
    function()
    start({ p = rfsm.seqand { r = chart() }, [1] = go("initial", "p"), [2] = false,
      [3] = false }, { p = rfsm_checks.always(function(active)
        told[#told + 1] = active "root.p.r.b" and "b" or "a"
        return true
      end) })
    told = {}
    send("e_x")
    assert.same({ "b" }, told)
  end)

  it("has the next deadline of the property whose time is over first", function()
    local watched = start({ gettime = function() return 0, 0 end },
      { from "root.b".left_within(7), from "root.b".left_within(2),
        from "root.b".left_within(9) })
    assert.is_nil(watched:next_deadline())
    send("e_x")
    assert.equal(2, watched:next_deadline())
  end)

  it("tells of short times between the steps", function()
    local now = 0
    start({ gettime = function() return math.floor(now), now % 1 * 1e9 end },
      { p = from "root.b".left_within(0.5) })
    now = 0.25
    send("e_x")
    now = 1
    rfsm.run(fsm)
    assert.same({ lines("property 'p' does not hold", "  1. e_init_fsm: root.a",
      "  2. +0.25 s e_x: root.a -> root.b", "  and then 0.75 s") }, told)
  end)

  it("does not owe what comes by a timer, until that has expired", function()
    local now = 0
    start({ gettime = function() return now, 0 end, [2] = go("a", "b", "e_after(3)"),
      [4] = go("a", "a", "e_y") }, { after "e_y".leads_to "root.b",
      after "e_y".leads_to(function() end) })
    send("e_y")
    assert.same({}, told)
    now = 4
    rfsm.run(fsm)
    assert.equal(1, #told)
  end)

  it("has a name without an address, whatever its event is", function()
    for text, event in pairs { -- any order: each stands alone
      e_paid = { name = "e_paid" }, ["a table"] = { 7 }, ["a function"] = print,
      ["an object"] = setmetatable({}, { __tostring = function()
        return "an object"
      end }) } do
      assert.equal("after " .. text .. " reach root.b",
        tostring(after(event).reach "root.b"))
    end
  end)

  it("refuses other properties, states, flags and values", function()
    local CASES_OF_ERRORS = {
      { given = { from "root.a".can_reach "root.b" },
        text = "rfsm_checks.watch_properties: property 'from root.a can reach root.b' "
          .. "is about runs that might be: explore it" },
      { given = { rfsm_checks.never "root.bb" },
        text = "rfsm_checks.watch_properties: property 'never root.bb': no state is "
          .. "named 'root.bb' (did you mean 'root.b'?)" },
      { given = 7, text = "rfsm_checks.watch_properties: table of properties expected, "
        .. "got 7" },
      { given = { 7 }, text = "rfsm_checks.watch_properties: properties: never(...), "
        .. "after(...).reach(...) or another property expected, got number" },
    }
    for _, case in ipairs(CASES_OF_ERRORS) do
      local ok, text = pcall(rfsm_checks.watch_properties, rfsm.init(chart()),
        case.given)
      assert.is_false(ok)
      assert.equal(case.text, (text:gsub("^[^\n]*property_spec.lua:%d+: ", "")))
    end
  end)
end)
