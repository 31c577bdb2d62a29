-- Servers and other programs that specs start and stop again: Redis, PostgreSQL, nginx
-- and what a command names, each in a folder of its own; charts that they run.

local helper = require "spec.helper"

local has_socket, socket = pcall(require, "socket")

local servers = { has_socket = has_socket } -- the module that connections need

-- Charts ---------------------------------------------------------------------------

-- even --e_tick--> odd --e_tick--> even, counted
servers.COUNTER = [[
return rfsm.state {
  keep = { "n", "list" }, n = 0, even = rfsm.state {}, odd = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "even" },
  rfsm.trans { src = "even", tgt = "odd", events = { "e_tick" },
    effect = function(fsm) fsm.n = fsm.n + 1 end },
  rfsm.trans { src = "odd", tgt = "even", events = { "e_tick" },
    effect = function(fsm) fsm.n = fsm.n + 1 end },
}]]

--- Returns a new version of it: its effects add `by`; `more` are states.
function servers.counter(by, more)
  return (servers.COUNTER:gsub("n %+ 1", "n + " .. by):gsub("odd = ", (more or "")
    .. "odd = "))
end

--- Returns off --e_on--> on --e_off or so many seconds--> off --e_busy--> busy; `more`
-- are states and transitions.
function servers.lamp(seconds, more)
  return ([[
return rfsm.state {
  keep = { "owner" },
  off = rfsm.state { entry = function(fsm)
    fsm.times = (fsm.times or 0) + 1 -- not kept
    fsm.emit("off", { times = fsm.times, owner = fsm.owner })
  end },
  on = rfsm.state { entry = function() error("no bulb", 0) end },
  busy = rfsm.state { doo = function() while true do rfsm.yield() end end },
  rfsm.trans { src = "initial", tgt = "off" },
  rfsm.trans { src = "off", tgt = "on", events = { "e_on" },
    guard = function(tr) return tr._fsm.owner ~= "ghost" end },
  rfsm.trans { src = "on", tgt = "off", events = { "e_off", "e_after(%s)" } },
  rfsm.trans { src = "off", tgt = "busy", events = { "e_busy" } },
  %s
}]]):format(seconds, more or "")
end

-- a --at once--> b, whose entry never ends if the machine has `bad`
servers.ENDLESS = [[
return rfsm.state {
  keep = { "bad" }, bad = false, a = rfsm.state {},
  b = rfsm.state { entry = function(fsm) repeat until not fsm.bad end },
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_after(0)", "e_b" } },
}]]

-- RFSM_EVENTS=100000 makes the storms longer. They run under one Lua: what matters is
-- that many come at once.
servers.EVENTS = tonumber(os.getenv("RFSM_EVENTS"))
servers.HAS_STORMS = servers.EVENTS ~= nil or rawget(_G, "jit") ~= nil

-- Programs -------------------------------------------------------------------------

--- Runs a command of the shell; returns its output.
function servers.output_of(command) return helper.text_of(command .. " 2>&1") end

--- Runs a script of the shell at the same time; returns a function that waits for its
-- end, and returns the output.
function servers.beside(script)
  local pipe = assert(io.popen(script .. " 2>&1"))
  return function()
    local output = pipe:read("*a")
    pipe:close()
    return output
  end
end

local output_of = servers.output_of

--- Returns a port of this machine that nobody uses.
function servers.free_port()
  local listener = assert(socket.bind("127.0.0.1", 0))
  local _, port = listener:getsockname()
  listener:close()
  return ("%d"):format(port)
end

local running = {} -- what is to be stopped

-- Starts a server in a new folder: one of a class with `launch` and `kill`.
local function start(class, server)
  server.folder = output_of("mktemp -d"):match("%S+")
  running[#running + 1] = setmetatable(server, class)
  server:launch()
  return server
end

--- Kills a server after so many seconds, and launches it again, beside what this
-- process does; returns a function that waits until both is done.
function servers.crash_after(seconds, server)
  return servers.beside(([[
    sleep %g
    %s
    for try in $(seq 50); do %s >/dev/null && break; done]]):format(seconds,
    server:kill_command(), server:launch_command()))
end

--- Stops a server, and removes what it wrote.
function servers.stop(server)
  server:kill()
  output_of("rm -rf " .. server.folder)
  for i = #running, 1, -1 do
    if running[i] == server then table.remove(running, i) end
  end
end

--- Stops all servers.
function servers.stop_all()
  while running[1] do servers.stop(running[#running]) end
end

--- A program that a command starts, see `servers.program`.
---@class Program
---@field folder string
---@field command string
---@field id string? of the process, until it was ended
local Program = {}
Program.__index = Program

function Program:launch()
  self.id = helper.lines_of(("exec %s >'%s/log' 2>&1 </dev/null & echo $!"):format(
    self.command, self.folder))[1]
end

--- Ends it, if it has not ended, and waits for its end.
function Program:kill()
  if not self.id then return end
  output_of(("kill %s; timeout 10 tail --pid=%s -f /dev/null"):format(self.id, self.id))
  self.id = nil
end

--- Returns what it has printed so far.
function Program:log() return helper.content(self.folder .. "/log") end

--- Starts a command.
function servers.program(command) return start(Program, { command = command }) end

-- Redis ----------------------------------------------------------------------------

--- Returns what a spec needs and this machine or Lua lacks, as a reason; nil if it is
--- all there.
function servers.no_redis()
  for _, name in ipairs { "socket", "redis", "dkjson" } do
    if not helper.package(name) then
      return ("the module %s is missing for %s"):format(name, _VERSION)
    end
  end
  return output_of("command -v redis-server") == "" and "redis-server is missing" or nil
end

-- Waits until a server answers. It is there within seconds, or not at all.
local function wait_for(port)
  for _ = 1, 500 do
    if output_of(("redis-cli -p %s PING"):format(port)) == "PONG\n" then return end
    socket.sleep(0.02)
  end
  error("redis-server does not answer")
end

--- A server that was started.
---@class Redis
---@field port string
---@field folder string
---@field options string
local Redis = {}
Redis.__index = Redis

function Redis:launch_command()
  return ("redis-server --port %s --bind 127.0.0.1 --dir %s --daemonize yes "
    .. "--pidfile %s/pid --logfile %s/log --save '' %s"):format(self.port, self.folder,
    self.folder, self.folder, self.options)
end

function Redis:launch()
  output_of(self:launch_command())
  wait_for(self.port)
end

function Redis:kill_command() return "kill -9 $(cat " .. self.folder .. "/pid)" end

--- Kills it as a power cut would.
function Redis:kill()
  output_of(self:kill_command())
  for _ = 1, 500 do
    if not socket.connect("127.0.0.1", self.port) then return end
    socket.sleep(0.01)
  end
end

function Redis:url() return "redis://127.0.0.1:" .. self.port end

--- Runs redis-cli; returns its output.
function Redis:cli(arguments)
  return output_of(("redis-cli -p %s %s"):format(self.port, arguments))
end

-- In place of `redis`: TIME is what the key `clock` says, if it is there.
local CLOCK = [[(setmetatable({ call = function(name, ...)
  if name ~= "TIME" then return redis.call(name, ...) end
  local time, clock = redis.call("TIME"), redis.call("GET", "clock")
  local word, number = (clock or "by 0"):match("(%a+) (%S+)")
  local us = word == "at" and 0 or time[1] * 1e6 + time[2]
  us = math.floor(us + number * 1e6 + 0.5)
  return { ("%.0f"):format(math.floor(us / 1e6)), ("%.0f"):format(us % 1e6) }
end }, { __index = redis }),]]

--- Returns a library for Redis whose machines read a clock that can be moved.
function servers.with_clock(text)
  local changed, count = text:gsub('("rfsm%.redis%.store") %(redis,', function(name)
    return name .. " " .. CLOCK
  end)
  assert(count == 1, "the library reads TIME in another way")
  return changed
end

--- Stops the clock of the machines at a time.
function Redis:stop_clock(seconds) self:cli(("SET clock 'at %.6f'"):format(seconds)) end

--- Sets the clock of the machines so many seconds off.
function Redis:move_clock(seconds) self:cli(("SET clock 'by %.6f'"):format(seconds)) end

--- Starts a server with these options of the command line.
function servers.redis(options)
  return start(Redis, { port = servers.free_port(), options = options or "" })
end

local function request(...)
  local parts = { "*" .. select("#", ...) .. "\r\n" }
  for i = 1, select("#", ...) do
    local text = tostring((select(i, ...)))
    parts[#parts + 1] = "$" .. #text .. "\r\n" .. text .. "\r\n"
  end
  return table.concat(parts)
end

-- Reads the reply to a call: a list of texts, or an error.
local function read_reply(client)
  local line, problem = client:receive("*l")
  if not line then return nil, problem end
  if line:sub(1, 1) ~= "*" then return false, line end
  for _ = 1, tonumber(line:sub(2)) do
    local size = tonumber((client:receive("*l") or ""):match("^%$(%d+)"))
    if not size or not client:receive(size + 2) then return nil, "cut" end
  end
  return true
end

--- Sends events with many clients at once, each of which waits for every reply.
--
-- `next_key(i)` names the machine of call number i. Returns how many calls were
-- answered, by key; the errors; and how many were sent, by key. `each(i)` is called
-- after call number i. It ends when all are answered, or the server is gone.
function servers.storm(port, clients, calls, next_key, event, each)
  local sockets, key_of, answered, sent, errors = {}, {}, {}, {}, {}
  local made = 0
  local function send(client)
    if made >= calls then return end
    made = made + 1
    local key = next_key(made)
    key_of[client] = key
    if client:send(request("FCALL", "rfsm_send", 1, key, event)) then
      sent[key] = (sent[key] or 0) + 1
    end
    if each then each(made) end
  end
  local function receive(client)
    local ok, problem = read_reply(client)
    local key = key_of[client]
    if ok then answered[key] = (answered[key] or 0) + 1 end
    if ok == false then errors[#errors + 1] = problem end
    key_of[client] = nil
    if ok ~= nil then send(client) end
    return ok ~= nil
  end
  for i = 1, clients do
    sockets[i] = assert(socket.connect("127.0.0.1", port))
    sockets[i]:settimeout(10)
    send(sockets[i])
  end
  while next(key_of) do
    local ready = socket.select(sockets, nil, 10)
    local is_alive = ready[1] ~= nil
    for _, client in ipairs(ready) do
      if key_of[client] then is_alive = receive(client) and is_alive end
    end
    if not is_alive then break end
  end
  for i = 1, clients do sockets[i]:close() end
  return answered, errors, sent
end

-- PostgreSQL: reached by a socket in its folder -----------------------------------

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
function servers.no_postgres()
  return BIN == "" and "postgresql-*-pllua is missing" or nil
end

--- A server that was started.
---@class Postgres
---@field folder string
local Postgres = {}
Postgres.__index = Postgres

local function init(folder)
  if AS_USER ~= "" then output_of("chown postgres " .. folder) end
  output_of("chmod 755 " .. folder)
  output_of(("cd / && %s%s/initdb -D %s/data -N -A trust -U postgres -E UTF8 "
    .. "--locale=C.UTF-8"):format(AS_USER, BIN, folder))
end

function Postgres:launch_command()
  return ("cd / && %s%s/pg_ctl -D %s/data -w -l %s/log -o \"-k %s -c "
    .. "listen_addresses='' %s\" start"):format(AS_USER, BIN, self.folder, self.folder,
    self.folder, self.options)
end

function Postgres:launch()
  if not self.is_there then init(self.folder) end
  self.is_there = true
  local output
  for _ = 1, 50 do -- after a kill, until the last process of the server before is gone
    output = output_of(self:launch_command())
    if output:find("server started", 1, true) then return end
  end
  error(output .. output_of("cat " .. self.folder .. "/log"))
end

function Postgres:kill_command()
  return ("cd %s && pid=$(head -n 1 data/postmaster.pid); kill -STOP $pid; "
    .. "kill -9 $(pgrep -P $pid) $pid; rm -f .s.PGSQL.*"):format(self.folder)
end

--- Kills all its processes as a power cut would. Stopped, it begins no others.
function Postgres:kill() output_of(self:kill_command()) end

--- Returns the command for a program of PostgreSQL that reaches the server.
function Postgres:command(program, arguments)
  return ("PGHOST=%s PGUSER=postgres PGDATABASE=postgres %s/%s %s"):format(self.folder,
    BIN, program, arguments)
end

--- Runs SQL at the same time; returns a function that waits for its end, and returns
-- the output.
function Postgres:beside(text)
  return servers.beside(self:command("psql", "-XAqt -f " .. helper.file_with(text)))
end

--- Sends statements, a list for each client, at the same time. A client that loses its
-- connection goes on with the first statement that was not answered. Returns a function
-- that waits for the end of all, and returns the errors.
function Postgres:storm(lists)
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
function Postgres:wait_for(query)
  local output = self:sql(([[
SET statement_timeout = 60000;
DO $$ BEGIN
  WHILE (%s) IS NOT TRUE LOOP
    PERFORM pg_stat_clear_snapshot(), pg_sleep(0.01);
  END LOOP;
END $$;]]):format(query))
  assert(output == "", output .. query)
end

--- Runs SQL as one session; returns what psql prints, errors without their context.
function Postgres:sql(text)
  local output = output_of(self:command("psql", "-XAqt -v VERBOSITY=terse -f "
    .. helper.file_with(text)))
  return (output:gsub("psql:[^ ]+:%d+: ", ""))
end

-- What SQL sees as the time comes from a table. The functions of the server keep their
-- numbers, by which it knows them, under other names.
local CLOCK_OF_SQL = [[
CREATE SCHEMA clock;
CREATE TABLE clock.state (at timestamptz, off interval);
INSERT INTO clock.state VALUES (NULL, '0');
GRANT USAGE ON SCHEMA clock TO PUBLIC;
GRANT SELECT ON clock.state TO PUBLIC;
]] .. ("clock_timestamp now"):gsub("%S+", [[
ALTER FUNCTION pg_catalog.%0() RENAME TO real_%0;
CREATE FUNCTION pg_catalog.%0() RETURNS timestamptz LANGUAGE sql AS $$
  SELECT coalesce(at, real_clock_timestamp() + off) FROM clock.state $$;
]])

local function set_clock(server, at, seconds)
  local update = ("UPDATE clock.state SET at = to_timestamp(%s), off = "
    .. "make_interval(secs => %.6f);"):format(at, seconds)
  local output = server:sql((server.has_clock and "" or CLOCK_OF_SQL) .. update)
  assert(output == "", output)
  server.has_clock = true
end

--- Stops the clock that SQL sees at a time.
function Postgres:stop_clock(seconds) set_clock(self, ("%.6f"):format(seconds), 0) end

--- Sets the clock that SQL sees so many seconds off.
function Postgres:move_clock(seconds) set_clock(self, "NULL", seconds) end

--- Starts a server with these options of the command line.
function servers.postgres(options)
  return start(Postgres, { options = options or "" })
end

-- nginx ----------------------------------------------------------------------------

-- It is installed, or unpacked in the folder NGINX_ROOT.
local NGINX = os.getenv "NGINX_ROOT" or ""
local MODULES = NGINX .. "/usr/lib/nginx/modules"

--- Returns what is missing; nil if nginx and its Lua module are there.
function servers.no_nginx()
  if has_socket and io.open(MODULES .. "/ngx_http_lua_module.so") then return nil end
  return "luasocket, or nginx with its Lua module (NGINX_ROOT), is missing"
end

--- Starts nginx in this folder with a file of settings.
function servers.nginx(conf)
  return servers.program(([[sh -c '
    export LD_LIBRARY_PATH=$(echo %s/usr/lib/*-gnu %s/lib/*-gnu | tr " " :)
    export LUA_PATH="%s/usr/share/lua/5.1/?.lua;;" PATH="%s/usr/sbin:$PATH"
    exec nginx -e stderr -p "$PWD" -c "%s" -g "master_process off;
      load_module %s/ndk_http_module.so; load_module %s/ngx_http_lua_module.so;"']])
    :format(NGINX, NGINX, NGINX, NGINX, conf, MODULES, MODULES))
end

return servers
