--- A time limit for the loading of files that other people wrote.
--
-- @module rfsm.shared.limit
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, ipairs, pcall, rawget = error, ipairs, pcall, rawget
local debug, jit = rawget(_G, "debug"), rawget(_G, "jit")

local limit = { SECONDS = 5 } -- the longest time that the loading of a chart may take

-- Returns "file:line: " of the innermost function on the stack that has a line. If
-- `is_known` is given, it also has to accept the source of the function.
local function location(is_known)
  local level, info = 3, debug.getinfo(3, "Sl")
  while info and (info.currentline < 1 or is_known and not is_known(info.source)) do
    level = level + 1
    info = debug.getinfo(level, "Sl")
  end
  return info and ("%s:%d: "):format(info.short_src, info.currentline) or ""
end

-- Is the hook called for `limit.load` itself, or for a function that it calls? An error
-- would leave the hook set, because nothing catches it there.
local function is_outside()
  for level = 3, 4 do
    local info = debug.getinfo(level, "f")
    if info and info.func == limit.load then return true end
  end
  return false
end

-- Returns a debug hook that raises an error if the loading takes too long. It reads the
-- first clock at each call of a function, since code that sleeps calls a function. It
-- reads all clocks at each 10,000th instruction.
local function new_hook(state, clocks, is_known)
  local ends, seconds = {}, limit.SECONDS
  for i, clock in ipairs(clocks) do ends[i] = clock() + seconds end
  return function(event)
    for i = 1, event == "count" and #clocks or 1 do
      if clocks[i]() > ends[i] and not is_outside() then
        state.is_late = true
        error(("%sloading takes more than %s s, is there a loop without end?"):format(
          location(is_known), rfsm.text_of(seconds)), 0)
      end
    end
  end
end

--- Call f(file), for at most `limit.SECONDS` on each of the clocks. Return the results
-- of pcall, and whether the call took too long. If it did, the error names the
-- innermost line whose source `is_known(source)` accepts. By default it accepts all.
--
-- LuaJIT does not call the hook in compiled code, so it compiles nothing in the call.
function limit.load(f, file, clocks, is_known)
  if not (debug and debug.sethook) then return pcall(f, file) end
  local state, is_compiling = { is_late = false }, jit and jit.status()
  local hook, mask, count = debug.gethook()
  if is_compiling then jit.off() end
  debug.sethook(new_hook(state, clocks, is_known), "c", 10000)
  local ok, result = pcall(f, file)
  debug.sethook(hook, mask, count)
  if is_compiling then jit.on() end
  return ok, result, state.is_late
end

return limit
