-- Static checks, and the check for undeclared events.

local ab = require "spec.support.ab"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local share = require "spec.support.share"
local stubs = require "rfsm.shared.stubs"
local timeevent = require "rfsm_timeevent"
require "rfsm.await"
require "rfsm.faults"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

local chart, go = ab.chart, ab.go

-- A machine and the list of what it warns of, once it runs.
local function watched(model)
  local fsm, warnings = helper.init(model), {}
  fsm.warn = function(text) warnings[#warnings + 1] = text end
  rfsm_checks.watch(fsm)
  rfsm.run(fsm)
  return fsm, warnings
end

local function undeclared(event)
  return "WARNING: undeclared event " .. event .. " received"
end

local function also_on(...)
  return { [4] = go("a", "b", { ... }) }
end

it("a chart whose states and fields are named type is checked like others", function()
  assert.same({}, rfsm_checks.check(state {
    type = state { type = 5 }, b = state { type = "x" },
    trans { src = "initial", tgt = "type" }, go("type", "b", { "e" }),
    go("b", "type", { "e" }),
  }))
end)

describe("watch", function()
  local object = {}

  -- A circumstance, more members of the chart, an event for each run, the warnings; the
  -- leaf at the end.
  local CASES = {
    { "warns of events that no transition names", {}, { "e_y", "e_x", 7 },
      { undeclared "e_y", undeclared "7" } },
    { "knows what a predicate accepts",
      also_on(function(event) return event == "e_p" end), { "e_q", "e_p" },
      { undeclared "e_q" } },
    { "takes a predicate that fails for one that does not accept",
      also_on(function() error("no") end), { "e_q" }, { undeclared "e_q" } },
    { "knows objects by identity", also_on(object), { object }, {} },
    { "knows awaited events", also_on("await(e_p, e_q)"), { "e_p", "e_q" }, {},
      "root.b" },
  }
  for _, case in ipairs(CASES) do
    it(case[1], function()
      local fsm, warnings = watched(chart(case[2]))
      for _, event in ipairs(case[3]) do helper.post_and_run(fsm, event) end
      assert.same(case[4], warnings)
      if case[5] then assert.equal(case[5], rfsm.get_actleaf_fqn(fsm)) end
    end)
  end

  it("is asked for by the model, too", function()
    local fsm, warnings = helper.started(chart { checkevents = true }), {}
    fsm.warn = function(text) warnings[#warnings + 1] = text end
    helper.post_and_run(fsm, "e_y")
    assert.same({ undeclared "e_y" }, warnings)
  end)

  it("uses the printer of the moment, and warns once if called twice", function()
    local fsm, warnings = watched(chart())
    local warn = fsm.warn
    rfsm_checks.watch(fsm)
    fsm.warn = false
    helper.post_and_run(fsm, "e_y")
    fsm.warn = warn
    helper.post_and_run(fsm, "e_z")
    assert.same({ undeclared "e_z" }, warnings)
  end)

  it("knows e_done of a root that is a leaf", function()
    local _, warnings = watched(state { warn = false })
    assert.same({}, warnings)
  end)

  it("knows time events, and what is merged later", function()
    local now = 0
    timeevent.set_gettime_hook(function() return now, 0 end)
    local fsm, warnings = watched(chart(also_on("e_after(1)")))
    now = 2
    rfsm.run(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    rfsm.fsm_merge(fsm, fsm, go("a", "b", "e_new"))
    helper.post_and_run(fsm, "e_new")
    assert.same({}, warnings)
  end)

  it("names the nearest function for one that there is not", function()
    local _, text = pcall(function() rfsm_checks.nevr() end)
    assert.matches("checks_spec.lua:%d+: rfsm_checks has no function 'nevr' %(did you "
      .. "mean 'never'%?%)$", text)
    assert.is_nil(rfsm_checks.zzz)
  end)

  it("has its module as a global", function()
    assert.equal(rfsm_checks, rawget(_G, "rfsm_checks"))
  end)

  it("blames the caller for what is no machine", function()
    local _, text = pcall(function() rfsm_checks.watch(chart()) end)
    assert.matches("checks_spec.lua:%d+: rfsm_checks.watch: initialised fsm expected, "
      .. "got state", text)
  end)
end)

local function lines_of(model)
  local lines = rfsm_checks.check(model)
  for i = 1, #lines do lines[i] = helper.without_file(lines[i]) end
  return lines
end

describe("check", function()
  it("finds what is wrong with the top of a part of a machine", function()
    local whole = helper.init(state { p = chart { guard = print }, go("initial", "p") })
    assert.same({ "root: a state has no field 'guard' (a transition has it) "
      .. "[never-called]" }, lines_of(whole.p))
  end)

  it("has the warnings of a model that is not valid, too", function()
    assert.same({ "root.trans[4]: src is missing, the name of a state or connector "
      .. "expected", "root.trans[5] (a -> b): a transition has no field 'action' (did "
      .. "you mean 'effect'?) [unknown-field]" }, lines_of(chart {
      [4] = go(nil, "a"), [5] = go("a", "b", "e", { action = print }) }))
  end)

  it("takes a machine, and a part of one, too", function()
    local model = chart { c = state {} }
    local findings = rfsm_checks.check(model)
    assert.equal(1, #findings)
    assert.same(findings, rfsm_checks.check(helper.init(model)))
    local whole = helper.init(state { p = model, go("initial", "p") })
    assert.same(findings, rfsm_checks.check(whole.p))
  end)

  it("names file and line", function()
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
    model[4] = go("b", model, "e_again")
    assert.same({}, rfsm_checks.check(model))
  end)

  it("reports a state that is called like a printer", function()
    assert.matches("^root%.info: ", lines_of(chart { info = state {} })[1])
  end)

  it("reports the problems of a model that is not valid", function()
    assert.same({ "root.trans[4]: src is missing, the name of a state or connector "
      .. "expected" }, lines_of(chart { [4] = go(nil, "a") }))
  end)

  it("goes through the states in the order of their names", function()
    local members, places = {}, {}
    for name in ("e d b f c"):gmatch("%a") do members[name] = state {} end
    for i, text in ipairs(lines_of(chart(members))) do
      places[i] = text:match("^[^:]*")
    end
    assert.equal("root.c root.d root.e root.f", table.concat(places, " "))
  end)

  it("looks into the machines of a sequential AND state", function()
    assert.same({ "root.par.1: root.c: unreachable, no path of transitions leads here "
      .. "[unreachable]" }, lines_of(chart {
      par = rfsm.seqand { chart { c = state {} } },
      [4] = go("a", "par", "e"), [5] = go("par", "a", "e"),
    }))
  end)

  it("has the warnings of init about machines in a state", function()
    assert.same({ "root.par.1: root.trans[4] (a -> b): a transition has no field "
      .. "'action' (did you mean 'effect'?) [unknown-field]" }, lines_of(chart {
      par = rfsm.seqand { chart { [4] = go("a", "b", "e_y", { action = print }) } },
      [4] = go("a", "par", "e"), [5] = go("par", "a", "e"),
    }))
  end)

  it("blames the caller for what is no state", function()
    local _, text = pcall(function() return (rfsm_checks.check {}) end)
    assert.matches("checks_spec.lua:%d+: rfsm_checks.check: state expected, got table",
      text)
  end)
end)

-- Codes ---------------------------------------------------------------------------

-- All findings, notes among them, as lines; `code`: of that code alone.
local function findings_of(model, code, settings)
  local lines = {}
  for _, finding in ipairs(rfsm_checks.findings(model, settings)) do
    if not code or finding.code == code then
      lines[#lines + 1] = finding.place .. ": " .. helper.without_file(finding.text)
    end
  end
  return lines
end

local function x_in_c() return state { x = state {}, go("initial", "x") } end

local function yes() return true end

-- c[ (initial) -> x --e_x--> y --e_y--> x ] with transitions around it
local function in_composite(outer)
  return {
    c = state { x = state {}, y = state {}, go("initial", "x"), go("x", "y", "e_x"),
      go("y", "x", "e_y") },
    [4] = go("a", "c", "e_c"), [5] = trans(outer),
  }
end

local UNREACHABLE = ": unreachable, no path of transitions leads here"
local NEVER_TAKEN = ": never taken, %s always comes first"
local BY_4, BY_5 = NEVER_TAKEN:format("root.trans[4] (a -> b)"),
  NEVER_TAKEN:format("root.trans[5] (c -> a)")
local NO_EXIT = ": no exit, neither this state nor one around it is ever left"

local function via_k(...)
  local members = { k = conn {}, [4] = go("a", "k", "e_k") }
  for i, tr in ipairs { ... } do members[4 + i] = tr end
  return members
end

local function entered_by(initial)
  return { c = state { x = state {}, initial }, [4] = go("a", "c", "e_c"),
    [5] = go("c", "a", "e_x") }
end

local function busy() while true do rfsm.yield() end end

-- A code, a circumstance, the members of a chart, and the findings of this code: those
-- that have none are the near twins.
local CASES = {
  { "unreachable", "a state that nothing leads to, and not what is in it",
    { c = x_in_c() }, "root.c" .. UNREACHABLE },
  { "unreachable", "a state that only unreachable ones lead to",
    { c = state {}, d = state {}, [4] = go("c", "d", "e"), [5] = go("d", "c", "e") },
    "root.c" .. UNREACHABLE, "root.d" .. UNREACHABLE },
  { "unreachable", "no state that is reached through connectors",
    { k = conn {}, c = state {}, [4] = go("a", "k", "e_k"), [5] = go("k", "c"),
      [6] = go("c", "a", "e_x") } },
  { "dead-end", "a state without an exit", { c = state {}, [4] = go("a", "c", "e_c") },
    "root.c" .. NO_EXIT },
  { "dead-end", "no state without an exit that is final",
    { c = state { final = true }, [4] = go("a", "c", "e_c") } },
  { "dead-end", "no state in a composite that has an exit",
    { c = x_in_c(), [4] = go("a", "c", "e_c"), [5] = go("c", "a", "e_x") } },
  { "closed", "a connector that leads nowhere", via_k(),
    "root.k: no way out of this connector, so that no transition to it is ever taken" },
  { "closed", "no connector that leads on", via_k(go("k", "b")) },
  { "connector-cycle", "connectors in a circle", {
    j = conn {}, k = conn {}, [4] = go("a", "k", "e_k"), [5] = go("k", "j"),
    [6] = go("j", "k", nil, { guard = yes }), [7] = go("j", "b") },
    "root.j: connectors in a circle: root.j -> root.k -> root.j" },
  { "connector-cycle", "no circle that a state is in", {
    j = conn {}, k = conn {}, [4] = go("a", "k", "e_k"), [5] = go("k", "j"),
    [6] = go("j", "a") } },
  { "connector-cycle", "once, a circle to which another connector leads", {
    h = conn {}, j = conn {}, k = conn {}, [4] = go("a", "h", "e_h"),
    [5] = go("h", "j"), [6] = go("j", "k"), [7] = go("k", "j"), [8] = go("k", "b") },
    "root.j: connectors in a circle: root.j -> root.k -> root.j" },
  { "closed-initial", "a composite that a guard can close",
    entered_by(go("initial", "x", nil, { guard = yes })),
    "root.c.initial: each transition from here has events or a guard, 'root.c' cannot "
      .. "be entered on e_c while none of them is enabled" },
  { "closed-initial", "one that waits for an event that does not lead there",
    entered_by(go("initial", "x", "e_other")), "root.c.initial: each transition from "
      .. "here has events or a guard, 'root.c' cannot be entered on e_c while none of "
      .. "them is enabled" },
  { "closed-initial", "none that is entered on the events it names",
    entered_by(go("initial", "x", { "e_b", "e_c" })) },
  { "closed-initial", "a root that a guard can close",
    { [1] = go("initial", "a", nil, { guard = yes }) },
    "root.initial: each transition from here has events or a guard, 'root' cannot be "
      .. "entered on e_init_fsm while none of them is enabled" },
  { "no-default", "a connector all of whose transitions have guards",
    via_k(go("k", "b", nil, { guard = yes }), go("k", "a", nil, { guard = yes })),
    "root.k: no way on without a guard for e_k" },
  { "no-default", "a connector that has no transition for an event",
    via_k(go("k", "b", "e_other")), "root.k: no way on without a guard for e_k" },
  { "no-default", "a connector behind another one",
    { j = conn {}, k = conn {}, [4] = go("a", "k", "e_k"), [5] = go("k", "j"),
      [6] = go("j", "b", nil, { guard = yes }) },
    "root.j: no way on without a guard for e_k" },
  { "no-default", "a connector behind one that only some events pass",
    { j = conn {}, k = conn {}, [4] = go("a", "k"), [5] = go("k", "j", "e_j"),
      [6] = go("k", "b"), [7] = go("j", "b", nil, { guard = yes }) },
    "root.j: no way on without a guard for e_j" },
  { "no-default", "a connector that is reached on any event",
    { k = conn {}, [4] = go("a", "k"), [5] = go("k", "b", "e_b") },
    "root.k: no way on without a guard for any event" },
  { "no-default", "none that has a default",
    via_k(go("k", "b", nil, { guard = yes }), go("k", "a")) },
  { "shadowed", "a transition that an outer one always beats",
    in_composite { src = "c", tgt = "a", events = { "e_x" } },
    "root.c.trans[2] (x -> y)" .. BY_5 },
  { "shadowed", "transitions that one on any event beats",
    in_composite { src = "c", tgt = "a" }, "root.c.trans[2] (x -> y)" .. BY_5,
    "root.c.trans[3] (y -> x)" .. BY_5 },
  { "shadowed", "none that one with a guard may beat",
    in_composite { src = "c", tgt = "a", guard = yes } },
  { "shadowed", "none beside one on another event",
    in_composite { src = "c", tgt = "a", events = { "e_z" } } },
  { "shadowed", "one that a sibling of larger pn always beats",
    { [4] = go("a", "b", "e_x", { pn = 1 }) }, "root.trans[2] (a -> b)" .. BY_4 },
  { "shadowed", "one that two others beat, each on one of its events",
    { [4] = go("a", "b", "e_y", { pn = 1 }), [5] = go("a", "a", { "e_x", "e_y" }) },
    "root.trans[5] (a -> a): never taken, root.trans[2] (a -> b) and root.trans[4] "
      .. "(a -> b) always come first" },
  { "shadowed", "none beside one through a connector that may be closed", {
    k = conn {}, [4] = go("a", "k", "e_x", { pn = 1 }),
    [5] = go("k", "b", nil, { guard = yes }) } },
  { "shadowed", "one that one through a connector always beats",
    { k = conn {}, [4] = go("a", "k", "e_x", { pn = 1 }), [5] = go("k", "b") },
    "root.trans[2] (a -> b)" .. NEVER_TAKEN:format("root.trans[4] (a -> k)") },
  { "shadowed", "none beside one that leads to connectors in a circle",
    { j = conn {}, k = conn {}, [4] = go("a", "k", "e_x", { pn = 1 }),
      [5] = go("k", "j"), [6] = go("j", "k") } },
  { "conflict", "guards that may both be true",
    { [4] = go("a", "b", "e_y", { guard = yes }),
      [5] = go("a", "a", "e_y", { guard = yes }) },
    "root.trans[5] (a -> a): enabled together with root.trans[4] (a -> b) on e_y, and "
      .. "of the same pn" },
  { "conflict", "events that are partly the same",
    { [4] = go("a", "a", { "e", "e_x" }) },
    "root.trans[4] (a -> a): enabled together with root.trans[2] (a -> b) on e_x, and "
      .. "of the same pn" },
  { "conflict", "none between different pn",
    { [4] = go("a", "b", "e_y", { guard = yes, pn = 1 }),
      [5] = go("a", "a", "e_y", { guard = yes }) } },
  { "conflict", "none between a guard and a default behind it",
    { [4] = go("a", "b", "e_y", { guard = yes }), [5] = go("a", "a", "e_y") } },
  { "endless", "leaves that need no event",
    { c = state {}, [4] = go("b", "c", "e_done"), [5] = go("c", "b") },
    "root.b: run never becomes idle, no event is needed on root.b -> root.c "
      .. "-> root.b" },
  { "endless", "a leaf that enters itself again", { [4] = go("b", "b", "e_done") },
    "root.b: run never becomes idle, no event is needed on root.b -> root.b" },
  { "endless", "none with a guard",
    { [4] = go("b", "b", "e_done", { guard = yes }) } },
  { "endless", "none with a doo",
    { b = state { doo = busy }, [4] = go("b", "b", "e_done") } },
  { "endless", "none that a callback can leave",
    { b = state { entry = yes }, [4] = go("b", "b", "e_done") } },
  { "endless", "none that an effect can leave",
    { [4] = go("b", "b", "e_done", { effect = yes }) } },
  { "endless", "one with a callback, if there is no way out",
    { b = state { entry = yes }, [3] = go("b", "b", "e_done", { effect = yes }) },
    "root.b: run never becomes idle, no event is needed on root.b -> root.b" },
  { "endless", "one whose only effect is on the way out",
    { [3] = go("b", "a", "e_x", { effect = yes }), [4] = go("b", "b", "e_done") },
    "root.b: run never becomes idle, no event is needed on root.b -> root.b" },
  { "endless", "none over connectors in a circle",
    { j = conn {}, k = conn {}, [4] = go("b", "j", "e_done"), [5] = go("j", "k"),
      [6] = go("k", "j") } },
  { "endless", "none that takes nothing again, an internal one",
    { [4] = go("b", "internal", "e_done") } },
  { "false-guard", "a guard that is false", { [4] = go("a", "b", "e_y",
    { guard = false }), c = state { x = state {}, go("initial", "x", nil,
      { guard = false }) }, [5] = go("a", "c", "e_c"), [6] = go("c", "a", "e_c") },
    "root.c.trans[1] (initial -> x): its guard is false and counts as absent, it was "
      .. "made while the chart was loaded",
    "root.trans[4] (a -> b): its guard is false and counts as absent, it was made "
      .. "while the chart was loaded" },
  { "false-guard", "none that is a function, or absent",
    { [4] = go("a", "b", "e_y", { guard = yes }) } },
  { "any-event", "a transition of a state without events",
    { c = state {}, [4] = go("a", "c", "e_c"), [5] = go("c", "a") },
    "root.trans[5] (c -> a): it has no events, and is taken on any" },
  { "any-event", "that others in the leaf cannot come before",
    { [4] = go("b", "a", {}, { pn = -1 }), b = state { doo = function() end } },
    "root.trans[4] (b -> a): it has no events, and is taken on any, before "
      .. "root.trans[3] (b -> a) can be" },
  { "any-event", "that others may come before, as a doo has a loop",
    { [4] = go("b", "a", {}, { pn = -1 }), b = state { doo = function(fsm)
      while fsm.is_busy do fsm.count = 1 end
    end } },
    "root.trans[4] (b -> a): it has no events, and is taken on any" },
  { "any-event", "none of a connector", via_k(go("k", "b")) },
  { "empty-events", "a list of events without any", { [4] = go("b", "a", {}) },
    "root.trans[4].events (b -> a): an empty list, any event triggers it (is a name in "
      .. "it nil? if any event is meant, leave it out)" },
  { "empty-events", "none where there is no list", { [4] = go("b", "a") } },
  { "never-done", "an e_done@F of no leaf", { [4] = go("a", "b", "e_done@root.z") },
    "root.trans[4] (a -> b): event 'e_done@root.z' never comes, 'root.z' is no leaf "
      .. "state of this machine" },
  { "never-done", "the e_done of a composite, once",
    { c = x_in_c(), [4] = go("a", "c", "e"), [5] = go("c", "a", "e_done") },
    "root.trans[5] (c -> a): event 'e_done@root.c' never comes, no leaf right in "
      .. "'root.c' is final (final = true)" },
  { "idle-reaction", "an e_fault where nothing can fail",
    { [4] = go("a", "b", "e_fault"), [5] = go("b", "a", "e_fault", { effect = yes }) },
    "root.trans[4] (a -> b): 'e_fault@root.a' never comes, 'root.a' has no callback" },
  { "init", "a time event, or an await, of a connector", { k = conn {},
    [4] = go("a", "k", "e_k"), [5] = go("k", "b", { "e_every(1)", "await(e_k)" }) },
    "root.trans[5].events (k -> b): 'e_every(1)' never fires here, 'root.k' is no "
      .. "state",
    "root.trans[5].events (k -> b): 'await(e_k)' never fires here, 'root.k' is no "
      .. "state" },
  { "never-done", "an await in a composite without an end", { c = state { p = state {},
      go("initial", "p") }, [4] = go("a", "c", "e"),
    [5] = go("c", "a", { "await(e_x, e_done)" }), [6] = go("b", "a", "e_x") },
    "root.trans[5].events (c -> a): 'e_done' never fires here, 'root.c' is no leaf, "
      .. "and has no final leaf" },
  { "never-done", "none of a leaf", { [4] = go("a", "b", "e_done@root.b") } },
  { "never-called", "callbacks of a connector, a state and a transition", {
    k = conn { entry = yes }, [4] = go("a", "k", "e"), [5] = go("k", "a", nil,
      { doo = yes }), b = state { guard = yes } },
    "root.trans[5] (k -> a): a transition has no field 'doo' (a state has it)",
    "root.b: a state has no field 'guard' (a transition has it)",
    "root.k: a connector has no field 'entry' (a state has it)" },
  { "never-called", "none where they belong", { b = state { entry = yes },
    [4] = go("a", "a", "e", { guard = yes, effect = yes }) } },
  { "shadowed", "none behind a connector that the path has passed", { k = conn {},
    [4] = go("a", "k", "e"), [5] = go("k", "k"), [6] = go("k", "b") } },
  { "typo", "two letters in reverse",
    { [4] = go("a", "a", "e_start"), [5] = go("b", "b", "e_start"),
      [6] = go("b", "a", "e_strat") },
    "root.trans[6] (b -> a): no other transition uses 'e_strat' (did you mean "
      .. "'e_start'?)" },
  { "typo", "a letter too many, or another case",
    { [4] = go("a", "a", { "e_button", "e_Go" }),
      [5] = go("b", "b", { "e_buttton", "e_go" }) },
    "root.trans[5] (b -> b): no other transition uses 'e_buttton' (did you mean "
      .. "'e_button'?)", "root.trans[5] (b -> b): no other transition uses 'e_go' (did "
      .. "you mean 'e_Go'?)" },
  { "typo", "a letter in place of another, where that one is used twice",
    { [4] = go("a", "a", { "e_start", "e_packed" }), [5] = go("b", "b", "e_stert"),
      [6] = go("b", "a", { "e_start", "e_picked" }) },
    "root.trans[5] (b -> b): no other transition uses 'e_stert' (did you mean "
      .. "'e_start'?)" },
  { "typo", "the first of several that look alike",
    { [4] = go("a", "a", { "e_stars", "e_start_later", "e_start" }),
      [5] = go("b", "b", { "e_start_laetr", "e_start", "e_strat" }) },
    "root.trans[5] (b -> b): no other transition uses 'e_start_laetr' (did you mean "
      .. "'e_start_later'?)",
    "root.trans[5] (b -> b): no other transition uses 'e_strat' (did you mean "
      .. "'e_start'?)" },
  { "typo", "a word of the library", { [4] = go("a", "b", "efaults"),
    [5] = go("b", "a", "eDone") },
    "root.trans[4] (a -> b): no other transition uses 'efaults' (did you mean "
      .. "'e_fault'?)", "root.trans[5] (b -> a): no other transition uses 'eDone' (did "
      .. "you mean 'e_done'?)" },
  { "typo", "none of words of their own",
    { [4] = go("a", "a", { "e_lock", "e_close", "e_left", "e_goto_a", "e_arm1",
        "e_gripperL" }),
      [5] = go("b", "b", { "e_block", "e_closed", "e_lift", "e_goto_b", "e_arm2",
        "e_gripperR" }) } },
  { "odd-event", "a comma in a name, and a list",
    { [4] = go("a", "b", "e_a, e_b"), [5] = go("b", "a", { { "e_a" } }) },
    "root.trans[4] (a -> b): 'e_a, e_b' is one event with a comma in its name",
    "root.trans[5] (b -> a): a list that holds 'e_a' is one event" },
  { "odd-event", "a blank or a bar in a name",
    { [4] = go("a", "b", "e_a e_b"), [5] = go("b", "a", "e_a|e_b"),
      [6] = go("b", "a", { "e_c ", "e_after 2" }) },
    "root.trans[4] (a -> b): 'e_a e_b' is one event with a blank in its name",
    "root.trans[5] (b -> a): 'e_a|e_b' is one event with a '|' in its name",
    "root.trans[6] (b -> a): 'e_c ' is one event with a blank in its name (did you "
      .. "mean 'e_c'?)",
    "root.trans[6] (b -> a): 'e_after 2' is one event with a blank in its name (did "
      .. "you mean 'e_after(2)'?)" },
  { "odd-event", "a word of an extension without its call",
    { [4] = go("a", "b", "e_every"), [5] = go("b", "a", "e_everything") },
    "root.trans[4] (a -> b): 'e_every' is the name of an event like any other (did you "
      .. "mean 'e_every(...)'?)" },
  { "odd-event", "a call that is not closed",
    { [4] = go("a", "b", "e_after(2"), [5] = go("b", "a", { "(-:", "e(1)(" }) },
    "root.trans[4] (a -> b): 'e_after(2' is the name of an event like any other (did "
      .. "you mean 'e_after(2)'?)" },
  { "odd-event", "nothing that somebody says", { [4] = go("a", "b", { "come here",
    "go on, please", "stop" }), [5] = go("b", "a", "it is done") } },
  { "odd-event", "none in the name of a state, or in parentheses", {
    ["c d"] = state {}, [4] = go("c d", "b", { "e_done", "e_after( 2 )" }),
    [5] = go("b", "c d", "e_x") } },
  { "odd-event", "no event of an extension, and no object", { [4] = go("a", "b",
    { "await(e_a, e_b)", { x = 1 }, setmetatable({ "x" }, {}) }) } },
  { "early-idle", "a region that waits for e_done",
    { [4] = go("a", "c", "e_c"), [5] = go("c", "a", "e_a"),
      c = rfsm.seqand { x = chart { [2] = go("a", "b", "e_done") } } },
    "root.c: run returns while events of the region 'x' still wait" },
  { "early-idle", "a region inside a region, and one that waits for e_fault",
    { [4] = go("a", "c", "e_c"), [5] = go("c", "d", "e_a"), [6] = go("d", "a", "e_a"),
      c = rfsm.seqand { x = state { info = false, warn = false, go("initial", "y"),
        y = rfsm.seqand { idle_doo = "auto",
          z = chart { [2] = go("a", "b", "e_done") } } } },
      d = rfsm.seqand { x = chart { [2] = go("a", "b", "e_fault") } } },
    "root.c: run returns while events of the region 'x' still wait",
    "root.d: run returns while events of the region 'x' still wait" },
  { "early-idle", "none with idle_doo, run, or a region of one step",
    { [4] = go("a", "c", "e_c"), [5] = go("c", "a", "e_a"), [6] = go("c", "d", "e_d"),
      [7] = go("d", "a", "e_a"), [8] = go("d", "e", "e_e"), [9] = go("e", "a", "e_a"),
      c = rfsm.seqand { idle_doo = "auto", x = chart { [2] = go("a", "b", "e_done") } },
      d = rfsm.seqand { run = true, x = chart { [2] = go("a", "b", "e_done") } },
      e = rfsm.seqand { x = chart() } } },
  { "once", "an e_after that an internal transition takes",
    { [4] = go("a", "internal", "e_after(1)") },
    "root.trans[4] (a -> internal): 'e_after(1)' comes once an entry, and an internal "
      .. "transition enters nothing" },
  { "once", "none of an e_every", { [4] = go("a", "internal", "e_every(1)") } },
  { "unknown-word", "an event that looks like a call",
    { [4] = go("a", "b", "every(1)") },
    "root.trans[4].events (a -> b): no loaded extension knows 'every(1)' (did you mean "
      .. "'e_every(...)'?)" },
  { "unknown-word", "none with the text of a stub in it", { [4] = go("a", "b",
    "every(" .. stubs.new "config".seconds .. ")") } },
  { "unknown-word", "none of an extension", { [4] = go("a", "b", "e_after(1)") } },
  { "unknown-field", "a field in other words",
    { [4] = go("a", "b", "e", { action = yes }) }, "root.trans[4] (a -> b): a "
      .. "transition has no field 'action' (did you mean 'effect'?)" },
  { "unknown-field", "true and false in a field that is nearly there",
    { debug = true, wran = false, a = state { finl = true } },
    "root: a state has no field 'debug' (did you mean 'dbg'?)",
    "root: a state has no field 'wran' (did you mean 'warn'?)",
    "root.a: a state has no field 'finl' (did you mean 'final'?)" },
  { "unknown-field", "a flag that is nearly there, or a text, or of another element",
    { a = state { always = true }, b = state { timed = "1" },
      [4] = go("a", "b", nil, { Always = true }),
      [5] = go("b", "a", nil, { always = "yes" }) },
    "root.b: timed: true expected, got string '1' (timed = true)",
    "root.trans[4] (a -> b): a transition has no field 'Always' (did you mean "
      .. "'always'?)",
    "root.trans[5] (b -> a): always: true expected, got string 'yes' (always = true)",
    "root.a: a state has no field 'always' (a transition has it)" },
  { "unknown-field", "a field of another element, or a value that is nearly right",
    { read = "One", a = state { read = "one" }, b = conn { history = "deep" },
      [4] = go("a", "b", "e", { timed = true, defer = { "e" } }) },
    "root: read: 'one' or 'all' expected, got string 'One' (did you mean 'one'?)",
    "root.trans[4] (a -> b): a transition has no field 'defer' (a state has it)",
    "root.trans[4] (a -> b): a transition has no field 'timed' (a state has it)",
    "root.a: a state has no field 'read' (the root has it)",
    "root.b: a connector has no field 'history' (a state has it)" },
  { "unknown-field", "a word in a field that is nearly there", { Read = "one",
    reads = 7 }, "root: a state has no field 'Read' (did you mean 'read'?)" },
  { "unknown-field", "a word that is nearly right", { read = "on" },
    "root: read: 'one' or 'all' expected, got string 'on' (did you mean 'one'?)" },
  { "unknown-field", "a name in keep that is nearly a field of the chart",
    { keep = { "payd", "cout", "who", "n" }, paid = 0, n = 0, a = state { entry =
      function(fsm) fsm.count = (fsm.count or 0) + (fsm.who or 1) end },
      b = state { keep = { "speld", "m1" }, speed = 1, m2 = 2 } },
    "root: keep: the root has no field 'payd' (did you mean 'paid'?)",
    "root: keep: the root has no field 'cout' (did you mean 'count'?)",
    "root.b: keep: the state has no field 'speld' (did you mean 'speed'?)",
    "root.b: keep: the state has no field 'm1' (did you mean 'm2'?)" },
  { "unknown-field", "none that is kept beside another, or is no word of the chart",
    { keep = { "m1", "m2", "item" }, m2 = 2 },
    "root: keep: the root has no field 'm1' (the program may write it)",
    "root: keep: the root has no field 'item' (the program may write it)" },
  { "unknown-field", "letters in reverse, missing and replaced",
    { raed = "one", kep = { "x" }, [4] = go("a", "b", "e", { effekt = yes }),
      b = state { entri = yes, kep = 1, raed = "x" } },
    "root.b: a state has no field 'entri' (did you mean 'entry'?)",
    "root.trans[4] (a -> b): a transition has no field 'effekt' (did you mean "
      .. "'effect'?)",
    "root: a state has no field 'kep' (did you mean 'keep'?)",
    "root: a state has no field 'raed' (did you mean 'read'?)" },
  { "unmarked", "a function and a number that should be regions",
    { [4] = go("a", "c", "e_c"), [5] = go("c", "a", "e_a"), c = rfsm.seqand {
      x = chart(), y = chart, z = 5, limit = 3, step = 2, seqanddbg = yes,
      entry = function(_, c) return c.limit end } },
    "root.c: 'y' is a function and no region (did you mean y = y()?)",
    "root.c: 'z' is a number and no region (a region is a state)" },
  { "unknown-field", "a number in place of a word", { read = 1 },
    "root: read: 'one' or 'all' expected, got number 1" },
  { "unknown-field", "no data of the user's", { read = 2 } },
  { "unknown-field", "a field of an extension in another element",
    { a = state { likely = yes, strict = true } },
    "root.a: a state has no field 'likely' (a transition has it)",
    "root.a: a state has no field 'strict' (the root has it)" },
  { "unknown-field", "a field that is nearly one of a sequential AND state",
    { [4] = go("a", "c", "e_c"), [5] = go("c", "a", "e_a"), c = rfsm.seqand {
      idledoo = "auto", steps = 2, read = "one", x = chart() } },
    "root.c: a sequential AND state has no field 'idledoo' (did you mean 'idle_doo'?)",
    "root.c: a state has no field 'read' (the root has it)",
    "root.c: a sequential AND state has no field 'steps' (did you mean 'step'?)" },
  { "unknown-field", "none of the user's with such a name", { read = "me",
    [4] = go("a", "c", "e_c", { history = {}, timed = 1 }), [5] = go("c", "a", "e_a"),
    c = rfsm.seqand { idle_doo = "auto", steps = {}, border = 1, x = chart() } } },
  { "unknown-field", "none of the user's, true or not",
    { [4] = go("a", "b", "e", { finl = true }),
      a = state { done = true, final = 1 } } },
  { "unknown-field", "none of the user's",
    { [4] = go("a", "b", "e", { note = "x" }) } },
  { "unmarked", "a state that was not marked", { c = { x = state {} } },
    "root.c: a plain table that contains states or transitions is ignored (did you "
      .. "mean rfsm.state{...}?)" },
  { "unmarked", "no table of the user's", { c = { x = 1 } } },
  { "misplaced", "a transition inside a leaf",
    { b = state { go("root.b", "root.a", "e") } }, "root.b: a transition inside a leaf "
      .. "state" },
  { "misplaced", "transitions in a sequential AND state, once",
    { [4] = go("a", "c", "e_c"), [5] = go("c", "a", "e_c"), c = rfsm.seqand {
      x_in_c(), go("initial", "1"), go("1", "2", "e") } },
    "root.c: a transition in a sequential AND state, it belongs into a region (none "
      .. "leads from one region to another)" },
  { "misplaced", "those in a region, once, with its path",
    { [4] = go("a", "c", "e_c"), [5] = go("c", "a", "e_c"), c = rfsm.seqand {
      x = state { x = state { go("x", "x") }, y = rfsm.seqand { go("x", "x") },
        go("initial", "x"), go("x", "y", "e") } } },
    "root.c.x: root.y: a transition in a sequential AND state, it belongs into a "
      .. "region (none leads from one region to another)",
    "root.c.x: root.x: a transition inside a leaf state" },
  { "misplaced", "none around it", { [4] = go("b", "a", "e") } },
  { "silence", "a code that does not exist, and one without a reason",
    { b = state { checks = { ["dead-ent"] = "no", typo = "" } } },
    "root.b: checks: no check has the code 'dead-ent' (did you mean 'dead-end'?)",
    "root.b: checks['typo']: a reason expected, got an empty string" },
  { "silence", "none with a reason", { b = state { checks = { typo = "it is" } } } },
}

describe("the code", function()
  for _, case in ipairs(CASES) do
    it(case[1] .. " finds " .. case[2], function()
      assert.same({ case[4], case[5], case[6], case[7], case[8] },
        findings_of(chart(case[3]), case[1]))
    end)
  end

  it("stands for nothing in a sound chart", function()
    assert.same({}, findings_of(chart()))
  end)
end)

describe("a field of a state", function()
  for field, flag in pairs { -- any order: each is a spec of its own
    debug = "dbg", er = "err", inf = "info", strct = "strict", wran = "warn",
  } do
    it(("that is nearly '%s' is found in the root"):format(flag), function()
      assert.same({ ("root: a state has no field '%s' (did you mean '%s'?)"):format(
        field, flag) }, findings_of(chart { [field] = true }, "unknown-field"))
    end)
  end

  local CASES_OF_FIELDS = { -- fields of a composite, the findings
    { { history = "deep" }, "history' (require \"rfsm.history\")" },
    { { history = "shallow" }, "history' (require \"rfsm.history\")" },
    { { history = true }, "history' (require \"rfsm.history\")" },
    { { history = "of Rome" } }, { { history = false } },
    { { type = "final" }, "type' (did you mean final = true?)" },
    { { type = "final", final = true } }, { { type = "red" } },
    { { type = "parallel" }, "type' (did you mean rfsm.seqand{...}?)" },
    { { parallel = true }, "parallel' (did you mean rfsm.seqand{...}?)" },
    { { parallel = false } },
  }
  for i, case in ipairs(CASES_OF_FIELDS) do
    it("may be meant for another library or extension: case " .. i, function()
      local c = x_in_c()
      for field, value in pairs(case[1]) do c[field] = value end -- any order: a set
      helper.with(package.loaded, { ["rfsm.history"] = false }, function()
        assert.same({ case[2] and "root.c: a state has no field '" .. case[2] },
          findings_of(chart { c = c }, "unknown-field"))
      end)
    end)
  end

  it("is no finding if the extension that reads it is loaded, or in a leaf", function()
    local leaf = chart { c = state { history = "deep" } }
    helper.with(package.loaded, { ["rfsm.history"] = false }, function()
      assert.same({}, findings_of(leaf, "unknown-field"))
    end)
    local c = x_in_c()
    c.history = "deep"
    helper.with(package.loaded, { ["rfsm.history"] = true }, function()
      assert.same({}, findings_of(chart { c = c }, "unknown-field"))
    end)
  end)

  it("final is a boolean", function()
    assert.same({ "root.a: final: true expected, got string 'yes' (final = true)" },
      findings_of(chart { a = state { final = "yes" } }, "unknown-field"))
  end)
end)

describe("a callback that is never called", function()
  local FIELDS = { "entry", "exit", "doo", "guard", "effect" }
  local CALLED = { state = "entry exit doo", transition = "guard effect",
    connector = "" }

  for _, kind in ipairs { "state", "transition", "connector" } do
    it("is any of a " .. kind .. " but " .. CALLED[kind], function()
      local expected, members = {}, { k = conn {}, c = state { final = true },
        [4] = go("a", "k", "e_k"), [5] = go("k", "c") }
      local obj = ({ state = members.c, transition = members[4],
        connector = members.k })[kind]
      for _, field in ipairs(FIELDS) do
        obj[field] = yes
        if not CALLED[kind]:find(field) then
          expected[#expected + 1] = ("a %s has no field '%s'"):format(kind, field)
        end
      end
      local texts = findings_of(chart(members), "never-called")
      for i = 1, #texts do texts[i] = texts[i]:match(": (a .-) %(") end
      table.sort(texts)
      table.sort(expected)
      assert.same(expected, texts)
      assert.same({}, findings_of(chart(members), "init")) -- each mistake is told once
    end)
  end
end)

describe("a field", function()
  it("with a slip of the pen, or of another kind of element, is told", function()
    assert.is_nil(share.problem(require "spec.support.claims.fields", 15))
  end)

  it("that is a time in another library is noted", function()
    assert.same({ "root.trans[4] (a -> b): a transition has no field 'timeout' (events "
      .. "= { 'e_after(3)' })", "root.a: a state has no field 'after' (a transition "
      .. "beside the state: events = { 'e_after(2)' })" }, findings_of(chart {
      a = state { after = 2, timeout = "soon" },
      [4] = go("a", "b", "e", { timeout = 3 }) }, "unknown-field"))
  end)

  it("that the chart itself reads is the user's", function()
    assert.same({}, findings_of(chart { a = state { timeout = 3, order = { "x" },
      entry = function(_, s) return s.timeout, s.order end } }, "unknown-field"))
  end)
end)

describe("a sequential AND state", function()
  it("without regions is told", function()
    assert.same({ "root.c: a sequential AND state without a region (a region is a "
      .. "state)" }, findings_of(chart { c = rfsm.seqand {}, [4] = go("a", "c", "e"),
      [5] = go("c", "a", "e_c") }, "unmarked"))
  end)
end)

describe("each code", function()
  local function has_case(code, has_finding)
    for _, case in ipairs(CASES) do
      if case[1] == code and (case[4] ~= nil) == has_finding then return true end
    end
    return false
  end

  local codes = require "rfsm.checks.codes"
  local OTHERS = { invalid = true, init = true, trap = true, violated = true,
    deadlock = true, overflow = true, untaken = true, ["idle-wire"] = true,
    deployed = true,
    undefined = true, ["no-value"] = true, ["no-yield"] = true, ["busy-doo"] = true,
    ["doo-ends"] = true, called = true, lost = true, parameters = true,
    ["wrong-call"] = true, ["idle-hook"] = true, ["idle-reaction"] = true,
    unwired = true }
  for _, entry in ipairs(codes.list) do
    if not OTHERS[entry.code] then
      it("has a chart that shows it, and one that does not: " .. entry.code, function()
        assert.is_true(has_case(entry.code, true))
        assert.is_true(has_case(entry.code, false))
      end)
    end
  end
end)

describe("findings", function()
  it("have a code, a severity, a place and a hint", function()
    assert.same({
      code = "unreachable", severity = "warning", place = "root.c",
      text = "unreachable, no path of transitions leads here",
      hint = "see which transition leads to it, or remove it",
    }, (function()
      local finding = rfsm_checks.findings(chart { c = state {} })[1]
      assert.matches("^spec/checks_spec.lua:%d+: $", finding.file)
      finding.file = nil
      return finding
    end)())
  end)

  it("are left out where their element expects them, with a reason", function()
    local function risky(checks)
      return chart { c = state { checks = checks }, [4] = go("a", "b", "every(1)",
        { checks = checks }) }
    end
    assert.equal(2, #findings_of(risky(nil)))
    assert.same({},
      findings_of(risky { unreachable = "later", ["unknown-word"] = "mine" }))
    assert.equal(2, #findings_of(risky { unreachable = " " }, "silence"))
  end)

  -- A code, what there is besides a and b, the severity.
  for _, case in ipairs {
    { "any-event", { [3] = go("b", "a") }, "note" },
    { "any-event", { [4] = go("b", "a", {}, { pn = 1 }) }, "warning" },
    { "dead-end", { b = state {}, [3] = go("a", "b", "e_y") }, "note" },
    { "dead-end", { FAILED = state {}, [4] = go("a", "FAILED", "e_y") }, "note" },
    { "dead-end", { c = state {}, [4] = go("a", "c", "e_y") }, "warning" },
  } do
    it(("of code %s may be a %s"):format(case[1], case[3]), function()
      local severities = {}
      for _, finding in ipairs(rfsm_checks.findings(chart(case[2]))) do
        if finding.code == case[1] then
          severities[#severities + 1] = finding.severity
        end
      end
      assert.same({ case[3] }, severities)
    end)
  end

  it("have the severity that a project sets", function()
    local model = chart { c = state {} }
    assert.equal("error",
      rfsm_checks.findings(model, { unreachable = "error" })[1].severity)
    assert.same({}, rfsm_checks.findings(model, { unreachable = "off" }))
  end)

  it("refuse a setting that is wrong", function()
    local _, text = pcall(function()
      return (rfsm_checks.findings(chart(), { typos = "off" }))
    end)
    assert.matches("checks_spec.lua:%d+: rfsm_checks.findings: settings: no check has "
      .. "the code 'typos' %(did you mean 'typo'%?%)", text)
  end)
end)

describe("rfsm.checkevents", function()
  -- In another Lua, since nothing takes the module back.
  it("watches each machine that is initialised afterwards, and none before", function()
    assert.equal("after: " .. undeclared "e_y", (helper.output_of([[
      package.path = "./?.lua;" .. package.path
      local rfsm, checks = require "rfsm", require "rfsm_checks"
      local function started(name)
        local fsm = rfsm.init(rfsm.state { info = false,
          warn = function(text) print(name .. ": " .. text) end,
          a = rfsm.state {},
          rfsm.trans { src = "initial", tgt = "a" },
          rfsm.trans { src = "a", tgt = "a", events = "e_x" } })
        rfsm.run(fsm)
        return fsm
      end
      local before = started "before"
      rfsm.fsm_merge(before, before,
        rfsm.trans { src = "a", tgt = "a", events = "e_new" })
      assert(require "rfsm.checkevents" == checks)
      for _, fsm in ipairs { before, started "after" } do
        rfsm.send_events(fsm, "e_y")
        rfsm.run(fsm)
      end
    ]])))
  end)
end)
