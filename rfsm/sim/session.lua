--- A session of the simulator: a chart, its machine, and functions that advance it.
--
-- The file reads in this order: open, advance, events, records, dry mode, reload.
--
-- @module rfsm.sim.session
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local rfsmpp = require "rfsmpp"
local calls = require "rfsm.shared.calls"
local chart = require "rfsm.shared.chart"
local clock = require "rfsm.clock"
local commands = require "rfsm.sim.commands"
local history = require "rfsm.sim.history"
local names = require "rfsm.observe.names"
local breakpoints = require "rfsm.observe.breakpoints"
local observer = require "rfsm.sim.observer"
local order = require "rfsm.shared.order"
local rewind = require "rfsm.observe.rewind"
local snapshot = require "rfsm.snapshot"
local instrument = require "rfsm.shared.instrument"
local terminal = require "rfsm.sim.terminal"
local time = require "rfsm.sim.time"
local why = require "rfsm.observe.why"
local drawing = require "rfsm.sim.drawing"

local error, ipairs, pcall, print = error, ipairs, pcall, print
local rawget, select, setmetatable = rawget, select, setmetatable
local type = type
local concat = table.concat
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local complain, text_of = terminal.complain, rfsm.text_of

--- A session: one chart and its prompt.
---@class rfsm.sim.Session
---@field fsm rfsm.Machine
---@field model rfsm.State
---@field file string the file of the chart
---@field init function makes the machine of a model, as `rfsm.init`
---@field has_stubs boolean was the file loaded with stubs in place of missing modules?
---@field follows boolean does an advance print the transitions taken, and the tree?
---@field tree? string|false the latest tree shown; an unchanged tree is not shown again
---@field level boolean|"full" trace records shown: none, the main ones (true), or all
---@field hooks (fun(fsm: rfsm.Machine))[] called after each advance
---@field points rfsm.observe.Breakpoint[] breakpoints and expressions that are watched
---@field picture? string|false a file into which each advance draws the machine
---@field history rfsm.observe.Rewind
---@field observer rfsm.sim.Observer
---@field came string[] the events of the present advance, as texts
---@field recorder? rfsm.record.Recorder
---@field time? rfsm.sim.Time the simulated clock
---@field saved? table[] the changes by which dry mode has removed functions
---@field env table what typed code sees: the commands, then the globals
---@field missing string[] globals that the current line reads and that do not exist
---@field last_line? string|false the last line typed, if it was a command
---@field commands { list: rfsm.sim.Command[], find: fun(name): rfsm.sim.Command? }
---@field fleet? table of which machine in a fleet this one is a copy
---@field unknown? string what is not known of the machine as it is noted now
---@field cell? rfsm.System the system, if the session has a system and no chart
---@field replay? fun(sim: rfsm.sim.Session, file: string): integer, string? takes
-- the moves that a file lists; only a session of a system has this field
---@field is_over boolean does the session end after this line?
local Session = {}
Session.__index = Session

-- Open a chart ----------------------------------------------------------------------

-- Prints an error of the chart's callbacks.
local function print_err(...) complain(calls.text("\t", ...)) end

-- Initialises a model. Its problems are returned, not printed.
local function init_quietly(model)
  if not rfsm.is_state(model) then return model end
  local own_err = model.err
  if own_err == nil then model.err = false end
  local fsm, text, problems = rfsm.init(model)
  model.err = own_err
  if fsm and own_err == nil then fsm.err = print_err end
  return fsm, text, problems
end

-- The same, without the infos of `rfsm.init`.
local function init_silently(model)
  if rfsm.is_state(model) and model.info == nil then model.info = false end
  return init_quietly(model)
end

-- Advance ---------------------------------------------------------------------------

function Session:print_active()
  local leaf = self.fsm._act_leaf
  print("active: " .. (leaf and leaf._fqn .. "(" .. leaf._mode .. ")" or "<none>"))
end

local function print_events(title, events)
  print(title .. concat(order.map(events, rfsm.event_text, true), ", "))
end

function Session:print_queue()
  local waiting = rfsm.waiting(self.fsm)
  print_events("queue:  ", self.fsm._intq)
  if waiting[1] ~= nil then print_events("waiting:  ", waiting) end
end

--- Show the active states and the queue.
function Session:show()
  local tree = self.follows and drawing.tree(self.fsm)
  local seconds = self.follows and clock.until_timer(self.fsm)
  if tree and tree ~= self.tree then print(tree) end
  self.tree = tree
  self:print_active()
  self:print_queue()
  if seconds then
    print("timer:  in " .. time.text(seconds) .. ", next() goes there")
  end
  breakpoints.show_watched(self)
  if self.picture then self:draw(self.picture) end
end

--- Draw the machine into a file, now and after each advance. If `file` is false, stop.
function Session:draw(file)
  history.pause(self)
  local problem = file and drawing.draw(self.fsm, file)
  self.picture = not problem and file
  if problem then complain("view: " .. problem) end
end

-- Advances by n steps. Stops earlier at a breakpoint, if the machine is idle, or if it
-- cannot be entered. Returns true if the machine is idle and has no idle hook.
local function advance(sim, n)
  local fsm, observed = sim.fsm, sim.observer
  if not sim.points[1] then return rfsm.step(fsm, n) and not fsm.idle_hook end
  for _ = 1, n do
    local is_idle = rfsm.step(fsm)
    observed:check_conditions()
    if is_idle or observed.is_hit or not fsm._act_leaf then return is_idle end
  end
  return false
end

local MAX_RUN = 10000 -- iterations: a chart may go on for ever

function Session:print_hits()
  for i, point in ipairs(self.points) do
    if self.observer.hits[i] then
      print(("stopped at %d: %s"):format(i, breakpoints.text(point)))
    end
  end
end

--- Advance by n steps, or until the machine is idle. Show the state even after errors.
function Session:advance(n)
  local observed = self.observer
  observed:begin(self.follows and not self.level)
  local ok, result = pcall(advance, self, n or MAX_RUN)
  if not ok then calls.try(rfsm.check_between_steps, self.fsm, "advance") end
  observed:finish()
  history.note_events(self, observed.seen)
  self:print_fates()
  self:show()
  self:print_hits()
  if ok and not (n or result or observed.is_hit) and self.fsm._act_leaf then
    print("stopped after 10,000 iterations, 'run' goes on")
  end
  for _, hook in ipairs(self.hooks) do hook(self.fsm) end
  if not ok then error(result, 0) end
end

-- Prints the events that an extension keeps, with the states, and the discarded ones.
function Session:print_fates()
  if not self.follows then return end
  local kept, discarded = {}, {}
  for i, entry in ipairs(self.observer:with_fate("kept")) do
    kept[i] = why.kept_text(entry.event, entry.who, entry.at.prefix)
  end
  for i, entry in ipairs(self.observer:with_fate("discarded")) do
    discarded[i] = rfsm.event_text(entry.event, true)
  end
  if kept[1] then print("kept:   " .. concat(kept, ", ")) end
  if not discarded[1] then return end
  print("discarded: " .. concat(discarded, ", ") .. (self.has_explained and ""
    or " ('why " .. discarded[1] .. "' explains)"))
  self.has_explained = true
end

-- Events ----------------------------------------------------------------------------

-- Complains of an event that is nil or that no transition of a machine names.
function Session:check_event(event, i, fsm)
  fsm = fsm or self.fsm
  local name = event == nil and self.missing[1]
  if name then
    complain(("nothing is named %s, an event is in quotes%s"):format(name,
      advice.nearest_name(name, names.events(fsm))))
  elseif event == nil then
    complain(("event %d is nil"):format(i))
  elseif self.follows and names.form_meant(fsm, event) then
    complain(("no transition names the event '%s' (did you mean '%s'?)"):format(
      rfsm.event_text(event, true), names.form_meant(fsm, event)))
  elseif not names.is_event(fsm, event) then
    local text = rfsm.name_with_data(event) or event
    complain(("no transition names the event '%s'%s"):format(
      rfsm.event_text(event, true), type(text) == "string"
        and advice.nearest_name(text, names.events(fsm)) or ""))
  end
end

--- Send events. `e_done` stands for the event `e_done@FQN` of the active leaf.
function Session:send(...)
  local leaf, events, n = self.fsm._act_leaf, { ... }, select("#", ...)
  for i = 1, n do
    if events[i] == "e_done" and leaf then events[i] = "e_done@" .. leaf._fqn end
    self:check_event(events[i], i)
  end
  rfsm.send_events(self.fsm, unpack(events, 1, n))
end

--- Have Control-C end a doo that never yields. Return a function that undoes this.
function Session:guard_doos()
  local changes = {}
  for _, at in ipairs(terminal.is_caught() and rfsm.machines(self.fsm) or {}) do
    for _, state in ipairs(rfsm.elements(at.machine, rfsm.is_leaf)) do
      local doo = state.doo
      if doo then instrument.put(changes, state, "doo", terminal.interruptible(doo)) end
    end
  end
  return function() instrument.give_back(changes) end
end

-- Other records, another machine ----------------------------------------------------

-- The trace records that matter most to the author of a chart.
local MAIN_RECORDS = {}
for id in ("STATE_ENTER STATE_EXIT EFFECT DOO EXEC_PATH ERROR HIBERNATING RAISED "
  .. "TIMEEVENT"):gmatch("%S+") do
  MAIN_RECORDS[id] = true
end

--- Choose the trace records that are shown.
function Session:set_level(level)
  if level == nil then level = true end
  if level ~= true and level ~= false and level ~= "full" then
    local what = type(level) == "string" and "string '%s'" or "%s"
    error("dbg: false, true or 'full' expected, got " .. what:format(text_of(level)), 0)
  end
  local ids = level == "full" and {} or MAIN_RECORDS
  local name = self.file:gsub("^.*/", ""):gsub("%.lua$", "")
  self.level = level
  self.fsm.dbg = level and rfsmpp.gen_dbgcolor(name, ids, level == "full")
end

-- Replaces each doo in dry mode. It goes on until its state is left.
local function idle()
  while true do rfsm.yield(true) end
end

local function let_pass() return true end

local function take_functions(fsm)
  local changes = {}
  for _, at in ipairs(rfsm.machines(fsm)) do
    local machine = at.machine
    for _, state in ipairs(instrument.take_functions(changes, machine)) do
      instrument.put(changes, state, "doo", idle)
    end
    if machine.getevents then instrument.put(changes, machine, "getevents", nil) end
    for _, tr in ipairs(rfsm.elements(machine, rfsm.is_trans)) do
      if tr.guard then instrument.put(changes, tr, "guard", let_pass) end
    end
  end
  return changes
end

--- Begin or end dry mode, in which the machine runs without the functions of the chart.
function Session:set_dry(is_dry)
  history.pause(self)
  instrument.give_back(self.saved or {})
  self.saved = is_dry and take_functions(self.fsm) or nil
end

--- Read the file of the chart again. If that fails the old machine stays.
function Session:reload()
  local fsm, result = chart.open(self.file, self.init, complain, self.has_stubs)
  if not fsm then
    for _, problem in ipairs(result) do complain(problem) end
    return
  end
  time.install(self, fsm)
  local snap, problem = snapshot.try_take(self.fsm)
  problem = problem or rewind.carry_over(fsm, snap)
  self.fsm, self.env.fsm, self.model = fsm, fsm, result
  if self.saved then self.saved = take_functions(fsm) end
  if self.level then self:set_level(self.level) end
  breakpoints.renew(self, complain)
  history.start(self)
  self.observer = observer.new(self)
  if problem then
    complain(calls.line(text_of(problem)) .. ": the machine begins anew")
  end
  self:show()
end

-- Public functions --------------------------------------------------------------------

local session = { check_event = Session.check_event }

--- Return a session of a chart; nil and the problems if the chart is wrong. If `load`
-- returns a system in place of a chart, `new(system, follows)` is returned.
function session.open(file, follows, has_stubs, is_silent, load, new)
  local init = is_silent and init_silently or init_quietly
  local fsm, result = chart.open(file, init, complain, has_stubs, load)
  if not fsm then return nil, result end
  if not rfsm.is_state(result) then return new(result, follows) end
  local sim = setmetatable({
    fsm = fsm, model = result, file = file, follows = follows, level = false,
    hooks = {}, points = {}, missing = {}, is_over = false, env = {},
    init = init, has_stubs = has_stubs or false, commands = commands,
  }, Session)
  history.start(sim)
  sim.observer = observer.new(sim)
  return sim
end

return session
