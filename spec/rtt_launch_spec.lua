-- Machines launched in services and components of RTT, on the stand-in in
-- spec/support/rtt.lua; what is refused, and that nothing is left then.

local helper = require "spec.helper"
local rtt = require "spec.support.rtt"
local rtt_helper = require "spec.support.rtt_helper" -- before rfsm.rtt

local rfsm_rtt = require "rfsm.rtt"

local samples, write_all = rtt_helper.samples, rtt_helper.write_all
local refusal, counting_variables, file_with =
  rtt_helper.refusal, rtt_helper.counting_variables, rtt_helper.file_with
local chart_file, logged, wire =
  rtt_helper.chart_file, rtt_helper.logged, rtt_helper.wire
local evaluate = rtt_helper.evaluate
local standin = rtt.standin

before_each(rtt_helper.reset)
after_each(rtt_helper.reset)

local deployer

-- Charts that cannot be launched: what they are, their text, what is said.
local WRONG_CHARTS = {
  { "is no chart", "return 3", "rfsm.load: no valid rfsm in file '%s' found." },
  { "raises", "error('no hardware', 0)", "no hardware" },
  { "raises a table", "error(setmetatable({}, { __tostring = function() "
    .. "return 'a table' end }))", "a table" },
  { "has problems", [[
local rfsm = require "rfsm"
return rfsm.state {
  a = rfsm.state { entry = 3 },
  rfsm.trans { src = "initial", tgt = "aa" },
}]], "rfsm.init: the model has 2 problems\n"
    .. "  root.a.entry: function expected, got number 3\n"
    .. "  root.trans[1]: tgt 'aa': no state or connector is named 'aa' in 'root' "
    .. "(did you mean 'a'?)" },
  { "has one problem", [[
local rfsm = require "rfsm"
return rfsm.state {
  a = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a", pn = "high" },
}]], "rfsm.init: the model has 1 problem\n"
    .. "  root.trans[1].pn: number expected, got string 'high'" },
}

-- Arguments that are wrong in `env`, and what is said.
local WRONG_ENVS = {
  { "env.go: string, number, boolean or a table of these expected, got function",
    function() return { go = print } end },
  { "env.t.x.2: string, number, boolean or a table of these expected, got thread",
    function()
      return { t = { x = { 1, coroutine.create(function() end) } } }
    end },
  { "env: names expected as keys, got number 1", function() return { "speed" } end },
  { "env: strings or numbers expected as keys, got boolean", function()
    return { [true] = 1 }
  end },
  { "env.t.t: a table that contains itself", function()
    local t = {}
    t.t = t
    return { t = t }
  end },
}

local ENV = {
  speed = 3.5, name = "it's\n\"quoted\" \\ 100%", is_fast = true, is_slow = false,
  list = { 1, 2, { x = { "y" } } }, count = 3, many = 1e300, never = math.huge,
  whole = 3.0,
}
ENV.same = ENV.list

local ENV_TEXT = "speed, name, is_fast, is_slow, list[2], list[3].x[1], same[1], "
  .. "count, many, whole, never == math.huge"

local function env_values()
  return table.concat({
    "3.5", "it's\n\"quoted\" \\ 100%", "true", "false", "2", "y", "1", "3",
    tostring(1e300), tostring(3.0), "true",
  }, " ")
end

-- Services ---------------------------------------------------------------------

describe("service_launch_rfsm", function()
  local host, exec_str

  before_each(function()
    deployer = rtt.getTC():getPeer("Deployer")
    deployer:import("ocl")
    deployer:loadComponent("arm", "OCL::HelloWorld")
    deployer:loadService("arm", "Lua")
    host = deployer:getPeer("arm")
    exec_str = host:provides("Lua"):getOperation("exec_str")
    host:start()
    standin.spin()
  end)

  local function update()
    host:trigger()
    standin.spin()
  end

  it("runs the machine at each update of its component", function()
    assert.is_true(rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true))
    local events, names = wire(host)
    assert.same({ "<none>" }, samples(names))
    update()
    assert.same({ "root.a" }, samples(names))
    events:write("e_go")
    assert.same({}, samples(names))
    update()
    assert.same({ "root.b" }, samples(names))
    write_all(events, "e_none", "e_back")
    update()
    update()
    assert.same({ "root.a" }, samples(names))
  end)

  it("does not let events trigger the component", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
    local events, names = wire(host)
    update()
    samples(names)
    events:write("e_go")
    standin.spin()
    assert.same({}, samples(names))
  end)

  it("leaves updates to the caller without eehook", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str)
    local _, names = wire(host)
    update()
    assert.same({ "<none>" }, samples(names))
    assert.equal("true", evaluate(exec_str, "rfsm_update()"))
    assert.same({ "root.a" }, samples(names))
  end)

  it("makes the machine a global of the service, and none here", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
    assert.equal("true", evaluate(exec_str, "rfsm.is_initialized_root(fsm)"))
    for _, name in ipairs { "fsm", "rfsm_update", "rfsm_eehook" } do
      assert.is_nil(rawget(_G, name))
    end
  end)

  it("keeps the hook when garbage is collected", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
    local _, names = wire(host)
    collectgarbage()
    collectgarbage()
    update()
    assert.same({ "<none>", "root.a" }, samples(names))
  end)

  it("lets the hook be disabled", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
    local events, names = wire(host)
    update()
    exec_str("rfsm_eehook:disable()")
    events:write("e_go")
    update()
    assert.same({ "<none>", "root.a" }, samples(names))
  end)

  it("keeps the hook when a printer raises, and logs that", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
    local events, names = wire(host)
    update()
    exec_str("fsm.dbg = function() error('no paper', 0) end")
    events:write("e_go")
    update()
    exec_str("fsm.dbg = false")
    events:write("e_back")
    update()
    assert.same({ "Error: rfsm.rtt: no paper" }, logged("no paper"))
    assert.same({ "<none>", "root.a", "root.b", "root.a" }, samples(names))
  end)

  it("lets the machine print to RTT's log", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
    exec_str("fsm.a.entry = function() error({}, 0) end")
    exec_str("fsm.warn('oil', 3, nil)")
    update()
    assert.same({ "Info: INFO: created undeclared connector root.initial" },
      logged("INFO"))
    assert.same({ "Warning: oil 3 nil" }, logged("oil"))
    assert.equal(1, #logged("Error: ENTRY error executing entry of root.a:  table"))
  end)

  it("leaves the printers of a chart alone", function()
    rfsm_rtt.service_launch_rfsm(chart_file("info = false, warn = print, err = print,"),
      exec_str, true)
    assert.same({}, standin.log)
    assert.equal("true", evaluate(exec_str, "fsm.warn == print and fsm.err == print"))
  end)

  it("defines env first, whatever is in it", function()
    rfsm_rtt.service_launch_rfsm(chart_file("data = { speed, name },"), exec_str, false,
      ENV)
    assert.equal(env_values(), evaluate(exec_str, ENV_TEXT))
    assert.equal("3.5", evaluate(exec_str, "fsm.data[1]"))
  end)

  it("sets no global of a module's name when env says so", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true,
      { RFSM_NO_GLOBALS = true })
    assert.equal("nil nil true", evaluate(exec_str, "rfsm, rfsm_rtt, fsm ~= nil"))
  end)

  it("leaves events to a chart that has a getevents", function()
    rfsm_rtt.service_launch_rfsm(chart_file("getevents = function() return mail end,"),
      exec_str, true)
    assert.same({ "rFSM_cur_fqn" }, host:getPortNames())
    local _, names = wire(host, false)
    update()
    exec_str("mail = { 'e_go' }")
    update()
    assert.same({ "<none>", "root.a", "root.b" }, samples(names))
  end)

  it("finds the modules where the caller does", function()
    local before = package.path
    exec_str("package.path = '/nowhere/?.lua'")
    rfsm_rtt.service_launch_rfsm(file_with("return rfsm.state { a = rfsm.state {}, "
      .. "rfsm.trans { src = 'initial', tgt = 'a' } }"), exec_str)
    assert.equal("/nowhere/?.lua;" .. before, evaluate(exec_str, "package.path"))
  end)

  it("accepts a function in the place of the operation", function()
    local lua = require("spec.support.lua_state").new()
    lua.globals.rtt = rtt
    rfsm_rtt.service_launch_rfsm(chart_file(), function(code) assert(lua:run(code)) end)
    assert.equal("table", type(lua.globals.fsm))
  end)

  it("keeps two services apart", function()
    deployer:loadComponent("leg", "OCL::HelloWorld")
    deployer:loadService("leg", "Lua")
    local leg, chart_name = deployer:getPeer("leg"), chart_file()
    leg:start()
    rfsm_rtt.service_launch_rfsm(chart_name, exec_str, true)
    rfsm_rtt.service_launch_rfsm(chart_name,
      leg:provides("Lua"):getOperation("exec_str"), true)
    local events, names = wire(host)
    local _, names_of_leg = wire(leg)
    update()
    leg:trigger()
    events:write("e_go")
    update()
    assert.same({ "<none>", "root.a", "root.b" }, samples(names))
    assert.same({ "<none>", "root.a" }, samples(names_of_leg))
  end)

  describe("refuses", function()
    local function refused(...)
      return refusal(rfsm_rtt.service_launch_rfsm, ...)
    end

    -- What the service and its component have, before and after.
    local function nothing_left()
      assert.same({}, host:getPortNames())
      assert.equal("nil nil nil nil",
        evaluate(exec_str, "fsm, rfsm_update, rfsm_eehook, speed"))
    end

    it("what is no file name", function()
      assert.equal("rfsm.rtt.service_launch_rfsm: file: file name expected, got nil",
        refused(nil, exec_str))
    end)

    it("a file that is not there", function()
      assert.equal("rfsm.rtt.service_launch_rfsm: file '/nowhere/x.lua': No such file "
        .. "or directory", refused("/nowhere/x.lua", exec_str))
    end)

    it("a file that is no Lua", function()
      local name = file_with("return {")
      local text = refused(name, exec_str)
      assert.equal("rfsm.rtt.service_launch_rfsm: file '" .. name .. "': ",
        text:match("^(.-': )"))
      assert.is_truthy(text:find(":1: ", 1, true))
      assert.same({}, standin.log)
    end)

    it("what is no operation", function()
      assert.equal("rfsm.rtt.service_launch_rfsm: exec_str: the operation exec_str "
        .. "expected, got nil (component:provides(\"Lua\"):getOperation(\"exec_str\") "
        .. "would be right)", refused(chart_file(), nil))
    end)

    it("an eehook that is no boolean", function()
      assert.equal("rfsm.rtt.service_launch_rfsm: eehook: boolean expected, got string "
        .. "'updateHook'", refused(chart_file(), exec_str, "updateHook"))
    end)

    it("an env that is no table", function()
      assert.equal("rfsm.rtt.service_launch_rfsm: env: table expected, got number 3",
        refused(chart_file(), exec_str, true, 3))
    end)

    for _, case in ipairs(WRONG_ENVS) do
      it("an env with " .. case[1], function()
        assert.equal("rfsm.rtt.service_launch_rfsm: " .. case[1],
          refused(chart_file(), exec_str, true, case[2]()))
        nothing_left()
      end)
    end

    for _, case in ipairs(WRONG_CHARTS) do
      it("a chart that " .. case[1], function()
        local name = file_with(case[2])
        local text = case[3]:gsub("%%s", (name:gsub("%%", "%%%%")))
        assert.equal("rfsm.rtt.service_launch_rfsm: " .. text,
          refused(name, exec_str, true, { speed = 3 }))
        nothing_left()
      end)
    end

    it("a port name that is in use, and leaves that port connected", function()
      local own, feed = rtt.InputPort("string"), rtt.OutputPort("string")
      host:addPort(own, "rFSM_events")
      feed:connect(own)
      assert.equal("rfsm.rtt.service_launch_rfsm: 'arm' has a port 'rFSM_events' "
        .. "already", refused(chart_file(), exec_str, true))
      assert.same({ "rFSM_events" }, host:getPortNames())
      assert.is_true(own:connected())
    end)

    it("the other port name likewise, and an events port is not made", function()
      host:addPort(rtt.OutputPort("int"), "rFSM_cur_fqn")
      assert.equal("rfsm.rtt.service_launch_rfsm: 'arm' has a port 'rFSM_cur_fqn' "
        .. "already", refused(chart_file(), exec_str, true))
      assert.same({ "rFSM_cur_fqn" }, host:getPortNames())
      assert.equal("int", host:getPort("rFSM_cur_fqn"):info().type)
    end)

    it("a second machine in one service, and leaves the first alone", function()
      rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
      local _, names = wire(host)
      assert.equal("rfsm.rtt.service_launch_rfsm: a machine was launched here before, "
        .. "it is the global 'fsm'", refused(chart_file(), exec_str, true))
      update()
      assert.same({ "<none>", "root.a" }, samples(names))
    end)

    it("a Lua without RTT", function()
      local lua = require("spec.support.lua_state").new()
      local function execute(code) return (lua:run(code)) end
      assert.equal("rfsm.rtt.service_launch_rfsm: module 'rtt' is not there, this is "
        .. "no Lua of RTT", refused(chart_file(), execute))
      assert.is_nil(lua.globals.fsm)
    end)

    it("a Lua in which the hook cannot be made, and takes all back", function()
      exec_str("fsm = 'mine' rtt.EEHook = function() "
        .. "return { enable = function() error('no engine', 0) end } end")
      assert.equal("rfsm.rtt.service_launch_rfsm: no engine",
        refused(chart_file(), exec_str, true, { speed = 3 }))
      assert.same({}, host:getPortNames())
      assert.equal("mine nil nil nil",
        evaluate(exec_str, "fsm, rfsm_update, rfsm_eehook, speed"))
    end)

    it("an operation that fails and says nothing", function()
      assert.equal("rfsm.rtt.service_launch_rfsm: the other Lua reports a failure, "
        .. "RTT's log says which", refused(chart_file(), function() return false end))
    end)

    it("an operation that raises", function()
      assert.equal("rfsm.rtt.service_launch_rfsm: no connection",
        refused(chart_file(), function() error("no connection", 0) end))
    end)
  end)

  it("leaves no file behind", function()
    local names, real = {}, os.tmpname
    rawset(os, "tmpname", function()
      names[#names + 1] = real()
      return names[#names]
    end)
    pcall(rfsm_rtt.service_launch_rfsm, chart_file(), exec_str, true)
    pcall(rfsm_rtt.service_launch_rfsm, chart_file(), exec_str, true)
    rawset(os, "tmpname", real)
    assert.equal(4, #names) -- two charts, two reports
    assert.is_nil(io.open(names[2]))
    assert.is_nil(io.open(names[4]))
  end)
end)

-- Components -------------------------------------------------------------------

describe("component_launch_rfsm", function()
  before_each(function()
    deployer = rtt.getTC():getPeer("Deployer")
    deployer:import("ocl")
  end)

  -- Launches with these fields and the usual ones.
  local function launched(fields)
    local args = { name = "arm", deployer = deployer }
    for key, value in pairs(fields or {}) do args[key] = value end -- any order: a set
    args.fsmfile = args.fsmfile or chart_file()
    return rfsm_rtt.component_launch_rfsm(args)
  end

  it("loads and configures a component, and does not start it", function()
    local arm = launched()
    assert.equal("Stopped", arm:getState())
    assert.same({ "arm" }, deployer:getPeers())
    assert.same({ "rFSM_cur_fqn", "rFSM_events" }, arm:getPortNames())
    local _, names = wire(arm)
    standin.spin()
    assert.same({ "<none>" }, samples(names))
  end)

  it("enters the machine when it is started", function()
    local arm = launched()
    local _, names = wire(arm)
    assert.is_true(arm:start())
    standin.spin()
    assert.same({ "<none>", "root.a" }, samples(names))
  end)

  it("runs the machine when an event comes", function()
    local arm = launched()
    local events, names = wire(arm)
    arm:start()
    standin.spin()
    events:write("e_go")
    standin.spin()
    write_all(events, "e_back", "e_none")
    standin.spin()
    assert.same({ "<none>", "root.a", "root.b", "root.a" }, samples(names))
  end)

  it("runs it until nothing is left to do", function()
    local arm = launched { fsmfile = file_with [[
return rfsm.state {
  a = rfsm.state {}, b = rfsm.state {}, c = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_done" } },
  rfsm.trans { src = "b", tgt = "c", events = { "e_done" } },
}]] }
    local _, names = wire(arm)
    arm:start()
    standin.spin()
    assert.same({ "<none>", "root.a", "root.b", "root.c" }, samples(names))
  end)

  it("runs with the period that the deployer gives it", function()
    local arm = launched()
    local events, names = wire(arm)
    assert.is_true(deployer:setActivity("arm", 0.01, 0, 0))
    arm:start()
    standin.advance(0.01)
    assert.same({ "<none>", "root.a" }, samples(names))
    events:write("e_go")
    standin.advance(0.009)
    assert.same({}, samples(names))
    standin.advance(0.001)
    assert.same({ "root.b" }, samples(names))
  end)

  it("lets time events pass on RTT's clock", function()
    local arm = launched {
      prefile = file_with("require('rfsm_timeevent').set_gettime_hook(rtt.getTime)"),
      fsmfile = file_with [[
return rfsm.state {
  a = rfsm.state {}, b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_after(0.1)" } },
}]] }
    local _, names = wire(arm)
    deployer:setActivity("arm", 0.01, 0, 0)
    arm:start()
    standin.advance(0.11)
    assert.same({ "<none>", "root.a" }, samples(names))
    standin.advance(0.01)
    assert.same({ "root.b" }, samples(names))
  end)

  describe("with sync", function()
    it("is not triggered by events", function()
      local arm = launched { sync = true }
      local events, names = wire(arm)
      arm:start()
      standin.spin()
      events:write("e_go")
      standin.spin()
      assert.same({ "<none>", "root.a" }, samples(names))
    end)

    it("takes one step at each update, however busy a doo is", function()
      local arm = launched { sync = true, fsmfile = file_with [[
return rfsm.state {
  a = rfsm.state { doo = function(fsm)
    for i = 1, 3 do
      fsm.cycles = i
      rfsm.yield()
    end
  end },
  b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_done" } },
}]] }
      local _, names = wire(arm)
      deployer:setActivity("arm", 0.01, 0, 0)
      arm:start()
      local cycles = {}
      for i = 1, 4 do
        standin.advance(0.01)
        cycles[i] = evaluate(arm:getOperation("exec_str"), "fsm.cycles")
      end
      assert.same({ "nil", "1", "2", "3" }, cycles)
      standin.advance(0.02)
      assert.same({ "<none>", "root.a", "root.b" }, samples(names))
    end)

    it("serves a component that another one executes", function()
      local arm = launched { sync = true }
      local events, names = wire(arm)
      deployer:setSlaveActivity("arm", 0)
      arm:start()
      assert.is_true(arm:update())
      events:write("e_go")
      assert.is_true(arm:update())
      assert.same({ "<none>", "root.a", "root.b" }, samples(names))
    end)
  end)

  describe("with ev_inport", function()
    it("as a name reads events from a port of that name", function()
      local arm = launched { ev_inport = "commands" }
      assert.same({ "rFSM_cur_fqn", "commands" }, arm:getPortNames())
      local events, names = wire(arm, "commands")
      arm:start()
      standin.spin()
      events:write("e_go")
      standin.spin()
      assert.same({ "<none>", "root.a", "root.b" }, samples(names))
    end)

    it("false has no port for events", function()
      assert.same({ "rFSM_cur_fqn" }, launched { ev_inport = false }:getPortNames())
    end)

    it("not given leaves events to a chart that has a getevents", function()
      local arm = launched { fsmfile = chart_file "getevents = function() end," }
      assert.same({ "rFSM_cur_fqn" }, arm:getPortNames())
    end)

    it("true has the port, and the chart's getevents is asked first", function()
      local arm = launched { ev_inport = true, fsmfile = file_with [[
return rfsm.state {
  getevents = function()
    local events = mail
    mail = nil
    return events
  end,
  dbg = function(id, event) if id == "RAISED" then print(event) end end,
  a = rfsm.state { doo = function() while true do rfsm.yield(true) end end },
  rfsm.trans { src = "initial", tgt = "a" },
}]] }
      local events = wire(arm)
      arm:start()
      standin.spin()
      arm:getOperation("exec_str")("mail = { 'e_1', nil, 'e_3' }")
      local lines = helper.printed(function()
        write_all(events, "e_4", "e_5")
        standin.spin()
      end)
      assert.equal("e_1", lines[1])
      assert.same({ "e_4", "e_5" }, { lines[#lines - 1], lines[#lines] })
    end)
  end)

  describe("with further files", function()
    it("runs prefile before the chart, postfile after, and env before all", function()
      local arm = launched {
        env = { words = "env" }, prefile = file_with "words = words .. ' prefile'",
        postfile = file_with "words = words .. ' postfile ' .. fsm.words",
        fsmfile = chart_file "words = words .. ' chart',",
      }
      assert.equal("env prefile postfile env prefile chart",
        evaluate(arm:getOperation("exec_str"), "words"))
    end)

    it("lets postfile set up the machine", function()
      local arm = launched { postfile = file_with [[
fsm.b.entry = function() print("in b") end
]] }
      local events = wire(arm)
      arm:start()
      standin.spin()
      events:write("e_go")
      assert.same({ "in b" }, helper.printed(standin.spin))
    end)

    it("lets them define further hooks of the component", function()
      local prefile = file_with "function startHook() return false end"
      local arm = launched { prefile = prefile }
      assert.is_false(arm:start())
    end)
  end)

  it("finds the deployer itself, or by the name of a peer", function()
    local args = { name = "arm", fsmfile = chart_file() }
    assert.equal("arm", rfsm_rtt.component_launch_rfsm(args):getName())
    args.name, args.deployer = "leg", "Deployer"
    assert.equal("leg", rfsm_rtt.component_launch_rfsm(args):getName())
  end)

  it("loads a component of the type asked for", function()
    local types, real = {}, deployer.operations.loadComponent.f
    deployer.operations.loadComponent.f = function(name, luatype)
      types[#types + 1] = luatype
      return real(name, luatype)
    end
    launched()
    launched { name = "leg", luatype = "OCL::LuaTLSFComponent" }
    assert.same({ "OCL::LuaComponent", "OCL::LuaTLSFComponent" }, types)
  end)

  it("touches no global here", function()
    launched { env = { speed = 3 } }
    for _, name in ipairs { "fsm", "updateHook", "configureHook", "cleanupHook",
      "speed" } do
      assert.is_nil(rawget(_G, name))
    end
  end)

  it("logs what a printer raises, and goes on", function()
    local arm = launched()
    local events, names = wire(arm)
    arm:start()
    standin.spin()
    arm:getOperation("exec_str")("fsm.dbg = function() error('no paper', 0) end")
    events:write("e_go")
    standin.spin()
    assert.same({ "Error: rfsm.rtt: no paper" }, logged("no paper"))
    assert.same({ "<none>", "root.a", "root.b" }, samples(names))
  end)

  describe("a component launched so", function()
    it("goes on where it was when it is stopped and started", function()
      local arm = launched()
      local events, names = wire(arm)
      arm:start()
      standin.spin()
      arm:stop()
      events:write("e_go")
      standin.spin()
      assert.same({ "<none>", "root.a" }, samples(names))
      arm:start()
      standin.spin()
      assert.same({ "root.b" }, samples(names))
    end)

    it("has no ports and no machine after cleanup", function()
      local arm = launched()
      local port = arm:getPort("rFSM_events")
      arm:cleanup()
      assert.is_true(port.is_deleted)
      assert.same({}, arm:getPortNames())
      assert.equal("nil", evaluate(arm:getOperation("exec_str"), "fsm"))
    end)

    it("has a fresh machine when it is configured again", function()
      local arm = launched()
      local events = wire(arm)
      arm:start()
      standin.spin()
      events:write("e_go")
      standin.spin()
      arm:stop()
      arm:cleanup()
      assert.is_true(arm:configure())
      local _, names = wire(arm)
      arm:start()
      standin.spin()
      assert.same({ "<none>", "root.a" }, samples(names))
    end)

    it("has one set of ports when it is configured twice in a row", function()
      local arm = launched()
      assert.is_true(arm:configure())
      assert.same({ "rFSM_cur_fqn", "rFSM_events" }, arm:getPortNames())
      assert.same({}, logged("Warning: 'addPort'"))
    end)

    it("is not configured again when its chart has gone wrong meanwhile", function()
      local name = chart_file()
      local report, real = nil, os.tmpname
      rawset(os, "tmpname", function()
        report = real()
        return report
      end)
      local arm = launched { fsmfile = name }
      rawset(os, "tmpname", real)
      local file = assert(io.open(name, "w"))
      file:write("error('edited', 0)")
      file:close()
      assert.is_false(arm:configure())
      assert.equal("PreOperational", arm:getState())
      assert.same({ "Error: rfsm.rtt: edited" }, logged("edited"))
      assert.is_nil(io.open(report)) -- nobody waits for a report any more
      assert.same({}, arm:getPortNames())
    end)

    it("leaves a model that others use as it was", function()
      local arm = launched {
        prefile = file_with [[
package.preload.model = package.preload.model or function()
  return rfsm.state { a = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" } }
end]],
        fsmfile = file_with "return require 'model'",
      }
      local exec_str = arm:getOperation("exec_str")
      assert.equal("nil nil nil", evaluate(exec_str,
        "require('model').err, require('model').warn, require('model').info"))
      arm:configure()
      exec_str("fsm.a.entry = function() error('no oil', 0) end")
      arm:start()
      standin.spin()
      assert.equal(1, #logged("no oil"))
    end)

    it("bears a clean-up of its ports by others", function()
      local arm = launched { postfile = file_with [[
function cleanupHook() -- as rttlib.tc_cleanup does
  local component = rtt.getTC()
  for _, name in ipairs(component:getPortNames()) do
    local port = component:getPort(name)
    component:removePort(name)
    port:delete()
  end
end]] }
      arm:cleanup()
      assert.same({}, arm:getPortNames())
      assert.is_true(arm:configure())
      assert.same({ "rFSM_cur_fqn", "rFSM_events" }, arm:getPortNames())
      assert.same({}, logged("Error"))
    end)

    it("does nothing in updates when its configureHook was replaced", function()
      local arm = launched()
      arm:cleanup()
      arm:getOperation("exec_str")("function configureHook() return true end")
      arm:configure()
      arm:start()
      standin.spin()
      assert.same({}, logged("Error"))
    end)

    it("can be unloaded, and its name used again", function()
      launched()
      assert.is_true(deployer:unloadComponent("arm"))
      assert.equal("Stopped", launched():getState())
    end)

    it("shares nothing with another one of the same chart", function()
      local name = chart_file()
      local arm = launched { fsmfile = name }
      local leg = launched { fsmfile = name, name = "leg" }
      local events, names = wire(arm)
      local _, names_of_leg = wire(leg)
      arm:start()
      leg:start()
      standin.spin()
      events:write("e_go")
      standin.spin()
      assert.same({ "<none>", "root.a", "root.b" }, samples(names))
      assert.same({ "<none>", "root.a" }, samples(names_of_leg))
    end)

    it("makes no Variable in the steady state", function()
      local arm = launched()
      local events = wire(arm)
      arm:start()
      standin.spin()
      assert.equal(0, counting_variables(function()
        for _ = 1, 10 do
          write_all(events, "e_go", "e_none")
          standin.spin()
          events:write("e_back")
          standin.spin()
        end
      end))
    end)
  end)

  describe("refuses", function()
    -- The text, with what every text begins with taken off; and nothing is left.
    local function refused(args)
      local before = deployer:getPeers()
      local text = refusal(rfsm_rtt.component_launch_rfsm, args)
      assert.same(before, deployer:getPeers())
      return (text:gsub("^rfsm%.rtt%.component_launch_rfsm: ", ""))
    end

    local function refused_with(fields)
      local args = { name = "arm", deployer = deployer, fsmfile = chart_file() }
      for key, value in pairs(fields) do args[key] = value end -- any order: a set
      local text = refused(args)
      assert.same({}, deployer:getPeers())
      return text
    end

    it("what is no table", function()
      assert.equal("table expected, got nil", refused(nil))
      assert.equal("table expected, got string 'arm'", refused("arm"))
    end)

    it("fields that are missing", function()
      assert.equal("name: string expected, got nil", refused {})
      assert.equal("fsmfile: file name expected, got nil", refused { name = "arm" })
    end)

    local FIELDS = {
      { { name = "" }, "name: string expected, got string ''" },
      { { name = 3 }, "name: string expected, got number 3" },
      { { fsm_file = "x" }, "unknown field 'fsm_file' (did you mean 'fsmfile'?)" },
      { { evinport = "x", zzzzzz = 1 },
        "unknown field 'evinport' (did you mean 'ev_inport'?)" },
      { { "arm" }, "unknown field '1'" },
      { { luatype = true }, "luatype: string expected, got boolean" },
      { { sync = "yes" }, "sync: boolean expected, got string 'yes'" },
      { { ev_inport = 3 }, "ev_inport: name for a port, or boolean, expected, got "
        .. "number 3" },
      { { ev_inport = "rFSM_cur_fqn" }, "ev_inport: name for a port, or boolean, "
        .. "expected, got string 'rFSM_cur_fqn'" },
      { { prefile = 1 }, "prefile: file name expected, got number 1" },
      { { fsmfile = "/nowhere/x.lua" },
        "fsmfile '/nowhere/x.lua': No such file or directory" },
      { { prefile = "/nowhere/x.lua" },
        "prefile '/nowhere/x.lua': No such file or directory" },
      { { postfile = "/nowhere/x.lua" },
        "postfile '/nowhere/x.lua': No such file or directory" },
      { { env = 3 }, "env: table expected, got number 3" },
      { { deployer = 3 }, "deployer: a component with the operation loadComponent "
        .. "expected, got number 3" },
      { { deployer = {} }, "deployer: a component with the operation loadComponent "
        .. "expected, got table" },
      { { deployer = "Deplyer" }, "deployer: 'lua' has no peer 'Deplyer' (did you mean "
        .. "'Deployer'?)" },
    }
    for _, case in ipairs(FIELDS) do
      it("fields that are wrong: " .. case[2], function()
        assert.equal(case[2], refused_with(case[1]))
        assert.same({}, standin.log)
      end)
    end

    for _, case in ipairs(WRONG_ENVS) do
      it("an env with " .. case[1], function()
        assert.equal(case[1], refused_with { env = case[2]() })
      end)
    end

    for _, case in ipairs(WRONG_CHARTS) do
      it("a chart that " .. case[1], function()
        local name = file_with(case[2])
        local text = case[3]:gsub("%%s", (name:gsub("%%", "%%%%")))
        assert.equal("'arm': " .. text, refused_with { fsmfile = name })
        assert.equal(1, #logged("Error"))
      end)
    end

    it("a prefile or postfile that raises", function()
      assert.equal("'arm': no gripper",
        refused_with { prefile = file_with "error('no gripper', 0)" })
      assert.equal("'arm': no gripper",
        refused_with { postfile = file_with "error('no gripper', 0)" })
    end)

    it("a port name that prefile has used", function()
      assert.equal("'arm': 'arm' has a port 'rFSM_events' already",
        refused_with { prefile = file_with
          "rtt.getTC():addPort(rtt.InputPort('string'), 'rFSM_events')" })
    end)

    it("a name that a component has, and leaves that one alone", function()
      local arm = launched()
      assert.equal("'arm': the deployer has a component of this name already",
        refused { name = "arm", deployer = deployer, fsmfile = chart_file() })
      assert.same({ "arm" }, deployer:getPeers())
      assert.is_true(arm:start())
    end)

    it("a type that the deployer does not know", function()
      assert.equal("'arm': the deployer does not load a component of type 'OCL::Lua' "
        .. "(is 'ocl' imported?), RTT's log says why",
        refused_with { luatype = "OCL::Lua" })
    end)

    it("a type without Lua", function()
      assert.equal("'arm': it has no operation exec_str, a luatype with Lua in it "
        .. "expected", refused_with { luatype = "OCL::HelloWorld" })
    end)

    it("a deployer that loads what is no peer then", function()
      deployer.operations.loadComponent.f = function() return true end
      assert.equal("'arm': the deployer loads it, but is no peer of it (and the "
        .. "deployer does not unload the component)", refused_with {})
    end)

    it("a component that does not configure, for reasons of its own", function()
      local real = deployer.operations.loadComponent.f
      deployer.operations.loadComponent.f = function(...)
        real(...)
        rawset(deployer:getPeer("arm"), "configure", function() return false end)
        return true
      end
      assert.equal("'arm': the other Lua reports a failure, RTT's log says which",
        refused_with {})
    end)
  end)
end)

-- Without RTT --------------------------------------------------------------------

describe("without RTT", function()
  before_each(function() package.loaded.rtt = nil end)
  after_each(function() package.loaded.rtt = rtt end)

  it("the search for a deployer says what is missing", function()
    assert.equal("rfsm.rtt.component_launch_rfsm: deployer: to look for a peer "
      .. "'Deployer' takes RTT, but module 'rtt' is not there",
      refusal(rfsm_rtt.component_launch_rfsm, { name = "arm", fsmfile = chart_file() }))
  end)

  it("a launch into this very Lua says what is missing", function()
    local load_text = rawget(_G, "loadstring") or rawget(_G, "load")
    assert.equal("rfsm.rtt.service_launch_rfsm: module 'rtt' is not there, this is no "
      .. "Lua of RTT", refusal(rfsm_rtt.service_launch_rfsm, chart_file(),
      function(code) assert(load_text(code))() end))
    assert.is_nil(rawget(_G, "fsm"))
  end)
end)

describe("examples/hosts/rtt_host.lua", function()
  -- Runs it with these modules named rtt; returns what it printed.
  local function output_with(module)
    local path = package.path
    package.loaded.rtt = module
    local lines = helper.printed(function() dofile("examples/hosts/rtt_host.lua") end)
    package.loaded.rtt, package.path = rtt, path
    return lines
  end

  local EXPECTED = {
    "fingers open", "gripper: <none>", "gripper: root.open",
    "fingers closing", "gripper: root.closing",
    "motor holds", "gripper: root.holding",
    "motor off", "fingers open", "gripper: root.open",
  }

  it("launches a component and drives it through ports", function()
    assert.same(EXPECTED, output_with(rtt))
  end)

  it("leaves no component and no port", function()
    output_with(rtt)
    assert.same({}, rtt.getTC():getPortNames())
    assert.same({}, rtt.getTC():getPeer("Deployer"):getPeers())
  end)

  it("says so when it runs on the stand-in", function()
    local lines = output_with(nil)
    assert.equal("RTT is not here, its stand-in is used: spec/support/rtt.lua",
      table.remove(lines, 1))
    assert.same(EXPECTED, lines)
  end)
end)
