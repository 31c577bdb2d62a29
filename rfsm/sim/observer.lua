--- The observer: follows a machine while it is advanced.
--
-- Each transition that is taken is printed when it begins, before the lines that its
-- callbacks print. Afterwards the observer knows which events were discarded, and which
-- breakpoints were hit.
--
-- @module rfsm.sim.observer
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local names = require "rfsm.observe.names"
local outline = require "rfsm.observe.outline"
local breakpoints = require "rfsm.observe.breakpoints"
local instrument = require "rfsm.shared.instrument"
local terminal = require "rfsm.sim.terminal"

local ipairs, print, rawequal, setmetatable = ipairs, print, rawequal, setmetatable
local concat, insert = table.concat, table.insert

local Observer = {}
Observer.__index = Observer

-- Paths and their transitions ---------------------------------------------------------

local function mark(node) return node._fqn .. "[" .. rfsm.fsmobj_tochar(node) .. "]" end

-- Lists the transitions of a machine by their two ends.
local function index(fsm)
  local by_ends = {}
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    if rfsm.is_node(tr.src) and rfsm.is_node(tr.tgt) then
      local ends = mark(tr.src) .. mark(tr.tgt)
      by_ends[ends] = by_ends[ends] or {}
      insert(by_ends[ends], tr)
    end
  end
  return by_ends
end

-- Splits "root.a[LS]->root.b[LS]" into its nodes, each with its mark.
local function split(path)
  local marks = {}
  for text in (path .. "->"):gmatch("(.-%[%a+%])%->") do marks[#marks + 1] = text end
  return marks
end

local function transitions_on(machine, marks)
  local found = {}
  machine.by_ends = machine.by_ends or index(machine.fsm)
  for i = 2, #marks do
    for _, tr in ipairs(machine.by_ends[marks[i - 1] .. marks[i]] or {}) do
      found[#found + 1] = tr
    end
  end
  return found
end

-- May the transition have been taken on this event? A predicate is not called again. A
-- transition without events counts if it leads away from a state.
local function takes(tr, event)
  local events = tr.events
  for i = 1, #events do
    if rawequal(events[i], event) or rfsm.is_callable(events[i]) then return true end
  end
  return events[1] == nil and rfsm.is_state(tr.src)
end

-- Records ---------------------------------------------------------------------------

function Observer:check_points(kind, value)
  breakpoints.each_reached(self.sim.points, kind, value, function(i)
    self.hits[i], self.is_hit = true, true
  end)
end

-- Notes the events that a transition has used; appends their texts to `by`.
function Observer:note_used(tr, events, by)
  for i = 1, events and #events or 0 do
    local event = events[i]
    if takes(tr, event) then
      self.is_used[event] = true
      if tr.events[1] ~= nil then
        by[#by + 1] = (rfsm.text_of(event):gsub("^(e_[%w()._]*)@root.*", "%1"))
      end
    end
  end
end

function Observer:note_path(machine, path)
  local marks, by = split(path), {}
  for i, tr in ipairs(transitions_on(machine, marks)) do
    self:check_points("transition", tr)
    self:note_used(tr, machine.events, i == 1 and by or {})
  end
  if not self.is_shown then return end
  for i, text in ipairs(marks) do
    marks[i] = names.full(machine.prefix, (text:gsub("%[%a+%]$", "")))
  end
  print("taken:  " .. concat(marks, " -> ") .. (by[1] and " on " .. concat(by, ", ")
    or ""))
end

function Observer:note(machine, id, text)
  if id == "EXEC_PATH" then
    self:note_path(machine, text)
  elseif id == "STATE_ENTER" then
    self:check_points("state", names.full(machine.prefix, text))
  end
end

function Observer:note_events(machine, events)
  terminal.insist()
  machine.events = {}
  for i = 1, #events do
    local event = events[i]
    machine.events[i] = event
    local is_noted = event ~= event or self.is_seen[event] or outline.is_own(event)
    if not is_noted then
      self.is_seen[event], self.seen[#self.seen + 1] = true, event
    end
    self:check_points("event", event)
  end
end

-- Attach and detach -----------------------------------------------------------------

function Observer:attach(machine)
  instrument.listen(self.changes, machine.fsm, "dbg", function(...)
    self:note(machine, ...)
  end)
  instrument.hook(self.changes, machine.fsm, "pre_step", function(_, events)
    self:note_events(machine, events)
  end, "after")
end

--- Observe no more. A `dbg` that was set meanwhile stays.
function Observer:detach() instrument.give_back(self.changes) end

--- List the events that no transition has taken and that no queue holds, as they came.
function Observer:discarded()
  local is_pending, list = {}, {}
  for _, machine in ipairs(self.machines) do
    for _, event in ipairs(machine.fsm._intq) do is_pending[event] = true end
  end
  for _, event in ipairs(self.seen) do
    if not (self.is_used[event] or is_pending[event]) then list[#list + 1] = event end
  end
  return list
end

local observer = {}

--- Observe the machine of a session and its regions; print the transitions taken if
-- they are to be shown.
function observer.attach(sim, is_shown)
  local self = setmetatable({ sim = sim, is_shown = is_shown, hits = {}, is_hit = false,
    is_seen = {}, seen = {}, is_used = {}, machines = {}, changes = {} }, Observer)
  for i, at in ipairs(rfsm.machines(sim.fsm)) do
    self.machines[i] = { fsm = at.machine, prefix = at.prefix }
    self:attach(self.machines[i])
  end
  return self
end

return observer
