-- Time events, on a clock that the specs advance.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local timeevent = require "rfsm_timeevent"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn
local e_after, e_at = timeevent.e_after, timeevent.e_at

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local BILLION = 1000000000
local now -- what the clock says: { sec, nsec }

local function advance(sec, nsec)
  local total = now[2] + (nsec or 0)
  local carry = math.floor(total / BILLION)
  now[1], now[2] = now[1] + sec + carry, total - carry * BILLION
end

local function clock() return now[1], now[2] end

-- (initial) -> a --events--> b --e_back--> a
local function chart(events)
  return state {
    warn = false, info = false, a = state {}, b = state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = events },
    trans { src = "b", tgt = "a", events = { "e_back" } },
  }
end

-- The machine of a chart, after its first run.
local function started(model)
  local fsm = helper.init(model)
  rfsm.run(fsm)
  return fsm
end

-- Runs, and says where that led.
local function active_after(fsm, sec, nsec)
  advance(sec, nsec)
  rfsm.run(fsm)
  return fsm._act_leaf._id
end

local function leaf(fsm) return fsm._act_leaf._id end

-- Collects what `fsm` hands to the printer `name`, words joined.
local function said(fsm, name, id)
  local lines = {}
  fsm[name] = function(...)
    if id and (...) ~= id then return end
    local texts = { ... }
    for i = 1, #texts do texts[i] = tostring(texts[i]) end
    lines[#lines + 1] = table.concat(texts, " ")
  end
  return lines
end

before_each(function()
  now = { 1000, 0 }
  timeevent.set_gettime_hook(clock)
end)

-- Moves a machine: "+3" three seconds later, "+0,1" a nanosecond later, "e_x" with that
-- event; "=b" is the leaf that is active then.
local function check_story(fsm, story)
  for move, expected in story:gmatch("(%S*)=(%S+)") do
    local sec, nsec = move:match("^%+([^,]+),?(%d*)$")
    if sec then advance(tonumber(sec), tonumber(nsec)) end
    if sec or move == "" then rfsm.run(fsm) else helper.post_and_run(fsm, move) end
    assert.equal(expected, leaf(fsm), story .. ": " .. move)
  end
end

local function fail() error("out of order", 0) end

describe("a time event", function()
  local callable = setmetatable({}, { __call = function() return 1 end })
  -- A circumstance, the events from a to b, moves and leaves.
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
    { "comes also if the function of another fails", { e_after(fail), "e_after(3)" },
      "+4=b" },
  } do
    it(case[1], function()
      local model = chart(case[2])
      model[4] = trans { src = "a", tgt = "a", events = { "e_self" } }
      model.err = false
      check_story(started(model), case[3])
    end)
  end
end)

describe("e_after", function()
  it("is acted on in the step call that finds it expired", function()
    local fsm = started(chart { "e_after(3)" })
    advance(4)
    rfsm.step(fsm)
    assert.equal("b", leaf(fsm))
  end)

  it("bears the name of the source", function()
    local fsm = started(chart { "e_after(3)" })
    assert.same({ "e_after(3)@root.a" }, fsm[2].events)
  end)

  it("leaves the model as it is", function()
    local model = chart { "e_after(3)" }
    started(model)
    assert.same({ "e_after(3)" }, model[2].events)
  end)

  it("reaches the effect by its name", function()
    local model, seen = chart { "e_after(3)" }, nil
    model[2].effect = function(_, _, _, events) seen = events end
    active_after(started(model), 4)
    assert.same({ "e_after(3)@root.a" }, seen)
  end)

  it("fires once per entry, also when a guard inhibits", function()
    local model, asked = chart { "e_after(1)" }, 0
    model[2].guard = function()
      asked = asked + 1
      return false
    end
    local fsm = started(model)
    active_after(fsm, 2)
    active_after(fsm, 2)
    assert.equal(1, asked)
  end)

  it("is disarmed when its state is left", function()
    local model = chart { "e_x" }
    model[4] = trans { src = "a", tgt = "b", events = { "e_after(1)" } }
    local fsm = started(model)
    helper.post_and_run(fsm, "e_x")
    assert.is_nil(timeevent.next_deadline(fsm))
  end)

  it("is armed before the entry of the state", function()
    local armed
    local model = chart { "e_after(2)" }
    model.a.entry = function(fsm) armed = timeevent.next_deadline(fsm) end
    started(model)
    assert.equal(2 + 1e-9, armed)
  end)

  it("leaves the arguments of entry and exit alone", function()
    local trace = {}
    local function note(fsm, self, what)
      trace[#trace + 1] = what .. " " .. self._fqn .. " " .. fsm._id
    end
    local model = chart { "e_after(2)" }
    model.a.entry, model.a.exit = note, note
    active_after(started(model), 3)
    assert.same({ "entry root.a root", "exit root.a root" }, trace)
  end)

  it("stays when a tool replaces entry and exit of a live machine", function()
    local fsm = helper.init(chart { "e_after(2)" })
    fsm.a.entry, fsm.a.exit = function() end, function() end
    rfsm.run(fsm)
    assert.equal("b", active_after(fsm, 3))
  end)

  it("fires in a root of its own", function()
    local model = chart { "e_x" }
    model[4] = trans { src = "root", tgt = "b", events = { "e_after(5)" } }
    local fsm = started(model)
    assert.equal("b", active_after(fsm, 6))
  end)

  it("goes through connectors by the rules for all events", function()
    local model = state {
      a = state {}, b = state {}, k = conn {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "k", events = { "e_after(1)" } },
      trans { src = "k", tgt = "b" },
    }
    assert.equal("b", active_after(started(model), 2))
  end)
end)

describe("the timer of a composite", function()
  -- (initial) -> c[ (initial) -> x --e_next--> y ] --e_after(10)--> out
  local function composite()
    return state {
      c = state {
        x = state {}, y = state {},
        trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "y", events = { "e_next" } },
      },
      out = state {},
      trans { src = "initial", tgt = "c" },
      trans { src = "c", tgt = "out", events = { "e_after(10)" } },
    }
  end

  it("runs across inner transitions", function()
    local fsm = started(composite())
    advance(6)
    helper.post_and_run(fsm, "e_next")
    assert.equal("y", active_after(fsm, 4))
    assert.equal("out", active_after(fsm, 0, 1))
  end)

  it("has the name of the composite", function()
    assert.same({ "e_after(10)@root.c" }, started(composite())[2].events)
  end)
end)

describe("many timers", function()
  it("may belong to one state, each with its transition", function()
    local model = chart { "e_after(5)" }
    model.c = state {}
    model[4] = trans { src = "a", tgt = "c", events = { "e_after(2)" } }
    assert.equal("c", active_after(started(model), 3))
  end)

  it("that expire together come in the order of their times, then as declared",
    function()
      local model, seen = chart { "e_after(3)", "e_after(1)", "e_at(1001)" }, nil
      model[2].effect = function(_, _, _, events) seen = events end
      active_after(started(model), 9)
      assert.same({
        "e_after(1)@root.a", "e_after(3)@root.a", "e_at(1001)@root.a",
      }, seen)
    end)

  it("with one name at one source are one timer", function()
    local model, seen = chart { "e_after(1)" }, nil
    model[4] = trans {
      src = "a", tgt = "b", events = { "e_after(1)" }, pn = 1,
      effect = function(_, _, _, events) seen = events end,
    }
    active_after(started(model), 2)
    assert.same({ "e_after(1)@root.a" }, seen)
  end)

  it("fire in the order of their times, whatever the order of arming", function()
    local delays, model = {}, chart { "e_x" }
    for i = 1, 200 do delays[i] = (i * 73) % 199 + 1 end
    for i = 1, 200 do
      model[i + 3] = trans { src = "a", tgt = "a", guard = function() return false end,
        events = { ("e_after(%d)"):format(delays[i]) } }
    end
    local fsm = started(model)
    local fired = said(fsm, "dbg", "TIMEEVENT")
    for _ = 1, 200 do active_after(fsm, 1, 1) end
    local expected = {}
    for i = 1, 199 do expected[i] = ("TIMEEVENT e_after(%d)@root.a"):format(i) end
    assert.same(expected, fired)
  end)

  it("are disarmed one by one from the middle without disturbing the rest", function()
    -- two states side by side in a composite: the inner one's timers go, the outer stay
    local model = state {
      c = state {
        x = state {}, y = state {},
        trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "y", events = { "e_next" } },
      },
      trans { src = "initial", tgt = "c" },
    }
    for i = 1, 40 do
      local owner = i % 2 == 0 and "c" or ".c.x"
      model[i + 1] = trans { src = owner, tgt = owner, pn = -1,
        guard = function() return false end, events = { e_after((i * 17) % 41) } }
    end
    local fsm = started(model)
    helper.post_and_run(fsm, "e_next")
    local fired = said(fsm, "dbg", "TIMEEVENT")
    active_after(fsm, 100)
    local expected = {}
    for delay = 1, 40 do
      local i = (delay * 29) % 41 -- 17 * 29 = 1 modulo 41
      if i % 2 == 0 then
        expected[#expected + 1] = ("TIMEEVENT e_after(%d)@root.c"):format(delay)
      end
    end
    assert.same(expected, fired)
  end)
end)

describe("a fraction of a second", function()
  -- T as written, and the nanoseconds that it is.
  local FRACTIONS = {
    { "0.1", 100000000 }, { "0.25", 250000000 }, { "0.9", 900000000 },
    { "1e-9", 1 }, { "0.000000001", 1 }, { ".5", 500000000 }, { "2.5e-1", 250000000 },
    { "0.3", 300000000 }, { "0.7", 700000000 }, { "0.123456789", 123456789 },
    { "0.999999999", 999999999 }, { "0.9999999996", 1000000000 }, { "3.", 3 * BILLION },
  }
  for _, fraction in ipairs(FRACTIONS) do
    local text, ns = fraction[1], fraction[2]

    it("in e_after(" .. text .. ") is exact to the nanosecond", function()
      local fsm = started(chart { "e_after(" .. text .. ")" })
      assert.equal("a", active_after(fsm, 0, ns))
      assert.equal("b", active_after(fsm, 0, 1))
    end)

    it("in the object e_after(" .. text .. ") is exact to the nanosecond", function()
      now = { 1700000000, 999999999 }
      local fsm = started(chart { e_after(tonumber(text)) })
      assert.equal("a", active_after(fsm, 0, ns))
      assert.equal("b", active_after(fsm, 0, 1))
    end)
  end

  it("of an absolute time is exact in text, however late", function()
    local fsm = started(chart { "e_at(1700000000.123456789)" })
    now = { 1700000000, 123456789 }
    assert.equal("a", active_after(fsm, 0))
    assert.equal("b", active_after(fsm, 0, 1))
  end)
end)

describe("a day of timers in milliseconds", function()
  it("in a row drifts by nothing", function()
    -- each entry arms one millisecond; the clock advances by one and a nanosecond
    local model, count = chart { "e_x" }, 0
    model[4] = trans { src = "a", tgt = "a", events = { "e_after(0.001)" },
      effect = function() count = count + 1 end }
    local fsm = started(model)
    for _ = 1, 20000 do
      advance(0, 1000000)
      rfsm.step(fsm)
      advance(0, 1)
      rfsm.step(fsm, 2)
    end
    assert.equal(20000, count)
    assert.same({ 1020, 20000 }, now)
  end)

  it("fires each of a thousand at its millisecond", function()
    -- 1,000 timers spread over the day, each found at its millisecond and not before
    local model = chart { "e_x" }
    for i = 1, 1000 do
      model[i + 3] = trans { src = "a", tgt = "a", guard = function() return false end,
        events = { ("e_after(%d.%03d)"):format(math.floor(i * 86400 / 1000),
          i * 86400 % 1000) } }
    end
    local fsm, late = started(model), 0
    local fired = said(fsm, "dbg", "TIMEEVENT")
    for i = 1, 1000 do
      now = { 1000 + math.floor(i * 86400 / 1000), (i * 86400) % 1000 * 1000000 }
      rfsm.run(fsm)
      if #fired ~= i - 1 then late = late + 1 end
      advance(0, 1)
      rfsm.run(fsm)
      if #fired ~= i then late = late + 1 end
    end
    assert.equal(0, late)
  end)
end)

describe("e_at", function()
  it("has a name like e_after", function()
    assert.same({ "e_at(1010.5)@root.a" }, started(chart { e_at(1010.5) })[2].events)
  end)
end)

describe("a timeout function", function()
  it("is called with its id at each entry", function()
    local ids = {}
    local fsm = started(chart { e_after(function(id)
      ids[#ids + 1] = id
      return 1
    end, "patience") })
    active_after(fsm, 2)
    helper.post_and_run(fsm, "e_back")
    assert.same({ "patience", "patience" }, ids)
  end)

  it("says how long this entry waits", function()
    local delay = 2
    local fsm = started(chart { e_after(function() return delay end) })
    assert.equal("b", active_after(fsm, 2, 1))
    delay = 0.5
    helper.post_and_run(fsm, "e_back")
    assert.equal("b", active_after(fsm, 0, 500000001))
  end)

  it("says at which time, in e_at", function()
    local fsm = started(chart { e_at(function() return now[1] + 5 end) })
    assert.equal("a", active_after(fsm, 5))
    assert.equal("b", active_after(fsm, 0, 1))
  end)

  it("gives the event its id as a name", function()
    local fsm = started(chart { e_after(function() return 1 end, "patience") })
    assert.same({ "e_after(patience)@root.a" }, fsm[2].events)
  end)

  it("without an id has a name of its own beside another", function()
    local fsm = started(chart {
      e_after(function() return 1 end), e_after(function() return 2 end),
    })
    assert.same({ "e_after(function)@root.a", "e_after(function)#2@root.a" },
      fsm[2].events)
  end)

  it("that fails goes to err", function()
    local fsm = helper.init(chart { e_after(fail, 7) })
    local errors = said(fsm, "err")
    rfsm.run(fsm)
    assert.same({
      "TIMEEVENT error executing timeout of e_after(7)@root.a:  out of order",
    }, errors)
  end)

  for _, case in ipairs {
    { "nil", nil }, { "string", "3" }, { "NaN", 0 / 0 }, { "boolean", false },
  } do
    it("that returns " .. case[1] .. " goes to err", function()
      local fsm = helper.init(chart { e_after(function() return case[2] end) })
      local errors = said(fsm, "err")
      rfsm.run(fsm)
      assert.same({ "TIMEEVENT error executing timeout of e_after(function)@root.a:  "
        .. "number of seconds expected, got " .. case[1] }, errors)
    end)
  end
end)

describe("a time event that is wrong", function()
  for _, text in ipairs {
    "e_after()", "e_after(x)", "e_after(3", "e_after(-1)", "e_after(1.2.3)",
    "e_after(.)", "e_after(0x10)", "e_after(inf)", "e_at(now)", "e_after(3) s",
  } do
    it("is a plain event and a warning: " .. text, function()
      local model, warnings = chart { "e_x", text }, {}
      model.warn = function(line) warnings[#warnings + 1] = line end
      local fsm = started(model)
      assert.equal("WARNING: root.trans[2].events (a -> b): '" .. text
        .. "': seconds expected, as in " .. text:match("^e_%a+") .. "(0.5)",
        helper.without_file(warnings[1]))
      helper.post_and_run(fsm, text)
      assert.equal("b", leaf(fsm))
    end)
  end

  it("as an object blames the caller", function()
    local _, text = pcall(function() return (e_after("3")) end)
    assert.matches("timeevent_spec.lua:%d+: rfsm_timeevent.e_after: seconds, a number "
      .. "not below 0, or a function expected, got string", text)
  end)

  it("as an object is neither negative nor NaN", function()
    assert.is_false((pcall(e_after, -1)))
    assert.is_false((pcall(e_at, 0 / 0)))
  end)

  it("at a connector brings a warning, since nothing arms it", function()
    local model, said_lines = chart { "e_x" }, {}
    model.warn = function(text) said_lines[#said_lines + 1] = text end
    model[1].events = { "e_init_fsm", "e_after(1)" }
    rfsm.init(model)
    assert.equal("WARNING: root.trans[1].events (initial -> a): 'e_after(1)' never "
      .. "fires here, 'root.initial' is no state", helper.without_file(said_lines[1]))
  end)
end)

describe("is_timeevent", function()
  for _, case in ipairs {
    { "e_after(1)", true }, { "e_at(2.5)", true }, { "e_after(1)@root.a", true },
    { e_after(1), true }, { e_at(print), true }, { "e_x", false },
    { "e_after", false },
    { "e_after(x)", false }, { 7, false }, { {}, false }, { print, false },
  } do
    it("is " .. tostring(case[2]) .. " for a " .. type(case[1]) .. ": "
      .. tostring(case[1]):gsub("[:x].*", ""), function()
      assert.equal(case[2], timeevent.is_timeevent(case[1]))
    end)
  end

  it("is false for nil", function() assert.is_false(timeevent.is_timeevent(nil)) end)
end)

describe("the gettime hook", function()
  it("may return nanoseconds in one number", function()
    local ns = 5 * BILLION + 999999999
    timeevent.set_gettime_hook(function() return ns end)
    local fsm = started(chart { "e_after(0.000000001)" })
    ns = ns + 1
    rfsm.run(fsm)
    assert.equal("a", leaf(fsm))
    ns = ns + 1
    rfsm.run(fsm)
    assert.equal("b", leaf(fsm))
  end)

  it("is exact for nanoseconds up to 2^53", function()
    local ns = 9007199 * BILLION - 1 -- where a / b rounds up to a whole number
    timeevent.set_gettime_hook(function() return ns end)
    local fsm = started(chart { "e_after(0.000000001)" })
    ns = ns + 1
    assert.equal("a", active_after(fsm, 0))
    ns = ns + 1
    assert.equal("b", active_after(fsm, 0))
  end)

  it("may return a fraction of a second in the first value", function()
    local sec = 10
    timeevent.set_gettime_hook(function() return sec, 0 end)
    local fsm = started(chart { "e_after(0.25)" })
    sec = 10.25
    assert.equal("a", active_after(fsm, 0))
    sec = 10.5
    assert.equal("b", active_after(fsm, 0))
  end)

  it("may return more nanoseconds than a second has", function()
    local nsec = 0
    timeevent.set_gettime_hook(function() return 0, nsec end)
    local fsm = started(chart { "e_after(2)" })
    nsec = 2 * BILLION + 1
    assert.equal("b", active_after(fsm, 0))
  end)

  it("that wants a clock id is given one", function()
    local ids = {}
    timeevent.set_gettime_hook(function(id)
      assert(type(id) == "string", "bad argument #1 to 'gettime'")
      ids[id] = true
      return now[1], now[2]
    end)
    local fsm = started(chart { "e_after(3)", "e_at(2000)" })
    assert.equal("a", active_after(fsm, 3))
    assert.equal("b", active_after(fsm, 0, 1))
    assert.same({ CLOCK_MONOTONIC = true }, ids)
  end)

  it("must be a function, and blames the caller", function()
    local _, text = pcall(function() timeevent.set_gettime_hook(5) end)
    assert.matches("timeevent_spec.lua:%d+: rfsm_timeevent.set_gettime_hook: function "
      .. "expected, got number", text)
  end)
end)

describe("a clock", function()
  local function broken() error("battery empty", 0) end

  describe("when it fails", function()
    it("is reported to err, and the step goes on", function()
      local fsm = started(chart { "e_after(3)" })
      local errors = said(fsm, "err")
      timeevent.set_gettime_hook(broken)
      rfsm.step(fsm)
      assert.same({ "TIMEEVENT the clock failed:  battery empty" }, errors)
    end)

    it("loses no armed timer", function()
      local fsm = started(chart { "e_after(3)" })
      fsm.err = false
      timeevent.set_gettime_hook(broken)
      rfsm.step(fsm)
      timeevent.set_gettime_hook(clock)
      assert.equal("b", active_after(fsm, 4))
    end)

    it("arms on entry what it can later, when it works again", function()
      timeevent.set_gettime_hook(broken)
      local fsm = helper.init(chart { "e_after(3)" })
      fsm.err = false
      rfsm.run(fsm)
      timeevent.set_gettime_hook(clock)
      rfsm.run(fsm)
      assert.equal("a", active_after(fsm, 3))
      assert.equal("b", active_after(fsm, 0, 1))
    end)

    it("arms nothing later for a state that was left meanwhile", function()
      timeevent.set_gettime_hook(broken)
      local model = chart { "e_after(3)", "e_x" }
      local fsm = helper.init(model)
      fsm.err = false
      rfsm.run(fsm)
      helper.post_and_run(fsm, "e_x")
      timeevent.set_gettime_hook(clock)
      rfsm.run(fsm)
      assert.is_nil(timeevent.next_deadline(fsm))
    end)

    it("still lets other events through", function()
      local fsm = started(chart { "e_after(3)", "e_x" })
      fsm.err = false
      timeevent.set_gettime_hook(broken)
      helper.post_and_run(fsm, "e_x")
      assert.equal("b", leaf(fsm))
    end)

    it("and err fails, too, raises that and loses nothing", function()
      local fsm = started(chart { "e_after(3)" })
      fsm.err = function() error("no printer", 0) end
      timeevent.set_gettime_hook(broken)
      assert.error_matches(function() rfsm.step(fsm) end, "no printer")
      timeevent.set_gettime_hook(clock)
      assert.equal("b", active_after(fsm, 4))
    end)

    for _, case in ipairs {
      { "a string", "12", nil }, { "NaN", 0 / 0, 0 }, { "infinity", 1, math.huge },
      { "nothing", nil, nil }, { "a table after a number", 1, {} },
    } do
      it("by returning " .. case[1] .. " is reported as such", function()
        local fsm = started(chart { "e_after(3)" })
        local errors = said(fsm, "err")
        timeevent.set_gettime_hook(function() return case[2], case[3] end)
        rfsm.step(fsm)
        assert.matches("^TIMEEVENT the clock failed:  ", errors[1])
      end)
    end
  end)
end)

describe("without a hook", function()
  local MODULES = { "rtp", "posix.time", "posix", "socket" }
  local real_time = os.time

  -- A fresh copy of core and extension, that finds only the clocks in `modules`.
  local function fresh(modules)
    local saved = {}
    for _, name in ipairs { "rfsm", "rfsm_timeevent", "rfsm.clock", unpack(MODULES) } do
      saved[name], package.loaded[name] = package.loaded[name] or false, nil
    end
    for _, name in ipairs(MODULES) do
      package.preload[name] = function() return modules[name] or error("none") end
    end
    local copy = { rfsm = require "rfsm", timeevent = require "rfsm_timeevent" }
    return copy, function()
      for name, module in pairs(saved) do -- any order
        package.loaded[name] = module or nil
      end
      for _, name in ipairs(MODULES) do package.preload[name] = nil end
    end
  end

  -- Which clocks are read for an e_after and then for an e_at?
  local function clocks_read(make_modules)
    local names = {}
    local copy, restore = fresh(make_modules(function(name)
      names[#names + 1] = name
      return 5, 0
    end))
    local C = copy.rfsm
    local fsm = C.init(C.state {
      warn = false, info = false, a = C.state {}, b = C.state {},
      C.trans { src = "initial", tgt = "a" },
      C.trans { src = "a", tgt = "b", events = { "e_after(1)", "e_at(99)" } },
    })
    C.step(fsm)
    copy.timeevent.next_deadline(fsm) -- the clocks have been chosen now
    helper.clear(names)
    copy.timeevent.next_deadline(fsm)
    restore()
    return names
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
      assert.equal(case[2], table.concat(clocks_read(case[3]), " "))
    end)
  end
end)

describe("dbg", function()
  it("has a record TIMEEVENT with the name", function()
    local fsm = started(chart { "e_after(3)" })
    local records = said(fsm, "dbg", "TIMEEVENT")
    active_after(fsm, 4)
    assert.same({ "TIMEEVENT e_after(3)@root.a" }, records)
  end)

  it("that fails loses no event of the iteration", function()
    local fsm = started(chart { "e_after(1)", "e_after(2)" })
    fsm.dbg = function(id) if id == "TIMEEVENT" then error("no printer", 0) end end
    advance(5)
    assert.error_matches(function() rfsm.step(fsm) end, "no printer")
    assert.equal("b", leaf(fsm))
  end)
end)

describe("next_deadline", function()
  it("is nil when nothing is armed", function()
    local fsm = started(chart { "e_x" })
    assert.is_nil(timeevent.next_deadline(fsm))
  end)

  it("is nil before the first entry", function()
    assert.is_nil(timeevent.next_deadline(helper.init(chart { "e_after(1)" })))
  end)

  it("is the time until the earliest can fire", function()
    local fsm = started(chart { "e_after(3)", "e_after(0.5)", "e_at(1002)" })
    assert.equal(0.5 + 1e-9, timeevent.next_deadline(fsm))
  end)

  it("shrinks as time passes", function()
    local fsm = started(chart { "e_after(3)" })
    advance(2, 750000000)
    assert.equal(0.25 + 1e-9, timeevent.next_deadline(fsm))
  end)

  it("is 0 when a timer has expired", function()
    local fsm = started(chart { "e_after(3)" })
    advance(4)
    assert.equal(0, timeevent.next_deadline(fsm))
  end)

  it("slept through to the nanosecond finds the event, one less does not", function()
    local fsm = started(chart { "e_after(0.3)" })
    local ns = math.floor(timeevent.next_deadline(fsm) * BILLION + 0.5)
    assert.equal("a", active_after(fsm, 0, ns - 1))
    assert.equal("b", active_after(fsm, 0, 1))
  end)

  it("arms the timers that wait for a clock that works again", function()
    timeevent.set_gettime_hook(function() error("no") end)
    local fsm = helper.init(chart { "e_after(3)" })
    fsm.err = false
    rfsm.run(fsm)
    timeevent.set_gettime_hook(clock)
    assert.equal(3 + 1e-9, timeevent.next_deadline(fsm))
  end)

  it("raises while they wait for a clock that fails", function()
    timeevent.set_gettime_hook(function() error("battery empty", 0) end)
    local fsm = helper.init(chart { "e_after(3)" })
    fsm.err = false
    rfsm.run(fsm)
    assert.error_matches(function() timeevent.next_deadline(fsm) end,
      "rfsm_timeevent.next_deadline: the clock failed: battery empty")
  end)

  it("raises when the clock fails", function()
    local fsm = started(chart { "e_after(3)" })
    timeevent.set_gettime_hook(function() error("battery empty", 0) end)
    assert.error_matches(function() timeevent.next_deadline(fsm) end,
      "rfsm_timeevent.next_deadline: the clock failed: battery empty")
  end)

  it("blames the caller for what is no machine", function()
    local _, text = pcall(function() return (timeevent.next_deadline {}) end)
    assert.matches("timeevent_spec.lua:%d+: rfsm_timeevent.next_deadline: initialised "
      .. "fsm expected, got table", text)
  end)

  it("counts the timers of machines in an active state's .substates", function()
    local sub = started(chart { "e_after(3)" })
    local fsm = started(chart { "e_after(5)" })
    fsm.a.substates = { sub = sub }
    assert.equal(3 + 1e-9, timeevent.next_deadline(fsm))
  end)
end)

describe("two machines of one model", function()
  it("have timers of their own", function()
    local model = chart { e_after(3) }
    local first = started(model)
    advance(2)
    local second = started(model)
    assert.equal("b", active_after(first, 1, 1))
    rfsm.run(second)
    assert.equal("a", leaf(second))
  end)
end)

describe("reset", function()
  it("disarms all timers", function()
    local fsm = started(chart { "e_after(3)", "e_at(5000)" })
    rfsm.reset(fsm)
    assert.is_nil(timeevent.next_deadline(fsm))
  end)

  it("arms anew on the next entry", function()
    local fsm = started(chart { "e_after(3)" })
    advance(2)
    rfsm.reset(fsm)
    rfsm.run(fsm)
    assert.equal("a", active_after(fsm, 3))
    assert.equal("b", active_after(fsm, 0, 1))
  end)
end)

describe("fsm_merge", function()
  it("of a transition from an active state arms its timer then", function()
    local fsm = started(chart { "e_x" })
    local tr = trans { src = "a", tgt = "b", events = { "e_after(2)" } }
    assert.is_true(rfsm.fsm_merge(fsm, fsm, tr))
    assert.equal("a", active_after(fsm, 2))
    assert.equal("b", active_after(fsm, 0, 1))
  end)

  it("of a transition from an inactive state arms it on entry", function()
    local fsm = started(chart { "e_x" })
    local tr = trans { src = "b", tgt = "a", events = { "e_after(2)" } }
    assert.is_true(rfsm.fsm_merge(fsm, fsm, tr))
    advance(5)
    helper.post_and_run(fsm, "e_x")
    assert.equal("b", active_after(fsm, 2))
    assert.equal("a", active_after(fsm, 0, 1))
  end)

  it("of a composite arms the timers in it", function()
    local fsm = started(chart { "e_x" })
    local c = state {
      x = state {}, y = state {}, trans { src = "initial", tgt = "x" },
      trans { src = "x", tgt = "y", events = { "e_after(1)" } },
    }
    assert.is_true(rfsm.fsm_merge(fsm, fsm, c, "c"))
    assert.is_true(rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "c",
      events = { "e_in" } }))
    helper.post_and_run(fsm, "e_in")
    assert.equal("y", active_after(fsm, 2))
  end)
end)

describe("a machine without time events", function()
  it("has nothing of this extension", function()
    local fsm = started(chart { "e_x" })
    assert.is_nil(fsm._timeevent)
    assert.is_nil(fsm.a._timers)
  end)

  it("reads no clock", function()
    local reads = 0
    timeevent.set_gettime_hook(function()
      reads = reads + 1
      return 0, 0
    end)
    reads = 0 -- it was tried
    helper.post_and_run(started(chart { "e_x" }), "e_x")
    assert.equal(0, reads)
  end)
end)

describe("while no timer is armed", function()
  it("reads no clock", function()
    local fsm = started(chart { "e_after(1)" })
    active_after(fsm, 2)
    local reads = 0
    timeevent.set_gettime_hook(function()
      reads = reads + 1
      return 0, 0
    end)
    reads = 0 -- it was tried
    rfsm.run(fsm)
    assert.equal(0, reads)
  end)

  it("is still exact when the earliest one has gone", function()
    local fsm = started(chart { "e_after(3)", "e_x" })
    helper.post_and_run(fsm, "e_x")
    assert.is_nil(timeevent.next_deadline(fsm))
  end)
end)

describe("a timer that is pending", function()
  it("costs one reading of the clock in an iteration", function()
    local fsm, reads = started(chart { "e_after(1)" }), 0
    timeevent.set_gettime_hook(function()
      reads = reads + 1
      return 1000, 0
    end)
    reads = 0 -- it was tried
    rfsm.step(fsm)
    assert.equal(1, reads)
  end)
end)
