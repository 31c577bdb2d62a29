--- The command line. Each command is a module in `rfsm/cli/` with texts for the help,
-- `add_arguments(parser)`, and `run(options, parser)`, which may return an exit status.
--
-- @module rfsm.cli.main
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local common = require "rfsm.cli.common"
local exporters = require "rfsm.cli.exporters"
local opts = require "rfsm.shared.options"

local cli = {}

-- The commands in the order of the help. The commands of the exporters come after them.
local COMMANDS = { "check", "sim", "viz", "snapshot", "redis", "postgres", "fleet",
  "web", "watch", "size" }

local function print_version()
  print("rfsm " .. rfsm._VERSION:match("%S+$"))
  os.exit(0)
end

-- Prints what is wrong in one line, and ends the program. argparse calls this function
-- with the parser of the command; its hint is a second line.
local function refuse(parser, problem)
  io.stderr:write(parser.program, ": ", (problem:gsub("\nDid (.*)", " (did %1)")),
    "; see ", parser.program, " --help\n")
  os.exit(2)
end

-- Adds --version to the parser of a program, and sets how problems are reported and how
-- wide the help is. The help fits a terminal of 24 lines and 80 columns.
local function prepare(parser, program, is_hidden)
  parser.error, parser.program = refuse, program
  parser:usage_max_width(79):help_max_width(79):help_description_margin(26)
  parser:flag("-v --version", "print the version and end"):action(print_version)
    :hidden(is_hidden)
end

-- Words that other programs have for commands.
local OTHERS = {
  run = "sim", simulate = "sim", start = "sim", play = "sim", step = "sim",
  test = "check", lint = "check", verify = "check", explore = "check",
  validate = "check", draw = "viz", dot = "viz", show = "viz", graph = "viz",
  render = "viz", picture = "viz", export = "viz", serve = "web", server = "web",
  open = "web", monitor = "watch", version = "--version",
}

-- If a chart is named in place of a command, prints the right command and ends the
-- program.
local function refuse_file(name)
  if not name:find("%.lua$") then return end
  io.stderr:write("rfsm: '", name, "' is no command. To step through that chart, ",
    "type: rfsm sim ", name, "\n")
  os.exit(2)
end

-- Ends the program if no command has a name.
local function check_command(parser, parsers, name)
  if parsers[name] or name:find("^%-") then return end
  refuse_file(name)
  local other = OTHERS[name]
  parser:error(("no command is named '%s'%s"):format(name, other
    and (" (did you mean '%s'?)"):format(other)
    or advice.nearest_name(name, rfsm.sorted_keys(parsers))))
end

local function print_help(parser, parsers, argv)
  if argv[2] then check_command(parser, parsers, argv[2]) end
  print((parsers[argv[2]] or parser):get_help())
  return 0
end

--- Run the command that a list of arguments names; return the exit status.
function cli.main(argv)
  local argparse, problem = opts.find_package("argparse")
  if not argparse then
    io.stderr:write("rfsm: ", problem, "\n")
    os.exit(1)
  end
  local parser = argparse("rfsm", "Check, simulate and draw statecharts.")
    :command_target("command"):add_help { "-h --help", hidden = true }
  local commands, parsers = {}, {}
  local function add(name, command)
    commands[name] = command
    parsers[name] = parser:command(name, command.summary, command.epilog)
    command.add_arguments(parsers[name])
    prepare(parsers[name], "rfsm " .. name, true)
  end
  prepare(parser, "rfsm", false)
  parser:add_complete { "--completion", argname = "SHELL",
    description = "print the completions for bash, zsh or fish" }
  for _, name in ipairs(COMMANDS) do add(name, require("rfsm.cli." .. name)) end
  for _, command in ipairs(exporters.commands) do add(command.name, command) end
  if argv[1] == nil or argv[1] == "help" then
    return print_help(parser, parsers, argv)
  end
  check_command(parser, parsers, argv[1])
  local options = parser:parse(argv)
  common.command = options.command
  return commands[options.command].run(options, parsers[options.command]) or 0
end

return cli
