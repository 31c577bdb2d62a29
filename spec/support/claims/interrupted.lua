-- Recordings of random runs with interrupts anywhere, also inside of the recorder and
-- of callbacks, and resets behind some of them: replayed dry, they end where the run
-- ended. Odd seeds have all that a chart may have; there only an interrupt is raised,
-- since any other error in a predicate is its answer, which no recorder can know.

local interrupts = require "spec.support.interrupts"
local kept = require "spec.support.kept"
local new_random = require "spec.support.random"
local record = require "rfsm.record"
local rfsm = require "rfsm"
local run_seeds = require "spec.support.run_seeds"

-- Returns the places of a machine and its regions as a text.
local function place_of(fsm)
  local texts = {}
  for _, at in ipairs(rfsm.machines(fsm)) do
    local leaf = at.machine._act_leaf
    texts[#texts + 1] = at.prefix .. ": " .. table.concat(
      rfsm.get_active_conf(at.machine), " ") .. (leaf and " " .. leaf._mode or "")
  end
  return table.concat(texts, ", ")
end

-- Returns a function that calls another one, and raises an error in it by chance. What
-- was raised in a printer may reach the caller of a later step.
local function interrupting(random, count, values)
  return function(f, ...)
    local at = random:chance(50) and random(4000) or 1e9
    local _, is_raised, ok, failure = interrupts.raise_anywhere(at,
      random:pick(values), f, ...)
    if is_raised then count.raised = count.raised + 1 end
    if not ok and not interrupts.is_known(failure) then error(failure, 0) end
    if is_raised and random:chance(40) then rfsm.reset((...)) end
  end
end

local function check(seed, problems)
  local random, sink, count = new_random(seed), {}, { raised = 0 }
  local has = seed % 2 == 1 and "all" or nil
  local values = has and { "interrupted!" } or interrupts.VALUES
  local fsm = kept.run(seed, function(machine)
    record.record(machine, sink)
  end, interrupting(random, count, values), has)
  for _ = 1, 3 do pcall(rfsm.step, fsm) end -- nothing is cut short, and recorded
  local again, problem = record.replay(kept.model(seed, has), sink, { dry = true })
  if not again then
    problems[#problems + 1] = ("%d: %s"):format(seed, problem)
  elseif place_of(again) ~= place_of(fsm) then
    problems[#problems + 1] = ("%d: %s\n%s"):format(seed, place_of(fsm),
      place_of(again))
  end
  return count.raised > 0
end

local run = run_seeds(check)

return { name = "interrupted recordings", run = function(n, seed)
  return interrupts.without_jit(run, n, seed)
end }
