--- `rfsm web`: show a chart, or a machine of another process, in the browser.
--
-- @module rfsm.cli.web
-- @license BSD-3-Clause

local common = require "rfsm.cli.common"
local opts = require "rfsm.shared.options"

local web = {
  summary = "Show a chart, or a machine, in the browser.",
  epilog = "The page is for this machine only, unless --host names another address.",
}

function web.add_arguments(command)
  common.add_file(command):args("?")
  command:argument("more"):args("?"):hidden(true)
  common.add_stub(command)
  common.add_from(command)
  common.add_option(command, "-a --attach", "a machine that answers by rfsm.proto")
    :argname("HOST:PORT")
  common.add_number(command, "-m --machine", "with -a: its number at that port (all)")
  common.add_number(command, "-p --port", "of the page; 0 is one that is free",
    opts.whole(0, 65535)):default("8044")
  command:option("--host", "the address of the page", "127.0.0.1"):argname("HOST")
end

-- Ends the program if there is a second argument, which may be a port.
local function refuse_more(more, parser)
  if not more then return end
  parser:error(("one FILE expected, got '%s', too%s"):format(more, more:find("^%d+$")
    and (" (the port is an option: -p %s)"):format(more) or ""))
end

function web.run(options, parser)
  refuse_more(options.more, parser)
  if (options.file == nil) == (options.attach == nil) then
    parser:error("FILE or -a HOST:PORT expected")
  end
  local server
  local page = { host = options.host, port = options.port, machine = options.machine,
    stub = options.stub, from = options.from }
  if options.from and options.attach then
    parser:error("--from is for a FILE, not for -a")
  elseif options.attach then
    local host, port = common.address_of(parser, options.attach)
    server = common.try(require("rfsm.web").attach(host, port, page))
  else
    common.read(options.file)
    server = common.try(require("rfsm.web").open(options.file, page))
  end
  common.write("-", server.url .. "\n")
  common.until_interrupt(server.run, server)
end

return web
