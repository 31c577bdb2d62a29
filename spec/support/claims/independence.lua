-- Regions one by one against all of them together: random charts with two or three
-- regions, most of which have events of their own. The verdicts are the same, random
-- runs break none of them, and each witness shows what it is for.

local charts = require "spec.support.claims.explore"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local run_seeds = require "spec.support.run_seeds"
local rfsm_checks = require "rfsm_checks"
local timing = require "spec.support.claims.timing"

local claim = { name = "regions one by one, and together", runs = 20, reduced = 0 }

local BOUND = 120 -- configurations: charts that have more are left out

local MANY = 5 -- transitions: a step of a chart with more has many choices

-- Returns the events of a transition with other names; no predicates. A state's
-- transition on any event gets an event.
local function own_events(chart, tr, name)
  local events, is_quiet = {}, chart.nodes[tr.src].kind == "connector"
  for _, event in ipairs(tr.events_ref or {}) do
    if type(event) == "string" then
      events[#events + 1] = event:find("^e_") and event
        or event:gsub("e%d", name .. "%0")
    end
  end
  if not (events[1] or is_quiet) then events[1] = name .. "e1" end
  return events
end

-- Gives a chart, and those in it, events of its own.
local function rename_events(chart, name)
  for _, tr in ipairs(chart.transitions) do
    tr.events_ref = own_events(chart, tr, name)
    if tr.src:find("initial$") then tr.guard = nil end
  end
  for _, regions in pairs(chart.regions) do -- any order: each stands alone
    for _, region in ipairs(regions.of) do rename_events(region, name) end
  end
end

-- Lists the states of a chart and of those in it, by path, with a list for each region.
local function states_of(chart, prefix, lists)
  local list = {}
  lists[#lists + 1] = list
  for _, fqn in ipairs(chart.names) do
    if chart.nodes[fqn].kind == "state" then list[#list + 1] = prefix .. fqn:sub(5) end
    local regions = chart.regions[fqn]
    for i, region in ipairs(regions and regions.of or {}) do
      states_of(region, ("%s%s.%d"):format(prefix, fqn:sub(5), i), lists)
    end
  end
  return lists
end

-- Returns a chart with few transitions.
local function small_chart(random, depth, is_timed)
  local chart
  repeat
    chart = charts.chart(random:below(1000000), depth, is_timed)
  until chart.names[2] and #chart.transitions <= MANY
  return chart
end

local EVENTS = { "e1", "e2", "e3", "e4" }

-- Returns a chart with regions in one leaf at least; nil if it has no leaf.
function claim.chart(seed)
  local random, is_timed = new_random(seed + 3), seed % 4 == 0
  local chart, leaves = small_chart(random, 0, is_timed), {}
  for _, fqn in ipairs(chart.names) do
    local node = chart.nodes[fqn]
    if node.is_leaf and fqn ~= "root" then leaves[#leaves + 1] = fqn end
  end
  if not leaves[1] then return nil end
  local fqn, of = random:pick(leaves), {}
  chart.events = { "e1", "e2", "e3", "e4" }
  for i = 1, 1 + random:below(2) do
    of[i] = small_chart(random, 1, is_timed and random:chance(50))
    if random:chance(85) then
      local name = ("r%d"):format(i)
      rename_events(of[i], name)
      for _, event in ipairs(EVENTS) do table.insert(chart.events, name .. event) end
    end
  end
  chart.nodes[fqn].doo = false
  chart.regions[fqn] = { step = 1, of = of }
  if random:chance(30) then charts.add_join(chart, fqn) end
  if random:chance(40) then
    for _, region in ipairs(of) do charts.add_words(region, random) end
    charts.add_words(chart, random)
  end
  return chart
end

--- Returns properties, most of which name states of one region or of the machine.
function claim.properties_of(chart, random)
  local lists, properties = states_of(chart, "root", {}), {}
  local function pick(list) return random:pick(list or random:pick(lists)) end
  for i = 1, 4 do
    local list = random:pick(lists)
    local kinds = {
      function() return timing.random_property(random, list, chart.events) end,
      function() return rfsm_checks.never { pick(list), pick() } end,
      function() return rfsm_checks.always(pick(list)) end,
      function() return rfsm_checks.from(pick(list)).can_reach(pick(list)) end,
      function() return rfsm_checks.after(pick(chart.events)).reach(pick(list)) end,
    }
    properties["p" .. i] = random:pick(kinds)()
  end
  return properties
end

-- Returns what an exploration has found as texts, but for what runs it takes.
local function texts_of(result)
  local texts = {}
  for _, finding in ipairs(result.findings) do
    if finding.code ~= "dead-end" and finding.code ~= "trap" then
      texts[finding.code .. " " .. finding.place] = true
    end
  end
  for _, judged in ipairs(result.properties) do
    texts[judged.name .. " " .. tostring(judged.holds)
      .. (judged.vacuous and " vacuously" or "")] = true
  end
  return texts
end

local function has_dead_end(result)
  for _, finding in ipairs(result.findings) do
    if finding.code == "dead-end" then return true end
  end
  return false
end

local function add_differences(seed, one, other, text, properties, list)
  for _, name in ipairs(rfsm.sorted_keys(one)) do
    if not other[name] then
      list[#list + 1] = ("%d: %s %s (%s)"):format(seed, name, text,
        tostring(properties[name:match("^p%d")]))
    end
  end
end

--- Returns the properties that a machine can be watched for.
function claim.watchable(properties)
  local list = {}
  for name, property in pairs(properties) do -- any order: a copy
    if property.kind ~= "from" then list[name] = property end
  end
  return list
end

local LONG = 300 -- steps

-- Are there so many choices that regions together would take long?
local function is_long(model)
  local result = rfsm_checks.explore(model, { configurations = BOUND })
  return result.bound ~= nil or result.steps > LONG
end

-- Appends what is wrong. Returns whether the chart was compared.
local function compare(seed, list)
  local chart, random = claim.chart(seed), new_random(seed + 31)
  if not chart then return false end
  local properties = claim.properties_of(chart, random)
  local options = { period = random:chance(10) and 0.75 or nil,
    configurations = BOUND, properties = properties }
  local function make() return rfsm.yield end
  local model = charts.model_of(chart, { guard = make, predicate = make, doo = make },
    "")
  if is_long(model) then return false end
  local result = rfsm_checks.explore(model, options)
  options.multiply = true
  local together = rfsm_checks.explore(model, options)
  if together.bound then return false end
  if result.premises:find("one by one", 1, true) then
    claim.reduced = claim.reduced + 1
  end
  local texts, others = texts_of(result), texts_of(together)
  add_differences(seed, texts, others, "only one by one", properties, list)
  add_differences(seed, others, texts, "only together", properties, list)
  if has_dead_end(together) and not has_dead_end(result) then
    list[#list + 1] = seed .. ": a dead end only together"
  end
  options.together, options.runs = 1, claim.runs
  local _, broken = timing.run_at_random(chart, claim.watchable(properties), options,
    seed)
  timing.check_properties(seed, chart, properties, result, broken, list)
  return true
end

claim.run = run_seeds(compare)

return claim
