--- The view of a machine in this program, and of the machines inside its states.
--
-- It watches them through their hooks and printers, which go on as before.
--
-- The file reads in this order: the machines, their hooks, the state of now.
--
-- @module rfsm.web.live
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local calls = require "rfsm.shared.calls"
local marsh = require "rfsm.marsh"
local outline = require "rfsm.web.outline"
local place = require "rfsm.checks.place"
local View = require "rfsm.web.view"

local ipairs, rawget = ipairs, rawget
local setmetatable, tostring = setmetatable, tostring
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local text_of, utf8 = rfsm.text_of, marsh.utf8

--- A machine that is watched.
---@class rfsm.web.Live : rfsm.web.View
---@field fsm rfsm.Machine
---@field machines rfsm.web.Watched[]
---@field lost any[] events that took no transition since the last one that did
local Live = setmetatable({}, { __index = View })
Live.__index = Live

-- The machines: that of the view, and those inside its states -----------------------

-- Returns the numbers of a machine's transitions by their texts.
local function edges_by_text(view, machine, prefix)
  local by_text = {}
  for _, tr in ipairs(rfsm.elements(machine, rfsm.is_trans)) do
    local text = tostring(tr)
    by_text[text] = by_text[text] or view.outline.edge_of[place.path(tr, prefix)]
  end
  return by_text
end

-- Notes the file and line of each node.
local function add_places(view, machine, prefix)
  for _, node in ipairs(rfsm.elements(machine, rfsm.is_node)) do
    local number = view.outline.number_of[place.path(node, prefix)]
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
      add_machine(view, region.machine, place.path(state, prefix) .. "." .. region.name)
    end
  end
end

-- Their hooks -----------------------------------------------------------------------

-- The meaning of the records of a trace for the page.
local RECORDS = {}

function RECORDS.EXEC_PATH(_, watched, text)
  text = text_of(text):gsub("%[%w+%]", ""):gsub("%->", " \226\134\146 ")
  watched.path = (watched.prefix == "root" and "" or watched.prefix .. ": ") .. text
end

function RECORDS.EFFECT(view, watched, text) view:see_edge(watched.edges[text]) end

-- Calls f(number) for each active state of a machine, from its root on.
local function each_active(view, watched, f)
  local node = rfsm.get_sta_mode(watched.fsm) ~= "inactive" and watched.fsm
  while node do
    local number = view.outline.number_of[place.path(node, watched.prefix)]
    if number then f(number) end -- none, if it was merged in
    node = rfsm.actchild_get(node)
  end
end

-- Has a printer of a machine call `note`, too.
local function listen(machine, name, note)
  local own = machine[name]
  machine[name] = function(...)
    note(...)
    if rfsm.is_callable(own) then return own(...) end
  end
end

-- Returns what a printer was called with, without the id of the record.
local function line_of(...)
  return (calls.text(" ", ...):gsub("^%u+:? ", ""):gsub(":  ", ": "))
end

-- Nobody asks why an event that the machine sends itself did nothing.
local function add_lost(view, events)
  for i = 1, #events do
    if not outline.is_own(events[i]) then view.lost[#view.lost + 1] = events[i] end
  end
end

-- Notes an iteration; one without events that took no transition is none.
local function note_step(view, watched, events)
  each_active(view, watched, function(number) view:see_node(number) end)
  if watched.path then
    view:note("step", watched.path, view:texts_of(events))
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
  listen(fsm, "warn", function(...) view:note("warning", line_of(...)) end)
  rfsm.post_step_hook_add(fsm, function(_, events)
    note_step(view, watched, events)
  end, "before") -- one of the user's may fail
  rfsm.reset_hook_add(fsm, function() view.is_dirty = true end)
end

-- The state of now -----------------------------------------------------------------

-- Numbers of the active states, from the root down, those of regions behind.
local function active_numbers(view)
  local numbers = {}
  for _, watched in ipairs(view.machines) do
    each_active(view, watched, function(number) numbers[#numbers + 1] = number end)
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

local function queue_texts(view)
  local texts = {}
  for i, watched in ipairs(view.machines) do
    for _, text in ipairs(view:texts_of(watched.fsm._intq)) do
      texts[#texts + 1] = i == 1 and text or watched.prefix .. ": " .. text
    end
  end
  return texts
end

---@return rfsm.web.Now now
function Live:now()
  local leaf = self.fsm._act_leaf
  local enabled, any = enabled_numbers(self)
  return {
    active = active_numbers(self), leaf = leaf and utf8(leaf._fqn) or false,
    mode = leaf and leaf._mode or "inactive", queue = queue_texts(self),
    enabled = enabled, any = any,
  }
end

--- Say why events that took no transition did not, once the machine is idle.
function Live:settle()
  if not self.lost[1] then return end
  local lost = self.lost
  self.lost = {}
  local _, text = rfsm_checks.why(self.fsm, unpack(lost))
  self:note("lost", "no transition", self:texts_of(lost))
  self.why = utf8(text)
end

function Live:go_back(turn)
  self.lost = {}
  View.go_back(self, turn)
end

--- Watch a machine.
---@param fsm rfsm.Machine
---@param clock fun(): number seconds, for the log
---@return rfsm.web.Live view
function Live.new(fsm, clock)
  local view = View.create(Live, marsh.model2tab(fsm, true), clock)
  view.fsm, view.machines, view.lost = fsm, {}, {}
  add_machine(view, fsm, "root")
  return view
end

return Live
