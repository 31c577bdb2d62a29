--- Other programs, such as Graphviz, which read a file and print another.
--
-- @module rfsm.shared.programs
-- @license BSD-3-Clause

local files = require "rfsm.shared.files"

local os = rawget(_G, "os") -- a browser has none

local programs = {}

-- A shell that knows why a program ends: a signal is a status above 128.
local COMMAND = "{ %s; } >'%s' 2>'%s' </dev/null; rc=$?; [ $rc -le 128 ] || "
  .. "echo killed by signal $((rc - 128)) >'%s'; exit $rc"

--- Return a text as a word of the shell.
function programs.quoted(text) return "'" .. text:gsub("'", "'\\''") .. "'" end

local function succeeds(command)
  local status = os.execute(command)
  return status == true or status == 0
end

-- Returns the content of a temporary file, and removes it.
local function take(file)
  local text = files.read(file)
  os.remove(file)
  return text or ""
end

--- Have a program work on a text. `command` begins with the name of the program; "%s"
-- in it is the file with the text.
---@return boolean ok
---@return string result what the program prints
---@return string complaint what it prints to stderr, or the problem with the text
function programs.run(command, text)
  local input, output, log = os.tmpname(), os.tmpname(), os.tmpname()
  local ok, problem = files.write(input, text)
  if ok then
    ok = succeeds(COMMAND:format(command:format("'" .. input .. "'"), output, log, log))
  end
  local result, complaint = take(output), take(log)
  os.remove(input)
  return ok, result, problem or complaint
end

--- The same for a program that has to print a text. `hint` is the problem if it is
-- missing.
---@return string? result what the program prints
---@return string? problem in one line
function programs.filter(command, text, hint)
  local ok, result, complaint = programs.run(command, text)
  if ok and result ~= "" then return result end
  local name = command:match("^%S+")
  if not succeeds("command -v " .. name .. " >/dev/null 2>&1") then return nil, hint end
  return nil, name .. ": " .. (complaint:match("[^\n]+") or "no result")
end

return programs
