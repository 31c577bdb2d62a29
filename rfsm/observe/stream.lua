--- Calls a listener for all that a machine does, in the same order on every Lua.
--
-- A listener is a table with any of these functions. `at` is the entry of
-- `rfsm.machines` for the machine concerned, which may be a region.
--
--    began(at, events)                    an iteration begins, before other hooks
--    guard(at, tr, own, events, event)    called in place of the guard `own`
--    free(at, tr)                         a transition that needs no event is looked
--                                         at, before `began`; false forbids it
--    taken(at, path, events)              the transitions in `path` will be taken
--    entered(at, state), left(at, state)  a state is entered, before its entry; is left
--    failed(at, element, name, failure)   the callback `name` of an element has failed
--    sent(at, event, ...)                 events were sent
--    resumed(at, leaf), ended(at, leaf)   the doo of a leaf is resumed, has ended
--    finished(at, events)                 an iteration is over, before other hooks
--    passed(at, events)                   an iteration is over, after other hooks; the
--                                         machine is idle if `rfsm.is_idle` is true
--    fate(at, event, fate, who)           what became of an event ("taken", "kept",
--                                         "forwarded", "discarded"), and who used it
--    reset(at)                            the machine was reset
--    merged(at, element)                  `fsm_merge` has added an element
--
-- With the field `is_repeatable`, functions that an interrupt has cut short are called
-- again, as the hooks of `rfsm.repeatable` are.
--
-- Regions of the machine and elements that are merged later are followed, too.
--
-- @module rfsm.observe.stream
-- @license BSD-3-Clause

local instrument = require "rfsm.shared.instrument"
local order = require "rfsm.shared.order"
local rfsm = require "rfsm"

local ipairs, rawequal, setmetatable = ipairs, rawequal, setmetatable

--- A machine that a listener follows.
---@class rfsm.observe.Stream
---@field fsm rfsm.Machine
---@field machines table[] the latest result of `rfsm.machines`
---@field listener table<string, function>
---@field changes table[] hooks added and guards replaced, for `stop`
---@field is_known table<table, true> set of elements to which hooks were added
local Stream = {}
Stream.__index = Stream

local stream = {}

-- Returns a hook that calls f(at, ...) for the machine `at`. A program's copy of this
-- machine has the hook, too.
local function hook_for(own, at, f)
  local function hook(fsm, ...)
    if rawequal(fsm, at.machine) then f(at, ...) end
  end
  return own.listener.is_repeatable and rfsm.repeatable(hook) or hook
end

local function attach_state(own, at, state, kind, f)
  if not f then return end
  instrument.hook(own.changes, at.machine, kind, state,
    hook_for(own, at, function(_, element) f(at, element) end))
end

local function attach_transition(own, at, tr)
  local listener, done = own.listener, nil
  if listener.guard and tr.guard then
    done = instrument.put(own.changes, tr, "guard", function(asked, events, event)
      if not rawequal(asked, tr) then return done.was(asked, events, event) end
      return listener.guard(at, tr, done.was, events, event)
    end)
  end
  if listener.free and tr.always == true then
    local function look(asked)
      if not rawequal(asked, tr) or at.machine._phase ~= "always" then return true end
      return listener.free(at, tr)
    end
    instrument.hook(own.changes, at.machine, "guard", tr, look)
  end
end

local function attach_element(own, at, element)
  local listener = own.listener
  if rfsm.is_state(element) then
    attach_state(own, at, element, "entry", listener.entered)
    attach_state(own, at, element, "exit", listener.left)
  elseif rfsm.is_trans(element) then
    attach_transition(own, at, element)
  end
end

-- Adds hooks to the states in `top`, a machine or an added element, and replaces the
-- guards, only once for each element.
local function attach_elements(own, at, top)
  for _, element in ipairs(rfsm.elements(top)) do
    if not own.is_known[element] then attach_element(own, at, element) end
    own.is_known[element] = true
  end
end

local join

local WATCHED = { "failed", "sent", "resumed", "ended" }

-- Function of a listener -> the kind of the hook that calls it, and the hook's place.
local HOOKS = { began = { "pre_step", "front" }, finished = { "post_step", "before" },
  passed = { "post_step", "after" }, reset = { "reset" }, fate = { "fate" } }

local function attach(own, at)
  local listener, fsm, changes = own.listener, at.machine, own.changes
  for _, what in ipairs(WATCHED) do
    local f = listener[what]
    if f then instrument.hook(changes, fsm, "watch", what, hook_for(own, at, f)) end
  end
  local function merge(_, element)
    join(own)
    attach_elements(own, at, element)
    if listener.merged then listener.merged(at, element) end
  end
  instrument.hook(changes, fsm, "watch", "merged", hook_for(own, at, merge))
  attach_elements(own, at, fsm)
  if listener.taken then
    instrument.hook(changes, fsm, "path", hook_for(own, at, function(_, path)
      if path[1] then listener.taken(at, path, fsm._curq) end
    end))
  end
  for name, hook in order.each(HOOKS) do -- any order: each has its place
    local f = listener[name]
    if f then instrument.hook(changes, fsm, hook[1], hook_for(own, at, f), hook[2]) end
  end
end

-- Adds hooks to the machine and its regions, but only once to each.
function join(own)
  own.machines = rfsm.machines(own.fsm)
  for _, at in ipairs(own.machines) do
    if not own.is_known[at.machine] then attach(own, at) end
  end
end

--- Stop following the machine, and restore its hooks and guards.
function Stream:stop() instrument.give_back(self.changes) end

--- Follow a machine and its regions.
---@param fsm rfsm.Machine
---@param listener table<string, function>
---@return rfsm.observe.Stream
function stream.follow(fsm, listener)
  local own = setmetatable({ fsm = fsm, listener = listener, changes = {},
    is_known = {} }, Stream)
  join(own)
  return own
end

return stream
