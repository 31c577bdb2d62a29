--- Verdict: the findings of an exploration, each with the shortest run that shows it.
--
-- @module rfsm.checks.verdict
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local codes = require "rfsm.checks.codes"
local explore = require "rfsm.checks.explore"
local graph = require "rfsm.checks.graph"
local place = require "rfsm.checks.place"
local properties = require "rfsm.checks.properties"
local static = require "rfsm.checks.static"

local ipairs, pairs, setmetatable, type = ipairs, pairs, setmetatable, type
local concat, sort = table.concat, table.sort

local verdict = {}

--- What an exploration has found; `tostring` of it is the report.
---@class rfsm_checks.Exploration
---@field configurations integer
---@field steps integer that were run
---@field transitions integer how many the chart has
---@field taken integer how many of them some step takes
---@field bound? "configurations"|"depth"|"seconds"|"choices" what was hit
---@field findings rfsm_checks.Finding[] with field `witness`
---@field properties { name: string, holds: boolean?, witness: table? }[]
local Exploration = {}
Exploration.__index = Exploration

-- Findings ........................................................................

-- The static check that sees the same: its silence counts here, too.
local STATIC = { unreached = "unreachable", untaken = "shadowed", stuck = "dead-end",
  livelock = "endless", swallowed = "no-default", clash = "conflict" }

-- Adds a finding, unless its element expects it.
local function add(result, code, obj, path, text, witness)
  if obj and (static.is_silenced(obj, code) or static.is_silenced(obj, STATIC[code]))
  then
    return
  end
  local file = obj and place.split(rfsm.location_of(obj)) or ""
  result.findings[#result.findings + 1] = {
    code = code, severity = codes.of[code].severity, file = file, place = path,
    text = text, hint = codes.of[code].hint, witness = witness,
  }
end

-- Returns the set of paths of states that are active in some configuration.
local function active_paths(walk)
  local own, set, numbers, is_seen = walk.puppet, {}, {}, {}
  for _, part in ipairs(own.parts) do is_seen[part] = {} end
  for number = 2, #walk.keys do
    own:numbers_of(walk.keys[number], numbers)
    for i, part in ipairs(own.parts) do
      local node = part.stands[numbers[i]].leaf
      while node and not is_seen[part][node] do
        is_seen[part][node], set[place.path(node, part.prefix)] = true, true
        node = node ~= part.fsm and node._parent
      end
    end
  end
  return set
end

-- States that are never active, but not those in another one.
local function find_unreached(walk, result)
  local active, list = active_paths(walk), {}
  for path, state in pairs(walk.puppet.names) do -- any order: sorted
    local parent = state._parent
    local is_root = parent == state or parent == nil
    local above = not is_root and path:sub(1, #path - #state._id - 1)
    if not active[path] and (not above or active[above]) then
      list[#list + 1] = path
    end
  end
  sort(list)
  for _, path in ipairs(list) do
    add(result, "unreached", walk.puppet.names[path], path,
      "active in no configuration")
  end
end

local function find_untaken(walk, result)
  for number, entry in ipairs(walk.puppet.transitions) do
    if walk.taken[number] then
      result.taken = result.taken + 1
    else
      local text = ("no step takes it (%s -> %s)"):format(entry.tr.src._fqn,
        entry.tr.tgt._fqn)
      add(result, "untaken", entry.tr, entry.path, text)
    end
  end
end

-- Returns the innermost active states of a configuration, and whether all are final.
local function leaves_of(walk, number)
  local own, leaves, are_final = walk.puppet, {}, true
  local numbers = own:numbers_of(walk.keys[number], {})
  for i, part in ipairs(own.parts) do
    local leaf = part.stands[numbers[i]].leaf
    if leaf then
      leaves[#leaves + 1] = { state = leaf, path = place.path(leaf, part.prefix) }
      local is_around = place.regions_of(leaf)[1] ~= nil
      are_final = are_final and (is_around or leaf.final == true)
    end
  end
  return leaves, are_final
end

local function paths_of(leaves)
  local paths = {}
  for i, leaf in ipairs(leaves) do paths[i] = leaf.path end
  return concat(paths, ", ")
end

-- Configurations in which nothing happens any more, one for each set of leaves.
local function find_stuck(walk, result)
  local is_told = {}
  for number = 1, walk.expanded do
    if not walk.moves[number] then
      local leaves, are_final = leaves_of(walk, number)
      local text, first = paths_of(leaves), leaves[1]
      if not first then
        add(result, "stuck", walk.puppet.parts[1].fsm, "root", "the machine cannot be "
          .. "entered", {})
      elseif not (are_final or is_told[text] or first.state._parent == first.state) then
        is_told[text] = true
        add(result, "stuck", first.state, text, "nothing happens any more in this "
          .. "configuration", walk:witness(number))
      end
    end
  end
end

-- Configurations from which events that wait lead on and on.
local function find_livelock(walk, result)
  local is_idle = {}
  for number = 1, #walk.keys do
    is_idle[number] = number > walk.expanded or not walk:is_driven(number)
  end
  local ends = graph.can_reach(walk, is_idle, true)
  for number = 2, walk.expanded do
    if not ends[number] then
      local leaves = leaves_of(walk, number)
      return add(result, "livelock", leaves[1] and leaves[1].state, paths_of(leaves),
        "run never becomes idle from this configuration", walk:witness(number))
    end
  end
  local step = walk.endless
  if not step then return end
  add(result, "livelock", nil, "root", "a machine in a sequential AND state never "
    .. "becomes idle", walk:witness(step.from, step.label))
end

local function find_clashes(walk, result)
  for _, fqn in ipairs(rfsm.sorted_keys(walk.clashes)) do
    local step = walk.clashes[fqn]
    add(result, "clash", nil, fqn, "several transitions of equal pn are enabled",
      walk:witness(step.from, step.label))
  end
end

local function find_swallowed(walk, result)
  for _, key in ipairs(rfsm.sorted_keys(walk.swallowed)) do
    local step = walk.swallowed[key]
    local text = ("no way on for %s, which is discarded in %s"):format(
      rfsm.text_of(step.event), step.leaf)
    add(result, "swallowed", nil, step.connector, text,
      walk:witness(step.from, step.label))
  end
end

local function find_violations(walk, result, list)
  for i, judged in ipairs(list) do
    local witness = judged.at and walk:witness(judged.at, judged.label)
    result.properties[i] = { name = judged.name, holds = judged.holds,
      witness = witness }
    if judged.holds == false then
      add(result, "violated", nil, judged.name, "does not hold", witness)
    end
  end
end

-- Text ............................................................................

local WORDS = {
  [true] = { [true] = " ends", [false] = " goes on" },
  [false] = { [true] = " true", [false] = " false" },
}

local function choices_text(step)
  local texts = {}
  for i, choice in ipairs(step.choices) do
    texts[i] = choice.who .. WORDS[choice.is_doo][choice.answer]
  end
  return texts[1] and " (" .. concat(texts, ", ") .. ")" or ""
end

--- Return the steps of a witness as lines.
---@param witness rfsm_checks.WitnessStep[]
---@return string[] lines
function verdict.lines_of(witness)
  local lines = {}
  for i, step in ipairs(witness) do
    local events = step.events[1] and concat(step.events, ", ") or "no event"
    local taken = step.taken[1] and concat(step.taken, ", ") or "no transition"
    lines[i] = ("%d. %s%s: %s -> %s"):format(i, events, choices_text(step), taken,
      step.leaf or "not entered")
  end
  return lines
end

local UNKNOWN = "stopped by the bound on %s: unreached states, transitions not taken "
  .. "and whether properties hold are not known"

local function add_finding_lines(lines, finding)
  local kind = finding.severity ~= "error" and finding.severity .. ": " or ""
  lines[#lines + 1] = finding.file .. kind
    .. static.line(finding):sub(#finding.file + 1)
  for _, line in ipairs(verdict.lines_of(finding.witness or {})) do
    lines[#lines + 1] = "  " .. line
  end
end

--- Return the report of an exploration as lines.
---@param result rfsm_checks.Exploration
---@param is_wanted? table<string, boolean> the severities to be reported
---@return string[] lines
function verdict.report(result, is_wanted)
  local lines = { ("%d configurations, %d of %d transitions taken, %d steps run")
    :format(result.configurations, result.taken, result.transitions, result.steps) }
  if result.bound then lines[2] = UNKNOWN:format(result.bound) end
  for _, judged in ipairs(result.properties) do
    local text = judged.holds and "holds" or judged.holds == nil and "not known"
    if text then lines[#lines + 1] = judged.name .. ": " .. text end
  end
  for _, finding in ipairs(result.findings) do
    if not is_wanted or is_wanted[finding.severity] then
      add_finding_lines(lines, finding)
    end
  end
  return lines
end

function Exploration:__tostring() return concat(verdict.report(self), "\n") end

-- Public functions ................................................................

-- Returns the properties of the options, and those in the root of the model.
local function properties_of(model, options)
  local given = {}
  for _, source in ipairs { model.properties or {}, options.properties or {} } do
    if type(source) == "table" and not rfsm.is_fsmobj(source) then
      for key, property in pairs(source) do -- any order: sorted later
        given[type(key) == "string" and key or property] = property
      end
    end
  end
  return given
end

--- Explore a model and judge what was found.
---@param model rfsm.State
---@param options rfsm_checks.Options
---@return rfsm_checks.Exploration
function verdict.of(model, options)
  local list
  local walk = explore.walk(model, options, function(new)
    list = properties.watch(new, properties_of(model, options))
  end)
  properties.judge(walk, list)
  local result = setmetatable({ configurations = #walk.keys, steps = walk.count,
    transitions = #walk.puppet.transitions, taken = 0, bound = walk.bound,
    findings = {}, properties = {} }, Exploration)
  find_violations(walk, result, list)
  find_stuck(walk, result)
  find_livelock(walk, result)
  if not walk.bound and walk.keys[2] then
    find_unreached(walk, result)
    find_untaken(walk, result)
  else
    for _ in pairs(walk.taken) do result.taken = result.taken + 1 end -- only counted
  end
  find_clashes(walk, result)
  find_swallowed(walk, result)
  return result
end

return verdict
