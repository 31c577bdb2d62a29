-- Sequential AND states.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local share = require "spec.support.share"

local state, trans, seqand = rfsm.state, rfsm.trans, rfsm.seqand
local init, started, run = helper.init, helper.started, helper.post_and_run

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

-- (initial) -> a --e_x--> b --e_x--> a, noting entries and exits as "NAME entry a".
local function region(trace, name)
  local function note(_, self, what)
    trace[#trace + 1] = name .. " " .. what .. " " .. self._id
  end
  local function noting() return state { entry = note, exit = note } end
  return state {
    warn = false, info = false, entry = note, exit = note,
    a = noting(), b = noting(),
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e_x" } },
    trans { src = "b", tgt = "a", events = { "e_x" } },
  }
end

-- (initial) -> a with these callbacks --e_x--> b with those
local function plain(a, b, fields)
  fields = fields or {}
  fields.warn, fields.info, fields.a, fields.b = false, false, state(a), state(b or {})
  fields[1] = trans { src = "initial", tgt = "a" }
  fields[2] = trans { src = "a", tgt = "b", events = { "e_x" } }
  return state(fields)
end

-- (initial) -> par --e_leave--> off --e_enter--> par
local function parent(par)
  return state {
    warn = false, info = false, par = par, off = state {},
    trans { src = "initial", tgt = "par" },
    trans { src = "par", tgt = "off", events = { "e_leave" } },
    trans { src = "off", tgt = "par", events = { "e_enter" } },
  }
end

-- One with the regions left and right.
local function two(trace, fields)
  fields = fields or {}
  fields.left, fields.right = region(trace, "left"), region(trace, "right")
  return seqand(fields)
end

local function started_two(trace, fields) return started(parent(two(trace, fields))) end

-- A region that notes its cycles; each is one doo cycle.
local function worker(trace, name, cycles)
  return plain { doo = function()
    for i = 1, cycles or 1000 do
      trace[#trace + 1] = name .. " " .. i
      rfsm.yield(cycles == nil)
    end
  end }
end

local function leaves(par)
  local names = {}
  for i, name in ipairs { "left", "right" } do
    local fsm = par.substates[name]
    names[i] = fsm and rfsm.get_actleaf_fqn(fsm) or "none"
  end
  return table.concat(names, " ")
end

it("a sequential AND state stands where its constructor was called", function()
  local line = debug.getinfo(1, "l").currentline + 1
  local par = rfsm.seqand { left = state { a = state {}, trans {
    src = "initial", tgt = "a" } } }
  local fsm = helper.init(state { warn = false, par = par,
    trans { src = "initial", tgt = "par" } })
  local at = rfsm.location_of(fsm.par):match("seqand_spec.lua:(%d+): root.par$")
  assert.is_true(tonumber(at) == line or tonumber(at) == line + 1) -- of several lines
end)

describe("rfsm.seqand", function()
  it("is the module rfsm_seqand, and returns a leaf state", function()
    assert.equal(seqand, rawget(_G, "rfsm_seqand"))
    assert.equal(require "rfsm_seqand", seqand)
    assert.is_true(rfsm.is_leaf(two {}))
  end)

  it("may be called as rfsm.seqand:new and rfsm_seqand.new", function()
    for _, par in ipairs { seqand:new { left = region({}, "left") },
      require("rfsm_seqand").new { left = region({}, "left") } } do
      assert.equal("root.a none", leaves(started(parent(par)).par))
    end
  end)

  it("takes regions at positions, before those with names", function()
    local trace = {}
    local fsm = started(parent(seqand {
      order = { 2 }, left = region(trace, "left"), region(trace, "one"),
      region(trace, "two"),
    }))
    assert.same({ "two entry root", "two entry a", "one entry root", "one entry a",
      "left entry root", "left entry a" }, trace)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm.par.substates[2]))
  end)

  it("leaves the table it is given as it is, and keeps the user's data", function()
    local fields = { left = region({}, "left"), colour = "red" }
    assert.equal("red", init(parent(seqand(fields))).par.colour)
    assert.is_nil(fields.doo)
    assert.is_table(fields.left)
  end)

  it("asks no __eq of the table it is given", function()
    local class = { __eq = function() error("compared") end }
    assert.is_true(rfsm.is_state(rfsm.seqand(setmetatable({}, class))))
  end)

  it("may be the root of a machine", function()
    local fsm = started(two({}, { warn = false, info = false }))
    run(fsm, "e_x")
    rfsm.run(fsm)
    assert.equal("root.b root.b", leaves(fsm))
  end)

  it("runs regions that are leaves", function()
    local trace = {}
    local fsm = started(parent(seqand { left = state { warn = false,
      entry = helper.noting(trace, "in"), exit = helper.noting(trace, "out") } }))
    run(fsm, "e_leave")
    assert.same({ "in", "out" }, trace)
  end)
end)

describe("a wrong sequential AND state", function()
  -- The message, which points at the caller, and the fields.
  for _, case in ipairs {
    { "step: either a number of steps or run = true, not both",
      { step = 2, run = true } },
    { "step: number of steps expected, got string '2'", { step = "2" } },
    { "run: boolean expected, got number 1", { run = 1 } },
    { "order: list of names expected, got string 'left'", { order = "left" } },
    { "order[1]: name of a region expected, got string 'up' (there are '1', 'left')",
      { order = { "up" }, state {} } },
    { "idle_doo: true, false or 'auto' expected, got number 1", { idle_doo = 1 } },
    { "idle.doo: true, false or 'auto' expected, got string 'no'",
      { ["idle.doo"] = "no" } },
    { "doo: is the state's own, and cannot be set", { doo = print } },
    { "substates: is the state's own, and cannot be set", { substates = {} } },
    { "entry: cannot be a state", { entry = state {} } },
    { "run: cannot be a state", { run = state {} } },
    { "k: cannot be a connector", { k = rfsm.conn {} } },
    { "[1]: state expected, got function", { function() end } },
    { "doo: is the state's own, and cannot be set", -- the least text
      { state {}, doo = print, substates = {}, run = state {}, k = rfsm.conn {} } },
  } do
    it("is refused: " .. case[1], function()
      case[2].left = region({}, "left")
      assert.equal("rfsm.seqand: " .. case[1], helper.refusal(seqand.new, case[2]))
    end)
  end

  it("is refused without fields, and for an order without regions", function()
    assert.equal("rfsm.seqand: table expected, got nil", helper.refusal(seqand.new))
    assert.equal("rfsm.seqand: table expected, got state", helper.refusal(seqand.new,
      rfsm.state { a = rfsm.state {} }))
    assert.equal("rfsm.seqand: table expected, got the library (rfsm.f, not rfsm:f)",
      helper.refusal(seqand.new, rfsm))
    local _, text = pcall(function() return (seqand { order = { "up" } }) end)
    assert.matches("seqand_spec.lua:%d+: rfsm%.seqand: order%[1%]: name of a region "
      .. "expected, got string 'up' %(there are none%)$", text)
  end)

  local function broken(left, tgt)
    return state { err = false, warn = false, info = false, left = left, a = state {},
      trans { src = "initial", tgt = tgt } }
  end

  it("with a region that is wrong is a problem of the model, with its place", function()
    local model = parent(seqand { left = broken(nil, "b") })
    model.err = false
    local _, _, problems = rfsm.init(model)
    assert.equal(1, #problems)
    assert.matches("^spec/seqand_spec.lua:%d+: root.par.left: root.trans%[1%] "
      .. "%(initial %-> b%): tgt 'b': no state or connector is named 'b' in 'root'",
      problems[1])
  end)

  for name, own in pairs { -- any order: each stands alone
    ["a region without err"] = function(left) left.err = nil return left end,
    ["a region in a region"] = function(left)
      left.err = nil
      local outer = parent(seqand { left = left })
      outer.err = nil
      return outer
    end,
  } do
    it("tells the problems of " .. name .. " once", function()
      local told = {}
      local model = parent(seqand { left = own(broken(nil, "b")) })
      model.err = function(line) told[#told + 1] = line end
      rfsm.init(model)
      assert.equal(1, #told)
      assert.truthy(told[1]:find("root.par.left: ", 1, true))
    end)
  end

  it("gives a region without err that of its parent machine", function()
    local told = {}
    local model = parent(seqand { left = state { info = false, warn = false,
      a = state { entry = function() error("no", 0) end },
      trans { src = "initial", tgt = "a" } } })
    model.err = function(...) told[#told + 1] = select(3, ...) end
    rfsm.run(init(model))
    assert.same({ "no" }, told)
  end)

  it("with a transition warns", function()
    local lines = {}
    local model = parent(seqand { left = region({}, "left"), trans { src = "left" } })
    model.warn = function(line) lines[#lines + 1] = line:match("root%.par: .*") end
    init(model)
    assert.same({ "root.par: a transition in a sequential AND state, it belongs into a "
      .. "region (none leads from one region to another)" }, lines)
  end)

  it("that contains itself is a problem of the model", function()
    local inner = broken(nil, "a")
    inner.a = seqand { left = inner }
    local fsm, _, problems = rfsm.init(inner)
    assert.is_false(fsm)
    assert.matches("a sequential AND state cannot contain itself", problems[1])
  end)
end)

describe("entry and exit", function()
  local ENTERED = { "right entry root", "right entry a", "left entry root",
    "left entry a" }
  local LEFT = { "right exit b", "right exit root", "left exit b", "left exit root" }

  it("are the user's around an advance and the end of each region", function()
    local trace = {}
    local function note(_, self, what) trace[#trace + 1] = what .. " " .. self._fqn end
    local fsm = init(parent(two(trace, { order = { "right", "left" }, entry = note,
      exit = note })))
    rfsm.step(fsm)
    assert.same({ "entry root.par", unpack(ENTERED) }, trace)
    rfsm.run(fsm)
    run(fsm, "e_x")
    rfsm.run(fsm)
    helper.clear(trace)
    run(fsm, "e_leave")
    LEFT[5] = "exit root.par"
    assert.same(LEFT, trace)
    assert.equal("none none", leaves(fsm.par))
    assert.same({ "e_init_fsm" }, fsm.par.substates.left._intq)
    helper.clear(trace)
    run(fsm, "e_enter")
    assert.same({ "entry root.par", unpack(ENTERED) }, trace)
  end)

  it("of the user that fail go to err, and the regions are entered", function()
    local trace = {}
    local model = parent(two(trace, { entry = function() error("no", 0) end }))
    local errors = helper.said(model, "err")
    rfsm.step(init(model))
    assert.same({ "ENTRY error executing entry of root.par:  no" }, errors)
    assert.equal("right entry a", trace[#trace])
  end)

  it("set on the model, or replaced by a tool, are the user's, too", function()
    local trace = {}
    local model = parent(two(trace))
    model.par.entry = helper.noting(trace, "mine")
    local fsm = started(model)
    assert.equal("mine left entry root", trace[1] .. " " .. trace[2])
    fsm.par.exit = helper.noting(trace, "tool")
    helper.clear(trace)
    run(fsm, "e_leave")
    assert.equal("tool left exit a", trace[1] .. " " .. trace[2])
  end)

  it("do not exit a region that was never entered", function()
    local trace = {}
    local closed = plain({}, {}, { err = false, exit = helper.noting(trace, "exit") })
    closed[1].guard = function() return false end
    run(started(parent(seqand { left = closed })), "e_leave")
    assert.same({}, trace)
  end)
end)

describe("doo", function()
  it("that an interrupt ends is begun anew", function()
    local fsm, yield = started_two({}), rfsm.yield
    rfsm.send_events(fsm, "e_x")
    rfsm.yield = function() error("interrupted!", 0) end -- called outside of any pcall
    local ok, failure = pcall(rfsm.step, fsm)
    rfsm.yield = yield
    assert.same({ false, "interrupted!" }, { ok, failure })
    rfsm.run(fsm)
    assert.equal("root.b root.b", leaves(fsm.par))
    helper.post_and_run(fsm, "e_x")
    rfsm.run(fsm)
    assert.equal("root.a root.a", leaves(fsm.par))
  end)

  -- The fields, the cycles of each worker, what they note in the entry and after it.
  for _, case in ipairs {
    { "steps each region once, by name", fields = {},
      cycles = { c = 9, a = 9, b = 9 }, trace = "| a 1 b 1 c 1" },
    { "steps those of order first, a duplicate once",
      fields = { order = { "c", "c" } }, cycles = { c = 9, a = 9, b = 9 },
      trace = "| c 1 a 1 b 1" },
    { "steps as often as step says, while the regions are busy",
      fields = { step = 3 }, cycles = { a = 9, b = 9 },
      trace = "a 1 a 2 b 1 b 2 | a 3 a 4 a 5 b 3 b 4 b 5" },
    { "runs each region when run is set", fields = { run = true },
      cycles = { a = 3, b = 2 }, trace = "a 1 a 2 a 3 b 1 b 2 |" },
    { "runs all work in one run when idle_doo is 'auto'",
      fields = { idle_doo = "auto" }, cycles = { a = 3, b = 5 },
      trace = "| a 1 b 1 a 2 b 2 a 3 b 3 b 4 b 5" },
  } do
    it(case[1], function()
      local trace, fields = {}, case.fields
      for name, cycles in pairs(case.cycles) do -- any order: a set
        fields[name] = worker(trace, name, cycles)
      end
      local fsm = init(parent(seqand(fields)))
      rfsm.step(fsm)
      local entered = #trace
      assert.is_true(rfsm.run(fsm))
      table.insert(trace, entered + 1, "|")
      assert.equal(case.trace, table.concat(trace, " "))
    end)
  end

  for _, field in ipairs { "idle_doo", "idle.doo" } do
    it("is never idle when " .. field .. " is false", function()
      local par = seqand { a = region({}, "a"), [field] = false }
      assert.is_false(rfsm.step(init(parent(par)), 50))
    end)
  end

  it("processes an event in the same run when idle_doo is 'auto'", function()
    local fsm = started_two({}, { idle_doo = "auto" })
    run(fsm, "e_x", "e_x")
    assert.equal("root.b root.b", leaves(fsm.par))
  end)

  it("survives a region whose program fails", function()
    local trace = {}
    local bad = plain { doo = function() error("no", 0) end }
    local errors = helper.said(bad, "err", "DOO")
    local fsm = init(parent(seqand { a = bad, b = worker(trace, "b") }))
    for _ = 1, 5 do rfsm.run(fsm) end
    assert.equal(1, #errors)
    assert.equal("b 4", trace[4])
  end)

  it("survives a region that raises, the caller gets the error", function()
    local trace = {}
    local bad = region({}, "bad")
    bad.getevents = function() error("no bus", 0) end
    local fsm = init(parent(seqand { a = bad, b = worker(trace, "b") }))
    for _ = 1, 3 do
      assert.error_matches(function() rfsm.step(fsm) end, "no bus")
    end
    assert.same({ "b 1", "b 2" }, trace)
    assert.equal("root.par", rfsm.get_actleaf_fqn(fsm))
  end)

  it("lets a region reset itself", function()
    local entries, self = 0, nil
    local fsm = started(parent(seqand { idle_doo = "auto", left = plain({
      entry = function(fsm) entries, self = entries + 1, fsm end,
    }, { entry = function() rfsm.reset(self) end }) }))
    run(fsm, "e_x")
    assert.equal(2, entries)
    assert.equal("root.a none", leaves(fsm.par))
  end)

  local ORDER = "SEQAND root.par: order right, left"

  for _, field in ipairs { "andseqdbg", "seqanddbg" } do
    it("prints the order once and each advance when " .. field .. " is set", function()
      local model = parent(two({}, { order = { "right" }, [field] = true }))
      local said = helper.said(model, "info")
      local fsm = init(model)
      helper.clear(said)
      rfsm.run(fsm)
      local right = "SEQAND root.par: right advanced to root.a"
      local left = "SEQAND root.par: left advanced to root.a"
      assert.same({ ORDER, right, left, right, left }, said)
      helper.clear(said)
      run(fsm, "e_leave")
      run(fsm, "e_enter")
      assert.same({ right, left, right, left }, said)
    end)

    it("prints that by print when info is off, and to a function: " .. field,
      function()
        for _, live in ipairs { true, false } do
          local lines = helper.printed(function()
            local fsm = init(parent(two({}, { order = { "right" }, [field] = true })))
            if live then fsm.info = false end
            rfsm.step(fsm)
          end)
          assert.same({ ORDER, 3 }, { lines[1], #lines })
        end
        local said = {}
        rfsm.step(init(parent(two({}, { order = { "right" },
          [field] = function(text) said[#said + 1] = text end }))))
        assert.same({ ORDER, 3 }, { said[1], #said })
      end)
  end
end)

describe("an event", function()
  local function received_by(fsm, ...)
    local trace = {}
    for _, name in ipairs { "left", "right" } do
      rfsm.pre_step_hook_add(fsm.par.substates[name], function(_, events)
        for i = 1, #events do trace[#trace + 1] = name .. " " .. events[i] end
      end)
    end
    run(fsm, ...)
    return trace
  end

  local function settled(fields, again)
    local model = parent(two({}, fields))
    model[4] = again
    local fsm = init(model)
    for _ = 1, 3 do rfsm.run(fsm) end
    return fsm
  end

  it("of the parent machine goes to every region", function()
    assert.same({ "left e_y", "left e_z", "right e_y", "right e_z" },
      received_by(settled(), "e_y", "e_z"))
  end)

  it("from getevents goes to every region, while hooks come and go", function()
    local fsm, events = settled(), { "e_y" }
    fsm.getevents = function() return { table.remove(events) } end
    local function hook() end
    rfsm.pre_step_hook_add(fsm, function()
      rfsm.post_step_hook_rm(fsm, hook)
      rfsm.post_step_hook_add(fsm, hook, "before")
    end)
    assert.same({ "left e_y", "right e_y" }, received_by(fsm))
  end)

  it("that makes the state leave goes to none, nor do those beside it", function()
    assert.same({}, received_by(settled(), "e_x", "e_leave"))
  end)

  it("that makes the state be entered goes to every region", function()
    local fsm = settled()
    run(fsm, "e_leave")
    assert.same({ "left e_init_fsm", "right e_init_fsm", "left e_done@root.a",
      "left e_enter", "left e_x", "right e_done@root.a", "right e_enter", "right e_x" },
      received_by(fsm, "e_enter", "e_x"))
  end)

  it("that leaves the state and enters it again goes to every region", function()
    local fsm = settled({}, trans { src = "par", tgt = "par", events = { "e_again" } })
    run(fsm, "e_again", "e_x")
    assert.equal("root.b root.b", leaves(fsm.par))
  end)

  it("reaches the regions once, also under events that never end", function()
    local fsm, count, expected, trace = settled(), 0, {}, {}
    fsm.getevents = function()
      count = count + 1
      return { count }
    end
    rfsm.pre_step_hook_add(fsm.par.substates.left, function(_, events)
      for i = 1, #events do trace[#trace + 1] = events[i] end
    end)
    for _ = 1, 20 do
      rfsm.step(fsm)
      assert.equal(count, #trace) -- also those of the iteration of the doo
    end
    for i = 1, #trace do expected[i] = i end
    assert.same(expected, trace)
    assert.is_true(#trace >= 15)
  end)

  it("may be anything, and 100,000 in one step are no problem", function()
    local fsm, sum, storm = settled { run = true }, 0, {}
    rfsm.pre_step_hook_add(fsm.par.substates.right, function(_, events)
      sum = sum + #events
    end)
    for i = 1, 100000 do storm[i] = i end
    fsm.getevents = function()
      local events = storm
      storm = nil
      return events
    end
    rfsm.run(fsm)
    assert.equal(100000, sum)
  end)
end)

describe("nesting", function()
  local function auto(fields)
    fields.idle_doo, fields.warn, fields.info = "auto", false, false
    return seqand(fields)
  end

  for name, wrap in pairs { -- any order: two specs
    ["in a machine"] = function(par)
      return state { warn = false, info = false, par = par,
        trans { src = "initial", tgt = "par" } }
    end,
    directly = function(par) return par end,
  } do
    it("carries events down and leaves from inside out: " .. name, function()
      local trace = {}
      local inner = wrap(auto { leaf = region(trace, "leaf") })
      local fsm = started(parent(auto { inner = inner }))
      run(fsm, "e_x")
      run(fsm, "e_leave")
      assert.same({ "leaf entry root", "leaf entry a", "leaf exit a", "leaf entry b",
        "leaf exit b", "leaf exit root" }, trace)
    end)
  end

  for _, read in ipairs { "one", "all", "late" } do
    it("has regions read as the machine around them: " .. read, function()
      local inner = parent(seqand { leaf = plain({}) })
      local model = parent(seqand { inner = inner })
      model.read = read ~= "late" and "one" or nil
      inner.read = read == "all" and read or nil
      local fsm = init(model)
      fsm.read = "one"
      rfsm.run(fsm)
      local leaf = fsm.par.substates.inner.par.substates.leaf
      rfsm.send_events(leaf, "e_other", "e_x")
      rfsm.step(leaf)
      assert.equal(read == "all" and "root.b" or "root.a", leaf._act_leaf._fqn)
      rfsm.step(leaf)
      assert.equal("root.b", leaf._act_leaf._fqn)
    end)
  end

  it("has a region read as the machine does, which has one event then", function()
    local taken, counts = 0, {}
    local inner = state { warn = false, info = false, a = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "internal", events = "e",
        effect = function() taken = taken + 1 end } }
    local model = parent(seqand { inner = inner })
    model.read = "all"
    local fsm = init(model)
    rfsm.run(fsm)
    for i, read in ipairs { "one", false, "one" } do
      fsm.read, taken = read, 0
      rfsm.send_events(fsm.par.substates.inner, "e", "e", "e")
      for _ = 1, 4 do rfsm.step(fsm) end
      counts[i] = taken
    end
    assert.same({ 3, 1, 3 }, counts)
  end)

  it("is not kept waiting for ever by transitions that are taken around it", function()
    require "rfsm_timeevent"
    local now, most = 0, 0
    local inner = state { warn = false, info = false, a = state {}, b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = "e_after(1)" } }
    local model = parent(seqand { inner = inner })
    model[4] = trans { src = "par", tgt = "internal", events = "e_busy" }
    function model.gettime() return now, 0 end
    local fsm = init(model)
    rfsm.run(fsm)
    local machine = fsm.par.substates.inner
    for second = 1, 200 do
      now = second
      rfsm.send_events(fsm, "e_busy")
      rfsm.step(fsm)
      most = math.max(most, #machine._intq)
    end
    assert.equal("root.b", rfsm.get_actleaf_fqn(machine))
    assert.is_true(most <= 65)
  end)
end)

describe("a machine given as a region", function()
  local function given_and_model()
    local given = init(region({}, "left"))
    return given, parent(seqand { left = given, idle_doo = "auto" })
  end

  it("is that region in the first machine of the model", function()
    local given, model = given_and_model()
    local records = helper.said(given, "dbg", "STATE_ENTER")
    local fsm = started(model)
    rfsm.send_events(given, "e_x")
    rfsm.run(fsm)
    assert.equal(given, fsm.par.substates.left)
    assert.equal("root.b", given._act_leaf._fqn)
    assert.same({ "STATE_ENTER root", "STATE_ENTER root.a", "STATE_ENTER root.b" },
      records)
  end)

  it("stands for its model in further ones, with what was set on it", function()
    local chart_with_err = region({}, "left")
    chart_with_err.err = false
    local given = init(chart_with_err)
    local model = parent(seqand { left = given, idle_doo = "auto" })
    local records = helper.said(given, "dbg", "STATE_ENTER")
    local fields = { "info", "warn", "err", "getevents", "pre_step_hook",
      "post_step_hook", "gettime" }
    for _, field in ipairs(fields) do given[field] = function() end end
    local first, second = started(model), init(model)
    helper.clear(records)
    rfsm.run(second)
    local region_of_second = second.par.substates.left
    assert.not_equal(given, region_of_second)
    for _, field in ipairs(fields) do
      assert.equal(given[field], region_of_second[field])
    end
    assert.same({ "STATE_ENTER root", "STATE_ENTER root.a" }, records)
    run(second, "e_x")
    assert.equal("root.a root.b", first.par.substates.left._act_leaf._fqn .. " "
      .. region_of_second._act_leaf._fqn)
  end)

  it("at two places is the region of the first one", function()
    local given = init(region({}, "left"))
    local model = parent(seqand { left = given })
    model.off = seqand { left = given }
    local fsm = init(model)
    local is_given = fsm.par.substates.left == given
    assert.not_equal(is_given, fsm.off.substates.left == given)
  end)

  it("is left and reset with the state, and by a reset", function()
    local given, model = given_and_model()
    local fsm = started(model)
    run(fsm, "e_leave")
    assert.is_false(rfsm.get_actleaf_fqn(given))
    run(fsm, "e_enter")
    rfsm.reset(fsm)
    assert.same({ false, { "e_init_fsm" } }, { given._act_leaf, given._intq })
  end)

  it("is free again if the parent machine is not valid", function()
    local given, model = given_and_model()
    helper.with_preproc(function() return { "root: no" } end, function()
      model.err = false
      assert.is_false((rfsm.init(model)))
    end)
    assert.equal(given, init(model).par.substates.left)
  end)

  it("is left alone by checks and by the structure of snapshots", function()
    local given, model = given_and_model()
    local checks, snapshot = require "rfsm_checks", require "rfsm.snapshot"
    checks.check(model)
    checks.explore(model)
    snapshot.structure(model)
    assert.same({ false, { "e_init_fsm" } }, { given._act_leaf, given._intq })
    assert.equal(given, started(model).par.substates.left)
  end)

  it("is restored as a part of the parent machine", function()
    local snapshot = require "rfsm.snapshot"
    local fsm = started((select(2, given_and_model())))
    run(fsm, "e_x")
    local given, model = given_and_model()
    assert(snapshot.restore(model, snapshot.take(fsm)))
    assert.equal("root.b", rfsm.get_actleaf_fqn(given))
  end)
end)

describe("instances", function()
  it("of one model have regions of their own, a hundred side by side", function()
    local model, machines = parent(two({}, { idle_doo = "auto" })), {}
    for i = 1, 100 do machines[i] = started(model) end
    for i = 1, 100, 2 do run(machines[i], "e_x") end
    for i = 1, 100 do
      local expected = i % 2 == 1 and "root.b root.b" or "root.a root.a"
      assert.equal(expected, leaves(machines[i].par))
    end
  end)

  it("of a machine have regions of their own", function()
    local first = init(parent(two {}))
    assert.not_equal(first.par.substates.left, init(first).par.substates.left)
  end)

  it("report what init finds in their regions, by the printer of the region", function()
    local told = plain {}
    local said = helper.said(told, "info")
    local model = seqand { silent = plain {}, told = told }
    init(model)
    init(model)
    local text = "INFO: created undeclared connector root.initial"
    assert.same({ text, text }, said)
  end)

  it("report by the printers of the parent machine if the region has none", function()
    local function failing(fields)
      fields.a = fields.a or state { entry = function() error("no", 0) end }
      fields[1] = trans { src = "initial", tgt = "a" }
      return state(fields)
    end
    local given = failing {}
    local model = seqand { deep = failing { a = seqand { given } }, given = given,
      own = init(failing { info = false, warn = false, err = false }) }
    local said, warned = helper.said(model, "info"), helper.said(model, "warn")
    local told = helper.said(model, "err")
    started(model)
    local info = "INFO: created undeclared connector root.initial"
    local failure = "ENTRY error executing entry of root.a:  no"
    assert.same({ { info, info, info }, { failure, failure } }, { said, told })
    assert.matches("no outgoing transitions from node 'root.a'", warned[1])
    assert.same({}, { given.info, given.warn, given.err })
  end)

  it("mounted twice, or merged, have regions of their own", function()
    local par = two {}
    local model = parent(par)
    model.off = par
    local fsm = started(model)
    assert.equal("root.a root.a", leaves(fsm.par))
    assert.equal("none none", leaves(fsm.off))
    assert.is_true(rfsm.fsm_merge(fsm, fsm, par, "more"))
    assert.is_true(rfsm.fsm_merge(fsm, fsm, trans { src = "par", tgt = "more",
      events = { "e_more" } }))
    run(fsm, "e_more")
    assert.equal("root.a root.a", leaves(fsm.more))
  end)
end)

describe("a snapshot", function()
  local snapshot = require "rfsm.snapshot"

  it("has the regions, and is put without an advance", function()
    local trace = {}
    local model = parent(two(trace, { step = 2 }))
    local fsm = started(model)
    rfsm.send_events(fsm.par.substates.left, "e_x")
    rfsm.run(fsm)
    local snap = snapshot.take(fsm)
    helper.clear(trace)
    local other = assert(snapshot.restore(model, snap))
    assert.same({}, trace)
    run(other, "e_x")
    assert.equal("root.a root.b", leaves(other.par))
    other = assert(snapshot.restore(model, snap, { entries = true }))
    assert.equal("root.b root.a", leaves(other.par))
    run(other, "e_leave")
    run(other, "e_enter")
    assert.equal("root.a root.a", leaves(other.par))
  end)

  -- Is the machine in par, and are entries called when it is restored?
  for _, case in ipairs { { true, false }, { false, true } } do
    it("changes no later entry, put in " .. (case[1] and "par" or "off"), function()
      local model = parent(two {})
      local fsm = started(model)
      if not case[1] then run(fsm, "e_leave") end
      local other = assert(snapshot.restore(model, snapshot.take(fsm),
        { entries = case[2] }))
      if case[1] then run(other, "e_leave") end
      rfsm.send_events(other, "e_enter")
      rfsm.step(other)
      assert.equal("root.a root.a", leaves(other.par))
    end)
  end
end)

describe("reset", function()
  it("resets the regions, without exits", function()
    local trace = {}
    local fsm = started_two(trace)
    helper.clear(trace)
    rfsm.reset(fsm)
    assert.same({}, trace)
    assert.equal("none none", leaves(fsm.par))
  end)

  it("of the parent machine by a region comes when the iteration ends", function()
    local fsm
    fsm = init(parent(seqand { right = region({}, "right"),
      left = plain({}, { entry = function() rfsm.reset(fsm) end }) }))
    for _ = 1, 3 do rfsm.run(fsm) end
    rfsm.send_events(fsm, "e_x")
    rfsm.step(fsm)
    assert.equal("none none", leaves(fsm.par))
    assert.is_false(rfsm.get_actleaf_fqn(fsm))
  end)
end)

it("regions agree with machines stepped by hand, on random charts", function()
  assert.is_nil(share.problem(require "spec.support.claims.seqand", 40))
end)

it("a machine without sequential AND states has nothing of this extension", function()
  local fsm = init(region({}, "plain"))
  assert.same({}, { fsm._seqands, fsm.a._seqand })
end)

describe("the machines of a machine", function()
  it("are itself and the regions at any depth, in the order of stepping", function()
    local inner = parent(seqand { order = { "z" }, a = plain({}), z = plain({}) })
    local fsm = rfsm.init(parent(seqand { order = { "y" }, x = plain({}), y = inner }))
    local found = {}
    for _, at in ipairs(rfsm.machines(fsm)) do
      local owner = at.owner == fsm and "fsm" or at.owner and "region" or "none"
      found[#found + 1] = ("%s, %s of %s"):format(at.prefix,
        at.state and at.state._fqn or "none", owner)
    end
    assert.same({
      "root, none of none", "root.par.y, root.par of fsm",
      "root.par.y.par.z, root.par of region", "root.par.y.par.a, root.par of region",
      "root.par.x, root.par of fsm",
    }, found)
    local substates = fsm.par.substates
    assert.same({ substates.y, substates.x }, rfsm.regions(fsm.par))
    assert.same({}, rfsm.regions(fsm))
    assert.same({}, rfsm.regions("root"))
  end)
end)
