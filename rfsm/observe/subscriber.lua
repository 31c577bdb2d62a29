--- A client of `rfsm.proto`: follows the machines of a host, over UDP.
--
-- Needs the packages luasocket and dkjson.
--
-- @module rfsm.observe.subscriber
-- @license BSD-3-Clause

local dot = require "rfsm.dot"
local calls = require "rfsm.shared.calls"
local opts = require "rfsm.shared.options"

local setmetatable, type = setmetatable, type

local subscriber = {}

local BEAT = 1 -- seconds between heartbeats; a host drops a client after 3 without one

--- A client that subscribes to the machines of a host.
---@class rfsm.observe.Subscription
---@field address string
---@field clock fun(): number seconds
---@field is_heard boolean has the host answered the last subscription?
local Client = {}
Client.__index = Client

--- Send a message to the host.
function Client:send(message) self.udp:send(self.json.encode(message)) end

-- Sends what is due: a subscription, or a heartbeat if the host has answered.
local function beat(client)
  if client.clock() < client.due then return end
  client:send(client.is_heard and { type = "heartbeat" }
    or { type = "subscribe", path = client.has_path })
  client.due = client.clock() + BEAT
end

--- Return the next message; nil if no message comes within the time.
function Client:receive(seconds)
  beat(self)
  self.udp:settimeout(seconds)
  local data, problem = self.udp:receive()
  if problem == "connection refused" then self.is_heard = false end
  local message = data and self.json.decode(data)
  if type(message) ~= "table" then return nil end
  self.is_heard = message.text ~= "heartbeat: not subscribed"
  if not self.is_heard then self.due = 0 end
  return message
end

function Client:close() self.udp:close() end

--- Call `handlers[message.type](target, message)`, if there is such a handler, and if
-- the message is about the machine `target.number`. Return a problem if the message
-- cannot be read, or its graph cannot be drawn.
function subscriber.handle(handlers, target, message)
  local handler = handlers[message.type]
  if not handler or (message.fsm or target.number) ~= target.number then return nil end
  local is_drawn = message.type ~= "rfsm_model" or calls.try(dot.encode, message.graph)
  if is_drawn and calls.try(handler, target, message) then return nil end
  return "unreadable message '" .. message.type .. "'"
end

--- Return a client that subscribes to the machines of a host, or nil and the problem.
-- With `has_path`, the messages of the host have the paths that were taken, too.
function subscriber.connect(host, port, has_path)
  local socket, json = opts.find_package("socket", "dkjson")
  if not socket then return nil, json end
  local udp = (socket.udp4 or socket.udp)()
  local is_set, why = udp:setpeername(host, port)
  if not is_set then return nil, ("%s: %s"):format(host, why) end
  return setmetatable({
    udp = udp, json = json, clock = socket.gettime, due = 0, is_heard = false,
    address = ("%s:%d"):format(host, port), has_path = has_path,
  }, Client)
end

return subscriber
