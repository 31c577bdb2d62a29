--- The short way in and out of a machine in Redis: what `snapshot.put` and
-- `snapshot.take` do, for the usual case.
--
-- It trusts snapshots that this library wrote, of the same chart. Whatever it does not
-- know it leaves: then nothing has changed, and the caller takes the long way. Without
-- this file all is the same, but slower.
--
-- @module rfsm.redis.short
-- @license BSD-3-Clause

local charts = require "rfsm.snapshot.chart"
local plain = require "rfsm.snapshot.plain"
local rfsm = require "rfsm"

local next, type = next, type
local is_safe = plain.is_safe

local short = {}

--- What is known of a chart.
---@class rfsm.redis.Short
---@field is_usable boolean no functions `save` and `load`, no regions
---@field leaves table<string, rfsm.State> by FQN
---@field keepers table[] as `rfsm.snapshot.Keeper`, each with its `state`
---@field nodes table[] targets of the transitions, as the model names them
---@field transitions rfsm.Transition[]
---@field hooks table[] of extensions
---@field are_targets_moved boolean the last machine has left other targets
---@field how table for the hooks

local function new_short(fsm)
  local known, nodes = charts.of(fsm), charts.nodes(fsm)
  local self = { is_usable = not (known.has_load or known.owners[1]), leaves = {},
    keepers = {}, nodes = {}, transitions = charts.transitions(fsm),
    hooks = charts.hooks(fsm), are_targets_moved = true,
    how = { is_migrated = false, is_new = function() return false end } }
  for _, leaf in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do
    self.leaves[leaf._fqn] = leaf
  end
  for i, keeper in ipairs(known.keepers) do
    self.keepers[i] = { state = nodes[keeper.index], fqn = keeper.fqn,
      names = keeper.names, kept = keeper.kept, first = keeper.first }
  end
  for i, index in ipairs(known.targets) do self.nodes[i] = nodes[index] end
  return self
end

local function of(chart)
  if not chart.short then chart.short = new_short(chart.fsm) end
  return chart.short
end

--- Return when the first timer of a machine expires that was taken.
---@param timers table<string, any> what the extension keeps: the time that is left of
--- e_after, the time of e_at
---@param now number
---@return number? time nil if none does
function short.next_expiry(timers, now)
  local least = nil
  for name, left in next, timers do -- any order: the least
    local time = left[1] + left[2] / 1e9 + (name:find("^e_at") and 0 or now)
    if not least or time < least then least = time end
  end
  return least
end

-- May all fields be set? They have no other names, and each state that has some keeps
-- them.
local function are_known(keepers, data)
  if not data then return true end
  local count = 0
  for i = 1, #keepers do
    local fields = data[keepers[i].fqn]
    if fields then
      count = count + 1
      if type(fields) ~= "table" or fields[1] ~= nil then return false end
      for name in next, fields do
        if not keepers[i].kept[name] then return false end
      end
    end
  end
  for _ in next, data do count = count - 1 end
  return count == 0
end

local NONE = {}

local function set_fields(keepers, data)
  for i = 1, #keepers do
    local keeper = keepers[i]
    local state, names, first = keeper.state, keeper.names, keeper.first
    local fields = data[keeper.fqn] or NONE
    for j = 1, #names do
      local name = names[j]
      local value = fields[name]
      if value == nil then
        value = plain.copy_of(first[name])
      elseif type(value) == "table" then
        value = plain.unpack(value, 2)
        if value == plain.NIL then value = nil end
      end
      state[name] = value
    end
  end
end

-- Is there nothing in a snapshot but a leaf, fields that are known, and extensions?
local function is_usual(self, snap)
  return self.is_usable and self.leaves[snap.leaf or ""] and snap.version == 2
    and not (snap.targets or snap.saved or snap.queue or snap.regions)
    and are_known(self.keepers, snap.data)
end

--- Put a snapshot of the same chart into the machine of a chart.
---@param chart rfsm.redis.Chart
---@param snap rfsm.snapshot.Snapshot
---@return boolean is_done false: nothing has changed
function short.put(chart, snap)
  local self, fsm, ext = of(chart), chart.fsm, snap.ext or NONE
  if self.are_targets_moved or not is_usual(self, snap) then
    self.are_targets_moved = false -- the long way sets them all
    return false
  end
  rfsm.place(fsm, self.leaves[snap.leaf], snap.done and "done" or "active", {})
  set_fields(self.keepers, snap.data or NONE)
  for i = 1, #self.hooks do
    local hook = self.hooks[i]
    local value = ext[hook.name]
    hook.load(fsm, value and plain.unpack(value, 2), self.how)
  end
  return true
end

-- Does a value stand for itself, in any encoder?
local function is_itself(value)
  local kind = type(value)
  return kind == "string" or kind == "boolean" or kind == "number" and is_safe(value)
end

-- Returns the fields of a keeper; nil and true if they need the long way.
local function take_fields(keeper)
  local state, names, first, fields = keeper.state, keeper.names, keeper.first, nil
  for i = 1, #names do
    local name = names[i]
    local value = state[name]
    if value ~= nil and name ~= "n" and is_itself(value) then
      fields = fields or {}
      fields[name] = value
    elseif value ~= nil or first[name] ~= nil then
      return nil, true
    end
  end
  return fields
end

-- Returns the data of all keepers; nil and true if it needs the long way.
local function take_data(keepers)
  local data = nil
  for i = 1, #keepers do
    local fields, is_long = take_fields(keepers[i])
    if is_long then return nil, true end
    if fields then
      data = data or {}
      data[keepers[i].fqn] = fields
    end
  end
  return data
end

local function take_extensions(hooks, fsm)
  local ext, timers = nil, NONE
  for i = 1, #hooks do
    local hook = hooks[i]
    local value = hook.save(fsm)
    if value ~= nil then
      ext = ext or {}
      ext[hook.name] = plain.pack(value, { owner = hook.name, prefix = "root", base = 4,
        seen = {} }, 0)
      if hook.name == "timers" then timers = value end
    end
  end
  return ext, timers
end

-- Does each transition lead where the model says?
local function are_targets_first(self)
  local transitions, nodes = self.transitions, self.nodes
  for i = 1, #transitions do
    if transitions[i].tgt ~= nodes[i] then return false end
  end
  return true
end

--- Take a snapshot of the machine of a chart.
---@param chart rfsm.redis.Chart
---@return rfsm.snapshot.Snapshot? snap nil if the long way is to be taken
---@return table<string, any>? timers see `next_expiry`
function short.take(chart)
  local self, fsm = of(chart), chart.fsm
  local leaf = fsm._act_leaf
  self.are_targets_moved = not are_targets_first(self)
  if self.are_targets_moved or not (self.is_usable and leaf) or fsm._intq[1] ~= nil then
    return nil
  end
  local data, is_long = take_data(self.keepers)
  if is_long then return nil end
  local ext, timers = take_extensions(self.hooks, fsm)
  return { version = 2, chart = chart.fingerprint, leaf = leaf._fqn,
    done = leaf._mode == "done" or nil, data = data, ext = ext }, timers
end

return short
