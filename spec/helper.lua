-- What several specs need.

local rfsm = require "rfsm"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local helper = {}

-- Replaced fields, errors -----------------------------------------------------------

--- Runs f while `t` has these fields; false removes one. Returns the result of f.
function helper.with(t, fields, f)
  local real = {}
  for key, value in pairs(fields) do -- any order: distinct keys
    real[key] = rawget(t, key)
    rawset(t, key, value or nil)
  end
  local ok, result = pcall(f)
  for key in pairs(fields) do rawset(t, key, real[key]) end -- any order: as above
  if not ok then error(result, 0) end
  return result
end

--- Runs f with one more preproc function; returns its result.
function helper.with_preproc(preproc, f)
  table.insert(rfsm.preproc, preproc)
  local ok, result = pcall(f)
  table.remove(rfsm.preproc)
  if not ok then error(result, 0) end
  return result
end

--- Returns the text of the error that f(...) raises, which must blame its caller.
function helper.refusal(f, ...)
  local arguments, n = { ... }, select("#", ...)
  local ok, problem = pcall(function() return (f(unpack(arguments, 1, n))) end)
  if ok then return "accepted" end
  local text = tostring(problem):match("^[^:\n]*helper%.lua:%d+: (.*)$")
  return text or "blames another: " .. tostring(problem)
end

-- What is printed and noted --------------------------------------------------------

--- Runs `f` and returns the lines that it printed.
function helper.printed(f)
  local lines = {}
  helper.with(_G, { print = function(...)
    lines[#lines + 1] = table.concat(helper.texts(...), " ")
  end }, f)
  return lines
end

--- Returns a list of the texts of its arguments.
function helper.texts(...)
  local texts = { ... }
  for i = 1, select("#", ...) do texts[i] = tostring(texts[i]) end
  return texts
end

--- Collects the calls of a printer of a machine or model as lines; with `id` those that
-- begin with it.
function helper.said(owner, printer, id)
  local lines = {}
  owner[printer] = function(...)
    if id and (...) ~= id then return end
    lines[#lines + 1] = table.concat(helper.texts(...), " ")
  end
  return lines
end

--- Returns a function that appends `text` to a list.
function helper.noting(trace, text) return function() trace[#trace + 1] = text end end

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

-- Machines -------------------------------------------------------------------------

--- (initial) -> a --events--> b --e_back--> a, and more members.
function helper.chart(events, members)
  local trans = rfsm.trans
  local model = {
    warn = false, info = false, a = rfsm.state {}, b = rfsm.state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = events },
    trans { src = "b", tgt = "a", events = { "e_back" } },
  }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a set
  return rfsm.state(model)
end

--- The description of a machine (initial) -> off --e_push--> on -> off. The core
-- alone has no `rfsm.marsh`.
function helper.lamp()
  local state, trans = rfsm.state, rfsm.trans
  return require "rfsm.marsh".model2tab(helper.init(state {
    off = state {}, on = state {},
    trans { src = "initial", tgt = "off" },
    trans { src = "off", tgt = "on", events = { "e_push" } },
    trans { src = "on", tgt = "off" },
  }), true)
end

--- A machine of s1 --e_push--> s2 --e_push--> ... s1, with `count` leaves, that runs.
function helper.ring(count)
  local model = rfsm.state { rfsm.trans { src = "initial", tgt = "s1" } }
  for i = 1, count do
    model["s" .. i] = rfsm.state {}
    model[#model + 1] = rfsm.trans { src = "s" .. i, tgt = "s" .. i % count + 1,
      events = { "e_push" } }
  end
  return helper.started(model)
end

--- A machine that says nothing about its model.
function helper.init(model)
  if model.warn == nil then model.warn = false end
  if model.info == nil then model.info = false end
  return (assert(rfsm.init(model)))
end

--- Such a machine, after its first run.
function helper.started(model)
  local fsm = helper.init(model)
  rfsm.run(fsm)
  return fsm
end

--- A problem or warning without the file and line of a spec in it.
function helper.without_file(text)
  return (text:gsub("%.?/?spec/[%w_/]+%.lua:%d+: ", ""))
end

--- Forgets what a list holds.
function helper.clear(list)
  for i = #list, 1, -1 do list[i] = nil end
end

--- Sends events and runs until there is nothing to do.
function helper.post_and_run(fsm, ...)
  if select("#", ...) > 0 then rfsm.send_events(fsm, ...) end
  return rfsm.run(fsm)
end

--- Does that, and returns the machine.
function helper.moved(fsm, ...)
  helper.post_and_run(fsm, ...)
  return fsm
end

--- Does that, and returns the FQN of the leaf.
function helper.leaf_after(fsm, ...)
  helper.post_and_run(fsm, ...)
  return rfsm.get_actleaf_fqn(fsm)
end

--- Moves a machine as a story says, and returns the story as it went: "e_x=b +3=a =a".
-- A move is an event, or several with commas, each time sent and run, or `+...`, with
-- which `advance` is called, or nothing. Behind = is the id of the leaf then.
function helper.story(fsm, story, advance)
  return (story:gsub("(%S*)=%S+", function(move)
    local events, time = {}, move:match("^%+(.*)")
    if time then advance(time) end
    for event in (time and "" or move):gmatch("[^,]+") do
      events[#events + 1] = event
    end
    helper.post_and_run(fsm, unpack(events))
    return move .. "=" .. (fsm._act_leaf and fsm._act_leaf._id or "none")
  end))
end

--- Copies a table with all tables in it, keys too, as `deepcopy` of many programs does;
-- metatables are shared. Returns any other value.
function helper.copy_of(value, copies)
  if type(value) ~= "table" then return value end
  copies = copies or {}
  if not copies[value] then
    local copy = {}
    copies[value] = copy
    for key, other in pairs(value) do -- any order: each stands alone
      rawset(copy, helper.copy_of(key, copies), helper.copy_of(other, copies))
    end
    setmetatable(copy, getmetatable(value))
  end
  return copies[value]
end

-- Files and other Luas ---------------------------------------------------------------

--- Writes a file; returns its name.
function helper.write(name, text)
  local file = assert(io.open(name, "wb"))
  file:write(text)
  file:close()
  return name
end

local made = {} -- names of files

--- Returns the name of a new file with this text. A spec file that makes some says
-- `after_each(helper.remove_files)`, so that none is left when a spec fails.
function helper.file_with(text)
  made[#made + 1] = os.tmpname()
  return helper.write(made[#made], text)
end

--- Removes what `file_with` made.
function helper.remove_files()
  for i = #made, 1, -1 do
    os.remove(made[i])
    made[i] = nil
  end
end

--- Returns a module of Debian; nil if it is missing. Those in Lua are packaged up to
--- 5.3, and also serve later ones.
function helper.package(name)
  local path = package.path
  package.path = path .. ";/usr/share/lua/5.3/?.lua"
  local ok, module = pcall(require, name)
  package.path = path
  return ok and module or nil
end

--- Returns the interpreter that runs this, as the shell can call it.
function helper.interpreter()
  local i = 0
  while arg[i - 1] do i = i - 1 end
  return arg[i]
end

--- Runs a command of the shell; returns what it prints.
function helper.text_of(command)
  local pipe = assert(io.popen(command))
  local text = pipe:read("*a")
  pipe:close()
  return text
end

--- Runs a command of the shell; returns the lines that it prints.
function helper.lines_of(command)
  local pipe, lines = assert(io.popen(command)), {}
  for line in pipe:lines() do lines[#lines + 1] = line end
  pipe:close()
  return lines
end

--- Runs a text with a fresh Lua, with variables such as "A=b"; returns its output.
function helper.output_of(text, variables)
  local lines = helper.lines_of(("%s %s %s 2>&1"):format(variables or "",
    helper.interpreter(), helper.file_with(text)))
  return (table.concat(lines, "\n"):gsub("%s+$", ""))
end

--- Returns the files of the project that match globs: those that git knows, in a tree
--- without git all of them.
function helper.files(...)
  local globs = table.concat({ ... }, "' ':(glob)")
  local found = helper.lines_of("git ls-files -- ':(glob)" .. globs .. "' 2>/dev/null")
  if found[1] then return found end
  return helper.lines_of("ls -d " .. table.concat({ ... }, " ") .. " 2>/dev/null")
end

--- Returns what stands in a file.
function helper.content(name)
  local file = assert(io.open(name, "rb"))
  local text = file:read("*a")
  file:close()
  return text
end

return helper
