-- The time in a state, and machines that begin in a state.

local clock = require "rfsm.clock"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local snapshot = require "rfsm.snapshot"
local timeevent = require "rfsm_timeevent"
require "rfsm.history"
require "rfsm_seqand"

local state, trans = rfsm.state, rfsm.trans
local send = helper.moved
local enter_at, time_in = timeevent.enter_at, timeevent.time_in

local function idle()
  while true do rfsm.yield(true) end
end

-- A machine of new --e_go--> work { a --e_b--> b } --e_after(5)--> late; notes entries.
local function new(members)
  local entered = {}
  local function entry(_, own) entered[#entered + 1] = own._fqn end
  local model = { info = false, warn = false, gettime = clock.simulated(),
    entry = entry,
    new = state { timed = true, entry = entry },
    work = state { entry = entry, a = state { entry = entry }, b = state {
      entry = entry, final = true },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_b" } } },
    late = state { final = true },
    trans { src = "initial", tgt = "new" },
    trans { src = "new", tgt = "work", events = { "e_go" } },
    trans { src = "work", tgt = "late", events = { "e_after(5)" } },
    trans { src = "work", tgt = "new", events = { "e_back" } } }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a copy
  local fsm = assert(rfsm.init(state(model)))
  fsm.entered = entered
  return fsm
end

local function at(fsm) return rfsm.get_actleaf_fqn(fsm) end

local function pass(fsm, seconds)
  fsm.gettime:advance(seconds)
  rfsm.run(fsm)
  return fsm
end

describe("time_in", function()
  it("counts from the entry, and is nil while the state is inactive", function()
    local fsm = send(new())
    fsm.gettime:advance(2.5)
    assert.equal(2.5, time_in(fsm.new))
    assert.is_nil(time_in(fsm.work))
    send(fsm, "e_go")
    fsm.gettime:advance(1)
    assert.same({ 1, nil }, { time_in(fsm.work), time_in(fsm.new) })
    send(fsm, "e_b")
    fsm.gettime:advance(0.25)
    assert.equal(1.25, time_in(fsm.work))
  end)

  it("is known where any time event leaves the state", function()
    for _, event in ipairs { "e_after(9)", "e_every(9)", "e_at(9)",
      timeevent.e_after(function() return 9 end) } do
      local fsm = send(send(new { [3] = trans { src = "work", tgt = "late",
        events = { event } } }), "e_go")
      fsm.gettime:advance(1.5)
      assert.equal(1.5, time_in(fsm.work))
    end
  end)

  it("is kept by snapshots", function()
    for _, case in ipairs { { "new" }, { "work", "e_go" } } do
      local fsm = send(send(new()), case[2])
      fsm.gettime:advance(1.5)
      local other = send(new(), "e_other")
      assert.is_true(snapshot.put(other, snapshot.take(fsm)))
      other.gettime:advance(1)
      assert.equal(2.5, time_in(other[case[1]]))
    end
  end)

  it("is kept in a state with and without timers, and the timers go on", function()
    local fsm = send(send(new { work = state { timed = true } }), "e_go")
    pass(fsm, 4)
    local other = send(new { work = state { timed = true } })
    assert.is_true(snapshot.put(other, snapshot.take(fsm)))
    assert.equal(4, time_in(other.work))
    assert.equal("root.late", at(pass(other, 1.5)))
  end)

  it("is not the time of before if a snapshot does not tell it", function()
    local fsm = send(new())
    local snap = snapshot.take(fsm)
    snap.ext = nil
    assert.is_true(snapshot.put(fsm, snap))
    assert.matches("'root.new' is not known .*a snapshot without it", helper.refusal(
      time_in, fsm.new))
  end)

  it("says if it is not known", function()
    local fsm = send(send(new()), "e_go")
    assert.equal("rfsm_timeevent.time_in: the time of 'root.work.a' is not known "
      .. "(timed = true in the state)", helper.refusal(time_in, fsm.work.a)
      :gsub("^.-:%d+: ", ""), nil)
    assert.equal("rfsm_timeevent.time_in: state of a machine expected, got string 'x'",
      helper.refusal(time_in, "x"):gsub("^.-:%d+: ", ""), nil)
    assert.equal("rfsm_timeevent.time_in: state of a machine expected, got state",
      helper.refusal(time_in, state {}):gsub("^.-:%d+: ", ""), nil)
  end)

  it("of a timed state whose entry missed the clock names the causes", function()
    local fsm = new { err = false, gettime = function() error("battery empty", 0) end }
    rfsm.run(fsm)
    assert.equal("rfsm_timeevent.time_in: the time of 'root.new' is not known (an "
      .. "interrupt or a failed clock at its entry, or a snapshot without it)",
      helper.refusal(time_in, fsm.new):gsub("^.-:%d+: ", ""), nil)
  end)
end)

describe("enter_at", function()
  it("begins in a leaf without entries, and goes on from there", function()
    for _, by_name in ipairs { true, false } do
      local fsm = new()
      enter_at(fsm, by_name and "root.work.b" or fsm.work.b)
      assert.equal("root.work.b", at(fsm))
      rfsm.run(fsm)
      assert.equal("root.work.b", at(fsm))
      assert.same({}, fsm.entered)
      assert.equal("root.new", at(send(fsm, "e_back")))
      assert.same({ "root.new" }, fsm.entered)
    end
  end)

  it("arms the timers of the leaf and of the states around it", function()
    local fsm = new()
    enter_at(fsm, "root.work.a")
    assert.equal(0, time_in(fsm.work))
    assert.equal("root.work.a", at(pass(fsm, 4.5)))
    assert.equal("root.late", at(pass(fsm, 1)))
    fsm = new()
    enter_at(fsm, "root.new")
    fsm.gettime:advance(1)
    assert.equal(1, time_in(fsm.new))
  end)

  it("sends e_done as an entry does, that of a composite too", function()
    local fsm = new { [5] = trans { src = "work", tgt = "late",
      events = { "e_done" } } }
    enter_at(fsm, "root.work.b")
    assert.equal("root.late", at(send(fsm)))
    fsm = new { [5] = trans { src = "new", tgt = "late", events = { "e_done" } } }
    enter_at(fsm, fsm.new)
    assert.equal("root.late", at(send(fsm)))
  end)

  it("begins the doo of the leaf", function()
    local count = 0
    local fsm = new { new = state { doo = function()
      count = count + 1
      idle()
    end } }
    enter_at(fsm, "root.new")
    rfsm.run(fsm)
    assert.same({ 1, "active" }, { count, rfsm.get_sta_mode(fsm.new) })
  end)

  it("takes e_init_fsm from the queue, and keeps other events and sends", function()
    local fsm = new()
    rfsm.send_events(fsm, "e_b")
    timeevent.send_after(fsm, 1, "e_back")
    enter_at(fsm, "root.work.a")
    rfsm.run(fsm)
    assert.equal("root.work.b", at(fsm))
    assert.equal("root.new", at(pass(fsm, 2)))
  end)

  it("has regions begin anew", function()
    local fsm = new { par = rfsm.seqand { idle_doo = "auto", x = state { info = false,
      warn = false, a = state {}, b = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_b" } } } },
      [5] = trans { src = "new", tgt = "par", events = { "e_par" } } }
    enter_at(fsm, "root.par")
    rfsm.run(fsm)
    assert.equal("root.a", at(fsm.par.substates.x))
    assert.equal("root.b", at(send(fsm, "e_b").par.substates.x))
  end)

  it("works again after a reset, and for a root without states", function()
    local fsm = send(new())
    rfsm.reset(fsm)
    enter_at(fsm, "root.late")
    assert.equal("root.late", at(fsm))
    fsm = assert(rfsm.init(state { info = false }))
    enter_at(fsm, "root")
    assert.equal("root", at(fsm))
  end)

  for _, case in ipairs {
    { "a composite", "root.work", "leaf of the machine expected, got 'root.work'" },
    { "a wrong name", "root.work.bb", "state of the machine expected, got string "
      .. "'root.work.bb' (did you mean 'root.work.b'?)" },
    { "a leaf of another machine", new().late,
      "leaf of the machine expected, got 'root.late'" },
    { "no state", 5, "state of the machine expected, got number 5" },
  } do
    it("refuses " .. case[1], function()
      local fsm = new()
      local text = helper.refusal(enter_at, fsm, case[2])
      assert.equal("rfsm_timeevent.enter_at: " .. case[3], text:gsub("^.-:%d+: ", ""),
        nil)
      assert.is_false(at(fsm))
    end)
  end

  it("refuses an active machine", function()
    local fsm = send(new())
    assert.equal("rfsm_timeevent.enter_at: the machine is active (rfsm.reset makes it "
      .. "inactive)", helper.refusal(enter_at, fsm, "root.late"):gsub("^.-:%d+: ", ""),
      nil)
  end)
end)
