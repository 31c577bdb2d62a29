--- Reactions: the events that can have an effect while a leaf is active.
--
-- @module rfsm.checks.reactions
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local ipairs, rawequal, type = ipairs, rawequal, type
local is_conn = rfsm.is_conn

local reactions = {}

local add_reactions

local function add_reaction(found, tr, seen)
  local events = tr.events or {}
  if events[1] == nil then found.any = true end
  for _, event in ipairs(events) do
    if type(event) == "function" then
      found.has_predicate, found.any = true, true
    elseif not found.set[event] then
      found.set[event], found[#found + 1] = true, event
    end
  end
  if is_conn(tr.tgt) then add_reactions(found, tr.tgt, seen) end
end

-- Collects the events of the transitions from a node, and of those behind connectors.
function add_reactions(found, node, seen)
  if seen[node] then return end
  seen[node] = true
  for _, tr in ipairs(node._otrs) do add_reaction(found, tr, seen) end
end

-- Lists the nodes whose transitions count in a leaf; in none, the way in.
local function nodes_of(part, leaf)
  if not leaf then
    return { rfsm.is_composite(part.fsm) and part.fsm.initial or nil }
  end
  local nodes, node = {}, leaf
  while node do
    nodes[#nodes + 1] = node
    node = node ~= part.fsm and node._parent
  end
  return nodes
end

--- List the events that can have an effect in a leaf, false for no leaf.
---@param part rfsm_checks.Part
---@param leaf rfsm.State|false
---@return { any: boolean, has_predicate: boolean, set: table } events a list, and a set
function reactions.of(part, leaf)
  local known = part.known[leaf]
  if known.reactions then return known.reactions end
  local found, seen = { set = {}, any = false, has_predicate = false }, {}
  if not leaf then found.set.e_init_fsm = true end
  for _, node in ipairs(nodes_of(part, leaf)) do add_reactions(found, node, seen) end
  known.reactions = found
  return found
end

-- Sets of events ....................................................................

local function has(list, event)
  for i = 1, #list do
    if rawequal(list[i], event) then return true end
  end
  return false
end

-- Lists what a segment may add to the events that its path has needed so far: false for
-- nothing; predicates are left out.
local function additions(tr, set)
  local list = {}
  for _, event in ipairs(tr.events or {}) do
    if has(set, event) then return { false } end
    if type(event) ~= "function" then list[#list + 1] = event end
  end
  return list[1] ~= nil and list or { false }
end

local function copy_of(list)
  local copy = {}
  for i = 1, #list do copy[i] = list[i] end
  return copy
end

local MANY_SETS = 100 -- of one leaf; more are not tried

local add_sets

local function add_sets_behind(found, tr, set, seen)
  if is_conn(tr.tgt) then
    for _, way in ipairs(tr.tgt._otrs) do add_sets(found, way, set, seen) end
  elseif set[2] ~= nil then
    found[#found + 1] = copy_of(set)
  end
end

-- Adds the sets of several events that the paths from a transition on need.
function add_sets(found, tr, set, seen)
  if seen[tr] or #found >= MANY_SETS then return end
  seen[tr] = true
  for _, event in ipairs(additions(tr, set)) do
    local is_more = has(tr.events or {}, event)
    if is_more then set[#set + 1] = event end
    add_sets_behind(found, tr, set, seen)
    if is_more then set[#set] = nil end
  end
  seen[tr] = nil
end

--- List the sets of several events without which a path cannot be taken.
---@param part rfsm_checks.Part
---@param leaf rfsm.State|false
---@return any[][] sets
function reactions.sets_of(part, leaf)
  local known = part.known[leaf]
  if known.sets then return known.sets end
  known.sets = {}
  for _, node in ipairs(nodes_of(part, leaf)) do
    for _, tr in ipairs(node._otrs) do add_sets(known.sets, tr, {}, {}) end
  end
  return known.sets
end

return reactions
