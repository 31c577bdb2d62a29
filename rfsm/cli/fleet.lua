--- `rfsm fleet URL VERB ...`: look after machines in Redis.
--
-- @module rfsm.cli.fleet
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local chart = require "rfsm.shared.chart"
local codec = require "rfsm.server.codec"
local common = require "rfsm.cli.common"
local rfsm = require "rfsm"
local typed = require "rfsm.shared.typed"
local verbs = require "rfsm.server.verbs"

local concat = table.concat
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local command = {}

--- Return the result of f(...), which asks a server. If it fails, end the program with
-- the reason in one line; with this status if f returns nil or false and the problem.
function command.ask_or_end(status, f, ...)
  local ok, result, problem = pcall(f, ...)
  if not ok then common.fail(chart.first_line(result)) end
  return result or common.fail(chart.first_line(problem), status)
end

--- Return the same with status 1.
function command.ask(f, ...) return command.ask_or_end(1, f, ...) end

-- Returns the lines of a reply: one with leaf, mode and outcome, then one per error.
local function lines_of(reply)
  local lines = { reply.leaf .. " " .. reply.mode .. " " .. reply.outcome }
  for _, text in ipairs(reply.errors) do lines[#lines + 1] = "error: " .. text end
  return lines
end

local function reply_lines(name)
  return function(fleet, ...)
    local reply, problem = fleet[name](fleet, ...)
    if not reply then return nil, problem end
    return lines_of(reply)
  end
end

-- Returns the event that a person has typed, such as e_paid{amount=12}.
local function event_of(text)
  local event, problem = typed.read(text)
  return event or error(problem, 0)
end

-- Returns the number that a person has typed; nil if none was.
local function number_of(text)
  return text and (rfsm.number_of(text)
    or error(("a number expected, got '%s'"):format(text), 0))
end

local ALL = 1000000 -- entries: the greatest number that is asked for

local function list_dead(fleet, limit)
  local lines = {}
  for _, entry in ipairs(fleet:dead(number_of(limit) or ALL)) do
    lines[#lines + 1] = concat({ entry.tag, entry.id, entry.machine, entry.what,
      entry.data, "x" .. entry.deliveries, entry.error }, " ")
  end
  return lines
end

local function view_lines(fleet, key)
  local view, problem = fleet:get(key)
  if not view then return nil, problem end
  local lines = {}
  for _, name in ipairs(rfsm.sorted_keys(view)) do
    local value = view[name]
    local is_empty = type(value) == "table" and next(value) == nil and name ~= "data"
    lines[#lines + 1] = name .. ": " .. (is_empty and "[]"
      or type(value) == "table" and codec.encode(value) or rfsm.text_of(value))
  end
  return lines
end

-- Returns a list of a machine. If it is empty since there is no such machine, returns
-- nil and the problem: a misspelt key must not look like a machine without errors.
local function list_of(name, fleet, key, count)
  local list, problem = fleet[name](fleet, key, count)
  if list and not list[1] then
    local view, missing = fleet:get(key)
    if not view then return nil, missing end
  end
  return list, problem
end

local function history_lines(fleet, key, count)
  local moves, problem = list_of("history", fleet, key, count)
  for i, move in ipairs(moves or {}) do
    local by = move.from == "" and "(create):" or move.event .. ": " .. move.from
    moves[i] = ("%s %s -> %s"):format(rfsm.number_text(move.time, "%.3f"), by, move.to)
  end
  return moves, problem
end

local function was_there(name)
  return function(fleet, ...)
    local is_done, problem = fleet[name](fleet, ...)
    if problem then return nil, problem end
    return is_done and {} or nil, "it is not there"
  end
end

local function log_lines(fleet, key, count)
  local lines, problem = list_of("log", fleet, key, count)
  for i, line in ipairs(lines or {}) do
    lines[i] = rfsm.number_text(line.time, "%.3f") .. " " .. line.error
  end
  return lines, problem
end

local function version_lines(fleet)
  local lines, problem = fleet:versions()
  for i, version in ipairs(lines or {}) do
    lines[i] = ("%s %s %s %d"):format(version.chart, version.known, version.version,
      version.count)
  end
  return lines, problem
end

local function send_lines(fleet, key, event, id)
  local reply, problem
  event = event_of(event)
  if id then
    reply, problem = fleet:send_once(id, key, event)
  else
    reply, problem = fleet:send(key, event)
  end
  if not reply then return nil, problem end
  return lines_of(reply)
end

-- One machine as a file ------------------------------------------------------------

local function pull_lines(fleet, key)
  local text, problem = fleet:pull(key)
  return text and { (text:gsub("\n$", "")) }, problem
end

-- Returns the lines of a reply. If the server refuses, ends the program with status 2:
-- nothing was moved.
local function moved_lines(f, ...)
  return lines_of(command.ask_or_end(2, f, ...))
end

local function push_lines(fleet, options, key, file)
  return moved_lines(fleet.push, fleet, key, common.read(file), options.if_version,
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

local function set_lines(fleet, options, key, assignment)
  local field, value = assignment_of(assignment)
  return moved_lines(fleet.set, fleet, key, field, value, options.by, options.force)
end

local function create_lines(fleet, _, key, name, ...)
  local data = {}
  for _, text in ipairs { ... } do
    local field, value = assignment_of(text)
    if data[field] ~= nil then common.fail(("'%s' is there twice"):format(field), 2) end
    data[field] = value
  end
  return moved_lines(fleet.create, fleet, key, name, data)
end

-- Many machines --------------------------------------------------------------------

local VERSIONS = { bundled = true, gone = true, newest = true }

-- Returns a hint for a version that no machine has, or else for a chart or a state that
-- the library has not; else "".
local function hint_for(fleet, name, state, version)
  if version and not VERSIONS[version] and not version:find "^%x+%-%x+$" then
    return advice.nearest_name(version, rfsm.sorted_keys(VERSIONS))
  end
  return advice.in_library(fleet:charts() or {}, name, state)
end

-- The filters, and the text that a message has of their values.
local FILTERS = { age = "SECONDS", chart = "", held = "yes or held=no", state = "",
  version = "" }

local function is_value(name, value)
  if name == "age" then return value:find "^[1-9]%d*$" ~= nil end
  return name ~= "held" or value == "yes" or value == "no"
end

-- Returns the filter that a text such as "chart=order,age=60" means; nil and the
-- problem if it is wrong. A comma may be in a value.
local function filter_of(text)
  local filter, name = {}, nil
  for part in text:gmatch("[^,]+") do
    local found, value = part:match("^%s*(%a+)=(.*)$")
    if FILTERS[found] then
      name, filter[found] = found, value
    elseif found or not name then
      return nil, ("--where: chart=, state=, version=, age= or held= expected, got "
        .. "'%s'%s"):format(part, found and advice.nearest_name(found,
          rfsm.sorted_keys(FILTERS)) or "")
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
    one.text = ("%s %s %s %s%s%s"):format(one.key, one.chart, one.leaf, one.known,
      one.seconds and " " .. rfsm.number_text(one.seconds, "%d") .. " s" or "",
      one.held and " held" or "")
  end
  return found, problem
end

-- Returns the keys of the machines whose entries are meant; nil if all are.
local function keys_for(fleet, filter)
  local keys, of = {}, { chart = filter.chart, state = filter.state,
    version = filter.version, held = filter.held }
  if not next(of) then return nil end
  local found, problem = fleet:select(of)
  if not found then error(problem, 0) end
  for _, one in ipairs(found) do keys[one.key] = true end
  return keys
end

-- Returns the dead entries of machines that a filter lets through. They are so old.
local function find_dead(fleet, filter)
  local found, keys = {}, keys_for(fleet, filter)
  local time = filter.age and os.time() - filter.age or math.huge
  for _, entry in ipairs(fleet:dead(ALL)) do
    if (not keys or keys[entry.machine])
      and tonumber(entry.id:match("^%d+")) / 1000 <= time then
      entry.text = concat({ entry.tag, entry.id, entry.machine, entry.what }, " ")
      found[#found + 1] = entry
    end
  end
  return found
end

-- For each verb that takes filters how the items are found, and what is done with one.
local MANY = {}
verbs.map(function(verb)
  if not verb.bulk then return end
  MANY[verb.name] = { find_machines, function(fleet, one, ...)
    return fleet[verb.name](fleet, one.key, ...)
  end }
end)
for _, name in ipairs { "again", "drop" } do
  MANY[name] = { find_dead, function(fleet, entry)
    return fleet[name](fleet, entry.tag, entry.id)
  end }
end

-- Does a verb for one item, and prints the result. Returns whether it was done; nil and
-- the problem if the server is lost.
local function do_one(fleet, act, one, ...)
  local ok, result, problem = pcall(act, fleet, one, ...)
  if not ok then problem = chart.first_line(result) end
  if ok and result then
    local text = type(result) == "table" and " " .. concat(lines_of(result), "; ") or ""
    common.write("-", (one.key or one.id) .. text .. "\n")
    return true
  end
  problem = problem or "it is not there"
  if ok and (problem:find("^ERR rfsm_") or not result) then
    common.warn(one.text .. ": " .. problem)
    return false
  end
  return nil, problem
end

-- Does a verb for all items, and returns for how many. Ends the program if the server
-- is lost.
local function do_all(fleet, act, found, arguments)
  local count = 0
  for _, one in ipairs(found) do
    local is_done, problem = do_one(fleet, act, one, unpack(arguments))
    if problem then
      common.fail(("%d of %d done, then: %s"):format(count, #found, problem))
    end
    count = count + (is_done and 1 or 0)
  end
  return count
end

-- Does a verb for all machines or entries that a filter lets through, or, dry, shows
-- them. Returns the status: 1 if one was refused.
local function do_many(fleet, options, filter)
  local find, act = unpack(MANY[options.verb])
  local found = command.ask(find, fleet, filter)
  if not found[1] then
    common.fail(("no %s is like that, so nothing was done%s"):format(find == find_dead
      and "entry" or "machine", hint_for(fleet, filter.chart, filter.state,
      filter.version)), 2)
  elseif options.dry_run then
    for _, one in ipairs(found) do common.write("-", one.text .. "\n") end
    return common.warn(("%d found, nothing was done"):format(#found))
  end
  local count = do_all(fleet, act, found, options.arguments)
  common.warn(("%d of %d done"):format(count, #found))
  return count < #found and 1 or 0
end

-- Single verbs ----------------------------------------------------------------------

-- Returns a time. With + it is so many seconds from now.
local function time_of(text)
  return number_of(text) + (text:find("^%+") and os.time() or 0)
end

-- Notes that there may be more keys than were asked for.
local function limited(keys, problem, limit)
  if keys and #keys >= (limit or 100) then
    keys.note = ("the first %d, there may be more: give a greater LIMIT"):format(#keys)
  end
  return keys, problem
end

-- Nothing is printed if nothing is found, so a misspelt name looks like good news.
local function find_lines(fleet, name, state, limit, seconds)
  limit = number_of(limit)
  local keys, problem = fleet:find(name, state, limit, seconds)
  if keys and not keys[1] then
    common.warn(("no machine of chart '%s' is in '%s'%s%s"):format(name, state,
      seconds and " for so long" or "", hint_for(fleet, name, state)))
  end
  return limited(keys, problem, limit)
end

local function due_lines(fleet, limit, time)
  limit = number_of(limit)
  local keys, problem = fleet:due(limit, time and time_of(time))
  return limited(keys, problem, limit)
end

local function chart_lines(fleet)
  local charts, problem = fleet:charts()
  local lines = {}
  for _, name in ipairs(rfsm.sorted_keys(charts or {})) do
    for _, path in ipairs(charts[name]) do lines[#lines + 1] = name .. " " .. path end
  end
  return charts and lines, problem
end

-- For each verb a function that returns lines to print, or nil and the problem.
local LINES = {
  find = find_lines, due = due_lines, charts = chart_lines,
  get = view_lines, history = history_lines, log = log_lines, versions = version_lines,
  why = function(fleet, key, text) return fleet:why(key, event_of(text)) end,
  send = send_lines, hold = reply_lines "hold", release = reply_lines "release",
  force = reply_lines "force", move = reply_lines "move", remove = was_there "remove",
  reindex = function(fleet)
    local count, problem = fleet:reindex()
    return count and { ("%d machines"):format(count) }, problem
  end,
  dead = list_dead, again = was_there "again", drop = was_there "drop",
  cancel = was_there "cancel",
  tick = reply_lines "tick", pull = pull_lines,
}

-- The same for those that get the options, and end the program themselves.
local WITH_OPTIONS = { create = create_lines, push = push_lines, set = set_lines }

-- The verbs of both servers, and those for entries, which only this command has.
local VERBS = { dead = { "[LIMIT]", 0 }, again = { "TAG ID", 2 },
  drop = { "TAG ID", 2 } }
verbs.map(function(verb)
  if verb.usage then VERBS[verb.name] = { verb.usage, verb.needs } end
end)

-- Returns the verbs with their arguments, those with the same ones together, in as few
-- lines as possible, so that the help fits a terminal.
local function help()
  local groups, by_usage, lines = {}, {}, { "Verbs:" }
  for _, name in ipairs(rfsm.sorted_keys(VERBS)) do
    local usage = VERBS[name][1]
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
    local is_first = not lines[2] or #lines[#lines] + #text > 79
    lines[is_first and #lines + 1 or #lines] = (is_first and "" or lines[#lines])
      .. text
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
  parser:argument("url", "of the server, or a node of the cluster"):argname("URL")
  parser:argument("verb", "what to do, see below"):convert(verb_of):argname("VERB")
  parser:argument("arguments", "of the verb; KEY is a whole key, with its {tag}")
    :args("*"):argname("ARGUMENT")
  common.add_number(parser, "--tags", "hash tags of short keys (64)")
  parser:option("--where", "in place of KEY: chart= state= version= age= held=")
    :argname("FILTER"):convert(filter_of)
  parser:flag("--dry-run", "show what --where means, do nothing")
  common.add_number(parser, "--if-version", "push: refuse another revision",
    function(number) return number >= 0 and number % 1 == 0 end)
  parser:option("--by", "push, set: a name for the history (yours)"):argname("NAME")
  parser:flag("--force", "set: take a value of another kind")
end

--- Return the client of a fleet, or end the program if there is no server.
function command.connect(url, options)
  if url:find "^postgres" then
    common.fail("PostgreSQL has functions in place of this command, such as SELECT * "
      .. "FROM rfsm.get('KEY')", 2)
  end
  return command.ask(require("rfsm.fleet").connect, url, options)
end

-- Verbs that look at all hash tags, also at those that no short key has.
local WIDE = { dead = true, due = true, find = true }

-- Returns how many arguments a verb has at most.
local function most_of(usage)
  return usage:find("...", 1, true) and ALL or select(2, usage:gsub("%S+", ""))
end

-- Options that only some verbs take.
local TAKERS = { by = { push = true, set = true }, force = { set = true },
  if_version = { push = true } }

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
  local usage, needs = unpack(VERBS[name])
  local rest = usage:gsub("^KEY ?", ""):gsub("^TAG ID", "")
  local given = options.where and most_of(usage) - most_of(rest) or 0
  if #list + given < needs then
    parser:error(("%s %s expected"):format(name, given == 0 and usage
      or "--where FILTER " .. rest))
  elseif #list + given <= most_of(usage) then
    return
  elseif given == 0 then
    parser:error(("%s %s expected, got %d arguments: '%s'"):format(name, usage, #list,
      concat(list, "', '")))
  end
  parser:error(("%s: --where or %s expected, not both"):format(name, usage))
end

local function check(options, parser)
  local name = options.verb
  if options.where and not MANY[name] then
    parser:error(name .. " takes no --where, but " .. VERBS[name][1])
  elseif options.dry_run and not options.where then
    parser:error("--dry-run: --where expected")
  end
  check_number(options, parser)
  check_options(options, parser)
end

function command.run(options, parser)
  local name, list = options.verb, options.arguments
  check(options, parser)
  options.by = options.by or os.getenv("USER") or os.getenv("LOGNAME")
  local fleet = command.connect(options.url, { tags = options.tags })
  local is_wide = options.where and MANY[name][1] == find_dead or WIDE[name]
  if is_wide then command.ask(fleet.find_tags, fleet) end
  if options.where then return do_many(fleet, options, options.where) end
  local lines = WITH_OPTIONS[name] and WITH_OPTIONS[name](fleet, options, unpack(list))
    or command.ask(LINES[name], fleet, unpack(list))
  for _, line in ipairs(lines) do common.write("-", line .. "\n") end
  if lines.note then common.warn(lines.note) end
end

return command
