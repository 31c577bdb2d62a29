-- What extensions, hosts and charts in the field do with models and live machines,
-- beside calling functions: they walk tables, wrap callbacks, write fields.

local helper = require "spec.helper"
local rfsm = require "rfsm"

local conn, state, trans = rfsm.conn, rfsm.state, rfsm.trans

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

local function started(fields)
  local fsm = helper.init(model(fields))
  rfsm.run(fsm)
  return fsm
end

-- Runs `f` with `preproc` among the preproc functions.
local function with_preproc(preproc, f)
  table.insert(rfsm.preproc, preproc)
  local ok, result = pcall(f)
  table.remove(rfsm.preproc)
  if not ok then error(result, 0) end
  return result
end

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
  return sorted(names)
end

describe("a walk over a live machine", function()
  it("finds nodes by name and transitions by number", function()
    local fsm = started()
    assert.same({ "a", "c", "initial", "k" }, names_of(fsm, rfsm.is_node))
    assert.same({ "initial", "x", "y" }, names_of(fsm.c, rfsm.is_node))
    assert.same({ "1", "2", "3", "4" }, names_of(fsm, rfsm.is_trans))
    assert.equal(4, #fsm)
    local count = 0
    for i, tr in ipairs(fsm) do
      count = count + 1
      assert.equal(tr, rawget(fsm, i))
    end
    assert.equal(4, count)
    assert.equal(fsm[2], (select(2, unpack(fsm))))
    assert.equal(fsm.c, rawget(fsm, "c"))
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

  it("follows the active child until there is none, which is nil", function()
    local fsm = started()
    assert.equal(fsm.a, rfsm.actchild_get(fsm))
    assert.is_nil(fsm.a._actchild)
    assert.is_nil(rfsm.actchild_get(fsm.a))
    assert.is_nil(rfsm.actchild_get(fsm.c))
    helper.post_and_run(fsm, "e_in")
    local names, at = {}, fsm
    while at._actchild do
      at = at._actchild
      names[#names + 1] = at._id
    end
    assert.same({ "c", "x" }, names)
    assert.is_nil(rfsm.actchild_get(helper.init(model())))
  end)

  it("goes over mapfsm, with the root first as its own parent", function()
    local fsm, seen = started(), {}
    rfsm.mapfsm(function(obj, parent, name)
      seen[#seen + 1] = parent._id .. "/" .. name .. (obj == parent and "=" or "")
    end, fsm, rfsm.is_state)
    assert.same({ "root/root=", "root/a", "root/c", "c/x", "c/y" }, seen)
    seen = {}
    rfsm.mapfsm(function(_, _, name) seen[#seen + 1] = name end, fsm, rfsm.is_nr_node)
    assert.same({ "a", "c", "initial", "x", "y", "initial", "k" }, seen)
  end)

  it("goes over mapfsm in a plain table, too", function()
    local seen = {}
    rfsm.mapfsm(function(_, _, name) seen[#seen + 1] = name end,
      { b = state { x = state {} }, a = state {}, n = 3 }, rfsm.is_state)
    assert.same({ "a", "b", "x" }, sorted(seen))
  end)

  it("has a list of results from map_from_to", function()
    local fsm = started()
    helper.post_and_run(fsm, "e_in")
    local list = rfsm.map_from_to(fsm, function(_, node) return node._fqn end, fsm.c.x,
      fsm)
    assert.same({ "root.c.x", "root.c", "root" }, list)
  end)

  it("has a path from node_find_enabled, in segments", function()
    local fsm = started()
    helper.post_and_run(fsm, "e_in")
    local path, texts = rfsm.node_find_enabled(fsm, fsm.c, { "e_out" }), {}
    local at = path
    while at do
      texts[#texts + 1] = at.node._fqn
      at = at.nextl and at.nextl[1].next
    end
    assert.same({ "root.c", "root.k", "root.a" }, texts)
    assert.equal(fsm[3], path.nextl[1].trans)
    assert.is_falsy(rfsm.node_find_enabled(fsm, fsm.c, { "e_none" }))
    assert.equal("root.c.x", rfsm.get_actleaf_fqn(fsm))
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
    end, function()
      return helper.init(model { a = state { entry = function()
        trace[#trace + 1] = "own"
      end } })
    end)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_in")
    assert.same({ "root", "root.a", "own", "root.c", "root.c.x" }, trace)
  end)

  it("finds in _otrs the transitions that leave a node, if any", function()
    local counts = {}
    with_preproc(function(fsm)
      rfsm.mapfsm(function(node)
        counts[#counts + 1] = node._id .. #node._otrs
        for _, tr in ipairs(node._otrs) do assert.equal(node, tr.src) end
      end, fsm, rfsm.is_nr_node)
    end, function() return helper.init(model()) end)
    assert.equal("a1 c1 initial1 initial1 k1 x1 y0", table.concat(sorted(counts), " "))
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
    end, function() return helper.init(model()) end)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_in")
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
    helper.post_and_run(fsm, "e_in_2")
    assert.equal("root.c.x", rfsm.get_actleaf_fqn(fsm))
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

  it("adds to the machine with fsm_merge, once", function()
    local calls = 0
    local fsm = with_preproc(function(fsm)
      calls = calls + 1
      if fsm.z then return end
      assert(rfsm.fsm_merge(fsm, fsm, state {}, "z"))
      assert(rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "z", events = "e_z" }))
    end, function() return helper.init(model()) end)
    assert.is_true(calls < 5)
    assert.equal(5, #fsm)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_z")
    assert.equal("root.z", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("a table of somebody else", function()
  -- Marks tables in the way of other libraries; what `type` says is a kind.
  local function marked(kind, t)
    local class = { rfsm = true, type = function() return kind end }
    class.__index = class
    return setmetatable(t, class)
  end

  it("with a true rfsm in its metatable is what its type says", function()
    assert.is_true(rfsm.is_state(marked("state", {})))
    assert.is_true(rfsm.is_trans(marked("transition", {})))
    assert.is_true(rfsm.is_conn(marked("connector", {})))
    assert.is_false(rfsm.is_fsmobj(marked("region", {})))
    assert.is_true(rfsm.is_composite(marked("state", { a = marked("state", {}) })))
  end)

  it("is a model, or a part of one", function()
    local trace = {}
    local fsm = started {
      a = marked("state", { entry = function() trace[#trace + 1] = "a" end }),
      [2] = marked("transition", { src = "a", tgt = "c", events = { "e_in" } }),
    }
    helper.post_and_run(fsm, "e_in")
    assert.same({ "a" }, trace)
    assert.equal("root.c.x", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("a state made of another one", function()
  it("inherits its callbacks and data, and replaces some", function()
    local trace = {}
    local function note(text) return function() trace[#trace + 1] = text end end
    local base = state { entry = note "base in", exit = note "base out", speed = 3 }
    local fsm = started { a = base:new { exit = note "own out" } }
    helper.post_and_run(fsm, "e_in")
    assert.same({ "base in", "own out" }, trace)
    assert.equal(3, fsm.a.speed)
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
    rfsm.run(fsm)
    assert.equal("root.c.x", rfsm.get_actleaf_fqn(fsm))
  end)

  it("post_step_hook or pre_step_hook set to nil removes it, and no other", function()
    for _, field in ipairs { "pre_step_hook", "post_step_hook" } do
      local calls = {}
      local fsm = started { [field] = function() calls[#calls + 1] = "own" end }
      rfsm[field .. "_add"](fsm, function() calls[#calls + 1] = "added" end)
      helper.clear(calls)
      fsm[field] = nil
      rfsm.send_events(fsm, "e_none")
      rfsm.step(fsm)
      assert.is_true(#calls > 0)
      assert.is_falsy(table.concat(calls):find("own"))
    end
  end)

  it("entry, exit, doo, guard and effect are replaced by tools", function()
    local trace, fsm = {}, started()
    local function note(text) return function() trace[#trace + 1] = text end end
    fsm.a.exit, fsm[2].effect, fsm.c.entry = note "exit", note "effect", note "entry"
    fsm[2].guard, fsm.c.x.doo = note "guard", note "doo"
    helper.post_and_run(fsm, "e_in")
    assert.same({ "guard", "exit", "effect", "entry", "doo" }, trace)
    fsm.c.exit = nil
    helper.post_and_run(fsm, "e_out")
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
  end)

  it("tgt retargets a transition of a running machine", function()
    local fsm = started()
    helper.post_and_run(fsm, "e_in")
    fsm[2].tgt = fsm.c.y
    helper.post_and_run(fsm, "e_out")
    helper.post_and_run(fsm, "e_in")
    assert.equal("root.c.y", rfsm.get_actleaf_fqn(fsm))
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

describe("the file rfsm.lua", function()
  -- A fresh Lua that runs `loader`, then prints what a C++ host needs.
  local function output_of(loader)
    return helper.output_of(loader .. [[

print(type(rawget(_G, "rfsm")), package.loaded.rfsm == rfsm, require("rfsm") == rfsm)]])
  end

  local READ = [[
local file = assert(io.open("rfsm.lua"))
local text = file:read("*a")
file:close()
assert((loadstring or load)(text, "embedded"))()]]

  for what, loader in pairs { -- any order: two specs
    ["as a text"] = READ, ["by dofile"] = [[dofile "rfsm.lua"]],
  } do
    it("run " .. what .. " is the global and the module rfsm", function()
      assert.equal("table\ttrue\ttrue", output_of(loader))
    end)
  end
end)
