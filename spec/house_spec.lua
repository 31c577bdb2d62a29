-- The house: the entries at the top, and the names of modules, old ones included.

local helper = require "spec.helper"
local share = require "spec.support.share"

after_each(helper.remove_files)

local lines_of = helper.lines_of

-- The tracked files; nil in a tree without git.
local function tracked()
  local files = lines_of("git ls-files 2>/dev/null")
  return files[1] and files
end

local ENTRIES = {
  ".busted", ".ci", ".github", ".gitignore", ".luacheckrc", ".luarc.json",
  "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "Makefile", "README.md", "bench",
  "compat", "doc", "examples", "rfsm", "rfsm.lua", "rfsm_checks.lua",
  "rfsm_seqand.lua", "rfsm_timeevent.lua", "rfsmpp.lua", "rockspec", "spec", "tools",
}

describe("the tree", function()
  local files = tracked()
  if not files then return pending("git, or its folder, is missing") end

  it("has these entries at the top, at most 24", function()
    local entries, is_listed = {}, {}
    for _, file in ipairs(files) do
      local entry = file:match("^[^/]*")
      if not is_listed[entry] then entries[#entries + 1] = entry end
      is_listed[entry] = true
    end
    table.sort(entries)
    assert.same(ENTRIES, entries)
    assert.is_true(#entries <= 24)
  end)

  it("has at most 32 files directly in rfsm/, besides names of one line", function()
    local count = 0
    for _, file in ipairs(files) do
      local is_name = helper.content(file):find("^return require[^\n]*\n$")
      count = count + (file:find("^rfsm/[^/]*$") and not is_name and 1 or 0)
    end
    assert.is_true(count <= 32, count .. " files")
  end)

  it("has no file that a program made", function()
    for _, file in ipairs(files) do
      local start = helper.content(file):sub(1, 4)
      assert.is_nil(start:find("%z"), file)
      assert.is_false(start == "\27Lua" or start:sub(1, 3) == "\27LJ", file)
      assert.is_nil(file:match("%.out$") or file:match("%.rock$"), file)
    end
  end)

  -- A user's own charts may lie at the top, and nowhere else.
  it("has no file that git does not know", function()
    assert.same({}, lines_of("git ls-files --others --exclude-standard -- .ci .github "
      .. "bench compat doc examples rfsm rockspec spec tools 'rfsm*.lua'"))
  end)

  it("has one line in each file of compat/", function()
    for _, file in ipairs(files) do
      if file:find("^compat/") then
        assert.matches('^return require%("[%w_.]+"%)\n$', helper.content(file))
      end
    end
  end)
end)

describe("each exporter", function()
  -- Lists the files in which each of the patterns is found.
  local function files_with(glob, ...)
    local found = {}
    for _, file in ipairs(lines_of("ls " .. glob)) do
      local text, has_all = helper.content(file), true
      for _, pattern in ipairs { ... } do
        has_all = has_all and text:find(pattern) ~= nil
      end
      found[#found + 1] = has_all and file or nil
    end
    return found
  end

  for _, exporter in ipairs(require("rfsm.cli.exporters").list) do
    local name = exporter.name
    local module = "%f[%w]rfsm%." .. name .. "%f[^%w]"

    it(name .. " has a spec that loads it and calls its encode", function()
      assert.is_truthy(files_with("spec/*_spec.lua", 'require%(?%s*"' .. module .. '"',
        "%f[%w]" .. name .. "%.encode")[1], "rfsm." .. name)
    end)

    it(name .. " has a page with its encode and the ending of its files", function()
      assert.is_truthy(files_with("doc/*.md", "`" .. name .. "%.encode%(",
        "`[%w.]*%." .. exporter.ending .. "`")[1], "rfsm " .. name)
    end)
  end
end)

-- The global that each module sets, and the names it has.
local MODULES = {
  { "rfsm", "rfsm.rfsm" },
  { "rfsmpp", "rfsm.pp" },
  { "rfsm_timeevent", "rfsm.timeevent" },
  { "rfsm_seqand", "rfsm.seqand" },
  { "rfsm_checks", "rfsm.checks" },
  { "rfsm_checkevents", "rfsm.checkevents" },
  { "rfsm_ext", "rfsm.ext", "rfsm.monitor" },
  { "rfsm_emem", "rfsm.emem" },
  { "rfsm_await", "rfsm.await" },
  { "rfsm_preview", "rfsm.preview" },
  { "rfsm_marsh", "rfsm.marsh" },
  { "rfsm2json", "rfsm.json", "rfsm.rfsm2json" },
  { "rfsm2plantuml", "rfsm.plantuml" },
  { "rfsm2dot", "rfsm.dot" },
  { "rfsm2mermaid", "rfsm.mermaid" },
  { "rfsm_proto", "rfsm.proto" },
  { "rfsm_rtt", "rfsm.rtt" },
  { "rfsm_snapshot", "rfsm.snapshot" },
  { "rfsm_fleet", "rfsm.fleet" },
  { "rfsm_record", "rfsm.record" },
  { "rfsm_web", "rfsm.web" },
}

-- Requires the names of each module in every order, each order from the beginning, and
-- prints every name that gives another module or global than the first.
local EVERY_ORDER = [[
local function permutations(list, n, f)
  if n == 0 then return f(list) end
  for i = 1, n do
    list[i], list[n] = list[n], list[i]
    permutations(list, n - 1, f)
    list[i], list[n] = list[n], list[i]
  end
end

local function forget(t)
  for name in pairs(t) do
    if type(name) == "string" and name:find("^rfsm") then t[name] = nil end
  end
end

local function try(global, order)
  forget(package.loaded)
  forget(package.preload)
  forget(_G)
  if is_rfsm_first then require "rfsm" end
  local expected = require(order[1])
  for _, name in ipairs(order) do
    if require(name) ~= expected then print(table.concat(order, " "), name) end
  end
  local expected_global = not RFSM_NO_GLOBALS and expected or nil
  if rawget(_G, global) ~= expected_global then print("global " .. global) end
  if RFSM_NO_GLOBALS == not rawget(_G, "rfsm") then return end
  print(order[1], "global rfsm")
end

for _, names in ipairs(MODULES) do
  permutations(names, #names, function(order) try(names.global, order) end)
end
print("done in " .. debug.getinfo(require("rfsm").init, "S").source:match("^@(.*/)"))
]]

-- Is it no name that stands in compat/?
local function is_plain(name)
  return not io.open("compat/" .. name .. ".lua")
end

-- Runs that with the modules on a path, and nothing of this checkout besides; those of
-- which `has` says so, and their names for which `pred` does.
local function every_order(path, is_rfsm_first, has_no_globals, pred, has)
  local rows = {}
  for i, names in ipairs(MODULES) do
    local row = ("{ global = %q"):format(names[1])
    for _, name in ipairs(names) do
      if not pred or pred(name) then row = ("%s, %q"):format(row, name) end
    end
    if not has or has(i) then rows[#rows + 1] = row .. " }" end
  end
  return helper.output_of(([[
    package.path = %q .. (";" .. package.path .. ";"):gsub(";%%./[^;]*", "")
    local is_rfsm_first, MODULES = %s, { %s }
    RFSM_NO_GLOBALS = %s
  ]]):format(path, tostring(is_rfsm_first), table.concat(rows, ", "),
    tostring(has_no_globals)) .. EVERY_ORDER)
end

-- All modules in a row, the core first, for one file that holds them.
local function all_modules()
  local names = { "rfsm" }
  for _, file in ipairs(lines_of("ls rfsm?*.lua rfsm/*.lua rfsm/*/*.lua "
    .. "compat/*.lua")) do
    names[#names + 1] = file:gsub("^compat/", ""):gsub("%.lua$", ""):gsub("/", ".")
  end
  return table.concat(names, " ")
end

-- Where the modules are: the command that puts them into the folder @, and their path.
-- LuaRocks is asked for Lua 5.1 only; it needs the headers.
local PLACES = {
  { "make install", "make -s install STRIP=0 PREFIX=@", "@/share/lua/$/?.lua",
    undo = "make -s uninstall PREFIX=@" },
  { "luarocks make", "luarocks --lua-version=5.1 make --deps-mode none --tree @ "
    .. "rockspec/rfsm-dev-1.rockspec", "@/share/lua/5.1/?.lua", only = "Lua 5.1",
    needs = "luarocks --lua-version=5.1 config variables.LUA_INCDIR" },
  { "make dist", ("make -s dist BUNDLE='%s' DIST=@"):format(all_modules()), "@/?.lua",
    is_rfsm_first = true, has = share.has }, -- each order loads all of it
}

describe("the names of a module", function()
  it("give one module and its global in every order, beside each other", function()
    assert.equal("done in ./", every_order("./?.lua;./compat/?.lua", false, false))
  end)

  it("do so in a checkout, once rfsm is loaded", function()
    assert.equal("done in ./", every_order("./?.lua", true, false))
  end)

  it("do so in a checkout, if there is a dot in them", function()
    assert.equal("done in ./", every_order("./?.lua", false, false, is_plain))
  end)

  for _, place in ipairs(PLACES) do
    local name, command, path = place[1], place[2], place[3]
    local is_here = lines_of((place.needs or "command -v make") .. " 2>&1 | grep ^/")[1]
    if is_here and (place.only or _VERSION) == _VERSION then
      it("do so after " .. name, function()
        local folder, version = os.tmpname(), _VERSION:match("[%d.]+$")
        os.remove(folder)
        local lines = lines_of("{ " .. command:gsub("@", folder) .. "; } 2>&1")
        path = path:gsub("@", folder):gsub("%$", version)
        local output = every_order(path, place.is_rfsm_first, false, nil, place.has)
        if place.undo then
          os.execute(place.undo:gsub("@", folder))
          assert.is_nil(io.open(folder))
        end
        os.execute("rm -rf " .. folder)
        assert.equal("done in " .. path:match("^.*/"), output,
          table.concat(lines, "\n"))
      end)
    end
  end

  it("set no global after RFSM_NO_GLOBALS", function()
    assert.equal("done in ./", every_order("./?.lua", true, true))
  end)

end)

describe("the core", function()
  local function output_of(text)
    return helper.output_of("package.path = './?.lua;' .. package.path\n" .. text)
  end

  it("loads seqand and pp when these fields are read, and no other module", function()
    assert.equal("true true nil nil", output_of([[
      local rfsm = require "rfsm"
      assert(not package.loaded.rfsm_seqand and not package.loaded.rfsmpp)
      print(tostring(rfsm.seqand == require "rfsm_seqand") .. " "
        .. tostring(rfsm.pp == require "rfsmpp") .. " "
        .. tostring(rfsm.timeevent) .. " " .. tostring(rfsm.emem))
    ]]))
  end)

  it("loads nothing and compiles no transition in a run, if it was prepared", function()
    assert.equal("true true 0 root.b\n21\tfalse\t0", output_of([[
      local compile, count = loadstring or load, 0
      local name = loadstring and "loadstring" or "load"
      _G[name] = function(text, chunkname)
        if chunkname:find("^=rfsm ") then count = count + 1 end
        return compile(text, chunkname)
      end
      local rfsm = require "rfsm"
      local fsm = rfsm.init(rfsm.state { info = false, warn = false,
        a = rfsm.state {}, b = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = "e" },
        rfsm.trans { src = "b", tgt = "a", events = "e" } })
      rfsm.prepare(fsm)
      local is_loaded, is_compiled = package.loaded["rfsm.fast"] ~= nil, count > 0
      local before = count
      rfsm.run(fsm)
      for _ = 1, 21 do rfsm.send_events(fsm, "e") rfsm.run(fsm) end
      print(("%s %s %d %s"):format(tostring(is_loaded), tostring(is_compiled),
        count - before, rfsm.get_actleaf_fqn(fsm)))
      local hooked = 0
      fsm.post_step_hook = function(_, events)
        hooked = hooked + (events[1] == "e" and 1 or 0)
      end
      rfsm.prepare(fsm) -- step hooks are in no text
      local is_more = count > before
      before = count
      for _ = 1, 21 do rfsm.send_events(fsm, "e") rfsm.run(fsm) end
      print(hooked, is_more, count - before)
    ]]))
  end)

  it("is package.loaded.rfsm, however its file was run", function()
    assert.equal("true true", output_of([[
      local rfsm = dofile "rfsm.lua"
      local is_loaded = rfsm == require "rfsm"
      package.loaded.rfsm = nil
      local text = io.open("rfsm.lua"):read("*a")
      rfsm = (loadstring or load)(text, "=core")()
      print(tostring(is_loaded) .. " " .. tostring(rfsm == require "rfsm"))
    ]]))
  end)

  it("leaves package.loaded.rfsm alone if something is there", function()
    assert.equal("mine", output_of([[
      package.loaded.rfsm = "mine"
      dofile "rfsm.lua"
      print(package.loaded.rfsm)
    ]]))
  end)

  it("adds one searcher, also if it is loaded twice", function()
    assert.equal("1", output_of([[
      local searchers = package.searchers or package.loaders
      local before = #searchers
      dofile "rfsm.lua"
      dofile "rfsm.lua"
      print(("%d"):format(#searchers - before))
    ]]))
  end)

  it("works in a sandbox without these: package, require, debug, loadfile", function()
    for _, names in ipairs { "package", "require", "debug", "loadfile",
      "package require debug loadfile dofile io os" } do
      assert.equal("root.b\t1\tnil", output_of(([[
        local file = io.open("rfsm.lua"):read("*a")
        local print, load = print, loadstring or load
        for name in ("%s"):gmatch("%%S+") do _G[name] = nil end
        local rfsm, count = load(file)(), 0
        local fsm = rfsm.init(rfsm.state { a = rfsm.state {}, b = rfsm.state {},
          rfsm.trans { src = "initial", tgt = "a" }, info = false, warn = false,
          rfsm.trans { src = "a", tgt = "b", events = "e" },
        })
        fsm.err = function() count = count + 1 end
        fsm.b.entry = function() error("on purpose") end
        rfsm.run(fsm)
        rfsm.send_events(fsm, "e")
        rfsm.run(fsm)
        print(rfsm.get_actleaf_fqn(fsm), count, rfsm.nothing)
      ]]):format(names)))
    end
  end)

  it("works where globals cannot be set and print is missing, as in a script of Redis",
    function()
      assert.equal("root.a\tfalse\tnil", output_of([[
        local file, write = io.open("rfsm.lua"):read("*a"), print
        local compile = loadstring or load
        local set, globals = rawset, _G
        function rawset(t, key, value)
          if t == globals then error("attempt to modify a readonly table") end
          return set(t, key, value)
        end
        print = nil
        local made = compile(file)()
        local fsm = made.init(made.state { warn = false, a = made.state {},
          made.trans { src = "initial", tgt = "a" } })
        made.run(fsm)
        io.stderr = nil
        local wrong = made.init(made.state { warn = false, entry = 3 })
        write(made.get_actleaf_fqn(fsm), wrong, rfsm)
      ]]))
    end)

  it("says in a sandbox that it can load neither a file nor a text", function()
    assert.equal("rfsm.load: there is no loadfile here\n"
      .. "rfsm.load_str: there is no load here", output_of([[
        local file, compile = io.open("rfsm.lua"):read("*a"), loadstring or load
        load, loadstring, loadfile = nil, nil, nil
        local rfsm = compile(file)()
        for _, name in ipairs { "load", "load_str" } do
          print(select(2, pcall(rfsm[name], "x")))
        end
      ]]))
  end)

  it("works where another global than these is an error, in one file, too", function()
    local folder = os.tmpname()
    os.remove(folder)
    os.execute(("make -s DIST='%s' LUA='%s' dist >/dev/null"):format(folder, arg[-1]))
    for _, file in ipairs { "rfsm.lua", folder .. "/rfsm.lua" } do
      assert.equal("root.b", output_of(([[
        local sandbox, text = {}, io.open("%s"):read("*a")
        for name in ("error getmetatable ipairs next pairs pcall rawequal rawget "
          .. "rawset select setmetatable tostring type xpcall string table print "
          .. "unpack load loadstring"):gmatch("%%S+") do sandbox[name] = _G[name] end
        sandbox._G = sandbox
        setmetatable(sandbox, {
          __index = function(_, name) error("no global " .. tostring(name)) end,
          __newindex = function(_, name) error("a new global " .. tostring(name)) end,
        })
        local chunk = not setfenv and load(text, "=core", "t", sandbox)
          or setfenv(loadstring(text), sandbox)
        local rfsm = chunk()
        local fsm = rfsm.init(rfsm.state { a = rfsm.state {}, b = rfsm.state {},
          rfsm.trans { src = "initial", tgt = "a" }, info = false, warn = false,
          rfsm.trans { src = "a", tgt = "b", events = "e" },
          rfsm.trans { src = "b", tgt = "a", events = "e" } })
        for _ = 1, 22 do
          rfsm.send_events(fsm, "e")
          rfsm.run(fsm)
        end
        print(rfsm.get_actleaf_fqn(fsm))
      ]]):format(file)))
    end
    os.execute("rm -r '" .. folder .. "'")
  end)
end)
