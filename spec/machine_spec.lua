-- Machines of one model share its structure, and nobody can tell; what a machine is to
-- those who walk it and write into it.

local helper = require "spec.helper"
local rfsm = require "rfsm"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local conn, state, trans = rfsm.conn, rfsm.state, rfsm.trans
local noting, leaf_after, with_preproc, said =
  helper.noting, helper.leaf_after, helper.with_preproc, helper.said

-- initial -> a --e_b--> k --> c.x,  c --e_a--> a; each callback notes its name.
local function new_chart(trace)
  local function callback(name) return noting(trace, name) end
  return state {
    info = false, warn = false, data = { 1, { 2 } }, n = 1,
    a = state { entry = callback "entry a", exit = callback "exit a", n = 2 },
    k = conn {},
    c = state {
      entry = callback "entry c", exit = callback "exit c",
      x = state { entry = callback "entry x", exit = callback "exit x" },
      trans { src = "initial", tgt = "x" },
    },
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "k", events = { "e_b" }, effect = callback "effect" },
    trans { src = "k", tgt = "c", guard = callback "guard" },
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
  return helper.texts(unpack(trace))
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

-- Two machines of a chart, the trace of both, the model; `change` may change the first
-- before the other is made.
local function two_machines(change)
  local trace = {}
  local model = new_chart(trace)
  local one = rfsm.init(model)
  if change then change(one, trace) end
  local other = rfsm.init(model)
  rfsm.run(one)
  rfsm.run(other)
  return one, other, trace, model
end

-- Each of them replaces one callback of the machine; the name of the callback.
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
    assert.equal("root.c.x", leaf_after(one, "e_b"))
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
      local one, other, trace = two_machines(function(one, trace)
        replace(one, noting(trace, "new"))
      end)
      assert.same(but { [name] = "new" }, round(one, trace))
      assert.same(ROUND, round(other, trace))
    end)

    for at, callback in ipairs(ROUND) do
      it(("use another %s at once when %s sets it"):format(name, callback), function()
        local one, other, trace = two_machines()
        local is_set, expected = false, but {}
        REPLACE[callback](one, function()
          trace[#trace + 1] = callback
          if not is_set then replace(one, noting(trace, "new")) end
          is_set = true
        end)
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
    assert.equal("root.d", leaf_after(one, "e_d"))
    assert.equal("root.a", leaf_after(other, "e_d"))
    assert.is_nil(other.d)
  end)

  it("have their own copies of plain tables, asked for or not", function()
    local one, other, _, model = two_machines()
    model.data[2][1] = "changed in the model"
    one.data[1], one.a.n = "changed in one", 3
    assert.same({ "changed in one", { 2 } }, one.data)
    assert.same({ { 1, { 2 } }, 2 }, { other.data, other.a.n })
  end)

  it("report the same of their model", function()
    local model = state {
      a = state {}, trans { src = "initial", tgt = "a", events = { "e" } },
    }
    local warnings, infos = said(model, "warn"), said(model, "info")
    rfsm.init(model)
    rfsm.init(model)
    assert.same({ 4, 2 }, { #warnings, #infos })
    assert.same({ warnings[1], warnings[2] }, { warnings[3], warnings[4] })
    assert.equal(infos[1], infos[2])
  end)

  for changed = 1, 3 do
    it("may each be changed by preproc functions, number " .. changed, function()
      local count, trace, seen = 0, {}, {}
      local model = new_chart(trace)
      local machines = with_preproc(function(fsm)
        count = count + 1
        seen[count] = fsm[2].events[1]
        if count ~= changed then return end
        fsm[2].events[1] = "e_other"
        fsm[4].events = "e_back"
        fsm.a.entry = false
      end, function()
        return { rfsm.init(model), rfsm.init(model), rfsm.init(model) }
      end)
      for _, fsm in ipairs(machines) do rfsm.run(fsm) end
      for i, fsm in ipairs(machines) do
        assert.same(i == changed and {} or ROUND, round(fsm, trace))
        assert.same({ i == changed and "e_other" or seen[1] }, fsm[2].events)
        assert.equal(seen[1], seen[i])
      end
      helper.post_and_run(machines[changed], "e_other")
      helper.post_and_run(machines[changed], "e_back")
      assert.equal("exit c", trace[#trace])
    end)
  end

  it("may be changed by a preproc function after the first has run", function()
    local one, _, trace, model = two_machines()
    assert.same(ROUND, round(one, trace))
    local other = with_preproc(function(fsm)
      fsm.c.x.entry = noting(trace, "new")
      fsm[2].events = "e_done@root.a"
    end, function() return rfsm.init(model) end)
    helper.clear(trace)
    rfsm.run(other)
    assert.same({ "entry a", "guard", "exit a", "effect", "entry c", "new" }, trace)
    assert.same(ROUND, round(one, trace))
  end)

  it("have what leaves a node for preproc functions, and as soon as one is changed",
    function()
      local lists = {}
      local one = with_preproc(function(fsm)
        lists[#lists + 1] = #fsm.a._otrs .. #fsm._otrs
      end, two_machines)
      assert.same({ "10", "10" }, lists)
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
      return model
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
    local function behaviour(model)
      local fsm = rfsm.init(model)
      if not fsm then return "refused" end
      rfsm.run(fsm)
      return { round(fsm, trace), rfsm.get_actleaf_fqn(fsm), fsm.n, fsm.data }
    end
    for _, edit in ipairs(changes) do
      local model, plain = new_chart(trace), new_chart(trace)
      model.err, plain.err = false, false
      local old = rfsm.init(model)
      change(model, unpack(edit, 1, 3))
      change(plain, unpack(edit, 1, 3))
      local place = edit[1] .. "." .. edit[2]
      assert.same({ place, behaviour(plain) }, { place, behaviour(model) })
      rfsm.run(old)
      assert.same(ROUND, round(old, trace))
    end
  end)

  it("have the states that were plain tables when an earlier one was made", function()
    local model = new_chart({})
    model.late = {}
    rfsm.init(model)
    state(model.late) -- marks the table itself
    assert.equal("root.late", rfsm.init(model).late._fqn)
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
  local trace, fsm

  before_each(function()
    trace = {}
    fsm = rfsm.init(new_chart(trace))
  end)

  it("are there before anything ran, always the same", function()
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

  it("may be put into a mode without a callback, for tools", function()
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
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_b")
    rfsm.set_sta_mode(fsm.a, "inactive")
    rfsm.set_sta_mode(fsm.c, "active")
    assert.equal("root.c.x", rfsm.get_actleaf_fqn(fsm))
  end)

  it("are active, not done, when what was in them is inactive", function()
    rfsm.run(fsm)
    assert.equal("done", rfsm.get_sta_mode(fsm.a))
    rfsm.set_sta_mode(fsm.a, "inactive")
    assert.equal("active", rfsm.get_sta_mode(fsm))
    rfsm.set_sta_mode(fsm, "inactive")
    assert.same({}, rfsm.get_active_conf(fsm))
    assert.equal("inactive", rfsm.get_sta_mode(fsm))
  end)

  it("are none of them active after reset, wherever the machine stood", function()
    rfsm.run(fsm)
    rfsm.exit_state(fsm, fsm.a)
    assert.same({ "root" }, rfsm.get_active_conf(fsm))
    rfsm.reset(fsm)
    assert.same({}, rfsm.get_active_conf(fsm))
  end)

  it("complete in a mode that was set before they were ever entered", function()
    fsm = helper.init(helper.chart({ "e" }, { c = state {},
      [4] = trans { src = "b", tgt = "c", events = { "e_done" } } }))
    rfsm.set_sta_mode(fsm.b, "active")
    rfsm.step(fsm)
    assert.same({ "e_done@root.b" }, fsm._intq)
    assert.equal("root.c", leaf_after(fsm))
  end)

  it("run a doo on, or anew, as the mode that was set wants it", function()
    local starts = {}
    local function start(_, self)
      starts[#starts + 1] = self._id
      while true do rfsm.yield(true) end
    end
    fsm = helper.started(helper.chart({ "e" },
      { a = state { doo = start }, b = state { doo = start } }))
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
      fsm = helper.init(helper.chart({ "e" }, { err = false, a = state {
        doo = function()
          rfsm.yield(true)
          ending()
        end,
      } }))
      assert.is_nil(fsm.a._doo_co)
      rfsm.step(fsm, 2)
      assert.equal("thread", type(fsm.a._doo_co))
      assert.is_nil(fsm.b._doo_co)
      rfsm.step(fsm)
      assert.is_nil(fsm.a._doo_co)
    end
  end)

  it("take no mode that is none", function()
    for _, case in ipairs {
      { fsm.a, "dead", "'active', 'done' or 'inactive' expected, got string 'dead'" },
      { state {}, "active", "state of a fsm expected, got state" },
    } do
      local _, problem = pcall(rfsm.set_sta_mode, case[1], case[2])
      assert.equal("rfsm.set_sta_mode: " .. case[3], problem)
    end
  end)

  it("report a callback that cannot be called when it is called", function()
    local lines = said(fsm, "err")
    fsm.a.entry, fsm[3].guard, fsm[2].effect = 5, true, "x"
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_b")
    fsm[3].guard = false
    assert.equal("root.c.x", leaf_after(fsm, "e_b"))
    assert.same({
      "ENTRY error executing entry of root.a:  function expected, got number 5",
      "GUARD error executing guard of T={ src='root.k', tgt='root.c.initial' }:  "
        .. "function expected, got boolean",
      "EFFECT error executing effect of T={ src='root.a', tgt='root.k', "
        .. "events='e_b' }:  function expected, got string 'x'",
    }, lines)
  end)

  for _, key in ipairs { "getevents", "pre_step_hook", "post_step_hook" } do
    it("refuse a " .. key .. " that cannot be called when it is set", function()
      local _, problem = pcall(function() fsm[key] = {} end)
      assert.equal(key .. ": function expected, got table",
        (problem:gsub("^[^:]*:%d+: ", "")))
    end)
  end

  it("refuse a printer that cannot be called when something is printed", function()
    local machine = helper.started(helper.chart({ "e" }, { err = false }))
    machine.dbg = "full"
    assert.has_error(function() rfsm.send_events(machine, "e") rfsm.step(machine) end,
      "rfsm: dbg: function, true or false expected, got string 'full'")
  end)
end)

it("a transition through many states runs all callbacks in order, a new one at once",
  function()
    -- The names of `depth` states in `outer`, one in another.
    local function nest(outer, name, depth)
      local names = {}
      for i = 1, depth do
        names[i] = name .. i
        outer[names[i]], outer[1] = state {}, trans { src = "initial", tgt = names[i] }
        outer = outer[names[i]]
      end
      return names
    end

    local a, b, expected = state {}, state {}, {}
    local in_a, in_b = nest(a, "a", 25), nest(b, "b", 25)
    local trace, fsm = helper.traced(state {
      a = a, b = b, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b." .. table.concat(in_b, "."), events = { "e" } },
    })
    rfsm.run(fsm)
    fsm.a.exit = function(_, self)
      trace[#trace + 1] = "exit " .. self._fqn
      fsm.b.b1.entry = false
    end
    helper.clear(trace)
    local function expect(callback, root, names, last)
      expected[#expected + 1] = callback .. " " .. root .. (last > 0 and "." or "")
        .. table.concat(names, ".", 1, last)
    end
    for last = #in_a, 0, -1 do expect("exit", "root.a", in_a, last) end
    expected[#expected + 1] = "effect root.a->" .. fsm[2].tgt._fqn
    for last = 0, #in_b do
      if last ~= 1 then expect("entry", "root.b", in_b, last) end
    end
    helper.post_and_run(fsm, "e")
    assert.same(expected, trace)
  end)

describe("events", function()
  it("have many transitions tried in order until a guard enables one", function()
    local asked = {}
    local model = helper.chart { "e_other" }
    for i = 4, 63 do
      model[i] = trans { src = "a", tgt = "b", events = { "e" }, guard = function()
        asked[#asked + 1] = i
        return i == 62
      end }
    end
    assert.equal("root.b", leaf_after(helper.started(model), "e"))
    assert.same({ 59, 62 }, { #asked, asked[59] })
  end)

  it("that nobody waits for are forgotten", function()
    local fsm = helper.started(new_chart({}))
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

-- The second machine of (initial) -> a --e_b--> b, and more members, at rest.
local function second(members)
  local model = helper.chart({ "e_b" }, { c = state {} })
  model[3] = nil
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a set
  rfsm.init(model)
  return helper.started(model)
end

local function to_b(fields)
  fields.src, fields.tgt, fields.events = "a", "b", { "e_b" }
  return trans(fields)
end

describe("a machine that shares a plan", function()
  it("leaves a doo behind that was taken away while it was busy", function()
    local trace = {}
    local fsm = second {
      a = state { doo = function()
        while true do
          trace[#trace + 1] = "doo a"
          rfsm.yield(true)
        end
      end },
      b = state { doo = noting(trace, "doo b") },
    }
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

  for where, members in pairs { -- any order: each stands alone
    entry = { b = state { entry = merge } }, exit = { a = state { exit = merge } },
    effect = { [2] = to_b { effect = merge } },
    ["post step hook"] = { post_step_hook = merge },
    ["pre step hook"] = { pre_step_hook = merge },
  } do
    it("is merged into by its own callback, the place: " .. where, function()
      local fsm = second(members)
      fsm.is_ready = true
      helper.post_and_run(fsm, "e_b")
      assert.same({ "root", "root.b" }, rfsm.get_active_conf(fsm))
      assert.equal("done", rfsm.get_sta_mode(fsm.b))
      assert.equal("root.c", leaf_after(fsm, "e_c"))
    end)
  end

  it("takes another target from the next search on, no other value", function()
    local fsm = second()
    local lines = said(fsm, "err")
    for i, tgt in ipairs({ "b", 5, false, state {}, helper.chart(), second().c }) do
      fsm[2].tgt = tgt
      assert.equal("root.a", leaf_after(fsm, "e_b"))
      assert.equal(i, #lines)
    end
    assert.equal("ERROR: tgt of root.a: node of the fsm expected, got string 'b'",
      lines[1])
    fsm[2].tgt = fsm.c
    assert.equal("root.c", leaf_after(fsm, "e_b"))
  end)

  it("takes the root for a target", function()
    local trace = {}
    local fsm = second { a = state { entry = noting(trace, "entry a") } }
    local lines = said(fsm, "err")
    helper.clear(trace)
    fsm[2].tgt = fsm
    assert.equal("root.a", leaf_after(fsm, "e_b"))
    assert.same({ { "entry a" }, {} }, { trace, lines })
  end)

  it("names the root alone while a leaf is left", function()
    local conf
    helper.post_and_run(second { a = state { exit = function(fsm)
      conf = rfsm.get_active_conf(fsm)
    end } }, "e_b")
    assert.same({ "root" }, conf)
  end)

  it("lists what leaves a node as it is now", function()
    local fsm = second()
    assert.equal(1, #fsm.a._otrs)
    assert.equal(fsm.a._otrs, fsm.a._otrs)
    rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "c", events = { "e_c" }, pn = 1 })
    assert.same({ fsm[3], fsm[2] }, fsm.a._otrs)
    assert.same({}, fsm.c._otrs)
  end)

  it("asks a guard that an earlier one has set", function()
    local trace = {}
    local fsm = second { [3] = trans { src = "a", tgt = "c", events = { "e_b" } } }
    local function closed(text, set)
      return function()
        trace[#trace + 1] = text
        if set then set() end
        return false
      end
    end
    fsm[2].guard = closed("guard", function() fsm[3].guard = closed "new guard" end)
    assert.equal("root.a", leaf_after(fsm, "e_b"))
    assert.same({ "guard", "new guard" }, trace)
  end)

  it("counts a transition without events or pn that preproc made one", function()
    local fsm = with_preproc(function(fsm) fsm[2].events, fsm[2].pn = nil, nil end,
      function() return second { [2] = to_b { pn = 5 } } end)
    assert.equal("root.b", leaf_after(fsm, "anything"))
    assert.equal("T={ src='root.a', tgt='root.b' }", tostring(fsm[2]))
  end)

  it("runs a hook of a state once when it replaces a callback", function()
    local trace = {}
    local fsm = second {
      a = state { exit = noting(trace, "exit a") },
      b = state { entry = noting(trace, "entry b") },
    }
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
    local lines
    local fsm = second {
      m = state { x = state {}, trans { src = "initial", tgt = "x" } },
      [2] = trans { src = "a", tgt = "m", events = { "e_b" } },
    }
    rfsm.entry_hook_add(fsm, fsm.m, function()
      lines = said(fsm, "dbg", "STATE_ENTER")
    end)
    rfsm.send_events(fsm, "e_b")
    rfsm.step(fsm)
    assert.same({ "STATE_ENTER root.m", "STATE_ENTER root.m.x" }, lines)
  end)

  it("puts no state into itself, no NaN, nothing into a state of others", function()
    local fsm = second { m = state {
      x = state {}, trans { src = "initial", tgt = "x" },
    }, err = false }
    for _, case in ipairs {
      { "'root.m' cannot contain itself", fsm.m, fsm.m, "y" },
      { "a name expected, got NaN", fsm, trans { src = "a", tgt = "b" }, 0 / 0 },
      { "parent: a state of the fsm expected, got state", state {}, state {}, "z" },
    } do
      assert.equal("rfsm.fsm_merge: " .. case[1],
        (select(2, rfsm.fsm_merge(fsm, unpack(case, 2)))))
    end
  end)
end)
