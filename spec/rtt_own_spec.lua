-- Components that launch their machine in their own configureHook, and
-- rfsm/rtt/program.lua as a component's whole program. On the stand-in in
-- spec/support/rtt.lua, or in a rttlua.

local helper = require "spec.helper"
local rtt_helper = require "spec.support.rtt_helper" -- before rfsm.rtt

local rtt = rtt_helper.rtt
local file_with, chart_file = helper.file_with, rtt_helper.chart_file
local evaluate, spin, advance = rtt_helper.evaluate, rtt_helper.spin, rtt_helper.advance
local deploy, load, logged = rtt_helper.deploy, rtt_helper.load, rtt_helper.logged
local feed, listen, leaves = rtt_helper.feed, rtt_helper.listen, rtt_helper.leaves

before_each(rtt_helper.reset)
after_each(rtt_helper.reset)

-- A component whose program launches a chart with these fields, and has this code.
local function own(fields, code, luatype)
  local arm, exec_str = load("arm", luatype)
  arm:getProperty("lua_file"):set(file_with(([[
local rfsm_rtt = require "rfsm.rtt"
%s
function configureHook() return rfsm_rtt.launch { %s } end]]):format(code or "",
    fields or ("fsmfile = %q"):format(chart_file()))))
  return arm, exec_str
end

-- Starts a configured component, sends its machine an event, and checks the leaves that
-- it writes. Ports that are connected may be given.
local function check_run(arm, out, names)
  out, names = out or feed("arm.events_in"), names or listen("arm.fqn")
  assert(arm:start())
  spin()
  out:write("e_go")
  spin()
  assert.equal("<none> a b", leaves(names))
end

describe("rfsm.rtt.launch", function()
  it("gives a component its ports, and a machine that runs", function()
    local arm = own()
    assert.is_true(arm:configure())
    check_run(arm)
    assert.equal(0, arm:getAttribute("rfsm_failures"):get())
    assert.equal(1, #logged("is launched in 'arm'"))
  end)

  it("works in a TLSF component, and leaves the modules of the launch", function()
    local arm, exec_str = own(nil, nil, "OCL::LuaTLSFComponent")
    local function modules()
      return evaluate(exec_str, [[(function()
        local names = {}
        for name in pairs(package.loaded) do
          if name:find("^rfsm[%w_.]") then names[#names + 1] = name end
        end
        table.sort(names)
        return table.concat(names, " ")
      end)()]])
    end
    assert.is_true(arm:configure())
    assert.equal("rfsm.advice rfsm.rtt", modules())
    check_run(arm)
    assert.equal("rfsm.advice rfsm.rtt", modules())
  end)

  it("loads the code of its hooks when RTT calls them, also after that has failed",
    function()
      local arm, exec_str = own()
      assert.is_true(arm:configure())
      exec_str("package.preload['rfsm.rtt.hooks'] = function() "
        .. "error('not enough memory', 0) end")
      assert.is_false(arm:start())
      assert.is_truthy(logged("not enough memory")[1])
      exec_str("package.preload['rfsm.rtt.hooks'] = nil")
      check_run(arm)
      arm:stop()
      assert.is_true(arm:cleanup())
      assert.equal("nil", evaluate(exec_str, "package.loaded['rfsm.rtt.hooks']"))
    end)

  it("loads functions again that a TLSF component has forgotten", function()
    local arm, exec_str = own(nil, nil, "OCL::LuaTLSFComponent")
    assert(arm:configure())
    assert.equal("nil nil nil", evaluate(exec_str, "rawget(rfsm, 'prepare'), "
      .. "rawget(rfsm, 'set_emit'), rawget(rfsm_rtt, 'gen_read_events')"))
    assert.is_true(exec_str("rfsm.prepare(fsm) rfsm.set_emit(fsm, function() end) "
      .. "rfsm_rtt.gen_write_fqn(fqn)"))
    check_run(arm)
  end)

  it("leaves out rttlib if it shall, and runs without", function()
    local fields = ("rttlib = false, fsmfile = %q"):format(chart_file())
    local arm, exec_str = own(fields, nil, "OCL::LuaTLSFComponent")
    assert.is_true(arm:configure())
    check_run(arm)
    assert.equal("nil nil", evaluate(exec_str, "rttlib, utils"))
  end)

  it("begins anew when it is configured again; a port that is there stays connected",
    function()
      local arm, exec_str = own()
      assert(arm:configure())
      local out, names = feed("arm.events_in"), listen("arm.fqn")
      for _, leave in ipairs { "stop", "cleanup", "none" } do
        check_run(arm, out, names)
        arm:stop()
        if leave == "cleanup" then arm:cleanup() end
        arm:getAttribute("rfsm_failures"):set(3)
        assert(arm:configure())
        assert.equal("false 0", evaluate(exec_str, "fsm._act_leaf, "
          .. "rtt.getTC():getAttribute('rfsm_failures'):get()"))
      end
    end)

  it("makes the ports again that a clean-up has deleted", function()
    local arm = own(nil, "function cleanupHook() rttlib.tc_cleanup() end")
    for _ = 1, 3 do
      assert(arm:configure())
      check_run(arm)
      arm:stop()
      arm:cleanup()
      assert.same({}, arm:getPortNames())
    end
  end)

  it("uses ports that the program has made, and refuses those of another type",
    function()
      for kind, is_right in pairs { string = true, int = false } do -- any order
        local arm = own(("fsmfile = %q, fqn_port = 'state'"):format(chart_file()),
          ("rtt.getTC():addPort(rtt.OutputPort.new('%s', 'state'))"):format(kind))
        assert.equal(is_right, arm:configure())
        assert.same(is_right and { "state", "events_in" } or { "state" },
          arm:getPortNames())
        rtt_helper.reset()
      end
    end)

  it("reads the chart again, when the machine before is no longer in memory", function()
    local chart = chart_file()
    local arm, exec_str = own(("fsmfile = %q, prestr = %q"):format(chart,
      "was_left = weak and weak[1] ~= nil"))
    assert(arm:configure())
    exec_str("weak = setmetatable({ fsm }, { __mode = 'v' })")
    local text = helper.content(chart):gsub("tgt = \"a\"", "tgt = \"b\"", 1)
    local file = assert(io.open(chart, "w"))
    file:write(text)
    file:close()
    assert(arm:configure())
    exec_str("trigger()")
    assert.equal("root.b false", evaluate(exec_str, "fsm._act_leaf._fqn, was_left"))
  end)

  it("does not hold the code of its launch when the paths are made: a pool has no room",
    function()
      local arm, exec_str = own(("fsmfile = %q, poststr = %q"):format(chart_file(), [[
        local launched, finish = rfsm_rtt.launched, rfsm_rtt.launched.finish
        weak = setmetatable({ package.loaded["rfsm.rtt.component"] }, { __mode = "v" })
        was_there = weak[1] ~= nil
        function launched.finish(...)
          for _ = 1, 2 do collectgarbage() end
          is_held = weak[1] ~= nil
          return finish(...)
        end]]))
      assert(arm:configure())
      -- traces of LuaJIT, which has no pools, may hold it, too
      local expected = rawget(_G, "jit") and evaluate(exec_str, "is_held") or "false"
      assert.equal("true " .. expected, evaluate(exec_str, "was_there, is_held"))
    end)

  it("leaves the hooks of a program that is loaded once, when it is configured again",
    function()
      local arm, exec_str = load("arm")
      exec_str(([[
words = ""
function startHook()
  words = words .. " start"
  return true
end
function configureHook() return require("rfsm.rtt").launch { fsmfile = %q } end]])
        :format(chart_file()))
      for _ = 1, 2 do
        assert(arm:configure())
        assert(arm:start())
        spin()
        arm:stop()
      end
      assert.equal(" start start", evaluate(exec_str, "words"))
    end)

  it("prepares the machine when the garbage of the launch is collected", function()
    local arm, exec_str = own(("fsmfile = %q, poststr = %q"):format(chart_file(), [[
local weak, prepare = setmetatable({ {} }, { __mode = "v" }), rfsm.prepare
function rfsm.prepare(...)
  is_collected = weak[1] == nil
  return prepare(...)
end]]))
    assert(arm:configure())
    assert.equal("true", evaluate(exec_str, "is_collected"))
  end)

  it("keeps the hooks of the program, calls its updateHook in place of ours", function()
    local arm, exec_str = own(nil, [[
words = ""
function startHook()
  words = words .. " start" .. tostring(fsm._act_leaf)
  return true
end
function updateHook() words = words .. " update" trigger() end
function stopHook() words = words .. " stop" .. fsm._act_leaf._id end]])
    for _, words in ipairs { " startfalse update stopa", " startfalse update stopa" } do
      assert(arm:configure())
      assert(arm:start())
      spin()
      arm:stop()
      assert.equal(words, evaluate(exec_str, "words"))
    end
  end)

  it("runs no machine beside an updateHook of the program that calls no trigger",
    function()
      local arm, exec_str = own(nil, "updates = 0 "
        .. "function updateHook() updates = updates + 1 end")
      assert(arm:configure())
      assert(arm:start())
      spin()
      assert.equal("true false", evaluate(exec_str, "updates > 0, fsm._act_leaf"))
    end)

  it("wakes a component without a period for time events, with a deployer as peer",
    function()
      local fields = ("fsmfile = %q, timer = true"):format(file_with [[
require "rfsm_timeevent"
return rfsm.state { info = false, a = rfsm.state {}, b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_after(0.2)" } } }]])
      local arm, exec_str = own(fields, "require 'rfsm'")
      assert.is_false(arm:configure())
      assert.equal(1, #logged("timer: a deployer that is a peer of 'arm' expected, "
        .. "there is no 'Deployer'"))
      arm:addPeer(rtt_helper.deployer())
      for _ = 1, 2 do
        assert(arm:configure())
        assert(arm:start())
        spin()
        assert.equal("a", evaluate(exec_str, "fsm._act_leaf._id"))
        advance(0.3)
        assert.equal("b", evaluate(exec_str, "fsm._act_leaf._id"))
        arm:stop()
      end
      assert.same({ "arm", "arm_timer" }, rtt_helper.loaded())
    end)

  it("fails if the name of its timer is taken", function()
    local arm = own(("fsmfile = %q, timer = true"):format(chart_file()))
    arm:addPeer(rtt_helper.deployer())
    load("arm_timer")
    assert.is_false(arm:configure())
    assert.equal(1, #logged("timer: the deployer does not load 'arm_timer'"))
    assert.same({ "arm", "arm_timer" }, rtt_helper.loaded())
  end)

  for _, case in ipairs { -- fields, what is logged, the chart
    { "", "rfsm.rtt.launch: fsmfile: file name expected, got nil" },
    { "fsm_file = 'x'", "rfsm.rtt.launch: unknown option 'fsm_file' (did you mean "
      .. "'fsmfile'?)" },
    { "fsmfile = '/nowhere/x.lua'", "fsmfile: cannot open /nowhere/x.lua" },
    { "fsmfile = %q", "no valid rfsm in file", "return 3" },
    { "fsmfile = %q, poststr = 'error \"no leg\"'", "no leg" },
  } do
    it("fails with the reason, and leaves nothing: " .. case[2], function()
      local chart = case[3] and file_with(case[3]) or chart_file()
      local arm, exec_str = own(case[1]:format(chart), "function updateHook() end")
      assert.is_false(arm:configure())
      assert.equal("PreOperational", arm:getState())
      assert.is_truthy(logged(case[2])[1])
      assert.same({}, arm:getPortNames())
      assert.equal("nil function", evaluate(exec_str, "fsm, type(updateHook)"))
    end)
  end

  for _, code in ipairs { "prestr", "poststr" } do
    it("fails if another launch begins inside of it: " .. code, function()
      local chart = chart_file()
      local arm, exec_str = own(("fsmfile = %q, %s = NESTED"):format(chart, code),
        ("NESTED = NESTED or [[rfsm_rtt.launch { fsmfile = %q }]]"):format(chart))
      for times = 1, 2 do
        assert.is_false(arm:configure())
        assert.equal(times, #logged("another launch began inside of it"))
        assert.equal("nil", evaluate(exec_str, "fsm"))
      end
      exec_str "NESTED = ''"
      assert(arm:configure())
      assert(arm:start())
    end)
  end

  local SHORT = "error('not enough memory', 0)"
  for _, case in ipairs { -- stage of the launch, setting, code in it
    { "the launch begins", "prestr", SHORT },
    { "the machine is made", "prestr", "function rfsm.init() " .. SHORT .. " end" },
    { "the machine is connected", "poststr", SHORT },
    { "the machine is prepared", "poststr", "function rfsm.prepare() " .. SHORT
      .. " end" },
    { "the library is loaded", "prestr", "",
      "package.preload['rfsm.rtt.component'] = function() " .. SHORT .. " end" },
    { "the launch begins", "prestr", "",
      "local getTC = rtt.getTC function rtt.getTC() rtt.getTC = getTC " .. SHORT
        .. " end" },
  } do
    it("names the stage in which memory was short: " .. case[1]
      .. (case[4] and ", anywhere" or ""), function()
      local arm = own(("fsmfile = %q, %s = %q"):format(chart_file(), case[2], case[3]),
        case[4])
      assert.is_false(arm:configure())
      assert.matches("not enough memory while " .. case[1] .. ", %d+ KiB in use "
        .. "without that: enlarge the pool by", logged("not enough memory")[1])
      assert.same({}, arm:getPortNames())
    end)
  end

  it("takes no memory to forget its modules, before it knows the reason", function()
    if not rtt_helper.is_standin then return end -- there is no plain Lua
    assert.equal("0", helper.output_of([[
      local forget, kib = require("rfsm.rtt").forget_modules, collectgarbage
      kib()
      kib "stop"
      forget() -- the stack of Lua has grown then
      package.loaded = { full = true } -- a new key would take memory
      local before = kib "count"
      forget()
      local after = kib "count" -- as deep in the stack of Lua as before
      print(("%.0f"):format((after - before) * 1024))]]):match("%S+"))
  end)
end)

describe("a launch of rfsm.rtt.launch", function()
  it("has the number of the active leaf in an attribute, their list in the log",
    function()
      local arm, exec_str = own(("fsmfile = %q"):format(file_with [[
        return rfsm.state { a = rfsm.state {}, m = rfsm.state { b = rfsm.state {},
          rfsm.trans { src = "initial", tgt = "b" } },
          rfsm.trans { src = "initial", tgt = "a" },
          rfsm.trans { src = "a", tgt = "m", events = { "e" } } } ]]))
      assert(arm:configure())
      assert.is_truthy(logged("rfsm.rtt: rfsm_state of 'arm': 0 <none>, 1 root.a, "
        .. "2 root.m.b")[1])
      local numbers = {}
      for i, code in ipairs { "1", "rfsm.run(fsm)",
        "rfsm.send_events(fsm, 'e'), rfsm.run(fsm)", "rfsm.reset(fsm)" } do
        evaluate(exec_str, code)
        numbers[i] = arm:getAttribute("rfsm_state"):get()
      end
      assert.same({ 0, 1, 2, 0 }, numbers)
    end)
end)

describe("rfsm/rtt/program.lua as lua_file", function()
  local PROGRAM = "rfsm/rtt/program.lua"

  local function whole(text, luatype)
    local arm, exec_str = load("arm", luatype)
    arm:getProperty("lua_file"):set(PROGRAM)
    arm:getProperty("lua_string"):set(text)
    return arm, exec_str
  end

  it("launches what lua_string says, again when it is configured again", function()
    local arm, exec_str = whole(("rfsm_launch = { fsmfile = %q, fqn_port = 'state' }")
      :format(chart_file()))
    for _ = 1, 2 do
      assert.is_true(arm:configure())
      local names = listen("arm.state")
      assert(arm:start())
      spin()
      assert.equal("a", leaves(names):match("%S+$"))
      arm:stop()
      arm:cleanup()
    end
    assert.equal("true", evaluate(exec_str, "rfsm.is_initialized_root(fsm)"))
  end)

  it("launches the file with the name of the component", function()
    local arm = whole("")
    assert.is_false(arm:configure())
    assert.equal(1, #logged("fsmfile: cannot open arm.lua"))
  end)

  for _, case in ipairs { -- lua_string, what is logged
    { "rfsm_launch = {", "unexpected symbol" },
    { "rfsm_launch = 3", "table of options expected, got 3" },
    { "rfsm_launch = { chart = 1 }", "unknown option 'chart'" },
  } do
    it("is not configured with lua_string " .. case[1], function()
      local arm = whole(case[1])
      assert.is_false(arm:configure())
      assert.is_truthy(logged(case[2])[1] or logged("'}' expected")[1])
      assert.same({}, logged("program.lua:"))
      rtt.logl("Error", "the log goes on")
      assert.equal(1, #logged("the log goes on"))
    end)
  end

  it("is all that XML or .ops must set, for a component of the deployer", function()
    local arm = whole(("rfsm_launch = { fsmfile = %q }"):format(chart_file()),
      "OCL::LuaTLSFComponent")
    assert(deploy("setActivity", "arm", 0.01, 0, 0))
    assert(arm:configure())
    local names = listen("arm.fqn")
    assert(arm:start())
    advance(0.05)
    assert.equal("<none> a", leaves(names))
  end)
end)
