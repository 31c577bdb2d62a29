-- Strict machines: odd, early and undeclared events, and fields that are not there.

local ab = require "spec.support.ab"
local claim = require "spec.support.claims.strict"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local share = require "spec.support.share"
local strict = require "rfsm.strict"
require "rfsm.await"

local state, trans = rfsm.state, rfsm.trans
local chart, go = ab.chart, ab.go
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

-- A strict machine of more members, and the list of its warnings.
local function watched(members)
  local warnings, model = {}, chart(members)
  model.strict = model.strict == nil or model.strict
  model.warn = function(text) warnings[#warnings + 1] = helper.without_file(text) end
  return helper.init(model), warnings
end

local function started(members)
  local fsm, warnings = watched(members)
  rfsm.run(fsm)
  return fsm, warnings
end

describe("a strict machine", function()
  it("warns of fields that have the active state in other libraries", function()
    local fsm, warnings = started {}
    assert.is_nil(fsm.state)
    assert.is_nil(fsm.current)
    assert.is_nil(fsm.speed)
    assert.equal(2, #warnings)
    assert.equal("WARNING: a machine has no field 'state' (did you mean "
      .. "rfsm.get_actleaf_fqn(fsm)?)", warnings[1])
  end)

  it("warns of an event whose path is closed behind a connector", function()
    local is_open = false
    local fsm, warnings = started { k = rfsm.conn {}, c = state {},
      [4] = go("a", "k", { "e_k" }), [5] = trans { src = "k", tgt = "c", guard =
      function() return is_open end }, [6] = go("c", "a", { "e_a" }) }
    rfsm.run(fsm)
    rfsm.send_events(fsm, "e_k")
    rfsm.run(fsm)
    assert.same({ "WARNING: event 'e_k' is discarded, no transition from 'root.k' is "
      .. "enabled (add one without a guard, of the least pn)" }, warnings)
    is_open = true
    rfsm.send_events(fsm, "e_k")
    rfsm.run(fsm)
    assert.equal("root.c", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("a strict machine", function()
  local HERE = "WARNING: "

  -- What is sent, the warning behind file and line.
  local SENT = {
    { events = { "e_y" }, text = "no transition names the event 'e_y' (did you mean "
      .. "'e_x'?)" },
    { events = { { "e_x" } }, text = "a list is one event (did you mean "
      .. "rfsm.send_events(fsm, unpack(list))?)" },
    { events = { "e_x", { speed = 3 } }, text = "a table is an event of its own, as "
      .. "each argument is" },
    { events = { 7 }, text = "no transition names the event 7 (there are "
      .. "'e_x', 'await(await_me, and_me)@root.a', 'await_me', 'and_me')" },
    { events = { "b" }, text = "'b' is the name of a state, no event" },
    { events = { "root.b" }, text = "'root.b' is the name of a state, no event" },
    { events = { "e_x e_y" }, text = "'e_x e_y' is one event (write an argument for "
      .. "each)" },
    { events = { "e_x " }, text = "'e_x ' is one event (did you mean 'e_x'?)" },
    { events = { "e_x|e_y" }, text = "'e_x|e_y' is one event (write an argument for "
      .. "each)" },
    { events = { "e_after 2" }, text = "'e_after 2' is one event (did you mean "
      .. "'e_after(2)'?)" },
    { events = { "e_after (2)" }, text = "'e_after (2)' is one event (did you mean "
      .. "'e_after(2)'?)" },
    { events = { "e_x" } },
    { events = { "e_p" }, predicate = function() error("not called") end },
    { events = { { name = "e_paid" } }, predicate = rfsm.named "e_paid" },
    { events = { { name = "e_pay" } }, predicate = rfsm.named "e_paid", text = "no "
      .. "transition names the event { name = 'e_pay' } (did you mean 'e_paid'?)" },
    { events = { { e = "e_paid" } }, predicate = rfsm.named "e_paid", text = "the "
      .. "table has no field 'name' (did you mean name = 'e_paid' in place of 'e'?)" },
    { events = { "e_paid" }, predicate = rfsm.named "e_paid", text = "no transition "
      .. "names the event 'e_paid' (did you mean { name = 'e_paid' }?)" },
    { events = { "await_me", "and_me" } },
  }
  for _, case in ipairs(SENT) do
    it(case.text and "warns: " .. case.text
      or "does not warn of " .. rfsm.text_of(case.events[1]), function()
      local fsm, warnings = started { [4] = go("a", "b", { "await(await_me, and_me)",
        case.predicate }) }
      rfsm.send_events(fsm, case.events[1], case.events[2] or "e_x")
      assert.same({ case.text and HERE .. case.text }, warnings)
      rfsm.run(fsm)
    end)
  end

  it("warns of nil, and of events before the first step", function()
    local fsm, warnings = watched()
    rfsm.send_events(fsm, "e_x", nil)
    assert.same({ HERE .. "event 'e_x' is sent before the first step, whose entry "
      .. "consumes it", HERE .. "argument 2 is nil, which is no event (is it a "
      .. "name without quotes?)" }, warnings)
  end)

  it("names an early event with data", function()
    local fsm, warnings = watched { [4] = go("a", "b", { rfsm.named "e_paid" }) }
    rfsm.send_events(fsm, { name = "e_paid" })
    assert.same({ HERE .. "event 'e_paid' is sent before the first step, whose entry "
      .. "consumes it" }, warnings)
    fsm, warnings = watched { strict = false }
    rfsm.send_events(fsm, { name = "e_paid" })
    rfsm.run(fsm)
    assert.same({ HERE .. "sent before the machine was entered, which consumes them: "
      .. "e_paid" }, warnings)
  end)

  it("warns of no early event if the machine takes one event", function()
    local fsm, warnings = watched { read = "one" }
    rfsm.send_events(fsm, "e_x")
    rfsm.run(fsm)
    assert.same({}, warnings)
  end)

  local paid, other = { name = "e_paid" }, { name = "e_paid" }
  local TOGETHER = {
    { name = "events with data", rfsm.named "e_go", rfsm.named "e_paid",
      sent = { { name = "e_go" }, paid }, waits = true },
    { name = "a text and one with data", "e_go", rfsm.named "e_paid",
      sent = { "e_go", paid }, waits = true },
    { name = "one of the path, and one of its name", paid, rfsm.named "e_paid",
      sent = { paid, other }, waits = true },
    { name = "two that the path takes", { "e_go", rfsm.named "e_paid" },
      rfsm.named "e_paid", sent = { "e_go", paid } },
    { name = "one that a predicate of the user may take", function() end,
      rfsm.named "e_paid", sent = { "e_go", paid } },
  }
  for _, case in ipairs(TOGETHER) do
    it("looks for a state that waits for one of " .. case.name, function()
      local is_list = type(case[1]) == "table" and case[1] ~= paid
      local own = is_list and case[1] or { case[1] }
      own[#own + 1] = "e_way"
      local fsm, warnings = started { [2] = trans { src = "a", tgt = "b",
        events = own }, [4] = go("b", "a", { case[2] }) }
      rfsm.send_events(fsm, "e_way", unpack(case.sent))
      rfsm.run(fsm)
      assert.same({ case.waits and HERE .. "event 'e_paid' came together with another "
        .. "one and is discarded, 'root.b' waits for it (call rfsm.run before it is "
        .. "sent)" or nil }, warnings)
    end)
  end

  it("warns once of an early event, also of getevents", function()
    local got = { "e_p" }
    local fsm, warnings = watched { getevents = function()
      local list = got
      got = {}
      return list
    end }
    rfsm.send_events(fsm, "e_x")
    rfsm.run(fsm)
    assert.same({ HERE .. "event 'e_x' is sent before the first step, whose entry "
      .. "consumes it", HERE .. "event 'e_p' is sent before the first step, whose "
      .. "entry consumes it" }, warnings)
  end)

  it("names the sender's file and line, and warns once of each", function()
    local lines, model = {}, chart { strict = true }
    model.warn = function(text) lines[#lines + 1] = text end
    local fsm = helper.init(model)
    rfsm.run(fsm)
    for _ = 1, 2 do rfsm.send_events(fsm, "e_q") end
    rfsm.run(fsm)
    assert.equal(1, #lines)
    assert.matches("^WARNING: spec/strict_spec.lua:%d+: no transition names the event "
      .. "'e_q'", lines[1])
  end)

  it("warns of fields that are not there, and of callbacks that are none", function()
    local fsm, warnings = started()
    local function f() end
    fsm.b.enter, fsm.post_hook, fsm.a.mine, fsm[2].efect = f, f, f, f
    fsm.a.exit = "beep"
    rfsm.step(fsm)
    fsm.a.exit = nil
    table.sort(warnings)
    assert.same({
      HERE .. "root.a.exit: function expected, got string 'beep'",
      HERE .. "root.b: a state has no field 'enter' (did you mean 'entry'?)",
      HERE .. "root.trans[2] (a -> b): a transition has no field 'efect' (did you mean "
        .. "'effect'?)",
      HERE .. "root: a state has no field 'post_hook' (did you mean 'post_step_hook'?)",
    }, warnings)
  end)

  it("tells what init has told no second time, also of a copy", function()
    local function f() end
    local fsm, warnings = watched { b = state { enter = f }, [2] = go("a", "b", "e_x",
      { effects = f }) }
    for _, machine in ipairs { fsm, helper.copy_of(fsm) } do rfsm.run(machine) end
    table.sort(warnings)
    assert.same({
      HERE .. "root.b: a state has no field 'enter' (did you mean 'entry'?)",
      HERE .. "root.trans[2] (a -> b): a transition has no field 'effects' (did you "
        .. "mean 'effect'?)",
    }, warnings)
  end)

  it("runs with a datum named `type` in a state, a transition or the root", function()
    local fsm, warnings = started { type = "x", [2] = go("a", "b", "e_x", { type = 7 }),
      a = state { type = "lamp" } }
    assert.equal("root.b", helper.leaf_after(fsm, "e_x"))
    assert.same({}, warnings)
  end)

  it("and a copy of its tables warn each", function()
    local fsm, warnings = started()
    for _, machine in ipairs { fsm, helper.copy_of(fsm) } do
      for _ = 1, 2 do rfsm.send_events(machine, "e_q") end
      rfsm.run(machine)
    end
    assert.equal(2, #warnings)
  end)

  it("is none without the field, nor with false", function()
    local fsm, warnings = started { strict = false }
    rfsm.send_events(fsm, "e_y")
    assert.same({}, warnings)
    strict.watch(fsm)
    rfsm.send_events(fsm, "e_y")
    strict.watch(fsm)
    assert.equal(1, #warnings)
  end)

  it("blames the caller for what is no machine, as ever", function()
    local _, text = pcall(function() rfsm.send_events(state {}, "e") end)
    assert.matches("initialised fsm expected", text)
  end)

  for what, case in pairs { -- any order: each stands alone
    ["the environment"] = { environment = "1", field = "nil" },
    ["the model"] = { environment = "0", field = "true" },
  } do
    it(("is asked for by %s, and loads what it needs"):format(what), function()
      local out = helper.output_of(([[
        package.path = "./?.lua;" .. package.path
        os.getenv = function(name) return name == "RFSM_STRICT" and "%s" or nil end
        local rfsm = require "rfsm"
        local fsm = rfsm.init(rfsm.state { info = false, warn = print, strict = %s,
          a = rfsm.state { final = true }, rfsm.trans { src = "initial", tgt = "a" } })
        rfsm.run(fsm)
        rfsm.send_events(fsm, "e_q")
      ]]):format(case.environment, case.field))
      helper.remove_files()
      assert.matches(":7: no transition names the event 'e_q'$", out)
    end)
  end
end)

it("a strict machine runs random charts as one that is not, with odd fields", function()
  assert.is_nil(share.problem(claim, 30, true))
end)

it("a strict machine names what it makes only for an event as that", function()
  local warnings = {}
  local fsm = assert(rfsm.init(state { strict = true, info = false, a = state {},
    warn = function(text) warnings[#warnings + 1] = text:match("%(.*%)$") end,
    b = state {}, trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e_done@root.a" } },
    trans { src = "b", tgt = "a", events = { "e_go" } } }))
  rfsm.run(fsm)
  rfsm.send_events(fsm, "e_goo", "e_done")
  rfsm.run(fsm)
  assert.same({ "(did you mean 'e_go'?)", "(the machine makes e_done@root.a)" },
    warnings)
end)

describe("a strict machine whose callbacks send to each other", function()
  local run = rfsm.run -- `run` before a strict machine replaces it
  local HEAD = "WARNING: rfsm.run has made 10000 iterations and goes on, in "

  -- Returns an entry that sends an event to the machine `of(fsm)`, 10,050 times in all.
  local function sends(world, event, of)
    return function(fsm)
      world.count = (world.count or 0) + 1
      if world.count > 10050 then return end
      rfsm.send_events(of and of(fsm) or fsm, event)
    end
  end

  -- s1 -e1-> s2 -e2-> .. s1: each entry sends the event that leaves its state.
  local function ring(count, fields)
    local world, model = {}, fields or {}
    model[1] = trans { src = "initial", tgt = "s1" }
    for i = 1, count do
      model["s" .. i] = state { entry = sends(world, "e" .. i) }
      model[i + 1] = trans { src = "s" .. i, tgt = "s" .. i % count + 1,
        events = { "e" .. i } }
    end
    return state(model)
  end

  -- Makes a machine of the model strict, and lets `f` run it; returns the warnings.
  local function warnings_of(model, f)
    local warnings = {}
    model.strict, model.info = true, false
    model.warn = function(text) warnings[#warnings + 1] = helper.without_file(text) end
    local fsm = assert(rfsm.init(model))
    f(fsm)
    return warnings
  end

  local TWO = HEAD .. "'root.s1', 'root.s2': events 'e1', 'e2' come again and again"

  it("says so, with the states and the events", function()
    assert.same({ TWO }, warnings_of(ring(2), rfsm.run))
  end)

  it("says so in a step, in a run that it does not know, and with an idle hook",
    function()
      assert.same({ TWO }, warnings_of(ring(2), function(fsm) rfsm.step(fsm, 2e4) end))
      assert.same({ TWO }, warnings_of(ring(2), run))
      assert.same({ TWO }, warnings_of(ring(2, { idle_hook = function(fsm)
        fsm.idle_hook = nil
      end }), rfsm.run))
    end)

  it("names at most six states, and counts the others", function()
    local states, events = {}, {}
    for i = 1, 6 do states[i], events[i] = "'root.s" .. i .. "'", "'e" .. i .. "'" end
    local text = HEAD .. table.concat(states, ", ") .. " and 3 more: events "
      .. table.concat(events, ", ") .. " and 3 more come again and again"
    assert.same({ text }, warnings_of(ring(9), rfsm.run))
  end)

  it("says so of a transition that leads back, and of e_done", function()
    local world = {}
    assert.same({ HEAD .. "'root.s1': event 'e1' comes again and again" },
      warnings_of(ring(1), rfsm.run))
    assert.same({ HEAD .. "'root.a', 'root.b': events 'e_done@root.a', 'e_done@root.b' "
      .. "come again and again" }, warnings_of(state {
      a = state {}, b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_done" } },
      trans { src = "b", tgt = "a", events = { "e_done" }, guard = function()
        world.count = (world.count or 0) + 1
        return world.count < 5050
      end } }, rfsm.run))
  end)

  for _, field in ipairs { "step", "run" } do
    it("says so of a region that is advanced by " .. field, function()
      local region = ring(2, { info = false, warn = false })
      local model = state { par = rfsm.seqand { left = region, idle_doo = "auto",
        [field] = field == "run" or nil }, a = state {},
        trans { src = "initial", tgt = "par" },
        trans { src = "par", tgt = "a", events = { "e_out" } },
        trans { src = "a", tgt = "par", events = { "e_in" } } }
      local text = HEAD .. "'root.par.left.s1', 'root.par.left.s2': events 'e1', 'e2' "
        .. "come again and again"
      assert.same({ text }, warnings_of(model, rfsm.run))
    end)
  end

  it("says nothing of a host that sends from an idle hook", function()
    local count = 0
    assert.same({}, warnings_of(chart { idle_hook = function(fsm)
      count = count + 1
      if count > 10100 then fsm.idle_hook = nil return end
      rfsm.send_events(fsm, "e_x")
    end }, rfsm.run))
  end)
end)
