--- The view of a machine that runs in this program, with the regions in its states.
--
-- Failures and warnings are always noted. Steps and entries of states are noted only
-- while the machine is observed. Only the function `LocalView:why` calls guards.
--
-- The sections of this file: the machines, failures, what an observed machine does, the
-- present state, questions.
--
-- @module rfsm.web.local_view
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local rfsmpp = require "rfsmpp"
local calls = require "rfsm.shared.calls"
local marsh = require "rfsm.marsh"
local match = require "rfsm.shared.match"
local location = require "rfsm.shared.location"
local breakpoints = require "rfsm.observe.breakpoints"
local clock = require "rfsm.clock"
local instrument = require "rfsm.shared.instrument"
local stream = require "rfsm.observe.stream"
local why = require "rfsm.observe.why"
local View = require "rfsm.web.view"

local ipairs, rawget = ipairs, rawget
local setmetatable, type = setmetatable, type
local concat, min = table.concat, math.min
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local utf8 = marsh.utf8

local MAX_LOST = 20 -- how many events without an effect are noted, at most
local MAX_QUEUED = 20 -- how many waiting events a moment has, at most

--- A machine that is observed.
---@class rfsm.web.LocalView : rfsm.web.View
---@field fsm rfsm.Machine
---@field machines rfsm.Place[] the machine and its regions
---@field numbers table<table, integer> numbers of nodes and transitions. An element
-- that was merged in later has none
---@field path table<rfsm.Machine, string> the path taken in the current iteration
---@field lost any[] events without an effect, since the last transition was taken
---@field last_lost any[] the events in the last "lost" entry of the log
---@field entered table<integer, integer> number of a state -> how often it was entered
-- while the machine was observed
---@field stream rfsm.observe.Stream|false false while the machine is not observed
---@field changes table[] hooks and printers that `close` removes from the machine
---@field points rfsm.observe.Breakpoint[] breakpoints
---@field hit string|false name of the last breakpoint reached; the caller resets it
---@field has_timer boolean moments have the time until the next timer; default false
local LocalView = setmetatable({}, { __index = View })
LocalView.__index = LocalView

-- The machines: the machine of the view, and the regions in its states --------------

-- Notes the number that each element of a machine has in the outline of the view.
local function add_machine(view, at)
  local lists, numbers = view.outline, view.numbers
  for _, element in ipairs(rfsm.elements(at.machine)) do
    local path = location.path(element, at.prefix)
    if rfsm.is_trans(element) then
      numbers[element] = lists.edge_of[path]
    else
      local number = lists.number_of[path]
      numbers[element], view.node_of[number] = number, element
      lists.nodes[number + 1].file = rfsm.location_of(element):match("^(.-:%d+): ")
    end
  end
end

-- Failures: noted also while the machine is not observed -----------------------------

-- Notes in the log each text that a printer of a machine (`err`, `warn`) gets, without
-- the words in front of it, such as "ERROR: ".
local function listen_to(view, fsm, name, kind)
  instrument.listen(view.changes, fsm, name, function(...)
    view:note(kind, (calls.text(" ", ...):gsub("^%u+:? ", ""):gsub(":  ", ": ")))
  end)
end

-- Counts the failed callbacks of each state. A guard or effect counts for the source of
-- its transition.
local function count_failures(view, fsm)
  instrument.hook(view.changes, fsm, "watch", "failed", function(_, element)
    local number = view.numbers[rfsm.is_trans(element) and element.src or element]
    if number then view:add_failure(number) end
  end)
end

-- What an observed machine does ------------------------------------------------------

-- Notes in `hit` the breakpoint that is reached, if there is one for this state,
-- transition or event (`kind` is "state", "transition" or "event").
local function check_points(view, kind, value)
  breakpoints.each_reached(view.points, kind, value, function(_, point)
    view.hit = point.name
  end)
end

-- Returns the numbers of the active states: first those of the machine itself, from the
-- root down, then those of its regions.
local function active_numbers(view)
  local numbers = {}
  for _, at in ipairs(view.machines) do
    local node = rfsm.get_sta_mode(at.machine) ~= "inactive" and at.machine
    while node do
      numbers[#numbers + 1] = view.numbers[node]
      node = rfsm.actchild_get(node)
    end
  end
  return numbers
end

-- Notes an event that nobody has used, or that an extension keeps.
local function note_fate(view, at, event, fate, who)
  if fate == "discarded" and #view.lost < MAX_LOST then
    view.lost[#view.lost + 1] = event
  elseif fate == "kept" then
    view:note("note", "kept: " .. why.kept_text(event, who, at.prefix), { event })
  end
end

local function text_of_path(at, path)
  local texts = { location.prefix(at.prefix) .. path[1].src._fqn }
  for i, tr in ipairs(path) do texts[i + 1] = tr.tgt._fqn end
  return concat(texts, " \226\134\146 ")
end

-- Adds an entry to the log if the iteration has taken a path.
local function note_step(view, fsm, events)
  local path = view.path[fsm]
  for i = 1, view.points[1] and #events or 0 do
    check_points(view, "event", events[i])
  end
  if path then
    view:note("step", path, match.joined({}, events), view:moment())
    view.path[fsm] = nil
  end
  view:touch()
end

-- Returns a listener that notes what the machine does.
local function new_listener(view)
  return {
    taken = function(at, path)
      view.path[at.machine] = text_of_path(at, path)
      for _, tr in ipairs(path) do
        view:see_edge(view.numbers[tr])
        check_points(view, "transition", tr)
      end
    end,
    entered = function(at, state)
      local number = view.numbers[state]
      if number then view.entered[number] = (view.entered[number] or 0) + 1 end
      if view.points[1] then
        check_points(view, "state", location.path(state, at.prefix))
      end
    end,
    finished = function(at, events) note_step(view, at.machine, events) end,
    fate = function(at, ...) note_fate(view, at, ...) end,
    reset = function() view:touch() end,
  }
end

--- Observe the machine from now on, or no longer.
function LocalView:observe(is_wanted)
  if is_wanted == (self.stream ~= false) then return end
  if self.stream then self.stream:stop() end
  self.stream = is_wanted and stream.follow(self.fsm, new_listener(self))
  self.path, self.lost = {}, {}
  self:see_nodes(active_numbers(self))
  self:touch()
end

--- Stop observing; remove the hooks and printers of the view from the machine.
function LocalView:close()
  self:observe(false)
  instrument.give_back(self.changes)
end

-- The present state ----------------------------------------------------------------

-- Returns the texts of the first events in all queues, and how many more there are: a
-- moment is noted at each step, also if 10,000 events wait. With `events_of` these are
-- the events that it returns for each machine.
local function queue_texts(view, events_of)
  local texts, more = {}, 0
  for _, at in ipairs(view.machines) do
    local queue = events_of and events_of(at.machine) or at.machine._intq
    local room = min(#queue, MAX_QUEUED - #texts)
    for _, text in ipairs(view:texts_of { unpack(queue, 1, room) }) do
      texts[#texts + 1] = location.prefix(at.prefix) .. text
    end
    more = more + #queue - room
  end
  if more > 0 then texts[#texts + 1] = ("%d more"):format(more) end
  return texts
end

function LocalView:now()
  local leaf, timer = self.fsm._act_leaf, nil
  if self.has_timer then timer = clock.until_timer(self.fsm) or false end
  return {
    active = active_numbers(self), leaf = leaf and utf8(leaf._fqn) or false,
    mode = leaf and leaf._mode or "inactive", queue = queue_texts(self),
    waiting = queue_texts(self, rfsm.waiting), timer = timer,
  }
end

--- Add an entry to the log for events without an effect, once the machine is idle.
function LocalView:settle()
  if self.lost[1] == nil then return end
  self.last_lost, self.lost = self.lost, {}
  self:note("lost", "discarded", self.last_lost)
end

function LocalView:go_back(turn)
  self.lost = {}
  View.go_back(self, turn)
end

-- Questions -----------------------------------------------------------------------

--- Return a text that explains why the events in the last "lost" entry of the log take
-- no transition. Guards are called.
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
    if is_data then texts[#texts + 1] = key .. " = " .. rfsmpp.value_text(value) end
  end
  return texts
end

--- Return what is known of the state with a number; nil if no state has that number.
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

--- Answer the command `inspect` of a page. Return a problem or nil, and the answer.
function LocalView.answer_inspect(source, message)
  local about = source.view:inspect(message.node)
  return not about and "node: number of a state expected" or nil, about
end

--- Make a view of a machine. It does not observe the machine yet. `time` is a function
-- that returns the time of an entry in the log, in seconds.
function LocalView.new(fsm, time)
  local view = View.create(LocalView, marsh.model2tab(fsm, true), time)
  view.fsm, view.machines, view.numbers, view.node_of = fsm, rfsm.machines(fsm), {}, {}
  view.lost, view.last_lost, view.entered, view.path = {}, {}, {}, {}
  view.points, view.hit, view.stream, view.changes = {}, false, false, {}
  view.has_timer, view.description = false, marsh.jsontab(fsm, true)
  for _, at in ipairs(view.machines) do
    add_machine(view, at)
    count_failures(view, at.machine)
    listen_to(view, at.machine, "err", "error")
    listen_to(view, at.machine, "warn", "warning")
  end
  return view
end

return LocalView
