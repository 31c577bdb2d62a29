-- A fleet in Redis: each event once, errors that change nothing, workers that fail, a
-- client that must reconnect, and what an operator asks.

local servers = require "spec.support.servers"

local missing = servers.no_redis()
if missing then return it("serves a fleet", function() pending(missing) end) end

local fleet = require "rfsm.fleet"
local helper = require "spec.helper"
local json = require "rfsm.server.codec"
local load_text = require("rfsm.shared.calls").load
local redis = require "rfsm.redis"
local rfsm = require "rfsm"
local share = require "spec.support.share"
local snapshot = require "rfsm.snapshot"

teardown(servers.stop_all)
after_each(helper.remove_files)

local COUNTER = servers.COUNTER

-- a --1 hour--> b, and a --e_emit--> a, which emits; --e_long--> c { d }
local TIMED = [[
return rfsm.state {
  keep = { "n" }, n = 0,
  a = rfsm.state {}, b = rfsm.state {},
  c = rfsm.state { d = rfsm.state {}, rfsm.trans { src = "initial", tgt = "d" } },
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_after(3600)", "e_b" } },
  rfsm.trans { src = "b", tgt = "a", events = { "e_back" } },
  rfsm.trans { src = "a", tgt = "c", events = { "e_long" } },
  rfsm.trans { src = "a", tgt = "internal", events = { "e_emit" },
    effect = function(fsm)
      fsm.n = fsm.n + 1
      fsm.emit("done", { n = fsm.n })
    end },
}]]

-- due at once, and again and again
local RESTLESS = [[
return rfsm.state {
  keep = { "n" }, n = 0,
  a = rfsm.state { entry = function(fsm) fsm.n = fsm.n + 1 end },
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "a", events = { "e_after(0)" } },
}]]

local server

local function library(options, charts)
  local arguments = {}
  for name, text in pairs(charts or { counter = COUNTER, timed = TIMED,
    restless = RESTLESS }) do
    arguments[#arguments + 1] = name .. "=" .. helper.file_with(text)
  end
  return (redis.bundle(arguments, options))
end

local function connect(options)
  options = options or {}
  options.name, options.tags = "m", 1
  return fleet.connect(server:url(), options)
end

local machines

local usual, loaded

setup(function()
  server = servers.redis()
  usual = library { index = true, history = 3 }
end)

before_each(function()
  server:cli("FLUSHALL")
  machines = connect()
  local load = machines.load
  function machines:load(text)
    loaded = text
    return load(self, text)
  end
  if loaded ~= usual then assert(machines:load(usual)) end
end)

-- The key of a machine, as the shell takes it.
local function key_of(id) return "'" .. machines:key_of(id) .. "'" end

local function count_of(id) return machines:get(id).data.root.n end

-- Returns the output of a call in one line.
local function call(...)
  return (server:cli("FCALL " .. table.concat({ ... }, " ")):gsub("\n$", "")
    :gsub("\n", " "))
end

describe("an event with an id", function()
  it("that the client sends again is applied once", function()
    local other = servers.redis("--appendonly yes --appendfsync always")
    local twice = fleet.connect(other:url(), { name = "m", tags = 1 })
    assert(twice:load(library()))
    assert(twice:create(1, "counter"))
    for _ = 1, 3 do
      assert(twice:send(1, "e_tick"))
      other:kill()
      other:launch()
    end
    assert(twice:send(1, "e_tick"))
    assert.equal(0, (twice:wake()))
    assert.equal(4, twice:get(1).data.root.n)
  end)
end)

describe("an error changes nothing:", function()
  -- Spoils something, sends an event, and returns the error; the machine has not moved.
  local function refusal(spoil, event)
    assert(machines:create(1, "timed"))
    local before = server:cli("DUMP " .. key_of(1))
    spoil((machines:key_of(1)))
    local reply, problem = machines:send(1, event)
    assert.is_nil(reply)
    assert.equal(before, server:cli("DUMP " .. key_of(1)))
    return problem
  end

  for _, case in ipairs {
    { what = "a stream of another type", key = "rfsm:out:{0}", event = "e_emit",
      kind = "stream" },
    { what = "a due set of another type", key = "rfsm:due:{0}", event = "e_b",
      is_first = true },
    { what = "an index of another type", key = "rfsm:in:{0}", event = "e_b",
      kind = "zset" },
    { what = "a history of another type", key = "m:{0}:1:history", event = "e_b",
      kind = "stream" },
  } do
    it(case.what, function()
      assert.equal(case.is_first and ("ERR rfsm_send: ZREM %s: WRONGTYPE Operation "
        .. "against a key holding the wrong kind of value"):format(case.key)
        or ("ERR rfsm_send: %s expected at '%s', got string"):format(case.kind,
        case.key), refusal(function()
          server:cli("DEL '" .. case.key .. "'")
          server:cli("SET '" .. case.key .. "' x")
        end, case.event))
    end)
  end

  for _, case in ipairs {
    { what = "no right to add to the stream", rule = "-xadd", event = "e_emit",
      text = "XADD rfsm:out:{0}" },
    { what = "no right to remove", rule = "-zrem", event = "e_long",
      text = "ZREM rfsm:in:{0}" },
    { what = "no right to publish at all", rule = "-spublish", event = "e_long",
      text = "SPUBLISH rfsm:{0}:m:{0}:1" },
  } do
    it(case.what, function()
      assert(machines:create(1, "timed"))
      local before = server:cli("DUMP " .. key_of(1))
      server:cli("ACL SETUSER worker reset on '>pass%word' +@all '~*' '&*' "
        .. case.rule)
      local url = server:url():gsub("//", "//worker:pass%%25word@") .. "/0"
      local worker = fleet.connect(url, { name = "m", tags = 1 })
      assert.same({ nil, "ERR rfsm_send: no right to do " .. case.text },
        { worker:send(1, case.event) })
      assert.equal(before, server:cli("DUMP " .. key_of(1)))
      server:cli("ACL DELUSER worker")
    end)
  end
end)

describe("consumer groups", function()
  -- Makes machines that have emitted once.
  local function emit(count)
    for i = 1, count do
      assert(machines:create(i, "timed"))
      assert(machines:send(i, "e_emit"))
    end
  end

  it("get each entry, whatever the others have done", function()
    machines:work("a", "w", function() end)
    machines:work("b", "w", function() end)
    emit(5)
    for _, group in ipairs { "a", "b" } do
      assert.equal(5, (machines:work(group, "w", function() end)))
    end
    assert.equal("0\n", server:cli("XLEN rfsm:out:{0}")) -- both have done all
  end)

  it("keep what one of them has not done", function()
    machines:work("a", "w", function() end)
    machines:work("b", "w", function() end)
    emit(3)
    local seen = 0
    machines:work("a", "w", function() end)
    machines:work("b", "w", function()
      seen = seen + 1
      if seen == 2 then error("no", 0) end
    end)
    assert.equal("2\n", server:cli("XLEN rfsm:out:{0}")) -- from the one that failed on
  end)

  it("keep no entry that has died, or ended by done, before another one", function()
    emit(2)
    local function fail() error("no", 0) end
    machines:work("g", "w", fail, { tries = 1 })
    assert.equal("0\n", server:cli("XLEN rfsm:out:{0}"))
    for _, dead in ipairs(machines:dead()) do machines:again(dead.tag, dead.id) end
    for _, entry in ipairs(machines:take("g", "w")) do assert(machines:done(entry)) end
    assert.same({}, machines:take("g", "w"))
    assert.equal("0\n", server:cli("XLEN rfsm:out:{0}"))
    for i = 1, 2 do assert(machines:send(i, "e_emit")) end
    for _, entry in ipairs(machines:take("g", "w")) do assert(machines:done(entry)) end
    assert.same({}, connect():take("g", "w")) -- the worker has ended meanwhile
    assert.equal("0\n", server:cli("XLEN rfsm:out:{0}"))
  end)

  it("are not held up by an entry that fails, which ends in a stream", function()
    emit(4)
    local function work(entry)
      if entry.machine:find(":2$") then error("poison", 0) end
    end
    assert.same({ 3, { "poison" } }, { machines:work("g", "w", work, { idle = 0,
      tries = 3 }) })
    for _ = 1, 4 do machines:work("g", "w", work, { idle = 0, tries = 3 }) end
    local dead = server:cli("XRANGE rfsm:dead:{0} - +")
    assert.matches("machine\nm:{0}:2\nwhat\ndone\n.*group\ng\n.*deliveries\n3\nerror\n"
      .. "poison", dead)
    assert.equal("1\n", server:cli("XLEN rfsm:dead:{0}"))
    assert.equal(0, tonumber(server:cli("XPENDING rfsm:out:{0} g"):match("%d+")))
  end)

  it("try an entry five times", function()
    emit(1)
    local function fail() error("no", 0) end
    for _ = 1, 5 do
      assert.equal("0\n", server:cli("XLEN rfsm:dead:{0}"))
      machines:work("g", "w", fail, { idle = 0 })
    end
    assert.equal("1\n", server:cli("XLEN rfsm:dead:{0}"))
  end)

  it("do not try an entry again that each of its workers has died of", function()
    emit(1)
    local calls, output = 0, {}
    local function die()
      calls = calls + 1
      error("interrupted!", 0)
    end
    for i = 1, 5 do
      output[i] = { pcall(machines.work, machines, "g", "w" .. i, die, { idle = 0,
        tries = 3 }) }
    end
    assert.equal(3, calls)
    assert.same({ { false, "interrupted!" }, { true, 0, { "no worker has finished it" }
      }, { true, 0, {} } }, { output[3], output[4], output[5] })
    assert.matches("machine\nm:{0}:1\nwhat\ndone\n.*deliveries\n3\nerror\nno worker "
      .. "has finished it\n$", server:cli("XRANGE rfsm:dead:{0} - +"))
    assert.equal("0", server:cli("XPENDING rfsm:out:{0} g"):match("%d+"))
  end)

  -- Returns the function of a worker that answers the first entry of a machine, and, if
  -- it is to die, is killed after that.
  local function answer(is_to_die)
    return function(entry)
      if entry.data.n > 1 then return end
      assert(machines:send_once(entry.id, entry.machine, "e_emit"))
      if is_to_die then error("interrupted!", 0) end
    end
  end

  it("apply the answer to an entry once, each its own", function()
    for _, group in ipairs { "a", "b" } do machines:work(group, "w", print) end
    emit(1)
    for i, group in ipairs { "a", "b" } do
      assert.is_false((pcall(machines.work, machines, group, "w", answer(true))))
      assert.equal(1 + i, count_of(1))
      machines:work(group, "v", answer(false), { idle = 0 })
      assert.equal(1 + i, count_of(1))
    end
  end)

  it("have other ids for the entries of other hash tags", function()
    local spread = fleet.connect(server:url(), { name = "m", tags = 2 })
    local ids = {}
    for tag = 0, 1 do
      server:cli("XADD rfsm:out:{" .. tag .. "} 5-0 machine m what w data ''")
    end
    spread:work("g", "w", function(entry) ids[#ids + 1] = entry.id end)
    assert.same({ "g:0:5-0", "g:1:5-0" }, ids)
  end)

  it("apply an answer once with the loop of doc/redis.md", function()
    emit(1)
    local robots, has_died = { wake = function() return 0 end }, false
    function robots.work(_, group, worker, f)
      return machines:work(group, worker, f, { idle = 0 })
    end
    for _, name in ipairs { "send", "send_once" } do
      robots[name] = function(_, ...)
        local reply, problem = machines[name](machines, ...)
        if has_died then return reply, problem end
        has_died = true
        error("interrupted!", 0)
      end
    end
    local text = helper.content("doc/redis.md"):match("\n```\n(repeat\n.-)```")
    local loop = assert(load_text(text, "=loop", { robots = robots, assert = assert,
      do_it = function(_, data) return data.n == 1 and "e_emit" or "e_b" end,
      socket = { sleep = function() error("over", 0) end } }))
    assert.same({ false, "interrupted!" }, { pcall(loop) })
    assert.same({ false, "over" }, { pcall(loop) })
    assert.same({ 2, "root.b" }, { count_of(1), machines:get(1).leaf })
  end)

  it("take entries, and end each by done or fail", function()
    emit(2)
    local entries = machines:take("g", "w")
    local first, second = entries[1], entries[2]
    assert.same({ {}, {} }, { machines:take("g", "v") })
    assert.is_true(machines:done(first))
    assert.is_false(machines:fail(second, "no stock"))
    assert.same({ { second }, {} }, { machines:take("g", "v", { idle = 0 }) })
    local again = machines:take("g", "v", { idle = 0, tries = 3 })[1]
    assert.is_true(machines:fail(again, "no stock"))
    assert.same({ second.machine, "no stock" }, { machines:dead()[1].machine,
      machines:dead()[1].error })
    assert.same({ "rfsm.fleet.done: an entry of take expected, got table" },
      { (select(2, pcall(machines.done, machines, {})):gsub("^%S+:%d+: ", "")) })
    assert.matches("rfsm.fleet.take: names of a group and of a worker expected, got g "
      .. "and nil$", select(2, pcall(machines.take, machines, "g")))
    assert.is_false(machines:drop(nil, "1-1"))
  end)

  it("see that an answer was dropped", function()
    emit(1)
    local entry = machines:take("g", "w")[1]
    assert.same({ nil, "rfsm.fleet.answer: dropped in root.a" },
      { machines:answer(entry, "e_back") })
    assert.equal("taken", machines:answer(entry, "e_b").outcome)
    assert.equal("known", machines:answer(entry, "e_b").outcome)
    assert.matches("no machine is at", select(2, machines:answer({ id = "x",
      machine = "{0}gone" }, "e_b")))
  end)

  it("count an answer once, though its entry died and was sent again", function()
    for _, group in ipairs { "g", "other" } do machines:work(group, "w", print) end
    emit(1)
    machines:work("g", "w", function(entry)
      assert(machines:answer(entry, "e_emit"))
      error("no mail", 0)
    end, { tries = 1 })
    local dead = machines:dead()[1]
    assert.is_true(machines:again(dead.tag, dead.id))
    for _ = 1, 2 do -- once more it dies
      local ids = {}
      machines:work("g", "w", function(entry)
        ids[#ids + 1] = entry.id
        if entry.data.n == 1 then assert(machines:answer(entry, "e_emit")) end
        if #ids == 1 and entry.data.n == 1 then error("no mail", 0) end
      end, { tries = 1 })
      dead = machines:dead()[1] or dead
      machines:again(dead.tag, dead.id)
    end
    assert.equal(2, count_of(1))
    local others = {}
    machines:work("other", "w", function(entry) others[#others + 1] = entry.data.n end)
    assert.same({ 1, 2 }, others)
    assert.equal("0\n", server:cli("XLEN rfsm:dead:{0}"))
  end)

  it("do not acknowledge an entry to a node that may not know the answer", function()
    local master = servers.redis()
    local replica = servers.redis("--repl-diskless-sync-delay 0 --replicaof 127.0.0.1 "
      .. master.port)
    local url = { master:url(), replica:url() }
    local both = fleet.connect(url, { name = "m", tags = 1 })
    assert(both:load(library()))
    assert(both:create(1, "timed"))
    assert(both:send(1, "e_emit"))
    for _ = 1, 500 do
      if both:call("0", "WAIT", 1, 1000) == 1
        and replica:cli("GET m:{0}:1") == master:cli("GET m:{0}:1") then break end
    end
    local calls = 0
    local function work(entry)
      calls = calls + 1
      if calls == 1 then replica:cli("REPLICAOF NO ONE") end
      assert(both:send_once(entry.id, entry.machine, "e_b"))
      if calls == 1 then servers.stop(master) end
    end
    assert.equal(0, (both:work("g", "w", work, { idle = 0 })))
    assert.equal("root.a", both:get(1).leaf)
    assert.equal(1, (both:work("g", "w", work, { idle = 0 })))
    assert.equal("root.b", both:get(1).leaf)
    servers.stop(replica)
  end)

  it("report a stream of another type", function()
    server:cli("SET 'rfsm:out:{0}' x")
    local _, problem = pcall(machines.work, machines, "g", "w", print)
    assert.matches("^WRONGTYPE", problem)
  end)

  it("try an entry again after twice the time", function()
    emit(1)
    local tries = 0
    local function work()
      tries = tries + 1
      error("no", 0)
    end
    machines:work("g", "w", work, { idle = 100000 })
    machines:work("g", "v", work, { idle = 100000 })
    assert.equal(1, tries)
    server:cli("XCLAIM rfsm:out:{0} g w 0 " .. server:cli("XRANGE rfsm:out:{0} - +")
      :match("%d+%-%d+") .. " IDLE 150000 RETRYCOUNT 2 JUSTID")
    machines:work("g", "v", work, { idle = 100000 })
    assert.equal(1, tries, "the second time is due after 200 s")
    server:cli("XCLAIM rfsm:out:{0} g w 0 " .. server:cli("XRANGE rfsm:out:{0} - +")
      :match("%d+%-%d+") .. " IDLE 250000 RETRYCOUNT 2 JUSTID")
    machines:work("g", "v", work, { idle = 100000 })
    assert.equal(2, tries)
  end)

end)

describe("machines that are due", function()
  it("that cannot be run are put aside, and do not hold up others", function()
    assert(machines:load(library(nil, { restless = RESTLESS, old = RESTLESS })))
    for i = 1, 20 do assert(machines:create("old" .. i, "old")) end
    for i = 1, 3 do assert(machines:create(i, "restless")) end
    assert(machines:load(library(nil, { restless = RESTLESS })))
    local count, failed = machines:wake(20)
    for _ = 1, 3 do
      local more, others = machines:wake(20)
      count, failed = count + more, failed + others
    end
    assert.is_true(count >= 3)
    assert.equal(20, failed)
    assert.equal("20\n", server:cli("ZCARD rfsm:aside:{0}"))
    assert.matches("no chart is named 'old'", server:cli("XRANGE m:{0}:old7:log - +"))
    -- when the chart is back they run again
    assert(machines:load(library(nil, { restless = RESTLESS, old = RESTLESS })))
    assert(machines:tick("old7"))
    assert.equal("19\n", server:cli("ZCARD rfsm:aside:{0}"))
  end)
end)

describe("a callback that never ends", function()
  local hung, worker

  setup(function()
    hung = servers.redis("--busy-reply-threshold 50")
    worker = fleet.connect(hung:url(), { name = "m", tags = 1 })
    assert(worker:load(servers.with_clock(library({ index = true },
      { endless = servers.ENDLESS }))))
  end)

  before_each(function()
    hung:cli("FLUSHALL")
    hung:stop_clock(1000)
    assert(worker:create("bad", "endless", { bad = true }))
    for i = 1, 3 do assert(worker:create(i, "endless")) end
    hung:stop_clock(1001)
  end)

  -- Calls rfsm_wake so many times, and kills each call that does not end.
  local function wake(count)
    servers.output_of(([[
      for i in $(seq %d); do
        timeout 20 redis-cli -p %s FCALL rfsm_wake 1 {0} & call=$!
        for try in $(seq 500); do
          kill -0 $call && redis-cli -p %s FUNCTION KILL || break
        done
        wait $call
      done]]):format(count, hung.port, hung.port))
  end

  it("costs one machine one lease, not the others, and can be killed", function()
    wake(6)
    assert.same({ "m:{0}:1", "m:{0}:2", "m:{0}:3" }, worker:find("endless", "root.b"))
    assert.equal("root.a", worker:get("bad").leaf)
    assert.equal("1\n", hung:cli("ZSCORE rfsm:lease:{0} m:{0}:bad"))
    assert.equal("1011\n", hung:cli("ZSCORE rfsm:due:{0} m:{0}:bad"))
  end)

  it("costs it three leases, then the machine is held", function()
    for i = 1, 3 do
      wake(6)
      hung:stop_clock(1000 + 12 * i)
    end
    assert.same({ 0, 1 }, { worker:wake() })
    assert.equal("yes", worker:get("bad").held)
    assert.equal("1\n", hung:cli("ZCARD rfsm:aside:{0}"))
    assert.matches("3 calls that ran what is due have not ended: held until it is "
      .. "released", hung:cli("XRANGE m:{0}:bad:log - +"))
    assert.equal("kept", worker:send("bad", "e_b").outcome)
    assert.same({ 0, 0 }, { worker:wake() })
    assert(worker:force("bad", "root.b"))
  end)

  it("costs the same if the server is killed in it", function()
    local killed = servers.redis("--appendonly yes --appendfsync always")
    local other = fleet.connect(killed:url(), { name = "m", tags = 1 })
    assert(other:load(library({ index = true }, { endless = servers.ENDLESS })))
    assert(other:create("bad", "endless", { bad = true }))
    assert(other:create(1, "endless"))
    killed:cli("FCALL rfsm_wake 1 {0}")
    local finish = servers.beside(("timeout 20 redis-cli -p %s FCALL rfsm_wake 1 {0}")
      :format(killed.port))
    killed:kill()
    finish()
    killed:launch()
    assert.same({ 1, 0 }, { other:wake() })
    assert.same({ "m:{0}:1" }, other:find("endless", "root.b"))
    servers.stop(killed)
  end)
end)

describe("an event of a time", function()
  it("is taken back", function()
    assert(machines:create(1, "counter"))
    local ticket = assert(machines:send_after(1, 1000, "e_tick"))
    assert.is_number(machines:get(1).due)
    assert.is_true(machines:cancel(1, ticket))
    assert.is_false(machines:cancel(1, ticket))
    assert.is_nil(machines:get(1).due)
  end)
end)

describe("an operator", function()
  it("gets data as plain JSON, and null is nil", function()
    call("rfsm_create 1 {0}:x counter", [['{"n":5,"list":{"n":1.5,"a":[1,null]}}']])
    local data = machines:get("{0}:x").data
    assert.same({ n = 5, list = { n = 1.5, a = { 1 } } }, data.root)
    assert.equal("root.odd", machines:send("{0}:x", "e_tick").leaf)
    assert.same({ n = 6, list = { n = 1.5, a = { 1 } } }, machines:get("{0}:x").data
      .root)
  end)

  it("gives data to a machine, also a field n", function()
    local data = { n = 5, list = { n = 2, { n = 1.5, "x" } } }
    assert(machines:create(1, "counter", data))
    assert.same({ n = 5, list = { n = 2, ["1"] = { n = 1.5, ["1"] = "x" } } },
      machines:get(1).data.root)
    assert.equal("root.odd", machines:send(1, "e_tick").leaf)
    assert(machines:create(2, "counter", {}))
    assert.matches("^rfsm.fleet.create: data: .*function",
      (select(2, machines:create(3, "counter", { n = print }))))
    assert.is_nil((machines:get(3)))
  end)

  it("finds and counts machines whose keys begin with any byte", function()
    local keys = { "\1{0}", "\t{0}", "\254{0}", "\255{0}", "\255\255{0}" }
    for _, key in ipairs(keys) do assert(machines:create(key, "timed")) end
    assert.same(keys, machines:find("timed", "root.a"))
    local output = servers.output_of("timeout 5 redis-cli -p " .. server.port
      .. " FCALL rfsm_stats 1 {0}")
    server:cli("FUNCTION KILL") -- it may go on
    assert.matches("^timed root.a 5 5 0 0 0 0 ", (output:gsub("\n", " ")))
  end)

  for name, text in pairs { rename = "{ ['root.odd'] = 'root.uneven' }",
    migrate = "function(snap) snap.leaf = 'root.uneven' end" } do
    it("finds a machine after a " .. name .. ", and sees that as a move", function()
      assert(machines:create(1, "counter"))
      machines:send(1, "e_tick")
      local new = COUNTER:gsub("odd", "uneven")
        :gsub("n = 0,", "%0 " .. name .. " = " .. text .. ",")
      assert(machines:load(library({ index = true, history = 3 }, { counter = new })))
      machines:tick(1)
      assert.same({ {}, { (machines:key_of(1)) } }, { machines:find("counter",
        "root.odd"), machines:find("counter", "root.uneven") })
      local move = machines:history(1, 1)[1]
      assert.same({ "(time)", "root.odd", "root.uneven" }, { move.event, move.from,
        move.to })
      machines:send(1, "e_tick")
      assert.matches("^counter root.even 1 0 0 0 0 0", call("rfsm_stats 1 {0}"))
    end)
  end

  it("counts a machine once whose key another had before DEL", function()
    assert(machines:create(1, "timed"))
    machines:send(1, "e_b")
    server:cli("DEL " .. key_of(1))
    assert(machines:create(1, "counter"))
    assert.same({}, machines:find("timed", "root"))
    assert.matches("^counter root.even 1 0 0 0 0 0 ", call("rfsm_stats 1 {0}"))
  end)

  it("counts machines by state", function()
    assert(machines:load(usual)) -- without the counters of other tests
    for i = 1, 4 do assert(machines:create(i, "timed")) end
    machines:send(1, "e_b")
    machines:send(2, "e_emit")
    machines:send(2, "e_back") -- dropped
    local version = machines:get(1).version:gsub("%-", "%%-")
    assert.equal([[
# TYPE rfsm_aside gauge
rfsm_aside 0
# TYPE rfsm_dead gauge
rfsm_dead 0
# TYPE rfsm_dropped_total counter
rfsm_dropped_total{chart="timed"} N
# TYPE rfsm_entries gauge
rfsm_entries 1
# TYPE rfsm_events_total counter
rfsm_events_total{chart="timed"} N
# TYPE rfsm_machines gauge
rfsm_machines{chart="timed",state="root.a"} 3
rfsm_machines{chart="timed",state="root.b"} 1
# TYPE rfsm_oldest_entry_seconds gauge
rfsm_oldest_entry_seconds 0
# TYPE rfsm_oldest_timer_seconds gauge
rfsm_oldest_timer_seconds 0
# TYPE rfsm_overdue gauge
rfsm_overdue 0
# TYPE rfsm_timers gauge
rfsm_timers 3
# TYPE rfsm_version_machines gauge
rfsm_version_machines{chart="timed",known="newest",version="VERSION"} 4
]], ((table.concat(helper.lines_of("tools/rfsm redis --stats " .. server:url()), "\n")
      .. "\n"):gsub('[^\n]*chart="counter"[^\n]*\n', "") -- of another spec
      :gsub(version, "VERSION"):gsub("(entry_seconds) [%d.]+", "%1 0")
      :gsub("(total{[^}]*}) %d+", "%1 N")))
    local function events()
      local text = machines:stats()
      return tonumber(text:match('events_total{chart="timed"} (%d+)')),
        tonumber(text:match('dropped_total{chart="timed"} (%d+)'))
    end
    local count, dropped = events()
    machines:send(2, "e_back")
    machines:send(2, "e_b")
    machines:tick(2)
    assert.same({ count + 2, dropped + 1 }, { events() })
  end)
end)

describe("rfsm fleet", function()
  local function fleet_command(...)
    return servers.output_of("env -u USER -u LOGNAME tools/rfsm fleet --tags 1 "
      .. server:url() .. " " .. table.concat({ ... }, " "))
  end

  it("finds, holds, forces and ends machines", function()
    local key = key_of(1)
    assert(machines:create(1, "timed"))
    assert.equal("m:{0}:1 root.a (hold: broken) by ann\n",
      fleet_command("hold", key, "broken", "--by ann"))
    assert.equal("root.a done kept\n", fleet_command("send", key, "e_b"))
    assert.equal("rfsm fleet: ERR rfsm_hold: the machine at " .. key
      .. " is held already\n", fleet_command("hold", key))
    assert.matches("^[%d.]+ e_b %(waits%): root.a %-> root.a\n[%d.]+ %(hold: broken%) "
      .. "by ann: root.a %-> root.a\n", fleet_command("history", key))
    assert.equal("m:{0}:1 root.b (release)\n", fleet_command("release", key))
    assert.equal("m:{0}:1 timed root.b\nrfsm fleet: 1 found, nothing was done\n",
      fleet_command("force", key, "root.a", "--dry-run"))
    assert.equal("m:{0}:1 root.a (force) by bob\n",
      fleet_command("force", key, "root.a", "--by bob"))
    assert.matches("chart: timed\n.*leaf: root.a\n", fleet_command("get", key))
    assert.matches("^[%d.]+ %(force%) by bob: root.b %-> root.a\n[%d.]+ e_b: root.a "
      .. "%-> root.b\n[%d.]+ %(release%): root.a %-> root.a\n",
      fleet_command("history", key))
    assert.matches("^no transition would be taken on e_back in root.a\n",
      fleet_command("why", key, "e_back"))
    assert.equal(key:gsub("'", "") .. "\n", fleet_command("find", "timed", "root.a"))
    assert.equal("rfsm fleet: 0 machines of chart 'timed' are in 'root.a' for so "
      .. "long\n", fleet_command("find", "timed", "root.a", "9", "60"))
    assert.equal("rfsm fleet: 0 machines of chart 'timd' are in 'root.a' (did you mean "
      .. "'timed'?)\n", fleet_command("find", "timd", "root.a"))
    assert.equal("rfsm fleet: 0 machines of chart 'timed' are in 'root.cc' (did you "
      .. "mean 'root.c'?)\n", fleet_command("find", "timed", "root.cc"))
    assert.equal("rfsm fleet: 0 machines of chart 'timed' are in 'root.b'\n",
      fleet_command("find", "timed", "root.b"))
    assert.equal("m:{0}:1 timed root.a (remove)\n", fleet_command("remove", key))
    assert.equal("rfsm fleet: it is not there\n", fleet_command("remove", key))
    assert.equal("", server:cli("KEYS '*'"):gsub("%s", ""))
  end)

  it("shows the log, what is due, and the versions", function()
    local old = { timed = TIMED }
    assert(machines:load(library({ index = true }, old)))
    for i = 1, 2 do assert(machines:create(i, "timed")) end
    local version = machines:get(1).version
    assert.equal("timed newest " .. version .. " 2\n", fleet_command("versions"))
    assert(machines:load(redis.bundle { "timed=" .. helper.file_with(TIMED), "timed="
      .. helper.file_with((TIMED:gsub("keep", "rename = {}, more = rfsm.state {}, keep")
      )) }))
    assert.equal("m:{0}:2 root.a (move)\n", fleet_command("move", "m:{0}:2"))
    assert.equal(("timed bundled %s 1\ntimed newest %s 1\n"):format(version,
      machines:get(2).version), fleet_command("versions"))
    assert(machines:load(library(nil, { counter = COUNTER })))
    assert.matches("timed gone " .. version, fleet_command("versions"), 1, true)
    assert.equal("", fleet_command("due"))
    assert.equal("m:{0}:1\nm:{0}:2\n", fleet_command("due", "10", "1e10"))
    assert.equal("m:{0}:1\nm:{0}:2\n", fleet_command("due", "10", "+1000000"))
    assert.equal("rfsm fleet: a number expected, got '1h'\n",
      fleet_command("due", "10", "1h"))
    fleet_command("hold", "m:{0}:1", "'to be looked at' --by ann")
    assert.matches("^%d+%.%d+ %(hold: to be looked at%) by ann\n$",
      fleet_command("log", "m:{0}:1"))
  end)

  it("tells of a machine that another program has overwritten", function()
    for i = 1, 3 do assert(machines:create(i, "timed")) end
    local version = machines:get(1).version
    server:cli("SET m:{0}:2 x")
    server:cli("SET m:{0}:9 'of another program'")
    server:cli([[EVAL "redis.call('SET', KEYS[1], cmsgpack.pack({ 'rfsm' }))" 1 ]]
      .. "m:{0}:8")
    assert.matches("^m:{0}:1 timed root.a newest %d+ s\nm:{0}:2 %(broken%)  broken %d+ "
      .. "s\nm:{0}:3 timed root.a newest %d+ s\n", fleet_command("list"))
    assert.equal(("(broken) broken (broken) 1\ntimed newest %s 2\n"):format(version),
      fleet_command("versions"))
    assert.matches("^m:{0}:2 %(broken%)  broken %d+ s\nrfsm fleet: 1 found",
      fleet_command("remove --dry-run --where version=broken"))
    assert.matches("fleet: 2 machines: timed root.a 2\n$",
      fleet_command("list --where age=0"))
    assert.matches("what is at 'm:{0}:2' is no machine\n.*fleet: 2 of 3 done\n$",
      fleet_command("hold --where key='*:[1-9]'"))
  end)

  it("makes a machine with data", function()
    local key = key_of(1)
    assert.equal("root.a done taken\n", fleet_command("create", key, "timed", "n=4"))
    assert.equal(4, machines:get(1).data.root.n)
    for text, arguments in pairs { -- any order: each stands alone
      ["ERR rfsm_create: something is at 'm:{0}:1'"] = { key, "timed" },
      ["ERR rfsm_create: no chart is named 'timd' (did you mean 'timed'?)"] = {
        "m:{0}:2", "timd" },
      ["ERR rfsm_create: data: the root of the chart does not keep 'm' (there is 'n')"]
        = { "m:{0}:2", "timed", "m=4" },
      ['ERR rfsm_create: field \'n\': a number expected, got the text "x"'] = {
        "m:{0}:2", "timed",
        "n=x" },
      ["FIELD=VALUE expected, got 'n'"] = { "m:{0}:2", "timed", "n" },
      ["'n' is there twice"] = { "m:{0}:2", "timed", "n=false", "n=2" },
    } do
      assert.equal("rfsm fleet: " .. text .. "\n", fleet_command("create",
        table.concat(arguments, " ")))
    end
    assert.matches("^%S+ %(create%): %-> root.a\n", fleet_command("history", key))
    assert.equal("machine:{0}:plain root.a done taken\n",
      fleet_command("create", "plain", "timed"))
    assert.equal("machine:{0}:plain root.b done taken\n",
      fleet_command("send", "plain", "e_b"))
    assert.equal("rfsm fleet: 0 machines (the library has no such state; states in "
      .. "regions are not looked for)\n",
      fleet_command("list --where state=root.qqq.x"))
  end)

  it("sets a field to a value of another kind only by force", function()
    local key = key_of(1)
    assert(machines:create(1, "timed"))
    assert.equal("rfsm fleet: ERR rfsm_set: field 'root.n': a number expected, got the "
      .. 'text "abc" (--force sets it nevertheless)\n',
      fleet_command("set", key, "n=abc"))
    assert.equal('m:{0}:1 root.a (set root.n: 0 -> "abc", forced)\n',
      fleet_command("set", key, "n=abc", "--force"))
    assert.equal("abc", machines:get(1).data.root.n)
    assert.matches("get takes no %-%-force", fleet_command("get", key, "--force"))
  end)

  it("has a hint for a path without root, and for a version", function()
    assert(machines:create(1, "timed"))
    assert.equal("rfsm fleet: ERR rfsm_force: chart 'timed' has no leaf 'b' (did you "
      .. "mean 'root.b'?)\n", fleet_command("force", key_of(1), "b"))
    assert.equal("rfsm fleet: no machine is like that, so nothing was done (did you "
      .. "mean 'newest'?)\n", fleet_command("hold", "--where", "version=newst"))
    assert.equal("rfsm fleet: no machine is like that, so nothing was done\n",
      fleet_command("hold", "--where", "version=bundled"))
  end)

  it("pulls a machine, and pushes what was repaired", function()
    local key, file = key_of(1), helper.file_with("")
    assert(machines:create(1, "timed"))
    assert(machines:send(1, "e_emit"))
    assert.equal("m:{0}:1 root.a (set root.n: 1 -> 7) by ann\n",
      fleet_command("set", key, "n=7", "--by ann"))
    helper.write(file, fleet_command("pull", key))
    local fsm = assert(snapshot.load(rfsm.load(helper.file_with(TIMED)), file))
    assert.same({ "root.a", 7 }, { rfsm.get_actleaf_fqn(fsm), fsm.n })
    local read = json.decode((helper.content(file))).fleet
    assert.same({ "m:{0}:1", "timed", 3 }, { read.machine, read.chart, #read.history })
    assert.same({ "(set root.n: 1 -> 7) by ann", "root.a", "root.a" },
      { read.history[3].event, read.history[3].from, read.history[3].to })
    assert.same({ { "%t", "n", 1 }, { "%t", "n", 7 } }, { -- the data of then
      read.history[2].snap.data.root, read.history[3].snap.data.root })
    assert.equal("m:{0}:1 root.a (push) by ann\n",
      fleet_command("push", key, file, "--by ann"))
    assert.matches("^%S+ %(push%) by ann: root.a %-> root.a\n",
      fleet_command("history", key))
    assert(machines:send(1, "e_b"))
    assert.matches("^rfsm fleet: ERR rfsm_push: the machine at 'm:{0}:1' has moved on, "
      .. "its revision is not %d+ any more: pull it again, or set one field\n$",
      fleet_command("push", key, file))
    helper.write(file, helper.content(file):sub(1, 90))
    assert.equal("rfsm fleet: ERR rfsm_push: file (is it cut short?): a JSON object "
      .. "expected\n", fleet_command("push", key, file))
    assert.equal("root.b", machines:get(1).leaf)
  end)

  it("finds a machine once that the server lists twice", function()
    local connection, each = machines.connection, machines.connection.each_master
    function connection.each_master(own, f)
      each(own, function(ask)
        f(function(name, ...)
          local reply = ask(name, ...)
          local keys = name == "SCAN" and reply[2] or {}
          for k = 1, #keys do keys[#keys + 1] = keys[k] end
          return reply
        end)
      end)
    end
    for k = 1, 3 do assert(machines:create(k, "timed")) end
    local found = assert(machines:select {})
    assert.same({ 3, "m:{0}:1", "m:{0}:3" }, { #found, found[1].key, found[3].key })
    assert.same({ 3, 3 }, { machines:versions()[1].count, machines:reindex() })
  end)

  it("does a verb for many machines", function()
    for i = 1, 3 do assert(machines:create(i, i < 3 and "timed" or "counter")) end
    assert(machines:send(2, "e_long"))
    assert.matches("^m:{0}:1 timed root.a newest %d+ s\nm:{0}:2 timed root.c.d newest "
      .. "%d+ s\nrfsm fleet: 2 found, nothing was done\n$",
      fleet_command("hold --dry-run --where chart=timed"))
    assert.equal("m:{0}:2 root.c.d (hold: broken)\nrfsm fleet: 1 of 1 done\n",
      fleet_command("hold --where state=root.c,version=newest broken"))
    assert.equal("broken", machines:get(2).held_because)
    assert.matches("^m:{0}:2 timed root.c.d newest %d+ s held: broken\nrfsm fleet: 1 "
      .. "found, ", fleet_command("release --dry-run --where reason=broken"))
    assert.matches("^m:{0}:1 .*\nm:{0}:2 .*held: broken\nm:{0}:3 .*\nrfsm fleet: 3 "
      .. "machines: counter root.even 1, timed root.a 1, timed root.c.d 1\n$",
      fleet_command("list"))
    assert.matches("^m:{0}:1 .*\nm:{0}:3 .*\nrfsm fleet: 2 machines: ",
      fleet_command("list --where 'key=m:{0}:[13],age=0'"))
    assert.equal("rfsm fleet: 0 machines\n", fleet_command("list --where key=n*"))
    assert.matches("^m:{0}:1 .*\nm:{0}:3 .*\nrfsm fleet: 2 found, ",
      fleet_command("hold --dry-run --where held=no"))
    assert.equal("m:{0}:2 root.c.d (release)\nrfsm fleet: 1 of 1 done\n",
      fleet_command("release --where chart=timed,held=yes"))
    assert.equal("rfsm fleet: no machine is like that, so nothing was done (did you "
      .. "mean 'root.c'?)\n", fleet_command("hold --where chart=timed,state=root.cc"))
    assert.equal("m:{0}:2 root.b (force)\nrfsm fleet: 1 of 1 done\n",
      fleet_command("force --where state=root.c root.b"))
    assert.equal("m:{0}:2 root.b (move: it was the newest)\nrfsm fleet: 1 of 1 done"
      .. "\n", fleet_command("move --where state=root.b"))
    assert.equal("rfsm fleet: no machine is like that, so nothing was done\n",
      fleet_command("remove --where version=gone"))
    assert.matches("^m:{0}:1 timed root.a newest %d+ s %(remove%)\nm:{0}:2 timed "
      .. "root.b .-\nrfsm fleet: 2 of 2 done\n$",
      fleet_command("remove --where chart=timed"))
    assert.equal("m:{0}:3", assert(machines:select {})[1].key)
    assert(machines:create(1, "timed"))
    for _ = 1, 2 do assert(machines:send(1, "e_emit")) end
    machines:work("g", "w", function() error("no stock", 0) end, { tries = 1 })
    assert.equal("rfsm fleet: no entry is like that, so nothing was done\n",
      fleet_command("again --where chart=counter"))
    assert.matches("^0 [%d-]+ m:{0}:1 done %(again%)\n0 [^\n]+\nrfsm fleet: 2 of 2 "
      .. "done\n$", fleet_command("again --where chart=timed,age=0"))
    assert.same({}, machines:dead())
  end)

  it("says if there may be more than it lists", function()
    for i = 1, 3 do assert(machines:create(i, "timed")) end
    local more = "m:{0}:1\nm:{0}:2\nrfsm fleet: the first 2, there may be more: give a "
      .. "greater LIMIT\n"
    assert.equal(more, fleet_command("find", "timed", "root.a", "2"))
    assert.equal(more, fleet_command("due", "2", "+4000"))
    assert.equal("m:{0}:1\nm:{0}:2\nm:{0}:3\n", fleet_command("due", "9", "+4000"))
  end)

  it("says of which charts the library is, and what a new one leaves out", function()
    local function load(...)
      return servers.output_of("tools/rfsm redis " .. table.concat({ ... }, " ")
        .. " --load " .. server:url())
    end
    local two = "two=" .. helper.file_with(COUNTER)
    server:cli("FUNCTION FLUSH")
    assert.equal("rfsm fleet: ERR Function not found: load a library (rfsm redis "
      .. "--load)\n", fleet_command("find", "two", "root.even"))
    loaded = nil
    assert.equal("", load("one=" .. helper.file_with(TIMED), two))
    assert.equal("one root\none root.a\none root.b\none root.c\none root.c.d\n"
      .. "two root\ntwo root.even\ntwo root.odd\n", fleet_command("charts"))
    for i = 1, 2 do assert(machines:create(i, "one")) end
    local version = machines:get(1).version
    assert.equal("rfsm redis: 2 machines of one cannot run until it is loaded, too\n",
      load(two, "--index", "--history 5"))
    local newer = (TIMED:gsub("keep", "more = rfsm.state {}, keep"))
    local before = "rfsm redis: the library before was made with --%s, this one is not"
    assert.equal(before:format "history" .. "\n" .. before:format "index"
      .. "\nrfsm redis: 2 machines of one: version " .. version .. " is not loaded, "
      .. "those that do not fit the newest one cannot run until both are: rfsm redis "
      .. "one=OLD.lua one=NEW.lua ... --load " .. server:url() .. "\n",
      load("one=" .. helper.file_with(newer), two))
    assert.equal("", load("one=" .. helper.file_with(TIMED),
      "one=" .. helper.file_with(newer)))
  end)

  it("says that there is no machine whose log is asked for", function()
    for _, verb in ipairs { "log", "history" } do
      assert.equal("rfsm fleet: ERR rfsm_get: no machine is at 'm:{0}:9' "
        .. "(rfsm_create makes one)\n", fleet_command(verb, "m:{0}:9"))
    end
    assert(machines:create(1, "timed"))
    assert.equal("", fleet_command("log", "m:{0}:1"))
  end)

  it("finds machines with hash tags that are not the client's", function()
    assert(machines:create("mine:{a}:1", "timed"))
    assert(machines:send("mine:{a}:1", "e_emit"))
    assert.equal("mine:{a}:1\n", fleet_command("find", "timed", "root.a"))
    assert.equal("mine:{a}:1\n", fleet_command("due", "10", "1e10"))
    assert.same({ "a" }, machines:find_tags())
    machines:work("g", "w", function() error("no stock", 0) end, { tries = 1 })
    assert.matches("^a %S+ mine:{a}:1 done ", fleet_command("dead"))
    assert.equal("rfsm fleet: 1 found, nothing was done\n",
      fleet_command("drop --where chart=timed --dry-run"):match("\n(.*)"))
    machines.more_tags = nil
  end)
end)

describe("the index", function()
  local MOVING = [[
    local rfsm = require "rfsm"
    return rfsm.state { rename = {}, a = rfsm.state {}, ["b\tc"] = rfsm.state {},
      d = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" },
      rfsm.trans { src = "a", tgt = "b\tc", events = { "e_b" } },
      rfsm.trans { src = "b\tc", tgt = "d", events = { "e_d" } } }]]

  it("finds machines that were there before it, and none where it was", function()
    local charts = { moving = MOVING }
    assert(machines:load(library(nil, charts)))
    for i = 1, 3 do assert(machines:create(i, "moving")) end
    assert(machines:load(library({ index = true }, charts)))
    assert(machines:send(1, "e_b"))
    assert.equal(3, machines:reindex())
    assert.same({ "m:{0}:2", "m:{0}:3" }, machines:find("moving", "root.a"))
    assert(machines:load(library(nil, charts)))
    assert(machines:send(2, "e_b"))
    assert(machines:load(library({ index = true }, charts)))
    assert.same({ "m:{0}:2", "m:{0}:3" }, machines:find("moving", "root.a"))
    assert.equal("3\n", server:cli("FCALL rfsm_reindex 1 {0}"))
    assert.same({ "m:{0}:3" }, machines:find("moving", "root.a"))
    assert.same({ "m:{0}:1", "m:{0}:2" }, machines:find("moving", "root.b\tc"))
    assert.matches('state="root.b\tc"} 2\n', machines:stats(), 1, true)
    assert(machines:send(2, "e_d"))
    assert.same({ "m:{0}:1" }, machines:find("moving", "root.b\tc"))
    assert.same({ nil, "ERR rfsm_reindex: the library was made without --index" },
      { (function()
        assert(machines:load(library(nil, charts)))
        return machines:reindex()
      end)() })
  end)

  it("finds machines that are in their state since nobody knows when", function()
    assert(machines:create(1, "timed"))
    assert.same({}, machines:find("timed", "root", 10, 100))
    server:cli("DEL rfsm:since:{0}")
    assert.same({ "m:{0}:1" }, machines:find("timed", "root", 10, 100))
  end)
end)

describe("the client", function()
  it("connects again, with password and database", function()
    local other = servers.redis()
    other:cli("CONFIG SET requirepass secret")
    local url = other:url():gsub("//", "//:secret@") .. "/3"
    local again = fleet.connect(url, { tags = 1 })
    again:call("0", "FUNCTION", "LOAD", "REPLACE", library())
    assert(again:create(1, "counter"))
    other:cli("-a secret CLIENT KILL TYPE normal")
    assert.equal("root.odd", again:send(1, "e_tick").leaf)
    assert.matches("db3", other:cli("-a secret INFO keyspace"))
    for password, problem in pairs { [":wrong@"] = "WRONGPASS", [""] = "NOAUTH" } do
      local lines = servers.output_of("tools/rfsm redis examples/lamp.lua --load "
        .. url:gsub(":secret@", password))
      assert.matches("^rfsm redis: rfsm.fleet: [^\n]*: " .. problem .. "[^\n]*\n$",
        lines)
    end
  end)

  it("uses another server if the first is gone", function()
    local first = servers.redis("--repl-diskless-sync-delay 0")
    local second = servers.redis()
    local either = fleet.connect({ first:url(), second:url() }, { tags = 1 })
    second:cli("REPLICAOF 127.0.0.1 " .. first.port)
    either:call("0", "FUNCTION", "LOAD", "REPLACE", library())
    assert(either:create(1, "counter"))
    assert.equal(1, either:call("0", "WAIT", 1, 5000)) -- for what it has written
    first:kill()
    second:cli("REPLICAOF NO ONE")
    assert.equal("root.odd", either:send(1, "e_tick").leaf)
  end)

  it("gives up after its patience", function()
    local other = servers.redis()
    local brief = fleet.connect(other:url(), { tags = 1, patience = 0 })
    other:kill()
    assert.matches("^rfsm.fleet: no answer for {0} in 0 s: ",
      (select(2, brief:send(1, "e_tick"))))
  end)

  for url, text in pairs {
    ["http://here"] = "redis://[USER:PASSWORD@]HOST:PORT[/DB] expected, got "
      .. "'http://here'",
    ["redis://a/b"] = "redis://[USER:PASSWORD@]HOST:PORT[/DB] expected, got "
      .. "'redis://a/b'",
  } do
    it("refuses " .. url, function()
      local ok, problem = pcall(fleet.connect, url)
      assert.is_false(ok)
      assert.is_truthy(problem:find("rfsm.fleet.connect: " .. text, 1, true))
    end)
  end

  it("skips nil among events, as the core does", function()
    assert(machines:create(1, "counter"))
    assert.equal("root.odd", machines:send(1, nil, "e_tick", nil).leaf)
    assert(machines:send_after(1, 0, nil, "e_tick"))
    assert.equal(2, count_of(1))
  end)

  for what, case in pairs {
    ["no id"] = { call = function() machines:send(nil, "e_tick") end,
      text = "rfsm.fleet: id of a machine expected, got nil" },
    ["a table as id"] = { call = function() machines:get {} end,
      text = "rfsm.fleet: id of a machine expected, got table" },
    ["a text as time"] = { call = function() machines:send_after(1, "5", "e_tick") end,
      text = "rfsm.fleet.send_after: seconds expected, got string '5'" },
    ["a time before now"] = { call = function() machines:send_after(1, -1, "x") end,
      text = "rfsm.fleet.send_after: seconds expected, got -1" },
  } do
    it("refuses " .. what, function()
      local _, problem = pcall(case.call)
      assert.equal(case.text, (problem:gsub("^%S+:%d+: ", "")))
    end)
  end

  it("has ids of its own", function()
    local one, other = connect(), connect()
    assert.matches("^%x%x%x%x%x%x%x%x%x%x$", one.id)
    assert.not_equal(one.id, other.id)
  end)

  it("uses TLS where the URL says so", function()
    local _, problem = pcall(fleet.connect, (server:url():gsub("redis:", "rediss:")),
      { timeout = 0.1 })
    assert.matches(helper.package "ssl" and ": TLS: " or "lua%-sec is missing", problem)
  end)

  it("refuses an option that is not known", function()
    local _, problem = pcall(fleet.connect, nil, { tag = 1 })
    assert.matches("rfsm.fleet.connect: unknown option 'tag' "
      .. "%(did you mean 'tags'%?%), expected: name, patience, tags, "
      .. "timeout, tls", problem)
  end)
end)

describe("an operator who types what doc/redis.md prints", function()
  -- The lines of a block that begins with a text, without what comes behind a #.
  local function lines_of(first)
    local content, lines = helper.content("doc/redis.md"), {}
    local from = assert(content:find("```\n" .. first, 1, true))
    for line in content:sub(from + 4, content:find("```", from + 4, true) - 1)
      :gmatch("[^\n]+") do
      lines[#lines + 1] = line:gsub(" +#.*", ""):gsub("redis://localhost",
        server:url())
    end
    return lines
  end

  before_each(function()
    assert(machines:load(servers.with_clock((redis.bundle({ "examples/warehouse/"
      .. "order.lua" }, { index = true, history = 9 })))))
    machines = fleet.connect(server:url(), { name = "m" })
  end)

  -- Types the lines of the page from one that begins so. Returns what each prints.
  local function typed(first)
    local printed = {}
    for i, line in ipairs(lines_of(first)) do
      line = line:gsub("redis%-cli", "redis-cli -p " .. server.port)
        :gsub("[^ ]*{7}[^ ]*", "'%0'")
      printed[i] = servers.output_of((line:find("^rfsm") and "tools/" or "") .. line)
    end
    return printed
  end

  it("begins with machines of two charts", function()
    local printed = typed "rfsm redis examples"
    assert.equal("", printed[1])
    assert.matches("^root.off\ndone\n.*taken\n", printed[2])
    assert.matches("^root.on.dim\ndone\n.*taken\n", printed[3])
    assert.matches("leaf: root.on.dim\n", printed[4], 1, true)
  end)

  it("finds those that hang, and why", function()
    assert(machines:create("m:{7}:42", "order", { item = "cog" }))
    assert(machines:send("m:{7}:42", "e_paid"))
    server:move_clock(3600)
    local printed = typed "rfsm fleet redis://localhost list --where age"
    assert.matches("^m:{7}:42 order root.picking newest %d+ s\nrfsm fleet: 1 machine: "
      .. "order root.picking 1\n$", printed[1])
    assert.matches("\nkept: %[%]\nlater: %[%]\n.*\nwaiting: %[%]\n", printed[2])
    assert.matches("(picking -> packing) would be taken on e_picked", printed[3], 1,
      true)
    assert.same({ "", "" }, { printed[4], (printed[5]:gsub("%s", "")) })
  end)

  it("sees what each verb does", function()
    local dead = {}
    for _, item in ipairs { "cog", "belt" } do
      local id = "m:{7}:" .. (item == "cog" and "42" or "43")
      assert(machines:create(id, "order", { item = item }))
      assert(machines:send(id, "e_paid"))
    end
    machines:work("g", "w", function() error("no paper", 0) end, { tries = 1 })
    for i, entry in ipairs(machines:dead()) do dead[i] = entry.id end
    machines:send("m:{7}:43", "e_picked")
    server:move_clock(3600)
    local printed = {}
    for i, line in ipairs(lines_of "rfsm fleet redis://localhost find") do
      local again = line:find(" again ") and 1 or 2
      line = line:gsub("17%d+%-0", function() return dead[again] end)
        :gsub("[^ ]*{7}[^ ]*", "'%0'")
      printed[i] = servers.output_of("tools/" .. line)
    end
    assert.equal("m:{7}:42\n", printed[1])
    assert.matches("chart: order\n.*cog.*leaf: root.picking\n", printed[2])
    assert.matches("^[%d.]+ e_paid: root.received %-> root.picking\n[%d.]+ %(create%): "
      .. "%-> root.received\n$", printed[3])
    assert.same({ "m:{7}:42 root.picking (hold: no paper) by ann\n",
      "root.picking done kept\n", "m:{7}:42 root.packing (release) by ann\n" },
      { printed[4], printed[5], printed[6] })
    assert.equal("m:{7}:42 root.picking (force) by ann\n", printed[7])
    assert.equal("m:{7}:42 order root.picking (remove)\n", printed[8])
    assert.matches("^7 " .. dead[1]:gsub("%-", "%%-") .. " m:{7}:42 pick {.*cog.*} x1 "
      .. "no paper\n7 .* m:{7}:43 pick ", printed[9])
    assert.same({ "7 " .. dead[1] .. " m:{7}:42 pick (again)\n",
      "7 " .. dead[2] .. " m:{7}:43 pick (drop)\n" }, { printed[10], printed[11] })
    assert.same({}, machines:dead())
  end)

  it("sets fields", function()
    assert(machines:create("m:{7}:42", "order", { item = "cog" }))
    local printed = typed "rfsm fleet redis://localhost set"
    assert.matches("^m:{7}:42 root.received %(set root.tries: 0 %-> 0%)", printed[1])
    assert.equal('m:{7}:42 root.received (set root.item: "cog" -> "left gear") by '
      .. "ann\n", printed[2])
  end)

  it("sees what the other questions answer", function()
    assert(machines:create("m:{7}:42", "order", { item = "cog" }))
    assert(machines:send("m:{7}:42", "e_paid"))
    assert(machines:hold("m:{7}:42", "no paper", "ann"))
    local printed = {}
    for i, line in ipairs(lines_of "rfsm fleet redis://localhost why") do
      printed[i] = servers.output_of("tools/" .. line:gsub("[^ ]*{7}[^ ]*", "'%0'"))
    end
    assert.matches("^held for %d+ s: events wait until it is released; "
      .. "then:\nroot.trans.4. .picking %-> packing. would be taken on e_picked in ",
      printed[1])
    assert.equal("", printed[2])
    assert.equal("", printed[3])
    assert.matches("^order newest %S+ 1\n$", printed[4])
    assert.same({ "m:{7}:42 root.picking (move: it was the newest)\n", "1 machine\n",
      "root.picking done kept\n" }, { printed[5], printed[6], printed[7] })
    assert.same({ "", "rfsm fleet: it is not there\n" }, { printed[8], printed[9] })
  end)
end)

describe("a chart that cannot run in Redis", function()
  local function refusal(text)
    local file = helper.file_with(text)
    local ok, problem = pcall(redis.bundle, { "c=" .. file })
    assert.is_false(ok)
    return (problem:gsub(file:gsub("%p", "%%%0"), "FILE"))
  end

  local function chart(lines, more)
    return lines .. "\nreturn rfsm.state { a = rfsm.state {" .. (more or "")
      .. "}, rfsm.trans { src = 'initial', tgt = 'a' } }"
  end

  for expected, text in pairs {
    ["FILE:2: module 'socket.core' is not there as plain Lua, so it cannot run in "
      .. "Redis"] = chart("\nlocal s = require 'socket.core'"),
    ["FILE:1: 'socket': module 'socket.core' is not there as plain Lua, so it cannot "
      .. "run in Redis"] = chart("", "entry = function() require 'socket' end")
        :gsub("^\n", ""),
  } do
    it("is refused: " .. expected, function()
      assert.equal(expected, refusal(text))
    end)
  end

  it("brings its own modules along if they are plain Lua", function()
    local folder = helper.lines_of("mktemp -d")[1]
    for name, text in pairs {
      mine = "return { yours = require 'yours' }",
      yours = "return { name = 'a name' }",
    } do
      local file = io.open(folder .. "/" .. name .. ".lua", "w")
      file:write(text)
      file:close()
    end
    helper.with(package, { path = folder .. "/?.lua;" .. package.path }, function()
      assert(machines:load((redis.bundle { "c=" .. helper.file_with(chart(
        "local mine = require('mine')",
        "entry = function(fsm) fsm.emit(mine.yours.name) end")) })))
    end)
    os.execute("rm -r " .. folder)
    package.loaded.mine, package.loaded.yours = nil, nil
    assert(machines:create(1, "c"))
    assert.matches("a name", server:cli("XRANGE rfsm:out:{0} - +"))
  end)

  it("is not one that requires libraries of Lua, or of rFSM by any name", function()
    local charts = {}
    for i, name in ipairs { "string", "math", "rfsm.rfsm", "rfsm_timeevent", "rfsm.ext",
      "rfsm.await", "rfsm_seqand", "rfsm.emem" } do
      charts[i] = ("c%d=%s"):format(i, helper.file_with(chart("local m = require '"
        .. name .. "'")))
    end
    assert(machines:load((redis.bundle(charts))))
    for i = 1, #charts do assert(machines:create(i, "c" .. i)) end
    local files = {}
    for i, name in ipairs { "rfsm_ext", "rfsm_emem", "rfsm_preview", "rfsm_await" } do
      files[i] = helper.file_with(chart("local m = require '" .. name .. "'"))
    end
    assert.matches("^#!lua name=rfsm\n", table.concat(helper.lines_of(
      "tools/rfsm redis " .. table.concat(files, " ")), "\n"))
  end)

  it("is reported if a loop in it has no end", function()
    local file = helper.file_with(chart("", [[
      entry = function()
        while true do
          local x = function() end
        end
      end,
      exit = function() repeat until false end,
      doo = function() while true do rfsm.yield() end end,
      other = function()
        while true do if a then break end end
        repeat until a
      end]]))
    local lines = { select(2, redis.bundle { "c=" .. file }) }
    local text = ": warning: this loop has no end: in Redis it would hold up all others"
    assert.same({ file .. ":3" .. text, file .. ":7" .. text }, lines[1])
  end)
end)

describe("rfsm redis --diff", function()
  it("compares the last two versions of a name", function()
    local old = helper.file_with(COUNTER)
    local new = helper.file_with((COUNTER:gsub('"n", "list"', '"n"')))
    local lines = helper.lines_of(("tools/rfsm redis c=%s c=%s --diff; echo $?"):format(
      old, new))
    assert.same({ "c: " .. old .. " -> " .. new, "gone: field list of root", "1" },
      { lines[1], lines[2], lines[#lines] })
    assert.same({ "rfsm redis: --diff: two versions of a chart expected" },
      helper.lines_of("tools/rfsm redis c=" .. old .. " --diff 2>&1"))
  end)
end)

it("does what one machine does whose host is punctual", function()
  assert.is_nil(share.problem(require "spec.support.claims.fleet_redis", 60))
end)
