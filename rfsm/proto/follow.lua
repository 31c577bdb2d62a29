--- Prints a machine that answers by `rfsm.proto`, for `rfsm watch`: at a terminal the
-- tree of its states and a log, in a pipe a line for each change.
--
-- @module rfsm.proto.follow
-- @license BSD-3-Clause

local subscriber = require "rfsm.observe.subscriber"

local io, ipairs, os, select = io, ipairs, os, select
local concat, remove = table.concat, table.remove

local follow = {}

local MAX_LOG = 10 -- lines

-- Appends a line for each state in a node of the graph. Active states have a star.
local function add_tree(lines, node, fqn, leaf)
  if node.type ~= "state" then return lines end
  local is_active = leaf and (leaf .. "."):sub(1, #fqn + 1) == fqn .. "."
  local indent = ("  "):rep(select(2, fqn:gsub("%.", "")))
  lines[#lines + 1] = (is_active and "* " or "  ") .. indent .. node.id
  for _, sub in ipairs(node.subnodes or {}) do
    add_tree(lines, sub, fqn .. "." .. sub.id, leaf)
  end
  return lines
end

--- A remote machine, as far as it is known from messages.
---@class rfsm.proto.Follower
---@field graph table? the description of the machine, once it was received
---@field leaf string|false|nil FQN of the active leaf; nil or false: none is known
---@field log string[] the last lines of the log
---@field count integer number of all lines so far, also of those that were removed

-- Adds a line to the log, unless it equals the last line.
local function add(self, text)
  if text == self.last then return end
  self.last, self.count = text, self.count + 1
  self.log[#self.log + 1] = os.date("%H:%M:%S ") .. text
  if #self.log > MAX_LOG then remove(self.log, 1) end
  if not self.is_terminal then print(text) end
end

local TAKE = {}

function TAKE.rfsm_model(self, message) self.graph = message.graph end

function TAKE.rfsm_error(self, message) add(self, "refused: " .. message.text) end

function TAKE.rfsm_active_state(self, message)
  local leaf = message.act_leaf
  add(self, leaf and leaf .. " (" .. message.act_leaf_state .. ")" or "not active")
  self.leaf = leaf
end

local function draw(self)
  local tree = self.graph and add_tree({}, self.graph, "root", self.leaf) or {}
  local status = self.status ~= "" and "\n" .. self.status or ""
  print("\27[H\27[J" .. concat(tree, "\n") .. "\n\n" .. concat(self.log, "\n")
    .. status)
end

local SILENCE = 3 -- seconds without a message that are reported

-- Reports that no message comes: at a terminal below each tree, in a pipe once.
local function note_silence(self, client)
  local seconds = client.clock() - (self.heard_at or self.began_at)
  self.status = ""
  if seconds < SILENCE and self.heard_at then return end
  self.status = self.heard_at and ("no answer since %d s"):format(seconds)
    or "waiting for " .. client.address
  if self.is_terminal or self.said_at then return end
  self.said_at = true
  io.stderr:write(self.status, "\n")
end

--- Print a machine as it changes, until `options.count` lines were printed.
function follow.run(client, options)
  local self = {
    log = {}, count = 0, is_terminal = options.is_terminal, number = options.number,
    status = "", heard_at = false, said_at = false, began_at = client.clock(),
  }
  while self.count < (options.count or 1 / 0) do
    local message = client:receive(1)
    local problem = message and subscriber.handle(TAKE, self, message)
    if problem then add(self, problem) end
    if message then
      self.heard_at, self.said_at, self.status = client.clock(), false, ""
    else
      note_silence(self, client)
    end
    if self.is_terminal then draw(self) end
  end
end

return follow
