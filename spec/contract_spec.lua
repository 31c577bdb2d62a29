-- What a user may rely on where machines tend to go wrong, rule by rule. The texts of
-- model problems are in check_spec.lua.

local helper = require "spec.helper"
local rfsm = require "rfsm"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn
local init, said, leaf_after = helper.init, helper.said, helper.leaf_after

-- initial -> a, and more members.
local function chart(members)
  members.a = members.a or state {}
  members[#members + 1] = trans { src = "initial", tgt = "a" }
  return state(members)
end

local function started(members) return helper.started(chart(members)) end

-- Transitions: "a -> b", "a -> b e" with the event e.
local function tr(text, fields)
  local result = fields or {}
  local src, tgt, event = text:match("^(%S+) %-> (%S+) ?(.*)$")
  result.src, result.tgt, result.events = src, tgt, event ~= "" and { event } or nil
  return trans(result)
end

local function closed() return false end

describe("FIX predicates:", function()
  it("any value at all may be asked about", function()
    for _, name in ipairs {
      "is_fsmobj", "is_state", "is_trans", "is_conn", "is_node", "is_composite",
      "is_leaf", "is_root", "is_initialized_root", "is_nr_node", "is_meta",
      "fsmobj_tochar",
    } do
      assert.is_falsy(rfsm[name](nil))
      local co = coroutine.create(function() end)
      for _, value in ipairs({ false, 0, "x", {}, print, co }) do
        assert.is_falsy(rfsm[name](value))
      end
    end
  end)

  it("an answer is never stale", function()
    local s = state {}
    for _, is_leaf in ipairs { true, false, true } do
      s.child = not is_leaf and state {} or nil
      assert.same({ is_leaf, not is_leaf, is_leaf and "LS" or "CS" },
        { rfsm.is_leaf(s), rfsm.is_composite(s), rfsm.fsmobj_tochar(s) })
    end
  end)
end)

it("FIX trace: none of it costs anything while dbg is off", function()
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

describe("FIX ties:", function()
  for name, case in pairs { -- any order: each stands alone
    ["declared further out first"] = { "root.far", {
      a = state { x = state {}, near = state {}, tr "initial -> x", tr "x -> near e" },
      far = state {}, tr ".a.x -> far e",
    } },
    ["then position in the table"] = { "root.z",
      { z = state {}, b = state {}, tr "a -> z e", tr "a -> b e" } },
    ["then, for transitions with names, sorted by key"] = { "root.z",
      { z = state {}, b = state {}, t2 = tr "a -> b e", t1 = tr "a -> z e" } },
  } do
    it(name, function() assert.equal(case[1], leaf_after(started(case[2]), "e")) end)
  end
end)

it("FIX guard: is called only when the events match", function()
  local asked = {}
  local fsm = started { b = state {}, tr("a -> b e_yes", {
    guard = function(_, events) asked[#asked + 1] = table.concat(events, " ") end,
  }) }
  helper.post_and_run(fsm, "e_no")
  helper.post_and_run(fsm, "e_yes")
  assert.same({ "e_yes" }, asked)
end)

describe("FIX connectors:", function()
  -- What is warned of at three ways from k, by their pn and guards; where it leads.
  for _, case in ipairs {
    { "two ways with the same pn: a warning, then one line per target",
      { {}, {}, { pn = -1 } }, { "b", "c" }, "b" },
    { "the same of two that come into question after a closed one",
      { { pn = 1, guard = closed }, {}, {} }, { "c", "d" }, "c" },
    { "no warning if the pns differ", { { pn = 1 }, {}, { pn = -1 } }, {}, "b" },
  } do
    it(case[1], function()
      local ways = case[2]
      local fsm = started {
        warn = false, k = conn {}, b = state {}, c = state {}, d = state {},
        tr "a -> k e", tr("k -> b", ways[1]), tr("k -> c", ways[2]),
        tr("k -> d", ways[3]),
      }
      local warnings = said(fsm, "warn")
      assert.equal("root." .. case[4], leaf_after(fsm, "e"))
      local expected = case[3][1]
        and { "conflicting transitions from src root.k to" } or {}
      for i, name in ipairs(case[3]) do expected[i + 1] = "\troot." .. name end
      assert.same(expected, warnings)
    end)
  end

  it("a connector already on the path is not enabled", function()
    assert.equal("root.b", leaf_after(started {
      k = conn {}, l = conn {}, b = state {}, tr "a -> k e", tr("k -> l", { pn = 1 }),
      tr "l -> k", tr "k -> b",
    }, "e"))
  end)

  it("a guard that yields enables nothing, however far away it is", function()
    local members = { err = false, b = state {}, tr "a -> k1" }
    for i = 1, 600 do
      members["k" .. i] = conn {}
      members[#members + 1] = trans {
        src = "k" .. i, tgt = i < 600 and "k" .. i + 1 or "b",
        guard = i == 600 and function() return rfsm.yield(true) end or nil,
      }
    end
    local fsm = started(members)
    coroutine.wrap(function() return helper.post_and_run(fsm, "e") end)()
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
  end)

  it("each connector is evaluated at most once a step", function()
    local asked = 0
    local members = { b = state {}, tr "a -> k1 e" }
    local function guard() asked = asked + 1 end
    for i = 1, 30 do
      members["k" .. i] = conn {}
      local way = ("k%d -> k%d"):format(i, i < 30 and i + 1 or 1) -- a dead end, at last
      members[#members + 1] = tr(way, { guard = guard, pn = 1 })
      members[#members + 1] = tr(way, { guard = guard })
    end
    assert.equal("root.a", leaf_after(started(members), "e"))
    assert.equal(60, asked)
  end)
end)

describe("FIX surroundings:", function()
  local function failing() error("on purpose", 0) end

  for name, leaf in pairs { getevents = "root.a", pre_step_hook = "root.a",
    post_step_hook = "root.b", dbg = "root.a" } do -- any order: each stands alone
    it("a failing " .. name .. " reaches the caller, and no event is lost", function()
      local fsm = started { b = state {}, tr "a -> b e" }
      fsm[name] = failing
      local ok, problem = pcall(function()
        rfsm.send_events(fsm, "e")
        rfsm.step(fsm)
      end)
      assert.same({ false, "on purpose" }, { ok, problem })
      if name ~= "dbg" then assert.equal(leaf, rfsm.get_actleaf_fqn(fsm)) end
      fsm[name] = nil
      assert.is_true(rfsm.run(fsm))
      assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    end)
  end

  it("a failing err does not stop a transition", function()
    local fsm = started { b = state { entry = failing }, tr "a -> b e" }
    fsm.err = function() error("err failed", 0) end
    rfsm.send_events(fsm, "e")
    local ok, problem = pcall(rfsm.step, fsm)
    assert.same({ false, "err failed" }, { ok, problem })
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)

  it("a failing idle_hook finds the machine consistent", function()
    local fsm = started {}
    fsm.idle_hook = failing
    assert.is_false((pcall(rfsm.step, fsm, 2)))
    fsm.idle_hook = 1
    assert.same({ false, "rfsm.step: idle_hook: function expected, got number 1" },
      { pcall(rfsm.step, fsm, 2) })
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
  it("send_events skips nil and keeps the rest; getevents may return nil", function()
    local fsm = started {}
    rfsm.send_events(fsm, nil, "e1", nil, "e2", nil)
    assert.same({ "e1", "e2" }, fsm._intq)
    assert.is_true(rfsm.run(started { getevents = function() return nil end }))
  end)

  for _, name in ipairs({ "send_events", "step", "run", "reset", "check_events",
    "get_actleaf_fqn", "get_active_conf", "check_no_otrs", "machines", "prepare",
    "entry_hook_add", "entry_hook_rm", "exit_hook_add", "exit_hook_rm",
    "watch_hook_add", "watch_hook_rm", "pre_step_hook_add", "pre_step_hook_rm",
    "is_free", "post_step_hook_add", "post_step_hook_rm", "reset_hook_add",
    "reset_hook_rm", "waiting",
    "snapshot_hook_add", "reaction_hook_add", "place", "fsm_merge",
    "exit_state", "map_from_to",
    "node_find_enabled", "check_between_steps" }) do
    it(name .. " on what is no fsm blames the caller", function()
      local function call(...) rfsm[name](...) end -- two levels for the last
      local is_for_extensions = name == "check_between_steps"
      assert.equal("rfsm." .. name .. ": initialised fsm expected, got state "
        .. "(rfsm.init makes one of a state)",
        helper.refusal(is_for_extensions and call or rfsm[name], state {},
          is_for_extensions and "rfsm.check_between_steps" or nil))
    end)
  end

  for _, name in ipairs({ "pre_step_hook_add", "post_step_hook_add", "reset_hook_add" })
  do
    it(name .. " refuses what is no function, and another place", function()
      local fsm, where = started {}, "rfsm." .. name
      assert.equal(where .. ": function expected, got number 5",
        helper.refusal(rfsm[name], fsm, 5))
      assert.equal(where .. ": 'before' or 'after' expected, got string 'first'",
        helper.refusal(rfsm[name], fsm, print, "first"))
    end)
  end

  for _, name in ipairs({ "entry_hook_add", "exit_hook_add" }) do
    it(name .. " refuses what is no function or no state of the machine", function()
      local fsm, where = started {}, "rfsm." .. name
      assert.equal(where .. ": function expected, got nil",
        helper.refusal(rfsm[name], fsm, fsm.a))
      for _, value in ipairs({ "a", state {}, fsm[1] }) do
        assert.equal(where .. ": state of the fsm expected, " .. rfsm.got(value),
          helper.refusal(rfsm[name], fsm, value, print))
      end
    end)
  end

  it("snapshot_hook_add wants two functions", function()
    local fsm = started {}
    assert.equal("rfsm.snapshot_hook_add: function expected, got nil",
      helper.refusal(rfsm.snapshot_hook_add, fsm, "x", nil, print))
    assert.equal("rfsm.snapshot_hook_add: function expected, got table",
      helper.refusal(rfsm.snapshot_hook_add, fsm, "x", print, {}))
  end)

  it("is kept when there is no path from root.initial", function()
    local is_open = false
    local model = state { a = state {},
      tr("initial -> a", { guard = function() return is_open end }) }
    local errors = said(model, "err")
    local fsm = init(model)
    rfsm.send_events(fsm, "e")
    assert.is_false(rfsm.step(fsm))
    assert.same({ "e_init_fsm", "e" }, fsm._intq)
    assert.same({
      "ERROR: cannot enter: no enabled path from 'root.initial' on events: "
        .. "e_init_fsm, e",
    }, errors)
    is_open = true
    assert.equal("root.a", leaf_after(fsm))
  end)
end)

describe("an entry that is refused", function()
  it("leaves a machine as new when a guard resets it", function()
    local fsm
    fsm = init(state { err = false, a = state {},
      tr("initial -> a", { guard = function()
        rfsm.reset(fsm)
        return false
      end }) })
    rfsm.send_events(fsm, "e")
    assert.is_false(rfsm.step(fsm))
    assert.same({ "e_init_fsm" }, fsm._intq)
  end)

  for kind, hook in pairs { plain = false, ["with a hook"] = print } do -- any order
    it("ends a run after a doo that exits its state: " .. kind, function()
      local fsm = helper.started(state {
        err = false, post_step_hook = hook and function() end or nil,
        a = state {
          doo = function(fsm, self)
            rfsm.yield(true)
            rfsm.exit_state(fsm, self)
            rfsm.yield(true)
          end,
        },
        tr "initial -> a e_init_fsm",
      })
      assert.is_false(rfsm.run(fsm))
      assert.same({ "root" }, rfsm.get_active_conf(fsm))
    end)
  end
end)

describe("FIX step:", function()
  it("returns under constant unmatched events, with a doo cycle", function()
    local cycles = 0
    local fsm = init(chart {
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
    local left = 50000
    helper.post_and_run(started {
      b = state {
        entry = function(fsm)
          left = left - 1
          if left > 0 then rfsm.send_events(fsm, "e") end
        end,
      },
      tr "a -> b e", tr "b -> b e",
    }, "e")
    assert.equal(0, left)
  end)
end)

it("FIX reset: resets what extensions keep", function()
  local fsm, seen = started {}, {}
  rfsm.reset_hook_add(fsm, function(machine) seen[#seen + 1] = machine end)
  rfsm.reset(fsm)
  assert.equal(1, #seen)
  assert.equal(fsm, seen[1])
end)

describe("FIX copying:", function()
  it("one sub model, or one transition object, may be used twice", function()
    local back = tr "x -> x e"
    local sub = state { x = state {}, tr "initial -> x", back }
    local fsm = init(chart { a = sub, b = sub, c = state { x = state {}, back } })
    for _, name in ipairs { "a", "b" } do
      assert.equal(("root.%s.x"):format(name), fsm[name].x._fqn)
      assert.equal(fsm[name].x, fsm[name][1].tgt)
      assert.equal(fsm[name].x, fsm[name][2].src)
    end
    assert.equal(fsm.c.x, fsm.c[1].src)
  end)

  it("plain tables are copied, shared structure kept, all else is shared", function()
    local shared, object = { 1 }, setmetatable({}, {})
    local fsm = init(chart {
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
    local function marked(element)
      for name in ([[id fqn parent mode actchild doo_co otrs is_leaf sources choices
        ignored by_event by_any done_event search way entry_hooks exit_hooks lca entries
        run rank is_simple initialized nodes fsm at intq leaf def plan_ mine]])
        :gmatch("%S+") do
        element["_" .. name] = { "the user's" }
      end
      element["%data"] = 1
      return element
    end
    local trace, fsm = helper.traced(marked(state {
      a = marked(state {}), b = marked(state {}), k = marked(conn {}),
      marked(tr "initial -> a"), marked(tr "a -> k e"), marked(tr "k -> b"),
    }))
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e")
    assert.same({ "effect root.initial->root.a", "entry root.a",
      "exit root.a", "effect root.a->root.k", "effect root.k->root.b", "entry root.b" },
      trace)
    for _, part in ipairs { fsm.a, fsm[2] } do
      for name in ("_def _plan_ _run _lca _leaf _entries _mine")
        :gmatch("%S+") do assert.same({ "the user's" }, part[name]) end
      assert.equal(1, part["%data"])
    end
  end)

  it("init of an initialised fsm gives a fresh instance of its model", function()
    local fsm = started {}
    local fresh = init(fsm)
    assert.not_equal(fsm, fresh)
    assert.is_false(rfsm.get_actleaf_fqn(fresh))
    assert.equal("root.a", leaf_after(fresh))
  end)

  it("an initialised fsm as a child means its model", function()
    local fsm = started { a = started { x = state {} } }
    assert.equal("root.a.a", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("FIX load:", function()
  it("no file name is an error, not stdin", function()
    assert.equal("rfsm.load: file name expected, got nil", helper.refusal(rfsm.load))
  end)

  it("load_str says what is wrong with the text", function()
    local function problem_of(text) return (select(2, pcall(rfsm.load_str, text))) end
    assert.matches("^rfsm.load_str: failed to load chunk: ", problem_of("return {"))
    assert.matches("^rfsm.load_str: no valid rfsm in 'string' found%.",
      problem_of("return 1"))
    assert.is_true(rfsm.is_state(rfsm.load_str("return rfsm.state {}")))
  end)
end)

describe("FIX fsm_merge:", function()
  local function merged(parent, obj, id)
    local fsm = started { m = state { x = state {} } }
    local told = helper.said(fsm, "err")
    local ok, reason = rfsm.fsm_merge(fsm, parent and fsm[parent] or fsm, obj, id)
    return fsm, ok, reason, told
  end

  it("adds leaves, connectors and transitions in their place of the order", function()
    local fsm, ok = merged(nil, state {}, "new")
    assert.same({ true, "root.new" }, { ok, fsm.new._fqn })
    fsm, ok = merged("m", conn {}, "k")
    assert.same({ true, "root.m.k" }, { ok, fsm.m.k._fqn })
    fsm, ok = merged(nil, tr("a -> .m.x e", { pn = 5 }))
    assert.same({ true, "root.m.x" }, { ok, leaf_after(fsm, "e") })
  end)

  it("adds a composite, which can be entered like any other", function()
    local fsm = merged(nil, state { y = state {}, tr "initial -> y" }, "new")
    assert.is_true((rfsm.fsm_merge(fsm, fsm, tr "a -> new e")))
    assert.equal("root.new.y", leaf_after(fsm, "e"))
  end)

  it("changes nothing when it cannot, and says why, to err as well", function()
    for text, arguments in pairs { -- any order: each stands alone
      ["the model has 1 problem\n  root.trans[2] (a -> nowhere): tgt 'nowhere': no "
        .. "state or connector is named 'nowhere' in 'root' (there are 'a', 'initial', "
        .. "'m')"] = { nil, tr "a -> nowhere" },
      ["'root' has a member 'm' already"] = { nil, state {}, "m" },
      ["a state needs a name"] = { nil, state {} },
      ["state, transition or connector expected, got table"] = { nil, {}, "x" },
      ["'root.a' is an active leaf state"] = { "a", state {}, "x" },
    } do
      local fsm, ok, reason, told = merged(arguments[1], arguments[2], arguments[3])
      assert.is_false(ok)
      assert.same({ reason }, told)
      assert.equal("rfsm.fsm_merge: " .. text, helper.without_file(reason))
      assert.same({}, { fsm[2], fsm.x, fsm.a.x })
    end
  end)
end)

it("FIX mapfsm: parents before children, array part first, then names, to a depth",
  function()
    local model = state {
      b = state { d = conn {}, c = state {} }, a = state {},
      tr "a -> b", t = tr "b -> a",
    }
    local function name_of(_, _, name) return name end
    assert.same({ 1, "a", "b", "c", "d", "t" }, rfsm.mapfsm(name_of, model))
    assert.same({ "a", "b" }, rfsm.mapfsm(name_of, model, rfsm.is_node, 1))
  end)

it("each element is printed as what it is", function()
  local model = state {
    info = false, warn = false, a = state { c = state {},
      trans { src = "initial", tgt = "c" } }, k = rfsm.conn {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "k", events = { "e", 1 }, pn = 2 },
    trans { src = "k", tgt = "a", events = "x" },
  }
  local fsm = assert(rfsm.init(model))
  local texts = { tostring(fsm), tostring(fsm.a) }
  rfsm.run(fsm)
  for _, value in ipairs { fsm, fsm.a, fsm.a.c, fsm.k, fsm[2], fsm[3], model.a, model.k,
    model[2], model[3], trans { src = model.a, tgt = {} } } do
    texts[#texts + 1] = tostring(value):gsub("table: .*'", "a table'")
  end
  assert.same({
    "machine, active: <none>", "state root.a (inactive)", "machine, active: root.a.c",
    "state root.a (active)", "state root.a.c (done)", "connector root.k",
    "T={ src='root.a', tgt='root.k', pn=2, events='e, 1' }",
    "T={ src='root.k', tgt='root.a.initial', events='x' }",
    "state", "connector", "T={ src='a', tgt='k', pn=2, events='e, 1' }",
    "T={ src='k', tgt='a', events='x' }", "T={ src='state', tgt='a table' }",
  }, texts)
end)

it("each kind of element has its letters", function()
  local letters = {}
  local values = { state { a = state {} }, state {}, trans {}, conn {}, {}, "c" }
  for i, value in ipairs(values) do
    letters[i] = rfsm.fsmobj_tochar(value) or "none"
  end
  assert.same({ "CS", "LS", "TR", "c", "none", "none" }, letters)
end)

it("an element of a machine stays what it is when a constructor gets it", function()
  local fsm = started { k = conn {} }
  for _, element in ipairs { fsm, fsm.a, fsm.k, fsm[1] } do
    local class = getmetatable(element)
    for _, constructor in ipairs { state, trans, conn } do
      assert.equal(element, constructor(element))
      assert.equal(class, getmetatable(element))
    end
  end
end)

describe("what is no function", function()
  for _, name in ipairs { "entry", "exit", "guard", "effect" } do
    it("is reported as such when it is called as " .. name, function()
      local fsm = started { b = state {}, tr "a -> b e" }
      local errors = said(fsm, "err")
      local owner = name == "entry" and fsm.b or name == "exit" and fsm.a or fsm[1]
      owner[name] = 5
      helper.post_and_run(fsm, "e")
      assert.equal(1, #errors)
      assert.matches(": %s+function expected, got number 5$", errors[1])
    end)
  end

  it("cannot be what getevents returns", function()
    for _, value in ipairs { 5, "e_a e_b", print, false } do
      local fsm = started {}
      fsm.getevents = function() return value end
      local text = "rfsm.step: getevents: list of events expected, " .. rfsm.got(value)
      assert.has_error(function() rfsm.step(fsm) end, text)
      assert.has_error(function() rfsm.check_events(fsm) end, text)
    end
  end)
end)
