--- A machine that a program drives: pages watch it, and may do what its program allows.
--
-- @module rfsm.web.hosted
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local clock = require "rfsm.clock"
local Live = require "rfsm.web.live"

local setmetatable, huge = setmetatable, math.huge

--- A machine that a program drives.
---@class rfsm.web.Hosted
---@field view rfsm.web.Live
---@field title string
---@field problems string[]
---@field generation integer
---@field commands table<string, function>
---@field has_history boolean it is watched also while no page is open
---@field is_watched boolean
local Hosted = {}
Hosted.__index = Hosted

local COMMANDS = {}

function COMMANDS.send(hosted, message)
  local event, problem = hosted.view:event_of(message)
  if problem then return problem end
  rfsm.send_events(hosted.view.fsm, event)
  hosted.view:touch()
end

function COMMANDS.why(hosted) return nil, hosted.view:why() end

--- Turn the notes of what the machine does on or off.
function Hosted:watch(is_wanted)
  self.is_watched = is_wanted or self.has_history
  self.view:watch(self.is_watched)
end

function Hosted:close() self.view:close() end

--- Note the events that did nothing, once the machine has taken them.
function Hosted:poll()
  local view = self.view
  if view.lost[1] ~= nil and view.fsm._intq[1] == nil then view:settle() end
end

function Hosted.wait() return huge end

function Hosted:describe(message) message.clock = self.view.clock() end

--- Show a machine.
function Hosted.new(fsm, title, settings)
  local hosted = setmetatable({ view = Live.new(fsm, clock.from_now()), title = title,
    problems = {}, generation = 1, has_history = settings.history, is_watched = false,
    commands = { inspect = Live.answer_inspect,
      send = settings.allow_send and COMMANDS.send or nil,
      why = settings.allow_why and COMMANDS.why or nil } }, Hosted)
  if settings.history then hosted:watch(true) end
  return hosted
end

return Hosted
