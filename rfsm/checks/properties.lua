--- Properties: what must hold in each configuration, and on each run.
--
-- A condition is the path of a state, which must be active, the name of a flag, a list
-- of these, all of which must be true, or a function. A function is called with another
-- one, `active`, that tells of a path or flag.
--
-- @module rfsm.checks.properties
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local graph = require "rfsm.checks.graph"
local match = require "rfsm.checks.match"

local error, getmetatable, ipairs, pairs = error, getmetatable, ipairs, pairs
local pcall, setmetatable, type = pcall, setmetatable, type
local concat, sort = table.concat, table.sort

local properties = {}

--- Something that must hold.
---@class rfsm_checks.Property
---@field kind "never"|"always"|"after"|"from"
---@field what any the condition; of `after` the event
---@field goal? any the condition to be reached
local Property = {}
Property.__index = Property

local function check_condition(what, where)
  local names = type(what) == "table" and what or { what }
  local is_right = names[1] ~= nil
  for _, name in ipairs(names) do
    is_right = is_right and (type(name) == "string" or type(what) == "function")
  end
  if is_right then return what end
  error("rfsm_checks." .. where .. ": path of a state, name of a flag, list of them or "
    .. "function expected, got " .. type(what), 3)
end

local function new(kind, what, goal)
  return setmetatable({ kind = kind, what = what, goal = goal }, Property)
end

--- Declare that a condition holds in no configuration.
---@param condition string|string[]|fun(active: fun(name: string): boolean): boolean
---@return rfsm_checks.Property
function properties.never(condition)
  return new("never", check_condition(condition, "never"))
end

--- Declare that a condition holds in each configuration after the first entry.
---@param condition string|string[]|fun(active: fun(name: string): boolean): boolean
---@return rfsm_checks.Property
function properties.always(condition)
  return new("always", check_condition(condition, "always"))
end

--- Declare what an event leads to: `after("e_stop").reach("root.stopped")`.
--
-- Once the machine was entered, it is reached in the step that has the event, or in
-- those that follow without an event from outside, whatever guards answer.
--
---@param event any
---@return { reach: fun(condition: any): rfsm_checks.Property }
function properties.after(event)
  if event == nil then error("rfsm_checks.after: event expected, got nil", 2) end
  return { reach = function(goal)
    return new("after", event, check_condition(goal, "after(...).reach"))
  end }
end

--- Declare what stays possible: `from("root.fault").can_reach("root.ready")`.
--
-- From each configuration in which the first condition holds, some run leads to one in
-- which the second does.
--
---@param condition any
---@return { can_reach: fun(condition: any): rfsm_checks.Property }
function properties.from(condition)
  check_condition(condition, "from")
  return { can_reach = function(goal)
    return new("from", condition, check_condition(goal, "from(...).can_reach"))
  end }
end

local function text_of(what)
  if type(what) == "function" then return "a function" end
  return type(what) == "table" and concat(what, " and ") or rfsm.text_of(what)
end

function Property:__tostring()
  local goal = self.kind == "after" and " reach " or " can reach "
  return self.kind .. " " .. text_of(self.what)
    .. (self.goal and goal .. text_of(self.goal) or "")
end

-- Check ...........................................................................

--- A property with its name, and what was found.
---@class rfsm_checks.Judged
---@field name string
---@field property rfsm_checks.Property
---@field holds boolean|nil nil if something was not tried and nothing was found
---@field vacuous? string why nothing was there to be judged
---@field at? integer configuration that shows that it does not
---@field label? string of a step from there

-- Lists properties with their names, sorted.
local function list_of(given)
  local list = {}
  for key, property in pairs(given) do -- any order: sorted
    if getmetatable(property) ~= Property then
      error("rfsm_checks.explore: properties: never(...), always(...), "
        .. "after(...).reach(...) or from(...).can_reach(...) expected, got "
        .. type(property), 0)
    end
    local name = type(key) == "string" and key or Property.__tostring(property)
    list[#list + 1] = { name = name, property = property, holds = nil }
  end
  sort(list, function(a, b) return a.name < b.name end)
  return list
end

local function holds(condition, active)
  if type(condition) == "function" then return condition(active) and true or false end
  for _, name in ipairs(type(condition) == "table" and condition or { condition }) do
    if not active(name) then return false end
  end
  return true
end

-- Returns the set of configurations in which a condition holds; with `field`, "from" or
-- "tgt", also those with a step in which it holds for a moment.
local function set_of(walk, condition, field)
  local set = {}
  for number = 2, #walk.keys do
    set[number] = holds(condition, walk.puppet:view(walk:configuration(number)))
  end
  for _, passed in ipairs(field and walk.passed or {}) do
    local number = passed[field]
    set[number] = set[number]
      or holds(condition, walk.puppet:view_of_moment(passed.moment))
  end
  return set
end

-- Notes the first configuration that is in one set and not in another as a violation.
local function find_first(walk, judged, set, others)
  for number = 2, #walk.keys do
    if set[number] and not others[number] then
      judged.holds, judged.at = false, number
      return
    end
  end
end

local ALL, NONE = setmetatable({}, { __index = function() return true end }), {}

local function is_empty(set)
  for _, is_in in pairs(set) do -- any order: is one there?
    if is_in then return false end
  end
  return true
end

local JUDGES = {}

-- Some moment of a step may fulfil the condition, too.
function JUDGES.never(walk, judged)
  find_first(walk, judged, set_of(walk, judged.property.what), NONE)
  if judged.holds == false then return end
  for _, passed in ipairs(walk.passed) do
    if holds(judged.property.what, walk.puppet:view_of_moment(passed.moment)) then
      judged.holds, judged.at, judged.label = false, passed.from, passed.label
      return
    end
  end
end

function JUDGES.always(walk, judged)
  find_first(walk, judged, ALL, set_of(walk, judged.property.what))
end

-- With a bound nothing is known against it: the way may lead through the rest.
function JUDGES.from(walk, judged)
  local property = judged.property
  local set = set_of(walk, property.what, "tgt")
  if is_empty(set) then
    judged.vacuous = "no configuration has " .. text_of(property.what)
  elseif not walk.bound then
    find_first(walk, judged, set,
      graph.can_reach(walk, set_of(walk, property.goal, "from")))
  end
end

function JUDGES.after(walk, judged)
  local set = graph.must_reach(walk, set_of(walk, judged.property.goal))
  local event = rfsm.text_of(judged.property.what)
  if not judged.has_come then
    judged.vacuous = event .. " never comes"
  elseif not judged.is_taken then
    judged.vacuous = "no transition takes " .. event
  end
  for number = 1, #walk.keys do
    local step = walk.owed[judged][number]
    local is_known = number <= walk.expanded or not walk.bound
    if step and is_known and not set[number]
      and (not judged.at or step.from < judged.at) then
      judged.holds, judged.at, judged.label = false, step.from, step.label
    end
  end
end

-- Raises an error for names that do not exist.
local function check_names(walk, judged)
  local own, property = walk.puppet, judged.property
  local active = own:view(own:configuration(own:read()))
  for _, condition in ipairs { property.kind ~= "after" and property.what or "root",
    property.goal or "root" } do
    local ok, problem = pcall(holds, type(condition) ~= "function" and condition
      or "root", active)
    if not ok then
      error(("rfsm_checks.explore: property '%s': %s"):format(judged.name, problem), 0)
    end
  end
end

-- Raises an error for an event that the machine would make itself, and does not.
local function check_event(own, judged)
  local event = judged.property.what
  if not own:maker_of(event) or own.event_numbers[event] or own.done[event] then
    return
  end
  error(("rfsm_checks.explore: property '%s': no transition names the event '%s'%s")
    :format(judged.name, event, advice.nearest_name(event, own:named_texts())), 0)
end

-- Is the event named by one of the transitions that the step took? Or do they take any?
local function is_taken(own, event)
  for _, number in ipairs(own.taken) do
    local tr = own.transitions[number].tr
    if match.triggers(tr, event) ~= false then return true end
  end
  return false
end

-- Has the walk take steps with the events of `after`, and note where they lead.
local function watch_events(walk, list)
  local afters, own = {}, walk.puppet
  walk.owed = {}
  for _, judged in ipairs(list) do
    if judged.property.kind == "after" then
      check_event(own, judged)
      afters[#afters + 1], walk.owed[judged] = judged, {}
      own.wanted[judged.property.what] = false
    end
  end
  if not afters[1] then return end
  if not walk.is_together_given then walk.together = 2 end
  function walk.add_wanted(_, events)
    for _, judged in ipairs(afters) do
      local event = judged.property.what
      local occurrence = own:occurrence(own.parts[1], event)
      if not (own:maker_of(event) or match.has(events, occurrence)) then
        events[#events + 1] = occurrence
      end
    end
  end
  function walk.look(_, from, tgt, _, label)
    if not own.parts[1].stand.leaf then return end -- before the first entry
    for _, judged in ipairs(afters) do
      local owed, event = walk.owed[judged], judged.property.what
      if own.wanted[event] then
        judged.has_come = true
        judged.is_taken = judged.is_taken or is_taken(own, event)
        owed[tgt] = owed[tgt] or { from = from, label = label() }
      end
    end
  end
end

--- Prepare a walk for properties.
---@param walk rfsm_checks.Walk
---@param given table<any, rfsm_checks.Property>
---@return rfsm_checks.Judged[] list sorted by name
function properties.watch(walk, given)
  local list = list_of(given)
  for _, judged in ipairs(list) do check_names(walk, judged) end
  watch_events(walk, list)
  return list
end

--- Judge properties when the walk is over.
function properties.judge(walk, list)
  for _, judged in ipairs(list) do
    JUDGES[judged.property.kind](walk, judged)
    if walk.expanded < 2 and not walk.keys[2] then
      judged.holds, judged.vacuous = nil, "the machine is never entered"
    end
    if judged.holds == nil and not walk.bound then judged.holds = true end
  end
end

return properties
