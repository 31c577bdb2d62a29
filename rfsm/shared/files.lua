--- Files: functions that read or write a whole file.
--
-- @module rfsm.shared.files
-- @license BSD-3-Clause

local io, os, package = rawget(_G, "io"), rawget(_G, "os"), rawget(_G, "package")
-- a browser has no `io`

local files = {}

--- Return the content of a file; nil and the problem in one line if it cannot be read.
function files.read(name)
  local handle, problem = io.open(name, "rb")
  if not handle then return nil, problem end
  local text, why = handle:read("*a") -- a directory can be opened, but not read
  handle:close()
  return text, why and name .. ": " .. why
end

--- Write a text to a file; return true, or false and the problem in one line.
function files.write(name, text)
  local handle, problem = io.open(name, "wb")
  if not handle then return false, problem end
  local is_written, why = handle:write(text)
  local is_closed, why_not = handle:close()
  if is_written and is_closed then return true end
  return false, name .. ": " .. (why or why_not)
end

-- Gives a file another name, also on a system that refuses to replace a file.
local function rename(old, new)
  if os.rename(old, new) then return true end
  os.remove(new)
  return os.rename(old, new)
end

--- Put a text into a file, in which at any time there is the whole old text, or the
-- whole new one. Return true, or false and the problem in one line.
function files.replace(name, text)
  local part = name .. ".part"
  local ok, problem = files.write(part, text)
  if ok then ok, problem = rename(part, name) end
  if ok then return true end
  os.remove(part)
  return false, problem
end

--- Search `package.path` for a file that is not bytecode; return its text and name, or
-- nil. `name` has slashes and no ending; `ending` is ".lua" by default.
function files.find(name, ending)
  for template in package.path:gmatch("[^;]+") do
    local file = template:gsub("%?", name):gsub("%.lua$", ending or ".lua")
    local text = files.read(file)
    if text and text:byte() ~= 27 then return text, file end
  end
end

--- Return random bytes as hexadecimal digits; nil if there is no /dev/urandom.
function files.random(count)
  local handle = io.open("/dev/urandom", "rb")
  local bytes = handle and handle:read(count)
  if handle then handle:close() end
  return bytes and bytes:gsub(".", function(c) return ("%02x"):format(c:byte()) end)
end

return files
