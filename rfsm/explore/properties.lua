--- Properties: conditions that must hold in each configuration, or on each run.
--
-- A condition is the path of a state, which must be active, the name of a flag, a list
-- of paths and flags, which must all be true, or a function. The function is called
-- with another function, `active`, which returns whether a path or flag is true.
--
-- @module rfsm.explore.properties
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local fairness = require "rfsm.explore.fairness"
local graph = require "rfsm.explore.graph"
local match = require "rfsm.shared.match"
local monitors = require "rfsm.explore.monitors"
local observers = require "rfsm.explore.observers"
local opts = require "rfsm.shared.options"
local order = require "rfsm.shared.order"

local error, getmetatable, ipairs = error, getmetatable, ipairs
local next, pcall, rawget, select = next, pcall, rawget, select
local setmetatable, type = setmetatable, type
local getinfo = (rawget(_G, "debug") or {}).getinfo
local concat, insert, sort = table.concat, table.insert, table.sort
local holds, kinds = monitors.holds, monitors.kinds

local properties = {}

--- A property that a machine must have. The kind decides which other fields there are.
---@class rfsm_checks.Property
---@field kind string "never", "after" ...: see `monitors.kinds`
---@field what? any the condition
---@field event? any the event that the property is about
---@field goal? any the second condition, such as the one to be reached
---@field scope? any the condition that holds when the event comes
---@field ending? any the condition or event with which a bond ends
---@field again? any the condition or event with which a bond begins anew
---@field chart? rfsm.State the chart of an observer
---@field until_? fun(ending: any): rfsm_checks.Property for `after(...).never(...)`
---@field since? fun(event: any): rfsm_checks.Property for `never` and `precedes`
---@field unless? fun(ending: any): rfsm_checks.Property for `always`
---@field seconds? number the time limit or time span
---@field count? integer how many events at most, or at least
---@field location string where it was made: "chart.lua:7: "; empty if that is not known
---@field within? fun(seconds: number): rfsm_checks.Property for `after(...).reach(...)`
local Property = {}

-- Part of a property -> function that returns the problem of a value, or nil.
local PROBLEMS = {}

local is_name = opts.is_a "string"

local function kind_found(value)
  local is_empty = type(value) == "table" and order.is_empty(value)
  return is_empty and "an empty list" or type(value)
end

function PROBLEMS.what(what)
  local names = type(what) == "table" and what or { what }
  local is_right = names[1] ~= nil and order.all(names, is_name) and opts.is_list(names)
  if is_right or type(what) == "function" then return nil end
  return "path of a state, name of a flag, list of them or function expected, got "
    .. kind_found(what)
end

PROBLEMS.goal, PROBLEMS.scope = PROBLEMS.what, PROBLEMS.what

function PROBLEMS.event(event)
  return event == nil and "event expected, got nil" or nil
end

function PROBLEMS.ending(thing)
  local is_list = type(thing) == "table" and not rfsm.name_with_data(thing)
  if thing ~= nil and not (is_list and PROBLEMS.what(thing)) then return nil end
  return "event or condition expected, got " .. kind_found(thing)
end

PROBLEMS.again = PROBLEMS.ending

local is_count = opts.is_whole(1, 100)

function PROBLEMS.count(count)
  return not is_count(count) and "whole number from 1 to 100 expected, "
    .. opts.got(count) or nil
end

local LONGEST = 1000000 -- seconds

function PROBLEMS.seconds(seconds)
  if opts.is_seconds(seconds) and seconds > 0 and seconds <= LONGEST then return nil end
  return ("seconds above 0 and up to %d expected, %s"):format(LONGEST,
    opts.got(seconds))
end

-- The first halves of properties: table -> "after(...) alone (after(...).reach(...))".
local halves = setmetatable({}, { __mode = "k" })

-- The problem of a property as a part of another one.
local NO_PART = "got a property (is there a colon in place of a dot?)"

-- Returns the value of a part of a property; raises an error if the value is wrong, or
-- is not alone.
local function checked(where, part, value, ...)
  local is_property = halves[value] or getmetatable(value) == Property
  local problem = is_property and NO_PART or PROBLEMS[part](value)
    or select("#", ...) > 0 and "one argument less expected, " .. opts.got((...))
  if problem then error("rfsm_checks." .. where .. ": " .. problem, 3) end
  return value
end

local THIS = getinfo and getinfo(1, "S").source

-- Returns the first location on the stack that is not in this file: "chart.lua:7: ".
local function location_of_caller()
  local level = 3
  local caller = getinfo and getinfo(level, "Sl")
  while caller and (caller.source == THIS or caller.currentline < 1) do
    level = level + 1
    caller = getinfo(level, "Sl")
  end
  if not caller then return "" end
  return ("%s:%d: "):format(caller.source:match("^@(.*)") or caller.short_src,
    caller.currentline)
end

local function new(kind, parts)
  local property = setmetatable({ kind = kind, location = location_of_caller() },
    Property)
  for part, value in order.each(parts) do property[part] = value end -- any order
  return property
end

-- Returns a function that takes the last part of a property and returns the property.
-- MORE[kind] gives a property of a kind functions that return another property.
local MORE

local function ending(where, kind, parts, last)
  return function(...)
    local own = { [last] = checked(where, last, ...) }
    for part, other in order.each(parts) do own[part] = other end -- any order
    local property = new(kind, own)
    for name, rest in order.each(MORE[kind] or {}) do -- any order: independent
      property[name] = ending(("%s(...).%s"):format(where, name), rest[1], own, rest[2])
    end
    return property
  end
end

MORE = { after = { within = { "reach_within", "seconds" } },
  after_never = { until_ = { "never_until", "ending" },
    within = { "never_within", "seconds" } },
  never_until = { until_ = { "never_until", "ending" },
    within = { "never_within", "seconds" } } }

-- Returns a table of functions. Each takes the last part of a property and returns the
-- property: `from(c)` returns such a table, and `from(c).stays(2)` is the property.
-- `endings`: name of a function -> kind of the property, and name of its last part.
local function first_half(where, parts, endings)
  local functions = {}
  for name, rest in order.each(endings) do -- any order: they are independent
    functions[name] = ending(where .. "." .. name, rest[1], parts, rest[2])
  end
  halves[functions] = ("%s alone (%s.%s(...))"):format(where, where,
    concat(rfsm.sorted_keys(functions), "(...), ."))
  return setmetatable(functions, { __index = function(_, name)
    local text, names = rfsm.text_of(name), rfsm.sorted_keys(functions)
    error(("rfsm_checks.%s: no '%s'%s, expected: %s"):format(where, text,
      advice.did_you_mean(text, names), concat(names, ", ")), 2)
  end })
end

--- Declare that a condition holds in no configuration.
--
-- `never("root.moving").since("e_stop")` is `after("e_stop").never("root.moving")`.
--
---@param condition string|string[]|fun(active: fun(name: string): boolean): boolean
---@param ... nil an argument too many is an error
---@return rfsm_checks.Property
function properties.never(condition, ...)
  local property = new("never", { what = checked("never", "what", condition, ...) })
  property.since = ending("never(...).since", "after_never", { goal = condition },
    "event")
  return property
end

--- Declare that a condition holds in each configuration after the first entry.
--
-- `always("root.homing").unless("e_homed")`: it holds until the event has come, or a
-- condition has held. Neither has to come.
--
---@param condition string|string[]|fun(active: fun(name: string): boolean): boolean
---@param ... nil an argument too many is an error
---@return rfsm_checks.Property
function properties.always(condition, ...)
  local parts = { what = checked("always", "what", condition, ...) }
  local property = new("always", parts)
  property.unless = ending("always(...).unless", "unless", parts, "ending")
  return property
end

local function after(where, event, scope)
  return first_half(where, { event = event, scope = scope },
    { reach = { "after", "goal" }, leads_to = { "leads_to", "goal" },
      never = { scope ~= nil and "never_until" or "after_never", "goal" } })
end

--- Declare the consequence of an event that comes after the first entry.
--
-- `after("e_stop").reach("root.stopped")`: the condition holds after the step with the
-- event, or after one of the next steps without events from outside, whatever guards
-- answer. `.within(5)`: it holds within 5 seconds, whatever other events come.
-- `leads_to`: it holds eventually. `never`: after that step it never holds; with
-- `.until_("e_reset")` not before that event has come, or a condition has held; with
-- `.within(2)` not for 2 seconds. The event may be `entry root.a`, `exit root.a` or
-- `taken root.trans[2]`, too.
--
---@param event any
---@param ... nil an argument too many is an error
---@return table of `reach(condition)`, `leads_to(condition)`, `never(condition)`
function properties.after(event, ...)
  return after("after(...)", checked("after", "event", event, ...))
end

--- Declare how long a condition holds, or what can follow it.
--
-- `from("root.fault").can_reach("root.ready")`: from each configuration in `root.fault`
-- some run leads to `root.ready`. `left_within(2)`: each time the condition begins to
-- hold, it ends within 2 seconds. `stays(2)`: it then holds for at least 2 seconds.
-- `after(event)`: as `after(event)`, if the condition holds when the event comes.
--
---@param condition any
---@return table of `can_reach(condition)`, `left_within(seconds)`, `stays(seconds)`,
---@param ... nil an argument too many is an error
-- `after(event)`
function properties.from(condition, ...)
  local parts = { what = checked("from", "what", condition, ...) }
  local half = first_half("from(...)", parts, { can_reach = { "from", "goal" },
    left_within = { "left_within", "seconds" }, stays = { "stays", "seconds" } })
  function half.after(...)
    return after("from(...).after(...)", checked("from(...).after", "event", ...),
      condition)
  end
  return half
end

--- Declare that the second thing does not happen before the first one has. Each is a
--- condition or an event. With `.since(event)`, the first one must happen again after
--- each such event.
---@param first any
---@param second any
---@param ... nil an argument too many is an error
---@return rfsm_checks.Property
function properties.precedes(first, second, ...)
  local parts = { what = checked("precedes", "what", first),
    goal = checked("precedes", "goal", second, ...) }
  local property = new("precedes", parts)
  property.since = ending("precedes(...).since", "precedes", parts, "again")
  return property
end

--- Declare that, from the first entry on, the first condition holds until the second
--- one holds, and that the second one holds eventually.
---@param first any
---@param second any
---@param ... nil an argument too many is an error
---@return rfsm_checks.Property
function properties.until_(first, second, ...)
  return new("until", { what = checked("until_", "what", first),
    goal = checked("until_", "goal", second, ...) })
end

--- Declare that an observer is never in a leaf named `bad`.
--
-- An observer is a chart that hears the events of the machine, `entry root.a`,
-- `exit root.a`, `taken root.trans[2]`, and `step` after each step.
--
-- @usage
--    rfsm_checks.observer(rfsm.state {
--      free = rfsm.state {}, asked = rfsm.state {}, bad = rfsm.state {},
--      rfsm.trans { src = "initial", tgt = "free" },
--      rfsm.trans { src = "free", tgt = "asked", events = { "e_request" } },
--      rfsm.trans { src = "asked", tgt = "free", events = { "entry root.answered" } },
--      rfsm.trans { src = "asked", tgt = "bad", events = { "e_request" } } })
--
---@param chart rfsm.State
---@return rfsm_checks.Property
function properties.observer(chart)
  if not rfsm.is_state(chart) then
    error("rfsm_checks.observer: state expected, " .. opts.got(chart), 2)
  end
  return new("observer", { chart = chart })
end

--- Declare that an event comes at most `count` times in any time span of a given
--- length: `at_most(3, "e_retry").within(10)`.
---@param count integer most steps with the event
---@param event any
---@param ... nil an argument too many is an error
---@return { within: fun(seconds: number): rfsm_checks.Property }
function properties.at_most(count, event, ...)
  return first_half("at_most(...)", { count = checked("at_most", "count", count),
    event = checked("at_most", "event", event, ...) },
    { within = { "at_most", "seconds" } })
end

--- Declare that an event comes at least `count` times in any time span of a given
--- length after the first entry: `at_least(1, "e_heartbeat").within(5)`.
---@param count integer fewest steps with the event
---@param event any
---@param ... nil an argument too many is an error
---@return { within: fun(seconds: number): rfsm_checks.Property }
function properties.at_least(count, event, ...)
  return first_half("at_least(...)", { count = checked("at_least", "count", count),
    event = checked("at_least", "event", event, ...) },
    { within = { "at_least", "seconds" } })
end

local function text_of(what)
  if type(what) == "function" then return "a function" end
  return type(what) == "table" and concat(what, " and ") or rfsm.text_of(what)
end

-- The texts around the parts that a property of any kind may have.
local AROUND = { { "scope", "from {scope} ", "" }, { "again", "", " since {again}" },
  { "ending", "", " until {ending}" } }

local ENDINGS = { "since", "unless", "until_", "within" }

-- The fields that a property may have or not.
local FIELDS = { what = true, event = true, goal = true, scope = true, ending = true,
  again = true, chart = true, seconds = true, count = true }

-- Raises an error for an ending that the property cannot have, also for one that is
-- misspelt.
function Property:__index(name)
  if FIELDS[name] or type(name) ~= "string"
    or advice.did_you_mean(name, ENDINGS) == "" and not match.has(ENDINGS, name) then
    return nil
  end
  local names = {}
  for _, other in ipairs(ENDINGS) do
    if rawget(self, other) then names[#names + 1] = other end
  end
  error(("rfsm_checks: '%s' has no '%s', expected: %s"):format(
    Property.__tostring(self), name, names[1] and concat(names, ", ")
    or "nothing more"), 2)
end

function Property:__tostring()
  local text = kinds[self.kind].text
  for _, part in ipairs(AROUND) do
    if self[part[1]] ~= nil then text = part[2] .. text .. part[3] end
  end
  return (text:gsub("{(%l+)}", function(field)
    local value = self[field]
    local is_event = type(value) ~= "string" and (rfsm.event_name(value)
      or rfsm.name_with_data(value))
    if type(value) ~= "function" and field == "event" then
      is_event = rfsm.event_text(value)
    end
    return is_event or text_of(value)
  end))
end

-- Check ...........................................................................

--- A property with its name, and the verdict on it.
---@class rfsm_checks.Judged
---@field name string
---@field property rfsm_checks.Property
---@field event any the event that the property means in the chart
---@field observer? rfsm_checks.Observer the observer that judges the property
---@field unnamed? string a text that no transition names the event
---@field is_apart? boolean its event is outside of the alphabet, so that its walk takes
-- steps that no other walk takes
---@field holds boolean|nil nil: not known, since something was not tried
---@field vacuous? string the reason why nothing tests the property
---@field way rfsm_checks.Way the parts of the machine that its walk explores
---@field walk rfsm_checks.Walk the walk on which it is judged
---@field is_open? boolean the verdict is not known, though everything was tried
---@field at? integer the configuration that violates the property
---@field label? string label of the step from `at`, if a step violates the property
---@field tgt? integer for an `after`: the configuration to which this step leads
---@field owed? table<integer, table> for an `after`: configuration -> the first step
-- that has the event and leads to it

--- Return a table of properties, also for one that is not in a table.
function properties.listed(given)
  return (halves[given] or getmetatable(given) == Property) and { given } or given
end

--- List properties with their names, sorted.
---@param where string name of the function that was called, for errors
---@param given table<any, rfsm_checks.Property>
---@return rfsm_checks.Judged[] list
function properties.list_of(where, given)
  local list = {}
  for key, property in order.each(properties.listed(given)) do -- any order: sorted
    if getmetatable(property) ~= Property then
      local half = halves[property]
      error(where .. ": properties: never(...), after(...).reach(...) or another "
        .. "property expected, got " .. (half or type(property)), 0)
    end
    local name = type(key) == "string" and key or Property.__tostring(property)
    list[#list + 1] = { name = name, property = property, holds = nil }
  end
  sort(list, function(a, b) return rfsm.text_before(a.name, b.name) end)
  return list
end

-- Returns the set of configurations in which a condition holds. If `field` is "from" or
-- "tgt", steps count that enter and leave a state in which the condition holds: the set
-- also has the configuration in which such a step begins ("from") or ends ("tgt").
local function set_of(walk, condition, field)
  local set = {}
  for number = 2, #walk.keys do
    set[number] = holds(condition, walk.subject:view(walk:configuration(number))) or nil
  end
  for _, passed in ipairs(field and walk.passed or {}) do
    local number = passed[field]
    set[number] = set[number]
      or holds(condition, walk.subject:view_of_moment(passed.moment)) or nil
  end
  return set
end

-- Notes a violation in the first configuration that is in `set` but not in `others`.
local function find_first(walk, judged, set, others)
  for number = 2, #walk.keys do
    if set[number] and not others[number] then
      judged.holds, judged.at = false, number
      return
    end
  end
end

local NONE = {}

-- A condition that holds in a state that a step enters and leaves is a violation, too.
function kinds.never.judge(walk, judged)
  find_first(walk, judged, set_of(walk, judged.property.what), NONE)
  if judged.holds == false then return end
  for _, passed in ipairs(walk.passed) do
    if holds(judged.property.what, walk.subject:view_of_moment(passed.moment)) then
      judged.holds, judged.at, judged.label = false, passed.from, passed.label
      return
    end
  end
end

function kinds.always.judge(walk, judged)
  local entered = {}
  for number = 2, #walk.keys do
    entered[number] = walk:configuration(number)[1].leaf ~= false
  end
  find_first(walk, judged, entered, set_of(walk, judged.property.what))
end

-- If a bound was hit no violation is reported, since a run to the goal may go through
-- steps that were not tried.
function kinds.from.judge(walk, judged)
  local property = judged.property
  local set = set_of(walk, property.what, "tgt")
  if order.is_empty(set) then
    judged.vacuous = "no configuration has " .. text_of(property.what)
  elseif not walk.bound then
    local goals = set_of(walk, property.goal, "from")
    find_first(walk, judged, set, graph.can_reach(walk, goals))
    local sure = graph.can_surely_reach(walk, goals)
    for number = 2, #walk.keys do
      judged.is_open = judged.is_open or set[number] and not sure[number]
    end
  end
end

function kinds.after.judge(walk, judged)
  local must_reach = walk.must_reach or graph.must_reach
  local set = must_reach(walk, set_of(walk, judged.property.goal))
  local event = rfsm.event_text(judged.property.event)
  if not judged.has_come then
    judged.vacuous = event .. " never comes"
  elseif not judged.is_taken then
    judged.vacuous = "no transition takes " .. event
  end
  for number = 1, #walk.keys do
    local step = judged.owed[number]
    local is_known = number <= walk.expanded or not walk.bound
    if step and is_known and not set[number]
      and (not judged.at or step.from < judged.at) then
      judged.holds, judged.at, judged.label = false, step.from, step.label
      judged.tgt = number
    end
  end
end

--- List the words that a property has to hear: those of its observer, or its event, if
--- that is a word about an element.
---@param judged rfsm_checks.Judged
---@return any[] words
function properties.words_of(judged)
  local event = judged.property.event
  if judged.observer then return judged.observer.words end
  return event ~= nil and observers.element_of(event) and { event } or NONE
end

--- Raise an error about a property, which begins with the place where it was made.
---@param where string name of the function that was called
---@param judged rfsm_checks.Judged
---@param problem string
local function refuse(where, judged, problem)
  error(("%s%s: property '%s': %s"):format(judged.property.location, where, judged.name,
    problem), 0)
end

properties.refuse = refuse

-- Kind of a property -> its parts that may be events; other parts are conditions.
local EVENTS_OF = { never_until = { goal = true, ending = true },
  precedes = { what = true, goal = true, again = true }, unless = { ending = true } }

local function check_condition(where, judged, condition, active)
  if rfsm.event_name(condition) then
    refuse(where, judged, ("state, flag or function expected, got the event %s"):format(
      rfsm.event_text(condition)))
  end
  local ok, problem = pcall(monitors.ask_all, condition, active)
  if ok then return end
  local is_placed = type(problem) ~= "string" or problem:find("^.-:%d+: ")
  if is_placed then error(problem, 0) end -- of the user's function, with its line
  refuse(where, judged, problem)
end

--- Raise an error if a condition names a state or flag that does not exist.
---@param where string name of the function that was called
---@param judged rfsm_checks.Judged
---@param audible rfsm_checks.Audible
function properties.check_names(where, judged, audible)
  local property, events = judged.property, EVENTS_OF[judged.property.kind] or NONE
  for _, field in ipairs { "what", "goal", "scope", "ending", "again" } do
    local condition = property[field]
    local is_asked = condition ~= nil
      and (not events[field] or observers.is_condition(condition, audible))
    if is_asked then check_condition(where, judged, condition, audible.active) end
  end
end

-- Raises an error for an event that only a machine itself can make, such as a time
-- event, and that this machine never makes.
local function check_maker(own, judged)
  local event = judged.event
  if not own:maker_of(event) or own.event_numbers[event] or own.done[event] then
    return
  end
  refuse("rfsm_checks.explore", judged, ("no transition names the event '%s'%s")
    :format(event, advice.nearest_name(event, own:named_texts())))
end

--- Return a text if no transition of a machine names the event of a property, or could
--- take it.
---@param event any
---@param audible rfsm_checks.Audible
---@return string?
function properties.text_of_unnamed(event, audible)
  local word = rfsm.event_name(event) or rfsm.name_with_data(event) or event
  if word == nil or audible.takes_any or match.has(audible.events, word)
    or match.has(audible.made, word) or observers.element_of(word) then
    return nil
  end
  local name = rfsm.event_text(word)
  return ("no transition names %s%s"):format(name, observers.word_meant(name, audible))
end

-- Raises an error for an event with data that is none of the examples of its name.
local function check_examples(own, where, judged)
  for _, field in ipairs { "event", "ending", "again" } do
    local event = judged.property[field]
    local name = rfsm.name_with_data(event)
    local texts = order.map(name and own.classes[name] or {}, rfsm.event_text, true)
    local has_data = texts[1] and next(event, (next(event))) ~= nil
    if has_data and not own.is_example[own:event_of(event)] then
      local text = rfsm.event_text(event, true)
      refuse(where, judged, ("classes has no %s%s"):format(text,
        advice.nearest_name(text, texts)))
    end
  end
end

-- Finds the event of a property in the chart, unless an observer hears it.
local function add_event(own, judged, audible)
  local event = judged.property.event
  if event == nil or judged.observer then return end
  judged.event = own:event_meant(event)
  if observers.element_of(event) then return end
  check_maker(own, judged)
  judged.is_apart = own.alphabet ~= nil and not own:maker_of(judged.event)
    and not match.has(own.alphabet, judged.event)
  judged.unnamed = properties.text_of_unnamed(judged.event, audible)
end

--- Has the last step taken a transition that names the event, or that takes any event?
--- A word about an element is one that was taken.
function properties.is_taken(own, event)
  if own.hears[event] then return true end
  for _, number in ipairs(own.taken) do
    local tr = own.transitions[number].tr
    if match.names(tr, event) or rfsm.is_state(tr.src)
      and match.triggers(tr, event) ~= false then
      return true
    end
  end
  return false
end

-- Has a walk note the targets of all steps that have the event of an `after` property.
local function watch_steps(walk, afters)
  local own = walk.subject
  function walk.look(_, from, tgt, _, label)
    if not own.parts[1].position.leaf then return end -- before the first entry
    for _, judged in ipairs(afters) do
      local owed, event, scope = judged.owed, judged.event, judged.property.scope
      local is_there = scope == nil or holds(scope, own:view(walk:configuration(from)))
      if own:has_come(event) and is_there then
        judged.has_come = true
        judged.is_taken = judged.is_taken or properties.is_taken(own, event)
        owed[tgt] = owed[tgt] or { from = from, label = label() }
      end
    end
  end
end

-- Has a walk take steps with the event of a property, or note when the word is said.
local function want_event(walk, judged)
  local event = judged.event
  if observers.element_of(event) then
    walk.subject:hear { event }
  else
    walk:want(event, true)
  end
  if judged.property.goal then walk:take_two() end
end

-- Makes the observer of a property, if one judges it. The error about a property or
-- observer that names what the machine does not have begins with the file of the
-- observer, or the name of the property.
local function add_observer(where, judged, audible)
  local property = judged.property
  local ok, observer = pcall(observers.of, property, audible)
  local problem = not ok and observer
    or property.event ~= nil and observers.element_of(property.event)
    and observers.problem_of(property.event, audible) or nil
  if not problem then
    judged.observer = observer
  elseif property.chart then
    error(problem, 0)
  else
    refuse(where, judged, problem)
  end
end

--- List properties with their observers, sorted by name.
-- @raise if a property names a state, a flag or an event that does not exist
---@param where string name of the function that was called
---@param given table<any, rfsm_checks.Property>
---@param audible rfsm_checks.Audible
---@return rfsm_checks.Judged[]
function properties.heard_in(where, given, audible)
  local list = properties.list_of(where, given)
  for _, judged in ipairs(list) do
    properties.check_names(where, judged, audible)
    add_observer(where, judged, audible)
  end
  return list
end

--- List the properties of an exploration.
-- @raise if a property names a state, a flag or an event that does not exist
---@param own rfsm_checks.Subject
---@param given table<any, rfsm_checks.Property>
---@return rfsm_checks.Judged[] list sorted by name
function properties.list_for(own, given)
  local where, audible = "rfsm_checks.explore", own:audible()
  local list = properties.heard_in(where, given, audible)
  for _, judged in ipairs(list) do
    check_examples(own, where, judged)
    add_event(own, judged, audible)
  end
  return list
end

--- Prepare a walk for the properties that are judged when it is over. If one of the
--- properties is an `after`, even one of another walk, a step may have two events.
---@param walk rfsm_checks.Walk
---@param list rfsm_checks.Judged[]
---@param own_walk? rfsm_checks.Judged the property whose own walk it is
function properties.watch(walk, list, own_walk)
  local afters = {}
  for _, judged in ipairs(list) do
    local is_after = judged.property.kind == "after"
    if is_after then walk:take_two() end
    local is_here = not (own_walk or judged.is_apart) and judged.way == walk.way
    if is_after and (is_here or judged == own_walk) then
      want_event(walk, judged)
      afters[#afters + 1], judged.owed = judged, {}
    end
  end
  if afters[1] then watch_steps(walk, afters) end
end

-- Has a walk note the words that an observer hears, and take steps with the events.
local function watch_words(walk, judged)
  local own, words = walk.subject, judged.observer.words
  own:hear(words)
  for _, word in ipairs(words) do
    local is_event = word ~= "step" and word ~= "pass"
      and not observers.element_of(word)
    if is_event then walk:want(own:event_meant(word)) end
  end
end

--- Prepare a walk for the monitors of some properties.
---@param walk rfsm_checks.Walk
---@param list rfsm_checks.Judged[]
function properties.monitor(walk, list)
  walk.monitors = list
  for i, judged in ipairs(list) do
    judged.number = i
    if judged.observer then
      watch_words(walk, judged)
    elseif judged.event ~= nil then
      want_event(walk, judged)
    end
  end
end

-- Returns what is equal for properties whose monitors can share a walk: none of them
-- needs steps or times that would be new to another. A condition that is owed is alone,
-- since its cycles would be longer beside the states of other monitors.
local function company_of(judged)
  local property, event = judged.property, judged.event
  if kinds[property.kind].owes or judged.is_apart then return judged end
  local is_wide = event ~= nil and not judged.observer and property.goal ~= nil
  return (is_wide and "two" or "one") .. (property.seconds and " timed" or "")
end

--- List the properties that monitors judge in groups: each may share a walk.
---@param list rfsm_checks.Judged[]
---@return rfsm_checks.Judged[][] groups
function properties.groups(list)
  local groups, by_way = {}, {}
  for _, judged in ipairs(list) do
    local company = not kinds[judged.property.kind].judge and company_of(judged)
    local mates = by_way[judged.way] or {}
    by_way[judged.way] = mates
    if company and not mates[company] then
      mates[company] = {}
      groups[#groups + 1] = mates[company]
    end
    if company then insert(mates[company], judged) end
  end
  return groups
end

-- Has the event of a property come? Then an observer has left its first leaf.
local function has_begun(walk, judged)
  local observer = judged.observer
  return judged.has_come or observer and order.any(walk.contexts, function(context)
    local state = context.states[judged.number]
    return state ~= "first" and state ~= observer.first
  end)
end

-- Judges a property whose monitor has looked at each step of the walk. The monitor has
-- noted violations already. If a condition must hold eventually, it is judged here.
local function judge_monitored(walk, judged)
  if judged.property.event ~= nil and not has_begun(walk, judged) then
    judged.vacuous = rfsm.event_text(judged.property.event) .. " never comes"
  end
  local owes = kinds[judged.property.kind].owes
  if owes and judged.holds == nil then fairness.judge(walk, judged, owes) end
end

--- Judge a property when its walk is over.
function properties.judge(walk, judged)
  local judge = kinds[judged.property.kind].judge or judge_monitored
  judge(walk, judged)
  if not (walk.bound or walk:is_entered()) then
    judged.holds, judged.vacuous = nil, "the machine is never entered"
  end
  if judged.holds == nil and not (walk.bound or judged.is_open) then
    judged.holds = true
  end
  judged.vacuous = judged.unnamed or judged.vacuous
end

return properties
