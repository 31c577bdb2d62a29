-- Time events, on a clock that the specs advance.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local share = require "spec.support.share"
local timeevent = require "rfsm_timeevent"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn
local chart, init, started, said =
  helper.chart, helper.init, helper.started, helper.said
local e_after, e_at, next_deadline, set_gettime_hook =
  timeevent.e_after, timeevent.e_at, timeevent.next_deadline, timeevent.set_gettime_hook

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local BILLION = 1000000000
local now -- what the clock says: { sec, nsec }

local function advance(sec, nsec)
  local total = now[2] + (nsec or 0)
  local carry = math.floor(total / BILLION)
  now[1], now[2] = now[1] + sec + carry, total - carry * BILLION
end

local function clock() return now[1], now[2] end

-- Stories: "+3" is three seconds later, "+0,1" a nanosecond.
local function check(fsm, story)
  assert.equal(story, helper.story(fsm, story, function(time)
    local sec, nsec = time:match("^([^,]+),?(%d*)$")
    advance(tonumber(sec), tonumber(nsec))
  end))
end

local function fail() error("out of order", 0) end

local function run_after(fsm, sec, nsec)
  advance(sec, nsec)
  rfsm.run(fsm)
end

before_each(function()
  now = { 1000, 0 }
  set_gettime_hook(clock)
end)

local function another(src, tgt, event, fields)
  local tr = trans { src = src, tgt = tgt, events = { event } }
  for key, value in pairs(fields or {}) do tr[key] = value end -- any order: a set
  return tr
end

local function closed() return false end

-- (initial) -> x --e_next--> y
local function inner()
  return state { x = state {}, y = state {}, trans { src = "initial", tgt = "x" },
    another("x", "y", "e_next") }
end

describe("a time event", function()
  local callable = setmetatable({}, { __call = function() return 1 end })
  -- The events from a to b, moves and leaves, more members.
  for _, case in ipairs {
    { it = "comes when more time has passed", events = { "e_after(3)" },
      story = "+3=a +0,1=b" },
    { it = "may be the only one, as a text", events = "e_after(3)", story = "+4=b" },
    { it = "stands beside others", events = { "e_x", "e_after(3)" }, story = "e_x=b" },
    { it = "is armed anew on each entry", events = { "e_after(1)" },
      story = "+2=b e_back=a +1=a +0,1=b" },
    { it = "is armed anew by a self transition", events = { "e_after(2)" },
      story = "+1=a e_self=a +1=a +1,1=b" },
    { it = "for 0 seconds waits for the clock", events = { "e_after(0)" },
      story = "=a =a =a +0,1=b" },
    { it = "comes first of several",
      events = { "e_after(5)", "e_after(2)", "e_at(9999)" }, story = "+2=a +0,1=b" },
    { it = "waits longer if the clock jumps back", events = { "e_after(3)" },
      story = "+-500=a +503=a +0,1=b" },
    { it = "armed after a jump back counts from there", events = { "e_after(3)" },
      story = "+-500=a e_self=a +3=a +0,1=b" },
    { it = "comes at a time", events = { "e_at(1010)" }, story = "+10=a +0,1=b" },
    { it = "whose time is past comes once an entry", events = { e_at(5) },
      story = "=b e_back=b" },
    { it = "may have a callable table", events = { e_after(callable) },
      story = "+1=a +0,1=b" },
    { it = "for math.huge seconds never comes",
      events = { e_after(function() return math.huge end) }, story = "+1e9=a" },
    { it = "for a negative number comes at once",
      events = { e_after(function() return -5 end) }, story = "=a +0,1=b" },
    { it = "at the time that a function returns",
      events = { e_at(function() return now[1] + 5 end) }, story = "+5=a +0,1=b" },
    { it = "of a function and of a number count from one reading",
      events = { e_after(function()
        advance(0, 5)
        return 1
      end), "e_after(2)" }, story = "+0,999999995=a +0,1=b" },
    { it = "comes also if the function of another fails",
      events = { e_after(fail), "e_after(3)" }, story = "+4=b" },
    { it = "may be that of the root", events = { "e_x" }, story = "+6=b",
      members = { [5] = another("root", "b", "e_after(5)") } },
    { it = "goes through connectors by the rules for all events", events = { "e_x" },
      story = "+1=a +0,1=b", members = { k = conn {},
        [5] = another("a", "k", "e_after(1)"),
        [6] = trans { src = "k", tgt = "b" } } },
    { it = "may be one of several, each with its transition",
      events = { "e_after(5)" }, story = "+3=c",
      members = { c = state {}, [5] = another("a", "c", "e_after(2)") } },
    { it = "of a composite goes on across inner transitions",
      events = { "e_after(10)" }, story = "+6=x e_next=y +4=y +0,1=b",
      members = { a = inner() } },
  } do
    it(case.it, function()
      local model = chart(case.events, case.members)
      model[4], model.err = another("a", "a", "e_self"), false
      check(started(model), case.story)
    end)
  end

  -- The events as they are written, and as they are in the machine.
  for _, case in ipairs {
    { written = { "e_after(3)" }, named = { "e_after(3)@root.a" } },
    { written = { e_at(1010.5) }, named = { "e_at(1010.5)@root.a" } },
    { written = { e_after(closed, "patience") },
      named = { "e_after(patience)@root.a" } },
    { written = { e_after(closed), e_after(fail) },
      named = { "e_after(function)@root.a", "e_after(function)#2@root.a" } },
  } do
    it("bears the name of its source: " .. case.named[1], function()
      local model = chart(case.written)
      model.err = false
      local first = case.written[1]
      assert.same(case.named, started(model)[2].events)
      assert.equal(first, model[2].events[1])
    end)
  end

  it("is acted on in the step call that finds it expired, by its name", function()
    local model, seen = chart { "e_after(3)" }, nil
    model[2].effect = function(_, _, _, events) seen = events end
    local fsm = started(model)
    advance(4)
    rfsm.step(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    assert.same({ "e_after(3)@root.a" }, seen)
  end)

  it("fires once per entry, also when a guard inhibits", function()
    local model, asked = chart { "e_after(1)" }, 0
    model[2].guard = function()
      asked = asked + 1
      return false
    end
    check(started(model), "+2=a +2=a")
    assert.equal(1, asked)
  end)

  it("is armed before the entry, and leaves its arguments and exit's alone", function()
    local trace = {}
    local function note(fsm, self, what)
      trace[#trace + 1] = ("%s %s %s %s"):format(what, self._fqn, fsm._id,
        tostring(next_deadline(fsm) == 2 + 1e-9))
    end
    local model = chart { "e_after(2)" }
    model.a.entry, model.a.exit = note, note
    check(started(model), "+3=b")
    assert.same({ "entry root.a root true", "exit root.a root false" }, trace)
  end)

  it("stays when a tool replaces entry and exit of a live machine", function()
    local fsm = init(chart { "e_after(2)" })
    fsm.a.entry, fsm.a.exit = function() end, function() end
    rfsm.run(fsm)
    check(fsm, "+3=b")
  end)
end)

describe("many timers", function()
  local function effect_events(events, more)
    local model, seen = chart(events), nil
    local function effect(_, _, _, found) seen = found end
    model[2].effect, model[4] = effect, more
    if more then more.effect = effect end
    run_after(started(model), 9)
    return seen
  end

  it("that expire together come in the order of their times, then as declared",
    function()
      assert.same({ "e_after(1)@root.a", "e_after(3)@root.a", "e_at(1001)@root.a" },
        effect_events { "e_after(3)", "e_after(1)", "e_at(1001)" })
      local events = { "e_after(1)", "e_after(1.0)", "e_after(01)", "e_after(1.00)",
        "e_after(1e0)", "e_after(001)" }
      local named = {}
      for i, event in ipairs(events) do named[i] = event .. "@root.a" end
      assert.same(named, effect_events(events))
    end)

  it("with one name at one source are one timer", function()
    assert.same({ "e_after(1)@root.a" }, effect_events({ "e_after(1)" },
      another("a", "b", "e_after(1)", { pn = 1 })))
  end)

  it("fire in the order of their times, whatever the order of arming", function()
    local model, expected = chart { "e_x" }, {}
    for i = 1, 200 do
      local event = ("e_after(%d)"):format((i * 73) % 199 + 1)
      model[i + 3] = another("a", "a", event, { guard = closed })
    end
    local fsm = started(model)
    local fired = said(fsm, "dbg", "TIMEEVENT")
    for i = 1, 200 do
      run_after(fsm, 1, 1)
      expected[i] = i < 200 and ("TIMEEVENT e_after(%d)@root.a"):format(i) or nil
    end
    assert.same(expected, fired)
  end)

  it("are disarmed one by one from the middle without disturbing the rest", function()
    -- those of x in c go, those of c stay
    local model, expected = state { c = inner(), another("initial", "c") }, {}
    for i = 1, 40 do
      local owner = i % 2 == 0 and "c" or ".c.x"
      model[i + 1] = another(owner, owner, e_after((i * 17) % 41),
        { pn = -1, guard = closed })
    end
    local fsm = started(model)
    helper.post_and_run(fsm, "e_next")
    local fired = said(fsm, "dbg", "TIMEEVENT")
    run_after(fsm, 100)
    for delay = 1, 40 do
      local i = (delay * 29) % 41 -- 17 * 29 = 1 modulo 41
      expected[#expected + 1] = i % 2 == 0
        and ("TIMEEVENT e_after(%d)@root.c"):format(delay) or nil
    end
    assert.same(expected, fired)
  end)

  it("of a millisecond each, 5,000 in a row, drift by nothing", function()
    local model, count = chart { "e_x" }, 0
    model[4] = another("a", "a", "e_after(0.001)",
      { effect = function() count = count + 1 end })
    local fsm = started(model)
    for _ = 1, 5000 do
      advance(0, 1000000)
      rfsm.step(fsm)
      advance(0, 1)
      rfsm.step(fsm, 2)
    end
    assert.same({ 5000, { 1005, 5000 } }, { count, now })
  end)

  it("spread over a day fire each at its millisecond, 350 of them", function()
    local model, STEP = chart { "e_x" }, 246857 -- ms
    for i = 1, 350 do
      model[i + 3] = another("a", "a", ("e_after(%d.%03d)"):format(
        math.floor(i * STEP / 1000), i * STEP % 1000), { guard = closed })
    end
    local fsm, late = started(model), 0
    local fired = said(fsm, "dbg", "TIMEEVENT")
    for i = 1, 350 do
      now = { 1000 + math.floor(i * STEP / 1000), i * STEP % 1000 * 1000000 }
      rfsm.run(fsm)
      if #fired ~= i - 1 then late = late + 1 end
      run_after(fsm, 0, 1)
      if #fired ~= i then late = late + 1 end
    end
    assert.equal(0, late)
  end)
end)

describe("a fraction of a second", function()
  -- T as written, and the nanoseconds that it is.
  for _, case in ipairs {
    { T = "0.1", ns = 100000000 }, { T = "0.25", ns = 250000000 },
    { T = "0.9", ns = 900000000 }, { T = "1e-9", ns = 1 },
    { T = "0.000000001", ns = 1 },
    { T = ".5", ns = 500000000 }, { T = "2.5e-1", ns = 250000000 },
    { T = "0.3", ns = 300000000 }, { T = "0.7", ns = 700000000 },
    { T = "0.123456789", ns = 123456789 }, { T = "0.999999999", ns = 999999999 },
    { T = "0.9999999996", ns = 1000000000 }, { T = "3.", ns = 3 * BILLION },
    { T = " 1 ", ns = BILLION }, { T = "15e-1", ns = 1500000000 },
  } do
    for i, event in ipairs { ("e_after(%s)"):format(case.T),
      e_after(tonumber(case.T)) } do
      it(("%s is exact to the nanosecond, as a %s"):format(tostring(event),
        type(event)), function()
        if i == 2 then now = { 1700000000, 999999999 } end
        check(started(chart { event }), ("+0,%d=a +0,1=b"):format(case.ns))
      end)
    end
  end

  it("of an absolute time is exact in text, however late", function()
    local fsm = started(chart { "e_at(1700000000.123456789)" })
    now = { 1700000000, 123456789 }
    check(fsm, "=a +0,1=b")
  end)
end)

describe("a timeout function", function()
  it("is called with its id at each entry, and returns how long that waits", function()
    local ids, delay = {}, 2
    local fsm = started(chart { e_after(function(id)
      ids[#ids + 1] = id
      return delay
    end, "patience") })
    check(fsm, "+2=a +0,1=b")
    delay = 0.5
    check(fsm, "e_back=a +0,500000000=a +0,1=b")
    assert.same({ "patience", "patience" }, ids)
  end)

  local expected = "number of seconds expected, got "
  for _, case in ipairs {
    { it = "raises", timeout = fail, reason = "out of order" },
    { it = "returns nil", timeout = function() end, reason = expected .. "nil" },
    { it = "returns a string", timeout = function() return "3" end,
      reason = expected .. "string" },
    { it = "returns NaN", timeout = function() return 0 / 0 end,
      reason = expected .. "NaN" },
    { it = "returns a boolean", timeout = closed, reason = expected .. "boolean" },
  } do
    it("that " .. case.it .. " is reported to err, and its timer is not armed",
      function()
        local fsm = init(chart { e_after(case.timeout, 7) })
        local errors = said(fsm, "err")
        rfsm.run(fsm)
        assert.same({ "TIMEEVENT error executing timeout of e_after(7)@root.a:  "
          .. case.reason }, errors)
        assert.is_nil(next_deadline(fsm))
      end)
  end

  it("that is interrupted is not reported: the error is raised", function()
    local function timeout() error("x.lua:1: interrupted!", 0) end
    local fsm = init(chart { e_after(timeout) })
    local errors = said(fsm, "err")
    assert.error_matches(function() rfsm.run(fsm) end, "interrupted!")
    assert.same({}, errors)
  end)
end)

describe("a time event that is wrong", function()
  for _, text in ipairs {
    "e_after()", "e_after(x)", "e_after(3", "e_after(-1)", "e_after(1.2.3)",
    "e_after(.)", "e_after(0x10)", "e_after(inf)", "e_at(now)", "e_after(3) s",
  } do
    it("is a plain event and a warning: " .. text, function()
      local model = chart { "e_x", text }
      local warnings = said(model, "warn")
      local fsm = started(model)
      assert.equal("WARNING: root.trans[2].events (a -> b): '" .. text
        .. "': seconds expected, as in " .. text:match("^e_%a+") .. "(0.5)",
        helper.without_file(warnings[1]))
      assert.is_nil(warnings[2])
      assert.equal("root.b", helper.leaf_after(fsm, text))
    end)
  end

  it("as an object blames the caller, also if it is negative or NaN", function()
    local text = "seconds, a number not below 0, or a function expected, got "
    assert.equal("rfsm_timeevent.e_after: " .. text .. "string",
      helper.refusal(e_after, "3"))
    assert.equal("rfsm_timeevent.e_after: " .. text .. "-1",
      helper.refusal(e_after, -1))
    assert.is_false((pcall(e_at, 0 / 0)))
  end)

  it("at a connector brings a warning, since nothing arms it", function()
    local model = chart { "e_x" }
    local warnings = said(model, "warn")
    model[1].events = { "e_init_fsm", "e_after(1)" }
    rfsm.init(model)
    assert.equal("WARNING: root.trans[1].events (initial -> a): 'e_after(1)' never "
      .. "fires here, 'root.initial' is no state", helper.without_file(warnings[1]))
    assert.same({ "e_init_fsm", "e_after(1)@root.initial" }, init(model)[1].events)
  end)
end)

it("the module is the global of its flat name, too", function()
  assert.equal(timeevent, rawget(_G, "rfsm_timeevent"))
end)

it("is_timeevent knows objects and texts", function()
  for _, value in ipairs { "e_after(1)", "e_at(2.5)", "e_after(1)@root.a", e_after(1),
    e_at(print) } do
    assert.is_true(timeevent.is_timeevent(value))
  end
  for _, value in ipairs { "e_x", "e_after", "e_after(x)", 7, {}, print } do
    assert.is_false(timeevent.is_timeevent(value))
  end
  assert.is_false(timeevent.is_timeevent(nil))
end)

describe("the gettime hook", function()
  -- The seconds of a timer, and what it may return: at first, then before the timer
  -- expires and when it has expired.
  for _, case in ipairs {
    { it = "nanoseconds in one number", seconds = 1e-9, first = { 5999999999 },
      before = { 6000000000 }, after = { 6000000001 } },
    { it = "up to 2^53 of them", seconds = 1e-9, -- where a / b rounds up
      first = { 9007199 * BILLION - 1 }, before = { 9007199 * BILLION },
      after = { 9007199 * BILLION + 1 } },
    { it = "a fraction in the first value", seconds = 0.25, first = { 10, 0 },
      before = { 10.25, 0 }, after = { 10.5, 0 } },
    { it = "more nanoseconds than a second has", seconds = 2, first = { 0, 0 },
      before = { 0, 2 * BILLION }, after = { 0, 2 * BILLION + 1 } },
    { it = "times before its start", seconds = 2, first = { -5, 0 },
      before = { -3, 0 }, after = { -3, 1 } },
  } do
    it("may return " .. case.it, function()
      local time = case.first
      set_gettime_hook(function() return unpack(time) end)
      local fsm = started(chart { e_after(case.seconds) })
      time = case.before
      check(fsm, "=a")
      time = case.after
      check(fsm, "=b")
    end)
  end

  it("that wants a clock id is given one: e_at has that of the day", function()
    local ids, hours = {}, 3600
    set_gettime_hook(function(id)
      assert(type(id) == "string", "bad argument #1 to 'gettime'")
      ids[id] = true
      return now[1] + (id == "CLOCK_REALTIME" and hours or 0), now[2]
    end)
    check(started(chart { "e_after(3)" }), "+3=a +0,1=b")
    now = { 1000, 0 }
    check(started(chart { ("e_at(%d)"):format(1003 + hours) }), "+3=a +0,1=b")
    assert.same({ CLOCK_MONOTONIC = true, CLOCK_REALTIME = true }, ids)
  end)

  it("must be a function, and blames the caller", function()
    assert.equal("rfsm_timeevent.set_gettime_hook: function expected, got number",
      helper.refusal(set_gettime_hook, 5))
  end)
end)

describe("a clock that fails", function()
  local function broken() error("battery empty", 0) end

  -- A machine that was started with one clock and goes on with another.
  local function with_clocks(first, second, events)
    set_gettime_hook(first)
    local fsm = init(chart(events or { "e_after(3)" }))
    local errors = said(fsm, "err")
    rfsm.run(fsm)
    set_gettime_hook(second)
    return fsm, errors
  end

  it("is reported when a state is entered, and when a timer is merged", function()
    set_gettime_hook(broken)
    local fsm = init(chart { "e_after(3)" })
    local errors = said(fsm, "err")
    rfsm.step(fsm)
    assert.same({ "TIMEEVENT the clock failed:  battery empty" }, errors)
    fsm, errors = with_clocks(clock, broken)
    assert.is_true(rfsm.fsm_merge(fsm, fsm, another("a", "b", "e_after(2)")))
    assert.same({ "TIMEEVENT the clock failed:  battery empty" }, errors)
    set_gettime_hook(clock)
    check(fsm, "+2=a +0,1=a +3=b")
  end)

  it("is reported to err, and the step goes on; no armed timer is lost", function()
    local fsm, errors = with_clocks(clock, broken)
    rfsm.step(fsm)
    assert.same({ "TIMEEVENT the clock failed:  battery empty" }, errors)
    set_gettime_hook(clock)
    check(fsm, "+4=b")
  end)

  it("has timers armed later, when it works again", function()
    check(with_clocks(broken, clock), "=a +3=a +0,1=b")
    assert.equal(3 + 1e-9, next_deadline((with_clocks(broken, clock))))
  end)

  it("has none armed later for a state that was left meanwhile", function()
    local fsm = with_clocks(broken, broken, { "e_after(3)", "e_x" })
    check(fsm, "e_x=b") -- other events get through
    set_gettime_hook(clock)
    rfsm.run(fsm)
    assert.is_nil(next_deadline(fsm))
  end)

  it("is not read for timers that a reset has dropped", function()
    local fsm, count = started(chart { "e_after(3)", "e_at(1005)" }), 0
    rfsm.reset(fsm)
    set_gettime_hook(function()
      count = count + 1
      return clock()
    end)
    rfsm.step(fsm)
    assert.equal(1, count) -- for the entry
  end)

  it("while err fails, too, raises that and loses nothing", function()
    local fsm = with_clocks(clock, broken)
    fsm.err = function() error("no printer", 0) end
    assert.error_matches(function() rfsm.step(fsm) end, "no printer")
    set_gettime_hook(clock)
    check(fsm, "+4=b")
  end)

  it("is raised by next_deadline, also while timers wait for it", function()
    for _, first in ipairs { clock, broken } do
      local fsm = with_clocks(first, broken)
      assert.error_matches(function() next_deadline(fsm) end,
        "rfsm_timeevent: the clock failed: battery empty")
    end
  end)

  for _, case in ipairs {
    { it = "a string", sec = "12", nsec = nil, got = "seconds and nanoseconds "
      .. "expected, got string" },
    { it = "NaN", sec = 0 / 0, nsec = 0, got = "a time must be finite" },
    { it = "infinity", sec = 1, nsec = math.huge, got = "a time must be finite" },
    { it = "infinitely many nanoseconds", sec = math.huge, nsec = nil,
      got = "a time must be finite" },
    { it = "nothing", sec = nil, nsec = nil, got = "seconds and nanoseconds expected, "
      .. "got nil" },
    { it = "a table after a number", sec = 1, nsec = {}, got = "seconds and "
      .. "nanoseconds expected, got table" },
  } do
    it("by returning " .. case.it .. " is reported as such", function()
      local function wrong() return case.sec, case.nsec end
      for _, first in ipairs { clock, wrong } do
        local fsm, errors = with_clocks(first, wrong)
        helper.clear(errors)
        rfsm.step(fsm)
        assert.same({ "TIMEEVENT the clock failed:  " .. case.got }, errors)
        fsm.gettime = clock
        check(fsm, "=a +4=b")
        now = { 1000, 0 }
      end
    end)
  end
end)

describe("without a hook", function()
  local MODULES = { "rtp", "posix.time", "posix", "socket" }
  local real_time = os.time

  -- Which clocks are read for an e_after and then for an e_at by a fresh copy of core
  -- and extension, which finds only the clocks in `modules`?
  local function clocks_read(make_modules)
    local names, preload = {}, {}
    local modules = make_modules(function(name)
      names[#names + 1] = name
      return 5, 0
    end)
    local hidden = { rfsm = false, rfsm_timeevent = false, ["rfsm.clock"] = false }
    for _, name in ipairs(MODULES) do
      hidden[name] = false
      preload[name] = function() return modules[name] or error("none") end
    end
    if modules["rfsm.clock"] == false then
      preload["rfsm.clock"] = function() error("module 'rfsm.clock' not found") end
    end
    local globals = { rtt = modules.rtt or false, rfsm = rfsm, -- as they were, later
      rfsm_timeevent = timeevent }
    helper.with(_G, globals, function() helper.with(package.preload, preload, function()
      helper.with(package.loaded, hidden, function()
        local C, copy = require "rfsm", require "rfsm_timeevent"
        local fsm = C.init(C.state { warn = false, info = false, a = C.state {},
          C.trans { src = "initial", tgt = "a" },
          C.trans { src = "a", tgt = "a", events = { "e_after(1)", "e_at(99)" } } })
        C.step(fsm)
        copy.next_deadline(fsm) -- the clocks have been chosen now
        helper.clear(names)
        copy.next_deadline(fsm)
      end)
    end) end)
    return table.concat(names, " ")
  end

  after_each(function() os.time = real_time end) -- luacheck: ignore 122

  -- The names or ids by which a clock is read for an e_after and an e_at, and the
  -- modules that are installed; `read` notes one.
  for _, case in ipairs {
    { it = "rtp, monotonic for e_after", ids = "CLOCK_MONOTONIC CLOCK_REALTIME",
      modules = function(read)
        return { rtp = { clock = { gettime = read } } }
      end },
    { it = "an rtp that knows no clock by name", ids = "nil nil",
      modules = function(read)
        return { rtp = { clock = { gettime = function(id)
          assert(id == nil, "number expected")
          return read("nil")
        end } } }
      end },
    { it = "luaposix, monotonic for e_after", ids = "mono real",
      modules = function(read)
        return { ["posix.time"] = {
          CLOCK_MONOTONIC = "mono", CLOCK_REALTIME = "real",
          clock_gettime = function(id) return { tv_sec = read(id), tv_nsec = 0 } end,
        } }
      end },
    { it = "an old luaposix", ids = "monotonic realtime",
      modules = function(read)
        return { posix = { clock_gettime = read } }
      end },
    { it = "luasocket", ids = "socket socket",
      modules = function(read)
        return { socket = { gettime = function() return (read("socket")) end } }
      end },
    { it = "that of RTT for e_after, the time of day for e_at", ids = "rtt socket",
      modules = function(read)
        return { rtt = { getTime = function() return read("rtt") end },
          rtp = false, socket = { gettime = function() return (read("socket")) end } }
      end },
    { it = "that of RTT in a folder without others", ids = "rtt os",
      modules = function(read)
        os.time = function() return (read("os")) end -- luacheck: ignore 122
        return { rtt = { getTime = function() return read("rtt") end } }
      end },
    { it = "os.time without rfsm.clock", ids = "os os", modules = function(read)
      os.time = function() return (read("os")) end -- luacheck: ignore 122
      return { ["rfsm.clock"] = false, socket = { gettime = function()
        return (read("socket"))
      end } }
    end },
    { it = "os.time", ids = "os os",
      modules = function(read)
        os.time = function() return (read("os")) end -- luacheck: ignore 122
        return {}
      end },
    { it = "the next one after one that fails", ids = "socket socket",
      modules = function(read)
        return { posix = { clock_gettime = function() error("no such clock") end },
          socket = { gettime = function() return (read("socket")) end } }
      end },
  } do
    it("the clock is " .. case.it, function()
      assert.equal(case.ids, clocks_read(case.modules))
    end)
  end

  it("an interrupt in the search for a clock reaches the caller of step", function()
    local ok, failure = pcall(clocks_read, function()
      return { rtp = { clock = { gettime = function() error("interrupted!", 0) end } } }
    end)
    assert.same({ false, "interrupted!" }, { ok, failure })
  end)
end)

describe("dbg", function()
  it("has a record TIMEEVENT with the name", function()
    local fsm = started(chart { "e_after(3)" })
    local records = said(fsm, "dbg", "TIMEEVENT")
    run_after(fsm, 4)
    assert.same({ "TIMEEVENT e_after(3)@root.a" }, records)
  end)

  it("that fails loses no event of the iteration", function()
    local fsm = started(chart { "e_after(1)", "e_after(2)" })
    fsm.dbg = function(id) if id == "TIMEEVENT" then error("no printer", 0) end end
    advance(5)
    assert.error_matches(function() rfsm.step(fsm) end, "no printer")
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("next_deadline", function()
  -- The events of a, seconds that pass, what is left.
  for _, case in ipairs {
    { it = "is nil when nothing is armed", events = { "e_x" }, passed = 0, left = nil },
    { it = "is the time until the earliest can fire",
      events = { "e_after(3)", "e_after(0.5)", "e_at(1002)" }, passed = 0,
      left = 0.5 + 1e-9 },
    { it = "counts absolute times", events = { "e_after(3)", "e_at(1002)" }, passed = 1,
      left = 1 + 1e-9 },
    { it = "shrinks as time passes", events = { "e_after(3)" }, passed = 2.75,
      left = 0.25 + 1e-9 },
    { it = "is 0 when a timer has expired", events = { "e_after(3)" }, passed = 4,
      left = 0 },
  } do
    it(case.it, function()
      local fsm = started(chart(case.events))
      advance(math.floor(case.passed), case.passed % 1 * BILLION)
      assert.equal(case.left, next_deadline(fsm))
    end)
  end

  it("is nil before the first entry, when the state was left, and after reset",
    function()
      local fsm = init(chart { "e_after(1)", "e_at(5000)", "e_x" })
      assert.is_nil(next_deadline(fsm))
      rfsm.run(fsm)
      check(fsm, "e_x=b")
      assert.is_nil(next_deadline(fsm))
      check(fsm, "e_back=a")
      rfsm.reset(fsm)
      assert.is_nil(next_deadline(fsm))
    end)

  it("slept through to the nanosecond finds the event, one less does not", function()
    local fsm = started(chart { "e_after(0.3)" })
    local ns = math.floor(next_deadline(fsm) * BILLION + 0.5)
    check(fsm, ("+0,%d=a +0,1=b"):format(ns - 1))
  end)

  it("blames the caller for what is no machine", function()
    assert.equal("rfsm_timeevent.next_deadline: initialised fsm expected, got table",
      helper.refusal(next_deadline, {}))
  end)

  it("counts the timers of the regions of active states", function()
    local fsm = init(state { info = false, warn = false, idle = state {},
      par = rfsm.seqand { sub = chart { "e_after(3)" } },
      another("initial", "idle"), another("idle", "par", "e_in"),
      another("par", "idle", "e_out") })
    fsm[1].events = nil
    check(fsm, "=idle e_in=par")
    assert.equal(3 + 1e-9, next_deadline(fsm))
    check(fsm, "+3=par +0,1=par")
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm.par.substates.sub))
    check(fsm, "e_out=idle")
    assert.is_nil(next_deadline(fsm))
  end)
end)

describe("the clock of a machine", function()
  local function hours_later() return now[1] + 7200, now[2] end

  it("is its field gettime, for e_after and e_at, also when set later", function()
    local model = chart({ "e_after(3)", "e_at(8210)" }, { gettime = hours_later })
    check(started(model), "+3=a +0,1=b")
    now = { 1000, 0 }
    check(started(model), "+3=a +0,1=b")
    now = { 1009, 0 }
    check(started(chart({ "e_at(8210)" }, { gettime = hours_later })), "+1=a +0,1=b")
    now = { 1000, 0 }
    local fsm = started(chart { "e_at(8210)" })
    fsm.gettime = hours_later
    check(fsm, "+1010=b")
    fsm = started(chart { "e_at(8210)" })
    check(fsm, "=a")
    fsm.gettime = hours_later
    assert.equal(next_deadline(fsm), 0)
    check(fsm, "=b")
    fsm.gettime = nil
    assert.is_nil(next_deadline(fsm))
  end)

  it("leaves that of other machines alone", function()
    local stopped = started(chart({ "e_after(3)" }, { gettime = function()
      return 5, 0
    end }))
    local fsm = started(chart { "e_after(3)" })
    check(fsm, "+3,1=b")
    check(stopped, "+99=a")
  end)

  it("may want a clock id", function()
    local ids, hours = {}, 0
    local fsm = started(chart({ "e_after(3)" }, { gettime = function(id)
      ids[#ids + 1] = assert(id)
      return now[1] + (id == "CLOCK_REALTIME" and hours or 0), now[2]
    end }))
    hours = 3600
    check(fsm, "+3=a +0,1=b e_back=a +3=a +0,1=b e_back=a")
    hours, now = 0, { 1000, 0 }
    helper.clear(ids)
    check(fsm, "=a")
    assert.same({ "CLOCK_MONOTONIC" }, ids)
    now = { 1999, 999999999 }
    fsm = started(chart({ "e_at(2000)" }, { gettime = fsm.gettime }))
    helper.clear(ids)
    check(fsm, "+0,1=a +0,1=b")
    assert.equal("CLOCK_REALTIME", ids[1])
  end)

  it("that fails is reported by name of the failure, as that of the process",
    function()
      local fsm = started(chart({ "e_after(3)" }, { gettime = clock }))
      local errors = said(fsm, "err")
      fsm.gettime = function() error("battery empty", 0) end
      rfsm.step(fsm)
      assert.same({ "TIMEEVENT the clock failed:  battery empty" }, errors)
    end)

  describe("in a region", function()
    -- The regions slow, with a clock of its own, and plain; deep inside of plain.
    local function machines()
      local deep = state { info = false, warn = false,
        par = rfsm.seqand { idle_doo = "auto", deep = chart { "e_after(3)" } },
        trans { src = "initial", tgt = "par" } }
      local fsm = started(state { info = false, warn = false,
        par = rfsm.seqand { idle_doo = "auto", deep = deep,
          slow = chart({ "e_after(3)" }, { gettime = clock }) },
        trans { src = "initial", tgt = "par" }, gettime = hours_later })
      return fsm, fsm.par.substates.slow, fsm.par.substates.deep.par.substates.deep
    end

    it("is its own, else that of the machine around it", function()
      local fsm, slow, deep = machines()
      local at = 0
      fsm.gettime = function() return 7200 + 1000 + at, 0 end
      assert.equal(3 + 1e-9, next_deadline(fsm))
      at = 4
      rfsm.run(fsm)
      assert.same({ "root.a", "root.b" }, { rfsm.get_actleaf_fqn(slow),
        rfsm.get_actleaf_fqn(deep) })
      now[1] = 1004
      rfsm.run(fsm)
      assert.equal("root.b", rfsm.get_actleaf_fqn(slow))
    end)
  end)

  it("that takes nothing else is refused by init, as a hook is", function()
    local model = chart({ "e_after(3)" }, { gettime = 5, err = false })
    local _, text = rfsm.init(model)
    assert.matches("root.gettime: function expected, got number 5", text)
  end)
end)

describe("the clock of RTT", function()
  local function rtt_time() return 50, 0 end -- since the start of the computer

  it("as a hook or as gettime is for e_after alone", function()
    helper.with(_G, { rtt = { getTime = rtt_time } }, function()
      local past = chart({ "e_after(3)", "e_at(1000)" })
      set_gettime_hook(rtt_time)
      check(started(past), "=b")
      set_gettime_hook(nil)
      past.gettime = rtt_time
      check(started(past), "=b")
    end)
  end)

  it("is one of the user's where there is no RTT", function()
    set_gettime_hook(rtt_time)
    check(started(chart { "e_at(1000)" }), "=a")
  end)
end)

describe("a clock that returns seconds in one number", function()
  local function warnings_of(gettime)
    local model = chart { "e_after(3)" }
    local warnings = said(model, "warn")
    set_gettime_hook(gettime)
    for _ = 1, 2 do rfsm.run((assert(rfsm.init(model)))) end
    return warnings
  end

  -- What it returns, and whether that must be seconds.
  for _, case in ipairs {
    { it = "the time of day", number = os.time(), is_warned = true },
    { it = "the time of day in a fraction", number = os.time() + 0.25,
      is_warned = true },
    { it = "seconds since the start", number = 12.5, is_warned = true },
    { it = "almost a millisecond", number = 999999, is_warned = true },
    { it = "a millisecond", number = 1000000 },
    { it = "nothing yet", number = 0 },
    { it = "the day after tomorrow", number = os.time() + 2 * 86400 },
    { it = "nanoseconds", number = os.time() * 1e9 },
    { it = "nanoseconds in the second value", number = 0, nsec = 500 },
  } do
    it("is reported once: " .. case.it, function()
      local warnings = warnings_of(function() return case.number, case.nsec end)
      local expected = case.is_warned and { ("WARNING: the clock returned one number, "
        .. "%.14g, which means nanoseconds; seconds need two: "
        .. "function() return os.time(), 0 end"):format(case.number) } or {}
      assert.same(expected, warnings)
    end)
  end

  it("is os.time itself, and once for each clock", function()
    local clocks = { os.time, function() return os.time() end }
    for _, gettime in ipairs(clocks) do assert.equal(1, #warnings_of(gettime)) end
    for _, gettime in ipairs(clocks) do assert.equal(0, #warnings_of(gettime)) end
  end)
end)

-- LuaJIT 2.1.0-beta3 crashes now and then in what it compiles of this claim.
it("time events agree with a list of deadlines, on random charts", function()
  local jit = rawget(_G, "jit") or { off = function() end, on = function() end }
  jit.off()
  local problem = share.problem(require "spec.support.claims.timeevent", 40)
  jit.on()
  assert.is_nil(problem)
end)

it("two machines of one model have timers of their own", function()
  local model = chart { e_after(3) }
  local first = started(model)
  advance(2)
  local second = started(model)
  check(first, "+1,1=b")
  check(second, "=a")
end)

it("reset has the next entry arm anew", function()
  local fsm = started(chart { "e_after(3)" })
  advance(2)
  rfsm.reset(fsm)
  check(fsm, "=a +3=a +0,1=b")
end)

describe("fsm_merge", function()
  -- What is merged into the root, with names; a story.
  for _, case in ipairs {
    { it = "of a transition from an active state arms its timer then",
      merged = { { obj = another("a", "b", "e_after(2)") } }, story = "+2=a +0,1=b" },
    { it = "of a transition from an inactive state arms it on entry",
      merged = { { obj = another("b", "a", "e_after(2)") } },
      story = "+5=a e_x=b +2=b +0,1=a" },
    { it = "of a time that is past arms it, too",
      merged = { { obj = another("a", "b", "e_at(7)") } }, story = "=b" },
    { it = "of another time for a state leaves its timers as they are",
      merged = { { obj = another("a", "b", "e_after(4)") },
        { after = 3, obj = another("a", "a", "e_after(3)") } },
      story = "+1=a +0,1=b e_back=a +3=a +0,1=a +1=a" },
    { it = "of a composite arms the timers in it", merged = {
      { obj = state { x = state {}, y = state {}, trans { src = "initial", tgt = "x" },
        another("x", "y", "e_after(1)") }, name = "c" },
      { obj = another("a", "c", "e_in") },
    }, story = "e_in=x +2=y" },
  } do
    it(case.it, function()
      local fsm = started(chart { "e_x" })
      for _, merged in ipairs(case.merged) do
        advance(merged.after or 0)
        assert.is_true(rfsm.fsm_merge(fsm, fsm, merged.obj, merged.name))
      end
      check(fsm, case.story)
    end)
  end

  it("while the clock fails has the timer wait for it", function()
    local fsm = started(chart({ "e_x" }, { err = false }))
    fsm.gettime = fail
    assert.is_true(rfsm.fsm_merge(fsm, fsm, another("a", "b", "e_after(2)")))
    rfsm.run(fsm)
    advance(9)
    fsm.gettime = clock
    check(fsm, "=a +2=a +0,1=b")
  end)
end)

describe("a snapshot", function()
  local snapshot = require "rfsm.snapshot"
  local model = chart { "e_after(3)", "e_after(1)", "e_at(1005)" }
  model[2].guard, model[4] = closed, another("a", "b", "e_after(5)")

  -- A machine from the snapshot of one that was entered two seconds before.
  local function restored(change)
    now = { 1000, 0 }
    local fsm = started(model)
    check(fsm, "+2=a")
    local snap = snapshot.take(fsm)
    now = { 5000, 7 }
    if change then change(snap.ext.timers) end
    local other, problem = snapshot.restore(model, snap)
    return other, other and said(other, "dbg", "TIMEEVENT") or problem
  end

  it("has the time that is left, and the timers that fired", function()
    local fsm, fired = restored()
    check(fsm, "=a +1=a +0,1=a +2=b")
    assert.same({ "TIMEEVENT e_at(1005)@root.a", "TIMEEVENT e_after(3)@root.a",
      "TIMEEVENT e_after(5)@root.a" }, fired)
    assert.same({ "e_after(3)@root.a", "e_after(5)@root.a", "e_at(1005)@root.a" },
      rfsm.sorted_keys(snapshot.take((restored())).ext.timers))
    assert.equal(1 + 1e-9, (next_deadline((restored(function(timers)
      timers["e_at(1005)@root.a"] = nil
    end)))))
  end)

  it("counts from the second reading of a clock that fails once at an entry", function()
    local is_broken = false
    set_gettime_hook(function()
      if is_broken then
        is_broken = false
        fail()
      end
      return unpack(now)
    end)
    local fsm = init(chart({ "e_after(3)" }, { err = false }))
    now, is_broken = { 1000, 500000000 }, true
    rfsm.step(fsm)
    assert.is_false(is_broken)
    for _, case in ipairs { { nsec = 500000000, leaf = "root.a" },
      { nsec = 500000001, leaf = "root.b" } } do
      now = { 1003, case.nsec }
      rfsm.run(fsm)
      assert.equal(case.leaf, rfsm.get_actleaf_fqn(fsm))
    end
  end)

  it("has the time of day of e_at, whatever the clock shows", function()
    local chart_at = chart { "e_at(1005)" }
    local snap = snapshot.take(started(chart_at))
    now = { 1002, 0 }
    local fsm = assert(snapshot.restore(chart_at, snap))
    assert.equal(3 + 1e-9, next_deadline(fsm))
    check(fsm, "+3=a +0,1=b")
  end)

  it("has the nanoseconds of a time that is far away", function()
    local fsm = started(chart { "e_at(2000000000.000000001)", "e_after(2000000)" })
    advance(0, 1)
    assert.same({ ["e_at(2000000000.000000001)@root.a"] = { 2000000000, 1 },
      ["e_after(2000000)@root.a"] = { 1999999, 999999999 } },
      snapshot.take(fsm).ext.timers)
  end)

  it("of a machine without armed timers has none", function()
    local fsm = started(model)
    check(fsm, "+9=b")
    assert.is_nil((snapshot.take(fsm).ext or {}).timers)
  end)

  it("has timers that wait for the clock", function()
    local fsm = init(chart({ "e_after(3)" }, { err = false }))
    set_gettime_hook(fail)
    rfsm.run(fsm)
    local snap = snapshot.take(fsm)
    assert.same({ ["e_after(3)@root.a"] = true }, snap.ext.timers)
    local other = assert(snapshot.restore(chart({ "e_after(3)" }, { err = false }),
      snap))
    set_gettime_hook(clock)
    check(other, "=a +3=a +0,1=b")
  end)

  it("keeps times that are equal so, though the clock is slow", function()
    local nsec = 0
    set_gettime_hook(function()
      nsec = 2 * nsec + 1
      return 0, nsec
    end)
    local both = chart { "e_after(3)", "e_every(3)" }
    local fsm = assert(snapshot.restore(both, snapshot.take(started(both))))
    local timers = fsm.a._timers
    assert.same({ timers[1].sec, timers[1].nsec }, { timers[2].sec, timers[2].nsec })
  end)

  it("is refused if a timer is wrong or not there, or the clock fails", function()
    for _, case in ipairs {
      { name = "e_x", value = { 1, 2 }, problem = "no active state has a timer 'e_x'" },
      { name = "e_after(3)@root.a", value = "3", problem = "seconds and nanoseconds "
        .. "expected for timer 'e_after(3)@root.a'" },
      { name = "e_after(3)@root.a", value = { 1 }, problem = "seconds and "
        .. "nanoseconds expected for timer 'e_after(3)@root.a'" },
    } do
      local fsm, problem = restored(function(timers) timers[case.name] = case.value end)
      assert.is_false(fsm)
      assert.is_truthy(problem:find(case.problem, 1, true), problem)
    end
    local fsm, problem = restored(function() set_gettime_hook(fail) end)
    assert.is_false(fsm)
    assert.is_truthy(problem:find("the clock failed: out of order", 1, true), problem)
  end)
end)

-- An error of a debug hook at each VM instruction of timers and clocks, in one step.
describe("an interrupt in a timer", function()
  local interrupts = require "spec.support.interrupts"

  -- Timers of each kind: that of a number, of functions, and of a time.
  local EVENTS = { "e_after(3)", e_after(function() return 2 end, "f"), "e_at(1005)" }

  -- Returns a machine and the list of what its timers raise: it is in b if it is to
  -- enter a in the next step, else in a.
  local function machine(gettime, is_entry)
    now = { 1000, 0 }
    local model = chart(EVENTS, { gettime = gettime })
    model[2].guard = closed
    model[4] = another("a", "b", "e_leave")
    local fsm = started(model)
    if is_entry then helper.post_and_run(fsm, "e_leave") end
    if is_entry then rfsm.send_events(fsm, "e_back") end
    return fsm, said(fsm, "dbg", "TIMEEVENT")
  end

  -- Steps, and goes on 9 s later; returns what was raised. The names are taken from the
  -- events if one record may have been cut short.
  local function finish(fsm, fired, is_record_lost)
    local set = {}
    rfsm.post_step_hook_add(fsm, function(_, events)
      for _, event in ipairs(events) do set["TIMEEVENT " .. event] = true end
    end)
    rfsm.run(fsm)
    run_after(fsm, 9)
    for _, text in ipairs(fired) do set[text] = true end
    set["TIMEEVENT e_done@root.a"] = nil
    if is_record_lost then fired = rfsm.sorted_keys(set) end
    table.sort(fired)
    return table.concat(fired, ", ")
  end

  local VALUE, ALL = "time is up", "TIMEEVENT e_after(3)@root.a, "
    .. "TIMEEVENT e_after(f)@root.a, TIMEEVENT e_at(1005)@root.a"

  -- The seconds before the step that is interrupted, whether it enters the state, and
  -- the clock.
  for _, case in ipairs {
    { it = "as none is due", passed = 1 },
    { it = "as all are due", passed = 9, is_record_lost = true },
    { it = "at an entry", passed = 0, is_entry = true },
    { it = "on the clock of the process", passed = 1, is_process = true },
  } do
    it("reaches the caller of step, and none is lost, " .. case.it, function()
      interrupts.without_jit(function()
        local at, count, is_reached = 0, 0, true
        while is_reached do
          at = at + 1
          local gettime = not case.is_process and clock or nil
          local fsm, fired = machine(gettime, case.is_entry)
          advance(case.passed)
          local result = { interrupts.raise_in_timers(at, VALUE, rfsm.step, fsm) }
          is_reached = result[1]
          if result[2] then
            count = count + 1
            assert.same({ false, VALUE }, { result[3], result[4] })
            assert.equal(ALL, finish(fsm, fired, case.is_record_lost))
          end
        end
        assert.is_true(count > 20)
      end)
    end)
  end
end)

describe("rfsm.clock", function()
  local clock_module = require "rfsm.clock"

  -- A clock, and what is read: the time in one number, seconds, nanoseconds.
  for _, case in ipairs {
    { it = "seconds and nanoseconds", clock = clock, read = { 1000, 1000, 0 } },
    { it = "nanoseconds", clock = function() return 5e9 end, read = { 5, 0, 5e9 } },
    { it = "the error of a clock", clock = fail, read = { false, "out of order" } },
    { it = "what is wrong", clock = function() return "5" end,
      read = { false, "seconds and nanoseconds expected, got string" } },
  } do
    it("reads " .. case.it .. ", of a machine, its parent machine and the process",
      function()
        local function read(fsm) return { clock_module.read(fsm, true) } end
        assert.same(case.read, read { gettime = case.clock, warn = false })
        assert.same(case.read, read { _owner = { _owner = { gettime = case.clock } },
          warn = false })
        clock_module.set_hook(case.clock)
        assert.same(case.read, read { _owner = {}, warn = false })
      end)
  end

  it("raises what Control-C raises in a clock, and nothing else", function()
    local raised = "x.lua:5: interrupted!"
    local fsm = { gettime = function() error(raised, 0) end }
    assert.error_matches(function() clock_module.read(fsm, true) end, "interrupted!")
    raised = "it was interrupted!"
    assert.same({ false, raised }, { clock_module.read(fsm, true) })
  end)

  it("counts from now on, by the clock that is never set", function()
    clock_module.set_hook(function(id)
      assert(id == "CLOCK_MONOTONIC")
      return now[1], now[2]
    end)
    local elapsed = clock_module.from_now()
    advance(2, 500000000)
    assert.equal(2.5, elapsed())
    advance(0, 750000000)
    assert.equal(3.25, elapsed())
  end)

  it("from now on, reports a clock that returns seconds in one number", function()
    local printed = {}
    local function write(_, text) printed[#printed + 1] = text end
    helper.with(io, { stderr = { write = write } }, function()
      clock_module.set_hook(function() return os.time() end)
      clock_module.from_now()
    end)
    assert.matches("^WARNING: the clock returned one number", printed[1])
  end)

  it("knows no timer without time events, nor with a clock that fails", function()
    local fsm = started(chart { "e_after(3)" })
    assert.is_true(clock_module.until_timer(fsm) > 3)
    set_gettime_hook(fail)
    assert.is_nil(clock_module.until_timer(fsm))
    helper.with(package.loaded, { rfsm_timeevent = false }, function()
      assert.is_nil(clock_module.until_timer(fsm))
    end)
    set_gettime_hook(function() error("interrupted!", 0) end)
    assert.has_error(function() clock_module.until_timer(fsm) end, "interrupted!")
  end)

  it("without any clock raises an error", function()
    helper.with(_G, { os = false, rtt = false }, function()
      local hidden = { ["posix.time"] = {}, posix = {}, socket = {}, rtp = {} }
      helper.with(package.loaded, hidden, function()
        set_gettime_hook(nil)
        assert.same({ false, "no clock is installed" }, { clock_module.read({}, true) })
      end)
    end)
  end)
end)

describe("a simulated clock", function()
  local simulated = require("rfsm.clock").simulated

  -- Starts a chart on a simulated clock; returns both.
  local function on_clock(events, fields, start)
    local time = simulated { now = start or 0 }
    fields = fields or {}
    fields.gettime = time
    return started(chart(events, fields)), time
  end

  local function leaf_after(fsm)
    rfsm.run(fsm)
    return rfsm.get_actleaf_fqn(fsm)
  end

  it("is a clock, whose time passes by advance alone", function()
    local fsm, time = on_clock { "e_after(2.5)" }
    assert.same({ 0, 0 }, { time() })
    time:advance(2.5)
    assert.equal("root.a", leaf_after(fsm))
    time:advance(1e-9)
    assert.equal("root.b", leaf_after(fsm))
    assert.same({ 2, 500000001 }, { fsm.gettime() })
    assert.equal(2.5 + 1e-9, time:now())
    time:advance(-1.75)
    assert.same({ 0, 750000001 }, { time() })
  end)

  -- Where it starts, what is added how often, seconds and nanoseconds then.
  for _, case in ipairs {
    { start = 0, step = 0.1, times = 100000, sec = 10000, nsec = 0 },
    { start = 0, step = 1e-9, times = 5000, sec = 0, nsec = 5000 },
    { start = 1700000000, step = 0.3, times = 10, sec = 1700000003, nsec = 0 },
    { start = 0.75, step = -0.5, times = 3, sec = -1, nsec = 250000000 },
    { start = -0.25, step = 1, times = 1, sec = 0, nsec = 750000000 },
  } do
    it(("does not drift: %g and %d times %g"):format(case.start, case.times, case.step),
      function()
        local time = simulated { now = case.start }
        for _ = 1, case.times do time:advance(case.step) end
        assert.same({ case.sec, case.nsec }, { time() })
      end)
  end

  it("goes to the next timer, from one to the other", function()
    local fsm, time = on_clock { "e_after(3)" }
    local back = another("b", "a", "e_at(1700000000.999999997)")
    assert.is_true(rfsm.fsm_merge(fsm, fsm, back))
    assert.equal(3 + 1e-9, time:advance_to_timer(fsm))
    assert.equal("root.b", leaf_after(fsm))
    assert.near(1699999998, time:advance_to_timer(fsm), 1e-6)
    assert.same({ 1700000000, 999999998 }, { time() })
    assert.equal("root.a", leaf_after(fsm))
  end)

  it("stays where it is if no timer is armed, or one has expired", function()
    local fsm, time = on_clock { "e_after(3)" }
    time:advance(4)
    assert.equal(0, time:advance_to_timer(fsm))
    assert.equal("root.b", leaf_after(fsm))
    assert.is_nil(time:advance_to_timer(fsm))
    assert.equal(4, time:now())
  end)

  it("goes to the timers of regions", function()
    local fsm, time = on_clock({ "e_in" },
      { b = rfsm.seqand { idle_doo = "auto", sub = chart { "e_after(0.5)" } } })
    helper.post_and_run(fsm, "e_in")
    assert.equal(0.5 + 1e-9, time:advance_to_timer(fsm))
    rfsm.run(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm.b.substates.sub))
  end)

  it("may serve several machines, also those of one model", function()
    local model = chart({ "e_after(1)" }, { gettime = simulated() })
    local one, other = started(model), started(model)
    model.gettime:advance_to_timer(one)
    assert.same({ "root.b", "root.b" }, { leaf_after(one), leaf_after(other) })
  end)

  it("is copied with a machine", function()
    local fsm, time = on_clock { "e_after(1)" }
    local copy = helper.copy_of(fsm)
    time:advance(2)
    assert.same({ "root.b", "root.a" }, { leaf_after(fsm), leaf_after(copy) })
    copy.gettime:advance(2)
    assert.equal("root.b", leaf_after(copy))
  end)

  it("may be that of the process", function()
    local fsm, time = started(chart { "e_after(1)" }), simulated { now = 1000 }
    set_gettime_hook(time)
    assert.equal(1 + 1e-9, time:advance_to_timer(fsm))
    assert.equal("root.b", leaf_after(fsm))
  end)

  -- What is called, and the error, which blames the caller.
  for _, case in ipairs {
    { call = function(f) return helper.refusal(f.advance, f, "5") end,
      problem = "rfsm.clock.advance: finite number of seconds expected, "
        .. "got string '5'" },
    { call = function(f) return helper.refusal(f.advance, f, 0 / 0) end,
      problem = "rfsm.clock.advance: finite number of seconds expected, "
        .. "got number nan" },
    { call = function(f) return helper.refusal(f.advance, f) end,
      problem = "rfsm.clock.advance: finite number of seconds expected, got nil" },
    { call = function(f) return helper.refusal(f.advance, 5) end,
      problem = "rfsm.clock.advance: simulated clock expected, got number 5" },
    { call = function(f) return helper.refusal(f.now) end,
      problem = "rfsm.clock.now: simulated clock expected, got nil" },
    { call = function(f) return helper.refusal(f.advance_to_timer, f, {}) end,
      problem = "rfsm.clock.advance_to_timer: initialised fsm expected, got table" },
    { call = function(f)
      return helper.refusal(f.advance_to_timer, f, (started(chart { "e_after(1)" })))
    end, problem = "rfsm.clock.advance_to_timer: the machine reads another clock" },
    { call = function() return helper.refusal(simulated, { now = "noon" }) end,
      problem = "rfsm.clock.simulated: now: finite number of seconds expected, "
        .. "got string 'noon'" },
    { call = function() return helper.refusal(simulated, { start = 5 }) end,
      problem = "rfsm.clock.simulated: { now = 0 } expected" },
    { call = function() return helper.refusal(simulated, 5) end,
      problem = "rfsm.clock.simulated: { now = 0 } expected" },
  } do
    it("refuses anything else: " .. case.problem, function()
      local time = simulated { now = 7 }
      assert.equal(case.problem, (case.call(time):gsub("%-?nan$", "nan")))
      assert.equal(7, time:now())
    end)
  end
end)

describe("the cost of an iteration", function()
  local function reads(fsm, time)
    local count = 0
    set_gettime_hook(function()
      count = count + 1
      return unpack(time or { 1000, 0 })
    end)
    count = 0 -- it was tried
    rfsm.step(fsm)
    return count
  end

  it("is nothing without time events", function()
    local fsm = started(chart { "e_x" })
    assert.same({ 0 }, { reads(fsm), fsm._timeevent, fsm.a._timers })
  end)

  it("is one reading of a clock that wants an id, and of one of nanoseconds",
    function()
      local count = 0
      for _, read in ipairs {
        function(id) return assert(id) and 1000, 0 end, function() return 1e15 end,
      } do
        local fsm = started(chart({ "e_after(1)" }, { gettime = function(id)
          count = count + 1
          return read(id)
        end }))
        count = 0
        rfsm.step(fsm)
        assert.equal(1, count)
      end
    end)

  it("is one reading, also when a timer is due or has expired", function()
    local model = chart { "e_after(1)", "e_after(9.9)" }
    model[2].guard = closed
    local fsm = started(model)
    check(fsm, "+2=a")
    for _, nsec in ipairs { 898000000, 899500000, 900000001 } do
      now = { 1009, nsec }
      assert.equal(1, reads(fsm, now))
    end
    assert.is_nil(next_deadline(fsm))
  end)

  it("with an entry is one reading more, for all its timers", function()
    local fsm, count = started(chart { "e_after(1)", "e_after(2)" }), 0
    check(fsm, "+2=b")
    fsm.gettime = function()
      count = count + 1
      return now[1], now[2]
    end
    check(fsm, "e_back=a +3=b") -- it has been tried now
    count = 0
    rfsm.send_events(fsm, "e_back")
    rfsm.step(fsm)
    assert.equal(1, count)
  end)

  it("is no reading of the clock while no timer is armed, one while one is", function()
    local fsm = started(chart { "e_after(1)" })
    assert.equal(1, reads(fsm))
    set_gettime_hook(clock)
    check(fsm, "+2=b")
    assert.equal(0, reads(fsm))
  end)
end)
