--- A machine in the browser: a server for one page, which shows it and takes events.
--
-- `serve` serves the page of a machine from your program, which calls `server:step` in
-- its loop. `open` makes the machine of a chart, and the page drives this machine; the
-- command `rfsm web` calls `open`. This module needs the packages luasocket and dkjson.
-- Pictures need Graphviz.
--
-- The server listens on loopback. It answers only requests whose Host header is an
-- address or the name of the server. Commands need the token that is in the page.
--
-- The sections of this file: messages, commands, pictures, routes, public functions.
--
-- @module rfsm.web
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local calls = require "rfsm.shared.calls"
local files = require "rfsm.shared.files"
local Served = require "rfsm.web.served"
local opts = require "rfsm.shared.options"
local outline = require "rfsm.observe.outline"
local Painter = require "rfsm.web.picture"

local error, ipairs, pcall = error, ipairs, pcall
local rawget, rawset, require, setmetatable = rawget, rawset, require, setmetatable
local tonumber, type = tonumber, type
local huge, min = math.huge, math.min

local web = {}

local is_boolean = opts.is_a "boolean"

local function is_title(x) return opts.is_text(x) or type(x) == "table" end

-- A list for each option: description of valid values, test, default.
local OPTIONS = {
  allow_send = { "boolean", is_boolean, false },
  allow_why = { "boolean", is_boolean, false },
  clock = { "function that returns seconds", rfsm.is_callable },
  from = { "file", opts.is_text },
  history = { "boolean", is_boolean, false },
  host = { "name or address", opts.is_text, "127.0.0.1" },
  machine = { "whole number from 1 on", opts.is_whole(1, huge) },
  port = opts.whole(0, 65535, 8044),
  stub = { "boolean", is_boolean, false },
  title = { "text or list of texts", is_title },
}

local MAX_DRAWN = 2000 -- nodes; Graphviz does not draw a machine that has more
local FRAME = 1 / 30 -- least number of seconds between two messages to a page
local LINGER = 5 -- seconds that a machine is observed after the last page has gone

local CSP = "default-src 'none'; script-src 'nonce-%s'; style-src 'unsafe-inline'; "
  .. "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; "
  .. "frame-ancestors 'none'"

-- Messages to the page -----------------------------------------------------------

--- A server of one page.
---@class rfsm.web.Server
---@field url string the address of the page, for a browser
---@field host string
---@field port integer
---@field sources table[] an object of `rfsm.web.served`, `.driven` or `.remote` for
-- each tab; the list grows when another machine of a port is found
local Server = {}
Server.__index = Server

-- Returns the version of a tab, a text. When it changes, a page fetches the chart and
-- the picture of the tab again.
local function version_of(server, tab)
  return ("%s-%d-%d-%d"):format(server.id, tab, #server.sources,
    server.sources[tab].generation)
end

-- Returns the next message for a page, and the new cursor of the page. A cursor says
-- how much the page knows already (see `rfsm.web.view`).
local function state_message(server, tab, cursor, version)
  local source, message = server.sources[tab], {}
  local view, next_cursor = source.view, { version = version, rewrites = -1 }
  if view then
    local is_known = cursor and cursor.version == version
    message, next_cursor = view:state(is_known and cursor or nil)
    next_cursor.version, next_cursor.revision = version, view.revision
  end
  next_cursor.at, message.is_full = server.gettime(), message.is_full ~= false
  message.version, message.server = version, server.id
  source:describe(message)
  local text = server.json.encode(message)
  return ("event: state\ndata: %s\n\n"):format(text), next_cursor
end

-- Is the machine of a view drawn? Graphviz takes too long for a very large one.
local function is_drawn(view)
  return view and #view.outline.nodes <= MAX_DRAWN or false
end

local function chart_reply(server, _, tab)
  local source = server.sources[tab]
  local chart = source.view and source.view:chart() or {}
  chart.title, chart.version = source.title, version_of(server, tab)
  chart.server, chart.machines = server.id, {}
  for i, other in ipairs(server.sources) do chart.machines[i] = other.title end
  chart.problems, chart.commands = source.problems, rfsm.sorted_keys(source.commands)
  chart.has_picture = is_drawn(source.view)
  return { type = "application/json", body = server.json.encode(chart) }
end

-- Commands from the page ---------------------------------------------------------

local function decode(server, text)
  local ok, message = pcall(server.json.decode, text, 1, nil, nil, nil)
  return ok and type(message) == "table" and message or nil
end

-- Returns a hint if a message sends an event that no transition names; otherwise nil.
local function hint_for(source, message)
  if message.command ~= "send" then return nil end
  return outline.hint_for(source.view.outline, (source.view:event_of(message)))
end

local function command_reply(server, request, tab)
  if request.headers["x-rfsm-token"] ~= server.token then return { status = 403 } end
  local source, message = server.sources[tab], decode(server, request.body)
  local command = message and source.commands[message.command]
  if not command then return { status = 400, body = "no such command\n" } end
  if not source.view then return { status = 400, body = "no machine\n" } end
  local problem, answer = command(source, message)
  if problem then return { status = 400, body = problem .. "\n" } end
  if type(answer) == "table" then
    return { type = "application/json", body = server.json.encode(answer) }
  end
  answer = answer or hint_for(source, message)
  return { status = answer and 200 or 204, body = answer }
end

-- Pictures ------------------------------------------------------------------------

-- Answers with the picture of a machine. The request lists the numbers of the
-- composites that are drawn folded, and has the size of its panel in points, such as
-- sheet=672x372, for a layout that fits it. The page asks again until it is ready.
local function picture_reply(server, request, tab)
  local source, numbers = server.sources[tab],
    request.query:match("folded=([%d,]*)") or ""
  local view = source.view
  if not is_drawn(view) then return { status = 404 } end
  local key = ("%d %d %s"):format(tab, source.generation, numbers)
  local svg = server.painter:ask(key, function()
    local folded = {}
    for number in numbers:gmatch("%d+") do
      local node = view.outline.nodes[number + 1]
      folded[#folded + 1] = node and node.fqn
    end
    return { graph = view.description, folded = folded, machine = tab }
  end)
  if svg then return { type = "image/svg+xml", body = svg } end
  return { status = svg == nil and 202 or 404 }
end

-- Routes --------------------------------------------------------------------------

local ROUTES = {
  ["/"] = { GET = function(server)
    return { type = "text/html", body = server.page, policy = server.policy }
  end },
  ["/chart"] = { GET = chart_reply },
  ["/picture.svg"] = { GET = picture_reply },
  ["/events"] = { GET = function(server, request, tab)
    if request.query:match("token=(%x*)") ~= server.token then
      return { status = 403 }
    end
    return { type = "text/event-stream", stream = tab, body = "retry: 1000\n\n" }
  end },
  ["/command"] = { POST = command_reply },
}

-- Is the host of the request an address, or the name of this server? Any other name may
-- belong to a hostile page whose owner pointed it at this address (DNS rebinding).
local function is_for(server, host)
  local name = (host or ""):gsub(":%d+$", "")
  return name == "localhost" or name == server.name or name:find("^[%d.]+$") ~= nil
    or name:find("^%[[%x:]+%]$") ~= nil
end

-- Does a page of another server send the request? Such a page may only link to "/".
local function is_foreign(request)
  local site = request.headers["sec-fetch-site"]
  return request.path ~= "/" and (site == "cross-site" or site == "same-site")
end

local function handle(server, request)
  if not is_for(server, request.headers.host) or is_foreign(request) then
    return { status = 403 }
  end
  local route = ROUTES[request.path]
  local tab = tonumber(request.query:match("machine=(%d+)") or 1)
  if not (route and server.sources[tab]) then return { status = 404 } end
  local answer = route[request.method]
  return answer and answer(server, request, tab) or { status = 405 }
end

-- Answers a request. An interrupt (Control-C) ends the server; an error does not.
local function handle_safely(server, request)
  local ok, reply = calls.try(handle, server, request)
  if ok then return reply end
  return { status = 500, body = rfsm.text_of(reply) .. "\n" }
end

-- Public functions ------------------------------------------------------------------

-- Sends the changes to each page that has received its last message, at most once in
-- FRAME seconds. Pages that know the same have the same cursor, and get one text.
local function send_changes(server)
  local messages, now = {}, server.gettime()
  server.is_late = false
  server.http:feed(function(connection)
    local tab, cursor = connection.stream, connection.cursor
    local source = server.sources[tab]
    if source.observe then
      source.seen_at = server.http.clock()
      source:observe(true)
    end
    local version, view = version_of(server, tab), source.view
    if cursor and cursor.version == version
      and cursor.revision == (view and view.revision or nil) then
      return nil
    end
    if cursor and now < cursor.at + FRAME and now >= cursor.at then
      server.is_late = true
      return nil
    end
    local key = cursor or tab
    local message = messages[key]
    if not message then
      message = { state_message(server, tab, cursor, version) }
      messages[key] = message
    end
    connection.cursor = message[2]
    return message[1]
  end)
end

-- Stops observing the machine of a program if no page has read for LINGER seconds.
local function rest(server, source)
  if source.observe and server.http.clock() > source.seen_at + LINGER then
    source:observe(false)
  end
end

--- Answer requests and send changes to the pages, waiting at most `timeout` seconds.
---@param timeout? number default 0
function Server:step(timeout)
  local wait = timeout or 0
  for _, source in ipairs(self.sources) do
    source:poll()
    wait = min(wait, source:wait())
  end
  send_changes(self)
  if self.is_late then wait = min(wait, FRAME) end
  self.http:step(wait)
  send_changes(self)
  for _, source in ipairs(self.sources) do rest(self, source) end
end

--- Serve until the program ends.
function Server:run()
  while true do self:step(huge) end
end

--- Close the port. A second call does nothing.
function Server:close()
  self.http:close()
  self.painter:close()
  for _, source in ipairs(self.sources) do
    if source.close then source:close() end
  end
end

-- Returns the options with defaults and the packages; if that fails, nil and a problem.
local function prepare(options)
  local settings, problem = opts.read(OPTIONS, options or {})
  if not settings then return nil, problem end
  local json, socket = opts.find_package("dkjson", "socket")
  if not json then return nil, socket end
  settings.json, settings.gettime = json, socket.gettime
  return settings
end

-- Opens the port and reads the page. Returns the server, or nil and a problem.
local function open_server(sources, settings)
  local page, token = files.find("rfsm/web/page", ".html"), files.random(16)
  if not page then return nil, "rfsm/web/page.html is not beside the modules" end
  if not token then return nil, "/dev/urandom cannot be read" end
  local server = setmetatable({
    sources = sources, json = settings.json, gettime = settings.gettime,
    painter = Painter.new(),
    token = token, id = files.random(4), name = settings.host, is_late = false,
  }, Server)
  -- A tenth of the page is indentation and comments.
  server.page = page:gsub("\n +", "\n"):gsub("\n//[^\n]*", ""):gsub("{{token}}", token)
  server.policy = CSP:format(token)
  local listen = require("rfsm.web.http").listen
  local listener, problem = listen(settings.host, settings.port, function(request)
    return handle_safely(server, request)
  end, settings.clock)
  if not listener then return nil, problem end
  server.http, server.host, server.port = listener, listener.host, listener.port
  local name = server.host:find(":", 1, true) and "[" .. server.host .. "]"
  server.url = ("http://%s:%d/"):format(name or server.host, server.port)
  return server
end

--- Options of `serve`, `open` and `attach`.
---@class rfsm.web.Options
---@field allow_send? boolean with `serve`: may pages send events? default false
---@field allow_why? boolean with `serve`: may pages ask why an event did nothing? The
-- answer calls guards. Default false
---@field from? string with `open`: begin with the machine in this file of a fleet
---@field machine? integer with `attach`: show only the machine with this number;
-- default: all machines of the port
---@field history? boolean with `serve`: observe the machine while no page is open, too?
-- default false
---@field host? string address to listen on, default 127.0.0.1
---@field port? integer default 8044; 0: any free port
---@field stub? boolean with `open`: replace missing modules and globals by stubs
---@field title? string|string[] title of the page, or a list with a title per machine
---@field clock? fun(): number returns seconds; default the clock of luasocket

--- Serve the page of a machine that your program drives.
--
-- @usage
--    local server = rfsm_web.serve(fsm, { port = 8044 })
--    while true do
--      rfsm.run(fsm)
--      server:step(0.1)
--    end
--
-- @raise when an option is wrong, a package is missing or the port cannot be opened
---@param fsm rfsm.Machine|rfsm.Machine[] one machine, or a list (one tab for each)
---@param options? rfsm.web.Options
---@return rfsm.web.Server server
function web.serve(fsm, options)
  local is_list = type(fsm) == "table" and rfsm.is_initialized_root(fsm[1])
  local machines, sources = is_list and fsm or { fsm }, {}
  local settings, problem = prepare(options)
  if not settings then error("rfsm.web.serve: " .. problem, 2) end
  for i, machine in ipairs(machines) do
    rfsm.check_machine(machine, "rfsm.web.serve")
    local title = settings.title
    if type(title) == "table" then title = title[i] end
    sources[i] = Served.new(machine, title or is_list and "machine " .. i or "machine",
      settings)
  end
  local server
  server, problem = open_server(sources, settings)
  if not server then error("rfsm.web.serve: " .. problem, 2) end
  return server
end

--- Make the machine of a chart, and serve a page that drives it.
---@param file string
---@param options? rfsm.web.Options
---@return rfsm.web.Server? server nil if there is a problem
---@return string? problem in one line
function web.open(file, options)
  local settings, problem = prepare(options)
  if not settings then return nil, problem end
  local session
  session, problem = require("rfsm.web.driven").open(file, settings.clock
    or settings.gettime, settings.stub, settings.from)
  if not session then return nil, problem end
  return open_server({ session }, settings)
end

--- Serve the page of machines in another program, which answers by `rfsm.proto`.
---@param host string
---@param port integer
---@param options? rfsm.web.Options
---@return rfsm.web.Server? server nil if there is a problem
---@return string? problem in one line
function web.attach(host, port, options)
  local settings, remotes, problem
  settings, problem = prepare(options)
  if not settings then return nil, problem end
  remotes, problem = require("rfsm.web.remote").open(host, port, settings.machine)
  if not remotes then return nil, problem end
  return open_server(remotes, settings)
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_web", web) end

return web
