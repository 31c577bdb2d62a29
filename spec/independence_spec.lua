-- Regions of sequential AND states that nothing joins: explored one by one.

local claim = require "spec.support.claims.independence"
local records = require "rfsm.record"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local share = require "spec.support.share"
require "rfsm_timeevent"

local state, trans = rfsm.state, rfsm.trans
local never, after = rfsm_checks.never, rfsm_checks.after

-- a region: a ring of so many states, on one event
local function ring(count, event, fields)
  local region = { trans { src = "initial", tgt = "s1" } }
  for i = 1, count do
    region["s" .. i] = state {}
    region[i + 1] = trans { src = "s" .. i, tgt = "s" .. i % count + 1,
      events = { event } }
  end
  for name, value in pairs(fields or {}) do region[name] = value end
  return state(region)
end

-- off --e_on--> par --e_off--> off
local function chart(regions, members)
  local model = { info = false, warn = false, off = state {},
    par = rfsm.seqand(regions), trans { src = "initial", tgt = "off" },
    trans { src = "off", tgt = "par", events = { "e_on" } },
    trans { src = "par", tgt = "off", events = { "e_off" } } }
  for key, value in pairs(members or {}) do model[key] = value end
  return state(model)
end

local function rings(count, states)
  local regions = {}
  for i = 1, count do regions["r" .. i] = ring(states, "e" .. i) end
  return chart(regions)
end

local function is_apart(model, options)
  local result = rfsm_checks.explore(model, options)
  return result.premises:find("; independent regions one by one", 1, true) ~= nil
end

describe("regions that nothing joins", function()
  it("are not multiplied", function()
    local result = rfsm_checks.explore(rings(5, 10))
    assert.equal(60, result.configurations)
    assert.equal("one event a step; independent regions one by one", result.premises)
    assert.equal(58, result.taken)
    assert.equal(58, result.transitions)
    assert.equal(0, #result.findings)
  end)

  it("are multiplied on demand", function()
    local result = rfsm_checks.explore(rings(2, 3), { multiply = true })
    assert.equal(11, result.configurations)
    assert.equal("one event a step", result.premises)
  end)

  it("have as many steps as there are", function() -- more than a block of them
    local result = rfsm_checks.explore(rings(4, 6), { multiply = true, properties = {
      rfsm_checks.from "root.par.r1.s1".can_reach "root.par.r4.s6" } })
    assert.equal(6 ^ 4 + 2, result.configurations)
    assert.is_true(result.properties[1].holds)
    assert.equal(0, #result.findings)
  end)

  it("may be inside of regions", function()
    local inner = state { info = false, warn = false,
      par = rfsm.seqand { a = ring(4, "e_a"), b = ring(4, "e_b") },
      trans { src = "initial", tgt = "par" } }
    local result = rfsm_checks.explore(chart { inner, ring(4, "e_c") })
    assert.equal(18, result.configurations)
    assert.equal(result.transitions, result.taken)
  end)

  local function yes() return true end

  local JOINED = {
    { name = "an event of both", ring(3, "e_x"), ring(3, "e_x") },
    { name = "any event", ring(3, "e_x"), ring(3, "e_y", { [2] =
      trans { src = "s1", tgt = "s2" } }) },
    { name = "a predicate", ring(3, "e_x"), ring(3, yes) },
    { name = "timers", ring(3, "e_after(1)"), ring(3, "e_after(2)") },
    { name = "timers of the machine and of one", ring(3, "e_x"), ring(3, "e_after(2)"),
      timer = trans { src = "par", tgt = "off", events = { "e_after(5)" } } },
    { name = "an await", ring(3, "e_x"), ring(3, "e_y", { [2] =
      trans { src = "s1", tgt = "s2", events = { "await(e_x, e_z)" } } }) },
    { name = "a callback that is called", ring(3, "e_x"),
      ring(3, "e_y", { entry = yes }), options = { run = { yes } } },
    { name = "a rule", ring(3, "e_x"), ring(3, "e_y", { [2] =
      trans { src = "s1", tgt = "s2", events = { "e_y" }, guard = yes } }),
      options = { same = { yes } } },
    { name = "a dry run", ring(3, "e_x"), ring(3, "e_y"),
      options = { dry_run = true } },
    { name = "the end of both", ring(1, "e_x", { s1 = state { final = true } }),
      ring(3, "e_y", { s3 = state { final = true } }),
      timer = trans { src = "par", tgt = "off", events = { "e_done" } } },
    { name = "a target that may be written", ring(3, "e_x"), ring(3, "e_y", {
      entry = function(fsm) fsm[2].tgt = fsm.s1 end }) },
  }
  for _, case in ipairs(JOINED) do
    it("are joined by " .. case.name, function()
      require "rfsm.await"
      assert.is_false(is_apart(chart({ case[1], case[2] }, { [4] = case.timer }),
        case.options))
    end)
  end

  local APART = {
    { name = "free timers", ring(3, "e_after(1)"), ring(3, "e_after(2)"),
      options = { timers = "free" } },
    { name = "timers of one", ring(3, "e_x"), ring(3, "e_after(2)") },
    { name = "a callback that the machine calls", ring(3, "e_x"), ring(3, "e_y"),
      entry = yes, options = { run = { yes } } },
  }
  for _, case in ipairs(APART) do
    it("are not joined by " .. case.name, function()
      assert.is_true(is_apart(chart({ case[1], case[2] }, { entry = case.entry }),
        case.options))
    end)
  end

  it("are multiplied if one of them never becomes idle", function()
    local endless = ring(2, "e_done")
    local model = chart({ endless, ring(2, "e_y"), run = true })
    assert.is_false(is_apart(model))
    assert.truthy(tostring(rfsm_checks.explore(model)):find("[endless]", 1, true))
  end)
end)

it("a run without an end is the machine's, whatever regions are looked at", function()
  require "rfsm.always"
  local model = chart({ ring(2, "e_x"), ring(2, "e_y") }, {
    [4] = trans { src = "par", tgt = "par", always = true } })
  for _, multiply in ipairs { false, true } do
    local finding = rfsm_checks.explore(model, { multiply = multiply }).findings[1]
    assert.same({ "endless", "root.par" }, { finding.code, finding.place })
  end
end)

describe("a property of regions", function()
  local FLAGS = { f = { on = { "entry root.par.r1.s2" },
    off = { "exit root.par.r1.s2" } } }
  local CASES = {
    { name = "of one is judged on that", condition = "root.par.r1.s3",
      way = "one by one" },
    { name = "of two is judged on both",
      condition = { "root.par.r1.s2", "root.par.r2.s3" }, way = "one by one" },
    { name = "of all is judged on all",
      condition = { "root.par.r1.s2", "root.par.r2.s3", "root.par.r3.s2" } },
    { name = "is judged with those that set a flag",
      condition = { "f", "root.par.r3.s2" }, way = "one by one" },
    { name = "of a function is judged on all", condition = function(active)
      return active "root.par.r1.s2" and active "root.par.r2.s2"
    end },
  }
  for _, case in ipairs(CASES) do
    it(case.name, function()
      local result = rfsm_checks.explore(rings(3, 3), { flags = FLAGS,
        properties = { p = never(case.condition) } })
      local judged = result.properties[1]
      assert.is_false(judged.holds)
      assert.equal(case.way, judged.premises:match("one by one"))
    end)
  end

  it("counts the regions that react to its event", function()
    local result = rfsm_checks.explore(rings(3, 3), {
      properties = { p = after "e2".reach "root" } })
    assert.is_nil(result.properties[1].vacuous)
  end)

  it("with a time has those with timers", function()
    local model = chart { r1 = ring(3, "e_x"), r2 = ring(3, "e_after(1)"),
      r3 = ring(3, "e_y") }
    local p = rfsm_checks.from "root.par.r1.s2".left_within(5)
    local result = rfsm_checks.explore(model, { properties = { p = p } })
    assert.is_false(result.properties[1].holds)
    assert.equal("one event a step; independent regions one by one; stepped between "
      .. "any two deadlines; steps take no time", result.properties[1].premises)
  end)

  it("knows that regions are joined only when all have ended", function()
    local function ends(event)
      return ring(2, event, { s2 = state { final = true }, [3] = false })
    end
    local model = chart({ ends "e_x", ends "e_y" }, { [4] = trans { src = "par",
      tgt = "z", events = { "e_done" } }, z = state { final = true } })
    local result = rfsm_checks.explore(model, { properties = {
      a = never "root.z", b = rfsm_checks.precedes("root.par.1.s2", "root.z"),
      c = after "e_x".reach "root.z" } })
    assert.same({ false, true, false }, { result.properties[1].holds,
      result.properties[2].holds, result.properties[3].holds })
  end)

  it("knows that regions are never joined if one of them has no end", function()
    local ends = ring(2, "e_x", { s2 = state { final = true } })
    local result = rfsm_checks.explore(chart({ ends, ring(2, "e_y") }, {
      [3] = trans { src = "par", tgt = "off", events = { "e_off", "e_done" } } }))
    assert.equal(0, #result.findings)
    assert.equal(result.transitions, result.taken)
  end)

  it("owes nothing while the machine is not entered", function()
    local function may() return true end
    local model = chart({ ring(2, "e_x"), ring(2, "e_y") },
      { trans { src = "initial", tgt = "par", guard = may } })
    for _, multiply in ipairs { false, true } do
      local result = rfsm_checks.explore(model, { multiply = multiply, properties = {
        p = rfsm_checks.until_("root.off", "root.par") } })
      assert.is_true(result.properties[1].holds)
    end
  end)

  it("holds for a state that the regions cannot leave by themselves", function()
    local model = chart({ ring(1, "e_x"), ring(1, "e_y") },
      { [4] = trans { src = "par", tgt = "off", events = { "e_done" } } })
    for _, multiply in ipairs { false, true } do
      local result = rfsm_checks.explore(model, { multiply = multiply, properties = {
        p = rfsm_checks.after "e_on".leads_to "root.off" } })
      assert.is_false(result.properties[1].holds)
      assert.equal("shadowed", result.findings[2].code)
    end
  end)
end)

describe("a watched machine", function()
  it("looks at regions when they have had the events", function()
    local told = {}
    local model = chart({ r1 = ring(2, "e1") }, { err = function(text)
      told[#told + 1] = text:match("^[^\n]*")
    end })
    local fsm = assert(rfsm.init(model))
    rfsm_checks.watch_properties(fsm, {
      left = after "e1".never "root.par.r1.s1",
      reached = after "e1".reach "root.par.r1.s1" })
    for _, event in ipairs { "e_on", "e1" } do
      rfsm.run(fsm)
      rfsm.send_events(fsm, event)
    end
    rfsm.step(fsm)
    assert.same({}, told)
    rfsm.send_events(fsm, "e1")
    rfsm.step(fsm)
    assert.same({ "property 'left' does not hold" }, told)
  end)

  it("does not wait for the regions if a transition was taken", function()
    local effects = 0
    local function effect() effects = effects + 1 end
    for _, tgt in ipairs { "internal", "par" } do
      local told = {}
      local fsm = assert(rfsm.init(chart({ r1 = ring(2, "e1") }, {
        [4] = trans { src = "par", tgt = tgt, events = { "e_in" }, effect = effect },
        err = function(text) told[#told + 1] = text:match("^[^\n]*") end })))
      rfsm_checks.watch_properties(fsm, { p = after "e_in".never "root.par" })
      rfsm.run(fsm)
      rfsm.send_events(fsm, "e_on")
      rfsm.run(fsm)
      rfsm.send_events(fsm, "e_in")
      rfsm.step(fsm)
      assert.same({ "property 'p' does not hold" }, told)
    end
    assert.equal(2, effects)
  end)
end)

describe("a witness of one region", function()
  local function yes() return true end

  it("has what the other regions are asked, and replays", function()
    local busy = ring(2, "e_y", { [2] = trans { src = "s1", tgt = "s2", guard = yes,
      events = { "e_done" } } })
    local model = chart { a = busy, b = ring(3, "e_x") }
    local result = rfsm_checks.explore(model, {
      properties = { p = never "root.par.b.s3" } })
    local witness, list = result.properties[1].witness, {}
    assert.same({ { who = "root.par.a.trans[2]", answer = false, is_doo = false } },
      witness[3].choices)
    rfsm_checks.record_witness(model, witness, list)
    local fsm = assert(records.replay(model, list, { dry = true }))
    assert.equal("root.s3", rfsm.get_actleaf_fqn(fsm.par.substates.b))
    assert.equal("root.s1", rfsm.get_actleaf_fqn(fsm.par.substates.a))
  end)
end)

describe("a dead end of regions", function()
  -- s1 --event--> s2, the end
  local function one_way(event)
    return state { s1 = state {}, s2 = state {}, trans { src = "initial", tgt = "s1" },
      trans { src = "s1", tgt = "s2", events = { event } } }
  end

  local function dead_ends(b)
    local model = chart({ a = one_way "e_x", b = b })
    model[3] = nil
    local places = {}
    for i, finding in ipairs(rfsm_checks.explore(model).findings) do
      places[i] = finding.code .. " " .. finding.place
    end
    return places
  end

  it("is one if nothing happens in any of them", function()
    assert.same({ "dead-end root.par, root.par.a.s2",
      "dead-end root.par, root.par.b.s2" }, dead_ends(one_way "e_y"))
    assert.same({ "trap root.par, root.par.b.s1" }, dead_ends(ring(2, "e_y")))
  end)
end)

describe(claim.name, function()
  it("agree on random charts", function()
    claim.runs = 5
    assert.is_nil(share.problem(claim, 24, true))
  end)
end)
