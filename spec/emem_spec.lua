-- Event memory.

local helper = require "spec.helper"
local host_of = require "spec.support.server_host"
local rfsm = require "rfsm"
local rfsm_emem = require "rfsm.emem"
local share = require "spec.support.share"

local state, trans = rfsm.state, rfsm.trans
local run = helper.post_and_run

local function wait()
  while true do rfsm.yield(true) end
end

-- (initial) -> c[ (initial) -> a --e_next--> b --e_next--> a ] --e_out--> out,
-- out --e_in--> c
-- without e_done from a and b.
local function chart()
  return state {
    warn = false, info = false,
    c = state {
      a = state { doo = wait }, b = state { doo = wait },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_next" } },
      trans { src = "b", tgt = "a", events = { "e_next" } },
    },
    out = state {},
    trans { src = "initial", tgt = "c" },
    trans { src = "c", tgt = "out", events = { "e_out" } },
    trans { src = "out", tgt = "c", events = { "e_in" } },
  }
end

-- A machine in state a after these events, and its counts there.
local function started(model, ...)
  local fsm = helper.started(model or chart())
  if ... then run(fsm, ...) end
  return fsm, fsm.c.a.emem
end

-- The counts of e_x in the root, c, a and b.
local function counts(fsm)
  return table.concat(helper.texts(fsm.emem.e_x, fsm.c.emem.e_x, fsm.c.a.emem.e_x,
    fsm.c.b.emem.e_x), " ")
end

describe("emem", function()
  it("is there in each machine initialised after the module was loaded", function()
    assert.same({}, helper.init(state { emem = nil }).emem)
    assert.same({}, helper.init(chart()).c.b.emem)
  end)

  it("counts all events of an iteration for all active states, and for no other",
    function()
      local fsm = started(nil, "e_x", "e_x", "e_y", "e_x", "e_x")
      run(fsm, "e_x")
      assert.equal("5 5 5 nil", counts(fsm))
      assert.equal(1, fsm.c.a.emem.e_y)
    end)

  it("has counted before guards are asked", function()
    local model = chart()
    model.c[2].guard = function(tr) return tr.src.emem.e_next >= 2 end
    local fsm = started(model)
    assert.equal("root.c.a", helper.leaf_after(fsm, "e_next"))
    assert.equal("root.c.b", helper.leaf_after(fsm, "e_next"))
  end)

  it("does not count the events that make the state be entered, a composite's go on",
    function()
      local fsm = started(nil, "e_next", "e_x")
      assert.equal("1 1 0 nil", counts(fsm))
      run(fsm, "e_x")
      assert.equal("2 2 0 1", counts(fsm))
    end)

  it("counts an event once that a hook has put back into the queue", function()
    local fails, fsm = false, started()
    rfsm.pre_step_hook_add(fsm, function()
      if fails then error("on purpose", 0) end
    end)
    for _, event in ipairs { "e_x", "e_y", "e_x" } do
      rfsm.send_events(fsm, event)
      fails = true
      assert.is_false((pcall(rfsm.step, fsm)))
      rfsm.send_events(fsm, "e_x")
      fails = false
      rfsm.step(fsm)
    end
    assert.equal("5 5 5 nil", counts(fsm))
    assert.equal(1, fsm.emem.e_y)
  end)

  it("is set to 0 on exit, in the same table, after the user's exit has read it",
    function()
      local model, seen = chart(), nil
      model.c.a.exit = function(_, self) seen = self.emem.e_x end
      local fsm, emem = started(model, "e_x")
      run(fsm, "e_next")
      assert.equal(emem, fsm.c.a.emem)
      assert.same({ 1, 0 }, { seen, emem.e_x })
    end)

  it("is set to 0 by reset", function()
    local fsm = started(nil, "e_x")
    rfsm.reset(fsm)
    assert.equal("0 0 0 nil", counts(fsm))
  end)

  it("counts objects by identity, and forgets an event with its object", function()
    local event = {}
    local fsm, emem = started(nil, event, {}, event)
    assert.equal(2, emem[event])
    event = nil -- luacheck: ignore 311
    run(fsm) -- the events table of that iteration goes, too
    collectgarbage()
    assert.is_nil(next(emem))
  end)

  it("counts events with data by their name", function()
    local fsm = started(nil, { name = "e_x", v = 1 }, { name = "e_x", v = 2 }, "e_x")
    assert.equal("3 3 3 nil", counts(fsm))
    run(fsm, { name = 7 }, setmetatable({ name = "e_x" }, {}), { name = "e_y" })
    assert.equal("3 3 3 nil", counts(fsm))
    assert.equal(1, fsm.c.emem.e_y)
  end)

  it("remembers events with data that a transition names, however many come", function()
    local model = chart()
    model.c[2].events = { rfsm.named "e_paid" }
    local fsm = started(model)
    run(fsm, { name = "e_paid", v = 1 })
    for i = 1, 1001 do run(fsm, { name = "e_pos" .. i }) end
    assert.same({ 1, 1 }, { fsm.c.emem.e_paid, fsm.c.emem.e_pos1001 })
    assert.is_nil(fsm.c.emem.e_pos1)
  end)

  it("bears an event that is NaN", function()
    assert.equal("1 1 1 nil", counts((started(nil, 0 / 0, "e_x"))))
  end)

  it("counts what a step hook of the user adds", function()
    local model, is_added = chart(), false
    model.pre_step_hook = function(_, events)
      if is_added or #events > 0 then return end
      is_added, events[1] = true, "e_x"
    end
    assert.equal("1 1 1 nil", counts((started(model))))
  end)

  it("is there for a state that was merged", function()
    local fsm = started()
    rfsm.fsm_merge(fsm, fsm, state {}, "new")
    rfsm.fsm_merge(fsm, fsm, trans { src = "c", tgt = "new", events = { "e_new" } })
    run(fsm, "e_new")
    run(fsm, "e_x")
    assert.equal(1, fsm.new.emem.e_x)
  end)

  it("is left out of a state that says false, which gets no hook", function()
    local model, hooked = chart(), {}
    rfsm.mapfsm(function(part) part.emem = false end, model, rfsm.is_state)
    model.emem, model.c.b.emem = nil, nil
    local add = rfsm.exit_hook_add
    local fsm = helper.with(rfsm, { exit_hook_add = function(fsm, part, f)
      hooked[#hooked + 1] = part._fqn
      return add(fsm, part, f)
    end }, function() return started(model, "e_x") end)
    assert.same({ "root", "root.c.b" }, hooked)
    assert.same({ 1, false }, { fsm.emem.e_x, fsm.c.a.emem })
  end)

  it("is left out of a machine whose root says false", function()
    local model = chart()
    model.emem = false
    assert.is_nil(helper.started(model).c.emem)
  end)
end)

describe("events that no transition names", function()
  -- A machine in which so many different ones came, and its memory.
  local function after(n)
    local fsm = started(nil, "e_next", "e_next")
    for i = 1, n do rfsm.send_events(fsm, "e_pos(" .. i .. ")") end
    rfsm.step(fsm)
    return fsm, fsm.emem
  end

  it("are remembered up to a thousand, then forgotten", function()
    local fsm, emem = after(1000)
    assert.equal(1001, #rfsm.sorted_keys(emem))
    run(fsm, "e_pos(1)", "e_pos(1000)")
    assert.same({ 2, 1, 2 }, { emem["e_pos(1)"], emem["e_pos(2)"],
      emem["e_pos(1000)"] })
    run(fsm, "e_pos(1001)", "e_pos(1)")
    assert.same({ ["e_pos(1001)"] = 1, ["e_pos(1)"] = 1, e_next = 2 }, emem)
  end)

  it("leave others as they are, also those that were merged", function()
    local fsm, emem = after(3000)
    assert.equal(2, emem.e_next)
    rfsm.fsm_merge(fsm, fsm.c, trans { src = "a", tgt = "b", events = { "e_more" } })
    run(fsm, "e_more")
    for i = 1, 1500 do rfsm.send_events(fsm, i) end
    rfsm.step(fsm)
    assert.same({ 1, 500 }, { emem.e_more, #rfsm.sorted_keys(emem, function(_, key)
      return type(key) == "number"
    end) })
  end)
end)

describe("a snapshot", function()
  local snapshot = require "rfsm.snapshot"

  it("has the counts, and takes the place of those that are there", function()
    local fsm = started(nil, "e_x", "e_y")
    local snap = snapshot.take(fsm)
    assert.same({ e_x = 1, e_y = 1 }, snap.ext.emem["root.c.a"])
    assert.is_nil(snap.ext.emem["root.c.b"])
    local other = started(nil, "e_z", "e_z")
    other.c.b.emem.e_x = 3
    assert(snapshot.put(other, snap))
    assert.same({ e_x = 1, e_y = 1 }, other.c.a.emem)
    assert.same({}, other.c.b.emem)
    run(other, "e_x")
    assert.same({ e_x = 2, e_y = 1 }, other.c.a.emem)
  end)

  it("has the counts of events with data, and none of objects", function()
    local object, kept = {}, { name = "e_x", list = { 1 } }
    local fsm = started(nil, kept, kept, object, print, setmetatable({}, {}))
    for _ = 1, 2 do
      local snap = snapshot.take(fsm)
      assert.same({ e_x = 2 }, snap.ext.emem["root.c.a"])
      local other = assert(snapshot.restore(chart(), snap))
      run(other, { name = "e_x" })
      assert.same({ e_x = 3 }, other.c.a.emem)
      collectgarbage()
    end
    assert.equal(1, fsm.c.a.emem[object])
    assert.is_nil((snapshot.take((started(nil, object))).ext or {}).emem)
  end)

  it("of a machine without counts has none", function()
    assert.is_nil((snapshot.take(helper.init(chart())).ext or {}).emem)
  end)

  it("with other data is refused", function()
    for _, case in ipairs {
      { emem = { ["root.c"] = 5 }, problem = "table of counts expected" },
      { emem = { ["root.c"] = { e_x = "5" } }, problem = "number of events expected" },
    } do
      local snap = snapshot.take((started(nil, "e_x")))
      snap.ext.emem = case.emem
      local _, problem = snapshot.restore(chart(), snap)
      assert.is_truthy(problem:find(case.problem, 1, true), problem)
    end
  end)

  it("counts towards the thousand", function()
    local fsm = started()
    local snap = snapshot.take((started(nil, "e_x")))
    for i = 1, 1000 do snap.ext.emem.root["e_pos(" .. i .. ")"] = 1 end
    assert(snapshot.put(fsm, snap))
    run(fsm, "e_new")
    assert.same({ e_new = 1 }, fsm.emem)
  end)
end)

describe("a state named emem", function()
  it("stays one, in a state that does not count, and init warns", function()
    local model = state { info = false, c = state { emem = state {},
      trans { src = "initial", tgt = "emem" },
      trans { src = "emem", tgt = "emem", events = { "e_again" } } },
      trans { src = "initial", tgt = "c" } }
    local warnings = helper.said(model, "warn")
    local fsm = helper.started(model)
    assert.equal("WARNING: root.c: 'emem' is a state here, so that rfsm.emem cannot "
      .. "count", helper.without_file(warnings[1]))
    assert.equal("root.c.emem", helper.leaf_after(fsm, "e_x"))
    assert.is_nil(rawget(fsm.c.emem, "e_x"))
    assert.same({ 1, 1 }, { fsm.emem.e_x, fsm.c.emem.emem.e_x })
    rfsm.reset(fsm)
    assert.is_false((pcall(rfsm_emem.emem_reset, fsm.c)))
    assert.equal("root.c.emem", helper.leaf_after(fsm))
  end)
end)

describe("a machine of a fleet", function()
  -- open --{ e_paid }--> part --{ e_paid }--> open, with a region in part
  local function pay()
    local function add(fsm, _, _, events) fsm.sum = fsm.sum + events[1].amount end
    return state { keep = { "sum" }, sum = 0, open = state {},
      part = rfsm.seqand { idle_doo = "auto", lamp = state { off = state {},
        on = state {}, trans { src = "initial", tgt = "off" },
        trans { src = "off", tgt = "on", events = { rfsm.named "e_on" } } } },
      trans { src = "initial", tgt = "open" },
      trans { src = "open", tgt = "part", events = { rfsm.named "e_paid" },
        effect = add },
      trans { src = "part", tgt = "open", events = { rfsm.named "e_paid" },
        effect = add } }
  end

  it("takes events with data, and keeps their counts", function()
    local trace = {}
    package.loaded["rfsm.server.functions"] = nil
    local f = require "rfsm.server.functions" (host_of.new(trace, { now = 1000 }),
      { { name = "p", make = pay } })
    package.loaded["rfsm.server.functions"] = nil
    f.rfsm_create({ "m" }, { "p" })
    for _, case in ipairs { { '{"name":"e_paid","amount":12}', "root.part" },
      { '{"name":"e_on","by":{"id":3}}', "root.part" },
      { '{"name":"e_paid","amount":3}', "root.open" } } do
      local reply = f.rfsm_send({ "m" }, { case[1] })
      assert.same({ case[2], "taken" }, { reply[1], reply[3] })
    end
    assert.matches('"sum":15', f.rfsm_get({ "m" })[12], 1, true)
    local last = trace[#trace - 1]
    assert.matches("emem={root={e_done@root.open=2,e_on=1,e_paid=2},", last, 1, true)
  end)
end)

it("memories agree with counting, on random charts", function()
  assert.is_nil(share.problem(require "spec.support.claims.emem", 40))
end)

describe("what a user writes into emem", function()
  it("is counted on, and set to 0 on exit", function()
    local fsm, emem = started()
    emem.e_x, emem.e_mine, emem[1], emem[fsm] = 5, "mine", 7, 8
    run(fsm, "e_x")
    assert.same({ e_x = 6, e_mine = "mine", [1] = 7, [fsm] = 8 }, emem)
    run(fsm, "e_next")
    assert.same({ e_x = 0, e_mine = 0, [1] = 0, [fsm] = 0, e_next = 0 }, emem)
  end)

  it("does not come back when he takes it out", function()
    local fsm, emem = started(nil, "e_x")
    emem.e_x = nil
    run(fsm, "e_next")
    assert.same({ e_next = 0 }, emem)
    run(fsm, "e_next")
    run(fsm, "e_x")
    assert.equal(1, emem.e_x)
  end)

  it("may be a table of his own, also in a state that said false", function()
    local model, own = chart(), { e_x = 3 }
    model.c.emem = false
    local fsm = started(model)
    fsm.c.a.emem, fsm.c.emem = own, {}
    run(fsm, "e_x", "e_y")
    assert.same({ e_x = 4, e_y = 1 }, own)
    run(fsm, "e_next")
    assert.same({ e_x = 0, e_y = 0, e_next = 0 }, own)
    assert.same({ e_x = 1, e_y = 1, e_next = 1 }, fsm.c.emem)
    rfsm.reset(fsm)
    assert.same({ e_x = 0, e_y = 0, e_next = 0 }, fsm.c.emem)
  end)

  it("may be nothing: the state counts no longer", function()
    local fsm, emem = started(nil, "e_x")
    fsm.c.a.emem = false
    run(fsm, "e_x")
    run(fsm, "e_next")
    assert.same({ e_x = 1 }, emem)
  end)

  it("may be a metatable, for a 0 in place of nil", function()
    local fsm, emem = started(nil, "e_x")
    setmetatable(emem, { __index = function() return 0 end })
    run(fsm, "e_y")
    assert.equal("1 0", emem.e_y .. " " .. emem.e_none)
    run(fsm, "e_next")
    assert.equal("0 0", rawget(emem, "e_y") .. " " .. rawget(emem, "e_next"))
  end)
end)

describe("emem_reset", function()
  it("sets the counts of a state to 0, and leaves others alone", function()
    local fsm = started(nil, "e_x")
    rfsm_emem.emem_reset(fsm.c.a)
    assert.equal("1 1 0 nil", counts(fsm))
  end)

  it("blames the caller for anything else", function()
    assert.equal("rfsm.emem.emem_reset: state with an event memory expected, got nil",
      helper.refusal(rfsm_emem.emem_reset, nil))
  end)
end)

describe("exploration of a machine with event memories", function()
  local rfsm_checks = require "rfsm_checks"

  local function count(fsm) if fsm.n < 2 then fsm.n = fsm.n + 1 end end

  -- (initial) -> a --e_x--> b --e_back--> a, which counts how often it came back.
  local function judged(members, called, property)
    local model = { warn = false, info = false, n = 0, a = state {}, b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_x" } },
      trans { src = "b", tgt = "a", events = { "e_back" }, effect = count } }
    for key, value in pairs(members) do model[key] = value end -- any order: a set
    property = property or rfsm_checks.never { "root.a", "root.b" }
    local result = rfsm_checks.explore(state(model), { vars = { n = { 0, 2 } },
      run = called, properties = { property } })
    return result.properties[1].holds, result.untried[1]
  end

  it("follows the data of callbacks, and leaves the counts out", function()
    local holds, untried = judged({}, { count })
    assert.same({ true }, { holds, untried })
    holds, untried = judged({ a = state { emem = true } }, { count })
    assert.same({ true }, { holds, untried })
    holds, untried = judged({}, { count }, rfsm_checks.never "root.b")
    assert.same({ false }, { holds, untried })
  end)

  it("leaves out the counts in a region, too", function()
    local region = state { warn = false, info = false, n = 0, a = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "internal", events = { "e_x" }, effect = count } }
    local result = rfsm_checks.explore(state { warn = false, info = false,
      par = rfsm.seqand { r = region }, trans { src = "initial", tgt = "par" } },
      { vars = { ["par.r.n"] = { 0, 2 } }, run = { count },
        properties = { rfsm_checks.always "root.par" } })
    assert.same({ true, {} }, { result.properties[1].holds, result.untried })
  end)

  it("knows nothing if a callback that is run reads the counts", function()
    local key = "emem"
    local GUARDS = {
      function(tr) return (tr.src.emem.e_back or 0) < 2 end,
      function(tr) return (tr.src[key].e_back or 0) < 2 end,
    }
    for i, guard in ipairs(GUARDS) do
      local holds, untried = judged({ [2] = trans { src = "a", tgt = "b",
        events = { "e_x" }, guard = guard } }, { count, guard })
      assert.same({ i, nil, "the field 'emem.e_x', which vars does not name" },
        { i, holds, untried })
    end
  end)

  it("knows nothing either if a guard that only reads does so", function()
    local function is_second(tr) return tr.src.emem.e_x == 2 end
    local result = rfsm_checks.explore(state { warn = false, info = false,
      a = state {}, b = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_x" }, guard = is_second } },
      { run = { is_second }, properties = { rfsm_checks.never "root.b" } })
    assert.is_nil(result.properties[1].holds)
  end)
end)
