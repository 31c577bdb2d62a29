-- Data in an exploration against random runs: random charts that count in fields of the
-- machine, of states, transitions, tables, objects and regions, in upvalues and
-- globals. Some callbacks are in `run`, some fields in `vars`. No random run reaches a
-- state that is never active as the exploration has it, and each witness leads there.

local helper = require "spec.helper"
local location = require "rfsm.shared.location"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local run_seeds = require "spec.support.run_seeds"
require "rfsm_seqand"

local load_text = rawget(_G, "loadstring") or load

local claim = { name = "data in an exploration", runs = 25, holds = 0, witnesses = 0 }

-- Charts, as texts ------------------------------------------------------------------

-- Where a chart counts: in a callback, and as `vars` has it.
local PLACES = {
  { text = "fsm.c1", path = "c1" }, { text = "fsm.d.c2", path = "d.c2" },
  { text = "fsm.s1.c3", path = "s1.c3" }, { text = "fsm.d.e.c4", path = "d.e.c4" },
  { text = "fsm.o.c5", path = "o.c5" }, { text = "fsm[1].c6", path = "trans[1].c6" },
  { text = "u1" }, { text = "verdicts_g1" }, { text = "table1.c7" },
}

local REGION_PLACES = { { text = "fsm.c8", path = "par.r.c8" },
  { text = "fsm.a.c9", path = "par.r.a.c9" }, PLACES[7] }

-- Returns a statement that writes to a place.
local function statement(random, place)
  local text, value = place.text, random:below(3)
  local base, field = text:match("^(.*)%.([%w_]+)$")
  local forms = { ("%s = (%s + 1) %% 3"):format(text, text),
    ("%s = %d"):format(text, value) }
  if base then
    forms[3] = ("rawset(%s, %q, %d)"):format(base, field, value)
    forms[4] = ("local key = %q %s[key] = %d"):format(field, base, value)
    forms[5] = ("set(%s, %q, %d)"):format(base, field, value)
  end
  return forms[random:chance(70) and 1 or 1 + random:below(#forms - 1)]
end

local function callback(random, places)
  return ("function(fsm) %s end"):format(statement(random, random:pick(places)))
end

local function guard(random, places)
  return ("function(tr) local fsm = tr.src._parent return %s %s %d end"):format(
    random:pick(places).text, random:chance(60) and "==" or "~=", random:below(3))
end

-- Returns the lines of a state, with random callbacks.
local function state_text(random, places, fields)
  local texts = { fields }
  for _, field in ipairs { "entry", "exit" } do
    if random:chance(25) then
      texts[#texts + 1] = field .. " = " .. callback(random, places)
    end
  end
  if random:chance(20) then
    local doo = callback(random, places)
    texts[#texts + 1] = "doo = " .. (random:chance(30)
      and doo:gsub(" end$", " rfsm.yield(true) end") or doo)
  end
  return ("rfsm.state { %s },"):format(table.concat(texts, ",\n"))
end

local function transitions_text(random, places, names, first)
  local lines = { ('rfsm.trans { src = "initial", tgt = "%s"%s },'):format(names[1],
    first) }
  for _ = 1, 2 + random:below(4) do
    local texts = { ("src = %q, tgt = %q, events = { %q }"):format(random:pick(names),
      random:chance(25) and "internal" or random:pick(names), "e" .. random:below(3)) }
    if random:chance(60) then texts[2] = "guard = " .. guard(random, places) end
    if random:chance(60) then
      texts[#texts + 1] = "effect = " .. callback(random, places)
    end
    lines[#lines + 1] = ("rfsm.trans { %s },"):format(table.concat(texts, ",\n"))
  end
  return table.concat(lines, "\n")
end

local REGION = [[
par = rfsm.seqand { idle_doo = "auto", r = rfsm.state {
info = false, warn = false, c8 = 0,
a = %s
b = %s
%s
} },]]

function claim.text(seed)
  local random = new_random(seed + 11)
  local names, places = { "s1", "s2", "s3" }, {}
  for i = 1, 3 do places[i] = random:pick(PLACES) end
  local lines = { 'local rfsm = require "rfsm"', "local u1, table1 = 0, { c7 = 0 }",
    "verdicts_g1 = 0", "local function set(t, k, v) t[k] = v end",
    "return rfsm.state { info = false, warn = false, c1 = 0,",
    "d = { c2 = 0, e = { c4 = 0 } }, o = setmetatable({ c5 = 0 }, {})," }
  for i, name in ipairs(names) do
    lines[#lines + 1] = name .. " = "
      .. state_text(random, places, i == 1 and "c3 = 0" or "n = 0")
  end
  if random:chance(35) then
    local own = { random:pick(REGION_PLACES), random:pick(REGION_PLACES) }
    lines[#lines + 1] = REGION:format(state_text(random, own, "c9 = 0"),
      state_text(random, own, "n = 0"), transitions_text(random, own, { "a", "b" }, ""))
    names[#names + 1] = "par"
  end
  lines[#lines + 1] = transitions_text(random, places, names, ", c6 = 0")
  lines[#lines + 1] = "} -- u1, table1, set"
  return table.concat(lines, "\n"), names[4] ~= nil
end

local function model_of(text) return assert(load_text(text, "=chart"))() end

-- The text is its own name, so that the callbacks can be read.
local function readable_model_of(text) return assert(load_text(text, text))() end

-- Calls f(name, owner, field) for each callback of a machine.
local function each_callback(fsm, f)
  for _, entry in ipairs(rfsm.machines(fsm)) do
    for _, obj in ipairs(rfsm.elements(entry.machine)) do
      for _, field in ipairs { "entry", "exit", "doo", "guard", "effect" } do
        local is_own = not (rfsm.is_state(obj) and rfsm.regions(obj)[1])
        if is_own and obj[field] then
          f(field .. " " .. location.path(obj, entry.prefix), obj, field)
        end
      end
    end
  end
end

-- Returns random options: `run` by names, `vars`.
local function options_of(random, fsm, text)
  local options, share = { run = {}, vars = {}, configurations = 400 },
    random:chance(50) and 100 or 70
  each_callback(fsm, function(name)
    if random:chance(share) then options.run[#options.run + 1] = name end
  end)
  if not options.run[1] then options.run = nil end
  for _, list in ipairs { PLACES, REGION_PLACES } do
    for _, place in ipairs(list) do
      local is_there = place.path and (list == PLACES or text:find("par = ", 1, true))
      if is_there and random:chance(80) then options.vars[place.path] = { 0, 2 } end
    end
  end
  return options
end

-- Runs and witnesses ----------------------------------------------------------------

local function active_paths(fsm)
  local active = {}
  for _, entry in ipairs(rfsm.machines(fsm)) do
    local leaf = entry.machine._act_leaf
    local is_on = not entry.owner or entry.owner._act_leaf == entry.state
    if leaf and is_on then active[location.path(leaf, entry.prefix)] = true end
  end
  return active
end

-- Returns the paths of the states that random runs have been in.
local function seen_in_runs(text, seed)
  local random, seen = new_random(seed + 17), {}
  for _ = 1, claim.runs do
    local fsm = rfsm.init(model_of(text))
    for _ = 1, 12 do
      if random:chance(80) then rfsm.send_events(fsm, "e" .. random:below(3)) end
      rfsm.step(fsm)
      for path in pairs(active_paths(fsm)) do seen[path] = true end -- any order: a set
    end
  end
  return seen
end

-- Follows a witness on a machine in which the callbacks that are not run do nothing,
-- and free guards and doos answer as it says.
local function follow(text, witness, options)
  local fsm, is_run, choices = rfsm.init(model_of(text)), {}, {}
  for _, name in ipairs(options.run or {}) do is_run[name] = true end
  local function answer(who)
    for i, choice in ipairs(choices) do
      if choice.who == who then return table.remove(choices, i).answer end
    end
    return false
  end
  each_callback(fsm, function(name, obj, field)
    if is_run[name] then return end
    local who = name:match("^%l+ (.*)$")
    obj[field] = field == "guard" and function() return answer(who) end
      or field == "doo" and function()
        while not answer(who) do rfsm.yield(true) end
      end or nil
  end)
  for _, step in ipairs(witness) do
    choices = {}
    for i, choice in ipairs(step.choices) do choices[i] = choice end
    for _, event in ipairs(step.values) do rfsm.send_events(fsm, event) end
    rfsm.step(fsm)
  end
  return active_paths(fsm)
end

-- Appends which verdicts about the chart of a seed are wrong.
local function compare(seed, list)
  local text = claim.text(seed)
  local random, model = new_random(seed + 5), readable_model_of(text)
  local options = options_of(random, rfsm.init(model), text)
  options.properties = {}
  local fsm = rfsm.init(model_of(text))
  for _, entry in ipairs(rfsm.machines(fsm)) do
    for _, leaf in ipairs(rfsm.elements(entry.machine, rfsm.is_leaf)) do
      local path = location.path(leaf, entry.prefix)
      options.properties[path] = rfsm_checks.never(path)
    end
  end
  local ok, result = pcall(rfsm_checks.explore, model, options)
  if not ok then
    list[#list + 1] = seed .. ": " .. tostring(result)
    return true
  end
  local seen = seen_in_runs(text, seed)
  for _, judged in ipairs(result.properties) do
    if judged.holds then
      claim.holds = claim.holds + 1
      if seen[judged.name] then
        list[#list + 1] = ("%d: %s was seen"):format(seed, judged.name)
      end
    elseif judged.holds == false then
      claim.witnesses = claim.witnesses + 1
      if not follow(text, judged.witness, options)[judged.name] then
        list[#list + 1] = ("%d: %s is not reached"):format(seed, judged.name)
      end
    end
  end
  return true
end

local run = run_seeds(compare)

function claim.run(n, seed)
  local compared, text
  helper.printed(function() compared, text = run(n, seed) end)
  rawset(_G, "verdicts_g1", nil)
  return compared, text
end

return claim
