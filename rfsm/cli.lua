--- The command line: `rfsm check`, `rfsm sim`, `rfsm viz`, `rfsm redis` and others.
--
-- Output of a chart while it is loaded goes to stderr, so that it is never part of a
-- result.
--
-- The file reads in the order in which a command works: streams, charts in, results
-- out, commands, public functions.
--
-- @module rfsm.cli
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local chart = require "rfsm.chart"
local diagram = require "rfsm.diagram"

local ipairs, pcall, print, rawget, rawset = ipairs, pcall, print, rawget, rawset
local require, select, tonumber, type = require, select, tonumber, type
local io, os = io, os
local concat = table.concat
local name_of = chart.name_of
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local cli = {}

local PROTO_PORT = 44044 -- of rfsm.proto

-- Streams: charts print to stderr ----------------------------------------------

local function print_to(stream)
  return function(...)
    local texts = { ... }
    for i = 1, select("#", ...) do texts[i] = rfsm.text_of(texts[i]) end
    stream:write(concat(texts, "\t"), "\n")
  end
end

-- Calls f(...) while `print`, stdout and stderr are `stream`. Returns the results of
-- pcall.
local function with_streams(stream, f, ...)
  local real_print, out, err, default = rawget(_G, "print"), io.stdout, io.stderr,
    io.output()
  rawset(_G, "print", print_to(stream))
  rawset(io, "stdout", stream)
  rawset(io, "stderr", stream)
  io.output(err)
  local results = { pcall(f, ...) }
  rawset(_G, "print", real_print)
  rawset(io, "stdout", out)
  rawset(io, "stderr", err)
  io.output(default)
  return unpack(results, 1, 3)
end

-- A stream that keeps nothing: machines are made silently.
local NOWHERE = { write = function(self) return self end }

-- Reports lines on stderr, each with the name of the command, and ends the program.
local function fail(name, lines, status)
  io.stdout:flush()
  for _, line in ipairs(lines) do io.stderr:write("rfsm ", name, ": ", line, "\n") end
  os.exit(status or 1)
end

-- Charts in -------------------------------------------------------------------

-- Returns the model in a file, and its warnings; nil and the problem in one line.
local function load_model(file)
  return select(2, with_streams(io.stderr, chart.load, file))
end

-- Returns the machine of a chart, made silently; false and its problems, a line each.
local function load_machine(file)
  local model, problem = load_model(file)
  if not model then return false, { problem } end
  model.dbg, model.err, model.warn, model.info = false, false, false, false
  local ok, fsm, problems = with_streams(NOWHERE, rfsm.init, model)
  if not ok then return false, { chart.reason(file, fsm) } end
  local lines = {}
  for i, text in ipairs(problems or {}) do lines[i] = chart.line(file, text) end
  return fsm, lines
end

-- Results out -----------------------------------------------------------------

-- A full disk shows when a stream is flushed.
local function write_stdout(text)
  local ok, problem = io.stdout:write(text)
  if ok then ok, problem = io.stdout:flush() end
  return ok, problem and "stdout: " .. problem
end

local function write(name, file, text)
  local ok, problem
  if file == "-" then
    ok, problem = write_stdout(text)
  else
    ok, problem = diagram.write(file, text)
  end
  if not ok then fail(name, { problem }) end
end

-- The name of a chart in its picture.
local function title_of(file)
  return (name_of(file):match("[^/]+$") or file):gsub("%.lua$", "")
end

-- Encodes every chart before anything is written.
local function encode_all(name, files, encode)
  local texts = {}
  for i, file in ipairs(files) do
    local fsm, problems = load_machine(file)
    if not fsm then fail(name, problems) end
    local ok, text = with_streams(NOWHERE, encode, fsm, title_of(file))
    if not ok then fail(name, { chart.reason(file, text) }) end
    texts[i] = text:sub(-1) == "\n" and text or text .. "\n"
  end
  return texts
end

-- Commands: each adds its arguments to a parser, and runs ------------------------

local function add_files(command)
  command:argument("files", "Lua files that return a chart; - is stdin"):args("+")
    :argname("FILE")
end

-- rfsm check --

-- Ends the program with status 2 if a file cannot be read.
local function check_readable(name, files)
  for _, file in ipairs(files) do
    if file ~= "-" then
      local handle, problem = io.open(file)
      if not handle then fail(name, { problem }, 2) end
      local text, why = handle:read(1) -- a directory opens, too
      if not text and why then fail(name, { file .. ": " .. why }, 2) end
      handle:close()
    end
  end
end

local function append(lines, texts)
  for _, text in ipairs(texts) do lines[#lines + 1] = text end
end

-- Appends lines about the chart in a file; returns the gravest severity.
local function review(lines, file, options)
  local command = require("rfsm.checks.command")
  local settings, problem = command.settings_for(file)
  if not settings then fail("check", { problem }, 2) end
  local model, warnings = load_model(file)
  if not model then
    append(lines, { warnings })
    return "error"
  end
  local ok, report, gravest = with_streams(NOWHERE, command.review, file, model,
    warnings, settings, options)
  append(lines, ok and report or { chart.reason(file, report) })
  return not ok and "error" or gravest
end

local check = {
  name = "check", summary = "Report problems and suspicious parts of charts.",
  epilog = "The status is 0 if no chart has a problem, 1 if one has, 2 if the command "
    .. "line is wrong or a file cannot be read. A file .rfsmcheck.lua sets severities.",
}

local function print_codes()
  print((require("rfsm.checks.command").codes_text():gsub("\n$", "")))
  os.exit(0)
end

function check.add_arguments(command)
  add_files(command)
  command:flag("-a --all", "print notes, too")
  command:flag("-q --quiet", "print nothing, only set the status")
  command:flag("-s --strict", "count a warning as a problem")
  command:flag("--codes", "list the codes of findings and end"):action(print_codes)
  command:flag("-x --explore", "walk over every configuration, and judge properties")
  command:option("-k --together", "explore: events in one step, at most")
    :argname("N"):convert(tonumber)
  command:option("--configurations", "explore: stop after so many")
    :argname("N"):convert(tonumber)
  command:option("--seconds", "explore: stop after so long"):argname("N")
    :convert(tonumber)
  command:option("--record", "explore: write the run that shows the first finding")
    :argname("FILE")
  command:option("--tests", "write a spec that takes every transition")
    :argname("KIND"):choices { "busted" }
  command:option("-o --output", "tests: file to write; - is stdout", "-")
    :argname("FILE")
end

local SUMMARY = "rfsm check: %d of %d transitions in %d steps (at least %d are "
  .. "needed)\n"

-- Writes tests of one chart.
local function write_tests(options, parser)
  local file = options.files[1]
  if options.files[2] then
    parser:error("one FILE expected, tests are those of one chart, got "
      .. #options.files)
  end
  local model, problem = load_model(file)
  if not model then fail("check", { problem }) end
  local ok, text, result = with_streams(NOWHERE, require("rfsm.checks.tests").busted,
    file, model)
  if not ok then fail("check", { chart.reason(file, text) }) end
  write("check", options.output, text)
  io.stderr:write(SUMMARY:format(result.taken, result.transitions, result.steps,
    result.least))
  return 0
end

function check.run(options, parser)
  check_readable("check", options.files)
  require("rfsm_timeevent") -- so that their events are known
  require("rfsm.await")
  if options.tests then return write_tests(options, parser) end
  local lines, status = {}, 0
  for _, file in ipairs(options.files) do
    local gravest = review(lines, file, options)
    if gravest == "error" or options.strict and gravest then status = 1 end
  end
  if not options.quiet then write("check", "-", concat(lines, "\n") .. "\n") end
  return status
end

-- rfsm sim --

local sim = {
  name = "sim", summary = "Step through a chart by hand.",
  epilog = "Commands are read from the terminal or from a pipe; help() lists them.",
}

function sim.add_arguments(command)
  command:argument("file", "the chart: a Lua file that returns a state"):argname("FILE")
  command:option("-e --execute", "run CODE, print the values of an expression, and end")
    :argname("CODE"):count("*")
  command:flag("-i --interactive", "read commands after CODE, too")
  command:option("-r --replay", "run the chart through the recording in FILE first")
    :argname("FILE")
  command:flag("-d --dry", "leave the functions of the chart out")
  command:flag("-q --quiet", "print no banner")
end

function sim.run(options)
  return require("rfsm.sim").main {
    file = options.file, code = options.execute, is_quiet = options.quiet,
    is_interactive = options.interactive, recording = options.replay,
    is_dry = options.dry,
  }
end

-- rfsm json, rfsm plantuml, rfsm dot, rfsm mermaid --

local ENDINGS = { json = "json", plantuml = "puml", dot = "dot", mermaid = "mmd" }

-- Returns the name of the result for a chart: a/b.lua becomes a/b.json.
local function output_for(file, ending)
  return file == "-" and "-" or file:gsub("%.lua$", "") .. "." .. ending
end

local function new_encoder(name, language)
  local ending, encoder = ENDINGS[name], { name = name }
  encoder.summary = "Write charts as " .. language .. "."
  encoder.epilog = "The result for a.lua is a." .. ending .. "."

  function encoder.add_arguments(command)
    add_files(command)
    command:option("-o --output", "one file for all results; - is stdout")
      :argname("FILE")
  end

  function encoder.run(options)
    local texts = encode_all(name, options.files, require("rfsm." .. name).encode)
    if options.output then
      write(name, options.output, concat(texts))
    else
      for i, file in ipairs(options.files) do
        write(name, output_for(file, ending), texts[i])
      end
    end
    return 0
  end

  return encoder
end

-- rfsm viz --

local FORMATS = { "dot", "svg", "png", "pdf", "plantuml", "mermaid", "json" }
local IS_TEXT = { dot = true, plantuml = true, mermaid = true, json = true }
local BY_ENDING = {
  dot = "dot", gv = "dot", svg = "svg", png = "png", pdf = "pdf", puml = "plantuml",
  plantuml = "plantuml", mmd = "mermaid", mermaid = "mermaid", json = "json",
}

local viz = {
  name = "viz", summary = "Draw charts.", epilog = "Graphviz lays out the pictures.",
}

local function to_depth(text)
  local depth = tonumber(text)
  if depth and depth >= 1 and depth % 1 == 0 then return depth end
  return nil, "depth: a whole number from 1 expected, got '" .. text .. "'"
end

function viz.add_arguments(command)
  add_files(command)
  command:option("-T --format", concat(FORMATS, ", ")
    .. "; without it the ending of the output decides, or it is dot")
    :argname("FORMAT"):choices(FORMATS)
  command:option("-o --output", "file to write; - is stdout", "-"):argname("FILE")
  command:option("--active", "draw state FQN as active; may be given for each region")
    :argname("FQN"):count("*")
  command:option("--depth", "draw N levels of states"):argname("N"):convert(to_depth)
  command:option("--coverage", "mark how often a run came to each place: JSON, as "
    .. "rfsm_checks.coverage writes it"):argname("JSON")
  command:option("--trace", "number the steps of a run: JSON lines, as rfsm.record "
    .. "writes them"):argname("JSON")
  command:option("--direction", "TB (down) or LR (to the right)"):argname("DIRECTION")
    :choices { "TB", "LR" }
end

-- Returns the JSON values in a file; a problem ends the program.
local function read_values(file)
  local handle, problem = io.open(file, "rb")
  if not handle then fail("viz", { problem }) end
  local ok, values = pcall(require("rfsm.json").decode_all, handle:read("*a") or "")
  handle:close()
  if not ok then fail("viz", { file .. ": " .. values }) end
  return values
end

local function read_coverage(file)
  local coverage = read_values(file)[1]
  local is_coverage = type(coverage) == "table" and type(coverage.states) == "table"
    and type(coverage.transitions) == "table"
  if is_coverage then return coverage end
  fail("viz", { file .. ": an object with \"states\" and \"transitions\" expected" })
end

-- Returns the steps of a run: a list of them, or one a line.
local function read_trace(file)
  local values = read_values(file)
  return values[2] == nil and type(values[1]) == "table" and values[1][1] and values[1]
    or values
end

-- Returns the format; nil and the problem of the command line.
local function find_format(options)
  local file = options.output
  local format = options.format or file == "-" and "dot"
    or BY_ENDING[(file:match("%.(%w+)$") or ""):lower()]
  if not format then
    return nil, "the ending of '" .. file .. "' is no format, -T expected ("
      .. concat(FORMATS, ", ") .. ")"
  end
  if not IS_TEXT[format] and options.files[2] then
    return nil, "one FILE expected, " .. format .. " holds one chart, got "
      .. #options.files
  end
  return format
end

function viz.run(options, parser)
  local format, problem = find_format(options)
  if not format then parser:error(problem) end
  local exporter = require("rfsm." .. (IS_TEXT[format] and format or "dot"))
  local looks = {
    depth = options.depth, direction = options.direction,
    active = options.active[1] and options.active,
    coverage = options.coverage and read_coverage(options.coverage),
    trace = options.trace and read_trace(options.trace),
  }
  local result = concat(encode_all("viz", options.files, function(fsm, title)
    looks.title = title
    return exporter.encode(fsm, looks)
  end))
  if not IS_TEXT[format] then
    result, problem = require("rfsm.dot").render(result, format)
    if not result then fail("viz", { problem }) end
  end
  write("viz", options.output, result)
  return 0
end

-- rfsm redis --

local redis = {
  name = "redis", summary = "Bundle charts as a library of Redis functions.",
  epilog = "The name of a chart is that of its file; NAME=FILE gives another one. Of "
    .. "charts with one name the last is the newest.",
}

function redis.add_arguments(command)
  command:argument("files", "Lua files that return a chart"):args("+")
    :argname("[NAME=]FILE")
  command:option("-o --output", "file to write; - is stdout"):argname("FILE")
  command:option("-l --load", "load the library into this server"):argname("URL")
end

function redis.run(options)
  local ok, text = with_streams(io.stderr, require("rfsm.redis").bundle, options.files)
  if not ok then fail("redis", { chart.first_line(text) }) end
  if options.load then
    local connected, fleet = pcall(require("rfsm.fleet").connect, options.load)
    if not connected then fail("redis", { chart.first_line(fleet) }) end
    local loaded, problem = fleet:load(text)
    if not loaded then fail("redis", { problem }) end
  end
  if options.output or not options.load then
    write("redis", options.output or "-", text)
  end
  return 0
end

-- rfsm web, rfsm watch --

-- Calls a function that has no end; Control-C ends it.
local function until_interrupt(f, ...)
  local ok, problem = pcall(f, ...)
  if ok or rfsm.text_of(problem):find("interrupted!$") then return 0 end
  error(problem, 0)
end

-- Returns host and port of "HOST:PORT"; nil if it is none.
local function split_address(text)
  local host, port = text:match("^(.*):(%d+)$")
  port = tonumber(port or not text:find(":", 1, true) and PROTO_PORT)
  if port and port <= 65535 then return host or text, port end
end

local function check_address(parser, text)
  local host, port = split_address(text)
  if not host then
    parser:error(("HOST or HOST:PORT expected, got '%s'"):format(text))
  end
  return host, port
end

local web = {
  name = "web", summary = "Show a chart, or a machine elsewhere, in the browser.",
  epilog = "The page is for this machine only, unless --host names another address.",
}

function web.add_arguments(command)
  command:argument("file", "the chart: a Lua file that returns a state"):argname("FILE")
    :args("?")
  command:option("-a --attach", "watch a machine that answers there by rfsm.proto")
    :argname("HOST:PORT")
  command:option("-p --port", "of the page; 0 is one that is free", "8044")
    :argname("N"):convert(tonumber)
  command:option("--host", "the address of the page", "127.0.0.1"):argname("HOST")
end

function web.run(options, parser)
  if (options.file == nil) == (options.attach == nil) then
    parser:error("FILE or --attach expected")
  end
  local server, problem
  local page = { host = options.host, port = options.port }
  if options.attach then
    local host, port = check_address(parser, options.attach)
    server, problem = require("rfsm.web").attach(host, port, page)
  else
    check_readable("web", { options.file })
    server, problem = require("rfsm.web").open(options.file, page)
  end
  if not server then fail("web", { problem }) end
  write("web", "-", server.url .. "\n")
  return until_interrupt(server.run, server)
end

local watch = {
  name = "watch", summary = "Print a machine that runs elsewhere, as it changes.",
  epilog = "The machine answers by rfsm.proto; its port is 44044 if none is given.",
}

function watch.add_arguments(command)
  command:argument("address", "where it answers"):argname("HOST[:PORT]")
  command:option("-m --machine", "its number at that port", "1"):argname("N")
    :convert(tonumber)
  command:option("-n --count", "end after N lines"):argname("N"):convert(tonumber)
end

function watch.run(options, parser)
  local client, problem = require("rfsm.subscriber").connect(
    check_address(parser, options.address))
  if not client then fail("watch", { problem }) end
  io.stdout:setvbuf("line")
  local status = os.execute("test -t 1")
  return until_interrupt(require("rfsm.watch").run, client, {
    number = options.machine, count = options.count,
    is_terminal = status == true or status == 0,
  })
end

-- Public functions ------------------------------------------------------------

local COMMANDS = {
  check, sim, viz, redis, new_encoder("json", "JSON"),
  new_encoder("plantuml", "PlantUML diagrams"), new_encoder("dot", "Graphviz graphs"),
  new_encoder("mermaid", "Mermaid diagrams"), web, watch,
}

local function find_argparse()
  local ok, argparse = pcall(require, "argparse")
  if ok then return argparse end
  io.stderr:write("rfsm: the package argparse is missing (luarocks install argparse; ",
    "on Debian: apt-get install lua-argparse)\n")
  os.exit(1)
end

local function print_version()
  print("rfsm " .. rfsm._VERSION:match("%S+$"))
  os.exit(0)
end

local function add_version(parser)
  parser:flag("-v --version", "print the version and end"):action(print_version)
end

-- argparse calls this with the parser of the command, whose usage is printed.
local function report_usage(parser, problem)
  io.stderr:write(parser:get_usage(), "\n\nError: ", problem, "\n")
  os.exit(2)
end

local function new_parser(argparse)
  local parser = argparse("rfsm", "Check, simulate and draw statecharts.")
    :command_target("command")
  parser.error = report_usage
  add_version(parser)
  for _, command in ipairs(COMMANDS) do
    local subparser = parser:command(command.name, command.summary, command.epilog)
      :summary(command.summary)
    subparser.error = report_usage
    command.add_arguments(subparser)
    add_version(subparser)
    command.parser = subparser
  end
  return parser
end

--- Run a command.
---@param argv string[] the command line without the name of the program
---@return integer status for the shell
function cli.main(argv)
  local options = new_parser(find_argparse()):parse(argv)
  for _, command in ipairs(COMMANDS) do
    if command.name == options.command then
      return command.run(options, command.parser)
    end
  end
end

return cli
