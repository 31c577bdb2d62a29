-- Static checks, and the check for undeclared events.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local timeevent = require "rfsm_timeevent"
require "rfsm.await"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

-- (initial) -> a --e_x--> b --e_x--> a, with more members
local function chart(members)
  local model = {
    warn = false, info = false, a = state {}, b = state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e_x" } },
    trans { src = "b", tgt = "a", events = { "e_x" } },
  }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a set
  return state(model)
end

-- A machine and the list of what it warns of, once it runs.
local function watched(model)
  local fsm, warnings = helper.init(model), {}
  fsm.warn = function(text) warnings[#warnings + 1] = text end
  rfsm_checks.watch(fsm)
  rfsm.run(fsm)
  return fsm, warnings
end

describe("watch", function()
  it("warns of an event that no transition names", function()
    local fsm, warnings = watched(chart())
    helper.post_and_run(fsm, "e_y", "e_x", 7)
    assert.same({
      "WARNING: undeclared event e_y received", "WARNING: undeclared event 7 received",
    }, warnings)
  end)

  it("is asked for by the model, too", function()
    local fsm, warnings = helper.init(chart { checkevents = true }), {}
    fsm.warn = function(text) warnings[#warnings + 1] = text end
    helper.post_and_run(fsm, "e_y")
    assert.same({ "WARNING: undeclared event e_y received" }, warnings)
  end)

  it("is silent while warn is off", function()
    local fsm, warnings = watched(chart())
    local warn = fsm.warn
    fsm.warn = false
    helper.post_and_run(fsm, "e_y")
    fsm.warn = warn
    helper.post_and_run(fsm, "e_z")
    assert.same({ "WARNING: undeclared event e_z received" }, warnings)
  end)

  it("knows what the engine sends", function()
    local fsm, warnings = watched(chart())
    helper.post_and_run(fsm, "e_x")
    assert.same({}, warnings)
  end)

  it("knows e_done of a root that is a leaf", function()
    local _, warnings = watched(state { warn = false })
    assert.same({}, warnings)
  end)

  it("knows what a predicate accepts", function()
    local fsm, warnings = watched(chart { [4] = trans { src = "a", tgt = "b",
      events = { function(event) return event == "e_p" end } } })
    helper.post_and_run(fsm, "e_q", "e_p")
    assert.same({ "WARNING: undeclared event e_q received" }, warnings)
  end)

  it("takes a predicate that fails for one that does not accept", function()
    local fsm, warnings = watched(chart { [4] = trans { src = "a", tgt = "b",
      events = { function() error("no") end } } })
    helper.post_and_run(fsm, "e_q")
    assert.same({ "WARNING: undeclared event e_q received" }, warnings)
  end)

  it("knows objects by identity", function()
    local event = {}
    local fsm, warnings = watched(chart { [4] = trans { src = "a", tgt = "b",
      events = { event } } })
    helper.post_and_run(fsm, event)
    assert.same({}, warnings)
  end)

  it("knows time events", function()
    local now = 0
    timeevent.set_gettime_hook(function() return now, 0 end)
    local fsm, warnings = watched(chart { [4] = trans { src = "a", tgt = "b",
      events = { "e_after(1)" } } })
    now = 2
    rfsm.run(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    assert.same({}, warnings)
  end)

  it("knows awaited events", function()
    local fsm, warnings = watched(chart { [4] = trans { src = "a", tgt = "b",
      events = { "await(e_p, e_q)" } } })
    helper.post_and_run(fsm, "e_p")
    helper.post_and_run(fsm, "e_q")
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    assert.same({}, warnings)
  end)

  it("knows what is merged later", function()
    local fsm, warnings = watched(chart())
    rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "b", events = { "e_new" } })
    helper.post_and_run(fsm, "e_new")
    assert.same({}, warnings)
  end)

  it("uses the printer of the moment", function()
    local fsm, later = watched(chart()), {}
    fsm.warn = function(text) later[#later + 1] = text end
    helper.post_and_run(fsm, "e_y")
    assert.same({ "WARNING: undeclared event e_y received" }, later)
  end)

  it("is silent when warn is false", function()
    local fsm = watched(chart())
    fsm.warn = false
    assert.has_no_error(function() helper.post_and_run(fsm, "e_y") end)
  end)

  it("called twice warns once", function()
    local fsm, warnings = watched(chart())
    rfsm_checks.watch(fsm)
    helper.post_and_run(fsm, "e_y")
    assert.equal(1, #warnings)
  end)

  it("blames the caller for what is no machine", function()
    local _, text = pcall(function() rfsm_checks.watch(chart()) end)
    assert.matches("checks_spec.lua:%d+: rfsm_checks.watch: initialised fsm expected, "
      .. "got state", text)
  end)
end)

describe("check", function()
  local function findings_of(members)
    local findings = rfsm_checks.check(chart(members))
    for i = 1, #findings do findings[i] = helper.without_file(findings[i]) end
    return findings
  end

  it("takes a machine, and a part of one, too", function()
    local model = chart { c = state {} }
    local findings = rfsm_checks.check(model)
    assert.equal(1, #findings)
    assert.same(findings, rfsm_checks.check(helper.init(model)))
    local whole = helper.init(state { p = model, trans { src = "initial", tgt = "p" } })
    assert.same(findings, rfsm_checks.check(whole.p))
  end)

  it("says in which file and line", function()
    assert.matches("^spec/checks_spec.lua:%d+: root.c: unreachable",
      rfsm_checks.check(chart { c = state {} })[1])
  end)

  it("prints nothing and leaves the model as it is", function()
    local printed, model = {}, chart { c = state {} }
    local function note(...) printed[#printed + 1] = ... end
    model.warn, model.info, model.err = note, note, note
    assert.equal(1, #rfsm_checks.check(model))
    assert.same({}, printed)
    assert.equal(note, model.warn)
    assert.is_nil(rawget(model, "dbg"))
  end)

  it("leaves the model as it is when it cannot be initialised", function()
    local model = chart()
    local function fail() error("no machine today", 0) end
    rfsm.preproc[#rfsm.preproc + 1] = fail
    local ok, text = pcall(rfsm_checks.check, model)
    table.remove(rfsm.preproc)
    assert.is_false(ok)
    assert.equal("no machine today", text)
    assert.is_false(model.warn)
    assert.is_nil(rawget(model, "dbg"))
  end)

  it("knows a model by which its transitions call the root", function()
    local model = chart()
    model[4] = trans { src = "b", tgt = model, events = { "e_again" } }
    assert.same({}, rfsm_checks.check(model))
  end)

  it("reports a state that is called like a printer", function()
    assert.matches("^root%.info: ", findings_of { info = state {} }[1])
  end)

  -- c[ (initial) -> x --e_x--> y --e_y--> x ] with transitions around it
  local function in_composite(outer)
    return {
      c = state {
        x = state {}, y = state {}, trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "y", events = { "e_x" } },
        trans { src = "y", tgt = "x", events = { "e_y" } },
      },
      [4] = trans { src = "a", tgt = "c", events = { "e_c" } },
      [5] = trans(outer),
    }
  end

  local function go(src, tgt, event, fields)
    fields = fields or {}
    fields.src, fields.tgt, fields.events = src, tgt, event and { event }
    return trans(fields)
  end

  local function x_in_c() return state { x = state {}, go("initial", "x") } end

  local UNREACHABLE = ": unreachable, no path of transitions leads here"
  local NEVER_TAKEN = ": never taken, %s always comes first"
  local BY_4, BY_5 = NEVER_TAKEN:format("root.trans[4] (a -> b)"),
    NEVER_TAKEN:format("root.trans[5] (c -> a)")

  -- A circumstance, the members of a chart, the findings.
  local CASES = {
    { "nothing in a sound model", {} },
    { "the problems of a model that is not valid", { [4] = trans { tgt = "a" } },
      "root.trans[4]: src is missing, the name of a state or connector expected" },
    { "a state that nothing leads to, and not what is in it", { c = x_in_c() },
      "root.c" .. UNREACHABLE },
    { "a state that only unreachable ones lead to",
      { c = state {}, d = state {}, [4] = go("c", "d", "e"), [5] = go("d", "c", "e") },
      "root.c" .. UNREACHABLE, "root.d" .. UNREACHABLE },
    { "no state that is reached through connectors", {
      k = conn {}, c = state {}, [4] = go("a", "k", "e_k"), [5] = go("k", "c"),
      [6] = go("c", "a", "e_x") } },
    { "a connector that leads nowhere", { k = conn {}, [4] = go("a", "k", "e_k") },
      "root.k: no way out of this connector, so that no transition to it is ever "
      .. "taken" },
    { "a state without an exit", { c = state {}, [4] = go("a", "c", "e_c") },
      "root.c: no exit, neither this state nor one around it is ever left" },
    { "no state without an exit that is final",
      { c = state { final = true }, [4] = go("a", "c", "e_c") } },
    { "no state in a composite that has an exit",
      { c = x_in_c(), [4] = go("a", "c", "e_c"), [5] = go("c", "a", "e_x") } },
    { "a transition that an outer one always beats",
      in_composite { src = "c", tgt = "a", events = { "e_x" } },
      "root.c.trans[2] (x -> y)" .. BY_5 },
    { "transitions that one on any event beats", in_composite { src = "c", tgt = "a" },
      "root.c.trans[2] (x -> y)" .. BY_5,
      "root.c.trans[3] (y -> x)" .. BY_5 },
    { "none that one with a guard may beat",
      in_composite { src = "c", tgt = "a", guard = function() end } },
    { "none beside one on another event",
      in_composite { src = "c", tgt = "a", events = { "e_z" } } },
    { "one that a sibling of larger pn always beats",
      { [4] = go("a", "b", "e_x", { pn = 1 }) }, "root.trans[2] (a -> b)" .. BY_4 },
    { "none beside one through a connector that may be disabled", {
      k = conn {}, [4] = go("a", "k", "e_x", { pn = 1 }),
      [5] = go("k", "b", nil, { guard = function() end }) } },
    { "one that one through a connector always beats",
      { k = conn {}, [4] = go("a", "k", "e_x", { pn = 1 }), [5] = go("k", "b") },
      "root.trans[2] (a -> b)" .. NEVER_TAKEN:format("root.trans[4] (a -> k)") },
    { "an e_done@F that never comes", { [4] = go("a", "b", "e_done@root.z") },
      "root.trans[4] (a -> b): event 'e_done@root.z' never comes, 'root.z' is no leaf "
      .. "state of this machine" },
  }
  for _, case in ipairs(CASES) do
    it("finds " .. case[1], function()
      assert.same({ case[3], case[4] }, findings_of(case[2]))
    end)
  end

  it("goes through the states in the order of their names", function()
    local members, places = {}, {}
    for name in ("e d b f c"):gmatch("%a") do members[name] = state {} end
    for i, text in ipairs(findings_of(members)) do places[i] = text:match("^[^:]*") end
    assert.equal("root.c root.d root.e root.f", table.concat(places, " "))
  end)

  it("blames the caller for what is no state", function()
    local _, text = pcall(function() return (rfsm_checks.check {}) end)
    assert.matches("checks_spec.lua:%d+: rfsm_checks.check: state expected, got table",
      text)
  end)
end)

describe("review", function()
  it("has the warnings of init, the findings, and those of regions", function()
    local region = chart { c = state {} }
    local model = chart {
      par = rfsm.seqand { region },
      [4] = trans { src = "a", tgt = "par", events = "e" },
      [5] = trans { src = "par", tgt = "a", events = { "e_done" } },
      [6] = trans { src = "initial", tgt = "b", event = "e" },
    }
    local problems, warnings = rfsm_checks.review(model)
    for i = 1, #warnings do warnings[i] = helper.without_file(warnings[i]) end
    assert.same({}, problems)
    assert.same({
      "root.trans[6] (initial -> b): a transition has no field 'event' (did you mean "
      .. "'events'?)",
      "root.trans[6] (initial -> b): never taken, root.trans[1] (initial -> a) always "
      .. "comes first",
      "root.par.1: root.c: unreachable, no path of transitions leads here",
    }, warnings)
  end)

  it("has the problems of a model that is not valid", function()
    local problems = rfsm_checks.review(chart { [4] = trans { tgt = "a" } })
    assert.equal(1, #problems)
  end)
end)

describe("rfsm.checkevents", function()
  it("watches each machine that is initialised afterwards, and none before", function()
    local warnings, before = {}, helper.init(chart())
    require "rfsm.checkevents"
    local model = chart()
    model.warn = function(text) warnings[#warnings + 1] = text end
    local after = helper.init(model)
    helper.post_and_run(before, "e_y")
    helper.post_and_run(after, "e_y")
    assert.same({ "WARNING: undeclared event e_y received" }, warnings)
  end)
end)
