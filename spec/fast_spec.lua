-- rfsm/fast.lua does what the core does. Here: that it is used, that it compiles once,
-- that it knows its limits, and that the core does without it.

local charts = require "spec.support.charts"
local compiling = require "spec.support.compiling"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local share = require "spec.support.share"
local shrink = require "spec.support.shrink"

local conn, state, trans = rfsm.conn, rfsm.state, rfsm.trans

local jit = rawget(_G, "jit")
setup(function() if jit then jit.off() end end) -- compiled code calls no hook
teardown(function() if jit then jit.on() end end)

-- Returns how many texts of paths f(fsm) calls. A text that finds a guard returns at
-- once, and is called again after the search.
local function texts_of(f, fsm)
  local count = 0
  debug.sethook(function()
    if debug.getinfo(2, "S").short_src == "rfsm text" then count = count + 1 end
  end, "c")
  f(fsm)
  debug.sethook()
  return count
end

local function callback() end

local function refuse() return false end

local function go(src, tgt, event, fields)
  fields = fields or {}
  fields.src, fields.tgt, fields.events = src, tgt, event and { event }
  return trans(fields)
end

-- (initial) -> a --e--> b --back--> a, with callbacks, and more members.
local function new_machine(members)
  local model = {
    info = false, warn = false, emem = false, checkevents = false,
    a = state { entry = callback, exit = callback }, b = state { entry = callback },
    c = state {}, go("initial", "a"), go("a", "b", "e", { effect = callback }),
    go("b", "a", "back"), go("c", "a", "back"),
  }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a set
  return assert(rfsm.init(state(model)))
end

local function send(fsm, events)
  for _, event in ipairs(events) do rfsm.send_events(fsm, event) end
end

-- Uses the machine until all is compiled, and sends the events once more.
local function warm(fsm, ...)
  rfsm.run(fsm)
  for _ = 1, 12 do
    send(fsm, { ... })
    rfsm.run(fsm)
    helper.post_and_run(fsm, "back")
  end
  send(fsm, { ... })
end

-- A path over `count` connectors to b.
local function over(count, last)
  local members = { [2] = go("a", count > 0 and "k1" or "b", "e") }
  for i = 1, count do
    members["k" .. i] = conn {}
    members[4 + i] = go("k" .. i, i < count and "k" .. i + 1 or "b", nil,
      i == count and last or nil)
  end
  return members
end

local function with(members, more)
  for key, value in pairs(more) do members[key] = value end -- any order: a set
  return members
end

-- What one event calls in the steady state.
local CASES = {
  { name = "leads straight to a leaf", texts = 1 },
  { name = "has an internal transition", texts = 1,
    members = { [2] = go("a", "internal", "e", { effect = callback }) } },
  { name = "nothing waits for", event = "other", texts = 0 },
  { name = "has a guard", texts = 2,
    members = { [2] = go("a", "b", "e", { guard = callback }) } },
  { name = "has an alternative", texts = 1,
    members = { [2] = go("a", "c", "e", { guard = refuse }),
      [5] = go("a", "b", "e") } },
  { name = "is refused by a guard", texts = 1,
    members = { [2] = go("a", "b", "e", { guard = refuse }) } },
  { name = "is refused by a guard where there is a hook",
    texts = 1,
    members = { [2] = go("a", "b", "e", { guard = refuse }),
      post_step_hook = callback } },
  { name = "is wanted by a predicate", texts = 1,
    members = { [2] = go("a", "b", function(event) return event == "e" end) } },
  { name = "goes over four connectors", members = over(4),
    texts = 1 },
  { name = "goes over five connectors", members = over(5),
    texts = 1 },
  { name = "goes over eight connectors", members = over(8),
    texts = 1 },
  { name = "goes over nine connectors", members = over(9),
    texts = 1 },
  { name = "goes over a connector with a guard",
    members = over(1, { guard = callback }),
    texts = 2 },
  { name = "goes over a connector with two ways",
    texts = 1,
    members = with(over(1, { guard = callback, pn = 1 }), { [6] = go("k1", "c") }) },
  { name = "goes over a connector with a predicate",
    texts = 1,
    members = with(over(1), { [5] = go("k1", "b", refuse), [6] = go("k1", "c") }) },
  { name = "is pending with another", more = "other",
    texts = 1 },
  { name = "finds a pre step hook", texts = 1,
    members = { pre_step_hook = callback } },
  { name = "finds a post step hook", texts = 1,
    members = { post_step_hook = callback } },
  { name = "finds a getevents", texts = 1,
    members = { getevents = function() return {} end } },
  { name = "finds hooks of states", texts = 1,
    change = function(fsm)
      rfsm.entry_hook_add(fsm, fsm.b, callback)
      rfsm.exit_hook_add(fsm, fsm.a, callback)
    end },
  { name = "finds a hook and an alternative",
    texts = 1,
    members = { post_step_hook = callback, [5] = go("a", "b", "e"),
      [2] = go("a", "c", "e", { guard = refuse }) } },
}

describe("an event that", function()
  for _, case in ipairs(CASES) do
    it(case.name .. " is for texts, also in a prepared machine", function()
      for _, is_prepared in ipairs { false, true } do
        local fsm = new_machine(case.members)
        if case.change then case.change(fsm) end
        if is_prepared then rfsm.prepare(fsm) end
        warm(fsm, case.event or "e", case.more)
        assert.equal(case.texts, texts_of(rfsm.step, fsm))
      end
    end)
  end
end)

it("a doo cycle gives the doo its three arguments again", function()
  local seen = {}
  local fsm = new_machine { a = state { doo = function()
    while true do seen = { rfsm.yield() } end
  end } }
  rfsm.step(fsm, 20)
  assert.equal(3, #seen)
  assert.is_true(seen[1] == fsm and seen[2] == fsm.a and seen[3] == "doo")
end)

describe("a text", function()
  it("uses no global", function()
    compiling.with(compiling.strictly, function()
      local compare = dofile("spec/support/runs.lua").compare
      local n = share.count(200)
      for seed = share.seed(n), share.seed(n) + n - 1 do
        assert.is_nil((compare(charts.generate(seed))))
      end
    end)
  end)

  -- Runs f(core, count), in which count() returns how many texts were compiled since it
  -- was last called.
  local function counting(f)
    local count = 0
    compiling.with(function(...)
      count = count + 1
      return compiling.strictly(...)
    end, function(core)
      f(core, function()
        local last = count
        count = 0
        return last
      end)
    end)
  end

  it("is compiled once for all models of the same shape", function()
    counting(function(core, count)
      local function make(a, b)
        local fsm = assert(core.init(core.state { info = false, warn = false,
          [a] = core.state {}, [b] = core.state { entry = callback },
          core.trans { src = "initial", tgt = a },
          core.trans { src = a, tgt = b, events = "e" },
          core.trans { src = a, tgt = b, events = "e_guarded", guard = callback },
        }))
        core.prepare(fsm)
        return fsm
      end
      local first = make("a", "b")
      assert.is_true(count() > 0)
      collectgarbage()
      collectgarbage()
      local second = make("c", "d")
      assert.equal(0, count())
      core.entry_hook_add(first, first.b, callback)
      core.entry_hook_add(second, second.d, callback)
      core.prepare(first)
      assert.is_true(count() > 0)
      core.prepare(second)
      assert.equal(0, count())
    end)
  end)

  it("is forgotten if no machine uses it", function()
    counting(function(core, count)
      local function prepare()
        core.prepare(assert(core.init(core.state { info = false, warn = false,
          a = core.state {}, core.trans { src = "initial", tgt = "a" },
          core.trans { src = "a", tgt = "a", events = "e", effect = callback } })))
      end
      local function drop()
        core.prepare(core.init(core.state {})) -- the latest model is kept
        collectgarbage()
        collectgarbage()
        count()
      end
      prepare()
      drop()
      prepare()
      assert.is_true(count() > 0)
    end)
  end)

  -- Not of charts whose structure changes: other targets, merged elements.
  it("is not compiled in the run of a prepared machine, 100 charts", function()
    counting(function(core, count)
      local prepare, compiled = core.prepare, 0
      core.prepare = function(fsm)
        prepare(fsm)
        count()
      end
      local on_core = dofile("spec/support/runs.lua").on_core
      for seed = 5, 500, 5 do
        local chart = charts.generate(seed)
        local text = shrink.to_lua(chart)
        if not (text:find("retarget", 1, true) or text:find("merge", 1, true)) then
          count()
          on_core(chart)
          compiled = compiled + count()
        end
      end
      assert.equal(0, compiled)
    end)
  end)

  it("is made of a path that is used often, and serves others of its shape", function()
    counting(function(core, count)
      local fsm = core.init(core.state { info = false, warn = false,
        a = core.state {}, core.trans { src = "initial", tgt = "a" },
        core.trans { src = "a", tgt = "a", events = { "e" } },
        core.trans { src = "a", tgt = "a", events = { "guarded" },
          guard = function() end } })
      core.run(fsm)
      count()
      local expected = { e = "^0 [0 ]*1 [0 ]*0 0 0 0$", guarded = "^[0 ]+$" }
      for _, event in ipairs { "e", "guarded" } do
        local counts = {}
        for i = 1, 10 do
          core.send_events(fsm, event)
          core.run(fsm)
          counts[i] = count()
        end
        assert.matches(expected[event], table.concat(counts, " "))
      end
    end)
  end)
end)

if jit then
  it("a text accesses fields without metamethods on LuaJIT", function()
    local lines = {}
    compiling.with(function(text, name)
      for line in text:gmatch("[^\n]+") do lines[#lines + 1] = line end
      return compiling.strictly(text, name)
    end, function(core)
      local on_core = dofile("spec/support/runs.lua").on_core
      core.prepare(core.init(core.state {}))
      for seed = 1, 10 do on_core(charts.generate(seed)) end
    end)
    for _, line in ipairs(lines) do
      for _, access in ipairs { "^fsm%._%w+ =", "^s[01]%._%w+ =", "%f[%w]tr%.[eg]",
        "s[01]%.e", "s[01]%._?doo[_co]* then" } do
        assert.is_nil(line:match(access) and line)
      end
    end
    assert.is_true(#lines > 100)
  end)
end

describe("a machine", function()
  it("is prepared soon, whatever the number of its paths", function()
    local members, used = { [2] = go("a", "k1", "e"), k31 = state {} }, 0
    for i = 1, 30 do
      members["k" .. i] = conn {}
      for j = 1, 2 do
        members[5 + 2 * i + j] = go("k" .. i, "k" .. i + 1, "e", { pn = j })
      end
    end
    local fsm = new_machine(members)
    debug.sethook(function()
      used = used + 1
      if used > 1e4 then error("it takes too long", 0) end
    end, "", 1000)
    local ok, problem = pcall(rfsm.prepare, fsm)
    debug.sethook()
    assert.is_true(ok, problem)
    rfsm.run(fsm)
    assert.equal("root.k31", helper.leaf_after(fsm, "e"))
  end)
end)

describe("a machine in use", function()
  -- Is it in that state after an event, each time? Too much for a text is done without.
  local function check(fsm, expected)
    rfsm.run(fsm)
    for _ = 1, 12 do
      assert.equal(expected, helper.leaf_after(fsm, "e"))
      assert.equal("root.a", helper.leaf_after(fsm, "back"))
    end
  end

  it("enters states that are too many for one text", function()
    local inner, path = state {}, "b" .. (".s"):rep(80)
    for _ = 1, 80 do inner = state { s = inner } end
    check(new_machine { b = inner, [2] = go("a", path, "e") }, "root." .. path)
  end)

  it("shows callbacks the same of itself in each passage", function()
    local seen = {}
    local function id(node) return node and node._id or tostring(node) end
    local function note(fsm, _, what)
      local text = ("%s %s %s"):format(what, id(fsm._actchild), id(fsm.a._actchild))
      seen[#seen + 1] = text
    end
    local function noting(members)
      members.entry, members.exit = note, note
      return state(members)
    end
    local fsm = assert(rfsm.init(state { info = false, warn = false,
      a = noting { x = noting {}, go("initial", "x") }, b = noting {},
      go("initial", "b"), go("b", "a", "e"), go("a", "b", "e"),
    }))
    rfsm.run(fsm)
    for _ = 1, 12 do
      seen = {}
      send(fsm, { "e" })
      rfsm.run(fsm)
      send(fsm, { "e" })
      rfsm.run(fsm)
      assert.same({ "exit nil nil", "entry a nil", "entry a x", "exit a nil",
        "exit nil nil", "entry b nil" }, seen)
    end
  end)

  it("asks many transitions, and a connector that is reached twice", function()
    local members = { k = conn {}, [2] = go("a", "k", "e", { guard = refuse }),
      [5] = go("a", "k", "e"), [6] = go("k", "b", nil, { guard = callback }) }
    check(new_machine(members), "root.b")
    for i = 7, 60 do members[i] = go("a", "c", "e", { guard = refuse, pn = 1 }) end
    check(new_machine(members), "root.b")
  end)

  it("takes a path over 3,000 connectors", function()
    check(new_machine(over(3000)), "root.b")
    check(new_machine(over(3000, { guard = callback })), "root.b")
  end)

  it("stays in a ring of connectors", function()
    check(new_machine { k = conn {}, m = conn {}, [2] = go("a", "k", "e"),
      [5] = go("k", "m"), [6] = go("m", "k") }, "root.a")
  end)

  -- Where a function is called, and how it gets there.
  local PLACES = {
    entry = function(fsm, f) fsm.b.entry = f end,
    exit = function(fsm, f) fsm.a.exit = f end,
    effect = function(fsm, f) fsm[2].effect = f end,
    guard = function(fsm, f) fsm[2].guard = f end,
    doo = function(fsm, f) fsm.b.doo = f end,
    getevents = function(fsm, f) fsm.getevents = f end,
    pre_step_hook = function(fsm, f) fsm.pre_step_hook = f end,
    post_step_hook = function(fsm, f) fsm.post_step_hook = f end,
    entry_hook = function(fsm, f) rfsm.entry_hook_add(fsm, fsm.b, f) end,
    ["an entry behind an exit that sets dbg"] = function(fsm, f)
      fsm.a.exit = function() fsm.dbg = callback end
      fsm.b.entry = f
    end,
    ["an entry on two events"] = function(fsm, f)
      fsm.b.entry = f
      rfsm.send_events(fsm, "other")
    end,
    ["an entry behind a guard that sets dbg"] = function(fsm, f)
      fsm[2].guard = function() fsm.dbg = callback end
      fsm.b.entry = f
    end,
  }
  for _, place in ipairs(rfsm.sorted_keys(PLACES)) do
    it("refuses a step from inside: " .. place, function()
      local fsm, problems = new_machine { [5] = go("a", "c", "e", { pn = -1 }) }, {}
      warm(fsm, "e")
      PLACES[place](fsm, function()
        local _, problem = pcall(rfsm.step, fsm)
        problems[#problems + 1] = problem
        return nil
      end)
      rfsm.step(fsm)
      if place == "doo" then rfsm.step(fsm) end
      assert.matches("rfsm.step: the machine is in the middle of a step;", problems[1])
      assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    end)
  end

  it("gets children for a leaf from its post step hook", function()
    local fsm, is_merged = new_machine(), nil
    warm(fsm)
    fsm.post_step_hook = function()
      is_merged = rfsm.fsm_merge(fsm, fsm.c, conn {}, "initial")
      fsm.post_step_hook = nil
    end
    helper.post_and_run(fsm, "e")
    assert.is_true(is_merged)
  end)
end)

describe("without rfsm.fast", function()
  local load = rawget(_G, "loadstring") or rawget(_G, "load")

  local function flip_flop(core)
    return core.init(core.state { info = false, warn = false,
      a = core.state {}, b = core.state {}, core.trans { src = "initial", tgt = "a" },
      core.trans { src = "a", tgt = "b", events = "e", guard = function() end },
      core.trans { src = "b", tgt = "a", events = "e" } })
  end

  -- The machine does what it always does, and without a text.
  local function check(core)
    for _, is_prepared in ipairs { false, true } do
      local fsm, leaves = flip_flop(core), {}
      if is_prepared then core.prepare(fsm) end
      for i = 0, 25 do
        if i > 0 then core.send_events(fsm, "e") end
        assert.equal(0, texts_of(core.run, fsm))
        leaves[#leaves + 1] = core.get_actleaf_fqn(fsm):sub(-1)
      end
      assert.equal(("ab"):rep(13), table.concat(leaves))
    end
  end

  local function raising(...)
    local failure = { ... }
    return function() error(failure[1], 0) end
  end

  -- What stands in the place of the file.
  local LOADERS = {
    ["that raises a text"] = raising "no",
    ["that raises that memory is short"] = raising "not enough memory",
    ["that raises a table"] = raising {},
    ["that raises nil"] = raising(nil),
    ["that returns a text"] = function() return "fast" end,
    ["that returns a function that raises"] = function() return raising {} end,
  }
  for _, what in ipairs(rfsm.sorted_keys(LOADERS)) do
    it("a machine goes on: a file " .. what, function()
      compiling.with(load, function(core)
        helper.with(package.preload, { ["rfsm.fast"] = LOADERS[what] }, function()
          check(core)
        end)
      end)
    end)
  end

  -- What stands in the place of loadstring.
  local COMPILERS = {
    ["is missing"] = false,
    ["refuses"] = function() return nil, "no" end,
    ["is short of memory"] = raising "not enough memory",
    ["raises a text"] = raising "load is forbidden here",
  }
  for _, what in ipairs(rfsm.sorted_keys(COMPILERS)) do
    it("a machine goes on: a compiler that " .. what, function()
      compiling.with(COMPILERS[what] or nil, check)
    end)
  end

  it("a machine calls no __eq of a target that is no node", function()
    local fsm = flip_flop(rfsm)
    fsm.err = false
    for _ = 1, 10 do helper.post_and_run(fsm, "e") end
    fsm[2].tgt = setmetatable({}, { __eq = function() return true end })
    fsm[3].tgt = fsm[2].tgt
    local leaf = rfsm.get_actleaf_fqn(fsm)
    helper.post_and_run(fsm, "e")
    assert.equal(leaf, rfsm.get_actleaf_fqn(fsm))
  end)

  -- a -> k1 =10=> k2 =10=> ... b: 10,000 paths
  it("a machine makes a bounded number of paths before they are taken", function()
    local model = { info = false, warn = false, a = rfsm.state {}, b = rfsm.state {},
      rfsm.trans { src = "initial", tgt = "a" },
      rfsm.trans { src = "a", tgt = "k1", events = { "e" } } }
    for i = 1, 4 do
      model["k" .. i] = rfsm.conn {}
      for pn = 1, 10 do
        model[#model + 1] = rfsm.trans { src = "k" .. i, pn = pn,
          tgt = i < 4 and "k" .. i + 1 or "b" }
      end
    end
    local fsm = rfsm.init(rfsm.state(model))
    debug.sethook(function() error("too many instructions") end, "", 500000)
    local ok, problem = pcall(rfsm.prepare, fsm)
    debug.sethook()
    assert.same({ true }, { ok, problem })
  end)

  it("a machine goes on after rfsm.save_memory", function()
    compiling.with(load, function(core)
      core.save_memory()
      check(core)
    end)
  end)

  -- A plan of its own is changed by preproc functions, not copied.
  it("a machine has the events and targets of preproc functions after it",
    function()
      compiling.with(load, function(core)
        core.save_memory()
        core.preproc[1] = function(fsm)
          fsm[2].events, fsm[3].pn = { "go" }, 1
          core.run(fsm) -- what a run notes is not kept
          core.send_events(fsm, "e")
          core.run(fsm)
          fsm[2].tgt = fsm.c
        end
        local fsm = core.init(core.state { info = false, warn = false,
          a = core.state {}, b = core.state {}, c = core.state {},
          core.trans { src = "initial", tgt = "a" },
          core.trans { src = "a", tgt = "b", events = { "e" } },
          core.trans { src = "a", tgt = "b", events = { "other" } } })
        core.reset(fsm)
        core.run(fsm)
        core.send_events(fsm, "go")
        core.run(fsm)
        assert.same({ "root.c", 1, "go" },
          { core.get_actleaf_fqn(fsm), fsm[3].pn, fsm[2].events[1] })
      end)
    end)

  it("a machine is made again if Control-C came while the file was loaded", function()
    compiling.with(load, function(core)
      local preload = { ["rfsm.fast"] = raising "interrupted!" }
      helper.with(package.preload, preload, function()
        assert.same({ false, "interrupted!" }, { pcall(flip_flop, core) })
      end)
      assert.is_true(core.run(flip_flop(core)))
    end)
  end)
end)
