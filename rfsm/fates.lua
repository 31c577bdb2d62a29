--- Fates: what became of the events of a machine and its regions.
--
-- An event is taken by a transition, kept by an extension, forwarded if a region took
-- or kept it, or else discarded. The outermost machine tells its watch hooks
-- "discarded" of each event that nobody used. The core loads this file for the first
-- such hook; until then nothing is noted.
--
-- @module rfsm.fates
-- @license BSD-3-Clause

local ipairs, rawequal, remove = ipairs, rawequal, table.remove

--- An event that regions have got, and that none of them has used yet.
---@class rfsm.fates.Entry
---@field event any
---@field waits table<rfsm.Machine, boolean> set of the regions that still have it
---@field count integer number of these regions
---@field is_used boolean a region has taken or kept it

--- The field `_fates` of a machine.
---@class rfsm.fates.Own
---@field fsm rfsm.Machine
---@field used table<any, boolean> set of events taken or kept in this iteration
---@field forwarded table<any, rfsm.fates.Entry> events that regions got in it
---@field entries rfsm.fates.Entry[]

---@param rfsm rfsm the core
---@param engine table<string, function> functions of the core
return function(rfsm, engine)
  local Own = {}
  Own.__index = Own

  -- Notes that an extension keeps a current event.
  function Own:keep(event) self.used[event] = true end

  -- Notes that a region gets an event.
  function Own:forward(region, event)
    rfsm.follow_fates(region)
    if self.used[event] then return end
    local entry = self.forwarded[event]
    if not entry then
      entry = { event = event, waits = {}, count = 0, is_used = false }
      self.forwarded[event], self.entries[#self.entries + 1] = entry, entry
    end
    if entry.waits[region] then return end
    entry.waits[region], entry.count = true, entry.count + 1
  end

  local settle

  -- Notes what became of an event in a machine, in the entries of its parent machine.
  -- An event without an entry was sent to the region alone.
  local function conclude(fsm, event, is_used)
    local around, is_known = rfsm.parent(fsm), false
    local own = around and around._fates
    for i = own and #own.entries or 0, 1, -1 do
      local entry = own.entries[i]
      if rawequal(entry.event, event) and entry.waits[fsm] then
        is_known = true
        settle(own, i, fsm, is_used)
      end
    end
    if is_used or is_known then return end
    while around and rfsm.parent(around) do around = rfsm.parent(around) end
    engine.tell_watch(around or fsm, "discarded", event)
  end

  -- Notes in entry number `i` of `own` that a region is through with the event.
  function settle(own, i, region, is_used)
    local entry = own.entries[i]
    entry.waits[region], entry.count = nil, entry.count - 1
    if entry.count == 0 then remove(own.entries, i) end
    if is_used and not entry.is_used then
      entry.is_used = true
      conclude(own.fsm, entry.event, true)
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

  local function takes(path, event)
    for _, tr in ipairs(path) do
      if tr.events[1] ~= nil and engine.matches(tr, { event }) then return true end
    end
    return false
  end

  -- The path hook: notes the current events that the path takes.
  local function note_taken(fsm, path)
    local takes_all = not names_events(path)
    for _, event in ipairs(fsm._curq) do
      if takes_all or takes(path, event) then fsm._fates.used[event] = true end
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
        if used[event] or not forwarded[event] then
          conclude(fsm, event, used[event] or false)
        end
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
end
