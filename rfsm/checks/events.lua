--- Events: lists of them, and those to which a transition reacts; for the other checks.
--
-- Events are compared by identity.
--
-- @module rfsm.checks.events
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local ipairs, rawequal, rawget = ipairs, rawequal, rawget
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local events = {}

--- Is the event in a list?
---@param list any[]
---@param event any
---@return boolean
function events.has(list, event)
  for i = 1, #list do
    if rawequal(list[i], event) then return true end
  end
  return false
end

--- Return a copy of a list with one event more.
---@param list any[]
---@param event any
---@return any[] longer
function events.with(list, event)
  local longer = { unpack(list) }
  longer[#longer + 1] = event
  return longer
end

--- Is the transition one on any event?
---@param tr rfsm.Transition
---@return boolean
function events.is_any(tr) return not tr.events or tr.events[1] == nil end

--- Does the transition name the event? A predicate names none.
---@param tr rfsm.Transition
---@param event any
---@return boolean
function events.names(tr, event) return events.has(tr.events or {}, event) end

--- Can the transition, and a path on from there, react to some events, as far as names
--- tell, and whatever guards answer?
---@param tr rfsm.Transition
---@param list any[]
---@param seen? table<rfsm.Connector, boolean> those that the path has passed
---@return boolean
function events.may_enable(tr, list, seen)
  local is_named = events.is_any(tr)
  for i = 1, #list do is_named = is_named or events.names(tr, list[i]) end
  seen = seen or {}
  if not is_named or seen[tr.tgt] then return false end
  if not rfsm.is_conn(tr.tgt) then return true end
  seen[tr.tgt] = true
  for _, way in ipairs(tr.tgt._otrs) do
    if events.may_enable(way, list, seen) then return true end
  end
  return false
end

return events
