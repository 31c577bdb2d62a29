--- Match: which events a transition names, and lists of events.
--
-- Events are compared by identity. Tools that do not have the data of an event compare
-- it by its name: `match.example_of` returns one table for all events of a name.
--
-- @module rfsm.shared.match
-- @license BSD-3-Clause

local try = require("rfsm.shared.calls").try -- alone: a pool drops the module
local order = require "rfsm.shared.order"
local rfsm = require "rfsm"

local getmetatable, ipairs = getmetatable, ipairs
local rawequal, rawget, setmetatable, type = rawequal, rawget, setmetatable, type

local match = {}

-- name -> the event that stands for all events with data of this name
local examples = setmetatable({}, { __mode = "v" })

-- Events with data that stand for themselves alone; data -> its events, by name.
local alone = setmetatable({}, { __mode = "k" })
local events_of = setmetatable({}, { __mode = "k" })

--- Return a copy of some data as an event that stands for no other event of its name.
--- It is the same one at each call.
---@param name string
---@param data table
---@return table event
function match.event_with(name, data)
  local events = events_of[data] or {}
  local event = events[name] or {}
  for key, value in order.each(data) do event[key] = value end -- any order: a copy
  event.name = name
  events_of[data], events[name], alone[event] = events, event, true
  return event
end

--- Return the event that stands for all events with data of one name, given one of them
--- or its predicate; return any other event as it is.
---@param event any
---@return any example
function match.example_of(event)
  if alone[event or alone] then return event end
  local name = rfsm.event_name(event) or rfsm.name_with_data(event)
  if not name then return event end
  local example = examples[name] or { name = name }
  examples[name] = example
  return example
end

--- Is the event in a list?
function match.has(list, event)
  for i = 1, #list do
    if rawequal(list[i], event) then return true end
  end
  return false
end

--- Is the event in a list, or does a predicate in the list accept it? A predicate that
--- raises an error does not accept the event.
function match.takes(list, event)
  if match.has(list, event) then return true end
  for i = 1, #list do
    local ok, answer = false, nil
    if type(list[i]) == "function" then ok, answer = try(list[i], event) end
    if ok and answer then return true end
  end
  return false
end

--- Return two lists joined to a new one; the first list itself if the second is empty.
function match.joined(list, more)
  if more[1] == nil then return list end
  local longer = {}
  for i = 1, #list do longer[i] = list[i] end
  for i = 1, #more do longer[#longer + 1] = more[i] end
  return longer
end

--- Return a copy of a list with one event more.
function match.with(list, event) return match.joined(list, { event }) end

--- Does any event trigger the transition, because it names no event? One that needs no
--- event (`always`) is triggered by none.
function match.is_any(tr)
  return (not tr.events or tr.events[1] == nil) and tr.always ~= true
end

--- Can a path begin with the transition on any event? No path begins at a connector.
function match.begins_on_any(tr)
  return match.is_any(tr) and not rfsm.is_conn(tr.src)
end

--- Does the transition name the event? Predicates are not called.
function match.names(tr, event) return match.has(tr.events or {}, event) end

--- Does an event trigger the transition? Predicates are not called.
---@return boolean|nil is_triggered nil: a predicate decides
function match.triggers(tr, event)
  if match.is_any(tr) or match.names(tr, event) then return true end
  for _, other in ipairs(tr.events) do
    if type(other) == "function" then return nil end
  end
  return false
end

--- May one of some predicates accept an event, or the events of a predicate of the
--- same name? Predicates of the user are not called; they count as accepting any event.
--- Other values in the list accept none.
---@param predicates any[]
---@param event any
---@return boolean
function match.may_accept(predicates, event)
  local name = rfsm.event_name(event)
    or type(event) == "table" and rawget(event, "name")
  for i = 1, #predicates do
    local own = rfsm.event_name(predicates[i])
    if type(predicates[i]) == "function" and (not own or own == name) then
      return true
    end
  end
  return false
end

--- List the transitions of a machine and its regions.
function match.transitions_of(fsm)
  local list = {}
  for _, at in ipairs(rfsm.machines(fsm)) do
    for _, tr in ipairs(rfsm.elements(at.machine, rfsm.is_trans)) do
      list[#list + 1] = tr
    end
  end
  return list
end

--- May one of some transitions take an event, or one that a predicate accepts?
---@param transitions rfsm.Transition[]
---@param event any
---@return boolean
function match.may_be_taken(transitions, event)
  if type(event) == "function" and not rfsm.event_name(event) then return true end
  for i = 1, #transitions do
    local tr = transitions[i]
    if match.begins_on_any(tr) or match.names(tr, event)
      or match.may_accept(tr.events, event) then
      return true
    end
  end
  return false
end

--- Can a path that begins with the transition be taken on some events? Guards count as
--- true, and a predicate accepts no event.
---@param tr rfsm.Transition
---@param list any[]
---@param seen? table<rfsm.Connector, boolean> connectors that the path has passed
---@return boolean
function match.may_enable(tr, list, seen)
  local is_named = match.is_any(tr)
  for i = 1, #list do is_named = is_named or match.triggers(tr, list[i]) end
  seen = seen or {}
  if not is_named or seen[tr.tgt] then return false end
  if not rfsm.is_conn(tr.tgt) then return true end
  seen[tr.tgt] = true
  for _, way in ipairs(tr.tgt._otrs) do
    if match.may_enable(way, list, seen) then return true end
  end
  return false
end

local DEEPEST = 20 -- levels of tables that are compared

--- Are two values equal? Plain tables are compared by their contents.
---@param a any
---@param b any
---@param level? integer
---@return boolean
function match.are_equal(a, b, level)
  if type(a) ~= "table" or type(b) ~= "table" then return rawequal(a, b) end
  if getmetatable(a) ~= nil or getmetatable(b) ~= nil then return rawequal(a, b) end
  level = (level or 0) + 1
  if level > DEEPEST then return false end -- a table may contain itself
  for key, value in order.each(a) do -- any order: one difference decides
    if not match.are_equal(value, b[key], level) then return false end
  end
  for key in order.each(b) do -- any order: one difference decides
    if a[key] == nil then return false end
  end
  return true
end

--- Return the part of the library that makes an event. The name of an event that a
--- machine makes ends in "@" and the FQN of a state.
---@param event any
---@return string? maker "engine" or an extension; nil: the event comes from outside
---@return string? fqn for a time event, the FQN of the state that has to be active
function match.maker_of(event)
  event = rfsm.name_with_data(event) or event
  if type(event) ~= "string" then return nil end
  if event == "e_init_fsm" or event:find("^e_done@root") then return "engine" end
  for _, maker in ipairs(rfsm.makers) do
    local name, fqn = maker(event)
    if name then return name, fqn end
  end
end

--- Return the maker of an event, as `maker_of` does; nil if the event comes from
--- outside. An event e_done@F comes from outside, too, if F cannot be done.
---@param event any
---@param done table<string, true> the events e_done@F that machines can make
---@return string? maker
---@return string? fqn
function match.maker_among(event, done)
  local maker, fqn = match.maker_of(event)
  if maker == "engine" and event ~= "e_init_fsm" and not done[event] then return nil end
  return maker, fqn
end

return match
