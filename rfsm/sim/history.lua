--- The history of a session: each iteration is recorded, to go back and forward to it.
--
-- It consists of chunks, each a recording that begins with a snapshot. To go to an
-- iteration, one chunk is replayed without the functions of the chart, and the machine
-- of the session gets a snapshot of the replayed one. So the time does not depend on
-- the length of the history, and the oldest chunk may be forgotten.
--
-- @module rfsm.sim.history
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local record = require "rfsm.record"
local journal = require "rfsm.record.journal"
local replay = require "rfsm.record.replay"
local snapshot = require "rfsm.snapshot"
local terminal = require "rfsm.sim.terminal"
local tracks = require "rfsm.record.track"
local order = require "rfsm.shared.order"

local error, io, ipairs = error, io, ipairs
local max, min = math.max, math.min
local pcall, print, type = pcall, print, type
local concat, remove = table.concat, table.remove
local text_of = rfsm.text_of

local history = { CHUNK = 500, LIMIT = 40000 } -- iterations: in a chunk, in all

--- A recording of some iterations.
---@class rfsm.sim.Chunk
---@field first integer the number of the iteration before it
---@field count integer iterations in it
---@field list table[] the records, as of `rfsm.record`

--- The beginning of an advance.
---@class rfsm.sim.Mark
---@field count integer
---@field sec? number simulated time
---@field nsec? number
---@field is_fresh boolean the machine was not entered

--- The chunks and advances of a session.
---@class rfsm.sim.History
---@field chunks rfsm.sim.Chunk[] the oldest first; at the end those undone by `back`
---@field fresh rfsm.sim.Chunk|false the next chunk, which has no iteration yet
---@field count integer iterations up to now
---@field last integer the same, and the iterations that were undone
---@field marks rfsm.sim.Mark[] of the advances, also of those undone
---@field at integer how many advances are not undone
---@field tip? rfsm.sim.Mark the end of the last advance, once `back` has left it
---@field recorder? rfsm.record.Recorder nil while nothing is recorded
---@field problem? string the reason why nothing is recorded
---@field write? fun(rec: table) writes to a file, too
---@field file? file*
---@field name? string

-- Chunks --------------------------------------------------------------------------

local function stop(own)
  if own.recorder then own.recorder:stop() end
  own.recorder = nil
end

local function first_of(own) return own.chunks[1] and own.chunks[1].first or 0 end

local function forget(own)
  while own.chunks[2] and own.last - first_of(own) > history.LIMIT do
    remove(own.chunks, 1)
  end
  while own.marks[1] and own.marks[1].count < first_of(own) do
    remove(own.marks, 1)
    own.at = own.at - 1
  end
end

local function drop_future(own)
  for i = #own.marks, own.at + 1, -1 do own.marks[i] = nil end
  own.tip = nil
  if own.count == own.last then return end
  for i = #own.chunks, 1, -1 do
    local chunk = own.chunks[i]
    if chunk.first >= own.count and i > 1 then
      own.chunks[i] = nil
    elseif chunk.first + chunk.count > own.count then
      chunk.count = own.count - chunk.first
      tracks.truncate(chunk.list, chunk.count)
    end
  end
  own.last = own.count
end

local function add(own, rec)
  if rec.record then
    own.fresh = { first = own.count, count = 0, list = { rec } }
    return
  end
  if own.fresh then
    drop_future(own)
    own.chunks[#own.chunks + 1], own.fresh = own.fresh, false
    forget(own)
  end
  local chunk = own.chunks[#own.chunks]
  chunk.list[#chunk.list + 1] = rec
  if own.write then own.write(rec) end
  if rec.m then return end
  own.count, chunk.count = own.count + 1, chunk.count + 1
  own.last = own.count
end

-- Records from now on, in a new chunk.
local function continue(sim)
  local own = sim.history
  local ok, result = pcall(record.record, sim.fsm, function(rec) add(own, rec) end)
  own.recorder = ok and result or nil
  own.problem = not ok and text_of(result) or nil
end

--- Begin a history.
function history.start(sim)
  if sim.history then stop(sim.history) end
  sim.history = { chunks = {}, fresh = false, count = 0, last = 0, marks = {}, at = 0 }
  continue(sim)
end

--- Call a function while nothing is recorded, and the guards are those of the chart.
function history.pause(sim, f)
  stop(sim.history)
  local ok, failure = pcall(f)
  continue(sim)
  if not ok then error(failure, 0) end
end

--- Begin a new chunk if the last one is long enough; between two steps.
function history.cut(sim)
  local own = sim.history
  local chunk = own.chunks[#own.chunks]
  if own.recorder and not own.fresh and chunk and chunk.count >= history.CHUNK then
    terminal.uninterrupted(function()
      stop(own)
      continue(sim)
    end)
  end
end

-- Marks: where advances begin -----------------------------------------------------

local function new_mark(sim)
  local now = sim.time or {}
  return { count = sim.history.count, sec = now.sec, nsec = now.nsec,
    is_fresh = not sim.fsm._act_leaf }
end

--- Note that an advance begins.
function history.mark(sim)
  local problem = sim.history.problem
  if not sim.history.recorder then -- a gap cannot be replayed
    history.start(sim)
    sim.history.problem = problem
  end
  history.cut(sim)
  local own = sim.history
  drop_future(own)
  own.at = own.at + 1
  own.marks[own.at] = new_mark(sim)
end

-- Returns how many marks are before iteration n.
local function count_marks(own, n)
  local i = #own.marks
  while i > 0 and own.marks[i].count >= n do i = i - 1 end
  return i
end

-- Sets the simulated time to that of a mark; returns the time before.
local function set_time(time, mark)
  if not (time and mark and mark.sec) then return nil end
  local before = { sec = time.sec, nsec = time.nsec }
  time.sec, time.nsec = mark.sec, mark.nsec
  return before
end

-- Go to ---------------------------------------------------------------------------

-- Replays records with a model that prints nothing.
local function replay_list(sim, list, options)
  local model = sim.model
  local info, warn = model.info, model.warn
  model.info, model.warn, options.migrate = false, false, true
  local ok, session = pcall(replay, model, list, options)
  model.info, model.warn = info, warn
  if not ok then error(session, 0) end
  return session.snap, session.problem or session.unsaved, session.fsm and session.at
end

local function put(sim, snap)
  local ok, problem, difference = snapshot.put(sim.fsm, snap)
  if ok then return end
  if difference then
    problem = "the machine has changed, " .. concat(difference, ", ")
  end
  error("goto: " .. problem, 0)
end

-- Returns the last chunk that begins with or before iteration n.
local function find_chunk(own, n)
  local i = #own.chunks
  while i > 1 and own.chunks[i].first > n do i = i - 1 end
  return own.chunks[i]
end

-- Puts the machine into its state after iteration n, at the time of a mark.
local function move(sim, n, mark)
  local own, chunk = sim.history, find_chunk(sim.history, n)
  if not (own.recorder or chunk) then
    error("goto: nothing was recorded: " .. text_of(own.problem), 0)
  end
  if own.count == own.last then own.tip = own.tip or new_mark(sim) end
  if not chunk then return end -- nothing has happened
  history.pause(sim, function()
    local before = set_time(sim.time, mark)
    local snap, problem = replay_list(sim, chunk.list,
      { dry = true, to = n - chunk.first })
    if not snap then
      set_time(sim.time, before)
      error("goto: " .. text_of(problem), 0)
    end
    put(sim, snap)
    own.count = n
  end)
  if own.file then history.save(sim, own.name) end
end

--- Put the machine into its state after iteration n.
function history.go_to(sim, n)
  local own = sim.history
  local first = first_of(own)
  if type(n) ~= "number" or n < first or n > own.last or n % 1 ~= 0 then
    error(("goto: number of an iteration from %d to %d expected, got %s"):format(first,
      own.last, text_of(n)), 0)
  end
  local at = count_marks(own, n)
  local following = own.marks[at + 1]
  local mark = following and following.count == n and following or own.marks[at]
  move(sim, n, n == own.last and own.tip or mark)
  own.at = at
end

local function check_count(name, n)
  if type(n) ~= "number" or n < 1 or n % 1 ~= 0 then
    error(name .. ": number from 1 expected, got " .. text_of(n), 0)
  end
end

-- Goes to where advance `at` has ended.
local function move_to_mark(sim, at)
  local own = sim.history
  local mark = own.marks[at + 1] or own.tip
  move(sim, mark.count, mark)
  own.at = at
  if mark.is_fresh then rfsm.reset(sim.fsm) end
end

--- Undo the last advances.
function history.back(sim, n)
  local at = sim.history.at
  check_count("back", n)
  if at == 0 then error("back: nothing was done", 0) end
  move_to_mark(sim, max(at - n, 0))
end

--- Do again what `back` has undone.
function history.forward(sim, n)
  local at, last = sim.history.at, #sim.history.marks
  check_count("forward", n)
  if at == last then error("forward: nothing was undone", 0) end
  move_to_mark(sim, min(at + n, last))
end

-- Files ---------------------------------------------------------------------------

-- Returns the first record of a chunk in a file with one header for all chunks.
local function continued(rec, header)
  if header.snapshot.leaf or rec.m then return rec end
  local copy = { fresh = true }
  for key, value in order.each(rec) do copy[key] = value end -- any order: a copy
  return copy
end

-- Calls f(record) for the records up to now, with one header.
local function each_record(own, f)
  if not own.chunks[1] and own.fresh then f(own.fresh.list[1]) end
  for i, chunk in ipairs(own.chunks) do
    local n, is_first = chunk.first, i > 1
    if i == 1 then f(chunk.list[1]) end
    for j = 2, #chunk.list do
      local rec = chunk.list[j]
      if n >= own.count then return end
      f(is_first and continued(rec, chunk.list[1]) or rec)
      if not rec.m then n, is_first = n + 1, false end
    end
  end
end

--- Write the history to a file, and all that follows; without a name, end that.
function history.save(sim, name)
  local own = sim.history
  if own.file then own.file:close() end
  own.file, own.write, own.name = nil, nil, name
  if not name then return end
  local file, problem = io.open(name, "w")
  if not file then error("record: " .. problem, 0) end
  own.file, own.write = file, journal.writer(file)
  each_record(own, own.write)
end

local function count_iterations(list)
  local count = 0
  for i = 2, #list do
    if not list[i].m then count = count + 1 end
  end
  return count
end

--- Run the chart through the recording in a file. Raises an error if the run departs
-- from it; the machine stays at that iteration.
function history.replay(sim, name)
  local list, about = record.read(name)
  local own, is_dry = sim.history, sim.saved ~= nil
  stop(own)
  local snap, problem, step = replay_list(sim, list, { dry = is_dry })
  if not snap and step then
    snap = replay_list(sim, list, { dry = true, to = step })
  end
  if not snap then error(name .. ": " .. text_of(problem), 0) end
  put(sim, snap)
  if problem then tracks.truncate(list, step) end
  own.count = count_iterations(list)
  own.last, own.chunks = own.count, { { first = 0, count = own.count, list = list } }
  continue(sim)
  if problem then error(name .. ": " .. text_of(problem), 0) end
  if about.is_cut then error(name .. ": the last line was cut off", 0) end
end

-- Show ----------------------------------------------------------------------------

local function add_texts(texts, events)
  for _, event in ipairs(events or {}) do
    texts[#texts + 1] = text_of(type(event) == "table" and event[2] or event)
  end
  return texts
end

--- Print so many of the last iterations.
function history.show(sim, last)
  local own = sim.history
  local n = first_of(own)
  each_record(own, function(rec)
    if rec.record or rec.m then return end
    n = n + 1
    if n > own.count - last then
      local events = add_texts(add_texts({}, rec.events), rec.added)
      print(("%4d  %-30s  %s"):format(n, concat(events, ", "),
        rec.leaf and tracks.leaf_text(rec.leaf, rec.done) or "<none>"))
    end
  end)
  if own.problem then print(own.problem) end
end

return history
