--- The observer of a session: follows the machine while a command advances it.
--
-- Each path that is taken is printed before its callbacks run. After the advance the
-- observer knows which events were discarded, and which breakpoints were hit.
--
-- @module rfsm.sim.observer
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local calls = require "rfsm.shared.calls"
local match = require "rfsm.shared.match"
local location = require "rfsm.shared.location"
local breakpoints = require "rfsm.observe.breakpoints"
local stream = require "rfsm.observe.stream"

local error, ipairs, next, print = error, ipairs, next, print
local setmetatable = setmetatable
local concat = table.concat
local text_of = rfsm.text_of

local Observer = {}
Observer.__index = Observer

-- May this event have triggered the transition? Returns true if a predicate decides.
local function takes(tr, event)
  if match.is_any(tr) then return match.begins_on_any(tr) end
  return match.triggers(tr, event) ~= false
end

-- Adds an event to a set, unless it is NaN, which cannot be a key.
local function add(set, event)
  if event == event then set[event] = true end
end

function Observer:check_points(kind, value)
  breakpoints.each_reached(self.sim.points, kind, value, function(i, point)
    local list = point.holds and self.reached or self.hits
    list[i] = true
  end)
end

--- Evaluate the conditions of the breakpoints that a step has reached, after the step.
-- A condition that fails with an error counts as true.
function Observer:check_conditions()
  local problem
  for i, point in ipairs(self.sim.points) do
    if self.reached[i] then
      local ok, value = calls.try(point.holds)
      if not ok then problem = ("breakpoint %d: %s"):format(i, text_of(value)) end
      self.hits[i] = not ok or value or nil
    end
  end
  self.reached, self.is_hit = {}, next(self.hits) ~= nil
  if problem then error(problem, 0) end
end

-- Records in `is_used` the events that may have triggered a transition. Also appends
-- their texts to the list `by`, unless the transition names no events.
function Observer:note_used(tr, events, by)
  for i = 1, #events do
    local event = events[i]
    if takes(tr, event) then
      add(self.is_used, event)
      if tr.events[1] ~= nil then
        by[#by + 1] = (rfsm.event_text(event, true):gsub("^(e_[%w()._]*)@root.*", "%1"))
      end
    end
  end
end

function Observer:taken(at, path, events)
  local by, nodes = {}, { location.path(path[1].src, at.prefix) }
  for i, tr in ipairs(path) do
    self:check_points("transition", tr)
    self:note_used(tr, events, i == 1 and by or {})
    nodes[i + 1] = location.path(tr.tgt, at.prefix)
  end
  if not self.is_shown then return end
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
  self:check_points("state", location.path(state, at.prefix))
end

function Observer:finished(_, events)
  for i = 1, #events do
    local event = events[i]
    local is_noted = event ~= event or self.is_seen[event]
      or match.maker_of(event) == "engine"
    if not is_noted then
      self.is_seen[event], self.seen[#self.seen + 1] = true, event
    end
    self:check_points("event", event)
  end
end

--- Start observing an advance of the machine. If `is_shown`, the paths are printed.
function Observer:begin(is_shown)
  self.is_on, self.is_shown, self.line, self.times = true, is_shown, false, 1
  self.hits, self.reached, self.is_hit = {}, {}, false
  self.seen, self.is_seen, self.is_used = {}, {}, {}
end

--- Stop observing.
function Observer:finish()
  self.is_on = false
  self:print_taken(false)
end

--- List the discarded events in the order they came. They have triggered no transition
-- and are not pending.
function Observer:discarded()
  local is_pending, list = {}, {}
  for _, at in ipairs(self.stream.machines) do
    for _, event in ipairs(at.machine._intq) do add(is_pending, event) end
  end
  for _, event in ipairs(self.seen) do
    if not (self.is_used[event] or is_pending[event]) then list[#list + 1] = event end
  end
  return list
end

local observer = {}

--- Return an observer of a session's machine and its regions.
function observer.new(sim)
  local self = setmetatable({ sim = sim, is_on = false }, Observer)
  local listener = {}
  for _, name in ipairs { "taken", "entered", "finished" } do
    listener[name] = function(...)
      if self.is_on then self[name](self, ...) end
    end
  end
  self.stream = stream.follow(sim.fsm, listener)
  return self
end

return observer
