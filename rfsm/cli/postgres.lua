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
  command:argument("files", "Lua files that return a chart"):args("+")
    :argname("[NAME=]FILE")
  command:option("-o --output", "file to write; - is stdout", "-"):argname("FILE")
  command:flag("--history", "keep the moves of each machine in a table")
  command:flag("--notify", "report moves to those who LISTEN")
  common.add_ids(command)
end

function postgres.run(options, parser)
  local ok, text, warnings = common.with_streams(io.stderr,
    require("rfsm.postgres.bundle").sql, options.files, { history = options.history,
      notify = options.notify, ids = common.number_of(parser, "ids", options.ids),
      ids_for = common.number_of(parser, "ids-for", options.ids_for) })
  if not ok then common.fail(chart.first_line(text)) end
  for _, line in ipairs(warnings) do io.stderr:write("rfsm postgres: ", line, "\n") end
  common.write(options.output, text)
end

return postgres
