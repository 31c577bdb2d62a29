--- Paths: connectors that lead nowhere at times, and back to themselves.
--
-- @module rfsm.checks.paths
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local match = require "rfsm.checks.match"

local ipairs, type = ipairs, type
local concat = table.concat
local is_conn = rfsm.is_conn

local paths = {}

-- Which events can reach a connector ..............................................

local ANY = setmetatable({}, { __tostring = function() return "any event" end })

-- Returns what a transition lets pass of an event, or of any.
local function passing(tr, event)
  if match.is_any(tr) or match.names(tr, event) then return { event } end
  return event == ANY and tr.events or {}
end

-- Notes the connectors to which a transition leads an event that comes to its source; a
-- predicate says nothing of what comes.
local function arrive(arrivals, tr, event)
  for _, own in ipairs(is_conn(tr.tgt) and passing(tr, event) or {}) do
    local list = arrivals[tr.tgt] or {}
    if not list[own] and type(own) ~= "function" then
      arrivals[tr.tgt], list[own], list[#list + 1] = list, true, own
      for _, way in ipairs(tr.tgt._otrs) do arrive(arrivals, way, own) end
    end
  end
end

-- Returns for each connector the events that can lead to it, one at a time.
local function arrivals_of(fsm)
  local arrivals = {}
  arrive(arrivals, { tgt = fsm.initial }, "e_init_fsm")
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    if not is_conn(tr.src) then arrive(arrivals, tr, ANY) end
  end
  return arrivals
end

-- Is there a way on for this event that no guard can close?
local function has_default(connector, event)
  for _, tr in ipairs(connector._otrs) do
    if not tr.guard and (match.is_any(tr) or match.names(tr, event)) then
      return true
    end
  end
  return false
end

local function check_default(connector, arriving, add)
  local texts = {}
  for _, event in ipairs(arriving or {}) do
    if not has_default(connector, event) then
      texts[#texts + 1] = rfsm.text_of(event)
    end
  end
  if not texts[1] or not connector._otrs[1] then return end
  local list = concat(texts, ", ")
  if connector._id == "initial" then
    add("closed-initial", connector, ("each transition from here has events or a guard,"
      .. " '%s' cannot be entered on %s while none of them is enabled"):format(
      connector._parent._fqn, list))
  else
    add("no-default", connector, "no way on without a guard for " .. list)
  end
end

-- Cycles ..........................................................................

-- Returns the connectors on a way from `node` back to `start`, without `start`.
local function find_cycle(start, node, seen)
  if seen[node] then return nil end
  seen[node] = true
  for _, tr in ipairs(node._otrs) do
    if tr.tgt == start then return { node._fqn } end
    local rest = is_conn(tr.tgt) and find_cycle(start, tr.tgt, seen)
    if rest then
      table.insert(rest, 1, node._fqn)
      return rest
    end
  end
end

--- Find what is wrong with connectors.
---@type rfsm_checks.Check
function paths.check(fsm, add)
  local arrivals, is_told = arrivals_of(fsm), {}
  for _, connector in ipairs(rfsm.elements(fsm, is_conn)) do
    check_default(connector, arrivals[connector], add)
    local cycle = not is_told[connector._fqn] and find_cycle(connector, connector, {})
    for _, fqn in ipairs(cycle or {}) do is_told[fqn] = true end
    if cycle then
      cycle[#cycle + 1] = connector._fqn
      add("connector-cycle", connector, "connectors in a circle: "
        .. concat(cycle, " -> "))
    end
  end
end

return paths
