--- Functions for all commands: streams, loading charts, options, results, addresses.
--
-- Text that a chart prints while it is loaded goes to stderr, so that it never becomes
-- part of a result.
--
-- @module rfsm.cli.common
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local calls = require "rfsm.shared.calls"
local chart = require "rfsm.shared.chart"
local files = require "rfsm.shared.files"
local library = require "rfsm.server.library"
local opts = require "rfsm.shared.options"

local concat = table.concat

local common = {
  command = "", -- name of the command that runs
  NOWHERE = { write = function(self) return self end }, -- a stream that keeps nothing
}

-- Streams ---------------------------------------------------------------------

local function set_streams(printer, out, err, default)
  rawset(_G, "print", printer)
  rawset(io, "stdout", out)
  rawset(io, "stderr", err)
  io.output(default)
end

-- Returns the results of pcall(f, ...). During the call, `print`, io.stdout and
-- io.stderr write to `stream`.
function common.with_streams(stream, f, ...)
  local printer, out, err, default = rawget(_G, "print"), io.stdout, io.stderr,
    io.output()
  set_streams(function(...)
    stream:write(calls.text("\t", ...), "\n")
  end, stream, stream, err)
  local ok, result, more, list = pcall(f, ...)
  set_streams(printer, out, err, default)
  return ok, result, more, list
end

-- Writes a line to stderr.
function common.warn(line)
  io.stderr:write("rfsm ", common.command, ": ", line, "\n")
end

-- Writes a problem to stderr, and ends the program with a status (1 by default).
function common.fail(problem, status)
  io.stdout:flush()
  for line in problem:gmatch("[^\n]+") do common.warn(line) end
  os.exit(status or 1)
end

-- Returns the result. If it is nil or false, prints the problem and ends the program.
function common.try(result, problem)
  return result or common.fail(problem)
end

-- Returns the results of f(...), and discards the text that it prints. An error in `f`
-- ends the program with a message that names the file.
function common.call(file, f, ...)
  local ok, result, more, list = common.with_streams(common.NOWHERE, f, ...)
  if not ok then common.fail(chart.reason(file, result)) end
  return result, more, list
end

-- Calls f(...), which runs until Control-C ends it. Other errors are raised.
function common.until_interrupt(f, ...)
  local ok, problem = pcall(f, ...)
  if not (ok or rfsm.is_interrupt(problem)) then error(problem, 0) end
end

-- Charts in -------------------------------------------------------------------

-- Returns the name of a file, with / in place of \ on Windows, which accepts both.
local function with_slashes(name)
  return package.config:byte() == 92 and name:gsub("\\", "/") .. "" or name
end

function common.add_file(command)
  return command:argument("file", "the chart: a Lua file that returns a state")
    :argname("FILE"):convert(with_slashes)
end

function common.add_files(command)
  return command:argument("files", "Lua files that return a chart; - is stdin")
    :args("+"):argname("FILE"):convert(with_slashes)
end

-- Adds an option with a short and a long name. The help shows only the short name,
-- since both names would not fit in one line.
function common.add_option(command, names, text, default)
  local short, long = names:match("(%-%a) (%-%-%a+)")
  return command:option(short, text, default):hidden_name(long):target(long:sub(3))
end

function common.add_output(command, text, default)
  common.add_option(command, "-o --output", text, default):argname("FILE")
end

function common.add_stub(command)
  command:flag("--stub", "modules and globals that are missing do nothing")
    :init(false)
end

-- What ends a problem if a module or a global of a robot is missing: Lua 5.1 and LuaJIT
-- name it in another order. `rtt` is often copied into a local variable.
local MISSING = {
  "module '([^']*)' not found$", "%(global '([^']*)'%)$", "%(%a+ '(rtt)'%)$",
  "global '([^']*)' %(a nil value%)$", "%a+ '(rtt)' %(a nil value%)$",
}

-- Returns the text of a problem. If a module or a global is missing, such as those of a
-- robot, and the option --stub was not given (`has_stubs` is false), the text names the
-- option. The text does not change if the command has no such option (`has_stubs` is
-- nil), or if the global is probably a misspelt `rfsm`.
function common.with_hint(problem, has_stubs)
  for _, pattern in ipairs(has_stubs == false and MISSING or {}) do
    local name = problem:match(pattern)
    if rfsm[name or 1] then return problem .. " (did you mean rfsm." .. name .. "?)" end
    if name and not require("rfsm.advice").is_near(name, "rfsm") then
      return problem .. " (the option --stub loads the chart without it)"
    end
  end
  return problem
end

-- Adds the option --from. The machine may need what a server has.
function common.add_from(command)
  command:option("--from", "begin with the machine in FILE, see rfsm fleet")
    :argname("FILE"):convert(function(file)
      require "rfsm_timeevent"
      require "rfsm.await"
      return file
    end)
end

-- Adds the option --machine. It is for files that are programs with several machines.
function common.add_machine(command)
  common.add_number(command, "--machine", "of a program: number of the machine (1)")
end

-- Returns the text of a file; nil for stdin. If the file cannot be read, ends the
-- program with status 2.
function common.read(file)
  if file == "-" then return nil end
  local text, problem = files.read(file)
  if text then return text end
  common.fail(problem .. (files.read(file .. ".lua")
    and (" (did you mean '%s.lua'?)"):format(file) or ""), 2)
end

-- Loads a chart as chart.load does. Text that the chart prints goes to stderr.
function common.load_model(file, has_stubs, number, load)
  local _, model, result, world = common.with_streams(io.stderr, chart.load, file,
    has_stubs, number, load)
  return model, model and result or common.with_hint(result, has_stubs), world
end

-- Loads a chart and makes its machine, with the printers off. Returns the machine, and
-- the names of the modules and globals that stubs have replaced.
local function load_machine(file, has_stubs, number)
  common.read(file)
  local model, problem, world = common.load_model(file, has_stubs, number)
  if not model then common.fail(problem) end
  local fsm, _, problems = common.call(file, calls.silently, rfsm.init, model)
  if not fsm then
    for i, text in ipairs(problems) do problems[i] = chart.line(file, text) end
    common.fail(concat(problems, "\n"))
  end
  for _, line in ipairs(chart.lines_of(file, world)) do common.warn(line) end
  return fsm, world.names
end

-- Options ---------------------------------------------------------------------

-- Adds an option that takes a number. `expected` is what `opts.read` takes; by default
-- it has to be a whole number above 0.
function common.add_number(command, names, description, expected)
  expected = expected or opts.whole()
  local add = names:find(" ") and common.add_option or command.option
  return add(command, names, description):argname("N"):convert(function(text)
    local number = rfsm.number_of(text)
    if number and expected[2](number) then return number end
    return nil, ("%s: %s expected, got '%s'"):format(names:match("%S+"), expected[1],
      text)
  end)
end

-- Libraries of charts ---------------------------------------------------------

common.CHART_NAMES = "The name of a chart is that of its file; NAME=FILE gives another "
  .. "one. Of charts with one name the last is the newest."

common.SIZE = opts.whole(1, 1e6) -- for the length of a list that a server keeps

-- Adds the arguments for a library of charts: the files, how many ids of events it
-- keeps, and for how long, and where it goes: into a file, or into a server.
function common.add_charts(command, server, load)
  command:argument("files", "Lua files that return a chart"):args("*")
    :argname("[NAME=]FILE"):convert(with_slashes)
  common.add_number(command, "--ids", "keep so many ids of events of each machine, "
    .. "default 16; with --ids-for 1000", common.SIZE)
  common.add_number(command, "--ids-for", "keep ids of events for so many seconds",
    common.SIZE):argname("S")
  common.add_output(command, "file to write; - is stdout")
  common.add_option(command, "-l --load", load):argname(server)
end

-- Calls load(text, server, options) if the option --load names a server. Writes the
-- text to the output, and to stdout if there is neither.
function common.deliver(text, options, load)
  if options.load then load(text, options.load, options) end
  if options.output or not options.load then
    common.write(options.output or "-", text)
  end
end

-- Returns the text of a library, which bundle(files, settings) makes. If a chart is
-- wrong, prints the reason in one line and ends the program.
function common.library_of(bundle, options, parser, settings)
  if not options.files[1] then parser:error("a chart expected") end
  for _, argument in ipairs(options.files) do
    common.read(select(2, library.name_of(argument)))
  end
  settings.ids, settings.ids_for = options.ids, options.ids_for
  local ok, text, warnings = common.with_streams(io.stderr, bundle, options.files,
    settings)
  if not ok then common.fail(chart.first_line(text)) end
  for _, line in ipairs(warnings) do common.warn(line) end
  return text
end

-- Results out -----------------------------------------------------------------

-- Writes a text to a file; `-` is stdout. stdout is flushed, since only a flush reports
-- that the disk is full.
function common.write(file, text)
  local ok, problem
  if file == "-" then
    ok, problem = io.stdout:write(text)
    if ok then ok, problem = io.stdout:flush() end
    problem = problem and "stdout: " .. problem
  else
    ok, problem = files.write(file, text)
  end
  if not ok then common.fail(problem) end
end

local WIDEST = 60 -- bytes of the line about stubs in a picture

-- Returns a line that names stubs; the last ones are counted if the line is too long.
local function line_of(names)
  local line = "stubbed: " .. names[1]
  for i = 2, #names do
    if #line + #names[i] > WIDEST then
      return ("%s and %d more"):format(line, #names - i + 1)
    end
    line = line .. ", " .. names[i]
  end
  return line
end

-- Calls encode(fsm, title, foot) for the chart in each file, and returns the list of
-- texts. So nothing is written before all charts are encoded. `foot` is a line that
-- names the stubs; nil without stubs.
function common.encode_all(options, encode)
  local texts = {}
  for i, file in ipairs(options.files) do
    local title = (chart.name_of(file):match("[^/]+$") or file):gsub("%.lua$", "")
    local fsm, names = load_machine(file, options.stub, options.machine)
    local text = common.call(file, encode, fsm, title, names[1] and line_of(names))
    texts[i] = text and (text:gsub("[^\n]$", "%0\n"))
  end
  return texts
end

-- Addresses -------------------------------------------------------------------

local PROTO_PORT = 44044 -- the default port of rfsm.proto

function common.address_of(parser, text)
  local host, port = text:match("^(.*):(%d+)$")
  port = tonumber(port or not text:find(":", 1, true) and PROTO_PORT)
  if port and port <= 65535 then return host or text, port end
  parser:error(("HOST or HOST:PORT expected, got '%s'"):format(text))
end

return common
