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

local function list_dead(fleet, limit)
  local lines = {}
  for _, entry in ipairs(fleet:dead(limit)) do
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

local function history_lines(fleet, key, count)
  local moves, problem = fleet:history(key, count)
  for i, move in ipairs(moves or {}) do
    moves[i] = ("%s %s: %s -> %s"):format(rfsm.number_text(move.time, "%.3f"),
      move.event, move.from, move.to)
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
  local lines, problem = fleet:log(key, count)
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

-- For each verb a function that returns lines to print, or nil and the problem.
local LINES = {
  find = function(fleet, name, state, limit, s)
    return fleet:find(name, state, rfsm.number_of(limit), s)
  end,
  due = function(fleet, limit, time)
    return fleet:due(rfsm.number_of(limit), rfsm.number_of(time))
  end,
  get = view_lines, history = history_lines, log = log_lines, versions = version_lines,
  why = function(fleet, key, text) return fleet:why(key, event_of(text)) end,
  send = send_lines, hold = reply_lines "hold", release = reply_lines "release",
  force = reply_lines "force", move = reply_lines "move", remove = was_there "remove",
  reindex = function(fleet)
    local count, problem = fleet:reindex()
    return count and { ("%d machines"):format(count) }, problem
  end,
  dead = list_dead, again = was_there "again", drop = was_there "drop",
}

-- The verbs of both servers, and those for entries, which only this command has.
local VERBS = { dead = { "[LIMIT]", 0 }, again = { "TAG ID", 2 },
  drop = { "TAG ID", 2 } }
verbs.map(function(verb)
  if verb.usage then VERBS[verb.name] = { verb.usage, verb.needs } end
end)

-- Returns the list of verbs, two in a line, so that the help fits a terminal.
local function help()
  local lines, names = { "Verbs:" }, rfsm.sorted_keys(VERBS)
  for i = 1, #names, 2 do
    local name, other = names[i], names[i + 1]
    lines[#lines + 1] = ("   %-36s %s"):format(name .. " " .. VERBS[name][1],
      other and other .. " " .. VERBS[other][1] or "")
  end
  return concat(lines, "\n")
end

local command = {
  summary = "Look after machines in Redis.",
  epilog = help(),
}

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
  common.add_number(parser, "--tags", "hash tags of the machines (64)")
end

--- Return the result of f(...), which asks a server. If it fails, or returns nil or
-- false and the problem, end the program with the reason in one line.
function command.ask(f, ...)
  local ok, result, problem = pcall(f, ...)
  if not ok then common.fail(chart.first_line(result)) end
  return common.try(result, problem)
end

--- Return the client of a fleet, or end the program if there is no server.
function command.connect(url, options)
  return command.ask(require("rfsm.fleet").connect, url, options)
end

function command.run(options, parser)
  local verb, list = VERBS[options.verb], options.arguments
  if #list < verb[2] then
    parser:error(options.verb .. " " .. verb[1] .. " expected")
  end
  local fleet = command.connect(options.url, { tags = options.tags })
  for _, line in ipairs(command.ask(LINES[options.verb], fleet, unpack(list))) do
    common.write("-", line .. "\n")
  end
end

return command
