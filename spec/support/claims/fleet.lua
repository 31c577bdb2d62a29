-- A fleet does what one machine in one process does whose host is punctual: random
-- charts, with timers in states, around them and in regions; events, also with data,
-- sent now and for later; calls that come twice; workers that are late; an operator.
-- Redis is a table here.

local charts = require "spec.support.fleet_charts"
local codec = require "rfsm.server.codec"
local host = require "spec.support.server_host"
local punctual = require "spec.support.punctual"

local Fleet = {}
Fleet.__index = Fleet

local function new_fleet(seed)
  local trace, clock = {}, { now = 1000 }
  package.loaded["rfsm.server.functions"] = nil
  local chart = { name = ("c%d"):format(seed),
    make = function() return charts.new(seed) end }
  local functions = require "rfsm.server.functions" (host.new(trace, clock), { chart },
    { history = 100, ids = 1000 })
  return setmetatable({ now = 1000, clock = clock, calls = trace,
    functions = functions }, Fleet)
end

function Fleet:pass(seconds)
  self.now = self.now + seconds
  self.clock.now = self.now
end

function Fleet:ask(name, ...)
  local reply = self.functions["rfsm_" .. name]({ "m" }, { ... })
  if type(reply) == "table" and reply.err then error(reply.err, 0) end
  return reply
end

function Fleet:wake() self:ask "tick" end

function Fleet:result()
  local trace, out = {}, {}
  for _, line in ipairs(self.calls) do
    local from, to = line:match(
      "^XADD {1={m}:history.*8=(.*),9=to,10=(.*),11=snapshot,12=.*}$")
    trace[#trace + 1] = from ~= to and to or nil
    out[#out + 1] = line:match('^XADD {1=rfsm:out.*8={"by":"(.*)"}}$')
  end
  return { data = codec.decode(self:ask("get")[12]).root, trace = trace, out = out }
end

return { name = "a fleet and one machine", run = function(n, seed)
  local loaded = package.loaded["rfsm.server.functions"]
  local count, problem = punctual.compare(n, seed, function() return new_fleet end)
  package.loaded["rfsm.server.functions"] = loaded
  return count, problem
end }
