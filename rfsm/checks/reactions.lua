--- Reactions: the events that can have an effect while a leaf is active, and those of
--- them that come from outside.
--
-- @module rfsm.checks.reactions
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local match = require "rfsm.checks.match"
local place = require "rfsm.checks.place"

local ipairs, setmetatable, type = ipairs, setmetatable, type
local is_conn = rfsm.is_conn

local reactions = {}

--- What can have an effect in a leaf: a list of events, and more.
---@class rfsm_checks.Reactions
---@field [integer] any
---@field set table<any, boolean> the same events as a set
---@field any boolean any other event can, too
---@field has_predicate boolean
---@field sets any[][] sets of several events without which a path cannot be taken

local add_reactions

local function add_reaction(found, tr, seen)
  if match.is_any(tr) then found.any = true end
  for _, event in ipairs(tr.events or {}) do
    if type(event) == "function" then
      found.has_predicate, found.any = true, true
    elseif not found.set[event] then
      found.set[event], found[#found + 1] = true, event
    end
  end
  if is_conn(tr.tgt) then add_reactions(found, tr.tgt, seen) end
end

-- Collects the events of the transitions from a node, and of those behind connectors.
function add_reactions(found, node, seen)
  if seen[node] then return end
  seen[node] = true
  for _, tr in ipairs(node._otrs) do add_reaction(found, tr, seen) end
end

-- Lists the sets of events that a path needs with a segment more; predicates are left
-- out.
local function extend(set, tr)
  local sets = {}
  for _, event in ipairs(tr.events or {}) do
    if match.has(set, event) then return { set } end
    if type(event) ~= "function" then sets[#sets + 1] = match.with(set, event) end
  end
  return sets[1] and sets or { set }
end

local MANY_SETS = 100 -- of one leaf; more are not tried

-- Adds the sets of several events that the paths from a transition on need.
local function add_sets(found, tr, set, seen)
  if seen[tr] or #found >= MANY_SETS then return end
  seen[tr] = true
  for _, longer in ipairs(extend(set, tr)) do
    if is_conn(tr.tgt) then
      for _, way in ipairs(tr.tgt._otrs) do add_sets(found, way, longer, seen) end
    elseif longer[2] ~= nil then
      found[#found + 1] = longer
    end
  end
  seen[tr] = nil
end

--- Collect what can have an effect in a leaf of a machine.
---@param fsm rfsm.Machine
---@param leaf rfsm.State|false false before the first entry
---@return rfsm_checks.Reactions reactions
function reactions.collect(fsm, leaf)
  local found = { set = {}, any = false, has_predicate = false, sets = {} }
  local seen, nodes = {}, place.tried(fsm, leaf)
  if not leaf then found.set.e_init_fsm = true end
  for i = #nodes, 1, -1 do
    add_reactions(found, nodes[i], seen)
    for _, tr in ipairs(nodes[i]._otrs) do add_sets(found.sets, tr, {}, {}) end
  end
  return found
end

--- Return the same for a part of a puppet, collected once.
function reactions.of(part, leaf)
  local known = part.known[leaf]
  known.reactions = known.reactions or reactions.collect(part.fsm, leaf)
  return known.reactions
end

-- Events from outside ...............................................................

--- Stands for each event that nothing names.
reactions.OTHER = setmetatable({}, {
  __tostring = function() return "(another event)" end,
})

local function is_internal(event)
  return type(event) == "string"
    and (event == "e_init_fsm" or event:find("^e_done@root") ~= nil)
end

local function is_allowed(self, event)
  return not self.alphabet or match.has(self.alphabet, event)
end

-- Appends the events from outside that can have an effect in a stand.
local function add_outside(self, list, is_listed, found)
  local function add(event)
    if not is_listed[event] and not is_internal(event) and is_allowed(self, event) then
      is_listed[event], list[#list + 1] = true, event
    end
  end
  for _, event in ipairs(found) do add(event) end
  if found.has_predicate or found.any and self.alphabet then
    for _, event in ipairs(self.all_events) do add(event) end
  end
  if found.any then add(reactions.OTHER) end
end

-- Adds the sets of several events from outside, but for those that cannot come.
local function add_outside_sets(self, sets, found)
  for _, set in ipairs(found.sets) do
    local kept, may_come = {}, true
    for _, event in ipairs(set) do
      local is_own = is_internal(event)
      may_come = may_come and (is_own or is_allowed(self, event))
      if not is_own then kept[#kept + 1] = event end
    end
    if may_come and kept[2] ~= nil then sets[#sets + 1] = kept end
  end
end

--- List the events from outside that can have an effect in a configuration, and the
--- sets of several of them that a path through connectors needs.
---@param self rfsm_checks.Puppet
---@param conf rfsm_checks.Configuration
---@return any[] events
---@return any[][] sets
function reactions.from_outside(self, conf)
  local list, sets, is_listed, leaf_of = {}, {}, {}, {}
  for i, part in ipairs(self.parts) do
    leaf_of[part] = conf[i].leaf
    if not part.owner or leaf_of[part.owner] == part.leaf then
      local found = reactions.of(part, conf[i].leaf)
      add_outside(self, list, is_listed, found)
      add_outside_sets(self, sets, found)
    end
  end
  return list, sets
end

return reactions
