-- Upgrades: a snapshot of one version of a chart becomes a machine of the next one, and
-- nothing is lost in silence.

local helper = require "spec.helper"
local json = require "dkjson"
local rfsm = require "rfsm"
local share = require "spec.support.share"
local snapshot = require "rfsm.snapshot"
local timeevent = require "rfsm_timeevent"
require "rfsm.await"
require "rfsm.defer"
require "rfsm.history"
require "rfsm.seqand"

local state, trans = rfsm.state, rfsm.trans
local now = 0

before_each(function()
  now = 0
  timeevent.set_gettime_hook(function() return now, 0 end)
end)
after_each(function() timeevent.set_gettime_hook(nil) end)

local function itself(snap) return snap end

-- (initial) -> a --events--> b --e_back--> a
local function chart(events, fields)
  local model = helper.chart(events, { emem = false })
  for key, value in pairs(fields or {}) do model[key] = value end
  return model
end

local function region(value, fields)
  local model = { info = false, warn = false, emem = false, keep = { "m" }, m = value,
    x = state {}, trans { src = "initial", tgt = "x" } }
  for key, value_of_field in pairs(fields or {}) do model[key] = value_of_field end
  return state(model)
end

-- A machine in whose only state the regions run.
local function regions(members)
  return state { info = false, warn = false, emem = false, w = rfsm.seqand(members),
    trans { src = "initial", tgt = "w" } }
end

local function restored(model, snap, options)
  return assert(snapshot.restore(model, snap, options))
end

describe("timers of a machine that migrates", function()
  local function moved(old, new)
    local fsm = helper.started(chart(old))
    now = 2
    return restored(chart(new), snapshot.take(fsm), { migrate = itself })
  end

  for _, case in ipairs {
    { what = "are armed from now on if they are new", old = { "e_x" },
      new = { "e_x", "e_after(5)" }, left = 5 },
    { what = "are dropped if they are gone", old = { "e_x", "e_after(5)" },
      new = { "e_x" }, left = nil },
    { what = "begin anew if they have changed", old = { "e_after(5)" },
      new = { "e_after(9)" }, left = 9 },
    { what = "go on if both charts have them", old = { "e_after(5)" },
      new = { "e_after(5)", "e_x" }, left = 3 },
  } do
    it(case.what, function()
      local left = timeevent.next_deadline(moved(case.old, case.new))
      assert.equal(case.left, left and math.floor(left + 0.5))
    end)
  end

  it("do not expire again if both charts have them", function()
    local function forever(events)
      return chart(events, { [2] = trans { src = "a", tgt = "b", events = events,
        guard = function() return false end } })
    end
    local fsm = helper.started(forever { "e_after(5)" })
    now = 7
    rfsm.run(fsm)
    assert.is_nil(timeevent.next_deadline(fsm))
    local again = restored(forever { "e_after(5)", "e_x" }, snapshot.take(fsm),
      { migrate = itself })
    assert.is_nil(timeevent.next_deadline(again))
  end)

  it("keep to the clock of their machine while another one is loaded", function()
    local other = helper.started(chart({ "e_after(5)" }, { gettime = function()
      return 100, 0
    end }))
    local again = moved({ "e_after(5)" }, { timeevent.e_after(function()
      assert(snapshot.put(other, snapshot.take(other)))
      return 9
    end), "e_after(5)" })
    assert.equal(3, math.floor(timeevent.next_deadline(again) + 0.5))
  end)

  it("go on under the new name of their state", function()
    local fsm = helper.started(chart { "e_after(5)" })
    now = 2
    local model = chart { "e_after(5)" }
    model.a, model.c = nil, state {}
    model[1].tgt, model[2].src, model[3].tgt = "c", "c", "c"
    local again = restored(model, snapshot.take(fsm), { rename = { ["root.a"] =
      "root.c" } })
    assert.equal(3, math.floor(timeevent.next_deadline(again) + 0.5))
  end)
end)

describe("a field", function()
  local function counter(keep, fields)
    fields = fields or { n = 1, old = 2 }
    fields.keep = keep
    return chart({ "e_x" }, fields)
  end

  it("that is new has its first value, also in a machine that is there", function()
    local snap = snapshot.take(helper.started(counter { "n" }))
    local model = counter({ "n", "more" }, { n = 5, more = { 1, { 2 } } })
    local fsm = restored(model, snap)
    assert.same({ 1, { 1, { 2 } } }, { fsm.n, fsm.more })
    fsm.more[2][1] = 3
    assert.is_true(snapshot.put(fsm, snap))
    assert.same({ 1, { 2 } }, fsm.more)
  end)

  it("that a callback has set to nil stays nil", function()
    local fsm = helper.started(counter { "n", "old" })
    fsm.n = nil
    local again = restored(counter { "n", "old" },
      (json.decode((json.encode(snapshot.take(fsm))))))
    assert.same({ nil, 2 }, { again.n, again.old })
    assert.is_nil(again.n)
  end)

  it("that is gone is named, unless migrate takes it out", function()
    local snap = snapshot.take(helper.started(counter { "n", "old" }))
    local ok, text, list = snapshot.restore(counter { "n" }, snap)
    assert.same({ false, "rfsm.snapshot: the snapshot holds what the chart lacks:\n"
      .. "  field old of root", { "field old of root" } }, { ok, text, list })
    local seen
    local fsm = restored(counter { "n" }, snap, { migrate = function(old, difference)
      old.data.root, seen = { n = 7 }, difference
    end })
    assert.same({ 7, { "gone: field old of root" } }, { fsm.n, seen })
    assert.equal(2, snap.data.root[4 + 1] or snap.data.root.old)
  end)

  it("that save returned needs a load", function()
    local model = chart({ "e_x" }, { save = function() return 1 end,
      load = function() end })
    assert.equal("rfsm.snapshot: the snapshot holds what the chart lacks:\n"
      .. "  what save of root returned", select(2, snapshot.restore(chart { "e_x" },
        snapshot.take(helper.started(model)))))
  end)
end)

describe("a region", function()
  it("that is new has its first values, and is entered when it is stepped", function()
    local snap = snapshot.take(helper.started(regions { b = region(2) }))
    local fsm = restored(regions { b = region(0), c = region(3) }, snap)
    local substates = fsm.w.substates
    assert.same({ 2, 3, "root.x", false }, { substates.b.m, substates.c.m,
      rfsm.get_actleaf_fqn(substates.b), rfsm.get_actleaf_fqn(substates.c) })
    rfsm.run(fsm)
    assert.equal("root.x", rfsm.get_actleaf_fqn(substates.c))
  end)

  it("that is gone is named", function()
    local snap = snapshot.take(helper.started(regions { a = region(1), b = region(2) }))
    assert.same({ false, "rfsm.snapshot: the snapshot holds what the chart lacks:\n"
      .. "  region root.w.b", { "region root.w.b" },
      "the snapshot holds what the chart lacks" },
      { snapshot.restore(regions { a = region(1) }, snap) })
    assert.equal(1, restored(regions { a = region(5) }, snap, { migrate = function(old)
      old.regions["root.w.b"] = nil
    end }).w.substates.a.m)
  end)

  it("with another structure is of another chart", function()
    local snap = snapshot.take(helper.started(regions { a = region(1) }))
    local model = regions { a = region(1, { y = state {} }) }
    assert.equal("rfsm.snapshot: the snapshot is of another chart:\n"
      .. "  new: root.w.a: state root.y", (select(2, snapshot.restore(model, snap))))
    local fsm = restored(regions { a = region(1, { x = false, y = state {},
      trans { src = "initial", tgt = "y" } }) }, snap,
      { rename = { ["root.w.a.x"] = "root.w.a.y" } })
    assert.equal("root.y", rfsm.get_actleaf_fqn(fsm.w.substates.a))
  end)

  it("that the snapshot names and nobody has is refused", function()
    local fsm = helper.started(regions { a = region(1) })
    local snap = snapshot.take(fsm)
    snap.regions["root.w.b"] = { leaf = 7 }
    assert.equal("rfsm.snapshot: root.w.b: leaf: string expected, got number",
      (select(2, snapshot.put(fsm, snap))))
    snap.regions["root.w.b"] = 5
    assert.equal("rfsm.snapshot: regions: table expected for 'root.w.b', got number",
      (select(2, snapshot.put(fsm, snap))))
    snap.regions["root.w.b"] = { leaf = "root.x" }
    assert.equal("rfsm.snapshot: the snapshot holds what the chart lacks:\n"
      .. "  region root.w.b", (select(2, snapshot.put(fsm, snap))))
    snap.regions["root.w.a"] = nil
    assert.is_false((snapshot.put(fsm, snap)))
  end)
end)

describe("data for encoders of JSON", function()
  it("has texts as keys, or is a list; numbers that JSON has not are texts", function()
    local encoding = require "rfsm.snapshot.encoding"
    for _, case in ipairs {
      { value = { 1, { 2 }, "x" }, json = { 1, { 2 }, "x" } },
      { value = { 1, nil, 3 }, json = { ["1"] = 1, ["3"] = 3 } },
      { value = { a = 1, [true] = 2 }, json = { a = 1, ["true"] = 2 } },
      { value = { 1, a = { [7] = 0 } }, json = { ["1"] = 1, a = { ["7"] = 0 } } },
      { value = { a = encoding.NIL, b = 1 }, json = { b = 1 } },
      { value = { 1 / 0, -1 / 0, 0 / 0 }, json = { "inf", "-inf", "nan" } },
      { value = 7, json = 7 }, { value = "x", json = "x" }, { value = {}, json = {} },
    } do
      assert.same(case.json, encoding.to_json(case.value))
    end
  end)
end)

describe("a region that was not entered", function()
  it("is kept for its events alone, for its target alone, and not if it is blank",
    function()
      local function model()
        return state { info = false, warn = false, emem = false, a = state {},
          w = rfsm.seqand { x = region(nil), y = region(nil), z = region(nil) },
          trans { src = "initial", tgt = "a" } }
      end
      local fsm = helper.started(model())
      local substates = fsm.w.substates
      rfsm.send_events(substates.x, "e_x")
      substates.y[1].tgt = substates.y.initial
      local snap = snapshot.take(fsm)
      assert.same({ ["root.w.x"] = { "e_init_fsm", "e_x" } }, { ["root.w.x"] =
        snap.regions["root.w.x"].queue })
      assert.same({ "root", 1, "root.initial" }, snap.regions["root.w.y"].targets)
      assert.is_nil(snap.regions["root.w.z"])
      local again = restored(model(), snap)
      assert.same(snap, snapshot.take(again))
    end)
end)

describe("the structure of a chart", function()
  it("has states, transitions, what is kept, and regions by their location", function()
    local inner = region(1, { save = function() end, load = function() end })
    assert.same({
      "state root", "root.initial -> root.w", "connector root.initial", "state root.w",
      "field n of root", "region root.w.a", "region root.w.b",
      "root.w.a: state root", "root.w.a: root.initial -> root.x",
      "root.w.a: connector root.initial", "root.w.a: state root.x",
      "root.w.a: field m of root", "root.w.a: save and load of root",
      "root.w.b: state root", "root.w.b: root.initial -> root.x",
      "root.w.b: connector root.initial", "root.w.b: state root.x",
      "root.w.b: field m of root",
    }, snapshot.structure((function()
      local model = regions { a = inner, b = region(2) }
      model.keep = { "n" }
      return model
    end)()))
  end)

  it("is the same with regions, so that migrate is not called", function()
    local model = regions { a = region(1), b = region(2) }
    local snap = snapshot.take(helper.started(model))
    assert(snap.regions["root.w.a"] and snap.regions["root.w.b"])
    restored(model, snap, { migrate = error })
  end)
end)

describe("the list of what differs", function()
  it("shows internal transitions, priorities and connectors", function()
    local function model(more)
      local root = chart { "e_x" }
      for key, value in pairs(more or {}) do root[key] = value end
      return root
    end
    local _, _, list = snapshot.restore(model { k = rfsm.conn {},
      [4] = trans { src = "a", tgt = "internal", events = { "e_i", 7 }, pn = 2 } },
      snapshot.take(helper.started(model())))
    assert.same({ "new: root.a -> internal on e_i, 7 pn 2", "new: connector root.k" },
      list)
  end)

  it("is the order if nothing else differs", function()
    local root = chart { "e_x" }
    root[2], root[3] = root[3], root[2]
    assert.same({ "the order of the transitions" }, select(3, snapshot.restore(root,
      snapshot.take(helper.started(chart { "e_x" })))))
  end)
end)

describe("a number in packed data", function()
  for _, case in ipairs {
    { digits = "x", kind = "string" }, { digits = {}, kind = "table" },
  } do
    it("is a text of digits, not a " .. case.kind, function()
      local fsm = helper.started(chart({ "e_x" }, { keep = { "x" } }))
      local snap = snapshot.take(fsm)
      snap.data = { root = { x = { { "%n", case.digits } } } }
      assert.equal("rfsm.snapshot: a number as text expected, got " .. case.kind,
        (select(2, snapshot.put(fsm, snap))))
    end)
  end
end)

describe("a value that is no plain data", function()
  for _, case in ipairs {
    { what = "a function", value = print,
      text = "text, number, boolean or table expected, got function" },
    { what = "NaN in a table", value = { 0 / 0 }, text = "a number expected, got NaN" },
    { what = "a function in a table", value = { { print } },
      text = "text, number, boolean or table expected, got function" },
    { what = "a table as key", value = { [{}] = 1 },
      text = "a text as key expected, got table" },
  } do
    it("is refused: " .. case.what, function()
      local fsm = helper.started(chart({ "e_x" }, { keep = { "x" } }))
      local snap = snapshot.take(fsm)
      snap.data = { root = { x = case.value } }
      assert.same({ false, "rfsm.snapshot: " .. case.text },
        { snapshot.put(fsm, snap) })
      assert.is_nil(fsm.x)
    end)
  end
end)

describe("a list that only looks like packed data", function()
  it("is a list", function()
    local fsm = helper.started(chart({ "e_x" }, { keep = { "x" } }))
    local snap = snapshot.take(fsm)
    snap.data = { root = { x = { "%s", "5" } } }
    assert(snapshot.put(fsm, snap))
    assert.same({ "%s", "5" }, fsm.x)
  end)
end)

describe("migrate", function()
  it("gets a copy, so that one that refuses has changed nothing", function()
    local whole = snapshot.take(helper.started(regions { a = region(1) }))
    for _, snap in ipairs { whole, (json.decode((json.encode(whole)))) } do
      local before = json.encode(snap)
      assert.is_false((snapshot.restore(chart { "e_y" }, snap, { migrate = function(old)
        old.leaf, old.regions["root.w.a"].data.root.m = "root.b", 7
        old.regions["root.w.b"] = {}
        return false
      end })))
      assert.equal(before, json.encode(snap))
    end
  end)
end)

describe("migrate", function()
  local function keeper(keep, fields)
    fields.keep = keep
    return chart({ "e_x" }, fields)
  end

  it("gets values as callbacks know them, also of a region", function()
    local function robot(more)
      local model = regions { r = region({ [7] = 0.1 + 0.2 }, { y = more,
        save = function() return { n = 2 } end, load = function() end }) }
      model.keep, model.n = { "n" }, 1
      return model
    end
    local snap, seen = snapshot.take(helper.started(robot())), nil
    local fsm = restored(robot(state {}), snap, { migrate = function(old)
      seen = { old.data.root.n, old.regions["root.w.r"].data.root.m[7],
        old.regions["root.w.r"].saved.root.n }
      old.data.root.n = { n = old.data.root.n + 1 / 3 }
    end })
    assert.same({ 1, 0.1 + 0.2, 2 }, seen)
    assert.same({ n = 1 + 1 / 3 }, fsm.n)
    assert.equal(0.1 + 0.2, fsm.w.substates.r.m[7])
  end)

  it("leaves a field nil that a callback has set to nil", function()
    local fsm = helper.started(keeper({ "n", "more" }, { n = 1, more = 2 }))
    fsm.n, fsm.more = nil, nil
    local again = restored(keeper({ "n", "more", "new" }, { n = 1, more = 2, new = 3 }),
      snapshot.take(fsm), { migrate = function(old)
        assert.is_nil(old.data.root.n)
        old.data.root.more = 7
      end })
    assert.same({ more = 7, new = 3 }, { n = again.n, more = again.more,
      new = again.new })
  end)

  for what, case in pairs {
    ["a function"] = { value = print, text = "data of root.n: a function cannot be "
      .. "saved" },
    ["a table with a metatable"] = { value = { x = setmetatable({}, {}) }, text =
      "data of root.n.x: a table with a metatable cannot be saved" },
  } do
    it("can add no field with " .. what, function()
      local snap = snapshot.take(helper.started(keeper({}, {})))
      assert.same({ false, "rfsm.snapshot: " .. case.text }, { snapshot.restore(
        keeper({ "n" }, {}), snap, { migrate = function(old)
          old.data = { root = { n = case.value } }
        end }) })
    end)
  end
end)

describe("an option", function()
  local snap

  before_each(function() snap = snapshot.take(helper.started(chart { "e_x" })) end)

  for _, case in ipairs {
    { what = "that is not known", options = { migrat = itself },
      text = "unknown option 'migrat' (did you mean 'migrate'?), "
      .. "expected: entries, migrate, old, rename, trusted" },
    { what = "of another type", options = { rename = 7 },
      text = "rename: table of old and new FQN expected, got 7" },
    { what = "with other names", options = { rename = { ["root.a"] = 7 } },
      text = "rename: table of old and new FQN expected, got table" },
    { what = "that cannot be called", options = { migrate = "f" },
      text = "migrate: function expected, got string 'f'" },
  } do
    it(case.what .. " is refused where it is given", function()
      local function problem_of(call)
        local _, problem = pcall(call)
        assert.matches("^[^:]*upgrade_spec.lua:%d+: ", problem)
        return (problem:gsub("^.-:.-: ", ""))
      end
      assert.same({ "rfsm.snapshot.restore: " .. case.text, "rfsm.snapshot.put: "
        .. case.text }, { problem_of(function()
          local _ = snapshot.restore(chart { "e_x" }, snap, case.options)
        end), problem_of(function()
          snapshot.put(helper.started(chart { "e_x" }), snap, case.options)
        end) })
    end)
  end

  it("is no position that a decoder returns behind the snapshot", function()
    assert(snapshot.restore(chart { "e_x" }, json.decode((json.encode(snap)))))
  end)
end)

describe("a snapshot", function()
  it("has no more than is there", function()
    local fsm = helper.started(chart { "e_x" })
    local name = snapshot.take(fsm).chart
    assert.same({ version = 2, chart = name, leaf = "root.a", done = true },
      snapshot.take(fsm))
    assert.matches("^%x%x%x%x%x%x%x%x%x%x%x$", name)
    rfsm.reset(fsm)
    assert.same({ version = 2, chart = name }, snapshot.take(fsm))
    rfsm.send_events(fsm, "e_x")
    assert.same({ "e_init_fsm", "e_x" }, snapshot.take(fsm).queue)
  end)

  it("names the place of an event that cannot be saved, also in a region", function()
    local fsm = helper.started(regions { a = region(1) })
    rfsm.send_events(fsm.w.substates.a, "e_x", print)
    local _, problem = pcall(snapshot.take, fsm)
    assert.matches("rfsm.snapshot.take: root.w.a queue%[2%]: an event that is a "
      .. "function", problem)
  end)
end)

describe("a machine into which a snapshot cannot be put", function()
  -- A region in it has a `load` that fails if it gets "bad".
  local function model()
    local inner = region(1, { save = function(fsm) return fsm.secret end,
      load = function(fsm, _, value)
        if value == "bad" then error("no good", 0) end
        fsm.secret = value
      end })
    local root = regions { a = inner }
    root.keep, root.n, root.b = { "n" }, 1, state {}
    root[2] = trans { src = "w", tgt = "b", events = { "e_b", "e_after(9)" } }
    return root
  end

  it("is reset if it could not be saved before", function()
    local bad = helper.started(model())
    bad.w.substates.a.secret = "bad"
    local fsm = helper.started(model())
    fsm.w.substates.a.secret = print
    assert.same({ false, "rfsm.snapshot: load of root: no good" },
      { snapshot.put(fsm, snapshot.take(bad)) })
    assert.same({ false, { "e_init_fsm" } }, { rfsm.get_actleaf_fqn(fsm), fsm._intq })
  end)

  it("has to be between two steps", function()
    local fsm, text
    local root = model()
    local snap = snapshot.take(helper.started(root))
    root.entry = function() text = select(2, pcall(snapshot.put, fsm, snap)) end
    fsm = helper.init(root)
    rfsm.run(fsm)
    assert.matches("rfsm.snapshot.put: the machine is in the middle of a step", text)
  end)

  it("is where it was, with what it had", function()
    local bad = helper.started(model())
    bad.n, bad.w.substates.a.secret = 7, "bad"
    local snap = snapshot.take(bad)
    local fsm = helper.started(model())
    fsm.w.substates.a.secret = "good"
    rfsm.send_events(fsm, "e_b")
    rfsm.run(fsm)
    fsm.n = 3
    local before = snapshot.take(fsm)
    assert.same({ false, "rfsm.snapshot: load of root: no good" },
      { snapshot.put(fsm, snap) })
    assert.same(before, snapshot.take(fsm))
    assert.same({ "root.b", 3 }, { rfsm.get_actleaf_fqn(fsm), fsm.n })
    assert.same({ false, "rfsm.snapshot: load of root: no good" },
      { snapshot.restore(model(), snap) })
  end)
end)

describe("the targets that a history has set", function()
  -- The composite `a` may have another name; with `has_service` each transition but the
  -- first has another number.
  local function robot(has_service, a)
    a = a or "a"
    local list = { trans { src = "initial", tgt = "idle" },
      trans { src = "idle", tgt = a, events = { "e_a" } },
      trans { src = "idle", tgt = "b", events = { "e_b" } },
      trans { src = a, tgt = "idle", events = { "e_idle" } },
      trans { src = "b", tgt = "idle", events = { "e_idle" } } }
    if has_service then
      list.service = state {}
      table.insert(list, 2, trans { src = "idle", tgt = "service",
        events = { "e_service" } })
    end
    local function mode()
      return state { history = "deep", x = state {}, y = state {},
        trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "y", events = { "e_y" } } }
    end
    list.idle, list[a], list.b = state {}, mode(), mode()
    list.info, list.warn, list.emem = false, false, false
    return state(list)
  end

  local function leaves(fsm, ...)
    local list = {}
    for i, event in ipairs { ... } do
      helper.post_and_run(fsm, event)
      list[i] = rfsm.get_actleaf_fqn(fsm)
    end
    return list
  end

  local function saved()
    local fsm = helper.started(robot())
    leaves(fsm, "e_a", "e_y", "e_idle", "e_b", "e_idle")
    return snapshot.take(fsm, { structure = true })
  end

  it("follow their transitions, which have other numbers in the new chart", function()
    local fsm = restored(robot(true), saved(), { migrate = itself })
    assert.same({ "root.a.y", "root.idle", "root.b.x", "root.idle", "root.service" },
      leaves(fsm, "e_a", "e_idle", "e_b", "e_idle", "e_service"))
  end)

  it("follow them if states have new names, and in regions", function()
    local function outer(inner)
      return state { info = false, warn = false, emem = false,
        w = rfsm.seqand { r = inner }, trans { src = "initial", tgt = "w" } }
    end
    local fsm = helper.started(outer(robot()))
    for _, event in ipairs { "e_a", "e_y", "e_idle" } do
      helper.post_and_run(fsm, event)
    end
    local again = restored(outer(robot(true, "new")), snapshot.take(fsm), {
      rename = { ["root.w.r.a"] = "root.w.r.new" } })
    local inner = rfsm.machines(again)[2].machine
    assert.equal("root.idle", rfsm.get_actleaf_fqn(inner))
    helper.post_and_run(again, "e_a")
    assert.equal("root.new.y", rfsm.get_actleaf_fqn(inner))
  end)

  it("are refused if the old chart is not known", function()
    local snap = saved()
    snap.chart, snap.structure = "00000000000", nil
    local fsm, problem = snapshot.restore(robot(true), snap, { migrate = itself })
    assert.is_false(fsm)
    assert.equal("rfsm.snapshot: the snapshot holds what the chart lacks (the chart "
      .. "of its time is needed: sim and web take that file, a library both under one "
      .. "name, NAME=OLD.lua NAME=NEW.lua; in Lua restore(model, snap, { old = "
      .. "model_of_then })):\n"
      .. "  target root.a.y of transition 2 in root\n"
      .. "  target root.b.x of transition 3 in root", problem)
    fsm = restored(robot(true), snap, { migrate = itself, old = robot() })
    assert.same({ "root.a.y" }, leaves(fsm, "e_a"))
  end)

  it("are left out with their transitions", function()
    local model = robot()
    model[2].events = { "e_new" } -- the same transition
    model[3] = trans { src = "b", tgt = "b", events = { "e_b" } }
    local fsm = restored(model, saved(), { migrate = itself })
    assert.same({ "root.a.y" }, leaves(fsm, "e_new"))
    assert.equal("root.b.initial", fsm[3].tgt._fqn)
  end)
end)

describe("a target that a program has set", function()
  it("is named if it is gone", function()
    local fsm = helper.started(chart { "e_x" })
    fsm[2].tgt = fsm.a
    local snap = snapshot.take(fsm)
    assert.equal("a", restored(chart { "e_x" }, snap)[2].tgt._id)
    snap.targets[3], snap.chart = "root.c", "00000000000"
    assert.same({ "target root.c of transition 2 in root" }, select(3,
      snapshot.restore(chart { "e_y" }, snap, { migrate = itself })))
  end)
end)

describe("timers of regions", function()
  local function arm(events)
    return region(1, { y = state {}, trans { src = "initial", tgt = "x" },
      trans { src = "x", tgt = "y", events = events } })
  end

  it("follow the chart of the region", function()
    local function moved(old, new)
      now = 0
      local fsm = helper.started(regions { a = arm(old), b = arm { "e_after(50)" } })
      now = 2
      local again = restored(regions { a = arm(new), b = arm { "e_after(50)" } },
        snapshot.take(fsm), { migrate = itself })
      local left = {}
      for _, name in ipairs { "a", "b" } do
        local deadline = timeevent.next_deadline(again.w.substates[name])
        left[name] = deadline and math.floor(deadline + 0.5)
      end
      return left
    end
    assert.same({ a = 7, b = 48 }, moved({ "e_x" }, { "e_after(7)" }))
    assert.same({ b = 48 }, moved({ "e_after(7)" }, { "e_x" }))
    assert.same({ a = 5, b = 48 }, moved({ "e_after(7)" }, { "e_after(7)", "e_x" }))
  end)

  it("that have expired do not expire again", function()
    local function waiting(events)
      local model = arm(events)
      model[2].guard = function() return false end
      return regions { a = model }
    end
    local fsm = helper.started(waiting { "e_after(1)" })
    now = 5
    rfsm.run(fsm)
    local again = restored(waiting { "e_after(1)", "e_x" }, snapshot.take(fsm),
      { migrate = itself })
    assert.is_nil(timeevent.next_deadline(again.w.substates.a))
  end)
end)

describe("what a state keeps", function()
  for _, name in ipairs { "entry", "exit", "doo", "keep", "save", "load", "getevents",
    "dbg", "info", "warn", "err", "idle_hook", "pre_step_hook", "post_step_hook",
    "_mode", "a" } do
    it("is no field of the engine: " .. name, function()
      local fsm = helper.init(chart({ "e_x" }, { keep = { name } }))
      assert.matches("root.keep%[1%]: name of a field with data expected, got '" .. name
        .. "'", (select(2, pcall(snapshot.take, fsm))))
    end)
  end

  it("may contain itself in the model, and is named when it is saved", function()
    local cycle = { 1 }
    cycle[2] = cycle
    local fsm = helper.started(chart({ "e_x" }, { keep = { "list" }, list = cycle }))
    local _, problem = pcall(snapshot.take, fsm)
    assert.matches("root.list%[2%]: this table stands elsewhere in the data, too, and "
      .. "can only be saved once", problem)
    fsm.list = { 7 }
    local again = restored(chart({ "e_x" }, { keep = { "list" }, list = cycle }),
      snapshot.take(fsm))
    assert.same({ 7 }, again.list)
  end)

  it("is given to load, also nil, but not if the chart is another one", function()
    local seen = {}
    local function model(events)
      return chart(events, { save = function() return nil end,
        load = function(_, _, value) seen[#seen + 1] = tostring(value) end })
    end
    local snap = snapshot.take(helper.started(model { "e_x" }))
    restored(model { "e_x" }, snap)
    assert.same({ "nil" }, seen)
    restored(model { "e_y" }, snap, { migrate = itself })
    assert.same({ "nil" }, seen)
  end)

  it("of two states that get one name is refused", function()
    local function model(names)
      local root = { info = false, warn = false, emem = false,
        trans { src = "initial", tgt = names:sub(1, 1) } }
      for name in names:gmatch(".") do
        root[name] = state { keep = { "n" }, n = name }
      end
      return state(root)
    end
    local fsm = helper.started(model "ab")
    local rename = { ["root.a"] = "root.c", ["root.b"] = "root.c" }
    assert.same({ false, "rfsm.snapshot: rename: two with data become root.c (only the "
      .. "option 'migrate' can join them)" },
      { snapshot.restore(model "c", snapshot.take(fsm), { rename = rename }) })
    assert.equal("b", restored(model "ca", snapshot.take(fsm), { rename = {
      ["root.a"] = "root.c", ["root.b"] = "root.a" } }).a.n)
  end)

  it("is not renamed, but the names of states are", function()
    local function model(name)
      return state { info = false, warn = false, emem = false, keep = { "x", "y" },
        x = "root.a", y = { ["root.a"] = "e_done@root.a" },
        [name] = state { keep = { "z" }, z = 1 },
        trans { src = "initial", tgt = name },
        trans { src = name, tgt = name, events = { "e_x" } } }
    end
    local fsm = helper.started(model "a")
    fsm.a.z, fsm[2].tgt = 7, fsm.initial
    rfsm.send_events(fsm, "e_done@root.a", "root.a", "root.ab")
    local again = restored(model "b", snapshot.take(fsm), { rename = { ["root.a"] =
      "root.b" } })
    assert.same({ "root.a", { ["root.a"] = "e_done@root.a" }, 7, "root.initial",
      { "e_done@root.b", "root.b", "root.ab" } },
      { again.x, again.y, again.b.z, again[2].tgt._fqn, again._intq })
  end)

  it("is plain in a snapshot, if JSON has it", function()
    local numbers = { 0, -1, 1.5, 99999999999999, -99999999999999 }
    local none = helper.init(chart({ "e_x" }, { keep = { "list" }, list = numbers }))
    assert.same({ root = { list = numbers } }, snapshot.take(none).data)
    none.list = { 1e14, -1e14, math.huge, -math.huge, 0.1 + 0.2, -1 / math.huge }
    for _, number in ipairs(snapshot.take(none).data.root.list) do
      assert.equal("%n", number[1])
    end
    local data = { list = { 1, "b", true, { 2 } }, map = { x = { y = 1.5 } }, n = 3 }
    local fsm = helper.init(chart({ "e_x" }, { keep = { "list", "map", "text" },
      text = "t", list = data.list, map = data.map }))
    local first = { list = data.list, map = data.map, text = "t" }
    assert.same({ root = first }, snapshot.take(fsm).data)
    fsm.map = data
    assert.same({ "%t", "list", data.list, "map", data.map, "n", 3 },
      snapshot.take(fsm).data.root.map)
  end)
end)

-- Returns what cjson has for null; nil where plain Lua cannot make such a value.
local function new_userdata()
  local newproxy = rawget(_G, "newproxy")
  local null = newproxy and newproxy(true)
  if not null then return nil end
  getmetatable(null).__tostring = function() return "userdata: NULL" end
  return null
end

describe("null of JSON", function()
  for name, null in pairs {
    ["that of cjson"] = new_userdata(),
    ["that of dkjson"] = json.null,
    ["that of a decoder in C"] = rawget(_G, "ngx") and rawget(_G, "ngx").null
      or setmetatable({}, { __tojson = function() return "null" end }),
  } do
    it("in data is nil: " .. name, function()
      local fsm = helper.started(chart({ "e_x" }, { keep = { "list", "x" } }))
      fsm.list, fsm.x = { 1, null, { null }, a = null }, null
      local again = restored(chart({ "e_x" }, { keep = { "list", "x" } }),
        snapshot.take(fsm))
      assert.same({ { [1] = 1, [3] = {} }, nil }, { again.list, again.x })
    end)

    it("in place of a field of a snapshot is what is absent: " .. name, function()
      local model = regions { a = region(1) }
      local whole = snapshot.take(helper.started(model))
      for _, field in ipairs { "leaf", "done", "queue", "data", "saved", "targets",
        "ext", "regions", "structure" } do
        local snap, without = {}, {}
        for key, value in pairs(whole) do snap[key], without[key] = value, value end
        snap[field], without[field] = null, nil
        assert.same(snapshot.take(restored(model, without)),
          snapshot.take(restored(model, snap)))
      end
      whole.regions["root.w.a"] = null
      assert.is_false(rfsm.get_actleaf_fqn(restored(model, whole).w.substates.a))
      whole.data = { root = null }
      assert(restored(model, whole))
      whole.chart = null
      assert.equal("rfsm.snapshot: chart: string expected, got nil",
        (select(2, snapshot.restore(model, whole))))
    end)

    it("in a snapshot is what is absent: " .. name, function()
      local snap = snapshot.take(helper.started(chart({ "e_x" }, { keep = { "x" } })))
      snap.queue, snap.data = null, { root = { x = null } }
      local fsm = restored(chart({ "e_x" }, { keep = { "x" } }), snap)
      assert.same({ "root.a", nil }, { rfsm.get_actleaf_fqn(fsm), fsm.x })
    end)
  end
end)

describe("9 tables inside each other", function()
  local function nested(depth)
    local value = 0.1 + 0.2
    for _ = 1, depth do value = { v = value, [true] = "t" } end
    return value
  end

  local function depth_of(value)
    local most = 0
    if type(value) ~= "table" then return most end
    for _, inner in pairs(value) do most = math.max(most, depth_of(inner)) end
    return most + 1
  end

  -- A machine whose data is in so many regions.
  local function wrapped(level, value)
    local model = region(value)
    for _ = 1, level do model = regions { r = model } end
    return model
  end

  for level = 0, 3 do
    it("are kept with " .. level .. " regions around them", function()
      local snap = snapshot.take(helper.started(wrapped(level, nested(9))))
      assert.is_true(depth_of(snap) < 16, "cmsgpack takes 16, one is the value's")
      local fsm = restored(wrapped(level, 0), (json.decode((json.encode(snap)))))
      for _ = 1, level do fsm = fsm.w.substates.r end
      assert.same(nested(9), fsm.m)
    end)

    it("are the most, and the field is named, with " .. level .. " regions", function()
      assert.equal("rfsm.snapshot.take: root" .. (".w.r"):rep(level)
        .. ".m: at most 9 tables inside each other expected",
        (select(2, pcall(snapshot.take, helper.started(wrapped(level, nested(10)))))
          :gsub("^%S+:%d+: ", "")))
    end)
  end
end)

describe("random charts", function()
  for _, name in ipairs { "migration", "short", "snapshot" } do
    local claim = require("spec.support.claims." .. name)
    it("agree with the claim: " .. claim.name, function()
      assert.is_nil(share.problem(claim, name == "short" and 12 or 40))
    end)
  end
end)

describe("events that a machine keeps", function()
  -- busy, which defers `deferred`, --e_free--> idle --`job`--> busy
  local function worker(job, deferred)
    return state { info = false, warn = false, emem = false, keep = { "n" }, n = 0,
      busy = state { defer = deferred or nil }, idle = state { defer = { "e_other" } },
      trans { src = "initial", tgt = "busy" },
      trans { src = "busy", tgt = "idle", events = { "e_free" } },
      trans { src = "idle", tgt = "busy", events = { job } } }
  end

  local NAMED, OTHER = rfsm.named "e_job", rfsm.named "e_task"
  local KEPT = '{"chart":"81f5cb1c59f-2c59b6","data":{"root":["%t","n",0]},"done":true,'
    .. '"ext":{"defer":[{"k":7,"name":"e_job"}]},"leaf":"root.busy","version":2}'

  local function keeping()
    local fsm = helper.started(worker(NAMED, { NAMED }))
    rfsm.send_events(fsm, { name = "e_job", k = 7 })
    rfsm.run(fsm)
    return snapshot.take(fsm)
  end

  -- Restores a machine; returns what it reports, and the machine.
  local function reported(model, snap, options)
    local lines = {}
    model.err = function(text) lines[#lines + 1] = text end
    local fsm, problem, list = snapshot.restore(model, snap, options)
    return lines, fsm, problem, list
  end

  local LOST = "rfsm.snapshot: the event 'e_job' waits, but no transition of the chart "
    .. "takes it"

  it("belong to the structure by their names, as what states defer does", function()
    local lines = snapshot.structure(worker(NAMED, { NAMED, 7, "e_x" }))
    assert.same({ "root.idle -> root.busy on e_job{..}", "state root.busy",
      "root.busy defers e_job{..}, 7, e_x", "state root.idle",
      "root.idle defers e_other" },
      { lines[4], lines[5], lines[6], lines[7], lines[8] })
    local _, ok, _, list = reported(worker(OTHER, false), keeping())
    assert.is_false(ok)
    assert.same({ "new: root.idle -> root.busy on e_task{..}",
      "gone: root.idle -> root.busy on e_job{..}", "gone: root.busy defers e_job{..}" },
      list)
  end)

  it("are reported if no transition of the new chart takes them", function()
    for _, deferred in ipairs { false, { OTHER }, { NAMED } } do
      assert.same({ LOST }, (reported(worker(OTHER, deferred), keeping(),
        { rename = {} })))
    end
  end)

  it("are not reported if something in the new chart takes them", function()
    local plain = helper.started(worker("e_job", { "e_job" }))
    rfsm.send_events(plain, "e_job")
    rfsm.run(plain)
    local snap = snapshot.take(plain)
    for _, event in ipairs { "e_job", "await(e_job, e_x)",
      function(e) return e == "e_job" end } do
      local lines, fsm = reported(worker(event, false), snap, { rename = {} })
      assert.same({}, lines)
      assert.is_truthy(fsm)
    end
  end)

  it("are those of a snapshot that an older release has taken", function()
    local lines, fsm = reported(state { info = false, warn = false, keep = { "n" },
      n = 0, busy = state { defer = { NAMED } }, idle = state {},
      trans { src = "initial", tgt = "busy" },
      trans { src = "busy", tgt = "idle", events = { "e_free" } },
      trans { src = "idle", tgt = "busy", events = { NAMED } } }, json.decode(KEPT))
    assert.same({}, lines)
    rfsm.send_events(fsm, "e_free")
    rfsm.run(fsm)
    assert.equal("root.busy", rfsm.get_actleaf_fqn(fsm))
    assert.not_equal("81f5cb1c59f-2c59b6", snapshot.take(fsm).chart)
  end)

  it("of an older release are reported, too, after a rename", function()
    local lines = reported(state { info = false, warn = false, keep = { "n" }, n = 0,
      busy = state { defer = { OTHER } }, idle = state {},
      trans { src = "initial", tgt = "busy" },
      trans { src = "busy", tgt = "idle", events = { "e_free" } },
      trans { src = "idle", tgt = "busy", events = { OTHER } } }, json.decode(KEPT))
    assert.same({ LOST }, lines)
  end)
end)

describe("rfsm snapshot diff", function()
  after_each(helper.remove_files)

  local OLD = [[return rfsm.state { keep = { "n", "old" }, n = 1,
    a = rfsm.state {}, b = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" },
    rfsm.trans { src = "a", tgt = "b", events = { "e_after(3)" } } }]]

  -- Returns what the command prints on two charts, and the status.
  local function compare(new, old)
    local lines = helper.lines_of(("tools/rfsm snapshot diff %s %s 2>&1; echo $?")
      :format(helper.file_with(old or OLD), helper.file_with(new)))
    local status = tonumber(table.remove(lines))
    if lines[#lines]:find("^  states of several") then -- the premises
      for _ = 1, 3 do table.remove(lines) end
    end
    return lines, status
  end

  it("says which kept events are lost", function()
    local old = [[require "rfsm.defer"
      return rfsm.state { rename = {},
      a = rfsm.state { defer = { rfsm.named "e_job" } }, b = rfsm.state {},
      rfsm.trans { src = "initial", tgt = "a" },
      rfsm.trans { src = "a", tgt = "b", events = { "e_free" } },
      rfsm.trans { src = "b", tgt = "a", events = { rfsm.named "e_job" } } }]]
    local new = old:gsub('e_job" } } }%]?', 'e_task" } } }')
    assert.same({ { "new: root.b -> root.a on e_task{..}",
      "gone: root.b -> root.a on e_job{..}", "in root.a: moves to root.a",
      "  a kept e_job is reported and lost: no transition takes it",
      "in root.b: moves to root.b" }, 0 }, { compare(new, old) })
    new = old:gsub('{ defer = { rfsm.named "e_job" } }', "{}")
    assert.same({ { "gone: root.a defers e_job{..}", "in root.a: moves to root.a",
      "in root.b: moves to root.b" }, 0 }, { compare(new, old) })
  end)

  it("says of each state what will happen", function()
    local new = OLD:gsub("3", "9"):gsub('b = ', 'c = ')
      :gsub('tgt = "b"', 'tgt = "c"'):gsub("keep", "more = 1, keep")
    assert.same({ "new: root.a -> root.c on e_after(9)@root.a", "new: state root.c",
      "gone: root.a -> root.b on e_after(3)@root.a", "gone: state root.b",
      "in root.a and root.b: stays a machine of the old version",
      "  the root of the new chart has neither 'rename' nor 'migrate'" },
      (compare(new)))
    local lines, status = compare((new:gsub("more = 1",
      "rename = { ['root.b'] = 'root.c' }")))
    assert.same({ { "in root.a: moves to root.a",
      "  timer e_after(3)@root.a is dropped",
      "  timer e_after(9)@root.a begins, with its whole time",
      "in root.b: moves to root.c" }, 0 },
      { { lines[5], lines[6], lines[7], lines[8], lines[9] }, status })
  end)

  it("names what would be lost", function()
    local lines, status = compare((OLD:gsub('"n", "old"', '"n"')))
    assert.same({ "gone: field old of root", "in root.a and root.b: stays a machine of "
      .. "the old version", "  the snapshot holds what the chart lacks",
      "  field old of root" }, lines)
    assert.equal(1, status)
  end)

  it("has the words of a load that fails, whatever they are", function()
    local old = [[return rfsm.state { keep = { "n" }, n = 1, a = rfsm.state {},
      rfsm.trans { src = "initial", tgt = "a" }, save = function() return 1 end,
      load = function() error("this is of another chart:\n7", 0) end }]]
    assert.same({ { "new: field more of root", "in root.a: stays a machine of the old "
      .. "version", "  rfsm.snapshot: load of root: this is of another chart:" }, 1 },
      { compare((old:gsub('"n" }', '"n", "more" }')), old) })
  end)

  it("looks at each state of each region", function()
    local function robot(last, timer, more)
      return (([[
        local function region(inner, time)
          return rfsm.state { x = rfsm.state {}, LAST = inner,
            rfsm.trans { src = "initial", tgt = "x" },
            rfsm.trans { src = "x", tgt = "LAST", events = { time } } }
        end
        return rfsm.state { MORE idle = rfsm.state {}, w = rfsm.seqand {
          r = region(rfsm.seqand { q = region(rfsm.state {}, "e_after(5)") }, "TIMER")
        },
          rfsm.trans { src = "initial", tgt = "idle" },
          rfsm.trans { src = "idle", tgt = "w", events = { "e_w" } } }]])
        :gsub("LAST", last):gsub("TIMER", timer):gsub("MORE", more or ""))
    end
    -- Returns what happens, without what differs.
    local function fates(old, new)
      local lines, status = compare(new, old)
      while not lines[1]:find("^in ") do table.remove(lines, 1) end
      return lines, status
    end
    local old = robot("y", "e_after(5)")
    assert.same({ "in root.idle: moves to root.idle", "in root.w: moves to root.w",
      "in root.w.r.x: moves to root.w.r.x", "  timer e_after(5)@root.x is dropped",
      "in root.w.r.y to root.w.r.y.q.y (3 states): stays a machine of the old version",
      "  the snapshot holds what the chart lacks", "  state root.w.r.y",
      "  region root.w.r.y.q" }, (fates(old, robot("z", "e_x",
        "migrate = function() end,"))))
    local lines, status = fates(old, robot("z", "e_after(5)",
      "rename = { ['root.w.r.y'] = 'root.w.r.z', "
      .. "['root.w.r.y.q.y'] = 'root.w.r.z.q.z' },"))
    assert.same({ { "in root.idle: moves to root.idle", "in root.w: moves to root.w",
      "in root.w.r.x: moves to root.w.r.x", "in root.w.r.y: moves to root.w.r.z",
      "in root.w.r.y.q.x: moves to root.w.r.z.q.x",
      "in root.w.r.y.q.y: moves to root.w.r.z.q.z" }, 0 }, { lines, status })
  end)

  it("says that there is no difference", function()
    local lines, status = compare(OLD)
    assert.same({ { "the charts have the same structure and keep the same: nothing "
      .. "moves" }, 0 }, { lines, status })
  end)
end)
