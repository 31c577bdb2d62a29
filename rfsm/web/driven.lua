--- A chart that a web page drives, with a clock that the page can stop.
--
-- A turn is all that the machine does because of one command of the page, or because a
-- timer has expired. The page can go back to the beginning of each turn. If the file
-- changes it is loaded again, and the machine is put into the state that was active, if
-- the chart still has that state. The output of the chart goes to the log of the page.
--
-- The file reads in this order: load, turns, commands, timers and the file.
--
-- @module rfsm.web.driven
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local load_file = rfsm.load -- before `search` replaces it
local advice = require "rfsm.advice"
local calls = require "rfsm.shared.calls"
local chart = require "rfsm.shared.chart"
local clock = require "rfsm.clock"
local files = require "rfsm.shared.files"
local moves = require "rfsm.observe.moves"
local rewind = require "rfsm.observe.rewind"
local LocalView = require "rfsm.web.local_view"
local breakpoints = require "rfsm.observe.breakpoints"
local utf8 = require("rfsm.marsh").utf8

local ipairs, os, pcall = ipairs, os, pcall
local rawget, rawset, setmetatable = rawget, rawset, setmetatable
local text_of, type, remove = rfsm.text_of, type, table.remove
local ceil, huge, max, min = math.ceil, math.huge, math.max, math.min

local LOOK_TIME = 0.5 -- seconds between two looks whether the file has changed
local TICK = 1e-6 -- seconds; times are rounded up to multiples of it

--- A chart and its machine.
---@class rfsm.web.Driven
---@field file string
---@field view rfsm.web.LocalView|false false while the chart has a mistake
---@field problems string[] problems of the chart; empty if it runs
---@field generation integer how often the chart was loaded; a page draws each one anew
---@field way rfsm.observe.Rewind|false the earlier places; turn n + 1 begins at place n
---@field from string? the file of a machine that is not loaded yet
---@field snap table? snapshot of the last machine, while the chart has a mistake
---@field time rfsm.clock.Clock seconds since the machine began, as the chart reads them
---@field is_live boolean the clock goes on with real time
---@field points rfsm.observe.Breakpoint[] breakpoints
---@field stopped string|false the breakpoint at which the last run has ended
local Driven = { MAX_STEPS = 1000 } -- most steps of one run
Driven.__index = Driven

-- Load: a chart becomes a machine, or a list of problems ----------------------------

-- Adds an entry to the log of the view. Entries wait in `early` until there is a view.
local function tell(session, kind, text)
  if session.view then return session.view:note(kind, text) end
  session.early[#session.early + 1] = { kind, text }
end

-- Returns f(session, ...), or nil if f fails. Errors and printed lines go to the log.
local function guarded(session, f, ...)
  local real = rawget(_G, "print")
  rawset(_G, "print", function(...) tell(session, "output", calls.text("\t", ...)) end)
  local ok, result = pcall(f, session, ...)
  rawset(_G, "print", real)
  if ok then return result end
  if rfsm.is_interrupt(result) then error(result, 0) end
  tell(session, "error", chart.first_line(result))
end

local function init(session, model)
  local own_warn = model.warn
  if model.err == nil then model.err = false end
  if model.info == nil then model.info = false end
  if own_warn == nil then
    model.warn = function(...)
      tell(session, "warning", (calls.text("\t", ...):gsub("^WARNING: ", "")))
    end
  end
  local fsm, text, problems = rfsm.init(model)
  if not fsm then return fsm, text, problems end
  fsm.gettime = session.gettime
  if own_warn == nil then fsm.warn = false end -- the view listens from now on
  return fsm, text, problems
end

local function read(file) return files.read(file) or "" end

-- Turns: each is a command of the page, or a timer -----------------------------------

-- Makes the simulated time advance with real time, from its present value on.
local function start_clock(session)
  session.since = session.real() - session.time:now()
end

-- Begins a new list of places to return to. The first one is the present state.
local function start_way(session)
  local time = session.time
  session.way = rewind.new(session.view.fsm, {
    about = function() return time:now() end,
    prepare = function(now) time:advance(now - time:now()) end,
  })
end

local function begin_turn(session)
  if session.is_live then
    local now = ceil((session.real() - session.since) / TICK) * TICK
    session.time:advance(max(now - session.time:now(), 0))
  end
  session.stopped = false
  session.view:begin_turn(session.way:leave())
end

local function step(session) return rfsm.step(session.view.fsm) end

-- Steps until the machine is idle or a breakpoint is reached, MAX_STEPS at most.
local function run(session)
  local view = session.view
  for _ = 1, Driven.MAX_STEPS do
    view.hit = false
    local is_idle = guarded(session, step)
    session.stopped = view.hit
    if view.hit then return view:note("note", "stopped at " .. view.hit) end
    if is_idle == nil then return end
    if is_idle then return view:settle() end
  end
  view:note("note", ("not idle after %d steps"):format(Driven.MAX_STEPS))
end

-- Goes through the moves of the machine in a file: each is a turn. Returns the problem
-- if the file is wrong.
local function follow(session)
  local view, from = session.view, session.from
  session.from = nil
  local ok, problem = calls.try(moves.follow, view.fsm, from, function(move, unknown)
    if unknown then view:note("note", unknown) end
    view:begin_turn(session.way:leave())
    view:note("note", ("%s: %s \226\134\146 %s"):format(moves.text_of(move),
      move.from, move.to))
  end, function() start_way(session) end)
  if ok then return view:touch() end
  tell(session, "error", text_of(problem))
  return text_of(problem)
end

-- Begins with a new machine. If the chart still has the state of the snapshot, the
-- machine is put into that state; otherwise it runs from the start.
local function begin(session, fsm, snap)
  session.view = LocalView.new(fsm, function() return session.time:now() end)
  session.view.points, session.view.has_timer = session.points, true
  breakpoints.renew(session.view, function(line) tell(session, "warning", line) end)
  session.view:observe(true)
  for _, entry in ipairs(session.early) do session.view:note(entry[1], entry[2]) end
  if not (snap or session.from) or snap and rewind.carry_over(fsm, snap) then
    session.time:advance(-session.time:now())
    run(session)
  end
  start_way(session)
  session.problem = session.from and follow(session)
  start_clock(session)
end

-- Loads the chart. If `keeps_state` the machine goes on in the state of the old one. A
-- system is a problem of the session: no page would ever show it.
local function load(session, keeps_state)
  local is_system
  local snap = keeps_state and (session.way and session.way:note().snap
    or session.snap) or nil
  session.text, session.view, session.early = read(session.file), false, {}
  session.generation, session.way = session.generation + 1, false
  local fsm, problems = chart.open(session.file, function(model)
    return init(session, model)
  end, function(line) tell(session, "warning", line) end, session.has_stubs,
    function(file)
      return load_file(file, function(value) is_system = advice.of_system(value) end)
    end)
  if is_system then session.problem = problems[1] end
  session.problems, session.snap = fsm and {} or problems, not fsm and snap or nil
  if fsm then begin(session, fsm, snap) end
end

-- Commands of the page ------------------------------------------------------------

--- The commands of a page. Each returns a problem or nil, then perhaps an answer.
Driven.commands = {}
local commands = Driven.commands

function commands.send(session, message)
  local event, problem = session.view:event_of(message)
  if problem then return problem end
  begin_turn(session)
  rfsm.send_events(session.view.fsm, event)
  session.view:touch()
  if message.run then run(session) end
end

function commands.step(session)
  begin_turn(session)
  if guarded(session, step) then session.view:settle() end
end

function commands.run(session)
  begin_turn(session)
  run(session)
end

-- Undoes the turns after turn `to`. No callback is called. The clock is paused, since a
-- timer of then could run before anybody has looked.
function commands.back(session, message)
  local to = message.to or session.way.at - 1
  local is_before = type(to) == "number" and to < session.way.at
  if not is_before then return "there is no such turn" end
  local place, problem = session.way:go(to)
  if not place then return problem end
  session.view:go_back(to)
  session.is_live = false
end

-- Resets the machine. The log is kept, and the command `back` undoes the reset.
function commands.reset(session)
  begin_turn(session)
  rfsm.reset(session.view.fsm)
  session.view:note("note", "reset")
  run(session)
end

function commands.why(session)
  local text = guarded(session, function() return session.view:why() end)
  return nil, text or "not known: an error in the log"
end

function commands.clock(session, message)
  if session.is_live then begin_turn(session) end
  session.is_live = message.live == true
  session.view:touch()
  start_clock(session)
end

local function next_timer(session)
  return session.view and clock.until_timer(session.view.fsm) or nil
end

-- Lets simulated time pass, but stops at a breakpoint. The machine runs when a timer
-- expires, and at the end.
local function pass(session, seconds)
  begin_turn(session)
  for _ = 1, Driven.MAX_STEPS do
    local part = min(seconds, next_timer(session) or seconds)
    part = min(seconds, ceil(part / TICK) * TICK)
    session.time:advance(part)
    run(session)
    seconds = seconds - part
    if seconds <= 0 or session.stopped then return start_clock(session) end
  end
  start_clock(session)
  session.view:note("note", ("%s s are left after %d timers"):format(
    rfsm.number_text(seconds, "%.6g"), Driven.MAX_STEPS))
end

function commands.wait(session, message)
  local seconds = message.seconds
  if type(seconds) ~= "number" or seconds < 0 or seconds >= 1e9 then
    return "seconds: number expected"
  end
  pass(session, seconds)
end

-- Sets a breakpoint or removes it, at a state, an event, or a transition "off -> on".
function commands.breakpoint(session, message)
  local list = session.points
  if type(message.at) ~= "string" then
    return "at: state, event or transition expected"
  end
  local ok, number = pcall(breakpoints.add, session.view, message.at)
  if not ok then return number end
  local name = list[number].name
  for i = message.on and number - 1 or number, 1, -1 do -- removes equal breakpoints
    if list[i].name == name then remove(list, i) end
  end
  session.view:touch()
end

commands.inspect = LocalView.answer_inspect

function commands.next(session)
  local seconds = next_timer(session)
  if not seconds then return "no timer runs" end
  pass(session, ceil(seconds / TICK) * TICK)
end

-- Timers and the file ----------------------------------------------------------------

-- Returns the seconds of real time until a timer expires; nil or false if none runs.
local function time_left(session)
  local seconds = session.is_live and next_timer(session)
  local since = session.real() - session.since
  return seconds and session.time:now() + seconds + TICK - since
end

--- Run the machine if a timer has expired; load the file again if it has changed.
function Driven:poll()
  local left = time_left(self)
  if left and left <= 0 then
    begin_turn(self)
    run(self)
  end
  if self.real() < self.look_at then return end
  self.look_at = self.real() + LOOK_TIME
  if read(self.file) ~= self.text then guarded(self, load, true) end
end

--- Return the seconds until `poll` has something to do.
function Driven:wait()
  return max(0, min(self.look_at - self.real(), time_left(self) or huge))
end

--- Add to a message: the clock, the breakpoints, and whether the page can go back.
function Driven:describe(message)
  message.clock, message.live = self.time:now(), self.is_live
  message.stopped, message.points = self.stopped, {}
  for i, point in ipairs(self.points) do
    message.points[i] = utf8(point.name)
  end
  local place = self.way and self.way[self.way.at - 1] or {}
  message.can_back = place.snap ~= nil
end

--- Open a chart, even if it has mistakes. `real()` returns the real time in seconds.
-- Return nil and the problem if the machine in the file `from` is wrong.
function Driven.open(file, real, has_stubs, from)
  local session = setmetatable({
    file = file, title = file:match("[^/]+$"), real = real, view = false, problems = {},
    generation = 0, way = false, since = 0,
    time = clock.simulated(), is_live = not from, points = {}, stopped = false,
    has_stubs = has_stubs, from = from,
    look_at = real() + LOOK_TIME, text = "", early = {}, snap = nil,
  }, Driven)
  local start = os.time() -- e_at needs the time of day
  session.gettime = clock.new(function()
    return true, start + session.time.sec, session.time.nsec
  end)
  guarded(session, load, false)
  return not session.problem and session or nil, session.problem
end

return Driven
