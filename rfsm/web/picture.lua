--- Pictures for pages: another process draws them, and the server does not wait.
--
-- The process is started when a page asks for the first picture, and ends with the
-- server. It reads names of files from its stdin. Each file has a request as JSON. The
-- process writes the picture to a file beside that file.
--
-- @module rfsm.web.picture
-- @license BSD-3-Clause

local dot = require "rfsm.dot"
local files = require "rfsm.shared.files"
local quoted = require("rfsm.shared.programs").quoted

local io, ipairs, os, package = io, ipairs, os, package
local pcall, rawget, require, setmetatable = pcall, rawget, require, setmetatable
local remove, type = table.remove, type

--- The painter of a server: has another process draw pictures.
---@class rfsm.web.Painter
---@field jobs rfsm.web.Job[] the last pictures that were asked for, oldest first
---@field pipe file*|false leads to the stdin of the process; false if no process runs
local Painter = {}
Painter.__index = Painter

--- A picture that a page has asked for.
---@class rfsm.web.Job
---@field key string
---@field request { graph: table, folded: string[], machine: integer } the graph as
-- `marsh.jsontab` returns it
---@field input string name of the file with the request
---@field svg string|false|nil the picture; false if it failed, nil while it is drawn

-- The process -----------------------------------------------------------------

local CPU_SECONDS = 60 -- limit for each run of Graphviz, and for the process itself

local INTERPRETERS = "lua5.4 lua5.3 luajit lua lua5.2 lua5.1"

-- Returns the name of the Lua interpreter that runs this program; nil if another
-- program runs it.
local function own_interpreter()
  local arguments = rawget(_G, "arg")
  local i = 0
  while type(arguments) == "table" and arguments[i - 1] do i = i - 1 end
  local name = type(arguments) == "table" and arguments[i] or ""
  return name:find("^[%w/._-]*$") and name:find("lua[^/]*$") and name or nil
end

-- Starts the process in the background, so that closing the pipe does not wait for it.
-- The shell closes inherited file descriptors up to 9, the process closes the others.
local function start()
  local own = own_interpreter()
  local code = ("package.path = %q %s require('rfsm.web.picture').serve()"):format(
    package.path, own and ("package.cpath = %q"):format(package.cpath) or "")
  local command = ("for l in %s; do command -v $l >/dev/null && break; done; "
    .. "exec 3<&0 4>&- 5>&- 6>&- 7>&- 8>&- 9>&-; ulimit -t %d; "
    .. "nice $l -e %s <&3 3<&- >/dev/null 2>&1 &"):format(own or INTERPRETERS,
    CPU_SECONDS, quoted(code:gsub("\\\n", "\\n")))
  -- Not `pcall(io.popen, ..)`: a caller that is not known is taken for a chart, and a
  -- chart that is loaded with stubs runs no program.
  local pipe
  pcall(function() pipe = io.popen(command, "w") end)
  return pipe or false
end

-- Closes the file descriptors that were inherited, but not stdin, stdout and stderr.
local function close_inherited()
  local ok, socket = pcall(require, "socket")
  for number = 3, ok and 1023 or 0 do
    local other = socket.tcp()
    other:setfd(number)
    other:close()
  end
end

--- Draw a request; return the SVG, or nil if Graphviz is missing or fails. `like` is
-- the former picture of the machine, whose order of nodes is kept. `run(text, format)`,
-- if given, replaces Graphviz.
function Painter.draw(request, like, run)
  run = run or dot.render
  local options = { folded = request.folded, like = like }
  local graph = dot.layout(request.graph, options, function(graphs)
    return run(graphs, "dot"), "no Graphviz"
  end)
  return run(graph or dot.encode(request.graph, options), "svg")
end

--- Read the names of files with requests from stdin, and draw each, until stdin ends.
function Painter.serve()
  close_inherited()
  local last = {} -- the last picture of each machine, by number of the machine
  for name in io.lines() do
    local request = files.read(name)
    request = request and require("dkjson").decode(request)
    local ok, svg = pcall(Painter.draw, request, last[request.machine])
    last[request.machine] = ok and svg or nil
    files.write(name .. ".part", ok and svg or "")
    local is_wanted = files.read(name) ~= nil
    os.rename(name .. ".part", name .. ".svg")
    if not is_wanted then os.remove(name .. ".svg") end
  end
end

-- The server ------------------------------------------------------------------

--- Make a painter.
function Painter.new() return setmetatable({ jobs = {}, pipe = false }, Painter) end

-- Sends a job to the process, which is started if it does not run.
function Painter:start(job)
  job.input = os.tmpname()
  local text = require("dkjson").encode(job.request)
  if not files.write(job.input, text) then job.svg = false end
  for _ = 1, 2 do
    self.pipe = self.pipe or start()
    local is_sent = self.pipe and self.pipe:write(job.input, "\n") and self.pipe:flush()
    if is_sent then return end
    self.pipe = false
  end
  job.svg = false
end

local function drop(job)
  os.remove(job.input)
  os.remove(job.input .. ".svg")
end

-- Reads the picture of a job if the process has written it.
local function look_at(job)
  local svg = files.read(job.input .. ".svg")
  if not svg then return end
  job.svg = svg ~= "" and svg
  drop(job)
end

local MOST = 8 -- greatest number of pictures that are kept

--- Return the picture with a key; false if it failed, nil while it is drawn. If the key
-- is new, `request()` is called, and the process begins to draw the returned request.
---@param key string
---@param request fun(): table
---@return string|false|nil svg
function Painter:ask(key, request)
  for _, job in ipairs(self.jobs) do
    if job.key == key then
      if job.svg == nil then look_at(job) end
      return job.svg
    end
  end
  local job = { key = key, request = request() }
  self.jobs[#self.jobs + 1] = job
  if #self.jobs > MOST then drop(remove(self.jobs, 1)) end
  self:start(job)
  return job.svg
end

--- End the process, and remove the files of all jobs.
function Painter:close()
  for _, job in ipairs(self.jobs) do drop(job) end
  if self.pipe then self.pipe:close() end
  self.jobs, self.pipe = {}, false
end

return Painter
