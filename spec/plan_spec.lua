-- Machines of one model share its plan, and nobody can tell.

local helper = require "spec.helper"
local rfsm = require "rfsm"

local conn, state, trans = rfsm.conn, rfsm.state, rfsm.trans

local function noting(trace, text) return function() trace[#trace + 1] = text end end

-- initial -> a --e_b--> k --> c.x,  c --e_a--> a; each program notes its name.
local function new_chart(trace)
  local function program(name) return noting(trace, name) end
  return state {
    info = false, warn = false, data = { 1, { 2 } }, n = 1,
    a = state { entry = program "entry a", exit = program "exit a", n = 2 },
    k = conn {},
    c = state {
      entry = program "entry c", exit = program "exit c",
      x = state { entry = program "entry x", exit = program "exit x" },
      trans { src = "initial", tgt = "x" },
    },
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "k", events = { "e_b" }, effect = program "effect" },
    trans { src = "k", tgt = "c", guard = program "guard" },
    trans { src = "c", tgt = "a", events = { "e_a" } },
  }
end

local ROUND = {
  "guard", "exit a", "effect", "entry c", "entry x", "exit x", "exit c", "entry a",
}

-- What a round from a to c and back notes.
local function round(fsm, trace)
  helper.clear(trace)
  helper.post_and_run(fsm, "e_b")
  helper.post_and_run(fsm, "e_a")
  local copy = {}
  for i, text in ipairs(trace) do copy[i] = text end
  return copy
end

-- The round with other texts in some places.
local function but(changes)
  local expected = {}
  for i, text in ipairs(ROUND) do expected[i] = changes[text] or text end
  return expected
end

local function two_machines()
  local trace = {}
  local model = new_chart(trace)
  local one, other = rfsm.init(model), rfsm.init(model)
  rfsm.run(one)
  rfsm.run(other)
  return one, other, trace, model
end

-- Each of them replaces one program of the machine; the name of the program.
local REPLACE = {
  ["exit a"] = function(fsm, f) fsm.a.exit = f end,
  ["effect"] = function(fsm, f) fsm[2].effect = f end,
  ["guard"] = function(fsm, f) fsm[3].guard = f end,
  ["entry c"] = function(fsm, f) fsm.c.entry = f end,
  ["entry x"] = function(fsm, f) fsm.c.x.entry = f end,
  ["exit x"] = function(fsm, f) fsm.c.x.exit = f end,
  ["exit c"] = function(fsm, f) fsm.c.exit = f end,
  ["entry a"] = function(fsm, f) fsm.a.entry = f end,
}

describe("machines of one model", function()
  it("stand where their own events led them", function()
    local one, other = two_machines()
    helper.post_and_run(one, "e_b")
    assert.equal("root.c.x", rfsm.get_actleaf_fqn(one))
    assert.equal("root.a", rfsm.get_actleaf_fqn(other))
    assert.equal("done", rfsm.get_sta_mode(one.c.x))
    assert.equal("inactive", rfsm.get_sta_mode(other.c.x))
  end)

  for name, replace in pairs(REPLACE) do -- any order: each stands alone
    it("do not meet when one gets another " .. name, function()
      local one, other, trace = two_machines()
      assert.same(ROUND, round(one, trace))
      replace(one, noting(trace, "new"))
      assert.same(ROUND, round(other, trace))
      assert.same(but { [name] = "new" }, round(one, trace))
      replace(one, nil)
      assert.equal(#ROUND - 1, #round(one, trace))
      assert.same(ROUND, round(other, trace))
    end)

    it("do not meet when the first one got another " .. name .. " before", function()
      local trace = {}
      local model = new_chart(trace)
      local one = rfsm.init(model)
      replace(one, noting(trace, "new"))
      local other = rfsm.init(model)
      rfsm.run(one)
      rfsm.run(other)
      assert.same(but { [name] = "new" }, round(one, trace))
      assert.same(ROUND, round(other, trace))
    end)

    for at, program in ipairs(ROUND) do
      local title = ("use another %s at once when %s sets it"):format(name, program)
      it(title, function()
        local one, other, trace = two_machines()
        local is_set = false
        REPLACE[program](one, function()
          trace[#trace + 1] = program
          if not is_set then replace(one, noting(trace, "new")) end
          is_set = true
        end)
        local expected = but {}
        for i = at + 1, #ROUND do
          if ROUND[i] == name then expected[i] = "new" end
        end
        assert.same(expected, round(one, trace))
        assert.same(but { [name] = "new" }, round(one, trace))
        assert.same(ROUND, round(other, trace))
      end)
    end
  end

  it("run a new doo each", function()
    local one, other, trace = two_machines()
    one.c.x.doo = noting(trace, "doo")
    helper.clear(trace)
    helper.post_and_run(one, "e_b")
    assert.same({ "guard", "exit a", "effect", "entry c", "entry x", "doo" }, trace)
    assert.same(ROUND, round(other, trace))
  end)

  it("have their own hooks of states", function()
    local one, other, trace = two_machines()
    rfsm.entry_hook_add(one, one.c, noting(trace, "entry hook"))
    rfsm.exit_hook_add(one, one.c.x, noting(trace, "exit hook"))
    assert.same({
      "guard", "exit a", "effect", "entry hook", "entry c", "entry x", "exit x",
      "exit hook", "exit c", "entry a",
    }, round(one, trace))
    assert.same(ROUND, round(other, trace))
  end)

  it("are merged into one by one", function()
    local one, other = two_machines()
    assert.is_true(rfsm.fsm_merge(one, one, state {}, "d"))
    assert.is_true(rfsm.fsm_merge(one, one, trans {
      src = "a", tgt = "d", events = { "e_d" },
    }))
    helper.post_and_run(one, "e_d")
    helper.post_and_run(other, "e_d")
    assert.equal("root.d", rfsm.get_actleaf_fqn(one))
    assert.equal("root.a", rfsm.get_actleaf_fqn(other))
    assert.is_nil(other.d)
  end)

  it("have their own copies of plain tables, asked for or not", function()
    local one, other, _, model = two_machines()
    model.data[2][1] = "changed in the model"
    one.data[1] = "changed in one"
    assert.same({ "changed in one", { 2 } }, one.data)
    assert.same({ 1, { 2 } }, other.data)
    one.a.n = 3
    assert.equal(2, other.a.n)
  end)

  it("report the same of their model", function()
    local said = {}
    local model = state {
      a = state {}, trans { src = "initial", tgt = "a", events = { "e" } },
      warn = function(text) said[#said + 1] = text end,
      info = function(text) said[#said + 1] = text end,
    }
    rfsm.init(model)
    local first = table.concat(said, "\n")
    helper.clear(said)
    rfsm.init(model)
    assert.equal(first, table.concat(said, "\n"))
    assert.equal(3, #said)
  end)

  it("may each be changed by preproc functions", function()
    local count = 0
    local function rename(fsm)
      count = count + 1
      if count ~= 2 then return end
      fsm[2].events[1] = "e_other"
      fsm[4].events = "e_back"
      fsm.a.entry = nil
    end
    table.insert(rfsm.preproc, rename)
    local trace = {}
    local model = new_chart(trace)
    local machines = { rfsm.init(model), rfsm.init(model), rfsm.init(model) }
    table.remove(rfsm.preproc)
    for _, fsm in ipairs(machines) do rfsm.run(fsm) end
    assert.same(ROUND, round(machines[1], trace))
    assert.same({}, round(machines[2], trace))
    assert.same({ "e_other" }, machines[2][2].events)
    helper.post_and_run(machines[2], "e_other")
    helper.post_and_run(machines[2], "e_back")
    assert.equal("exit c", trace[#trace])
    assert.same(ROUND, round(machines[3], trace))
  end)

  it("are made of what the model is when they are", function()
    local trace = {}
    local function change(model, path, key, value)
      for name in path:gmatch("[^.]+") do model = model[tonumber(name) or name] end
      model[key] = value
    end
    local changes = {
      { "a", "entry", noting(trace, "new") }, { "c.x", "exit", noting(trace, "new") },
      { "a", "entry", nil }, { "2", "effect", noting(trace, "new") },
      { "3", "guard", function() return false end }, { "2", "events", { "e_x" } },
      { "2", "events", "e_a" }, { "2.events", 1, "e_x" }, { "2.events", 2, "e_a" },
      { "4", "events", nil }, { "2", "tgt", "c" }, { "4", "src", "c.x" },
      { "", "d", state { entry = noting(trace, "d") } }, { "", "n", 5 },
      { "", 5, trans { src = "a", tgt = "c", events = { "e_b" }, pn = 1 } },
      { "2", "pn", 3 }, { "", "k", state { entry = noting(trace, "k") } },
      { "c", "doo", noting(trace, "doo") }, { "", "data", { 3 } },
    }
    for _, edit in ipairs(changes) do
      local model = new_chart(trace)
      local old = rfsm.init(model)
      change(model, edit[1], edit[2], edit[3])
      local plain = new_chart(trace)
      change(plain, edit[1], edit[2], edit[3])
      model.err, plain.err = false, false
      local function behaviour(chart)
        local fsm = rfsm.init(chart)
        if not fsm then return "refused" end
        rfsm.run(fsm)
        return { round(fsm, trace), rfsm.get_actleaf_fqn(fsm), fsm.n, fsm.data }
      end
      local place = edit[1] .. "." .. edit[2]
      assert.same({ place, behaviour(plain) }, { place, behaviour(model) })
      rfsm.run(old)
      assert.same(ROUND, round(old, trace))
    end
  end)

  it("do not keep models alive that nobody uses", function()
    local models = setmetatable({}, { __mode = "k" })
    for i = 1, 20 do
      local model = new_chart({})
      models[model] = i
      rfsm.run((rfsm.init(model)))
      rfsm.init(model)
    end
    collectgarbage()
    collectgarbage()
    local count = 0
    for _ in pairs(models) do count = count + 1 end -- any order: only counted
    assert.is_true(count <= 1, count .. " of 20 are left")
  end)
end)

describe("the parts of a machine", function()
  it("are there before anything ran, always the same", function()
    local fsm = rfsm.init(new_chart({}))
    assert.equal(fsm.c.x, fsm.c.x)
    assert.equal(fsm, fsm.c.x._parent._parent)
    assert.equal(fsm.c.initial, fsm[3].tgt)
    assert.equal("T={ src='root.a', tgt='root.k', events='e_b' }", tostring(fsm[2]))
    local names = rfsm.mapfsm(function(node) return node._fqn end, fsm, rfsm.is_node)
    assert.same({ "root.a", "root.c", "root.c.initial", "root.c.x", "root.initial",
      "root.k" }, names)
    assert.is_true(rfsm.is_composite(fsm) and rfsm.is_composite(fsm.c))
    assert.is_true(rfsm.is_leaf(fsm.a))
  end)

  it("tell where the machine stands, and take no other answer", function()
    local fsm = rfsm.init(new_chart({}))
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_b")
    fsm.c._actchild, fsm.c._parent = false, fsm.a
    assert.equal(fsm.c.x, fsm.c._actchild)
    assert.equal(fsm, fsm.c._parent)
  end)

  it("may be put into a mode without a program, for tools", function()
    local trace = {}
    local fsm = rfsm.init(new_chart(trace))
    rfsm.run(fsm)
    helper.clear(trace)
    rfsm.set_sta_mode(fsm.c.x, "active")
    assert.same({ "root", "root.c", "root.c.x" }, rfsm.get_active_conf(fsm))
    assert.equal("inactive", rfsm.get_sta_mode(fsm.a))
    rfsm.set_sta_mode(fsm.c.x, "done")
    assert.equal("done", fsm.c.x._mode)
    rfsm.set_sta_mode(fsm.c, "inactive")
    assert.same({ "root" }, rfsm.get_active_conf(fsm))
    assert.same({}, trace)
    rfsm.set_sta_mode(fsm.c.x, "active")
    helper.post_and_run(fsm, "e_a")
    assert.same({ "exit x", "exit c", "entry a" }, trace)
  end)

  it("take no mode that is none", function()
    local fsm = rfsm.init(new_chart({}))
    local ok, problem = pcall(rfsm.set_sta_mode, fsm.a, "dead")
    assert.is_false(ok)
    assert.equal("rfsm.set_sta_mode: 'active', 'done' or 'inactive' expected, got "
      .. "string 'dead'", problem)
    ok, problem = pcall(rfsm.set_sta_mode, state {}, "active")
    assert.is_false(ok)
    assert.equal("rfsm.set_sta_mode: state of a fsm expected, got state", problem)
  end)

  it("take nothing for a program that cannot be called", function()
    local fsm = rfsm.init(new_chart({}))
    local function refusal(owner, key, value)
      local ok, problem = pcall(function() owner[key] = value end)
      assert.is_false(ok)
      return (problem:gsub("^[^:]*:%d+: ", ""))
    end
    assert.equal("entry: function expected, got number 5", refusal(fsm.a, "entry", 5))
    assert.equal("guard: function expected, got boolean",
      refusal(fsm[2], "guard", true))
    assert.equal("doo: function expected, got string 'x'", refusal(fsm, "doo", "x"))
    assert.equal("getevents: function expected, got table",
      refusal(fsm, "getevents", {}))
    assert.equal("dbg: function, true or false expected, got string 'full'",
      refusal(fsm, "dbg", "full"))
  end)
end)
