--- `rfsm fleet URL VERB ...`: look after machines in Redis.
--
-- @module rfsm.cli.fleet
-- @license BSD-3-Clause

local chart = require "rfsm.shared.chart"
local codec = require "rfsm.server.codec"
local common = require "rfsm.cli.common"
local rfsm = require "rfsm"
local typed = require "rfsm.shared.typed"

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
    lines[#lines + 1] = name .. ": " .. (type(value) == "table" and codec.encode(value)
      or rfsm.text_of(value))
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

-- For each verb: its arguments, how many of them are needed, and the function, which
-- returns lines to print, or nil and the problem.
local VERBS = {
  find = { "CHART STATE [LIMIT [SECONDS]]", 2, function(fleet, name, state, limit, s)
    return fleet:find(name, state, rfsm.number_of(limit), s)
  end },
  get = { "KEY", 1, view_lines }, history = { "KEY [COUNT]", 1, history_lines },
  why = { "KEY EVENT", 2, function(fleet, key, text)
    return fleet:why(key, event_of(text))
  end },
  send = { "KEY EVENT", 2, function(fleet, key, ...)
    local events = { ... }
    for i, text in ipairs(events) do events[i] = event_of(text) end
    return reply_lines "send"(fleet, key, unpack(events))
  end },
  hold = { "KEY", 1, reply_lines "hold" },
  release = { "KEY", 1, reply_lines "release" },
  force = { "KEY STATE", 2, reply_lines "force" },
  remove = { "KEY", 1, was_there "remove" },
  dead = { "[LIMIT]", 0, list_dead },
  again = { "TAG ID", 2, was_there "again" }, drop = { "TAG ID", 2, was_there "drop" },
}

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

function command.add_arguments(parser)
  parser:argument("url", "of the server, or a node of the cluster"):argname("URL")
  parser:argument("verb", "what to do"):choices(rfsm.sorted_keys(VERBS)):argname("VERB")
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
  for _, line in ipairs(command.ask(verb[3], fleet, unpack(list))) do
    common.write("-", line .. "\n")
  end
end

return command
