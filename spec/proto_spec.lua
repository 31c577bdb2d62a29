-- Introspection over UDP, over real sockets on loopback. Ports are the system's choice,
-- so that several runs of the specs do not meet. SEED comes from the environment.

local datagrams = require "spec.support.datagrams"
local dkjson = require "dkjson"
local helper = require "spec.helper"
local marsh = require "rfsm.marsh"
local proto = require "rfsm.proto"
local rfsm = require "rfsm"
local share = require "spec.support.share"
local socket = require "socket"

local state, trans = rfsm.state, rfsm.trans
local init, started, leaf = helper.init, helper.started, rfsm.get_actleaf_fqn

local jit = rawget(_G, "jit")
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local SEED = tonumber(os.getenv("SEED")) or 1
local COUNT = tonumber(os.getenv("COUNT")) or 5000

-- What several specs need -------------------------------------------------------

-- (initial) --> off --e_push--> on --e_push--> off
local function lamp()
  return state {
    warn = false, info = false, off = state {}, on = state {},
    trans { src = "initial", tgt = "off" },
    trans { src = "off", tgt = "on", events = { "e_push" } },
    trans { src = "on", tgt = "off", events = { "e_push" } },
  }
end

local now
local function clock() return now end

local function install(options)
  options = options or {}
  options.port = options.port or 0
  options.clock = options.clock or clock
  return proto.install(options)
end

local Client = {}
Client.__index = Client

local clients = {}

local function new_client(server)
  local udp = assert(socket.udp4())
  assert(udp:setpeername(server.host, server.port))
  local client = setmetatable({ udp = udp, server = server }, Client)
  clients[#clients + 1] = client
  return client
end

-- Sends a text, or a message as JSON. It is there when this returns.
function Client:send(message)
  local text = type(message) == "table" and dkjson.encode(message) or message
  assert(self.udp:send(text))
  assert(socket.select({ self.server.udp }, nil, 5)[1], "nothing arrived")
end

function Client:read()
  self.udp:settimeout(5)
  return (assert(dkjson.decode((assert(self.udp:receive(65536))), 1, nil, nil, nil)))
end

-- Returns nothing when nothing is there, else a text.
function Client:peek()
  self.udp:settimeout(0)
  return (self.udp:receive(65536))
end

-- Reads n messages: each as one line.
function Client:lines(n)
  local lines = {}
  for i = 1, n do
    local message = self:read()
    local what = message.text or message.graph and message.fsm
    if what == nil then what = message.act_leaf end
    lines[i] = message.type:gsub("^rfsm_", "") .. " " .. tostring(what)
  end
  assert.is_nil(self:peek())
  return lines
end

function Client:subscribe(fsm) self:send { type = "subscribe", fsm = fsm } end

-- A lamp that answers at a port, and has been entered; one who may talk to it.
local function served(options)
  local server = install(options)
  return started(lamp()), new_client(server), server
end

-- The same with one who has subscribed and read what that brings.
local function subscribed(options)
  local fsm, client, server = served(options)
  client:subscribe()
  rfsm.step(fsm)
  client:lines(2)
  return fsm, client, server
end

-- Sockets whose functions can be replaced by those in `fake`.
local function with_fake_socket(fake, f)
  local function udp4()
    local udp = assert(socket.udp4())
    local own = setmetatable({}, { __index = function(_, name)
      return function(_, ...) return udp[name](udp, ...) end
    end })
    for name, replacement in pairs(fake) do -- any order: distinct names
      own[name] = function(_, ...) return replacement(udp, ...) end
    end
    return own
  end
  helper.with(package.loaded, {
    socket = setmetatable({ udp4 = udp4 }, { __index = socket }),
  }, f)
end

-- Why install refuses these options.
local function problem_of(options)
  local text = helper.refusal(proto.install, options)
  return (text:gsub("^rfsm.proto.install: ", ""))
end

-- Sends to a machine and steps it; returns the n messages that come back.
local function answers(fsm, client, n, ...)
  for i = 1, select("#", ...) do client:send((select(i, ...))) end
  rfsm.step(fsm)
  return client:lines(n)
end

local OFF, ON = "active_state root.off", "active_state root.on"
local SUBSCRIBE, HEARTBEAT = { type = "subscribe" }, { type = "heartbeat" }
local PUSH = { type = "event", event = "e_push" }

before_each(function() now = 1000 end)

after_each(function()
  for i = #clients, 1, -1 do
    clients[i].udp:close()
    clients[i] = nil
  end
  proto.uninstall()
end)

local TYPES = "error event: string, boolean or finite number expected, got "
local NUMBER = ": fsm: number of a machine expected, got "

-- What a lamp with these options answers to the messages of a subscriber.
for _, case in ipairs {
  { "a subscription that is repeated brings the graph again, and one copy of all", {},
    { SUBSCRIBE, SUBSCRIBE }, { "model 1", OFF } },
  { "unsubscribe ends a subscription", {}, { { type = "unsubscribe" } }, {} },
  { "an event is refused without allow_send", {}, { PUSH },
    { "error event: refused, allow_send is off", OFF } },
  { "an event of another type is refused", { allow_send = true },
    { '{"type":"event","event":{}}', '{"type":"event","event":[1]}',
      '{"type":"event","event":1e999}', '{"type":"event","event":null}' },
    { TYPES .. "table", TYPES .. "table", TYPES .. "inf", TYPES .. "nil", OFF } },
  { "a number that no machine has is refused", { allow_send = true },
    { { type = "subscribe", fsm = 3 }, '{"type":"event","event":"e_push","fsm":"1"}' },
    { "error subscribe" .. NUMBER .. "3", "error event" .. NUMBER .. "string", OFF } },
} do
  it(case[1], function()
    local fsm, client = subscribed(case[2])
    assert.same(case[4], answers(fsm, client, #case[4], unpack(case[3])))
  end)
end

it("an event with data is sent, and data that a snapshot cannot have are refused",
  function()
    local seen, model = false, lamp()
    model.off = rfsm.state { exit = function(_, _, _, event) seen = event end }
    model[2] = rfsm.trans { src = "off", tgt = "on", events = { rfsm.named "e_paid" } }
    local server = install { allow_send = true }
    local fsm, client = started(model), new_client(server)
    client:send { type = "event", event = { name = "e_paid", by = { id = 3 } } }
    rfsm.run(fsm)
    assert.same({ name = "e_paid", by = { id = 3 } }, seen)
    client:send '{"type":"event","event":{"name":"e_paid","n":1e999}}'
  end)

describe("a subscription", function()
  it("brings the graph, then the active leaf after each iteration", function()
    local fsm, client = served()
    client:subscribe()
    helper.post_and_run(fsm, "e_push")
    assert.same({ "model 1", ON, ON, ON }, client:lines(4))
  end)

  it("brings the graph that rfsm.marsh knows", function()
    local fsm, client = served()
    client:subscribe()
    rfsm.step(fsm)
    local model = client:read()
    assert.same(marsh.model2tab(fsm), model.graph)
    model.graph = nil
    assert.same({ type = "rfsm_model", version = 2, fsm = 1, cnt = 3 }, model)
  end)

  it("writes messages in a fixed order of fields, counted", function()
    local fsm, client = subscribed()
    for count = 5, 7 do
      rfsm.step(fsm)
      assert.equal(('{"type":"rfsm_active_state","version":2,"fsm":1,"cnt":%d,'
        .. '"act_leaf":"root.off","act_leaf_state":"done","path":false}'):format(
        count), client:peek())
    end
  end)

  it("writes the graph in a fixed order of fields", function()
    local server = install()
    local fsm = init(state { warn = false, info = false, on = state { dim = state {},
      trans { src = "initial", tgt = "dim" },
      trans { src = "dim", tgt = "dim", pn = 2, events = { "e_a", "e_b" } },
      trans { src = "dim", tgt = "internal", events = { "e_c" } } },
      trans { src = "initial", tgt = "on" } })
    local client = new_client(server)
    client:subscribe()
    rfsm.step(fsm)
    assert.equal('{"type":"rfsm_model","version":2,"fsm":1,"cnt":0,"graph":{"id":'
      .. '"root","type":"state","transitions":[{"type":"transition","src":'
      .. '"root.initial","tgt":"root.on.initial","events":[]}],"subnodes":[{"id":'
      .. '"initial","type":"connector"},{"id":"on","type":"state","transitions":'
      .. '[{"type":"transition","src":"root.on.initial","tgt":"root.on.dim",'
      .. '"events":[]},{"type":"transition","src":"root.on.dim","tgt":"root.on.dim",'
      .. '"pn":2,"events":["e_a","e_b"]},{"type":"transition","src":"root.on.dim",'
      .. '"tgt":"root.on.dim","events":["e_c"],"internal":true}],"subnodes":[{"id":'
      .. '"initial","type":"connector"},{"id":"dim","type":"state"}]}]}}',
      client:peek())
  end)

  it("brings the paths that are taken to whom asks, and looks for nobody else",
    function()
      local fsm, client, server = served()
      local other = started(lamp())
      client:send { type = "subscribe", path = true, fsm = 2 }
      rfsm.step(fsm)
      assert.is_nil(fsm._path_hooks)
      rfsm.step(other)
      client:lines(2)
      local asking = new_client(server)
      asking:send { type = "subscribe", path = true, fsm = 1 }
      helper.post_and_run(fsm, "e_push")
      local paths = {}
      for i = 1, 3 do paths[i] = asking:read().path or false end
      assert.same({ false, "root.off[LS]->root.on[LS]", false },
        { paths[1], asking:read().path or paths[2], paths[3] })
      rfsm.step(fsm)
      assert.equal(1, #fsm._path_hooks) -- one is enough
      asking:send { type = "unsubscribe" }
      rfsm.step(fsm)
      assert.is_nil(fsm._path_hooks)
    end)

  it("is served before the machine has been entered, or if it cannot be", function()
    for _, is_closed in ipairs { false, true } do
      local server, model = install(), lamp()
      model[1].guard, model.err = function() return not is_closed end, false
      local fsm, n = init(model), is_closed and 1 or 2
      assert.same({ "model 1", n == 2 and OFF or nil },
        answers(fsm, new_client(server), n, SUBSCRIBE))
      server:close()
    end
  end)

  it("brings the mode of the leaf", function()
    local server = install()
    local fsm = init(state { warn = false, doo = function() rfsm.yield(true) end })
    local client, modes = new_client(server), {}
    client:subscribe()
    rfsm.step(fsm, 3)
    rfsm.step(fsm)
    client:read()
    for i = 1, 3 do modes[i] = client:read().act_leaf_state end
    assert.same({ "active", "active", "done" }, modes)
  end)

  it("is refused if there are too many", function()
    local fsm, client, server = subscribed { max_subscribers = 1 }
    local late = new_client(server)
    late:subscribe()
    client:subscribe()
    rfsm.step(fsm)
    assert.same({ "error subscribe: there are 1 subscribers already" }, late:lines(1))
    assert.same({ "model 1", OFF }, client:lines(2))
  end)

  it("goes on after reset, which it reports", function()
    local fsm, client = subscribed()
    rfsm.reset(fsm)
    assert.same({ "active_state false" }, client:lines(1))
    assert.same({ OFF }, answers(fsm, client, 1))
  end)

  it("brings the new graph after fsm_merge", function()
    local fsm, client = subscribed()
    assert(rfsm.fsm_merge(fsm, fsm, state {}, "dim"))
    rfsm.step(fsm)
    assert.same(marsh.model2tab(fsm), client:read().graph)
    assert.same({ OFF }, client:lines(1))
  end)

  it("brings no graph anew of another machine than the merged one", function()
    local fsm, client = served()
    local other = started(lamp())
    client:subscribe()
    rfsm.step(fsm)
    rfsm.step(other)
    client:lines(4)
    assert(rfsm.fsm_merge(fsm, fsm, state {}, "dim"))
    assert.same({ OFF }, answers(other, client, 1))
    assert.same({ "model 1", OFF }, answers(fsm, client, 2))
  end)

  it("reports a graph or a name that is too long for a datagram", function()
    local name = ("x"):rep(2000)
    local server = install { max_datagram = 1024 }
    local fsm = init(state { warn = false, info = false, [name] = state {},
      trans { src = "initial", tgt = name } })
    assert.same({ "error model: too long for a datagram",
      "error active_state: too long for a datagram" },
      answers(fsm, new_client(server), 2, SUBSCRIBE))
  end)

  it("reports a graph that cannot be written", function()
    local fsm, client = served()
    helper.with(marsh, { jsontab = function() error("stack overflow", 0) end },
      function()
        assert.same({ "error model: the graph cannot be written: stack overflow",
          OFF }, answers(fsm, client, 2, SUBSCRIBE))
      end)
  end)
end)

describe("a heartbeat", function()
  it("keeps a subscription, without it that ends after 3 s", function()
    local fsm, client, server = subscribed()
    local dead = new_client(server)
    assert.same({ "model 1", OFF }, answers(fsm, dead, 2, SUBSCRIBE))
    client:lines(1)
    now = now + 3
    assert.same({ OFF }, answers(fsm, client, 1, HEARTBEAT))
    assert.same({ OFF }, dead:lines(1))
    now = now + 0.001
    assert.same({ OFF }, answers(fsm, client, 1))
    assert.same({}, dead:lines(0))
  end)

  it("that waited while nothing ran counts when it is read", function()
    local fsm, client = subscribed()
    client:send(HEARTBEAT)
    now = now + 100
    assert.same({ OFF }, answers(fsm, client, 1))
  end)

  it("of a stranger is refused", function()
    local fsm, client = subscribed { max_silence = 1 }
    now = now + 2
    rfsm.step(fsm)
    assert.same({ "error heartbeat: not subscribed" },
      answers(fsm, client, 1, HEARTBEAT))
  end)

  it("is not missed when the clock jumps back", function()
    local fsm, client = subscribed()
    for _, case in ipairs { { -500, { OFF } }, { 3, { OFF } }, { 1, {} } } do
      now = now + case[1]
      assert.same(case[2], answers(fsm, client, #case[2]))
    end
  end)

  it("is not missed while more waits than a step reads", function()
    local fsm, client, server = subscribed { max_reads = 4 }
    local flood = new_client(server)
    for _ = 1, 4 do flood:send("x") end
    client:send(HEARTBEAT)
    now = now + 4
    rfsm.step(fsm)
    assert.same({ OFF, OFF }, answers(fsm, client, 2))
  end)

  for name, fails in pairs { -- any order: each is a spec of its own
    raises = function() error("no clock", 0) end,
    ["is no number"] = function() return nil end,
    ["is not finite"] = function() return 0 / 0 end,
  } do
    it("is not missed when the clock fails: it " .. name, function()
      local fsm, client = subscribed { clock = function()
        return now < 1003 and now or fails()
      end }
      local complaints = helper.said(fsm, "err")
      now = now + 10
      assert.same({ OFF }, answers(fsm, client, 1))
      assert.matches("^PROTO the clock failed: ", complaints[1])
    end)
  end
end)

describe("an event", function()
  it("goes to the machine, which is not idle then, and the same call acts on it",
    function()
      local fsm, client = subscribed { allow_send = true }
      client:send(PUSH)
      assert.is_false(rfsm.step(fsm))
      assert.is_true(rfsm.run(fsm))
      assert.equal("root.on", leaf(fsm))
      client:send(PUSH)
      assert.is_true(rfsm.run(fsm))
      assert.equal("root.off", leaf(fsm))
    end)

  it("can be a number or a boolean, needs no subscription, and is traced", function()
    local server, model = install { allow_send = true }, lamp()
    model[2].events, model[3].events = { 7 }, { false }
    local fsm, client = started(model), new_client(server)
    local raised = helper.said(fsm, "dbg", "RAISED")
    for _, case in ipairs { { 7, "root.on" }, { false, "root.off" } } do
      client:send { type = "event", event = case[1] }
      assert.equal(case[2], helper.leaf_after(fsm))
    end
    assert.same({ "RAISED 7", "RAISED e_done@root.on", "RAISED false",
      "RAISED e_done@root.off" }, raised)
  end)

  it("for a machine that is not advanced waits, up to a limit", function()
    local server = install { allow_send = true, max_events = 3 }
    local busy, lazy = started(lamp()), started(lamp())
    local push = { type = "event", event = "e", fsm = 2 }
    assert.same({ "error event: 3 events are pending already" },
      answers(busy, new_client(server), 1, push, push, push, push))
    assert.equal(3, rfsm.check_events(lazy))
    rfsm.reset(lazy)
    assert.equal(1, rfsm.check_events(lazy)) -- e_init_fsm
  end)
end)

describe("several machines at a port", function()
  local function two()
    local first, client = served { allow_send = true }
    return first, started(lamp()), client
  end

  it("are numbered in the order of their first steps, reported also later", function()
    local _, client = subscribed()
    local third, second = init(lamp()), init(lamp())
    rfsm.step(second)
    assert.same({ "model 2", OFF, "model 3", OFF }, answers(third, client, 4))
  end)

  it("are all reported unless a subscription names one", function()
    local first, second, client = two()
    client:subscribe(2)
    rfsm.step(first)
    assert.same({ "model 2", OFF }, answers(second, client, 2))
  end)

  it("get the events that name them, the first those that name none", function()
    local first, second, client = two()
    for _, case in ipairs { { nil, "root.on", "root.off" },
      { 2, "root.on", "root.on" } } do
      client:send { type = "event", event = "e_push", fsm = case[1] }
      assert.equal(case[2], helper.leaf_after(first))
      assert.equal(case[3], helper.leaf_after(second))
    end
  end)

  it("are not kept alive", function()
    local server = install()
    local first, second = init(lamp()), init(lamp())
    local kept = setmetatable({ first, second }, { __mode = "v" })
    new_client(server):subscribe()
    rfsm.run(first)
    install { fsm = second }
    first, second = nil, nil -- luacheck: ignore 311
    collectgarbage()
    collectgarbage()
    assert.same({}, kept)
  end)

  it("can have ports of their own, or two", function()
    local first, second = init(lamp()), init(lamp())
    for _, fsm in ipairs { first, second, second } do
      local client = new_client(install { fsm = fsm })
      assert.same({ "model 1", OFF }, answers(fsm, client, 2, SUBSCRIBE))
      assert.same({}, answers(fsm, client, 0, { type = "unsubscribe" }))
    end
  end)
end)

describe("a datagram without a message", function()
  it("is not answered", function()
    local fsm, client = served { allow_send = true }
    assert.same({}, answers(fsm, client, 0,
      "", "x", "[]", "{}", '"subscribe"', '{"type":"subscribe"',
      '{"type":"subscribe"}x', '{"type":"rfsm_error"}', '{"type":"none"}',
      '{"type":["subscribe"]}', '{"type":1}',
      '{"type":"subscribe","x":' .. ("["):rep(4000),
      '{"type":"subscribe","x":"' .. ("x"):rep(4096) .. '"}'))
  end)

  local function used() -- KiB; the JIT's traces do not count
    if jit then jit.flush() end
    collectgarbage()
    collectgarbage()
    return collectgarbage("count")
  end

  it(("does no harm, %d of them, SEED=%d"):format(COUNT, SEED), function()
    local fsm, client, server = served { allow_send = true }
    local next_datagram, sizes = datagrams.generator(SEED), {}
    client.udp:settimeout(0)
    for i = 1, COUNT do
      client.udp:send(next_datagram())
      if i % 32 == 0 then
        assert.is_boolean(rfsm.step(fsm))
        assert.is_boolean(rfsm.step(fsm))
        repeat until not client.udp:receive()
      end
      if i % (COUNT / 5) == 0 then sizes[i * 5 / COUNT] = used() end
    end
    rfsm.run(fsm)
    -- After the first fifth buffers have found their size. Lua's table of strings may
    -- double once, so the less of two growths counts.
    assert.is_true(math.min(sizes[3] - sizes[1], sizes[5] - sizes[3]) < 32)
    assert.equal("root.off", leaf(fsm))
    local visitor = new_client(server)
    assert.same({ "model 1", OFF }, answers(fsm, visitor, 2, PUSH, SUBSCRIBE))
    assert.same({ ON }, answers(fsm, visitor, 1))
  end)
end)

describe("a step", function()
  it("reads no more than max_reads datagrams, the rest waits", function()
    local fsm, client = served { allow_send = true, max_reads = 5 }
    for _ = 1, 5 do client:send("x") end
    client:send(PUSH)
    assert.equal("root.off", helper.leaf_after(fsm))
    assert.equal("root.on", helper.leaf_after(fsm))
  end)

  it("takes a datagram of max_received bytes, none that is longer", function()
    local fsm, client = served { allow_send = true, max_received = 64 }
    for length, leaf_then in pairs { -- any order: each stands alone
      [65] = "root.off", [64] = "root.on",
    } do
      local text = dkjson.encode(PUSH)
      client:send(text .. (" "):rep(length - #text))
      assert.equal(leaf_then, helper.leaf_after(fsm))
      rfsm.reset(fsm)
      rfsm.run(fsm)
    end
  end)

  it("reads once and writes nothing while nobody has subscribed", function()
    local reads = 0
    with_fake_socket({
      receivefrom = function()
        reads = reads + 1
        return nil, "timeout"
      end,
      sendto = function() error("sent") end,
    }, function()
      local fsm = served { clock = function() error("asked") end }
      reads = 0
      helper.with(marsh, { actinfo2tab = function() error("encoded") end },
        function() rfsm.step(fsm, 5) end)
      assert.equal(1, reads)
    end)
  end)

  it("waits for a datagram only as long as read_timeout says", function()
    local timeouts = {}
    with_fake_socket({
      settimeout = function(udp, seconds)
        timeouts[#timeouts + 1] = seconds
        return udp:settimeout(0)
      end,
    }, function()
      local fsm = served { read_timeout = 0.5 }
      helper.clear(timeouts)
      rfsm.step(fsm)
      assert.same({ 0.5, 0 }, timeouts)
    end)
  end)

  -- Whether a subscriber survives when the next call of a socket's function fails.
  for case, survives in pairs { -- any order: each is a spec of its own
    ["sendto refused"] = false, ["sendto Network is unreachable"] = false,
    ["sendto timeout"] = true, ["receivefrom refused"] = true,
    ["receivefrom closed"] = true,
  } do
    it("survives a failure: " .. case, function()
      local name, problem = case:match("^(%S+) (.*)")
      local is_broken = false
      with_fake_socket({
        [name] = function(udp, ...)
          if not is_broken then return udp[name](udp, ...) end
          is_broken = false
          return nil, problem
        end,
      }, function()
        local fsm, client = subscribed()
        is_broken = true
        rfsm.step(fsm)
        client:peek()
        assert.same(survives and { OFF } or {},
          answers(fsm, client, survives and 1 or 0))
      end)
    end)
  end

  it("does not fail after a subscriber has closed its socket", function()
    local fsm, client, server = subscribed()
    client.udp:close()
    for _ = 1, 3 do assert.is_boolean(rfsm.step(fsm)) end
    assert.same({ "model 1", OFF }, answers(fsm, new_client(server), 2, SUBSCRIBE))
  end)
end)

describe("install", function()
  it("listens on localhost, port 44044, unless it is told otherwise", function()
    local asked
    with_fake_socket({
      setsockname = function(udp, host, port)
        asked = { host, port }
        return udp:setsockname("127.0.0.1", "0")
      end,
    }, function()
      assert.equal("127.0.0.1", proto.install().host)
      assert.same({ "localhost", "44044" }, asked)
    end)
  end)

  it("concerns machines initialised afterwards", function()
    local before = init(lamp())
    local client = new_client(install())
    client:subscribe()
    rfsm.run(before)
    assert.same({}, client:lines(0))
  end)

  it("blames its caller for a wrong option", function()
    for options, text in pairs { -- any order: each alone
      [{ prot = 1 }] = "unknown option 'prot' (did you mean 'port'?), expected: "
        .. "allow_send, clock, fsm, host, max_datagram, max_events, max_reads, "
        .. "max_received, max_silence, max_subscribers, port, read_timeout",
      [{ port = "44" }] = "port: whole number from 0 to 65535 expected, "
        .. "got string '44'",
      [{ port = 65536 }] = "port: whole number from 0 to 65535 expected, got 65536",
      [{ port = 0.5 }] = "port: whole number from 0 to 65535 expected, got 0.5",
      [{ host = "" }] = "host: name or address expected, got string ''",
      [{ host = 1 }] = "host: name or address expected, got 1",
      [{ read_timeout = -1 }] = "read_timeout: finite number of seconds, not below 0 "
        .. "expected, got -1",
      [{ read_timeout = math.huge }] = "read_timeout: finite number of seconds, not "
        .. "below 0 expected, got inf",
      [{ allow_send = "yes" }] = "allow_send: boolean expected, got string 'yes'",
      [{ clock = 3 }] = "clock: function that returns seconds expected, got 3",
      [{ fsm = lamp() }] = "fsm: initialised fsm expected, got state",
      [{ max_subscribers = 0 }] = "max_subscribers: whole number from 1 on expected, "
        .. "got 0",
      [{ max_datagram = 1e6 }] = "max_datagram: bytes from 1024 to 65507 expected, "
        .. "got 1000000",
      localhost = "table of options expected, got string 'localhost'",
    } do
      assert.equal(text, problem_of(options))
    end
  end)

  -- Least, most, and default of each limit.
  local LIMITS = {
    max_datagram = { least = 1024, most = 65507, default = 65507 },
    max_events = { least = 1, default = 1000 },
    max_reads = { least = 1, default = 64 },
    max_received = { least = 64, most = 65507, default = 4096 },
    max_silence = { least = 0, default = 3 },
    max_subscribers = { least = 1, default = 16 },
    port = { least = 0, most = 65535 },
    read_timeout = { least = 0, default = 0 },
  }

  for name, limit in pairs(LIMITS) do -- any order: each is a spec of its own
    it("takes each value of " .. name .. " that it names, and no other", function()
      assert.equal(limit.default, name ~= "port" and install()[name] or nil)
      for _, value in ipairs(name == "port" and {} or { limit.least, limit.most }) do
        assert.equal(value, install { [name] = value }[name])
      end
      local above = limit.most and limit.most + 1
      for _, value in ipairs { limit.least - 1, above } do
        local problem = problem_of { [name] = value }
        assert.equal(name .. ": ", problem:sub(1, #name + 2))
        assert.matches(("got %d$"):format(value):gsub("%-", "%%-"), problem)
      end
    end)
  end

  it("takes each port", function()
    for _, port in ipairs { 0, 65535 } do -- the last one may be in use
      assert.not_matches("^port: ", problem_of { port = port })
    end
  end)

  it("sets its global, under the name of the original", function()
    assert.equal(proto, rawget(_G, "rfsm_proto"))
  end)

  it("says when the port is in use, or when there is no such host", function()
    local port = install().port
    assert.equal(("cannot listen on localhost, port %d: address already in use")
      :format(port), problem_of { port = port })
    assert.matches("^cannot listen on x*, port 44044: %S",
      problem_of { host = ("x"):rep(64) })
  end)

  for name, text in pairs { -- any order: each is a spec of its own
    socket = "luasocket is missing (on Debian: apt-get install lua-socket)",
    dkjson = "dkjson is missing (on Debian: apt-get install lua-dkjson)",
  } do
    it("says what to install without " .. name, function()
      helper.with(package.loaded, { [name] = false }, function()
        local preload = { [name] = function() error("not there", 0) end }
        helper.with(package.preload, preload, function()
          assert.equal("the package " .. text, problem_of { port = 0 })
          assert.same({ nil, "the package " .. text },
            { require("rfsm.observe.subscriber").connect("localhost", 1) })
        end)
      end)
    end)
  end
end)

describe("a client", function()
  local subscriber = require "rfsm.observe.subscriber"

  -- Returns a client, its clock, what it has sent, and what it is to receive.
  local function connected(has_path)
    local client = assert(subscriber.connect("127.0.0.1", 9, has_path))
    clients[#clients + 1] = client
    local at, sent, coming = { now = 0 }, {}, {}
    client.clock = function() return at.now end
    client.udp:close()
    client.udp = { close = function() end, settimeout = function() end,
      send = function(_, text) sent[#sent + 1] = text end,
      receive = function()
        local text = table.remove(coming, 1)
        if text then return text end
        return nil, "timeout"
      end }
    return client, at, sent, coming
  end

  it("subscribes until it is heard, then sends a heartbeat a second", function()
    local client, at, sent, coming = connected(true)
    for _, seconds in ipairs { 0, 0.5, 1, 1.5, 2 } do
      at.now = seconds
      assert.is_nil(client:receive(0))
    end
    assert.equal(3, #sent)
    assert.same({ type = "subscribe", path = true }, dkjson.decode(sent[1]))
    assert.is_false(client.is_heard)
    coming[1] = '{"type":"rfsm_error","text":"something"}'
    assert.equal("something", client:receive(0).text)
    assert.is_true(client.is_heard)
    at.now = 3
    client:receive(0)
    assert.same({ type = "heartbeat" }, dkjson.decode(sent[4]))
    coming[1] = '{"type":"rfsm_error","text":"heartbeat: not subscribed"}'
    client:receive(0)
    assert.is_false(client.is_heard)
    client:receive(0) -- at once
    assert.equal("subscribe", dkjson.decode(sent[5]).type)
    coming[1] = "[1]x"
    assert.is_table(client:receive(0))
    coming[1] = "x"
    assert.is_nil(client:receive(0))
    assert.equal("127.0.0.1:9", client.address)
  end)

  it("is not heard once its messages are refused", function()
    local client, _, _, coming = connected()
    coming[1] = '{"type":"rfsm_error"}'
    client:receive(0)
    client.udp.receive = function() return nil, "connection refused" end
    client:receive(0)
    assert.is_false(client.is_heard)
  end)

  it("handles the messages about its machine, and reports what it cannot", function()
    local seen = {}
    local function handle(message)
      return subscriber.handle({ known = function(target, got)
        seen[#seen + 1] = { target.number, got.text:upper() }
      end }, { number = 2 }, message)
    end
    assert.is_nil(handle { type = "known", fsm = 2, text = "a" })
    assert.is_nil(handle { type = "known", text = "b" })
    assert.is_nil(handle { type = "known", fsm = 1, text = "c" })
    assert.is_nil(handle { type = "unknown", fsm = 2 })
    assert.equal("unreadable message 'known'", handle { type = "known", fsm = 2 })
    assert.same({ { 2, "A" }, { 2, "B" } }, seen)
  end)

  it("names the host that it does not find", function()
    local client, problem = subscriber.connect("no host", 1)
    assert.is_nil(client)
    assert.matches("^no host: ", problem)
  end)
end)

describe("uninstall", function()
  it("frees the port, and machines go on without", function()
    local fsm, client, server = subscribed()
    proto.uninstall()
    assert.is_true(helper.post_and_run(fsm, "e_push"))
    assert.same({}, client:lines(0))
    assert.equal(server.port, install { port = server.port }.port)
  end)

  it("may come in the middle of a step", function()
    local model = lamp()
    model.on.entry = function() proto.uninstall() end
    local client = new_client(install { allow_send = true })
    local fsm = init(model)
    client:send(PUSH)
    client:subscribe()
    assert.equal("root.on", helper.leaf_after(fsm))
    rfsm.reset(fsm)
    assert.is_true(rfsm.run(fsm))
  end)

  it("leaves no hook in a machine that goes on, after its next step", function()
    local fsm = init(lamp())
    local server = install { fsm = fsm }
    local client = new_client(server)
    client:send { type = "subscribe", path = true }
    rfsm.run(fsm)
    assert.is_table(fsm._path_hooks)
    server:close()
    rfsm.step(fsm)
    local counts = {}
    for i, field in ipairs { "_pre_hooks", "_post_hooks", "_path_hooks",
      "_reset_hooks" } do
      counts[i] = #(fsm[field] or {}) - #(init(lamp())[field] or {})
    end
    assert.same({ 0, 0, 0, 0 }, counts)
    assert.is_nil(fsm._watch_hooks.merged)
  end)

  it("is not needed to close one port", function()
    local one, other = install(), install()
    local fsm = init(lamp())
    one:close()
    one:close()
    assert.same({ "model 1", OFF }, answers(fsm, new_client(other), 2, SUBSCRIBE))
  end)
end)

it("has an example that runs unattended", function()
  local lines = helper.printed(function() dofile("examples/hosts/proto_host.lua") end)
  assert.same({
    "graph: off, on", "active: root.off", "sends e_push", "active: root.on",
    "sends e_push", "active: root.off",
  }, lines)
end)

it("shows a client what the machine did, iteration by iteration", function()
  assert.is_nil(share.problem(require "spec.support.claims.proto", 10))
  require("rfsm.clock").set_hook(nil)
end)
