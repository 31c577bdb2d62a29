-- A fleet does what one machine in one process does whose host is punctual: random
-- charts, with timers in states, around them and in regions; events, also with data,
-- sent now and for later; calls that come twice; workers that are late. Redis is a
-- table here.

local host = require "spec.support.server_host"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local timeevent = require "rfsm_timeevent"

local state, trans = rfsm.state, rfsm.trans
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local TEXTS = { "e_a", "e_b", '{"name":"e_c","by":1}', '{"name":"e_c","by":2}' }
local EVENTS = { "e_a", "e_b", { name = "e_c", by = 1 }, { name = "e_c", by = 2 } }

-- Charts ------------------------------------------------------------------------------

-- Returns the machine around a region.
local function outermost(fsm)
  while fsm._owner do fsm = fsm._owner end
  return fsm
end

-- Returns an effect that writes a letter into the log, which the chart keeps, and at
-- times sends an event, or resets the machine.
local function new_effect(random, letter)
  local does = random:below(12)
  return function(fsm, _, _, events)
    local outer, by = outermost(fsm), ""
    for _, event in ipairs(events) do
      if type(event) == "table" then by = by .. event.by end
    end
    outer.log = outer.log .. letter .. by
    outer.count = outer.count + 1
    if does == 1 and outer.count % 4 == 1 then rfsm.send_events(fsm, "e_b") end
    if does == 2 and outer.count % 3 == 0 then rfsm.reset(outer) end
    if does == 3 then outer.emit("did", { by = letter }) end
  end
end

local function new_events(random)
  local list = {}
  for _, event in ipairs { "e_a", "e_b", rfsm.named "e_c" } do
    if random:chance(40) then list[#list + 1] = event end
  end
  if random:chance(50) or not list[1] then
    list[#list + 1] = ("e_after(%g)"):format(random:below(12) / 4)
  end
  return list
end

-- Adds states, in a row or nested, and transitions between them to a composite.
local function add_states(random, model, prefix, depth)
  local count = 1 + random:below(3)
  for i = 1, count do
    local name = "s" .. i
    if depth > 0 and random:chance(40) then
      model[name] = state(add_states(random, {}, prefix .. i, depth - 1))
    else
      model[name] = state {}
    end
  end
  model[1] = trans { src = "initial", tgt = "s1" }
  for i = 1, count + random:below(2) do
    local letter = prefix .. ("abcdefgh"):sub(i, i)
    model[i + 1] = trans { src = "s" .. (i - 1) % count + 1,
      tgt = random:chance(20) and "internal" or "s" .. random:below(count),
      events = new_events(random), effect = new_effect(random, letter),
      guard = random:chance(20) and function(tr)
        return outermost(tr._fsm).count % 2 == 0
      end or nil }
  end
  return model
end

local function new_model(seed)
  local random = new_random(seed * 7 + 1)
  local model = add_states(random, {}, "", 2)
  if random:chance(30) then
    model.s1 = rfsm.seqand { step = 20,
      x = state(add_states(random, {}, "x", 1)),
      y = state(add_states(random, {}, "y", 0)) }
  end
  model[#model + 1] = trans { src = "s1", tgt = "s1", events = { "e_a", "e_b",
    rfsm.named "e_c" }, guard = function() return false end } -- all are known
  model.keep, model.log, model.count, model.emem = { "log", "count" }, "", 0, false
  model.info, model.warn, model.err = false, false, false
  return state(model)
end

-- One machine, whose host is punctual ------------------------------------------------

local Punctual = {}
Punctual.__index = Punctual

local SAME = 1e-6 -- seconds: a timer first fires a nanosecond after its time

local function leaf_of(fsm) return fsm._act_leaf and fsm._act_leaf._fqn or "" end

local function step(self)
  rfsm.step(self.fsm, 1000)
  if self.trace[#self.trace] ~= leaf_of(self.fsm) then
    self.trace[#self.trace + 1] = leaf_of(self.fsm)
  end
end

local function new_punctual(seed)
  local self = setmetatable({ now = 1000, nsec = 0, trace = {}, out = {},
    later = {} }, Punctual)
  timeevent.set_gettime_hook(nil)
  local model = new_model(seed)
  function model.gettime() return self.now, self.nsec end
  self.fsm = assert(rfsm.init(model))
  function self.fsm.emit(_, data) self.out[#self.out + 1] = data.by end
  step(self)
  return self
end

-- Sets the clock so many seconds on.
local function advance(self, seconds)
  local ns = self.nsec + math.floor(seconds * 1e9 + 0.5)
  self.now, self.nsec = self.now + math.floor(ns / 1e9), ns % 1e9
end

-- Lets time pass until `time`; each timer and event comes when it is due.
function Punctual:wait(time)
  while true do
    local left, first = timeevent.next_deadline(self.fsm) or math.huge, self.later[1]
    local to_first = first and first.time - self.now - self.nsec / 1e9 or math.huge
    local is_timer = to_first > 0 and left <= to_first + SAME
    local due = self.now + self.nsec / 1e9 + math.min(left, to_first)
    if due > time + SAME then break end
    advance(self, math.max(0, is_timer and left or to_first))
    if not is_timer then
      rfsm.send_events(self.fsm, table.remove(self.later, 1).event)
    end
    step(self)
  end
  self.now, self.nsec = math.floor(time), (time % 1) * 1e9
end

function Punctual:send_at(time, event)
  local at = #self.later + 1
  while at > 1 and self.later[at - 1].time > time do at = at - 1 end
  table.insert(self.later, at, { time = time, event = event })
end

function Punctual:send(event)
  rfsm.send_events(self.fsm, event)
  step(self)
end

-- A fleet of one machine -------------------------------------------------------------

local function new_fleet(seed)
  local trace, clock = {}, { now = 1000 }
  package.loaded["rfsm.server.functions"] = nil
  local functions = require "rfsm.server.functions" (host.new(trace, clock),
    { { name = "c", make = function() return new_model(seed) end } },
    { history = 100, ids = 1000 })
  local self = { trace = { "" }, out = {}, clock = clock }
  function self.call(name, ...)
    local reply = functions["rfsm_" .. name]({ "m" }, { ... })
    if type(reply) ~= "table" or reply.err then error(reply and reply.err) end
    for _, line in ipairs(trace) do
      local to = line:match("^XADD {1={m}:history.*10=(.*)}$")
      self.trace[#self.trace + 1] = to
      self.out[#self.out + 1] = line:match('^XADD {1=rfsm:out.*8={"by":"(.*)"}}$')
    end
    for i = #trace, 1, -1 do trace[i] = nil end
    return reply
  end
  return self
end

-- Comparison -------------------------------------------------------------------------

-- Makes random calls; returns what was recorded.
local function run_fleet(seed)
  local random, fleet = new_random(seed * 31), new_fleet(seed)
  fleet.call("create", "c")
  local plan, last = {}, nil
  for i = 1, 25 do
    local now, kind = fleet.clock.now, random:below(10)
    local number = random:below(4)
    if kind <= 4 then
      local reply = fleet.call("send", TEXTS[number], "ID", "i" .. i)
      plan[#plan + 1] = { now = now, event = EVENTS[number], outcome = reply[#reply] }
      last = { "send", TEXTS[number], "ID", "i" .. i }
      if reply[#reply] == "dropped" then last = nil end
    elseif kind <= 6 then
      local time = now + random:below(12) / 4
      fleet.call("send_at", ("%.6f"):format(time), TEXTS[number], "ID", "i" .. i)
      plan[#plan + 1] = { now = now, event = EVENTS[number], time = time }
      last = { "send_at", ("%.6f"):format(time), TEXTS[number], "ID", "i" .. i }
    elseif kind == 7 and last then
      local reply = fleet.call(unpack(last))
      if reply[#reply] ~= "known" then error "a call was made twice" end
    elseif kind == 8 then
      fleet.call("tick")
    else
      fleet.clock.now = now + random:below(30) / 8 -- nobody comes meanwhile
    end
  end
  fleet.clock.now = fleet.clock.now + 2
  fleet.call("tick")
  fleet.kept = fleet.call("get")[12]
  return fleet, plan
end

-- The same in one process.
local function run_punctual(seed, plan, finish)
  local one = new_punctual(seed)
  for _, call in ipairs(plan) do
    one:wait(call.now)
    local before = one.fsm.log
    if call.time then one:send_at(call.time, call.event) else one:send(call.event) end
    local outcome = one.fsm.log ~= before and "taken" or "dropped"
    if call.outcome and call.outcome ~= outcome then
      return one, "an event is said to be " .. call.outcome
    end
  end
  one:wait(finish)
  return one
end

local function run_case(seed)
  local fleet, plan = run_fleet(seed)
  local one, problem = run_punctual(seed, plan, fleet.clock.now)
  if problem then return problem end
  local kept = ('{"root":{"count":%d,"log":"%s"}}'):format(one.fsm.count, one.fsm.log)
  if fleet.kept ~= kept then return "kept:\n  " .. fleet.kept .. "\n  " .. kept end
  for _, name in ipairs { "trace", "out" } do
    local theirs, ours = table.concat(fleet[name], " "), table.concat(one[name], " ")
    if theirs:gsub("^ ", "") ~= ours then
      return name .. ":\n  " .. theirs .. "\n  " .. ours
    end
  end
end

return { name = "a fleet and one machine", run = function(n, seed)
  local loaded, problem = package.loaded["rfsm.server.functions"], nil
  local count = 0
  for i = 1, n do
    count = i
    local ok, wrong = pcall(run_case, seed * 2003 + i)
    if wrong then problem = ("seed %d, case %d: %s"):format(seed, i, wrong) end
    if not ok or wrong then break end
  end
  package.loaded["rfsm.server.functions"] = loaded
  timeevent.set_gettime_hook(nil)
  return count, problem
end }
