--- Structure: nodes that nothing reaches or leaves, callbacks that nobody calls.
--
-- @module rfsm.checks.structure
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local codes = require "rfsm.checks.codes"
local place = require "rfsm.checks.place"

local ipairs = ipairs
local is_conn, is_leaf = rfsm.is_conn, rfsm.is_leaf

local structure = {}

-- Marks a node that a transition leads to, and the composites that it is in.
local function mark(reached, pending, node)
  while not reached[node] do
    reached[node] = true
    pending[#pending + 1] = node
    node = node._parent
  end
end

--- Return the set of nodes that some path of transitions leads to.
---@param fsm rfsm.Machine
---@return table<table, boolean> reached
function structure.reached(fsm)
  local reached, pending = {}, {}
  mark(reached, pending, fsm)
  if fsm.initial then mark(reached, pending, fsm.initial) end
  while pending[1] do
    local node = pending[#pending]
    pending[#pending] = nil
    for _, tr in ipairs(node._otrs) do mark(reached, pending, tr.tgt) end
  end
  return reached
end

local function has_way_out(fsm, state)
  for _, node in ipairs(place.line(fsm, state)) do
    if node._otrs[1] then return true end
  end
  return false
end

-- Finds nodes that nothing leads to, and those that nothing leads away from, but not
-- in an unreachable composite. One that is entered elsewhere may have an `initial`.
local function check_node(fsm, node, reached, add)
  if not reached[node] then
    if reached[node._parent] and node._id ~= "initial" then
      add("unreachable", node, "unreachable, no path of transitions leads here")
    end
  elseif is_conn(node) and not node._otrs[1] then
    add("connector-end", node, "no way out of this connector, so that no transition to "
      .. "it is ever taken")
  elseif node ~= fsm and is_leaf(node) and not node.final
    and not has_way_out(fsm, node) then
    add("dead-end", node, "no exit, neither this state nor one around it is ever left",
      codes.is_named_as_end(node) and "note")
  end
end

local NEVER_CALLED = {
  state = { "guard", "effect" }, transition = { "entry", "exit", "doo" },
  connector = { "entry", "exit", "doo", "guard", "effect" },
}

local function check_callbacks(obj, add)
  local kind = rfsm.kind_of(obj)
  for _, field in ipairs(NEVER_CALLED[kind]) do
    if rfsm.is_callable(obj[field]) then
      add("never-called", obj, ("the %s of a %s is never called"):format(field, kind))
    end
  end
end

--- Find what is wrong with nodes.
---@type rfsm_checks.Check
function structure.check(fsm, add)
  local reached = structure.reached(fsm)
  for _, obj in ipairs(rfsm.elements(fsm)) do
    if rfsm.is_node(obj) then check_node(fsm, obj, reached, add) end
    check_callbacks(obj, add)
  end
end

return structure
