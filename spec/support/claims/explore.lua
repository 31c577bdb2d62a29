-- Exploration against brute force: random charts with timers, awaits, predicates and
-- sequential AND states. Whatever random runs reach was reached, also of several
-- machines at once, and each witness leads to its end on a machine of its own.

local bare = require "spec.support.bare"
local charts = require "spec.support.charts"
local explore = require "rfsm.checks.explore"
local new_random = require "spec.support.random"
local place = require "rfsm.checks.place"
local rfsm = require "rfsm"
local rfsm_timeevent = require "rfsm_timeevent"
require "rfsm.await"

local claim = { name = "exploration and random runs", runs = 300 }

-- Charts ----------------------------------------------------------------------------

local EVENTS = { "e1", "e2", "e3", "e4" }

-- Returns one event more for a transition: of a time that no other has, or an await.
local function extra_event(random, i)
  if random:chance(15) then return ("e_after(%d.%03d)"):format(random:below(3), i) end
  if not random:chance(10) then return nil end
  return ("await(%s, %s)"):format(random:pick(EVENTS), random:pick(EVENTS))
end

local function add_events(chart, random)
  for i, tr in ipairs(chart.transitions) do
    if chart.nodes[tr.src].kind == "state" and tr.events_ref and not tr.is_internal then
      local events = {}
      for n, event in ipairs(tr.events_ref) do events[n] = event end
      events[#events + 1] = extra_event(random, i)
      tr.events_ref = events
    end
  end
end

-- Gives some leaves regions, which are charts, too.
local function add_regions(chart, random, depth)
  chart.regions = {}
  for _, fqn in ipairs(chart.names) do
    local node = chart.nodes[fqn]
    if depth < 2 and fqn ~= "root" and node.is_leaf and random:chance(8) then
      node.doo = false
      chart.regions[fqn] = { step = random:below(2), of = {} }
      for i = 1, random:below(2) do
        chart.regions[fqn].of[i] = claim.chart(random:below(1000000), depth + 1)
      end
    end
  end
end

function claim.chart(seed, depth)
  local chart, random = charts.generate(seed), new_random(seed + 7)
  add_events(chart, random)
  add_regions(chart, random, depth or 0)
  return chart
end

-- A model of the chart. `make` has functions that return callbacks; each is named by
-- the path of its element.
local function model_of(chart, make, prefix)
  local own = {}
  for name, f in pairs(make) do -- any order: each stands alone
    own[name] = function(at) return f(prefix .. at) end
  end
  local model = bare.model_of(chart, own)
  rfsm.mapfsm(function(tr) tr.number = prefix .. tr.number end, model, rfsm.is_trans)
  for fqn, regions in pairs(chart.regions) do -- any order: each stands alone
    local fields = { step = regions.step, warn = false, info = false,
      entry = make.entry and make.entry(prefix .. fqn) }
    for i, region in ipairs(regions.of) do
      fields[i] = model_of(region, make, prefix .. fqn .. "/" .. i .. "/")
    end
    local parent = model
    for name in chart.nodes[fqn].parent:gmatch("%.([^.]+)") do parent = parent[name] end
    parent[chart.nodes[fqn].id] = rfsm.seqand(fields)
  end
  return model
end

-- Random runs -----------------------------------------------------------------------

-- Returns the leaf and mode of each machine as texts, and all of them as one.
local function stands_of(fsm)
  local texts = {}
  for i, entry in ipairs(rfsm.machines(fsm)) do
    local leaf = entry.machine._act_leaf
    texts[i] = entry.prefix .. " "
      .. (leaf and leaf._fqn .. " " .. leaf._mode or "none")
  end
  texts[#texts + 1] = table.concat(texts, "; ")
  return texts
end

-- The callbacks of random runs, which note what they see.
local function wanderer(random, seen, sends, fsm_of)
  return {
    guard = function() return function() return random(2) == 1 end end,
    predicate = function() return function() return random(2) == 1 end end,
    effect = function(id)
      return function(fsm)
        seen["taken " .. id] = true
        if sends[id] and fsm == fsm_of() then rfsm.send_events(fsm, sends[id]) end
      end
    end,
    entry = function(id) return function() seen["entered " .. id] = true end end,
    doo = function()
      return function()
        while random(3) > 1 do rfsm.yield(random(2) == 1) end
      end
    end,
  }
end

local LENGTH = 6 -- steps of a run, on average

-- Takes a step with at most one event or timer. Returns whether two timers came.
local function wander_on(fsm, random, events, clock)
  local choice, fired = random(4), 0
  local wait = choice == 1 and rfsm_timeevent.next_deadline(fsm)
  for _, entry in ipairs(rfsm.machines(fsm)) do
    entry.machine.dbg = function(id) if id == "TIMEEVENT" then fired = fired + 1 end end
  end
  if wait then
    clock.now = clock.now + wait + 0.0000001
  elseif choice > 2 and events[1] ~= nil then
    rfsm.send_events(fsm, events[random(#events)])
  end
  rfsm.step(fsm)
  return fired > 1
end

-- Runs the chart so often. Returns a set of texts of what was seen.
local function run_at_random(chart, events, sends, seed)
  local random, seen, fsm = new_random(seed), {}, nil
  local clock = { now = 0 }
  fsm = rfsm.init(model_of(chart, wanderer(random, seen, sends,
    function() return fsm end), ""))
  for _, entry in ipairs(rfsm.machines(fsm)) do
    entry.machine.gettime = function() return clock.now, 0 end
  end
  for _ = 1, claim.runs do
    repeat
      if wander_on(fsm, random, events, clock) then break end
      for _, text in ipairs(stands_of(fsm)) do seen[text] = true end
    until random(LENGTH) == 1
    rfsm.reset(fsm)
  end
  return seen
end

-- Exploration -----------------------------------------------------------------------

-- Returns the paths of the model's elements in puppets, by those in this file.
local function paths_of(chart)
  local fsm, path_of = rfsm.init(model_of(chart, {}, "")), {}
  for _, entry in ipairs(rfsm.machines(fsm)) do
    for _, tr in ipairs(rfsm.elements(entry.machine, rfsm.is_trans)) do
      path_of[tr.number] = place.path(tr, entry.prefix)
    end
  end
  return path_of
end

-- Returns the first configuration, or the first step, that shows each text.
local function explored(walk)
  local shown, own = {}, walk.puppet
  for number = 1, #walk.keys do
    local texts = {}
    for i, stand in ipairs(walk:configuration(number)) do
      texts[i] = own.parts[i].prefix .. " " .. (stand.leaf
        and stand.leaf._fqn .. " " .. stand.mode or "none")
    end
    texts[#texts + 1] = table.concat(texts, "; ")
    for _, text in ipairs(texts) do shown[text] = shown[text] or { at = number } end
  end
  for number, step in pairs(walk.taken) do -- any order: a set
    shown["taken " .. own.transitions[number].tr.number] = { at = step.from,
      label = step.label }
  end
  return shown
end

-- Follows a witness on a machine of its own; returns a set of texts of what it shows.
local function follow(chart, witness, sends)
  local answers, seen, at, fsm = {}, {}, 0, nil
  local function answer()
    at = at + 1
    return (answers[at] or {}).answer
  end
  local make = wanderer(new_random(1), seen, sends, function() return fsm end)
  make.guard = function() return answer end
  make.predicate = function() -- asked once about each event of a step
    local known, of_step = {}, nil
    return function(event)
      if of_step ~= answers then known, of_step = {}, answers end
      if known[event] == nil then known[event] = answer() or false end
      return known[event]
    end
  end
  make.doo = function()
    return function()
      while not (answers[at + 1] and answer()) do rfsm.yield(true) end
    end
  end
  fsm = rfsm.init(model_of(chart, make, ""))
  local machine_of = {}
  for _, entry in ipairs(rfsm.machines(fsm)) do
    machine_of[entry.prefix] = entry.machine
    entry.machine.gettime = function() return 0, 0 end
  end
  for _, step in ipairs(witness) do
    answers, at = step.choices, 0
    for text in pairs(seen) do seen[text] = nil end
    for _, event in ipairs(step.values) do rfsm.send_events(fsm, event) end
    for _, inner in ipairs(step.inside) do
      rfsm.send_events(machine_of[inner.prefix], inner.event)
    end
    rfsm.step(fsm)
  end
  for _, text in ipairs(stands_of(fsm)) do seen[text] = true end
  return seen
end

-- The claim -------------------------------------------------------------------------

local BOUND = 300 -- configurations: charts that have more are left out

-- Returns random options: an alphabet now and then, and what effects send.
local function options_of(chart, random)
  local sends, own = {}, {}
  for number, path in pairs(paths_of(chart)) do -- any order: decided by the number
    if not number:find("/", 1, true) and tonumber(number) % 7 == 1 then
      sends[number], own["effect " .. path] = "e2", { "e2" }
    end
  end
  local alphabet = random:chance(25) and {}
  for i = 1, alphabet and 2 or 0 do alphabet[i] = EVENTS[i] end
  return { sends = own, configurations = BOUND, alphabet = alphabet or nil }, sends
end

local function explore_chart(chart, options)
  local function yes() return true end
  local function make() return yes end
  local model = model_of(chart, { guard = make, predicate = make, doo = make,
    effect = make, entry = make }, "")
  local ok, walk = pcall(explore.walk, model, options)
  if ok then return walk end
  if options.alphabet and tostring(walk):find("alphabet: no transition", 1, true) then
    options.alphabet = nil -- which the chart does not name
    return explore_chart(chart, options)
  end
  error(walk, 0)
end

-- Appends in which way exploring the chart of `seed` and random runs differ.
local function compare(seed, list)
  local chart, random = claim.chart(seed), new_random(seed + 13)
  local options, sends = options_of(chart, random)
  local walk = explore_chart(chart, options)
  if walk.bound then return end
  local events, shown = walk.puppet:outside_events(), explored(walk)
  events = options.alphabet or events
  if not options.alphabet then table.insert(events, "e_?") end
  local seen = run_at_random(chart, events, sends, seed)
  for text in pairs(seen) do -- any order: sorted
    local is_shown = shown[text] or text:find("^entered")
    if not is_shown then list[#list + 1] = ("%d: %s was seen"):format(seed, text) end
  end
  for text, step in pairs(shown) do -- any order: sorted
    if not follow(chart, walk:witness(step.at, step.label), sends)[text] then
      list[#list + 1] = ("%d: %s is not reached"):format(seed, text)
    end
  end
end

--- Explores the charts of so many seeds. Returns their number, and what is wrong.
function claim.run(n, seed)
  local list = {}
  for i = seed or 1, (seed or 1) + n - 1 do compare(i, list) end
  table.sort(list)
  return n, list[1] and table.concat(list, "\n") or nil
end

return claim
