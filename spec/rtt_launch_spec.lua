-- Machines launched in services and components of RTT; refusals, and that they leave
-- nothing. On the stand-in in spec/support/rtt.lua, or in a rttlua.

local helper = require "spec.helper"
local rtt_helper = require "spec.support.rtt_helper" -- before rfsm.rtt

local rfsm = require "rfsm"
local rfsm_rtt = require "rfsm.rtt"
local share = require "spec.support.share"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local rtt, leaves = rtt_helper.rtt, rtt_helper.leaves
local samples, write_all, logged =
  rtt_helper.samples, rtt_helper.write_all, rtt_helper.logged
local refusal, file_with, chart_file =
  helper.refusal, helper.file_with, rtt_helper.chart_file
local evaluate, spin, advance = rtt_helper.evaluate, rtt_helper.spin, rtt_helper.advance
local deploy, load, listen, feed =
  rtt_helper.deploy, rtt_helper.load, rtt_helper.listen, rtt_helper.feed

before_each(rtt_helper.reset)
after_each(rtt_helper.reset)

-- More fields of a chart: a --e_done--> b --e_done--> c
local DONE = [[c = rfsm.state {},
  rfsm.trans { src = "a", tgt = "b", events = { "e_done" } },
  rfsm.trans { src = "b", tgt = "c", events = { "e_done" } },]]

-- Code that raises a table to which `tostring` gives this text.
local function raising(text)
  return ("error(setmetatable({}, { __tostring = function() return '%s' end }))")
    :format(text)
end

-- The leaf of the machine that was launched there.
local function leaf_of(exec_str)
  return (evaluate(exec_str, "rfsm.get_actleaf_fqn(fsm)"):gsub("root%.", ""))
end

local function has_port(component, name)
  return (pcall(component.getPort, component, name))
end

-- An error was logged, and none that mutes the log.
local function check_logged(text)
  assert.is_truthy(logged(text)[1])
  rtt.logl("Error", "the log goes on")
  assert.equal(1, #logged("the log goes on"))
end

local function start(component, wait)
  assert(component:configure())
  assert(component:start())
  wait()
end

-- Returns two functions: one sends events to a component and waits, one returns the
-- leaves that came.
local function connected(name, wait, port)
  local events = feed(name .. "." .. (port or "events_in"))
  local names = listen(name .. ".fqn")
  return function(...)
    write_all(events, ...)
    wait()
  end, function() return leaves(names) end
end

-- Services ---------------------------------------------------------------------

describe("service_launch_rfsm", function()
  local launch = rfsm_rtt.service_launch_rfsm
  local host, exec_str

  -- A HelloWorld with a Lua service; that, and its exec_str.
  local function load_host(name)
    local component = load(name, "OCL::HelloWorld")
    assert(deploy("setActivity", name, 0.01, 0, 0))
    assert(deploy("loadService", name, "Lua"))
    return component, component:provides("Lua"):getOperation("exec_str")
  end

  before_each(function() host, exec_str = load_host("host") end)

  -- Some updates.
  local function settle() advance(0.1) end

  -- Launches a machine that waits for the start of its component, and starts that.
  local function started(poststr)
    local options = { running_only = true, poststr = poststr }
    launch(chart_file(), exec_str, true, nil, options)
    local send, came = connected("host", settle)
    start(host, settle)
    return send, came
  end

  it("needs no rttlib here, and loads it and utils there, before the chart", function()
    local has = "has = { rttlib ~= nil, utils ~= nil, rtt.Variable('int'):getType() },"
    assert.is_true(launch(chart_file(has), exec_str))
    assert.equal("true true int",
      evaluate(exec_str, "fsm.has[1], fsm.has[2], fsm.has[3]"))
    assert.is_nil(package.loaded.rttlib)
    local _, other = load_host("other")
    other("package.preload.rttlib = function() error('none') end "
      .. "package.preload.utils = function() return { own = true } end")
    launch(chart_file(), other)
    assert.equal("nil true", evaluate(other, "rttlib, utils.own"))
    local _, without = load_host("without")
    without("package.preload.rttlib = function() error('none') end "
      .. "package.preload.utils = package.preload.rttlib")
    launch(chart_file(), without)
    assert.equal("nil", evaluate(without, "rawget(_G, 'utils')"))
  end)

  it("takes a step at each update of its component", function()
    local send, came = started()
    send("e_go")
    send("e_none", "e_back")
    assert.equal("<none> a b a", came())
  end)

  it("does not stop the component when a doo is busy for ever", function()
    local send, came = started [[cycles = 0
      fsm.a.doo = function()
        while true do
          cycles = cycles + 1
          rfsm.yield()
        end
      end]]
    local before = tonumber(evaluate(exec_str, "cycles"))
    settle()
    assert.is_true(before < tonumber(evaluate(exec_str, "cycles")))
    send("e_go")
    assert.equal("<none> a b", came())
    assert.is_true(host:stop())
  end)

  it("steps when trigger() is executed, or runs if it shall, without a hook", function()
    launch(chart_file(DONE), exec_str)
    start(host, settle)
    assert.equal("nil false", evaluate(exec_str, "eehook, fsm._act_leaf"))
    assert.equal("true", evaluate(exec_str, "trigger()"))
    assert.equal("a", leaf_of(exec_str))
    local _, other = load_host("other")
    launch(chart_file(DONE), other, false, nil, { run = true })
    other("trigger()")
    assert.equal("c", leaf_of(other))
  end)

  it("reads 64 waiting samples at an update, and triggers none for more", function()
    deploy("setActivity", "host", 0, 0, 0)
    launch(chart_file(), exec_str, true)
    local out = feed("host.events_in", 100)
    local names = listen("host.fqn")
    for _ = 1, 64 do out:write("e_none") end
    out:write("e_go")
    for _, wanted in ipairs { "<none> a", "b" } do
      host:getOperation("trigger")()
      settle()
      assert.equal(wanted, leaves(names))
    end
  end)

  it("steps in every state of the component", function()
    launch(chart_file(), exec_str, true)
    settle()
    assert.equal("PreOperational a", host:getState() .. " " .. leaf_of(exec_str))
  end)

  it("steps only while the component runs, with running_only", function()
    local send = started("state = rtt.getTC():getState() leaf = fsm._act_leaf")
    assert.equal("PreOperational false a",
      evaluate(exec_str, "state, leaf") .. " " .. leaf_of(exec_str))
    host:stop()
    send("e_go")
    assert.equal("a", leaf_of(exec_str))
  end)

  it("has the original's globals, and a hook that a chart cannot remove", function()
    local _, came = started([[types = type(trigger) .. type(setfqn) .. fqn:info().type
      is_machine = rfsm.is_initialized_root(fsm)
      trigger, eehook, fsm, fqn = nil collectgarbage() collectgarbage()]])
    assert.equal("functionfunctionstring true nil",
      evaluate(exec_str, "types, is_machine, updateHook"))
    assert.equal("<none> a", came())
  end)

  it("keeps its hook if a printer raises a table, logs that as text", function()
    local send, came = started()
    exec_str("fsm.dbg = function() " .. raising "no paper" .. " end")
    send("e_go")
    exec_str("fsm.dbg = false")
    send("e_back")
    check_logged("Error: rfsm.rtt: no paper")
    exec_str("eehook:disable()")
    send("e_go")
    assert.equal("<none> a b a", came())
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

  -- Fields of the chart and of the launch, code, expressions and their values.
  for title, case in pairs { -- any order: each is a spec of its own
    ["leaves the printers of a chart alone, but counts the errors"] = {
      "info = false, warn = print, err = function(text) said = text end,", {},
      "fsm.err('oil')",
      "fsm.warn == print, said, rtt.getTC():getAttribute('rfsm_errors'):get()",
      "true oil 1",
    },
    ["leaves events to a chart that has a getevents"] = {
      "getevents = function() return mail end,", {},
      "trigger() mail = { 'e_go' } trigger()",
      "fsm._act_leaf._id, pcall(rtt.getTC().getPort, rtt.getTC(), 'events_in') and 1",
      "b false",
    },
    ["has ports of other names as an option"] = {
      "", { fqn_port = "rFSM_cur_fqn", ev_inport = "rFSM_events" }, "",
      "rtt.getTC():getPort('rFSM_cur_fqn'):info().porttype, "
        .. "rtt.getTC():getPort('rFSM_events'):info().porttype", "out in",
    },
    ["sets no global of a module's name if env says so"] = {
      "", { env = { RFSM_NO_GLOBALS = true } }, "", "rfsm, rfsm_rtt, fsm ~= nil",
      "nil nil true",
    },
  } do
    it(title, function()
      launch(chart_file(case[1]), exec_str, false, nil, case[2])
      exec_str(case[3])
      assert.equal(case[5], evaluate(exec_str, case[4]))
    end)
  end

  it("takes our modules from where they are here, others from where the caller does",
    function()
      local other = file_with("error('another rfsm', 0)") -- is found for every name
      exec_str(("package.path = %q"):format(other))
      launch(chart_file(), exec_str)
      local path = evaluate(exec_str, "package.path")
      assert.equal(other .. ";" .. package.path, (path:gsub("^[^;]*;", "")))
    end)

  it("is refused beside another rfsm, loaded in that Lua before", function()
    exec_str("package.loaded.rfsm = { load = print }")
    assert.is_false((pcall(launch, chart_file(), exec_str)))
    assert.equal(1, #logged("another rfsm is loaded in this Lua"))
  end)

  it("does nothing in its Lua once the hook is enabled, 15 times beside a thread",
    function()
      for i = 1, 15 do
        local other, exec_other = load_host("h" .. i)
        other:stop()
        deploy("setActivity", "h" .. i, 0.001, 0, 0)
        start(other, function() end)
        launch(chart_file(), exec_other, true)
        advance(0.005)
        assert.is_true(rfsm_rtt.service_halt_rfsm(other))
        assert.equal("true", evaluate(exec_other, "rfsm.is_initialized_root(fsm)"))
        other:stop()
      end
    end)

  it("halts in the thread of the component, and goes on", function()
    local send, came = started()
    assert.is_true(rfsm_rtt.service_halt_rfsm(host))
    send("e_go")
    assert.equal("<none> a", came())
    assert.is_true(rfsm_rtt.service_halt_rfsm(host))
    rfsm_rtt.service_resume_rfsm(exec_str)
    settle()
    assert.equal("b", came())
    assert.is_false(host:getAttribute("rfsm_halted"):get())
    assert.is_true(rfsm_rtt.service_halt_rfsm(host))
    exec_str("rtt.getTC():getAttribute('rfsm_halted'):set(false)")
    assert.matches("RTT's log has the reason",
      refusal(rfsm_rtt.service_resume_rfsm, exec_str))
    assert.equal(1, #logged("the machine is not halted"))
  end)

  it("is halted without a hook; a thread that does not update is none of its own",
    function()
      launch(chart_file(), exec_str)
      assert.is_true(rfsm_rtt.service_halt_rfsm(host))
      local idle, exec_idle = load_host("idle")
      deploy("setActivity", "idle", 0, 0, 0)
      launch(chart_file(), exec_idle, true)
      assert.is_false(rfsm_rtt.service_halt_rfsm(idle, 0.05))
      assert.is_false(idle:getAttribute("rfsm_halt"):get())
    end)

  it("refuses to halt and to resume what was not launched", function()
    assert.matches("^rfsm.rtt.service_halt_rfsm: component with a machine in its Lua "
      .. "service expected, got ",
      refusal(rfsm_rtt.service_halt_rfsm, host))
    assert.equal("rfsm.rtt.service_resume_rfsm: RTT's log has the reason",
      refusal(rfsm_rtt.service_resume_rfsm, exec_str))
  end)

  it("leaves neither port nor attribute when it fails", function()
    for name, poststr in pairs { kept = "", failed = "error 'no'" } do
      local target, exec_target = load_host(name)
      local is_done = pcall(launch, chart_file(), exec_target, false, nil,
        { poststr = poststr, ev_outport = true })
      local found = {}
      for i, attribute in ipairs { "rfsm_failures", "rfsm_halt", "rfsm_halted",
        "rfsm_live", "rfsm_overruns", "rfsm_peak" } do
        found[i] = pcall(target.getAttribute, target, attribute)
      end
      found[7], found[8] = has_port(target, "fqn"), has_port(target, "events_out")
      for _, is_there in ipairs(found) do assert.equal(is_done, is_there) end
      assert.equal(name == "kept", is_done)
    end
  end)

  describe("refuses", function()
    local function refused(...)
      local text = refusal(launch, ...):gsub("^rfsm%.rtt%.service_launch_rfsm: ", "")
      return (text:gsub(", expected: .*", ""))
    end

    it("wrong arguments, an operation that fails or raises", function()
      local chart = chart_file()
      for text, arguments in pairs { -- any order: each stands alone
        ["fsmfile: file name expected, got nil"] = { nil, print, true },
        ["exec_str: operation exec_str expected, got nil"] = { chart, nil, true },
        ["eehook: boolean expected, got string 'x'"] = { chart, print, "x" },
        ["env: table of globals by name expected, got 3"] = { chart, print, true, 3 },
        ["unknown option 'runs' (did you mean 'run'?)"] =
          { chart, print, true, nil, { runs = true } },
        ["options: table expected, got boolean"] = { chart, print, true, nil, true },
        ["unknown option 'enter'"] = { chart, print, true, nil, { enter = "start" } },
        ["steps: expected without sync and run, which are numbers of steps"] = {
          chart, print, true, nil, { steps = 2, run = true } },
        ["RTT's log has the reason"] = { chart, function() return false end },
        ["no connection"] = { chart, function() error("no connection", 0) end },
      } do
        assert.equal(text, refused(unpack(arguments, 1, 5)))
      end
    end)

    it("a chart that raises a table, and leaves no port and no hook", function()
      refused(file_with(raising "no hardware"), exec_str, true)
      check_logged("no hardware")
      assert.is_false(has_port(host, "fqn") or has_port(host, "events_in"))
      assert.equal("nil nil", evaluate(exec_str, "fsm, eehook"))
    end)

    it("a port name that is in use, and leaves that port connected", function()
      host:addPort(rtt.InputPort.new("string", "events_in"))
      local out = feed("host.events_in")
      refused(chart_file(), exec_str, true, nil, { ev_inport = true })
      assert.equal(1, #logged("'host' has a port 'events_in' already"))
      local text = refused(chart_file(), exec_str, true, nil, { ev_inport = true })
      assert.matches("^launch of '.*': 'host' has a port 'events_in' already$", text)
      assert.is_true(out:info().connected)
      assert.is_false(has_port(host, "fqn"))
    end)

    it("a second machine in one service, and leaves the first alone", function()
      launch(chart_file(), exec_str)
      refused(chart_file(), exec_str)
      assert.equal(1, #logged("a machine was launched here before"))
      assert.equal("root.a", evaluate(exec_str, "trigger() and fsm._act_leaf._fqn"))
    end)
  end)
end)

-- Components -------------------------------------------------------------------

describe("component_launch_rfsm", function()
  -- The usual fields of a launch, and these.
  local function launch_fields(fields)
    local args = { name = "arm" }
    for key, value in pairs(fields or {}) do args[key] = value end -- any order: a set
    args.fsmfile = args.fsmfile or chart_file()
    return args
  end

  -- Launches; returns exec_str, too.
  local function launched(fields)
    local component = rfsm_rtt.component_launch_rfsm(launch_fields(fields))
    return component, component:getOperation("exec_str")
  end

  -- Launches and starts; returns component and exec_str, too.
  local function started(fields, port)
    local arm, exec_str = launched(fields)
    local send, came = connected("arm", spin, port)
    start(arm, spin)
    return send, came, arm, exec_str
  end

  -- A component that does without a launch.
  local OWN = [[
local rfsm, rfsm_rtt = require "rfsm", require "rfsm.rtt"
local own, fsm = rtt.getTC(), nil
local events = rtt.InputPort.new("string", "events_in")
local calm, names = rtt.InputPort.new("string"), rtt.OutputPort.new("string", "fqn")
own:addEventPort(events)
own:addPort(names)
fsm = assert(rfsm.init(rfsm.load(%q)))
fsm.getevents = rfsm_rtt.gen_read_str_events(events, calm)
rfsm.post_step_hook_add(fsm, rfsm_rtt.gen_write_fqn(names))
function updateHook() rfsm.run(fsm) end]]

  local function own()
    local arm, exec_str = load("arm")
    assert(exec_str(OWN:format(chart_file("info = false,"))))
    return arm
  end

  for title, make in pairs { -- any order: each is a spec of its own
    ["is launched"] = launched, ["has its own program"] = own,
    ["takes a step at each update"] = function() return launched { sync = true } end,
  } do
    it("reads a burst to its end without a period if it " .. title, function()
      local arm = make()
      local out, names = feed("arm.events_in", 300), listen("arm.fqn")
      start(arm, spin)
      arm:stop()
      for _ = 1, 200 do out:write("e_none") end
      out:write("e_go")
      assert(arm:start())
      spin()
      assert.equal("<none> a b", leaves(names))
    end)
  end

  it("loads a component with the machine, not configured, the deployer its peer",
    function()
      local arm, exec_str = launched()
      assert.equal("PreOperational", arm:getState())
      assert.same({ "Deployer" }, arm:getPeers())
      assert.equal("false true", evaluate(exec_str, "fsm._act_leaf, rttlib ~= nil"))
      assert.equal("<none>", leaves(listen("arm.fqn")))
    end)

  it("enters the machine when it is started, and runs it at an event", function()
    local send, came = started()
    send("e_go")
    send("e_back", "e_none")
    assert.equal("<none> a b a", came())
  end)

  it("runs until nothing is left to do; with sync an update is a step", function()
    local arm, exec_str = launched { fsmfile = chart_file(DONE) }
    local leg, exec_leg = launched { name = "leg", fsmfile = chart_file(DONE),
      sync = true }
    start(arm, spin)
    start(leg, spin)
    assert.equal("c a", leaf_of(exec_str) .. " " .. leaf_of(exec_leg))
    leg:getOperation("trigger")()
    spin()
    assert.equal("b", leaf_of(exec_leg))
  end)

  it("lets time events pass on RTT's clock", function()
    local arm, exec_str = launched {
      prestr = "require('rfsm_timeevent').set_gettime_hook(rtt.getTime)",
      fsmfile = chart_file((DONE:gsub("e_done", "e_after(0.2)", 1))),
    }
    deploy("setActivity", "arm", 0.01, 0, 0)
    start(arm, spin)
    advance(0.1)
    assert.equal("a", leaf_of(exec_str))
    advance(0.2)
    assert.equal("c", leaf_of(exec_str))
  end)

  it("works in a TLSF component", function()
    local send, came, _, exec_str = started { luatype = "OCL::LuaTLSFComponent" }
    send("e_go")
    assert.equal("<none> a b table", came() .. " " .. evaluate(exec_str, "type(tlsf)"))
  end)

  -- Fields of a launch, fields of the chart, the port that is written.
  for title, case in pairs { -- any order: each is a spec of its own
    ["a port of the name given"] = {
      fields = { ev_inport = "commands" }, port = "commands" },
    ["those of extra_in_ports"] = {
      fields = { ev_inport = "commands" }, port = "alarms" },
    ["those of extra_in_ports without a port for events"] = {
      fields = { ev_inport = false }, port = "alarms" },
    ["those of extra_in_ports when the chart has a getevents"] = {
      fields = {}, chart = "getevents = function() return { 'e_none' } end,",
      port = "alarms" },
  } do
    it("reads " .. title, function()
      case.fields.fsmfile = chart_file(case.chart)
      case.fields.sync = true
      case.fields.prestr = [[
local port = rtt.InputPort("string", "alarms")
rtt.getTC():addEventPort(port)
extra_in_ports = { port }]]
      local send, came = started(case.fields, case.port)
      send("e_go")
      assert.equal("<none> a b", came())
    end)
  end

  it("reads the chart's getevents and extra_in_ports, loses nothing when one raises",
    function()
      local _, exec_str = launched { fsmfile = chart_file(
        "getevents = function() return mail() end,"), prestr = [[
port = { read = function() return box() end, info = function() return {} end }
extra_in_ports = { port }]] }
      exec_str [[mail = function() return { "e_a", "e_b" } end
        box = function() error("torn", 0) end
        ok = pcall(fsm.getevents)
        mail = function() return nil end
        box = function() return "NoData" end
        list = fsm.getevents() ]]
      assert.equal("false 2 e_a e_b", evaluate(exec_str, "ok, #list, list[1], list[2]"))
    end)

  it("has no port for events if told so, and replaces none", function()
    assert.is_false(has_port(launched { ev_inport = false }, "events_in"))
    local leg = launched { name = "leg",
      prestr = "rtt.getTC():addPort(rtt.OutputPort('int', 'events_in'))" }
    assert.equal("int", leg:getPort("events_in"):info().type)
  end)

  it("has a port and emit_event for events of the machine with ev_outport", function()
    local _, exec_str = launched { ev_outport = true }
    local out = listen("arm.events_out")
    exec_str("emit_event('e_a', 'e_b')")
    assert.same({ "e_a", "e_b" }, samples(out))
    assert.is_false(exec_str("emit_event({})"))
    assert.equal(1, #logged("string expected, got table"))
  end)

  it("writes what callbacks emit to that port, without data", function()
    local _, exec_str = launched { ev_outport = true }
    local out = listen("arm.events_out")
    exec_str("fsm.emit('e_a') fsm.emit('e_b', { force = 3 })")
    assert.same({ "e_a", "e_b" }, samples(out))
    local _, exec_leg = launched { name = "leg" }
    assert.is_true(exec_leg("fsm.emit('e_a')"))
  end)

  it("has the globals of its ports when the chart is read", function()
    local _, exec_str = launched { ev_outport = true,
      fsmfile = chart_file "seen = { fqn ~= nil, ev_outport ~= nil, setfqn ~= nil }," }
    assert.equal("true true true",
      evaluate(exec_str, "fsm.seen[1], fsm.seen[2], fsm.seen[3]"))
  end)

  it("runs env, prefile, prestr, the chart, postfile, poststr in turn, once", function()
    local arm, exec_str = launched {
      env = { words = "env" }, prefile = file_with "words = words .. ' prefile'",
      prestr = "words = words .. ' prestr'", fsmfile = chart_file "words = words,",
      postfile = file_with "words = fsm.words .. ' postfile'",
      poststr = "words = words .. ' poststr' "
        .. "function configureHook() words = words .. ' hook' return true end",
    }
    assert.is_true(arm:configure())
    assert.equal("env prefile prestr postfile poststr hook",
      evaluate(exec_str, "words"))
    assert.same({}, logged("already in use"))
    assert.equal("nil table nil", evaluate(exec_str, -- nobody needs them any more
      "package.loaded['rfsm.rtt.component'] or package.loaded['rfsm.rtt.update'], "
      .. "type(package.loaded['rfsm.rtt']), rfsm_rtt.launched.poststr"))
  end)

  it("defines env as values, tables among them, and touches no global here", function()
    local _, exec_str = launched { ev_outport = true, env = {
      speed = 3.5, name = "it's\n\"quoted\" \\ 100% %s", fast = true, slow = false,
      list = { 1, "y", true }, count = 3, small = 1 / 3, limits = { arm = { 1, 2 } },
    } }
    assert.equal("3.5 it's\n\"quoted\" \\ 100% %s true false y true 3 3 true 2",
      evaluate(exec_str, "speed, name, fast, slow, list[2], list[3], #list, count, "
        .. "small == 1 / 3, limits.arm[2]"))
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

  it("goes on where it was when it is stopped and started", function()
    local send, came, arm = started()
    arm:stop()
    send("e_go")
    assert.equal("<none> a", came())
    assert.is_true(arm:start())
    spin()
    assert.equal("b", came())
  end)

  it("has the attributes of an update, for overruns and failures", function()
    local _, _, arm = started()
    for _, case in ipairs { { "rfsm_overruns", 0 }, { "rfsm_failures", 0 } } do
      assert.equal(case[2], arm:getAttribute(case[1]):get())
    end
    local live = arm:getAttribute("rfsm_live"):get()
    local peak = arm:getAttribute("rfsm_peak"):get()
    assert.is_true(10 < live and live <= peak)
  end)

  local BUSY = "busy = rfsm.state { "
    .. "doo = function() while true do rfsm.yield() end end },"
    .. "rfsm.trans { src = 'a', tgt = 'busy', events = { 'e_busy' } },"

  -- Code for a burst of garbage that fills the pool.
  local BURST = rtt_helper.is_standin
    and "function burst() tlsf.fill(1) error('not enough memory', 0) end"
    or "function burst() local t = {} for i = 1, 1e6 do t[i] = { i } end end"

  it("leaves a full pool: a burst costs a callback or an update, not the machine",
    function()
      local send, came, arm, exec_str = started {
        luatype = "OCL::LuaTLSFComponent", prestr = BURST }
      exec_str("fsm.b.entry = burst")
      send("e_go")
      assert.equal("<none> a b", came())
      assert.is_truthy(logged("not enough memory")[1])
      exec_str("fsm.pre_step_hook = burst")
      send("e_none")
      send("e_none")
      exec_str("fsm.pre_step_hook = nil")
      local failures = arm:getAttribute("rfsm_failures"):get()
      assert.is_true(failures >= 2)
      assert.is_truthy(logged("Error: rfsm.rtt: not enough memory")[1])
      send("e_back")
      assert.equal("a", came())
      assert.is_true(arm:getAttribute("rfsm_peak"):get() > 900)
    end)

  it("updates once more when failures begin, and when they end", function()
    local send, _, arm, exec_str = started {
      poststr = "local inner, n = updateHook, 0 "
        .. "function updateHook() n = n + 1 inner() end "
        .. "function updates() return n end",
    }
    for _, case in ipairs { { fails = 0, updates = 1 }, { fails = 1, updates = 3 },
      { fails = 2, updates = 2 }, { fails = 0, updates = 2 } } do
      exec_str(("before, left = updates(), %d "):format(case.fails)
        .. "fsm.pre_step_hook = function() "
        .. "if left > 0 then left = left - 1 error('torn', 0) end end")
      send("e_none")
      assert.equal(tostring(case.updates), evaluate(exec_str, "updates() - before"))
    end
    assert.equal(3, arm:getAttribute("rfsm_failures"):get())
  end)

  it("collects before a pool is full, and not at each update #standin", function()
    if not rtt_helper.is_standin then return end
    local send, _, _, exec_str = started { luatype = "OCL::LuaTLSFComponent" }
    for _, case in ipairs { { 0.96, "524288" }, { 0.94, "985661" } } do
      exec_str(("tlsf.fill(%g)"):format(case[1]))
      send("e_none")
      assert.equal(case[2], evaluate(exec_str, "math.floor((tlsf.stats()))"))
    end
  end)

  it("has room for 20 states with timers in the pool of a TLSF component", function()
    local _, exec_str = launched {
      luatype = "OCL::LuaTLSFComponent", prestr = "require 'rfsm_timeevent'",
      fsmfile = file_with [[
local rfsm = require "rfsm"
local root = { info = false, rfsm.trans { src = "initial", tgt = "s1" } }
for i = 1, 20 do
  root["s" .. i] = rfsm.state {}
  root[#root + 1] = rfsm.trans { src = "s" .. i, tgt = "s" .. i % 20 + 1,
    events = { "e_after(0.01)" } }
end
return rfsm.state(root)]] }
    exec_str("trigger()")
    assert.equal("s1", leaf_of(exec_str))
    advance(0.1)
    exec_str("trigger()")
    assert.equal("s2", leaf_of(exec_str))
  end)

  it("does without rfsm.fast in a pool, and logs that", function()
    for luatype, text in pairs { -- any order: each stands alone
      ["OCL::LuaTLSFComponent"] = " of %d+ KiB in use %(%d+ %%%), without rfsm%.fast$",
      ["OCL::LuaComponent"] = " KiB in use$",
    } do
      local name = luatype:match("Lua(.*)")
      local arm = launched { name = name, luatype = luatype }
      local lines = logged("is launched in '" .. name .. "'")
      assert.equal(1, #lines)
      assert.matches("^Info: rfsm%.rtt: '.*' is launched in '.*': %d+" .. text,
        lines[1])
      assert.is_true(arm:getAttribute("rfsm_live"):get() > 10)
    end
  end)

  it("has a pool of the size that is wanted when the chart is loaded", function()
    local POOL = "(select(3, tlsf.stats()) / 1024 + 0.5)"
    for name, case in pairs { arm = { 2000, "2000" }, leg = { 10, "0*1[0-9]+" } } do
      local _, exec_str = launched { name = name, luatype = "OCL::LuaTLSFComponent",
        pool = case[1], fsmfile = chart_file("size = math.floor" .. POOL .. ",") }
      assert.matches("^" .. case[2] .. "$", evaluate(exec_str, "fsm.size"))
    end
    assert.equal("PreOperational", launched { name = "foot", pool = 2000 }:getState())
  end)

  -- Updates that go from state to state, after `before` of them: what was opened, read
  -- or compiled, and the bytes by which the heap has grown; the least of three.
  local UPDATES = [=[
local feed, var = rttlib.port_clone_conn(ev_inport), rtt.Variable("string")
local jit, count, opened = jit, collectgarbage, 0
if jit then jit.off() jit.flush() end
for _, place in ipairs { { io, "open" }, { _G, "loadfile" }, { _G, "loadstring" },
  { _G, "load" }, { _G, "require" } } do
  local f = place[1][place[2]]
  place[1][place[2]] = f and function(...) opened = opened + 1 return f(...) end
end
local function update(n)
  for i = 1, n do
    var:assign(i % 2 == 1 and "e_go" or "e_back")
    feed:write(var)
    updateHook()
  end
end
local least = math.huge
count("stop")
local function grow_stack(n) return n > 0 and 1 + grow_stack(n - 1) or 0 end
grow_stack(150) -- it grows once, too, but is Lua's
update(before)
opened = 0
for i = 1, tries do
  local kib = count("count")
  update(10000)
  least = math.min(least, count("count") - kib)
end
count("restart")
if jit then jit.on() end
files, grown = opened, math.floor(least * 1024)]=]

  -- A composite, a connector, guards, effects, entries and exits, on a circle.
  local SHAPES = [[
local rfsm = require "rfsm"
local f = rfsm.borrows(function() end)
local yes = rfsm.borrows(function() return true end)
return rfsm.state { info = false, warn = false,
  a = rfsm.state { entry = f, exit = f,
    a1 = rfsm.state { exit = f }, a2 = rfsm.state { entry = f },
    rfsm.trans { src = "initial", tgt = "a1" },
    rfsm.trans { src = "a1", tgt = "a2", events = { "e_go" }, guard = yes } },
  b = rfsm.state {}, c = rfsm.state { entry = f }, k = rfsm.conn {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_back" }, effect = f },
  rfsm.trans { src = "b", tgt = "k", events = { "e_go" } },
  rfsm.trans { src = "k", tgt = "c", events = { "e_go" }, guard = yes },
  rfsm.trans { src = "c", tgt = "a", events = { "e_back" }, effect = f },
}]]

  local function updated(before, tries)
    local arm, exec_str = launched { fsmfile = file_with(SHAPES),
      env = { before = before, tries = tries } }
    assert(arm:configure())
    assert.is_true(exec_str(UPDATES))
    return evaluate(exec_str, "files, grown")
  end

  it("reads, loads and allocates nothing in the steady state #alloc", function()
    assert.equal("0 0", updated(1000, 3))
  end)

  -- Some lists grow once.
  it("reads, loads and allocates nothing from the first update on #alloc", function()
    local files, grown = updated(0, 1):match("(%d+) (%d+)")
    assert.equal("0", files)
    assert.is_true(tonumber(grown) < 2000, grown .. " bytes in 10,000 updates")
  end)

  it("can be stopped when a doo is busy for ever, and counts overruns", function()
    local arm = launched { fsmfile = chart_file(BUSY) }
    deploy("setActivity", "arm", 0.01, 0, 0)
    local state = arm:getAttribute("rfsm_state")
    local overruns = arm:getAttribute("rfsm_overruns")
    start(arm, function()
      rtt_helper.wait_until(function() return state:get() > 0 end) -- it is entered
    end)
    feed("arm.events_in"):write("e_busy")
    rtt_helper.wait_until(function() return overruns:get() > 3 end)
    assert.is_true(arm:stop())
  end)

  it("makes as many steps in an update as it may, and goes on by itself", function()
    local arm, exec_str = launched { steps = 2, fsmfile = chart_file(DONE) }
    start(arm, spin)
    assert.equal("c", leaf_of(exec_str))
    assert.equal(1, arm:getAttribute("rfsm_overruns"):get())
  end)

  it("counts no overrun and triggers nothing if it cannot be entered", function()
    local arm, exec_str = launched { fsmfile = file_with(
      "local rfsm = require 'rfsm' return rfsm.state { a = rfsm.state {}, "
      .. "rfsm.trans { src = 'initial', tgt = 'a', "
      .. "guard = function() return false end } }") }
    start(arm, spin)
    assert.equal("false", evaluate(exec_str, "fsm._act_leaf"))
    assert.equal(0, arm:getAttribute("rfsm_overruns"):get())
  end)

  it("loads no check: `rfsm check` at the desk has them all", function()
    local _, exec_str = launched { poststr = [[
      for name in pairs(package.loaded) do
        if name:find "^rfsm.check" then has_checks = true end
      end]] }
    assert.equal("nil", evaluate(exec_str, "has_checks"))
  end)

  it("counts the errors that are reported, and those of updates", function()
    local send, _, arm, exec_str = started()
    exec_str("fsm.b.entry = function() error('jam', 0) end")
    for _, event in ipairs { "e_go", "e_back", "e_go" } do send(event) end
    exec_str("fsm.pre_step_hook = function() error('torn', 0) end")
    send("e_none")
    assert.same({ 2, 2 }, { arm:getAttribute("rfsm_errors"):get(),
      arm:getAttribute("rfsm_failures"):get() })
  end)

  it("calls error() of the component at an error if it shall", function()
    for name, case in pairs { -- any order: each stands alone
      arm = { "fsm.b.entry = function() error('jam', 0) end", "RunTimeError" },
      leg = { "fsm.pre_step_hook = function() error('torn', 0) end", "RunTimeError" },
      foot = { "", "Running" },
    } do
      local arm, exec_str = launched { name = name, error = true }
      local out = feed(name .. ".events_in")
      start(arm, spin)
      exec_str(case[1])
      out:write("e_go")
      spin()
      assert.equal(case[2], arm:getState())
      exec_str("fsm.pre_step_hook = nil")
      arm:recover()
      arm:getOperation("trigger")()
      spin()
      assert.equal("Running b", arm:getState() .. " " .. leaf_of(exec_str))
    end
  end)

  it("reads as many samples of a port at once as it may", function()
    local _, exec_str = launched { samples = 3, steps = 1 }
    local out = feed("arm.events_in", 100)
    for _ = 1, 8 do out:write("e_none") end
    for _, count in ipairs { 3, 3, 2, 0 } do
      assert.equal(tostring(count), evaluate(exec_str, "#fsm.getevents()"))
    end
  end)

  it("is entered in startHook if it shall, so that the first event is not lost",
    function()
      local arm, exec_str = launched { enter = "start",
        poststr = "function startHook() words = 'start' .. tostring(fsm._act_leaf) "
          .. "return true end" }
      local names = listen("arm.fqn")
      local out = feed("arm.events_in")
      assert(arm:configure())
      out:write("e_go")
      assert.equal("<none>", leaves(names))
      assert(arm:start())
      spin()
      assert.equal("startfalse", evaluate(exec_str, "words"))
      assert.equal("a b", leaves(names))
      arm:stop()
      assert(arm:start())
      assert.equal("b", leaf_of(exec_str))
    end)

  it("counts failures of the entry in startHook with those of updates", function()
    local arm, exec_str = launched { enter = "start", poststr = "calls = 0 "
      .. "function fsm.pre_step_hook() calls = calls + 1 error('torn', 0) end" }
    for _ = 1, 3 do
      exec_str("rfsm.reset(fsm)")
      start(arm, spin)
      assert(arm:stop()) -- an update between the two readings would part them
      assert.equal(evaluate(exec_str, "calls"),
        tostring(arm:getAttribute("rfsm_failures"):get()))
      assert(arm:cleanup())
    end
  end)

  it("is not started, nor entered, if the program's startHook refuses", function()
    local arm, exec_str = launched { enter = "start",
      poststr = "function startHook() return false end" }
    assert(arm:configure())
    assert.is_false(arm:start())
    assert.equal("false", evaluate(exec_str, "fsm._act_leaf"))
  end)

  it("is not woken by a timer that was unloaded, and says so once", function()
    local arm, exec_str = launched { timer = true, fsmfile = chart_file [[
      rfsm.trans { src = "a", tgt = "internal", events = { "e_every(0.1)" } },]] }
    arm:configure()
    arm:start()
    rtt_helper.spin()
    rtt_helper.deployer():getPeer("arm_timer"):stop()
    rtt_helper.deployer():getOperation("unloadComponent")("arm_timer")
    for _ = 1, 3 do exec_str("trigger()") end
    assert.same({ "Error: rfsm.rtt: time events are late from now on: 'arm_timer' was "
      .. "unloaded" }, logged("late"))
    assert.equal(0, arm:getAttribute("rfsm_failures"):get())
  end)

  it("with timer = true knows time events that the chart does not require", function()
    local _, exec_str = launched { timer = true, fsmfile = file_with [[
      return rfsm.state { a = rfsm.state {}, b = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = { "e_after(1)" } } } ]] }
    assert.equal("e_after(1)@root.a", evaluate(exec_str, "fsm[2].events[1]"))
    assert.same({}, logged("no loaded extension"))
  end)

  it("is woken exactly when a time event is due, without a period", function()
    local _, exec_str = launched { timer = true,
      prestr = "require('rfsm_timeevent').set_gettime_hook(rtt.getTime)",
      fsmfile = chart_file((DONE:gsub("e_done", "e_after(0.2)", 1))),
    }
    local arm = rtt_helper.deployer():getPeer("arm")
    start(arm, spin)
    advance(0.1)
    assert.equal("a", leaf_of(exec_str))
    advance(0.2)
    assert.equal("c", leaf_of(exec_str))
    arm:stop()
    assert.same({ "arm", "arm_timer" }, rtt_helper.loaded())
    assert.same({}, logged("needs timer = true"))
  end)

  it("logs that nothing wakes it for a time event, unless it has a period", function()
    local arm = launched { fsmfile = chart_file((DONE:gsub("e_done", "e_after(9)", 1))),
      prestr = "require 'rfsm_timeevent'" }
    start(arm, spin)
    local text = "Warning: e_after(9)@root.a is late: a component without a period "
      .. "needs timer = true"
    assert.same({ text }, logged("timer = true"))
    arm:stop()
    deploy("setActivity", "arm", 0.01, 0, 0)
    assert(arm:start())
    advance(1.1) -- lines that come again are written a second later
    assert.same({ text }, logged("timer = true"))
  end)

  it("names the chart in the log when it fails", function()
    local chart = file_with("return 3")
    assert.is_false((pcall(launched, { fsmfile = chart })))
    assert.equal(1, #logged("launch of '" .. chart .. "': rfsm.load: no valid rfsm"))
    assert.is_false((pcall(launched, { prestr = "error('x')" })))
    assert.equal(1, #logged("prestr:1: x"))
  end)

  local CLEANUP = "function cleanupHook() rttlib.tc_cleanup() rfsm.reset(fsm) end"

  for _, ports in ipairs { "launch", "configure" } do
    it("can be cleaned up and started again and again, ports made at " .. ports,
      function()
        local arm, exec_str = launched { sync = true, ev_outport = true,
          ports = ports == "configure" and ports or nil, poststr = CLEANUP }
        assert.equal(ports == "launch", has_port(arm, "fqn"))
        for _ = 1, 3 do
          assert(arm:configure())
          local send, came = connected("arm", spin)
          local out = listen("arm.events_out")
          assert(arm:start())
          spin()
          send("e_go")
          exec_str("emit_event('e_out')")
          assert.equal("<none> a b", came())
          assert.same({ "e_out" }, samples(out))
          assert.equal("fqn events_in", evaluate(exec_str,
            "fqn:info().name, ev_inport:info().name"))
          assert.is_true(arm:stop())
          assert.is_true(arm:cleanup())
          assert.same({}, arm:getPortNames())
          assert.equal("nil nil false", evaluate(exec_str,
            "fqn, ev_inport, fsm._act_leaf"))
        end
        assert(arm:configure())
        assert.equal(0, arm:getAttribute("rfsm_failures"):get())
      end)
  end

  -- A hook, and the calls of the component's methods that lead to it.
  for _, case in ipairs {
    { "configureHook", "configure" }, { "startHook", "configure", "start" },
    { "updateHook", "configure", "start" }, { "cleanupHook", "configure", "cleanup" },
    { "stopHook", "configure", "start", "stop" },
  } do
    it("logs a table that the program's " .. case[1] .. " raises as text", function()
      local arm = launched { poststr = ("function %s() %s end"):format(case[1],
        raising "no brake") }
      for i = 2, #case do arm[case[i]](arm) end
      spin()
      check_logged("error calling function " .. case[1] .. ": no brake")
    end)
  end

  it("finds the ports that the program's hook has made, and refuses wrong ones",
    function()
      local arm, exec_str = launched { ports = "configure", poststr = [[
function configureHook()
  rtt.getTC():addPort(rtt.OutputPort("string", "fqn"))
  rtt.getTC():addEventPort(rtt.InputPort(kind or "string", "events_in"))
  return true
end ]] .. CLEANUP }
      start(arm, spin)
      assert.same({}, logged("already in use"))
      assert.equal("a", leaves(listen("arm.fqn")))
      arm:stop()
      arm:cleanup()
      exec_str("kind = 'int'")
      assert.is_false(arm:configure())
      assert.equal(1, #logged("port 'events_in': input port of type string expected, "
        .. "got an input port of type int"))
    end)

  it("bears a cleanupHook that fails, and hooks that a lua_file defines", function()
    local arm = launched { sync = true }
    arm:getProperty("lua_file"):set(file_with [[
function cleanupHook() rttlib.tc_cleanup() error("no brake", 0) end
function startHook() return true end]])
    for i = 1, 3 do
      start(arm, spin)
      assert.equal("a", leaves(listen("arm.fqn")))
      arm:stop()
      arm:cleanup()
      assert.equal(i, #logged("no brake"))
    end
  end)

  it("makes its ports at the start, if a lua_file has another configureHook", function()
    local arm = launched { ports = "configure", enter = "start" }
    arm:getProperty("lua_file"):set(file_with(
      "function configureHook() return true end"))
    assert(arm:configure())
    assert.is_false(has_port(arm, "fqn"))
    assert(arm:start())
    assert.equal("a", leaves(listen("arm.fqn")))
  end)

  it("bears a clean-up of its ports by rttlib; can be unloaded, its name used again",
    function()
      local _, _, arm = started {
        poststr = "function cleanupHook() rttlib.tc_cleanup() end",
      }
      arm:stop()
      assert.is_true(arm:cleanup())
      assert.same({}, arm:getPortNames())
      assert.is_true(deploy("unloadComponent", "arm"))
      assert.equal("PreOperational", launched():getState())
    end)

  describe("refuses", function()
    -- The text, with what every text begins with taken off; and nothing is left.
    local function refused(args)
      local before = rtt_helper.loaded()
      local text = refusal(rfsm_rtt.component_launch_rfsm, args)
      assert.same(before, rtt_helper.loaded())
      text = text:gsub("^rfsm%.rtt%.component_launch_rfsm: ", "")
      return (text:gsub(", expected: .*", ""))
    end

    local function refused_with(fields) return refused(launch_fields(fields)) end

    it("what is no table, and fields that are missing", function()
      assert.equal("table of options expected, got nil", refused(nil))
      assert.equal("fsmfile: file name expected, got nil", refused { name = "arm" })
      assert.equal("name: string expected, got nil", refused { fsmfile = chart_file() })
    end)

    local endless = {}
    endless.t = endless
    local VALUE = ": string, finite number, boolean or table of these expected, got "

    for _, case in ipairs { -- what is reported, fields
      { "name: string expected, got 3", { name = 3 } },
      { "unknown option 'fsm_file' (did you mean 'fsmfile'?)", { fsm_file = "x" } },
      { "unknown option '1'", { "x" } },
      { "luatype: string expected, got boolean", { luatype = true } },
      { "sync: boolean expected, got string 'yes'", { sync = "yes" } },
      { "prefile: file name expected, got 1", { prefile = 1 } },
      { "ev_inport" .. VALUE .. "function", { ev_inport = print } },
      { "env.go" .. VALUE .. "function", { env = { go = print } } },
      { "env.t.1" .. VALUE .. "function", { env = { t = { print } } } },
      { "env.far" .. VALUE .. "number inf", { env = { far = math.huge } } },
      { "env" .. (".t"):rep(49) .. VALUE .. "table", { env = endless } },
      { "env: table of globals by name expected, got table", { env = { "speed" } } },
    } do
      it(case[1], function() assert.equal(case[1], refused_with(case[2])) end)
    end

    it("files that are not there, or no Lua", function()
      for _, name in ipairs { "fsmfile", "prefile", "postfile" } do
        assert.matches("^" .. name .. ": cannot open '?/nowhere/x.lua",
          refused_with { [name] = "/nowhere/x.lua" })
      end
      assert.matches("^fsmfile: [^\n]*:1: ",
        refused_with { fsmfile = file_with "return {" })
    end)

    for title, case in pairs { -- the reason, fields; any order: each is a spec
      ["a chart that is none"] = { "rfsm.load: no valid rfsm in file 'FILE' found. "
        .. "(a chart ends with: return rfsm.state{...})",
        { chart = "return 3" } },
      ["a chart that raises a table"] = { "as text", { chart = raising "as text" } },
      ["a chart with problems"] = { "no machine:\n  FILE:1: root.a.entry: "
        .. "function expected, got number 3\n  FILE:1: root.trans[1] "
        .. "(initial -> aa): tgt 'aa': no state or connector is named 'aa' in 'root' "
        .. "(did you mean 'a'?)", {
        chart = "return rfsm.state { a = rfsm.state { entry = 3 }, "
          .. "rfsm.trans { src = 'initial', tgt = 'aa' } }" } },
      ["a chart whose loading has no end"] = {
        "FILE:1: loading takes more than 0.1 s, is there a loop without end?", {
        chart = "while true do end",
        prestr = "require('rfsm.shared.limit').SECONDS = 0.1" } },
      ["a prestr that raises"] = { "no arm", { prestr = "error('no arm', 0)" } },
      ["a poststr that raises"] = { "no leg", { poststr = "error('no leg', 0)" } },
    } do
      it(title, function()
        local fields = case[2]
        fields.fsmfile = file_with(fields.chart or "return rfsm.state {}")
        fields.chart = nil
        local text = "launch of '" .. fields.fsmfile .. "': "
          .. case[1]:gsub("FILE", fields.fsmfile)
        assert.equal(text, refused_with(fields))
        check_logged(text:match("[^\n]+"))
      end)
    end

    it("a chart for which the pool is too small, and says what to do", function()
      local text = refused_with { luatype = "OCL::LuaTLSFComponent",
        fsmfile = file_with "error('not enough memory', 0)" }
      assert.matches("': not enough memory while the chart is loaded, %d+ of %d+ KiB "
        .. "in use %(%d+ %%%) without that: enlarge the pool by `pool = KIB` of the "
        .. "launch; 'rfsm size' prints how much a chart needs$", text)
    end)

    it("a name that a component has, and leaves that one alone", function()
      local arm = launched()
      assert.equal("the deployer loads no 'arm' of type 'OCL::LuaComponent', RTT's log "
        .. "has the reason", refused_with {})
      assert.same({ "arm" }, rtt_helper.loaded())
      assert.is_true(arm:configure())
    end)

    for _, case in ipairs { -- what is reported, fields
      { "the deployer loads no 'arm' of type 'OCL::Lua', RTT's log has the reason",
        { luatype = "OCL::Lua" } },
      { "luatype: type of a Lua component expected, got 'OCL::HelloWorld'",
        { luatype = "OCL::HelloWorld" } },
      { "deployer: a deployer or the name of a peer expected, got string 'nobody'",
        { deployer = "nobody" } },
      { "deployer: a deployer or the name of a peer expected, got number 7",
        { deployer = 7 } },
      { "deployer: a deployer or the name of a peer expected, got table",
        { deployer = {} } },
    } do
      it("what is no deployer or type, such as " .. case[1], function()
        assert.equal(case[1], refused_with(case[2]))
      end)
    end
  end)
end)

-- The collector: of a pool, and of other Luas --------------------------------------

describe("rfsm.rtt in a pool, and only there,", function()
  -- Runs code in a component with a pool, and in one without; compares two values.
  local function compare(code, value, in_pool, elsewhere)
    for kind, expected in pairs { -- any order: each stands alone
      TLSFComponent = in_pool, Component = elsewhere,
    } do
      local _, exec_str = load(kind, "OCL::Lua" .. kind)
      assert(exec_str(code))
      assert.equal(expected, evaluate(exec_str, value))
    end
  end

  it("sets the collector", function()
    compare([[
      local collect = collectgarbage
      calls = ""
      function collectgarbage(what, number)
        if not number then return collect(what) end
        calls = calls .. what .. " " .. number .. ", "
      end
      require "rfsm.rtt"
      collectgarbage = collect]], "calls", "setpause 100, setstepmul 3000, ", "")
  end)

  it("has no code generated", function()
    compare([[
      require "rfsm.rtt"
      local rfsm = require "rfsm"
      local fsm = rfsm.init(rfsm.state { info = false, warn = false,
        a = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" } })
      rfsm.prepare(fsm)]], "package.loaded['rfsm.fast'] ~= nil", "false", "true")
  end)

  -- Makes machines of a chart with data, and of one with a mistake.
  local INIT = [[
    require "rfsm.rtt"
    local rfsm = require "rfsm"
    local function root(initial)
      return rfsm.state { info = false, warn = false, err = false, limits = { 1 },
        a = rfsm.state { speeds = { 2 } },
        rfsm.trans { src = "initial", tgt = initial } }
    end
    is_made = rfsm.init(root("a")) and true
    text = select(2, rfsm.init(root("aa"))):match("did you mean '.-'")
    local weak = setmetatable({ rawget(package.loaded["rfsm.advice"], "nearest_name") },
      { __mode = "v" })
    rfsm_rtt.forget_modules()
    if jit then jit.flush() end -- compiled code keeps functions
    collectgarbage()
    is_kept = weak[1] ~= nil]]

  it("has hints for problems, and leaves none of them in memory", function()
    compare(INIT, "is_made, text, is_kept", "true did you mean 'a' false",
      "true did you mean 'a' true")
  end)
end)

-- Since 5.4 it is set in another way.
describe("the collector of a component's Lua", function()
  if _VERSION > "Lua 5.3" then return end
  local pause, step_multiplier

  before_each(function()
    pause = collectgarbage("setpause", 200)
    step_multiplier = collectgarbage("setstepmul", 200)
  end)

  after_each(function()
    collectgarbage("setpause", pause)
    collectgarbage("setstepmul", step_multiplier)
  end)

  local function loading(luatype)
    local _, exec_str = load("arm", luatype)
    assert(exec_str("require 'rfsm.rtt'"))
    return exec_str
  end

  local function launching(luatype, prestr)
    return rfsm_rtt.component_launch_rfsm { name = "arm", luatype = luatype,
      fsmfile = chart_file(), prestr = prestr }:getOperation("exec_str")
  end

  local POOL = "OCL::LuaTLSFComponent"
  for title, case in pairs { -- any order: each is a spec of its own
    ["never pauses in a pool where rfsm.rtt is loaded"] = { "100 3000", loading, POOL },
    ["never pauses in a pool after a launch"] = { "100 3000", launching, POOL },
    ["is as a prestr sets it"] = { "120 3000", launching, POOL,
      "collectgarbage('setpause', 120)" },
    ["is left alone without a pool"] = { "200 200", loading, "OCL::LuaComponent" },
  } do
    it(title, function()
      assert.equal(case[1], evaluate(case[2](case[3], case[4]),
        "collectgarbage('setpause', 200), collectgarbage('setstepmul', 200)"))
    end)
  end
end)

-- Random charts: in a component as without RTT -------------------------------------

describe("a launched machine", function()
  local new_random = require "spec.support.random"

  -- A chart as text. An `e_done` leads to a later state, so that each run has an end.
  local function random_chart(random)
    local lines, n = {}, 1 + random:below(4)
    for i = 1, n do lines[i] = ("s%d = rfsm.state {},"):format(i) end
    lines[#lines + 1] = "rfsm.trans { src = 'initial', tgt = 's1' },"
    for _ = 1, 2 * n do
      local src, tgt = random:below(n), random:below(n)
      local event = src < tgt and random:chance(30) and "e_done"
        or "e_" .. random:below(3)
      lines[#lines + 1] = ("rfsm.trans { src = 's%d', tgt = 's%d', events = { '%s' }, "
        .. "pn = %d },"):format(src, tgt, event, random:below(3))
    end
    return "local rfsm = require 'rfsm'\nreturn rfsm.state { info = false, "
      .. "warn = false, " .. table.concat(lines, "\n") .. "}"
  end

  -- Returns a machine of the chart, which writes its leaves; and the function that
  -- returns those that came.
  local function without_rtt(file)
    local list, fsm = {}, assert(rfsm.init(rfsm.load(file)))
    rfsm.post_step_hook_add(fsm, rfsm_rtt.gen_write_fqn {
      write = function(_, fqn) list[#list + 1] = fqn:gsub("root%.", "") end })
    return fsm, function()
      local text = table.concat(list, " ")
      list = {}
      return text
    end
  end

  -- Compares when threads have had the time that they need.
  local function check_leaves(names, wanted, message)
    local came, tries = leaves(names), 0
    while came ~= wanted and tries < 25 do
      spin()
      local more = leaves(names)
      came, tries = (came .. " " .. more):gsub("^ ", ""):gsub(" $", ""), tries + 1
    end
    assert.equal(wanted, came, message)
  end

  it("writes the leaves that it writes without RTT, whatever is stopped, started and "
    .. "cleaned up", function()
    local n = share.count(8)
    for seed = share.seed(n), share.seed(n) + n - 1 do
      local random = new_random(seed)
      local file = file_with(random_chart(random))
      local fsm, expected = without_rtt(file)
      local arm = rfsm_rtt.component_launch_rfsm { name = "arm", fsmfile = file,
        steps = 1 + random:below(3), enter = random:chance(50) and "start" or nil,
        ports = random:chance(50) and "configure" or nil,
        poststr = "function cleanupHook() rttlib.tc_cleanup() rfsm.reset(fsm) end" }
      local events, names
      local function begin()
        assert(arm:configure())
        events, names = feed("arm.events_in"), listen("arm.fqn")
        assert(arm:start())
        spin()
        rfsm.run(fsm)
      end
      begin()
      for _ = 1, 12 do
        if random:chance(10) then
          arm:stop()
          check_leaves(names, expected(), "seed " .. seed)
          arm:cleanup()
          rfsm.reset(fsm)
          begin()
        else
          local count = random:below(3) -- a thread could read one before the others
          if count > 1 then arm:stop() end
          for _ = 1, count do
            local event = "e_" .. random:below(4)
            events:write(event)
            rfsm.send_events(fsm, event)
          end
          if count > 1 then arm:start() end
        end
        rfsm.run(fsm)
        spin()
        check_leaves(names, expected(), "seed " .. seed)
      end
      rtt_helper.reset()
    end
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

it("examples/hosts/rtt_host.lua drives a component, and leaves nothing #standin",
  function()
    if not rtt_helper.is_standin then return end
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
