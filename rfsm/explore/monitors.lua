--- Monitors: judge properties of runs, step by step.
--
-- A monitor looks at each step. Its state is a word, "first" in the beginning. It also
-- has a list of clocks, the oldest one first; a clock expires when the time of the
-- property is over. An exploration stores state and clocks with each configuration; for
-- a running machine they are in a table. Conditions are judged at the end of a step.
-- Some kinds also look at the states that a step *passes*: enters and leaves again.
--
-- @module rfsm.explore.monitors
-- @license BSD-3-Clause

local order = require "rfsm.shared.order"

local ipairs, type = ipairs, type

local monitors = {}

--- The view of a step that a monitor has.
---@class rfsm_checks.Look
---@field active fun(name: string): boolean is the state or flag active?
---@field came boolean the event of the property came
---@field is_end boolean the step ends; otherwise it only passes a state
---@field expired integer how many clocks have expired
---@field count integer how many clocks there are
---@field is_idle? boolean for running machines: nothing happens before an event comes
---@field observer? rfsm_checks.Observer the observer that judges the property
---@field heard? rfsm_checks.Heard[] what it hears of the step
---@field is_at_rest? boolean for running machines: it is idle, and no timer is armed

--- Does a condition hold?
---@param condition any see `rfsm.explore.properties`
---@param active fun(name: string): boolean
---@return boolean
function monitors.holds(condition, active)
  if type(condition) == "function" then return condition(active) and true or false end
  for _, name in ipairs(type(condition) == "table" and condition or { condition }) do
    if not active(name) then return false end
  end
  return true
end

--- Ask for all names in a condition; `active` raises an error for a wrong one. A
--- function is called twice: all states are active, or none.
---@param condition any
---@param active fun(name: string): boolean
function monitors.ask_all(condition, active)
  if type(condition) ~= "function" then
    local names = type(condition) == "table" and condition or { condition }
    for _, name in ipairs(names) do active(name) end
    return
  end
  for _, answer in ipairs { true, false } do
    condition(function(name)
      active(name)
      return answer
    end)
  end
end

local holds = monitors.holds

local NONE, NEW = {}, { 0 }

-- Returns the next clocks: the numbers `first` to `count` of the clocks that stay, then
-- 0 if there is a new clock.
local function clocks_from(first, count, is_new)
  local clocks = {}
  for i = first, count do clocks[#clocks + 1] = i end
  if is_new then clocks[#clocks + 1] = 0 end
  return clocks
end

--- A kind of property.
---@class rfsm_checks.Kind
---@field text string the text of a property; its field `what` replaces {what}
---@field passes? boolean its monitor also looks at the states that a step passes
---@field owes? string the state that its monitor must leave eventually
---@field next? string the state after a violation, if there can be only one violation
---@field unseen? string the state if the machine was entered unseen (default: `next`)
---@field see? function looks at a step, with the parameters and results of
-- `monitors.look`; nil for `from`, which no single run can violate
---@field judge? fun(walk: rfsm_checks.Walk, judged: rfsm_checks.Judged) judges it when
-- a walk is over; nil if its monitor looks at the steps of the walk instead

--- The kinds of properties by name.
---@type table<string, rfsm_checks.Kind>
local kinds = {
  never = { text = "never {what}", passes = true },
  always = { text = "always {what}" },
  after = { text = "after {event} reach {goal}" },
  from = { text = "from {what} can reach {goal}" },
  leads_to = { text = "after {event} leads to {goal}", owes = "owed" },
  after_never = { text = "after {event} never {goal}", passes = true },
  observer = { text = "observer" },
  never_until = { text = "after {event} never {goal}" },
  unless = { text = "always {what}", unseen = "root.free" },
  precedes = { text = "{what} precedes {goal}", next = "root.seen" },
  ["until"] = { text = "{what} until {goal}", owes = "first", next = "done" },
  reach_within = { text = "after {event} reach {goal} within {seconds} s" },
  never_within = { text = "after {event} never {goal} within {seconds} s" },
  left_within = { text = "from {what} left within {seconds} s" },
  stays = { text = "from {what} stays {seconds} s", unseen = "old" },
  at_most = { text = "at most {count} {event} within {seconds} s" },
  at_least = { text = "at least {count} {event} within {seconds} s" },
}
monitors.kinds = kinds

function kinds.never.see(property, _, look)
  return holds(property.what, look.active) and "violated" or "first"
end

function kinds.always.see(property, state, look)
  return holds(property.what, look.active) and state or "violated"
end

-- Returns a function that sees if the goal is owed at a moment when it must not be.
local function owed_until(moment)
  return function(property, state, look)
    if holds(property.goal, look.active) then return "first" end
    if look.came then state = "owed" end
    return state == "owed" and look[moment] and "violated" or state
  end
end

kinds.leads_to.see, kinds.after.see = owed_until "is_at_rest", owed_until "is_idle"

function kinds.after_never.see(property, state, look)
  if look.is_end and look.came then state = "since" end
  if state == "first" or not holds(property.goal, look.active) then return state end
  return "violated"
end

-- The state is the leaf of an observer.
local function observe(_, state, look) return look.observer:next(state, look.heard) end

for _, kind in ipairs { "observer", "never_until", "unless", "precedes" } do
  kinds[kind].see = observe
end

kinds["until"].see = function(property, state, look)
  if state == "done" then return state end
  if holds(property.goal, look.active) then return "done" end
  local is_broken = look.is_at_rest or not holds(property.what, look.active)
  return is_broken and "violated" or state
end

function kinds.reach_within.see(property, state, look)
  if holds(property.goal, look.active) then return "first", NONE end
  if look.expired > 0 then return "violated", NONE end
  if state == "first" and look.came then return "owed", NEW end
  return state
end

function kinds.never_within.see(property, state, look)
  local is_bound = look.came or state == "owed" and look.expired == 0
  if is_bound and holds(property.goal, look.active) then return "violated", NONE end
  if look.came then return "owed", NEW end
  return is_bound and state or "first", not is_bound and NONE or nil
end

function kinds.left_within.see(property, state, look)
  if not holds(property.what, look.active) then return "first", NONE end
  if look.expired > 0 then return "violated", NONE end
  if state == "first" then return "owed", NEW end
  return state
end

-- When the condition begins to hold, a clock is started. The condition has to hold
-- until the clock expires.
function kinds.stays.see(property, state, look)
  if holds(property.what, look.active) then
    if state == "first" then return "young", NEW end
    if look.expired > 0 then return "old", NONE end
    return state
  end
  if state == "young" and look.expired == 0 then return "violated", NONE end
  return "first", NONE
end

function kinds.at_most.see(property, state, look)
  local left = look.count - look.expired
  if look.came and left >= property.count then return "violated", NONE end
  return state, clocks_from(look.expired + 1, look.count, look.came)
end

-- There are `count` clocks, one for each of the last events. At the entry of the
-- machine all of them begin, as if the events had come then.
function kinds.at_least.see(property, state, look)
  if state == "first" then
    local clocks = {}
    for i = 1, property.count do clocks[i] = 0 end
    return "on", clocks
  end
  if look.expired > (look.came and 1 or 0) then return "violated", NONE end
  return state, look.came and clocks_from(2, look.count, true) or nil
end

--- Have a monitor look at a step.
---@param property rfsm_checks.Property
---@param state string the present state of the monitor
---@param look rfsm_checks.Look
---@return string state the next state; "violated" if the property does not hold
---@return integer[]? clocks the numbers of the clocks that stay, and 0 for a new clock;
-- nil if all clocks stay
function monitors.look(property, state, look)
  local kind = kinds[property.kind]
  if not (look.is_end or kind.passes) then return state end
  return kind.see(property, state, look)
end

-- Monitors of an exploration ........................................................

-- Returns how many clocks of a monitor there are in a configuration, and how many of
-- them have expired.
local function count_clocks(try, judged)
  local count, expired = 0, 0
  for i, entry in ipairs(try.group and try.conf.context.entries or {}) do
    if entry.clock.judged == judged then
      count = count + 1
      expired = expired + try.group.over[i]
    end
  end
  return count, expired
end

-- Has a monitor look at the states that the last step has passed, and at the end of the
-- step. Returns the next state of the monitor and the next clocks.
local function look_at(walk, judged, state, try, view)
  local own, property = walk.subject, judged.property
  local look = { came = false, is_end = false }
  look.count, look.expired = count_clocks(try, judged)
  look.observer = judged.observer
  for _, moment in ipairs(own.passed) do
    look.active = own:view_of_moment(moment)
    if state ~= "violated" then state = monitors.look(property, state, look) end
  end
  if state == "violated" then return state, {} end
  look.active, look.is_end = view, true
  look.heard = own:heard_words(view, judged.observer)
  look.came = judged.event ~= nil and own.parts[1].position.leaf
    and own:has_come(judged.event) or false
  if look.came and property.scope then
    look.came = holds(property.scope, own:view(try.conf))
  end
  judged.has_come = judged.has_come or look.came
    or order.any(look.heard, function(each) return each.word == property.event end)
  return monitors.look(property, state, look)
end

local function is_decided(judged) return judged.holds ~= nil end

--- Have the monitors of a walk look at the last step; return their next states and
--- clocks. A monitor that has found a violation looks no more.
---@param walk rfsm_checks.Walk
---@param try rfsm_checks.Try the step
---@param key string of the configuration to which the step has led
---@param label fun(): string returns the label of the step
---@return string[] states the next ones, in the order of `walk.monitors`
---@return table<rfsm_checks.Judged, integer[]> clocks see `monitors.look`
function monitors.after(walk, try, key, label)
  local own, states, clocks = walk.subject, try.conf.context.states, {}
  local is_entered = own.parts[1].fsm._act_leaf
  if not (is_entered and walk.monitors[1]) then return states, clocks end
  local view, next_states = own:view(own:configuration(key)), {}
  for i, judged in ipairs(walk.monitors) do
    local state, own_clocks = "violated", NONE
    if states[i] ~= state then
      state, own_clocks = look_at(walk, judged, states[i], try, view)
    end
    if state == "violated" and judged.holds == nil then
      judged.holds, judged.at, judged.label = false, try.from, label()
      walk.has_ended = order.all(walk.monitors, is_decided)
    end
    next_states[i], clocks[judged] = state, own_clocks
  end
  return next_states, clocks
end

return monitors
