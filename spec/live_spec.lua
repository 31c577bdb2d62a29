-- What tools may replace on a live machine; and the hooks, trace and calls from inside.

local helper = require "spec.helper"
local rfsm = require "rfsm"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local conn, state, trans = rfsm.conn, rfsm.state, rfsm.trans
local noting, said, leaf_after = helper.noting, helper.said, helper.leaf_after
local post_and_run = helper.post_and_run

-- initial -> a --e--> b --e--> a
local function started(members)
  local fsm = helper.chart("e", members)
  fsm[3] = trans { src = "b", tgt = "a", events = "e" }
  return helper.started(fsm)
end

describe("a live machine", function()
  it("completes a leaf that loses its doo before the start", function()
    local fsm = started { a = state { doo = function() rfsm.yield() end } }
    local errors = said(fsm, "err")
    post_and_run(fsm, "e")
    rfsm.send_events(fsm, "e")
    rfsm.step(fsm)
    fsm.a.doo = nil
    rfsm.step(fsm)
    assert.same({ "e_done@root.a" }, fsm._intq)
    assert.same({ "done", {} }, { rfsm.get_sta_mode(fsm.a), errors })
  end)

  it("prints its trace from when dbg is true", function()
    local fsm = started()
    fsm.dbg = true
    local lines = helper.printed(function() post_and_run(fsm, "e") end)
    assert.equal("RAISED e", (lines[1]:gsub("\t", " ")))
    assert.equal("HIBERNATING no events, no idle_hook, no doos or doo idle, halting "
      .. "engines", (lines[#lines]:gsub("\t", " ")))
  end)

  it("shows a new leaf as the active one when its entry is traced", function()
    local seen, fsm = {}, started()
    fsm.dbg = function(id)
      if id == "STATE_ENTER" then seen[#seen + 1] = rfsm.get_actleaf_fqn(fsm) end
    end
    post_and_run(fsm, "e")
    assert.same({ "root.b" }, seen)
  end)

  it("asks a getevents that a doo sets as soon as that is idle", function()
    local fsm = started { a = state { doo = function(fsm)
      fsm.getevents = function() return { "e_other" } end
    end } }
    rfsm.reset(fsm)
    fsm.getevents = nil
    rfsm.step(fsm, 2)
    assert.same({ "e_done@root.a", "e_other" }, fsm._intq)
  end)

  it("traces from when dbg is set until it is taken away", function()
    local fsm = started()
    local records = said(fsm, "dbg")
    rfsm.send_events(fsm, "e_other")
    fsm.dbg = nil
    post_and_run(fsm, "e")
    assert.same({ "RAISED e_other" }, records)
  end)

  it("has printers that can be called, whatever the model said", function()
    local fsm = started()
    for _, name in ipairs({ "dbg", "info", "warn", "err", "getevents" }) do
      assert.is_function(fsm[name])
    end
  end)
end)

describe("`read`, written after init,", function()
  it("counts from the next iteration on", function()
    for _, case in ipairs { { nil, "one", 3 }, { "all", "one", 3 }, { "one", "all", 1 },
      { "one", nil, 1 }, { "data", nil, 1 } } do
      local taken = {}
      local fsm = started { read = case[1], trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "internal", events = "e", effect = noting(taken, 1) } }
      fsm.read = case[2]
      rfsm.send_events(fsm, "e", "e", "e")
      rfsm.run(fsm)
      assert.same({ case[1], case[2], case[3] }, { case[1], case[2], #taken })
    end
  end)

  it("counts each time, whatever it was before", function()
    for _, first in ipairs { "one", "all", "data", false } do
      local taken = {}
      local fsm = started { read = first, trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "internal", events = "e", effect = noting(taken, 1) } }
      for _, value in ipairs { "one", false, "one", "data", "one", "all", "one" } do
        helper.clear(taken)
        fsm.read = value
        rfsm.send_events(fsm, "e", "e", "e")
        rfsm.run(fsm)
        assert.same({ first, value, value == "one" and 3 or 1 },
          { first, value, #taken })
      end
    end
  end)
end)

describe("the trace", function()
  it("has its records in order, also when a getevents was taken away", function()
    local fsm = started()
    fsm.getevents = function() return {} end
    local records = said(fsm, "dbg")
    rfsm.run(fsm)
    fsm.getevents = nil
    rfsm.run(fsm)
    helper.clear(records)
    post_and_run(fsm, "e")
    assert.same({
      "RAISED e", "TRANSITION searching transitions for events: e",
      "CHECKING depth: 0 for transitions from root",
      "CHECKING depth: 1 for transitions from root.a",
      "EXEC_PATH root.a[LS]->root.b[LS]",
      "TRANS_EXIT exiting all up to (including): root.a , lca: root",
      "STATE_EXIT root.a", "EFFECT T={ src='root.a', tgt='root.b', events='e' }",
      "TRANS_ENTER lca: root down_path:  root.b", "RAISED e_done@root.b",
      "STATE_ENTER root.b",
      "TRANSITION searching transitions for events: e_done@root.b",
      "CHECKING depth: 0 for transitions from root",
      "CHECKING depth: 1 for transitions from root.b",
      "TRANSITION no enabled paths found",
      "HIBERNATING no events, no idle_hook, no doos or doo idle, halting engines",
    }, records)
  end)

  it("has the beginning and the end of a doo", function()
    local fsm = started { a = state { doo = function() rfsm.yield() end } }
    local records = said(fsm, "dbg", "DOO")
    rfsm.reset(fsm)
    rfsm.run(fsm)
    assert.same({ "DOO created coroutine for root.a doo",
      "DOO removing completed coroutine of root.a doo" }, records)
  end)
end)

describe("a connector", function()
  it("is asked once in a search for each event that leads to it", function()
    local count = 0
    local fsm = started { k = conn {}, [4] = trans { src = "k", tgt = "b",
      guard = function()
        count = count + 1
        return false
      end } }
    for _, event in ipairs { "x", "y", "x", "y" } do
      rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "k", events = { event } })
    end
    post_and_run(fsm, "x")
    count = 0
    rfsm.send_events(fsm, "x", "y")
    rfsm.step(fsm)
    assert.equal(2, count)
  end)
end)

describe("an internal transition", function()
  it("has beside it events that are no texts", function()
    local fsm = started { b = state {} }
    fsm[2].tgt, fsm[2].events[2] = fsm.a, 7
    rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "internal", pn = 1,
      events = { 7 } })
    rfsm.send_events(fsm, 7, {}, 8)
    assert.is_true(rfsm.run(fsm))
  end)
end)

describe("a step hook", function()
  it("in front is called before a source of events, and that before others", function()
    local order, fsm = {}, started()
    rfsm.pre_step_hook_add(fsm, noting(order, "other"), "before")
    rfsm.source_hook_add(fsm, noting(order, "source"))
    rfsm.pre_step_hook_add(fsm, noting(order, "front"), "front")
    rfsm.step(fsm)
    assert.same({ "front", "source", "other" }, order)
  end)

  it("added before others is the first again when those in front are gone", function()
    local fsm, order = started(), {}
    local front = noting(order, "front")
    rfsm.pre_step_hook_add(fsm, front, "front")
    fsm.pre_step_hook = noting(order, "own")
    rfsm.pre_step_hook_rm(fsm, front)
    rfsm.pre_step_hook_add(fsm, noting(order, "first"), "before")
    rfsm.step(fsm)
    assert.same({ "first", "own" }, order)
  end)

  it("added before others is the first, also when a later one is gone", function()
    local fsm, order = started(), {}
    local later = noting(order, "later")
    fsm.pre_step_hook = noting(order, "own")
    rfsm.pre_step_hook_add(fsm, later)
    rfsm.pre_step_hook_rm(fsm, later)
    rfsm.pre_step_hook_add(fsm, noting(order, "first"), "before")
    rfsm.step(fsm)
    assert.same({ "first", "own" }, order)
  end)

  it("sees the events and may change them", function()
    local fsm = started()
    rfsm.pre_step_hook_add(fsm, function(_, events) events[1] = "e" end)
    rfsm.step(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)

  it("that an effect sets runs at the end of the same iteration", function()
    local seen, fsm, count = {}, started(), 0
    fsm[2].effect = function()
      count = count + 1
      if count < 3 then return end
      fsm.post_step_hook = function(_, events)
        seen[#seen + 1] = table.concat(events, " ") .. " " .. rfsm.get_actleaf_fqn(fsm)
      end
    end
    for _ = 1, 4 do post_and_run(fsm, "e") end
    rfsm.send_events(fsm, "e")
    rfsm.step(fsm)
    assert.same({ "e root.b" }, seen)
  end)

  it("sees the leaf where a path with a connector ended", function()
    local seen = {}
    local fsm = started { c = state {}, k = conn {},
      [4] = trans { src = "a", tgt = "k", events = "e_k" },
      [5] = trans { src = "k", tgt = "c" },
    }
    fsm.post_step_hook = function() seen[#seen + 1] = rfsm.get_actleaf_fqn(fsm) end
    rfsm.send_events(fsm, "e_k")
    rfsm.step(fsm)
    assert.same({ "root.c" }, seen)
  end)

  it("runs before or after those that are there", function()
    local trace, fsm = {}, started()
    fsm.pre_step_hook = noting(trace, "own")
    rfsm.pre_step_hook_add(fsm, noting(trace, "last"))
    rfsm.pre_step_hook_add(fsm, noting(trace, "first"), "before")
    rfsm.step(fsm)
    assert.same({ "first", "own", "last" }, trace)
  end)

  it("can be taken out again, also by itself", function()
    local trace, fsm = {}, started()
    local hook = noting(trace, "hook")
    rfsm.post_step_hook_add(fsm, hook)
    assert.is_true(rfsm.post_step_hook_rm(fsm, hook))
    assert.is_false(rfsm.post_step_hook_rm(fsm, hook))
    local function once()
      trace[#trace + 1] = "once"
      rfsm.pre_step_hook_rm(fsm, once)
    end
    rfsm.pre_step_hook_add(fsm, once)
    rfsm.pre_step_hook_add(fsm, noting(trace, "other"))
    rfsm.step(fsm)
    rfsm.step(fsm)
    assert.same({ "once", "other", "other" }, trace)
  end)

  for _, what in ipairs { "entry", "exit" } do
    it(("of an %s can be taken out again, also by itself"):format(what), function()
      local trace, fsm = {}, started()
      local add, take_out = rfsm[what .. "_hook_add"], rfsm[what .. "_hook_rm"]
      local hook = function() trace[#trace + 1] = "hook" end
      local function once(_, node)
        trace[#trace + 1] = "once"
        assert.is_true(take_out(fsm, node, once))
      end
      assert.is_false(take_out(fsm, fsm.b, hook))
      add(fsm, fsm.b, once)
      add(fsm, fsm.b, hook)
      assert.is_false(take_out(fsm, fsm.a, hook))
      for _ = 1, 4 do post_and_run(fsm, "e") end
      assert.is_true(take_out(fsm, fsm.b, hook))
      assert.is_false(take_out(fsm, fsm.b, hook))
      for _ = 1, 4 do post_and_run(fsm, "e") end
      assert.same({ "once", "hook", "hook" }, trace)
    end)
  end

  it("can ask if the step goes on", function()
    local trace, fsm = {}, started()
    rfsm.post_step_hook_add(fsm, function(_, events)
      trace[#trace + 1] = tostring(events[1]) .. " " .. tostring(rfsm.is_free(fsm))
    end)
    rfsm.send_events(fsm, "e")
    rfsm.step(fsm)
    rfsm.send_events(fsm, "e_other")
    rfsm.step(fsm)
    assert.same({ "e false", "e_done@root.b true", "nil false" }, trace)
  end)
end)

describe("a state hook", function()
  it("runs outside of the callbacks, also of new ones", function()
    local trace, fsm = {}, started()
    rfsm.entry_hook_add(fsm, fsm.b, noting(trace, "hook"))
    rfsm.exit_hook_add(fsm, fsm.b, noting(trace, "exit hook"))
    fsm.b.entry, fsm.b.exit = noting(trace, "entry"), noting(trace, "exit")
    post_and_run(fsm, "e")
    post_and_run(fsm, "e")
    assert.same({ "hook", "entry", "exit", "exit hook" }, trace)
  end)

  it("runs from the next path on, after those that are there", function()
    local trace, fsm = {}, started()
    local function twice()
      post_and_run(fsm, "e")
      post_and_run(fsm, "e")
    end
    twice()
    rfsm.entry_hook_add(fsm, fsm.b, noting(trace, "one"))
    post_and_run(fsm, "e")
    fsm[3].effect = function()
      rfsm.entry_hook_add(fsm, fsm.a, noting(trace, "now"))
    end
    rfsm.entry_hook_add(fsm, fsm.b, noting(trace, "two"))
    twice()
    assert.same({ "one", "one", "two" }, trace)
    post_and_run(fsm, "e")
    assert.same({ "one", "one", "two", "now" }, trace)
  end)

  it("may change callbacks after an exit that failed", function()
    local trace, fsm = {}, started { err = false }
    fsm.a.exit = error
    rfsm.exit_hook_add(fsm, fsm.a, function() fsm.b.entry = noting(trace, "new") end)
    assert.equal("root.b", leaf_after(fsm, "e"))
    assert.same({ "new" }, trace)
  end)
end)

it("a connector is evaluated once, also if a transition is aimed at it", function()
  local asked = 0
  local fsm = helper.started(state {
    info = false, warn = false, k = conn {}, b = state {},
    m = state { a = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "root.k" } },
    trans { src = "initial", tgt = "m" }, trans { src = "m", tgt = "b" },
    trans { src = "k", tgt = "b", guard = function()
      asked = asked + 1
      return asked > 1
    end },
  })
  fsm[2].tgt = fsm.k
  for _ = 1, 20 do -- the first of them loads and compiles
    rfsm.reset(fsm)
    rfsm.step(fsm)
    asked = 0
    rfsm.step(fsm) -- on e_done
    assert.equal(1, asked)
    assert.equal("root.m.a", rfsm.get_actleaf_fqn(fsm))
  end
end)

describe("a call from inside", function()
  it("to step is an error of the callback that made it", function()
    local fsm = started()
    local errors = said(fsm, "err")
    fsm.b.entry = function(machine) rfsm.step(machine) end
    assert.equal("root.b", leaf_after(fsm, "e"))
    assert.equal(1, #errors)
    assert.matches("live_spec.lua:%d+: rfsm.step: the machine is in the middle of a "
      .. "step", errors[1])
  end)

  it("to reset takes effect at the end, also when an exit has switched dbg", function()
    for _, dbg in ipairs { false, function() end } do
      local fsm = started()
      for _ = 1, 10 do post_and_run(fsm, "e") end
      fsm.a.exit = function() fsm.dbg = dbg end
      fsm[2].effect = function() rfsm.reset(fsm) end
      rfsm.reset(fsm)
      rfsm.run(fsm)
      post_and_run(fsm, "e")
      assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
      assert.same({}, fsm._intq)
    end
  end)

  it("to reset forgets an error that a printer raised between two steps", function()
    local fsm = started()
    fsm.dbg = function() error("on purpose", 0) end
    rfsm.send_events(fsm, "e")
    rfsm.reset(fsm)
    fsm.dbg = false
    assert.is_false(rfsm.step(fsm))
  end)

  it("to reset takes effect when the iteration is over", function()
    local fsm, seen = started(), nil
    fsm.b.entry = function(machine)
      rfsm.reset(machine)
      seen = rfsm.get_active_conf(machine)
    end
    rfsm.send_events(fsm, "e")
    assert.is_false(rfsm.step(fsm))
    assert.same({ { "root", "root.b" }, {}, { "e_init_fsm" } },
      { seen, rfsm.get_active_conf(fsm), fsm._intq })
  end)

  it("to exit_state of the root in a post step hook leaves nothing idle", function()
    local fsm, is_due = started(), false
    fsm.post_step_hook = rfsm.borrows(function(machine)
      if is_due then rfsm.exit_state(machine, machine) end
    end)
    rfsm.run(fsm)
    is_due = true
    assert.is_false(rfsm.step(fsm))
  end)

  it("to send_events counts in the next iteration", function()
    local fsm = started()
    fsm.b.entry = function(machine) rfsm.send_events(machine, "e") end
    rfsm.send_events(fsm, "e")
    rfsm.step(fsm)
    assert.same({ "e", "e_done@root.b" }, fsm._intq)
    rfsm.step(fsm)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
  end)
end)

it("exit_state exits what is active below, the deepest first", function()
  local trace, fsm = helper.traced(state {
    a = state { x = state {}, trans { src = "initial", tgt = "x" } },
    trans { src = "initial", tgt = "a" },
  })
  rfsm.run(fsm)
  helper.clear(trace)
  rfsm.exit_state(fsm, fsm)
  assert.same({ { "exit root.a.x", "exit root.a" }, {} },
    { trace, rfsm.get_active_conf(fsm) })
end)

describe("node_find_enabled", function()
  -- initial -> a --e_go--> k --> b, and more
  local function through_a_connector(members)
    local trace, fsm = helper.traced(helper.chart("e", {
      k = conn {}, k1 = conn {}, unpack(members or {
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "k", events = { "e_go" } },
        trans { src = "k", tgt = "b" },
      }),
    }))
    rfsm.run(fsm)
    helper.clear(trace)
    return fsm, trace
  end

  it("finds a path, and takes none, also from a node that was never active", function()
    local fsm, trace = through_a_connector()
    local path = rfsm.node_find_enabled(fsm, fsm.a, { "e_go" })
    assert.equal(fsm[2], path.nextl[1].trans)
    assert.equal(fsm[3], path.nextl[1].next.nextl[1].trans)
    path = rfsm.node_find_enabled(fsm, fsm.k, { "e" })
    assert.equal(fsm[3], path.nextl[1].trans)
    assert.equal(fsm.k, path.node)
    assert.equal(fsm.b, path.nextl[1].next.node)
    assert.is_false(path.nextl[1].next.nextl)
    assert.is_false(rfsm.node_find_enabled(fsm, fsm.b, { "e" }))
    assert.same({ {}, "root.a" }, { trace, rfsm.get_actleaf_fqn(fsm) })
  end)

  it("leaves the path alone that an effect asks from", function()
    local fsm, trace = through_a_connector()
    fsm[2].effect = function(machine)
      rfsm.node_find_enabled(machine, machine.initial, { "e" })
    end
    post_and_run(fsm, "e_go")
    assert.same({ "exit root.a", "effect root.k->root.b", "entry root.b" }, trace)
  end)

  it("leaves the search alone that a guard asks from", function()
    local fsm, trace, is_asking
    fsm, trace = through_a_connector {
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "k", events = { "e_go" } },
      trans { src = "k", tgt = "k1" },
      trans { src = "k", tgt = "a", guard = function()
        if not is_asking then
          is_asking = true
          rfsm.node_find_enabled(fsm, fsm.k, { "e_other" })
        end
        return false
      end },
      trans { src = "k1", tgt = "b", events = { "e_go" } },
    }
    post_and_run(fsm, "e_go")
    assert.equal("entry root.b", trace[#trace])
  end)

  it("wants a node of a machine", function()
    local fsm = started()
    assert.error_matches(function() rfsm.node_find_enabled(fsm, state {}, {}) end,
      "rfsm.node_find_enabled: node of the fsm expected, got state", 1, true)
  end)
end)

describe("is_in", function()
  it("tells of a state or its name, wants a state of the machine, and a machine",
    function()
      local fsm = started { b = state { x = state {},
        trans { src = "initial", tgt = "x" } } }
      post_and_run(fsm, "e")
      assert.same({ true, true, true, false },
        { rfsm.is_in(fsm, fsm), rfsm.is_in(fsm, fsm.b), rfsm.is_in(fsm, "root.b.x"),
          rfsm.is_in(fsm, "root.a") })
      for _, other in ipairs { state {}, fsm[2], 5 } do
        assert.error_matches(function() rfsm.is_in(fsm, other) end,
          "rfsm.is_in: state of the machine expected, got ", 1, true)
      end
      assert.error_matches(function() rfsm.is_in({}, "root") end,
        "rfsm.is_in: initialised fsm expected, got table", 1, true)
    end)
end)

describe("a merge into a live machine", function()
  -- Why a merge is refused.
  local function reason(fsm, ...)
    local ok, text = rfsm.fsm_merge(fsm, ...)
    assert.is_false(ok)
    return text
  end

  it("gives a leaf no children while a transition may enter it", function()
    local fsm, found = started { err = false }, {}
    fsm[2].effect = function() found[1] = reason(fsm, fsm.b, state {}, "x") end
    assert.equal("root.b", leaf_after(fsm, "e"))
    fsm = helper.init(helper.chart("e", { err = false,
      trans { src = "initial", tgt = "a", guard = function()
        found[2] = reason(fsm, fsm.a, conn {}, "initial")
      end } }))
    assert.equal("root.a", leaf_after(fsm))
    for i, name in ipairs { "b", "a" } do
      assert.equal("rfsm.fsm_merge: 'root." .. name .. "' is a leaf state, while a "
        .. "transition is taken", found[i])
    end
  end)

  it("gives a leaf children from a guard", function()
    local fsm, is_merged = started(), false
    fsm[2].guard = function()
      is_merged = is_merged or rfsm.fsm_merge(fsm, fsm.b, conn {}, "initial")
      return false
    end
    assert.equal("root.a", leaf_after(fsm, "e"))
    assert.is_true(is_merged)
  end)

  it("that is refused leaves a leaf a leaf", function()
    local fsm = started { err = false }
    assert.matches("the model has 1 problem\n.*: root.b: a transition inside a leaf "
      .. "state", reason(fsm, fsm.b, trans { src = "initial", tgt = "x" }))
    assert.is_nil(fsm.b.initial)
    assert.is_true(rfsm.is_leaf(fsm.b))
    rfsm.send_events(fsm, "e")
    rfsm.step(fsm)
    assert.same({ "e_done@root.b" }, fsm._intq)
  end)

  it("that is refused leaves no trace in the next one", function()
    local fsm, is_refused = started { err = false }, true
    helper.with_preproc(function(_, merged)
      return is_refused and { merged._fqn .. ": refused" } or nil
    end, function()
      assert.equal("rfsm.fsm_merge: the model has 1 problem\n  root.d: refused",
        reason(fsm, fsm, state {}, "d"))
      is_refused = false
      assert.is_true((rfsm.fsm_merge(fsm, fsm, conn {}, "k")))
    end)
    assert.is_nil(fsm.d)
    assert.equal("root.k", fsm.k._fqn)
    assert.is_true(rfsm.is_conn(fsm.k))
  end)

  it("makes a composite of a leaf that transitions lead to", function()
    local fsm = started()
    assert.is_true(rfsm.fsm_merge(fsm, fsm.b, conn {}, "initial"))
    assert.is_true(rfsm.fsm_merge(fsm, fsm.b, state {}, "x"))
    assert.is_true(rfsm.fsm_merge(fsm, fsm.b, trans { src = "initial", tgt = "x" }))
    assert.equal(fsm.b.initial, fsm[2].tgt)
    assert.equal("root.b.x", leaf_after(fsm, "e"))
  end)

  it("takes a transition of another machine by the names in its model", function()
    local fsm, other = started(), started()
    assert.is_true((rfsm.fsm_merge(fsm, fsm, other[2])))
    assert.is_true(fsm[4].src == fsm.a and fsm[4].tgt == fsm.b)
  end)

  it("copies plain tables at once, and warns of what is new alone", function()
    local fsm, d = started { dead = state {} }, state { data = { 1 } }
    local warnings = said(fsm, "warn")
    assert.is_true(rfsm.fsm_merge(fsm, fsm, d, "d"))
    d.data[1] = 2
    assert.same({ 1 }, fsm.d.data)
    assert.same({ "WARNING: no outgoing transitions from node 'root.d'" }, warnings)
  end)

  it("takes no name of a field that the machine was given", function()
    local fsm = started { err = false }
    fsm.d = 5
    assert.equal("rfsm.fsm_merge: 'root' has a member 'd' already",
      reason(fsm, fsm, state {}, "d"))
  end)
end)

it("an e_done that nothing waited for does not come again where something does",
  function()
    local fsm = started {
      [4] = trans { src = "b", tgt = "b", events = "e_x" },
      [5] = trans { src = "b", tgt = "a", events = "e_done@root.a" },
    }
    for _ = 1, 3 do
      rfsm.reset(fsm)
      rfsm.step(fsm)
      assert.same({ "e_done@root.a" }, fsm._intq)
      post_and_run(fsm, "e")
      post_and_run(fsm, "e_x")
      assert.equal("root.b", leaf_after(fsm, "e_x"))
    end
  end)

describe("an events table that was kept stays what it was:", function()
  local kept

  local function keep(events) kept[#kept + 1] = events end

  -- Keeps those of the effects of initial -> a --e1--> k --> b --e2--> a.
  local function check(effect, dbg)
    kept = {}
    local fsm = helper.started(helper.chart("e1", {
      err = false, k = conn {},
      [2] = trans { src = "a", tgt = "k", events = "e1" },
      [3] = trans { src = "k", tgt = "b", effect = effect },
      [4] = trans { src = "b", tgt = "a", events = "e2", effect = effect },
    }))
    fsm.dbg = dbg
    for _, event in ipairs({ "e1", "e2", "e1" }) do post_and_run(fsm, event) end
    assert.same({ { "e1" }, { "e2" }, { "e1" } }, kept)
  end

  for name, effect in pairs { -- any order: each stands alone
    ["with four parameters"] = function(_, _, _, events) keep(events) end,
    ["with any number"] = function(...) keep((select(4, ...))) end,
    ["that is a table"] = setmetatable({}, {
      __call = function(_, _, _, _, events) keep(events) end,
    }),
    ["that fails"] = function(_, _, _, events)
      keep(events)
      error("on purpose")
    end,
  } do
    it("by an effect " .. name, function() check(effect) end)
    it("traced, by an effect " .. name, function() check(effect, function() end) end)
  end

  it("by a coroutine", function()
    check(coroutine.wrap(function(...)
      keep((select(4, ...)))
      while true do keep((select(4, coroutine.yield()))) end
    end))
  end)

  for _, hook in ipairs({ "pre_step_hook", "post_step_hook" }) do
    it("by a " .. hook, function()
      kept = {}
      local fsm = started()
      fsm[hook] = function(_, events) if events[1] then keep(events) end end
      post_and_run(fsm, "e")
      post_and_run(fsm, "e")
      assert.same({ { "e" }, { "e_done@root.b" }, { "e" }, { "e_done@root.a" } }, kept)
    end)
  end
end)

describe("the model's own hook", function()
  it("is taken away like any other", function()
    local trace = {}
    local hook = noting(trace, "own")
    local fsm = started { pre_step_hook = hook }
    helper.clear(trace)
    assert.is_true(rfsm.pre_step_hook_rm(fsm, hook))
    assert.is_false(rfsm.pre_step_hook_rm(fsm, hook))
    post_and_run(fsm, "e")
    assert.same({ {}, "root.b" }, { trace, rfsm.get_actleaf_fqn(fsm) })
  end)
end)

describe("a node of another machine", function()
  local fsm, other = started(), started()
  local function nothing() end

  local function row(name, text, ...)
    return { name, text .. " expected, got ", rfsm[name], ... }
  end

  for _, case in ipairs {
    row("entry_hook_add", "state of the fsm", fsm, other.a, nothing),
    row("exit_state", "state of the fsm", fsm, other.a),
    row("node_find_enabled", "node of the fsm", fsm, other.a, {}),
    row("map_from_to", "two nodes of the fsm", fsm, nothing, other.a, other),
  } do
    it("is refused by " .. case[1], function()
      local text = helper.refusal(unpack(case, 3, 7))
      assert.equal(1, (text:find(("rfsm.%s: %s"):format(case[1], case[2]), 1, true)))
    end)
  end
end)

describe("a merge in an effect", function()
  it("leaves the rest of the path the event that counts", function()
    for _, is_prepared in ipairs { false, true } do
      local notes, count = {}, 0
      local fsm = started { k = conn {},
        [8] = trans { src = "a", tgt = "k", events = "go", effect = function(fsm)
          count = count + 1
          assert.is_true((rfsm.fsm_merge(fsm, fsm, state {}, "m" .. count)))
        end },
        [9] = trans { src = "k", tgt = "b", events = "go",
          effect = function(_, _, _, _, event) notes[#notes + 1] = event end } }
      if is_prepared then rfsm.prepare(fsm) end
      assert.equal("root.b", leaf_after(fsm, "go"))
      assert.same({ "go" }, notes)
    end
  end)
end)

describe("a merge that a preproc function refuses", function()
  it("leaves each transition its target", function()
    local fsm = started { err = false }
    helper.with_preproc(function() return { "on purpose" } end, function()
      assert.is_false((rfsm.fsm_merge(fsm, fsm.b, conn {}, "initial")))
    end)
    assert.equal(fsm.b, fsm[2].tgt)
    assert.is_nil(fsm.b.initial)
    assert.equal("root.b", leaf_after(fsm, "e"))
  end)

  it("leaves nothing of what was to come", function()
    local fsm = started { err = false }
    local function names()
      return rfsm.mapfsm(function(obj) return obj._fqn or tostring(obj) end, fsm)
    end
    local before = names()
    helper.with_preproc(function() return { "on purpose" } end, function()
      assert.is_false((rfsm.fsm_merge(fsm, fsm, state {
        x = state {}, y = state {}, z = state {}, trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "y" }, trans { src = "y", tgt = "z" },
      }, "m")))
    end)
    assert.same(before, names())
    assert.is_nil(rawget(fsm, "m"))
    assert(rfsm.fsm_merge(fsm, fsm, state {}, "m"))
    assert.equal(#before + 1, #names())
  end)
end)

describe("two transitions of one priority, in composites of one depth,", function()
  it("are tried in the order of the composites' names", function()
    for _, name in ipairs { "k", "z" } do
      local fsm = started {
        m = state { [8] = trans { src = "root.a", tgt = "root.m.x", events = "go" },
          x = state {}, trans { src = "initial", tgt = "x" } },
        [name] = state { [1] = trans { src = "root.a", tgt = "root.b", events = "go" },
          x = state {}, [2] = trans { src = "initial", tgt = "x" } },
      }
      assert.equal(name == "k" and "root.b" or "root.m.x", leaf_after(fsm, "go"))
    end
  end)
end)

describe("a node table that is mounted twice", function()
  it("is for each transition the nearest one", function()
    local shared = state {}
    local function mount(name)
      return state { x = shared, trans { src = "initial", tgt = shared, effect = nil },
        trans { src = shared, tgt = "root.a", events = "from " .. name } }
    end
    local fsm = started { m = mount "m", z = mount "z",
      [4] = trans { src = "a", tgt = "m", events = "m" },
      [5] = trans { src = "a", tgt = "z", events = "z" } }
    for _, name in ipairs { "m", "z" } do
      assert.equal("root." .. name .. ".x", leaf_after(fsm, name))
      assert.equal("root.a", leaf_after(fsm, "from " .. name))
    end
  end)

  it("is for a merged transition the one of the machine that it names", function()
    local shared = state {}
    local function mount()
      return state { x = shared, trans { src = "initial", tgt = "x" } }
    end
    for _, name in ipairs { "m", "z" } do
      local fsm = started { m = mount(), z = mount() }
      assert(rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = fsm[name].x,
        events = "go" }))
      assert.equal("root." .. name .. ".x", leaf_after(fsm, "go"))
    end
  end)
end)

describe("the older names", function()
  it("are the same functions", function()
    for _, name in ipairs { "sista", "csta", "simple_state", "composite_state" } do
      assert.equal(rfsm.state, rfsm[name])
    end
    assert.same({ rfsm.trans, rfsm.conn }, { rfsm.transition, rfsm.connector })
  end)
end)

describe("a merge", function()
  it("whose preproc function fails leaves the others at work", function()
    local preproc, calls, fails = rfsm.preproc, {}, true
    rfsm.preproc = { noting(calls, "one"), function(_, merged)
      calls[#calls + 1] = "two"
      if merged and fails then error("on purpose", 0) end
    end }
    finally(function() rfsm.preproc = preproc end)
    local fsm = started()
    local errors = said(fsm, "err")
    assert.is_false(rfsm.fsm_merge(fsm, fsm, state { final = true }, "x"))
    calls, fails = {}, false
    rfsm.preproc[1] = noting(calls, "one")
    assert.is_true(rfsm.fsm_merge(fsm, fsm, state { final = true }, "x"))
    assert.same({ "one", "two" }, calls)
    assert.matches("\n  a preproc function failed: on purpose", errors[1])
  end)

  it("by a guard, each time it is asked, ends the search", function()
    local count = 0
    local fsm = started()
    fsm[2].guard = function()
      count = count + 1
      rfsm.fsm_merge(fsm, fsm, state { final = true }, "x" .. count)
    end
    post_and_run(fsm, "e")
    assert.same({ 2, "root.a" }, { count, rfsm.get_actleaf_fqn(fsm) })
  end)
end)

describe("check_no_otrs", function()
  it("warns of each node that nothing leaves", function()
    local fsm = started { c = state {}, d = state { final = true } }
    local warnings = said(fsm, "warn")
    assert.is_false(rfsm.check_no_otrs(fsm))
    assert.same({ "WARNING: no outgoing transitions from node 'root.c'" }, warnings)
    assert.is_true(rfsm.check_no_otrs(started()))
  end)

  it("knows composites that are left from inside, through a connector too", function()
    local fsm = started {
      c = state { x = state {}, k = conn {}, trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "k", events = { "e" } } },
      d = state { x = state {}, trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "x", events = { "e" } } },
      leave = trans { src = "c.k", tgt = "a" },
    }
    local warnings = said(fsm, "warn")
    assert.is_false(rfsm.check_no_otrs(fsm))
    assert.same({ "WARNING: no outgoing transitions from node 'root.d'" }, warnings)
  end)
end)

describe("the printers of a machine that has none of its own", function()
  it("are stdout for info, stderr for warn and err", function()
    local file = helper.file_with([[
      local rfsm = require "rfsm"
      local fsm = rfsm.init(rfsm.state {
        a = rfsm.state { entry = function() error("on purpose", 0) end, final = true },
        rfsm.trans { src = "initial", tgt = "a" } })
      fsm.info "info" fsm.warn "warn" rfsm.run(fsm)
    ]])
    local command = arg[-1] .. " " .. file
    assert.same({ "INFO: created undeclared connector root.initial", "info" },
      helper.lines_of(command .. " 2>/dev/null"))
    assert.same({ "warn", "ENTRY\terror executing entry of root.a: \ton purpose" },
      helper.lines_of(command .. " 2>&1 >/dev/null"))
    helper.remove_files()
  end)
end)
