-- Errors that no callback raised, as those of Control-C or of a host's limit of time,
-- and what they leave: each callback is called at most once, and in order.

local debug, pcall = debug, pcall -- a spec may hide the library from the engine

local interrupts = {}

--- What is raised: the text of the interpreters, a host's text, any other value.
interrupts.VALUES = { "interrupted!", "time is up", {} }

--- Is a failure one of these values?
function interrupts.is_known(failure)
  for _, value in ipairs(interrupts.VALUES) do
    if rawequal(failure, value) then return true end
  end
  return false
end

-- Calls f(...); not in a tail call, so that it is found on the stack.
local function drive(f, ...)
  f(...)
  debug.sethook()
end

local ENGINE = { "rfsm%.lua$", "rfsm/fast%.lua$", "rfsm/always%.lua$",
  "^rfsm text$" }

local function is_of_engine(source)
  for _, pattern in ipairs(ENGINE) do
    if source:find(pattern) then return true end
  end
  return false
end

-- For a hook: does something run that `drive` has called? `is_right` is asked about the
-- sources of all functions in between, first that of the running one.
local function is_inside(is_right)
  local level, info = 3, debug.getinfo(3, "fS")
  if info.func == drive then return false end
  while info and info.func ~= drive do
    if not is_right(info.short_src, level > 3) then return false end
    level = level + 1
    info = debug.getinfo(level, "fS")
  end
  return info ~= nil
end

-- Does the engine run, and no function of a spec that it has called?
local function is_engine(source, is_caller)
  if is_caller then return not source:find("spec/", 1, true) end
  return is_of_engine(source)
end

--- Calls f(...) and raises `value` at its VM instruction number `at`, if
--- is_right(source, is_caller) is true of the functions that are under way. Returns
--- whether there is such an instruction, whether the value was raised, and what pcall
--- returns.
function interrupts.raise_where(is_right, at, value, f, ...)
  local is_reached, is_raised = false, false
  local function hook()
    debug.sethook()
    is_reached, is_raised = true, is_inside(is_right)
    if is_raised then error(value, 0) end
  end
  debug.sethook(hook, "", at)
  local ok, failure = pcall(drive, f, ...)
  debug.sethook()
  return is_reached, is_raised, ok, failure
end

local raise = interrupts.raise_where

--- The same, unless a callback or an extension runs.
function interrupts.raise(...) return raise(is_engine, ...) end

local function always() return true end

--- The same, also in callbacks.
function interrupts.raise_anywhere(...) return raise(always, ...) end

local function is_of_timers(source, is_caller)
  return is_caller or source:find("timeevent%.lua$") or source:find("clock%.lua$")
end

--- The same, in timers and clocks alone.
function interrupts.raise_in_timers(...) return raise(is_of_timers, ...) end

local function belongs_to_last(line) return line ~= nil and line:find("^ ") ~= nil end

--- Returns the number of the line that is missing in `got`, nil if it is as expected;
--- and what is wrong: more is missing, or something was called twice or out of order. A
--- line that begins with a space belongs to the one before.
function interrupts.missing(expected, got)
  local at, count = 1, 1
  while expected[at] ~= nil and expected[at] == got[at] do at = at + 1 end
  if expected[at] == nil and got[at] == nil then return nil end
  while belongs_to_last(expected[at + count]) do count = count + 1 end
  for i = at, math.max(#expected - count, #got) do
    if got[i] ~= expected[i + count] then
      return at, ("expected\n%s\ngot\n%s"):format(table.concat(expected, "\n"),
        table.concat(got, "\n"))
    end
  end
  return at
end

--- Runs f(...) on the interpreter: code that LuaJIT has compiled calls no hook.
function interrupts.without_jit(f, ...)
  local jit = rawget(_G, "jit")
  if not jit then return f(...) end
  jit.off()
  jit.flush()
  local ok, result, more = pcall(f, ...)
  jit.on()
  if not ok then error(result, 0) end
  return result, more
end

return interrupts
