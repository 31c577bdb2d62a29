--- The simulator behind `rfsm-sim`: a prompt that drives one machine.
--
-- Each line is Lua; the commands of `help()` are functions in its scope, as are `fsm` and
-- `rfsm`. Reading and writing are handed in, so that specs can hold both ends.
--
-- @module rfsm_sim
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local concat, sort = table.concat, table.sort
local setfenv = rawget(_G, "setfenv")

local rfsm_sim = {}

-- The ids that dbg(true) shows; dbg('full') shows them all.
local IMPORTANT = {
  STATE_ENTER = true, STATE_EXIT = true, EFFECT = true, DOO = true, EXEC_PATH = true,
  ERROR = true, HIBERNATING = true, RAISED = true, TIMEEVENT = true,
}

local HELP = [[
step(n)     advance by one step, or by n
run()       advance until nothing is left to do
se(...)     send events
ses(...)    send events and step
ser(...)    send events and run
dbg(x)      trace: false (off), true (the important records), 'full' (all)
pp()        print the states, active ones marked
showeq()    show the queue
showfqn()   show the active leaf
add_hook(f) have f(fsm) called after each advance
help()      this list
fsm, rfsm   the machine and the library; any other Lua works too]]

--- What a simulator works with.
---@class rfsm_sim.Simulator
---@field fsm rfsm.Machine
---@field write fun(text: string) takes each line of output
---@field hooks function[]
---@field env table scope of the lines

-- Showing ---------------------------------------------------------------------

-- The first line of an error, whatever value it is.
local function first_line(problem)
  return (tostring(problem):match("^[^\n]*"))
end

local function list_text(values)
  local texts = {}
  for i = 1, #values do texts[i] = tostring(values[i]) end
  return concat(texts, ", ")
end

local function show_leaf(sim)
  local leaf = sim.fsm._act_leaf
  if not leaf then return sim.write("active: <none>") end
  sim.write("active: " .. leaf._fqn .. "(" .. rfsm.get_sta_mode(leaf) .. ")")
end

local function show_queue(sim) sim.write("queue:  " .. list_text(sim.fsm._intq)) end

local function show(sim)
  show_leaf(sim)
  show_queue(sim)
  for i = 1, #sim.hooks do sim.hooks[i](sim.fsm) end
end

-- rfsmpp, when it is installed.
local function pretty_printer()
  local ok, rfsmpp = pcall(require, "rfsmpp")
  return ok and rfsmpp or nil
end

local function depth_of(fqn)
  local _, dots = fqn:gsub("%.", "")
  return dots
end

-- The states as plain text, one a line, for want of rfsmpp.
local function plain_tree(fsm)
  local lines = { "root " .. rfsm.get_sta_mode(fsm) }
  rfsm.mapfsm(function(state)
    lines[#lines + 1] = ("  "):rep(depth_of(state._fqn)) .. state._id .. " ["
      .. rfsm.fsmobj_tochar(state) .. "] " .. rfsm.get_sta_mode(state)
  end, fsm, rfsm.is_state)
  return concat(lines, "\n")
end

local function show_tree(sim)
  local pp = pretty_printer()
  sim.write(pp and pp.fsm2str(sim.fsm) or plain_tree(sim.fsm))
end

-- Tracing ---------------------------------------------------------------------

local function plain_dbg(sim, ids)
  return function(id, ...)
    if ids and not ids[id] then return end
    local texts = { ... }
    for i = 1, #texts do texts[i] = tostring(texts[i]) end
    sim.write(id .. "\t" .. concat(texts, "\t"))
  end
end

-- Sets fsm.dbg to what `wanted` means: false, true or "full".
local function set_dbg(sim, wanted)
  if not wanted then
    sim.fsm.dbg = false
    return
  end
  local ids = wanted ~= "full" and IMPORTANT or nil
  local pp = pretty_printer()
  sim.fsm.dbg = pp and pp.gen_dbgcolor("sim", ids or {}, not ids) or plain_dbg(sim, ids)
end

-- Commands --------------------------------------------------------------------

local function commands_of(sim)
  local fsm, commands = sim.fsm, {}
  local function advancing(f)
    return function(...)
      f(...)
      show(sim)
    end
  end
  function commands.se(...)
    rfsm.send_events(fsm, ...)
    show_queue(sim)
  end
  commands.step = advancing(function(n) rfsm.step(fsm, n) end)
  commands.run = advancing(function() rfsm.run(fsm) end)
  commands.ses = advancing(function(...)
    rfsm.send_events(fsm, ...)
    rfsm.step(fsm)
  end)
  commands.ser = advancing(function(...)
    rfsm.send_events(fsm, ...)
    rfsm.run(fsm)
  end)
  function commands.dbg(wanted) set_dbg(sim, wanted) end
  function commands.pp() show_tree(sim) end
  function commands.showeq() show_queue(sim) end
  function commands.showfqn() show_leaf(sim) end
  function commands.add_hook(f)
    if type(f) ~= "function" then error("add_hook: function expected", 2) end
    sim.hooks[#sim.hooks + 1] = f
  end
  function commands.help() sim.write(HELP) end
  commands.fsm, commands.rfsm = fsm, rfsm
  return commands
end

--- The names that a prompt can complete.
---@param sim rfsm_sim.Simulator
---@return string[] names sorted
function rfsm_sim.names(sim)
  local names = {}
  for name in pairs(commands_of(sim)) do names[#names + 1] = name end -- sorted below
  sort(names)
  return names
end

-- Prompt ----------------------------------------------------------------------

-- Compiles `text` in the scope of the simulator.
local function compile(sim, text)
  if not setfenv then return load(text, "=prompt", "t", sim.env) end
  local chunk, problem = loadstring(text, "=prompt") -- luacheck: ignore 113 (5.1)
  return chunk and setfenv(chunk, sim.env), problem
end

-- An expression is a statement with `return` in front; "= x" is the old way to say so.
local function compile_line(sim, text)
  local expression = text:match("^%s*=(.*)$") or text
  local chunk = compile(sim, "return " .. expression)
  if chunk then return chunk end
  return compile(sim, text)
end

local function write_results(sim, ok, ...)
  if not ok then return sim.write(first_line((...))) end
  local texts = { ... }
  for i = 1, select("#", ...) do texts[i] = tostring(texts[i]) end
  if texts[1] then sim.write(concat(texts, "\t")) end
end

--- Run one piece of Lua in the scope of the simulator.
---@param sim rfsm_sim.Simulator
---@param text string
---@return boolean is_incomplete true when more lines are needed; nothing ran then
function rfsm_sim.eval(sim, text)
  local chunk, problem = compile_line(sim, text)
  if chunk then
    write_results(sim, pcall(chunk))
    return false
  end
  if problem:find("<eof>", 1, true) then return true end
  sim.write(first_line(problem))
  return false
end

--- Read lines and run them until there are no more.
---@param sim rfsm_sim.Simulator
---@param read fun(prompt: string): string? next line, nil at the end
function rfsm_sim.loop(sim, read)
  local line, pending = read("> "), ""
  while line do
    local text = pending .. line
    if rfsm_sim.eval(sim, text) then pending = text .. "\n" else pending = "" end
    line = read(pending == "" and "> " or ">> ")
  end
  if pending ~= "" then sim.write("prompt: unfinished: " .. first_line(pending)) end
end

--- Make a simulator for a machine.
---@param fsm rfsm.Machine
---@param write? fun(text: string) default print
---@return rfsm_sim.Simulator sim
---@nodiscard
function rfsm_sim.new(fsm, write)
  local sim = { fsm = fsm, write = write or print, hooks = {} }
  sim.env = setmetatable(commands_of(sim), { __index = _G, __newindex = _G })
  return sim
end

--- The line that greets.
---@return string
function rfsm_sim.banner()
  local version = rfsm._VERSION:match("%d.*")
  return "rFSM simulator v" .. version .. ", type 'help()' to list available commands"
end

--- Load the chart in a file; nil and what is wrong with it.
---@param file string
---@return rfsm.Machine? fsm
---@return string? problem
function rfsm_sim.load(file)
  local ok, model = pcall(rfsm.load, file)
  if not ok then return nil, (first_line(model):gsub("^rfsm%.load: ", "")) end
  local is_valid, problems = rfsm.verify_early(model)
  if not is_valid then
    return nil, ("%s: the model has %d problem%s\n  %s"):format(file, #problems,
      #problems == 1 and "" or "s", concat(problems, "\n  "))
  end
  local fsm = rfsm.init(model)
  if not fsm then return nil, file .. ": the model is not valid" end
  return fsm
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_sim", rfsm_sim) end

return rfsm_sim
