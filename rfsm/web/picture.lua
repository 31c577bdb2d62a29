--- Pictures that Graphviz draws while the server goes on.
--
-- @module rfsm.web.picture
-- @license BSD-3-Clause

local dot = require "rfsm.dot"
local files = require "rfsm.shared.files"

local coroutine, io, os, setmetatable = coroutine, io, os, setmetatable

local CPU_SECONDS = 60 -- then a run of Graphviz is stopped

--- A picture that Graphviz draws.
---@class rfsm.web.Picture
---@field is_pending boolean
---@field work thread yields while Graphviz runs, and returns the picture
---@field pid string? of Graphviz
---@field input string name of a file, as is `output`
local Picture = {}
Picture.__index = Picture

-- The output has its name once it is complete, also if Graphviz has failed. Sockets of
-- this program are closed first: a port would stay in use while Graphviz runs.
local COMMAND = "exec 3>&- 4>&- 5>&- 6>&- 7>&- 8>&- 9>&-; "
  .. "command -v dot >/dev/null && { ulimit -t %d; { "
  .. "nice dot -T%s '%s' >'%s.part' 2>/dev/null </dev/null & "
  .. "trap \"kill $! 2>/dev/null; rm -f '%s.part'; exit\" TERM; wait; "
  .. "mv '%s.part' '%s'; } >/dev/null & echo $!; }"

local function begin(picture, graph, format)
  local output = picture.output
  if not files.write(picture.input, graph) then return end
  os.remove(output)
  local pipe = io.popen(COMMAND:format(CPU_SECONDS, format, picture.input, output,
    output, output, output))
  picture.pid = pipe:read("*l")
  pipe:close()
end

--- Have Graphviz run, and yield until it is done; return its output, nil if it is
-- missing or fails. The playground has its own.
function Picture:run(graph, format)
  begin(self, graph, format)
  while self.pid do
    local text = files.read(self.output)
    if text then return text ~= "" and text or nil end
    coroutine.yield()
  end
end

local function draw(picture, graph, description)
  if description then
    graph = dot.layout(description, nil, function(graphs)
      return picture:run(graphs, "dot"), "no Graphviz"
    end) or graph
  end
  return picture:run(graph, "svg")
end

--- Begin a picture of a graph in Graphviz's language, or of a description, which is
-- laid out level by level, in its place; without Graphviz it never comes.
function Picture.start(graph, description)
  local picture = setmetatable({ input = os.tmpname(), output = os.tmpname(),
    work = coroutine.create(draw), is_pending = true }, Picture)
  picture.svg = picture:advance(picture, graph, description)
  return picture
end

-- Goes on with the work. Returns the picture if it is complete.
function Picture:advance(...)
  local ok, svg = coroutine.resume(self.work, ...)
  if ok and coroutine.status(self.work) == "suspended" then return nil end
  self.pid = nil
  self:drop()
  return ok and svg or nil
end

--- Return the picture, once it is complete; nil before.
function Picture:take()
  return self.is_pending and self:advance() or nil
end

--- Stop Graphviz, and remove the files.
function Picture:drop()
  if self.pid then os.execute("kill " .. self.pid .. " 2>/dev/null") end
  self.is_pending, self.pid = false, nil
  os.remove(self.input)
  os.remove(self.output)
end

return Picture
