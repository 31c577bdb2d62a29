-- Machines in Redis:  LUA bench/fleet.lua [MACHINES ...]
--
-- What a call costs the server, in microseconds of its processor, which other programs
-- do not disturb: events for machines of 20 states, and next to them plain HSET, and an
-- EVAL that reads and writes a value of the same size. The memory that a machine takes.

package.path = "./?.lua;" .. package.path

local redis = require "rfsm.redis"
local servers = require "spec.support.redis"

local CALLS = 20000

-- 20 states: four areas of four stations.
local CHART = [[
local areas = { keep = { "order", "count" }, order = "A-4711", count = 0 }
local function count(fsm) fsm.count = fsm.count + 1 end
for i = 1, 4 do
  local area = rfsm.state { rfsm.trans { src = "initial", tgt = "station1" } }
  for j = 1, 4 do
    area["station" .. j] = rfsm.state { entry = count }
    area[j + 1] = rfsm.trans { src = "station" .. j, tgt = "station" .. j % 4 + 1,
      events = { "e_next" } }
  end
  areas["area" .. i] = area
  areas[i] = rfsm.trans { src = i == 1 and "initial" or "area" .. i - 1,
    tgt = "area" .. i, events = i > 1 and { "e_area" } or nil }
end
return rfsm.state(areas)
]]

local function write_file(text)
  local name = os.tmpname()
  local file = assert(io.open(name, "w"))
  file:write(text)
  file:close()
  return name
end

local chart = write_file(CHART)
local library = write_file(redis.bundle { "area=" .. chart })
local server = servers.start("--maxmemory 0")
assert(server:cli("-x FUNCTION LOAD REPLACE <" .. library):find("rfsm"))
os.remove(chart)
os.remove(library)

local function info(section, field)
  return tonumber(server:cli("INFO " .. section):match(field .. ":([%d.]+)"))
end

local function cpu()
  return info("cpu", "used_cpu_user") + info("cpu", "used_cpu_sys")
end

-- Microseconds of the server for each call of a command.
local function cost(machines, command)
  local before = cpu()
  local answer = server:cli((" PING >/dev/null; redis-benchmark -p %d -q -c 50 -n %d "
    .. "-r %d %s"):format(server.port, CALLS, machines, command))
  assert(not answer:find("rror"), answer)
  return (cpu() - before) / CALLS * 1e6
end

-- Copies a machine until there are as many as wanted; redis-benchmark names the keys.
local function populate(machines)
  server:cli("FLUSHALL")
  server:cli("FCALL rfsm_create 1 m:000000000000 area")
  local lines = {}
  for i = 1, machines - 1 do
    lines[i] = ("COPY m:000000000000 m:%012d\n"):format(i)
  end
  local file = write_file(table.concat(lines))
  server:cli("--pipe <" .. file)
  os.remove(file)
  assert(tonumber(server:cli("DBSIZE"):match("%d+")) == machines)
end

local VALUE = ("x"):rep(96)
local SCRIPT = [[local v = redis.call("GET", KEYS[1]) ]]
  .. [[redis.call("SET", KEYS[1], ARGV[1]) return v]]

local function row(machines)
  local empty = info("memory", "used_memory")
  populate(machines)
  local size = tonumber(server:cli("STRLEN m:000000000000"):match("%d+"))
  local used = (info("memory", "used_memory") - empty) / machines
  local send = cost(machines, "FCALL rfsm_send 1 m:__rand_int__ e_next")
  local eval = cost(machines, ("EVAL '%s' 1 v:__rand_int__ %s"):format(SCRIPT, VALUE))
  local hset = cost(machines, "HSET h:__rand_int__ value " .. VALUE)
  print(("| %d | %d | %.0f | %.1f | %.1f | %.1f |"):format(machines, size, used, send,
    eval, hset))
end

print("| machines | value, bytes | memory, bytes | rfsm_send, us | EVAL | HSET |")
print("|---|---|---|---|---|---|")
local ok, problem = pcall(function()
  for i = 1, #arg > 0 and #arg or 2 do row(tonumber(arg[i] or ({ 1, 1000 })[i])) end
end)
servers.stop_all()
if not ok then error(problem, 0) end
