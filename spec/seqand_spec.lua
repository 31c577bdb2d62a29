-- Sequential AND states.

local helper = require "spec.helper"
local rfsm = require "rfsm"

local state, trans = rfsm.state, rfsm.trans

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

-- (initial) -> par --e_leave--> off --e_enter--> par
local function parent(par)
  return state {
    warn = false, info = false, par = par, off = state {},
    trans { src = "initial", tgt = "par" },
    trans { src = "par", tgt = "off", events = { "e_leave" } },
    trans { src = "off", tgt = "par", events = { "e_enter" } },
  }
end

local function two(trace, fields)
  fields = fields or {}
  fields.left, fields.right = region(trace, "left"), region(trace, "right")
  return parent(rfsm.seqand(fields))
end

-- A region that notes its cycles; each is one doo cycle.
local function worker(trace, name, cycles)
  return state {
    warn = false, info = false,
    work = state {
      doo = function()
        for i = 1, cycles or 1000 do
          trace[#trace + 1] = name .. " " .. i
          rfsm.yield(cycles == nil)
        end
      end,
    },
    trans { src = "initial", tgt = "work" },
  }
end

local function leaves(par)
  local names = {}
  for _, name in ipairs { "left", "right" } do
    names[#names + 1] = rfsm.get_actleaf_fqn(par.substates[name]) or "none"
  end
  return table.concat(names, " ")
end

describe("rfsm.seqand", function()
  it("is the module rfsm_seqand", function()
    assert.equal(require "rfsm_seqand", rfsm.seqand)
  end)

  it("returns a leaf state", function()
    assert.is_true(rfsm.is_leaf(rfsm.seqand { left = region({}, "left") }))
  end)

  for name, make in pairs { -- any order
    ["rfsm.seqand:new"] = function(fields) return rfsm.seqand:new(fields) end,
    ["rfsm_seqand.new"] = require("rfsm_seqand").new,
  } do
    it("may be called as " .. name, function()
      local fsm = helper.init(parent(make { left = region({}, "left") }))
      rfsm.run(fsm)
      assert.equal("root.a", rfsm.get_actleaf_fqn(fsm.par.substates.left))
    end)
  end

  it("takes regions at positions, before those with names", function()
    local trace = {}
    local fsm = helper.init(parent(rfsm.seqand {
      order = { 2 }, left = region(trace, "left"), region(trace, "one"),
      region(trace, "two"),
    }))
    rfsm.run(fsm)
    assert.same({
      "two entry root", "two entry a", "one entry root", "one entry a",
      "left entry root", "left entry a",
    }, trace)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm.par.substates[2]))
  end)

  it("leaves the table it is given as it is", function()
    local fields = { left = region({}, "left") }
    rfsm.seqand(fields)
    assert.is_nil(fields.doo)
    assert.is_table(fields.left)
  end)

  it("keeps the user's data", function()
    local par = rfsm.seqand { left = region({}, "left"), colour = "red" }
    local fsm = helper.init(parent(par))
    assert.equal("red", fsm.par.colour)
  end)

  it("takes initialised machines, too", function()
    local trace = {}
    local given = helper.init(region(trace, "left"))
    local fsm = helper.init(parent(rfsm.seqand { left = given }))
    rfsm.run(fsm)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm.par.substates.left))
    assert.is_false(rfsm.get_actleaf_fqn(given))
  end)

  it("hands on what was set on an initialised machine", function()
    local given, records = helper.init(region({}, "left")), {}
    given.dbg = function(id) records[#records + 1] = id end
    local fsm = helper.init(parent(rfsm.seqand { left = given }))
    rfsm.step(fsm)
    assert.is_true(#records > 0)
  end)

  it("may be the root of a machine", function()
    local fsm = helper.init(rfsm.seqand {
      warn = false, info = false,
      left = region({}, "left"), right = region({}, "right"),
    })
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_x")
    rfsm.run(fsm)
    assert.equal("root.b root.b", leaves(fsm))
  end)

  it("runs regions that are leaves", function()
    local trace = {}
    local leaf = state { warn = false, entry = function() trace[1] = "in" end,
      exit = function() trace[2] = "out" end }
    local fsm = helper.init(parent(rfsm.seqand { left = leaf }))
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_leave")
    assert.same({ "in", "out" }, trace)
  end)
end)

describe("a wrong sequential AND state", function()
  -- What is wrong, and the message, which points at the caller.
  local CASES = {
    { "table expected, got nil", nil },
    { "step: either a number of steps or run = true, not both",
      { step = 2, run = true } },
    { "step: number of steps expected, got string '2'", { step = "2" } },
    { "run: boolean expected, got number", { run = 1 } },
    { "order: list of names expected, got string 'left'", { order = "left" } },
    { "order[1]: name of a region expected, got string 'up' (there are '1', 'left')",
      { order = { "up" }, state {} } },
    { "idle_doo: true, false or 'auto' expected, got number", { idle_doo = 1 } },
    { "idle.doo: true, false or 'auto' expected, got string 'no'",
      { ["idle.doo"] = "no" } },
    { "doo: is the state's own, and cannot be set", { doo = print } },
    { "substates: is the state's own, and cannot be set", { substates = {} } },
    { "entry: cannot be a state", { entry = state {} } },
    { "k: cannot be a connector", { k = rfsm.conn {} } },
    { "doo: is the state's own, and cannot be set", -- the least text
      { state {}, doo = print, substates = {}, run = state {}, k = rfsm.conn {} } },
  }
  for _, case in ipairs(CASES) do
    it("is refused: " .. case[1], function()
      local fields = case[2]
      if fields then fields.left = region({}, "left") end
      local _, text = pcall(function() return (rfsm.seqand(fields)) end)
      local place, message = text:match("^(.-:%d+): (.*)$")
      assert.matches("seqand_spec.lua", place)
      assert.equal("rfsm.seqand: " .. case[1], message)
    end)
  end

  it("is refused for an order without regions", function()
    local _, text = pcall(function() return (rfsm.seqand { order = { "up" } }) end)
    assert.matches(": rfsm%.seqand: order%[1%]: name of a region expected, got "
      .. "string 'up' %(there are none%)$", text)
  end)

  it("with a region that is wrong is a problem of the model, with its place", function()
    local broken = state { err = false, warn = false, info = false, a = state {},
      trans { src = "initial", tgt = "b" } }
    local model = parent(rfsm.seqand { left = broken })
    model.err = false
    local _, problems = rfsm.init(model)
    assert.equal(1, #problems)
    assert.matches("^spec/seqand_spec.lua:%d+: root.par.left: root.trans%[1%] "
      .. "%(initial %-> b%): tgt 'b': no state or connector is named 'b' in 'root'",
      problems[1])
  end)

  it("that contains itself is a problem of the model", function()
    local inner = state { err = false, warn = false, info = false, x = state {},
      trans { src = "initial", tgt = "x" } }
    inner.x = rfsm.seqand { left = inner }
    local fsm, problems = rfsm.init(inner)
    assert.is_false(fsm)
    assert.matches("a sequential AND state cannot contain itself", problems[1])
  end)
end)

describe("entry", function()
  it("is the user's, then one step of each region in order", function()
    local trace = {}
    local fsm = helper.init(two(trace, {
      order = { "right", "left" },
      entry = function(_, self, what) trace[#trace + 1] = what .. " " .. self._fqn end,
    }))
    rfsm.step(fsm)
    assert.same({
      "entry root.par", "right entry root", "right entry a", "left entry root",
      "left entry a",
    }, trace)
  end)

  it("of the user that fails goes to err, and the regions are entered", function()
    local trace, errors = {}, {}
    local model = two(trace, { entry = function() error("no", 0) end })
    model.err = function(...) errors[#errors + 1] = table.concat({ ... }) end
    rfsm.step(helper.init(model))
    assert.same({ "ENTRYerror executing entry of root.par: no" }, errors)
    assert.equal("right entry a", trace[#trace])
  end)

  it("set on the model afterwards is the user's, too", function()
    local trace = {}
    local model = two(trace)
    model.par.entry = function() trace[#trace + 1] = "mine" end
    rfsm.step(helper.init(model))
    assert.equal("mine left entry root", trace[1] .. " " .. trace[2])
  end)
end)

describe("exit", function()
  it("leaves the regions in order, then is the user's", function()
    local trace = {}
    local fsm = helper.init(two(trace, {
      exit = function(_, self, what) trace[#trace + 1] = what .. " " .. self._fqn end,
    }))
    rfsm.run(fsm)
    helper.clear(trace)
    helper.post_and_run(fsm, "e_leave")
    assert.same({
      "left exit a", "left exit root", "right exit a", "right exit root",
      "exit root.par",
    }, trace)
  end)

  it("resets the regions", function()
    local fsm = helper.init(two {})
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_leave")
    assert.equal("none none", leaves(fsm.par))
    assert.same({ "e_init_fsm" }, fsm.par.substates.left._intq)
  end)

  it("does not exit a region that was never entered", function()
    local exits = 0
    local closed = state {
      err = false, warn = false, info = false, a = state {},
      exit = function() exits = exits + 1 end,
      trans { src = "initial", tgt = "a", guard = function() return false end },
    }
    local fsm = helper.init(parent(rfsm.seqand { left = closed }))
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_leave")
    assert.equal(0, exits)
  end)

  it("leaves the regions also when a tool has replaced it", function()
    local trace = {}
    local fsm = helper.init(two(trace))
    rfsm.run(fsm)
    fsm.par.exit = function() trace[#trace + 1] = "tool" end
    helper.clear(trace)
    helper.post_and_run(fsm, "e_leave")
    assert.equal("tool left exit a", trace[1] .. " " .. trace[2])
  end)

  it("leaves nothing behind when the state is entered again", function()
    local trace = {}
    local fsm = helper.init(two(trace))
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_x")
    helper.post_and_run(fsm, "e_leave")
    helper.clear(trace)
    helper.post_and_run(fsm, "e_enter")
    assert.same({
      "left entry root", "left entry a", "right entry root", "right entry a",
    }, trace)
  end)
end)

describe("doo", function()
  local function trace_of(fields, steps)
    local trace = {}
    for _, name in ipairs { "c", "a", "b" } do fields[name] = worker(trace, name) end
    local fsm = helper.init(parent(rfsm.seqand(fields)))
    rfsm.step(fsm)
    for _ = 1, steps or 1 do rfsm.step(fsm) end
    return trace
  end

  it("steps each region once, by name", function()
    assert.same({ "a 1", "b 1", "c 1" }, trace_of {})
  end)

  it("steps those of order first, a duplicate once", function()
    assert.same({ "c 1", "a 1", "b 1" }, trace_of { order = { "c", "c" } })
  end)

  it("steps as often as step says, when the regions are busy", function()
    local trace = {}
    local fsm = helper.init(parent(rfsm.seqand {
      step = 3, a = worker(trace, "a", 9), b = worker(trace, "b", 9),
    }))
    rfsm.step(fsm)
    helper.clear(trace)
    rfsm.run(fsm)
    assert.same({ "a 1", "a 2", "a 3", "b 1", "b 2", "b 3" }, trace)
  end)

  it("runs each region when run is set", function()
    local trace = {}
    local fsm = helper.init(parent(rfsm.seqand {
      run = true, a = worker(trace, "a", 3), b = worker(trace, "b", 2),
    }))
    rfsm.run(fsm)
    assert.same({ "a 1", "a 2", "a 3", "b 1", "b 2" }, trace)
  end)

  it("advances once per run, since it is idle by default", function()
    local trace = {}
    local fsm = helper.init(parent(rfsm.seqand { a = worker(trace, "a", 9) }))
    rfsm.run(fsm)
    helper.clear(trace)
    assert.is_true(rfsm.run(fsm))
    assert.equal(1, #trace)
  end)

  for _, field in ipairs { "idle_doo", "idle.doo" } do
    it("is never idle when " .. field .. " is false", function()
      local par = rfsm.seqand { a = region({}, "a"), [field] = false }
      local fsm = helper.init(parent(par))
      assert.is_false(rfsm.step(fsm, 50))
    end)
  end

  it("runs all work in one run when idle_doo is 'auto'", function()
    local trace = {}
    local fsm = helper.init(parent(rfsm.seqand {
      idle_doo = "auto", a = worker(trace, "a", 3), b = worker(trace, "b", 5),
    }))
    assert.is_true(rfsm.run(fsm))
    assert.same({ "a 1", "b 1", "a 2", "b 2", "a 3", "b 3", "b 4", "b 5" }, trace)
  end)

  it("processes an event in the same run when idle_doo is 'auto'", function()
    local fsm = helper.init(two({}, { idle_doo = "auto" }))
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_x", "e_x")
    assert.equal("root.b root.b", leaves(fsm.par))
  end)

  it("survives a region whose program fails", function()
    local errors, trace = {}, {}
    local bad = state { warn = false, info = false,
      err = function(id) errors[#errors + 1] = id end,
      a = state { doo = function() error("no") end },
      trans { src = "initial", tgt = "a" } }
    local fsm = helper.init(parent(rfsm.seqand { a = bad, b = worker(trace, "b") }))
    for _ = 1, 5 do rfsm.run(fsm) end
    assert.same({ "DOO" }, errors)
    assert.equal("b 4", trace[4])
  end)

  it("survives a region that raises, the caller gets the error", function()
    local trace = {}
    local bad = region({}, "bad")
    bad.getevents = function() error("no bus", 0) end
    local fsm = helper.init(parent(rfsm.seqand { a = bad, b = worker(trace, "b") }))
    for _ = 1, 3 do
      assert.error_matches(function() rfsm.step(fsm) end, "no bus")
    end
    assert.same({ "b 1", "b 2" }, trace)
    assert.equal("root.par", rfsm.get_actleaf_fqn(fsm))
  end)

  it("lets a region reset itself", function()
    local entries, self = 0, nil
    local model = state { warn = false, info = false,
      a = state { entry = function(fsm)
        entries, self = entries + 1, fsm
      end }, b = state { entry = function() rfsm.reset(self) end },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_x" } } }
    local fsm = helper.init(parent(rfsm.seqand { idle_doo = "auto", a = model }))
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_x")
    assert.equal(2, entries)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm.par.substates.a))
  end)

  for _, field in ipairs { "andseqdbg", "seqanddbg" } do
    it("prints each advance when " .. field .. " is set", function()
      local said = {}
      local model = parent(rfsm.seqand { left = region({}, "left"), [field] = true })
      model.info = function(text) said[#said + 1] = text end
      rfsm.run(helper.init(model))
      assert.equal("SEQAND root.par: left advanced to root.a", said[#said])
    end)
  end
end)

describe("an event", function()
  local function received_by(fsm, ...)
    local trace = {}
    for _, name in ipairs { "left", "right" } do
      local machine = fsm.par.substates[name]
      rfsm.pre_step_hook_add(machine, function(_, events)
        for i = 1, #events do trace[#trace + 1] = name .. " " .. events[i] end
      end)
    end
    helper.post_and_run(fsm, ...)
    return trace
  end

  local function settled(fields)
    local fsm = helper.init(two({}, fields))
    for _ = 1, 3 do rfsm.run(fsm) end
    return fsm
  end

  it("of the parent machine goes to every region", function()
    assert.same({ "left e_y", "left e_z", "right e_y", "right e_z" },
      received_by(settled(), "e_y", "e_z"))
  end)

  it("from getevents goes to every region", function()
    local fsm, sent = settled(), false
    fsm.getevents = function()
      local events = sent and {} or { "e_y" }
      sent = true
      return events
    end
    assert.same({ "left e_y", "right e_y" }, received_by(fsm))
  end)

  it("that makes the state leave goes to none, nor do those beside it", function()
    assert.same({}, received_by(settled(), "e_x", "e_leave"))
  end)

  it("that makes the state be entered goes to every region", function()
    local fsm = settled()
    helper.post_and_run(fsm, "e_leave")
    assert.same({ "left e_init_fsm", "right e_init_fsm", "left e_done@root.a",
      "left e_enter", "left e_x", "right e_done@root.a", "right e_enter", "right e_x" },
      received_by(fsm, "e_enter", "e_x"))
  end)

  it("that leaves the state and enters it again goes to every region", function()
    local model = two {}
    model[4] = trans { src = "par", tgt = "par", events = { "e_again" } }
    local fsm = helper.init(model)
    for _ = 1, 3 do rfsm.run(fsm) end
    helper.post_and_run(fsm, "e_again", "e_x")
    assert.equal("root.b root.b", leaves(fsm.par))
  end)

  it("reaches the regions once, also under events that never end", function()
    local fsm, count = settled(), 0
    fsm.getevents = function()
      count = count + 1
      return { "e_" .. count }
    end
    local trace = {}
    rfsm.pre_step_hook_add(fsm.par.substates.left, function(_, events)
      for i = 1, #events do trace[#trace + 1] = events[i] end
    end)
    for _ = 1, 20 do rfsm.step(fsm) end
    for i = 1, 15 do assert.equal("e_" .. i, trace[i]) end
  end)

  it("is forwarded while hooks come and go", function()
    local fsm = settled()
    local function hook() end
    rfsm.pre_step_hook_add(fsm, function()
      rfsm.post_step_hook_rm(fsm, hook)
      rfsm.post_step_hook_add(fsm, hook, "before")
    end)
    assert.same({ "left e_y", "right e_y" }, received_by(fsm, "e_y"))
  end)

  it("may be anything, and 100,000 in one step are no problem", function()
    local fsm, sum = settled { run = true }, 0
    rfsm.pre_step_hook_add(fsm.par.substates.right, function(_, events)
      sum = sum + #events
    end)
    local storm = {}
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
  it("two deep carries events down and leaves from inside out", function()
    local trace = {}
    local inner = parent(rfsm.seqand {
      idle_doo = "auto", leaf = region(trace, "leaf"),
    })
    inner[2], inner[3], inner.off = nil, nil, nil
    local fsm = helper.init(parent(rfsm.seqand { idle_doo = "auto", inner = inner }))
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_x")
    helper.post_and_run(fsm, "e_leave")
    assert.same({
      "leaf entry root", "leaf entry a", "leaf exit a", "leaf entry b", "leaf exit b",
      "leaf exit root",
    }, trace)
  end)

  it("directly in another sequential AND state works, too", function()
    local trace = {}
    local inner = rfsm.seqand { warn = false, info = false, idle_doo = "auto",
      leaf = region(trace, "leaf") }
    local fsm = helper.init(parent(rfsm.seqand { idle_doo = "auto", inner = inner }))
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_x")
    assert.equal("leaf entry b", trace[#trace])
  end)
end)

describe("instances", function()
  it("of one model have regions of their own, a hundred side by side", function()
    local model, machines = two({}, { idle_doo = "auto" }), {}
    for i = 1, 100 do
      machines[i] = helper.init(model)
      rfsm.run(machines[i])
    end
    for i = 1, 100, 2 do helper.post_and_run(machines[i], "e_x") end
    local wrong = 0
    for i = 1, 100 do
      local expected = i % 2 == 1 and "root.b root.b" or "root.a root.a"
      if leaves(machines[i].par) ~= expected then wrong = wrong + 1 end
    end
    assert.equal(0, wrong)
  end)

  it("of a machine have regions of their own", function()
    local first = helper.init(two {})
    local second = helper.init(first)
    assert.not_equal(first.par.substates.left, second.par.substates.left)
  end)

  it("report what init finds in their regions, by the printer of the region", function()
    local told = {}
    local function talking(info)
      return state { info = info, warn = false, s = state {},
        trans { src = "initial", tgt = "s" } }
    end
    local model = rfsm.seqand {
      silent = talking(false),
      told = talking(function(text) told[#told + 1] = text end),
    }
    helper.init(model)
    helper.init(model)
    local text = "INFO: created undeclared connector root.initial"
    assert.same({ text, text }, told)
  end)

  it("mounted twice in one machine have regions of their own", function()
    local par = rfsm.seqand { left = region({}, "left"), right = region({}, "right") }
    local model = parent(par)
    model.off = par
    local fsm = helper.init(model)
    rfsm.run(fsm)
    assert.equal("root.a root.a", leaves(fsm.par))
    assert.equal("none none", leaves(fsm.off))
  end)

  it("merged into a live machine run like others", function()
    local fsm = helper.init(two {})
    rfsm.run(fsm)
    local par = rfsm.seqand { left = region({}, "left"), right = region({}, "right") }
    assert.is_true(rfsm.fsm_merge(fsm, fsm, par, "more"))
    assert.is_true(rfsm.fsm_merge(fsm, fsm, trans { src = "par", tgt = "more",
      events = { "e_more" } }))
    helper.post_and_run(fsm, "e_more")
    assert.equal("root.a root.a", leaves(fsm.more))
  end)
end)

describe("reset", function()
  it("resets the regions, without exits", function()
    local trace = {}
    local fsm = helper.init(two(trace))
    rfsm.run(fsm)
    helper.clear(trace)
    rfsm.reset(fsm)
    assert.same({}, trace)
    assert.equal("none none", leaves(fsm.par))
  end)

  it("of the parent machine by a region comes when the iteration ends", function()
    local fsm
    local resetter = state { warn = false, info = false, a = state {},
      b = state { entry = function() rfsm.reset(fsm) end },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_x" } } }
    fsm = helper.init(parent(rfsm.seqand {
      left = resetter, right = region({}, "right"),
    }))
    for _ = 1, 3 do rfsm.run(fsm) end
    rfsm.send_events(fsm, "e_x")
    rfsm.step(fsm)
    assert.equal("none none", leaves(fsm.par))
    assert.is_false(rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("a machine without sequential AND states", function()
  it("has nothing of this extension", function()
    local fsm = helper.init(region({}, "plain"))
    assert.is_nil(fsm._has_seqand)
    assert.is_nil(fsm.a._seqand)
  end)
end)
