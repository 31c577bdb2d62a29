--- Tracks: what recording and replay have in common.
--
-- Events as plain data, clocks that are read through another function, and the hooks of
-- a machine and of those in its states.
--
-- @module rfsm.record.track
-- @license BSD-3-Clause

local order = require "rfsm.shared.order"
local calls = require "rfsm.shared.calls"
local clock = require "rfsm.clock"
local plain = require "rfsm.snapshot.plain"
local rfsm = require "rfsm"

local error, ipairs, pcall = error, ipairs, pcall
local rawequal, rawget, select, tostring = rawequal, rawget, select, tostring
local type = type
local concat = table.concat
local text_of = rfsm.text_of

local track = {}

-- Data ----------------------------------------------------------------------------

local PATH = { owner = "", base = 0, seen = {}, packed = {} }

--- Return plain data for a text, number or boolean.
function track.pack(value) return plain.pack(value, PATH, 0) end

--- Return an event as plain data; one that is none by its type, which is not replayed.
function track.pack_event(event)
  if plain.is_scalar(event) then return track.pack(event) end
  return { "%x", type(event) }
end

--- Return events as plain data; nil if there are none.
function track.pack_events(events)
  local list = {}
  for i = 1, #events do list[i] = track.pack_event(events[i]) end
  return list[1] ~= nil and list or nil
end

--- Return packed events as text.
function track.list_text(list)
  local texts = {}
  for i = 1, list and #list or 0 do
    texts[i] = type(list[i]) == "table" and "an event that is a " .. text_of(list[i][2])
      or text_of(list[i])
  end
  return texts[1] and concat(texts, ", ") or "none"
end

--- Return a place that was recorded as text.
function track.place_text(leaf, is_done)
  return leaf and leaf .. (is_done and "(done)" or "(active)") or "none"
end

--- Are plain data the same?
function track.same(a, b)
  if type(a) ~= "table" or type(b) ~= "table" then return rawequal(a, b) end
  for key, value in order.each(a) do -- any order: all have to be the same
    if not track.same(value, b[key]) then return false end
  end
  for key in order.each(b) do -- likewise
    if a[key] == nil then return false end
  end
  return true
end

--- Append to the list t[field].
function track.note(t, field, ...)
  local list = t[field] or {}
  t[field] = list
  for i = 1, select("#", ...) do list[#list + 1] = (select(i, ...)) end
end

--- Drop the records after iteration number `count`.
function track.truncate(records, count)
  local kept = 1
  for i = 2, #records do
    if not records[i].m then count = count - 1 end
    if count >= 0 and not records[i].m then kept = i end
  end
  for i = #records, kept + 1, -1 do records[i] = nil end
end

-- What may have changed: the data that the chart keeps, and targets -----------------

--- Return what tells cheaply that the data of a machine is as it was.
---@param fsm rfsm.Machine
---@return table watched
function track.watch_data(fsm)
  local watched = { transitions = rfsm.elements(fsm, rfsm.is_trans), targets = {},
    states = {}, names = {}, values = {}, is_deep = false }
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    if type(state.save) == "function" then watched.is_deep = true end
    for _, name in ipairs(type(state.keep) == "table" and state.keep or {}) do
      watched.states[#watched.states + 1] = state
      watched.names[#watched.names + 1] = name
    end
  end
  track.may_have_changed(watched)
  return watched
end

--- May the data have changed since the last call? A table may, at any time.
---@param watched table
---@return boolean
function track.may_have_changed(watched)
  local may, values, names = watched.is_deep, watched.values, watched.names
  for i, state in ipairs(watched.states) do
    local value = state[names[i]]
    if type(value) == "table" or not rawequal(value, values[i]) then may = true end
    values[i] = value
  end
  local targets = watched.targets
  for i, tr in ipairs(watched.transitions) do
    local tgt = tr.tgt
    if targets[i] ~= tgt then targets[i], may = tgt, true end
  end
  return may
end

-- Clock --------------------------------------------------------------------------

--- Two clocks of an owner, made once, to be read in place of those in use.
---@class rfsm.record.Clocks
---@field before table<boolean, function> those in use, while the owner's are read

--- Return clocks that note each reading by note(...), or a failure.
---@param note fun(ok: boolean, ...)
---@return rfsm.record.Clocks clocks
function track.new_clocks(note)
  local clocks = { before = {} }
  for _, kind in ipairs { true, false } do
    clocks[kind] = function(...)
      local ok, sec, nsec = calls.try(clocks.before[kind], ...)
      note(ok, sec, nsec)
      if not ok then error(sec, 0) end
      return sec, nsec
    end
  end
  return clocks
end

--- Have clocks read through those of an owner from now on.
function track.use_clocks(clocks)
  local in_use, before = clock.in_use, clocks.before
  for i = 1, 2 do
    local kind = i == 1
    local read = in_use[kind]
    if read ~= clocks[kind] then before[kind], in_use[kind] = read, clocks[kind] end
  end
end

--- Have clocks read as before, unless somebody has set another one.
function track.leave_clocks(clocks)
  local in_use, before = clock.in_use, clocks.before
  for i = 1, 2 do
    local kind = i == 1
    if in_use[kind] == clocks[kind] then in_use[kind] = before[kind] end
  end
end

--- Have clocks read through wrap(read), in place of what the owner had before; nil: as
-- they are.
function track.watch_clock(owner, wrap)
  local in_use = clock.in_use
  for kind, read in order.each(owner.clocks or {}) do -- any order: each stands alone
    if in_use[kind] == read.own then in_use[kind] = read.before end
  end
  owner.clocks = wrap and {}
  for _, kind in ipairs(wrap and { true, false } or {}) do
    owner.clocks[kind] = { own = wrap(in_use[kind]), before = in_use[kind] }
    in_use[kind] = owner.clocks[kind].own
  end
end

--- Call f(...) meanwhile; return whether it succeeded, and two results.
function track.with_clock(owner, wrap, f, ...)
  track.watch_clock(owner, wrap)
  local is_whole, ok, result, problem = pcall(calls.try, f, ...)
  track.watch_clock(owner, nil)
  if not is_whole then error(ok, 0) end
  return ok, result, problem
end

-- Machines -----------------------------------------------------------------------

--- A machine that is recorded or replayed, and what it calls.
---@class rfsm.record.Track
---@field fsm rfsm.Machine
---@field m integer|nil its number; nil for the machine around the others
---@field rec rfsm.record.Record|false of the iteration that is under way
---@field begin function the pre step hook
---@field finish function the post step hook
---@field reset function the reset hook
---@field guard function called in place of each guard: number, guard, arguments
---@field guards table<rfsm.Transition, { own: function, new: function }>
---@field getevents function|nil set on the machine, in place of its own
---@field own_getevents function|nil

-- Has the guards of a machine asked by its track.
local function replace_guards(own)
  for number, tr in ipairs(rfsm.elements(own.fsm, rfsm.is_trans)) do
    local guard = tr.guard
    if guard then
      local function ask(_, events) return own.guard(number, guard, tr, events) end
      tr.guard, own.guards[tr] = ask, { own = guard, new = ask }
    end
  end
end

--- Return the numbers and texts of the guards of a machine and of those in its states;
-- nil if it has none.
---@param fsm rfsm.Machine
---@return any[]? texts a list for each machine: number, text, number, text ...
function track.guard_texts(fsm)
  local lists, has_some = {}, false
  for i, at in ipairs(rfsm.machines(fsm)) do
    lists[i] = {}
    for number, tr in ipairs(rfsm.elements(at.machine, rfsm.is_trans)) do
      if tr.guard then
        has_some = true
        track.note(lists, i, number, tostring(tr))
      end
    end
  end
  return has_some and lists or nil
end

--- Make the tracks of a machine and of those in its states, by add(track, ...).
function track.attach(fsm, add, ...)
  local tracks = {}
  for i, at in ipairs(rfsm.machines(fsm)) do
    local machine = at.machine
    local own = { fsm = machine, m = i > 1 and i - 1 or nil, rec = false, guards = {} }
    add(own, ...)
    replace_guards(own)
    rfsm.pre_step_hook_add(machine, own.begin, "before")
    rfsm.post_step_hook_add(machine, own.finish, "before")
    rfsm.reset_hook_add(machine, own.reset)
    tracks[i] = own
  end
  return tracks
end

--- Leave the machines as they were.
function track.detach(tracks)
  for _, own in ipairs(tracks) do
    local fsm = own.fsm
    for tr, guard in order.each(own.guards) do -- any order: each stands alone
      if rawequal(tr.guard, guard.new) then tr.guard = guard.own end
    end
    if rawget(fsm, "getevents") == own.getevents then
      fsm.getevents = own.own_getevents
    end
    rfsm.pre_step_hook_rm(fsm, own.begin)
    rfsm.post_step_hook_rm(fsm, own.finish)
    rfsm.reset_hook_rm(fsm, own.reset)
  end
end

return track
