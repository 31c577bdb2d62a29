-- The commands: their command lines, and what each hands to the module that does the
-- work, which is replaced here. spec/tools_spec.lua runs the tools themselves.

local commands = require "spec.support.commands"
local common = require "rfsm.cli.common"
local helper = require "spec.helper"

local new_stream, refusal, run = commands.new_stream, commands.refusal, commands.run
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

after_each(helper.remove_files)

-- Returns a function that notes its arguments, and returns these values.
local function noting(list, ...)
  local results, n = { ... }, select("#", ...)
  return function(...)
    list[#list + 1] = { ... }
    return unpack(results, 1, n)
  end
end

local function last_line(text) return text:match("([^\n]*)\n$") end

describe("the usage of rfsm", function()
  local USAGES = {
    check = "[OPTION] ... FILE [FILE] ...",
    sim = "[--stub] [-e CODE] [-i] [-r FILE] [--from FILE] [-d] [-q] FILE",
    viz = "[--stub] [--machine N] [-T FORMAT] [-o FILE] [--active FQN] [--depth N] "
      .. "[--coverage JSON] [--trace JSON] [--direction DIR] [--for SHEET] "
      .. "[--pages] [--like SVG] FILE [FILE] ...",
    snapshot = "{diff} OLD NEW",
    redis = "[--ids N] [--ids-for S] [-o FILE] [-l URL] [--index] [--history N] "
      .. "[--diff] [--stats URL] [[NAME=]FILE] ...",
    postgres = "[--ids N] [--ids-for S] [-o FILE] [-l DATABASE] "
      .. "[--stats DATABASE] [--client] [--history] [--history-days N] "
      .. "[--notify] [[NAME=]FILE] ...",
    json = "[--stub] [--machine N] [-o FILE] FILE [FILE] ...",
    plantuml = "[--stub] [--machine N] [-o FILE] FILE [FILE] ...",
    dot = "[--stub] [--machine N] [-o FILE] FILE [FILE] ...",
    mermaid = "[--stub] [--machine N] [-o FILE] FILE [FILE] ...",
    web = "[--stub] [--from FILE] [-a HOST:PORT] [-m N] [-p N] [--host HOST] [FILE]",
    watch = "[-m N] [-n N] HOST[:PORT]",
    fleet = "[--tags N] [--where FILTER] [--dry-run] [--if-version N] [--by NAME] "
      .. "[--force] URL VERB [ARGUMENT] ...",
    size = "[--stub] [--lua LUA] FILE",
  }
  for name, usage in pairs(USAGES) do -- any order: each stands alone
    it(name .. " is " .. usage, function()
      local out, err, status = run("help " .. name)
      local text = out:match("^Usage: (.-)\n\n"):gsub("%s+", " "):gsub(" %[%-h%]", "")
      assert.same({ "rfsm " .. name .. " " .. usage, "", 0 }, { text, err, status })
      assert.equal(out, (run(name .. " --help")))
    end)
  end

  it("fits a terminal, of each command", function()
    local too_long = {}
    for name in pairs(USAGES) do -- any order: a set
      local out = run("help " .. name)
      local _, count = out:gsub("\n", "")
      local has_wide = ("\n" .. out):find("\n" .. ("[^\n]"):rep(81)) ~= nil
      if count > 25 or has_wide then too_long[#too_long + 1] = name end
    end
    assert.same({}, too_long)
    assert.is_true(select(2, (run ""):gsub("\n", "")) <= 24)
  end)

  it("is printed without a command, with a sentence about each", function()
    local out, err, status = run ""
    for name in pairs(USAGES) do -- any order: each stands alone
      assert.matches("\n   " .. name .. " +%u[^\n]*%.\n", out)
    end
    assert.same({ "", 0 }, { err, status })
    assert.equal(out, (run "help"))
  end)

  it("has text behind the options", function()
    for name in pairs(USAGES) do -- any order: each stands alone
      local last = run("help " .. name):match(".*\n\n(.-)%s*$")
      assert.matches(name == "fleet" and "^Verbs:\n" or "^%S+ .*%.$", last)
    end
  end)

  it("names argparse if that is missing", function()
    local preload = { argparse = function() error("no argparse") end }
    helper.with(package.preload, preload, function()
      assert.same({ "", "rfsm: the package argparse is missing (on Debian: apt-get "
        .. "install lua-argparse)\n", 1 }, { run("help", { argparse = false }) })
    end)
  end)

  for command, problem in pairs { -- any order: each stands alone
    ["help chekc"] = "no command is named 'chekc' (did you mean 'check'?)",
    ["check -k 0 x"] = "-k: whole number above 0 expected, got '0'",
    ["check --seconds=-1 x"] = "--seconds: seconds expected, got '-1'",
    ["check --tests busted - -"] = "one FILE expected, tests are those of one "
      .. "chart, got 2",
    ["viz --depth x y"] = "--depth: whole number above 0 expected, got 'x'",
    ["viz -T svg a b"] = "one FILE expected, svg holds one chart, got 2",
    ["viz x.lua -o y.gif"] = "the ending of 'y.gif' is no format, -T expected "
      .. "(" .. table.concat(commands.formats(), ", ") .. ")",
    ["watch -n 1.5 host"] = "-n: whole number above 0 expected, got '1.5'",
    ["watch -m 0 host"] = "-m: whole number above 0 expected, got '0'",
    ["watch a:b"] = "HOST or HOST:PORT expected, got 'a:b'",
    ["watch a:65536"] = "HOST or HOST:PORT expected, got 'a:65536'",
    ["web"] = "FILE or -a HOST:PORT expected",
    ["web x.lua --attach a"] = "FILE or -a HOST:PORT expected",
    ["web -p x x.lua"] = "-p: whole number from 0 to 65535 expected, got 'x'",
    ["web -m 0 -a x"] = "-m: whole number above 0 expected, got '0'",
    ["check -o x x.lua"] = "-o and --callbacks need --tests busted",
    ["check --callbacks x.lua"] = "-o and --callbacks need --tests busted",
    ["redis"] = "a chart expected",
    ["redis --ids 0 x"]
      = "--ids: whole number from 1 to 1000000 expected, got '0'",
    ["redis --ids 1000001 x"]
      = "--ids: whole number from 1 to 1000000 expected, got '1000001'",
    ["redis --history 1.5 x"]
      = "--history: whole number from 1 to 1000000 expected, got '1.5'",
    ["postgres --ids-for x y"]
      = "--ids-for: whole number from 1 to 1000000 expected, got 'x'",
    ["postgres --history-days 1e20 x"]
      = "--history-days: whole number from 1 to 1000000 expected, got '1e20'",
    ["fleet --tags 16385 x get k"]
      = "--tags: whole number from 1 to 16384 expected, got '16385'",
    ["fleet --if-version=-1 x push k f"] = "--if-version: whole number from 0 to "
      .. "9007199254740992 expected, got '-1'",
    ["web x.lua 8080"] = "one FILE expected, got '8080', too (the port is an "
      .. "option: -p 8080)",
    ["web x.lua y.lua"] = "one FILE expected, got 'y.lua', too",
    ["viz x.lua x.svg"]
      = "'x.svg' is no chart, a picture is written by -o x.svg",
    ["run x.lua"] = "no command is named 'run' (did you mean 'sim'?)",
    ["chekc x.lua"] = "no command is named 'chekc' (did you mean 'check'?)",
  } do
    it("refuses " .. command, function()
      local name = command:match("^%S+")
      local program = USAGES[name] and "rfsm " .. name or "rfsm"
      assert.same({ "", refusal(program, problem), 2 }, { run(command) })
    end)
  end

  it("names the command for a chart", function()
    assert.same({ "", "rfsm: 'x.lua' is no command. To step through that chart, type: "
      .. "rfsm sim x.lua\n", 2 }, { run "x.lua" })
  end)
end)

describe("rfsm check", function()
  local CHART = "local rfsm = require 'rfsm'\nreturn rfsm.state { info = false, "
    .. "a = rfsm.state {%s}, rfsm.trans { src = 'initial', tgt = 'a' } }\n"

  it("shows the lines of tests that a new version of the chart changes", function()
    local file, spec = helper.file_with(CHART:format ""), helper.file_with ""
    local command = ("check --tests busted -o %s %s"):format(spec, file)
    os.remove(spec)
    local summary = "rfsm check: 1 of 1 transitions in 3 steps\n"
    assert.same({ "", summary, 0 }, { run(command) })
    local old = helper.content(spec)
    assert.same({ "", summary, 0 }, { run(command) })
    helper.write(file, (CHART:format "":gsub("a =", "b ="):gsub("'a'", "'b'")))
    local _, err = run(command)
    local new, count = helper.content(spec), { ["-"] = 0, ["+"] = 0 }
    for sign, line in err:gsub("^[^\n]*\n", "", 1):gmatch("([-+])([^\n]*)\n") do
      local from, to = old, new
      if sign == "+" then from, to = new, old end
      assert.is_truthy(from:find(line, 1, true))
      assert.is_nil(("\n" .. to):find("\n" .. line .. "\n", 1, true))
      count[sign] = count[sign] + 1
    end
    assert.is_true(count["+"] > 0 and count["-"] == count["+"])
  end)

  -- Regions that turn on their own: 3 ^ 6 configurations.
  local function turning()
    local regions = {}
    for i = 1, 6 do
      regions[i] = ([[
    r%d = rfsm.state { a = rfsm.state {}, b = rfsm.state {}, c = rfsm.state {},
      rfsm.trans { src = "initial", tgt = "a" },
      rfsm.trans { src = "a", tgt = "b", events = { "e_%d" } },
      rfsm.trans { src = "b", tgt = "c", events = { "e_%d" } },
      rfsm.trans { src = "c", tgt = "a", events = { "e_%d" } } },
]]):format(i, i, i, i)
    end
    return 'local rfsm = require "rfsm"\nreturn rfsm.state { info = false,\n'
      .. '  p = require("rfsm_seqand").new {\n' .. table.concat(regions)
      .. '  }, rfsm.trans { src = "initial", tgt = "p" } }\n'
  end

  it("writes tests as soon as each transition was taken on each event", function()
    local file = helper.file_with(turning())
    local _, err, status = run("check --tests busted --configurations 700 " .. file)
    assert.same({ "rfsm check: 25 of 25 transitions in 19 steps\n", 0 },
      { err, status })
  end)

  it("says that the exploration for tests has ended at its bound", function()
    local file = helper.file_with(turning())
    local _, err, status = run("check --tests busted --configurations 3 " .. file)
    assert.same({ "rfsm check: 7 of 25 transitions in 1 steps\nrfsm check: the "
      .. "exploration ended at its bound on configurations: what lies behind it has no "
      .. "test (--configurations N)\n", 0 }, { err, status })
  end)

  it("says that an exploration for tests has ended at many choices", function()
    local parts, tr = {}, 'rfsm.trans { src = "s%d", tgt = "s%d", events = { "e%d" }, '
      .. "guard = g }"
    for i = 1, 14 do
      for k = 1, 14 do
        parts[#parts + 1] = tr:format(i, i % 14 + 1, k)
      end
      parts[#parts + 1] = ("s%d = rfsm.state {}"):format(i)
    end
    local file = helper.file_with('local rfsm, g = require "rfsm", function() end\n'
      .. 'return rfsm.state { rfsm.trans { src = "initial", tgt = "s1" },\n'
      .. table.concat(parts, ",\n") .. " }\n")
    local _, err = run("check --tests busted --configurations 5 " .. file)
    assert.equal("rfsm check: the exploration ended at its bound on choices: what lies "
      .. "behind it has no test (--configurations N)", last_line(err))
  end)

  it("ends with the gravest of several charts", function()
    local good, odd = CHART:format "final = true", CHART:format "checks = { typ = '' }"
    for _, case in ipairs {
      { charts = { good, good }, status = 0 },
      { charts = { good, odd }, status = 0, strict = 1 },
      { charts = { "return 7", good }, status = 1 },
    } do
      local names = {}
      for i, text in ipairs(case.charts) do names[i] = helper.file_with(text) end
      local files = table.concat(names, " ")
      local out, err, status = run("check --static " .. files)
      assert.same({ "", case.status }, { err, status })
      assert.is_true(out:find(names[2], 1, true) > out:find(names[1], 1, true))
      assert.equal(case.strict or case.status,
        (select(3, run("check --static -s " .. files))))
    end
  end)
end)

describe("rfsm sim", function()
  it("hands its options to the simulator, and returns its status", function()
    local calls = {}
    local _, _, status = run("sim -e run -e step -i -r Makefile -d -q --stub README.md",
      { ["rfsm.sim.simulator"] = { main = noting(calls, 3) } })
    assert.equal(3, status)
    assert.same({ command = "sim", sim = true, file = "README.md",
      execute = { "run", "step" }, interactive = true, replay = "Makefile", dry = true,
      quiet = true, stub = true },
      calls[1][1])
  end)
end)

describe("rfsm viz", function()
  it("reads a coverage and a trace, and prints nothing of the chart", function()
    local chart = helper.file_with("local rfsm = require 'rfsm'\nreturn rfsm.state { "
      .. "dbg = print, warn = print, a = rfsm.state {}, b = rfsm.state {}, "
      .. "rfsm.trans { src = 'initial', tgt = 'a' } }")
    local coverage = helper.file_with('{"states":{"root.a":1},"transitions":{}}')
    local trace = helper.file_with('["root.a"]')
    local looks
    local encoder = { encode = function(fsm, given)
      fsm.dbg("x")
      looks = given
      return "drawn"
    end }
    local out, err, status = run(("viz -T mermaid --direction LR --depth 2 --active "
      .. "root.a --coverage %s --trace %s %s"):format(coverage, trace, chart),
      { ["rfsm.mermaid"] = encoder })
    assert.same({ "drawn\n", "", 0 }, { out, err, status })
    assert.same({ title = chart:match("[^/]+$"), depth = 2, direction = "LR",
      active = { "root.a" }, trace = { "root.a" },
      coverage = { states = { ["root.a"] = 1 }, transitions = {} } }, looks)
  end)

  it("refuses what is no coverage, and a file that is not there", function()
    local chart = helper.file_with "return 7"
    for text, problem in pairs { -- any order: each stands alone
      ['{"states":{}}'] = 'an object with "states" and "transitions" expected',
      ['{"states":{},"transitions":1}']
        = 'an object with "states" and "transitions" expected',
      ['{"states":1,"transitions":{}}']
        = 'an object with "states" and "transitions" expected',
    } do
      local file = helper.file_with(text)
      assert.same({ "", "rfsm viz: " .. file .. ": " .. problem .. "\n", 1 },
        { run(("viz --coverage %s %s"):format(file, chart)) })
    end
    local file = helper.file_with '{"a":1}'
    for option, problem in pairs { -- any order: each stands alone
      trace = "steps of a recording expected",
      like = "a picture of rfsm viz expected",
    } do
      assert.same({ "", "rfsm viz: " .. file .. ": " .. problem .. "\n", 1 },
        { run(("viz --%s %s %s"):format(option, file, chart)) })
    end
    assert.same({ "", "rfsm viz: /no/file: No such file or directory\n", 2 },
      { run("viz --trace /no/file " .. chart) })
  end)

  it("keeps the order of a former picture", function()
    local old = helper.file_with('<g id="root.on" class="node state">\n'
      .. '<g id="root.initial" class="node">\n<g id="root.off" class="node">\n')
    local graph = run(("viz --like %s examples/on_off.lua"):format(old))
    assert.matches("root_on %[.*root_initial %[.*root_off %[", graph)
    assert.same({ "", "rfsm viz: /no/old.svg: No such file or directory\n", 2 },
      { run("viz --like /no/old.svg examples/on_off.lua") })
  end)
end)

describe("rfsm snapshot diff", function()
  local OLD = "return require('rfsm').state { info = false, warn = false, "
    .. "a = rfsm.state {}, rfsm.trans { src = 'initial', tgt = 'a' }%s }"

  it("ends with status 0 if all machines move, else with 1", function()
    local old = helper.file_with(OLD:format "")
    local same = helper.file_with(OLD:format "")
    local other = helper.file_with(OLD:format ", rfsm.trans { src = 'a', tgt = 'a' }")
    local out, err, status = run(("snapshot diff %s %s"):format(old, same))
    assert.same({ "", 0 }, { err, status })
    assert.matches("nothing moves\n$", out)
    out, err, status = run(("snapshot diff %s %s"):format(old, other))
    assert.same({ "", 1 }, { err, status })
    assert.matches("^new: root.a %-> root.a\nin root.a: stays a machine", out)
    assert.equal(2, (select(3, run("snapshot diff /no/file " .. other))))
  end)
end)

describe("rfsm redis", function()
  local function modules(calls)
    return {
      ["rfsm.redis"] = { bundle = noting(calls, "the library", { "a warning" }),
        name_of = function(text) return text:match("^(.*)=(.*)$") end },
      ["rfsm.fleet"] = { connect = noting(calls, {
        load = function(_, text)
          calls[#calls + 1] = { "load", text }
          return true
        end,
        stats = function() return "numbers\n" end,
        charts = function() return { new = {} } end,
        ask = function(_, name) return not calls[3] and name == "rfsm_find" end,
        versions = function()
          return { { chart = "old", known = "gone", version = "1-2", count = 1 },
            { chart = "new", known = "gone", version = "3-4", count = 2 },
            { chart = "new", known = "newest", version = "5-6", count = 7 } }
        end,
      }) },
    }
  end

  it("bundles charts with its options, and prints warnings", function()
    local calls = {}
    local out, err, status = run("redis --index --history 5 --ids 6 --ids-for 7 "
      .. "Makefile README.md",
      modules(calls))
    assert.same({ "the library", "rfsm redis: a warning\n", 0 }, { out, err, status })
    local options = { index = true, history = 5, ids = 6, ids_for = 7 }
    assert.same({ { { "Makefile", "README.md" }, options } }, calls)
  end)

  it("loads the library into a server, and prints it if it is asked to", function()
    for options, expected in pairs { [""] = "", ["-o - "] = "the library" } do
      local calls = {}
      local out, err = run("redis " .. options .. "-l redis://x README.md",
        modules(calls))
      assert.same({ expected, "rfsm redis: a warning\nrfsm redis: the library "
        .. "before was made with --index, this one is not\nrfsm redis: 1 machine of "
        .. "old cannot run until it is loaded, too\nrfsm redis: 2 machines of new: "
        .. "version 3-4 is not loaded, those that do not fit the newest one cannot run "
        .. "until both are: rfsm redis new=OLD.lua new=NEW.lua ... --load "
        .. "redis://x\n" },
        { out, err })
      assert.same({ { { "README.md" }, {} }, { "redis://x" },
        { "load", "the library" } }, calls)
    end
  end)

  it("prints the numbers of a server", function()
    local calls = {}
    assert.same({ "numbers\n", "", 0 }, { run("redis --stats redis://x",
      modules(calls)) })
    assert.same({ { "redis://x" } }, calls)
  end)

  it("says in a line why it cannot connect or bundle", function()
    local function fail() error("no server\nhere", 0) end
    assert.same({ "", "rfsm redis: no server\n", 1 }, { run("redis --stats x",
      { ["rfsm.fleet"] = { connect = fail } }) })
    assert.same({ "", "rfsm redis: no server\n", 1 }, { run("redis --stats x",
      { ["rfsm.fleet"] = { connect = function() return { stats = fail } end } }) })
    assert.same({ "", "rfsm redis: no server\n", 1 }, { run("redis README.md",
      { ["rfsm.redis"] = { bundle = fail } }) })
  end)

  it("compares the last two versions of a chart", function()
    local compared = {}
    local all = modules {}
    for _, case in ipairs { { is_safe = true, status = 0 }, { is_safe = false,
      status = 1 } } do
      all["rfsm.cli.snapshot"] = { compare = noting(compared, case.is_safe),
        add_arguments = function(parser) parser:argument "x" end }
      local out, _, status = run("redis --diff a=1 b=2 a=3 a=4", all)
      assert.same({ "a: 1 -> 3\na: 3 -> 4\n", case.status }, { out, status })
    end
    assert.same({ { "1", "3" }, { "3", "4" }, { "1", "3" }, { "3", "4" } }, compared)
    assert.same({ "", "rfsm redis: --diff: two versions of a chart expected\n", 2 },
      { run("redis --diff a=1 b=2", all) })
  end)
end)

describe("rfsm fleet", function()
  local REPLY = { leaf = "root.a", mode = "done", outcome = "(it)",
    errors = { "no arm", "no leg" } }
  local REPLIED = "root.a done (it)\nerror: no arm\nerror: no leg\n"
  local NOTED = "root.a (it)\nerror: no arm\nerror: no leg\n"

  for command, case in pairs { -- any order: each stands alone
    ["find door root.a 5 60"] = { called = { "door", "root.a", 5, "60" },
      result = { "m:{0}:1", "m:{0}:2" }, out = "m:{0}:1\nm:{0}:2\n" },
    ["get k"] = { called = { "k" }, result = { leaf = "root.a", data = { n = 1 },
      is_held = false }, out = 'data: {"n":1}\nis_held: false\nleaf: root.a\n' },
    ["history k 2"] = { called = { "k", "2" }, result = { { time = 1.5, event = "e_x",
      from = "root.a", to = "root.b" } }, out = "1.500 e_x: root.a -> root.b\n" },
    ["history k"] = { called = { "k" }, result = { { time = 1, from = "root.a",
      event = '{"id":"b8","name":"e_batch"} e_x', to = "root.a" } },
      out = '1.000 e_batch{id="b8"} e_x: root.a -> root.a\n' },
    ["why k e_x"] = { called = { "k", "e_x" }, result = { "one", "two" },
      out = "one\ntwo\n" },
    ["send k e_x"] = { called = { nil, nil, "k", "e_x" }, method = "send_by",
      result = REPLY, out = REPLIED },
    ["send k e_x my-1 --by ann"] = { called = { "ann", "my-1", "k", "e_x" },
      method = "send_by", result = REPLY, out = REPLIED },
    ["hold k --by ann"] = { called = { "k", nil, "ann" }, result = REPLY,
      out = "k " .. NOTED },
    ["move k --by ann"] = { called = { "k", "ann" }, result = REPLY,
      out = "k " .. NOTED },
    ["release k --by ann"] = { called = { "k", "ann" }, result = REPLY,
      out = "k " .. NOTED },
    ["force k root.a --by ann"] = { called = { "k", "root.a", "ann" }, result = REPLY,
      out = "k " .. NOTED },
    ["remove k --by ann"] = { called = { "k", "ann" }, result = true,
      out = "k c root.b (remove)\n" },
    ["remove bad"] = { called = { "bad" }, result = true, out = "bad (remove)\n" },
    ["dead 9"] = { called = { 9 }, result = { { tag = 0, id = "1-0", machine = "k",
      what = "done", data = "{}", deliveries = 3, error = "no stock" } },
      out = "0 1-0 k done {} x3 no stock\n" },
    ["tick k"] = { called = { "k" }, result = REPLY, out = "k " .. REPLIED },
    ["pull k"] = { called = { "k" }, result = "{}\n", out = "{}\n" },
    ["set k a=x --by ann"] = { called = { "k", "a", "x", "ann" }, result = REPLY,
      out = "k " .. NOTED, refused = 2 },
    ["set k root.b.a=[1] --by ann"] = { called = { "k", "root.b.a", { 1 }, "ann" },
      result = REPLY, out = "k " .. NOTED, refused = 2 },
    ["push k README.md --if-version 3000000000 --by ann"] = { called = { "k",
      helper.content "README.md", 3000000000, "ann" }, result = REPLY,
      out = "k " .. NOTED, refused = 2 },
    ["again 0 1-0"] = { called = { "0", "1-0" }, result = true,
      out = "0 1-0 k pick (again)\n" },
    ["drop 0 1-0"] = { called = { "0", "1-0" }, result = true,
      out = "0 1-0 k pick (drop)\n" },
    ["cancel k my-1"] = { called = { "k", "my-1" }, result = true,
      out = "k my-1 (cancel)\n" },
  } do
    local verb = command:match "%l+"

    -- Runs the command with a client that does this.
    local function with_client(act)
      local calls, client = {}, { find_tags = function() return {} end,
        key_of = function(_, key) return key end,
        get = function(_, key)
          if key == "bad" then return nil, "ERR rfsm_get: it is no machine" end
          return { chart = "c", leaf = "root.b" }
        end,
        dead = function()
          return { { tag = "0", id = "1-0", machine = "k", what = "pick" } }
        end }
      client[case.method or verb] = function(_, ...)
        calls[2] = { ... }
        return act()
      end
      local out, err, status = run("fleet --tags 2 redis://x " .. command,
        { ["rfsm.fleet"] = { connect = noting(calls, client) } })
      assert.same({ { "redis://x", { tags = 2 } }, case.called }, calls)
      return { out, err, status }
    end

    it("prints the result of " .. command, function()
      assert.same({ case.out, "", 0 },
        with_client(function() return helper.copy_of(case.result) end))
    end)

    it("says in a line why it cannot " .. command, function()
      local function fail() error("no server\nhere", 0) end
      local function refuse() return nil, "no server" end
      for _, act in ipairs { fail, verb ~= "dead" and refuse or nil } do
        assert.same({ "", "rfsm fleet: no server\n", act == refuse and case.refused
          or 1 }, with_client(act))
      end
    end)

    if case.result == true then
      it("says that there is nothing to " .. verb, function()
        assert.same({ "", "rfsm fleet: it is not there\n", 1 },
          with_client(function() return false end))
      end)
    end
  end

  for command, needed in pairs { -- any order: each stands alone
    ["find door"] = "find CHART STATE [LIMIT [SECONDS]]", ["get"] = "get KEY",
    ["history"] = "history KEY [N]", ["why k"] = "why KEY EVENT",
    ["send k"] = "send KEY EVENT [ID]", ["hold"] = "hold KEY [WHY]",
    ["log"] = "log KEY [N]", ["move"] = "move KEY", ["release"] = "release KEY",
    ["force k"] = "force KEY STATE", ["remove"] = "remove KEY",
    ["again 0"] = "again TAG ID", ["drop 0"] = "drop TAG ID",
  } do
    it("needs more than " .. command, function()
      assert.same({ "", refusal("rfsm fleet", needed .. " expected"), 2 },
        { run("fleet redis://x " .. command) })
    end)
  end

  for arguments, problem in pairs { -- any order: each stands alone
    ["get --where chart=c"] = "get takes no --where",
    ["set k n=1 --dry-run"] = "set takes no --dry-run",
    ["release k --where chart=c"] = "release: --where or KEY expected, not both",
    ["hold --where age=x"] = "--where: age=SECONDS expected, got 'x'",
    ["remove --where chart="] = "--where: chart=NAME expected, got ''",
    ["tick --where state=root.a,chart=c,state="] = "--where: 'state' is there twice",
    ["list x"] = "list expected, got 1 arguments: 'x'",
    ["hold --where ,"] = "--where: a filter expected",
    ["hold --where chart=c,stat=x"] = "--where: age=, chart=, held=, key=, reason=, "
      .. "state=, version= expected, got 'stat=x' (did you mean 'state'?)",
    ["hold --where c"] = "--where: age=, chart=, held=, key=, reason=, state=, "
      .. "version= expected, got 'c'",
    ["release --where held=maybe"] = "--where: held=yes or held=no expected, got "
      .. "'maybe'",
    ["force --where chart=c"] = "force --where FILTER STATE expected",
    ["force k root.a --where chart=c"] = "force: --where or KEY STATE expected, not "
      .. "both",
    ["set k n=1 n=2"] = "set KEY FIELD=VALUE expected, got 3 arguments: 'k', 'n=1', "
      .. "'n=2'",
    ["remove k l"] = "remove KEY expected, got 2 arguments: 'k', 'l'",
    ["set k n=1 --if-version 3"] = "set takes no --if-version",
    ["tick k --by ann"] = "tick takes no --by",
    ["get k --if-version 3 --force --by ann"] = "get takes no --by",
    ["again 0 1-0 --where age=1"] = "again: --where or TAG ID expected, not both",
  } do
    it("refuses " .. arguments, function()
      assert.same({ "", refusal("rfsm fleet", problem), 2 },
        { run("fleet redis://x " .. arguments) })
    end)
  end

  -- Runs the command with a client that finds two machines and three dead entries.
  local function with_many(arguments, calls)
    local client = {
      find_tags = function() return {} end,
      get = function() return { chart = "c", leaf = "root.a" } end,
      charts = function() return { c = { "root", "root.a", "root.bay" } } end,
      select = function(_, filter)
        calls[#calls + 1] = filter
        if filter.chart == "none" or filter.state == "root.by" then return {} end
        if filter.chart == "lost" then return nil, "no answer from 7" end
        return { { key = "k1", chart = "c", leaf = "root.a", known = "newest",
          seconds = 7, held = true, reason = "no arm" },
          { key = "k2", chart = "c", leaf = "root.a", known = "gone" } }
      end,
      dead = function()
        local list = {}
        for i = 1, 3 do
          list[i] = { tag = "0", id = i .. "-0", machine = "k" .. i, what = "pick" }
        end
        return list
      end,
    }
    for _, name in ipairs { "hold", "release", "again", "remove", "tick" } do
      client[name] = function(_, ...)
        calls[#calls + 1] = { name, ... }
        if name == "tick" and #calls == 3 then error("no answer\nfrom 7", 0) end
        if ({ ... })[1] == "k2" then return nil, "ERR rfsm_hold: it is held already" end
        return (name == "remove" or name == "again") or helper.copy_of(REPLY)
      end
    end
    return { run("fleet redis://x " .. arguments,
      { ["rfsm.fleet"] = { connect = function() return client end } }) }
  end

  it("does a verb for many machines, or shows them", function()
    local calls, is_one = {}, "k1 c root.a newest 7 s held: no arm\n"
    assert.same({ is_one .. "k2 c root.a gone\n", "rfsm fleet: 2 found, nothing was "
      .. "done\n", 0 }, with_many("hold --dry-run --where chart=c,d,state=root.a,"
      .. "version=gone,age=60", calls))
    assert.same({ { chart = "c,d", state = "root.a", version = "gone", age = "60" } },
      calls)
    calls = {}
    assert.same({ "k1 root.a (it); error: no arm; error: no leg\n",
      "rfsm fleet: k2 c root.a gone: ERR rfsm_hold: it is held already\n"
      .. "rfsm fleet: 1 of 2 done\n", 1 },
      with_many("hold why --where chart=c --by ann", calls))
    assert.same({ { chart = "c" }, { "hold", "k1", "why", "ann" },
      { "hold", "k2", "why", "ann" } }, calls)
    assert.same({ "k1 root.a done (it); error: no arm; error: no leg\n",
      "rfsm fleet: 1 of 2 done, then: no answer\n", 1 },
      with_many("tick --where chart=c", {}))
    assert.same({ "k1 c root.a\n", "rfsm fleet: 1 found, nothing was done\n", 0 },
      with_many("force k1 root.b --dry-run", {}))
    for _, verb in ipairs { "hold", "again" } do
      assert.same({ "", "rfsm fleet: no answer from 7; nothing was done\n", 1 },
        with_many(verb .. " --where chart=lost", {}))
    end
    for filter, hint in pairs { ["chart=none"] = " (there is 'c')", -- any order: each
      ["state=root.by"] = " (did you mean 'root.bay'?)" } do -- stands alone
      assert.same({ "", "rfsm fleet: no machine is like that, so nothing was done"
        .. hint .. "\n", 2 }, with_many("remove --where " .. filter, calls))
      assert.same({ "", "rfsm fleet: 0 machines" .. hint .. "\n", 0 },
        with_many("list --where " .. filter, calls))
    end
  end)

  it("lists machines, and counts them by chart and state", function()
    local OUT = { "k1 c root.a newest 7 s held: no arm\nk2 c root.a gone\n",
      "rfsm fleet: 2 machines: c root.a 2\n", 0 }
    local calls = {}
    assert.same(OUT, with_many("list", calls))
    assert.same(OUT, with_many("list --where age=0", calls))
    assert.same(OUT, with_many("list --where 'reason=no arm,key=k*'", calls))
    assert.same({ {}, { age = "0" }, { reason = "no arm", key = "k*" } }, calls)
  end)

  it("sends dead entries of many machines again", function()
    local calls = {}
    assert.same({ "0 1-0 k1 pick (again)\n0 2-0 k2 pick (again)\n",
      "rfsm fleet: 2 of 2 done\n", 0 }, with_many("again --where chart=c", calls))
    assert.same({ { chart = "c" }, { "again", "0", "1-0" }, { "again", "0", "2-0" } },
      calls)
    for _, age in ipairs { "0", "60" } do
      assert.same({ "0 1-0 k1 pick (again)\n0 2-0 k2 pick (again)\n0 3-0 k3 pick "
        .. "(again)\n", "rfsm fleet: 3 of 3 done\n", 0 },
        with_many("again --where age=" .. age, calls))
    end
    assert.same({ "", "rfsm fleet: it is not there; nothing was done\n", 1 },
      with_many("again 0 7-0", calls))
    assert.same({ "", "rfsm fleet: no entry is like that, so nothing was done (there "
      .. "is 'c')\n", 2 },
      with_many("again --where chart=none", calls))
  end)

  it("pulls a machine into a file", function()
    local file = helper.file_with("the one before")
    local client = { pull = function() return '{"leaf":"root.a"}\n' end }
    local modules = { ["rfsm.fleet"] = { connect = function() return client end } }
    assert.same({ "", "", 0 }, { run("fleet redis://x pull k " .. file, modules) })
    assert.equal('{"leaf":"root.a"}\n', helper.content(file))
    assert.same({ "", "rfsm fleet: /nowhere/m.json.part: No such file or directory\n",
      1 }, { run("fleet redis://x pull k /nowhere/m.json", modules) })
  end)

  it("sets a value, or says why it is none", function()
    for text, problem in pairs { -- any order: each stands alone
      ["set k a"] = "FIELD=VALUE expected, got 'a'",
      ["set k a=[1"] = "data: ',' or ']' expected, got the end",
      ["push k nothing.json"] = "nothing.json: No such file or directory",
    } do
      assert.same({ "", "rfsm fleet: " .. problem .. "\n", 2 }, with_many(text, {}))
    end
  end)

  it("lists the verbs by their arguments", function()
    assert.equal([=[
   again drop TAG ID   cancel KEY ID   charts list reindex versions
   create KEY CHART [FIELD=VALUE...]   dead [LIMIT]   due [LIMIT [TIME]]
   find CHART STATE [LIMIT [SECONDS]]   force KEY STATE   history log KEY [N]
   get move release remove tick KEY   hold KEY [WHY]   pull KEY [FILE]
   push KEY FILE   send KEY EVENT [ID]   set KEY FIELD=VALUE   why KEY EVENT
]=], run("help fleet"):match("Verbs:\n(.*)"))
  end)
end)

describe("rfsm postgres", function()
  it("bundles charts with its options, and prints warnings", function()
    local calls = {}
    local bundle = { sql = noting(calls, "the schema", { "a warning" }) }
    assert.same({ "the schema", "rfsm postgres: a warning\n", 0 },
      { run("postgres --history --notify --ids 6 --ids-for 7 "
      .. "Makefile README.md",
        { ["rfsm.postgres.script"] = bundle }) })
    assert.same({ { { "Makefile", "README.md" },
      { history = true, notify = true, ids = 6, ids_for = 7 } } }, calls)
  end)
end)

describe("rfsm web", function()
  local function modules(calls, failure)
    local server = { url = "http://x", run = function() error(failure, 0) end }
    return { ["rfsm.web"] = { open = noting(calls, server),
      attach = noting(calls, server) } }
  end

  it("opens the page of a chart", function()
    local calls, file = {}, helper.file_with ""
    local out, err, status = run("web --stub -p 0 --host 0.0.0.0 " .. file,
      modules(calls, "interrupted!"))
    assert.same({ "http://x\n", "", 0 }, { out, err, status })
    assert.same({ { file, { host = "0.0.0.0", port = 0, stub = true } } }, calls)
    assert.equal(2, (select(3, run("web /no/file", modules(calls)))))
  end)

  it("attaches to a machine elsewhere", function()
    local calls = {}
    run("web -a robot -m 2", modules(calls, "interrupted!"))
    run("web -a robot:7", modules(calls, "interrupted!"))
    local page = { host = "127.0.0.1", port = 8044, machine = 2, stub = false }
    assert.same({ "robot", 44044, page }, calls[1])
    page.machine = nil
    assert.same({ "robot", 7, page }, calls[2])
  end)

  it("raises what is no interrupt", function()
    assert.same({ false, "no page" }, { pcall(run, "web -a robot", modules({},
      "no page")) })
  end)
end)

describe("rfsm watch", function()
  it("prints what comes from host and port", function()
    local calls = {}
    local _, err, status = run("watch -m 2 -n 3 robot:65535", {
      ["rfsm.observe.subscriber"] = { connect = noting(calls, "client") },
      ["rfsm.proto.follow"] = { run = noting(calls) },
      ["rfsm.sim.terminal"] = { is_terminal = noting(calls, true) },
    })
    assert.same({ "", 0 }, { err, status })
    assert.same({ { "robot", 65535 }, { 1 },
      { "client", { number = 2, count = 3, is_terminal = true } } }, calls)
  end)

  it("says why it cannot", function()
    assert.same({ "", "rfsm watch: no socket\n", 1 }, { run("watch robot",
      { ["rfsm.observe.subscriber"] = { connect = noting({}, nil, "no socket") } }) })
  end)
end)

describe("what commands share", function()
  it("gives the streams back after a call", function()
    local stream, out, err = new_stream(), io.stdout, io.stderr
    local printer, default = rawget(_G, "print"), io.output()
    local function write(a, b)
      rawget(_G, "print")(a, nil, b)
      io.stdout:write("o")
      io.stderr:write("e")
      return 1, 2, 3
    end
    assert.same({ true, 1, 2, 3 }, { common.with_streams(stream, write, "a", 7) })
    assert.equal("a\tnil\t7\noe", stream.text)
    assert.is_false((common.with_streams(stream, error, "x")))
    assert.same({ out, err, printer, default },
      { io.stdout, io.stderr, rawget(_G, "print"), io.output() })
  end)
end)

describe("a system that is opened as a chart", function()
  local file = "examples/systems/stop/cell.lua"
  local HINT = ": no valid rfsm in file '" .. file .. "' found. (it is a system, which "
    .. "rfsm check, rfsm sim and rfsm.system.load open)"

  for _, command in ipairs { "viz", "dot", "mermaid", "plantuml", "json" } do
    it("is named by rfsm " .. command, function()
      assert.same({ "", "rfsm " .. command .. HINT .. "\n", 1 },
        { run(command .. " -o - " .. file) })
    end)
  end

  it("is named by the page", function()
    assert.same({ false, { HINT:sub(3) } },
      { require("rfsm.shared.chart").open(file, error) })
  end)
end)

describe("a chart that reads a global of its robot", function()
  local STUB = " (the option --stub loads the chart without it)"

  -- Returns what rfsm viz complains of, without the file.
  local function complaint(text)
    local file = helper.file_with(text)
    local _, err = run("viz -o - " .. file)
    return err:match("rfsm viz: .-:%d+: ([^\n]*)\n$")
  end

  it("names the option --stub", function()
    for _, text in ipairs { "local c = rtt.getTC()", "robot_setup()",
      "local rtt = rtt local c = rtt.getTC()", "require 'rttlib'" } do
      assert.equal(STUB, complaint(text):sub(-#STUB))
    end
  end)

  it("names the function of the library that has this name", function()
    assert.matches(" %(did you mean rfsm%.trans%?%)$", complaint "return trans {}")
  end)

  it("does not if `rfsm` is misspelt, or a local variable is nil", function()
    for _, text in ipairs { "return rfms.state {}", "local p local n = p.name" } do
      assert.is_nil(complaint(text):find("--stub", 1, true))
    end
  end)
end)
