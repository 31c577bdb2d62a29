-- What the text of callbacks shows, where luacheck is installed.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local source = require "rfsm.checks.source"
local static = require "rfsm.checks.static"

local CHART = [[
local rfsm = require "rfsm"
local state, trans, yield = rfsm.state, rfsm.trans, rfsm.yield
return state { info = false, warn = false,
  a = state {},
  b = state {
    %s
  },
  trans { src = "initial", tgt = "a" },
  trans { src = "a", tgt = "b", events = { "e_x" },
    %s
  },
  trans { src = "b", tgt = "a", events = { "%s" } },
}
]]

-- Returns the findings of this check about a chart: "code: text", a note with "note".
local function found(case)
  local file = helper.file_with(CHART:format(case.state or "", case.transition or "",
    case.event or "e_x"))
  local lines = {}
  for i, finding in ipairs(static.collect(rfsm.load(file), { "rfsm.checks.source" })) do
    local note = finding.severity == "note" and "note " or ""
    lines[i] = note .. finding.code .. ": " .. finding.place .. ": " .. finding.text
  end
  helper.remove_files()
  return lines
end

local GUARD = "no-value: root.trans[2] (a -> b): the guard returns no value, it never "
  .. "forbids"
local NEVER_FALSE = "no-value: root.trans[2] (a -> b): the guard never returns false, "
  .. "and only false forbids"
local NO_YIELD = "no-yield: root.b: a loop in the doo has no end and no yield"
local BUSY = "note busy-doo: root.b: the doo is never idle, it yields nothing"
local ENDS = "note doo-ends: root.b: the doo ends, and no transition waits for e_done"

local IDLE = "an idle machine calls its idle_hook again and again, so that run returns "
  .. "only after an error"

local function undefined(line, name, hint)
  return ("undefined: root.b: line %d reads the global '%s', which is not defined%s")
    :format(line, name, hint)
end

local CASES = {
  { name = "a global that is nearly there", state = "entry = function() prnt 'hi' end",
    lines = { undefined(6, "prnt", " (did you mean 'print'?)") } },
  { name = "a function of the library without its name", lines = {
    undefined(7, "send_events", " (did you mean 'rfsm.send_events'?)") },
    state = "exit = function(fsm)\n send_events(fsm, 'e') end" },
  { name = "as a note, a global that the host may define",
    state = "entry = function() crane.stop() end",
    lines = { "note " .. undefined(6, "crane", "") } },
  { name = "once, a global that a line reads twice",
    state = "entry = function() crane.stop(crane) end",
    lines = { "note " .. undefined(6, "crane", "") } },
  { name = "no loop without an end whose condition is a field", lines = { ENDS },
    state = "doo = function(fsm) while fsm.is_busy do local _ = 1 end end" },
  { name = "as a note, the global `fsm`, which programs keep their machine in",
    state = "entry = function() rfsm.send_events(fsm, 'e') end",
    lines = { "note " .. undefined(6, "fsm", "") } },
  { name = "no global that is compared with nothing", lines = {},
    state = "entry = function() local off = not crane crane.stop() return off end" },
  { name = "no global whose existence is asked for",
    state = "entry = function() if crane then crane.stop() end end", lines = {} },
  { name = "no global that the chart sets",
    state = "entry = function() own_count = 1 return own_count end", lines = {} },
  { name = "a guard without a value", lines = { GUARD },
    transition = "guard = function(tr)\n local f = function() return tr end f() end" },
  { name = "no guard with a value", lines = {},
    transition = "guard = function() if 1 then return false end end" },
  { name = "a guard that returns true or nothing", lines = { NEVER_FALSE },
    transition = "guard = function(tr) if tr.x then return true end end" },
  { name = "no guard that returns true only", lines = {},
    transition = "guard = function() return true end" },
  { name = "no guard that calls assert", lines = {},
    transition = "guard = function(tr) assert(tr.x) return 1 end" },
  { name = "parameters in another order", state = "entry = function(state, fsm)\n"
    .. "return state, fsm end", lines = {
    "parameters: root.b: parameter 1 of the entry, 'state', is the machine (entry(fsm, "
      .. "state, _, event))",
    "parameters: root.b: parameter 2 of the entry, 'fsm', is the state (entry(fsm, "
      .. "state, _, event))" } },
  { name = "no parameter that is not used, nor one of another name", lines = {},
    state = "entry = function(state) end,\n exit = function(o, a) return o, a end" },
  { name = "a first parameter that is read as the state", lines = {
    "parameters: root.b: parameter 1 of the entry, 'self', is the machine, which has "
      .. "no field 'n' (entry(fsm, state, _, event))" },
    state = "n = 0, entry = function(self) self.n = self.n + 1 end" },
  { name = "one of an effect that is read as the transition", lines = {
    "parameters: root.trans[2] (a -> b): parameter 1 of the effect, 'o', is the "
      .. "machine, which has no field 'speed' (effect(fsm, tr, _, events, event))" },
    transition = "speed = 3, effect = function(o) print(o.speed) end" },
  { name = "one of a guard that is read as the machine", lines = {
    "parameters: root.trans[2] (a -> b): parameter 1 of the guard, 'm', is the "
      .. "transition, which has no field 'info' (guard(tr, events, event))" },
    transition = "guard = function(m) return m.info end" },
  { name = "no first parameter with the name of what it is", lines = {},
    state = "n = 0, entry = function(fsm) print(fsm.n) end",
    transition = "speed = 3, effect = function(machine) print(machine.speed) end" },
  { name = "no field of the machine, and none that is only written", lines = {},
    state = "info = 1, n = 0, entry = function(m) m.n = 1 return m.info, m._fqn end" },
  { name = "a method that gets the machine in place of its object", lines = {
    "parameters: root.b: parameter 1 of the entry, 'self', is the machine, which has "
      .. "no field 'sound' (entry = function() robot:beep() end)" },
    state = "entry = (function() local robot = {}\nfunction robot:beep() print(self."
      .. "sound) end\nreturn robot.beep end)()" },
  { name = "no method that reads what the machine has", lines = {},
    state = "entry = (function() local robot = {}\nfunction robot:beep() print(self."
      .. "info) end\nreturn robot.beep end)()" },
  { name = "a guard that reads the list as one event", lines = {
    "parameters: root.trans[2] (a -> b): parameter 2 of the guard, 'e', is the list of "
      .. "events (guard(tr, events, event))" },
    transition = "guard = function(_, e) return e.n > 0 end" },
  { name = "a guard that compares the list with a text", lines = {
    "parameters: root.trans[2] (a -> b): parameter 2 of the guard, 'event', is the "
      .. "list of events (guard(tr, events, event))" },
    transition = "guard = function(_, event) return 'e_x' == event end" },
  { name = "an entry that reads the word as an event", lines = {
    "parameters: root.b: parameter 3 of the entry, 'e', is the word (entry(fsm, state, "
      .. "_, event))" },
    state = "entry = function(_, _, e) print(e.n) end" },
  { name = "no list that is read as one, or whose name is given to another value",
    transition = "guard = function(_, e) for _, e in ipairs(e) do if e.n then return "
      .. "false end end end,\n effect = function(_, _, _, events) print(events[1], "
      .. "#events) end", lines = {},
    state = "entry = function(_, _, word, event) print(word:upper(), event.n) end" },
  { name = "an emit with a colon", lines = {
    "wrong-call: root.b: emit gets the event first (m.emit(...), with a dot)" },
    state = "entry = function(m) m:emit('e_on') end" },
  { name = "as a note, an idle hook that may wait", lines = {
    "note idle-hook: root: " .. IDLE },
    transition = "}, idle_hook = function() print() end, datum = {" },
  { name = "an idle hook that calls nothing", lines = { "idle-hook: root: " .. IDLE },
    transition = "}, idle_hook = function() local n = 1 return n end, datum = {" },
  { name = "a yield outside of a doo", state = "exit = function() yield() end,\n"
    .. "entry = function() coroutine.yield() end", lines = {
    "wrong-call: root.b: the entry calls coroutine.yield (only a doo may yield)" } },
  { name = "a call without the machine, and one whose step is under way",
    state = "entry = function(fsm) rfsm.send_events('e') rfsm.run(fsm) end", lines = {
    "wrong-call: root.b: rfsm.send_events gets the machine first (rfsm.send_events(fsm,"
      .. " ...))",
    "wrong-call: root.b: the entry calls rfsm.run of its machine, whose step is under "
      .. "way (rfsm.send_events is enough, its events are taken next)" } },
  { name = "a function of the library as a method", lines = {
    "wrong-call: root.b: a machine has no method 'run' (rfsm.run(m, ...))" },
    state = "entry = function(m) m:run() end" },
  { name = "one that is loaded when it is used, as a method", lines = {
    "wrong-call: root.b: a machine has no method 'is_in' (rfsm.is_in(m, ...))" },
    state = "entry = function(m) m:is_in('root.a') end" },
  { name = "no method of another object, and no call of another machine", lines = {},
    state = "entry = function(m) local o = m.other o:run() rfsm.run(o) m:own() end" },
  { name = "a callback that was called while the chart was loaded",
    state = "\n entry = type(nil) == '' and 1 or nil, exit = yield and collectgarbage()"
      .. " and nil, doo = print()", lines = {
    "called: root.b: print was called while the chart was loaded, and left no doo (doo "
      .. "= function() print(...) end)" } },
  { name = "no call that returned a callback", lines = {},
    state = "entry = assert(print)" },
  { name = "a key that stands twice", state = "datum = 1,\n datum = 2", lines = {
    "lost: root.b: 'datum' stands twice, the first one is lost (the second is in line "
      .. "7)" } },
  { name = "a doo that waits in a loop", lines = { NO_YIELD },
    state = "doo = function(fsm)\n local ready while not ready do end return fsm end" },
  { name = "no doo whose loop may end", lines = { ENDS },
    state = "doo = function(fsm)\n local n = 1 while n < 9 do n = n + fsm.x end end" },
  { name = "no guard that fails", lines = {},
    transition = "guard = function() error('no') end" },
  { name = "a doo that never yields", lines = { NO_YIELD },
    state = "doo = function()\n while true do print(1) end end" },
  { name = "a doo that never yields, in another loop", lines = { NO_YIELD },
    state = "doo = function()\n repeat local x = 1 until false end" },
  { name = "no doo whose loop calls what may yield", lines = {},
    state = "doo = function(f)\n while true do f() end end" },
  { name = "no doo whose loop has a method that may yield", lines = {},
    state = "doo = function(f)\n while true do f:go() end end" },
  { name = "no doo whose loop is left", lines = {},
    state = "doo = function()\n while true do break end end" },
  { name = "as a note, a doo that is busy", lines = { BUSY },
    state = "doo = function()\n while true do rfsm.yield() print(1) end end" },
  { name = "as a note, a doo that yields false", lines = { BUSY },
    state = "doo = function()\n while true do yield(false) end end" },
  { name = "no doo that yields true", lines = {},
    state = "doo = function()\n while true do yield(true) end end" },
  { name = "no doo that yields what it knows", lines = {},
    state = "doo = function(x)\n while true do rfsm.yield(x) end end" },
  { name = "as a note, a doo whose end nobody waits for", lines = { ENDS },
    state = "doo = function()\n print(1) end" },
  { name = "no doo of a leaf that ends its composite", lines = {},
    transition = "}, trans { src = 'root', tgt = '.a', events = { 'e_done' }",
    state = "final = true, doo = function()\n print(1) end" },
  { name = "no doo whose end is waited for", lines = {}, event = "e_done",
    state = "doo = function()\n print(1) end" },
}

describe("the text of callbacks", function()
  it("is not read without luacheck, and rfsm check -a reports that", function()
    helper.with(source, { is_there = false }, function()
      assert.same({}, found(CASES[1]))
      local model = helper.chart({ "e" })
      for _, all in ipairs { true, false } do
        local lines = require("rfsm.cli.review").of("x.lua", model, {}, {},
          { all = all, static = true })
        assert.same({ "x.lua: ok", all and "x.lua: the text of callbacks was not read, "
          .. "luacheck is not installed" or nil }, lines)
      end
    end)
  end)

  local debian = io.open("/usr/share/lua/5.1/luacheck/parser.lua")
  if debian then debian:close() end
  it("is read by the luacheck of Lua 5.1 as well", function()
    assert.is_true(not debian or source.is_there)
  end)
  if not source.is_there then return end

  for _, case in ipairs(CASES) do
    it("shows " .. case.name, function() assert.same(case.lines, found(case)) end)
  end

  it("shows an event that a region sends to itself, and only others know", function()
    local file = helper.file_with([[
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans
local function region(entry)
  return state { info = false, warn = false, w = state { entry = entry }, r = state {},
    trans { src = "initial", tgt = "w" } }
end
local left, right = region(), region(function(fsm)
  rfsm.send_events(fsm, "e_left", "e_own")
end)
left[2] = trans { src = "w", tgt = "r", events = { "e_left" } }
right[2] = trans { src = "w", tgt = "r", events = { "e_own" } }
return state { info = false, warn = false, trans { src = "initial", tgt = "both" },
  both = rfsm.seqand { left = left, right = right, idle_doo = "auto" } }
]])
    local findings = static.collect(rfsm.load(file), { "rfsm.checks.source" })
    assert.equal(1, #findings)
    assert.equal("root.both.right: root.w: the entry sends 'e_left' to its own region, "
      .. "where no transition names it (rfsm.send_events(rfsm.parent(fsm), ...))",
      findings[1].place .. ": " .. findings[1].text)
  end)

  it("is left alone where it cannot be read, or begins twice in a line", function()
    local model = rfsm.load_str("local rfsm = require 'rfsm' return rfsm.state { "
      .. "info = false, warn = false, a = rfsm.state { exit = function() prnt() end }, "
      .. "rfsm.trans { src = 'initial', tgt = 'a' } }")
    assert.equal(0, #static.collect(model, { "rfsm.checks.source" }))
    assert.same({}, found { transition = "guard = (function() return function() end "
      .. "end)()" })
  end)
end)
