-- Renews the table of figures in CONTRIBUTING.md:  LUA tools/figures.lua [WORD [FILE]]
--
-- A row has a command, and the last line that it printed. Each command that contains
-- WORD is run again; all of them, without it, take hours.

package.path = "./?.lua;" .. package.path
local helper = require "spec.helper"

local word, file = arg[1] or "", arg[2] or "CONTRIBUTING.md"
local count = 0

-- Returns the row of a command, run again.
local function renewed(command)
  if not command:find(word, 1, true) then return nil end
  count = count + 1
  io.stderr:write(command, "\n")
  local lines = helper.lines_of(command .. " 2>&1")
  return ("| `%s` | %s |"):format(command, lines[#lines] or "nothing")
end

local text = helper.content(file):gsub("| `(make [^`\n]+)` | [^\n]- |", renewed)
if count == 0 then
  io.stderr:write("figures: no command in ", file, " contains '", word, "'\n")
  os.exit(2)
end
helper.write(file, text)
