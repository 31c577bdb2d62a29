--- The command line. Each command is a module in `rfsm/cli/`: texts of its help,
-- `add_arguments(parser)`, and `run(options, parser)`, which may return a status.
--
-- @module rfsm.cli.main
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local common = require "rfsm.cli.common"
local encoders = require "rfsm.cli.encoders"
local opts = require "rfsm.shared.options"

local cli = {}

local COMMANDS = {
  "check", "sim", "viz", "snapshot", "redis", "json", "plantuml", "dot", "mermaid",
  "web", "watch",
}

local function print_version()
  print("rfsm " .. rfsm._VERSION:match("%S+$"))
  os.exit(0)
end

-- argparse calls this with the parser of the command, whose usage is printed.
local function report_usage(parser, problem)
  io.stderr:write(parser:get_usage(), "\n\nError: ", problem, "\n")
  os.exit(2)
end

-- Adds what every parser has.
local function prepare(parser)
  parser.error = report_usage
  parser:flag("-v --version", "print the version and end"):action(print_version)
end

--- Run a command.
---@param argv string[] the command line without the name of the program
---@return integer status for the shell
function cli.main(argv)
  local argparse, problem = opts.find_package("argparse", "lua-argparse")
  if not argparse then
    io.stderr:write("rfsm: ", problem, "\n")
    os.exit(1)
  end
  local parser = argparse("rfsm", "Check, simulate and draw statecharts.")
    :command_target("command")
  local commands, parsers = {}, {}
  prepare(parser)
  for _, name in ipairs(COMMANDS) do
    local command = encoders[name] or require("rfsm.cli." .. name)
    commands[name] = command
    parsers[name] = parser:command(name, command.summary, command.epilog)
    command.add_arguments(parsers[name])
    prepare(parsers[name])
  end
  local options = parser:parse(argv)
  common.command = options.command
  return commands[options.command].run(options, parsers[options.command]) or 0
end

return cli
