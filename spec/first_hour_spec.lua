-- The first hour: what a new user writes, and what `rfsm check`, init, a strict machine
-- or the library's functions have to say.

local helper = require "spec.helper"
local chart = require "rfsm.shared.chart"
local review = require "rfsm.cli.review"
local rfsm = require "rfsm"
local source = require "rfsm.checks.source"
require "rfsm_timeevent"
require "rfsm.await"

-- A chart is in chart.lua, where state and trans are those of rfsm, INITIAL the way to
-- `a` and BACK that from b to a. `events: e_x` are sent to it, strictly, each with its
-- run; with - it is not run. A program has `lamp`, a strict machine that is in off.
local HEAD = "local state, trans = rfsm.state, rfsm.trans "
local PARTS = {
  INITIAL = 'trans { src = "initial", tgt = "a" }',
  BACK = 'trans { src = "b", tgt = "a", events = { "e_go" } }',
}

-- Behind a chart or program: `--C` before each line of `rfsm check`, `--S` before what
-- a strict machine warns of, reports to `err`, or raises.
local MISTAKES = [==[
== busy_doo
-- events: e_go
return state { a = state { doo = function() while true do coroutine.yield()
  end end }, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } }, BACK }
--C : ok
--S WARNING: rfsm.run has made 10000 iterations and goes on, in 'root.a': its doo is
    never idle (rfsm.yield(true) lets run return)
--S raised: and goes on
== callback_arguments
-- events: e_go e_go
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" }, effect = function(events)
    print("first", events[1]) end },
  trans { src = "b", tgt = "a", events = { "e_go" }, guard = function(fsm, events)
    return fsm.speed < 3 end } }
--C :3: warning: root.trans[2] (a -> b): parameter 1 of the effect, 'events', is the
    machine (effect(fsm, tr, _, events, event)) [parameters]
--C :5: warning: root.trans[3] (b -> a): parameter 1 of the guard, 'fsm', is the
    transition (guard(tr, events, event)) [parameters]
--S GUARD error executing guard of T={ src='root.b', tgt='root.a', events='e_go' }:
    :6: attempt to compare nil with number
== event_done
-- events:
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "done" } },
  BACK }
--C :3: warning: root.trans[2] (a -> b): no other transition uses 'done' (did you mean
    'e_done'?) [typo]
== event_e_Done_capital
-- events:
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_Done" } },
  BACK }
--C :3: warning: root.trans[2] (a -> b): no other transition uses 'e_Done' (did you
    mean 'e_done'?) [typo]
== event_e_done_at_a
-- events:
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_done@a" } },
  BACK }
--C :3: warning: root.trans[2] (a -> b): event 'e_done@a' never comes, 'a' is no FQN
    of this machine (did you mean 'e_done@root.a'?) [never-done]
== event_star
-- events: e_any
return state { a = state {}, b = state {},
  INITIAL, trans { src = "a", tgt = "b", events = { "*" } },
  trans { src = "b", tgt = "a", events = { "e_x" } } }
--C :2: warning: root.trans[2] (a -> b): '*' is the name of one event, no pattern (a
    function in events accepts several; leave events out for any event) [odd-event]
--S WARNING: no transition names the event 'e_any' (there are '*', 'e_x')
== events_as_list
rfsm.send_events(lamp, { "e_on" })
--S WARNING: main.lua:1: a list is one event (did you mean rfsm.send_events(fsm,
    unpack(list))?)
== goto_state
rfsm.goto_state(lamp, "on")
--S WARNING: main.lua:1: rfsm has no function 'goto_state' (a machine moves by its
    transitions: send an event)
--S raised: main.lua:1: attempt to call a nil value (field 'goto_state')
== guard_without_else
-- events: e_go
local speed = 9
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" }, guard = function()
    if speed < 3 then return true end end },
  trans { src = "b", tgt = "a", events = { "e_back" } } }
--C :4: warning: root.trans[2] (a -> b): the guard never returns false, and only false
    forbids (return false, or a comparison) [no-value]
== history_shallow
-- events: e_next e_pause e_pause
return state { off = state {}, on = state { history = "shallow", x = state {},
  y = state {},
    trans { src = "initial", tgt = "x" }, trans { src = "x", tgt = "y",
      events = { "e_next" } } },
  trans { src = "initial", tgt = "on" },
  trans { src = "on", tgt = "off", events = { "e_pause" } },
  trans { src = "off", tgt = "on", events = { "e_pause" } } }
--C :1: warning: root.on: a state has no field 'history' (require "rfsm.history")
    [unknown-field]
--S WARNING: :1: root.on: a state has no field 'history' (require "rfsm.history")
== history_true
-- events: e_next e_pause e_pause
return state { off = state {}, on = state { history = true, x = state {},
  y = state {},
    trans { src = "initial", tgt = "x" }, trans { src = "x", tgt = "y",
      events = { "e_next" } } },
  trans { src = "initial", tgt = "on" },
  trans { src = "on", tgt = "off", events = { "e_pause" } },
  trans { src = "off", tgt = "on", events = { "e_pause" } } }
--C :1: warning: root.on: a state has no field 'history' (require "rfsm.history")
    [unknown-field]
== method_run
lamp:run()
--S WARNING: main.lua:1: a machine has no field 'run' (did you mean rfsm.run(fsm)?)
--S raised: main.lua:1: attempt to call a nil value (method 'run')
== model_changed_late
model.on.entry = function() end
rfsm.send_events(lamp, "e_on")
rfsm.run(lamp)
--S WARNING: root.on.entry: was set in the model after rfsm.init (set it in
    the machine)
== name_parent_folder
-- events: e_off
return state { off = state {}, on = state { x = state {},
    trans { src = "initial", tgt = "x" }, trans { src = "x", tgt = "../off",
      events = { "e_off" } } },
  trans { src = "initial", tgt = "on" }, trans { src = "off", tgt = "on",
    events = { "e_go" } } }
--C :2: root.on.trans[2] (x -> ../off): tgt '../off': no state or connector is named
    '/off' in 'root.on' (did you mean 'root.off'?)
== name_with_slash
-- events: e_off
return state { on = state { x = state {}, trans { src = "initial", tgt = "x" } },
  off = state {},
  trans { src = "initial", tgt = "on" }, trans { src = "off", tgt = "on",
    events = { "e_on" } },
  trans { src = "on/x", tgt = "off", events = { "e_off" } } }
--C :5: root.trans[3] (on/x -> off): src 'on/x': no state or connector is named 'on/x'
    in 'root' (did you mean 'root.on.x'?)
== name_without_dot
-- events: e_go
return state { outer = state { off = state {},
    on = state { x = state {}, trans { src = "initial", tgt = "x" } },
    trans { src = "initial", tgt = "off" }, trans { src = "off", tgt = "on",
      events = { "e_go" } },
    trans { src = "on.x", tgt = "off", events = { "e_back" } } },
  trans { src = "initial", tgt = "outer" } }
--C :5: root.outer.trans[3] (on.x -> off): src 'on.x': no state or connector is named
    'on' in 'root' (did you mean 'root.outer.on.x'?)
== nil_event
rfsm.send_events(lamp, e_on)
--S WARNING: main.lua:1: argument 1 is nil, which is no event (is it a name without
    quotes?)
== number_or_text
local fsm = strict(rfsm.state { a = rfsm.state { final = true },
  b = rfsm.state { final = true }, rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { 1 } } })
rfsm.send_events(fsm, "1")
--S WARNING: main.lua:4: no transition names the event '1' (did you mean the number 1?)
== parallel_true
-- events: e_go
local function arm() return state { x = state {}, trans { src = "initial",
  tgt = "x" } } end
return state { both = state { parallel = true, left = arm(), right = arm() },
  trans { src = "initial", tgt = "both" } }
--C :4: root.trans[1] (initial -> both): tgt 'root.both': the composite has no initial
    transition (rfsm.trans{ src='initial', tgt=... }) (did you mean rfsm.seqand{...}?)
== plain_tables
-- events: e_go
return state { a = { entry = function() print "a" end }, b = {}, z = {}, m = {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } },
  trans { src = "z", tgt = "m", events = { "e_go" } } }
--C :1: warning: root: a transition inside a leaf state ('a', 'b', 'm', 'z' are plain:
    did you mean rfsm.state{...}?) [misplaced]
--S WARNING: :1: root: a transition inside a leaf state ('a', 'b', 'm', 'z' are plain:
    did you mean rfsm.state{...}?)
--S WARNING: no transition names the event 'e_go'
== plain_transitions
-- events: e_go
return state { a = state {}, b = state {},
  { src = "initial", tgt = "a" }, { src = "a", tgt = "b", events = { "e_go" } } }
--C :1: root: the root needs an initial transition (rfsm.trans{ src='initial', tgt=...
    })
--C :1: warning: root.1: a plain table that has 'src' and 'tgt' is ignored (did you
    mean rfsm.trans{...}?) [unmarked]
--C :1: warning: root.2: a plain table that has 'src' and 'tgt' is ignored (did you
    mean rfsm.trans{...}?) [unmarked]
== print_called_at_load
-- events: e_go
return state { a = state { entry = print "a" }, b = state { entry = print "b" },
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } },
  BACK }
--C :1: warning: root: print was called while the chart was loaded, and left no entry
    (entry = function() print(...) end) [called]
== region_as_source
-- events: e_x
require "rfsm_seqand"
local function arm() return state { x = state {}, trans { src = "initial",
  tgt = "x" } } end
return state { both = rfsm.seqand { left = arm(), right = arm(),
    trans { src = "left", tgt = "right", events = { "e_x" } } },
      trans { src = "initial", tgt = "both" } }
--C :4: warning: root.both: a transition in a sequential AND state, it belongs into a
    region (none leads from one region to another) [misplaced]
--S WARNING: :4: root.both: a transition in a sequential AND state, it belongs into a
    region (none leads from one region to another)
--S WARNING: no outgoing transitions from node 'root.x'
--S WARNING: no outgoing transitions from node 'root.x'
--S WARNING: no outgoing transitions from node 'root.both'
--S WARNING: no transition names the event 'e_x'
== state_added_late
lamp.broken = rfsm.state {}
rfsm.run(lamp)
--S WARNING: root.broken: a state that was added after rfsm.init is not
    looked at (did you mean rfsm.fsm_merge?)
== state_declared_twice
-- events: e_x
return state { a = state { entry = function() print "first" end }, b = state {},
  a = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_x" } },
  trans { src = "b", tgt = "a", events = { "e_x" } } }
--C :1: warning: root: 'a' stands twice, the first one is lost (the second is in line
    2) [lost]
== state_declared_twice_below
-- events: e_x

return state {
  a = state { entry = function() print "first" end }, b = state {},
  a = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_x" } },
  trans { src = "b", tgt = "a", events = { "e_x" } } }
--C :2: warning: root: 'a' stands twice, the first one is lost (the second is in line
    4) [lost]
== states_list
-- events: e_go
return state { initial = "a", states = { a = state {}, b = state {} },
  trans { src = "a", tgt = "b", events = { "e_go" } } }
--C :1: root.initial: connector expected, got string 'a' (rfsm.trans{ src='initial',
    tgt=... })
--C :1: warning: root.states: a plain table that contains states or transitions is
    ignored (they stand in the state itself) [unmarked]
--C :1: warning: root: a transition inside a leaf state (move it to the composite
    around) [misplaced]
== two_events_one_run
rfsm.send_events(lamp, "e_on", "e_off")
rfsm.run(lamp)
--S WARNING: event 'e_off' came together with another one and is discarded, 'root.on'
    waits for it (call rfsm.run before it is sent)
== type_final_parallel
-- events: e_x
return state { a = state {}, b = state { type = "parallel", regions = { state {} } },
  c = state { type = "final" },
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_x" } }, trans { src = "b", tgt = "c",
    events = { "e_x" } } }
--C :1: warning: root.b.regions: a plain table that contains states or transitions is
    ignored (did you mean rfsm.seqand{...}?) [unmarked]
--C :1: warning: root.b: a state has no field 'type' (did you mean rfsm.seqand{...}?)
    [unknown-field]
--C :2: warning: root.c: a state has no field 'type' (did you mean final = true?)
    [unknown-field]
--S WARNING: :1: root.b.regions: a plain table that contains states or transitions is
    ignored (did you mean rfsm.seqand{...}?)
--S WARNING: no outgoing transitions from node 'root.c'
== unknown_event
rfsm.send_events(lamp, "on")
--S WARNING: main.lua:1: 'on' is the name of a state, no event (did you mean 'e_on'?)
== yield_in_entry
-- events: e_go
return state { a = state { entry = function() rfsm.yield() end }, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } }, BACK }
--C :1: warning: root.a: the entry calls rfsm.yield (only a doo may yield) [wrong-call]
--S ENTRY error executing entry of root.a: attempt to yield
== z1
-- events:
local E = { GO = "e_go" }
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { E.GOO } },
  trans { src = "b", tgt = "a", events = { E.GO } } }
--C :4: warning: root.trans[2].events (a -> b): an empty list, any event triggers it
    (is a name in it nil? if any event is meant, leave it out) [empty-events]
--S WARNING: :4: root.trans[2].events (a -> b): an empty list, any event triggers it
    (is a name in it nil? if any event is meant, leave it out)
== guard_among_events
-- events: e_go
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go", guard = function()
    return true end } },
  trans { src = "b", tgt = "a", events = { "e_back" } } }
--C :3: root.trans[2].events (a -> b): list of events expected, got a table with holes
    or keys ('guard' belongs beside events)
== event_by_position
-- events: e_other
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", "e_go" },
  trans { src = "b", tgt = "a", events = { "e_back" } } }
--C :3: warning: root.trans[2] (a -> b): 'e_go' stands beside the events, any event
    triggers it (events = { 'e_go' }) [unknown-field]
--S WARNING: :3: root.trans[2] (a -> b): 'e_go' stands beside the events, any event
    triggers it (events = { 'e_go' })
--S WARNING: no transition names the event 'e_other' (there is 'e_back')
== function_below
-- events: e_go
local chart = state { a = state {}, b = state { entry = on_entry },
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } },
  BACK }
function on_entry() print "in b" end
return chart
--C :1: warning: undefined global 'on_entry' (nil while the chart is loaded)
== guard_called
-- events: e_go
local function is_ready() if os.time() < 0 then return true end end
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" }, guard = is_ready() },
  BACK }
--C :4: warning: root.trans[2] (a -> b): is_ready was called while the chart was
    loaded, and left no guard (guard = function() return is_ready(...) end) [called]
== guard_returns_zero
-- events: e_go
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" }, guard = function()
    return 0 end },
  BACK }
--C :3: warning: root.trans[2] (a -> b): the guard never returns false, and only false
    forbids (return false, or a comparison) [no-value]
== guard_returns_nil
-- events: e_go
local ready
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" }, guard = function()
    if not ready then return nil end return true end },
  BACK }
--C :4: warning: root.trans[2] (a -> b): the guard never returns false, and only false
    forbids (return false, or a comparison) [no-value]
== send_without_machine
-- events: e_go
return state { a = state { exit = function() rfsm.send_events("e_left") end },
  b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } },
  trans { src = "b", tgt = "a", events = { "e_left" } } }
--C :1: warning: root.a: rfsm.send_events gets the machine first
    (rfsm.send_events(fsm, ...)) [wrong-call]
--S EXIT error executing exit of root.a: rfsm.send_events: initialised fsm expected,
    got string 'e_left'
== run_in_a_callback
-- events: e_go
return state { a = state {}, b = state { entry = function(fsm) rfsm.send_events(fsm,
  "e_back") rfsm.run(fsm) end },
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } },
  trans { src = "b", tgt = "a", events = { "e_back" } } }
--C :1: warning: root.b: the entry calls rfsm.run of its machine, whose step is under
    way (rfsm.send_events is enough, its events are taken next) [wrong-call]
--S ENTRY error executing entry of root.b: rfsm.run: the machine is in the middle of a
    step; if its coroutine is never resumed, rfsm.init(fsm) makes a fresh machine
== method_in_a_callback
-- events: e_go
return state { a = state {}, b = state { entry = function(fsm)
  fsm:send_events("e_back") end },
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } },
  trans { src = "b", tgt = "a", events = { "e_back" } } }
--C :1: warning: root.b: a machine has no method 'send_events' (rfsm.send_events(fsm,
    ...)) [wrong-call]
--S WARNING: :2: a machine has no field 'send_events' (did you mean
    rfsm.send_events(fsm)?)
--S ENTRY error executing entry of root.b: :2: attempt to call a nil value (method
    'send_events')
== choice
-- events: e_go
return state { a = state {}, b = state {}, c = rfsm.choice {},
  INITIAL, trans { src = "a", tgt = "c", events = { "e_go" } },
  trans { src = "c", tgt = "b" } }
--C :1: attempt to call a nil value (field 'choice') (did you mean rfsm.conn?)
== stat_misspelt
-- events: e_go
return state { a = rfsm.sate {}, b = state {},
  INITIAL, trans { src = "a", tgt = "b", events = { "e_go" } } }
--C :1: attempt to call a nil value (field 'sate') (did you mean rfsm.state?)
== src_star
-- events: e_fault
return state { run = state { a = state {}, INITIAL }, fault = state { final = true },
  trans { src = "initial", tgt = "run" },
  trans { src = "*", tgt = "fault", events = { "e_fault" } } }
--C :3: root.trans[2] (* -> fault): src '*': no state or connector is named '*' in
    'root' (for each of its states: a transition of the composite around them)
== timeout_field
-- events: e_go
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", timeout = 5 },
  BACK }
--C :3: warning: root.trans[2] (a -> b): a transition has no field 'timeout', any
    event triggers it (events = { 'e_after(5)' }) [unknown-field]
--S WARNING: :3: root.trans[2] (a -> b): a transition has no field 'timeout', any
    event triggers it (events = { 'e_after(5)' })
== after_with_unit
-- events: e_go
require "rfsm_timeevent"
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_after(5s)" } },
  BACK }
--C :4: warning: root.trans[2].events (a -> b): 'e_after(5s)': seconds expected, as in
    e_after(0.5) [init]
--S WARNING: :4: root.trans[2].events (a -> b): 'e_after(5s)': seconds expected, as in
    e_after(0.5)
== after_as_key
-- events: e_go
require "rfsm_timeevent"
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { e_after = 5 } },
  BACK }
--C :4: root.trans[2].events (a -> b): list of events expected, got a table with holes
    or keys (did you mean { 'e_after(5)' }?)
== final_text
-- events: e_go
return state { a = state {}, b = state { final = "yes" },
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } } }
--C :1: warning: root.b: final: true expected, got string 'yes' (final = true)
    [unknown-field]
--S WARNING: :1: root.b: final: true expected, got string 'yes' (final = true)
== state_called_final
-- events: e_go
return state { a = state {},
  INITIAL,
  trans { src = "a", tgt = "final", events = { "e_go" } } }
--C :3: root.trans[2] (a -> final): tgt 'final': no state or connector is named
    'final' in 'root' (an end is a state with final = true)
== seqand_order_misspelt
-- events: e_go
require "rfsm_seqand"
local function arm() return state { x = state { final = true },
  trans { src = "initial", tgt = "x" } } end
return state { both = rfsm.seqand { order = { "left", "rihgt" }, left = arm(),
  right = arm() }, off = state { final = true },
  trans { src = "initial", tgt = "both" }, trans { src = "both", tgt = "off",
    events = { "e_go" } } }
--C :4: rfsm.seqand: order[2]: name of a region expected, got string 'rihgt' (there
    are 'left', 'right')
== transition_into_region
-- events: e_go
require "rfsm_seqand"
local function arm() return state { x = state { final = true },
  trans { src = "initial", tgt = "x" } } end
return state { both = rfsm.seqand { left = arm(), right = arm() },
  off = state { final = true },
  trans { src = "initial", tgt = "both" }, trans { src = "both.left.x", tgt = "off",
    events = { "e_go" } } }
--C :6: root.trans[2] (both.left.x -> off): src 'both.left.x': no state or connector
    is named 'left' in 'root.both' (a region is a machine of its own: no transition
    leads into or out of it)
== event_table_in_events
-- events: e_go
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { { name = "e_paid" } } },
  BACK }
--C :3: warning: root.trans[2] (a -> b): a table is equal to itself only (did you mean
    rfsm.named 'e_paid'?) [odd-event]
== getevents_string
-- events: e_go
local once = true
return state { getevents = function()
  if once then once = false return "e_go" end return {} end,
  a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } },
  trans { src = "b", tgt = "a", events = { "e_back" } } }
--C : ok
--S raised: rfsm.step: getevents: list of events expected, got string 'e_go'
== dbg_module
-- events: e_go
local rfsmpp = require "rfsmpp"
return state { dbg = rfsmpp, a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } },
  BACK }
--C :2: root.dbg: function, true or false expected, got table
== doo_waits_in_a_loop
-- events: -
local ready = false
return state { a = state { doo = function() while not ready do end end },
  b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } },
  BACK }
--C :2: warning: root.a: a loop in the doo has no end and no yield (call rfsm.yield()
    in its loop) [no-yield]
== doo_sends_forever
-- events: e_go
return state { a = state { doo = function(fsm) while true do rfsm.send_events(fsm,
  "e_tick") rfsm.yield(true) end end }, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } },
  BACK }
--C : ok
--S WARNING: :1: no transition names the event 'e_tick' (there is 'e_go')
--S WARNING: rfsm.run has made 10000 iterations and goes on, in 'root.a': event
    'e_tick' comes again and again
--S raised: and goes on
== entries_send_each_other
-- events: e_go
return state {
  a = state { entry = function(fsm) rfsm.send_events(fsm, "e_go") end },
  b = state { entry = function(fsm) rfsm.send_events(fsm, "e_back") end },
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } },
  trans { src = "b", tgt = "a", events = { "e_back" } } }
--C : ok
--S WARNING: rfsm.run has made 10000 iterations and goes on, in 'root.a', 'root.b':
    events 'e_back', 'e_go' come again and again
--S raised: and goes on
== doo_is_coroutine
-- events: e_go
return state { a = state { doo = coroutine.create(function() end) }, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } },
  BACK }
--C :1: root.a.doo: function expected, got thread
== entry_gets_state_first
-- events: e_go
return state { a = state {}, b = state { entry = function(state)
  print("in " .. state._id) end },
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_go" } },
  BACK }
--C :1: warning: root.b: parameter 1 of the entry, 'state', is the machine (entry(fsm,
    state, _, event)) [parameters]
== transition_named_by_event
-- events: e_go
return state { a = state { on = { e_go = "b" } }, b = state {},
  INITIAL,
  BACK }
--C :1: warning: root.a.on: a state has no field 'on' (beside it: rfsm.trans{ src =
    'a', tgt = 'b', events = { 'e_go' } }) [unknown-field]
--C :1: warning: root.b: unreachable, no path of transitions leads here (see which
    transition leads to it, or remove it) [unreachable]
--S WARNING: :1: root.a.on: a state has no field 'on' (beside it: rfsm.trans{ src =
    'a', tgt = 'b', events = { 'e_go' } })
--S WARNING: no outgoing transitions from node 'root.a'
== events_and_are_all
-- events: e_a
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "e_a and e_b" } },
  BACK }
--C :3: warning: root.trans[2] (a -> b): 'e_a and e_b' is one event with a blank in
    its name (write a string for each: events = { "e_a", "e_b" }) [odd-event]
--S WARNING: no transition names the event 'e_a' (there are 'e_a and e_b',
    'e_go')
== event_negated
-- events: e_x
return state { a = state {}, b = state {},
  INITIAL,
  trans { src = "a", tgt = "b", events = { "!e_stop" } },
  trans { src = "b", tgt = "a", events = { "e_stop" } } }
--C :3: warning: root.trans[2] (a -> b): '!e_stop' is the name of one event, no
    pattern (a function in events accepts several; leave events out for any event)
    [odd-event]
--S WARNING: no transition names the event 'e_x' (there are '!e_stop',
    'e_stop')
== init_of_a_name
rfsm.init("lamp.lua")
--S raised: main.lua:1: invalid fsm model passed to rfsm.init: state expected, got
    string 'lamp.lua' (did you mean rfsm.load?)
== load_without_lua
rfsm.load "examples/on_off"
--S raised: rfsm.load: cannot open examples/on_off (did you mean 'examples/on_off.lua'?)
== run_of_a_model
rfsm.run(model)
--S raised: rfsm.run: initialised fsm expected, got state (rfsm.init makes one of a
    state)
== send_event
rfsm.send_event(lamp, "e_on")
--S WARNING: main.lua:1: rfsm has no function 'send_event' (did you mean
    rfsm.send_events?)
--S raised: main.lua:1: attempt to call a nil value (field 'send_event')
== step_with_an_event
rfsm.step(lamp, "e_on")
--S raised: rfsm.step: number of steps expected, got string 'e_on' (did you mean
    rfsm.send_events?)
== run_with_an_event
rfsm.run(lamp, "e_on")
--S WARNING: main.lua:1: rfsm.run takes a machine only (did you mean rfsm.send_events?)
== is_in_misspelt
rfsm.is_in(lamp, "of")
--S raised: rfsm.is_in: state of the machine expected, got string 'of' (there are
    'root', 'root.off', 'root.on')
== named_event_as_text
local fsm = strict(rfsm.state { a = rfsm.state {}, b = rfsm.state { final = true },
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { rfsm.named "e_paid" } } })
rfsm.send_events(fsm, "e_paid")
--S WARNING: main.lua:4: no transition names the event 'e_paid' (did you mean { name =
    'e_paid' }?)
== data_without_name
local fsm = strict(rfsm.state { a = rfsm.state {}, b = rfsm.state { final = true },
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { rfsm.named "e_paid" } } })
rfsm.send_events(fsm, { event = "e_paid", amount = 12 })
--S WARNING: main.lua:4: the table has no field 'name' (did you
    mean name = 'e_paid' in place of 'event'?)
]==]

-- Returns the lines of `rfsm check`, without exploration.
local function checked(name)
  local required, model, warnings = review.noting_extensions(chart.load, name)
  if not model then return { warnings } end
  return (review.of(name, model, warnings, {}, { static = true, required = required }))
end

-- Makes a machine strict, with a list of what it says.
local function listen(model, said)
  local function note(...)
    said[#said + 1] = table.concat(helper.texts(...), " "):gsub("%s+", " ")
  end
  model.strict, model.info, model.warn, model.err = true, false, note, note
  return model
end

-- Runs f with the machine of a model, and a limit for a run that does not end.
local function with_limit(said, model, f)
  local count = 0
  local fsm = rfsm.init(listen(model, said))
  if not fsm then return helper.clear(said) end -- rfsm check has the same lines
  rfsm.pre_step_hook_add(fsm, function()
    count = count + 1
    if count > 10100 then error("and goes on", 0) end
  end)
  local ok, problem = pcall(f, fsm)
  if not ok then said[#said + 1] = "raised: " .. tostring(problem) end
end

local function run_chart(said, name, events)
  local ok, model = pcall(rfsm.load, name)
  if not ok then return end -- rfsm check has reported it
  with_limit(said, model, function(fsm)
    rfsm.run(fsm)
    for event in events:gmatch("%S+") do
      rfsm.send_events(fsm, event)
      rfsm.run(fsm)
    end
  end)
end

local function lamp_model()
  return rfsm.state { off = rfsm.state {}, on = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "off" },
    rfsm.trans { src = "off", tgt = "on", events = { "e_on" } },
    rfsm.trans { src = "on", tgt = "off", events = { "e_off" } } }
end

local function run_program(said, text)
  local model = lamp_model()
  with_limit(said, model, function(fsm)
    rfsm.run(fsm)
    local load = rawget(_G, "loadstring") or load
    local function strict(other)
      local machine = rfsm.init(listen(other, said))
      rfsm.run(machine)
      return machine
    end
    assert(load("local lamp, model, strict = ... " .. text, "=main.lua"))(fsm, model,
      strict)
  end)
end

-- The Luas have different words for some failures.
local function as_in_all_luas(line, file)
  return (helper.without_file(line:gsub(file, ""))
    :gsub("call (%l+) '([%w_]+)' %(a nil value%)", "call a nil value (%1 '%2')")
    :gsub(":%d+: (attempt to yield).*", "%1")
    :gsub("( error .*)%f[:]:%d+: (rfsm%.)", "%1%2")
    :gsub("^S raised: [%w.]+:%d+: (rfsm%.)", "S raised: %1")
    :gsub("(attempt to yield) .*", "%1"):gsub(": No such file or directory", ""))
end

-- Returns what is said of a mistake, with marks.
local function said_of(text)
  local lines, said, events = {}, {}, text:match("^%-%- events:([^\n]*)\n")
  local file = "chart%.lua"
  if not events then
    run_program(said, text)
  else
    text = HEAD .. text:gsub("^[^\n]*\n", ""):gsub("%f[%u]%u+%f[%U]", PARTS)
    local name = helper.file_with(text)
    helper.printed(function()
      for _, line in ipairs(checked(name)) do lines[#lines + 1] = "C " .. line end
      if events ~= " -" then run_chart(said, name, events) end
    end)
    file = name:gsub("%W", "%%%0")
  end
  for _, line in ipairs(said) do lines[#lines + 1] = "S " .. line end
  for i, line in ipairs(lines) do lines[i] = as_in_all_luas(line, file) end
  return lines
end

-- Calls f(name, text, said) for each mistake.
local function each_mistake(f)
  local name, text, said
  for line in (MISTAKES .. "\n== "):gmatch("([^\n]*)\n?") do
    local next_name = line:match("^== (.*)$")
    if next_name then
      if name then f(name, table.concat(text, "\n"), said) end
      name, text, said = next_name, {}, {}
    elseif line:find("^%-%-[CS] ") then
      said[#said + 1] = line:sub(3)
    elseif said[1] then
      said[#said] = said[#said] .. line:sub(4)
    else
      text[#text + 1] = line
    end
  end
end

describe("in the first hour", function()
  after_each(helper.remove_files)

  each_mistake(function(name, text, said)
    it(name:gsub("_", " ") .. " is told", function()
      if not source.is_there then return pending("no luacheck") end
      assert.same(said, said_of(text))
    end)
  end)
end)
