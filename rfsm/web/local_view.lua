--- The view of a machine in this program, and of the regions in its states.
--
-- While it is observed, its hooks and printers note what happens, and go on as before.
-- Otherwise only failures and warnings are noted, and the machine runs as without a
-- page. Guards are called only for the question why.
--
-- The file reads in this order: the machines, failures, what a observed machine does,
-- the present state, questions.
--
-- @module rfsm.web.local_view
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local calls = require "rfsm.shared.calls"
local marsh = require "rfsm.marsh"
local outline = require "rfsm.observe.outline"
local location = require "rfsm.shared.location"
local breakpoints = require "rfsm.observe.breakpoints"
local instrument = require "rfsm.shared.instrument"
local values = require "rfsm.observe.values"
local View = require "rfsm.web.view"

local ipairs, rawget = ipairs, rawget
local setmetatable, tostring, type = setmetatable, tostring, type
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local utf8 = marsh.utf8

local MAX_LOST = 20 -- so many events without an effect are named

--- A machine that is observed.
---@class rfsm.web.LocalView : rfsm.web.View
---@field fsm rfsm.Machine
---@field machines rfsm.web.Observed[]
---@field lost any[] events that took no transition since the last transition
---@field last_lost any[] such events of the last entry in the log
---@field entered table<integer, integer> how often a state was entered while observed
---@field is_observed boolean
---@field points rfsm.observe.Breakpoint[] breakpoints
---@field hit string|false the breakpoint that was reached since this was set to false
local LocalView = setmetatable({}, { __index = View })
LocalView.__index = LocalView

-- The machines: that of the view, and those inside its states -----------------------

--- A machine of a view.
---@class rfsm.web.Observed
---@field fsm rfsm.Machine
---@field prefix string the FQN of its root in the description
---@field numbers table<rfsm.State, integer> of its nodes
---@field by_fqn table<string, integer> of its nodes by their FQN in the machine
---@field transitions table<string, rfsm.Transition> by their texts
---@field edges table<rfsm.Transition, integer> their numbers
---@field path_texts table<string, string> for a reader
---@field path string|false of the transition in the current iteration
---@field printers table[] changes of err and warn
---@field tracer table[] change of dbg, and hooks, while it is observed

local function add_transitions(view, observed)
  for _, tr in ipairs(rfsm.elements(observed.fsm, rfsm.is_trans)) do
    local text = tostring(tr)
    observed.transitions[text] = observed.transitions[text] or tr
    observed.edges[tr] = view.outline.edge_of[location.path(tr, observed.prefix)]
  end
end

-- Returns a table of paths as a reader sees them, by their texts in a trace.
local function new_path_texts(prefix)
  local begin = prefix == "root" and "" or prefix .. ": "
  return setmetatable({}, { __index = function(texts, text)
    texts[text] = begin .. text:gsub("%[%w+%]", ""):gsub("%->", " \226\134\146 ")
    return texts[text]
  end })
end

local function add_machine(view, at)
  local fsm, prefix = at.machine, at.prefix
  local observed = { fsm = fsm, prefix = prefix, path = false, numbers = {},
    by_fqn = {}, transitions = {}, edges = {}, path_texts = new_path_texts(prefix),
    printers = {}, tracer = {} }
  add_transitions(view, observed)
  for _, node in ipairs(rfsm.elements(fsm, rfsm.is_node)) do
    local number = view.outline.number_of[location.path(node, prefix)]
    observed.numbers[node], observed.by_fqn[node._fqn] = number, number
    view.outline.nodes[number + 1].file = rfsm.location_of(node):match("^(.-:%d+): ")
    view.node_of[number] = node
  end
  view.machines[#view.machines + 1] = observed
  return observed
end

-- Failures: noted also while nobody observes ----------------------------------------

-- Returns the arguments of a printer as a line, without the id of the record.
local function line_of(...)
  return (calls.text(" ", ...):gsub("^%u+:? ", ""):gsub(":  ", ": "))
end

-- Returns the number of the node in a report; for a guard or an effect the source.
local function node_in(observed, line)
  local fqn = line:match("src='(root[^']*)'") or line:match("'(root[^']*)' failed")
    or line:match(" of (root.-): ")
  return observed.by_fqn[fqn]
end

local function note_failure(view, observed, ...)
  local line = line_of(...)
  local number = node_in(observed, line)
  if number then view:add_failure(number) end
  view:note("error", line)
end

local function listen_to_failures(view, observed)
  local fsm = observed.fsm
  instrument.listen(observed.printers, fsm, "err", function(...)
    note_failure(view, observed, ...)
  end)
  instrument.listen(observed.printers, fsm, "warn", function(...)
    view:note("warning", line_of(...))
  end)
end

-- What a observed machine does -----------------------------------------------------

-- Notes the breakpoint that is reached, if one is.
local function check_points(view, kind, value)
  breakpoints.each_reached(view.points, kind, value, function(_, point)
    view.hit = point.name
  end)
end

-- The meaning of the records of a trace for the page.
local RECORDS = {}

function RECORDS.EXEC_PATH(_, observed, text)
  observed.path = observed.path_texts[text]
end

function RECORDS.EFFECT(view, observed, text)
  local tr = observed.transitions[text]
  if not tr then return end -- merged in
  view:see_edge(observed.edges[tr])
  check_points(view, "transition", tr)
end

function RECORDS.STATE_ENTER(view, observed, fqn)
  local number = observed.by_fqn[fqn]
  check_points(view, "state", observed.prefix .. fqn:sub(#"root" + 1))
  if number then view.entered[number] = (view.entered[number] or 0) + 1 end
end

-- Appends the numbers of the active states of a machine, from its root on.
local function add_active(numbers, observed)
  local node = rfsm.get_sta_mode(observed.fsm) ~= "inactive" and observed.fsm
  while node do
    numbers[#numbers + 1] = observed.numbers[node] -- nil, if it was merged in
    node = rfsm.actchild_get(node)
  end
  return numbers
end

-- Numbers of the active states, from the root down, those of regions behind.
local function active_numbers(view)
  local numbers = {}
  for _, observed in ipairs(view.machines) do add_active(numbers, observed) end
  return numbers
end

-- Notes events without an effect, except those that the machine sends itself.
local function add_lost(view, events)
  for i = 1, #events do
    if not outline.is_own(events[i]) and #view.lost < MAX_LOST then
      view.lost[#view.lost + 1] = events[i]
    end
  end
end

-- Logs an iteration, unless nothing happened in it.
local function note_step(view, observed, events)
  for i = 1, view.points[1] and #events or 0 do
    check_points(view, "event", events[i])
  end
  if observed.path then
    for _, number in ipairs(add_active({}, observed)) do view:see_node(number) end
    view:note("step", observed.path, { unpack(events) }, active_numbers(view))
    view.lost = {}
  elseif observed.fsm == view.fsm then
    add_lost(view, events)
  end
  observed.path = false
  view:touch()
end

local function attach(view, observed)
  local fsm = observed.fsm
  instrument.listen(observed.tracer, fsm, "dbg", function(id, text)
    local take = RECORDS[id]
    if take then take(view, observed, text) end
  end)
  -- before the user's hooks, which may fail
  instrument.hook(observed.tracer, fsm, "post_step", function(_, events)
    note_step(view, observed, events)
  end, "before")
  instrument.hook(observed.tracer, fsm, "reset", function() view:touch() end)
end

--- Begin or end to note what the machine does.
function LocalView:observe(is_wanted)
  if self.is_observed == is_wanted then return end
  self.is_observed, self.lost = is_wanted, {}
  for _, observed in ipairs(self.machines) do
    if is_wanted then
      attach(self, observed)
    else
      instrument.give_back(observed.tracer)
    end
    observed.path = false
    for _, number in ipairs(add_active({}, observed)) do self:see_node(number) end
  end
  self:touch()
end

--- Leave the machine as it was.
function LocalView:close()
  self:observe(false)
  for _, observed in ipairs(self.machines) do
    instrument.give_back(observed.printers)
  end
end

-- The present state ----------------------------------------------------------------

local function queue_texts(view)
  local texts = {}
  for i, observed in ipairs(view.machines) do
    for _, text in ipairs(view:texts_of(observed.fsm._intq)) do
      texts[#texts + 1] = i == 1 and text or observed.prefix .. ": " .. text
    end
  end
  return texts
end

function LocalView:now()
  local leaf = self.fsm._act_leaf
  return {
    active = active_numbers(self), leaf = leaf and utf8(leaf._fqn) or false,
    mode = leaf and leaf._mode or "inactive", queue = queue_texts(self),
  }
end

--- Note the events that took no transition, once the machine is idle.
function LocalView:settle()
  if self.lost[1] == nil then return end
  self.last_lost, self.lost = self.lost, {}
  self:note("lost", "no transition", self.last_lost)
end

function LocalView:go_back(turn)
  self.lost = {}
  View.go_back(self, turn)
end

-- Questions -----------------------------------------------------------------------

--- Say why events that took no transition did not. This calls guards.
function LocalView:why()
  local _, text = rfsm_checks.why(self.fsm, unpack(self.last_lost))
  return utf8(text)
end

local CALLBACKS = { "entry", "doo", "exit" }

-- Returns the data of a state: its fields that belong to the user.
local function data_of(state)
  local texts = {}
  for _, key in ipairs(rfsm.sorted_keys(state)) do
    local value = rawget(state, key)
    local is_data = type(key) == "string" and not rfsm.is_meta(key)
      and type(value) ~= "function" and not rfsm.is_fsmobj(value)
    if is_data then texts[#texts + 1] = key .. " = " .. values.value(value) end
  end
  return texts
end

--- Return what is known of a state; nil if there is none of that number.
function LocalView:inspect(number)
  local node = self.node_of[number]
  if not node then return nil end
  local about = { fqn = self.outline.nodes[number + 1].fqn, callbacks = {},
    file = self.outline.nodes[number + 1].file, entered = self.entered[number] or 0,
    failures = self.failures[number] or 0, data = {} }
  if not rfsm.is_state(node) then return about end
  for _, name in ipairs(CALLBACKS) do
    if node[name] then about.callbacks[#about.callbacks + 1] = name end
  end
  for i, text in ipairs(data_of(node)) do about.data[i] = utf8(text) end
  return about
end

--- Answer the command `inspect` of a page: a problem, or nil and what is known.
function LocalView.answer_inspect(source, message)
  local about = source.view:inspect(message.node)
  return not about and "node: number of a state expected" or nil, about
end

--- View a machine; `observe` begins to do so. The clock returns seconds, for the log.
function LocalView.new(fsm, clock)
  local view = View.create(LocalView, marsh.model2tab(fsm, true), clock)
  view.fsm, view.machines, view.node_of = fsm, {}, {}
  view.lost, view.last_lost, view.entered, view.is_observed = {}, {}, {}, false
  view.points, view.hit = {}, false
  for _, at in ipairs(rfsm.machines(fsm)) do
    listen_to_failures(view, add_machine(view, at))
  end
  return view
end

return LocalView
