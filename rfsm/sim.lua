--- The simulator: steps through a chart by hand, with Lua at the prompt.
--
-- The command `rfsm sim` calls `rfsm.sim.main`. Code typed at the prompt sees the
-- machine as `fsm`, the commands that `help()` lists, and the globals of the chart,
-- which it can also set.
--
-- The file reads in the order in which a session goes: output, open a chart, commands,
-- evaluate, read lines, public functions.
--
-- @module rfsm.sim
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local rfsmpp = require "rfsmpp"

local error, ipairs, pairs, pcall, print = error, ipairs, pairs, pcall, print
local rawget, require, select, setmetatable = rawget, require, select, setmetatable
local tostring, type = tostring, type
local io, os = io, os
local concat, sort = table.concat, table.sort
local load = rawget(_G, "loadstring") or rawget(_G, "load")
local setfenv = rawget(_G, "setfenv")

local rfsm_sim = { VERSION = rfsm._VERSION:match("%S+$") }

-- Output: values as text, complaints of one line ------------------------------

local function text_of(value)
  if type(value) == "number" then return ("%.14g"):format(value) end
  local ok, text = pcall(tostring, value)
  return ok and type(text) == "string" and text or type(value)
end

local function list_text(values, separator)
  local texts = {}
  for i = 1, #values do texts[i] = text_of(values[i]) end
  return concat(texts, separator)
end

-- Writes a line to stderr, after what stands in stdout.
local function complain(text)
  io.stdout:flush()
  io.stderr:write(text, "\n")
end

-- Returns the first line of an error: the rest is a traceback or a list of paths.
local function first_line(failure)
  local text = text_of(failure)
  return (text:match("[^\n]+") or text):gsub(":%s*$", "")
end

-- The errors of the chart's own programs.
local function print_err(...)
  local values = { ... }
  for i = 1, select("#", ...) do values[i] = text_of(values[i]) end
  complain(concat(values, "\t"))
end

-- Open a chart ----------------------------------------------------------------

-- Initialises `model`, silent about its problems: they are returned.
local function init_quietly(model)
  local own_err = model.err
  if own_err == nil then model.err = false end
  local fsm, problems = rfsm.init(model)
  model.err = own_err
  if fsm and own_err == nil then fsm.err = print_err end
  return fsm, problems
end

-- Returns a machine, or false and the lines that say why not.
local function open(file)
  local ok, model = pcall(rfsm.load, file)
  if not ok then return false, { (first_line(model):gsub("^rfsm%.load: ", "")) } end
  local done, fsm, problems = pcall(init_quietly, model)
  if not done then return false, { file .. ": " .. first_line(fsm) } end
  if fsm then return fsm end
  for i = 1, #problems do problems[i] = file .. ": " .. problems[i] end
  return false, problems
end

-- Commands --------------------------------------------------------------------

--- One chart and its prompt.
---@class rfsm.sim.Session
---@field fsm rfsm.Machine
---@field name string of the chart, for trace records
---@field hooks (fun(fsm: rfsm.Machine))[] called after each advance
---@field env table what typed code sees: the commands, then the globals
---@field is_over boolean no more lines, please

local function show_active(sim)
  local leaf = sim.fsm._act_leaf
  print("active: " .. (leaf and leaf._fqn .. "(" .. leaf._mode .. ")" or "<none>"))
end

local function show_queue(sim) print("queue:  " .. list_text(sim.fsm._intq, ", ")) end

-- Calls rfsm.step or rfsm.run, and shows where that led, also when it failed.
local function advance(sim, how, n)
  local ok, failure = pcall(how, sim.fsm, n)
  show_active(sim)
  show_queue(sim)
  for _, hook in ipairs(sim.hooks) do hook(sim.fsm) end
  if not ok then error(failure, 0) end
end

-- The records that matter most while a chart is written.
local MAIN_RECORDS = {}
for id in ("STATE_ENTER STATE_EXIT EFFECT DOO EXEC_PATH ERROR HIBERNATING RAISED "
  .. "TIMEEVENT"):gmatch("%S+") do
  MAIN_RECORDS[id] = true
end

local function set_dbg(sim, level)
  if level == nil then level = true end
  if level ~= true and level ~= false and level ~= "full" then
    local what = type(level) == "string" and "string '%s'" or "%s"
    error("dbg: false, true or 'full' expected, got " .. what:format(text_of(level)), 0)
  end
  local ids = level == "full" and {} or MAIN_RECORDS
  sim.fsm.dbg = level and rfsmpp.gen_dbgcolor(sim.name, ids, level == "full")
end

local function add_hook(sim, hook)
  if type(hook) ~= "function" then
    error("add_hook: function expected, got " .. type(hook), 0)
  end
  sim.hooks[#sim.hooks + 1] = hook
end

local HELP = [[
step([n])    advance by n transitions or doo cycles (1)
run()        advance until nothing is left to do
se(...)      send events and print the queue
ses(...)     send events, then step()
ser(...)     send events, then run()
dbg(level)   trace records: false none, true the main ones, 'full' all of them
pp()         print the states as a tree
showeq()     print the events that wait in the queue
showfqn()    print the active state and its mode
add_hook(f)  call f(fsm) after each advance
help()       print this list
quit()       end the simulator, as Control-D does

'fsm' is the machine, 'rfsm' the library. Any Lua works: an expression prints its value,
and what is not complete goes on in the next line.]]

-- Returns the commands for `sim`. None returns a value: the prompt would print it.
local function commands_for(sim)
  local fsm = sim.fsm
  local commands = { fsm = fsm, rfsm = rfsm }
  function commands.step(n) advance(sim, rfsm.step, n or 1) end
  function commands.run() advance(sim, rfsm.run) end
  function commands.se(...)
    rfsm.send_events(fsm, ...)
    show_queue(sim)
  end
  function commands.ses(...)
    rfsm.send_events(fsm, ...)
    advance(sim, rfsm.step, 1)
  end
  function commands.ser(...)
    rfsm.send_events(fsm, ...)
    advance(sim, rfsm.run)
  end
  function commands.dbg(level) set_dbg(sim, level) end
  function commands.pp() print(rfsmpp.fsm2str(fsm)) end
  function commands.showeq() show_queue(sim) end
  function commands.showfqn() show_active(sim) end
  function commands.add_hook(hook) add_hook(sim, hook) end
  function commands.help() print(HELP) end
  function commands.quit() sim.is_over = true end
  return commands
end

local function new_session(fsm, file)
  local name = file:gsub("^.*/", ""):gsub("%.lua$", "")
  local sim = { fsm = fsm, name = name, hooks = {}, is_over = false }
  sim.env = setmetatable(commands_for(sim), { __index = _G, __newindex = _G })
  return sim
end

-- Evaluate: an expression prints its value, a statement runs ------------------

-- Loads a text so that its globals are those of `env`, on every Lua. The blank is for
-- 5.1, which takes what starts with an escape (an arrow key) for a compiled chunk.
local function load_in(env, text, chunkname)
  local chunk, problem = load(" " .. text, chunkname, "t", env)
  if chunk and setfenv then setfenv(chunk, env) end
  return chunk, problem
end

-- Compiles an expression to a chunk that calls a function with its values: a mere
-- `return` would be a tail call, after which an error has lost its place.
local function compile_expression(env, text, chunkname)
  local chunk, problem = load_in(env, "return " .. text, chunkname)
  return chunk and load_in(env, "(...)(" .. text .. "\n)", chunkname) or chunk, problem
end

local function compile(env, text, chunkname)
  local expression = text:match("^%s*=(.*)")
  local chunk, problem = compile_expression(env, expression or text, chunkname)
  if chunk or expression then return chunk, problem end
  return load_in(env, text, chunkname)
end

local function is_incomplete(problem)
  return problem:find("<eof>'?$") ~= nil
end

local function print_results(...)
  if select("#", ...) > 0 then print(...) end
end

-- Runs `text`. Returns true, or false, one line, and whether more text may mend it.
local function evaluate(sim, text, chunkname)
  local chunk, problem = compile(sim.env, text, chunkname)
  if not chunk then return false, first_line(problem), is_incomplete(problem) end
  local ok, failure = pcall(chunk, print_results)
  if not ok then return false, first_line(failure), false end
  return true
end

-- Read lines: piped in, or typed at a terminal --------------------------------

-- Is the file descriptor (0: stdin, 1: stdout) a terminal?
local function is_terminal(descriptor)
  local result = os.execute("test -t " .. descriptor)
  return result == true or result == 0
end

-- What the Tab key can complete: commands, states, the library, events.
local function words_of(sim)
  local set = {}
  for name in pairs(sim.env) do set[name] = true end
  for name in pairs(rfsm) do set["rfsm." .. name] = true end
  rfsm.mapfsm(function(node) set["fsm" .. node._fqn:match("%..*")] = true end, sim.fsm,
    rfsm.is_node)
  rfsm.mapfsm(function(tr)
    for _, event in ipairs(tr.events or {}) do
      if type(event) == "string" then set[event] = true end
    end
  end, sim.fsm, rfsm.is_trans)
  local words = {}
  for word in pairs(set) do words[#words + 1] = word end -- any order: sorted below
  sort(words)
  return words
end

-- Line editing, history and completion by the readline module; nil without it.
local function readline_reader(sim)
  local ok, readline = pcall(require, "readline")
  if not ok then return nil end
  readline.set_options { histfile = "~/.rfsm_sim_history", keeplines = 1000 }
  readline.set_complete_function(function(text, from, to)
    readline.set_completion_append_character("")
    local typed, matches = text:sub(from, to), {}
    for _, word in ipairs(words_of(sim)) do
      if word:sub(1, #typed) == typed then matches[#matches + 1] = word end
    end
    return matches
  end)
  return readline.readline, readline.save_history
end

local function prompting_reader(prompt)
  io.write(prompt)
  io.flush()
  return io.read()
end

local function no_op() end

-- Returns a function that reads a line, and one to call at the end.
local function choose_reader(sim)
  if not is_terminal(0) then return function() return io.read() end, no_op end
  local read, close
  if is_terminal(1) then read, close = readline_reader(sim) end
  read, close = read or prompting_reader, close or no_op
  return read, function()
    close()
    print() -- the shell's prompt belongs on a line of its own
  end
end

-- Reads a line; nil at the end of the input, false after Control-C.
local function read_line(read, prompt)
  local ok, line = pcall(read, prompt)
  if ok then return line end
  if not tostring(line):find("interrupted!", 1, true) then error(line, 0) end
  return false
end

-- Evaluates what is typed so far. When more must follow, returns the text and what is
-- wrong with it as it is, otherwise "".
local function digest(sim, text)
  local ok, problem, is_open = evaluate(sim, text, "=stdin")
  if ok then return "" end
  if is_open then return text, problem end
  complain(problem)
  return ""
end

-- Reads and evaluates until the end of the input. Control-C drops what is typed.
local function converse(sim, read)
  local text, problem = "", nil
  while not sim.is_over do
    local line = read_line(read, text == "" and "> " or ">> ")
    if line == nil then break end
    if line then
      text, problem = digest(sim, text .. line .. "\n")
    else
      text = ""
    end
  end
  if text ~= "" then complain(problem) end
end

-- Public functions ------------------------------------------------------------

-- Runs the texts of -e up to the first that fails, or quits; returns whether all went
-- well.
local function run_code(sim, texts)
  for _, text in ipairs(texts) do
    if sim.is_over then break end
    local ok, problem = evaluate(sim, text, "=(command line)")
    if not ok then
      complain("rfsm sim: " .. problem)
      return false
    end
  end
  return true
end

--- The options of `rfsm sim`.
---@class rfsm.sim.Options
---@field file string the chart
---@field code? string[] Lua to run first
---@field is_quiet? boolean no banner
---@field is_interactive? boolean read commands, also after `code`

--- Open a chart, run the code given, read commands from stdin.
---@param options rfsm.sim.Options
---@return integer status for the shell: 0, or 1 for a chart or code that is wrong
function rfsm_sim.main(options)
  io.stdout:setvbuf("line")
  local fsm, problems = open(options.file)
  if not fsm then
    for _, problem in ipairs(problems) do complain("rfsm sim: " .. problem) end
    return 1
  end
  local sim, code = new_session(fsm, options.file), options.code or {}
  if not run_code(sim, code) then return 1 end
  if sim.is_over or code[1] and not options.is_interactive then return 0 end
  if not options.is_quiet then
    print("rFSM simulator v" .. rfsm_sim.VERSION
      .. ", type 'help()' to list available commands")
  end
  local read, close = choose_reader(sim)
  converse(sim, read)
  close()
  return 0
end

return rfsm_sim
