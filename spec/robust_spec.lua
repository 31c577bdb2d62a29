-- What other people's code does to a machine: values that lie, callbacks that move it,
-- hosts that drop it, tools and modules of others that walk it. Each circumstance is
-- tried fresh and after so many uses that straight code runs.

local helper = require "spec.helper"
local rfsm = require "rfsm"

local conn, state, trans = rfsm.conn, rfsm.state, rfsm.trans

local USES = 5

-- initial -> a --e--> m.x --back--> a, and members.
local function new_model(members)
  local model = {
    err = false, a = state {}, b = state {},
    m = state { x = state {}, trans { src = "initial", tgt = "x" } },
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "m", events = { "e" } },
    trans { src = "m", tgt = "a", events = { "back" } },
    trans { src = "b", tgt = "a", events = { "back" } },
  }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a set
  return state(model)
end

-- A machine in state a; `uses` times it went to m and back.
local function started(members, uses)
  local fsm = helper.init(new_model(members))
  rfsm.run(fsm)
  for _ = 1, uses or 0 do
    helper.post_and_run(fsm, "e")
    helper.post_and_run(fsm, "back")
  end
  return fsm
end

local function leaf_after(fsm, ...)
  helper.post_and_run(fsm, ...)
  return rfsm.get_actleaf_fqn(fsm)
end

-- it("...", f(uses)) for a fresh machine and for one that has been in use
local function both(text, f)
  for _, uses in ipairs({ 0, USES }) do
    it(text .. (uses > 0 and ", in use" or ""), function() f(uses) end)
  end
end

describe("a value with an __eq that lies", function()
  local calls = 0
  local Liar = { __eq = function()
    calls = calls + 1
    return true
  end, __tostring = function() return "a liar" end }
  local function liar() return setmetatable({}, Liar) end
  local x, y = liar(), liar()

  before_each(function() calls = 0 end)
  after_each(function() assert.equal(0, calls) end)

  for _, where in ipairs({ "entry", "exit", "effect", "guard", "doo" }) do
    both("is the error of " .. where, function(uses)
      local said, fail = {}, false
      local function failing() if fail then error(x, 0) end end
      local fsm = started({
        err = function(id, _, failure)
          said[#said + 1] = id
          assert.is_true(rawequal(failure, x))
        end,
        a = state { exit = where == "exit" and failing },
        b = state { entry = where == "entry" and failing,
          doo = where == "doo" and failing },
        [5] = trans {
          src = "a", tgt = "b", events = { "go" }, guard = where == "guard" and failing,
          effect = where == "effect" and failing,
        },
      }, uses)
      for _ = 1, uses do
        assert.equal("root.b", leaf_after(fsm, "go"))
        assert.equal("root.a", leaf_after(fsm, "back"))
      end
      fail = true
      helper.post_and_run(fsm, "go")
      assert.same({ where:upper() }, said)
    end)
  end

  it("is what a doo yields", function()
    local cycles = 0
    local fsm = started { a = state { doo = function()
      for _ = 1, 3 do
        cycles = cycles + 1
        rfsm.yield(x)
      end
    end } }
    assert.equal("active", rfsm.get_sta_mode(fsm.a))
    for _ = 1, 4 do rfsm.run(fsm) end
    assert.equal(3, cycles)
    assert.equal("done", rfsm.get_sta_mode(fsm.a))
  end)

  both("is an event, matched by identity, also behind a connector", function(uses)
    local fsm = started({
      k = conn {},
      [5] = trans { src = "a", tgt = "b", events = { x } },
      [6] = trans { src = "b", tgt = "k", events = { x, y } },
      [7] = trans { src = "k", tgt = "a", events = { y } },
    }, uses)
    for _ = 1, uses + 1 do
      assert.equal("root.a", leaf_after(fsm, y))
      assert.equal("root.b", leaf_after(fsm, x))
      assert.equal("root.b", leaf_after(fsm, x))
      assert.equal("root.b", leaf_after(fsm, liar()))
      assert.equal("root.a", leaf_after(fsm, y))
      assert.equal("root.b", leaf_after(fsm, y, x))
      assert.equal("root.a", leaf_after(fsm, "back"))
    end
  end)

  it("is the error of a printer, hook or getevents, and reaches the caller", function()
    for _, field in ipairs({ "dbg", "getevents", "pre_step_hook", "post_step_hook" }) do
      local fsm = started()
      fsm[field] = function() error(x, 0) end
      fsm._intq[1] = "other"
      local ok, failure = pcall(rfsm.step, fsm)
      assert.is_false(ok)
      assert.is_true(rawequal(failure, x), field)
      fsm[field] = nil
      assert.equal("root.m.x", leaf_after(fsm, "e"))
    end
  end)

  it("is user data in a model that is used again", function()
    local model = new_model { mine = x }
    helper.init(model)
    model.mine = y
    assert.is_true(rawequal(y, helper.init(model).mine))
  end)
end)

describe("tr.tgt set by a callback of that transition", function()
  for _, where in ipairs({ "exit", "effect", "entry", "guard" }) do
    both("counts from the next search on: " .. where, function(uses)
      local fsm, is_armed = nil, false
      local function retarget()
        if is_armed then fsm[2].tgt = fsm.b end
      end
      fsm = started({
        a = state { exit = where == "exit" and retarget },
        m = state {
          entry = where == "entry" and retarget,
          x = state {}, trans { src = "initial", tgt = "x" },
        },
        [2] = trans {
          src = "a", tgt = "m", events = { "e" },
          effect = where == "effect" and retarget,
          guard = where == "guard" and retarget,
        },
      }, uses)
      is_armed = true
      local first = leaf_after(fsm, "e")
      assert.equal(where == "guard" and first or "root.m.x", first)
      leaf_after(fsm, "back")
      assert.equal("root.b", leaf_after(fsm, "e"))
      fsm[2].tgt, is_armed = fsm.m, false
      leaf_after(fsm, "back")
      assert.equal("root.m.x", leaf_after(fsm, "e"))
      rfsm.reset(fsm)
      rfsm.run(fsm)
      assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
    end)
  end
end)

describe("a step in a coroutine that is dropped", function()
  local is_5_1 = not pcall(function() -- pcall cannot be yielded across
    assert(coroutine.wrap(function() pcall(coroutine.yield, 1) end)() == 1)
  end)

  local PLACES = {
    { "getevents", function(yield) return { getevents = yield } end },
    { "pre_step_hook", function(yield) return { pre_step_hook = yield } end },
    { "post_step_hook", function(yield) return { post_step_hook = yield } end },
    { "idle_hook", function(yield) return { idle_hook = yield } end },
    { "exit", function(yield) return { a = state { exit = yield } } end, true },
    { "entry", function(yield) return { m = state {
      entry = yield, x = state {}, trans { src = "initial", tgt = "x" },
    } } end, true },
    { "effect", function(yield) return {
      [2] = trans { src = "a", tgt = "m", events = { "e" }, effect = yield },
    } end, true },
    { "guard", function(yield) return {
      [2] = trans { src = "a", tgt = "m", events = { "e" }, guard = yield },
    } end, true },
  }

  for _, place in ipairs(PLACES) do
    local function dropped(uses)
      local is_armed = false
      local fsm = started(place[2](function()
        if is_armed then coroutine.yield() end
      end), place[1] ~= "idle_hook" and uses or 0)
      is_armed = true
      rfsm.send_events(fsm, "e")
      local co = coroutine.create(rfsm.step)
      assert.is_true(coroutine.resume(co, fsm, 20))
      assert.equal("suspended", coroutine.status(co))
      is_armed = false
      return fsm, co
    end

    if not (is_5_1 and place[3]) and place[1] ~= "idle_hook" then
      both("goes on where it was, " .. place[1], function(uses)
        local fsm, co = dropped(uses)
        fsm.post_step_hook = nil
        assert.is_true(coroutine.resume(co))
        assert.equal("dead", coroutine.status(co))
        assert.equal("root.m.x", rfsm.get_actleaf_fqn(fsm))
      end)

      both("is finished by the next one, " .. place[1], function(uses)
        local fsm = dropped(uses)
        rfsm.run(fsm)
        assert.equal("root.m.x", rfsm.get_actleaf_fqn(fsm))
        assert.equal("root.a", leaf_after(fsm, "back"))
      end)

      both("is forgotten by reset, " .. place[1], function(uses)
        local fsm = dropped(uses)
        rfsm.reset(fsm)
        assert.same({}, rfsm.get_active_conf(fsm))
        assert.same({ "e_init_fsm" }, fsm._intq)
        rfsm.run(fsm)
        assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
        assert.equal("root.m.x", leaf_after(fsm, "e"))
      end)
    end
  end
end)

describe("a hook or guard that moves the machine", function()
  local MOVES = {
    exit_leaf = function(fsm) rfsm.exit_state(fsm, fsm.m.x) end,
    exit_composite = function(fsm) rfsm.exit_state(fsm, fsm.m) end,
    exit_root = function(fsm) rfsm.exit_state(fsm, fsm) end,
    leaf_inactive = function(fsm) rfsm.set_sta_mode(fsm.m.x, "inactive") end,
    composite_inactive = function(fsm) rfsm.set_sta_mode(fsm.m, "inactive") end,
    root_inactive = function(fsm) rfsm.set_sta_mode(fsm, "inactive") end,
    elsewhere = function(fsm) rfsm.set_sta_mode(fsm.b, "active") end,
    composite_done = function(fsm) rfsm.set_sta_mode(fsm.m, "done") end,
  }

  for name, move in pairs(MOVES) do -- any order: each stands alone
    for _, where in ipairs({ "pre_step_hook", "post_step_hook", "guard" }) do
      both(("leaves one that goes on: %s, %s"):format(where, name), function(uses)
        local fsm, is_armed = nil, false
        local function move_once()
          if is_armed then
            is_armed = false
            move(fsm)
          end
        end
        fsm = started({
          [where] = where ~= "guard" and move_once or nil,
          [3] = trans {
            src = "m", tgt = "a", events = { "back" }, guard = where == "guard"
              and move_once,
          },
        }, uses)
        helper.post_and_run(fsm, "e")
        is_armed = true
        rfsm.send_events(fsm, "back")
        rfsm.step(fsm, 50)
        rfsm.send_events(fsm, "back", "back")
        rfsm.step(fsm, 50)
        rfsm.reset(fsm)
        rfsm.run(fsm)
        assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
        assert.equal("root.m.x", leaf_after(fsm, "e"))
        assert.same({ "root", "root.m", "root.m.x" }, rfsm.get_active_conf(fsm))
      end)
    end
  end

  both("may merge children into the target of its transition", function(uses)
    local fsm, is_armed = nil, false
    fsm = started({ [5] = trans {
      src = "a", tgt = "b", events = { "go" }, guard = function()
        if not is_armed then return end
        is_armed = false
        assert(rfsm.fsm_merge(fsm, fsm.b, conn {}, "initial"))
        assert(rfsm.fsm_merge(fsm, fsm.b, state {}, "y"))
        assert(rfsm.fsm_merge(fsm, fsm.b, trans { src = "initial", tgt = "y" }))
      end,
    } }, uses)
    is_armed = true
    assert.equal("root.b.y", leaf_after(fsm, "go"))
    assert.same({ "root", "root.b", "root.b.y" }, rfsm.get_active_conf(fsm))
    assert.equal("root.a", leaf_after(fsm, "back"))
  end)
end)

describe("a machine", function()
  it("is no machine to another copy of the library, which says so", function()
    local fsm = started()
    local other = dofile("rfsm.lua")
    rawset(_G, "rfsm", rfsm)
    for _, name in ipairs({ "step", "run", "send_events", "reset" }) do
      local ok, problem = pcall(function() other[name](fsm, 1) end)
      assert.is_false(ok)
      assert.matches("robust_spec.lua:%d+: rfsm." .. name .. ": initialised fsm "
        .. "expected, got state of another copy of rfsm$", problem)
    end
    assert.same({}, fsm._intq)
  end)

  it("is entered also if a pre step hook takes e_init_fsm away", function()
    local fsm = helper.init(new_model { pre_step_hook = function(_, events)
      helper.clear(events)
    end })
    rfsm.step(fsm)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
  end)

  both("leaves a guard the events that it keeps", function(uses)
    local kept
    local fsm = started({ [5] = trans {
      src = "a", tgt = "b", events = { "go" }, guard = function(_, events)
        kept = events
      end,
    } }, uses)
    for _ = 1, uses + 1 do
      helper.post_and_run(fsm, "go", "and more")
      assert.same({ "go", "and more" }, kept)
      helper.post_and_run(fsm, "back")
      assert.same({ "go", "and more" }, kept)
    end
  end)

  both("is as before after a merge whose preproc function raises", function(uses)
    local fsm, said = started(nil, uses), {}
    fsm.err = function(text) said[#said + 1] = text end
    table.insert(rfsm.preproc, function() error("on purpose", 0) end)
    local ok, reason = rfsm.fsm_merge(fsm, fsm, trans {
      src = "a", tgt = "b", events = { "go" },
    })
    table.remove(rfsm.preproc)
    assert.is_false(ok)
    assert.same({ reason }, said)
    assert.matches("a preproc function failed: on purpose", reason)
    assert.is_nil(fsm[5])
    assert.equal(1, #fsm.a._otrs)
    assert.equal("root.a", leaf_after(fsm, "go"))
    assert.is_true((rfsm.fsm_merge(fsm, fsm, trans {
      src = "a", tgt = "b", events = { "go" },
    })))
    assert.equal("root.b", leaf_after(fsm, "go"))
  end)

  both("has its records in the original's order", function(uses)
    local seen = {}
    local function note(text)
      return function(machine)
        seen[#seen + 1] = ("%s %s %s"):format(text, table.concat(
          rfsm.get_active_conf(machine), " "), tostring(rfsm.actchild_get(machine)))
      end
    end
    local fsm = started({ a = state { exit = note "exit" }, [2] = trans {
      src = "a", tgt = "m", events = { "e" }, effect = note "effect",
    } }, uses)
    helper.clear(seen)
    helper.post_and_run(fsm, "e")
    assert.same({ "exit root nil", "effect root nil" }, seen)
    fsm.dbg = function(id) seen[#seen + 1] = id end
    helper.post_and_run(fsm, "back")
    helper.clear(seen)
    rfsm.send_events(fsm, "e", "f")
    rfsm.step(fsm)
    assert.same({ "RAISED", "TRANSITION", "CHECKING", "CHECKING", "EXEC_PATH",
      "TRANS_EXIT", "exit root nil", "STATE_EXIT", "EFFECT", "effect root nil",
      "TRANS_ENTER", "STATE_ENTER", "TRANS_EXIT", "EFFECT", "TRANS_ENTER", "RAISED",
      "STATE_ENTER" }, seen)
    helper.clear(seen)
    rfsm.step(fsm, 1)
    assert.is_not.equal("HIBERNATING", seen[#seen])
    rfsm.step(fsm, 2)
    assert.equal("HIBERNATING", seen[#seen])
  end)

  both("takes an internal transition and leaves nothing for it", function(uses)
    local trace = {}
    local function note(what) return function() trace[#trace + 1] = what end end
    local fsm = started({
      m = state {
        entry = note "entry m", exit = note "exit m",
        x = state { entry = note "entry x", exit = note "exit x", doo = function()
          for i = 1, 100 do
            trace[#trace + 1] = "doo " .. i
            rfsm.yield(true)
          end
        end },
        trans { src = "initial", tgt = "x" },
      },
      [5] = trans {
        src = "m", tgt = "internal", events = { "beep" }, effect = note "effect",
        guard = function() trace[#trace + 1] = "guard" end,
      },
      [6] = trans { src = "root", tgt = "internal", events = { "top" } },
    }, uses)
    helper.post_and_run(fsm, "e")
    for i = 1, uses + 1 do
      helper.clear(trace)
      helper.post_and_run(fsm, "beep")
      assert.same({ "guard", "effect", "doo " .. i * 2 }, trace)
      helper.post_and_run(fsm, "top")
    end
    assert.equal("root.m.x", rfsm.get_actleaf_fqn(fsm))
  end)

  it("has the user's data under any name that no tool reads", function()
    local data = { _index = 1, _def = 2, _plan_ = 3, ["%data"] = 4, _run = 5, _lca = 6 }
    local a, tr = state {}, trans { src = "a", tgt = "b", events = { "go" } }
    for key, value in pairs(data) do a[key], tr[key] = value, value end -- a set
    local fsm = started { a = a, [5] = tr, _index = 7, _def = 8 }
    for key, value in pairs(data) do -- any order: a set
      assert.equal(value, fsm.a[key])
      assert.equal(value, fsm[5][key])
    end
    assert.same({ 7, 8 }, { fsm._index, fsm._def })
    assert.equal("root.b", leaf_after(fsm, "go"))
  end)

  it("runs in a sandbox without require, loadfile, debug and package", function()
    assert.equal("root.b 1", helper.output_of([[
      local file = assert(io.open("rfsm.lua"))
      local text = file:read("*a")
      file:close()
      local load = loadstring or load
      require, loadfile, dofile, debug, package, io, os = nil
      local rfsm = load(text, "=rfsm")()
      local fsm = rfsm.init(rfsm.state {
        info = false, warn = false, a = rfsm.state {}, b = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = "e" },
      })
      local count = 0
      fsm.err = function() count = count + 1 end
      fsm.b.entry = function() error("on purpose") end
      rfsm.run(fsm)
      rfsm.send_events(fsm, "e")
      rfsm.run(fsm)
      print(rfsm.get_actleaf_fqn(fsm) .. " " .. count)
    ]]))
    helper.remove_files()
  end)

  it("is made in a time that grows with the mounts of one template", function()
    local function instructions(count)
      local template = state { x = state {}, trans { src = "initial", tgt = "x" } }
      local model = new_model()
      for i = 1, count do model["s" .. i] = template end
      local used = 0
      debug.sethook(function() used = used + 1 end, "", 1000)
      rfsm.init(model)
      debug.sethook()
      return used
    end
    local jit = rawget(_G, "jit")
    if jit then jit.off() end
    local few, many = instructions(1000), instructions(4000)
    if jit then jit.on() end
    assert.is_true(many < 6 * few, ("%d, %d"):format(few, many))
  end)
end)

-- The idioms of the original's own modules, of librFSM and of hosts in C.
describe("a live machine that others walk", function()
  both("has no active child where there is none", function(uses)
    local fsm = started(nil, uses)
    local function children()
      return { fsm.a._actchild == nil, rfsm.actchild_get(fsm.a) == nil,
        fsm.m._actchild == nil, rawget(fsm.m, "_actchild") == nil }
    end
    assert.same({ true, true, true, true }, children())
    helper.post_and_run(fsm, "e")
    helper.post_and_run(fsm, "back")
    assert.same({ true, true, true, true }, children())
    assert.equal(fsm.a, fsm._actchild)
    rfsm.reset(fsm)
    assert.is_nil(fsm._actchild)
  end)

  it("shows itself first to mapfsm, if pred wants it", function()
    local fsm = started()
    local seen = rfsm.mapfsm(function(obj, parent, name)
      return { obj._fqn, parent._fqn, name }
    end, fsm, rfsm.is_state)
    assert.same({ "root", "root", "root" }, seen[1])
    assert.same({ "root.a", "root", "a" }, seen[2])
    assert.same({ "root.m.x", "root.m", "x" }, seen[5])
    local function name_of(_, _, name) return name end
    assert.same({ "a", "b", "initial", "m", "initial", "x" },
      rfsm.mapfsm(name_of, fsm, rfsm.is_nr_node))
  end)

  it("lists what leaves each node, before preproc functions run", function()
    local counts
    table.insert(rfsm.preproc, function(fsm)
      counts = { #fsm._otrs, #fsm.a._otrs, #fsm.m.x._otrs, #fsm.initial._otrs }
    end)
    local fsm = started()
    table.remove(rfsm.preproc)
    assert.same({ 0, 1, 0, 1 }, counts)
    assert.equal(fsm[2], fsm.a._otrs[1])
  end)

  it("is a tree of raw tables: pairs, next, ipairs, #, rawget, unpack", function()
    local fsm = started()
    local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
    assert.equal(4, #fsm)
    assert.equal(4, select("#", unpack(fsm)))
    assert.equal(fsm.m.x, rawget(rawget(fsm, "m"), "x"))
    local FIELDS = {
      entry = true, exit = true, doo = true, getevents = true, dbg = true, info = true,
      warn = true, err = true, idle_hook = true, pre_step_hook = true,
      post_step_hook = true,
    }
    local function names_of(owner, iterate)
      local names = {}
      for key, value in iterate(owner) do -- any order: sorted below
        if rfsm.is_fsmobj(value) and not rfsm.is_meta(key) then
          names[#names + 1] = tostring(key)
        elseif not FIELDS[key] then
          assert.matches("^[_%%]", key)
        end
      end
      table.sort(names)
      return table.concat(names, " ")
    end
    assert.equal("1 2 3 4 a b initial m", names_of(fsm, pairs))
    assert.equal("1 initial x",
      names_of(fsm.m, function(t) return next, t end))
    assert.equal("1 2 3 4", names_of(fsm, ipairs))
  end)

  it("holds marked tables of others, which are what they say", function()
    local function marked(kind, t)
      return setmetatable(t, { rfsm = true, __index = { type = function()
        return kind
      end } })
    end
    local fsm = started {
      s = marked("state", { y = state {}, trans { src = "initial", tgt = "y" } }),
      k = marked("connector", {}),
      [5] = marked("transition", { src = "a", tgt = "k", events = { "go" } }),
      [6] = trans { src = "k", tgt = "s" },
    }
    assert.equal("root.s.y", leaf_after(fsm, "go"))
    local function name_of(_, _, name) return name end
    assert.same({ 1, "a" }, rfsm.mapfsm(name_of, { trans {}, a = state {}, b = 5 }))
    assert.is_false(rfsm.is_state(marked("banana", {})))
    assert.is_false(rfsm.is_state(setmetatable({}, { rfsm = true })))
    assert.is_true(rfsm.is_trans(marked("transition", {})))
  end)

  it("has a getevents that returns a list, and drops a hook set to nil", function()
    local fsm, count = started(), 0
    assert.same({}, fsm.getevents())
    fsm.post_step_hook = function() count = count + 1 end
    rfsm.step(fsm)
    fsm.post_step_hook = nil
    rfsm.step(fsm)
    assert.equal(1, count)
    assert.is_nil(fsm.post_step_hook)
  end)

  it("is walked by map_from_to, which returns the list of results", function()
    local fsm = started()
    local function name_of(_, node) return node._fqn end
    assert.same({ "root", "root.m", "root.m.x" },
      rfsm.map_from_to(fsm, name_of, fsm, fsm.m.x))
    assert.same({ "root.m.x", "root.m" },
      rfsm.map_from_to(fsm, name_of, fsm.m.x, fsm.m))
    assert.error_matches(function() rfsm.map_from_to(fsm, name_of, fsm.a, fsm.b) end,
      "'root.a' and 'root.b' are not on one line", 1, true)
  end)

  it("gets from a preproc function what that merges, once", function()
    local merged, calls = 0, 0
    table.insert(rfsm.preproc, function() calls = calls + 1 end)
    table.insert(rfsm.preproc, function(fsm)
      if fsm.extra then return end
      merged = merged + 1
      assert(rfsm.fsm_merge(fsm, fsm, state {}, "extra"))
      assert(rfsm.fsm_merge(fsm, fsm, trans {
        src = "a", tgt = "extra", events = { "go" },
      }))
    end)
    local fsm = started()
    table.remove(rfsm.preproc)
    table.remove(rfsm.preproc)
    assert.same({ 1, 3 }, { merged, calls })
    assert.equal("root.extra", leaf_after(fsm, "go"))
  end)
end)

describe("base:new{...}", function()
  it("makes a state that inherits callbacks and data from the state", function()
    local trace = {}
    local function note(what) return function() trace[#trace + 1] = what end end
    local base = state { entry = note "entry", exit = note "exit", speed = 1 }
    local child = base:new { exit = note "own exit", colour = "red" }
    local grandchild = child:new { speed = 2 }
    assert.is_true(rfsm.is_state(child) and rfsm.is_state(grandchild))
    assert.equal("state", grandchild:type())
    local fsm = started { b = grandchild, [5] = trans {
      src = "a", tgt = "b", events = { "go" },
    } }
    helper.post_and_run(fsm, "go")
    helper.post_and_run(fsm, "back")
    assert.same({ "entry", "own exit" }, trace)
    assert.same({ 2, "red" }, { fsm.b.speed, fsm.b.colour })
    base.entry = note "new entry"
    fsm = started { b = grandchild, [5] = trans {
      src = "a", tgt = "b", events = { "go" },
    } }
    helper.clear(trace)
    helper.post_and_run(fsm, "go")
    assert.same({ "new entry" }, trace)
  end)

  it("makes a transition that inherits", function()
    local base = trans { src = "a", events = { "go" } }
    local fsm = started { [5] = base:new { tgt = "b" } }
    assert.equal("root.b", leaf_after(fsm, "go"))
  end)
end)
