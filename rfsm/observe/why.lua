--- Why: explains for each transition if events would make the machine take it.
--
-- Guards and predicates are called, as when the engine searches for a transition.
-- No other callback is called, and the machine does not change.
--
-- @module rfsm.observe.why
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local calls = require "rfsm.shared.calls"
local alphabet = require "rfsm.shared.alphabet"
local match = require "rfsm.shared.match"
local order = require "rfsm.shared.order"
local location = require "rfsm.shared.location"

local ipairs, rawequal, rawget = ipairs, rawequal, rawget
local select, setmetatable, type = select, setmetatable, type
local getinfo = (rawget(_G, "debug") or {}).getinfo
local concat = table.concat
local is_conn, text_of = rfsm.is_conn, rfsm.text_of

local why = {}

--- The answer of one transition: would it be taken, and why (not)?
---@class rfsm_checks.Answer
---@field verdict "fires"|"lost"|"enabled"|"event"|"guard"|"failed"|"closed"
---@field reason string the verdict in words
---@field place string path and ends of the transition: "root.trans[2] (off -> on)"
---@field file string "chart.lua:7: "; empty if it is not known
---@field src string FQN of the source
---@field tgt string FQN of the target
---@field winner? string if "lost": the place of the transition that is taken instead
---@field connector? string if "closed": FQN of the connector where the path ends
---@field ways? rfsm_checks.Answer[] if "closed": the answers of the transitions from
-- the connector, unless an earlier answer has them

--- The answers for all transitions of a machine that the engine may try.
---@class rfsm_checks.Why
---@field events string[] the events, as texts
---@field leaf string|false FQN of the active leaf; false before the first entry
---@field fires string|false place of the transition that would be taken
---@field kept string[] the events that an extension would keep, with the state:
-- "e_job (root.warming defers it)"
---@field answers rfsm_checks.Answer[] in the order in which transitions are tried
---@field is_done boolean the leaf is done, so that its regions are not stepped any more
---@field regions { name: string, why: rfsm_checks.Why }[] regions of the leaf, unless a
-- transition would leave it before they get the events

--- Return an event that an extension keeps as text: "e_job (root.warming defers it)".
---@param event any
---@param use rfsm.Use|rfsm.Kept
---@param prefix? string prefix of the machine
---@return string
function why.kept_text(event, use, prefix)
  local state = use.state and location.path(use.state, prefix)
  return rfsm.event_text(event, true) .. (state and (" (%s %s it)"):format(state,
    use.word or "keeps") or "")
end

-- Returns an event that a transition waits for as text; of a function, where it is.
local function wanted_text(event)
  local info = getinfo and type(event) == "function" and not rfsm.event_name(event)
    and getinfo(event, "S")
  return info and ("what %s:%d accepts"):format(info.short_src, info.linedefined)
    or rfsm.event_text(event, true)
end

-- Search: as in the engine, but with an answer for each transition -----------------

-- Do the events trigger a transition? Without events, only a machine that was not
-- entered takes a transition, or one that needs no event is taken. Also returns the
-- event that counts for its guard. `first` is the event that counts for the first
-- transition of the path.
local function matches(search, tr, first)
  if tr.always == true then return search.needs_none end
  if match.is_any(tr) then
    if first == nil then first = search.events[1] end
    return not search.is_mute, first
  end
  for _, event in ipairs(search.events) do
    if match.takes(tr.events, event) then return true, event end
  end
  return false
end

-- Returns the node to which a transition leads; nil if its target cannot be entered.
-- A program may have changed the target.
local function target_of(tr)
  local tgt = tr.tgt
  if rawequal(tr.src, tgt) and rfsm.target_of(tr) == "internal" then return tgt end
  if rfsm.is_composite(tgt) then return tgt.initial end
  return rfsm.is_node(tgt) and tgt or nil
end

local function name_of(tgt) return rfsm.is_node(tgt) and tgt._fqn or text_of(tgt) end

-- Calls the guard hooks of extensions, then the guard. Returns the verdict and the
-- reason in words if one of them forbids the transition; else nil.
local function ask_guards(search, tr, event)
  if search.is_unasked then return nil end
  local hooks = search.fsm._guard_hooks and search.fsm._guard_hooks[tr] or {}
  for i = 1, #hooks + (tr.guard and 1 or 0) do
    local ok, answer = calls.try(hooks[i] or tr.guard, tr, search.events, event)
    local who = hooks[i] and "the guard hook of an extension" or "its guard"
    if not ok then return "failed", who .. " fails: " .. text_of(answer) end
    if answer == false then return "guard", who .. " returns false" end
  end
end

local ask_connector

-- Returns the verdict on a transition and the reason in words. If the path ends at a
-- connector, also returns the FQN of the connector and the answers of its transitions.
local function judge(search, tr, first)
  local is_triggered, event = matches(search, tr, first)
  if not is_triggered then
    local wanted = concat(order.map(tr.events or {}, wanted_text), ", ")
    return "event", "waits for " .. (wanted == "" and "any event" or wanted)
  end
  local verdict, reason = ask_guards(search, tr, event)
  if verdict then return verdict, reason end
  local tgt = target_of(tr)
  if not tgt then
    return "closed", "its target is " .. name_of(tr.tgt) .. ", which cannot be entered"
  end
  local found, ways = { way = true }, nil
  if first == nil then first = event end
  if is_conn(tgt) then found, ways = ask_connector(search, tgt, first) end
  if found.way then return "enabled", "enabled" end
  return "closed", "the path ends at " .. found.connector, found.connector, ways
end

local function ask(search, tr, first)
  local verdict, reason, connector, ways = judge(search, tr, first)
  local file, at = location.split(rfsm.location_of(tr))
  return { verdict = verdict, reason = reason, place = at, file = file,
    src = tr.src._fqn, tgt = name_of(tr.tgt), connector = connector, ways = ways }
end

-- Returns the result for a connector, and true if it is new. A connector may be asked
-- once for each event that counts for the first transition of a path.
local function result_for(search, connector, first)
  local key = first ~= nil and first == first and first or search
  local by_event = search.found[connector] or {}
  search.found[connector] = by_event
  if by_event[key] then return by_event[key], false end
  by_event[key] = { connector = connector._fqn, way = false }
  return by_event[key], true
end

-- Asks the transitions from a connector. The field `way` of the first result is true if
-- one of the transitions is enabled. The second result is a list of their answers. Only
-- the first call for a connector and an event returns this list. During that call the
-- connector counts as closed, so that a cycle of connectors ends. All transitions are
-- asked, while the engine stops at the first one that is enabled.
function ask_connector(search, connector, first)
  local found, is_new = result_for(search, connector, first)
  if not is_new then return found end
  local ways, pn = {}, nil
  for i, tr in ipairs(connector._otrs) do
    if pn and (tr.pn or 0) ~= pn then found.way = true end
    ways[i] = ask(search, tr, first)
    if not pn and ways[i].verdict == "enabled" then pn = tr.pn or 0 end
  end
  found.way = pn ~= nil
  if #ways == 1 then found.connector = ways[1].connector or found.connector end
  return found, ways
end

-- Asks the transitions that need no event, or the others: those come later. Returns the
-- name of the transition that would be taken, and the transition.
local function add_answers_of(fsm, search, answers, winner)
  for _, node in ipairs(location.tried(fsm, fsm._act_leaf)) do
    for _, tr in ipairs(node._otrs) do
      local is_asked = (tr.always == true) == search.needs_none
      local answer = is_asked and ask(search, tr) or {}
      if answer.verdict == "enabled" and winner then
        answer.verdict, answer.reason, answer.winner = "lost", "loses to " .. winner,
          winner
      elseif answer.verdict == "enabled" then
        answer.verdict, answer.reason = "fires", "would be taken"
        winner, search.taker = answer.place, tr
      end
      answers[#answers + 1] = is_asked and answer or nil
    end
  end
  return winner, search.taker
end

-- Guards are not asked if `is_unasked`.
local function answers_of(fsm, events, is_unasked)
  events = match.joined(events, select(2, rfsm.foretell(fsm, events)))
  local answers, winner, first, taker = {}, false
  if fsm._act_leaf then
    winner, first = add_answers_of(fsm, { fsm = fsm, events = {}, found = {},
      needs_none = true }, answers, winner)
  end
  winner, taker = add_answers_of(fsm, { fsm = fsm, events = events, found = {},
    needs_none = false, is_mute = fsm._act_leaf and events[1] == nil,
    is_unasked = is_unasked }, answers, winner)
  return answers, winner, first or taker
end

-- Lists the events that an extension would keep, as texts, since the transition that
-- would be taken does not take them.
local function kept_texts(fsm, events, taker)
  local texts = {}
  for _, kept in ipairs((rfsm.foretell(fsm, events))) do
    local is_taken = taker and (match.is_any(taker)
      or match.takes(taker.events, kept.event))
    if not is_taken then texts[#texts + 1] = why.kept_text(kept.event, kept) end
  end
  return texts
end

-- Text ----------------------------------------------------------------------------

local function add_answers(lines, answers, indent)
  for _, answer in ipairs(answers) do
    lines[#lines + 1] = indent .. answer.place .. ": " .. answer.reason
    if answer.ways then add_answers(lines, answer.ways, indent .. "  ") end
  end
end

-- Returns what would be taken, in regions too; nil if nothing would.
local function taken(result)
  local texts = { result.fires or nil }
  for _, region in ipairs(result.regions) do
    local inner = taken(region.why)
    if inner then texts[#texts + 1] = "region " .. region.name .. ": " .. inner end
  end
  return texts[1] and concat(texts, " and ")
end

local function summary(result)
  local events = result.events[1] and "on " .. concat(result.events, ", ")
    or "without an event"
  local leaf = " in " .. (result.leaf or "a machine that was not entered")
  return (taken(result) or "no transition") .. " would be taken " .. events .. leaf
end

local function add_text(lines, result, indent)
  lines[#lines + 1] = indent .. summary(result)
  if result.kept[1] then
    lines[#lines + 1] = indent .. "  kept: " .. concat(result.kept, ", ")
  end
  if result.is_done then
    lines[#lines + 1] = indent .. "  its regions are not stepped any more: it is done"
  end
  add_answers(lines, result.answers, indent .. "  ")
  for _, region in ipairs(result.regions) do
    lines[#lines + 1] = indent .. "  region " .. region.name .. ":"
    add_text(lines, region.why, indent .. "    ")
  end
end

-- Public functions ----------------------------------------------------------------

-- Returns the regions that the active leaf steps; and true if it is done, and has some.
local function stepped_regions(fsm)
  local leaf = fsm._act_leaf or {}
  local regions = location.regions_of(leaf)
  local is_done = leaf._mode == "done" and regions[1] ~= nil
  return is_done and {} or regions, is_done
end

local function explain(fsm, events)
  local answers, winner, taker = answers_of(fsm, events)
  local regions, is_done = stepped_regions(fsm)
  local result = { events = order.map(events, rfsm.event_text, true), fires = winner,
    answers = answers, kept = kept_texts(fsm, events, taker),
    leaf = rfsm.get_actleaf_fqn(fsm), is_done = is_done, regions = {} }
  local is_left = taker and rfsm.target_of(taker) ~= "internal"
  for i, region in ipairs(is_left and {} or regions) do
    result.regions[i] = { name = region.name, why = explain(region.machine, events) }
  end
  return result
end

--- Explain the effect of events in the current state of a machine.
--
-- There is an answer for each transition of the active leaf and the states around it.
-- If the transition would not be taken, the answer has the reason: it waits for another
-- event, its guard is false, another transition is tried earlier, or its path ends at a
-- connector. Guards and predicates are called, other callbacks are not. Events that a
-- step hook or a timer would add are not known here.
--
---@param fsm rfsm.Machine
---@param ... any events; without events, those in the queue are used
---@return rfsm_checks.Why why the answers as plain tables
---@return string text the answers as text
function why.why(fsm, ...)
  rfsm.check_machine(fsm, "rfsm_checks.why")
  local events = select("#", ...) == 0 and match.joined({}, fsm._intq) or {}
  for i = 1, select("#", ...) do
    events[#events + 1] = (select(i, ...)) -- nil is left out
  end
  local result, lines = explain(fsm, events), {}
  add_text(lines, result, "")
  return result, concat(lines, "\n")
end

-- This table represents every event that is in no transition.
local OTHER = setmetatable({}, { __tostring = function() return "any other event" end })

-- Appends the events on which the machine, or a region of its leaf, takes a transition.
-- Each event is tried, even if a transition reacts to any event, since its guard may
-- refuse some events. A guard may read the data of an event, so it is not asked then.
local function add_enabled(list, is_listed, fsm)
  local function add(event, sample, is_unasked)
    if not is_listed[event] and select(2, answers_of(fsm, { sample }, is_unasked)) then
      is_listed[event] = true
      list[#list + 1] = event
    end
  end
  local known = alphabet.of(fsm)
  list.any = list.any or select(2, answers_of(fsm, { OTHER })) and true
  for _, event in ipairs(match.joined(known.list, known.reactions)) do
    add(event, event)
  end
  for _, predicate in ipairs(known.predicates) do
    local name = rfsm.event_name(predicate)
    if name then add(predicate, { name = name }, true) end
  end
  for _, region in ipairs((stepped_regions(fsm))) do
    add_enabled(list, is_listed, region.machine)
  end
  return list
end

--- List the events that would make the machine take a transition now.
--
-- Each event of a transition is tried alone, in the order of the tree. An event with
-- data is listed as the predicate of its name, and its guard is not asked.
--
---@param fsm rfsm.Machine
---@return any[] events the field `any` is true if any other event has this effect, too
---@return string text the events as text, one in a line
function why.enabled(fsm)
  rfsm.check_machine(fsm, "rfsm_checks.enabled")
  local list = add_enabled({ any = false }, {}, fsm)
  local texts = order.map(list, rfsm.event_text)
  if list.any then texts[#texts + 1] = text_of(OTHER) end
  return list, texts[1] and concat(texts, "\n") or "no event"
end

return why
