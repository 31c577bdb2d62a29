--- The simulator: steps through a chart by hand, with Lua at the prompt.
--
-- The command `rfsm sim` calls `rfsm.sim.main`. Code typed at the prompt sees the
-- machine as `fsm`, the commands that `help()` lists, and the globals of the chart,
-- which it can also set.
--
-- The file reads in the order in which a session goes: output, interrupts, open a
-- chart, commands, evaluate, read lines, public functions.
--
-- @module rfsm.sim
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local rfsmpp = require "rfsmpp"
local chart = require "rfsm.chart"

local error, getmetatable, ipairs, pairs = error, getmetatable, ipairs, pairs
local pcall, print, rawget, require = pcall, print, rawget, require
local select, setmetatable, tostring, type = select, setmetatable, tostring, type
local io, os = io, os
local concat, sort = table.concat, table.sort
local load = rawget(_G, "loadstring") or rawget(_G, "load")
local setfenv = rawget(_G, "setfenv")
local sethook = rawget(_G, "debug") and rawget(_G, "debug").sethook
local text_of, first_line = rfsm.text_of, chart.first_line

local rfsm_sim = { VERSION = rfsm._VERSION:match("%S+$") }

-- Output: values as text, complaints of one line ------------------------------

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

-- The errors of the chart's own callbacks.
local function print_err(...)
  local texts = {}
  for i = 1, select("#", ...) do texts[i] = text_of((select(i, ...))) end
  complain(concat(texts, "\t"))
end

local function sorted(set)
  local list = {}
  for key in pairs(set) do list[#list + 1] = key end -- any order: sorted below
  sort(list, function(a, b) return text_of(a) < text_of(b) end)
  return list
end

local MAX_SHOWN, MAX_DEPTH = 20, 3 -- entries of a table, tables inside each other

local show

local function show_table(t, depth)
  local texts, is_item = {}, {}
  for i = 1, #t do texts[i], is_item[i] = show(t[i], depth + 1), true end
  for _, key in ipairs(sorted(t)) do
    local name = type(key) == "string" and key or "[" .. show(key, depth + 1) .. "]"
    if not is_item[key] then
      texts[#texts + 1] = name .. " = " .. show(t[key], depth + 1)
    end
  end
  if #texts > MAX_SHOWN then texts = { concat(texts, ", ", 1, MAX_SHOWN), "..." } end
  return texts[1] and "{ " .. concat(texts, ", ") .. " }" or "{}"
end

local function show_node(node)
  if rfsm.is_root(node) then
    return "machine, active: " .. (rfsm.get_actleaf_fqn(node) or "<none>")
  end
  local text = node:type() .. " " .. text_of(node._fqn or "without a name")
  return node._mode and text .. " (" .. node._mode .. ")" or text
end

-- Returns a value as a person reads it; `depth` counts the tables around it.
function show(value, depth)
  if type(value) == "string" and depth > 0 then return ("%q"):format(value) end
  if rfsm.is_node(value) then return show_node(value) end
  if type(value) ~= "table" or getmetatable(value) or depth >= MAX_DEPTH then
    return text_of(value)
  end
  return show_table(value, depth)
end

local function print_results(...)
  local texts = {}
  for i = 1, select("#", ...) do texts[i] = show(select(i, ...), 0) end
  if texts[1] then print(concat(texts, "\t")) end
end

-- Interrupts: Control-C, any number of times ----------------------------------
--
-- The interpreter survives one Control-C by itself. If luv is installed it counts them,
-- and a debug hook raises an error for each, also in a doo, which is a coroutine.

local PERIOD = 10000 -- VM instructions between two looks
local uv -- luv, once interrupts are caught
local count, seen = 0, 0 -- Control-Cs typed, and raised as errors

-- Has Control-C been typed since the last look?
local function is_typed()
  if uv then uv.run("nowait") end
  local is_new = count > seen
  seen = count
  return is_new
end

local function poll()
  if is_typed() then error("interrupted!", 2) end -- the core knows this text
end

local function catch_interrupts()
  local ok, luv = pcall(require, "luv")
  if not ok or not sethook or uv then return end
  uv = luv
  uv.new_signal():start("sigint", function() count = count + 1 end)
  sethook(poll, "", PERIOD)
  if rawget(_G, "jit") then rawget(_G, "jit").off() end -- its code calls no hook
end

-- Called as a preproc function.
local function make_interruptible(fsm, merged)
  for _, state in ipairs(uv and rfsm.elements(merged or fsm, rfsm.is_leaf) or {}) do
    local doo = state.doo
    state.doo = doo and function(...)
      sethook(poll, "", PERIOD)
      return doo(...)
    end
  end
end

-- Open a chart ----------------------------------------------------------------

-- Initialises `model`, silent about its problems: they are returned.
local function init_quietly(model)
  local own_err, preproc = model.err, rfsm.preproc
  if own_err == nil then model.err = false end
  preproc[#preproc + 1] = make_interruptible -- after those of the chart's extensions
  local fsm, problems = rfsm.init(model)
  preproc[#preproc] = nil
  model.err = own_err
  if fsm and own_err == nil then fsm.err = print_err end
  return fsm, problems
end

-- Returns a machine, or false and the lines that say why not.
local function open(file)
  local model, warnings = chart.load(file)
  if not model then return false, { warnings } end
  for _, warning in ipairs(warnings) do complain(warning) end
  local ok, fsm, problems = pcall(init_quietly, model)
  if not ok then return false, { chart.reason(file, fsm) } end
  if fsm then return fsm end
  for i = 1, #problems do problems[i] = chart.line(file, problems[i]) end
  return false, problems
end

-- Commands --------------------------------------------------------------------

--- One chart and its prompt.
---@class rfsm.sim.Session
---@field fsm rfsm.Machine
---@field file string of the chart
---@field level boolean|"full" which trace records are shown
---@field hooks (fun(fsm: rfsm.Machine))[] called after each advance
---@field env table what typed code sees: the commands, then the globals
---@field missing string[] globals that the current line reads and that do not exist
---@field is_over boolean no more lines, please

local function show_active(sim)
  local leaf = sim.fsm._act_leaf
  print("active: " .. (leaf and leaf._fqn .. "(" .. leaf._mode .. ")" or "<none>"))
end

local function show_queue(sim) print("queue:  " .. list_text(sim.fsm._intq, ", ")) end

local function show_both(sim)
  show_active(sim)
  show_queue(sim)
end

-- Calls rfsm.step or rfsm.run, and shows where that led, also if it failed.
local function advance(sim, how, n)
  local ok, failure = pcall(how, sim.fsm, n)
  show_both(sim)
  for _, hook in ipairs(sim.hooks) do hook(sim.fsm) end
  if not ok then error(failure, 0) end
end

-- The events that a machine and those inside its states know, as a set.
local function add_events(set, fsm)
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    for _, event in ipairs(tr.events or {}) do set[event] = true end
  end
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do
    local machines = type(state.substates) == "table" and state.substates or {}
    for _, machine in pairs(machines) do -- any order: a set
      if rfsm.is_initialized_root(machine) then add_events(set, machine) end
    end
  end
  return set
end

-- Returns the hint " (did you mean 'e_go'?)", if there is one.
local function nearest(name, names)
  local ok, advice = pcall(require, "rfsm.advice")
  return ok and advice.nearest_name(name, names) or ""
end

local function is_known(set, event)
  return set[event] or event == "e_init_fsm"
    or type(event) == "string" and event:find("^e_done")
end

-- Sends events; complains of those that are nil or that no transition names.
local function send(sim, ...)
  local set, words, has_predicate = add_events({}, sim.fsm), {}, false
  for _, event in ipairs(sorted(set)) do
    if type(event) == "string" then words[#words + 1] = event end
    has_predicate = has_predicate or rfsm.is_callable(event)
  end
  for i = 1, select("#", ...) do
    local event = select(i, ...)
    local name = event == nil and sim.missing[1]
    if name then
      complain(("nothing is named %s, an event is in quotes%s"):format(name,
        nearest(name, words)))
    elseif event == nil then
      complain(("event %d is nil"):format(i))
    elseif not has_predicate and not is_known(set, event) then
      complain(("no transition names the event '%s'%s"):format(show(event, 0),
        type(event) == "string" and nearest(event, words) or ""))
    end
  end
  rfsm.send_events(sim.fsm, ...)
end

-- Returns the path that an event would take now, as text; nil if there is none.
local function path_on(fsm, event)
  local node = fsm
  while node do
    local path = rfsm.node_find_enabled(fsm, node, { event })
    if path then
      local texts = {}
      while path do
        texts[#texts + 1] = path.node._fqn
        path = path.nextl and path.nextl[1].next
      end
      return concat(texts, " -> ")
    end
    node = node._actchild
  end
end

-- Prints the events that would do something now. An unknown one stands for any.
local function show_events(sim)
  local fsm, any = sim.fsm, {}
  if not fsm._act_leaf then
    return print("step() enters the machine")
  end
  local on_any, is_empty = path_on(fsm, any), true
  for _, event in ipairs(sorted(add_events({}, fsm))) do
    local path = not rfsm.is_callable(event) and path_on(fsm, event)
    if path and path ~= on_any then
      print(text_of(event) .. ":  " .. path)
      is_empty = false
    end
  end
  if on_any then print("any event:  " .. on_any) end
  if is_empty and not on_any then print("no event does anything now") end
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
  local name = sim.file:gsub("^.*/", ""):gsub("%.lua$", "")
  sim.level = level
  sim.fsm.dbg = level and rfsmpp.gen_dbgcolor(name, ids, level == "full")
end

-- The chart is read anew; if it has a problem the machine stays.
local function reload(sim)
  local fsm, problems = open(sim.file)
  if not fsm then
    for _, problem in ipairs(problems) do complain(problem) end
    return
  end
  sim.fsm, sim.env.fsm = fsm, fsm
  if sim.level then set_dbg(sim, sim.level) end
  show_both(sim)
end

local function add_hook(sim, hook)
  if not rfsm.is_callable(hook) then
    error("add_hook: function expected, got " .. type(hook), 0)
  end
  sim.hooks[#sim.hooks + 1] = hook
end

local HELP = [[
step([n])    advance by n transitions or doo cycles (1)
run()        advance until nothing is left to do; Control-C ends it
se(...)      send events and print the queue
ses(...)     send events, then step()
ser(...)     send events, then run()
events()     print the events that would do something now
dbg(level)   trace records: false none, true the main ones, 'full' all of them
pp()         print the states as a tree
showeq()     print the events that wait in the queue
showfqn()    print the active state and its mode
add_hook(f)  call f(fsm) after each advance
reset()      make the machine as it was at the beginning
reload()     read the chart's file again
help()       print this list
quit()       end the simulator, as Control-D does

'fsm' is the machine, 'rfsm' the library. Any Lua works: an expression prints its value,
and an incomplete line goes on in the next. Control-C drops what is typed.]]

-- Returns the commands for `sim`. None returns a value: the prompt would print it.
local function commands_for(sim)
  local commands = { fsm = sim.fsm, rfsm = rfsm }
  function commands.step(n) advance(sim, rfsm.step, n or 1) end
  function commands.run() advance(sim, rfsm.run) end
  function commands.se(...)
    send(sim, ...)
    show_queue(sim)
  end
  function commands.ses(...)
    send(sim, ...)
    advance(sim, rfsm.step, 1)
  end
  function commands.ser(...)
    send(sim, ...)
    advance(sim, rfsm.run)
  end
  function commands.events() show_events(sim) end
  function commands.dbg(level) set_dbg(sim, level) end
  function commands.pp() print((rfsmpp.fsm2str(sim.fsm):gsub("\n$", ""))) end
  function commands.showeq() show_queue(sim) end
  function commands.showfqn() show_active(sim) end
  function commands.add_hook(hook) add_hook(sim, hook) end
  function commands.reset()
    rfsm.reset(sim.fsm)
    show_both(sim)
  end
  function commands.reload() reload(sim) end
  function commands.help() print(HELP) end
  function commands.quit() sim.is_over = true end
  return commands
end

local function new_session(fsm, file)
  local sim = {
    fsm = fsm, file = file, level = false, hooks = {}, missing = {}, is_over = false,
  }
  sim.env = setmetatable(commands_for(sim), {
    __index = function(_, name)
      local value = _G[name]
      if value == nil then sim.missing[#sim.missing + 1] = text_of(name) end
      return value
    end,
    __newindex = _G,
  })
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

-- A command alone, such as `step`, is called.
local function call_of(sim, text)
  local name = text:match("^%s*([%a_][%w_]*)%s*$")
  return name and type(rawget(sim.env, name)) == "function" and name .. "()" or text
end

-- Runs `text`. Returns true, or false, one line, and whether more text may mend it.
local function evaluate(sim, text, chunkname)
  sim.missing = {}
  local chunk, problem = compile(sim.env, call_of(sim, text), chunkname)
  if not chunk then return false, first_line(problem), is_incomplete(problem) end
  local ok, failure = pcall(chunk, print_results)
  if ok then return true end
  return false, (first_line(failure):gsub("^.*:%d+: (interrupted!)$", "%1")), false
end

-- Read lines: piped in, or typed at a terminal --------------------------------
--
-- A reader takes a prompt and returns a line; nil at the end of the input; false if
-- Control-C dropped it.

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
  for _, node in ipairs(rfsm.elements(sim.fsm, rfsm.is_nr_node)) do
    set["fsm" .. node._fqn:match("%..*")] = true
  end
  for event in pairs(add_events({}, sim.fsm)) do -- any order: a set
    if type(event) == "string" then set[event] = true end
  end
  return sorted(set)
end

-- Reads a line key by key, so that Control-C is noticed at once.
local function read_keys(readline, prompt)
  local line, is_done = nil, false
  readline.handler_install(prompt, function(text)
    line, is_done = text, true
    readline.handler_remove()
  end)
  local keys = uv.new_poll(0)
  keys:start("r", readline.read_char)
  while not is_done and count == seen do uv.run("once") end
  keys:stop()
  keys:close()
  if is_done then return line end
  readline.handler_remove()
  seen = count
  print()
  return false
end

local HISTORY = (os.getenv("HOME") or ".") .. "/.rfsm_sim_history"

-- The history is complete also if the simulator is killed.
local function keep_line(readline, line)
  readline.add_history(line)
  local file = io.open(HISTORY, "a")
  if not file then return end
  file:write(line, "\n")
  file:close()
end

-- Line editing, history and completion by the readline module; nil without it.
local function readline_reader(sim)
  local ok, readline = pcall(require, "readline")
  if not ok then return nil end
  readline.set_options { histfile = HISTORY, auto_add = false }
  readline.set_complete_function(function(text, from, to)
    readline.set_completion_append_character("")
    local typed, matches = text:sub(from, to), {}
    for _, word in ipairs(words_of(sim)) do
      if word:sub(1, #typed) == typed then matches[#matches + 1] = word end
    end
    return matches
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
  return io.read()
end

local function choose_reader(sim)
  if not is_terminal(0) then return function() return io.read() end end
  return is_terminal(1) and readline_reader(sim) or prompting_reader
end

-- Reads a line. Returns also whether Control-C was typed: it drops the lines before,
-- and a terminal has dropped what stood before it in this one.
local function read_line(read, prompt)
  local ok, line = pcall(read, prompt)
  if ok then return line, is_typed() end
  if not tostring(line):find("interrupted!", 1, true) then error(line, 0) end
  return false, true
end

-- Evaluates what is typed so far. If more must follow, returns the text and what is
-- wrong with it as it is, otherwise "".
local function digest(sim, text)
  local ok, problem, is_open = evaluate(sim, text, "=stdin")
  if ok then return "" end
  if is_open then return text, problem end
  complain(problem)
  return ""
end

-- Reads and evaluates until the end of the input.
local function converse(sim, read)
  local text, problem = "", nil
  while not sim.is_over do
    local line, is_dropped = read_line(read, text == "" and "> " or ">> ")
    if line == nil then break end
    if is_dropped or not line then text = "" end
    if line then text, problem = digest(sim, text .. line .. "\n") end
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
  if is_terminal(0) then catch_interrupts() end
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
  converse(sim, choose_reader(sim))
  if is_terminal(0) then print() end -- the shell's prompt has a line of its own
  return 0
end

return rfsm_sim
