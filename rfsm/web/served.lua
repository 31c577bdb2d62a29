--- A machine that a program drives: pages watch it, and may do what its program allows.
--
-- @module rfsm.web.served
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local clock = require "rfsm.clock"
local LocalView = require "rfsm.web.local_view"

local setmetatable, huge = setmetatable, math.huge

--- A machine that a program drives.
---@class rfsm.web.Served
---@field view rfsm.web.LocalView
---@field title string the title of the tab
---@field problems string[] always empty, since the machine runs
---@field generation integer always 1, since the chart stays the same
---@field commands table<string, function> name of a page's command -> its function
---@field has_history boolean is the machine observed also while no page is open?
---@field seen_at number the time at which a page last read the machine
local Served = {}
Served.__index = Served

local COMMANDS = {}

function COMMANDS.send(served, message)
  local event, problem = served.view:event_of(message)
  if problem then return problem end
  rfsm.send_events(served.view.fsm, event)
  served.view:touch()
end

function COMMANDS.why(served) return nil, served.view:why() end

--- Start or stop observing the machine. With `history` it is always observed.
function Served:observe(is_wanted)
  self.view:observe(is_wanted or self.has_history)
end

function Served:close() self.view:close() end

--- Note the events that took no transition, once the queue is empty.
function Served:poll()
  local view = self.view
  if view.lost[1] ~= nil and view.fsm._intq[1] == nil then view:settle() end
end

function Served.wait() return huge end

function Served:describe(message) message.clock = self.view.clock() end

--- Make a tab of the web page for a machine.
function Served.new(fsm, title, settings)
  local served = setmetatable({
    view = LocalView.new(fsm, clock.from_now()), title = title, problems = {},
    generation = 1, has_history = settings.history, seen_at = 0,
    commands = { inspect = LocalView.answer_inspect,
      send = settings.allow_send and COMMANDS.send or nil,
      why = settings.allow_why and COMMANDS.why or nil } }, Served)
  served:observe(false)
  return served
end

return Served
