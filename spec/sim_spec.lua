-- The simulator as a person meets it: the tool runs as a process of its own, under the
-- Lua that runs this spec.

local helper = require "spec.helper"

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

local function sim(arguments, input)
  return run("TERM=dumb LUA=" .. LUA .. " tools/rfsm-sim " .. arguments, input)
end

-- What the prompt prints for `input`, with hello_world and no errors.
local function said(input)
  local out, complaints, status = sim("-q " .. HELLO, input)
  assert.equal("", complaints)
  assert.equal(0, status)
  assert.equal(INFO, out:sub(1, #INFO))
  return out:sub(#INFO + 1)
end

-- What it complains of.
local function complaint(input)
  local _, complaints, status = sim("-q " .. HELLO, input)
  assert.equal(0, status)
  return complaints
end

local AT_HELLO = "active: root.hello(done)\nqueue:  e_done@root.hello\n"
local AT_END = "hello\nworld\nactive: root.world(done)\nqueue:  \n"
local AT_WORLD = "active: root.world(done)\nqueue:  e_done@root.world\n"

after_each(helper.remove_files)

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

  it("runs from another directory, through a link, with any Lua", function()
    local link = file_with("")
    os.remove(link)
    local out = run("here=$PWD; cd / && ln -s $here/tools/rfsm-sim " .. link .. " && "
      .. link .. " -q $here/" .. HELLO, "step()")
    assert.equal(INFO .. AT_HELLO, out)
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
  ["run() reset() step()"] = AT_END .. "active: <none>\nqueue:  e_init_fsm\n"
    .. AT_HELLO,
  ["run()\nreload()\nfsm.hello\nstep()"] = AT_END .. INFO
    .. "active: root.world(done)\nqueue:  \nstate root.hello (inactive)\n"
    .. "active: root.world(done)\nqueue:  \n",
  ["'hello', 'world'\nnil\n= 'three'\n"] = "hello\tworld\nnil\nthree\n",
  ["rfsm.is_root(fsm)\nfsm\nfsm[1]"] = "true\nmachine, active: <none>\n"
    .. "T={ src='root.initial', tgt='root.hello' }\n",
  ["{ 1, 'a', x = { y = 2 }, [true] = fsm.world }, {}"] =
    '{ 1, "a", [true] = state root.world (inactive), x = { y = 2 } }\t{}\n',
  ["for i = 1, 2 do\n  print(i)\nend\n"] = "1\n2\n",
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
  ["step('x')"] = "rfsm.step: number of steps expected, got string 'x'\n",
  ["error('no')"] = "^stdin:%d+: no\n$", ["error('one\\ntwo')"] = "^stdin:%d+: one\n$",
  ["error()"] = _VERSION == "Lua 5.5" and "<no error object>\n" or "nil\n",
  ["error({})"] = "^table: %S+\n$", ["x = = 1\n"] = "^stdin:%d+: [^\n]*near '=?'\n$",
  ["require 'no.such'"] = "^[^\n]*module 'no.such' not found\n$",
}

describe("the prompt", function()
  -- All inputs go to one process, with a mark and a reset behind each.
  it("prints the result of each input", function()
    local inputs, text, i = {}, "", 0
    for input in pairs(SAID) do -- any order: each stands alone
      inputs[#inputs + 1] = input
      text = text .. input .. "\nio.write('~') rfsm.reset(fsm)\n"
    end
    for result in said(text):gmatch("([^~]*)~") do
      i = i + 1
      assert.equal(SAID[inputs[i]], result, inputs[i])
    end
    assert.equal(#inputs, i)
  end)

  it("complains of each mistake", function()
    local inputs, text, i, hints = {}, "", 0, pcall(require, "rfsm.advice")
    for input in pairs(COMPLAINTS) do -- any order: each stands alone
      inputs[#inputs + 1] = input
      text = text .. input .. "\nio.stderr:write('~')\n"
    end
    for result in complaint(text):gmatch("([^~]*)~") do
      i = i + 1
      local expected = COMPLAINTS[inputs[i]]
      if not hints then expected = expected:gsub(" %(did.*%)", "") end
      if expected:sub(1, 1) == "^" then
        assert.matches(expected, result)
      else
        assert.equal(expected, result)
      end
    end
    assert.equal(#inputs, i)
    assert.matches("^stdin:%d: [^\n]*<eof>'?\n$", complaint("for i = 1, 2 do\n"))
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
    local out = said("help()")
    for name in ("step run se ses ser events dbg pp showeq showfqn add_hook reset "
      .. "reload help quit"):gmatch("%S+") do
      assert.matches("%f[%w]" .. name .. "%(", out)
    end
    assert.equal(out, said("help"))
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
    assert.same({ INFO .. AT_HELLO .. "1\n", "hook\n" }, { out, complaints })
  end)
end)

-- A terminal: script(1) makes one of a pipe. Each line is typed half a second after the
-- one before; "^C" is Control-C.
local function at_terminal(chart, lines)
  local typed = {}
  for i, line in ipairs(lines) do
    typed[i] = "sleep 0.5; printf '" .. line:gsub("%^C$", "\\003") .. "'"
  end
  return (run(("{ (%s; sleep 0.5) | HOME=/nowhere TERM=dumb LUA=%s timeout 20 script "
    .. "-qefc 'tools/rfsm-sim %s' /dev/null; }"):format(table.concat(typed, "; "), LUA,
    chart)))
end

describe("Control-C", function()
  if not pcall(require, "luv") or not (os.execute("command -v script >/dev/null") == 0
    or os.execute("command -v script >/dev/null") == true) then
    return
  end

  it("drops a line, ends a run, and interrupts a doo, any number of times", function()
    local chart = file_with([[
return rfsm.state {
  warn = false, info = false,
  idle = rfsm.state {},
  busy = rfsm.state { doo = function() while true do rfsm.yield() end end },
  spin = rfsm.state { doo = function() while true do end end },
  rfsm.trans { src = "initial", tgt = "idle" },
  rfsm.trans { src = "idle", tgt = "busy", events = "e_busy" },
  rfsm.trans { src = "idle", tgt = "spin", events = "e_spin" },
  rfsm.trans { src = "busy", tgt = "idle", events = "e_stop" },
}]])
    local out = at_terminal(chart, {
      "print(1)^C", "print(2)^C", 'run() ser("e_busy")\\n', "^C",
      'ser("e_stop") ser("e_spin")\\n', "^C", "fsm\\n", "quit()\\n",
    })
    assert.is_nil(out:find("\n[12]\r"))
    assert.matches("active: root.busy%(active%)\r\n.*interrupted!\r\n.*"
      .. "active: root.idle%(done%)\r\n.*active: root.spin%(done%)\r\n.*"
      .. "interrupted!\r\n.*machine, active: root.spin\r\n", out)
  end)
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

  it("is explained, and asked for if it is missing or unknown", function()
    assert.same({ "rfsm 1.0.0\n", "", 0 }, { sim("--version") })
    local out = sim("--help")
    for name in ("-e -i -q FILE --version"):gmatch("%S+") do
      assert.is_truthy(out:find(name, 1, true))
    end
    for arguments, text in pairs { -- any order: each stands alone
      [""] = "missing argument 'file'", ["--bogus x"] = "unknown option '%-%-bogus'",
    } do
      local _, complaints, status = sim(arguments)
      assert.matches("^Usage: rfsm sim .*\nError: " .. text .. "\n$", complaints)
      assert.equal(2, status)
    end
  end)
end)

describe("a chart that cannot be used", function()
  local function refused(text)
    local file = text and file_with(text) or "no/such.lua"
    local out, complaints, status = sim(file, "step()")
    assert.same({ "", 1 }, { out, status })
    return (complaints:gsub(file:gsub("%p", "%%%0"), "CHART"))
  end

  it("is reported in one line", function()
    assert.equal("rfsm sim: cannot open CHART: No such file or directory\n", refused())
    assert.matches("^rfsm sim: CHART:2: [^\n]*\n$",
      refused("return rfsm.state {\n  a = = 1\n}"))
    assert.equal("rfsm sim: CHART:1: module 'no.such.module' not found\n",
      refused("require 'no.such.module'"))
    assert.matches("^rfsm sim: no valid rfsm in file 'CHART' found[^\n]*\n$",
      refused("return {}"))
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
    local _, complaints, status = run(("LUA_PATH='./?.lua' LUA_PATH_5_2='./?.lua' "
      .. "LUA_PATH_5_3='./?.lua' LUA_PATH_5_4='./?.lua' LUA=%s tools/rfsm-sim %s")
      :format(LUA, path))
    assert.same({ "rfsm: the package argparse is missing (luarocks install argparse; "
      .. "on Debian: apt-get install lua-argparse)\n", 1 }, { complaints, status })
  end)
end)
