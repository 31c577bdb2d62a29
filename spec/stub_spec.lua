-- Charts away from their robot: what they load is looked for beside them, and stubs are
-- in place of what is not here.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local search = require "rfsm.shared.search"
local chart = require "rfsm.shared.chart"
local limit = require "rfsm.shared.limit"
local json = require "rfsm.json"
local mermaid = require "rfsm.mermaid"
local record = require "rfsm.record"
local snapshot = require "rfsm.snapshot"
local static = require "rfsm.checks.static"
local stubs = require "rfsm.shared.stubs"

local folder

-- Writes files, by name, and returns the name of `chart.lua` among them.
local function write_files(files)
  for name, text in pairs(files) do -- any order: each stands alone
    helper.write(folder .. "/robot/" .. name, text)
  end
  return folder .. "/robot/chart.lua"
end

-- Loads a chart; returns the model, or the problem, and the names of its stubs.
local function open(files, has_stubs)
  local file = write_files(files)
  local model, warnings, world = chart.load(file, has_stubs)
  local problem = not model and warnings:gsub("%S+/robot/", "") or nil
  return model, problem, world.names
end

local function machine_of(files)
  local model, problem = open(files, true)
  assert.is_nil(problem)
  model.info, model.warn = false, false
  return assert(rfsm.init(model))
end

before_each(function()
  folder = os.tmpname()
  os.remove(folder)
  assert(os.execute("mkdir -p " .. folder .. "/robot/parts"))
end)

after_each(function()
  setmetatable(_G, nil)
  os.execute("rm -r " .. folder)
end)

describe("a chart finds beside its file", function()
  local LEAF = 'return rfsm.state { doc = "found" }'

  for _, case in ipairs {
    { what = "a module", chart = 'return require "part"', part = "part.lua" },
    { what = "a module in a folder", chart = 'return require "parts.part"',
      part = "parts/part.lua" },
    { what = "a chart", chart = 'return rfsm.load "part.lua"', part = "part.lua" },
    { what = "a chart, as seen from the folder above",
      chart = 'return rfsm.load "robot/part.lua"', part = "part.lua" },
    { what = "a file for dofile", chart = 'return dofile "part.lua"',
      part = "part.lua" },
    { what = "a file for loadfile", chart = 'local x = loadfile "part.lua"; return x()',
      part = "part.lua" },
  } do
    it(case.what, function()
      local model, problem = open { ["chart.lua"] = case.chart, [case.part] = LEAF }
      assert.is_nil(problem)
      assert.equal("found", model.doc)
    end)
  end

  it("a file that a callback runs later", function()
    local model = open { ["part.lua"] = "ran = (ran or 0) + 1", ["chart.lua"] = [[
      return rfsm.state { info = false, entry = function() dofile "part.lua" end,
        a = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" } }
    ]] }
    rawset(_G, "ran", nil)
    model.warn = false
    rfsm.run((assert(rfsm.init(model))))
    assert.equal(1, rawget(_G, "ran"))
    rawset(_G, "ran", nil)
  end)

  it("its own module, not that of a chart in another folder", function()
    write_files { ["chart.lua"] = 'return require "part"', ["part.lua"] = LEAF }
    os.execute(("mv %s/robot %s/first; mkdir %s/robot"):format(folder, folder, folder))
    assert.equal("found", chart.load(folder .. "/first/chart.lua").doc)
    local model = open { ["chart.lua"] = 'return require "part"',
      ["part.lua"] = 'return rfsm.state { doc = "other" }' }
    assert.equal("other", model.doc)
  end)

  it("a module that a callback requires later", function()
    local model = open { ["part.lua"] = "ran = 1", ["chart.lua"] = [[
      return rfsm.state { info = false, entry = function() require "part" end,
        a = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" } }
    ]] }
    model.warn, model.err = false, false
    rfsm.run((assert(rfsm.init(model))))
    assert.equal(1, rawget(_G, "ran"))
    rawset(_G, "ran", nil)
  end)

  for _, place in ipairs { "", "./", "parts/../" } do
    it(("a module in the folder above, as %schart.lua"):format(place), function()
      write_files { ["../above.lua"] = LEAF, ["chart.lua"] = 'return require "above"',
        ["part.lua"] = LEAF }
      local model = chart.load(folder .. "/robot/" .. place .. "chart.lua")
      assert.equal("found", model.doc)
    end)
  end

  it("its module before one of that name elsewhere", function()
    local path = package.path
    write_files { ["parts/part.lua"] = "return 7", ["part.lua"] = LEAF }
    package.path = folder .. "/robot/parts/?.lua;" .. path
    local model = open { ["chart.lua"] = 'return require "part"' }
    package.path = path
    assert.equal("found", model.doc)
  end)

  it("no other file in place of one that is there from the working directory",
    function()
      local model = open({ ["on_off.lua"] = LEAF,
        ["chart.lua"] = 'return rfsm.load "examples/on_off.lua"' }, true)
      assert.is_true(rfsm.is_state(model.on))
    end)

  it("files, whose functions are replaced once", function()
    open { ["chart.lua"] = LEAF }
    local replaced = { rfsm.load, rawget(_G, "dofile"), rawget(_G, "loadfile") }
    open { ["chart.lua"] = LEAF }
    assert.same(replaced, { rfsm.load, rawget(_G, "dofile"), rawget(_G, "loadfile") })
  end)

  it("nothing for code that is not a chart's", function()
    write_files { ["part.lua"] = LEAF }
    open { ["chart.lua"] = LEAF }
    assert.is_false((pcall(require, "part")))
    assert.is_nil((loadfile "part.lua"))
  end)

  it("no rfsm module in place of the library's", function()
    local model = open { ["chart.lua"] = 'require "rfsm_emem"; ' .. LEAF,
      ["rfsm_emem.lua"] = "error 'not this one'" }
    assert.equal("found", model.doc)
  end)
end)

describe("a stub", function()
  local stub = stubs.new "rf"

  it("can be indexed, called and joined, and is called by its name then", function()
    assert.equal('rf.findFile("arm.lua").x', tostring(stub:findFile("arm.lua").x))
    assert.equal("path: rf/lib", "path: " .. stub .. "/lib")
    assert.equal(stub.x, stub.x)
  end)

  it("is 0 in arithmetic, and less than nothing", function()
    assert.same({ 0, 0, 0, 0, 0, 0, 0 },
      { stub + 1, 1 - stub, 2 * stub, -stub, stub / stub, stub % 2, stub ^ 2 })
    assert.same({ false, false }, { stub < stub, stub <= stub })
  end)

  it("is 0 with the operators of a newer Lua", function()
    local load = rawget(_G, "load")
    local operators = "return function(s) return #s + s // 2 + (s & 1) + (s | 1) "
      .. "+ (s ~ 1) + (s << 1) + (s >> 1) + ~s end"
    local compiled = _VERSION > "Lua 5.2" and load(operators)
    assert.equal(0, compiled and compiled()(stub) or 0)
  end)

  it("has no end in no loop", function()
    local count = 0
    for _ in ipairs(stub) do count = count + 1 end
    for _ in stub:all() do count = count + 100 end
    for _ in pairs(stub) do count = count + 100 end
    assert.is_true(count < 100)
  end)

  it("copies a state that it is called with", function()
    local state = rfsm.state { a = rfsm.state { n = 1 },
      rfsm.trans { src = "initial", tgt = "a" } }
    local copy = stubs.new "deepcopy"(7, state)
    assert.is_true(rfsm.is_state(copy) and rfsm.is_state(copy.a))
    assert.is_true(rfsm.is_trans(copy[1]))
    assert.is_false(rawequal(copy, state) or rawequal(copy.a, state.a))
    assert.same({ 1, "a" }, { copy.a.n, copy[1].tgt })
  end)

  it("may be copied, also where it stands for a state", function()
    local function copy_of(value)
      local copy = {}
      for key, inner in pairs(value) do copy[key] = inner end -- any order: a copy
      return setmetatable(copy, getmetatable(value))
    end
    assert.equal("a stub.x()", tostring(copy_of(stubs.new "lib").x(7)))
    local part = copy_of(stubs.new_state "part")
    local model = rfsm.state { part = part, b = rfsm.state {},
      rfsm.trans { src = "initial", tgt = "part" },
      rfsm.trans { src = "part.ready", tgt = "b" } }
    stubs.complete(model)
    assert.same({}, select(2, rfsm.verify_early(model)))
  end)

  it("has a name of bounded length", function()
    local long = stub
    for _ = 1, 100 do long = long("0123456789") end
    assert.is_true(#tostring(long) <= 200)
  end)
end)

-- A robot's chart: modules, globals, files and peers that are not here.
local ROBOT = [[
require "robotlib"
local tc = rtt.getTC()
local rate = tc:getProperty("rate"):get()
local has_colours, colours = pcall(require, "no_colours")
if gripper then error "there is no gripper" end
return rfsm.state {
  info = false, port = tc:getPort("out"), period = 1 / (rate + 1),
  colours = has_colours and colours or "none",
  off = rfsm.state { entry = function() rtt.log("off") end },
  on = rfsm.load(rf:findFile("on.lua")),
  grasp = rfsm.load "grasp.lua",
  rfsm.trans { src = "initial", tgt = "off" },
  rfsm.trans { src = "off", tgt = "on", events = { "e_on" }, guard = tc.isReady },
  rfsm.trans { src = "on", tgt = "grasp", events = { "e_grasp" } },
  rfsm.trans { src = "grasp.done", tgt = "off", events = { "e_off" } },
}
]]
local FILES = { ["chart.lua"] = ROBOT, ["on.lua"] = "return rfsm.state {}" }

describe("a chart of a robot", function()
  it("cannot be loaded without stubs", function()
    local _, problem = open(FILES)
    assert.equal("chart.lua:1: module 'robotlib' not found", problem)
  end)

  it("is loaded with stubs, which are named", function()
    local model, problem, names = open(FILES, true)
    assert.is_nil(problem)
    assert.same({ "robotlib", "rtt", "rf", "grasp.lua" }, names)
    assert.equal("none", model.colours)
    assert.is_true(rfsm.is_state(model.grasp.done))
  end)

  it("has findings about its stubs, none of which stands in the library", function()
    local model = open({ ["chart.lua"] = [[
      return rfsm.state { a = rfsm.load "a.lua", b = rfsm.load "b.lua",
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "b.x", tgt = "a", events = { "e" } } }
    ]] }, true)
    local lines = {}
    for i, finding in ipairs(static.findings(model)) do
      lines[i] = finding.file .. finding.place .. " " .. finding.code
    end
    table.sort(lines)
    assert.same({ "root.b unreachable" }, lines) -- a may have an end inside
  end)

  it("is drawn with the names of its stubs", function()
    local text = mermaid.encode(machine_of(FILES))
    assert.matches("root_off %-%-> root_on : e_on %[rtt%.getTC%(%)%.isReady%]", text)
    assert.matches("grasp%.lua is a stub", text)
    assert.is_table(json.decode_all(json.encode(machine_of(FILES))))
  end)

  it("is drawn with one line for a stub, and none for what is in it", function()
    local call = ('m.get("%s")'):format(("x"):rep(60))
    local fsm = machine_of { ["chart.lua"] = ([[
      local m = require "m"
      return rfsm.state { a = %s.arm, b = m.b,
        rfsm.trans { src = "initial", tgt = "a.low" },
        rfsm.trans { src = "a.low", tgt = "b.x.y" } } ]]):format(call) }
    local rows = {}
    for row in mermaid.encode(fsm):gmatch(" : ([^\n]+)") do rows[#rows + 1] = row end
    assert.same({ ".." .. ("x"):rep(22) .. "#34;).arm is a stub", "m.b is a stub" },
      rows)
    assert.is_not_nil(fsm.b.x.y)
  end)

  it("runs, is recorded, replayed, saved and restored", function()
    local fsm, file = machine_of(FILES), folder .. "/recording"
    local recorder = record.record(fsm, file)
    rfsm.run(fsm)
    rfsm.send_events(fsm, "e_on")
    rfsm.run(fsm)
    local snap = snapshot.take(fsm)
    rfsm.send_events(fsm, "e_grasp")
    rfsm.run(fsm)
    recorder:stop()
    assert.equal("root.grasp.done", rfsm.get_actleaf_fqn(fsm))
    local model = open(FILES, true)
    model.warn = false
    assert.equal("root.on", rfsm.get_actleaf_fqn(snapshot.restore(model, snap)))
    local again = record.replay(model, file)
    assert.equal("root.grasp.done", rfsm.get_actleaf_fqn(again))
  end)

  it("gets stubs for globals it asks for only if nothing else helps", function()
    local _, _, names = open({ ["chart.lua"] = [[
      if not rtt then error "no rtt" end
      return rfsm.state {}
    ]] }, true)
    assert.same({ "rtt" }, names)
  end)

  for _, name in ipairs { "os.execute", "os.exit", "io.popen" } do
    local CALL = ('%s("touch %%s/made")'):format(name)

    it(("gets a stub for %s, also in callbacks"):format(name), function()
      local call = CALL:format(folder)
      local model, problem, names = open({ ["chart.lua"] = ([[
        local first = %s
        return rfsm.state { info = false, warn = false, first = tostring(first),
          entry = function() %s end, exit = function() return %s end }
      ]]):format(call, call, call) }, true)
      assert.is_nil(problem)
      assert.same({ name }, names)
      assert.equal(call, model.first)
      model.entry()
      pcall(model.exit)
      assert.is_false(search.exists(folder .. "/made"))
    end)
  end

  it("leaves these functions as they are for others, and without stubs", function()
    open({ ["chart.lua"] = "return rfsm.state {}" }, true)
    assert.equal("on", helper.text_of "printf on")
    local model = open { ["chart.lua"] = ([[
      os.execute "touch %s/made"
      return rfsm.state { close = io.popen("true").close }
    ]]):format(folder) }
    assert.equal("function", type(model.close))
    assert.is_true(search.exists(folder .. "/made"))
  end)

  it("gets no stub for an event without quotes", function()
    local file = write_files { ["chart.lua"] = "return rfsm.state { x = e_go }" }
    local model, warnings = chart.load(file, true)
    assert.is_nil(model.x)
    assert.equal(1, #warnings)
  end)
end)

describe("loading a chart", function()
  it("leaves the debug hook and the compiler as they were", function()
    local debug, jit = rawget(_G, "debug"), rawget(_G, "jit")
    local function hook() end
    debug.sethook(hook, "", 1000000)
    open { ["chart.lua"] = "return rfsm.state {}" }
    local found, mask, count = debug.gethook()
    debug.sethook()
    assert.same({ hook, "", 1000000 }, { found, mask, count })
    assert.is_true(not jit or jit.status())
  end)

  -- Calls `limit.load` with a clock that jumps at its reading number `at`, and in `f`.
  -- Returns whether it came back, its results, and whether a hook stays set.
  local function load_late(at, f)
    local debug, count, is_late = rawget(_G, "debug"), 0, false
    local function clock()
      count = count + 1
      return (is_late or count >= at) and 100 or 0
    end
    local ok, loaded, problem, was_late = pcall(limit.load, function()
      if f then f() end
      is_late = true
    end, "x", { clock })
    local stays = debug.gethook() ~= nil
    debug.sethook()
    return { ok, loaded, problem, was_late, stays }
  end

  it("leaves no hook if the time ends while the loading begins", function()
    local late = load_late(2)
    assert.same({ true, false, true, false }, { late[1], late[2], late[4], late[5] })
    assert.matches("loading takes more than 5 s", late[3], 1, true)
  end)

  it("leaves no hook if the time ends at any instruction behind the loading", function()
    local wrong = {}
    for turns = 1, 60 do -- the 10,000th instruction is each of those that follow
      local result = load_late(1 / 0, function()
        for _ = 1, 4970 + turns do local _ = turns + 1 end
      end)
      if not result[1] or result[5] then wrong[#wrong + 1] = turns end
      result = load_late(1 / 0, function()
        for _ = 1, 9940 + turns do end
      end)
      if not result[1] or result[5] then wrong[#wrong + 1] = -turns end
    end
    assert.same({}, wrong)
  end)

  local seconds = limit.SECONDS

  teardown(function() limit.SECONDS = seconds end)

  it("warns once of a global that its own code reads, not of those of a module",
    function()
      local file = write_files { ["part.lua"] = "local _ = of_part return {}",
        ["chart.lua"] = "local _, _ = of_chart, of_chart\nrequire 'part' "
          .. "return rfsm.state { x = of_chart, y = e_go }" }
      local _, warnings = chart.load(file)
      assert.same({ file .. ":1: warning: undefined global 'of_chart' (nil while the "
          .. "chart is loaded)",
        file .. ":2: warning: undefined global 'e_go' (an event is a string, in "
          .. "quotes)" }, warnings)
      assert.is_nil(getmetatable(_G))
    end)

  it("leaves a metatable of the globals as it is, of a host or of the chart", function()
    local file = write_files { ["chart.lua"] = "return rfsm.state { x = of_chart }" }
    local class = { __index = function() return "the host's" end }
    setmetatable(_G, class)
    local model, warnings = chart.load(file)
    assert.same({ "the host's", {} }, { model.x, warnings })
    assert.equal(class, getmetatable(_G))
    setmetatable(_G, nil)
    chart.load((write_files { ["chart.lua"] =
      "getmetatable(_G).__newindex = rawset return rfsm.state {}" }))
    assert.same({ __newindex = rawset }, getmetatable(_G))
  end)

  it("finds rfsmpp and rfsm_ext for callbacks, rfsm_timeevent if it is read", function()
    assert.equal("true\ttrue\tfalse", helper.output_of(([[
      package.path = "./?.lua;" .. package.path
      require("rfsm.shared.chart").load("%s")
      local function has(name) return rawget(_G, name) ~= nil end
      print(has "rfsmpp", has "rfsm_ext", has "rfsm_timeevent")
    ]]):format(write_files { ["chart.lua"] = "return rfsm.state {}" })))
    helper.remove_files()
  end)

  it("returns the problems of the model, each with its file", function()
    local file = write_files { ["chart.lua"] = "local x = of_chart\nreturn "
      .. "rfsm.state { err = false, entry = 7 }" }
    local lines = {}
    local fsm, problems = chart.open(file, rfsm.init, function(line)
      lines[#lines + 1] = line
    end)
    assert.is_false(fsm)
    assert.same({ file .. ":2: root.entry: function expected, got number 7" },
      problems)
    assert.same({ file .. ":1: warning: undefined global 'of_chart' (nil while the "
      .. "chart is loaded)" }, lines)
  end)

  it("returns the machine and its model, or the failure", function()
    local file = write_files { ["chart.lua"] = 'return rfsm.state { info = false, '
      .. 'a = rfsm.state { final = true, entry = lib.f }, '
      .. 'rfsm.trans { src = "initial", tgt = "a" } }' }
    local lines = {}
    local function warn(line) lines[#lines + 1] = line end
    local fsm, model = chart.open(file, rfsm.init, warn, true)
    assert.is_true(rfsm.is_root(fsm))
    assert.is_true(rfsm.is_state(model))
    assert.same({ file .. ": stubbed: lib" }, lines)
    assert.same({ false, { file .. ": no" } },
      { chart.open(file, function() error("no", 0) end, warn, true) })
  end)

  it("has an end", function()
    limit.SECONDS = 0.05
    for line, text in ipairs { "while true do end", "\nwhile true do end" } do
      local _, problem = open { ["chart.lua"] = text }
      assert.equal(("chart.lua:%d: loading takes more than 0.05 s, is there a loop "
        .. "without end?"):format(line), problem)
    end
  end)

  -- Calls f(a, b, c) while each `os.execute` takes a second, and the processor rests.
  -- Returns the seconds, and the results.
  local function slowly(f, a, b, c)
    local now, results = 0, nil
    limit.SECONDS = seconds
    helper.with(os, { time = function() return now end,
      clock = function() return 0 end, execute = function() now = now + 1 end,
    }, function()
      results = { f(a, b, c) }
    end)
    return now, results[1], results[2], results[3]
  end

  -- Loads a chart so. Returns the model, the problem, and the seconds.
  local function open_slowly(text, has_stubs)
    local now, model, problem = slowly(open, { ["chart.lua"] = text }, has_stubs)
    return model, problem, now
  end

  local TOO_LONG = "loading takes more than 5 s, is there a loop without end?"

  it("has an end by the clock on the wall, if the chart sleeps", function()
    local _, problem, now = open_slowly [[

      for _ = 1, 50 do os.execute "sleep 1" end
      return rfsm.state {}
    ]]
    assert.same({ "chart.lua:2: " .. TOO_LONG, 6 }, { problem, now })
    assert.is_table((open_slowly [[
      for _ = 1, 5 do os.execute "sleep 1" end
      return rfsm.state {}
    ]]))
  end)

  local PROGRAM = [[
    local function make(doc)
      return rfsm.init(rfsm.state { doc = doc,
        a = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" } })
    end
    local fsm = make "one"
    %s
    while true do
      %s(rfsm.step, fsm)
      os.execute "sleep 1"
    end
  ]]

  it("ends before the first step of a machine that the file makes", function()
    local model, problem, now = open_slowly(PROGRAM:format("", "pcall"))
    assert.same({ "one", nil, 6 }, { model.doc, problem, now })
    for _, has_stubs in ipairs { true, false } do
      local text = PROGRAM:format("", "(function(f, x) f(x) end)")
      model, problem, now = open_slowly(text, has_stubs)
      assert.same({ "one", nil, 0 }, { model.doc, problem, now })
    end
  end)

  it("takes the machine that is asked for, and lists them", function()
    local file = write_files { ["chart.lua"] = PROGRAM:format('make "two"', "pcall") }
    local lines = { "machine 1 of 2 (chart.lua:2, chart.lua:2); --machine N takes "
      .. "another", "machine 2 of 2 (chart.lua:2, chart.lua:2); --machine N takes "
      .. "another" }
    for number, doc in ipairs { "one", "two" } do
      local _, model, _, world = slowly(chart.load, file, false, number)
      assert.equal(doc, model.doc)
      assert.equal("chart.lua: " .. lines[number],
        (chart.lines_of(file, world)[1]:gsub("[^ (]+/robot/", "")))
    end
    local _, model, problem = slowly(chart.load, file, false, 3)
    assert.is_nil(model)
    assert.equal("chart.lua: no machine 3, it makes 2 (chart.lua:2, chart.lua:2)",
      (problem:gsub("[^ (]+/robot/", "")))
  end)

  it("takes the state that is returned before a machine", function()
    local model = open { ["chart.lua"] = [[
      rfsm.init(rfsm.state { info = false, warn = false, doc = "one" })
      return rfsm.state { doc = "two" }
    ]] }
    assert.equal("two", model.doc)
  end)

  it("takes a model that cannot become a machine, and says so once", function()
    local err = spy.new(function() end)
    local model, problem
    helper.with(_G, { print = err }, function()
      model, problem = open { ["chart.lua"] = [[
        local fsm = rfsm.init(rfsm.state { rfsm.trans { src = "a", tgt = "b" } })
        rfsm.run(fsm)
      ]] }
    end)
    assert.is_true(rfsm.is_state(model))
    assert.is_nil(problem)
    assert.is_nil(rawget(model, "err"))
    assert.spy(err).was_not_called()
  end)

  it("is not tried again with more stubs if it takes too long", function()
    local _, _, now = open_slowly([[
      for _ = 1, 50 do os.execute "sleep 1" end
      return rfsm.state {}
    ]], true)
    assert.equal(6, now)
  end)

  it("does not end the program", function()
    local _, problem = open { ["chart.lua"] = "os.exit(3)" }
    assert.equal("chart.lua:1: os.exit is called while the chart is loaded", problem)
  end)
end)

describe("a stub that is a callback", function()
  it("is called with the machine, and does not fail", function()
    local fsm = machine_of { ["chart.lua"] = [[
      return rfsm.state { a = rfsm.state { entry = robot.act, doo = robot.act },
        rfsm.trans { src = "initial", tgt = "a", effect = robot.act,
          guard = robot.act } }
    ]] }
    local problems = helper.said(fsm, "err")
    rfsm.run(fsm)
    assert.same({ "root.a", {} }, { rfsm.get_actleaf_fqn(fsm), problems })
  end)

  it("returns the machine or state that it is called with", function()
    local fsm, stub = helper.started(rfsm.state { a = rfsm.state {},
      rfsm.trans { src = "initial", tgt = "a" } }), stubs.new("wrap")
    assert.equal(fsm, stub(fsm))
    assert.equal(fsm.a, stub(fsm.a))
    local model = rfsm.state { a = rfsm.state {} }
    assert.not_equal(model, stub(model))
    assert.is_true(rfsm.is_state(stub(model).a))
  end)
end)

describe("exploration of charts with stubs", function()
  it("agrees with random runs", function()
    local claim = require "spec.support.claims.stubs"
    assert.is_nil(require("spec.support.share").problem(claim, 20, true))
  end)
end)
