-- Runs the claims about random charts:  LUA spec/support/torture.lua N SEED [CLAIM...]
--
-- A file of spec/support/claims/ returns `name` and `run(n, seed)`, which returns the
-- number of cases and, if the claim does not hold, a text that says what is wrong. A
-- line is printed for each claim: its name, cases, seconds, and "ok" or that text. Each
-- runs in a process of its own, so that no claim sees what another has loaded. With
-- LIMIT in the environment, a claim is stopped after so many seconds.

package.path = "./?.lua;" .. package.path

local FOLDER = "spec/support/claims/"

-- LuaJIT 2.1.0-beta3 may compile `next` so that the process crashes. On LuaJIT the code
-- of claims has a `next`, and a `pairs`, that is not compiled.
local order = require "rfsm.shared.order"
local own = setmetatable({ next = order.each {}, pairs = order.each },
  { __index = _G, __newindex = _G })

local function load_claim(file)
  local chunk = assert(loadfile(file))
  return own.next == next and chunk or rawget(_G, "setfenv")(chunk, own)
end

local searchers = rawget(package, "loaders") or rawget(package, "searchers")
table.insert(searchers, 2, function(name)
  return name:find("^spec%.") and load_claim(name:gsub("%.", "/") .. ".lua") or nil
end)

local function fail(message)
  io.stderr:write("torture: ", message, "\n")
  os.exit(2)
end

local function lines_of(command)
  local pipe, lines = assert(io.popen(command)), {}
  for line in pipe:lines() do lines[#lines + 1] = line end
  pipe:close()
  return lines
end

-- Runs a claim and prints its line; has it held?
local function hold(file, n, seed)
  local began, name = os.time(), file
  local has_ended, cases, problem = pcall(function()
    local claim = load_claim(file)()
    if not claim.run then error("'run' expected in what the file returns", 0) end
    name = claim.name
    return claim.run(n, seed)
  end)
  if not has_ended then cases, problem = 0, cases end
  print(("%-24s %9d cases %6d s  %s"):format(name, cases, os.time() - began,
    problem and tostring(problem) or "ok"))
  return not problem
end

-- The files of the claims that are named from argument `first` on; all if none is.
local function files_of(first)
  local files = {}
  for i = first, #arg do
    local file = FOLDER .. arg[i] .. ".lua"
    if not io.open(file) then fail(("there is no claim '%s'"):format(arg[i])) end
    files[#files + 1] = file
  end
  return files[1] and files or lines_of("ls " .. FOLDER .. "*.lua")
end

local n, seed = tonumber(arg[1]), tonumber(arg[2])
if not (n and seed) then fail("N, SEED: numbers expected") end
if arg[3] == "--file" then os.exit(hold(arg[4], n, seed) and 0 or 1) end

-- Runs a claim in a process of its own, and prints its lines; has it held?
local function hold_alone(file)
  local limit = os.getenv "LIMIT"
  local lines = lines_of(("%s'%s' '%s' %d %d --file '%s' 2>&1; echo $?"):format(
    limit and "timeout -k 5 " .. limit .. " " or "", arg[-1], arg[0], n, seed, file))
  local status = table.remove(lines)
  if limit and (status == "124" or status == "137") then
    lines[#lines + 1] = ("%s did not end within %s s"):format(file, limit)
  end
  print(table.concat(lines, "\n"))
  io.stdout:flush()
  return status == "0"
end

local files, failed = files_of(3), 0
for _, file in ipairs(files) do
  if not hold_alone(file) then failed = failed + 1 end
end
print(("%d claims hold, %d do not"):format(#files - failed, failed))
os.exit(failed == 0 and 0 or 1)
