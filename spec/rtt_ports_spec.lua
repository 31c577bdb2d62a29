-- `ports` of a launch: input ports whose samples become events. On the stand-in in
-- spec/support/rtt.lua, or in a rttlua.

local helper = require "spec.helper"
local measure = require "bench.measure"
local rtt_helper = require "spec.support.rtt_helper" -- before rfsm.rtt
local rfsm_rtt = require "rfsm.rtt"

local rtt = rtt_helper.rtt
local file_with, refusal = helper.file_with, helper.refusal
local evaluate, spin, advance = rtt_helper.evaluate, rtt_helper.spin, rtt_helper.advance
local deploy, load, logged = rtt_helper.deploy, rtt_helper.load, rtt_helper.logged
local write_all = rtt_helper.write_all

before_each(rtt_helper.reset)
after_each(rtt_helper.reset)

-- A chart that notes in the global `seen` the names of the events that it reads. It is
-- in `a` until e_stop.
local function noting_chart(fields)
  return file_with([[
local rfsm = require "rfsm"
seen, steps = {}, 0
local chart = rfsm.state { info = false, ]] .. (fields or "") .. [[
  a = rfsm.state {}, stopped = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "stopped", events = { "e_stop" } },
}
function chart.pre_step_hook(_, events)
  steps = steps + 1
  for _, event in ipairs(events) do
    local name = rfsm.event_text(event)
    if not name:find("^e_done") and name ~= "e_init_fsm" then seen[#seen + 1] = name end
  end
end
return chart]])
end

-- Fields of a launch as the text of a table's inside.
local function own_fields(ports, more)
  return ("fsmfile = %q, enter = 'start', ports = %s, %s"):format(noting_chart(), ports,
    more or "")
end

-- A component whose program launches a chart with these fields, after this code.
local function own(fields, code)
  local arm, exec_str = load("arm")
  arm:getProperty("lua_file"):set(file_with(([[
local rfsm_rtt = require "rfsm.rtt"
%s
function configureHook() return rfsm_rtt.launch { %s } end]]):format(code or "",
    fields)))
  return arm, exec_str
end

-- A configured and started component of that kind.
local function started(fields, code)
  local arm, exec_str = own(fields, code)
  assert(arm:configure())
  return arm, exec_str, function()
    assert(arm:start())
    spin()
  end
end

-- A launched component of these ports, and a function that returns what it has seen.
local function launched(ports, more)
  local fields = { name = "arm", fsmfile = noting_chart(), deployer =
    rtt_helper.deployer(), enter = "start", ports = ports }
  for name, value in pairs(more or {}) do fields[name] = value end -- any order: a set
  local arm = rfsm_rtt.component_launch_rfsm(fields)
  local exec_str = arm:getOperation("exec_str")
  assert(arm:configure())
  return arm, function()
    spin()
    return evaluate(exec_str, "table.concat(seen, ' ')")
  end, exec_str
end

-- Makes an output port of a type (string) that writes to "component.port".
local function feed(path, kind)
  local out, name = rtt_helper.output(kind)
  assert(deploy("connect", name, path, rtt_helper.policy(64)))
  return out
end

local function struct(size)
  local var = rtt.Variable.new("ConnPolicy")
  var.size = size
  return var
end

describe("ports of a launch", function()
  it("are there, events or not, before events_in, which is the last", function()
    for _, is_own in ipairs { true, false } do
      local arm, exec_str, seen
      if is_own then
        local start
        arm, exec_str, start = started(own_fields "{ { 'stop_in' }, { 'arm_in' } }")
        feed("arm.events_in"):write("e_last")
        feed("arm.arm_in"):write("e_mid")
        feed("arm.stop_in"):write("e_first")
        start()
        seen = evaluate(exec_str, "table.concat(seen, ' ')")
      else
        local come
        arm, come = launched { { "stop_in" }, { "arm_in" } }
        feed("arm.events_in"):write("e_last")
        feed("arm.arm_in"):write("e_mid")
        feed("arm.stop_in"):write("e_first")
        assert(arm:start())
        seen = come()
      end
      assert.equal("e_first e_mid e_last", seen)
      assert.same({ "fqn", "stop_in", "arm_in", "events_in" }, arm:getPortNames())
      rtt_helper.reset()
    end
  end)

  it("make a stop overtake what others send, each port read up to its bound", function()
    local arm, seen = launched({ { "stop_in" }, { "sensor_in" } }, { samples = 3 })
    local sensor = feed("arm.sensor_in")
    for i = 1, 20 do sensor:write("e_n" .. i) end
    feed("arm.stop_in"):write("e_stop")
    assert(arm:start())
    assert.matches("^e_stop e_n1 e_n2 e_n3 e_n4 .* e_n20$", seen())
  end)

  it("do not let a burst of one port hide a stop on another, a step later", function()
    local arm, seen, exec_str = launched({ { "stop_in" }, { "sensor_in" } },
      { samples = 4, steps = 1 })
    local sensor, stop = feed("arm.sensor_in"), feed("arm.stop_in")
    assert(arm:start())
    spin()
    for i = 1, 64 do sensor:write("e_n" .. i) end
    stop:write("e_stop")
    seen()
    assert.equal("root.stopped", evaluate(exec_str, "fsm._act_leaf._fqn"))
    if rtt_helper.is_standin then -- a thread may read while this one writes
      assert.equal("e_stop", evaluate(exec_str, "seen[1]"))
    end
  end)

  it("may have events_in among them, with its place and prefix", function()
    local arm, seen = launched { { "events_in", prefix = "gui" }, { "arm_in" } }
    assert.same({ "fqn", "events_in", "arm_in" }, arm:getPortNames())
    feed("arm.arm_in"):write("e_b")
    feed("arm.events_in"):write("e_a")
    assert(arm:start())
    assert.equal("gui.e_a e_b", seen())
  end)

  it("have the launch load few of its files at once, since a pool has no more room",
    function()
      local arm, exec_str = own(own_fields "{ { 'stop_in', prefix = 'boss' } }", [[
        loads = {}
        setmetatable(package.preload, { __index = function(_, name)
          if name:find("^rfsm%.rtt%.") then loads[#loads + 1] = name:sub(10) end
        end })]])
      assert(arm:configure())
      assert.equal("component port update settings inputs wiring events "
        .. "hooks wiring inputs update events update hooks",
        evaluate(exec_str, "table.concat(loads, ' ')"))
    end)

  it("stay beside the getevents of a chart, and beside extra_in_ports", function()
    local arm, seen = launched({ { "stop_in" } }, { prestr = [[
local port = rtt.InputPort.new("string", "extra")
rtt.getTC():addEventPort(port)
extra_in_ports = { port }]], fsmfile = noting_chart [[
getevents = function() local list = mail mail = nil return list end,]] })
    arm:getOperation("exec_str")("mail = { 'e_mail' }")
    feed("arm.extra"):write("e_extra")
    feed("arm.stop_in"):write("e_first")
    assert(arm:start())
    assert.equal("e_first e_mail e_extra", seen())
    assert.same({ "extra", "fqn", "stop_in" }, arm:getPortNames())
  end)

  it("wake a component without a period, and belong to a service as well", function()
    local arm, seen = launched { { "stop_in" } }
    assert(arm:start())
    spin()
    feed("arm.stop_in"):write("e_stop")
    assert.equal("e_stop", seen())

    local motor = load("motor", "OCL::HelloWorld")
    deploy("loadService", "motor", "Lua")
    local exec_str = motor:provides("Lua"):getOperation("exec_str")
    rfsm_rtt.service_launch_rfsm(noting_chart(), exec_str, false, nil,
      { ports = { { "stop_in", prefix = "boss" } } })
    feed("motor.stop_in"):write("e_now")
    feed("motor.events_in"):write("e_late")
    exec_str("trigger() trigger()")
    assert.equal("boss.e_now e_late", evaluate(exec_str, "table.concat(seen, ' ')"))
  end)

  it("are made again after a clean-up, and stay connected without one", function()
    local arm, _, start = started(own_fields("{ { 'arm_in', prefix = 'arm' } }"),
      "function cleanupHook() rttlib.tc_cleanup() end")
    local out = feed("arm.arm_in")
    for i = 1, 3 do
      start()
      write_all(out, "e_x", "e_y")
      spin()
      assert.equal("arm.e_x arm.e_y", evaluate(arm:getOperation("exec_str"),
        "table.concat(seen, ' ')"))
      arm:stop()
      if i == 2 then
        arm:cleanup()
        assert.same({}, arm:getPortNames())
      end
      assert(arm:configure())
      if i == 2 then out = feed("arm.arm_in") end
    end
  end)

  it("are made again for a launched component that is cleaned up", function()
    local arm, seen = launched({ { "arm_in", prefix = "arm" } }, { poststr =
      "function cleanupHook() rttlib.tc_cleanup() end" })
    assert(arm:start())
    spin()
    arm:stop()
    arm:cleanup()
    assert.same({}, arm:getPortNames())
    assert(arm:configure())
    feed("arm.arm_in"):write("e_x")
    assert(arm:start())
    assert.equal("arm.e_x", seen())
  end)
end)

describe("prefix", function()
  it("says who sent an event, also one that carries data", function()
    local arm, seen, exec_str = launched {
      { "arm_in", prefix = "arm" },
      { "base_in", prefix = "base", event = function(name)
        return { name = name, x = 3 }
      end },
    }
    exec_str [[rfsm.pre_step_hook_add(fsm, function(_, events)
      for _, e in ipairs(events) do x = type(e) == "table" and e.x or x end end)]]
    feed("arm.arm_in"):write("e_reached")
    feed("arm.base_in"):write("e_reached")
    assert(arm:start())
    assert.equal("arm.e_reached base.e_reached", seen())
    assert.equal("3", evaluate(exec_str, "x"))
  end)

  it("leaves a table that is answered again as it is", function()
    local arm, exec_str, start = started(own_fields(
      "{ { 'f', type = 'double', prefix = 'arm', event = f } }"),
      "local e = { name = 'e_hot' } function f() return e end")
    write_all(feed("arm.f", "double"), 1, 2)
    start()
    assert.equal("arm.e_hot arm.e_hot", evaluate(exec_str, "table.concat(seen, ' ')"))
    arm:stop()
  end)

  it("keeps the class of an object that carries data", function()
    local arm, exec_str, start = started(own_fields(
      "{ { 'f', type = 'double', prefix = 'arm', event = f } }",
      "poststr = [[rfsm.pre_step_hook_add(fsm, function(_, events) "
        .. "for _, e in ipairs(events) do hot = e end end)]]"),
      "local class = { __index = { unit = 'K' }, __metatable = false } "
        .. "function f() return setmetatable({ name = 'e_hot' }, class) end")
    feed("arm.f", "double"):write(1)
    start()
    assert.equal("arm.e_hot K", evaluate(exec_str, "hot.name .. ' ' .. hot.unit"))
    arm:stop()
  end)
end)

describe("event", function()
  it("makes an event, one with data, or none, of any sample", function()
    local arm, seen = launched {
      { "force_in", type = "ConnPolicy", event = function(f)
        return f.size > 5 and "e_contact"
      end },
      { "level_in", type = "double", event = function(x)
        if x > 1 then return { name = "e_level", x = x } end
      end },
      { "on_in", type = "bool",
        event = function(on) return on and "e_on" or "e_off" end },
    }
    write_all(feed("arm.force_in", "ConnPolicy"), struct(3), struct(7), struct(9))
    write_all(feed("arm.level_in", "double"), 0.5, 2)
    write_all(feed("arm.on_in", "bool"), true, false)
    assert(arm:start())
    assert.equal("e_contact e_contact e_level e_on e_off", seen())
  end)

  it("counts samples, not events, against the bound", function()
    local arm, seen = launched({ { "stop_in" },
      { "x_in", type = "int", event = function(x) return x > 20 and "e_big" end } },
      { samples = 5 })
    local out = feed("arm.x_in", "int")
    for i = 1, 21 do out:write(i) end
    assert(arm:start())
    assert.equal("e_big", seen())
  end)

  it("that fails costs its sample, and is told once a second with a count", function()
    local arm, seen = launched({ { "x_in", type = "int", event = function(x)
      if x % 2 == 1 then error("odd " .. x, 0) end
      return "e_" .. x
    end } })
    assert(arm:start())
    spin()
    local out = feed("arm.x_in", "int")
    local LINE = "Error: rfsm.rtt: port 'x_in': a sample is dropped: odd "
    write_all(out, 1, 2, 3, 4, 5, 6)
    assert.equal("e_2 e_4 e_6", seen())
    assert.same({ LINE .. "1" }, logged("port 'x_in'"))
    assert.equal(3, arm:getAttribute("rfsm_errors"):get())
    assert.equal(0, arm:getAttribute("rfsm_failures"):get())
    advance(1)
    out:write(8)
    seen()
    assert.same({ LINE .. "1", LINE .. "5 (2 times)" }, logged("port 'x_in'"))
  end)

  it("that answers anything else is told likewise", function()
    for _, case in ipairs { -- code of the function, what is got
      { "true", "boolean" }, { "7", "number 7" }, { "''", "string ''" },
      { "{ 'e_x' }", "table" }, { "{ name = 3 }", "table" }, { "f", "an object" },
      { "rtt.getTC()", "an object" }, { "rtt.getTC():getPort('f')", "an object" },
      { "rtt.getTC():getAttribute('rfsm_state')", "an object" },
    } do
      local _, exec_str, start = started(own_fields(("{ { 'f', type = 'ConnPolicy', "
        .. "event = function(f) return %s end } }"):format(case[1])))
      feed("arm.f", "ConnPolicy"):write(struct(3))
      start()
      assert.equal("", evaluate(exec_str, "table.concat(seen, ' ')"))
      local lines = logged("port 'f': a sample is dropped: event: text, table with a "
        .. "name or nothing expected, got ")
      assert.equal(1, #lines)
      if case[2] ~= "an object" then -- of RTT: a table in the stand-in
        assert.matches("got " .. case[2] .. "$", lines[1])
      end
      rtt_helper.reset()
    end
  end)

  it("calls error() of the component if the launch says so", function()
    local arm, seen = launched({ { "x_in", type = "int",
      event = function() error("no") end } }, { error = true })
    assert(arm:start())
    spin()
    feed("arm.x_in", "int"):write(1)
    seen()
    assert.equal("RunTimeError", arm:getState())
  end)
end)

describe("edge", function()
  local FORCE = [[{ { 'f', type = 'double', edge = true, event = function(x)
    if x == 0 then error('no force', 0) end
    return x > 5 and { name = 'e_contact', x = x } or x < -5 and 'e_pull' end } }]]

  it("makes an event when the answer changes: its name, or nothing", function()
    local _, exec_str, start = started(own_fields(FORCE))
    write_all(feed("arm.f", "double"), 1, 6, 7, 0, 8, 1, 2, 9, -6, -7, 6)
    start()
    assert.equal("e_contact e_contact e_pull e_contact",
      evaluate(exec_str, "table.concat(seen, ' ')"))
  end)

  it("needs no function at a port of a type that Lua has", function()
    local arm, seen = launched { { "mode_in", edge = true, prefix = "ui" } }
    write_all(feed("arm.mode_in"), "e_a", "e_a", "e_b", "e_b", "e_a")
    assert(arm:start())
    assert.equal("ui.e_a ui.e_b ui.e_a", seen())
  end)

  it("begins anew with the machine", function()
    local _, exec_str, start = started(own_fields(FORCE))
    local out = feed("arm.f", "double")
    write_all(out, 6, 7)
    start()
    exec_str("rfsm.reset(fsm) trigger()")
    write_all(out, 8, 9)
    spin()
    assert.equal("e_contact e_contact",
      evaluate(exec_str, "table.concat(seen, ' ')"))
  end)
end)

it("makes events of samples without garbage #alloc", function()
  local jit, least = rawget(_G, "jit"), math.huge
  if jit then jit.off() end
  local input = { "x_in", prefix = "arm", edge = true,
    event = function(x) return x > 5 and "e_contact" end }
  local convert = require("rfsm.rtt.inputs").converter({}, helper.init(helper.chart()),
    input)
  local kept = { "arm.e_contact" } -- as a transition keeps it
  for _ = 1, 3 do
    least = math.min(least, measure.bytes_grown(function(n)
      for i = 1, n do convert(i % 2 * 9) end
    end, 1000))
  end
  if jit then jit.on() end
  assert.equal(kept[1], convert(9))
  assert.is_true(least < 1000, least .. " bytes in 1,000 samples")
end)

describe("rfsm_rtt.ports", function()
  local PORTS = "rfsm_rtt.ports { { 'stop_in' }, { 'arm_in', prefix = 'arm' } }"
  local FIELDS = "fsmfile = %q, enter = 'start'"

  it("makes ports at file level, which can be connected before configure", function()
    local arm, exec_str = load("arm")
    local file = file_with(("local rfsm_rtt = require 'rfsm.rtt'\n%s\n"
      .. "function configureHook() return rfsm_rtt.launch { %s } end"):format(PORTS,
      FIELDS:format(noting_chart())))
    assert(arm:getOperation("exec_file")(file))
    assert.same({ "stop_in", "arm_in" }, arm:getPortNames())
    local out, stop = feed("arm.arm_in"), feed("arm.stop_in")
    for _ = 1, 2 do
      assert(arm:configure())
      assert(arm:start())
      spin()
      stop:write("e_stop")
      out:write("e_x")
      spin()
      assert.equal("e_stop arm.e_x", evaluate(exec_str, "table.concat(seen, ' ')"))
      arm:stop()
    end
  end)

  it("may be said again, each time the file is read", function()
    local arm, exec_str, start = started(FIELDS:format(noting_chart()), PORTS)
    local out = feed("arm.arm_in")
    for _ = 1, 2 do
      start()
      out:write("e_x")
      spin()
      assert.equal("arm.e_x", evaluate(exec_str, "table.concat(seen, ' ')"))
      arm:stop()
      assert(arm:configure())
    end
  end)

  it("refuses a second list without a port of the first, which nobody would read",
    function()
      local arm, exec_str, start = started(FIELDS:format(noting_chart()), PORTS)
      local out = feed("arm.arm_in")
      exec_str("ok, why = pcall(rfsm_rtt.ports, { { 'stop_in' }, { 'leg_in' } })")
      assert.equal("rfsm.rtt.ports: one list of all ports expected, 'arm_in' of an "
        .. "earlier call is missing", evaluate(exec_str, "why"))
      start()
      out:write("e_x")
      spin()
      assert.equal("arm.e_x", evaluate(exec_str, "table.concat(seen, ' ')"))
      assert.is_false(pcall(arm.getPort, arm, "leg_in"))
    end)

  it("is done by program.lua if the fields are known before", function()
    local arm, exec_str = load("arm")
    exec_str(("rfsm_launch = { %s }"):format(own_fields("{ { 'stop_in' } }")))
    assert(arm:getOperation("exec_file")("rfsm/rtt/program.lua"))
    assert.same({ "stop_in" }, arm:getPortNames())
    local stop = feed("arm.stop_in")
    assert(arm:configure())
    assert(arm:start())
    spin()
    stop:write("e_stop")
    spin()
    assert.equal("e_stop", evaluate(exec_str, "table.concat(seen, ' ')"))
  end)

  it("leaves a program.lua whose ports are wrong to its configureHook", function()
    local arm, exec_str = load("arm")
    exec_str(("rfsm_launch = { %s }"):format(own_fields("{ { 'f', type = 'Far' } }")))
    assert(arm:getOperation("exec_file")("rfsm/rtt/program.lua"))
    assert.is_false(arm:configure())
    assert.equal(1, #logged("ports[1]: type: "))
    assert.same({}, arm:getPortNames())
  end)

  it("refuses ports in the launch beside it", function()
    local arm = own(own_fields "{ { 'other_in' } }", PORTS)
    assert.is_false(arm:configure())
    assert.equal(1, #logged("ports: expected once, rfsm_rtt.ports has made some"))
    assert.same({ "stop_in", "arm_in" }, arm:getPortNames())
  end)

  it("leaves no port behind if one is wrong, and blames its caller", function()
    local own_tc = rtt.getTC()
    assert.equal("rfsm.rtt.ports: ports[3]: type: a type of a loaded typekit expected, "
      .. "got 'Force'", refusal(rfsm_rtt.ports, { { "a" }, { "b" },
      { "c", type = "Force" } }))
    assert.same({}, own_tc:getPortNames())
    own_tc:addPort(rtt.InputPort.new("double", "b"))
    assert.equal("rfsm.rtt.ports: ports[2]: port 'b': input port of type string "
      .. "expected, got an input port of type double",
      refusal(rfsm_rtt.ports, { { "a" }, { "b" } }))
    assert.same({ "b" }, own_tc:getPortNames())
    assert.equal("rfsm.rtt.ports: list of ports expected, got nil",
      refusal(rfsm_rtt.ports))
  end)
end)

describe("a launch refuses ports", function()
  local function upvalue() return file_with end

  for title, case in pairs { -- any order: each is a spec of its own
    ["that are no list"] = { 3, "ports: list of ports expected, got 3" },
    ["by name"] = { { stop = { "stop_in" } },
      "ports: list of ports expected, got the key 'stop'" },
    ["with a gap"] = { { { "a" }, [3] = { "b" } },
      "ports: list of ports expected, got the key '3'" },
    ["that are texts"] = { { "stop_in" },
      "ports[1]: table such as { 'stop_in' } expected, got string 'stop_in'" },
    ["without a name"] = { { { "a" }, { prefix = "arm" } },
      "ports[2]: name of a port expected, got nil" },
    ["with an empty name"] = { { { "" } },
      "ports[1]: name of a port expected, got string ''" },
    ["with a field that is not known"] = { { { "a", prefx = "arm" } },
      "ports[1]: unknown option 'prefx' (did you mean 'prefix'?), expected: 1, edge, "
        .. "event, prefix, type" },
    ["with a prefix that is none"] = { { { "a", prefix = "arm." } },
      "ports[1]: prefix: name without blanks or a dot at an end expected, got string "
        .. "'arm.'" },
    ["with a wrong edge"] = { { { "a", edge = 1 } },
      "ports[1]: edge: boolean expected, got 1" },
    ["with a wrong event"] = { { { "a", event = "e_x" } },
      "ports[1]: event: function of a sample expected, got string 'e_x'" },
    ["of one name"] = { { { "a" }, { "b" }, { "a" } },
      "ports[3]: 'a' is the name of ports[1]" },
    ["of one prefix"] = { { { "a", prefix = "arm" }, { "b", prefix = "arm" } },
      "ports[2]: prefix: 'arm' is that of ports[1], so one name has two senders" },
    ["of numbers with a prefix"] = { { { "a", prefix = "arm", type = "double" } },
      "ports[1]: prefix: function in `event` expected at a port of type double" },
    ["of structs with an edge"] = { { { "a", edge = true, type = "ConnPolicy" } },
      "ports[1]: edge: function in `event` expected at a port of type ConnPolicy" },
    ["of a type without a typekit"] = { { { "a" }, { "f", type = "Force" } },
      "ports[2]: type: a type of a loaded typekit expected, got 'Force'", true },
    ["of a name that a port has"] = { { { "a" }, { "fqn" } },
      "ports[2]: 'arm' has a port 'fqn' already", true },
    ["with a function that uses locals"] = { { { "a", event = upvalue } },
      "ports[1]: event: function that uses no local of its surroundings expected, "
        .. "it uses 'file_with'" },
    ["with a function of C"] = { { { "a", event = print } },
      "ports[1]: event: function in Lua expected, got one in C" },
    ["with an object that can be called"] = { { { "a",
      event = setmetatable({}, { __call = print }) } },
      "ports[1]: event: function in Lua expected, got table" },
  } do
    it(title, function()
      local before = rtt_helper.loaded()
      local chart = noting_chart()
      local where = case[3] and "launch of '" .. chart .. "': " or ""
      assert.equal("rfsm.rtt.component_launch_rfsm: " .. where .. case[2],
        refusal(rfsm_rtt.component_launch_rfsm, { name = "arm", fsmfile = chart,
          deployer = rtt_helper.deployer(), ports = case[1] }))
      assert.same(before, rtt_helper.loaded())
    end)
  end

  it("that exist with another type, and leaves none half made", function()
    local arm = own(own_fields "{ { 'stop_in' }, { 'force_in', type = 'double' } }",
      "rtt.getTC():addPort(rtt.OutputPort.new('double', 'force_in'))")
    assert.is_false(arm:configure())
    assert.equal(1, #logged("ports[2]: port 'force_in': input port of type double "
      .. "expected, got an output port of type double"))
    assert.same({ "force_in" }, arm:getPortNames())
  end)
end)
