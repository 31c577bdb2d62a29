-- Random runs of random charts, and runs that follow a witness, on their own machines.

local bare = require "spec.support.bare"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"

local wander = {}

-- Events that the chart names, and one that it does not.
local function events_of(chart)
  local list, is_listed = { "e_unknown" }, {}
  for _, tr in ipairs(chart.transitions) do
    for _, event in ipairs(tr.events) do
      local is_internal = type(event) == "string" and event:find("^e_done")
      if type(event) ~= "function" and not is_internal and not is_listed[event] then
        is_listed[event], list[#list + 1] = true, event
      end
    end
  end
  return list
end

-- Where the machine stands, as a text.
local function stand_of(fsm)
  local leaf = rfsm.get_actleaf_fqn(fsm)
  return leaf and leaf .. " " .. rfsm.get_sta_mode(fsm._act_leaf) or "none"
end

--- Runs a chart for so many steps, with at most one event between two of them; guards
-- and doos decide by chance. Returns where it stood and what it took, as sets.
function wander.at_random(chart, seed, steps)
  local random, stands, taken = new_random(seed), {}, {}
  local function note_taken(number)
    return function() taken[number] = true end
  end
  local fsm = rfsm.init(bare.model_of(chart, {
    guard = function() return function() return random(2) == 1 end end,
    effect = note_taken,
    doo = function()
      return function()
        while random(3) > 1 do rfsm.yield(random(2) == 1) end
      end
    end,
  }))
  local events = events_of(chart)
  for _ = 1, steps do
    if random(4) > 1 then rfsm.send_events(fsm, events[random(#events)]) end
    rfsm.step(fsm, random(3))
    stands[stand_of(fsm)] = true
  end
  return stands, taken
end

--- Follows a witness; returns where the machine stands then, and which transitions the
-- last step took.
function wander.follow(chart, witness)
  local answers, taken, at = {}, {}, 0
  local function answer()
    at = at + 1
    return answers[at].answer
  end
  local fsm = rfsm.init(bare.model_of(chart, {
    guard = function() return answer end,
    effect = function(number)
      return function() taken[number] = true end
    end,
    doo = function()
      return function()
        while not (answers[at + 1] and answer()) do rfsm.yield(true) end
      end
    end,
  }))
  for _, step in ipairs(witness) do
    answers, at = step.choices, 0
    for number in pairs(taken) do taken[number] = nil end
    for _, event in ipairs(step.values) do rfsm.send_events(fsm, event) end
    rfsm.step(fsm)
  end
  return stand_of(fsm), taken
end

return wander
