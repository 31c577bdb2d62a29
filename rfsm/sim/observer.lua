--- The observer of a session: follows the machine while a command advances it.
--
-- Each path that is taken is printed before its callbacks run. After the advance the
-- observer knows what became of each event, and which breakpoints were hit.
--
-- @module rfsm.sim.observer
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local calls = require "rfsm.shared.calls"
local match = require "rfsm.shared.match"
local location = require "rfsm.shared.location"
local breakpoints = require "rfsm.observe.breakpoints"
local order = require "rfsm.shared.order"
local stream = require "rfsm.observe.stream"

local error, ipairs, print = error, ipairs, print
local rawequal, setmetatable = rawequal, setmetatable
local concat = table.concat
local text_of = rfsm.text_of

--- Follows a session while a command advances its machine.
---@class rfsm.sim.Observer
local Observer = {}
Observer.__index = Observer

-- Notes the breakpoints that are reached, each with the event.
function Observer:check_points(kind, value, event)
  breakpoints.each_reached(self.sim.points, kind, value, function(i, point)
    self.reached[#self.reached + 1] = { at = i, holds = point.holds, event = event }
  end)
end

--- Evaluate the conditions of the breakpoints that a step has reached, after the step.
-- A condition that fails with an error counts as true.
function Observer:check_conditions()
  local problem
  for _, each in ipairs(self.reached) do
    local ok, value = true, true
    if each.holds then ok, value = calls.try(each.holds, each.event) end
    if not ok then problem = ("breakpoint %d: %s"):format(each.at, text_of(value)) end
    self.hits[each.at] = self.hits[each.at] or not ok or value or nil
  end
  self.reached, self.is_hit = {}, not order.is_empty(self.hits)
  if problem then error(problem, 0) end
end

-- Returns the events that may have triggered a transition, if it names events. Nobody
-- asks its predicates.
local function triggers_of(tr, events)
  local list = {}
  for i = 1, tr.events[1] ~= nil and #events or 0 do
    if match.triggers(tr, events[i]) ~= false then list[#list + 1] = events[i] end
  end
  return list
end

-- Returns an event as text, without the state of an event that the machine makes.
local function short_text(event)
  return (rfsm.event_text(event, true):gsub("^(e_[%w()._]*)@root.*", "%1"))
end

function Observer:taken(at, path, events)
  local by, nodes = triggers_of(path[1], events), { location.path(path[1].src,
    at.prefix) }
  self.event = by[1] == nil and events[1] or by[1]
  for i, tr in ipairs(path) do
    self:check_points("transition", tr, self.event)
    nodes[i + 1] = location.path(tr.tgt, at.prefix)
  end
  if not self.is_shown then return end
  for i = 1, #by do by[i] = short_text(by[i]) end
  self:print_taken("taken:  " .. concat(nodes, " -> ")
    .. (by[1] and " on " .. concat(by, ", ") or ""))
end

-- Prints a line. If the next lines are equal, only counts them, and prints the count
-- before the first different line.
function Observer:print_taken(line)
  if line == self.line then
    self.times = self.times + 1
    return
  end
  if self.times > 1 then print(("        %d times"):format(self.times)) end
  if line then print(line) end
  self.line, self.times = line, 1
end

function Observer:entered(at, state)
  self:check_points("state", location.path(state, at.prefix), self.event)
end

function Observer:finished(_, events)
  for i = 1, #events do
    local event = events[i]
    local is_noted = event ~= event or self.is_seen[event]
      or match.maker_of(event) == "engine"
    if not is_noted then
      self.is_seen[event], self.seen[#self.seen + 1] = true, event
    end
    self:check_points("event", event, event)
  end
end

--- Start observing an advance of the machine. If `is_shown`, the paths are printed.
function Observer:begin(is_shown)
  self.is_on, self.is_shown, self.line, self.times = true, is_shown, false, 1
  self.hits, self.reached, self.is_hit, self.event = {}, {}, false, nil
  self.seen, self.is_seen, self.fates = {}, {}, {}
end

--- Stop observing.
function Observer:finish()
  self.is_on = false
  self:print_taken(false)
end

function Observer:fate(at, event, fate, who)
  local list = self.fates[fate] or {}
  for _, entry in ipairs(list) do
    if rawequal(entry.event, event) then return end
  end
  self.fates[fate], list[#list + 1] = list, { at = at, event = event, who = who }
end

--- List the events with a fate in the order they came, each once. An event that a hook
-- has sent again, so that it is pending, is left out.
---@param fate rfsm.Fate
---@return { at: rfsm.Place, event: any, who: rfsm.Use }[]
function Observer:with_fate(fate)
  local list = {}
  for _, entry in ipairs(self.fates[fate] or {}) do
    local is_pending = order.any(self.stream.machines, function(at)
      return match.has(at.machine._intq, entry.event)
    end)
    if not is_pending then list[#list + 1] = entry end
  end
  return list
end

local observer = {}

--- Return an observer of a session's machine and its regions.
function observer.new(sim)
  local self = setmetatable({ sim = sim, is_on = false }, Observer)
  local listener = {}
  for _, name in ipairs { "taken", "entered", "finished", "fate" } do
    listener[name] = function(...)
      if self.is_on then self[name](self, ...) end
    end
  end
  self.stream = stream.follow(sim.fsm, listener)
  return self
end

return observer
