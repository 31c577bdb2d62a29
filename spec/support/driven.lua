-- Random charts that are driven at random, for claims about extensions. Which states
-- are active is known from their callbacks, not from the machine.

local bare = require "spec.support.bare"
local charts = require "spec.support.charts"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"

local driven = {}

--- A chart that is driven; functions that a claim may set are called if they are there.
---@class driven.Run
---@field fsm rfsm.Machine
---@field chart table see charts.lua
---@field random function
---@field active table<string, boolean> by FQN
---@field enter function(fqn) before the state counts as active
---@field leave function(fqn)
---@field iterate function(events) in each iteration, behind other pre step hooks
---@field problem string|nil what is wrong

--- Notes what is wrong; the first problem counts.
function driven.fail(run, text, ...) run.problem = run.problem or text:format(...) end

--- Returns the factory of doos that yield by chance.
function driven.yielding(random)
  return function()
    return function()
      while random(3) > 1 do rfsm.yield(random(2) == 1) end
    end
  end
end

local function callbacks(run)
  local random = run.random
  local function note(field, is_active)
    return function(fqn)
      return function()
        if run[field] then run[field](fqn) end
        run.active[fqn] = is_active
      end
    end
  end
  return {
    entry = note("enter", true), exit = note("leave", nil),
    guard = function() return function() return random(4) > 1 end end,
    effect = function()
      return function(fsm)
        if random:chance(10) then rfsm.send_events(fsm, "e" .. random(4)) end
      end
    end,
    doo = driven.yielding(random),
  }
end

--- Makes the machine of a seed. `change(chart, random)` may change its chart before.
---@return driven.Run
function driven.new(seed, change)
  local run = { chart = charts.generate(seed), random = new_random(seed + 5),
    active = {} }
  if change then change(run.chart, run.random) end
  run.fsm = assert(rfsm.init(bare.model_of(run.chart, callbacks(run))))
  rfsm.pre_step_hook_add(run.fsm, function(_, events)
    if run.iterate then run.iterate(events) end
  end)
  return run
end

local EVENTS = { "e1", "e2", "e3", "e4", 7, false, "e_unknown" }

--- Takes a random step, or resets the machine.
function driven.step(run)
  local random = run.random
  if random:chance(5) then
    rfsm.reset(run.fsm)
    run.active = {}
    if run.reset then run.reset() end
    return
  end
  for _ = 1, random(4) - 1 do rfsm.send_events(run.fsm, random:pick(EVENTS)) end
  rfsm.step(run.fsm, random(3))
end

--- Makes the function `run` of a claim: `case(seed)` returns what is wrong, or nil.
function driven.claim(case)
  return function(n, seed)
    for i = 1, n do
      local problem = case(seed * 100003 + i)
      if problem then return i, ("seed %d, case %d: %s"):format(seed, i, problem) end
    end
    return n
  end
end

return driven
