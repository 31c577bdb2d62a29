--- Introspection over UDP: other programs watch machines, and may send them events.
--
-- `install` opens a port. Each machine initialised afterwards answers there, in JSON,
-- one datagram for each message. A subscriber receives the graph of the machine and,
-- after each iteration, its active leaf. Each machine of a port has a number.
--
-- The port is read when a machine is advanced; nothing runs in between. No datagram
-- makes a step fail or wait, and the cost of a step is limited. Needs the packages
-- luasocket and dkjson.
--
-- The file reads in this order: options, sending, messages, receiving, the hooks of a
-- machine, public functions.
--
-- @module rfsm.proto
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local marsh = require "rfsm.marsh"
local encoding = require "rfsm.snapshot.encoding"
local opts = require "rfsm.shared.options"
local instrument = require "rfsm.shared.instrument"

local error, ipairs, pairs, pcall = error, ipairs, pairs, pcall
local rawget, rawset, setmetatable, tonumber = rawget, rawset, setmetatable, tonumber
local tostring, type = tostring, type
local huge, remove = math.huge, table.remove
local is_seconds, is_text, is_whole = opts.is_seconds, opts.is_text, opts.is_whole

local proto = {}

local VERSION = 2 -- of the messages and of the graph in them, as rfsm.json writes it

-- Options ---------------------------------------------------------------------

-- Name of an option -> its description, its test and its default.
local OPTIONS = {
  allow_send = { "boolean", opts.is_a "boolean", false },
  clock = { "function that returns seconds", rfsm.is_callable },
  fsm = { "initialised fsm", rfsm.is_initialized_root },
  host = { "name or address", is_text, "localhost" },
  max_datagram = { "bytes from 1024 to 65507", is_whole(1024, 65507), 65507 },
  max_events = { "whole number from 1 on", is_whole(1, huge), 1000 },
  max_reads = { "whole number from 1 on", is_whole(1, huge), 64 },
  max_received = { "bytes from 64 to 65507", is_whole(64, 65507), 4096 },
  max_silence = { "finite number of seconds, not below 0", is_seconds, 3 },
  max_subscribers = { "whole number from 1 on", is_whole(1, huge), 16 },
  port = opts.whole(0, 65535, 44044),
  read_timeout = { "finite number of seconds, not below 0", is_seconds, 0 },
}

-- Returns a socket bound to host and port. If this fails, returns nil and the problem.
-- A name means its IPv4 address, so that "localhost" is the same everywhere.
local function bind(socket, host, port)
  local is_v6 = host:find(":", 1, true) and socket.udp6
  local udp, problem = (is_v6 or socket.udp4 or socket.udp)()
  local ok = udp
  if udp then ok, problem = udp:setsockname(host, ("%d"):format(port)) end
  if ok then
    udp:settimeout(0)
    return udp
  end
  if udp then udp:close() end
  return nil, ("cannot listen on %s, port %d: %s"):format(host, port, tostring(problem))
end

--- An open port.
---@class rfsm.proto.Server
---@field host string the address that it listens on
---@field port integer
local Server = {}
Server.__index = Server

--- Close the port and forget the subscribers. It may be called again.
function Server:close()
  if self.is_closed then return end
  self.is_closed, self.subscribers = true, {}
  self.udp:close()
end

-- Opens the port; `server` is the table of settings.
local function open_server(server)
  local socket, json = opts.find_package("socket", "dkjson")
  if not socket then return nil, json end
  local udp, problem = bind(socket, server.host, server.port)
  if not udp then return nil, problem end
  local host, port = udp:getsockname()
  server.host, server.port, server.clock = host, tonumber(port),
    server.clock or socket.gettime
  server.udp, server.json, server.now, server.is_closed = udp, json, 0, false
  server.subscribers = {} -- in the order in which they came
  -- number of a machine -> its feed (see `attach`), kept alive by the machine's hooks
  server.feeds, server.count = setmetatable({}, { __mode = "v" }), 0
  return setmetatable(server, Server)
end

-- Send ------------------------------------------------------------------------

local function find_subscriber(server, ip, port)
  for i, sub in ipairs(server.subscribers) do
    if sub.port == port and sub.ip == ip then return sub, i end
  end
end

local function drop(server, ip, port)
  local _, i = find_subscriber(server, ip, port)
  if i then remove(server.subscribers, i) end
end

-- Sends a text. If the send buffer is full the text is lost, as any datagram may be. A
-- subscriber that cannot be reached is dropped.
local function send(server, ip, port, text)
  local sent, problem = server.udp:sendto(text, ip, port)
  if not sent and problem ~= "timeout" then drop(server, ip, port) end
end

local function error_text(server, text)
  return ('{"type":"rfsm_error","version":%d,"text":%s}'):format(VERSION,
    server.json.quotestring(text))
end

-- Returns a message about a machine, or an error message in place of a too long one.
local function message_text(feed, kind, body)
  local text = ('{"type":"rfsm_%s","version":%d,"fsm":%d,"cnt":%d,%s}'):format(kind,
    VERSION, feed.number, feed.cnt, body)
  if #text <= feed.server.max_datagram then return text end
  return error_text(feed.server, kind .. ": too long for a datagram")
end

-- Calls f(sub) for each subscriber of a machine, the last one first, as f may drop it.
local function each_subscriber(feed, f)
  local subscribers = feed.server.subscribers
  for i = #subscribers, 1, -1 do
    local sub = subscribers[i]
    if not sub.only or sub.only == feed.number then f(sub) end
  end
end

local KEY_ORDER = {
  "id", "type", "src", "tgt", "pn", "events", "with_data", "internal", "transitions",
  "subnodes",
}

-- Returns the message with the graph of a machine, or an error message if the chart is
-- nested too deep for JSON. The JSON is made once.
local function graph_text(feed)
  if not feed.graph then
    local ok, graph = pcall(function()
      return feed.server.json.encode(marsh.jsontab(feed.fsm), { keyorder = KEY_ORDER })
    end)
    feed.graph, feed.has_graph = ok and graph or tostring(graph):match("^[^\n]*"), ok
  end
  if not feed.has_graph then
    return error_text(feed.server, "model: the graph cannot be written: " .. feed.graph)
  end
  return message_text(feed, "model", '"graph":' .. feed.graph)
end

local function send_graph(feed)
  each_subscriber(feed, function(sub)
    if sub.has_graph_of[feed] then return end
    sub.has_graph_of[feed] = true
    send(feed.server, sub.ip, sub.port, graph_text(feed))
  end)
end

local function send_state(feed)
  feed.cnt = feed.cnt + 1
  if not feed.server.subscribers[1] then return end
  local leaf, mode = marsh.actinfo2tab(feed.fsm)
  local quote = feed.server.json.quotestring
  local path = feed.path and quote(feed.path)
  feed.path = false
  local body = ('"act_leaf":%s,"act_leaf_state":%s,"path":%s'):format(
    leaf and quote(leaf) or "false", mode and quote(mode) or "false", tostring(path))
  local text = message_text(feed, "active_state", body)
  each_subscriber(feed, function(sub) send(feed.server, sub.ip, sub.port, text) end)
end

-- Messages by type: each function returns the reason of a refusal, or nil -------

local MESSAGES = {}

local function feed_of(server, message, number)
  local feed = server.feeds[number]
  if feed then return feed end
  return nil, ("%s: fsm: number of a machine expected, got %s"):format(message.type,
    type(number) == "number" and rfsm.text_of(number) or type(number))
end

function MESSAGES.subscribe(server, message, ip, port)
  local subscribers, only = server.subscribers, message.fsm or false
  if only then
    local feed, problem = feed_of(server, message, only)
    if not feed then return problem end
  end
  local sub = find_subscriber(server, ip, port)
  if not sub and #subscribers >= server.max_subscribers then
    return ("subscribe: there are %d subscribers already"):format(#subscribers)
  elseif not sub then
    sub = {}
    subscribers[#subscribers + 1] = sub
  end
  sub.ip, sub.port, sub.seen, sub.only = ip, port, server.now, only
  sub.has_path = message.path == true
  sub.has_graph_of = setmetatable({}, { __mode = "k" })
end

function MESSAGES.unsubscribe(server, _, ip, port) drop(server, ip, port) end

function MESSAGES.heartbeat(server, _, ip, port)
  local sub = find_subscriber(server, ip, port)
  if not sub then return "heartbeat: not subscribed" end
  sub.seen = server.now
end

-- Is an event a text, a boolean, a finite number, or a table with a name and data that
-- a snapshot can have?
local function is_event(event)
  if type(event) == "number" then return event - event == 0 end
  return encoding.is_event(event) and encoding.attempt(encoding.pack, event,
    { owner = "event", seen = false, is_by_value = true }, 0) ~= nil
end

function MESSAGES.event(server, message)
  local event = message.event
  if not server.allow_send then return "event: refused, allow_send is off" end
  if not is_event(event) then
    return "event: string, boolean or finite number expected, " .. opts.got(event)
  end
  local feed, problem = feed_of(server, message, message.fsm or 1)
  if not feed then return problem end
  if #feed.fsm._intq >= server.max_events then
    return ("event: %d events are pending already"):format(#feed.fsm._intq)
  end
  rfsm.send_events(feed.fsm, event)
end

-- Receive ---------------------------------------------------------------------

local function decode(server, data)
  if #data > server.max_received or not data:find("^%s*{") then return nil end
  local ok, message, after = pcall(server.json.decode, data, 1, nil, nil, nil)
  if ok and type(message) == "table" and not data:find("%S", after) then
    return message
  end
end

-- Handles a datagram. A message of unknown type gets no answer, since two services that
-- do not know each other's answers would exchange errors without an end.
local function handle(server, data, ip, port)
  local message = decode(server, data)
  local kind = message and message.type
  local take = type(kind) == "string" and MESSAGES[kind]
  local refusal = take and take(server, message, ip, port)
  if refusal then send(server, ip, port, error_text(server, refusal)) end
end

-- Reads a datagram up to one byte beyond the limit, which shows that it is too long.
local function read(server)
  return server.udp:receivefrom(server.max_received + 1)
end

local function read_first(server)
  server.udp:settimeout(server.read_timeout)
  local data, ip, port = read(server)
  server.udp:settimeout(0)
  return data, ip, port
end

-- Handles at most `max_reads` datagrams; `data` is the first one. Returns true if no
-- more wait. If a read returns the error of an earlier send, the error is ignored.
local function read_all(server, data, ip, port)
  for i = 1, server.max_reads do
    if data then
      handle(server, data, ip, port)
    elseif ip == "timeout" or ip == "closed" then
      return true
    end
    if i < server.max_reads then data, ip, port = read(server) end
  end
  return false
end

-- Sets the server's time. If the clock fails, returns the problem, and the time stays.
local function read_clock(server)
  local ok, now = pcall(server.clock)
  if not ok then return tostring(now) end
  if type(now) ~= "number" or now - now ~= 0 then
    return "finite number of seconds expected, " .. opts.got(now)
  end
  server.now = now
end

-- Drops subscribers that were silent too long. If the clock was set back, the silence
-- of each subscriber begins anew.
local function drop_silent(server)
  for i = #server.subscribers, 1, -1 do
    local sub = server.subscribers[i]
    if server.now < sub.seen then sub.seen = server.now end
    if server.now - sub.seen > server.max_silence then remove(server.subscribers, i) end
  end
end

-- Reads the port. Returns the problem if the clock failed. No subscriber is dropped
-- while datagrams wait, since the datagrams may be heartbeats.
local function receive(server)
  local data, ip, port = read_first(server)
  if not data and not server.subscribers[1] then return nil end
  local failure = read_clock(server)
  if read_all(server, data, ip, port) then drop_silent(server) end
  return failure
end

-- The path that was taken: for subscribers that ask -----------------------------

local function wants_path(feed)
  local is_wanted = false
  each_subscriber(feed, function(sub) is_wanted = is_wanted or sub.has_path end)
  return is_wanted
end

local function label_of(node)
  return node._fqn .. "[" .. rfsm.fsmobj_tochar(node) .. "]"
end

-- Starts, or stops, noting the paths that the machine of a feed takes.
local function follow_paths(feed, is_wanted)
  if is_wanted and not feed.hooks[1] then
    instrument.hook(feed.hooks, feed.fsm, "path", function(_, path)
      feed.path = path[1] and label_of(path[1].src) or false
      for _, tr in ipairs(path) do feed.path = feed.path .. "->" .. label_of(tr.tgt) end
    end)
  elseif not is_wanted then
    instrument.give_back(feed.hooks)
  end
end

-- Hooks of a machine -----------------------------------------------------------

-- Has a machine answer at a port. The feed holds the port's data about the machine.
-- A machine gets its number with the first step, so a machine that never runs has none.
local function attach(fsm, server)
  local feed = { server = server, fsm = fsm, number = 0, cnt = 0, graph = false,
    path = false, hooks = {} }
  local hooks = {}

  local function before_step()
    if server.is_closed then
      follow_paths(feed, false)
      return instrument.give_back(hooks)
    end
    if feed.number == 0 then
      server.count = server.count + 1
      feed.number, server.feeds[server.count] = server.count, feed
    end
    local failure = receive(server)
    follow_paths(feed, wants_path(feed))
    send_graph(feed)
    if failure then rfsm.report(fsm, "err", "PROTO", "the clock failed: ", failure) end
  end

  local function after_step()
    if not server.is_closed then send_state(feed) end
  end

  local function after_reset()
    if feed.number > 0 then after_step() end
  end

  -- The graph is made again with the next step, and sent to each subscriber.
  local function after_merge()
    feed.graph = false
    each_subscriber(feed, function(sub) sub.has_graph_of[feed] = nil end)
  end

  -- called before other hooks, so that these see the events that were received
  instrument.hook(hooks, fsm, "pre_step", before_step, "before")
  instrument.hook(hooks, fsm, "post_step", after_step)
  instrument.hook(hooks, fsm, "reset", after_reset)
  instrument.hook(hooks, fsm, "watch", "merged", after_merge)
end

-- Public functions ------------------------------------------------------------

local open = {} -- servers for all machines initialised from now on
local servers = setmetatable({}, { __mode = "k" }) -- all servers that are still in use

--- The options of `install`.
---@class rfsm.proto.Options
---@field host? string name or address to listen on, default "localhost"
---@field port? integer default 44044; 0: any free port
---@field read_timeout? number seconds that an iteration waits for a datagram, default 0
---@field allow_send? boolean may messages send events? default false
---@field fsm? rfsm.Machine the machine that answers; nil: all that are made from now on
---@field clock? fun(): number returns seconds; default `socket.gettime`
---@field max_datagram? integer most bytes of a message that is sent, default 65507
---@field max_received? integer most bytes of a message that is read, default 4096
---@field max_reads? integer most datagrams read in an iteration, default 64
---@field max_events? integer most events that wait in a machine, default 1000
---@field max_subscribers? integer default 16
---@field max_silence? number seconds; a subscriber without heartbeat for longer is
-- dropped, default 3

--- Open a port at which machines answer.
--
-- @usage
--    proto.install { port = 44044, allow_send = true }
--    local fsm = rfsm.init(model)
--
-- @raise when an option is wrong, a package is missing or the port cannot be opened
---@param options? rfsm.proto.Options
---@return rfsm.proto.Server server
function proto.install(options)
  local server, problem = opts.read(OPTIONS, options == nil and {} or options)
  if server then server, problem = open_server(server) end
  if not server then error("rfsm.proto.install: " .. problem, 2) end
  servers[server] = true
  if server.fsm then
    attach(server.fsm, server)
    server.fsm = nil -- a port keeps no machine alive
  else
    open[#open + 1] = server
  end
  return server
end

--- Close all ports; the machines go on running.
function proto.uninstall()
  for server in pairs(servers) do server:close() end -- any order: all of them
  open, servers = {}, setmetatable({}, { __mode = "k" })
end

rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  if merged then return end
  for i = #open, 1, -1 do
    if open[i].is_closed then remove(open, i) end
  end
  for i = 1, #open do attach(fsm, open[i]) end
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_proto", proto) end

return proto
