--- The view of a machine in another program, made from the messages that `rfsm.proto`
-- in that program sends.
--
-- @module rfsm.web.remote
-- @license BSD-3-Clause

local clock = require "rfsm.clock"
local View = require "rfsm.web.view"
local subscriber = require "rfsm.observe.subscriber"

local ipairs, setmetatable, type = ipairs, setmetatable, type

-- Behind the FQN of a node in the path that a message names: "root.a[LS]->root.b[LS]".
local MARKS = { leaf = "[LS]", composite = "[CS]" }
local MAX_MESSAGES = 100 -- greatest number of messages that one poll reads
local MAX_MACHINES = 100 -- greatest number of machines of a port that are shown
local WAIT = 0.02 -- seconds between two polls of the socket

--- The machine as the last message describes it.
---@class rfsm.web.RemoteView : rfsm.web.View
---@field leaf string|false FQN of the active leaf; false: none is active
---@field mode string mode of the leaf
local RemoteView = setmetatable({}, { __index = View })
RemoteView.__index = RemoteView

-- Returns the numbers of the states from the root down to the active leaf.
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

local function mark_of(node) return node.fqn .. (MARKS[node.kind] or "[c]") end

-- Returns the numbers of the transitions, by their ends as messages write them:
-- "root.a[LS]->root.b[LS]".
local function edges_by_ends(view)
  local by_ends, nodes = {}, view.outline.nodes
  for number, edge in ipairs(view.outline.edges) do
    if edge.src and edge.tgt then
      local ends = mark_of(nodes[edge.src + 1]) .. "->" .. mark_of(nodes[edge.tgt + 1])
      by_ends[ends] = by_ends[ends] or number - 1
    end
  end
  return by_ends
end

-- Notes that the transitions on a path were taken; returns the path as a text to show.
local function take_path(view, path)
  view.by_ends = view.by_ends or edges_by_ends(view)
  local before
  for node in (path .. "->"):gmatch("(.-%[%a+%])%->") do
    if before then view:see_edge(view.by_ends[before .. "->" .. node]) end
    before = node
  end
  return (path:gsub("%[%a+%]", ""):gsub("%->", " \226\134\146 "))
end

local function text_of_leaf(leaf) return leaf or "not active" end

local function take_state(view, message)
  local leaf = message.act_leaf or false
  local path = type(message.path) == "string" and message.path
  local has_moved = leaf ~= view.leaf
  if not (has_moved or path) and message.act_leaf_state == view.mode then return end
  local text = path and take_path(view, path) or has_moved and text_of_leaf(leaf)
  view.leaf, view.mode = leaf, message.act_leaf_state or "inactive"
  if text then view:note("step", text, nil, view:moment()) end
  view:touch()
end

--- A machine in another program. The machines of a port share a client; only the first
--- machine of a port reads from the client.
---@class rfsm.web.Remote
---@field number integer number of the machine at the port
---@field view rfsm.web.RemoteView|false false before the machine is described
---@field problems string[] texts that the page shows in place of the machine
---@field all rfsm.web.Remote[] the machines of the port
---@field is_only boolean? true in the first machine if it alone is shown
local Remote = { commands = {} }
Remote.__index = Remote

function Remote.commands.send(remote, message)
  local event, problem = remote.view:event_of(message)
  if problem then return problem end
  remote.client:send { type = "event", event = event, fsm = remote.number }
end

local TAKE = {}

function TAKE.rfsm_model(remote, message)
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

local function add_remote(all, client, clock_of_page, number)
  local title = client.address
  if number then title = title .. ", machine " .. ("%d"):format(number) end
  all[#all + 1] = setmetatable({
    client = client, title = title, number = number or 1, generation = 0, view = false,
    problems = { title .. ": no machine has answered yet" }, is_heard = false,
    clock = clock_of_page, all = all,
  }, Remote)
  return all[#all]
end

-- Returns the machine that sent a message; a new one if the message is its first; nil
-- if the machine is not shown.
local function remote_of(first, message)
  local number = message.fsm
  if number == nil or first.number == number then return first end
  if first.is_only then return nil end
  for _, remote in ipairs(first.all) do
    if remote.number == number then return remote end
  end
  if message.type ~= "rfsm_model" or #first.all >= MAX_MACHINES then return nil end
  return add_remote(first.all, first.client, first.clock, number)
end

local function take(first, message)
  local remote = remote_of(first, message)
  local problem = remote and subscriber.handle(TAKE, remote, message)
  if problem then refuse(remote, problem) end
end

--- Read the messages that have come from all machines of the port.
function Remote:poll()
  if self ~= self.all[1] then return end
  for _ = 1, MAX_MESSAGES do
    local message = self.client:receive(0)
    if not message then break end
    take(self, message)
  end
  for _, remote in ipairs(self.all) do
    if remote.view and remote.is_heard ~= self.client.is_heard then
      remote.is_heard = self.client.is_heard
      remote.view:note("note", remote.is_heard and "the machine answers" or "no answer")
    end
  end
end

function Remote.wait() return WAIT end

function Remote:describe(message) message.clock = self.clock() end

--- Return a list of the machines of a port, or only of the machine with a given number.
-- The list grows when another machine answers. If the port cannot be reached, return
-- nil and the problem.
function Remote.open(host, port, number)
  local client, problem = subscriber.connect(host, port, true)
  if not client then return nil, problem end
  local all = {}
  add_remote(all, client, clock.from_now(), number).is_only = number ~= nil
  return all
end

return Remote
