--- `rfsm check`: report problems and suspicious parts of charts.
--
-- @module rfsm.cli.check
-- @license BSD-3-Clause

local chart = require "rfsm.shared.chart"
local common = require "rfsm.cli.common"
local files = require "rfsm.shared.files"
local opts = require "rfsm.shared.options"

local concat = table.concat

local check = {
  summary = "Report problems and suspicious parts of charts.",
  epilog = "FILE: chart or system, - is stdin. Status: 0, 1 (problem), 2 (no file).",
}

local function print_codes()
  for _, entry in ipairs(require("rfsm.checks.codes").list) do
    print(("%-16s%-9s%s"):format(entry.code, entry.severity, entry.meaning))
  end
  os.exit(0)
end

function check.add_arguments(command)
  common.add_files(command):hidden(true)
  command:usage("Usage: rfsm check [OPTION] ... FILE [FILE] ...")
  common.add_stub(command)
  common.add_machine(command)
  command:flag("-a --all", "print notes, too")
  command:flag("-q --quiet", "print nothing, only set the status")
  command:flag("-s --strict", "count a warning as a problem")
  command:flag("--codes", "list the codes of findings and end"):action(print_codes)
  command:flag("-x --explore", "print the numbers of the exploration, too")
  command:flag("--static", "do not explore: check the structure only")
  common.add_number(command, "-k --together", "events in one step, at most")
  common.add_number(command, "--configurations", "explore so many, at most (10000)")
  common.add_number(command, "--seconds", "explore so long, at most", { "seconds",
    opts.is_seconds })
  command:flag("--no-overlap", "a system: moves do not cross"):hidden(true)
  command:option("--deployed", "what is not as a system says: .xml, .ops, .lua")
    :argname("FILE")
  command:option("--record", "write runs that show findings: FILE, FILE.2 ...")
    :argname("FILE")
  command:option("--tests", "write a spec that takes every transition")
    :argname("KIND"):choices { "busted" }
  command:flag("--callbacks", "tests: run entries, exits and effects, too")
  common.add_output(command, "tests: file to write, - for stdout")
end

-- Writes to stderr the lines that are in only one text: - in the old one, + in the new.
local function report_difference(old, new)
  local function lines_of(text)
    local list, set = {}, {}
    for line in text:gmatch("[^\n]+") do list[#list + 1], set[line] = line, true end
    return list, set
  end
  local old_list, in_old = lines_of(old)
  local new_list, in_new = lines_of(new)
  for _, line in ipairs(old_list) do
    if not in_new[line] then io.stderr:write("-", line, "\n") end
  end
  for _, line in ipairs(new_list) do
    if not in_old[line] then io.stderr:write("+", line, "\n") end
  end
end

-- Returns a text if the exploration ended at a bound, else nil.
local function text_of_bound(bound)
  local option = bound == "choices" and "configurations" or bound
  return bound and ("the exploration ended at its bound on %s: what lies behind it has "
    .. "no test (--%s N)"):format(bound, option)
end

local function write_tests(options, parser)
  local file, output = options.files[1], options.output or "-"
  if options.files[2] then
    parser:error("one FILE expected, tests are those of one chart, got "
      .. #options.files)
  end
  if file == "-" then parser:error("FILE expected, tests load it again, got -") end
  local model = common.try(common.load_model(file, options.stub, options.machine))
  local old_text = output ~= "-" and files.read(output)
  local text, result = common.call(file, require("rfsm.tests.tests").busted, file,
    model, { callbacks = options.callbacks, stub = options.stub,
      machine = options.machine, file = file, seconds = options.seconds,
      configurations = options.configurations or require("rfsm.cli.review").MANY },
    output, old_text)
  local ended = text_of_bound(result.bound)
  if not result.runs[1] then
    common.fail(("%s: %s"):format(file, result.skipped == 0 and ended
      or "no run of it repeats itself"))
  end
  common.write(output, text)
  common.warn(("%d of %d transitions in %d steps"):format(result.taken,
    result.transitions, result.steps))
  if ended then common.warn(ended) end
  if result.skipped > 0 then
    common.warn(("left out: %d runs that do not repeat themselves"):format(
      result.skipped))
  end
  if old_text then report_difference(old_text, text) end
end

-- Returns the reason why a chart cannot be checked. It begins with the name of the file
-- of declarations if `failure` does so, or else with the name of the chart.
local function reason(file, failure)
  local text = chart.first_line(failure)
  local name = require("rfsm.cli.review").properties_of(file)
  return text:find(name, 1, true) == 1 and text or chart.reason(file, failure)
end

-- Returns lines about the chart in a file, and the gravest severity of its findings.
local function lines_about(file, options)
  local review = require("rfsm.cli.review")
  local settings, model, warnings, world
  options.required, model, warnings, world = review.noting_extensions(function()
    local problem
    settings, problem = review.settings_for(file)
    if not settings then common.fail(problem, 2) end
    return common.load_model(file, options.stub, options.machine,
      require("rfsm.system").load)
  end)
  if not model then return { warnings }, "error" end
  local ok, lines, gravest = common.with_streams(common.NOWHERE, review.of, file,
    model, warnings, settings, options)
  if not ok then return { reason(file, lines) }, "error" end
  for _, line in ipairs(chart.lines_of(file, world)) do lines[#lines + 1] = line end
  return lines, gravest
end

function check.run(options, parser)
  if not options.tests and (options.callbacks or options.output) then
    parser:error("-o and --callbacks need --tests busted")
  end
  for _, file in ipairs(options.files) do common.read(file) end
  require("rfsm_timeevent") -- so that events such as e_after(1) are known
  require("rfsm.await")
  if options.tests then return write_tests(options, parser) end
  local texts, status = {}, 0
  for i, file in ipairs(options.files) do
    local lines, gravest = lines_about(file, options)
    texts[i] = concat(lines, "\n") .. "\n"
    if gravest == "error" or options.strict and gravest then status = 1 end
  end
  if not options.quiet then common.write("-", concat(texts)) end
  return status
end

return check
