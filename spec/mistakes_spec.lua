-- The mistakes of a first hour: what stands in a chart file, and what init has to say.

local helper = require "spec.helper"
local rfsm = require "rfsm"

-- A text that does not begin with `return` or `local` stands from line 6 on in here.
local RIGHT = [[
return rfsm.state {
  a = rfsm.state {}, b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_go" } },
  rfsm.trans { src = "b", tgt = "a", events = { "e_back" } },
%s
}
]]

-- A chart, then `-->` in front of each problem or warning, in order. Nothing behind the
-- arrow: there is nothing to say.
local MISTAKES = [[
  rfsm.trans { tgt = "a", events = { "e" } },
--> chart.lua:6: root.trans[4]: src is missing, the name of a state or connector
    expected

  rfsm.trans { src = "a", events = { "e" } },
--> chart.lua:6: root.trans[4]: tgt is missing, the name of a state or connector
    expected

  rfsm.trans { src = "a", tgt = "bb", events = { "e" } },
--> chart.lua:6: root.trans[4] (a -> bb): tgt 'bb': no state or connector is named 'bb'
    in 'root' (did you mean 'b'?)

  rfsm.trans { src = "A", tgt = "b", events = { "e" } },
--> chart.lua:6: root.trans[4] (A -> b): src 'A': no state or connector is named 'A' in
    'root' (did you mean 'a'?)

  rfsm.trans { src = "a", tgt = "zzzzzz", events = { "e" } },
--> chart.lua:6: root.trans[4] (a -> zzzzzz): tgt 'zzzzzz': no state or connector is
    named 'zzzzzz' in 'root' (there are 'a', 'b', 'initial')

  rfsm.trans { from = "a", to = "b", events = { "e" } },
--> chart.lua:6: root.trans[4]: src is missing, the name of a state or connector
    expected (there is 'from', did you mean 'src'?)
--> chart.lua:6: root.trans[4]: tgt is missing, the name of a state or connector
    expected (there is 'to', did you mean 'tgt'?)

  rfsm.trans { source = "a", target = "b", events = { "e" } },
--> chart.lua:6: root.trans[4]: src is missing, the name of a state or connector
    expected (there is 'source', did you mean 'src'?)
--> chart.lua:6: root.trans[4]: tgt is missing, the name of a state or connector
    expected (there is 'target', did you mean 'tgt'?)

  rfsm.trans { "a", "b", events = { "e" } },
--> chart.lua:6: root.trans[4]: src is missing, the name of a state or connector
    expected
--> chart.lua:6: root.trans[4]: tgt is missing, the name of a state or connector
    expected

  rfsm.trans { src = "a", tgt = { "b" }, events = { "e" } },
--> chart.lua:6: root.trans[4]: tgt: name of a state or connector expected, got table

  rfsm.trans { src = 1, tgt = "b", events = { "e" } },
--> chart.lua:6: root.trans[4]: src: name of a state or connector expected, got number 1

  rfsm.trans { src = a, tgt = b, events = { "e" } },
--> chart.lua:6: root.trans[4]: src is missing, the name of a state or connector
    expected
--> chart.lua:6: root.trans[4]: tgt is missing, the name of a state or connector
    expected

  rfsm.trans { src = "a", tgt = rfsm.state {}, events = { "e" } },
--> chart.lua:6: root.trans[4]: tgt: the table given is no part of this model

  rfsm.trans { src = "a", tgt = "b.x", events = { "e" } },
--> chart.lua:6: root.trans[4] (a -> b.x): tgt 'b.x': no state or connector is named 'x'
    in 'root.b'

  rfsm.trans { src = "a", tgt = "root.c.x", events = { "e" } },
--> chart.lua:6: root.trans[4] (a -> root.c.x): tgt 'root.c.x': no state or connector is
    named 'c' in 'root' (there are 'a', 'b', 'initial')

  rfsm.trans { src = "a", tgt = "c", events = { "e" } }, c = {},
--> chart.lua:6: root.trans[4] (a -> c): tgt 'c': 'root.c' is no state or connector but
    a table (did you mean rfsm.state{...}?)

  rfsm.trans { src = "a", tgt = "c", events = { "e" } }, c = { x = rfsm.state {} },
--> chart.lua:6: root.trans[4] (a -> c): tgt 'c': 'root.c' is no state or connector but
    a table (did you mean rfsm.state{...}?)

  rfsm.trans { src = "a", tgt = "c", events = { "e" } }, c = function() end,
--> chart.lua:6: root.trans[4] (a -> c): tgt 'c': 'root.c' is no state or connector but
    a function

  c = rfsm.state { x = rfsm.state {} },
  rfsm.trans { src = "a", tgt = "c", events = { "e" } },
--> chart.lua:7: root.trans[4] (a -> c): tgt 'root.c': the composite has no initial
    transition (rfsm.trans{ src='initial', tgt=... })

  c = rfsm.state { x = rfsm.state {}, rfsm.trans { src = "initial", tgt = "y" } },
--> chart.lua:6: root.c.trans[1] (initial -> y): tgt 'y': no state or connector is named
    'y' in 'root.c' (there are 'initial', 'x')

  c = rfsm.state { x = rfsm.state {}, rfsm.trans { src = "initial", tgt = "x" },
    rfsm.trans { src = "x", tgt = "b", events = { "e" } } },
--> chart.lua:7: root.c.trans[2] (x -> b): tgt 'b': no state or connector is named 'b'
    in 'root.c' (did you mean 'root.b'?)

  c = rfsm.state { x = rfsm.state {}, initial = "x" },
--> chart.lua:6: root.c.initial: connector expected, got string 'x' (rfsm.trans{
    src='initial', tgt=... })

  c = rfsm.state { x = rfsm.state {}, initial = rfsm.state {} },
--> chart.lua:6: root.c.initial: connector expected, got state

  rfsm.trans { src = "intial", tgt = "a" },
--> chart.lua:6: root.trans[4] (intial -> a): src 'intial': no state or connector is
    named 'intial' in 'root' (did you mean 'initial'?)

  initial = "a",
--> chart.lua:1: root.initial: connector expected, got string 'a' (rfsm.trans{
    src='initial', tgt=... })

  ["c.d"] = rfsm.state {},
--> chart.lua:6: root.c.d: the name of a state must not be empty, contain '.' or '\' or
    start with '_'

  _c = rfsm.state {},
--> chart.lua:6: root._c: the name of a state must not be empty, contain '.' or '\' or
    start with '_'

  rfsm.state {},
--> chart.lua:6: root.4: a state needs a name (name = ...)

  rfsm.conn {},
--> chart.lua:6: root.4: a connector needs a name (name = ...)

  entry = rfsm.state {},
--> chart.lua:6: root.entry: a state cannot have this name, it is a field of every state

  dbg = rfsm.state {},
--> chart.lua:6: root.dbg: a state cannot have this name, it is a field of every root
--> chart.lua:1: root.dbg: function, true or false expected, got state

  c = rfsm.state { entry = "led" },
--> chart.lua:6: root.c.entry: function expected, got string 'led'

  c = rfsm.state { exit = true },
--> chart.lua:6: root.c.exit: function expected, got boolean

  c = rfsm.state { doo = {} },
--> chart.lua:6: root.c.doo: function expected, got table

  doo = function() end,
--> chart.lua:1: root.doo: only a leaf state can have a doo

  c = rfsm.state { enter = function() end },
--> WARNING: chart.lua:6: root.c: a state has no field 'enter' (did you mean 'entry'?)

  c = rfsm.state { on_entry = function() end },
--> WARNING: chart.lua:6: root.c: a state has no field 'on_entry' (did you mean
    'entry'?)

  c = rfsm.state { onExit = function() end },
--> WARNING: chart.lua:6: root.c: a state has no field 'onExit' (did you mean 'exit'?)

  c = rfsm.state { Entry = function() end },
--> WARNING: chart.lua:6: root.c: a state has no field 'Entry' (did you mean 'entry'?)

  c = rfsm.state { ["do"] = function() end },
--> WARNING: chart.lua:6: root.c: a state has no field 'do' (did you mean 'doo'?)

  c = rfsm.state { during = function() end },
--> WARNING: chart.lua:6: root.c: a state has no field 'during' (did you mean 'doo'?)

  c = rfsm.state { leave = function() end },
--> WARNING: chart.lua:6: root.c: a state has no field 'leave' (did you mean 'exit'?)

  c = rfsm.state { enrty = function() end },
--> WARNING: chart.lua:6: root.c: a state has no field 'enrty' (did you mean 'entry'?)

  rfsm.trans { src = "a", tgt = "b", event = "e" },
--> WARNING: chart.lua:6: root.trans[4] (a -> b): a transition has no field 'event' (did
    you mean 'events'?)

  rfsm.trans { src = "a", tgt = "b", Events = { "e" } },
--> WARNING: chart.lua:6: root.trans[4] (a -> b): a transition has no field 'Events'
    (did you mean 'events'?)

  rfsm.trans { src = "a", tgt = "b", evnts = { "e" } },
--> WARNING: chart.lua:6: root.trans[4] (a -> b): a transition has no field 'evnts' (did
    you mean 'events'?)

  rfsm.trans { src = "a", tgt = "b", on = "e" },
--> WARNING: chart.lua:6: root.trans[4] (a -> b): a transition has no field 'on' (did
    you mean 'events'?)

  rfsm.trans { src = "a", tgt = "b", events = { "e" }, cond = function() end },
--> WARNING: chart.lua:6: root.trans[4] (a -> b): a transition has no field 'cond' (did
    you mean 'guard'?)

  rfsm.trans { src = "a", tgt = "b", events = { "e" }, condition = function() end },
--> WARNING: chart.lua:6: root.trans[4] (a -> b): a transition has no field 'condition'
    (did you mean 'guard'?)

  rfsm.trans { src = "a", tgt = "b", events = { "e" }, gaurd = function() end },
--> WARNING: chart.lua:6: root.trans[4] (a -> b): a transition has no field 'gaurd' (did
    you mean 'guard'?)

  rfsm.trans { src = "a", tgt = "b", events = { "e" }, action = function() end },
--> WARNING: chart.lua:6: root.trans[4] (a -> b): a transition has no field 'action'
    (did you mean 'effect'?)

  rfsm.trans { src = "a", tgt = "b", events = { "e" }, prio = 1 },
--> WARNING: chart.lua:6: root.trans[4] (a -> b): a transition has no field 'prio' (did
    you mean 'pn'?)

  rfsm.trans { src = "a", tgt = "b", events = { "e" }, priority = 1 },
--> WARNING: chart.lua:6: root.trans[4] (a -> b): a transition has no field 'priority'
    (did you mean 'pn'?)

  rfsm.trans { src = "a", tgt = "b", events = { "e" }, PN = 1 },
--> WARNING: chart.lua:6: root.trans[4] (a -> b): a transition has no field 'PN' (did
    you mean 'pn'?)

  rfsm.trans { src = "a", tgt = "b", events = { "e" }, pn = "1" },
--> chart.lua:6: root.trans[4].pn (a -> b): number expected, got string '1'

  rfsm.trans { src = "a", tgt = "b", events = 5 },
--> chart.lua:6: root.trans[4].events (a -> b): list of events or a string expected, got
    number 5

  rfsm.trans { src = "a", tgt = "b", events = true },
--> chart.lua:6: root.trans[4].events (a -> b): list of events or a string expected, got
    boolean

  rfsm.trans { src = "a", tgt = "b", events = { nil, "e" } },
--> chart.lua:6: root.trans[4].events (a -> b): list of events expected, got a table
    with holes or keys

  rfsm.trans { src = "a", tgt = "b", events = { go = "e" } },
--> chart.lua:6: root.trans[4].events (a -> b): list of events expected, got a table
    with holes or keys

  rfsm.trans { src = "a", tgt = "b", events = { 0/0 } },
--> chart.lua:6: root.trans[4].events[1] (a -> b): an event cannot be NaN

  rfsm.trans { src = "a", tgt = "b", events = { "e_after(1)" } },
--> WARNING: chart.lua:6: root.trans[4].events (a -> b): no loaded extension knows
    'e_after(1)' (require "rfsm_timeevent")

  rfsm.trans { src = "a", tgt = "b", events = "e_at(1)" },
--> WARNING: chart.lua:6: root.trans[4].events (a -> b): no loaded extension knows
    'e_at(1)' (require "rfsm_timeevent")

  rfsm.trans { src = "a", tgt = "b", events = { "await(e_a, e_b)" } },
--> WARNING: chart.lua:6: root.trans[4].events (a -> b): no loaded extension knows
    'await(e_a, e_b)' (require "rfsm_await")

  rfsm.trans { src = "a", tgt = "b", events = { "after(1)" } },
--> WARNING: chart.lua:6: root.trans[4].events (a -> b): no loaded extension knows
    'after(1)' (did you mean 'e_after(...)'?)

  rfsm.trans { src = "a", tgt = "b", events = { "e" }, guard = true },
--> chart.lua:6: root.trans[4].guard (a -> b): function expected, got boolean

  rfsm.trans { src = "a", tgt = "b", events = { "e" }, guard = "x > 1" },
--> chart.lua:6: root.trans[4].guard (a -> b): function expected, got string 'x > 1'

  rfsm.trans { src = "a", tgt = "b", events = { "e" }, effect = 1 },
--> chart.lua:6: root.trans[4].effect (a -> b): function expected, got number 1

  { src = "a", tgt = "b", events = { "e" } },
--> WARNING: chart.lua:1: root.4: a plain table that has 'src' and 'tgt' is ignored (did
    you mean rfsm.trans{...}?)

  c = rfsm.state { rfsm.trans { src = "a", tgt = "b", events = { "e" } } },
--> WARNING: chart.lua:6: root.c.trans[1] (a -> b): src 'a': no state or connector is
    named 'a' in 'root.c' (did you mean 'root.a'?)
--> WARNING: chart.lua:6: root.c.trans[1] (a -> b): tgt 'b': no state or connector is
    named 'b' in 'root.c' (did you mean 'root.b'?)
--> WARNING: chart.lua:6: root.c: a transition inside a leaf state

  c = rfsm.state { rfsm.trans { src = "root.a", tgt = "root.b", events = { "e" } } },
--> WARNING: chart.lua:6: root.c: a transition inside a leaf state

  c = rfsm.state { rfsm.trans { src = "initial", tgt = "x" } },
--> WARNING: chart.lua:6: root.c.trans[1] (initial -> x): src 'initial': no state or
    connector is named 'initial' in 'root.c'
--> WARNING: chart.lua:6: root.c.trans[1] (initial -> x): tgt 'x': no state or connector
    is named 'x' in 'root.c'
--> WARNING: chart.lua:6: root.c: a transition inside a leaf state

  k = rfsm.conn { x = rfsm.state {} }, rfsm.trans { src = "k", tgt = "a" },
--> WARNING: chart.lua:6: root.k: a connector holds no state, 'x' is ignored

  c = rfsm.state { x = rfsm.state {}, rfsm.trans { src = "initial", tgt = "x" } },
  rfsm.trans { src = "c", tgt = "a", events = { "e_done" } },
--> WARNING: chart.lua:7: root.trans[4] (c -> a): 'e_done' never fires here, 'root.c' is
    no leaf state

  c = rfsm.state { x = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "x", events = { "e" } } },
--> WARNING: chart.lua:7: root.c.initial: each transition from here has events or a
    guard, 'root.c' cannot be entered while none of them is enabled

  c = rfsm.state { x = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "x", guard = function() end } },
--> WARNING: chart.lua:7: root.c.initial: each transition from here has events or a
    guard, 'root.c' cannot be entered while none of them is enabled

  getevents = {},
--> chart.lua:1: root.getevents: function expected, got table

  get_events = function() end,
--> WARNING: chart.lua:1: root: a state has no field 'get_events' (did you mean
    'getevents'?)

  idle_hook = true,
--> chart.lua:1: root.idle_hook: function expected, got boolean

  dbg = "yes",
--> chart.lua:1: root.dbg: function, true or false expected, got string 'yes'

  err = 5,
--> chart.lua:1: root.err: function, true or false expected, got number 5

  [true] = rfsm.trans { src = "a", tgt = "b", events = { "e" } },
--> chart.lua:6: root.true (a -> b): the key of a transition is a position or a name

  _t = rfsm.trans { src = "a", tgt = "b", events = { "e" } },
--> chart.lua:6: root._t (a -> b): the name of a transition must not start with '_'

  exit = rfsm.trans { src = "a", tgt = "b", events = { "e" } },
--> chart.lua:6: root.exit (a -> b): a transition cannot have this name, it is a field
    of every state

  rfsm.trans("a", "b"),
--> raises chart.lua:6: rfsm.trans: table expected, got string

  c = rfsm.state { final = true },
-->

  c = rfsm.state {},
--> WARNING: no outgoing transitions from node 'root.c'

return rfsm.state { a = rfsm.state {} }
--> chart.lua:1: root: the root needs an initial transition (rfsm.trans{ src='initial',
    tgt=... })

return { a = {} }
--> raises rfsm.load: no valid rfsm in file 'chart.lua' found. (did you mean: return
    rfsm.state{...}?)

return rfsm.trans { src = "a", tgt = "b" }
--> raises rfsm.load: no valid rfsm in file 'chart.lua' found. (did you mean: return
    rfsm.state{...}?)

local chart = rfsm.state { a = rfsm.state {} }
--> raises rfsm.load: no valid rfsm in file 'chart.lua' found. (a chart ends with:
    return rfsm.state{...})

return rfsm.state { initial = "a", a = rfsm.state {} }
--> chart.lua:1: root.initial: connector expected, got string 'a' (rfsm.trans{
    src='initial', tgt=... })
--> chart.lua:1: root: the root needs an initial transition (rfsm.trans{ src='initial',
    tgt=... })

local inner = rfsm.state {}
inner.again = inner
return rfsm.state { inner = inner, rfsm.trans { src = "initial", tgt = "inner" } }
--> chart.lua:1: root.inner.again: a state cannot contain itself
--> chart.lua:3: root.trans[1] (initial -> inner): tgt 'root.inner': the composite has
    no initial transition (rfsm.trans{ src='initial', tgt=... })

return rfsm.state { a = rfsm.state {},
  transitions = { rfsm.trans { src = "initial", tgt = "a" } } }
--> chart.lua:1: root: the root needs an initial transition (rfsm.trans{ src='initial',
    tgt=... })

return rfsm.state { states = { a = rfsm.state {} },
  rfsm.trans { src = "initial", tgt = "a" } }
--> WARNING: chart.lua:1: root.states: a plain table that contains states or transitions
    is ignored (did you mean rfsm.state{...}?)
--> WARNING: chart.lua:2: root.trans[1] (initial -> a): src 'initial': no state or
    connector is named 'initial' in 'root'
--> WARNING: chart.lua:2: root.trans[1] (initial -> a): tgt 'a': no state or connector
    is named 'a' in 'root'
--> WARNING: chart.lua:1: root: a transition inside a leaf state

  c = rfsm.state { exits = "north" },
  rfsm.trans { src = "c", tgt = "a", events = { "e" }, speed = 3 },
-->

  warn = 5,
--> chart.lua:1: root.warn: function, true or false expected, got number 5

  k = rfsm.conn {}, rfsm.trans { src = "k", tgt = "a", events = { "e_done" } },
--> WARNING: chart.lua:6: root.trans[4] (k -> a): 'e_done' never fires here, 'root.k' is
    no leaf state

  c = rfsm.state { x = rfsm.state {}, rfsm.trans { src = "initial", tgt = "x" },
    doo = function() end },
--> chart.lua:6: root.c.doo: only a leaf state can have a doo

  ["c\\d"] = rfsm.conn {},
--> chart.lua:6: root.c\d: the name of a connector must not be empty, contain '.' or '\'
    or start with '_'

  [""] = rfsm.state {},
--> chart.lua:6: root.: the name of a state must not be empty, contain '.' or '\' or
    start with '_'

  rfsm.trans { src = "c", tgt = "b", events = { "e" } },
  c = rfsm.state { doo = 5, exit = "off", entry = 1 },
  rfsm.trans { src = "nowhere", tgt = "neither" },
--> chart.lua:7: root.c.doo: function expected, got number 5
--> chart.lua:7: root.c.entry: function expected, got number 1
--> chart.lua:7: root.c.exit: function expected, got string 'off'
--> chart.lua:8: root.trans[5] (nowhere -> neither): src 'nowhere': no state or
    connector is named 'nowhere' in 'root' (there are 'a', 'b', 'c', 'initial')
--> chart.lua:8: root.trans[5] (nowhere -> neither): tgt 'neither': no state or
    connector is named 'neither' in 'root' (there are 'a', 'b', 'c', 'initial')

  rfsm.trans { src = "a", tgt = "root.b.", events = { "e" } },
--> chart.lua:6: root.trans[4] (a -> root.b.): tgt 'root.b.': no state or connector is
    named '' in 'root.b'

  rfsm.trans { src = "a", tgt = "", events = { "e" } },
--> chart.lua:6: root.trans[4] (a -> ): tgt '': no state or connector is named '' in
    'root' (there are 'a', 'b', 'initial')

  rfsm.trans { src = "a", tgt = "b", events = function() end },
--> chart.lua:6: root.trans[4].events (a -> b): list of events or a string expected, got
    function

  c = rfsm.state, d = rfsm.conn,
--> WARNING: chart.lua:1: root.c: rfsm.state is not called (rfsm.state{...})
--> WARNING: chart.lua:1: root.d: rfsm.conn is not called (rfsm.conn{...})

  c = rfsm.conn { entry = function() end }, rfsm.trans { src = "a", tgt = "c" },
  rfsm.trans { src = "c", tgt = "b" },
--> WARNING: chart.lua:6: root.c.entry: a connector has no entry, this one is ignored

  _segment = 5, _pre_hooks = {}, _mine = 1,
--> WARNING: chart.lua:1: root._pre_hooks: the machine has a field of this name, this
    one is ignored
--> WARNING: chart.lua:1: root._segment: the machine has a field of this name, this one
    is ignored

  rfsm.trans { src = "a", tgt = "b", events = { "e_after(soon)" } },
--> WARNING: chart.lua:6: root.trans[4].events (a -> b): no loaded extension knows
    'e_after(soon)' (require "rfsm_timeevent")

]]

-- Returns what is said of a chart file: raised, to err, or to warn. That nothing leaves
-- a node is left out where nobody expects it.
local function said_of(text, has_dead_ends)
  local name, lines = helper.file_with(text), {}
  local function note(line)
    line = tostring(line):gsub(name:gsub("%W", "%%%0"), "chart.lua")
    if has_dead_ends or not line:find("no outgoing", 1, true) then
      lines[#lines + 1] = line
    end
  end
  local ok, model = pcall(rfsm.load, name)
  if not ok then
    note("raises " .. model)
    return lines
  end
  model.info, model.err = false, model.err or false
  if model.warn == nil then model.warn = note end
  local _, problems = rfsm.init(model)
  for _, problem in ipairs(problems or {}) do note(problem) end
  return lines
end

describe("a mistake:", function()
  after_each(helper.remove_files)

  for case in MISTAKES:gmatch("(.-)\n\n") do
    local text, said = case:match("^(.-)\n(%-%->.*)$")
    local expected = {}
    for line in (said:gsub("\n    ", " ") .. "\n"):gmatch("%-%-> ([^\n]+)\n") do
      expected[#expected + 1] = line
    end
    it(text:gsub("%s+", " "):sub(1, 70), function()
      local is_whole = text:find("^return") or text:find("^local")
      assert.same(expected, said_of(is_whole and text or RIGHT:format(text),
        said:find("no outgoing", 1, true)))
    end)
  end
end)
