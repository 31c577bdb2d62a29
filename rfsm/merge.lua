--- Merge: adds an element to a live machine, `rfsm.fsm_merge`.
--
-- The core loads this file when that name is first read.
--
-- @module rfsm.merge
-- @license BSD-3-Clause

local error, ipairs, pcall, rawequal = error, ipairs, pcall, rawequal
local rawget, rawset = rawget, rawset

-- Obstacles -------------------------------------------------------------------------

-- Returns the reason why the leaf `parent` cannot become a composite; nil if it can.
local function leaf_obstacle(fsm, parent)
  if parent._mode ~= "inactive" then
    return ("'%s' is an active leaf state"):format(parent._fqn)
  elseif fsm._phase == "take" or fsm._phase == "search" and not fsm._act_leaf then
    return ("'%s' is a leaf state, while a transition is taken"):format(parent._fqn)
  end
end

-- Returns the reason why a member cannot have this name; nil if it can.
local function name_obstacle(rfsm, parent, kind, id)
  if id == nil and kind ~= "transition" then
    return "a " .. kind .. " needs a name"
  elseif id ~= id then
    return "a name expected, got NaN"
  elseif id ~= nil and rawget(parent, id) ~= nil then
    return ("'%s' has a member '%s' already"):format(parent._fqn, rfsm.text_of(id))
  end
end

-- Returns the reason why `obj` cannot become a member of `parent`; nil if it can.
local function obstacle_of(rfsm, engine, fsm, parent, obj, id)
  local kind, is_node_of = rfsm.kind_of(obj), engine.is_node_of
  if not is_node_of(fsm, parent, "state") then
    return "parent: a state of the fsm expected, " .. rfsm.got(parent)
  elseif not kind then
    return "state, transition or connector expected, " .. rfsm.got(obj)
  end
  local obstacle = name_obstacle(rfsm, parent, kind, id)
  if obstacle then return obstacle end
  if is_node_of(fsm, obj) and engine.find_lca(parent, obj) == obj then
    return ("'%s' cannot contain itself"):format(obj._fqn)
  elseif kind ~= "transition" and parent._is_leaf then
    return leaf_obstacle(fsm, parent)
  end
end

-- Build -----------------------------------------------------------------------------

-- Adds `obj` to the machine, as a member of `parent`. Returns the build.
local function build_merge(rfsm, engine, fsm, parent, obj, id)
  local build, first = engine.new_build(fsm), #fsm._transitions + 1
  for _, node in ipairs(fsm._nodes) do engine.note_mount(build, node) end
  if rfsm.is_trans(obj) then
    engine.new_transition(build, obj, parent, id)
  else
    local node = engine.new_node(build, rfsm.kind_of(obj), obj, parent, id)
    engine.clone_below(build, node._index)
  end
  engine.check_members(build, parent, rfsm.is_trans(obj))
  engine.resolve(build, first)
  engine.check_ways_in(build, first)
  return build
end

-- If `parent` was a leaf and is a composite now, makes its `initial` the target of the
-- transitions to it. Returns these transitions.
local function move_targets(engine, build, parent, first)
  local moved = {}
  for i = 1, parent._is_leaf and 0 or first - 1 do
    local tr = build.fsm._transitions[i]
    if tr._target == parent and not tr._is_internal then
      moved[#moved + 1] = tr
      if tr.tgt == parent then
        tr.tgt = engine.find_entrance(build, tr, parent) or parent
      end
      tr._target = rawget(parent, "initial")
    end
  end
  return moved
end

-- Removes the elements from number `first` on, from the list and from their parents.
local function truncate(list, first)
  for i = #list, first, -1 do
    local element = list[i]
    if rawequal(rawget(element._parent, element._id), element) then
      rawset(element._parent, element._id, nil)
    end
    list[i] = nil
  end
end

-- What the machine had before a merge of `parent[id]`.
local function note_state(fsm, parent, id)
  return { fsm = fsm, parent = parent, id = id, was_leaf = parent._is_leaf, moved = {},
    node = #fsm._nodes + 1, transition = #fsm._transitions + 1,
    preparing = fsm._preparing }
end

-- Makes the machine what it was. This may be done again after an interrupt.
local function undo(engine, before)
  local fsm, parent = before.fsm, before.parent
  rawset(parent, before.id, nil)
  truncate(fsm._transitions, before.transition)
  truncate(fsm._nodes, before.node)
  parent._is_leaf, fsm._preparing = before.was_leaf, before.preparing
  for _, tr in ipairs(before.moved) do tr.tgt, tr._target = parent, parent end
  engine.list_otrs(fsm)
  engine.forget(fsm)
end

-- Adds the element. Returns the build and the problems; the list is empty if there is
-- none.
local function try_merge(rfsm, engine, before, obj)
  local fsm, parent, id = before.fsm, before.parent, before.id
  local build = build_merge(rfsm, engine, fsm, parent, obj, id)
  if before.was_leaf then
    before.moved = move_targets(engine, build, parent, before.transition)
  end
  local problems = engine.lines_of(build.problems)
  if rfsm.is_trans(obj) and not fsm._transitions[before.transition] then
    for _, line in ipairs((engine.lines_of(build.warnings))) do -- in a leaf a wrong end
      problems[#problems + 1] = line
    end
  end
  if not problems[1] then
    engine.list_otrs(fsm)
    problems = engine.preprocess(fsm, parent[id])
  end
  if problems[1] then undo(engine, before) else engine.forget(fsm) end
  return build, problems
end

---@param core rfsm
---@param engine table<string, function> functions of the core
return function(core, engine)
  ---@class rfsm
  local rfsm = core

  local function refuse(fsm, reason)
    rfsm.report(fsm, "err", reason)
    return false, reason
  end

  --- Add a state, connector or transition to a live machine.
  --
  -- From the next iteration on the machine behaves as if its model had the new element.
  -- If `obj` cannot be added, the reason is reported to `err`, and nothing has changed.
  --
  ---@param fsm rfsm.Machine
  ---@param parent rfsm.State the state of the machine that gets the new element
  ---@param obj rfsm.State|rfsm.Connector|rfsm.Transition the element, which is cloned
  ---@param id? string its name; optional for a transition
  ---@return boolean is_merged
  ---@return string? reason the reason if it was not added
  function rfsm.fsm_merge(fsm, parent, obj, id)
    rfsm.check_machine(fsm, "rfsm.fsm_merge")
    local obstacle = obstacle_of(rfsm, engine, fsm, parent, obj, id)
    if obstacle then return refuse(fsm, "rfsm.fsm_merge: " .. obstacle) end
    if id == nil then id = #parent + 1 end
    local before = note_state(fsm, parent, id)
    local ok, build, problems = pcall(try_merge, rfsm, engine, before, obj)
    if not ok then
      local is_undone, failure = pcall(undo, engine, before)
      if not is_undone then undo(engine, before) end
      if not is_undone or rfsm.is_interrupt(build) then error(failure or build, 0) end
      problems = { "a preproc function failed: " .. rfsm.text_of(build) }
    end
    if problems[1] then
      return refuse(fsm, engine.summary("rfsm.fsm_merge", problems))
    end
    engine.report_created(build)
    engine.report_findings(build, before.node, before.transition)
    engine.tell_watch(fsm, "merged", parent[id])
    return true
  end
end
