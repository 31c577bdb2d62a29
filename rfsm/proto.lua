--- Introspection over UDP: other programs watch machines, and may send them events.
--
-- `install` opens a port. Each machine initialised afterwards answers there, in JSON. A
-- subscriber receives the graph of the machine and, after each iteration, its active
-- states. Each machine of a port has a number.
--
-- The port is looked at when a machine is advanced; nothing runs in between. No
-- datagram makes a step fail or wait, and what one can cost is bounded. Needs the
-- packages luasocket and dkjson.
--
-- The file reads in this order: options, server, sending, messages, receiving, the
-- hooks of a machine, public functions.
--
-- @module rfsm.proto
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local marsh = require "rfsm.marsh"

local error, getmetatable, pairs, pcall = error, getmetatable, pairs, pcall
local print, rawget, rawset, require, select = print, rawget, rawset, require, select
local setmetatable, tonumber, tostring, type = setmetatable, tonumber, tostring, type
local floor, huge = math.floor, math.huge
local concat, remove, sort = table.concat, table.remove, table.sort

local proto = {}

local VERSION = 2 -- of the messages and of the graph in them, as rfsm.json writes it

-- Limits: what a datagram, or a lot of them, can cost.
local MAX_READS = 64 -- datagrams read in one iteration
local MAX_RECEIVED = 4096 -- bytes of a datagram
local BUDGET = 32768 -- bytes read and answered, after which the rest waits
local MAX_DEPTH = 8 -- lists and objects inside each other
local MAX_COMMAS = 64 -- between values
local MAX_WAITING = 1000 -- events that wait until their machine is advanced
local MAX_SILENCE = 3 -- seconds without a heartbeat
local ENVELOPE = 256 -- bytes at most around a graph or a part of it

local WEAK_KEYS, WEAK_VALUES = { __mode = "k" }, { __mode = "v" }

-- Options ---------------------------------------------------------------------

local function is_callable(value)
  if type(value) == "function" then return true end
  local class = getmetatable(value)
  return type(class) == "table" and rawget(class, "__call") ~= nil
end

local function is_whole(least, most)
  return function(x)
    return type(x) == "number" and x >= least and x <= most and x == floor(x)
  end
end

-- Name, what it must be, how to see that, default.
local OPTIONS = {
  { "allow_send", "boolean", function(x) return type(x) == "boolean" end, false },
  { "clock", "function that returns seconds", is_callable },
  { "fsm", "initialised fsm", rfsm.is_initialized_root },
  { "host", "name or address", function(x) return type(x) == "string" and x ~= "" end,
    "localhost" },
  { "max_datagram", "bytes from 1024 to 65507", is_whole(1024, 65507), 65507 },
  { "max_subscribers", "whole number from 1 on", is_whole(1, huge), 16 },
  { "port", "whole number from 0 to 65535", is_whole(0, 65535), 44044 },
  { "read_timeout", "finite number of seconds, not below 0",
    function(x) return type(x) == "number" and x >= 0 and x < huge end, 0 },
}

-- Says what a value is, in a few bytes whatever it is.
local function kind_of(value)
  if type(value) == "number" then return ("%.14g"):format(value) end
  return type(value)
end

local function text_of(value)
  if type(value) == "string" then return ("string '%s'"):format(value) end
  return kind_of(value)
end

-- Says which of the options there is none of; nil when all are known.
local function find_unknown(options)
  local is_option, names, unknown = {}, {}, {}
  for i = 1, #OPTIONS do
    names[i] = OPTIONS[i][1]
    is_option[names[i]] = true
  end
  for name in pairs(options) do -- any order: sorted below
    if not is_option[name] then unknown[#unknown + 1] = tostring(name) end
  end
  if not unknown[1] then return nil end
  sort(unknown)
  return ("unknown option '%s', expected: %s"):format(unknown[1], concat(names, ", "))
end

-- Returns the options with their defaults; nil and what is wrong.
local function read_options(options)
  if options == nil then options = {} end
  if type(options) ~= "table" then
    return nil, "table of options expected, got " .. text_of(options)
  end
  local unknown = find_unknown(options)
  if unknown then return nil, unknown end
  local settings = {}
  for i = 1, #OPTIONS do
    local name, what, is_right, default = OPTIONS[i][1], OPTIONS[i][2], OPTIONS[i][3],
      OPTIONS[i][4]
    local value = options[name]
    if value ~= nil and not is_right(value) then
      return nil, ("%s: %s expected, got %s"):format(name, what, text_of(value))
    end
    if value == nil then value = default end
    settings[name] = value
  end
  return settings
end

local function find_package(name, package)
  local ok, module = pcall(require, name)
  if ok and type(module) == "table" then return module end
  return nil, ("the package %s is missing (on Debian: apt-get install %s)"):format(
    name == "socket" and "luasocket" or name, package)
end

-- Returns a socket bound to host and port; nil and why not. A name means its IPv4
-- address, so that "localhost" is the same everywhere.
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

-- Server: a port, those who subscribed there, the machines that answer ----------

--- An open port.
---@class rfsm.proto.Server
---@field host string the address that it listens on
---@field port integer
local Server = {}
Server.__index = Server

local function new_server(settings, socket, json, udp)
  local host, port = udp:getsockname()
  return setmetatable({
    host = host, port = tonumber(port), is_closed = false,
    -- settings
    allow_send = settings.allow_send, max_subscribers = settings.max_subscribers,
    max_datagram = settings.max_datagram, read_timeout = settings.read_timeout,
    clock = settings.clock or socket.gettime,
    -- the run
    udp = udp, json = json, now = 0, budget = 0,
    subscribers = {}, -- in the order in which they came
    machines = setmetatable({}, WEAK_VALUES), count = 0, -- by number; not kept alive
  }, Server)
end

local function open_server(settings)
  local socket, json, udp, problem
  socket, problem = find_package("socket", "lua-socket")
  if not socket then return nil, problem end
  json, problem = find_package("dkjson", "lua-dkjson")
  if not json then return nil, problem end
  udp, problem = bind(socket, settings.host, settings.port)
  if not udp then return nil, problem end
  return new_server(settings, socket, json, udp)
end

--- Close the port and forget who subscribed; again does no harm.
function Server:close()
  if self.is_closed then return end
  self.is_closed, self.subscribers = true, {}
  self.udp:close()
end

-- What a machine has to do with one server; the machine has a list of them, `_proto`.
local function new_feed(server)
  return {
    server = server, number = 0, -- the number comes with the first step
    cnt = 0, inbox = {}, -- events that wait for the next step
    -- the graph as JSON, made when it is first wanted; or why there is none
    graph = false, failure = false, cuts = false, revision = 1,
    part = 0, data = false, -- the part that was sent last, as a JSON string
    -- the end of the last rfsm_active_state, and what it was made of
    leaf = nil, mode = nil, tail = false,
  }
end

local function feed_of(server, fsm)
  for i = 1, #fsm._proto do
    if fsm._proto[i].server == server then return fsm._proto[i] end
  end
end

-- Send ------------------------------------------------------------------------

local function find_subscriber(server, ip, port)
  for i = 1, #server.subscribers do
    local sub = server.subscribers[i]
    if sub.port == port and sub.ip == ip then return sub, i end
  end
end

local function drop(server, ip, port)
  local _, i = find_subscriber(server, ip, port)
  if i then remove(server.subscribers, i) end
end

-- Sends a text. A full buffer loses it, as UDP may; who cannot be reached is dropped.
local function send(server, ip, port, text)
  server.budget = server.budget - #text
  local sent, problem = server.udp:sendto(text, ip, port)
  if not sent and problem ~= "timeout" then drop(server, ip, port) end
end

local function refuse(server, ip, port, text)
  send(server, ip, port, ('{"type":"rfsm_error","version":%d,"text":%s}'):format(
    VERSION, server.json.quotestring(text)))
end

local function head(kind, feed)
  return ('{"type":"%s","version":%d,"fsm":%d,"cnt":%d,'):format(kind, VERSION,
    feed.number, feed.cnt)
end

local KEY_ORDER = {
  "id", "type", "src", "tgt", "pn", "events", "transitions", "subnodes",
}

-- Returns where the parts of a text begin, and its end; no part begins inside of a
-- UTF-8 character.
local function cuts_of(text, size)
  local cuts, from = { 1 }, 1
  while from + size <= #text do
    from = from + size
    for _ = 1, 3 do
      local byte = text:byte(from)
      if byte < 0x80 or byte >= 0xC0 then break end
      from = from - 1
    end
    cuts[#cuts + 1] = from
  end
  cuts[#cuts + 1] = #text + 1
  return cuts
end

local function encode_graph(json, fsm)
  return json.encode(marsh.jsontab(fsm), { keyorder = KEY_ORDER })
end

-- Makes the JSON of the graph, once. A chart nested too deep for Lua has none.
local function prepare_graph(server, fsm, feed)
  if feed.graph or feed.failure then return end
  local ok, graph = pcall(encode_graph, server.json, fsm)
  if not ok then
    feed.failure = "the graph cannot be written: " .. tostring(graph):match("^[^\n]*")
    return
  end
  feed.graph, feed.cuts, feed.part = graph, false, 0
  if #graph + ENVELOPE > server.max_datagram then -- quoted, a text doubles at most
    feed.cuts = cuts_of(graph, floor((server.max_datagram - ENVELOPE) / 2))
  end
end

local function part_text(server, feed, part)
  local cuts = feed.cuts
  if feed.part ~= part then
    feed.part = part
    feed.data = server.json.quotestring(feed.graph:sub(cuts[part], cuts[part + 1] - 1))
  end
  return ('%s"revision":%d,"part":%d,"parts":%d,"data":%s}'):format(
    head("rfsm_model_part", feed), feed.revision, part, #cuts - 1, feed.data)
end

-- Sends the graph, or that part of it if it is too long for one datagram.
local function send_model(server, fsm, feed, sub, part)
  prepare_graph(server, fsm, feed)
  local parts = feed.cuts and #feed.cuts - 1 or 1
  if feed.failure then
    refuse(server, sub.ip, sub.port, "model: " .. feed.failure)
  elseif not is_whole(1, parts)(part) then
    refuse(server, sub.ip, sub.port,
      ("model: part from 1 to %d expected, got %s"):format(parts, kind_of(part)))
  elseif feed.cuts then
    send(server, sub.ip, sub.port, part_text(server, feed, part))
  else
    send(server, sub.ip, sub.port, head("rfsm_model", feed) .. '"graph":' .. feed.graph
      .. "}")
  end
end

local function wants(sub, feed) return not sub.only or sub.only == feed.number end

-- Those who wait for the graph of a machine get it. The last comes first: sending may
-- drop the one that is at hand.
local function send_models(fsm, feed)
  local server = feed.server
  for i = #server.subscribers, 1, -1 do
    local sub = server.subscribers[i]
    if wants(sub, feed) and not sub.sent[feed] then
      sub.sent[feed] = true
      send_model(server, fsm, feed, sub, 1)
    end
  end
end

local function state_text(server, fsm, feed)
  local leaf, mode, path = marsh.actinfo2tab(fsm)
  if not feed.tail or leaf ~= feed.leaf or mode ~= feed.mode then
    local quote = server.json.quotestring
    feed.leaf, feed.mode = leaf, mode
    feed.tail = ('"act_leaf":%s,"act_leaf_state":%s,"path":%s}'):format(
      leaf and quote(leaf) or "false", mode and quote(mode) or "false", tostring(path))
  end
  return head("rfsm_active_state", feed) .. feed.tail
end

-- Tells all who want to know what is active.
local function tell(fsm, feed)
  local server = feed.server
  feed.cnt = feed.cnt + 1
  if not server.subscribers[1] then return end
  local text = state_text(server, fsm, feed)
  local is_long = #text > server.max_datagram
  for i = #server.subscribers, 1, -1 do
    local sub = server.subscribers[i]
    if wants(sub, feed) and is_long then
      refuse(server, sub.ip, sub.port, "rfsm_active_state: too long for a datagram")
    elseif wants(sub, feed) then
      send(server, sub.ip, sub.port, text)
    end
  end
end

-- Messages: what each type that comes in does ---------------------------------
--
-- A text that is returned says why it does not, and is sent back.

local MESSAGES = {}

-- Returns the machine of that number; nil and what is wrong when there is none.
local function find_machine(server, message, number)
  local fsm = server.machines[number]
  if fsm then return fsm end
  return nil, ("%s: fsm: number of a machine expected, got %s"):format(message.type,
    kind_of(number))
end

-- Returns the number in a message, else the subscriber's, else the first machine's.
local function number_in(message, only)
  if message.fsm ~= nil then return message.fsm end
  return only or 1
end

function MESSAGES.subscribe(server, message, ip, port)
  if message.fsm ~= nil then
    local fsm, complaint = find_machine(server, message, message.fsm)
    if not fsm then return complaint end
  end
  local subscribers = server.subscribers
  local sub = find_subscriber(server, ip, port)
  if not sub and #subscribers >= server.max_subscribers then
    return ("subscribe: there are %d subscribers already"):format(#subscribers)
  end
  if not sub then
    sub = { ip = ip, port = port, seen = 0, only = false, sent = false }
    subscribers[#subscribers + 1] = sub
  end
  sub.seen, sub.only = server.now, message.fsm or false
  sub.sent = setmetatable({}, WEAK_KEYS) -- the feeds whose graph it has been sent
end

function MESSAGES.unsubscribe(server, _, ip, port) drop(server, ip, port) end

function MESSAGES.heartbeat(server, _, ip, port)
  local sub = find_subscriber(server, ip, port)
  if not sub then return "heartbeat: not subscribed" end
  sub.seen = server.now
end

function MESSAGES.model(server, message, ip, port)
  local sub = find_subscriber(server, ip, port)
  if not sub then return "model: not subscribed" end
  local fsm, complaint = find_machine(server, message, number_in(message, sub.only))
  if not fsm then return complaint end
  local part = message.part
  send_model(server, fsm, feed_of(server, fsm), sub, part == nil and 1 or part)
end

local function is_event(value)
  local kind = type(value)
  if kind == "number" then return value - value == 0 end
  return kind == "string" or kind == "boolean"
end

function MESSAGES.event(server, message)
  local event = message.event
  if not server.allow_send then return "event: not taken, allow_send is off" end
  if not is_event(event) then
    return "event: string, boolean or finite number expected, got " .. kind_of(event)
  end
  local fsm, complaint = find_machine(server, message, number_in(message))
  if not fsm then return complaint end
  local inbox = feed_of(server, fsm).inbox
  if #inbox >= MAX_WAITING then
    return ("event: %d events wait already"):format(MAX_WAITING)
  end
  inbox[#inbox + 1] = event
end

-- Receive ---------------------------------------------------------------------

local function count(text, pattern) return select(2, text:gsub(pattern, "")) end

-- Has a text more values, or brackets deeper inside each other, than are read? What is
-- in strings does not count. Only JSON's dialects have a slash elsewhere.
local function is_tangled(text)
  if count(text, "[%[{,]") <= MAX_DEPTH then return false end
  text = text:gsub("\\.", ""):gsub('"[^"]*"', "")
  if text:find("/", 1, true) or count(text, ",") > MAX_COMMAS then return true end
  local depth = 0
  for bracket in text:gmatch("[%[%]{}]") do
    depth = depth + ((bracket == "[" or bracket == "{") and 1 or -1)
    if depth > MAX_DEPTH then return true end
  end
  return false
end

-- Returns the message in a datagram; nil when there is none that could be read.
local function decode(json, data)
  if #data > MAX_RECEIVED or not data:find("^%s*{") or is_tangled(data) then
    return nil
  end
  local ok, message, after = pcall(json.decode, data, 1, nil, nil, nil)
  if not ok or type(message) ~= "table" or data:find("%S", after) then return nil end
  return message
end

-- What cannot be read, or has no type of ours, is not answered: two services, or an
-- echo, never keep each other busy.
local function handle(server, data, ip, port)
  local message = decode(server.json, data)
  local kind = message and message.type
  local take = type(kind) == "string" and MESSAGES[kind]
  local complaint = take and take(server, message, ip, port)
  if complaint then refuse(server, ip, port, complaint) end
end

-- One byte more than is taken shows what is too long.
local function receive_first(server)
  local udp = server.udp
  if server.read_timeout == 0 then return udp:receivefrom(MAX_RECEIVED + 1) end
  udp:settimeout(server.read_timeout)
  local data, ip, port = udp:receivefrom(MAX_RECEIVED + 1)
  udp:settimeout(0)
  return data, ip, port
end

local function is_over(problem) return problem == "timeout" or problem == "closed" end

-- Reads what waits, up to the limits; `data` is the first. Returns whether that was
-- all. Errors of earlier sends show here, too, and are no reason to stop.
local function receive_all(server, data, ip, port)
  server.budget = BUDGET
  for i = 1, MAX_READS do
    if data then
      server.budget = server.budget - #data
      handle(server, data, ip, port)
    elseif is_over(ip) then
      return true
    end
    if i == MAX_READS or server.budget <= 0 then return false end
    data, ip, port = server.udp:receivefrom(MAX_RECEIVED + 1)
  end
end

-- Sets the server's time; returns why not, and the time stands still.
local function read_clock(server)
  local ok, now = pcall(server.clock)
  if not ok then return tostring(now) end
  if type(now) ~= "number" or now - now ~= 0 then
    return "finite number of seconds expected, got " .. text_of(now)
  end
  server.now = now
end

-- Drops who has not been heard of for too long. Nobody is when the clock jumps back.
local function drop_silent(server)
  for i = #server.subscribers, 1, -1 do
    local sub = server.subscribers[i]
    if server.now < sub.seen then sub.seen = server.now end
    if server.now - sub.seen > MAX_SILENCE then remove(server.subscribers, i) end
  end
end

-- Returns why the clock failed, if it did. While more waits to be read than a step
-- takes, heartbeats may be among it.
local function receive(server)
  local data, ip, port = receive_first(server)
  if not data and not server.subscribers[1] then return nil end
  local failure = read_clock(server)
  if receive_all(server, data, ip, port) then drop_silent(server) end
  return failure
end

-- Hooks of a machine -----------------------------------------------------------

local function pass_on(fsm, feed)
  local inbox = feed.inbox
  if #inbox == 0 then return end -- an event may be false
  feed.inbox = {}
  for i = 1, #inbox do rfsm.send_events(fsm, inbox[i]) end
end

local function report(fsm, ...)
  local f = fsm.err
  if f == true then f = print end
  if f then f(...) end
end

-- A machine gets its number with its first step: those that never run have none.
local function register(fsm, feed)
  local server = feed.server
  server.count = server.count + 1
  feed.number = server.count
  server.machines[feed.number] = fsm
end

local function serve(fsm, feed)
  if feed.number == 0 then register(fsm, feed) end
  local failure = receive(feed.server)
  pass_on(fsm, feed)
  send_models(fsm, feed)
  if failure then report(fsm, "PROTO", "the clock failed: ", failure) end
end

local function after_step(fsm)
  local feeds = fsm._proto
  for i = 1, feeds and #feeds or 0 do
    if not feeds[i].server.is_closed then tell(fsm, feeds[i]) end
  end
end

local function after_reset(fsm)
  local feeds = fsm._proto
  for i = 1, feeds and #feeds or 0 do
    local feed = feeds[i]
    feed.inbox = {}
    if feed.number > 0 and not feed.server.is_closed then tell(fsm, feed) end
  end
end

local before_step -- detach removes it, and it calls detach

local function detach(fsm)
  rfsm.pre_step_hook_rm(fsm, before_step)
  rfsm.post_step_hook_rm(fsm, after_step)
  rfsm.reset_hook_rm(fsm, after_reset)
  fsm._proto = nil
end

-- Servers that were closed are left here, too.
function before_step(fsm)
  local feeds = fsm._proto
  for i = #feeds, 1, -1 do
    if feeds[i].server.is_closed then remove(feeds, i) end
  end
  for i = 1, #feeds do serve(fsm, feeds[i]) end
  if not feeds[1] then detach(fsm) end
end

local function attach(fsm, server)
  if not fsm._proto then
    fsm._proto = {}
    rfsm.pre_step_hook_add(fsm, before_step, "before") -- other hooks come after events
    rfsm.post_step_hook_add(fsm, after_step)
    rfsm.reset_hook_add(fsm, after_reset)
  end
  fsm._proto[#fsm._proto + 1] = new_feed(server)
end

-- The graph has changed: it is made and sent anew.
local function forget_graph(feed)
  feed.graph, feed.failure, feed.revision = false, false, feed.revision + 1
  local subscribers = feed.server.subscribers
  for i = 1, #subscribers do subscribers[i].sent[feed] = nil end
end

-- Public functions ------------------------------------------------------------

local open = {} -- for all machines initialised from now on
local servers = setmetatable({}, WEAK_KEYS) -- all, as long as somebody has them

--- What `install` may be told.
---@class rfsm.proto.Options
---@field host? string name or address to listen on, default "localhost"
---@field port? integer default 44044; 0 for any that is free
---@field read_timeout? number seconds that an iteration waits for a datagram, default 0
---@field allow_send? boolean take events? default false
---@field fsm? rfsm.Machine the one that answers; nil for all initialised from now on
---@field clock? fun(): number seconds, for heartbeats; default `socket.gettime`
---@field max_datagram? integer bytes that are sent at most, default 65507
---@field max_subscribers? integer default 16

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
  local settings, problem = read_options(options)
  local server
  if settings then server, problem = open_server(settings) end
  if not server then error("rfsm.proto.install: " .. problem, 2) end
  servers[server] = true
  if settings.fsm then
    attach(settings.fsm, server)
  else
    open[#open + 1] = server
  end
  return server
end

--- Close all ports; machines go on without.
function proto.uninstall()
  for server in pairs(servers) do server:close() end -- any order: all of them
  open, servers = {}, setmetatable({}, WEAK_KEYS)
end

local function prepare(fsm)
  for i = #open, 1, -1 do
    if open[i].is_closed then remove(open, i) end
  end
  for i = 1, #open do attach(fsm, open[i]) end
end

rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  if not merged then return prepare(fsm) end
  for i = 1, fsm._proto and #fsm._proto or 0 do forget_graph(fsm._proto[i]) end
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_proto", proto) end

return proto
