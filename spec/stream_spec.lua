-- The stream of values that those who watch a machine listen to, and the way back.

local breakpoints = require "rfsm.observe.breakpoints"
local claim = require "spec.support.claims.stream"
local helper = require "spec.helper"
local LocalView = require "rfsm.web.local_view"
local record = require "rfsm.record"
local rewind = require "rfsm.observe.rewind"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local share = require "spec.support.share"
local snapshot = require "rfsm.snapshot"
local stream = require "rfsm.observe.stream"
require "rfsm_timeevent"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

local NAMES = { "began", "taken", "entered", "failed", "sent", "resumed",
  "ended", "finished", "passed", "reset", "merged" }

local function text_of(value)
  if rfsm.is_node(value) then return value._fqn end
  if rfsm.is_trans(value) then return value.src._fqn .. ">" .. value.tgt._fqn end
  if type(value) ~= "table" then return tostring(value) end
  local texts = {}
  for i, item in ipairs(value) do texts[i] = text_of(item) end
  return "{" .. table.concat(texts, " ") .. "}"
end

-- Returns a listener for some values, by default all, and the list of what it is told.
local function listening(names)
  local listener, trace = {}, {}
  for _, name in ipairs(names or NAMES) do
    listener[name] = function(at, ...)
      local words = { at.prefix == "root" and name or at.prefix .. " " .. name }
      for i = 1, select("#", ...) do words[i + 1] = text_of((select(i, ...))) end
      trace[#trace + 1] = table.concat(words, " ")
    end
  end
  return listener, trace
end

-- initial --> a --e_b [guards]--> m.k --> m.b --e_a--> a; a --e_i--> internal
local function chart(fields)
  local model = state {
    info = false, warn = false, err = false, emem = false,
    a = state {}, m = state { b = state {}, k = conn {},
      trans { src = "initial", tgt = "b" }, trans { src = "k", tgt = "b" } },
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "root.m.k", events = { "e_b" },
      guard = function() return false end },
    trans { src = "a", tgt = "root.m.k", events = { "e_b" } },
    trans { src = "m", tgt = "a", events = { "e_a" } },
    trans { src = "a", tgt = "internal", events = { "e_i" } },
  }
  for key, value in pairs(fields or {}) do model[key] = value end -- any order: a set
  return model
end

local function follow(fsm, names)
  local listener, trace = listening(names)
  return trace, stream.follow(fsm, listener)
end

describe("the stream", function()
  it("tells of an iteration in one order", function()
    local fsm = helper.init(chart())
    local trace = follow(fsm)
    helper.post_and_run(fsm)
    assert.same({ "began {e_init_fsm}", "taken {root.initial>root.a} "
      .. "{e_init_fsm}", "entered root", "entered root.a", "finished {e_init_fsm}",
      "passed {e_init_fsm}", "began {e_done@root.a}", "finished {e_done@root.a}",
      "passed {e_done@root.a}", "began {}", "finished {}", "passed {}" }, trace)
    helper.clear(trace)
    rfsm.send_events(fsm, "e_b", 7)
    rfsm.step(fsm)
    rfsm.reset(fsm)
    assert.same({ "sent e_b 7", "began {e_b 7}",
      "taken {root.a>root.m.k root.m.k>root.m.b} {e_b 7}",
      "entered root.m", "entered root.m.b", "finished {e_b 7}", "passed {e_b 7}",
      "reset" }, trace)
  end)

  it("has the transition that is taken, of two with the same text", function()
    local fsm, taken = helper.started(chart()), nil
    stream.follow(fsm, { taken = function(_, path) taken = path[1] end })
    helper.post_and_run(fsm, "e_b")
    assert.equal(fsm[3], taken)
    helper.post_and_run(fsm, "e_a")
    helper.post_and_run(fsm, "e_i")
    assert.equal(fsm[5], taken)
  end)

  it("enters nothing by an internal transition", function()
    local fsm = helper.started(chart())
    local trace = follow(fsm, { "entered" })
    helper.post_and_run(fsm, "e_i")
    assert.same({}, trace)
    helper.post_and_run(fsm, "e_b")
    helper.post_and_run(fsm, "e_a")
    assert.same({ "entered root.m", "entered root.m.b", "entered root.a" }, trace)
  end)

  it("follows a target that a program has set, also a composite", function()
    local fsm = helper.started(chart())
    local trace = follow(fsm, { "entered" })
    fsm[3].tgt = fsm.m
    helper.post_and_run(fsm, "e_b")
    fsm[4].tgt = fsm.m.b
    helper.post_and_run(fsm, "e_a")
    assert.same({ "entered root.m", "entered root.m.b", "entered root.m",
      "entered root.m.b" }, trace)
  end)

  it("tells of a root without states, which no transition enters", function()
    local fsm = helper.init(state { info = false, warn = false })
    local trace = follow(fsm, { "taken", "entered" })
    rfsm.run(fsm)
    assert.same({ "entered root" }, trace)
  end)

  it("tells of failures and doos", function()
    local fsm = helper.init(chart { a = state { doo = function()
      rfsm.yield(true)
      error("no doo", 0)
    end }, m = state { entry = function() error("no entry", 0) end,
      b = state { doo = function() end }, k = conn {},
      trans { src = "initial", tgt = "b" }, trans { src = "k", tgt = "b" } } })
    local trace = follow(fsm, { "failed", "resumed", "ended" })
    helper.post_and_run(fsm)
    helper.post_and_run(fsm)
    helper.post_and_run(fsm, "e_b")
    assert.same({ "resumed root.a", "resumed root.a", "failed root.a doo no doo",
      "failed root.m entry no entry", "resumed root.m.b", "ended root.m.b" }, trace)
  end)

  it("has the regions, with their prefix", function()
    local fsm = helper.init(chart { a = rfsm.seqand { left = chart(),
      right = chart() } })
    local trace = follow(fsm, { "taken", "entered" })
    helper.post_and_run(fsm)
    helper.post_and_run(fsm, "e_i", "e_b")
    assert.same({ "taken {root.initial>root.a} {e_init_fsm}", "entered root",
      "entered root.a", "root.a.left taken {root.initial>root.a} {e_init_fsm}",
      "root.a.left entered root", "root.a.left entered root.a",
      "root.a.right taken {root.initial>root.a} {e_init_fsm}",
      "root.a.right entered root", "root.a.right entered root.a",
      "taken {root.a>root.m.k root.m.k>root.m.b} {e_i e_b}",
      "entered root.m", "entered root.m.b" }, trace)
  end)

  it("calls a guard in its place, with the guard", function()
    local fsm = helper.started(chart())
    local seen
    local followed = stream.follow(fsm, { guard = function(at, tr, own, events)
      seen = { at.prefix, tr, own(tr, events), events[1] }
      return true
    end })
    helper.post_and_run(fsm, "e_b")
    assert.same({ "root", fsm[2], false, "e_b" }, seen)
    assert.equal("root.m.b", rfsm.get_actleaf_fqn(fsm))
    followed:stop()
    helper.post_and_run(fsm, "e_a")
    helper.post_and_run(fsm, "e_b")
    assert.equal("e_b", seen[4])
    assert.is_false(fsm[2].guard())
  end)

  it("has what is merged: states, regions, and guards once", function()
    local fsm = helper.started(chart())
    local listener, trace = listening { "entered", "merged" }
    local asked = 0
    function listener.guard(_, tr, own, events)
      asked = asked + 1
      return own(tr, events)
    end
    stream.follow(fsm, listener)
    assert(rfsm.fsm_merge(fsm, fsm, rfsm.seqand { one = chart() }, "p"))
    assert(rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "p", events = { "e_p" },
      guard = function() end }))
    helper.post_and_run(fsm, "e_p")
    assert.same({ "merged root.p", "merged root.a>root.p", "entered root.p",
      "root.p.one entered root", "root.p.one entered root.a" }, trace)
    assert.equal(1, asked)
    helper.post_and_run(fsm.p.substates.one, "e_b")
    assert.equal(2, asked)
  end)

  it("hooks only what is asked for, and nothing once it is stopped", function()
    local fsm = helper.started(chart { p = rfsm.seqand { one = chart() },
      [6] = trans { src = "a", tgt = "p", events = { "e_p" } } })
    local FIELDS = { "_pre_hooks", "_post_hooks", "_path_hooks", "_reset_hooks" }
    local function hooks()
      local counts = {}
      for _, at in ipairs(rfsm.machines(fsm)) do
        for _, field in ipairs(FIELDS) do
          counts[#counts + 1] = #(at.machine[field] or {})
        end
        local of_root = (at.machine._entry_hooks or {})[at.machine]
        counts[#counts + 1] = #(of_root or {})
        for _, what in ipairs { "sent", "failed", "resumed", "ended", "merged" } do
          counts[#counts + 1] = #((at.machine._watch_hooks or {})[what] or {})
        end
      end
      return table.concat(counts, " "):gsub("(%S+ %S+ %S+ %S+ %S+) ", "%1, ", 1)
    end
    local before = hooks()
    for name, expected in pairs {
      began = "2 2 0 1 0, 0 0 0 0 1 2 1 0 0 0 0 0 0 0 1",
      taken = "1 2 1 1 0, 0 0 0 0 1 1 1 1 0 0 0 0 0 0 1",
      entered = "1 2 0 1 1, 0 0 0 0 1 1 1 0 0 1 0 0 0 0 1",
      finished = "1 3 0 1 0, 0 0 0 0 1 1 2 0 0 0 0 0 0 0 1",
      passed = "1 3 0 1 0, 0 0 0 0 1 1 2 0 0 0 0 0 0 0 1",
      reset = "1 2 0 2 0, 0 0 0 0 1 1 1 0 1 0 0 0 0 0 1",
      failed = "1 2 0 1 0, 0 1 0 0 1 1 1 0 0 0 0 1 0 0 1",
      sent = "1 2 0 1 0, 1 0 0 0 1 1 1 0 0 0 1 0 0 0 1",
      resumed = "1 2 0 1 0, 0 0 1 0 1 1 1 0 0 0 0 0 1 0 1",
      ended = "1 2 0 1 0, 0 0 0 1 1 1 1 0 0 0 0 0 0 1 1",
      merged = "1 2 0 1 0, 0 0 0 0 1 1 1 0 0 0 0 0 0 0 1",
    } do
      local _, followed = follow(fsm, { name })
      assert.equal(expected, hooks(), name)
      followed:stop()
      assert.equal(before, hooks())
    end
  end)

  it("tells of each state what its entry and exit tell", function()
    assert.is_nil(share.problem(claim, 30))
  end)
end)

describe("those who watch", function()
  -- Returns a chart that counts the calls of its functions.
  local function counting()
    local calls = { guard = 0, entry = 0, exit = 0, effect = 0, doo = 0 }
    local function count(name)
      return function() calls[name] = calls[name] + 1 end
    end
    local model = chart { keep = { "n" }, n = 1, a = state { entry = count "entry",
      exit = count "exit", doo = count "doo" } }
    for _, tr in ipairs(model) do
      tr.guard, tr.effect = tr ~= model[1] and count "guard", count "effect"
    end
    return model, calls
  end

  it("call no guard and no callback", function()
    local model, plain = counting()
    local fsm = helper.init(model)
    local observed, calls = counting()
    local other = helper.init(observed)
    local view = LocalView.new(other, function() return 0 end)
    view:observe(true)
    rfsm_checks.coverage(other)
    rfsm_checks.watch_properties(other, { rfsm_checks.never "root.m" })
    record.record(other, {})
    local way = rewind.new(other)
    for _, event in ipairs { "e_x", "e_b", "e_i", "e_a", "e_b", "e_a" } do
      helper.post_and_run(fsm, event)
      helper.post_and_run(other, event)
      way:leave()
      view:state(nil)
    end
    for i = way.last, 0, -1 do assert(way:go(i)) end
    assert(way:go(way.last))
    assert.same(plain, calls)
    assert.same(rfsm.get_active_conf(fsm), rfsm.get_active_conf(other))
  end)

  it("take 20,000 events in one step", function()
    local fsm, events = helper.started(chart()), {}
    local view = LocalView.new(fsm, function() return 0 end)
    view:observe(true)
    record.record(fsm, {})
    for _ = 1, 20000 do rfsm.send_events(fsm, "e_other") end
    helper.post_and_run(fsm, "e_b")
    for _, entry in ipairs(view.log) do
      events[#events + 1] = entry.events and #entry.events or nil
    end
    assert.equal(20001, events[#events])
  end)

  it("have the transition that is taken, of two with the same text", function()
    local fsm = helper.started(chart())
    local view = LocalView.new(fsm, function() return 0 end)
    view:observe(true)
    local seen = rfsm_checks.coverage(fsm)
    breakpoints.add(view, fsm[2])
    helper.post_and_run(fsm, "e_b")
    assert.is_false(view.hit)
    local edges, taken = view:chart().edges, view:state(nil).taken
    assert.same({ "root.trans[3]", "root.m.trans[2]", nil },
      { edges[taken[1] + 1].key, edges[taken[2] + 1].key, taken[3] })
    assert.same({ 0, 1, 1 }, { seen.transitions["root.trans[2]"],
      seen.transitions["root.trans[3]"], seen.transitions["root.m.trans[2]"] })
    helper.post_and_run(fsm, "e_a")
    breakpoints.add(view, fsm[3])
    helper.post_and_run(fsm, "e_b")
    assert.equal("root.a -> root.m.k", view.hit)
  end)
end)

describe("the way back", function()
  local function new_way(options, fields)
    local fsm = helper.started(chart(fields))
    return rewind.new(fsm, options), fsm
  end

  local function go_on(way, fsm, event)
    local number = way:leave()
    helper.post_and_run(fsm, event)
    return number
  end

  local function leaf(fsm) return rfsm.get_actleaf_fqn(fsm) end

  it("leads to each place and forward again, the last one included", function()
    local way, fsm = new_way()
    assert.same({ 1, 2 }, { go_on(way, fsm, "e_b"), go_on(way, fsm, "e_a") })
    rfsm.send_events(fsm, "e_more")
    local snap = snapshot.take(fsm)
    local seen = {}
    for i, number in ipairs { 1, 0, 2, 2 } do
      assert.is_table(way:go(number))
      seen[i] = { way.at, leaf(fsm) }
    end
    assert.same({ { 1, "root.m.b" }, { 0, "root.a" }, { 2, "root.a" },
      { 2, "root.a" } }, seen)
    assert.same(snap, snapshot.take(fsm))
  end)

  it("takes a snapshot that is given as its own, and none besides", function()
    local way, fsm = new_way { about = function(snap) return snap.leaf end }
    local snap, count, take = snapshot.take(fsm), 0, snapshot.try_take
    helper.with(snapshot, { try_take = function(...)
      count = count + 1
      return take(...)
    end }, function()
      way:leave(snap)
      assert.same({ 0, "root.a" }, { count, way[0].about })
      way:leave()
    end)
    assert.equal(1, count)
    way:go(0)
    assert.same(snap, snapshot.take(fsm))
  end)

  it("does not lead to a place at which the clock failed, and leaves the machine",
    function()
      local is_wrong = false
      local way, fsm = new_way(nil, { gettime = function()
        if is_wrong then error("time is up", 0) end
        return 1, 0
      end, late = rfsm.trans { src = "a", tgt = "m", events = { "e_after(9)" } } })
      is_wrong = true
      way:leave()
      is_wrong = false
      helper.post_and_run(fsm, "e_b")
      go_on(way, fsm, "e_a")
      local snap = snapshot.take(fsm)
      assert.same({ false, "rfsm_timeevent: the clock failed: time is up" },
        { way:go(0) })
      assert.same({ snap, 2 }, { snapshot.take(fsm), way.at })
      way:go(1)
      assert.equal("root.m.b", leaf(fsm))
    end)

  it("forgets what was undone once the machine goes on", function()
    local way, fsm = new_way()
    for _, event in ipairs { "e_b", "e_a", "e_b" } do go_on(way, fsm, event) end
    way:go(1)
    assert.equal(3, way.last)
    go_on(way, fsm, "e_x")
    assert.same({ 2, 2, "root.m.b" }, { way.at, way.last, leaf(fsm) })
    assert.same({ false, "there is no such place" }, { way:go(3) })
    assert.equal(2, way.at)
  end)

  it("refuses what is no place", function()
    local way, fsm = new_way()
    go_on(way, fsm, "e_b")
    for _, number in ipairs { -1, 2, 0.5, "at", "go", "first", {}, true } do
      assert.same({ false, "there is no such place" }, { way:go(number) })
    end
    assert.same({ "root.m.b", 1 }, { leaf(fsm), way.at })
  end)

  it("keeps so many bytes, and the place where the machine stands", function()
    local way, fsm = new_way { bytes = 5000 }
    local least = 0
    for i = 1, 200 do
      go_on(way, fsm, i % 2 == 1 and "e_b" or "e_a")
      least = math.max(least, way.size)
    end
    assert.is_true(least <= 5000 and least > 3000, least)
    assert.is_true(way.first > 180 and way.first < 200, way.first)
    assert.same({ false, "there is no such place" }, { way:go(way.first - 1) })
    assert.is_table(way:go(way.first))
    for i = 0, way.first - 1 do assert.is_nil(way[i]) end
    way, fsm = new_way { bytes = 0 }
    go_on(way, fsm, "e_b")
    go_on(way, fsm, "e_a")
    assert.same({ 1, "root.a" }, { way.first, leaf(fsm) })
  end)

  it("counts the bytes of what it forgets", function()
    local way, fsm = new_way()
    go_on(way, fsm, "e_b")
    local size = way.size
    for _ = 1, 5 do
      way:go(0)
      go_on(way, fsm, "e_b")
      way:note()
    end
    assert.equal(2, way.last + 1)
    way:go(0)
    way:leave()
    assert.equal(size, way.size)
  end)

  it("says why it cannot lead to a place, and stays", function()
    local way, fsm = new_way(nil, { keep = { "x" }, x = print })
    go_on(way, fsm, "e_b")
    fsm.x = 1
    go_on(way, fsm, "e_a")
    assert.same({ false, "root.x: a function cannot be saved" }, { way:go(0) })
    assert.same({ 2, "root.a" }, { way.at, leaf(fsm) })
    assert.is_table(way:go(1))
    assert(rfsm.fsm_merge(fsm, fsm, state { final = true }, "new"))
    assert.same({ false, "the machine has changed, new: state root.new" },
      { way:go(2) })
    assert.same({ 1, "root.m.b" }, { way.at, leaf(fsm) })
  end)

  it("keeps what its caller knows, and shows it before timers are set", function()
    local now, shown = 0, {}
    local way, fsm
    way, fsm = new_way { about = function() return { now = now } end,
      prepare = function(about)
        shown[#shown + 1] = about.now .. " " .. leaf(fsm)
        now = about.now
      end }
    now = 1
    go_on(way, fsm, "e_b")
    now = 2
    assert.equal(1, way:go(0).about.now)
    assert.equal(2, way:go(1).about.now)
    assert.same({ "1 root.m.b", "2 root.a" }, shown)
    assert(rfsm.fsm_merge(fsm, fsm, state { final = true }, "new"))
    assert.is_false(way:go(0))
    assert.same({ 2, "1 root.m.b", "2 root.m.b" }, { now, shown[3], shown[4] })
  end)

  it("stays if its caller cannot go to a place, which is prepared for the present one",
  function()
    local prepared = {}
    local way, fsm
    way, fsm = new_way { about = function() return leaf(fsm) end,
      prepare = function(about)
        prepared[#prepared + 1] = about
        return about == "root.a" and "not there" or nil
      end }
    go_on(way, fsm, "e_b")
    assert.same({ false, "not there" }, { way:go(0) })
    assert.same({ 1, "root.m.b" }, { way.at, leaf(fsm) })
    assert.same({ "root.a", "root.m.b" }, prepared)
  end)

  it("finishes a step that was interrupted", function()
    local way, fsm = new_way()
    fsm.m.entry = function() error("interrupted!", 0) end
    rfsm.send_events(fsm, "e_b")
    assert.is_false(pcall(rfsm.step, fsm))
    way:leave()
    rfsm.reset(fsm)
    way:go(0)
    assert.equal("root.m.b", leaf(fsm))
  end)

  it("wants a machine, and options that there are", function()
    assert.equal("rfsm.observe.rewind.new: initialised fsm expected, got number 7",
      helper.refusal(rewind.new, 7))
    assert.equal("rfsm.observe.rewind.new: bytes: number of bytes expected, got -1",
      helper.refusal(rewind.new, helper.init(chart()), { bytes = -1 }))
    for _, name in ipairs { "about", "prepare" } do
      assert.equal("rfsm.observe.rewind.new: " .. name
        .. ": function expected, got string 'x'",
        helper.refusal(rewind.new, helper.init(chart()), { [name] = "x" }))
    end
    assert.matches("unknown option 'byte' %(did you mean 'bytes'%?%)",
      helper.refusal(rewind.new, helper.init(chart()), { byte = 1 }))
  end)
end)

describe("a breakpoint at a state whose name occurs elsewhere", function()
  -- A machine with as many units, each with the states `hold` and `go`.
  local function plant(count)
    local model = { trans { src = "initial", tgt = "area1" } }
    for i = 1, count do
      local area = state { trans { src = "initial", tgt = "unit1" } }
      area.unit1 = state { hold = state {}, go = state {},
        trans { src = "initial", tgt = "hold" },
        trans { src = "hold", tgt = "go", events = { "e_go" } } }
      model["area" .. i] = area
    end
    return helper.init(state(model))
  end

  local function problem_of(fsm, text)
    local _, problem = pcall(breakpoints.add, { fsm = fsm, points = {} }, text)
    return problem:match("got.*")
  end

  it("names the first one, and counts the others", function()
    assert.equal("got 'hold', did you mean area1.unit1.hold (and 49 more)?",
      problem_of(plant(50), "hold"))
    assert.equal("got 'unit1.go', did you mean area1.unit1.go (and 1 more)?",
      problem_of(plant(2), "unit1.go"))
    assert.equal("got 'hold', did you mean area1.unit1.hold?", problem_of(plant(1),
      "hold"))
  end)

  it("names a near one if there is none, and states if nothing is near", function()
    assert.equal("got 'e_goo' (did you mean 'e_go'?)", problem_of(plant(2), "e_goo"))
    assert.equal("got 'xyz', pp() shows the states", problem_of(plant(2), "xyz"))
  end)
end)
