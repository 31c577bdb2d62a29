-- The simulator as a person meets it: the tool runs as a process of its own, under the
-- Lua that runs this spec.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local share = require "spec.support.share"
local snapshot = require "rfsm.snapshot"
local snapshot_file = require "rfsm.snapshot.file"

local BANNER = "rFSM simulator v1.0.0, type 'help()' to list available commands\n"
local INFO = "INFO: created undeclared connector root.initial\n"
local HELLO = "examples/hello_world.lua"
local LUA = arg[-1]

local content, file_with = helper.content, helper.file_with

-- Runs a command line; returns what it wrote to stdout and stderr, and its status.
local function run(command, input)
  local out, err = file_with(""), file_with("")
  local status = os.execute(("%s <%s >%s 2>%s; echo $? >>%s"):format(command,
    file_with(input or ""), out, err, err))
  assert.is_true(status == true or status == 0)
  local complaints, code = content(err):match("^(.-)(%d+)\n$")
  return content(out), complaints, tonumber(code)
end

local function sim(arguments, input) -- as tools/rfsm-sim does
  return run("TERM=dumb " .. LUA .. " tools/rfsm sim " .. arguments, input)
end

-- What the prompt prints for `input`, with hello_world and no errors.
local function said(input)
  local out, complaints, status = sim("-q " .. HELLO, input)
  assert.equal("", complaints)
  assert.equal(0, status)
  return out
end

-- What it complains of.
local function complaint(input)
  local _, complaints, status = sim("-q " .. HELLO, input)
  assert.equal(1, status)
  return complaints
end

local AT_HELLO = "active: root.hello(done)\nqueue:  e_done@root.hello\n"
local AT_END = "hello\nworld\nactive: root.world(done)\nqueue:  \n"
local AT_NONE = "active: <none>\nqueue:  e_init_fsm\n"
local AFTER = "active: root.world(done)\nqueue:  \n"
local AT_WORLD = "active: root.world(done)\nqueue:  e_done@root.world\n"

after_each(helper.remove_files)

local function output_of(command) return helper.text_of(command .. " 2>/dev/null") end

describe("the simulator", function()
  it("goes the way of hello, world", function()
    local out, complaints, status = sim(HELLO, [[
step()
step()
se("e_restart")
step()
]])
    assert.equal("", complaints)
    assert.equal(0, status)
    assert.equal(INFO .. BANNER .. AT_HELLO .. "hello\nworld\n" .. AT_WORLD
      .. "queue:  e_done@root.world, e_restart\n" .. AT_HELLO, out)
  end)

  it("opens the chart that a word of make sim names", function()
    local own = file_with("return rfsm.state { info = false, lamp = 'own' }")
    local TITLES = { ["lamp.lua"] = "nil\tsays", ["MODEL=lamp.lua"] = "nil\tsays",
      ["examples/lamp.lua"] = "nil\tsays", [own] = "own\tnil",
      [""] = "nil\tnil", ["MODEL=" .. HELLO .. " " .. own] = "own\tnil" }
    for word, title in pairs(TITLES) do -- any order: each stands alone
      assert.equal(title .. "\n", (run("TERM=dumb make -s sim " .. word,
        "print(fsm.lamp, fsm.on and 'says')"):gsub("^.-help[^\n]*\n", "")), word)
    end
  end)

  it("complains of a word of make sim that names no chart, and opens none", function()
    for _, word in ipairs { "nosuch.lua", "lamp.lau", "MODEL=nosuch.lua" } do
      local out, complaints = run("TERM=dumb make -s sim " .. word)
      assert.equal("", out)
      assert.equal(("rfsm sim: %s: No such file or directory\n"):format(
        word:gsub("MODEL=", "")), complaints:match("^[^\n]*\n"))
    end
  end)

  it("runs with the Lua that LUA names, also by make sim", function()
    local made = helper.lines_of("make -sn sim LUA=" .. LUA .. " MODEL=" .. HELLO)
    local jit = rawget(_G, "jit")
    local expected = INFO .. BANNER .. _VERSION .. "\t" .. tostring(jit and jit.version)
    for _, command in ipairs { "LUA=" .. LUA .. " tools/rfsm-sim " .. HELLO,
      made[#made] } do
      assert.equal(expected .. "\n",
        (run("TERM=dumb " .. command, "print(_VERSION, jit and jit.version)")))
    end
  end)
end)

-- The output for each input, with hello_world and without an error.
local SAID = {
  ["step() step()"] = AT_HELLO .. "hello\nworld\n" .. AT_WORLD,
  ["step(3)"] = AT_END, ["run()"] = AT_END, ["step\n"] = AT_HELLO, ["run"] = AT_END,
  ["showeq()"] = "queue:  e_init_fsm\n",
  ['se("e_restart", "e_restart")'] = "queue:  e_init_fsm, e_restart, e_restart\n",
  ['run() ses("e_restart")'] = AT_END .. AT_HELLO,
  ['run() ser("e_restart")'] = AT_END .. AT_END,
  ["showfqn() step() showfqn()"] = "active: <none>\n" .. AT_HELLO
    .. "active: root.hello(done)\n",
  ["events() run() events()"] = "step() enters the machine\n" .. AT_END
    .. "e_restart\n",
  ["run() reset() step()"] = AT_END .. AT_NONE
    .. AT_HELLO,
  ["run()\nreload()\nfsm.hello\nstep()"] = AT_END
    .. "active: root.world(done)\nqueue:  \nstate root.hello (inactive)\n"
    .. "active: root.world(done)\nqueue:  \n",
  ["'hello', 'world'\nnil\n= 'three'\n"] = "hello\tworld\nnil\nthree\n",
  ["rfsm.is_root(fsm)\nfsm\nfsm[1]"] = "true\nmachine, active: <none>\n"
    .. "T={ src='root.initial', tgt='root.hello' }\n",
  ["{ 1, 'a', x = { y = 2 }, [true] = fsm.world }, {}"] =
    '{ 1, "a", [true] = state root.world (inactive), x = { y = 2 } }\t{}\n',
  ["{ x = { x = { x = { 1 } } } }"] = "^{ x = { x = { x = table: %S+ } } }\n$",
  ["{ { { { 1 } } } }"] = "^{ { { table: %S+ } } }\n$",
  ["local t = {} for i = 1, 25 do t[i] = i end x = t\nx\nx = nil"] =
    "{ 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, ... }\n",
  ["x = { 1 }\nx[2], x.y = x, { x }\nx\nx = nil"] =
    "^{ 1, table: %S+, y = { table: %S+ } }\n$",
  ["x = {}\nwatch x\nx[1] = { { x, { 1 } } }\nstep\ndelete\nx = nil"] = "^"
    .. AT_HELLO:gsub("[().]", "%%%0")
    .. "watch:  x = { { { table: %S+, table: %S+ } } }\n$",
  ["for i = 1, 2 do\n  print(i)\nend\n"] = "1\n2\n",
  ["step 3"] = AT_END, ["run\nser e_restart, 'e_restart'"] = AT_END .. AT_END,
  ["next({ 7 })"] = "1\t7\n",
  ["step\nstep\nback 2\nforward 9"] = AT_HELLO .. "hello\nworld\n" .. AT_WORLD
    .. "active: <none>\nqueue:  e_init_fsm\n" .. AT_WORLD,
  ["step\nstep\nback\nstep"] = AT_HELLO .. "hello\nworld\n"
    .. AT_WORLD .. AT_HELLO .. "hello\nworld\n" .. AT_WORLD,
  ["step\nreset\nstep\nback 2\nforward"] = AT_HELLO .. AT_NONE .. AT_HELLO .. AT_HELLO
    .. AT_NONE,
  ["step\nse e_done"] = AT_HELLO
    .. "queue:  e_done@root.hello, e_done@root.hello\n",
  ["tree\nstep\ntree"] = "  root ...\n" .. AT_HELLO
    .. "* root\n  * hello (done)\n    world\n",
  ["follow(true)\nstep\nses('e_restart')\nfollow(false)"] =
    "taken:  root.initial -> root.hello\n* root\n  * hello (done)\n    world\n"
    .. AT_HELLO .. "taken:  root.hello -> root.world on e_done\nhello\nworld\n"
    .. "discarded: e_restart ('why e_restart' explains)\n"
    .. "* root\n    hello\n  * world (done)\n" .. AT_WORLD,
  ["breakpoint world\nrun\nbreakpoint\nrun\ndelete"] = "1  state root.world\n"
    .. "hello\nworld\n" .. AT_WORLD .. "stopped at 1: state root.world\n"
    .. "1  state root.world\nactive: root.world(done)\nqueue:  \n",
  ["breakpoint(fsm[2])\nrun\ndelete(1)\nbreakpoint"] =
    "1  transition root.hello -> root.world\nhello\nworld\n" .. AT_WORLD
    .. "stopped at 1: transition root.hello -> root.world\nthere is none\n",
  ["breakpoint hello -> world\nbreakpoint e_restart\nstep\nser e_restart\ndelete"] =
    "1  transition root.hello -> root.world\n2  event e_restart\n" .. AT_HELLO
    .. "hello\nworld\nactive: root.world(done)\nqueue:  e_done@root.world\n"
    .. "stopped at 1: transition root.hello -> root.world\n"
    .. "stopped at 2: event e_restart\n",
  ["watch fsm.hello._mode\nstep\nstep\ndelete"] = AT_HELLO
    .. "watch:  fsm.hello._mode = done (was inactive)\nhello\nworld\n" .. AT_WORLD
    .. "watch:  fsm.hello._mode = inactive (was done)\n",
  ["dry(true)\nrun\ndry(false)"] = "active: root.world(done)\nqueue:  \n",
  ["step 2\nback\nstep"] = "hello\nworld\n" .. AT_WORLD
    .. "active: <none>\nqueue:  e_init_fsm\n" .. AT_HELLO,
}

-- The complaint about each input.
local COMPLAINTS = {
  ["se('e_restrat')"] = "no transition names the event 'e_restrat' (did you "
    .. "mean 'e_restart'?)\n",
  ["se(e_restart)"] = "nothing is named e_restart, an event is in quotes (did "
    .. "you mean 'e_restart'?)\n",
  ["se { 'e_restart' }"] = "no transition names the event '{ \"e_restart\" }'\n",
  ["se(nil)"] = "event 1 is nil\n",
  ["dbg('fool')"] = "dbg: false, true or 'full' expected, got string 'fool'\n",
  ["add_hook(1)"] = "add_hook: function expected, got number\n",
  ["step('x')"] = "step: number expected, got string\n",
  ["error('no')"] = "^stdin:%d+: no\n$", ["error('one\\ntwo')"] = "^stdin:%d+: one\n$",
  ["error()"] = _VERSION == "Lua 5.5" and "<no error object>\n" or "nil\n",
  ["error({})"] = "^table: %S+\n$", ["x = = 1\n"] = "^stdin:%d+: [^\n]*near '=?'\n$",
  ["stpe"] = "nothing is named stpe (did you mean 'step'?)\n",
  ["stpe(1)"] = "nothing is named stpe (did you mean 'step'?)\n",
  ["exit"] = "nothing is named exit (did you mean 'quit'?)\n",
  ["bye()"] = "nothing is named bye (did you mean 'quit'?)\n",
  ["q"] = "nothing is named q (did you mean 'quit'?)\n",
  ["xyz"] = "nothing is named xyz, help() lists the commands\n",
  ["xyz e_restart"] = "nothing is named xyz, help() lists the commands\n",
  ["send e_restart"] = "nothing is named send (did you mean 'se'?)\n",
  ["undo 2"] = "nothing is named undo (did you mean 'back'?)\n",
  ["stpe 3"] = "nothing is named stpe (did you mean 'step'?)\n",
  ["rfsm step"] = "^stdin:%d+: [^\n]*near '=?'?step'?\n$",
  ["e_restart"] = "e_restart is an event: 'ser e_restart' sends it and runs\n",
  ["help nothing"] = "help: no command is named nothing, help() lists them\n",
  ["breakpoint nowhere"] = "breakpoint: state, event or transition (off -> on) "
    .. "expected, got 'nowhere', pp() shows the states\n",
  ["help stpe"] = "help: no command is named stpe (did you mean 'step'?)\n",
  ["breakpoint helo"] = "breakpoint: state, event or transition (off -> on) expected, "
    .. "got 'helo' (did you mean 'hello'?)\n",
  ["breakpoint helo if x"] = "breakpoint: state, event or transition (off -> on) "
    .. "expected, got 'helo' (did you mean 'hello'?)\n",
  ["breakpoint hello if"] = "breakpoint: state, event or transition (off -> on) "
    .. "expected, got 'hello if' (did you mean 'hello'?)\n",
  ["breakpoint hello if x.y\nrun"] =
    "^breakpoint 1: condition:1: attempt to index [^\n]*\n$",
  ["delete 9"] = "delete: number of a breakpoint expected, got 9\n",
  ["watch 1 +"] = "^watch:1: [^\n]*\n$",
  ["clock -1"] = "clock: seconds from 0 to 1e9 expected, got -1\n",
  ["clock 1e9"] = "^clock: seconds from 0 to 1e9 expected, got 1",
  ["clock 1e308"] = "^clock: seconds from 0 to 1e9 expected, got 1e%+308\n$",
  ["clock(0/0)"] = "^clock: seconds from 0 to 1e9 expected, got %-?nan\n$",
  ["step -1"] = "step: whole number from 1 expected, got -1\n",
  ["step 1.5"] = "step: whole number from 1 expected, got 1.5\n",
  ["step 0"] = "step: whole number from 1 expected, got 0\n",
  ["forward 0"] = "forward: number from 1 expected, got 0\n",
  ["clock x"] = "clock: number expected, got string\n",
  ["next"] = "next: no timer is armed\n",
  ["next 3"] = "next: no value expected, got number 3 ('clock 3' lets 3 s pass)\n",
  ["clock + 3"] = "clock: number expected, got string\n",
  ["goto(-1)"] = "^goto: number of an advance from 0 to %d+ expected, got %-1\n$",
  ["back 0"] = "back: number from 1 expected, got 0\n",
  ["view x.doc"] = "view: file.svg, .png, .pdf or .dot expected, got 'x.doc'\n",
  ["view /no/x.dot"] = "view: /no/x.dot: No such file or directory\n",
  ["record /no/x"] = "record: /no/x: No such file or directory\n",
  ["view(7)"] = "view: name of a file expected, got number\n",
  ["record(7)"] = "record: name of a file expected, got number\n",
  ["watch(7)"] = "watch: expression as a text expected, got number\n",
  ["history x"] = "history: number expected, got string\n",
  ["view x.doc\nprint()"] = "view: file.svg, .png, .pdf or .dot expected, got "
    .. "'x.doc'\n",
  ["require 'no.such'"] = "^[^\n]*module 'no.such' not found\n$",
}

-- Compares the result of each input with what is expected, a pattern if it begins with
-- ^. All inputs go to one process, with `mark` behind each, which writes "~".
local function check_each(results, expected_of, mark)
  local inputs, text, i = rfsm.sorted_keys(expected_of), "", 0
  for _, input in ipairs(inputs) do text = text .. input .. "\n" .. mark .. "\n" end
  for result in results(text):gmatch("([^~]*)~") do
    i = i + 1
    local expected = expected_of[inputs[i]]
    if expected:sub(1, 1) == "^" then
      assert.matches(expected, result, inputs[i])
    else
      assert.equal(expected, result, inputs[i])
    end
  end
  assert.equal(#inputs, i)
end

describe("the prompt", function()
  it("prints the result of each input", function()
    check_each(said, SAID, "io.write('~') rfsm.reset(fsm)")
  end)

  it("complains of each mistake", function()
    check_each(complaint, COMPLAINTS, "io.stderr:write('~')")
    assert.matches("^stdin:%d: [^\n]*<eof>'?\n$", complaint("for i = 1, 2 do\n"))
  end)

  it("goes on after a wrong line of a pipe, and ends with status 1", function()
    for input, expected in pairs { -- any order: each is a process
      ["wrong\nstep"] = 1, ["error(1)\nstep\nquit"] = 1, ["step\nfor i = 1, 2 do"] = 1,
      ["step\nse e_wrong"] = 0, ["step\nquit\nwrong"] = 0, ["step"] = 0,
    } do
      local out, _, status = sim("-q " .. HELLO, input .. "\n")
      assert.same({ input, expected, true },
        { input, status, out:find("active: root.hello", 1, true) ~= nil })
    end
  end)

  it("calls a hook after each advance", function()
    assert.equal(AT_HELLO .. "hook\ttrue\n",
      said("add_hook(function(f) print('hook', f == fsm) end) step()"))
  end)

  it("prints the tree of states", function()
    assert.matches("^root[^\n]*\n *hello%[LS%].*\n *world%[LS%]", said("pp()"))
  end)

  it("ends with quit", function()
    assert.equal("1\n2\n", said("print(1)\nquit() print(2)\nprint(3)\n"))
    assert.equal("1\n", said("1\nquit\n2\n"))
    assert.equal(AT_HELLO, said("step()")) -- the last line without a newline
  end)

  it("shows the main records after dbg(true), none after dbg(false)", function()
    local out = said("dbg(true) step() dbg(false) step()")
    assert.matches("STATE_ENTER%s+root%.hello\n", out)
    assert.is_nil(out:find("TRANS_ENTER", 1, true))
    assert.is_nil(out:find("STATE_ENTER[^\n]*root.world"))
    assert.matches("TRANS_ENTER", said("dbg('full') step()"))
  end)

  it("lists the commands", function()
    local NAMES = "step run se ses ser events why tree pp view showeq showfqn follow "
      .. "dbg add_hook breakpoint watch delete clock next back goto history record dry "
      .. "reset reload help quit"
    local TOPICS = "advance look stop time undo machine program"
    local out = said("help")
    for topic in TOPICS:gmatch("%S+") do
      assert.matches("  " .. topic .. " ", out)
      out = out .. "~\n" .. said("help " .. topic)
    end
    local each = said((NAMES:gsub("%S+", "print '~'\nhelp %0\n")))
    for name in NAMES:gmatch("%S+") do
      assert.matches("^[^~]* " .. name .. "%f[%s]", out)
      assert.matches("~.*\n  " .. name .. "%(", out)
      assert.matches("~\n" .. name .. "%(", each)
    end
    for text in (out .. each):gmatch("[^~]+") do
      assert.is_true(select(2, text:gsub("\n", "")) < 24, text) -- and the prompt
    end
  end)

  it("sets the globals of the chart", function()
    local chart = file_with([[
return rfsm.state {
  a = rfsm.state {}, b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", guard = function() return is_open == true end },
  warn = false, info = false,
}]])
    local out = sim("-q " .. chart, 'run()\nis_open = true\nses("e")\n')
    assert.equal("active: root.a(done)\nqueue:  \n"
      .. "active: root.b(done)\nqueue:  e_done@root.b\n", out)
  end)

  it("shows where a failed advance has led, and goes on", function()
    local out, complaints = sim("-q " .. HELLO,
      "rfsm.post_step_hook_add(fsm, function() error('hook', 0) end)\nstep()\n1\n")
    assert.same({ AT_HELLO .. "1\n", "hook\n" }, { out, complaints })
  end)
end)

-- A stand-in of the package ansicolors: <%{green}>.
local COLOURS = "package.preload.ansicolors = function() return "
  .. "{ noReset = function(name) return '<' .. name .. '>' end } end"

it("writes no colours into a pipe", function()
  local out = run(("TERM=xterm LUA_INIT=\"%s\" %s tools/rfsm sim -q %s"):format(COLOURS,
    LUA, HELLO), "dbg 'full'\nstep\npp\ntree\n")
  assert.matches("hello[LS] done", out, 1, true)
  assert.matches("EFFECT", out)
  assert.is_nil(out:find("%{", 1, true))
end)

-- A terminal, made by tmux --------------------------------------------------------

local has_tmux = output_of("command -v tmux") ~= ""
local sockets = {} -- of the terminals that are open
local without = "package.preload['%s'] = function() error('none') end "

-- Opens a chart in a terminal of its own; without arguments, a shell. `type_in` sends
-- keys, as tmux calls them, and waits until the screen shows a text; `await_prompt`
-- waits until the last line is a prompt.
local function open_terminal(arguments, lua_init)
  local socket = file_with("")
  os.remove(socket)
  local tmux = "tmux -f /dev/null -S " .. socket .. " "
  local terminal = {}
  sockets[#sockets + 1] = socket

  function terminal.screen() return output_of(tmux .. "capture-pane -p -S -100") end

  function terminal.type_in(text, ...)
    for _, key in ipairs { ... } do
      os.execute(tmux .. "send-keys '" .. key:gsub("'", "'\\''") .. "'")
    end
    local found = output_of(("timeout 30 sh -c 'until %s capture-pane -p -S -100 "
      .. "| grep -F \"%s\"; do sleep 0.02; done'"):format(tmux, text))
    assert.is_true(found ~= "", "no '" .. text .. "' in:\n" .. terminal.screen())
  end

  function terminal.await_prompt(sign)
    local found = output_of(("timeout 30 sh -c 'until %s capture-pane -p | grep . "
      .. "| tail -n 1 | grep \"^%s *$\"; do sleep 0.02; done'"):format(tmux, sign))
    assert.is_true(found ~= "", "no prompt in:\n" .. terminal.screen())
  end

  -- Types Control-D until the program has ended: at first readline may not be there.
  function terminal.close()
    os.execute(("timeout 30 sh -c 'until %s capture-pane -p "
      .. "| grep -qF \"ended with status\"; do %s send-keys C-d; sleep 0.05; done' "
      .. "2>/dev/null"):format(tmux, tmux))
    local screen = terminal.screen()
    assert.is_truthy(screen:find("ended with status 0", 1, true), screen)
  end

  -- tmux asks $SHELL to run the command. Control-C reaches that shell, too.
  os.execute(("SHELL=/bin/sh LUA_INIT=\"%s\" HOME=/nowhere TERM=dumb LUA=%s %s "
    .. "new-session -d -x 120 -y 50 '%s'"):format(lua_init or "", LUA, tmux, arguments
    and "trap : INT; tools/rfsm-sim " .. arguments
      .. "; echo ended with status $?; sleep 100"
    or 'env PS1="$ " ENV= sh -i'))
  terminal.type_in(arguments and ">" or "$")
  return terminal
end

local BUSY = [[
local n = 0
local function poll() for i = 1, 10 do n = n + i end end
return rfsm.state {
  warn = false, info = false,
  idle = rfsm.state {},
  busy = rfsm.state { doo = function() while true do rfsm.yield() end end },
  spin = rfsm.state { doo = function() while true do end end },
  mute = rfsm.state { entry = function() while true do poll() end end },
  rfsm.trans { src = "initial", tgt = "idle" },
  rfsm.trans { src = "idle", tgt = "busy", events = "e_busy" },
  rfsm.trans { src = "idle", tgt = "spin", events = "e_spin" },
  rfsm.trans { src = "idle", tgt = "mute", events = "e_mute" },
  rfsm.trans { src = "mute", tgt = "idle", events = "e_stop" },
  rfsm.trans { src = "busy", tgt = "idle", events = "e_stop" },
  rfsm.trans { src = "spin", tgt = "idle", events = "e_stop" },
}]]

describe("at a terminal", function()
  after_each(function()
    for i = #sockets, 1, -1 do
      os.execute("tmux -S " .. sockets[i] .. " kill-server 2>/dev/null")
      os.remove(sockets[i])
      sockets[i] = nil
    end
  end)

  if not has_tmux or not pcall(require, "luv") then
    return pending("tmux or luv is missing")
  end

  it("Control-C drops a line, ends a run, and interrupts a doo, any time", function()
    local at = open_terminal("-q " .. file_with(BUSY))
    at.type_in("taken:  root.initial -> root.idle", "print(1)", "C-c", "run", "Enter")
    at.type_in("root.spin on e_spin", "ser e_spin", "Enter")
    at.type_in("interrupted!", "C-c")
    at.type_in("root.spin -> root.idle", "ser e_stop", "Enter")
    at.type_in("queue:  e_spin", "se e_spin", "Enter")
    at.type_in("now", "print('n' .. 'ow') rfsm.run(fsm)", "Enter")
    at.type_in("go on", "C-c", "print('go' .. ' on')", "Enter")
    at.type_in("root.busy on e_busy", "ser e_stop", "Enter", "se e_busy", "Enter",
      "step 1e9", "Enter")
    at.type_in("active: root.busy(", "C-c") -- done if its own code was interrupted
    at.type_in("42", "print(2)", "C-c", "6 * 7", "Enter")
    at.type_in("> ", "Enter")
    at.close()
    local text = at.screen()
    assert.is_nil(text:find("\n[12]\n"))
    assert.equal(3, select(2, text:gsub("interrupted!", "")))
    assert.matches("%* busy[^\n]*\n.*active: root.busy%(%l+%)", text)
  end)

  it("Control-C ends an entry, and the transition is complete", function()
    local at = open_terminal("-q " .. file_with(BUSY))
    at.type_in("taken:  root.initial -> root.idle", "run", "Enter")
    at.type_in("root.mute on e_mute", "ser e_mute", "Enter")
    at.type_in("active: root.mute(done)", "C-c")
    at.type_in("root.mute -> root.idle", "ser e_stop", "Enter")
    at.close()
  end)

  it("Control-Z gives the terminal to the shell, and fg shows the prompt", function()
    local at = open_terminal()
    at.type_in("initial", "tools/rfsm-sim " .. HELLO, "Enter")
    at.await_prompt ">"
    at.type_in("> lost", "lost")
    at.type_in("topped", "C-z")
    at.type_in("shell 3", "echo shell $((1 + 2))", "Enter")
    at.type_in("fg", "fg", "Enter")
    at.await_prompt ">"
    at.type_in("42", "6 * 7", "Enter")
    at.type_in("> quit", "quit", "Enter")
    at.await_prompt "[$]" -- else readline takes the keys along
    at.type_in("shell 5", "echo shell $((2 + 3))", "Enter")
    assert.matches("\n> 6 %* 7\n42\n> quit\n", at.screen())
  end)

  it("has colours", function()
    local at = open_terminal("-i -e run " .. HELLO, COLOURS)
    at.type_in("<%{yellow}>world<%{reset}>[LS]", "pp", "Enter")
    at.close()
  end)

  it("Tab completes commands, states and events", function()
    if not pcall(require, "readline") then return pending("lua-readline is missing") end
    local at = open_terminal("-q " .. file_with(BUSY))
    at.type_in("> breakpoint spin", "brea", "Tab", " sp", "Tab", "Enter")
    at.type_in("> ser e_busy", "ser e_b", "Tab")
    at.type_in("> fsm.idle", "Enter", "fsm.id", "Tab")
    at.type_in("state root.idle", "Enter")
    assert.matches("1  state root.spin\n.*state root.idle %(done%)\n", at.screen())
  end)

  it("goes without luv and readline, and names the packages", function()
    local init = ""
    for _, name in ipairs { "luv", "readline" } do
      init = init .. without:format(name)
    end
    local at = open_terminal("-i -e step " .. HELLO, init)
    at.type_in("active: root.world(done)", "run", "Enter")
    at.type_in("ended with status 0", "quit", "Enter")
    assert.matches("\nfor line editing and the Tab key, for more than one Control%-C "
      .. "%(on Debian%): apt%-get install lua%-readline lua%-%a+\n", at.screen())
  end)
end)

describe("the sessions in doc/sim.md", function()
  it("are what the simulator prints", function()
    local out, complaints = run(LUA .. " tools/transcript.lua doc/sim.md")
    assert.equal("", complaints)
    assert.equal(content("doc/sim.md"), out)
  end)
end)

describe("reload", function()
  local CHART = [[
require "rfsm_timeevent"
return rfsm.state {
  warn = false, info = false,
  a = rfsm.state {}, b = rfsm.state { entry = function() print("b") end },
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = "e_b" },
  rfsm.trans { src = "b", tgt = "a", events = "e_after(5)" },
}]]

  -- What is printed for a reload in b after the chart has become another.
  local function reloaded(text, more)
    local chart, other = file_with(CHART), file_with(text)
    local out, complaints = sim("-q " .. chart, "clock 0\nrun\nser e_b\nclock 2\n"
      .. "print '~'\nos.rename('" .. other .. "', '" .. chart .. "')\nreload\n" .. more)
    complaints = complaints:gsub(chart:gsub("%p", "%%%0"), "CHART")
    return out:match("~\ntrue\n(.*)"), complaints
  end

  it("keeps state, queue and timers, and calls nothing", function()
    local out, complaints = reloaded(CHART:gsub("rfsm.trans { src = \"initial\"",
      "c = rfsm.state {},\n  %0"), "clock 2\nclock 2\n")
    assert.equal("", complaints)
    assert.equal("active: root.b(done)\nqueue:  \n"
      .. "clock:  4 s\nactive: root.b(done)\nqueue:  \n"
      .. "clock:  5 s\nactive: root.a(done)\nqueue:  \n"
      .. "clock:  6 s\nactive: root.a(done)\nqueue:  \n", out)
  end)

  it("keeps breakpoints and expressions, but those of what is gone", function()
    local chart, other = file_with(CHART),
      file_with((CHART:gsub("%f[%w]b =", "c ="):gsub('"b"', '"c"')))
    local out, complaints = sim("-q " .. chart, "breakpoint b\nbreakpoint a\n"
      .. "breakpoint a -> b\nbreakpoint e_b\nwatch 1 + 1\nos.rename('" .. other
      .. "', '" .. chart .. "')\nreload\nprint '~'\nbreakpoint\nrun\n")
    assert.equal("3 transition root.a -> root.b: is gone, and no breakpoint now\n"
      .. "1 state root.b: is gone, and no breakpoint now\n", complaints)
    assert.equal("1  state root.a\n2  event e_b\n3  watch 1 + 1\nactive: root.a(done)"
      .. "\nqueue:  e_done@root.a\nwatch:  1 + 1 = 2\nstopped at 1: state root.a\n",
      out:match("~\n(.*)"))
  end)

  it("begins anew if the state is gone", function()
    local out, complaints = reloaded((CHART:gsub("%f[%w]b =", "c =")
      :gsub('"b"', '"c"')), "run\n")
    assert.matches("root.b.*the machine begins anew\n$", complaints)
    assert.equal("active: <none>\nqueue:  e_init_fsm\n"
      .. "active: root.a(done)\nqueue:  \n", out)
  end)

  it("has no stubs unless the simulator was started with them", function()
    local out, complaints = reloaded("local arm = robot.arm\n" .. CHART, "showfqn\n")
    assert.matches("CHART:1: [^\n]*'robot'", complaints)
    assert.equal("active: root.b(done)\n", out)
  end)

  it("reports a mistake, and changes nothing", function()
    local out, complaints = reloaded("return rfsm.state { a = = 1 }", "showfqn\n")
    assert.matches("^CHART:1: [^\n]*\n$", complaints)
    assert.equal("active: root.b(done)\n", out)
  end)
end)

-- Sends random events and resets to each chart, steps, and goes back. Prints the
-- iterations after which a machine stands elsewhere than then, and "done".
local WANDER = [[
package.path = "./?.lua;" .. package.path
print = function() end
local rfsm = require "rfsm"
local history = require "rfsm.sim.history"
local alphabet = require "rfsm.shared.alphabet"
local prompt = require "rfsm.sim.prompt"
local session = require "rfsm.sim.session"
local dice = require("spec.support.random")(7)

local function place_of(sim)
  local leaf = sim.fsm._act_leaf
  return table.concat(rfsm.get_active_conf(sim.fsm), " ") .. (leaf and leaf._mode or "")
end

local function wander(sim, count)
  local known, places = alphabet.of_all(sim.fsm), {}
  local events = rfsm.sorted_keys(known.set)
  for i, event in ipairs(events) do
    if type(event) == "function" then
      events[i] = { name = rfsm.event_name(event) }
    end
  end
  for _ = 1, count do
    if dice(9) == 1 then sim.env.reset() else sim.env.se(events[dice(#events)]) end
    sim.env.step()
    places[sim.history.at] = place_of(sim)
  end
  return places
end

for _, file in ipairs(FILES) do
  local sim = session.open(file, false)
  prompt.install(sim)
  sim.env.clock(0)
  local places = wander(sim, 8)
  while sim.history.at > 0 do
    local n = math.max(sim.history.at - dice(7), 0)
    local ok, problem = pcall(history.go_to, sim, n)
    if not ok then
      io.write(file, ": ", problem, "\n")
      break
    end
    if places[n] and places[n] ~= place_of(sim) then
      io.write(file, " ", n, ": ", places[n], ", got ", place_of(sim), "\n")
    end
  end
  sim.env.clock(false)
end
io.write("done")
]]

describe("goto", function()
  it("leads back to any advance of any example, each on two of the Luas", function()
    local files, count, dynamic = {}, 0, "examples/dynamic.lua"
    for file in output_of("ls examples/*.lua"):gmatch("%S+") do
      count = count + 1
      files[#files + 1] = (share.has(count) or file == dynamic)
        and ("%q"):format(file) or nil
    end
    assert.equal(dynamic .. ": goto: the machine has changed, new: "
      .. "root.resting -> root.dancing on e_music, new: root.dancing -> root.resting "
      .. "on e_done@root.dancing, new: state root.dancing\ndone",
      helper.output_of("FILES = { " .. table.concat(files, ", ")
      .. " }\nio.stderr = { write = function() end }\n" .. WANDER))
  end)
end)

it("random commands do what the same calls do, and back leads where it was", function()
  assert.is_nil(share.problem(require "spec.support.claims.sim", 3))
end)

it("the history is gone through: back, forward, goto, go_to in Lua", function()
  assert.equal(AT_HELLO .. "hello\nworld\n" .. AFTER
    .. AT_HELLO .. AFTER .. AT_NONE .. AFTER .. AT_HELLO
    .. "  >1                                  root.hello(done)\n"
    .. "   2                                  root.world(done)\n",
    said("step\nrun\nback\nforward\ngoto 0\ngoto 2\n"
      .. "if true then go_to(1) end\nhistory"))
end)

it("the history shows the timer that was the cause", function()
  local out = sim("-q examples/timeevent.lua", "clock 0\nnext\nhistory 2\n")
  assert.matches("%d  e_after%(60%)@root.lights +root.dark", out)
end)

describe("the Tab key", function()
  -- The completions of a word behind a text.
  local function completions(word, before, file, is_entered)
    local drive = require "spec.support.drive"
    local terminal = require "rfsm.sim.terminal"
    local prompt = drive.require "rfsm.sim.prompt"
    local opened = drive.require("rfsm.sim.session").open(
      file or "examples/on_off.lua", false)
    local complete
    if is_entered then rfsm.run(opened.fsm) end
    prompt.install(opened)
    opened.is_over = true
    helper.with(terminal, { new_reader = function(f) complete = f end },
      function() prompt.converse(opened) end)
    return complete(word, before)
  end

  for _, case in ipairs {
    { word = "", before = "ser ", words = { "e_push" } },
    { word = "e_p", before = "se(", words = { "e_push" } },
    { word = "o", before = "ses ", words = {} },
    { word = "o", before = "why ", words = {} },
    { word = "o", before = "breakpoint ", words = { "off", "on" } },
    { word = "se", before = "", words = { "se", "ser", "ses" } },
    { word = "fsm.of", before = "print(", words = { "fsm.off" } },
    { word = "rfsm.is_l", before = "", words = { "rfsm.is_leaf" } },
    { word = "s", before = "tree ", words = { "save", "se", "ser", "ses", "showeq",
      "showfqn", "step" } },
  } do
    it(("knows '%s' behind '%s'"):format(case.word, case.before), function()
      assert.same(case.words, completions(case.word, case.before))
    end)
  end

  local DOOR = [[
return rfsm.state {
  shut = rfsm.state {}, open = rfsm.state {}, jammed = rfsm.state {},
  check = rfsm.conn {},
  rfsm.trans { src = "initial", tgt = "shut" },
  rfsm.trans { src = "shut", tgt = "check", events = { "e_open", "e_done@root.open",
    function() end },
    guard = function() error("called") end },
  rfsm.trans { src = "check", tgt = "open", events = { "e_key" } },
  rfsm.trans { src = "open", tgt = "shut", events = { "e_shut" } },
  rfsm.trans { src = "open", tgt = "jammed", events = { "e_jam" } },
  warn = false, info = false,
}]]

  for _, case in ipairs {
    { word = "", before = "ser ", words = { "e_key", "e_open" } },
    { word = "e_o", before = "se e_shut ", words = { "e_open" } },
    { word = "e_s", before = "ses ", words = { "e_shut" } },
    { word = "", before = "why ", words = { "e_jam", "e_key", "e_open", "e_shut" } },
    { word = "e_", before = "breakpoint ", words = { "e_jam", "e_key", "e_open",
      "e_shut" } },
    { word = "fsm.o", before = "breakpoint shut if ", words = { "fsm.open" } },
  } do
    it(("offers for '%s' behind '%s' what matters"):format(case.word, case.before),
      function()
        local file = file_with(DOOR)
        assert.same(case.words, completions(case.word, case.before, file, true))
      end)
  end

  it("offers all events as long as the machine is not entered", function()
    assert.same({ "e_jam", "e_key", "e_open", "e_shut" },
      completions("e_", "ser ", file_with(DOOR), false))
  end)
end)

it("the tree has 12 siblings of an active state, and counts the others", function()
  local names = {}
  for i = 1, 15 do names[i] = ("s%02d = rfsm.state {}"):format(i) end
  local out = sim("-q " .. file_with("return rfsm.state { warn = false, info = false, "
    .. table.concat(names, ", ") .. ", rfsm.trans { src = 'initial', tgt = 's14' } }"),
    "step\ntree\n")
  assert.matches("\n    s12\n  %* s14 %(done%)\n    and 2 more\n$", out)
end)

describe("a picture", function()
  it("in another format is laid out by Graphviz", function()
    local file = file_with("") .. ".svg"
    local out = sim("-q " .. HELLO, "view " .. file .. "\nstep\n")
    assert.equal(AT_HELLO, out)
    local text = content(file)
    os.remove(file)
    assert.matches('id="root.hello"', text, 1, true)
    assert.matches("</svg>", text)
  end)

  it("in the format of Graphviz needs no Graphviz", function()
    local file = file_with("") .. ".DOT"
    sim("-q " .. HELLO, "view " .. file .. "\n")
    local text = content(file)
    os.remove(file)
    assert.equal(require("rfsm.dot").encode(helper.init(rfsm.load(HELLO))), text)
  end)

  it("is kept up to date, in the format of its ending", function()
    local file = file_with("") .. ".dot"
    local out = sim("-q " .. HELLO, (("view F\nos.remove('F')\nstep\n"
      .. "os.remove('F')\nview(false)\nrun\nio.open('F')\n"):gsub("F", file)))
    assert.equal("true\n" .. AT_HELLO .. "true\nhello\nworld\n"
      .. "active: root.world(done)\nqueue:  \n" .. "nil\t" .. file
      .. ": No such file or directory\t2\n", out)
  end)
end)

describe("a recording", function()
  local function recorded(chart, input)
    local name = file_with("")
    sim("-q " .. chart, "record " .. name .. "\n" .. input)
    return name
  end

  it("is replayed, with the chart's functions or without", function()
    local name = recorded("examples/emem.lua", "run\nser e_wrong\nser e_wrong\n")
    local out, complaints, status = sim("-q --replay " .. name
      .. " -e 'ser e_wrong' -e 'history 1' examples/emem.lua")
    assert.same({ "", 0 }, { complaints, status })
    assert.matches("closed\nreplayed %d+ iterations of " .. name .. "\nactive: "
      .. "root.closed%(done%)\nqueue:  \n.*active: root.locked%(done%)\n", out)
    out = sim("-q --dry --replay " .. name .. " -e 'ser e_wrong' examples/emem.lua")
    assert.is_nil(out:find("\nclosed\n"))
  end)

  it("that has ended stays as it is when the session begins anew", function()
    local name = recorded(HELLO, "run\nrecord(false)\nreload\n")
    assert.equal(1, select(2, content(name):gsub('"file"', "")))
  end)

  it("of a fleet is a machine with its history, which can be saved", function()
    local file, chart = helper.file_with(""), helper.file_with [[
      return rfsm.state { keep = { "n" }, n = 0, warn = false, info = false,
        a = rfsm.state {}, b = rfsm.state { entry = function() error "not called" end },
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = { "e_b", "e_after(60)" } } }]]
    require "rfsm_timeevent"
    local snap = snapshot.take(helper.init(rfsm.load(chart)))
    snap.leaf, snap.done, snap.data = "root.b", true, { root = { n = 7 } }
    snap.fleet = { machine = "m:{0}:1", chart = "c", revision = 5, history = {
      { time = 0, event = "e_old", from = "root.gone", to = "root.a" },
      { time = 0, event = "", from = "", to = "root.a" },
      { time = 60.5, event = '{"name":"e_b","n":1}', from = "root.a",
        to = "root.b" } } }
    assert(snapshot_file.write(file, snap))
    local out, complaints, status = sim("-q --from " .. file .. " " .. chart,
      "history\nback\nprint(fsm.n)\nhistory 1\ndry\nwhy e_b\n"
      .. "dry(false)\nback\nforward 2\nforward\nwhy e_b\n"
      .. "save " .. file .. "\n")
    assert.same({ "", 0 }, { complaints, status })
    assert.equal([[
m:{0}:1: 2 moves in its history ('back' goes there)
active: root.b(done)
queue:
   1  1970-01-01 00:00:00             root.a(done)
   2  1970-01-01 00:01:00 e_b{n=1}    root.b(done)
  >1  1970-01-01 00:00:00             root.a(done)
with the data of now, not those of this move:
active: root.a(done)
queue:
7
  >1  1970-01-01 00:00:00             root.a(done)
   2  1970-01-01 00:01:00 e_b{n=1}    root.b(done)
dry: guards are not asked, each lets pass
with the data of now, not those of this move:
root.trans[2] (a -> b) would be taken on e_b in root.a
  root.trans[2] (a -> b): would be taken
active: <none>
queue:  e_init_fsm
   2  1970-01-01 00:01:00 e_b{n=1}    root.b(done)
active: root.b(done)
queue:
forward: this is the last advance
   2  1970-01-01 00:01:00 e_b{n=1}    root.b(done)
active: root.b(done)
queue:
no transition would be taken on e_b in root.b
]], (out:gsub("queue:  \n", "queue:\n")))
    local saved = snapshot_file.read(file)
    assert.same({ machine = "m:{0}:1", chart = "c", revision = 5 }, saved.fleet)
    assert.same({ root = { "%t", "n", 7 } }, saved.data)
    assert.equal("state root", saved.structure[1]) -- for a chart that has changed
    helper.write(file, helper.content(file):sub(1, 50))
    out, complaints, status = sim("-q --from " .. file .. " " .. chart)
    assert.same({ "", 2 }, { out, status })
    assert.matches("^rfsm sim: " .. file .. ": no JSON: [^\n]*\n$", complaints)
    snap.chart, snap.fleet = "1-2", { chart = "job" }
    assert(snapshot_file.write(file, snap))
    complaints = select(2, sim("-q --from " .. file .. " " .. chart))
    assert.matches(": a machine of chart 'job': rfsm.snapshot: the snapshot is of "
      .. "another chart:\n.*the chart of its time is needed: sim and web take that "
      .. "file", complaints)
  end)

  it("of a fleet says that the past of regions is not known", function()
    local file, chart = helper.file_with(""), helper.file_with [[
      local rfsm = require "rfsm"
      return rfsm.state { warn = false, info = false, b = rfsm.state {},
        s = rfsm.seqand { r = rfsm.state { a = rfsm.state {},
          rfsm.trans { src = "initial", tgt = "a" } } },
        rfsm.trans { src = "initial", tgt = "s" },
        rfsm.trans { src = "s", tgt = "b", events = { "e_b" } } }]]
    local snap = snapshot.take(helper.init(rfsm.load(chart)))
    snap.leaf, snap.done = "root.b", true
    snap.fleet = { history = { { time = 0, event = "", from = "", to = "root.s" },
      { time = 9, event = "e_b", from = "root.s", to = "root.b" } } }
    assert(snapshot_file.write(file, snap))
    assert.matches("\nwith the data of now, not those of this move; where its regions "
      .. "were is not known:\nroot.trans%[2%] %(s %-> b%) would be taken",
      (sim("-q --from " .. file .. " " .. chart, "back\nwhy e_b\n")))
    local out = sim("-q --from " .. file .. " " .. chart,
      "back\nser e_x\nwhy e_b\nback\nforward\nevents\nreload\nwhy e_b\n")
    assert.equal(6, select(2, out:gsub("; where its regions were is not known:", "")))
    assert.matches("\nactive: root.s%(active%)\n", out)
  end)

  it("of a fleet has data and regions of then, if the history has them", function()
    local file, chart = helper.file_with(""), helper.file_with [[
      local rfsm = require "rfsm"
      require "rfsm.emem"
      return rfsm.state { warn = false, info = false, keep = { "n" }, n = 0,
        b = rfsm.state {},
        s = rfsm.seqand { r = rfsm.state { a = rfsm.state {}, z = rfsm.state {},
          rfsm.trans { src = "initial", tgt = "a" },
          rfsm.trans { src = "a", tgt = "z", events = { "e_z" } } } },
        rfsm.trans { src = "initial", tgt = "s" },
        rfsm.trans { src = "s", tgt = "b", events = { "e_b" } } }]]
    local fsm = helper.init(rfsm.load(chart))
    rfsm.run(fsm)
    fsm.n = 3
    rfsm.send_events(fsm, "e_z")
    rfsm.run(fsm)
    local then_of = snapshot.take(fsm)
    fsm.n = 4
    rfsm.send_events(fsm, "e_b")
    rfsm.run(fsm)
    local snap = snapshot.take(fsm)
    snap.fleet = { history = {
      { time = 0, event = "", from = "", to = "root.s" },
      { time = 5, event = "e_z", from = "root.s", to = "root.s", snap = then_of },
      { time = 9, event = "e_b", from = "root.s", to = "root.b" } } }
    assert(snapshot_file.write(file, snap))
    assert.equal([[
FILE: 3 moves in its history ('back' goes there)
active: root.b(done)
queue:
  >2  1970-01-01 00:00:05 e_z         root.s(active)
active: root.s(active)
queue:
3	root.z
  >1  1970-01-01 00:00:00             root.s(active)
with the data of now, not those of this move; where its regions were is not known:
active: root.s(active)
queue:
4
]], (sim("-q --from " .. file .. " " .. chart, "back\n"
      .. "print(fsm.n, rfsm.get_actleaf_fqn(rfsm.regions(fsm.s)[1]))\n"
      .. "back\nprint(fsm.n)\n"):gsub("queue:  \n", "queue:\n")
      :gsub("^[^:]*", "FILE", 1)))
  end)

  it("of a chart that behaves otherwise now is replayed up to there", function()
    local name = recorded(HELLO, "run\n")
    local text = content(name):gsub(',"sum":"%x+"}', "}")
    text = text:gsub('"leaf":"root.world"', '"leaf":"root.hello"', 1)
    local out, complaints, status = sim("-q -r " .. file_with(text) .. " -e events "
      .. HELLO)
    assert.equal(0, status)
    assert.matches("^rfsm sim: %S+: step 2: active leaf root.hello%(done%) expected, "
      .. "got root.world%(done%)\n$", complaints)
    assert.matches("replayed 1 iterations of", out)
  end)

  -- a --e_go--> b, and what a mended chart has besides
  local function chart(more)
    return file_with([[
      local rfsm = require "rfsm"
      local count = 0
      return rfsm.state { info = false, warn = false,
        a = rfsm.state {}, b = rfsm.state {}, ]] .. (more or "") .. [[
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = { "e_go" },
          guard = function() return true end },
        rfsm.trans { src = "b", tgt = "a", events = { "e_go" } },
      }]])
  end

  it("of a failure runs through the mended chart up to the first difference",
  function()
    local name = recorded(chart(), "run\nser e_go\nser e_go\nser e_go\n")
    local out, complaints, status = sim("-q -r " .. name .. " -e showfqn "
      .. chart("c = rfsm.state {}, rfsm.trans { src = 'c', tgt = 'a', "
        .. "guard = function() end },"))
    assert.same({ "", 0 }, { complaints, status })
    assert.matches("replayed %d iterations.*active: root.b%(done%)\n$", out)
    out, complaints = sim("-q -r " .. name .. " -e showfqn "
      .. chart("c = rfsm.state {}, rfsm.trans { src = 'b', tgt = 'c', pn = 1, "
        .. "events = { 'e_go' } },"))
    assert.matches("step 5: active leaf root.a%(done%) expected, got root.c%(done%)\n$",
      complaints)
    assert.matches("replayed 4 iterations.*active: root.b%(done%)\n$", out)
  end)

  it("that was cut off is replayed up to there, and says so", function()
    local name = recorded(chart(), "run\nser e_go\n")
    local out, complaints = sim("-q -r " .. file_with(content(name):sub(1, -3))
      .. " -e showfqn " .. chart())
    assert.matches("^rfsm sim: %S+: the last line was cut off\n$", complaints)
    assert.matches("active: root.b%(done%)\n$", out)
  end)

  it("in a file that has one is the last run there, which is replayed", function()
    local name = recorded(chart(), "run\nser e_go\n")
    sim("-q -e 'record " .. name .. "' -e run " .. chart())
    assert.same({ 2, "active: root.a(done)" }, {
      select(2, content(name):gsub('"file"', "")),
      sim("-q -r " .. name .. " -e showfqn " .. chart()):match("\n(active: %S+)\n") })
  end)

  it("is no help to a chart whose data cannot be saved, nor made of one", function()
    local name = recorded(chart(), "run\n")
    local kept = content(name)
    assert.equal("rfsm sim: record: root.x: a function cannot be saved\n",
      (select(2, sim("-q -e 'record " .. name .. "' "
        .. chart("keep = { 'x' }, x = print,")))))
    assert.equal(kept, content(name))
    assert.same({ "", "rfsm sim: root.x: a function cannot be saved\n", 1 },
      { sim("-q -r " .. name .. " " .. chart("keep = { 'x' }, x = print,")) })
  end)

  it("that is none is refused", function()
    local _, complaints, status = sim("-q -r /no/file " .. HELLO)
    assert.equal("rfsm sim: /no/file: No such file or directory\n",
      complaints)
    assert.equal(2, status)
    _, complaints, status = sim("-q -r Makefile " .. HELLO)
    assert.matches("^rfsm sim: [^\n]*Makefile[^\n]*\n$", complaints)
    assert.equal(1, status)
  end)
end)

describe("a session with regions, timers, guards and data", function()
  local CHART = [[
local rfsm = require "rfsm"
require "rfsm_timeevent"
local function arm()
  return rfsm.init(rfsm.state { info = false, warn = false,
    open = rfsm.state {}, shut = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "open" },
    rfsm.trans { src = "open", tgt = "shut", events = { "e_grasp" } } })
end
is_open = false
return rfsm.state { warn = false, info = false, keep = { "n" }, n = 0,
  idle = rfsm.state { entry = function(fsm) fsm.n = fsm.n + 1 end },
  arms = rfsm.seqand { left = arm(), right = arm() },
  work = rfsm.state { doo = function() while true do rfsm.yield(true) end end },
  rfsm.trans { src = "initial", tgt = "idle" },
  rfsm.trans { src = "idle", tgt = "arms", events = { "e_go" } },
  rfsm.trans { src = "arms", tgt = "idle", events = { "e_back" } },
  rfsm.trans { src = "idle", tgt = "work", events = { "e_work" },
    guard = function() return is_open end },
  rfsm.trans { src = "work", tgt = "idle", events = { "e_after(5)" } },
}]]

  -- A text with one line for the active state and the queue, without blanks at the ends
  -- of lines: "at root.idle(done)  e_go".
  local function brief(text)
    return (text:gsub("active: (%S+)\nqueue:", "at %1"):gsub(" +\n", "\n"))
  end

  for _, case in ipairs {
    { does = "stops in a region and at an event, until the breakpoint is deleted",
      input = [=[
run
breakpoint arms.left.shut
breakpoint e_grasp
ser e_go
ser e_grasp
ser e_back
breakpoint
delete 1
breakpoint
]=],
      output = [[
at root.idle(done)
1  state root.arms.left.shut
2  event e_grasp
at root.arms(active)
at root.arms(active)
stopped at 1: state root.arms.left.shut
stopped at 2: event e_grasp
at root.idle(done)
1  state root.arms.left.shut
2  event e_grasp
1  event e_grasp
]] },
    { does = "shows what regions take",
      input = [=[
follow(true)
run
ser e_go
ser e_grasp
]=],
      output = [[
taken:  root.initial -> root.idle
* root
    arms ...
  * idle (done)
    work
at root.idle(done)
taken:  root.idle -> root.arms on e_go
taken:  root.arms.left.initial -> root.arms.left.open
taken:  root.arms.right.initial -> root.arms.right.open
* root
  * arms
    * left
      * open (done)
        shut
    * right
      * open (done)
        shut
    idle
    work
at root.arms(active)
taken:  root.arms.left.open -> root.arms.left.shut on e_grasp
taken:  root.arms.right.open -> root.arms.right.shut on e_grasp
* root
  * arms
    * left
        open
      * shut (done)
    * right
        open
      * shut (done)
    idle
    work
at root.arms(active)
]] },
    { does = "keeps the time of each place on the way back and forward",
      input = [=[
clock 0
is_open = true
ser e_work
clock 3
back
clock
clock 1
back 2
clock
forward 1
clock
next
fsm.n
clock(false)
clock
]=],
      output = [[
clock:  0 s
at root.idle(done)
at root.work(active)
clock:  3 s
at root.work(active)
at root.work(active)
clock:  0 s
clock:  1 s
at root.work(active)
at root.idle(done)
clock:  0 s
at root.work(active)
clock:  0 s
clock:  5 s
at root.idle(done)
2
clock:  real time
]] },
    { does = "says what events would do",
      input = [=[
run
events
why e_work
why
ser e_go
events
]=],
      output = [[
at root.idle(done)
e_go
no transition would be taken on e_work in root.idle
  root.trans[2] (idle -> arms): waits for e_go
  root.trans[4] (idle -> work): its guard returns false
no transition would be taken without an event in root.idle
  root.trans[2] (idle -> arms): waits for e_go
  root.trans[4] (idle -> work): waits for e_work
at root.arms(active)
e_back
e_grasp
]] },
    { does = "leaves the functions of the chart out, then has them again",
      input = [=[
dry(true)
run
ser e_work
se e_done
run
dry(false)
reset
run
ser e_work
fsm.n
]=],
      output = [[
at root.idle(done)
at root.work(active)
queue:  e_done@root.work
at root.work(active)
at <none>  e_init_fsm
at root.idle(done)
at root.idle(done)
1
]] },
    { does = "lists as much of the history as is wanted",
      input = [=[
run
for i = 1, 24 do ses('e_back') end
print '~'
history 2
history 0
goto 3
history 3
]=],
      output = [[
  24  e_back                          root.idle(done)
  25  e_back                          root.idle(done)
at root.idle(done)
   1                                  root.idle(done)
   2  e_back                          root.idle(done)
  >3  e_back                          root.idle(done)
   4  e_back                          root.idle(done)
   5  e_back                          root.idle(done)
   6  e_back                          root.idle(done)
]] },
  } do
    it(case.does, function()
      local out, complaints = sim("-q " .. file_with(CHART), case.input)
      assert.equal("", complaints)
      assert.equal(case.output, brief(out:match("~\n(.*)") or out))
    end)
  end
end)

describe("an option", function()
  it("-e runs code and ends, in order, up to the first failure", function()
    local out, complaints, status = sim("-e 'step()' -e '1, 2' " .. HELLO, "step()")
    assert.same({ INFO .. AT_HELLO .. "1\t2\n", "", 0 }, { out, complaints, status })
    out, complaints, status = sim("-e 'error(1, 0)' -e 'step()' " .. HELLO)
    assert.same({ INFO, "rfsm sim: 1\n", 1 }, { out, complaints, status })
    out, complaints, status = sim("-i -e 'quit()' -e 'print(1)' " .. HELLO, "2")
    assert.same({ INFO, "", 0 }, { out, complaints, status })
  end)

  it("-i reads commands after -e", function()
    assert.equal(INFO .. AT_HELLO .. BANNER .. "2\n",
      (sim("-i -e 'step()' " .. HELLO, "1 + 1")))
  end)

end)

describe("a chart that cannot be used", function()
  local function refused(text, expected)
    local file = text and file_with(text) or "no/such.lua"
    local out, complaints, status = sim(file, "step()")
    assert.same({ "", expected or 1 }, { out, status })
    return (complaints:gsub(file:gsub("%p", "%%%0"), "CHART"))
  end

  it("is reported in one line", function()
    assert.equal("rfsm sim: CHART: No such file or directory\n", refused(nil, 2))
  end)

  it("is reported with each of its problems, a line each", function()
    assert.matches("^CHART:3: warning: undefined global 'e_go' [^\n]*\n"
      .. "rfsm sim: CHART:3: root.trans%[1%][^\n]* tgt 'b': [^\n]*\n"
      .. "rfsm sim: CHART:4: root.trans%[2%][^\n]* tgt 'aa': [^\n]*\n$", refused([[
return rfsm.state {
  a = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "b", events = e_go },
  rfsm.trans { src = "a", tgt = "aa" },
}]]))
  end)
end)

describe("the tool", function()
  it("tells which module it misses", function()
    local path = file_with("")
    -- tools/lua5.5 adds folders to LUA_PATH
    local _, complaints, status = run(("LUA_INIT=\"package.path = './?.lua'\" LUA=%s "
      .. "tools/rfsm-sim %s"):format(LUA, path))
    assert.same({ "rfsm: the package argparse is missing (on Debian: apt-get "
      .. "install lua-argparse)\n", 1 }, { complaints, status })
  end)
end)

describe("an advance", function()
  it("may be asked for with texts and other words", function()
    local out = sim("-q " .. HELLO, "se 'e_a' 5\n")
    assert.matches("queue:  e_init_fsm, e_a, 5\n", out, 1, true)
  end)

  it("discards no event that is pending again", function()
    local chart = file_with([[
      return rfsm.state { info = false, warn = false, a = rfsm.state {},
        b = rfsm.state { entry = function(fsm) rfsm.send_events(fsm, "e_x") end },
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = { "e_go" } } }]])
    local out = sim("-q " .. chart, "run\nfollow()\nses e_y e_x e_go\n")
    assert.matches("discarded: e_y (", out, 1, true)
  end)

  it("has the simulated time of its end, also after back", function()
    local out = sim("-q examples/timeevent.lua",
      "clock 0\nclock 0.5\nback\nclock\nforward\nclock\nback\ngoto 2\nclock\n")
    local times = {}
    for time in out:gmatch("clock:  ([%d.]+) s") do times[#times + 1] = time end
    assert.same({ "0", "0.5", "0", "0.5", "0.5" }, times)
  end)

  it("has that time also after goto", function()
    local out = said("clock 0\nse e_restart\nclock 1\nse e_restart\nclock 1\n"
      .. "goto 2\nclock\ngoto 1\nclock\ngoto 0\nclock\n")
    local times = {}
    for time in out:gmatch("clock:  ([%d.]+) s") do times[#times + 1] = time end
    assert.same({ "0", "1", "2", "1", "0", "0" }, times)
  end)
end)
