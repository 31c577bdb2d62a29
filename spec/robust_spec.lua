-- What other people's code does to a machine: values that lie, callbacks that move it,
-- hosts that drop it. Each circumstance is tried fresh and after so many uses that
-- straight code runs.

local compiling = require "spec.support.compiling"
local helper = require "spec.helper"
local interrupts = require "spec.support.interrupts"
local rfsm = require "rfsm"

local conn, state, trans = rfsm.conn, rfsm.state, rfsm.trans
local leaf_after, noting = helper.leaf_after, helper.noting

local load_text = rawget(_G, "loadstring") or load

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
  local fsm = helper.started(new_model(members))
  for _ = 1, uses or 0 do
    helper.post_and_run(fsm, "e")
    helper.post_and_run(fsm, "back")
  end
  return fsm
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
      for _, case in ipairs { { "a", y }, { "b", x }, { "b", x }, { "b", liar() },
        { "a", y }, { "b", y, x }, { "a", "back" } } do
        assert.equal("root." .. case[1], leaf_after(fsm, case[2], case[3]))
      end
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

  it("is a table that is marked", function()
    assert.is_true(rfsm.is_state(rfsm.state(liar())))
    assert.is_true(rfsm.is_conn(rfsm.conn(liar())))
  end)

  it("is each state of another library", function()
    local Other = { rfsm = true, __eq = Liar.__eq, __index = {
      type = function() return "state" end,
    } }
    local function other(t) return setmetatable(t, Other) end
    local fsm = helper.started(other { m = other { x = other {},
      trans { src = "initial", tgt = "x" } }, trans { src = "initial", tgt = "m" } })
    assert.equal("root.m.x", rfsm.get_actleaf_fqn(fsm))
  end)
end)

it("a field of the engine is never one of the model", function()
  local names = {}
  local text = helper.content("rfsm.lua")
  for name in text:gmatch("%f[%w_]fsm%.(_%l[%w_]*)") do names[name] = true end
  for name in text:gmatch('list = "(_%l+_hooks)"') do names[name] = true end
  for name in pairs(names) do -- any order: each stands alone
    local fsm = helper.init(new_model { [name] = 5 })
    assert.not_equal(5, fsm[name], name)
  end
end)

describe("an event that equals no event, NaN,", function()
  both("ends at a circle of connectors", function(uses)
    local fsm = started({ k = conn {}, l = conn {},
      [5] = trans { src = "a", tgt = "k" }, [6] = trans { src = "k", tgt = "l" },
      [7] = trans { src = "l", tgt = "k" },
      [8] = trans { src = "k", tgt = "b", events = { "go" } } }, uses)
    for _ = 1, uses + 1 do
      assert.equal("root.a", leaf_after(fsm, 0 / 0))
      assert.equal("root.b", leaf_after(fsm, 0 / 0, "go"))
      assert.equal("root.a", leaf_after(fsm, "back"))
    end
  end)
end)

describe("getevents", function()
  it("may return a list that cannot be read: the machine goes on", function()
    local function fail() error(7, 0) end
    local function two() return 2 end -- Lua 5.1 does not ask, there it is two
    local lists = { setmetatable({ nil, "e" }, { __index = fail, __len = two }) }
    local fsm = started()
    fsm.getevents = function() return table.remove(lists) end
    rfsm.send_events(fsm, "other")
    local ok, failure = pcall(rfsm.step, fsm)
    assert.same({ false, 7 }, { ok, failure })
    pcall(rfsm.step, fsm)
    assert.equal("root.m.x", leaf_after(fsm, "e"))
  end)

  it("may return a list that fails halfway: no event of it is there twice", function()
    local count = 0
    local function two(_, i) -- Lua 5.1 does not ask for the length
      count = count + 1
      if count == 2 then error(7, 0) end
      return "e_" .. i
    end
    local fsm = started()
    fsm.getevents = function()
      return setmetatable({ nil, nil, "e_3" }, { __index = two,
        __len = function() return 3 end })
    end
    assert.same({ false, 7 }, { pcall(rfsm.check_events, fsm) })
    rfsm.check_events(fsm)
    local times = {}
    for _, event in ipairs(fsm._intq) do times[event] = (times[event] or 0) + 1 end
    assert.same({ nil, nil }, { times.e_1 ~= 1 or nil, times.e_3 ~= 1 or nil })
  end)

  it("leaves nothing but events in a list, also taken one by one", function()
    local keys, given = {}, { "e", "back" }
    local function note(_, events)
      for key in pairs(events) do keys[key] = true end -- any order: a set
    end
    local fsm = started { read = "one", post_step_hook = note }
    fsm.getevents = function() return { table.remove(given, 1) } end
    for _ = 1, 9 do
      rfsm.step(fsm)
      note(fsm, fsm._intq)
    end
    assert.same({ { true }, {} }, { keys, given })
  end)
end)

describe("a field for a hook", function()
  for _, slot in ipairs { "getevents", "pre_step_hook", "post_step_hook" } do
    it("may be false for a while: " .. slot, function()
      local count = 0
      local function hook() count = count + 1 end
      local fsm = started()
      fsm[slot] = false
      rfsm.run(fsm)
      fsm[slot] = hook
      rfsm.run(fsm)
      assert.is_true(count > 0)
      fsm[slot] = false
      rfsm.pre_step_hook_add(fsm, function() end)
      count, fsm[slot] = 0, hook
      rfsm.run(fsm)
      assert.is_true(count > 0)
    end)
  end
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
        m = state { entry = where == "entry" and retarget, x = state {},
          trans { src = "initial", tgt = "x" } },
        [2] = trans { src = "a", tgt = "m", events = { "e" },
          effect = where == "effect" and retarget,
          guard = where == "guard" and retarget },
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
      assert.equal("root.a", leaf_after(fsm))
    end)
  end
end)

describe("a step that is suspended in its coroutine", function()
  local is_5_1 = not pcall(function() -- pcall cannot be yielded across
    assert(coroutine.wrap(function() pcall(coroutine.yield, 1) end)() == 1)
  end)

  local MIDDLE = "%s: the machine is in the middle of a step; if its coroutine is "
    .. "never resumed, rfsm.init(fsm) makes a fresh machine"

  local function members_with(place, f)
    if place == "exit" then return { a = state { exit = f } } end
    if place == "entry" then
      return { m = state { entry = f, x = state {},
        trans { src = "initial", tgt = "x" } } }
    end
    if place:find("_") or place == "getevents" then return { [place] = f } end
    return { [2] = trans { src = "a", tgt = "m", events = { "e" }, [place] = f } }
  end

  local PLACES = {
    "getevents", "pre_step_hook", "post_step_hook", "exit", "entry", "effect", "guard",
  }

  for _, place in ipairs(is_5_1 and {} or PLACES) do
    local function suspended(uses)
      local is_armed = false
      local fsm = started(members_with(place, function()
        if is_armed then coroutine.yield() end
      end), uses)
      is_armed = true
      rfsm.send_events(fsm, "e")
      local co = coroutine.create(rfsm.step)
      assert.is_true(coroutine.resume(co, fsm, 20))
      assert.equal("suspended", coroutine.status(co))
      is_armed = false
      return fsm, co
    end

    local function go_on(co)
      assert.is_true(coroutine.resume(co))
      assert.equal("dead", coroutine.status(co))
    end

    both("refuses others, and goes on where it was, " .. place, function(uses)
      local fsm, co = suspended(uses)
      for _, name in ipairs { "step", "run" } do
        local expected = MIDDLE:format("rfsm." .. name)
        assert.equal(expected, helper.refusal(rfsm[name], fsm))
        assert.equal(expected, coroutine.wrap(function()
          return helper.refusal(rfsm[name], fsm)
        end)())
      end
      go_on(co)
      assert.equal("root.m.x", rfsm.get_actleaf_fqn(fsm))
      assert.equal("root.a", leaf_after(fsm, "back"))
    end)

    both("is reset when its iteration ends, " .. place, function(uses)
      local fsm, co = suspended(uses)
      local modes = table.concat(rfsm.get_active_conf(fsm), " ")
      rfsm.reset(fsm)
      assert.equal(modes, table.concat(rfsm.get_active_conf(fsm), " "))
      go_on(co)
      assert.equal("root.a", leaf_after(fsm))
      assert.equal("root.m.x", leaf_after(fsm, "e"))
    end)

    both("that is dropped is forgotten by a fresh machine, " .. place, function(uses)
      local fsm = rfsm.init((suspended(uses)))
      assert.same({}, rfsm.get_active_conf(fsm))
      assert.equal("root.a", leaf_after(fsm))
      assert.equal("root.m.x", leaf_after(fsm, "e"))
    end)
  end

  -- Without the library debug, too, no caller gets past it.
  for _, missing in ipairs(is_5_1 and {} or { "no library", "debug" }) do
    it("calls each callback once, whoever runs the machine: without " .. missing,
      function()
        compiling.without(missing, function(core)
          local trace = {}
          local fsm = core.init(core.state { info = false, warn = false,
            a = core.state { entry = function()
              coroutine.yield()
              trace[#trace + 1] = "entry of a"
            end, exit = noting(trace, "exit of a") },
            b = core.state { entry = noting(trace, "entry of b"), final = true },
            core.trans { src = "initial", tgt = "a" },
            core.trans { src = "a", tgt = "b", events = { "e" } } })
          local first = coroutine.wrap(core.run)
          first(fsm)
          local is_run = coroutine.wrap(function()
            core.send_events(fsm, "e")
            return (pcall(core.run, fsm))
          end)()
          trace[#trace + 1] = is_run and "run" or "refused"
          first()
          if table.concat(trace, ", ")
            ~= "refused, entry of a, exit of a, entry of b" then
            error(table.concat(trace, ", "))
          end
        end)
      end)
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
          [3] = trans { src = "m", tgt = "a", events = { "back" },
            guard = where == "guard" and move_once },
        }, uses)
        helper.post_and_run(fsm, "e")
        is_armed = true
        rfsm.send_events(fsm, "back")
        rfsm.step(fsm, 50)
        rfsm.send_events(fsm, "back", "back")
        rfsm.step(fsm, 50)
        rfsm.reset(fsm)
        assert.equal("root.a", leaf_after(fsm))
        assert.equal("root.m.x", leaf_after(fsm, "e"))
        assert.same({ "root", "root.m", "root.m.x" }, rfsm.get_active_conf(fsm))
      end)
    end
  end

  for _, case in ipairs {
    { where = "in a composite that is left", to = "b", expected = "root.b" },
    { where = "beside its source", to = "m", expected = "root.m.y" },
  } do
    both("has its transition taken only if the machine stays, " .. case.where,
      function(uses)
        local fsm, is_armed = nil, false
        fsm = started({
          m = state {
            x = state {}, y = state {}, z = state {},
            trans { src = "initial", tgt = "x" },
            trans { src = "x", tgt = "y", events = { "go" }, guard = function()
              if not is_armed then return end
              rfsm.set_sta_mode(case.to == "b" and fsm.b or fsm.m.z, "active")
            end },
          },
        }, uses)
        helper.post_and_run(fsm, "e")
        is_armed = true
        assert.equal(case.expected, leaf_after(fsm, "go"))
      end)
  end

  both("of the end of an iteration may reset it: the next one begins anew",
    function(uses)
      local is_armed, trace = false, {}
      local fsm = started({ m = state {
        x = state { exit = noting(trace, "exit x") },
        trans { src = "initial", tgt = "x" },
      }, post_step_hook = function(machine)
        if is_armed then rfsm.reset(machine) end
        is_armed = false
      end }, uses)
      helper.clear(trace)
      is_armed = true
      rfsm.send_events(fsm, "e")
      rfsm.step(fsm)
      assert.equal("root.m.x", rfsm.get_actleaf_fqn(fsm))
      rfsm.send_events(fsm, "back")
      rfsm.step(fsm)
      assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
      assert.same({}, trace)
    end)

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
      assert.equal("rfsm." .. name .. ": initialised fsm expected, got state of "
        .. "another copy of rfsm", helper.refusal(other[name], fsm, 1))
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
    local fsm = started(nil, uses)
    local said, reason, tr = helper.said(fsm, "err"), nil,
      trans { src = "a", tgt = "b", events = { "go" } }
    helper.with_preproc(function() error("on purpose", 0) end, function()
      reason = select(2, rfsm.fsm_merge(fsm, fsm, tr))
    end)
    assert.same({ reason }, said)
    assert.matches("a preproc function failed: on purpose", reason)
    assert.is_nil(fsm[5])
    assert.equal(1, #fsm.a._otrs)
    assert.equal("root.a", leaf_after(fsm, "go"))
    assert.is_true((rfsm.fsm_merge(fsm, fsm, tr)))
    assert.equal("root.b", leaf_after(fsm, "go"))
  end)

  both("takes an internal transition and leaves nothing for it", function(uses)
    local trace = {}
    local note = noting(trace, "entry or exit")
    local fsm = started({
      m = state {
        entry = note, exit = note,
        x = state { entry = note, exit = note, doo = function()
          for i = 1, 100 do
            trace[#trace + 1] = "doo " .. i
            rfsm.yield(true)
          end
        end },
        trans { src = "initial", tgt = "x" },
      },
      [5] = trans {
        src = "m", tgt = "internal", events = { "beep" },
        guard = noting(trace, "guard"), effect = noting(trace, "effect"),
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

  it("goes on behind a callback that asked for a path and was interrupted", function()
    local at, is_reached = 0, true
    local fsm = started { k = conn {}, [6] = trans { src = "k", tgt = "b",
      events = { "then" } } }
    rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "k", events = { "go" },
      effect = function()
        is_reached = interrupts.raise(at, "time is up", rfsm.node_find_enabled, fsm,
          fsm.k, { "then" })
      end })
    interrupts.without_jit(function()
      while is_reached do
        at = at + 1
        assert.equal("root.b", leaf_after(fsm, "go", "then"), at)
        assert.equal("root.a", leaf_after(fsm, "back"))
      end
    end)
    assert.is_true(at > 50)
  end)

  it("has an initial that stands where its first transition does", function()
    local said = {}
    local members = { a = state {}, info = false, warn = function(text)
      said[#said + 1] = text:match("^WARNING: (.-initial): ")
    end }
    local text = "local trans = ...\nlocal t = trans { src = 'initial', tgt = 'a', "
      .. "guard = print }\nreturn t"
    for i = 1, 9 do
      local chunk = assert(load_text(("\n"):rep(i) .. text, "=chart"))
      members["t" .. i] = chunk(trans)
    end
    rfsm.init(state(members))
    assert.same({ "chart:3: root.initial" }, said)
  end)

  it("is made in a time that grows with the mounts of one template", function()
    local function instructions(count)
      local template = state { x = state {}, trans { src = "initial", tgt = "x" } }
      local model = new_model { info = false, warn = false }
      for i = 1, count do model["s" .. i] = template end
      local used = 0
      debug.sethook(function() used = used + 1 end, "", 1000)
      rfsm.init(model)
      debug.sethook()
      return used
    end
    local jit = rawget(_G, "jit")
    if jit then -- traces that other specs left call no hook
      jit.off()
      jit.flush()
    end
    local few, many = instructions(1000), instructions(4000)
    if jit then jit.on() end
    assert.is_true(many < 6 * few, ("%d, %d"):format(few, many))
  end)
end)
