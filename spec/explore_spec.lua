-- Exploration: what it finds, and that it agrees with random runs.

local ab = require "spec.support.ab"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local share = require "spec.support.share"
require "rfsm.await"
require "rfsm.faults"
require "rfsm.defer"
require "rfsm_timeevent"
local claim = require "spec.support.claims.explore"

local state, conn = rfsm.state, rfsm.conn
local never, always = rfsm_checks.never, rfsm_checks.always
local after, from = rfsm_checks.after, rfsm_checks.from

local chart, go = ab.chart, ab.go

local function yes() return true end

-- The report without its first line, and without files.
local function report(model, options)
  local text = helper.without_file(tostring(rfsm_checks.explore(model, options)))
  return (text:gsub("^[^\n]*\n?", ""))
end

local function lines(...) return table.concat({ ... }, "\n") end

describe("explore", function()
  it("counts configurations, transitions and steps", function()
    assert.equal("3 configurations, 3 of 3 transitions taken, 3 steps run",
      tostring(rfsm_checks.explore(chart())))
  end)

  -- A circumstance, the members of a chart, the report; options.
  local CASES = {
    { "nothing in a sound chart", {}, "" },
    { "a state that an earlier transition keeps from being reached", {
      c = state {}, [4] = go("a", "c", "e_x", { guard = yes }),
      [5] = go("c", "a", "e_x"), [2] = go("a", "b", "e_x", { pn = 1 }) },
      "warning: root.c: active in no configuration [unreachable]" },
    { "a transition that an earlier one keeps from being taken", {
      [4] = go("a", "a", "e_x", { pn = -1 }) },
      "warning: root.trans[4]: no step takes it (root.a -> root.a) [shadowed]" },
    { "a connector that no step passes, once", {
      k = conn {}, [4] = go("a", "k", "e_x", { pn = -1 }),
      [5] = go("b", "k", "e_x", { pn = -1 }), [6] = go("k", "a") },
      "warning: root.k: no step passes this connector [closed]" },
    { "as a note, states that lead to each other, behind others", {
      c = state {}, d = state {}, [3] = go("b", "b", "e_x"), [4] = go("b", "c", "e_c"),
      [5] = go("c", "d", "e_x"), [6] = go("d", "c", "e_x") }, lines(
      "note: root.c: root.c and root.d lead to each other, and never back to root.a "
        .. "[trap]", "  1. no event: root.trans[1] -> root.a") },
    { "states that lead to each other and never back", {
      c = state {}, d = state {}, [4] = go("a", "c", "e_c"), [5] = go("c", "d", "e_x"),
      [6] = go("d", "c", "e_x") }, lines(
      "warning: root.c: root.c and root.d lead to each other, and never back to root.a "
        .. "[trap]",
      "  1. no event: root.trans[1] -> root.a", "  2. e_c: root.trans[4] -> root.c") },
    { "states that are named as faults, and lead to each other", {
      fault = state {}, d = state {}, [2] = go("a", "fault", "e_x"),
      [3] = go("b", "a", "e_x"), [4] = go("fault", "d", "e_x"),
      [5] = go("d", "fault", "e_x") }, lines(
      "warning: root.b: active in no configuration [unreachable]",
      "warning: root.fault: root.fault and root.d lead to each other, and never back "
        .. "to root.a [trap]",
      "  1. no event: root.trans[1] -> root.a", "  2. e_x: root.trans[2] -> root.fault")
      },
    { "as a note, a way of more states than those before", {
      c = state {}, d = state {}, e = state {}, [4] = go("a", "c", "e_c"),
      [5] = go("c", "d", "e_x"), [6] = go("d", "e", "e_x"), [7] = go("e", "c", "e_x") },
      "note: root.c: root.c and root.d and root.e lead to each other, and never back "
        .. "to root.a [trap]" },
    { "no trap behind states that are left by themselves", {
      c = state { doo = yes }, d = state {}, [1] = go("initial", "c"),
      [4] = go("c", "d", "e_done"), [5] = go("d", "a", "e_after(1)") }, "" },
    { "no trap that has an end", {
      c = state {}, d = state {}, [4] = go("a", "c", "e_c"), [5] = go("c", "d", "e_x"),
      [6] = go("d", "c", "e_x"), [7] = go("c", "e", "e_y"),
      e = state { final = true } },
      "" },
    { "as a note, that nothing leaves an end that is named so", {
      FAILED = state {}, [4] = go("a", "FAILED", "e_c") }, lines(
      "note: root.FAILED: nothing happens any more in this configuration [dead-end]",
      "  1. no event: root.trans[1] -> root.a", "  2. e_c: root.trans[4] -> "
        .. "root.FAILED") },
    { "a path that needs two events", {
      k = conn {}, c = state {}, [4] = go("a", "k", "e_k"), [5] = go("k", "c", "e_l"),
      [6] = go("c", "a", "e_x") }, "" },
    { "that an event must not come twice to open a path", {
      k = conn {}, c = state {}, [4] = go("a", "k", "e_k"), [5] = go("k", "c", "e_k"),
      [6] = go("c", "a", "e_x") }, "", { together = 2 } },
    { "a configuration that nothing leaves", {
      c = state {}, [4] = go("a", "c", "e_c"), [5] = go("c", "a", "e_done",
      { guard = yes }) }, lines(
      "warning: root.c: nothing happens any more in this configuration [dead-end]",
      "  1. no event: root.trans[1] -> root.a",
      "  2. e_c: root.trans[4] -> root.c",
      "  3. no event (root.trans[5] false): no transition -> root.c") },
    { "no end that is final", { c = state { final = true }, [4] = go("a", "c", "e_c") },
      "" },
    { "a cycle that no event ends", { c = state {}, [4] = go("a", "c", "e_c"),
      [5] = go("c", "c", "e_done"), [6] = go("c", "a", "e_x") }, lines(
      "warning: root.c: run never becomes idle from this configuration [endless]",
      "  1. no event: root.trans[1] -> root.a",
      "  2. e_c: root.trans[4] -> root.c") },
    { "that the machine cannot be entered", { [1] = go("initial", "a", "e_never") },
      "warning: root: the machine cannot be entered [dead-end]", { alphabet = {} } },
  }
  for _, case in ipairs(CASES) do
    it("finds " .. case[1], function()
      local text = report(chart(case[2]), case[4])
      assert.equal(case[3], (text:sub(1, #case[3])))
      if case[3] == "" then assert.equal("", text) end
    end)
  end

  it("finds a state that nothing leaves once, however it is reached", function()
    local result = rfsm_checks.explore(chart { c = state {}, [4] = go("a", "c", "e_c"),
      [5] = go("b", "c", "e_c") }, { flags = { f = { on = { "entry root.b" } } },
      properties = { p = never { "f", "root.c" }, q = never "root.c" } })
    local places = {}
    for i, finding in ipairs(result.findings) do
      places[i] = finding.code .. " " .. finding.place
    end
    assert.same({ "violated p", "violated q", "dead-end root.c" }, places)
  end)

  it("leaves out what an element expects, also by the code of the static check",
    function()
    assert.equal("", report(chart {
      c = state { checks = { ["dead-end"] = "meant to be" } },
      d = state { checks = { unreachable = "later" } }, [4] = go("a", "c", "e_c") }))
  end)

  it("calls no callback of the user, and leaves the model as it is", function()
    local function fail() error("called") end
    local region = state { entry = fail, x = state { doo = fail, exit = fail },
      warn = false, info = false, go("initial", "x"),
      go("x", "x", "e_x", { guard = fail, effect = fail }) }
    local model = chart {
      a = state { entry = fail, exit = fail }, c = state { doo = fail },
      par = rfsm.seqand { entry = fail, exit = fail, region },
      [4] = go("a", "c", "e_c", { guard = fail, effect = fail }),
      [5] = go("c", "a", "e_done"), [6] = go("a", "par", "e_p"),
      [7] = go("par", "a", "e_q"), getevents = fail, idle_hook = fail,
      pre_step_hook = fail, post_step_hook = fail, dbg = fail, err = fail,
    }
    assert.equal("", report(model))
    assert.equal(fail, model.a.entry)
    assert.equal(fail, model.dbg)
  end)

  it("stops at a bound, and reports what is not known then", function()
    local members = {}
    for i = 1, 50 do
      members["s" .. i] = state {}
      members[3 + i] = go(i == 1 and "a" or "s" .. i - 1, "s" .. i, "e_go")
    end
    for _, bound in ipairs { "configurations", "depth" } do
      local result = rfsm_checks.explore(chart(members), { [bound] = 10,
        properties = { from("root.b").can_reach("root.s50"), never("root.s1") } })
      assert.equal(bound, result.bound)
      assert.matches("\nnot tried: what lies behind the bound on " .. bound
        .. "; unreached states, ", tostring(result))
      assert.matches("from root.b can reach root.s50: not known", tostring(result))
      assert.matches("never root.s1: does not hold", tostring(result))
    end
  end)

  it("restricts the events from outside, and sends what callbacks send", function()
    local members = { a = state {}, b = state {},
      c = state {}, [4] = go("b", "c", "e_y"), [5] = go("c", "a", "e_x") }
    local text = report(chart(members), { alphabet = { "e_x" } })
    assert.matches("root.c: active in no configuration", text)
    assert.equal("", report(chart(members), { alphabet = { "e_x" },
      sends = { ["entry root.b"] = { "e_y" } } }))
  end)

  it("takes what callbacks send in a dry run, if that is asked for", function()
    local function send_y(fsm) rfsm.send_events(fsm, "e_y") end
    local options, calls = { alphabet = { "e_x" }, dry_run = true }, {}
    local model = chart { b = state { entry = send_y }, c = state {},
      [4] = go("b", "c", "e_y", { effect = function(_, _, what) calls[1] = what end }),
      [5] = go("c", "a", "e_x") }
    assert.equal("", report(model, options))
    assert.same({ "effect" }, calls)
    options.sends = { ["entry root.b"] = {} }
    assert.matches("root.c: active in no configuration", report(model, options))
  end)

  it("takes one property that is in no list", function()
    assert.matches("never root.b: does not hold", report(chart(),
      { properties = never "root.b" }))
    assert.matches("got after%(...%) alone", select(2, pcall(rfsm_checks.explore,
      chart(), { properties = rfsm_checks.after "e_x" })))
  end)

  it("refuses a second condition, which would not be judged", function()
    for name, text in pairs { -- any order: each alone
      never = "never: one argument less expected, got string 'root.c'",
      after = "after: one argument less expected, got string 'root.c'",
      from = "from: one argument less expected, got string 'root.c'",
    } do
      local _, message = pcall(function() rfsm_checks[name]("root.b", "root.c") end)
      assert.matches("explore_spec.lua:%d+: rfsm_checks." .. text .. "$", message)
    end
    local reach = rfsm_checks.after("e_x").reach
    assert.matches("reach: one argument less expected, got 2", select(2,
      pcall(reach, "root.c", 2)))
  end)

  -- Options, the message; the model.
  local REFUSED = {
    { {}, "explore_spec.lua:%d+: rfsm_checks.explore: state expected, got table", {} },
    { {}, "^the model has problems\n  .*root.trans%[4%]: src is missing",
      chart { [4] = go(nil, "a") } },
    { { depth = "x" }, "explore_spec.lua:%d+: rfsm_checks.explore: depth: number "
      .. "expected, got string" },
    { { sends = { ["entry root.b"] = 7 } }, "rfsm_checks.explore: sends: " },
    { { seconds = -1 }, "rfsm_checks.explore: seconds: number expected, got %-1$" },
    { { dept = 3 }, "explore_spec.lua:%d+: rfsm_checks.explore: unknown option 'dept' "
      .. "%(did you mean 'depth'%?%), expected: alphabet, classes, complementary, "
      .. "configurations, deferred, depth, dry_run, " },
    { { sends = { ["entry root.bb"] = { "e" } } },
      "^sends: no callback 'entry root.bb' %(did you mean 'entry root.b'%?%)$" },
    { { flags = { lit = { on = { "enter root.b" } } } }, "^flags: no callback 'enter "
      .. "root.b' %(did you mean 'entry root.b'%?%)$" },
    { { properties = { 7 } }, "rfsm_checks.explore: properties: never%(...%), "
      .. "after%(...%).reach%(...%) or another property expected, got number$" },
    { { properties = { never("root.c") } }, "^spec/explore_spec.lua:%d+: rfsm_checks."
      .. "explore: property 'never root.c': no state or flag is named 'root.c' %(did "
      .. "you mean 'root.a'%?%)$" },
    { { properties = { never "b" } }, "no state or flag is named 'b' %(did you mean "
      .. "'root.b'%?%)$" },
    { { properties = { never { "root.b", "door" } } },
      "no state or flag is named 'door'" },
    { { properties = { never(function(active)
      return active "root.b" and not active "root.d"
    end) } }, "no state or flag is named 'root.d'" },
  }
  for _, case in ipairs(REFUSED) do
    it("refuses " .. (next(case[1]) or "models") .. ": " .. case[2]:sub(-30), function()
      local ok, text = pcall(function()
        return (rfsm_checks.explore(case[3] or chart(), case[1]))
      end)
      assert.is_false(ok)
      assert.matches(case[2], text)
    end)
  end
end)

describe("a step that was not tried", function()
  local function more(fsm) fsm.n = fsm.n + 5 end

  -- What is found in the chart a --e_go--> b, which is left with n out of its range.
  local function found(members, options)
    members.n, members[2] = 0, go("a", "b", "e_go")
    options = options or { vars = { n = { 0, 3 } }, run = { more } }
    local result = rfsm_checks.explore(chart(members), options)
    local codes = {}
    for i, finding in ipairs(result.findings) do codes[i] = finding.code end
    return table.concat(codes, " "), result.untried[1]
  end

  local BEYOND = "values of the field 'n' such as 5"

  it("leaves its state, which is no dead end then", function()
    local codes, untried = found { [3] = go("b", "a", "e_back", { effect = more }) }
    assert.same({ "", BEYOND }, { codes, untried })
  end)

  it("may be the end of what the machine sends itself", function()
    local codes, untried = found { [3] = go("b", "a", "e_done", { effect = more }) }
    assert.same({ "", BEYOND }, { codes, untried })
  end)

  it("may begin when a deadline is over", function()
    local codes, untried = found { [3] = go("b", "a", "e_after(1)", { effect = more }) }
    assert.same({ "", BEYOND }, { codes, untried })
  end)

  it("leaves a dead end in another state to be found", function()
    local codes, untried = found { c = state {}, [4] = go("a", "c", "e_c"),
      [3] = go("b", "a", "e_back", { effect = more }),
      [5] = go("c", "a", "e_done", { guard = yes }) }
    assert.same({ "dead-end", BEYOND }, { codes, untried })
  end)

  it("leaves a rest in its state to be found, if an event has to begin it", function()
    local model = chart { n = 0, [3] = go("b", "a", "e_back", { effect = more }) }
    local result = rfsm_checks.explore(model, { vars = { n = { 0, 3 } }, run = { more },
      properties = { after("e_x").leads_to "root.a" } })
    assert.is_false(result.properties[1].holds)
  end)
end)

describe("the bound on seconds", function()
  require "rfsm_seqand"

  -- Explores with a clock that advances 1 s whenever it is looked at. Returns what was
  -- done and not tried, how often the clock was looked at, and the result.
  local function explored(model, options)
    local looks = 0
    local function clock()
      looks = looks + 1
      return looks
    end
    local result = helper.with(os, { clock = clock }, function()
      return rfsm_checks.explore(model, options)
    end)
    return { result.steps, result.untried, result.bound }, looks, result
  end

  local LATE = { "what lies behind the bound on seconds" }

  -- Of the transitions from a on e_x, each leads to a connector that leads nowhere.
  local function with_many_choices()
    local model = chart {}
    for i = 1, 12 do
      model["k" .. i] = conn {}
      model[#model + 1] = go("a", "k" .. i, "e_x", { guard = yes, pn = 1 })
      model[#model + 1] = go("k" .. i, "b", nil, { guard = yes })
    end
    return model
  end

  it("ends a step that has many choices", function()
    local found = explored(with_many_choices(), { seconds = 20 })
    assert.same({ 19 * 8, LATE, "seconds" }, found)
  end)

  it("is not needed for a step with choices without end", function()
    local function wait() rfsm.yield(true) end
    local region = state { warn = false, info = false, x = state { doo = wait },
      y = state { doo = wait }, go("initial", "x"), go("x", "y", "e_done"),
      go("y", "x", "e_done") }
    local model = chart { a = rfsm.seqand { run = true, region } }
    local found, _, result = explored(model, { configurations = 2 })
    assert.same({ 275, { "more than 275 choices of one step",
      "what lies behind the bound on configurations" }, "choices" }, found)
    assert.equal("endless", result.findings[1].code)
  end)

  it("ends a step with many sets of events", function()
    local model = chart {}
    for i = 1, 30 do model[#model + 1] = go("a", "b", "e_" .. i) end
    local found = explored(model, { seconds = 20, together = 6 })
    assert.same({ 1, LATE, "seconds" }, found)
  end)

  it("is one bound for all properties", function()
    local model = chart { [2] = go("a", "b", "e_after(1)"), [3] = go("b", "a", "e_x") }
    local _, looks = explored(model, {})
    local properties = {}
    for i = 1, 4 do properties[i] = from("root.a").left_within(i + 1) end
    local _, more, result = explored(model, { properties = properties })
    assert.same({ true, true }, { more > 1.5 * looks, more < 3 * looks }) -- one walk
    for _, judged in ipairs(result.properties) do assert.is_true(judged.holds) end
    local found, least = explored(model, { properties = properties, seconds = looks })
    assert.same({ LATE, "seconds" }, { found[2], found[3] })
    assert.is_true(least <= looks + 2 * 7 + 2) -- five more walks, which end at once
  end)

  it("is one bound for regions that are explored one by one", function()
    local function region(event, back)
      return state { warn = false, info = false, x = state {}, y = state {},
        go("initial", "x"), go("x", "y", event), go("y", "x", back) }
    end
    local model = chart { a = rfsm.seqand { region("e_1", "e_2"),
      region("e_3", "e_4"), region("e_5", "e_6") } }
    local found, _, result = explored(model, {})
    assert.same({ {}, nil }, { found[2], found[3] })
    local less, _, part = explored(model, { seconds = 8 })
    assert.same({ LATE, "seconds" }, { less[2], less[3] })
    assert.is_true(part.configurations < result.configurations)
    assert.equal("stopped by seconds = 8: ", part.reach:match("^stop.-: "))
  end)

  it("leaves a dead end and what was not reached open", function()
    local model = with_many_choices()
    model.c, model[3] = state {}, go("b", "c", "e_c")
    local _, _, result = explored(model, { seconds = 3, properties = {
      after("e_c").leads_to "root.a", never "root.c" } })
    assert.equal(0, #result.findings)
    for _, judged in ipairs(result.properties) do assert.is_nil(judged.holds) end
  end)
end)

describe("an await that is complete", function()
  it("comes with an event that nothing names", function()
    local result = rfsm_checks.explore(rfsm.state { info = false, warn = false,
      c = rfsm.state { x = rfsm.state {}, y = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "x" },
        rfsm.trans { src = "x", tgt = "y", events = { "e_b", "await(e_a)" } } },
      rfsm.trans { src = "initial", tgt = "c" },
      rfsm.trans { src = "c", tgt = "internal", events = { "e_a", "e_b" } } })
    assert.equal("6 configurations, 4 of 4 transitions taken",
      tostring(result):match("^(.-), %d+ steps"))
  end)
end)

describe("what a machine keeps and what waits in it", function()
  local function judged(model, options)
    local result = rfsm_checks.explore(model, options)
    return result.properties[1].holds
  end

  -- In s e_x is deferred, and in `a` a guard may refuse it: then nothing asks again.
  it("is not asked about again before the next path", function()
    require "rfsm.defer"
    for _, read in ipairs { "all", "one" } do
      local model = state { warn = false, info = false, defer = { "e_x" }, read = read,
        s = state { entry = yes }, a = state {}, b = state { final = true },
        go("initial", "s"), go("s", "a", "e_go"), go("a", "b", "e_x", { guard = yes }) }
      assert.is_false(judged(model, { sends = { ["entry root.s"] = { "e_x" } },
        alphabet = { "e_go" }, properties = { after("e_go").reach("root.b") } }))
    end
  end)

  for _, case in ipairs {
    { "twice, if it came twice", { "e_x", "e_x" }, "one", false },
    { "once for a machine that takes all", { "e_x", "e_x" }, "all", true },
    { "in its order", { "e_x", "e_y", "e_z" }, "one", true, "e_x", "e_z" },
    { "also if the leaf does not name it", { "e_x", "e_y", "e_z" }, "one", false,
      "e_y", "e_z" },
  } do
    it("comes " .. case[1], function()
      local model = state { warn = false, info = false, read = case[3],
        a = state { entry = yes }, b = state {}, c = state { final = true },
        go("initial", "a"), go("a", "b", case[5] or "e_x"),
        go("b", "c", case[6] or "e_x"), go("b", "a", "e_y", { pn = 1 }) }
      assert.equal(case[4], judged(model, { alphabet = {}, properties = {
        never "root.c" }, sends = { ["entry root.a"] = case[2] } }))
    end)
  end

  it("comes before what is sent from outside", function()
    local model = state { warn = false, info = false, read = "one",
      a = state { entry = yes }, b = state {}, c = state {}, go("initial", "a"),
      go("a", "b", "e_x"), go("a", "c", "e_y") }
    local options = { sends = { ["entry root.a"] = { "e_x" } },
      properties = { never "root.c" } }
    assert.is_true(judged(model, options))
    assert.truthy(tostring(rfsm_checks.explore(model, options)):find(
      "holds (one event a step; none from outside while one waits)", 1, true))
  end)

  for _, event in ipairs { "e_every(1)", "e_after(1)" } do
    it("comes while an event waits, if it is " .. event, function()
      local model = state { warn = false, info = false, read = "one", a = state {},
        b = state {}, go("initial", "a"), go("a", "a", "e_done"), go("a", "b", event) }
      local fsm, now = rfsm.init(model), 0
      fsm.gettime = function() return now, 0 end
      rfsm.step(fsm, 2)
      now = 2
      rfsm.step(fsm, 4)
      assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
      for _, timers in ipairs { "free", "in order" } do
        assert.is_false(judged(model, { timers = timers,
          properties = { never "root.b" } }))
      end
    end)
  end

  it("comes before or behind a fault that its own step has made", function()
    local function model(entry)
      return state { warn = false, info = false, err = false, read = "one",
        b = state { entry = entry }, c = state {}, d = state {}, go("initial", "b"),
        go("b", "c", "e_done"), go("b", "d", "e_fault") }
    end
    local fsm = rfsm.init(model(error))
    rfsm.run(fsm)
    assert.equal("root.d", rfsm.get_actleaf_fqn(fsm))
    for _, leaf in ipairs { "root.c", "root.d" } do
      assert.is_false(judged(model(yes), { properties = { never(leaf) } }))
    end
  end)

  it("may be a fault between two steps of a region, so nothing is known", function()
    local region = state { warn = false, info = false, err = false, a = state {},
      b = state { entry = error }, c = state {}, d = state {}, go("initial", "a"),
      go("a", "b", "e_x"), go("b", "c", "e_fault"), go("c", "d") }
    local model = state { warn = false, info = false, go("initial", "s"),
      s = rfsm.seqand { arm = region, step = 2 } }
    local fsm = rfsm.init(model)
    rfsm.run(fsm)
    rfsm.send_events(fsm, "e_x")
    rfsm.step(fsm)
    assert.equal("root.c", rfsm.get_actleaf_fqn(rfsm.machines(fsm)[2].machine))
    local result = rfsm_checks.explore(model, { properties = {
      rfsm_checks.always(function(active) return not active "root.s.arm.c" end) } })
    assert.is_nil(result.properties[1].holds)
    assert.same({ "'e_fault@root.b' between two steps of root.s.arm" }, result.untried)
  end)

  it("of a wire comes behind a fault, too", function()
    local function model()
      return state { warn = false, info = false, read = "one", a = state {},
        b = state {}, c = state {}, go("initial", "a"), go("a", "b", "e_fault"),
        go("b", "c", "e_x"), go("a", "a", "e_x") }
    end
    local sender = state { warn = false, info = false,
      a = state { entry = function(fsm) fsm.emit "e_x" end }, go("initial", "a") }
    local cell = require("rfsm.system") { reader = model(), sender = sender,
      wires = { { from = "sender", event = "e_x", to = "reader" } } }
    local result = cell:explore { machines = { sender = { dry_run = true } },
      properties = { never "reader: root.c" } }
    assert.is_nil(result.bound)
    assert.is_false(result.properties[1].holds)
  end)

  it("comes to a region before the time events of that step", function()
    local region = state { warn = false, info = false, a = state {}, b = state {},
      c = state {}, d = state {}, go("initial", "a"), go("a", "b", "e_x"),
      go("a", "c", "e_after(1)"), go("b", "d", "e_after(1)@root.a") }
    local model = state { warn = false, info = false, read = "one",
      s = rfsm.seqand { arm = region }, go("initial", "s") }
    local fsm, now = rfsm.init(model), 0
    local arm = rfsm.machines(fsm)[2].machine
    arm.gettime = function() return now, 0 end
    for _ = 1, 4 do rfsm.step(fsm) end
    now = 2
    rfsm.send_events(fsm, "e_x")
    for _ = 1, 4 do rfsm.step(fsm) end
    assert.equal("root.d", rfsm.get_actleaf_fqn(arm))
    assert.is_false(judged(model, { properties = { never "root.s.arm.d" } }))
  end)

  it("comes to a region before its time events, if it keeps them for later", function()
    local arm = state { warn = false, info = false, b = state {}, c = state {},
      d = state {}, a = state { defer = { "e_x", "e_y" } }, go("initial", "a"),
      go("a", "b", "e_after(1)"), go("b", "c", "e_x"), go("b", "d", "e_y") }
    local model = state { warn = false, info = false, s = rfsm.seqand { arm = arm },
      go("initial", "s") }
    local options = { alphabet = {}, sends = {
      ["effect root.trans[1]"] = { { "e_x", after = 1 } },
      ["effect root.s.arm.trans[1]"] = { { "e_y", after = 1 } } } }
    for leaf, is_never in pairs { c = false, d = true } do -- any order: each alone
      options.properties = { never("root.s.arm." .. leaf) }
      assert.equal(is_never, judged(model, options))
    end
  end)

  it("comes in every order, if two are sent in a step", function()
    local model = state { warn = false, info = false, read = "one", a = state {},
      b = state { entry = yes }, c = state {}, go("initial", "a"),
      go("a", "b", "e_y"), go("b", "c", "e_x"), go("b", "a", "e_z") }
    assert.is_false(judged(model, { together = 2, properties = { never "root.c" },
      sends = { ["entry root.b"] = { "e_z" } } }))
  end)
end)

describe("a transition that needs no event", function()
  it("may be refused by its guard for ever", function()
    local function judged(guard)
      return rfsm_checks.explore(chart { c = state { final = true },
        [4] = rfsm.trans { src = "b", tgt = "c", always = true,
          guard = guard } }, { properties = { after("e_x").reach("root.c") } })
        .properties[1].holds
    end
    assert.is_false(judged(yes))
    assert.is_true(judged(nil))
  end)

  it("is asked for again after an event that nothing takes", function()
    local result = rfsm_checks.explore(state { warn = false, info = false,
      a = state { entry = yes, doo = yes }, b = state { final = true },
      c = state { final = true }, go("initial", "a"), go("a", "c", "e_done"),
      rfsm.trans { src = "a", tgt = "b", always = true, guard = yes } }, {
      sends = { ["entry root.a"] = { "e_other" } }, properties = { never "root.c" } })
    local names = {}
    for i, choice in ipairs(result.properties[1].witness[2].choices) do
      names[i] = choice.who .. " " .. tostring(choice.answer)
    end
    assert.same({ "root.trans[3] false", "root.trans[3] false" }, names)
  end)

  it("is taken some time, if a doo has to end before", function()
    local result = rfsm_checks.explore(chart { c = state { final = true },
      b = state { doo = yes }, [3] = go("b", "c", "e_done"),
      [5] = rfsm.trans { src = "b", tgt = "c", always = true, guard = yes } },
      { properties = { after("e_x").reach("root.c") } })
    assert.is_true(result.properties[1].holds)
  end)
end)

describe("machines in a sequential AND state", function()
  -- (initial) -> open --e_close--> closed --e_open--> open
  local function arm(members)
    members.open, members.closed = state {}, state {}
    members.warn, members.info, members[1] = false, false, go("initial", "open")
    members[2] = members[2] or go("open", "closed", "e_close")
    members[3] = members[3] or go("closed", "open", "e_open")
    return state(members)
  end

  local function both(left, right)
    return chart { b = rfsm.seqand { left = left, right = right } }
  end

  it("have the event of the first entry, too", function()
    local left = state { warn = false, info = false, open = state { doo = yes },
      closed = state {}, go("initial", "open"), go("open", "closed") }
    local model = chart { b = rfsm.seqand { left = left }, [1] = go("initial", "b") }
    assert.matches(lines("never root.b.left.closed: does not hold %[violated%]",
      "  1. no event: root.trans%[1%], root.b.left.trans%[1%] %-> root.b",
      "  2. no event: root.b.left.trans%[2%] %-> root.b"),
      report(model, { properties = { never "root.b.left.closed" } }))
  end)

  it("are explored together", function()
    local slow = arm { [2] = go("open", "closed", "e_close", { guard = yes }) }
    assert.equal("", report(both(arm {}, slow), { properties = {
      from("root.b").can_reach { "root.b.left.closed", "root.b.right.open" },
      never { "root.a", "root.b.left.open" },
      ["left is first"] = always(function(active)
        return not active "root.b" or active "root.b.left.open"
          or active "root.b.left.closed"
      end),
    } }):gsub("[^\n]*: holds [^\n]*\n?", ""))
  end)

  it("have findings of their own", function()
    assert.matches("root.b.left.spare: active in no configuration",
      report(both(arm { spare = state {} }, arm {})))
  end)

  it("may never become idle", function()
    local endless = arm { [2] = go("open", "closed", "e_done"),
      [3] = go("closed", "open", "e_done") }
    local model = chart { b = rfsm.seqand { run = true, endless } }
    assert.matches("root: a machine in a sequential AND state never becomes idle "
      .. "%[endless%]\n  1. no event: root.trans%[1%] %-> root.a\n  2. e_x: [^\n]* and "
      .. "on and on %-> not entered\n", report(model))
  end)
end)

describe("a property", function()
  local function verdict(property, members, options)
    options = options or {}
    options.properties = { property }
    local result = rfsm_checks.explore(chart(members), options)
    return result.properties[1].holds, tostring(result)
  end

  local C = { c = state {}, [4] = go("a", "c", "e_c"), [5] = go("c", "a", "e_x") }
  local VIA_C = { c = state {}, [4] = go("a", "c", "e_c"),
    [5] = go("c", "b", "e_done") }
  local function not_in_c(active) return active "root.b" or active "root.a" end
  local MAYBE = { c = state {}, [4] = go("a", "c", "e_c"),
    [5] = go("c", "b", "e_done", { guard = yes }), [6] = go("c", "a", "e_x") }
  local TRAP = { c = state {}, [4] = go("a", "c", "e_c"), [5] = go("c", "c", "e_x") }
  local WORK = { c = state { doo = yes }, [4] = go("a", "c", "e_c"),
    [5] = go("c", "b", "e_done") }

  local CASES = {
    { "never", never("root.c"), nil, C, false },
    { "never", never { "root.a", "root.b" }, true, C, true },
    { "never", never(function(active) return active "root.c" end), nil, C, false },
    { "always", always("root"), nil, C, true },
    { "always", always(function(active) return not active "root.c" end), nil, C,
      false },
    { "after", after("e_x").reach("root.b"), nil, C, false },
    { "after", after("e_c").reach("root.c"), nil, { [2] = go("a", "b", "e_y"),
      c = state {}, [4] = go("root", "c", "e_c", { pn = 1 }) }, true },
    { "after, in steps that follow by themselves",
      after("e_c").reach(not_in_c), nil, VIA_C, true },
    { "after, whatever guards say",
      after("e_c").reach(not_in_c), nil, MAYBE, false },
    { "after, when a doo has ended",
      after("e_c").reach(not_in_c), nil, WORK, true },
    { "from", from("root.c").can_reach("root.b"), nil, C, true },
    { "from", from("root.c").can_reach("root.a"), nil, TRAP, false },
  }
  for i, case in ipairs(CASES) do
    it(("of %s %s (%d)"):format(case[1], case[5] and "holds" or "fails", i), function()
      local holds, text = verdict(case[2], case[4])
      assert.equal(case[5], holds)
      assert.equal(not case[5], text:find("does not hold [violated]", 1, true) ~= nil)
    end)
  end

  it("is shown to fail by the shortest run", function()
    local _, text = verdict(after("e_x").reach("root.b"), C)
    assert.equal(lines("after e_x reach root.b: does not hold [violated]",
      "  1. no event: root.trans[1] -> root.a", "  2. e_x: root.trans[2] -> root.b",
      "  3. e_x: root.trans[3] -> root.a"), (text:gsub("^[^\n]*\n", "")))
  end)

  it("may stand in the root of the model, with a name", function()
    local model = chart { properties = { ["never in b"] = never("root.b") } }
    assert.matches("\nnever in b: does not hold %[violated%]\n",
      tostring(rfsm_checks.explore(model)))
  end)

  it("may ask for flags that callbacks set", function()
    local flags = { lit = { on = { "entry root.b" }, off = { "exit root.b" } } }
    local unsafe = never(function(active) return active "lit" and active "root.a" end)
    assert.is_true(verdict(unsafe, {}, { flags = flags }))
    flags.lit.off = { "effect root.trans[2]" }
    assert.is_false((verdict(unsafe, {}, { flags = flags })))
  end)
end)

describe("a witness", function()
  local model = chart { c = state { doo = yes },
    [4] = go("a", "c", "e_c", { guard = yes }), [5] = go("c", "b", "e_done"),
    properties = { never("root.c"), after("e_c").reach("root.c") } }
  local findings = rfsm_checks.explore(model).findings

  it("is replayed as a recording, to where it leads", function()
    for _, finding in ipairs(findings) do
      local records = {}
      rfsm_checks.record_witness(model, finding.witness, records)
      local fsm, problem = require("rfsm.record").replay(model, records, { dry = true })
      assert.is_nil(problem)
      assert.equal(finding.witness[#finding.witness].leaf, rfsm.get_actleaf_fqn(fsm))
    end
  end)

  it("is a path in a picture", function()
    assert.same({ "root.trans[1]", "root.a", "root.trans[4]", "root.c" },
      rfsm_checks.path_of(findings[2].witness))
  end)
end)

-- Agreement with random runs ----------------------------------------------------

describe("a state whose name is a word of an extension", function()
  -- (initial) -> a --e_x--> prepare --e_y--> a
  local function chart_with(name, members)
    members[name], members.a = state {}, state {}
    members.warn, members.info, members[1] = false, false, go("initial", "a")
    members[2], members[3] = go("a", name, "e_x"), go(name, "a", "e_y")
    return state(members)
  end

  it("is a state of the chart", function()
    for _, name in ipairs { "prepare", "likely" } do
      local result = rfsm_checks.explore(chart_with(name, {}), { properties = {
        never("root." .. name) } })
      assert.same({ name, 3, false }, { name, result.configurations,
        result.properties[1].holds })
    end
  end)

  it("is a state of its region", function()
    local model = chart { b = rfsm.seqand { left = chart_with("prepare", {}) } }
    local result = rfsm_checks.explore(model, { properties = {
      never "root.b.left.prepare" } })
    assert.same({ false, 0 }, { result.properties[1].holds,
      #result.findings - 1 }) -- one finding: the property
  end)

  it("may be in another state, also as the key of a transition", function()
    local model = chart { b = state { prepare = state {}, c = state {},
      go("initial", "prepare"), go("prepare", "c", "e_c"), go("c", "prepare", "e_c") } }
    assert.equal("", report(model))
    model = chart { b = state { c = state {}, d = state {}, go("initial", "c"),
      prepare = go("c", "d", "e_c"), [2] = go("d", "c", "e_c") } }
    assert.equal("", report(model))
  end)
end)

-- A printer: it warms up, then prints, and both times keeps jobs.
local function printer(members)
  local model = { info = false, warn = false,
    warming = state { defer = { "e_job", "e_clean" } }, ready = state {},
    printing = state { defer = { "e_job", "e_clean" } },
    cleaning = state { defer = { "e_job" } },
    go("initial", "warming"), go("warming", "ready", "e_warm"),
    go("ready", "printing", "e_job"), go("printing", "ready", "e_printed"),
    go("ready", "cleaning", "e_clean"), go("cleaning", "ready", "e_cleaned") }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a set
  return state(model)
end

describe("deferred events", function()
  local leads = from("root").can_reach "root.ready"

  it("are at most 4 at a time, which is a premise", function()
    local result = rfsm_checks.explore(printer(), { properties = { leads } })
    assert.same({ true, "trap", nil, "note" }, { result.properties[1].holds,
      result.findings[1].code, result.bound, result.findings[1].severity })
    assert.equal("one event a step; at most 4 deferred events",
      result.properties[1].premises)
    assert.is_true(result.configurations < 250, result.configurations)
  end)

  it("are as many as the option allows, and no premise if there never are more",
    function()
    local one = rfsm_checks.explore(printer(), { deferred = 1 })
    assert.equal("one event a step; at most 1 deferred event", one.premises)
    local few = { max = 2, "e_job" }
    local exact = rfsm_checks.explore(chart { a = state { defer = few },
      [4] = go("b", "a", "e_job") })
    assert.equal("one event a step", exact.premises)
  end)

  it("are no dead end where one more would be deferred", function()
    local result = rfsm_checks.explore(state { info = false, warn = false,
      a = state { defer = { "e_x" } }, b = state {},
      go("initial", "a"), go("a", "b", "e_y"), go("b", "a", "e_x") },
      { alphabet = { "e_x" }, deferred = 1 })
    for _, finding in ipairs(result.findings) do
      assert.not_equal("dead-end", finding.code)
    end
  end)

  it("are not known if callbacks send them and there are too many", function()
    local model = printer { [2] = go("warming", "warming", "e_more", {
      effect = function() end }), [7] = go("warming", "ready", "e_warm") }
    local result = rfsm_checks.explore(model, { alphabet = { "e_more", "e_warm" },
      sends = { ["effect root.trans[2]"] = { "e_job" } }, properties = { leads } })
    assert.same({ "deferred" }, { result.bound, result.properties[1].holds })
    assert.same({ "more than 4 deferred events" }, result.untried)
  end)
end)

describe("the choices of a step", function()
  it("are listed up to 8", function()
    local choice = { who = "g", answer = true }
    local step = { choices = {} }
    for i = 1, 9 do step.choices[i] = choice end
    local text = require("rfsm.explore.verdict").choices_text(step)
    assert.equal(" (" .. ("g true, "):rep(7) .. "g true and on and on)", text)
  end)
end)

describe("the transitions of a step", function()
  it("are listed up to 8", function()
    local subject = require "rfsm.explore.subject"
    local paths = {}
    for i = 1, 8 do paths[i] = "t" end
    local text = table.concat(paths, ", ")
    assert.equal(text .. " -> root.a", subject.outcome(paths, "root.a"))
    paths[9] = "t"
    assert.equal(text .. " and on and on -> not entered", subject.outcome(paths))
    assert.equal("no transition -> root.a", subject.outcome({}, "root.a"))
  end)
end)

describe(claim.name, function()
  it("agree on random charts", function()
    claim.runs = 40
    assert.is_nil(share.problem(claim, 16, true))
  end)
end)
