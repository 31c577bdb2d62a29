--- A bound for what runs code of others: it comes to an end, or is ended.
--
-- @module rfsm.shared.limit
-- @license BSD-3-Clause

local error, ipairs, pcall, rawget = error, ipairs, pcall, rawget
local debug, jit = rawget(_G, "debug"), rawget(_G, "jit")

local limit = { SECONDS = 5 } -- for loading a chart

-- Returns "file:line: " of the innermost function on the stack whose source is known.
local function location(is_known)
  local level, info = 3, debug.getinfo(3, "Sl")
  while info and (info.currentline < 1 or is_known and not is_known(info.source)) do
    level = level + 1
    info = debug.getinfo(level, "Sl")
  end
  return info and ("%s:%d: "):format(info.short_src, info.currentline) or ""
end

-- Returns the hook that ends a call. Code that waits for something calls a function to
-- do so: each call looks at the first clock, each 10,000th instruction at all of them.
local function new_hook(state, clocks, is_known)
  local ends, seconds = {}, limit.SECONDS
  for i, clock in ipairs(clocks) do ends[i] = clock() + seconds end
  return function(event)
    for i = 1, event == "count" and #clocks or 1 do
      if state.is_on and clocks[i]() > ends[i] then
        state.is_late = true
        error(("%sloading takes more than %g s, is there a loop without end?"):format(
          location(is_known), seconds), 0)
      end
    end
  end
end

--- Load something by f(file), for some seconds by any of the clocks at most. Return
-- what pcall does, and if that was too long. An error names the innermost code that
-- `is_known(source)` accepts, any if that is not given.
--
-- LuaJIT does not call the hook in compiled code, so nothing is compiled meanwhile.
function limit.load(f, file, clocks, is_known)
  if not (debug and debug.sethook) then return pcall(f, file) end
  local state, is_compiling = { is_on = true, is_late = false }, jit and jit.status()
  local hook, mask, count = debug.gethook()
  if is_compiling then jit.off() end
  debug.sethook(new_hook(state, clocks, is_known), "c", 10000)
  local ok, result = pcall(f, file)
  state.is_on = false -- from here on the hook does nothing
  debug.sethook(hook, mask, count)
  if is_compiling then jit.on() end
  return ok, result, state.is_late
end

return limit
