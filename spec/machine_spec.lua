-- Machines of one model share its structure, and nobody can tell; what a machine is to
-- those who walk it and write into it.

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

-- How many keys of a weak table the collector leaves.
local function count_left(weak)
  collectgarbage()
  collectgarbage()
  local count = 0
  for _ in pairs(weak) do count = count + 1 end -- any order: only counted
  return count
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
      replace(one, false)
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
      fsm.a.entry = false
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

  it("may be changed by a preproc function after the first has run", function()
    local trace = {}
    local model = new_chart(trace)
    local one = rfsm.init(model)
    rfsm.run(one)
    assert.same(ROUND, round(one, trace))
    table.insert(rfsm.preproc, function(fsm)
      fsm.c.x.entry = noting(trace, "new")
      fsm[2].events = "e_done@root.a"
    end)
    local other = rfsm.init(model)
    table.remove(rfsm.preproc)
    helper.clear(trace)
    rfsm.run(other)
    assert.same({ "entry a", "guard", "exit a", "effect", "entry c", "new" }, trace)
    assert.same(ROUND, round(one, trace))
  end)

  it("show a preproc function what leaves each node", function()
    local model, lists = new_chart({}), {}
    table.insert(rfsm.preproc, function(fsm)
      lists[#lists + 1] = #fsm.a._otrs .. #fsm._otrs
    end)
    local one = rfsm.init(model)
    rfsm.run(one)
    rfsm.init(model)
    table.remove(rfsm.preproc)
    assert.same({ "10", "10" }, lists)
  end)

  it("tell what leaves a node as soon as one is changed", function()
    local one = two_machines()
    one.a.exit = nil
    assert.same({ one[2] }, one.a._otrs)
  end)

  it("stand where a tool put them when one is changed", function()
    local one = two_machines()
    rfsm.set_sta_mode(one.c, "active")
    one.a.exit = nil
    assert.same({ "root", "root.c" }, rfsm.get_active_conf(one))
    assert.equal("active", rfsm.get_sta_mode(one.c))
  end)

  it("start each doo, also when the exit before it changes one of them", function()
    for _, dbg in ipairs({ false, function() end }) do
      local trace = {}
      local function doo(name)
        return function()
          while true do
            trace[#trace + 1] = name
            rfsm.yield(true)
          end
        end
      end
      local model = new_chart(trace)
      model.a.doo, model.c.x.doo = doo "doo a", doo "doo x"
      local one, other = rfsm.init(model), rfsm.init(model)
      one.dbg = dbg
      one.a.exit = function(fsm) fsm.c.exit = noting(trace, "new") end
      rfsm.run(other)
      rfsm.run(one)
      helper.clear(trace)
      helper.post_and_run(one, "e_b")
      assert.same({ "guard", "effect", "entry c", "entry x", "doo x" }, trace)
    end
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
      { "2", "effect", nil }, { "a", "n", nil }, { "", "n", nil },
      { "", "d", { "a table" } }, { "c", "x", "no state" },
    }
    for _, edit in ipairs(changes) do
      local model = new_chart(trace)
      model.err = false
      local old = rfsm.init(model)
      change(model, edit[1], edit[2], edit[3])
      local plain = new_chart(trace)
      change(plain, edit[1], edit[2], edit[3])
      plain.err = false
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
    local count = count_left(models)
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
    assert.same({ "root", "root.a", "root.c", "root.c.initial", "root.c.x",
      "root.initial", "root.k" }, names)
    assert.is_true(rfsm.is_composite(fsm) and rfsm.is_composite(fsm.c))
    assert.is_true(rfsm.is_leaf(fsm.a))
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

  it("stay where they are in a mode that they have", function()
    local fsm = rfsm.init(new_chart({}))
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_b")
    rfsm.set_sta_mode(fsm.a, "inactive")
    rfsm.set_sta_mode(fsm.c, "active")
    assert.equal("root.c.x", rfsm.get_actleaf_fqn(fsm))
  end)

  it("are active, not done, when what was in them is inactive", function()
    local fsm = rfsm.init(new_chart({}))
    rfsm.run(fsm)
    assert.equal("done", rfsm.get_sta_mode(fsm.a))
    rfsm.set_sta_mode(fsm.a, "inactive")
    assert.equal("active", rfsm.get_sta_mode(fsm))
    rfsm.set_sta_mode(fsm, "inactive")
    assert.same({}, rfsm.get_active_conf(fsm))
    assert.equal("inactive", rfsm.get_sta_mode(fsm))
  end)

  it("are none of them active after reset, wherever the machine stood", function()
    local fsm = rfsm.init(new_chart({}))
    rfsm.run(fsm)
    rfsm.exit_state(fsm, fsm.a)
    assert.same({ "root" }, rfsm.get_active_conf(fsm))
    rfsm.reset(fsm)
    assert.same({}, rfsm.get_active_conf(fsm))
  end)

  it("complete in a mode that was set before they were ever entered", function()
    local fsm = helper.init(state {
      a = state {}, b = state {}, c = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "b", tgt = "c", events = { "e_done" } },
    })
    rfsm.set_sta_mode(fsm.b, "active")
    rfsm.step(fsm)
    assert.same({ "e_done@root.b" }, fsm._intq)
    rfsm.run(fsm)
    assert.equal("root.c", rfsm.get_actleaf_fqn(fsm))
  end)

  it("run a doo on, or anew, as the mode that was set wants it", function()
    local starts = {}
    local function start(_, self)
      starts[#starts + 1] = self._id
      while true do rfsm.yield(true) end
    end
    local fsm = helper.init(state {
      a = state { doo = start }, b = state { doo = start },
      trans { src = "initial", tgt = "a" },
    })
    rfsm.run(fsm)
    rfsm.set_sta_mode(fsm.a, "active")
    rfsm.run(fsm)
    assert.same({ "a" }, starts)
    rfsm.set_sta_mode(fsm.b, "active")
    rfsm.run(fsm)
    assert.same({ "a", "b" }, starts)
    rfsm.set_sta_mode(fsm.b, "inactive")
    helper.post_and_run(fsm, "e_init_fsm")
    assert.same({ "a", "b", "a" }, starts)
  end)

  it("have the coroutine of a doo while it is not at its end", function()
    for _, ending in ipairs({ function() end, error }) do
      local fsm = helper.init(state {
        err = false, b = state {},
        a = state {
          doo = function()
            rfsm.yield(true)
            ending()
          end,
        },
        trans { src = "initial", tgt = "a" },
      })
      assert.is_nil(fsm.a._doo_co)
      rfsm.step(fsm, 2)
      assert.equal("thread", type(fsm.a._doo_co))
      assert.is_nil(fsm.b._doo_co)
      rfsm.step(fsm)
      assert.is_nil(fsm.a._doo_co)
    end
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

  it("report a callback that cannot be called when it is called", function()
    local said = {}
    local fsm = rfsm.init(new_chart({}))
    fsm.err = function(id, text) said[#said + 1] = id .. " " .. text end
    fsm.a.entry, fsm[3].guard, fsm[2].effect = 5, true, "x"
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_b")
    assert.same({ "ENTRY error executing entry of root.a: ",
      "GUARD error executing guard of T={ src='root.k', tgt='root.c.initial' }: ",
    }, said)
    fsm[3].guard = false
    helper.post_and_run(fsm, "e_b")
    assert.equal("root.c.x", rfsm.get_actleaf_fqn(fsm))
    assert.equal("EFFECT error executing effect of T={ src='root.a', tgt='root.k', "
      .. "events='e_b' }: ", said[3])
  end)

  it("refuse a hook or printer that cannot be called when it is set", function()
    local fsm = rfsm.init(new_chart({}))
    local function refusal(key, value)
      local ok, problem = pcall(function() fsm[key] = value end)
      assert.is_false(ok)
      return (problem:gsub("^[^:]*:%d+: ", ""))
    end
    assert.equal("getevents: function expected, got table", refusal("getevents", {}))
    assert.equal("dbg: function, true or false expected, got string 'full'",
      refusal("dbg", "full"))
  end)
end)

describe("a transition through many states", function()
  -- The names of the states in `outer`, one in another, and the innermost of them.
  local function nest(outer, name, depth)
    local names = {}
    for i = 1, depth do
      local inner = state {}
      names[i] = name .. i
      outer[names[i]] = inner
      outer[1] = trans { src = "initial", tgt = names[i] }
      outer = inner
    end
    return names
  end

  it("runs all of their programs in order, and a new one at once", function()
    local a, b = state {}, state {}
    local in_a, in_b = nest(a, "a", 25), nest(b, "b", 25)
    local trace, fsm = helper.traced(state {
      a = a, b = b, trans { src = "initial", tgt = "a" },
      trans {
        src = "a", tgt = "b." .. table.concat(in_b, "."), events = { "e" },
      },
    })
    rfsm.run(fsm)
    fsm.a.exit = function(_, self)
      trace[#trace + 1] = "exit " .. self._fqn
      fsm.b.b1.entry = false
    end
    helper.clear(trace)
    local expected = {}
    local function expect(program, root, names, last)
      local name = root .. "." .. table.concat(names, ".", 1, last)
      expected[#expected + 1] = program .. " " .. (last > 0 and name or root)
    end
    for last = #in_a, 0, -1 do expect("exit", "root.a", in_a, last) end
    expected[#expected + 1] = "effect root.a->" .. fsm[2].tgt._fqn
    for last = 0, #in_b do
      if last ~= 1 then expect("entry", "root.b", in_b, last) end
    end
    helper.post_and_run(fsm, "e")
    assert.same(expected, trace)
  end)
end)

describe("events", function()
  it("have many transitions tried in order until a guard enables one", function()
    local asked = {}
    local model = state {
      a = state {}, b = state {}, trans { src = "initial", tgt = "a" },
    }
    for i = 2, 61 do
      model[i] = trans {
        src = "a", tgt = "b", events = { "e" },
        guard = function()
          asked[#asked + 1] = i
          return i == 60
        end,
      }
    end
    local fsm = helper.init(model)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e")
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    assert.equal(59, #asked)
    assert.equal(60, asked[59])
  end)

  it("that nobody waits for are forgotten", function()
    local fsm = helper.init(new_chart({}))
    rfsm.run(fsm)
    local events = setmetatable({}, { __mode = "k" })
    for i = 1, 20 do
      local event = {}
      events[event] = i
      helper.post_and_run(fsm, event)
    end
    local count = count_left(events)
    assert.is_true(count <= 1, count .. " of 20 are left")
  end)
end)

-- initial -> a --e_b--> b, with more members.
local function flat(members)
  local model = {
    info = false, warn = false, a = state {}, b = state {}, c = state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e_b" } },
  }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a set
  return state(model)
end

-- The second machine of a model, at rest.
local function second(model)
  rfsm.init(model)
  local fsm = rfsm.init(model)
  rfsm.run(fsm)
  return fsm
end

describe("a machine that shares a plan", function()
  it("leaves a doo behind that was taken away while it was busy", function()
    local trace = {}
    local fsm = second(flat {
      a = state { doo = function()
        while true do
          trace[#trace + 1] = "doo a"
          rfsm.yield(true)
        end
      end },
      b = state { doo = noting(trace, "doo b") },
    })
    fsm.a.doo = nil
    helper.post_and_run(fsm, "e_b")
    assert.same({ "doo a", "doo b" }, trace)
    assert.equal("done", rfsm.get_sta_mode(fsm.b))
  end)

  local function merge(fsm)
    if not fsm.is_ready or fsm.is_merged then return end
    fsm.is_merged = true
    assert(rfsm.fsm_merge(fsm, fsm, trans { src = "b", tgt = "c", events = { "e_c" } }))
  end

  local MERGE = {
    entry = { b = state { entry = merge } }, exit = { a = state { exit = merge } },
    effect = { [2] = trans {
      src = "a", tgt = "b", events = { "e_b" }, effect = merge,
    } },
    ["post step hook"] = { post_step_hook = merge },
    ["pre step hook"] = { pre_step_hook = merge },
  }

  for where, members in pairs(MERGE) do -- any order: each stands alone
    it("is merged into by its own program, the place: " .. where, function()
      local fsm = second(flat(members))
      fsm.is_ready = true
      helper.post_and_run(fsm, "e_b")
      assert.same({ "root", "root.b" }, rfsm.get_active_conf(fsm))
      assert.equal("done", rfsm.get_sta_mode(fsm.b))
      helper.post_and_run(fsm, "e_c")
      assert.equal("root.c", rfsm.get_actleaf_fqn(fsm))
    end)
  end

  it("takes another target from the next search on, no other value", function()
    local said = {}
    local fsm = second(flat())
    fsm.err = function(text) said[#said + 1] = text end
    for _, tgt in ipairs({ "b", 5, false, state {}, flat(), second(flat()).c }) do
      fsm[2].tgt = tgt
      helper.post_and_run(fsm, "e_b")
      assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
    end
    assert.equal(6, #said)
    assert.equal("ERROR: tgt of root.a: node of the fsm expected, got string 'b'",
      said[1])
    fsm[2].tgt = fsm.c
    helper.post_and_run(fsm, "e_b")
    assert.equal("root.c", rfsm.get_actleaf_fqn(fsm))
  end)

  it("goes on with a transition whose program asks what others would do", function()
    local trace = {}
    local fsm = second(flat())
    fsm[2].effect = function()
      fsm.b.entry = noting(trace, "new entry")
      rfsm.node_find_enabled(fsm, fsm.a, { "e_b" })
    end
    helper.post_and_run(fsm, "e_b")
    assert.same({ "new entry" }, trace)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)

  it("names the root alone while a leaf is left", function()
    local conf
    local fsm = second(flat { a = state { exit = function(fsm)
      conf = rfsm.get_active_conf(fsm)
    end } })
    helper.post_and_run(fsm, "e_b")
    assert.same({ "root" }, conf)
  end)

  it("is entered anew when a step hook makes its leaf inactive", function()
    for _, dbg in ipairs { false, function() end } do
      local fsm = second(flat())
      fsm.dbg = dbg
      fsm.pre_step_hook = function()
        fsm.pre_step_hook = nil
        rfsm.set_sta_mode(fsm.a, "inactive")
      end
      helper.post_and_run(fsm, "e_b")
      assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
    end
  end)

  it("lists what leaves a node as it is now", function()
    local fsm = second(flat())
    assert.equal(1, #fsm.a._otrs)
    assert.equal(fsm.a._otrs, fsm.a._otrs)
    rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "c", events = { "e_c" }, pn = 1 })
    assert.same({ fsm[3], fsm[2] }, fsm.a._otrs)
    assert.same({}, fsm.c._otrs)
  end)

  it("asks a guard that an earlier one has set", function()
    local trace = {}
    local fsm = second(flat {
      [3] = trans { src = "a", tgt = "c", events = { "e_b" } },
    })
    fsm[2].guard = function()
      trace[#trace + 1] = "guard"
      fsm[3].guard = function()
        trace[#trace + 1] = "new guard"
        return false
      end
      return false
    end
    helper.post_and_run(fsm, "e_b")
    assert.same({ "guard", "new guard" }, trace)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
  end)

  it("leaves others their events when preproc changes its own", function()
    local model = flat()
    local one = second(model)
    local function rename(fsm) fsm[2].events[1] = "e_other" end
    table.insert(rfsm.preproc, rename)
    local other = rfsm.init(model)
    table.remove(rfsm.preproc)
    rfsm.run(other)
    for _, fsm in ipairs { one, other } do helper.post_and_run(fsm, "e_b") end
    assert.equal("root.b", rfsm.get_actleaf_fqn(one))
    assert.equal("root.a", rfsm.get_actleaf_fqn(other))
    helper.post_and_run(other, "e_other")
    assert.equal("root.b", rfsm.get_actleaf_fqn(other))
  end)

  it("counts a transition without events or pn that preproc made one", function()
    local function open(fsm) fsm[2].events, fsm[2].pn = nil, nil end
    table.insert(rfsm.preproc, open)
    local fsm = second(flat { [2] = trans {
      src = "a", tgt = "b", events = { "e_b" }, pn = 5,
    } })
    table.remove(rfsm.preproc)
    helper.post_and_run(fsm, "anything")
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    assert.equal("T={ src='root.a', tgt='root.b' }", tostring(fsm[2]))
  end)

  it("runs a hook of a state once when it replaces a program", function()
    local trace = {}
    local fsm = second(flat {
      a = state { exit = noting(trace, "exit a") },
      b = state { entry = noting(trace, "entry b") },
    })
    local function hook(name)
      return function()
        trace[#trace + 1] = name
        fsm.b.entry = noting(trace, "new entry b")
      end
    end
    rfsm.exit_hook_add(fsm, fsm.a, hook "exit hook")
    rfsm.entry_hook_add(fsm, fsm.b, hook "entry hook")
    helper.post_and_run(fsm, "e_b")
    assert.same({ "exit a", "exit hook", "entry hook", "new entry b" }, trace)
  end)

  it("is traced from where a hook of a state switches dbg on", function()
    local trace = {}
    local fsm = second(flat {
      m = state { x = state {}, trans { src = "initial", tgt = "x" } },
      [2] = trans { src = "a", tgt = "m", events = { "e_b" } },
    })
    rfsm.entry_hook_add(fsm, fsm.m, function()
      fsm.dbg = function(id, what)
        if id:find("STATE", 1, true) then trace[#trace + 1] = id .. " " .. what end
      end
    end)
    rfsm.send_events(fsm, "e_b")
    rfsm.step(fsm)
    assert.same({ "STATE_ENTER root.m", "STATE_ENTER root.m.x" }, trace)
  end)

  it("keeps the user's data whatever its name is", function()
    local fsm = second(flat {
      a = state { _def = 1, _fsm = 2, _leaf = 3, _choices = { 4 }, _mine = 5 },
      [2] = trans {
        src = "a", tgt = "b", events = { "e_b" }, _entries = { 1 }, _run = 6, _lca = 7,
      },
      _at = 8, _intq = 9,
    })
    helper.post_and_run(fsm, "e_b")
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    assert.same({ 3, { 4 }, 5 }, { fsm.a._leaf, fsm.a._choices, fsm.a._mine })
    assert.same({ { 1 }, 6, 7 }, { fsm[2]._entries, fsm[2]._run, fsm[2]._lca })
  end)
end)

describe("fsm_merge", function()
  local function reason(...)
    local fsm = second(flat { m = state {
      x = state {}, trans { src = "initial", tgt = "x" },
    } })
    return (select(2, rfsm.fsm_merge(fsm, ...)))
  end

  it("puts no state into itself", function()
    local fsm = second(flat { m = state {
      x = state {}, trans { src = "initial", tgt = "x" },
    } })
    assert.equal("rfsm.fsm_merge: 'root.m' cannot contain itself",
      select(2, rfsm.fsm_merge(fsm, fsm.m, fsm.m, "y")))
    assert.equal("rfsm.fsm_merge: a name expected, got NaN",
      select(2, rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "b" }, 0 / 0)))
    assert.equal("rfsm.fsm_merge: parent: a state of the fsm expected, got state",
      reason(state {}, state {}, "z"))
  end)
end)
