--- `rfsm postgres`: bundle charts as a schema of PostgreSQL.
--
-- @module rfsm.cli.postgres
-- @license BSD-3-Clause

local common = require "rfsm.cli.common"
local programs = require "rfsm.shared.programs"

local postgres = {
  summary = "Bundle charts as SQL for PostgreSQL.",
  epilog = common.CHART_NAMES,
}

function postgres.add_arguments(command)
  common.add_charts(command, "DATABASE", "load it there, by psql")
  command:option("--stats", "print the numbers there, for Prometheus")
    :argname("DATABASE")
  command:flag("--client", "only tables, for rfsm.postgres, without PL/Lua")
  command:flag("--history", "keep the moves of each machine in a table")
  common.add_number(command, "--history-days", "workers remove moves that are older",
    common.SIZE)
  command:flag("--notify", "report moves to those who LISTEN")
end

-- Has psql run SQL in a database: a name, or the address that psql takes. Returns its
-- output, and what it reports. If it is refused, nothing was done, and the program ends
-- with this status.
local function run(sql, database, status)
  local ok, output, log = programs.run("psql -XAqt -v ON_ERROR_STOP=1 -v "
    .. "VERBOSITY=terse -d " .. programs.quoted(database):gsub("%%", "%%%%")
    .. " -f %s", sql)
  if ok then return output, log end
  common.fail(log:match("ERROR: *([^\n]*)") or log:match("[^\n]+") or "psql failed",
    status)
end

-- Loads SQL into a database, and reports warnings.
local function load(sql, database)
  local _, log = run(sql, database, 2)
  for line in log:gmatch "WARNING: *([^\n]*)" do common.warn(line) end
end

function postgres.run(options, parser)
  local script, text = require "rfsm.postgres.script", nil
  if options.stats then
    return common.write("-", (run("SELECT * FROM rfsm.metrics()", options.stats)))
  end
  local settings = { history = options.history or options.history_days ~= nil,
    notify = options.notify, history_days = options.history_days }
  if not options.client then
    text = common.library_of(script.sql, options, parser, settings)
  elseif options.files[1] or options.ids or options.ids_for then
    parser:error("--client: no charts and no ids expected, the client has them")
  else
    text = script.tables(settings)
  end
  common.deliver(text, options, load)
end

return postgres
