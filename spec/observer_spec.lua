-- Observers: charts that hear a machine, beside an exploration and a live machine. And
-- what properties may be about: words, flags that events switch, data by example.

local ab = require "spec.support.ab"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local share = require "spec.support.share"
require "rfsm_seqand"
require "rfsm_timeevent"

local state, chart = rfsm.state, ab.chart
local after, from, never = rfsm_checks.after, rfsm_checks.from, rfsm_checks.never
local always, precedes = rfsm_checks.always, rfsm_checks.precedes

-- A transition as that of `ab.go`; its line is known, as no tail call makes it.
local function go(src, tgt, event, fields)
  fields = fields or {}
  fields.src, fields.tgt = src, tgt
  fields.events = event ~= nil and { event } or nil
  local tr = rfsm.trans(fields)
  return tr
end

-- An observer that comes to `bad` if it hears these words in this order.
local function hearing(...)
  local model = { go("initial", "s1"), bad = state {} }
  for i, word in ipairs { ... } do
    model["s" .. i] = state {}
    local tgt = select(i + 1, ...) and "s" .. i + 1 or "bad"
    model[#model + 1] = go("s" .. i, tgt, word)
  end
  return rfsm_checks.observer(state(model))
end

local function judge(model, property, options)
  options = options or {}
  options.properties = { p = property }
  return rfsm_checks.explore(model, options).properties[1]
end

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

-- What a machine that is watched reports, while each list of events is sent and run.
local function watched(model, property, runs)
  local told = {}
  model.err = function(text) told[#told + 1] = text:match("^[^\n]*") end
  local fsm = rfsm.init(model)
  rfsm_checks.watch_properties(fsm, { p = property })
  for _, events in ipairs(runs) do
    rfsm.send_events(fsm, unpack(events))
    rfsm.run(fsm)
  end
  return #told, fsm, told[1]
end

describe("an observer", function()
  -- (initial) -> a --e_x--> b --e_x--> a
  local ORDER = { "e_x", "taken root.trans[2]", "exit root.a", "entry root.b", "step" }

  it("hears events, transitions, exits, entries and the end of a step, in this order",
    function()
    local judged = judge(chart(), hearing(unpack(ORDER)))
    assert.same({ false, 2 }, { judged.holds, #judged.witness })
    assert.equal(1, (watched(chart(), hearing(unpack(ORDER)), { {}, { "e_x" } })))
    for i = 1, #ORDER - 1 do
      local other = { unpack(ORDER) }
      other[i], other[i + 1] = other[i + 1], other[i]
      judged = judge(chart { [4] = go("b", "b", "e_y") }, hearing(unpack(other)))
      assert.is_true(judged.holds == false and #judged.witness > 2, judged.name)
    end
  end)

  it("is watched anew after a report", function()
    local count, fsm = watched(chart(), hearing("entry root.b"), { {}, { "e_x" } })
    assert.equal(1, count)
    rfsm.send_events(fsm, "e_x")
    rfsm.run(fsm)
    assert.equal(1, count)
    assert.equal(2, (watched(chart(), hearing "entry root.b", { {}, { "e_x" },
      { "e_x" }, { "e_x" } })))
  end)

  it("asks, at an event, what was active before it, and at a step what is active then",
    function()
    local function asking(word, when)
      return rfsm_checks.observer(state { free = state {}, bad = state {},
        go("initial", "free"), go("free", "bad", word, { when = when }) })
    end
    local model = chart { [3] = go("b", "a", "e_y") }
    for _, case in ipairs {
      { "e_x", { "root.b", "root.a" }, true }, { "e_y", "root.b", false },
      { nil, "root.b", false }, { nil, { "root.b", "root.a" }, true },
      { "entry root.b", "root.b", false }, { "exit root.a", "root.a", true },
      { "e_y", function(active) return active "root.b" end, false },
    } do
      local property = asking(case[1], case[2])
      assert.equal(case[3], judge(model, property).holds)
      assert.equal(case[3] and 0 or 1,
        (watched(model, property, { {}, { "e_x" }, { "e_y" } })))
    end
  end)

  it("hears `pass` in a composite that a step enters and leaves again", function()
    local model = chart { c = state { x = state {}, go("initial", "root.b") },
      [2] = go("a", "c", "e_x") }
    local passing = rfsm_checks.observer(state { free = state {}, bad = state {},
      go("initial", "free"), go("free", "bad", "pass", { when = "root.c" }) })
    assert.is_false(judge(model, passing).holds)
    assert.equal(1, (watched(model, passing, { {}, { "e_x" } })))
    assert.is_true(judge(chart(), hearing "pass").holds)
    for i, words in ipairs { { "entry root.c", "pass", "exit root.c", "step" },
      { "exit root.c", "pass" }, { "entry root.b", "pass" } } do
      local judged = judge(model, hearing(unpack(words)))
      assert.equal(i == 1, judged.holds == false and #judged.witness == 2)
      assert.equal(i > 1 and 0 or 1, (watched(model, hearing(unpack(words)),
        { {}, { "e_x" } })))
    end
    local property = after "exit root.c".never "root.c".until_ "e_x"
    assert.is_true(judge(model, property).holds)
    assert.equal(0, (watched(model, property, { {}, { "e_x" } })))
  end)

  it("hears `pass` in each state that a region of several steps has left again",
    function()
    local function model(steps)
      return chart { b = rfsm.seqand { step = steps, idle_doo = "auto", arm = state {
        info = false, warn = false, x = state {}, y = state {}, z = state {},
        go("initial", "x"), go("x", "y", "e_y"), go("y", "z") } } }
    end
    for steps = 1, 2 do
      local property = after "e_y".never "root.b.arm.y".until_ "entry root.b.arm.z"
      local runs = { {}, { "e_x" }, { "e_y" } }
      assert.is_false(judge(model(steps), property).holds)
      assert.equal(1, (watched(model(steps), property, runs)))
      assert.is_false(judge(model(steps), never "root.b.arm.y").holds)
      assert.equal(1, (watched(model(steps), never "root.b.arm.y", runs)))
      assert.equal(steps == 1, judge(model(steps), hearing "pass").holds)
    end
  end)

  it("hears regions, and events that only they make", function()
    local function region(seconds)
      return state { info = false, warn = false, x = state {}, y = state {},
        go("initial", "x"), go("x", "y", seconds and "e_after(1)" or "e_r"),
        go("y", "x", "e_s") }
    end
    local function model()
      return chart { b = rfsm.seqand { idle_doo = "auto", left = region(),
        right = region(true) }, [4] = go("b", "b", "e_again") }
    end
    local words = hearing("entry root.b.left.y", "exit root.b.left.y")
    local judged = judge(model(), words)
    assert.is_false(judged.holds)
    assert.equal(1, (watched(model(), words, { {}, { "e_x" }, { "e_r" }, { "e_s" } })))
    assert.is_true(judge(model(), hearing("entry root.b.left.y"),
      { alphabet = { "e_x" } }).holds)
    assert.is_false(judge(model(), hearing "e_after(1)@root.x").holds)
    assert.is_false(judge(model(), hearing "taken root.b.right.trans[2]").holds)
  end)

  it("hears an event from outside once that has the name of a region's own", function()
    local function model()
      return chart { b = rfsm.seqand { idle_doo = "auto", arm = state { info = false,
        warn = false, c = state { x = state {}, go("initial", "x") },
        go("initial", "c"), go("c", "c", "e_done@root.c") } } }
    end
    local words = { "e_x", "e_done@root.c", "e_done@root.c" }
    assert.equal(4, #judge(model(), hearing(unpack(words)), { together = 1 }).witness)
    local runs = { {}, { "e_x" }, { "e_done@root.c" } }
    assert.equal(0, (watched(model(), hearing(unpack(words)), runs)))
    runs[4] = runs[3]
    assert.equal(1, (watched(model(), hearing(unpack(words)), runs)))
  end)

  it("hears events with data by their names, and e_done of states", function()
    local function model() return chart { [2] = go("a", "b", rfsm.named "e_data") } end
    for _, word in ipairs { "e_data", rfsm.named "e_data", "e_done@root.b" } do
      assert.is_false(judge(model(), hearing(word)).holds)
      assert.equal(1, (watched(model(), hearing(word), { {},
        { { name = "e_data", n = 3 } } })))
    end
  end)

  local function observer(members)
    local model = { free = state {}, bad = state {}, go("initial", "free") }
    for key, value in pairs(members) do model[key] = value end -- any order: a set
    return rfsm_checks.observer(state(model))
  end

  -- What is wrong, the members of the chart, and the problem.
  local WRONG = {
    { "an event that never comes", { [2] = go("free", "bad", "e_y") },
      "root.trans[2] (free -> bad): no transition of the machine names 'e_y' (did you "
      .. "mean 'e_x'?)" },
    { "a state that is not there", { [2] = go("free", "bad", "entry root.c") },
      "root.trans[2] (free -> bad): no state is named 'root.c' (did you mean "
      .. "'root.a'?)" },
    { "a field that is misspelt", { [2] = go("free", "bad", nil, { whn = "root.a" }) },
      "root.trans[2] (free -> bad): no field is named 'whn' (did you mean 'when'?)" },
    { "no way to bad", { [2] = go("free", "internal", "e_x") },
      "root: no transition leads to the leaf 'bad'" },
    { "a transition that is not there",
      { [2] = go("free", "bad", "taken root.trans[9]") },
      "root.trans[2] (free -> bad): no transition is named 'root.trans[9]' (did you "
      .. "mean 'root.trans[1]'?)" },
    { "a condition on what is not there", { [2] = go("free", "bad", nil,
      { when = "root.c" }) }, "root.trans[2] (free -> bad): when: no state" },
    { "two conditions, one of them on what is not there", { [2] = go("free", "bad", nil,
      { when = { "root.b", "root.c" } }) },
      "root.trans[2] (free -> bad): when: no state" },
    { "a time event", { [2] = go("free", "bad", "e_after(2)") },
      "root.trans[2] (free -> bad): an observer has no timers (say "
      .. "`.within(seconds)`)" },
    { "a guard", { [2] = go("free", "bad", "e_x", { guard = print }) }, "root.trans[2] "
      .. "(free -> bad): an observer has no guard (a transition may have a condition, "
      .. "when = ...)" },
    { "an entry", { free = state { entry = print } }, "root.free: an observer has no "
      .. "entry (a transition may have a condition, when = ...)" },
    { "no leaf `bad`", { bad = state { x = state {}, go("initial", "x") } },
      "root: no leaf of the observer is named 'bad'" },
    { "regions", { free = rfsm.seqand { chart() } }, "root.free: an observer has no "
      .. "regions" },
  }
  for _, case in ipairs(WRONG) do
    it("with " .. case[1] .. " is refused in one line, in its file", function()
      for _, f in ipairs { judge, watched } do
        local ok, text = pcall(f, chart(), observer(case[2]), {})
        assert.is_false(ok)
        assert.matches("^spec/%S+%.lua:%d+: ", text)
        local problem = text:gsub("^spec/%S+%.lua:%d+: ", "")
        assert.equal(case[3], problem:sub(1, #case[3]))
        assert.is_nil(text:find("\n"))
      end
    end)
  end

  it("has to be a state", function()
    local ok, text = pcall(function() return (rfsm_checks.observer(7)) end)
    assert.is_false(ok)
    assert.matches("observer_spec.lua:%d+: rfsm_checks.observer: state expected, got "
      .. "7$", text)
  end)

  it("hears an event from outside that only the alphabet names", function()
    assert.is_false(judge(chart(), hearing "e_far", { alphabet = { "e_x", "e_far" } })
      .holds)
    assert.is_true(judge(chart(), hearing "e_x", { alphabet = {} }).holds)
  end)
end)

describe("a word", function()
  -- A pump: (initial) -> off --e_on--> on --e_off--> off, and on --e_leak--> dry
  -- --e_fill--> on
  local function pump(members)
    local model = { info = false, warn = false, off = state {}, on = state {},
      dry = state {}, go("initial", "off"), go("off", "on", "e_on"),
      go("on", "off", "e_off"), go("on", "dry", "e_leak"), go("dry", "on", "e_fill"),
      go("dry", "off", "e_off") }
    for key, value in pairs(members or {}) do model[key] = value end -- any order: a set
    return state(model)
  end

  local HELD = { [7] = go("dry", "on", "e_on") } -- on without a filling
  local UNTIL = after "e_leak".never "root.on".until_ "e_fill"
  local SINCE = precedes("e_fill", "root.on").since "e_leak"

  -- A property, its text, and does it hold of the pump; and a run that breaks it.
  local CASES = {
    { UNTIL, "after e_leak never root.on until e_fill", false, { { "e_on" },
      { "e_leak" }, { "e_off" }, { "e_on" } } },
    { after "e_leak".never "root.on".until_ { "root.off" },
      "after e_leak never root.on until root.off", false, { { "e_on" }, { "e_leak" },
      { "e_fill" } } },
    { from "root.on".after "e_leak".never "root.off".until_ "root.on",
      "from root.on after e_leak never root.off until root.on", false, { { "e_on" },
      { "e_leak" }, { "e_off" } } },
    { from "root.off".after "e_leak".never "root.dry".until_ "e_leak",
      "from root.off after e_leak never root.dry until e_leak", true },
    { from "root.off".after "e_leak".reach "root.off",
      "from root.off after e_leak reach root.off", true },
    { from "root.on".after "e_leak".reach "root.off",
      "from root.on after e_leak reach root.off", false, { { "e_on" }, { "e_leak" } } },
    { from "root.on".after "e_leak".leads_to "root.off",
      "from root.on after e_leak leads to root.off", false },
    { never "root.on".since "e_leak", "after e_leak never root.on", false,
      { { "e_on" }, { "e_leak" }, { "e_fill" } } },
    { SINCE, "e_fill precedes root.on since e_leak", false, { { "e_on" } } },
    { precedes("e_on", "root.on").since "root.off",
      "e_on precedes root.on since root.off", true },
    { precedes("e_on", "root.on"), "e_on precedes root.on", true },
    { precedes("root.off", "e_on"), "root.off precedes e_on", true },
    { always "root.off".unless "e_on", "always root.off until e_on", true },
    { always "root.off".unless "root.dry", "always root.off until root.dry", false,
      { { "e_on" } } },
    { after "entry root.on".never "root.dry".until_ "exit root.on",
      "after entry root.on never root.dry until exit root.on", true },
    { after "entry root.dry".reach "root.off", "after entry root.dry reach root.off",
      false, { { "e_on" }, { "e_leak" } } },
    { rfsm_checks.at_most(1, "taken root.trans[4]").within(5),
      "at most 1 taken root.trans[4] within 5 s", false, { { "e_on" }, { "e_leak" },
      { "e_fill" }, { "e_leak" } } },
    { after "e_on".never "root.dry".within(2), "after e_on never root.dry within 2 s",
      false, { { "e_on" }, { "e_leak" } } },
  }
  for _, case in ipairs(CASES) do
    it(("'%s' %s"):format(case[2], case[3] and "holds" or "does not hold"), function()
      assert.equal(case[2], tostring(case[1]))
      local judged = judge(pump(), case[1], { together = 1 })
      assert.equal(case[3], judged.holds, tostring(judged))
      if not case[4] then return end
      local runs, now = { {}, unpack(case[4]) }, 0
      local model = pump { gettime = function() return now, 0 end }
      assert.equal(1, (watched(model, case[1], runs)))
    end)
  end

  -- What is given as an event, and the word that is meant.
  for _, case in ipairs {
    { "e_xx", "e_x" }, { "root.a", "entry root.a" }, { "a", "entry root.a" },
    { "Exit root.a", "exit root.a" }, { "taken trans[2]", "taken root.trans[2]" },
    { "e_done@root.aa", "e_done@root.a" },
  } do
    it("is the hint for '" .. case[1] .. "'", function()
      local hint = case[1] .. " (did you mean '" .. case[2] .. "'?)"
      local property = after(case[1]).reach "root.b"
      local ok, judged = pcall(judge, chart(), property)
      assert.matches(ok and "p: does not hold, no transition names " .. hint
        or "no transition names the event '" .. case[1] .. "'", tostring(judged), 1,
        true)
      local warned, model = {}, chart()
      model.warn = function(text) warned[#warned + 1] = text end
      rfsm_checks.watch_properties(rfsm.init(model), { p = property })
      assert.equal(1, #warned)
      assert.matches("property 'p': no transition names " .. hint, warned[1], 1, true)
    end)
  end

  it("of something that never begins holds vacuously", function()
    local judged = judge(pump { [4] = go("dry", "on", "e_leak") }, from "root.off"
      .after "e_leak".never "root.dry", { alphabet = {} })
    assert.same({ true, "e_leak never comes" }, { judged.holds, judged.vacuous })
    assert.is_nil(judge(pump(HELD), UNTIL).vacuous)
  end)

  it("has only the endings that it can have", function()
    local full = after "e_fill".reach "root.on".within(2)
    for text, property in pairs { -- any order: each stands alone
      ["'never root.on' has no 'until_', expected: since"] = never "root.on",
      ["'" .. tostring(full) .. "' has no 'until_', expected: nothing more"] = full,
    } do
      local ok, problem = pcall(function() return (property.until_ "e_fill") end)
      local place, rest = problem:match("^(spec/observer_spec.lua:)%d+: (.*)")
      assert.same({ false, "spec/observer_spec.lua:", "rfsm_checks: " .. text },
        { ok, place, rest })
    end
    local ok, problem = pcall(function() return (full.untill "e_fill") end)
    assert.is_false(ok)
    assert.matches("has no 'untill', expected: nothing more", problem, 1, true)
    assert.is_nil(full.other)
  end)

  it("behind a colon, in place of a dot, is refused", function()
    for where, f in pairs { -- any order: each stands alone
      ["after(...).reach"] = function() return (after "e":reach "root.on") end,
      ["never(...).since"] = function() return (never "root.on":since "e") end,
      ["from(...).after"] = function() return (from "root.on":after "e") end,
    } do
      local ok, problem = pcall(f)
      assert.is_false(ok)
      assert.matches(": rfsm_checks." .. where .. ": got a property (is there a colon "
        .. "in place of a dot?)", problem, 1, true)
    end
  end)

  -- What is wrong, the property, and the problem.
  local WRONG = {
    { after "e_leak".never "root.om".until_ "e_fill", "no state or flag is named "
      .. "'root.om' (did you mean 'root.on'?)" },
    { after "e_leak".never "root.on".until_ "e_fil", "no transition of the machine "
      .. "names 'e_fil' (did you mean 'e_fill'?)" },
    { from "root.om".after "e_leak".never "root.on", "no state or flag is named "
      .. "'root.om' (did you mean 'root.on'?)" },
    { precedes("e_fil", "root.on"), "no transition of the machine names 'e_fil' (did "
      .. "you mean 'e_fill'?)" },
    { after "entry root.om".reach "root.on", "no state is named 'root.om' (did you "
      .. "mean 'root.on'?)" },
  }
  for _, case in ipairs(WRONG) do
    it("is refused: " .. case[2]:sub(1, 40), function()
      local ok, text = pcall(judge, pump(), case[1])
      assert.same({ false, "rfsm_checks.explore: property 'p': " .. case[2] },
        { ok, (text:gsub("^spec/observer_spec.lua:%d+: ", "")) })
    end)
  end
end)

describe("a flag", function()
  local DOOR = { door = { on = { "e_open" }, off = { "e_close" } } }

  it("may be switched by events, also by those that nothing takes", function()
    local judged = judge(chart(), never { "root.b", "door" }, { flags = DOOR })
    assert.is_false(judged.holds)
    assert.equal("p: does not hold\n  a -e_x-> b -e_open-> b", (tostring(judged):gsub(
      "\n[^\n]*$", "")))
    local safe = chart { [4] = go("b", "a", "e_open", { pn = 1 }),
      [2] = go("a", "b", "e_close") }
    assert.is_true(judge(safe, never { "root.b", "door" }, { flags = DOOR }).holds)
    assert.is_true(judge(chart(), never "door", { flags = DOOR, alphabet = { "e_x" } })
      .holds)
  end)

  it("does not hide a dead end, and is off when the machine is entered", function()
    local result = rfsm_checks.explore(chart { c = state {}, [3] = go("b", "c", "e_c"),
      [4] = go("c", "a", "e_done", { guard = function() end }) }, { flags = DOOR })
    local codes = {}
    for i, finding in ipairs(result.findings) do codes[i] = finding.code end
    assert.truthy(table.concat(codes, " "):find("dead-end", 1, true))
    assert.is_true(judge(chart { b = nil, [2] = go("a", "a", "e_x"), [3] = go("a", "a",
      "e_y") }, never "door", { flags = DOOR, alphabet = {} }).holds)
  end)
end)

describe("data of events by example", function()
  local function is_hot(_, _, event) return event.celsius > 80 end

  -- (initial) -> a --e_heat[celsius > 80]--> b --e_heat--> a
  local function heater(guard)
    return chart { [2] = go("a", "b", rfsm.named "e_heat", { guard = guard or is_hot }),
      [3] = go("b", "a", "e_x") }
  end
  local function classes(...)
    local list = {}
    for i, celsius in ipairs { ... } do list[i] = { celsius = celsius } end
    return { classes = { e_heat = list } }
  end

  it("comes, and guards that only read get it", function()
    assert.is_true(judge(heater(), never "root.b", classes(20, 70)).holds)
    local judged = judge(heater(), never "root.b", classes(20, 90))
    assert.is_false(judged.holds)
    assert.equal("p: does not hold\n  a -e_heat{celsius=90}-> b\n  (one event a step; "
      .. "2 examples of e_heat)", tostring(judged))
    assert.equal("b", rfsm.get_actleaf_fqn((function()
      local fsm = rfsm.init(heater())
      for _, step in ipairs(judged.witness) do
        rfsm.send_events(fsm, unpack(step.values))
        rfsm.step(fsm)
      end
      return fsm
    end)()):gsub("^root%.", ""), nil)
  end)

  local long = ("x"):rep(100)
  for name, at in pairs { -- any order: each stands alone
    ["a long text"] = { one = { part = long .. 1 }, other = { part = long .. 2 } },
    ["many fields"] = { one = { a = long, b = long, c = 1 }, other = { a = long,
      b = long, c = 2 } },
    ["numbers"] = { one = { x = 0.3 }, other = { x = 0.1 + 0.2 } },
    ["tables"] = { one = { { { { { 1 } } } } }, other = { { { { { 2 } } } } } },
  } do
    it("is told from another by " .. name, function()
      local function is_other(_, _, event) return event.is_other end
      at.other.is_other, at.one.is_other = true, false
      local options = { together = 1, classes = { e_heat = { at.one, at.other } } }
      local function after_one(data)
        local event = { name = "e_heat" }
        for key, value in pairs(data) do event[key] = value end -- any order: a copy
        return judge(heater(is_other), from "root.a".after(event).reach "root.b",
          options).holds
      end
      assert.is_false(after_one(at.one))
      assert.is_true(after_one(at.other))
    end)
  end

  for _, case in ipairs {
    { after { name = "e_heat", celsius = 91 }.reach "root.b",
      "classes has no e_heat{celsius=91} (did you mean 'e_heat{celsius=90}'?)" },
    { rfsm_checks.always "root.a".unless { name = "e_heat", kelvin = 9 },
      "classes has no e_heat{kelvin=9}" },
  } do
    it("is the only data that a property may name: " .. case[2], function()
      local ok, text = pcall(judge, heater(), case[1], classes(20, 90))
      assert.is_false(ok)
      assert.truthy(text:find(case[2], 1, true), text)
      assert.matches("^spec/observer_spec.lua:%d+: ", text)
    end)
  end

  it("is a premise", function()
    assert.equal("one event a step; 1 example of e_heat",
      judge(heater(), never "root.b", classes(20)).premises)
  end)

  it("may be that of a property, and of the alphabet by name", function()
    local hot = { name = "e_heat", celsius = 90 }
    local options = classes(20, 90)
    options.together = 1
    assert.is_true(judge(heater(), from "root.a".after(hot).reach "root.b", options)
      .holds)
    assert.is_false(judge(heater(), from "root.a".after "e_heat".reach "root.b",
      options).holds)
    options.alphabet = { "e_heat" }
    assert.is_false(judge(heater(), never "root.b", options).holds)
  end)

  it("is known beside an event of the machine that a predicate accepts", function()
    local function is_done(event) return event == "e_done@root.a" end
    local model = heater()
    model.k, model[4] = rfsm.connector {}, go("k", "b", "e_y")
    model[5] = rfsm.trans { src = "root", tgt = "k", events = { is_done } }
    local options = classes(20)
    options.alphabet = { "e_heat" }
    assert.is_true(judge(model, never "root.b", options).holds)
  end)

  it("is known beside other data, to a guard that does not read all events", function()
    local function has_hot(_, events) return events[1].celsius > 80 end
    local options = classes(20)
    options.together = 2
    for guard, holds in pairs { [is_hot] = true, [has_hot] = false } do -- any order
      local model = heater(guard)
      model.c, model[4] = state {}, go("a", "c", rfsm.named "e_touch", { pn = -1 })
      assert.equal(holds, judge(model, never "root.b", options).holds)
    end
  end)

  it("is not known to a guard that calls what is not known", function()
    local function asks(_, _, event) return helper.unknown(event.celsius) end
    assert.is_false(judge(heater(asks), never "root.b", classes(20)).holds)
  end)

  for _, case in ipairs {
    { { e_haet = { {} } }, "^classes: no transition takes 'e_haet' with data %(did you "
      .. "mean 'e_heat'%?%)$" },
    { { e_x = { {} } }, "^classes: no transition takes 'e_x' with data" },
    { { e_heat = { celsius = 3 } }, "classes: e_heat: list of tables with data "
      .. "expected, such as { { x = 1 } }$" },
    { { e_heat = { 3 } }, "classes: e_heat%[1%]: table with data expected, got 3$" },
    { { e_heat = { { name = "e_hat" } } }, "classes: e_heat%[1%]: an event of this "
      .. "name expected, got one of the name 'e_hat'$" },
    { { {} }, "classes: name of an event expected, got 1$" },
    { 3, "classes: table of lists expected, got 3$" },
  } do
    it("is refused: " .. case[2]:sub(-40), function()
      local ok, text = pcall(judge, heater(), never "root.b", { classes = case[1] })
      assert.is_false(ok)
      assert.matches(case[2], text)
    end)
  end
end)

describe("verdicts of observers", function()
  it("agree with random runs on random charts", function()
    local claim = dofile "spec/support/claims/observers.lua"
    assert.is_nil(share.problem(claim, 24, true))
  end)
end)
