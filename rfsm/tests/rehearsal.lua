--- Rehearsal: runs a chart step by step without its callbacks, for tests and witnesses.
--
-- The argument of a step has the answers of guards, and names the doos that end. If a
-- guard or doo without an answer was asked, the result names it. Time advances only by
-- the seconds in the argument of a step. The machine, with its callbacks replaced, and
-- its regions are the parts of a subject (`rfsm.explore.subject`).
--
-- @module rfsm.tests.rehearsal
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local calls = require "rfsm.shared.calls"
local chart = require "rfsm.shared.chart"
local opts = require "rfsm.shared.options"
local location = require "rfsm.shared.location"
local stubs = require "rfsm.shared.stubs"
local subject = require "rfsm.explore.subject"

local error, getmetatable, ipairs = error, getmetatable, ipairs
local pairs, rawget, rawset = pairs, rawget, rawset
local select, setmetatable = select, setmetatable
local table, type = table, type
local concat = table.concat

local rehearsal = {}

--- A chart in rehearsal.
---@class rfsm_checks.Rehearsal
---@field subject rfsm_checks.Subject
local Rehearsal = {}
Rehearsal.__index = Rehearsal

-- Replaces `Subject:choose`: returns the answer that the argument of the step has for a
-- guard or doo; `who` is its path. Without an answer a guard is true, a doo goes on.
local function answer(own, who, is_doo)
  local said = own.said[who]
  if said == nil and not own.is_asked[who] then
    own.unmentioned[#own.unmentioned + 1] = who
  end
  own.is_asked[who] = true
  if said == nil then return not is_doo end
  return said
end

-- Fills two tables: `asker_of` leads from the name of a transition or state to the path
-- (`who` in `answer`) of its guard or doo, `name_of` leads from path to name.
local function add_names(own)
  own.asker_of, own.name_of = {}, {}
  location.add_names(own.transitions)
  local function add(name, who)
    own.asker_of[name], own.name_of[who] = own.asker_of[name] or who, name
  end
  for _, entry in ipairs(own.transitions) do
    add(entry.name, entry.path)
    add(entry.name .. " predicate", entry.path .. " predicate")
  end
  for _, part in ipairs(own.parts) do
    for _, leaf in ipairs(rfsm.elements(part.fsm, rfsm.is_leaf)) do
      add(location.name_of(leaf, part.prefix), location.path(leaf, part.prefix))
    end
  end
end

-- Fakes: stubs that callbacks find in place of `print` and of undefined globals. Each
-- call of a fake is noted as a text: "motor.start(5)".

-- Returns an argument of a call as a text. A table or function that is not a stub is
-- only named by its type, since its address differs from run to run.
local function text_of_argument(value)
  local is_plain = type(value) ~= "table" and type(value) ~= "function"
  return stubs.name_of(value) or is_plain and rfsm.text_of(value) or type(value)
end

local function new_fake(own, name)
  return stubs.new(name, function(called, ...)
    local texts = {}
    for i = 1, select("#", ...) do texts[i] = text_of_argument((select(i, ...))) end
    own.called[#own.called + 1] = ("%s(%s)"):format(called, concat(texts, ", "))
  end)
end

-- Calls f(...) while fakes take the place of globals.
local function with_fakes(own, f, ...)
  local real, fakes, class = {}, own.fakes, nil
  for name, fake in pairs(fakes) do -- any order: each stands alone
    real[name] = { rawget(_G, name) }
    rawset(_G, name, fake)
  end
  if not getmetatable(_G) then
    class = { __index = function(_, name)
      own.unknown[name] = own.unknown[name] or new_fake(own, rfsm.text_of(name))
      return own.unknown[name]
    end }
    setmetatable(_G, class)
  end
  return calls.finally(function()
    if class and getmetatable(_G) == class then setmetatable(_G, nil) end
    for name in pairs(fakes) do rawset(_G, name, real[name][1]) end -- any order
  end, f, ...)
end

local KNOWN = {
  callbacks = { "boolean", opts.is_a "boolean", false },
  fakes = { "table", opts.is_a "table", {} },
  stub = { "boolean", opts.is_a "boolean", false },
  machine = opts.whole(),
}

-- Returns the model in a file; raises an error if there is none.
local function load(file, settings)
  local model, problem = chart.load(file, settings.stub, settings.machine)
  return model or error("rfsm_checks.rehearsal: " .. problem, 0)
end

--- Begin the rehearsal of a chart.
-- @raise if the chart is not valid, or an option is wrong
---@param what string|rfsm.State a file or a model
---@param options? { callbacks: boolean?, fakes: table<string, any>?, stub: boolean?,
-- machine: integer? } `callbacks`: run entries, exits and effects, with the values in
-- `fakes` as globals. `print` and undefined globals are fakes by default; their calls
-- are noted. `stub`, `machine`: as the options of `rfsm check` with these names
---@return rfsm_checks.Rehearsal
function rehearsal.rehearsal(what, options)
  local settings = opts.take("rfsm_checks.rehearsal", KNOWN, options)
  local model = type(what) == "string" and load(what, settings) or what
  if not rfsm.is_state(model) then
    error("rfsm_checks.rehearsal: file or state expected, got " .. type(what), 2)
  end
  local own = subject.new(model, { callbacks = settings.callbacks })
  own.choose, own.said, own.is_asked = answer, {}, {}
  if settings.callbacks then
    own.fakes, own.unknown = { print = new_fake(own, "print") }, {}
    for name, fake in pairs(settings.fakes) do own.fakes[name] = fake end -- any order
  end
  add_names(own)
  return setmetatable({ subject = own }, Rehearsal)
end

--- Return the answers in a step of a witness as an argument for `Rehearsal:step`.
---@param step rfsm_checks.WitnessStep
---@return { guards: table, ends: string[], goes_on: string[] } what
function Rehearsal:answers_of(step)
  local what, name_of = { guards = {}, ends = {}, goes_on = {} }, self.subject.name_of
  for _, choice in ipairs(step.choices) do
    local name = name_of[choice.who]
    if choice.is_doo then
      table.insert(choice.answer and what.ends or what.goes_on, name)
    else
      what.guards[name] = choice.answer and what.guards[name] ~= false
    end
  end
  return what
end

-- Returns the path of the guard or doo of the transition or state with this name.
local function find_asker(own, name)
  local who = own.asker_of[name]
  if who then return who end
  error(("rfsm_checks.rehearsal: no transition or state is named '%s'%s"):format(
    rfsm.text_of(name), advice.nearest_name(rfsm.text_of(name),
      rfsm.sorted_keys(own.asker_of))), 4)
end

-- Stores the answers of guards and doos for the next step.
local function tell(own, what)
  own.said, own.is_asked, own.unmentioned = {}, {}, {}
  for _, name in ipairs(rfsm.sorted_keys(what.guards or {})) do
    own.said[find_asker(own, name)] = what.guards[name]
  end
  for _, name in ipairs(what.goes_on or {}) do
    own.said[find_asker(own, name)] = false
  end
  for _, name in ipairs(what.ends or {}) do own.said[find_asker(own, name)] = true end
end

-- Lists the guards and doos that were asked without having an answer, and those that
-- had an answer without being asked.
local function surprises(own)
  local list = {}
  for _, who in ipairs(own.unmentioned) do
    list[#list + 1] = "(" .. (own.name_of[who] or who) .. " was asked)"
  end
  for _, who in ipairs(rfsm.sorted_keys(own.said)) do
    if not own.is_asked[who] then
      list[#list + 1] = "(" .. own.name_of[who] .. " was not asked)"
    end
  end
  return list
end

-- Lists the events in the argument of a step, each as an occurrence for the subject.
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

-- Returns the outcome of a step as a text: the names of the transitions that it took,
-- and the unexpected questions and calls of fakes.
local function outcome(own)
  local texts, leaf = {}, own.parts[1].fsm._act_leaf
  for i, number in ipairs(own.taken) do texts[i] = own.transitions[number].name end
  if not texts[1] then
    texts[1] = leaf and "stays in " .. location.name_of(leaf, "root")
      or "is not entered"
  end
  for _, text in ipairs(surprises(own)) do texts[#texts + 1] = text end
  local called = own.called[1] and ": " .. concat(own.called, ", ") or ""
  return concat(texts, ", ") .. called
end

--- Take a step with some events, and with answers of guards and doos.
--
-- `run:step { "e_x", guards = { ["off -e_x-> on"] = false }, ends = { "busy" } }`
--
---@param what? table list of events, with fields. `guards`: answers by transition;
-- `ends`, `goes_on`: lists of states whose doo ends or goes on; `after`: seconds that
-- pass before the step; `inside`: lists of events for regions, by the paths of regions
---@return string text the transitions taken: "off -e_x-> on", or "stays in off". Then
-- guards and doos that were asked without having an answer, and those that had an
-- answer without being asked. If callbacks run, the calls of fakes follow behind a
-- colon
function Rehearsal:step(what)
  what = what or {}
  local own = self.subject
  tell(own, what)
  own.time:advance(what.after or 0)
  local events = occurrences_of(own, what)
  if own.fakes then
    with_fakes(own, own.step, own, events, {})
  else
    own:step(events, {})
  end
  return outcome(own)
end

-- Sends an event that a callback has sent in a step to a part, so that the next step of
-- the part sees it. If the part takes several steps in one of the machine, this raises
-- an error, since the event would come too late.
local function send_after(part, event)
  if not part.is_single then
    error(("rfsm_checks.record_witness: a callback in %s sends '%s' while the region "
      .. "takes several steps in one: no recording has that"):format(part.prefix,
      rfsm.event_text(event)), 0)
  end
  rfsm.send_events(part.fsm, event)
end

-- Takes a step of a witness again: guards and doos answer as in the witness, in order.
function Rehearsal:repeat_step(step)
  local own, events, choices = self.subject, {}, {}
  for i = 1, #step.values do
    events[i] = own:occurrence(own.parts[1], step.values[i])
  end
  for _, inner in ipairs(step.inside) do
    events[#events + 1] = own:occurrence(own.part_of[inner.prefix], inner.event)
  end
  for i, choice in ipairs(step.choices) do choices[i] = choice.answer end
  own.choose = nil
  if step.at then own.time:advance(step.at - own.time:now()) end
  own:step(events, choices)
  own.choose = answer
  for _, sent in ipairs(step.sent) do
    send_after(own.part_of[sent.prefix], sent.event)
  end
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
  local fsm = run.subject.parts[1].fsm
  local recorder = rfsm.find_module("rfsm.record").record(fsm, sink)
  for _, step in ipairs(steps) do run:repeat_step(step) end
  recorder:stop()
end

--- List the paths of the transitions and leaves in a witness: a `trace` for a picture.
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
