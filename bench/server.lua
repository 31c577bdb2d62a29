-- VM instructions of a call in a server:  lua5.1 bench/server.lua [MOVES]
--
-- For charts of each kind with 10, 100 and 500 states: putting a saved machine, taking
-- it, and one rfsm_send with all that belongs to it; with MOVES, a history keeps so
-- many moves. Redis is a table here; its commands, pack and unpack are C, not counted.
-- Needs an interpreter that calls a count hook at each instruction: not LuaJIT.

package.path = "./?.lua;" .. package.path

local charts = require "rfsm.server.charts"
local codec = require "rfsm.server.codec"
local copy_of = require("rfsm.snapshot.encoding").copy_of
local functions = require "rfsm.server.functions"
local rfsm = require "rfsm"
local snapshot = require "rfsm.snapshot"
local store = require "rfsm.redis.store"
require "rfsm.history"

local state, trans = rfsm.state, rfsm.trans

local SIZES, KINDS = { 10, 100, 500 },
  { "plain", "timer", "fields", "keep", "history", "regions" }

local function with_region()
  return rfsm.seqand { l = state {
    a = state {}, trans { src = "initial", tgt = "a" } } }
end

-- A composite of ten states, of which nine are a ring.
local function area_of(kind)
  local area = { trans { src = "initial", tgt = "s1" } }
  if kind == "keep" then area.keep, area.a, area.b = { "a", "b" }, 1, "x" end
  if kind == "history" then area.history = "deep" end
  for s = 1, 10 do
    local own = kind == "fields" and { limit = s, entry = function() end } or {}
    area["s" .. s] = kind == "regions" and s == 10 and with_region() or state(own)
    area[s + 1] = trans { src = "s" .. s, tgt = "s" .. s % 9 + 1,
      events = { "e_next", kind == "timer" and "e_after(3600)" or nil },
      effect = function(fsm) fsm.n = fsm.n + 1 end }
  end
  return state(area)
end

local function chart_of(kind, count)
  local last = count / 10
  local root = { keep = { "n", "item" }, n = 0, item = "gear",
    trans { src = "initial", tgt = "c1" } }
  for c = 1, last do
    root["c" .. c] = area_of(kind)
    root[c + 1] = trans { src = "c" .. c, tgt = "c" .. c % last + 1,
      events = { "e_far" } }
  end
  return state(root)
end

-- Instructions of f() that are counted, each time.
local count, is_on = 0, false

local function counted(times, f)
  count, is_on = 0, true
  debug.sethook(function() if is_on then count = count + 1 end end, "", 1)
  for _ = 1, times do f() end
  debug.sethook()
  return count / times
end

-- Returns a function that is not counted.
local function uncounted(f)
  local function on(...)
    is_on = true
    return ...
  end
  return function(...)
    is_on = false
    return on(f(...))
  end
end

local values, packed = {}, {}
local COMMANDS = {
  GET = function(key) return values[key] and key or false end,
  TIME = function() return { "1700000000", "123456" } end,
  SET = function(key, text) values[key], packed = packed[#text], {} end,
  TYPE = function() return { ok = "none" } end,
}
local redis = { acl_check_cmd = uncounted(function() return true end),
  error_reply = error, call = uncounted(function(name, ...)
    return COMMANDS[name] and COMMANDS[name](...)
  end) }
local cmsgpack = {
  pack = uncounted(function(list)
    packed[#packed + 1] = copy_of(list)
    return ("x"):rep(#packed)
  end),
  unpack = uncounted(function(key) return copy_of(values[key]) end),
}

local list = {}
for _, kind in ipairs(KINDS) do
  for _, size in ipairs(SIZES) do
    list[#list + 1] = { name = kind .. size, make = function()
      return chart_of(kind, size)
    end }
  end
end
local f = functions(store(redis, { decode = codec.decode }, cmsgpack), list,
  { history = tonumber(arg[1]) })

print(("%-12s %8s %8s %8s"):format("chart", "put", "take", "send"))
for _, chart in ipairs(list) do
  local key = { chart.name }
  assert(f.rfsm_create(key, { chart.name })[3] == "taken")
  local function send()
    local reply = f.rfsm_send(key, { "e_next" })
    assert(reply[#reply] == "taken")
  end
  for _ = 1, 60 do send() end
  local sent = counted(36, send)
  local snap = values[chart.name][3]
  local function put() assert(charts.put(chart, snap)) end
  local function take() return snapshot.take(chart.fsm) end
  put()
  print(("%-12s %8.0f %8.0f %8.0f"):format(chart.name, counted(36, put),
    counted(36, take), sent))
end
