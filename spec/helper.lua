-- What several specs need.

local rfsm = require "rfsm"

local helper = {}

--- Runs `f` and returns the lines that it printed.
function helper.printed(f)
  local lines, real = {}, print
  rawset(_G, "print", function(...)
    local texts = { ... }
    for i = 1, select("#", ...) do texts[i] = tostring(texts[i]) end
    lines[#lines + 1] = table.concat(texts, " ")
  end)
  local ok, problem = pcall(f)
  rawset(_G, "print", real)
  if not ok then error(problem, 0) end
  return lines
end

local function noting(trace, what)
  return function(_, state) trace[#trace + 1] = what .. " " .. state._fqn end
end

local function note_state(trace, state)
  state.entry = state.entry or noting(trace, "entry")
  state.exit = state.exit or noting(trace, "exit")
end

--- Gives each state of `model` an entry and exit, and each transition an effect, that
-- note in a flat list what ran; returns the list and the machine.
function helper.traced(model)
  local trace = {}
  rfsm.mapfsm(function(state) note_state(trace, state) end, model, rfsm.is_state)
  rfsm.mapfsm(function(tr)
    tr.effect = tr.effect or function(_, self)
      trace[#trace + 1] = "effect " .. self.src._fqn .. "->" .. self.tgt._fqn
    end
  end, model, rfsm.is_trans)
  return trace, helper.init(model)
end

--- A machine that says nothing about its model.
function helper.init(model)
  if model.warn == nil then model.warn = false end
  if model.info == nil then model.info = false end
  return (assert(rfsm.init(model)))
end

--- A problem or warning without the file and line of a spec in it.
function helper.without_file(text)
  return (text:gsub("spec/[%w_]+%.lua:%d+: ", ""))
end

--- Forgets what a list holds.
function helper.clear(list)
  for i = #list, 1, -1 do list[i] = nil end
end

--- Sends events and runs until there is nothing to do.
function helper.post_and_run(fsm, ...)
  rfsm.send_events(fsm, ...)
  return rfsm.run(fsm)
end

local made = {} -- names of files

--- Returns the name of a new file with this text. A spec file that makes some says
-- `after_each(helper.remove_files)`, so that none is left when a spec fails.
function helper.file_with(text)
  local name = os.tmpname()
  made[#made + 1] = name
  local file = assert(io.open(name, "wb"))
  file:write(text)
  file:close()
  return name
end

--- Removes what `file_with` made.
function helper.remove_files()
  for i = #made, 1, -1 do
    os.remove(made[i])
    made[i] = nil
  end
end

-- The interpreter that runs this, as the shell can call it.
local function interpreter()
  local i = 0
  while arg[i - 1] do i = i - 1 end
  return arg[i]
end

--- Runs a text with a fresh Lua; returns its output.
function helper.output_of(text)
  local pipe = assert(io.popen(interpreter() .. " " .. helper.file_with(text)
    .. " 2>&1"))
  local output = pipe:read("*a")
  pipe:close()
  return (output:gsub("%s+$", ""))
end

--- Returns what stands in a file.
function helper.content(name)
  local file = assert(io.open(name, "rb"))
  local text = file:read("*a")
  file:close()
  return text
end

return helper
