-- What a user may rely on where machines tend to go wrong, rule by rule. The texts of
-- model problems are in check_spec.lua.

local helper = require "spec.helper"
local rfsm = require "rfsm"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

-- initial -> a, and more members.
local function chart(members)
  members.a = members.a or state {}
  members[#members + 1] = trans { src = "initial", tgt = "a" }
  return state(members)
end

local function started(members)
  local fsm = helper.init(chart(members))
  rfsm.run(fsm)
  return fsm
end

local function lines(list) return table.concat(list, " ") end

describe("FIX predicates:", function()
  local PREDICATES = {
    "is_fsmobj", "is_state", "is_trans", "is_conn", "is_node", "is_composite",
    "is_leaf", "is_root", "is_initialized_root", "is_nr_node", "is_meta",
    "fsmobj_tochar",
  }

  it("any value at all may be asked about", function()
    for _, name in ipairs(PREDICATES) do
      assert.is_falsy(rfsm[name](nil))
      local co = coroutine.create(function() end)
      for _, value in ipairs({ false, 0, "x", {}, print, co }) do
        assert.is_falsy(rfsm[name](value))
      end
    end
  end)

  it("an answer is never stale", function()
    local s = state {}
    assert.is_true(rfsm.is_leaf(s))
    s.child = state {}
    assert.is_true(rfsm.is_composite(s))
    assert.equal("CS", rfsm.fsmobj_tochar(s))
    s.child = nil
    assert.is_true(rfsm.is_leaf(s))
    assert.equal("LS", rfsm.fsmobj_tochar(s))
  end)
end)

describe("FIX trace:", function()
  it("none of it costs anything while dbg is off", function()
    local asked = 0
    local event = setmetatable({}, { __tostring = function()
      asked = asked + 1
      return "event"
    end })
    local fsm = started { trans { src = "a", tgt = "a", events = { event } } }
    helper.post_and_run(fsm, event)
    assert.equal(0, asked)
    fsm.dbg = function() end
    helper.post_and_run(fsm, event)
    assert.is_true(asked > 0)
  end)
end)

describe("FIX ties:", function()
  local function winner(members)
    local fsm = started(members)
    helper.post_and_run(fsm, "e")
    return rfsm.get_actleaf_fqn(fsm)
  end

  it("declared further out first", function()
    local inner = state {
      x = state {}, near = state {}, trans { src = "initial", tgt = "x" },
      trans { src = "x", tgt = "near", events = "e" },
    }
    assert.equal("root.far", winner {
      a = inner, far = state {}, trans { src = ".a.x", tgt = "far", events = "e" },
    })
  end)

  it("then position in the table", function()
    assert.equal("root.z", winner {
      z = state {}, b = state {},
      trans { src = "a", tgt = "z", events = "e" },
      trans { src = "a", tgt = "b", events = "e" },
    })
  end)

  it("then, for transitions with names, sorted by key", function()
    assert.equal("root.z", winner {
      z = state {}, b = state {},
      t2 = trans { src = "a", tgt = "b", events = "e" },
      t1 = trans { src = "a", tgt = "z", events = "e" },
    })
  end)
end)

describe("FIX guard:", function()
  it("is called only when the events match", function()
    local asked = {}
    local fsm = started {
      b = state {},
      trans {
        src = "a", tgt = "b", events = "e_yes",
        guard = function(_, events) asked[#asked + 1] = lines(events) end,
      },
    }
    helper.post_and_run(fsm, "e_no")
    helper.post_and_run(fsm, "e_yes")
    assert.same({ "e_yes" }, asked)
  end)
end)

describe("FIX connectors:", function()
  local function conflicts(pn)
    local said = {}
    local fsm = started {
      warn = false, k = conn {}, b = state {}, c = state {},
      trans { src = "a", tgt = "k", events = "e" },
      trans { src = "k", tgt = "b", pn = pn }, trans { src = "k", tgt = "c" },
    }
    fsm.warn = function(text) said[#said + 1] = text end
    helper.post_and_run(fsm, "e")
    return said, rfsm.get_actleaf_fqn(fsm)
  end

  it("two ways with the same pn: a warning, then one line per target", function()
    local said, leaf = conflicts(nil)
    assert.same({
      "conflicting transitions from src root.k to", "\troot.b", "\troot.c",
    }, said)
    assert.equal("root.b", leaf)
  end)

  it("the same of two that come into question after a closed one", function()
    local said = {}
    local fsm = started {
      warn = false, k = conn {}, b = state {}, c = state {}, d = state {},
      trans { src = "a", tgt = "k", events = "e" },
      trans { src = "k", tgt = "b", pn = 1, guard = function() return false end },
      trans { src = "k", tgt = "c" }, trans { src = "k", tgt = "d" },
    }
    fsm.warn = function(text) said[#said + 1] = text end
    helper.post_and_run(fsm, "e")
    assert.same({
      "conflicting transitions from src root.k to", "\troot.c", "\troot.d",
    }, said)
    assert.equal("root.c", rfsm.get_actleaf_fqn(fsm))
  end)

  it("no warning if the pns differ", function()
    assert.same({}, (conflicts(1)))
  end)

  it("a connector already on the path is not enabled", function()
    local fsm = started {
      k = conn {}, l = conn {}, b = state {},
      trans { src = "a", tgt = "k", events = "e" },
      trans { src = "k", tgt = "l", pn = 1 }, trans { src = "l", tgt = "k" },
      trans { src = "k", tgt = "b" },
    }
    helper.post_and_run(fsm, "e")
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)

  it("a guard that yields enables nothing, however far away it is", function()
    local members = { err = false, b = state {}, trans { src = "a", tgt = "k1" } }
    for i = 1, 600 do
      members["k" .. i] = conn {}
      members[#members + 1] = trans {
        src = "k" .. i, tgt = i < 600 and "k" .. i + 1 or "b",
        guard = i == 600 and function() return rfsm.yield(true) end or nil,
      }
    end
    local fsm = started(members)
    local co = coroutine.wrap(function() return helper.post_and_run(fsm, "e") end)
    co()
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
  end)

  it("each connector is evaluated at most once a step", function()
    local asked = 0
    local members = { b = state {}, trans { src = "a", tgt = "k1", events = "e" } }
    local function guard() asked = asked + 1 end
    for i = 1, 30 do
      members["k" .. i] = conn {}
      local tgt = i < 30 and "k" .. i + 1 or "k1" -- a dead end, at last
      members[#members + 1] = trans { src = "k" .. i, tgt = tgt, guard = guard, pn = 1 }
      members[#members + 1] = trans { src = "k" .. i, tgt = tgt, guard = guard }
    end
    local fsm = started(members)
    helper.post_and_run(fsm, "e")
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
    assert.equal(60, asked)
  end)
end)

describe("FIX surroundings:", function()
  local function failing() error("on purpose", 0) end

  -- Sends e with `fields` on the machine: what the caller gets, and where it is.
  local function with(fields)
    local fsm = started { b = state {}, trans { src = "a", tgt = "b", events = "e" } }
    for name, value in pairs(fields) do fsm[name] = value end -- any order: a set
    local ok, problem = pcall(function()
      rfsm.send_events(fsm, "e")
      rfsm.step(fsm)
    end)
    return ok, problem, fsm
  end

  for name, leaf in pairs { getevents = "root.a", pre_step_hook = "root.a",
    post_step_hook = "root.b" } do -- any order: each stands alone
    it("a failing " .. name .. " reaches the caller, and no event is lost", function()
      local ok, problem, fsm = with { [name] = failing }
      assert.is_false(ok)
      assert.equal("on purpose", problem)
      assert.equal(leaf, rfsm.get_actleaf_fqn(fsm))
      fsm[name] = nil
      assert.is_true(rfsm.run(fsm))
      assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    end)
  end

  it("a failing dbg loses no event", function()
    local ok, problem, fsm = with { dbg = failing }
    assert.is_false(ok)
    assert.equal("on purpose", problem)
    fsm.dbg = false
    rfsm.run(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)

  it("a failing err does not stop a transition", function()
    local fsm = started {
      b = state { entry = failing }, trans { src = "a", tgt = "b", events = "e" },
    }
    fsm.err = function() error("err failed", 0) end
    rfsm.send_events(fsm, "e")
    local ok, problem = pcall(rfsm.step, fsm)
    assert.is_false(ok)
    assert.equal("err failed", problem)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)

  it("a failing idle_hook finds the machine consistent", function()
    local fsm = started {}
    fsm.idle_hook = failing
    assert.is_false((pcall(rfsm.step, fsm, 2)))
    fsm.idle_hook = nil
    assert.is_true(rfsm.run(fsm))
  end)

  it("the default printers accept any value", function()
    local bad = setmetatable({}, { __tostring = function() error("no text") end })
    local out = helper.printed(function()
      started({ info = true }).info(nil, bad, {}, 1.5)
    end)
    assert.matches("^nil\ttable\ttable: .*\t1.5$", out[2])
  end)
end)

describe("FIX queue:", function()
  it("send_events skips nil and keeps the rest", function()
    local fsm = started {}
    rfsm.send_events(fsm, nil, "e1", nil, "e2", nil)
    assert.same({ "e1", "e2" }, fsm._intq)
  end)

  it("getevents may return nil", function()
    local fsm = started { getevents = function() return nil end }
    assert.is_true(rfsm.run(fsm))
  end)

  for _, name in ipairs({ "send_events", "step", "run", "reset" }) do
    it(name .. " on what is no fsm blames the caller", function()
      local ok, problem = pcall(function() rfsm[name](state {}) end)
      assert.is_false(ok)
      assert.matches("contract_spec.lua:%d+: rfsm." .. name .. ": initialised fsm "
        .. "expected, got state", problem)
    end)
  end

  it("init does not copy events", function()
    local event = {}
    local fsm = started {
      b = state {}, trans { src = "a", tgt = "b", events = { event } },
    }
    helper.post_and_run(fsm, {})
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
    helper.post_and_run(fsm, event)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)

  it("is kept when there is no path from root.initial", function()
    local is_open, said = false, {}
    local fsm = helper.init(state {
      err = function(text) said[#said + 1] = text end,
      a = state {},
      trans { src = "initial", tgt = "a", guard = function() return is_open end },
    })
    rfsm.send_events(fsm, "e")
    assert.is_false(rfsm.step(fsm))
    assert.same({ "e_init_fsm", "e" }, fsm._intq)
    assert.same({
      "ERROR: cannot enter: no enabled path from 'root.initial' on events: "
        .. "e_init_fsm, e",
    }, said)
    is_open = true
    rfsm.run(fsm)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("an entry that is refused", function()
  it("leaves a machine as new when a guard resets it", function()
    local fsm
    fsm = helper.init(state {
      err = false, a = state {},
      trans { src = "initial", tgt = "a", guard = function()
        rfsm.reset(fsm)
        return false
      end },
    })
    rfsm.send_events(fsm, "e")
    assert.is_false(rfsm.step(fsm))
    assert.same({ "e_init_fsm" }, fsm._intq)
  end)

  for _, hook in ipairs({ false, function() end }) do
    local kind = hook and "with a hook" or "plain"
    it("ends a run after a doo that exits its state: " .. kind, function()
      local fsm = helper.init(state {
        err = false, post_step_hook = hook or nil,
        a = state {
          doo = function(fsm, self)
            rfsm.yield(true)
            rfsm.exit_state(fsm, self)
            rfsm.yield(true)
          end,
        },
        trans { src = "initial", tgt = "a", events = "e_init_fsm" },
      })
      rfsm.run(fsm)
      assert.is_false(rfsm.run(fsm))
      assert.same({ "root" }, rfsm.get_active_conf(fsm))
    end)
  end
end)

describe("FIX step:", function()
  it("returns under constant unmatched events, with a doo cycle", function()
    local cycles = 0
    local fsm = helper.init(chart {
      getevents = function() return { "e_noise" } end,
      a = state {
        doo = function()
          while true do
            cycles = cycles + 1
            rfsm.yield()
          end
        end,
      },
    })
    rfsm.step(fsm)
    rfsm.step(fsm, 3)
    assert.equal(3, cycles)
  end)

  it("is idle only when the queue is empty", function()
    local fsm = started {}
    fsm.post_step_hook = function(machine) rfsm.send_events(machine, "e") end
    assert.is_false(rfsm.step(fsm))
    fsm.post_step_hook = nil
    assert.is_true(rfsm.run(fsm))
  end)

  it("does not grow the stack", function()
    local left = 200000
    local fsm = started {
      b = state {
        entry = function(fsm)
          left = left - 1
          if left > 0 then rfsm.send_events(fsm, "e") end
        end,
      },
      trans { src = "a", tgt = "b", events = "e" },
      trans { src = "b", tgt = "b", events = "e" },
    }
    helper.post_and_run(fsm, "e")
    assert.equal(0, left)
  end)
end)

describe("FIX reset:", function()
  it("resets what extensions keep", function()
    local fsm = started {}
    local called = 0
    rfsm.reset_hook_add(fsm, function(machine)
      assert.equal(fsm, machine)
      called = called + 1
    end)
    rfsm.reset(fsm)
    assert.equal(1, called)
  end)
end)

describe("FIX copying:", function()
  it("one sub model may be mounted twice", function()
    local sub = state { x = state {}, trans { src = "initial", tgt = "x" } }
    local fsm = helper.init(chart { a = sub, b = sub })
    assert.equal("root.a.x", fsm.a.x._fqn)
    assert.equal("root.b.x", fsm.b.x._fqn)
    assert.equal(fsm.b.x, fsm.b[1].tgt)
  end)

  it("one transition object may be used twice", function()
    local back = trans { src = "x", tgt = "x", events = "e" }
    local fsm = helper.init(chart {
      a = state { x = state {}, trans { src = "initial", tgt = "x" }, back },
      b = state { x = state {}, back },
    })
    assert.equal(fsm.a.x, fsm.a[2].src)
    assert.equal(fsm.b.x, fsm.b[1].src)
  end)

  it("one model gives independent machines", function()
    local model = chart { b = state {}, trans { src = "a", tgt = "b", events = "e" } }
    local one, two = helper.init(model), helper.init(model)
    rfsm.run(one)
    helper.post_and_run(one, "e")
    rfsm.run(two)
    assert.equal("root.b", rfsm.get_actleaf_fqn(one))
    assert.equal("root.a", rfsm.get_actleaf_fqn(two))
  end)

  it("plain tables are copied, shared structure kept, all else is shared", function()
    local shared, object = { 1 }, setmetatable({}, {})
    local fsm = helper.init(chart {
      data = { one = shared, two = shared, object = object },
      a = state { own = shared },
    })
    assert.same({ 1 }, fsm.data.one)
    assert.not_equal(shared, fsm.data.one)
    assert.equal(fsm.data.one, fsm.data.two)
    assert.equal(fsm.data.one, fsm.a.own)
    assert.equal(object, fsm.data.object)
  end)

  it("what a model holds under the engine's own names does no harm", function()
    local own = {}
    for _, name in ipairs({ "id", "fqn", "parent", "mode", "actchild", "doo_co", "otrs",
      "is_leaf", "sources", "choices", "ignored", "by_event", "by_any", "done_event",
      "search", "way", "entry_hooks", "exit_hooks", "lca", "entries", "run", "rank",
      "is_simple", "initialized", "nodes" }) do
      own["_" .. name] = { "the user's" }
    end
    local function marked(element)
      for name, value in pairs(own) do element[name] = value end
      return element
    end
    local trace, fsm = helper.traced(marked(state {
      a = marked(state {}), b = marked(state {}), k = marked(conn {}),
      marked(trans { src = "initial", tgt = "a" }),
      marked(trans { src = "a", tgt = "k", events = "e" }),
      marked(trans { src = "k", tgt = "b" }),
    }))
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e")
    assert.same({ "effect root.initial->root.a", "entry root.a",
      "exit root.a", "effect root.a->root.k", "effect root.k->root.b", "entry root.b" },
      trace)
  end)

  it("init of an initialised fsm gives a fresh instance of its model", function()
    local fsm = started {}
    local fresh = helper.init(fsm)
    assert.not_equal(fsm, fresh)
    assert.equal(false, rfsm.get_actleaf_fqn(fresh))
    rfsm.run(fresh)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fresh))
  end)

  it("an initialised fsm as a child means its model", function()
    local sub = started { x = state {} }
    local fsm = started { a = sub }
    assert.equal("root.a.a", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("FIX load:", function()
  it("no file name is an error, not stdin", function()
    local ok, problem = pcall(function() return (rfsm.load()) end)
    assert.is_false(ok)
    assert.matches("contract_spec.lua:%d+: rfsm.load: file name expected, got nil",
      problem)
  end)

  it("load_str says what is wrong with the text", function()
    local function problem_of(text) return (select(2, pcall(rfsm.load_str, text))) end
    assert.matches("^rfsm.load_str: failed to load chunk: ", problem_of("return {"))
    assert.equal("rfsm.load_str: no valid rfsm in 'string' found.",
      problem_of("return 1"))
    assert.is_true(rfsm.is_state(rfsm.load_str("return rfsm.state {}")))
  end)
end)

describe("FIX fsm_merge:", function()
  local function merged(parent, obj, id)
    local fsm = started { m = state { x = state {} } }
    return fsm, rfsm.fsm_merge(fsm, parent and fsm[parent] or fsm, obj, id)
  end

  it("adds a leaf", function()
    local fsm, ok = merged(nil, state {}, "new")
    assert.is_true(ok)
    assert.equal("root.new", fsm.new._fqn)
  end)

  it("adds a connector", function()
    local fsm, ok = merged("m", conn {}, "k")
    assert.is_true(ok)
    assert.equal("root.m.k", fsm.m.k._fqn)
  end)

  it("adds a composite, which can be entered like any other", function()
    local fsm = merged(nil, state {
      y = state {}, trans { src = "initial", tgt = "y" },
    }, "new")
    assert.is_true((rfsm.fsm_merge(fsm, fsm, trans {
      src = "a", tgt = "new", events = "e",
    })))
    helper.post_and_run(fsm, "e")
    assert.equal("root.new.y", rfsm.get_actleaf_fqn(fsm))
  end)

  it("adds a transition in its place of the order", function()
    local fsm, ok = merged(nil, trans { src = "a", tgt = ".m.x", events = "e", pn = 5 })
    assert.is_true(ok)
    helper.post_and_run(fsm, "e")
    assert.equal("root.m.x", rfsm.get_actleaf_fqn(fsm))
  end)

  it("changes nothing when it cannot", function()
    local fsm, ok, reason = merged(nil, trans { src = "a", tgt = "nowhere" })
    assert.is_false(ok)
    assert.equal("rfsm.fsm_merge: the model has 1 problem\n  root.trans[2] (a -> "
      .. "nowhere): tgt 'nowhere': no state or connector is named 'nowhere' in 'root' "
      .. "(there are 'a', 'initial', 'm')",
      (reason:gsub("spec/contract_spec.lua:%d+: ", "")))
    assert.is_nil(fsm[2])
  end)

  it("says why", function()
    local function reason_of(...) return (select(3, merged(...))) end
    assert.equal("rfsm.fsm_merge: 'root' has a member 'm' already",
      reason_of(nil, state {}, "m"))
    assert.equal("rfsm.fsm_merge: a state needs a name", reason_of(nil, state {}))
    assert.equal("rfsm.fsm_merge: state, transition or connector expected, got table",
      reason_of(nil, {}, "x"))
    assert.equal("rfsm.fsm_merge: 'root.a' is an active leaf state",
      reason_of("a", state {}, "x"))
  end)
end)

describe("FIX mapfsm:", function()
  it("parents before children, array part first, then names sorted", function()
    local model = state {
      b = state { d = conn {}, c = state {} }, a = state {},
      trans { src = "a", tgt = "b" }, t = trans { src = "b", tgt = "a" },
    }
    assert.same({ 1, "a", "b", "c", "d", "t" },
      rfsm.mapfsm(function(_, _, name) return name end, model))
  end)

  it("stops at a depth", function()
    local model = state { a = state { b = state {} } }
    assert.same({ "a" },
      rfsm.mapfsm(function(_, _, name) return name end, model, rfsm.is_node, 1))
  end)
end)
