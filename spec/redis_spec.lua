-- A fleet in Redis: the real server, started here on loopback and stopped again.

local servers = require "spec.support.servers"

local missing = servers.no_redis()
if missing then return it("serves a fleet", function() pending(missing) end) end

local fleet = require "rfsm.fleet"
local helper = require "spec.helper"
local redis = require "rfsm.redis"

local EVENTS = servers.EVENTS or 2000

teardown(servers.stop_all)
after_each(helper.remove_files)

local COUNTER = servers.COUNTER

local LAMP = servers.lamp(0.05)

-- a --e_next--> a: each entry emits what it finds in fields, and changes them
local UNTIDY = [[
return rfsm.state {
  there = true, list = { 1, { 1 } },
  a = rfsm.state { entry = function(fsm, state)
    local tr, region = fsm[2], fsm.b.substates.x
    local found = { fsm.extra, state.extra, tr.extra, region.extra, fsm.there,
      #fsm.list - 1, fsm.list[2][1], tr.tgt._fqn }
    for i = 1, 8 do found[i] = tostring(found[i]) end
    fsm.emit("found", table.concat(found, " "))
    fsm.extra, state.extra, tr.extra, region.extra = 1, 1, 1, 1
    fsm.there, fsm.list[2][1], fsm.list[3], state.entry = nil, 7, 7, print
  end },
  b = rfsm.seqand { x = rfsm.state { c = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "c" } } },
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "a", events = { "e_next" } },
}]]

local function load_charts(url, ...)
  local machines = fleet.connect(url, { name = "m", tags = 4 })
  assert(machines:load(redis.bundle { ... }))
  return machines
end

describe("a fleet", function()
  local server, machines

  setup(function()
    server = servers.redis()
    machines = load_charts(server:url(), "lamp=" .. helper.file_with(LAMP),
      "counter=" .. helper.file_with(COUNTER), "untidy=" .. helper.file_with(UNTIDY))
  end)

  before_each(function() server:cli("FLUSHALL") end)

  it("creates machines, sends them events and shows them", function()
    assert.same({ leaf = "root.off", mode = "done", errors = {}, outcome = "taken" },
      machines:create(1, "lamp", { owner = "me" }))
    assert.same({ leaf = "root.on", mode = "done", outcome = "taken",
      errors = { "ENTRY error executing entry of root.on:  no bulb" } },
      machines:send(1, "e_on"))
    local view = machines:get(1)
    assert.same({ "lamp", "root.on", "done", "root root.on", {}, { root =
      { owner = "me" } } }, { view.chart, view.leaf, view.mode, view.configuration,
      view.queue, view.data })
    assert.is_number(view.due)
    assert.matches("no bulb", server:cli("XRANGE m:{" .. select(2, machines:key_of(1))
      .. "}:1:log - +"))
  end)

  it("hands on what machines emit, once more if a worker dies", function()
    machines:create(1, "lamp", { owner = "me" })
    assert.same({ 0, { "killed" } }, { machines:work("g", "w1", function()
      error("killed", 0)
    end) })
    local seen = {}
    local function note(entry)
      seen[#seen + 1] = { entry.machine, entry.what, entry.data }
    end
    assert.equal(0, machines:work("g", "w2", note))
    assert.equal(1, machines:work("g", "w2", note, { idle = 0 }))
    assert.equal(0, machines:work("g", "w2", note, { idle = 0 }))
    assert.same({ { machines:key_of(1), "off", { times = 1, owner = "me" } } },
      { { seen[1][1], seen[1][2], seen[1][3] } })
  end)

  it("shares no field that the chart does not keep", function()
    for i = 1, 3 do assert(machines:create(i, "untidy")) end
    for i = 1, 3 do assert(machines:send(i, "e_next")) end
    local seen = {}
    machines:work("g", "w", function(entry) seen[#seen + 1] = entry.data end)
    local first = "nil nil nil nil true 1 1 root.a"
    assert.same({ first, first, first, first, first, first }, seen)
  end)

  it("reports each active leaf to a watcher", function()
    machines:create(1, "lamp")
    local sender = io.popen(([[
      until redis-cli -p PORT PUBSUB SHARDCHANNELS | grep -q .; do sleep 0.02; done
      for e in e_on e_off e_on; do redis-cli -p PORT FCALL rfsm_send 1 'KEY' $e; done]])
      :gsub("PORT", server.port):gsub("KEY", (machines:key_of(1))), "r")
    local leaves = {}
    machines:watch(1, function(leaf)
      leaves[#leaves + 1] = leaf
      return #leaves == 3
    end)
    sender:close()
    assert.same({ "root.on", "root.off", "root.on" }, leaves)
  end)

  it("is whole after a callback that never ended was killed", function()
    local loop = redis.bundle { "loop=" .. helper.file_with([[
      return rfsm.state { a = rfsm.state {},
        b = rfsm.state { entry = function() while true do end end },
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = { "e_loop" } },
        rfsm.trans { src = "a", tgt = "a", events = { "e_fine" } } }]]) }
    local other = servers.redis("--busy-reply-threshold 20")
    local looping = fleet.connect(other:url())
    assert(looping:load(loop))
    assert(looping:create(1, "loop"))
    local caller = io.popen(("redis-cli -p %d FCALL rfsm_send 1 '%s' e_loop 2>&1")
      :format(other.port, (looping:key_of(1))))
    local tries = 0
    repeat tries = tries + 1 until other:cli("FUNCTION KILL") == "OK\n" or tries > 5000
    assert.matches("killed by user", caller:read("*a"))
    caller:close()
    assert.same({ leaf = "root.a", mode = "done", errors = {}, outcome = "taken" },
      looping:send(1, "e_fine"))
  end)

  it("takes each event exactly once, from many clients at once", function()
    local keys = {}
    for i = 1, 1000 do
      keys[i] = "c:{" .. i % 50 .. "}:" .. i
      assert(machines:create(keys[i], "counter"))
    end
    local answered, errors = servers.storm(server.port, 20, EVENTS,
      function(i) return keys[i * 7919 % 1000 + 1] end, "e_tick")
    assert.same({}, errors)
    local total = 0
    for i = 1, 1000 do
      local view = machines:get(keys[i])
      local count = view.data.root.n
      assert.equal(answered[keys[i]] or 0, count)
      assert.equal(count % 2 == 0 and "root.even" or "root.odd", view.leaf)
      total = total + count
    end
    assert.equal(EVENTS, total)
  end)
end)

describe("a chart in Redis", function()
  it("prints to the log of the server", function()
    local server = servers.redis()
    local machines = load_charts(server:url(), "c=" .. helper.file_with [[
return rfsm.state {
  a = rfsm.state { entry = function(fsm) print("at", fsm.a._fqn, nil) end },
  rfsm.trans { src = "initial", tgt = "a" },
}]])
    assert.same({}, machines:create(1, "c").errors)
    assert.matches("at root.a nil\n", helper.content(server.folder .. "/log"), 1, true)
  end)
end)

describe("a backup", function()
  it("is read by a new server, as doc/redis.md shows", function()
    local save, options = helper.content("doc/redis.md"):match("\n```\nredis%-cli "
      .. "%-h localhost (%-%-rdb [^\n]*)\nredis%-server ([^\n]*)\n```")
    local server = servers.redis()
    local machines = load_charts(server:url(), "lamp=" .. helper.file_with(LAMP))
    machines:create(1, "lamp", { owner = "me" })
    machines:send_once("id", 1, "e_on")
    servers.output_of(("cd %s && redis-cli -p %s %s"):format(server.folder, server.port,
      save))
    local copy = fleet.connect(servers.redis(("--dir %s %s"):format(server.folder,
      options)):url(), { name = "m", tags = 4 })
    assert.equal("known", copy:send_once("id", 1, "e_on").outcome)
    repeat local count = copy:wake() until count == 1 -- 50 ms after e_on
    assert.same({ "root.off", "me" }, { copy:get(1).leaf, copy:get(1).data.root.owner })
    assert.equal(2, (copy:work("g", "w", function() end)))
  end)
end)

describe("rfsm redis", function()
  local function run(arguments)
    return servers.output_of("tools/rfsm-redis " .. arguments)
  end

  it("writes a library, and loads it", function()
    local server = servers.redis()
    local chart, library = helper.file_with(COUNTER), helper.file_with("")
    assert.equal("", run(("c=%s -o %s --load %s"):format(chart, library, server:url())))
    assert.matches("^#!lua name=rfsm\n", helper.content(library))
    assert.equal("root.even\ndone\ntaken\n", server:cli("FCALL rfsm_create 1 x c"))
  end)

  it("reports a chart with a mistake, and loads nothing", function()
    local chart = helper.file_with("return rfsm.state { a = rfsm.state {},\n"
      .. "rfsm.trans { src = 'a', tgt = 'b' } }")
    assert.matches("^rfsm redis: " .. chart .. ":%d: root.trans%[1%].*: tgt 'b': no "
      .. "state or connector is named 'b' in 'root'[^\n]*\n$", run(chart))
    assert.equal("rfsm redis: /nowhere.lua: No such file or directory\n",
      run("/nowhere.lua"))
    assert.equal("rfsm redis: /tmp: Is a directory\n", run("/tmp"))
    assert.equal("rfsm redis: rfsm.fleet: cannot connect to 127.0.0.1:1: "
      .. "connection refused\n",
      run(helper.file_with(COUNTER) .. " --load redis://127.0.0.1:1"))
  end)
end)

if not servers.HAS_STORMS then return end

describe("a server that is killed", function()
  it("has lost no acknowledged event when it is back", function()
    local server = servers.redis("--appendonly yes --appendfsync always")
    local machines = load_charts(server:url(),
      "counter=" .. helper.file_with(COUNTER))
    for i = 1, 20 do machines:create("c:{1}:" .. i, "counter") end
    local limit = math.max(EVENTS / 4, 200)
    local answered, _, sent = servers.storm(server.port, 50, EVENTS,
      function(i) return "c:{1}:" .. i % 20 + 1 end, "e_tick", function(i)
        if i == limit then os.execute("kill -9 $(cat " .. server.folder .. "/pid)") end
      end)
    server:kill()
    server:launch()
    machines = fleet.connect(server:url())
    local lost = 0
    for key, count in pairs(answered) do
      local now = machines:get(key).data.root.n
      if now < count then lost = lost + count - now end
      assert.is_true(now <= sent[key])
    end
    assert.equal(0, lost)
  end)
end)

describe("a cluster of three nodes", function()
  local function start_cluster()
    local nodes, ids = {}, {}
    for i = 1, 3 do
      nodes[i] = servers.redis("--cluster-enabled yes --cluster-node-timeout 2000")
      ids[i] = nodes[i]:cli("CLUSTER MYID"):match("%x+")
      -- equal epochs are settled some time later, and take a moved slot back
      nodes[i]:cli("CLUSTER SET-CONFIG-EPOCH " .. i)
      nodes[i]:cli(("CLUSTER ADDSLOTSRANGE %d %d"):format((i - 1) * 5462,
        math.min(i * 5462 - 1, 16383)))
      nodes[i]:cli("CONFIG SET cluster-require-full-coverage no")
    end
    for i = 2, 3 do
      nodes[1]:cli(("CLUSTER MEET 127.0.0.1 %d"):format(nodes[i].port))
    end
    for _ = 1, 500 do
      local ready = 0
      for i = 1, 3 do
        local info = nodes[i]:cli("CLUSTER INFO")
        if info:find("cluster_state:ok", 1, true)
          and info:find("cluster_slots_assigned:16384", 1, true) then
          ready = ready + 1
        end
      end
      if ready == 3 then return nodes, ids end
      require "socket".sleep(0.02)
    end
    error("the cluster does not come together")
  end

  -- Moves a slot from the node that has it to another, in a process of its own.
  local function move_slot(nodes, ids, slot)
    local from = math.floor(slot / 5462) + 1
    local to = from % 3 + 1
    return io.popen(([[
      a="redis-cli -p %d" b="redis-cli -p %d" slot=%d
      $b CLUSTER SETSLOT $slot IMPORTING %s
      $a CLUSTER SETSLOT $slot MIGRATING %s
      while keys=$($a CLUSTER GETKEYSINSLOT $slot 1); [ -n "$keys" ]; do
        $a MIGRATE 127.0.0.1 %d "$keys" 0 5000
        sleep 0.01
      done
      $b CLUSTER SETSLOT $slot NODE %s
      $a CLUSTER SETSLOT $slot NODE %s]]):format(nodes[from].port, nodes[to].port, slot,
      ids[from], ids[to], nodes[to].port, ids[to], ids[to]))
  end

  it("loses no event while a slot moves", function()
    local nodes, ids = start_cluster()
    local machines = load_charts(nodes[1]:url(),
      "counter=" .. helper.file_with(COUNTER), "lamp=" .. helper.file_with(LAMP))
    for i = 1, 40 do assert(machines:create(i, "counter")) end
    for i = 41, 60 do assert(machines:create(i, "lamp")) end
    assert.equal(3, #machines.connection.seeds)
    local _, tag = machines:key_of(1)
    local slot = tonumber(nodes[1]:cli("CLUSTER KEYSLOT {" .. tag .. "}"))
    local before = machines:get(1)
    assert.equal("root.even", before.leaf)
    local mover
    for round = 1, 6 do
      if round == 2 then mover = move_slot(nodes, ids, slot) end
      for i = 1, 40 do assert(machines:send(i, "e_tick")) end
      local event = round % 2 == 1 and "e_on" or "e_off"
      for i = 41, 60 do assert(machines:send(i, event)) end
    end
    mover:close()
    for i = 1, 40 do assert.equal(6, machines:get(i).data.root.n) end
    for i = 41, 60 do assert.equal("root.off", machines:get(i).leaf) end
    local owner = math.floor(slot / 5462) % 3 + 2
    assert.matches("^%d", nodes[(owner - 1) % 3 + 1]:cli(
      "CLUSTER COUNTKEYSINSLOT " .. slot))
  end)
end)

describe("the warehouse", function()
  -- Runs it on a server of its own; returns what it prints.
  local function fleet_of(arguments)
    return servers.output_of("LUA_INIT= examples/warehouse/fleet.sh " .. arguments)
  end

  it("takes a new version of its orders while it works", function()
    local output = fleet_of "lua5.1 40 upgrade"
    assert.matches("\nin root.packing: moves to root.wrapping\n", output)
    assert.matches("\nin root.received: moves to root.received\n"
      .. "  timer e_after%(3%)@root.received is dropped\n", output)
    -- on a slow machine orders that are not paid are cancelled in the meantime
    assert.matches("orders have moved at their next event\n0 are left; 30 shipped, %d+ "
      .. "received\n$", output)
  end)

  it("ships what is paid for, in one command", function()
    local output = fleet_of "lua5.3 8"
    assert.matches("order:{%d}:1 +pick nuts %-> e_picked\n", output)
    assert.matches("\n6 shipped, 2 cancelled\n$", output)
  end)
end)
