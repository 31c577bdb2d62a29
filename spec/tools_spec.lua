-- The command line: rfsm check, viz, json, plantuml, dot, mermaid, and the tools of
-- their own names.

local lua = arg and arg[-1] or "lua5.1"
local folder

local function write_file(name, text)
  local handle = assert(io.open(folder .. "/" .. name, "wb"))
  handle:write(text)
  handle:close()
  return folder .. "/" .. name
end

local function content(file)
  local handle = assert(io.open(file, "rb"))
  local text = handle:read("*a")
  handle:close()
  return text
end

-- Runs a command line that begins with a tool: stdout, stderr and the status.
local function run(command)
  local err, status = folder .. "/stderr", folder .. "/status"
  local pipe = io.popen(("{ LUA=%s tools/%s; echo $? >'%s'; } 2>'%s'"):format(lua,
    command, status, err))
  local out = pipe:read("*a")
  pipe:close()
  return out, content(err), tonumber(content(status))
end

local function fails(command, expected, expected_status)
  local out, err, status = run(command)
  assert.same({ "", expected, expected_status or 1 }, { out, err, status })
end

-- The last line only: the usage stands before it.
local function refuses(command, expected)
  local out, err, status = run(command)
  assert.same({ "", expected, 2 }, { out, err:match("([^\n]*)\n$"), status })
end

local CHART = [[
local rfsm = require "rfsm"
return rfsm.state {
  a = rfsm.state {}, b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_go" } },
  rfsm.trans { src = "b", tgt = "a" },
}
]]

local BAD = [[
local rfsm = require "rfsm"
return rfsm.state {
  a = rfsm.state { entry = 7 },
  rfsm.trans { src = "initial", tgt = "aa" },
}
]]

setup(function()
  folder = os.tmpname()
  os.remove(folder)
  assert(os.execute("mkdir '" .. folder .. "'"))
end)

teardown(function() os.execute("rm -r '" .. folder .. "'") end)

-- The tools that write charts, and the command that each is.
local WRITERS = {
  { tool = "rfsm2json", command = "json", ending = "json" },
  { tool = "rfsm2plantuml", command = "plantuml", ending = "puml" },
  { tool = "rfsm-viz", command = "viz" },
  { tool = "rfsm dot", command = "dot", ending = "dot" },
  { tool = "rfsm mermaid", command = "mermaid", ending = "mmd" },
}

for _, writer in ipairs(WRITERS) do
  local name = "rfsm " .. writer.command
  local tool = writer.tool .. (writer.ending and " -o -" or "")

  describe(writer.tool, function()
    it("writes charts one after the other, without empty lines", function()
      local one = run(tool .. " examples/on_off.lua")
      local both, err, status = run(tool .. " examples/on_off.lua examples/on_off.lua")
      assert.equal(one .. one, both)
      assert.equal("", err)
      assert.equal(0, status)
      assert.is_falsy(both:find("\n\n", 1, true))
    end)

    it("writes to a file", function()
      local file = folder .. "/out.dot"
      assert.equal("", (run(writer.tool .. " examples/on_off.lua -o '" .. file .. "'")))
      assert.equal((run(tool .. " examples/on_off.lua")), content(file))
    end)

    if writer.ending then
      it("writes each chart to a file of its own", function()
        local a, b = write_file("a.lua", CHART), write_file("b.lua", CHART)
        local out, err, status = run(("%s '%s' '%s'"):format(writer.tool, a, b))
        assert.same({ "", "", 0 }, { out, err, status })
        for _, file in ipairs { a, b } do
          assert.equal((run(tool .. " '" .. file .. "'")),
            content((file:gsub("lua$", writer.ending))))
        end
      end)
    end

    it("reads stdin, also behind a #! line, and writes to stdout", function()
      local file = write_file("chart.lua", "#!/usr/bin/lua\n" .. CHART)
      local named = run(tool .. " '" .. file .. "'")
      local piped, err, status = run(writer.tool .. " - <'" .. file .. "'")
      assert.equal("", err)
      assert.equal(0, status)
      assert.equal(named:gsub(file:gsub("%p", "%%%0"), "stdin"), piped)
    end)

    it("keeps what the chart prints out of its output", function()
      local plain = write_file("chart.lua", CHART)
      local expected = run(tool .. " '" .. plain .. "'")
      write_file("chart.lua", "print('one', nil, 2) io.write('two\\n') "
        .. "io.stdout:write('three\\n')\n" .. CHART)
      local out, err = run(tool .. " '" .. plain .. "'")
      assert.equal(expected, out)
      assert.equal("one\tnil\t2\ntwo\nthree\n", err)
    end)

    it("is silent about the machines inside a state", function()
      local out, err = run(tool .. " examples/seqand.lua")
      assert.is_falsy(out:find("INFO", 1, true))
      assert.equal("", err)
    end)

    it("says every problem of a chart in a line", function()
      local file = write_file("bad.lua", BAD)
      local start = name .. ": " .. file .. ": "
      fails(tool .. " '" .. file .. "'", start
        .. "root.a.entry: function expected, got number 7\n" .. start
        .. "root.trans[1]: tgt 'aa': no state or connector is named 'aa' in 'root' "
        .. "(did you mean 'a'?)\n")
    end)

    it("says in one line why a file is no chart", function()
      local function case(text, expected)
        local file = write_file("no.lua", text)
        fails(tool .. " '" .. file .. "'", name .. ": "
          .. expected:gsub("FILE", file) .. "\n")
      end
      case("return 7", "no valid rfsm in file 'FILE' found.")
      case("error('no bus\\nat all')", "FILE:1: no bus")
      case("error('no bus', 0)", "FILE: no bus")
      case("error()", "FILE: failed without a message")
      case("error({})", "FILE: failed with a table")
      case("require 'no.such'", "FILE:1: module 'no.such' not found")
      case("error(setmetatable({}, { __tostring = error }))", "FILE: table")
      case("rfsm.preproc[1] = function() error('no', 0) end return rfsm.state {}",
        "FILE: no")
      fails(tool .. " - </dev/null", name .. ": no valid rfsm in stdin found.\n")
      fails(tool .. " '" .. folder .. "/none'", name .. ": cannot open " .. folder
        .. "/none: No such file or directory\n")
    end)

    it("writes nothing when one of several charts is wrong", function()
      local bad, out = write_file("bad.lua", "return 1"), folder .. "/both.dot"
      run(writer.tool .. " examples/on_off.lua '" .. bad .. "' -o '" .. out .. "'")
      assert.is_nil(io.open(out))
    end)

    it("says why it cannot write", function()
      fails(writer.tool .. " examples/on_off.lua -o /nowhere/x.dot", name
        .. ": /nowhere/x.dot: No such file or directory\n")
      fails(tool .. " examples/on_off.lua >/dev/full", name
        .. ": stdout: No space left on device\n")
    end)

    it("tells how to use it, with status 2 when it was not", function()
      refuses(writer.tool, "Error: missing argument 'files'")
      refuses(writer.tool .. " --bogus x", "Error: unknown option '--bogus'")
      local out, _, status = run(writer.tool .. " --help")
      assert.matches("Usage: " .. name, out)
      assert.equal(0, status)
    end)

    it("tells its version", function()
      assert.equal("rfsm 1.0.0\n", (run(writer.tool .. " --version")))
    end)

    it("runs by a symbolic link from anywhere", function()
      local file, arguments = tool:match("^(%S+)(.*)$")
      local link = folder .. "/link"
      os.execute(("ln -sf \"$PWD/tools/%s\" '%s'"):format(file, link))
      local command = "f=$PWD/examples/on_off.lua; cd / && '%s'%s \"$f\" 2>&1"
      local pipe = io.popen(command:format(link, arguments))
      local out = pipe:read("*a")
      pipe:close()
      assert.is_truthy(out:find("e_push", 1, true))
    end)
  end)
end

describe("rfsm2json", function()
  it("names the package to install if dkjson is missing", function()
    local real = lua
    lua = "'" .. lua .. "' LUA_INIT='package.preload.dkjson = function() error(0) end'"
    fails("rfsm2json -o - examples/on_off.lua", "rfsm json: examples/on_off.lua: the "
      .. "package dkjson is missing (on Debian: apt-get install lua-dkjson)\n")
    lua = real
  end)
end)

describe("rfsm-viz", function()
  local function starts(command, expected)
    local out, err, status = run("rfsm-viz examples/on_off.lua " .. command)
    assert.same({ expected, "", 0 }, { out:sub(1, #expected), err, status })
  end

  it("writes each of its formats", function()
    starts("", 'digraph "examples/on_off.lua" {')
    starts("-T dot", 'digraph "examples/on_off.lua" {')
    starts("-T plantuml", "@startuml\ntitle examples/on_off.lua\n")
    starts("-T mermaid", '---\ntitle: "examples/on_off.lua"\n---\nstateDiagram-v2\n')
    starts("-T svg", "<?xml")
    starts("-T png", "\137PNG\r\n")
    starts("-T pdf", "%PDF-1")
  end)

  it("lists its formats", function()
    assert.is_truthy(run("rfsm-viz --help"):gsub("%s+", " "):find("-T FORMAT, "
      .. "dot, svg, png, pdf, plantuml, mermaid", 1, true))
  end)

  it("tells the format by the name of the output", function()
    for ending, expected in pairs { -- any order: each stands alone
      svg = "<?xml", PNG = "\137PNG", pdf = "%PDF", gv = "digraph", dot = "digraph",
      puml = "@startuml", mmd = "---\n",
    } do
      local file = folder .. "/chart." .. ending
      local _, err = run("rfsm-viz examples/on_off.lua -o '" .. file .. "'")
      assert.equal("", err)
      assert.equal(expected, content(file):sub(1, #expected))
    end
  end)

  it("refuses formats that it does not know, with the list", function()
    refuses("rfsm-viz examples/on_off.lua -T gif", "Error: argument for option '-T' "
      .. "must be one of 'dot', 'svg', 'png', 'pdf', 'plantuml', 'mermaid'")
    refuses("rfsm-viz examples/on_off.lua -o x.gif", "Error: the ending of 'x.gif' "
      .. "is no format, -T expected (dot, svg, png, pdf, plantuml, mermaid)")
  end)

  it("refuses several charts in a picture", function()
    refuses("rfsm-viz -T svg examples/on_off.lua examples/on_off.lua",
      "Error: one FILE expected, svg holds one chart, got 2")
  end)

  it("says what to install when Graphviz is missing", function()
    local real = lua
    local path = io.popen("command -v '" .. lua .. "'"):read("*l")
    local bin = folder .. "/bin"
    os.execute(("mkdir '%s' && ln -s $(command -v readlink) $(command -v dirname) '%s'")
      :format(bin, bin))
    lua = path .. " PATH='" .. bin .. "'"
    fails("rfsm-viz examples/on_off.lua -T svg", "rfsm viz: Graphviz is missing "
      .. "(on Debian: apt-get install graphviz)\n")
    lua = real
  end)

  it("says what Graphviz says", function()
    write_file("dot", "#!/bin/sh\necho 'out of ink' >&2\nexit 3\n")
    os.execute("chmod +x '" .. folder .. "/dot'")
    local real = lua
    lua = lua .. " PATH='" .. folder .. "':\"$PATH\""
    fails("rfsm-viz examples/on_off.lua -T svg", "rfsm viz: dot: out of ink\n")
    lua = real
    os.remove(folder .. "/dot")
  end)
end)

-- luacheck: push no max line length
describe("rfsm-check", function()
  local function checks(command, expected, expected_status)
    local out, err, status = run("rfsm-check " .. command)
    assert.same({ expected, "", expected_status }, { out, err, status })
  end

  local WARNED = "examples/checks.lua: warning: root.spare: unreachable, no path of "
    .. "transitions leads here\n"

  it("says ok to a chart without problems", function()
    checks("examples/on_off.lua examples/seqand.lua",
      "examples/on_off.lua: ok\nexamples/seqand.lua: ok\n", 0)
    checks("- <examples/on_off.lua", "stdin: ok\n", 0)
  end)

  it("tells every problem, with status 1", function()
    local file = write_file("bad.lua", BAD)
    checks("'" .. file .. "' examples/on_off.lua", (([[
FILE: root.a.entry: function expected, got number 7
FILE: root.trans[1]: tgt 'aa': no state or connector is named 'aa' in 'root' (did you mean 'a'?)
examples/on_off.lua: ok
]]):gsub("FILE", file)), 1)
    file = write_file("no.lua", "return 7")
    checks("'" .. file .. "'", "no valid rfsm in file '" .. file .. "' found.\n", 1)
  end)

  it("tells warnings, with status 0", function()
    checks("examples/checks.lua", WARNED, 0)
  end)

  it("takes a warning for a problem when it is strict", function()
    checks("--strict examples/checks.lua", WARNED, 1)
    checks("-s examples/on_off.lua", "examples/on_off.lua: ok\n", 0)
  end)

  it("says nothing when it is quiet", function()
    checks("--quiet examples/checks.lua examples/on_off.lua", "", 0)
    checks("-q -s examples/checks.lua", "", 1)
  end)

  it("tells the warnings of init, and those of extensions' problems", function()
    local file = write_file("warned.lua", [[
      local rfsm = require "rfsm"
      require "rfsm_timeevent"
      return rfsm.state {
        a = rfsm.state {}, b = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a", events = "e_init_fsm" },
        rfsm.trans { src = "a", tgt = "b", event = "e_x" },
        rfsm.trans { src = "b", tgt = "a" },
      }
    ]])
    checks("'" .. file .. "'", (([[
FILE: warning: root.initial: each transition from here has events or a guard, 'root' cannot be entered while none of them is enabled
FILE: warning: root.trans[2]: a transition has no field 'event' (did you mean 'events'?)
]]):gsub("FILE", file)), 0)
  end)

  it("knows time events and await, also when the host of a chart loads them", function()
    local file = write_file("timed.lua", [[
      local rfsm = require "rfsm"
      return rfsm.state {
        a = rfsm.state {}, b = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = { "e_after(x)", "e_after(2)" } },
        rfsm.trans { src = "b", tgt = "a", events = { "await()", "await(e_a)" } },
      }
    ]])
    checks("'" .. file .. "'", (([[
FILE: root.trans[2].events[1]: e_after: seconds expected, got 'e_after(x)' (e_after(0.5) would be right)
FILE: root.trans[3].events[1]: await: a list of events expected, got 'await()' (await(e_a, e_b) would be right)
]]):gsub("FILE", file)), 1)
  end)

  it("tells once that a composite has no e_done", function()
    local file = write_file("done.lua", [[
      local rfsm = require "rfsm"
      return rfsm.state {
        a = rfsm.state { b = rfsm.state {}, rfsm.trans { src = "initial", tgt = "b" } },
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "a", events = { "e_done" } },
      }
    ]])
    checks("'" .. file .. "'", file .. ": warning: root.trans[2]: 'e_done' never fires "
      .. "here, 'root.a' is no leaf state\n", 0)
  end)

  it("looks into the machines inside a state", function()
    local file = write_file("inside.lua", [[
      local rfsm = require "rfsm"
      local state, trans = rfsm.state, rfsm.trans
      return state {
        par = rfsm.seqand {
          left = state { a = state {}, spare = state {},
            trans { src = "initial", tgt = "a" },
            trans { src = "a", tgt = "a", event = "e" },
          },
        },
        trans { src = "initial", tgt = "par" },
        trans { src = "par", tgt = "par", events = { "e_again" } },
      }
    ]])
    checks("'" .. file .. "'", (([[
FILE: warning: root.par.left: root.spare: unreachable, no path of transitions leads here
FILE: warning: root.par.left: root.trans[2]: a transition has no field 'event' (did you mean 'events'?)
]]):gsub("FILE", file)), 0)
  end)

  it("fails with status 2 when it cannot read a file", function()
    fails("rfsm-check examples/on_off.lua /nowhere/x.lua",
      "rfsm check: /nowhere/x.lua: No such file or directory\n", 2)
    fails("rfsm-check examples", "rfsm check: examples: Is a directory\n", 2)
  end)

  it("tells how to use it, with status 2 when it was not", function()
    refuses("rfsm-check", "Error: missing argument 'files'")
    refuses("rfsm-check -x y", "Did you mean one of these: '-h' '-q' '-s' '-v'?")
    local out, _, status = run("rfsm-check --help")
    assert.matches("Usage: rfsm check", out)
    assert.equal(0, status)
  end)
end)
-- luacheck: pop
