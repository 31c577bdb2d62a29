-- What a fleet of one machine does, and the same chart in one process whose host is
-- punctual: random calls, also those of an operator, and workers that are late.

local charts = require "spec.support.fleet_charts"
local helper = require "spec.helper"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local servers = require "spec.support.servers"
local timeevent = require "rfsm_timeevent"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local punctual = {}

local TEXTS = { "e_a", "e_b", '{"name":"e_c","by":1}', '{"name":"e_c","by":2}' }
local EVENTS = { "e_a", "e_b", { name = "e_c", by = 1 }, { name = "e_c", by = 2 } }

local SAME = 1e-6 -- seconds: a timer first fires a nanosecond after its time

-- One machine ------------------------------------------------------------------------

local Punctual = {}
Punctual.__index = Punctual

local function leaf_of(fsm) return fsm._act_leaf and fsm._act_leaf._fqn or "" end

local function step(self)
  rfsm.step(self.fsm, 1000)
  if self.trace[#self.trace] ~= leaf_of(self.fsm) then
    self.trace[#self.trace + 1] = leaf_of(self.fsm)
  end
end

-- Adds a way from each state over another one to each leaf: no callback is on it, and
-- each timer begins anew.
local function add_forced_ways(model, leaves)
  local i = 1
  while model["s" .. i] do
    model[#model + 1] = rfsm.trans { src = "s" .. i, tgt = "z", events = { "e_force" } }
    i = i + 1
  end
  model.z = rfsm.state {}
  for _, leaf in ipairs(leaves) do
    model[#model + 1] = rfsm.trans { src = "z", tgt = leaf,
      events = { "e_to " .. leaf } }
  end
end

local function new_punctual(seed)
  local self = setmetatable({ now = 1000, nsec = 0, trace = {}, out = {},
    later = {} }, Punctual)
  timeevent.set_gettime_hook(nil)
  local model = charts.new(seed, function(model)
    add_forced_ways(model, charts.leaves(seed))
  end)
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
    local is_timer = left <= to_first + SAME
    local due = self.now + self.nsec / 1e9 + math.min(left, to_first)
    if due > time + SAME then break end
    advance(self, math.max(0, is_timer and left or to_first))
    if not is_timer then
      rfsm.send_events(self.fsm, unpack(table.remove(self.later, 1).events))
    end
    step(self)
  end
  self.now, self.nsec = math.floor(time), (time % 1) * 1e9
end

-- What calls do here; each returns what is wrong with what the fleet has replied.

function Punctual:send(call)
  local before = self.fsm.log
  rfsm.send_events(self.fsm, unpack(call.events))
  step(self)
  local outcome = self.fsm.log ~= before and "taken" or "dropped"
  return call.outcome and call.outcome ~= outcome
    and "an event is said to be " .. call.outcome
end

function Punctual:send_at(call)
  local at = #self.later + 1
  while at > 1 and self.later[at - 1].time > call.time do at = at - 1 end
  table.insert(self.later, at, call)
end

function Punctual:cancel(call)
  local was_there = 0
  for i = #self.later, 1, -1 do
    if self.later[i].id == call.id then
      table.remove(self.later, i)
      was_there = 1
    end
  end
  return call.reply ~= was_there and "cancel has replied " .. tostring(call.reply)
end

function Punctual:force(call)
  rfsm.send_events(self.fsm, "e_force")
  rfsm.step(self.fsm, 1000)
  rfsm.send_events(self.fsm, "e_to " .. call.leaf)
  step(self)
end

-- Makes the calls that a fleet has answered.
local function repeat_calls(seed, plan, finish)
  local self = new_punctual(seed)
  for _, call in ipairs(plan) do
    self:wait(call.now)
    local problem = self[call.kind](self, call)
    if problem then return self, problem end
  end
  self:wait(finish)
  return self
end

-- A fleet -----------------------------------------------------------------------------

--- A fleet of one machine.
---@class FleetOfOne
---@field now number the time of the server
---@field pass fun(self, seconds: number) lets time pass
---@field ask fun(self, name: string, ...: any): any the reply to a call
---@field wake fun(self)
---@field result fun(self): { data: table, trace: string[], out: string[] } what the
--- machine keeps, its leaves, what it has emitted

local Run = {}
Run.__index = Run

-- Notes a call, which the machine sees when its clock shows the time, or was held.
local function note(run, kind, call)
  call.now, call.kind = run.held_at or run.fleet.now, kind
  run.plan[#run.plan + 1] = call
end

-- Makes a call with an event, or two, behind what is in a list; returns the reply, and
-- the events.
local function ask_with_events(run, list, id)
  local events = {}
  for i = 1, run.random:chance(20) and 2 or 1 do
    local number = run.random:below(#TEXTS)
    list[#list + 1], events[i] = TEXTS[number], EVENTS[number]
  end
  list[#list + 1], list[#list + 2] = "ID", id
  run.last = list
  return run.fleet:ask(unpack(list)), events
end

function Run:send(id)
  local reply, events = ask_with_events(self, { "send" }, id)
  local outcome = reply[#reply]
  if outcome == "dropped" then self.last = nil end
  if not self.held_at then
    return note(self, "send", { events = events, outcome = outcome })
  end
  if outcome ~= "kept" then error("held, but " .. outcome) end
  note(self, "send_at", { events = events, time = self.fleet.now, id = id })
end

function Run:send_at(id)
  local time = self.fleet.now + self.random:below(12) / 4
  local _, events = ask_with_events(self, { "send_at", ("%.6f"):format(time) }, id)
  note(self, "send_at", { events = events, time = time, id = id })
  self.ids[#self.ids + 1] = id
end

-- While a machine is held events wait whose time has come.
function Run:cancel()
  local id = not self.held_at and self.ids[1] and self.random:pick(self.ids)
  if not id then return end
  note(self, "cancel", { id = id, reply = self.fleet:ask("cancel", id) })
  self.last = nil
end

function Run:send_again()
  if not self.last then return end
  local reply = self.fleet:ask(unpack(self.last))
  if reply[#reply] ~= "known" then error "a call was made twice" end
end

function Run:tick() self.fleet:ask "tick" end

function Run:wake() self.fleet:wake() end

function Run:look()
  self.fleet:ask "get"
  self.fleet:ask("why", self.random:pick(TEXTS))
end

function Run:pass() self.fleet:pass(self.random:below(30) / 8) end -- nobody comes

-- What is due before does not come any more: so it has come.
function Run:force()
  if self.held_at then return end
  self.fleet:ask "tick"
  if self.random:chance(30) then self:hold() end
  local leaf = self.random:pick(self.leaves)
  self.fleet:ask("force", leaf)
  note(self, "force", { leaf = leaf })
end

function Run:hold()
  if self.held_at then return self:release() end
  self.fleet:ask "hold"
  self.held_at = self.fleet.now
end

-- A worker wakes the machine until it has come to the present.
function Run:release()
  if not self.held_at then return end
  self.fleet:ask "release"
  self.held_at = false
  for _ = 1, 20 do
    local list, due = self.fleet:ask "get", nil
    for i = 1, #list, 2 do due = list[i] == "due" and tonumber(list[i + 1]) or due end
    if not due or due > self.fleet.now then return end
    self.fleet:wake()
  end
end

local KINDS = { "send", "send", "send", "send", "send", "send_at", "send_at", "pass",
  "pass", "pass", "send_again", "tick", "wake", "cancel", "look", "hold", "force" }

-- Makes random calls; returns the run.
local function run_fleet(seed, fleet)
  local run = setmetatable({ fleet = fleet, random = new_random(seed * 31), plan = {},
    ids = {}, held_at = false, leaves = charts.leaves(seed) }, Run)
  fleet:ask("create", ("c%d"):format(seed))
  for i = 1, 30 do run[run.random:pick(KINDS)](run, "i" .. i) end
  run:release()
  fleet:pass(2)
  fleet:ask "tick"
  return run
end

-- Returns what differs.
local function difference(fleet, seed)
  local run = run_fleet(seed, fleet)
  local one, problem = repeat_calls(seed, run.plan, fleet.now)
  if problem then return problem end
  local result = fleet:result()
  local data = result.data
  if data.count ~= one.fsm.count or data.log ~= one.fsm.log then
    return ("kept:\n  %s %s\n  %s %s"):format(data.count, data.log, one.fsm.count,
      one.fsm.log)
  end
  for _, name in ipairs { "trace", "out" } do
    local theirs, ours = table.concat(result[name], " "), table.concat(one[name], " ")
    if theirs ~= ours then return name .. ":\n  " .. theirs .. "\n  " .. ours end
  end
end

--- Returns the charts with seeds as arguments for a library.
function punctual.files(seeds)
  local arguments = {}
  for i, seed in ipairs(seeds) do
    arguments[i] = ("c%d="):format(seed) .. helper.file_with(([[
local charts = require "spec.support.fleet_charts"
return charts.new(%d)]]):format(seed))
  end
  return arguments
end

--- Compares n fleets, one after the other, that `open(seeds)` makes: it returns a
--- function that returns a new fleet for a seed of the list. Returns how many were
--- compared, and what is wrong.
function punctual.compare(n, seed, open)
  local count = 0
  while count < n do
    local seeds = {}
    for i = 1, math.min(n - count, 50) do seeds[i] = seed * 2003 + count + i end
    local new_fleet = open(seeds)
    for _, case in ipairs(seeds) do
      count = count + 1
      local ok, problem = pcall(difference, new_fleet(case), case)
      timeevent.set_gettime_hook(nil)
      if problem then return count, ("case %d: %s"):format(case, problem) end
      assert(ok)
    end
  end
  return count
end

--- Compares likewise fleets in a server, which ends then. `open(server, seeds)` returns
--- what makes them.
function punctual.compare_server(n, seed, server, open)
  local ok, count, problem = pcall(punctual.compare, n, seed, function(seeds)
    return open(server, seeds)
  end)
  servers.stop(server)
  helper.remove_files()
  if not ok then error(count, 0) end
  return count, problem
end

return punctual
