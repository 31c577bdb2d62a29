-- What several products share: calls, the alphabet of a machine, traversals, options,
-- hints, messages about charts, fields that are replaced for a while.

local rfsm = require "rfsm"
require "rfsm.await"
local advice = require "rfsm.advice"
local alphabet = require "rfsm.shared.alphabet"
local calls = require "rfsm.shared.calls"
local chart = require "rfsm.shared.chart"
local code = require "rfsm.shared.code"
local files = require "rfsm.shared.files"
local helper = require "spec.helper"
local exact_json = require "rfsm.shared.exact_json"
local options = require "rfsm.shared.options"
local order = require "rfsm.shared.order"
local instrument = require "rfsm.shared.instrument"
local match = require "rfsm.shared.match"
local writes = require "rfsm.shared.writes"
local location = require "rfsm.shared.location"
local stubs = require "rfsm.shared.stubs"

local state, trans = rfsm.state, rfsm.trans

describe("a composite", function()
  it("is passable if a connector in it leads out of it", function()
    for tgt, is_passable in pairs { ["root.cc"] = true, x = false } do -- any order
      local fsm = rfsm.init(state { info = false, warn = false, cc = state {},
        c = state { x = state {}, k = rfsm.conn {},
          trans { src = "initial", tgt = "x" }, trans { src = "x", tgt = "k" },
          trans { src = "k", tgt = tgt, events = "e" } },
        trans { src = "initial", tgt = "c" } })
      assert.equal(is_passable, location.is_passable(fsm.c))
      assert.equal("c.k", location.name_of(fsm.c.k, "root"))
      assert.equal("root", location.name_of(fsm, "root"))
    end
  end)
end)

describe("the name of a node", function()
  it("is that of its composite if it is an initial connector, and a target", function()
    local fsm = helper.init(state { c = state { k = rfsm.conn {}, x = state {},
      trans { src = "initial", tgt = "x" }, trans { src = "k", tgt = "x" } },
      trans { src = "initial", tgt = "c" } })
    for name, case in pairs { -- any order: each stands alone
      c = { fsm.c.initial, "root", true }, ["c.initial"] = { fsm.c.initial, "root" },
      ["c.k"] = { fsm.c.k, "root", true }, ["p.left.c.x"] = { fsm.c.x, "root.p.left" },
    } do
      assert.equal(name, location.name_of(case[1], case[2], case[3]))
    end
  end)

  it("that does not exist is refused, with the nearest name", function()
    for text, name in pairs { -- any order: each stands alone
      ["no state is named 'onn' (did you mean 'on'?)"] = "onn",
      ["no state is named '7'"] = 7,
    } do
      assert.same({ false, text },
        { pcall(location.refuse_name, name, "state", { "on", "off" }) })
    end
  end)
end)

describe("a protected call", function()
  it("returns all results", function()
    assert.same({ true, 1, nil, 3, n = 4 }, (function(...)
      return { n = select("#", ...), ... }
    end)(calls.try(function(...) return ... end, 1, nil, 3)))
  end)

  it("returns any failure", function()
    local failure = {}
    local ok, found = calls.try(error, failure)
    assert.is_false(ok)
    assert.equal(failure, found)
    local _, none = calls.try(error) -- Lua 5.5 has a text in place of nil
    assert.is_true(none == nil or none == "<no error object>")
  end)

  it("lets an interrupt through as itself", function()
    local function interrupted() error("x.lua:7: interrupted!", 0) end
    assert.same({ false, "x.lua:7: interrupted!" },
      { pcall(calls.try, interrupted) })
  end)
end)

describe("the text of arguments", function()
  it("has each of them, nil included", function()
    assert.equal("1, nil, x, 2.5, false, nil",
      calls.text(", ", 1.0, nil, "x", 2.5, false, nil))
    assert.equal("", calls.text(", "))
  end)
end)

describe("a text in one line", function()
  it("has a list behind its colon, and other lines behind semicolons", function()
    assert.equal("lost: a; b; c", calls.line("lost:\n  a\n  b\r\nc"))
    assert.equal("one", calls.line("one"))
  end)
end)

describe("a file", function()
  local NAME = "/tmp/rfsm_shared_spec.txt"

  after_each(function() os.remove(NAME) end)

  it("is read as it was written", function()
    local text = "a\r\n\0b"
    assert.is_true(files.write(NAME, text))
    assert.same({ text }, { files.read(NAME) })
  end)

  it("that cannot be read or written has a problem in one line", function()
    local missing = "/nothing/x: No such file or directory"
    assert.same({ nil, missing }, { files.read("/nothing/x") })
    assert.same({ false, missing }, { files.write("/nothing/x", "") })
    assert.same({ nil, "/tmp: Is a directory" }, { files.read("/tmp") })
    assert.same({ false, "/dev/full: No space left on device" },
      { files.write("/dev/full", "x") })
  end)

  it("is found as modules are, unless it is bytecode", function()
    local path = package.path
    package.path = "/nothing/?.lua;/tmp/?.lua;" .. path
    finally(function() package.path = path end)
    files.write(NAME, "x")
    assert.equal("x", (files.find("rfsm_shared_spec", ".txt")))
    files.write(NAME, "\27Lua")
    assert.is_nil(files.find("rfsm_shared_spec", ".txt"))
    assert.matches("^%-%-%- Files", (files.find("rfsm/shared/files")))
  end)

  it("of random bytes gives digits, others each time", function()
    local one, other = files.random(4), files.random(4)
    assert.matches("^" .. ("%x"):rep(8) .. "$", one)
    assert.not_equal(one, other)
  end)
end)

describe("the text of a value in JSON", function()
  local function null_as(text)
    return setmetatable({}, { __tojson = function() return text end })
  end

  local function nested(depth)
    local t = {}
    for _ = 2, depth do t = { t } end
    return t
  end

  for _, case in ipairs {
    { { "a", 7, false, { "b" } }, '["a",7,false,["b"]]' },
    { { b = 1, a = "x", c = {} }, '{"a":"x","b":1,"c":{}}' },
    { { 1, a = 2 }, '{"1":1,"a":2}' }, { { [2] = "b" }, '{"2":"b"}' },
    { { [0] = 1 }, '{"0":1}' }, { { 1, 2, [0] = 1 }, '{"0":1,"1":1,"2":2}' },
    { '"\\\n\t\r\1', [["\"\\\n\t\u000d\u0001"]] },
    { 5.0, "5" }, { 0.1, "0.1" }, { -2 ^ 53, "-9007199254740992" },
    { 1 / 3, "0.3333333333333333" }, { 1e300, "1e+300" },
    { { null_as("null") }, "[null]" }, { null_as("nil"), "{}" },
    { setmetatable({}, {}), "{}" },
    { setmetatable({}, { __tojson = "null" }), "{}" },
    { setmetatable({}, { __tojson = error }), "{}" },
    { nested(100), ("["):rep(99) .. "{}" .. ("]"):rep(99) },
  } do
    it("is the same on every Lua: " .. case[2]:sub(1, 30), function()
      assert.equal(case[2], exact_json.encode(case[1]))
    end)
  end

  for problem, value in pairs { -- any order: each stands alone
    ["the number inf has no JSON"] = 1 / 0, ["a function has no JSON"] = { print },
    ["a userdata has no JSON"] = io.stdout,
    ["a text or number as key expected, got boolean"] = { [true] = 1 },
    ["at most 100 tables inside each other expected"] = nested(101),
  } do
    it("is refused: " .. problem, function()
      assert.same({ false, problem }, { pcall(exact_json.encode, value) })
    end)
  end
end)

describe("the name of a stub", function()
  it("is found as a word of a text, after the stub was made a text", function()
    local arm = stubs.new("arm")
    assert.is_false(stubs.is_in("arm"))
    for _, stub in ipairs { arm, arm.find("a-b.lua"), arm._x } do
      assert.equal(stubs.name_of(stub), tostring(stub))
    end
    finally(stubs.forget)
    for text, is_in in pairs { -- any order: each stands alone
      arm = true, ["no arm: x"] = true, ["alarm"] = false, ["arm_2"] = false,
      ["the alarm of arm"] = true, ["_arm, arms"] = false,
    } do
      assert.equal(is_in, stubs.is_in(text))
    end
    stubs.forget()
    assert.is_false(stubs.is_in("arm"))
    assert.equal('arm.find("a-b.lua")', tostring(arm.find("a-b.lua")))
    assert.is_true(stubs.is_in('no file arm.find("a-b.lua")'))
    assert.is_false(stubs.is_in('no file arm.find("ab.lua")'))
  end)
end)

describe("the name of a transition", function()
  it("has its events in order, and composites in place of their `initial`", function()
    local fsm = assert(rfsm.init(state { info = false, warn = false, k = rfsm.conn {},
      a = state { x = state {}, trans { src = "initial", tgt = "x" } },
      trans { src = "initial", tgt = "k" },
      trans { src = "k", tgt = "a" },
      trans { src = "a", tgt = "k", pn = 2,
        events = { "e_y", 7, "e_x@root.a", "e_z@root", "root.a" } },
      trans { src = "a", tgt = "internal", events = { print }, pn = 1 },
      trans { src = "a", tgt = "internal", events = { type } } }))
    local entries, names = {}, {}
    for i, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
      entries[i] = { tr = tr, prefix = "root" }
    end
    location.add_names(entries)
    for i, entry in ipairs(entries) do names[i] = entry.name end
    assert.same({ "initial --> k", "k --> a",
      "a -7, e_x, e_y, e_z@root, root.a-> k", "a -a predicate-> internal",
      "a -a predicate-> internal #2", "a.initial --> a.x" }, names)
  end)
end)

describe("the alphabet of a machine", function()
  local function is_odd(event) return event == "odd" end
  local object = setmetatable({}, { __eq = function() error("compared") end })

  local function machine(region)
    return assert(rfsm.init(state { warn = false, info = false, initial = rfsm.conn {},
      a = region and rfsm.seqand { arm = region } or state {}, b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_2", "await(e_x, e_1)", is_odd } },
      trans { src = "b", tgt = "a", events = { object, "e_2", 7 } },
    }))
  end

  it("has events in the order of the tree, those awaited, and predicates", function()
    local known = alphabet.of(machine())
    assert.same({ "e_2", "await(e_x, e_1)@root.a", object, 7 }, known.list)
    assert.same({ "e_x", "e_1" }, known.reactions)
    assert.same({ is_odd }, known.predicates)
    for _, event in ipairs { "e_2", "e_x", "e_1", 7, is_odd, object } do
      assert.is_true(known.set[event])
    end
    assert.is_nil(known.set.e_3)
    assert.is_false(known.takes_any)
  end)

  it("knows whether any event will do", function()
    local fsm = assert(rfsm.init(state { warn = false, info = false, a = state {},
      trans { src = "initial", tgt = "a" }, trans { src = "a", tgt = "a" } }))
    assert.is_true(alphabet.of(fsm).takes_any)
  end)

  it("has events of regions where they are asked for", function()
    local fsm = machine(state { c = state {}, initial = rfsm.conn {},
      trans { src = "initial", tgt = "c" },
      trans { src = "c", tgt = "c", events = { "e_inner" } } })
    assert.is_nil(alphabet.of(fsm).set.e_inner)
    assert.is_true(alphabet.of_all(fsm).set.e_inner)
    assert.is_true(alphabet.of_all(fsm).set.e_2)
  end)
end)

describe("a traversal", function()
  it("has all keys once, with their values", function()
    local t, seen = { 1, 2, x = 3, [false] = 4 }, {}
    for key, value in order.each(t) do
      assert.is_nil(seen[key])
      seen[key] = value
    end
    assert.same(t, seen)
  end)

  local jit = rawget(_G, "jit")
  if jit then
    it("is not compiled on LuaJIT, nor is a loop around it", function()
      local compiled, t = 0, { a = 1, b = 2, c = 3 }
      local function traverse()
        local sum = 0
        for _ = 1, 300 do
          for _, value in order.each(t) do sum = sum + value end
        end
        return sum
      end
      local function note(what, _, f)
        if what == "stop" and f == traverse then compiled = compiled + 1 end
      end
      jit.attach(note, "trace")
      local sum = traverse()
      jit.attach(note)
      assert.same({ 1800, 0 }, { sum, compiled })
    end)
  end
end)

describe("two words", function()
  local CASES = {
    { "events", "Events", true }, { "on_exit", "onexit", true }, -- case, underscores
    { "guard", "gard", true }, { "gard", "guard", true }, { "doo", "dooo", true },
    { "entry", "enrty", true }, { "exit", "edit", false }, { "entry", "en", false },
    { "abcd", "badc", false }, { "", "a", true }, { "", "", true },
  }
  for _, case in ipairs(CASES) do
    local first, second, is_near = case[1], case[2], case[3]
    it(("'%s' and '%s' look %s"):format(first, second,
      is_near and "alike" or "different"), function()
      assert.equal(is_near, advice.is_near(first, second))
    end)
  end
end)

describe("the field that is meant", function()
  local MEANT = {
    state = "enter=entry on_entry=entry onEnter=entry OnExit=exit leave=exit "
      .. "onleave=exit do=doo during=doo activity=doo do_activity=doo entyr=entry "
      .. "pre_hook=- exits=exit entry=- mine=-",
    root = "prehook=pre_step_hook post_hook=post_step_hook pre_step_hok=pre_step_hook "
      .. "post_step=post_step_hook preStep=pre_step_hook "
      .. "get_events=getevents idlehook=idle_hook debg=dbg inf=info warning=- "
      .. "warnn=warn er=err enter=entry exti=exit dooo=doo",
    transition = "source=src from=src target=tgt to=tgt dst=tgt dest=tgt on=events "
      .. "trigger=events triggers=events condition=guard cond=guard when=guard "
      .. "action=effect actions=effect priority=pn prio=pn event=events gaurd=guard "
      .. "efect=effect pn=- name=-",
    connector = "entry=- enter=-",
  }
  for _, kind in ipairs { "connector", "root", "state", "transition" } do
    it("of a " .. kind .. " is found by its other names, and by what looks alike",
      function()
        local found = MEANT[kind]:gsub("(%S+)=%S+", function(key)
          local field = advice.field_meant(kind, key)
          if field == "" and kind == "root" then
            field = advice.field_meant("state", key)
          end
          return key .. "=" .. (field ~= "" and field or "-")
        end)
        assert.equal(MEANT[kind], found)
      end)
  end
end)

describe("a hint", function()
  it("names the nearest name, or all if they are few", function()
    for _, case in ipairs {
      { name = "lamp", names = { "door", "lam", "lamps" },
        hint = "did you mean 'lam'?" },
      { name = "Lamp", names = { "lamp" }, hint = "did you mean 'lamp'?" },
      { name = "inital", names = {}, hint = "did you mean 'initial'?" },
      { name = "initial", names = { "a" }, hint = "there is 'a'" },
      { name = "x", names = { "abc", "b" }, hint = "there are 'abc', 'b'" },
      { name = "abc", names = { 7, "abd" }, hint = "did you mean 'abd'?" },
      { name = "abcde", names = { "abcxy" }, hint = "did you mean 'abcxy'?" },
      { name = "abcde", names = { "abxyz" }, hint = "there is 'abxyz'" },
      { name = "abcdefgh", names = { "bacdegfx" }, hint = "did you mean 'bacdegfx'?" },
      { name = "abcdefgh", names = { "bacdwxyh" }, hint = "there is 'bacdwxyh'" },
      { name = "stpe", names = { "tape", "step" }, hint = "did you mean 'step'?" },
      { name = "bye", names = { "se" }, hint = "there is 'se'" },
      { name = "no", names = { "on" }, hint = "did you mean 'on'?" },
      { name = "x", names = { "a", "b", "c", "d", "e", "f" },
        hint = "there are 'a', 'b', 'c', 'd', 'e', 'f'" },
      { name = "x", names = { "a", "b", "c", "d", "e", "f", "g" } },
      { name = "x", names = {} },
    } do
      assert.equal(case.hint and " (" .. case.hint .. ")" or "",
        advice.nearest_name(case.name, case.names))
    end
  end)

  it("names the module of an event that looks like a call", function()
    helper.with(package.loaded, { rfsm_timeevent = false, ["rfsm.await"] = {},
      rfsm_await = false }, function()
      for word, hint in pairs { -- any order: each stands alone
        e_after = ' (require "rfsm_timeevent")', e_at = ' (require "rfsm_timeevent")',
        e_aftr = " (did you mean 'e_after(...)'?)",
        awiat = " (did you mean 'await(...)'?)", e_att = " (did you mean 'e_at(...)'?)",
        other = "",
      } do
        assert.equal(hint, advice.module_of(word))
      end
      assert.is_nil(advice.module_of("await"))
    end)
  end)
end)

describe("options", function()
  local KNOWN = {
    count = { "whole number from 1 to 9", options.is_whole(1, 9), 3 },
    name = { "text", options.is_text },
    wait = { "seconds", options.is_seconds, 0.5 },
    even = { "even number", function(x) return x % 2 == 0, "odd" end },
  }

  it("have their defaults", function()
    assert.same({ count = 3, wait = 0.5 }, options.read(KNOWN, {}))
    assert.same({ count = 9, wait = 0, name = "x", even = 2 },
      options.read(KNOWN, { count = 9, wait = 0, name = "x", even = 2 }))
  end)

  for _, case in ipairs {
    { given = 7, problem = "table of options expected, got 7" },
    { given = "x", problem = "table of options expected, got string 'x'" },
    { given = { cuont = 1 },
      problem = "unknown option 'cuont' (did you mean 'count'?), expected: count, "
        .. "even, name, wait" },
    { given = { [2] = 1, zz = 1 },
      problem = "unknown option '2', expected: count, even, name, wait" },
    { given = { count = 0 },
      problem = "count: whole number from 1 to 9 expected, got 0" },
    { given = { count = 10 },
      problem = "count: whole number from 1 to 9 expected, got 10" },
    { given = { count = 1.5 },
      problem = "count: whole number from 1 to 9 expected, got 1.5" },
    { given = { count = "1" },
      problem = "count: whole number from 1 to 9 expected, got string '1'" },
    { given = { name = "" }, problem = "name: text expected, got string ''" },
    { given = { name = false }, problem = "name: text expected, got boolean" },
    { given = { wait = -1 }, problem = "wait: seconds expected, got -1" },
    { given = { wait = math.huge }, problem = "wait: seconds expected, got inf" },
    { given = { even = 3 }, problem = "even: odd" },
  } do
    it("are refused: " .. case.problem, function()
      assert.same({ nil, case.problem }, { options.read(KNOWN, case.given) })
    end)
  end

  it("name the package of a module that is missing", function()
    local text = "the package %s is missing (on Debian: apt-get install %s)"
    assert.same({ nil, text:format("none", "lua-none") },
      { options.find_package("none") })
    assert.same({ nil, text:format("none", "lua-none") },
      { options.find_package("rfsm", "none") })
    assert.same({ rfsm, advice }, { options.find_package("rfsm", "rfsm.advice") })
    assert.equal("rfsm.x: " .. text:format("none", "lua-none"),
      select(2, pcall(options.need, "rfsm.x", "none")))
    helper.with(package.loaded, { socket = "no table" }, function()
      assert.equal(text:format("luasocket", "lua-socket"),
        select(2, options.find_package("socket")))
    end)
    assert.equal(rfsm, options.need("rfsm.x", "rfsm"))
  end)
end)

describe("a message about a chart", function()
  for _, case in ipairs {
    { file = "a b.lua", text = "a b.lua:3: x", line = "a b.lua:3: warning: x" },
    { file = "a.lua", text = "other.lua:3: x", line = "other.lua:3: warning: x" },
    { file = "a.lua", text = "root: x", line = "a.lua: warning: root: x" },
    { file = "a.lua", text = "a.lua has no line",
      line = "a.lua: warning: a.lua has no line" },
    { file = "-", text = "root: x", line = "stdin: warning: root: x" },
  } do
    it("has the location once: " .. case.line, function()
      assert.equal(case.line, chart.line(case.file, case.text, "warning: "))
      assert.equal((case.line:gsub("warning: ", "")), chart.line(case.file, case.text))
    end)
  end

  for failure, reason in pairs { -- any order: each stands alone
    ["x\nstack traceback"] = "a.lua: x",
    [""] = "a.lua: failed without a message",
    ["a.lua:1: x"] = "a.lua:1: x",
    ["rfsm.json: x"] = "a.lua: x",
    ["rfsm.load_str: failed to load chunk: x"] = "a.lua: x",
    ["rfsm.dot.encode: depth: x"] = "a.lua: depth: x",
    ["module 'x' not found:\n no field"] = "a.lua: module 'x' not found",
    ["<no error object>"] = "a.lua: failed without a message",
  } do
    it("has the reason of a failure: " .. reason, function()
      assert.equal(reason, chart.reason("a.lua", failure))
    end)
  end

  it("has the function that was probably meant, with the words of each Lua", function()
    for name, hint in pairs { -- any order: each stands alone
      stpe = " (did you mean rfsm.step?)", step = "", motor9 = "",
    } do
      for _, form in ipairs {
        "a.lua:1: attempt to call a nil value (field '%s')",
        "a.lua:1: attempt to call field '%s' (a nil value)",
      } do
        local text = form:format(name)
        assert.equal(text .. hint, chart.reason("a.lua", text))
      end
    end
  end)

  it("has what is meant most often by a mistake of syntax", function()
    local comma = " (is a comma missing in front of it?)"
    local word = ' (one too many? the name of a state is written ["end"])'
    for text, hint in pairs { -- any order: each stands alone
      ["'}' expected (to close '{' at line 1) near 'b'"] = comma,
      ["'}' expected near 'rfsm'"] = comma, ["'}' expected near '='"] = "",
      ["unexpected symbol near 'end'"] = word, ["'}' expected near 'end'"] = word,
    } do
      local problem = "a.lua:2: " .. text
      assert.equal(problem .. hint, chart.reason("a.lua", problem))
    end
  end)

  it("has the type of a failure that is no text", function()
    assert.equal("a.lua: failed with a table", chart.reason("a.lua", {}))
    assert.equal("a.lua: failed without a message", chart.reason("a.lua", nil))
    assert.equal("a.lua: 7", chart.reason("a.lua", 7))
    assert.equal("a.lua: rfsm.system: the system has left", chart.reason("a.lua",
      "rfsm.system: the system has left\n  the building"))
  end)
end)

describe("replaced fields", function()
  it("are given back, unless a program has set them meanwhile", function()
    local changes, t = {}, { a = 1, b = 2 }
    assert.same({ obj = t, field = "a", own = 1, was = 1, new = 5 },
      instrument.put(changes, t, "a", 5))
    instrument.put(changes, t, "a", 6)
    instrument.put(changes, t, "b", 7)
    instrument.put(changes, t, "c", 8)
    assert.same({ 6, 7, 8, 1 }, { t.a, t.b, t.c, instrument.original(t, "a") })
    t.b = 9
    instrument.give_back(changes)
    assert.same({ a = 1, b = 9 }, t)
    assert.same({}, changes)
  end)

  it("let a tool listen to a printer, which goes on", function()
    local said = {}
    local function say(...) said[#said + 1] = calls.text(" ", ...) end
    for _, case in ipairs {
      { own = say, said = { "a b" } },
      { own = true, printed = { "a\tb" } },
      { own = false },
    } do
      local fsm, changes = { warn = case.own }, {}
      local heard = {}
      said = {}
      instrument.listen(changes, fsm, "warn", function(...)
        heard[#heard + 1] = { ... }
      end)
      local printed = helper.printed(function() fsm.warn("a", "b") end)
      assert.same({ { { "a", "b" } }, case.said or {}, case.printed or {} },
        { heard, said, printed })
      instrument.give_back(changes)
      assert.equal(case.own, fsm.warn)
    end
  end)

  it("are the functions of a chart, but for guards, doos and getevents", function()
    local called, changes = {}, {}
    local function noting(text, result)
      return function()
        called[text] = true
        return result
      end
    end
    local fsm = assert(rfsm.init(state { info = false, warn = false,
      getevents = noting("getevents"),
      pre_step_hook = noting "pre", post_step_hook = noting "post",
      entry = noting "root",
      a = state { entry = noting "entry", exit = noting "exit",
        doo = noting("doo", true) },
      par = rfsm.seqand { entry = noting "par", arm = state { info = false,
        warn = false, r = state {}, trans { src = "initial", tgt = "r" } } },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "par", events = { "e" }, guard = noting "guard",
        effect = noting "effect", likely = noting "likely" } }))
    local function run()
      called = {}
      rfsm.reset(fsm)
      rfsm.step(fsm, 9)
      rfsm.send_events(fsm, "e")
      rfsm.step(fsm, 9)
      assert.equal("root.par", rfsm.get_actleaf_fqn(fsm))
      assert.equal("root.r", rfsm.get_actleaf_fqn(rfsm.regions(fsm.par)[1]))
      return called
    end
    local likely, all = fsm[2].likely, { getevents = true, pre = true, post = true,
      root = true, entry = true, exit = true, doo = true, par = true, guard = true,
      effect = true }
    assert.same(all, run())
    assert.same({ fsm.a }, instrument.take_functions(changes, fsm))
    assert.same({ getevents = true, doo = true, guard = true }, run())
    assert.is_falsy(fsm[2].likely)
    instrument.give_back(changes)
    assert.same(all, run())
    assert.equal(likely, fsm[2].likely)
  end)
end)

describe("hooks that a tool adds", function()
  it("are called where it says, and are gone when changes are given back", function()
    local trace, changes = {}, {}
    local function note(text) return function() trace[#trace + 1] = text end end
    local fsm = rfsm.init(state { info = false, warn = false, a = state {},
      pre_step_hook = note "own", trans { src = "initial", tgt = "a" } })
    instrument.hook(changes, fsm, "pre_step", note "first", "before")
    instrument.hook(changes, fsm, "pre_step", note "last", "after")
    instrument.hook(changes, fsm, "post_step", note "post")
    instrument.hook(changes, fsm, "reset", note "reset")
    rfsm.step(fsm)
    rfsm.reset(fsm)
    assert.same({ "first", "own", "last", "post", "reset" }, trace)
    instrument.give_back(changes)
    rfsm.step(fsm)
    rfsm.reset(fsm)
    assert.same({ "first", "own", "last", "post", "reset", "own" }, trace)
    assert.same({}, changes)
  end)
end)

describe("a text loaded with globals", function()
  it("has these and no others; a mistake is returned", function()
    local globals = { x = 7 }
    assert.same({ 7, nil }, { calls.load("y = x return x, print", "=t", globals)() })
    assert.equal(7, globals.y)
    assert.same({ nil, "t:1" }, { nil,
      (select(2, calls.load("return return", "=t", {})):match("^t:1")) })
  end)
end)

describe("the code of a text", function()
  local TEXT = [==[
a("x\"y") -- "c"
b = 'd\\' .. [[e
]] --[[ f
]] g]==]

  local function shown(...) return (code.of(...):gsub(" ", "_")) end

  it("has blanks in place of strings and comments, and as many lines", function()
    assert.equal("a(______)_______\nb_=_______..____\n_________\n___g", shown(TEXT))
  end)

  it("may have its strings", function()
    assert.equal("a(\"x\\\"y\")_______\nb_=_'d\\\\'_.._[[e\n]]_______\n___g",
      shown(TEXT, true))
  end)
end)

describe("a path that may be taken", function()
  local conn = rfsm.conn

  it("goes on behind its connectors on the same events", function()
    local fsm = assert(rfsm.init(state { warn = false, info = false,
      a = state {}, b = state {}, k = conn {}, l = conn {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "k", events = { "e_x", "e_y" } },
      trans { src = "k", tgt = "l", events = { "e_x" } },
      trans { src = "l", tgt = "k" },
      trans { src = "l", tgt = "b", events = { "e_z" } } }))
    local function may_enable(...) return match.may_enable(fsm[2], { ... }) end
    assert.same({ true, false, false, false }, { may_enable("e_x", "e_z"),
      may_enable "e_x", may_enable "e_z", may_enable("e_y", "e_z") })
  end)
end)

describe("the text of a function", function()
  local function set_plain(t) t["a"], t[1], t[#t + 1] = 1, 2, 3 end
  local function set_computed(t, key) t[key] = 1 end

  it("may write any field by a key that it computes", function()
    assert.same({ false, true }, { writes.may_write(set_plain, { "tgt" }),
      writes.may_write(set_computed, { "tgt" }) })
  end)

  local function compare(tr)
    local n = tr.src.n
    return n > 2 and tr.tgt ~= nil
  end
  local function set(tr) tr.n = 1 end
  local function call(tr) return tr.test() end

  it("only reads if it calls nothing and assigns to local variables alone", function()
    assert.same({ true, false, false }, { writes.only_reads(compare),
      writes.only_reads(set), writes.only_reads(call) })
  end)
end)
