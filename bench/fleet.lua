-- Machines in Redis:  LUA bench/fleet.lua [MACHINES [ROUNDS]]
--
-- Microseconds of the server's processor for a call, pipelined by 32, and calls in a
-- second of it: the least of some rounds in turn. Events for machines of 20 states,
-- with an id, with a timer in each state; next to them an EVAL that unpacks a value of
-- the same size and packs it again, and HSET. Then timers that are due at once, an idle
-- loop of a worker, and the memory that a machine takes.

package.path = "./?.lua;" .. package.path

local fleet = require "rfsm.fleet"
local helper = require "spec.helper"
local redis = require "rfsm.redis"
local servers = require "spec.support.servers"

local CALLS, TAGS = 10000, 64
local machines, rounds = tonumber(arg[1]) or 1000, tonumber(arg[2]) or 5
local few = math.min(machines, 1000) -- that the events are for

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

-- waiting --1 ms--> done
local DUE = [[
return rfsm.state {
  waiting = rfsm.state {}, done = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "waiting" },
  rfsm.trans { src = "waiting", tgt = "done", events = { "e_after(0.001)" } },
}]]

local chart = helper.file_with(CHART)
local timed = helper.file_with((CHART:gsub('events = { "e_next" } }',
  'events = { "e_next", "e_after(1000)" } }')))
local due = helper.file_with(DUE)
local library = helper.file_with((redis.bundle { "area=" .. chart, "timed=" .. timed,
  "due=" .. due }))
local server = servers.redis("--maxmemory 0")
assert(server:cli("-x FUNCTION LOAD REPLACE <" .. library):find("rfsm"))

local function info(section, field)
  return tonumber(server:cli("INFO " .. section):match(field .. ":([%d.]+)"))
end

local function cpu()
  return info("cpu", "used_cpu_user") + info("cpu", "used_cpu_sys")
end

-- Microseconds of the server while `f` runs, for each of so many calls.
local function cost(calls, f)
  local before = cpu()
  f()
  return (cpu() - before) / calls * 1e6
end

local function benchmark(keys, command)
  local answer = server:cli((" PING >/dev/null; redis-benchmark -p %d -q -c 20 -P 32 "
    .. "-n %d -r %d %s"):format(server.port, CALLS, keys, command))
  assert(not answer:find("rror"), answer)
end

local function pipe(lines)
  server:cli("--pipe <" .. helper.file_with(table.concat(lines)))
end

-- Makes a machine, and copies of it; redis-benchmark names the keys.
local function populate(name, mark, count)
  server:cli(("FCALL rfsm_create 1 %s:000000000000 %s"):format(mark, name))
  local lines = {}
  for i = 1, count - 1 do
    lines[i] = ("COPY %s:000000000000 %s:%012d\n"):format(mark, mark, i)
  end
  pipe(lines)
end

local VALUE = ("x"):rep(96)
local SCRIPT = [[local v = redis.call("GET", KEYS[1]) ]]
  .. [[if v then cmsgpack.unpack(v) end redis.call("SET", KEYS[1], ]]
  .. [[cmsgpack.pack({ "rfsm", "area", { version = 2, ]]
  .. [[chart = "844974cfc38-e0429e", leaf = "root.area1.station2", done = true, ]]
  .. [[data = { root = { order = "A-4711", count = 13 } } } })) return 1]]

local COMMANDS = {
  { name = "EVAL", text = ("EVAL '%s' 1 v:__rand_int__"):format(SCRIPT) },
  { name = "HSET", text = "HSET h:__rand_int__ value " .. VALUE },
  { name = "rfsm_send", text = "FCALL rfsm_send 1 m:__rand_int__ e_next" },
  { name = "with id", text = "FCALL rfsm_send 1 i:__rand_int__ e_next ID "
    .. "i:__rand_int__" },
  { name = "with timers", text = "FCALL rfsm_send 1 t:__rand_int__ e_next" },
}

local function print_rates()
  for _ = 1, rounds do
    for _, command in ipairs(COMMANDS) do
      local us = cost(CALLS, function() benchmark(few, command.text) end)
      command.us = math.min(command.us or us, us)
    end
  end
  print("| call | us | a second | of an EVAL |\n|---|---|---|---|")
  for _, command in ipairs(COMMANDS) do
    print(("| %s | %.1f | %.0f | %.1f |"):format(command.name, command.us,
      1e6 / command.us, command.us / COMMANDS[1].us))
  end
end

-- Machines whose timers are all due, woken by one worker; then it finds none.
local function print_timers()
  local worker = fleet.connect(server:url(), { name = "w", tags = TAGS })
  local lines, woken = {}, 0
  for i = 0, machines - 1 do
    local tag = i % TAGS
    local key = ("w:{%d}:%d"):format(tag, i)
    if i < TAGS then
      assert(worker:create(key, "due"))
    else
      lines[#lines + 1] = ("COPY w:{%d}:%d %s\n"):format(tag, tag, key)
    end
    lines[#lines + 1] = ("ZADD rfsm:due:{%d} 1 %s\n"):format(tag, key)
  end
  pipe(lines)
  local us = cost(machines, function()
    repeat
      local count = worker:wake()
      woken = woken + count
    until count == 0
  end)
  print(("%d timers due at once: %d woken, %.1f us of the server each"):format(machines,
    woken, us))
  local own = os.clock()
  us = cost(200, function()
    for _ = 1, 200 do worker:wake() end
  end)
  print(("an idle loop over %d tags: %.2f ms of the server, %.2f ms of the worker")
    :format(TAGS, us / 1000, (os.clock() - own) * 5))
end

local function main()
  local empty = info("memory", "used_memory")
  populate("area", "m", machines)
  print(("%d machines of %d bytes: %.0f bytes of memory each"):format(machines,
    tonumber(server:cli("STRLEN m:000000000000"):match("%d+")),
    (info("memory", "used_memory") - empty) / machines))
  populate("area", "i", few)
  populate("timed", "t", few)
  print_rates()
  print_timers()
end

local ok, problem = pcall(main)
servers.stop_all()
helper.remove_files()
if not ok then error(problem, 0) end
