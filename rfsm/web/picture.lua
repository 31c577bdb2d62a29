--- Pictures that Graphviz draws while the server goes on.
--
-- @module rfsm.web.picture
-- @license BSD-3-Clause

local io, os, setmetatable = io, os, setmetatable

local FAILED = "failed"
local CPU_SECONDS = 20 -- then Graphviz is stopped

--- A picture in the making.
---@class rfsm.web.Picture
---@field is_pending boolean
local Picture = {}
Picture.__index = Picture

-- The shell moves the picture to where it is looked for once it is complete.
local COMMAND = "(ulimit -t %d; dot -Tsvg -o '%s' '%s' || echo " .. FAILED
  .. " >'%s'; mv '%s' '%s'; rm -f '%s') >/dev/null 2>&1 </dev/null &"

--- Begin a picture of a graph.
---@param graph string in Graphviz's language
---@return rfsm.web.Picture picture
function Picture.start(graph)
  local input, part, output = os.tmpname(), os.tmpname(), os.tmpname()
  local handle = io.open(input, "wb")
  if handle then
    handle:write(graph)
    handle:close()
    os.execute(COMMAND:format(CPU_SECONDS, part, input, part, part, output, input))
  end
  return setmetatable({ output = output, is_pending = handle ~= nil }, Picture)
end

--- Return the picture, once it is complete; nil before, and if Graphviz has none.
---@return string? svg
function Picture:take()
  local handle = self.is_pending and io.open(self.output, "rb")
  local text = handle and handle:read("*a") or ""
  if handle then handle:close() end
  if text == "" then return nil end
  self:drop()
  return text:find("<svg", 1, true) and text or nil
end

--- Forget it.
function Picture:drop()
  self.is_pending = false
  os.remove(self.output)
end

return Picture
