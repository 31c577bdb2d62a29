--- `rfsm watch`: print the changes of a machine in another process.
--
-- @module rfsm.cli.watch
-- @license BSD-3-Clause

local common = require "rfsm.cli.common"

local watch = {
  summary = "Print a machine that runs elsewhere, as it changes.",
  epilog = "The machine answers by rfsm.proto; its port is 44044 if none is given.",
}

function watch.add_arguments(command)
  command:argument("address", "where it answers"):argname("HOST[:PORT]")
  common.add_number(command, "-m --machine", "its number at that port"):default("1")
  common.add_number(command, "-n --count", "end after N lines")
end

function watch.run(options, parser)
  local host, port = common.address_of(parser, options.address)
  local client = common.try(require("rfsm.observe.subscriber").connect(host, port))
  io.stdout:setvbuf("line")
  common.until_interrupt(require("rfsm.proto.follow").run, client, {
    number = options.machine, count = options.count,
    is_terminal = require("rfsm.sim.terminal").is_terminal(1),
  })
end

return watch
