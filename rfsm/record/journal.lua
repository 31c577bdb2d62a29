--- Files of recordings. Each run in a file is a header and a JSON line for each record.
--
-- A line omits the fields that follow from the lines before: queued events, a leaf that
-- has not changed, the completion of a leaf. This makes the file a third as long. Each
-- line has a number `n`, and the line that ends a run has the last number, so that a
-- missing line is noticed, and a check sum. The last line of a run may be incomplete.
-- A file is read line by line, so that it may be larger than the memory.
--
-- @module rfsm.record.journal
-- @license BSD-3-Clause

local exact_json = require "rfsm.shared.exact_json"
local opts = require "rfsm.shared.options"
local rfsm = require "rfsm"
local sums = require "rfsm.shared.sums"
local tracks = require "rfsm.record.track"
local order = require "rfsm.shared.order"

local error, io, select = error, io, select
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
  if rec.inner then short.inner = order.map(rec.inner, shorten, all) end
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
  if short.inner then rec.inner = order.map(short.inner, lengthen, all) end
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
    stream:write(sums.add(journal.encode(line)), "\n")
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

--- How the reading of a run has ended.
---@class rfsm.record.About
---@field runs integer how many runs the file has
---@field is_cut boolean the last line is incomplete, and was left out
---@field has_end boolean the run was stopped and no line is missing

local function fail(form, ...) error(form:format(...), 0) end

-- A problem is without its place: the text is one line.
local function decode(text)
  local value, _, problem = opts.need("rfsm.record", "dkjson").decode(text)
  return value, problem and problem:gsub(" at line 1, column %d+$", "")
end

-- Returns the header in a line; nil if it is another line. A line of a run has the
-- field `record` only in its data.
local function header_of(line)
  local value = line:find('"record":', 1, true) and decode(line)
  return type(value) == "table" and value.record and value or nil
end

-- Returns a function that returns the next line of a file that is not empty, and its
-- number; nil at the end. It begins in line `first`.
local function lines_of(file, first)
  local number = 0
  file:seek("set")
  return function()
    local line, problem
    repeat
      line, problem = file:read("*l")
      number = number + 1
    until not line or number >= first and line:find("%S")
    if problem then error(problem, 0) end
    return line, number
  end
end

-- Returns the numbers of the lines in which the runs of a file begin.
local function find_runs(file)
  local runs = {}
  for line, number in lines_of(file, 1) do
    if header_of(line) then runs[#runs + 1] = number end
  end
  if runs[1] then return runs end
  local line, number = lines_of(file, 1)()
  local problem = line and select(2, decode(line))
  if problem then fail("no JSON: %s at line %d", problem, number) end
  fail(line and "line %d: header expected" or "no recording", number)
end

-- Returns the value of a line, and whether the line has a check sum. If the line is
-- damaged, returns nil and the problem.
local function value_of(line, number)
  local text, has_sum = sums.remove(line)
  if not text then return nil, ("line %d: %s"):format(number, has_sum) end
  local value, problem = decode(text)
  if problem then return nil, ("no JSON: %s at line %d"):format(problem, number) end
  return value, has_sum
end

-- Checks the value of a line, which has to be record `count`, or the end of the run.
-- Returns the record; nil at the end.
local function record_of(value, count)
  if type(value) ~= "table" then
    fail("record %d: table expected, got %s", count + 1, type(value))
  end
  local last = value["end"]
  local number = last and last + 1 or value.n
  if number ~= count then
    fail("record %d is missing: record %s comes in its place", count,
      rfsm.text_of(number))
  end
  value.n = nil
  return not last and value or nil
end

-- Returns the value of the next line of a run; nil if the run has ended. A damaged line
-- is the last one if it was cut off.
local function next_value(run)
  local line, number = run.next_line()
  if not line or header_of(line) then return nil end
  local value, has_sum = value_of(line, number)
  if value ~= nil and has_sum == run.has_sums then return value end
  local problem = value == nil and has_sum or ("line %d: a check sum %s"):format(number,
    has_sum and "in a run without them" or "expected")
  local after = run.next_line()
  if after and not header_of(after) or value ~= nil then error(problem, 0) end
  run.about.is_cut = true
end

-- Returns the header of a run, and a function that returns the next record.
local function open_run(run)
  local before, count = {}, 0
  local header, has_sums = value_of(run.next_line())
  if not header then error(has_sums, 0) end
  run.has_sums = has_sums
  return header, function()
    local value = next_value(run)
    if value == nil then return nil end
    count = count + 1
    local rec = record_of(value, count)
    run.about.has_end = not rec
    if rec then return lengthen(rec, before) end
    local line, number = run.next_line()
    if line and not header_of(line) then fail("line %d: header expected", number) end
  end
end

local function choose(runs, number)
  return runs[number or #runs] or fail("run: number from 1 to %d expected, got %s",
    #runs, rfsm.text_of(number))
end

--- Return the header of run `number` (default: the last run) in a file, a function that
--- returns the next record, or nil at the end, and what it has found out about the run.
--- Both raise an error if the file cannot be read, a line is damaged or missing.
function journal.reader(name, number)
  local file, problem = io.open(name, "rb")
  if not file then error(problem, 0) end
  local runs = find_runs(file)
  local about = { runs = #runs, is_cut = false, has_end = false }
  local run = { about = about, next_line = lines_of(file, choose(runs, number)) }
  local header, next_record = open_run(run)
  return header, function()
    local rec = file and next_record()
    if not rec and file then file = file:close() and nil end
    return rec or nil
  end, about
end

--- Return the same of a recording that is a list.
function journal.reader_of(recording)
  local at = 1
  return recording[1], function()
    at = at + 1
    return recording[at]
  end
end

--- Return the records of a run in a list, and what is known about it.
function journal.read(name, number)
  local header, next_record, about = journal.reader(name, number)
  local list = { header }
  for rec in next_record do list[#list + 1] = rec end
  return list, about
end

return journal
