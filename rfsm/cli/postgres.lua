--- `rfsm postgres`: bundle charts as a schema of PostgreSQL.
--
-- @module rfsm.cli.postgres
-- @license BSD-3-Clause

local chart = require "rfsm.shared.chart"
local common = require "rfsm.cli.common"

local postgres = {
  summary = "Bundle charts as SQL: tables and functions for PostgreSQL.",
  epilog = "The name of a chart is that of its file; NAME=FILE gives another one. Of "
    .. "charts with one name the last is the newest.",
}

function postgres.add_arguments(command)
  command:argument("files", "Lua files that return a chart"):args("*")
    :argname("[NAME=]FILE")
  command:option("-o --output", "file to write; - is stdout", "-"):argname("FILE")
  command:flag("--client", "only tables, for rfsm.postgres, which runs charts "
    .. "where PL/Lua is missing")
  command:flag("--history", "keep the moves of each machine in a table")
  command:flag("--notify", "report moves to those who LISTEN")
  common.add_ids(command)
end

-- Returns the SQL that the options ask for.
local function sql_of(options, parser)
  local settings = { history = options.history, notify = options.notify,
    ids = common.number_of(parser, "ids", options.ids),
    ids_for = common.number_of(parser, "ids-for", options.ids_for) }
  local bundle = require "rfsm.postgres.bundle"
  if options.client then
    if options.files[1] or settings.ids or settings.ids_for then
      parser:error("--client: no charts and ids expected, the client has them")
    end
    return bundle.tables(settings)
  end
  if not options.files[1] then parser:error("a chart expected") end
  local ok, text, warnings = common.with_streams(io.stderr, bundle.sql, options.files,
    settings)
  if not ok then common.fail(chart.first_line(text)) end
  for _, line in ipairs(warnings) do io.stderr:write("rfsm postgres: ", line, "\n") end
  return text
end

function postgres.run(options, parser)
  common.write(options.output, sql_of(options, parser))
end

return postgres
