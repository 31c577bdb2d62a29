--- Pictures that Graphviz draws while the server goes on.
--
-- @module rfsm.web.picture
-- @license BSD-3-Clause

local io, os, setmetatable = io, os, setmetatable

local CPU_SECONDS = 60 -- then Graphviz is stopped

--- A picture in the making.
---@class rfsm.web.Picture
---@field is_pending boolean
---@field pid string? of Graphviz
---@field input string name of a file, as is `output`
local Picture = {}
Picture.__index = Picture

local COMMAND = "command -v dot >/dev/null && { ulimit -t %d; "
  .. "nice dot -Tsvg -o '%s' '%s' >/dev/null 2>&1 </dev/null & echo $!; }"

--- Begin a picture of a graph; without Graphviz none will come.
---@param graph string in Graphviz's language
---@return rfsm.web.Picture picture
function Picture.start(graph)
  local picture = setmetatable({ input = os.tmpname(), output = os.tmpname() }, Picture)
  local handle = io.open(picture.input, "wb")
  if handle then
    handle:write(graph)
    handle:close()
    local pipe = io.popen(COMMAND:format(CPU_SECONDS, picture.output, picture.input))
    picture.pid = pipe:read("*l")
    pipe:close()
  end
  picture.is_pending = picture.pid ~= nil
  if not picture.is_pending then picture:drop() end
  return picture
end

-- Returns a complete picture in a file; nil while Graphviz writes it.
local function read_picture(file)
  local handle = io.open(file, "rb")
  if not handle then return nil end
  local is_complete = handle:seek("end", -8) and handle:read("*a"):find("</svg>")
  local text = is_complete and handle:seek("set") and handle:read("*a")
  handle:close()
  return text or nil
end

--- Return the picture, once it is complete; nil before.
---@return string? svg
function Picture:take()
  local text = self.is_pending and read_picture(self.output)
  if text then
    self.is_pending = false
    self:drop()
  end
  return text or nil
end

--- Stop Graphviz, and remove the files.
function Picture:drop()
  if self.is_pending then os.execute("kill " .. self.pid .. " 2>/dev/null") end
  self.is_pending = false
  os.remove(self.input)
  os.remove(self.output)
end

return Picture
