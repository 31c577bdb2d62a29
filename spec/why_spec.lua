-- why and enabled: what each transition says to events, and which events count.

local claim = require "spec.support.claims.checks"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local share = require "spec.support.share"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

local function no() return false end

-- A doo that never ends, so that there is no e_done.
local function wait() while true do rfsm.yield(true) end end

-- a -> b, -> k -> b or c, and more; k leads on if a guard lets it
local function machine(members)
  local model = {
    a = state { doo = wait }, b = state { doo = wait }, k = conn {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e_b" } },
    trans { src = "a", tgt = "k", events = { "e_k" } },
    trans { src = "k", tgt = "b", events = { "e_k" }, guard = no },
    trans { src = "k", tgt = "a", events = { "e_other" } },
    trans { src = "b", tgt = "a", events = { "e_b" } },
  }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a set
  local fsm = helper.init(state(model))
  fsm.err = false
  rfsm.run(fsm)
  return fsm
end

local function text_of(fsm, ...)
  local _, text = rfsm_checks.why(fsm, ...)
  return (helper.without_file(text))
end

-- Without the first line, which has the result.
local function rest_of(fsm, ...) return (text_of(fsm, ...):gsub("^[^\n]*\n", "")) end

describe("why", function()
  it("names the transition that would be taken, and why the others are not", function()
    assert.equal(table.concat({
      "root.trans[2] (a -> b) would be taken on e_b in root.a",
      "  root.trans[2] (a -> b): would be taken",
      "  root.trans[3] (a -> k): waits for e_k",
    }, "\n"), text_of(machine(), "e_b"))
  end)

  it("names the connector where a path ends, and what its transitions say", function()
    assert.equal(table.concat({
      "no transition would be taken on e_k in root.a",
      "  root.trans[2] (a -> b): waits for e_b",
      "  root.trans[3] (a -> k): the path ends at root.k",
      "    root.trans[4] (k -> b): its guard returns false",
      "    root.trans[5] (k -> a): waits for e_other",
    }, "\n"), text_of(machine(), "e_k"))
  end)

  it("asks the guard hooks of extensions before the guard", function()
    for _, case in ipairs {
      { no, "the guard hook of an extension returns false" },
      { function() error("hot", 0) end, "the guard hook of an extension fails: hot" },
      { function(_, events, event) return events[1] == event end, "would be taken" },
    } do
      local fsm = machine()
      rfsm.guard_hook_add(fsm, fsm[2], case[1])
      assert.equal("  root.trans[2] (a -> b): " .. case[2] .. "\n"
        .. "  root.trans[3] (a -> k): waits for e_k", rest_of(fsm, "e_b"))
    end
  end)

  local CASES = {
    { "a guard that fails", trans { src = "a", tgt = "b", events = { "e_x" },
      guard = function() error("no", 0) end }, "its guard fails: no" },
    { "a guard that returns false", trans { src = "a", tgt = "b", events = { "e_x" },
      guard = no }, "its guard returns false" },
    { "a transition on any event", trans { src = "a", tgt = "b" }, "would be taken" },
    { "one that is tried later", trans { src = "a", tgt = "b", pn = -1,
      events = { "e_x", "e_b" } }, "would be taken" },
    { "a predicate", trans { src = "a", tgt = "b", events = {
      function(event) return event == "e_x" end } }, "would be taken" },
    { "a predicate that does not accept it", trans { src = "a", tgt = "b",
      events = { "e_y", function() return false end } },
      "waits for e_y, what spec/why_spec.lua:%d+ accepts" },
  }
  for _, case in ipairs(CASES) do
    it("explains " .. case[1], function()
      assert.matches("root.trans%[7%] %(a %-> b%): " .. case[3],
        rest_of(machine { [7] = case[2] }, "e_x"))
    end)
  end

  it("asks no connector for an internal transition of a composite", function()
    local fsm = machine {
      [7] = trans { src = "a", tgt = "root.c.x", events = { "e_c" } },
      [8] = trans { src = "c", tgt = "internal", events = { "e_i" } },
      c = state { x = state {}, trans { src = "initial", tgt = "x", guard = no } } }
    helper.post_and_run(fsm, "e_c")
    assert.matches("root.trans%[8%] %(c %-> internal%): would be taken",
      rest_of(fsm, "e_i"))
  end)

  it("has a word for each answer", function()
    local fsm, words = machine { [7] = trans { src = "a", tgt = "b", pn = -1,
      events = { "e_b" }, guard = function() error("no", 0) end } }, {}
    for i, answer in ipairs(rfsm_checks.why(fsm, "e_b").answers) do
      words[i] = answer.verdict
    end
    assert.same({ "fires", "event", "failed" }, words)
  end)

  it("names the winner to a transition that loses", function()
    local fsm = machine { [7] = trans { src = "a", tgt = "b", pn = -1,
      events = { "e_b" } } }
    assert.matches("root.trans%[7%] %(a %-> b%): loses to root.trans%[2%] %(a %-> b%)$",
      text_of(fsm, "e_b"))
  end)

  it("explains a target that a callback has set, and that is none", function()
    local fsm = machine()
    for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
      if tr.src == fsm.a then tr.tgt = "bb" end
    end
    assert.matches("root.trans%[2%] %(a %-> b%): its target is bb, which cannot be "
      .. "entered\n", text_of(fsm, "e_b"))
  end)

  it("takes the queue if no event is given", function()
    local fsm = machine()
    rfsm.send_events(fsm, "e_b")
    assert.matches("^root.trans%[2%] %(a %-> b%) would be taken on e_b", text_of(fsm))
  end)

  it("says that without an event no transition is taken", function()
    local fsm = machine { [7] = trans { src = "a", tgt = "b" } }
    assert.matches("^no transition would be taken without an event in root.a",
      text_of(fsm))
  end)

  it("tells of the way in before the first entry", function()
    local fsm = helper.init(state { a = state {},
      trans { src = "initial", tgt = "a" } })
    assert.equal("root.trans[1] (initial -> a) would be taken on e_init_fsm in a "
      .. "machine that was not entered\n  root.trans[1] (initial -> a): would be taken",
      text_of(fsm))
  end)

  it("looks into the machines of the active leaf", function()
    local inner = state { err = false, warn = false, info = false,
      x = state {}, trans { src = "initial", tgt = "x" },
      trans { src = "x", tgt = "x", events = { "e_x" } } }
    local fsm = helper.init(state { par = rfsm.seqand { left = inner },
      trans { src = "initial", tgt = "par" } })
    rfsm.run(fsm)
    local found, text = rfsm_checks.why(fsm, "e_x")
    assert.is_false(found.fires)
    assert.equal("region left: root.trans[2] (x -> x) would be taken on e_x in "
      .. "root.par", text:match("^[^\n]*"))
    assert.equal("left", found.regions[1].name)
    assert.equal("root.trans[2] (x -> x)", found.regions[1].why.fires)
    assert.same({ "e_x", any = false }, (rfsm_checks.enabled(fsm)))
  end)

  it("says nothing of regions that are not stepped any more", function()
    local region = state { info = false, warn = false, x = state { final = true },
      y = state {}, trans { src = "initial", tgt = "x" },
      trans { src = "x", tgt = "y", events = { "e_y" } } }
    local fsm = machine { c = rfsm.seqand { r = region },
      [7] = trans { src = "a", tgt = "c", events = { "e_c" } },
      [8] = trans { src = "c", tgt = "a", events = { "e_done" }, guard = no } }
    helper.post_and_run(fsm, "e_c")
    assert.equal(table.concat({ "no transition would be taken on e_y in root.c",
      "  its regions are not stepped any more: it is done",
      "  root.trans[8] (c -> a): waits for e_done@root.c" }, "\n"), text_of(fsm, "e_y"))
    assert.same({ any = false }, (rfsm_checks.enabled(fsm)))
  end)

  -- Returns how many regions answer if an event leads out of their leaf to `tgt`, or to
  -- none, and the first line.
  local function regions_on(tgt)
    local inner = state { err = false, warn = false, info = false, x = state {},
      trans { src = "initial", tgt = "x" },
      trans { src = "x", tgt = "x", events = { "e_x" } } }
    local fsm = helper.init(state { a = state {},
      par = rfsm.seqand { left = inner, right = inner },
      trans { src = "initial", tgt = "par" },
      trans { src = "par", tgt = tgt, events = { "e_x" } } })
    rfsm.run(fsm)
    local found, text = rfsm_checks.why(fsm, "e_x")
    return { #found.regions, text:match("^[^\n]*") }
  end

  it("leaves out the machines of a leaf that is left, unless internally", function()
    assert.same({ 0, "root.trans[2] (par -> a) would be taken on e_x in root.par" },
      regions_on "a")
    assert.same({ 2, "root.trans[2] (par -> internal) and region left: root.trans[2] "
      .. "(x -> x) and region right: root.trans[2] (x -> x) would be taken on e_x in "
      .. "root.par" }, regions_on "internal")
  end)

  it("explains a queue of any length", function()
    local fsm = machine()
    for _ = 1, 20000 do rfsm.send_events(fsm, "e_other") end
    rfsm.send_events(fsm, "e_b")
    assert.equal("root.trans[2] (a -> b)", (rfsm_checks.why(fsm)).fires)
  end)

  it("blames the caller for what is no machine", function()
    local _, text = pcall(function() rfsm_checks.why(state {}, "e") end)
    assert.matches("why_spec.lua:%d+: rfsm_checks.why: initialised fsm expected", text)
  end)
end)

describe("enabled", function()
  it("lists the events that would do something now", function()
    local events, text = rfsm_checks.enabled(machine())
    assert.same({ "e_b", any = false }, events)
    assert.equal("e_b", text)
  end)

  it("marks that any event would", function()
    local events, text = rfsm_checks.enabled(machine { [7] = trans { src = "root",
      tgt = "a", events = {}, pn = -1 } })
    assert.is_true(events.any)
    assert.matches("any other event$", text)
  end)
end)

describe("enabled", function()
  it("asks guards of transitions on any event about each event", function()
    local events = rfsm_checks.enabled(machine { [7] = trans { src = "root", tgt = "a",
      guard = function(_, list) return list[1] == "e_c" end },
      [8] = trans { src = "b", tgt = "a", events = { "e_c" } } })
    assert.same({ "e_b", "e_c", any = false }, events)
  end)
end)

describe(claim.name, function()
  it("agree on random charts", function()
    assert.is_nil(share.problem(claim, 60))
  end)
end)
