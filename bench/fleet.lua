-- Machines in Redis:  LUA bench/fleet.lua [MACHINES ...]
--
-- What a call costs the server, in microseconds of its processor, pipelined by 32:
-- events for machines of 20 states, with an id, with a timer in each state. Next to
-- them plain HSET, and an EVAL that unpacks a value of the same size and packs it
-- again. The memory that a machine takes.

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
local timed = write_file((CHART:gsub('events = { "e_next" } }',
  'events = { "e_next", "e_after(1000)" } }')))
local library = write_file((redis.bundle { "area=" .. chart, "timed=" .. timed }))
local server = servers.start("--maxmemory 0")
assert(server:cli("-x FUNCTION LOAD REPLACE <" .. library):find("rfsm"))
for _, name in ipairs { chart, timed, library } do os.remove(name) end

local function info(section, field)
  return tonumber(server:cli("INFO " .. section):match(field .. ":([%d.]+)"))
end

local function cpu()
  return info("cpu", "used_cpu_user") + info("cpu", "used_cpu_sys")
end

-- Microseconds of the server for each call of a command.
local function cost(machines, command)
  local before = cpu()
  local answer = server:cli((" PING >/dev/null; redis-benchmark -p %d -q -c 20 -P 32 "
    .. "-n %d -r %d %s"):format(server.port, CALLS, machines, command))
  assert(not answer:find("rror"), answer)
  return (cpu() - before) / CALLS * 1e6
end

-- Copies a machine until there are as many as wanted; redis-benchmark names the keys.
local function populate(name, mark, machines)
  server:cli(("FCALL rfsm_create 1 %s:000000000000 %s"):format(mark, name))
  local lines = {}
  for i = 1, machines - 1 do
    lines[i] = ("COPY %s:000000000000 %s:%012d\n"):format(mark, mark, i)
  end
  local file = write_file(table.concat(lines))
  server:cli("--pipe <" .. file)
  os.remove(file)
end

local VALUE = ("x"):rep(96)
local SCRIPT = [[local v = redis.call("GET", KEYS[1]) ]]
  .. [[if v then cmsgpack.unpack(v) end redis.call("SET", KEYS[1], ]]
  .. [[cmsgpack.pack({ "rfsm", "area", { version = 2, ]]
  .. [[chart = "844974cfc38-e0429e", leaf = "root.area1.station2", done = true, ]]
  .. [[data = { root = { order = "A-4711", count = 13 } } } })) return 1]]

local function row(machines)
  server:cli("FLUSHALL")
  local empty = info("memory", "used_memory")
  populate("area", "m", machines)
  local size = tonumber(server:cli("STRLEN m:000000000000"):match("%d+"))
  local used = (info("memory", "used_memory") - empty) / machines
  populate("timed", "t", math.min(machines, 1000))
  local costs = {}
  for i, command in ipairs { "FCALL rfsm_send 1 m:__rand_int__ e_next",
    "FCALL rfsm_send 1 m:__rand_int__ e_next ID i:__rand_int__",
    "FCALL rfsm_send 1 t:__rand_int__ e_next",
    ("EVAL '%s' 1 v:__rand_int__"):format(SCRIPT),
    "HSET h:__rand_int__ value " .. VALUE } do
    costs[i] = ("%.1f"):format(cost(i == 3 and math.min(machines, 1000) or machines,
      command))
  end
  print(("| %d | %d | %.0f | %s |"):format(machines, size, used,
    table.concat(costs, " | ")))
end

print("| machines | value, bytes | memory, bytes | rfsm_send, us | with id "
  .. "| with timers | EVAL | HSET |")
print("|---|---|---|---|---|---|---|---|")
local ok, problem = pcall(function()
  for i = 1, #arg > 0 and #arg or 2 do row(tonumber(arg[i] or ({ 1, 1000 })[i])) end
end)
servers.stop_all()
if not ok then error(problem, 0) end
