--- Descriptions: the tables from which systems are made, and the checks of the tables.
--
-- The checks append problems to a list and raise no error. No callback runs.
--
-- @module rfsm.system.description
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local alphabet = require "rfsm.shared.alphabet"
local calls = require "rfsm.shared.calls"
local code = require "rfsm.shared.code"
local files = require "rfsm.shared.files"
local location = require "rfsm.shared.location"
local match = require "rfsm.shared.match"
local names = require "rfsm.observe.names"
local opts = require "rfsm.shared.options"
local replacements = require "rfsm.explore.replacements"

local io, ipairs, next = rawget(_G, "io"), ipairs, next
local select, type = select, type
local concat, huge = table.concat, math.huge

local description = {}

--- The parts of a description that have been read, and the problems found.
---@class rfsm.system.Draft
---@field file? string
---@field lines table<string|integer, integer> line of each machine name and wire number
---@field problems string[]
---@field models table<string, rfsm.State> charts by the names of machines
---@field machines table<string, rfsm.Machine> machines for the checks; they never run

local function place_of(draft, key)
  local line = draft.lines[key]
  return draft.file and draft.file .. (line and ":" .. line or "") or ""
end

local function add(draft, key, text, place)
  place = place or place_of(draft, key)
  draft.problems[#draft.problems + 1] = place .. (place ~= "" and ": " or "") .. text
end

-- Lines: from the text of the file, since a table does not know its lines --------

local function line_at(text, at)
  return select(2, text:sub(1, at - 1):gsub("\n", "")) + 1
end

local function blank(text) return (text:gsub("[^\n]", " ")) end

-- Notes the lines of the wires, if the text has as many tables as `list` has wires.
local function note_wires(lines, text, at, list)
  local from, wires = text:match("^%s*()(%b{})", at)
  local found = {}
  for offset in (wires or ""):sub(2, -2):gmatch("()%b{}") do
    found[#found + 1] = line_at(text, from + offset)
  end
  for i = 1, wires and #found == #list and #list or 0 do lines[i] = found[i] end
end

-- Notes the lines of fields. Reports names that occur twice: Lua keeps only the last.
local function note_fields(draft, text, at, fields)
  local lines = draft.lines
  for offset, name in fields:gmatch("()%f[%w_]([%a_][%w_]*)%s*=%f[^=]") do
    local line = line_at(text, at + offset)
    if lines[name] then
      add(draft, name, ("two machines are named '%s', the first one is lost (the "
        .. "second is in line %d)"):format(name, line))
    end
    lines[name] = lines[name] or line
  end
end

-- Notes the lines of machines by name, and the lines of wires by number. The table that
-- has the field `wires` is taken for the description.
local function note_lines(draft, list)
  local text = code.of(draft.file and io and files.read(draft.file) or "")
  for at, whole in text:gmatch("()(%b{})") do
    local fields = whole:sub(2, -2):gsub("%b{}", blank):gsub("%b()", blank)
    local behind = fields:match("%f[%w_]wires%s*=()")
    if behind then
      note_wires(draft.lines, text, at + behind, list)
      return note_fields(draft, text, at, fields)
    end
  end
end

--- Return true if a machine has this name; false and the problem otherwise.
function description.is_name(models, name)
  if type(name) == "string" and models[name] then return true end
  return false, ("no machine is named '%s'%s"):format(rfsm.text_of(name),
    advice.nearest_name(rfsm.text_of(name), rfsm.sorted_keys(models)))
end

-- Machines ------------------------------------------------------------------------

local function check_chart(draft, name, model)
  draft.models[name] = rfsm.model_of(model)
  local fsm, _, problems = calls.silently(calls.init_apart, draft.models[name])
  draft.machines[name] = fsm or nil
  for _, text in ipairs(problems or {}) do
    local file, rest = location.split(text)
    add(draft, name, name .. ": " .. rest, file:match("^(.+): $"))
  end
end

-- Returns a hint for a field whose value is not a chart.
local function hint_for(name, value)
  if advice.is_near(name, "wires") then return " (did you mean 'wires'?)" end
  return type(value) == "string" and (" (did you mean system.load '%s'?)"):format(value)
    or ""
end

local function check_machines(draft, given)
  for _, name in ipairs(rfsm.sorted_keys(given)) do
    local value = given[name]
    if type(name) ~= "string" then
      add(draft, nil, ("[%s]: a machine has a name, as in { arm = system.load "
        .. "'arm.lua' }"):format(rfsm.text_of(name)))
    elseif name ~= "wires" and not rfsm.is_state(value) then
      add(draft, name, ("%s: chart expected, %s%s"):format(name, opts.got(value),
        hint_for(name, value)))
    elseif name ~= "wires" then
      check_chart(draft, name, value)
    end
  end
  if not (next(draft.models) or draft.problems[1]) then
    add(draft, nil, "a system has at least one chart")
  end
end

-- Wires ---------------------------------------------------------------------------

-- Is the value a list of names, at least one, each of them once?
local function is_event_list(x)
  local seen = {}
  for i, name in ipairs(type(x) == "table" and x or {}) do
    if not opts.is_text(name) then
      return false, ("[%d]: name of an event expected, %s"):format(i, opts.got(name))
    elseif seen[name] then
      return false, ("[%d]: '%s' is there twice"):format(i, name)
    end
    seen[name] = true
  end
  return next(seen) ~= nil
end

local READ = "how many events '%s' takes at once is said by its chart: %s = \"one\" in "
  .. "the root, not by a wire"

-- Returns a table: for each field of a wire a description, a test, and the default.
local function fields_of(draft)
  local function is_name(x) return description.is_name(draft.models, x) end
  return {
    from = { "name of a machine", is_name }, to = { "name of a machine", is_name },
    event = { "name of an event", opts.is_text },
    events = { "list of events", is_event_list },
    kind = { "'buffer' or 'data'", function(x) return x == "buffer" or x == "data" end,
      "buffer" },
    size = { "whole number from 1", opts.is_whole(1, huge), 16 },
  }
end

-- Reports the fields that are missing, or that exclude each other.
local function check_together(report, fields, wire, given)
  for _, name in ipairs { "from", "to" } do
    if given[name] == nil then
      report((".%s: %s expected"):format(name, fields[name][1]))
    end
  end
  if given.event == nil and given.events == nil then
    report(".event: name of an event expected, or events = { ... }")
  elseif given.event ~= nil and given.events ~= nil then
    report(".events: a wire has event or events, not both")
  end
  if wire.kind == "data" and given.size ~= nil then
    report(".size: data is one event, a buffer has a size")
  end
end

-- Returns a wire with its defaults. Wrong fields are reported and left out.
local function read_wire(report, fields, given)
  local wire = opts.read(fields, {})
  for _, name in ipairs(rfsm.sorted_keys(given)) do
    local right, problem = opts.read(fields, { [name] = given[name] })
    if right then
      wire[name] = right[name]
    elseif name == "read" then
      report(".read: " .. READ:format(rfsm.text_of(given.to or "a machine"), name))
    else
      report((fields[name] and "." or ": ") .. problem)
    end
  end
  check_together(report, fields, wire, given)
  if wire.kind == "data" then wire.size = 1 end
  wire.events, wire.event = wire.events or { wire.event }, nil
  return wire
end

-- Reports an event that the sender does not emit, or to which the reader has nothing.
local function check_event(draft, report, wire, event)
  local sender, reader = draft.machines[wire.from], draft.machines[wire.to]
  if not (sender and reader) then return end
  local emitted = replacements.emitted_by(sender)
  if emitted and not match.has(emitted, event) then
    report((".event: nothing in '%s' emits '%s'%s"):format(wire.from, event,
      advice.nearest_name(event, emitted)))
  end
  if not (alphabet.of_all(reader).takes_any or names.is_event(reader, event)) then
    report((".event: no transition of '%s' has the event '%s'%s"):format(wire.to,
      event, advice.nearest_name(event, names.events(reader))))
  end
end

-- Reports an event that another wire carries between the same two machines: it would
-- come twice.
local function check_pair(draft, report, wire, event)
  for _, other in ipairs(draft.wires) do
    if other.from == wire.from and other.to == wire.to
      and match.has(other.events, event) then
      report((".event: wires[%s] carries '%s' from '%s' to '%s' already"):format(
        rfsm.text_of(other.number), event, wire.from, wire.to))
    end
  end
end

local function check_wire(draft, fields, i, given)
  local function report(text)
    add(draft, i, ("wires[%s]%s"):format(rfsm.text_of(i), text))
  end
  if type(given) ~= "table" then
    return report(": table expected, " .. opts.got(given))
  end
  local wire = read_wire(report, fields, given)
  wire.number, wire.location = i, place_of(draft, i)
  for _, event in ipairs(wire.from and wire.to and wire.events or {}) do
    check_event(draft, report, wire, event)
    check_pair(draft, report, wire, event)
  end
  draft.wires[#draft.wires + 1] = wire
end

local function check_wires(draft, list)
  local fields = fields_of(draft)
  if type(list) ~= "table" then
    return add(draft, "wires", "wires: list expected, " .. opts.got(list))
  end
  for _, i in ipairs(rfsm.sorted_keys(list)) do
    check_wire(draft, fields, i, list[i])
  end
end

--- Read a description. If it is wrong, return nil and all its problems as one text.
---@param given any
---@param file? string file that has the description
---@return table? parts the fields names, models, wires, file and places
---@return string? text the problems
---@return string[]? problems
function description.read(given, file)
  if type(given) ~= "table" or rfsm.is_fsmobj(given) then
    return nil, "rfsm.system: table of machines expected, " .. opts.got(given)
  end
  local draft = { file = file, problems = {}, models = {}, machines = {}, wires = {},
    lines = {} }
  local list = given.wires == nil and {} or given.wires
  note_lines(draft, list)
  check_machines(draft, given)
  check_wires(draft, list)
  if draft.problems[1] then
    return nil, ("rfsm.system: the system has %d problem%s\n  %s"):format(
      #draft.problems, draft.problems[2] and "s" or "", concat(draft.problems,
      "\n  ")), draft.problems
  end
  local names_of, places = rfsm.sorted_keys(draft.models), {}
  for _, name in ipairs(names_of) do places[name] = place_of(draft, name) end
  return { names = names_of, models = draft.models, wires = draft.wires, file = file,
    places = places }
end

return description
