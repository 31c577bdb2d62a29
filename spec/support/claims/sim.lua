-- The simulator: commands leave the machine where the same calls in Lua leave it; back,
-- goto and forward land where the machine stood then, also behind an interrupt.

local drive = require "spec.support.drive"
local kept = require "spec.support.kept"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"

local interrupts = require "spec.support.interrupts"
local session = drive.require "rfsm.sim.session"
local prompt = drive.require "rfsm.sim.prompt"

local COMMANDS = {
  function(sim, fsm, random)
    local event = random:pick(drive.EVENTS)
    sim.env.se(event)
    rfsm.send_events(fsm, event)
  end,
  function(sim, fsm, random)
    local n = random(4)
    sim.env.step(n)
    rfsm.step(fsm, n)
  end,
  function(sim, fsm, random)
    local event = random:pick(drive.EVENTS)
    sim.env.ses(event)
    rfsm.send_events(fsm, event)
    rfsm.step(fsm)
  end,
  function(sim, fsm)
    sim.env.reset()
    rfsm.reset(fsm)
  end,
}

-- Notes the places of advances by number, with the events that wait for the next one.
local function wander(sim, fsm, random, places)
  places[0] = drive.place(fsm)
  for _ = 1, 25 do
    local kind = random(9)
    COMMANDS[kind == 9 and 4 or kind % 3 + 1](sim, fsm, random)
    local problem = drive.difference(sim.fsm, fsm)
    if problem then return problem end
    places[sim.history.at] = drive.place(fsm)
  end
end

local function check_place(sim, places, what)
  local at = sim.history.at
  local place = drive.place(sim.fsm)
  if place ~= places[at] then
    return ("%s %d: %s\nwas: %s"):format(what, at, place, places[at])
  end
end

-- Back by each advance, then forward again: the same places.
local function check_way_back(sim, places)
  local last, problem = sim.history.at, nil
  while sim.history.at > sim.history.first and not problem do
    sim.env.back()
    problem = check_place(sim, places, "back to")
  end
  while sim.history.at < last and not problem do
    sim.env.forward()
    problem = check_place(sim, places, "forward to")
  end
  return problem
end

local function go_anywhere(sim, random)
  local first, last = sim.history.first, sim.history.last
  sim.env.go_to(first + random:below(last - first + 1) - 1)
end

-- Goes to advances in any order.
local function check_jumps(sim, random, places)
  for _ = 1, 6 do
    go_anywhere(sim, random)
    local problem = check_place(sim, places, "goto")
    if problem then return problem end
  end
end

-- Goes back, and on in another way: what was undone is gone, the new way is kept.
local function check_new_way(sim, random, places)
  go_anywhere(sim, random)
  sim.env.ses(random:pick(drive.EVENTS))
  local at = sim.history.at
  places[at] = drive.place(sim.fsm)
  if sim.history.last ~= at then return "what was undone can be reached" end
  for n = sim.history.first, at do sim.env.go_to(n) end
  return check_place(sim, places, "the end")
end

-- What was raised in the clock, a callback, is its failure: the place has no snapshot
-- then, and the machine stays where it is. "interrupted!" is never taken for a failure.
local function check_lost(sim, number, value)
  local problem, before = sim.history[number].problem, drive.place(sim.fsm)
  local _, failure = pcall(sim.env.go_to, number)
  if value == "interrupted!" or problem ~= "rfsm_timeevent: the clock failed: "
    .. rfsm.text_of(value) or failure ~= "goto: " .. problem then
    return ("%s: a place without snapshot, %s, %s"):format(rfsm.text_of(value), problem,
      rfsm.text_of(failure))
  end
  return drive.place(sim.fsm) ~= before and "goto failed, and changed the machine"
end

local function check_back(sim, places, last, value)
  if sim.history[last].problem then return check_lost(sim, last, value) end
  sim.env.go_to(last)
  return check_place(sim, places, "interrupted, then back to")
end

-- Goes back after an advance that was interrupted anywhere, and reset by chance.
local function check_interrupted(sim, random)
  for _ = 1, 8 do
    local places, way = { [sim.history.at] = drive.place(sim.fsm) }, sim.history
    local last, at, value = way.at, random(3000), random:pick(interrupts.VALUES)
    interrupts.raise_anywhere(at, value, sim.env.ses, random:pick(drive.EVENTS))
    if random:chance(30) then sim.env.reset() end
    local problem = way.at > last and check_back(sim, places, last, value)
    if problem then return problem end
    pcall(sim.env.step, 5)
  end
end

local function check(seed)
  local random, places = new_random(seed), {}
  local sim = assert(drive.with_file(seed, function(name)
    return (session.open(name, false))
  end))
  prompt.install(sim)
  return wander(sim, assert(rfsm.init(kept.model(seed))), random, places)
    or check_way_back(sim, places) or check_jumps(sim, random, places)
    or check_new_way(sim, random, places)
    or interrupts.without_jit(check_interrupted, sim, random)
end

return { name = "sim", run = drive.each(check) }
