-- Brute force: random runs of random charts, and runs that follow the witnesses of an
-- exploration, on machines of their own.

local bare = require "spec.support.bare"
local charts = require "spec.support.charts"
local explore = require "rfsm.checks.explore"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"

local wander = {}

-- Events that a puppet knows and that may come from outside, and one that it does not.
local function events_of(own)
  local list = { "e_unknown" }
  for _, event in ipairs(own.all_events) do
    local is_own = type(event) == "string" and event:find("^e_done")
    if not is_own then list[#list + 1] = event end
  end
  return list
end

-- Where a machine stands, as a text.
local function text_of(leaf, mode)
  return leaf and leaf._fqn .. " " .. mode or "none"
end

-- Notes the active leaf and its mode; texts are made at the end, of what was seen.
local function note_stand(stands, leaf)
  local modes = stands[leaf] or {}
  stands[leaf], modes[leaf and leaf._mode or "none"] = modes, true
end

local function texts_of(stands)
  local texts = {}
  for leaf, modes in pairs(stands) do -- any order: a set
    for mode in pairs(modes) do texts[text_of(leaf, mode)] = true end -- likewise
  end
  return texts
end

local LENGTH = 5 -- steps of a run, on average

-- Runs a chart so many times, with at most one event between two steps; guards and doos
-- decide by chance. Returns where it stood and what it took, as sets.
local function run_at_random(chart, events, seed, runs)
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
  for _ = 1, runs do
    repeat
      if random(4) > 1 then rfsm.send_events(fsm, events[random(#events)]) end
      rfsm.step(fsm, random(3))
      note_stand(stands, fsm._act_leaf)
    until random(LENGTH) == 1
    rfsm.reset(fsm)
  end
  return texts_of(stands), taken
end

-- Follows a witness; returns where the machine stands then, and which transitions the
-- last step took.
local function follow(chart, witness)
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
  local leaf = fsm._act_leaf
  return text_of(leaf, leaf and leaf._mode), taken
end

-- Returns the first configuration with each leaf and mode by text, and the first step
-- that takes each transition by its number in the chart.
local function explored(walk)
  local stands, taken = {}, {}
  for number = 1, #walk.keys do
    local stand = walk:configuration(number)[1]
    local text = text_of(stand.leaf, stand.mode)
    stands[text] = stands[text] or number
  end
  for number, step in pairs(walk.taken) do -- any order: a set
    taken[walk.puppet.transitions[number].tr.number] = step
  end
  return stands, taken
end

local function yes() return true end

--- Returns in which way exploring the chart of `seed` and so many random runs differ.
function wander.disagreements(seed, runs)
  local chart, list = charts.generate(seed), {}
  local function expect(is_right, what, which)
    if not is_right then list[#list + 1] = ("%d: %s %s"):format(seed, which, what) end
  end
  local walk = explore.walk(bare.model_of(chart, {
    guard = function() return yes end, doo = function() return yes end }), {})
  local stands, taken = explored(walk)
  local seen, seen_taken = run_at_random(chart, events_of(walk.puppet), seed, runs)
  for text in pairs(seen) do expect(stands[text], "was reached", text) end
  for number in pairs(seen_taken) do expect(taken[number], "was taken", number) end
  for text, number in pairs(stands) do
    expect(follow(chart, walk:witness(number)) == text, "is not reached", text)
  end
  for number, step in pairs(taken) do
    local _, own = follow(chart, walk:witness(step.from, step.label))
    expect(own[number], "is not taken", number)
  end
  table.sort(list) -- the sets above have no order
  return list
end

return wander
