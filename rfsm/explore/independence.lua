--- Independence: regions of sequential AND states that can be explored one by one.
--
-- Each step advances all regions of a state, and no event leaves a region. So the
-- machine and one region have the same configurations whether the other regions exist
-- or not, and a walk may leave the others out. A *way* is the set of parts of a subject
-- that one walk has. Two regions are *joined*, and so always in the same ways, if
--
-- - both react to the same event from outside, since that event decides whether the two
--   are at a dead end together, or
-- - both have timers, since the machine is stepped between any two deadlines.
--
-- A *bound* region is in each way that has the machine around it. A region is bound if
-- it has a callback in `run` or a guard with a rule, if it has timers and the machine
-- or a property has times, too, or if a transition waits until its state is done. A
-- property is judged on a walk that has all regions that the property names.
--
-- @module rfsm.explore.independence
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local alphabet = require "rfsm.shared.alphabet"
local match = require "rfsm.shared.match"
local observers = require "rfsm.explore.observers"
local order = require "rfsm.shared.order"

local ipairs, type = ipairs, type
local concat, max, min = table.concat, math.max, math.min
local any = order.any

local independence = {}

local NOTHING = {}

--- The prefixes of the parts of a subject that a walk has; false: it has all parts.
---@alias rfsm_checks.Way table<string, true>|false

--- The traits of a region, and of the regions inside of it, that may join it to others.
---@class rfsm_checks.Traits
---@field events table<any, true> the events from outside to which it reacts
---@field is_any boolean it may react to any event
---@field has_timer boolean it has a timer, and the order of timers matters
---@field is_bound boolean it is in each way that has the machine around it

-- Traits ............................................................................

-- Can any event decide whether a transition is taken? Not if it leaves a connector and
-- has no events and no guard (`guard` is false): then the segments before it decide.
local function is_any(tr)
  local triggers = match.triggers(tr, NOTHING)
  return triggers == nil or triggers and (rfsm.is_state(tr.src) or tr.guard ~= false)
end

-- Returns the traits of a part, without the traits of its regions.
local function own_traits(own, part, are_free)
  local traits = { events = {}, is_bound = part.is_bound, has_timer = false,
    is_any = any(rfsm.elements(part.fsm, rfsm.is_trans), is_any) }
  for event in order.each(alphabet.of(part.fsm).set) do -- any order: a set
    local maker = own:maker_of(event)
    traits.events[event] = not maker or nil
    traits.has_timer = traits.has_timer or maker == "timer" and not are_free
  end
  return traits
end

-- Adds the traits of a region to the traits of the region around it.
local function add_inner(traits, inner)
  for event in order.each(inner.events) do traits.events[event] = true end -- any order
  traits.is_any = traits.is_any or inner.is_any
  traits.has_timer = traits.has_timer or inner.has_timer
  traits.is_bound = traits.is_bound or inner.is_bound
end

-- Returns the traits of each part. A region inside of a region is bound if it has
-- timers, even if no other part has timers.
local function traits_of(own, is_timed, are_free)
  local traits = {}
  for _, part in ipairs(own.parts) do
    traits[part] = own_traits(own, part, are_free)
  end
  is_timed = is_timed or traits[own.parts[1]].has_timer
  for i = #own.parts, 2, -1 do
    local part = own.parts[i]
    if part.owner.owner then add_inner(traits[part.owner], traits[part]) end
    if rfsm.names_done(part.leaf)
      or traits[part].has_timer and (is_timed or part.owner.owner) then
      traits[part].is_bound = true
    end
  end
  return traits
end

-- Groups ............................................................................

local function are_joined(a, b)
  if a.has_timer and b.has_timer then return true end
  if a.is_any and (b.is_any or not order.is_empty(b.events)) then return true end
  if b.is_any and not order.is_empty(a.events) then return true end
  for event in order.each(a.events) do -- any order: one is enough
    if b.events[event] then return true end
  end
  return false
end

-- Returns the groups after a region is added. The region and all groups to which it is
-- joined become one group.
local function with_region(groups, traits, part)
  local group, list = { part }, {}
  for _, other in ipairs(groups) do
    if any(other, function(mate) return are_joined(traits[part], traits[mate]) end) then
      group = match.joined(other, group)
    else
      list[#list + 1] = other
    end
  end
  list[#list + 1] = group
  return list
end

--- The tables that are filled while the walks of a chart are planned.
---@class rfsm_checks.Planning
---@field own rfsm_checks.Subject the chart
---@field traits table<rfsm_checks.Part, rfsm_checks.Traits>
---@field states table<rfsm_checks.Part, table[]> for each state with regions in a part:
-- its `leaf`, the list of its `bound` regions, and the `groups` of its joined regions
---@field mates table<rfsm_checks.Part, rfsm_checks.Part[]> the group to which a region
-- belongs
---@field ways table<string, table<string, true>> ways by a text of their prefixes

-- Returns the entry of `states` for the state of a region. A missing entry is added.
local function state_of(self, part)
  local states = self.states[part.owner]
  for _, state in ipairs(states) do
    if state.leaf == part.leaf then return state end
  end
  states[#states + 1] = { leaf = part.leaf, bound = {}, groups = {} }
  return states[#states]
end

local function find_groups(self)
  for _, part in ipairs(self.own.parts) do
    self.states[part], self.mates[part] = {}, {}
    local state = part.owner and state_of(self, part)
    if state and self.traits[part].is_bound then
      state.bound[#state.bound + 1] = part
    elseif state then
      state.groups = with_region(state.groups, self.traits, part)
      local group = state.groups[#state.groups]
      for _, mate in ipairs(group) do self.mates[mate] = group end
    end
  end
end

-- Ways ..............................................................................

-- Merges lists of ways into one list; here a way is a list of parts. The first way has
-- the parts of all first ways, and so on. A list that is shorter repeats its last way.
local function side_by_side(lists)
  local result, count = {}, 1
  for _, list in ipairs(lists) do count = max(count, #list) end
  for k = 1, count do
    result[k] = {}
    for _, list in ipairs(lists) do
      result[k] = match.joined(result[k], list[min(k, #list)] or {})
    end
  end
  return result
end

local ways_of

-- Returns ways that each have all regions of a group. Of the regions inside of these
-- regions, each way has one group.
local function ways_of_group(self, group)
  local lists = { { group } }
  for _, part in ipairs(group) do lists[#lists + 1] = ways_of(self, part) end
  return side_by_side(lists)
end

-- Returns the ways of the regions of a part. In each state with regions, all bound
-- regions are in each way, and the groups take turns.
function ways_of(self, part)
  local lists = {}
  for _, state in ipairs(self.states[part]) do
    local list = {}
    for _, group in ipairs(state.groups) do
      list = match.joined(list, ways_of_group(self, group))
    end
    lists[#lists + 1], lists[#lists + 2] = ways_of_group(self, state.bound), list
  end
  return side_by_side(lists)
end

-- Adds a part to a way, with the parts around it, its group, and its bound regions.
local function add_part(self, way, part)
  if not part or way[part.prefix] then return end
  way[part.prefix] = true
  add_part(self, way, part.owner)
  for _, mate in ipairs(self.mates[part]) do add_part(self, way, mate) end
  for _, state in ipairs(self.states[part]) do
    for _, region in ipairs(state.bound) do add_part(self, way, region) end
  end
end

-- Returns the way that has some parts and all parts that they need; false if it has all
-- parts of the subject. Equal ways are one table.
local function way_of(self, parts)
  local way = {}
  add_part(self, way, self.own.parts[1])
  for _, part in ipairs(parts) do add_part(self, way, part) end
  local names = rfsm.sorted_keys(way)
  if #names == #self.own.parts then return false end
  local key = concat(names, "\n")
  self.ways[key] = self.ways[key] or way
  return self.ways[key]
end

-- Properties ........................................................................

-- Appends the parts whose callbacks set a flag.
local function add_setters(own, parts, number)
  for name, flags in order.each(own.flags_of) do -- any order: a set
    for _, flag in ipairs(flags) do
      if flag.number == number then parts[#parts + 1] = own.callbacks[name] end
    end
  end
end

-- Appends the parts of the states and flags that a condition names. Returns false for a
-- function, whose states are not known.
local function add_named(own, parts, condition)
  if type(condition) == "function" then return false end
  for _, name in ipairs(type(condition) == "table" and condition or { condition }) do
    local number = own.flag_numbers[name]
    if number then add_setters(own, parts, number) end
    parts[#parts + 1] = own.part_of[name]
  end
  return true
end

-- Appends the parts that react to an event, or in which a step may "pass" a state.
local function add_reacting(self, parts, word)
  for _, part in ipairs(self.own.parts) do
    local traits, passes = self.traits[part], word == "pass" and part.may_pass
    if passes or traits.is_any or traits.events[word] then parts[#parts + 1] = part end
  end
end

-- Appends the parts of which an observer hears or asks. Returns false if these may be
-- all parts.
local function add_heard(self, parts, observer)
  local own = self.own
  for _, word in ipairs(observer.words) do
    local kind, path = observers.element_of(word)
    if own:maker_of(word) or kind == "taken" then return false end
    parts[#parts + 1] = kind and own.part_of[path] or nil
    add_reacting(self, parts, word)
  end
  for _, condition in ipairs(observer.conditions) do
    if not add_named(own, parts, condition) then return false end
  end
  return true
end

-- Returns the way of the walk on which a property is judged. It has all parts if the
-- property has a function, or an event that machines make themselves.
local function way_for(self, judged)
  local own, parts, event = self.own, {}, judged.event
  local property = judged.property
  if judged.observer then
    return add_heard(self, parts, judged.observer) and way_of(self, parts)
  end
  local are_known = add_named(own, parts, property.what)
    and add_named(own, parts, property.goal)
    and add_named(own, parts, property.scope)
  if not are_known or event ~= nil and (own:maker_of(event)
    or observers.element_of(event)) then
    return false
  end
  if event ~= nil then add_reacting(self, parts, event) end
  return way_of(self, parts)
end

local function is_timed(list)
  return any(list, function(judged) return judged.property.seconds end)
end

--- Plan the walks of a chart, and set the field `way` of its properties.
---@param own rfsm_checks.Subject
---@param list rfsm_checks.Judged[]
---@param options rfsm_checks.Options
---@return rfsm_checks.Way[] ways
function independence.ways(own, list, options)
  for _, judged in ipairs(list) do judged.way = false end
  local are_apart = not (options.multiply or options.dry_run or own.writers[1]
    or own.later[1] or own.late_senders[1])
  if not (are_apart and own.parts[2]) then return { false } end
  local self, ways = { own = own, states = {}, mates = {}, ways = {} }, {}
  self.traits = traits_of(own, is_timed(list), options.timers == "free")
  find_groups(self)
  for i, parts in ipairs(ways_of(self, own.parts[1])) do
    ways[i] = way_of(self, parts)
  end
  for _, judged in ipairs(ways[2] and list or NOTHING) do
    judged.way = way_for(self, judged)
  end
  return ways
end

return independence
