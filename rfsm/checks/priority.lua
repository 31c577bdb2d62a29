--- Order: finds transitions that are never taken because others are tried before them.
--- Also finds pairs of transitions of which one is taken only because it comes first.
--
-- @module rfsm.checks.priority
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local match = require "rfsm.shared.match"
local location = require "rfsm.shared.location"
local order = require "rfsm.shared.order"

local ipairs, setmetatable, type = ipairs, setmetatable, type
local is_conn = rfsm.is_conn

local priority = {}

local is_always_enabled

-- Is a path from this connector always enabled, whatever the events and guards?
local function has_path(connector, seen)
  if seen[connector] then return false end
  seen[connector] = true
  return order.any(connector._otrs, function(tr)
    return match.is_any(tr) and is_always_enabled(tr, seen)
  end)
end

-- Is `tr` always enabled, once its events match?
function is_always_enabled(tr, seen)
  if tr.guard then return false end
  return not is_conn(tr.tgt) or has_path(tr.tgt, seen)
end

local ANY = {} -- stands for any event
local NONE = {} -- stands for no event, which `always = true` needs

-- Does the event trigger `tr` for certain? If a predicate decides, the answer is no.
-- What needs no event is taken before any event comes.
local function is_enabled_by(tr, event)
  if event == NONE or tr.always == true then return tr.always == true end
  return match.is_any(tr) or type(event) ~= "function" and match.triggers(tr, event)
end

-- A path from a connector may have passed any connector before, so all count as seen.
local ALL = setmetatable({}, { __index = function() return true end })

-- Returns the first transition in a list that comes before `tr` and is always taken on
-- the event; nil if there is none. One that needs no event comes before those that do.
local function find_shadow(list, tr, event)
  local is_later = false
  for _, other in ipairs(list) do
    is_later = is_later or other == tr
    if other ~= tr and (not is_later or other.always == true and event ~= NONE)
      and is_enabled_by(other, event)
      and is_always_enabled(other, is_conn(tr.src) and ALL or {}) then
      return other
    end
  end
end

-- Lists the transitions that are taken in place of `tr` on its events; nil if `tr` may
-- be taken on one of these events.
local function find_shadows(fsm, tr)
  local list, is_listed = {}, {}
  local tried = is_conn(tr.src) and tr.src._otrs or location.transitions(fsm, tr.src)
  local events = tr.always == true and { NONE } or match.is_any(tr) and { ANY }
  for _, event in ipairs(events or tr.events) do
    local shadow = find_shadow(tried, tr, event)
    if not shadow then return nil end
    if not is_listed[shadow] then list[#list + 1] = shadow end
    is_listed[shadow] = true
  end
  return list
end

local function check_shadows(fsm, tr, add)
  local shadows = find_shadows(fsm, tr)
  if not shadows then return false end
  add("shadowed", tr, "never taken, " .. table.concat(order.map(shadows,
    rfsm.location_of), " and ") .. " always " .. (shadows[2] and "come" or "comes")
    .. " first")
  return true
end

-- Is `other` taken in place of `tr` only because it comes first? A guarded transition
-- before one without a guard is meant as if and else, so it is no clash. At a connector
-- it is a clash nevertheless, because the engine warns of such pairs there.
local function may_clash(tr, other)
  return (other.pn or 0) == (tr.pn or 0)
    and (tr.guard or not other.guard or is_conn(tr.src))
end

-- Returns the text of an event that enables both transitions; nil if there is none.
local function shared_event(tr, other)
  if match.is_any(tr) and match.is_any(other) then return "any event" end
  if (tr.always == true) ~= (other.always == true) then return nil end
  if tr.always == true then return "no event" end
  for _, event in ipairs(match.is_any(tr) and other.events or tr.events) do
    if type(event) ~= "function" and is_enabled_by(other, event) then
      return rfsm.event_text(event)
    end
  end
end

local function check_conflicts(tr, add)
  for _, other in ipairs(tr.src._otrs) do
    if other == tr then return end
    local event = may_clash(tr, other) and shared_event(tr, other)
    if event then
      return add("conflict", tr, ("enabled together with %s on %s, and of the same pn")
        :format(rfsm.location_of(other), event))
    end
  end
end

--- Find mistakes in the order of transitions.
---@type rfsm_checks.Check
function priority.check(fsm, add, reached)
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    if reached[tr.src] and not check_shadows(fsm, tr, add) then
      check_conflicts(tr, add)
    end
  end
end

return priority
