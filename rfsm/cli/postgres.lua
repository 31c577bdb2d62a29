--- `rfsm postgres`: bundle charts as a schema of PostgreSQL.
--
-- @module rfsm.cli.postgres
-- @license BSD-3-Clause

local common = require "rfsm.cli.common"
local files = require "rfsm.shared.files"

local postgres = {
  summary = "Bundle charts as SQL for PostgreSQL.",
  epilog = common.CHART_NAMES,
}

function postgres.add_arguments(command)
  common.add_charts(command)
  common.add_option(command, "-o --output", "file to write; - is stdout")
    :argname("FILE")
  common.add_option(command, "-l --load", "load it there, by psql")
    :argname("DATABASE")
  command:option("--stats", "print the numbers there, for Prometheus")
    :argname("DATABASE")
  command:flag("--client", "only tables, for rfsm.postgres, without PL/Lua")
  command:flag("--history", "keep the moves of each machine in a table")
  common.add_number(command, "--history-days", "workers remove moves that are older",
    common.SIZE)
  command:flag("--notify", "report moves to those who LISTEN")
end

-- Runs psql for a database: a name, or the address that psql takes. Returns its output;
-- nil and the reason in one line if it fails.
local function run(arguments, database)
  local log = os.tmpname()
  local status = os.execute(("psql -XAqt -v ON_ERROR_STOP=1 -v VERBOSITY=terse %s "
    .. "-d %s >'%s' 2>&1"):format(arguments, common.quoted(database), log))
  local output = files.read(log) or ""
  os.remove(log)
  if status == true or status == 0 then return output end
  return nil, output:match("ERROR: *([^\n]*)") or output:match("[^\n]+")
    or "psql failed"
end

-- Loads SQL into a database. If it is refused, nothing was loaded, and the program
-- ends with status 2.
local function load(sql, database)
  local script = os.tmpname()
  common.try(files.write(script, sql))
  local output, problem = run(("-f '%s'"):format(script), database)
  os.remove(script)
  if not output then common.fail(problem, 2) end
  for line in output:gmatch "WARNING: *([^\n]*)" do common.warn(line) end
end

-- Returns the numbers of a database for Prometheus.
local function stats(database)
  return common.try(run("-c 'SELECT * FROM rfsm.metrics()'", database))
end

function postgres.run(options, parser)
  local script, text = require "rfsm.postgres.script", nil
  if options.stats then return common.write("-", stats(options.stats)) end
  local settings = { history = options.history or options.history_days ~= nil,
    notify = options.notify, history_days = options.history_days }
  if not options.client then
    text = common.library_of(script.sql, options, parser, settings)
  elseif options.files[1] or options.ids or options.ids_for then
    parser:error("--client: no charts and no ids expected, the client has them")
  else
    text = script.tables(settings)
  end
  if options.load then load(text, options.load) end
  if options.output or not options.load then
    common.write(options.output or "-", text)
  end
end

return postgres
