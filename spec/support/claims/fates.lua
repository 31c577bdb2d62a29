-- What fate hooks are told of random runs with deferral, beside what follows from the
-- definition: the events of each iteration, its path, and what waits before and after.

local bare = require "spec.support.bare"
local charts = require "spec.support.charts"
local match = require "rfsm.shared.match"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local run_seeds = require "spec.support.run_seeds"
require "rfsm.defer"

local claim = { name = "fates of events, and their definition" }

local EVENTS = { "e1", "e2", "e3", "e4", "e_unknown" }

local function count_of(list, event)
  local count = 0
  for i = 1, #list do
    if rawequal(list[i], event) then count = count + 1 end
  end
  return count
end

-- Is an event taken by a path, as the contract says?
local function is_taken(path, event)
  local names_some = false
  for _, tr in ipairs(path) do
    if not match.is_any(tr) then
      names_some = true
      if match.takes(tr.events, event) then return true end
    end
  end
  return not names_some
end

-- Has a machine append the fate of each event to `told`, and what the fate should be to
-- `expected`.
local function follow(fsm, told, expected)
  local path, before = nil, {}
  rfsm.fate_hook_add(fsm, function(_, event, fate)
    told[#told + 1] = tostring(event) .. " " .. fate
  end)
  rfsm.pre_step_hook_add(fsm, function() path, before = nil, rfsm.waiting(fsm) end)
  rfsm.path_hook_add(fsm, function(_, taken) path = taken end)
  rfsm.post_step_hook_add(fsm, function(_, events)
    local after, seen = rfsm.waiting(fsm), {}
    for _, event in ipairs(events) do
      if not seen[event] and not match.maker_of(event) then
        seen[event] = true
        local is_kept = count_of(after, event) > count_of(before, event)
        expected[#expected + 1] = tostring(event) .. " "
          .. (path and is_taken(path, event) and "taken" or is_kept and "kept"
          or "discarded")
      end
    end
  end)
end

local function model_of(seed)
  local chart, random = charts.generate(seed), new_random(seed)
  charts.add_deferrals(chart)
  local function choice() return random(3) > 1 end
  local model = bare.model_of(chart, { guard = function() return choice end,
    effect = function(number)
      return function(fsm)
        if number % 3 == 0 then rfsm.send_events(fsm, EVENTS[number % 4 + 1]) end
      end
    end })
  if seed % 2 == 0 then model.read = "one" end
  return model, random
end

local function compare(seed, list)
  local model, random = model_of(seed)
  local fsm = rfsm.init(model)
  if not fsm then return false end
  local told, expected = {}, {}
  follow(fsm, told, expected)
  for _ = 1, 30 do
    for _ = 1, random(3) do rfsm.send_events(fsm, EVENTS[random(#EVENTS)]) end
    rfsm.step(fsm, random(3))
  end
  for i = 1, math.max(#told, #expected) do
    if told[i] ~= expected[i] then
      list[#list + 1] = ("%d: fate %d: told %s, expected %s"):format(seed, i,
        tostring(told[i]), tostring(expected[i]))
      break
    end
  end
  return true
end

claim.run = run_seeds(compare)

return claim
