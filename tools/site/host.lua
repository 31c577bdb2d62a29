-- The server of `rfsm web` in a page: requests and messages are texts that worker.js
-- passes, Graphviz is that of viz.js, the time is what the page says. All else is the
-- library as it is.
--
-- Returns the functions that worker.js calls. The chart sees nothing of the browser.

local now = 0 -- seconds
local outbox = {} -- messages for the page

-- What a chart must not have: it could switch off the limit of its time, or end Lua.
for _, name in ipairs { "sethook", "gethook", "debug" } do rawset(debug, name, nil) end
rawset(os, "exit", function() error("os.exit is called", 2) end)

package.path = "/lib/?.lua;/lib/compat/?.lua;/?.lua"
package.cpath = ""
package.preload.socket = function() return { gettime = function() return now end } end

-- A server without a port, and with one page: as rfsm.web.http.
package.preload["rfsm.web.http"] = function()
  local Server = {}
  Server.__index = Server

  function Server:step(timeout) self.wait = timeout end

  function Server:feed(next_message)
    local text = self.connections[1] and next_message(self.connections[1])
    if text then outbox[#outbox + 1] = text:match("data: (.*)\n\n$") end
  end

  return { listen = function(_, _, handle)
    return setmetatable({ host = "localhost", port = 0, handle = handle, wait = 0,
      clock = function() return now end, connections = {} }, Server)
  end }
end

local chart = require "rfsm.shared.chart"
local review = require "rfsm.cli.review"
local Painter = require "rfsm.web.picture"
local web = require "rfsm.web"
require("rfsm_timeevent") -- so that their events are known, as to `rfsm check`
require("rfsm.await")

local queue = {} -- what is to be drawn: { text, format, what goes on then }

-- Draws in place of a process of its own.
function Painter:start(job)
  job.input = "/no file"
  local work
  work = coroutine.wrap(function()
    job.svg = Painter.draw(job.request, self.last, function(text, format)
      queue[#queue + 1] = { text, format, work }
      return coroutine.yield()
    end) or false
    self.last = job.svg or nil
  end)
  work()
end

local host, file, server = {}, nil, nil

function host.open(name, text)
  file = name
  host.write(text)
  server = assert(web.open(name, { port = 0, stub = true }))
end

function host.write(text)
  local handle = assert(io.open(file, "wb"))
  handle:write(text)
  handle:close()
  if server then server.sources[1].look_at = 0 end -- at once
end

-- Does what is due. Returns the seconds until more is.
function host.step(time)
  now = time
  server:step(math.huge)
  return server.http.wait
end

-- Answers a request of the page: { status, text }.
function host.ask(path, query, body)
  local reply = server.http.handle {
    method = body and "POST" or "GET", path = "/" .. path, query = query,
    body = body, headers = { host = "localhost", ["x-rfsm-token"] = server.token },
  }
  return { reply.status or 200, reply.body or "" }
end

-- Follows the machine from now on.
function host.follow()
  server.http.connections[1] = { stream = 1, pending = "" }
end

-- Returns the next message to the page.
function host.message() return table.remove(outbox, 1) end

-- Returns what Graphviz has to draw, as { text, format }; nil if there is nothing.
function host.graph()
  return queue[1] and { queue[1][1], queue[1][2] }
end

-- Goes on with the picture that was drawn.
function host.draw(text) table.remove(queue, 1)[3](text ~= "" and text or nil) end

-- Returns what `rfsm check --static` reports.
function host.check()
  local real = print
  rawset(_G, "print", function() end)
  local ok, lines = pcall(function()
    local required, model, warnings, world =
      review.noting_extensions(chart.load, file)
    if not model then -- of a robot that is not here
      required, model, warnings, world =
        review.noting_extensions(chart.load, file, true)
    end
    if not model then return { warnings } end
    local found = review.of(file, model, warnings, {},
      { static = true, required = required })
    for _, line in ipairs(chart.lines_of(file, world)) do found[#found + 1] = line end
    return found
  end)
  rawset(_G, "print", real)
  return table.concat(ok and lines or { chart.reason(file, lines) }, "\n")
end

return host
