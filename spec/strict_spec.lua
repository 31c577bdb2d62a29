-- Strict machines: odd, early and undeclared events, and fields that are not there.

local ab = require "spec.support.ab"
local claim = require "spec.support.claims.strict"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local share = require "spec.support.share"
local strict = require "rfsm.strict"
require "rfsm.await"

local state = rfsm.state
local chart, go = ab.chart, ab.go

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
      .. "table has no field 'name' (there is 'e_paid')" },
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
  assert.is_nil(share.problem(claim, 30))
end)
