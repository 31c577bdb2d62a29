-- Time events, on a clock that the specs advance.

local helper = require "spec.helper"
local rfsm = require "rfsm"
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
  -- A circumstance, the events from a to b, moves and leaves, more members.
  for _, case in ipairs {
    { "comes when more time has passed", { "e_after(3)" }, "+3=a +0,1=b" },
    { "may be the only one, as a text", "e_after(3)", "+4=b" },
    { "stands beside others", { "e_x", "e_after(3)" }, "e_x=b" },
    { "is armed anew on each entry", { "e_after(1)" }, "+2=b e_back=a +1=a +0,1=b" },
    { "is armed anew by a self transition", { "e_after(2)" },
      "+1=a e_self=a +1=a +1,1=b" },
    { "for 0 seconds waits for the clock", { "e_after(0)" }, "=a =a =a +0,1=b" },
    { "comes first of several", { "e_after(5)", "e_after(2)", "e_at(9999)" },
      "+2=a +0,1=b" },
    { "waits longer if the clock jumps back", { "e_after(3)" },
      "+-500=a +503=a +0,1=b" },
    { "comes at a time", { "e_at(1010)" }, "+10=a +0,1=b" },
    { "whose time is past comes once an entry", { e_at(5) }, "=b e_back=b" },
    { "may have a callable table", { e_after(callable) }, "+1=a +0,1=b" },
    { "for math.huge seconds never comes",
      { e_after(function() return math.huge end) }, "+1e9=a" },
    { "for a negative number comes at once", { e_after(function() return -5 end) },
      "=a +0,1=b" },
    { "at the time that a function returns",
      { e_at(function() return now[1] + 5 end) }, "+5=a +0,1=b" },
    { "comes also if the function of another fails", { e_after(fail), "e_after(3)" },
      "+4=b" },
    { "may be that of the root", { "e_x" }, "+6=b",
      { [5] = another("root", "b", "e_after(5)") } },
    { "goes through connectors by the rules for all events", { "e_x" }, "+1=a +0,1=b",
      { k = conn {}, [5] = another("a", "k", "e_after(1)"),
        [6] = trans { src = "k", tgt = "b" } } },
    { "may be one of several, each with its transition", { "e_after(5)" }, "+3=c",
      { c = state {}, [5] = another("a", "c", "e_after(2)") } },
    { "of a composite goes on across inner transitions", { "e_after(10)" },
      "+6=x e_next=y +4=y +0,1=b", { a = inner() } },
  } do
    it(case[1], function()
      local model = chart(case[2], case[4])
      model[4], model.err = another("a", "a", "e_self"), false
      check(started(model), case[3])
    end)
  end

  -- The events as they are written, and as they are in the machine.
  for _, case in ipairs {
    { { "e_after(3)" }, { "e_after(3)@root.a" } },
    { { e_at(1010.5) }, { "e_at(1010.5)@root.a" } },
    { { e_after(closed, "patience") }, { "e_after(patience)@root.a" } },
    { { e_after(closed), e_after(fail) },
      { "e_after(function)@root.a", "e_after(function)#2@root.a" } },
  } do
    it("bears the name of its source: " .. case[2][1], function()
      local model = chart(case[1])
      model.err = false
      local first = case[1][1]
      assert.same(case[2], started(model)[2].events)
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
    { "0.1", 100000000 }, { "0.25", 250000000 }, { "0.9", 900000000 },
    { "1e-9", 1 }, { "0.000000001", 1 }, { ".5", 500000000 }, { "2.5e-1", 250000000 },
    { "0.3", 300000000 }, { "0.7", 700000000 }, { "0.123456789", 123456789 },
    { "0.999999999", 999999999 }, { "0.9999999996", 1000000000 }, { "3.", 3 * BILLION },
  } do
    for i, event in ipairs { ("e_after(%s)"):format(case[1]),
      e_after(tonumber(case[1])) } do
      it(("%s is exact to the nanosecond, as a %s"):format(tostring(event),
        type(event)), function()
        if i == 2 then now = { 1700000000, 999999999 } end
        check(started(chart { event }), ("+0,%d=a +0,1=b"):format(case[2]))
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
  for _, case in ipairs { -- how it fails, the function, the reason
    { "raises", fail, "out of order" },
    { "returns nil", function() end, expected .. "nil" },
    { "returns a string", function() return "3" end, expected .. "string" },
    { "returns NaN", function() return 0 / 0 end, expected .. "NaN" },
    { "returns a boolean", closed, expected .. "boolean" },
  } do
    it("that " .. case[1] .. " is reported to err", function()
      local fsm = init(chart { e_after(case[2], 7) })
      local errors = said(fsm, "err")
      rfsm.run(fsm)
      assert.same({ "TIMEEVENT error executing timeout of e_after(7)@root.a:  "
        .. case[3] }, errors)
    end)
  end
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
  end)
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
  -- What it may return: before a, and for a and for b after that, and the event.
  for _, case in ipairs {
    { "nanoseconds in one number", 1e-9, { 5999999999 }, { 6000000000 },
      { 6000000001 } },
    { "up to 2^53 of them", 1e-9, { 9007199 * BILLION - 1 }, -- where a / b rounds up
      { 9007199 * BILLION }, { 9007199 * BILLION + 1 } },
    { "a fraction in the first value", 0.25, { 10, 0 }, { 10.25, 0 }, { 10.5, 0 } },
    { "more nanoseconds than a second has", 2, { 0, 0 }, { 0, 2 * BILLION },
      { 0, 2 * BILLION + 1 } },
  } do
    it("may return " .. case[1], function()
      local time = case[3]
      set_gettime_hook(function() return unpack(time) end)
      local fsm = started(chart { e_after(case[2]) })
      time = case[4]
      check(fsm, "=a")
      time = case[5]
      check(fsm, "=b")
    end)
  end

  it("that wants a clock id is given one", function()
    local ids = {}
    set_gettime_hook(function(id)
      assert(type(id) == "string", "bad argument #1 to 'gettime'")
      ids[id] = true
      return now[1], now[2]
    end)
    check(started(chart { "e_after(3)", "e_at(2000)" }), "+3=a +0,1=b")
    assert.same({ CLOCK_MONOTONIC = true }, ids)
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
    { "a string", "12", nil }, { "NaN", 0 / 0, 0 }, { "infinity", 1, math.huge },
    { "nothing", nil, nil }, { "a table after a number", 1, {} },
  } do
    it("by returning " .. case[1] .. " is reported as such", function()
      local fsm, errors = with_clocks(clock, function() return case[2], case[3] end)
      rfsm.step(fsm)
      assert.matches("^TIMEEVENT the clock failed:  ", errors[1])
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
    helper.with(package.preload, preload, function()
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
    end)
    return table.concat(names, " ")
  end

  after_each(function() os.time = real_time end) -- luacheck: ignore 122

  -- A clock, the names or ids by which it is read for an e_after and an e_at, and the
  -- modules that are installed; `read` notes one.
  for _, case in ipairs {
    { "rtp, monotonic for e_after", "CLOCK_MONOTONIC CLOCK_REALTIME", function(read)
      return { rtp = { clock = { gettime = read } } }
    end },
    { "an rtp that knows no clock by name", "nil nil", function(read)
      return { rtp = { clock = { gettime = function(id)
        assert(id == nil, "number expected")
        return read("nil")
      end } } }
    end },
    { "luaposix, monotonic for e_after", "mono real", function(read)
      return { ["posix.time"] = {
        CLOCK_MONOTONIC = "mono", CLOCK_REALTIME = "real",
        clock_gettime = function(id) return { tv_sec = read(id), tv_nsec = 0 } end,
      } }
    end },
    { "an old luaposix", "monotonic realtime", function(read)
      return { posix = { clock_gettime = read } }
    end },
    { "luasocket", "socket socket", function(read)
      return { socket = { gettime = function() return (read("socket")) end } }
    end },
    { "os.time", "os os", function(read)
      os.time = function() return (read("os")) end -- luacheck: ignore 122
      return {}
    end },
    { "the next one after one that fails", "socket socket", function(read)
      return { posix = { clock_gettime = function() error("no such clock") end },
        socket = { gettime = function() return (read("socket")) end } }
    end },
  } do
    it("the clock is " .. case[1], function()
      assert.equal(case[2], clocks_read(case[3]))
    end)
  end
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
    { "is nil when nothing is armed", { "e_x" }, 0, nil },
    { "is the time until the earliest can fire",
      { "e_after(3)", "e_after(0.5)", "e_at(1002)" }, 0, 0.5 + 1e-9 },
    { "shrinks as time passes", { "e_after(3)" }, 2.75, 0.25 + 1e-9 },
    { "is 0 when a timer has expired", { "e_after(3)" }, 4, 0 },
  } do
    it(case[1], function()
      local fsm = started(chart(case[2]))
      advance(math.floor(case[3]), case[3] % 1 * BILLION)
      assert.equal(case[4], next_deadline(fsm))
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

  it("counts the timers of machines in an active state's .substates", function()
    local sub, fsm = started(chart { "e_after(3)" }), started(chart { "e_after(5)" })
    fsm.a.substates = { sub = sub }
    assert.equal(3 + 1e-9, next_deadline(fsm))
  end)
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
    { "of a transition from an active state arms its timer then",
      { { another("a", "b", "e_after(2)") } }, "+2=a +0,1=b" },
    { "of a transition from an inactive state arms it on entry",
      { { another("b", "a", "e_after(2)") } }, "+5=a e_x=b +2=b +0,1=a" },
    { "of a composite arms the timers in it", {
      { state { x = state {}, y = state {}, trans { src = "initial", tgt = "x" },
        another("x", "y", "e_after(1)") }, "c" },
      { another("a", "c", "e_in") },
    }, "e_in=x +2=y" },
  } do
    it(case[1], function()
      local fsm = started(chart { "e_x" })
      for _, merged in ipairs(case[2]) do
        assert.is_true(rfsm.fsm_merge(fsm, fsm, merged[1], merged[2]))
      end
      check(fsm, case[3])
    end)
  end
end)

describe("the cost of an iteration", function()
  local function reads(fsm)
    local count = 0
    set_gettime_hook(function()
      count = count + 1
      return 1000, 0
    end)
    count = 0 -- it was tried
    rfsm.step(fsm)
    return count
  end

  it("is nothing without time events", function()
    local fsm = started(chart { "e_x" })
    assert.same({ 0 }, { reads(fsm), fsm._timeevent, fsm.a._timers })
  end)

  it("is no reading of the clock while no timer is armed, one while one is", function()
    local fsm = started(chart { "e_after(1)" })
    assert.equal(1, reads(fsm))
    set_gettime_hook(clock)
    check(fsm, "+2=b")
    assert.equal(0, reads(fsm))
  end)
end)
