--- What a machine does, as one stream of values in one order, on every Lua.
--
-- A listener is a table of functions. Only what it has is looked for. Each is called
-- with where something happens, an entry of `rfsm.machines`, and values:
--
--    began(at, events)                    an iteration begins, before other hooks
--    guard(at, tr, own, events)           called in place of the guard `own`
--    taken(at, path, events)              these transitions are about to be taken
--    left(at, state), entered(at, state)  by them, in order
--    failed(at, element, name, failure)   a callback
--    sent(at, event, ...)
--    resumed(at, leaf), ended(at, leaf)   a doo
--    finished(at, events)                 an iteration is over, before other hooks
--    passed(at, events)                   the same behind them; the machine rests if
--                                         `rfsm.is_idle`
--    reset(at)
--    merged(at, element)
--
-- Regions belong to the stream, and so does what is merged.
--
-- @module rfsm.observe.stream
-- @license BSD-3-Clause

local instrument = require "rfsm.shared.instrument"
local location = require "rfsm.shared.location"
local order = require "rfsm.shared.order"
local rfsm = require "rfsm"

local ipairs, rawequal, setmetatable = ipairs, rawequal, setmetatable

--- A listener that follows a machine.
---@class rfsm.observe.Stream
---@field fsm rfsm.Machine
---@field machines table[] as `rfsm.machines`
---@field listener table<string, function>
---@field changes table[] the hooks and guards
---@field is_known table<table, true> machines, and transitions with a guard
local Stream = {}
Stream.__index = Stream

local stream = {}

-- Returns the node to which a transition leads; nil for an internal one. A program may
-- have set a composite, which is entered by its initial.
local function target_of(tr)
  local tgt = tr.tgt
  if rawequal(tr.src, tgt) and rfsm.target_of(tr) == "internal" then return nil end
  return rfsm.is_conn(tgt.initial) and tgt.initial or tgt
end

local function enter(at, listener, state, outer)
  if state == outer then return end
  enter(at, listener, state._parent, outer)
  if listener.entered then listener.entered(at, state) end
end

local function leave(at, listener, state, outer)
  while state ~= outer do
    if listener.left then listener.left(at, state) end
    state = state._parent
  end
end

-- Tells which states a path leaves and enters: of each transition those in the state
-- that contains both ends.
local function tell_states(at, listener, path)
  local from = at.machine._act_leaf
  if not from then
    from = at.machine
    if listener.entered then listener.entered(at, from) end
  end
  for _, tr in ipairs(path) do
    local outer, tgt = tr.src._parent, target_of(tr)
    if tgt then
      while not location.is_inside(tgt._parent, outer) do outer = outer._parent end
      leave(at, listener, from, outer)
      enter(at, listener, rfsm.is_state(tgt) and tgt or tgt._parent, outer)
      from = tgt._parent
    end
  end
end

local function path_hook(listener, at)
  local has_states = listener.left or listener.entered
  return function(fsm, path)
    if listener.taken and path[1] then listener.taken(at, path, fsm._curq) end
    if has_states then tell_states(at, listener, path) end
  end
end

local function replace_guards(own, at, element)
  for _, tr in ipairs(rfsm.elements(element, rfsm.is_trans)) do
    local guard = tr.guard
    if guard and not own.is_known[tr] then
      own.is_known[tr] = true
      instrument.put(own.changes, tr, "guard", function(_, events)
        return own.listener.guard(at, tr, guard, events)
      end)
    end
  end
end

local join

local WATCHED = { "failed", "sent", "resumed", "ended" }

-- Where a listener hears of iterations: the kind of a hook, and its place among them.
local ITERATION = { began = { "pre_step", "front" },
  finished = { "post_step", "before" }, passed = { "post_step", "after" } }

local function attach(own, at)
  local listener, fsm, changes = own.listener, at.machine, own.changes
  for _, what in ipairs(WATCHED) do
    local f = listener[what]
    if f then
      instrument.watch(changes, fsm, what, function(_, ...) f(at, ...) end)
    end
  end
  instrument.watch(changes, fsm, "merged", function(_, element)
    join(own)
    if listener.guard then replace_guards(own, at, element) end
    if listener.merged then listener.merged(at, element) end
  end)
  if listener.guard then replace_guards(own, at, fsm) end
  if listener.taken or listener.left or listener.entered then
    instrument.hook(changes, fsm, "path", path_hook(listener, at))
  end
  for name, hook in order.each(ITERATION) do
    local f = listener[name]
    if f then
      instrument.hook(changes, fsm, hook[1], function(_, events) f(at, events) end,
        hook[2])
    end
  end
  if listener.reset then
    instrument.hook(changes, fsm, "reset", function() listener.reset(at) end)
  end
end

-- Follows the machines that are not followed yet.
function join(own)
  own.machines = rfsm.machines(own.fsm)
  for _, at in ipairs(own.machines) do
    if not own.is_known[at.machine] then
      own.is_known[at.machine] = true
      attach(own, at)
    end
  end
end

--- Follow no more: the machine has the hooks and guards that it had.
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
