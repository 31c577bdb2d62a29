-- A session of the simulator in this process: lines typed, what is printed.

local helper = require "spec.helper"
local rfsm = require "rfsm"

local MODULES = { "observe.breakpoints", "sim.commands", "sim.drawing",
  "sim.history", "sim.observer", "sim.prompt", "sim.session",
  "sim.simulator", "sim.terminal", "sim.time" }

local printed = {} -- lines, those of stderr with a "!"

-- Loads the modules of the simulator with another print.
local function load_simulator()
  local none, modules = {}, {}
  for _, name in ipairs(MODULES) do none["rfsm." .. name] = false end
  helper.with(package.loaded, none, function()
    helper.with(_G, { print = function(...)
      printed[#printed + 1] = table.concat(helper.texts(...), "\t")
    end }, function()
      for _, name in ipairs(MODULES) do modules[name] = require("rfsm." .. name) end
    end)
  end)
  return modules
end

local loaded = load_simulator()
local history, prompt, session, terminal = loaded["sim.history"],
  loaded["sim.prompt"], loaded["sim.session"], loaded["sim.terminal"]

local stderr = {}
function stderr.write(_, ...) printed[#printed + 1] = "! " .. table.concat { ... } end

-- Returns what `case.input` prints with `case.chart`.
local function said(case)
  history.BYTES, printed = case.bytes, {}
  local sim
  helper.with(io, { stderr = stderr }, function()
    local file = helper.file_with(case.chart)
    sim = assert(session.open(file, case.follows or false))
    prompt.install(sim)
    function sim.env.change() helper.write(file, case.other) end
    local recording = helper.file_with("")
    function sim.env.record_here() history.save(sim, recording) end
    function sim.env.replay_it() history.replay(sim, recording) end
    for line in case.input:gmatch("[^\n]+") do
      local ok, problem = prompt.evaluate(sim, line, "=stdin")
      if not ok then printed[#printed + 1] = "! " .. problem end
    end
  end)
  history.BYTES = nil
  local text = table.concat(printed, "\n") .. "\n"
  text = text:gsub("\27%[[%d;]*m", ""):gsub("%-nan", "nan")
  return (text:gsub("active: (%S+)\nqueue: ", "at %1"):gsub(" *\n+", "\n"))
end

local function check(cases)
  for _, case in ipairs(cases) do
    it(case.does, function() assert.equal(case.output, said(case)) end)
  end
end

after_each(helper.remove_files)

-- a --e_go--> b --e_go--> c --e_go--> a, and more
local function ring(more)
  return [[
local rfsm = require "rfsm"
return rfsm.state { warn = false, info = false, ]] .. (more or "") .. [[
  a = rfsm.state {}, b = rfsm.state {}, c = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_go" } },
  rfsm.trans { src = "b", tgt = "c", events = { "e_go" } },
  rfsm.trans { src = "c", tgt = "a", events = { "e_go" } },
}]]
end

-- a --e_paid{..}--> b --e_x--> a
local PAID = [[
local rfsm = require "rfsm"
return rfsm.state { warn = false, info = false, a = rfsm.state {}, b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { rfsm.named "e_paid" },
    guard = function(_, events) return events[1].amount > 9 end },
  rfsm.trans { src = "b", tgt = "a", events = { "e_x" } },
}]]

describe("an event with data", function()
  check {
    { does = "is asked for where a text is sent, at a terminal", chart = PAID,
      follows = true, input = [=[
se e_paid
]=], output = [=[
! no transition names the event 'e_paid' (did you mean 'e_paid{}'?)
queue:  e_init_fsm, e_paid
]=] },
    { does = "is `event` in conditions at it, and where it leads", chart = PAID,
      input = [=[
run
breakpoint e_paid if event.amount > 6
breakpoint b if event.amount > 10
breakpoint a -> b if event.amount == 10
ser e_paid{amount=3}
ser e_paid{amount=3} e_paid{amount=7}
ser e_paid{amount=10}
ser e_x
ser e_paid{amount=11}
]=], output = [=[
at root.a(done)
1  event e_paid if event.amount > 6
2  state root.b if event.amount > 10
3  transition root.a -> root.b if event.amount == 10
at root.a(done)
at root.a(done)
stopped at 1: event e_paid if event.amount > 6
at root.b(done) e_done@root.b
stopped at 1: event e_paid if event.amount > 6
stopped at 3: transition root.a -> root.b if event.amount == 10
at root.a(done)
at root.b(done) e_done@root.b
stopped at 1: event e_paid if event.amount > 6
stopped at 2: state root.b if event.amount > 10
]=] },
    { does = "is sent as it is shown", chart = PAID, input = [=[
run
ser e_paid{amount = 1} e_paid{"amount": 12}
ser e_x
se e_paid { amount = 12 }
run
ser e_paid{amount}
]=], output = [=[
at root.a(done)
at root.a(done)
at root.a(done)
queue:  e_paid{amount=12}
at root.b(done)
! data: a text in quotes, a number, true, false or a table expected, got 'amount}'
]=] },
  }
end)

describe("the history", function()
  check {
    { does = "ends where it was left for another way", chart = ring(), input = [=[
run
ses e_go
ses e_go
ses e_go
back 2
history
ses e_go
se e_go
history
goto 5
goto 2
forward
goto 0
]=], output = [=[
at root.a(done)
at root.b(done) e_done@root.b
at root.c(done) e_done@root.c
at root.a(done) e_done@root.a
at root.b(done) e_done@root.b
   1                                  root.a(done)
  >2  e_go                            root.b(done)
   3  e_go                            root.c(done)
   4  e_go                            root.a(done)
at root.c(done) e_done@root.c
queue:  e_done@root.c, e_go
   1                                  root.a(done)
   2  e_go                            root.b(done)
   3  e_go                            root.c(done)
! goto: number of an advance from 0 to 3 expected, got 5
at root.b(done) e_done@root.b
at root.c(done) e_done@root.c, e_go
at <none> e_init_fsm
]=] },
    { does = "forgets what was undone with a reset", chart = ring(),
      input = [=[
run
ses e_go
ses e_go
back 1
reset
goto 4
history
back 9
forward 9
]=], output = [=[
at root.a(done)
at root.b(done) e_done@root.b
at root.c(done) e_done@root.c
at root.b(done) e_done@root.b
at <none> e_init_fsm
! goto: number of an advance from 0 to 3 expected, got 4
   1                                  root.a(done)
   2  e_go                            root.b(done)
   3                                  <none>
at <none> e_init_fsm
at <none> e_init_fsm
]=] },
    { does = "forgets the oldest places", bytes = 3000, chart = ring(), input = [=[
run
for i = 1, 5 do ses 'e_go' end
history
goto 1
goto 6
back 20
back
forward 20
]=], output = [=[
at root.a(done)
at root.b(done) e_done@root.b
at root.c(done) e_done@root.c
at root.a(done) e_done@root.a
at root.b(done) e_done@root.b
at root.c(done) e_done@root.c
   4  e_go                            root.a(done)
   5  e_go                            root.b(done)
   6  e_go                            root.c(done)
! goto: number of an advance from 4 to 6 expected, got 1
at root.c(done) e_done@root.c
at root.a(done) e_done@root.a
! back: nothing was done
at root.c(done) e_done@root.c
]=] },
    { does = "has the events of a recording, also those of timers", chart = ([[
require "rfsm_timeevent"

]] .. ring("gettime = function() return 0, 0 end, rfsm.trans { "
        .. "src = 'b', tgt = 'a', events = { 'e_after(9)' } }, ")), input = [=[
record_here()
run
ser e_go
clock 20
record(false)
replay_it()
history 4
]=], output = [=[
at root.a(done)
at root.b(done)
clock:  9 s
at root.a(done)
clock:  20 s
at root.a(done)
   5  e_done@root.a, e_go             root.b(done)
   6  e_done@root.b                   root.b(done)
   7  e_after(9)@root.b               root.a(done)
   8  e_done@root.a                   root.a(done)
]=] },
    { does = "shows events with their data, also in a replay", chart = ring(
        "rfsm.trans { src = 'a', tgt = 'b', events = { rfsm.named 'e_paid' } }, "),
      input = [=[
record_here()
run
ser { name = "e_paid", amount = 12 }
history 1
record(false)
replay_it()
history 2
]=], output = [=[
at root.a(done)
at root.b(done)
   2  e_paid{amount=12}               root.b(done)
   4  e_done@root.a, e_paid{amount=12}  root.b(done)
   5  e_done@root.b                   root.b(done)
]=] },
    { does = "has the errors of callbacks again in a replay", chart = ring(
        "d = rfsm.state { entry = function() error('no', 0) end }, rfsm.trans { "
        .. "src = 'a', tgt = 'd', events = 'e_d' }, "), input = [=[
record_here()
run
ser e_d
record(false)
replay_it()
]=], output = [=[
at root.a(done)
! ENTRY	error executing entry of root.d: 	no
at root.d(done)
! ENTRY	error executing entry of root.d: 	no
]=] },
    { does = "has no events of the host in dry mode", chart = ring(
        "getevents = function() return { 'e_go' } end, "), input = [=[
dry(true)
step
step
dry(false)
step
]=], output = [=[
at root.a(done) e_done@root.a
at root.a(done)
at root.b(done) e_done@root.b
]=] },
    { does = "shows events that are no texts", chart = ring(), input = [=[
run
ser(true, 1.5)
ser({ 1 })
history 2
]=], output = [=[
at root.a(done)
! no transition names the event 'true'
! no transition names the event '1.5'
at root.a(done)
! no transition names the event '{ 1 }'
at root.a(done)
   2  true, 1.5                       root.a(done)
   3  table                           root.a(done)
]=] },
    { does = "has the advances that failed", chart = ring(
        "pre_step_hook = function(fsm, events) if events[1] == 'e_bad' then "
        .. "error('bad', 0) end end, "), input = [=[
run
ser e_bad
back
ser e_go
history
]=], output = [=[
at root.a(done)
! no transition names the event 'e_bad' (there is 'e_go')
at root.a(done) e_bad
! bad
at root.a(done)
at root.b(done)
   1                                  root.a(done)
   2  e_go                            root.b(done)
]=] },
  }
end)

describe("a doo", function()
  it("ends by Control-C while a line runs, and is the own one afterwards", function()
    local sim = assert(session.open(helper.file_with(ring([[
      d = rfsm.state { doo = function() end }, ]])), false))
    prompt.install(sim)
    local own, seen = sim.fsm.d.doo, {}
    local function wrapped() end
    helper.with(_G, { see = function(doo) seen[#seen + 1] = doo end }, function()
      helper.with(terminal, { is_caught = function() return true end,
        interruptible = function() return wrapped end }, function()
        prompt.evaluate(sim, "see(fsm.d.doo)", "=stdin")
        seen[2] = sim.fsm.d.doo
        prompt.evaluate(sim, "see(fsm.d.doo) error 'x'", "=stdin")
      end)
    end)
    assert.same({ wrapped, own, wrapped, own }, { seen[1], seen[2], seen[3],
      sim.fsm.d.doo })
  end)
end)

describe("the observer", function()
  check {
    { does = "tells nothing of what the library is told to do in Lua", chart = ring(),
      follows = true, input = [=[
breakpoint b
run
rfsm.send_events(fsm, 'e_go', 'e_x')
rfsm.run(fsm)
step
history 1
]=], output = [=[
1  state root.b
taken:  root.initial -> root.a
* root
  * a (done)
    b
    c
at root.a(done)
true
* root
    a
  * b (done)
    c
at root.b(done)
   2                                  root.b(done)
]=] },
    { does = "lists an event once that came twice, and to each region",
      chart = ring([[
  both = rfsm.seqand {
    left = rfsm.state { x = rfsm.state {}, rfsm.trans { src = "initial", tgt = "x" } },
    right = rfsm.state { x = rfsm.state {}, rfsm.trans { src = "initial", tgt = "x" } },
  },
  rfsm.trans { src = "a", tgt = "both", events = { "e_both" } }, ]]), input = [=[
run
ser e_both
follow true
ser e_x e_go e_x
history 1
]=], output = [=[
at root.a(done)
at root.both(active)
! no transition names the event 'e_x' (there are 'e_both', 'e_go')
! no transition names the event 'e_x' (there are 'e_both', 'e_go')
discarded: e_x, e_go ('why e_x' explains)
* root
    a
    b
  * both
    * left
      * x (done)
    * right
      * x (done)
    c
at root.both(active)
   3  e_x, e_go                       root.both(active)
]=] },
    { does = "follows a chart that is loaded again", chart = ring(), other = ring(),
      follows = true, input = [=[
run
change()
reload
ses e_go
]=], output = [=[
taken:  root.initial -> root.a
* root
  * a (done)
    b
    c
at root.a(done)
at root.a(done)
taken:  root.a -> root.b on e_go
* root
    a
  * b (done)
    c
at root.b(done) e_done@root.b
]=] },
  }

  check {
    { does = "knows NaN, which may be an event, but no key of a table", follows = true,
      chart = ring("rfsm.trans { src = 'a', tgt = 'c', effect = function(fsm) "
        .. "rfsm.send_events(fsm, 0/0) end }, "), input = [=[
step
se(0/0)
step
follow(false)
ses(0/0)
]=], output = [=[
taken:  root.initial -> root.a
* root
  * a (done)
    b
    c
at root.a(done) e_done@root.a
! no transition names the event 'nan'
queue:  e_done@root.a, nan
taken:  root.a -> root.c
* root
    a
    b
  * c (done)
at root.c(done) nan, e_done@root.c
! no transition names the event 'nan'
at root.c(done)
]=] },
  }

  it("has no guard, predicate or callback called", function()
    local file = helper.file_with(ring([[
      pre_step_hook = function() called "hook" end,
      rfsm.trans { src = "a", tgt = "c", guard = function()
        called "guard"
        return false
      end, events = { function(event)
        called("predicate " .. event)
        return event == "e_x"
      end } }, ]]))
    local function calls_of(advance)
      local calls = {}
      helper.with(_G, { called = function(what) calls[#calls + 1] = what end }, advance)
      return calls
    end
    local plain = calls_of(function()
      local fsm = rfsm.init(rfsm.load(file))
      rfsm.run(fsm)
      rfsm.send_events(fsm, "e_x", "e_go")
      rfsm.run(fsm)
    end)
    assert.same(plain, calls_of(function()
      local sim = assert(session.open(file, true))
      prompt.install(sim)
      for _, line in ipairs { "breakpoint e_no", "run", "se e_x e_go", "run" } do
        prompt.evaluate(sim, line, "=stdin")
      end
    end))
    assert.same({ "hook", "hook", "predicate e_done@root.a", "hook", "hook",
      "predicate e_x", "guard", "hook", "hook" }, plain)
  end)

  -- Returns the number of VM instructions of an idle step of a chart with some states.
  local function instructions(count)
    local states = {}
    for i = 1, count do states[i] = ("s%d = rfsm.state {},"):format(i) end
    local file, used = helper.file_with(ring(table.concat(states))), 0
    local sim = assert(session.open(file, false))
    prompt.install(sim)
    for _ = 1, 3 do sim.env.run() end
    debug.sethook(function() used = used + 1 end, "", 1)
    sim.env.step()
    debug.sethook()
    return used
  end

  it("costs nothing for states that are not active", function()
    local jit = rawget(_G, "jit")
    if jit then -- compiled code calls no hook
      jit.off()
      jit.flush()
    end
    local few, many = instructions(1), instructions(300)
    if jit then jit.on() end
    assert.equal(few, many)
  end)
end)

describe("a machine that cannot be saved", function()
  check {
    { does = "goes back to no place, and says why", chart = ring(
        "keep = { 'x' }, x = print, "), input = [=[
run
history
back
forward
goto 1
goto 0
fsm.x = 1
ses e_go
back
]=], output = (([=[
at root.a(done)
   1                                  root.a(done)
REASON
! back: REASON
forward: this is the last advance
at root.a(done)
! goto: REASON
! goto: REASON
at root.b(done) e_done@root.b
at root.a(done)
]=]):gsub("REASON", "root.x: a function cannot be saved")) },
  }
end)

describe("the simulated clock", function()
  check {
    { does = "is that of each place", chart = ring(), input = [=[
clock 0
run
clock 1
ses e_go
clock 2
ses e_go
back
clock
back
clock
back
clock
back 9
clock
forward
clock
forward 9
clock
goto 2
clock
goto 3
clock
goto 4
clock
]=], output = [=[
clock:  0 s
at root.a(done)
at root.a(done)
clock:  1 s
at root.a(done)
at root.b(done) e_done@root.b
clock:  3 s
at root.b(done)
at root.c(done) e_done@root.c
at root.b(done)
clock:  3 s
at root.b(done) e_done@root.b
clock:  1 s
at root.a(done)
clock:  1 s
at <none> e_init_fsm
clock:  0 s
at root.a(done)
clock:  0 s
at root.c(done) e_done@root.c
clock:  3 s
at root.a(done)
clock:  0 s
at root.a(done)
clock:  1 s
at root.b(done) e_done@root.b
clock:  1 s
]=] },
    { does = "goes on from the chart's clock to a timer", chart = [[
local rfsm = require "rfsm"
require "rfsm_timeevent"
local sec = 5
return rfsm.state { warn = false, info = false,
  gettime = function() sec = sec + 1 return sec, 7 end,
  a = rfsm.state {}, b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_after(50)" } },
}]], input = [=[
next
run
next
clock
clock 0.5
clock(false)
clock
]=], output = [=[
! next: no timer is armed
at root.a(done)
clock:  50 s
at root.b(done)
clock:  50 s
clock:  50.5 s
at root.b(done)
clock:  real time
]=] },
    { does = "ends after 1000 steps of a doo without end", chart = [[
local rfsm = require "rfsm"
return rfsm.state { warn = false, info = false,
  a = rfsm.state { doo = function(fsm)
    fsm.n = 0
    while true do fsm.n = fsm.n + 1 rfsm.yield() end
  end },
  rfsm.trans { src = "initial", tgt = "a" },
}]], input = [=[
clock 1
fsm.n
]=], output = [=[
clock:  1 s
at root.a(active)
999
]=] },
  }
end)

describe("a run that has no end", function()
  -- a --e_spin--> spin --> spin --e_stop--> a; a --e_busy--> busy, a doo.
  -- Each ends at last, so that this spec does.
  local function endless(more)
    return [[
local rfsm = require "rfsm"
local n = 0
local function goes_on()
  n = n + 1
  return n < 30000
end
return rfsm.state { warn = false, info = false, ]] .. (more or "") .. [[
  a = rfsm.state {}, spin = rfsm.state {},
  busy = rfsm.state { doo = function() while goes_on() do rfsm.yield() end end },
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "spin", events = { "e_spin" } },
  rfsm.trans { src = "spin", tgt = "a", events = { "e_stop" } },
  rfsm.trans { src = "spin", tgt = "spin", guard = goes_on },
  rfsm.trans { src = "a", tgt = "busy", events = { "e_busy" } },
}]]
  end

  local STOPPED = "stopped after 10,000 iterations, 'run' goes on\n"

  check {
    { does = "stops after 10,000 iterations", chart = endless(), input = [=[
run
ser e_spin
history 1
run
ser e_stop
]=], output = [=[
at root.a(done)
at root.spin(done) e_done@root.spin
]=] .. STOPPED .. [=[
   2  e_spin                          root.spin(done)
at root.spin(done) e_done@root.spin
]=] .. STOPPED .. [=[
at root.a(done)
]=] },
    { does = "is told in one line", chart = endless(), follows = true,
      input = "step\nser e_spin", output = [=[
taken:  root.initial -> root.a
* root
  * a (done)
    busy
    spin
at root.a(done) e_done@root.a
taken:  root.a -> root.spin on e_spin
taken:  root.spin -> root.spin
        9999 times
* root
    a
    busy
  * spin (done)
at root.spin(done) e_done@root.spin
]=] .. STOPPED },
    { does = "of a doo stops, too", chart = endless(), input = "step\nser e_busy",
      output = "at root.a(done) e_done@root.a\nat root.busy(active)\n" .. STOPPED },
    { does = "stops earlier at a breakpoint", chart = endless(), input = [=[
step
breakpoint spin
ser e_spin
run
]=], output = [=[
at root.a(done) e_done@root.a
1  state root.spin
at root.spin(done) e_done@root.spin
stopped at 1: state root.spin
at root.spin(done) e_done@root.spin
stopped at 1: state root.spin
]=] },
    { does = "by an idle hook stops, too", input = "run", output = "at root.a(done)\n"
      .. STOPPED, chart = endless "idle_hook = function() assert(goes_on()) end, " },
    { does = "is no step with a number", chart = endless(),
      input = "step\nse e_busy\nstep 10001",
      output = "at root.a(done) e_done@root.a\nqueue:  e_done@root.a, e_busy\n"
        .. "at root.busy(active)\n" },
  }
end)

describe("reload", function()
  local function working(name, more)
    return ring((more or "") .. ([[
      work = rfsm.state { keep = { "n" }, n = 1,
        NAME = rfsm.state {}, other = rfsm.state { keep = { "n" }, n = 1 },
        rfsm.trans { src = "initial", tgt = "NAME" } },
      rfsm.trans { src = "a", tgt = "work", events = { "e_work" } }, ]])
      :gsub("NAME", name))
  end

  check {
    { does = "stays in its state though data is of states that are gone",
      chart = working("one"), other = ring(), input = [=[
run
change()
reload
]=], output = [=[
at root.a(done)
at root.a(done)
]=] },
    { does = "begins anew if the active state is gone", chart = working("one"),
      other = working("two"), input = [=[
run
ser e_work
dbg true
dbg false
change()
reload
history
]=], output = [=[
at root.a(done)
at root.work.one(done)
! rfsm.snapshot: the snapshot holds what the chart lacks: ]=] .. [=[
state root.work.one: the machine begins anew
at <none> e_init_fsm
]=] },
    { does = "keeps data", chart = working("one"), other = working("one", "d = "
      .. "rfsm.state {}, "), input = [=[
run
fsm.work.n = 7
fsm.work.other.n = 8
change()
reload
fsm.work.n + fsm.work.other.n
fsm.d
]=], output = [=[
at root.a(done)
at root.a(done)
15
state root.d (inactive)
]=] },
  }
end)

describe("what is typed", function()
  check {
    { does = "may be words or Lua", chart = ring(), input = [=[
follow true
run
follow false
ser e_go, e_x
se 'e_go' 5 true
se e_init_fsm
goto(1)
goto 9
{ [{ { { 1 } } }] = 1 } == nil
help step
]=], output = [=[
taken:  root.initial -> root.a
* root
  * a (done)
    b
    c
at root.a(done)
! no transition names the event 'e_x' (there is 'e_go')
at root.b(done)
! no transition names the event '5'
! no transition names the event 'true'
queue:  e_go, 5, true
queue:  e_go, 5, true, e_init_fsm
at root.a(done)
! goto: number of an advance from 0 to 2 expected, got 9
false
step([n])    advance by n transitions or doo cycles (1)
Enters the machine when it is called first. Example: step 3
]=] },
    { does = "has its value printed, with texts in tables in quotes", chart = ring(),
      input = "= { [{ 'a' }] = { 'b' }, c = 'd', 'e' }, 'f'",
      output = '{ "e", c = "d", [{ "a" }] = { "b" } }\tf\n' },
    { does = "has complaints of its own", chart = ring(), input = [=[
back
forward
history x
watch(7)
sho
e_go
events
se(nil)
se(nil, 'e_go')
se(e_go)
se(fsm.nothing)
help(7)
stp(1)
breakpoint(rfsm.trans { src = 'a', tgt = 'b' })
]=], output = [=[
! back: nothing was done
forward: this is the last advance
at <none> e_init_fsm
! history: number expected, got string
! watch: expression as a text expected, got number
! nothing is named sho, help() lists the commands
! e_go is an event: 'ser e_go' sends it and runs
step() enters the machine
! event 1 is nil
queue:  e_init_fsm
! event 1 is nil
queue:  e_init_fsm, e_go
! nothing is named e_go, an event is in quotes (did you mean 'e_go'?)
queue:  e_init_fsm, e_go
! event 1 is nil
queue:  e_init_fsm, e_go
! help: no command is named 7, help() lists them
! nothing is named stp (did you mean 'step'?)
! breakpoint: state, event or transition (off -> on) expected, got 'T={ ]=] .. [=[
src='a', tgt='b' }', pp() shows the states
]=] },
    { does = "explains events, and lists discarded ones", chart = ring(),
      follows = true, input = [=[
run
ser e_go e_x
ser e_x
ses e_go
why e_go
why
events
]=], output = [=[
taken:  root.initial -> root.a
* root
  * a (done)
    b
    c
at root.a(done)
! no transition names the event 'e_x' (there is 'e_go')
taken:  root.a -> root.b on e_go
discarded: e_x ('why e_x' explains)
* root
    a
  * b (done)
    c
at root.b(done)
! no transition names the event 'e_x' (there is 'e_go')
discarded: e_x
at root.b(done)
taken:  root.b -> root.c on e_go
* root
    a
    b
  * c (done)
at root.c(done) e_done@root.c
root.trans[4] (c -> a) would be taken on e_go in root.c
  root.trans[4] (c -> a): would be taken
no transition would be taken on e_done@root.c in root.c
  root.trans[4] (c -> a): waits for e_go
e_go
]=] },
    { does = "has the errors of callbacks on stderr", chart = ring(
        "d = rfsm.state { entry = function() error('no', 0) end }, rfsm.trans { "
        .. "src = 'a', tgt = 'd', events = 'e_d' }, "), input = "run\nser e_d",
      output = "at root.a(done)\n! ENTRY\terror executing entry of root.d: \tno\n"
        .. "at root.d(done)\n" },
    { does = "has the nearest event where it asks why", chart = ring(), input = [=[
run
why e_og
why e_go
]=], output = [=[
at root.a(done)
! no transition names the event 'e_og' (did you mean 'e_go'?)
no transition would be taken on e_og in root.a
  root.trans[2] (a -> b): waits for e_go
root.trans[2] (a -> b) would be taken on e_go in root.a
  root.trans[2] (a -> b): would be taken
]=] },
    { does = "stops, and shows values", chart = ring(), input = [=[
breakpoint(fsm.b)
breakpoint a->b
breakpoint b  ->  c
breakpoint(7)
watch fsm._act_leaf
watch { fsm._mode }
watch fsm.nothing
run
ser(7)
ser e_go
ser e_go
breakpoint
delete 3
delete 0
breakpoint root.c
delete
breakpoint
]=], output = [=[
1  state root.b
2  transition root.a -> root.b
3  transition root.b -> root.c
4  event 7
! watch: expression as a text expected, got table
at root.a(done)
watch:  fsm._act_leaf = state root.a (done) (was false)
watch:  fsm.nothing = nil
! no transition names the event '7'
at root.a(done)
watch:  fsm._act_leaf = state root.a (done)
watch:  fsm.nothing = nil
stopped at 4: event 7
at root.b(done) e_done@root.b
watch:  fsm._act_leaf = state root.b (done) (was state root.a (inactive))
watch:  fsm.nothing = nil
stopped at 1: state root.b
stopped at 2: transition root.a -> root.b
at root.c(done) e_done@root.c
watch:  fsm._act_leaf = state root.c (done) (was state root.b (inactive))
watch:  fsm.nothing = nil
stopped at 3: transition root.b -> root.c
1  state root.b
2  transition root.a -> root.b
3  transition root.b -> root.c
4  event 7
5  watch fsm._act_leaf
6  watch fsm.nothing
! delete: number of a breakpoint expected, got 0
6  state root.c
there is none
]=] },
    { does = "stops at each transition with these ends, at one only for its value",
      chart = ring([[
  both = rfsm.seqand { left = rfsm.state { x = rfsm.state {}, y = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "x" },
    rfsm.trans { src = "x", tgt = "y", events = { "e_y" } } } },
  rfsm.trans { src = "a", tgt = "b", events = { "e_go" },
    guard = function() return is_first == true end },
  rfsm.trans { src = "b", tgt = "both", events = { "e_both" } }, ]]), other = ring(),
      input = [=[
breakpoint a -> b
breakpoint(fsm[1])
breakpoint both.left.x -> both.left.y
run
ser e_go
goto 1
is_first = true
ser e_go
ser e_both
ser e_y
change()
reload
breakpoint
]=], output = [=[
1  transition root.a -> root.b
2  transition root.a -> root.b
3  transition root.both.left.x -> root.both.left.y
at root.a(done)
at root.b(done) e_done@root.b
stopped at 1: transition root.a -> root.b
at root.a(done)
at root.b(done) e_done@root.b
stopped at 1: transition root.a -> root.b
stopped at 2: transition root.a -> root.b
at root.both(active)
at root.both(active)
stopped at 3: transition root.both.left.x -> root.both.left.y
! 3 transition root.both.left.x -> root.both.left.y: is gone, and no breakpoint now
! rfsm.snapshot: the snapshot holds what the chart lacks: ]=] .. [=[
state root.both; region root.both.left: the machine begins anew
at <none> e_init_fsm
1  transition root.a -> root.b
2  transition root.a -> root.b
]=] },
    { does = "has no breakpoint at a state that is gone, with a predicate, too",
      chart = ring(), other = [[
return rfsm.state { warn = false, info = false, a = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "a", events = { function() return false end } } }]],
      input = [=[
breakpoint b if tries
change()
reload
breakpoint
]=], output = [=[
1  state root.b if tries
! 1 state root.b if tries: is gone, and no breakpoint now
at <none> e_init_fsm
there is none
]=] },
    { does = "keeps a breakpoint at an initial transition", chart = ring(),
      other = ring(), input = [=[
breakpoint initial -> a
breakpoint
change()
reload
breakpoint
]=], output = [=[
1  transition root.initial -> root.a
1  transition root.initial -> root.a
at <none> e_init_fsm
1  transition root.initial -> root.a
]=] },
    { does = "stops where a condition holds, or fails", chart = ring(), other = ring(),
      input = [=[
tries = 0
breakpoint b if tries > 1
breakpoint a -> b if tries
breakpoint e_go if error('one\ntwo', 0)
breakpoint c if tries == = 1
delete 2
run
ser e_go
delete 2
ser e_go
breakpoint c if tries == 2 and fsm.c._mode == 'done'
se e_go
ses e_go
tries = 2
se e_go e_go
step 9
change()
reload
breakpoint
ser e_go
se e_go
run
delete
tries = nil
]=], output = [=[
1  state root.b if tries > 1
2  transition root.a -> root.b if tries
3  event e_go if error('one\ntwo', 0)
! condition:1: unexpected symbol near '='
at root.a(done)
at root.b(done) e_done@root.b
stopped at 2: event e_go if error('one\ntwo', 0)
! breakpoint 2: one
at root.c(done)
2  state root.c if tries == 2 and fsm.c._mode == 'done'
queue:  e_go
at root.a(done) e_done@root.a
queue:  e_done@root.a, e_go, e_go
at root.b(done) e_done@root.b
stopped at 1: state root.b if tries > 1
at root.b(done) e_done@root.b
1  state root.b if tries > 1
2  state root.c if tries == 2 and fsm.c._mode == 'done'
at root.c(done) e_done@root.c
stopped at 2: state root.c if tries == 2 and fsm.c._mode == 'done'
queue:  e_done@root.c, e_go
at root.a(done)
]=] },
  }
end)

describe("a line", function()
  it("replaces the open ones if Control-C was before it", function()
    local lines = { "for i = 1, 2 do", "x = 1", "for i = 1, 3 do", "local x = i end",
      "if true then" }
    local prompts, i = {}, 0
    local function read(_, text)
      i = i + 1
      prompts[i] = text
      return lines[i], i == 3
    end
    printed = {}
    local sim = session.open(helper.file_with(ring()), false)
    prompt.install(sim)
    helper.with(io, { stderr = stderr }, function()
      helper.with(terminal, { read = read }, function() prompt.converse(sim) end)
    end)
    assert.same({ "> ", ">> ", ">> ", ">> ", "> ", ">> " }, prompts)
    assert.matches("^! stdin:%d: [^\n]*<eof>'?\n$", printed[1])
    assert.is_nil(printed[2])
  end)

  it("is repeated by Enter alone, at a terminal, if it is a command", function()
    for _, follows in ipairs { true, false } do
      local lines = { "step", "", " ", "x = 1", "", "for i = 1, 2 do", "", "end", "" }
      local i = 0
      local sim = session.open(helper.file_with(ring()), follows)
      prompt.install(sim)
      printed = {}
      helper.with(terminal, { read = function()
        i = i + 1
        return lines[i], false
      end }, function() prompt.converse(sim) end)
      assert.equal(follows and 3 or 1, sim.history.at)
    end
  end)
end)
