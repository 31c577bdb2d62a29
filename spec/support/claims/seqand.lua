-- The regions of a sequential AND state do the same as machines of their models that
-- are stepped by hand, in the same order.

local bare = require "spec.support.bare"
local charts = require "spec.support.charts"
local driven = require "spec.support.driven"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"

-- A region ----------------------------------------------------------------------------

-- Returns the model of a chart. Its callbacks note in `trace` that they are called, and
-- decide by the numbers of a seed, so that two machines of it do the same.
local function noting_model(trace, name, chart)
  local random = new_random(chart.seed)
  local function note(what)
    return function(id)
      return function() trace[#trace + 1] = ("%s %s %s"):format(name, what, id) end
    end
  end
  return bare.model_of(chart, {
    entry = note("entry"), exit = note("exit"), effect = note("effect"),
    guard = function() return function() return random(4) > 1 end end,
    doo = function(id)
      return function(fsm)
        for _ = 1, random(3) do
          note("doo")(id)()
          if random:chance(20) then rfsm.send_events(fsm, "e" .. random(4)) end
          rfsm.yield(random(2) == 1)
        end
      end
    end,
  })
end

-- By hand -----------------------------------------------------------------------------

local Hand = {}
Hand.__index = Hand

local function each(list, f, ...)
  for _, fsm in ipairs(list) do f(fsm, ...) end
end

function Hand:advance()
  each(self.machines, self.is_run and rfsm.run or rfsm.step, self.steps)
end

function Hand:forward(events)
  each(self.machines, function(fsm)
    for i = 1, #events do rfsm.send_events(fsm, events[i]) end
  end)
end

function Hand:enter(events)
  self.trace[#self.trace + 1] = "entry"
  self:advance()
  self:forward(events)
  self.is_active = true
end

function Hand:leave()
  each(self.machines, function(fsm)
    rfsm.exit_state(fsm, fsm)
    rfsm.reset(fsm)
  end)
  self.trace[#self.trace + 1] = "exit"
  self.is_active = false
end

-- One step of the parent machine. It reacts to the first of the events, if at all.
function Hand:step(events)
  local first = events[1]
  if not self.is_active then
    if first == "e_enter" then self:enter(events) end
  elseif first == "e_leave" then
    self:leave()
  elseif first == "e_again" then
    self:leave()
    self:enter(events)
  else
    self:forward(events)
    self:advance()
  end
end

-- Both --------------------------------------------------------------------------------

-- The names of regions, in the order in which they are stepped.
local NAMES = { "m", "c", "a", "b" }

-- Returns a random chart, one whose machine may be run on demand.
local function new_chart(seed, is_run)
  local chart = charts.generate(seed)
  if is_run and not chart.is_tame then return new_chart(seed + 1, is_run) end
  return chart
end

-- Returns the trace of a seed, the models of regions, and the fields of the state.
local function new_case(seed)
  local random, case = new_random(seed), { trace = {}, models = {} }
  case.is_run = random:chance(30)
  case.fields = { order = { "m", "c" },
    entry = function() case.trace[#case.trace + 1] = "entry" end,
    exit = function() case.trace[#case.trace + 1] = "exit" end }
  for i, name in ipairs(NAMES) do
    local model = noting_model(case.trace, name, new_chart(seed * 4 + i, case.is_run))
    case.models[i] = model
    case.fields[name] = random:chance(50) and model or rfsm.init(model)
  end
  case.steps = not case.is_run and random:chance(70) and random(4) or nil
  case.fields.run, case.fields.step = case.is_run or nil, case.steps
  return case
end

-- off --e_enter--> par --e_leave--> off, par --e_again--> par
local function new_parent(fields)
  local function wait()
    while true do rfsm.yield(true) end
  end
  local fsm = rfsm.init(rfsm.state { info = false, warn = false,
    par = rfsm.seqand(fields), off = rfsm.state { doo = wait },
    rfsm.trans { src = "initial", tgt = "off" },
    rfsm.trans { src = "off", tgt = "par", events = { "e_enter" } },
    rfsm.trans { src = "par", tgt = "off", events = { "e_leave" } },
    rfsm.trans { src = "par", tgt = "par", events = { "e_again" } } })
  rfsm.step(fsm)
  return fsm
end

local function new_hand(case)
  local machines = {}
  for i, model in ipairs(case.models) do machines[i] = rfsm.init(model) end
  return setmetatable({ trace = case.trace, machines = machines, is_active = false,
    is_run = case.is_run, steps = case.steps }, Hand)
end

local EVENTS = { "e_enter", "e_enter", "e_leave", "e_again", "e1", "e2", "e3", "e4",
  7 }

-- Calls step(events) with random events, so often; returns the trace.
local function drive(case, seed, step)
  local random = new_random(seed + 1)
  for _ = 1, 12 do
    local events = {}
    for i = 1, random(4) - 1 do
      events[i] = EVENTS[i == 1 and random(#EVENTS) or 4 + random(5)]
    end
    step(events)
    case.trace[#case.trace + 1] = "|"
  end
  return case.trace
end

local function run_parent(seed)
  local case = new_case(seed)
  local fsm = new_parent(case.fields)
  return drive(case, seed, function(events)
    for i = 1, #events do rfsm.send_events(fsm, events[i]) end
    rfsm.step(fsm)
  end)
end

local function run_by_hand(seed)
  local case = new_case(seed)
  local hand = new_hand(case)
  return drive(case, seed, function(events) hand:step(events) end)
end

return { name = "regions by hand", run = driven.claim(function(seed)
  local found, expected = run_parent(seed), run_by_hand(seed)
  for i = 1, math.max(#found, #expected) do
    if found[i] ~= expected[i] then
      return ("line %d of the trace is '%s', by hand '%s'"):format(i,
        tostring(found[i]), tostring(expected[i]))
    end
  end
end) }
