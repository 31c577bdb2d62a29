-- Properties of after that are said to hold, and random runs, on random charts with
-- awaits, and with timers that do not fire in these runs.

local bare = require "spec.support.bare"
local explore = require "spec.support.claims.explore"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local run_seeds = require "spec.support.run_seeds"
local rfsm_checks = require "rfsm_checks"

local claim = { name = "what holds after an event, and random runs", runs = 100 }

local EVENTS = { "e1", "e2", "e3", "e4" }

-- Returns properties by name, "e1 root.a" and "e1 not root.a", for half of the pairs.
local function properties_of(chart)
  local properties = {}
  for i, event in ipairs(EVENTS) do
    for j, fqn in ipairs(chart.names) do
      if (i + j) % 2 == 0 and chart.nodes[fqn].kind == "state" and fqn ~= "root" then
        local after = rfsm_checks.after(event)
        properties[event .. " " .. fqn] = after.reach(fqn)
        properties[event .. " not " .. fqn] = after.reach(function(active)
          return not active(fqn)
        end)
      end
    end
  end
  return properties
end

-- Lists the names of those that hold; none if something was not tried.
local function held_by(chart)
  local function make() return function() return true end end
  local model = bare.model_of(chart, { guard = make, predicate = make, doo = make })
  local result = rfsm_checks.explore(model, { properties = properties_of(chart),
    configurations = 300 })
  local held = {}
  for _, judged in ipairs(result.properties) do
    if judged.holds then held[#held + 1] = judged.name end
  end
  return held
end

local function random_machine(chart, random)
  local function choice() return random(2) == 1 end
  local function make() return choice end
  local fsm = rfsm.init(bare.model_of(chart, { guard = make, predicate = make,
    doo = function()
      return function()
        while random(3) > 1 do rfsm.yield(true) end
      end
    end }))
  fsm.gettime = function() return 0, 0 end
  return fsm
end

-- Notes "root.a" of each active state, "not root.a" of each other one.
local function note_active(chart, fsm, visited)
  local is_active = {}
  for _, fqn in ipairs(rfsm.get_active_conf(fsm)) do is_active[fqn] = true end
  for _, fqn in ipairs(chart.names) do
    visited[is_active[fqn] and fqn or "not " .. fqn] = true
  end
end

-- Sends an event, now and then with another one, and lets the machine go on by itself.
-- Returns the set of what was visited; nil if that has no end.
local function run_on(chart, fsm, random, event)
  local other, visited = EVENTS[random(6)], {}
  rfsm.send_events(fsm, event, other)
  for _ = 1, 300 do
    rfsm.step(fsm)
    note_active(chart, fsm, visited)
    if fsm._intq[1] == nil and fsm._act_leaf._mode == "done" then return visited end
  end
end

-- Enters the machine and lets it take a few steps with one event at most.
local function wander(fsm, random)
  rfsm.reset(fsm)
  rfsm.step(fsm)
  for _ = 1, fsm._act_leaf and random(5) or 0 do
    if random(3) > 1 then rfsm.send_events(fsm, EVENTS[random(4)]) end
    rfsm.step(fsm)
  end
  return fsm._act_leaf
end

local function compare(seed, list)
  local chart, random = explore.chart(seed, 2), new_random(seed)
  local held, fsm = held_by(chart), random_machine(chart, random)
  for _ = 1, claim.runs do
    local event = EVENTS[random(4)]
    local visited = wander(fsm, random) and run_on(chart, fsm, random, event)
    for _, name in ipairs(visited and held or {}) do
      local wanted, goal = name:match("^(e%d) (.*)$")
      if wanted == event and not visited[goal] then
        list[#list + 1] = ("%d: after %s"):format(seed, name)
      end
    end
  end
  return true
end

claim.run = run_seeds(compare)

return claim
