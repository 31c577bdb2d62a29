--- A puppet: a machine of a model whose callbacks do nothing, and decide what they are
--- told to. Exploration runs the engine with it.
--
-- A guard is a choice, and so is whether a doo ends. Entries, exits and effects do
-- nothing but note that they ran, set flags and send the events that `options.sends`
-- has for them. The machines inside of sequential AND states are puppets, too.
--
-- Where all these machines stand is a configuration: for each of them the active leaf,
-- its mode, and the events that wait; and the flags. Events that nothing in the leaf
-- can react to are left out of it.
--
-- The file reads in this order: the machines, configurations, steps, public functions.
--
-- @module rfsm.checks.puppet
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local deeds = require "rfsm.checks.deeds"
local place = require "rfsm.checks.place"
local reactions = require "rfsm.checks.reactions"
local static = require "rfsm.checks.static"

local error, ipairs, pairs, pcall = error, ipairs, pairs, pcall
local rawequal, rawget, setmetatable = rawequal, rawget, setmetatable
local tonumber, type = tonumber, type
local concat, sort = table.concat, table.sort

local puppet = {}

--- The machines of a model, with what was asked of them in the last step.
---@class rfsm_checks.Puppet
---@field parts rfsm_checks.Part[] the machine itself first
---@field transitions table[] all of them: `path`, `location`, `part`, `tr`
---@field names table<string, table> states by path
---@field flags boolean[] see `options.flags`
---@field events any[] from outside, of the last step
---@field choices boolean[] in the order in which they were asked
---@field askers string[] who asked: the path of a transition or leaf
---@field is_doo boolean[] whether that was a doo
---@field asked integer how many there were
---@field taken integer[] numbers of the transitions that the last step took
---@field clashes string[] FQNs of connectors with several ways on
local Puppet = {}
Puppet.__index = Puppet

--- One of the machines of a puppet.
---@class rfsm_checks.Part
---@field fsm rfsm.Machine
---@field prefix string|nil path of the region: "root.par.left"; nil for the root
---@field known table<rfsm.State|false, table> what is known of a leaf
---@field owner? rfsm_checks.Part of a region
---@field owner_leaf? rfsm.State
---@field stands rfsm_checks.Stand[] where it can stand
---@field ids table<string, integer> their numbers
---@field stand rfsm_checks.Stand where it was put
---@field stale integer how many events in its queue are none of the configuration's
---@field is_read boolean its queue holds what waits, and nothing else
---@field rounds integer iterations since it was put there

--- Where a machine can stand.
---@class rfsm_checks.Stand
---@field id integer
---@field leaf rfsm.State|false
---@field mode string
---@field waiting any[] events

-- Stands for each event that nothing names.
local OTHER = setmetatable({}, { __tostring = function() return "(another event)" end })
puppet.OTHER = OTHER

-- The machines ....................................................................

-- Asks for the next of the choices that were set; the default is true.
function Puppet:choose(who, is_doo)
  local n = self.asked + 1
  self.asked = n
  self.askers[n], self.is_doo[n] = who, is_doo or false
  if self.choices[n] == nil then self.choices[n] = true end
  return self.choices[n]
end

local function new_guard(self, who)
  return function() return self:choose(who) end
end

-- A doo that ends when it is told to. Without events a step has a cycle of its own, so
-- that a cycle behind discarded ones need not ask.
local function new_doo(self, part, who)
  return function()
    while true do
      if (part.prefix or part.rounds == 1) and self:choose(who, true) then return end
      rfsm.yield(true)
    end
  end
end

local function make_state(self, part, state)
  local path = place.path(state, part.prefix)
  self.names[path] = state
  local regions = state._seqand
  local target = regions or state -- the callbacks of such a state are the library's
  target.entry = deeds.new(self, "entry", path) or nil
  target.exit = deeds.new(self, "exit", path) or nil
  if state.doo and not regions then state.doo = new_doo(self, part, path) end
  state.prepare = nil
end

local function make_transition(self, part, tr)
  local number, path = #self.transitions + 1, place.path(tr, part.prefix)
  self.transitions[number] = { tr = tr, part = part, path = path,
    location = rfsm.location_of(tr) }
  if tr.guard then tr.guard = new_guard(self, path) end
  local effect = deeds.new(self, "effect", path)
  tr.likely = nil
  tr.effect = function(fsm)
    self.taken[#self.taken + 1] = number
    if effect then effect(fsm) end
  end
end

local ROUNDS = 1000 -- more than any step needs that ends

-- Copies events[first] and those behind it to `to`; as table.move, which old Luas lack.
local function move(events, first, last, to)
  local from, past, step = first, last, 1
  if to > first then from, past, step = last, first, -1 end
  for i = from, past, step do events[i - first + to] = events[i] end
end

-- Replaces what an iteration has got: what was in the queue before by what waits in the
-- configuration. Those that the parent machine has sent stay. Returns the length.
local function put_events(part, events)
  local waiting, length, stale = part.stand.waiting, #events, part.stale
  local count = #waiting
  if count ~= stale then move(events, stale + 1, length, count + 1) end
  for i = 1, count do events[i] = waiting[i] end
  for i = length, count + length - stale + 1, -1 do events[i] = nil end
  part.stale, part.is_read = 0, true
  return count + length - stale
end

local function count_round(self, part)
  part.rounds = part.rounds + 1
  if part.rounds > ROUNDS then
    self.is_endless = true
    error("endless", 0)
  end
end

local jit_off = (rawget(_G, "jit") or {}).off or function() end

-- The first iteration of the machine itself gets the events of the step, too. A trace
-- of LuaJIT 2.1.0-beta3 with this in it may go on with the list as it was before.
local function new_hook(self, part)
  local function hook(_, events)
    count_round(self, part)
    local length = part.is_read and #events or put_events(part, events)
    if part.rounds > 1 or part.prefix then return end
    for i = 1, #self.events do events[length + i] = self.events[i] end
  end
  jit_off(hook, true)
  return hook
end

local HOOKS = { "getevents", "idle_hook", "pre_step_hook", "post_step_hook", "dbg" }

local function note_warning(self)
  return function(text)
    local fqn = rfsm.text_of(text):match("^conflicting transitions from src (.*) to$")
    if fqn then self.clashes[#self.clashes + 1] = fqn end
  end
end

local function new_part(fsm, owner, owner_leaf, prefix)
  return { fsm = fsm, prefix = prefix, owner = owner, owner_leaf = owner_leaf,
    known = {}, stands = {}, ids = {}, stand = false, stale = 0, is_read = true,
    rounds = 0 }
end

local function new_known(number)
  return { number = number, reactions = false, sets = false, active = {}, done = {},
    inactive = {} }
end

-- Makes a machine a part of the puppet, and then those inside of it.
local function add_part(self, part)
  local fsm = part.fsm
  self.parts[#self.parts + 1] = part
  for _, name in ipairs(HOOKS) do fsm[name] = nil end
  fsm.info, fsm.err, fsm.warn = false, false, note_warning(self)
  rfsm.pre_step_hook_add(fsm, new_hook(self, part))
  rfsm.reset_hook_add(fsm, function() part.stale, part.is_read = 0, true end)
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    make_state(self, part, state)
  end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    make_transition(self, part, tr)
  end
  part.known[false] = new_known(0)
  for i, leaf in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do
    part.known[leaf] = new_known(i)
    for _, region in ipairs(place.regions_of(leaf)) do
      local prefix = place.path(leaf, part.prefix) .. "." .. region.name
      add_part(self, new_part(region.machine, part, leaf, prefix))
    end
  end
end

-- Configurations ..................................................................

-- Leaves out what has no effect in the leaf, and what is there twice. Of events that
-- count only as any event at all, one is kept if there is no other.
local function relevant(part, leaf, events)
  local known, kept, is_kept = reactions.of(part, leaf), {}, {}
  for i = 1, #events do
    local event = events[i]
    if (known.has_predicate or known.set[event]) and not is_kept[event] then
      kept[#kept + 1], is_kept[event] = event, true
    end
  end
  if leaf and known.any and kept[1] == nil then kept[1] = events[1] end
  return kept
end

-- A number for each event there is.
function Puppet:number_of_event(event)
  local number = self.event_numbers[event]
  if not number then
    number = #self.event_list + 1
    self.event_list[number], self.event_numbers[event] = event, number
  end
  return number
end

-- Returns the place where a machine stands, with the events that wait: always the same
-- table.
local function find_stand(self, part, leaf, mode, events)
  local waiting, numbers = relevant(part, leaf, events), {}
  for i, event in ipairs(waiting) do numbers[i] = self:number_of_event(event) end
  sort(numbers)
  local key = part.known[leaf].number .. mode .. concat(numbers, ",")
  local id = part.ids[key]
  if not id then
    id = #part.stands + 1
    part.ids[key] = id
    part.stands[id] = { id = id, leaf = leaf, mode = mode, waiting = waiting }
  end
  return part.stands[id]
end

local NOTHING = {}

-- Returns what waits for a machine in its queue, or still in its configuration.
local function waiting_of(part)
  local events, first = {}, 1
  if not part.is_read then
    for i = 1, #part.stand.waiting do events[i] = part.stand.waiting[i] end
    first = part.stale + 1
  end
  local queue = part.fsm._intq
  for i = first, #queue do events[#events + 1] = queue[i] end
  return events
end

-- Returns where a machine stands; with one event at most, the usual case, it is noted.
local function read_stand(self, part)
  local leaf, queue = part.fsm._act_leaf, part.fsm._intq
  local mode = leaf and leaf._mode or "inactive"
  if not part.is_read or queue[2] ~= nil then
    return find_stand(self, part, leaf, mode, waiting_of(part))
  end
  local noted, first = part.known[leaf][mode], queue[1]
  if first == nil then first = NOTHING end
  noted[first] = noted[first] or find_stand(self, part, leaf, mode, queue)
  return noted[first]
end

local function put_stand(part, stand)
  local fsm, leaf = part.fsm, stand.leaf
  if not leaf then
    if fsm._mode ~= "inactive" or fsm._intq[2] ~= nil then rfsm.reset(fsm) end
  elseif not rawequal(fsm._act_leaf, leaf) or leaf._mode ~= stand.mode then
    rfsm.set_sta_mode(leaf, stand.mode)
  end
  part.stand, part.stale, part.rounds = stand, #fsm._intq, 0
  part.is_read = false
end

local function flags_id(self)
  local id = 0
  for i = 1, #self.flags do id = id * 2 + (self.flags[i] and 1 or 0) end
  return id
end

--- Return the key of the configuration in which the machines are: a number if there is
--- one machine and no flag, a text otherwise.
function Puppet:read()
  local parts, ids = self.parts, self.ids
  for i = 1, #parts do ids[i] = read_stand(self, parts[i]).id end
  if self.has_flags then ids[#parts + 1] = flags_id(self) end
  return ids[2] and concat(ids, ",") or ids[1]
end

-- Puts the flags as a number has them, each a digit of two.
local function put_flags(self, id)
  for i = #self.flags, 1, -1 do
    self.flags[i] = id % 2 == 1
    id = (id - id % 2) / 2
  end
end

--- Split a key into the numbers that `put` wants.
function Puppet.numbers_of(_, key, numbers)
  if type(key) == "number" then
    numbers[1] = key
    return numbers
  end
  local n = 0
  for digits in key:gmatch("%d+") do
    n = n + 1
    numbers[n] = tonumber(digits)
  end
  return numbers
end

--- Have the machines stand in a configuration.
---@param numbers integer[]
function Puppet:put(numbers)
  local parts = self.parts
  for i = 1, #parts do put_stand(parts[i], parts[i].stands[numbers[i]]) end
  if self.has_flags then put_flags(self, numbers[#parts + 1]) end
end

-- Steps ...........................................................................

--- Take one step with events from outside and with choices; where that leads to tells
--- `read`. Returns nil if a machine inside never becomes idle.
function Puppet:step(events, choices)
  self.events, self.choices, self.asked = events, choices, 0
  for i = #self.taken, 1, -1 do self.taken[i] = nil end
  for i = #self.clashes, 1, -1 do self.clashes[i] = nil end
  local ok, failure = pcall(rfsm.step, self.parts[1].fsm)
  if ok then return true end
  if not self.is_endless then error(failure, 0) end
  self.is_endless = false
  for _, part in ipairs(self.parts) do rfsm.reset(part.fsm) end
end

--- Set the next choices to try; false if all were tried.
function puppet.next_choices(choices, asked)
  for i = #choices, asked + 1, -1 do choices[i] = nil end
  for i = asked, 1, -1 do
    if choices[i] then
      choices[i] = false
      return true
    end
    choices[i] = nil
  end
  return false
end

--- Does a step without events from outside lead anywhere? Not if nothing waits, and no
--- doo is there.
function Puppet:is_busy(numbers)
  local stand = self.parts[1].stands[numbers[1]]
  return not stand.leaf or stand.mode ~= "done" or stand.waiting[1] ~= nil
end

--- Is there an event that waits, so that run would go on?
function Puppet:is_driven(numbers)
  return self.parts[1].stands[numbers[1]].waiting[1] ~= nil
end

local function is_internal(event)
  return type(event) == "string"
    and (event == "e_init_fsm" or event:find("^e_done@root") ~= nil)
end

-- Appends the events from outside that can have an effect in a stand.
local function add_outside(self, list, is_listed, known)
  local function add(event)
    if is_listed[event] or is_internal(event) then return end
    if self.alphabet and not self.alphabet[event] then return end
    is_listed[event], list[#list + 1] = true, event
  end
  for _, event in ipairs(known) do add(event) end
  if known.has_predicate or known.any and self.alphabet then
    for _, event in ipairs(self.all_events) do add(event) end
  end
  if known.any then add(OTHER) end
end

-- Returns the events of a set that come from outside; none if one of them cannot come.
local function outside_of(self, set)
  local kept = {}
  for i = 1, #set do
    local event = set[i]
    if self.alphabet and not self.alphabet[event] and not is_internal(event) then
      return {}
    end
    if not is_internal(event) then kept[#kept + 1] = event end
  end
  return kept
end

--- List the events from outside that can have an effect in a configuration, and the
--- sets of several of them that a path through connectors needs.
---@return any[] events
---@return any[][] sets
function Puppet:events_in(numbers)
  local list, sets, is_listed, leaf_of = {}, {}, {}, {}
  for i, part in ipairs(self.parts) do
    local leaf = part.stands[numbers[i]].leaf
    leaf_of[part] = leaf
    if not part.owner or leaf_of[part.owner] == part.owner_leaf then
      add_outside(self, list, is_listed, reactions.of(part, leaf))
      for _, set in ipairs(reactions.sets_of(part, leaf)) do
        local kept = outside_of(self, set)
        if kept[2] ~= nil then sets[#sets + 1] = kept end
      end
    end
  end
  return list, sets
end

-- Public functions ................................................................

local function list_events(self)
  local list, is_listed = {}, {}
  for _, entry in ipairs(self.transitions) do
    for _, event in ipairs(entry.tr.events or {}) do
      if type(event) ~= "function" and not is_listed[event] then
        is_listed[event], list[#list + 1] = true, event
      end
    end
  end
  return list
end

local function set_of(list)
  local set = {}
  for _, value in ipairs(list) do set[value] = true end
  return set
end

--- Make a puppet of a model.
-- @raise if the model is not valid, or an option is wrong
---@param model rfsm.State
---@param options { alphabet?: any[], flags?: table, sends?: table }
---@return rfsm_checks.Puppet
function puppet.new(model, options)
  local fsm, problems
  if rfsm.is_initialized_root(model) then
    fsm, problems = rfsm.init(model)
  else
    fsm, problems = static.init(model, false)
  end
  if not fsm then error("the model has problems\n  " .. concat(problems, "\n  "), 0) end
  local self = setmetatable({ parts = {}, transitions = {}, names = {}, deeds = {},
    flags = {}, flags_of = {}, flag_numbers = {}, has_flags = false,
    sends = options.sends or {}, events = {}, choices = {}, askers = {}, is_doo = {},
    asked = 0,
    taken = {}, clashes = {}, ids = {}, event_list = {}, event_numbers = {},
    alphabet = options.alphabet and set_of(options.alphabet), is_endless = false,
    all_events = false }, Puppet)
  deeds.read_flags(self, options.flags or {})
  add_part(self, new_part(fsm))
  deeds.check(self, self.flags_of, "flags")
  deeds.check(self, self.sends, "sends")
  self.all_events = options.alphabet or list_events(self)
  return self
end

--- Return the numbers of the configuration before the first entry.
---@return integer[] numbers
function Puppet:first()
  local numbers = {}
  for i, part in ipairs(self.parts) do
    numbers[i] = find_stand(self, part, false, "inactive", { "e_init_fsm" }).id
  end
  if self.has_flags then numbers[#numbers + 1] = 0 end
  return numbers
end

--- Return the key of numbers, as `read` does.
function Puppet.key_of(_, numbers)
  return numbers[2] and concat(numbers, ",") or numbers[1]
end

--- Return a function that tells of a path or flag if it is active in a configuration.
---@return fun(name: string): boolean
function Puppet:view(numbers)
  local active = {}
  for i, part in ipairs(self.parts) do
    local node = part.stands[numbers[i]].leaf
    while node do
      active[place.path(node, part.prefix)] = true
      node = node ~= part.fsm and node._parent
    end
  end
  local flags = numbers[#self.parts + 1] or 0
  for number = #self.flags, 1, -1 do
    active[number] = flags % 2 == 1
    flags = (flags - flags % 2) / 2
  end
  return function(name)
    local number = self.flag_numbers[name]
    if number then return active[number] end
    if self.names[name] then return active[name] == true end
    local names = {}
    for path in pairs(self.names) do names[#names + 1] = path end -- any order: sorted
    for flag in pairs(self.flag_numbers) do names[#names + 1] = flag end -- likewise
    sort(names)
    error(("no state or flag is named '%s'%s"):format(rfsm.text_of(name),
      type(name) == "string" and advice.nearest_name(name, names) or ""), 0)
  end
end

return puppet
