--- Tracks: functions that recording and replay share.
--
-- A track follows one machine: the outermost one, or a region. It replaces the guards,
-- getevents and the clock of the machine, and tests quickly if data has changed. Events
-- are noted as plain data.
--
-- @module rfsm.record.track
-- @license BSD-3-Clause

local order = require "rfsm.shared.order"
local encoding = require "rfsm.snapshot.encoding"
local match = require "rfsm.shared.match"
local rfsm = require "rfsm"
local instrument = require "rfsm.shared.instrument"
local stream = require "rfsm.observe.stream"

local ipairs = ipairs
local rawequal, rawget, tostring = rawequal, rawget, tostring
local type = type
local concat, max = table.concat, math.max
local text_of = rfsm.text_of

local track = {}

-- Data ----------------------------------------------------------------------------

--- Return an event as plain data. An object, or an event whose data cannot be saved, is
-- noted by its type and its name. Such an event cannot be replayed.
function track.pack_event(event)
  if encoding.is_scalar(event) then return encoding.pack(event) end
  local path = { owner = "event", seen = false, is_by_value = true }
  local packed = encoding.is_event(event) and encoding.attempt(encoding.pack, event,
    path, 0)
  local name = type(event) == "table" and rawget(event, "name")
  return packed or { "%x", type(event), type(name) == "string" and name or nil }
end

--- Return events as plain data; nil if there are none.
function track.pack_events(events)
  return events[1] ~= nil and order.map(events, track.pack_event) or nil
end

local function is_object(packed)
  return type(packed) == "table" and packed[1] == "%x"
end

--- Return the text of a packed event; of an object its name, or its type.
function track.event_text(packed)
  if is_object(packed) then return text_of(packed[3] or packed[2]) end
  return rfsm.event_text(encoding.unpack(packed, 0), true)
end

local function long_text(packed)
  if not is_object(packed) then return track.event_text(packed) end
  local name = packed[3] and (" named '%s'"):format(text_of(packed[3])) or ""
  return "an event that is a " .. text_of(packed[2]) .. name
end

--- Return a list of packed events as text: "e_a, e_b", or "none".
function track.list_text(list)
  return list and list[1] ~= nil and concat(order.map(list, long_text), ", ") or "none"
end

--- Return an active leaf as text: "root.a(active)", "root.a(done)" or "none".
function track.leaf_text(leaf, is_done)
  return leaf and leaf .. (is_done and "(done)" or "(active)") or "none"
end

--- Are two values of plain data equal?
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

-- Queues --------------------------------------------------------------------------

--- Note the queue at the beginning of an iteration, which has taken `count` events.
-- Return how many events still wait of those that waited when the last iteration ended,
-- and whether these are all that did, and all that wait.
function track.note_queue(own, count)
  local queue, old, n = own.fsm._intq, own.queue, 0
  while old[count + n + 1] ~= nil and rawequal(old[count + n + 1], queue[n + 1]) do
    n = n + 1
  end
  own.held = match.joined({}, queue)
  return n, n == max(#old - count, 0) and queue[n + 1] == nil
end

--- Return the events that were sent in an iteration, how many of them are ahead of
-- those that waited before, and the latter. Those at `first` to `last`, if these are
--- given, are left out.
function track.sent_in(own, first, last)
  local queue, held, ahead = own.fsm._intq, own.held, 0
  local sent, waiting = {}, {}
  for i = 1, #queue do
    local next_held = held[#waiting + 1]
    if next_held ~= nil and rawequal(queue[i], next_held) then
      if waiting[1] == nil then ahead = #sent end
      waiting[#waiting + 1] = next_held
    elseif not first or i < first or i > last then
      sent[#sent + 1] = queue[i]
    end
  end
  return sent, ahead, waiting
end

--- Return a queue of these events, in their order.
function track.queue_of(sent, ahead, waiting)
  local list = {}
  for i = 1, ahead do list[i] = sent[i] end
  for i = 1, #waiting do list[#list + 1] = waiting[i] end
  for i = ahead + 1, #sent do list[#list + 1] = sent[i] end
  return list
end

-- Changes of data that the chart keeps, and of targets -------------------------------

--- Return the kept fields and targets of a machine and their values.
function track.observe_data(fsm)
  local observed = { has_save = false }
  local function add(obj, field, is_data)
    observed[#observed + 1] = { obj = obj, field = field, is_data = is_data,
      value = obj[field] }
  end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do add(tr, "tgt", false) end
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    if type(state.save) == "function" then observed.has_save = true end
    for _, name in ipairs(type(state.keep) == "table" and state.keep or {}) do
      add(state, name, true)
    end
  end
  return observed
end

--- May the data have changed since its values were noted? If a kept field has a table,
-- or a state has the function `save`, the data counts as changed.
function track.may_have_changed(observed)
  for i = 1, #observed do
    local one = observed[i]
    local value = one.obj[one.field]
    if one.is_data and type(value) == "table" or value ~= one.value then return true end
  end
  return observed.has_save
end

--- Note the present values, with which `may_have_changed` compares later ones.
function track.note_values(observed)
  for _, one in ipairs(observed) do one.value = one.obj[one.field] end
end

-- Machines -----------------------------------------------------------------------

--- A machine that is recorded or replayed: the outermost one, or a region.
---@class rfsm.record.Track
---@field fsm rfsm.Machine
---@field m integer|nil number of the region; nil for the outermost machine
---@field rec rfsm.record.Record|false the record of the present iteration
---@field held any[] the queue when the present iteration began
---@field queue any[] the queue when the last iteration ended
---@field is_free boolean transitions that need no event are searched, or one is taken
---@field listener table<string, function> the functions that `track.attach` calls
---@field session table the recorder, or the session of a replay
---@field number_of table<rfsm.Transition, integer>
---@field changes table[] fields that were replaced, for `track.detach`
---@field wrapped table<string, table> the last changes of "getevents" and "gettime"

-- Replaces a function of the machine by the one that the listener returns. Does so
-- again if a program has set another function since.
local function wrap(own, field)
  local wrapped, value = own.wrapped[field], rawget(own.fsm, field)
  if not (wrapped and rawequal(wrapped.new, value)) then
    own.wrapped[field] = instrument.put(own.changes, own.fsm, field,
      own.listener[field](own.session, own, value))
  end
end

--- Replace getevents and the clock of a machine. A region that has no clock uses the
-- clock of its parent machine.
function track.wrap(own)
  local fsm = own.fsm
  if own.m == nil or rawget(fsm, "gettime") then wrap(own, "gettime") end
  if rawget(fsm, "getevents") then wrap(own, "getevents") end
end

--- Return for a machine and each region a list { number, text, number, text ... } of
-- the transitions that have a guard. Return nil if there are no guards.
function track.guard_texts(fsm)
  local lists, has_some = {}, false
  for i, at in ipairs(rfsm.machines(fsm)) do
    lists[i] = {}
    for number, tr in ipairs(rfsm.elements(at.machine, rfsm.is_trans)) do
      if tr.guard then
        has_some = true
        order.append(lists, i, number)
        order.append(lists, i, tostring(tr))
      end
    end
  end
  return has_some and lists or nil
end

-- Returns a table transition -> number, for the transitions of a machine.
local function numbers_of(fsm)
  local numbers = {}
  for i, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do numbers[tr] = i end
  return numbers
end

local HEARD = { "free", "began", "finished", "reset", "failed" }

--- Make the tracks of a machine and its regions. The functions of `listener` are called
-- with the session, a track, and these arguments:
--
--    attached()                     the machine is about to be followed
--    free(tr)                       a transition that needs no event is looked at
--    began(events), finished(events), reset(), failed(element, name)
--    guard(number, own, tr, events) called in place of the guard `own`
--    gettime(own), getevents(own)   return a function in place of the machine's own
function track.attach(fsm, listener, session)
  local tracks, of, heard = {}, {}, {}
  for i, at in ipairs(rfsm.machines(fsm)) do
    local own = { fsm = at.machine, m = i > 1 and i - 1 or nil, rec = false,
      is_free = false, queue = {},
      listener = listener, session = session, number_of = numbers_of(at.machine),
      changes = {}, wrapped = {} }
    listener.attached(session, own)
    track.wrap(own)
    tracks[i], of[at.machine] = own, own
  end
  -- A machine that is merged in later has no track. A new transition has no number.
  function heard.guard(at, tr, guard, events, event)
    local own = of[at.machine]
    local number = own and own.number_of[tr]
    if not number then return guard(tr, events, event) end
    return listener.guard(session, own, number, guard, tr, events, event)
  end
  for _, name in ipairs(HEARD) do
    local f = listener[name]
    heard[name] = f and function(at, ...)
      if of[at.machine] then return f(session, of[at.machine], ...) end
    end
  end
  tracks.stream = stream.follow(fsm, heard)
  return tracks
end

--- Give the machines their own guards, getevents and clocks back.
function track.detach(tracks)
  if tracks.stream then tracks.stream:stop() end
  for _, own in ipairs(tracks) do instrument.give_back(own.changes) end
end

return track
