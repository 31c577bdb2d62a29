--- Liveness of products: do the machines come to a goal, if doos end and each of them
--- moves again and again?
--
-- @module rfsm.system.liveness
-- @license BSD-3-Clause

local graph = require "rfsm.explore.graph"
local order = require "rfsm.shared.order"
local subject = require "rfsm.explore.subject"

local ipairs, setmetatable = ipairs, setmetatable

local liveness = {}

-- Notes in `is_fair` which machines a run does not neglect if it stays in the strongly
-- connected component of a configuration: a machine has nothing to do in the
-- configuration, or it has a move that stays in the component. Behind the machines it
-- notes which wires are read, if the reader reads one wire at a time.
local function note_fair(self, number, index_of, is_fair)
  local is_busy = {}
  graph.each_step(self, number, function(tgt, is_internal, at)
    local mover, stays = self.movers[at], index_of[tgt] == index_of[number]
    is_busy[mover] = is_busy[mover] or is_internal and tgt ~= number
    is_fair[mover] = is_fair[mover] or is_internal and stays
  end)
  for i in ipairs(self.members) do is_fair[i] = is_fair[i] or not is_busy[i] end
end

-- Could a machine that reads one wire at a time read the wire in a configuration?
local function is_readable(self, number, at)
  local conf, member = self.keys[number], self.wires[at].reader
  if not member.reads_one or conf.queues[at][1] == nil
    or conf.unsent[member.number][1] then return false end
  local own = member.confs[conf.numbers[member.number]]
  return own[1].leaf and not subject.is_driven(own)
end

-- Does a run neglect a wire if it comes to a configuration again and again? It does if
-- the wire could be read there, and is never read.
local function is_neglected(self, number, is_fair)
  for at in ipairs(self.wires) do
    if not is_fair[#self.members + at] and is_readable(self, number, at) then
      return true
    end
  end
  return false
end

-- Adds the configurations of a component to the set `staying`, if a run that stays in
-- the component neglects neither a machine nor a wire. If it neglects a wire, adds to
-- the set `parts` those in which the wire cannot be read.
local function note_component(self, numbers, index_of, staying, parts)
  local is_fair, rest = {}, {}
  for _, number in ipairs(numbers) do note_fair(self, number, index_of, is_fair) end
  for _, member in ipairs(self.members) do
    if not is_fair[member.number] then return end
  end
  for _, number in ipairs(numbers) do
    if not is_neglected(self, number, is_fair) then rest[#rest + 1] = number end
  end
  local set = #rest == #numbers and staying or parts
  for _, number in ipairs(rest) do set[number] = true end
end

-- Adds to the set `staying` the configurations of the set `open` between which a run
-- may stay for ever, without neglecting a machine or a wire.
local function note_staying(self, open, staying)
  local components, index_of = graph.components_in(self, open, true)
  local parts = {}
  for _, numbers in ipairs(components) do
    note_component(self, numbers, index_of, staying, parts)
  end
  if not order.is_empty(parts) then note_staying(self, parts, staying) end
end

--- Return the set of configurations from which moves without events from outside always
--- lead to one of `goals`, if doos end and each machine moves again and again.
---@param self table the exploration of the product
---@param goals table<integer, boolean> set of configurations
---@return table<integer, boolean> set
function liveness.must_reach(self, goals)
  local set, staying, open = {}, {}, {}
  for number = 1, self.expanded do open[number] = not goals[number] end
  note_staying(self, open, staying)
  self.open, self.staying = open, staying
  local can_stay = graph.can_reach(self, staying, true, open)
  for number = 1, #self.keys do
    set[number] = self.is_partial or not can_stay[number]
  end
  return set
end

-- Returns the moves from a configuration to the nearest one in which a run may stay, as
-- the last call of `must_reach` has found.
function liveness.way_to_stay(self, start)
  if self.staying[start] then return {} end
  local edges = setmetatable({}, { __index = function(_, number)
    local list = {}
    graph.each_step(self, number, function(tgt, is_internal, at)
      if is_internal and self.open[tgt] then
        list[#list + 1] = { from = number, tgt = tgt, label = self.step_labels[at] }
      end
    end)
    return list
  end })
  return graph.find_way(edges, start, function(edge) return self.staying[edge.tgt] end)
    or {}
end

return liveness
