--- Reactions: the events that can have an effect while a leaf is active, and the ones
--- among them that may come next.
--
-- A sequential AND state forwards the events of an iteration to its regions, also in
-- the iteration that enters the state. So an event to which a region can react counts
-- for the leaf that has the region, and for each leaf with a transition to that leaf.
--
-- @module rfsm.explore.reactions
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local match = require "rfsm.shared.match"
local location = require "rfsm.shared.location"

local ipairs, type = ipairs, type
local is_conn = rfsm.is_conn

local reactions = {}

--- The events that can have an effect in a leaf, as a list with more fields.
---@class rfsm_checks.Reactions
---@field [integer] any the events
---@field set table<any, boolean> the events as a set
---@field any boolean any other event can have an effect, too
---@field has_predicate boolean a predicate may accept any event; `any` is true, too
---@field timers string[] time events of states that are active
---@field sets any[][] sets of several events that a path through connectors needs
---@field is_cut boolean there are more than MANY_SETS of these sets, or it took more
-- than MANY_SEGMENTS to look for them
---@field count integer how many segments were looked at
---@field outside rfsm_checks.Occurrence[]|false events from outside; false: no list yet

local function add_event(found, event)
  event = match.example_of(event)
  if type(event) == "function" then
    found.has_predicate, found.any = true, true
  elseif not found.set[event] then
    local maker = match.maker_of(event)
    found.set[event], found[#found + 1] = true, event
    -- such as "await(e_a, e_b)", which comes with the event that completes it
    if maker and maker ~= "engine" and maker ~= "timer" then found.any = true end
  end
end

-- Adds the events of a transition.
local function add_events(found, tr)
  if match.begins_on_any(tr) then found.any = true end
  for _, event in ipairs(tr.events or {}) do add_event(found, event) end
end

-- Adds the events to which extensions react in a node.
local function add_reactions_of(found, fsm, node)
  for _, event in ipairs(rfsm.reactions(fsm, node)) do add_event(found, event) end
end

-- Adds all events that the regions of a leaf name, whatever state they are in.
local function add_regions(found, leaf)
  for _, region in ipairs(rfsm.regions(leaf)) do
    for _, tr in ipairs(rfsm.elements(region, rfsm.is_trans)) do
      add_events(found, tr)
    end
    for _, state in ipairs(rfsm.elements(region, rfsm.is_state)) do
      add_reactions_of(found, region, state)
      add_regions(found, state)
    end
  end
end

-- Collects the events of the transitions from a node, and of transitions behind their
-- connectors.
local function add_reactions(found, fsm, node, seen)
  if seen[node] then return end
  seen[node] = true
  for _, tr in ipairs(node._otrs) do
    add_events(found, tr)
    for _, tgt in ipairs(rfsm.targets(tr)) do
      if is_conn(tgt) then
        add_reactions(found, fsm, tgt, seen)
      else
        add_regions(found, tgt)
      end
    end
  end
  add_reactions_of(found, fsm, node)
end

-- Adds the events of the leaf's regions to `found.set`, but not to the list `found`:
-- each region lists the events of its own leaf.
local function add_own_regions(found, leaf)
  local count = #found
  add_regions(found, leaf)
  for i = #found, count + 1, -1 do found[i] = nil end
end

local function add_timers(found, nodes)
  local is_active = {}
  for _, node in ipairs(nodes) do is_active[node._fqn] = true end
  for _, event in ipairs(found) do
    local _, fqn = match.maker_of(event)
    if fqn and is_active[fqn] then found.timers[#found.timers + 1] = event end
  end
end

-- Lists the sets of events that a path needs after one more segment. `set` is the set
-- that it needed before. A predicate may accept an event of `set`, so it adds no event.
local function extend(set, tr)
  local sets, is_free = {}, match.is_any(tr)
  for _, event in ipairs(tr.events or {}) do
    if match.has(set, event) then return { set } end
    if type(event) == "function" then
      is_free = true
    else
      sets[#sets + 1] = match.with(set, event)
    end
  end
  if is_free then sets[#sets + 1] = set end
  return sets
end

local MANY_SETS = 1000 -- most sets of one leaf; others are not tried
local MANY_SEGMENTS = 20000 -- most segments of its paths that are looked at for them

-- Begins to look at a transition of a path. `seen` has the transitions of the path, and
-- for each set those that were looked at with it. Returns false if there is no need.
local function begin(found, tr, set, seen)
  local looked = seen[set] or {}
  seen[set] = looked
  if seen[tr] or looked[tr] or found.is_cut then return false end
  seen[tr], looked[tr] = true, true
  found.count = found.count + 1
  found.is_cut = found.count > MANY_SEGMENTS
  return true
end

-- Adds the sets of several events that are needed by paths through a transition. `set`
-- is the set of events that the segments before it need. Paths that meet again with the
-- same set are not followed twice.
local function add_sets(found, tr, set, seen)
  if not begin(found, tr, set, seen) then return end
  for _, longer in ipairs(extend(set, tr)) do
    local is_end = false
    for _, tgt in ipairs(rfsm.targets(tr)) do
      is_end = is_end or not is_conn(tgt)
      for _, way in ipairs(is_conn(tgt) and tgt._otrs or {}) do
        add_sets(found, way, longer, seen)
      end
    end
    if is_end and longer[2] ~= nil then
      found.is_cut = #found.sets >= MANY_SETS
      if found.is_cut then break end
      found.sets[#found.sets + 1] = longer
    end
  end
  seen[tr] = nil
end

--- Collect the events that can have an effect in a leaf of a machine.
---@param fsm rfsm.Machine
---@param leaf rfsm.State|false false before the first entry
---@return rfsm_checks.Reactions reactions
function reactions.collect(fsm, leaf)
  local found = { set = {}, any = false, has_predicate = false, timers = {}, sets = {},
    is_cut = false, count = 0, outside = false }
  local seen, nodes = {}, location.tried(fsm, leaf)
  if not leaf then found.set.e_init_fsm = true end
  for i = #nodes, 1, -1 do
    add_reactions(found, fsm, nodes[i], seen)
    for _, tr in ipairs(nodes[i]._otrs) do add_sets(found, tr, {}, {}) end
  end
  add_timers(found, leaf and nodes or {})
  if leaf then add_own_regions(found, leaf) end
  return found
end

--- Return the reactions of a leaf of a part. They are collected once.
function reactions.of(part, leaf)
  local known = part.known[leaf]
  known.reactions = known.reactions or reactions.collect(part.fsm, leaf)
  return known.reactions
end

-- What may come .....................................................................

--- The event that stands for all events that no transition names.
reactions.OTHER = "(another event)"

local function is_allowed(self, event)
  return not self.alphabet or match.has(self.alphabet, event)
end

-- Lists the events from outside that can have an effect in a leaf, and keeps the list.
local function outside_of(self, found)
  if found.outside then return found.outside end
  local list, is_listed = {}, {}
  local function add(event)
    for _, each in ipairs(self:examples_of(event)) do
      if not (is_listed[each] or self:maker_of(each)) and is_allowed(self, each) then
        is_listed[each] = true
        list[#list + 1] = self:occurrence(self.parts[1], each)
      end
    end
  end
  for _, event in ipairs(found) do add(event) end
  for _, event in ipairs(found.any and self.alphabet or {}) do add(event) end
  if found.any then add(reactions.OTHER) end
  found.outside = list
  return list
end

-- Adds a set of several events, without the events that the machine makes itself. A set
-- is left out if one of its events cannot come.
local function add_set(self, part, sets, set, timers)
  local kept = {}
  for _, event in ipairs(set) do
    local maker = self:maker_of(event)
    if maker == "timer" then
      if not (part.timed[event] or match.has(timers, event)) then return end
      if not part.timed[event] then kept[#kept + 1] = self:occurrence(part, event) end
    elseif not maker then
      if not is_allowed(self, event) or self:examples_of(event)[1] ~= event then
        return
      end
      kept[#kept + 1] = self:occurrence(self.parts[1], event)
    end
  end
  if kept[2] ~= nil then sets[#sets + 1] = kept end
end

--- List the events that may come in a configuration and can have an effect: events from
--- outside and time events; of a machine that takes one event an iteration, only time
--- events that do not wait in it. The second list has the sets of several such events
--- that a path through connectors needs.
---@param self rfsm_checks.Subject
---@param conf rfsm_checks.Configuration
---@return rfsm_checks.Occurrence[] events
---@return rfsm_checks.Occurrence[][] sets
---@return boolean is_cut a path may need sets that are not in the list
function reactions.that_may_come(self, conf)
  local list, sets, is_cut, is_listed, leaf_of = {}, {}, false, {}, {}
  for i, part in ipairs(self.parts) do
    leaf_of[part] = conf[i].leaf
    if not part.owner or leaf_of[part.owner] == part.leaf then
      local found = reactions.of(part, conf[i].leaf)
      for _, event in ipairs(outside_of(self, found)) do
        if not is_listed[event] then
          is_listed[event], list[#list + 1] = true, event
        end
      end
      for _, timer in ipairs(found.timers) do
        local has_come = part.reads_one and match.has(conf[i].waiting, timer)
        if not (part.timed[timer] or has_come) then
          list[#list + 1] = self:occurrence(part, timer)
        end
      end
      for _, set in ipairs(found.sets) do
        add_set(self, part, sets, set, found.timers)
      end
      is_cut = is_cut or found.is_cut
    end
  end
  return list, sets, is_cut
end

return reactions
