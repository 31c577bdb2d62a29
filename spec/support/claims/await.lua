-- An await comes in each iteration from that on in which the last of its events came
-- since its state was entered, and in no other.

local driven = require "spec.support.driven"
require "rfsm.await"

local NAMES = { "e1", "e2", "e3", "e4", "e_unknown" }

-- Gives some transitions an await, of one to three events.
local function add_awaits(chart, random)
  chart.awaits = {} -- FQN -> name in the machine -> list of events
  for _, tr in ipairs(chart.transitions) do
    local is_state = chart.nodes[tr.src].kind == "state"
    if is_state and tr.events_ref and random:chance(50) then
      local wanted = {}
      for i = 1, random(3) do wanted[i] = random:pick(NAMES) end
      tr.events_ref = { "await(" .. table.concat(wanted, ", ") .. ")", "e4" }
      chart.awaits[tr.src] = chart.awaits[tr.src] or {}
      chart.awaits[tr.src][tr.events_ref[1] .. "@" .. tr.src] = wanted
    end
  end
end

-- Splits the events of an iteration: a sorted list of awaits, a set of the others.
local function split(events)
  local awaits, others = {}, {}
  for _, event in ipairs(events) do
    if tostring(event):find("^await") then awaits[#awaits + 1] = event end
    others[event] = true
  end
  table.sort(awaits)
  return awaits, others
end

-- Returns the names of the awaits that are complete, now that `events` came, too.
local function complete(run, received, events)
  local names = {}
  for fqn, awaits in pairs(run.chart.awaits) do -- any order: sorted
    for name, wanted in pairs(run.active[fqn] and awaits or {}) do -- likewise
      local missing = 0
      for _, event in ipairs(wanted) do
        received[fqn][event] = received[fqn][event] or events[event]
        if not received[fqn][event] then missing = missing + 1 end
      end
      if missing == 0 and next(events) ~= nil then names[#names + 1] = name end
    end
  end
  table.sort(names)
  return names
end

return { name = "await and counting", run = driven.claim(function(seed)
  local run, received = driven.new(seed, add_awaits), {}
  function run.enter(fqn) received[fqn] = {} end
  function run.iterate(events)
    local came, others = split(events)
    local expected = table.concat(complete(run, received, others), " ")
    if table.concat(came, " ") ~= expected then
      driven.fail(run, "came: %s, expected: %s", table.concat(came, " "), expected)
    end
  end
  for _ = 1, 12 do
    driven.step(run)
    if run.problem then return run.problem end
  end
end) }
