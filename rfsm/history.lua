--- History: a composite with `history = "shallow"` is entered at the substate that was
-- active last, one with `history = "deep"` at the leaf. Whenever a leaf is entered, the
-- transitions into the composites around it get a new target. Only these targets hold
-- the history, so snapshots save it, and `rfsm.targets` shows where transitions lead.
--
-- @module rfsm.history
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local function has_history(obj)
  return rfsm.is_state(obj) and obj.history and not rfsm.is_fsmobj(obj.history)
end

local function is_inside(node, composite)
  local fqn = composite._fqn .. "."
  return rfsm.is_node(node) and node._fqn:sub(1, #fqn) == fqn
end

-- Sets the target of a transition into a composite to a node in the composite. A target
-- outside of the composite was set by the program, and is not changed.
local function lead_to(tr, node)
  if tr.tgt ~= node and is_inside(tr.tgt, tr._initial._parent) then tr.tgt = node end
end

-- The reset hook: each composite is entered by its `initial` again.
local function forget(fsm)
  local list = fsm._history
  for i = 1, #list do
    local tr = list[i]
    if tr.tgt ~= tr._initial then lead_to(tr, tr._initial) end
  end
end

local function lead_all(into, node)
  for i = 1, into and #into or 0 do lead_to(into[i], node) end
end

-- The entry hook of a leaf: for each composite around the leaf, sets the node at which
-- the composite is entered the next time.
local function remember(fsm, leaf)
  -- as in UML, a composite in which a final state was reached begins anew
  local deep = leaf.final and leaf._parent.initial and leaf._parent or leaf
  local node, way = leaf, deep
  while node ~= fsm do
    node = node._parent
    way = node.history == "deep" and deep or node.history == "shallow" and way or node
    lead_all(fsm._history[node], way.initial or way)
  end
end

local function check(state)
  local value, where = state.history, rfsm.location_of(state, "history") .. ": "
  if value ~= "shallow" and value ~= "deep" then
    return where .. "'shallow' or 'deep' expected, " .. rfsm.got(value)
      .. rfsm.find_module("rfsm.advice").nearest_name(rfsm.text_of(value),
        { "shallow", "deep" })
  elseif rfsm.is_leaf(state) then
    return where .. "only a composite can have a history"
  end
  return value == "shallow" and rfsm.mapfsm(function(child)
    if child.initial or has_history(child) then return nil end
    return where .. "'shallow' enters '" .. child._fqn .. "' by its initial transition,"
      .. " there is none (did you mean 'deep'?)"
  end, state, rfsm.is_composite, 1)[1] or nil
end

-- Adds the entry hook to a leaf; notes a transition into a composite with a history.
local function note(fsm, obj)
  local composite = rfsm.is_trans(obj) and obj.tgt._id == "initial" and obj.tgt._parent
  if rfsm.is_leaf(obj) then
    rfsm.entry_hook_add(fsm, obj, rfsm.repeatable(remember))
  elseif composite and has_history(composite) and not is_inside(obj.src, composite) then
    local list = fsm._history
    local into = list[composite] or {}
    obj._initial, list[composite] = obj.tgt, into
    list[#list + 1], into[#into + 1] = obj, obj
  end
end

rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  local problems = {}
  for _, state in ipairs(rfsm.elements(merged or fsm, has_history)) do
    problems[#problems + 1] = check(state)
    if not fsm._history then rfsm.reset_hook_add(fsm, forget) end
    -- the transitions into composites with a history, and the list of those into each
    fsm._history = fsm._history or {}
  end
  local elements = fsm._history and rfsm.elements(merged or fsm) or {}
  for _, obj in ipairs(elements) do note(fsm, obj) end
  return problems
end

return {}
