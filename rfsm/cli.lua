--- What the tools on the command line have in common: charts in, texts out.
--
-- The tools in `tools/` are a name and a call each. What a chart prints while it is
-- loaded goes to stderr, and so never gets into what a tool writes.
--
-- The file reads in the order in which a tool works: streams, charts in, texts out, the
-- command line, the tools.
--
-- @module rfsm_export
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local ipairs, pairs, pcall, rawget, rawset = ipairs, pairs, pcall, rawget, rawset
local require, select, tostring, type = require, select, tostring, type
local io, os = io, os
local concat, sort = table.concat, table.sort
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local rfsm_export = {}

-- Streams: what charts print is not what tools write ------------------------------

local function text_of(value)
  local ok, text = pcall(tostring, value)
  return ok and type(text) == "string" and text or type(value)
end

local function print_to(stream)
  return function(...)
    local texts = { ... }
    for i = 1, select("#", ...) do texts[i] = text_of(texts[i]) end
    stream:write(concat(texts, "\t"), "\n")
  end
end

-- Calls f(...) while `print`, stdout and stderr are `stream`; returns what pcall does.
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

local function complain(name, lines)
  io.stdout:flush()
  for _, line in ipairs(lines) do io.stderr:write(name, ": ", line, "\n") end
end

local function fail(name, lines, status)
  complain(name, type(lines) == "table" and lines or { lines })
  os.exit(status or 1)
end

-- Charts in -------------------------------------------------------------------

-- Where a chart comes from, as messages name it.
local function name_of(file) return file == "-" and "stdin" or file end

-- Says in one line why `file` is no chart, with its name in front.
local function reason(file, failure)
  local text = text_of(failure):match("[^\n]+") or ""
  if failure == nil or text == "" then text = "failed without a message" end
  if text:find("^%a+: 0x") then text = "failed with a " .. type(failure) end
  text = text:gsub("^rfsm2json: ", "")
    :gsub("^rfsm%.load: ", ""):gsub("^rfsm%.load_str: ", "")
    :gsub("^failed to load chunk: ", ""):gsub("'=stdin'", "stdin")
  text = text:gsub(":%s*$", "") -- a list followed, such as that of require
  if text:find(name_of(file), 1, true) then return text end
  return name_of(file) .. ": " .. text
end

-- A first line for the shell (#!) is none of Lua's business.
local function load_stdin()
  local text = io.read("*a"):gsub("^#[^\n]*", "")
  return rfsm.load_str(text, "=stdin")
end

--- Load the model in a file.
---@param file string "-" is stdin
---@return rfsm.State? model
---@return string? problem in one line
---@nodiscard
function rfsm_export.load_model(file)
  local load = file == "-" and load_stdin or rfsm.load
  local ok, model = with_streams(io.stderr, load, file)
  if ok then return model end
  return nil, reason(file, model)
end

-- Makes a machine that says nothing; false and its problems when that cannot be.
local function init(model, file)
  local ok, fsm, problems = with_streams(NOWHERE, rfsm.init, model)
  if not ok then return false, { reason(file, fsm) } end
  for i, problem in ipairs(problems or {}) do
    problems[i] = name_of(file) .. ": " .. problem
  end
  return fsm, problems
end

--- Load and initialise the chart in a file, silently.
---@param file string "-" is stdin
---@return rfsm.Machine|false fsm
---@return string[]? problems a line each
---@nodiscard
function rfsm_export.load(file)
  local model, problem = rfsm_export.load_model(file)
  if not model then return false, { problem } end
  model.dbg, model.err, model.warn, model.info = false, false, false, false
  return init(model, file)
end

-- Review: all that there is to say about a model ----------------------------------

-- Digits padded, so that trans[10] comes after trans[2].
local function natural(text)
  return (text:gsub("%d+", function(n) return ("0"):rep(12 - #n) .. n end))
end

local function sorted(lines)
  sort(lines, function(a, b) return natural(a) < natural(b) end)
  return lines
end

local function names_of(machines)
  local names = {}
  for name, machine in pairs(machines) do -- any order: sorted below
    if rfsm.is_initialized_root(machine) then names[#names + 1] = name end
  end
  sort(names)
  return names
end

local function append(list, more, prefix)
  for _, text in ipairs(more) do list[#list + 1] = prefix .. text end
end

-- Returns the finding as `init` has put it, which sees the same of an e_done.
local function as_init_tells(finding)
  return (finding:gsub("^(.-): event 'e_done@(.-)' never comes.*",
    "%1: 'e_done' never fires here, '%2' is no leaf state"))
end

-- Appends the findings of the static checks but those that `init` has told.
local function append_untold(list, findings, prefix)
  local is_told = {}
  for _, text in ipairs(list) do is_told[text] = true end
  for _, finding in ipairs(findings) do
    if not is_told[prefix .. as_init_tells(finding)] then
      list[#list + 1] = prefix .. finding
    end
  end
end

-- Appends what is dead or suspicious in a machine and in those inside its states.
local function add_findings(findings, fsm, prefix)
  append_untold(findings, require("rfsm_checks").check(fsm), prefix)
  rfsm.mapfsm(function(state)
    if type(state.substates) ~= "table" then return end
    for _, name in ipairs(names_of(state.substates)) do
      local sub = state.substates[name]
      local place = prefix .. state._fqn .. "." .. name .. ": "
      append(findings, select(3, rfsm.verify_early(sub)), place)
      add_findings(findings, sub, place)
    end
  end, fsm, rfsm.is_leaf)
end

-- A printer for `warn`. That a node has no way out is for the static checks to say,
-- which know whether it matters.
local function collect_in(warnings)
  return function(text)
    text = text_of(text):gsub("^WARNING: ", "")
    if text:find("^no outgoing transitions from node") then return end
    warnings[#warnings + 1] = text
  end
end

local function review(model)
  local is_valid, problems, warnings = rfsm.verify_early(model)
  if not is_valid then return problems, warnings end
  warnings = {}
  model.dbg, model.err, model.info = false, false, false
  model.warn = collect_in(warnings)
  local fsm, found = rfsm.init(model)
  if not fsm then return found, warnings end
  add_findings(warnings, fsm, "")
  return {}, sorted(warnings)
end

--- Find all that is wrong, dead or suspicious in a model.
---@param model rfsm.State its printers are replaced
---@param file string where it comes from, for what raises
---@return string[] problems each "place: text"; with one, there is no machine
---@return string[] warnings likewise
---@nodiscard
function rfsm_export.review(model, file)
  local ok, problems, warnings = with_streams(NOWHERE, review, model)
  if ok then return problems, warnings end
  return { reason(file, problems) }, {}
end

-- Texts out -------------------------------------------------------------------

-- Writes all or says why not: a full disk shows when a stream is flushed.
local function write_to(stream, text)
  local ok, problem = stream:write(text)
  if ok then ok, problem = stream:flush() end
  return ok, problem
end

--- Write a text to a file.
---@param file string "-" is stdout
---@param text string
---@return boolean? is_written
---@return string? problem in one line
function rfsm_export.write(file, text)
  if file == "-" then
    local ok, problem = write_to(io.stdout, text)
    return ok and true, not ok and "stdout: " .. problem or nil
  end
  local handle, problem = io.open(file, "wb")
  if not handle then return nil, problem end
  local ok, why = write_to(handle, text)
  handle:close()
  return ok and true, not ok and file .. ": " .. why or nil
end

local function write(name, file, text)
  local ok, problem = rfsm_export.write(file, text)
  if not ok then fail(name, problem) end
end

-- Encodes every chart before anything is written.
local function encode_all(name, files, encode)
  local texts = {}
  for i, file in ipairs(files) do
    local fsm, problems = rfsm_export.load(file)
    if not fsm then fail(name, problems) end
    local ok, text = with_streams(NOWHERE, encode, fsm, name_of(file))
    if not ok then fail(name, reason(file, text)) end
    texts[i] = text:sub(-1) == "\n" and text or text .. "\n"
  end
  return texts
end

-- The command line ------------------------------------------------------------

local function new_parser(name, text, epilog)
  local has_argparse, argparse = pcall(require, "argparse")
  if not has_argparse then
    fail(name, "the package argparse is missing (on Debian: apt-get install "
      .. "lua-argparse)")
  end
  local parser = argparse(name, text, epilog)
  function parser:error(problem)
    io.stderr:write(self:get_usage(), "\n\nError: ", problem, "\n")
    os.exit(2)
  end
  parser:argument("files", "Lua files that return a chart; - is stdin"):args("+")
    :argname("FILE")
  parser:flag("-v --version", "print the version and end"):action(function()
    print(name .. " " .. rfsm._VERSION:match("%S+$"))
    os.exit(0)
  end)
  return parser
end

-- Pictures: Graphviz makes them -----------------------------------------------

local function runs(command)
  local status = os.execute(command)
  return status == true or status == 0
end

local function content_of(file)
  local handle = io.open(file, "rb")
  if not handle then return "" end
  local text = handle:read("*a")
  handle:close()
  return text
end

-- Runs Graphviz on files; returns whether it went well.
local function run_dot(format, source, picture, log)
  local command = "dot -T%s -o '%s' '%s' 2>'%s' </dev/null"
  return runs(command:format(format, picture, source, log))
end

-- Returns the picture; nil and why there is none.
local function render(format, text)
  if not runs("command -v dot >/dev/null 2>&1") then
    return nil, "Graphviz is missing (on Debian: apt-get install graphviz)"
  end
  local source, picture, log = os.tmpname(), os.tmpname(), os.tmpname()
  local ok, problem = rfsm_export.write(source, text)
  if ok then
    ok = run_dot(format, source, picture, log)
    problem = "dot: " .. (content_of(log):match("[^\n]+") or "no picture")
  end
  local result = content_of(picture)
  os.remove(source)
  os.remove(picture)
  os.remove(log)
  if ok and result ~= "" then return result end
  return nil, problem
end

-- The tools -------------------------------------------------------------------

--- Run a tool that writes charts in one format.
---@param name string of the tool
---@param what string what it writes
---@param encode fun(fsm: rfsm.Machine, title: string): string
---@param argv string[] the command line
function rfsm_export.main(name, what, encode, argv)
  local parser = new_parser(name, "Write charts as " .. what .. ".")
  parser:option("-o --output", "file to write; - is stdout", "-"):argname("FILE")
  local options = parser:parse(argv)
  write(name, options.output, concat(encode_all(name, options.files, encode)))
end

local FORMATS = { "dot", "svg", "png", "pdf", "plantuml", "mermaid" }
local MODULE = {
  dot = "rfsm2dot", plantuml = "rfsm2plantuml", mermaid = "rfsm2mermaid",
}
local BY_ENDING = {
  dot = "dot", gv = "dot", svg = "svg", png = "png", pdf = "pdf", puml = "plantuml",
  plantuml = "plantuml", mmd = "mermaid", mermaid = "mermaid",
}

-- The format that is asked for, or that the name of the output tells.
local function format_of(parser, options)
  local file = options.output
  local format = options.format or file == "-" and "dot"
    or BY_ENDING[(file:match("%.(%w+)$") or ""):lower()]
  if not format then
    parser:error("the name '" .. file .. "' tells no format, -T expected ("
      .. concat(FORMATS, ", ") .. ")")
  end
  if not MODULE[format] and options.files[2] then
    parser:error("one FILE expected, " .. format .. " shows no more, got "
      .. #options.files)
  end
  return format
end

--- Run the tool that draws charts.
---@param argv string[] the command line
function rfsm_export.viz(argv)
  local name = "rfsm-viz"
  local parser = new_parser(name, "Draw charts.", "Pictures are laid out by Graphviz.")
  parser:option("-T --format", concat(FORMATS, ", ")
    .. "; without it the name of the output tells, or it is dot")
    :argname("FORMAT"):choices(FORMATS)
  parser:option("-o --output", "file to write; - is stdout", "-"):argname("FILE")
  local options = parser:parse(argv)
  local format = format_of(parser, options)
  local encode = require(MODULE[format] or "rfsm2dot").encode
  local text = concat(encode_all(name, options.files, encode))
  if not MODULE[format] then
    local picture, problem = render(format, text)
    if not picture then fail(name, problem) end
    text = picture
  end
  write(name, options.output, text)
end

-- Returns the lines about the chart in a file, how many problems, how many warnings.
local function check_file(file)
  local model, problem = rfsm_export.load_model(file)
  if not model then return { problem }, 1, 0 end
  local problems, warnings = rfsm_export.review(model, file)
  local lines, place = {}, name_of(file) .. ": "
  append(lines, problems, place)
  append(lines, warnings, place .. "warning: ")
  if not lines[1] then return { place .. "ok" }, 0, 0 end
  return lines, #problems, #warnings
end

-- Ends the tool with status 2 when a file is not to be read.
local function check_readable(name, files)
  for _, file in ipairs(files) do
    if file ~= "-" then
      local handle, problem = io.open(file)
      if not handle then fail(name, problem, 2) end
      local text, why = handle:read(1) -- a directory opens, too
      if not text and why then fail(name, file .. ": " .. why, 2) end
      handle:close()
    end
  end
end

--- Run the tool that checks charts.
---@param argv string[] the command line
function rfsm_export.check(argv)
  local name = "rfsm-check"
  local parser = new_parser(name, "Tell what is wrong, dead or suspicious in charts.",
    "The status is 0 when all charts are well, 1 when one has a problem, 2 when the "
    .. "command line is wrong or a file cannot be read.")
  parser:flag("-q --quiet", "print nothing; the status tells")
  parser:flag("-s --strict", "a warning counts as a problem")
  local options = parser:parse(argv)
  check_readable(name, options.files)
  require("rfsm_timeevent") -- so that their events are understood
  require("rfsm_await")
  local all, status = {}, 0
  for _, file in ipairs(options.files) do
    local lines, problems, warnings = check_file(file)
    append(all, lines, "")
    if problems > 0 or options.strict and warnings > 0 then status = 1 end
  end
  if not options.quiet then write(name, "-", concat(all, "\n") .. "\n") end
  os.exit(status)
end

return rfsm_export
