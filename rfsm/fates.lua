--- Fates: what became of the events of a machine and its regions, or would become.
--
-- An event is taken by a transition, kept by an extension, forwarded if a region took
-- or kept it, or else discarded. Each machine tells its fate hooks who has used an
-- event. The outermost machine tells its fate hooks, and its watch hooks "discarded",
-- of each event that nobody used. The core loads this file for the first such hook;
-- until then nothing is noted.
--
-- @module rfsm.fates
-- @license BSD-3-Clause

local ipairs, rawequal, remove = ipairs, rawequal, table.remove

--- An event that regions have got, and that none of them has used yet.
---@class rfsm.fates.Entry
---@field event any
---@field state rfsm.State the state that has the regions
---@field waits table<rfsm.Machine, boolean> set of the regions that still have it
---@field count integer number of these regions
---@field is_used boolean the machine or a region has taken or kept it

--- The field `_fates` of a machine.
---@class rfsm.fates.Own
---@field fsm rfsm.Machine
---@field used table<any, rfsm.Use> the events taken or kept in this iteration
---@field forwarded table<any, rfsm.fates.Entry> events that regions got in it
---@field entries rfsm.fates.Entry[]

---@param rfsm rfsm the core
---@param engine table<string, function> functions of the core
return function(rfsm, engine)
  local Own = {}
  Own.__index = Own

  -- Notes that an extension keeps a current event.
  function Own:keep(event, state, word)
    if self.used[event] then return end
    self.used[event] = { fate = "kept", state = state, word = word }
  end

  -- Notes that a region gets an event.
  function Own:forward(region, event)
    rfsm.follow_fates(region)
    local entry = self.forwarded[event]
    if not entry then
      entry = { event = event, state = self.fsm._act_leaf, waits = {}, count = 0,
        is_used = self.used[event] ~= nil }
      self.forwarded[event], self.entries[#self.entries + 1] = entry, entry
    end
    if entry.waits[region] then return end
    entry.waits[region], entry.count = true, entry.count + 1
  end

  local DISCARDED = { fate = "discarded" }

  local settle

  local function tell_discarded(fsm, event)
    while rfsm.parent(fsm) do fsm = rfsm.parent(fsm) end
    engine.tell_watch(fsm, "discarded", event)
    engine.tell(fsm, fsm._fate_hooks, event, "discarded", DISCARDED)
  end

  -- Tells what became of an event in a machine, and notes it in the entries of its
  -- parent machine. An event without an entry was sent to the region alone. `use` is
  -- false if the event was not used.
  local function conclude(fsm, event, use)
    if use then engine.tell(fsm, fsm._fate_hooks, event, use.fate, use) end
    local around, is_known = rfsm.parent(fsm), false
    local own = around and around._fates
    for i = own and #own.entries or 0, 1, -1 do
      local entry = own.entries[i]
      if rawequal(entry.event, event) and entry.waits[fsm] then
        is_known = true
        settle(own, i, fsm, use)
      end
    end
    if not (use or is_known) then tell_discarded(fsm, event) end
  end

  -- Notes in entry number `i` of `own` that a region is through with the event.
  function settle(own, i, region, use)
    local entry = own.entries[i]
    entry.waits[region], entry.count = nil, entry.count - 1
    if entry.count == 0 then remove(own.entries, i) end
    if use and not entry.is_used then
      entry.is_used = true
      conclude(own.fsm, entry.event, { fate = "forwarded", region = region,
        state = entry.state })
    elseif entry.count == 0 and not entry.is_used then
      conclude(own.fsm, entry.event, false)
    end
  end

  local function names_events(path)
    for _, tr in ipairs(path) do
      if tr.events[1] ~= nil then return true end
    end
    return false
  end

  -- Returns the first transition of a path that names an event; nil if none does.
  local function taker_in(path, event)
    for _, tr in ipairs(path) do
      if tr.events[1] ~= nil and engine.matches(tr, { event }) then return tr end
    end
  end

  -- The path hook: notes the current events that the path takes.
  local function note_taken(fsm, path)
    local takes_all = not names_events(path)
    for _, event in ipairs(fsm._curq) do
      local tr = takes_all and path[1] or taker_in(path, event)
      if (tr or takes_all) and event == event then
        fsm._fates.used[event] = { fate = "taken", transition = tr }
      end
    end
  end

  -- The last post step hook: concludes on the events that no region has got.
  local function end_iteration(fsm, events)
    local own, used, is_told = fsm._fates, fsm._fates.used, {}
    local forwarded = own.forwarded
    own.used, own.forwarded = {}, {}
    for i = 1, #events do
      local event = events[i]
      if event == event and not (is_told[event] or engine.is_made(event)) then
        is_told[event] = true
        local use = used[event] or false
        if use or not forwarded[event] then conclude(fsm, event, use) end
      end
    end
  end

  -- The reset hook of a region: what it has not looked at is lost if its state was
  -- left.
  local function reset(fsm)
    local around = rfsm.parent(fsm)
    local own = around and around._fates
    for i = own and #own.entries or 0, 1, -1 do
      if own.entries[i].waits[fsm] and around._phase ~= "idle" then
        settle(own, i, fsm, false)
      end
    end
    fsm._fates.entries, fsm._fates.used, fsm._fates.forwarded = {}, {}, {}
  end

  local function is_followed(at)
    local watched = at.machine._watch_hooks
    return at.machine._fate_hooks or watched and watched.discarded
  end

  --- Note nothing more, if neither the machine nor one around it or in it has a hook
  --- that is told of fates.
  ---@param fsm rfsm.Machine
  function rfsm.leave_fates(fsm)
    while rfsm.parent(fsm) do fsm = rfsm.parent(fsm) end
    local machines = rfsm.machines(fsm)
    for _, at in ipairs(machines) do
      if is_followed(at) then return end
    end
    for _, at in ipairs(machines) do
      local machine = at.machine
      machine._fates = false
      rfsm.path_hook_rm(machine, note_taken)
      rfsm.post_step_hook_rm(machine, end_iteration)
      rfsm.reset_hook_rm(machine, reset)
    end
  end

  --- Note what becomes of the events of a machine and its regions from now on.
  ---@param fsm rfsm.Machine
  function rfsm.follow_fates(fsm)
    if fsm._fates then return end
    fsm._fates = setmetatable({ fsm = fsm, used = {}, forwarded = {}, entries = {} },
      Own)
    rfsm.path_hook_add(fsm, rfsm.repeatable(note_taken))
    rfsm.post_step_hook_add(fsm, rfsm.borrows(end_iteration))
    rfsm.reset_hook_add(fsm, reset)
    for _, leaf in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do
      for _, region in ipairs(rfsm.regions(leaf)) do rfsm.follow_fates(region) end
    end
  end

  --- List what extensions would do with events that come to a machine now.
  --
  -- An event may be listed although a transition takes it. The regions of the machine
  -- are not asked.
  --
  ---@param fsm rfsm.Machine
  ---@param events any[]
  ---@return rfsm.Kept[] kept the events that an extension would keep, each once
  ---@return any[] more events that extensions would add to them
  function rfsm.foretell(fsm, events)
    rfsm.check_machine(fsm, "rfsm.foretell")
    local kept, more, is_kept, state = {}, {}, {}, fsm._act_leaf and fsm
    while state do
      for _, hook in ipairs(fsm._reaction_hooks or {}) do
        local list, word, added = hook(fsm, state, events)
        for _, event in ipairs(word and list or {}) do
          if not is_kept[event] then
            is_kept[event] = true
            kept[#kept + 1] = { event = event, state = state, word = word }
          end
        end
        for _, event in ipairs(added or {}) do more[#more + 1] = event end
      end
      state = rfsm.actchild_get(state)
    end
    return kept, more
  end
end
