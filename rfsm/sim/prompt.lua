--- The prompt of the simulator: Lua, and commands written as words.
--
-- An expression prints its value, a statement runs. A line that is no Lua and begins
-- with a command is split into words: `ser e_push` means `ser("e_push")`.
--
-- @module rfsm.sim.prompt
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local alphabet = require "rfsm.shared.alphabet"
local calls = require "rfsm.shared.calls"
local chart = require "rfsm.shared.chart"
local location = require "rfsm.shared.location"
local names = require "rfsm.observe.names"
local terminal = require "rfsm.sim.terminal"
local typed = require "rfsm.shared.typed"
local rfsm = require "rfsm"
local rfsmpp = require "rfsmpp"

local _G, error, ipairs, pairs, pcall = _G, error, ipairs, pairs, pcall
local print, rawget, select = print, rawget, select
local setmetatable, type = setmetatable, type
local concat = table.concat
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local load = rawget(_G, "loadstring") or rawget(_G, "load")
local complain, first_line = terminal.complain, chart.first_line

local prompt = {}

-- Compile ---------------------------------------------------------------------------

-- Loads a text with a blank in front. Lua 5.1 takes a text that begins with an escape
-- character, which arrow keys send, for a compiled chunk.
local function load_in(env, text, chunkname)
  return calls.load(" " .. text, chunkname, env)
end

-- Compiles an expression to a chunk f(print) that calls `print` with the expression's
-- values. In the simpler chunk `return g()` a tail call hides the line of an error.
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

-- Words -----------------------------------------------------------------------------

local VALUES = { ["true"] = true, ["false"] = false }

local function value_of_word(word)
  if VALUES[word] ~= nil then return VALUES[word] end
  if not word:find("{", 1, true) then return rfsm.number_of(word) or word end
  local event, problem = typed.read(word)
  return event or error(problem, 0)
end

local function split(text)
  local words = typed.split(text)
  for i, word in ipairs(words) do
    words[i] = value_of_word(word:match("^(['\"])(.*)%1$") and word:sub(2, -2) or word)
  end
  return words
end

-- Returns a function that calls the command with which a line of words begins; nil if
-- it begins with no command.
local function call_of(sim, text)
  local name, rest = text:match("^%s*([%a_][%w_]*)%f[%s%z]%s*(.-)%s*$")
  if not name then name, rest = text:match("^%s*(goto)%((.-)%)%s*$") end -- a keyword
  local command = name and sim.commands.find(name)
  if not command then return nil end
  return function()
    local is_line = command.takes_line and rest ~= ""
    sim.env[name](unpack(is_line and { value_of_word(rest) } or split(rest)))
  end
end

-- Words of other programs for commands of the simulator.
local OTHERS = {
  bye = "quit", exit = "quit", q = "quit", undo = "back", redo = "forward",
  send = "se", event = "ser", fire = "ser", emit = "ser", post = "ser",
  state = "pp", states = "pp", status = "pp", where = "pp", active = "pp",
  print = "pp", show = "pp", current = "pp", list = "tree", chart = "tree", ls = "tree",
  transitions = "events", queue = "showeq", ["break"] = "breakpoint", bp = "breakpoint",
  s = "step", n = "step", next_step = "step", continue = "run", c = "run", r = "run",
  trace = "dbg", debug = "dbg", time = "clock", commands = "help", h = "help",
}

-- Returns the complaint about a name that does not exist.
local function problem_of_missing(sim, name, list)
  for _, command in ipairs(sim.commands.list) do list[#list + 1] = command.name end
  local other = OTHERS[name] and sim.commands.find(OTHERS[name])
  local hint = other and (" (did you mean '%s'?)"):format(other.name)
    or advice.nearest_name(name, list)
  if hint == "" then hint = ", help() lists the commands" end
  return "nothing is named " .. name .. hint
end

-- Is a word a name, neither of a value nor a word of Lua?
local function is_unknown(sim, name)
  return name and sim.env[name] == nil and load("local " .. name) ~= nil
end

-- Returns a complaint if a line is only the name of an event, or an unknown name.
local function problem_of_name(sim, text)
  local name = text:match("^%s*([%a_][%w_]*)%s*$")
  if not is_unknown(sim, name) then return nil end
  if sim.commands.find "ser" and alphabet.of_all(sim.fsm).set[name] then
    return ("%s is an event: 'ser %s' sends it and runs"):format(name, name)
  end
  return problem_of_missing(sim, name, names.events(sim.fsm))
end

-- Returns a complaint if a line, which is no Lua, is an unknown name and words.
local function problem_of_words(sim, text)
  local name = text:match("^%s*([%a_][%w_]*)%s+[%w_]")
  if not is_unknown(sim, name) then return nil end
  return problem_of_missing(sim, name, {})
end

-- Evaluate --------------------------------------------------------------------------

-- Returns the problem of a line. If the line has called a global that does not exist,
-- returns a complaint about this name, with a hint.
local function explain(sim, problem)
  local name = problem:find("attempt to call", 1, true) and sim.missing[1]
  return name and problem_of_missing(sim, name, {}) or problem
end

-- Prints the values of an expression in one line, if there are any.
local function print_values(...)
  local texts = {}
  for i = 1, select("#", ...) do texts[i] = rfsmpp.value_text((select(i, ...))) end
  if texts[1] then print(concat(texts, "\t")) end
end

-- Calls a chunk. Returns true; if it fails, returns false and the problem in one line.
local function call(sim, chunk)
  local release = sim:guard_doos()
  terminal.settle()
  local ok, failure = pcall(chunk, print_values)
  release()
  if ok then return true end
  local problem = first_line(failure):gsub("^.*:%d+: (interrupted!)$", "%1")
  return false, explain(sim, problem)
end

--- Run a text. Return true if it ran. Otherwise return false, the problem, and whether
--- the text is only incomplete.
function prompt.evaluate(sim, text, chunkname)
  sim.missing = {}
  -- Certainly words, not Lua? Lua would take `view /tmp/x.svg` for a division.
  local is_clear = text:find("^%s*[%a_][%w_]*%s*$")
    or text:find("^%s*[%a_][%w_]*%s+[%w_/.+-]")
  local problem = problem_of_name(sim, text)
  if problem then return false, problem, false end
  local chunk = is_clear and call_of(sim, text)
  if not chunk then
    chunk, problem = compile(sim.env, text, chunkname)
    chunk = chunk or not is_incomplete(problem) and call_of(sim, text)
  end
  if chunk then return call(sim, chunk) end
  if text:find("^%s*%?") then return false, "help() lists the commands", false end
  if is_incomplete(problem) then return false, first_line(problem), true end
  return false, problem_of_words(sim, text) or first_line(problem), false
end

--- Make the environment of typed code: the commands, and the globals of the chart.
function prompt.install(sim)
  local env = { fsm = sim.fsm, rfsm = rfsm, cell = sim.cell }
  for _, command in ipairs(sim.commands.list) do
    env[command.name] = function(...) return command.run(sim, ...) end
  end
  function sim.compile(text, name, before) -- the text is an expression
    text = (before or "") .. "return " .. text
    local chunk, problem = load_in(env, text, "=" .. name)
    return chunk or error(problem, 0)
  end
  function sim.value_of(text)
    local ok, value = pcall(sim.compile, text, "watch")
    if ok then ok, value = pcall(value) end
    return ok, ok and value or not ok and first_line(value) or value
  end
  sim.env = setmetatable(env, {
    __index = function(_, name)
      local value = _G[name]
      if value == nil then sim.missing[#sim.missing + 1] = rfsm.text_of(name) end
      return value
    end,
    __newindex = _G,
  })
end

-- Read lines ------------------------------------------------------------------------

-- Lists the events of transitions from active states, and from connectors.
local function events_now(fsm)
  local words = {}
  for at, tr in location.each(fsm, rfsm.is_trans) do
    local is_now = at.machine._act_leaf and tr.src._mode ~= "inactive"
    for _, event in ipairs(is_now and tr.events or {}) do
      local is_typed = type(event) == "string" and not event:find("@", 1, true)
      if is_typed then words[#words + 1] = event end
    end
  end
  return words
end

-- Returns two lists of words for the Tab key after the text `before`: all words, and
-- the words to offer first.
local function words_after(sim, before)
  local command = sim.commands.find(before:match("^%s*([%w_]+)[%s(]") or "") or {}
  local fsm = command.fsm or sim.fsm
  local kind, words = command.completes, names.events(fsm)
  if kind == "now" then return words, events_now(fsm) end
  if kind == "events" then return words, {} end
  for _, name in ipairs((names.nodes(sim.fsm))) do
    words[#words + 1] = name
    words[#words + 1] = name:gsub("^root%.", "")
    words[#words + 1] = "fsm" .. name:match("%..*")
  end
  if kind == "points" and not before:find("%sif%s") then return words, {} end
  for name in pairs(sim.env) do words[#words + 1] = name end -- any order: sorted later
  for name in pairs(rfsm) do words[#words + 1] = "rfsm." .. name end
  return words, {}
end

local function beginning_with(word, words)
  local set = {}
  for _, name in ipairs(words) do
    if name:sub(1, #word) == word then set[name] = true end
  end
  return rfsm.sorted_keys(set)
end

-- Returns the words that complete the typed word. Readline sorts them. So the words to
-- offer first are returned alone, unless none of them begins with the typed word.
local function complete(sim, word, before)
  local words, first = words_after(sim, before)
  first = beginning_with(word, first)
  return first[1] and first or beginning_with(word, words)
end

-- Evaluates a text and prints its problem. The first result is the text if it is
-- incomplete, else "". The second result is the problem, or nil.
local function evaluate(sim, text)
  local ok, problem, is_open = prompt.evaluate(sim, text, "=stdin")
  if is_open then return text, problem end
  if not ok then complain(problem) end
  return "", problem
end

-- Returns the line; for an empty line the last line, if the last line was a command.
local function repeated(sim, line)
  if not line:find("%S") then return sim.last_line or line end
  sim.last_line = sim.commands.find(line:match("^%s*([%w_]*)")) and line
  return line
end

-- Evaluates an incomplete text with a further line. Returns the results of `evaluate`.
local function take_line(sim, text, line)
  if text == "" and sim.follows then line = repeated(sim, line) end
  return evaluate(sim, text .. line .. "\n")
end

--- Read and evaluate until the end of the input; at a terminal, Enter alone repeats a
-- command. Return false if a line was wrong.
function prompt.converse(sim)
  local read = terminal.new_reader(function(...) return complete(sim, ...) end)
  local text, problem, is_right = "", nil, true
  while not sim.is_over do
    local line, is_dropped = terminal.read(read, text == "" and "> " or ">> ")
    if line == nil then break end
    if is_dropped or not line then text = "" end
    if line then text, problem = take_line(sim, text, line) end
    is_right = is_right and (text ~= "" or not problem)
  end
  if text ~= "" then complain(problem) end
  return is_right and text == ""
end

return prompt
