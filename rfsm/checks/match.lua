--- Match: which events a transition names, and lists of them; for the other checks.
--
-- Events are compared by identity.
--
-- @module rfsm.checks.match
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local ipairs = ipairs
local rawequal, rawget = rawequal, rawget
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local match = {}

--- Is the event in a list?
function match.has(list, event)
  for i = 1, #list do
    if rawequal(list[i], event) then return true end
  end
  return false
end

--- Return a copy of a list with one event more.
function match.with(list, event)
  local longer = { unpack(list) }
  longer[#longer + 1] = event
  return longer
end

--- Is the transition one on any event?
function match.is_any(tr) return not tr.events or tr.events[1] == nil end

--- Does the transition name the event? A predicate names none.
function match.names(tr, event) return match.has(tr.events or {}, event) end

--- Can the transition, and a path on from there, react to some events, as far as names
--- tell, and whatever guards answer?
---@param tr rfsm.Transition
---@param list any[]
---@param seen? table<rfsm.Connector, boolean> those that the path has passed
---@return boolean
function match.may_enable(tr, list, seen)
  local is_named = match.is_any(tr)
  for i = 1, #list do is_named = is_named or match.names(tr, list[i]) end
  seen = seen or {}
  if not is_named or seen[tr.tgt] then return false end
  if not rfsm.is_conn(tr.tgt) then return true end
  seen[tr.tgt] = true
  for _, way in ipairs(tr.tgt._otrs) do
    if match.may_enable(way, list, seen) then return true end
  end
  return false
end

return match
