--- The view of a machine that runs elsewhere, as `rfsm.proto` describes it.
--
-- @module rfsm.web.remote
-- @license BSD-3-Clause

local dot = require "rfsm.dot"
local View = require "rfsm.web.view"
local subscriber = require "rfsm.proto.subscriber"

local ipairs, setmetatable = ipairs, setmetatable

local MAX_MESSAGES = 100 -- that are taken at a time
local WAIT = 0.02 -- seconds until the socket is looked at again

--- The machine as it was last described.
---@class rfsm.web.RemoteView : rfsm.web.View
---@field leaf string|false
---@field mode string
local RemoteView = setmetatable({}, { __index = View })
RemoteView.__index = RemoteView

-- Numbers of the states from the root to the active one.
local function active_numbers(view)
  local numbers, number = {}, view.outline.number_of[view.leaf]
  while number do
    table.insert(numbers, 1, number)
    number = view.outline.nodes[number + 1].parent
  end
  return numbers
end

function RemoteView:now()
  return { active = active_numbers(self), leaf = self.leaf, mode = self.mode,
    queue = {} }
end

local function take_state(view, message)
  local leaf = message.act_leaf or false
  if leaf == view.leaf and message.act_leaf_state == view.mode then return end
  if leaf ~= view.leaf then view:note("step", leaf or "not active") end
  view.leaf, view.mode = leaf, message.act_leaf_state or "inactive"
  for _, number in ipairs(active_numbers(view)) do view:see_node(number) end
  view:touch()
end

--- A connection that a page watches.
---@class rfsm.web.Remote
---@field view rfsm.web.RemoteView|false false before the machine is described
---@field problems string[]
local Remote = { commands = {} }
Remote.__index = Remote

function Remote.commands.send(remote, message)
  local event = remote.view:event_of(message)
  if event == nil then return "event: text or number of an event expected" end
  remote.client:send { type = "event", event = event, fsm = remote.number }
end

local TAKE = {}

function TAKE.rfsm_model(remote, message)
  dot.encode(message.graph) -- raises an error for a graph that is none
  remote.generation, remote.problems = remote.generation + 1, {}
  remote.view = View.create(RemoteView, message.graph, remote.clock)
  remote.view.leaf, remote.view.mode = false, "inactive"
end

function TAKE.rfsm_active_state(remote, message)
  if remote.view then take_state(remote.view, message) end
end

function TAKE.rfsm_error(remote, message)
  if remote.view then remote.view:note("error", message.text) end
end

local function refuse(remote, problem)
  if remote.view then return remote.view:note("error", problem) end
  remote.generation = remote.generation + 1
  remote.problems = { remote.title .. ": " .. problem }
end

--- Take the messages that have come.
function Remote:poll()
  for _ = 1, MAX_MESSAGES do
    local message = self.client:receive(0)
    if not message then break end
    local problem = subscriber.handle(TAKE, self, message)
    if problem then refuse(self, problem) end
  end
  if self.view and self.is_heard ~= self.client.is_heard then
    self.is_heard = self.client.is_heard
    self.view:note("note", self.is_heard and "the machine answers" or "no answer")
  end
end

function Remote.wait() return WAIT end

function Remote:describe(message) message.clock = self.clock() end

--- Watch a machine elsewhere.
---@param host string
---@param port integer
---@param clock fun(): number seconds, for the log
---@return rfsm.web.Remote? remote
---@return string? problem in one line
function Remote.open(host, port, clock)
  local client, problem = subscriber.connect(host, port)
  if not client then return nil, problem end
  local title = ("%s:%d"):format(host, port)
  return setmetatable({
    client = client, title = title, number = 1, generation = 0, view = false,
    problems = { title .. ": no machine has answered yet" }, is_heard = false,
    clock = clock,
  }, Remote)
end

return Remote
