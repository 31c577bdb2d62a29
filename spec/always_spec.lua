-- Transitions that need no event: always = true.

local compiling = require "spec.support.compiling"
local defer = require "rfsm.defer"
local helper = require "spec.helper"
local interrupts = require "spec.support.interrupts"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local snapshot = require "rfsm.snapshot"
require "rfsm_seqand"

local conn, state, trans = rfsm.conn, rfsm.state, rfsm.trans
local send = helper.moved

local function at(fsm) return rfsm.get_actleaf_fqn(fsm) end

-- A machine of a --always, if it is open--> b --e_back--> a. `log` has what is called.
local function new(members, is_open)
  local log, fsm = {}, nil
  local function note(text)
    return function(...)
      local event = select(4, ...)
      log[#log + 1] = text .. " " .. tostring(event)
    end
  end
  local model = { info = false, warn = false, a = state {},
    b = state { entry = note "entry" },
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", always = true,
      guard = function(_, events, event)
        log[#log + 1] = ("guard %d %s"):format(#events, tostring(event))
        return fsm.is_open
      end,
      effect = function(_, _, _, events, event)
        log[#log + 1] = ("effect %d %s"):format(#events, tostring(event))
      end },
    trans { src = "b", tgt = "a", events = { "e_back" } } }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a copy
  fsm = assert(rfsm.init(state(model)))
  fsm.is_open, fsm.log = is_open or false, log
  rfsm.run(fsm)
  return fsm
end

describe("a transition that needs no event", function()
  it("waits for its guard, and is taken without an event", function()
    local fsm = new()
    assert.equal("root.a", at(fsm))
    fsm.is_open = true
    for i = #fsm.log, 1, -1 do fsm.log[i] = nil end
    assert.is_true(rfsm.run(fsm))
    assert.equal("root.b", at(fsm))
    assert.same({ "guard 0 nil", "effect 0 nil", "entry nil" }, fsm.log)
  end)

  it("consumes no event, and comes before them", function()
    local fsm = new { c = state {}, [4] = trans { src = "b", tgt = "c",
      events = { "e_c" } }, [5] = trans { src = "a", tgt = "c", events = { "e_c" } } }
    fsm.is_open = true
    rfsm.send_events(fsm, "e_c")
    rfsm.step(fsm)
    assert.equal("root.b", at(fsm))
    rfsm.step(fsm)
    assert.equal("root.c", at(fsm))
  end)

  it("is not triggered by events", function()
    local fsm = new()
    local count = #fsm.log
    rfsm.send_events(fsm, "e_x")
    rfsm.step(fsm)
    assert.equal("root.a", at(fsm))
    for i = count + 1, #fsm.log do assert.equal("guard 0 nil", fsm.log[i]) end
  end)

  it("asks its guard in each iteration, also behind an e_done of a leaf", function()
    local fsm = new()
    rfsm.reset(fsm)
    rfsm.step(fsm)
    for _, count in ipairs { 2, 1, 1 } do -- the first step has the e_done of the leaf
      local before = #fsm.log
      assert.is_true(rfsm.step(fsm))
      assert.equal(count, #fsm.log - before)
    end
  end)

  it("counts as a step; post hooks get an empty list, others are not called", function()
    local called = {}
    local fsm = new { getevents = function()
      called[#called + 1] = "getevents"
      return {}
    end, pre_step_hook = function() called[#called + 1] = "pre" end,
      post_step_hook = function(_, events)
        called[#called + 1] = "post " .. #events
      end }
    fsm.is_open, called[1] = true, nil
    for i = #called, 1, -1 do called[i] = nil end
    rfsm.send_events(fsm, "e_back")
    rfsm.step(fsm)
    assert.same({ "root.b", "post 0" }, { at(fsm), called[1] })
    assert.is_nil(called[2])
    assert.equal("e_back", fsm._intq[1] == "e_done@root.a" and fsm._intq[2]
      or fsm._intq[1])
  end)

  it("is judged by the moment at which it is taken", function()
    for seconds, count in pairs { [0.5] = 1, [1.5] = 0 } do -- any order
      local time, told = require("rfsm.clock").simulated(), {}
      local fsm = new { gettime = time,
        err = function(text) told[#told + 1] = text end }
      rfsm.reset(fsm)
      rfsm_checks.watch_properties(fsm, { p = rfsm_checks.from "root.a".stays(1) })
      rfsm.step(fsm)
      time:advance(seconds)
      fsm.is_open = true
      rfsm.step(fsm)
      assert.same({ "root.b", count }, { at(fsm), #told })
    end
  end)

  it("lets segments without events be open behind it, others be closed", function()
    local k = { k = conn {}, c = state {}, [2] = trans { src = "a", tgt = "k",
      always = true }, [4] = trans { src = "k", tgt = "c", events = { "e_x" }, pn = 1 },
      [5] = trans { src = "k", tgt = "b" } }
    assert.equal("root.b", at(new(k)))
    k[5] = nil
    assert.equal("root.a", at(send(new(k), "e_x")))
  end)

  it("of a composite comes before one inside; among others by pn", function()
    local inner = state { x = state {}, y = state {}, z = state {},
      trans { src = "initial", tgt = "x" }, trans { src = "x", tgt = "y",
        always = true }, trans { src = "x", tgt = "z", always = true, pn = 1 } }
    local fsm = new({ a = inner }, false)
    assert.equal("root.a.z", at(fsm))
    assert.equal("root.b", at(new({ a = inner }, true)))
  end)

  it("may be internal, and a doo goes on beside it", function()
    local count, cycles = 0, 0
    local fsm = new { a = state { doo = function()
      while true do
        cycles = cycles + 1
        rfsm.yield(true)
      end
    end }, [2] = trans { src = "a", tgt = "internal", always = true,
      guard = function() return count < 2 end,
      effect = function() count = count + 1 end } }
    rfsm.run(fsm)
    assert.same({ 2, "root.a", true }, { count, at(fsm), cycles > 0 })
  end)

  it("works in a region, behind a snapshot, if it is merged, and with dbg", function()
    local is_open = false
    local region = state { info = false, warn = false, a = state {}, b = state {},
      trans { src = "initial", tgt = "a" }, trans { src = "a", tgt = "b", always = true,
        guard = function() return is_open end } }
    local fsm = new { a = rfsm.seqand { r = region }, [2] = trans { src = "a",
      tgt = "b", events = { "e_b" } } }
    is_open = true
    rfsm.run(fsm)
    rfsm.run(fsm)
    assert.equal("root.b", at(fsm.a.substates.r))
    local other = new()
    local restored = new({}, true)
    assert.is_true(snapshot.put(restored, snapshot.take(other)))
    assert.equal("root.a", at(restored))
    rfsm.run(restored)
    assert.equal("root.b", at(restored))
    local merged = new { [2] = trans { src = "a", tgt = "b", events = { "e_b" } } }
    assert.is_true(rfsm.fsm_merge(merged, merged, trans { src = "a", tgt = "b",
      always = true }))
    rfsm.run(merged)
    assert.equal("root.b", at(merged))
    local trace = {}
    local traced = new({ dbg = function(id) trace[#trace + 1] = id end }, true)
    assert.equal("root.b", at(traced))
    assert.matches("EXEC_PATH .*EFFECT .*STATE_ENTER", table.concat(trace, " "))
  end)

  it("does not eat an event that is kept, and has it looked at", function()
    local fsm = new { a = state { defer = { "e_back" } } }
    assert.equal("e_back", rfsm.waiting(send(fsm, "e_back"))[1])
    fsm.is_open = true
    rfsm.step(fsm)
    assert.equal("root.b", at(fsm))
    fsm.is_open = false
    rfsm.run(fsm)
    assert.equal("root.a", at(fsm))
    assert.is_table(defer)
  end)

  it("goes on after an interrupt at any instruction of the engine", function()
    for instruction = 1, 400 do
      local fsm = new()
      fsm.is_open = true
      interrupts.raise(instruction, interrupts.VALUES[1], rfsm.step, fsm)
      rfsm.run(fsm)
      assert.equal("root.b", at(fsm))
    end
  end)

  it("is data if it is not true", function()
    local fsm = new { [2] = trans { src = "a", tgt = "b", events = { "e_b" },
      always = "yes" } }
    assert.same({ "yes", "root.b" }, { fsm[2].always, at(send(fsm, "e_b")) })
  end)

  for _, case in ipairs {
    { "with events", { [2] = trans { src = "a", tgt = "b", always = true,
      events = { "e_x" } } }, "root.trans[2].always (a -> b): a transition that needs "
        .. "no event has no events (leave out one of the two fields)" },
    { "from a connector", { k = conn {}, [2] = trans { src = "a", tgt = "k",
      events = { "e" } }, [4] = trans { src = "k", tgt = "b", always = true } },
      "root.trans[4].always (k -> b): only a transition from a state needs no event, "
        .. "'root.k' is a connector" },
    { "from initial", { [1] = trans { src = "initial", tgt = "a", always = true } },
      "root.trans[1].always (initial -> a): only a transition from a state needs no "
        .. "event, 'root.initial' is a connector" },
  } do
    it("is refused " .. case[1], function()
      local model = { info = false, warn = false, err = false, a = state {},
        b = state {}, trans { src = "initial", tgt = "a" }, trans { src = "a",
          tgt = "b", events = { "e" } } }
      for key, value in pairs(case[2]) do model[key] = value end -- any order: a copy
      local ok, _, problems = rfsm.init(state(model))
      assert.is_false(ok)
      assert.equal(case[3], (problems[1]:gsub("^[^ ]-:%d+: ", "")))
    end)
  end
end)

describe("a cycle of transitions that need no event", function()
  local function cyclic(guard)
    return { info = false, a = state {}, b = state {}, off = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", always = true },
      trans { src = "b", tgt = "a", always = true, guard = guard },
      trans { src = "root", tgt = ".off", events = { "e_off" } } }
  end

  local function endless(members)
    local model = cyclic()
    model.warn = false
    for key, value in pairs(members or {}) do model[key] = value end -- any order
    local texts = {}
    for _, finding in ipairs(rfsm_checks.findings(state(model))) do
      if finding.code == "endless" then texts[#texts + 1] = finding.text end
    end
    return texts
  end

  it("is found, also with callbacks that send, and of one internal transition",
    function()
      local text = "run never becomes idle, no event is needed on "
      assert.same({ text .. "root.a -> root.b -> root.a" }, endless())
      assert.same({ text .. "root.a -> root.b -> root.a" }, endless { a = state {
        entry = function(fsm) rfsm.send_events(fsm, "e_off") end } })
      assert.same({ text .. "root.a -> root.a" }, endless { [2] = trans { src = "a",
        tgt = "internal", always = true } })
      assert.same({}, endless { [3] = trans { src = "b", tgt = "a", always = true,
        guard = function() return false end } })
    end)

  it("is told by a strict machine", function()
    local is_open, warned = false, {}
    local model = cyclic(function() return is_open end)
    model.strict = true
    model.warn = function(text)
      warned[#warned + 1] = text:gsub("^WARNING: ", ""):gsub("[^ ]-:%d+: ", "")
    end
    local fsm = assert(rfsm.init(state(model)))
    rfsm.run(fsm)
    is_open = true
    rfsm.step(fsm, 9999)
    assert.same({}, warned)
    rfsm.step(fsm)
    assert.same({ "transitions that need no event are taken again and again, such as "
      .. "root.trans[2] (a -> b) (give one of them a guard)" }, warned)
  end)
end)

it("a strict machine is silent about a transition that is taken once in each run",
  function()
    local is_open, warned = false, {}
    local fsm = assert(rfsm.init(state { info = false, strict = true,
      warn = function(text) warned[#warned + 1] = text end, a = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "internal", always = true, guard = function()
        is_open = not is_open
        return is_open
      end } }))
    for _ = 1, 10010 do rfsm.run(fsm) end
    assert.same({}, warned)
  end)

describe("a preproc function", function()
  it("may say that a transition needs no event, also if no chart says so", function()
    compiling.anew(function()
      local core = require "rfsm"
      core.preproc[1] = function(fsm)
        for _, tr in ipairs(core.elements(fsm, core.is_trans)) do
          tr.always = tr.src == fsm.a or nil
        end
      end
      local fsm = core.init(core.state { info = false, warn = false, a = core.state {},
        b = core.state {}, core.trans { src = "initial", tgt = "a" },
        core.trans { src = "a", tgt = "b" } })
      assert.is_true(core.run(fsm))
      assert.equal("root.b", core.get_actleaf_fqn(fsm))
    end)
  end)
end)

describe("an exploration of transitions that need no event", function()
  it("takes them, and knows that their guards may forbid", function()
    local result = rfsm_checks.explore(state { info = false, warn = false, a = state {},
      b = state {}, c = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", always = true,
        guard = function() return false end },
      trans { src = "a", tgt = "c", events = { "e_c" } },
      trans { src = "b", tgt = "c", always = true } })
    assert.matches("^%d+ configurations, 4 of 4 transitions taken", tostring(result))
  end)

  it("takes those of a region", function()
    local region = state { info = false, warn = false, a = state {}, b = state {},
      trans { src = "initial", tgt = "a" }, trans { src = "a", tgt = "b", always = true,
        guard = function() return false end } }
    local result = rfsm_checks.explore(state { info = false, warn = false,
      p = rfsm.seqand { idle_doo = "auto", r = region },
      trans { src = "initial", tgt = "p" } })
    assert.matches("3 of 3 transitions taken", tostring(result), 1, true)
    assert.is_function(helper.lines_of)
  end)
end)
