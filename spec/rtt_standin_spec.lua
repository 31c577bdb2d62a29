-- Facts of RTT-Lua that a careless user would not expect, on the stand-in for RTT; in a
-- rttlua this file shows that the stand-in is like the real one.

local helper = require "spec.helper"
local rtt_helper = require "spec.support.rtt_helper"

local rtt = rtt_helper.rtt
local connected, policy = rtt_helper.connected, rtt_helper.policy
local samples, write_all, logged =
  rtt_helper.samples, rtt_helper.write_all, rtt_helper.logged
local evaluate, spin, deploy = rtt_helper.evaluate, rtt_helper.spin, rtt_helper.deploy

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local Variable = rtt.Variable.new

before_each(rtt_helper.reset)
after_each(rtt_helper.reset)

-- Returns what a Variable of this type makes of a value, with `from` of a Variable of
-- that type; "raises" when it does.
local function converted(kind, value, from)
  local ok, result = pcall(function()
    local var = Variable(kind)
    var:assign(not from and value or Variable(from, value))
    return var:tolua()
  end)
  return ok and result or not ok and "raises"
end

local CONVERSIONS = { -- type, value, result, type of a Variable
  { "string", 3, "raises" }, { "string", true, "raises" }, { "string", "a\0b", "a" },
  { "int", "3", "raises" }, { "int", true, "raises" }, { "double", "0.1", "raises" },
  { "int", 2.9, 2 }, { "int", -2.9, -2 }, { "int", 2 ^ 31, -2 ^ 31 },
  { "uint", -1, 2 ^ 32 - 1 }, { "uint", 2 ^ 32 + 5, 5 }, { "uint", 1.7, 1 },
  { "bool", 3, true }, { "bool", 0, false }, { "bool", "true", "raises" },
  { "char", "abc", "a" }, { "char", "", "\0" }, { "char", 65, "raises" },
  { "llong", 3, "raises" }, { "ullong", 3, "raises" }, { "double", 2, 2, "int" },
  { "int", 2.9, 2, "double", "Warning: Conversion from double to int" },
  { "string", 3, "raises", "double" }, { "int", "3", "raises", "string" },
}

describe("a Variable of RTT", function()
  for _, case in ipairs(CONVERSIONS) do
    local kind, value, result, from, warning = unpack(case, 1, 5)
    it(("of type %s makes %s of %s %s"):format(kind, tostring(result),
      from or type(value), tostring(value):gsub("%z", "\\0")), function()
      assert.equal(result, converted(kind, value, from))
      assert.same({ warning }, logged("Conversion"))
    end)
  end

  it("takes wide integers from a double, and returns them to one", function()
    local wide, double = Variable("llong"), Variable("double")
    wide:assign(Variable("double", 2 ^ 40 + 1))
    assert.is_false((pcall(wide.tolua, wide)))
    double:assign(wide)
    assert.equal(2 ^ 40 + 1, double:tolua())
    assert.same({}, logged("Conversion"))
  end)
end)

describe("a port of RTT", function()
  it("returns a value with NoData and OldData, and only a status for a Variable",
    function()
      local into, out = connected("string")
      local var = Variable("string")
      assert.same({ "NoData", "" }, { into:read() })
      var:assign("before")
      assert.same({ "NoData", nil, "before" }, { into:read(var), nil, var:tolua() })
      out:write("e_a")
      assert.same({ "NewData", nil, "e_a" }, { into:read(var), nil, var:tolua() })
      assert.same({ "OldData", "e_a" }, { into:read() })
    end)

  it("reads and writes no Variable of another type, logs that, and writes one argument",
    function()
      local into, out = connected("string")
      out:write("e_a", "e_b")
      assert.equal("NoData", into:read(Variable("int")))
      out:write(Variable("int"))
      assert.same({ "e_a" }, samples(into))
      assert.equal(2, #logged("incompatible"))
    end)

  it("copies what is written", function()
    local into, out = connected("ConnPolicy")
    local var = policy(2)
    out:write(var)
    var.size = 3
    assert.equal(2, samples(into)[1].size)
  end)

  it("keeps the last sample without a buffer, the first ones in a full one", function()
    for _, case in ipairs { { policy(1, 0), { "e_c" } },
      { policy(2), { "e_a", "e_b" } } } do
      local into, out = connected("string", case[1])
      write_all(out, "e_a", "e_b", "e_c")
      assert.same(case[2], samples(into))
    end
  end)

  it("ignores a policy in connect, and obeys the default when it was made", function()
    local function received(wanted)
      local into, out = rtt_helper.input(), rtt_helper.output()
      rtt.globals_get("DefaultConnPolicy").type = 0
      assert.is_true(out:connect(into, wanted))
      write_all(out, "e_a", "e_b")
      return samples(into)
    end
    local default = rtt.globals_get("DefaultConnPolicy")
    assert.same({ "e_b" }, received(policy(8)))
    default.type, default.size = 1, 8
    assert.same({ "e_a", "e_b" }, received())
    default.size = 0
  end)

  it("says in info() whether it is connected, never to another type or to its like",
    function()
      local into, out = rtt_helper.input(), rtt_helper.output()
      assert.is_false(rtt_helper.output("int"):connect(into))
      assert.is_false(rtt_helper.input():connect(into))
      assert.is_false(into:info().connected)
      assert.is_true(out:connect(into))
      assert.is_true(into:info().connected)
      assert.equal("in string", into:info().porttype .. " " .. into:info().type)
      assert.is_nil(into.connected)
    end)

  it("raises in every method once it was deleted", function()
    local port, other = rtt.OutputPort.new("string", "gone"), rtt_helper.input()
    port:connect(other)
    port:delete()
    for _, name in ipairs { "write", "info", "connect", "disconnect", "delete" } do
      assert.is_false((pcall(function() port[name](port, other) end)))
    end
    assert.is_false(other:info().connected)
  end)

  it("keeps its name when it is added connected", function()
    local into, out = rtt.InputPort.new("string", "old"), rtt_helper.output()
    out:connect(into)
    rtt.getTC():addPort(into, "new", "described")
    assert.equal("old described", into:info().name .. " " .. into:info().desc)
  end)

  it("replaces and disconnects one whose name it has", function()
    local own = rtt.getTC()
    local first, out = rtt.InputPort.new("string", "events"), rtt_helper.output()
    own:addPort(first)
    out:connect(first)
    own:addPort(rtt.InputPort.new("string", "events"))
    assert.is_false(out:info().connected)
    assert.equal(2, #own:getPortNames())
    assert.equal(1, #logged("'addPort' events: name already in use. D"))
    first:delete()
  end)
end)

describe("a Lua of RTT", function()
  local arm, exec_str

  before_each(function() arm, exec_str = rtt_helper.load("arm") end)

  it("has callable constructors and operations as methods with rttlib only", function()
    assert.equal("false nil", evaluate(exec_str,
      "pcall(function() return rtt.Variable('int') end) and true, rtt.getTC().trigger"))
    exec_str("require 'rttlib'")
    assert.equal("true function table table table", evaluate(exec_str,
      "rtt.Variable('int') ~= nil, type(rtt.getTC().trigger), type(rttlib), "
      .. "type(utils), type(rtt.globals)"))
    assert.equal("nil", evaluate(exec_str, "rtt.getTC().nope"))
    exec_str("out = rtt.OutputPort('int', 'out') "
      .. "into = rttlib.port_clone_conn(out, '_2') out:write(3)")
    assert.equal("out_2 NewData 3", evaluate(exec_str, "into:info().name, into:read()"))
  end)

  it("is its own: globals, modules, rttlib", function()
    exec_str("require 'rttlib' rfsm = 3 string.rep = 3 package.loaded.io = 3")
    assert.is_function(string.rep)
    assert.equal(io, package.loaded.io)
    local _, exec_leg = rtt_helper.load("leg")
    assert.equal("nil nil leg",
      evaluate(exec_leg, "rttlib, rfsm, rtt.getTC():getName()"))
  end)

  it("returns false when code fails, and logs the reason; a zero ends code", function()
    assert.is_true(exec_str("x = 1 \0 nonsense"))
    assert.equal("1", evaluate(exec_str, "x"))
    assert.is_false(exec_str("error('boom', 0)"))
    assert.is_false(exec_str("x ="))
    assert.same({ "Error: LuaComponent 'arm': boom" }, logged("boom"))
    assert.is_false(pcall(exec_str, 3) or pcall(exec_str))
  end)

  it("logs texts without blanks between", function()
    rtt.logl("Error", "one", 2, "three")
    assert.same({ "Error: one2three" }, logged("one"))
    assert.is_false((pcall(rtt.logl, "Error", "half", true)))
    rtt.logl("Error", "whole")
    assert.same({ "Error: halfwhole" }, logged("whole"))
  end)

  it("executes its properties when it is configured, and only logs errors; wants a "
    .. "boolean of configureHook", function()
    arm:getProperty("lua_string"):set("n = (n or 0) + 1 error('in string', 0)")
    arm:getProperty("lua_file"):set(helper.file_with(
      "function configureHook() m = (m or 0) + 1 return true end"))
    assert.is_true(arm:configure())
    assert.is_true(arm:configure())
    assert.equal("2 2", evaluate(exec_str, "n, m"))
    assert.equal(2, #logged("in string"))
    arm:getProperty("lua_file"):set("")
    exec_str("function configureHook() end")
    assert.is_false(arm:configure())
    assert.equal("PreOperational", arm:getState())
    assert.same({ "Error: LuaComponent 'arm': configureHook must return a bool but "
      .. "returned a nil" }, logged("configureHook"))
  end)

  it("goes on when updateHook fails, and is not changed or unloaded while it runs",
    function()
    exec_str("n = 0 function updateHook() n = n + 1 error('tired', 0) end")
    assert.is_true(arm:configure())
    assert.is_true(arm:start())
    spin()
    arm:getOperation("trigger")()
    spin()
    assert.equal("Running", arm:getState())
    assert.equal("2", evaluate(exec_str, "n"))
    assert.equal(2, #logged("error calling function updateHook: tired"))
    assert.is_false(deploy("setActivity", "arm", 0.1, 0, 0))
    assert.is_false(deploy("unloadComponent", "arm"))
  end)

  it("calls errorHook in place of updateHook from error() to recover() or stop()",
    function()
      exec_str("words = '' function updateHook() words = words .. ' update' end "
        .. "function errorHook() words = words .. ' error' end")
      exec_str("rtt.getTC():error()")
      assert(arm:configure())
      local function trigger()
        arm:getOperation("trigger")()
        spin()
      end
      assert(arm:start())
      spin()
      exec_str("rtt.getTC():error()")
      spin()
      assert.equal("RunTimeError", arm:getState())
      trigger()
      assert.is_true(arm:recover())
      assert.is_false(arm:recover())
      trigger()
      assert.equal(" update error update", evaluate(exec_str, "words"))
      exec_str("rtt.getTC():error()")
      assert.is_true(arm:stop())
      assert.equal("Stopped", arm:getState())
    end)

  it("is configured without a configureHook, also if its file fails", function()
    arm:getProperty("lua_file"):set("/nowhere/x.lua")
    assert.is_true(arm:configure())
    assert.equal(1, #logged("cannot open /nowhere/x.lua"))
  end)

  it("with a pool enlarges that once", function()
    local _, exec_leg = rtt_helper.load("leg", "OCL::LuaTLSFComponent")
    local ADD = "local bytes = rtt.Variable.new('uint') bytes:assign(500 * 1024) "
      .. "before = select(3, tlsf.stats()) "
      .. "rtt.getTC():getOperation('tlsf_incmem')(bytes)"
    assert.is_true(exec_leg(ADD))
    assert.is_true(math.abs(500 - evaluate(exec_leg,
      "(select(3, tlsf.stats()) - before) / 1024")) < 16)
    assert.is_false(exec_leg(ADD))
    assert.equal(1, #logged("region already increased"))
  end)

  it("has attributes, whose values stay when they are removed", function()
    local attribute = rtt.Attribute.new("uint", "count")
    local value = attribute:getRaw()
    arm:addAttribute(attribute)
    value:assign(3)
    assert.equal(3, arm:getAttribute("count"):get())
    arm:getAttribute("count"):set(4)
    assert.equal(4, value:tolua())
    arm:removeAttribute("count")
    assert.is_false(pcall(arm.getAttribute, arm, "count"))
    assert.is_false(pcall(arm.removeAttribute, arm, "count"))
    value:assign(5)
    assert.equal(5, value:tolua())
  end)

  it("loses its ports and attributes by rttlib.tc_cleanup", function()
    exec_str("require 'rttlib' local own = rtt.getTC() "
      .. "own:addPort(rtt.OutputPort('int', 'out')) "
      .. "own:addAttribute(rtt.Attribute('int', 'n')) rttlib.tc_cleanup()")
    assert.same({}, arm:getPortNames())
    assert.is_false(pcall(arm.getAttribute, arm, "n"))
  end)

  it("has a period, 0 without one, and a timer triggers it when it is armed", function()
    local timer = rtt_helper.load("timer", "OCL::TimerComponent")
    assert.is_true(timer:configure() and timer:start())
    exec_str("n = 0 function updateHook() n = n + 1 end "
      .. "port = rtt.InputPort.new('int', 'timer') rtt.getTC():addEventPort(port)")
    assert.is_true(arm:getPort("timer"):connect(timer:getPort("timer_0")))
    assert.equal(0, arm:getOperation("getPeriod")())
    assert.is_true(arm:configure() and arm:start())
    spin()
    timer:getOperation("arm")(0, 0.1)
    rtt_helper.advance(0.05)
    assert.equal("1", evaluate(exec_str, "n"))
    rtt_helper.advance(0.15)
    assert.equal("2", evaluate(exec_str, "n"))
    arm:stop()
    timer:stop()
    deploy("setActivity", "arm", 0.1, 0, 0)
    assert.equal(0.1, arm:getOperation("getPeriod")())
  end)

  it("removes a hook that does not return true, in any state", function()
    exec_str("n = 0 function count() n = n + 1 return n < 3 end "
      .. "hook = rtt.EEHook.new('count') hook:enable()")
    for _ = 1, 5 do
      arm:getOperation("trigger")()
      spin()
    end
    assert.equal("3 PreOperational", evaluate(exec_str, "n, rtt.getTC():getState()"))
  end)

end)

describe("a process of RTT", function()
  it("has the component lua and the deployer, and a HelloWorld with two ports",
    function()
      local own, host = rtt.getTC(), rtt_helper.load("host", "OCL::HelloWorld")
      local names = host:getPortNames()
      table.sort(names)
      assert.equal("lua PreOperational PreOperational", own:getName() .. " "
        .. own:getState() .. " " .. host:getState())
      assert.same({ { "Deployer" }, { "host", "lua" }, { "the_buffer_port",
        "the_results" } }, { own:getPeers(), rtt_helper.deployer():getPeers(), names })
    end)

  it("raises for what is not there", function()
    local own = rtt.getTC()
    for _, f in ipairs {
      function() own:getPeer("nobody") end, function() own:getPort("none") end,
      function() own:getProperty("none") end, function() own:getOperation("none") end,
      function() own:provides("nope") end, function() rtt.InputPort.new("nonsense") end,
      function() return Variable("int").nope end, function() Variable("nonsense") end,
    } do
      assert.is_false((pcall(f)))
    end
    assert.is_false(own:hasOperation("none"))
    assert.is_nil(own.none)
    assert.equal("lua", own:provides():getName())
  end)
end)

-- These end the process of the real one, or its log.
describe("an error of a user #standin", function()
  if not rtt_helper.is_standin then return end

  it("that is no text mutes the log", function()
    local _, exec_str = rtt_helper.load("arm")
    assert.is_false(exec_str("error({})"))
    assert.is_false(exec_str("error('lost', 0)"))
    rtt.logl("Warning", "lost as well")
    assert.same({ "Error: LuaComponent 'arm': ", "Error: ", "Warning: " },
      rtt_helper.logged(""))
  end)

  it("that takes an EEHook's function, or the hook itself, ends the process", function()
    for _, deed in ipairs { "count = nil",
      "hook = nil collectgarbage() collectgarbage()" } do
      local arm, exec_str = rtt_helper.load("arm")
      exec_str("function count() return true end hook = rtt.EEHook.new('count') "
        .. "hook:enable() " .. deed)
      arm:getOperation("trigger")()
      assert.has_error(spin)
      rtt.standin.reset()
    end
  end)

  it("that uses a port which another pointer has deleted ends the process", function()
    local _, exec_str = rtt_helper.load("arm")
    assert.is_false(exec_str("require 'rttlib' out = rtt.OutputPort('int', 'out') "
      .. "rtt.getTC():addPort(out) rttlib.tc_cleanup() pcall(out.write, out, 3)"))
    assert.has_error(rtt.standin.check)
    rtt.standin.reset()
  end)

  it("that calls something in a Lua with an enabled hook ends the process", function()
    for code, is_alive in pairs { [""] = true, ["type(3)"] = false } do -- any order
      local _, exec_str = rtt_helper.load("arm")
      exec_str("function count() return true end hook = rtt.EEHook.new('count') "
        .. "hook:enable() " .. code)
      assert.equal(is_alive, (pcall(rtt.standin.check)))
      rtt.standin.reset()
    end
  end)

  it("that deletes a port before it is removed ends the process", function()
    rtt_helper.output():delete()
    assert.has_error(function() rtt.getTC():getPortNames() end)
    rtt.standin.reset()
  end)
end)
