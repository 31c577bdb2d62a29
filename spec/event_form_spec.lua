-- Events in the wrong form: each mistake is told, with its cure.

local checks = require "rfsm_checks"
local helper = require "spec.helper"
local names = require "rfsm.observe.names"
local rfsm = require "rfsm"
local timeevent = require "rfsm_timeevent"

local state, trans, named = rfsm.state, rfsm.trans, rfsm.named

-- a -events-> b
local function chart(events, more)
  local model = { info = false, warn = false, a = state {}, b = state { final = true },
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = events } }
  for key, value in pairs(more or {}) do model[key] = value end -- any order: a set
  return state(model)
end

describe("rfsm check tells of", function()
  for _, case in ipairs {
    { "a constructor that is not called", { named },
      "rfsm.named is not called (did you mean rfsm.named(..)?)" },
    { "a time event that is not called", { timeevent.e_after },
      "rfsm_timeevent.e_after is not called (did you mean "
        .. "rfsm_timeevent.e_after(..)?)" },
    { "a state", { state {} }, "a state is no event (texts and rfsm.named are)" },
    { "a transition", { trans { src = "a", tgt = "b" } },
      "a transition is no event (texts and rfsm.named are)" },
    { "an empty text", { "" }, "the name of an event is empty" },
    { "an empty text beside another", { "e_go", "" }, "the name of an event is empty" },
    { "a list with data", { { "e_go", n = 1 } },
      "a list that holds 'e_go' is one event" },
  } do
    it(case[1], function()
      local texts = {}
      for _, finding in ipairs(checks.findings(chart(case[2]))) do
        if finding.code == "odd-event" then texts[#texts + 1] = finding.text end
      end
      assert.same({ case[3] }, texts)
    end)
  end

  it("no predicate of a name, and no function of the user", function()
    for _, finding in ipairs(checks.findings(chart { named "e_go", function() end })) do
      assert.is_not.equal("odd-event", finding.code)
    end
  end)
end)

describe("a strict machine tells of", function()
  for _, case in ipairs {
    { "a text in place of a name", named "e_go", "e_go",
      "no transition names the event 'e_go' (did you mean { name = 'e_go' }?)" },
    { "a name in place of a text", "e_go", { name = "e_go" },
      "no transition names the event { name = 'e_go' } (did you mean 'e_go', "
      .. "or rfsm.named 'e_go' in the chart?)" },
    { "a list with data", named "e_go", { "e_go", n = 1 },
      "the table has no field 'name' (did you mean name = 'e_go' in place of the "
        .. "first item?)" },
    { "another field", named "e_go", { type = "e_go" },
      "the table has no field 'name' (did you mean name = 'e_go' in place of "
        .. "'type'?)" },
    { "another field, though the chart has the text", "e_go", { event = "e_go", n = 1 },
      "the table has no field 'name' (did you mean name = 'e_go' in place of "
        .. "'event'?)" },
    { "a name that is no text", named "e_go", { name = 5 },
      "name: text expected, got number 5" },
    { "an e_done, which the machine makes", "e_done", "e_done",
      "no transition names the event 'e_done' (the machine makes e_done@root.a)" },
    { "a list", named "e_go", { "e_go" },
      "a list is one event (did you mean rfsm.send_events(fsm, unpack(list))?)" },
  } do
    it(case[1] .. ", at the sender's place", function()
      local model = chart({ case[2] }, { strict = true })
      local said = helper.said(model, "warn")
      local fsm = helper.init(model)
      rfsm.run(fsm)
      rfsm.send_events(fsm, case[3])
      local line = said[#said]:match("^WARNING: .-event_form_spec%.lua:%d+: (.*)$")
      assert.equal(case[4], line)
    end)
  end
end)

it("the simulator knows the form that was meant", function()
  local fsm = helper.init(chart { named "e_go" })
  assert.equal("e_go{}", names.form_meant(fsm, "e_go"))
  assert.is_nil(names.form_meant(fsm, { name = "e_go" }))
  fsm = helper.init(chart { "e_go" })
  assert.equal("e_go", names.form_meant(fsm, { name = "e_go" }))
  assert.is_nil(names.form_meant(fsm, "e_go"))
end)

it("a machine that is watched owes for the name of an event with data", function()
  local fsm, told = helper.init(chart({ named "e_go" }, { [2] = trans { src = "a",
    tgt = "internal", events = { named "e_go" } } })), {}
  fsm.err = function(text) told[#told + 1] = (text:gsub("\n.*", "")) end
  checks.watch_properties(fsm, { p = checks.after "e_go".leads_to "root.b" })
  rfsm.run(fsm)
  rfsm.send_events(fsm, { name = "e_go", n = 1 })
  rfsm.run(fsm)
  assert.equal(1, #told)
end)
