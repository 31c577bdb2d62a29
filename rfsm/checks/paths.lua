--- Paths: connectors that lead nowhere at times, and back to themselves.
--
-- @module rfsm.checks.paths
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local events = require "rfsm.checks.events"

local ipairs, type = ipairs, type
local concat = table.concat
local is_conn = rfsm.is_conn

local paths = {}

-- Which events can reach a connector ..............................................

local ANY = setmetatable({}, { __tostring = function() return "any event" end })

-- Notes that an event comes to a node; a predicate says nothing of what comes.
local function arrive(arrivals, pending, node, event)
  if not is_conn(node) or type(event) == "function" then return end
  local list = arrivals[node] or {}
  arrivals[node] = list
  if list[event] then return end
  list[event], list[#list + 1] = true, event
  pending[#pending + 1] = { node, event }
end

local function arrive_by(arrivals, pending, tr, event)
  if events.is_any(tr) then
    arrive(arrivals, pending, tr.tgt, event)
  elseif event == ANY then
    for _, own in ipairs(tr.events) do arrive(arrivals, pending, tr.tgt, own) end
  elseif events.names(tr, event) then
    arrive(arrivals, pending, tr.tgt, event)
  end
end

-- Returns for each connector the events that can lead to it, one at a time.
local function arrivals_of(fsm)
  local arrivals, pending = {}, {}
  if fsm.initial then arrive(arrivals, pending, fsm.initial, "e_init_fsm") end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    if not is_conn(tr.src) then arrive_by(arrivals, pending, tr, ANY) end
  end
  while pending[1] do
    local node, event = pending[#pending][1], pending[#pending][2]
    pending[#pending] = nil
    for _, tr in ipairs(node._otrs) do arrive_by(arrivals, pending, tr, event) end
  end
  return arrivals
end

-- Is there a way on for this event that no guard can close?
local function has_default(connector, event)
  for _, tr in ipairs(connector._otrs) do
    if not tr.guard and (events.is_any(tr) or events.names(tr, event)) then
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
---@param fsm rfsm.Machine
---@param add fun(code: string, obj: table, text: string)
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
