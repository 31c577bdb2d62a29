-- Exploration against brute force: random charts with timers, awaits, predicates and
-- sequential AND states, callbacks that fail, a third with histories, a quarter with
-- deferred events, with random options. Whatever
-- random runs reach was reached, also of several machines and flags at once, and each
-- witness leads to its end on a machine of its own.

local bare = require "spec.support.bare"
local charts = require "spec.support.charts"
local driven = require "spec.support.driven"
local explore = require "rfsm.explore.explore"
local new_random = require "spec.support.random"
local location = require "rfsm.shared.location"
local match = require "rfsm.shared.match"
local subject = require "rfsm.explore.subject"
local rfsm = require "rfsm"
local run_seeds = require "spec.support.run_seeds"
local rfsm_timeevent = require "rfsm_timeevent"
require "rfsm.await"
require "rfsm.defer"
require "rfsm.faults"
require "rfsm.history"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local claim = { name = "exploration and random runs", runs = 300 }

-- Charts ----------------------------------------------------------------------------

local EVENTS = { "e1", "e2", "e3", "e4" }

-- Returns one event more for a transition: of a time that no other has, or an await. A
-- timed chart has more time events, many of the same time.
local function extra_event(random, i, is_timed)
  if is_timed and random:chance(50) then
    if random:chance(25) then return ("e_every(%.1f)"):format(random:below(4) / 2) end
    return ("e_after(%.1f)"):format((random:below(5) - 1) / 2)
  elseif not is_timed and random:chance(5) then
    return ("e_every(%d)"):format(random:below(3))
  elseif not is_timed and random:chance(8) then
    return "e_fault"
  end
  if random:chance(15) and not is_timed then
    return ("e_after(%d.%03d)"):format(random:below(3), i)
  end
  if not random:chance(10) then return nil end
  return ("await(%s, %s)"):format(random:pick(EVENTS), random:pick(EVENTS))
end

local function add_events(chart, random, is_timed)
  for i, tr in ipairs(chart.transitions) do
    if chart.nodes[tr.src].kind == "state" and tr.events_ref and not tr.is_internal then
      local events = {}
      for n, event in ipairs(tr.events_ref) do events[n] = event end
      events[#events + 1] = extra_event(random, i, is_timed)
      tr.events_ref = events
    end
  end
end

-- Gives some leaves, by chance, regions, which are charts, too.
local function add_regions(chart, random, depth, is_timed, chance)
  chart.regions = {}
  for _, fqn in ipairs(chart.names) do
    local node = chart.nodes[fqn]
    if depth < 2 and fqn ~= "root" and node.is_leaf and random:chance(chance) then
      node.doo = false
      chart.regions[fqn] = { step = random:below(2), of = {} }
      for i = 1, random:below(2) do
        chart.regions[fqn].of[i] = claim.chart(random:below(1000000), depth + 1,
          is_timed)
      end
    end
  end
end

function claim.chart(seed, depth, is_timed)
  local chart, random = charts.generate(seed), new_random(seed + 7)
  add_events(chart, random, is_timed)
  if seed % 3 == 0 then charts.add_histories(chart) end
  if seed % 4 == 0 then charts.add_deferrals(chart, EVENTS, 2) end
  chart.read = seed % 5 == 0 and "one" or nil
  add_regions(chart, random, depth or 0, is_timed, 8)
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
  model.read = chart.read
  rfsm.mapfsm(function(tr) tr.number = prefix .. tr.number end, model, rfsm.is_trans)
  for fqn, regions in pairs(chart.regions) do -- any order: each stands alone
    local fields = { step = regions.step, warn = false, info = false,
      entry = make.entry and make.entry(prefix .. fqn),
      exit = make.exit and make.exit(prefix .. fqn) }
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

-- What the callbacks of random runs do: they note what they see, set flags, and send.
---@class World
---@field random function
---@field seen table<string, true>
---@field sends table<string, string> what an effect sends, by the number of it
---@field later table<string, table[]>|nil likewise later, as in the option `sends`
---@field ids table<rfsm.Machine, table[]> of what was sent later
---@field flags table<string, string> "+" or "-" by name
---@field sets table<string, table[]> what a callback sets: { name, sign }, by "entry F"
---@field fails boolean|nil effects and entries fail by chance, when all else is done

local function set_flags(world, id)
  for _, flag in ipairs(world.sets[id] or {}) do world.flags[flag[1]] = flag[2] end
end

local function flags_text(flags)
  local signs = {}
  for i, name in ipairs(rfsm.sorted_keys(flags)) do signs[i] = flags[name] end
  return table.concat(signs)
end

-- Returns the path of a state in subjects: "root.a/1/root.b" is "root.a.1.b".
local function path_of_state(id) return (id:gsub("/(%d+)/root", ".%1")) end

-- Returns the leaf and mode of each machine as texts, and all of them with the flags.
local function stands_of(fsm, flags)
  local texts = {}
  for i, entry in ipairs(rfsm.machines(fsm)) do
    local leaf = entry.machine._act_leaf
    texts[i] = entry.prefix .. " "
      .. (leaf and leaf._fqn .. " " .. leaf._mode or "none")
  end
  texts[#texts + 1] = table.concat(texts, "; ") .. " " .. flags_text(flags)
  return texts
end

-- Sends events later, and cancels all of a kind, as the items of a list say.
local function send_later(world, fsm, items)
  world.ids[fsm] = world.ids[fsm] or {}
  local ids = world.ids[fsm]
  for _, item in ipairs(items) do
    for i = item.cancel and #ids or 0, 1, -1 do
      if ids[i].event == item.cancel then
        rfsm_timeevent.cancel(fsm, table.remove(ids, i))
      end
    end
    if item.after then
      ids[#ids + 1] = { event = item[1] }
      rfsm_timeevent.send_after(fsm, item.after, item[1], ids[#ids])
    end
  end
end

local function fail_by_chance(world)
  if world.fails and world.random:chance(5) then error("on purpose", 0) end
end

-- The callbacks of random runs.
local function wanderer(world, fsm_of)
  local random, seen, sends = world.random, world.seen, world.sends
  world.ids = {}
  return {
    guard = function() return function() return random(2) == 1 end end,
    predicate = function() -- one answer for an event in a step
      local answers, count = {}, nil
      return function(event)
        if count ~= world.steps then answers, count = {}, world.steps end
        if answers[event] == nil then answers[event] = random(2) == 1 end
        return answers[event]
      end
    end,
    effect = function(id)
      return function(fsm)
        seen["taken " .. id] = true
        set_flags(world, "effect " .. id)
        if sends[id] and fsm == fsm_of() then rfsm.send_events(fsm, sends[id]) end
        send_later(world, fsm, world.later and world.later[id] or {})
        fail_by_chance(world)
      end
    end,
    entry = function(id)
      return function()
        seen["entered " .. path_of_state(id)] = true
        set_flags(world, "entry " .. path_of_state(id))
        fail_by_chance(world)
      end
    end,
    exit = function(id)
      return function() set_flags(world, "exit " .. path_of_state(id)) end
    end,
    doo = driven.yielding(random),
  }
end

local LENGTH = 6 -- steps of a run, on average

local function count_faults(fsm)
  local count = 0
  for _, event in ipairs(fsm._intq) do
    local name = rfsm.name_with_data(event)
    if name and name:find("^e_fault@") then count = count + 1 end
  end
  return count
end

-- Does nothing come from outside to a machine, since it takes one event and is busy?
function claim.is_busy(fsm) return fsm.read == "one" and rfsm.check_events(fsm) > 0 end

-- Takes a step with so many events, faults and timers at most, and only timers if a
-- machine that takes one event is busy. Returns whether there were more.
local function wander_on(fsm, world, events, clock, most)
  local random = world.random
  local fired = 0
  local is_busy = claim.is_busy(fsm)
  for _, entry in ipairs(rfsm.machines(fsm)) do
    entry.machine.dbg = function(id) if id == "TIMEEVENT" then fired = fired + 1 end end
    fired = fired + count_faults(entry.machine)
  end
  for _ = 1, random(most) do
    local choice = random(4)
    local wait = choice == 1 and rfsm_timeevent.next_deadline(fsm)
    if wait and clock.now == clock.last then
      clock.now = clock.now + wait + 0.0000001
    elseif choice > 2 and events[1] ~= nil and not is_busy then
      rfsm.send_events(fsm, events[random(#events)])
      fired = fired + 1
    end
  end
  world.steps = (world.steps or 0) + 1
  rfsm.step(fsm)
  clock.last = clock.now
  return fired > most
end

-- Runs the chart so often. Returns a set of texts of what was seen.
local function run_at_random(chart, events, choice, seed)
  local fsm
  local world = { random = new_random(seed), seen = {}, sends = choice.sends,
    flags = {}, sets = choice.sets, fails = true }
  local clock = { now = 0, last = 0 }
  fsm = rfsm.init(model_of(chart, wanderer(world, function() return fsm end), ""))
  for _, entry in ipairs(rfsm.machines(fsm)) do
    entry.machine.gettime = function() return clock.now, 0 end
  end
  for _ = 1, claim.runs do
    for _, name in ipairs(choice.names) do world.flags[name] = "-" end
    repeat
      if wander_on(fsm, world, events, clock, choice.together) then break end
      for _, text in ipairs(stands_of(fsm, world.flags)) do world.seen[text] = true end
    until world.random(LENGTH) == 1
    rfsm.reset(fsm)
  end
  return world.seen
end

-- Exploration -----------------------------------------------------------------------

-- Returns the paths of the model's elements in subjects, by those in this file.
local function paths_of(chart)
  local fsm, path_of = rfsm.init(model_of(chart, {}, "")), {}
  for _, entry in ipairs(rfsm.machines(fsm)) do
    for _, tr in ipairs(rfsm.elements(entry.machine, rfsm.is_trans)) do
      path_of[tr.number] = location.path(tr, entry.prefix)
    end
  end
  return path_of
end

-- Returns the first configuration, or the first step, that shows each text; false for
-- the entry of a state, which may have been in an earlier step.
local function explored(walk)
  local shown, own = {}, walk.subject
  for number = 1, #walk.keys do
    local texts = {}
    for i, position in ipairs(walk:configuration(number)) do
      texts[i] = own.parts[i].prefix .. " " .. (position.leaf
        and position.leaf._fqn .. " " .. position.mode or "none")
    end
    local conf = walk:configuration(number)
    texts[#texts + 1] = table.concat(texts, "; ") .. " " .. conf.flags
    for _, text in ipairs(texts) do shown[text] = shown[text] or { at = number } end
    for _, leaf in ipairs(subject.leaves(conf)) do
      for _, path in ipairs(leaf.paths) do shown["entered " .. path] = false end
    end
  end
  for _, passed in ipairs(walk.passed) do
    for path in pairs(passed.moment.active) do -- any order: a set
      shown["entered " .. path] = false
    end
  end
  for number, step in pairs(walk.taken) do -- any order: a set
    shown["taken " .. own.transitions[number].tr.number] = { at = step.from,
      label = step.label }
  end
  return shown
end

-- Has guards, predicates and doos of `make` answer as the choices of a step say.
-- Returns the function that begins a step with its choices.
local function answering(make)
  local answers, at = {}, 0
  local function answer()
    at = at + 1
    return (answers[at] or {}).answer
  end
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
  return function(choices) answers, at = { unpack(choices) }, 0 end -- a new table
end

-- Sends an event. To a machine that takes one event a fault has come before those that
-- wait.
local function send(fsm, event)
  rfsm.send_events(fsm, event)
  local is_fault = match.maker_of(event) == "fault"
  if is_fault and fsm._reads_one then
    table.insert(fsm._intq, 1, table.remove(fsm._intq))
  end
end

-- Follows a witness on a machine of its own, which is given to `watch`; returns a set
-- of texts of what it shows. What `watch` returns is called with the time of each step.
local function follow(chart, witness, choice, watch)
  local fsm
  local world = { random = new_random(1), seen = {}, sends = choice.sends, flags = {},
    sets = choice.sets, later = choice.later }
  for _, name in ipairs(choice.names) do world.flags[name] = "-" end
  local make = wanderer(world, function() return fsm end)
  local answer_by = answering(make)
  fsm = rfsm.init(model_of(chart, make, ""))
  local machine_of, now = {}, 0
  for _, entry in ipairs(rfsm.machines(fsm)) do
    machine_of[entry.prefix] = entry.machine
    entry.machine.gettime = function() return now, 0 end
  end
  local before = watch and watch(fsm)
  for _, step in ipairs(witness) do
    answer_by(step.choices)
    now = step.at or 0
    if before then before(now) end
    for text in pairs(world.seen) do world.seen[text] = nil end
    for _, event in ipairs(step.values) do send(fsm, event) end
    for _, inner in ipairs(step.inside) do
      send(machine_of[inner.prefix], inner.event)
    end
    rfsm.step(fsm)
  end
  for _, text in ipairs(stands_of(fsm, world.flags)) do world.seen[text] = true end
  return world.seen
end

claim.model_of, claim.wanderer, claim.stands_of = model_of, wanderer, stands_of
claim.explored, claim.follow, claim.paths_of = explored, follow, paths_of
claim.answering, claim.send = answering, send

-- The claim -------------------------------------------------------------------------

local BOUND = 300 -- configurations: charts that have more are left out

local FLAGS = { "f1", "f2" }

-- Adds flags that callbacks set: to the options, and by the names of callbacks here.
-- Each is set by some callback, and no callback has one twice.
local function add_flags(options, choice, random, callbacks)
  options.flags, choice.names = {}, FLAGS
  for _, name in ipairs(FLAGS) do
    local flag, is_used = { on = {}, off = {} }, {}
    for i = 1, 1 + random:below(4) do
      local own, field = random:pick(callbacks), "on"
      if i > 1 and random:chance(50) then field = "off" end
      if not is_used[own] then
        is_used[own] = true
        table.insert(flag[field], own.name)
        choice.sets[own.id] = choice.sets[own.id] or {}
        table.insert(choice.sets[own.id], { name, field == "on" and "+" or "-" })
      end
    end
    options.flags[name] = flag
  end
end

-- Lists the callbacks of a chart: `name` in options, `id` here.
local function callbacks_of(chart, path_of)
  local list, fsm = {}, rfsm.init(model_of(chart, {}, ""))
  for _, entry in ipairs(rfsm.machines(fsm)) do
    for _, state in ipairs(rfsm.elements(entry.machine, rfsm.is_state)) do
      local path = location.path(state, entry.prefix)
      list[#list + 1] = { name = "entry " .. path, id = "entry " .. path }
      list[#list + 1] = { name = "exit " .. path, id = "exit " .. path }
    end
  end
  for _, number in ipairs(rfsm.sorted_keys(path_of)) do
    list[#list + 1] = { name = "effect " .. path_of[number], id = "effect " .. number }
  end
  return list
end

-- Returns random options, and what they mean for random runs: an alphabet now and then,
-- one or two events a step, flags, and what effects send, as an option or in a dry run.
local function options_of(chart, random)
  local path_of = paths_of(chart)
  local choice = { sends = {}, sets = {}, names = {},
    together = random:chance(30) and 2 or 1 }
  local options = { configurations = BOUND, timers = "free", sends = {},
    together = choice.together, dry_run = random:chance(30),
    alphabet = random:chance(25) and { "e1", "e2" } or nil }
  for _, number in ipairs(rfsm.sorted_keys(path_of)) do
    if not number:find("/", 1, true) and tonumber(number) % 7 == 1 then
      choice.sends[number] = "e2"
      if not options.dry_run then
        options.sends["effect " .. path_of[number]] = { "e2" }
      end
    end
  end
  if random:chance(40) then
    add_flags(options, choice, random, callbacks_of(chart, path_of))
  end
  return options, choice
end

local function explore_chart(chart, options, sends)
  local function yes() return true end
  local function make() return yes end
  local model = model_of(chart, { guard = make, predicate = make, doo = make,
    entry = make, effect = function(id)
      return sends[id] and function(fsm) rfsm.send_events(fsm, sends[id]) end or yes
    end }, "")
  local ok, walk = pcall(explore.walk, model, options)
  if ok then return walk end
  if options.alphabet and tostring(walk):find("alphabet: no transition", 1, true) then
    options.alphabet = nil -- which the chart does not name
    return explore_chart(chart, options, sends)
  end
  error(walk, 0)
end

--- Lists the events that a subject knows and its machine does not make itself.
function claim.outside_events(own)
  local list = {}
  for _, event in ipairs(own.event_list) do
    if not own:maker_of(event) then list[#list + 1] = event end
  end
  return list
end

--- Adds transitions of faults and timers that repeat, and such that need no event.
function claim.add_words(chart, random)
  for _, tr in ipairs(chart.transitions) do
    if chart.nodes[tr.src].kind == "state" and tr.events_ref and random:chance(25) then
      local word = random:pick { "e_fault", "e_every(1)", false }
      tr.events_ref = word and { word, unpack(tr.events_ref) } or nil
      tr.always, tr.guard = not word, tr.guard or not word
    end
  end
end

--- Has regions end in the leaves right in their root, and e_done leave the state.
function claim.add_join(chart, fqn)
  for _, tr in ipairs(chart.transitions) do
    if tr.src == fqn and tr.events_ref then
      tr.events_ref = { "e_done", unpack(tr.events_ref) }
    end
  end
  for _, region in ipairs(chart.regions[fqn].of) do
    for _, node in pairs(region.nodes) do -- any order: all alike
      if node.is_leaf and node.parent == "root" then node.final = true end
    end
  end
end

-- Returns the chart of a seed, with more of what completes than others have.
local function complete_chart(seed)
  local chart, random = claim.chart(seed), new_random(seed + 19)
  if not next(chart.regions) then add_regions(chart, random, 1, false, 25) end
  for _, fqn in ipairs(chart.names) do
    local regions = chart.regions[fqn]
    for _, region in ipairs(regions and regions.of or {}) do
      claim.add_words(region, random)
    end
    if regions then claim.add_join(chart, fqn) end
  end
  claim.add_words(chart, random)
  return chart
end

-- Appends in which way exploring the chart of `seed` and random runs differ.
local function compare(seed, list)
  local chart, random = complete_chart(seed), new_random(seed + 13)
  local options, choice = options_of(chart, random)
  local walk = explore_chart(chart, options, choice.sends)
  if walk.bound then return end
  local events, shown = claim.outside_events(walk.subject), explored(walk)
  events = options.alphabet or events
  if not options.alphabet then table.insert(events, "e_?") end
  local seen = run_at_random(chart, events, choice, seed)
  for text in pairs(seen) do -- any order: sorted
    if shown[text] == nil then
      list[#list + 1] = ("%d: %s was seen"):format(seed, text)
    end
  end
  for text, step in pairs(shown) do -- any order: sorted
    if step and not follow(chart, walk:witness(step.at, step.label), choice)[text] then
      list[#list + 1] = ("%d: %s is not reached"):format(seed, text)
    end
  end
  return true
end

claim.run = run_seeds(compare)

return claim
