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
  return run("LUA=" .. LUA .. " tools/rfsm-sim " .. arguments, input)
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

  it("takes several commands from one line, the last without a newline", function()
    assert.equal(AT_HELLO .. "hello\nworld\n" .. AT_WORLD, said("step() step()"))
  end)

  it("is found by the shell with any Lua", function()
    local out, complaints, status = run("tools/rfsm-sim -q " .. HELLO, "step()")
    assert.same({ INFO .. AT_HELLO, "", 0 }, { out, complaints, status })
  end)

  it("runs from another directory and through a link", function()
    local link = file_with("")
    os.remove(link)
    local out = run("here=$PWD; cd / && ln -s $here/tools/rfsm-sim " .. link .. " && "
      .. link .. " -q $here/" .. HELLO, "step()")
    assert.equal(INFO .. AT_HELLO, out)
  end)
end)

describe("a command", function()
  it("step advances by as much as it is told", function()
    assert.equal(AT_END, said("step(3)"))
  end)

  it("run goes on until nothing is left", function()
    assert.equal(AT_END, said("run()"))
  end)

  it("se sends and shows the queue", function()
    assert.equal("queue:  e_init_fsm, e_a, 1, true\n", said('se("e_a", nil, 1, true)'))
  end)

  it("showeq shows the queue", function()
    assert.equal("queue:  e_init_fsm\n", said("showeq()"))
  end)

  it("ses sends and steps", function()
    assert.equal(AT_END .. AT_HELLO, said('run() ses("e_restart")'))
  end)

  it("ser sends and runs", function()
    assert.equal(AT_END .. AT_END, said('run() ser("e_restart")'))
  end)

  it("showfqn shows the active leaf", function()
    assert.equal("active: <none>\n" .. AT_HELLO .. "active: root.hello(done)\n",
      said("showfqn() step() showfqn()"))
  end)

  it("dbg(true) shows the main records, dbg(false) none", function()
    local out = said("dbg(true) step() dbg(false) step()")
    assert.matches("STATE_ENTER%s+root%.hello\n", out)
    assert.is_nil(out:find("TRANSITION", 1, true))
    assert.is_nil(out:find("STATE_ENTER[^\n]*root.world"))
  end)

  it("dbg('full') shows every record", function()
    local out = said("dbg('full') step()")
    assert.matches("TRANSITION%s+events: e_init_fsm\n", out)
    assert.matches("STATE_ENTER%s+root%.hello\n", out)
  end)

  it("dbg says what it expects", function()
    assert.equal("dbg: false, true or 'full' expected, got string 'fool'\n",
      complaint("dbg('fool')"))
  end)

  it("pp shows each state with its mode", function()
    assert.equal(AT_HELLO .. "root[CS] active\n  hello[LS] done\n"
      .. "  world[LS] inactive\n", said("step() pp()"))
  end)

  it("add_hook has a function called after each advance", function()
    assert.equal(AT_HELLO .. "hook true\n" .. "queue:  e_done@root.hello\n",
      said("add_hook(function(f) print('hook', f == fsm) end) step() showeq()")
        :gsub("\t", " "))
  end)

  it("add_hook says what it expects", function()
    assert.equal("add_hook: function expected, got number\n", complaint("add_hook(1)"))
  end)

  it("quit ends the simulator after the line, or after -e", function()
    assert.equal("1\n2\n", said("print(1)\nquit() print(2)\nprint(3)\n"))
    local out, complaints, status = sim("-i -e 'quit()' -e 'print(1)' " .. HELLO, "2")
    assert.same({ INFO, "", 0 }, { out, complaints, status })
  end)

  it("help lists them all", function()
    local out = said("help()")
    local names = "step run se ses ser dbg pp showeq showfqn add_hook help quit"
    for name in names:gmatch("%S+") do
      assert.matches("%f[%w]" .. name .. "%(", out)
    end
  end)
end)

describe("the prompt", function()
  it("prints the value of an expression", function()
    assert.equal("hello world\nnil\nthree\n",
      said("'hello', 'world'\nnil\n= 'three'\n"):gsub("\t", " "))
  end)

  it("sees the machine, and the library", function()
    assert.equal("true\ntrue\n",
      said("fsm.hello == fsm.world._parent.hello\nrfsm.is_root(fsm)"))
  end)

  it("goes on in the next line when one is not complete", function()
    assert.equal("1\n2\n", said("for i = 1, 2 do\n  print(i)\nend\n"))
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

  it("gives an error one line and goes on", function()
    local out, complaints, status = sim("-q " .. HELLO, "error('no')\nstep()\n")
    assert.same({ INFO .. AT_HELLO, "stdin:1: no\n", 0 }, { out, complaints, status })
  end)

  it("gives an error that is no text one line", function()
    local nothing = _VERSION == "Lua 5.5" and "<no error object>" or "nil"
    assert.equal(nothing .. "\n", complaint("error()"))
    assert.matches("^table: %S+\n$", complaint("error({})"))
  end)

  it("leaves out the lines after the first", function()
    assert.equal("stdin:1: one\n", complaint("error('one\\ntwo')"))
    assert.matches("^[^\n]*module 'no.such' not found\n$",
      complaint("require 'no.such'"))
  end)

  it("tells a syntax error at its end", function()
    assert.matches("^stdin:1: [^\n]*near '=?'\n$", complaint("x = = 1\n"))
  end)

  it("tells what is not complete when the input ends", function()
    assert.matches("^stdin:%d: [^\n]*<eof>'?\n$", complaint("for i = 1, 2 do\n"))
  end)

  it("blames nobody's line for a bad argument of a command", function()
    assert.equal("rfsm.step: number of steps expected, got string 'x'\n",
      complaint("step('x')"))
  end)

  it("shows where a failed advance has led", function()
    local out, complaints = sim("-q " .. HELLO,
      "rfsm.post_step_hook_add(fsm, function() error('hook', 0) end)\nstep()\n")
    assert.same({ INFO .. AT_HELLO, "hook\n" }, { out, complaints })
  end)
end)

describe("an option", function()
  it("-e runs code and ends, in order", function()
    local out, complaints, status = sim("-e 'step()' -e '1, 2' " .. HELLO, "step()")
    assert.same({ INFO .. AT_HELLO .. "1\t2\n", "", 0 }, { out, complaints, status })
  end)

  it("-e ends with status 1 at an error", function()
    local out, complaints, status = sim("-e 'error(1, 0)' -e 'step()' " .. HELLO)
    assert.same({ INFO, "rfsm sim: 1\n", 1 }, { out, complaints, status })
  end)

  it("-i reads commands after -e", function()
    assert.equal(INFO .. AT_HELLO .. BANNER .. "2\n",
      (sim("-i -e 'step()' " .. HELLO, "1 + 1")))
  end)

  it("-q leaves the banner out", function()
    assert.equal(INFO, (sim("-q " .. HELLO)))
  end)

  it("--version tells the version", function()
    assert.same({ "rfsm 1.0.0\n", "", 0 }, { sim("--version") })
  end)

  it("--help tells them all", function()
    local out, _, status = sim("--help")
    assert.equal(0, status)
    for name in ("-e -i -q FILE --version"):gmatch("%S+") do
      assert.is_truthy(out:find(name, 1, true))
    end
  end)

  it("is asked for when there is no file", function()
    local _, complaints, status = sim("")
    assert.matches("^Usage: rfsm sim .*\nError: missing argument 'file'\n$",
      complaints)
    assert.equal(2, status)
  end)

  it("is asked for when an option is unknown", function()
    local out, complaints, status = sim("--bogus " .. HELLO)
    assert.matches("^Usage: rfsm sim .*\nError: unknown option '%-%-bogus'\n$",
      complaints)
    assert.same({ "", 2 }, { out, status })
  end)
end)

describe("a chart that cannot be used", function()
  local function refused(file)
    local out, complaints, status = sim(file, "step()")
    assert.same({ "", 1 }, { out, status })
    return complaints
  end

  it("is told when there is no such file", function()
    assert.equal("rfsm sim: cannot open no/such.lua: No such file or directory\n",
      refused("no/such.lua"))
  end)

  it("is told when it does not compile", function()
    local chart = file_with("return rfsm.state {\n  a = = 1\n}")
    assert.matches("^rfsm sim: [^\n]*:2: [^\n]*\n$", refused(chart))
  end)

  it("is told when it fails", function()
    local chart = file_with("require 'no.such.module'")
    assert.equal("rfsm sim: module 'no.such.module' not found\n",
      (refused(chart):gsub("[^ ]*:1: ", "")))
  end)

  it("is told when it returns no state", function()
    local chart = file_with("return {}")
    assert.equal("rfsm sim: no valid rfsm in file '" .. chart .. "' found.\n",
      refused(chart))
  end)

  it("is told with each of its problems, a line each", function()
    local chart = file_with([[
return rfsm.state {
  a = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "b" },
  rfsm.trans { src = "a", tgt = "aa" },
}]])
    local complaints = refused(chart):gsub(chart:gsub("%p", "%%%0"), "CHART")
    assert.equal("rfsm sim: CHART: root.trans[1]: tgt 'b': no state or connector is "
      .. "named 'b' in 'root' (there are 'a', 'initial')\n"
      .. "rfsm sim: CHART: root.trans[2]: tgt 'aa': no state or connector is "
      .. "named 'aa' in 'root' (did you mean 'a'?)\n", complaints)
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
