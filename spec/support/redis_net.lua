-- Servers in place of Redis, in this process: sockets that speak its protocol, a clock
-- that only `sleep` moves, and a trace of what was sent.

local net = {}

-- Returns a reply as the protocol has it: text, number, true (OK), false (none), list,
-- or { err = text }.
local function encode(reply)
  if reply == true then return "+OK\r\n" end
  if reply == false then return "$-1\r\n" end
  if type(reply) == "number" then return (":%d\r\n"):format(reply) end
  if type(reply) == "string" then return ("$%d\r\n%s\r\n"):format(#reply, reply) end
  if reply.err then return "-" .. reply.err .. "\r\n" end
  local parts = { ("*%d\r\n"):format(#reply) }
  for i, item in ipairs(reply) do parts[i + 1] = encode(item) end
  return table.concat(parts)
end

-- Takes the first command from a text; returns its words and the rest.
local function decode(text)
  local count, at = text:match("^%*(%d+)\r\n()")
  local words = {}
  for i = 1, tonumber(count) do
    local size, from = text:match("^%$(%d+)\r\n()", at)
    words[i], at = text:sub(from, from + size - 1), from + size + 2
  end
  return words, text:sub(at)
end

local Socket = {}
Socket.__index = Socket

function Socket:note(...)
  local trace = self.net.trace
  trace[#trace + 1] = table.concat({ self.address or "?", ... }, " ")
end

function Socket:connect(host, port)
  self.address = host .. ":" .. ("%d"):format(port)
  if not self.net.nodes[self.address] then return nil, "connection refused" end
  return true
end

function Socket:settimeout(seconds) self.timeout = seconds end

function Socket:setoption(name, value) self[name] = value end

function Socket:close()
  self:note("close")
  self.is_lost = true
end

-- A node is a function of the words; it returns a reply, or nil and is gone.
function Socket:send(text)
  self.sends = (self.sends or 0) + 1
  while text ~= "" and not self.is_lost do
    local words
    words, text = decode(text)
    self:note(table.concat(words, " "))
    local node = self.net.nodes[self.address]
    local reply = node and node(words, self)
    self.is_lost = reply == nil
    self.replies = self.replies .. (reply ~= nil and encode(reply) or "")
  end
  return true
end

function Socket:receive(what)
  local replies = self.replies
  if replies == "" then return nil, self.is_lost and "closed" or "timeout" end
  local size = type(what) == "number" and what
  local last = size or replies:find("\n", 1, true)
  self.replies = replies:sub(last + 1)
  return replies:sub(1, size or last - 2)
end

--- Return nodes by address, with `packages` for package.loaded, `trace` and `now`.
function net.new(nodes)
  local self = { nodes = nodes, trace = {}, now = 0, sockets = {} }
  self.packages = { socket = {
    tcp = function()
      local socket = setmetatable({ net = self, replies = "" }, Socket)
      self.sockets[#self.sockets + 1] = socket
      return socket
    end,
    gettime = function() return self.now end,
    sleep = function(seconds)
      self.now = self.now + seconds
      self.trace[#self.trace + 1] = ("sleep %g"):format(seconds)
    end,
  } }
  return self
end

return net
