-- The simulator: commands leave the machine where the same calls in Lua leave it; back,
-- goto and forward land where the machine stood then.

local drive = require "spec.support.drive"
local kept = require "spec.support.kept"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"

local session = drive.require "rfsm.sim.session"
local history = drive.require "rfsm.sim.history"
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

-- Events of one advance are known only when it is over: places by iteration.
local function wander(sim, fsm, random, places)
  for _ = 1, 25 do
    local kind = random(9)
    COMMANDS[kind == 9 and 4 or kind % 3 + 1](sim, fsm, random)
    local problem = drive.difference(sim.fsm, fsm)
    if problem then return problem end
    local is_sent = kind ~= 9 and kind % 3 + 1 == 1 -- what waits then is forgotten
    places.at_end = not is_sent and drive.place(fsm)
    if kind ~= 9 and not is_sent then
      places[#places + 1] = { place = drive.place(fsm), at = sim.history.at,
        count = sim.history.count }
    end
  end
end

-- Back by each mark, then forward again: the same places.
local function check_way_back(sim, places)
  local count = #places
  for i = count - 1, 1, -1 do
    while sim.history.at > places[i].at do sim.env.back() end
    local leaf = drive.place(sim.fsm)
    if leaf ~= places[i].place then
      return "back to " .. i .. ": " .. leaf .. "\nwas: " .. places[i].place
    end
  end
  while sim.history.at < #sim.history.marks do sim.env.forward() end
  local place = drive.place(sim.fsm)
  if places.at_end and place ~= places.at_end then
    return "forward: " .. place .. "\nwas: " .. places.at_end
  end
end

-- Goes to iterations in any order.
local function check_jumps(sim, random, places)
  for _ = 1, 6 do
    local stop = places[1] and random:pick(places)
    if not stop then return end
    sim.env.go_to(stop.count)
    local leaf = sim.fsm._act_leaf and sim.fsm._act_leaf._fqn or ""
    if not stop.place:find(leaf, 1, true) then
      return ("goto %d: %s\nwas: %s"):format(stop.count, leaf, stop.place)
    end
  end
end

-- Goes back, and on in another way: what was undone is gone, the new way is kept.
local function check_new_way(sim, random, places)
  local stop = places[1] and random:pick(places)
  if not stop then return end
  sim.env.go_to(stop.count)
  sim.env.ses(random:pick(drive.EVENTS))
  local place, count = drive.place(sim.fsm), sim.history.count
  if sim.history.last ~= count then return "what was undone can be reached" end
  for n = 0, count do sim.env.go_to(n) end
  if drive.place(sim.fsm) ~= place then
    return "the end: " .. drive.place(sim.fsm) .. "\nwas: " .. place
  end
end

local function check(seed)
  local random, places, chunk = new_random(seed), {}, history.CHUNK
  history.CHUNK = random(12)
  local sim = assert(drive.with_file(seed, function(name)
    return (session.open(name, false))
  end))
  prompt.install(sim)
  local problem = wander(sim, assert(rfsm.init(kept.model(seed))), random, places)
    or check_way_back(sim, places) or check_jumps(sim, random, places)
    or check_new_way(sim, random, places)
  history.CHUNK = chunk
  sim.history.recorder:stop()
  return problem
end

return { name = "sim", run = drive.each(check) }
