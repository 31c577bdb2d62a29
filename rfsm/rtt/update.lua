--- The updates of a machine in a component of Orocos RTT: steps, attributes, memory.
--
-- All functions and tables are made during the launch. An update allocates nothing.
--
-- @module rfsm.rtt.update
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local rfsm = require "rfsm"

local collectgarbage, debug, error = collectgarbage, debug, error
local getmetatable = getmetatable
local pcall, rawget, require, select = pcall, rawget, require, select
local setmetatable, type = setmetatable, type
local huge, remove = math.huge, table.remove
local newproxy = rawget(_G, "newproxy")
local text_of = calls.text -- so that launched functions do not hold the module

local update = {}

-- Memory: a pool of a fixed size -------------------------------------------------

-- Collects garbage. The collector itself allocates, so it may fail in a full pool.
local function collect() pcall(collectgarbage) end

update.collect = collect

-- Collects garbage after an error for lack of memory. Lua 5.1 itself collects when the
-- heap has grown by a factor, not when memory is short. So a full pool would stay full,
-- and the report of the error would fail, too.
local function make_room(problem)
  if type(problem) == "string" and problem:find("not enough memory", 1, true) then
    collect()
  end
end

-- Returns the KiB in use, the most KiB that were ever in use, and the size of the TLSF
-- pool, all with the pool's overhead. Without a pool the last two are 0 and infinity.
local function usage()
  local tlsf = rawget(_G, "tlsf")
  if not (tlsf and tlsf.stats) then return collectgarbage("count"), 0, huge end
  local used, most, size = tlsf.stats()
  return used / 1024, most / 1024, size / 1024
end

-- Collects all garbage, and returns the memory in use as a text.
local function memory_text()
  collect()
  local used, _, size = usage()
  if size == huge then return ("%.0f KiB in use"):format(used) end
  return ("%.0f of %.0f KiB in use (%.0f %%)"):format(used, size, 100 * used / size)
end

--- Enlarge the pool of a component to so many KiB; without a pool nothing happens.
function update.enlarge_pool(launch, kib)
  local _, _, size = usage()
  if size + 16 > kib then return end -- large enough: the pool itself takes up to 16 KiB
  local bytes = launch.rtt.Variable.new("uint")
  bytes:assign((kib - size) * 1024)
  launch.component:getOperation("tlsf_incmem")(bytes)
end

-- Has `note` called when the present cycle of the collector ends.
local function when_collected(note)
  if not newproxy then return setmetatable({}, { __gc = note }) end
  getmetatable(newproxy(true)).__gc = note
end

--- Return a function that writes the memory in use to attributes: `rfsm_live` after
-- each cycle of the collector, `rfsm_peak` the most so far. It collects garbage when
-- nine tenths of a pool's free part are used up. Before its first call, collect all.
function update.new_meter(launch)
  local variables, peak, limit, is_collected = launch.variables, 0, false, true
  local function note() is_collected = true end
  return function()
    local used, most, size = usage()
    if limit and used > limit then
      collect()
      used, limit = usage(), false
    end
    limit = limit or used + 0.9 * (size - used)
    if is_collected then
      is_collected = false
      variables.rfsm_live:assign(collectgarbage("count"))
      pcall(when_collected, note)
    end
    if most < used then most = used end
    if most > peak then variables.rfsm_peak:assign(most) end
    if most > peak then peak = most end
  end
end

-- Has the collector work as before the launch, unless more than a part of the pool is
-- in use: what is left has no room for much garbage.
local function relax(launch, part)
  collect()
  local used, _, size = usage()
  if launch.stepmul and used <= part * size then
    collectgarbage("setstepmul", launch.stepmul)
  end
end

--- Undo a launch that has failed, and raise the reason. If memory was short, the
-- message also has the stage of the launch and the memory in use.
function update.fail(launch, problem)
  relax(launch, 1) -- the garbage goes: otherwise undoing would fail, too
  if launch.undo then launch:undo() end
  local text = rfsm.text_of(problem)
  if text:find("not enough memory", 1, true) then
    text = ("%s while %s, %s without that"):format(text, launch.stage, memory_text())
  end
  error(launch.where .. text, 0)
end

local fail = update.fail

--- Prepare the machine, and log that it is launched.
function update.finish(launch)
  collect()
  launch.stage = "the machine is prepared"
  local prepare = rfsm.prepare -- loads a file, which leaves garbage
  collect()
  local ok, problem = pcall(prepare, launch.fsm)
  require("rfsm.rtt").forget_modules() -- prepare, too
  if not ok then fail(launch, problem) end
  launch.undo, launch.finish = nil, nil
  relax(launch, 0.9)
  launch.env, launch.prestr, launch.poststr = nil, nil, nil -- they may be large
  local is_stripped = debug.getinfo(rfsm.init, "S").source == "=?"
  launch.log("Info", ("rfsm.rtt: '%s' is launched in '%s': %s%s%s"):format(
    launch.fsmfile, launch.component:getName(), memory_text(),
    rawget(_G, "tlsf") and ", without rfsm.fast" or "",
    is_stripped and ", stripped" or ""))
  launch.meter()
end

-- Adds one to the count in an attribute.
local function count(launch, name)
  launch.counts[name] = launch.counts[name] + 1
  launch.variables[name]:assign(launch.counts[name])
end

-- Log ----------------------------------------------------------------------------

local MOST_LINES = 16 -- lines with different texts that a log remembers

local function write(rtt, line)
  rtt.logl(line.level, line.text
    .. (line.count > 1 and (" (%d times)"):format(line.count) or ""))
  line.second, line.count = rtt.getTime(), 0
end

--- Return three functions. log(level, ...) writes a line to RTT's log; a line that was
-- written in the same second already is only counted. The second function, to be called
-- now and then, writes the lines that were counted, with their counts. The third one
-- is log with a key in front: lines of one key count as the same one, the last of them.
--
-- Arguments become texts, since OCL mutes the log of the whole process if an error is
-- not a text.
function update.new_log(rtt)
  local lines, is_behind = {}, false

  -- Returns the line with a level and a key. A new line replaces the oldest one.
  local function find(level, key)
    for i = 1, #lines do
      if lines[i].key == key and lines[i].level == level then return lines[i] end
    end
    local oldest = lines[MOST_LINES] and remove(lines, 1)
    if oldest and oldest.count > 0 then write(rtt, oldest) end
    lines[#lines + 1] = { level = level, key = key, text = key, count = 0,
      second = false }
    return lines[#lines]
  end

  local function log_as(key, level, ...)
    for i = 1, select("#", ...) do make_room((select(i, ...))) end
    local text = text_of(" ", ...)
    local line = find(level, key or text)
    line.text, line.count = text, line.count + 1
    if line.second ~= rtt.getTime() then return write(rtt, line) end
    is_behind = true
  end

  local function log(level, ...) return log_as(nil, level, ...) end

  return log, function()
    if not is_behind then return end
    local second = rtt.getTime()
    is_behind = false
    for i = 1, #lines do
      local line = lines[i]
      if line.count > 0 and line.second ~= second then write(rtt, line) end
      is_behind = is_behind or line.count > 0
    end
  end, log_as
end

-- Adds one to the count in an attribute, and calls error() of the component if the
-- option `error` of the launch is true.
local function alert(launch, name)
  count(launch, name)
  if launch.error then launch.component:error() end
end

--- Return a function that counts its calls as errors, and calls `err` of the machine.
function update.counted(launch, err)
  return function(...)
    alert(launch, "rfsm_errors")
    if err then return err(...) end
  end
end

--- Report an error that an update raised. This function raises no error itself, since
-- RTT removes a hook that fails.
function update.report(launch, problem)
  make_room(problem)
  alert(launch, "rfsm_failures")
  pcall(launch.log, "Error", "rfsm.rtt:", problem)
end

local report = update.report

-- Exceptions of C++ ----------------------------------------------------------------

--- Have the machine go on if an exception of C++ has ended its last step: it goes
-- through Lua, and no pcall notices it. Only for callers that RTT calls, and never
-- inside of a step, since such a step looks the same. Return true if one was ended.
function update.notice_exception(launch)
  local fsm = launch.fsm
  if not (fsm and rfsm.note_cut(fsm)) then return false end
  if launch.hear then launch.hear() end
  launch.has_failed = true
  report(launch, "an exception of C++ has ended a step, which goes on behind the "
    .. "callback that raised it")
  return true
end

-- Updates ------------------------------------------------------------------------

-- Returns a function that wakes an event-driven component for the next time event. It
-- looks for the timer each time: an operation of a component that was unloaded ends the
-- process.
local function new_alarm(launch, fsm)
  local next_deadline = launch.ports.timer and require("rfsm_timeevent").next_deadline
  if not next_deadline then return function() end end
  local component, name = launch.component, launch.timer
  local arm = component:getPeer(name):getOperation("arm")
  local id, delay = launch.rtt.Variable.new("int"), launch.rtt.Variable.new("double")
  return function()
    local seconds = arm and next_deadline(fsm)
    if not seconds then return end
    if not pcall(component.getPeer, component, name) then
      arm = nil
      return launch.log("Error", "rfsm.rtt: time events are late from now on: '" .. name
        .. "' was unloaded")
    end
    delay:assign(seconds)
    arm(id, delay)
  end
end

-- Returns a function that takes the steps of an update.
local function new_update(launch, fsm, again)
  local steps, alarm = launch.steps, new_alarm(launch, fsm)
  return function()
    if not launch.is_ready then launch:make_ready() end
    local is_idle = rfsm.step(fsm, steps)
    if not is_idle and steps > 1 and rfsm.get_sta_mode(fsm) ~= "inactive" then
      count(launch, "rfsm_overruns")
      again()
    end
    alarm()
  end
end

-- Returns a function that advances the machine, and always returns true. The update
-- after a failure finishes the step that was cut short; the next update reads the new
-- events. So another update is triggered when failures begin and when they end.
function update.new_trigger(launch, fsm)
  -- triggers the next update of a component, which otherwise waits for an event
  local again = launch.is_component and launch.component:getOperation("trigger")
    or function() end
  local advance = new_update(launch, fsm, again)
  local meter, target, flush = launch.meter, launch.component, launch.flush
  local running_only = launch.running_only
  launch.has_failed = false
  return function()
    if running_only and target:getState() ~= "Running" then return true end
    local ok, problem = pcall(advance)
    if not ok then report(launch, problem) end
    if ok == launch.has_failed then pcall(again) end
    launch.has_failed = not ok
    pcall(flush)
    meter()
    return true
  end
end

return update
