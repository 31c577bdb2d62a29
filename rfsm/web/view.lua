--- What a page shows of a machine: its chart once, then what has changed.
--
-- `rfsm.web.live` is the view of a machine in this program, `rfsm.web.remote` of one
-- elsewhere. Both say by `now` what is active, waits and is enabled; the log and the
-- coverage are kept here.
--
-- @module rfsm.web.view
-- @license BSD-3-Clause

local marsh = require "rfsm.marsh"
local outline = require "rfsm.web.outline"

local ipairs, rawget, setmetatable, type = ipairs, rawget, setmetatable, type
local remove = table.remove
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local MAX_LOG = 500 -- entries that are kept
local MAX_TEXT = 2000 -- bytes of a text in the log

--- The state of a machine as a page shows it.
---@class rfsm.web.Now
---@field active integer[] numbers of nodes, from the root down
---@field leaf string|false FQN of the active leaf
---@field mode string of the leaf
---@field queue string[]
---@field enabled integer[] numbers of events
---@field any boolean would any other event do something?

--- What a page is shown of a machine.
---@class rfsm.web.View
---@field description rfsm.marsh.Node
---@field outline rfsm.web.Outline
---@field clock fun(): number seconds, for the log
---@field now fun(self: rfsm.web.View): rfsm.web.Now
---@field log table[]
---@field turn integer the log's entries belong to it
---@field why string|false why the last events did nothing
---@field taken integer[] numbers of the transitions taken last
---@field is_dirty boolean something has changed since the last message
---@field is_rewritten boolean so has something older
local View = {}
View.__index = View

local function new_marks() return { has = {}, count = 0, fresh = {} } end

local function count_states(nodes)
  local count = 0
  for _, node in ipairs(nodes) do
    if node.kind == "leaf" or node.kind == "composite" then count = count + 1 end
  end
  return count
end

--- Make a view of a class that is derived from this one.
---@param class table
---@param description rfsm.marsh.Node
---@param clock fun(): number
---@return rfsm.web.View view
function View.create(class, description, clock)
  local lists = outline.read(description)
  return setmetatable({
    description = description, outline = lists, clock = clock, log = {}, count = 0,
    sent = 0, turn = 0, why = false, taken = {}, is_taken_shown = true, is_dirty = true,
    is_rewritten = false, state_count = count_states(lists.nodes),
    seen_nodes = new_marks(), seen_edges = new_marks(),
  }, class)
end

-- Notes -----------------------------------------------------------------------------

--- Add an entry to the log.
---@param kind string "step", "lost", "error", "warning", "output" or "note"
---@param text string
---@param events? string[] of a step
function View:note(kind, text, events)
  self.count = self.count + 1
  self.log[#self.log + 1] = {
    number = self.count, at = self.clock(), kind = kind, events = events,
    turn = self.turn, text = marsh.utf8(text:sub(1, MAX_TEXT)),
  }
  if #self.log > MAX_LOG then remove(self.log, 1) end
  self.is_dirty = true
end

local function mark(list, number)
  if number and not list.has[number] then
    list.has[number], list.count = true, list.count + 1
    list.fresh[#list.fresh + 1] = number
  end
end

--- Note that a state was active.
---@param number integer
function View:see_node(number) mark(self.seen_nodes, number) end

--- Note that a transition was taken.
---@param number integer? nil if it is not in the chart
function View:see_edge(number)
  if self.is_taken_shown then self.taken, self.is_taken_shown = {}, false end
  mark(self.seen_edges, number)
  self.taken[#self.taken + 1] = number
end

--- Return the events as texts.
---@param events any[]
---@return string[] texts
function View:texts_of(events)
  local texts = {}
  for i = 1, #events do texts[i] = marsh.utf8(self.outline.event_text(events[i])) end
  return texts
end

--- Begin a turn: the transitions of the one before are the last ones no more.
---@param turn integer
function View:begin_turn(turn) self.turn, self.is_taken_shown = turn, true end

--- Take back what was noted after a turn; what was seen was seen.
---@param turn integer
function View:go_back(turn)
  for i = #self.log, 1, -1 do
    if self.log[i].turn > turn then remove(self.log, i) end
  end
  self.turn, self.why, self.taken = turn, false, {}
  self.is_dirty, self.is_rewritten = true, true
end

-- Messages --------------------------------------------------------------------------

--- Return the event in a message: a text, or the number of one of the chart's.
---@param message { event: any }
---@return any event nil if there is none
function View:event_of(message)
  local event = message.event
  if type(event) == "number" then return self.outline.values[event + 1] end
  return type(event) == "string" and event or nil
end

--- Return what a page draws once.
---@return table chart
function View:chart()
  local lists = self.outline
  return { nodes = lists.nodes, edges = lists.edges, events = lists.events }
end

local function seen_numbers(list, count)
  local numbers = {}
  for number = 0, count - 1 do
    if list.has[number] then numbers[#numbers + 1] = number end
  end
  return numbers
end

-- The log entries that no message had.
local function new_entries(view)
  local first = #view.log + 1
  while first > 1 and view.log[first - 1].number > view.sent do first = first - 1 end
  return { unpack(view.log, first) }
end

--- Return the state of now, and what has changed since the last message.
---@param is_full boolean for a page that knows nothing yet: all that was noted
---@return table message
function View:state(is_full)
  local message, lists = self:now(), self.outline
  message.is_full, message.why, message.taken = is_full, self.why, self.taken
  message.states = { self.seen_nodes.count, self.state_count }
  message.transitions = { self.seen_edges.count, #lists.edges }
  if is_full then
    message.log = self.log
    message.seen_nodes = seen_numbers(self.seen_nodes, #lists.nodes)
    message.seen_edges = seen_numbers(self.seen_edges, #lists.edges)
  else
    message.log = new_entries(self)
    message.seen_nodes = self.seen_nodes.fresh
    message.seen_edges = self.seen_edges.fresh
  end
  return message
end

--- All pages have the state of now.
function View:set_sent()
  self.sent, self.is_taken_shown = self.count, true
  self.is_dirty, self.is_rewritten = false, false
  self.seen_nodes.fresh, self.seen_edges.fresh = {}, {}
end

return View
