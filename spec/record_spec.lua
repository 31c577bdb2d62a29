-- Recordings: the same run again, from the events, the clock and the guards.
--
-- RFSM_N=10000 makes the random part longer.

local claim = require "spec.support.claims.record"
local interrupted_claim = require "spec.support.claims.interrupted"
local helper = require "spec.helper"
local json = require "dkjson"
local kept = require "spec.support.kept"
local journal = require "rfsm.record.journal"
local record = require "rfsm.record"
local rfsm = require "rfsm"
local share = require "spec.support.share"
local snapshot = require "rfsm.snapshot"
require "rfsm.history"
require "rfsm.defer"
require "rfsm.faults"
local timeevent = require "rfsm_timeevent"

local state, trans = rfsm.state, rfsm.trans
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local N = tonumber(os.getenv("RFSM_N")) or share.count(10)
local FIRST = share.seed(N)

after_each(helper.remove_files)

-- idle --e_go--> busy --e_done--> idle; go is guarded by what `sensor` returns
local function worker(trace, sensor)
  local function note(text) return function() trace[#trace + 1] = text end end
  return state {
    info = false, warn = false, err = false, emem = false, keep = { "count" },
    count = 0,
    idle = state { entry = note "idle" },
    busy = state { entry = function(fsm)
      trace[#trace + 1] = "busy"
      fsm.count = fsm.count + 1
      rfsm.send_events(fsm, "e_own" .. fsm.count)
    end },
    trans { src = "initial", tgt = "idle" },
    trans { src = "idle", tgt = "busy", events = { "e_go" },
      guard = function() return sensor() end },
    trans { src = "busy", tgt = "idle", events = { "e_own1", "e_own2" } },
  }
end

local function yes() return true end

-- Returns the text of a file as an older release wrote it; with `number`, only this
-- line has no check sum.
local function without_sums(text, number)
  local at = 0
  return (text:gsub(',"sum":"%x+"}', function()
    at = at + 1
    return (number or at) == at and "}" or nil
  end))
end

-- Returns the recording of a run in which the sensor returns false the second time.
local function recorded(sink)
  local calls, trace = 0, {}
  local fsm = helper.init(worker(trace, function()
    calls = calls + 1
    return calls ~= 2
  end))
  local recorder = record.record(fsm, sink)
  rfsm.run(fsm)
  for _ = 1, 3 do helper.post_and_run(fsm, "e_go") end
  return recorder, fsm, trace
end

-- a --{ e_paid, amount 12 }--> b --{ e_own }--> c, where the exit of a sends e_own; in
-- c a region: x --{ e_r }--> y; c --{ e_back, later }--> a
local function paying(sums)
  local function amount(name, wanted)
    return function(_, events)
      for _, event in ipairs(events) do
        if event.name == name and event.by.id == wanted then return true end
      end
      return false
    end
  end
  return state { info = false, warn = false, keep = { "last" },
    a = state { exit = function(fsm)
      rfsm.send_events(fsm,
        { name = "e_own", n = 0.1, by = { id = 1, n = 5 }, [3] = 1 })
    end },
    b = state {},
    c = rfsm.seqand { idle_doo = "auto", left = state { x = state {}, y = state {},
      trans { src = "initial", tgt = "x" },
      trans { src = "x", tgt = "y", events = { rfsm.named "e_r" },
        guard = amount("e_r", 7) } } },
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { rfsm.named "e_paid" },
      guard = amount("e_paid", 12) },
    trans { src = "b", tgt = "c", events = { rfsm.named "e_own" },
      effect = function(fsm, _, _, events)
        fsm.last = events[1].by
        sums[#sums + 1] = events[1].n + events[1].by.n + events[1][3]
        timeevent.send_after(fsm, 5, { name = "e_back", by = { id = 2 } })
      end },
    trans { src = "c", tgt = "a", events = { rfsm.named "e_back" },
      guard = amount("e_back", 2) },
  }
end

describe("a machine that reads one event an iteration", function()
  -- a -e_go-> b, whose entry sends e_s1 and e_s2 -> c -> par, a region x -e_r{..}-> y
  local function reader(more)
    local model = { info = false, warn = false, read = "one", n = 0, keep = { "n" },
      a = state {}, c = state {}, par = rfsm.seqand { idle_doo = "auto",
        r = state { info = false, warn = false, x = state {}, y = state {},
          trans { src = "initial", tgt = "x" },
          trans { src = "x", tgt = "y", events = { rfsm.named "e_r" },
            guard = function(_, _, event) return event.v > 3 end } } },
      b = state { entry = function(fsm) rfsm.send_events(fsm, "e_s1", "e_s2") end },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "internal", events = { rfsm.named "e_r" },
        effect = function(fsm, _, _, _, event) fsm.n = fsm.n + event.v end },
      trans { src = "a", tgt = "b", events = { "e_go" } },
      trans { src = "b", tgt = "c", events = { "e_s1" } },
      trans { src = "c", tgt = "par", events = { "e_s2" } } }
    for key, value in pairs(more or {}) do model[key] = value end -- any order: a set
    return state(model)
  end

  local function e_r(v) return { name = "e_r", v = v } end

  for _, dry in ipairs { false, true } do
    it("replays what it read, dry: " .. tostring(dry), function()
      local fsm, recording = helper.init(reader()), {}
      local recorder = record.record(fsm, recording)
      rfsm.send_events(fsm, e_r(1))
      rfsm.run(fsm)
      helper.post_and_run(fsm, e_r(2), e_r(3), "e_go", "e_s1", e_r(4))
      helper.post_and_run(fsm, e_r(2), e_r(5), "e_s1", "e_s1")
      recorder:stop()
      assert.same({ "root.par", 6 }, { rfsm.get_actleaf_fqn(fsm), fsm.n })
      local again, problem = record.replay(reader(), recording, { dry = dry })
      assert.same({ "root.par", 6, nil }, { again and rfsm.get_actleaf_fqn(again),
        again and again.n, problem })
      assert.equal("root.y", rfsm.get_actleaf_fqn(rfsm.regions(again.par)[1]))
    end)
  end

  it("replays deferred events, each in an iteration", function()
    local more = { a = state { defer = { "e_s1" } } }
    local fsm, recording = helper.init(reader(more)), {}
    local recorder = record.record(fsm, recording)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_s1", e_r(2), "e_go", "e_x")
    recorder:stop()
    local leaf = rfsm.get_actleaf_fqn(fsm)
    local again = assert(record.replay(reader(more), recording))
    assert.equal(leaf, rfsm.get_actleaf_fqn(again))
  end)
end)

describe("events with data", function()
  -- Runs the chart, and returns its fqn at the end.
  local function run_all(fsm, now)
    local same = { name = "e_paid", by = { id = 12 } }
    fsm.gettime = function() return now[1], 0 end
    helper.post_and_run(fsm, "e_none", { name = "e_paid", by = { id = 11 } })
    helper.post_and_run(fsm, same, same, { name = "e_none" })
    helper.post_and_run(fsm, { name = "e_r", by = { id = 7 } })
    local region = fsm.c.substates and fsm.c._regions[1] or fsm
    assert.equal("root.y", rfsm.get_actleaf_fqn(region))
    now[1] = 6
    return helper.leaf_after(fsm)
  end

  for _, kind in ipairs { "list", "file" } do
    it("are replayed with it from a " .. kind .. ", also dry", function()
      local sums, now = {}, { 0 }
      local sink = kind == "list" and {} or helper.file_with("")
      local fsm = helper.init(paying(sums))
      local recorder = record.record(fsm, sink)
      assert.equal("root.a", run_all(fsm, now))
      recorder:stop()
      for _, dry in ipairs { false, true } do
        local again = assert(record.replay(paying(sums), sink,
          { dry = dry, guards = true }))
        assert.equal("root.a", rfsm.get_actleaf_fqn(again))
        assert.same({ id = 1, n = 5 }, again.last)
      end
      assert.same({ 6.1, 6.1 }, sums)
    end)
  end

  it("are as new ones after each replay", function()
    local sink = {}
    local fsm = helper.started(paying({}))
    local recorder = record.record(fsm, sink)
    local event = { name = "e_paid", by = { id = 12 } }
    assert.equal("root.c", helper.leaf_after(fsm, event))
    recorder:stop()
    event.by.id = 0
    for _ = 1, 2 do
      local again = assert(record.replay(paying({}), sink))
      assert.equal("root.c", rfsm.get_actleaf_fqn(again))
      again.last.id = 9
    end
  end)
end)

describe("a recording", function()
  it("holds what came from outside, and what followed", function()
    local sink = {}
    local recorder, fsm = recorded(sink)
    assert.equal(1, sink[1].record)
    assert.same(snapshot.take(helper.init(worker({}, yes))), sink[1].snapshot)
    assert.same({
      { events = { "e_init_fsm" }, sent = { "e_done@root.idle" }, leaf = "root.idle",
        done = true },
      { events = { "e_done@root.idle" }, leaf = "root.idle", done = true },
      { events = { "e_go" }, guards = { 2, true }, kept = { data = { root =
        { count = 1 } } }, sent = { "e_own1", "e_done@root.busy" }, leaf = "root.busy",
        done = true },
    }, { sink[2], sink[3], sink[4] })
    assert.same({ 9, 10 }, { recorder.count, #sink })
    recorder:stop()
    helper.post_and_run(fsm, "e_go")
    assert.equal(10, #sink)
  end)

  it("has the events that hooks have added apart", function()
    local sink, fsm = {}, helper.init(worker({}, yes))
    record.record(fsm, sink)
    rfsm.pre_step_hook_add(fsm, function(_, events) events[#events + 1] = "e_more" end)
    rfsm.step(fsm)
    assert.same({ { "e_init_fsm" }, { "e_more" } }, { sink[2].events, sink[2].added })
  end)

  it("begins between two steps only", function()
    local model, text, fsm = worker({}, yes), nil, nil
    local begin = record.record
    function model.busy.entry() text = helper.refusal(begin, fsm, {}) end
    fsm = helper.init(model)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_go")
    assert.is_truthy(text:find("rfsm.record.record: the machine is in the middle of "
      .. "a step", 1, true), text)
  end)

  it("of a machine that cannot be saved at the end has no machine, but the reason",
    function()
      local sink, model = {}, helper.chart({ "e_x" }, { keep = { "x" }, emem = false })
      local fsm = helper.init(model)
      record.record(fsm, sink)
      rfsm.run(fsm)
      model.save, model.load = function() error("no space", 0) end, function() end
      local again, problem = record.replay(model, sink, { dry = true, migrate = true })
      assert.is_false(again)
      assert.matches("save of root: no space$", problem)
    end)

  it("is replayed with the callbacks, and the guards as they were", function()
    local sink = {}
    local _, _, trace = recorded(sink)
    local again = {}
    local fsm = assert(record.replay(worker(again, error), sink))
    assert.same(trace, again)
    assert.equal(2, fsm.count)
  end)

  it("leaves nothing behind in a machine that was replayed", function()
    local sink = {}
    recorded(sink)
    local model, events = worker({}, yes), { "e_go" }
    function model.getevents()
      local list = events
      events = {}
      return list
    end
    local fsm = assert(record.replay(model, sink))
    assert.same({ 0, 0, 0 }, { #fsm._pre_hooks - 1, #fsm._post_hooks - 1,
      #(fsm._reset_hooks or {}) })
    rfsm.run(fsm)
    assert.same({ 3, "root.busy" }, { fsm.count, rfsm.get_actleaf_fqn(fsm) })
  end)

  it("is replayed dry: nothing is called", function()
    local sink, again = {}, {}
    recorded(sink)
    local fsm = assert(record.replay(worker(again, error), sink, { dry = true }))
    assert.same({ {}, 2, "root.idle" }, { again, fsm.count, rfsm.get_actleaf_fqn(fsm) })
    helper.post_and_run(fsm, "e_go") -- its callbacks are there
    assert.same({}, again) -- the guard fails
  end)

  it("knows its guards by machine, number and text", function()
    local function region()
      return state { info = false, warn = false, x = state {},
        trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "x", events = { "e_r" }, guard = yes } }
    end
    local sink = {}
    record.record(helper.init(state { info = false, warn = false,
      both = rfsm.seqand { a = helper.init(region()), b = helper.init(region()) },
      trans { src = "initial", tgt = "both" },
      trans { src = "both", tgt = "both", events = { "e_b" }, guard = yes } }), sink)
    local loop = "T={ src='root.x', tgt='root.x', events='e_r' }"
    assert.same({ { 2, "T={ src='root.both', tgt='root.both', events='e_b' }" },
      { 2, loop }, { 2, loop } }, sink[1].guards)
    sink = {}
    record.record(helper.init(state { info = false, warn = false,
      both = rfsm.seqand { b = helper.init(region()) },
      trans { src = "initial", tgt = "both" } }), sink)
    assert.same({ {}, { 2, loop } }, sink[1].guards)
    sink = {}
    record.record(helper.init(state { info = false, a = state {},
      trans { src = "initial", tgt = "a" } }), sink)
    assert.is_nil(sink[1].guards)
  end)

  it("finds a guard by its text in a chart with other transitions", function()
    local sink = {}
    recorded(sink)
    local model = worker({}, error)
    table.insert(model, 2, trans { src = "idle", tgt = "idle", events = { "e_new" },
      guard = error })
    assert.matches("^rfsm.snapshot: the snapshot is of another chart",
      select(2, record.replay(model, sink)))
    local fsm = assert(record.replay(model, sink, { migrate = true }))
    assert.equal("root.idle", rfsm.get_actleaf_fqn(fsm))
    local without = worker({}, yes)
    without[2].guard = nil
    assert(record.replay(without, sink, { migrate = true, to = 5 }))
  end)

  it("is replayed up to an iteration", function()
    local sink = {}
    recorded(sink)
    local fsm = assert(record.replay(worker({}, yes), sink, { dry = true, to = 3 }))
    assert.same({ "root.busy", 1 }, { rfsm.get_actleaf_fqn(fsm), fsm.count })
    assert.same({ "e_own1", "e_done@root.busy" }, fsm._intq)
    assert.equal(false, rfsm.get_actleaf_fqn(assert(
      record.replay(worker({}, yes), sink, { to = 0 }))))
  end)

  it("reports the step at which a callback behaves otherwise", function()
    local sink = {}
    recorded(sink)
    local model = worker({}, yes)
    model.busy.entry = function(fsm)
      fsm.count = fsm.count + 1
      rfsm.send_events(fsm, "e_mine")
    end
    assert.same({ false, "step 3: events sent: e_own1, e_done@root.busy expected, "
      .. "got e_mine, e_done@root.busy", 2 }, { record.replay(model, sink) })
    assert.same({ false, "step 6: the guard of T={ src='root.idle', tgt='root.busy', "
      .. "events='e_go' } behaves otherwise", 5 },
      { record.replay(worker({}, yes), sink, { guards = true }) })
  end)

  it("reports the step at which a chart goes another way", function()
    local sink = {}
    recorded(sink)
    sink[4].leaf = "root.idle"
    assert.same({ false, "step 3: active leaf root.idle(done) expected, got "
      .. "root.busy(done)", 2 }, { record.replay(worker({}, yes), sink,
      { dry = true }) })
    assert.same({ false, "rfsm.record: a recording of format 1 expected" },
      { record.replay(worker({}, yes), {}) })
    assert.same({ false, "rfsm.record: record 2: table expected, got number" },
      { record.replay(worker({}, yes), { sink[1], 7 }) })
    assert.matches("^rfsm.snapshot: the snapshot is of another chart:\n",
      select(2, record.replay(state { a = state {}, info = false, warn = false,
        trans { src = "initial", tgt = "a" } }, sink)))
  end)

  it("reports an event that cannot be replayed", function()
    local sink = {}
    local _, fsm = recorded(sink)
    helper.post_and_run(fsm, print)
    assert.equal("step 10: an event that is a function cannot be replayed",
      select(2, record.replay(worker({}, yes), sink, { dry = true })))
  end)

  it("names an event with data that cannot be replayed", function()
    for _, event in ipairs { setmetatable({ name = "e_paid" }, {}),
      { name = "e_paid", f = print } } do
      local sink = {}
      local _, fsm = recorded(sink)
      helper.post_and_run(fsm, event, "e_go")
      assert.equal("step 10: an event that is a table named 'e_paid' cannot be "
        .. "replayed", select(2, record.replay(worker({}, yes), sink, { dry = true })))
    end
  end)

  it("names the field and both values when the data is not as it was", function()
    local sink = {}
    recorded(sink)
    local function problem(change)
      local model = worker({}, yes)
      local own = model.busy.entry
      model.busy.entry = function(fsm) own(fsm) change(fsm) end
      return select(2, record.replay(model, sink))
    end
    assert.equal("step 3: root.count: 1 expected, got 7",
      problem(function(fsm) fsm.count = 7 end))
    assert.equal("step 3: root.count: 1 expected, got 'x'",
      problem(function(fsm) fsm.count = "x" end))
    assert.equal("step 3: root.count: 1 expected, got a table",
      problem(function(fsm) fsm.count = {} end))
    assert.equal("step 3: root.count: 1 expected, got nothing",
      problem(function(fsm) fsm.count = nil end))
    sink[4].kept.data.root.list = { { x = "y" } }
    assert.equal("step 3: root.list: a table expected, got nothing",
      problem(function() end))
  end)

  it("needs a file that can be opened", function()
    local fsm = helper.init(worker({}, yes))
    assert.equal("rfsm.record.record: /nowhere/x: No such file or directory",
      helper.refusal(record.record, fsm, "/nowhere/x"))
    rfsm.run(fsm)
  end)

  it("in a file has a line for each record; one that was cut does not count", function()
    local file, sink = helper.file_with(""), {}
    recorded(file)
    recorded(sink)
    local text = helper.content(file)
    assert.equal(10, select(2, text:gsub("\n", "")))
    assert.matches('^{.*"guards":%[.-%],"record":1,"snapshot":', text)
    assert.same(json.decode(json.encode(sink)), (record.read(file)))
    local cut = helper.file_with(text:sub(1, -3))
    assert.same({ runs = 1, is_cut = true, has_end = false },
      select(2, record.read(cut)))
    assert.equal(9, #record.read(cut))
    assert.equal("root.idle", rfsm.get_actleaf_fqn(assert(
      record.replay(worker({}, yes), cut, { dry = true }))))
    local broken = helper.file_with((text:gsub("\n{", "\n?", 1)))
    assert.matches(": line 2: the check sum is wrong: the text has changed since it "
      .. "was written$", select(2, pcall(record.read, broken)))
    text = without_sums(text)
    broken = helper.file_with((text:gsub("\n{", "\n?", 1)))
    assert.matches(": no JSON: .* at line 2$", select(2, pcall(record.read, broken)))
  end)

  it("in a file has an end, and no line may be missing", function()
    local file = helper.file_with("")
    recorded(file):stop()
    assert.is_true(select(2, record.read(file)).has_end)
    local lines = {}
    for line in helper.content(file):gmatch("[^\n]+") do lines[#lines + 1] = line end
    assert.equal(11, #lines)
    for gone = 2, 10 do
      local line = table.remove(lines, gone)
      local ok, problem = pcall(record.read,
        helper.file_with(table.concat(lines, "\n") .. "\n"))
      assert.is_false(ok)
      assert.matches(("record %d is missing: record %d comes in its place$"):format(
        gone - 1, gone), problem)
      table.insert(lines, gone, line)
    end
    lines[11] = nil
    local about = select(2, record.read(helper.file_with(table.concat(lines, "\n"))))
    assert.same({ runs = 1, is_cut = false, has_end = false }, about)
  end)

  it("in a file is replayed line by line, up to a damaged line", function()
    local file = helper.file_with("")
    recorded(file):stop()
    local text, model = helper.content(file), worker({}, error)
    local fsm = assert(record.replay(model, file, { dry = true }))
    assert.same({ "root.idle", 2 }, { rfsm.get_actleaf_fqn(fsm), fsm.count })
    helper.write(file, (text:gsub('"n":6', '"n":7')))
    assert.same({ false, "rfsm.record: " .. file .. ": line 7: the check sum is wrong: "
      .. "the text has changed since it was written", 5 },
      { record.replay(model, file, { dry = true }) })
    assert.is_truthy((record.replay(model, file, { dry = true, to = 4 })))
    local header, next_record = record.open(file)
    assert.same((record.read(helper.file_with(text)))[1], header)
    for _ = 1, 5 do assert.is_table(next_record()) end
    assert.matches("line 7", select(2, pcall(next_record)))
  end)

  it("in a file tells each bit that is wrong", function()
    local file = helper.file_with("")
    recorded(file):stop()
    local text, taken = helper.content(file), 0
    local whole = record.read(file)
    for at = 1, #text, 3 do
      local byte, bit = text:byte(at), 2 ^ (at % 8)
      byte = byte + (byte % (2 * bit) < bit and bit or -bit)
      helper.write(file, text:sub(1, at - 1) .. string.char(byte) .. text:sub(at + 1))
      local ok, found, about = pcall(record.read, file)
      if ok and not about.is_cut and about.has_end then
        taken = taken + 1
        assert.same(whole, found)
      end
    end
    assert.is_true(taken <= 4) -- of a newline, into white space
  end)

  it("of an event and its completion takes 110 bytes in a file", function()
    local file = helper.file_with("")
    local fsm = helper.init(state { info = false, warn = false, off = state {},
      on = state {}, trans { src = "initial", tgt = "off" },
      trans { src = "off", tgt = "on", events = { "e_push" } },
      trans { src = "on", tgt = "off", events = { "e_push" } } })
    rfsm.run(fsm)
    local recorder = record.record(fsm, file)
    local before = #helper.content(file)
    for _ = 1, 10 do helper.post_and_run(fsm, "e_push") end
    for _ = 1, 1000 do rfsm.run(fsm) end -- nothing comes
    recorder:stop()
    assert.is_true(#helper.content(file) - before <= 1100)
    assert.equal(20, recorder.count)
  end)

  it("in a file has its fields in a fixed order", function()
    assert.equal('{"clock":[[7,1]],"done":true,"events":["a"],"from":7,"guards":[2,'
      .. 'true],"kept":{"data":{"root":{"n":0.5}}},"leaf":"x","reset":true,"sent":{}}',
      journal.encode { from = 7, events = { "a" }, clock = { { 7, 1 } },
        guards = { 2, true }, reset = true, sent = {}, leaf = "x", done = true,
        kept = { data = { root = { n = 0.5 } } } })
  end)

  it("in a file costs at most 500 VM instructions to encode in the usual case",
    function()
      if rawget(_G, "jit") then return end -- compiled code calls no hook
      local usual = { done = true, events = { "e_done@root.off", "e_push" },
        leaf = "root.on", n = 7 }
      local count = 0
      debug.sethook(function() count = count + 1 end, "", 1)
      journal.encode(usual)
      debug.sethook()
      assert.is_true(count <= 500, count .. " instructions")
    end)

  it("in a file has what regions did in an iteration", function()
    local function model()
      return state { emem = false, info = false, warn = false, err = false,
        p = rfsm.seqand { r = helper.chart { "e_x" } },
        trans { src = "initial", tgt = "p" } }
    end
    local sink, file, fsm = {}, helper.file_with(""), helper.init(model())
    local one, other = record.record(fsm, sink), record.record(fsm, file)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_x")
    other:stop()
    one:stop()
    local count = 0
    for i = 2, #sink do count = count + #(sink[i].inner or {}) end
    assert.is_true(count > 1)
    assert.same({ unpack(sink, 2) }, { unpack((record.read(file)), 2) })
    assert(record.replay(model(), file))
  end)

  it("in a file has short lines", function()
    local texts = {}
    local write = journal.writer { write = function(_, text, stop)
      texts[#texts + 1] = text .. (stop == "\n" and "" or "?")
    end }
    for _, rec in ipairs {
      { events = { "e_\"a" }, leaf = "root.a" },
      { events = { true, false }, leaf = "root.a", sent = { "e_b" } },
      { events = { "e_b" }, leaf = "root.b", done = true, sent = { "e_done@root.b" } },
      { events = { "e_done@root.b" }, leaf = "root.b", done = true },
      { leaf = "root.b", done = true },
      { events = { "x" }, done = true },
      { m = 1, leaf = "root.r" }, { m = 1, leaf = "root.r" },
      { events = { 7 }, leaf = "root.a" },
    } do
      write(rec)
    end
    for i, line in ipairs(texts) do texts[i] = without_sums(line) end
    assert.same({ '{"events":["e_\\"a"],"leaf":"root.a","n":1}',
      '{"events":[true,false],"n":2,"sent":["e_b"]}',
      '{"done":true,"leaf":"root.b","n":3}', '{"n":4}', '{"n":5}',
      '{"done":true,"events":["x"],"leaf":false,"n":6}',
      '{"leaf":"root.r","m":1,"n":7}', '{"m":1,"n":8}',
      '{"events":[7],"leaf":"root.a","n":9}' }, texts)
  end)

  it("is handed to a function, or written to a stream that stays open", function()
    local list, file = {}, helper.file_with("")
    recorded(function(rec) list[#list + 1] = rec end)
    local sink = {}
    recorded(sink)
    assert.same(sink, list)
    local stream = assert(io.open(file, "w"))
    local recorder = recorded(stream)
    assert.equal(10, select(2, helper.content(file):gsub("\n", ""))) -- flushed
    recorder:stop()
    assert.equal("file", io.type(stream))
    stream:close()
    recorder = recorded(file)
    local own = recorder.file
    recorder:stop()
    assert.equal("closed file", io.type(own))
    recorder:stop() -- again does no harm
    local lines = {}
    recorded { write = function(_, line) lines[#lines + 1] = line end }
    local run = table.concat(lines, "\n") .. "\n"
    run = without_sums(run) .. '{"end":9}\n'
    assert.equal(run .. run, without_sums(helper.content(file)))
  end)

  it("is replayed by a chart only, whose caller is blamed", function()
    assert.equal("rfsm.record.replay: state expected, got number",
      helper.refusal(record.replay, 7, {}))
  end)

  it("has what save returns whenever that has changed", function()
    local sink, secret = {}, 1
    local fsm = helper.init(helper.chart({ "e_b" }, { emem = false,
      save = function() return secret end, load = function() end }))
    record.record(fsm, sink)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_none")
    secret = 2
    helper.post_and_run(fsm, "e_b")
    local saved = {}
    for _, rec in ipairs(sink) do
      saved[#saved + 1] = (rec.had or rec.kept or { saved = {} }).saved.root
    end
    assert.same({ 2 }, saved)
    assert.equal(1, sink[1].snapshot.saved.root)
  end)

  it("has a kept table whenever something in it has changed", function()
    local sink = {}
    local fsm = helper.init(helper.chart({ "e_b" }, { emem = false, keep = { "list" },
      list = { 1 } }))
    record.record(fsm, sink)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_none")
    fsm.list[2] = "more"
    helper.post_and_run(fsm, "e_none")
    assert.same({ nil, { 1, "more" } }, { (sink[#sink - 1].had or {}).data,
      sink[#sink].had.data.root.list })
  end)

  it("is refused if a line of its file is no record, or the chart is wrong", function()
    local file = helper.file_with("")
    recorded(file):stop()
    local whole = helper.content(file)
    for changed, problem in pairs {
      [whole .. "7\n"] = ": line 12: header expected",
      [without_sums(whole):gsub('{"end":9}', "7") .. ""] =
        ": record 11: table expected, got number",
      [without_sums(whole, 4)] = ": line 4: a check sum expected",
      [whole:gsub('"sum":"%x+"', '"sum":"24d8d4ec"', 1) .. ""] =
        ": line 1: the check sum is wrong",
    } do
      helper.write(file, changed)
      assert.matches(problem, tostring(select(2, pcall(record.read, file))), 1, true)
    end
    local sink = {}
    recorded(sink)
    assert.same({ false, "rfsm.init: the model has 1 problem" },
      { (function(fsm, text) return fsm, text:match("^[^\n]*") end)(record.replay(
        state { err = false, entry = 7 }, sink)) })
  end)

  it("shows a callback that leaves targets as they are", function()
    local function model(retarget)
      return helper.chart({ "e_b" }, { emem = false, entry = retarget })
    end
    local fsm = helper.init(model(function(machine) machine[2].tgt = machine.a end))
    local changed = {}
    record.record(fsm, changed)
    rfsm.run(fsm)
    local _, problem = record.replay(model(), changed)
    assert.equal("step 1: the targets of transitions are not as they were", problem)
  end)

  it("holds targets that have changed, and whether that was in a step", function()
    local sink = {}
    local function model()
      return state { info = false, warn = false, a = state { entry = function(fsm)
        fsm[3].tgt = fsm.c
      end }, b = state {}, c = state {}, trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_b" } },
        trans { src = "b", tgt = "a", events = { "e_back" } } }
    end
    local fsm = helper.init(model())
    record.record(fsm, sink)
    rfsm.run(fsm)
    assert.same({ "root.a", "root.a", "root.c" },
      { sink[2].leaf, sink[3].leaf, sink[2].kept.targets[#sink[2].kept.targets] })
    assert.is_nil(sink[3].kept)
    fsm[3].tgt = fsm.a
    helper.post_and_run(fsm, "e_b")
    assert.same({ "root.b", true, nil },
      { sink[4].leaf, sink[4].had ~= nil, sink[4].kept })
    helper.post_and_run(fsm, "e_back")
    assert.same({ "root.a", true },
      { sink[6].leaf, sink[6].kept.targets ~= nil })
    local again = assert(record.replay(model(), sink, { dry = true }))
    assert.equal(again.c, again[3].tgt)
    assert(record.replay(model(), sink))
  end)

  it("holds what guards have returned, and their failures", function()
    local answers, sink, said = { "yes", false, "fail" }, {}, {}
    local function guard()
      local answer = table.remove(answers, 1)
      if answer == "fail" then error("no sensor", 0) end
      return answer
    end
    local fsm = helper.init(worker({}, guard))
    record.record(fsm, sink)
    rfsm.run(fsm)
    for _ = 1, 3 do helper.post_and_run(fsm, "e_go") end
    local noted = {}
    for i = 2, #sink do
      if sink[i].guards then noted[#noted + 1] = sink[i].guards[2] end
    end
    assert.same({ true, false, "no sensor" }, noted)
    local again = worker({}, error)
    again.err = function(...) said[#said + 1] = table.concat({ ... }, " ") end
    assert(record.replay(again, sink))
    assert.equal(1, #said)
    assert.matches("no sensor$", said[1])
  end)

  it("says nothing when it is replayed dry, whatever the model's printers", function()
    local sink, said = {}, 0
    recorded(sink)
    local model = worker({}, error)
    for _, name in ipairs { "dbg", "info", "warn", "err" } do
      model[name] = function() said = said + 1 end
    end
    helper.init(model)
    local before = said
    assert(record.replay(model, sink, { dry = true, to = 3 }))
    assert.is_true(said <= 2 * before, said) -- of the machine that is returned
  end)

  it("in the same file is a run more; a line that was cut harms no other", function()
    local file = helper.file_with("")
    recorded(file)
    local whole, text = record.read(file), helper.content(file)
    helper.write(file, text:sub(1, -3))
    recorded(file)
    recorded(file)
    assert.same({ 9, { runs = 3, is_cut = true, has_end = false } },
      { #record.read(file, 1), select(2, record.read(file, 1)) })
    for _, number in ipairs { 2, 3 } do
      assert.same(whole, (record.read(file, number)))
    end
    assert.same({ whole, { runs = 3, is_cut = false, has_end = false } },
      { record.read(file) })
    for _, number in ipairs { 0, 4, 1.5, "x" } do
      assert.equal("rfsm.record: " .. file .. ": run: number from 1 to 3 expected, got "
        .. tostring(number), select(2, pcall(record.read, file, number)))
    end
    assert.matches("No such file", select(2, pcall(record.read, "nothing.jsonl")))
    assert.equal("rfsm.record: " .. file .. ": no recording",
      select(2, pcall(record.read, (helper.write(file, "\n")))))
    assert.matches("line 1: header expected",
      select(2, pcall(record.read, (helper.write(file, "{}\n")))))
  end)

  it("becomes a spec that passes, as long as the chart does that", function()
    local chart = helper.file_with([[
      return rfsm.state { info = false, warn = false, a = rfsm.state {},
        b = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = "e_\n" } }]])
    local sink = {}
    local fsm = helper.init(rfsm.load(chart))
    record.record(fsm, sink)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_\n")
    local function output_of(text)
      local name = helper.file_with(text)
      return helper.text_of("f=" .. name .. "; mv $f $f.lua; "
        .. "busted -o TAP $f.lua 2>&1; rm $f.lua")
    end
    local text = record.to_spec(sink)
    assert.matches("ok 1 %- .* takes the steps that were recorded", output_of(text))
    assert.is_truthy(text:find(("local FILE = %q"):format(chart), 1, true))
    assert.is_truthy(text:find("{ dry = false }", 1, true))
    assert.is_truthy(text:find("decode_all [=[\n", 1, true))
    text = record.to_spec(sink, { chart = "other.lua", dry = true })
    assert.is_truthy(text:find('local FILE = "other.lua"', 1, true))
    assert.is_truthy(text:find("{ dry = true }", 1, true))
    helper.post_and_run(fsm, "]]", "x]=]")
    text = record.to_spec(sink)
    assert.is_truthy(text:find("decode_all [==[\n", 1, true))
    assert.matches("ok 1 ", output_of(text))
    sink[1].file = nil
    assert.equal("rfsm.record.to_spec: the file of the chart expected",
      helper.refusal(record.to_spec, sink))
    assert.error_matches(function() record.to_spec({}) end,
      "rfsm.record: a recording of format 1 expected")
    assert.matches("FILE", record.to_spec(sink, { chart = "x" }))
    assert.matches("not ok 1", output_of((text:gsub('"leaf":"root.b"', '"leaf":"x"'))))
  end)
end)

describe("the clock", function()
  local function timed(gettime)
    return state { info = false, warn = false, gettime = gettime, a = state {},
      b = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_after(5)" } } }
  end

  -- Returns what the process's clock was asked for while f() ran.
  local function readings_of_process(f)
    local count = 0
    timeevent.set_gettime_hook(function()
      count = count + 1
      return 0, 0
    end)
    count = 0
    f()
    timeevent.set_gettime_hook(nil)
    return count
  end

  it("is the machine's own: that of the process is not read or replaced", function()
    local now, sink, fsm = 10, {}, nil
    local function own() return now, 0 end
    assert.equal(0, readings_of_process(function()
      fsm = helper.init(timed(own))
      local recorder = record.record(fsm, sink)
      rfsm.step(fsm)
      now = 15.5
      rfsm.run(fsm)
      assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
      recorder:stop()
    end))
    assert.equal(own, rawget(fsm, "gettime"))
    local again = assert(record.replay(timed(nil), sink))
    assert.same({ "root.b", nil },
      { rfsm.get_actleaf_fqn(again), rawget(again, "gettime") })
  end)

  it("of a replayed machine is its own: timers have the time that was left", function()
    local now, sink = 10, {}
    local fsm = helper.init(timed(function() return now, 0 end))
    record.record(fsm, sink)
    rfsm.step(fsm)
    now = 12
    rfsm.run(fsm)
    now = 1000
    local again = assert(record.replay(timed(function() return now, 0 end), sink))
    now = 1002.9
    assert.equal("root.a", helper.leaf_after(again))
    now = 1003.1
    assert.equal("root.b", helper.leaf_after(again))
  end)

  it("that was not read leaves the machine as it is", function()
    local loads, sink = 0, {}
    local function model()
      return state { info = false, warn = false, a = state {},
        trans { src = "initial", tgt = "a" }, save = function() return 1 end,
        load = function() loads = loads + 1 end }
    end
    local fsm = helper.init(model())
    record.record(fsm, sink)
    rfsm.run(fsm)
    loads = 0
    assert(record.replay(model(), sink))
    assert.equal(1, loads) -- of the snapshot at the beginning
  end)

  it("may be set while the machine is recorded", function()
    local sink, fsm = {}, helper.init(timed(function() return 10, 0 end))
    local recorder = record.record(fsm, sink)
    rfsm.step(fsm)
    local function later() return 16, 0 end
    fsm.gettime = later
    rfsm.run(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    recorder:stop()
    assert.equal(later, rawget(fsm, "gettime"))
    assert.equal("root.b", rfsm.get_actleaf_fqn(assert(record.replay(timed(), sink))))
  end)

  it("is not recorded when a host reads it between two iterations", function()
    local now, sink = 10, {}
    local fsm = helper.init(timed(function() return now, 0 end))
    record.record(fsm, sink)
    rfsm.step(fsm)
    for _ = 1, 3 do timeevent.next_deadline(fsm) end
    assert.equal(1, #sink[2].clock)
    now = 15.5
    rfsm.run(fsm)
    timeevent.next_deadline(fsm)
    assert.equal("root.b",
      rfsm.get_actleaf_fqn(assert(record.replay(timed(), sink))))
  end)

  it("is read ahead of each record if one event is taken at a time", function()
    local now, sink = 10, {}
    local function model(gettime)
      local one = timed(gettime)
      one.read = "one"
      return one
    end
    local fsm = helper.init(model(function() return now, 0 end))
    record.record(fsm, sink)
    rfsm.step(fsm)
    now = 15.5
    rfsm.run(fsm)
    assert.same({ { { 15.5, 0 } }, { "e_after(5)@root.a" } },
      { sink[3].clock, sink[4].events })
    assert(record.replay(model(), sink))
    assert(record.replay(model(), sink, { dry = true }))
  end)

  it("that fails fails again", function()
    local model, sink, texts = timed(function() error("no battery", 0) end), {}, {}
    model.err = function(...) texts[#texts + 1] = table.concat({ ... }, " ") end
    local fsm = helper.init(model)
    record.record(fsm, sink)
    rfsm.step(fsm)
    local before = #texts
    assert.is_true(before > 0)
    model.gettime = nil
    assert(record.replay(model, sink))
    assert.equal(texts[before], texts[#texts])
    assert.is_true(#texts > before)
  end)

  it("of a region that has its own is the recording's, too", function()
    local now = 0
    local function model(gettime)
      return state { info = false, warn = false, gettime = gettime and gettime(1),
        both = rfsm.seqand { fast = rfsm.init(timed(gettime and gettime(2))),
          slow = rfsm.init(timed()) },
        trans { src = "initial", tgt = "both" } }
    end
    local chart = model(function(rate) return function() return now * rate, 0 end end)
    local fsm, sink = helper.init(chart), {}
    record.record(fsm, sink)
    rfsm.run(fsm)
    now = 3 -- 6 s of the fast one
    rfsm.run(fsm)
    local function places(machine)
      local texts = {}
      for _, at in ipairs(rfsm.machines(machine)) do
        texts[#texts + 1] = at.prefix .. "=" .. rfsm.get_actleaf_fqn(at.machine)
      end
      return texts
    end
    local expected = { "root=root.both", "root.both.fast=root.b",
      "root.both.slow=root.a" }
    assert.same(expected, places(fsm))
    local again, problem = record.replay(model(), sink)
    assert.is_nil(problem)
    assert.same(expected, places(again))
  end)
end)

-- a --e_go--> b --e_back--> a, and fields of the root.
local function chart(fields)
  local model = helper.chart({ "e_go" }, { emem = false, checkevents = false })
  for key, value in pairs(fields or {}) do model[key] = value end -- any order: a set
  return model
end

describe("the events of getevents", function()
  local function polled(answers)
    return chart { getevents = function() return table.remove(answers, 1) end }
  end

  it("are those from outside, unlike what the machine has sent", function()
    local sink, fsm = {}, helper.init(polled { {}, { "e_x", "e_go" }, { "e_y" } })
    local recorder = record.record(fsm, sink)
    rfsm.run(fsm)
    rfsm.run(fsm)
    assert.same({ "e_done@root.a", "e_x", "e_go" }, sink[3].events)
    assert.same({ "e_done@root.a" }, sink[2].sent)
    assert.same({ "e_done@root.b" }, sink[3].sent)
    assert.same({ "e_done@root.b", "e_y" }, sink[4].events)
    recorder:stop()
    local again = assert(record.replay(polled {}, sink))
    assert.equal("root.b", rfsm.get_actleaf_fqn(again))
  end)

  it("may be none at all", function()
    local sink = {}
    record.record(helper.started(polled {}), sink)
    local fsm = helper.init(polled { nil })
    record.record(fsm, sink)
    rfsm.run(fsm)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("data that changes between iterations", function()
  it("makes a record of one in which nothing else happens", function()
    local sink, model = {}, chart { keep = { "count" }, count = 1 }
    local fsm = helper.init(model)
    local recorder = record.record(fsm, sink)
    rfsm.run(fsm)
    local count = recorder.count
    rfsm.step(fsm)
    assert.equal(count, recorder.count)
    fsm.count = 2
    rfsm.step(fsm)
    assert.equal(count + 1, recorder.count)
    local last = sink[#sink]
    assert.same({ 2, nil, nil, "root.a", true },
      { last.had.data.root.count, last.events, last.kept, last.leaf, last.done })
    assert.equal(2, assert(record.replay(model, sink, { dry = true })).count)
  end)

  it("makes one, too, if a hook changes them in an iteration without events", function()
    local sink = {}
    local fsm = helper.init(chart { keep = { "count" }, count = 1 })
    local recorder = record.record(fsm, sink)
    rfsm.run(fsm)
    local count = recorder.count
    rfsm.pre_step_hook_add(fsm, function() fsm.count = fsm.count + 1 end)
    rfsm.step(fsm)
    assert.equal(count + 1, recorder.count)
    assert.equal(2, sink[#sink].kept.data.root.count)
  end)

  it("of a region that is left is in the record of the parent machine", function()
    local function region(n, exit)
      return helper.init(state { info = false, warn = false, emem = false,
        keep = { "count" }, count = n, x = state { exit = exit },
        trans { src = "initial", tgt = "x" } })
    end
    local function model()
      return chart { a = rfsm.seqand { l = region(1),
        r = region(5, function(fsm) fsm.count = fsm.count + 1 end) } }
    end
    local sink, fsm = {}, helper.init(model())
    record.record(fsm, sink)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_go")
    local found = {}
    for i = 2, #sink do
      local regions = sink[i].regions or {}
      if regions[1] then
        found[#found + 1] = { regions[1], regions[2].data.root.count }
      end
    end
    assert.same({ { 2, 6 } }, found)
    local regions = assert(record.replay(model(), sink, { dry = true })).a.substates
    assert.same({ 1, 6 }, { regions.l.count, regions.r.count })
  end)

  it("is named if it differs, also that of a function `save`", function()
    local function saver(n)
      local value = 0
      return chart { b = state { entry = function() value = value + n end,
        save = function() return { value = value } end,
        load = function(_, _, data) value = data.value end } }
    end
    local sink, fsm = {}, helper.init(saver(1))
    record.record(fsm, sink)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_go")
    assert(record.replay(saver(1), sink))
    assert.same({ false, "step 3: save of root.b.value: 1 expected, got 2", 2 },
      { record.replay(saver(2), sink) })
  end)
end)

describe("a doo in a dry replay", function()
  -- Returns what follows when the doo of a ends, or fails, in its third cycle.
  local function replayed(ending)
    local function model(doo)
      return chart { err = false, a = state { doo = doo } }
    end
    local sink, fsm = {}, helper.init(model(function()
      rfsm.yield()
      rfsm.yield(true)
      ending()
    end))
    record.record(fsm, sink)
    for _ = 1, 4 do rfsm.step(fsm) end
    local again = assert(record.replay(model(error), sink, { dry = true }))
    assert.same(snapshot.take(fsm), snapshot.take(again))
    return again._act_leaf._mode, again._intq
  end

  it("ends when it did, and fails when it did", function()
    assert.same({ "done", { "e_done@root.a" } }, { replayed(function() end) })
    assert.same({ "done", {} }, { replayed(error) })
  end)

  it("of a region that is run goes on for as many cycles as it did", function()
    local function model(doo)
      return state { info = false, warn = false, p = rfsm.seqand { run = true,
          r = chart { a = state { doo = doo }, [3] = trans { src = "a", tgt = "b",
            events = { "e_done" } } } },
        trans { src = "initial", tgt = "p" } }
    end
    local sink, fsm = {}, helper.init(model(function()
      for _ = 1, 3 do rfsm.yield(false) end
    end))
    record.record(fsm, sink)
    rfsm.step(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(rfsm.machines(fsm)[2].machine))
    local again = assert(record.replay(model(error), sink, { dry = true }))
    assert.same(snapshot.take(fsm), snapshot.take(again))
  end)
end)

describe("a guard in a replay", function()
  it("that was not called is named, and is not enabled", function()
    local sink, fsm = {}, helper.init(chart())
    record.record(fsm, sink)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_go")
    local model = chart()
    model[2].guard = error
    assert.same({ false, "step 3: the guard of T={ src='root.a', tgt='root.b', "
      .. "events='e_go' } was not called then", 2 },
      { record.replay(model, sink, { migrate = true }) })
  end)

  it("is found by its text among others that have changed places", function()
    local function model(is_swapped)
      local first = trans { src = "a", tgt = "b", events = { "e_1" }, guard = yes }
      local second = trans { src = "a", tgt = "c", events = { "e_2" }, guard = yes }
      local fields = { c = state {} }
      fields[is_swapped and 5 or 4], fields[is_swapped and 4 or 5] = first, second
      return chart(fields)
    end
    local sink, fsm = {}, helper.init(model())
    record.record(fsm, sink)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_2")
    local again = assert(record.replay(model(true), sink, { migrate = true,
      guards = true }))
    assert.equal("root.c", rfsm.get_actleaf_fqn(again))
  end)
end)

describe("targets that a history has set", function()
  -- Further states and transitions stand in front of the others, or behind them.
  local function model(at)
    local list = { info = false, warn = false, idle = state {}, more = state {},
      a = state { history = "deep", x = state {}, y = state {},
        trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "y", events = { "e_y" } } },
      trans { src = "initial", tgt = "idle" },
      trans { src = "idle", tgt = "a", events = { "e_a" } },
      trans { src = "a", tgt = "idle", events = { "e_idle" } } }
    if at then
      table.insert(list, at, trans { src = "idle", tgt = "more", events = { "e_m" } })
    end
    return state(list)
  end

  local sink = {}
  local fsm = helper.started(model())
  record.record(fsm, sink)
  for _, event in ipairs { "e_a", "e_y", "e_idle" } do
    helper.post_and_run(fsm, event)
  end

  for _, dry in ipairs { false, true } do
    local options = { migrate = true, dry = dry }

    it("are set again if they have their numbers, dry: " .. tostring(dry), function()
      local again = assert(record.replay(model(4), sink, options))
      helper.post_and_run(again, "e_a")
      assert.equal("root.a.y", rfsm.get_actleaf_fqn(again))
    end)

    it("are not given to others, dry: " .. tostring(dry), function()
      assert.same({ false, "step 1: the targets of transitions are not as they were",
        0 }, { record.replay(model(2), sink, options) })
    end)
  end
end)

describe("two guards in an iteration", function()
  it("have each their own result again", function()
    local function model(first, second)
      return chart { c = state {},
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_go" }, guard = first, pn = 1 },
        trans { src = "a", tgt = "c", events = { "e_go" }, guard = second } }
    end
    local sink, fsm = {}, helper.init(model(function() return false end, yes))
    record.record(fsm, sink)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_go")
    local again = assert(record.replay(model(error, error), sink))
    assert.equal("root.c", rfsm.get_actleaf_fqn(again))
  end)
end)

describe("a transition that needs no event", function()
  -- a --always--> b --e_back--> a: taken if the sensor says so
  local function model(sensor, trace)
    return state { info = false, warn = false, read = "one", keep = { "n" }, n = 0,
      a = state {}, b = state { entry = function(fsm) fsm.n = fsm.n + 1 end },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", always = true, guard = sensor,
        effect = function() if trace then trace[#trace + 1] = "effect" end end },
      trans { src = "b", tgt = "a", events = { "e_back" } } }
  end

  local function recorded_run()
    local is_seen, sink = false, {}
    local fsm = helper.started(model(function() return is_seen end))
    local recorder = record.record(fsm, sink)
    for _ = 1, 100 do rfsm.run(fsm) end
    assert.equal(0, recorder.count) -- a guard was asked, and nothing happened
    is_seen = true
    rfsm.send_events(fsm, "e_x", "e_back")
    rfsm.run(fsm)
    assert.same({ "root.b", 2 }, { rfsm.get_actleaf_fqn(fsm), fsm.n })
    return sink
  end

  it("has a record, with what its guard said and what waits", function()
    local sink = recorded_run()
    assert.same({ always = true, guards = { 2, true }, waiting = { 0, "e_x", "e_back" },
      sent = { "e_done@root.b" }, leaf = "root.b", done = true,
      kept = { data = { root = { "%t", "n", 1 } } } }, sink[2])
    assert.same({ "e_x" }, sink[3].events)
    assert.is_nil(sink[3].waiting)
  end)

  it("is taken in a replay where it was taken then, also without callbacks", function()
    local sink, trace = recorded_run(), {}
    local again = assert(record.replay(model(error, trace), sink))
    assert.same({ "root.b", 2 }, { rfsm.get_actleaf_fqn(again), again.n })
    assert.same({ "effect", "effect" }, trace)
    again = assert(record.replay(model(error), sink, { dry = true }))
    assert.same({ "root.b", 2 }, { rfsm.get_actleaf_fqn(again), again.n })
  end)

  it("is not taken behind the end of a replay, though it has no guard", function()
    local sink = {}
    local fsm = helper.init(model())
    record.record(fsm, sink)
    rfsm.run(fsm)
    local again = assert(record.replay(model(), sink, { to = 1 }))
    assert.equal("root.a", rfsm.get_actleaf_fqn(again))
    assert.equal("root.b", rfsm.get_actleaf_fqn(assert(record.replay(model(), sink))))
  end)

  it("is named if a changed chart takes it where it was not taken", function()
    local changed, sink = model(), recorded_run()
    changed[2].always, changed[2].events = nil, { "e_x" }
    assert.same({ false, "step 1: a transition that needs no event expected, none was "
      .. "taken", 0 }, { record.replay(changed, sink, { migrate = true }) })
  end)
end)

describe("a queue in a replay", function()
  local function model(trace)
    return state { info = false, warn = false, err = false, read = "one",
      a = state {}, b = state { entry = function() error("no bulb", 0) end },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_b" } },
      trans { src = "b", tgt = "b", events = { "e_b" } },
      trans { src = "b", tgt = "a", events = { "e_fault" },
        effect = function() trace[#trace + 1] = "fault" end } }
  end

  it("has what waited then: a fault that waits is not made again", function()
    local sink, before, after = {}, {}, {}
    local fsm = helper.started(model(before))
    record.record(fsm, sink)
    helper.post_and_run(fsm, "e_b", "e_b", "e_b")
    assert(record.replay(model(after), sink))
    assert.same(before, after)
    assert.is_nil(sink[3].waiting) -- what waits is noted once
  end)

  it("is at its end as the run left it, also without callbacks", function()
    local sink = {}
    local fsm = helper.started(model {})
    record.record(fsm, sink)
    rfsm.send_events(fsm, "e_b", "e_1", { name = "e_2", n = 3 })
    rfsm.step(fsm)
    for _, is_dry in ipairs { true, false } do
      local again = assert(record.replay(model {}, sink, { dry = is_dry }))
      local texts = {}
      for i, event in ipairs(again._intq) do texts[i] = rfsm.event_text(event) end
      assert.same({ "e_1", "e_2", "e_fault@root.b", "e_done@root.b" }, texts)
      assert.equal(3, again._intq[2].n)
    end
  end)

  it("keeps a region going that reads one event at a time", function()
    local function parts()
      local region = state { read = "one", a = state {}, b = state {},
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_3" } } }
      return state { info = false, warn = false, trans { src = "initial", tgt = "s" },
        s = rfsm.seqand { x = region, run = true } }
    end
    local sink, fsm = {}, helper.started(parts())
    record.record(fsm, sink)
    helper.post_and_run(fsm, "e_1", "e_2", "e_3")
    for _, is_dry in ipairs { true, false } do
      local again = assert(record.replay(parts(), sink, { dry = is_dry }))
      assert.equal("root.b", rfsm.get_actleaf_fqn(rfsm.machines(again)[2].machine))
    end
  end)

  it("departs only when an event is read that cannot be replayed", function()
    local sink, fsm = {}, helper.started(model {})
    record.record(fsm, sink)
    helper.post_and_run(fsm, "e_1", setmetatable({}, {}))
    assert.same({ false, "step 2: an event that is a table cannot be replayed", 1 },
      { record.replay(model {}, sink) })
  end)
end)

describe("an event with data", function()
  it("may have a table in two places", function()
    local function model(seen)
      return state { info = false, warn = false, a = state {},
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "internal", events = { rfsm.named "e_two" },
          effect = function(_, _, _, _, event)
            seen[#seen + 1] = event.left.x + event.right.x
          end } }
    end
    local sink, seen, place = {}, {}, { x = 2 }
    local fsm = helper.started(model(seen))
    record.record(fsm, sink)
    helper.post_and_run(fsm, { name = "e_two", left = place, right = place })
    assert(record.replay(model(seen), sink))
    assert.same({ 4, 4 }, seen)
  end)
end)

it("a folder is no recording, and the message says so", function()
  assert.same({ false, "rfsm.record: /: Is a directory" }, { pcall(record.read, "/") })
end)

describe("a fault", function()
  for _, make in ipairs { function() return "no bulb" end,
    function() return { code = 3 } end,
    function() return setmetatable({}, { __name = "Coin" }) end } do
    it("is the same one in a replay, whose traceback has other lines: "
      .. rfsm.event_text(make(), true), function()
      local function model()
        return state { info = false, warn = false, err = false, a = state {},
          b = state { entry = function() error(make(), 0) end }, c = state {},
          trans { src = "initial", tgt = "a" },
          trans { src = "a", tgt = "b", events = { "e_b" } },
          trans { src = "b", tgt = "c", events = { "e_fault" } } }
      end
      local sink, fsm = {}, helper.started(model())
      record.record(fsm, sink)
      helper.post_and_run(fsm, "e_b")
      rfsm.run(fsm)
      assert.equal("root.c", rfsm.get_actleaf_fqn(fsm))
      assert.equal("root.c", rfsm.get_actleaf_fqn(assert(record.replay(model(), sink))))
    end)
  end
end)

describe("a recording that begins with a timer armed", function()
  it("has the readings of the clock for its first snapshot", function()
    local now = 10
    local function timed()
      return chart { [2] = trans { src = "a", tgt = "b", events = { "e_after(5)" } } }
    end
    timeevent.set_gettime_hook(function() return now, 0 end)
    finally(function() timeevent.set_gettime_hook(nil) end)
    local sink, fsm = {}, helper.started(timed())
    now = 12
    local recorder = record.record(fsm, sink)
    now = 16
    rfsm.run(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    assert.same({ { 12, 0 } }, sink[1].clock)
    recorder:stop()
    now = 500
    local again = assert(record.replay(timed(), sink))
    assert.equal("root.b", rfsm.get_actleaf_fqn(again))
  end)
end)

describe("a clock that fails", function()
  it("stops no machine whose recorder needs its place", function()
    local sink, is_broken = {}, false
    local fsm = helper.started(chart { err = false,
      [2] = trans { src = "a", tgt = "b", events = { "e_after(5)" } },
      [3] = trans { src = "a", tgt = "b", events = { "e_b" } },
      gettime = function()
        if is_broken then error("battery empty", 0) end
        return 10, 0
      end })
    local recorder = record.record(fsm, sink)
    recorder:pause()
    recorder:go_on()
    is_broken = true
    helper.post_and_run(fsm, "e_b")
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("an interrupt while it is recorded", function()
  -- Returns the error of a step in which `f` of the model raises what Control-C raises.
  local function interrupted(name, f)
    local model, sink, is_due = worker({}, yes), {}, false
    local function raise()
      if is_due then error("interrupted!", 0) end
    end
    f(model, raise)
    local fsm = helper.init(model)
    local recorder = record.record(fsm, sink)
    rfsm.run(fsm)
    is_due = true
    local ok, failure = pcall(helper.post_and_run, fsm, "e_go")
    is_due = false
    assert.same({ name, false, "interrupted!" }, { name, ok, failure })
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_go")
    assert.equal(2, fsm.count)
    recorder:stop()
    assert(record.replay(model, sink))
    assert(record.replay(model, sink, { dry = true }))
    assert.same({ false, "interrupted!" }, { pcall(record.replay, model, sink,
      { guards = true, watch = function() is_due = true end }) })
  end

  it("reaches the caller as itself, and the recording is whole", function()
    interrupted("guard", function(model, raise) model[2].guard = raise end)
    interrupted("save", function(model, raise) model.save, model.load = raise, yes end)
  end)

  it("in a reset, before the recorder hears of it", function()
    local sink, is_due, model = {}, false, chart()
    local fsm = helper.init(model)
    record.record(fsm, sink)
    rfsm.run(fsm)
    local hook = fsm._reset_hooks[#fsm._reset_hooks]
    fsm._reset_hooks[#fsm._reset_hooks] = function(...)
      if is_due then error("time is up", 0) end
      return hook(...)
    end
    for _, reset in ipairs { function() rfsm.reset(fsm) end, function()
      rfsm.send_events(fsm, "e_go")
      fsm._reset_wanted, fsm._is_usual = true, false -- as by a callback
      rfsm.step(fsm)
    end } do
      helper.post_and_run(fsm, "e_go")
      assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
      is_due = true
      assert.same({ false, "time is up" }, { pcall(reset) })
      is_due = false
      rfsm.run(fsm)
    end
    assert(record.replay(model, sink, { dry = true }))
  end)

  it("in a step that goes on to a doo, with events that nothing takes", function()
    local sink, is_due = {}, false
    local model = state { info = false, warn = false, b = state {},
      a = state { doo = function() end }, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_go" }, guard = function()
        if is_due then error("interrupted!", 0) end
        return false
      end } }
    local fsm = helper.init(model)
    rfsm.step(fsm)
    record.record(fsm, sink)
    rfsm.send_events(fsm, "e_go")
    is_due = true
    assert.is_false(pcall(rfsm.step, fsm))
    is_due = false
    rfsm.send_events(fsm, "e_other") -- is there when the doo runs, behind "e_go"
    rfsm.run(fsm)
    assert.equal("done", fsm.a._mode)
    assert.equal("done", assert(record.replay(model, sink, { dry = true })).a._mode)
  end)
end)

describe("a recorder", function()
  it("may pause: the next record has the place, and no other hook is left", function()
    local sink = {}
    local recorder, fsm = recorded(sink)
    recorder:pause()
    assert.same({ 1, 1, false }, { #fsm._pre_hooks, #fsm._post_hooks,
      fsm._reset_hooks or false })
    helper.post_and_run(fsm, "e_go")
    recorder:pause() -- again does no harm
    assert.equal(10, #sink)
    recorder:go_on()
    recorder:go_on()
    assert.equal(2, #fsm._pre_hooks)
    helper.post_and_run(fsm, "e_go")
    assert.same({ "root.busy", 3, nil }, { sink[11].from.snapshot.leaf,
      sink[11].from.snapshot.data.root.count, sink[12] })
    local again = assert(record.replay(worker({}, yes), sink, { dry = true }))
    assert.same(snapshot.take(fsm), snapshot.take(again))
    recorder:stop()
    recorder:go_on()
    recorder:stop()
    assert.equal(1, #fsm._pre_hooks)
  end)

  it("notes a place again when the machine is put there", function()
    local sink = {}
    local _, fsm = recorded(sink)
    local snap = snapshot.take(fsm)
    helper.post_and_run(fsm, "e_go")
    assert(snapshot.put(fsm, snap))
    local count = #sink
    assert.equal(12, count)
    helper.post_and_run(fsm, "e_go")
    assert.same(snap, sink[count + 1].from.snapshot)
    assert.is_nil(sink[count + 2].from)
    for _, is_dry in ipairs { true, false } do
      assert(record.replay(worker({}, yes), sink, { dry = is_dry }))
    end
    assert.same({ false, "step 12: rfsm.snapshot: leaf: no state is 'root.x'", 11 }, {
      (function()
        sink[count + 1].from.snapshot.leaf = "root.x"
        return record.replay(worker({}, yes), sink)
      end)() })
  end)

  it("reads the clock for such a place as it was read then", function()
    local now, sink = 10, {}
    local function timed()
      return state { info = false, warn = false, a = state {}, b = state {},
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_after(5)" } } }
    end
    local fsm = helper.init(timed())
    fsm.gettime = function() return now, 0 end
    record.record(fsm, sink)
    rfsm.run(fsm)
    now = 12
    assert(snapshot.put(fsm, snapshot.take(fsm)))
    now = 13
    rfsm.step(fsm)
    helper.post_and_run(fsm, "e_x")
    now = 16
    rfsm.run(fsm)
    local place = sink[4].from
    assert.same({ { 13, 0 }, "root.b" }, { place.clock[1], rfsm.get_actleaf_fqn(fsm) })
    assert.equal("root.b", rfsm.get_actleaf_fqn(assert(record.replay(timed(), sink))))
  end)

  it("reads the clock as often as it was read, also after a reset", function()
    local now, sink = 0, {}
    local function timed()
      return state { info = false, warn = false, a = state {}, b = state {},
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_after(3)" } } }
    end
    local fsm = helper.init(timed())
    function fsm.gettime() -- each reading takes a second
      now = now + 1
      return now, 0
    end
    record.record(fsm, sink)
    rfsm.step(fsm)
    rfsm.reset(fsm)
    for _ = 1, 6 do
      rfsm.step(fsm)
      rfsm.send_events(fsm, "e_x")
    end
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    assert(record.replay(timed(), sink))
  end)

  it("waits for a machine that can be saved", function()
    local sink, fsm = {}, helper.init(worker({}, yes))
    local recorder = record.record(fsm, sink)
    rfsm.run(fsm)
    rfsm.reset(fsm)
    fsm.count = print
    rfsm.run(fsm)
    local count = #sink
    fsm.count = 5
    helper.post_and_run(fsm, "e_go")
    assert.same({ 3, 5, "root.idle" }, { count, sink[4].from.snapshot.data.root.count,
      sink[4].from.snapshot.leaf })
    assert.equal(recorder.count, #sink - 1)
    assert(record.replay(worker({}, yes), sink, { dry = true }))
  end)

  it("refuses a machine that cannot be saved, and blames the caller", function()
    local model = worker({}, yes)
    model.count = print
    local fsm = helper.init(model)
    assert.equal("rfsm.record.record: root.count: a function cannot be saved",
      helper.refusal(record.record, fsm, {}))
    assert.equal(1, #fsm._pre_hooks)
  end)

  it("refuses a sink that is none, and leaves the machine alone", function()
    local fsm = helper.init(worker({}, yes))
    assert.equal("rfsm.record.record: list, function, file or its name expected, "
      .. "got nil", helper.refusal(record.record, fsm))
    assert.equal("rfsm.record.record: list, function, file or its name expected, "
      .. "got 1", helper.refusal(record.record, fsm, 1))
    assert.equal(1, #fsm._pre_hooks)
    rfsm.run(fsm)
  end)

  it("refuses options that are none, which would call callbacks", function()
    local sink = {}
    record.record(helper.init(worker({}, yes)), sink)
    for expected, options in pairs { -- any order: each stands alone
      ["unknown option 'dri' (did you mean 'dry'?), expected: dry, each, guards, "
        .. "migrate, to, watch"] = { dri = true },
      ["to: whole number from 0 on expected, got string '3'"] = { to = "3" },
      ["each: function expected, got boolean"] = { each = true },
      ["table of options expected, got boolean"] = true,
    } do
      assert.equal("rfsm.record.replay: " .. expected,
        helper.refusal(record.replay, worker({}, yes), sink, options))
    end
    assert.equal("rfsm.record.to_spec: unknown option 'chrt' (did you mean 'chart'?), "
      .. "expected: chart, dry", helper.refusal(record.to_spec, sink, { chrt = "x" }))
    assert.equal("rfsm.record.read: file name expected, got nil",
      helper.refusal(record.read))
    assert.equal("rfsm.record.open: file name expected, got 7",
      helper.refusal(record.open, 7))
  end)

  it("reads the machine's own clock for its first snapshot", function()
    local fsm, sink = helper.init(state { info = false, warn = false,
      gettime = function() return 42, 0 end, a = state {}, b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_after(5)" } } }), {}
    rfsm.run(fsm)
    record.record(fsm, sink)
    assert.same({ { 42, 0 } }, sink[1].clock)
  end)

  it("reads the clocks of regions for its first snapshot", function()
    local now = 200
    local function model(gettime)
      local region = state { info = false, warn = false, gettime = gettime,
        a = state {}, b = state {}, trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_after(5)" } } }
      return state { info = false, warn = false, p = rfsm.seqand { r = region },
        trans { src = "initial", tgt = "p" } }
    end
    local fsm, sink = helper.init(model(function() return now, 0 end)), {}
    rfsm.run(fsm)
    now = 202
    record.record(fsm, sink)
    assert.same({ { 202, 0 } }, sink[1].clock)
    now = 203
    helper.post_and_run(fsm, "e_any")
    assert(record.replay(model(function() return 0, 0 end), sink))
  end)

  it("prints nothing in a dry replay, of what is created and what fails", function()
    local sink, said = {}, {}
    local fsm = helper.init(worker({}, function() error("no sensor", 0) end))
    record.record(fsm, sink)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_go")
    local model = worker({}, error)
    for _, name in ipairs { "dbg", "info", "warn", "err" } do
      model[name] = function() said[#said + 1] = name end
    end
    assert(record.replay(model, sink, { dry = true, watch = function(own)
      for _, name in ipairs { "dbg", "info", "warn", "err" } do own[name](own) end
      assert.same({}, said)
    end }))
    assert.same({ "info" }, said) -- of the machine that is returned
  end)

  it("leaves the error of a guard as it is", function()
    local said = {}
    local model = worker({}, function() error("no sensor", 0) end)
    model.err = function(...) said[#said + 1] = table.concat({ ... }, "") end
    local fsm = helper.init(model)
    record.record(fsm, {})
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_go")
    assert.same({ "GUARDerror executing guard of T={ src='root.idle', tgt='root.busy', "
      .. "events='e_go' }: no sensor" }, said)
  end)

  it("leaves alone what is merged in", function()
    local sink, asked = {}, 0
    local _, fsm = recorded(sink)
    assert(rfsm.fsm_merge(fsm, fsm, rfsm.seqand { r = helper.chart "e_x" }, "p"))
    assert(rfsm.fsm_merge(fsm, fsm, trans { src = "idle", tgt = "p", events = { "e_p" },
      guard = function() asked = asked + 1 end }))
    helper.post_and_run(fsm, "e_p")
    assert.same({ 1, "root.p", nil }, { asked, rfsm.get_actleaf_fqn(fsm),
      sink[#sink].guards })
  end)

  it("calls a function after each step of a replay", function()
    local sink, seen = {}, {}
    recorded(sink)
    assert(record.replay(worker({}, yes), sink, { dry = true, to = 3,
      each = function(fsm, records)
        seen[#seen + 1] = { rfsm.get_actleaf_fqn(fsm), records }
      end }))
    assert.same({ { "root.idle", { sink[2] } }, { "root.busy", { sink[3], sink[4] } } },
      seen)
  end)
end)

describe("an error of a debug hook while it is recorded", function()
  -- initial --> a --> b --> c, and so on; the list may change in each iteration
  local function line()
    return state {
      info = false, warn = false, keep = { "list" }, list = { 1, {} },
      a = state {}, b = state {}, c = state {},
      trans { src = "initial", tgt = "a" }, trans { src = "a", tgt = "b" },
      trans { src = "b", tgt = "c" },
    }
  end

  -- Runs a machine, and raises `failure` once, after so many VM instructions. Returns
  -- false if it was through before, else what the run returned.
  local function cut(fsm, instructions, failure)
    local is_raised = false
    local function raise()
      debug.sethook()
      is_raised = true
      error(failure, 0)
    end
    local ok, raised = pcall(function()
      debug.sethook(raise, "", instructions)
      rfsm.run(fsm)
      debug.sethook()
    end)
    return is_raised and { ok, raised }
  end

  -- Calls f(result, fsm, sink) for runs that are cut short, each later.
  local function each_cut(failure, f)
    local step, at = share.every(31)
    local count, result = 0, {}
    while result do
      local fsm, sink = helper.init(line()), {}
      record.record(fsm, sink)
      result = cut(fsm, at, failure)
      if result then f(result, fsm, sink) end
      count, at = count + 1, at + step
    end
    assert.is_true(count > 20)
  end

  it("reaches the caller as itself, whatever it is", function()
    for _, failure in ipairs { "limit", {} } do
      each_cut(failure, function(result) assert.same({ false, failure }, result) end)
    end
  end)

  it("and a reset after it are replayed", function()
    each_cut("limit", function(_, fsm, sink)
      rfsm.reset(fsm)
      fsm.list[3] = 7
      helper.post_and_run(fsm, "e_x")
      for _, is_dry in ipairs { true, false } do
        local again = assert(record.replay(line(), sink, { dry = is_dry }))
        assert.same({ "root.c", 7 }, { rfsm.get_actleaf_fqn(again), again.list[3] })
      end
    end)
  end)
end)

it("a step whose hook has failed is recorded, with its regions, before a reset",
  function()
    local function regions()
      return state { info = false, warn = false,
        both = rfsm.seqand { x = helper.chart { "e_x" } },
        trans { src = "initial", tgt = "both" } }
    end
    local sink, fsm = {}, helper.init(regions())
    record.record(fsm, sink)
    local function fail() error("no room", 0) end
    rfsm.post_step_hook_add(fsm, fail, "before")
    assert.same({ false, "no room" }, { pcall(rfsm.step, fsm) })
    rfsm.post_step_hook_rm(fsm, fail)
    rfsm.reset(fsm)
    helper.post_and_run(fsm, "e_x")
    local rec = sink[3]
    assert.same({ 1, 1 }, { sink[2].inner[1].m, #sink[2].inner })
    assert.same({ { "e_init_fsm", "e_x" }, 1, 1, nil },
      { rec.events, rec.inner[1].m, #rec.inner, rec.from.snapshot.leaf })
    assert(record.replay(regions(), sink))
  end)

it("a program's copy of a machine that is recorded is not in the recording", function()
  local function guarded()
    local region = helper.chart { "e_x" }
    return state { info = false, warn = false, a = state {},
      both = rfsm.seqand { x = region }, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "both", events = { "e_b" }, guard = yes },
      trans { src = "both", tgt = "a", events = { "e_a" } } }
  end
  local sink, fsm = {}, helper.init(guarded())
  record.record(fsm, sink)
  local copy = helper.copy_of(fsm)
  for _, event in ipairs { "e_b", "e_x", "e_a", "e_b" } do
    helper.post_and_run(copy, event)
    helper.post_and_run(fsm, event)
    helper.post_and_run(copy, "e_x")
  end
  local count = #sink
  helper.post_and_run(copy, "e_a")
  assert.same({ count, "root.both", "root.a" }, { #sink, rfsm.get_actleaf_fqn(fsm),
    rfsm.get_actleaf_fqn(copy) })
  assert(record.replay(guarded(), sink, { dry = true }))
end)

-- A machine whose kept e_k was looked at, and refused by a guard; so again after e_x.
local function new_refusing()
  local model = rfsm.state { info = false,
    a = rfsm.state { defer = { "e_k" } }, b = rfsm.state { final = true },
    rfsm.trans { src = "initial", tgt = "a" },
    rfsm.trans { src = "a", tgt = "a", events = { "e_x" } },
    rfsm.trans { src = "a", tgt = "b", events = { "e_k" },
      guard = function() return false end },
  }
  local fsm = rfsm.init(model)
  for _, event in ipairs { false, "e_k", "e_x" } do
    rfsm.send_events(fsm, event or nil)
    rfsm.run(fsm)
  end
  return fsm, model
end

it("a recording begins where a kept event has been refused", function()
  local fsm, model = new_refusing()
  local sink = {}
  local recorder = record.record(fsm, sink)
  for _, event in ipairs { "e_y", "e_x" } do
    rfsm.send_events(fsm, event)
    rfsm.run(fsm)
  end
  recorder:stop()
  assert(record.replay(model, sink))
  assert(record.replay(model, sink, { dry = true }))
end)

it("the module of recordings has a global", function()
  assert.equal(record, rawget(_G, "rfsm_record"))
end)

it("what is recorded, in a list or a file, gives the same run", function()
  assert.is_nil(share.problem(claim, 10))
end)

it("what is recorded is replayed, whatever was interrupted and reset", function()
  assert.is_nil(share.problem(interrupted_claim, 30, true))
end)

describe("a random run", function()
  local function each_run(f)
    local seeds = { 1545, 5609, 6489, 8328 } -- regions change while they are left
    for seed = FIRST, FIRST + N - 1 do seeds[#seeds + 1] = seed end
    for _, seed in ipairs(seeds) do
      local lines, watch = kept.watcher()
      local sink = {}
      kept.run(seed, function(machine)
        watch(machine)
        record.record(machine, sink)
      end)
      f(seed, sink, lines)
    end
  end

  for name, is_dry in pairs { ["dry"] = true, ["with its callbacks"] = false } do
    it("goes the same way when it is replayed " .. name, function()
      each_run(function(seed, sink, lines)
        local again, watch = kept.watcher()
        if seed % 2 == 0 then sink = json.decode((json.encode(sink))) end
        assert(record.replay(kept.model(seed), sink, { dry = is_dry, watch = watch }))
        assert.same(lines, again, "seed " .. seed)
      end)
    end)
  end
end)
