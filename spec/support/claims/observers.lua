-- Observers, their words, flags that events switch, deferral and data by example
-- against brute force: random charts with regions and awaits. An evaluator of its own
-- reads the words of a run. What is said to hold is not broken by random runs, and each
-- witness breaks the property on a machine of its own; a machine that is watched says
-- the same.

local explore = require "spec.support.claims.explore"
local location = require "rfsm.shared.location"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local run_seeds = require "spec.support.run_seeds"
require "rfsm.defer"

local claim = { name = "observers, and random runs", runs = 60 }

local CLASSES = { e_d = { { n = 1 }, { n = 3 } } }
local FLAGS = { door = { on = { "e1" }, off = { "e2" } } }

local function is_large(_, _, event) return event.n > 2 end
local function is_small(_, _, event) return event.n < 2 end

-- Charts ----------------------------------------------------------------------------

-- Gives some transitions of the outer machine an event with data and a guard that reads
-- it. Returns the guards by the number of the transition.
local function add_data(chart, random)
  local guards = {}
  for i, tr in ipairs(chart.transitions) do
    local is_plain = chart.nodes[tr.src].kind == "state" and not tr.is_internal
      and not tr.always and tr.events_ref and tr.events_ref[1] ~= nil
    if is_plain and random:chance(25) then
      guards[tostring(i)] = random:pick { is_large, is_small }
    end
  end
  return guards
end

-- A model of the chart; `wrap` makes a guard with data of the one that reads it.
local function model_of(chart, make, guards, wrap)
  local model = explore.model_of(chart, make, "")
  rfsm.mapfsm(function(tr)
    local guard = guards[tr.number]
    if guard then
      tr.events, tr.guard = { rfsm.named "e_d" }, wrap and wrap(guard) or guard
    end
  end, model, rfsm.is_trans)
  return model
end

-- Properties ------------------------------------------------------------------------

-- Returns a random thing: a leaf, the flag, an event, or an entry or exit.
local function new_thing(names, random, is_event)
  local kind = random:below(is_event and 2 or 4)
  if kind == 1 then return random:pick(names.events) end
  if kind == 2 then
    return random:pick { "entry ", "exit " } .. random:pick(names.states)
  end
  return random:chance(15) and "door" or random:pick(names.leaves)
end

local function is_condition(thing)
  return thing == "door" or thing:find("^root") ~= nil
end

-- Makers of properties: each returns the property and its parts.
local makers = {}

function makers.never_until(names, random)
  local own = { event = new_thing(names, random, true), goal = new_thing(names, random),
    ending = new_thing(names, random),
    scope = random:chance(40) and random:pick(names.leaves) or nil }
  local half = own.scope and rfsm_checks.from(own.scope).after(own.event)
    or rfsm_checks.after(own.event)
  return half.never(own.goal).until_(own.ending), own
end

function makers.precedes(names, random)
  local own = { what = new_thing(names, random), goal = new_thing(names, random),
    again = random:chance(60) and new_thing(names, random, true) or nil }
  local property = rfsm_checks.precedes(own.what, own.goal)
  return own.again and property.since(own.again) or property, own
end

function makers.unless(names, random)
  local leaves = { random:pick(names.leaves), random:pick(names.leaves) }
  local own = { ending = new_thing(names, random), what = function(active)
    return active(leaves[1]) or active(leaves[2])
  end }
  return rfsm_checks.always(own.what).unless(own.ending), own
end

-- A random observer of three leaves and `bad`, to which the last transition leads.
function makers.observer(names, random)
  local own, leaves = { trs = {} }, { "s1", "s2", "s3" }
  local model = { bad = rfsm.state {}, rfsm.trans { src = "initial", tgt = "s1" } }
  for _, src in ipairs(leaves) do
    model[src] = rfsm.state {}
    for _ = 1, 1 + random:below(2) do
      local tr = { src = src, word = new_thing(names, random, true),
        tgt = random:chance(25) and "bad" or random:pick(leaves) }
      local is_step = random:chance(30)
      if is_step then tr.word = "step" end
      if is_step or not tr.word:find(" ") and random:chance(40) then
        tr.when = random:chance(15) and "door" or random:pick(names.leaves)
      end
      own.trs[#own.trs + 1] = tr
      model[#model + 1] = rfsm.trans { src = src, tgt = tr.tgt, events = { tr.word },
        when = tr.when, pn = -#own.trs }
    end
  end
  own.trs[#own.trs].tgt, model[#model].tgt = "bad", "bad"
  return rfsm_checks.observer(rfsm.state(model)), own
end

-- The evaluator ---------------------------------------------------------------------

-- Does a thing happen at a word? A pattern looks also at what a step passes.
local function happens(thing, said)
  if not is_condition(thing) then return said.word == thing end
  return (said.word == "step" or said.word == "pass") and said.view(thing)
end

-- Kind of a property -> function of the parts, the state and a word, which returns the
-- next state; the first state is false.
local evaluators = {}

function evaluators.never_until(own, state, said)
  if not state then
    local is_in_scope = not own.scope or said.view(own.scope)
    return is_in_scope and happens(own.event, said) and "held"
  elseif happens(own.ending, said) then
    return false
  end
  return happens(own.goal, said) and "bad" or state
end

function evaluators.precedes(own, state, said)
  if state == "seen" then
    return not (own.again and happens(own.again, said)) and "seen"
  elseif happens(own.what, said) then
    return "seen"
  end
  return happens(own.goal, said) and "bad"
end

function evaluators.unless(own, state, said)
  if state == "free" or happens(own.ending, said) then return "free" end
  return said.word == "step" and not own.what(said.view) and "bad"
end

function evaluators.observer(own, state, said)
  state = state or "s1"
  for _, tr in ipairs(own.trs) do
    local is_open = tr.src == state and tr.word == said.word
      and (not tr.when or said.view(tr.when))
    if is_open then return tr.tgt end
  end
  return state
end

-- Runs ------------------------------------------------------------------------------

-- Has a machine judge its own words, from its reset on. Returns a table: is it `bad`?
local function judged_by(fsm, kind, own)
  local judge = { state = false, door = false, is_entered = false }
  local states = {}
  for _, at in ipairs(rfsm.machines(fsm)) do
    for _, state in ipairs(rfsm.elements(at.machine, rfsm.is_state)) do
      states[location.path(state, at.prefix)] = state
    end
  end
  local function new_view()
    local active = { door = judge.door }
    for path, state in pairs(states) do -- any order: a set
      active[path] = state._mode ~= "inactive"
    end
    return function(name) return active[name] end
  end
  local said = {}
  local function say(word, passed)
    said[#said + 1] = { word = word, view = new_view(), passed = passed }
  end
  for path, state in pairs(states) do -- any order: hooks of different states
    local machine = fsm
    for _, at in ipairs(rfsm.machines(fsm)) do
      if path:find(at.prefix .. ".", 1, true) == 1 or path == at.prefix then
        machine = at.machine
      end
    end
    rfsm.entry_hook_add(machine, state, function()
      say("entry " .. path)
      say("pass", state)
    end)
    rfsm.exit_hook_add(machine, state, function() say("exit " .. path) end)
  end
  rfsm.pre_step_hook_add(fsm, function(_, events)
    for _, event in ipairs(judge.is_entered and events or {}) do
      if event == "e1" or event == "e2" then judge.door = event == "e1" end
      say(rfsm.name_with_data(event) or event)
    end
  end)
  function judge.finish()
    judge.is_entered = fsm._act_leaf ~= false
    if judge.is_entered then say("step") end
    for _, each in ipairs(judge.is_entered and said or {}) do
      local is_heard = not each.passed or each.passed._mode == "inactive"
      if is_heard and judge.state ~= "bad" then
        judge.state = evaluators[kind](own, judge.state, each)
      end
    end
    said = {}
  end
  function judge.reset()
    judge.state, judge.door, judge.is_entered, said = false, false, false, {}
  end
  return judge
end

local function count_kept(fsm)
  local count = 0
  for _, at in ipairs(rfsm.machines(fsm)) do
    count = count + #(at.machine._deferred and at.machine._deferred.list or {})
  end
  return count
end

-- Makes a machine, and watches it if the property has no flag. Returns how many reports
-- there were.
local function new_machine(model, property, is_watchable)
  local told = { count = 0 }
  local fsm = rfsm.init(model)
  for _, at in ipairs(rfsm.machines(fsm)) do
    at.machine.gettime = function() return 0, 0 end
  end
  fsm.err = function(text)
    if tostring(text):find("^property '") then told.count = told.count + 1 end
  end
  if is_watchable then rfsm_checks.watch_properties(fsm, { p = property }) end
  return fsm, told
end

-- Runs the chart at random. Returns whether a run breaks the property, and whether the
-- machine that is watched says so.
local function break_at_random(test, random)
  local fsm
  local world = { random = random, seen = {}, sends = {}, flags = {}, sets = {},
    steps = 0 }
  local make = explore.wanderer(world, function() return fsm end)
  local told
  fsm, told = new_machine(model_of(test.chart, make, test.guards), test.property,
    test.is_watchable)
  local judge = judged_by(fsm, test.kind, test.own)
  for _ = 1, claim.runs do
    judge.reset()
    rfsm.reset(fsm)
    for _ = 1, random(12) do
      local event = random(4) > 1 and test.events[random(#test.events)] or nil
      if event == "e_d" then event = { name = "e_d", n = random(2) * 2 - 1 } end
      if not explore.is_busy(fsm) then rfsm.send_events(fsm, event) end
      world.steps = world.steps + 1
      rfsm.step(fsm)
      if count_kept(fsm) > test.options.deferred then break end
      judge.finish()
      if judge.state == "bad" or told.count > 0 then
        return judge.state == "bad", told.count > 0
      end
    end
  end
  return false, false
end

-- Follows a witness. Returns whether it breaks the property, and whether the machine
-- that is watched says so.
local function follow(test, witness)
  local fsm
  local world = { random = new_random(1), seen = {}, sends = {}, flags = {}, sets = {} }
  local make = explore.wanderer(world, function() return fsm end)
  local answer_by = explore.answering(make)
  local answer = make.guard()
  local told
  fsm, told = new_machine(model_of(test.chart, make, test.guards, function(guard)
    return function(...)
      answer()
      return guard(...)
    end
  end), test.property, test.is_watchable)
  local machine_of = {}
  for _, at in ipairs(rfsm.machines(fsm)) do machine_of[at.prefix] = at.machine end
  local judge = judged_by(fsm, test.kind, test.own)
  for _, step in ipairs(witness) do
    answer_by(step.choices)
    for _, event in ipairs(step.values) do explore.send(fsm, event) end
    for _, inner in ipairs(step.inside) do
      explore.send(machine_of[inner.prefix], inner.event)
    end
    rfsm.step(fsm)
    judge.finish()
  end
  return judge.state == "bad", told.count > 0
end

-- The claim -------------------------------------------------------------------------

-- Returns the names that properties may use.
local function names_of(model, events)
  local names = { events = events, states = {}, leaves = {} }
  for _, at in ipairs(rfsm.machines(rfsm.init(model))) do
    for _, state in ipairs(rfsm.elements(at.machine, rfsm.is_state)) do
      local path = location.path(state, at.prefix)
      if state ~= at.machine then names.states[#names.states + 1] = path end
      if rfsm.is_leaf(state) then names.leaves[#names.leaves + 1] = path end
    end
  end
  return names
end

-- Lists the events from outside that a model knows, by their names.
local function events_of(model)
  local events, walk = {}, require("rfsm.explore.explore").walk(model,
    { configurations = 1 })
  for _, event in ipairs(explore.outside_events(walk.subject)) do
    local name = rfsm.name_with_data(event) or event
    if type(name) == "string" and name:find("^e") then events[#events + 1] = name end
  end
  return events
end

-- Do the parts of a property name the flag?
local function names_door(own)
  local has_door = false
  for _, thing in pairs(own) do has_door = has_door or thing == "door" end -- any order
  for _, tr in ipairs(own.trs or {}) do has_door = has_door or tr.when == "door" end
  return has_door
end

-- Makes a random property of a chart with these names, and its options.
local function new_property(test, names, random)
  test.kind = random:pick { "never_until", "precedes", "unless", "observer" }
  test.property, test.own = makers[test.kind](names, random)
  local has_door, has_data = names_door(test.own), next(test.guards) ~= nil
  test.options = { configurations = 400, timers = "free", together = 1,
    deferred = random:below(3), properties = { p = test.property },
    flags = has_door and FLAGS or nil, classes = has_data and CLASSES or nil }
  test.is_watchable = not has_door
  for _, event in ipairs(has_door and { "e1", "e2" } or {}) do
    test.events[#test.events + 1] = event
  end
  if has_data then test.events[#test.events + 1] = "e_d" end
end

-- Returns what is compared for a seed; nil if its chart is left out.
local function new_test(seed)
  local random = new_random(seed + 23)
  local test = { chart = explore.chart(seed), guards = {} }
  if random:chance(50) then test.guards = add_data(test.chart, random) end
  local function yes() return true end
  local function make() return yes end
  test.model = model_of(test.chart, { guard = make, predicate = make, doo = make },
    test.guards)
  test.events = events_of(test.model)
  local names = names_of(test.model, test.events)
  if not (test.events[1] and names.leaves[2]) then return nil end
  new_property(test, names, random)
  return test
end

claim.counts = { holds = 0, fails = 0, open = 0 }

-- Appends what is wrong with the verdict of a seed. Returns whether it is known.
local function compare(seed, list)
  local test = new_test(seed)
  if not test then return false end
  local ok, result = pcall(rfsm_checks.explore, test.model, test.options)
  if not ok then error(seed .. ": " .. tostring(result), 0) end
  local judged = result.properties[1]
  local function note(text)
    list[#list + 1] = ("%d: %s: %s"):format(seed, test.kind, text)
  end
  if judged.holds == nil then
    claim.counts.open = claim.counts.open + 1
    return false
  elseif judged.holds then
    claim.counts.holds = claim.counts.holds + 1
    local is_broken, is_told = break_at_random(test, new_random(seed + 41))
    if is_broken then note("holds, and a run breaks it") end
    if is_told then note("holds, and a machine that is watched reports it") end
  else
    claim.counts.fails = claim.counts.fails + 1
    local is_broken, is_told = follow(test, judged.witness)
    if not is_broken then note("the witness does not break it") end
    if test.is_watchable and not is_told then note("a watch does not see it") end
  end
  return true
end

claim.run = run_seeds(compare)

return claim
