--- Finds cycles of leaves that a machine runs through without events from outside, so
-- that `rfsm.run` never returns.
--
-- @module rfsm.checks.loops
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local match = require "rfsm.shared.match"
local location = require "rfsm.shared.location"

local ipairs = ipairs
local concat = table.concat
local is_conn = rfsm.is_conn

local loops = {}

-- Returns the first transition that the event triggers; nil if there is none, or if a
-- guard or predicate decides.
local function find_taken(transitions, event)
  for _, tr in ipairs(transitions) do
    local is_wanted = match.triggers(tr, event)
    if is_wanted == nil or is_wanted and tr.guard then return nil end
    if is_wanted then return tr end
  end
end

-- Returns the first transition that needs no event; nil if there is none, or if a guard
-- decides. The second result is true if there is one.
local function find_always(transitions)
  for _, tr in ipairs(transitions) do
    if tr.always == true then return not tr.guard and tr or nil, true end
  end
end

-- Returns the leaf to which a transition that needs no event, or e_done, leads from a
-- leaf, and the transitions on this path; the third result is true for the former.
-- Returns nil if there is no such path, or if a guard decides.
local function follow(fsm, leaf)
  local event, path = "e_done@" .. leaf._fqn, {}
  local tr, is_always = find_always(location.transitions(fsm, leaf))
  if not is_always and not leaf.doo then
    tr = find_taken(location.transitions(fsm, leaf), event)
  end
  if tr and is_always and rfsm.target_of(tr) == "internal" then
    return leaf, { tr }, true
  end
  if is_always then event = nil end
  while tr and rfsm.target_of(tr) ~= "internal" do
    path[#path + 1] = tr
    if not is_conn(tr.tgt) then return tr.tgt, path, is_always end
    if path[100] then return nil end -- connectors in a circle
    tr = find_taken(tr.tgt._otrs, event)
  end
end

-- Could a callback send an event that triggers a transition not in the set `taken`?
local function may_be_left(fsm, leaves, taken)
  local has_callback, has_exit = false, false
  for _, leaf in ipairs(leaves) do
    for _, node in ipairs(location.line(fsm, leaf)) do
      has_callback = has_callback or node.entry or node.exit
      for _, tr in ipairs(node._otrs) do
        has_callback = has_callback or taken[tr] and tr.effect
        has_exit = has_exit or not taken[tr]
      end
    end
  end
  return has_callback and has_exit
end

-- Returns the leaves of a cycle that contains `start` and is never left, `start` first.
-- Returns nil or false if there is no such cycle. No event ends a cycle of transitions
-- that need none.
local function find_cycle(fsm, start)
  local leaves, taken, leaf, needs_event = {}, {}, start, false
  repeat
    if taken[leaf] then return nil end
    leaves[#leaves + 1], taken[leaf] = leaf, true
    local next_leaf, path, is_always = follow(fsm, leaf)
    needs_event = needs_event or not is_always
    for _, tr in ipairs(path or {}) do taken[tr] = true end
    leaf = next_leaf
  until not leaf or leaf == start
  return leaf and not (needs_event and may_be_left(fsm, leaves, taken)) and leaves
end

--- Find cycles on which a machine never becomes idle.
---@type rfsm_checks.Check
function loops.check(fsm, add, reached)
  local is_told = {}
  for _, leaf in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do
    local cycle = reached[leaf] and not is_told[leaf] and find_cycle(fsm, leaf)
    if cycle then
      local names = {}
      for i, other in ipairs(cycle) do
        names[i], is_told[other] = other._fqn, true
      end
      names[#names + 1] = leaf._fqn
      add("endless", leaf, "run never becomes idle, no event is needed on "
        .. concat(names, " -> "))
    end
  end
end

return loops
