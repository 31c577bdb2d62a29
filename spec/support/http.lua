-- Clients of a page's server in the same process: plain sockets, and no waiting. Each
-- loop has an end.

local dkjson = require "dkjson"
local socket = require "socket"

local http = {}

local ROUNDS = 2000 -- of a server, each at most a millisecond long

--- Returns a connection that sends and receives while `server` is stepped.
function http.connect(server)
  local tcp = assert(socket.connect("127.0.0.1", server.port))
  tcp:settimeout(0)
  return tcp
end

--- Has the server go on until `is_done()` returns a true value, which is returned.
function http.until_done(server, is_done)
  for _ = 1, ROUNDS do
    server:step(0.001)
    local result = is_done()
    if result then return result end
  end
end

--- Sends a text as the server takes it.
function http.send(server, tcp, text)
  local sent = 0
  http.until_done(server, function()
    local last, problem, partly = tcp:send(text, sent + 1)
    sent = last or partly or sent
    return sent == #text or problem == "closed"
  end)
end

--- Returns all that comes until the server closes the connection; nil if it does not.
function http.receive_all(server, tcp)
  local received = ""
  return http.until_done(server, function()
    local data, problem, partly = tcp:receive("*a")
    received = received .. (data or partly or "")
    return (data or problem == "closed") and received
  end)
end

--- Sends a text; returns the status and the whole reply.
function http.talk(server, text)
  local tcp = http.connect(server)
  http.send(server, tcp, text)
  local reply = http.receive_all(server, tcp)
  tcp:close()
  return reply and tonumber(reply:match("^HTTP/1%.1 (%d+)")), reply
end

--- Sends a request; returns the status, the body, and the whole reply.
function http.request(server, method, path, headers, body)
  local lines = { ("%s %s HTTP/1.1\r\n"):format(method, path) }
  headers = headers or { "Host: localhost" }
  for _, line in ipairs(headers) do lines[#lines + 1] = line .. "\r\n" end
  if body then lines[#lines + 1] = "Content-Length: " .. #body .. "\r\n" end
  local status, reply = http.talk(server, table.concat(lines) .. "\r\n" .. (body or ""))
  return status, reply and reply:match("\r\n\r\n(.*)$"), reply
end

-- Returns the address of something about a machine, the first one if none is named.
local function url_of(path, machine) return path .. "?machine=" .. (machine or 1) end

--- Sends a command as the page does; returns the status and the body.
function http.command(server, message, machine)
  return http.request(server, "POST", url_of("/command", machine), { "Host: 127.0.0.1",
    "X-Rfsm-Token: " .. server.token }, dkjson.encode(message))
end

--- A page that listens to its stream.
local Page = {}
Page.__index = Page

--- Returns the next message, decoded; nil if none comes.
function Page:next()
  return http.until_done(self.server, function()
    local data, _, partly = self.tcp:receive("*a")
    self.text = self.text .. (data or partly or "")
    local body, rest = self.text:match("event: state\ndata: ([^\n]*)\n\n(.*)$")
    if not body then return nil end
    self.text = rest
    return (dkjson.decode(body))
  end)
end

--- Sends a command as the page does; returns the next message.
function Page:command(name, fields)
  fields = fields or {}
  fields.command = name
  http.command(self.server, fields, self.machine)
  return self:next()
end

--- Sends an event and runs, likewise.
function Page:send(event)
  return self:command("send", { event = event, run = true })
end

--- Opens the stream of a page; returns it and the first message.
function http.page(server, machine)
  local page = setmetatable({ server = server, tcp = http.connect(server), text = "",
    machine = machine }, Page)
  http.send(server, page.tcp, "GET " .. url_of("/events", machine) .. "&token="
    .. server.token .. " HTTP/1.1\r\nHost: localhost\r\n\r\n")
  return page, page:next()
end

--- Returns how many pages are open.
function http.streams(server)
  local count = 0
  for _, connection in ipairs(server.http.connections) do
    if connection.phase == "stream" then count = count + 1 end
  end
  return count
end

--- Returns the chart as the page gets it.
function http.chart(server, machine)
  local _, body = http.request(server, "GET", url_of("/chart", machine))
  return (dkjson.decode(body))
end

return http
