--- `rfsm fleet URL VERB ...`: look after machines in Redis.
--
-- @module rfsm.cli.fleet
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local chart = require "rfsm.shared.chart"
local codec = require "rfsm.server.codec"
local common = require "rfsm.cli.common"
local files = require "rfsm.shared.files"
local opts = require "rfsm.shared.options"
local rfsm = require "rfsm"
local typed = require "rfsm.shared.typed"
local verbs = require "rfsm.server.verbs"

local concat = table.concat
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local command = {}

-- Returns the result of f(...), which asks a server. If it fails, ends the program with
-- the reason in one line, and a note behind it; with this status if f returns nil or
-- false and the problem.
local function ask_or_end(status, note, f, ...)
  local ok, result, problem = pcall(f, ...)
  if not ok then common.fail(chart.first_line(result) .. note) end
  return result
    or common.fail(chart.first_line(problem or "it is not there") .. note, status)
end

local function ask(f, ...) return ask_or_end(1, "", f, ...) end

--- The same with status 1.
command.ask = ask

-- The verbs of both servers, and those that only this command has; those that write and
-- note who has done it.
local VERBS, NOTES = { again = { usage = "TAG ID" }, dead = { usage = "[LIMIT]" },
  drop = { usage = "TAG ID" }, list = { usage = "" } }, {}
verbs.map(function(verb)
  VERBS[verb.name] = verb.usage and verb or nil
  NOTES[verb.name] = verb.by and not verb.reads or nil
end)

-- Returns the lines of a reply: one with the key, if it is given, the leaf, and the
-- outcome, or what was done, then one per error.
local function lines_of(reply, verb, key)
  local what = NOTES[verb] and reply.outcome or reply.mode .. " " .. reply.outcome
  local lines = { (key and key .. " " or "") .. reply.leaf .. " " .. what }
  for _, text in ipairs(reply.errors) do lines[#lines + 1] = "error: " .. text end
  return lines
end

-- Returns the key that a machine has in Redis, if it is not the one that was typed.
local function other_key(fleet, key)
  local whole = fleet:key_of(key)
  return whole ~= key and whole or nil
end

-- Returns the number that a person has typed; nil if none was.
local function number_of(text)
  return text and (rfsm.number_of(text)
    or common.fail(("a number expected, got '%s'"):format(text)))
end

local ALL = 1000000 -- entries: the greatest number that is asked for

-- For each verb that is not for many a function that returns lines to print, and maybe
-- a note. It gets the options and the arguments.
local LINES = {}

function LINES.dead(fleet, _, limit)
  local lines = {}
  for i, entry in ipairs(ask(fleet.dead, fleet, number_of(limit) or ALL)) do
    lines[i] = concat({ entry.tag, entry.id, entry.machine, entry.what, entry.data,
      "x" .. entry.deliveries, entry.error }, " ")
  end
  return lines
end

function LINES.get(fleet, _, key)
  local view, lines = ask(fleet.get, fleet, key), {}
  for i, name in ipairs(rfsm.sorted_keys(view)) do
    local value = view[name]
    local is_empty = type(value) == "table" and next(value) == nil and name ~= "data"
    lines[i] = name .. ": " .. (is_empty and "[]"
      or type(value) == "table" and codec.encode(value) or rfsm.text_of(value))
  end
  return lines
end

-- Returns a list of a machine. If it is empty since there is no such machine, ends the
-- program: a misspelt key must not look like a machine without errors.
local function list_of(f, fleet, key, count)
  local list = ask(f, fleet, key, count)
  if not list[1] then ask(fleet.get, fleet, key) end
  return list
end

function LINES.history(fleet, _, key, count)
  local lines = {}
  for i, move in ipairs(list_of(fleet.history, fleet, key, count)) do
    local by = move.from == "" and "(create):"
      or typed.shown(move.event) .. ": " .. move.from
    lines[i] = ("%s %s -> %s"):format(rfsm.number_text(move.time, "%.3f"), by, move.to)
  end
  return lines
end

function LINES.cancel(fleet, _, key, id)
  ask(fleet.cancel, fleet, key, id)
  return { key .. " " .. id .. " (cancel)" }
end

function LINES.log(fleet, _, key, count)
  local lines = {}
  for i, line in ipairs(list_of(fleet.log, fleet, key, count)) do
    lines[i] = rfsm.number_text(line.time, "%.3f") .. " " .. line.error
  end
  return lines
end

function LINES.versions(fleet)
  local lines = {}
  for i, version in ipairs(ask(fleet.versions, fleet)) do
    lines[i] = ("%s %s %s %d"):format(version.chart, version.known, version.version,
      version.count)
  end
  return lines
end

function LINES.why(fleet, _, key, text)
  return ask(fleet.why, fleet, key, common.try(typed.read(text)))
end

function LINES.send(fleet, options, key, text, id)
  local event = common.try(typed.read(text))
  return lines_of(ask(fleet.send_by, fleet, options.by, id, key, event), "send",
    other_key(fleet, key))
end

function LINES.reindex(fleet)
  return { opts.counted(ask(fleet.reindex, fleet), "machine") }
end

-- One machine as a file ------------------------------------------------------------

function LINES.pull(fleet, _, key, file)
  local text = ask(fleet.pull, fleet, key)
  if not file then return { (text:gsub("\n$", "")) } end
  common.try(files.replace(file, text))
  return {}
end

-- Returns the lines of a reply. If the server refuses, ends the program with status 2:
-- nothing was moved.
local function moved_lines(fleet, verb, key, ...)
  return lines_of(ask_or_end(2, "", fleet[verb], fleet, key, ...), verb,
    NOTES[verb] and key or other_key(fleet, key))
end

function LINES.push(fleet, options, key, file)
  return moved_lines(fleet, "push", key, common.read(file), options.if_version,
    options.by)
end

-- Returns the name and the value in FIELD=VALUE.
local function assignment_of(text)
  local field, value_text = text:match("^%s*([^=]-)%s*=(.*)$")
  if not field then common.fail(("FIELD=VALUE expected, got '%s'"):format(text), 2) end
  local value, problem = typed.value(value_text)
  if problem then common.fail(problem, 2) end
  return field, value
end

function LINES.set(fleet, options, key, assignment)
  local field, value = assignment_of(assignment)
  return moved_lines(fleet, "set", key, field, value, options.by, options.force)
end

function LINES.create(fleet, _, key, name, ...)
  local data = {}
  for _, text in ipairs { ... } do
    local field, value = assignment_of(text)
    if data[field] ~= nil then common.fail(("'%s' is there twice"):format(field), 2) end
    data[field] = value
  end
  return moved_lines(fleet, "create", key, name, data)
end

-- Many machines --------------------------------------------------------------------

local VERSIONS = { broken = true, bundled = true, gone = true, newest = true }

-- Returns a hint for a version that no machine has, or else for a chart or a state that
-- the library has not; else "".
local function hint_for(fleet, name, state, version)
  if version and not VERSIONS[version] and not version:find "^%x+%-%x+$" then
    return advice.nearest_name(version, rfsm.sorted_keys(VERSIONS))
  end
  return advice.in_library(fleet:charts() or {}, name, state)
end

-- The filters, and the text that a message has of their values.
local FILTERS = { age = "SECONDS", chart = "NAME", held = "yes or held=no",
  key = "PATTERN", reason = "TEXT", state = "STATE", version = "VERSION" }
local NAMES = rfsm.sorted_keys(FILTERS)

-- Is it a value of a filter? For a server, an empty one means all machines.
local function is_value(name, value)
  if name == "age" then return value:find "^%d+$" end
  if name == "held" then return value == "yes" or value == "no" end
  return value ~= ""
end

-- Returns the filter that a text such as "chart=order,age=60" means; nil and the
-- problem if it is wrong. A comma may be in a value.
local function filter_of(text)
  local filter, name = {}, nil
  for part in text:gmatch("[^,]+") do
    local found, value = part:match("^%s*(%a+)=(.*)$")
    if filter[found] then
      return nil, ("--where: '%s' is there twice"):format(found)
    elseif FILTERS[found] then
      name, filter[found] = found, value
    elseif found or not name then
      return nil, ("--where: %s= expected, got '%s'%s"):format(concat(NAMES, "=, "),
        part, found and advice.nearest_name(found, NAMES) or "")
    else
      filter[name] = filter[name] .. "," .. part
    end
  end
  for _, found in ipairs(rfsm.sorted_keys(filter)) do
    if not is_value(found, filter[found]) then
      return nil, ("--where: %s=%s expected, got '%s'"):format(found, FILTERS[found],
        filter[found])
    end
  end
  return next(filter) and filter or nil, "--where: a filter expected"
end

-- Returns the machines that a filter lets through, each with a text for a line.
local function find_machines(fleet, filter)
  local found, problem = fleet:select(filter)
  for _, one in ipairs(found or {}) do
    one.text = ("%s %s %s %s%s%s%s"):format(one.key, one.chart, one.leaf, one.known,
      one.seconds and " " .. rfsm.number_text(one.seconds, "%d") .. " s" or "",
      one.held and " held" or "", one.reason and ": " .. one.reason or "")
  end
  return found, problem
end

-- Returns the keys of the machines whose entries are meant; nil if all are.
local function keys_for(fleet, filter)
  local keys, of = {}, {}
  for _, name in ipairs(NAMES) do of[name] = name ~= "age" and filter[name] or nil end
  if not next(of) then return nil end
  local found, problem = fleet:select(of)
  if not found then error(problem, 0) end
  for _, one in ipairs(found) do keys[one.key] = true end
  return keys
end

-- Returns the dead entries of machines that a filter lets through. They are so old.
local function find_dead(fleet, filter)
  local found, keys, age = {}, keys_for(fleet, filter), tonumber(filter.age or 0)
  local time = age > 0 and os.time() - age or math.huge
  for _, entry in ipairs(fleet:dead(ALL)) do
    if (not keys or keys[entry.machine])
      and tonumber(entry.id:match("^%d+")) / 1000 <= time then
      entry.text = concat({ entry.tag, entry.id, entry.machine, entry.what }, " ")
      found[#found + 1] = entry
    end
  end
  return found
end

-- Returns how many arguments a verb has at most, and how many it needs.
local function number_in(usage)
  local _, most = usage:gsub("%S+", "")
  local _, needed = usage:gsub("%[.*", ""):gsub("%S+", "")
  return usage:find("...", 1, true) and ALL or most, needed
end

-- For each verb that takes filters, how the items are found.
local MANY = { again = find_dead, drop = find_dead }
verbs.map(function(verb) MANY[verb.name] = verb.bulk and find_machines or nil end)

-- Calls the function of a verb for one item.
local function act(fleet, options, one)
  local name, arguments = options.verb, options.arguments
  if one.tag then return fleet[name](fleet, one.tag, one.id) end
  local count = number_in(VERBS[name].usage)
  arguments[count] = options.by -- behind those that may be absent
  return fleet[name](fleet, one.key, unpack(arguments, 1, count))
end

-- Returns the machine at a key, as a list. It is looked at only if its line is shown:
-- also one that is broken can be held, and removed.
local function machine_at(fleet, options, key)
  local one = { key = key, text = key }
  if options.dry_run or options.verb == "remove" then
    local view, problem = fleet:get(key)
    if options.dry_run and not view then return nil, problem end
    one.text = view and concat({ key, view.chart, view.leaf }, " ") or key
  end
  return { one }
end

-- Returns the item that the first arguments of a verb name, as a list, and takes these
-- arguments away.
local function find_named(fleet, options)
  local first = table.remove(options.arguments, 1)
  if MANY[options.verb] == find_machines then
    return machine_at(fleet, options, first)
  end
  local id = table.remove(options.arguments, 1)
  for _, entry in ipairs(find_dead(fleet, {})) do
    if entry.tag == first and entry.id == id then return { entry } end
  end
end

-- Returns the line that tells what was done with an item.
local function line_of(options, one, result)
  if result == true then return one.text .. " (" .. options.verb .. ")" end
  return concat(lines_of(result, options.verb, one.key),
    options.where and "; " or "\n")
end

-- Does a verb for one item. Returns the result; or false and the problem, nil and the
-- problem if there was no answer.
local function try(fleet, options, one)
  local ok, result, problem = pcall(act, fleet, options, one)
  if not ok then return nil, chart.first_line(result) end
  return result, problem or "it is not there"
end

-- Does a verb for all items, prints what was done, and returns for how many. Ends the
-- program if the problem is not that of one machine: then the server is lost.
local function do_all(fleet, options, found)
  local count, is_many = 0, options.where
  for _, one in ipairs(found) do
    local result, problem = try(fleet, options, one)
    if result then
      common.write("-", line_of(options, one, result) .. "\n")
      count = count + 1
    elseif result ~= false and problem ~= "no machine"
      and not problem:find "^ERR rfsm_" then
      common.fail((is_many and ("%d of %d done, then: "):format(count, #found) or "")
        .. problem)
    else
      common.warn((is_many and one.text .. ": " or "") .. problem)
    end
  end
  return count
end

-- Returns the text behind the number of machines: how many are in each state.
local function counts_of(found)
  local counts, texts = {}, {}
  for _, one in ipairs(found) do
    local place = one.chart .. " " .. one.leaf
    counts[place] = (counts[place] or 0) + 1
  end
  for i, place in ipairs(rfsm.sorted_keys(counts)) do
    texts[i] = (i > 1 and ", " or ": ") .. place .. " " .. counts[place]
  end
  return concat(texts)
end

-- Prints lines, and on stderr a note about them.
local function print_lines(lines, note)
  for _, line in ipairs(lines) do common.write("-", line .. "\n") end
  if note then common.warn(note) end
end

local function texts_of(found)
  local lines = {}
  for i, one in ipairs(found) do lines[i] = one.text end
  return lines
end

function LINES.list(fleet, options)
  local filter = options.where or {}
  local found = ask(find_machines, fleet, filter)
  return texts_of(found), opts.counted(#found, "machine") .. (found[1]
    and counts_of(found) or hint_for(fleet, filter.chart, filter.state, filter.version))
end

-- Does a verb for all machines or entries that are meant, or, dry, shows them. Returns
-- the status: 1 if one was refused.
local function do_many(fleet, options)
  local find, filter = MANY[options.verb], options.where
  local found = ask_or_end(1, "; nothing was done", filter and find or find_named,
    fleet, filter or options)
  if not found[1] then
    common.fail(("no %s is like that, so nothing was done%s"):format(find == find_dead
      and "entry" or "machine", hint_for(fleet, filter.chart, filter.state,
      filter.version)), 2)
  elseif options.dry_run then
    return print_lines(texts_of(found), ("%d found, nothing was done"):format(#found))
  end
  local count = do_all(fleet, options, found)
  if filter then common.warn(("%d of %d done"):format(count, #found)) end
  return count < #found and 1 or 0
end

-- Single verbs ----------------------------------------------------------------------

-- Returns a time. With + it is so many seconds from now.
local function time_of(text)
  return number_of(text) + (text:find("^%+") and os.time() or 0)
end

-- Returns keys, and the note that there may be more than were asked for.
local function limited(keys, limit)
  return keys, #keys >= (limit or 100)
    and ("the first %d, there may be more: give a greater LIMIT"):format(#keys) or nil
end

-- Nothing is printed if nothing is found, so a misspelt name looks like good news.
function LINES.find(fleet, _, name, state, limit, seconds)
  limit = number_of(limit)
  local keys = ask(fleet.find, fleet, name, state, limit, seconds)
  if keys[1] then return limited(keys, limit) end
  return keys, ("0 machines of chart '%s' are in '%s'%s%s"):format(name, state,
    seconds and " for so long" or "", hint_for(fleet, name, state))
end

function LINES.due(fleet, _, limit, time)
  limit = number_of(limit)
  return limited(ask(fleet.due, fleet, limit, time and time_of(time)), limit)
end

function LINES.charts(fleet)
  local charts, lines = ask(fleet.charts, fleet), {}
  for _, name in ipairs(rfsm.sorted_keys(charts)) do
    for _, path in ipairs(charts[name]) do lines[#lines + 1] = name .. " " .. path end
  end
  return lines
end

-- Returns the verbs with their arguments, those with the same ones together, in as few
-- lines as possible, so that the help fits a terminal.
local function help()
  local groups, by_usage, lines = {}, {}, { "Verbs:" }
  for _, name in ipairs(rfsm.sorted_keys(VERBS)) do
    local usage = VERBS[name].usage
    if not by_usage[usage] then
      by_usage[usage] = { usage = usage }
      groups[#groups + 1] = by_usage[usage]
    end
    local group = by_usage[usage]
    group[#group + 1] = name
  end
  for _, group in ipairs(groups) do
    local text = "   " .. concat(group, " ") .. (group.usage ~= "" and " " or "")
      .. group.usage
    local at = 2
    while lines[at] and #lines[at] + #text > 79 do at = at + 1 end
    lines[at] = (lines[at] or "") .. text
  end
  return concat(lines, "\n")
end

command.summary = "Look after machines in Redis."
command.epilog = help()

-- Returns a verb; nil and the problem if there is no such verb. (A list of choices
-- would be one long line of the help.)
local function verb_of(word)
  if VERBS[word] then return word end
  return nil, ("there is no verb '%s'%s"):format(word,
    advice.nearest_name(word, rfsm.sorted_keys(VERBS)))
end

function command.add_arguments(parser)
  parser:summary(command.summary)
  parser:description(command.summary .. " Numbers of all: rfsm redis --stats URL")
  parser:argument("url", "of the server, or a node of the cluster"):argname("URL")
  parser:argument("verb", "what to do, see below"):convert(verb_of):argname("VERB")
  parser:argument("arguments", "of the verb; KEY is a whole key, with its {tag}")
    :args("*"):argname("ARGUMENT")
  common.add_number(parser, "--tags", "hash tags of short keys (64)",
    opts.whole(1, 16384))
  parser:option("--where", "many: key= chart= state= version= age= held= reason=")
    :argname("FILTER"):convert(filter_of)
  parser:flag("--dry-run", "show what is meant, do nothing")
  common.add_number(parser, "--if-version", "push: refuse another revision",
    opts.whole(0, 2 ^ 53))
  parser:option("--by", "who changes it, for the history (you)"):argname("NAME")
  parser:flag("--force", "set: take a value of another kind")
end

--- Return the client of a fleet, or end the program if there is no server.
function command.connect(url, options)
  if url:find "^postgres" then
    common.fail("PostgreSQL has functions in place of this command, such as SELECT * "
      .. "FROM rfsm.get('KEY')", 2)
  end
  return ask(require("rfsm.fleet").connect, url, options)
end

-- Verbs that look at all hash tags, also at those that no short key has.
local WIDE = { again = true, dead = true, drop = true, due = true, find = true }

-- Options that only some verbs take.
local TAKERS = { by = setmetatable({ send = true }, { __index = NOTES }),
  dry_run = MANY, force = { set = true },
  if_version = { push = true },
  where = setmetatable({ list = true }, { __index = MANY }) }

local function check_options(options, parser)
  local name = options.verb
  for _, option in ipairs(rfsm.sorted_keys(TAKERS)) do
    if options[option] and not TAKERS[option][name] then
      parser:error(("%s takes no --%s"):format(name, (option:gsub("_", "-"))))
    end
  end
end

-- The number of arguments of a verb. A filter stands in place of KEY, or of TAG ID.
local function check_number(options, parser)
  local name, list = options.verb, options.arguments
  local usage = VERBS[name].usage
  local rest = usage:gsub("^KEY ?", ""):gsub("^TAG ID", "")
  local most, needed = number_in(usage)
  local given = options.where and most - number_in(rest) or 0
  if #list + given < needed then
    parser:error(("%s %s expected"):format(name, given == 0 and usage
      or "--where FILTER " .. rest))
  elseif #list + given <= most then
    return
  elseif given == 0 then
    parser:error(("%s expected, got %d arguments: '%s'"):format(
      (name .. " " .. usage):match("^(.-) *$"), #list, concat(list, "', '")))
  end
  parser:error(("%s: --where or %s expected, not both"):format(name, usage))
end

function command.run(options, parser)
  local name = options.verb
  check_options(options, parser)
  check_number(options, parser)
  -- Programs send, too: an event has a name in the history only if one is given.
  if NOTES[name] then
    options.by = options.by or os.getenv("USER") or os.getenv("LOGNAME")
  end
  local fleet = command.connect(options.url, { tags = options.tags })
  if WIDE[name] then ask(fleet.find_tags, fleet) end
  if MANY[name] then return do_many(fleet, options) end
  print_lines(LINES[name](fleet, options, unpack(options.arguments)))
end

return command
