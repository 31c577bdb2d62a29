-- Introspection over UDP, over real sockets on loopback. Ports are the system's choice,
-- so that several runs of the specs do not meet. SEED comes from the environment.

local datagrams = require "spec.support.datagrams"
local dkjson = require "dkjson"
local helper = require "spec.helper"
local marsh = require "rfsm.marsh"
local proto = require "rfsm.proto"
local rfsm = require "rfsm"
local socket = require "socket"

local state, trans = rfsm.state, rfsm.trans

local jit = rawget(_G, "jit")

local SEED = tonumber(os.getenv("SEED")) or 1
local COUNT = 100000

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
    local what = message.text or message.graph and message.fsm or message.part
    if what == nil then what = message.act_leaf end
    lines[i] = message.type:gsub("^rfsm_", "") .. " " .. tostring(what)
  end
  assert.is_nil(self:peek())
  return lines
end

function Client:subscribe(fsm) self:send { type = "subscribe", fsm = fsm } end

-- A lamp that answers at a port, and has been entered.
local function served(options)
  local server = install(options)
  local fsm = helper.init(lamp())
  rfsm.run(fsm)
  return fsm, server
end

-- The same with one who has subscribed and read what that brings.
local function subscribed(options)
  local fsm, server = served(options)
  local client = new_client(server)
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
  package.loaded.socket = setmetatable({ udp4 = udp4 }, { __index = socket })
  local ok, problem = pcall(f)
  package.loaded.socket = socket
  if not ok then error(problem, 0) end
end

local function problem_of(options)
  local ok, problem = pcall(proto.install, options)
  assert.is_false(ok)
  return problem
end

describe("rfsm.proto", function()
  before_each(function() now = 1000 end)

  after_each(function()
    for i = #clients, 1, -1 do
      clients[i].udp:close()
      clients[i] = nil
    end
    proto.uninstall()
  end)

  describe("a subscription", function()
    it("brings the graph, then what is active after each iteration", function()
      local fsm, server = served { allow_send = true }
      local client = new_client(server)
      client:subscribe()
      rfsm.send_events(fsm, "e_push")
      rfsm.run(fsm)
      assert.same({ "model 1", "active_state root.on", "active_state root.on",
        "active_state root.on" }, client:lines(4))
    end)

    it("brings the graph that rfsm.marsh knows", function()
      local fsm, server = served()
      local client = new_client(server)
      client:subscribe()
      rfsm.step(fsm)
      local model = client:read()
      assert.same(marsh.model2tab(fsm), model.graph)
      model.graph = nil
      assert.same({ type = "rfsm_model", version = 2, fsm = 1, cnt = 3 }, model)
    end)

    it("writes messages in a fixed order of fields", function()
      local fsm, client = subscribed()
      rfsm.step(fsm)
      assert.equal('{"type":"rfsm_active_state","version":2,"fsm":1,"cnt":5,'
        .. '"act_leaf":"root.off","act_leaf_state":"done","path":false}', client:peek())
    end)

    it("is served before the machine has been entered", function()
      local server = install()
      local fsm = helper.init(lamp())
      local client = new_client(server)
      client:subscribe()
      rfsm.step(fsm)
      assert.same({ "model 1", "active_state root.off" }, client:lines(2))
    end)

    it("is served by a machine that cannot be entered", function()
      local server, model = install(), lamp()
      model[1].guard = function() return false end
      model.err = false
      local fsm = helper.init(model)
      local client = new_client(server)
      client:subscribe()
      assert.is_false(rfsm.step(fsm))
      assert.same({ "model 1" }, client:lines(1))
    end)

    it("that is repeated brings the graph again, and one copy of all", function()
      local fsm, client = subscribed()
      client:subscribe()
      client:subscribe()
      rfsm.step(fsm)
      assert.same({ "model 1", "active_state root.off" }, client:lines(2))
    end)

    it("ends with unsubscribe", function()
      local fsm, client = subscribed()
      client:send { type = "unsubscribe" }
      rfsm.step(fsm)
      assert.same({}, client:lines(0))
    end)

    it("numbers the messages, so that a lost one shows", function()
      local fsm, client = subscribed()
      local counts = {}
      for i = 1, 3 do
        rfsm.step(fsm)
        counts[i] = client:read().cnt
      end
      assert.same({ 5, 6, 7 }, counts)
    end)

    it("tells the mode of the leaf", function()
      local server = install()
      local fsm = helper.init(state { warn = false,
        doo = function() rfsm.yield(true) end })
      local client = new_client(server)
      client:subscribe()
      rfsm.step(fsm, 3)
      rfsm.step(fsm)
      client:read()
      local modes = {}
      for i = 1, 3 do modes[i] = client:read().act_leaf_state end
      assert.same({ "active", "active", "done" }, modes)
    end)

    it("is refused when there are too many", function()
      local fsm, client, server = subscribed { max_subscribers = 1 }
      local late = new_client(server)
      late:subscribe()
      client:subscribe()
      rfsm.step(fsm)
      assert.same({ "error subscribe: there are 1 subscribers already" }, late:lines(1))
      assert.same({ "model 1", "active_state root.off" }, client:lines(2))
    end)

    it("goes on after reset, which it tells", function()
      local fsm, client = subscribed()
      rfsm.reset(fsm)
      assert.same({ "active_state false" }, client:lines(1))
      rfsm.send_events(fsm, "e_push")
      rfsm.step(fsm)
      assert.same({ "active_state root.off" }, client:lines(1))
    end)

    it("brings the new graph after fsm_merge", function()
      local fsm, client = subscribed()
      assert(rfsm.fsm_merge(fsm, fsm, state {}, "dim"))
      rfsm.step(fsm)
      assert.same(marsh.model2tab(fsm), client:read().graph)
      assert.same({ "active_state root.off" }, client:lines(1))
    end)

    it("of two brings both the same", function()
      local fsm, server = served()
      local first, second = new_client(server), new_client(server)
      first:subscribe()
      rfsm.step(fsm)
      second:subscribe()
      rfsm.step(fsm)
      assert.same({ "model 1", "active_state root.off", "active_state root.off" },
        first:lines(3))
      assert.same({ "model 1", "active_state root.off" }, second:lines(2))
    end)
  end)

  describe("a heartbeat", function()
    it("keeps a subscription, without it that ends after 3 s", function()
      local fsm, client, server = subscribed()
      local dead = new_client(server)
      dead:subscribe()
      rfsm.step(fsm)
      client:lines(1)
      dead:lines(2)

      now = now + 3
      client:send { type = "heartbeat" }
      rfsm.step(fsm)
      assert.same({ "active_state root.off" }, client:lines(1))
      assert.same({ "active_state root.off" }, dead:lines(1))

      now = now + 0.001
      rfsm.step(fsm)
      assert.same({ "active_state root.off" }, client:lines(1))
      assert.same({}, dead:lines(0))
    end)

    it("that waited while nothing ran counts when it is read", function()
      local fsm, client = subscribed()
      client:send { type = "heartbeat" }
      now = now + 100
      rfsm.step(fsm)
      assert.same({ "active_state root.off" }, client:lines(1))
    end)

    it("of somebody who is not subscribed says so", function()
      local fsm, client = subscribed()
      now = now + 4
      rfsm.step(fsm)
      client:send { type = "heartbeat" }
      rfsm.step(fsm)
      assert.same({ "error heartbeat: not subscribed" }, client:lines(1))
    end)

    it("is not missed when the clock jumps back", function()
      local fsm, client = subscribed()
      now = now - 500
      rfsm.step(fsm)
      now = now + 3
      rfsm.step(fsm)
      assert.same({ "active_state root.off", "active_state root.off" }, client:lines(2))
      now = now + 1
      rfsm.step(fsm)
      assert.same({}, client:lines(0))
    end)

    it("is not missed while more waits than a step reads", function()
      local fsm, client, server = subscribed()
      local flood = new_client(server)
      for _ = 1, 64 do flood:send("x") end
      client:send { type = "heartbeat" }
      now = now + 4
      rfsm.step(fsm)
      rfsm.step(fsm)
      assert.same({ "active_state root.off", "active_state root.off" }, client:lines(2))
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
        local complaints = {}
        fsm.err = function(...) complaints[#complaints + 1] = table.concat({ ... }) end
        now = now + 10
        rfsm.step(fsm)
        assert.same({ "active_state root.off" }, client:lines(1))
        assert.matches("^PROTOthe clock failed: ", complaints[1])
      end)
    end
  end)

  describe("an event", function()
    it("goes to the machine, and the same call acts on it", function()
      local fsm, client = subscribed { allow_send = true }
      client:send { type = "event", event = "e_push" }
      assert.is_true(rfsm.run(fsm))
      assert.equal("root.on", rfsm.get_actleaf_fqn(fsm))
    end)

    it("keeps the machine from being idle", function()
      local fsm, client = subscribed { allow_send = true }
      client:send { type = "event", event = "e_push" }
      assert.is_false(rfsm.step(fsm))
      rfsm.step(fsm)
      assert.equal("root.on", rfsm.get_actleaf_fqn(fsm))
    end)

    it("can be a number or a boolean, and needs no subscription", function()
      local model = lamp()
      model[2].events, model[3].events = { 7 }, { false }
      local server = install { allow_send = true }
      local fsm = helper.init(model)
      rfsm.run(fsm)
      local client = new_client(server)
      client:send { type = "event", event = 7 }
      rfsm.run(fsm)
      assert.equal("root.on", rfsm.get_actleaf_fqn(fsm))
      client:send { type = "event", event = false }
      rfsm.run(fsm)
      assert.equal("root.off", rfsm.get_actleaf_fqn(fsm))
    end)

    it("is traced as one that was sent", function()
      local fsm, client = subscribed { allow_send = true }
      local raised = {}
      fsm.dbg = function(id, event)
        if id == "RAISED" then raised[#raised + 1] = event end
      end
      client:send { type = "event", event = "e_x" }
      rfsm.run(fsm)
      assert.same({ "e_x" }, raised)
    end)

    it("is not taken without allow_send", function()
      local fsm, client = subscribed()
      client:send { type = "event", event = "e_push" }
      rfsm.run(fsm)
      assert.equal("root.off", rfsm.get_actleaf_fqn(fsm))
      assert.same({ "error event: not taken, allow_send is off",
        "active_state root.off" }, client:lines(2))
    end)

    it("of another type is refused", function()
      local fsm, client = subscribed { allow_send = true }
      local wanted = "error event: string, boolean or finite number expected, got "
      for _, text in ipairs { '{}', '[1]', '1e999', 'null' } do
        client:send('{"type":"event","event":' .. text .. '}')
      end
      rfsm.step(fsm)
      assert.same({ wanted .. "table", wanted .. "table", wanted .. "inf",
        wanted .. "nil", "active_state root.off" }, client:lines(5))
    end)

    it("for a machine that is not advanced waits, but not without end", function()
      local server = install { allow_send = true }
      local busy, lazy = helper.init(lamp()), helper.init(lamp())
      rfsm.run(busy)
      rfsm.run(lazy)
      local client = new_client(server)
      for _ = 1, 20 do
        for _ = 1, 51 do client:send { type = "event", event = "e_x", fsm = 2 } end
        rfsm.step(busy)
      end
      assert.same({ "error event: 1000 events wait already" }, { client:lines(20)[20] })
      local count = 0
      rfsm.pre_step_hook_add(lazy, function(_, events) count = count + #events end)
      rfsm.run(lazy)
      assert.equal(1000, count)
    end)

    it("that waits is gone after reset", function()
      local server = install { allow_send = true }
      local first, second = helper.init(lamp()), helper.init(lamp())
      rfsm.run(first)
      rfsm.run(second)
      new_client(server):send { type = "event", event = "e_push", fsm = 2 }
      rfsm.step(first)
      rfsm.reset(second)
      rfsm.run(second)
      assert.equal("root.off", rfsm.get_actleaf_fqn(second))
    end)
  end)

  describe("several machines at a port", function()
    local function two()
      local server = install { allow_send = true }
      local first, second = helper.init(lamp()), helper.init(lamp())
      rfsm.run(first)
      rfsm.run(second)
      return first, second, server
    end

    it("are numbered in the order of their first steps", function()
      local first, second, server = two()
      local client = new_client(server)
      client:subscribe()
      rfsm.step(second)
      rfsm.step(first)
      local numbers = {}
      for i = 1, 4 do numbers[i] = client:read().fsm end
      assert.same({ 2, 2, 1, 1 }, numbers)
    end)

    it("are all told of unless a subscription names one", function()
      local first, second, server = two()
      local client = new_client(server)
      client:subscribe(2)
      rfsm.step(first)
      rfsm.step(second)
      assert.same({ "model 2", "active_state root.off" }, client:lines(2))
    end)

    it("are told of when they come later", function()
      local fsm, client = subscribed()
      local late = helper.init(lamp())
      rfsm.step(late)
      rfsm.step(fsm)
      assert.same({ "model 2", "active_state root.off", "active_state root.off" },
        client:lines(3))
    end)

    it("get the events that name them, the first those that name none", function()
      local first, second, server = two()
      local client = new_client(server)
      client:send { type = "event", event = "e_push", fsm = 2 }
      rfsm.run(first)
      rfsm.run(second)
      assert.equal("root.off", rfsm.get_actleaf_fqn(first))
      assert.equal("root.on", rfsm.get_actleaf_fqn(second))
      client:send { type = "event", event = "e_push" }
      rfsm.run(second)
      rfsm.run(first)
      assert.equal("root.on", rfsm.get_actleaf_fqn(first))
      assert.equal("root.on", rfsm.get_actleaf_fqn(second))
    end)

    it("refuse a number that none of them has", function()
      local first, _, server = two()
      local client = new_client(server)
      client:subscribe(3)
      client:send '{"type":"event","event":"e_push","fsm":"1"}'
      rfsm.step(first)
      assert.same({ "error subscribe: fsm: number of a machine expected, got 3",
        "error event: fsm: number of a machine expected, got string" }, client:lines(2))
    end)

    it("are not kept alive", function()
      local server = install()
      local kept = setmetatable({ helper.init(lamp()) }, { __mode = "v" })
      local client = new_client(server)
      client:subscribe()
      rfsm.run(kept[1])
      collectgarbage()
      collectgarbage()
      assert.is_nil(kept[1])
    end)

    it("in a sequential AND state have numbers, too", function()
      local server = install()
      local fsm = helper.init(state { warn = false, info = false,
        both = rfsm.seqand { idle_doo = "auto", left = lamp(), right = lamp() },
        trans { src = "initial", tgt = "both" } })
      local client = new_client(server)
      client:subscribe()
      rfsm.step(fsm)
      assert.same({ "model 1", "model 2", "active_state root.off", "model 3",
        "active_state root.off", "active_state root.both" }, client:lines(6))
    end)

    it("can have ports of their own", function()
      local first, second = helper.init(lamp()), helper.init(lamp())
      local one, other = install { fsm = first }, install { fsm = second }
      local client, watcher = new_client(one), new_client(other)
      client:subscribe()
      watcher:subscribe()
      rfsm.step(first)
      rfsm.step(second)
      assert.same({ "model 1", "active_state root.off" }, client:lines(2))
      assert.same({ "model 1", "active_state root.off" }, watcher:lines(2))
      assert.is_nil(helper.init(lamp())._proto)
    end)

    it("can each answer at two ports", function()
      local one, other = install(), install()
      local fsm = helper.init(lamp())
      local client, watcher = new_client(one), new_client(other)
      client:subscribe()
      watcher:subscribe()
      rfsm.step(fsm)
      assert.same(client:lines(2), watcher:lines(2))
    end)
  end)

  describe("a graph that is longer than a datagram", function()
    local function chain(n)
      local model = state { warn = false, info = false,
        trans { src = "initial", tgt = "s1" } }
      for i = 1, n do
        model["s" .. i] = state {}
        model[i + 1] = trans { src = "s" .. i, tgt = "s" .. i % n + 1,
          events = { '"e\\' .. i .. "\195\164" } }
      end
      return model
    end

    local function join(client, fsm, first)
      local texts = { first.data }
      for part = 2, first.parts do
        client:send { type = "model", part = part }
        client:send { type = "heartbeat" }
        rfsm.step(fsm)
        local message = client:read()
        assert.equal(part, message.part)
        assert.equal(first.revision, message.revision)
        texts[part] = message.data
        client:read()
      end
      return (assert(dkjson.decode(table.concat(texts), 1, nil, nil, nil)))
    end

    local function fetch(model, options)
      local server = install(options)
      local fsm = helper.init(model)
      rfsm.run(fsm)
      local client = new_client(server)
      client:subscribe()
      rfsm.step(fsm)
      local first = client:read()
      client:read()
      return fsm, client, first
    end

    it("comes in parts that are asked for", function()
      local fsm, client, first = fetch(chain(10000))
      assert.equal("rfsm_model_part", first.type)
      local graph = join(client, fsm, first)
      assert.equal(10000, #graph.transitions - 1)
      assert.same(marsh.model2tab(fsm), graph)
    end)

    it("comes in smaller parts where datagrams are smaller", function()
      local fsm, client, first = fetch(chain(20), { max_datagram = 1024 })
      assert.same(marsh.model2tab(fsm), join(client, fsm, first))
    end)

    it("comes in parts that are UTF-8 each", function()
      local fsm, client, first = fetch(chain(200), { max_datagram = 1024 })
      for part = 1, first.parts do
        client:send { type = "model", part = part }
        rfsm.step(fsm)
        local data = client:read().data
        assert.is_nil(data:find("^[\128-\191]"))
        assert.is_nil(data:find("[\192-\255]$"))
        client:read()
      end
    end)

    it("comes one part per iteration, however many are asked for", function()
      local fsm, client, first = fetch(chain(2000))
      for part = 2, first.parts do client:send { type = "model", part = part } end
      for part = 2, first.parts do
        rfsm.step(fsm)
        assert.equal(part, client:read().part)
        assert.equal("rfsm_active_state", client:read().type)
      end
    end)

    it("has no more parts than it says", function()
      local fsm, client, first = fetch(chain(20), { max_datagram = 1024 })
      client:send { type = "model", part = first.parts + 1 }
      client:send { type = "model", part = "1" }
      rfsm.step(fsm)
      local text = ("error model: part from 1 to %d expected, got "):format(first.parts)
      assert.same({ text .. first.parts + 1, text .. "string", "active_state root.s1" },
        client:lines(3))
    end)

    it("has another revision after fsm_merge, and starts anew", function()
      local fsm, client = fetch(chain(20), { max_datagram = 1024 })
      assert(rfsm.fsm_merge(fsm, fsm, state {}, "more"))
      rfsm.step(fsm)
      local first = client:read()
      client:read()
      assert.same({ 2, 1 }, { first.revision, first.part })
      assert.same(marsh.model2tab(fsm), join(client, fsm, first))
    end)

    it("is sent only to subscribers", function()
      local fsm, server = served()
      local client = new_client(server)
      client:send { type = "model" }
      rfsm.step(fsm)
      assert.same({ "error model: not subscribed" }, client:lines(1))
    end)

    it("of a name that is too long makes an error, not a failure", function()
      local model = state { warn = false, info = false, [("x"):rep(2000)] = state {},
        trans { src = "initial", tgt = ("x"):rep(2000) } }
      local server = install { max_datagram = 1024 }
      local fsm = helper.init(model)
      local client = new_client(server)
      client:subscribe()
      rfsm.step(fsm)
      client:read()
      assert.same({ "error rfsm_active_state: too long for a datagram" },
        client:lines(1))
    end)

    it("of a machine that cannot be written makes an error, not a failure", function()
      local real = marsh.jsontab
      marsh.jsontab = function() error("stack overflow", 0) end
      local fsm, server = served()
      local client = new_client(server)
      client:subscribe()
      local ok, problem = pcall(rfsm.step, fsm)
      marsh.jsontab = real
      assert.is_true(ok, problem)
      assert.same({ "error model: the graph cannot be written: stack overflow",
        "active_state root.off" }, client:lines(2))
    end)
  end)

  describe("a datagram that is no message", function()
    it("is not answered", function()
      local fsm, server = served { allow_send = true }
      local client = new_client(server)
      for _, text in ipairs {
        "", "x", "[]", "{}", '"subscribe"', '{"type":"subscribe"',
        '{"type":"subscribe"}x', '{"type":"rfsm_error"}', '{"type":"none"}',
        '{"type":["subscribe"]}', '{"type":1}',
        '{"type":"subscribe","x":[[[[[[[[]]]]]]]]}',
        '{"type":"subscribe","x":[' .. ("1,"):rep(64) .. '1]}',
        '{"type":"subscribe","x":"' .. ("x"):rep(4096) .. '"}',
      } do client:send(text) end
      rfsm.step(fsm)
      rfsm.step(fsm)
      assert.same({}, client:lines(0))
    end)

    it("is told from one with brackets and commas in a string", function()
      local fsm, server = served()
      local client = new_client(server)
      client:send('{"type":"subscribe","x":"\\"' .. ("[,"):rep(100) .. '","y":[[1],2]}')
      rfsm.step(fsm)
      assert.same({ "model 1", "active_state root.off" }, client:lines(2))
    end)

    local function used() -- KiB; the JIT's traces do not count
      if jit then jit.flush() end
      collectgarbage()
      collectgarbage()
      return collectgarbage("count")
    end

    -- Feeds random datagrams to a lamp, no more at a time than it reads in two steps.
    -- `put` is called with each, `sweep` after the steps. Returns the KiB by which
    -- memory has grown since the first fifth, in which buffers find their size.
    local function feed(fsm, count, put, sweep)
      local next_datagram, before = datagrams.generator(SEED), nil
      for i = 1, count do
        put(next_datagram())
        if i % 32 == 0 then
          assert.is_boolean(rfsm.step(fsm))
          assert.is_boolean(rfsm.step(fsm))
          sweep()
        end
        if i == count / 5 then before = used() end
      end
      rfsm.run(fsm)
      return used() - before
    end

    it(("does no harm, %d of them through a socket, SEED=%d"):format(COUNT, SEED),
      function()
        local fsm, server = served { allow_send = true }
        local client = new_client(server)
        client.udp:settimeout(0)
        local grown = feed(fsm, COUNT, function(text) client.udp:send(text) end,
          function() repeat until not client.udp:receive() end)
        assert.is_true(grown < 64, grown .. " KiB")
        assert.equal("root.off", rfsm.get_actleaf_fqn(fsm))

        local visitor = new_client(server)
        visitor:send { type = "event", event = "e_push" }
        visitor:subscribe()
        rfsm.step(fsm)
        assert.same({ "model 1", "active_state root.off" }, visitor:lines(2))
        rfsm.step(fsm)
        assert.same({ "active_state root.on" }, visitor:lines(1))
      end)

    -- Senders come and go, and most of them cannot be reached.
    it(("does no harm, %d from as many senders, SEED=%d"):format(COUNT / 4, SEED),
      function()
        local waiting, first, port = {}, 1, 0
        local function receivefrom()
          local text = waiting[first]
          if not text then return nil, "timeout" end
          first, port = first + 1, port + 1
          return text:sub(1, 4097), "127.0.0.1", port
        end
        local function sendto(_, _, _, to)
          if to % 3 == 0 then return nil, "refused" end
          if to % 3 == 1 then return nil, "timeout" end
          return 1
        end
        local function sweep()
          assert.is_true(first > #waiting)
          helper.clear(waiting)
          first, now = 1, now + 1
        end
        with_fake_socket({ receivefrom = receivefrom, sendto = sendto }, function()
          local fsm, server = served { allow_send = true }
          local grown = feed(fsm, COUNT / 4, function(text)
            waiting[#waiting + 1] = text
          end, function()
            sweep()
            assert.is_true(#server.subscribers <= 16)
          end)
          assert.is_true(grown < 64, grown .. " KiB")
          assert.equal("root.off", rfsm.get_actleaf_fqn(fsm))
        end)
      end)
  end)

  describe("a step", function()
    it("reads no more than 64 datagrams, the rest waits", function()
      local fsm, server = served { allow_send = true }
      local client = new_client(server)
      for _ = 1, 64 do client:send("x") end
      client:send { type = "event", event = "e_push" }
      rfsm.run(fsm)
      assert.equal("root.off", rfsm.get_actleaf_fqn(fsm))
      rfsm.run(fsm)
      assert.equal("root.on", rfsm.get_actleaf_fqn(fsm))
    end)

    it("reads no more than 32 KiB, the rest waits", function()
      local fsm, server = served { allow_send = true }
      local client = new_client(server)
      for _ = 1, 8 do client:send(("x"):rep(4096)) end
      client:send { type = "event", event = "e_push" }
      rfsm.run(fsm)
      assert.equal("root.off", rfsm.get_actleaf_fqn(fsm))
      rfsm.run(fsm)
      assert.equal("root.on", rfsm.get_actleaf_fqn(fsm))
    end)

    it("reads once and writes nothing while nobody has subscribed", function()
      local reads, real = 0, marsh.actinfo2tab
      with_fake_socket({
        receivefrom = function()
          reads = reads + 1
          return nil, "timeout"
        end,
        sendto = function() error("sent") end,
      }, function()
        local fsm = served { clock = function() error("asked") end }
        reads = 0
        marsh.actinfo2tab = function() error("encoded") end
        local ok, problem = pcall(rfsm.step, fsm, 5)
        marsh.actinfo2tab = real
        assert.is_true(ok, problem)
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

    for _, problem in ipairs { "refused", "closed", "Network is unreachable" } do
      it("drops a subscriber that cannot be reached: " .. problem, function()
        local is_broken = false
        with_fake_socket({
          sendto = function(udp, ...)
            if is_broken then return nil, problem end
            return udp:sendto(...)
          end,
        }, function()
          local fsm, client = subscribed()
          is_broken = true
          rfsm.step(fsm)
          is_broken = false
          rfsm.step(fsm)
          assert.same({}, client:lines(0))
        end)
      end)

      it("goes on after an error of receiving: " .. problem, function()
        local is_broken = false
        with_fake_socket({
          receivefrom = function(udp, ...)
            if is_broken then
              is_broken = false
              return nil, problem
            end
            return udp:receivefrom(...)
          end,
        }, function()
          local fsm, client = subscribed()
          client:send { type = "unsubscribe" }
          is_broken = true
          rfsm.step(fsm)
          rfsm.step(fsm)
          client:peek()
          assert.same({}, client:lines(0))
        end)
      end)
    end

    it("keeps a subscriber when the socket's buffer is full", function()
      local is_full = false
      with_fake_socket({
        sendto = function(udp, ...)
          if is_full then return nil, "timeout" end
          return udp:sendto(...)
        end,
      }, function()
        local fsm, client = subscribed()
        is_full = true
        rfsm.step(fsm)
        is_full = false
        rfsm.step(fsm)
        assert.equal(6, client:read().cnt)
      end)
    end)

    it("does not fail after a subscriber has closed its socket", function()
      local fsm, client, server = subscribed()
      client.udp:close()
      for _ = 1, 3 do assert.is_boolean(rfsm.step(fsm)) end
      local other = new_client(server)
      other:subscribe()
      rfsm.step(fsm)
      assert.same({ "model 1", "active_state root.off" }, other:lines(2))
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
      local before = helper.init(lamp())
      local server = install()
      local client = new_client(server)
      client:subscribe()
      rfsm.run(before)
      assert.same({}, client:lines(0))
      assert.is_nil(before._proto)
    end)

    it("blames its caller for a wrong option", function()
      for options, text in pairs { -- any order: each alone
        [{ prot = 1 }] = "unknown option 'prot', expected: allow_send, clock, fsm, "
          .. "host, max_datagram, max_subscribers, port, read_timeout",
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
        [{ fsm = lamp() }] = "fsm: initialised fsm expected, got table",
        [{ max_subscribers = 0 }] = "max_subscribers: whole number from 1 on expected, "
          .. "got 0",
        [{ max_datagram = 1e6 }] = "max_datagram: bytes from 1024 to 65507 expected, "
          .. "got 1000000",
      } do
        local problem = problem_of(options)
        assert.equal("rfsm.proto.install: " .. text, (problem:gsub("^%S+:%d+: ", "")))
      end
      local _, problem = pcall(function() proto.install("localhost") end)
      assert.matches("^[^:]*proto_spec.lua:%d+: rfsm.proto.install: table of options "
        .. "expected, got string 'localhost'$", problem)
    end)

    it("says when the port is in use", function()
      local server = install()
      assert.equal(("rfsm.proto.install: cannot listen on localhost, port %d: address "
        .. "already in use"):format(server.port), problem_of { port = server.port })
    end)

    it("says when there is no such host", function()
      assert.matches("^rfsm.proto.install: cannot listen on x*, port 44044: %S",
        problem_of { host = ("x"):rep(64) })
    end)

    for package_name, text in pairs { -- any order: each is a spec of its own
      socket = "luasocket is missing (on Debian: apt-get install lua-socket)",
      dkjson = "dkjson is missing (on Debian: apt-get install lua-dkjson)",
    } do
      it("says what to install without " .. package_name, function()
        local real = package.loaded[package_name]
        package.loaded[package_name] = nil
        package.preload[package_name] = function() error("not there", 0) end
        local problem = problem_of { port = 0 }
        package.preload[package_name], package.loaded[package_name] = nil, real
        assert.equal("rfsm.proto.install: the package " .. text, problem)
      end)
    end
  end)

  describe("uninstall", function()
    it("frees the port, and machines go on without", function()
      local fsm, client, server = subscribed()
      local port = server.port
      proto.uninstall()
      rfsm.send_events(fsm, "e_push")
      assert.is_true(rfsm.run(fsm))
      assert.is_nil(fsm._proto)
      assert.same({}, client:lines(0))
      assert.equal(port, install { port = port }.port)
    end)

    it("may come in the middle of a step", function()
      local model = lamp()
      model.on.entry = function() proto.uninstall() end
      local server = install { allow_send = true }
      local fsm = helper.init(model)
      local client = new_client(server)
      client:send { type = "event", event = "e_push" }
      client:subscribe()
      rfsm.run(fsm)
      assert.equal("root.on", rfsm.get_actleaf_fqn(fsm))
      rfsm.reset(fsm)
      assert.is_true(rfsm.run(fsm))
    end)

    it("is not needed to close one port", function()
      local one, other = install(), install()
      local fsm = helper.init(lamp())
      one:close()
      one:close()
      local client = new_client(other)
      client:subscribe()
      rfsm.step(fsm)
      assert.same({ "model 1", "active_state root.off" }, client:lines(2))
      assert.equal(1, #helper.init(lamp())._proto)
    end)
  end)

  it("has an example that runs unattended", function()
    local lines = helper.printed(function() dofile("examples/hosts/proto_host.lua") end)
    assert.same({
      "graph: off, on", "active: root.off", "sends e_push", "active: root.on",
      "sends e_push", "active: root.off",
    }, lines)
  end)
end)
