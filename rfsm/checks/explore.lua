--- Exploration: every configuration that a chart can reach, breadth first.
--
-- Each step is one `rfsm.step` of a puppet, which the engine runs. From a configuration
-- it is taken without events from outside, with each event that can have an effect, or
-- with each set of up to `options.together` of them, and with those sets that a path
-- through connectors needs; each time with every choice of the guards and doos asked.
--
-- A configuration is kept as its key, the number of the one it was first reached from,
-- and the label of that step. The steps are kept as numbers of configurations, those
-- without events from outside as negative ones.
--
-- @module rfsm.checks.explore
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local puppet = require "rfsm.checks.puppet"

local error, ipairs, rawequal, rawget = error, ipairs, rawequal, rawget
local require, setmetatable, tonumber, type = require, setmetatable, tonumber, type
local concat = table.concat
local os_clock = rawget(_G, "os") and rawget(_G, "os").clock

local explore = {}

--- Options of an exploration.
---@class rfsm_checks.Options
---@field together? integer how many events from outside a step may have (1)
---@field alphabet? any[] the events from outside; default: all that transitions name
---@field sends? table<string, any[]> what callbacks send: ["entry root.a"] = { "e_x" }
---@field flags? table<string, { on?: string[], off?: string[] }> set by callbacks
---@field properties? table<any, table> see `rfsm_checks.never` and others
---@field configurations? integer stop after so many (1,000,000)
---@field depth? integer stop after so many steps
---@field seconds? number stop after so long
---@field progress? fun(configurations: integer, depth: integer) called now and then

--- A walk over the configurations.
---@class rfsm_checks.Walk
---@field puppet rfsm_checks.Puppet
---@field keys (integer|string)[] of the configurations, the first one is not entered
---@field numbers table<integer|string, integer> key -> configuration
---@field from integer[] configuration -> the one it was first reached from
---@field labels string[] configuration -> events and choices of that step
---@field depths integer[]
---@field first integer[] configuration -> where its steps begin in `steps`
---@field steps integer[] targets; negative: without an event from outside
---@field taken table<integer, table> transition -> the first step that takes it
---@field clashes table<string, table> connector -> the first step with several ways on
---@field swallowed table<string, table> see `note_swallowed`
---@field moves table<integer, true> configurations that a step leaves or acts in
---@field expanded integer configurations whose steps were all taken
---@field endless table? the first step in which a machine inside never becomes idle
---@field bound string? what was hit
---@field count integer steps that were run
local Walk = {}
Walk.__index = Walk

-- Labels: "3,5:101", the numbers of the events and the choices ......................

local function label_of(walk, events, choices, asked)
  local numbers, digits = {}, {}
  for i, event in ipairs(events) do
    numbers[i] = walk.puppet:number_of_event(event)
  end
  for i = 1, asked do digits[i] = choices[i] and "1" or "0" end
  return concat(numbers, ",") .. ":" .. concat(digits)
end

--- Return the events and choices of a label.
---@param label string
---@return any[] events
---@return boolean[] choices
function Walk:read_label(label)
  local numbers, digits = label:match("^(.*):(.*)$")
  local events, choices = {}, {}
  for number in numbers:gmatch("%d+") do
    events[#events + 1] = self.puppet.event_list[tonumber(number)]
  end
  for digit in digits:gmatch("%d") do choices[#choices + 1] = digit == "1" end
  return events, choices
end

-- Configurations ....................................................................

-- Returns the number of a configuration; a new one is to be looked at later.
local function find_configuration(walk, key, from, label)
  local number = walk.numbers[key]
  if number then return number end
  number = #walk.keys + 1
  walk.keys[number], walk.numbers[key] = key, number
  walk.from[number], walk.labels[number] = from, label()
  walk.depths[number] = from > 0 and walk.depths[from] + 1 or 0
  return number
end

-- Steps .............................................................................

-- Notes what a step did that has not been seen before.
local function note(walk, from, label)
  local own = walk.puppet
  for _, number in ipairs(own.taken) do
    walk.taken[number] = walk.taken[number] or { from = from, label = label() }
  end
  for _, fqn in ipairs(own.clashes) do
    walk.clashes[fqn] = walk.clashes[fqn] or { from = from, label = label() }
  end
end

-- Appends where a step leads, once for each configuration.
local function add_step(walk, seen, from, tgt, is_internal)
  local step = is_internal and -tgt or tgt
  if seen[step] == from then return end
  seen[step] = from
  walk.steps[#walk.steps + 1] = step
end

local MANY_CHOICES = 4096

-- Takes a step with these events, once for each choice. Returns whether one of them
-- took a transition.
local function try_events(walk, from, numbers, events, seen)
  local own, choices, tries, has_taken = walk.puppet, {}, 0, false
  repeat
    own:put(numbers)
    local ended = own:step(events, choices)
    local asked = own.asked
    local text
    local function label()
      text = text or label_of(walk, events, choices, asked)
      return text
    end
    walk.count, tries = walk.count + 1, tries + 1
    has_taken = has_taken or own.taken[1] ~= nil
    note(walk, from, label)
    if ended then
      local tgt = find_configuration(walk, own:read(), from, label)
      add_step(walk, seen, from, tgt, events[1] == nil)
      if tgt ~= from or own.taken[1] then walk.moves[from] = true end
      walk:look(from, tgt, events, label)
    else
      walk.endless = walk.endless or { from = from, label = label() }
    end
    if tries == MANY_CHOICES then walk.bound = walk.bound or "choices" end
  until tries == MANY_CHOICES or not puppet.next_choices(choices, asked)
  return has_taken
end

-- Calls f(events) for each set of up to `left` of the events from number `first` on.
local function each_set(list, first, left, set, f)
  for i = first, #list do
    set[#set + 1] = list[i]
    f(set)
    if left > 1 then each_set(list, i + 1, left - 1, set, f) end
    set[#set] = nil
  end
end

local function copy_of(list)
  local copy = {}
  for i = 1, #list do copy[i] = list[i] end
  return copy
end

-- An event alone took no transition, though one that names it leads to a connector.
local function note_swallowed(walk, from, numbers, event)
  local stand = walk.puppet.parts[1].stands[numbers[1]]
  local node, fsm = stand.leaf, walk.puppet.parts[1].fsm
  while node do
    for _, tr in ipairs(node._otrs) do
      for _, other in ipairs(rfsm.is_conn(tr.tgt) and tr.events or {}) do
        local key = tr.tgt._fqn .. " " .. rfsm.text_of(event)
        if rawequal(other, event) and not walk.swallowed[key] then
          walk.swallowed[key] = { from = from, event = event, connector = tr.tgt._fqn,
            leaf = stand.leaf._fqn, label = label_of(walk, { event }, {}, 0) }
        end
      end
    end
    node = node ~= fsm and node._parent
  end
end

-- Takes all steps from a configuration.
local function expand(walk, from, numbers, seen)
  local own = walk.puppet
  own:numbers_of(walk.keys[from], numbers)
  walk.first[from] = #walk.steps + 1
  if own:is_busy(numbers) then try_events(walk, from, numbers, {}, seen) end
  local list, sets = own:events_in(numbers)
  walk:add_wanted(list)
  for i = 1, #sets do
    if #sets[i] > walk.together then try_events(walk, from, numbers, sets[i], seen) end
  end
  each_set(list, 1, walk.together, {}, function(events)
    local has_taken = try_events(walk, from, numbers, copy_of(events), seen)
    if not (has_taken or events[2] ~= nil) then
      note_swallowed(walk, from, numbers, events[1])
    end
  end)
end

-- Bounds ............................................................................

local EVERY = 256 -- configurations between two looks at the clock

local function find_bound(walk, options, at, began)
  if #walk.keys > (options.configurations or 1e6) then return "configurations" end
  if options.depth and walk.depths[at] >= options.depth then return "depth" end
  if options.seconds and at % EVERY == 0 and os_clock() - began > options.seconds then
    return "seconds"
  end
end

local function walk_all(walk, options)
  local at, numbers, seen, began = 1, {}, {}, os_clock and os_clock() or 0
  while walk.keys[at] do
    local bound = find_bound(walk, options, at, began)
    if bound then
      walk.bound = bound
      break
    end
    if options.progress and at % EVERY == 0 then
      options.progress(#walk.keys, walk.depths[at])
    end
    expand(walk, at, numbers, seen)
    at = at + 1
  end
  walk.expanded = at - 1
  walk.first[at] = #walk.steps + 1
end

-- Public functions ..................................................................

-- What is done with each step and event for properties is set by `properties.watch`.
function Walk.look() end

function Walk.add_wanted() end

local function check_options(options)
  for _, name in ipairs { "together", "configurations", "depth", "seconds" } do
    local value = options[name]
    if value ~= nil and (type(value) ~= "number" or value ~= value or value < 0) then
      error(("rfsm_checks.explore: %s: number expected, got %s"):format(name,
        type(value) == "number" and rfsm.text_of(value) or type(value)), 3)
    end
  end
end

--- Walk over the configurations of a model, without judging them.
---@param model rfsm.State
---@param options rfsm_checks.Options
---@param prepare? fun(walk: rfsm_checks.Walk) called before it begins
---@return rfsm_checks.Walk walk
function explore.walk(model, options, prepare)
  local own = puppet.new(model, options)
  local walk = setmetatable({ puppet = own, together = options.together or 1,
    keys = {}, numbers = {}, from = {}, labels = {}, depths = {}, first = {},
    steps = {}, taken = {}, clashes = {}, swallowed = {}, endless = nil, bound = nil,
    moves = {}, count = 0, expanded = 0 }, Walk)
  if prepare then prepare(walk) end
  find_configuration(walk, own:key_of(own:first()), 0, function() return "" end)
  walk_all(walk, options)
  return walk
end

--- Does an event wait in a configuration, so that run would go on?
---@param number integer
---@return boolean
function Walk:is_driven(number)
  return self.puppet:is_driven(self.puppet:numbers_of(self.keys[number], {}))
end

--- A step of a witness.
---@class rfsm_checks.WitnessStep
---@field events string[] from outside, as texts
---@field values any[] the events themselves
---@field choices { who: string, answer: boolean, is_doo: boolean }[] in order
---@field taken string[] paths of the transitions that it takes
---@field leaf string|false FQN of the active leaf then

-- Runs a step again; returns what it did.
local function rerun(walk, from, label)
  local own = walk.puppet
  local events, choices = walk:read_label(label)
  own:put(own:numbers_of(walk.keys[from], {}))
  own:step(events, choices)
  local step = { events = {}, values = events, choices = {}, taken = {} }
  for i, event in ipairs(events) do step.events[i] = rfsm.text_of(event) end
  for i = 1, own.asked do
    step.choices[i] = { who = own.askers[i], answer = own.choices[i],
      is_doo = own.is_doo[i] }
  end
  for i, number in ipairs(own.taken) do step.taken[i] = own.transitions[number].path end
  step.leaf = rfsm.get_actleaf_fqn(own.parts[1].fsm)
  return step
end

--- Return the shortest way to a configuration, and the step given behind it.
---@param number integer
---@param label? string
---@return rfsm_checks.WitnessStep[] witness
function Walk:witness(number, label)
  local labels, at = { label }, number
  while self.from[at] > 0 do
    table.insert(labels, 1, self.labels[at])
    at = self.from[at]
  end
  local steps, way = {}, { number }
  while self.from[way[1]] > 0 do table.insert(way, 1, self.from[way[1]]) end
  for i, text in ipairs(labels) do steps[i] = rerun(self, way[i], text) end
  return steps
end

--- Explore every configuration that a chart can reach.
--
-- Returns what was found: states that are never active, transitions that are never
-- taken, configurations that nothing leaves, cycles without an end, and properties
-- that do not hold, each with the shortest run that shows it.
--
-- @raise if the model is not valid, or an option is wrong
---@param model rfsm.State
---@param options? rfsm_checks.Options
---@return rfsm_checks.Exploration exploration
function explore.explore(model, options)
  options = options or {}
  if not rfsm.is_state(model) then
    error("rfsm_checks.explore: state expected, got " .. type(model), 2)
  end
  check_options(options)
  return require("rfsm.checks.verdict").of(model, options)
end

return explore
