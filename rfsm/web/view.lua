--- A view of a machine for web pages: first its chart, then the changes.
--
-- Two classes are derived from this one: `rfsm.web.local_view` for a machine in this
-- program, `rfsm.web.remote` for a machine elsewhere. Their method `now` returns the
-- active states and the queue. The log and the coverage are kept here. Each page has a
-- cursor, which says what the page knows; a message to the page has only later changes.
--
-- @module rfsm.web.view
-- @license BSD-3-Clause

local diagram = require "rfsm.pictures.diagram"
local marsh = require "rfsm.marsh"
local outline = require "rfsm.observe.outline"
local rfsm = require "rfsm"
local typed = require "rfsm.shared.typed"

local ipairs, rawget = ipairs, rawget
local setmetatable, type = setmetatable, type
local max = math.max
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local MAX_LOG = 500 -- how many entries, the newest ones, are always kept
local MAX_SENT = 60 -- entries in a message to a page that has a cursor
local MAX_TEXT = 2000 -- bytes of the text of an entry in a message

--- What a page shows of a moment: of now, or of the moment after a step in the log.
---@class rfsm.web.Moment
---@field active integer[] numbers of nodes, from the root down
---@field leaf string|false FQN of the active leaf
---@field mode string mode of the leaf
---@field queue string[]
---@field timer? number|false seconds until the next timer; false if none runs
---@field nodes integer how many nodes of the list `seen_nodes` were seen until then
---@field edges integer how many transitions of the list `seen_edges` were taken
---@field failures integer[] node, count, node, count, ...

--- How much of a view a page knows.
---@class rfsm.web.Cursor
---@field log integer number of the last entry of the log that the page knows
---@field nodes integer how many nodes of the list `seen_nodes` the page knows
---@field edges integer how many transitions of the list `seen_edges` it knows
---@field rewrites integer `rewrites` of the view when the page got its last message

--- A view of a machine: its chart, its log, and its coverage.
---@class rfsm.web.View
---@field description rfsm.marsh.Node
---@field outline rfsm.observe.Outline
---@field clock fun(): number seconds, for the entries of the log
---@field now fun(self: rfsm.web.View): rfsm.web.Moment the first five fields
---@field log table[]
---@field turn integer number of the present turn: all that one command or timer does
---@field taken integer[] numbers of the transitions that are shown as taken
---@field revision integer counts the changes of the view
---@field rewrites integer counts the calls of `go_back`, which drop entries of the log
---@field failures table<integer, integer> how many callbacks failed, by node number
---@field failure_list integer[]|false the same as a list; false if it is out of date
---@field step_edges integer[] numbers of the transitions taken since the last step
local View = {}
View.__index = View

local function new_marks() return { has = {}, list = {} } end

local function count_states(nodes)
  local count = 0
  for _, node in ipairs(nodes) do
    if diagram.is_state(node) then count = count + 1 end
  end
  return count
end

--- Make a view of a class that is derived from this one.
function View.create(class, description, clock)
  local lists = outline.read(description)
  return setmetatable({
    description = description, outline = lists, clock = clock, log = {}, count = 0,
    turn = 0, taken = {}, is_taken_shown = true, revision = 1, rewrites = 0,
    state_count = count_states(lists.nodes), failures = {}, failure_list = {},
    step_edges = {},
    seen_nodes = new_marks(), seen_edges = new_marks(),
  }, class)
end

-- Notes -----------------------------------------------------------------------------

--- Note that something has changed.
function View:touch() self.revision = self.revision + 1 end

-- Drops old entries, many at a time: this costs less than to drop one at each call.
local function trim(view)
  local log = view.log
  if #log >= 2 * MAX_LOG then view.log = { unpack(log, #log - MAX_LOG + 1) } end
end

local function mark(list, number)
  if number and not list.has[number] then
    list.has[number] = true
    list.list[#list.list + 1] = number
  end
end

--- Note that states were active, by the numbers of their nodes.
function View:see_nodes(numbers)
  for _, number in ipairs(numbers) do mark(self.seen_nodes, number) end
end

-- Returns the counts of failed callbacks as a list { node, count, node, count, ... }.
local function failure_list(view)
  local list = {}
  for number = 0, #view.outline.nodes - 1 do
    if view.failures[number] then
      list[#list + 1], list[#list + 2] = number, view.failures[number]
    end
  end
  return list
end

--- Return the present moment. Its active states count for the coverage.
---@return rfsm.web.Moment
function View:moment()
  local moment = self:now()
  self:see_nodes(moment.active)
  self.failure_list = self.failure_list or failure_list(self)
  moment.nodes, moment.edges = #self.seen_nodes.list, #self.seen_edges.list
  moment.failures = self.failure_list
  return moment
end

--- Add an entry to the log, of the kind "step", "lost", "error", "warning", "output" or
-- "note". A step has events, and the moment after it. Events become texts only when an
-- entry is sent, since most entries of a fast machine are never sent.
function View:note(kind, text, events, moment)
  self.count = self.count + 1
  self.log[#self.log + 1] = {
    number = self.count, at = self.clock(), kind = kind, events = events,
    turn = self.turn, text = text, moment = moment, taken = moment and self.step_edges,
  }
  if moment then self.step_edges = {} end
  trim(self)
  self:touch()
end

--- Note that a transition was taken, by its number. The number is nil if the transition
-- was merged into the machine after the view was made; the page does not draw it.
function View:see_edge(number)
  if self.is_taken_shown then self.taken, self.is_taken_shown = {}, false end
  mark(self.seen_edges, number)
  for _, list in ipairs { self.taken, self.step_edges } do
    if #list < MAX_SENT then list[#list + 1] = number end
  end
end

--- Note that a callback has failed, by the number of its node.
function View:add_failure(number)
  self.failures[number], self.failure_list = (self.failures[number] or 0) + 1, false
  self:touch()
end

--- Return the events as texts, with their data.
function View:texts_of(events)
  local texts = {}
  for i = 1, #events do
    local event = events[i]
    texts[i] = marsh.utf8(rfsm.name_with_data(event) and rfsm.event_text(event, true)
      or self.outline.event_text(event))
  end
  return texts
end

--- Begin a turn. Its first transition replaces those that are shown as taken.
function View:begin_turn(turn) self.turn, self.is_taken_shown = turn, true end

--- Go back to the end of a turn: drop the entries of later turns, keep the coverage.
function View:go_back(turn)
  local kept = {}
  for _, entry in ipairs(self.log) do
    if entry.turn <= turn then kept[#kept + 1] = entry end
  end
  self.log, self.turn, self.taken = kept, turn, {}
  self.rewrites = self.rewrites + 1
  self:touch()
end

-- Messages --------------------------------------------------------------------------

--- Return the event in a message from a page: a text, or the number of an event in the
-- chart. The field `data` is a text. Return nil and the problem if it cannot be read.
function View:event_of(message)
  local event, data = message.event, message.data or ""
  if type(data) ~= "string" then return nil, "data: text expected" end
  if type(event) == "string" then
    if data:find("%S") then return typed.event(event, data) end
    return typed.read(event)
  end
  local value = nil
  if type(event) == "number" then value = self.outline.values[event + 1] end
  if value == nil then
    return nil, "event: text or number of an event expected"
  end
  local name = rfsm.event_name(value)
  if name then return typed.event(name, data) end
  return value
end

--- Return the chart as a page draws it.
function View:chart()
  local lists = self.outline
  return { nodes = lists.nodes, edges = lists.edges, events = lists.events }
end

-- Adds a moment to a message, or to an entry of the log in a message.
local function add_moment(view, message, moment, taken)
  local lists = view.outline
  message.active, message.leaf, message.mode = moment.active, moment.leaf, moment.mode
  message.queue, message.timer, message.taken = moment.queue, moment.timer, taken
  message.waiting = moment.waiting
  message.states = { moment.nodes, view.state_count }
  message.transitions = { moment.edges, #lists.edges }
  message.enabled, message.any = outline.possible(lists, moment.active)
  message.failures = moment.failures
  return message
end

local function sent(view, entry)
  local message = { number = entry.number, at = entry.at, kind = entry.kind,
    turn = entry.turn, text = marsh.utf8(entry.text:sub(1, MAX_TEXT)),
    events = entry.events and view:texts_of(entry.events) }
  return entry.moment and add_moment(view, message, entry.moment, entry.taken)
    or message
end

-- Returns the entries after number `last`, or only the last `most` of them.
local function entries_after(view, last, most)
  local log, entries = view.log, {}
  local first = max(1, #log - most + 1)
  while log[first] and log[first].number <= last do first = first + 1 end
  for i = first, #log do entries[#entries + 1] = sent(view, log[i]) end
  return entries
end

--- Return a message for a page, with the present state and the changes since its last
-- cursor, and the new cursor of the page. For a page without a cursor all is new.
function View:state(cursor)
  local message = add_moment(self, {}, self:moment(), self.taken)
  message.is_full = not cursor or cursor.rewrites ~= self.rewrites
  if message.is_full then cursor = { log = 0, nodes = 0, edges = 0 } end
  local nodes, edges = self.seen_nodes.list, self.seen_edges.list
  self.is_taken_shown = true
  message.log = entries_after(self, cursor.log, message.is_full and MAX_LOG or MAX_SENT)
  local first = message.log[1]
  message.skipped = not message.is_full and first and first.number - cursor.log - 1 or 0
  message.seen_nodes = { unpack(nodes, cursor.nodes + 1) }
  message.seen_edges = { unpack(edges, cursor.edges + 1) }
  return message, { log = self.count, nodes = #nodes, edges = #edges,
    rewrites = self.rewrites }
end

return View
