-- Faults: events that come when a callback fails.

local defer = require "rfsm.defer"
local helper = require "spec.helper"
local interrupts = require "spec.support.interrupts"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local snapshot = require "rfsm.snapshot"
require "rfsm.faults"
require "rfsm_seqand"

local conn, state, trans = rfsm.conn, rfsm.state, rfsm.trans
local send = helper.moved

local function fail() error("on purpose", 0) end

local function at(fsm) return rfsm.get_actleaf_fqn(fsm) end

-- Returns a machine that has run: work { a --e_b--> b } --e_fault--> safe. `faults` has
-- what came, `reported` the names given to err.
local function new(members, inner)
  local work = { a = state {}, b = state {}, trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e_b" } } }
  for key, value in pairs(inner or {}) do work[key] = value end -- any order: a copy
  local faults, reported = {}, {}
  local model = { info = false, warn = false, work = state(work), safe = state {},
    err = function(id) reported[#reported + 1] = id end,
    trans { src = "initial", tgt = "work" },
    trans { src = "work", tgt = "safe", events = { "e_fault" },
      effect = function(_, _, _, _, event) faults[#faults + 1] = event end },
    trans { src = "safe", tgt = "work", events = { "e_again" } } }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a copy
  local fsm = assert(rfsm.init(state(model)))
  fsm.faults, fsm.reported = faults, reported
  rfsm.run(fsm)
  return fsm
end

local function text_of(fault)
  return ("%s %s %s: %s"):format(fault.name, fault.callback, fault.element,
    fault.message)
end

describe("e_fault", function()
  for _, case in ipairs {
    { "an entry", { b = state { entry = fail } },
      "e_fault@root.work entry root.work.b: on purpose" },
    { "an exit", { a = state { exit = fail } },
      "e_fault@root.work exit root.work.a: on purpose" },
    { "a doo", { b = state { doo = fail } },
      "e_fault@root.work doo root.work.b: on purpose" },
    { "an effect", { [2] = trans { src = "a", tgt = "b", events = { "e_b" },
      effect = fail } }, "e_fault@root.work effect T={ src='root.work.a', "
        .. "tgt='root.work.b', events='e_b' }: on purpose" },
    { "a guard", { [2] = trans { src = "a", tgt = "b", events = { "e_b" },
      guard = fail } }, "e_fault@root.work guard T={ src='root.work.a', "
        .. "tgt='root.work.b', events='e_b' }: on purpose" },
    { "an effect behind a connector", { k = conn {}, [2] = trans { src = "a", tgt = "k",
      events = { "e_b" } }, [3] = trans { src = "k", tgt = "b", effect = fail } },
      "e_fault@root.work effect T={ src='root.work.k', tgt='root.work.b' }: "
        .. "on purpose" },
    { "an internal transition", { [3] = trans { src = "a", tgt = "internal",
      events = { "e_b" }, pn = 1, effect = fail } }, "e_fault@root.work effect T={ "
        .. "src='root.work.a', tgt='root.work.a', pn=1, events='e_b' }: on purpose" },
  } do
    it("comes when " .. case[1] .. " of a state inside fails", function()
      local fsm = send(new({}, case[2]), "e_b")
      assert.equal("root.safe", at(fsm))
      assert.equal(case[3], text_of(fsm.faults[1]))
      assert.is_nil(fsm.faults[2])
      assert.equal(1, #fsm.reported)
    end)
  end

  it("comes when the state's own entry fails, and its own doo", function()
    assert.equal("root.safe", at(new({}, { entry = fail })))
    local fsm = new { work = state { doo = fail } }
    assert.equal("root.safe", at(fsm))
    assert.equal("e_fault@root.work doo root.work: on purpose", text_of(fsm.faults[1]))
  end)

  it("does not come for the exit and the transition that leave the state", function()
    local fsm = new({ [5] = trans { src = "work", tgt = "safe", events = { "e_go" },
      effect = fail } }, { exit = fail })
    assert.equal("root.safe", at(send(fsm, "e_go")))
    assert.same({ 0, 2 }, { #fsm.faults, #fsm.reported })
  end)

  it("comes to each state that names it, the innermost first", function()
    local seen = {}
    local fsm = new({ pre_step_hook = function(_, events)
      for _, event in ipairs(events) do
        seen[#seen + 1] = type(event) == "table" and event.name or nil
      end
    end }, { b = state { entry = fail }, [3] = trans { src = "b", tgt = "a",
      events = { "e_fault" } } })
    assert.equal("root.safe", at(send(fsm, "e_b")))
    assert.same({ "e_fault@root.work.b", "e_fault@root.work" }, seen)
  end)

  it("comes once while one of the same element is current or waits", function()
    local fsm = new({ [2] = trans { src = "work", tgt = "internal",
      events = { "e_fault" } } }, { a = state {}, [2] = trans { src = "a",
      tgt = "internal", events = { "e_b" }, effect = fail } })
    rfsm.send_events(fsm, "e_b")
    rfsm.step(fsm)
    rfsm.send_events(fsm, "e_b", "e_b")
    assert.equal(3, #fsm._intq)
    rfsm.step(fsm)
    assert.equal(0, #fsm._intq)
    send(fsm, "e_b")
    assert.equal(2, #fsm.reported)
  end)

  it("comes once if the transition that takes it fails, too", function()
    local count = 0
    local fsm = new({ [2] = trans { src = "work", tgt = "internal",
      events = { "e_fault" }, effect = function()
        count = count + 1
        fail()
      end } }, { b = state { entry = fail } })
    send(fsm, "e_b")
    assert.equal(2, count)
  end)

  it("comes once of what fails again while one waits", function()
    local fsm = new({ read = "one", [2] = trans { src = "work", tgt = "internal",
      events = { "e_fault" }, effect = function() end } },
      { [2] = trans { src = "a", tgt = "internal", events = { "e_b" },
        effect = fail } })
    rfsm.send_events(fsm, "e_b", "e_b", "e_b")
    for _, waiting in ipairs { 3, 2, 1, 0 } do
      rfsm.step(fsm)
      assert.equal(waiting, #fsm._intq)
    end
    assert.equal(3, #fsm.reported)
  end)

  it("is traced", function()
    local raised = {}
    local fsm = new({}, { b = state { entry = fail } })
    fsm.dbg = function(id, event)
      if id == "RAISED" and type(event) == "table" then raised[#raised + 1] = event end
    end
    send(fsm, "e_b")
    assert.equal(1, #raised)
    assert.equal(fsm.faults[1], raised[1])
  end)

  it("comes if the callback has replaced itself", function()
    for _, case in ipairs {
      { b = state { entry = function(_, b)
        b.entry = nil
        fail()
      end } },
      { [2] = trans { src = "a", tgt = "b", events = { "e_b" }, guard = function(tr)
        tr.guard = nil
        fail()
      end } },
    } do assert.equal("root.safe", at(send(new({}, case), "e_b"))) end
  end)

  it("comes for elements of the same name in two regions", function()
    local seen = {}
    local function region()
      return state { info = false, warn = false, err = false, x = state {},
        y = state { entry = fail }, trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "y", events = { "e_b" } } }
    end
    local inner = state { info = false, warn = false, err = false,
      p = rfsm.seqand { idle_doo = "auto", region() },
      trans { src = "initial", tgt = "p" } }
    local fsm = new { pre_step_hook = function(_, events)
      for _, event in ipairs(events) do
        local is_fault = type(event) == "table"
        seen[#seen + 1] = is_fault and event.element .. " in " .. event.region or nil
      end
    end, work = rfsm.seqand { idle_doo = "auto", arm = region(), base = inner },
      [2] = trans { src = "work", tgt = "internal", events = { "e_fault" } } }
    send(fsm, "e_b")
    assert.same({ "root.y in root.work.arm", "root.y in root.work.base.p.1" }, seen)
  end)

  it("is queued before err is called, and err prints as before", function()
    local waiting
    local fsm = new({ err = function(...)
      waiting = { (...), select("#", ...) }
    end }, { b = state { entry = fail } })
    fsm.err = function(id) waiting = { id, #fsm._intq } end
    send(fsm, "e_b")
    assert.same({ "ENTRY", 1 }, waiting)
  end)

  it("has a traceback where there is debug, of a doo its own", function()
    local function fail_inside() error("deep", 0) end
    local b = state { doo = function() fail_inside() end }
    local fsm = send(new({}, { b = b }), "e_b")
    assert.matches("faults_spec", fsm.faults[1].traceback, 1, true)
    fsm = send(new({}, { b = state { entry = function(_, own)
      own._doo_co = fail_inside -- the doo itself is there where there are no coroutines
      fail()
    end } }), "e_b")
    assert.equal("string", type(fsm.faults[1].traceback))
    local debug = _G.debug
    _G.debug = nil
    local ok, other = pcall(function()
      return send(new({}, { b = state { entry = fail } }), "e_b")
    end)
    _G.debug = debug
    assert.is_true(ok)
    assert.is_nil(other.faults[1].traceback)
  end)

  it("has any error as a text", function()
    local fsm = send(new({}, { b = state { entry = function() error({}, 0) end } }),
      "e_b")
    assert.equal("string", type(fsm.faults[1].message))
  end)

  it("does not come for hooks, predicates, or guards that a tool asks", function()
    local fsm = new({ work = state { a = state {}, trans { src = "initial",
      tgt = "a" }, trans { src = "a", tgt = "internal",
      events = { function() error "no" end } },
      trans { src = "a", tgt = "internal", events = { "e_b" }, guard = fail } } })
    rfsm.node_find_enabled(fsm, fsm.work.a, { "e_b" })
    send(fsm, "e_other")
    assert.equal("root.work.a", at(fsm))
    rfsm.entry_hook_add(fsm, fsm.work.a, fail)
    rfsm.guard_hook_add(fsm, fsm.work[2], fail)
    pcall(send, fsm, "e_x")
    assert.equal("root.work.a", at(fsm))
  end)

  it("does not come for an interrupt", function()
    local fsm = new({}, { b = state { entry = function()
      error("interrupted!", 0)
    end } })
    assert.has_error(function() send(fsm, "e_b") end, "interrupted!")
    rfsm.run(fsm)
    assert.equal("root.work.b", at(fsm))
  end)

  -- out { within { a --e_b--> b, whose entry fails } }: both name e_fault
  local function new_nested(got)
    local function noting(src)
      return trans { src = src, tgt = "internal", events = { "e_fault" },
        effect = helper.noting(got, src) }
    end
    local within = state { a = state {}, b = state { entry = fail },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_b" } } }
    local fsm = assert(rfsm.init(state { info = false, warn = false, err = false,
      read = "one", trans { src = "initial", tgt = "out" }, noting "out",
      out = state { within = within, trans { src = "initial", tgt = "within" },
        noting "within" } }))
    rfsm.run(fsm)
    rfsm.send_events(fsm, "e_b")
    return fsm
  end

  it("comes to all of them after an interrupt, if its failure is not lost", function()
    local texts, number, is_reached = {}, 0, true
    interrupts.without_jit(function()
      while is_reached do
        local got = {}
        local fsm = new_nested(got)
        number = number + 1
        is_reached = interrupts.raise_anywhere(number,
          interrupts.VALUES[number % 3 + 1], rfsm.step, fsm)
        for _ = 1, 6 do pcall(rfsm.step, fsm) end
        texts[table.concat(got, " ")] = true
      end
    end)
    assert.same({ "", "within out" }, rfsm.sorted_keys(texts))
  end)

  it("is made where a state names it only", function()
    local fsm = send(new({ [2] = trans { src = "work", tgt = "safe",
      events = { "e_error" } } }, { b = state { entry = fail } }), "e_b")
    assert.equal("root.work.b", at(fsm))
    assert.is_nil(fsm._watch_hooks)
    assert.is_nil(fsm._intq[1])
  end)

  it("is in the trace once for each state, also if the printer sends events", function()
    local raised = {}
    local fsm = new({}, { b = state { entry = fail },
      [3] = trans { src = "b", tgt = "a", events = { "e_fault" } } })
    fsm.dbg = function(id, event)
      local fault = id == "RAISED" and type(event) == "table" and event
      if not fault then return end
      raised[#raised + 1] = fault.name
      rfsm.send_events(fsm, "e_again")
    end
    send(fsm, "e_b")
    assert.same({ "e_fault@root.work.b", "e_fault@root.work" }, raised)
  end)

  it("of a region goes to the machine around, unless the region names it", function()
    for _, case in ipairs { { false, "root.safe" }, { true, "root.work" } } do
      local region = { info = false, warn = false, err = false, x = state {},
        y = state { entry = fail }, z = state {}, trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "y", events = { "e_b" } } }
      if case[1] then
        region[3] = trans { src = "y", tgt = "z", events = { "e_fault" } }
      end
      local fsm = new { work = rfsm.seqand { idle_doo = "auto",
        [1] = state(region) } }
      assert.equal(case[2], at(send(fsm, "e_b")))
      if case[1] then
        assert.equal("root.z", at(fsm.work.substates[1]))
      else
        assert.equal("e_fault@root.work entry root.y: on purpose",
          text_of(fsm.faults[1]))
      end
    end
  end)

  it("of an exit in a region that is left goes to the machine around", function()
    local region = state { info = false, warn = false, err = false, x = state {
      exit = fail }, trans { src = "initial", tgt = "x" } }
    local fsm = new({ [2] = trans { src = "work", tgt = "safe",
      events = { "e_fault" } },
      [3] = trans { src = "root", tgt = "internal", events = { "e_fault" } } },
      { a = rfsm.seqand { r = region } })
    assert.equal("root.safe", at(send(fsm, "e_b")))
  end)

  it("may be merged, and is kept by a snapshot", function()
    local fsm = new({ [2] = trans { src = "work", tgt = "safe",
      events = { "e_stop" } } }, { b = state { entry = fail } })
    assert.is_true(rfsm.fsm_merge(fsm, fsm, trans { src = "work", tgt = "safe",
      events = { "e_fault" } }))
    assert.equal("root.safe", at(send(fsm, "e_b")))
    fsm = new({}, { b = state { entry = fail } })
    rfsm.send_events(fsm, "e_b")
    rfsm.step(fsm)
    local fresh = new({}, { b = state {} })
    assert.is_true(snapshot.put(fresh, snapshot.take(fsm)))
    rfsm.run(fresh)
    assert.equal("root.safe", at(fresh))
  end)

  it("is never deferred, and never told as discarded", function()
    local told = {}
    local fsm = new({ safe = state { defer = { function() return true end } } },
      { b = state { entry = fail } })
    rfsm.watch_hook_add(fsm, "discarded", function(_, event)
      told[#told + 1] = event
    end)
    send(fsm, "e_b")
    assert.equal("root.safe", at(fsm))
    assert.same({}, told)
    assert.is_table(defer)
    for _, event in ipairs(rfsm.waiting(fsm)) do assert.equal("string", type(event)) end
  end)

  it("is explored as an event that may come", function()
    local function explored(event)
      return tostring(rfsm_checks.explore(state { info = false, warn = false,
        a = state { entry = fail }, b = state {}, trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { event } } }))
    end
    assert.matches("2 of 2 transitions taken", explored "e_fault", 1, true)
  end)

  it("may be a name with data, or have the FQN of its source", function()
    for _, event in ipairs { rfsm.named "e_fault", "e_fault@root.work" } do
      local fsm = new({ [2] = trans { src = "work", tgt = "safe",
        events = { event } } }, { b = state { entry = fail } })
      assert.equal("root.safe", at(send(fsm, "e_b")))
    end
  end)

  it("of another state, or as a call, is told", function()
    for _, event in ipairs { "e_fault@root.a", "e_fault()" } do
      local warned = {}
      new { warn = function(text) warned[#warned + 1] = text:match("root.*$") end,
        [3] = trans { src = "safe", tgt = "work", events = { event } } }
      assert.same({ ("root.trans[3].events (safe -> work): '%s' never fires here, did "
        .. "you mean 'e_fault'?"):format(event) }, warned)
    end
  end)

  it("from a connector is told", function()
    local warned = {}
    assert(rfsm.init(state { info = false, warn = function(text)
      warned[#warned + 1] = text:gsub("^.-events ", "")
    end, a = state {}, k = conn {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "k", events = { "e" } },
      trans { src = "k", tgt = "a", events = { "e_fault" } } }))
    assert.same({ "(k -> a): 'e_fault' never fires here, 'root.k' is no state" },
      warned)
  end)

  it("without its module is told", function()
    local lines = require("spec.helper").lines_of(arg[-1] .. [[ -e '
      package.path = "./?.lua;" .. package.path
      local rfsm = require "rfsm"
      rfsm.init(rfsm.state { info = false, warn = print, a = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "a", events = { "e_fault", "e_error" } } })
      local m = rfsm.state { a = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "a", events = { rfsm.named "e_fault" } },
        rfsm.trans { src = "a", tgt = "a", events = { "e_fault@root.a" } } }
      print(table.concat(require("rfsm_checks").check(m), "\n"))']])
    for i = 1, 3 do
      assert.matches("no loaded extension knows 'e_fault' (require \"rfsm.faults\")",
        lines[i], 1, true)
    end
    assert.is_nil(lines[4])
  end)
end)
