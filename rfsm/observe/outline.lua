--- The outline of a chart: its nodes, edges and events in lists, numbered from 0 on.
--
-- The outline is made from a description that `rfsm.marsh` has written, in this or in
-- another program.
--
-- @module rfsm.observe.outline
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local diagram = require "rfsm.pictures.diagram"
local marsh = require "rfsm.marsh"
local match = require "rfsm.shared.match"
local rfsm = require "rfsm"

local ipairs, type = ipairs, type
local concat = table.concat
local utf8 = marsh.utf8

local outline = {}

--- The chart as a page draws it.
---@class rfsm.observe.Outline
---@field nodes table[] { name, fqn, kind, parent?, is_region? }; parents come first
---@field edges table[] { key, src, tgt, label, events, is_internal? }
---@field events table[] { text, words, is_own, has_data }; `words`: as shown to a
-- person; `is_own`: the machine itself sends it; `has_data`: it is sent with data
---@field values any[] the events themselves, in the order of `events`
---@field number_of table<any, integer> number of a node, by its FQN
---@field edge_of table<string, integer> number of an edge, by the key of the transition
---@field event_of table<any, integer> number of an event, by the event
---@field event_text fun(event: any): string returns an event as a text
---@field from table<integer, table[]> the edges that begin at a node, by its number

local function add_node(list, tab, fqn, parent, is_region)
  local number = #list.nodes
  list.number_of[fqn] = number
  list.nodes[number + 1] = {
    name = utf8(tab.id), fqn = utf8(fqn), kind = diagram.kind_of(tab), parent = parent,
    is_region = is_region,
  }
  for _, subtab in ipairs(diagram.members(tab)) do
    add_node(list, subtab, fqn .. "." .. subtab.id, number, tab.regions and true)
  end
end

-- Returns the number of an event. Adds the event to the list if it is not there yet.
local function number_of(list, event, words)
  if not list.event_of[event] then
    list.event_of[event] = #list.values
    list.values[#list.values + 1] = event
    list.events[#list.values] = { text = utf8(list.event_text(event)),
      words = utf8(words), is_own = match.maker_of(event) == "engine",
      has_data = rfsm.event_name(event) and true }
  end
  return list.event_of[event]
end

local function label_of(tr, words)
  local parts = { words[1] and concat(words, ", ") or nil }
  if tr.guard then parts[#parts + 1] = "[" .. tr.guard .. "]" end
  if tr.effect then parts[#parts + 1] = "/ " .. tr.effect end
  return utf8(concat(parts, " "))
end

local function add_edge(list, tr, key, words)
  local edge = {
    key = utf8(key), src = list.number_of[tr.src], tgt = list.number_of[tr.tgt],
    label = label_of(tr, words), is_internal = tr.internal, events = {},
  }
  for i, event in ipairs(tr.events) do
    local has_data = match.has(tr.with_data or {}, event) -- a description from JSON
    edge.events[i] = number_of(list, has_data and rfsm.named(event) or event, words[i])
  end
  list.edge_of[key] = #list.edges
  list.edges[#list.edges + 1] = edge
  list.from[edge.src] = list.from[edge.src] or {}
  table.insert(list.from[edge.src], edge)
end

local function is_named(list, event)
  local name = rfsm.name_with_data(event)
  return list.event_of[name and rfsm.named(name) or event] ~= nil
end

--- Return a hint if no transition names an event, a text or with data; otherwise nil.
---@param list table the events of the outline
---@param event any
---@return string?
function outline.hint_for(list, event)
  local name, texts = rfsm.name_with_data(event), {}
  local text = name or event
  if type(text) ~= "string" or is_named(list, event) then return nil end
  for i, about in ipairs(list.events) do texts[i] = about.text end
  local other = name and text or text .. "{}"
  return ("no transition names '%s'%s"):format(name and text .. "{..}" or text,
    match.has(texts, text) and (" (did you mean '%s'?)"):format(other)
    or advice.nearest_name(text, texts))
end

--- Return the outline of a description.
function outline.read(description)
  local list = {
    nodes = {}, edges = {}, events = {}, values = {}, number_of = {}, edge_of = {},
    event_of = {}, from = {}, event_text = marsh.gen_event_text(),
  }
  add_node(list, description, "root")
  diagram.each_transition(description, list.event_text, function(...)
    add_edge(list, ...)
  end)
  return list
end

-- Adds the events of the edges from a node. If an edge leads to a connector, the edges
-- from the connector are included.
local function add_possible(list, found, node, is_seen)
  local is_from_state = diagram.is_state(list.nodes[node + 1])
  is_seen[node] = true
  for _, edge in ipairs(list.from[node] or {}) do
    local is_through = not diagram.is_state(list.nodes[(edge.tgt or node) + 1])
    for _, number in ipairs(edge.events) do found.set[number] = true end
    if is_from_state and not edge.events[1] then found.any = true end
    if is_through and not is_seen[edge.tgt] then
      add_possible(list, found, edge.tgt, is_seen)
    end
  end
end

--- List the numbers of the events of all transitions from active nodes, and from the
-- connectors that these transitions lead to. The second result is true if one of the
-- transitions takes any event. No guard is called.
function outline.possible(list, active)
  local found, is_seen, numbers = { set = {}, any = false }, {}, {}
  for _, node in ipairs(active) do add_possible(list, found, node, is_seen) end
  for number = 0, #list.events - 1 do
    if found.set[number] then numbers[#numbers + 1] = number end
  end
  return numbers, found.any
end

return outline
