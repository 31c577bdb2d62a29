-- The short way in and out of machines in Redis writes what the long way writes, in the
-- same order, for random charts and calls. Redis is a table here.

local host = require "spec.support.server_host"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local snapshot = require "rfsm.snapshot"

local put = snapshot.put

local EVENTS = { "e_next", "e_next", "e_same", "e_none" }

local VALUES = { 1, 0, -3, 1e15, 0.1 + 0.2, "text", true, false, { 1, { x = 2 } }, {} }

-- What an effect does, by chance: it sets a field, or another target.
local function new_effect(random, name)
  local value = VALUES[random:below(14)] -- nil, too
  local is_target = random:chance(10)
  return function(fsm, tr)
    if is_target then tr.tgt = fsm.s1 end
    fsm.x, fsm[name].n, fsm.other = value, (fsm[name].n or 0) + 1, value
  end
end

-- States that follow each other, with timers and fields that are kept.
local function new_model(seed)
  local random = new_random(seed)
  local count = 2 + random:below(3)
  local model = { emem = false, keep = { "x" }, x = random:chance(50) and 5 or nil,
    rfsm.trans { src = "initial", tgt = "s1" } }
  for i = 1, count do
    local name, to = "s" .. i, "s" .. i % count + 1
    model[name] = rfsm.state { keep = random:chance(70) and { "n" } or nil, n = i }
    model[#model + 1] = rfsm.trans { src = name, tgt = to, effect = new_effect(random,
      name), events = { "e_next", random:chance(40) and "e_after(2)" or nil } }
    local is_moving = random:chance(20)
    model[#model + 1] = rfsm.trans { src = name, tgt = name, events = { "e_same",
      random:chance(10) and "e_at(1005)" or nil }, guard = function(tr)
        if is_moving then tr.tgt = tr._fsm.s2 end
      end }
  end
  return rfsm.state(model)
end

local function put_the_long_way(fsm, snap, options)
  return put(fsm, snap, { migrate = options.migrate, rename = options.rename })
end

-- Makes the library anew, with the short way or without, and makes random calls.
local function run_library(seed, is_short)
  package.loaded["rfsm.server.functions"] = nil
  snapshot.put = is_short and put or put_the_long_way
  local random, trace, clock = new_random(seed * 31), {}, { now = 1000 }
  local functions = require "rfsm.server.functions" (host.new(trace, clock),
    { { name = "c", make = function() return new_model(seed) end } })
  for i = 1, 30 do
    local key = "m" .. random:below(2)
    clock.now = clock.now + random:below(8) / 4
    local what = random:below(6)
    local reply
    if i <= 2 or what == 1 then
      reply = functions.rfsm_create({ i <= 2 and "m" .. i or key }, { "c" })
    elseif what == 2 then
      reply = functions.rfsm_tick({ key }, {})
    elseif what == 3 then
      reply = functions.rfsm_why({ key }, { "e_same" }) -- guards run
    else
      reply = functions.rfsm_send({ key }, { random:pick(EVENTS), random:pick(EVENTS) })
    end
    trace[#trace + 1] = host.sorted(reply)
  end
  return trace
end

return { name = "the short way in Redis", run = function(n, seed)
  local loaded = package.loaded["rfsm.server.functions"]
  local problem = nil
  for i = 1, n do
    local with, without = run_library(seed * 1009 + i, true),
      run_library(seed * 1009 + i, false)
    for j = 1, math.max(#with, #without) do
      if with[j] ~= without[j] and not problem then
        problem = ("seed %d, case %d, line %d:\n  %s\n  %s"):format(seed, i, j,
          tostring(with[j]), tostring(without[j]))
      end
    end
    if problem then break end
  end
  package.loaded["rfsm.server.functions"], snapshot.put = loaded, put
  require("rfsm_timeevent").set_gettime_hook(nil)
  return n, problem
end }
