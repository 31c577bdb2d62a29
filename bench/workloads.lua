-- The workloads of bench/run.lua. Each makes two functions of n: the core doing n
-- events, and its limit doing the same by hand. Callbacks only count.

local workloads = {}

local count = 0

local function callback() count = count + 1 end

local function yes() count = count + 1 end

local function no()
  count = count + 1
  return false
end

local function add(name, make)
  workloads[#workloads + 1] = { name = name, make = make }
end

local function silent(fields)
  fields.info, fields.warn = false, false
  return fields
end

-- Drives a machine with the events in turn, by `rfsm.step` or `advance`.
local function stepping(rfsm, fsm, events, advance)
  local send_events, step, last = rfsm.send_events, advance or rfsm.step, #events
  rfsm.run(fsm)
  local at = 0
  return function(n)
    for _ = 1, n do
      at = at < last and at + 1 or 1
      send_events(fsm, events[at])
      step(fsm)
    end
  end
end

-- The limit: rows[state][event] is a list of callbacks and a target.
local function by_hand(rows, first, events)
  local last, at, state = #events, 0, first
  return function(n)
    for _ = 1, n do
      at = at < last and at + 1 or 1
      local row = rows[state][events[at]]
      for i = 1, #row do pcall(row[i]) end
      state = row.target
    end
  end
end

local function row(size, target)
  local list = { target = target }
  for i = 1, size do list[i] = callback end
  return list
end

local function two_rows(size)
  return by_hand({ a = { e_b = row(size, "b") }, b = { e_a = row(size, "a") } }, "a",
    { "e_b", "e_a" })
end

local function two_leaves(rfsm)
  return rfsm.state(silent {
    a = rfsm.state { entry = callback }, b = rfsm.state { entry = callback },
    rfsm.trans { src = "initial", tgt = "a" },
    rfsm.trans { src = "a", tgt = "b", events = { "e_b" } },
    rfsm.trans { src = "b", tgt = "a", events = { "e_a" } },
  })
end

add("W1", function(rfsm)
  local fsm = rfsm.init(two_leaves(rfsm))
  return stepping(rfsm, fsm, { "e_b", "e_a" }), two_rows(1)
end)

add("W1r", function(rfsm)
  local fsm = rfsm.init(two_leaves(rfsm))
  return stepping(rfsm, fsm, { "e_b", "e_a" }, rfsm.run), two_rows(1)
end)

-- A branch of `depth` states, the last one a leaf.
local function branch(rfsm, depth)
  local state = rfsm.state { entry = callback, exit = callback }
  if depth > 1 then
    state.s = branch(rfsm, depth - 1)
    state[1] = rfsm.trans { src = "initial", tgt = "s" }
  end
  return state
end

add("W2", function(rfsm)
  local down = ".s.s.s.s.s"
  local fsm = rfsm.init(rfsm.state(silent {
    a = branch(rfsm, 6), b = branch(rfsm, 6),
    rfsm.trans { src = "initial", tgt = "root.a" .. down },
    rfsm.trans { src = "root.a" .. down, tgt = "root.b" .. down, events = { "e_b" } },
    rfsm.trans { src = "root.b" .. down, tgt = "root.a" .. down, events = { "e_a" } },
  }))
  return stepping(rfsm, fsm, { "e_b", "e_a" }), two_rows(12)
end)

add("W3", function(rfsm)
  local ring = rfsm.state {}
  local rows, events = {}, {}
  local no_row = 0
  for i = 1, 100 do
    local name, event = "s" .. i, "e_" .. i
    local next_name = "s" .. i % 100 + 1
    ring[name] = rfsm.state { entry = callback }
    ring[#ring + 1] = rfsm.trans { src = name, tgt = next_name, events = { event } }
    rows[name] = { [event] = { no, callback, target = next_name } }
    events[i] = event
    no_row = no_row + 1
  end
  ring[#ring + 1] = rfsm.trans { src = "initial", tgt = "s1" }
  local model = rfsm.state(silent {
    ring = ring, other = rfsm.state {}, rfsm.trans { src = "initial", tgt = "ring" },
  })
  for i = 1, 100 do
    model[#model + 1] = rfsm.trans {
      src = "ring", tgt = "other", events = { "e_" .. i }, guard = no,
    }
    model[#model + 1] = rfsm.trans {
      src = "ring", tgt = "other", events = { "x_" .. i },
    }
  end
  return stepping(rfsm, rfsm.init(model), events), by_hand(rows, "s1", events)
end)

add("W4", function(rfsm)
  local model = rfsm.state(silent {
    a = rfsm.state { entry = callback }, b = rfsm.state { entry = callback },
    dead = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "a" },
  })
  local function path(from, to, event)
    for i = 1, 4 do model[event .. i] = rfsm.conn {} end
    local first = rfsm.trans {
      src = from, tgt = event .. 1, events = { event }, effect = callback,
    }
    model[#model + 1] = first
    for i = 1, 4 do
      model[#model + 1] = rfsm.trans {
        src = event .. i, tgt = i < 4 and event .. i + 1 or to, guard = yes,
        effect = callback,
      }
      model[#model + 1] = rfsm.trans { src = event .. i, tgt = "dead", guard = no }
    end
  end
  path("a", "b", "e_b")
  path("b", "a", "e_a")
  local function by_path(target)
    return { yes, no, yes, no, yes, no, yes, no, callback, callback, callback, callback,
      callback, callback, target = target }
  end
  local rows = { a = { e_b = by_path("b") }, b = { e_a = by_path("a") } }
  return stepping(rfsm, rfsm.init(model), { "e_b", "e_a" }),
    by_hand(rows, "a", { "e_b", "e_a" })
end)

add("W5", function(rfsm)
  local function busy()
    while true do
      count = count + 1
      rfsm.yield()
    end
  end
  local fsm = rfsm.init(rfsm.state(silent {
    a = rfsm.state { doo = busy }, rfsm.trans { src = "initial", tgt = "a" },
  }))
  rfsm.step(fsm)
  local step, resume, co = rfsm.step, coroutine.resume, coroutine.create(busy)
  return function(n) for _ = 1, n do step(fsm) end end,
    function(n) for _ = 1, n do resume(co) end end
end)

-- A model of about `size` states: flat, a tree of tens, or chains 20 deep.
local function big_model(rfsm, size, shape)
  local function leaf() return rfsm.state { entry = callback, exit = callback } end
  local function ring(members, state)
    for i = 1, members do
      state["s" .. i] = leaf()
      state[i] = rfsm.trans {
        src = "s" .. i, tgt = "s" .. i % members + 1, events = { "e_" .. i },
      }
    end
    state[members + 1] = rfsm.trans { src = "initial", tgt = "s1" }
    return state
  end
  if shape == "flat" then return rfsm.state(silent(ring(size, {}))) end
  if shape == "tree" then
    local model = ring(1, {})
    for i = 1, size / 10 do model["t" .. i] = rfsm.state(ring(9, {})) end
    return rfsm.state(silent(model))
  end
  local model = ring(1, {})
  for i = 1, size / 20 do model["b" .. i] = branch(rfsm, 20) end
  return rfsm.state(silent(model))
end

local function deep_copy(value)
  if type(value) ~= "table" then return value end
  local copy = {}
  for k, v in pairs(value) do copy[k] = deep_copy(v) end
  return setmetatable(copy, getmetatable(value))
end

-- Makes n of them and returns the last, whose memory counts.
local function making(make, model)
  return function(n)
    for _ = 2, n do make(model) end
    return make(model)
  end
end

-- `init` of a model that had none before: it has changed since the last time.
local function making_first(init, model)
  return making(function()
    model.turn = (model.turn or 0) + 1
    return init(model)
  end)
end

for _, size in ipairs({ 20, 1000, 10000 }) do
  for _, shape in ipairs({ "flat", "tree", "deep" }) do
    add(("W6 %s %d"):format(shape, size), function(rfsm)
      local model = big_model(rfsm, size, shape)
      return making(rfsm.init, model), making(deep_copy, model)
    end)
  end
end

for _, size in ipairs({ 20, 1000 }) do
  for _, shape in ipairs({ "flat", "tree", "deep" }) do
    add(("W6 %s %d first"):format(shape, size), function(rfsm)
      local model = big_model(rfsm, size, shape)
      return making_first(rfsm.init, model), making(deep_copy, model)
    end)
  end
end

local function many_machines(rfsm, machines)
  local model = big_model(rfsm, 20, "flat")
  local fsms = {}
  for i = 1, machines do
    fsms[i] = rfsm.init(model)
    rfsm.run(fsms[i])
  end
  local send_events, step = rfsm.send_events, rfsm.step
  local at, event = 0, 1
  local events = {}
  for i = 1, 20 do events[i] = "e_" .. i end
  return function(n)
    for _ = 1, n do
      at = at + 1
      if at > machines then
        at = 1
        event = event % 20 + 1
      end
      send_events(fsms[at], events[event])
      step(fsms[at])
    end
  end
end

add("W7", function(rfsm, machines)
  local fsm = rfsm.init(two_leaves(rfsm))
  return many_machines(rfsm, machines or 1000), stepping(rfsm, fsm, { "e_b", "e_a" })
end)

return workloads
