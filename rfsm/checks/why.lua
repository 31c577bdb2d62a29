--- Why: the answer of each transition to some events, and the events that count now.
--
-- Guards and predicates are called, as in a search of the engine; nothing else is, and
-- nothing is changed.
--
-- @module rfsm.checks.why
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local place = require "rfsm.checks.place"

local error, ipairs, pcall, rawequal = error, ipairs, pcall, rawequal
local select, setmetatable, type = select, setmetatable, type
local concat = table.concat
local is_conn, text_of = rfsm.is_conn, rfsm.text_of

local why = {}

--- The answer of one transition.
---@class rfsm_checks.Answer
---@field verdict "fires"|"lost"|"enabled"|"event"|"guard"|"failed"|"closed"
---@field reason string the verdict in words
---@field place string "root.trans[2] (off -> on)"
---@field file string "chart.lua:7: "; empty if it is not known
---@field src string FQN
---@field tgt string FQN
---@field winner? string lost: the place of the transition that is taken
---@field connector? string closed: FQN of the connector where the path ends
---@field ways? rfsm_checks.Answer[] closed: those from the connector, once

--- The answers of a machine.
---@class rfsm_checks.Why
---@field events string[] as texts
---@field leaf string|false FQN of the active leaf; false before the first entry
---@field fires string|false place of the transition that would be taken
---@field answers rfsm_checks.Answer[] in the order in which they are tried
---@field regions { name: string, why: rfsm_checks.Why }[] machines in the leaf

local function texts_of(values)
  local texts = {}
  for i = 1, #values do texts[i] = text_of(values[i]) end
  return texts
end

-- Search: as the engine's, but each transition is asked ----------------------------

-- An interrupt such as Control-C is no failure of a callback.
local function try(f, ...)
  local ok, answer = pcall(f, ...)
  if not ok and type(answer) == "string" and answer:find("interrupted!$") then
    error(answer, 0)
  end
  return ok, answer
end

-- Without any event no transition is taken, but the first way in.
local function matches(search, tr)
  local wanted, events = tr.events, search.events
  if not (wanted and wanted[1] ~= nil) then return not search.is_mute end
  for i = 1, #wanted do
    for j = 1, #events do
      if rawequal(wanted[i], events[j]) then return true end
      if type(wanted[i]) == "function" then
        local ok, answer = try(wanted[i], events[j])
        if ok and answer then return true end
      end
    end
  end
  return false
end

-- Returns where a transition ends: a target of the moment may be a composite.
local function target_of(tr)
  local tgt = tr.tgt
  if tr._is_internal and rawequal(tr.src, tgt) then return tgt end
  if rfsm.is_composite(tgt) then return tgt.initial end
  return rfsm.is_node(tgt) and tgt or nil
end

local ask_connector

-- Returns the verdict on a transition, and what there is to say of it.
local function judge(search, tr)
  if not matches(search, tr) then return "event" end
  if tr.guard then
    local ok, answer = try(tr.guard, tr, search.events)
    if not ok then return "failed", { failure = text_of(answer) } end
    if answer == false then return "guard" end
  end
  local tgt = target_of(tr)
  if not is_conn(tgt) then return tgt and "enabled" or "closed" end
  local found, ways = ask_connector(search, tgt)
  if found.way then return "enabled" end
  return "closed", { connector = found.connector, ways = ways }
end

local REASONS = {
  fires = "would be taken",
  enabled = "enabled",
  guard = "its guard returns false",
}

local function reason_of(answer, tr, details)
  if answer.verdict == "event" then
    local wanted = concat(texts_of(tr.events or {}), ", ")
    return wanted == "" and "waits for any event" or "waits for " .. wanted
  elseif answer.verdict == "failed" then
    return "its guard fails: " .. details.failure
  elseif answer.verdict == "closed" then
    return details and "the path ends at " .. details.connector
      or "its target is " .. answer.tgt .. ", which cannot be entered"
  end
  return REASONS[answer.verdict]
end

local function ask(search, tr)
  local verdict, details = judge(search, tr)
  local answer = { verdict = verdict, src = tr.src._fqn,
    tgt = rfsm.is_node(tr.tgt) and tr.tgt._fqn or text_of(tr.tgt) }
  answer.file, answer.place = place.split(rfsm.location_of(tr))
  answer.reason = reason_of(answer, tr, details)
  if verdict == "closed" and details then
    answer.connector, answer.ways = details.connector, details.ways
  end
  return answer
end

-- Where there is one way on, the path ends where that ends.
local function find_end(connector, ways)
  local only = not ways[2] and ways[1]
  return only and only.connector or connector._fqn
end

-- Asks the transitions from a connector, once a search; while that goes on it counts as
-- closed. `way` is true if one is enabled. The second result comes once. The engine
-- stops at the first enabled one, and asks none of smaller priority; here those are
-- asked afterwards.
function ask_connector(search, connector)
  local found = search.found[connector]
  if found then return found end
  found = { connector = connector._fqn, way = false }
  search.found[connector] = found
  local ways, is_enabled, pn = {}, false, nil
  for i, tr in ipairs(connector._otrs) do
    if is_enabled and (tr.pn or 0) ~= pn then found.way = true end
    ways[i] = ask(search, tr)
    if not is_enabled and ways[i].verdict == "enabled" then
      is_enabled, pn = true, tr.pn or 0
    end
  end
  found.way, found.connector = is_enabled, find_end(connector, ways)
  return found, ways
end

-- Returns the nodes whose transitions are tried, in order.
local function nodes_of(fsm)
  if not fsm._act_leaf then return { rfsm.is_composite(fsm) and fsm.initial or nil } end
  local nodes, node = {}, fsm._act_leaf
  while true do
    table.insert(nodes, 1, node)
    if node == fsm then return nodes end
    node = node._parent
  end
end

local function lose(answer, winner)
  answer.verdict, answer.winner = "lost", winner
  answer.reason = "loses to " .. winner
end

local function answers_of(fsm, events)
  local search, answers, winner = { events = events, found = {} }, {}, false
  search.is_mute = fsm._act_leaf and events[1] == nil
  for _, node in ipairs(nodes_of(fsm)) do
    for _, tr in ipairs(node._otrs) do
      local answer = ask(search, tr)
      if answer.verdict == "enabled" and winner then
        lose(answer, winner)
      elseif answer.verdict == "enabled" then
        answer.verdict, answer.reason = "fires", REASONS.fires
        winner = answer.place
      end
      answers[#answers + 1] = answer
    end
  end
  return answers, winner
end

-- Text ----------------------------------------------------------------------------

local function add_answers(lines, answers, indent)
  for _, answer in ipairs(answers) do
    lines[#lines + 1] = indent .. answer.place .. ": " .. answer.reason
    if answer.ways then add_answers(lines, answer.ways, indent .. "  ") end
  end
end

local function summary(result)
  local events = result.events[1] and "on " .. concat(result.events, ", ")
    or "without an event"
  local leaf = " in " .. (result.leaf or "a machine that was not entered")
  return (result.fires or "no transition") .. " would be taken " .. events .. leaf
end

local function add_text(lines, result, indent)
  lines[#lines + 1] = indent .. summary(result)
  add_answers(lines, result.answers, indent .. "  ")
  for _, region in ipairs(result.regions) do
    lines[#lines + 1] = indent .. "  region " .. region.name .. ":"
    add_text(lines, region.why, indent .. "    ")
  end
end

-- Public functions ----------------------------------------------------------------

local function explain(fsm, events)
  local answers, winner = answers_of(fsm, events)
  local result = { events = texts_of(events), fires = winner, answers = answers,
    leaf = rfsm.get_actleaf_fqn(fsm), regions = {} }
  for i, region in ipairs(place.regions_of(fsm._act_leaf or {})) do
    result.regions[i] = { name = region.name, why = explain(region.machine, events) }
  end
  return result
end

--- Explain the effect of events in the current state of a machine.
--
-- Each transition from the root to the active leaf is asked whether it would be taken;
-- if not, the answer names the rule: another event, the guard, another transition that
-- is tried earlier, a connector where the path ends. Guards are called, nothing else
-- is. Events that a step hook or a timer would add are not known here.
--
---@param fsm rfsm.Machine
---@param ... any events; none: those in the queue
---@return rfsm_checks.Why why plain tables
---@return string text the same for a person
function why.why(fsm, ...)
  rfsm.check_machine(fsm, "rfsm_checks.why")
  local events = {}
  for i = 1, select("#", ...) do
    local event = select(i, ...)
    if event ~= nil then events[#events + 1] = event end
  end
  if select("#", ...) == 0 then
    for i = 1, #fsm._intq do events[i] = fsm._intq[i] end
  end
  local result, lines = explain(fsm, events), {}
  add_text(lines, result, "")
  return result, concat(lines, "\n")
end

-- Stands for an event that no transition names.
local OTHER = setmetatable({}, { __tostring = function() return "any other event" end })

-- Returns the events that transitions from active states and from connectors name, as a
-- set; nil if one of them has a predicate. Any other event counts as `OTHER` does.
local function named_events(fsm, transitions)
  local is_asked, named = {}, {}
  for _, node in ipairs(nodes_of(fsm)) do is_asked[node] = true end
  for _, tr in ipairs(transitions) do
    for _, event in ipairs((is_asked[tr.src] or is_conn(tr.src)) and tr.events or {}) do
      if type(event) == "function" then return nil end
      named[event] = true
    end
  end
  return named
end

-- Appends the events that enable a transition of the machine, or of one in its leaf.
local function add_enabled(list, is_listed, fsm)
  local transitions = rfsm.elements(fsm, rfsm.is_trans)
  local named = named_events(fsm, transitions)
  local takes_any = select(2, answers_of(fsm, { OTHER })) and true
  local function is_enabled(event)
    if named and not named[event] then return takes_any end
    return select(2, answers_of(fsm, { event }))
  end
  for _, tr in ipairs(transitions) do
    for _, event in ipairs(tr.events or {}) do
      if type(event) ~= "function" and not is_listed[event] and is_enabled(event) then
        is_listed[event] = true
        list[#list + 1] = event
      end
    end
  end
  list.any = list.any or takes_any
  for _, region in ipairs(place.regions_of(fsm._act_leaf or {})) do
    add_enabled(list, is_listed, region.machine)
  end
  return list
end

--- List the events that would have a transition taken now, one event at a time.
--
-- Events are those that transitions name, in the order of the tree.
--
---@param fsm rfsm.Machine
---@return any[] events field `any` is true if any other event would, too
---@return string text the same for a person
function why.enabled(fsm)
  rfsm.check_machine(fsm, "rfsm_checks.enabled")
  local list = add_enabled({ any = false }, {}, fsm)
  local texts = texts_of(list)
  if list.any then texts[#texts + 1] = text_of(OTHER) end
  return list, texts[1] and concat(texts, "\n") or "no event"
end

return why
