-- Deferral: events that a state keeps until the machine has left it.

local calls = require "rfsm.shared.calls"
local helper = require "spec.helper"
local interrupts = require "spec.support.interrupts"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local share = require "spec.support.share"
local snapshot = require "rfsm.snapshot"
local defer = require "rfsm.defer"
require "rfsm.await"
require "rfsm.emem"
local rfsm_timeevent = require "rfsm_timeevent"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local state, trans = rfsm.state, rfsm.trans
local send = helper.moved

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

local function at(fsm) return rfsm.get_actleaf_fqn(fsm) end

it("a machine is not idle while it would recall another event", function()
  local guarded = rfsm.named "e_job"
  local fsm = helper.started(state { info = false,
    a = state { defer = { guarded } }, b = state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { guarded },
      guard = function(_, _, event) return event.n == 3 end } })
  rfsm.send_events(fsm, { name = "e_job", n = 1 }, { name = "e_job", n = 2 },
    { name = "e_job", n = 3 })
  assert.is_true(rfsm.run(fsm))
  assert.equal("root.b", at(fsm))
end)

it("a guard that drops another event leaves the recalled one in the list", function()
  local fsm
  fsm = helper.started(state { info = false, warn = false,
    a = state { defer = { "e_x", "e_y" } }, trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "internal", events = { "e_x" }, guard = function()
      defer.drop(fsm, "e_y")
      return false
    end } })
  rfsm.send_events(fsm, "e_x", "e_y")
  assert.is_true(rfsm.run(fsm))
  assert.same({ "e_x" }, rfsm.waiting(fsm))
end)

it("a guard that drops the recalled event, and a hook that drops none, end", function()
  local fsm, count = nil, 0
  fsm = helper.started(state { info = false, warn = false,
    a = state { defer = { "e_x" } }, trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "internal", events = { "e_x" }, guard = function()
      count = count + 1
      if count > 1 then defer.drop(fsm, "e_x") end
      return count > 9
    end } })
  rfsm.post_step_hook_add(fsm, function() defer.drop(fsm, "e_y") end)
  rfsm.send_events(fsm, "e_x")
  assert.is_true(rfsm.run(fsm))
  assert.same({ 2, {} }, { count, rfsm.waiting(fsm) })
end)

it("an object that a named transition takes is deferred without a warning", function()
  local named, warnings = rfsm.named "e_job", {}
  local fsm = helper.started(state { info = false, final = true,
    warn = function(text) warnings[#warnings + 1] = text end,
    a = state { defer = { named } }, b = state {}, c = state { final = true },
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e_go" } },
    trans { src = "b", tgt = "c", events = { named } } })
  rfsm.send_events(fsm, setmetatable({ name = "e_job" }, { __index = {} }))
  rfsm.run(fsm)
  rfsm.send_events(fsm, "e_go")
  rfsm.run(fsm)
  assert.equal("root.c", at(fsm))
  assert.same({}, warnings)
end)

it("a post step hook that fails keeps no event from being deferred, or told", function()
  local told = {}
  local fsm = helper.started(rfsm.state { info = false,
    a = rfsm.state { defer = { "e_job" } }, b = rfsm.state { final = true },
    rfsm.trans { src = "initial", tgt = "a" },
    rfsm.trans { src = "a", tgt = "b", events = { "e_go" } } })
  rfsm.watch_hook_add(fsm, "discarded", function(_, event) told[#told + 1] = event end)
  local function fail() error("no room", 0) end
  rfsm.post_step_hook_add(fsm, fail, "before")
  rfsm.send_events(fsm, "e_job", "e_no")
  assert.same({ false, "no room" }, { pcall(rfsm.step, fsm) })
  assert.same({ { "e_job" }, { "e_no" } }, { rfsm.waiting(fsm), told })
end)

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

  -- A switch: `free` and `left` take e_take and e_drop in turn; both defer e_take.
  local function new_switch(members)
    local model = { info = false, warn = false,
      free = state { defer = { "e_take" } }, left = state { defer = { "e_take" } },
      trans { src = "initial", tgt = "free" },
      trans { src = "free", tgt = "left", events = { "e_take" } },
      trans { src = "left", tgt = "free", events = { "e_drop" } } }
    for key, value in pairs(members or {}) do model[key] = value end -- any order
    local fsm = assert(rfsm.init(state(model)))
    rfsm.run(fsm)
    return send(fsm, "e_take")
  end

  it("recalls what a transition of an active state takes, though it is deferred",
    function()
      local fsm = send(new_switch(), "e_take", "e_drop")
      assert.equal("root.left", at(fsm))
      assert.equal("", join(rfsm.waiting(fsm)))
    end)

  it("recalls in the old order: no newer event overtakes", function()
    local seen = {}
    local first, second = { name = "e_take", n = 1 }, { name = "e_take", n = 2 }
    local take = rfsm.named "e_take"
    local fsm = new_switch { left = state { defer = { take } },
      free = state { defer = { take } }, [2] = trans { src = "free", tgt = "left",
        events = { "e_take", take },
        effect = function(_, _, _, _, event) seen[#seen + 1] = event.n or event end } }
    send(fsm, first, second)
    send(send(fsm, "e_drop"), "e_drop")
    assert.same({ "e_take", 1, 2 }, seen)
  end)

  it("recalls what a transition without events takes", function()
    local fsm = new_switch { [2] = trans { src = "free", tgt = "left",
      guard = function(tr) return tr._fsm.is_open end },
      [4] = trans { src = "free", tgt = "internal", events = { "e_look" } } }
    fsm.is_open = false
    send(fsm, "e_take", "e_drop")
    send(fsm, "e_take")
    fsm.is_open = true
    assert.equal("root.left", at(send(fsm, "e_look")))
  end)

  it("keeps the place of what nothing takes, until the next path", function()
    local asked = {}
    local function is_open(tr, _, event)
      asked[#asked + 1] = event
      return tr._fsm.is_open
    end
    local fsm = new { is_open = false, b = state { defer = { "e_x", "e_y" } },
      a = state { defer = { "e_x", "e_y", "e_z" } },
      [3] = trans { src = "b", tgt = "c", events = { "e_x" }, guard = is_open },
      [5] = trans { src = "b", tgt = "internal", events = { "e_open", "e_look" },
        effect = function(own, _, _, _, event) own.is_open = event == "e_open" end } }
    send(fsm, "e_x", "e_y", "e_z")
    send(fsm, "e_free")
    assert.equal("e_x e_y", join(rfsm.waiting(fsm)))
    assert.same({ "e_x" }, asked)
    for _ = 1, 3 do rfsm.step(fsm) end
    send(fsm, "e_odd")
    assert.same({ "e_x" }, asked)
    send(fsm, "e_look")
    assert.same({ "e_x", "e_x" }, asked)
    assert.equal("e_x e_y", join(rfsm.waiting(fsm)))
    assert.equal("root.c", at(send(fsm, "e_open")))
    assert.equal("", join(rfsm.waiting(fsm)))
  end)

  it("looks at what is kept after a path only", function()
    local count = 0
    local fsm = new { a = state { defer = { function(event)
      count = count + 1
      return event == "e_x"
    end } } }
    for _ = 1, 20 do rfsm.send_events(fsm, "e_x") end
    rfsm.run(fsm)
    count = 0
    for _ = 1, 5 do rfsm.step(fsm) end
    assert.equal(0, count)
  end)

  it("comes behind what comes again beside an internal transition", function()
    local now = 0
    local fsm = new { gettime = function() return now, 0 end,
      b = state { defer = { "e_x" } },
      [3] = trans { src = "b", tgt = "c", events = { "e_x" },
        guard = function(tr) return tr._fsm.is_open end },
      [5] = trans { src = "b", tgt = "internal", events = { "e_open" },
        effect = function(own) own.is_open = true end },
      [6] = trans { src = "b", tgt = "internal", events = { "e_after(1)" } } }
    fsm.is_open = false
    send(send(fsm, "e_x"), "e_free")
    now, fsm.trace = 2, {}
    send(fsm, "e_open", "e_late")
    assert.equal("e_open e_late e_after(1)@root.b | e_after(1)@root.b | e_x"
      .. " | e_done@root.c", table.concat(fsm.trace, " | "))
    fsm = send(send(new { read = "one", gettime = function() return now, 0 end,
      a = state { defer = { "e_x" } }, b = state { defer = { "e_x" } },
      [3] = trans { src = "b", tgt = "internal", events = { "e_x" } } }, "e_x"),
      "e_free")
    assert.equal("", join(rfsm.waiting(fsm)))
  end)

  it("comes behind what comes again, wherever an interrupt comes", function()
    local instruction, is_reached = 0, true
    interrupts.without_jit(function()
      while is_reached do
        local fsm = new { b = state { defer = { "e_x" } }, d = state {},
          [3] = trans { src = "b", tgt = "c", events = { "e_x" },
            guard = function(tr) return tr._fsm.is_open end },
          [5] = trans { src = "b", tgt = "internal", events = { "e_open" },
            effect = function(own) own.is_open = true end },
          [6] = trans { src = "b", tgt = "d", events = { "e_done" } } }
        fsm.is_open = false
        rfsm.send_events(fsm, "e_free")
        rfsm.step(fsm) -- e_done waits
        rfsm.send_events(fsm, "e_x", "e_open")
        rfsm.step(fsm)
        instruction = instruction + 1
        is_reached = interrupts.raise(instruction, interrupts.VALUES[1], rfsm.step, fsm)
        rfsm.run(fsm)
        assert.equal("root.d", rfsm.get_actleaf_fqn(fsm))
      end
    end)
    assert.is_true(instruction > 100)
  end)

  it("is looked at again after a snapshot, with what comes before it", function()
    local now = 0
    local fsm = new { gettime = function() return now, 0 end, is_open = false,
      b = state { defer = { "e_x" } },
      [3] = trans { src = "b", tgt = "c", events = { "e_x" },
        guard = function(tr) return tr._fsm.is_open end },
      [5] = trans { src = "b", tgt = "internal", events = { "e_open" } },
      [6] = trans { src = "b", tgt = "internal", events = { "e_after(1)" } } }
    send(send(fsm, "e_x"), "e_free")
    local other = assert(snapshot.restore(fsm, snapshot.take(fsm)))
    other.is_open = true
    assert.equal("root.c", at(send(other)))
    now = 2
    rfsm.send_events(fsm, "e_open")
    rfsm.step(fsm)
    other = assert(snapshot.restore(fsm, snapshot.take(fsm)))
    other.is_open, other.trace = true, {}
    other.post_step_hook = function(_, events)
      other.trace[#other.trace + 1] = join(events)
    end
    rfsm.step(other)
    assert.same({ "e_after(1)@root.b" }, other.trace)
  end)

  it("is looked at again after a merge", function()
    local fsm = send(new(), "e_x")
    assert.is_true(rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "c",
      events = { "e_x" } }))
    assert.equal("root.c", at(send(fsm)))
  end)

  it("belongs to the machine, not to the model", function()
    local list = { "e_x", max = 1 }
    local fsm = new { a = state { defer = list } }
    list[1], list.max = "e_y", 9
    assert.equal("e_x", join(rfsm.waiting(send(fsm, "e_x", "e_x", "e_y"))))
  end)

  for _, case in ipairs {
    { "all", {}, 4 }, { "those of a name", { "e_x" }, 3 },
    { "no other", { "e_z" }, 0 },
  } do
    it("drops " .. case[1], function()
      local fsm = new { a = state { defer = { "e_x", "e_y", rfsm.named "e_x" } } }
      send(fsm, "e_x", "e_y", { name = "e_x" }, "e_x")
      assert.equal(4, #rfsm.waiting(fsm))
      assert.equal(case[3], defer.drop(fsm, unpack(case[2])))
      assert.equal(4 - case[3], #rfsm.waiting(fsm))
    end)
  end

  it("drops in a callback, and in a machine that defers nothing", function()
    local fsm = new { [2] = trans { src = "a", tgt = "b", events = { "e_free" },
      effect = function(own) defer.drop(own) end } }
    assert.equal("root.b", at(send(fsm, "e_x", "e_free")))
    assert.equal(0, defer.drop(assert(rfsm.init(state { info = false }))))
    assert.has_error(function() defer.drop {} end,
      "rfsm.defer.drop: initialised fsm expected, got table")
  end)

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
    { {}, "root.a.defer: list of events expected, got an empty list" },
    { { events = "e_x" },
      "root.a.defer: list of events expected, got a table with holes or keys" },
    { { "e_x", nil, "e_y" },
      "root.a.defer: list of events expected, got a table with holes or keys" },
    { { max = 3 }, "root.a.defer: list of events expected, got an empty list" },
    { { "e_after(3)" },
      "root.a.defer[1]: 'e_after(3)' is never deferred, the machine makes it" },
    { { "e_x", rfsm_timeevent.e_every(3) },
      "root.a.defer[2]: 'e_every(3)' is never deferred, the machine makes it" },
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

  for _, case in ipairs {
    { { "e_yx" }, "defer 'e_yx', but no transition takes it (did you mean 'e_xy'?)" },
    { { "e_go" }, "defer 'e_go' has no effect, root.trans[2] (a -> b) takes it" },
    { { rfsm.named "e_go" }, "defer 'e_go', but no transition takes it (did you mean "
      .. "the text 'e_go'?)" },
    { { "e_z" }, "defer 'e_z', but no transition takes it (did you mean rfsm.named "
      .. "'e_z'?)", event = rfsm.named "e_z" },
    { { rfsm.named }, "rfsm.named is not called (did you mean rfsm.named(..)?)" },
    { { "e_go, e_xy" }, "'e_go, e_xy' is one event with a comma in its name" },
    { { { name = "e_go" } }, "a table is equal to itself only (did you mean rfsm.named "
      .. "'e_go'?)" },
    { { rfsm.named "e_zx" }, "defer 'e_zx', but no transition takes it (there are "
      .. "'e_go', 'e_xy')", event = rfsm.named "e_z" },
    { { "e_xy", rfsm.named "e_z" }, event = rfsm.named "e_z" },
    { { "e_xy" }, event = rfsm.named "e_z" },
    { { "e_go" }, guard = print },
    { { "e_go" }, tgt = "k" },
    { { "e_zz" }, event = print },
    { { print } },
  } do
    it("is checked for events that nothing takes, or the state itself: "
      .. (case[2] or "none"), function()
      local found = {}
      for _, finding in ipairs(require("rfsm_checks").findings(state { info = false,
        warn = false, a = state { defer = case[1] }, b = state {},
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = case.tgt or "b", events = { "e_go" },
          guard = case.guard },
        k = rfsm.conn {}, trans { src = "k", tgt = "b", guard = print },
        trans { src = "b", tgt = "a", events = { "e_xy", case.event } } })) do
        local is_wanted = finding.code == "idle-reaction" or finding.code == "odd-event"
        if is_wanted then found[#found + 1] = finding.text end
      end
      assert.same({ case[2] }, found)
    end)
  end

  it("leaves the trace of the oracle on random charts", function()
    assert.is_nil(share.problem(dofile "spec/support/claims/defer.lua", 100))
  end)
end)
