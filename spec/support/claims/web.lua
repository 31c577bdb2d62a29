-- The page: its commands leave the machine where the same calls in Lua leave it; back
-- lands where the machine stood after that turn.

local drive = require "spec.support.drive"
local kept = require "spec.support.kept"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"

local Driven = drive.require "rfsm.web.driven"

local function run(fsm)
  for _ = 1, Driven.MAX_STEPS do
    if rfsm.step(fsm) then return end
  end
end

local COMMANDS = {
  function(session, fsm, random)
    local event = random:pick(drive.EVENTS)
    session.commands.send(session, { event = event })
    rfsm.send_events(fsm, event)
  end,
  function(session, fsm, random)
    local event = random:pick(drive.EVENTS)
    session.commands.send(session, { event = event, run = true })
    rfsm.send_events(fsm, event)
    run(fsm)
  end,
  function(session, fsm)
    session.commands.step(session, {})
    rfsm.step(fsm)
  end,
  function(session, fsm)
    session.commands.reset(session, {})
    rfsm.reset(fsm)
    run(fsm)
  end,
}

local function wander(session, fsm, random, places)
  for _ = 1, 15 do
    COMMANDS[random(4)](session, fsm, random)
    local problem = drive.difference(session.view.fsm, fsm)
    if problem then return problem end
    places[session.way.at] = drive.place(fsm)
  end
end

local function check_back(session, random, places)
  while session.way.at > 0 do
    local to = session.way.at - random(math.min(session.way.at, 3))
    local problem = session.commands.back(session, { to = to })
    if problem then return problem end
    local place = drive.place(session.view.fsm)
    if places[to] and place ~= places[to] then
      return ("back to %d: %s\nwas: %s"):format(to, place, places[to])
    end
  end
end

local function check(seed)
  local random, places, steps = new_random(seed), {}, Driven.MAX_STEPS
  Driven.MAX_STEPS = 30
  local session = drive.with_file(seed, function(name)
    return Driven.open(name, function() return 0 end)
  end)
  local model = kept.model(seed)
  model.err = false
  local fsm = assert(rfsm.init(model))
  fsm.gettime = session.gettime
  run(fsm)
  local problem = wander(session, fsm, random, places)
    or check_back(session, random, places)
  Driven.MAX_STEPS = steps
  return problem
end

return { name = "web", run = drive.each(check) }
