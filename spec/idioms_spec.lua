-- What extensions, hosts and charts in the field do with models and live machines,
-- beside calling functions: they walk tables, wrap callbacks, write fields.

local helper = require "spec.helper"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"

local conn, state, trans = rfsm.conn, rfsm.state, rfsm.trans
local noting, with_preproc, leaf_after =
  helper.noting, helper.with_preproc, helper.leaf_after

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

after_each(helper.remove_files)

-- (initial) -> a --e_in--> c{ (initial) -> x --e_next--> y } --e_out--> (k) -> a
local function model(fields)
  local t = {
    warn = false, info = false,
    a = state {}, k = conn {},
    c = state {
      x = state {}, y = state {},
      trans { src = "initial", tgt = "x" },
      trans { src = "x", tgt = "y", events = { "e_next" } },
    },
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "c", events = { "e_in" } },
    trans { src = "c", tgt = "k", events = { "e_out" } },
    trans { src = "k", tgt = "a" },
  }
  for key, value in pairs(fields or {}) do t[key] = value end -- any order: a set
  return state(t)
end

local function started(fields) return helper.started(model(fields)) end

local function sorted(list)
  table.sort(list)
  return list
end

-- Names under which `t` holds what `pred` accepts, as `next` finds them.
local function names_of(t, pred)
  local names = {}
  local key, value = next(t)
  while key ~= nil do
    if pred(value) and not rfsm.is_meta(key) then names[#names + 1] = tostring(key) end
    key, value = next(t, key)
  end
  return table.concat(sorted(names), " ")
end

-- Marks tables in the way of other libraries; what `type` returns is a kind.
local function marked(kind, t)
  local class = { rfsm = true, type = function() return kind end }
  class.__index = class
  return setmetatable(t or {}, class)
end

local function name_of(_, _, name) return name end

describe("a walk over a live machine", function()
  it("finds nodes by name and transitions by number, in raw tables", function()
    local fsm, list = started(), {}
    assert.equal("a c initial k", names_of(fsm, rfsm.is_node))
    assert.equal("initial x y", names_of(fsm.c, rfsm.is_node))
    assert.equal("1 2 3 4", names_of(fsm, rfsm.is_trans))
    for i, tr in ipairs(fsm) do list[i] = tr == rawget(fsm, i) and tr end
    assert.same({ unpack(fsm) }, list)
    assert.same({ 4, 4 }, { #fsm, #list })
    assert.equal(fsm.c.x, rawget(rawget(fsm, "c"), "x"))
  end)

  it("finds nothing else but what begins with _, fields of a model, the user's",
    function()
      local fsm, others = started { speed = 3, a = state { colour = "red" } }, {}
      local FIELDS = {
        getevents = true, dbg = true, info = true, warn = true, err = true,
        speed = true, colour = true,
      }
      for _, t in ipairs { fsm, fsm.a, fsm.c } do
        for key, value in pairs(t) do
          if not (rfsm.is_meta(key) or rfsm.is_fsmobj(value) or FIELDS[key]) then
            others[#others + 1] = tostring(key)
          end
        end
      end
      assert.same({}, sorted(others))
    end)

  for _, uses in ipairs { 0, 5 } do
    it(("follows the active child until there is none, used %d times"):format(uses),
      function()
        local fsm, names = started(), {}
        for _ = 1, uses do
          helper.post_and_run(fsm, "e_in")
          helper.post_and_run(fsm, "e_out")
        end
        assert.equal(fsm.a, rfsm.actchild_get(fsm))
        for _, at in ipairs { fsm.a, fsm.c } do
          assert.same({},
            { at._actchild, rfsm.actchild_get(at), rawget(at, "_actchild") })
        end
        helper.post_and_run(fsm, "e_in")
        local at = fsm
        while at._actchild do
          at = at._actchild
          names[#names + 1] = at._id
        end
        assert.same({ "c", "x" }, names)
        rfsm.reset(fsm)
        assert.same({}, { fsm._actchild, rfsm.actchild_get(helper.init(model())) })
      end)
  end

  it("goes over mapfsm, with the root first as its own parent", function()
    local fsm = started()
    assert.same({ "root/root=", "root/a", "root/c", "c/x", "c/y" },
      rfsm.mapfsm(function(obj, up, name)
        return up._id .. "/" .. name .. (obj == up and "=" or "")
      end, fsm, rfsm.is_state))
    assert.same({ "a", "c", "initial", "x", "y", "initial", "k" },
      rfsm.mapfsm(name_of, fsm, rfsm.is_nr_node))
  end)

  it("goes over mapfsm in a plain table, too", function()
    local t = { b = state { x = state {} }, trans {}, a = state {}, n = 3, l = { 1 } }
    assert.same({ 1, "a", "b", "x" }, rfsm.mapfsm(name_of, t))
    assert.same({ "a", "b", "x" }, rfsm.mapfsm(name_of, t, rfsm.is_state))
  end)

  it("has a list of results from map_from_to", function()
    local fsm = started()
    local function fqn_of(_, node) return node._fqn end
    assert.same({ "root.c.x", "root.c", "root" },
      rfsm.map_from_to(fsm, fqn_of, fsm.c.x, fsm))
    assert.same({ "root.c", "root.c.x" }, rfsm.map_from_to(fsm, fqn_of, fsm.c, fsm.c.x))
    assert.error_matches(function() rfsm.map_from_to(fsm, fqn_of, fsm.a, fsm.c) end,
      "'root.a' and 'root.c' are not on one line", 1, true)
  end)
end)

describe("the events of a transition", function()
  it("are a list after init, also if there are none", function()
    local fsm = helper.init(model())
    assert.same({ {}, { "e_in" } }, { fsm[1].events, fsm[2].events })
  end)
end)

describe("a preproc function", function()
  it("wraps the entries of all states, that of the root among them", function()
    local trace = {}
    local fsm = with_preproc(function(fsm)
      rfsm.mapfsm(function(s)
        local before = s.entry
        s.entry = function(...)
          trace[#trace + 1] = s._fqn
          if before then return before(...) end
        end
      end, fsm, rfsm.is_state)
    end, function() return started { a = state { entry = noting(trace, "own") } } end)
    helper.post_and_run(fsm, "e_in")
    assert.same({ "root", "root.a", "own", "root.c", "root.c.x" }, trace)
  end)

  it("rewrites events and wraps guards", function()
    local asked = 0
    local fsm = with_preproc(function(fsm)
      rfsm.mapfsm(function(tr)
        for i, event in ipairs(tr.events) do tr.events[i] = event .. "_2" end
        local guard = tr.guard
        tr.guard = function(...)
          asked = asked + 1
          if guard then return guard(...) end
        end
      end, fsm, function(obj)
        return rfsm.is_trans(obj) and obj.events and #obj.events > 0
      end)
    end, started)
    assert.equal("root.a", leaf_after(fsm, "e_in"))
    assert.equal("root.c.x", leaf_after(fsm, "e_in_2"))
    assert.equal(1, asked)
  end)

  local function rename(suffix)
    return function(fsm)
      for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
        for i, event in ipairs(tr.events) do tr.events[i] = event .. suffix end
        if tr.events[1] then tr.pn = (tr.pn or 0) + 1 end
      end
    end
  end

  it("makes of each machine what it makes of the first", function()
    local chart = model()
    local first = with_preproc(rename("_2"), function() return helper.init(chart) end)
    local second = with_preproc(rename("_2"), function() return helper.init(chart) end)
    local third = with_preproc(rename("_3"), function() return helper.init(chart) end)
    local fourth = helper.init(chart)
    local texts = {}
    for i, fsm in ipairs { first, second, third, fourth } do
      texts[i] = tostring(fsm[2]):match("tgt=(.*) }")
    end
    assert.same({
      "'root.c.initial', pn=1, events='e_in_2'",
      "'root.c.initial', pn=1, events='e_in_2'",
      "'root.c.initial', pn=1, events='e_in_3'",
      "'root.c.initial', events='e_in'",
    }, texts)
    assert.equal(getmetatable(first.a), getmetatable(second.a)) -- one structure
    assert.is_true(rfsm.fsm_merge(first, first, trans { src = "a", tgt = "k" }))
    assert.equal(texts[1], tostring(first[2]):match("tgt=(.*) }"))
    rfsm.run(second)
    helper.post_and_run(second, "e_in_2")
    assert.equal("root.c.x", rfsm.get_actleaf_fqn(second))
  end)

  -- Draws what the transitions between three states are to have.
  local function drawn(random)
    local changes = {}
    for i = 2, 7 do
      changes[i] = {
        events = random:pick { "e_1", { "e_2" }, { "e_1", "e_2" }, {} },
        pn = random:pick { false, 1, 2 }, src = random:pick { "a", "b", "k" },
        tgt = random:pick { "a", "b", "k" },
      }
    end
    return changes
  end

  -- Six transitions between them, with those changes or to be changed.
  local function ring(changes)
    local chart = state {
      info = false, warn = false, err = false, a = state {}, b = state {}, k = state {
        x = state {}, trans { src = "initial", tgt = "x" },
      },
      trans { src = "initial", tgt = "a" },
    }
    for i = 2, 7 do
      local change = changes and changes[i]
      chart[i] = change and trans { src = change.src, tgt = change.tgt,
        events = change.events, pn = change.pn or nil }
        or trans { src = "a", tgt = "b", events = "e_1" }
    end
    return chart
  end

  local function run_through(fsm)
    local names = {}
    rfsm.step(fsm, 3) -- a ring without events never ends
    for _, event in ipairs { "e_1", "e_2", "e_2", "e_1", "e_x", "e_1", "e_2", "e_1" } do
      rfsm.send_events(fsm, event)
      rfsm.step(fsm)
      names[#names + 1] = rfsm.get_actleaf_fqn(fsm)
    end
    return table.concat(names, " ")
  end

  -- More variants than are kept, in any order, some of them again and again.
  it("may change all of a transition, as if it had been written so", function()
    local random, chart, sets = new_random(7), ring(), {}
    for i = 1, 15 do sets[i] = drawn(random) end
    for _ = 1, 150 do
      local changes = random:pick(sets)
      local fsm = with_preproc(function(fsm)
        for i = 2, 7 do
          local tr, change = fsm[i], changes[i]
          tr.events = change.events
          tr.pn, tr.src, tr.tgt = change.pn, fsm[change.src], fsm[change.tgt]
        end
      end, function() return assert(rfsm.init(chart)) end)
      local written = assert(rfsm.init(ring(changes)))
      for i = 2, 7 do assert.equal(tostring(written[i]), tostring(fsm[i])) end
      assert.equal(run_through(written), run_through(fsm))
    end
  end)

  local WRONG = {
    { field = "events", value = 5, text = "got number 5" },
    { field = "events", value = { 0 / 0 }, text = "got table" },
    { field = "pn", value = "high", text = "got string 'high'" },
    { field = "pn", value = 0 / 0, text = "got number" },
    { field = "src", value = "a", text = "got string 'a'" },
    { field = "tgt", value = state {}, text = "got state" },
  }
  for _, case in ipairs(WRONG) do
    it(("is told of a wrong %s, %s"):format(case.field, case.text), function()
      local chart = ring()
      local result = with_preproc(function(fsm) fsm[3][case.field] = case.value end,
        function() return { rfsm.init(chart) } end)
      local text = result[2]
      assert.is_false(result[1])
      assert.matches(("root.trans[3] (a -> b): %s: set by a preproc function, %s")
        :format(case.field, case.text), text, 1, true)
      local fsm = assert(rfsm.init(chart))
      rfsm.run(fsm)
      assert.equal("root.b", leaf_after(fsm, "e_1"))
    end)
  end

  it("cannot aim at a composite without an entrance", function()
    local chart = state { info = false, warn = false, err = false, a = state {},
      b = state { c = state {} }, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b.c", events = "e" } }
    local result = with_preproc(function(fsm) fsm[2].tgt = fsm.b end,
      function() return { rfsm.init(chart) } end)
    assert.is_false(result[1])
    assert.matches("root.trans[2] (a -> b.c): tgt: the composite has no initial "
      .. "transition", result[2], 1, true)
  end)

  it("adds to the machine with fsm_merge, once, and sees that merged", function()
    local merged, calls = 0, 0
    local fsm = with_preproc(function() calls = calls + 1 end, function()
      return with_preproc(function(fsm)
        if fsm.z then return end
        merged = merged + 1
        assert(rfsm.fsm_merge(fsm, fsm, state {}, "z"))
        assert(rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "z", events = "e_z" }))
      end, started)
    end)
    assert.same({ 1, 3, 5 }, { merged, calls, #fsm })
    assert.equal("root.z", leaf_after(fsm, "e_z"))
  end)
end)

describe("a table of somebody else", function()
  it("with a true rfsm in its metatable is what its type says", function()
    assert.is_true(rfsm.is_state(marked "state"))
    assert.is_true(rfsm.is_trans(marked "transition"))
    assert.is_true(rfsm.is_conn(marked "connector"))
    assert.is_false(rfsm.is_fsmobj(marked "region"))
    assert.is_false(rfsm.is_state(setmetatable({}, { rfsm = true })))
    assert.is_true(rfsm.is_composite(marked("state", { a = marked "state" })))
  end)

  it("is refused if it is an element of another kind", function()
    for name, made in pairs { -- any order: each alone
      state = trans {}, trans = state {}, conn = state {}, named = "e_a" } do
      local _, text = pcall(function() local _ = rfsm[name](made, "e_b") end)
      assert.matches("^%S*idioms_spec.lua:%d+: rfsm." .. name .. ": [%w ]+ expected, "
        .. "got " .. (rfsm.kind_of(made) or "string 'e_a' and more") .. "$", text)
    end
  end)

  it("is refused with a class, which it would lose", function()
    local class = {}
    class.__index = class
    for _, name in ipairs { "state", "trans", "conn" } do
      for _, meta in ipairs { class, { __metatable = "mine" } } do
        local object = setmetatable({}, meta)
        local text = select(2, pcall(function() local _ = rfsm[name](object) end))
        assert.matches("^%S*idioms_spec.lua:%d+: rfsm." .. name .. ": plain table "
          .. "expected, got an object, whose class would be lost", text)
      end
    end
    local decoded = setmetatable({}, { __jsontype = "object" })
    assert.is_true(rfsm.is_state(state(decoded)))
  end)

  it("is a model, or a part of one", function()
    local trace = {}
    local fsm = started {
      a = marked("state", { entry = noting(trace, "a") }), k = marked "connector",
      [2] = marked("transition", { src = "a", tgt = "c", events = { "e_in" } }),
      c = marked("state", { x = state {}, trans { src = "initial", tgt = "x" } }),
    }
    assert.equal("root.c.x", leaf_after(fsm, "e_in"))
    assert.equal("root.a", leaf_after(fsm, "e_out"))
    assert.same({ "a", "a" }, trace)
  end)
end)

describe("base:new{...}", function()
  it("makes a state that inherits callbacks and data, and replaces some", function()
    local trace = {}
    local base = state { entry = noting(trace, "entry"), exit = noting(trace, "exit"),
      speed = 1 }
    local child = base:new { exit = noting(trace, "own exit"), colour = "red" }
    local grandchild = child:new { speed = 2 }
    assert.is_true(rfsm.is_state(child) and rfsm.is_state(grandchild))
    assert.equal("state", grandchild:type())
    local fsm = started { a = grandchild }
    helper.post_and_run(fsm, "e_in")
    assert.same({ "entry", "own exit" }, trace)
    assert.same({ 2, "red" }, { fsm.a.speed, fsm.a.colour })
    base.entry = noting(trace, "new entry")
    helper.clear(trace)
    started { a = grandchild }
    assert.same({ "new entry" }, trace)
  end)

  it("makes a transition that inherits", function()
    local base = trans { src = "a", events = { "e_in" } }
    local fsm = started { [2] = base:new { tgt = "c" } }
    assert.equal("root.c.x", leaf_after(fsm, "e_in"))
  end)
end)

describe("a field of a live machine", function()
  it("getevents is a function that returns a list, to be wrapped", function()
    local fsm = started()
    assert.same({}, fsm.getevents())
    local before, more = fsm.getevents, { "e_in" }
    fsm.getevents = function()
      local events = before()
      for i = #more, 1, -1 do events[#events + 1] = table.remove(more, i) end
      return events
    end
    assert.equal("root.c.x", leaf_after(fsm))
  end)

  it("post_step_hook or pre_step_hook set to nil removes it, and no other", function()
    for _, field in ipairs { "pre_step_hook", "post_step_hook" } do
      local calls = {}
      local fsm = started { [field] = noting(calls, "own") }
      rfsm[field .. "_add"](fsm, noting(calls, "added"))
      helper.clear(calls)
      fsm[field] = nil
      rfsm.send_events(fsm, "e_none")
      rfsm.step(fsm)
      assert.is_true(#calls > 0)
      assert.is_falsy(table.concat(calls):find("own"))
    end
  end)

  it("_intq is the queue, _act_leaf the leaf, events an array of strings", function()
    local fsm = started()
    rfsm.send_events(fsm, "e_x", "e_y")
    assert.equal(2, rfsm.check_events(fsm))
    assert.equal("e_x e_y", table.concat(fsm._intq, " "))
    assert.equal(fsm.a, fsm._act_leaf)
    assert.equal("e_in", table.concat(fsm[2].events, ","))
    assert.equal("root.a root.c.initial", fsm[2].src._fqn .. " " .. fsm[2].tgt._fqn)
  end)
end)
