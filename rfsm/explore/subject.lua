--- A subject: a machine of a model whose callbacks are replaced. Exploration runs the
--- engine with it.
--
-- Each answer of a guard or predicate is a *choice*, and so is the end of a doo. A step
-- gets a list of booleans, its choices, in the order of the questions. Entries, exits
-- and effects set flags and send events (`rfsm.explore.replacements`). The clock does
-- not advance: a time event comes only if it is among the events of a step.
-- The machine, and the regions of sequential AND states, are the *parts* of a subject.
--
-- A *position* is the state of one part: its active leaf, the mode of the leaf, the
-- waiting events, and the data of extensions. Waiting events to which nothing in the
-- leaf can react are left out. A configuration has a position for each part, the flags,
-- and the values of fields. It is identified by a text, its key.
--
-- The file reads in this order: the machines, configurations, steps, public functions.
--
-- @module rfsm.explore.subject
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local alphabet_of = require("rfsm.shared.alphabet").of
local clock = require "rfsm.clock"
local data = require "rfsm.explore.data"
local instrument = require "rfsm.shared.instrument"
local kept = require "rfsm.explore.kept"
local match = require "rfsm.shared.match"
local location = require "rfsm.shared.location"
local reactions = require "rfsm.explore.reactions"
local observers = require "rfsm.explore.observers"
local order = require "rfsm.shared.order"
local static = require "rfsm.checks.static"
local replacements = require "rfsm.explore.replacements"

local error, ipairs, pcall = error, ipairs, pcall
local rawequal, setmetatable = rawequal, setmetatable
local tonumber, type = tonumber, type
local concat, insert, remove, sort =
  table.concat, table.insert, table.remove, table.sort
local max, min = math.max, math.min

local subject = {}

--- The machines of a model, and what they did in the last step.
---@class rfsm_checks.Subject
---@field parts rfsm_checks.Part[] the machine itself first
---@field transitions table[] { tr, path, part, prefix, tgt } for each transition
---@field names table<string, rfsm.State> the states of all parts, by path
---@field part_of table<string, rfsm_checks.Part> path of a state -> the part it is in
---@field paths string[] the paths of all states, in the order of the tree
---@field flags ("+"|"-")[] "+" for each flag that is on, "-" for each that is off
---@field writers string[] callbacks that may write the targets of transitions
---@field unknown string[] callbacks whose text, or that of a function they call, is not
-- known
---@field calls_unnamed boolean a callback calls what no text names
---@field shares_text boolean a callback may have the text of others in its line
---@field unsure_senders string[] callbacks that may send what is not known
---@field names_with_data table<any, true> names in predicates of `rfsm.named`
---@field classes table<string, table[]> name of an event with data -> its examples
---@field is_example table<any, true> the events in `classes`
---@field free table<string, true> the kinds of choices that the chart has: "guards",
-- "predicates", "timers", "doos"
---@field wanted table<any, boolean> event of a property -> did the last step have it?
---@field passed rfsm_checks.Moment[] entries of states that the last step left again
---@field hears table<any, true> the words that an observer hears
---@field has_observer boolean
---@field heard rfsm_checks.Moment[] the words of the last step, in the field `word`
---@field entered table<rfsm.State, boolean> states with a doo or timers that the last
-- step has entered
---@field sent { prefix: string, event: any }[] sent by replacements in the last step
---@field emitted { emit: string, data?: any }[] calls of `fsm.emit` in the last step
---@field emitters string[] callbacks that may emit events that the options do not name
---@field later rfsm_checks.Occurrence[] events that replacements send later
---@field sent_later rfsm_checks.Occurrence[] events of `later` that the last step sent
---@field dropped table<rfsm_checks.Occurrence, boolean> events of `later` that a reset
-- or a `cancel` has dropped in the last step
---@field deferred integer how many events extensions keep for later, after `read`
---@field has_senders boolean not all events come from outside: callbacks send some
---@field late_senders string[] callbacks that may send more events later
---@field cancellers string[] callbacks that may cancel events that are to be sent later
---@field called string[] names of the callbacks that the last step called, the events
-- that they sent, and their failures, as texts
---@field time rfsm.clock.Clock the clock of the machines
---@field answers table<function, any> predicate, or guard with a rule -> its answers in
-- this step
---@field notes_events boolean `last_events` gets the events of all iterations of a step
---@field choices boolean[] the choices of the last step, in the order of the questions
---@field askers string[] for each choice the path of the transition or leaf
---@field is_doo boolean[] for each choice: is it about the end of a doo?
---@field is_known boolean[] for each choice: is the opposite answer impossible?
---@field asked integer how many choices the last step had
---@field taken integer[] numbers of the transitions that the last step took
---@field unfollowed false|"data"|"targets" the last step has called callbacks that may
-- change data that callbacks in `run` use, or targets of transitions
---@field sends_late boolean the last step has called one of `late_senders`
---@field ran false|"before"|"after" the last step has called a callback in `run`, also
-- after such a callback
local Subject = {}
Subject.__index = Subject

--- One of the machines of a subject.
---@class rfsm_checks.Part
---@field fsm rfsm.Machine
---@field prefix string "root", or the name of the region: "root.arms.left"
---@field owner rfsm_checks.Part|false the part of the parent machine
---@field kept rfsm_checks.Kept|false where its kept data is; false if there is none
---@field reads_one boolean it takes one event an iteration
---@field keeps_order boolean all waiting events are kept, in their order: it takes one
-- event an iteration, or an extension may keep events in its data
---@field leaf rfsm.State|false the state of the parent machine that runs the region
---@field is_bound boolean a step may call one of its callbacks, or a guard has a rule
---@field known table<rfsm.State|false, rfsm_checks.Leaf> what is known of each
-- leaf; the key `false` is for a part that was not entered
---@field positions rfsm_checks.Position[] all positions found so far, by their `id`
---@field timed table<string, boolean> time events that come in the order of deadlines
---@field position rfsm_checks.Position the position in which the step began
---@field coming rfsm_checks.Occurrence[] what comes to a region alone in this step
---@field rounds integer how many iterations it has made in this step
---@field may_pass boolean a step may enter and leave a state of it
---@field is_single boolean a step of the subject advances it at most once. In such a
-- step, only composites can be entered and left again.

--- An event that comes to a part of a subject in a step.
---@class rfsm_checks.Occurrence
---@field part rfsm_checks.Part
---@field event any
---@field after? number seconds of delay, if a replacement sends the event later
---@field has_data boolean the event is an example of the option `classes`
---@field number integer position in the list of all occurrences
---@field is_repeated boolean of a timer that comes again: not while its event waits
---@field is_first boolean a callback has made it in a step before, such as a fault: to
-- a machine that takes one event it may come ahead of events that wait
---@field state rfsm.State|false the state whose timer it comes from
---@field alone rfsm_checks.Occurrence[] a list that has this occurrence only

--- A moment in a step: the entry of a state that the same step leaves again.
---@class rfsm_checks.Moment
---@field state rfsm.State
---@field active table<string, boolean> the paths of the states that are active then
---@field flags string a sign for each flag, "+" or "-"

--- What is known of a leaf of a part, or of a part that was not entered.
---@class rfsm_checks.Leaf
---@field state rfsm.State|false
---@field path string path of the leaf
---@field paths string[] paths of the leaf and of the states around it
---@field reactions rfsm_checks.Reactions|false false until they are asked for
---@field needs_no_event boolean a transition that needs no event may be taken in it
---@field positions table<string, rfsm_checks.Position> by a text of mode, events, data

--- The state of one part: its leaf, the mode, waiting events, data of extensions.
---@class rfsm_checks.Position
---@field id integer its number among the positions of the part
---@field leaf rfsm.State|false
---@field known rfsm_checks.Leaf what is known of the leaf
---@field mode string mode of the leaf: "active" or "done"; "inactive" without a leaf
---@field waiting any[] the events in the queue
---@field kept any[]|false data of extensions, and changed targets
---@field deferred integer how many events extensions keep for later

--- The positions of all parts. It has two more fields: `flags`, a text with a sign for
--- each flag, and `values`, the values of the fields that callbacks may set.
---@alias rfsm_checks.Configuration rfsm_checks.Position[]

local NOTHING = {}

-- The machines ....................................................................

-- Returns the next choice of the step, true by default. If `known` is given, it is the
-- only possible answer, and the opposite answer is not tried.
function Subject:choose(who, is_doo, known)
  local n = self.asked + 1
  self.asked = n
  self.askers[n], self.is_doo[n] = who, is_doo or false
  self.is_known[n] = known ~= nil
  if known ~= nil then self.choices[n] = known end
  if self.choices[n] == nil then self.choices[n] = true end
  return self.choices[n]
end

-- Makes a doo that ends if a choice is true. In the machine itself it asks for a choice
-- in the first iteration of a step only. In a region it asks in each iteration.
local function new_doo(self, part, who)
  return function()
    while true do
      if (part.owner or part.rounds == 1) and self:choose(who, true) then return end
      rfsm.yield(true)
    end
  end
end

--- Return an event as the transitions of the subject name it. All events with data of
--- one name are the same event, unless a transition names the table itself, or the
--- option `classes` has an example with the same data.
function Subject:event_of(event)
  if type(event) ~= "table" and type(event) ~= "function" then return event end
  if self.event_numbers[event] then return event end
  local name = rfsm.name_with_data(event)
  for _, other in ipairs(name and self.classes[name] or NOTHING) do
    if match.are_equal(other, event) then return other end
  end
  return match.example_of(event)
end

--- Return the event that stands for all events of its name, if an event is an example
--- of `classes`; otherwise the event.
function Subject:any_of(event)
  return self.is_example[event] and match.example_of(rfsm.named(event.name)) or event
end

--- List the events that come from outside as an event: the examples of its name in the
--- option `classes`, or else the event itself.
function Subject:examples_of(event)
  local name = not self.is_example[event] and rfsm.name_with_data(event)
  return name and self.classes[name] or { event }
end

--- Return the event that an option or property means. It may give only the name of an
--- event with data, if no transition has a text of that name.
function Subject:event_meant(event)
  local is_name = self.names_with_data[event] and not self.event_numbers[event]
  if is_name then return match.example_of(rfsm.named(event)) end
  return self:event_of(event)
end

-- Returns the number of an event; a new event gets the next number.
function Subject:number_of_event(event)
  event = self:event_of(event)
  local number = self.event_numbers[event]
  if not number then
    number = #self.event_list + 1
    self.event_list[number], self.event_numbers[event] = event, number
  end
  return number
end

--- Return the maker of an event, as `match.maker_of` does; nil if the event comes from
--- outside. An event e_done@F comes from outside, too, if F is no leaf and cannot be
--- done.
function Subject:maker_of(event)
  return match.maker_among(event, self.done)
end

-- Returns the state whose timer has an event, and whether it comes again and again.
local function timer_of(part, event)
  for _, state in ipairs(rfsm.elements(part.fsm, rfsm.is_state)) do
    for _, timer in ipairs(state._timers or NOTHING) do
      if timer.name == event then return state, timer.event.is_repeated end
    end
  end
  return false, false
end

--- Make an occurrence of an event, with the next number.
---@return rfsm_checks.Occurrence
function Subject:new_occurrence(part, event, after)
  event = self:event_of(event)
  local new = { part = part, event = event, after = after,
    has_data = self.is_example[event] or false, number = #self.occurrences + 1,
    state = false, is_repeated = false, is_first = false, alone = {} }
  if not after then new.state, new.is_repeated = timer_of(part, event) end
  local _, fqn = match.maker_of(event)
  new.is_first = part.reads_one and fqn ~= nil and not new.state
  new.alone[1], self.occurrences[new.number] = new, new
  return new
end

--- Return the occurrence of an event in a part, the same table at each call.
---@return rfsm_checks.Occurrence
function Subject:occurrence(part, event)
  event = self:event_of(event)
  part.occurrences[event] = part.occurrences[event] or self:new_occurrence(part, event)
  return part.occurrences[event]
end

-- Notes in a list which states and flags are active now.
local function note_moment(self, list, state, word)
  local active = {}
  for _, part in ipairs(self.parts) do
    local node = part.fsm._mode ~= "inactive" and part.fsm
    while node do
      active[location.path(node, part.prefix)] = true
      node = rfsm.actchild_get(node)
    end
  end
  list[#list + 1] = { state = state, word = word, active = active,
    flags = self.flags[1] and concat(self.flags) or "" }
end

local function new_replacement_of_doo(self, part, path, doo)
  local free = new_doo(self, part, path)
  if self.runs[doo] then
    part.is_bound = true
    return data.new_doo(self, path, doo, free)
  end
  self.free.doos = true
  return free
end

local function make_state(self, part, state)
  local path = location.path(state, part.prefix)
  self.names[path], self.paths[#self.paths + 1] = state, path
  self.part_of[path] = part
  local own = instrument.owner_of_callbacks(state)
  local entry = replacements.new(self, "entry", path, part, own.entry)
  own.entry = entry
  if not part.is_single or not rfsm.is_root(state) and rfsm.is_composite(state)
    and location.is_passable(state) then
    function own.entry(...)
      if entry then entry(...) end
      note_moment(self, self.passed, state)
      if self.hears.pass then note_moment(self, self.heard, state, "pass") end
    end
    part.may_pass = true
  end
  own.exit = replacements.new(self, "exit", path, part, own.exit)
  if state.doo and own == state then
    replacements.note_writer(self, "doo " .. path, state.doo)
    state.doo = replacements.marked(self, "doo " .. path, state.doo,
      new_replacement_of_doo(self, part, path, state.doo))
  end
  if state.doo or state._timers then
    rfsm.entry_hook_add(part.fsm, state, function() self.entered[state] = true end)
  end
end

local function note_events(self, tr)
  for _, event in ipairs(tr.events or {}) do
    if type(event) ~= "function" then self:number_of_event(event) end
    if match.maker_of(event) == "timer" then self.free.timers = true end
  end
end

-- Frees a transition of the guard hooks of extensions, whose data are not followed.
-- They may forbid it at any time, as a guard may that is not called.
local function free_guard_hooks(self, part, tr, path)
  local hooks = part.fsm._guard_hooks and part.fsm._guard_hooks[tr] or {}
  for _, hook in ipairs(hooks) do
    replacements.note_writer(self, "guard " .. path, hook)
    rfsm.guard_hook_rm(part.fsm, tr, hook)
  end
  if not hooks[1] then return end
  self.free.guards = true
  if not tr.guard or self.runs[tr.guard] or self.rules[tr.guard] then
    rfsm.guard_hook_add(part.fsm, tr, function() return self:choose(path) end)
  end
end

local function make_transition(self, part, tr)
  local number, path = #self.transitions + 1, location.path(tr, part.prefix)
  self.number_of[tr] = number
  self.transitions[number] = { tr = tr, path = path, prefix = part.prefix,
    part = part, tgt = tr.tgt }
  note_events(self, tr)
  free_guard_hooks(self, part, tr, path)
  if tr.guard then
    replacements.note_writer(self, "guard " .. path, tr.guard)
    if not self.runs[tr.guard] then self.free.guards = true end
    if self.runs[tr.guard] or self.rules[tr.guard] then part.is_bound = true end
    tr.guard = replacements.marked(self, "guard " .. path, tr.guard,
      data.new_guard(self, path, tr.guard))
  end
  local replacement = replacements.new(self, "effect", path, part, tr.effect)
  tr.likely = nil
  tr.effect = function(...)
    self.taken[#self.taken + 1] = number
    if replacement then replacement(...) end
  end
end

local ROUNDS = 1000 -- iterations; a step with more of them is taken to be endless

local function count_round(self, part)
  part.rounds = part.rounds + 1
  if part.rounds > ROUNDS then
    self.is_endless = true
    error("endless", 0)
  end
end

-- Notes an event that an observer hears. It comes to the machine, or is made by a
-- region that alone knows it, and not before the machine was entered.
local function note_event(self, part, event)
  local word = rfsm.name_with_data(event) or event
  local is_own = not part.owner or self:maker_of(event)
    and not alphabet_of(self.parts[1].fsm).set[event]
  if self.hears[word] and is_own then note_moment(self, self.heard, nil, word) end
end

-- Returns a step hook that counts the iterations of a step, and notes their events. An
-- event with data that a callback has sent becomes the event of its name.
local function new_hook(self, part)
  return function(_, events)
    count_round(self, part)
    for i = 1, #events do
      local event = self:event_of(events[i])
      events[i] = event
      if self.notes_events then self.last_events[#self.last_events + 1] = event end
      local is_entered = self.parts[1].position and self.parts[1].position.leaf
      if is_entered and not part.owner then replacements.switch_flags(self, event) end
      if is_entered and self.has_observer then note_event(self, part, event) end
      if self.wanted[event] ~= nil and (not part.owner or match.maker_of(event)) then
        self.wanted[event], self.wanted[self:any_of(event)] = true, true
      end
    end
  end
end

local function is_always(tr) return tr.always == true end

-- Notes the paths of a leaf and its ancestors. `leaf` is false for "not entered".
local function add_leaf(part, leaf)
  local paths = {}
  for i, node in ipairs(leaf and location.line(part.fsm, leaf) or {}) do
    paths[i] = location.path(node, part.prefix)
  end
  part.known[leaf] = { state = leaf, path = paths[#paths], paths = paths,
    reactions = false, positions = {}, needs_no_event = leaf
      and order.any(location.transitions(part.fsm, leaf), is_always) }
end

local SILENT = { "getevents", "idle_hook", "pre_step_hook", "post_step_hook", "dbg" }

-- Does each step of the subject advance this machine at most once?
local function is_single(part)
  if not part.owner then return true end
  local steps = part.leaf.step or 1
  return part.owner.is_single and not part.leaf.run and steps < 2
end

-- Does a machine take one event an iteration? Without `read` it does as its owner.
local function reads_one(part)
  local read = part.fsm.read
  return read == "one" or read ~= "all" and part.owner and part.owner.reads_one or false
end

local function clear(list)
  for i = #list, 1, -1 do list[i] = nil end
end

-- Adds the event of an occurrence to a queue.
local function come(queue, occurrence)
  local event = occurrence.event
  if occurrence.is_repeated and match.has(queue, event) then return end
  insert(queue, occurrence.is_first and 1 or #queue + 1, event)
end

local function put_coming(part, queue)
  if not part.coming[1] then return end
  for _, occurrence in ipairs(part.coming) do come(queue, occurrence) end
  clear(part.coming)
end

-- Has the events that come to a region alone come where those of timers do.
local function add_source(part)
  part.coming = {}
  if not part.owner then return end
  rfsm.source_hook_add(part.fsm, rfsm.repeatable(function(fsm)
    put_coming(part, fsm._curq)
  end))
end

-- Makes a machine a part of the subject.
local function add_part(self, part)
  local fsm = part.fsm
  part.known, part.positions, part.position = {}, {}, false
  part.is_bound, part.may_pass, part.is_single = false, false, is_single(part)
  part.reads_one = reads_one(part)
  part.kept, part.keeps_order = kept.of(fsm), part.reads_one
  part.occurrences, part.timed = {}, {}
  add_source(part)
  self.parts[#self.parts + 1] = part
  for _, name in ipairs(SILENT) do fsm[name] = nil end
  fsm.info, fsm.err, fsm.warn = false, false, false
  fsm.gettime = self.time
  rfsm.reset_hook_add(fsm, function()
    clear(part.coming)
    replacements.drop_later(self, part)
  end)
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    make_state(self, part, state)
  end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    make_transition(self, part, tr)
  end
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    for _, event in ipairs(rfsm.reactions(fsm, state)) do
      if part.kept and part.kept.hooks[1] then part.keeps_order = true end
      if type(event) ~= "function" then self:number_of_event(event) end
    end
  end
  add_leaf(part, false)
  for _, leaf in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do
    self.done["e_done@" .. leaf._fqn] = true
    add_leaf(part, leaf)
  end
  for _, state in ipairs(rfsm.elements(fsm, rfsm.can_be_done)) do
    self.done["e_done@" .. state._fqn] = true
  end
  rfsm.pre_step_hook_add(fsm, new_hook(self, part))
end

-- Configurations ..................................................................

-- Lists the waiting events to which the leaf can react, each once. If there are none,
-- and the leaf reacts to any event, the first waiting event is listed alone; also if a
-- transition needs no event, since its guard is asked again after any event. If an
-- extension may keep events for another leaf, or the machine takes one event an
-- iteration, all waiting events are listed.
local function relevant(self, part, leaf, events)
  if part.keeps_order then return match.joined({}, events) end
  local found, list = reactions.of(part, leaf), NOTHING
  for i = 1, #events do
    local event = events[i]
    local counts = found.has_predicate or found.set[self:any_of(event)]
      or self.wanted[event] ~= nil
    if counts and not match.has(list, event) then list = match.with(list, event) end
  end
  if list[1] ~= nil or not leaf then return list end
  return (found.any or part.known[leaf].needs_no_event) and { events[1] } or list
end

-- Returns a text with the numbers of the waiting events.
local function text_of_waiting(self, part, waiting)
  local numbers = {}
  for i, event in ipairs(waiting) do numbers[i] = self:number_of_event(event) end
  if not part.keeps_order then sort(numbers) end
  return concat(numbers, ",")
end

-- Returns the present position of a machine. Equal positions are the same table.
local function read_position(self, part)
  local leaf, queue, values = part.fsm._act_leaf, part.fsm._intq, false
  local known, mode = part.known[leaf], leaf and leaf._mode or "inactive"
  for i = 1, #queue do queue[i] = self:event_of(queue[i]) end
  local waiting = queue[1] ~= nil and relevant(self, part, leaf, queue) or NOTHING
  local text = mode
  if waiting[1] ~= nil then text = text .. text_of_waiting(self, part, waiting) end
  if part.kept then
    local more
    values, more = kept.read(part.kept, part.fsm, self.event_numbers)
    text = text .. ":" .. more
  end
  local position = known.positions[text]
  if not position then
    position = { id = #part.positions + 1, leaf = leaf, known = known, mode = mode,
      waiting = waiting, kept = values,
      deferred = part.kept and #rfsm.waiting(part.fsm) or 0 }
    part.positions[position.id], known.positions[text] = position, position
  end
  return position
end

--- Return the key of the current configuration: the numbers of the positions, a sign
--- for each flag, and the values of fields.
---@return string key
---@return string? problem names data that the exploration does not follow
function Subject:read()
  local parts, ids = self.parts, self.ids
  self.deferred = 0
  for i = 1, #parts do
    local position = read_position(self, parts[i])
    ids[i], self.deferred = position.id, self.deferred + position.deferred
  end
  local key = concat(ids, ",") .. concat(self.flags)
  if not self.memory then return key end
  local values, text = data.read(self)
  if not values then return key, text end
  self.values[text] = values
  return key .. "=" .. text
end

--- Return the configuration that has a key.
---@param key string
---@return rfsm_checks.Configuration conf
function Subject:configuration(key)
  local ids, flags, text = key:match("^([%d,]*)([+-]*)=?(.*)$")
  local conf = { flags = flags, values = self.values[text] or NOTHING }
  for id in ids:gmatch("%d+") do
    local i = #conf + 1
    conf[i] = self.parts[i].positions[tonumber(id)]
  end
  return conf
end

-- Puts a machine into a position. Often only the queue of the machine has to change.
local function put_position(part, position)
  local fsm, leaf, waiting = part.fsm, position.leaf, position.waiting
  local queue, mode = fsm._intq, (leaf or fsm)._mode
  part.position = position
  if rawequal(fsm._act_leaf, leaf) and mode == position.mode and not part.kept then
    for i = 1, max(#queue, #waiting) do queue[i] = waiting[i] end
  else
    rfsm.place(fsm, leaf, position.mode, match.joined({}, waiting))
    if part.kept then kept.put(part.kept, fsm, position.kept) end
  end
end

--- Put the machines into a configuration, from which a step is to start.
---@param conf rfsm_checks.Configuration
function Subject:put(conf)
  for i, part in ipairs(self.parts) do put_position(part, conf[i]) end
  for i = 1, #self.flags do self.flags[i] = conf.flags:sub(i, i) end
  data.put(self, conf.values)
end

--- List the innermost active states of a configuration.
---@param conf rfsm_checks.Configuration
---@return rfsm_checks.Leaf[] leaves
function subject.leaves(conf)
  local leaves = {}
  for _, position in ipairs(conf) do
    if position.leaf then leaves[#leaves + 1] = position.known end
  end
  return leaves
end

-- Returns the function `active` for conditions: active(name) is true if the state with
-- this path is active, or the flag with this name is on.
local function new_view(self, active, flags)
  return function(name)
    local number = self.flag_numbers[name]
    if number then return flags:sub(number, number) == "+" end
    if self.names[name] then return active[name] == true end
    location.refuse_name(name, "state or flag", match.joined(
      rfsm.sorted_keys(self.names), rfsm.sorted_keys(self.flag_numbers)))
  end
end

--- Return a function f(name): is the state or flag of that name active in `conf`?
---@param conf rfsm_checks.Configuration
---@return fun(name: string): boolean
function Subject:view(conf)
  local active = {}
  for _, leaf in ipairs(subject.leaves(conf)) do
    for _, path in ipairs(leaf.paths) do active[path] = true end
  end
  return new_view(self, active, conf.flags)
end

--- Return a function f(name): is the state or flag of that name active at `moment`?
---@param moment rfsm_checks.Moment
---@return fun(name: string): boolean
function Subject:view_of_moment(moment)
  return new_view(self, moment.active, moment.flags)
end

-- What observers hear ...............................................................

-- Has the subject note when a machine takes a transition, in the order of paths.
local function hear_paths(self, part)
  rfsm.path_hook_add(part.fsm, function(_, path)
    for _, tr in ipairs(path) do
      local word = "taken " .. self.transitions[self.number_of[tr]].path
      if self.hears[word] then note_moment(self, self.heard, nil, word) end
    end
  end)
end

--- Have the steps note the words of an observer, with what is active then. A machine
--- keeps the events among them in its queue, whatever its leaf.
---@param words any[]
function Subject:hear(words)
  for _, word in ipairs(words) do
    local kind, path = observers.element_of(word)
    local state = (kind == "entry" or kind == "exit") and self.names[path]
    if state and not self.hears[word] then
      rfsm[kind .. "_hook_add"](self.part_of[path].fsm, state, function()
        note_moment(self, self.heard, state, word)
      end)
    end
    self.hears[word] = true
  end
  for _, part in ipairs(self.has_observer and NOTHING or self.parts) do
    hear_paths(self, part)
  end
  self.has_observer = true
end

--- Has an event come in the last step, or was the word said?
function Subject:has_come(event)
  return self.wanted[event] or self.hears[event] and order.any(self.heard,
    function(each) return each.word == event end)
end

--- Return the words of the last step that an observer hears, each with a view of the
--- machine. The last one is `step`, with the given view.
---@param view fun(name: string): boolean
---@param observer? rfsm_checks.Observer
---@return rfsm_checks.Heard[]
function Subject:heard_words(view, observer)
  local list = {}
  for _, moment in ipairs(observer and self.heard or NOTHING) do
    if match.has(observer.words, moment.word) then
      list[#list + 1] = { word = moment.word, active = self:view_of_moment(moment) }
    end
  end
  list[#list + 1] = { word = "step", active = view }
  return list
end

--- Return what an observer may hear, and ask of the machine.
---@return rfsm_checks.Audible
function Subject:audible()
  local is_open = self.free.predicates or order.any(self.transitions, function(entry)
    return match.begins_on_any(entry.tr)
  end)
  local events = match.joined(self.event_list, self.alphabet or NOTHING)
  return observers.hearing(events, self.done, { states = self.paths,
    transitions = order.map(self.transitions, function(entry) return entry.path end),
    takes_any = is_open, flags = self.flag_numbers,
    active = self:view(self:configuration((self:read()))) })
end

-- Steps ...........................................................................

-- The fields with lists of what a step did. They are emptied when the next step begins.
local OF_STEP = { "taken", "passed", "heard", "last_events", "sent", "sent_later",
  "emitted", "called" }

-- Drops the moments whose states are still active at the end of the step: no state was
-- passed then. Words about other things stay.
local function keep_passed(moments)
  for i = #moments, 1, -1 do
    local moment = moments[i]
    local is_passage = not moment.word or moment.word == "pass"
    if is_passage and moment.state._mode ~= "inactive" then remove(moments, i) end
  end
end

-- Sends the events of a step. If the order decides, what comes to a region waits until
-- the region looks for time events: by then it has the events of its parent machine.
local function send(occurrences)
  for _, occurrence in ipairs(occurrences) do
    local part = occurrence.part
    if part.owner and part.keeps_order and not occurrence.is_first then
      part.coming[#part.coming + 1] = occurrence
    else
      come(part.fsm._intq, occurrence)
    end
  end
end

--- Take one step with events and with choices. After it, `read` returns the key of the
--- new configuration. The result is nil if a region never becomes idle.
---@param events rfsm_checks.Occurrence[]
---@param choices boolean[]
---@return true?
function Subject:step(events, choices)
  self.choices, self.asked, self.changed = choices, 0, nil
  self.unfollowed, self.ran, self.sends_late = false, false, false
  for i = 1, #OF_STEP do clear(self[OF_STEP[i]]) end
  if not order.is_empty(self.dropped) then self.dropped = {} end
  if not order.is_empty(self.answers) then self.answers = {} end
  if not order.is_empty(self.entered) then self.entered = {} end
  for event in order.each(self.wanted) do self.wanted[event] = false end
  for _, part in ipairs(self.parts) do part.rounds = 0 end
  send(events)
  local ok, failure = pcall(rfsm.step, self.parts[1].fsm)
  if self.is_touched then data.put_back(self) end
  if ok then
    keep_passed(self.passed)
    keep_passed(self.heard)
    for _, part in ipairs(self.parts) do -- what came to a region that did not advance
      put_coming(part, part.fsm._intq)
    end
    return true
  end
  if not self.is_endless then error(failure, 0) end
  self.is_endless = false
  for _, part in ipairs(self.parts) do rfsm.reset(part.fsm) end
end

-- Changes the list of choices to the next one to try; returns false if all were tried.
local function next_choices(self, choices)
  for i = #choices, self.asked + 1, -1 do choices[i] = nil end
  for i = self.asked, 1, -1 do
    if choices[i] and not self.is_known[i] then
      choices[i] = false
      return true
    end
    choices[i] = nil
  end
  return false
end

-- Most lists of choices of one step, and most answers in them all.
local MANY_CHOICES, MANY_ANSWERS = 4096, 100000

--- Take a step from a configuration once for each list of choices: the answers of
--- guards and predicates, and whether a doo ends. Call f(owner, has_ended) after each
--- step; `has_ended` is the result of `step`. If `f` returns true, stop.
---@param conf rfsm_checks.Configuration
---@param events rfsm_checks.Occurrence[]
---@param owner any the first argument of `f`
---@param f fun(owner: any, has_ended: true?): boolean?
---@return string? untried a text if some lists of choices were not tried, nil otherwise
function Subject:each_choice(conf, events, owner, f)
  local choices, lists, answers = {}, 0, 0
  repeat
    self:put(conf)
    local is_stopped = f(owner, self:step(events, choices))
    lists, answers = lists + 1, answers + self.asked
    if is_stopped or lists == MANY_CHOICES or answers > MANY_ANSWERS then
      return ("more than %d choices of one step"):format(lists)
    end
  until not next_choices(self, choices)
end

local MANY = 8 -- a step with more transitions or choices is shown in part

--- Return what a step did as a text: "root.trans[1], root.trans[3]".
---@param texts string[]
---@return string
function subject.listed(texts)
  local text = concat(texts, ", ", 1, min(#texts, MANY))
  return #texts > MANY and text .. " and on and on" or text
end

--- Return the outcome of a step as a text: the transitions taken and the active leaf.
---@param paths string[]
---@param leaf? string|false
---@return string text "root.trans[2] -> root.b"
function subject.outcome(paths, leaf)
  return (paths[1] and subject.listed(paths) or "no transition") .. " -> "
    .. (leaf or "not entered")
end

--- May the machine do again and again what the last step did, if the step changed
--- nothing? It may not if the step lets a doo go on, since each doo ends at some time.
function Subject:may_rest()
  for i = 1, self.asked do
    if self.is_doo[i] and not self.choices[i] then return false end
  end
  return true
end

--- May an event of a timer come once more while it waits? It may if the last step has
--- entered its state anew. A machine that takes all events loses nothing by that.
function Subject:may_come_twice()
  for _, part in ipairs(order.is_empty(self.entered) and NOTHING or self.parts) do
    for _, event in ipairs(part.reads_one and part.fsm._intq or NOTHING) do
      local own = not part.timed[event] and part.occurrences[event]
      if own and self.entered[own.state] and not own.is_repeated then return true end
    end
  end
  return false
end

--- List the paths of the transitions that the last step took.
---@return string[] paths
function Subject:paths_of()
  local paths = {}
  for i, number in ipairs(self.taken) do
    paths[i] = self.transitions[number].path
  end
  return paths
end

--- Does an event wait in the queue of the machine itself, so that `rfsm.run` goes on?
function subject.is_driven(conf) return conf[1].waiting[1] ~= nil end

--- Is the machine busy? It is if it was not entered, if the doo of its leaf goes on, or
--- if an event waits. Then a step without events from outside may change something.
function subject.is_busy(conf)
  return not conf[1].leaf or conf[1].mode ~= "done" or subject.is_driven(conf)
end

--- May a step without events from outside change something? It may if the machine is
--- busy, if a transition needs no event, or if an extension has data, such as an event
--- that it will send.
function subject.may_act(conf)
  return subject.is_busy(conf) or order.any(conf, function(position)
    return position.kept and position.kept.is_data or position.known.needs_no_event
  end)
end

-- Public functions ................................................................

-- Returns a predicate whose answer is a choice. Each event gets one answer in a step.
local function new_predicate(self, tr)
  local function predicate(event)
    local answers = self.answers[predicate] or {}
    self.answers[predicate] = answers
    if answers[event] == nil then
      local path = self.transitions[self.number_of[tr]].path
      answers[event] = self:choose(path .. " predicate")
    end
    return answers[event]
  end
  return predicate
end

-- Has a transition accept the examples of an event with data, too.
local function add_classes(self, tr, name)
  for _, event in ipairs(self.classes[name] or NOTHING) do
    if not match.has(tr.events, event) then tr.events[#tr.events + 1] = event end
  end
end

-- Makes the events of the option `classes`.
local function read_classes(self, given)
  for _, name in ipairs(rfsm.sorted_keys(given)) do
    self.classes[name] = {}
    for i, example in ipairs(given[name]) do
      self.classes[name][i] = match.event_with(name, example)
      self.is_example[self.classes[name][i]] = true
    end
  end
end

-- Raises an error if an event of the option `classes` is taken by no transition.
local function check_classes(self)
  for _, name in ipairs(rfsm.sorted_keys(self.classes)) do
    if not (self.names_with_data[name] or self.free.predicates) then
      error(("classes: no transition takes '%s' with data%s"):format(name,
        advice.nearest_name(name, rfsm.sorted_keys(self.names_with_data))), 0)
    end
  end
end

-- Replaces the predicates of transitions: those of `rfsm.named` by the event that
-- stands for all events of the name, others by functions that answer with a choice.
local function free_predicates(self, fsm)
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    for i, event in ipairs(tr.events) do
      if rfsm.event_name(event) then
        self.names_with_data[rfsm.event_name(event)] = true
        tr.events[i] = match.example_of(event)
        add_classes(self, tr, rfsm.event_name(event))
      elseif type(event) == "function" then
        local name = "predicate of " .. rfsm.location_of(tr)
        self.free.predicates = true
        replacements.note_writer(self, name, event)
        tr.events[i] = replacements.marked(self, name, event, new_predicate(self, tr))
      end
    end
  end
end

-- Makes a silent machine of a model, with its predicates replaced.
local function new_machine(self, model)
  local init = rfsm.is_initialized_root(model) and rfsm.init or static.init
  local fsm, _, problems = static.prepared(init, model, function(fsm)
    free_predicates(self, fsm)
  end)
  return fsm or error("the model has problems\n  " .. concat(problems, "\n  "), 0)
end

-- Does a property of the options name an event? An observer hears it.
local function is_heard(options, event)
  for _, property in order.each(options.properties or {}) do -- any order: one is enough
    if observers.name(property, event) then return true end
  end
  return false
end

-- Raises an error if the alphabet has an event that is in no transition, property or
-- flag. If the chart has predicates, any event is allowed, since a predicate may accept
-- it.
local function check_alphabet(self, options)
  local alphabet = not self.free.predicates and options.alphabet or {}
  for _, event in ipairs(alphabet) do
    if not (self.event_numbers[self:event_meant(event)] or self.flags_of_event[event]
      or is_heard(options, event)) then
      local text = rfsm.name_with_data(event) or event
      error(("alphabet: no transition names the event '%s'%s"):format(
        rfsm.event_text(event), type(text) == "string"
        and advice.nearest_name(text, self:named_texts()) or ""), 0)
    end
  end
end

--- List the texts, and the names of events with data, that transitions name.
---@return string[] names
function Subject:named_texts()
  local list = {}
  for _, event in ipairs(self.event_list) do
    local text = rfsm.name_with_data(event) or event
    if type(text) == "string" then list[#list + 1] = text end
  end
  return list
end

-- Removes a region from its state, so that the engine does not run it.
local function leave_out(entry)
  local _, regions = rfsm.regions(entry.state)
  for i = #regions, 1, -1 do
    if regions[i] == entry.machine then
      remove(regions, i)
      remove(regions.names, i)
    end
  end
end

-- Adds machines as parts, each before its regions. If `way` is given, it has the
-- prefixes of the machines to add. By default all are added.
local function add_parts(self, fsm, way)
  local part_of = { [false] = false }
  for _, entry in ipairs(rfsm.machines(fsm)) do
    if not way or way[entry.prefix] then
      local part = { fsm = entry.machine, prefix = entry.prefix, leaf = entry.state,
        owner = part_of[entry.owner] }
      part_of[entry.machine] = part
      add_part(self, part)
    elseif part_of[entry.owner] then
      leave_out(entry)
    end
  end
end

-- Raises an error if the options name a state, callback or event that the chart lacks.
local function check_options(self, options)
  replacements.check_flag_names(self)
  replacements.check_names(self, self.flags_of, "flags")
  replacements.check_names(self, self.sends, "sends")
  check_alphabet(self, options)
  check_classes(self)
end

--- Make a subject of a model, in the configuration before the first entry.
-- @raise if the model is not valid, or an option is wrong
---@param model rfsm.State
---@param options table `alphabet`, `flags`, `sends`, `dry_run` as in an exploration;
-- `callbacks`: call entries, exits and effects
---@param way? rfsm_checks.Way the machines that become parts; default: all
---@return rfsm_checks.Subject
function subject.new(model, options, way)
  local self = setmetatable({ parts = {}, transitions = {}, number_of = {},
    names = {}, paths = {}, part_of = {}, callbacks = {}, writers = {},
    unknown = {}, calls_unnamed = false, shares_text = false, data_writers = {},
    unsure_senders = {}, names_with_data = {}, classes = {}, is_example = {},
    free = {}, sent = {}, later = {}, sent_later = {}, dropped = {}, late_senders = {},
    cancellers = {}, deferred = 0, has_senders = false,
    emitted = {}, emitters = {}, dry_sends = {},
    runs = {},
    flags = {}, flags_of = {}, flags_of_event = {},
    flag_numbers = {}, sends = options.sends or {},
    calls_callbacks = options.callbacks, called = {},
    choices = {}, is_known = {}, askers = {}, is_doo = {}, asked = 0,
    taken = {}, passed = {}, hears = {}, heard = {}, has_observer = false,
    last_events = {}, ids = {}, entered = {}, values = {},
    occurrences = {}, event_list = {}, event_numbers = {}, wanted = {}, done = {},
    alphabet = nil, time = clock.simulated(), is_endless = false,
    notes_events = false, is_touched = false, changed = nil, unfollowed = false,
    sends_late = false, ran = false }, Subject)
  read_classes(self, options.classes or {})
  local fsm = new_machine(self, model)
  rfsm.set_emit(fsm, function(event, value)
    self.emitted[#self.emitted + 1] = { emit = event, data = value ~= nil }
  end)
  self.dry_sends = options.dry_run
    and replacements.dry_run(self, new_machine(self, model)) or {}
  replacements.read_flags(self, options.flags or {})
  data.read_options(self, options, fsm)
  self.alphabet = options.alphabet and {}
  add_parts(self, fsm, way)
  for _, event in ipairs(options.alphabet or {}) do
    self.alphabet = match.joined(self.alphabet,
      self:examples_of(self:event_meant(event)))
  end
  if not way then check_options(self, options) end
  data.check_first(self)
  return self
end

return subject
