--- Verdict: the findings of an exploration, each with the shortest run that shows it.
--
-- @module rfsm.explore.verdict
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local codes = require "rfsm.checks.codes"
local data = require "rfsm.explore.data"
local explore = require "rfsm.explore.explore"
local graph = require "rfsm.explore.graph"
local independence = require "rfsm.explore.independence"
local match = require "rfsm.shared.match"
local monitors = require "rfsm.explore.monitors"
local location = require "rfsm.shared.location"
local opts = require "rfsm.shared.options"
local properties = require "rfsm.explore.properties"
local subject = require "rfsm.explore.subject"
local reactions = require "rfsm.explore.reactions"
local static = require "rfsm.checks.static"
local structure = require "rfsm.checks.structure"
local order = require "rfsm.shared.order"

local ipairs, math, setmetatable = ipairs, math, setmetatable
local tostring, type = tostring, type
local concat, huge, min, remove = table.concat, math.huge, math.min, table.remove
local any = order.any

local verdict = {}

--- The result of an exploration. `tostring(result)` is the report.
---@class rfsm_checks.Exploration
---@field configurations integer number of configurations that were found
---@field steps integer number of steps that were run
---@field transitions integer number of transitions of the chart
---@field taken integer number of transitions that at least one step takes
---@field bound? "configurations"|"depth"|"seconds"|"choices"|"sets"|"targets"|"values"
-- |"pending"|"deferred"|"texts"|"sends" a limit that the exploration reached
---@field reach? string how far it came, if an option has stopped it
---@field untried string[] texts about parts that were not tried; empty without a bound
---@field premises string the assumptions: "one event a step; guards and timers free"
---@field findings rfsm_checks.Finding[] a finding about a run has a field `witness`
---@field properties rfsm_checks.Verdict[] the verdict on each property
local Exploration = {}
Exploration.__index = Exploration

--- The verdict on a property. `tostring(verdict)` has at most three lines: the verdict,
--- the run that violates the property, and the premises.
---@class rfsm_checks.Verdict
---@field name string
---@field holds boolean|nil nil if the exploration cannot decide it
---@field vacuous? string the reason, if the property holds only trivially
---@field unnamed? string a text that no transition names the event
---@field witness? rfsm_checks.WitnessStep[] the run that shows that it does not hold
---@field premises string the assumptions of the exploration
---@field reason string why `holds` is nil although everything was tried; else empty
local Verdict = {}
Verdict.__index = Verdict

-- Findings ........................................................................

--- Return the set of the paths of the states that are active in some configuration, and
--- of the states that some step enters and leaves again.
---@param own rfsm_checks.Subject
---@param passed rfsm_checks.Passed[] the states that a step enters and leaves again
---@return table<string, true> active
function verdict.active_in(own, passed)
  local active = {}
  for _, each in ipairs(passed) do
    for path in order.each(each.moment.active) do active[path] = true end -- any order
  end
  for _, part in ipairs(own.parts) do
    for _, leaf in ipairs(subject.leaves(part.positions)) do
      for _, path in ipairs(leaf.paths) do active[path] = true end
    end
  end
  return active
end

-- Returns a table of three sets: the paths of the states that were `active` in a walk,
-- and the nodes that the taken transitions have `entered` and `left`.
local function met_by(walk)
  local met = { active = verdict.active_in(walk.subject, walk.passed), entered = {},
    left = {} }
  for number in order.each(walk.taken) do -- any order: a set
    local tr = walk.subject.transitions[number].tr
    met.entered[tr.tgt], met.left[tr.src] = true, true
  end
  return met
end

-- Returns a text with the reason why a transition is never taken, if all of its events
-- are timers that never expire; otherwise the empty text.
local function timer_text(walk, entry)
  local names = {}
  for i, event in ipairs(entry.tr.events or {}) do
    local is_dead = entry.part.timed[event]
      and not walk.timing.fired[walk.subject:occurrence(entry.part, event)]
    if not is_dead then return "" end
    names[i] = event
  end
  return names[1] and " (" .. concat(names, " and ") .. " never comes)" or ""
end

-- Returns the node that a transition enters: its target, or the parent of the target if
-- the target is an `initial` connector.
local function entered_by(tr)
  local tgt = tr.tgt
  return rfsm.is_conn(tgt) and tgt._id == "initial" and tgt._parent or tgt
end

-- Calls `timer_text` for each transition into a state, and returns the first text that
-- is not empty.
local function timers_text(walk, state)
  for _, entry in ipairs(walk.subject.transitions) do
    local text = entered_by(entry.tr) == state and timer_text(walk, entry) or ""
    if text ~= "" then return text end
  end
  return ""
end

-- Finds states that are never active. The states inside of such a state are left out.
local function find_unreachable(walk, findings, met)
  for _, path in ipairs(walk.subject.paths) do
    local state = walk.subject.names[path]
    local above = not rfsm.is_root(state) and path:sub(1, #path - #state._id - 1)
    if not met.active[path] and (not above or met.active[above]) then
      findings:add("unreachable", state, path,
        "active in no configuration" .. timers_text(walk, state))
    end
  end
end

-- Finds connectors that no step passes, although a state that is active in some
-- configuration has a transition to them. Returns the set of these connectors.
local function find_closed(walk, findings, met)
  local is_closed = {}
  for _, entry in ipairs(walk.subject.transitions) do
    local connector, prefix = entry.tr.tgt, entry.prefix
    local is_met = rfsm.is_conn(connector) and not met.left[connector]
      and met.active[location.path(entry.tr.src, prefix)]
    if is_met and connector._id ~= "initial" and not is_closed[connector] then
      is_closed[connector] = true
      findings:add("closed", connector, location.path(connector, prefix),
        "no step passes this connector")
    end
  end
  return is_closed
end

-- Finds transitions that no step takes although steps reach their source and target. If
-- no step reaches one of the two, another finding reports this.
local function find_untaken(walk, findings, met, is_closed)
  local function is_told(entry)
    local src, tgt = entry.tr.src, entered_by(entry.tr)
    return is_closed[tgt] or rfsm.is_conn(src) and not met.entered[src]
      and not (src._id == "initial" and rfsm.is_root(src._parent))
      or rfsm.is_state(src) and not met.active[location.path(src, entry.prefix)]
      or rfsm.is_state(tgt) and not met.active[location.path(tgt, entry.prefix)]
  end
  for number, entry in ipairs(walk.subject.transitions) do
    if not (walk.taken[number] or is_told(entry)) then
      findings:add("shadowed", entry.tr, entry.path, ("no step takes it (%s -> %s)%s")
        :format(entry.tr.src._fqn, entry.tr.tgt._fqn, timer_text(walk, entry)))
    end
  end
end

-- Returns the leaves of a configuration, their paths as a text, and whether all leaves
-- are final (a leaf with regions is counted as final).
local function leaves_of(walk, number)
  local leaves, paths, are_final = subject.leaves(walk:configuration(number)), {}, true
  for i, leaf in ipairs(leaves) do
    paths[i] = leaf.path
    are_final = are_final
      and (leaf.state.final == true or rfsm.regions(leaf.state)[1] ~= nil)
  end
  return leaves, concat(paths, ", "), are_final
end

-- Appends a finding. Its witness is the run to configuration `number`, followed by the
-- step with the label `label` if one is given. A run that is doubtful shows nothing.
local function add_run(walk, findings, code, state, path, text, number, label)
  local own = walk.subject
  local may_change = own.data_writers[1] or own.unknown[1] or own.writers[1]
  local known = may_change and walk:witness(number, label) -- what is not followed
  if known and explore.is_doubtful(known, own.run_list[1]) then return {} end
  local finding = findings:add(code, state, path, text)
  if finding then finding.witness = known or walk:witness(number, label) end
  return finding or {}
end

-- Returns the path of the leaf of the machine itself, not of its regions.
local function own_leaf(walk, number)
  return walk:configuration(number)[1].known.path or "none"
end

local function add_dead_end(walk, findings, number)
  local leaves, text, are_final = leaves_of(walk, number)
  local state = leaves[1] and leaves[1].state
  if not state then
    add_run(walk, findings, "dead-end", walk.subject.parts[1].fsm, "root",
      "the machine cannot be entered", number)
  elseif not (are_final or rfsm.is_root(state)) then
    local finding = add_run(walk, findings, "dead-end", state, text,
      "nothing happens any more in this configuration", number)
    local is_fault = any(leaves, function(leaf)
      return not structure.is_end(walk.subject.part_of[leaf.path].fsm, leaf.state)
    end)
    if not is_fault then finding.severity = "note" end
  end
end

-- Finds dead ends: configurations in which nothing happens any more. It is none if some
-- walk has no dead end with the same leaf of the machine: a region still moves there.
local function find_dead_ends(walks, findings)
  local are_stuck = {}
  for i, walk in ipairs(walks) do
    are_stuck[i] = {}
    for _, at in ipairs(walk.stuck) do are_stuck[i][own_leaf(walk, at)] = true end
  end
  for _, walk in ipairs(walks) do
    for _, number in ipairs(walk.stuck) do
      local leaf = own_leaf(walk, number)
      local goes_on = any(are_stuck, function(is_stuck) return not is_stuck[leaf] end)
      if not goes_on then add_dead_end(walk, findings, number) end
    end
  end
end

-- Finds a configuration from which `run` never ends, since an event is pending after
-- each step.
local function find_endless(walk, findings)
  local is_idle, are_idle, step = {}, true, walk.endless
  for number = 1, #walk.keys do
    local conf = walk:configuration(number)
    is_idle[number] = number > walk.expanded or walk.cut[number]
      or not (conf[1].leaf and subject.is_driven(conf))
    are_idle = are_idle and is_idle[number]
  end
  local ends = are_idle and is_idle or graph.can_reach(walk, is_idle, true)
  for number = 2, walk.expanded do
    if not ends[number] then
      local leaf = walk:configuration(number)[1].leaf
      return add_run(walk, findings, "endless", leaf, own_leaf(walk, number),
        "run never becomes idle from this configuration", number)
    end
  end
  if step then
    add_run(walk, findings, "endless", walk.subject.parts[1].fsm, "root",
      "a machine in a sequential AND state never becomes idle", step.from, step.label)
  end
end

-- Returns three results for some configurations: the paths of their leaves, each set of
-- leaves once; whether the machine has ended in one of them; the last leaf of each set.
local function leaves_of_all(walk, numbers)
  local paths, states, is_listed, has_end = {}, {}, {}, false
  for _, number in ipairs(numbers) do
    local leaves, text, are_final = leaves_of(walk, number)
    has_end = has_end or are_final or not leaves[1]
    if not is_listed[text] and leaves[1] then
      paths[#paths + 1], states[#states + 1] = text, leaves[#leaves].state
    end
    is_listed[text] = true
  end
  return paths, has_end, states
end

-- Does a configuration wait for an event from outside? It does not if a sent event is
-- pending, a timer runs, or a step without events leads to another configuration.
local function is_waiting(walk, number)
  local conf = walk:configuration(number)
  local goes_on = subject.is_driven(conf)
  for _, entry in ipairs(conf.context and conf.context.entries or {}) do
    goes_on = goes_on or entry.clock.later ~= nil
  end
  graph.each_step(walk, number, function(tgt, is_internal)
    goes_on = goes_on or is_internal and tgt ~= number
  end)
  local part = walk.subject.parts[1]
  return not (goes_on or reactions.of(part, conf[1].leaf).timers[1])
end

-- Returns the first configuration of a component in which the machine waits for an
-- event from outside; if a set is given, the first one in this set.
local function find_waiting(walk, numbers, set)
  for _, number in ipairs(numbers) do
    if number > 1 and (not set or set[number]) and is_waiting(walk, number) then
      return number
    end
  end
end

-- Searches the components in `others` for a configuration in which the machine waits,
-- and from which it can reach the configurations `numbers`. Returns this configuration,
-- and whether it is on a cycle with at least `least` sets of leaves.
local function find_before(walk, numbers, others, least)
  local set, first = {}, nil
  for _, number in ipairs(numbers) do set[number] = true end
  local leads_there = graph.can_reach(walk, set)
  for _, component in ipairs(others) do
    local number = find_waiting(walk, component, leads_there)
    local paths = leaves_of_all(walk, number and component or {})
    if paths[least] then return number, true end
    if number and (not first or number < first) then first = number end
  end
  return first, false
end

-- Has the machine itself (without its regions) the same leaf in all of these
-- configurations? If not, the first walk has the same trap, which is reported there.
local function is_in_one_leaf(walk, numbers)
  local leaf = own_leaf(walk, numbers[1])
  return not any(numbers, function(number) return own_leaf(walk, number) ~= leaf end)
end

local function is_fault(state) return codes.means(state, "a fault") end

-- Finds traps: configurations that lead to each other and nowhere else, if the machine
-- waited for an event before it came there. The part before the trap may have been a
-- setup, so the finding is a note. It is a warning if the part before has a cycle with
-- at least as many states as the trap, or if a name in the trap means a fault.
local function find_traps(walk, findings, is_first)
  local bottoms, others = graph.components(walk)
  local function waits_in(component) return find_waiting(walk, component) end
  if not any(others, waits_in) then return end
  for _, numbers in ipairs(bottoms) do
    local paths, has_end, states = leaves_of_all(walk, numbers)
    local outside, is_small
    if paths[2] and not has_end and (is_first or is_in_one_leaf(walk, numbers)) then
      outside, is_small = find_before(walk, numbers, others, #paths)
    end
    local _, name = leaves_of(walk, outside or 1)
    if outside and not match.has(paths, name) then -- otherwise only data differ
      local finding = add_run(walk, findings, "trap", states[1], paths[1],
        concat(paths, " and ") .. " lead to each other, and never back to " .. name,
        numbers[1])
      if not (is_small or any(states, is_fault)) then finding.severity = "note" end
    end
  end
end

-- Premises and properties .........................................................

local NUMBERS = { "one event", "two events", "three events" }

-- Returns the names of the set `free` as a text: "guards and doos". All answers of free
-- callbacks are tried.
local function free_text(free)
  local names = rfsm.sorted_keys(free)
  local last = remove(names)
  return names[1] and concat(names, ", ") .. " and " .. last or last
end

-- Appends the texts of the premises about time, if a walk has timers.
local function add_times(texts, walks, period)
  local function is_timed(walk) return walk.timing and walk.timing.is_timed end
  if not any(walks, is_timed) then return end
  texts[#texts + 1] = period and ("stepped every %s s"):format(rfsm.text_of(period))
    or "stepped between any two deadlines"
  texts[#texts + 1] = "steps take no time"
end

-- Returns the premises of walks as a text: "one event a step; guards and timers free".
local function premises_of(walks, options)
  local walk, free = walks[1], {}
  for _, each in ipairs(walks) do
    for name in order.each(each.subject.free) do free[name] = true end -- any order
  end
  local texts = { (NUMBERS[walk.together] or walk.together .. " events") .. " a step" }
  if walk.subject.parts[1].reads_one then
    texts[2] = "none from outside while one waits"
  end
  if options.alphabet then texts[#texts + 1] = "no event outside of the alphabet" end
  texts[#texts + 1] = any(walks, function(each) return each.is_limited end)
    and "at most " .. opts.counted(options.deferred, "deferred event") or nil
  if walk.way then texts[#texts + 1] = "independent regions one by one" end
  add_times(texts, walks, options.period)
  texts = match.joined(texts, data.premises(walk.subject))
  texts[#texts + 1] = not order.is_empty(free) and free_text(free) .. " free" or nil
  return concat(texts, "; ")
end

-- Adds to a result the texts of what a walk has not tried, and the bound that it hit.
local function note_bound(result, walk)
  for _, text in ipairs(walk.untried) do
    explore.note_untried(result, walk.bound, text)
  end
end

-- Returns the reason why the verdict on a property is open although everything was
-- tried; the empty text if it is not open.
local function reason_of(walk, judged)
  if not judged.is_open then return "" end
  return walk.subject.free["sends with a delay"] and ", sends with a delay are free"
    or ", it depends on when timers expire"
end

-- Returns the run that violates a property. If it is doubtful, returns nil, and the
-- verdict is not known.
local function find_witness(walk, judged)
  local witness = walk:witness(judged.at, judged.label, judged.cycle)
  local goes_on = judged.tgt or judged.rests or judged.cycle
  local is_open = explore.is_doubtful(witness, goes_on and walk.subject.run_list[1])
    or explore.may_miss(witness, judged.rests or judged.cycle)
  if not is_open then return witness end
  judged.holds = nil
end

-- Returns what is said of a property, and the reason.
local function word_of(judged)
  if judged.holds then
    return "holds" .. (judged.vacuous and " vacuously, " .. judged.vacuous or "")
  end
  return (judged.holds == nil and "not known" .. judged.reason or "does not hold")
    .. (judged.unnamed and ", " .. judged.unnamed or "")
end

-- Judges a property on its walk: sets its verdict, and the gaps that leave it open.
local function judge(walk, judged, options)
  properties.judge(walk, judged)
  local witness = judged.at and find_witness(walk, judged)
  if witness then witness.rests = judged.rests end
  judged.gaps = { bound = walk.bound, untried = walk.untried }
  judged.verdict = setmetatable({ name = judged.name, holds = judged.holds,
    vacuous = judged.holds and judged.vacuous or nil, unnamed = judged.unnamed,
    witness = witness,
    reason = reason_of(walk, judged),
    premises = premises_of({ walk }, options)
      .. (monitors.kinds[judged.property.kind].owes and "; doos end" or "") }, Verdict)
end

-- Adds the verdict on a property to a result, with a finding if it is violated.
local function add_verdict(result, judged)
  result.properties[#result.properties + 1] = judged.verdict
  if judged.holds == nil then note_bound(result, judged.gaps) end
  local finding = judged.holds == false and result.findings:add("violated", nil,
    judged.name, word_of(judged))
  if finding then finding.witness = judged.verdict.witness end -- nil: given twice
end

-- Text ............................................................................

--- Return the choices of a step as a text: " (root.trans[2] false, root.b ends)".
function verdict.choices_text(step)
  local texts = {}
  for i, choice in ipairs(step.choices) do
    local word = tostring(choice.answer)
    if choice.is_doo then word = choice.answer and "ends" or "goes on" end
    texts[i] = choice.who .. " " .. word
  end
  return texts[1] and " (" .. subject.listed(texts) .. ")" or ""
end

--- Return the steps of a witness as lines.
---@param witness rfsm_checks.WitnessStep[]
---@return string[] lines
function verdict.lines_of(witness)
  local lines = {}
  for i, step in ipairs(witness) do
    local events = step.events[1] and concat(step.events, ", ") or "no event"
    local wait = i > 1 and step.at and step.at - witness[i - 1].at or 0
    local text = wait > 0 and "+" .. rfsm.number_text(wait, "%.9g") .. " s, " or ""
    lines[i] = ("%d. %s%s%s: %s"):format(i, text, events, verdict.choices_text(step),
      subject.outcome(step.taken, step.leaf))
  end
  if witness.again then
    lines[#lines + 1] = ("and again from %d on"):format(witness.again)
  elseif witness.rests then
    lines[#lines + 1] = "and nothing more has to come"
  end
  return lines
end

-- Returns a run as one line: "off -e_power-> homing -+1 s, e_homed-> ready".
local function run_text(witness)
  local parts, before = {}, 0
  for i, step in ipairs(witness) do
    local texts, at = {}, step.at or before
    if i > 1 and at > before then
      texts[1] = "+" .. rfsm.number_text(at - before, "%.9g") .. " s"
    end
    for _, event in ipairs(step.events) do
      texts[#texts + 1] = event:gsub("@root[^%s]*", "")
    end
    local leaf = (step.leaf or "not entered"):gsub("^root%.", "")
    before = at
    parts[i] = i > 1 and ("-%s-> %s"):format(concat(texts, ", "), leaf) or leaf
  end
  return concat(parts, " ")
end

local UNKNOWN = "not tried: %s; unreached states, transitions not taken and whether "
  .. "properties hold are not known"

-- Returns a property that holds or is not known as a line. Premises that another line
-- has are replaced by its name: `said` has the names, by premises.
local function property_text(judged, said)
  local text = judged.name .. ": " .. word_of(judged)
  if judged.holds == nil then return text end
  local name = said[judged.premises]
  said[judged.premises] = name or judged.name
  return ("%s (%s)"):format(text,
    name and ("premises of '%s'"):format(name) or judged.premises)
end

function Verdict:__tostring()
  local lines = { self.name .. ": " .. word_of(self) }
  if self.witness then lines[2] = "  " .. run_text(self.witness) end
  lines[#lines + 1] = "  (" .. self.premises .. ")"
  return concat(lines, "\n")
end

local function add_finding_lines(lines, finding)
  local kind = finding.severity ~= "error" and finding.severity .. ": " or ""
  local text = static.line(finding):sub(#finding.file + 1)
  lines[#lines + 1] = finding.file .. kind .. text
  for _, line in ipairs(verdict.lines_of(finding.witness or {})) do
    lines[#lines + 1] = "  " .. line
  end
end

-- The bounds that an option sets. A walk that hits one stops there.
local KNOBS = { configurations = true, depth = true, seconds = true }

-- Returns a line about the bound that stopped a walk: its value, how far the walk came,
-- and what is free, so that there is so much; nil if no option stopped it.
local function reach_of(walk)
  local options = walk.options
  if not KNOBS[walk.bound or ""] then return nil end
  local free = free_text(walk.subject.free)
  return ("stopped by %s = %s: depth %d, %d of %d configurations not expanded; raise "
    .. "it, or bind what is free (%sevents by alphabet)"):format(walk.bound,
    (rfsm.number_text(options[walk.bound], "%.1f"):gsub("%.0$", "")), walk.depth,
    #walk.keys - walk.expanded, #walk.keys, free and free .. " by run, " or "")
end

--- Return a summary of an exploration as lines: how many configurations and steps there
--- are, what was not tried, and the properties that hold or are not known.
---@param has_numbers boolean? false: without the numbers, unless a bound was hit
---@return string[] lines
function Exploration:summary(has_numbers)
  local lines = {}
  if has_numbers or self.bound then
    lines[1] = ("%d configurations, %d of %d transitions taken, %d steps run"):format(
      self.configurations, self.taken, self.transitions, self.steps)
  end
  if self.bound then lines[2] = UNKNOWN:format(concat(self.untried, "; ")) end
  lines[#lines + 1] = self.reach
  local said = {}
  for _, judged in ipairs(self.properties) do
    if judged.holds ~= false then
      lines[#lines + 1] = property_text(judged, said)
    end
  end
  return lines
end

function Exploration:__tostring()
  local lines = self:summary(true)
  for _, finding in ipairs(self.findings) do add_finding_lines(lines, finding) end
  return concat(lines, "\n")
end

-- Public functions ................................................................

-- Returns the properties in the root of the model, and those in the options.
local function properties_of(model, options)
  local given = {}
  for _, source in ipairs { model.properties or {}, options.properties } do
    if type(source) == "table" and not rfsm.is_fsmobj(source) then
      local all = properties.listed(source)
      for key, property in order.each(all) do -- any order: sorted later
        given[type(key) == "string" and key or property] = property
      end
    end
  end
  return given
end

-- Counts the transitions that at least one walk takes.
local function count_taken(walks)
  local is_taken, count = {}, 0
  for _, walk in ipairs(walks) do
    for number in order.each(walk.taken) do -- any order: a set
      local path = walk.subject.transitions[number].path
      if not is_taken[path] then is_taken[path], count = true, count + 1 end
    end
  end
  return count
end

-- Returns a function that returns the walk of a property, and the list of the walks for
-- `ways` (sets of regions that a walk includes). Properties of one way share its walk,
-- which is made when it is first asked for.
local function walks_in(model, options, ways, list)
  local by_way, walks = {}, {}
  local function walk_of(way, own_walk)
    return explore.walk(model, options, function(walk)
      properties.watch(walk, list, own_walk)
    end, way)
  end
  setmetatable(by_way, { __index = function(_, way)
    by_way[way] = walk_of(way)
    return by_way[way]
  end })
  for i, way in ipairs(ways) do walks[i] = by_way[way] end
  return function(judged)
    return judged.is_apart and walk_of(judged.way, judged) or by_way[judged.way]
  end, walks
end

-- Returns a result with the numbers, the bounds and the premises, but no findings.
local function new_result(own, walks, options)
  local result = setmetatable({ configurations = 0, steps = 0,
    transitions = #own.transitions, taken = count_taken(walks), bound = nil,
    untried = {}, findings = static.new_list(), properties = {},
    premises = premises_of(walks, options) }, Exploration)
  for _, walk in ipairs(walks) do
    result.configurations = result.configurations + #walk.keys
    result.steps = result.steps + walk.count
    note_bound(result, walk)
    result.reach = result.reach or reach_of(walk)
  end
  return result
end

-- Appends all findings except violated properties and dead ends.
local function find_others(walks, findings)
  find_endless(walks[1], findings)
  for i, walk in ipairs(walks) do
    if not walk.bound and walk:is_entered() then
      local met = met_by(walk)
      find_unreachable(walk, findings, met)
      find_untaken(walk, findings, met, find_closed(walk, findings, met))
      find_traps(walk, findings, i == 1)
    end
  end
end

-- Walks over a chart, and judges what needs no monitor. Returns a result with findings;
-- nil if a region never becomes idle, which stops all: then one walk has to have all.
local function judge_chart(model, own, list, options)
  local ways = independence.ways(own, list, options)
  local walk_for, walks = walks_in(model, options, ways, list)
  local has_endless = any(walks, function(walk) return walk.endless end)
  local is_late = any(walks, function(walk) return walk.is_late end)
  if walks[2] and has_endless and not is_late then return nil end
  local result = new_result(own, walks, options)
  for _, judged in ipairs(list) do
    if monitors.kinds[judged.property.kind].judge then
      judge(walk_for(judged), judged, options)
    end
  end
  find_dead_ends(walks, result.findings)
  find_others(walks, result.findings)
  return result
end

-- Walks with the monitors of some properties, which the walk must not make larger than
-- `most` configurations.
local function walk_with(list, model, options, most)
  local own = options.configurations
  options.configurations = min(own, most)
  local walk = explore.walk(model, options, function(walk)
    properties.monitor(walk, list)
  end, list[1].way)
  options.configurations = own
  return walk
end

local MANY_TIMES = 4 -- most configurations of a shared walk, by those of the chart

-- Judges properties by monitors that share a walk. A property gets a walk of its own if
-- the shared one was not finished or left out orders of deadlines, and if the clocks of
-- other properties may be on the run that violates it.
local function judge_together(list, model, options, configurations)
  local most = min(#list, MANY_TIMES) * configurations
  local walk = walk_with(list, model, options, list[2] and most or huge)
  local is_exact = not walk.keys[walk.expanded + 1]
    and not (walk.timing and (walk.timing.is_cut or walk.timing.is_inexact))
  for _, judged in ipairs(list) do
    local is_known = judged.holds == false and not judged.property.seconds
      or judged.holds == nil and is_exact
    if is_known or not list[2] then
      judge(walk, judged, options)
    else
      judged.holds, judged.at, judged.label = nil, nil, nil
    end
  end
end

--- Explore a model, judge its properties, and return the result.
---@param model rfsm.State
---@param options rfsm_checks.Options
---@return rfsm_checks.Exploration
function verdict.of(model, options)
  options.properties = properties_of(model, options)
  local own = subject.new(model, options)
  local list = properties.list_for(own, options.properties)
  local result = judge_chart(model, own, list, options)
  if not result then
    options.multiply = true
    return verdict.of(model, options)
  end
  for _, group in ipairs(properties.groups(list)) do
    judge_together(group, model, options, result.configurations)
    for _, judged in ipairs(group) do
      if not judged.verdict then judge_together({ judged }, model, options, huge) end
    end
  end
  local findings = result.findings
  result.findings = static.new_list()
  for _, judged in ipairs(list) do add_verdict(result, judged) end
  result.findings:join(findings)
  return result
end

return verdict
