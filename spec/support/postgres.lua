-- Real PostgreSQL servers for the specs: each in a folder of its own, reached by a
-- socket there.

local helper = require "spec.helper"
local servers = require "spec.support.servers"

local output_of = servers.output_of

local postgres = setmetatable({}, { __index = servers })

-- The programs of the newest server for which PL/Lua is there; "" if there is none.
local BIN = output_of([[
  for file in $(ls -v /usr/share/postgresql/*/extension/pllua.control 2>/dev/null); do
    version=${file#/usr/share/postgresql/}
    bin=/usr/lib/postgresql/${version%%/*}/bin
    [ -x $bin/initdb ] && last=$bin
  done
  echo $last]]):match("%S*")

-- The server refuses to run as root.
local AS_USER = output_of("id -u") == "0\n" and "runuser -u postgres -- " or ""

--- Returns what a spec needs and this machine lacks, as a reason; nil if it is there.
function postgres.missing()
  return BIN == "" and "postgresql-*-pllua is missing" or nil
end

--- A server that was started.
---@class PostgresServer
---@field folder string
local Server = {}
Server.__index = Server

local function init(folder)
  if AS_USER ~= "" then output_of("chown postgres " .. folder) end
  output_of("chmod 755 " .. folder)
  output_of(("cd / && %s%s/initdb -D %s/data -N -A trust -U postgres -E UTF8 "
    .. "--locale=C.UTF-8"):format(AS_USER, BIN, folder))
end

function Server:launch()
  if not self.is_there then init(self.folder) end
  self.is_there = true
  local command = ("cd / && %s%s/pg_ctl -D %s/data -w -l %s/log -o \"-k %s -c "
    .. "listen_addresses='' %s\" start"):format(AS_USER, BIN, self.folder, self.folder,
    self.folder, self.options)
  local output
  for _ = 1, 50 do -- after a kill, until the last process of the server before is gone
    output = output_of(command)
    if output:find("server started", 1, true) then return end
  end
  error(output .. output_of("cat " .. self.folder .. "/log"))
end

--- Kills all its processes as a power cut would. Stopped, it begins no others.
function Server:kill()
  output_of(("cd %s && pid=$(head -n 1 data/postmaster.pid); kill -STOP $pid; "
    .. "kill -9 $(pgrep -P $pid) $pid; rm -f .s.PGSQL.*"):format(self.folder))
end

--- Returns the command for a program of PostgreSQL that reaches the server.
function Server:command(program, arguments)
  return ("PGHOST=%s PGUSER=postgres PGDATABASE=postgres %s/%s %s"):format(self.folder,
    BIN, program, arguments)
end

--- Runs SQL at the same time; returns a function that waits for its end, and returns
-- the output.
function Server:beside(text)
  return servers.beside(self:command("psql", "-XAqt -f " .. helper.file_with(text)))
end

--- Sends statements, a list for each client, at the same time. A client that loses its
-- connection goes on with the first statement that was not answered. Returns a function
-- that waits for the end of all, and returns the errors.
function Server:storm(lists)
  local ends = {}
  for i, lines in ipairs(lists) do
    local file = helper.file_with(table.concat(lines, "\n") .. "\n")
    ends[i] = servers.beside(([[
      n=0 tries=0
      while [ $n -lt %d ] && [ -e %s ]; do
        [ $tries -lt 2000 ] || { echo gave up; break; }
        [ $tries = 0 ] || sleep 0.1
        tries=$((tries + 1))
        [ "$(echo %s/.s.PGSQL.*)" = "%s/.s.PGSQL.*" ] && continue # it is not there yet
        tail -n +$((n + 1)) %s | %s 2>&1 >>%s.out
        n=$(wc -l <%s.out)
      done
      rm %s.out]]):format(#lines, file, self.folder, self.folder, file,
      self:command("psql", "-XAqt -v ON_ERROR_STOP=1"), file, file, file))
  end
  return function()
    local errors = {}
    for i, finish in ipairs(ends) do errors[i] = finish() end
    return table.concat(errors)
  end
end

--- Waits until a query returns true. It does within seconds, or not at all.
function Server:wait_for(query)
  local output = self:sql(([[
SET statement_timeout = 60000;
DO $$ BEGIN
  WHILE (%s) IS NOT TRUE LOOP PERFORM pg_sleep(0.01); END LOOP;
END $$;]]):format(query))
  assert(output == "", output .. query)
end

--- Runs SQL as one session; returns what psql prints, errors without their context.
function Server:sql(text)
  local output = output_of(self:command("psql", "-XAqt -v VERBOSITY=terse -f "
    .. helper.file_with(text)))
  return (output:gsub("psql:[^ ]+:%d+: ", ""))
end

--- Starts a server with these options of the command line.
function postgres.start(options)
  return servers.start(Server, { options = options or "" })
end

return postgres
