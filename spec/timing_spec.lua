-- Timers in order: what an exploration knows of time, and properties with a time.

local ab = require "spec.support.ab"
local claim = require "spec.support.claims.timing"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local share = require "spec.support.share"
local rfsm_timeevent = require "rfsm_timeevent"
local zones = require "rfsm.explore.zones"
require "rfsm.await"
require "rfsm.defer"

local state = rfsm.state
local never, after, from = rfsm_checks.never, rfsm_checks.after, rfsm_checks.from
local chart, go = ab.chart, ab.go

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local function lines(...) return table.concat({ ... }, "\n") end

-- The report without its first line, and without files.
local function report(model, options)
  local text = helper.without_file(tostring(rfsm_checks.explore(model, options)))
  return (text:gsub("^[^\n]*\n?", ""))
end

-- The line of a property that holds, or the lines of one that does not.
local function verdict(model, property, options)
  options = options or {}
  options.properties = { p = property }
  local result = rfsm_checks.explore(model, options)
  local judged = result.properties[1]
  if judged.holds ~= false then
    return (tostring(result):match("\n(p: [^\n]*)"))
  end
  return lines("p", unpack(require("rfsm.explore.verdict").lines_of(judged.witness)))
end

local PREMISE = "one event a step; stepped between any two deadlines; "
  .. "steps take no time"
local HOLDS = "p: holds (" .. PREMISE .. ")"

local ENTRY = "1. no event: root.trans[1] -> root.a"

describe("timers of many days", function()
  -- a goes to b after some seconds, and to bad after more.
  local function model(seconds, more, nothing)
    return chart { bad = state {}, [2] = go("a", "b", ("e_after(%s)"):format(seconds)),
      [4] = go("a", "bad", ("e_after(%s)"):format(more)),
      [5] = nothing and go("b", "a", ("e_after(%s)"):format(nothing)) }
  end

  it("are in order up to 104 days", function()
    assert.equal("p: holds (" .. PREMISE .. ")",
      verdict(model("1209600", "9000000"), never "root.bad"))
    assert.equal(lines("p", "1. no event: root.trans[1] -> root.a", "2. +1209600 s, "
      .. "e_after(1209600)@root.a: root.trans[4] -> root.bad"),
      verdict(model("9000000", "1209600"), never "root.bad"))
  end)

  it("are free beyond that, which the premises say", function()
    assert.equal("p: holds (one event a step; timers free)",
      verdict(model("9100000", "9200000"), rfsm_checks.always "root"))
  end)

  it("are not known beside such of nanoseconds", function()
    assert.equal("p: not known",
      verdict(model("1209600", "9000000", "0.000000001"), never "root.bad"))
  end)
end)

describe("timers of active states", function()
  it("expire in the order of their deadlines", function()
    local function race(first, second)
      return chart { c = state {}, [2] = go("a", "b", first),
        [4] = go("a", "c", second), [5] = go("c", "a", "e_x") }
    end
    assert.equal("warning: root.c: active in no configuration (e_after(5)@root.a "
      .. "never comes) [unreachable]", report(race("e_after(1)", "e_after(5)")))
    assert.equal("", report(race("e_after(5)", "e_after(1)"),
      { timers = "free" }))
    assert.equal("", report(race("e_after(1)", "e_at(5)")))
    assert.equal("", report(race("e_after(1)",
      { rfsm_timeevent.e_after(function() return 5 end) })))
  end)

  it("of one state come one after the other, also with a period", function()
    local model = chart { [2] = go("a", "internal", "e_after(1)"),
      [4] = go("a", "b", "e_after(3)") }
    for seconds, holds in pairs { [3.2] = true, [2.9] = false } do -- any order
      local result = rfsm_checks.explore(model, { period = 0.1,
        properties = { from "root.a".left_within(seconds) } })
      assert.equal(holds, result.properties[1].holds)
    end
  end)

  it("are not waited for while an event waits, if there is a period", function()
    local model = chart { chain = state { c = state {}, d = state {}, e = state {},
      go("initial", "c"), go("c", "d", "e_done"), go("d", "e", "e_done") },
      [2] = go("a", "chain", "e_x"), [4] = go("root.chain.e", "b", "e_done") }
    for seconds, holds in pairs { [0.35] = true, [0.15] = false } do -- any order
      local result = rfsm_checks.explore(model, { period = 0.1,
        properties = { from "root.chain".left_within(seconds) } })
      assert.equal(holds, result.properties[1].holds)
    end
  end)

  it("of a composite and of a state in it run side by side", function()
    local function nested(outer, inner)
      return chart { [4] = go("c", "b", outer), [2] = go("a", "c", "e_x"),
        c = state { x = state {}, y = state {}, go("initial", "x"),
          go("x", "y", inner) } }
    end
    assert.equal("warning: root.c.y: active in no configuration (e_after(2)@root.c.x "
      .. "never comes) [unreachable]", report(nested("e_after(1)", "e_after(2)")))
    assert.equal("", report(nested("e_after(2)", "e_after(1)")))
    -- at the same time the composite is first
    assert.equal("warning: root.c.y: active in no configuration [unreachable]",
      report(nested("e_after(1)", "e_after(1)")))
    local model = nested("e_after(1)", "e_after(2)")
    model.c[3] = go("x", "y", "e_y")
    assert.equal("warning: root.c.trans[2]: no step takes it (root.c.x -> root.c.y) "
      .. "(e_after(2)@root.c.x never comes) [shadowed]", report(model))
  end)

  it("come once, until their state is entered again", function()
    local model = chart { [2] = go("a", "b", "e_x"),
      [4] = go("a", "internal", "e_after(2)") }
    local twice = rfsm_checks.at_most(1, "e_after(2)@root.a").within(2)
    assert.equal(HOLDS, verdict(model, twice))
    assert.equal(lines("p", ENTRY,
      "2. +2.001 s, e_x, e_after(2)@root.a: root.trans[2] -> root.b",
      "3. e_x: root.trans[3] -> root.a",
      "4. +2.001 s, e_after(2)@root.a: root.trans[4] -> root.a"),
      verdict(model, rfsm_checks.at_most(1, "e_after(2)@root.a").within(3)))
  end)

  it("expire together, if their deadlines are less than a period apart", function()
    local function model()
      return chart { c = state {}, [2] = go("a", "b", "e_after(1)"),
        [4] = go("a", "c", "e_after(1.5)", { pn = 1 }), [5] = go("c", "a", "e_x") }
    end
    assert.equal(HOLDS, verdict(model(), never "root.c"))
    assert.equal("p: holds (one event a step; stepped every 0.5 s; steps take no time)",
      verdict(model(), never "root.c", { period = 0.5 }))
    assert.equal(lines("p", ENTRY, "2. +1.501 s, e_after(1)@root.a, "
      .. "e_after(1.5)@root.a: root.trans[4] -> root.c"),
      verdict(model(), never "root.c", { period = 0.6 }))
  end)

  it("of regions run side by side", function()
    local function arm(seconds)
      return state { warn = false, info = false, x = state {}, y = state {},
        go("initial", "x"), go("x", "y", ("e_after(%d)"):format(seconds)) }
    end
    local model = chart { b = rfsm.seqand { left = arm(1), right = arm(2) } }
    assert.equal(HOLDS, verdict(model, never { "root.b.left.x", "root.b.right.y" }))
    assert.equal("p", verdict(model, never { "root.b.left.y", "root.b.right.x" })
      :match("^[^\n]*"))
  end)

  it("in an await are over before it is complete", function()
    local model = chart { c = state {}, [2] = go("a", "b", "await(e_p, e_after(3))"),
      [4] = go("a", "c", "e_after(2)"), [5] = go("c", "a", "e_x") }
    assert.equal(HOLDS, verdict(model, never "root.b"))
  end)

  it("tell that a way is there, if one timer alone can be first", function()
    assert.equal(HOLDS, verdict(chart { [2] = go("a", "b", "e_after(1)") },
      from("root.a").can_reach "root.b"))
  end)

  it("do not tell whether a way is there at all times", function()
    local model = chart { c = state { x = state {}, y = state {}, z = state {},
      go("initial", "x"), go("x", "y", "e_y"), go("y", "z", "e_after(2)") },
      [2] = go("a", "c", "e_x"), [4] = go("c", "b", "e_after(3)"),
      [3] = go("b", "b", "e_x") }
    local function way(name) return from("root.c.y").can_reach(name) end
    assert.equal("p: not known, it depends on when timers expire",
      verdict(model, way "root.c.z"))
    assert.equal(HOLDS, verdict(model, way "root.b"))
  end)
end)

describe("a property with a time", function()
  local function alarm(seconds, members)
    local all = { [2] = go("a", "b", "e_x"), [3] = go("b", "a",
      ("e_after(%s)"):format(seconds)) }
    for key, value in pairs(members or {}) do all[key] = value end
    return chart(all)
  end

  local CASES = {
    { name = "reach within, in time", model = alarm(2),
      property = after "e_x".reach "root.a".within(2),
      verdict = "p: holds (two events a step;" .. PREMISE:match(";(.*)") .. ")" },
    { name = "reach within, too late", model = alarm(2),
      property = after "e_x".reach "root.a".within(1.5),
      verdict = lines("p", ENTRY, "2. e_x: root.trans[2] -> root.b",
        "3. +1.501 s, no event: no transition -> root.b") },
    { name = "reach within, too late by a period", model = alarm(2), period = 0.1,
      property = from "root.b".left_within(1.95),
      verdict = lines("p", ENTRY, "2. e_x: root.trans[2] -> root.b",
        "3. +1.951 s, no event: no transition -> root.b") },
    { name = "left_within, in time", model = alarm(2),
      property = from "root.b".left_within(2), verdict = HOLDS },
    { name = "left_within, with a period", model = alarm(2), period = 0.1,
      property = from "root.b".left_within(2.1),
      verdict = "p: holds (one event a step; stepped every 0.1 s; steps take no time)"
    },
    { name = "left_within, too late", model = alarm(2, { [4] = go("b", "b", "e_y") }),
      property = from "root.b".left_within(2),
      verdict = lines("p", ENTRY, "2. e_x: root.trans[2] -> root.b",
        "3. +0.001 s, e_y: root.trans[4] -> root.b",
        "4. +2 s, no event: no transition -> root.b") },
    { name = "stays, long enough", model = alarm(2), property = from "root.b".stays(2),
      verdict = HOLDS },
    { name = "stays, too short", model = alarm(2), property = from "root.b".stays(2.5),
      verdict = lines("p", ENTRY, "2. e_x: root.trans[2] -> root.b",
        "3. +2.001 s, e_after(2)@root.b: root.trans[3] -> root.a") },
    { name = "at_least, by a timer", model = chart { [2] = go("a", "a", "e_after(1)"),
      [3] = go("a", "b", "e_never", { guard = function() end }) },
      property = rfsm_checks.at_least(2, "e_after(1)@root.a").within(2),
      alphabet = {}, verdict = lines("p", ENTRY,
        "2. +1.001 s, e_after(1)@root.a: root.trans[2] -> root.a",
        "3. +1 s, no event: no transition -> root.a") },
    { name = "at_least, by a timer in a period", model = chart { [2] = go("a", "a",
      "e_after(1)"), [3] = go("b", "a", "e_x") }, period = 0.2,
      property = rfsm_checks.at_least(2, "e_after(1)@root.a").within(2.5),
      verdict = "p: holds (one event a step; stepped every 0.2 s; steps take no time)"
    },
    { name = "leads_to, by the timer of a composite", model = chart {
      c = state { x = state {}, y = state {}, go("initial", "x"), go("x", "y", "e_y"),
        go("y", "x", "e_y") }, [2] = go("a", "c", "e_x"), [3] = go("c", "b",
        "e_after(9)"), [4] = go("b", "b", "e_x") },
      property = after "e_x".leads_to "root.b", together = 1,
      verdict = "p: holds (" .. PREMISE .. "; doos end)" },
    { name = "leads_to, if events come too early for a timer", model = alarm(2,
      { [4] = go("b", "b", "e_y") }), property = after "e_x".leads_to "root.a",
      together = 1, verdict = lines("p", ENTRY, "2. e_x: root.trans[2] -> root.b",
        "3. e_y: root.trans[4] -> root.b", "and again from 3 on") },
  }
  for _, case in ipairs(CASES) do
    it("is " .. case.name, function()
      local text = verdict(case.model, case.property, { period = case.period,
        together = case.together, alphabet = case.alphabet })
      assert.equal(case.verdict, text)
    end)
  end

  it("has times that rise", function()
    local result = rfsm_checks.explore(chart { c = state {},
      [2] = go("a", "b", "e_after(3)"), [3] = go("b", "c", "e_x") },
      { properties = { p = never "root.c" } })
    local times = {}
    for i, step in ipairs(result.properties[1].witness) do times[i] = step.at end
    assert.same({ 0, 3.001, 3.001 }, times)
  end)

  it("replays as a recording, with its times", function()
    local model = alarm(2)
    local result = rfsm_checks.explore(model,
      { properties = { from "root.b".stays(2.5) } })
    local records = {}
    rfsm_checks.record_witness(model, result.properties[1].witness, records)
    local fsm = assert(require("rfsm.record").replay(model, records, { dry = true }))
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
  end)

  it("refuses what is no time, number or option", function()
    local seconds = ": seconds above 0 and up to 1000000 expected, got "
    local CASES_OF_ERRORS = {
      { f = function() return (after "e".reach "root".within(0)) end,
        text = "rfsm_checks.after(...).reach(...).within" .. seconds .. "0" },
      { f = function() return (from "root".left_within()) end,
        text = "rfsm_checks.from(...).left_within" .. seconds .. "nil" },
      { f = function() return (from "root".stays "2") end,
        text = "rfsm_checks.from(...).stays" .. seconds .. "string '2'" },
      { f = function() return (rfsm_checks.at_most(0, "e")) end,
        text = "rfsm_checks.at_most: whole number from 1 to 100 expected, got 0" },
      { f = function() return (rfsm_checks.at_least(1)) end,
        text = "rfsm_checks.at_least: event expected, got nil" },
      { f = function() return (rfsm_checks.at_most(1, "e").inside(2)) end,
        text = "rfsm_checks.at_most(...): no 'inside', expected: within" },
      { f = function() return (rfsm_checks.explore(chart(), { period = 0 })) end,
        text = "rfsm_checks.explore: period: seconds above 0 expected, got 0" },
      { f = function() return (rfsm_checks.explore(chart(), { timers = "fre" })) end,
        text = "rfsm_checks.explore: timers: 'free' or 'in order' expected, got 'fre' "
          .. "(did you mean 'free'?)" },
      { f = function() return (rfsm_checks.explore(chart(), { timers = 1 })) end,
        text = "rfsm_checks.explore: timers: 'free' or 'in order' expected, got 1" },
    }
    for _, case in ipairs(CASES_OF_ERRORS) do
      local ok, text = pcall(case.f)
      assert.is_false(ok)
      assert.equal(case.text, (text:gsub("^[^\n]*timing_spec.lua:%d+: ", "")))
    end
    assert.equal("from root.a left within 2.5 s",
      tostring(from "root.a".left_within(2.5)))
    assert.equal("at most 2 e_x within 3 s",
      tostring(rfsm_checks.at_most(2, "e_x").within(3)))
  end)
end)

-- Small models of textbooks on timed automata, as charts. A timer of a chart comes
-- after its time, and not at it, so the train and its gate need a period and room.
-- tchecker has the same verdicts, of automata whose timers come in the period behind
-- their time: tck-reach, and tck-liveness for leads_to, with beats 0.1 s apart.
describe("a textbook model", function()
  local function silent(members)
    members.warn, members.info = false, false
    return state(members)
  end

  -- Two quick clicks for bright light (the lamp of the UPPAAL tutorial).
  local function lamp()
    return silent { off = state {}, bright = state {},
      low = state { quick = state {}, slow = state {}, go("initial", "quick"),
        go("quick", "slow", "e_after(5)") },
      go("initial", "off"), go("off", "low", "e_press"),
      go("root.low.quick", "bright", "e_press", { pn = 1 }),
      go("root.low.slow", "off", "e_press"), go("bright", "off", "e_press") }
  end

  -- The train needs `near` seconds at least and 5 at most; the controller waits for a
  -- second, and the gate moves for one (the crossing of Alur and Dill, one passage).
  local function crossing(near)
    local train = silent { away = state {}, far = state {}, close = state {},
      inside = state {}, gone = state { final = true }, go("initial", "away"),
      go("away", "far", "e_approach"),
      go("far", "close", ("e_after(%g)"):format(near)),
      go("close", "inside", { "e_in", ("e_after(%g)"):format(5 - near) }),
      go("inside", "gone", "e_out") }
    local gate = silent { up = state {}, waiting = state {}, lowering = state {},
      down = state { final = true }, go("initial", "up"),
      go("up", "waiting", "e_approach"), go("waiting", "lowering", "e_after(1)"),
      go("lowering", "down", "e_after(1)") }
    return silent { both = rfsm.seqand { train = train, gate = gate },
      go("initial", "both") }
  end

  local function is_safe(active)
    return not active "root.both.train.inside" or active "root.both.gate.down"
  end

  local function is_down(active)
    return active "root.both.gate.up" or active "root.both.gate.down"
  end

  -- A heartbeat with a timeout, and what a beat leads to.
  local function heart(tgt, pn)
    return silent { alive = state {}, dead = state { final = true },
      last = state {}, go("initial", "alive"), go("alive", tgt, "e_beat"),
      go("alive", "dead", "e_after(1.5)", { pn = pn }),
      go("last", "dead", "e_after(1.5)") }
  end

  local always = rfsm_checks.always
  local CASES = {
    { name = "the lamp becomes bright", model = lamp(), holds = true,
      property = from "root.off".can_reach "root.bright" },
    { name = "bright light needs a quick click", model = lamp(), holds = true,
      property = rfsm_checks.precedes("root.low.quick", "root.bright") },
    { name = "a click is quick for 5 s", model = lamp(), holds = true,
      property = from "root.low.quick".left_within(5) },
    { name = "low light ends some time", model = lamp(), holds = false,
      property = from "root.low".left_within(60) },
    { name = "the gate is down while a train is inside", model = crossing(3),
      period = 0.1, property = always(is_safe), holds = true },
    { name = "a train that comes in 2 s is too quick", model = crossing(2),
      period = 0.1, property = always(is_safe), holds = false },
    { name = "the gate moves for 2.2 s at most", model = crossing(3), period = 0.1,
      property = from(function(active) return not is_down(active)
        and active "root.both" end).left_within(2.2), holds = true },
    { name = "the gate moves for 2 s at most", model = crossing(3), period = 0.1,
      property = from(function(active) return not is_down(active)
        and active "root.both" end).left_within(2), holds = false },
    { name = "a heart without a beat is alive for 1.5 s", model = heart "alive",
      holds = true, property = from "root.alive".stays(1.5) },
    { name = "and no longer, if it beats", model = heart "alive", holds = false,
      property = from "root.alive".left_within(1.5) },
    { name = "a heart that beats dies", model = heart "alive", holds = false,
      property = after "e_beat".leads_to "root.dead" },
    { name = "a heart that beats once dies", model = heart "last", holds = true,
      property = after "e_beat".leads_to "root.dead" },
    { name = "a heart dies if its timeout does not count from the beat",
      model = heart("internal", 1), holds = true,
      property = after "e_beat".leads_to "root.dead" },
    { name = "it does if a beat may come before the timeout in a step",
      model = heart "internal", holds = false,
      property = after "e_beat".leads_to "root.dead" },
  }
  for _, case in ipairs(CASES) do
    it("has it that " .. case.name .. (case.holds and "" or ": no"), function()
      local result = rfsm_checks.explore(case.model, { properties = { case.property },
        period = case.period })
      assert.equal(case.holds, result.properties[1].holds)
    end)
  end
end)

describe("bounds of clocks", function()
  it("add up to one that is strict if one of them is", function()
    local at_most, below = zones.at_most, zones.below
    for _, case in ipairs { { at_most(2), at_most(5) }, { below(2), below(5) } } do
      local zone = zones.up(zones.project(zones.new(), 0, { 0, 0 }), 2)
      zone = zones.bounded(zone, 2, 1, 0, at_most(3)) -- both began at once
      assert.same({ at_most(0), at_most(0), at_most(0), at_most(3), at_most(0),
        at_most(0), at_most(3), at_most(0), at_most(0) }, zone)
      zone = zones.project(zone, 2, { 1, 0 })
      zone = zones.bounded(zones.up(zone, 2), 2, 2, 0, case[1]) -- so long ago at most
      assert.equal(case[2], zone[4])
    end
  end)
end)

describe("a watched machine", function()
  it("reports what comes too late, on its clock", function()
    local now, told = 100, {}
    local fsm = rfsm.init(chart { err = function(text) told[#told + 1] = text end,
      gettime = function() return now, 0 end })
    local watched = rfsm_checks.watch_properties(fsm, {
      quick = from "root.b".left_within(2) })
    rfsm.run(fsm)
    assert.is_nil(watched:next_deadline())
    rfsm.send_events(fsm, "e_x")
    rfsm.run(fsm)
    assert.equal(2, watched:next_deadline())
    now = 102
    rfsm.run(fsm)
    assert.same({}, told)
    now = 102.5
    rfsm.run(fsm)
    rfsm.run(fsm)
    assert.equal(1, #told)
    assert.matches("\n  2. e_x: root.a %-> root.b\n", told[1])
    assert.matches("\n  and then %+?2.5 s$", told[1])
    now = 105
    rfsm.run(fsm)
    assert.equal(2, #told) -- it has stayed there again
    rfsm.reset(fsm)
    assert.is_nil(watched:next_deadline())
  end)
end)

describe("an event that is sent later, by sends,", function()
  -- a goes to b after 3 s and to c with e_x, c to a with e_back.
  local function model(members)
    members = members or {}
    members.c = members.c or state {}
    members[2], members[3] = go("a", "b", "e_after(3)"), go("a", "c", "e_x")
    members[4] = go("c", "a", "e_back")
    return chart(members)
  end

  local function later(seconds, members)
    local options = { alphabet = { "e_back" },
      sends = { ["entry root.a"] = { { "e_x", after = seconds } } } }
    for key, value in pairs(members or {}) do options[key] = value end -- any order
    return options
  end

  local ALPHABET = "one event a step; no event outside of the alphabet; "
  local COMES = "2. +2.001 s, after 2 s: e_x: root.trans[3] -> root.c"
  local TIMED = ALPHABET .. "stepped between any two deadlines; steps take no time"

  it("comes in order with timers", function()
    local holds = "p: holds (" .. TIMED .. ")"
    assert.equal(holds, verdict(model(), never "root.b", later(2)))
    assert.equal(lines("p", ENTRY, COMES), verdict(model(), never "root.c", later(2)))
    assert.equal(holds, verdict(model(), never "root.c", later(4)))
  end)

  it("has to come, and ends what properties give a time", function()
    assert.equal("p: holds (" .. TIMED .. ")",
      verdict(model(), from("root.a").left_within(2.5), later(2)))
    assert.equal("p: holds (" .. TIMED .. "; doos end)",
      verdict(model(), rfsm_checks.until_("root.a", "root.c"), later(2)))
    assert.equal(lines("p", ENTRY, "2. +1.501 s, no event: no transition -> root.a"),
      verdict(model(), from("root.a").left_within(1.5), later(2)))
  end)

  it("comes to whatever state is active, as often as it is sent", function()
    local own = model { [5] = go("c", "bad", "e_x"), bad = state {} }
    local options = later(2)
    options.sends["entry root.a"][2] = { "e_x", after = 2.5 }
    assert.equal(lines("p", ENTRY, COMES,
      "3. +0.5 s, after 2.5 s: e_x: root.trans[5] -> root.bad"),
      verdict(own, never "root.bad", options))
  end)

  it("is dropped by a reset", function()
    local region = state { d = state {}, e = state {}, go("initial", "d"),
      go("d", "e", "e_y") }
    local own = chart { par = rfsm.seqand { region }, [2] = go("a", "par", "e_go"),
      [3] = go("par", "a", "e_after(1)") }
    local function options(seconds)
      return { alphabet = { "e_go" },
        sends = { ["entry root.par.1.d"] = { { "e_y", after = seconds } } } }
    end
    assert.equal("p: holds (" .. TIMED .. ")",
      verdict(own, never "root.par.1.e", options(1.5)))
    assert.equal(lines("p", ENTRY,
      "2. e_go: root.trans[2], root.par.1.trans[1] -> root.par",
      "3. +0.501 s, after 0.5 s: e_y in root.par.1: root.par.1.trans[2] -> root.par"),
      verdict(own, never "root.par.1.e", options(0.5)))
  end)

  it("is cancelled where sends says so", function()
    local options = later(2, { alphabet = { "e_back", "e_x" } })
    local own = model { [5] = go("c", "bad", "e_late"), bad = state {} }
    options.sends["entry root.a"][1][1] = "e_late"
    assert.equal(lines("p", ENTRY, "2. e_x: root.trans[3] -> root.c",
      "3. +2.001 s, after 2 s: e_late: root.trans[5] -> root.bad"),
      verdict(own, never "root.bad", options))
    options.sends["effect root.trans[3]"] = { { cancel = "e_late" } }
    assert.equal("p: holds (" .. TIMED .. ")", verdict(own, never "root.bad", options))
    options.sends["effect root.trans[3]"] = nil
    own[3].effect = function(fsm) rfsm_timeevent.cancel(fsm, "late") end
    options.alphabet = { "e_x" }
    local result = rfsm_checks.explore(own, options)
    assert.equal("events that the effect root.trans[3] may cancel",
      table.concat(result.untried, "; "))
  end)

  it("may come at any time or never if timers are free", function()
    local free = { timers = "free" }
    assert.equal(lines("p", ENTRY, "2. after 4 s: e_x: root.trans[3] -> root.c"),
      verdict(model(), never "root.c", later(4, free)))
    assert.equal(lines("p", ENTRY, "2. e_after(3)@root.a: root.trans[2] -> root.b"),
      verdict(model(), never "root.b", later(2, free)))
    assert.equal("p: not known, sends with a delay are free",
      verdict(model(), from("root.a").can_reach "root.c", later(2, free)))
    local own = chart { [2] = go("a", "b", "e_x") }
    assert.equal("p: holds (" .. ALPHABET .. "sends with a delay free)",
      verdict(own, never { "root.a", "root.b" }, later(2, { timers = "free",
        alphabet = {} })))
    assert.equal(lines("p", ENTRY, "and nothing more has to come"),
      verdict(own, rfsm_checks.until_("root.a", "root.b"), later(2, { timers = "free",
        alphabet = {} })))
  end)

  it("does not hold up what the machine does by itself if timers are free", function()
    assert.equal("p: holds (two events a step; no event outside of the alphabet; "
      .. "sends with a delay free)", verdict(chart { c = state {}, [3] = go("b", "c") },
      after("e_x").reach "root.c", later(2, { timers = "free", alphabet = { "e_x" },
        sends = { ["entry root.a"] = { { "e_y", after = 2 } } } })))
  end)

  it("is free beyond 104 days, beside timers of many days", function()
    local own = chart { [2] = go("a", "b", "e_after(1209600)"), [3] = nil }
    assert.equal("p: holds (" .. TIMED .. "; sends with a delay free)",
      verdict(own, rfsm_checks.always "root", later(1e7, { alphabet = {} })))
  end)

  it("is not followed in all orders if there are more than 200", function()
    local own = chart { [2] = go("a", "b", "e_x") }
    local options = later(2, { timers = "free", pending = 8, configurations = 9,
      alphabet = {}, properties = { p = rfsm_checks.always "root" } })
    local items = options.sends["entry root.a"]
    for i = 1, 8 do items[i] = { "e_" .. i, after = i } end
    local untried = rfsm_checks.explore(own, options).untried
    assert.equal("some orders of deadlines", untried[1])
  end)

  it("is not followed if too many wait", function()
    local own = model { [5] = go("c", "a", "e_again") }
    local options = later(2, { pending = 1, alphabet = { "e_x", "e_back" } })
    options.properties = { p = never "root.b" }
    local result = rfsm_checks.explore(own, options)
    assert.is_nil(result.properties[1].holds)
    assert.equal("pending", result.bound)
    assert.equal("more than 1 events that wait to be sent later",
      table.concat(result.untried, "; "))
    assert.equal(0, #result.findings)
  end)

  -- Does the kept e_1 always come before e_2? Items that a sends, and those of e_x.
  local function is_in_order(period, items, more)
    local own = model { a = state { defer = { "e_1", "e_2" } },
      [5] = go("b", "c", "e_1"), [6] = go("b", "bad", "e_2"), bad = state {} }
    own[3], own[4] = go("a", "internal", "e_x"), nil
    local options = { alphabet = { "e_x" }, period = period,
      sends = { ["entry root.a"] = items, ["effect root.trans[3]"] = more } }
    return verdict(own, never "root.bad", options):find("^p: holds") ~= nil
  end

  for _, period in ipairs { 4, 0 } do
    it("is kept in the order of times, then of sending, period: " .. period, function()
      period = period > 0 and period or nil
      local function item(n, seconds) return { "e_" .. n, after = seconds } end
      assert.is_true(is_in_order(period, { item(1, 1), item(2, 2) }))
      assert.is_true(is_in_order(period, { item(2, 2), item(1, 1) }))
      assert.is_true(is_in_order(period, { item(1, 1), item(2, 1) }))
      assert.is_false(is_in_order(period, { item(2, 1), item(1, 1) }))
      local again = { { cancel = "e_2" }, item(2, 1) }
      assert.is_true(is_in_order(period, { item(1, 1) }, again))
      assert.is_false(is_in_order(period, { item(1, 2) }, again))
    end)
  end

  it("may be one too many in the step that breaks a property", function()
    local own = model { [5] = go("c", "a", "e_again") }
    assert.equal(lines("p", ENTRY, "2. e_x: root.trans[3] -> root.c",
      "3. e_again: root.trans[5] -> root.a"), verdict(own, after("e_x").never "root.a",
      later(2, { pending = 1, alphabet = { "e_x", "e_again" } })))
  end)

  it("is refused with one message if it is none", function()
    for text, item in pairs { -- any order: each stands alone
      [".after: seconds, a finite number not below 0, expected, got -1"] =
        { "e_x", after = -1 },
      [".after: seconds, a finite number not below 0, expected, got nan"] =
        { "e_x", after = 0 / 0 },
      [".after: seconds, a finite number not below 0, expected, got string '2'"] =
        { "e_x", after = "2" },
      [": event expected in front of 'after', got none"] = { after = 2 },
      [": no field 'id' beside the event and 'after'"] = { "e_x", after = 2, id = 1 },
    } do
      local ok, problem = pcall(rfsm_checks.explore, model(),
        { sends = { ["entry root.a"] = { item } } })
      assert.is_false(ok)
      assert.equal("rfsm_checks.explore: sends: ['entry root.a'][1]" .. text,
        (problem:gsub("^.-(rfsm_checks)", "%1"):gsub("-nan", "nan")))
    end
  end)

  it("is not known if the text of a callback has it, and sends does not", function()
    local send = rfsm_timeevent.send_after
    local function named(fsm) rfsm_timeevent.send_after(fsm, 2, "e_x") end
    local function renamed(fsm) send(fsm, 2, "e_x") end
    for _, entry in ipairs { named, renamed } do
      local own = chart { a = state { entry = entry }, [2] = go("a", "b", "e_x") }
      local result = rfsm_checks.explore(own, { alphabet = {},
        properties = { p = never "root.b" } })
      assert.is_nil(result.properties[1].holds)
      assert.equal("events that the entry root.a may send later",
        table.concat(result.untried, "; "))
      result = rfsm_checks.explore(own, later(2, { alphabet = {},
        properties = { p = never "root.b" } }))
      assert.is_false(result.properties[1].holds)
      result = rfsm_checks.explore(own, later(2, { run = { "entry root.a" },
        alphabet = {}, properties = { p = rfsm_checks.always "root" } }))
      assert.equal("pending", result.bound)
    end
  end)

  it("may end a wait, if the exploration does not follow it", function()
    local function entry(fsm) rfsm_timeevent.send_after(fsm, 2, "e_x") end
    local function judged(property)
      local own = chart { a = state { entry = entry }, [2] = go("a", "b", "e_x") }
      return rfsm_checks.explore(own, { properties = { p = property } })
        .properties[1].holds
    end
    assert.is_nil(judged(from "root.a".left_within(2)))
    assert.is_nil(judged(rfsm_checks.until_("root.a", "root.b")))
    assert.is_false(judged(never "root.b"))
  end)
end)

describe(claim.name, function()
  it("agree on random charts", function()
    claim.runs, claim.bound = 10, 60
    assert.is_nil(share.problem(claim, 30, true))
  end)

  it("agree where deferral recalls an event in the middle of a step", function()
    local whole = dofile "spec/support/claims/timing.lua"
    assert.is_nil(select(2, whole.run(1, 2570)))
  end)
end)

describe("an e_every", function()
  -- p { t0 -e_tick-> .. t4 } ticks each second, and is left after some seconds
  local function ticking(seconds, more)
    local model = { info = false, warn = false, off = state { final = true },
      p = state { go("initial", "t0") }, go("initial", "p"),
      go("p", "internal", "e_every(1)"),
      go("p", "off", ("e_after(%g)"):format(seconds)) }
    for i = 0, 4 do
      model.p["t" .. i] = state {}
      if i > 0 then model.p[i + 1] = go("t" .. i - 1, "t" .. i, "e_tick") end
    end
    for key, value in pairs(more or {}) do model[key] = value end -- any order: a set
    return state(model)
  end

  local function said(name, seconds, options, more)
    options = options or {}
    options.sends, options.alphabet = { ["effect root.trans[2]"] = { "e_tick" } }, {}
    return verdict(ticking(seconds, more), never(name), options)
  end

  it("comes each T seconds, and not sooner", function()
    assert.equal("p: holds (one event a step; no event outside of the alphabet; "
      .. "stepped between any two deadlines; steps take no time)",
      said("root.p.t3", 2.5))
    assert.equal(lines("p",
      "1. no event: root.trans[1], root.p.trans[1] -> root.p.t0",
      "2. +1.001 s, e_every(1)@root.p: root.trans[2] -> root.p.t0",
      "3. no event: root.p.trans[2] -> root.p.t1",
      "4. +1 s, e_every(1)@root.p: root.trans[2] -> root.p.t1",
      "5. no event: root.p.trans[3] -> root.p.t2"), said("root.p.t2", 2.5))
  end)
end)
