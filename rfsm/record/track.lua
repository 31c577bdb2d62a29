--- Tracks: common parts of recording and replay.
--
-- They are events as plain data, a quick test for changed data, and the hooks, guards
-- and clocks of a machine and its regions.
--
-- @module rfsm.record.track
-- @license BSD-3-Clause

local order = require "rfsm.shared.order"
local encoding = require "rfsm.snapshot.encoding"
local rfsm = require "rfsm"
local instrument = require "rfsm.shared.instrument"
local stream = require "rfsm.observe.stream"

local ipairs = ipairs
local rawequal, rawget, select, tostring = rawequal, rawget, select, tostring
local type = type
local concat = table.concat
local text_of = rfsm.text_of

local track = {}

-- Data ----------------------------------------------------------------------------

local PATH = { owner = "", seen = {} }

--- Return plain data for a text, number or boolean.
function track.pack(value) return encoding.pack(value, PATH, 0) end

--- Return an event as plain data. A table or another object becomes the name of its
-- type, which cannot be replayed.
function track.pack_event(event)
  if encoding.is_scalar(event) then return track.pack(event) end
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

--- Return the active leaf of a record as text.
function track.leaf_text(leaf, is_done)
  return leaf and leaf .. (is_done and "(done)" or "(active)") or "none"
end

--- Are plain data the same?
function track.same(a, b)
  if type(a) ~= "table" or type(b) ~= "table" then return rawequal(a, b) end
  for key, value in order.each(a) do
    if not track.same(value, b[key]) then return false end
  end
  for key in order.each(b) do
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

-- Changes of data that the chart keeps, and of targets -------------------------------

--- Return the values of a machine that `may_have_changed` compares.
function track.observe_data(fsm)
  local observed = { transitions = rfsm.elements(fsm, rfsm.is_trans), targets = {},
    states = {}, names = {}, values = {}, is_deep = false, has_changed = false }
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    if type(state.save) == "function" then observed.is_deep = true end
    for _, name in ipairs(type(state.keep) == "table" and state.keep or {}) do
      observed.states[#observed.states + 1] = state
      observed.names[#observed.names + 1] = name
    end
  end
  track.may_have_changed(observed)
  observed.has_changed = false
  return observed
end

--- May the data have changed since the caller has set `has_changed` to false? A table
-- may, at any time.
function track.may_have_changed(observed)
  local values, names = observed.values, observed.names
  if observed.is_deep then observed.has_changed = true end
  for i, state in ipairs(observed.states) do
    local value = state[names[i]]
    if type(value) == "table" or not rawequal(value, values[i]) then
      observed.has_changed, values[i] = true, value
    end
  end
  local targets = observed.targets
  for i, tr in ipairs(observed.transitions) do
    local tgt = tr.tgt
    if targets[i] ~= tgt then observed.has_changed, targets[i] = true, tgt end
  end
  return observed.has_changed
end

-- Machines -----------------------------------------------------------------------

--- A machine that is recorded or replayed, and the functions that it calls.
---@class rfsm.record.Track
---@field fsm rfsm.Machine
---@field m integer|nil its number, if it is a region
---@field rec rfsm.record.Record|false of the present iteration
---@field began fun(events: any[])
---@field finished fun(events: any[])
---@field reset fun()
---@field failed fun(element: table, name: string)
---@field guard function called in place of each guard: number, guard, arguments
---@field clock fun(own: function?): function returns a clock in place of its own
---@field getevents fun(own: function): function|nil likewise getevents
---@field changes table[]
---@field wrapped table<string, table> the last change of a field of the machine

-- Replaces a function of the machine, again if a program has set another one meanwhile.
local function wrap(own, field, make)
  local wrapped, value = own.wrapped[field], rawget(own.fsm, field)
  if not (wrapped and rawequal(wrapped.new, value)) then
    own.wrapped[field] = instrument.put(own.changes, own.fsm, field, make(value))
  end
end

--- Replace getevents and the clock of a machine. A region without a clock reads that of
-- its parent machine.
function track.wrap(own)
  local fsm = own.fsm
  if own.m == nil or rawget(fsm, "gettime") then wrap(own, "gettime", own.clock) end
  if rawget(fsm, "getevents") then wrap(own, "getevents", own.getevents) end
end

--- Return the guards of a machine and its regions, nil if there are none: for each
-- machine a list { number, text, number, text ... }.
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

-- Returns the numbers of the transitions of a machine.
local function numbers_of(fsm)
  local numbers = {}
  for i, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do numbers[tr] = i end
  return numbers
end

--- Make the tracks of a machine and its regions, by add(track, ...).
function track.attach(fsm, add, ...)
  local tracks, of = {}, {}
  for i, at in ipairs(rfsm.machines(fsm)) do
    local own = { fsm = at.machine, m = i > 1 and i - 1 or nil, rec = false,
      changes = {}, wrapped = {}, number_of = numbers_of(at.machine) }
    add(own, ...)
    track.wrap(own)
    tracks[i], of[at.machine] = own, own
  end
  -- what is merged in meanwhile has no track, and no number
  local listener = { guard = function(at, tr, guard, events)
    local own = of[at.machine]
    local number = own and own.number_of[tr]
    if not number then return guard(tr, events) end
    return own.guard(number, guard, tr, events)
  end }
  for _, name in ipairs { "began", "finished", "reset", "failed" } do
    listener[name] = function(at, first, second)
      local own = of[at.machine]
      if own then own[name](first, second) end
    end
  end
  tracks.stream = stream.follow(fsm, listener)
  return tracks
end

--- Leave the machines as they were.
function track.detach(tracks)
  if tracks.stream then tracks.stream:stop() end
  for _, own in ipairs(tracks) do instrument.give_back(own.changes) end
end

return track
