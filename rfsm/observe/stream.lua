--- What a machine does, as one stream of values in one order, on every Lua.
--
-- A listener is a table of functions. Only what it has is looked for. Each is called
-- with where something happens, an entry of `rfsm.machines`, and values:
--
--    began(at, events)                    an iteration begins, before other hooks
--    guard(at, tr, own, events)           called in place of the guard `own`
--    taken(at, path, events)              these transitions are about to be taken
--    entered(at, state)                   before its entry
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
local order = require "rfsm.shared.order"
local rfsm = require "rfsm"

local ipairs, setmetatable = ipairs, setmetatable

--- A listener that follows a machine.
---@class rfsm.observe.Stream
---@field fsm rfsm.Machine
---@field machines table[] as `rfsm.machines`
---@field listener table<string, function>
---@field changes table[] the hooks and guards
---@field is_known table<table, true> elements of the machines
local Stream = {}
Stream.__index = Stream

local stream = {}

local function attach_element(own, at, element)
  local listener = own.listener
  if rfsm.is_state(element) and listener.entered then
    instrument.hook_of(own.changes, at.machine, "entry", element, function(_, state)
      listener.entered(at, state)
    end)
  elseif rfsm.is_trans(element) and listener.guard and element.guard then
    local guard = element.guard
    instrument.put(own.changes, element, "guard", function(_, events)
      return listener.guard(at, element, guard, events)
    end)
  end
end

-- Has the states and guards of an element tell of themselves, unless they do.
local function attach_elements(own, at, top)
  for _, element in ipairs(rfsm.elements(top)) do
    if not own.is_known[element] then attach_element(own, at, element) end
    own.is_known[element] = true
  end
end

local join

local WATCHED = { "failed", "sent", "resumed", "ended" }

-- The kind of a hook, and its place among them.
local HOOKS = { began = { "pre_step", "front" }, finished = { "post_step", "before" },
  passed = { "post_step", "after" }, reset = { "reset" } }

local function attach(own, at)
  local listener, fsm, changes = own.listener, at.machine, own.changes
  for _, what in ipairs(WATCHED) do
    local f = listener[what]
    if f then
      instrument.hook_of(changes, fsm, "watch", what, function(_, ...) f(at, ...) end)
    end
  end
  instrument.hook_of(changes, fsm, "watch", "merged", function(_, element)
    join(own)
    attach_elements(own, at, element)
    if listener.merged then listener.merged(at, element) end
  end)
  attach_elements(own, at, fsm)
  if listener.taken then
    instrument.hook(changes, fsm, "path", function(_, path)
      if path[1] then listener.taken(at, path, fsm._curq) end
    end)
  end
  for name, hook in order.each(HOOKS) do -- any order: each has its place
    local f = listener[name]
    if f then
      instrument.hook(changes, fsm, hook[1], function(_, ...) f(at, ...) end,
        hook[2])
    end
  end
end

-- Follows the machines that are not followed yet.
function join(own)
  own.machines = rfsm.machines(own.fsm)
  for _, at in ipairs(own.machines) do
    if not own.is_known[at.machine] then attach(own, at) end
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
