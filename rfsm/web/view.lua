--- A machine as the page sees it: its chart once, then its states as they change.
--
-- A view watches a machine, and the machines inside its states (regions), through their
-- hooks and printers. States and transitions have numbers here, from 0 on, in the order
-- of the tree.
--
-- The file reads in this order: the chart, notes of what happens, the state of now.
--
-- @module rfsm.web.view
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local outline = require "rfsm.web.outline"
local place = require "rfsm.checks.place"
local marsh = require "rfsm.marsh"

local ipairs, rawget, select = ipairs, rawget, select
local setmetatable, tostring, type = setmetatable, tostring, type
local concat, remove = table.concat, table.remove
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local text_of, utf8 = rfsm.text_of, marsh.utf8

local MAX_LOG = 500 -- entries that are kept
local MAX_TEXT = 2000 -- bytes of a text in the log

--- What a page is shown of a machine.
---@class rfsm.web.View
---@field fsm rfsm.Machine
---@field outline rfsm.web.Outline
---@field log table[] entries; `first` is the number of log[1]
---@field is_dirty boolean something has changed since the last message
local View = {}
View.__index = View

-- The machines: that of the view, and those inside its states -----------------------

-- Returns the FQN that a node has in the description.
local function path_of(prefix, node) return prefix .. node._fqn:sub(5) end

-- Returns the numbers of a machine's transitions by their texts.
local function edges_by_text(view, machine, prefix)
  local by_text = {}
  rfsm.mapfsm(function(tr, composite, name)
    local text = tostring(tr)
    by_text[text] = by_text[text] or view.outline.edge_of[path_of(prefix, composite)
      .. (type(name) == "number" and ".trans[%s]" or ".%s"):format(text_of(name))]
  end, machine, rfsm.is_trans)
  return by_text
end

-- Notes the file and line of each node.
local function add_places(view, machine, prefix)
  for _, node in ipairs(rfsm.elements(machine, rfsm.is_node)) do
    local number = view.outline.number_of[path_of(prefix, node)]
    view.outline.nodes[number + 1].file = rfsm.location_of(node):match("^(.-:%d+): ")
  end
end

--- A machine of a view.
---@class rfsm.web.Watched
---@field fsm rfsm.Machine
---@field prefix string the FQN of its root in the description
---@field edges table<string, integer> numbers of its transitions by their texts
---@field path string|false of the transition in the current iteration

local watch

local function add_machine(view, machine, prefix)
  local watched = {
    fsm = machine, prefix = prefix, path = false,
    edges = edges_by_text(view, machine, prefix),
  }
  view.machines[#view.machines + 1] = watched
  add_places(view, machine, prefix)
  watch(view, watched)
  for _, state in ipairs(rfsm.elements(machine, rfsm.is_leaf)) do
    for _, region in ipairs(place.regions_of(state)) do
      add_machine(view, region.machine, path_of(prefix, state) .. "." .. region.name)
    end
  end
end

-- Notes of what happens ----------------------------------------------------------

local function texts_of(view, events)
  local texts = {}
  for i = 1, #events do texts[i] = utf8(view.outline.event_text(events[i])) end
  return texts
end

--- Add an entry to the log.
---@param kind string "step", "lost", "sent", "error", "warning", "output" or "note"
---@param text string
---@param events? string[] of a step
function View:note(kind, text, events)
  self.count = self.count + 1
  self.log[#self.log + 1] = {
    number = self.count, at = self.clock(), kind = kind, events = events,
    turn = self.turn, text = utf8(text:sub(1, MAX_TEXT)),
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

-- Calls f(number) for each active state of a machine, from its root on.
local function each_active(view, watched, f)
  local node = rfsm.get_sta_mode(watched.fsm) ~= "inactive" and watched.fsm
  while node do
    local number = view.outline.number_of[path_of(watched.prefix, node)]
    if number then f(number) end -- none, if it was merged in
    node = rfsm.actchild_get(node)
  end
end

-- What the records of a trace mean for the page.
local RECORDS = {}

function RECORDS.EXEC_PATH(_, watched, text)
  text = text_of(text):gsub("%[%w+%]", ""):gsub("%->", " \226\134\146 ")
  watched.path = (watched.prefix == "root" and "" or watched.prefix .. ": ") .. text
end

function RECORDS.EFFECT(view, watched, text)
  if view.is_told then view.taken, view.is_told = {}, false end
  local number = watched.edges[text]
  mark(view.seen_edges, number)
  view.taken[#view.taken + 1] = number
end

-- Has a printer of a machine call `note`, too.
local function listen(machine, name, note)
  local own = machine[name]
  machine[name] = function(...)
    note(...)
    if rfsm.is_callable(own) then return own(...) end
  end
end

local function line_of(...)
  local texts = {}
  for i = 1, select("#", ...) do texts[i] = text_of((select(i, ...))) end
  return concat(texts, " ")
end

-- Nobody asks why an event that the machine sends itself did nothing.
local function add_lost(view, events)
  for i = 1, #events do
    if not outline.is_own(events[i]) then view.lost[#view.lost + 1] = events[i] end
  end
end

-- Notes an iteration; one without events that took no transition is none.
local function note_step(view, watched, events)
  each_active(view, watched, function(number) mark(view.seen_nodes, number) end)
  if watched.path then
    view:note("step", watched.path, texts_of(view, events))
    view.lost, view.why = {}, false
  elseif watched.fsm == view.fsm then
    add_lost(view, events)
  end
  watched.path, view.is_dirty = false, true
end

-- Follows a machine through its hooks and printers.
function watch(view, watched)
  local fsm = watched.fsm
  listen(fsm, "dbg", function(id, text)
    if RECORDS[id] then RECORDS[id](view, watched, text) end
  end)
  listen(fsm, "err", function(...) view:note("error", line_of(...)) end)
  listen(fsm, "warn", function(...)
    view:note("warning", (line_of(...):gsub("^WARNING: ", "")))
  end)
  rfsm.post_step_hook_add(fsm, function(_, events) note_step(view, watched, events) end)
  rfsm.reset_hook_add(fsm, function() view.is_dirty = true end)
end

-- The state of now -----------------------------------------------------------------

-- Numbers of the active states, from the root down, those of regions behind.
local function active_numbers(view)
  local numbers = {}
  for _, watched in ipairs(view.machines) do
    each_active(view, watched, function(number)
      numbers[#numbers + 1] = number
    end)
  end
  return numbers
end

-- Numbers of the events that would have a transition taken.
local function enabled_numbers(view)
  local list = rfsm_checks.enabled(view.fsm)
  local numbers = {}
  for i, event in ipairs(list) do numbers[i] = view.outline.event_of[event] end
  return numbers, list.any
end

--- Say why events that took no transition did not, once the machine is idle.
function View:settle()
  if not self.lost[1] then return end
  local lost = self.lost
  self.lost = {}
  local texts, _, text = texts_of(self, lost), rfsm_checks.why(self.fsm, unpack(lost))
  self:note("lost", "no transition", texts)
  self.why = utf8(text)
end

-- Takes what a list of marks has that no message had.
local function take_fresh(list)
  local fresh = list.fresh
  list.fresh = {}
  return fresh
end

local function seen_numbers(list, count)
  local numbers = {}
  for number = 0, count - 1 do
    if list.has[number] then numbers[#numbers + 1] = number end
  end
  return numbers
end

--- Return what a page draws once.
---@return table chart
function View:chart()
  local list = self.outline
  return { nodes = list.nodes, edges = list.edges, events = list.events }
end

-- The log entries that no message had.
local function new_entries(view)
  local entries = {}
  for i = #view.log, 1, -1 do
    if view.log[i].number <= view.sent then break end
    table.insert(entries, 1, view.log[i])
  end
  view.sent = view.count
  return entries
end

local function queue_texts(view)
  local texts = {}
  for i, watched in ipairs(view.machines) do
    for _, text in ipairs(texts_of(view, watched.fsm._intq)) do
      texts[#texts + 1] = i == 1 and text or watched.prefix .. ": " .. text
    end
  end
  return texts
end

--- Return the state of now.
---@param is_full boolean for a page that knows nothing yet
---@return table message
function View:state(is_full)
  local leaf = self.fsm._act_leaf
  local enabled, any = enabled_numbers(self)
  local message = {
    active = active_numbers(self), leaf = leaf and utf8(leaf._fqn) or false,
    mode = leaf and leaf._mode or "inactive", queue = queue_texts(self),
    enabled = enabled, any = any, why = self.why, is_full = is_full,
    taken = self.taken,
    states = { self.seen_nodes.count, self.state_count },
    transitions = { self.seen_edges.count, #self.outline.edges },
  }
  if is_full then
    message.log = self.log
    message.seen_nodes = seen_numbers(self.seen_nodes, #self.outline.nodes)
    message.seen_edges = seen_numbers(self.seen_edges, #self.outline.edges)
  else
    message.log, self.is_told = new_entries(self), true
    message.seen_nodes = take_fresh(self.seen_nodes)
    message.seen_edges = take_fresh(self.seen_edges)
    self.is_dirty = false
  end
  return message
end

local function new_marks() return { has = {}, count = 0, fresh = {} } end

--- Watch a machine.
---@param fsm rfsm.Machine
---@param clock fun(): number seconds, for the log
---@return rfsm.web.View view
function View.new(fsm, clock)
  local view = setmetatable({
    fsm = fsm, clock = clock, machines = {}, turn = 0, is_dirty = true,
    description = marsh.model2tab(fsm, true), state_count = 0, log = {}, count = 0,
    sent = 0, path = false, lost = {}, why = false, taken = {}, is_told = true,
    seen_nodes = new_marks(), seen_edges = new_marks(),
  }, View)
  view.outline = outline.read(view.description)
  for _, node in ipairs(view.outline.nodes) do
    local is_state = node.kind == "leaf" or node.kind == "composite"
    view.state_count = view.state_count + (is_state and 1 or 0)
  end
  add_machine(view, fsm, "root")
  return view
end

return View
