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

local ipairs, next, rawequal = ipairs, next, rawequal
local remove, setmetatable = table.remove, setmetatable

--- What is known of an event of an iteration.
---@class rfsm.fates.Note
---@field is_told boolean? its fate was told
---@field is_known boolean? it came from the parent machine

--- An event of an iteration that regions have got; its fate is theirs if the machine
--- has not used the event.
---@class rfsm.fates.Entry : rfsm.fates.Note
---@field event any
---@field state rfsm.State the state that has the regions
---@field open table<rfsm.fates.Copy, boolean> set of what regions have not looked at
---@field region rfsm.Machine|false the first region that has used the event
---@field size integer how often the event was current

--- An event that a region has got.
---@class rfsm.fates.Copy
---@field entry rfsm.fates.Entry
---@field place integer its place among the current events of the parent machine

--- The field `_fates` of a machine. `used`, `forwarded` and `notes` are about events
--- of the iteration number `turn`.
---@class rfsm.fates.Own
---@field fsm rfsm.Machine
---@field turn integer
---@field used table<any, rfsm.Use> taken or kept
---@field forwarded table<any, rfsm.fates.Entry> sent to regions
---@field notes table<any, rfsm.fates.Note>
---@field entries rfsm.fates.Entry[] those whose fate regions decide
---@field copies rfsm.fates.Copy[] the events from the parent machine that wait

---@param core rfsm
---@param engine table<string, function> functions of the core
return function(core, engine)
  ---@class rfsm
  local rfsm = core

  local Own = {}
  Own.__index = Own

  -- An interrupt may cut short what notes and tells. It is done again in the same
  -- iteration; so nothing is told twice, and what was not yet told is.

  local function new_own(fsm)
    return setmetatable({ fsm = fsm, turn = -1, used = {}, forwarded = {}, notes = {},
      entries = {}, copies = {} }, Own)
  end

  -- Returns the notes of a machine, which are about this iteration from now on.
  local function current(own)
    if own.turn ~= own.fsm._turn then
      own.used, own.forwarded, own.notes = {}, {}, {}
      own.turn = own.fsm._turn
    end
    return own
  end

  -- Notes that an extension keeps a current event.
  function Own:keep(event, state, word)
    local used = current(self).used
    used[event] = used[event] or { fate = "kept", state = state, word = word }
  end

  -- Notes that a region gets the current event at a place.
  function Own:forward(region, event, place)
    rfsm.follow_fates(region)
    local forwarded, copies = current(self).forwarded, region._fates.copies
    local entry = forwarded[event] or { event = event, state = self.fsm._act_leaf,
      open = {}, region = false, size = 0 }
    forwarded[event] = entry
    local copy = copies[#copies]
    if not copy or copy.entry ~= entry or copy.place ~= place then
      copy = { entry = entry, place = place }
      copies[#copies + 1] = copy
    end
    entry.open[copy] = true
  end

  local DISCARDED = { fate = "discarded" }

  local function tell_discarded(fsm, event)
    while rfsm.parent(fsm) do fsm = rfsm.parent(fsm) end
    engine.tell_watch(fsm, "discarded", event)
    engine.tell(fsm, fsm._fate_hooks, event, "discarded", DISCARDED)
  end

  local function count_of(events, event)
    local count = 0
    for i = 1, #events do
      if rawequal(events[i], event) then count = count + 1 end
    end
    return count
  end

  -- Closes the copies of an event that a region has looked at: all but the last, as
  -- many as wait in its queue or are open in its own regions.
  local function close_copies(fsm, event, is_used, note)
    local own, waiting = fsm._fates, count_of(fsm._intq, event)
    for _, entry in ipairs(own.entries) do
      if rawequal(entry.event, event) and entry ~= note then
        waiting = waiting + entry.size
      end
    end
    for i = #own.copies, 1, -1 do
      local copy = own.copies[i]
      if rawequal(copy.entry.event, event) then
        waiting = waiting - 1
        if waiting < 0 then
          note.is_known = true
          if is_used then copy.entry.region = copy.entry.region or fsm end
          copy.entry.open[copy] = nil
          remove(own.copies, i)
        end
      end
    end
  end

  -- Tells what became of an event in a machine, and notes it for the parent machine. An
  -- event that did not come from there was sent to the region alone. `use` is false if
  -- the event was not used.
  local function conclude(fsm, event, use, note)
    local around = rfsm.parent(fsm)
    if use and not note.is_told then
      note.is_told = true
      engine.tell(fsm, fsm._fate_hooks, event, use.fate, use)
    end
    if around and around._fates then close_copies(fsm, event, use, note) end
    if not (note.is_known or note.is_told) then
      note.is_told = true
      tell_discarded(fsm, event)
    end
  end

  -- Concludes on the events that a region has used or all regions have discarded. Each
  -- iteration ends with it, so regions need not tell the machine that steps them.
  local function judge(own)
    local entries, i = own.entries, 1
    while entries[i] do
      local entry = entries[i]
      if entry.region or next(entry.open) == nil then
        conclude(own.fsm, entry.event, entry.region and { fate = "forwarded",
          region = entry.region, state = entry.state }, entry)
        remove(entries, i)
      else
        i = i + 1
      end
    end
  end

  engine.interpret(judge)

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
    local takes_all, used = not names_events(path), current(fsm._fates).used
    for _, event in ipairs(fsm._curq) do
      local tr = takes_all and path[1] or taker_in(path, event)
      if (tr or takes_all) and event == event then
        used[event] = { fate = "taken", transition = tr }
      end
    end
  end

  -- Has the regions decide on an event of this iteration.
  local function leave_to_regions(own, entry, events)
    if entry.size > 0 then return end
    own.entries[#own.entries + 1] = entry
    entry.size = count_of(events, entry.event)
  end

  -- The last post step hook: concludes on the events that no region has got.
  local function end_iteration(fsm, events)
    local own = current(fsm._fates)
    for i = 1, #events do
      local event = events[i]
      if event == event and not engine.is_made(event) then
        local use, entry = own.used[event] or false, own.forwarded[event]
        if entry and not use then
          leave_to_regions(own, entry, events)
        else
          own.notes[event] = own.notes[event] or {}
          conclude(fsm, event, use, own.notes[event])
        end
      end
    end
    judge(own)
  end

  -- The reset hook: a region whose state was left has lost what it has not looked at.
  local function reset(fsm)
    for _, copy in ipairs(fsm._fates.copies) do copy.entry.open[copy] = nil end
    fsm._fates = new_own(fsm)
  end

  local function is_followed(at)
    local watched = at.machine._watch_hooks
    return at.machine._fate_hooks or watched and watched.discarded
  end

  --- Note nothing more, if neither the machine nor one around it or in it has a hook
  --- that is told of fates.
  ---@param fsm rfsm.Machine
  ---@package
  function rfsm.leave_fates(fsm)
    while rfsm.parent(fsm) do fsm = rfsm.parent(fsm) end
    local machines = rfsm.machines(fsm)
    for _, at in ipairs(machines) do
      if is_followed(at) then return end
    end
    for _, at in ipairs(machines) do
      local machine = at.machine
      machine._fates = nil
      rfsm.path_hook_rm(machine, note_taken)
      rfsm.post_step_hook_rm(machine, end_iteration)
      rfsm.reset_hook_rm(machine, reset)
    end
  end

  --- Note what becomes of the events of a machine and its regions from now on.
  ---@param fsm rfsm.Machine
  ---@package
  function rfsm.follow_fates(fsm)
    if fsm._fates then return end
    fsm._fates = new_own(fsm)
    rfsm.path_hook_add(fsm, rfsm.repeatable(note_taken))
    rfsm.post_step_hook_add(fsm, rfsm.repeatable(end_iteration))
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
