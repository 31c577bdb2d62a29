-- Real Redis servers for the specs, on loopback, and many clients at once.

local helper = require "spec.helper"
local servers = require "spec.support.servers"

local has_socket, socket = pcall(require, "socket")

local output_of = servers.output_of

local redis = setmetatable({}, { __index = servers })

--- Returns what a spec needs and this machine or Lua lacks, as a reason; nil if it is
-- all there.
function redis.missing()
  for _, name in ipairs { "socket", "redis", "dkjson" } do
    if not helper.package(name) then
      return ("the module %s is missing for %s"):format(name, _VERSION)
    end
  end
  return output_of("command -v redis-server") == "" and "redis-server is missing" or nil
end

--- Is the module there that connections need?
redis.has_socket = has_socket

local function free_port()
  local listener = assert(socket.bind("127.0.0.1", 0))
  local _, port = listener:getsockname()
  listener:close()
  return port
end

-- Waits until a server answers. It is there within seconds, or not at all.
local function wait_for(port)
  for _ = 1, 500 do
    if output_of(("redis-cli -p %d PING"):format(port)) == "PONG\n" then return end
    socket.sleep(0.02)
  end
  error("redis-server does not answer")
end

--- A server that was started.
---@class Server
---@field port integer
---@field folder string
---@field options string
local Server = {}
Server.__index = Server

function Server:launch()
  output_of(("redis-server --port %d --bind 127.0.0.1 --dir %s --daemonize yes "
    .. "--pidfile %s/pid --logfile %s/log --save '' %s"):format(self.port, self.folder,
    self.folder, self.folder, self.options))
  wait_for(self.port)
end

--- Kills it as a power cut would.
function Server:kill()
  output_of("kill -9 $(cat " .. self.folder .. "/pid)")
  for _ = 1, 500 do
    if not socket.connect("127.0.0.1", self.port) then return end
    socket.sleep(0.01)
  end
end

function Server:url() return "redis://127.0.0.1:" .. self.port end

--- Runs redis-cli; returns its output.
function Server:cli(arguments)
  return output_of(("redis-cli -p %d %s"):format(self.port, arguments))
end

--- Starts a server with these options of the command line.
function redis.start(options)
  return servers.start(Server, { port = free_port(), options = options or "" })
end

-- Many clients ---------------------------------------------------------------------

local function request(...)
  local parts = { "*" .. select("#", ...) .. "\r\n" }
  for i = 1, select("#", ...) do
    local text = tostring((select(i, ...)))
    parts[#parts + 1] = "$" .. #text .. "\r\n" .. text .. "\r\n"
  end
  return table.concat(parts)
end

-- Reads the reply to a call: a list of texts, or an error.
local function read_reply(client)
  local line, problem = client:receive("*l")
  if not line then return nil, problem end
  if line:sub(1, 1) ~= "*" then return false, line end
  for _ = 1, tonumber(line:sub(2)) do
    local size = tonumber((client:receive("*l") or ""):match("^%$(%d+)"))
    if not size or not client:receive(size + 2) then return nil, "cut" end
  end
  return true
end

--- Sends events with many clients at once, each of which waits for every reply.
--
-- `next_key(i)` names the machine of call number i. Returns how many calls were
-- answered, by key; the errors; and how many were sent, by key. `each(i)` is called
-- after call number i. It ends when all are answered, or the server is gone.
function redis.storm(port, clients, calls, next_key, event, each)
  local sockets, key_of, answered, sent, errors = {}, {}, {}, {}, {}
  local made = 0
  local function send(client)
    if made >= calls then return end
    made = made + 1
    local key = next_key(made)
    key_of[client] = key
    if client:send(request("FCALL", "rfsm_send", 1, key, event)) then
      sent[key] = (sent[key] or 0) + 1
    end
    if each then each(made) end
  end
  local function receive(client)
    local ok, problem = read_reply(client)
    local key = key_of[client]
    if ok then answered[key] = (answered[key] or 0) + 1 end
    if ok == false then errors[#errors + 1] = problem end
    key_of[client] = nil
    if ok ~= nil then send(client) end
    return ok ~= nil
  end
  for i = 1, clients do
    sockets[i] = assert(socket.connect("127.0.0.1", port))
    sockets[i]:settimeout(10)
    send(sockets[i])
  end
  while next(key_of) do
    local ready = socket.select(sockets, nil, 10)
    local is_alive = ready[1] ~= nil
    for _, client in ipairs(ready) do
      if key_of[client] then is_alive = receive(client) and is_alive end
    end
    if not is_alive then break end
  end
  for i = 1, clients do sockets[i]:close() end
  return answered, errors, sent
end

return redis
