-- Deferral: events that a state keeps until the machine has left it.

local calls = require "rfsm.shared.calls"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local share = require "spec.support.share"
local snapshot = require "rfsm.snapshot"
require "rfsm.await"
require "rfsm.defer"
require "rfsm.emem"
require "rfsm_timeevent"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local state, trans = rfsm.state, rfsm.trans

local function idle()
  while true do rfsm.yield(true) end
end

local function join(events) return calls.text(" ", unpack(events)) end

-- A machine of a: busy, b: free, c: e_x was taken there. Notes the events of each
-- iteration that has some.
local function new(members)
  local model = { a = state { defer = { "e_x" } }, b = state {}, c = state {},
    info = false, warn = false,
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e_free" } },
    trans { src = "b", tgt = "c", events = { "e_x" } },
    trans { src = "c", tgt = "b", events = { "e_next" } } }
  for key, value in pairs(members or {}) do model[key] = value end -- any order
  local fsm = assert(rfsm.init(state(model)))
  fsm.trace = {}
  fsm.post_step_hook = function(_, events)
    if events[1] ~= nil then
      fsm.trace[#fsm.trace + 1] = join(events)
    end
  end
  rfsm.run(fsm)
  fsm.trace = {}
  return fsm
end

local function send(fsm, ...)
  rfsm.send_events(fsm, ...)
  rfsm.run(fsm)
  return fsm
end

local function at(fsm) return rfsm.get_actleaf_fqn(fsm) end

describe("deferral", function()
  -- What it does, the calls of send, the leaf, what is kept; more members.
  for _, case in ipairs {
    { "keeps an event", { { "e_x" } }, "root.a", "e_x" },
    { "keeps each one", { { "e_x", "e_x" }, { "e_x" } }, "root.a", "e_x e_x e_x" },
    { "does not keep others", { { "e_y" } }, "root.a", "" },
    { "recalls it in the next state", { { "e_x" }, { "e_free" } }, "root.c", "" },
    { "recalls it, kept in the same iteration", { { "e_free", "e_x" } }, "root.c", "" },
    { "discards a recalled event that nothing takes", { { "e_x", "e_x" }, { "e_free" },
      { "e_next" } }, "root.b", "" },
    { "keeps what another state defers on", { { "e_x", "e_x" }, { "e_free" } },
      "root.c", "e_x", { c = state { defer = { "e_x" } } } },
    { "of a composite is for the states in it", { { "e_x" } }, "root.a.p", "e_x",
      { a = state { defer = { "e_x" }, p = state {},
        trans { src = "initial", tgt = "p" } } } },
    { "yields to a transition further out", { { "e_x" } }, "root.c", "",
      { [5] = trans { src = "a", tgt = "c", events = { "e_x" } } } },
    { "yields to a transition on any event", { { "e_x" } }, "root.c", "",
      { [5] = trans { src = "a", tgt = "c" },
        a = state { defer = { "e_x" }, doo = idle } } },
    { "yields to an internal transition", { { "e_x" } }, "root.a", "",
      { [5] = trans { src = "a", tgt = "internal", events = { "e_x" } } } },
    { "keeps an event whose guard forbids", { { "e_x" } }, "root.a", "e_x",
      { [5] = trans { src = "a", tgt = "c", events = { "e_x" },
        guard = function() return false end } } },
    { "by a predicate never keeps what the machine makes", { { "e_x" } }, "root.a",
      "e_x", { a = state { defer = { function() return true end } } } },
    { "by a predicate that fails keeps nothing", { { "e_x" } }, "root.a", "",
      { a = state { defer = { function() error "no" end } } } },
    { "keeps as many as its max", { { "e_x", "e_x", "e_x" } }, "root.a", "e_x e_x",
      { a = state { defer = { "e_x", max = 2 } } } },
  } do
    it(case[1], function()
      local fsm = new(case[5])
      for _, events in ipairs(case[2]) do
        send(fsm, unpack(events))
      end
      assert.equal(case[3], at(fsm))
      assert.equal(case[4], join(rfsm.waiting(fsm)))
    end)
  end

  it("recalls one event an iteration, before what came later", function()
    local fsm = new { c = state { entry = function(fsm)
      rfsm.send_events(fsm, "e_next", "e_late")
    end } }
    send(fsm, "e_x", "e_x")
    fsm.trace = {}
    send(fsm, "e_free")
    assert.same({ "e_free", "e_x", "e_x", "e_done@root.b e_next e_late e_done@root.c" },
      { fsm.trace[1], fsm.trace[2], fsm.trace[3], fsm.trace[4] })
  end)

  it("keeps the event itself, not a copy", function()
    local event, seen = { name = "e_x" }, nil
    local fsm = new { a = state { defer = { rfsm.named "e_x" } },
      [3] = trans { src = "b", tgt = "c", events = { rfsm.named "e_x" },
        effect = function(_, _, _, events) seen = events[1] end } }
    send(fsm, event)
    assert.equal(event, rfsm.waiting(fsm)[1])
    send(fsm, "e_free")
    assert.equal(event, seen)
  end)

  it("takes a table of the model for itself", function()
    local event = { "an event" }
    local fsm = new { a = state { defer = { event } } }
    send(fsm, event)
    assert.equal(event, rfsm.waiting(fsm)[1])
  end)

  it("comes before those who count events, and after the timers", function()
    local now = 0
    local fsm = new { gettime = function() return now, 0 end,
      [5] = trans { src = "b", tgt = "a", events = { "e_after(1)" } },
      b = state {}, c = state {} }
    send(fsm, "e_x", "e_x", "e_free")
    assert.equal(1, fsm.c.emem["e_done@root.c"])
    send(fsm, "e_next")
    assert.equal("root.b", at(fsm))
    assert.equal(0, fsm.c.emem.e_x or 0)
    now = 2
    assert.equal("root.a", at(send(fsm, "e_late")))
  end)

  for _, is_merged in ipairs { false, true } do
    it("recalls one event alone, though a timer expires"
      .. (is_merged and ", also if it is merged" or ""), function()
      local now = 0
      local fsm = new { gettime = function() return now, 0 end,
        a = state { defer = not is_merged and { "e_x" } or nil },
        [5] = trans { src = "b", tgt = "a", events = { "e_after(1)" } } }
      if is_merged then
        assert.is_true(rfsm.fsm_merge(fsm, fsm, state { defer = { "e_x" } }, "d"))
        assert.is_true(rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "d",
          events = { "e_d" } }))
        assert.is_true(rfsm.fsm_merge(fsm, fsm, trans { src = "d", tgt = "b",
          events = { "e_free" } }))
        send(fsm, "e_d")
      end
      send(fsm, "e_x")
      rfsm.send_events(fsm, "e_free")
      rfsm.step(fsm)
      now, fsm.trace = 2, {}
      rfsm.run(fsm)
      assert.same({ "e_x", "e_done@root.b e_after(1)@root.b e_done@root.c" }, fsm.trace)
    end)
  end

  it("is explored with events as often as they were sent", function()
    local result = rfsm_checks.explore(state { info = false, warn = false,
      a = state { defer = { "e_x" } }, b = state {}, c = state {}, d = state {},
      off = state {}, trans { src = "initial", tgt = "off" },
      trans { src = "off", tgt = "a", events = { "e_two" } },
      trans { src = "a", tgt = "b", events = { "e_go" } },
      trans { src = "b", tgt = "c", events = { "e_x" } },
      trans { src = "c", tgt = "d", events = { "e_x" } } },
      { alphabet = { "e_two", "e_go" },
        sends = { ["effect root.trans[2]"] = { "e_x", "e_x" } } })
    assert.equal(5, result.taken)
  end)

  it("is dropped by a reset", function()
    local fsm = send(new(), "e_x")
    rfsm.reset(fsm)
    assert.same({}, rfsm.waiting(fsm))
  end)

  it("is held by snapshots", function()
    local fsm = send(new(), "e_x", "e_x")
    local other = assert(snapshot.restore(fsm, snapshot.take(fsm)))
    assert.equal("e_x e_x", join(rfsm.waiting(other)))
    assert.equal("root.c", at(send(other, "e_free")))
  end)

  it("is replaced by a snapshot", function()
    local fsm = send(new(), "e_x")
    local snap = snapshot.take(fsm)
    send(fsm, "e_x")
    snapshot.put(fsm, snap)
    assert.equal("e_x", join(rfsm.waiting(fsm)))
  end)

  it("is refused in a snapshot that is wrong", function()
    local fsm = send(new(), "e_x")
    local snap = snapshot.take(fsm)
    snap.ext = { defer = "e_x" }
    local other, problem = snapshot.restore(fsm, snap)
    assert.is_false(other)
    assert.truthy(problem:find("table expected for 'defer'", 1, true), problem)
  end)

  it("recalls an event before what a hook sends in that iteration", function()
    local is_free, fsm = false, nil
    fsm = new { [2] = trans { src = "a", tgt = "b", events = { "e_free" },
      effect = function() is_free = true end },
      getevents = function()
        if is_free then rfsm.send_events(fsm, "e_hook") end
        local events = is_free and { "e_got" } or {}
        is_free = false
        return events
      end }
    send(send(fsm, "e_x"), "e_free")
    assert.equal("e_free | e_x | e_done@root.b e_got e_hook e_done@root.c",
      table.concat(fsm.trace, " | ", 2))
  end)

  it("is known by strict, and by explorations", function()
    local warned = {}
    local fsm = new { strict = true, a = state { defer = { "e_x", max = 1 } },
      warn = function(text) warned[#warned + 1] = text end }
    send(fsm, "e_x")
    assert.same({}, warned)
    local found = rfsm_checks.explore(fsm, { alphabet = { "e_x", "e_free" } })
    assert.equal("11 configurations, 3 of 4 transitions taken",
      tostring(found):match("^(.-), %d+ steps"))
  end)

  it("traces what it does", function()
    local fsm, trace = new(), {}
    fsm.dbg = function(id, event)
      if id == "DEFERRED" or id == "RECALLED" then
        trace[#trace + 1] = id .. " " .. event
      end
    end
    send(send(fsm, "e_x"), "e_free")
    assert.same({ "DEFERRED e_x", "RECALLED e_x" }, trace)
  end)

  it("warns once of what is lost, and of what no transition takes", function()
    local warned = {}
    local fsm = new { a = state { defer = { "e_x", "e_odd", max = 1 } },
      warn = function(text) warned[#warned + 1] = text:gsub("^.-: .-: ", "") end }
    send(fsm, "e_odd", "e_x", "e_x")
    send(fsm, "e_odd", "e_x")
    assert.same({ "root.a.defer: 'e_odd' is deferred, but no transition takes it",
      "root.a.defer: 'e_x' is lost, too many events are deferred" }, warned)
  end)

  it("does not warn of what a transition may take", function()
    for _, events in ipairs { { function() return false end }, false } do
      local warned = {}
      local fsm = new { a = state { defer = { "e_odd" } },
        [5] = trans { src = "c", tgt = "a", events = events or nil },
        warn = function(text) warned[#warned + 1] = text end }
      assert.equal("e_odd", join(rfsm.waiting(send(fsm, "e_odd"))))
      assert.same({}, warned)
    end
  end)

  it("is of 64 events if there is no max", function()
    local fsm = new()
    for _ = 1, 65 do rfsm.send_events(fsm, "e_x") end
    rfsm.run(fsm)
    assert.equal(64, #rfsm.waiting(fsm))
    assert.equal(64, #snapshot.take(fsm).ext.defer)
  end)

  it("is a state like others if it has the name", function()
    local fsm = new { a = state { defer = state {}, trans { src = "initial",
      tgt = "defer" } } }
    assert.equal("root.a.defer", at(fsm))
  end)

  it("may be merged", function()
    local fsm = new()
    local leaf = state { defer = { "e_y" } }
    assert.is_true(rfsm.fsm_merge(fsm, fsm, leaf, "d"))
    assert.is_true(rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "d",
      events = { "e_d" } }))
    assert.equal("e_y", join(rfsm.waiting(send(send(fsm, "e_d"), "e_y"))))
  end)

  it("is taken by a transition that is merged, without a warning", function()
    local warned = {}
    local fsm = new { a = state { defer = { "e_x", "e_new" } },
      warn = function(text) warned[#warned + 1] = text end }
    send(fsm, "e_x")
    assert.is_true(rfsm.fsm_merge(fsm, fsm, trans { src = "c", tgt = "a",
      events = { "e_new" } }))
    send(fsm, "e_new")
    assert.same({}, warned)
    assert.equal("root.a", at(send(fsm, "e_free")))
  end)

  it("may be of more events than a function has arguments", function()
    local fsm = new { a = state { defer = { "e_x", max = 10000 } } }
    for i = 1, 10000 do
      rfsm.send_events(fsm, "e_x")
      if i % 1000 == 0 then rfsm.run(fsm) end
    end
    assert.equal(10000, #rfsm.waiting(fsm))
    local other = assert(snapshot.restore(fsm, snapshot.take(fsm)))
    assert.equal(10000, #rfsm.waiting(other))
  end)

  for _, case in ipairs {
    { "e_x", "root.a.defer: list of events expected, got string 'e_x'" },
    { {}, "root.a.defer: list of events expected, got table" },
    { { "e_x", max = 0 },
      "root.a.defer.max: whole number from 1 expected, got number 0" },
    { { "e_x", max = "8" },
      "root.a.defer.max: whole number from 1 expected, got string '8'" },
    { { "e_x", "e_done" },
      "root.a.defer[2]: 'e_done' is never deferred, the machine makes it" },
    { { "e_init_fsm" },
      "root.a.defer[1]: 'e_init_fsm' is never deferred, the machine makes it" },
  } do
    it("refuses " .. rfsm.text_of(case[1]):sub(1, 6) .. ": " .. case[2], function()
      local fsm, text = rfsm.init(state { err = false, info = false,
        a = state { defer = case[1] }, trans { src = "initial", tgt = "a" } })
      assert.is_false(fsm)
      assert.truthy(text:find(case[2], 1, true), text)
    end)
  end

  it("leaves the trace of the oracle on random charts", function()
    assert.is_nil(share.problem(dofile "spec/support/claims/defer.lua", 100))
  end)
end)
