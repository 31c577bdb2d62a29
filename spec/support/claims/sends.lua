-- Events of rfsm_timeevent.send_after come when a model of a list says so, whatever the
-- clock does, beside timers, across snapshots and resets.

local clock = require "rfsm.clock"
local driven = require "spec.support.driven"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local rfsm_timeevent = require "rfsm_timeevent"
local snapshot = require "rfsm.snapshot"

local function new_model(now)
  return rfsm.state { info = false, warn = false, gettime = now,
    a = rfsm.state {}, b = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "a" },
    rfsm.trans { src = "a", tgt = "b", events = { "e_after(0.5)", 3 } },
    rfsm.trans { src = "b", tgt = "a", events = { 1, 2 } },
    rfsm.trans { src = "a", tgt = "internal", events = { 4 } } }
end

-- What a run does; each returns a problem.
local OPS = {}

function OPS.advance(run, random) run.now:advance(random:below(5) * 0.25) end

function OPS.set_back(run, random)
  if random:chance(20) then run.now:advance(-0.25) end
end

function OPS.send(run, random)
  run.count = run.count + 1
  local send = { seconds = random:below(8) * 0.25, event = run.count % 5,
    id = run.count, number = run.count }
  send.time = run.now:now() + send.seconds
  rfsm_timeevent.send_after(run.fsm, send.seconds, send.event, send.id)
  run.model[#run.model + 1] = send
end

function OPS.cancel(run, random)
  local id, is_there = random:below(run.count + 1), false
  for at = #run.model, 1, -1 do
    if run.model[at].id == id then is_there = table.remove(run.model, at) ~= nil end
  end
  return rfsm_timeevent.cancel(run.fsm, id) ~= is_there and "cancel " .. id
end

function OPS.reset(run, random)
  if not random:chance(20) then return end
  rfsm.reset(run.fsm)
  run.model = {}
end

local function watch(run)
  run.fsm.post_step_hook = function(_, events)
    for _, event in ipairs(events) do
      if type(event) == "number" then run.came[#run.came + 1] = event end
    end
  end
end

function OPS.snapshot(run)
  run.fsm = assert(snapshot.restore(new_model(run.now), snapshot.take(run.fsm)))
  watch(run)
end

local function sooner(a, b)
  if a.time ~= b.time then return a.time < b.time end
  return a.number < b.number
end

function OPS.run(run)
  local expected, rest = {}, {}
  table.sort(run.model, sooner)
  for _, send in ipairs(run.model) do
    local list = send.time < run.now:now() and expected or rest
    list[#list + 1] = list == rest and send or send.event
  end
  run.model, run.came = rest, {}
  rfsm.run(run.fsm)
  expected, run.came = table.concat(expected, " "), table.concat(run.came, " ")
  if run.came ~= expected then return "came: " .. run.came .. ", not " .. expected end
end

local NAMES = { "advance", "advance", "set_back", "send", "send", "send", "cancel",
  "reset", "snapshot", "run", "run" }

local function check(seed)
  local random, now = new_random(seed), clock.simulated { now = 1000 }
  local fsm = assert(rfsm.init(new_model(now)))
  local run = { fsm = fsm, now = now, model = {}, came = {}, count = 0 }
  watch(run)
  for step = 1, 40 do
    local name = random:pick(NAMES)
    local problem = OPS[name](run, random)
    if problem then return ("step %d, %s: %s"):format(step, name, problem) end
  end
end

return { name = "sends and a list", run = driven.claim(check) }
