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

-- A chart, then `-->` before each problem, `--W` before each warning, in order. Nothing
-- behind the arrow: there is nothing to say. A location is in chart.lua, and words in
-- capitals stand for these texts:
local WORDS = {
  T = "6: root.trans[4]", NODE = "the name of a state or connector expected",
  NONE = "no state or connector is named", INITIAL = "(rfsm.trans{ src='initial', "
    .. "tgt=... })", LIST = "list of events or a string expected",
  RULES = "must not be empty, contain '.' or '\\' or start with '_'",
  CLOSED = "each transition from here has events or a guard, ",
}

local MISTAKES = [[
  rfsm.trans { tgt = "a", events = { "e" } },
--> T: src is missing, NODE
  rfsm.trans { src = "a", events = { "e" } },
--> T: tgt is missing, NODE
  rfsm.trans { src = "a", tgt = "bb", events = { "e" } },
--> T (a -> bb): tgt 'bb': NONE 'bb' in 'root' (did you mean 'b'?)
  rfsm.trans { src = "A", tgt = "b", events = { "e" } },
--> T (A -> b): src 'A': NONE 'A' in 'root' (did you mean 'a'?)
  rfsm.trans { src = "a", tgt = "zzzzzz", events = { "e" } },
--> T (a -> zzzzzz): tgt 'zzzzzz': NONE 'zzzzzz' in 'root' (there are 'a', 'b',
    'initial')
  rfsm.trans { from = "a", to = "b", events = { "e" } },
--> T: src is missing, NODE (there is 'from', did you mean 'src'?)
--> T: tgt is missing, NODE (there is 'to', did you mean 'tgt'?)
  rfsm.trans { source = "a", target = "b", events = { "e" } },
--> T: src is missing, NODE (there is 'source', did you mean 'src'?)
--> T: tgt is missing, NODE (there is 'target', did you mean 'tgt'?)
  rfsm.trans { "a", "b", events = { "e" } },
--> T: src is missing, NODE
--> T: tgt is missing, NODE
  rfsm.trans { src = "a", tgt = { "b" }, events = { "e" } },
--> T: tgt: name of a state or connector expected, got table
  rfsm.trans { src = 1, tgt = "b", events = { "e" } },
--> T: src: name of a state or connector expected, got number 1
  rfsm.trans { src = a, tgt = b, events = { "e" } },
--> T: src is missing, NODE
--> T: tgt is missing, NODE
  rfsm.trans { src = "a", tgt = rfsm.state {}, events = { "e" } },
--> T: tgt: the table given is no part of this model
  rfsm.trans { src = "a", tgt = "b.x", events = { "e" } },
--> T (a -> b.x): tgt 'b.x': NONE 'x' in 'root.b'
  rfsm.trans { src = "a", tgt = "root.c.x", events = { "e" } },
--> T (a -> root.c.x): tgt 'root.c.x': NONE 'c' in 'root' (there are 'a', 'b',
    'initial')
  rfsm.trans { src = "a", tgt = "c", events = { "e" } }, c = {},
--> T (a -> c): tgt 'c': 'root.c' is no state or connector but a table (did you mean
    rfsm.state{...}?)
  rfsm.trans { src = "a", tgt = "c", events = { "e" } }, c = { x = rfsm.state {} },
--> T (a -> c): tgt 'c': 'root.c' is no state or connector but a table (did you mean
    rfsm.state{...}?)
  rfsm.trans { src = "a", tgt = "c", events = { "e" } }, c = function() end,
--> T (a -> c): tgt 'c': 'root.c' is no state or connector but a function
  c = rfsm.state { x = rfsm.state {} },
  rfsm.trans { src = "a", tgt = "c", events = { "e" } },
--> 7: root.trans[4] (a -> c): tgt 'root.c': the composite has no initial transition
    INITIAL
  c = rfsm.state { x = rfsm.state {}, rfsm.trans { src = "initial", tgt = "y" } },
--> 6: root.c.trans[1] (initial -> y): tgt 'y': NONE 'y' in 'root.c' (there are
    'initial', 'x')
  c = rfsm.state { x = rfsm.state {}, rfsm.trans { src = "initial", tgt = "x" },
    rfsm.trans { src = "x", tgt = "b", events = { "e" } } },
--> 7: root.c.trans[2] (x -> b): tgt 'b': NONE 'b' in 'root.c' (did you mean 'root.b'?)
  c = rfsm.state { x = rfsm.state {}, initial = "x" },
--> 6: root.c.initial: connector expected, got string 'x' INITIAL
  c = rfsm.state { x = rfsm.state {}, initial = rfsm.state {} },
--> 6: root.c.initial: connector expected, got state
  rfsm.trans { src = "intial", tgt = "a" },
--> T (intial -> a): src 'intial': NONE 'intial' in 'root' (did you mean 'initial'?)
  initial = "a",
--> 1: root.initial: connector expected, got string 'a' INITIAL
  ["c.d"] = rfsm.state {},
--> 6: root.c.d: the name of a state RULES
  _c = rfsm.state {},
--> 6: root._c: the name of a state RULES
  rfsm.state {},
--> 6: root.4: a state needs a name (name = ...)
  rfsm.conn {},
--> 6: root.4: a connector needs a name (name = ...)
  entry = rfsm.state {},
--> 6: root.entry: a state cannot have this name, it is a field of every state
  dbg = rfsm.state {},
--> 6: root.dbg: a state cannot have this name, it is a field of every root
--> 1: root.dbg: function, true or false expected, got state
  c = rfsm.state { entry = "led" },
--> 6: root.c.entry: function expected, got string 'led'
  c = rfsm.state { exit = true },
--> 6: root.c.exit: function expected, got boolean
  c = rfsm.state { doo = {} },
--> 6: root.c.doo: function expected, got table
  doo = function() end,
--> 1: root.doo: only a leaf state can have a doo
  c = rfsm.state { initial = rfsm.conn {}, x = rfsm.state {} },
--W 6: root.c.initial: no transition leaves it (rfsm.trans{ src='initial', tgt=... })
  c = rfsm.state { enter = function() end },
--W 6: root.c: a state has no field 'enter' (did you mean 'entry'?)
  c = rfsm.state { on_entry = function() end },
--W 6: root.c: a state has no field 'on_entry' (did you mean 'entry'?)
  c = rfsm.state { onExit = function() end },
--W 6: root.c: a state has no field 'onExit' (did you mean 'exit'?)
  c = rfsm.state { Entry = function() end },
--W 6: root.c: a state has no field 'Entry' (did you mean 'entry'?)
  c = rfsm.state { ["do"] = function() end },
--W 6: root.c: a state has no field 'do' (did you mean 'doo'?)
  c = rfsm.state { during = function() end },
--W 6: root.c: a state has no field 'during' (did you mean 'doo'?)
  c = rfsm.state { leave = function() end },
--W 6: root.c: a state has no field 'leave' (did you mean 'exit'?)
  c = rfsm.state { enrty = function() end },
--W 6: root.c: a state has no field 'enrty' (did you mean 'entry'?)
  c = rfsm.state { on_enter_idle = function() end },
--W 6: root.c: a state has no field 'on_enter_idle' (did you mean 'entry'?)
  c = rfsm.state { onLeaveIdle = function() end },
--W 6: root.c: a state has no field 'onLeaveIdle' (did you mean 'exit'?)
  c = rfsm.state { always = { { target = "b", cond = "isHot" } } },
--W 6: root.c: a state has no field 'always' (a transition beside the state: rfsm.trans{
    src, tgt, always = true })
  c = rfsm.state { after = { [1000] = "b" } },
--W 6: root.c: a state has no field 'after' (a transition beside the state: events = {
    'e_after(SECONDS)' })
  c = rfsm.state { before = function() end },
--W 6: root.c: a state has no field 'before' (the effect of a transition runs before the
    entry)
  c = rfsm.state { conditions = { function() end } },
--W 6: root.c: a state has no field 'conditions' (guard = function() ... end, of a
    transition)
  c = rfsm.state { unless = function() end },
--W 6: root.c: a state has no field 'unless' (guard = function() ... end, of a
    transition)
  c = rfsm.state { validators = function() end },
--W 6: root.c: a state has no field 'validators' (guard = function() ... end, of a
    transition)
  c = rfsm.state { invoke = { src = function() end, onDone = "b" } },
--W 6: root.c: a state has no field 'invoke' (did you mean 'doo'?)
  c = rfsm.state { always = true, after = 5, before = "noon", invoke = {} },
-->
  rfsm.trans { src = "a", tgt = "b", events = { "e" }, before = function() end },
--W T (a -> b): a transition has no field 'before' (did you mean 'effect'?)
  rfsm.trans { src = "a", tgt = "b", events = { "e" }, validators = function() end },
--W T (a -> b): a transition has no field 'validators' (did you mean 'guard'?)
  rfsm.trans { src = "a", tgt = "b", event = "e" },
--W T (a -> b): a transition has no field 'event' (did you mean 'events'?)
  rfsm.trans { src = "a", tgt = "b", Events = { "e" } },
--W T (a -> b): a transition has no field 'Events' (did you mean 'events'?)
  rfsm.trans { src = "a", tgt = "b", evnts = { "e" } },
--W T (a -> b): a transition has no field 'evnts' (did you mean 'events'?)
  rfsm.trans { src = "a", tgt = "b", on = "e" },
--W T (a -> b): a transition has no field 'on' (did you mean 'events'?)
  rfsm.trans { src = "a", tgt = "b", events = { "e" }, cond = function() end },
--W T (a -> b): a transition has no field 'cond' (did you mean 'guard'?)
  rfsm.trans { src = "a", tgt = "b", events = { "e" }, condition = function() end },
--W T (a -> b): a transition has no field 'condition' (did you mean 'guard'?)
  rfsm.trans { src = "a", tgt = "b", events = { "e" }, gaurd = function() end },
--W T (a -> b): a transition has no field 'gaurd' (did you mean 'guard'?)
  rfsm.trans { src = "a", tgt = "b", events = { "e" }, action = function() end },
--W T (a -> b): a transition has no field 'action' (did you mean 'effect'?)
  rfsm.trans { src = "a", tgt = "b", events = { "e" }, prio = 1 },
--W T (a -> b): a transition has no field 'prio' (did you mean 'pn'?)
  rfsm.trans { src = "a", tgt = "b", events = { "e" }, priority = 1 },
--W T (a -> b): a transition has no field 'priority' (did you mean 'pn'?)
  rfsm.trans { src = "a", tgt = "b", events = { "e" }, PN = 1 },
--W T (a -> b): a transition has no field 'PN' (did you mean 'pn'?)
  rfsm.trans { src = "a", tgt = "b", events = { "e" }, pn = "1" },
--> T.pn (a -> b): number expected, got string '1'
  rfsm.trans { src = "a", tgt = "b", events = 5 },
--> T.events (a -> b): LIST, got number 5
  rfsm.trans { src = "a", tgt = "b", events = true },
--> T.events (a -> b): LIST, got boolean
  rfsm.trans { src = "a", tgt = "b", events = { nil, "e" } },
--> T.events (a -> b): list of events expected, got a table with holes or keys
  rfsm.trans { src = "a", tgt = "b", events = { go = "e", back = "f" } },
--> T.events (a -> b): list of events expected, got a table with holes or keys
  rfsm.trans { src = "a", tgt = "b", events = { no_such_name } },
--W T.events (a -> b): an empty list, any event triggers it (is a name in it nil? if any
    event is meant, leave it out)
  rfsm.trans { src = "a", tgt = "b", events = { 0/0 } },
--> T.events[1] (a -> b): an event cannot be NaN
  rfsm.trans { src = "a", tgt = "b", events = { "e_after(1)" } },
--W T.events (a -> b): no loaded extension knows 'e_after(1)' (require "rfsm_timeevent")
  rfsm.trans { src = "a", tgt = "b", events = "e_at(1)" },
--W T.events (a -> b): no loaded extension knows 'e_at(1)' (require "rfsm_timeevent")
  rfsm.trans { src = "a", tgt = "b", events = { "await(e_a, e_b)" } },
--W T.events (a -> b): no loaded extension knows 'await(e_a, e_b)' (require
    "rfsm.await")
  rfsm.trans { src = "a", tgt = "b", events = { "after(1)" } },
--W T.events (a -> b): no loaded extension knows 'after(1)' (did you mean
    'e_after(...)'?)
  rfsm.trans { src = "a", tgt = "b", events = { "e" }, guard = true },
--> T.guard (a -> b): function expected, got boolean
  rfsm.trans { src = "a", tgt = "b", events = { "e" }, guard = "x > 1" },
--> T.guard (a -> b): function expected, got string 'x > 1'
  rfsm.trans { src = "a", tgt = "b", events = { "e" }, effect = 1 },
--> T.effect (a -> b): function expected, got number 1
  { src = "a", tgt = "b", events = { "e" } },
--W 1: root.4: a plain table that has 'src' and 'tgt' is ignored (did you mean
    rfsm.trans{...}?)
  c = rfsm.state { rfsm.trans { src = "a", tgt = "b", events = { "e" } } },
--W 6: root.c: a transition inside a leaf state
  c = rfsm.state { rfsm.trans { src = "root.a", tgt = "root.b", events = { "e" } } },
--W 6: root.c: a transition inside a leaf state
  c = rfsm.state { rfsm.trans { src = "initial", tgt = "x" } },
--W 6: root.c: a transition inside a leaf state
  c = rfsm.seqand { x = a, rfsm.trans { src = "x", tgt = "x" } },
--W 6: root.c: a transition in a sequential AND state, it belongs into a region (none
    leads from one region to another)
  k = rfsm.conn { x = rfsm.state {} }, rfsm.trans { src = "k", tgt = "a" },
--W 6: root.k: a connector holds no state, 'x' is ignored
  c = rfsm.state { x = rfsm.state {}, rfsm.trans { src = "initial", tgt = "x" } },
  rfsm.trans { src = "c", tgt = "a", events = { "e_done" } },
--W 7: root.trans[4] (c -> a): 'e_done' never fires here, no leaf right in 'root.c' is
    final (final = true)
  c = rfsm.state { x = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "x", events = { "e" } } },
--W 7: root.c.initial: CLOSED'root.c' cannot be entered while none of them is enabled
  c = rfsm.state { x = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "x", guard = function() end } },
--W 7: root.c.initial: CLOSED'root.c' cannot be entered while none of them is enabled
  getevents = {},
--> 1: root.getevents: function expected, got table
  get_events = function() end,
--W 1: root: a state has no field 'get_events' (did you mean 'getevents'?)
  idle_hook = true,
--> 1: root.idle_hook: function expected, got boolean
  dbg = "yes",
--> 1: root.dbg: function, true or false expected, got string 'yes'
  err = 5,
--> 1: root.err: function, true or false expected, got number 5
  [true] = rfsm.trans { src = "a", tgt = "b", events = { "e" } },
--> 6: root.true (a -> b): the key of a transition is a position or a name
  _t = rfsm.trans { src = "a", tgt = "b", events = { "e" } },
--> 6: root._t (a -> b): the name of a transition must not start with '_'
  exit = rfsm.trans { src = "a", tgt = "b", events = { "e" } },
--> 6: root.exit (a -> b): a transition cannot have this name, it is a field of every
    state
  rfsm.trans("a", "b"),
--> raises chart.lua:6: rfsm.trans: table expected, got string 'a'
  c = rfsm:state {},
--> raises chart.lua:6: rfsm.state: table expected, got the library (rfsm.f, not rfsm:f)
  c = rfsm.state { final = true },
-->
  c = rfsm.state {},
--W no outgoing transitions from node 'root.c'
return rfsm.state { a = rfsm.state {} }
--> 1: root: the root needs an initial transition INITIAL
local a = rfsm.state {} -- a root in a tail call has the line of the last return
return rfsm.state { a = a }
--> 2: root: the root needs an initial transition INITIAL
return { a = {} }
--> raises rfsm.load: no valid rfsm in file 'chart.lua' found. (did you mean: return
    rfsm.state{...}?)
return rfsm.trans { src = "a", tgt = "b" }
--> raises rfsm.load: no valid rfsm in file 'chart.lua' found. (did you mean: return
    rfsm.state{...}?)
return 7
--> raises rfsm.load: no valid rfsm in file 'chart.lua' found. (a chart ends with:
    return rfsm.state{...})
return function() return rfsm.state { a = rfsm.state {} } end
--> raises rfsm.load: no valid rfsm in file 'chart.lua' found. (return the state that it
    makes)
local chart = rfsm.state { a = rfsm.state {} }
--> raises rfsm.load: no valid rfsm in file 'chart.lua' found. (a chart ends with:
    return rfsm.state{...})
return rfsm.state { initial = "a", a = rfsm.state {} }
--> 1: root.initial: connector expected, got string 'a' INITIAL
--> 1: root: the root needs an initial transition INITIAL
local inner = rfsm.state {}
inner.again = inner
return rfsm.state { inner = inner, rfsm.trans { src = "initial", tgt = "inner" } }
--> 1: root.inner.again: a state cannot contain itself
--> 3: root.trans[1] (initial -> inner): tgt 'root.inner': the composite has no initial
    transition INITIAL
return rfsm.state { a = rfsm.state {},
  transitions = { rfsm.trans { src = "initial", tgt = "a" } } }
--> 1: root: the root needs an initial transition INITIAL
return rfsm.state { states = { a = rfsm.state {} },
  rfsm.trans { src = "initial", tgt = "a" } }
--W 1: root.states: a plain table that contains states or transitions is ignored (they
    stand in the state itself)
--W 1: root: a transition inside a leaf state
  c = rfsm.state { exits = "north" },
  rfsm.trans { src = "c", tgt = "a", events = { "e" }, speed = 3 },
-->
  warn = 5,
--> 1: root.warn: function, true or false expected, got number 5
  k = rfsm.conn {}, rfsm.trans { src = "k", tgt = "a", events = { "e_done" } },
--W T (k -> a): 'e_done' never fires here, 'root.k' is no leaf state
  c = rfsm.state { x = rfsm.state {}, rfsm.trans { src = "initial", tgt = "x" },
    doo = function() end },
--> 6: root.c.doo: only a leaf state can have a doo
  ["c\\d"] = rfsm.conn {},
--> 6: root.c\d: the name of a connector RULES
  [""] = rfsm.state {},
--> 6: root.: the name of a state RULES
  rfsm.trans { src = "c", tgt = "b", events = { "e" } },
  c = rfsm.state { doo = 5, exit = "off", entry = 1 },
  rfsm.trans { src = "nowhere", tgt = "neither" },
--> 7: root.c.doo: function expected, got number 5
--> 7: root.c.entry: function expected, got number 1
--> 7: root.c.exit: function expected, got string 'off'
--> 8: root.trans[5] (nowhere -> neither): src 'nowhere': NONE 'nowhere' in 'root'
    (there are 'a', 'b', 'c', 'initial')
--> 8: root.trans[5] (nowhere -> neither): tgt 'neither': NONE 'neither' in 'root'
    (there are 'a', 'b', 'c', 'initial')
  rfsm.trans { src = "a", tgt = "root.b.", events = { "e" } },
--> T (a -> root.b.): tgt 'root.b.': NONE '' in 'root.b'
  rfsm.trans { src = "a", tgt = "", events = { "e" } },
--> T (a -> ): tgt '': NONE '' in 'root' (there are 'a', 'b', 'initial')
  rfsm.trans { src = "a", tgt = "b", events = function() end },
--> T.events (a -> b): LIST, got function
  c = rfsm.state, d = rfsm.conn,
--W 1: root.c: rfsm.state is not called (rfsm.state{...})
--W 1: root.d: rfsm.conn is not called (rfsm.conn{...})
  c = rfsm.state { on = { e_x = "b", e_y = "a" } },
--W 6: root.c.on: a state has no field 'on' (beside it: rfsm.trans{ src = 'c', tgt =
    'b', events = { 'e_x' } })
  c = rfsm.state { transitions = { [7] = "a" } },
--W 6: root.c.transitions: a state has no field 'transitions' (beside it: rfsm.trans{
    src = 'c', tgt = 'a', events = { '7' } })
  c = rfsm.state { on = { e_x = "none" }, transitions = { { "b" } }, mine = { "b" } },
-->
  on = { e_x = "b" },
-->
  c = rfsm.conn { entry = function() end }, rfsm.trans { src = "a", tgt = "c" },
  rfsm.trans { src = "c", tgt = "b" },
--W 6: root.c.entry: a connector has no entry, this one is ignored
  _phase = 5, _pre_hooks = {}, _mine = 1, _source_hooks = 5,
--W 1: root._phase: the machine has a field of this name, this one is ignored
--W 1: root._pre_hooks: the machine has a field of this name, this one is ignored
--W 1: root._source_hooks: the machine has a field of this name, this one is ignored
  rfsm.trans { src = "a", tgt = "b", events = { "e_after(soon)" } },
--W T.events (a -> b): no loaded extension knows 'e_after(soon)' (require
    "rfsm_timeevent")
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
  local _, _, problems = rfsm.init(model)
  for _, problem in ipairs(problems or {}) do note(problem) end
  return lines
end

-- Returns the lines that a case expects.
local function expected_of(said)
  local expected = {}
  for i, line in ipairs(said) do
    local kind, text = line:match("^%-%-([>W]) ?(.*)$")
    text = text:gsub("%u+", WORDS):gsub("^%d+: ", "chart.lua:%0")
    expected[i] = text ~= "" and (kind == "W" and "WARNING: " or "") .. text or nil
  end
  return expected
end

describe("a mistake:", function()
  after_each(helper.remove_files)

  local code, said = {}, {}
  local function check()
    local text, expected = table.concat(code, "\n"), expected_of(said)
    it(text:gsub("%s+", " "):sub(1, 70), function()
      local is_whole = text:find("^return") or text:find("^local")
      assert.same(expected, said_of(is_whole and text or RIGHT:format(text),
        table.concat(expected):find("no outgoing", 1, true)))
    end)
    code, said = {}, {}
  end

  for line in MISTAKES:gmatch("([^\n]*)\n") do
    if line:find("^%-%-[>W]") then
      said[#said + 1] = line
    elseif said[1] and line:find("^    ") then
      said[#said] = said[#said] .. line:sub(4)
    else
      if said[1] then check() end
      code[#code + 1] = line
    end
  end
  check()
end)
