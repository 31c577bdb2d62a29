-- Machines launched in services and components of RTT; refusals, and that they leave
-- nothing. On the stand-in in spec/support/rtt.lua, or in a rttlua.

local helper = require "spec.helper"
local rtt_helper = require "spec.support.rtt_helper" -- before rfsm.rtt

local rfsm_rtt = require "rfsm.rtt"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local rtt = rtt_helper.rtt
local samples, write_all, logged =
  rtt_helper.samples, rtt_helper.write_all, rtt_helper.logged
local refusal, file_with, chart_file =
  helper.refusal, helper.file_with, rtt_helper.chart_file
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

local LOGGED = "RTT's log has the reason"

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

local endless = {}
endless.t = endless

local VALUE = ": string, finite number, boolean or table of these expected, got "
local NAMES = "env: table of globals by name expected, got "
local WRONG_ENVS = { -- what is reported, env
  { "env.go" .. VALUE .. "function", { go = print } },
  { "env.t.1" .. VALUE .. "function", { t = { print } } },
  { "env.far" .. VALUE .. "number inf", { far = math.huge } },
  { "env" .. (".t"):rep(49) .. VALUE .. "table", endless },
  { NAMES .. "table", { "speed" } }, { NAMES .. "3", 3 },
}

-- Makes a spec of each wrong env and chart. refused_env(env) and refused_file(file)
-- return the reason.
local function refuses_all(refused_env, refused_file)
  for _, case in ipairs(WRONG_ENVS) do
    it("a wrong env: " .. case[1], function()
      assert.equal(case[1], refused_env(case[2]))
    end)
  end

  for _, case in ipairs(WRONG_CHARTS) do
    it("a chart that " .. case[1], function()
      assert.equal(LOGGED, refused_file(file_with(case[2])))
      assert.is_true(#logged(case[3]) > 0)
      rtt.logl("Error", "the log goes on")
      assert.equal(1, #logged("the log goes on"))
    end)
  end
end

local ENV = {
  speed = 3.5, name = "it's\n\"quoted\" \\ 100% %s", is_fast = true, is_slow = false,
  list = { 1, 2, "y", true }, count = 3, small = 1e-300, limits = { arm = { 1, 2 } },
}
local ENV_NAMES = "speed, name, is_fast, is_slow, list[2], list[3], list[4], #list, "
  .. "count, small == 1e-300, limits.arm[2]"
local ENV_VALUES = "3.5 it's\n\"quoted\" \\ 100% %s true false 2 y true 4 3 true 2"

-- The leaf of the machine that was launched there.
local function leaf_of(exec_str)
  return evaluate(exec_str, "rfsm.get_actleaf_fqn(fsm)")
end

-- Checks the leaves that came from a port, such as "<none> a b".
local function check_leaves(expected, port)
  assert.equal(expected, (table.concat(samples(port), " "):gsub("root%.", "")))
end

local function has_port(component, name)
  return (pcall(component.getPort, component, name))
end

-- Services ---------------------------------------------------------------------

describe("service_launch_rfsm", function()
  local host, exec_str

  -- A HelloWorld with a Lua service; that, and its exec_str.
  local function load_host(name)
    local component = load(name, "OCL::HelloWorld")
    assert(deploy("setActivity", name, 0.01, 0, 0))
    assert(deploy("loadService", name, "Lua"))
    return component, component:provides("Lua"):getOperation("exec_str")
  end

  before_each(function() host, exec_str = load_host("host") end)

  local launch = rfsm_rtt.service_launch_rfsm

  -- Some updates.
  local function settle() advance(0.1) end

  local function start()
    assert(host:configure())
    assert(host:start())
    settle()
  end

  -- Launches a machine that waits for the start of its component.
  local function launch_waiting(file)
    launch(file or chart_file(), exec_str, true, nil, { running_only = true })
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
    local events, names = launch_waiting()
    start()
    events:write("e_go")
    settle()
    write_all(events, "e_none", "e_back")
    settle()
    check_leaves("<none> a b a", names)
  end)

  it("does not stop the component when a doo is busy for ever", function()
    local events, names = launch_waiting(file_with(BUSY))
    start()
    local before = tonumber(evaluate(exec_str, "fsm.cycles"))
    settle()
    assert.is_true(before < tonumber(evaluate(exec_str, "fsm.cycles")))
    events:write("e_go")
    settle()
    check_leaves("<none> a b", names)
    assert.is_true(host:stop())
  end)

  it("steps when trigger() is executed, or runs if it shall", function()
    launch(file_with(THREE), exec_str)
    assert.equal("true", evaluate(exec_str, "trigger()"))
    assert.equal("root.a", leaf_of(exec_str))
    local _, other = load_host("other")
    launch(file_with(THREE), other, false, nil, { run = true })
    other("trigger()")
    assert.equal("root.c", leaf_of(other))
  end)

  it("has no hook unless it is asked for", function()
    launch(chart_file(), exec_str)
    start()
    assert.equal("nil false", evaluate(exec_str, "eehook, fsm._act_leaf"))
  end)

  it("steps in every state of the component", function()
    launch(chart_file(), exec_str, true)
    settle()
    assert.equal("PreOperational root.a", host:getState() .. " " .. leaf_of(exec_str))
  end)

  it("steps only while the component runs, with running_only", function()
    local events = launch_waiting()
    settle()
    assert.equal("false", leaf_of(exec_str))
    start()
    host:stop()
    events:write("e_go")
    settle()
    assert.equal("root.a", leaf_of(exec_str))
  end)

  it("has the original's globals, and a hook that a chart cannot remove", function()
    local _, names = launch_waiting()
    assert.equal("true function function string true", evaluate(exec_str,
      "rfsm.is_initialized_root(fsm), type(trigger), type(setfqn), fqn:info().type, "
      .. "eehook ~= nil"))
    exec_str("trigger, eehook, fsm, fqn = nil collectgarbage() collectgarbage()")
    start()
    check_leaves("<none> a", names)
  end)

  it("lets the hook be disabled", function()
    local events, names = launch_waiting()
    start()
    exec_str("eehook:disable()")
    events:write("e_go")
    settle()
    check_leaves("<none> a", names)
  end)

  it("keeps the hook when a printer raises a table, and logs that as text", function()
    local events, names = launch_waiting()
    start()
    exec_str("fsm.dbg = function() error(setmetatable({}, { __tostring = function() "
      .. "return 'no paper' end })) end")
    events:write("e_go")
    settle()
    exec_str("fsm.dbg = false")
    events:write("e_back")
    settle()
    assert.is_truthy(logged("no paper")[1]:find("^Error: rfsm.rtt: no paper"))
    check_leaves("<none> a b a", names)
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

  it("defines env first, and sets no global of a module's name if env says so",
    function()
      launch(chart_file("data = { speed, name },"), exec_str, false, ENV)
      assert.equal(ENV_VALUES, evaluate(exec_str, ENV_NAMES))
      assert.equal("3.5", evaluate(exec_str, "fsm.data[1]"))
      local _, other = load_host("other")
      launch(chart_file(), other, true, { RFSM_NO_GLOBALS = true })
      assert.equal("nil nil true", evaluate(other, "rfsm, rfsm_rtt, fsm ~= nil"))
    end)

  it("leaves events to a chart that has a getevents", function()
    launch(chart_file("getevents = function() return mail end,"), exec_str)
    assert.is_false(has_port(host, "events_in"))
    exec_str("trigger() mail = { 'e_go' } trigger()")
    assert.equal("root.b", leaf_of(exec_str))
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

    it("wrong arguments", function()
      local chart = chart_file()
      for text, arguments in pairs { -- any order: each stands alone
        ["fsmfile: file name expected, got nil"] = { nil, print, true },
        ["exec_str: operation exec_str expected, got nil"] = { chart, nil, true },
        ["eehook: boolean expected, got string 'x'"] = { chart, print, "x" },
        ["unknown option 'runs'"] = { chart, print, true, nil, { runs = true } },
        ["options: table expected, got boolean"] = { chart, print, true, nil, true },
      } do
        local reason = refused(unpack(arguments, 1, 5))
        assert.equal(text, (reason:gsub(", expected: .*", "")))
      end
    end)

    it("a file that is not there, or no Lua", function()
      assert.matches("^fsmfile: cannot open '?/nowhere/x.lua",
        refused("/nowhere/x.lua", exec_str))
      assert.matches("^fsmfile: [^\n]*:1: ", refused(file_with("return {"), exec_str))
    end)

    refuses_all(function(env) return refused(chart_file(), exec_str, true, env) end,
      function(file)
        local reason = refused(file, exec_str, true)
        assert.is_false(has_port(host, "fqn") or has_port(host, "events_in"))
        assert.equal("nil nil", evaluate(exec_str, "fsm, eehook"))
        return reason
      end)

    it("a port name that is in use, and leaves that port connected", function()
      local own = rtt.InputPort.new("string", "events_in")
      host:addPort(own)
      local out = feed("host.events_in")
      refused(chart_file(), exec_str, true, nil, { ev_inport = true })
      assert.equal(1, #logged("'host' has a port 'events_in' already"))
      assert.is_true(out:info().connected)
      assert.is_false(has_port(host, "fqn"))
    end)

    it("a second machine in one service, and leaves the first alone", function()
      launch(chart_file(), exec_str)
      refused(chart_file(), exec_str)
      assert.equal(1, #logged("a machine was launched here before"))
      assert.equal("root.a", evaluate(exec_str, "trigger() and fsm._act_leaf._fqn"))
    end)

    it("an operation that fails, or raises", function()
      assert.equal(LOGGED, refused(chart_file(), function() return false end))
      assert.equal("no connection",
        refused(chart_file(), function() error("no connection", 0) end))
    end)
  end)
end)

-- Components -------------------------------------------------------------------

describe("component_launch_rfsm", function()
  -- The usual fields of a launch, and these.
  local function launch_fields(fields)
    local args = { name = "arm", fsmfile = false }
    for key, value in pairs(fields or {}) do args[key] = value end -- any order: a set
    args.fsmfile = args.fsmfile or chart_file()
    return args
  end

  -- Launches; returns exec_str, too.
  local function launched(fields)
    local component = rfsm_rtt.component_launch_rfsm(launch_fields(fields))
    return component, component:getOperation("exec_str")
  end

  local function start(component)
    assert(component:configure())
    assert(component:start())
    spin()
  end

  -- Launches and starts; returns ports to and from the machine, component and exec_str.
  local function started(fields, port)
    local arm, exec_str = launched(fields)
    local events, names = feed("arm." .. (port or "events_in")), listen("arm.fqn")
    start(arm)
    return events, names, arm, exec_str
  end

  it("loads a component with the machine, not configured, the deployer its peer",
    function()
      local arm, exec_str = launched()
      assert.equal("PreOperational", arm:getState())
      assert.same({ "Deployer" }, arm:getPeers())
      assert.equal("false true", leaf_of(exec_str) .. " "
        .. evaluate(exec_str, "rttlib ~= nil"))
      check_leaves("<none>", listen("arm.fqn"))
    end)

  it("runs nothing twice when it is configured then", function()
    local arm, exec_str = launched {
      prestr = "n = (n or 0) + 1 "
        .. "function configureHook() m = (m or 0) + 1 return true end",
    }
    assert.is_true(arm:configure())
    assert.equal("1 1", evaluate(exec_str, "n, m"))
    assert.same({}, logged("already in use"))
  end)

  it("enters the machine when it is started, and runs it at an event", function()
    local events, names = started()
    events:write("e_go")
    spin()
    write_all(events, "e_back", "e_none")
    spin()
    check_leaves("<none> a b a", names)
  end)

  it("runs until nothing is left to do; with sync an update is a step", function()
    local arm, exec_str = launched { fsmfile = file_with(THREE) }
    local leg, exec_leg = launched { name = "leg", fsmfile = file_with(THREE),
      sync = true }
    start(arm)
    start(leg)
    assert.equal("root.c root.a", leaf_of(exec_str) .. " " .. leaf_of(exec_leg))
    leg:getOperation("trigger")()
    spin()
    assert.equal("root.b", leaf_of(exec_leg))
  end)

  it("lets time events pass on RTT's clock", function()
    local arm, exec_str = launched {
      prestr = "require('rfsm_timeevent').set_gettime_hook(rtt.getTime)",
      fsmfile = file_with((THREE:gsub("e_done", "e_after(0.2)", 1))),
    }
    deploy("setActivity", "arm", 0.01, 0, 0)
    start(arm)
    advance(0.1)
    assert.equal("root.a", leaf_of(exec_str))
    advance(0.2)
    assert.equal("root.c", leaf_of(exec_str))
  end)

  it("works in a TLSF component, and has its collector run in time", function()
    local events, names, _, exec_str = started { luatype = "OCL::LuaTLSFComponent" }
    events:write("e_go")
    spin()
    check_leaves("<none> a b", names)
    assert.equal("table", evaluate(exec_str, "type(tlsf)"))
    if _VERSION == "Lua 5.5" then return end -- it has other parameters
    assert.equal("true", evaluate(exec_str, "collectgarbage('setpause', 200) <= 110"))
  end)

  it("keeps what nobody needs any more out of memory", function()
    local _, exec_str = launched()
    assert.equal("nil table", evaluate(exec_str,
      "package.loaded['rfsm.rtt_launch'], type(package.loaded['rfsm.rtt'])"))
  end)

  describe("with ev_inport", function()
    it("as a name reads events from a port of that name, and from extra_in_ports",
      function()
        for _, port in ipairs { "commands", "alarms" } do
          local events, names = started({ ev_inport = "commands", prestr = [[
local port = rtt.InputPort("string", "alarms")
rtt.getTC():addEventPort(port)
extra_in_ports = { port }]] }, port)
          events:write("e_go")
          spin()
          check_leaves("<none> a b", names)
          rtt_helper.reset()
        end
      end)

    it("false has no port for events", function()
      assert.is_false(has_port(launched { ev_inport = false }, "events_in"))
    end)

    it("not given leaves events to a chart with a getevents, or to a port of that name",
      function()
        local arm = launched { fsmfile = chart_file "getevents = function() end," }
        assert.is_false(has_port(arm, "events_in"))
        local leg = launched { name = "leg",
          prestr = "rtt.getTC():addPort(rtt.OutputPort('int', 'events_in'))" }
        assert.equal("int", leg:getPort("events_in"):info().type)
      end)
  end)

  it("has a port and emit_event for events of the machine with ev_outport", function()
    local _, exec_str = launched { ev_outport = true }
    local out = listen("arm.events_out")
    exec_str("emit_event('e_a', 'e_b')")
    assert.same({ "e_a", "e_b" }, samples(out))
    assert.is_false(exec_str("emit_event({})"))
    assert.equal(1, #logged("string expected, got table"))
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

  it("defines env as values, lists among them, and touches no global here", function()
    local _, exec_str = launched { env = ENV, ev_outport = true }
    assert.equal(ENV_VALUES, evaluate(exec_str, ENV_NAMES))
    for _, name in ipairs { "fsm", "updateHook", "trigger", "fqn", "speed" } do
      assert.is_nil(rawget(_G, name))
    end
  end)

  it("finds the deployer itself, by the name of a peer, or as such", function()
    for name, deployer in pairs { arm = false, leg = "Deployer",
      foot = rtt_helper.deployer() } do -- any order: each stands alone
      assert.equal(name, launched { name = name, deployer = deployer or nil }:getName())
    end
  end)

  it("logs what a printer raises, and goes on", function()
    local events, names, _, exec_str = started()
    exec_str("fsm.dbg = function() error({}) end")
    events:write("e_go")
    spin()
    assert.equal(1, #logged("Error: rfsm.rtt: table"))
    check_leaves("<none> a b", names)
  end)

  it("goes on where it was when it is stopped and started", function()
    local events, names, arm = started()
    arm:stop()
    events:write("e_go")
    spin()
    check_leaves("<none> a", names)
    assert.is_true(arm:start())
    spin()
    check_leaves("b", names)
  end)

  it("bears a clean-up of its ports by rttlib", function()
    local _, _, arm = started {
      poststr = "function cleanupHook() rttlib.tc_cleanup() end",
    }
    arm:stop()
    assert.is_true(arm:cleanup())
    assert.same({}, arm:getPortNames())
  end)

  it("can be unloaded, and its name used again", function()
    local _, _, arm = started()
    arm:stop()
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

    local function refused_with(fields) return refused(launch_fields(fields)) end

    it("what is no table, and fields that are missing", function()
      assert.equal("table of options expected, got nil", refused(nil))
      assert.equal("table of options expected, got string 'arm'", refused("arm"))
      assert.equal("fsmfile: file name expected, got nil", refused { name = "arm" })
      assert.equal("name: string expected, got nil", refused { fsmfile = chart_file() })
    end)

    it("wrong fields", function()
      for text, fields in pairs { -- any order: each stands alone
        ["name: string expected, got 3"] = { name = 3 },
        ["unknown option 'fsm_file'"] = { fsm_file = "x" },
        ["unknown option '1'"] = { "arm" },
        ["luatype: string expected, got boolean"] = { luatype = true },
        ["sync: boolean expected, got string 'yes'"] = { sync = "yes" },
        ["prefile: file name expected, got 1"] = { prefile = 1 },
      } do
        assert.equal(text, (refused_with(fields):gsub(", expected: .*", "")))
      end
    end)

    it("files that are not there, and texts that raise", function()
      for _, name in ipairs { "fsmfile", "prefile", "postfile" } do
        assert.matches("^" .. name .. ": cannot open '?/nowhere/x.lua",
          refused_with { [name] = "/nowhere/x.lua" })
      end
      for i, name in ipairs { "prestr", "poststr" } do
        assert.equal(LOGGED, refused_with { [name] = "error('no gripper', 0)" })
        assert.equal(i, #logged("no gripper"))
      end
    end)

    refuses_all(function(env) return refused_with { env = env } end,
      function(file) return refused_with { fsmfile = file } end)

    it("a port name that is in use", function()
      refused_with { ev_inport = true,
        prestr = "rtt.getTC():addPort(rtt.InputPort('string', 'events_in'))" }
      assert.equal(1, #logged("'arm' has a port 'events_in' already"))
    end)

    it("a name that a component has, and leaves that one alone", function()
      local arm = launched()
      assert.equal(LOGGED, refused_with {})
      assert.same({ "arm" }, rtt_helper.loaded())
      assert.is_true(arm:configure())
    end)

    it("a type that the deployer does not know, or without Lua; no deployer", function()
      assert.equal(LOGGED, refused_with { luatype = "OCL::Lua" })
      assert.matches("has no operation exec_str",
        refused_with { luatype = "OCL::HelloWorld" })
      assert.matches("no peer nobody", refused_with { deployer = "nobody" })
      assert.matches("getOperation", refused_with { deployer = {} })
    end)
  end)
end)

it("a Lua without RTT is refused", function()
  local load_text = rawget(_G, "loadstring") or rawget(_G, "load")
  helper.with(package.loaded, { rtt = false }, function()
    assert.matches("no module 'rtt' in this Lua", refusal(rfsm_rtt.service_launch_rfsm,
      chart_file(), function(code) assert(load_text(code))() end))
  end)
  assert.is_nil(rawget(_G, "fsm"))
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
