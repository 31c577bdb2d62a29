-- The claim of spec/support/claims/fleet.lua for a real Redis, which also finds each
-- machine once, and nothing of it when it was removed. A worker takes what is emitted;
-- it fails now and then.

local punctual = require "spec.support.punctual"
local servers = require "spec.support.servers"

local Fleet = {}
Fleet.__index = Fleet

function Fleet:pass(seconds)
  self.now = self.now + seconds
  self.client:call("0", "SET", "clock", ("at %.6f"):format(self.now))
end

function Fleet:ask(name, ...)
  local reply, problem = self.client:ask("rfsm_" .. name, "m", ...)
  if problem then error(problem, 0) end
  return reply
end

function Fleet:wake() self.client:wake() end

-- Returns what a worker takes that fails now and then, in the order of the entries.
local function take_all(client)
  local entries, count, out = {}, 0, {}
  for _ = 1, 100 do
    local done, failures = client:work("g", "w", function(entry)
      count = count + 1
      if count % 3 == 0 then error "no paper" end
      entries[#entries + 1] = entry
    end, { idle = 0, tries = 1000 })
    if done == 0 and not failures[1] then break end
  end
  local function number_of(entry, pattern) return tonumber(entry.id:match(pattern)) end
  table.sort(entries, function(a, b)
    local ms, other_ms = number_of(a, "(%d+)%-"), number_of(b, "(%d+)%-")
    if ms ~= other_ms then return ms < other_ms end
    return number_of(a, "%d+$") < number_of(b, "%d+$")
  end)
  for i, entry in ipairs(entries) do out[i] = entry.data.by end
  return out
end

function Fleet:result()
  local view, trace = self.client:get("m"), {}
  for _, move in ipairs(self.client:history("m", 10000)) do
    if move.from ~= move.to then table.insert(trace, 1, move.to) end
  end
  local found = self.client:find(view.chart, "root")
  if #found ~= 1 then error(("find: %d machines"):format(#found), 0) end
  local out = take_all(self.client)
  self.client:remove("m")
  local keys = self.server:cli "KEYS '*:{0}*'":gsub("rfsm:out:{0}\n", "")
  if keys:find "%S" then error("left: " .. keys, 0) end
  return { data = view.data.root, trace = trace, out = out }
end

-- Returns what makes fleets of the charts with seeds.
local function open(server, seeds)
  local client = require("rfsm.fleet").connect(server:url(), { name = "c", tags = 1 })
  local text = require("rfsm.redis").bundle(punctual.files(seeds),
    { index = true, history = 1000, ids = 1000 })
  assert(client:load(servers.with_clock(text)))
  return function()
    server:stop_clock(1000)
    return setmetatable({ now = 1000, server = server, client = client }, Fleet)
  end
end

return { name = "a fleet in Redis", run = function(n, seed)
  if servers.no_redis() then return 0 end
  return punctual.compare_server(n, seed, servers.redis(), open)
end }
