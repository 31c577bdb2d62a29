--- The history of a session: each iteration is recorded, to go back to it.
--
-- Going back calls no function of the chart: a machine is replayed without them, and
-- that of the session is put where it stands then.
--
-- @module rfsm.sim.history
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local opts = require "rfsm.shared.options"
local record = require "rfsm.record"
local snapshot = require "rfsm.snapshot"
local tracks = require "rfsm.record.track"

local error, io, ipairs, max, pcall = error, io, ipairs, math.max, pcall
local print, type = print, type
local concat = table.concat
local text_of = rfsm.text_of

local history = {}

--- What was recorded.
---@class rfsm.sim.History
---@field list table[] the records, as of `rfsm.record`
---@field count integer iterations
---@field marks table[] where each advance began: count, simulated time, is_fresh
---@field recorder? rfsm.record.Recorder nil while nothing is recorded
---@field problem? string the reason then
---@field is_fresh? boolean the machine was reset before the next iteration
---@field file? file* gets each record, too

local LIMIT = 100000 -- iterations; then a history begins anew

local function write(file, rec)
  local dkjson = opts.need("record", "dkjson", "lua-dkjson")
  file:write(dkjson.encode(rec), "\n")
  file:flush()
end

local function stop(own)
  if own.recorder then own.recorder:stop() end
  own.recorder = nil
end

-- Takes a record. Only the first header counts: the recorder is made more than once.
local function add(own, rec)
  if rec.record and own.list[1] then return end
  if own.is_fresh and not (rec.record or rec.m) then
    rec.fresh, own.is_fresh = true, false
  end
  own.list[#own.list + 1] = rec
  if own.file then write(own.file, rec) end
  if rec.record or rec.m then return end
  own.count = own.count + 1
  if own.count >= LIMIT then
    own.problem = LIMIT .. " iterations were forgotten"
    stop(own)
  end
end

-- Records from now on, behind what is there.
local function continue(sim)
  local own = sim.history
  local ok, result = pcall(record.record, sim.fsm, function(rec) add(own, rec) end)
  own.recorder = ok and result or nil
  own.is_fresh = own.count > 0 and not sim.fsm._act_leaf
  own.problem = not ok and text_of(result) or nil
end

--- Begin a history.
---@param sim rfsm.sim.Session
function history.start(sim)
  if sim.history then stop(sim.history) end
  sim.history = { list = {}, count = 0, marks = {} }
  continue(sim)
end

--- Call a function while nothing is recorded, and the guards are those of the chart.
---@param sim rfsm.sim.Session
---@param f fun()
function history.pause(sim, f)
  stop(sim.history)
  local ok, failure = pcall(f)
  if sim.history.count < LIMIT then continue(sim) end
  if not ok then error(failure, 0) end
end

--- Note that an advance begins.
---@param sim rfsm.sim.Session
function history.mark(sim)
  local problem = sim.history.problem
  if not sim.history.recorder then -- what is missing cannot be replayed
    history.start(sim)
    sim.history.problem = problem
  end
  local own, now = sim.history, sim.time or {}
  own.marks[#own.marks + 1] = { count = own.count, sec = now.sec, nsec = now.nsec,
    is_fresh = not sim.fsm._act_leaf }
end

-- Drops the records after iteration n.
local function truncate(own, n)
  tracks.truncate(own.list, n)
  own.count = n
end

-- Returns the last mark that is not after iteration n, and its index.
local function find_mark(marks, n)
  local i = #marks
  while i > 1 and marks[i].count > n do i = i - 1 end
  return marks[i], i
end

-- Sets the simulated time to that of a mark; returns the time before.
local function set_time(time, mark)
  if not (time and mark and mark.sec) then return nil end
  local before = { sec = time.sec, nsec = time.nsec }
  time.sec, time.nsec = mark.sec, mark.nsec
  return before
end

-- Replays records with a model that says nothing of itself.
local function replay(sim, list, options)
  local model = sim.model
  local info, warn = model.info, model.warn
  model.info, model.warn = false, false
  local ok, fsm, problem, step = pcall(record.replay, model, list, options)
  model.info, model.warn = info, warn
  if not ok then error(fsm, 0) end
  return fsm, problem, step
end

-- Puts the machine of a session where another one stands.
local function put(sim, fsm)
  local ok, problem, difference = snapshot.put(sim.fsm, snapshot.take(fsm))
  if ok then return end
  if difference then
    problem = "the machine has changed, " .. concat(difference, ", ")
  end
  error("goto: " .. problem, 0)
end

--- Have the machine stand where it stood after iteration n.
---@param sim rfsm.sim.Session
---@param n integer
function history.go_to(sim, n)
  local own = sim.history
  if type(n) ~= "number" or n < 0 or n > own.count or n % 1 ~= 0 then
    error(("goto: number of an iteration from 0 to %d expected, got %s"):format(
      own.count, text_of(n)), 0)
  elseif not own.list[1] then
    error("goto: nothing was recorded: " .. text_of(own.problem), 0)
  end
  history.pause(sim, function()
    local mark, i = find_mark(own.marks, n)
    local before = set_time(sim.time, mark)
    local fsm, problem = replay(sim, own.list, { dry = true, to = n })
    if not fsm then
      set_time(sim.time, before)
      error("goto: " .. text_of(problem), 0)
    end
    put(sim, fsm)
    truncate(own, n)
    for j = #own.marks, mark and mark.count == n and i or i + 1, -1 do
      own.marks[j] = nil
    end
  end)
  if own.file then history.save(sim, own.name) end
end

--- Undo the last advances.
---@param sim rfsm.sim.Session
---@param n integer
function history.back(sim, n)
  local marks = sim.history.marks
  if type(n) ~= "number" or n < 1 or n % 1 ~= 0 then
    error("back: number from 1 expected, got " .. text_of(n), 0)
  elseif not marks[1] then
    error("back: nothing was done", 0)
  end
  local mark = marks[max(#marks - n + 1, 1)]
  history.go_to(sim, mark.count)
  if mark.is_fresh then rfsm.reset(sim.fsm) end
end

--- Write the history to a file, and all that follows; nil ends that.
---@param sim rfsm.sim.Session
---@param name? string
function history.save(sim, name)
  local own = sim.history
  if own.file then own.file:close() end
  own.file, own.name = nil, name
  if not name then return end
  local file, problem = io.open(name, "w")
  if not file then error("record: " .. problem, 0) end
  for _, rec in ipairs(own.list) do write(file, rec) end
  own.file = file
end

--- Run the chart through a recording. Where it departs, it stops, and that is raised.
---@param sim rfsm.sim.Session
---@param name string of the file
function history.replay(sim, name)
  local list, own = record.read(name), sim.history
  local is_dry = sim.saved ~= nil
  stop(own)
  local fsm, problem, step = replay(sim, list, { dry = is_dry })
  if not fsm and step then
    fsm = replay(sim, list, { dry = true, to = step })
  end
  if not fsm then error(name .. ": " .. text_of(problem), 0) end
  put(sim, fsm)
  own.list, own.count = list, 0
  for i = 2, #list do
    if not list[i].m then own.count = own.count + 1 end
  end
  if problem then truncate(own, step) end
  continue(sim)
  if problem then error(name .. ": " .. text_of(problem), 0) end
end

local function texts_of(events)
  local texts = {}
  for i = 1, events and #events or 0 do
    local event = events[i]
    texts[i] = text_of(type(event) == "table" and event[2] or event)
  end
  return concat(texts, ", ")
end

--- Print the last iterations.
---@param sim rfsm.sim.Session
---@param last integer how many
function history.show(sim, last)
  local own, n = sim.history, 0
  for i = 2, #own.list do
    local rec = own.list[i]
    if not rec.m then
      n = n + 1
      if n > own.count - last then
        print(("%4d  %-30s  %s"):format(n, texts_of(rec.events),
          rec.leaf and tracks.place_text(rec.leaf, rec.done) or "<none>"))
      end
    end
  end
  if own.problem then print(own.problem) end
end

return history
