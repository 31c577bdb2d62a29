-- Timers in order, and properties with a time, against brute force: random charts on a
-- clock of their own, run by hosts that keep the premise. What they reach was reached,
-- what is said to hold is not broken, and each witness replays with its times. Effects
-- of half of the charts send events later. A property has one verdict, alone and beside
-- others.

local add_deferrals = require("spec.support.charts").add_deferrals
local charts = require "spec.support.claims.explore"
local explore = require "rfsm.explore.explore"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local run_seeds = require "spec.support.run_seeds"
local rfsm_checks = require "rfsm_checks"

local claim = { name = "timers in order, and random hosts", runs = 60,
  bound = 200 } -- configurations: charts that have more are left out

local FOLLOWED = 30 -- witnesses of each chart

local EVENTS = { "e1", "e2", "e3", "e4" }

local MS = 1000 -- in a second

-- Properties --------------------------------------------------------------------------

-- Returns a property of states, or of conditions, and events.
function claim.random_property(random, paths, events)
  local a, b, event = random:pick(paths), random:pick(paths), random:pick(events)
  local seconds = random:below(8) / 2
  local kinds = {
    function() return rfsm_checks.after(event).reach(a).within(seconds) end,
    function() return rfsm_checks.from(a).left_within(seconds) end,
    function() return rfsm_checks.from(a).stays(seconds) end,
    function() return rfsm_checks.at_most(random:below(2), event).within(seconds) end,
    function()
      return rfsm_checks.at_least(random:below(2), event).within(seconds)
    end,
    function() return rfsm_checks.after(event).leads_to(a) end,
    function() return rfsm_checks.after(event).never(a) end,
    function() return rfsm_checks.precedes(a, b) end,
    function() return rfsm_checks.until_(a, b) end,
  }
  return random:pick(kinds)()
end

local function not_in(path) return function(active) return not active(path) end end

-- Returns a few properties by name.
local function properties_of(chart, random)
  local paths, properties = {}, {}
  for _, fqn in ipairs(chart.names) do
    if chart.nodes[fqn].kind == "state" and fqn ~= "root" then
      paths[#paths + 1] = fqn
      paths[#paths + 1] = not_in(fqn)
    end
  end
  for i = 1, paths[1] and random:below(3) or 0 do
    properties["p" .. i] = claim.random_property(random, paths, EVENTS)
  end
  return properties
end

-- Data ----------------------------------------------------------------------------

-- Puts a counter into the callbacks of some transitions of the machine itself: effects
-- that count, and guards that look at it. They are added to `runs`.
local function with_data(make, runs)
  local guard, effect = make.guard, make.effect
  function make.guard(id)
    if not tonumber(id) or id % 2 == 0 then return guard(id) end
    local function is_little(tr)
      local node = tr.src
      while not rfsm.is_root(node) do node = node._parent end
      return node.tries < 2
    end
    runs[#runs + 1] = is_little
    return is_little
  end
  function make.effect(id)
    local own = effect and effect(id)
    if not tonumber(id) or id % 3 == 0 then return own end
    local function count(fsm, ...)
      fsm.tries = (fsm.tries + 1) % 4
      if own then own(fsm, ...) end
    end
    runs[#runs + 1] = count
    return count
  end
  return make
end

-- Events that are sent later ---------------------------------------------------------

local LATE = { "e7", "e8", "e9" } -- come from no host

-- Calls f for a chart and for those of its regions.
local function each_chart(chart, f)
  f(chart)
  for _, fqn in ipairs(rfsm.sorted_keys(chart.regions)) do
    for _, region in ipairs(chart.regions[fqn].of) do each_chart(region, f) end
  end
end

-- Has transitions react to events that are sent later, and states defer some of them.
-- Returns the events that a host may send, of those that are named.
local function react_to_late(chart, random)
  local named, list, defers = {}, {}, random:chance(50)
  each_chart(chart, function(own)
    for _, tr in ipairs(own.transitions) do
      for _, event in ipairs(tr.events_ref or {}) do named[event] = true end
      if tr.events_ref and random:chance(30) then
        table.insert(tr.events_ref, random:pick(LATE))
      end
    end
    if defers and not own.is_small then add_deferrals(own, LATE, 2) end
  end)
  for _, event in ipairs(EVENTS) do
    if named[event] then list[#list + 1] = event end
  end
  return list
end

-- Returns what an effect sends later and takes back: an event that may be waiting is
-- taken back first, most times.
local function random_items(random)
  local items = {}
  for _ = 1, random:below(3) do
    local event, choice = random:pick(LATE), random:below(100)
    if choice <= 85 then items[#items + 1] = { cancel = event } end
    if choice > 15 then
      items[#items + 1] = { event, after = (random:below(6) - 1) / 2 }
    end
  end
  return items
end

-- Has effects of the chart send events later, in its field `later`. Returns the option.
local function add_later(chart, random, percent)
  local sends, path_of = {}, charts.paths_of(chart)
  chart.later = {}
  for _, number in ipairs(rfsm.sorted_keys(path_of)) do
    if number == "1" or random:chance(percent) then
      chart.later[number] = random_items(random)
      sends["effect " .. path_of[number]] = chart.later[number]
    end
  end
  return sends
end

-- Returns the event of a transition in a small chart.
local function small_event(random)
  local choice = random:below(4)
  if choice == 1 then
    if random:chance(30) then return ("e_every(%.1f)"):format(random:below(4) / 2) end
    return ("e_after(%.1f)"):format((random:below(5) - 1) / 2)
  end
  return choice == 2 and random:pick { "e1", "e2" } or random:pick(LATE)
end

local function add_to_small(chart, src, tgt, event)
  local key = #chart.transitions + 1
  chart.transitions[key] = { owner = "root", src_ref = src, src = "root." .. src,
    tgt_ref = tgt, events_ref = event and { event }, key = key }
end

local LEAVES = { "a", "b", "c", "d" }

-- Adds leaf i of a small chart. An event that is sent later leads to the next leaf, and
-- another one to a third, if the leaf does not keep them all.
local function add_leaf(chart, random, i, count)
  local fqn, keeps = "root." .. LEAVES[i], i == 1 and random:chance(60)
  local first = random:below(#LATE)
  chart.names[i + 1] = fqn
  chart.nodes[fqn] = { kind = "state", parent = "root", id = LEAVES[i], is_leaf = true,
    defer = keeps and { "e7", "e8", "e9", max = 4 } or nil }
  local function add(tgt, event) add_to_small(chart, LEAVES[i], tgt, event) end
  add(LEAVES[i % count + 1], keeps and small_event(random) or LATE[first])
  add(keeps and "internal" or LEAVES[(i + 1) % count + 1],
    keeps and "e1" or LATE[first % #LATE + 1])
  for _ = 1, random:below(3) - 1 do
    add(random:pick { "internal", "a", LEAVES[count] }, small_event(random))
  end
end

-- Returns a chart of some leaves without guards, in which the order of times decides
-- where the machine goes. One may have regions.
local function small_chart(random, depth)
  local chart = { seed = 1, names = { "root" }, transitions = {}, regions = {},
    is_small = true, nodes = { root = { kind = "state" },
      ["root.initial"] = { kind = "connector" } } }
  local count = 2 + random:below(2)
  add_to_small(chart, "initial", "a")
  for i = 1, count do add_leaf(chart, random, i, count) end
  if depth == 0 and random:chance(15) then
    chart.regions["root.b"] = { step = random:below(2), of = {
      small_chart(random, 1), random:chance(50) and small_chart(random, 1) or nil } }
  end
  return chart
end

local function without(list, is_it)
  for i = #list, 1, -1 do
    if is_it(list[i]) then return table.remove(list, i) end
  end
end

-- Returns the steps of a witness without the events that the machine sends itself.
local function without_sends(witness)
  local steps = {}
  for i, step in ipairs(witness) do
    local copy = { choices = step.choices, at = step.at, values = {}, inside = {} }
    for n, event in ipairs(step.values) do copy.values[n] = event end
    for n, inner in ipairs(step.inside) do copy.inside[n] = inner end
    for _, text in ipairs(step.events) do
      local event = text:match("^after .- s: (%w+)")
      local prefix = event and text:match(" in (.*)$")
      assert(not event or without(prefix and copy.inside or copy.values, function(own)
        return own == event or prefix and own.event == event and own.prefix == prefix
      end))
    end
    steps[i] = copy
  end
  return steps
end

local function choice_of(chart)
  return { sends = {}, sets = {}, names = {}, later = chart.later }
end

-- Hosts -------------------------------------------------------------------------------

local function time_of(at) return math.floor(at.sec * MS + at.nsec / 1e6 + 0.5) end

-- Adds the times of properties.
local function add_monitors(watched, add)
  for _, monitor in ipairs(watched.step.monitors) do
    for _, began in ipairs(monitor.clocks) do
      add(math.floor((began + monitor.property.seconds) * MS + 0.5))
    end
  end
end

local function deadline_of(timer, timers)
  local event = timer.event
  if timer.entry == timers.entry then
    return { sec = timer.sec or math.huge, nsec = timer.nsec or 0 }
  end
  return { sec = timers.sec + event.sec, nsec = timers.nsec + event.nsec }
end

-- Lists the moments behind which timers of active states, or times of properties, are
-- over. One that is now is not over yet.
local function deadlines_of(fsm, watched, now)
  local list = {}
  local function add(ms)
    if ms >= now and ms < math.huge then list[#list + 1] = ms end
  end
  for _, entry in ipairs(rfsm.machines(fsm)) do
    for _, state in ipairs(rfsm.elements(entry.machine, rfsm.is_state)) do
      local timers = state._mode ~= "inactive" and state._timers
      for _, timer in ipairs(timers or {}) do
        local event, ms = timer.event, time_of(deadline_of(timer, timers))
        add(ms)
        if event.is_repeated then add(ms + time_of(event)) end
      end
    end
    for _, send in ipairs((entry.machine._timeevent or {}).sends or {}) do
      add(time_of(send))
    end
  end
  add_monitors(watched, add)
  table.sort(list)
  return list
end

-- Returns when the host takes the next step: at once, before the next deadline, or
-- between that and the one behind it; with a period, when it likes.
local function next_moment(fsm, watched, now, random, period)
  if period then return now + random(period * MS + 1) - 1 end
  local list = deadlines_of(fsm, watched, now)
  local first, second = list[1] or now + 2000, nil
  for _, ms in ipairs(list) do second = second or ms > first and ms or nil end
  second = second or first + 2000
  local choice = random(4)
  if choice == 1 then return now end
  if choice == 2 then return now + random(first - now + 1) - 1 end
  return first + random(second - first)
end

-- Sends an event now and then, but none to a machine that takes one while one waits.
local function send_by_chance(fsm, events, random)
  local is_busy = fsm.read == "one" and rfsm.check_events(fsm) > 0
  if events[1] and random(2) == 1 and not is_busy then
    rfsm.send_events(fsm, events[random(#events)])
  end
end

local function no_flags() return {} end

-- Runs the chart so often. Returns a set of texts of what was seen, and of the names of
-- properties that were broken.
function claim.run_at_random(chart, properties, options, seed)
  local events = chart.events or EVENTS
  local fsm, now, seen, broken = nil, 0, {}, {}
  local world = { random = new_random(seed), seen = seen, sends = {}, flags = {},
    sets = {}, later = chart.later }
  local make = charts.wanderer(world, function() return fsm end)
  fsm = rfsm.init(charts.model_of(chart, with_data(make, {}), ""))
  for _, entry in ipairs(rfsm.machines(fsm)) do
    entry.machine.gettime = function() return math.floor(now / MS), now % MS * 1e6 end
  end
  fsm.err = function(text)
    broken[tostring(text):match("^property '(.-)'") or "another error"] = true
  end
  local watched = rfsm_checks.watch_properties(fsm, properties)
  for _ = 1, options.runs or claim.runs do
    fsm.tries = 0
    for _ = 1, 2 + world.random(20) do
      if fsm._act_leaf then
        now = next_moment(fsm, watched, now, world.random, options.period)
      end
      send_by_chance(fsm, events, world.random)
      world.steps = (world.steps or 0) + 1
      rfsm.step(fsm)
      for _, text in ipairs(charts.stands_of(fsm, no_flags())) do seen[text] = true end
    end
    rfsm.reset(fsm)
  end
  return seen, broken
end

-- The claim ---------------------------------------------------------------------------

-- Kinds whose violation a machine shows that is watched.
local IS_SHOWN = { reach_within = true, left_within = true, stays = true,
  at_most = true, at_least = true }

-- Does the witness of a property break it, with its times?
local function is_shown(chart, witness, name, property)
  local is_broken = false
  charts.follow(chart, without_sends(witness), choice_of(chart), function(fsm)
    fsm.err = function(text)
      if tostring(text):find("property '" .. name .. "'", 1, true) then
        is_broken = true
      end
    end
    rfsm_checks.watch_properties(fsm, { [name] = property })
  end)
  return is_broken
end

-- Returns a model of a chart to explore, and sets the options for its data.
function claim.model_of(chart, options)
  local function yes() return true end
  local function make() return yes end
  local runs = {}
  local model = charts.model_of(chart, with_data({ guard = make, predicate = make,
    doo = make }, runs), "")
  model.tries = 0
  options.vars, options.run = { tries = { 0, 3 } }, runs[1] and runs or nil
  return model
end

local function explore_chart(chart, properties, options)
  local model = claim.model_of(chart, options)
  options.properties, options.configurations = properties, claim.bound
  return rfsm_checks.explore(model, options), explore.walk(model, options)
end

claim.counts = { holds = 0, broken = 0, open = 0, configurations = 0, later = 0 }

-- Appends verdicts that random runs break, and witnesses that show nothing.
function claim.check_properties(seed, chart, properties, result, broken, list)
  for _, judged in ipairs(result.properties) do
    local property = properties[judged.name]
    local verdict = judged.holds and "holds" or judged.holds == false and "broken"
    claim.counts[verdict or "open"] = claim.counts[verdict or "open"] + 1
    local text = ("%d: %s, %s"):format(seed, judged.name, tostring(property))
    if judged.holds and broken[judged.name] then
      list[#list + 1] = text .. " holds, and was broken"
    end
    if judged.holds == false and not chart.is_free and IS_SHOWN[property.kind]
      and not is_shown(chart, judged.witness, judged.name, property) then
      list[#list + 1] = text .. " is violated, and its witness does not show it"
    end
  end
end

-- Appends the properties whose verdict depends on the other properties.
local function check_alone(seed, chart, properties, options, result, list)
  for _, judged in ipairs(result.properties) do
    options.properties = { [judged.name] = properties[judged.name] }
    local alone = rfsm_checks.explore(claim.model_of(chart, options), options)
    local text, other = tostring(judged), tostring(alone.properties[1])
    if text ~= other then
      list[#list + 1] = ("%d: beside others %s, alone %s"):format(seed, text, other)
    end
  end
end

-- Returns a function that is called before a step of a machine, with the time. It
-- returns the moments that the step finds over, if it should have been taken sooner.
local function keeper(fsm, period)
  local last = 0
  return function(now)
    local over = {}
    for _, ms in ipairs(deadlines_of(fsm, { step = { monitors = {} } }, last)) do
      if ms < now * MS - 1e-3 then over[#over + 1] = ms end
    end
    last = now * MS
    local latest = period and now * MS - period * MS - 1e-3 or over[#over]
    return over[1] and over[1] < latest and table.concat(over, " ") or nil
  end
end

-- Appends which witnesses lead elsewhere, or have a host that comes too late.
local function follow_some(seed, chart, walk, random, period, list)
  local shown = charts.explored(walk)
  local texts = rfsm.sorted_keys(shown)
  for _ = 1, FOLLOWED do
    local text = random:pick(texts)
    local step = shown[text]
    if step then
      local witness = walk:witness(step.at, step.label)
      local late
      local seen = charts.follow(chart, without_sends(witness), choice_of(chart),
        function(fsm)
          local keep = keeper(fsm, period)
          return function(now) late = late or keep(now) end
        end)
      if late then
        list[#list + 1] = ("%d: %s is too late, for %s"):format(seed, text, late)
      elseif not seen[text] then
        list[#list + 1] = ("%d: %s is not reached"):format(seed, text)
      end
    end
  end
end

local function send_late(chart, random, options, percent)
  options.alphabet = react_to_late(chart, random)
  options.sends = add_later(chart, random, percent)
  chart.events = options.alphabet
end

-- Appends what random runs have seen and the exploration has not.
local function find_unexplored(seed, walk, seen, list)
  local shown = charts.explored(walk)
  for text in pairs(seen) do -- any order: sorted
    if shown[text] == nil then
      list[#list + 1] = ("%d: %s was seen"):format(seed, text)
    end
  end
end

-- Returns the chart of a seed, its properties, and options.
local function case_of(seed, random)
  local is_small = seed % 3 > 0
  local chart = is_small and small_chart(random, 0) or charts.chart(seed, 0, true)
  local options = { together = 1,
    period = random:chance(30) and random:below(3) * 0.75 or nil }
  local properties = properties_of(chart, random)
  if is_small or random:chance(50) then
    send_late(chart, random, options, is_small and 60 or 20)
  end
  chart.is_free = random:chance(15)
  options.timers = chart.is_free and "free" or nil
  return chart, properties, options
end

-- Appends what is wrong. Returns whether the chart was compared.
local function compare(seed, list)
  local random = new_random(seed + 29)
  local chart, properties, options = case_of(seed, random)
  local result, walk = explore_chart(chart, properties, options)
  if not chart.is_free then
    follow_some(seed, chart, walk, random, options.period, list)
  end
  if result.bound then return end
  local seen, broken = claim.run_at_random(chart, properties, options, seed)
  find_unexplored(seed, walk, seen, list)
  local counts = claim.counts
  counts.later = counts.later + (next(chart.later or {}) and 1 or 0)
  claim.check_properties(seed, chart, properties, result, broken, list)
  check_alone(seed, chart, properties, options, result, list)
  return true
end

claim.run = run_seeds(compare)

return claim
