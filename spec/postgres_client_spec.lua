-- The client of machines in PostgreSQL: transactions, lost connections, workers. The
-- server is a table in this process; `spec/postgres_spec.lua` has the real one.

local helper = require "spec.helper"
local net_of = require "spec.support.postgres_net"
local new_random = require "spec.support.random"
local servers = require "spec.support.servers"

if not helper.package "dkjson" then
  describe("the client of PostgreSQL", function()
    it("needs dkjson", function() pending("dkjson is missing") end)
  end)
  return
end

local postgres = require "rfsm.postgres"

after_each(helper.remove_files)

-- waiting --1 s--> done, which emits, unless it keeps a text that ends the transaction
local TIMED = [[
return rfsm.state {
  keep = { "x" }, waiting = rfsm.state {},
  done = rfsm.state { entry = function(fsm)
    fsm.emit("done", { x = fsm.x })
    error("no", 0)
  end },
  rfsm.trans { src = "initial", tgt = "waiting" },
  rfsm.trans { src = "waiting", tgt = "done", events = { "e_after(1)" } },
}]]

local charts, net, slept

setup(function()
  charts = postgres.charts { "counter=" .. helper.file_with(servers.COUNTER),
    "timed=" .. helper.file_with(TIMED) }
end)

before_each(function()
  net, slept = net_of.new(), 0
end)

local function connect(options, other_charts)
  options = options or {}
  options.sleep = options.sleep or function(seconds) slept = slept + seconds end
  local client = postgres.connect(other_charts or charts, function()
    return net:open()
  end, options)
  client.id = "me"
  helper.clear(net.trace)
  return client
end

-- Fails once at a statement.
local function fail_once(words, when, kind)
  net.fault = function(found, at)
    if found:find(words, 1, true) and at == when then
      net.fault = function() end
      return kind
    end
  end
end

local SEND = { "BEGIN", "SELECT value FOR UPDATE", "UPDATE rfsm.machines", "COMMIT" }

describe("a call of the client", function()
  it("is one transaction that locks the row", function()
    local client = connect()
    assert.same({ leaf = "root.even", mode = "done", errors = {},
      outcome = "taken" }, client:create("1", "counter"))
    assert.same({ "BEGIN", "SELECT value FOR UPDATE", "INSERT INTO rfsm.machines",
      "COMMIT" }, net.trace)
    helper.clear(net.trace)
    assert.same({ leaf = "root.odd", mode = "done", errors = {},
      outcome = "taken" }, client:send("1", "e_tick"))
    assert.same(SEND, net.trace)
  end)

  it("writes what callbacks emit, and their errors", function()
    local client = connect()
    client:create("1", "timed", { x = 7 })
    net.now = 1002
    local problem = "ENTRY error executing entry of root.done:  no"
    assert.same({ leaf = "root.done", mode = "done", errors = { problem },
      outcome = "taken" }, client:tick("1"))
    assert.same({ { { "1", "done", '{"x":7}' } }, { { "1", problem } } },
      { net.tables.out, net.tables.log })
  end)

  it("reads without a write", function()
    local client = connect()
    client:create("1", "counter")
    helper.clear(net.trace)
    local view = client:get("1")
    assert.same({ "counter", "root.even", { root = { n = 0 } }, {} },
      { view.chart, view.leaf, view.data, view.queue })
    assert.equal("root.trans[2] (even -> odd) would be taken on e_tick in root.even",
      client:why("1", "e_tick")[1])
    assert.same({ "BEGIN", "SELECT value", "COMMIT", "BEGIN", "SELECT value",
      "COMMIT" }, net.trace)
  end)

  it("applies an event with an id once", function()
    local client = connect()
    client:create("1", "counter")
    for _ = 1, 2 do
      assert.equal("root.odd", client:send_once("a", "1", "e_tick").leaf)
    end
    assert.equal("root.even", client:send_once("b", "1", "e_tick").leaf)
    assert.equal(2, client:get("1").data.root.n)
  end)

  it("sends events at a time, unless they are taken back", function()
    local client = connect()
    client:create("1", "counter")
    assert.equal("me-2", client:send_after("1", 10, "e_tick"))
    local ticket = client:send_after("1", 20, "e_tick")
    assert.same({ true, false }, { (client:cancel("1", ticket)),
      (client:cancel("1", ticket)) })
    assert.equal("1010.000000", net.tables.machines["1"].due)
    assert.equal(0, (client:wake()))
    net.now = 1030
    assert.same({ 1, 0 }, { client:wake() })
    assert.equal("root.odd", client:get("1").leaf)
    assert.equal(0, (client:wake()))
  end)

  for name, case in pairs {
    ["no such machine"] = { method = "send", arguments = { "9", "e_tick" },
      problem = "rfsm.send: no machine is at '9' (rfsm.create makes one)" },
    ["no machine to tick"] = { method = "tick", arguments = { "9" },
      problem = "no machine" },
    ["an unknown event"] = { method = "send", arguments = { "1", "e_tik" },
      problem = "rfsm.send: no transition of chart 'counter' has the event 'e_tik' "
        .. "(did you mean 'e_tick'?)" },
    ["an unknown chart"] = { method = "create", arguments = { "2", "count" },
      problem = "rfsm.create: no chart is named 'count' (did you mean 'counter'?)" },
    ["a second machine"] = { method = "create", arguments = { "1", "counter" },
      problem = "rfsm.create: something is at '1'" },
    ["data that is not kept"] = { method = "create",
      arguments = { "2", "counter", { colour = 1 } },
      problem = "rfsm.create: data: the root of the chart does not keep 'colour' "
        .. "(there are 'list', 'n')" },
    ["data that is no JSON"] = { method = "create",
      arguments = { "2", "counter", { n = print } },
      problem = "rfsm.postgres.create: data: a function has no JSON" },
  } do
    it("refuses, and changes nothing: " .. name, function()
      local client = connect()
      client:create("1", "counter")
      local before = net.tables
      assert.same({ nil, case.problem, n = 2 }, { n = 2, client[case.method](client,
        case.arguments[1], case.arguments[2], case.arguments[3]) })
      assert.same(before, net.tables)
      assert.equal("root.odd", client:send("1", "e_tick").leaf)
    end)
  end

  it("reports an error of SQL in one line, and changes nothing", function()
    local client = connect()
    client:create("1", "counter")
    for _, words in ipairs(SEND) do
      fail_once(words, "before", "no right")
      local before = net.tables
      assert.same({ nil, "no right", n = 2 }, { n = 2, client:send("1", "e_tick") })
      assert.equal(before, net.tables)
    end
    assert.equal("ROLLBACK", net.trace[#net.trace])
    assert.equal(1, net.opened)
  end)

  it("raises what is no key, and no seconds", function()
    local client = connect()
    assert.same({ false, "rfsm.postgres: key of a machine expected, got nil" },
      { pcall(client.send, client, nil, "e_tick") })
    assert.same({ false, "rfsm.postgres: key of a machine expected, got table" },
      { pcall(client.tick, client, {}) })
    assert.equal("rfsm.postgres.send_after: seconds expected, got -1",
      helper.refusal(client.send_after, client, "1", -1, "e_tick"))
    for _, limit in ipairs { 0, 10001, 1.5 } do
      assert.equal("rfsm.postgres.wake: whole number from 1 to 10000 expected, got "
          .. limit,
        helper.refusal(client.wake, client, limit))
    end
    assert.equal(0, (client:wake(10000)))
  end)
end)

describe("a connection that is lost", function()
  for _, words in ipairs(SEND) do
    for _, when in ipairs { "before", "after" } do
      it(("%s %s is opened again, and the event applied once"):format(when, words),
        function()
          local client = connect()
          client:create("1", "counter")
          fail_once(words, when, "lost")
          assert.equal("root.odd", client:send("1", "e_tick").leaf)
          assert.equal(2, net.opened)
          assert.equal("1", net.tables.machines["1"].data:match("%d"))
        end)
    end
  end

  it("is waited for as long as the caller has patience", function()
    local client = connect { patience = 2 }
    client:create("1", "counter")
    net.fault = function() return "lost" end
    assert.same({ nil, "server closed the connection", n = 2 },
      { n = 2, client:send("1", "e_tick") })
    assert.equal(21, net.opened)
    assert.is_true(math.abs(slept - 2) < 1e-9)
    assert.equal(10, connect().options.patience)
    client.options.patience = 0
    function client.open() return nil, "driver: FATAL\nstarting" end
    assert.equal("cannot connect: driver: FATAL",
      select(2, client:send("1", "e_tick")))
  end)

  it("is opened once where nothing can sleep", function()
    local client = connect()
    client.options.sleep = nil
    net.fault = function() return "lost" end
    helper.with(package.loaded, { socket = 1 }, function()
      client:send("1", "e_tick")
    end)
    assert.equal(1, net.opened)
  end)

  it("at random statements loses no event, and applies none twice", function()
    local random, client = new_random(28), connect()
    client:create("1", "counter")
    net.fault = function() return random:chance(20) and "lost" or nil end
    for _ = 1, 100 do assert(client:send("1", "e_tick")) end
    net.fault = function() end
    assert.equal(100, client:get("1").data.root.n)
    assert.is_true(net.opened > 10)
  end)
end)

describe("a transaction of the caller", function()
  it("is all of it", function()
    local client = connect()
    client:create("1", "counter")
    helper.clear(net.trace)
    assert.same({ true, nil, n = 2 }, { n = 2, client:transaction(function(query)
      client:send("1", "e_tick")
      query("INSERT INTO rfsm.out (key) VALUES ($1)", "7")
    end) })
    assert.same({ "BEGIN", "SELECT value FOR UPDATE", "UPDATE rfsm.machines",
      "INSERT INTO rfsm.out", "COMMIT" }, net.trace)
    assert.same({ { "7" } }, net.tables.out)
  end)

  for name, f in pairs {
    ["a call"] = function(client)
      client:send("1", "e_tick")
      assert.is_nil(client:send("1", "e_tik"))
      client:send("1", "e_tick")
    end,
    ["a statement"] = function(client, query)
      client:send("1", "e_tick")
      fail_once("INSERT", "before", "no transition of it")
      query("INSERT INTO rfsm.out (key) VALUES ($1)", "7")
    end,
    ["the caller"] = function(client)
      client:send("1", "e_tick")
      error("no transition of it", 0)
    end,
    ["a worker"] = function(client)
      client:send("1", "e_tick")
      net.now = 3000
      fail_once("UPDATE", "before", "no transition of it")
      client:wake()
    end,
    ["the connection"] = function(client)
      client:send("1", "e_tick")
      fail_once("SELECT", "before", "lost")
      assert.equal("server closed the connection",
        select(2, client:send("1", "e_tick")))
      error("no transition of it", 0)
    end,
  } do
    it("is nothing if it fails: " .. name, function()
      local client = connect()
      client:create("1", "counter")
      client:create("2", "timed")
      local before = net.tables
      local ok, problem = client:transaction(function(query) f(client, query) end)
      assert.is_false(ok)
      assert.matches("no transition of", problem)
      assert.not_matches("lua:%d", problem)
      assert.equal(before, net.tables)
      assert.equal("root.odd", client:send("1", "e_tick").leaf)
    end)
  end

  it("has no other in it", function()
    local client, inner = connect(), nil
    client:transaction(function()
      inner = helper.refusal(client.transaction, client, print)
    end)
    assert.equal("rfsm.postgres.transaction: one runs already", inner)
  end)

  it("ends when it is interrupted, as a call does", function()
    local client = connect()
    client:create("1", "counter")
    local before = net.tables
    for _, f in ipairs { function() client:send("1", "e_tick") end,
      function() client:transaction(function() client:send("1", "e_tick") end) end } do
      net.fault = function(words)
        if words:find("UPDATE", 1, true) then error("interrupted!", 0) end
      end
      assert.same({ false, "interrupted!" }, { pcall(f) })
      net.fault = function() end
      assert.equal("ROLLBACK", net.trace[#net.trace])
      assert.equal(before, net.tables)
    end
    assert.equal("root.odd", client:send("1", "e_tick").leaf)
  end)
end)

describe("a worker", function()
  -- Makes machines that are due.
  local function timed(count)
    local client = connect()
    for i = 1, count do client:create(("%d"):format(i), "timed") end
    net.now = net.now + 2
    helper.clear(net.trace)
    return client
  end

  it("wakes each machine in a transaction, and leases it in the one before", function()
    local client = timed(3)
    assert.same({ 2, 0 }, { client:wake(2) })
    local runs = "BEGIN, SELECT value, UPDATE rfsm.machines, "
      .. "INSERT INTO rfsm.out, WITH trimmed, "
    assert.equal("BEGIN, SELECT key, COMMIT, " .. runs .. "SELECT key, COMMIT, " .. runs
      .. "COMMIT", table.concat(net.trace, ", "))
    assert.same({ 1, 0 }, { client:wake() })
    assert.same({ 0, 0 }, { client:wake() })
  end)

  it("goes on with the others when another one has come to no end", function()
    local client = timed(2)
    net.tables.machines["1"].leases = 1 -- by a process that was killed in it
    net.tables.machines["1"].due = net.now + 10
    assert.same({ 1, 0 }, { client:wake() })
    net.now = net.now + 11
    assert.same({ 1, 0 }, { client:wake() })
  end)

  it("holds one after three leases, with the reason", function()
    local client = timed(2)
    net.tables.machines["1"].leases = 3
    assert.same({ 1, 0 }, { client:wake() })
    assert.same({ "1", "3 calls that ran what is due have not ended: held until it is "
      .. "released" }, net.tables.log[1])
    assert.equal("kept", client:tick("1").outcome)
    assert.equal("(release) by ann", client:release("1", "ann").outcome)
  end)

  it("puts one aside whose chart is gone", function()
    local client = timed(2)
    local row = net.tables.machines["1"]
    row.value = row.value:gsub("timed", "tamed")
    assert.same({ 1, 1 }, { client:wake() })
    assert.equal(1062, net.tables.machines["1"].due)
    assert.same({ "1", "rfsm.tick: no chart is named 'tamed' (did you mean 'timed'?)" },
      net.tables.log[1])
    assert.same({ 0, 0 }, { client:wake() })
  end)

  it("puts one aside that ends the transaction, and wakes the others", function()
    local client = timed(3)
    local count = 0
    net.fault = function(words, when)
      if words == "INSERT INTO rfsm.out" and when == "before" then
        count = count + 1
        return count == 2 and "no such text" or nil
      end
    end
    assert.same({ 2, 1 }, { client:wake() })
    assert.same({ "2", "no such text" }, net.tables.log[2])
    assert.equal(1062, net.tables.machines["2"].due)
  end)

  it("raises what ends the transaction if it cannot put the machine aside", function()
    local client = timed(1)
    net.fault = function(words, when)
      if when == "after" then return nil end
      return words == "INSERT INTO rfsm.out" and "no such text"
        or words == "WITH trimmed" and "no right" or nil
    end
    assert.same({ false, "rfsm.postgres.wake: no such text" },
      { pcall(client.wake, client) })
  end)

  it("goes on when the connection is lost, and raises what does not end", function()
    local client = timed(3)
    fail_once("UPDATE", "after", "lost")
    assert.same({ 3, 0 }, { client:wake() })
    assert.equal(3, #net.tables.out)
    net.fault = function() return "lost" end
    assert.same({ false, "rfsm.postgres.wake: server closed the connection" },
      { pcall(client.wake, client) })
  end)
end)

describe("a connection", function()
  it("may be one of LuaSQL", function()
    local trace, answers, closed = {}, {}, 0
    local connection = {
      escape = function(_, text)
        return text ~= "\255" and text:gsub("'", "''") or nil
      end,
      execute = function(_, sql)
        trace[#trace + 1] = sql
        local rows, at = answers[sql], 0
        if type(rows) ~= "table" then return rows == nil and 0 or nil, rows end
        return {
          numrows = function() return #rows end,
          fetch = function(_, row, mode)
            assert.same({ {}, "a" }, { row, mode })
            at = at + 1
            return rows[at]
          end,
          close = function() closed = closed + 1 end,
        }
      end,
    }
    local client = postgres.connect(charts, function() return connection end)
    local SELECT = "SELECT 'it''s', NULL, 'it''s', '$1', '7'"
    answers[SELECT] = { { a = "1" }, { a = "2" } }
    local found
    assert.is_true(client:transaction(function(query)
      found = { query("SELECT $1, $2, $1, $3, $4", "it's", nil, "$1", 7),
        query("DELETE") }
    end))
    assert.same({ { { a = "1" }, { a = "2" } }, {} }, found)
    assert.equal(1, closed)
    assert.same({ "BEGIN", SELECT, "DELETE", "COMMIT" }, trace)
    for _, text in ipairs { "\255", "a\0b" } do
      assert.same({ false, "a text is not valid in the server's encoding", n = 2 },
        { n = 2, client:transaction(function(query) query("$1", text) end) })
    end
    -- the connection is lost
    client.options.patience = 0
    answers.BEGIN, answers.ROLLBACK = "LuaSQL: x. PostgreSQL: ERROR:  no\n", "no"
    assert.same({ nil, "no", n = 2 }, { n = 2, client:send("1", "e_tick") })
    assert.is_false(client.query)
  end)

  it("is asked for at once", function()
    local function connecting(...)
      return helper.refusal(postgres.connect, charts, ...)
    end
    assert.equal("rfsm.postgres.connect: function expected that opens a connection, "
      .. "got string 'shop'", connecting("shop"))
    assert.equal("rfsm.postgres.connect: unknown option 'patient' (did you mean "
      .. "'patience'?), expected: patience, sleep", connecting(print, { patient = 1 }))
    assert.equal("rfsm.postgres.connect: patience: seconds expected, got -1",
      connecting(print, { patience = -1 }))
    assert.equal("rfsm.postgres.connect: sleep: function expected, got number",
      (connecting(print, { sleep = 1 }):gsub("got 1", "got number")))
    assert.same({ false, "cannot connect: none" }, { pcall(postgres.connect, charts,
      function() return nil, "none" end) })
  end)
end)

describe("JSON of clients", function()
  local json = require "rfsm.server.codec"

  it("keeps all that a number is, and a field n", function()
    for text, value in pairs {
      ["0.1"] = 0.1, ["9007199254740992"] = 2 ^ 53, ["0.30000000000000004"] = 0.1 + 0.2,
      ['{"n":2}'] = { n = 2 }, ["[1]"] = { 1 }, ["{}"] = {},
      ['{"1":1,"a":{"b":[true]}}'] = { 1, a = { b = { true } } },
      ['"\\"\\u0001\\n"'] = '"\1\n',
    } do
      assert.equal(text, json.encode(value))
    end
    assert.error_matches(function() json.encode { 1 / 0 } end,
      "^the number inf has no JSON$")
    local most = rawget(math, "maxinteger")
    if most then assert.equal("9223372036854775807", json.encode(most)) end
  end)

  it("comes back in tables without metatables", function()
    local list = json.decode('[{"a": [true, null]}]')
    assert.same({ { a = { true } } }, list)
    assert.same({}, { getmetatable(list), getmetatable(list[1]),
      getmetatable(list[1].a) })
    assert.is_nil(json.decode("[1"))
  end)
end)

describe("charts of the client", function()
  it("have the globals that they have in PostgreSQL", function()
    local file = helper.file_with([[
      return rfsm.state { rfsm.trans { src = "initial", tgt = "a" },
        a = rfsm.state { entry = function() x = 1 end },
        rfsm.trans { src = "a", tgt = "b", events = { "e" } },
        b = rfsm.state { entry = function() return spi end } }]])
    local client = connect(nil, postgres.charts { "c=" .. file })
    assert.matches("global 'x' cannot be set in PostgreSQL$",
      client:create("1", "c").errors[1])
    assert.matches("global 'spi' does not exist in PostgreSQL$",
      client:send("1", "e").errors[1])
    assert.is_nil(rawget(_G, "x"))
  end)

  -- Lua 5.1 does not yield across pcall.
  local can_yield = rawget(_G, "jit") or _VERSION ~= "Lua 5.1"

  it("serve connections that wait in coroutines", function()
    local threads, random = {}, new_random(28)
    for i = 1, can_yield and 5 or 0 do
      threads[i] = coroutine.create(function()
        local key = ("%d"):format(i)
        local client = postgres.connect(charts, function()
          local query = net:open()
          return function(...)
            coroutine.yield()
            return query(...)
          end
        end)
        assert(client:create(key, "counter"))
        for _ = 1, i * 3 do assert(client:send(key, "e_tick")) end
        return client:get(key).data.root.n
      end)
    end
    local found, left = {}, #threads
    while left > 0 do
      local i = random:below(#threads)
      if coroutine.status(threads[i]) == "suspended" then
        local ok, n = coroutine.resume(threads[i])
        assert.is_true(ok, n)
        if n then found[i], left = n, left - 1 end
      end
    end
    assert.same(can_yield and { 3, 6, 9, 12, 15 } or {}, found)
  end)

  it("print here", function()
    local file = helper.file_with([[
      return rfsm.state { a = rfsm.state { entry = function() print("here", 7) end },
        rfsm.trans { src = "initial", tgt = "a" } }]])
    local client = connect(nil, postgres.charts { "c=" .. file })
    assert.same({ "here 7" }, helper.printed(function() client:create("1", "c") end))
  end)

  it("are named in a list, with options that are known", function()
    for text, arguments in pairs {
      ["list of files expected, got string 'a.lua'"] = { "a.lua" },
      ["list of files expected, got table"] = { {} },
      ["unknown option 'id' (did you mean 'ids'?), expected: history, ids, ids_for"] =
        { { "a.lua" }, { id = 1 } },
      ["ids: whole number from 1 to 1000000 expected, got 0"] =
        { { "a.lua" }, { ids = 0 } },
      ["ids: whole number from 1 to 1000000 expected, got 1000001"] = { { "a.lua" },
        { ids = 1000001 } },
    } do
      assert.equal("rfsm.postgres.charts: " .. text, helper.refusal(postgres.charts,
        arguments[1], arguments[2]))
    end
    assert.equal("rfsm.postgres.connect: result of rfsm.postgres.charts expected, got "
      .. "table", helper.refusal(postgres.connect, {}, print))
  end)

  it("keep as many ids as they are told", function()
    local client = connect(nil, postgres.charts({ "counter="
      .. helper.file_with(servers.COUNTER) }, { ids = 1, ids_for = 1000000 }))
    client:create("1", "counter")
    for _, id in ipairs { "a", "b", "b", "a" } do
      client:send_once(id, "1", "e_tick")
    end
    assert.equal(3, client:get("1").data.root.n)
  end)

  it("are those that can run in PostgreSQL", function()
    local file = helper.file_with("local t = os.time()\nreturn rfsm.state {}")
    assert.same({ false, file .. ":1: 'os.time' does not exist in PostgreSQL" },
      { pcall(postgres.charts, { file }) })
    local _, warnings = postgres.charts { helper.file_with("return rfsm.state { a = "
      .. "rfsm.state { entry = function() while true do end end },\n"
      .. "rfsm.trans { src = 'initial', tgt = 'a' } }") }
    assert.matches(":1: warning: this loop has no end: in PostgreSQL it would hold up",
      warnings[1])
  end)

  it("leave the clock of this process alone", function()
    local timeevent, seconds = require "rfsm_timeevent", 5
    timeevent.set_gettime_hook(function() return seconds, 0 end)
    assert(connect():create("1", "timed"))
    assert.equal(5, (require("rfsm.clock").read({})))
    timeevent.set_gettime_hook(nil)
  end)
end)
