-- Events that are sent later: rfsm_timeevent.send_after, cancel.

local calls = require "rfsm.shared.calls"
local clock = require "rfsm.clock"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local rfsm_timeevent = require "rfsm_timeevent"
local seqand = require "rfsm_seqand"
local share = require "spec.support.share"
local snapshot = require "rfsm.snapshot"

local state, trans = rfsm.state, rfsm.trans
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local send_after, cancel = rfsm_timeevent.send_after, rfsm_timeevent.cancel

local function join(events) return calls.text(" ", unpack(events)) end

local now

-- A machine of a and b that has run, whose field `came` has the events of iterations.
local function new(members)
  now = clock.simulated { now = 100 }
  local model = { info = false, warn = false, gettime = now,
    a = state {}, b = state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e_x", "e_after(3)" } } }
  for key, value in pairs(members or {}) do model[key] = value end -- any order
  local fsm = assert(rfsm.init(state(model)))
  fsm.post_step_hook = function(own, events)
    if events[1] ~= nil then own.came[#own.came + 1] = join(events) end
  end
  fsm.came = {}
  rfsm.run(fsm)
  fsm.came = {}
  return fsm
end

local function run_after(fsm, seconds)
  now:advance(seconds)
  rfsm.run(fsm)
  return join(fsm.came)
end

describe("an event that is sent later", function()
  it("comes when its time has passed, and once", function()
    local fsm = new()
    send_after(fsm, 2, "e_y")
    assert.equal("", run_after(fsm, 2))
    assert.equal("e_y", run_after(fsm, 1e-9))
    assert.equal("e_y", run_after(fsm, 0.5))
  end)

  it("comes in the order of times, then of calls", function()
    local fsm = new()
    for i, seconds in ipairs { 2, 1, 2, 0, 1 } do send_after(fsm, seconds, i) end
    assert.equal("4 2 5 1 3", join(rfsm.waiting(fsm)))
    assert.equal("4 2 5 1 3", run_after(fsm, 2.5))
    assert.equal(0, #rfsm.waiting(fsm))
  end)

  it("comes with the timers that have expired, after them", function()
    local fsm = new()
    send_after(fsm, 1, "e_y")
    assert.equal("e_after(3)@root.a e_y e_done@root.b", run_after(fsm, 4))
  end)

  it("comes to whatever state is active, also to a machine without timers", function()
    local fsm = new { [2] = trans { src = "a", tgt = "b", events = { "e_x" } } }
    send_after(fsm, 1, "e_x")
    run_after(fsm, 2)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)

  it("may be sent and taken back by callbacks", function()
    local fsm = new { b = state {
      entry = function(fsm) send_after(fsm, 1, "e_y", "y") end,
      exit = function(fsm) assert(cancel(fsm, "y")) end },
      [3] = trans { src = "b", tgt = "a", events = { "e_back" } } }
    rfsm.send_events(fsm, "e_x")
    rfsm.run(fsm)
    assert.equal("e_y", join(rfsm.waiting(fsm)))
    rfsm.send_events(fsm, "e_back")
    rfsm.run(fsm)
    assert.equal("", join(rfsm.waiting(fsm)))
  end)

  it("is cancelled by its id, compared by identity", function()
    local fsm, id = new(), setmetatable({}, { __eq = function() return true end })
    local other = setmetatable({}, getmetatable(id))
    send_after(fsm, 1, "e_y", id)
    send_after(fsm, 1, "e_z")
    assert.is_false(cancel(fsm, other))
    assert.is_false(cancel(fsm, nil))
    assert.is_true(cancel(fsm, id))
    assert.is_false(cancel(fsm, id))
    assert.equal("e_z", run_after(fsm, 2))
    assert.is_false(cancel(new(), "y"))
  end)

  it("counts for next_deadline, also in a region", function()
    local fsm = new()
    send_after(fsm, 1, "e_y")
    assert.equal(1.000000001, rfsm_timeevent.next_deadline(fsm))
    now:advance(2)
    assert.equal(0, rfsm_timeevent.next_deadline(fsm))
    rfsm.run(fsm)
    assert.equal(1.000000001, rfsm_timeevent.next_deadline(fsm)) -- the timer of a
    local outer = new { a = seqand { sub = state { p = state {},
      trans { src = "initial", tgt = "p" } } }, [2] = false }
    send_after(outer.a.substates.sub, 1, "e_y")
    assert.equal(1.000000001, rfsm_timeevent.next_deadline(outer))
  end)

  it("is dropped by a reset", function()
    local fsm = new()
    send_after(fsm, 1, "e_y")
    rfsm.reset(fsm)
    assert.equal("", join(rfsm.waiting(fsm)))
    send_after(fsm, 1, "e_z", "z")
    assert.is_true(cancel(fsm, "z"))
  end)

  for _, members in ipairs {
    {}, { [2] = trans { src = "a", tgt = "b", events = { "e_x" } } },
  } do
    it("is held by snapshots with the time left, beside "
      .. (members[2] and "no timers" or "timers"), function()
      local fsm = new(members)
      send_after(fsm, 2, "e_y", "y")
      send_after(fsm, 1e7, "e_late")
      send_after(fsm, 2, "e_z")
      now:advance(0.5)
      local snap = snapshot.take(fsm)
      assert.same({ { event = "e_y", id = "y", after = 1.5 },
        { event = "e_z", after = 1.5 },
        { event = "e_late", after = { 1e7 - 1, 5e8 } } }, snap.ext.sends)
      now:advance(50)
      local other = assert(snapshot.restore(fsm, snap))
      other.came, other.post_step_hook = fsm.came, fsm.post_step_hook
      assert.equal("", run_after(other, 1.5))
      assert.equal("e_y e_z", run_after(other, 0.1))
      assert.equal("e_late", join(rfsm.waiting(other)))
    end)
  end

  it("is refused in a snapshot that is wrong", function()
    local fsm = new()
    for _, case in ipairs {
      { { {} }, "list of events with `after` expected" },
      { { { event = "e_x", after = "1" } },
        "seconds and nanoseconds expected for an event that is sent later" },
    } do
      local snap = snapshot.take(fsm)
      snap.ext = { sends = case[1] }
      local other, problem = snapshot.restore(fsm, snap)
      assert.is_false(other)
      assert.truthy(problem:find(case[2], 1, true), problem)
    end
  end)

  for _, case in ipairs {
    { "seconds, a finite number not below 0, expected, got number -1", -1, "e" },
    { "seconds, a finite number not below 0, expected, got number nan", 0 / 0, "e" },
    { "seconds, a finite number not below 0, expected, got number inf", math.huge,
      "e" },
    { "seconds, a finite number not below 0, expected, got string '1'", "1", "e" },
    { "event expected, got nil", 1 },
    { "an event with the id y is waiting", 1, "e", "y" },
  } do
    it("is refused: " .. case[1], function()
      local fsm = new()
      send_after(fsm, 1, "e_y", "y")
      local ok, problem = pcall(function()
        send_after(fsm, unpack(case, 2, 4))
        return true
      end)
      assert.is_false(ok)
      assert.equal("spec/sends_spec.lua: rfsm_timeevent.send_after: " .. case[1],
        (problem:gsub("%-nan", "nan"):gsub(":%d+:", ":", 1)))
      assert.equal("e_y", join(rfsm.waiting(fsm)))
    end)
  end

  it("is refused by what is no machine, and by a clock that fails", function()
    assert.error_matches(function() send_after({}, 1, "e") end,
      "^rfsm_timeevent.send_after: initialised fsm expected, got table$")
    assert.error_matches(function() cancel({}, 1) end,
      "^rfsm_timeevent.cancel: initialised fsm expected, got table$")
    local fsm = new()
    fsm.gettime = function() error("stopped", 0) end
    assert.error_matches(function() send_after(fsm, 1, "e") end,
      "^rfsm_timeevent.send_after: the clock failed: stopped$")
  end)

  it("traces", function()
    local fsm, trace = new(), {}
    fsm.dbg = function(id, event)
      if id == "TIMEEVENT" then trace[#trace + 1] = event end
    end
    send_after(fsm, 1, "e_y")
    run_after(fsm, 2)
    assert.same({ "e_y" }, trace)
  end)

  it("comes as a list says, on random clocks", function()
    assert.is_nil(share.problem(dofile "spec/support/claims/sends.lua", 300))
  end)
end)

-- An event sent later and timers that come at one moment, at the time of day.
describe("times that meet", function()
  local START = 1700000000 -- seconds
  local EVENTS = { "e_after(%.3f)", "e_every(%.3f)" }
  local SHOWN = "e_after(%.3f)@root.a e_every(%.3f)@root.a e_sent"

  -- Returns a machine that waits for them, 1.5 periods after its entry.
  local function waiting_for(period, gettime, wait)
    local fsm = new { gettime = gettime,
      a = state { entry = function(fsm) send_after(fsm, 2 * period, "e_sent") end },
      [2] = trans { src = "a", tgt = "internal", events = {
        EVENTS[1]:format(2 * period), EVENTS[2]:format(period), "e_sent" } } }
    wait(1.5 * period)
    rfsm.run(fsm)
    fsm.came = {}
    return fsm
  end

  local function shown(period) return SHOWN:format(2 * period, period) end

  it("come a nanosecond later, and not before", function()
    for _, period in ipairs { 0.05, 0.15, 0.35, 0.55 } do
      local exact = clock.simulated { now = START }
      local fsm = waiting_for(period, exact, function(s) exact:advance(s) end)
      exact:advance(0.5 * period)
      for _ = 1, 2 do
        rfsm.run(fsm)
        assert.equal("", join(fsm.came))
        local hook = fsm.post_step_hook
        fsm = assert(snapshot.restore(fsm, snapshot.take(fsm)))
        fsm.post_step_hook, fsm.came = hook, {}
      end
      exact:advance(1e-9)
      rfsm.run(fsm)
      assert.equal(shown(period), join(fsm.came))
    end
  end)

  for _, case in ipairs {
    { "seconds with a fraction", function(at) return at, 0 end },
    { "nanoseconds in one number", function(at) return at * 1e9 end },
    { "whole nanoseconds", function(at)
      return math.floor(at) * 1000000000 + math.floor(at % 1 * 1e9)
    end },
  } do
    it("come together on a clock of " .. case[1], function()
      local random = new_random(7)
      for _ = 1, 300 do
        local entered, period = START + random(1000000) / 1e6, random(2000) / 1000
        local at = entered
        local fsm = waiting_for(period, function() return case[2](at) end,
          function(s) at = at + s end)
        at = entered + 2 * period - 2 ^ -22
        for _ = 1, 5 do
          if not fsm.came[1] then rfsm.run(fsm) end
          at = at + 2 ^ -22
        end
        assert.equal(shown(period), join(fsm.came))
      end
    end)
  end
end)
