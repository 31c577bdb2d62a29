--- A chart that the page drives: inputs, a clock of its own, back by replay.
--
-- All that comes from outside (an event, a step) is an input with its time. To go back,
-- the chart is loaded anew and the inputs are repeated, but the last ones; callbacks
-- run again. When the file has changed, it is loaded anew and all inputs are repeated.
-- What the chart prints goes to the log of the page.
--
-- @module rfsm.web.session
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local chart = require "rfsm.chart"
local clock = require "rfsm.clock"
local View = require "rfsm.web.view"

local io, ipairs, package, pcall = io, ipairs, package, pcall
local rawget, rawset, select, setmetatable = rawget, rawset, select, setmetatable
local type = type
local ceil, floor, huge, max, min = math.ceil, math.floor, math.huge, math.max, math.min
local concat = table.concat

local MAX_STEPS = 1000 -- of one run
local MAX_INPUTS = 20000 -- that can be repeated
local LOOK_TIME = 0.5 -- seconds between two looks at the file
local TICK = 1e-6 -- seconds are rounded up to these

--- A chart and where it stands.
---@class rfsm.web.Session
---@field file string
---@field view rfsm.web.View|false false while the chart has a mistake
---@field problems string[] those of the chart; empty if it runs
---@field generation integer counts the charts that a page has to draw
---@field inputs table[] each { act, at = seconds, turn }
---@field turn integer the commands so far; `back` undoes one
---@field now number seconds since the machine began, as the chart reads them
---@field is_live boolean does the clock go on by itself?
local Session = {}
Session.__index = Session

-- Load: a chart becomes a machine, or a list of problems ----------------------------

local function line_of(...)
  local texts = {}
  for i = 1, select("#", ...) do texts[i] = rfsm.text_of((select(i, ...))) end
  return concat(texts, "\t")
end

-- Adds an entry to the log, also before there is one.
local function tell(session, kind, text)
  if session.view then return session.view:note(kind, text) end
  session.early[#session.early + 1] = { kind, text }
end

-- Calls f(session, ...) while `print` goes to the log; a failure goes there, too.
local function guarded(session, f, ...)
  local real = rawget(_G, "print")
  rawset(_G, "print", function(...) tell(session, "output", line_of(...)) end)
  local ok, result = pcall(f, session, ...)
  rawset(_G, "print", real)
  if ok then return result end
  tell(session, "error", chart.first_line(result))
end

local function init(session, model)
  local own_warn = model.warn
  if model.err == nil then model.err = false end
  if model.info == nil then model.info = false end
  if own_warn == nil then
    model.warn = function(...) tell(session, "warning", (line_of(...):gsub("^WARNING: ", "")))
    end
  end
  local fsm, problems = rfsm.init(model)
  if fsm and own_warn == nil then fsm.warn = false end -- the view hears it anyway
  return fsm, problems
end

-- Returns a machine; false and the lines that say why not.
local function load_machine(session)
  local model, warnings = chart.load(session.file)
  if not model then return false, { warnings } end
  for _, line in ipairs(warnings) do tell(session, "warning", line) end
  local ok, fsm, problems = pcall(init, session, model)
  if not ok then return false, { chart.reason(session.file, fsm) } end
  if fsm then return fsm, {} end
  for i, problem in ipairs(problems) do
    problems[i] = chart.line(session.file, problem)
  end
  return false, problems
end

local function read(file)
  local handle = io.open(file, "rb")
  local text = handle and handle:read("*a") or ""
  if handle then handle:close() end
  return text
end

local function load(session)
  session.text, session.view, session.early = read(session.file), false, {}
  clock.set_hook(session.gettime)
  local fsm, problems = load_machine(session)
  session.problems = problems or { session.file .. ": it cannot be loaded" }
  if not fsm then return end
  session.view = View.new(fsm, function() return session.now end)
  for _, entry in ipairs(session.early) do session.view:note(entry[1], entry[2]) end
end

-- Inputs ---------------------------------------------------------------------------

local ACTS = {}

function ACTS.send(session, input)
  local event = input.event
  if type(event) == "number" then event = session.view.outline.values[event + 1] end
  if event ~= nil then rfsm.send_events(session.view.fsm, event) end
end

function ACTS.step(session) return rfsm.step(session.view.fsm) end

-- The time stands still while an input is carried out, so that it can be repeated.
local function carry_out(session, input)
  session.now, session.view.turn = max(session.now, input.at), input.turn
  clock.set_hook(session.gettime)
  return guarded(session, ACTS[input.act], input)
end

local function take_input(session, act, event)
  local input = { act = act, at = session.now, turn = session.turn, event = event }
  if #session.inputs < MAX_INPUTS then
    session.inputs[#session.inputs + 1] = input
  end
  return carry_out(session, input)
end

-- Steps until the machine is idle, or too long.
local function run(session)
  for _ = 1, MAX_STEPS do
    local is_idle = take_input(session, "step")
    if is_idle == nil then return end
    if is_idle then return session.view:settle() end
  end
  session.view:note("note", ("not idle after %d steps"):format(MAX_STEPS))
end

-- Loads the chart anew, and repeats the inputs up to a turn.
local function rebuild(session, turn)
  local inputs = session.inputs
  session.inputs, session.now, session.turn = {}, 0, 0
  session.generation = session.generation + 1
  guarded(session, load)
  for i, input in ipairs(inputs) do
    if input.turn > turn then break end
    session.inputs[i], session.turn = input, input.turn
    if session.view then carry_out(session, input) end
  end
  if session.view and not inputs[1] then run(session) end
  if session.view then session.view:settle() end
  session.since = session.real() - session.now
end

local function begin_turn(session)
  if session.is_live then
    session.now = max(session.now, ceil((session.real() - session.since) / TICK) * TICK)
  end
  session.turn = session.turn + 1
end

-- Commands of the page ------------------------------------------------------------

--- What a page may ask for; each returns nothing, or why not.
Session.commands = {}
local commands = Session.commands

local function is_seconds(x) return type(x) == "number" and x >= 0 and x < 1e9 end

function commands.send(session, message)
  local event = message.event
  local known = type(event) == "number" and session.view.outline.values[event + 1]
  if type(event) ~= "string" and not known then
    return "event: text or number of an event expected"
  end
  if type(known) == "string" then event = known end -- numbers change with the chart
  begin_turn(session)
  take_input(session, "send", event)
  if message.run then run(session) end
end

function commands.step(session)
  begin_turn(session)
  if take_input(session, "step") then session.view:settle() end
end

function commands.run(session)
  begin_turn(session)
  run(session)
end

function commands.back(session, message)
  if #session.inputs >= MAX_INPUTS then return "there is too much to repeat" end
  local to = message.to or session.turn - 1
  if type(to) ~= "number" then return "to: number expected" end
  rebuild(session, to)
end

function commands.reset(session) rebuild(session, 0) end

function commands.clock(session, message)
  begin_turn(session)
  session.is_live = message.live == true
  session.since = session.real() - session.now
end

-- Lets time pass, then runs.
local function pass(session, seconds)
  begin_turn(session)
  session.now = session.now + seconds
  session.since = session.real() - session.now
  run(session)
end

function commands.wait(session, message)
  if not is_seconds(message.seconds) then return "seconds: number expected" end
  pass(session, message.seconds)
end

-- Seconds to the next timer of the chart; nil if there is none.
local function next_timer(session)
  local timeevent = package.loaded.rfsm_timeevent
  if not (timeevent and session.view) then return nil end
  clock.set_hook(session.gettime)
  local ok, seconds = pcall(timeevent.next_deadline, session.view.fsm)
  return ok and seconds or nil
end

function commands.next(session)
  local seconds = next_timer(session)
  if not seconds then return "no timer runs" end
  pass(session, ceil(seconds / TICK) * TICK)
end

-- What goes on by itself -------------------------------------------------------------

-- Seconds until the next timer is due by the clock on the wall.
local function time_left(session)
  local seconds = session.is_live and next_timer(session)
  return seconds and session.now + seconds + TICK - (session.real() - session.since)
end

--- Do what is due: a timer, a look at the file.
function Session:poll()
  local left = time_left(self)
  if left and left <= 0 then
    begin_turn(self)
    run(self)
  end
  if self.real() < self.look_at then return end
  self.look_at = self.real() + LOOK_TIME
  if read(self.file) ~= self.text then rebuild(self, huge) end
end

--- Return the seconds until `poll` has something to do.
---@return number
function Session:wait()
  return max(0, min(self.look_at - self.real(), time_left(self) or huge))
end

--- Add what the page shows of a session to a message.
---@param message table
function Session:describe(message)
  message.clock, message.live = self.now, self.is_live
  message.timer = next_timer(self) or false
  message.can_back = self.turn > 0 and #self.inputs < MAX_INPUTS
end

--- Open a chart, also one with mistakes.
---@param file string
---@param real fun(): number seconds of the wall's clock
---@return rfsm.web.Session session
function Session.open(file, real)
  local session = setmetatable({
    file = file, title = file:match("[^/]+$"), real = real, view = false, problems = {},
    generation = 0, inputs = {}, turn = 0, now = 0, since = real(), is_live = true,
    look_at = real() + LOOK_TIME, text = "", early = {},
  }, Session)
  function session.gettime()
    local sec = floor(session.now)
    return sec, floor((session.now - sec) * 1e9 + 0.5)
  end
  rebuild(session, 0)
  return session
end

return Session
