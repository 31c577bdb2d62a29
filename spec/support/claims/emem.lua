-- The counts of rfsm.emem are those of the events that a hook saw, also if an interrupt
-- comes while it counts.

local driven = require "spec.support.driven"
local interrupts = require "spec.support.interrupts"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
require "rfsm.emem"

local fail = driven.fail

-- Notes what the memories of a run should hold: FQN -> event -> count.
local function watch(run)
  local counts = {}
  local function clear(fqn)
    for event in pairs(counts[fqn] or {}) do counts[fqn][event] = 0 end -- any order
  end
  run.leave = clear
  function run.reset()
    for fqn in pairs(counts) do clear(fqn) end -- any order: all of them
  end
  function run.iterate(events)
    for fqn in pairs(run.active) do -- any order: each stands alone
      counts[fqn] = counts[fqn] or {}
      for _, event in ipairs(events) do
        counts[fqn][event] = (counts[fqn][event] or 0) + 1
      end
    end
  end
  return counts
end

local function compare(run, counts)
  for _, state in ipairs(rfsm.elements(run.fsm, rfsm.is_state)) do
    local wanted = counts[state._fqn] or {}
    for _, t in ipairs { wanted, state.emem } do
      for event in pairs(t) do -- any order: one is enough
        if wanted[event] ~= state.emem[event] then
          fail(run, "%s.emem[%s] is %s, not %s", state._fqn, tostring(event),
            tostring(state.emem[event]), tostring(wanted[event]))
        end
      end
    end
  end
end

-- Has an instruction of rfsm.emem raise an error while an iteration is under way.
local function arm(run)
  local skip = run.cuts(200)
  debug.sethook(function()
    local is_counting = debug.getinfo(2, "S").short_src:find("rfsm/emem%.lua$")
    if not is_counting or run.fsm._phase == "idle" then return end
    skip = skip - 1
    if skip > 0 then return end
    debug.sethook()
    error("interrupted!", 0)
  end, "", 1)
end

-- Steps a machine; one that is cut short is stepped again.
local function step(run)
  if run.cuts:chance(50) then arm(run) end
  local ok, failure = pcall(driven.step, run)
  debug.sethook()
  if ok then return end
  if failure ~= "interrupted!" then error(failure, 0) end
  rfsm.step(run.fsm)
end

local run_all = driven.claim(function(seed)
  local run = driven.new(seed)
  local counts = watch(run)
  run.cuts = new_random(seed + 7)
  for _ = 1, 12 do
    step(run)
    compare(run, counts)
    if run.problem then return run.problem end
  end
end)

return { name = "emem and counting", run = function(n, seed)
  return interrupts.without_jit(run_all, n, seed)
end }
