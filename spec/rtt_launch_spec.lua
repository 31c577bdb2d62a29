-- Machines launched in services and components of RTT; refusals, and that they leave
-- nothing. On the stand-in in spec/support/rtt.lua, or in a rttlua.

local helper = require "spec.helper"
local rtt_helper = require "spec.support.rtt_helper" -- before rfsm.rtt

local rfsm_rtt = require "rfsm.rtt"

local rtt = rtt_helper.rtt
local samples, write_all, logged =
  rtt_helper.samples, rtt_helper.write_all, rtt_helper.logged
local refusal, file_with, chart_file =
  rtt_helper.refusal, rtt_helper.file_with, rtt_helper.chart_file
local evaluate, spin, advance = rtt_helper.evaluate, rtt_helper.spin, rtt_helper.advance
local deploy, load, listen, feed =
  rtt_helper.deploy, rtt_helper.load, rtt_helper.listen, rtt_helper.feed

before_each(rtt_helper.reset)
after_each(rtt_helper.reset)

-- (initial) -> a --e_done--> b --e_done--> c
local THREE = [[
return rfsm.state {
  a = rfsm.state {}, b = rfsm.state {}, c = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_done" } },
  rfsm.trans { src = "b", tgt = "c", events = { "e_done" } },
}]]

-- A doo that is never idle.
local BUSY = [[
return rfsm.state {
  a = rfsm.state { doo = function(fsm)
    fsm.cycles = 0
    while true do
      fsm.cycles = fsm.cycles + 1
      rfsm.yield()
    end
  end },
  b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_go" } },
}]]

-- Charts that cannot be launched, and what is logged.
local WRONG_CHARTS = {
  { "is no chart", "return 3", "no valid rfsm in file" },
  { "raises", "error('no hardware', 0)", "no hardware" },
  { "raises a table", "error(setmetatable({}, { __tostring = function() "
    .. "return 'a table as text' end }))", "a table as text" },
  { "has problems", [[
return rfsm.state {
  a = rfsm.state { entry = 3 },
  rfsm.trans { src = "initial", tgt = "aa" },
}]], "no machine, problems of the chart: 2" },
}

local WRONG_ENVS = { -- env, and what is reported
  { { go = print }, "env: go: " }, { { t = { { 1 } } }, "env: t: " },
  { { t = { x = 1 } }, "env: t: " }, { { far = math.huge }, "env: far: " },
  { { "speed" }, "env: 1: " },
}
for _, case in ipairs(WRONG_ENVS) do
  case[2] = case[2]
    .. "a name and a string, number, boolean or list of these expected"
end
WRONG_ENVS[#WRONG_ENVS + 1] = { 3, "env: table expected, got number" }

local ENV = {
  speed = 3.5, name = "it's\n\"quoted\" \\ 100% %s", is_fast = true, is_slow = false,
  list = { 1, 2, "y", true }, count = 3, small = 1e-300,
}
local ENV_NAMES = "speed, name, is_fast, is_slow, list[2], list[3], list[4], #list, "
  .. "count, small == 1e-300"
local ENV_VALUES = "3.5 it's\n\"quoted\" \\ 100% %s true false 2 y true 4 3 true"

-- Services ---------------------------------------------------------------------

describe("service_launch_rfsm", function()
  local host, exec_str

  before_each(function()
    host = load("host", "OCL::HelloWorld")
    assert(deploy("setActivity", "host", 0.01, 0, 0))
    assert(deploy("loadService", "host", "Lua"))
    exec_str = host:provides("Lua"):getOperation("exec_str")
  end)

  local function started()
    assert(host:configure())
    assert(host:start())
  end

  local launch = rfsm_rtt.service_launch_rfsm

  -- Some updates.
  local function settle() advance(0.1) end

  -- Launches a machine that waits for the start of its component.
  local function launch_waiting(file)
    launch(file, exec_str, true, nil, { running_only = true })
    return feed("host.events_in"), listen("host.fqn")
  end

  it("needs no rttlib here, and loads it and utils there, before the chart", function()
    local has = "has = { rttlib ~= nil, utils ~= nil, rtt.Variable('int'):getType() },"
    assert.is_true(launch(chart_file(has), exec_str))
    assert.equal("true true int",
      evaluate(exec_str, "fsm.has[1], fsm.has[2], fsm.has[3]"))
    assert.is_nil(package.loaded.rttlib)
  end)

  it("takes a step at each update of its component", function()
    local events, names = launch_waiting(chart_file())
    started()
    settle()
    events:write("e_go")
    settle()
    write_all(events, "e_none", "e_back")
    settle()
    assert.same({ "<none>", "root.a", "root.b", "root.a" }, samples(names))
  end)

  it("does not stop the component when a doo is busy for ever", function()
    local events, names = launch_waiting(file_with(BUSY))
    started()
    settle()
    local before = tonumber(evaluate(exec_str, "fsm.cycles"))
    settle()
    assert.is_true(before < tonumber(evaluate(exec_str, "fsm.cycles")))
    events:write("e_go")
    settle()
    assert.same({ "<none>", "root.a", "root.b" }, samples(names))
    assert.is_true(host:stop())
  end)

  it("steps when trigger() is executed, or runs if it shall", function()
    launch(file_with(THREE), exec_str)
    assert.equal("true", evaluate(exec_str, "trigger()"))
    assert.equal("root.a", evaluate(exec_str, "rfsm.get_actleaf_fqn(fsm)"))
    load("other", "OCL::HelloWorld")
    deploy("loadService", "other", "Lua")
    local other = rtt_helper.deployer():getPeer("other"):provides("Lua")
    launch(file_with(THREE), other:getOperation("exec_str"), false, nil, { run = true })
    other:getOperation("exec_str")("trigger()")
    assert.equal("root.c", evaluate(other:getOperation("exec_str"),
      "rfsm.get_actleaf_fqn(fsm)"))
  end)

  it("has no hook unless it is asked for", function()
    launch(chart_file(), exec_str)
    started()
    settle()
    assert.equal("nil false", evaluate(exec_str, "eehook, fsm._act_leaf"))
  end)

  it("steps in every state of the component", function()
    launch(chart_file(), exec_str, true)
    settle()
    assert.equal("PreOperational", host:getState())
    assert.equal("root.a", evaluate(exec_str, "rfsm.get_actleaf_fqn(fsm)"))
  end)

  it("steps only while the component runs, with running_only", function()
    local events = launch_waiting(chart_file())
    settle()
    assert.equal("false", evaluate(exec_str, "fsm._act_leaf"))
    started()
    settle()
    assert.equal("root.a", evaluate(exec_str, "rfsm.get_actleaf_fqn(fsm)"))
    host:stop()
    events:write("e_go")
    settle()
    assert.equal("root.a", evaluate(exec_str, "rfsm.get_actleaf_fqn(fsm)"))
  end)

  it("has the original's globals, and a hook that a chart cannot remove", function()
    local _, names = launch_waiting(chart_file())
    assert.equal("true function function string true", evaluate(exec_str,
      "rfsm.is_initialized_root(fsm), type(trigger), type(setfqn), fqn:info().type, "
      .. "eehook ~= nil"))
    exec_str("trigger, eehook, fsm, fqn = nil collectgarbage() collectgarbage()")
    started()
    settle()
    assert.same({ "<none>", "root.a" }, samples(names))
  end)

  it("lets the hook be disabled", function()
    local events, names = launch_waiting(chart_file())
    started()
    settle()
    exec_str("eehook:disable()")
    events:write("e_go")
    settle()
    assert.same({ "<none>", "root.a" }, samples(names))
  end)

  it("keeps the hook when a printer raises a table, and logs that as text", function()
    local events, names = launch_waiting(chart_file())
    started()
    settle()
    exec_str("fsm.dbg = function() error(setmetatable({}, { __tostring = function() "
      .. "return 'no paper' end })) end")
    events:write("e_go")
    settle()
    exec_str("fsm.dbg = false")
    events:write("e_back")
    settle()
    assert.is_truthy(logged("no paper")[1]:find("^Error: rfsm.rtt: no paper"))
    assert.same({ "<none>", "root.a", "root.b", "root.a" }, samples(names))
    rtt.logl("Error", "the log goes on")
    assert.equal(1, #logged("the log goes on"))
  end)

  it("lets the machine print to RTT's log, any value as text", function()
    launch(chart_file(), exec_str)
    exec_str("fsm.a.entry = function() error({}, 0) end")
    exec_str("fsm.warn('oil', 3, nil)")
    exec_str("trigger()")
    assert.same({ "Info: INFO: created undeclared connector root.initial" },
      logged("INFO: created"))
    assert.same({ "Warning: oil 3 nil" }, logged("oil"))
    assert.equal(1, #logged("Error: ENTRY error executing entry of root.a:  table"))
  end)

  it("leaves the printers of a chart alone", function()
    launch(chart_file("info = false, warn = print, err = print,"), exec_str)
    assert.same({}, logged("INFO: created"))
    assert.equal("true", evaluate(exec_str, "fsm.warn == print and fsm.err == print"))
  end)

  it("defines env first", function()
    launch(chart_file("data = { speed, name },"), exec_str, false, ENV)
    assert.equal(ENV_VALUES, evaluate(exec_str, ENV_NAMES))
    assert.equal("3.5", evaluate(exec_str, "fsm.data[1]"))
  end)

  it("sets no global of a module's name when env says so", function()
    launch(chart_file(), exec_str, true, { RFSM_NO_GLOBALS = true })
    assert.equal("nil nil true", evaluate(exec_str, "rfsm, rfsm_rtt, fsm ~= nil"))
  end)

  it("leaves events to a chart that has a getevents", function()
    launch(chart_file("getevents = function() return mail end,"), exec_str)
    assert.is_false((pcall(host.getPort, host, "events_in")))
    exec_str("trigger() mail = { 'e_go' } trigger()")
    assert.equal("root.b", evaluate(exec_str, "rfsm.get_actleaf_fqn(fsm)"))
  end)

  it("has ports of other names as an option", function()
    launch(chart_file(), exec_str, false, nil,
      { fqn_port = "rFSM_cur_fqn", ev_inport = "rFSM_events" })
    assert.equal("out", host:getPort("rFSM_cur_fqn"):info().porttype)
    assert.equal("in", host:getPort("rFSM_events"):info().porttype)
  end)

  it("finds the modules where the caller does", function()
    exec_str("package.path = '/nowhere/?.lua'")
    launch(chart_file(), exec_str)
    assert.equal("/nowhere/?.lua;" .. package.path, evaluate(exec_str, "package.path"))
  end)

  describe("refuses", function()
    local function refused(...)
      return (refusal(launch, ...):gsub("^rfsm%.rtt%.service_launch_rfsm: ", ""))
    end

    local function nothing_left()
      assert.is_false((pcall(host.getPort, host, "fqn")))
      assert.is_false((pcall(host.getPort, host, "events_in")))
      assert.equal("nil nil", evaluate(exec_str, "fsm, eehook"))
    end

    local ARGUMENTS = { -- file, exec_str, eehook, text
      { nil, print, true, "fsmfile: file name expected, got nil" },
      { false, nil, true, "exec_str: operation exec_str expected, got nil" },
      { false, print, "updateHook", "eehook: boolean expected, got string" },
    }
    for _, case in ipairs(ARGUMENTS) do
      it(case[4], function()
        local file = case[1] == false and chart_file() or case[1]
        assert.equal(case[4], refused(file, case[2], case[3]))
      end)
    end

    it("an option that is unknown", function()
      assert.equal("unknown field 'runs'",
        refused(chart_file(), print, true, nil, { runs = true }))
    end)

    it("a file that is not there, or no Lua", function()
      assert.matches("^fsmfile: cannot open '?/nowhere/x.lua",
        refused("/nowhere/x.lua", exec_str))
      assert.matches("^fsmfile: [^\n]*:1: ", refused(file_with("return {"), exec_str))
    end)

    for _, case in ipairs(WRONG_ENVS) do
      it("a wrong env: " .. case[2], function()
        assert.equal(case[2], refused(chart_file(), exec_str, true, case[1]))
      end)
    end

    for _, case in ipairs(WRONG_CHARTS) do
      it("a chart that " .. case[1], function()
        assert.equal("RTT's log has the reason",
          refused(file_with(case[2]), exec_str, true))
        assert.is_true(#logged(case[3]) > 0)
        rtt.logl("Error", "the log goes on")
        assert.equal(1, #logged("the log goes on"))
        nothing_left()
      end)
    end

    it("a port name that is in use, and leaves that port connected", function()
      local own = rtt.InputPort.new("string", "events_in")
      host:addPort(own)
      local out = feed("host.events_in")
      refused(chart_file(), exec_str, true, nil, { ev_inport = true })
      assert.equal(1, #logged("'host' has a port 'events_in' already"))
      assert.is_true(out:info().connected)
      assert.is_false((pcall(host.getPort, host, "fqn")))
    end)

    it("a second machine in one service, and leaves the first alone", function()
      launch(chart_file(), exec_str)
      refused(chart_file(), exec_str)
      assert.equal(1, #logged("a machine was launched here before"))
      assert.equal("root.a", evaluate(exec_str, "trigger() and fsm._act_leaf._fqn"))
    end)

    it("an operation that fails, or raises", function()
      assert.equal("RTT's log has the reason",
        refused(chart_file(), function() return false end))
      assert.equal("no connection",
        refused(chart_file(), function() error("no connection", 0) end))
    end)
  end)
end)

-- Components -------------------------------------------------------------------

describe("component_launch_rfsm", function()
  -- Launches with these fields and the usual ones; returns exec_str, too.
  local function launched(fields)
    local args = { name = "arm", deployer = rtt_helper.deployer() }
    for key, value in pairs(fields or {}) do args[key] = value end -- any order: a set
    args.fsmfile = args.fsmfile or chart_file()
    local component = rfsm_rtt.component_launch_rfsm(args)
    return component, component:getOperation("exec_str")
  end

  local function start(component)
    assert(component:configure())
    assert(component:start())
    spin()
  end

  it("loads a component with the machine, not configured, the deployer its peer",
    function()
      local arm, exec_str = launched()
      assert.equal("PreOperational", arm:getState())
      assert.same({ "Deployer" }, arm:getPeers())
      assert.equal("false true", evaluate(exec_str,
        "rfsm.get_actleaf_fqn(fsm), rttlib ~= nil"))
      assert.same({ "<none>" }, samples(listen("arm.fqn")))
    end)

  it("runs nothing twice when it is configured then", function()
    local arm, exec_str = launched {
      prestr = "n = (n or 0) + 1 "
        .. "function configureHook() m = (m or 0) + 1 return true end",
    }
    evaluate(exec_str, "fsm")
    assert.is_true(arm:configure())
    assert.equal("1 1", evaluate(exec_str, "n, m"))
    assert.same({}, logged("already in use"))
  end)

  it("enters the machine when it is started, and runs it at an event", function()
    local arm = launched()
    local events, names = feed("arm.events_in"), listen("arm.fqn")
    start(arm)
    events:write("e_go")
    spin()
    write_all(events, "e_back", "e_none")
    spin()
    assert.same({ "<none>", "root.a", "root.b", "root.a" }, samples(names))
  end)

  it("runs until nothing is left to do; with sync an update is a step", function()
    local arm, exec_str = launched { fsmfile = file_with(THREE) }
    local leg, exec_leg = launched { name = "leg", fsmfile = file_with(THREE),
      sync = true }
    start(arm)
    start(leg)
    assert.equal("root.c", evaluate(exec_str, "rfsm.get_actleaf_fqn(fsm)"))
    assert.equal("root.a", evaluate(exec_leg, "rfsm.get_actleaf_fqn(fsm)"))
    leg:getOperation("trigger")()
    spin()
    assert.equal("root.b", evaluate(exec_leg, "rfsm.get_actleaf_fqn(fsm)"))
  end)

  it("lets time events pass on RTT's clock", function()
    local arm, exec_str = launched {
      prestr = "require('rfsm_timeevent').set_gettime_hook(rtt.getTime)",
      fsmfile = file_with [[
return rfsm.state {
  a = rfsm.state {}, b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_after(0.2)" } },
}]] }
    deploy("setActivity", "arm", 0.01, 0, 0)
    start(arm)
    advance(0.1)
    assert.equal("root.a", evaluate(exec_str, "rfsm.get_actleaf_fqn(fsm)"))
    advance(0.2)
    assert.equal("root.b", evaluate(exec_str, "rfsm.get_actleaf_fqn(fsm)"))
  end)

  it("works in a TLSF component, and has its collector run in time", function()
    local arm, exec_str = launched { luatype = "OCL::LuaTLSFComponent" }
    local events, names = feed("arm.events_in"), listen("arm.fqn")
    start(arm)
    events:write("e_go")
    spin()
    assert.same({ "<none>", "root.a", "root.b" }, samples(names))
    assert.equal("table", evaluate(exec_str, "type(tlsf)"))
    if _VERSION == "Lua 5.5" then return end -- it has other parameters
    assert.equal("true",
      evaluate(exec_str, "collectgarbage('setpause', 200) <= 110"))
  end)

  it("keeps what nobody needs any more out of memory", function()
    local _, exec_str = launched()
    assert.equal("nil table", evaluate(exec_str,
      "package.loaded['rfsm.rtt_launch'], type(package.loaded['rfsm.rtt'])"))
  end)

  describe("with ev_inport", function()
    local function has(component, name)
      return (pcall(component.getPort, component, name))
    end

    it("as a name reads events from a port of that name", function()
      local arm = launched { ev_inport = "commands" }
      local events, names = feed("arm.commands"), listen("arm.fqn")
      start(arm)
      events:write("e_go")
      spin()
      assert.same({ "<none>", "root.a", "root.b" }, samples(names))
    end)

    it("false has no port for events", function()
      assert.is_false(has(launched { ev_inport = false }, "events_in"))
    end)

    it("not given leaves events to a chart with a getevents, or to a port of that name",
      function()
        local arm = launched { fsmfile = chart_file "getevents = function() end," }
        assert.is_false(has(arm, "events_in"))
        local leg = launched { name = "leg",
          prestr = "rtt.getTC():addPort(rtt.OutputPort('int', 'events_in'))" }
        assert.equal("int", leg:getPort("events_in"):info().type)
      end)

    it("reads the ports in extra_in_ports as well", function()
      local arm = launched { ev_inport = true, prestr = [[
local port = rtt.InputPort("string", "alarms")
rtt.getTC():addEventPort(port)
extra_in_ports = { port }]] }
      local alarms, names = feed("arm.alarms"), listen("arm.fqn")
      start(arm)
      alarms:write("e_go")
      spin()
      assert.same({ "<none>", "root.a", "root.b" }, samples(names))
    end)
  end)

  it("has a port and emit_event for events of the machine with ev_outport", function()
    local arm, exec_str = launched { ev_outport = true }
    local out = listen("arm.events_out")
    exec_str("emit_event('e_a', 'e_b')")
    assert.same({ "e_a", "e_b" }, samples(out))
    assert.is_false(exec_str("emit_event({})"))
    assert.equal(1, #logged("string expected, got table"))
    assert.equal("arm", arm:getName())
  end)

  it("runs env, prefile, prestr, the chart, postfile, poststr in turn", function()
    local _, exec_str = launched {
      env = { words = "env" }, prefile = file_with "words = words .. ' prefile'",
      prestr = "words = words .. ' prestr'", fsmfile = chart_file "words = words,",
      postfile = file_with "words = fsm.words .. ' postfile'",
      poststr = "words = words .. ' poststr'",
    }
    assert.equal("env prefile prestr postfile poststr", evaluate(exec_str, "words"))
  end)

  it("defines env as values, lists among them", function()
    local _, exec_str = launched { env = ENV }
    assert.equal(ENV_VALUES, evaluate(exec_str, ENV_NAMES))
  end)

  it("finds the deployer itself, or by the name of a peer", function()
    local args = { name = "arm", fsmfile = chart_file() }
    assert.equal("arm", rfsm_rtt.component_launch_rfsm(args):getName())
    args.name, args.deployer = "leg", "Deployer"
    assert.equal("leg", rfsm_rtt.component_launch_rfsm(args):getName())
  end)

  it("touches no global here", function()
    launched { env = { speed = 3 }, ev_outport = true }
    for _, name in ipairs { "fsm", "updateHook", "trigger", "fqn", "speed" } do
      assert.is_nil(rawget(_G, name))
    end
  end)

  it("logs what a printer raises, and goes on", function()
    local arm, exec_str = launched()
    local events, names = feed("arm.events_in"), listen("arm.fqn")
    start(arm)
    exec_str("fsm.dbg = function() error({}) end")
    events:write("e_go")
    spin()
    assert.equal(1, #logged("Error: rfsm.rtt: table"))
    assert.same({ "<none>", "root.a", "root.b" }, samples(names))
  end)

  it("goes on where it was when it is stopped and started", function()
    local arm = launched()
    local events, names = feed("arm.events_in"), listen("arm.fqn")
    start(arm)
    arm:stop()
    events:write("e_go")
    spin()
    assert.same({ "<none>", "root.a" }, samples(names))
    assert.is_true(arm:start())
    spin()
    assert.same({ "root.b" }, samples(names))
  end)

  it("bears a clean-up of its ports by rttlib", function()
    local arm = launched {
      poststr = "function cleanupHook() rttlib.tc_cleanup() end",
    }
    start(arm)
    arm:stop()
    assert.is_true(arm:cleanup())
    assert.same({}, arm:getPortNames())
  end)

  it("can be unloaded, and its name used again", function()
    start(launched())
    rtt_helper.deployer():getPeer("arm"):stop()
    assert.is_true(deploy("unloadComponent", "arm"))
    assert.equal("PreOperational", launched():getState())
  end)

  describe("refuses", function()
    -- The text, with what every text begins with taken off; and nothing is left.
    local function refused(args)
      local before = rtt_helper.loaded()
      local text = refusal(rfsm_rtt.component_launch_rfsm, args)
      assert.same(before, rtt_helper.loaded())
      return (text:gsub("^rfsm%.rtt%.component_launch_rfsm: ", ""))
    end

    local function refused_with(fields)
      local args = { name = "arm", fsmfile = chart_file() }
      for key, value in pairs(fields) do args[key] = value end -- any order: a set
      return refused(args)
    end

    it("what is no table", function()
      assert.equal("table expected, got nil", refused(nil))
      assert.equal("table expected, got string", refused("arm"))
    end)

    it("fields that are missing", function()
      assert.equal("fsmfile: file name expected, got nil", refused {})
      assert.equal("name: string expected, got nil", refused { fsmfile = chart_file() })
    end)

    local WRONG = {
      { { name = 3 }, "name: string expected, got number" },
      { { fsm_file = "x" }, "unknown field 'fsm_file'" },
      { { "arm" }, "unknown field '1'" },
      { { luatype = true }, "luatype: string expected, got boolean" },
      { { sync = "yes" }, "sync: boolean expected, got string" },
      { { prefile = 1 }, "prefile: file name expected, got number" },
    }
    for _, case in ipairs(WRONG) do
      it("a wrong field: " .. case[2], function()
        assert.equal(case[2], refused_with(case[1]))
      end)
    end

    for _, name in ipairs { "fsmfile", "prefile", "postfile" } do
      it(name .. " that is not there", function()
        assert.matches("^" .. name .. ": cannot open '?/nowhere/x.lua",
          refused_with { [name] = "/nowhere/x.lua" })
      end)
    end

    for _, case in ipairs(WRONG_ENVS) do
      it("a wrong env: " .. case[2], function()
        assert.equal(case[2], refused_with { env = case[1] })
      end)
    end

    for _, case in ipairs(WRONG_CHARTS) do
      it("a chart that " .. case[1], function()
        assert.equal("RTT's log has the reason",
          refused_with { fsmfile = file_with(case[2]) })
        assert.is_true(#logged(case[3]) > 0)
      end)
    end

    for _, name in ipairs { "prestr", "poststr" } do
      it(name .. " that raises", function()
        assert.equal("RTT's log has the reason",
          refused_with { [name] = "error('no gripper', 0)" })
        assert.equal(1, #logged("no gripper"))
      end)
    end

    it("a port name that is in use", function()
      refused_with { ev_inport = true,
        prestr = "rtt.getTC():addPort(rtt.InputPort('string', 'events_in'))" }
      assert.equal(1, #logged("'arm' has a port 'events_in' already"))
    end)

    it("a name that a component has, and leaves that one alone", function()
      local arm = launched()
      assert.equal("RTT's log has the reason", refused_with {})
      assert.same({ "arm" }, rtt_helper.loaded())
      assert.is_true(arm:configure())
    end)

    it("a type that the deployer does not know, or without Lua", function()
      assert.equal("RTT's log has the reason", refused_with { luatype = "OCL::Lua" })
      assert.matches("has no operation exec_str",
        refused_with { luatype = "OCL::HelloWorld" })
    end)

    it("a deployer that is none", function()
      assert.matches("no peer nobody", refused_with { deployer = "nobody" })
      assert.matches("getOperation", refused_with { deployer = {} })
    end)
  end)
end)

describe("a Lua without RTT", function()
  it("is refused", function()
    package.loaded.rtt = nil
    local load_text = rawget(_G, "loadstring") or rawget(_G, "load")
    local text = refusal(rfsm_rtt.service_launch_rfsm, chart_file(),
      function(code) assert(load_text(code))() end)
    package.loaded.rtt = rtt
    assert.matches("no module 'rtt' in this Lua", text)
    assert.is_nil(rawget(_G, "fsm"))
  end)
end)

describe("examples/hosts/rtt_host.lua #standin", function()
  if not rtt_helper.is_standin then return end

  it("launches a component, drives it through ports, and leaves nothing", function()
    local path = package.path
    package.loaded.rtt = nil
    local lines = helper.printed(function() dofile("examples/hosts/rtt_host.lua") end)
    package.loaded.rtt, package.path = rtt, path
    assert.same({
      "RTT is not here, its stand-in is used: spec/support/rtt.lua",
      "fingers open", "gripper: <none>", "gripper: root.open",
      "fingers closing", "gripper: root.closing",
      "motor holds", "gripper: root.holding",
      "motor off", "fingers open", "gripper: root.open",
    }, lines)
    assert.same({}, rtt.getTC():getPortNames())
    assert.same({}, rtt_helper.loaded())
  end)
end)
