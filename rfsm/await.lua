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

local error, ipairs, next, pairs = error, ipairs, next, pairs
local rawget, rawset, type = rawget, rawset, type
local concat = table.concat

local rfsm_await = {}

-- Run: note the events that are received --------------------------------------------

--- One await of a state; the list of them is the field `_await` of the state.
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

-- Appends the event of an await that is complete.
local function raise_complete(fsm, await, events, n)
  local was_missing = await.missing
  if was_missing > 0 then note_events(await, events, n) end
  if await.missing > 0 then return end
  events[#events + 1] = await.name
  if was_missing > 0 then rfsm.report(fsm, "dbg", "AWAIT", await.name) end
end

-- This runs in every iteration.
local function check_awaits(fsm)
  local events, state = fsm._curq, fsm._act_leaf and fsm
  local n = #events
  while state and n > 0 do
    local awaits = state._await
    for i = 1, awaits and #awaits or 0 do raise_complete(fsm, awaits[i], events, n) end
    state = state._actchild
  end
end

local function forget(_, state)
  for _, await in ipairs(state._await) do
    await.received, await.missing = {}, await.count
  end
end

local function has_await(obj) return rfsm.is_state(obj) and obj._await ~= nil end

local function reset(fsm)
  for _, state in ipairs(rfsm.elements(fsm, has_await)) do forget(fsm, state) end
end

-- Snapshots hold the events that were received, by the names of awaits.
local function save(fsm)
  local received = nil
  for _, state in ipairs(rfsm.elements(fsm, has_await)) do
    for _, await in ipairs(state._await) do
      if next(await.received) ~= nil then
        local copy = {}
        for event in pairs(await.received) do copy[event] = true end -- any order
        received = received or {}
        received[await.name] = copy
      end
    end
  end
  return received
end

local function load(fsm, received)
  for _, state in ipairs(rfsm.elements(fsm, has_await)) do
    forget(fsm, state)
    for _, await in ipairs(state._await) do
      local kept = received and received[await.name] or {}
      if type(kept) ~= "table" then error("set of events expected", 0) end
      for event in pairs(kept) do note_events(await, { event }, 1) end -- any order
    end
  end
end

-- Prepare: await(...) becomes an event of its own -----------------------------------

-- Splits "e_a, 'e_b'" into names without blanks and quotes; nil if one is empty.
local function split(text)
  local names = {}
  for part in (text .. ","):gmatch("([^,]*),") do
    local name = part:match("^%s*(.-)%s*$")
    name = name:match("^(['\"]).*%1$") and name:sub(2, -2) or name
    if name == "" then return nil end
    names[#names + 1] = name
  end
  return names
end

-- Returns the names in "await(e_a, e_b)"; nil if it is another event, false and the
-- reason if it was meant to be one.
local function parse(event)
  local inside = type(event) == "string" and event:match("^await%s*%((.*)$")
  if not inside or inside:find("%)@[^%)]*$") then return nil end
  local names = inside:match("%)$") and split(inside:sub(1, -2))
  if names and not inside:find("await(", 1, true) then return names end
  return false, "await: a list of events expected, got '" .. event
    .. "' (await(e_a, e_b) would be right)"
end

local function new_await(names, fqn)
  local await = { name = "await(" .. concat(names, ", ") .. ")@" .. fqn,
    wanted = {}, received = {}, missing = 0, count = 0 }
  for _, name in ipairs(names) do
    if not await.wanted[name] then await.count = await.count + 1 end
    await.wanted[name] = true
  end
  await.missing = await.count
  return await
end

local function warn_never(fsm, tr, event, kind)
  rfsm.report(fsm, "warn", ("WARNING: %s: '%s' never fires here, '%s' is no %s"):format(
    rfsm.location_of(tr, "events"), event, tr.src._fqn, kind))
end

local function add_await(fsm, state, await)
  if not fsm._has_await then
    fsm._has_await = true
    rfsm.pre_step_hook_add(fsm, check_awaits)
    rfsm.reset_hook_add(fsm, reset)
    rfsm.snapshot_hook_add(fsm, "await", save, load)
  end
  if not state._await then
    state._await = {}
    rfsm.exit_hook_add(fsm, state, forget)
  end
  for _, other in ipairs(state._await) do
    if other.name == await.name then return end
  end
  state._await[#state._await + 1] = await
end

-- Returns the name of the event for the await of `names` at the source of `tr`.
local function expand(fsm, tr, names)
  local src = tr.src
  for i = 1, #names do -- as outside of await, `e_done` is that of the source
    if names[i] == "e_done" then
      names[i] = "e_done@" .. src._fqn
      if not rfsm.is_leaf(src) then warn_never(fsm, tr, "e_done", "leaf state") end
    end
  end
  local await = new_await(names, src._fqn)
  if rfsm.is_state(src) then
    add_await(fsm, src, await)
  else
    warn_never(fsm, tr, "await(" .. concat(names, ", ") .. ")", "state")
  end
  return await.name
end

rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  local problems = {}
  for _, tr in ipairs(rfsm.elements(merged or fsm, rfsm.is_trans)) do
    for i, event in ipairs(tr.events) do
      local names, reason = parse(event)
      if names then
        tr.events[i] = expand(fsm, tr, names)
      elseif names == false then
        problems[#problems + 1] = rfsm.location_of(tr, "events[" .. i .. "]") .. ": "
          .. reason
      end
    end
  end
  return problems
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_await", rfsm_await) end

return rfsm_await
