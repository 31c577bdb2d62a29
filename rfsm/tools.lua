--- Tools: functions of `rfsm` that inspect or move a machine. No iteration calls them.
--
-- The core loads this file when one of their names is first read.
--
-- @module rfsm.tools
-- @license BSD-3-Clause

local error, ipairs, rawequal, rawset = error, ipairs, rawequal, rawset
local setmetatable, type = setmetatable, type
local max = math.max

local NONE = {}

-- Structure: machines of equal structure share what is known of it ------------------

local latest = setmetatable({}, { __mode = "kv" }) -- model -> a machine of it

-- Have the elements of two lists equal values in some fields? Nodes are compared by
-- FQN.
local function have_same(list, others, fields)
  for i, element in ipairs(list) do
    for _, field in ipairs(fields) do
      local a, b = element[field], others[i][field]
      if type(a) == "table" and type(b) == "table" and a._index then
        a, b = a._fqn, b._fqn
      end
      if not rawequal(a, b) then return false end
    end
  end
  return true
end

local function have_same_events(list, others)
  for i, tr in ipairs(list) do
    local events, more = tr.events, others[i].events
    for j = 1, max(#events, #more) do
      if not rawequal(events[j], more[j]) then return false end
    end
  end
  return true
end

local NODE, TRANSITION = { "_fqn", "_is_leaf" }, { "_model", "src", "_target", "pn" }

local function are_alike(fsm, other)
  local nodes, transitions = fsm._nodes, fsm._transitions
  return #nodes == #other._nodes and #transitions == #other._transitions
    and have_same(nodes, other._nodes, NODE)
    and have_same(transitions, other._transitions, TRANSITION)
    and have_same_events(transitions, other._transitions)
end

-- Move ------------------------------------------------------------------------------

-- Makes all active states inactive. `_actchild` leads to them.
local function leave_all(fsm)
  local left = fsm
  while left do
    local child = left._actchild
    left._mode = "inactive"
    if left._doo_co then left._doo_co = nil end
    if child then rawset(left, "_actchild", nil) end
    left = child
  end
  fsm._act_leaf = false
end

-- Sets the mode of a state. Its ancestors become active, all other states inactive.
local function move_to(fsm, state, mode)
  leave_all(fsm)
  state._mode = mode
  if mode ~= "inactive" and state._is_leaf then fsm._act_leaf = state end
  while state ~= fsm do
    local parent = state._parent
    if state._mode ~= "inactive" then rawset(parent, "_actchild", state) end
    parent._mode, state = "active", parent
  end
end

---@param core rfsm
---@param engine table<string, function> functions of the core
return function(core, engine)
  ---@class rfsm
  local rfsm = core

  local check_machine, got = rfsm.check_machine, rfsm.got
  local is_node_of, line_to = engine.is_node_of, engine.line_to

  --- List the nodes to which a transition may lead.
  --
  -- An extension may change the target of a transition so that it leads to any node in
  -- a composite. Then the extension keeps the model's target in the field `_initial`.
  --
  ---@param tr rfsm.Transition a transition of a machine
  ---@return (rfsm.State|rfsm.Connector)[] targets the target; or `_initial` and all
  -- nodes of the composite that contains it
  function rfsm.targets(tr)
    local initial = tr._initial
    if not initial then return { tr.tgt } end
    local targets = { initial }
    for _, node in ipairs(rfsm.elements(initial._parent, rfsm.is_node)) do
      targets[#targets + 1] = node
    end
    return targets
  end

  --- Return the FQN of a transition's target in the model, for extensions.
  ---@param tr rfsm.Transition a transition of a machine
  ---@return string fqn "internal" for an internal transition
  function rfsm.target_of(tr)
    return tr._is_internal and "internal" or tr._target._fqn
  end

  --- Has the machine taken a path since the last call of this function?
  --
  -- A host that calls this between steps needs no path hook.
  --
  ---@param fsm rfsm.Machine
  ---@return boolean
  function rfsm.took_path(fsm)
    check_machine(fsm, "rfsm.took_path")
    local path = fsm._path
    if fsm._phase ~= "take" then fsm._path = false end
    return path ~= false
  end

  --- For post step hooks: will `step` iterate again, because no transition was enabled?
  ---@param fsm rfsm.Machine
  ---@return boolean
  function rfsm.is_free(fsm)
    check_machine(fsm, "rfsm.is_free")
    return fsm._outcome == "free"
  end

  --- For post step hooks: is nothing left to do, unless an event comes?
  ---@param fsm rfsm.Machine
  ---@return boolean
  function rfsm.is_idle(fsm)
    check_machine(fsm, "rfsm.is_idle")
    return fsm._outcome == "idle" and fsm._intq[1] == nil
  end

  --- List the events that extensions keep for later.
  ---@param fsm rfsm.Machine
  ---@return any[] events
  function rfsm.waiting(fsm)
    check_machine(fsm, "rfsm.waiting")
    local list = {}
    for _, hook in ipairs(fsm._waiting_hooks or NONE) do
      for _, event in ipairs(hook(fsm) or NONE) do list[#list + 1] = event end
    end
    return list
  end

  --- List the arguments of all calls of `snapshot_hook_add`, in order, for extensions.
  ---@param fsm rfsm.Machine
  ---@return { name: string, save: function, load: function, is_explored?: boolean }[]
  function rfsm.snapshot_hooks(fsm) return fsm._snapshot_hooks or NONE end

  -- Returns the node with a name such as "root.par.left.a" in a machine or its regions.
  local function find_by_name(fsm, name)
    for _, at in ipairs(rfsm.machines(fsm)) do
      for _, node in ipairs(at.machine._nodes) do
        if at.prefix .. node._fqn:sub(5) == name then return node end
      end
    end
  end

  -- Returns a state, given itself or by name; blames the caller for any other value.
  local function check_state(fsm, state, where, level)
    local node = type(state) == "string" and find_by_name(fsm, state) or state
    if rfsm.is_state(node) and node._mode then return node end
    local hint = type(state) == "string" and engine.advise("state_name", fsm, state)
    error(where .. ": state of the machine expected, " .. got(state) .. (hint or ""),
      level + 1)
  end

  --- Is a state of the machine, or of one of its regions, active?
  ---@param fsm rfsm.Machine
  ---@param state rfsm.State|string a state, or a name such as "root.par.left.a"
  ---@return boolean
  function rfsm.is_in(fsm, state)
    check_machine(fsm, "rfsm.is_in")
    return check_state(fsm, state, "rfsm.is_in", 2)._mode ~= "inactive"
  end

  --- Call `f(fsm, state)` for each state from `from` up or down to `to`, both included.
  -- @raise when neither is an ancestor of the other
  ---@param fsm rfsm.Machine
  ---@param f fun(fsm: rfsm.Machine, state: rfsm.State): any
  ---@param from rfsm.State where to begin
  ---@param to rfsm.State an ancestor or descendant of `from`
  ---@return any[] results the results of f, in order, without nils
  function rfsm.map_from_to(fsm, f, from, to)
    check_machine(fsm, "rfsm.map_from_to")
    engine.check_function(f, "rfsm.map_from_to")
    if not (is_node_of(fsm, from) and is_node_of(fsm, to)) then
      error("rfsm.map_from_to: two nodes of the fsm expected, " .. got(from) .. " and "
        .. got(to), 2)
    end
    local up, down, results = from._depth, to._depth, {}
    local line = line_to(up >= down and from or to)
    if line[up + 1] ~= from or line[down + 1] ~= to then
      error(("rfsm.map_from_to: '%s' and '%s' are not on one line"):format(from._fqn,
        to._fqn), 2)
    end
    for depth = up, down, up > down and -1 or 1 do
      results[#results + 1] = f(fsm, line[depth + 1])
    end
    return results
  end

  --- Find the path that events would enable from a node, without taking it.
  --
  -- A path is a table { node, nextl }. `nextl` is a list of tables { trans, next },
  -- whose `next` is the rest of the path. At the end of the path `nextl` is false.
  --
  ---@param fsm rfsm.Machine
  ---@param node rfsm.State|rfsm.Connector
  ---@param events any[]
  ---@return table|false path false if no path is enabled
  function rfsm.node_find_enabled(fsm, node, events)
    check_machine(fsm, "rfsm.node_find_enabled")
    if not is_node_of(fsm, node) then
      error("rfsm.node_find_enabled: node of the fsm expected, " .. got(node), 2)
    elseif type(events) ~= "table" then
      error("rfsm.node_find_enabled: list of events expected, " .. got(events), 2)
    end
    -- a callback may call this: the notes of the machine stay, also if it is cut short
    local ways = {}
    local asker = setmetatable({ _ways = ways, _search = 1, _watch_hooks = false,
      _owner = false }, { __index = fsm, __newindex = fsm })
    local segment = engine.first_enabled(asker, node._otrs, 1, events)
    local path = segment and { node = node, nextl = false } or false
    local at = path
    while segment do
      local tail = { node = segment.tgt, nextl = false }
      at.nextl = { { trans = segment.tr, next = tail } }
      at, segment = tail, segment.connector and ways[segment.connector].way
    end
    return path
  end

  --- Warn of each state or connector that no transition leaves.
  ---@param fsm rfsm.Machine
  ---@return boolean is_clean true if there is no such node
  function rfsm.check_no_otrs(fsm)
    check_machine(fsm, "rfsm.check_no_otrs")
    return engine.report_dead_ends(fsm, 1)
  end

  --- Return a table that stands for the structure of a machine, for extensions.
  --
  -- A machine gets another table from `fsm_merge`. Machines of one model have the same
  -- table if they are alike.
  --
  ---@param fsm rfsm.Machine
  ---@return table structure
  function rfsm.structure_of(fsm)
    check_machine(fsm, "rfsm.structure_of")
    if fsm._structure then return fsm._structure end
    local other = latest[fsm._model]
    fsm._structure = other and other._structure and are_alike(fsm, other)
      and other._structure or {}
    latest[fsm._model] = fsm
    return fsm._structure
  end

  --- Call getevents and append its events to the queue.
  ---@param fsm rfsm.Machine
  ---@return integer waiting length of the queue
  function rfsm.check_events(fsm)
    check_machine(fsm, "rfsm.check_events")
    local events, failure = engine.ask_getevents(fsm)
    if not events then error(failure, 0) end
    engine.queue_given(fsm, events)
    return #fsm._intq
  end

  --- Raise an error if a step is under way, for extensions.
  --
  -- The error blames the caller's caller. A step that was cut short is finished first.
  --
  ---@param fsm rfsm.Machine
  ---@param where string the public function
  function rfsm.check_between_steps(fsm, where)
    check_machine(fsm, where, 4)
    if fsm._phase == "idle" then return end
    engine.check_no_step(fsm, where, 4)
    engine.try(fsm)
  end

  --- Set the mode of a state.
  --
  -- Its ancestors become active, all other states inactive. No callback runs.
  --
  ---@param state rfsm.State a state of a machine
  ---@param mode "active"|"inactive"|"done"
  ---@return string mode
  function rfsm.set_sta_mode(state, mode)
    if not rfsm.is_state(state) or type(state._index) ~= "number" then
      error("rfsm.set_sta_mode: state of a fsm expected, " .. got(state), 2)
    elseif mode ~= "active" and mode ~= "inactive" and mode ~= "done" then
      error("rfsm.set_sta_mode: 'active', 'done' or 'inactive' expected, "
        .. got(mode), 2)
    end
    local is_active, was_active = mode ~= "inactive", state._mode ~= "inactive"
    if is_active ~= was_active or is_active and state._is_leaf then
      local co, fsm = is_active and state._doo_co or nil, state
      while fsm._parent ~= fsm do fsm = fsm._parent end
      move_to(fsm, state, mode)
      state._doo_co = co
    end
    return mode
  end

  --- Reset a machine, then make `leaf` active (false: no leaf); no callback runs.
  ---@param fsm rfsm.Machine
  ---@param leaf rfsm.State|false
  ---@param mode string the mode of the leaf
  ---@param queue any[] the pending events
  function rfsm.place(fsm, leaf, mode, queue)
    rfsm.check_between_steps(fsm, "rfsm.place")
    if leaf then
      move_to(fsm, leaf, mode)
      engine.tell(fsm, fsm._reset_hooks)
      fsm._reset_wanted, fsm._unread = false, 0
    else
      engine.reset_now(fsm)
    end
    fsm._intq, fsm._curq, fsm._path = queue, {}, false
    engine.raise_failure(fsm)
  end

  -- Calls the entry hooks of extensions: those that may be repeated, which a program's
  -- hooks are not.
  local function call_entry_hooks(fsm, leaf)
    for _, state in ipairs(fsm._entry_hooks and line_to(leaf) or NONE) do
      for _, hook in ipairs(fsm._entry_hooks[state] or NONE) do
        if engine.may_repeat(hook) then engine.tell(fsm, { hook }, state) end
      end
    end
  end

  -- Returns the pending events of a machine, but `e_init_fsm`.
  local function others_of(queue)
    local others = {}
    for i = 1, #queue do
      if not rawequal(queue[i], "e_init_fsm") then others[#others + 1] = queue[i] end
    end
    return others
  end

  --- Have an inactive machine begin in a leaf, as if entered, for extensions.
  --
  -- No callback runs, but the entry hooks of extensions are called. A leaf without doo
  -- is done.
  --
  ---@param fsm rfsm.Machine
  ---@param state rfsm.State|string the leaf, or its name
  ---@param where string the public function, for messages that blame its caller
  ---@package
  function rfsm.begin_in(fsm, state, where)
    local leaf = check_state(fsm, state, where, 3)
    if not (is_node_of(fsm, leaf) and leaf._is_leaf) then
      error(where .. ": leaf of the machine expected, got '" .. leaf._fqn .. "'", 3)
    elseif fsm._mode ~= "inactive" then
      error(where .. ": the machine is active (rfsm.reset makes it inactive)", 3)
    end
    rfsm.place(fsm, leaf, leaf.doo and "active" or "done", others_of(fsm._intq))
    call_entry_hooks(fsm, leaf)
    fsm._at = 0
    if not leaf.doo then engine.complete(fsm, leaf) end
    engine.raise_failure(fsm)
  end
end
