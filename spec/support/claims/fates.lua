-- What fate hooks are told of random runs with regions, deferral and awaits, a third of
-- them observed, beside what follows from the definition: the events of each iteration,
-- its path, what waits before and after, what awaits have received, and what became of
-- the events in regions. Time goes on, events are counted, and half of the machines are
-- strict. An interrupt takes at most the fate that is being told: snapshots behind it
-- are those of a run without. It comes anywhere but where other events are current
-- together behind it: in the cycle of regions, which ends then, and between the two
-- iterations of a step, or in the second one before its search, since the step has one
-- more then.

local charts = require "spec.support.charts"
local coverage = require "rfsm.observe.coverage"
local explored = require "spec.support.claims.explore"
local interrupts = require "spec.support.interrupts"
local match = require "rfsm.shared.match"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local run_seeds = require "spec.support.run_seeds"
local snapshot = require "rfsm.snapshot"
require "rfsm.emem"

local remove = table.remove

local claim = { name = "fates of events, and their definition", interrupted = 0 }

local STEPS = 20

local EVENTS = { "e1", "e2", "e3", "e4", "e_unknown" }

local function count_of(list, event)
  local count = 0
  for i = 1, #list do
    if rawequal(list[i], event) then count = count + 1 end
  end
  return count
end

-- Is an event taken by a path, as the contract says?
local function is_taken(path, event)
  local names_some = false
  for _, tr in ipairs(path) do
    if not match.is_any(tr) then
      names_some = true
      if match.takes(tr.events, event) then return true end
    end
  end
  return not names_some
end

-- The definition ----------------------------------------------------------------------

--- A machine as the definition sees it.
---@class Judge
---@field fsm rfsm.Machine
---@field prefix string
---@field around Judge|nil
---@field lines string[] what should be told, of all machines
---@field copies Group[] the events that came from the machine around, and wait
---@field groups Group[] the events of earlier iterations, which regions decide
---@field received table<string, table> what awaits have received, by their names

--- An event of an iteration that regions have got.
---@class Group
---@field judge Judge
---@field event any
---@field size integer how often it was current
---@field open integer how many copies no region has looked at
---@field is_used boolean
local Judge = {}
Judge.__index = Judge

function Judge:note(event, fate)
  self.lines[#self.lines + 1] = ("%s %s %s"):format(self.prefix,
    rfsm.event_text(event, true), fate)
end

-- Takes the copies of an event that have left the queue of this machine.
function Judge:take_copies(event)
  local waiting, taken = count_of(self.fsm._intq, event), {}
  for _, group in ipairs(self.groups) do
    if rawequal(group.event, event) then waiting = waiting + group.size end
  end
  for i = #self.copies, 1, -1 do
    if rawequal(self.copies[i].event, event) then
      waiting = waiting - 1
      if waiting < 0 then table.insert(taken, 1, remove(self.copies, i)) end
    end
  end
  return taken
end

function Judge:decide(event, fate)
  if fate then self:note(event, fate) end
  local taken = self:take_copies(event)
  for _, group in ipairs(taken) do
    group.open, group.is_used = group.open - 1, group.is_used or fate ~= nil
  end
  if fate or taken[1] then return end
  local outermost = self
  while outermost.around do outermost = outermost.around end
  outermost:note(event, "discarded")
end

-- Decides on the events that a region has used, or that none can use any more; at the
-- end of an iteration, when all copies are known.
function Judge:settle()
  for i = #self.groups, 1, -1 do
    local group = self.groups[i]
    if group and (group.is_used or group.open == 0) then
      remove(self.groups, i)
      self:decide(group.event, group.is_used and "forwarded" or nil)
    end
  end
end

-- Has the awaits of active states receive the events of an iteration. Returns a set of
-- those that are new to one.
function Judge:receive(events)
  local new = {}
  for _, await in ipairs(self.awaits) do
    local received = self.received[await.name]
    for _, event in ipairs(await.state._mode ~= "inactive" and events or {}) do
      if match.has(await.wanted, event) and not received[event] then
        received[event], new[event] = true, true
      end
    end
  end
  return new
end

function Judge:begin(events)
  self.path, self.current, self.before = nil, {}, rfsm.waiting(self.fsm)
  self.noted = self:receive(events)
end

function Judge:finish(events)
  local after, is_seen = rfsm.waiting(self.fsm), {}
  for _, event in ipairs(events) do
    local is_kept = self.noted[event]
      or count_of(after, event) > count_of(self.before, event)
    local fate = self.path and is_taken(self.path, event) and "taken"
      or is_kept and "kept" or nil
    local group = self.current[event]
    if not is_seen[event] and not match.maker_of(event) then
      is_seen[event] = true
      if group and not fate then
        group.size = count_of(events, event)
        self.groups[#self.groups + 1] = group
      else
        self:decide(event, fate)
      end
    end
  end
  self:settle()
end

-- The machine gets an event from the one around it, which is in an iteration.
function Judge:get(event)
  local around = self.around
  local group = around.current[event] or { judge = around, event = event, size = 0,
    open = 0, is_used = false }
  around.current[event] = group
  group.open, self.copies[#self.copies + 1] = group.open + 1, group
end

function Judge:reset()
  for _, group in ipairs(self.copies) do group.open = group.open - 1 end
  self.copies, self.groups, self.current = {}, {}, {}
end

local function awaits_of(fsm)
  local list = {}
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    for _, event in ipairs(tr.events) do
      local inside = type(event) == "string" and event:match("^await%((.*)%)@")
      if inside and rfsm.is_state(tr.src) then
        local await = { name = event, state = tr.src, wanted = {} }
        for name in inside:gmatch("[^, ]+") do table.insert(await.wanted, name) end
        list[#list + 1] = await
      end
    end
  end
  return list
end

-- Hangs the definition on a machine.
local function add_judge(at, around, lines)
  local fsm = at.machine
  local judge = setmetatable({ fsm = fsm, prefix = at.prefix, around = around,
    lines = lines, copies = {}, groups = {}, current = {}, awaits = awaits_of(fsm),
    received = {} }, Judge)
  for _, await in ipairs(judge.awaits) do
    judge.received[await.name] = {}
    rfsm.exit_hook_add(fsm, await.state, function() judge.received[await.name] = {} end)
  end
  rfsm.pre_step_hook_add(fsm, function(_, events) judge:begin(events) end)
  rfsm.path_hook_add(fsm, function(_, path) judge.path = path end)
  rfsm.post_step_hook_add(fsm, function(_, events) judge:finish(events) end)
  rfsm.reset_hook_add(fsm, function() judge:reset() end)
  rfsm.watch_hook_add(fsm, "sent", function(_, ...)
    for i = 1, around and select("#", ...) or 0 do judge:get((select(i, ...))) end
  end)
  return judge
end

local function judge_all(fsm)
  local lines, judges = {}, {}
  for _, at in ipairs(rfsm.machines(fsm)) do
    judges[at.machine] = add_judge(at, judges[at.owner], lines)
  end
  return lines
end

-- Runs --------------------------------------------------------------------------------

local function is_even(event) return type(event) == "table" and event.n % 2 == 0 end

-- Has half of the events of a list have data. Predicates ask no text of a table.
local function name_some(list, random)
  for i, event in ipairs(list or {}) do
    local is_plain = match.has(EVENTS, event)
    list[i] = type(event) == "function" and is_even
      or is_plain and random:chance(50) and rfsm.named(event) or event
  end
end

local function prepare(chart, random)
  charts.add_deferrals(chart, EVENTS, random(4))
  for _, fqn in ipairs(chart.names) do name_some(chart.nodes[fqn].defer, random) end
  for _, tr in ipairs(chart.transitions) do name_some(tr.events_ref, random) end
  for _, fqn in ipairs(rfsm.sorted_keys(chart.regions)) do
    for _, region in ipairs(chart.regions[fqn].of) do prepare(region, random) end
  end
end

-- Returns the chart of a seed; every second one has regions.
local function chart_of(seed)
  local chart = explored.chart(seed, 0)
  for i = 1, 100 do
    if seed % 2 == 0 or next(chart.regions) then break end
    chart = explored.chart(seed + i * 100003, 0)
  end
  prepare(chart, new_random(seed + 1))
  return chart
end

-- Returns a machine, and what its fate hooks are told. Guards answer by the number of
-- the transition and the data of the event, and nothing else is done.
local function new_machine(seed)
  local model = explored.model_of(chart_of(seed), { guard = function(id)
    local number = tonumber(id:match("%d+$"))
    return function(_, _, event)
      return (number + (type(event) == "table" and event.n or 1)) % 3 > 0
    end
  end }, "")
  local clock = { now = 0 }
  if seed % 3 == 0 then model.read = "one" end
  model.strict = seed % 2 == 0
  local fsm, told = rfsm.init(model), {}
  for _, at in ipairs(fsm and rfsm.machines(fsm) or {}) do
    at.machine.gettime = function() return clock.now, 0 end
    rfsm.fate_hook_add(at.machine, function(_, event, fate)
      told[#told + 1] = ("%s %s %s"):format(at.prefix, rfsm.event_text(event, true),
        fate)
    end)
  end
  if fsm and seed % 3 == 1 then coverage.coverage(fsm) end
  return fsm, told, clock
end

local function is_waiting(fsm)
  for _, at in ipairs(rfsm.machines(fsm)) do
    if at.machine._intq[1] ~= nil and at.machine._act_leaf then return true end
  end
  return false
end

-- Steps a machine until it and its regions have nothing to do; false if that is long.
local function settle(fsm)
  for _ = 1, 60 do
    if rfsm.step(fsm) and not is_waiting(fsm) then return true end
  end
  return false
end

-- Sends random events to a machine, lets time pass, and has it settle behind each
-- handful. `call(i, f)` calls f for number i. Returns the snapshots behind each; nil if
-- the machine does not settle.
local function run(fsm, clock, seed, call)
  local random, n, snaps = new_random(seed), 0, {}
  for i = 1, STEPS do
    for _ = 1, random(4) - 1 do
      local name = random:pick(EVENTS)
      n = n + 1
      rfsm.send_events(fsm, random:chance(50) and { name = name, n = n } or name)
    end
    clock.now = clock.now + random(4) - 1
    call(i, rfsm.step, fsm)
    if not settle(fsm) then return nil end
    snaps[i] = snapshot.encode(snapshot.take(fsm))
  end
  return snaps
end

local function plainly(_, f, ...) return f(...) end

-- Returns the first line in which two sorted lists differ, if more than `few` lines are
-- missing in the second one, or it has others.
local function difference(expected, told, few)
  table.sort(expected)
  table.sort(told)
  local missing, at = {}, 1
  for _, line in ipairs(expected) do
    if told[at] == line then at = at + 1 else missing[#missing + 1] = line end
  end
  if told[at] then return "told: " .. told[at] end
  return #missing > few and "not told: " .. table.concat(missing, ", ") or nil
end

local function first_difference(snaps, others)
  for i = 1, STEPS do
    if snaps[i] ~= others[i] then
      return ("step %d ends with\n%s\nnot\n%s"):format(i, others[i], snaps[i])
    end
  end
end

-- Is an interrupt behind which the same events are current together?
local function is_plain(fsm)
  if fsm._phase == "doo" then return not rfsm.regions(fsm._act_leaf)[1] end
  return not rfsm.is_free(fsm) or fsm._phase == "finish"
end

-- Interrupts a run anywhere in one step. Returns what is wrong.
local function interrupt(seed, expected, snaps)
  local random = new_random(seed + 2)
  local fsm, told, clock = new_machine(seed)
  local step, at, is_raised = random(STEPS), random(3000), false
  local others = run(fsm, clock, seed, function(i, f, ...)
    if i ~= step then return f(...) end
    local ok, failure
    local results = { interrupts.raise_where(function() return is_plain(fsm) end, at,
      "interrupted!", f, ...) }
    is_raised, ok, failure = results[2], results[3], results[4]
    if not ok and failure ~= "interrupted!" then error(failure, 0) end
  end)
  if is_raised then claim.interrupted = claim.interrupted + 1 end
  local wrong = others and first_difference(snaps, others)
    or difference(expected, told, is_raised and 1 or 0)
  return wrong and ("interrupt at step %d, instruction %d: %s"):format(step, at, wrong)
end

local function compare(seed, list)
  local fsm, told, clock = new_machine(seed)
  if not fsm then return false end
  local expected = judge_all(fsm)
  local snaps = run(fsm, clock, seed, plainly)
  local wrong = difference(expected, told, 0)
    or snaps and interrupt(seed, told, snaps)
  if wrong then list[#list + 1] = ("%d: %s"):format(seed, wrong) end
  return true
end

local run_all = run_seeds(compare)

--- Tries the charts of so many seeds.
function claim.run(n, seed) return interrupts.without_jit(run_all, n, seed) end

return claim
