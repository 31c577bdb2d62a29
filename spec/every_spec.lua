-- Time events that come again: e_every.

local clock = require "rfsm.clock"
local helper = require "spec.helper"
local host_of = require "spec.support.server_host"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local snapshot = require "rfsm.snapshot"
local timeevent = require "rfsm_timeevent"

local state, trans = rfsm.state, rfsm.trans
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

teardown(function() timeevent.set_gettime_hook(nil) end)

local function internal(event, more)
  local tr = { src = "on", tgt = "internal", events = { event },
    effect = function(fsm)
      fsm.times[#fsm.times + 1] = ("%.14g"):format(fsm.gettime:now())
    end }
  for key, value in pairs(more or {}) do tr[key] = value end -- any order: a copy
  return trans(tr)
end

-- A machine of on and off, that notes the times at which an event comes; its clock.
local function new(event, members)
  local time = clock.simulated()
  local model = { info = false, warn = false, gettime = time, times = {},
    on = state {}, off = state {}, trans { src = "initial", tgt = "on" },
    internal(event), trans { src = "on", tgt = "off", events = { "e_off" } },
    trans { src = "off", tgt = "on", events = { "e_on" } } }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a copy
  local fsm = assert(rfsm.init(state(model)))
  rfsm.run(fsm)
  return fsm, time
end

local function times(fsm) return table.concat(fsm.times, " ") end

-- Lets seconds pass and runs the machine, as often as there are numbers.
local function pass(fsm, ...)
  for i = 1, select("#", ...) do
    fsm.gettime:advance((select(i, ...)))
    rfsm.run(fsm)
  end
  return fsm
end

describe("e_every", function()
  for _, case in ipairs {
    { "comes again each T seconds", "e_every(1)", { 1.5, 1, 0.25, 1 }, "1.5 2.5 3.75" },
    { "does not drift", "e_every(0.5)", { 0.75, 0.75, 0.25, 0.5 },
      "0.75 1.5 1.75 2.25" },
    { "comes once if several times were missed", "e_every(1)", { 4.5, 0.25, 0.5 },
      "4.5 5.25" },
    { "comes when more than T seconds have passed", "e_every(1)", { 1, 1, 0.5 },
      "2 2.5" },
    { "may have the FQN of its source", "e_every(1)@root.on", { 1.5, 1 }, "1.5 2.5" },
    { "may be an object", timeevent.e_every(1), { 1.5, 1 }, "1.5 2.5" },
    { "may have a function, called each time", timeevent.e_every((function()
      local period = 0
      return function()
        period = period + 1
        return period
      end
    end)(), "x"), { 1.5, 1, 1, 2, 1 }, "1.5 3.5 6.5" },
  } do
    it(case[1], function()
      local fsm = pass(new(case[2]), unpack(case[3]))
      assert.equal(case[4], times(fsm))
    end)
  end

  it("is silent when its state was left, and begins anew with the entry", function()
    local fsm = pass(new "e_every(1)", 1.5)
    rfsm.send_events(fsm, "e_off")
    pass(fsm, 0, 5)
    assert.is_nil(timeevent.next_deadline(fsm))
    rfsm.send_events(fsm, "e_on")
    pass(fsm, 0, 0.75, 0.5)
    assert.equal("1.5 7.75", times(fsm))
  end)

  it("of a composite runs across the transitions in it", function()
    local fsm = new("e_every(1)", { on = state { a = state {}, b = state {},
      trans { src = "initial", tgt = "a" }, trans { src = "a", tgt = "b",
        events = { "e_done" } }, trans { src = "b", tgt = "a",
        events = { "e_every(0.75)" } } } })
    assert.equal("1.25 2.5", times(pass(fsm, 0.5, 0.75, 1.25)))
  end)

  it("beside an e_after, an e_at and a send each come at their times", function()
    local seen = {}
    local fsm = new("e_every(1)", { pre_step_hook = function(_, events)
      for _, event in ipairs(events) do seen[#seen + 1] = event end
    end, [5] = internal("e_after(1.5)"), [6] = internal("e_at(2.5)") })
    timeevent.send_after(fsm, 2.25, "e_sent")
    for i = #seen, 1, -1 do seen[i] = nil end
    pass(fsm, 1.25, 0.5, 0.5, 0.5)
    assert.equal("e_every(1)@root.on e_after(1.5)@root.on e_every(1)@root.on e_sent "
      .. "e_at(2.5)@root.on", table.concat(seen, " "))
  end)

  it("is missed while one waits, so that no queue grows", function()
    local fsm = new("e_every(1)", { read = "one", [5] = internal("e_x") })
    for _ = 1, 9 do rfsm.send_events(fsm, "e_x") end
    for _ = 1, 5 do
      fsm.gettime:advance(1.5)
      rfsm.step(fsm)
    end
    assert.equal(4 + 1, rfsm.check_events(fsm))
    rfsm.run(fsm)
    assert.equal(10, #fsm.times)
  end)

  it("comes again beside an internal transition that does not name it", function()
    local fsm = new("e_every(1)", { [5] = internal("e_tick", { pn = 1 }) })
    rfsm.send_events(fsm, "e_tick")
    assert.equal("1.5 1.5", times(pass(fsm, 1.5)))
  end)

  it("tells a host when to wake up", function()
    local fsm = pass(new "e_every(1)", 1.25)
    assert.equal("0.750000001", ("%.9f"):format(timeevent.next_deadline(fsm)))
    fsm.gettime:advance_to_timer(fsm)
    assert.equal("1.25 2.000000001", times(pass(fsm, 0)))
  end)

  it("goes on behind a snapshot, with its phase", function()
    local fsm = pass(new "e_every(1)", 1.5)
    local other = new "e_every(1)"
    assert.is_true(snapshot.put(other, snapshot.take(fsm)))
    assert.equal("0.75 1.75", times(pass(other, 0.25, 0.5, 0.5, 0.5)))
  end)

  it("is missed once by a machine that was away, and keeps its phase", function()
    local fsm = pass(new "e_every(1)", 1.5)
    local snap, other = snapshot.take(fsm), new "e_every(1)"
    assert.is_true(snapshot.put(other, snap))
    assert.equal("10.25 11", times(pass(other, 10.25, 0.25, 0.5)))
  end)

  it("is punctual in a fleet after an outage, and missed ones come once", function()
    local now, trace = { now = 1000 }, {}
    local f = dofile("rfsm/server/functions.lua")(host_of.new(trace, now),
      { { name = "c", make = function()
        return state { on = state {},
          trans { src = "initial", tgt = "on" },
          trans { src = "on", tgt = "internal", events = { "e_every(10)" },
            effect = function(fsm) fsm.emit("tick") end } }
      end } })
    f.rfsm_create({ "m" }, { "c" })
    now.now = 1035
    f.rfsm_tick({ "m" }, {})
    now.now = 1041
    f.rfsm_tick({ "m" }, {})
    local count = 0
    for _, line in ipairs(trace) do
      if line:find("6=tick", 1, true) then count = count + 1 end
    end
    assert.equal(2, count)
  end)

  for _, case in ipairs {
    { 0, "seconds, a number above 0, or a function expected, got 0" },
    { -1, "seconds, a number above 0, or a function expected, got -1" },
    { "1", "seconds, a number above 0, or a function expected, got string" },
    { 0 / 0, "seconds, a number above 0, or a function expected, got " },
  } do
    it("refuses " .. rfsm.text_of(case[1]):gsub("%-?nan", "NaN"), function()
      local text = helper.refusal(timeevent.e_every, case[1])
      assert.equal("rfsm_timeevent.e_every: " .. case[2],
        text:gsub("^.-:%d+: ", ""):gsub("%-?nan$", ""), nil)
    end)
  end

  for _, case in ipairs {
    { "e_every(0)", "'e_every(0)': seconds above 0 expected, as in e_every(0.5)" },
    { "e_every(x)", "'e_every(x)': seconds expected, as in e_every(0.5)" },
    { "e_every(0)@root.a",
      "'e_every(0)': seconds above 0 expected, as in e_every(0.5)" },
    { "await(e_x, e_every(0))",
      "'e_every(0)': seconds above 0 expected, as in e_every(0.5)" },
  } do
    it("warns of " .. case[1], function()
      local warned = {}
      assert(rfsm.init(state { info = false, warn = function(text)
        warned[#warned + 1] = text:gsub("^.-events ", "")
      end, on = state {}, trans { src = "initial", tgt = "on" },
        trans { src = "on", tgt = "on", events = { case[1] } } }))
      assert.same({ "(on -> on): " .. case[2] }, warned)
    end)
  end

  it("is explored: it comes again and again", function()
    local result = rfsm_checks.explore(state { info = false, warn = false,
      a = state {}, b = state {}, c = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "internal", events = { "e_every(1)" } },
      trans { src = "a", tgt = "b", events = { "e_go" } },
      trans { src = "b", tgt = "c", events = { "e_every(2)" } } })
    assert.matches("^%d+ configurations, 4 of 4 transitions taken", tostring(result))
  end)

  it("is drawn in words, and is a time event", function()
    local fsm = new "e_every(1)"
    assert.matches("every 1 s", require("rfsm.dot").encode(fsm), 1, true)
    assert.is_true(timeevent.is_timeevent("e_every(1)@root.on"))
    assert.is_true(timeevent.is_timeevent(timeevent.e_every(2)))
    assert.equal("timer", require("rfsm.shared.match").maker_of("e_every(1)@root.on"))
  end)
end)

describe("the code once", function()
  local function found(members)
    local model = { info = false, warn = false, on = state {}, off = state {},
      trans { src = "initial", tgt = "on" },
      trans { src = "on", tgt = "off", events = { "e_off" } },
      trans { src = "off", tgt = "on", events = { "e_on" } } }
    for key, value in pairs(members) do model[key] = value end -- any order: a copy
    local texts = {}
    for _, finding in ipairs(rfsm_checks.findings(state(model))) do
      if finding.code == "once" then texts[#texts + 1] = finding.text end
    end
    return texts
  end

  it("finds an e_after that an internal transition takes", function()
    assert.same({ "'e_after(1)' comes once an entry, and an internal transition enters "
      .. "nothing" }, found { [4] = internal("e_after(1)") })
    assert.same({ "'e_after(2)' comes once an entry, and an internal transition enters "
      .. "nothing" }, found { [4] = internal(timeevent.e_after(2)) })
  end)

  it("finds no e_every, e_at or self transition", function()
    assert.same({}, found { [4] = internal("e_every(1)"), [5] = internal("e_at(5)"),
      [6] = trans { src = "on", tgt = "on", events = { "e_after(1)" } } })
  end)
end)
