--- `rfsm postgres`: bundle charts as a schema of PostgreSQL.
--
-- @module rfsm.cli.postgres
-- @license BSD-3-Clause

local common = require "rfsm.cli.common"

local postgres = {
  summary = "Bundle charts as SQL for PostgreSQL.",
  epilog = common.CHART_NAMES,
}

function postgres.add_arguments(command)
  common.add_charts(command)
  common.add_option(command, "-o --output", "file to write; - is stdout", "-")
    :argname("FILE")
  command:flag("--client", "only tables, for rfsm.postgres, without PL/Lua")
  command:flag("--history", "keep the moves of each machine in a table")
  command:flag("--notify", "report moves to those who LISTEN")
end

function postgres.run(options, parser)
  local script, text = require "rfsm.postgres.script", nil
  local settings = { history = options.history, notify = options.notify }
  if not options.client then
    text = common.library_of(script.sql, options, parser, settings)
  elseif options.files[1] or options.ids or options.ids_for then
    parser:error("--client: no charts and no ids expected, the client has them")
  else
    text = script.tables(settings)
  end
  common.write(options.output, text)
end

return postgres
