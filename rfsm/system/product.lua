--- Products: the configurations that the machines of a system reach together.
--
-- In a move, a machine reads its wires. Then it takes one step with the events that it
-- has read and at most one event from outside. Any machine may move at any time. Each
-- machine has a walk (`rfsm.explore.explore`), which takes equal steps only once: the
-- outcomes are kept by the configuration of the machine and the list of events read.
--
-- A product also has the fields of a walk that graphs and properties read.
--
-- @module rfsm.system.product
-- @license BSD-3-Clause

local explore = require "rfsm.explore.explore"
local graph = require "rfsm.explore.graph"
local location = require "rfsm.shared.location"
local match = require "rfsm.shared.match"
local order = require "rfsm.shared.order"
local properties = require "rfsm.explore.properties"
local rfsm = require "rfsm"
local wires = require "rfsm.system.wires"

local error, ipairs, rawget = error, ipairs, rawget
local setmetatable, tonumber, type = setmetatable, tonumber, type
local concat = table.concat
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local product = {}

--- A walk over the configurations of several machines.
---@class rfsm.system.Product
---@field members rfsm.system.Member[]
---@field wires rfsm.system.Wire[] wires between the members
---@field keys table[] configurations: `numbers` has the configuration of each machine,
-- `queues` has the queue of each wire
---@field numbers table<string, integer> number of a configuration by its text
---@field labels string[] by configuration, the move that first led to it: "2:7" is
-- outcome 7 of member 2
---@field steps integer[] targets of moves; negative: without an event from outside
---@field movers integer[] by index of `steps`, the number of the member that moved
---@field lost table<rfsm.system.Wire, table> the first move that loses the wire's event
---@field carries table<rfsm.system.Wire, true> wires over which an event goes
---@field is_partial boolean some steps of a machine were not tried
local Product = { note_untried = explore.note_untried }
Product.__index = Product

--- A machine of a product: its walk, and fields that the product needs.
---@class rfsm.system.Member: rfsm_checks.Walk
---@field name string
---@field number integer
---@field confs rfsm_checks.Configuration[] configurations of this machine alone
---@field moves table<integer, table> outcomes by configuration, then by events read
---@field wired table<string, boolean> events of wires; true: they come only by wires
---@field takes table<string, true> events that transitions have taken
---@field outgoing table<string, integer[]> by event, numbers of the wires that carry it

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

-- Returns the outcome of a machine's last step: the configuration to which the step has
-- led, the events from outside, and the events that were emitted.
local function new_outcome(member, try, tgt, outside)
  local own = member.subject
  local outcome = { tgt = tgt, outside = outside,
    emitted = match.joined({}, own.emitted), passed = match.joined({}, own.passed),
    came = try.conf[1].leaf and events_of(member) or {} }
  for _, moment in ipairs(outcome.passed) do
    member.passed[#member.passed + 1] = { moment = moment }
  end
  explore.note_outcome(own, outcome)
  return outcome
end

-- Returns a text that is different for different outcomes.
local function text_of(outcome)
  local texts = { outcome.tgt, concat(outcome.taken, ","),
    outcome.outside[1] and "outside" or "",
    concat(rfsm.sorted_keys(outcome.came), ",") }
  for _, item in ipairs(outcome.emitted) do
    texts[#texts + 1] = item.emit .. (item.data and "+" or "")
  end
  return concat(texts, " ")
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
  local outcome = new_outcome(member, try, tgt, { unpack(try.events, count + 1) })
  local text = text_of(outcome)
  if not list[text] then list[text], list[#list + 1] = outcome, outcome end
end

-- Returns the outcomes of the steps of a machine with the events that it has read: one
-- outcome for each choice that makes a difference.
local function outcomes_of(member, number, read)
  local known, numbers = member.moves[number] or {}, {}
  member.moves[number] = known
  for i, occurrence in ipairs(read) do numbers[i] = occurrence.number end
  local key = concat(numbers, ",")
  if not known[key] then
    known[key] = {}
    member:each_step(number, function(_, try, tgt, label)
      add_outcome(member, known[key], try, tgt, label, #read)
    end, read)
  end
  return known[key]
end

-- Moves .............................................................................

-- All events of a wire have one name. So a queue is a list of letters: "d" is an event
-- with data, "e" is an event without data.
local function copy(queue) return match.joined({}, queue) end

--- Return a configuration by its number.
function Product:configuration(number) return self.keys[number] end

-- Returns the number of a configuration. A new one is added, and is expanded later. Its
-- first item has `leaf`, for properties: it is true if all machines were entered.
local function find_configuration(self, numbers, queues, from, label)
  local texts = { concat(numbers, ",") }
  for i, queue in ipairs(queues) do texts[i + 1] = concat(queue) end
  local key = concat(texts, "|")
  local number = self.numbers[key]
  if number then return number end
  local are_entered = order.all(self.members, function(member)
    return member.confs[numbers[member.number]][1].leaf
  end)
  number = #self.keys + 1
  self.keys[number] = { { leaf = are_entered }, numbers = numbers, queues = queues }
  self.numbers[key], self.from[number], self.labels[number] = number, from, label
  return number
end

-- Returns the outcomes of a move, the queues after the wires were read, and for each
-- event that was read the wire by which it came.
local function moves_of(self, member, conf)
  local number, queues, read = conf.numbers[member.number], {}, {}
  if not member.confs[number][1].leaf then
    return outcomes_of(member, number, read), conf.queues, read
  end
  for at, wire in ipairs(self.wires) do
    queues[at] = wire.to == member.name and copy(conf.queues[at]) or conf.queues[at]
  end
  local letters, by = wires.take(self.wires, queues, member.name)
  for i, letter in ipairs(letters) do
    local event = letter == "d" and by[i].with_data or by[i].event
    read[i] = member.subject:occurrence(member.subject.parts[1], event)
  end
  return outcomes_of(member, number, read), queues, by
end

-- Returns the queues after the emitted events of a step were put into them, and a list
-- that has for each event and wire whether the event was lost.
local function send(self, member, queues, emitted)
  local after, sent = emitted[1] and copy(queues) or queues, {}
  for _, item in ipairs(emitted) do
    for _, at in ipairs(member.outgoing[item.emit] or {}) do
      after[at] = copy(after[at])
      local is_put = wires.put(self.wires[at], after[at], item.data and "d" or "e")
      sent[#sent + 1] = { wire = self.wires[at], is_lost = not is_put }
    end
  end
  return after, sent
end

-- Notes a move. A move that changes nothing counts only if it took a transition without
-- an event from outside: then the machine goes on for ever.
local function add_step(self, from, tgt, member, outcome, label)
  local is_internal = not outcome.outside[1]
  if tgt == from and not (is_internal and outcome.taken[1]) then return end
  local step = is_internal and -tgt or tgt
  for at = self.first[from], #self.steps do
    if self.steps[at] == step and self.movers[at] == member.number then return end
  end
  local at = #self.steps + 1
  self.steps[at], self.movers[at], self.step_labels[at] = step, member.number, label
end

-- Notes which wires carry or lose events in a move, and which states the move passes.
-- If an event of a property came, notes the target of the move for the property.
local function note_move(self, move, member, outcome, sent)
  for _, each in ipairs(sent) do
    self.carries[each.wire] = true
    self.lost[each.wire] = self.lost[each.wire]
      or each.is_lost and { at = move.from, label = move.label } or nil
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

--- Take all moves from a configuration.
function Product:expand(from)
  local conf, has_moved = self.keys[from], false
  self.first[from] = #self.steps + 1
  for _, member in ipairs(self.members) do
    local list, left, by = moves_of(self, member, conf)
    for index, outcome in ipairs(list) do
      local queues, sent = send(self, member, left, outcome.emitted)
      local numbers, label = copy(conf.numbers), member.number .. ":" .. index
      numbers[member.number] = outcome.tgt
      local tgt = find_configuration(self, numbers, queues, from, label)
      add_step(self, from, tgt, member, outcome, label)
      note_move(self, { from = from, tgt = tgt, label = label }, member, outcome, sent)
      has_moved = has_moved or tgt ~= from or outcome.taken[1] ~= nil or by[1] ~= nil
    end
  end
  if not has_moved then self.stuck[#self.stuck + 1] = from end
end

-- What properties ask ...............................................................

--- Set the time of the clock at which the walks of all machines have to end.
function Product:set_end(ends)
  self.ends = ends
  for _, member in ipairs(self.members) do member:set_end(ends) end
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

-- Runs that stay ....................................................................

-- Notes in `is_fair` which machines a run does not neglect if it stays in the strongly
-- connected component of a configuration: a machine has nothing to do in the
-- configuration, or it has a move that stays in the component.
local function note_fair(self, number, index_of, is_fair)
  local is_busy = {}
  graph.each_step(self, number, function(tgt, is_internal, at)
    local mover, stays = self.movers[at], index_of[tgt] == index_of[number]
    is_busy[mover] = is_busy[mover] or is_internal and tgt ~= number
    is_fair[mover] = is_fair[mover] or is_internal and stays
  end)
  for i in ipairs(self.members) do is_fair[i] = is_fair[i] or not is_busy[i] end
end

--- Return the set of configurations from which moves without events from outside always
--- lead to one of `goals`, if doos end and each machine moves again and again.
---@param goals table<integer, boolean> set of configurations
---@return table<integer, boolean> set
function Product:must_reach(goals)
  local set, staying, open = {}, {}, {}
  for number = 1, self.expanded do open[number] = not goals[number] end
  local components, index_of = graph.components_in(self, open, true)
  for _, numbers in ipairs(components) do
    local is_fair = {}
    for _, number in ipairs(numbers) do
      note_fair(self, number, index_of, is_fair)
    end
    local stays = order.all(self.members, function(member)
      return is_fair[member.number]
    end)
    for _, number in ipairs(numbers) do staying[number] = stays end
  end
  self.open, self.staying = open, staying
  local can_stay = graph.can_reach(self, staying, true, open)
  for number = 1, #self.keys do
    set[number] = self.is_partial or not can_stay[number]
  end
  return set
end

-- Returns the moves from a configuration to the nearest one in which a run may stay, as
-- the last call of `must_reach` has found.
local function way_to_stay(self, start)
  if self.staying[start] then return {} end
  local edges = setmetatable({}, { __index = function(_, number)
    local list = {}
    graph.each_step(self, number, function(tgt, is_internal, at)
      if is_internal and self.open[tgt] then
        list[#list + 1] = { from = number, tgt = tgt, label = self.step_labels[at] }
      end
    end)
    return list
  end })
  return graph.find_way(edges, start, function(edge) return self.staying[edge.tgt] end)
    or {}
end

-- Witnesses .........................................................................

--- A move of a witness.
---@class rfsm.system.Move
---@field machine string name of the machine that moves
---@field events string[] events from outside
---@field read rfsm.system.Wire[] for each event that was read, the wire it came from
---@field sent { wire: rfsm.system.Wire, is_lost: boolean }[] events put into wires
---@field choices { who: string, answer: boolean, is_doo: boolean }[] tried answers of
-- callbacks; for a doo, whether it ends
---@field taken string[] paths of the transitions that were taken
---@field leaf string|false path of the leaf after the move; false: not entered yet
---@field unfollowed false|"data"|"targets" see `rfsm_checks.WitnessStep`
---@field ran false|"before"|"after"

-- Returns the move with this label from the configuration `from`, as a witness has it.
local function move_of(self, from, label)
  local number, index = label:match("^(%d+):(%d+)$")
  local member = self.members[tonumber(number)]
  local list, left, by = moves_of(self, member, self.keys[from])
  local outcome = list[tonumber(index)]
  local _, sent = send(self, member, left, outcome.emitted)
  local move = { machine = member.name, events = {}, read = by, sent = sent,
    choices = outcome.choices, taken = outcome.taken, leaf = outcome.leaf,
    occurrences = outcome.outside, unfollowed = outcome.unfollowed, ran = outcome.ran }
  for i, occurrence in ipairs(outcome.outside) do
    move.events[i] = rfsm.event_text(occurrence.event)
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
  if stays then way = match.joined(way, way_to_stay(self, stays)) end
  for i, step in ipairs(way) do moves[i] = move_of(self, step.from, step.label) end
  return moves
end

-- Public functions ..................................................................

local EMITS = "events that the %s may emit, which sends does not name"

-- Adds a machine. In its subject each event that only comes by wires gets a maker, so
-- that the walk of the machine does not send it from outside.
local function add_member(self, cell, name, options)
  local member = explore.new(cell.models[name], options)
  local own, maker_of = member.subject, member.subject.maker_of
  self.members[#self.members + 1] = member
  member.name, member.number, member.confs, member.moves = name, #self.members, {}, {}
  member.wired, member.takes, member.outgoing = {}, {}, {}
  own.notes_events = true
  for at, wire in ipairs(self.wires) do
    if wire.to == name then
      member.wired[wire.event] = not match.has(options.alphabet or {}, wire.event)
    end
    if wire.from == name then
      member.outgoing[wire.event] = match.with(member.outgoing[wire.event] or {}, at)
    end
  end
  function own.maker_of(_, event)
    return maker_of(own, event) or member.wired[match.name_of(event) or event]
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
---@return rfsm.system.Product
function product.new(cell, group_of, group, settings)
  local self = setmetatable({ members = {}, wires = {}, keys = {}, numbers = {},
    from = {}, labels = {}, first = {}, steps = {}, movers = {}, step_labels = {},
    expanded = 0, depth = 0, level_end = 1, stuck = {}, passed = {}, lost = {},
    carries = {}, afters = {}, untried = {}, unsure = {}, cut = {},
    monitor = false, bound = nil, is_partial = false }, Product)
  self.subject = self
  for _, wire in ipairs(cell.wires) do
    if group_of[wire.to] == group then
      self.wires[#self.wires + 1] = setmetatable({ with_data = { name = wire.event } },
        { __index = wire })
    end
  end
  for _, name in ipairs(cell.names) do
    if group_of[name] == group then add_member(self, cell, name, settings[name]) end
  end
  local numbers, queues = {}, {}
  for i, member in ipairs(self.members) do numbers[i] = add_configuration(member, 1) end
  for at in ipairs(self.wires) do queues[at] = {} end
  find_configuration(self, numbers, queues, 0, "")
  return self
end

return product
