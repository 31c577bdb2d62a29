-- The command line: rfsm check, viz, json, plantuml, dot, mermaid, and the tools of
-- their own names.

local commands = require "spec.support.commands"
local charts = require "rfsm.shared.chart"
local helper = require "spec.helper"

local content = helper.content
local lua = arg and arg[-1] or "lua5.1"
local folder

local function write_file(name, text)
  local handle = assert(io.open(folder .. "/" .. name, "wb"))
  handle:write(text)
  handle:close()
  return folder .. "/" .. name
end

-- Runs a command line that begins with a tool: stdout, stderr and the status. `rfsm x`
-- runs in this process, unless the shell connects it with files.
local function run(command)
  local inside = command:match("^rfsm ([^<>]*)$")
  if inside then return commands.run(inside) end
  local err, status = folder .. "/stderr", folder .. "/status"
  local pipe = io.popen(("{ LUA=%s tools/%s; echo $? >'%s'; } 2>'%s'"):format(lua,
    command, status, err))
  local out = pipe:read("*a")
  pipe:close()
  return out, content(err), tonumber(content(status))
end

-- Runs one; it must print `out`, then `err`, and end with `status`, 0 if none is given.
local function check(command, out, err, status)
  assert.same({ out, err or "", status or 0 }, { run(command) })
end

local function fails(command, err, status) check(command, "", err, status or 1) end

local function refuses(command, problem)
  local program = command:match("^rfsm.%l+"):gsub("%-", " ")
  fails(command, commands.refusal(program, problem), 2)
end

local function has_help(tool, name)
  local out, _, status = run(tool .. " --help")
  assert.matches("Usage: " .. name, out)
  assert.equal(0, status)
end

-- Runs `f` while the tools run with this in place of the interpreter.
local function with_lua(text, f)
  local real = lua
  lua = text
  local ok, problem = pcall(f)
  lua = real
  if not ok then error(problem, 0) end
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

-- A hint of rfsm/advice.lua, which may be missing.
local function hint(text) return pcall(require, "rfsm.advice") and text or "" end

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
    it("writes charts one after the other, also to a file", function()
      local file = folder .. "/out.dot"
      check(writer.tool .. " examples/on_off.lua -o '" .. file .. "'", "")
      local one = content(file)
      assert.is_falsy((one .. one):find("\n\n", 1, true))
      check(tool .. " examples/on_off.lua examples/on_off.lua", one .. one)
    end)

    it("reports each problem of a chart in a line, and writes nothing", function()
      local file, out = write_file("bad.lua", BAD), folder .. "/both.dot"
      local start = name .. ": " .. file
      fails(writer.tool .. " examples/on_off.lua '" .. file .. "' -o '" .. out .. "'",
        start .. ":3: root.a.entry: function expected, got number 7\n" .. start
        .. ":4: root.trans[1] (initial -> aa): tgt 'aa': no state or connector is "
        .. "named 'aa' in 'root'" .. hint " (did you mean 'a'?)" .. "\n")
      assert.is_nil(io.open(out))
    end)

    it("tells how to use it", function()
      has_help(writer.tool, name)
    end)

    if not writer.ending then return end

    it("writes each chart to a file of its own", function()
      local a, b = write_file("a.lua", CHART), write_file("b.lua", CHART)
      check(("%s '%s' '%s'"):format(writer.tool, a, b), "")
      local texts = {}
      for i, file in ipairs { a, b } do
        texts[i] = content((file:gsub("lua$", writer.ending)))
      end
      check(("%s '%s' '%s'"):format(tool, a, b), table.concat(texts))
    end)

    it("reports that it has replaced another text", function()
      local chart = write_file("c.lua", CHART)
      local result = write_file("c." .. writer.ending, "mine\n")
      check(("%s '%s'"):format(writer.tool, chart), "",
        ("%s: %s was replaced\n"):format(name, result))
      check(("%s '%s'"):format(writer.tool, chart), "")
    end)
  end)
end

-- The rest is the same code for all of them.
describe("the command line", function()
  it("reads stdin, also behind a #! line, and writes to stdout", function()
    local file = write_file("chart.lua", "#!/usr/bin/lua\n" .. CHART)
    local named = run("rfsm viz '" .. file .. "'")
    local piped, err, status = run("rfsm dot - <'" .. file .. "'")
    assert.same({ "", 0 }, { err, status })
    assert.equal(named:gsub('"chart"', '"stdin"'), piped)
  end)

  it("keeps what the chart prints out of its output", function()
    local plain = write_file("chart.lua", CHART)
    local expected = run("rfsm viz '" .. plain .. "'")
    write_file("chart.lua", "print('one', nil, 2) io.write('two\\n') "
      .. "io.stdout:write('three\\n')\n" .. CHART)
    check("rfsm-viz '" .. plain .. "'", expected, "one\tnil\t2\ntwo\nthree\n")
  end)

  it("is silent about the machines inside a state", function()
    local out, err = run("rfsm viz examples/seqand.lua")
    assert.is_falsy(out:find("INFO", 1, true))
    assert.equal("", err)
  end)

  it("says in one line why a file is no chart", function()
    for text, expected in pairs { -- any order: each stands alone
      ["return 7"] = "no valid rfsm in file 'FILE' found. (a chart ends with: return "
        .. "rfsm.state{...})",
      ["error('no bus\\nat all')"] = "FILE:1: no bus",
      ["error('no bus', 0)"] = "FILE: no bus",
      ["error()"] = "FILE: failed without a message",
      ["error({})"] = "FILE: failed with a table",
      ["require 'no.such'"] = "FILE:1: module 'no.such' not found",
      ["error(setmetatable({}, { __tostring = error }))"] = "FILE: table",
    } do
      local file = write_file("no.lua", text)
      local _, reason = charts.load(file)
      expected = expected:gsub(" %(a chart.*", "")
      assert.equal((expected:gsub("FILE", file)), (reason:gsub(" %(.*", "")))
    end
    local file = write_file("no.lua", "rfsm.preproc[1] = function() error('no', 0) end "
      .. "return rfsm.state {}")
    fails("rfsm-viz '" .. file .. "'", "rfsm viz: " .. file .. ": no\n")
  end)

  it("says why it cannot write", function()
    fails("rfsm viz examples/on_off.lua -o /nowhere/x.dot",
      "rfsm viz: /nowhere/x.dot: No such file or directory\n")
    fails("rfsm viz examples/on_off.lua >/dev/full",
      "rfsm viz: stdout: No space left on device\n")
  end)

  it("asks for a file, tells its version", function()
    refuses("rfsm-viz", "missing argument 'files'")
    refuses("rfsm-sim", "missing argument 'file'")
    check("rfsm-sim --version", "rfsm 1.0.0\n")
    has_help("rfsm-sim", "rfsm sim")
  end)

  it("runs by a symbolic link from anywhere", function()
    local link = folder .. "/link"
    os.execute(("ln -sf \"$PWD/tools/rfsm-viz\" '%s'"):format(link))
    local lines = helper.lines_of(("f=$PWD/examples/on_off.lua; cd / && '%s' \"$f\" "
      .. "2>&1"):format(link))
    assert.is_truthy(table.concat(lines):find("e_push", 1, true))
  end)
end)

describe("rfsm2json", function()
  it("names the package to install if dkjson is missing", function()
    with_lua("'" .. lua .. "' LUA_INIT='package.preload.dkjson = function() error(0) "
      .. "end'", function()
      fails("rfsm2json -o - examples/on_off.lua", "rfsm json: examples/on_off.lua: the "
        .. "package dkjson is missing (on Debian: apt-get install lua-dkjson)\n")
    end)
  end)
end)

describe("rfsm-viz", function()
  it("writes the format that is asked for", function()
    for format, expected in pairs { -- any order: each stands alone
      [""] = 'digraph "on_off" {',
      ["-T plantuml"] = "@startuml\ntitle on_off\n",
      ["-T mermaid"] = '---\ntitle: "on_off"\n---\nstateDiagram-v2\n',
      ["-T png"] = "\137PNG\r\n",
    } do
      local out, err, status = run("rfsm viz examples/on_off.lua " .. format)
      assert.same({ expected, "", 0 }, { out:sub(1, #expected), err, status })
    end
  end)

  it("lists its formats", function()
    assert.is_truthy(run("rfsm viz --help"):gsub("%s+", " "):find("-T FORMAT "
      .. table.concat(commands.formats(), ", "), 1, true))
  end)

  it("tells the format by the name of the output", function()
    for ending, expected in pairs { -- any order: each stands alone
      svg = "<?xml", pdf = "%PDF-1", gv = "digraph", dot = "digraph",
      PUML = "@startuml", mmd = "---\n", json = '{\n  "version":2',
    } do
      local file = folder .. "/chart." .. ending
      check("rfsm viz examples/on_off.lua -o '" .. file .. "'", "")
      assert.equal(expected, content(file):sub(1, #expected))
    end
  end)

  it("refuses unknown formats, and several charts in a picture", function()
    refuses("rfsm viz examples/on_off.lua -T gif", "argument for option '-T' "
      .. "must be one of '" .. table.concat(commands.formats(), "', '") .. "'")
    refuses("rfsm viz examples/on_off.lua -o x.gif", "the ending of 'x.gif' "
      .. "is no format, -T expected (" .. table.concat(commands.formats(), ", ")
      .. ")")
    refuses("rfsm viz -T svg examples/on_off.lua examples/on_off.lua",
      "one FILE expected, svg holds one chart, got 2")
  end)

  it("draws what is active, some levels, from left to right", function()
    local text = run("rfsm viz --active root.operational.tracking --depth 1 "
      .. "--direction LR examples/ball_tracking.lua")
    assert.is_truthy(text:find("rankdir=LR", 1, true))
    assert.is_falsy(text:find("searching", 1, true))
    assert.matches('%[id="root.operational",[^\n]*class="state active"', text)
    fails("rfsm viz --active dim examples/on_off.lua",
      "rfsm viz: examples/on_off.lua: active: no state is named 'dim'"
        .. hint(" (there are 'root', 'root.off', 'root.on')") .. "\n")
    refuses("rfsm viz --depth 1.5 examples/on_off.lua",
      "--depth: whole number above 0 expected, got '1.5'")
    refuses("rfsm viz --direction UP examples/on_off.lua",
      "argument for option '--direction' must be one of 'TB', 'LR'")
  end)

  it("marks a run on the diagram", function()
    local coverage = write_file("coverage.json",
      '{"states":{"root.on":12},"transitions":{"root.trans[1]":1}}')
    local text = run("rfsm viz --coverage '" .. coverage .. "' examples/on_off.lua")
    assert.is_truthy(text:find("(12×)", 1, true))
    local steps = { '{"leaf":"root.off"}', '{"taken":["root.trans[2]"]}', '"root.on"' }
    for _, json in ipairs { table.concat(steps, "\n"),
      "[" .. table.concat(steps, ",") .. "]" } do
      local trace = write_file("trace.json", json)
      text = run("rfsm viz --trace '" .. trace .. "' examples/on_off.lua")
      for i, place in ipairs { "off", "trans%[2%]", "on" } do
        assert.matches('id="root.' .. place .. '",[^\n]*%(step ' .. i .. "%)", text)
      end
    end
    for content_of, problem in pairs { -- any order: each stands alone
      ["[1]"] = 'an object with "states" and "transitions" expected',
      ["{"] = "no JSON: unterminated object at line 1, column 1",
    } do
      local file = write_file("bad.json", content_of)
      fails("rfsm viz --coverage '" .. file .. "' examples/on_off.lua",
        "rfsm viz: " .. file .. ": " .. problem .. "\n")
    end
  end)

  it("says what to install without Graphviz, and what Graphviz says", function()
    local path, bin = helper.lines_of("command -v '" .. lua .. "'")[1], folder .. "/bin"
    os.execute(("mkdir '%s' && ln -s $(command -v readlink) $(command -v dirname) '%s'")
      :format(bin, bin))
    with_lua(path .. " PATH='" .. bin .. "'", function()
      fails("rfsm-viz examples/on_off.lua -T svg", "rfsm viz: Graphviz is missing "
        .. "(on Debian: apt-get install graphviz)\n")
    end)
    os.execute("chmod +x '" .. write_file("bin/dot",
      "#!/bin/sh\necho 'out of ink' >&2\nexit 3\n") .. "'")
    with_lua(lua .. " PATH='" .. bin .. "':\"$PATH\"", function()
      fails("rfsm-viz examples/on_off.lua -T svg",
        "rfsm viz: examples/on_off.lua: dot: out of ink\n")
      write_file("bin/dot", "#!/bin/sh\nkill -SEGV $$\n")
      fails("rfsm-viz examples/on_off.lua -T svg",
        "rfsm viz: examples/on_off.lua: dot: killed by signal 11; another direction or "
        .. "depth, or another version of Graphviz may help\n")
    end)
  end)
end)

describe("rfsm-check", function()
  -- In `expected`, FILE is the chart; it is a pattern if it begins with ^.
  local function checks(text, expected, expected_status, options)
    local file = text:find("\n") and write_file("chart.lua", text) or text
    local out, err, status = run(("rfsm check %s '%s'"):format(options or "", file))
    out = out:gsub(file:gsub("%p", "%%%0"), "FILE")
    if expected:sub(1, 1) == "^" then
      assert.matches(expected, out)
      out = expected
    end
    assert.same({ expected, "", expected_status }, { out, err, status })
  end

  local OK = "FILE: ok (0 properties judged)\n"

  local RISKY = [[
    local rfsm = require "rfsm"
    return rfsm.state {
      a = rfsm.state {}, spare = rfsm.state {}, k = rfsm.conn {},
      rfsm.trans { src = "initial", tgt = "a" },
      rfsm.trans { src = "a", tgt = "k", events = { "e_go" } },
      rfsm.trans { src = "k", tgt = "a", guard = function() return true end },
    }
  ]]
  local WARNED = "FILE:3: warning: root.spare: unreachable, no path of transitions "
    .. "leads here (see which transition leads to it, or remove it) [unreachable]\n"
  local NOTED = "FILE:3: note: root.k: no way on without a guard for e_go (add a "
    .. "transition without guard and events, of the least pn) [no-default]\n"

  it("says ok to a chart without problems", function()
    check("rfsm check examples/on_off.lua examples/seqand.lua",
      "examples/on_off.lua: ok (0 properties judged)\n"
      .. "examples/seqand.lua: ok (0 properties judged)\n")
    check("rfsm check - <examples/on_off.lua", "stdin: ok (0 properties judged)\n")
  end)

  it("reports every problem with its line, with status 1", function()
    checks(BAD, "FILE:3: root.a.entry: function expected, got number 7\n"
      .. "FILE:4: root.trans[1] (initial -> aa): tgt 'aa': no state or connector is "
      .. "named 'aa' in 'root'" .. hint " (did you mean 'a'?)" .. "\n", 1)
    checks("\nreturn 7", "^no valid rfsm in file 'FILE' found[^\n]*\n$", 1)
  end)

  it("reports warnings: status 0, 1 if strict, nothing if quiet", function()
    checks(RISKY, WARNED, 0)
    checks(RISKY, WARNED, 1, "--strict")
    checks("examples/on_off.lua", OK, 0, "-s")
    checks(RISKY, "", 0, "--quiet")
    checks(RISKY, "", 1, "-q -s")
  end)

  it("prints notes if they are asked for", function()
    checks(RISKY, WARNED .. NOTED, 0, "--all")
  end)

  it("takes severities from the nearest .rfsmcheck.lua", function()
    write_file(".rfsmcheck.lua", "return { unreachable = 'error' }")
    checks(RISKY, WARNED:gsub("warning: ", ""), 1)
    write_file(".rfsmcheck.lua", "return { unreachable = 'off' }")
    checks(RISKY, OK, 0)
    local file = write_file("chart.lua", RISKY)
    for text, expected in pairs { -- any order: each stands alone
      ["return { unreachabel = 'off' }"] = ": no check has the code 'unreachabel'"
        .. hint " (did you mean 'unreachable'?)",
      ["return { typo = 'of' }"] = ": typo: 'error', 'warning', 'note' or 'off' "
        .. "expected, got 'of'",
      ["return {"] = ":1: ",
    } do
      local settings = write_file(".rfsmcheck.lua", text)
      local _, problem = require("rfsm.cli.review").settings_for(file)
      assert.equal(settings .. expected, (problem:sub(1, #settings + #expected)))
    end
    local settings = write_file(".rfsmcheck.lua", "return 7")
    fails("rfsm check '" .. file .. "'", "rfsm check: " .. settings
      .. ": table of severities expected, got number\n", 2)
    os.remove(folder .. "/.rfsmcheck.lua")
  end)

  it("lists the codes", function()
    local out, _, status = run("rfsm check --codes")
    assert.matches("\ndead%-end +warning +nothing leads on from a leaf\n", out)
    assert.equal(0, status)
  end)

  it("explores a chart, and judges the properties beside it", function()
    local chart = [[
      local rfsm = require "rfsm"
      return rfsm.state { a = rfsm.state {}, b = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = { "e_go" } },
        rfsm.trans { src = "b", tgt = "a", events = { "e_go" } },
      }
    ]]
    local counts = "FILE: 3 configurations, 3 of 3 transitions taken, 3 steps run\n"
    checks(chart, OK .. counts, 0, "--explore")
    checks(chart, OK, 0)
    checks(chart, OK:gsub("ok", "%0 as far as explored")
      .. counts:gsub("3 conf", "2 conf"):gsub("3 of", "1 of")
      :gsub("3 steps", "1 steps") .. "FILE: not tried: what lies behind the bound on "
      .. "configurations; unreached states, transitions not taken and whether "
      .. "properties hold are not known\nFILE: stopped by configurations = 1: depth 1,"
      .. " 1 of 2 configurations not expanded; raise it, or bind what is free "
      .. "(events by alphabet)\n", 0, "--configurations 1")
    write_file("chart_properties.lua", [[
      local never = require("rfsm_checks").never
      return { properties = { never "root.b", never { "root.a", "root.b" } } }
    ]])
    local violated = "FILE: never root.b: does not hold [violated]\n"
      .. "  1. no event: root.trans[1] -> root.a\n"
      .. "  2. e_go: root.trans[2] -> root.b\n"
    local holds = "FILE: never root.a and root.b: holds (one event a step)\n"
    checks(chart, violated .. holds, 1)
    checks(chart, "FILE: ok\n", 0, "--static")
    checks(chart, violated .. "  recorded in " .. folder .. "/run\n" .. counts .. holds,
      1, "-x --record '" .. folder .. "/run'")
    assert.matches("root.b", (run("rfsm-sim -q --dry --replay '" .. folder .. "/run' '"
      .. folder .. "/chart.lua' -e 'print(rfsm.get_actleaf_fqn(fsm))'")))
    assert.matches("\n   1  e_init_fsm +root.a%(done%)\n   2  e_done@root.a, e_go +"
      .. "root.b%(done%)\nactive: root.a%(done%)\n", (run("rfsm-sim -q --dry --replay '"
      .. folder .. "/run' '" .. folder .. "/chart.lua' -e 'history()' -e 'goto(1)'")))
    local never = "return { properties = {\n  require('rfsm_checks').never("
      .. "function(is) %s end) } }"
    for text, problem in pairs { -- any order: each stands alone
      ["return 7"] = "FILE_properties.lua: table with the field 'properties' "
        .. "expected, got number (return { properties = { ... } })\n",
      ["return { 7 }"] = "FILE_properties.lua: table with the field 'properties' "
        .. "expected, got a list (return { properties = { ... } })\n",
      ["return { properties = { 7 } }"] = "FILE_properties.lua:1: properties: "
        .. "never(...), after(...).reach(...) or another property expected, got "
        .. "number\n",
      ["return {\n  run = { 'effect root.trans[7]' },\n}"] = "FILE_properties.lua:2: "
        .. "run: no callback 'effect root.trans[7]'\n",
      ["return {\n  vars = { no = { 0, 1 } } }"] = "FILE_properties.lua:2: vars: no "
        .. "field is named 'no'\n",
      ["return { ['va' .. 'rs'] = { ['n' .. 'o'] = { 0, 1 } } }"] =
        "FILE_properties.lua: vars: no field is named 'no'\n",
      ["return {\n  vras = {} }"] = "FILE_properties.lua:2: unknown option 'vras' (did "
        .. "you mean 'vars'?), expected: ",
      ["return { properties = 7,"] = "FILE_properties.lua:1: ",
      [never:format "return is.lit.x"] = "FILE_properties.lua:2: attempt to index ",
      [never:format "error {}"] = "FILE.lua: failed with a table\n",
    } do
      local file = write_file("chart_properties.lua", text)
      local out, _, status = run("rfsm check -x '" .. folder .. "/chart.lua'")
      local name = file:gsub("_properties.lua$", "")
      out = out:gsub(name:gsub("%p", "%%%0"), "FILE")
      local is_whole = problem:sub(-1) == "\n"
      assert.equal(problem, is_whole and out or out:sub(1, #problem))
      assert.equal(1, status)
    end
    os.remove(folder .. "/chart_properties.lua")
  end)

  it("names a file of properties that is not read, because it has another name",
    function()
    local chart = [[
      local rfsm = require "rfsm"
      return rfsm.state { a = rfsm.state {}, trans_to_a = rfsm.trans { src = "initial",
        tgt = "a" }, rfsm.trans { src = "a", tgt = "a", events = { "e_go" } } }
    ]]
    for _, name in ipairs { "properties.lua", "chart.properties.lua" } do
      write_file(name, "return { properties = {} }")
      checks(chart, ("FILE: warning: %s/%s is not read, its name would be %s/"
        .. "chart_properties.lua\n"):format(folder, name, folder), 0)
      os.remove(folder .. "/" .. name)
    end
  end)

  it("finds a silence whose reason is gone", function()
    local text = [[
      local rfsm = require "rfsm"
      return rfsm.state {
        a = rfsm.state { checks = { ["dead-end"] = "meant" } },
        b = rfsm.state { checks = { trap = "meant" } },
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = { "e_go" },
          checks = { ["unknown-field"] = "later" }, action = 1 },
        c = rfsm.state {}, rfsm.trans { src = "a", tgt = "c", events = { "e_on" } },
        rfsm.trans { src = "c", tgt = "a", events = { "e_off" } },
      }
    ]]
    checks(text, "FILE:4: warning: root.b: no exit, neither this state nor one around "
      .. "it is ever left (add a transition, or declare final = true) [dead-end]\n"
      .. "FILE:3: warning: root.a: checks['dead-end']: there is nothing to silence any "
      .. "more (write checks = { [\"a-code\"] = \"the reason\" }) [silence]\n"
      .. "FILE:4: warning: root.b: checks['trap']: there is nothing to silence any "
      .. "more (write checks = { [\"a-code\"] = \"the reason\" }) [silence]\n", 0)
    checks(text, "^FILE:4: warning: root.b: no exit[^\n]*\n$", 0, "--static")
  end)

  it("tells once what two checks find, and of ends that are named so only with --all",
    function()
    checks([[
      local rfsm = require "rfsm"
      return rfsm.state {
        a = rfsm.state {}, b = rfsm.state {}, FAILED = rfsm.state {},
        spare = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = { "e_go" } },
        rfsm.trans { src = "a", tgt = "FAILED", events = { "e_fail" } },
        rfsm.trans { src = "spare", tgt = "b", events = { "e_go" } },
        c = rfsm.state {}, rfsm.trans { src = "a", tgt = "c", events = { "e_on" } },
        rfsm.trans { src = "c", tgt = "a", events = { "e_off" } },
      }
    ]], "FILE:3: warning: root.b: no exit, neither this state nor one around it is "
      .. "ever left (add a transition, or declare final = true) [dead-end]\n"
      .. "FILE:4: warning: root.spare: unreachable, no path of transitions leads here "
      .. "(see which transition leads to it, or remove it) [unreachable]\n", 0)
  end)

  it("refuses numbers that are none of events or configurations", function()
    refuses("rfsm check -k 0 x",
      "-k: whole number above 0 expected, got '0'")
    refuses("rfsm check -k 1.5 x",
      "-k: whole number above 0 expected, got '1.5'")
    refuses("rfsm check --configurations x y",
      "--configurations: whole number above 0 expected, got 'x'")
  end)

  it("writes tests that busted runs", function()
    local spec = folder .. "/emem_spec.lua"
    local out, err, status = run("rfsm check --tests busted -o '" .. spec
      .. "' examples/emem.lua")
    assert.same({ "", 0 }, { out, status })
    assert.matches("^rfsm check: 5 of 5 transitions in %d+ steps\n$", err)
    local pipe = io.popen("busted --lua=$(command -v '" .. lua .. "') -o TAP '" .. spec
      .. "' 2>&1")
    assert.matches("^ok 1 %- examples/emem.lua goes to ", pipe:read("*a"))
    pipe:close()
  end)

  it("finds nothing in the examples that is not expected there", function()
    local rest, count = run("rfsm-check examples/*.lua"):gsub("[^\n]*: ok[^\n]*\n", "")
    assert.matches("^examples/dynamic.lua: [^\n]*\nexamples/dynamic.lua: not tried: "
      .. "transitions that the effect root.trans%[2%] may change or add;[^\n]*\n$",
      rest)
    assert.is_true(count > 10)
  end)

  it("opens a chart with stubs in place of what is not here, and names them", function()
    local name = write_file("arm.lua", 'require "armlib"\n' .. CHART)
    local problem = name .. ":1: module 'armlib' not found (the option --stub loads "
      .. "the chart without it)\n"
    fails("rfsm viz " .. name, "rfsm viz: " .. problem)
    fails("rfsm size " .. name, "rfsm size: " .. problem)
    fails("rfsm sim -e 'step()' " .. name, "rfsm sim: " .. problem)
    check("rfsm check " .. name, problem, "", 1)
    fails("rfsm snapshot diff " .. name .. " " .. name, "rfsm snapshot: " .. name
      .. ":1: module 'armlib' not found\n")
    local line = name .. ": stubbed: armlib\n"
    check("rfsm check --static --stub " .. name, name .. ": ok\n" .. line)
    local out, err = run("rfsm viz --stub -T mermaid " .. name)
    assert.equal("rfsm viz: " .. line, err)
    assert.matches('title: "arm %(stubbed: armlib%)"', out)
    local picture = run("rfsm viz --stub -T svg " .. name)
    assert.matches('font%-size="10.00">stubbed: armlib<', picture)
    assert.not_matches("arm %(stubbed", picture)
  end)

  it("has one line for stubs in a picture, however many they are", function()
    local lines = {}
    for i = 1, 30 do lines[i] = ('require "robots.lib%d"\n'):format(i) end
    local name = write_file("arm.lua", table.concat(lines) .. CHART)
    local picture = run("rfsm viz --stub -T svg " .. name)
    assert.equal("robots.lib1, robots.lib2, robots.lib3, robots.lib4 and 26 more",
      picture:match(">stubbed: (.-)<"))
  end)

  -- Writes a chart: four composites with 18 states each.
  local function write_plant()
    local parts = { "return rfsm.state { rfsm.trans { src = 'initial', tgt = 'a1' }," }
    for i = 1, 4 do
      parts[#parts + 1] = ("a%d = rfsm.state { rfsm.trans { src = 'initial', tgt = "
        .. "'s1' },"):format(i)
      for k = 1, 18 do
        parts[#parts + 1] = ("s%d = rfsm.state {}, rfsm.trans { src = 's%d', tgt = "
          .. "'s%d' },"):format(k, k, k % 18 + 1)
      end
      parts[#parts + 1] = "}, rfsm.trans { src = '.a" .. i .. ".s18', tgt = '.a"
        .. i % 4 + 1 .. ".s9', events = { 'e_next' } },"
    end
    return write_file("plant.lua", table.concat(parts) .. "}")
  end

  it("draws a large chart in pages: an overview, sheets, links to each", function()
    local name, out = write_plant(), os.tmpname()
    os.remove(out)
    check("rfsm viz --pages -o " .. out .. " " .. name, "", "")
    local files, links = {}, {}
    for file in io.popen("cd " .. out .. " && ls"):lines() do
      files[#files + 1] = file
      for link in helper.content(out .. "/" .. file):gmatch('xlink:href="([^"]*)"') do
        links[file] = (links[file] or "") .. link .. " "
      end
    end
    os.execute("rm -r " .. out)
    assert.same({ "01-root.svg", "02-root_a1.svg", "03-root_a2.svg", "04-root_a3.svg",
      "05-root_a4.svg" }, files)
    assert.equal("02-root_a1.svg 03-root_a2.svg 04-root_a3.svg 05-root_a4.svg ",
      links["01-root.svg"])
    assert.equal("03-root_a2.svg 05-root_a4.svg ", links["02-root_a1.svg"])
    refuses("rfsm viz --pages " .. name,
      "--pages needs -o FOLDER or FILE.pdf, and no text for -T")
    assert.not_matches("href", (run("rfsm viz --depth 1 -T svg " .. name)))
  end)

  it("draws a large chart in one PDF with links to its pages", function()
    if not helper.lines_of("command -v qpdf")[1] then return pending("no qpdf") end
    local out = os.tmpname() .. ".pdf"
    check("rfsm viz --pages -o " .. out .. " " .. write_plant(), "", "")
    local text = helper.text_of("qpdf --qdf --object-streams=disable " .. out .. " -")
    os.remove(out)
    local pages, goals = {}, {}
    for page, object in text:gmatch("%% Page (%d+)\n%%[^\n]*\n(%d+) 0 obj") do
      pages[object] = page
    end
    for object in text:gmatch("/D %[%s+(%d+) 0 R%s+/Fit") do
      goals[#goals + 1] = pages[object]
    end
    assert.equal("2 3 4 5 3 5 2 4 3 5 4 2", table.concat(goals, " "))
    assert.not_matches("/URI", text)
  end)

  it("reports the warnings of init, and undefined globals of the file, once", function()
    checks([[
      local rfsm, unknown = require "rfsm", debug and DEBUG
      return rfsm.state {
        a = rfsm.state { entry = function() print(later) end }, b = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", event = "e_x", events = { e_go } },
        rfsm.trans { src = "b", tgt = "a", events = e_go },
        rfsm.trans { src = "b", tgt = "a", event = "e_x" },
      }
    ]], "^FILE:1: warning: undefined global 'DEBUG' %(nil while the chart is loaded%)\n"
      .. "FILE:5: warning: undefined global 'e_go' %(an event is a string, in "
      .. "quotes%)\n.*FILE:7: warning: root.trans%[4%] %(b %-> a%): a transition has "
      .. "no field 'event'", 0)
  end)

  it("leaves out a global whose existence the chart asks for", function()
    checks([[
      local rfsm = require "rfsm"
      if finder ~= nil then finder:find "x" end
      if host then host() end
      local name = title or "x"
      return rfsm.state { a = rfsm.state { final = not is_open },
        b = rate and rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" } }
    ]], OK, 0)
  end)

  it("has the location once, also in a file with a blank in its name", function()
    local file = write_file("a chart.lua", RISKY)
    assert.equal(WARNED:gsub("FILE", file), (run("rfsm check '" .. file .. "'")))
  end)

  it("warns of time events and awaits unless chart or settings load them", function()
    local text = [[
      local rfsm = require "rfsm"
      return rfsm.state {
        a = rfsm.state {}, b = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = { "e_after(2)" } },
        rfsm.trans { src = "b", tgt = "a", events = { "await(e_a)" } },
      }
    ]]
    local warning = "FILE:%d: warning: root.trans[%d] (%s): the chart does not load "
      .. "the extension that knows '%s' (require %q) [unknown-word]\n"
    local of_time = warning:format(5, 2, "a -> b", "e_after(2)", "rfsm_timeevent")
    local of_await = warning:format(6, 3, "b -> a", "await(e_a)", "rfsm.await")
    checks(text, of_time .. of_await, 0)
    checks("require 'rfsm.timeevent'" .. text, of_await, 0)
    checks("local _ = rfsm_timeevent" .. text, of_await, 0)
    checks("require 'rfsm_await'" .. text, of_time, 0)
    write_file(".rfsmcheck.lua", "require 'rfsm_timeevent' return {}")
    checks(text, of_await, 0)
    os.remove(folder .. "/.rfsmcheck.lua")
  end)

  it("looks into the machines inside a state", function()
    checks([[
      local rfsm = require "rfsm"
      return rfsm.state {
        par = rfsm.seqand {
          left = rfsm.state { a = rfsm.state { final = true }, spare = rfsm.state {},
            rfsm.trans { src = "initial", tgt = "a" } },
        },
        rfsm.trans { src = "initial", tgt = "par" },
        rfsm.trans { src = "par", tgt = "par", events = { "e_again" } },
      }
    ]], "^FILE:.* warning: root.par.left: [^\n]*root.spare: unreachable", 0)
  end)

  it("fails with status 2 if it cannot read a file", function()
    fails("rfsm check examples/on_off.lua /nowhere/x.lua",
      "rfsm check: /nowhere/x.lua: No such file or directory\n", 2)
    for command in ("check sim viz dot json size web redis postgres"):gmatch "%l+" do
      fails("rfsm " .. command .. " examples",
        "rfsm " .. command .. ": examples: Is a directory\n", 2)
    end
    fails("rfsm check examples/lamp", "rfsm check: examples/lamp: No such file or "
      .. "directory (did you mean 'examples/lamp.lua'?)\n", 2)
    for _, option in ipairs { "viz --like", "viz --trace", "viz --coverage", "sim -r",
      "sim -q --from" } do
      local _, err, status = run("rfsm " .. option .. " /nowhere/x examples/lamp.lua")
      assert.same({ "/nowhere/x: No such file or directory", 2 },
        { err:match("(/nowhere[^\n]*)\n$"), status })
    end
  end)

  it("tells how to use it, with status 2 if it was not", function()
    has_help("rfsm-check", "rfsm check")
    refuses("rfsm check --bogus x", "unknown option '--bogus'")
    refuses("rfsm-check", "missing argument 'files'")
    refuses("rfsm check -y x",
      "unknown option '-y' (did you mean one of these: '-a' '-h' '-k' '-o' '-q' '-s' "
      .. "'-v' '-x'?)")
  end)
end)

describe("a chart that uses globals of the original", function()
  local function check_chart(text, out, err, status)
    local file = write_file("globals.lua", ([[
local rfsm = require "rfsm"
%s
return rfsm.state {
  a = rfsm.state { entry = function() assert(rfsmpp.fsm2str) end }, b = m,
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_after(3)" } },
  rfsm.trans { src = "b", tgt = "a", events = { "e_low" } },
}
]]):format(text))
    check("rfsm check " .. file, (out:gsub("FILE", file)), (err:gsub("FILE", file)),
      status)
  end

  local OK = "FILE: ok (0 properties judged)\n"

  it("finds rfsm_timeevent and rfsm_ext while it is read", function()
    check_chart([[
rfsm_timeevent.set_gettime_hook(function() return 5, 0 end)
m = rfsm_ext.gen_monitor_state { montab = { e_low = print } }]], OK, "")
  end)

  it("switches time events on only if it reads rfsm_timeevent", function()
    for first, expected in pairs { -- any order: each stands alone
      [""] = '"e_after(3)"', ["_ = rfsm_timeevent"] = '"e_after(3)@root.m"',
    } do
      local out = run("rfsm2json -o - " .. write_file("unread.lua", first .. [[

local rfsm = require "rfsm"
local m = rfsm_ext.gen_monitor_state { montab = { e_low = rfsmpp.fsm2str } }
return rfsm.state { m = m, rfsm.trans { src = "initial", tgt = "m" },
  rfsm.trans { src = "m", tgt = "m", events = { "e_after(3)", "e_low" } } }
]]))
      assert.is_truthy(out:find(expected, 1, true), out)
    end
  end)

  it("finds rfsmpp also while it runs", function()
    local file = write_file("runs.lua", [[
local rfsm = require "rfsm"
return rfsm.state { info = false, warn = false,
  a = rfsm.state { entry = function(fsm) print("tree " .. #rfsmpp.fsm2str(fsm)) end },
  rfsm.trans { src = "initial", tgt = "a" } }
]])
    local pipe = io.popen(("echo run | LUA=%s tools/rfsm sim -q %s 2>&1"):format(lua,
      file))
    local text = pipe:read("*a")
    pipe:close()
    assert.matches("tree %d+", text)
  end)
end)
