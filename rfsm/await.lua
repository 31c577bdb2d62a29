--- Await: transitions that wait for several events.
--
-- Once this module is loaded, a transition may have the event `"await(e_a, e_b)"`. It
-- occurs when all named events were received while the source was active, in any order
-- and over any number of steps. From then on it occurs with any other event, until the
-- source is left.
--
-- @module rfsm.await
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local print, rawget, rawset, type = print, rawget, rawset, type
local concat = table.concat
local actchild_get = rfsm.actchild_get

local rfsm_await = {}

-- Run: note what is received ---------------------------------------------------

--- One await of a state; the list of them is its field `_await`.
---@class rfsm.await.Await
---@field name string the event that comes when all were received
---@field wanted table<string, boolean> the events to wait for
---@field received table<string, boolean> those that came
---@field missing integer how many did not
---@field count integer how many are wanted

local function note_events(await, events, n)
  for i = 1, n do
    local event = events[i]
    if await.wanted[event] and not await.received[event] then
      await.received[event] = true
      await.missing = await.missing - 1
    end
  end
end

local function tell(fsm, name)
  local dbg = fsm.dbg
  if dbg == true then dbg = print end
  if dbg then dbg("AWAIT", name) end
end

-- Appends the events of what is complete; tells of what has just become so.
local function raise_complete(fsm)
  local events = fsm._curq
  local n = #events
  if n == 0 or rfsm.get_sta_mode(fsm) == "inactive" then return end
  local state = fsm
  while state do
    local awaits = state._await
    for i = 1, awaits and #awaits or 0 do
      local await = awaits[i]
      local was_missing = await.missing
      if was_missing > 0 then note_events(await, events, n) end
      if await.missing == 0 then
        events[#events + 1] = await.name
        if was_missing > 0 then tell(fsm, await.name) end
      end
    end
    state = actchild_get(state)
  end
end

local function forget(_, state)
  local awaits = state._await
  for i = 1, #awaits do awaits[i].received, awaits[i].missing = {}, awaits[i].count end
end

local function reset(fsm)
  if fsm._await then forget(fsm, fsm) end
  rfsm.mapfsm(function(state)
    if state._await then forget(fsm, state) end
  end, fsm, rfsm.is_state)
end

-- Prepare: await(...) becomes an event of its own ------------------------------

local function place_of(tr)
  local key = type(tr._id) == "number" and ("trans[%d]"):format(tr._id) or tr._id
  return tr._parent._fqn .. "." .. key
end

-- Splits "e_a, e_b" into trimmed names; nil when one is empty.
local function split(text)
  local names = {}
  for part in (text .. ","):gmatch("([^,]*),") do
    local name = part:match("^%s*(.-)%s*$")
    if name == "" then return nil end
    names[#names + 1] = name
  end
  return names
end

-- Returns the names in "await(e_a, e_b)"; nil when it is another event, false and the
-- reason when it was meant so.
local function parse(event)
  local inside = type(event) == "string" and event:match("^await%s*%((.*)$")
  if not inside or inside:find("%)@[^%)]*$") then return nil end
  local names = inside:match("%)$") and split(inside:sub(1, -2))
  if not names or inside:find("await(", 1, true) then
    return false, "await: a list of events expected, got '" .. event
      .. "' (await(e_a, e_b) would be right)"
  end
  return names
end

local function new_await(names, fqn)
  local wanted, count = {}, 0
  for i = 1, #names do
    if not wanted[names[i]] then count = count + 1 end
    wanted[names[i]] = true
  end
  return {
    name = "await(" .. concat(names, ", ") .. ")@" .. fqn,
    wanted = wanted, received = {}, missing = count, count = count,
  }
end

local function warn_never(fsm, tr, what, why)
  fsm.warn(("WARNING: %s: '%s' never fires here, '%s' is no %s"):format(place_of(tr),
    what, tr.src._fqn, why))
end

-- `e_done` means that of the source, as outside of await.
local function expand_e_done(fsm, tr, names)
  for i = 1, #names do
    if names[i] == "e_done" then
      names[i] = "e_done@" .. tr.src._fqn
      if not rfsm.is_leaf(tr.src) then warn_never(fsm, tr, "e_done", "leaf state") end
    end
  end
end

local function add_await(fsm, state, await)
  if not fsm._has_await then
    fsm._has_await = true
    rfsm.pre_step_hook_add(fsm, raise_complete)
    rfsm.reset_hook_add(fsm, reset)
  end
  if not state._await then
    state._await = {}
    rfsm.exit_hook_add(fsm, state, forget)
  end
  local awaits = state._await
  for i = 1, #awaits do
    if awaits[i].name == await.name then return end
  end
  awaits[#awaits + 1] = await
end

-- Returns the name of the event for the await of `names` at the source of `tr`.
local function expand(fsm, tr, names)
  expand_e_done(fsm, tr, names)
  local await = new_await(names, tr.src._fqn)
  if rfsm.is_state(tr.src) then
    add_await(fsm, tr.src, await)
  else
    warn_never(fsm, tr, "await(" .. concat(names, ", ") .. ")", "state")
  end
  return await.name
end

local function prepare_transition(fsm, tr, problems)
  if type(tr.events) == "string" then tr.events = { tr.events } end
  local events = tr.events
  for i = 1, events and #events or 0 do
    local names, reason = parse(events[i])
    if names then
      events[i] = expand(fsm, tr, names)
    elseif names == false then
      problems[#problems + 1] = place_of(tr) .. ".events[" .. i .. "]: " .. reason
    end
  end
end

local function prepare(fsm, merged)
  local obj, problems = merged or fsm, {}
  if rfsm.is_trans(obj) then
    prepare_transition(fsm, obj, problems)
  elseif rfsm.is_state(obj) then
    rfsm.mapfsm(function(tr) prepare_transition(fsm, tr, problems) end, obj,
      rfsm.is_trans)
  end
  return problems
end

rfsm.preproc[#rfsm.preproc + 1] = prepare

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_await", rfsm_await) end

return rfsm_await
