--- Products: the configurations that the machines of a system reach together.
--
-- In a move, a machine reads its wires. Then it takes one step with the events that it
-- has read and at most one event from outside, and puts the first event that the step
-- emits into its wire. Each further one is a move of its own, and before that the
-- machine does nothing else. Any machine may move at any time. A machine that takes one
-- event an iteration gets one: from any of its wires, or from outside; and none while
-- one waits. But an event of a timer may come in each move.
--
-- If moves may cross, the first put may be a move of its own, too. A machine that reads
-- no wire needs no such move: it could as well take its step later.
--
-- Each machine has a walk (`rfsm.explore.explore`), which takes equal steps only once.
-- The outcomes are kept by the configuration of the machine and the list of what it has
-- read.
--
-- A product also has the fields of a walk that graphs and properties read.
--
-- @module rfsm.system.product
-- @license BSD-3-Clause

local explore = require "rfsm.explore.explore"
local liveness = require "rfsm.system.liveness"
local location = require "rfsm.shared.location"
local match = require "rfsm.shared.match"
local order = require "rfsm.shared.order"
local properties = require "rfsm.explore.properties"
local rfsm = require "rfsm"
local subject = require "rfsm.explore.subject"
local wires = require "rfsm.system.wires"

local error, ipairs, pcall, rawget = error, ipairs, pcall, rawget
local setmetatable, tonumber, type = setmetatable, tonumber, type
local concat = table.concat
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local product = {}

--- A walk over the configurations of several machines.
---@class rfsm.system.Product
---@field members rfsm.system.Member[]
---@field wires rfsm.system.Wire[] wires between the members
---@field keys table[] configurations: `numbers` has the configuration of each machine,
-- `queues` the queue of each wire, `unsent` for each machine what it has yet to put
---@field kept table<string, table> these parts of configurations by their texts
---@field numbers table<string, integer> number of a configuration by its text
---@field labels string[] by configuration, the move that first led to it: "2:1:7" is
-- outcome 7 of what member 2 may read first; "2:1:7 holds": nothing is put yet
---@field steps integer[] targets of moves; negative: without an event from outside
---@field movers integer[] by index of `steps`, the number of the member that moved; if
-- it has read one wire of several, the number of members and the position of the wire
---@field lost table<rfsm.system.Wire, table> the first move that loses the wire's event
---@field carries table<rfsm.system.Wire, table> for each wire the set of events that go
-- over it
---@field is_partial boolean some steps of a machine were not tried
---@field overlap boolean moves may cross
local Product = { note_untried = explore.note_untried,
  must_reach = liveness.must_reach }
Product.__index = Product

--- A machine of a product: its walk, and fields that the product needs.
---@class rfsm.system.Member: rfsm_checks.Walk
---@field name string
---@field number integer
---@field confs rfsm_checks.Configuration[] configurations of this machine alone
---@field moves table<integer, table> outcomes by configuration, then by events read
---@field wired table<string, boolean> events of wires; true: they come only by wires
---@field takes table<string, true> events that transitions have taken
---@field outgoing table<string, rfsm.system.Put[]> by event, the puts that it needs,
-- without and with data
---@field reads_one boolean it takes one event an iteration
---@field hears boolean it reads some wire

--- An event that is put into a wire: an item of a queue, or of what is yet to be put.
---@class rfsm.system.Put
---@field at integer position of the wire
---@field name string name of the event
---@field event any the event that the reader gets
---@field event_text string different for each event, with and without data
---@field text string different for each wire, too

-- Steps of one machine ..............................................................

-- Keeps a configuration of a machine. Returns its number.
local function add_configuration(member, number)
  member.confs[number] = member.confs[number] or member:configuration(number)
  return number
end

-- Returns a table: for each event of a property that came in the last step, whether a
-- transition took it. Also notes all events that were taken, in `member.takes`. Events
-- with data are noted by their names.
local function events_of(member)
  local came, own = {}, member.subject
  for _, event in ipairs(own.last_events) do
    local name = type(event) == "table" and rawget(event, "name") or event
    local is_taken = properties.is_taken(own, event)
    member.takes[name] = member.takes[name] or is_taken or nil
    if match.has(member.wanted, name) then came[name] = came[name] or is_taken end
  end
  return came
end

-- Lists what the last step of a machine has to put into wires.
local function puts_of(member)
  local puts = {}
  for _, item in ipairs(member.subject.emitted) do
    for _, pair in ipairs(member.outgoing[item.emit] or {}) do
      puts[#puts + 1] = item.data and pair.with_data or pair.plain
    end
  end
  return puts
end

-- Returns the outcome of a machine's last step: the configuration to which the step has
-- led, the events from wires, the first `count`, and from outside, and what has to be
-- put into wires.
local function new_outcome(member, try, tgt, count)
  local own = member.subject
  local outcome = { tgt = tgt, read = { unpack(try.events, 1, count) },
    outside = { unpack(try.events, count + 1) },
    puts = puts_of(member), passed = match.joined({}, own.passed),
    may_rest = own.taken[1] ~= nil or own:may_rest(),
    came = try.conf[1].leaf and events_of(member) or {} }
  for _, moment in ipairs(outcome.passed) do
    member.passed[#member.passed + 1] = { moment = moment }
  end
  explore.note_outcome(own, outcome)
  return outcome
end

-- Returns the text of some lists of puts.
local function text_of_puts(lists)
  local texts = {}
  for _, list in ipairs(lists) do
    for _, put in ipairs(list) do texts[#texts + 1] = put.text end
  end
  return concat(texts)
end

-- Returns a text that is different for different outcomes.
local function text_of(outcome)
  return concat({ outcome.tgt, concat(outcome.taken, ","),
    outcome.outside[1] and "outside" or "", outcome.may_rest and "may rest" or "",
    concat(rfsm.sorted_keys(outcome.came), ","), text_of_puts { outcome.puts } }, " ")
end

-- Adds the outcome of the last step, unless the list has an equal outcome. The first
-- `count` events of the step came from wires.
local function add_outcome(member, list, try, key, label, count)
  if not key then
    return member:note_untried("endless", "a step that does not end")
  elseif member.subject.sent_later[1] then
    member:note_untried("pending", "events that are sent later")
  end
  local tgt = add_configuration(member, member:find_configuration(key, try.from, label))
  local outcome = new_outcome(member, try, tgt, count)
  local text = text_of(outcome)
  if not list[text] then list[text], list[#list + 1] = outcome, outcome end
end

-- Lists the ways in which a machine may get what it has read: an event with data as
-- each example of its name in `classes`.
local function ways_to_get(own, puts)
  local ways = { {} }
  for _, put in ipairs(puts) do
    local longer = {}
    for _, way in ipairs(ways) do
      for _, event in ipairs(own:examples_of(put.event)) do
        longer[#longer + 1] = match.with(way, own:occurrence(own.parts[1], event))
      end
    end
    ways = longer
  end
  return ways
end

-- Returns the outcomes of the steps of a machine with the events that it has read: one
-- outcome for each choice that makes a difference.
local function outcomes_of(member, number, puts)
  local known, texts = member.moves[number] or {}, {}
  member.moves[number] = known
  for i, put in ipairs(puts) do texts[i] = put.event_text end
  local key = concat(texts, ",")
  if not known[key] then
    known[key] = {}
    for _, read in ipairs(ways_to_get(member.subject, puts)) do
      member:each_step(number, function(_, try, tgt, label)
        add_outcome(member, known[key], try, tgt, label, #read)
      end, read)
    end
  end
  return known[key]
end

-- Moves .............................................................................

local NOTHING = {}

local function copy(list) return match.joined({}, list) end

-- Returns a list without its first item; equal results for equal lists.
local function rest_of(list)
  if not list[2] then return NOTHING end
  list.rest = list.rest or { unpack(list, 2) }
  return list.rest
end

--- Return a configuration by its number.
function Product:configuration(number) return self.keys[number] end

-- Returns the first value that was kept under a text, so that equal parts of different
-- configurations are one table.
local function kept(self, text, value)
  local values = self.kept
  if values[text] == nil then values[text] = value end
  return values[text]
end

local ENTERED, NOT_ENTERED = { leaf = true }, { leaf = false }

-- Returns the number of a configuration. A new one is added, and is expanded later. Its
-- first item has `leaf`, for properties: it is true if all machines were entered.
local function find_configuration(self, numbers, queues, unsent, from, label)
  local own = concat(numbers, ",")
  local waiting, rest = "queues" .. text_of_puts(queues), "rest" .. text_of_puts(unsent)
  local key = own .. waiting .. rest
  local number = self.numbers[key]
  if number then return number end
  local are_entered = order.all(self.members, function(member)
    return member.confs[numbers[member.number]][1].leaf
  end)
  number = #self.keys + 1
  self.keys[number] = { are_entered and ENTERED or NOT_ENTERED,
    numbers = kept(self, own, numbers), queues = kept(self, waiting, queues),
    unsent = kept(self, rest, unsent) }
  self.numbers[key], self.from[number], self.labels[number] = number, from, label
  return number
end

--- What a machine may read in a move.
---@class rfsm.system.Reading
---@field outcomes table[] the outcomes of a step with the events that are read
---@field queues rfsm.system.Put[][] the queues after that
---@field read rfsm.system.Put[] the events that are read
---@field mover integer see the field `movers` of `rfsm.system.Product`

-- Returns the reading of the wires at some positions.
local function read_wires(self, member, conf, positions)
  local queues = positions[1] and copy(conf.queues) or conf.queues
  for _, at in ipairs(positions) do queues[at] = copy(queues[at]) end
  local read = wires.take(self.wires, queues, positions, member.reads_one)
  return { queues = queues, read = read, mover = member.number,
    outcomes = outcomes_of(member, conf.numbers[member.number], read) }
end

-- Returns the readings of a machine that takes one event: none while an event waits in
-- itself, or else one of a wire, or one from outside. A time event may come in any
-- case. An event from outside to which the machine does not react makes it move, too:
-- its doo goes on.
local function read_one(self, member, conf, waiting)
  local list = { read_wires(self, member, conf, NOTHING) }
  local is_driven = subject.is_driven(member.confs[conf.numbers[member.number]])
  for i, at in ipairs(is_driven and NOTHING or waiting) do
    list[i + 1] = read_wires(self, member, conf, { at })
    list[i + 1].mover = #self.members + at
  end
  return list
end

-- Returns the outcome of a move that only puts an event into a wire.
local function putting(conf, member)
  return { is_put = true, tgt = conf.numbers[member.number], read = NOTHING,
    outside = NOTHING, puts = conf.unsent[member.number], passed = NOTHING,
    came = NOTHING, taken = NOTHING, choices = NOTHING, leaf = false,
    unfollowed = false, ran = false }
end

-- Lists what a machine may read in a move. While it has events to put it reads nothing,
-- and before its entry neither.
local function readings_of(self, member, conf)
  if conf.unsent[member.number][1] then
    return { { queues = conf.queues, read = NOTHING, mover = member.number,
      outcomes = { putting(conf, member) } } }
  elseif not member.confs[conf.numbers[member.number]][1].leaf then
    return { read_wires(self, member, conf, NOTHING) }
  end
  local waiting = wires.waiting(self.wires, conf.queues, member.name)
  if member.reads_one then return read_one(self, member, conf, waiting) end
  return { read_wires(self, member, conf, waiting) }
end

-- Returns a list with another item in one place.
local function with(list, place, item)
  if list[place] == item then return list end
  local other = copy(list)
  other[place] = item
  return other
end

-- Returns the queues after a put, and what was put: nil if there is no put.
local function put_into(self, queues, put)
  if not put then return queues, nil end
  local queue, wire = copy(queues[put.at]), self.wires[put.at]
  local is_lost = not wires.put(wire, queue, put)
  return with(queues, put.at, queue),
    { wire = wire, event = put.name, is_lost = is_lost }
end

-- Notes a move. A move that changes nothing counts only without an event from outside,
-- and if no doo goes on: then the machine goes on so for ever.
local function add_step(self, from, tgt, mover, outcome, label)
  local is_internal = not outcome.outside[1]
  if tgt == from and not (is_internal and outcome.may_rest) then return end
  local step = is_internal and -tgt or tgt
  for at = self.first[from], #self.steps do
    if self.steps[at] == step and self.movers[at] == mover then return end
  end
  local at = #self.steps + 1
  self.steps[at], self.movers[at], self.step_labels[at] = step, mover, label
end

-- Notes which wires carry or lose events in a move, and which states the move passes.
-- If an event of a property came, notes the target of the move for the property.
local function note_move(self, move, member, outcome, sent)
  if sent then
    local wire = sent.wire
    self.carries[wire][sent.event] = true
    self.lost[wire] = self.lost[wire]
      or sent.is_lost and { at = move.from, label = move.label } or nil
  end
  for _, moment in ipairs(outcome.passed) do
    self.passed[#self.passed + 1] = { from = move.from, tgt = move.tgt,
      label = move.label,
      moment = { member = member, moment = moment, number = move.from } }
  end
  for _, judged in ipairs(self.afters) do
    local is_taken, owed = outcome.came[judged.event], judged.owed
    if judged.member == member and is_taken ~= nil then
      judged.has_come, judged.is_taken = true, judged.is_taken or is_taken
      owed[move.tgt] = owed[move.tgt] or move
    end
  end
end

-- Takes a move, which puts nothing yet if it `holds`. Returns true if it changes
-- something, or takes a transition.
local function take_move(self, from, member, reading, outcome, label, holds)
  local conf, puts = self.keys[from], outcome.puts
  local queues, sent = put_into(self, reading.queues, not holds and puts[1])
  local tgt = find_configuration(self, with(conf.numbers, member.number, outcome.tgt),
    queues, with(conf.unsent, member.number, holds and puts or rest_of(puts)), from,
    label)
  add_step(self, from, tgt, reading.mover, outcome, label)
  note_move(self, { from = from, tgt = tgt, label = label }, member, outcome, sent)
  return tgt ~= from or outcome.taken[1] ~= nil or reading.read[1] ~= nil
end

--- Take all moves from a configuration.
function Product:expand(from)
  local has_moved, conf = false, self.keys[from]
  self.first[from] = #self.steps + 1
  for _, member in ipairs(self.members) do
    local may_hold = self.overlap and member.hears and not conf.unsent[member.number][1]
    for at, reading in ipairs(readings_of(self, member, conf)) do
      for index, outcome in ipairs(reading.outcomes) do
        local label = ("%d:%d:%d"):format(member.number, at, index)
        has_moved = take_move(self, from, member, reading, outcome, label) or has_moved
        if may_hold and outcome.puts[1] then
          take_move(self, from, member, reading, outcome, label .. " holds", true)
        end
      end
    end
  end
  if not has_moved then self.stuck[#self.stuck + 1] = from end
end

-- What properties ask ...............................................................

--- Return how many steps the machines have run.
function Product:steps_run()
  local count = 0
  for _, member in ipairs(self.members) do count = count + member.count end
  return count
end

--- Is some machine entered at some time?
function Product:is_entered()
  return order.any(self.members, function(member) return member:is_entered() end)
end

--- Return the member and the path of a name such as "arm: root.moving".
function Product:split(name)
  local front, rest = name:match("^%s*([^:]-)%s*:%s*(.-)%s*$")
  local names = {}
  for i, member in ipairs(self.members) do
    if member.name == front then return member, rest end
    names[i] = member.name
  end
  if front then location.refuse_name(front, "machine", names) end
  error(("'%s': expected as in 'arm: root.moving'"):format(name), 0)
end

--- Return a function that returns whether "arm: root.moving" is active in a
--- configuration. If `passed` is given, its machine is judged at a moment within a
--- step. A product is its own subject, so that properties find this method.
function Product:view(conf, passed)
  return function(name)
    local member, path = self:split(name)
    local own = member.confs[conf.numbers[member.number]]
    if passed and member == passed.member then
      return member.subject:view_of_moment(passed.moment)(path)
    end
    own.view = own.view or member.subject:view(own)
    return own.view(path)
  end
end

function Product:view_of_moment(passed)
  return self:view(self.keys[passed.number], passed)
end

-- Witnesses .........................................................................

--- A move of a witness.
---@class rfsm.system.Move
---@field machine string name of the machine that moves
---@field events string[] events from outside
---@field read { event: string, from: string }[] the events from wires
---@field sent? { wire: rfsm.system.Wire, event: string, is_lost: boolean } the event
-- that was put into a wire
---@field is_put boolean nothing else is done: the event is one of the step before
---@field holds boolean the step emits, but nothing is put yet
---@field choices { who: string, answer: boolean, is_doo: boolean }[] tried answers of
-- callbacks; for a doo, whether it ends
---@field taken string[] paths of the transitions that were taken
---@field leaf string|false path of the leaf after the move; false: not entered yet
---@field unfollowed false|"data"|"targets" see `rfsm_checks.WitnessStep`
---@field ran false|"before"|"after"

local function text_of_event(occurrence)
  return rfsm.event_text(occurrence.event, occurrence.has_data)
end

-- Returns the move with this label from the configuration `from`, as a witness has it.
local function move_of(self, from, label)
  local number, at, index, holds = label:match("^(%d+):(%d+):(%d+)(.*)$")
  local member, conf = self.members[tonumber(number)], self.keys[from]
  local reading = readings_of(self, member, conf)[tonumber(at)]
  local outcome = reading.outcomes[tonumber(index)]
  local _, sent = put_into(self, reading.queues, holds == "" and outcome.puts[1])
  local move = { machine = member.name, is_put = outcome.is_put or false,
    events = order.map(outcome.outside, text_of_event), sent = sent,
    holds = holds ~= "", read = {}, choices = outcome.choices, taken = outcome.taken,
    leaf = outcome.leaf, occurrences = outcome.outside,
    unfollowed = outcome.unfollowed, ran = outcome.ran }
  for i, occurrence in ipairs(outcome.read) do
    move.read[i] = { event = text_of_event(occurrence),
      from = self.wires[reading.read[i].at].from }
  end
  return move
end

--- Return the shortest run to a configuration, then the move `label` if it is given. If
--- `stays` is given, the run goes on to a configuration in which it may stay for ever.
---@param number integer
---@param label string? label of a move from the configuration
---@param stays integer? target of that move, if a run that stays is shown
---@return rfsm.system.Move[] witness
function Product:witness(number, label, stays)
  local way, moves = explore.way_to(self, number, label), {}
  if stays then way = match.joined(way, liveness.way_to_stay(self, stays)) end
  for i, step in ipairs(way) do moves[i] = move_of(self, step.from, step.label) end
  return moves
end

-- Public functions ..................................................................

local EMITS = "events that the %s may emit, which sends does not name"

-- Makes the copy of a wire that a product has. `position` is that in the product,
-- `puts` has two puts for each event, without data and with it.
local function new_wire(position, wire)
  local own = setmetatable({ position = position, puts = {} }, { __index = wire })
  for i, name in ipairs(wire.events) do
    local function put(kind, event)
      return { at = position, name = name, event = event, event_text = kind .. name,
        text = ("%d:%d%s"):format(position, i, kind) }
    end
    own.puts[i] = { plain = put("e", name), with_data = put("d", { name = name }) }
  end
  return own
end

-- Connects a machine to its wires.
local function join_wires(self, member, options)
  for _, wire in ipairs(self.wires) do
    for i, event in ipairs(wire.events) do
      if wire.to == member.name then
        member.wired[event] = not match.has(options.alphabet or {}, event)
        wire.reader, member.hears = member, true
      end
      if wire.from == member.name then
        member.outgoing[event] = match.with(member.outgoing[event] or {}, wire.puts[i])
      end
    end
  end
end

-- Adds a machine. In its subject each event that only comes by wires gets a maker, so
-- that the walk of the machine does not send it from outside.
local function add_member(self, cell, name, options)
  local ok, member = pcall(explore.new, cell.models[name], options)
  if not ok then error(("machines.%s: %s"):format(name, rfsm.text_of(member)), 0) end
  local own, maker_of = member.subject, member.subject.maker_of
  self.members[#self.members + 1] = member
  member.name, member.number, member.confs, member.moves = name, #self.members, {}, {}
  member.wired, member.takes, member.outgoing = {}, {}, {}
  member.reads_one, own.notes_events = own.parts[1].reads_one, true
  own.has_senders = true -- the other machines
  join_wires(self, member, options)
  function own.maker_of(_, event)
    return maker_of(own, event) or member.wired[rfsm.name_with_data(event) or event]
  end
  function member.note_untried(_, bound, text)
    self.is_partial = true
    self:note_untried(bound, name .. ": " .. text)
  end
  member:begin()
  for _, callback in ipairs(own.emitters) do
    member:note_untried("emits", EMITS:format(callback))
  end
end

--- Make the product of some machines of a system, with its first configuration.
---@param cell rfsm.System
---@param group_of table<string, string> the group of each machine
---@param group string the product has the machines of this group
---@param settings table<string, rfsm_checks.Options> the options of each machine
---@param overlap boolean moves may cross
---@return rfsm.system.Product
function product.new(cell, group_of, group, settings, overlap)
  local self = setmetatable({ members = {}, wires = {}, keys = {}, numbers = {},
    kept = {}, from = {}, labels = {}, first = {}, steps = {}, movers = {},
    step_labels = {}, expanded = 0, depth = 0, level_end = 1, stuck = {}, passed = {},
    lost = {}, carries = {}, afters = {}, untried = {}, unsure = {}, cut = {},
    bound = nil, is_partial = false, overlap = overlap }, Product)
  self.subject = self
  for _, wire in ipairs(cell.wires) do
    if group_of[wire.to] == group then
      local own = new_wire(#self.wires + 1, wire)
      self.wires[own.position], self.carries[own] = own, {}
    end
  end
  for _, name in ipairs(cell.names) do
    if group_of[name] == group then add_member(self, cell, name, settings[name]) end
  end
  local numbers, queues, unsent = {}, {}, {}
  for i, member in ipairs(self.members) do
    numbers[i], unsent[i] = add_configuration(member, 1), NOTHING
  end
  for at in ipairs(self.wires) do queues[at] = NOTHING end
  find_configuration(self, numbers, queues, unsent, 0, "")
  return self
end

return product
