--- A fleet of machines in Redis: the client.
--
-- The machines live in a server that has loaded a library of `rfsm.redis`. The client
-- names their keys, so that machines spread over the slots of a cluster, follows slots
-- that have moved, wakes machines that are due, and reads what they emitted. Needs the
-- packages lua-redis and dkjson.
--
-- The file reads in this order: connections, calls, machines, workers.
--
-- @module rfsm.fleet
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local opts = require "rfsm.shared.options"
local rfsm = require "rfsm"

local error, ipairs, pcall, rawget = error, ipairs, calls.try, rawget
local rawset, setmetatable = rawset, setmetatable
local tonumber, tostring, type = tonumber, tostring, type

local fleet = {}

local function need(name) return opts.need("rfsm.fleet", name, "lua-" .. name) end

-- Connections --------------------------------------------------------------------

--- A connection to a fleet.
---@class rfsm.fleet.Fleet
---@field name string of the machines, in front of their keys
---@field tags integer over how many hash tags they spread
---@field nodes table<string, table> connections by address
---@field node_of table<string, table> connections by hash tag
---@field first table
local Fleet = {}
Fleet.__index = Fleet

local commands = {}

-- Sends a command; raises the error of the server without a position.
local function command(client, name, ...)
  commands[name] = commands[name] or need("redis").command(name)
  local ok, reply = pcall(commands[name], client, ...)
  if ok then return reply end
  reply = tostring(reply):gsub("^.-redis error: ", "")
  error((reply:gsub("^%S+redis%.lua:%d+: ", "")), 0)
end

local function node(self, host, port)
  local address = host .. ":" .. port
  if not self.nodes[address] then
    local ok, client = pcall(need("redis").connect, host, tonumber(port))
    if not ok then error("rfsm.fleet: cannot connect to " .. address, 0) end
    self.nodes[address] = client
  end
  return self.nodes[address], address
end

--- Connect to a server, or to any node of a cluster.
--
-- @usage
--    local robots = fleet.connect("redis://localhost:6379", { name = "robot" })
--
-- @raise if there is no server
---@param url? string default redis://127.0.0.1:6379
---@param options? { name: string?, tags: integer? } `tags`: 64
---@return rfsm.fleet.Fleet fleet
function fleet.connect(url, options)
  options = options or {}
  local host, port = (url or "redis://127.0.0.1"):match("^redis://([^:/]+):?(%d*)/?$")
  if not host then
    error("rfsm.fleet.connect: redis://HOST:PORT expected, got '" .. url .. "'", 2)
  end
  local self = setmetatable({ name = options.name or "machine",
    tags = options.tags or 64, nodes = {}, node_of = {}, first = false }, Fleet)
  self.first = node(self, host, port == "" and "6379" or port)
  return self
end

local MAX_TRIES = 600 -- each waits a hundredth of a second while a slot moves

-- Returns the node to try next after an error, and whether it is asked once only.
local function redirected(self, tag, text)
  local kind, host, port = text:match("^(%u+) %d+ ([^:]+):(%d+)$")
  if kind == "MOVED" then
    self.node_of[tag] = node(self, host, port)
    return self.node_of[tag], false
  elseif kind == "ASK" then
    return node(self, host, port), true
  elseif text:find("^TRYAGAIN") or text:find("^CLUSTERDOWN") then
    need("socket").sleep(0.01)
    return self.node_of[tag] or self.first, false
  end
end

--- Send a command to the node that has the keys of a hash tag.
-- @raise the error of the server
---@param tag string
---@param name string
---@param ... any
---@return any reply
function Fleet:call(tag, name, ...)
  local client, is_asked = self.node_of[tag] or self.first, false
  for _ = 1, MAX_TRIES do
    if is_asked then command(client, "ASKING") end
    local ok, reply = pcall(command, client, name, ...)
    if ok then return reply end
    client, is_asked = redirected(self, tag, reply)
    if not client then error(reply, 0) end
  end
  error("rfsm.fleet: the slot of {" .. tag .. "} does not come to rest", 0)
end

-- Calls: keys and replies ---------------------------------------------------------

--- Return the key of a machine; one with a hash tag in braces is a key already.
---@param id any
---@return string key
---@return string tag
function Fleet:key_of(id)
  id = rfsm.text_of(id)
  local tag, hash = id:match("{([^}]+)}"), 7
  if tag then return id, tag end
  for i = 1, #id do hash = (hash * 31 + id:byte(i)) % 16777213 end
  tag = ("%d"):format(hash % self.tags)
  return self.name .. ":{" .. tag .. "}:" .. id, tag
end

-- Calls a function; a cluster must know all keys that it writes.
local function call_function(self, name, id, ...)
  local key, tag = self:key_of(id)
  return pcall(self.call, self, tag, "FCALL", name, 4, key, "rfsm:due:{" .. tag .. "}",
    "rfsm:out:{" .. tag .. "}", key .. ":log", ...)
end

--- Where a machine stands after a call.
---@class rfsm.fleet.Reply
---@field leaf string FQN
---@field mode string
---@field errors string[] of its callbacks

local function reply_of(ok, list)
  if not ok then return nil, list end
  if not list then return nil, "no machine" end
  local errors = {}
  for i = 3, #list do errors[i - 2] = list[i] end
  return { leaf = list[1], mode = list[2], errors = errors }
end

-- Machines -----------------------------------------------------------------------

--- Make a machine.
---@param id any
---@param chart string its name in the library
---@param data? table fields that the root of the chart keeps
---@return rfsm.fleet.Reply? reply
---@return string? problem
function Fleet:create(id, chart, data)
  local text = data and need("dkjson").encode(data)
  return reply_of(call_function(self, "rfsm_create", id, chart, text))
end

--- Send events to a machine, and run it.
---@param id any
---@param ... any events
---@return rfsm.fleet.Reply? reply
---@return string? problem
function Fleet:send(id, ...)
  return reply_of(call_function(self, "rfsm_send", id, ...))
end

--- Run a machine that is due.
---@param id any
---@return rfsm.fleet.Reply? reply
---@return string? problem
function Fleet:tick(id) return reply_of(call_function(self, "rfsm_tick", id)) end

--- Look at a machine.
---@param id any
---@return table? view chart, version, leaf, mode, configuration, data, queue, due
---@return string? problem
function Fleet:get(id)
  local ok, list = call_function(self, "rfsm_get", id)
  if not ok then return nil, list end
  local view, decode = {}, need("dkjson").decode
  for i = 1, #list, 2 do view[list[i]] = list[i + 1] end
  view.data, view.queue, view.due = decode(view.data), decode(view.queue),
    tonumber(view.due)
  return view
end

--- Ask what an event would do to a machine.
---@param id any
---@param event any
---@return string[]? lines
---@return string? problem
function Fleet:why(id, event)
  local ok, lines = call_function(self, "rfsm_why", id, event)
  if ok then return lines end
  return nil, lines
end

-- Reads a list of texts that the server sends without being asked.
local function read_list(client)
  local read, list = client.network.read, {}
  for i = 1, tonumber(read(client):match("^[*>](%d+)")) do
    local size = read(client):match("^%$(%d+)")
    list[i] = size and read(client, tonumber(size) + 2):sub(1, -3) or false
  end
  return list
end

--- Call `f(leaf)` each time a machine has got another active leaf, until it returns
-- true. The call does not return before.
---@param id any
---@param f fun(leaf: string): boolean?
function Fleet:watch(id, f)
  local key, tag = self:key_of(id)
  local channel = "rfsm:{" .. tag .. "}:" .. key
  self:call(tag, "EXISTS", key) -- finds the node
  local socket = (self.node_of[tag] or self.first).network.socket
  local host, port = socket:getpeername()
  local client = need("redis").connect(host, tonumber(port))
  local message = command(client, "SSUBSCRIBE", channel)
  repeat
    if message[1] == "smessage" and f(message[3]) then break end
    message = read_list(client)
  until false
  client.network.socket:close()
end

-- Workers ------------------------------------------------------------------------

--- Run the machines that are due.
---@param limit? integer at most that many of each tag (100)
---@return integer count
function Fleet:wake(limit)
  local count = 0
  for number = 0, self.tags - 1 do
    local tag = ("%d"):format(number)
    local due = self:call(tag, "FCALL", "rfsm_due", 1, "rfsm:due:{" .. tag .. "}",
      limit or 100)
    for _, key in ipairs(due) do
      self:tick(key)
      count = count + 1
    end
  end
  return count
end

-- An entry of a stream as a table.
local function entry_of(raw)
  local entry, decode = { id = raw[1] }, need("dkjson").decode
  for i = 1, #raw[2], 2 do entry[raw[2][i]] = raw[2][i + 1] end
  entry.data = entry.data and entry.data ~= "" and decode(entry.data) or nil
  return entry
end

-- Hands entries to f; those that it has done are taken out of the stream.
local function handle(self, tag, stream, group, entries, f)
  local count = 0
  for _, raw in ipairs(entries) do
    if type(raw) == "table" and type(raw[2]) == "table" then
      f(entry_of(raw))
      self:call(tag, "XACK", stream, group, raw[1])
      self:call(tag, "XDEL", stream, raw[1])
      count = count + 1
    end
  end
  return count
end

-- Returns the entries that a worker has been given and has not done for `idle` ms; the
-- group of workers is made when it is first needed.
local function claim(self, tag, stream, group, worker, idle, count)
  local ok, reply = pcall(self.call, self, tag, "XAUTOCLAIM", stream, group, worker,
    idle, "0", "COUNT", count)
  if ok then return reply[2] end
  if not reply:find("^NOGROUP") then error(reply, 0) end
  ok, reply = pcall(self.call, self, tag, "XGROUP", "CREATE", stream, group, "0",
    "MKSTREAM")
  if not ok and not reply:find("^BUSYGROUP") then error(reply, 0) end -- another's
  return {}
end

--- Hand what machines have emitted to `f(entry)`, at least once each.
--
-- An entry has `machine`, `what` and `data`. If `f` raises or the worker dies, another
-- worker of the group gets the entry, when it has been idle for some time.
--
---@param group string
---@param worker string its name, of its own
---@param f fun(entry: table)
---@param options? { count: integer?, idle: integer? } `idle`: milliseconds (30000)
---@return integer count entries that were handled
function Fleet:work(group, worker, f, options)
  options = options or {}
  local count, idle, total = options.count or 100, options.idle or 30000, 0
  for number = 0, self.tags - 1 do
    local tag = ("%d"):format(number)
    local stream = "rfsm:out:{" .. tag .. "}"
    local left = claim(self, tag, stream, group, worker, idle, count)
    total = total + handle(self, tag, stream, group, left, f)
    local new = self:call(tag, "XREADGROUP", "GROUP", group, worker, "COUNT", count,
      "STREAMS", stream, ">")
    total = total + handle(self, tag, stream, group, new and new[1][2] or {}, f)
  end
  return total
end

-- Returns the server, or the nodes of the cluster that take writes.
local function masters(self)
  local ok, text = pcall(command, self.first, "CLUSTER", "NODES")
  if not ok then return { self.first } end
  local list = {}
  for line in text:gmatch("[^\n]+") do
    local host, port = line:match("^%S+ ([^:]+):(%d+)@%S* %S*master")
    if host then list[#list + 1] = node(self, host, port) end
  end
  return list
end

--- Load a library into the server, or each node of the cluster, in place of the one
-- that is there.
---@param text string see `rfsm.redis`
---@return boolean ok
---@return string? problem
function Fleet:load(text)
  for _, client in ipairs(masters(self)) do
    local ok, problem = pcall(command, client, "FUNCTION", "LOAD", "REPLACE", text)
    if not ok then return false, problem end
  end
  return true
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_fleet", fleet) end

return fleet
