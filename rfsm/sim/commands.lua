--- The commands of the simulator, each with its help.
--
-- @module rfsm.sim.commands
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local rfsm_checks = require "rfsm_checks"
local rfsmpp = require "rfsmpp"
local history = require "rfsm.sim.history"
local breakpoints = require "rfsm.observe.breakpoints"
local time = require "rfsm.sim.time"
local drawing = require "rfsm.sim.drawing"

local error, ipairs, next, print = error, ipairs, next, print
local select, type = select, type
local text_of = rfsm.text_of

local commands = {}

--- A command of the simulator.
---@class rfsm.sim.Command
---@field name string
---@field usage string "step([n])"
---@field brief string a description in one line
---@field text string details and an example, for `help` of this command
---@field run fun(sim: rfsm.sim.Session, ...) returns nothing: results would be printed
---@field takes_line? boolean all words typed after the command are one argument
---@field completes? "now"|"events"|"points" what the Tab key completes. now: events,
-- those of active states first; events: all events alike; points: events and states
---@field fsm? rfsm.Machine the machine that the command is about, if it is in a system

commands.list = {}
-- A topic is a list of commands. It has the fields of a command that `help` prints.
local by_name, topics = {}, {}

local function topic(name)
  topics[#topics + 1] = { name = name, usage = name }
end

local function add(usage, brief, text, run, more)
  local command = more or {}
  command.name = usage:match("^[%w_]+")
  command.usage, command.brief, command.text, command.run = usage, brief, text, run
  by_name[command.name] = command
  commands.list[#commands.list + 1] = command
  local last = topics[#topics]
  last[#last + 1] = command
  last.brief = (last.brief and last.brief .. " " or "") .. command.name
end

--- Return the command with a name; nil if there is none.
function commands.find(name) return by_name[name] end

local function check(command, value, kind, what)
  if type(value) == kind then return value end
  error(("%s: %s expected, got %s"):format(command, what or kind, type(value)), 0)
end

local function advance(sim, n)
  history.mark(sim)
  sim:advance(n)
end

topic "advance"

add("step([n])", "advance by n transitions or doo cycles (1)", [[
Enters the machine when it is called first. Example: step 3]],
function(sim, n)
  n = check("step", n == nil and 1 or n, "number")
  if n < 1 or n % 1 ~= 0 then
    error("step: whole number from 1 expected, got " .. text_of(n), 0)
  end
  advance(sim, n)
end)

add("run()", "advance until nothing is left to do", [[
It stops after 10,000 iterations, at a breakpoint, and by Control-C: a chart may go on
for ever, by a doo that is never idle, or a transition without events.]],
function(sim) advance(sim) end)

add("se(...)", "send events", [[
They wait in the queue until the next step. `se e_done` stands for the completion of
the active leaf. An event is sent also if no transition names it. Example: se e_a e_b]],
function(sim, ...)
  sim:send(...)
  sim:print_queue()
end, { completes = "now" })

add("ses(...)", "send events, then step()", [[
Example: ses e_push    or, in Lua, ses("e_push")]],
function(sim, ...)
  history.mark(sim)
  sim:send(...)
  sim:advance(1)
end, { completes = "now" })

add("ser(...)", "send events, then run()", [[
Example: ser e_push    or, in Lua, ser("e_push")    with data: ser e_paid{amount=12}]],
function(sim, ...)
  history.mark(sim)
  sim:send(...)
  sim:advance()
end, { completes = "now" })

topic "look"

add("events()", "list the events that would do something now", [[
Guards are called, nothing else is.]],
function(sim)
  if not sim.fsm._act_leaf then return print("step() enters the machine") end
  history.show_unknown(sim)
  print((select(2, rfsm_checks.enabled(sim.fsm))))
end)

add("why(...)", "explain the effect that events would have now", [[
Each transition from the root to the active leaf answers: it would be taken, or the
reason why not. Without an event: those in the queue. Example: why e_push]],
function(sim, ...)
  for i = 1, select("#", ...) do sim:check_event((select(i, ...)), i) end
  if sim.saved then print "dry: guards are not asked, each lets pass" end
  history.show_unknown(sim)
  print((select(2, rfsm_checks.why(sim.fsm, ...))))
end, { completes = "events" })

add("tree()", "draw the active states and their siblings", [[
A star marks active states.]],
function(sim) print(drawing.tree(sim.fsm)) end)

add("pp()", "print all states as a tree", [[
[CS] is a composite, [LS] a leaf. The mode is a colour, or a word without colours.]],
function(sim) print((rfsmpp.fsm2str(sim.fsm):gsub("\n$", ""))) end)

add("view(file)", "keep a picture of the machine up to date", [[
The ending of the file is the format: svg, png, pdf (by Graphviz) or dot. view(false)
ends it. Example: view out.svg]],
function(sim, file)
  if file ~= false then check("view", file, "string", "name of a file") end
  sim:draw(file)
end, { takes_line = true })

add("showfqn()", "print the active state and its mode", "",
function(sim) sim:print_active() end)

add("showeq()", "print the events that wait in the queue", "",
function(sim) sim:print_queue() end)

add("follow(on)", "print what each advance takes, and the tree", [[
true at a terminal. false: only the active state and the queue, as for a pipe.]],
function(sim, is_on) sim.follows = is_on ~= false end)

add("dbg(level)", "trace records: false, true or 'full'", [[
false shows none, true the main ones, 'full' all of them.]],
function(sim, level) sim:set_level(level) end)

add("add_hook(f)", "call f(fsm) after each advance", "",
function(sim, hook)
  if not rfsm.is_callable(hook) then check("add_hook", hook, "function") end
  sim.hooks[#sim.hooks + 1] = hook
end)

topic "stop"

add("breakpoint(x)", "stop at a state, a transition or an event", [[
Without an argument: list them. The machine stops behind the step in which the state
was entered, the transition taken, or the event received. The condition behind `if` is
evaluated when that step has ended; `event` is the event there.
Examples: breakpoint off -> on    breakpoint on if tries > 2
          breakpoint e_paid if event.amount > 6]],
function(sim, what)
  if what == nil then return breakpoints.list(sim) end
  local text = type(what) == "string" and what or ""
  local name, condition = text:match("^(.-)%s+if%s+(.+)$")
  local holds = name and sim.compile(condition, "condition", "local event = ... ")
  local n = breakpoints.add(sim, name or what)
  sim.points[n].condition, sim.points[n].holds = condition, holds
  print(("%d  %s"):format(n, breakpoints.text(sim.points[n])))
end, { completes = "points", takes_line = true })

add("watch(expr)", "show the value of an expression after each advance", [[
Without an argument: list them. Example: watch tank.fuel]],
function(sim, text)
  if text == nil then return breakpoints.list(sim) end
  breakpoints.add_watch(sim, check("watch", text, "string", "expression as a text"))
end, { takes_line = true })

add("delete([n])", "remove the breakpoint or expression n, or all", "",
function(sim, n) breakpoints.delete(sim, n) end)

topic "time"

local MAX_SECONDS = 1e9 -- so that each Lua can hold the time as an integer

add("clock([s])", "let s simulated seconds pass", [[
From then on time passes only by clock and next. At each timer on the way, and at the
end, the machine runs, but not for more than 1000 steps. Without an argument: print the
time. clock(false): real time again. Example: clock 3.5]],
function(sim, seconds)
  if seconds == nil then return time.show(sim) end
  if seconds == false then return time.use_real(sim) end
  if not (check("clock", seconds, "number") >= 0 and seconds < MAX_SECONDS) then
    error("clock: seconds from 0 to 1e9 expected, got " .. text_of(seconds), 0)
  end
  time.pass(sim, seconds)
end)

add("next()", "go to the next timer and run", [[
The clock is simulated from then on. With a table it is the function of Lua.]],
function(sim, value, key)
  if type(value) == "table" then return next(value, key) end
  if value ~= nil then
    error("next: no value expected, " .. rfsm.got(value)
      .. " ('clock 3' lets 3 s pass)", 0)
  end
  time.go_to_timer(sim)
end)

topic "undo"

local function moving(move, default)
  return function(sim, n)
    move(sim, n or default)
    if sim.fleet then history.show(sim, 1) end
    history.show_unknown(sim)
    sim:show()
  end
end

add("back([n])", "undo the last n advances (1)", [[
No function of the chart is called. Variables of the chart keep their values, except
those that its states `keep`; a doo begins anew.]],
moving(history.back, 1))

add("forward([n])", "do the last n advances again that back has undone (1)", [[
Until something else is done. No function of the chart is called.]],
moving(history.forward, 1))

add("goto(n)", "go to where advance n ended; goto 0: to the beginning", [[
history() has the numbers. For the rest see back. goto is a word of Lua since 5.2:
where a line is more than this command, it is called go_to(n).]], moving(history.go_to))

add("go_to(n)", "the same in Lua", "", moving(history.go_to))

add("history([n])", "list the last n advances (20)", [[
The number, the events, also those of timers, and the active leaf at its end; then up to
n of those that `back` has undone, where > is the present one. The oldest are forgotten
when all take more than 32 MiB.]],
function(sim, n)
  n = check("history", n or 20, "number")
  history.show(sim, n, n)
end)

add("record(file)", "write what follows to a file", [[
`rfsm sim --replay file` runs the chart through it. record(false) ends it.
Example: record run.jsonl]],
function(sim, file)
  if file ~= false then check("record", file, "string", "name of a file") end
  history.save(sim, file or nil)
end, { takes_line = true })

add("save(file)", "write the machine, for `rfsm fleet URL push`", [[
`rfsm sim --from file` goes on with it, and so does snapshot.load.
Example: save m.json]],
function(sim, file)
  history.keep(sim, check("save", file, "string", "name of a file"))
end, { takes_line = true })

topic "machine"

add("dry(on)", "leave the functions of the chart out", [[
Entries, exits and effects do nothing, guards let pass, a doo goes on until `se e_done`.
A doo that runs already is not ended. dry(false) brings the functions back.]],
function(sim, is_on) sim:set_dry(is_on ~= false) end)

add("reset()", "make the machine as it was at the beginning", "",
function(sim)
  history.mark(sim)
  rfsm.reset(sim.fsm)
  sim:show()
end)

add("reload()", "read the chart's file again", [[
The machine stays in its state if that is still there, with its queue and its timers. No
function is called. A doo begins anew, and so does the history.]],
function(sim) sim:reload() end)

topic "program"

local function print_help(command)
  print(command.usage .. "    " .. command.brief)
  if command.text ~= "" then print(command.text) end
end

local function print_list(members)
  for _, command in ipairs(members) do
    print(("  %-15s%s"):format(command.usage, command.brief))
  end
end

local CLOSING = [[

'help look' and 'help step' have more. A command is Lua, step(3), or words: step 3.
'fsm' is the machine, 'rfsm' the library. An expression prints its value.
Control-C ends what runs, Control-D the program.]]

add("help([x])", "the topics, or more about a topic or a command", "",
function(_, name)
  if name == nil then
    print_list(topics)
    return print(CLOSING)
  end
  local word = text_of(name):match("^[%w_]*")
  if by_name[word] then return print_help(by_name[word]) end
  local list = {}
  for i, members in ipairs(topics) do
    if members.name == word then return print_list(members) end
    list[i] = members.name
  end
  for _, command in ipairs(commands.list) do list[#list + 1] = command.name end
  local hint = advice.nearest_name(text_of(name), list)
  error("help: no command is named " .. text_of(name)
    .. (hint ~= "" and hint or ", help() lists them"), 0)
end)

add("quit()", "end, as Control-D does", "", function(sim) sim.is_over = true end)

return commands
