--- Prepare: compiles what would be compiled while the machine runs.
--
-- The core loads this file when `prepare` or `save_memory` is first read. It stands
-- alone, because a robot needs it once and the memory afterwards.
--
-- @module rfsm.prepare
-- @license BSD-3-Clause

local ipairs, pairs = ipairs, pairs

local NONE = {}
local MOST_PATHS, MOST_SEGMENTS = 50, 6 -- for a leaf and an event; in a path

---@param core rfsm
---@param engine table<string, function> functions of the core
return function(core, engine)
  ---@class rfsm
  local rfsm = core
  local paths_left = 0

  -- Makes the paths that continue `at` with a transition, and compiles them.
  local function prepare_paths(fsm, at, tr)
    local segment = engine.segment_of(fsm, tr)
    if not segment then return end
    local path = at._paths and at._paths[segment] or engine.new_path(at, segment)
    if not segment.connector then
      paths_left = paths_left - 1
      engine.fast.compile(engine.path_of(fsm, path))
      return
    end
    local is_long = #path.segments >= MOST_SEGMENTS
    for _, way in ipairs(is_long and NONE or segment.connector._otrs) do
      if paths_left > 0 then prepare_paths(fsm, path, way) end
    end
  end

  -- Makes and compiles the paths that continue `at` with each transition of a list.
  local function prepare_list(fsm, at, list)
    paths_left = MOST_PATHS
    for _, tr in ipairs(list) do prepare_paths(fsm, at, tr) end
  end

  local function prepare_leaf(fsm, leaf)
    for _, choice in pairs(engine.list_choices(leaf)) do -- any order: independent
      prepare_list(fsm, leaf, choice)
      engine.fast.quick_run(fsm, leaf, choice)
    end
  end

  local function prepare_machine(fsm)
    prepare_list(fsm, engine.entrance_of(fsm),
      fsm._is_leaf and NONE or fsm.initial._otrs)
    for _, node in ipairs(fsm._nodes) do
      if not node._mode then engine.note_of(fsm, node) end
      if node._is_leaf then prepare_leaf(fsm, node) end
      for _, region in ipairs((rfsm.regions(node))) do prepare_machine(region) end
    end
  end

  --- Compile a machine completely now, not while it runs.
  --
  -- Without this call a path is compiled when it has been taken a few times. This is
  -- also true of paths that change later, by `fsm_merge` or because a hook is added.
  --
  ---@param fsm rfsm.Machine
  function rfsm.prepare(fsm)
    rfsm.check_machine(fsm, "rfsm.prepare")
    prepare_machine(fsm)
  end

  --- Use less memory and more time from now on: rfsm/fast.lua compiles nothing more.
  function rfsm.save_memory()
    local function none() end
    for name in pairs(engine.fast) do engine.fast[name] = none end -- any order: a set
    engine.fast.is_loaded = true
  end
end
