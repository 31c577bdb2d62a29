--- The terminal of the simulator: catches Control-C, and reads and writes lines.
--
-- A reader is a function that takes a prompt and returns a line, typed or piped in; nil
-- at the end of the input; false if Control-C dropped the line. Without lua-readline a
-- line cannot be edited, and without luv a second Control-C ends the program.
--
-- @module rfsm.sim.terminal
-- @license BSD-3-Clause

local error, io, os = error, io, os
local pcall, print, rawget, require = pcall, print, rawget, require
local tostring = tostring
local concat = table.concat
local debug = rawget(_G, "debug") or {}
local sethook = debug.sethook
local jit = rawget(_G, "jit")

local terminal = {}

--- Flush stdout, then write a line to stderr.
function terminal.complain(text)
  io.stdout:flush()
  io.stderr:write(text, "\n")
end

-- Control-C, any number of times --------------------------------------------------
--
-- The interpreter alone survives only the first Control-C. So luv counts each one, and
-- a debug hook raises an error for it, also in a doo.

local PERIOD = 10000 -- VM instructions between two checks for Control-C
local uv -- the module luv; nil until interrupts are caught
local keys = nil -- tells of keys; made when a line is read
local count, seen = 0, 0 -- how many Control-Cs were typed, and how many were noticed
local is_busy = false -- true while C code calls Lua: the hook must not raise an error
local is_resumed = false -- true if the program goes on after Control-Z
local modes = false -- how the shell wants the terminal, while a line is read by keys

-- Stops the program for Control-Z. Shells such as dash do not set up the terminal
-- themselves, so it gets the modes in which the shell left it.
local function stop()
  if modes then os.execute("stty " .. modes .. " 2>/dev/null") end
  uv.kill(uv.os_getpid(), "sigstop")
end

-- Waits for a key or a signal; returns whether a key came.
local function wait()
  local has_key = false
  keys = keys or uv.new_poll(0)
  keys:start("r", function() has_key = true end)
  uv.run("once")
  keys:stop()
  return has_key
end

--- Has Control-C been typed since the last call of this function?
function terminal.is_interrupted()
  local was_busy = is_busy
  is_busy = true
  if uv and not uv.loop_mode() then uv.run("nowait") end -- a chart may run the loop
  is_busy = was_busy
  local is_new = count > seen
  seen = count
  return is_new
end

local function poll()
  if is_busy or not terminal.is_interrupted() then return end
  print() -- ends the line in which the terminal has shown ^C
  error("interrupted!", 2) -- the core knows an interrupt by this text
end

--- Have each Control-C raise an error in the code that runs then.
function terminal.catch_interrupts()
  local is_there, module = pcall(require, "luv")
  if uv or not (sethook and is_there) then return end
  uv = module
  uv.new_signal():start("sigint", function() count = count + 1 end)
  uv.new_signal():start("sigtstp", stop)
  uv.new_signal():start("sigcont", function() is_resumed = true end)
  sethook(poll, "", PERIOD)
  if jit then jit.off() end -- compiled code calls no hook
end

--- Set the debug hook again, because other code may have replaced it.
function terminal.settle()
  if uv then sethook(poll, "", PERIOD) end
end

--- Is Control-C caught?
function terminal.is_caught() return uv ~= nil end

--- Wrap a callback so that Control-C ends it also in a coroutine that has no hook.
function terminal.interruptible(callback)
  return function(...)
    sethook(poll, "", PERIOD)
    return callback(...)
  end
end

-- Lines -----------------------------------------------------------------------------

--- Is stdin (0) or stdout (1) a terminal?
function terminal.is_terminal(descriptor)
  local result = os.execute("test -t " .. descriptor)
  return result == true or result == 0
end

local shell_modes = nil -- as `stty` prints them

-- Returns the modes that the terminal has while the shell reads a line.
local function read_modes()
  if shell_modes then return shell_modes end
  local pipe = io.popen("stty -g 2>/dev/null")
  shell_modes = pipe:read("*l")
  pipe:close()
  return shell_modes
end

-- Reads a line key by key, so that Control-C is noticed at once. Meanwhile `is_busy` is
-- true, so that the debug hook does not interrupt readline by an error. After Control-C
-- the handler of this line is not removed, because lua-readline 3.2 would then write to
-- a closed stream. The handler of the next line replaces it.
local function read_keys(readline, prompt)
  local line, is_done = nil, false
  local function install()
    readline.handler_install(prompt, function(text)
      line, is_done, modes = text, true, false
      readline.handler_remove()
    end)
  end
  modes, is_resumed = read_modes(), false
  install()
  is_busy = true -- up to the end of `terminal.read`
  while not is_done do
    local has_key = wait()
    if terminal.is_interrupted() then -- a later key belongs to the next line
      print()
      return false
    end
    if is_resumed then -- what was typed before is lost
      os.execute("stty -icanon -echo 2>/dev/null") -- as `handler_install` does once
      is_resumed = false
      install()
    end
    if has_key then readline.read_char() end
  end
  return line
end

local HISTORY = (os.getenv("HOME") or ".") .. "/.rfsm_sim_history"

-- Adds a line to the history. Writes it at once, because the simulator may be killed.
local function keep_line(readline, line)
  readline.add_history(line)
  local file = io.open(HISTORY, "a")
  if not file then return end
  file:write(line, "\n")
  file:close()
end

-- Returns a reader with line editing, history and completion; nil without lua-readline.
local function readline_reader(complete)
  local ok, readline = pcall(require, "readline")
  if not ok then return nil end
  readline.set_options { histfile = HISTORY, auto_add = false }
  readline.set_complete_function(function(text, from, to)
    readline.set_completion_append_character("")
    local is_done, matches = pcall(complete, text:sub(from, to), text:sub(1, from - 1))
    return is_done and matches or {}
  end)
  return function(prompt)
    local line
    if uv and readline.handler_install then
      line = read_keys(readline, prompt)
    else
      line = readline.readline(prompt)
    end
    if line and line:find("%S") then keep_line(readline, line) end
    return line
  end
end

local function prompting_reader(prompt)
  io.write(prompt)
  io.flush()
  is_resumed = false
  local line = io.read()
  if line ~= nil then return line end
  if terminal.is_interrupted() then
    print()
    return false -- the signal has ended the read, not the input
  end
  if is_resumed then return prompting_reader(prompt) end
end

local function piped_reader() return io.read() end

--- Return the reader for stdin. At a terminal the Tab key offers the words that
-- `complete(word, before)` lists for the typed word and the text before it.
function terminal.new_reader(complete)
  if not terminal.is_terminal(0) then return piped_reader end
  return terminal.is_terminal(1) and readline_reader(complete) or prompting_reader
end

--- Read a line. Return the result of the reader, and whether Control-C was typed. If it
-- was, the caller drops the incomplete lines before this line.
function terminal.read(read, prompt)
  local ok, line = pcall(read, prompt)
  is_busy = false
  if ok then return line, terminal.is_interrupted() end
  if not tostring(line):find("interrupted!", 1, true) then error(line, 0) end
  return false, true
end

--- Return a line that names the missing packages and their use; nil if none is missing.
function terminal.advice()
  local packages, gains = {}, {}
  if not pcall(require, "readline") then
    packages[1], gains[1] = "lua-readline", "line editing and the Tab key"
  end
  if not uv then
    packages[#packages + 1] = "lua-luv"
    gains[#gains + 1] = "more than one Control-C"
  end
  if not packages[1] then return nil end
  return ("for %s (on Debian): apt-get install %s"):format(concat(gains, ", for "),
    concat(packages, " "))
end

return terminal
