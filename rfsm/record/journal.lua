--- Files of recordings. Each run in a file is a header and a JSON line for each record.
--
-- A line omits the fields that follow from the lines before: queued events, a leaf that
-- has not changed, the completion of a leaf. This makes the file a third as long. Each
-- line has a number `n`, and the line that ends a run has the last number, so that a
-- missing line is noticed. The last line of a run may be incomplete.
--
-- @module rfsm.record.journal
-- @license BSD-3-Clause

local exact_json = require "rfsm.shared.exact_json"
local files = require "rfsm.shared.files"
local opts = require "rfsm.shared.options"
local rfsm = require "rfsm"
local tracks = require "rfsm.record.track"
local order = require "rfsm.shared.order"

local error, io, ipairs = error, io, ipairs
local type = type
local same = tracks.same

local journal = { VERSION = 1 }

-- Short records -------------------------------------------------------------------

local NONE, SHORT = {}, { events = true, leaf = true, done = true, sent = true }

-- Returns the events that a record usually has in `sent`: the e_done of a done leaf.
local function usual(leaf, is_done)
  return is_done and leaf and { "e_done@" .. leaf } or nil
end

-- Returns the previous record of the machine of `rec`. A record with a snapshot in
-- `from` does not depend on earlier records, so these are forgotten.
local function last_of(all, rec)
  if rec.from then
    for machine in order.each(all) do all[machine] = nil end -- any order: all go
  end
  return all[rec.m or 0] or NONE
end

local function each_of(f, list, ...)
  local results = {}
  for i, item in ipairs(list) do results[i] = f(item, ...) end
  return results
end

-- Returns a record without the fields that follow from `before`, the previous record
-- of the same machine.
local function without_known(rec, before)
  local short, events = {}, rec.events
  for key, value in order.each(rec) do -- any order: independent entries
    if not SHORT[key] then short[key] = value end
  end
  if not same(events, before.sent) then short.events = events or NONE end
  if rec.leaf ~= before.leaf or rec.done ~= before.done then
    short.leaf, short.done = rec.leaf or false, rec.done
  end
  local is_told = short.leaf ~= nil
  if not same(rec.sent, is_told and usual(rec.leaf, rec.done) or nil) then
    short.sent = rec.sent or NONE
  end
  return short
end

local function shorten(rec, all)
  local short = without_known(rec, last_of(all, rec))
  if rec.inner then short.inner = each_of(shorten, rec.inner, all) end
  all[rec.m or 0] = rec
  return short
end

local function list_or_nil(list) return list[1] ~= nil and list or nil end

local function lengthen(short, all)
  local rec, before = {}, last_of(all, short)
  for key, value in order.each(short) do rec[key] = value end -- any order: a copy
  local is_told = short.leaf ~= nil
  rec.events = list_or_nil(short.events or before.sent or NONE)
  if is_told then
    rec.leaf = short.leaf or nil
  else
    rec.leaf, rec.done = before.leaf, before.done
  end
  rec.sent = list_or_nil(short.sent or is_told and usual(rec.leaf, rec.done) or NONE)
  if short.inner then rec.inner = each_of(lengthen, short.inner, all) end
  all[rec.m or 0] = rec
  return rec
end

-- Write ---------------------------------------------------------------------------

--- Return a record as a line of JSON.
journal.encode = exact_json.encode

--- Return a function f(rec) that writes a record to a stream; `rec` nil ends the run.
function journal.writer(stream)
  local before, number = {}, 0
  return function(rec)
    local line = rec or { ["end"] = number }
    if line.record then
      before, number = {}, 0
    elseif rec then
      line, number = shorten(rec, before), number + 1
      line.n = number
    end
    stream:write(journal.encode(line), "\n")
    if stream.flush then stream:flush() end
  end
end

--- Open a file to append a run. An incomplete last line is ended with a newline.
function journal.open(name)
  local old = io.open(name, "rb")
  local is_cut = old and old:seek("end", -1) and old:read(1) ~= "\n"
  if old then old:close() end
  local file, problem = io.open(name, "a")
  if file and is_cut then file:write("\n") end
  return file, problem
end

-- Read ----------------------------------------------------------------------------

--- A run in a file.
---@class rfsm.record.Run
---@field [integer] table the decoded lines of the run
---@field is_cut boolean true if the last line is incomplete
---@field has_end boolean true if the run was stopped and no line is missing

-- Adds a decoded line to a run: a record, or the end of the run.
local function add_record(run, value)
  if type(value) ~= "table" then
    error(("record %d: table expected, got %s"):format(#run + 1, type(value)), 0)
  end
  local last = value["end"]
  local number = last and last + 1 or value.n
  if number ~= #run then
    error(("record %d is missing: record %s comes in its place"):format(#run,
      rfsm.text_of(number)), 0)
  end
  value.n = nil
  if last then run.has_end = true else run[#run + 1] = value end
end

-- Adds a line to the runs. After a line that is no JSON only a header may follow.
local function add_line(runs, line, number)
  local json = opts.need("rfsm.record", "dkjson")
  local value, _, problem = json.decode(line, 1, nil)
  local run = runs[#runs]
  if type(value) == "table" and value.record then
    runs[#runs + 1] = { value, is_cut = false, has_end = false }
  elseif runs.problem or not (problem or run) then
    error(runs.problem or ("line %d: header expected"):format(number), 0)
  elseif problem then
    runs.problem = ("no JSON: %s at line %d"):format(problem, number)
    if run then run.is_cut = true end
    return
  else
    add_record(run, value)
  end
  runs.problem = nil
end

local function split(text)
  local runs, number = {}, 0
  for line in (text .. "\n"):gmatch("(.-)\r?\n") do
    number = number + 1
    if line:find("%S") then add_line(runs, line, number) end
  end
  if not runs[1] then error(runs.problem or "no recording", 0) end
  return runs
end

local function expand(run)
  local before, list = {}, {}
  for i, rec in ipairs(run) do list[i] = i > 1 and lengthen(rec, before) or rec end
  return list
end

--- Return the records of run `number` (default: the last run) in a file. Raises an
-- error if the file cannot be read, a line is no record, or there is no such run.
function journal.read(name, number)
  local text, problem = files.read(name)
  if not text then error(problem, 0) end
  local runs = split(text)
  local run = runs[number or #runs]
  if not run then
    error(("run: number from 1 to %d expected, got %s"):format(#runs,
      rfsm.text_of(number)), 0)
  end
  return expand(run), { runs = #runs, is_cut = run.is_cut,
    has_end = run.has_end }
end

return journal
