--- Order: transitions that are never taken because others are tried earlier, and those
--- that only their position decides between.
--
-- @module rfsm.checks.order
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local structure = require "rfsm.checks.structure"

local ipairs, type = ipairs, type
local is_conn = rfsm.is_conn

local order = {}

local is_always_enabled

local function has_events(tr) return tr.events and tr.events[1] ~= nil end

-- Does some path lead on from this connector, whatever the events and guards?
local function has_path(connector, seen)
  if seen[connector] then return false end
  seen[connector] = true
  for _, tr in ipairs(connector._otrs) do
    if not has_events(tr) and is_always_enabled(tr, seen) then return true end
  end
  return false
end

-- Is `tr` always enabled, once its events match?
function is_always_enabled(tr, seen)
  if tr.guard then return false end
  return not is_conn(tr.tgt) or has_path(tr.tgt, seen)
end

local ANY = {} -- stands for each event of a transition that has none

-- May the event enable `tr`, as far as names tell? Predicates may accept anything, but
-- nobody can rely on it.
local function names(tr, event)
  if not has_events(tr) then return true end
  if event == ANY or type(event) == "function" then return false end
  for _, other in ipairs(tr.events) do
    if rawequal(other, event) then return true end
  end
  return false
end

-- Returns a transition that is tried before `tr`, from its source or a composite that
-- the source is in, and always taken on the event.
local function find_shadow(fsm, tr, event)
  local node, found = tr.src, nil
  while true do
    for _, other in ipairs(node._otrs) do
      if other == tr then break end
      if names(other, event) and is_always_enabled(other, {}) then
        found = other
        break
      end
    end
    if is_conn(node) or node == fsm then return found end
    node = node._parent
  end
end

-- Lists the transitions one of which is taken before `tr` on each of its events; nil if
-- an event is left to it.
local function find_shadows(fsm, tr)
  local list, is_listed = {}, {}
  for _, event in ipairs(has_events(tr) and tr.events or { ANY }) do
    local shadow = find_shadow(fsm, tr, event)
    if not shadow then return nil end
    if not is_listed[shadow] then list[#list + 1] = shadow end
    is_listed[shadow] = true
  end
  return list
end

local function check_shadows(fsm, tr, add)
  local shadows = find_shadows(fsm, tr)
  if not shadows then return false end
  local texts = {}
  for i, other in ipairs(shadows) do texts[i] = rfsm.location_of(other) end
  add("shadowed", tr, "never taken, " .. table.concat(texts, " and ") .. " always "
    .. (texts[2] and "come" or "comes") .. " first")
  return true
end

-- Returns an event that enables both, as a text.
local function shared_event(tr, other)
  if not has_events(tr) then return has_events(other) and other.events[1] or "any" end
  for _, event in ipairs(tr.events) do
    if type(event) ~= "function" and names(other, event) then return event end
  end
end

-- A guard in front of a transition without one reads as if and else.
local function check_conflicts(tr, add)
  for _, other in ipairs(tr.src._otrs) do
    if other == tr then return end
    local event = (other.pn or 0) == (tr.pn or 0) and shared_event(tr, other)
    if event and (tr.guard or not other.guard) then
      add("conflict", tr, ("enabled together with %s on %s, and of the same pn"):format(
        rfsm.location_of(other), event == "any" and "any event" or rfsm.text_of(event)))
      return
    end
  end
end

--- Find what is wrong with the order of transitions.
---@param fsm rfsm.Machine
---@param add fun(code: string, obj: table, text: string)
function order.check(fsm, add)
  local reached = structure.reached(fsm)
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    if reached[tr.src] and not check_shadows(fsm, tr, add) then
      check_conflicts(tr, add)
    end
  end
end

return order
