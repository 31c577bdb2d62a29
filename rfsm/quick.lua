--- Quick: which transitions an event may trigger, noted, and the usual iteration.
--
-- The core does without this file. It is slower then, and that is all: it looks in each
-- iteration at each transition from the root down to the active leaf. Here the
-- candidates of an event are noted when it first comes while a leaf is active, and an
-- iteration with a single event that leads straight to another leaf is written out. In
-- all other cases the core's own functions go on.
--
-- @module rfsm.quick
-- @license BSD-3-Clause

local pcall, rawequal = pcall, rawequal

local NONE = {}

-- Candidates --------------------------------------------------------------------
--
-- leaf.choices[event] lists what an event may trigger while the leaf is active, in
-- order. leaf.quick[event] is the only one on the list, if it needs no search. Events
-- that the machine does not know have one list, at [OTHER].

local OTHER = {}

-- May one event alone trigger it?
local function is_candidate(def, event)
  local events = def.events
  if not events or def.has_predicate then return true end
  for i = 1, #events do
    if rawequal(events[i], event) then return true end
  end
  return false
end

-- Makes the function that returns the transition that events enable in a leaf, or nil,
-- as the search of the core.
local function make_find(core, straight)
  local enabled, line_to, matches = core.enabled, core.line_to, core.matches

  local function note_choice(leaf, event)
    local candidates, line = {}, line_to(leaf)
    for i = 1, #line do
      for j = 1, #line[i].otrs do
        local def = line[i].otrs[j]
        if def.connector == nil then core.compile_transition(def) end
        if is_candidate(def, event) then candidates[#candidates + 1] = def end
      end
    end
    local first = candidates[1]
    leaf.choices[event] = candidates
    if not rawequal(event, OTHER) and first and not (candidates[2] or first.connector
      or first.has_predicate) then
      leaf.quick[event] = first
    end
    return candidates
  end

  -- What a run reads of a leaf. `ignored` is its e_done if that leads nowhere, as it
  -- mostly does; NaN is no event.
  local function prepare_leaf(leaf)
    leaf.choices, leaf.quick = {}, {}
    local leads_somewhere = note_choice(leaf, leaf.done_event)[1] ~= nil
    leaf.ignored = leads_somewhere and 0 / 0 or leaf.done_event
  end

  local function choice_of(fsm, leaf, event)
    if not leaf.ignored then prepare_leaf(leaf) end
    local choice = leaf.choices[event]
    if choice then return choice end
    if not fsm._plan.events[event] then event = OTHER end
    return leaf.choices[event] or note_choice(leaf, event)
  end

  -- Returns the candidates of all events, nil if there are several lists of them.
  local function common_choice(fsm, leaf, events)
    local common = NONE
    for i = 1, #events do
      local candidates = choice_of(fsm, leaf, events[i])
      if candidates[1] and candidates ~= common then
        if common ~= NONE then return nil end
        common = candidates
      end
    end
    return common
  end

  -- Returns the first candidate that is enabled.
  local function find_listed(fsm, candidates, events)
    fsm._search = fsm._search + 1
    for i = 1, #candidates do
      local def = candidates[i]
      local found = (not def.has_predicate or matches(def, events))
        and enabled(fsm, def, events, 0)
      if found then return found end
    end
  end

  return function(fsm, leaf, events)
    local candidates = common_choice(fsm, leaf, events)
    if not candidates then return core.search(fsm, leaf, events) end
    candidates.search = candidates.search or straight and straight.search(candidates)
      or find_listed
    return candidates.search(fsm, candidates, events)
  end
end

-- Iterate -----------------------------------------------------------------------

-- Makes the iteration, and the function that goes on for it.
local function make_iterate(core)
  local choose, collect, gather = core.choose, core.collect, core.gather
  local is_idle, iterate_fully, react = core.is_idle, core.iterate_fully, core.react
  local recover, run_doo, settle = core.recover, core.run_doo, core.settle

  -- The events, the active leaf and the empty table of an iteration with hooks. No
  -- leaf: `iterate_fully` is to do it.
  local function prepare(fsm)
    if fsm._is_traced then return nil end
    local events = gather(fsm)
    if fsm._is_traced then return nil, events end
    return fsm._act_leaf, events, fsm._intq
  end

  -- Without events but an e_done that nothing waits for there is a doo cycle in any
  -- case, now or in the next iteration.
  local function iterate_doo(fsm, leaf, events)
    if events[1] ~= nil then events[1] = nil end
    if leaf._mode == "done" and not fsm._is_unsettled then return true, true end
    local idle = run_doo(fsm, leaf)
    if idle and fsm._is_fed then collect(fsm, fsm._intq) end
    if fsm._is_unsettled then settle(fsm, fsm._curq) end
    return true, is_idle(fsm, idle)
  end

  -- Looks for the transition that a single event enables, by straight code. Returns nil
  -- when there is more to it: see `iterate_further`.
  local function find_single(fsm, leaf_def, events, event, spare)
    local choice = leaf_def.choices[event]
    if not (choice and choice.search) then return nil end
    fsm._segment = true
    fsm._curq = events
    fsm._intq = spare
    local def = choice.search(fsm, choice, events)
    if not def or def.connector or not fsm._is_plain then return nil, def or false end
    return def, fsm._transitions[def.index]
  end

  -- Goes on where a single event does not lead straight to a leaf. `def` is nil when it
  -- has not been looked for, `events` is when they have not been gathered.
  local function iterate_further(fsm, def, leaf, leaf_def, after_free, events)
    if def == nil then return iterate_fully(fsm, after_free, events) end
    events = fsm._curq
    if leaf["_%def"] ~= leaf_def then def = choose(fsm, events) end -- merged
    local counted, idle = react(fsm, def, leaf, events, after_free)
    settle(fsm, events)
    return counted, is_idle(fsm, idle)
  end

  -- One iteration, as the core's. What is written out here is the usual case: there is
  -- one event, apart from an e_done that nothing waits for, and nobody traces.
  local function iterate(fsm, after_free) -- luacheck: ignore 561 (as it is, for speed)
    local leaf, events, spare, gathered = fsm._act_leaf, fsm._intq, fsm._curq, nil
    if not fsm._is_plain then
      leaf, events, spare = prepare(fsm)
      if not leaf then return iterate_fully(fsm, after_free, events) end
      gathered = events
    end
    local leaf_def, event, next_event = leaf["_%def"], events[1], events[2]
    if event == leaf_def.ignored then event, next_event = next_event, events[3] end
    if event == nil and not gathered then return iterate_doo(fsm, leaf, events) end
    if next_event ~= nil then return iterate_fully(fsm, after_free, gathered) end
    local def = leaf_def.quick[event]
    local tr = def and fsm._transitions[def.index]
    if not def or tr.guard or fsm._nodes[def.tgt_index] ~= tr.tgt then
      def, tr = find_single(fsm, leaf_def, events, event, spare)
      if not def then
        return iterate_further(fsm, tr, leaf, leaf_def, after_free, gathered)
      end
    else
      fsm._segment = true
      fsm._curq = events
      fsm._intq = spare
    end
    fsm._from = leaf
    fsm._segment = def
    local ok, failure = pcall(def[fsm._run], fsm, leaf, tr)
    if not ok then recover(fsm, true, failure) end
    if fsm._is_unsettled then
      settle(fsm, events)
    else
      events[2] = nil
      events[1] = nil
      fsm._segment = false
    end
    return true, false
  end

  return iterate, iterate_further
end

--- Make the quick functions of one core.
---@param core table functions of the core
---@return table quick `find`, `iterate`, `stepping`, `segment`, `parameters_of`
return function(core)
  local straight = core.straight and core.straight(core)
  local iterate, iterate_further = make_iterate(core)
  return {
    find = make_find(core, straight),
    iterate = iterate, stepping = { iterate, iterate_further },
    parameters_of = straight and straight.parameters_of,
    -- Returns the function that takes a segment.
    segment = function(def, is_hooked)
      return straight and straight.segment(def, is_hooked) or core.run_segment
    end,
  }
end
