-- The project holds together: rockspecs, examples, the code in the documents.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local share = require "spec.support.share"

after_each(helper.remove_files)

local content, files, lines_of = helper.content, helper.files, helper.lines_of
local setfenv = rawget(_G, "setfenv")
local load_text = rawget(_G, "loadstring") or rawget(_G, "load")

-- Loads a text so that its globals are those of `env`, on every Lua.
local function load_in(env, text, name)
  local chunk = assert(load_text(text, name, "t", env))
  if setfenv then setfenv(chunk, env) end
  return chunk
end

local function rockspec(name)
  local env = {}
  load_in(env, content(name), "@" .. name)()
  return env
end

local DEV = "rockspec/rfsm-dev-1.rockspec"

-- rfsm/pp.lua is the module rfsm.pp, compat/rfsm_emem.lua the module rfsm_emem.
local function modules_of(...)
  local modules = {}
  for _, file in ipairs(files(...)) do
    modules[file:gsub("^compat/", ""):gsub("%.lua$", ""):gsub("/", ".")] = file
  end
  return modules
end

local function tools_in_tree()
  local tools = {}
  for _, file in ipairs(files("tools/rfsm*")) do tools[file:match("[^/]*$")] = file end
  return tools
end

describe("the rockspec", function()
  it("lists the modules", function()
    assert.same(modules_of("*.lua", "rfsm/*.lua", "rfsm/*/*.lua", "compat/*.lua"),
      rockspec(DEV).build.modules)
  end)

  it("lists the tools", function()
    assert.same(tools_in_tree(), rockspec(DEV).build.install.bin)
  end)

  it("of a release differs in version, source and homepage", function()
    local release, dev = {}, rockspec(DEV)
    local text = helper.output_of("arg = { '1.2.3', 'git+https://x.org/100%.git' } "
      .. "dofile 'tools/rockspec.lua'")
    load_in(release, text, "=rockspec")()
    assert.equal("1.2.3-1", release.version)
    assert.same({ url = "git+https://x.org/100%.git", tag = "v1.2.3" }, release.source)
    assert.equal("https://x.org/100%", release.description.homepage)
    release.version, release.source = dev.version, dev.source
    release.description.homepage = nil
    assert.same(dev, release)
  end)
end)

describe("the file dist/rfsm-all.lua", function()
  it("has time events, regions, the printed machine, history and checks", function()
    local folder = os.tmpname()
    os.remove(folder)
    os.execute(("make -s DIST='%s' LUA='%s' dist >/dev/null"):format(folder, arg[-1]))
    local output = helper.output_of(([[
      package.path = ""
      local rfsm, now = dofile("%s/rfsm-all.lua"), 0
      local state, trans = rfsm.state, rfsm.trans
      require("rfsm_timeevent").set_gettime_hook(function() return now, 0 end)
      require "rfsm.history"
      local model = state { info = false, warn = false,
        par = rfsm.seqand { x = state { history = "deep", a = state {},
          trans { src = "initial", tgt = "a" } } },
        wait = state {},
        trans { src = "initial", tgt = "wait" },
        trans { src = "wait", tgt = "par", events = "e_after(2)" } }
      local fsm = assert(rfsm.init(model))
      rfsm.run(fsm)
      now = 3
      rfsm.run(fsm)
      print(rfsm.pp.fsm2str(fsm))
      print(require("rfsm_checks").explore(model))
    ]]):format(folder))
    local hashes = lines_of("cd '" .. folder .. "' && sha256sum -c SHA256SUMS")
    os.execute("rm -r '" .. folder .. "'")
    assert.same({ "rfsm.lua: OK", "rfsm-all.lua: OK" }, hashes)
    assert.matches("par[LS] active", output, 1, true)
    assert.matches("3 of 3 transitions taken", output, 1, true)
  end)
end)

describe("a core alone in a folder", function()
  local folder, lua = os.tmpname(), arg[-1]

  -- Specs of the core, and what of them needs a module that is missing there.
  local SPECS = {
    { name = "transition" }, { name = "doo" },
    { name = "machine", hint = "machines of one model report the same of their model" },
    { name = "contract",
      hint = "FIX fsm_merge: changes nothing when it cannot, and says why, to err as "
        .. "well" },
    { name = "robust",
      hint = "a machine has an initial that stands where its first transition does" },
    { name = "idioms" },
    { name = "live", hint = "a merge into a live machine that is refused leaves no "
      .. "trace in the next one" },
  }

  setup(function()
    os.remove(folder)
    assert(os.execute(("mkdir -p 'F/alone/rfsm' && cp -r spec 'F' && cp -r spec "
      .. "rfsm.lua 'F/alone' && cp rfsm/tools.lua rfsm/prepare.lua rfsm/merge.lua "
      .. "rfsm/fates.lua rfsm/always.lua 'F/alone/rfsm' && '%s' tools/dist.lua rfsm "
      .. "rfsm.fast rfsm.always "
      .. "rfsm.advice rfsm.tools rfsm.prepare rfsm.merge rfsm.fates >'F/rfsm.lua'")
      :gsub("F", folder):format(lua)))
  end)

  teardown(function() os.execute("rm -r '" .. folder .. "'") end)

  -- Runs the share of the specs there; returns what fails, and the hints.
  local function results_in(place)
    local names, hints, failed, count = {}, {}, {}, 0
    for i, spec in ipairs(share.of(SPECS)) do
      names[i] = "spec/" .. spec.name .. "_spec.lua"
      hints[#hints + 1] = spec.hint
    end
    for _, line in ipairs(lines_of(("cd '%s' && busted --lua=$(command -v '%s') "
      .. "--lpath=./?.lua -o TAP %s 2>&1"):format(place, lua,
      table.concat(names, " ")))) do
      local name = line:match("^not ok %d+ %- (.*)")
      count = count + (line:find("^ok") and 1 or 0)
      failed[#failed + 1] = name
    end
    table.sort(failed)
    table.sort(hints)
    assert.is_true(count > 10 * #names, count .. " passed")
    return failed, hints
  end

  it("does what it does here, as dist/rfsm.lua", function()
    assert.same({}, (results_in(folder)))
  end)

  it("does so as rfsm.lua with its parts, but for hints", function()
    local failed, hints = results_in(folder .. "/alone")
    assert.same(hints, failed)
  end)

  it("brings generated code into a sandbox without require", function()
    assert.equal("true", helper.output_of(([[
      local text, load = io.open("%s/rfsm.lua"):read("*a"), loadstring or load
      require, package, loadfile = nil, nil, nil
      local rfsm = load(text)()
      local fsm = rfsm.init(rfsm.state { info = false, warn = false, a = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "a", events = "e" } })
      for _ = 1, 9 do rfsm.send_events(fsm, "e") rfsm.run(fsm) end
      print(rfsm.get_actleaf_fqn(fsm) == "root.a")
    ]]):format(folder)))
  end)
end)

describe("rfsm size", function()
  -- Returns the rows of a table: lists of numbers by name; and the other lines.
  local function table_of(command)
    local rows, others = {}, {}
    for _, line in ipairs(lines_of(command .. " 2>&1")) do
      local name, cells = line:match("^(.-)  +([%d ]+)$")
      if name then
        rows[name] = {}
        for cell in cells:gmatch("%d+") do table.insert(rows[name], tonumber(cell)) end
      else
        others[#others + 1] = line
      end
    end
    return rows, others
  end

  local function has_program(name) return lines_of("command -v " .. name)[1] end

  local function size(file, lua)
    return table_of(("LUA='%s' tools/rfsm size --lua '%s' %s"):format(arg[-1], lua,
      file))
  end

  it("prints heap and pool, from source and stripped, and what modules add", function()
    local rows, others = size("examples/on_off.lua", arg[-1])
    local chart = rows["on_off.lua: 2 states, 3 transitions"]
    local together, library = rows.together, rows["rfsm and rfsm.rtt"]
    local base = rows["Lua with RTT and a launch"]
    local modules = rows["modules that the chart loads"]
    for i, kib in ipairs(base) do
      assert.equal(({ 112, 156, 104, 140 })[i], kib) -- measured once, as doc/rtt.md has
      local sum = kib + library[i] + modules[i] + chart[i]
      assert.is_true(math.abs(together[i] - sum) <= 2) -- they are rounded
    end
    for _, name in ipairs { "+ rttlib and utils", "+ rfsmpp", "+ rfsm.record",
      "+ rfsm.proto" } do
      assert.is_true(rows[name][1] > 0)
    end
    local pool = others[#others]:match("^launch { pool = (%d+) } leaves room for")
    assert.is_true(together[2] < pool + 0 and pool % 50 == 0)
    local compiler = "luac" .. _VERSION:match "[%d.]+$"
    if rawget(_G, "jit") or _VERSION > "Lua 5.2" or has_program(compiler) then
      assert.is_true(library[3] < library[1] and library[4] < library[2])
    end
  end)

  it("shows what modules take that a chart loads, also those of the tools", function()
    for file, least in pairs { on_off = 0, timeevent = 40, checks = 30 } do
      local modules = size("examples/" .. file .. ".lua", arg[-1])
        ["modules that the chart loads"][1]
      -- rounded
      assert.is_true(modules >= least - 1 and modules < least + 160)
    end
  end)

  it("shows that the library and a launch take 590 KiB, stripped 440", function()
    if not (has_program "lua5.1" and has_program "luac5.1") then return end -- of RTT
    local rows = size("examples/on_off.lua", "lua5.1")
    assert.is_true(rows.together[2] <= 590 and rows.together[4] <= 440)
    assert.is_true(rows.together[3] < rows.together[1])
  end)

  it("has no columns of stripped code without the compiler of Lua 5.1", function()
    local lua = has_program "lua5.1"
    if not lua then return end
    local rows = size("examples/on_off.lua", "env PATH=/nowhere " .. lua)
    assert.same({ 2, 2 }, { #rows.together, #rows["+ rfsm.record"] })
  end)

  it("reports a chart with a problem, and a Lua that is not there", function()
    local file = helper.file_with("return 3")
    for lua, text in pairs { [arg[-1]] = file, ["no-such-lua"] = "no-such-lua: " } do
      local rows, others = size(file, lua)
      assert.same({}, rows)
      assert.is_truthy(others[1]:find(text, 1, true))
      assert.matches("^rfsm size: ", others[1])
    end
  end)
end)

describe("make help", function()
  it("fits a terminal", function()
    local lines = lines_of("make -s help")
    assert.is_true(#lines > 10 and #lines <= 24)
  end)
end)

describe("make -sn", function()
  for target, options in pairs { ["test-all"] = "", test = "--quick ", -- any order
    check = "--quick " } do
    it(target .. " prints the commands, and runs none", function()
      local lines = lines_of("make -sn " .. target .. " LUA=no-such-lua "
        .. "LUAS=no-such-lua 2>&1; echo $?")
      assert.matches("tools/test.sh " .. options .. "no-such-lua", lines[2], 1, true)
      assert.same({ "0" }, { lines[3], lines[4] })
    end)
  end
end)

describe("the command", function()
  -- Returns which of these Luas runs it; those in `with` have argparse, those in `own`
  -- the package of the command, those in `socket` luasocket, by default all.
  local function chosen(names, with, command, own, socket)
    local folder = os.tmpname()
    os.remove(folder)
    os.execute("mkdir " .. folder .. "; ln -s $(command -v readlink) " .. folder)
    local function status(list, name) return list:find(name, 1, true) and 0 or 1 end
    for name in names:gmatch("%S+") do
      local text = "#!/bin/sh\n[ \"$1\" = -e ] || { echo %s; exit; }\ncase $2 in\n"
        .. "*redis*socket*) exit $((%d | %d));;\n*redis*) exit %d;;\n"
        .. "*argparse*) exit %d;;\nesac\n"
      local has_own = status(own or "", name)
      helper.write(folder .. "/" .. name, text:format(name, has_own,
        status(socket or names, name), has_own, status(with, name)))
      os.execute("chmod +x " .. folder .. "/" .. name)
    end
    local lines = lines_of(("LUA= PATH=%s /bin/sh tools/rfsm %s 2>&1"):format(folder,
      command or ""))
    os.execute("rm -r " .. folder)
    return table.concat(lines, " ")
  end

  it("is run by the newest Lua that has argparse", function()
    assert.equal("lua5.3", chosen("lua5.1 lua5.3 lua5.4", "lua5.1 lua5.3"))
    assert.equal("lua5.4", chosen("lua5.1 lua5.3 lua5.4", "lua5.1 lua5.3 lua5.4"))
  end)

  it("is run by the newest one that has the package of the command", function()
    assert.equal("lua5.1", chosen("lua5.1 lua5.3", "lua5.1 lua5.3", "redis", "lua5.1"))
    assert.equal("lua5.3", chosen("lua5.1 lua5.3", "lua5.1 lua5.3", "redis", ""))
  end)

  it("is run by one that has luasocket, too, for Redis", function()
    for _, command in ipairs { "redis", "fleet" } do
      assert.equal("lua5.1", chosen("lua5.1 lua5.3", "lua5.1 lua5.3", command,
        "lua5.1 lua5.3", "lua5.1"))
    end
  end)

  it("is run by the newest one, which reports it, if none has", function()
    assert.equal("luajit", chosen("lua5.1 luajit", ""))
    assert.matches("^rfsm: no Lua found", chosen("", ""))
  end)
end)

describe("on a machine where nothing is installed", function()
  local folder = os.tmpname()

  setup(function()
    os.remove(folder)
    os.execute("mkdir " .. folder .. "; for p in sh make dirname mkdir; do "
      .. "ln -s $(command -v $p) " .. folder .. "; done")
  end)

  teardown(function() os.execute("rm -r " .. folder) end)

  -- Returns what a command prints that finds these programs only, and its status.
  local function output(command)
    return table.concat(lines_of(("{ PATH=%s LUA= %s; echo $?; } 2>&1"):format(folder,
      command)), "\n")
  end

  local NO_LUA = "no Lua is installed; please type: sudo apt-get install lua5.4\n"

  it("tools/deps.sh lua prints the last Lua there, or what to type", function()
    local lua = helper.interpreter()
    os.execute(("ln -s $(command -v %s) %s/lua5.3"):format(lua, folder))
    assert.equal("lua5.3\n0", output("tools/deps.sh lua lua5.3 lua5.4 tools/lua"))
    os.remove(folder .. "/lua5.3")
    assert.equal(NO_LUA .. "false\n0", output("tools/deps.sh lua lua5.1 lua5.3"))
  end)

  for _, target in ipairs { "house", "fuzz", "dist" } do
    it("make " .. target .. " says what to type", function()
      local text = output("make -s DIST=" .. folder .. "/dist " .. target)
      assert.equal(NO_LUA, text:sub(1, #NO_LUA))
      assert.matches("\n2$", text)
    end)
  end

  for target, packages in pairs { -- any order: each stands alone
    deb = "git build-essential dpkg-dev debhelper help2man lintian lua5.3 lua-argparse "
      .. "lua-dkjson",
    site = "lua-ldoc lua-discount lua-dkjson",
  } do
    it("make " .. target .. " lists the packages to type", function()
      assert.equal("missing; please type: sudo apt-get install " .. packages .. "\n1",
        output("tools/deps.sh " .. target))
    end)
  end

  it("make rocks lists the headers that LuaRocks wants", function()
    local text = output("tools/deps.sh rocks")
    for _, version in ipairs { "5.1", "5.2", "5.3", "5.4" } do
      local header = io.open("/usr/include/lua" .. version .. "/lua.h")
      assert.equal(header == nil, text:find("liblua" .. version .. "-dev", 1, true)
        ~= nil)
      if header then header:close() end
    end
    assert.matches("git luarocks lua5.1 ", text, 1, true)
  end)

  it("the site needs a Lua, and says so", function()
    for _, name in ipairs { "node", "npm" } do
      helper.write(folder .. "/" .. name, "#!/bin/sh\n")
      os.execute("chmod +x " .. folder .. "/" .. name)
    end
    assert.equal("make site: a Lua is missing (on Debian: apt-get install lua5.4)\n1",
      output("tools/site/build.sh " .. folder .. "/x.html"))
  end)
end)

describe("tools/test.sh", function()
  local FILES = "spec/a[lw]*_spec.lua" -- none of them needs a server
  local SPECS = #lines_of("ls " .. FILES)

  -- Runs it with a busted that does this; returns the lines, and those on stderr.
  local function run_program(program, settings, arguments)
    local busted = helper.file_with("#!/bin/sh\n" .. program)
    local messages = helper.file_with("")
    os.execute("chmod +x " .. busted)
    local command = "LINT= LIMIT= FILES='%s' %s BUSTED=%s tools/test.sh %s"
    return lines_of(("{ " .. command .. "; echo $?; } 2>%s")
      :format(FILES, settings or "PENDING=", busted, arguments or arg[-1], messages)),
      lines_of("cat " .. messages)
  end

  -- Runs it with a busted that prints this.
  local function run(text, settings)
    return run_program("cat <<EOF\n" .. text .. "EOF\n", settings)
  end

  local PASSED = "1 success / 0 failures / 0 errors / 0 pending : 0.1 seconds\n"

  it("limits the time of the processor, not that in which others had it", function()
    local lines = run_program("while :; do :; done\n",
      "LIMIT=1 FILES=spec/alloc_spec.lua")
    assert.same({ "0 passed, 1 failed, 0 pending", "1" },
      { lines[#lines - 1], lines[#lines] })
    assert.matches("spec/alloc_spec.lua used more than 1 s of the processor, did not "
      .. "end within 10 s, or crashed", table.concat(lines, "\n"), 1, true)
  end)

  it("stops what waits without end after ten times as long", function()
    local folder = os.tmpname()
    os.remove(folder)
    os.execute("mkdir " .. folder)
    helper.write(folder .. "/timeout", '#!/bin/sh\necho "$1 $2 $3" >>' .. folder
      .. '/seen\nshift 3\nexec "$@"\n')
    os.execute("chmod +x " .. folder .. "/timeout")
    local lines = run(PASSED, "LIMIT=7 PATH=" .. folder .. ":$PATH")
    local seen = lines_of("sort -u " .. folder .. "/seen")
    os.execute("rm -r " .. folder)
    assert.same({ SPECS .. " passed, 0 failed, 0 pending", "0" },
      { lines[#lines - 1], lines[#lines] })
    assert.same({ "-k 5 70" }, seen)
  end)

  it("prints a line as each interpreter ends, and the sum", function()
    local lines, messages = run("2 successes / 0 failures / 0 errors / 0 pending : 0.1 "
      .. "seconds\n")
    local sum = 2 * SPECS .. " passed, 0 failed, 0 pending"
    assert.matches("^%S+: " .. sum .. ", %d+ s$", lines[1])
    assert.same({ sum, "0" }, { lines[2], lines[3] })
    assert.is_truthy(messages[1]) -- one each 10 seconds, the first one at once
    for _, line in ipairs(messages) do
      assert.matches("^%d+ of " .. SPECS .. " files", line)
    end
  end)

  local TWO = "FILES='spec/await_spec.lua spec/rtt_spec.lua' PENDING="

  it("leaves out the files of servers and Orocos, or has them only", function()
    for setting, sum in pairs { -- any order: each stands alone
      no = "1 passed, 0 failed, 0 pending", only = "0 passed, 1 failed, 0 pending",
      [""] = "1 passed, 1 failed, 0 pending",
    } do
      local lines = run_program('case "$*" in *await*) echo "' .. PASSED:sub(1, -2)
        .. '" ;; esac', TWO .. " SERVERS=" .. setting)
      assert.equal(sum, lines[#lines - 1])
    end
  end)

  it("has a small share in a quick run, and names what was not tried", function()
    local program = 'echo "1 success / 0 failures / 0 errors / %d pending : 0.1 '
      .. 'seconds"\n[ "$RFSM_SHARE" = 1/30 ]'
    for pending, lack in pairs { -- any order: each stands alone
      [0] = "", ", what lacks a package (1)",
    } do
      local lines = run_program(program:format(pending), TWO, "--quick " .. arg[-1])
      assert.same({ "not tried: servers and Orocos (1 files), browsers, other Luas, "
        .. "most random charts" .. lack .. ": make test-all",
        "1 passed, 0 failed, " .. pending .. " pending", "0" },
        { lines[2], lines[3], lines[4] })
    end
  end)

  it("runs another command beside the specs, and fails if that does", function()
    local lines = run(PASSED, "LINT='ls nowhere'")
    assert.matches("nowhere", lines[2])
    assert.equal("1", lines[#lines])
    lines = run(PASSED, "LINT=true")
    assert.same({ SPECS .. " passed, 0 failed, 0 pending", "0" },
      { lines[2], lines[3] })
  end)

  it("counts failures and errors", function()
    local lines = run("1 success / 1 failure / 2 errors / 0 pending : 0.1 seconds\n")
    assert.same({ SPECS .. " passed, " .. 3 * SPECS .. " failed, 0 pending", "1" },
      { lines[2], lines[3] })
  end)

  it("takes a file without a test, or without an end, for an error", function()
    for text, reason in pairs { -- any order: each stands alone
      ["0 successes / 0 failures / 0 errors / 0 pending : 0.1 seconds\n"]
        = "has no test",
      ["● ●\n"] = "used more than 300 s of the processor, did not end within 3000 s",
    } do
      local lines = run(text)
      assert.same({ ("0 passed, %d failed, 0 pending"):format(SPECS), "1" },
        { lines[#lines - 1], lines[#lines] })
      assert.is_truthy(table.concat(lines, "\n"):find("spec/alloc_spec.lua " .. reason,
        1, true))
    end
  end)

  it("lists what is pending, which is no failure unless it is to be one", function()
    local text = "1 success / 0 failures / 0 errors / 1 pending : 0.1 seconds\n"
      .. "\nPending -> spec/x_spec.lua @ 1\na fleet: it is missing\n"
    local lines = run(text)
    assert.matches("^pending: a fleet: it is missing %(.*%)$", lines[2])
    assert.same({ ("%d passed, 0 failed, %d pending"):format(SPECS, SPECS), "0" },
      { lines[#lines - 1], lines[#lines] })
    lines = run(text, "PENDING=no")
    assert.equal("1", lines[#lines])
  end)
end)

describe("make figures", function()
  local file

  before_each(function()
    local makefile = helper.file_with("all:\n\t@echo working; echo $(N) of 9\n")
    file = helper.file_with(("| `make -sf F N=7` | - |\n| `make -sf F N=8` | old |\n")
      :gsub("F", makefile))
  end)

  local function renew(word)
    return helper.output_of(("arg = { '%s', '%s' } dofile 'tools/figures.lua'"):format(
      word, file))
  end

  it("puts the last line beside each command, or those with a word", function()
    renew "N=7"
    assert.matches("^| [^|]* | 7 of 9 |\n| [^|]* | old |\n$", content(file))
    renew ""
    assert.matches("^| [^|]* | 7 of 9 |\n| [^|]* | 8 of 9 |\n$", content(file))
  end)

  it("says that no command has the word, and changes nothing", function()
    local before = content(file)
    assert.equal("figures: no command in " .. file .. " contains 'N=9'", renew "N=9")
    assert.equal(before, content(file))
  end)
end)

describe("make torture", function()
  it("stops a claim that does not end, and names it", function()
    local lines = lines_of(("LIMIT=0.1 '%s' spec/support/torture.lua 1e9 1 defer")
      :format(arg[-1]))
    assert.same({ "spec/support/claims/defer.lua did not end within 0.1 s",
      "0 claims hold, 1 do not" }, lines)
  end)
end)

describe("the version of the core", function()
  it("is in the changelog", function()
    local version = rfsm._VERSION:match("[%d.]+$")
    assert.is_truthy(content("CHANGELOG.md"):find("## " .. version, 1, true))
  end)
end)

-- Modules that nobody requires but the library and its tools, as those in folders.
local IS_PRIVATE = {
  ["rfsm.advice"] = true, ["rfsm.fast"] = true,
}

describe("doc/config.ld", function()
  local text = content("doc/config.ld")

  it("lists the public modules", function()
    local listed, public = {}, {}
    for file in text:match("\nfile = (%b{})"):gmatch("'%.%./(.-)'") do
      listed[file:gsub("%.lua$", ""):gsub("/", ".")] = file
    end
    for name, file in pairs(modules_of("*.lua", "rfsm/*.lua")) do
      local is_alias = content(file):find("^return require")
      public[name] = not (is_alias or IS_PRIVATE[name]) and file or nil
    end
    for name, file in pairs(modules_of("rfsm/*/*.lua")) do -- parts of public ones
      public[name] = content(file):find("\n-- @submodule ") and file or nil
    end
    assert.same(public, listed)
  end)

  it("has each function of the core in a group", function()
    local missing, is_grouped = {}, {}
    for names in text:gmatch("\ngroup%(%u+, %[%[(.-)%]%]%)") do
      for name in names:gmatch("%S+") do is_grouped[name] = true end
    end
    for _, file in ipairs { "rfsm.lua", "rfsm/tools.lua", "rfsm/merge.lua",
      "rfsm/prepare.lua" } do
      for name in content(file):gmatch("\n *function rfsm%.([%w_]+)") do
        if not is_grouped[name] then missing[#missing + 1] = name end
      end
    end
    assert.same({}, missing)
  end)

  it("lists the documents", function()
    local listed, list = {}, text:match("\ntopics = (%b{})")
    for file in list:gmatch("'(.-)'") do
      listed[#listed + 1] = ("doc/" .. file):gsub("^doc/%.%./", "")
    end
    table.sort(listed)
    assert.same(files("*.md", ".github/*.md", "doc/*.md"), listed)
  end)
end)

-- The blocks of a document that open with ```lua: { line =, text = } each. Files, which
-- begin with their name, are left to spec/documents_spec.lua.
local function lua_blocks(file)
  local blocks, block, number = {}, nil, 0
  for line in (content(file) .. "\n"):gmatch("(.-)\n") do
    number = number + 1
    if block and line:match("^%s*```") then
      block.text = table.concat(block, "\n")
      if not block[1]:find("^%-%- %S+%.lua$") then blocks[#blocks + 1] = block end
      block = nil
    elseif block then
      block[#block + 1] = line
    elseif line:match("^%s*```lua%s*$") then
      block = { line = number + 1 }
    end
  end
  return blocks
end

-- What a block says that it prints:  print(1)  --> 1
local function promised(block)
  local lines = {}
  for _, line in ipairs(block) do
    local text = line:match("%-%->%s?(.-)%s*$")
    if text then lines[#lines + 1] = text end
  end
  return lines
end

-- The anchors of a document, as GitHub makes them of its headings.
local function anchors(file)
  local set = {}
  for heading in ("\n" .. content(file)):gmatch("\n#+ ([^\n]*)") do
    set[heading:lower():gsub("[^%w%- ]", ""):gsub(" ", "-")] = true
  end
  return set
end

-- Is there what a link in `file` leads to? Pages of the web are believed.
local function leads_somewhere(file, link)
  if link:find("^%a+:") then return true end
  local path, anchor = link:match("^([^#]*)#?(.*)$")
  local target = path == "" and file or (file:match("^.*/") or "") .. path
  local handle = io.open(target)
  if not handle then return false end
  handle:close()
  return anchor == "" or anchors(target)[anchor] == true
end

describe("a link", function()
  for _, file in ipairs(files("*.md", ".github/*.md", "doc/*.md")) do
    it("in " .. file .. " leads somewhere", function()
      local dead = {}
      for link in content(file):gmatch("%]%(([^)%s]+)%)") do
        if not leads_somewhere(file, link) then dead[#dead + 1] = link end
      end
      assert.same({}, dead)
    end)
  end
end)

-- Runs a block; returns the lines that it printed.
local function run_block(env, block, name)
  local lines = {}
  rawset(env, "print", function(...)
    for line in (table.concat(helper.texts(...), "\t") .. "\n"):gmatch("(.-)\n") do
      lines[#lines + 1] = line:match("^(.-)%s*$")
    end
  end)
  local text = ("\n"):rep(block.line - 1) .. block.text
  helper.with(_G, { print = env.print }, load_in(env, text, "@" .. name))
  return lines
end

-- The blocks of one document share their globals, as at one prompt.
describe("each block of code", function()
  for _, file in ipairs(files("*.md", ".github/*.md", "doc/*.md")) do
    it("in " .. file .. " runs, and prints what it says", function()
      local env = setmetatable({}, { __index = _G })
      for _, block in ipairs(lua_blocks(file)) do
        local printed, expected = run_block(env, block, file), promised(block)
        if expected[1] then assert.same(expected, printed, "at line " .. block.line) end
      end
    end)
  end
end)
