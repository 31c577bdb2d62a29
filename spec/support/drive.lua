-- What the claims about the simulator and the page share: charts in files, the place of
-- a machine as text, a machine that is driven by plain calls.

local helper = require "spec.helper"
local rfsm = require "rfsm"

local drive = { EVENTS = { "e1", "e2", "e3", "e_own", "e_x@y" } }

--- Returns where a machine stands: active states, modes, queue, and data it keeps.
function drive.place(fsm)
  local texts = {}
  for _, location in ipairs(rfsm.machines(fsm)) do
    local machine = location.machine
    local leaf = machine._act_leaf
    texts[#texts + 1] = location.prefix .. "=" .. table.concat(
      rfsm.get_active_conf(machine), " ") .. (leaf and leaf._mode or "")
    for _, event in ipairs(machine._intq) do texts[#texts + 1] = rfsm.text_of(event) end
    for _, key in ipairs(rfsm.sorted_keys(machine.counts)) do
      texts[#texts + 1] = key .. rfsm.text_of(machine.counts[key])
    end
  end
  return table.concat(texts, " ")
end

local is_quiet, real_print = false, print

--- Loads a module whose print is silent while a claim is checked.
function drive.require(name)
  rawset(_G, "print", function(...)
    if not is_quiet then real_print(...) end
  end)
  local module = require(name)
  rawset(_G, "print", real_print)
  return module
end

--- Calls f(...) while nothing is printed.
function drive.silently(f, ...)
  local stderr = io.stderr
  is_quiet = true
  rawset(io, "stderr", { write = function(self) return self end })
  local ok, result = pcall(f, ...)
  is_quiet = false
  rawset(io, "stderr", stderr)
  if not ok then error(result, 0) end
  return result
end

--- Returns the problem if a tool has left its machine elsewhere than calls in Lua have
-- left another one.
function drive.difference(fsm, called)
  local place, expected = drive.place(fsm), drive.place(called)
  if place ~= expected then
    return "commands: " .. place .. "\ncalls: " .. expected
  end
end

--- Returns what check(file) returns; the file has the chart of a seed.
function drive.with_file(seed, check)
  local name = os.tmpname()
  helper.write(name, ("return require('spec.support.kept').model(%d)\n"):format(seed))
  local ok, result = pcall(check, name)
  os.remove(name)
  if not ok then error(result, 0) end
  return result
end

--- Returns the function of a claim that calls check(seed) for each of n seeds.
function drive.each(check)
  return function(n, seed)
    for i = 1, n do
      local problem = drive.silently(check, seed + i - 1)
      if problem then return i, ("seed %d: %s"):format(seed + i - 1, problem) end
    end
    return n
  end
end

return drive
