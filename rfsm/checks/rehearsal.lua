--- Rehearsal: a chart run step by step without its callbacks, for tests and witnesses.
--
-- Guards answer true, and doos go on, unless a step says otherwise. Time is what the
-- rehearsal says.
--
-- @module rfsm.checks.rehearsal
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local puppet = require "rfsm.checks.puppet"

local error, ipairs, pairs, require = error, ipairs, pairs, require
local setmetatable, table, type = setmetatable, table, type

local rehearsal = {}

--- A chart that is rehearsed.
---@class rfsm_checks.Rehearsal
---@field puppet rfsm_checks.Puppet
local Rehearsal = {}
Rehearsal.__index = Rehearsal

-- What a step says of the guards and doos that are asked.
local function answer(own, who, is_doo)
  local said = own.said[who]
  own.asked = own.asked + 1
  own.is_asked[who] = true
  if said == nil then return not is_doo end
  return said
end

--- Begin the rehearsal of a chart.
-- @raise if it is not valid
---@param chart string|rfsm.State a file or a model
---@return rfsm_checks.Rehearsal
function rehearsal.rehearsal(chart)
  local model = type(chart) == "string" and rfsm.load(chart) or chart
  if not rfsm.is_state(model) then
    error("rfsm_checks.rehearsal: file or state expected, got " .. type(chart), 2)
  end
  local self = setmetatable({ puppet = puppet.new(model, {}) }, Rehearsal)
  self.puppet.choose, self.puppet.said, self.puppet.is_asked = answer, {}, {}
  return self
end

--- Return what to tell a rehearsal about a step of a witness.
---@param step rfsm_checks.WitnessStep
---@return table what see `Rehearsal:step`
function rehearsal.what_of(step)
  local what = { guards = {}, ends = {}, inside = {} }
  for i = 1, #step.values do what[i] = step.values[i] end
  for _, inner in ipairs(step.inside) do
    what.inside[inner.prefix] = what.inside[inner.prefix] or {}
    table.insert(what.inside[inner.prefix], inner.event)
  end
  for _, choice in ipairs(step.choices) do
    if choice.is_doo and choice.answer then
      what.ends[#what.ends + 1] = choice.who
    elseif not (choice.is_doo or choice.answer) then
      what.guards[choice.who] = false
    end
  end
  return what
end

-- Tells the puppet what to decide in the next step.
local function tell(own, what)
  own.said, own.is_asked = {}, {}
  for who, said in pairs(what.guards or {}) do own.said[who] = said end -- a copy
  for _, who in ipairs(what.ends or {}) do own.said[who] = true end
  for _, part in ipairs(own.parts) do part.rounds = 0 end
end

-- Returns the first path of which something was said in vain: nothing has asked.
local function unasked(own)
  for _, who in ipairs(rfsm.sorted_keys(own.said)) do
    if not own.is_asked[who] then return who end
  end
end

-- Lists the occurrences of events in a step.
local function occurrences_of(own, what)
  local list, inside = {}, what.inside or {}
  for i = 1, #what do list[i] = own:occurrence(own.parts[1], what[i]) end
  for _, part in ipairs(own.parts) do
    for _, event in ipairs(part.owner and inside[part.prefix] or {}) do
      list[#list + 1] = own:occurrence(part, event)
    end
  end
  return list
end

--- Take a step with the events given, and with what guards and doos decide in it.
--
-- `run:step { "e_x", guards = { ["root.trans[2]"] = false }, ends = { "root.busy" } }`
--
---@param what? table events; `guards` by path; `ends`: paths of doos; `after`: seconds;
-- `inside`: lists of events of regions, by their paths
---@return string text "root.trans[2] -> root.b": transitions taken, and the active leaf
function Rehearsal:step(what)
  what = what or {}
  local own = self.puppet
  tell(own, what)
  own.now = own.now + (what.after or 0)
  own:step(occurrences_of(own, what), {})
  local paths, who = own:paths_of(), unasked(own)
  if who then paths[#paths + 1] = "(" .. who .. " was not asked)" end
  return puppet.outcome(paths, rfsm.get_actleaf_fqn(own.parts[1].fsm))
end

-- Takes the step of a witness again, with its choices one after the other.
function Rehearsal:repeat_step(step)
  local own, what, choices = self.puppet, rehearsal.what_of(step), {}
  for i, choice in ipairs(step.choices) do choices[i] = choice.answer end
  own.choose = nil
  for _, part in ipairs(own.parts) do part.rounds = 0 end
  own:step(occurrences_of(own, what), choices)
  own.choose = answer
end

-- Witnesses: the run that shows a finding, for the simulator and for pictures ........

local function check_steps(steps, where)
  if type(steps) == "table" then return end
  error("rfsm_checks." .. where .. ": the witness of a finding expected, got "
    .. type(steps), 3)
end

--- Write a witness as a recording, which `rfsm sim --replay FILE --dry CHART` runs.
---@param model rfsm.State
---@param steps rfsm_checks.WitnessStep[] the field `witness` of a finding
---@param sink table|string list of records, or the name of a file
function rehearsal.record_witness(model, steps, sink)
  check_steps(steps, "record_witness")
  local run = rehearsal.rehearsal(model)
  local fsm = run.puppet.parts[1].fsm
  local recorder = require("rfsm.record").record(fsm, sink)
  for _, step in ipairs(steps) do run:repeat_step(step) end
  recorder:stop()
end

--- List the transitions and leaves of a witness by path: the `trace` of a picture.
---@param steps rfsm_checks.WitnessStep[]
---@return string[] paths
function rehearsal.path_of(steps)
  check_steps(steps, "path_of")
  local paths = {}
  for _, step in ipairs(steps) do
    for _, path in ipairs(step.taken) do paths[#paths + 1] = path end
    if step.taken[1] and step.leaf then paths[#paths + 1] = step.leaf end
  end
  return paths
end

return rehearsal
