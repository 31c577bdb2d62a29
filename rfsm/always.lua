--- Always: transitions that need no event are tried in each iteration.
--
-- They have `always = true`. The core loads this file for the first chart with such a
-- transition.
--
-- @module rfsm.always
-- @license BSD-3-Clause

local ipairs = ipairs

---@param rfsm rfsm the core
---@param engine table<string, any> functions of the core
return function(rfsm, engine)
  local PHASES, enabled, follow = engine.PHASES, engine.enabled, engine.follow
  local iterate, silent = engine.iterate, engine.silent

  local function list_always(leaf)
    local list = {}
    for _, node in ipairs(engine.line_to(leaf)) do
      engine.append(list, engine.list_otrs_of(node, true))
    end
    leaf._always = list
    return list
  end

  -- Returns the segment of the first transition of a list that is enabled without an
  -- event. An event would be given to its guard, so `events` is an empty list.
  local function find_always(fsm, list, events)
    local merges = fsm._merges
    fsm._search = fsm._search + 1
    for i = 1, #list do
      local found = enabled(fsm, list[i], events, nil, nil)
      if found and fsm._merges == merges then return found end
      if fsm._merges ~= merges then break end
    end
    if fsm._is_lent then fsm._curq, fsm._is_lent = {}, fsm._lends end
  end

  local function begin(fsm, after_free)
    fsm._phase = "begin"
    return PHASES.begin(fsm, after_free)
  end

  -- Makes a usual iteration, if it is one, of a leaf from which no path was found. One
  -- with an e_done that nothing takes would leave out the iteration behind it, in which
  -- guards are asked again.
  local function iterate_usual(fsm, after_free, leaf)
    local event = fsm._intq[1]
    if fsm.dbg ~= silent or fsm._act_leaf ~= leaf or fsm._reset_wanted
      or fsm._failure or fsm._given or event ~= nil and event == leaf._ignored then
      return begin(fsm, after_free)
    end
    fsm._phase = "idle"
    if fsm._is_hooked then fsm._turn = fsm._turn - 1 end -- it is counted there
    fsm._is_usual = true
    local idle = iterate(fsm, after_free)
    fsm._is_usual = false
    return idle
  end

  -- The phase "always". After an interrupt the list of current events may have events,
  -- which come first. What comes again beside an internal transition still does so in
  -- the next iteration.
  function PHASES.always(fsm, after_free)
    local leaf, events, again = fsm._act_leaf, fsm._curq, fsm._again
    if not leaf or events[1] ~= nil or fsm._reset_wanted then
      return begin(fsm, after_free)
    end
    local list = leaf._always or list_always(leaf)
    local found = list[1] and find_always(fsm, list, events)
    if not found then return iterate_usual(fsm, after_free, leaf) end
    if again and again.turn == fsm._turn - 1 then again.turn = fsm._turn end
    return follow(fsm, after_free, leaf, found, nil)
  end

  --- Add what is wrong with a transition that needs no event to the problems.
  -- This name comes last: the core does not load the file again once it is there.
  ---@package
  function rfsm.check_always(build, tr)
    local problem = tr.events[1] ~= nil and "a transition that needs no event has no "
      .. "events (leave out one of the two fields)" or not tr.src._mode and "only a "
      .. "transition from a state needs no event, '%s' is a connector"
    if problem then
      engine.add(build.problems, tr, "always", problem:format(tr.src._fqn))
    end
  end
end
