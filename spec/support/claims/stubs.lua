-- Exploration of charts away from their robot: random charts with regions and stubs, in
-- which states have the names of words. What random runs reach was reached.

local chart = require "rfsm.shared.chart"
local explore = require "rfsm.explore.explore"
local helper = require "spec.helper"
local location = require "rfsm.shared.location"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local run_seeds = require "spec.support.run_seeds"
local verdict = require "rfsm.explore.verdict"
require "rfsm.preview"

local claim = { name = "charts with stubs", runs = 20 }

-- Names of states, among them words of callbacks and extensions. Those that `init`
-- refuses, since they are fields of each state or root, are left out.
local NAMES = { "a", "b", "prepare", "likely", "guard", "effect", "order", "run",
  "step", "substates", "emem", "history", "defer", "final", "checks", "properties",
  "timed" }

local EVENTS = { "e_1", "e_2", "e_done" }

-- Values of callbacks: stubs, and functions that call stubs.
local CALLBACKS = { "robot.act", "part.act()",
  "function(...) return robot.act(...) end", "function() part.act { 1, 2 } end" }

local state_text

-- Returns transitions between the states of some names as a text. `paths` are further
-- targets.
local function transitions_text(random, names, paths)
  local texts = { ('rfsm.trans { src = "initial", tgt = %q }'):format(names[1]) }
  for i, name in ipairs(names) do
    for _ = 1, random:below(2) do
      local tgt = random:chance(60) and names[i % #names + 1]
        or random:chance(30) and paths[1] and random:pick(paths) or random:pick(names)
      local callback = random:chance(30) and random:pick { "guard = ", "effect = ",
        "likely = " } .. random:pick(CALLBACKS) or ""
      texts[#texts + 1] = ("rfsm.trans { src = %q, tgt = %q, events = { %q }, %s }")
        :format(name, tgt, random:pick(EVENTS), callback)
    end
  end
  return table.concat(texts, ",\n")
end

-- Returns the members of a composite as a text. Below some states that are stubs there
-- are targets of transitions.
local function members_text(random, depth)
  local names, texts, paths = {}, {}, {}
  for _ = 1, 2 + random:below(3) do
    local name = random:pick(NAMES)
    if not texts[name] then
      names[#names + 1] = name
      texts[name] = state_text(random, depth + 1)
      if texts[name]:find("^rfsm.load") then paths[#paths + 1] = name .. ".inside" end
    end
  end
  local lines = {}
  for i, name in ipairs(names) do lines[i] = name .. " = " .. texts[name] end
  lines[#lines + 1] = transitions_text(random, names, paths)
  return table.concat(lines, ",\n")
end

-- Forms of a region, and of a sequential AND state.
local REGIONS = { "rfsm.state { %s }", "rfsm.init(rfsm.state { info = false, %s })",
  "robot.wrap(rfsm.state { %s })", 'rfsm.load "no/such/region.lua" -- %s\n' }
local PARALLELS = { "rfsm.seqand { %s }", "robot.wrap(rfsm.seqand { %s })",
  "rfsm.seqand { step = 2, %s }" }

-- Returns a sequential AND state as a text.
local function regions_text(random, depth)
  local texts = {}
  for i = 1, random:below(2) do
    texts[i] = ("%s = %s"):format(random:pick { "left", "right", "prepare" },
      random:pick(REGIONS):format(members_text(random, depth + 1)
        :gsub("\n", " "):gsub("%%", "%%%%")))
  end
  return random:pick(PARALLELS):format(table.concat(texts, ", "))
end

-- Returns a state as a text: a leaf, a stub, a composite, or one with regions.
function state_text(random, depth)
  local kind = depth < 3 and random:below(8) or random:below(4)
  if kind == 8 then return regions_text(random, depth) end
  if kind > 5 then
    local form = kind == 7 and "robot.wrap(rfsm.state { %s })" or "rfsm.state { %s }"
    return form:format(members_text(random, depth))
  end
  if kind == 5 then return 'rfsm.load "no/such/part.lua"' end
  if kind == 4 then return "robot.wrap(rfsm.state {})" end
  local field = random:pick { "entry", "exit", "doo", "doc" }
  return ("rfsm.state { %s = %s }"):format(field, random:pick(CALLBACKS))
end

function claim.text(seed)
  return ('local part = require "no.such.module"\nreturn rfsm.state { info = false, '
    .. "warn = false, err = false,\n%s }"):format(members_text(new_random(seed), 1))
end

-- Returns the model of a text that is loaded as a file, with stubs.
local function load_text(text, file)
  helper.write(file, text)
  return chart.load(file, true)
end

-- Returns the set of the paths of states in which random runs have been.
local function seen_in_runs(model, seed)
  local random, seen = new_random(seed + 17), {}
  local fsm = rfsm.init(model)
  for _ = 1, fsm and claim.runs or 0 do
    for _ = 1, 8 do
      if random:chance(80) then rfsm.send_events(fsm, random:pick(EVENTS)) end
      rfsm.step(fsm)
      for _, entry in ipairs(rfsm.machines(fsm)) do
        local leaf = entry.machine._act_leaf
        local is_on = not entry.owner or entry.owner._act_leaf == entry.state
        if leaf and is_on then seen[location.path(leaf, entry.prefix)] = true end
      end
    end
    rfsm.reset(fsm)
  end
  return fsm and seen
end

-- Appends what runs of the chart of a seed reach and its exploration does not.
local function compare_in(file, seed, list)
  local model, problem = load_text(claim.text(seed), file)
  if not model then
    list[#list + 1] = seed .. ": " .. tostring(problem)
    return true
  end
  local seen = seen_in_runs(model, seed)
  local ok, walk = pcall(explore.walk, model, { configurations = 300 })
  if not seen then return false end -- the chart is not valid
  if not ok then
    list[#list + 1] = seed .. ": " .. tostring(walk)
    return true
  elseif walk.bound then
    return false
  end
  local active = verdict.active_in(walk.subject, walk.passed)
  for _, path in ipairs(rfsm.sorted_keys(seen)) do
    if not active[path] then
      list[#list + 1] = ("%d: %s was reached"):format(seed, path)
    end
  end
  return true
end

local function compare(seed, list)
  local file = os.tmpname()
  local ok, is_compared = pcall(compare_in, file, seed, list)
  os.remove(file)
  setmetatable(_G, nil)
  if not ok then error(is_compared, 0) end
  return is_compared
end

claim.run = run_seeds(compare)

return claim
