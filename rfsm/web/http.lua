--- A small HTTP server for one page: requests, replies, streams of events.
--
-- One `step` reads and writes as far as it can without waiting. Each connection carries
-- one request. Time, bytes and connections are limited, so that no client can hold up
-- another. This needs the package luasocket. If a Lua zlib is installed (lua-zlib),
-- replies are compressed for clients that take that.
--
-- The file reads in this order: limits, requests, replies, connections, the server.
--
-- @module rfsm.web.http
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local opts = require "rfsm.shared.options"
local socket = require "socket"

local ipairs, pcall, setmetatable = ipairs, pcall, setmetatable
local tonumber, tostring, type = tonumber, tostring, type
local huge, max, remove = math.huge, math.max, table.remove

local http = {}

-- Limits ----------------------------------------------------------------------

local MAX_CONNECTIONS = 200
local MAX_DESCRIPTOR = 1023 -- the greatest file descriptor that `select` takes
local MAX_ACCEPTED = 50 -- new connections in one step
local MAX_STREAMS = 32
local MAX_HEAD, MAX_BODY = 8192, 16384
local MIN_PACKED = 1400 -- bytes; a smaller body fits in one packet
local BEAT_TIME = 15 -- seconds without a message until a heartbeat

-- Seconds that a phase of a connection may take. "reading" ends when the request is
-- complete, "writing" when the client has taken the reply, "closing" when the client
-- closes the connection. In a "stream" the client must take each message in this time.
local MAX_TIME = { reading = 5, writing = 30, closing = 2, stream = 30 }

-- Requests --------------------------------------------------------------------

--- A request.
---@class rfsm.web.Request
---@field method string such as "GET"
---@field path string the target of the request up to a question mark, not decoded
---@field query string the text behind the question mark; "" if there is none
---@field headers table<string, string> by lower-case name
---@field body string

local IS_SINGLE = { host = true, ["content-length"] = true }

-- Returns the header fields by their names in lower case; nil if a line is wrong.
local function parse_headers(lines)
  local headers = {}
  for line in lines:gmatch("\r\n([^\r\n]*)") do
    local name, value = line:match("^([%w_-]+):%s*(.-)%s*$")
    if not name then return nil end
    name = advice.lower(name)
    if IS_SINGLE[name] and headers[name] then return nil end
    headers[name] = value
  end
  return headers
end

-- Returns the length of the body; nil and the HTTP status if the request is refused.
local function body_length(headers)
  if headers["transfer-encoding"] then return nil, 501 end
  local text = headers["content-length"] or "0"
  if not text:find("^%d+$") then return nil, 400 end
  local length = tonumber(text)
  if length > MAX_BODY then return nil, 413 end
  return length
end

-- Returns the request in a text. Returns nil alone if the request is incomplete, and
-- nil and the HTTP status of the reply if the request is wrong.
local function parse_request(text)
  local stop, body_start = text:find("\r\n\r\n", 1, true)
  if not stop then return nil, #text > MAX_HEAD and 431 or nil end
  if stop > MAX_HEAD then return nil, 431 end
  local line, lines = text:sub(1, stop - 1):match("^([^\r\n]*)(.*)$")
  local method, target = line:match("^(%u+) (%S+) HTTP/1%.[01]$")
  local headers = method and parse_headers(lines)
  if not headers then return nil, 400 end
  local length, status = body_length(headers)
  if not length then return nil, status end
  local body = text:sub(body_start + 1)
  if #body < length then return nil end
  return {
    method = method, path = target:match("^[^?]*"), headers = headers,
    query = target:match("%?(.*)$") or "", body = body:sub(1, length),
  }
end

-- Replies ---------------------------------------------------------------------

--- The answer to a request.
---@class rfsm.web.Reply
---@field status? integer default 200
---@field type? string default "text/plain"
---@field body? string the body, or the first message of a stream
---@field policy? string the header field Content-Security-Policy
---@field stream? any what later messages are about, such as a tab; nil: none come, and
-- the connection is closed

local REASONS = {
  [200] = "OK", [202] = "Accepted", [204] = "No Content", [400] = "Bad Request",
  [403] = "Forbidden", [404] = "Not Found", [405] = "Method Not Allowed",
  [413] = "Content Too Large",
  [431] = "Request Header Fields Too Large", [500] = "Internal Server Error",
  [501] = "Not Implemented",
}

local COMMON = "Cache-Control: no-store\r\nConnection: close\r\n"
  .. "Referrer-Policy: no-referrer\r\nX-Content-Type-Options: nosniff\r\n"

-- Returns a function that compresses a text; false if no Lua zlib does.
local function find_gzip()
  local zlib = opts.find_package("zlib")
  local function gzip(text) return (zlib.deflate(6, 31)(text, "finish")) end
  local ok, packed = pcall(gzip, "")
  return ok and type(packed) == "string" and packed:sub(1, 2) == "\31\139" and gzip
end

local function takes_gzip(request)
  local names = request and request.headers["accept-encoding"] or ""
  for name, rest in names:lower():gmatch("([%w*-]+)([^,]*)") do
    if name == "gzip" then return not rest:find("q%s*=%s*0%.?0*%s*$") end
  end
  return false
end

-- Returns the body of a reply, and the header fields about it.
local function body_of(reply, gzip)
  local status = reply.status or 200
  local body = reply.body or (status ~= 204 and REASONS[status] .. "\n" or "")
  if reply.stream then return body, "" end
  local is_packed = gzip and #body >= MIN_PACKED
  if is_packed then body = gzip(body) end
  return body, ("Content-Length: %d\r\n"):format(#body)
    .. (is_packed and "Content-Encoding: gzip\r\nVary: Accept-Encoding\r\n" or "")
end

local function reply_text(reply, gzip)
  local status, body, fields = reply.status or 200, body_of(reply, gzip)
  return ("HTTP/1.1 %d %s\r\nContent-Type: %s; charset=utf-8\r\n"):format(status,
    REASONS[status], reply.type or "text/plain") .. fields .. COMMON .. (reply.policy
    and "Content-Security-Policy: " .. reply.policy .. "\r\n" or "") .. "\r\n" .. body
end

-- Connections: reading, then writing, then closing; or a stream -----------------

--- A connection.
---@class rfsm.web.Connection
---@field socket table
---@field phase "reading"|"writing"|"closing"|"stream"
---@field received string
---@field pending string a reply or message that is being sent; "" if there is none
---@field sent integer bytes of `pending` that the client has taken
---@field since number the time when the phase began; in a stream, the latest time when
-- the client took bytes or a message was begun
---@field stream? any the field `stream` of its reply

local function new_connection(client, now)
  client:settimeout(0)
  client:setoption("tcp-nodelay", true)
  return {
    socket = client, phase = "reading", received = "", pending = "", sent = 0,
    since = now,
  }
end

local function drop(server, connection)
  connection.socket:close()
  for i, other in ipairs(server.connections) do
    if other == connection then return remove(server.connections, i) end
  end
end

-- If no more streams are allowed, drops the stream whose client has left a message
-- unread for the longest time. If no message is unread, drops the oldest stream.
local function make_room(server)
  local silent, count = nil, 0
  for _, connection in ipairs(server.connections) do
    if connection.phase == "stream" then
      local is_stuck = connection.pending ~= ""
      count = count + 1
      if not silent or is_stuck and (silent.pending == ""
        or connection.since < silent.since) then
        silent = connection
      end
    end
  end
  if count >= MAX_STREAMS then drop(server, silent) end
end

local function begin_message(connection, text, now)
  connection.pending, connection.sent, connection.since = text, 0, now
end

local function begin_reply(server, connection, reply, request)
  if reply.stream then make_room(server) end
  connection.phase = reply.stream and "stream" or "writing"
  connection.stream = reply.stream
  local gzip = takes_gzip(request) and server.gzip
  begin_message(connection, reply_text(reply, gzip), server.clock())
end

-- Sends as much as the client takes. If the client is gone, `read` will notice.
local function write(server, connection)
  local last, _, partly = connection.socket:send(connection.pending,
    connection.sent + 1)
  if connection.phase == "stream" and (last or partly) > connection.sent then
    connection.since = server.clock()
  end
  connection.sent = max(connection.sent, last or partly)
  if connection.sent == #connection.pending then connection.pending = "" end
  if connection.phase == "writing" and connection.pending == "" then
    -- Closing with unread bytes would reset the connection and lose the reply.
    connection.socket:shutdown("send")
    connection.phase, connection.since = "closing", server.clock()
  end
end

-- Reads what has arrived. Returns false if the client is gone.
local function read(server, connection)
  local data, problem, partly = connection.socket:receive(4096)
  if not data and problem ~= "timeout" and partly == "" then return false end
  if connection.phase ~= "reading" then return true end -- nothing more is expected
  connection.received = connection.received .. (data or partly)
  local request, status = parse_request(connection.received)
  if not (request or status) then return data ~= nil or problem == "timeout" end
  begin_reply(server, connection, request and server.handle(request) or
    { status = status }, request)
  write(server, connection)
  return true
end

-- The server ------------------------------------------------------------------

--- A server: an open port and its connections.
---@class rfsm.web.HttpServer
---@field host string
---@field port integer
---@field connections rfsm.web.Connection[] the oldest first
local Server = {}
Server.__index = Server

local function drop_oldest(server)
  for _, connection in ipairs(server.connections) do
    if connection.phase ~= "stream" then return drop(server, connection) end
  end
end

local function accept(server)
  for _ = 1, MAX_ACCEPTED do
    local client = server.socket:accept()
    if not client then return end
    if #server.connections >= MAX_CONNECTIONS then drop_oldest(server) end
    if client:getfd() > MAX_DESCRIPTOR then
      client:close()
    else
      server.connections[#server.connections + 1] =
        new_connection(client, server.clock())
    end
  end
end

local function drop_late(server)
  local now = server.clock()
  for i = #server.connections, 1, -1 do
    local connection = server.connections[i]
    local is_waiting = connection.phase == "stream" and connection.pending == ""
    if not is_waiting and now > connection.since + MAX_TIME[connection.phase] then
      drop(server, connection)
    end
  end
end

--- Serve the connections that are ready; wait at most `timeout` seconds for one.
function Server:step(timeout)
  local readers, writers, by_socket = { self.socket }, {}, {}
  for i, connection in ipairs(self.connections) do
    readers[i + 1], by_socket[connection.socket] = connection.socket, connection
    if connection.pending ~= "" then writers[#writers + 1] = connection.socket end
  end
  if timeout == huge then timeout = nil end
  local readable, writable = socket.select(readers, writers, timeout)
  for _, client in ipairs(writable) do write(self, by_socket[client]) end
  for _, client in ipairs(readable) do
    local connection = by_socket[client]
    if connection and client:getfd() >= 0 and not read(self, connection) then
      drop(self, connection)
    end
  end
  accept(self)
  drop_late(self)
end

--- Send a message to each stream whose client has taken the previous message. The text
-- is the result of `next_message(connection)`. If that is nil, nothing is sent, except
-- a heartbeat from time to time.
function Server:feed(next_message)
  local now = self.clock()
  for _, connection in ipairs(self.connections) do
    if connection.phase == "stream" and connection.pending == "" then
      local is_quiet = now > connection.since + BEAT_TIME
      local text = next_message(connection) or is_quiet and ": beat\n\n"
      if text then
        begin_message(connection, text, now)
        write(self, connection)
      end
    end
  end
end

--- Close the port and all connections. It may be called again.
function Server:close()
  for _, connection in ipairs(self.connections) do connection.socket:close() end
  self.connections = {}
  self.socket:close()
end

--- Open a port, or any free port if `port` is 0. Return the server; nil and the problem
-- if that fails. `clock()` returns the seconds for the limits of time.
---@param host string
---@param port integer
---@param handle fun(request: rfsm.web.Request): rfsm.web.Reply
---@param clock fun(): number
function http.listen(host, port, handle, clock)
  local listening, problem = socket.bind(host, port, 128)
  if not listening then
    return nil, ("cannot listen on %s, port %d: %s"):format(host, port,
      tostring(problem))
  end
  listening:settimeout(0)
  local address, own_port = listening:getsockname()
  return setmetatable({
    socket = listening, host = address, port = tonumber(own_port),
    handle = handle, clock = clock or socket.gettime, connections = {},
    gzip = find_gzip(),
  }, Server)
end

return http
