-- What tools may replace on a live machine; and the hooks, trace and calls from inside.

local helper = require "spec.helper"
local rfsm = require "rfsm"

local conn, state, trans = rfsm.conn, rfsm.state, rfsm.trans

-- initial -> a --e--> b --e--> a
local function started(fields)
  local model = fields or {}
  model.a, model.b = model.a or state {}, state {}
  model[1] = trans { src = "initial", tgt = "a" }
  model[2] = trans { src = "a", tgt = "b", events = "e" }
  model[3] = trans { src = "b", tgt = "a", events = "e" }
  local fsm = helper.init(state(model))
  rfsm.run(fsm)
  return fsm
end

local function texts_of(list)
  local texts = {}
  for i = 1, #list do texts[i] = tostring(list[i]) end
  return texts
end

local function noting(trace, text) return function() trace[#trace + 1] = text end end

describe("a live machine", function()
  it("runs a new entry, exit, effect and guard at the next use", function()
    local trace, fsm = {}, started()
    fsm.a.exit, fsm.b.entry = noting(trace, "exit"), noting(trace, "entry")
    fsm[2].effect, fsm[2].guard = noting(trace, "effect"), noting(trace, "guard")
    helper.post_and_run(fsm, "e")
    assert.same({ "guard", "exit", "effect", "entry" }, trace)
  end)

  it("runs a new doo at the next entry", function()
    local trace, fsm = {}, started()
    fsm.b.doo = noting(trace, "doo")
    helper.post_and_run(fsm, "e")
    assert.same({ "doo" }, trace)
  end)

  it("completes a leaf whose doo is taken away before it started", function()
    local fsm = started { a = state { doo = function() rfsm.yield() end } }
    helper.post_and_run(fsm, "e")
    rfsm.send_events(fsm, "e")
    rfsm.step(fsm)
    fsm.a.doo = nil
    rfsm.step(fsm, 2)
    assert.equal("done", rfsm.get_sta_mode(fsm.a))
  end)

  it("sends e_done, without an error, when it loses a doo before its start", function()
    local said = {}
    local fsm = started {
      b = state {}, a = state { doo = function() end },
      err = function(...) said[#said + 1] = table.concat({ ... }, " ") end,
    }
    helper.post_and_run(fsm, "e")
    rfsm.send_events(fsm, "e")
    rfsm.step(fsm)
    fsm.a.doo = nil
    rfsm.step(fsm)
    assert.same({ "e_done@root.a" }, fsm._intq)
    assert.same({}, said)
  end)

  it("prints its trace from when dbg is true", function()
    local fsm = started()
    fsm.dbg = true
    local lines = helper.printed(function() helper.post_and_run(fsm, "e") end)
    assert.equal("RAISED e", (lines[1]:gsub("\t", " ")))
    assert.equal("HIBERNATING no events, no idle_hook, no doos or doo idle, halting "
      .. "engines", (lines[#lines]:gsub("\t", " ")))
  end)

  it("traces in full when its getevents is taken away", function()
    local records, fsm = {}, started()
    fsm.getevents = function() return {} end
    fsm.dbg = function(id) records[#records + 1] = id end
    rfsm.run(fsm)
    fsm.getevents = nil
    rfsm.run(fsm)
    helper.clear(records)
    helper.post_and_run(fsm, "e")
    assert.same({ "RAISED", "TRANSITION", "CHECKING", "CHECKING", "EXEC_PATH",
      "TRANS_EXIT", "STATE_EXIT", "EFFECT", "TRANS_ENTER", "RAISED", "STATE_ENTER",
      "TRANSITION", "CHECKING", "CHECKING", "TRANSITION", "HIBERNATING" }, records)
  end)

  it("shows a new leaf as the active one when its trace tells of it", function()
    local seen, fsm = {}, started()
    fsm.dbg = function(id)
      if id == "STATE_ENTER" then seen[#seen + 1] = rfsm.get_actleaf_fqn(fsm) end
    end
    helper.post_and_run(fsm, "e")
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

  it("asks a new getevents", function()
    local fsm, asked = started(), 0
    fsm.getevents = function()
      asked = asked + 1
      return asked == 1 and { "e" } or {}
    end
    rfsm.run(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)

  it("traces from when dbg is set until it is taken away", function()
    local ids, fsm = {}, started()
    fsm.dbg = function(id) ids[#ids + 1] = id end
    rfsm.send_events(fsm, "e_other")
    fsm.dbg = nil
    helper.post_and_run(fsm, "e")
    assert.same({ "RAISED" }, ids)
  end)

  it("has printers that can be called, whatever the model said", function()
    local fsm = started()
    for _, name in ipairs({ "dbg", "info", "warn", "err", "getevents" }) do
      assert.is_function(fsm[name])
    end
  end)
end)

describe("the trace", function()
  it("has its records in order", function()
    local records = {}
    local fsm = started()
    fsm.dbg = function(...) records[#records + 1] = table.concat({ ... }, " ") end
    helper.post_and_run(fsm, "e")
    local tr = "T={ src='root.a', tgt='root.b', events='e' }"
    assert.same({
      "RAISED e", "TRANSITION searching transitions for events: e",
      "CHECKING depth: 0 for transitions from root",
      "CHECKING depth: 1 for transitions from root.a",
      "EXEC_PATH root.a[LS]->root.b[LS]",
      "TRANS_EXIT exiting all up to (including): root.a , lca: root",
      "STATE_EXIT root.a", "EFFECT " .. tr,
      "TRANS_ENTER lca: root down_path:  root.b", "RAISED e_done@root.b",
      "STATE_ENTER root.b",
      "TRANSITION searching transitions for events: e_done@root.b",
      "CHECKING depth: 0 for transitions from root",
      "CHECKING depth: 1 for transitions from root.b",
      "TRANSITION no enabled paths found",
      "HIBERNATING no events, no idle_hook, no doos or doo idle, halting engines",
    }, records)
  end)

  it("tells of the beginning and the end of a doo", function()
    local records = {}
    local fsm = started { a = state { doo = function() rfsm.yield() end } }
    fsm.dbg = function(...) records[#records + 1] = table.concat({ ... }, " ") end
    rfsm.reset(fsm)
    rfsm.run(fsm)
    local doos = {}
    for _, record in ipairs(records) do
      if record:find("^DOO") then doos[#doos + 1] = record end
    end
    assert.same({ "DOO created coroutine for root.a doo",
      "DOO removing completed coroutine of root.a doo" }, doos)
  end)
end)

describe("a step hook", function()
  it("sees the events and may change them", function()
    local fsm = started()
    rfsm.pre_step_hook_add(fsm, function(_, events) events[1] = "e" end)
    rfsm.step(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)

  it("that an effect sets runs at the end of the same iteration", function()
    local trace, fsm = {}, started()
    local count = 0
    fsm[2].effect = function()
      count = count + 1
      if count < 3 then return end
      fsm.post_step_hook = function(_, events)
        trace[#trace + 1] = texts_of(events)
        trace[#trace + 1] = rfsm.get_actleaf_fqn(fsm)
      end
    end
    for _ = 1, 4 do helper.post_and_run(fsm, "e") end
    rfsm.send_events(fsm, "e")
    rfsm.step(fsm)
    assert.same({ { "e" }, "root.b" }, trace)
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

  it("can be taken out again", function()
    local trace, fsm = {}, started()
    local hook = noting(trace, "hook")
    rfsm.post_step_hook_add(fsm, hook)
    assert.is_true(rfsm.post_step_hook_rm(fsm, hook))
    assert.is_false(rfsm.post_step_hook_rm(fsm, hook))
    rfsm.step(fsm)
    assert.same({}, trace)
  end)

  it("that takes itself out does not disturb the others", function()
    local trace, fsm = {}, started()
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
end)

describe("an entry hook", function()
  it("runs before the entry and survives a new one", function()
    local trace, fsm = {}, started()
    rfsm.entry_hook_add(fsm, fsm.b, noting(trace, "hook"))
    rfsm.exit_hook_add(fsm, fsm.b, noting(trace, "exit hook"))
    fsm.b.entry, fsm.b.exit = noting(trace, "entry"), noting(trace, "exit")
    helper.post_and_run(fsm, "e")
    helper.post_and_run(fsm, "e")
    assert.same({ "hook", "entry", "exit", "exit hook" }, trace)
  end)
end)

describe("a call from inside", function()
  it("to step is an error of the program that made it", function()
    local said = {}
    local fsm = started()
    fsm.err = function(...) said[#said + 1] = table.concat({ ... }, " ") end
    fsm.b.entry = function(machine) rfsm.step(machine) end
    helper.post_and_run(fsm, "e")
    assert.equal(1, #said)
    assert.matches("live_spec.lua:%d+: rfsm.step: the machine is in the middle of a "
      .. "step", said[1])
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)

  it("to reset takes effect when the iteration is over", function()
    local fsm = started()
    local seen
    fsm.b.entry = function(machine)
      rfsm.reset(machine)
      seen = rfsm.get_active_conf(machine)
    end
    rfsm.send_events(fsm, "e")
    assert.is_false(rfsm.step(fsm))
    assert.same({ "root", "root.b" }, seen)
    assert.same({}, rfsm.get_active_conf(fsm))
    assert.same({ "e_init_fsm" }, fsm._intq)
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

describe("exit_state", function()
  it("exits what is active below, the deepest first", function()
    local trace, fsm = helper.traced(state {
      a = state { x = state {}, trans { src = "initial", tgt = "x" } },
      trans { src = "initial", tgt = "a" },
    })
    rfsm.run(fsm)
    helper.clear(trace)
    rfsm.exit_state(fsm, fsm)
    assert.same({ "exit root.a.x", "exit root.a" }, trace)
    assert.same({}, rfsm.get_active_conf(fsm))
  end)
end)

describe("node_find_enabled", function()
  local function segments_of(path)
    local texts = {}
    while path.nextl do
      texts[#texts + 1] = tostring(path.nextl[1].trans)
      path = path.nextl[1].next
    end
    return texts
  end

  -- initial -> a --e_go--> k --> b
  local function through_a_connector()
    local trace, fsm = helper.traced(state {
      a = state {}, k = conn {}, b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "k", events = { "e_go" } },
      trans { src = "k", tgt = "b" },
    })
    rfsm.run(fsm)
    return fsm, trace
  end

  it("returns the segments of the path, and takes none", function()
    local fsm, trace = through_a_connector()
    helper.clear(trace)
    assert.same({ "T={ src='root.a', tgt='root.k', events='e_go' }",
      "T={ src='root.k', tgt='root.b' }" },
      segments_of(rfsm.node_find_enabled(fsm, fsm.a, { "e_go" })))
    assert.same({}, trace)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
  end)

  it("tells what leaves a node that has never been active", function()
    local fsm = through_a_connector()
    local path = rfsm.node_find_enabled(fsm, fsm.k, { "e" })
    assert.same({ "T={ src='root.k', tgt='root.b' }" }, segments_of(path))
    assert.equal(fsm.k, path.node)
    assert.equal(fsm.b, path.nextl[1].next.node)
    assert.is_false(path.nextl[1].next.nextl)
    assert.is_false(rfsm.node_find_enabled(fsm, fsm.b, { "e" }))
  end)

  it("leaves the path alone that an effect asks from", function()
    local fsm, trace = through_a_connector()
    fsm[2].effect = function(machine)
      rfsm.node_find_enabled(machine, machine.initial, { "e" })
    end
    helper.clear(trace)
    helper.post_and_run(fsm, "e_go")
    assert.same({ "exit root.a", "effect root.k->root.b", "entry root.b" }, trace)
  end)

  -- initial -> a --e_go--> k --> k1 --e_go--> b, and a guarded way k --> a
  it("leaves the search alone that a guard asks from", function()
    local is_asking = false
    local trace, fsm = helper.traced(state {
      a = state {}, k = conn {}, k1 = conn {}, b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "k", events = { "e_go" } },
      trans { src = "k", tgt = "k1" },
      trans { src = "k", tgt = "a" },
      trans { src = "k1", tgt = "b", events = { "e_go" } },
    })
    rfsm.run(fsm)
    fsm[4].guard = function()
      if not is_asking then
        is_asking = true
        rfsm.node_find_enabled(fsm, fsm.k, { "e_other" })
      end
      return false
    end
    helper.clear(trace)
    helper.post_and_run(fsm, "e_go")
    assert.equal("entry root.b", trace[#trace])
  end)

  it("wants a node of a machine", function()
    local fsm = started()
    assert.error_matches(function() rfsm.node_find_enabled(fsm, state {}, {}) end,
      "rfsm.node_find_enabled: node of the fsm expected, got state", 1, true)
  end)
end)

describe("fsm_merge from inside", function()
  it("gives a leaf no children while a transition may enter it", function()
    local fsm, reason = started()
    fsm[2].effect = function(machine)
      reason = select(2, rfsm.fsm_merge(machine, machine.b, state {}, "x"))
    end
    helper.post_and_run(fsm, "e")
    assert.equal("rfsm.fsm_merge: 'root.b' is a leaf state, while a transition is "
      .. "taken", reason)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)

  it("gives a leaf children from a guard", function()
    local fsm, is_merged = started()
    fsm[2].guard = function()
      is_merged = is_merged or rfsm.fsm_merge(fsm, fsm.b, rfsm.conn {}, "initial")
      return false
    end
    helper.post_and_run(fsm, "e")
    assert.is_true(is_merged)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("a state hook", function()
  it("runs at once, after those that are there", function()
    local trace, fsm = {}, started()
    helper.post_and_run(fsm, "e")
    helper.post_and_run(fsm, "e")
    rfsm.entry_hook_add(fsm, fsm.b, noting(trace, "one"))
    helper.post_and_run(fsm, "e")
    fsm[3].effect = function()
      rfsm.entry_hook_add(fsm, fsm.a, noting(trace, "now"))
    end
    rfsm.entry_hook_add(fsm, fsm.b, noting(trace, "two"))
    helper.post_and_run(fsm, "e")
    helper.post_and_run(fsm, "e")
    assert.same({ "one", "now", "one", "two" }, trace)
  end)

  it("may change programs after an exit that failed", function()
    local trace, fsm = {}, started { err = false }
    fsm.a.exit = error
    rfsm.exit_hook_add(fsm, fsm.a, function() fsm.b.entry = noting(trace, "new") end)
    helper.post_and_run(fsm, "e")
    assert.same({ "new" }, trace)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("a merge into a live machine", function()
  it("that is refused leaves a leaf a leaf", function()
    local fsm = started()
    fsm.err = false
    local ok, reason = rfsm.fsm_merge(fsm, fsm.b, trans { src = "initial", tgt = "x" })
    assert.is_false(ok)
    assert.matches("the model has 3 problems\n.*no state or connector is named 'x' in "
      .. "'root.b'", reason)
    assert.is_nil(fsm.b.initial)
    assert.is_true(rfsm.is_leaf(fsm.b))
    rfsm.send_events(fsm, "e")
    rfsm.step(fsm)
    assert.same({ "e_done@root.b" }, fsm._intq)
  end)

  it("that is refused leaves no trace in the next one", function()
    local fsm, is_refused = started(), true
    table.insert(rfsm.preproc, function(_, merged)
      return is_refused and { merged._fqn .. ": refused" } or nil
    end)
    local ok, reason = rfsm.fsm_merge(fsm, fsm, state {}, "d")
    is_refused = false
    local is_merged = rfsm.fsm_merge(fsm, fsm, conn {}, "k")
    table.remove(rfsm.preproc)
    assert.is_false(ok)
    assert.equal("rfsm.fsm_merge: the model has 1 problem\n  root.d: refused", reason)
    assert.is_true(is_merged)
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
    helper.post_and_run(fsm, "e")
    assert.equal("root.b.x", rfsm.get_actleaf_fqn(fsm))
  end)

  it("copies plain tables at once", function()
    local fsm, d = started(), state { data = { 1 } }
    assert.is_true(rfsm.fsm_merge(fsm, fsm, d, "d"))
    d.data[1] = 2
    assert.same({ 1 }, fsm.d.data)
  end)

  it("takes no name of a field that the machine was given", function()
    local fsm = started()
    fsm.d = 5
    local ok, reason = rfsm.fsm_merge(fsm, fsm, state {}, "d")
    assert.is_false(ok)
    assert.equal("rfsm.fsm_merge: 'root' has a member 'd' already", reason)
  end)

  it("warns of what is new alone", function()
    local said, fsm = {}, started { dead = state {} }
    fsm.warn = function(text) said[#said + 1] = text end
    assert.is_true(rfsm.fsm_merge(fsm, fsm, state {}, "d"))
    assert.same({ "WARNING: no outgoing transitions from node 'root.d'" }, said)
  end)

  it("gives a leaf no children while the machine is being entered", function()
    local fsm, ok, reason
    fsm = helper.init(state {
      a = state {},
      trans { src = "initial", tgt = "a", guard = function()
        ok, reason = rfsm.fsm_merge(fsm, fsm.a, conn {}, "initial")
      end },
    })
    rfsm.run(fsm)
    assert.is_false(ok)
    assert.equal("rfsm.fsm_merge: 'root.a' is a leaf state, while a transition is "
      .. "taken", reason)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("an e_done that nothing waited for", function()
  it("does not come again later, where something waits for it", function()
    local fsm = started {
      [4] = trans { src = "b", tgt = "b", events = "e_x" },
      [5] = trans { src = "b", tgt = "a", events = "e_done@root.a" },
    }
    for _ = 1, 3 do
      rfsm.reset(fsm)
      rfsm.step(fsm)
      assert.same({ "e_done@root.a" }, fsm._intq)
      helper.post_and_run(fsm, "e")
      helper.post_and_run(fsm, "e_x")
      helper.post_and_run(fsm, "e_x")
      assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    end
  end)
end)

describe("an events table", function()
  local kept

  local function keep(events) kept[#kept + 1] = events end

  -- initial -> a --e1--> k --> b --e2--> a, with `effect` everywhere
  local function started_with(effect)
    kept = {}
    local fsm = helper.init(state {
      err = false, a = state {}, b = state {}, k = conn {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "k", events = "e1" },
      trans { src = "k", tgt = "b", effect = effect },
      trans { src = "b", tgt = "a", events = "e2", effect = effect },
    })
    rfsm.run(fsm)
    return fsm
  end

  local function kept_after_three(fsm)
    for _, event in ipairs({ "e1", "e2", "e1" }) do
      rfsm.send_events(fsm, event)
      rfsm.run(fsm)
    end
    return kept
  end

  local EFFECTS = {
    { "with four parameters", function(_, _, _, events) keep(events) end },
    { "with any number", function(...) keep((select(4, ...))) end },
    { "that is a table", setmetatable({}, {
      __call = function(_, _, _, _, events) keep(events) end,
    }) },
    { "that fails", function(_, _, _, events)
      keep(events)
      error("on purpose")
    end },
  }
  it("that was kept stays what it was: by a coroutine", function()
    local effect = coroutine.wrap(function(...)
      keep((select(4, ...)))
      while true do keep((select(4, coroutine.yield()))) end
    end)
    assert.same({ { "e1" }, { "e2" }, { "e1" } },
      kept_after_three(started_with(effect)))
  end)

  for _, effect in ipairs(EFFECTS) do
    it("that was kept stays what it was: by an effect " .. effect[1], function()
      assert.same({ { "e1" }, { "e2" }, { "e1" } },
        kept_after_three(started_with(effect[2])))
    end)

    it("that was kept stays what it was, traced: by an effect " .. effect[1], function()
      local fsm = started_with(effect[2])
      fsm.dbg = function() end
      assert.same({ { "e1" }, { "e2" }, { "e1" } }, kept_after_three(fsm))
    end)
  end

  for _, hook in ipairs({ "pre_step_hook", "post_step_hook" }) do
    it("that was kept stays what it was: by a " .. hook, function()
      local fsm = started_with(nil)
      fsm[hook] = function(_, events) if events[1] then keep(events) end end
      local lists = kept_after_three(fsm)
      assert.same({ "e1" }, lists[1])
      assert.same({ "e_done@root.b" }, lists[2])
      assert.same({ "e2" }, lists[3])
    end)
  end
end)
