-- What the programs of bench/ share: the name of the interpreter, time, rounds in turn.

local measure = {}

local jit = rawget(_G, "jit")

--- The interpreter that runs, as "Lua 5.4" or "LuaJIT 2.1.0".
function measure.engine() return jit and jit.version or _VERSION end

--- Stops the program with one line about what is wrong.
function measure.fail(text)
  io.stderr:write(arg[0], ": ", text, "\n")
  os.exit(1)
end

--- Forgets all of this library that is loaded, so that it can be loaded apart.
function measure.forget_modules()
  for name in pairs(package.loaded) do -- any order: each stands alone
    if name:find("^rfsm") then package.loaded[name] = nil end
  end
end

--- Seconds of processor time that f(n) takes. It is called until the clock has moved,
-- which on some machines, when they are busy, is after milliseconds.
function measure.time(f, n)
  local start, calls, taken = os.clock(), 0, 0
  while taken <= 0 do
    f(n)
    calls, taken = calls + 1, os.clock() - start
  end
  return taken / calls
end

--- The n for which f(n) takes about `seconds`.
function measure.calibrate(f, seconds)
  local n = 1
  while true do
    local taken = measure.time(f, n)
    if taken > seconds / 4 then return math.ceil(n * seconds / taken) end
    n = n * 4
  end
end

--- A function of n that sends the event and steps, n times.
function measure.stepping(rfsm, fsm, event)
  local send_events, step = rfsm.send_events, rfsm.step
  return function(n)
    for _ = 1, n do
      send_events(fsm, event)
      step(fsm)
    end
  end
end

-- Forgets compiled code: traces made for one subject are no measure for the next.
local function forget_traces(subject, n)
  if not jit then return end
  jit.flush()
  subject(math.ceil(n / 10))
end

--- Microseconds per call, a figure for each of `subjects`, functions of n: the best of
-- `rounds`, in turn, so that a busy machine hits all alike.
function measure.best_in_turn(subjects, rounds, seconds)
  local counts, best = {}, {}
  for i = 1, #subjects do
    counts[i], best[i] = measure.calibrate(subjects[i], seconds), math.huge
  end
  for _ = 1, rounds do
    for i = 1, #subjects do
      collectgarbage()
      forget_traces(subjects[i], counts[i])
      local microseconds = measure.time(subjects[i], counts[i]) / counts[i] * 1e6
      best[i] = math.min(best[i], microseconds)
    end
  end
  return best
end

--- Two functions of n, measured in turn: returns two sorted lists, a figure for each of
--- `rounds`: how many times the rate of `limit` that of `subject` is, and its rate.
function measure.shares(subject, limit, rounds, seconds)
  local time, calibrate = measure.time, measure.calibrate
  local subject_n, limit_n = calibrate(subject, seconds), calibrate(limit, seconds)
  local shares, rates = {}, {}
  for i = 1, rounds do
    collectgarbage()
    local limit_rate = limit_n / time(limit, limit_n)
    collectgarbage()
    local rate = subject_n / time(subject, subject_n)
    shares[i], rates[i] = rate / limit_rate, rate
  end
  table.sort(shares)
  table.sort(rates)
  return shares, rates
end

--- A number from the environment, or `default`; anything else stops the program.
function measure.setting(name, default)
  local text = os.getenv(name)
  if not text or text == "" then return default end
  local number = tonumber(text)
  if number and number > 0 then return number end
  measure.fail(("%s: number greater than 0 expected, got '%s'"):format(name, text))
end

--- A whole number from the environment, or `default`.
function measure.count(name, default)
  local number = measure.setting(name, default)
  if number % 1 == 0 then return number end
  measure.fail(("%s: whole number expected, got '%s'"):format(name, os.getenv(name)))
end

--- Those of `list` (each has a name) that are named; all when none is.
function measure.select(list, names)
  if #names == 0 then return list end
  local by_name, all, selected = {}, {}, {}
  for i, item in ipairs(list) do by_name[item.name], all[i] = item, item.name end
  for i, name in ipairs(names) do
    selected[i] = by_name[name] or measure.fail(("nothing is named '%s' here (there is "
      .. "'%s')"):format(name, table.concat(all, "', '")))
  end
  return selected
end

--- Bytes that `n` calls' worth of `subject` leave on the heap, when it has run before.
--
-- A full collection shrinks the stack, which grows again at the first call; so the call
-- that is measured must stand no higher on it than the one before: hence the loop.
function measure.bytes_grown(subject, n)
  collectgarbage()
  collectgarbage()
  collectgarbage("stop")
  local before, after = 0, 0
  for i = 1, 2 do
    before = collectgarbage("count")
    subject(i == 1 and 10 or n)
    after = collectgarbage("count")
  end
  collectgarbage("restart")
  return (after - before) * 1024
end

--- Bytes that what `make` returns holds on the heap: the mean of `n`, garbage not
-- counted.
function measure.bytes_kept(make, n)
  local kept = {}
  for i = 1, n do kept[i] = make(1) end -- whatever the first ones leave behind for good
  for i = 1, n do kept[i] = false end
  collectgarbage()
  collectgarbage()
  local before = collectgarbage("count")
  for i = 1, n do kept[i] = make(1) end
  collectgarbage()
  collectgarbage()
  return (collectgarbage("count") - before) * 1024 / n, kept
end

return measure
