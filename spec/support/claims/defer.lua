-- A machine with rfsm.defer leaves the trace of the oracle, also with histories,
-- timers, faults and regions.

local charts = require "spec.support.charts"
local driven = require "spec.support.driven"
local history = require "spec.support.claims.history"
local match = require "rfsm.shared.match"
local new_random = require "spec.support.random"
local reference = require "spec.support.reference"
local runs = require "spec.support.runs"
require "rfsm.defer"
require "rfsm.faults"
require "rfsm_seqand"
require "rfsm_timeevent"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

-- Charts -----------------------------------------------------------------------------

-- Gives some transitions a time event. Those of a state have the same, since events of
-- one state that come at one time have the order of its transitions.
local function add_timers(chart, random)
  local event_of = {}
  for _, tr in ipairs(chart.transitions) do
    if chart.nodes[tr.src].kind == "state" and tr.events[1] and random:chance(30) then
      local event = event_of[tr.src] or ("e_%s(%.1f)"):format(
        random:pick { "after", "every" }, random:below(4) / 2)
      event_of[tr.src] = event
      tr.events_ref = { event, unpack(tr.events_ref) }
      tr.events = { event .. "@" .. tr.src, unpack(tr.events) }
    end
  end
  for _ = 1, random:below(6) do
    table.insert(chart.ops, random:below(#chart.ops), { "wait", random:below(5) / 2 })
  end
end

-- Gives some leaves regions, which are charts. They leave no trace of their own: its
-- place in that of the outer machine says nothing.
local function add_regions(chart, random)
  chart.regions = {}
  for _, fqn in ipairs(chart.names) do
    local node = chart.nodes[fqn]
    if node.is_leaf and fqn ~= "root" and not node.final and random:chance(25) then
      node.entry, node.exit, node.doo = true, true, true
      for _, what in ipairs { "entry ", "exit " } do
        chart.programs[what .. fqn] = chart.programs[what .. fqn] or { false }
      end
      chart.regions[fqn] = { step = random:below(2) }
      for i = 1, random:below(2) do
        local region = charts.generate(random:below(1000000))
        chart.regions[fqn][i], region.programs.dbg = region, nil
      end
    end
  end
end

local function each_chart(chart, f)
  f(chart)
  for _, regions in pairs(chart.regions or {}) do -- any order: each stands alone
    for _, region in ipairs(regions) do each_chart(region, f) end
  end
end

local function new_chart(seed)
  local chart, random = charts.generate(seed), new_random(seed + 3)
  if random:chance(40) then add_regions(chart, random) end
  local has_history, has_timers = random:chance(50), random:chance(60)
  local has_faults = random:chance(60)
  each_chart(chart, function(own)
    charts.add_deferrals(own)
    if has_history then charts.add_histories(own) end
    if has_timers then add_timers(own, new_random(own.seed + 3)) end
    if has_faults then charts.add_faults(own) end
  end)
  return chart
end

-- The model of timers ----------------------------------------------------------------

-- Calls f(...) behind the function `name` of a table, if there is one.
local function behind(calls, name, f)
  local own = calls[name]
  calls[name] = function(...)
    if own then own(...) end
    return f(...)
  end
end

local function add_timer_model(calls, chart, world)
  local since, depth = {}, {} -- F -> when it was entered; by time event
  for i, fqn in ipairs(chart.names) do depth[fqn] = i end
  behind(calls, "entered", function(fqn) since[fqn] = { at = world.clock.now } end)
  behind(calls, "was_reset", function() since = {} end)

  -- Returns the time at which a timer came, if it is over and has not come.
  local function come(fqn, event)
    local kind, seconds = tostring(event):match("^e_(%l+)%((.-)%)@")
    local at = seconds and (since[fqn][event] or since[fqn].at + tonumber(seconds))
    if not at or at >= world.clock.now then return nil end
    since[fqn][event] = kind == "after" and math.huge or at
    while since[fqn][event] < world.clock.now do
      since[fqn][event] = since[fqn][event] + tonumber(seconds)
    end
    return at, kind == "every"
  end

  -- Appends the timers of a state that come now. A time of an e_every is missed while
  -- one waits.
  local function add_over(list, fqn, waiting)
    for _, tr in ipairs(chart.transitions) do
      for _, event in ipairs(tr.src == fqn and tr.events or {}) do
        local at, is_repeated = come(fqn, event)
        if at and not (is_repeated and match.has(waiting, event)) then
          list[#list + 1] = { event = event, at = at, depth = depth[fqn] }
        end
      end
    end
  end

  function calls.timers(waiting)
    local list, events = {}, {}
    for fqn, mode in pairs(world.machine.mode) do -- any order: sorted
      if mode ~= "inactive" and since[fqn] then add_over(list, fqn, waiting) end
    end
    table.sort(list, function(a, b)
      if a.at ~= b.at then return a.at < b.at end
      return a.depth < b.depth
    end)
    for i, timer in ipairs(list) do events[i] = timer.event end
    return events
  end
end

-- The model of regions ---------------------------------------------------------------

local function add_region_model(calls, _, world)
  local machine, active, current, is_forwarded = world.machine, false, {}, false
  for fqn, regions in pairs(world.regions) do -- any order: each stands alone
    for i, region in ipairs(regions) do
      local own = region.machine
      own.around, own.inside, own.region = machine, fqn, tostring(i)
    end
  end

  -- Calls f for each region of the active state; errors wait for the iteration's end.
  local function each(f)
    for _, region in ipairs(world.regions[active]) do f(region.machine) end
  end
  local function advance()
    each(function(region)
      reference.protected(machine, reference.step, region, world.regions[active].step)
    end)
  end
  local function forward()
    each(function(region)
      for _, event in ipairs(current) do
        reference.protected(machine, reference.send, region, event)
      end
    end)
    is_forwarded = true
  end

  local function is_joined(fqn)
    local regions = {}
    each(function(region) regions[#regions + 1] = region end)
    return reference.is_joined(machine, fqn, regions)
  end

  behind(calls, "pre_hook", function(events)
    current, is_forwarded = events, false
  end)
  local entry, exit, doo = calls.entry, calls.exit, calls.doo
  local post_hook = calls.post_hook
  function calls.entry(fqn, leaf, event)
    if not world.regions[fqn] then return entry(fqn, leaf, event) end
    local ok, problem = pcall(entry, fqn, leaf, event)
    active = fqn
    advance()
    if not ok then error(problem, 0) end
  end
  function calls.exit(fqn, leaf, event)
    if world.regions[fqn] then
      each(function(region)
        reference.protected(machine, reference.leave, region)
      end)
      active = false
    end
    return exit(fqn, leaf, event)
  end
  function calls.doo(fqn)
    if not world.regions[fqn] then return doo(fqn) end
    while true do
      forward()
      advance()
      if is_joined(fqn) then return true end
      coroutine.yield(true)
    end
  end
  function calls.post_hook(events)
    current = events -- pre hooks are not called ahead of what needs no event
    local is_open = active and machine.mode[active] == "active"
    if is_open and not is_forwarded then forward() end
    is_forwarded = false
    if post_hook then post_hook(events) end
  end
  behind(calls, "was_reset", function()
    active, is_forwarded = false, false
    for _, regions in pairs(world.regions) do -- any order: each stands alone
      for _, region in ipairs(regions) do reference.reset(region.machine) end
    end
  end)
end

local function add_models(calls, chart, world)
  history.add_model(calls, chart)
  add_timer_model(calls, chart, world)
  if next(world.regions) then add_region_model(calls, chart, world) end
end

return { name = "deferral and the oracle", new_chart = new_chart,
  add_models = add_models, run = driven.claim(function(seed)
  local at, expected, actual = runs.compare(new_chart(seed), add_models)
  return at and ("line %d: oracle '%s', core '%s'"):format(at, tostring(expected[at]),
    tostring(actual[at]))
end) }
