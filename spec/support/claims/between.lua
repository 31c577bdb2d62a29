-- Whatever a program does with a machine between two steps, its trace is that of the
-- oracle. The program copies all tables, merges elements that nothing enters, observes,
-- records, prepares, takes snapshots, puts them back, and restores them into another
-- machine.

local charts = require "spec.support.charts"
local defer = require "spec.support.claims.defer"
local driven = require "spec.support.driven"
local helper = require "spec.helper"
local new_random = require "spec.support.random"
local record = require "rfsm.record"
local rfsm = require "rfsm"
local runs = require "spec.support.runs"
local snapshot = require "rfsm.snapshot"

local state, trans = rfsm.state, rfsm.trans

-- Does no machine in it have a doo under way, a step cut short, or something to come?
-- A snapshot begins doos anew, and asks for events that were not read yet.
local function is_at_rest(fsm)
  for _, at in ipairs(rfsm.machines(fsm)) do
    local machine, leaf = at.machine, at.machine._act_leaf
    local has_doo = leaf and leaf._doo_co and not rfsm.regions(leaf)[1]
    if machine._phase ~= "idle" or machine._reset_wanted or machine._failure
      or machine._unread > 0 or has_doo then
      return false
    end
  end
  return true
end

-- Does no machine in it keep an event? A merge and a load have kept events looked at.
local function keeps_nothing(fsm)
  for _, at in ipairs(rfsm.machines(fsm)) do
    if rfsm.waiting(at.machine)[1] ~= nil then return false end
  end
  return true
end

-- Is the machine as its model says, but for targets?
local function is_of_model(world)
  if next(world.versions) or world.is_changed or world.merged then return false end
  for _, regions in pairs(world.regions) do -- any order: each stands alone
    for _, region in ipairs(regions) do
      if not is_of_model(region) then return false end
    end
  end
  return true
end

local function nothing() end

local function states_of(fsm) return rfsm.elements(fsm, rfsm.is_state) end

-- What may be done, by name: f(engine, world, random).
local ACTS = {}

function ACTS.copy(engine)
  local copies = {}
  for _, object in ipairs(charts.OBJECTS) do copies[object] = object end
  engine.replace_by(helper.copy_of(engine.fsm, copies), true)
end

-- Adds a leaf that nothing enters, with a transition from it and one to it, whose event
-- never comes.
function ACTS.merge(engine, world, random)
  local fsm, composites = engine.fsm, rfsm.elements(engine.fsm, rfsm.is_composite)
  if not (composites[1] and keeps_nothing(fsm)) then return end
  local parent, warn = random:pick(composites), fsm.warn
  world.merged = (world.merged or 0) + 1
  local name = "other" .. world.merged
  fsm.warn = false
  assert(rfsm.fsm_merge(fsm, parent, state {}, name))
  assert(rfsm.fsm_merge(fsm, parent, trans { src = name,
    tgt = random:pick(rfsm.elements(fsm, rfsm.is_leaf)) }))
  assert(rfsm.fsm_merge(fsm, parent, trans { src = name, tgt = name,
    events = { "e_never" } }, name .. "_again"))
  fsm.warn = warn
end

-- Observes the machine until the next call, and looks at it.
function ACTS.observe(engine, _, random)
  local fsm, observed = engine.fsm, random:pick(states_of(engine.fsm))
  rfsm.path_hook_add(fsm, nothing)
  rfsm.entry_hook_add(fsm, observed, nothing)
  rfsm.exit_hook_add(fsm, observed, rfsm.repeatable(function() end))
  rfsm.post_step_hook_add(fsm, nothing)
  rfsm.pre_step_hook_add(fsm, rfsm.borrows(function() end), "front")
  for _, what in ipairs { "sent", "failed", "resumed", "ended", "discarded" } do
    rfsm.watch_hook_add(fsm, what, nothing)
  end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    if random:chance(30) then rfsm.guard_hook_add(fsm, tr, nothing) end
  end
  assert(tostring(fsm) and #rfsm.machines(fsm) > 0)
  assert(rfsm.is_in(fsm, observed) == (rfsm.get_sta_mode(observed) ~= "inactive"))
  rfsm.took_path(fsm)
end

-- Records what the machine does until the next call.
function ACTS.record(engine, world)
  if not is_at_rest(engine.fsm) then return end
  local ok, recorder = pcall(record.record, engine.fsm, {})
  world.recorder = ok and recorder
end

function ACTS.prepare(engine) rfsm.prepare(engine.fsm) end

-- Takes a snapshot and puts it back, or restores it into another machine.
function ACTS.keep(engine, world, random)
  local fsm = engine.fsm
  local snap = is_at_rest(fsm) and keeps_nothing(fsm) and snapshot.try_take(fsm)
  if not snap then return end
  if random:chance(50) or not is_of_model(world) then
    return assert(snapshot.put(fsm, snap))
  end
  local other = assert(snapshot.restore(fsm, snap))
  engine.replace_by(other)
end

local NAMES = rfsm.sorted_keys(ACTS)

local function run_case(seed)
  local random, notes = new_random(seed + 17), {}
  local is_plain = random:chance(50)
  local chart = is_plain and charts.generate(seed) or defer.new_chart(seed)
  local function between(engine, world)
    if world.recorder then world.recorder:stop() end
    world.recorder = nil
    if not random:chance(40) then return end
    local name = random:pick(NAMES)
    notes[#notes + 1] = name
    ACTS[name](engine, world, random)
  end
  local at, expected, actual = runs.compare(chart, not is_plain and defer.add_models
    or nil, between)
  return at and ("after %s, line %d: oracle '%s', core '%s'"):format(
    table.concat(notes, " "), at, tostring(expected[at]), tostring(actual[at]))
end

return { name = "between two steps", run = driven.claim(run_case) }
