--- Methods of the clients of both servers, Redis and PostgreSQL. Each method calls a
-- function of `rfsm.server.functions` for a machine. Events are sent with an id, so
-- that they are applied only once if a client sends them again.
--
-- @submodule rfsm.fleet
-- @license BSD-3-Clause

local files = require "rfsm.shared.files"
local codec = require "rfsm.server.codec"
local opts = require "rfsm.shared.options"
local rfsm = require "rfsm"
local try = require("rfsm.shared.calls").try

local error, ipairs, os, select = error, ipairs, os, select
local rawget, tostring, type = rawget, tostring, type
local insert = table.insert
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

--- The part of a client that `rfsm.fleet` and `rfsm.postgres` have in common.
---@class rfsm.server.Client
---@field where string name of its module, for messages
---@field id string the beginning of all ids that the client makes
---@field count integer number of ids that the client has made
---@field ask fun(self, name: string, id: any, ...: any): any, string? calls a function
--- for a machine; returns the reply, or nil and the problem
local Client = {}

--- The reply to a call for a machine.
---@class rfsm.server.Reply
---@field leaf string FQN of the active leaf
---@field mode string mode of the active leaf
---@field errors string[] errors of callbacks during the call
---@field outcome string result for the events: "taken", "kept" or "dropped"; or
--- "known", if a call with this id was made before; of an operator's call what was
--- done, as it is in the history: "(set root.n: 1 -> 2) by ann"

--- Return an id that no other client has.
---@return string id
function Client.new_id()
  return files.random(5) or ("%.0f-%s"):format(os.time(), tostring({}):match("%x+$"))
end

local function next_id(self)
  self.count = self.count + 1
  return self.id .. "-" .. ("%d"):format(self.count)
end

-- Converts the list that a function has returned into a table with field names.
local function reply_of(list, problem)
  if not list then return nil, problem end
  local errors = {}
  for i = 3, #list - 1 do errors[i - 2] = list[i] end
  return { leaf = list[1], mode = list[2], errors = errors, outcome = list[#list] }
end

-- Calls a function of an operator, and tells it who that is.
local function ask_by(self, who, name, id, ...)
  local arguments = { ... }
  if who then insert(arguments, "BY") end
  insert(arguments, who)
  return self:ask(name, id, unpack(arguments))
end

--- Make a machine of a chart in the library.
---@param id any the id of the new machine
---@param chart string the name of the chart
---@param data? table values of fields that the root of the chart lists in `keep`
---@return rfsm.server.Reply? reply
---@return string? problem
function Client:create(id, chart, data)
  local ok, text = try(codec.encode, data or {})
  if not ok then return nil, self.where .. ".create: data: " .. text end
  return reply_of(self:ask("rfsm_create", id, chart, text, "ID", next_id(self)))
end

-- Calls a function that takes events. The events are inserted from position `at` on. A
-- table is an event with data, and is sent as JSON.
local function ask_with(self, name, id, arguments, at, ...)
  for i = 1, select("#", ...) do
    local event = select(i, ...)
    local ok, text = true, event ~= nil and rfsm.text_of(event)
    if type(event) == "table" then ok, text = try(codec.encode, event) end
    if not ok then return nil, ("%s: event %d: %s"):format(self.where, i, text) end
    if text then
      insert(arguments, at, text)
      at = at + 1
    end
  end
  return self:ask(name, id, unpack(arguments))
end

-- An error blames the caller of the method, so this is not called as a tail call.
local function send_later(self, where, ticket, id, seconds, ...)
  if not opts.is_seconds(seconds) then
    error(self.where .. "." .. where .. ": seconds expected, " .. opts.got(seconds), 3)
  end
  local time = "+" .. rfsm.number_text(seconds, "%.6f")
  local reply, problem = ask_with(self, "rfsm_send_at", id, { time, "ID", ticket },
    2, ...)
  return reply and ticket, problem
end

--- Send events to a machine, and run it. The events are applied only once, even if they
-- must be sent again because the connection was lost.
---@param id any
---@param ... any events; a table with a text `name` carries data
---@return rfsm.server.Reply? reply
---@return string? problem
function Client:send(id, ...) return self:send_by(nil, nil, id, ...) end

--- Send events with your own id, such as the id of a message that may arrive twice.
---@param event_id string the machine applies events with this id only once
---@param id any id of the machine
---@param ... any events
---@return rfsm.server.Reply? reply
---@return string? problem
function Client:send_once(event_id, id, ...)
  return self:send_by(nil, event_id, id, ...)
end

--- Send events, and tell the history who does it.
---@param who? string
---@param event_id? string as for `send_once`
---@param id any id of the machine
---@param ... any events
---@return rfsm.server.Reply? reply
---@return string? problem
function Client:send_by(who, event_id, id, ...)
  local own = event_id or next_id(self)
  local arguments = who and { "BY", who, "ID", own } or { "ID", own }
  return reply_of(ask_with(self, "rfsm_send", id, arguments, 1, ...))
end

--- Send the answer to an entry. It is applied only once, also if the entry comes again.
---@param entry { id: string, machine: string }
---@param ... any events
---@return rfsm.server.Reply? reply
---@return string? problem also if no transition took the events: then the entry has to
--- fail, so that it comes again
function Client:answer(entry, ...)
  local reply, problem = self:send_once(entry.id, entry.machine, ...)
  if not reply or reply.outcome ~= "dropped" then return reply, problem end
  return nil, ("%s.answer: dropped in %s"):format(self.where, reply.leaf)
end

--- Send events to a machine after a delay. They are applied when a worker wakes it.
---@param id any
---@param seconds number the delay
---@param ... any events
---@return string? ticket the argument with which `cancel` finds these events
---@return string? problem
function Client:send_after(id, seconds, ...)
  local ticket, problem = send_later(self, "send_after", next_id(self), id, seconds,
    ...)
  return ticket, problem
end

--- Send events after a delay, with your own id.
---@param event_id string the machine applies events with this id only once
---@param id any id of the machine
---@param seconds number the delay
---@param ... any events
---@return string? ticket `event_id`
---@return string? problem
function Client:send_once_after(event_id, id, seconds, ...)
  local ticket, problem = send_later(self, "send_once_after", event_id, id, seconds,
    ...)
  return ticket, problem
end

--- Cancel events of `send_after` that have not been applied yet.
---@param id any
---@param ticket string
---@return boolean? was_there true if there were events to cancel
---@return string? problem
function Client:cancel(id, ticket)
  local count, problem = self:ask("rfsm_cancel", id, ticket)
  return count and count == 1, problem
end

--- Run a machine whose timer or delayed event is due.
---@param id any
---@return rfsm.server.Reply? reply
---@return string? problem
function Client:tick(id) return reply_of(self:ask("rfsm_tick", id)) end

--- Hold a machine: its events and timers wait until `release`.
---@param id any
---@param reason? string
---@param who? string for the history, as below
---@return rfsm.server.Reply? reply
---@return string? problem
function Client:hold(id, reason, who)
  return reply_of(ask_by(self, who, "rfsm_hold", id, reason or who and ""))
end

--- Release a held machine. Events and timers that came due meanwhile run in order.
---@param id any
---@param who? string
---@return rfsm.server.Reply? reply
---@return string? problem
function Client:release(id, who)
  return reply_of(ask_by(self, who, "rfsm_release", id))
end

--- Put a machine into a leaf and start the leaf's timers. No callback runs for this.
---@param id any
---@param state string FQN
---@param who? string
---@return rfsm.server.Reply? reply
---@return string? problem
function Client:force(id, state, who)
  return reply_of(ask_by(self, who, "rfsm_force", id, state))
end

--- Remove a machine with its timers and streams.
---@param id any
---@param who? string
---@return boolean? was_there true if there was such a machine
---@return string? problem
function Client:remove(id, who)
  local count, problem = ask_by(self, who, "rfsm_remove", id)
  return count and count == 1, problem
end

--- Return a table that describes a machine.
---@param id any
---@return table? view chart, version, leaf, mode, configuration, data, queue, due;
--- held, held_since, held_because; events: kept (deferred), later, waiting (for the
--- release); ids that the machine knows
---@return string? problem
function Client:get(id)
  local list, problem = self:ask("rfsm_get", id)
  if not list then return nil, problem end
  local view = {}
  for i = 1, #list, 2 do view[list[i]] = list[i + 1] end
  for _, name in ipairs { "data", "queue", "kept", "later", "waiting", "ids" } do
    view[name] = view[name] and codec.decode(view[name]) -- an old library lacks some
  end
  view.due, view.held_since = rfsm.number_of(view.due), rfsm.number_of(view.held_since)
  return view
end

--- Return a machine as the text of a file for `push` and `rfsm.snapshot.load`.
---@param id any
---@return string? text the snapshot; in its field `fleet` the key, the name of the
--- chart, the revision, and the history, if the library keeps one
---@return string? problem
function Client:pull(id)
  local text, problem = self:ask("rfsm_pull", id)
  return type(text) == "table" and text[1] or text, problem
end

--- Put the machine of a file of `pull` back. Its timers have gone on meanwhile; those
-- in a file that the simulator has saved go on from now.
---@param id any
---@param text string
---@param revision? integer that of the machine; default: that in the file
---@param who? string
---@return rfsm.server.Reply? reply
---@return string? problem also if the machine has moved on meanwhile
function Client:push(id, text, revision, who)
  local number = revision and ("%.0f"):format(revision) or ""
  return reply_of(ask_by(self, who, "rfsm_push", id, text, number))
end

--- Give a field that a state keeps another value.
---@param id any
---@param field string its path, such as root.on.count; without a path one of the root
---@param value any of the kind that the field has in a new machine, or now
---@param who? string
---@param force? boolean take a value of another kind
---@return rfsm.server.Reply? reply
---@return string? problem
function Client:set(id, field, value, who, force)
  local ok, text = true, ""
  if value ~= nil then ok, text = try(codec.encode, { value }) end
  if not ok then return nil, self.where .. ".set: value: " .. text end
  return reply_of(ask_by(self, who, "rfsm_set", id, field, text:sub(2, -2),
    force and "force" or nil))
end

--- Move a machine to the newest version of its chart, without running it.
---@param id any
---@param who? string
---@return rfsm.server.Reply? reply
---@return string? problem also if it does not fit that version
function Client:move(id, who) return reply_of(ask_by(self, who, "rfsm_move", id)) end

--- Explain which transitions an event would trigger in a machine, and why not others.
---@param id any
---@param event any
---@return string[]? lines one for each transition
---@return string? problem
function Client:why(id, event)
  if type(event) == "table" then event = codec.encode(event) end
  return self:ask("rfsm_why", id, event)
end

return Client
