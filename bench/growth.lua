-- What does an event cost in a larger chart?  LUA bench/growth.lua [TABLE ...]
--
-- The tables `states`, `transitions`, `own` and `timers` are of charts with 10 to
-- 10,000 of these beside what the event needs: it should cost the same (ratio 1).
-- `depth` is of transitions between branches of 1 to 64 levels: each state that is left
-- and entered should add the same.
--
-- Environment: ROUNDS=5, SECONDS=0.1 for a measurement, MOST=10000.

package.path = "./?.lua;" .. package.path

local measure = require "bench.measure"
local rfsm = require "rfsm"
local timeevent = require "rfsm_timeevent"

local ROUNDS = measure.count("ROUNDS", 5)
local SECONDS = measure.setting("SECONDS", 0.1)
local MOST = measure.count("MOST", 10000)

-- Charts ----------------------------------------------------------------------

local function callback() end

-- A machine that goes round between two states in a composite on e_next.
local function new_model()
  return rfsm.state {
    info = false, warn = false,
    c = rfsm.state {
      a = rfsm.state { entry = callback }, b = rfsm.state { entry = callback },
      rfsm.trans { src = "initial", tgt = "a" },
      rfsm.trans { src = "a", tgt = "b", events = { "e_next" } },
      rfsm.trans { src = "b", tgt = "a", events = { "e_next" } },
    },
    other = rfsm.state { x = rfsm.state {}, rfsm.trans { src = "initial", tgt = "x" } },
    rfsm.trans { src = "initial", tgt = "c" },
  }
end

local function add(state, fields) state[#state + 1] = rfsm.trans(fields) end

local function with_states(size)
  local model = new_model()
  for i = 1, size do
    model.other["s" .. i] = rfsm.state { entry = callback }
    add(model.other, { src = "s" .. i, tgt = "x", events = { "e_next" } })
  end
  return model
end

local function with_transitions(size)
  local model = new_model()
  for i = 1, size do
    add(model.other, { src = "x", tgt = "x", events = { "e_" .. i } })
  end
  return model
end

-- Transitions of the states that are active, half of them of the composite.
local function with_own_transitions(size)
  local model = new_model()
  for i = 1, size / 2 do
    add(model.c, { src = "a", tgt = "b", events = { "e_" .. i } })
    add(model, { src = "c", tgt = "other", events = { "e_" .. i } })
  end
  return model
end

-- Timers that run: an hour and more from now, each step looks whether one is due.
local function with_timers(size)
  local model = new_model()
  for i = 1, size do
    add(model, { src = "c", tgt = "other",
      events = { ("e_after(%d)"):format(3600 + i * 7 % size) } })
  end
  return model
end

-- A branch of `levels` states under `parent`; returns the name of its leaf.
local function add_branch(parent, id, levels)
  local name = "root"
  for i = 1, levels do
    local state = rfsm.state { entry = callback, exit = callback }
    parent[id] = state
    if i > 1 then add(parent, { src = "initial", tgt = id }) end
    name, parent, id = name .. "." .. id, state, "s"
  end
  return name
end

local function with_levels(levels)
  local model = rfsm.state { info = false, warn = false }
  local a, b = add_branch(model, "a", levels), add_branch(model, "b", levels)
  add(model, { src = "initial", tgt = a })
  add(model, { src = a, tgt = b, events = { "e_next" } })
  add(model, { src = b, tgt = a, events = { "e_next" } })
  return model
end

-- Measure ---------------------------------------------------------------------

local ticks = 0
timeevent.set_gettime_hook(function()
  ticks = ticks + 1
  return 1000, ticks % 1000
end)

local function stepping(model)
  local fsm = assert(rfsm.init(model))
  rfsm.run(fsm)
  return measure.stepping(rfsm, fsm, "e_next")
end

-- Microseconds per event of the charts of all `sizes`, measured in turn.
local function measure_sizes(make, sizes)
  local subjects = {}
  for i, size in ipairs(sizes) do subjects[i] = stepping(make(size)) end
  return measure.best_in_turn(subjects, ROUNDS, SECONDS)
end

local function print_flat(growth)
  local sizes, size = {}, 10
  while size <= MOST do
    sizes[#sizes + 1], size = size, size * 10
  end
  local best = measure_sizes(growth.make, sizes)
  print(("\n%-28s us/event    ratio"):format(growth.title))
  for i = 1, #sizes do
    print(("%28d %8.3f %8.2f"):format(sizes[i], best[i], best[i] / best[1]))
  end
end

-- Twice as many levels leave and enter as many states more as there are levels now.
local function print_linear(growth)
  local sizes = { 1, 2, 4, 8, 16, 32, 64 }
  local best = measure_sizes(growth.make, sizes)
  print(("\n%-28s us/event    ratio   us/state   us/further state"):format(
    growth.title))
  for i = 1, #sizes do
    local further = i == 1 and "-"
      or ("%.3f"):format((best[i] - best[i - 1]) / sizes[i])
    print(("%28d %8.3f %8.2f %10.3f %18s"):format(sizes[i], best[i], best[i] / best[1],
      best[i] / (2 * sizes[i]), further))
  end
end

local GROWTHS = {
  { name = "states", title = "states elsewhere", make = with_states },
  { name = "transitions", title = "transitions elsewhere", make = with_transitions },
  { name = "own", title = "transitions of active states", make = with_own_transitions },
  { name = "timers", title = "timers that run", make = with_timers },
  { name = "depth", title = "levels left and entered", make = with_levels },
}

local selected = measure.select(GROWTHS, arg)
print(("%s: best of %d rounds"):format(measure.engine(), ROUNDS))
for _, growth in ipairs(selected) do
  local print_table = growth.name == "depth" and print_linear or print_flat
  print_table(growth)
end
