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

local error, ipairs, rawget = error, ipairs, rawget
local rawset, type = rawset, type
local concat = table.concat

local rfsm_await = {}

-- Run: note the events that are received --------------------------------------------

--- An await(...). It is in the lists `_await` of its source and `_awaits` of the fsm.
---@class rfsm.await.Await
---@field name string the event that occurs when all wanted events were received
---@field wanted string[] the events to wait for
---@field received table<string, boolean> for each wanted event: was it received?
---@field state rfsm.State|false its source
---@field missing integer how many wanted events were not received yet

-- Notes an event. The number of missing events is counted anew, so that an interrupt
-- cannot make it wrong.
local function note_event(await, event)
  if await.received[event] == nil then return end
  await.received[event] = true
  local missing = 0
  for _, wanted in ipairs(await.wanted) do
    if not await.received[wanted] then missing = missing + 1 end
  end
  await.missing = missing
end

-- Has an await note the first n events, and appends its event if it is complete.
local function raise_complete(fsm, await, events, n)
  local was_missing = await.missing
  for i = 1, n do
    if await.received[events[i]] == false then
      rfsm.note_kept(fsm, events[i], await.state, "awaits")
    end
    if was_missing > 0 then note_event(await, events[i]) end
  end
  if await.missing > 0 then return end
  for i = 1, #events do -- current already: after an interrupt, or pending again
    if events[i] == await.name then return end
  end
  events[#events + 1] = await.name
  if was_missing > 0 then rfsm.report(fsm, "dbg", "AWAIT", await.name) end
end

-- The pre step hook: shows the events to the awaits of each active state.
local function check_awaits(fsm)
  local events, state = fsm._curq, fsm._act_leaf and fsm
  local n = #events
  while state and n > 0 do
    local awaits = state._await
    for i = 1, awaits and #awaits or 0 do raise_complete(fsm, awaits[i], events, n) end
    state = state._actchild
  end
end

local function forget(await)
  for _, event in ipairs(await.wanted) do await.received[event] = false end
  await.missing = #await.wanted
end

local function forget_state(_, state)
  for _, await in ipairs(state._await) do forget(await) end
end

local function reset(fsm)
  for _, await in ipairs(fsm._awaits) do forget(await) end
end

-- Returns the data for a snapshot: name of an await -> set of the received events.
local function save(fsm)
  local kept = {}
  for _, await in ipairs(fsm._awaits) do
    for _, event in ipairs(await.missing < #await.wanted and await.wanted or {}) do
      kept[await.name] = kept[await.name] or {}
      kept[await.name][event] = await.received[event] or nil
    end
  end
  return rfsm.sorted_keys(kept)[1] and kept
end

local function load(fsm, kept)
  for _, await in ipairs(fsm._awaits) do
    local received = kept and kept[await.name] or {}
    if type(received) ~= "table" then error("set of events expected", 0) end
    forget(await)
    for _, event in ipairs(await.wanted) do
      if received[event] then note_event(await, event) end
    end
  end
end

-- Adds to a list the events that an await would note for the first time. Returns how
-- many events are missing then.
local function add_noted(list, await, events)
  local missing, is_noted = await.missing, {}
  for _, event in ipairs(events) do
    if await.received[event] == false and not is_noted[event] then
      is_noted[event], missing, list[#list + 1] = true, missing - 1, event
    end
  end
  return missing
end

-- The reaction hook: lists the events for which the awaits of a state wait. With
-- `events`, also lists the awaits that these complete.
local function list_wanted(_, state, events)
  local wanted, complete = {}, {}
  for _, await in ipairs(state._await or {}) do
    if events then
      local missing = add_noted(wanted, await, events)
      complete[#complete + 1] = missing == 0 and events[1] ~= nil and await.name or nil
    else
      for _, event in ipairs(await.wanted) do wanted[#wanted + 1] = event end
    end
  end
  return wanted, events and "awaits" or nil, complete
end

-- Prepare: await(...) becomes an event ----------------------------------------------

-- Replaces the FQN of the source while a text is parsed, since the names of states may
-- contain commas and parentheses.
local SOURCE = "\1"

local function hide_source(text, fqn)
  local from, to = text:find("@" .. fqn, 1, true)
  while from do
    local rest = text:sub(to + 1)
    if rest:find("^[,)%s'\"]") or rest == "" then
      text = text:sub(1, from) .. SOURCE .. rest
    end
    from, to = text:find("@" .. fqn, from + 1, true)
  end
  return text
end

-- Splits "e_a, 'e_b'" into names without blanks and quotes. Returns nil if a name is
-- empty, or has another separator and no quotes.
local function split(text, fqn)
  local names = {}
  for part in (text .. ","):gmatch("([^,]*),") do
    local name = part:match("^%s*(.-)%s*$")
    if name:find("^[^'\"]*[;|]") then return nil end
    name = name:match("^(['\"]).*%1$") and name:sub(2, -2) or name
    if name == "" then return nil end
    local event, count = name:gsub("@" .. SOURCE .. "$", "")
    names[#names + 1] = count == 1 and event .. "@" .. fqn or name
  end
  return names
end

-- Returns the names in "await(e_a, e_b)"; `fqn` is the transition's source. Returns nil
-- for any other event; for a malformed await it returns false and the reason.
local function parse(event, fqn)
  local text = type(event) == "string" and hide_source(event, fqn)
  local inside = text and text:match("^await%s*%((.*)$")
  if not inside or inside:find("%)@" .. SOURCE .. "$") then return nil end
  local names = inside:match("%)$") and split(inside:sub(1, -2), fqn)
  if names and not inside:find("await(", 1, true) then return names end
  return false, "await: a list of events expected, got '" .. event
    .. "' (await(e_a, e_b) would be right)"
end

local function new_await(names, fqn)
  local await = { name = "await(" .. concat(names, ", ") .. ")@" .. fqn,
    wanted = {}, received = {}, state = false, missing = 0 }
  for _, name in ipairs(names) do
    if await.received[name] == nil then await.wanted[#await.wanted + 1] = name end
    await.received[name] = false
  end
  await.missing = #await.wanted
  return await
end

local function warn_never(fsm, tr, event, kind)
  local code = event == "e_done" and "never-done" or "init"
  rfsm.warn(fsm, code, ("%s: '%s' never fires here, '%s' is no %s"):format(
    rfsm.location_of(tr, "events"), event, tr.src._fqn, kind))
end

local function add_await(fsm, state, await)
  if not fsm._awaits then
    fsm._awaits = {}
    rfsm.pre_step_hook_add(fsm, rfsm.repeatable(check_awaits))
    rfsm.reset_hook_add(fsm, reset)
    rfsm.snapshot_hook_add(fsm, "await", save, load, true)
    rfsm.reaction_hook_add(fsm, list_wanted)
  end
  if not state._await then
    state._await = {}
    rfsm.exit_hook_add(fsm, state, rfsm.repeatable(forget_state))
  end
  for _, other in ipairs(state._await) do
    if other.name == await.name then return end
  end
  await.state = state
  state._await[#state._await + 1], fsm._awaits[#fsm._awaits + 1] = await, await
end

-- Adds an await for `names` to the source of `tr`, and returns the name of its event.
local function expand(fsm, tr, names)
  local src = tr.src
  for i = 1, #names do -- here `e_done` is the event of the source's doo
    if names[i] == "e_done" then
      names[i] = "e_done@" .. src._fqn
      src._awaits_done = true
      if not rfsm.can_be_done(src) then
        warn_never(fsm, tr, "e_done", "leaf, and has no final leaf")
      end
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
      local names, reason = parse(event, tr.src._fqn)
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

rfsm.makers[#rfsm.makers + 1] = function(event)
  return event:find("^await%s*%(.*%)@root") and "await" or nil
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_await", rfsm_await) end

return rfsm_await
