-- Connections to Redis: addresses, a server that is lost, slots that move. The servers
-- are tables in this process.

local helper = require "spec.helper"
local net_of = require "spec.support.redis_net"

if not helper.package "redis" then
  describe("a connection", function()
    it("needs lua-redis", function() pending("lua-redis is missing") end)
  end)
  return
end

-- The module, loaded anew: it keeps the commands of lua-redis.
local function fresh()
  package.loaded["rfsm.redis.connection"] = nil
  local connection = require "rfsm.redis.connection"
  package.loaded["rfsm.redis.connection"] = nil
  return connection
end

local parse = fresh().parse

-- Calls f(connection) in a net; returns what it sent, and the result or the error.
local function within(net, f)
  local ok, result = pcall(helper.with, package.loaded, net.packages, function()
    return f(fresh())
  end)
  if not ok and type(result) == "table" then error(result, 0) end -- of an assertion
  return net.trace, result, ok
end

local OPTIONS = { timeout = 5, patience = 10 }

-- Connects to addresses and calls f(connected, net); returns the trace since then.
local function connected(net, urls, f, options)
  local from
  local trace, result, ok = within(net, function(connection)
    local made = connection.connect(urls, options or OPTIONS)
    from = #net.trace
    return f(made, net)
  end)
  local sent = {}
  for i = (from or 0) + 1, #trace do sent[#sent + 1] = trace[i] end
  return sent, result, ok
end

-- A node that is no cluster and replies with what it was asked.
local function echo(words)
  if words[1] == "CLUSTER" then return { err = "ERR no cluster" } end
  return table.concat(words, " ")
end

describe("an address of a server", function()
  for url, expected in pairs {
    ["redis://h"] = { host = "h", port = 6379, is_tls = false },
    ["redis://h:80/"] = { host = "h", port = 80, is_tls = false },
    ["redis://h/3"] = { host = "h", port = 6379, db = 3, is_tls = false },
    ["rediss://u:p%40%3a@h.x:1/2"] = { host = "h.x", port = 1, db = 2, is_tls = true,
      user = "u", password = "p@:" },
    ["redis://:p@h"] = { host = "h", port = 6379, password = "p", is_tls = false },
    ["redis://:@h"] = { host = "h", port = 6379, password = "", is_tls = false },
  } do
    it("is read: " .. url, function() assert.same(expected, parse(url)) end)
  end

  for _, url in ipairs { "http://h", "redis://", "redis:h", "redis://a/b",
    "redis://a:b", "redis://a:1:2", "redis://u@h:x", "xredis://h" } do
    it("is refused: " .. url, function() assert.is_nil(parse(url)) end)
  end
end)

describe("a connection", function()
  it("is authenticated, and has its database, with a limit of time", function()
    local net = net_of.new { ["h:1"] = function() return true end }
    assert.same({ "h:1 AUTH u p", "h:1 SELECT 2", "h:1 CLUSTER SLOTS" },
      (within(net, function(c) c.connect("redis://u:p@h:1/2", OPTIONS) end)))
    assert.same({ 5, true }, { net.sockets[1].timeout, net.sockets[1]["tcp-nodelay"] })
    net = net_of.new { ["h:1"] = function() return true end }
    assert.same({ "h:1 AUTH p", "h:1 CLUSTER SLOTS" }, (within(net, function(c)
      c.connect("redis://:p@h:1", OPTIONS)
    end)))
  end)

  it("tries the next address if there is no server at the first", function()
    local net = net_of.new { ["b:6379"] = echo }
    local _, made = within(net, function(c)
      return c.connect({ "redis://:x@a/1", "redis://b" }, OPTIONS)
    end)
    assert.same({ { "a:6379", "b:6379" }, "x", 1 },
      { made.seeds, made.settings.password, made.settings.db })
    assert.same({ "b:6379 AUTH x", "b:6379 SELECT 1", "b:6379 CLUSTER SLOTS" },
      net.trace)
  end)

  it("reports the first address if there is none", function()
    local _, problem, ok = within(net_of.new {}, function(c)
      c.connect({ "redis://a", "redis://b" }, OPTIONS)
    end)
    assert.same({ false, "rfsm.fleet: cannot connect to a:6379: connection refused" },
      { ok, problem })
  end)

  for _, text in ipairs { "NOAUTH Authentication required.", "ERR wrong" } do
    it("reports that a password is wrong: " .. text, function()
      local _, problem = within(net_of.new { ["a:6379"] = function()
        return { err = text }
      end }, function(c) c.connect("redis://:x@a", OPTIONS) end)
      assert.equal("rfsm.fleet: cannot connect to a:6379: " .. text, problem)
    end)
  end

  it("is not made if the server is lost at once", function()
    local _, problem = within(net_of.new { ["a:6379"] = function() return nil end },
      function(c) c.connect("redis://a", OPTIONS) end)
    assert.equal("rfsm.fleet: no server of Redis answers: connection error: closed",
      problem)
  end)

  it("knows the nodes of a cluster, each once", function()
    local net = net_of.new { ["a:1"] = function()
      return { { 0, 5, { "a", 1, "id" }, { "b", 2, "id" } }, { 6, 9, { "c", 3, "id" },
        { "", 4, "id" }, { "b", 2, "id" }, { false, 5, "id" } } }
    end }
    local _, made = within(net, function(c)
      return c.connect("redis://a:1", OPTIONS)
    end)
    assert.same({ "a:1", "b:2", "c:3" }, made.seeds)
  end)
end)

describe("a secured connection", function()
  -- Connects with a stand-in for luasec; returns its settings, or the problem.
  local function secured(wrapped, options)
    local net, seen = net_of.new { ["h:1"] = echo }, nil
    net.packages.ssl = { wrap = function(socket, settings)
      seen = settings
      function socket.dohandshake() return wrapped.ok, wrapped.why end
      if wrapped.problem then return nil, wrapped.problem end
      return socket
    end }
    local _, problem, ok = within(net, function(c)
      c.connect("rediss://h:1", { timeout = 7, patience = 1, tls = options })
    end)
    return ok and seen or problem, net
  end

  it("checks the server's certificate against those of the system", function()
    local settings, net = secured { ok = true }
    assert.same({ mode = "client", protocol = "any", verify = "peer",
      capath = "/etc/ssl/certs", options = "all" }, settings)
    assert.equal(7, net.sockets[1].timeout)
  end)

  it("takes settings of luasec", function()
    assert.equal("mine", secured({ ok = true }, { cafile = "mine" }).cafile)
    assert.equal("none", secured({ ok = true }, { verify = "none" }).verify)
  end)

  for what, case in pairs {
    ["the handshake fails"] = { ok = false, why = "bad cert" },
    ["the settings are wrong"] = { problem = "bad cert" },
  } do
    it("is not made if " .. what, function()
      assert.equal("rfsm.fleet: cannot connect to h:1: TLS: bad cert", (secured(case)))
    end)
  end

  it("needs luasec", function()
    local net = net_of.new { ["h:1"] = echo }
    local _, problem = within(net, function(c)
      package.preload.ssl = function() error("not here") end
      package.loaded.ssl = nil
      c.connect("rediss://h:1", OPTIONS)
    end)
    package.preload.ssl = nil
    assert.equal("rfsm.fleet: cannot connect to h:1: the package lua-sec is missing",
      problem)
  end)
end)

describe("a call", function()
  -- Returns a node that gives these replies in turn, then echoes.
  local function replying(...)
    local replies, i = { ... }, 0
    return function(words, socket)
      if words[1] == "CLUSTER" then return echo(words) end
      i = i + 1
      if replies[i] == nil then return echo(words, socket) end
      if replies[i] == "lost" then return nil end
      return { err = replies[i] }
    end
  end

  local function get(made) return made:call("7", "GET", "k") end

  it("is for the first address, and a reply is what the server has sent", function()
    assert.same({ "a:6379 GET k" }, (connected(net_of.new { ["a:6379"] = echo },
      "redis://a", get)))
  end)

  for text, expected in pairs {
    ["MOVED 12 b:2"] = { "a:6379 GET k", "b:2 GET k", "b:2 GET k" },
    ["ASK 12 b:2"] = { "a:6379 GET k", "b:2 ASKING", "b:2 GET k", "a:6379 GET k" },
    ["MOVED 12 :7"] = { "a:6379 GET k", "a:7 GET k", "a:7 GET k" },
    ["TRYAGAIN later"] = { "a:6379 GET k", "sleep 0.01", "a:6379 GET k",
      "a:6379 GET k" },
    ["CLUSTERDOWN down"] = { "a:6379 GET k", "sleep 0.01", "a:6379 GET k",
      "a:6379 GET k" },
  } do
    it("follows " .. text .. ", and remembers it if it lasts", function()
      local net = net_of.new { ["a:6379"] = replying(text), ["b:2"] = echo,
        ["a:7"] = echo }
      assert.same(expected, (connected(net, "redis://a", function(made)
        get(made)
        get(made)
      end)))
    end)
  end

  for _, text in ipairs { "lost", "READONLY You can't write", "MASTERDOWN Link",
    "LOADING Redis is loading" } do
    it("goes to the next address: " .. text, function()
      local net = net_of.new { ["a:6379"] = replying(text), ["b:6379"] = echo }
      local sent, reply = connected(net, { "redis://a", "redis://b" }, get)
      assert.same({ { "a:6379 GET k", "a:6379 close", "b:6379 GET k" }, "GET k" },
        { sent, reply })
    end)
  end

  it("forgets where hash tags were on a server that is lost, and no others", function()
    local net = net_of.new { ["a:1"] = replying("MOVED 1 b:2", "MOVED 2 c:3"),
      ["b:2"] = echo, ["c:3"] = echo }
    connected(net, "redis://a:1", function(made)
      made:call("1", "GET", "k")
      made:call("2", "GET", "k")
      assert.same({ ["1"] = "b:2", ["2"] = "c:3" }, made.node_of)
      net.nodes["b:2"] = replying("lost")
      made:call("1", "GET", "k")
      assert.same({ ["2"] = "c:3" }, made.node_of)
    end)
  end)

  it("waits a little longer each time, until its patience is over", function()
    local net = net_of.new { ["a:1"] = function(words)
      if words[1] == "CLUSTER" then return echo(words) end
      return { err = "TRYAGAIN later" }
    end }
    local sent, problem, ok = connected(net, "redis://a:1", get, { timeout = 1,
      patience = 1 })
    local sleeps = {}
    for _, line in ipairs(sent) do sleeps[#sleeps + 1] = line:match("^sleep (.*)") end
    assert.equal("0.01 0.02 0.03 0.04 0.05 0.06 0.07 0.08 0.09 0.1 0.11 0.12 0.13 "
      .. "0.14",
      table.concat(sleeps, " "))
    assert.same({ false, "rfsm.fleet: no answer for {7} in 1 s: TRYAGAIN later" },
      { ok, problem })
  end)

  it("never waits longer than 0.2 s", function()
    local net = net_of.new { ["a:1"] = function(words)
      if words[1] == "CLUSTER" then return echo(words) end
      return { err = "TRYAGAIN later" }
    end }
    local sent = connected(net, "redis://a:1", get, { timeout = 1, patience = 9 })
    assert.equal("sleep 0.2", sent[#sent])
  end)

  it("does not wait before it has tried two others", function()
    local net = net_of.new { ["a:1"] = replying("lost"), ["b:1"] = replying("lost"),
      ["c:1"] = replying("lost") }
    local sent = connected(net, { "redis://a:1", "redis://b:1", "redis://c:1" }, get)
    local lines = {}
    for _, line in ipairs(sent) do
      if not line:find("CLUSTER") then lines[#lines + 1] = line end
    end
    assert.same({ "a:1 GET k", "a:1 close", "b:1 GET k", "b:1 close", "c:1 GET k",
      "c:1 close", "sleep 0.03", "a:1 GET k" }, lines)
  end)

  it("raises an error of the server as it is", function()
    local _, problem, ok = connected(net_of.new { ["a:1"] = replying("ERR x:1: y") },
      "redis://a:1", get)
    assert.same({ false, "ERR x:1: y" }, { ok, problem })
  end)

  it("gives up at an ASK that is refused for good", function()
    local net = net_of.new { ["a:1"] = replying("ASK 1 b:1"),
      ["b:1"] = replying("NOPERM no ASKING") }
    assert.equal("NOPERM no ASKING", (select(2, connected(net, "redis://a:1", get))))
  end)
end)

describe("calls at once", function()
  local function ask(made)
    local replies = made:call_all({ "1", "2", "3" }, { { "GET", "x" }, { "GET", 2 },
      { "GET", "z" } })
    return table.concat(replies, ", ")
  end

  it("are sent to each node together, and replies are in order", function()
    local net = net_of.new { ["a:1"] = echo, ["b:1"] = echo }
    local sent, replies = connected(net, "redis://a:1", function(made)
      made.node_of["2"] = "b:1"
      return ask(made)
    end)
    table.sort(sent)
    assert.same({ { "a:1 GET x", "a:1 GET z", "b:1 GET 2" }, "GET x, GET 2, GET z" },
      { sent, replies })
    for _, socket in ipairs(net.sockets) do
      if socket.address == "b:1" then assert.equal(1, socket.sends) end
      if socket.address == "a:1" then assert.equal(2, socket.sends) end -- with SLOTS
    end
  end)

  it("that fail are made again, one by one", function()
    local lost = 0
    local net = net_of.new { ["a:1"] = function(words)
      if words[2] == "2" and lost == 0 then
        lost = 1
        return nil
      end
      return echo(words)
    end }
    local sent, replies = connected(net, "redis://a:1", ask)
    assert.same({ "a:1 GET x", "a:1 GET 2", "a:1 close", "a:1 GET 2", "a:1 GET z" },
      sent)
    assert.equal("GET x, GET 2, GET z", replies)
  end)

  it("follow a slot that has moved", function()
    local net = net_of.new { ["b:1"] = echo, ["a:1"] = function(words)
      return words[2] == "z" and { err = "MOVED 3 b:1" } or echo(words)
    end }
    local sent, replies = connected(net, "redis://a:1", ask)
    assert.same({ "a:1 GET x", "a:1 GET 2", "a:1 GET z", "a:1 GET z", "b:1 GET z" },
      sent)
    assert.equal("GET x, GET 2, GET z", replies)
  end)

  it("raise what the server reports", function()
    local _, problem = connected(net_of.new { ["a:1"] = function(words)
      return words[2] == "z" and { err = "ERR no z" } or echo(words)
    end }, "redis://a:1", ask)
    assert.equal("ERR no z", problem)
  end)
end)

describe("a further connection", function()
  it("is to the node of a hash tag, and waits without a limit", function()
    local net = net_of.new { ["a:1"] = echo, ["b:2"] = echo }
    connected(net, "redis://a:1", function(made)
      made.node_of["9"] = "b:2"
      local client, command = made:open_for("9")
      assert.equal("PING 1", command("PING", 1))
      assert.equal("b:2", client.network.socket.address)
      assert.is_nil(client.network.socket.timeout)
      assert.equal("a:1", made:open_for("8").network.socket.address)
      assert.is_nil(made.nodes["b:2"])
    end)
  end)
end)

describe("each master", function()
  local NODES = "1 a:1@2 myself,master - 0 0 1 connected 0-5\n"
    .. "2 b:1@2 master - 0 0 1 connected 6-9\n3 c:1@2 slave 1 0 0 1 connected\n"
    .. "4 d:1@2 master,fail - 0 0 1 connected\n"

  -- The addresses that are called; each node says which nodes there are.
  local function called(nodes, word)
    local net = net_of.new {}
    for _, address in ipairs { "a:1", "b:1", "c:1", "d:1" } do
      net.nodes[address] = function(words)
        if words[2] == "NODES" then return nodes end
        if words[1] == word then return nil end
        return echo(words)
      end
    end
    return connected(net, "redis://a:1", function(made)
      made:each_master(function(call) call("PING") end)
    end)
  end

  it("is called in a cluster, unless it has failed", function()
    assert.same({ "a:1 CLUSTER NODES", "a:1 PING", "b:1 PING" }, (called(NODES)))
  end)

  it("is the only server otherwise", function()
    assert.same({ "a:1 CLUSTER NODES", "a:1 PING" }, (called { err = "ERR none" }))
  end)

  it("that is lost is reported, and connected anew next time", function()
    local sent, problem, ok = called(NODES, "PING")
    assert.same({ false, "connection error: closed" }, { ok, problem })
    assert.equal("a:1 close", sent[#sent])
  end)

  it("is asked for at a node that is known to be there", function()
    local net = net_of.new { ["a:1"] = echo, ["b:1"] = function(words)
      return words[2] == "NODES" and NODES or echo(words)
    end }
    local sent = connected(net, "redis://a:1", function(made)
      made.node_of["1"] = "b:1"
      made:each_master(function(call) return call("PING") end)
    end)
    assert.equal("b:1 CLUSTER NODES", sent[1])
  end)
end)
