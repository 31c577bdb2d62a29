-- VM instructions an event:  lua5.1 bench/instructions.lua
--
-- A count hook counts them, so that the figures are the same on each machine. It needs
-- an interpreter that calls the hook at each instruction: not LuaJIT.

package.path = "./?.lua;" .. package.path

local measure = require "bench.measure"
local rfsm = require "rfsm"
local workloads = require "bench.workloads"

local state, trans = rfsm.state, rfsm.trans

-- The instructions of f(n) that each further unit of n takes.
local function per_unit(f, n)
  local count = 0
  local function count_units(units)
    count = 0
    debug.sethook(function() count = count + 1 end, "", 1)
    f(units)
    debug.sethook()
    return count
  end
  f(2000) -- compiles what is compiled as it runs
  local first = count_units(n)
  return (count_units(2 * n) - first) / n
end

local function callback() end

-- A ring of 20 leaves, each with an entry.
local function ring()
  local model = { info = false, warn = false, trans { src = "initial", tgt = "s1" } }
  for i = 1, 20 do
    model["s" .. i] = state { entry = callback }
    model[i + 1] = trans { src = "s" .. i, tgt = "s" .. i % 20 + 1,
      events = { "e_next" } }
  end
  return state(model)
end

local function count_calls(f)
  return per_unit(function(n)
    for _ = 1, n do f() end
  end, 20)
end

local known, making = ring(), count_calls(ring)
print(("%-32s %6.0f"):format("init of 20 states, a known model",
  count_calls(function() return rfsm.init(known) end)))
print(("%-32s %6.0f"):format("init of 20 states, its own model",
  count_calls(function() return rfsm.init(ring()) end) - making))
print(("%-32s %6.1f"):format("KiB of a machine of 20 states",
  measure.bytes_kept(function() return rfsm.init(known) end, 20) / 1024))

-- From here on extensions are loaded, whose preproc functions look at each machine.
local rfsmpp = require "rfsmpp"
local rfsm_timeevent = require "rfsm_timeevent"
local snapshot = require "rfsm.snapshot"

-- Two events in turn.
local function stepping(fsm, one, other)
  local send_events, step = rfsm.send_events, rfsm.step
  rfsm.run(fsm)
  return function(n)
    for _ = 1, n, 2 do
      send_events(fsm, one or "e_b")
      step(fsm)
      send_events(fsm, other or "e_a")
      step(fsm)
    end
  end
end

local function two_leaves(fields)
  local model = {
    info = false, warn = false,
    a = state { entry = callback }, b = state { entry = callback }, c = state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e_b" } },
    trans { src = "b", tgt = "a", events = { "e_a" } },
  }
  for name, value in pairs(fields or {}) do model[name] = value end -- any order: a set
  return rfsm.init(state(model))
end

-- Two composites, entered by `initial` or at the leaf.
local function composites(below)
  local function composite()
    return state { entry = callback, x = state { entry = callback },
      trans { src = "initial", tgt = "x" } }
  end
  return rfsm.init(state {
    info = false, warn = false, a = composite(), b = composite(),
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "root.b" .. below, events = { "e_b" } },
    trans { src = "b", tgt = "root.a" .. below, events = { "e_a" } },
  })
end

local function with_state_hooks()
  local fsm = two_leaves()
  rfsm.entry_hook_add(fsm, fsm.a, callback)
  rfsm.entry_hook_add(fsm, fsm.b, callback)
  return fsm
end

-- Both leaves have two timers, which each event arms anew.
local function with_timers()
  local fields = { gettime = function() return 0, 0 end }
  for i = 4, 7 do
    fields[i] = trans { src = i < 6 and "a" or "b", tgt = "c",
      events = { ("e_after(%d)"):format(i) } }
  end
  return two_leaves(fields)
end

-- A timer of the composite around both.
local function with_pending()
  return rfsm.init(state {
    info = false, warn = false, gettime = function() return 0, 0 end, c = state {},
    m = state {
      a = state { entry = callback }, b = state { entry = callback },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_b" } },
      trans { src = "b", tgt = "a", events = { "e_a" } },
    },
    trans { src = "initial", tgt = "m" },
    trans { src = "m", tgt = "c", events = { "e_after(5)" } },
  })
end

-- 20 states, four areas of four stations; two fields are kept.
local function warehouse()
  local model = { info = false, warn = false, keep = { "order", "count" },
    order = "A-4711", count = 0 }
  for i = 1, 4 do
    local area = state { trans { src = "initial", tgt = "station1" } }
    for j = 1, 4 do
      area["station" .. j] = state { entry = callback }
      area[j + 1] = trans { src = "station" .. j, tgt = "station" .. j % 4 + 1,
        events = { "e_next" } }
    end
    model["area" .. i] = area
    model[i] = trans { src = i == 1 and "initial" or "area" .. i - 1, tgt = "area" .. i,
      events = i > 1 and { "e_area" } or nil }
  end
  return state(model)
end

for _, workload in ipairs(workloads) do
  if workload.name:find "^W[1-5]r?$" then
    print(("%-32s %6.0f"):format(workload.name, per_unit(workload.make(rfsm), 1000)))
  end
end

local base = per_unit(stepping(two_leaves()), 1000)

local function row(name, fsm, one, other)
  local count = per_unit(stepping(fsm, one, other), 1000)
  print(("%-32s %6.0f  x %.2f"):format(name, count, count / base))
end

rfsm_timeevent.set_gettime_hook(function() return 0, 0 end)
row("two leaves", two_leaves())
row("an event that nothing waits for", two_leaves(), "x", "y")
row("post step hook", two_leaves { post_step_hook = callback })
row("pre step hook", two_leaves { pre_step_hook = callback })
row("getevents", two_leaves { getevents = callback })
row("hooks of states", with_state_hooks())
row("a pending timer", with_pending())
row("two timers armed anew", with_timers())
row("dbg that does nothing", two_leaves { dbg = callback })
row("rfsmpp", two_leaves { dbg = rfsmpp.gen_dbgcolor("x", {}, true, callback) })
row("a composite, aimed at its leaf", composites ".x")
row("a composite, by initial", composites "")

-- A step in which nothing happens, without and with a transition that needs no event.
local function idling(more)
  local fsm = rfsm.init(state { info = false, warn = false, a = state {},
    trans { src = "initial", tgt = "a" }, more })
  rfsm.run(fsm)
  return count_calls(function() rfsm.step(fsm) end)
end

print(("%-32s %6.0f"):format("idle step", idling()))
print(("%-32s %6.0f"):format("idle step, always", idling(trans { src = "a", tgt = "a",
  always = true, guard = rfsm.borrows(function() return false end) })))

-- `send; run`, the loop of most hosts: two leaves without callbacks, and what is added.
local function running(fields, change)
  local model = { info = false, warn = false, a = state {}, b = state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e" } },
    trans { src = "b", tgt = "a", events = { "e" } } }
  for name, value in pairs(fields or {}) do model[name] = value end -- any order: a set
  local fsm = rfsm.init(state(model))
  if change then change(fsm) end
  rfsm.run(fsm)
  return function(n)
    for _ = 1, n do
      rfsm.send_events(fsm, "e")
      rfsm.run(fsm)
    end
  end
end

local function add_hooks(count)
  return function(fsm)
    for _ = 1, count do
      rfsm.post_step_hook_add(fsm, rfsm.borrows(function() end))
    end
  end
end

base = per_unit(running(), 1000)
for _, case in ipairs {
  { "send; run", running() },
  { "send; run, a hook", running(nil, add_hooks(1)) },
  { "send; run, three hooks", running(nil, add_hooks(3)) },
  { "send; run, a guard", running { [2] = trans { src = "a", tgt = "b",
    events = { "e" }, guard = rfsm.borrows(function() end) } } },
  { "send; run, a timer", running { [2] = trans { src = "a", tgt = "b",
    events = { "e", "e_after(9)" } } } },
} do
  local count = per_unit(case[2], 1000)
  print(("%-32s %6.0f  x %.2f"):format(case[1], count, count / base))
end

local kept = snapshot.take(rfsm.init(known))
print(("%-32s %6.0f"):format("restore of 20 states",
  count_calls(function() snapshot.restore(known, kept) end)))

local model = warehouse()
local fsm = rfsm.init(model)
base = per_unit(stepping(fsm, "e_next", "e_next"), 1000)
local snap = snapshot.take(fsm)
print(("%-32s %6.0f"):format("event of a machine of 20 states", base))
for _, case in ipairs {
  { name = "snapshot.take", call = function() return snapshot.take(fsm) end },
  { name = "snapshot.put", call = function() return snapshot.put(fsm, snap) end },
  { name = "rfsm.init", call = function() return rfsm.init(model) end },
  { name = "snapshot.restore", call = function()
    return snapshot.restore(model, snap)
  end },
} do
  local count = per_unit(function(n) for _ = 1, n do case.call() end end, 20)
  print(("%-32s %6.0f  x %.1f"):format(case.name, count, count / base))
end
