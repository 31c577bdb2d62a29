--- Connections to a server of Redis, or to the nodes of a cluster.
--
-- A call is sent again when the connection is lost, a slot has moved, or another node
-- has become the master. So a call that must not be applied twice needs an id.
--
-- @module rfsm.redis.connection
-- @license BSD-3-Clause

local try = require("rfsm.shared.calls").try
local opts = require "rfsm.shared.options"
local order = require "rfsm.shared.order"
local rfsm = require "rfsm"

local error, ipairs, next, pairs = error, ipairs, next, pairs
local pcall, rawget, setmetatable = try, rawget, setmetatable
local tonumber, tostring, type = tonumber, tostring, type
local min = math.min
local concat = table.concat
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local connection = {}

local function need(name) return opts.need("rfsm.fleet", name) end

-- Addresses -----------------------------------------------------------------------

local function unescaped(text)
  return text and (text:gsub("%%(%x%x)", function(hex)
    return string.char(tonumber(hex, 16))
  end))
end

--- Return the parts of a URL like rediss://user:password@host:6380/1; nil if wrong.
function connection.parse(url)
  local scheme, rest = url:match("^(rediss?)://(.*)$")
  local user, password, place = (rest or ""):match("^([^:@/]*):([^@/]*)@(.*)$")
  local host, port, db = (place or rest or ""):match("^([^:/@]+):?(%d*)/?(%d*)$")
  if not host then return nil end
  return { is_tls = scheme == "rediss", user = user ~= "" and unescaped(user) or nil,
    password = unescaped(password), host = host,
    port = tonumber(port == "" and "6379" or port), db = tonumber(db) }
end

--- Connections to the nodes of a fleet.
---@class rfsm.redis.Connection
---@field settings table the first URL as `connection.parse` returns it
---@field options table `timeout`, `patience` (seconds), `tls`
---@field seeds string[] addresses to try: from the URLs, then the other cluster nodes
---@field nodes table<string, table> address -> open connection
---@field node_of table<string, string> hash tag that has moved -> address of its node
local Connection = {}
Connection.__index = Connection

-- One node ------------------------------------------------------------------------

local commands = {}

-- Sends a command. Raises the error of the server, without the prefix of lua-redis.
local function command(client, name, ...)
  commands[name] = commands[name] or need("redis").command(name)
  local ok, reply = pcall(commands[name], client, ...)
  if ok then return reply end
  reply = tostring(reply):gsub("^.-redis error: ", "")
    :gsub("^ERR Function not found$", "%0: load a library (rfsm redis --load)")
  error((reply:gsub("^%S+redis%.lua:%d+: ", "")), 0)
end

local function is_lost(text)
  return text:find("^connection error") or text:find("closed$")
    or text:find("^timeout") or text:find("cannot connect", 1, true)
    or text:find("^LOADING")
end

--- Is an error one that passes, and that changes nothing: the server is busy with a
-- call, or has no memory left?
function connection.has_to_wait(text)
  return (text:find("BUSY Redis is busy", 1, true) or text:find "OOM command") ~= nil
end

local function secured(self, socket)
  local found, ssl = pcall(require, "ssl")
  if not found then error("the package lua-sec is missing", 0) end
  local settings = { mode = "client", protocol = "any", verify = "peer",
    capath = "/etc/ssl/certs", options = "all" }
  for key, value in pairs(self.options.tls or {}) do settings[key] = value end -- a copy
  local wrapped, problem = ssl.wrap(socket, settings)
  if wrapped then
    wrapped:settimeout(self.options.timeout)
    local ok, why = wrapped:dohandshake()
    if ok then return wrapped end
    problem = why
  end
  error("TLS: " .. tostring(problem), 0)
end

local function open(self, host, port)
  local socket, settings = need("socket").tcp(), self.settings
  socket:settimeout(self.options.timeout)
  local ok, problem = socket:connect(host, port)
  if not ok then error(problem, 0) end
  socket:setoption("tcp-nodelay", true)
  if settings.is_tls then socket = secured(self, socket) end
  local client = need("redis").connect { socket = socket }
  if settings.password then
    if settings.user then
      command(client, "AUTH", settings.user, settings.password)
    else
      command(client, "AUTH", settings.password)
    end
  end
  if settings.db then command(client, "SELECT", settings.db) end
  return client
end

-- Returns the connection to an address such as 127.0.0.1:6379.
local function node(self, address)
  if self.nodes[address] then return self.nodes[address] end
  local host, port = address:match("^(.*):(%d+)$")
  local ok, client = pcall(open, self, host, tonumber(port))
  if not ok then
    error(("rfsm.fleet: cannot connect to %s: %s"):format(address, client), 0)
  end
  self.nodes[address] = client
  return client
end

-- Closes the connection to an address, and forgets which hash tags have moved there.
local function drop(self, address)
  local client = self.nodes[address]
  if client then pcall(client.network.socket.close, client.network.socket) end
  self.nodes[address] = nil
  for tag, place in order.each(self.node_of) do -- any order: each is independent
    if place == address then self.node_of[tag] = nil end
  end
end

local function is_closed(text) return is_lost(text) or text:find("^NOAUTH") end

-- Adds the addresses of all nodes to `seeds`, if the server belongs to a cluster.
local function learn(self, client)
  local ok, slots = pcall(command, client, "CLUSTER", "SLOTS")
  if not ok and is_closed(slots) then
    error("rfsm.fleet: no server of Redis answers: " .. slots, 0)
  end
  local is_known = {}
  for _, address in ipairs(self.seeds) do is_known[address] = true end
  for _, range in ipairs(ok and slots or {}) do
    for i = 3, #range do
      local host = range[i][1]
      local address = host and host ~= "" and host .. ":" .. ("%d"):format(range[i][2])
      if address and not is_known[address] then
        is_known[address] = true
        self.seeds[#self.seeds + 1] = address
      end
    end
  end
end

-- All nodes -----------------------------------------------------------------------

--- Connect to the server of a URL. In a list of URLs, the later ones are tried if the
-- first is not reached. Raises an error if no server is reached, or a URL is wrong.
function connection.connect(urls, options)
  local self = setmetatable({ settings = false, options = options, seeds = {},
    nodes = {}, node_of = {} }, Connection)
  for i, url in ipairs(type(urls) == "table" and urls or { urls }) do
    local settings = connection.parse(url)
    if not settings then
      error("rfsm.fleet.connect: redis://[USER:PASSWORD@]HOST:PORT[/DB] expected, got '"
        .. url .. "'", 0)
    end
    self.settings = self.settings or settings
    self.seeds[i] = settings.host .. ":" .. settings.port
  end
  local problem
  for _, address in ipairs(self.seeds) do
    local ok, client = pcall(node, self, address)
    if ok then
      learn(self, client)
      return self
    end
    problem = problem or client
  end
  error(problem, 0)
end

local function sleep(seconds) need("socket").sleep(seconds) end

local function time() return need("socket").gettime() end

-- Returns the address to try after an error of the server; false if any other address
-- is to be tried, nil if the command is not to be sent again. The second result is true
-- if the command ASKING has to be sent first.
local function redirected(self, tag, address, text)
  local kind, host, port = text:match("^(%u+) %d+ ([^ ]*):(%d+)$")
  if kind == "MOVED" or kind == "ASK" then
    if host == "" then host = address:match("^(.*):") end
    if kind == "MOVED" then self.node_of[tag] = host .. ":" .. port end
    return host .. ":" .. port, kind == "ASK"
  elseif text:find("^TRYAGAIN") or text:find("^CLUSTERDOWN")
    or text:find("^BUSY ") then
    return address, false
  elseif is_lost(text) or text:find("^READONLY") or text:find("^MASTERDOWN") then
    drop(self, address)
    return false, false
  end
end

-- Sends a command to one node, and ASKING before it if `is_asked`. Returns true, the
-- reply and the connection, or false and the error.
local function ask(self, address, is_asked, name, ...)
  local found, client = pcall(node, self, address)
  if not found then return false, client end
  if is_asked then
    local ok, problem = pcall(command, client, "ASKING")
    if not ok then return false, problem end
  end
  local ok, reply = pcall(command, client, name, ...)
  return ok, reply, client
end

--- Send a command to the node that has the keys of a hash tag; return the reply, and
-- the connection to the node. If the node is not reached, the command is sent again for
-- `patience` seconds, also to other nodes. Raises the error of the server.
function Connection:call(tag, name, ...)
  local address, is_asked = self.node_of[tag] or self.seeds[1], false
  local started, tries, seed = time(), 0, 1
  repeat
    local ok, reply, client = ask(self, address, is_asked, name, ...)
    if ok then return reply, client end
    local other
    other, is_asked = redirected(self, tag, address, reply)
    if other == nil then error(reply, 0) end
    if other == false then -- any other: the next address of `seeds`
      seed = seed % #self.seeds + 1
      other = self.seeds[seed]
    end
    tries = tries + 1
    if other == address or tries > 2 then sleep(min(0.01 * tries, 0.2)) end
    address = other
    if time() - started > self.options.patience then
      error(("rfsm.fleet: no answer for {%s} in %s s: %s"):format(tag,
        rfsm.text_of(self.options.patience), reply), 0)
    end
  until false
end

--- Send a command by a connection that `call` has returned; return whether it was
-- done, and the reply. It is not done if the connection is lost: another one may reach
-- a node that does not know what was sent before.
function Connection:call_by(client, name, ...)
  for address, open_client in order.each(self.nodes) do -- any order: one is found
    if open_client == client then
      local ok, reply = pcall(command, client, name, ...)
      if not ok and is_lost(reply) then drop(self, address) end
      return ok, ok and reply or nil
    end
  end
  return false
end

local function read(client)
  commands.READ = commands.READ or need("redis").command("READ",
    { request = function() end })
  return command(client, "READ")
end

-- Sends calls to one node in one text. Returns a table number of a call -> its reply. A
-- call that got no reply is not in the table.
local function ask_at_once(self, address, calls)
  local found, client = pcall(node, self, address)
  local texts, replies = {}, {}
  if not found then return replies end
  local writer = { network = {} }
  function writer.network.write(_, text) texts[#texts + 1] = text end
  for _, call in ipairs(calls) do client.requests.multibulk(writer, unpack(call)) end
  if not pcall(client.network.write, client, concat(texts)) then
    drop(self, address)
    return replies
  end
  for i = 1, #calls do
    local ok, reply = pcall(read, client)
    if ok then
      replies[i] = reply
    elseif is_lost(reply) then
      drop(self, address)
      break
    end
  end
  return replies
end

--- Send one call { command, argument, ... } for each hash tag; return the replies. The
-- calls for one node are sent together. A call without a reply is sent again, so it may
-- arrive twice. Raises the error of the server.
function Connection:call_all(tags, calls)
  local by_address, replies = {}, {}
  for i, tag in ipairs(tags) do
    local address = self.node_of[tag] or self.seeds[1]
    local group = by_address[address] or { calls = {}, numbers = {} }
    by_address[address] = group
    group.calls[#group.calls + 1], group.numbers[#group.numbers + 1] = calls[i], i
  end
  for address, group in order.each(by_address) do -- any order: each is independent
    for i, reply in order.each(ask_at_once(self, address, group.calls)) do -- any order
      replies[group.numbers[i]] = reply
    end
  end
  for i, tag in ipairs(tags) do
    if replies[i] == nil then replies[i] = self:call(tag, unpack(calls[i])) end
  end
  return replies
end

--- Call `f(text)` for each text that is published on a channel, until `f` returns true.
-- This opens another connection, to the node of the hash tag, which has the channel.
function Connection:subscribe(tag, channel, f)
  local host, port = (self.node_of[tag] or self.seeds[1]):match("^(.*):(%d+)$")
  local client = open(self, host, tonumber(port))
  client.network.socket:settimeout(nil)
  local message = command(client, "SSUBSCRIBE", channel)
  while not (message[1] == "smessage" and f(message[3])) do message = read(client) end
  client.network.socket:close()
end

--- Call f(call) for each master of the cluster, or once for a server without a cluster.
-- call(name, ...) sends a command to this node, and returns the reply.
function Connection:each_master(f)
  local _, address = next(self.node_of)
  local ok, text = ask(self, address or self.seeds[1], false, "CLUSTER", "NODES")
  local masters = {}
  for line in (ok and text or ""):gmatch("[^\n]+") do
    local place = line:match("^%S+ ([^@]+)@%S* %S*master")
    if place and not line:find("fail", 1, true) then masters[#masters + 1] = place end
  end
  if not ok then masters[1] = self.seeds[1] end
  for _, place in ipairs(masters) do
    f(function(name, ...)
      local done, reply = ask(self, place, false, name, ...)
      if done then return reply end
      if is_lost(reply) then drop(self, place) end
      error(reply, 0)
    end)
  end
end

return connection
