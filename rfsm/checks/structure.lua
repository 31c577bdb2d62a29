--- Structure: finds nodes that are never reached or left, callbacks that are never
--- called, and connectors that may be dead ends or lead back to themselves.
--
-- @module rfsm.checks.structure
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local codes = require "rfsm.checks.codes"
local match = require "rfsm.shared.match"
local order = require "rfsm.shared.order"
local stubs = require "rfsm.shared.stubs"
local location = require "rfsm.shared.location"
local writes = require "rfsm.shared.writes"

local ipairs, rawget, setmetatable, type = ipairs, rawget, setmetatable, type
local concat = table.concat
local is_conn, is_leaf = rfsm.is_conn, rfsm.is_leaf

local structure = {}

-- Marks a node to which a transition leads, and the composites around it, as reached.
local function mark(reached, pending, node)
  while not reached[node] do
    reached[node] = true
    pending[#pending + 1] = node
    node = node._parent
  end
end

--- Return the set of nodes that some path of transitions leads to.
---@return table<table, boolean> reached
function structure.reached(fsm)
  local reached, pending = {}, {}
  mark(reached, pending, fsm)
  if fsm.initial then mark(reached, pending, fsm.initial) end
  while pending[1] do
    local node = pending[#pending]
    pending[#pending] = nil
    for _, tr in ipairs(node._otrs) do mark(reached, pending, tr.tgt) end
  end
  return reached
end

-- Appends the leaves that a transition to a node may enter.
local function add_leaves(node, leaves, seen)
  if seen[node] then return end
  seen[node] = true
  if is_leaf(node) then leaves[#leaves + 1] = node end
  local connector = is_conn(node) and node or not is_leaf(node) and node.initial
  for _, tr in ipairs(connector and connector._otrs or {}) do
    add_leaves(tr.tgt, leaves, seen)
  end
end

--- Do transitions lead from some leaf to other leaves and back to it? If not, the
--- leaves are a sequence, which must end somewhere.
---@return boolean
function structure.has_cycle(fsm)
  local is_under_way, is_done = {}, {}
  local function visit(leaf)
    if is_done[leaf] then return false end
    if is_under_way[leaf] then return true end
    is_under_way[leaf] = true
    local leaves = {}
    for _, tr in ipairs(location.transitions(fsm, leaf)) do
      add_leaves(tr.tgt, leaves, {})
    end
    is_done[leaf] = not order.any(leaves, function(other)
      return other ~= leaf and visit(other)
    end)
    return not is_done[leaf]
  end
  return order.any(rfsm.elements(fsm, is_leaf), visit)
end

--- Is a leaf without a way out meant as an end? Yes if its name means an end, or if no
--- leaves of the machine lead back to each other.
---@return boolean
function structure.is_end(fsm, leaf)
  return codes.means(leaf, "an end") or not structure.has_cycle(fsm)
end

-- Finds nodes without a way in or out, except those in an unreachable composite. An
-- `initial` needs no way in: transitions may enter its composite at another node.
local function check_node(fsm, node, reached, add)
  if not reached[node] then
    if reached[node._parent] and node._id ~= "initial" then
      add("unreachable", node, "unreachable, no path of transitions leads here")
    end
  elseif is_conn(node) and not node._otrs[1] then
    add("closed", node, "no way out of this connector, so that no transition to "
      .. "it is ever taken")
  elseif node ~= fsm and is_leaf(node) and not node.final
    and not location.transitions(fsm, node)[1] then
    add("dead-end", node, "no exit, neither this state nor one around it is ever left",
      structure.is_end(fsm, node) and "note")
  end
end

-- Does a transition wait for an event that the machine sends to itself?
local function waits_for_own(tr)
  for _, event in ipairs(tr.events or {}) do
    local name = rfsm.event_name(event) or event
    local word = match.maker_of(name) and name:match("^(e_%a+)@")
    if word == "e_done" or word == "e_fault" then return true end
  end
  return false
end

-- Does a region, or one inside it, send events, or wait for an e_done or e_fault? Then
-- it needs several steps for one event.
local function needs_steps(region)
  for _, obj in ipairs(rfsm.elements(region)) do
    if rfsm.is_trans(obj) and waits_for_own(obj) then return true end
    for _, inner in ipairs(is_leaf(obj) and rfsm.regions(obj) or {}) do
      if needs_steps(inner) then return true end
    end
    for _, field in ipairs { "entry", "exit", "doo", "effect" } do
      if writes.may_call(rawget(obj, field), rfsm, "send_events") then return true end
    end
  end
  return false
end

-- Finds regions that may have work when `run` returns, since nothing says whether the
-- doo that steps them is idle.
local function check_regions(node, add)
  local regions, own = rfsm.regions(node)
  if not own or node.run or node.idle_doo ~= nil or node["idle.doo"] ~= nil then
    return
  end
  for i, region in ipairs(regions) do
    if needs_steps(region) then
      add("early-idle", node, ("run returns while events of the region '%s' still wait")
        :format(rfsm.text_of(own.names[i])))
    end
  end
end

-- Finds `final` where it says nothing, or the contrary of the transitions.
local function check_final(fsm, obj, add)
  if obj.final ~= true then return end
  if rfsm.is_composite(obj) then
    add("misplaced", obj, "final = true in a composite says nothing (mark the leaf in "
      .. "it that ends it)")
  elseif is_leaf(obj) and obj ~= fsm and obj._otrs[1] then
    add("misplaced", obj, "final = true, but a transition leaves it (remove one of "
      .. "them)")
  end
end

local READ = { "one", "all" }

-- Finds a value of `read` that is nearly one of those that count.
local function check_read(fsm, add)
  local value = fsm.read
  local hint = type(value) == "string" and advice.did_you_mean(value, READ) or ""
  local is_right = value == READ[1] or value == READ[2]
  if hint ~= "" and not is_right or value == true or value == 1 then
    add("unknown-field", fsm, "read: 'one' or 'all' expected, " .. rfsm.got(value)
      .. hint)
  end
end

-- Returns the set of words in the functions of a machine and of those in it and around
-- it, the set of words behind a point, and whether all their texts are known.
local function words_of(fsm)
  local words, fields, seen, is_known = {}, {}, {}, not stubs.are_used
  while rfsm.parent(fsm) do fsm = rfsm.parent(fsm) end
  for _, obj in location.each(fsm) do
    for _, value in order.each(rfsm.model_of(obj)) do -- any order: sets
      local f = rfsm.is_callable(value) and not rfsm.is_fsmobj(value) and value
      is_known = is_known and (not f or writes.is_known(f))
      writes.each(f, function(text)
        for word in text:gmatch(writes.ANY) do words[word] = true end
        for word in text:gmatch("%.%s*(" .. writes.ANY .. ")") do
          fields[word] = true
        end
      end, seen)
    end
  end
  return words, fields, is_known
end

local UNKNOWN = " (the program may write it)"

-- Returns the hint for a name in `keep` that is no field: one that is there, or that
-- functions use, and that the state does not keep.
local function hint_for_kept(state, name, fields)
  local known, names = {}, {}
  for key in order.each(fields) do known[key] = true end -- any order: a copy
  for key, value in order.each(rfsm.model_of(state)) do -- any order: a set
    local is_data = type(key) == "string" and not rfsm.is_callable(value)
    if is_data and not rfsm.is_fsmobj(value) then known[key] = true end
  end
  for _, key in ipairs(rfsm.sorted_keys(known)) do
    if not match.has(state.keep, key) then names[#names + 1] = key end
  end
  local hint = advice.did_you_mean(name, names)
  return hint ~= "" and hint or UNKNOWN
end

-- Finds names in `keep` of fields that neither the state nor a function of the chart
-- has. A program may write them: only one that looks like another is a warning.
local function check_keep(fsm, state, add, words_of_all)
  for _, name in ipairs(type(state.keep) == "table" and state.keep or {}) do
    local words, fields, is_known = words_of_all()
    if type(name) == "string" and state[name] == nil and not words[name] then
      local hint = hint_for_kept(state, name, fields)
      local is_sure = is_known and hint ~= UNKNOWN
      add("unknown-field", state, ("keep: the %s has no field '%s'%s"):format(
        state == fsm and "root" or "state", name, hint), not is_sure and "note")
    end
  end
end

-- Finds a sequential AND state without regions, and what was probably meant as one: a
-- function whose call was forgotten, and a number that no function uses.
local function check_members(state, add, words_of_all)
  if not rfsm.regions(state)[1] then
    add("unmarked", state, "a sequential AND state without a region (a region is a "
      .. "state)")
  end
  for _, key in ipairs(rfsm.sorted_keys(rfsm.model_of(state))) do
    local value = type(key) == "string" and state[key]
    if advice.is_field(key) or advice.misspelt(state, key, value) ~= "" then
      value = nil
    end
    if type(value) == "function" then
      add("unmarked", state, ("'%s' is a function and no region (did you mean %s = "
        .. "%s()?)"):format(key, key, key))
    elseif type(value) == "number" and not words_of_all()[key] then
      add("unmarked", state, ("'%s' is a number and no region (a region is a state)")
        :format(key))
    end
  end
end

-- Fields of the library whose names programs use, too.
local IS_COMMON = {}
for word in ("dbg info warn err strict rename migrate run step order src tgt pn save "
  .. "load prepare after delay timeout"):gmatch("%S+") do
  IS_COMMON[word] = true
end

local CODES = { entry = "never-called" }
CODES.exit, CODES.doo = CODES.entry, CODES.entry
CODES.guard, CODES.effect = CODES.entry, CODES.entry

-- Finds fields of another kind of element, and those that are nearly right.
local function check_names(obj, add, words_of_all)
  for _, key in ipairs(rfsm.sorted_keys(rfsm.model_of(obj))) do
    local is_name = type(key) == "string"
    local text = is_name and advice.misplaced(obj, key, obj[key]) or ""
    if text ~= "" and not (IS_COMMON[key] and words_of_all()[key]) then
      add(CODES[key] or "unknown-field", obj, text, IS_COMMON[key] and "note")
    end
    text = is_name and advice.misspelt(obj, key, obj[key]) or ""
    if text ~= "" then add("unknown-field", obj, text) end
  end
end

-- Finds a field that only another library, or an extension that is not loaded, reads.
local function check_foreign(state, add)
  local function note(field, remedy)
    add("unknown-field", state, ("a state has no field '%s' (%s)"):format(field,
      remedy))
  end
  local has_history = state.history == true and rfsm.is_composite(state)
  if has_history and not rawget(_G, "package").loaded["rfsm.history"] then
    note("history", "require \"rfsm.history\"") -- init tells of a text
  elseif state.type == "final" and not state.final then
    note("type", "did you mean final = true?")
  elseif state.type == "parallel" or state.parallel == true then
    note(state.parallel and "parallel" or "type", "did you mean rfsm.seqand{...}?")
  end
end

local LASTING = { "while", "repeat", "for", "goto", "yield", "send_events" }

-- Does a callback end at once and send no event, as far as its source text shows?
local function ends_at_once(doo)
  return writes.text_of(doo) ~= nil and not order.any(LASTING, function(word)
    return writes.may_call(doo, nil, word)
  end)
end

-- Returns a transition from the same leaf that is never taken, because `tr` has no
-- events and is taken as soon as the leaf was entered.
local function find_outrun(tr)
  local leaf = tr.src
  if tr.guard or not is_leaf(leaf) or leaf.entry and not ends_at_once(leaf.entry)
    or leaf.doo and not ends_at_once(leaf.doo) then
    return nil
  end
  for _, other in ipairs(leaf._otrs) do
    local event = other.events and other.events[1]
    if event ~= nil and not match.maker_of(event) then return other end
  end
end

-- Finds an e_after that an internal transition takes: the timer is not armed again.
local function check_repeated(tr, add)
  for _, timer in ipairs(rfsm.target_of(tr) == "internal" and tr.src._timers or {}) do
    local event = timer.event
    if event.is_relative and not event.is_repeated and match.names(tr, timer.name) then
      add("once", tr, ("'%s' comes once an entry, and an internal transition enters "
        .. "nothing"):format(event.name))
    end
  end
end

local function check_transition(tr, add)
  check_repeated(tr, add)
  if not match.begins_on_any(tr) then return end
  local other = find_outrun(tr)
  add("any-event", tr, "it has no events, and is taken on any" .. (other
    and ", before " .. rfsm.location_of(other) .. " can be" or ""),
    other and "warning")
end

-- Which events can reach a connector ..............................................

local ANY = setmetatable({}, { __tostring = function() return "any event" end })

-- Returns the events on which a path can continue through `tr`, if it has come to the
-- source of `tr` on `event`. The event may be ANY.
local function passing(tr, event)
  if match.triggers(tr, event) then return { event } end
  return event == ANY and tr.events or {}
end

-- Follows the paths that come to the source of `tr` on `event`, and adds to `arrivals`
-- the events on which they reach each connector after it. Predicates are left out.
local function arrive(arrivals, tr, event)
  for _, own in ipairs(is_conn(tr.tgt) and passing(tr, event) or {}) do
    local list = arrivals[tr.tgt] or {}
    if not list[own] and type(own) ~= "function" then
      arrivals[tr.tgt], list[own], list[#list + 1] = list, true, own
      for _, way in ipairs(tr.tgt._otrs) do arrive(arrivals, way, own) end
    end
  end
end

-- Returns for each connector the list of events on which a path may reach it.
local function arrivals_of(fsm)
  local arrivals = {}
  arrive(arrivals, { tgt = fsm.initial }, "e_init_fsm")
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    if not is_conn(tr.src) then arrive(arrivals, tr, ANY) end
  end
  return arrivals
end

local function check_default(connector, arriving, add)
  local texts = {}
  for _, event in ipairs(arriving or {}) do
    local has_default = order.any(connector._otrs, function(tr)
      return not tr.guard and match.triggers(tr, event)
    end)
    if not has_default then texts[#texts + 1] = rfsm.event_text(event) end
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

-- Returns the FQNs of the connectors from `node` to the last one before `start`, on a
-- path of connectors that leads back to `start`; nil if there is no such path.
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

-- Finds connectors without a default, and cycles of connectors.
local function check_connectors(fsm, add)
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

--- Find mistakes in the structure of a machine.
---@type rfsm_checks.Check
function structure.check(fsm, add, reached)
  local words, fields, is_known
  local function words_of_all() -- read once, for the first that asks
    if not words then words, fields, is_known = words_of(fsm) end
    return words, fields, is_known
  end
  for _, obj in ipairs(rfsm.elements(fsm)) do
    if rfsm.is_node(obj) then
      check_node(fsm, obj, reached, add)
      check_regions(obj, add)
    end
    if rfsm.is_trans(obj) then check_transition(obj, add) end
    if rfsm.is_state(obj) then
      check_foreign(obj, add)
      check_keep(fsm, obj, add, words_of_all)
      if select(2, rfsm.regions(obj)) then check_members(obj, add, words_of_all) end
    end
    check_final(fsm, obj, add)
    check_names(obj, add, words_of_all)
  end
  check_read(fsm, add)
  check_connectors(fsm, add)
end

return structure
