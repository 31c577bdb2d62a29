-- rttlib and utils in a pool, where a launch loads them at their first use. On the
-- stand-in in spec/support/rtt.lua, or in a rttlua.

local rtt_helper = require "spec.support.rtt_helper" -- before rfsm.rtt
local rfsm_rtt = require "rfsm.rtt"

local chart_file, evaluate = rtt_helper.chart_file, rtt_helper.evaluate
local load, logged = rtt_helper.load, rtt_helper.logged

before_each(rtt_helper.reset)
after_each(rtt_helper.reset)

-- Returns the exec_str of a component with a launched machine, and the component.
local function launched(fields, luatype)
  local args = { name = "arm", fsmfile = chart_file(), deployer = rtt_helper.deployer(),
    luatype = luatype or "OCL::LuaTLSFComponent", pool = 2000 }
  for name, value in pairs(fields or {}) do args[name] = value end -- any order: a set
  local arm = rfsm_rtt.component_launch_rfsm(args)
  return arm:getOperation("exec_str"), arm
end

local IS_LOADED = "package.loaded.rttlib ~= nil"

describe("rttlib in a pool", function()
  it("is not loaded by a launch, nor by what needs none of it", function()
    local exec_str, arm = launched()
    assert(arm:configure())
    assert(arm:start())
    rtt_helper.spin()
    assert.equal("false nil arm", evaluate(exec_str, IS_LOADED
      .. ", rtt.nothing, rtt.getTC():getName()"))
    assert.equal("false", evaluate(exec_str, IS_LOADED))
  end)

  for title, case in pairs { -- code that uses it, its value; any order: each is a spec
    ["a constructor that is called"] = { "rtt.Variable('int', 3):tolua()", "3" },
    ["an operation as a method"] = { "rtt.getTC():getPeriod() == 0", "true" },
    ["the global rttlib"] = { "type(rttlib.port_clone_conn)", "function" },
    ["the global utils"] = { "type(utils.tab2str)", "function" },
    ["rtt.globals"] = { "rtt.globals.DefaultConnPolicy:getType()", "ConnPolicy" },
    ["require of rttlib"] = { "require('rttlib') == rttlib and type(rttlib.tc_cleanup)",
      "function" },
    ["require of utils"] = { "require('utils') == utils and type(utils.tab2str)",
      "function" },
    ["a text of a component"] = { "tostring(rtt.getTC()):find('arm') ~= nil",
      "true" },
  } do
    it("is loaded by " .. title, function()
      local exec_str = launched()
      assert.equal("false", evaluate(exec_str, IS_LOADED))
      assert.equal(case[2] .. " true", evaluate(exec_str, case[1] .. ", " .. IS_LOADED))
      assert.equal(case[2] .. " 4 function", evaluate(exec_str, case[1]
        .. ", rtt.Variable('int', 4):tolua(), type(rtt.getTC().trigger)"))
    end)
  end

  it("is loaded by a chart that uses it, without a warning", function()
    local exec_str = launched { fsmfile = chart_file(
      "info = false, has = { rtt.Variable('int', 3):tolua() },") }
    assert.equal("true 3", evaluate(exec_str, IS_LOADED .. ", fsm.has[1]"))
    assert.same({}, logged("rttlib"))
  end)

  it("is loaded by a callback, with a warning", function()
    local exec_str = launched { fsmfile = chart_file(
      "entry = function() x = rtt.Variable('int', 3):tolua() end,") }
    assert.equal("false", evaluate(exec_str, IS_LOADED))
    exec_str("trigger()")
    assert.equal("true 3", evaluate(exec_str, IS_LOADED .. ", x"))
    assert.same({ "Warning: rfsm.rtt: rttlib is loaded now, after the launch; with "
      .. "rttlib = true the launch loads it" }, logged("rttlib"))
  end)

  it("may be loaded by the program before, or by the launch", function()
    local exec_str = launched { prestr = "require 'rttlib'" }
    assert.equal("true 3", evaluate(exec_str, IS_LOADED .. ", rtt.Variable('int', 3)"
      .. ":tolua()"))
    rtt_helper.reset()
    exec_str = launched { rttlib = true }
    assert.equal("true 3", evaluate(exec_str, IS_LOADED .. ", rtt.Variable('int', 3)"
      .. ":tolua()"))
  end)

  it("is loaded once by a component that is configured again", function()
    local arm, exec_str = load("arm", "OCL::LuaTLSFComponent")
    arm:getProperty("lua_string"):set(("function configureHook() return "
      .. "require('rfsm.rtt').launch { fsmfile = %q, pool = 2000 } end"):format(
      chart_file()))
    for _ = 1, 3 do assert(arm:configure()) end
    assert.equal("false", evaluate(exec_str, IS_LOADED))
    assert.equal("3", evaluate(exec_str, "rtt.Variable('int', 3):tolua()"))
    assert(arm:configure())
    assert.equal("true 3", evaluate(exec_str, IS_LOADED .. ", rtt.Variable('int', 3)"
      .. ":tolua()"))
  end)

  it("may be missing: what needs it says so, the rest is as it was", function()
    local arm, exec_str = load("arm", "OCL::LuaTLSFComponent")
    exec_str([[package.preload.rttlib = function() error("none", 0) end
      package.preload.utils = function() return { own = true } end]])
    exec_str(("require('rfsm.rtt.component').start(require('rfsm.rtt.settings')"
      .. ".read('own', { fsmfile = %q }))"):format(chart_file()))
    assert.equal("nil nil true false", evaluate(exec_str, "rtt.getTC().nope, "
      .. "rtt.getTC().trigger, utils.own, (pcall(rtt.Variable, 'int'))"))
    assert.is_true(arm:configure())
  end)

  it("is loaded by a launch elsewhere", function()
    local exec_str = launched({ pool = nil }, "OCL::LuaComponent")
    assert.equal("true", evaluate(exec_str, IS_LOADED))
  end)
end)

