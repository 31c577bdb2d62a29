--- Fairness: does a condition hold eventually if doos end and time goes on?
--
-- A configuration *owes* the condition if a monitor still waits for it. The property
-- does not hold if some fair run stays among such configurations: it rests in one, or
-- takes the steps of a cycle again and again. A run is fair if each doo ends and each
-- timer expires, unless its state is left before: so somewhere on the cycle the doo or
-- timer is not pending, or its state is entered anew. Events from outside need not
-- come, and guards may always be false.
--
-- @module rfsm.explore.fairness
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local graph = require "rfsm.explore.graph"
local match = require "rfsm.shared.match"
local subject = require "rfsm.explore.subject"
local order = require "rfsm.shared.order"

local ipairs = ipairs

local fairness = {}

-- Returns a table of what is pending in a configuration: name of a doo or timer -> its
-- state, name of an event to be sent later -> the clock of the event.
local function pending_in(conf)
  local pending = {}
  for _, position in ipairs(conf) do
    local leaf = position.leaf
    local _, own_regions = rfsm.regions(leaf)
    if leaf and leaf.doo and position.mode == "active" and not own_regions then
      pending["doo " .. position.known.path] = leaf
    end
  end
  for _, entry in ipairs(conf.context.entries or {}) do
    if entry.clock.state then
      pending[("timer %d.%d"):format(entry.clock.number, entry.passed)] =
        entry.clock.state
    elseif entry.clock.later and not entry.clock.is_free then
      pending["later " .. entry.clock.number] = entry.clock
    end
  end
  return pending
end

-- A step that leads from one configuration of a component to another one.
---@class rfsm_checks.Edge
---@field from integer the configuration in which the step begins
---@field tgt integer the configuration to which it leads
---@field label string
---@field entered table<table, boolean> states that the step enters, and clocks of later
-- events that come in the step or that it drops

-- Notes the clocks of events sent later that come in a step or that the step drops.
local function note_later(walk, try, entered)
  for i, entry in ipairs(try.group and try.conf.context.entries or {}) do
    local later = entry.clock.later
    if later and (try.group.over[i] > 0 or walk.subject.dropped[later]) then
      entered[entry.clock] = true
    end
  end
end

-- Returns the steps between some configurations: configuration -> list of its steps.
local function edges_between(walk, numbers)
  local edges, is_in = {}, {}
  for _, number in ipairs(numbers) do edges[number], is_in[number] = {}, true end
  for _, number in ipairs(numbers) do
    walk:each_step(number, function(_, try, key, label)
      local tgt = key and walk:find_known(key)
      if not is_in[tgt] then return end
      local edge = { from = number, tgt = tgt, label = label(), entered = {} }
      for state in order.each(walk.subject.entered) do -- any order: a set
        edge.entered[state] = true
      end
      note_later(walk, try, edge.entered)
      edges[number][#edges[number] + 1] = edge
    end)
  end
  return edges
end

-- Returns the first configuration of a list in which a run may rest: nothing is
-- pending, no event waits, and no step without events leads to another configuration.
local function find_rest(walk, numbers)
  for _, number in ipairs(numbers) do
    local conf = walk:configuration(number)
    local is_idle = not (subject.is_busy(conf) or walk.cut[number])
    graph.each_step(walk, number, function(tgt, is_internal)
      is_idle = is_idle and (tgt == number or not is_internal)
    end)
    if is_idle and order.is_empty(pending_in(conf)) then return number end
  end
end

-- Returns the steps between configurations if a fair run may take them again and again:
-- if a doo or timer is pending in all of them, some step enters its state anew.
local function find_fair(walk, numbers)
  local edges, has_edge = edges_between(walk, numbers), false
  local common = pending_in(walk:configuration(numbers[1]))
  for _, number in ipairs(numbers) do
    local pending = pending_in(walk:configuration(number))
    has_edge = has_edge or edges[number][1] ~= nil
    for name, state in order.each(common) do -- any order: a set
      local is_entered = order.any(edges[number], function(edge)
        return edge.entered[state]
      end)
      if is_entered or not pending[name] then common[name] = nil end
    end
  end
  return has_edge and order.is_empty(common) and edges or nil
end

-- Returns the steps of a cycle from `start` on which no doo or timer stays pending.
local function cycle_from(walk, edges, start)
  local cycle, at = {}, start
  local function go(is_wanted)
    for _, edge in ipairs(graph.find_way(edges, at, is_wanted)) do
      cycle[#cycle + 1], at = edge, edge.tgt
    end
  end
  local pending = pending_in(walk:configuration(start))
  for _, name in ipairs(rfsm.sorted_keys(pending)) do
    go(function(edge)
      return edge.entered[pending[name]]
        or not pending_in(walk:configuration(edge.tgt))[name]
    end)
  end
  if at ~= start or not cycle[1] then
    go(function(edge) return edge.tgt == start end)
  end
  return cycle
end

-- Are there times at which two rounds of a cycle can be taken? There may be none, since
-- a configuration also stands for equal ones whose clocks can have fewer values.
local function has_times(walk, start, cycle)
  return not walk.timing
    or walk:witness(start, nil, match.joined(cycle, cycle))[1].at ~= nil
end

-- Returns the set of the expanded configurations in which the machine is entered and
-- the only monitor has state `owes`.
local function owing(walk, owes)
  local set = {}
  for number = 2, walk.expanded do
    local conf = walk:configuration(number)
    set[number] = conf[1].leaf and conf.context.states[1] == owes
  end
  return set
end

--- Judge a property whose monitor must leave a state eventually: the property does not
--- hold if the monitor stays in that state on a fair run.
---@param walk rfsm_checks.Walk
---@param judged rfsm_checks.Judged
---@param owes string the state of the monitor
function fairness.judge(walk, judged, owes)
  for _, numbers in ipairs(graph.components_in(walk, owing(walk, owes))) do
    local rest = find_rest(walk, numbers)
    local edges = not rest and find_fair(walk, numbers)
    local cycle = edges and cycle_from(walk, edges, numbers[1])
    if cycle and not has_times(walk, numbers[1], cycle) then
      judged.is_open = true
    elseif rest or cycle then
      judged.holds, judged.at, judged.rests = false, rest or numbers[1], rest ~= nil
      judged.cycle = cycle
      return
    end
  end
end

return fairness
