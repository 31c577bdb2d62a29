--- Verdict: the findings of an exploration, each with the shortest run that shows it.
--
-- @module rfsm.checks.verdict
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local codes = require "rfsm.checks.codes"
local explore = require "rfsm.checks.explore"
local graph = require "rfsm.checks.graph"
local order = require "rfsm.checks.order"
local place = require "rfsm.checks.place"
local properties = require "rfsm.checks.properties"
local puppet = require "rfsm.checks.puppet"
local static = require "rfsm.checks.static"

local ipairs, pairs, setmetatable = ipairs, pairs, setmetatable
local table, tostring, type = table, tostring, type
local concat = table.concat

local verdict = {}

--- What an exploration has found; `tostring` of it is the report.
---@class rfsm_checks.Exploration
---@field configurations integer
---@field steps integer that were run
---@field transitions integer how many the chart has
---@field taken integer how many of them some step takes
---@field bound? "configurations"|"depth"|"seconds"|"choices"|"sets"|"targets"
---@field untried string[] what was not tried, as texts; empty without a bound
---@field premises string "one event a step; guards and timers free"
---@field findings rfsm_checks.Finding[] with field `witness`
---@field properties rfsm_checks.Verdict[]
local Exploration = {}
Exploration.__index = Exploration

--- What is known of a property.
---@class rfsm_checks.Verdict
---@field name string
---@field holds boolean|nil nil: not known
---@field vacuous? string it holds because of this reason alone
---@field witness? rfsm_checks.WitnessStep[] the run that shows that it does not hold

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
  local finding = codes.finding(code, file, path, text)
  finding.witness = witness
  result.findings[#result.findings + 1] = finding
end

-- Returns the set of paths of states that are active in some configuration, or entered
-- by some step.
local function active_paths(walk)
  local set = {}
  for _, passed in ipairs(walk.passed) do
    for path in pairs(passed.moment.active) do set[path] = true end -- any order: a set
  end
  for _, part in ipairs(walk.puppet.parts) do
    for _, leaf in ipairs(puppet.leaves(part.stands)) do
      for _, path in ipairs(leaf.paths) do set[path] = true end
    end
  end
  return set
end

-- States that are never active, but not those in another one.
local function find_unreached(walk, result)
  local active = active_paths(walk)
  for _, path in ipairs(rfsm.sorted_keys(walk.puppet.names)) do
    local state = walk.puppet.names[path]
    local above = not rfsm.is_root(state) and path:sub(1, #path - #state._id - 1)
    if not active[path] and (not above or active[above]) then
      add(result, "unreached", state, path, "active in no configuration")
    end
  end
end

local function find_untaken(walk, result)
  for number, entry in ipairs(walk.puppet.transitions) do
    if not walk.taken[number] then
      add(result, "untaken", entry.tr, entry.path, ("no step takes it (%s -> %s)")
        :format(entry.tr.src._fqn, entry.tr.tgt._fqn))
    end
  end
end

-- Returns the leaves of a configuration and their paths as a text; the third result is
-- whether all of them are final.
local function leaves_of(walk, number)
  local leaves, paths, are_final = puppet.leaves(walk:configuration(number)), {}, true
  for i, leaf in ipairs(leaves) do
    paths[i] = leaf.path
    are_final = are_final
      and (leaf.state.final == true or rfsm.regions(leaf.state)[1] ~= nil)
  end
  return leaves, concat(paths, ", "), are_final
end

-- Configurations in which nothing happens any more, one for each set of leaves.
local function find_stuck(walk, result)
  local is_told = {}
  for number = 1, walk.expanded do
    if not walk.moves[number] then
      local leaves, text, are_final = leaves_of(walk, number)
      local state = leaves[1] and leaves[1].state
      if not state then
        add(result, "stuck", walk.puppet.parts[1].fsm, "root", "the machine cannot be "
          .. "entered", {})
      elseif not (are_final or is_told[text] or rfsm.is_root(state)) then
        is_told[text] = true
        add(result, "stuck", state, text, "nothing happens any more in this "
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
      local leaves, text = leaves_of(walk, number)
      return add(result, "livelock", leaves[1] and leaves[1].state, text,
        "run never becomes idle from this configuration", walk:witness(number))
    end
  end
  local step = walk.endless
  if not step then return end
  add(result, "livelock", nil, "root", "a machine in a sequential AND state never "
    .. "becomes idle", walk:witness(step.from, step.label))
end

local function find_clashes(walk, result)
  local transitions = walk.puppet.transitions
  for _, number in ipairs(rfsm.sorted_keys(walk.clashes)) do
    local step, entry = walk.clashes[number], transitions[number]
    add(result, "clash", entry.tr, entry.path,
      order.conflict_text(transitions[step.by].tr), walk:witness(step.from, step.label))
  end
end

local function find_swallowed(walk, result)
  for _, key in ipairs(rfsm.sorted_keys(walk.swallowed)) do
    local step = walk.swallowed[key]
    local text = ("no way on for %s, which is discarded in %s"):format(
      rfsm.text_of(step.event), step.leaf._fqn)
    add(result, "swallowed", step.connector, step.connector._fqn, text,
      walk:witness(step.from, step.label))
  end
end

local function find_violations(walk, result, list)
  for i, judged in ipairs(list) do
    local witness = judged.at and walk:witness(judged.at, judged.label)
    result.properties[i] = { name = judged.name, holds = judged.holds,
      vacuous = judged.holds and judged.vacuous or nil, witness = witness }
    if judged.holds == false then
      add(result, "violated", nil, judged.name, "does not hold", witness)
    end
  end
end

-- Text ............................................................................

local function choices_text(step)
  local texts = {}
  for i, choice in ipairs(step.choices) do
    local word = tostring(choice.answer)
    if choice.is_doo then word = choice.answer and "ends" or "goes on" end
    texts[i] = choice.who .. " " .. word
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
    lines[i] = ("%d. %s%s: %s"):format(i, events, choices_text(step),
      puppet.outcome(step.taken, step.leaf))
  end
  return lines
end

local NUMBERS = { "one event", "two events", "three events" }

-- Returns what is not known of a chart, and is tried in each way: "guards and doos".
local function free_text(free)
  local names = rfsm.sorted_keys(free)
  local last = table.remove(names)
  return names[1] and concat(names, ", ") .. " and " .. last or last
end

-- Returns the premises of a walk: "one event a step; guards and timers free".
local function premises_of(walk, options)
  local free = free_text(walk.puppet.free)
  local texts = { (NUMBERS[walk.together] or walk.together .. " events") .. " a step" }
  if options.alphabet then texts[#texts + 1] = "no event outside of the alphabet" end
  if free then texts[#texts + 1] = free .. " free" end
  return concat(texts, "; ")
end

local UNKNOWN = "not tried: %s; unreached states, transitions not taken and whether "
  .. "properties hold are not known"

local function property_text(judged, premises)
  if judged.holds == nil then return judged.name .. ": not known" end
  local how = judged.vacuous and " vacuously, " .. judged.vacuous or ""
  return ("%s: holds%s (%s)"):format(judged.name, how, premises)
end

local function add_finding_lines(lines, finding, name)
  local kind = finding.severity ~= "error" and finding.severity .. ": " or ""
  local file = finding.file ~= "" and finding.file or name
  lines[#lines + 1] = file .. kind .. static.line(finding):sub(#finding.file + 1)
  for _, line in ipairs(verdict.lines_of(finding.witness or {})) do
    lines[#lines + 1] = "  " .. line
  end
end

--- Return the report of an exploration as lines.
---@param result rfsm_checks.Exploration
---@param name string in front of the first line, and where no file is known
---@param is_wanted? table<string, boolean> the severities to be reported
---@return string[] lines
function verdict.report(result, name, is_wanted)
  local lines = { ("%s%d configurations, %d of %d transitions taken, %d steps run")
    :format(name, result.configurations, result.taken, result.transitions,
      result.steps) }
  if result.bound then lines[2] = UNKNOWN:format(concat(result.untried, "; ")) end
  for _, judged in ipairs(result.properties) do
    if judged.holds ~= false then
      lines[#lines + 1] = property_text(judged, result.premises)
    end
  end
  for _, finding in ipairs(result.findings) do
    if not is_wanted or is_wanted[finding.severity] then
      add_finding_lines(lines, finding, finding.code == "violated" and "" or name)
    end
  end
  return lines
end

function Exploration:__tostring() return concat(verdict.report(self, ""), "\n") end

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
    transitions = #walk.puppet.transitions, taken = #rfsm.sorted_keys(walk.taken),
    bound = walk.bound, untried = walk.untried, findings = {}, properties = {},
    premises = premises_of(walk, options) }, Exploration)
  find_violations(walk, result, list)
  find_stuck(walk, result)
  find_livelock(walk, result)
  if not walk.bound and walk.keys[2] then
    find_unreached(walk, result)
    find_untaken(walk, result)
  end
  find_clashes(walk, result)
  find_swallowed(walk, result)
  return result
end

return verdict
