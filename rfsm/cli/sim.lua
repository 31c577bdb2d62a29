--- `rfsm sim`: step through a chart by hand.
--
-- @module rfsm.cli.sim
-- @license BSD-3-Clause

local common = require "rfsm.cli.common"

local sim = {
  summary = "Step through a chart by hand.",
  epilog = "Commands are read from the terminal or from a pipe; help() lists them.",
}

function sim.add_arguments(command)
  common.add_file(command)
  common.add_stub(command)
  common.add_option(command, "-e --execute", "run CODE, and end")
    :argname("CODE"):count("*")
  command:flag("-i --interactive", "read commands after CODE, too")
  common.add_option(command, "-r --replay", "run through the recording in FILE first")
    :argname("FILE")
  common.add_from(command)
  command:flag("-d --dry", "leave the functions of the chart out")
  command:flag("-q --quiet", "print no banner, and no infos")
end

function sim.run(options)
  common.read(options.file)
  if options.replay then common.read(options.replay) end
  local open = require("rfsm.cli.side_by_side").open
  return require("rfsm.sim.simulator").main(options, open)
end

return sim
