-- Runs the sessions of the simulator in a document:  LUA tools/transcript.lua FILE
--
-- A session is a block that begins with "$ rfsm sim CHART". The lines behind "> " are
-- typed, and what the simulator prints for them as at a terminal is put in place of the
-- others. The document with all its sessions is printed to stdout.

local files = require "rfsm.shared.files"

-- The lines to type: each group of them is printed first, as a terminal echoes it.
local function input_of(block)
  local lines, group = { "if follow then follow(true) end" }, {} -- not of a system
  local function close()
    for _, line in ipairs(group) do lines[#lines + 1] = ("print(%q)"):format(line) end
    for _, line in ipairs(group) do lines[#lines + 1] = line:gsub("^>+ ?", "") end
    group = {}
  end
  for line in block:gmatch("[^\n]+") do
    if not line:find("^>>") then close() end
    if line:find("^>+ ?") then group[#group + 1] = line end
  end
  close()
  return table.concat(lines, "\n") .. "\n"
end

local function run(arguments, block)
  local name = os.tmpname()
  assert(files.write(name, input_of(block)))
  local pipe = assert(io.popen(("TERM=dumb LUA='%s' '%s/rfsm' sim %s <%s 2>&1"):format(
    os.getenv("LUA") or arg[-1], arg[0]:match("^(.*)/"), arguments, name)))
  local output = pipe:read("*a")
  pipe:close()
  os.remove(name)
  return output
end

local function again(arguments, block)
  return ("```\n$ rfsm sim %s\n%s```\n"):format(arguments, run(arguments, block))
end

local document = assert(files.read(arg[1]))
io.write((document:gsub("```\n%$ rfsm sim ([^\n]*)\n(.-)```\n", again)))
