-- What why, enabled, coverage and the static checks say, and what the engine then does,
-- on random charts.

local bare = require "spec.support.bare"
local charts = require "spec.support.charts"
local new_random = require "spec.support.random"
local location = require "rfsm.shared.location"
local rfsm = require "rfsm"
local run_seeds = require "spec.support.run_seeds"
local rfsm_checks = require "rfsm_checks"

local claim = { name = "checks and what the engine does" }

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local EVENTS = { "e1", "e2", "e3", "e4", 7, false, "e_unknown" }

-- Guards that answer the same for the same events.
local function guard_of(seed)
  return function(number)
    return function(_, events)
      return (seed + number * 7 + #tostring(events[1])) % 3 > 0
    end
  end
end

-- A machine that notes the paths of what it enters, leaves and takes.
local function noting_machine(chart, seed)
  local seen, first = { entered = {}, left = {}, taken = {} }, {}
  local function noting(set)
    return function(name)
      return function() set[name] = (set[name] or 0) + 1 end
    end
  end
  local model = bare.model_of(chart, { guard = guard_of(seed),
    entry = noting(seen.entered), exit = noting(seen.left),
    effect = function(number)
      return function()
        seen.taken[number] = (seen.taken[number] or 0) + 1
        first[#first + 1] = number
      end
    end })
  return rfsm.init(model), seen, first, model
end

local function places_of(fsm)
  local number_of = {}
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    number_of[location.of(tr)] = tr.number
  end
  return number_of
end

local function has(list, event)
  for i = 1, #list do
    if rawequal(list[i], event) then return true end
  end
  return false
end

local function is_named(fsm, event)
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    if has(tr.events, event) then return true end
  end
  return false
end

-- Compares why and enabled with the next step. An event that only a predicate accepts
-- is none that `enabled` lists.
local function step_and_compare(fsm, random, number_of, first, expect)
  local event, queue = EVENTS[random(#EVENTS)], { unpack(fsm._intq) }
  queue[#queue + 1] = event
  local found, enabled = rfsm_checks.why(fsm, unpack(queue)), rfsm_checks.enabled(fsm)
  local is_comparable = queue[2] == nil and is_named(fsm, event)
  for i = #first, 1, -1 do first[i] = nil end
  rfsm.send_events(fsm, event)
  rfsm.step(fsm)
  expect(first[1] == (found.fires and number_of[found.fires] or nil), "why")
  expect(not is_comparable or has(enabled, event) == (first[1] ~= nil), "enabled")
end

-- Compares the record of coverage with what was seen.
local function compare_coverage(fsm, record, seen, expect)
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    expect((seen.entered[state._fqn] or 0) == record.states[state._fqn], "coverage")
  end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    expect((seen.taken[tr.number] or 0) == record.transitions[location.path(tr)],
      "coverage of transitions")
  end
end

-- What findings of a code deny of an element.
local DENIED = {
  unreachable = function(seen, path) return seen.entered[path] end,
  ["dead-end"] = function(seen, path) return seen.left[path] end,
  shadowed = function(seen, _, number) return seen.taken[number] end,
}

local function compare_findings(model, number_of, seen, expect)
  for _, finding in ipairs(rfsm_checks.findings(model)) do
    local is_denied = DENIED[finding.code]
    if is_denied then
      expect(not is_denied(seen, finding.place, number_of[finding.place]),
        finding.code .. " " .. finding.place)
    end
  end
end

local STEPS = 40

local function compare(seed, list)
  local function expect(is_right, what)
    if not is_right then list[#list + 1] = ("%d: %s"):format(seed, what) end
  end
  local chart, random = charts.generate(seed), new_random(seed)
  local fsm, seen, first, model = noting_machine(chart, seed)
  local record, number_of = rfsm_checks.coverage(fsm), places_of(fsm)
  rfsm.step(fsm)
  for _ = 1, fsm._act_leaf and STEPS or 0 do
    step_and_compare(fsm, random, number_of, first, expect)
  end
  compare_coverage(fsm, record, seen, expect)
  compare_findings(model, number_of, seen, expect)
  return true
end

claim.run = run_seeds(compare)

return claim
