-- The stand-in for RTT: what it has in common with the real one and a careless user
-- of RTT would not expect.

local rtt = require "spec.support.rtt"
local rtt_helper = require "spec.support.rtt_helper" -- before rfsm.rtt


local connected, policy, pose = rtt_helper.connected, rtt_helper.policy, rtt_helper.pose
local samples, write_all, logged =
  rtt_helper.samples, rtt_helper.write_all, rtt_helper.logged
local evaluate = rtt_helper.evaluate
local standin = rtt.standin

before_each(rtt_helper.reset)
after_each(rtt_helper.reset)

describe("the stand-in for RTT", function()
  it("returns a value with NoData and OldData, and only a status for a Variable",
    function()
      local into, out = connected("string")
      assert.same({ "NoData", "" }, { into:read() })
      local var = rtt.Variable("string", "before")
      assert.same({ "NoData" }, { into:read(var) })
      assert.equal("before", var:tolua())
      out:write("e_a")
      assert.same({ "NewData" }, { into:read(var) })
      assert.equal("e_a", var:tolua())
      assert.same({ "OldData", "e_a" }, { into:read() })
    end)

  it("reads nothing into a Variable of another type, and logs that", function()
    local into, out = connected("string")
    out:write("e_a")
    assert.equal("NoData", into:read(rtt.Variable("int")))
    assert.equal(1, #logged("incompatible"))
  end)

  it("writes the first argument only", function()
    local into, out = connected("string")
    out:write("e_a", "e_b")
    assert.same({ "e_a" }, samples(into))
  end)

  it("copies what is written", function()
    local into, out = connected("Pose")
    local var = pose(1, 2)
    out:write(var)
    var.x = 3
    assert.equal(1, samples(into)[1].x)
  end)

  it("keeps the last sample without a buffer, the first ones in a full one", function()
    local out, data = rtt.OutputPort("string"), rtt.InputPort("string")
    local buffer, ring = rtt.InputPort("string"), rtt.InputPort("string")
    out:connect(data)
    out:connect(buffer, policy(2))
    out:connect(ring, policy(2, 2))
    write_all(out, "e_a", "e_b", "e_c")
    assert.same({ "e_c" }, samples(data))
    assert.same({ "e_a", "e_b" }, samples(buffer))
    assert.same({ "e_b", "e_c" }, samples(ring))
  end)

  it("replaces and disconnects a port whose name is used again", function()
    local component = rtt.getTC()
    local into, out = connected("string")
    component:addPort(into, "events")
    component:addPort(rtt.InputPort("string"), "events")
    assert.is_false(out:connected())
    assert.same({ "events" }, component:getPortNames())
    assert.equal(1, #logged("name already in use"))
  end)

  it("returns false when code fails, and logs why", function()
    local tc = rtt.getTC():getPeer("Deployer")
    tc:import("ocl")
    tc:loadComponent("arm", "OCL::LuaComponent")
    local exec_str = tc:getPeer("arm"):getOperation("exec_str")
    assert.is_true(exec_str("x = 1"))
    assert.is_false(exec_str("error('boom', 0)"))
    assert.is_false(exec_str("x ="))
    assert.same({ "Error: LuaComponent 'arm': boom" }, logged("boom"))
  end)

  describe("in a component", function()
    local deployer, arm, exec_str

    before_each(function()
      deployer = rtt.getTC():getPeer("Deployer")
      deployer:import("ocl")
      deployer:loadComponent("arm", "OCL::LuaComponent")
      arm = deployer:getPeer("arm")
      exec_str = arm:getOperation("exec_str")
    end)

    it("removes a hook that does not return true", function()
      exec_str("n = 0 function count() n = n + 1 end hook = rtt.EEHook('count') "
        .. "hook:enable()")
      for _ = 1, 3 do
        arm:trigger()
        standin.spin()
      end
      assert.equal("1", evaluate(exec_str, "n"))
    end)

    it("collects a hook that nobody holds", function()
      exec_str("n = 0 function count() n = n + 1 return true end "
        .. "rtt.EEHook('count'):enable()")
      collectgarbage()
      collectgarbage()
      arm:trigger()
      standin.spin()
      assert.equal("0", evaluate(exec_str, "n"))
    end)

    it("wants a boolean of configureHook", function()
      exec_str("function configureHook() end")
      assert.is_false(arm:configure())
      assert.same({ "Error: LuaComponent 'arm': configureHook must return a bool but "
        .. "returned a nil" }, logged("configureHook"))
    end)

    it("keeps its Lua to itself", function()
      exec_str("rfsm = 3 string.rep = 3 package.loaded.io = 3")
      assert.is_function(string.rep)
      assert.equal(io, package.loaded.io)
      assert.equal("arm", evaluate(exec_str, "rtt.getTC():getName()"))
    end)

    it("does not change the activity of one that runs", function()
      arm:configure()
      arm:start()
      assert.is_false(deployer:setActivity("arm", 0.1, 0, 0))
      assert.is_false(deployer:unloadComponent("arm"))
    end)

    it("has properties", function()
      arm:addProperty(rtt.Property("double", "speed", "in m/s"))
      arm:getProperty("speed"):set(2)
      assert.same({ "speed" }, arm:getPropertyNames())
      assert.equal(2, arm:getProperty("speed"):get())
    end)
  end)

  it("raises for what is not there", function()
    local tc = rtt.getTC()
    for _, f in ipairs {
      function() tc:getPeer("nobody") end, function() tc:getPort("none") end,
      function() tc:getOperation("none") end, function() tc:noSuchOperation() end,
      function() tc:provides("Lua"):getOperation("exec_str") end,
      function() rtt.Variable("nonsense") end, function() rtt.InputPort("nonsense") end,
    } do
      assert.is_false((pcall(f)))
    end
  end)
end)
