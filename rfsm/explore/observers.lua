--- Observers: charts that hear what a machine does, and must never be in a leaf `bad`.
--
-- An observer hears one word after the other. In a step of the machine these are the
-- events that come, unless the step enters the machine, `taken root.trans[2]` for each
-- transition of a path, then `exit root.a` and `entry root.b` in their order. It hears
-- `pass` behind the entry of a state that the step leaves again, and `step` when the
-- step is over. A transition may have a field `when`, a condition on the machine. If it
-- has no events, it hears `step`.
--
-- The leaf of the observer is the state of its monitor. The engine takes each of its
-- steps, once for each leaf, word and truth of its conditions.
--
-- @module rfsm.explore.observers
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local instrument = require "rfsm.shared.instrument"
local location = require "rfsm.shared.location"
local match = require "rfsm.shared.match"
local monitors = require "rfsm.explore.monitors"
local order = require "rfsm.shared.order"
local static = require "rfsm.checks.static"

local error, ipairs, pcall = error, ipairs, pcall
local setmetatable, type = setmetatable, type
local concat = table.concat

local observers = {}

--- What an observer may hear from a machine, and ask of it.
---@class rfsm_checks.Audible
---@field events any[] the events from outside, those with data by their names
---@field made any[] the events that the machine makes itself
---@field takes_any boolean a transition may take events that none names
---@field flags table<string, any> names of flags
---@field states string[] paths of states
---@field transitions string[] paths of transitions
---@field active fun(name: string): boolean raises an error if no state or flag has the
-- name

--- A word that an observer hears, and what is active then.
---@class rfsm_checks.Heard
---@field word any
---@field active fun(name: string): boolean

--- The machine of an observer.
---@class rfsm_checks.Observer
---@field fsm rfsm.Machine
---@field leaves table<string, rfsm.State> by FQN
---@field first string FQN of the leaf in which it begins
---@field words any[] all words that its transitions name
---@field conditions any[] all conditions of its transitions
---@field truth boolean[] does each condition hold now?
---@field known table<any, table<string, string>> word -> leaf and truth -> next leaf
local Observer = {}
Observer.__index = Observer

local STEP = "step"

-- The machine .......................................................................

local WHEN = { "when" }

local function refuse(obj, text)
  error(rfsm.location_of(obj) .. ": " .. text, 0)
end

local function check_element(obj)
  if rfsm.is_state(obj) and rfsm.regions(obj)[1] then
    refuse(obj, "an observer has no regions")
  end
  for _, field in ipairs(instrument.CALLBACKS) do
    if obj[field] then
      refuse(obj, ("an observer has no %s (a transition may have a condition, when = "
        .. "...)"):format(field))
    end
  end
end

-- Has a transition hear `step` if it names only a condition, and names of events in
-- place of the predicates of `rfsm.named`.
local function prepare_transition(tr)
  for _, field in ipairs(rfsm.sorted_keys(tr)) do
    if field ~= "when" and type(field) == "string" then
      local hint = advice.did_you_mean(field, WHEN)
      if hint ~= "" then refuse(tr, "no field is named '" .. field .. "'" .. hint) end
    end
  end
  local events = tr.events or {}
  for i, event in ipairs(events) do events[i] = rfsm.event_name(event) or event end
  if tr.when ~= nil and not events[1] then tr.events = { STEP } end
end

-- Makes the silent machine of a chart.
local function new_machine(chart)
  local fsm, _, problems = static.prepared(static.init, chart, function(fsm)
    for _, obj in ipairs(rfsm.elements(fsm)) do
      check_element(obj)
      if rfsm.is_trans(obj) then prepare_transition(obj) end
    end
  end)
  if not fsm then error(concat(problems, "; "), 0) end
  fsm.info, fsm.warn, fsm.err = false, false, false
  return fsm
end

local function add_leaves(self)
  local bad = {}
  for _, leaf in ipairs(rfsm.elements(self.fsm, rfsm.is_leaf)) do
    self.leaves[leaf._fqn] = leaf
    if leaf._id == "bad" then bad[#bad + 1] = leaf end
  end
  if not bad[1] then refuse(self.fsm, "no leaf of the observer is named 'bad'") end
  local is_target = order.any(rfsm.elements(self.fsm, rfsm.is_trans), function(tr)
    return order.any(bad, function(leaf) return location.is_inside(leaf, tr.tgt) end)
  end)
  if not is_target then refuse(self.fsm, "no transition leads to the leaf 'bad'") end
  rfsm.run(self.fsm)
  if not self.fsm._act_leaf then refuse(self.fsm, "the observer cannot be entered") end
  self.first = self.fsm._act_leaf._fqn
end

local OF_ELEMENTS = { entry = "states", exit = "states", taken = "transitions" }

--- Return what an observer may hear from a machine, and ask of it.
---@param events any[] events that the machine knows
---@param done table<string, true> the events e_done@F that it can make
---@param audible rfsm_checks.Audible gets its fields `events` and `made`
---@return rfsm_checks.Audible audible
function observers.hearing(events, done, audible)
  audible.events, audible.made = {}, rfsm.sorted_keys(done)
  for _, event in ipairs(events) do
    local list = match.maker_among(event, done) and audible.made or audible.events
    list[#list + 1] = rfsm.event_name(event) or rfsm.name_with_data(event) or event
  end
  return audible
end

--- Is a thing a condition, and not an event? A text is one if it is the path of a state
--- or the name of a flag, or could be a path.
---@param thing any
---@param audible rfsm_checks.Audible
---@return boolean
function observers.is_condition(thing, audible)
  if rfsm.event_name(thing) or rfsm.name_with_data(thing) then return false end
  return type(thing) ~= "string" or audible.flags[thing] ~= nil
    or (thing .. "."):find("^root%.") ~= nil
end

--- Return the kind and the path in a word about an element of the machine, such as
--- "entry root.a"; nil for other words.
---@param word any
---@return "entry"|"exit"|"taken"? kind
---@return string? path
function observers.element_of(word)
  local kind, path = rfsm.event_text(word):match("^(%l+) (root.*)$")
  if OF_ELEMENTS[kind] then return kind, path end
end

--- Return the hint for a word that a machine cannot say. The name of a state alone
--- means its entry.
---@param text string
---@param audible rfsm_checks.Audible
---@return string hint " (did you mean 'entry root.a'?)"
function observers.word_meant(text, audible)
  if text:find("^e_done@") then return advice.nearest_name(text, audible.made) end
  local kind, path = text:match("^(%a+)%s+(.+)$")
  kind, path = kind and kind:lower() or "entry", path or text
  local words = {}
  for i, name in ipairs(audible[OF_ELEMENTS[kind]] or {}) do
    words[i] = kind .. " " .. name
    if path == name or "root." .. path == name then
      return (" (did you mean '%s'?)"):format(words[i])
    end
  end
  if path:lower():find("^root") then
    return advice.nearest_name(kind .. " " .. path, words)
  end
  return advice.nearest_name(text, order.map(audible.events, rfsm.event_text))
end

--- Return the problem of a word; nil if the machine can say it.
---@param word any
---@param audible rfsm_checks.Audible
---@return string?
function observers.problem_of(word, audible)
  if word == STEP or word == "pass" or match.has(audible.events, word)
    or match.has(audible.made, word) then
    return nil
  end
  local text = rfsm.event_text(word)
  local kind, path = observers.element_of(word)
  local names = audible[OF_ELEMENTS[kind]]
  if names then
    return not match.has(names, path) and ("no %s is named '%s'%s"):format(
      kind == "taken" and "transition" or "state", path,
      advice.nearest_name(path, names)) or nil
  end
  return ("no transition of the machine names '%s'%s"):format(text,
    observers.word_meant(text, audible))
end

-- Notes the words and the condition of a transition, and checks them.
local function add_transition(self, tr, audible)
  for _, word in ipairs(tr.events or {}) do
    local problem = observers.problem_of(word, audible)
    if problem and match.maker_of(word) == "timer" then
      problem = "an observer has no timers (say `.within(seconds)`)"
    end
    if problem then refuse(tr, problem) end
    if not match.has(self.words, word) then self.words[#self.words + 1] = word end
  end
  if tr.when == nil then return end
  local n = #self.conditions + 1
  local ok, problem = pcall(monitors.ask_all, tr.when, audible.active)
  if not ok then refuse(tr, "when: " .. rfsm.text_of(problem)) end
  self.conditions[n] = tr.when
  tr.guard = function() return self.truth[n] end
end

--- Make the machine of an observer.
-- @raise if the chart is no observer, or hears what the machine never says; the error
-- begins with file and line of the element
---@param chart rfsm.State
---@param audible rfsm_checks.Audible
---@return rfsm_checks.Observer
function observers.new(chart, audible)
  local self = setmetatable({ fsm = new_machine(chart), leaves = {}, first = "",
    words = {}, conditions = {}, truth = {}, known = {} }, Observer)
  add_leaves(self)
  for _, tr in ipairs(rfsm.elements(self.fsm, rfsm.is_trans)) do
    if rfsm.is_state(tr.src) then add_transition(self, tr, audible) end
  end
  return self
end

-- Takes a step of the machine. Returns the FQN of the next leaf.
local function take_step(self, leaf, word)
  rfsm.place(self.fsm, self.leaves[leaf], "done", { word })
  rfsm.step(self.fsm)
  local next_leaf = self.fsm._act_leaf
  return next_leaf._id == "bad" and "violated" or next_leaf._fqn
end

-- Hears a word. Returns the FQN of the next leaf; "violated" for a leaf named `bad`.
local function hear(self, leaf, word, active)
  local key = leaf
  for i, condition in ipairs(self.conditions) do
    self.truth[i] = monitors.holds(condition, active)
    key = key .. (self.truth[i] and "+" or "-")
  end
  local known = self.known[word] or {}
  self.known[word] = known
  known[key] = known[key] or take_step(self, leaf, word)
  return known[key]
end

--- Hear the words of a step, or of a part of it.
---@param state string the FQN of the leaf; "first" in the beginning
---@param heard rfsm_checks.Heard[]
---@return string state "violated" if it has come into a leaf named `bad`
function Observer:next(state, heard)
  if state == "first" then state = self.first end
  for _, each in ipairs(heard) do
    if state == "violated" then break end
    state = hear(self, state, each.word, each.active)
  end
  return state
end

-- Patterns: charts of the words of properties ........................................

local IN_STEP, AT_END = { "pass", STEP }, { STEP }

-- Returns a transition for a thing: a condition, or an event.
local function go(src, tgt, thing, fields)
  local all = { src = src, tgt = tgt, events = thing.events, when = thing.when }
  for name, value in order.each(fields or {}) do all[name] = value end -- any order
  return rfsm.trans(all)
end

-- Returns a chart with a leaf `bad`, two more leaves, and some transitions.
local function chart_of(first, second, transitions)
  transitions[#transitions + 1] = rfsm.trans { src = "initial", tgt = first }
  transitions.bad, transitions[first] = rfsm.state {}, rfsm.state {}
  transitions[second] = rfsm.state {}
  return rfsm.state(transitions)
end

local patterns = {}

-- After an event, in a scope, something does not happen until something else does.
function patterns.never_until(property, thing)
  local ending = property.ending
  return chart_of("free", "held", {
    go("free", "held", thing(property.event), { when = property.scope }),
    go("held", "bad", thing(property.goal)),
    ending ~= nil and go("held", "free", thing(ending), { pn = 1 }) or nil })
end

-- The second thing does not happen before the first one: from the first entry on, and
-- again since each event.
function patterns.precedes(property, thing)
  local again = property.again
  return chart_of("none", "seen", {
    go("none", "seen", thing(property.what), { pn = 1 }),
    go("none", "bad", thing(property.goal)),
    again ~= nil and go("seen", "none", thing(again)) or nil })
end

-- A condition holds from the first entry on, unless something has happened.
function patterns.unless(property, thing)
  local condition = property.what
  return chart_of("bound", "free", {
    go("bound", "free", thing(property.ending), { pn = 1 }),
    go("bound", "bad", { events = AT_END, when = function(active)
      return not monitors.holds(condition, active)
    end }) })
end

-- The parts of a property that are conditions or events.
local THINGS = { "event", "what", "goal", "ending", "again", "scope" }

--- Does a property name an event, or does its chart?
---@param property any
---@param event any
---@return boolean
function observers.name(property, event)
  if type(property) ~= "table" then return false end
  local is_named = order.any(THINGS, function(field)
    return property[field] == event
  end)
  if rfsm.is_state(property.chart) then
    rfsm.mapfsm(function(tr)
      local events = type(tr.events) == "table" and tr.events or { tr.events }
      is_named = is_named or match.has(events, event)
    end, property.chart, rfsm.is_trans)
  end
  return is_named
end

--- Make the observer that judges a property; return nil if no observer does.
-- @raise if the property, or its chart, names what the machine does not have
---@param property rfsm_checks.Property
---@param audible rfsm_checks.Audible
---@return rfsm_checks.Observer?
function observers.of(property, audible)
  if property.chart then return observers.new(property.chart, audible) end
  local pattern = patterns[property.kind]
  if not pattern then return nil end
  local function word_of(thing)
    return rfsm.event_name(thing) or rfsm.name_with_data(thing) or thing
  end
  for _, field in ipairs(THINGS) do
    local thing = property[field]
    local problem = thing ~= nil and not observers.is_condition(thing, audible)
      and observers.problem_of(word_of(thing), audible)
    if problem then error(problem, 0) end
  end
  return observers.new(pattern(property, function(thing)
    local is_condition = observers.is_condition(thing, audible)
    return { events = is_condition and IN_STEP or { word_of(thing) },
      when = is_condition and thing or nil }
  end), audible)
end

return observers
