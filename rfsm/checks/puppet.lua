--- A puppet: a machine of a model whose callbacks do nothing, and decide what they are
--- told to. Exploration runs the engine with it.
--
-- A guard is a choice, and so is whether a doo ends. Entries, exits and effects do
-- nothing but note that they ran, set flags and send events (`rfsm.checks.deeds`). The
-- machines inside of sequential AND states are puppets, too.
--
-- A configuration is where all these machines stand: for each of them the active leaf,
-- its mode, and the events that wait; and the flags. Events that nothing in the leaf
-- can react to are left out of it. Its key is a text.
--
-- The file reads in this order: the machines, configurations, steps, public functions.
--
-- @module rfsm.checks.puppet
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local alphabet = require "rfsm.shared.alphabet"
local deeds = require "rfsm.checks.deeds"
local order = require "rfsm.checks.order"
local place = require "rfsm.checks.place"
local reactions = require "rfsm.checks.reactions"
local static = require "rfsm.checks.static"

local error, ipairs, pcall = error, ipairs, pcall
local rawequal, rawget, setmetatable = rawequal, rawget, setmetatable
local tonumber, type = tonumber, type
local concat, max, sort = table.concat, math.max, table.sort
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local puppet = {}

--- The machines of a model, with what was asked of them in the last step.
---@class rfsm_checks.Puppet
---@field parts rfsm_checks.Part[] the machine itself first
---@field transitions { tr: rfsm.Transition, path: string }[] all of them
---@field names table<string, rfsm.State> states by path
---@field flags ("+"|"-")[] see `options.flags`
---@field events any[] from outside, of the last step
---@field choices boolean[] in the order in which they were asked
---@field askers string[] who asked: the path of a transition or leaf
---@field is_doo boolean[] whether that was a doo
---@field asked integer how many there were
---@field taken integer[] numbers of the transitions that the last step took
---@field clashes integer[][] of those, and one of equal pn that was enabled, too
local Puppet = {}
Puppet.__index = Puppet

--- One of the machines of a puppet.
---@class rfsm_checks.Part: rfsm_checks.Inner
---@field known table<rfsm.State|false, rfsm_checks.Leaf>
---@field stands rfsm_checks.Stand[] where it can stand
---@field ids table<string, integer> their numbers
---@field stand rfsm_checks.Stand where it was put
---@field rounds integer iterations since then

--- What is known of a leaf, or of a machine that was not entered.
---@class rfsm_checks.Leaf
---@field state rfsm.State|false
---@field number integer
---@field path string of the leaf
---@field paths string[] of the leaf and the states around it
---@field reactions rfsm_checks.Reactions|false
---@field noted table<string, table<any, rfsm_checks.Stand>> by mode and waiting event

--- Where a machine can stand.
---@class rfsm_checks.Stand
---@field id integer
---@field leaf rfsm.State|false
---@field known rfsm_checks.Leaf
---@field mode string
---@field waiting any[] events

--- Where all of them stand: a stand for each, and `flags`, a text.
---@alias rfsm_checks.Configuration rfsm_checks.Stand[]

local NOTHING = {}

-- The machines ....................................................................

-- Asks for the next of the choices that were set; the default is true.
function Puppet:choose(who, is_doo)
  local n = self.asked + 1
  self.asked = n
  self.askers[n], self.is_doo[n] = who, is_doo or false
  if self.choices[n] == nil then self.choices[n] = true end
  return self.choices[n]
end

-- A doo that ends when it is told to. Without events a step has a cycle of its own, so
-- that a cycle behind discarded ones need not ask.
local function new_doo(self, part, who)
  return function()
    while true do
      if (part.owner or part.rounds == 1) and self:choose(who, true) then return end
      rfsm.yield(true)
    end
  end
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

local function make_state(self, part, state)
  local path = place.path(state, part.prefix)
  self.names[path] = state
  local own = state._regions or state -- the callbacks of such a state are the library's
  own.entry = deeds.new(self, "entry", path, part.fsm, state, own.entry)
  own.exit = deeds.new(self, "exit", path, part.fsm, state, own.exit)
  if state.doo and not state._regions then state.doo = new_doo(self, part, path) end
  state.prepare = nil
end

local function make_transition(self, part, tr)
  local number, path = #self.transitions + 1, place.path(tr, part.prefix)
  self.transitions[number], self.number_of[tr] = { tr = tr, path = path }, number
  if tr.guard then tr.guard = function() return self:choose(path) end end
  local deed = deeds.new(self, "effect", path, part.fsm, tr, tr.effect)
  local rivals = order.rivals_of(tr)
  tr.likely = nil
  tr.effect = function(fsm, _, _, events)
    self.taken[#self.taken + 1] = number
    for _, rival in ipairs(rivals) do
      if order.is_clash(tr, rival, events) then
        self.clashes[#self.clashes + 1] = { self.number_of[rival], number }
      end
    end
    if deed then deed(fsm) end
  end
end

local ROUNDS = 1000 -- more than any step needs that ends

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
    if part.rounds > 1 or part.owner then return end
    local length = #events
    for i = 1, #self.events do events[length + i] = self.events[i] end
  end
  jit_off(hook, true)
  return hook
end

-- Notes a leaf, or false for a machine that was not entered.
local function add_leaf(part, leaf, number)
  local paths = {}
  for i, node in ipairs(leaf and place.line(part.fsm, leaf) or {}) do
    paths[i] = place.path(node, part.prefix)
  end
  part.known[leaf] = { state = leaf, number = number, path = paths[#paths],
    paths = paths, reactions = false,
    noted = { active = {}, done = {}, inactive = {} } }
end

local SILENT = { "getevents", "idle_hook", "pre_step_hook", "post_step_hook", "dbg" }

-- Makes a machine a part of the puppet.
local function add_part(self, part)
  local fsm = part.fsm
  part.known, part.stands, part.ids, part.stand = {}, {}, {}, false
  part.rounds = 0
  self.parts[#self.parts + 1] = part
  for _, name in ipairs(SILENT) do fsm[name] = nil end
  fsm.info, fsm.err, fsm.warn = false, false, false
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    make_state(self, part, state)
  end
  for _, event in ipairs(alphabet.of(fsm).list) do self:number_of_event(event) end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    make_transition(self, part, tr)
  end
  add_leaf(part, false, 0)
  for i, leaf in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do add_leaf(part, leaf, i) end
  rfsm.pre_step_hook_add(fsm, new_hook(self, part))
end

-- Configurations ..................................................................

-- Leaves out what has no effect in the leaf, and what is there twice. Of events that
-- count only as any event at all, one is kept if there is no other.
local function relevant(part, leaf, events)
  local found, kept, is_kept = reactions.of(part, leaf), {}, {}
  for i = 1, #events do
    local event = events[i]
    if (found.has_predicate or found.set[event]) and not is_kept[event] then
      kept[#kept + 1], is_kept[event] = event, true
    end
  end
  if leaf and found.any and kept[1] == nil then kept[1] = events[1] end
  return kept
end

-- Returns the place where a machine stands, with the events that wait: always the same
-- table.
local function find_stand(self, part, leaf, mode, events)
  local waiting, numbers = relevant(part, leaf, events), {}
  for i, event in ipairs(waiting) do numbers[i] = self:number_of_event(event) end
  sort(numbers)
  local known = part.known[leaf]
  local key = known.number .. mode .. concat(numbers, ",")
  local id = part.ids[key] or #part.stands + 1
  part.ids[key] = id
  part.stands[id] = part.stands[id]
    or { id = id, leaf = leaf, known = known, mode = mode, waiting = waiting }
  return part.stands[id]
end

-- Returns where a machine stands; with one event at most, the usual case, it is noted.
local function read_stand(self, part)
  local leaf, queue = part.fsm._act_leaf, part.fsm._intq
  local mode = leaf and leaf._mode or "inactive"
  if queue[2] ~= nil then return find_stand(self, part, leaf, mode, queue) end
  local noted, first = part.known[leaf].noted[mode], queue[1]
  if first == nil then first = NOTHING end
  noted[first] = noted[first] or find_stand(self, part, leaf, mode, queue)
  return noted[first]
end

--- Return the key of the configuration in which the machines are: the numbers of their
--- stands, and a sign for each flag.
---@return string key
function Puppet:read()
  local parts, ids = self.parts, self.ids
  for i = 1, #parts do ids[i] = read_stand(self, parts[i]).id end
  return concat(ids, ",") .. concat(self.flags)
end

--- Return the configuration with a key.
---@param key string
---@return rfsm_checks.Configuration conf
function Puppet:configuration(key)
  local conf = { flags = key:match("[+-]*$") }
  for id in key:gmatch("%d+") do
    local i = #conf + 1
    conf[i] = self.parts[i].stands[tonumber(id)]
  end
  return conf
end

-- Puts a machine where it is to stand. It often is there, but for the queue.
local function put_stand(part, stand)
  local fsm, leaf, waiting = part.fsm, stand.leaf, stand.waiting
  local queue, mode = fsm._intq, (leaf or fsm)._mode
  part.stand, part.rounds = stand, 0
  if rawequal(fsm._act_leaf, leaf) and mode == stand.mode then
    for i = 1, max(#queue, #waiting) do queue[i] = waiting[i] end
  else
    rfsm.place(fsm, leaf, stand.mode, { unpack(waiting) })
  end
end

--- Have the machines stand in a configuration.
---@param conf rfsm_checks.Configuration
function Puppet:put(conf)
  for i = 1, #self.parts do put_stand(self.parts[i], conf[i]) end
  for i = 1, #self.flags do self.flags[i] = conf.flags:sub(i, i) end
end

--- List the innermost active states of a configuration.
---@param conf rfsm_checks.Configuration
---@return rfsm_checks.Leaf[] leaves
function puppet.leaves(conf)
  local leaves = {}
  for _, stand in ipairs(conf) do
    if stand.leaf then leaves[#leaves + 1] = stand.known end
  end
  return leaves
end

--- Return a function that tells of a path or flag if it is active in a configuration.
---@param conf rfsm_checks.Configuration
---@return fun(name: string): boolean
function Puppet:view(conf)
  local active = {}
  for _, leaf in ipairs(puppet.leaves(conf)) do
    for _, path in ipairs(leaf.paths) do active[path] = true end
  end
  return function(name)
    local number = self.flag_numbers[name]
    if number then return conf.flags:sub(number, number) == "+" end
    if self.names[name] then return active[name] == true end
    local names = rfsm.sorted_keys(self.names)
    for _, flag in ipairs(rfsm.sorted_keys(self.flag_numbers)) do
      names[#names + 1] = flag
    end
    error(("no state or flag is named '%s'%s"):format(rfsm.text_of(name),
      type(name) == "string" and advice.nearest_name(name, names) or ""), 0)
  end
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

--- Return the outcome of a step as a text: the transitions taken, and the active leaf.
---@param paths string[]
---@param leaf? string|false
---@return string text "root.trans[2] -> root.b"
function puppet.outcome(paths, leaf)
  return (paths[1] and concat(paths, ", ") or "no transition") .. " -> "
    .. (leaf or "not entered")
end

--- List the paths of transitions by their numbers, such as those taken.
---@param numbers? integer[] default: those that the last step took
---@return string[] paths
function Puppet:paths_of(numbers)
  local paths = {}
  for i, number in ipairs(numbers or self.taken) do
    paths[i] = self.transitions[number].path
  end
  return paths
end

--- Is there an event that waits, so that run would go on?
function puppet.is_driven(conf) return conf[1].waiting[1] ~= nil end

--- Does a step without events from outside lead anywhere? Not if nothing waits, and no
--- doo is there.
function puppet.is_busy(conf)
  return not conf[1].leaf or conf[1].mode ~= "done" or puppet.is_driven(conf)
end

-- Public functions ................................................................

--- Make a puppet of a model, in the configuration before the first entry.
-- @raise if the model is not valid, or an option is wrong
---@param model rfsm.State
---@param options { alphabet?: any[], flags?: table, sends?: table, dry_run?: boolean }
---@return rfsm_checks.Puppet
function puppet.new(model, options)
  local is_machine = rfsm.is_initialized_root(model)
  local fsm, _, problems = (is_machine and rfsm.init or static.init)(model, false)
  if not fsm then error("the model has problems\n  " .. concat(problems, "\n  "), 0) end
  local self = setmetatable({ parts = {}, transitions = {}, number_of = {}, names = {},
    deeds = {}, flags = {}, flags_of = {}, flag_numbers = {},
    sends = options.sends or {}, is_dry_run = options.dry_run, events = {},
    choices = {}, askers = {}, is_doo = {}, asked = 0, taken = {}, clashes = {},
    ids = {}, event_list = {}, event_numbers = {}, alphabet = options.alphabet,
    all_events = false, is_endless = false }, Puppet)
  deeds.read_flags(self, options.flags or {})
  for _, part in ipairs(place.machines(fsm)) do add_part(self, part) end
  deeds.check(self, self.flags_of, "flags")
  deeds.check(self, self.sends, "sends")
  self.all_events = options.alphabet or { unpack(self.event_list) }
  return self
end

return puppet
