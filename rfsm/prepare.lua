--- Prepare: what a host asks of a machine and its regions before and between steps.
--
-- The core loads this file when one of their names is first read. It stands alone,
-- because a robot needs no other tools.
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
    local is_long = #engine.segments_of(path) >= MOST_SEGMENTS
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

  engine.interpret(prepare_leaf)

  local function prepare_machine(fsm)
    prepare_list(fsm, fsm._entrance,
      fsm._is_leaf and NONE or fsm.initial._otrs)
    for _, node in ipairs(fsm._nodes) do
      if not node._mode then engine.note_of(fsm, node) end
      if node._is_leaf then prepare_leaf(fsm, node) end
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
    for _, at in ipairs(rfsm.machines(fsm)) do prepare_machine(at.machine) end
  end

  --- Use less memory and more time from now on: rfsm/fast.lua compiles nothing more.
  function rfsm.save_memory()
    local function none() end
    for name in pairs(engine.fast) do engine.fast[name] = none end -- any order: a set
    engine.fast.is_loaded = true
  end

  --- A machine, and where it runs.
  ---@class rfsm.Place
  ---@field machine rfsm.Machine
  ---@field owner rfsm.Machine|false the parent machine, whose state runs it
  ---@field state rfsm.State|false the state of the parent machine that runs it
  ---@field prefix string "root", or the name of the region: "root.arms.left"

  --- List a machine, then the regions in its states, at any depth.
  ---@param fsm rfsm.Machine
  ---@return rfsm.Place[] places
  function rfsm.machines(fsm)
    rfsm.check_machine(fsm, "rfsm.machines")
    local places = {}
    local function visit(machine, owner, state, prefix)
      places[#places + 1] = {
        machine = machine, owner = owner, state = state, prefix = prefix,
      }
      for _, leaf in ipairs(rfsm.elements(machine, rfsm.is_leaf)) do
        local regions, own = rfsm.regions(leaf)
        for i, region in ipairs(regions) do
          local name = rfsm.text_of(own.names[i])
          visit(region, machine, leaf, prefix .. leaf._fqn:sub(5) .. "." .. name)
        end
      end
    end
    visit(fsm, false, false, "root")
    return places
  end

  --- Note that the step under way will never return, for hosts that know this.
  --
  -- An exception of C++ that goes through Lua ends a step, and no pcall notices that.
  -- The next step then goes on behind the callback that was under way, as after an
  -- interrupt. A doo that was under way has failed. A guard or a predicate is asked
  -- once more; if that ends so, too, the iteration takes no transition.
  --
  ---@param fsm rfsm.Machine
  ---@return boolean is_noted false if no step was under way
  function rfsm.note_cut(fsm)
    rfsm.check_machine(fsm, "rfsm.note_cut")
    if fsm._phase == "idle" or fsm._is_cut then return false end
    for _, at in ipairs(rfsm.machines(fsm)) do
      local machine, leaf = at.machine, at.machine._act_leaf
      -- the doo that steps regions begins anew: its coroutine cannot be resumed
      if machine._phase == "doo" and rfsm.regions(leaf)[1] then leaf._doo_co = nil end
      if machine._phase == "search" then
        local is_second = machine._searched == machine._turn
        machine._searched = machine._turn
        if is_second then
          machine._outcome, machine._hook, machine._phase = "free", 0, "finish"
        end
      end
      if machine._phase ~= "idle" then engine.cut(machine) end
    end
    return true
  end

  --- Have f(name, data) called when a callback of a machine or its regions emits.
  --
  -- For hosts. By default `emit` does nothing. Regions merged later are included.
  --
  ---@param fsm rfsm.Machine
  ---@param f fun(name: string, data: any)
  function rfsm.set_emit(fsm, f)
    rfsm.check_machine(fsm, "rfsm.set_emit")
    local emit = engine.new_emit(f)
    for _, at in ipairs(rfsm.machines(fsm)) do
      if not rfsm.is_state(at.machine.emit) then at.machine.emit = emit end
      at.machine._emit = f
    end
  end
end
