--- Exploration: visits every configuration that a chart can reach, breadth first.
--
-- Each step is one `rfsm.step` of a subject, a machine with replaced callbacks. From
-- each configuration steps are taken without an event, with each event that may come
-- and can have an effect (or each set of up to `options.together` such events), and
-- with the larger sets that paths through connectors need. Each step is repeated for
-- every list of choices: the answers of guards and predicates, and whether a doo ends.
--
-- The walk stores for each configuration its key, the number of the configuration from
-- which it was first reached, and the label of that step. For each step it stores the
-- number of the configuration to which the step leads; the number is negative if the
-- step has no event from outside.
--
-- @module rfsm.explore.explore
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local data = require "rfsm.explore.data"
local opts = require "rfsm.shared.options"
local match = require "rfsm.shared.match"
local monitors = require "rfsm.explore.monitors"
local order = require "rfsm.shared.order"
local subject = require "rfsm.explore.subject"
local reactions = require "rfsm.explore.reactions"
local replacements = require "rfsm.explore.replacements"
local timing = require "rfsm.explore.timing"
local zones = require "rfsm.explore.zones"

local error, getmetatable, ipairs = error, getmetatable, ipairs
local math, rawget = math, rawget
local setmetatable, tonumber, type = setmetatable, tonumber, type
local concat, huge = table.concat, math.huge
local os = rawget(_G, "os") or {}

local explore = {}

local NOTHING = {}

--- Options of an exploration.
---@class rfsm_checks.Options
---@field together? integer most events of one step (1; 2 if a property is an `after`,
-- and the machine takes all events at once)
---@field alphabet? any[] events from outside; default: all events that transitions name
---@field sends? table<string, any[]> what callbacks send: ["entry root.a"] = { "e_x" };
-- { "e_x", after = 2 } is sent 2 s later, { cancel = "e_x" } cancels such an event
---@field pending? integer most events that wait to be sent later (4)
---@field deferred? integer most events that states defer at a time (4): a premise
---@field dry_run? boolean call entries, exits and effects once, to note what they send
---@field classes? table<string, table[]> name of an event with data -> the examples of
-- its data that come: { e_reading = { { celsius = 20 }, { celsius = 90 } } }
---@field flags? table<string, { on?: any[], off?: any[] }> name of a flag -> the
-- callbacks and events that set it (`on`), and those that clear it (`off`)
---@field vars? table<string, any> fields that callbacks in `run` read and set
---@field run? (function|string)[] callbacks that are called: "effect root.trans[2]"
---@field exclusive? any[] guards, or lists of guards: in a step at most one is true
---@field complementary? any[] guards, or lists of guards: exactly one is true
---@field same? any[] guards, or lists of guards: all give one answer throughout a step
---@field timers? "in order"|"free" "free": time events may come at any time
---@field period? number seconds, the longest time between two steps
---@field properties? table<any, table> results of `rfsm_checks.never` and others
---@field configurations? integer stop after so many configurations (1,000,000)
---@field depth? integer stop after so many steps from the start
---@field seconds? number stop after so many seconds
---@field multiply? boolean explore independent regions together, not one by one
---@field progress? fun(configurations: integer, depth: integer) called now and then

--- A walk over the configurations.
---@class rfsm_checks.Walk
---@field subject rfsm_checks.Subject
---@field model rfsm.State
---@field options rfsm_checks.Options
---@field way rfsm_checks.Way the parts of the machine that are explored; false: all
---@field keys string[] of the configurations; in the first one no state is active
---@field numbers table<string, integer> key -> configuration
---@field from integer[] configuration -> the one from which it was first reached
---@field labels string[] configuration -> label of the step that first reached it
---@field depth integer how many steps lead to the configurations expanded now
---@field level_end integer the last configuration of this depth
---@field first integer[] configuration -> the position of its first step in `steps`
---@field steps integer[] target of each step; negative: without event from outside
---@field taken table<integer, table> transition -> the first step that takes it
---@field stuck integer[] configurations whose steps stay there and take no transition
---@field has_moved boolean the configuration expanded now is not known to be stuck: a
-- step leaves it or takes a transition, or some step was not tried
---@field expanded integer number of configurations from which all steps were taken
---@field is_limited boolean a step was left out since too many events are deferred
---@field endless table? the first step in which a region never becomes idle
---@field bound string? the name of the first bound that was hit
---@field untried string[] texts that say what was not tried
---@field passed rfsm_checks.Passed[] states that steps enter and leave again
---@field count integer how many steps were run
---@field is_late boolean the time of the options is over, so no more steps are taken
---@field wanted any[] events that properties look at
---@field monitors rfsm_checks.Judged[] the properties whose monitors see each step
---@field has_ended boolean nothing is looked for any more
---@field ended_by string? the bound at which it ended with configurations left
---@field contexts rfsm_checks.Context[]
---@field named table<string, rfsm_checks.Context> the contexts by a text
---@field zones table<integer, number[]> configuration -> the values of its clocks
---@field wider table<integer, integer> configuration that is not expanded -> a later
-- one that differs only in times, and whose zone of times includes its zone
---@field unsure table<integer, integer> position of a step in `steps` -> number of the
-- group of deadlines that are over before the step, if another group may be over first
---@field ways table<integer, number> configuration with such a step -> how many groups
-- may be over first
---@field cut table<integer, boolean> configurations from which a step without events
-- from outside was not tried, or its target is not explored
---@field try rfsm_checks.Try the step that is taken now
---@field label fun(): string the label of that step
---@field timing rfsm_checks.Timing|false clocks, if timers come in order
local Walk = {}
Walk.__index = Walk

--- What a configuration has beside the machines, if the walk has monitors or clocks.
--- Configurations that differ only in the values of clocks have the same context.
---@class rfsm_checks.Context
---@field number integer its number in keys
---@field states string[] the states of the monitors
---@field entries? rfsm_checks.Entry[] the clocks that run
---@field numbers integer[] configurations, without those that a wider one includes

--- A step that enters a state and leaves it again, and the moment of that entry.
---@class rfsm_checks.Passed
---@field moment rfsm_checks.Moment
---@field from integer the configuration in which the step begins
---@field tgt integer the configuration in which it ends
---@field label string label of the step

-- Configurations and labels of steps ................................................

-- Splits a key into the number of its context, which may be nil, and the subject's key.
local function split(key)
  local id, own = key:match("^(%d+)[^|=]*|(.*)$")
  return tonumber(id), own or key
end

--- Return a configuration by its number.
---@param number integer
---@return rfsm_checks.Configuration conf
function Walk:configuration(number)
  local id, key = split(self.keys[number])
  local conf = self.subject:configuration(key)
  conf.context, conf.zone = self.contexts[id], self.zones[number]
  return conf
end

-- Returns the context of the states of monitors, and of the clocks that run.
local function find_context(walk, key, states, entries)
  local name = concat(states, "\n")
  if entries then name = ("%s@%s|%s"):format(name, timing.text_of(entries), key) end
  local context = walk.named[name]
  if not context then
    context = { number = #walk.contexts + 1, states = states, entries = entries,
      numbers = {} }
    walk.named[name], walk.contexts[context.number] = context, context
  end
  return context
end

-- Returns the key of a configuration: the number of its context, the values of clocks,
-- and the key of the subject. If a known one differs only in these values, and includes
-- them, it is the key of that one.
local function key_of(walk, key, states, entries, zone)
  if not (walk.monitors[1] or walk.timing) then return key end
  local context = find_context(walk, key, states, entries)
  local own = context.number .. (zone and "@" .. concat(zone, ",") or "") .. "|" .. key
  if not zone or walk.numbers[own] then return own end
  for _, number in ipairs(context.numbers) do
    if zones.includes(walk.zones[number], zone) then return walk.keys[number] end
  end
  walk.zones[#walk.keys + 1] = zone
  return own
end

--- Is the machine entered in some configuration of the walk?
---@return boolean
function Walk:is_entered()
  return order.any(self.subject.parts[1].positions, function(at) return at.leaf end)
end

-- Returns the configuration that is expanded in place of another one, or itself.
local function widest(walk, number)
  while walk.wider[number] do number = walk.wider[number] end
  return number
end

--- Return the number of the known configuration with a key, or of the one that is
--- expanded in its place; nil if there is none.
function Walk:find_known(key)
  local known = self.numbers[key]
  return known and widest(self, known)
end

-- Adds a configuration to those of its context. Those whose zones it includes leave it.
-- Those of its depth are not expanded: it can do what they can in as many steps.
local function add_zone(walk, numbers, number)
  local zone, count = walk.zones[number], 0
  for i = 1, #numbers do
    local old = numbers[i]
    numbers[i] = nil
    if not zones.includes(zone, walk.zones[old]) then
      count = count + 1
      numbers[count] = old
    elseif old > walk.level_end then
      walk.wider[old] = number
    end
  end
  numbers[count + 1] = number
end

-- Has all steps lead to configurations that are expanded.
local function redirect(walk)
  local steps = walk.steps
  for at = 1, not order.is_empty(walk.wider) and #steps or 0 do
    local step = steps[at]
    steps[at] = step < 0 and -widest(walk, -step) or widest(walk, step)
  end
end

--- Return the number of a configuration to which a step from `from` has led. A new
--- configuration is added; it is expanded later.
function Walk:find_configuration(key, from, label)
  local number = self:find_known(key)
  if number then return number end
  number = #self.keys + 1
  if self.timing then add_zone(self, self.contexts[split(key)].numbers, number) end
  self.keys[number], self.numbers[key] = key, number
  self.from[number], self.labels[number] = from, label()
  return number
end

-- Returns the label of a step, such as "3,5:101@2": the numbers of its events (3, 5),
-- its choices (101), and the number of the group of deadlines that were over (2).
local function label_of(try, choices, asked)
  local numbers, digits = {}, {}
  for i, event in ipairs(try.events) do numbers[i] = event.number end
  for i = 1, asked do digits[i] = choices[i] and "1" or "0" end
  return concat(numbers, ",") .. ":" .. concat(digits)
    .. (try.group and "@" .. try.group.number or "")
end

local function read_label(walk, label)
  local numbers, digits, group = label:match("^([%d,]*):(%d*)@?(%d*)$")
  local events, choices = {}, {}
  for number in numbers:gmatch("%d+") do
    events[#events + 1] = walk.subject.occurrences[tonumber(number)]
  end
  for digit in digits:gmatch("%d") do choices[#choices + 1] = digit == "1" end
  return events, choices, tonumber(group)
end

-- Steps .............................................................................

--- Note that something was not tried, so that a property is not proved if no violation
--- is found.
function Walk:note_untried(bound, text)
  self.bound = self.bound or bound
  if not match.has(self.untried, text) then
    self.untried[#self.untried + 1] = text
  end
end

explore.note_untried = Walk.note_untried

-- Notes that a step was not tried, or its target is not explored: so nobody knows that
-- nothing happens in the configuration. Without a bound, that is a premise.
local function note_cut(walk, try, bound, text)
  walk.has_moved = true
  walk.cut[try.from] = walk.cut[try.from] or not try.is_from_outside
  if bound then walk:note_untried(bound, text) end
end

-- Notes the states that a step has entered and left again.
local function note_passed(walk, from, tgt, label)
  for _, moment in ipairs(walk.subject.passed) do
    local key = concat({ concat(rfsm.sorted_keys(moment.active), " "), moment.flags,
      from, tgt }, "|")
    if not walk.passed[key] then
      walk.passed[key] = true
      walk.passed[#walk.passed + 1] = { moment = moment, from = from, tgt = tgt,
        label = label() }
    end
  end
end

-- May a step that stays in its configuration be taken again and again? It may if an
-- event waits, or if the machine goes on without events and no doo ends at some time.
local function may_repeat(walk, try)
  return subject.is_driven(try.conf) or try.is_internal and walk.subject:may_rest()
end

-- Appends the target of a step, unless the configuration in which it begins has another
-- step to this target with the same `unsure` deadlines.
local function add_step(walk, try, tgt)
  if tgt == try.from and not may_repeat(walk, try) then return end
  local step, unsure = try.is_internal and -tgt or tgt, walk.unsure
  local group = try.group and not try.group.is_sure and try.group.number or nil
  if group then walk.ways[try.from] = try.group.ways end
  local steps, count = walk.steps, #walk.steps
  for at = walk.first[try.from], count do
    if steps[at] == step and unsure[at] == group then return end
  end
  steps[count + 1], unsure[count + 1] = step, group
end

--- A step that is tried: its events, and the deadlines that are over when it begins.
--- One table serves all steps that begin in a configuration with the same deadlines.
---@class rfsm_checks.Try
---@field from integer number of the configuration in which the step begins
---@field conf rfsm_checks.Configuration
---@field events rfsm_checks.Occurrence[] the time events are the last ones
---@field is_internal boolean the step has no event from outside and no deadline
---@field is_from_outside boolean the step has an event from outside
---@field group rfsm_checks.Group|false the deadlines; false if the walk has no clocks
---@field f fun(walk: rfsm_checks.Walk, try: rfsm_checks.Try, key: string|nil,
-- label: fun()) called after the step; `key` is nil if the step never ends

-- Returns two results: the key of the configuration to which the last step has led (nil
-- if it is not explored), and for each clock there the number that it had before.
local function key_after(walk, try, label)
  local own, most = walk.subject, walk.options.deferred
  local context, key, problem = try.conf.context, own:read()
  local states, entries, zone, clocks, sources = NOTHING, false, nil, nil, nil
  if context then states, clocks = monitors.after(walk, try, key, label) end
  if walk.timing then
    entries, sources, zone = walk.timing:after(try, walk, clocks)
  end
  if own:may_come_twice() then
    walk:note_untried("timers", "a time event that comes again while it waits")
  end
  if entries == nil then
    note_cut(walk, try, "pending", ("more than %d events that wait to be sent later")
      :format(walk.options.pending))
  elseif problem then
    note_cut(walk, try, "values", problem)
  elseif own.deferred > most then -- if all come from outside, a premise is that not
    walk.is_limited = true
    note_cut(walk, try, own.has_senders and "deferred",
      ("more than %d deferred events"):format(most))
  else
    return key_of(walk, key, states, entries, zone), sources
  end
  return nil, sources
end

-- Returns the seconds of processor time; 0 on a host without a clock.
local function now() return os.clock and os.clock() or 0 end

local EVERY = 8 -- steps between two looks at the clock

-- Calls the function `f` of the try after a step, unless its target is not explored.
-- Returns true if the time of the walk is over.
local function after_choice(walk, has_ended)
  local try, label = walk.try, walk.label
  walk.count = walk.count + 1
  local key = has_ended and key_after(walk, try, label)
  if key or not has_ended then try.f(walk, try, key, label) end
  walk.is_late = walk.is_late or walk.count % EVERY == 0 and now() > walk.options.ends
  return walk.is_late
end

-- Do two configurations differ only in flags, which events have switched?
local function differ_in_flags(walk, one, other)
  if order.is_empty(walk.subject.flags_of_event) then return false end
  local _, key = split(walk.keys[one])
  local _, other_key = split(walk.keys[other])
  return key:gsub("[+-]+", "", 1) == other_key:gsub("[+-]+", "", 1)
end

-- Notes the outcome of a step in the walk.
local function note_step(walk, try, key, label)
  local from = try.from
  for _, number in ipairs(walk.subject.taken) do
    walk.taken[number] = walk.taken[number] or { from = from, label = label() }
  end
  if not key then
    walk.endless = walk.endless or { from = from, label = label() }
    walk.has_moved = true
    return
  end
  local tgt = walk:find_configuration(key, from, label)
  add_step(walk, try, tgt)
  walk.has_moved = walk.has_moved or walk.subject.taken[1] ~= nil
    or tgt ~= from and not differ_in_flags(walk, from, tgt)
  note_passed(walk, from, tgt, label)
  walk:look(from, tgt, try.events, label)
end

-- Lists the sets of up to `most` events of a list, smaller sets first, as long as there
-- is time; if the machine takes one event an iteration, each set in every order.
local function sets_of(walk, list, most)
  local sets, last, at = { {} }, { 0 }, 1
  local is_one = walk.subject.parts[1].reads_one
  while sets[at] and #sets[at] < most and not walk.is_late do
    for i = last[at] + 1, #list do
      local set = at == 1 and list[i].alone or match.with(sets[at], list[i])
      sets[#sets + 1], last[#sets + 1] = set, is_one and 0 or i
    end
    walk.is_late = at % EVERY == 0 and now() > walk.options.ends
    at = at + 1
  end
  return sets
end

local BEHIND = "what lies behind the bound on "

-- Takes the steps with the events of a try: one step for each list of choices. If some
-- are not taken, notes it.
local function each_list(walk, try)
  walk.try = try
  local untried = not walk.is_late
    and walk.subject:each_choice(try.conf, try.events, walk, after_choice)
  if walk.is_late then
    note_cut(walk, try, "seconds", BEHIND .. "seconds")
  elseif untried then
    note_cut(walk, try, "choices", untried)
  end
end

-- Takes the steps that begin when the deadlines of a group are over: those with each
-- set of events from outside.
local function each_set(walk, from, conf, group, sets, f)
  local timers, is_over = group and group.events or {}, group and group.is_over
  local try = { from = from, conf = conf, group = group, events = false,
    is_internal = false, is_from_outside = false, f = f }
  for _, set in ipairs(sets) do
    if set[1] ~= nil or is_over or subject.may_act(conf) then
      try.events, try.is_from_outside = match.joined(set, timers), set[1] ~= nil
      try.is_internal = set[1] == nil and not is_over
      each_list(walk, try)
    end
  end
end

local NO_GROUP = { false }

-- Lists the groups of deadlines that may be over when a step begins.
local function groups_of(walk, from, conf)
  if not walk.timing then return NO_GROUP end
  local groups = walk.timing:groups(conf, subject.is_driven(conf))
  if walk.timing.is_cut then
    note_cut(walk, { from = from }, "sets", "some orders of deadlines")
  end
  return groups
end

-- Adds the events of properties to a list, except those that the machine itself makes.
local function add_wanted(own, wanted, list)
  for _, event in ipairs(wanted) do
    local occurrence = own:occurrence(own.parts[1], event)
    if not (own:maker_of(event) or match.has(list, occurrence)) then
      list[#list + 1] = occurrence
    end
  end
end

-- Lists the events of a list that may come while others wait: time events, and what a
-- callback has made in a step before. If that waits, the machine has `read` none.
local function made_events(list, has_read)
  local own = {}
  for _, occurrence in ipairs(list) do
    local may_come = occurrence.state or occurrence.is_first and not has_read
    if may_come then own[#own + 1] = occurrence end
  end
  return own
end

-- Lists the sets of events from outside with which steps are taken: those of up to
-- `walk.together` events, and the larger ones that paths through connectors need. A
-- machine that takes one event an iteration gets only what it makes itself while one
-- waits, or if it has `read` one. It takes such paths with no set, and of several
-- events the later ones in another leaf.
local function sets_from_outside(walk, conf, list, needed, read)
  local own, is_one = walk.subject, walk.subject.parts[1].reads_one
  if is_one and (read[1] ~= nil or subject.is_driven(conf)) then
    return sets_of(walk, made_events(list, read[1] ~= nil), walk.together)
  end
  if is_one and walk.together > 1 then
    add_wanted(own, own.alphabet or own.event_list, list)
  end
  local sets = sets_of(walk, list, walk.together)
  for _, set in ipairs(is_one and {} or needed) do
    if #set > walk.together then sets[#sets + 1] = set end
  end
  return sets
end

-- Takes a step from a configuration for each set of events and each group of deadlines.
-- Each step gets the events `read` before its own events.
local function each_try(walk, from, f, read)
  local conf = walk:configuration(from)
  local list, needed, is_cut = reactions.that_may_come(walk.subject, conf)
  if is_cut then
    note_cut(walk, { from = from, is_from_outside = true }, "sets",
      ("some sets of events that paths from %s need"):format(conf[1].leaf
      and conf[1].leaf._fqn or "root.initial"))
  end
  add_wanted(walk.subject, walk.wanted, list)
  local sets = sets_from_outside(walk, conf, list, needed, read)
  for i, set in ipairs(read[1] ~= nil and sets or {}) do
    sets[i] = match.joined(read, set)
  end
  for _, group in ipairs(groups_of(walk, from, conf)) do
    each_set(walk, from, conf, group, sets, f)
  end
end

-- Takes all steps from a configuration. If a wider one is known, a single step leads to
-- that one.
function Walk.expand(walk, from)
  walk.first[from], walk.has_moved = #walk.steps + 1, false
  if walk.wider[from] then
    walk.steps[#walk.steps + 1] = -walk.wider[from]
    return
  end
  each_try(walk, from, note_step, {})
  if not walk.has_moved then walk.stuck[#walk.stuck + 1] = from end
end

--- Take all steps from a configuration, and call f(walk, try, key, label) after each.
---@param from integer
---@param f function see the field `f` of `rfsm_checks.Try`
---@param read? rfsm_checks.Occurrence[] events that come first in each step
function Walk:each_step(from, f, read)
  each_try(self, from, f, read or {})
  data.rest(self.subject)
end

-- Bounds ............................................................................

local EVERY_REPORT = 256 -- configurations between two calls of `progress`

local MANY_STEPS = 100 -- most steps for each configuration that the options allow

local STEPS = "more than %d steps, since some have very many choices"

--- Return how many steps were run.
function Walk:steps_run() return self.count end

-- Returns the name of a bound that was hit, and a text that says what was not tried.
local function find_bound(walk, options)
  local most = MANY_STEPS * options.configurations
  local bound = #walk.keys > options.configurations and "configurations"
    or walk.depth >= options.depth and "depth" or now() > options.ends and "seconds"
  if bound then return bound, BEHIND .. bound end
  if walk:steps_run() > most then return "choices", STEPS:format(most) end
end

--- Have a walk, or a product of machines, take all steps from each configuration.
function explore.walk_all(walk, options)
  local at = 1
  while walk.keys[at] and not walk.has_ended do
    if at > walk.level_end then
      walk.depth, walk.level_end = walk.depth + 1, #walk.keys
    end
    local bound, text = find_bound(walk, options)
    if bound then
      walk.ended_by = bound
      walk:note_untried(bound, text)
      break
    end
    if options.progress and at % EVERY_REPORT == 0 then
      options.progress(#walk.keys, walk.depth)
    end
    walk:expand(at)
    at = at + 1
  end
  walk.expanded = at - 1
  walk.first[at] = #walk.steps + 1
end

-- Public functions ..................................................................

-- Called after each step; `properties.watch` and tests replace it in a walk.
function Walk.look() end

local function is_number(x) return type(x) == "number" and x >= 0 end

local is_boolean = opts.is_a "boolean"

local function is_period(x) return opts.is_seconds(x) and x > 0 end

local TIMERS = { free = true, ["in order"] = true }

local function is_order(x)
  if TIMERS[x] then return true end
  return false, type(x) == "string" and ("'free' or 'in order' expected, got '%s'%s")
    :format(x, advice.nearest_name(x, rfsm.sorted_keys(TIMERS))) or nil
end

-- Returns the problem of the examples of an event.
local function problem_of_examples(name, list)
  if type(name) ~= "string" then
    return "name of an event expected, " .. opts.got(name)
  elseif type(list) ~= "table" or list[1] == nil then
    return name .. ": list of tables with data expected, such as { { x = 1 } }"
  end
  for i, example in ipairs(list) do
    if type(example) ~= "table" or getmetatable(example) then
      return ("%s[%d]: table with data expected, %s"):format(name, i, opts.got(example))
    elseif example.name ~= nil and example.name ~= name then
      return ("%s[%d]: an event of this name expected, got one of the name '%s'")
        :format(name, i, rfsm.text_of(example.name))
    end
  end
end

local KNOWN = {
  together = opts.whole(),
  configurations = opts.whole(1, nil, 1e6),
  depth = { "number", is_number, huge },
  seconds = { "number", is_number, huge },
  alphabet = { "list", opts.is_list },
  sends = { "table of lists", replacements.check_sends, {} },
  pending = opts.whole(1, nil, 4),
  deferred = opts.whole(1, nil, 4),
  dry_run = { "boolean", is_boolean, false },
  multiply = { "boolean", is_boolean, false },
  classes = { "table of lists", opts.each_field(problem_of_examples) },
  flags = { "table of flags", replacements.check_flags, {} },
  vars = { "table of ranges", data.check_vars },
  run = { "list of callbacks", data.check_functions },
  exclusive = { "list of guards", data.check_groups },
  complementary = { "list of guards", data.check_groups },
  same = { "list of guards", data.check_groups },
  timers = { "'free' or 'in order'", is_order, "in order" },
  period = { "seconds above 0", is_period },
  properties = { "table", opts.is_a "table", {} },
  progress = { "function", rfsm.is_callable },
}

-- Notes the events that a region may make itself between two of its steps, if a step of
-- the machine around it advances it more than once. Time does not pass meanwhile.
local function note_between(walk)
  for _, entry in ipairs(walk.subject.transitions) do
    for _, event in ipairs(entry.part.is_single and {} or entry.tr.events or {}) do
      local maker, fqn = match.maker_of(event)
      if fqn and maker ~= "timer" then
        walk:note_untried("order", ("'%s' between two steps of %s"):format(
          rfsm.event_text(event), entry.part.prefix))
      end
    end
  end
end

-- Notes that callbacks may do what the exploration does not follow: write targets and
-- data, and send events later or cancel them though the options do not name these.
local function note_gaps(walk)
  local own = walk.subject
  local count, first = #own.unknown, own.unknown[1]
  if first then
    walk:note_untried("texts", ("what the %s does, which no text shows%s"):format(
      first, count > 1 and (", and %d more callbacks"):format(count - 1) or ""))
  end
  local function add(names, bound, text)
    for _, name in ipairs(names) do walk:note_untried(bound, text:format(name)) end
  end
  add(own.writers, "targets", "transitions that the %s may change or add")
  add(own.data_writers, "values", "data that the %s may write, which is not run")
  add(own.unsure_senders, "sends", "events that the %s may send, which "
    .. (own.alphabet and not walk.options.dry_run and "sends does not name"
      or "a dry run does not show"))
  add(own.late_senders, "pending", "events that the %s may send later")
  add(own.later[1] and own.cancellers or {}, "pending",
    "events that the %s may cancel")
end

--- Return the options of the given names; missing options get their defaults. If the
--- value of an option is wrong or its name is not known, return nil and the problem.
--- The field `ends` is the time of the clock at which the seconds are over, for all
--- explorations with these options together.
---@param options table
---@param names string[]
---@param more? table<string, any[]> further options, described as in `KNOWN`
function explore.settings(options, names, more)
  local known = more or {}
  for _, name in ipairs(names) do known[name] = KNOWN[name] end
  local settings, problem = opts.read(known, options)
  if settings then settings.ends = now() + (settings.seconds or huge) end
  return settings, problem
end

--- Make a walk over the configurations of a model. The walk has no configuration yet.
---@param model rfsm.State
---@param options rfsm_checks.Options
---@param way? rfsm_checks.Way the parts of the machine to explore; nil: all
---@return rfsm_checks.Walk walk
function explore.new(model, options, way)
  local settings = { ends = options.ends or now() + (options.seconds or huge) }
  for name, option in order.each(KNOWN) do -- any order: a copy
    settings[name] = options[name]
    if settings[name] == nil then settings[name] = option[3] end
  end
  local own = subject.new(model, settings, way)
  local walk = setmetatable({ subject = own, model = model, options = settings,
    way = way or false, together = settings.together or 1,
    untried = {}, passed = {},
    keys = {}, numbers = {}, from = {}, labels = {}, depth = 0, level_end = 1,
    first = {}, steps = {}, taken = {}, endless = nil,
    bound = nil, stuck = {}, has_moved = false,
    is_limited = false, count = 0, expanded = 0, wanted = {},
    is_late = false,
    monitors = {}, has_ended = false, contexts = {}, named = {}, zones = {}, wider = {},
    unsure = {}, ways = {}, cut = {}, timing = false }, Walk)
  for _, event in ipairs(rfsm.sorted_keys(own.flags_of_event)) do
    walk:want(own:event_meant(event))
  end
  function walk.label() return label_of(walk.try, own.choices, own.asked) end
  return walk
end

--- Have a walk try two events in a step, unless the machine takes them one by one: then
--- one event after the other is the same.
function Walk:take_two()
  if not (self.options.together or self.subject.parts[1].reads_one) then
    self.together = 2
  end
end

--- Have a walk try an event from each configuration, also one that nothing takes.
---@param event any
---@param is_certain? boolean also if the alphabet has no such event
function Walk:want(event, is_certain)
  local own = self.subject
  own.wanted[event] = false
  for _, each in ipairs(own:examples_of(event)) do
    local is_allowed = is_certain or not own.alphabet or match.has(own.alphabet, each)
    if is_allowed then self.wanted[#self.wanted + 1] = each end
    own.wanted[each] = false
  end
end

--- Have a walk begin with the configuration that its subject is in.
function Walk:begin()
  note_gaps(self)
  note_between(self)
  local states = {}
  for i = 1, #self.monitors do states[i] = "first" end
  local key = key_of(self, self.subject:read(), states, self.timing and {},
    self.timing and zones.new())
  self:find_configuration(key, 0, function() return "" end)
end

--- Walk over the configurations of a model, without judging them.
---@param model rfsm.State
---@param options rfsm_checks.Options
---@param prepare? fun(walk: rfsm_checks.Walk) called before the walk begins
---@param way? rfsm_checks.Way the parts of the machine to explore; nil: all
---@return rfsm_checks.Walk walk
function explore.walk(model, options, prepare, way)
  local walk = explore.new(model, options, way)
  if prepare then prepare(walk) end
  walk.timing = timing.new(walk, walk.options)
  walk:begin()
  if walk.timing and walk.timing.is_inexact then
    walk:note_untried("sets", "the order of times with more than 15 digits")
  end
  explore.walk_all(walk, walk.options)
  redirect(walk)
  data.rest(walk.subject)
  return walk
end

--- A step of a witness.
---@class rfsm_checks.WitnessStep
---@field events string[] all events that came, as texts
---@field values any[] the events that are sent to the machine itself
---@field inside { prefix: string, event: any }[] time events that are sent to regions
---@field sent { prefix: string, event: any }[] events that replacements sent
---@field at? number seconds since the first step, if timers come in order
---@field choices { who: string, answer: boolean, is_doo: boolean }[] the answers of
-- guards and predicates and the ends of doos, in the order in which they were asked
---@field taken string[] paths of the transitions that the step takes
---@field leaf string|false FQN of the active leaf after the step
---@field unfollowed false|"data"|"targets" see the fields of `rfsm_checks.Subject`
---@field sends_late boolean
---@field ran false|"before"|"after"

local function text_of_event(occurrence)
  local part, event = occurrence.part, occurrence.event
  local text = rfsm.event_text(event, occurrence.has_data)
  if occurrence.after then
    text = ("after %s s: %s"):format(rfsm.number_text(occurrence.after, "%.9g"), text)
  end
  return part.owner and text .. " in " .. part.prefix or text
end

--- Copy the outcome of the subject's last step into the step of a witness.
function explore.note_outcome(own, step)
  step.choices = {}
  for i = 1, own.asked do
    step.choices[i] = { who = own.askers[i], answer = own.choices[i],
      is_doo = own.is_doo[i] }
  end
  step.taken, step.leaf = own:paths_of(), rfsm.get_actleaf_fqn(own.parts[1].fsm)
  step.sent = match.joined({}, own.sent)
  step.unfollowed, step.ran = own.unfollowed, own.ran
  step.sends_late = own.sends_late
end

--- May a run leave out an event that a callback sends later, which is not followed? It
--- may if time passes after the callback, or if the run then waits for ever.
---@param steps rfsm_checks.WitnessStep[]
---@param waits any the run rests at its end, or is a cycle
---@return boolean
function explore.may_miss(steps, waits)
  local sent
  local is_missed = order.any(steps, function(step)
    local is_later = sent and (step.at or 0) > sent
    sent = sent or step.sends_late and (step.at or 0)
    return is_later
  end)
  return is_missed or waits and sent and true or false
end

--- Is it doubtful that a machine can follow a run? It is if a step calls a callback in
--- `run`, or takes a transition, after a callback may have changed data or targets that
--- are not followed.
---@param steps { unfollowed: any, ran: any, taken: string[], machine: string? }[]
---@param goes_on? any callbacks in `run` decide what happens after the run, too
---@return boolean
function explore.is_doubtful(steps, goes_on)
  local changed = {} -- by machine
  local is_doubtful = order.any(steps, function(step)
    local name = step.machine or ""
    local before = changed[name]
    changed[name] = step.unfollowed == "targets" and "targets" or before
      or step.unfollowed or nil
    return step.ran == "after" or before and step.ran
      or before == "targets" and step.taken[1] ~= nil
  end)
  return is_doubtful or goes_on and not order.is_empty(changed) or false
end

-- Returns a step of a witness with its events. `values` and `inside` leave out the time
-- events whose order is known: a replay advances the clock to the time `at` instead.
local function new_step(events)
  local step = { events = {}, values = {}, inside = {} }
  for i, occurrence in ipairs(events) do
    local part, event = occurrence.part, occurrence.event
    step.events[i] = text_of_event(occurrence)
    local comes_alone = part.timed[event]
    if part.owner and not comes_alone then
      step.inside[#step.inside + 1] = { prefix = part.prefix, event = event }
    elseif not comes_alone then
      step.values[#step.values + 1] = event
    end
  end
  return step
end

-- Repeats a step on a subject with all regions, after a walk that has left out some. In
-- the regions that were left out guards are false and doos go on.
local function repeat_on(own, events, step)
  local at, choices, list = 0, step.choices, {}
  function own:choose(who, is_doo)
    local choice = choices[at + 1]
    local is_same = choice ~= nil and choice.who == who
    if is_same then at = at + 1 end
    return getmetatable(own).choose(self, who, is_doo, is_same and choice.answer)
  end
  for i, occurrence in ipairs(events) do
    list[i] = own:occurrence(own.part_of[occurrence.part.prefix], occurrence.event)
  end
  data.put(own, own.last_values or own.first_values)
  own:step(list, {})
  own.last_values = data.read(own)
  explore.note_outcome(own, step)
end

--- Run a step of the walk again.
---@param from integer the configuration in which the step begins
---@param label string the label of the step
---@param whole? rfsm_checks.Subject with all regions, if the walk has left out some: it
-- takes the step, too, and its outcome is returned
---@return rfsm_checks.WitnessStep step
---@return rfsm_checks.Try|false try false if the walk has no clocks
function Walk:rerun(from, label, whole)
  local events, choices, number = read_label(self, label)
  local conf, step = self:configuration(from), new_step(events)
  self.subject:put(conf)
  self.subject:step(events, choices)
  explore.note_outcome(self.subject, step)
  if whole then repeat_on(whole, events, step) end
  return step, self.timing and { from = from, conf = conf, events = events,
    group = groups_of(self, from, conf)[number] }
end

--- List the steps of the shortest run to a configuration, then the step from there that
--- has the given label.
---@return { from: integer, label: string }[] way
function explore.way_to(walk, number, label)
  local way = { label and { from = number, label = label } }
  while walk.from[number] > 0 do
    table.insert(way, 1, { from = walk.from[number], label = walk.labels[number] })
    number = walk.from[number]
  end
  return way
end

--- Return the shortest run to a configuration, then a further step, or a cycle.
---@param number integer the configuration
---@param label? string label of the further step
---@param cycle? rfsm_checks.Edge[]
---@return rfsm_checks.WitnessStep[] witness its field `again`: where the cycle begins
function Walk:witness(number, label, cycle)
  local way, steps = explore.way_to(self, number, label), {}
  steps.again = cycle and #way + 1
  way = match.joined(way, cycle or {})
  local timed = {} -- the argument of `Timing:times_of`
  local whole = self.way and subject.new(self.model, self.options)
  for i, step in ipairs(way) do
    local try
    steps[i], try = self:rerun(step.from, step.label, whole)
    if try then
      local _, sources = key_after(self, try, function() return step.label end)
      timed[i] = { group = try.group, sources = sources }
    end
  end
  local times = self.timing and self.timing:times_of(timed) or {}
  for i, step in ipairs(steps) do step.at = times[i] end
  data.rest(self.subject)
  return steps
end

--- Explore every configuration that a chart can reach.
--
-- The result has the findings: states that are never active, transitions that are never
-- taken, configurations that no step leaves, cycles without an end, and properties that
-- do not hold, each with the shortest run that shows it.
--
-- @raise if the model is not valid, or an option is wrong
---@param model rfsm.State
---@param options? rfsm_checks.Options
---@return rfsm_checks.Exploration exploration
function explore.explore(model, options)
  if not rfsm.is_state(model) then
    error("rfsm_checks.explore: state expected, got " .. type(model), 2)
  end
  local settings = opts.take("rfsm_checks.explore", KNOWN, options)
  settings.ends = now() + settings.seconds
  return rfsm.find_module("rfsm.explore.verdict").of(model, settings)
end

return explore
