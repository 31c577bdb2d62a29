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
local marsh = require "rfsm.marsh"

local ipairs, pairs, rawget, select = ipairs, pairs, rawget, select
local setmetatable, tostring, type = setmetatable, tostring, type
local concat, remove, sort = table.concat, table.remove, table.sort
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local text_of, utf8 = rfsm.text_of, marsh.utf8

local MAX_LOG = 500 -- entries that are kept
local MAX_TEXT = 2000 -- bytes of a text in the log

--- What a page is shown of a machine.
---@class rfsm.web.View
---@field fsm rfsm.Machine
---@field nodes table[] as they are sent
---@field edges table[]
---@field events any[] of the chart, in the order of the tree
---@field log table[] entries; `first` is the number of log[1]
---@field is_dirty boolean something has changed since the last message
local View = {}
View.__index = View

-- The chart --------------------------------------------------------------------

local function kind_of(node)
  if rfsm.is_composite(node) then return "composite" end
  if rfsm.is_state(node) then return "leaf" end
  return node._id == "initial" and "initial" or "connector"
end

local function file_and_line(obj) return rfsm.location_of(obj):match("^(.-:%d+): ") end

local function add_node(view, machine, node, region)
  local parent = node ~= machine and view.number[node._parent] or region.parent
  local at = #view.nodes
  view.number[node] = at
  view.nodes[at + 1] = {
    name = utf8(text_of(node == machine and region.name or node._id)),
    fqn = utf8(region.prefix .. node._fqn), kind = kind_of(node), parent = parent,
    is_region = node == machine and region.parent ~= nil or nil,
    doo = node.doo and true or nil, file = file_and_line(node),
  }
end

local function label_of(tr, events)
  local parts = { events[1] and concat(events, ", ") or nil }
  if tr.guard then parts[#parts + 1] = "[guard]" end
  if tr.effect then parts[#parts + 1] = "/ effect" end
  return concat(parts, " ")
end

-- Gives an event its number; each is listed once.
local function add_event(view, event)
  if view.event_number[event] then return end
  view.events[#view.events + 1] = event
  view.event_number[event] = #view.events - 1
end

local function add_edge(view, tr, by_text)
  local texts = {}
  for i, event in ipairs(tr.events or {}) do
    add_event(view, event)
    texts[i] = utf8(view.event_text(event))
  end
  local text, at = tostring(tr), #view.edges
  by_text[text] = by_text[text] or at
  view.edges[at + 1] = {
    src = view.number[tr.src], tgt = view.number[tr.tgt], label = label_of(tr, texts),
    internal = tr._is_internal and true or nil, file = file_and_line(tr),
  }
end

-- The machines inside a state, sorted by name.
local function regions_of(state)
  local machines = type(state.substates) == "table" and state.substates or {}
  local regions = {}
  for name, machine in pairs(machines) do -- any order: sorted below
    if rfsm.is_initialized_root(machine) then
      regions[#regions + 1] = { name = text_of(name), machine = machine }
    end
  end
  sort(regions, function(a, b) return a.name < b.name end)
  return regions
end

local add_machine

local function add_regions(view, state, region)
  for _, inner in ipairs(regions_of(state)) do
    add_machine(view, inner.machine, {
      name = inner.name, parent = view.number[state],
      prefix = region.prefix .. state._fqn .. "/" .. inner.name .. ": ",
    })
  end
end

-- Adds a machine, and those inside its states.
function add_machine(view, machine, region)
  local by_text = {}
  view.machines[#view.machines + 1] = machine
  view.prefixes[#view.machines] = region.prefix
  for _, node in ipairs(rfsm.elements(machine, rfsm.is_node)) do
    add_node(view, machine, node, region)
  end
  for _, tr in ipairs(rfsm.elements(machine, rfsm.is_trans)) do
    add_edge(view, tr, by_text)
  end
  view:watch(machine, region.prefix, by_text)
  for _, state in ipairs(rfsm.elements(machine, rfsm.is_leaf)) do
    add_regions(view, state, region)
  end
end

-- Notes of what happens ----------------------------------------------------------

local function texts_of(view, events)
  local texts = {}
  for i = 1, #events do texts[i] = utf8(view.event_text(events[i])) end
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

local function mark_active(view, machine)
  local node = machine._mode ~= "inactive" and machine or nil
  while node do
    mark(view.seen_nodes, view.number[node])
    node = node._actchild
  end
end

-- What the records of a trace mean for the page.
local RECORDS = {}

function RECORDS.EXEC_PATH(view, prefix, _, text)
  view.path = prefix .. text_of(text):gsub("%[%w+%]", ""):gsub("%->", " \226\134\146 ")
end

function RECORDS.EFFECT(view, _, by_text, text)
  local number = by_text[text]
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

-- The events that the machine sends itself; nobody asks why they did nothing.
local function is_own(event)
  return type(event) == "string"
    and (event == "e_init_fsm" or event:find("^e_done@") ~= nil)
end

local function add_lost(view, events)
  for i = 1, #events do
    if not is_own(events[i]) then view.lost[#view.lost + 1] = events[i] end
  end
end

-- Notes an iteration; one without events that took no transition is none.
local function note_step(view, machine, prefix, events)
  mark_active(view, machine)
  if view.path then
    view:note("step", view.path, texts_of(view, events))
    view.lost, view.why = {}, false
  elseif machine == view.fsm then
    add_lost(view, events)
  end
  view.path, view.is_dirty = false, true
end

--- Follow a machine.
---@param machine rfsm.Machine
---@param prefix string of the names of its states
---@param by_text table<string, integer> numbers of its transitions by their texts
function View:watch(machine, prefix, by_text)
  listen(machine, "dbg", function(id, text)
    if RECORDS[id] then RECORDS[id](self, prefix, by_text, text) end
  end)
  listen(machine, "err", function(...) self:note("error", line_of(...)) end)
  listen(machine, "warn", function(...) self:note("warning", line_of(...)) end)
  rfsm.post_step_hook_add(machine, function(_, events)
    note_step(self, machine, prefix, events)
  end)
  rfsm.reset_hook_add(machine, function() self.is_dirty = true end)
end

-- The state of now -----------------------------------------------------------------

-- Numbers of the active states, from the root down, regions behind their states.
local function active_numbers(view)
  local numbers = {}
  for _, machine in ipairs(view.machines) do
    local node = machine._mode ~= "inactive" and machine or nil
    while node do
      numbers[#numbers + 1] = view.number[node]
      node = node._actchild
    end
  end
  return numbers
end

-- Numbers of the events that would have a transition taken.
local function enabled_numbers(view)
  local list = rfsm_checks.enabled(view.fsm)
  local numbers = {}
  for i, event in ipairs(list) do numbers[i] = view.event_number[event] end
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
  local events = {}
  for i, event in ipairs(self.events) do
    local text = utf8(self.event_text(event))
    local is_done = type(event) == "string" and is_own(event)
    events[i] = { text = text, kind = is_done and "own"
      or text:find("^e_a[ft]t?e?r?%(") and "timer" or "event" }
  end
  return { nodes = self.nodes, edges = self.edges, events = events }
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
  for i, machine in ipairs(view.machines) do
    for _, text in ipairs(texts_of(view, machine._intq)) do
      texts[#texts + 1] = i == 1 and text or view.prefixes[i] .. text
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
    states = coverage(self, "nodes"), transitions = coverage(self, "edges"),
  }
  if is_full then
    message.log = self.log
    message.seen_nodes = seen_numbers(self.seen_nodes, #self.nodes)
    message.seen_edges = seen_numbers(self.seen_edges, #self.edges)
  else
    message.log, self.taken = new_entries(self), {}
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
    fsm = fsm, clock = clock, machines = {}, prefixes = {}, number = {}, nodes = {},
    edges = {}, events = {}, event_number = {}, event_text = marsh.gen_event_text(),
    log = {}, count = 0, sent = 0, path = false, lost = {}, why = false, taken = {},
    turn = 0, seen_nodes = new_marks(), seen_edges = new_marks(), is_dirty = true,
  }, View)
  add_machine(view, fsm, { name = "root", prefix = "" })
  return view
end

return View
