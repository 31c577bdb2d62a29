-- The client of a fleet: what it asks the server, and what it makes of the answers. The
-- server is a table in this process.

local helper = require "spec.helper"
local net_of = require "spec.support.redis_net"

if not (helper.package "redis" and helper.package "dkjson") then
  describe("the client of a fleet", function()
    it("needs lua-redis", function() pending("lua-redis or dkjson is missing") end)
  end)
  return
end

local MODULES = { "rfsm.redis.connection", "rfsm.fleet" }

local function forget()
  for _, name in ipairs(MODULES) do package.loaded[name] = nil end
end

-- Calls f(client, net) where `answer(words)` answers for the server; returns what was
-- sent, without the id of the client, and the result or the error.
local function with_client(answer, f, options)
  local net = net_of.new { ["h:6379"] = function(words, socket)
    if words[1] == "CLUSTER" then return { err = "ERR no cluster" } end
    return answer(words, socket)
  end }
  local ok, result = pcall(helper.with, package.loaded, net.packages, function()
    forget()
    local client = require "rfsm.fleet".connect("redis://h", options or { name = "m",
      tags = 1 })
    client.id = "me"
    helper.clear(net.trace)
    return f(client, net)
  end)
  forget()
  if not ok and type(result) == "table" then error(result, 0) end -- of an assertion
  return net.trace, result, ok
end

local function always(reply) return function() return reply end end

local KEYS = "m:{0}:1 rfsm:due:{0} rfsm:out:{0} m:{0}:1:log rfsm:in:{0} "
  .. "m:{0}:1:history rfsm:since:{0}"

local function fcall(name, arguments)
  return ("h:6379 FCALL %s 7 %s%s"):format(name, KEYS, arguments or "")
end

local STANDING = { "root.a", "done", "first", "second", "taken" }
local REPLY = { leaf = "root.a", mode = "done", errors = { "first", "second" },
  outcome = "taken" }

describe("the client of a fleet", function()
  for _, case in ipairs {
    { name = "create", call = function(c) return c:create(1, "lamp") end,
      sent = fcall("rfsm_create", " lamp {} ID me-1"), answer = STANDING,
      reply = REPLY },
    { name = "create", call = function(c) return c:create(1, "lamp", { x = { 1 } }) end,
      sent = fcall("rfsm_create", ' lamp {"x":[1]} ID me-1'), answer = STANDING,
      reply = REPLY },
    { name = "send", call = function(c) return c:send(1, "e_a", 5, true) end,
      sent = fcall("rfsm_send", " e_a 5 true ID me-1"), answer = STANDING,
      reply = REPLY },
    { name = "send", call = function(c) return c:send(1, { name = "e", n = { 1 } }) end,
      sent = fcall("rfsm_send", ' {"n":[1],"name":"e"} ID me-1'),
      answer = STANDING, reply = REPLY },
    { name = "send_once_after", call = function(c)
        return c:send_once_after("mine", 1, 2.5, "e")
      end, sent = fcall("rfsm_send_at", " +2.500000 e ID mine"), answer = STANDING,
      reply = "mine" },
    { name = "send_after", call = function(c) return c:send_after(1, 2.5, "e") end,
      sent = fcall("rfsm_send_at", " +2.500000 e ID me-1"), answer = STANDING,
      reply = "me-1" },
    { name = "cancel", call = function(c) return c:cancel(1, "me-7") end,
      sent = fcall("rfsm_cancel", " me-7"), answer = 1, reply = true },
    { name = "cancel", call = function(c) return c:cancel(1, "me-7") end,
      sent = fcall("rfsm_cancel", " me-7"), answer = 0, reply = false },
    { name = "tick", call = function(c) return c:tick(1) end, sent = fcall "rfsm_tick",
      answer = { "", "inactive", "kept" }, reply = { leaf = "", mode = "inactive",
        errors = {}, outcome = "kept" } },
    { name = "hold", call = function(c) return c:hold(1) end,
      sent = fcall "rfsm_hold", answer = STANDING, reply = REPLY },
    { name = "hold", call = function(c) return c:hold(1, "new", "ann") end,
      sent = fcall("rfsm_hold", " new BY ann"), answer = STANDING, reply = REPLY },
    { name = "set", call = function(c) return c:set(1, "n", 2, "ann", true) end,
      sent = fcall("rfsm_set", " n 2 force BY ann"), answer = STANDING, reply = REPLY },
    { name = "push", call = function(c) return c:push(1, "{}", nil, "ann") end,
      sent = fcall("rfsm_push", " {}  BY ann"), answer = STANDING, reply = REPLY },
    { name = "release", call = function(c) return c:release(1, "ann") end,
      sent = fcall("rfsm_release", " BY ann"), answer = STANDING, reply = REPLY },
    { name = "release", call = function(c) return c:release(1) end,
      sent = fcall "rfsm_release", answer = STANDING, reply = REPLY },
    { name = "force", call = function(c) return c:force(1, "root.b") end,
      sent = fcall("rfsm_force", " root.b"), answer = STANDING, reply = REPLY },
    { name = "remove", call = function(c) return c:remove(1) end,
      sent = fcall "rfsm_remove", answer = 1, reply = true },
    { name = "why", call = function(c) return c:why(1, "e") end,
      sent = fcall("rfsm_why", " e"), answer = { "a line" }, reply = { "a line" } },
    { name = "get", call = function(c) return c:get(1) end, sent = fcall "rfsm_get",
      answer = { "leaf", "root.a", "data", '{"root":{"n":5}}', "queue", '["e"]', "due",
        "12.5" }, reply = { leaf = "root.a", data = { root = { n = 5 } },
        queue = { "e" }, due = 12.5 } },
    { name = "history", call = function(c) return c:history(1) end,
      sent = fcall("rfsm_history", " 10"), answer = { "1.500", "e", "root.a", "root.b",
        "1.000", "", "", "root.a" }, reply = {
        { time = 1.5, event = "e", from = "root.a", to = "root.b" },
        { time = 1, event = "", from = "", to = "root.a" } } },
    { name = "history", call = function(c) return c:history(1, 3) end,
      sent = fcall("rfsm_history", " 3"), answer = {}, reply = {} },
  } do
    it("calls the function of " .. case.name, function()
      local sent = with_client(always(case.answer), function(client)
        local reply, problem = case.call(client)
        assert.same(case.reply, reply)
        assert.is_nil(problem)
      end)
      assert.same({ case.sent }, sent)
    end)

    it("returns nil and the problem of " .. case.name, function()
      with_client(always { err = "ERR none" }, function(client)
        local reply, problem = case.call(client)
        assert.same({ nil, "ERR none" }, { reply, problem })
      end)
    end)
  end

  it("returns that there is no machine", function()
    with_client(always(false), function(client)
      assert.same({ nil, "no machine" }, { client:tick(1) })
    end)
  end)

  it("sends no data that JSON does not know", function()
    local cycle = {}
    cycle[1] = cycle
    for _, value in ipairs { cycle, print } do
      local sent = with_client(always(STANDING), function(client)
        local reply, problem = client:create(1, "lamp", { x = value })
        assert.is_nil(reply)
        assert.matches("^rfsm.fleet.create: data: ", problem)
      end)
      assert.same({}, sent)
    end
  end)

  it("numbers its events", function()
    local sent = with_client(always(STANDING), function(client)
      client:send(1, "e")
      client:send(1, "e")
    end)
    assert.matches("ID me%-1$", sent[1])
    assert.matches("ID me%-2$", sent[2])
  end)

  it("has an id of the time where there is no file of random bytes",
    function()
      local _, text = pcall(helper.with, io, { open = function() end }, function()
        local net = net_of.new { ["h:6379"] = always { err = "ERR" } }
        return helper.with(package.loaded, net.packages, function()
          forget()
          return require "rfsm.fleet".connect("redis://h").id
        end)
      end)
      forget()
      assert.matches("^%d+%-%x+$", text)
    end)

  it("spreads machines over the tags by a digest of their ids", function()
    local _, keys = with_client(always(true), function(client)
      return table.concat({ client:key_of(1), (client:key_of(2)), (client:key_of("ab")),
        (client:key_of(1.5)), client:key_of("x{y}z") }, " ")
    end, {})
    assert.equal("machine:{10}:1 machine:{11}:2 machine:{40}:ab machine:{17}:1.5 x{y}z "
      .. "y", keys)
  end)

  for _, case in ipairs {
    { options = { tags = 0 },
      text = "tags: whole number from 1 to 16384 expected, got 0" },
    { options = { tags = 16385 },
      text = "tags: whole number from 1 to 16384 expected, got 16385" },
    { options = { timeout = 0 }, text = "timeout: seconds above 0 expected, got 0" },
    { options = { timeout = "1" },
      text = "timeout: seconds above 0 expected, got string '1'" },
    { options = { patience = -1 }, text = "patience: seconds expected, got -1" },
    { options = { name = "" }, text = "name: text expected, got string ''" },
    { options = { tls = 1 }, text = "tls: table expected, got 1" },
  } do
    it("refuses " .. case.text, function()
      local _, problem = with_client(always(true), print, case.options)
      assert.equal("rfsm.fleet.connect: " .. case.text,
        (problem:gsub("^%S+:%d+: ", "")))
    end)
  end

  it("takes all tags that a cluster has slots for, and little time", function()
    local _, client = with_client(always(true), function(client) return client end,
      { tags = 16384, timeout = 0.001, patience = 0, tls = {} })
    assert.same({ 16384, 0.001, 0 }, { client.tags, client.connection.options.timeout,
      client.connection.options.patience })
    _, client = with_client(always(true), function(other) return other end, {})
    assert.same({ "machine", 64, 5, 10 }, { client.name, client.tags,
      client.connection.options.timeout, client.connection.options.patience })
  end)

  it("names the package that is missing", function()
    local net = net_of.new {}
    net.packages.redis = 1
    local _, problem = pcall(helper.with, package.loaded, { redis = 1 }, function()
      forget()
      helper.with(package.loaded, { socket = net.packages.socket }, function()
        net.nodes["h:6379"] = always(true)
        require "rfsm.fleet".connect("redis://h")
      end)
    end)
    forget()
    assert.equal("rfsm.fleet: cannot connect to h:6379: rfsm.fleet: the package redis "
      .. "is missing (on Debian: apt-get install lua-redis, for Lua 5.1 to 5.3)",
      problem)
  end)

  it("is also a global", function()
    forget()
    helper.with(_G, { rfsm_fleet = false }, function()
      assert.equal(require "rfsm.fleet", rawget(_G, "rfsm_fleet"))
    end)
    forget()
  end)

  it("watches a machine until it is told enough", function()
    local messages = { { "other", "x", "root.z" }, { "smessage", "c", "root.a" },
      { "smessage", "c", "root.b" }, { "smessage", "c", "root.c" } }
    local sent, seen = with_client(function(words, socket)
      if words[1] ~= "SSUBSCRIBE" then return 1 end
      local receive = socket.receive
      function socket.receive(self, what)
        if self.replies == "" then
          local parts = { "*3\r\n" }
          for _, text in ipairs(table.remove(messages, 1)) do
            parts[#parts + 1] = ("$%d\r\n%s\r\n"):format(#text, text)
          end
          self.replies = table.concat(parts)
        end
        return receive(self, what)
      end
      return { "ssubscribe", words[2], 1 }
    end, function(client)
      local leaves = {}
      client:watch(1, function(leaf)
        leaves[#leaves + 1] = leaf
        return leaf == "root.b"
      end)
      return leaves
    end)
    assert.same({ { "h:6379 EXISTS m:{0}:1", "h:6379 SSUBSCRIBE rfsm:{0}:m:{0}:1",
      "h:6379 close" }, { "root.a", "root.b" } }, { sent, seen })
  end)
end)

describe("a worker", function()
  it("wakes the machines of all tags, and adds the numbers", function()
    local sent, sums = with_client(always { 2, 1 }, function(client)
      return { client:wake(), client:wake(7) }
    end, { tags = 2 })
    assert.same({ 4, 4, 2 }, sums)
    assert.same({
      "h:6379 FCALL rfsm_wake 4 rfsm:due:{0} rfsm:out:{0} rfsm:aside:{0} "
        .. "rfsm:lease:{0} 100",
      "h:6379 FCALL rfsm_wake 4 rfsm:due:{1} rfsm:out:{1} rfsm:aside:{1} "
        .. "rfsm:lease:{1} 100",
      "h:6379 FCALL rfsm_wake 4 rfsm:due:{0} rfsm:out:{0} rfsm:aside:{0} "
        .. "rfsm:lease:{0} 7",
      "h:6379 FCALL rfsm_wake 4 rfsm:due:{1} rfsm:out:{1} rfsm:aside:{1} "
        .. "rfsm:lease:{1} 7" }, sent)
  end)

  it("finds machines in all tags, up to a limit", function()
    local sent, found = with_client(function(words) return { words[4] .. "x", "y" } end,
      function(client)
        return { client:find("c", "root.a"), client:find("c", "root.a", 3) }
      end, { tags = 2 })
    assert.same({ { "rfsm:in:{0}x", "y", "rfsm:in:{1}x", "y" },
      { "rfsm:in:{0}x", "y", "rfsm:in:{1}x" } }, found)
    assert.same({ "h:6379 FCALL rfsm_find 2 rfsm:in:{0} rfsm:since:{0} c root.a 100",
      "h:6379 FCALL rfsm_find 2 rfsm:in:{1} rfsm:since:{1} c root.a 3" },
      { sent[1], sent[4] })
  end)

  -- Answers the commands of a worker; `answers` has replies by command.
  local function working(answers)
    return function(words)
      local reply = answers[words[1]]
      if reply == nil and words[1] == "XINFO" then return {} end -- no group
      if type(reply) == "function" then reply = reply(words) end
      return reply == nil or reply
    end
  end

  local ENTRY = { "5-1", { "machine", "m", "what", "w", "data", '{"a":1}' } }

  local function work(answers, f, options)
    return with_client(working(answers), function(client)
      local count, failures = client:work("g", "w", f or function() end, options)
      return { count, failures }
    end)
  end

  local PENDING = "h:6379 XPENDING rfsm:out:{0} g IDLE 30000 - + 100"
  local READ = "h:6379 XREADGROUP GROUP g w COUNT 100 STREAMS rfsm:out:{0} >"

  local TRIM = "h:6379 XINFO GROUPS rfsm:out:{0}"

  local BUSY = "BUSY Redis is busy running a script. You can only call FUNCTION KILL"
  local FULL = "OOM command not allowed when used memory > 'maxmemory'."

  it("waits while the server is busy, and does nothing if that lasts", function()
    local tries = 0
    local function busy(words)
      if words[1] ~= "XACK" then return { err = BUSY } end
      return true
    end
    local _, result, ok = work { XPENDING = busy }
    assert.same({ true, { 0, { "rfsm.fleet: no answer for {0} in 10 s: " .. BUSY } } },
      { ok, result })
    _, result = work { XPENDING = function()
      tries = tries + 1
      return tries < 3 and { err = BUSY } or {}
    end, XREADGROUP = { { "s", { ENTRY } } } }
    assert.same({ 1, {} }, result)
  end)

  it("does nothing while the server has no memory", function()
    local _, result = work { XPENDING = {}, XREADGROUP = { err = FULL } }
    assert.same({ 0, { FULL } }, result)
    local _, sums = with_client(always { err = FULL }, function(client)
      return { client:wake() }
    end)
    assert.same({ 0, 0, FULL }, sums)
    local _, problem, ok = with_client(always { err = "ERR no" }, function(client)
      client:wake()
    end)
    assert.same({ false, "ERR no" }, { ok, problem })
  end)

  it("does not acknowledge an entry by another connection", function()
    local sent, result = with_client(working { XPENDING = {}, XREADGROUP = { { "s",
      { ENTRY } } } }, function(client, net)
      return { client:work("g", "w", function()
        for _, socket in ipairs(net.sockets) do socket.is_lost = true end
      end) }
    end)
    assert.same({ 0, {} }, result)
    assert.same({ PENDING, TRIM, READ, "h:6379 close", TRIM }, sent)
  end)

  it("makes its group, which sees all entries that are there", function()
    local sent, result = work { XPENDING = { err = "NOGROUP No such key" },
      XREADGROUP = false }
    assert.same({ PENDING, "h:6379 XGROUP CREATE rfsm:out:{0} g 0 MKSTREAM", TRIM,
      READ }, sent)
    assert.same({ 0, {} }, result)
  end)

  it("does not mind that another worker has made it", function()
    local _, result = work { XPENDING = { err = "NOGROUP No such key" },
      XGROUP = { err = "BUSYGROUP exists" }, XREADGROUP = false }
    assert.same({ 0, {} }, result)
  end)

  for name, answers in pairs {
    XPENDING = { XPENDING = { err = "WRONGTYPE no" } },
    XGROUP = { XPENDING = { err = "NOGROUP no" }, XGROUP = { err = "WRONGTYPE no" } },
    XREADGROUP = { XPENDING = {}, XREADGROUP = { err = "WRONGTYPE no" } },
  } do
    it("raises what the server reports on " .. name, function()
      local _, problem, ok = work(answers)
      assert.same({ false, "WRONGTYPE no" }, { ok, problem })
    end)
  end

  it("hands on entries, and acknowledges each", function()
    local seen = {}
    local sent, result = work({ XPENDING = {}, XREADGROUP = { { "s", { ENTRY,
      { "5-2", { "machine", "m", "what", "w", "data", "" } } } } } },
      function(entry) seen[#seen + 1] = entry end)
    assert.same({ { id = "g:0:5-1", machine = "m", what = "w", data = { a = 1 } },
      { id = "g:0:5-2", machine = "m", what = "w" } }, seen)
    assert.same({ PENDING, TRIM, READ, "h:6379 XACK rfsm:out:{0} g 5-1",
      "h:6379 XACK rfsm:out:{0} g 5-2", TRIM }, sent)
    assert.same({ 2, {} }, result)
  end)

  it("tries again what was not done, each time after twice the time", function()
    local sent = work({ XPENDING = { { "5-1", "v", 30000, 1 }, { "5-2", "v", 59999, 2 },
      { "5-3", "v", 60000, 2 } }, XCLAIM = { ENTRY }, XREADGROUP = false })
    assert.same({ PENDING, "h:6379 XCLAIM rfsm:out:{0} g w 30000 5-1",
      "h:6379 XACK rfsm:out:{0} g 5-1", "h:6379 XCLAIM rfsm:out:{0} g w 60000 5-3",
      "h:6379 XACK rfsm:out:{0} g 5-1", TRIM, READ }, sent)
  end)

  it("does not mind an entry that somebody has removed", function()
    local _, result = work { XPENDING = { { "5-1", "v", 30000, 1 } },
      XCLAIM = { false }, XREADGROUP = false }
    assert.same({ 0, {} }, result)
  end)

  it("moves an entry that fails too often, with all that is known", function()
    local function fail() error("no", 0) end
    local answers = { XPENDING = { { "5-1", "v", 9, 2 } }, XCLAIM = { ENTRY },
      XREADGROUP = { { "s", { ENTRY } } } }
    local sent, result = work(answers, fail, { idle = 1, tries = 3, count = 7 })
    assert.same({ "h:6379 XPENDING rfsm:out:{0} g IDLE 1 - + 7",
      "h:6379 XCLAIM rfsm:out:{0} g w 2 5-1",
      'h:6379 XADD rfsm:dead:{0} * machine m what w data {"a":1} group g id 5-1 '
        .. "deliveries 3 error no", "h:6379 XACK rfsm:out:{0} g 5-1", TRIM,
      "h:6379 XREADGROUP GROUP g w COUNT 7 STREAMS rfsm:out:{0} >" }, sent)
    assert.same({ 0, { "no", "no" } }, result)
    sent = work(answers, fail, { idle = 1, tries = 4 })
    assert.equal(4, #sent)
  end)

  for _, case in ipairs {
    { what = "the first that a group has not done", pending = { 1, "5-2" },
      other = { 0, "9-0" }, least = "5-2" },
    { what = "what comes next, if all have done all", pending = { 0, "9-0" },
      other = { 0, "9-3" }, least = "9-1" },
    { what = "the least number of one time", pending = { 1, "9-7" },
      other = { 0, "9-5" }, least = "9-6" },
    { what = "the least time, by its number", pending = { 1, "10-0" },
      other = { 1, "9-0" }, least = "9-0" },
  } do
    it("trims the stream up to " .. case.what, function()
      local first = { g = case.pending, h = case.other }
      local function info(name)
        return { "name", name, "pending", first[name][1], "last-delivered-id",
          first[name][2] }
      end
      local sent = work({ XREADGROUP = { { "s", { ENTRY } } },
        XPENDING = function(words)
          if words[4] == "IDLE" then return {} end
          return { 1, first[words[3]][2], "x" }
        end, XINFO = { info "g", info "h" } })
      assert.equal("h:6379 XTRIM rfsm:out:{0} MINID " .. case.least, sent[#sent])
    end)
  end

  for _, case in ipairs {
    { options = { count = 0 }, text = "count: whole number from 1 to "
      .. "1000000 expected, got 0" },
    { options = { count = 1000001 }, text = "count: whole number from 1 to "
      .. "1000000 expected, got 1000001" },
    { options = { tries = 0 }, text = "tries: whole number from 1 to 1000 "
      .. "expected, got 0" },
    { options = { tries = 1001 }, text = "tries: whole number from 1 to 1000 "
      .. "expected, got 1001" },
    { options = { idle = -1 }, text = "idle: milliseconds expected, got -1" },
  } do
    it("refuses " .. case.text, function()
      local _, problem = work({}, nil, case.options)
      local place, text = problem:match("^(%S+):%d+: (.*)$")
      assert.same({ "spec/client_spec.lua", "rfsm.fleet.work: " .. case.text },
        { place:gsub("^%./", ""), text })
    end)
  end

  it("takes the most entries and tries that may be", function()
    local sent = work({ XPENDING = {}, XREADGROUP = false }, nil, { count = 1000000,
      tries = 1000, idle = 0 })
    assert.equal("h:6379 XPENDING rfsm:out:{0} g IDLE 0 - + 1000000", sent[1])
  end)
end)

describe("the numbers of a fleet", function()
  it("are those of all tags of all masters, each once", function()
    local scans = { { "7", { "rfsm:due:{0}", "rfsm:in:{1}", "rfsm:due:{1}" } },
      { "0", { "rfsm:in:{0}" } }, { "0", { "m:{0}:1", "rfsm:in:{0}" } } }
    local sent, text = with_client(function(words)
      if words[1] == "SCAN" then return table.remove(scans, 1) end
      if words[2] == "rfsm_versions" then return { "c", "gone", "1f-2", 3 } end
      local is_first = words[4] == "rfsm:in:{0}"
      return { { "c", 'root."a\\\n', 2, "c", "root.b", 1 }, 3, 4, 5, 6, 7,
        is_first and "1.5" or "0.5", is_first and "0" or "7.25",
        { "rfsm_events_total", "c", 9 } }
    end, function(client) return client:stats() end)
    assert.same({ "h:6379 CLUSTER NODES", "h:6379 SCAN 0 MATCH rfsm:*:{*} COUNT 1000",
      "h:6379 FCALL rfsm_stats 1 rfsm:in:{0}", "h:6379 FCALL rfsm_stats 1 rfsm:in:{1}",
      "h:6379 SCAN 7 MATCH rfsm:*:{*} COUNT 1000", "h:6379 CLUSTER NODES",
      "h:6379 SCAN 0 COUNT 1000 TYPE string MATCH *",
      "h:6379 FCALL rfsm_versions 1 m:{0}:1" }, sent)
    assert.equal([[
# TYPE rfsm_aside gauge
rfsm_aside 8
# TYPE rfsm_dead gauge
rfsm_dead 14
# TYPE rfsm_entries gauge
rfsm_entries 10
# TYPE rfsm_events_total counter
rfsm_events_total{chart="c"} 9
# TYPE rfsm_machines gauge
rfsm_machines{chart="c",state="root.\"a\\\n"} 4
rfsm_machines{chart="c",state="root.b"} 2
# TYPE rfsm_oldest_entry_seconds gauge
rfsm_oldest_entry_seconds 1.5
# TYPE rfsm_oldest_timer_seconds gauge
rfsm_oldest_timer_seconds 7.25
# TYPE rfsm_overdue gauge
rfsm_overdue 12
# TYPE rfsm_timers gauge
rfsm_timers 6
# TYPE rfsm_version_machines gauge
rfsm_version_machines{chart="c",known="gone",version="1f-2"} 3
]], text)
  end)

  it("need a server, as loading a library does", function()
    with_client(always { err = "ERR no" }, function(client)
      assert.same({ false, "ERR no" }, { client:load("text") })
      assert.is_false((pcall(client.stats, client)))
    end)
    local sent = with_client(always(true), function(client)
      assert.same({ true }, { client:load("text") })
    end)
    assert.equal("h:6379 FUNCTION LOAD REPLACE text", sent[2])
  end)
end)
