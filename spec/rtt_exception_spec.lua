-- An exception of C++ goes through Lua without a trace: a launched machine goes on
-- behind the callback that raised it. On the stand-in in spec/support/rtt.lua.

local helper = require "spec.helper"
local rtt_helper = require "spec.support.rtt_helper" -- before rfsm.rtt

local rfsm_rtt = require "rfsm.rtt"

local file_with = helper.file_with
local evaluate, spin = rtt_helper.evaluate, rtt_helper.spin
local deploy, load, logged = rtt_helper.deploy, rtt_helper.load, rtt_helper.logged
local feed = rtt_helper.feed

local REPORT = "Error: rfsm.rtt: an exception of C++ has ended a step, which goes on "
  .. "behind the callback that raised it"

local function begin()
  rtt_helper.reset()
  if rtt_helper.is_standin then rtt_helper.rtt.standin.has_exceptions = true end
end

before_each(begin)
after_each(rtt_helper.reset)

-- A chart with more members: (initial) -> a --e_throw--> b --e_back--> a. Each state
-- appends its name to the global `trace`, and the effect of e_throw throws.
local function chart_file(members)
  return file_with([[
local rfsm = require "rfsm"
local state, trans, throw = rfsm.state, rfsm.trans, rtt.standin.throw
trace = trace or ""
local function note(text) return function() trace = trace .. " " .. text end end
local function leaf(name) return state { entry = note(name) } end
return state {
  info = false, warn = false,
  a = leaf "a", b = leaf "b", trans { src = "initial", tgt = "a" },
  trans { src = "a", tgt = "b", events = { "e_throw" }, effect = throw },
  trans { src = "b", tgt = "a", events = { "e_back" } }, ]] .. (members or "")
    .. "\n}\n")
end

-- Launches a chart in a component; returns it, its exec_str, and a function that sends
-- events and waits.
local function launched(members, args)
  args = args or {}
  args.name, args.fsmfile, args.deployer = "arm", chart_file(members), "Deployer"
  local arm = rfsm_rtt.component_launch_rfsm(args)
  local events = feed("arm.events_in")
  assert(arm:configure())
  arm:start()
  spin()
  return arm, arm:getOperation("exec_str"), function(...)
    rtt_helper.write_all(events, ...)
    spin()
  end
end

-- Has RTT recover a component that an exception has stopped.
local function recover(arm)
  assert.equal("Exception", arm:getState())
  for _, name in ipairs { "recover", "configure", "start" } do
    assert.is_true(arm[name](arm), name)
  end
  spin()
end

local function failures(arm) return arm:getAttribute("rfsm_failures"):get() end

describe("a component after an exception of C++", function()
  if not rtt_helper.is_standin then return pending "needs the stand-in" end

  it("goes on behind the effect that raised it, and logs and counts that", function()
    for steps = 1, 2 do
      local arm, exec_str, send = launched(nil, { steps = steps })
      send("e_throw", "e_late")
      assert.same({ REPORT }, logged("rfsm.rtt: an"))
      assert.equal(1, failures(arm))
      recover(arm)
      assert.equal(" a b", evaluate(exec_str, "trace"))
      send("e_back")
      send("e_throw")
      recover(arm)
      send("e_back")
      assert.equal(" a b a b a", evaluate(exec_str, "trace"))
      assert.equal(2, failures(arm))
      begin()
    end
  end)

  it("goes on if a guard, an exit, an entry, a hook or getevents raised it", function()
    for field, traces in pairs { -- any order: each stands alone
      ["fsm.a.exit"] = " a b a", ["fsm.b.entry"] = " a a", ["fsm.a.entry"] = " a b",
      ["fsm[2].guard"] = " a b a", ["fsm.pre_step_hook"] = " a b a",
      ["fsm.post_step_hook"] = " a b a", ["fsm.getevents"] = " a b a",
    } do
      local arm, exec_str, send = launched()
      exec_str(([[fsm[2].effect, old = nil, %s
        %s = function(...)
          %s = old
          rtt.standin.throw()
        end]]):format(field, field, field))
      send("e_throw", "e_none")
      if arm:getState() == "Exception" then recover(arm) end
      send("e_throw")
      send("e_back")
      if arm:getState() == "Exception" then recover(arm) end
      assert.equal(traces, evaluate(exec_str, "trace"), field)
      begin()
    end
  end)

  it("goes on if a guard or a predicate raises it again and again", function()
    for _, field in ipairs { "fsm[2].guard", "boom" } do
      local arm, exec_str, send = launched([[
        trans { src = "a", tgt = "b", events = { function(e)
          return e == "e_throw" and boom and boom()
        end } }]])
      exec_str(("fsm[2].effect = nil %s = function() rtt.standin.throw() end"):format(
        field))
      if field == "boom" then exec_str("fsm[2].guard = function() return false end") end
      send("e_throw")
      for _ = 1, 2 do
        recover(arm)
        send("e_none")
      end
      assert.equal("Running", arm:getState())
      assert.equal(" a", evaluate(exec_str, "trace"))
      exec_str("fsm[2].guard = nil boom = nil")
      send("e_throw")
      send("e_back")
      assert.equal(" a b a", evaluate(exec_str, "trace"))
      begin()
    end
  end)

  it("is reset by rfsm.reset, in a hook of its program or from outside", function()
    local arm, exec_str, send = launched(nil, {
      poststr = "function startHook() if was then rfsm.reset(fsm) end was = true "
        .. "return true end" })
    send("e_throw")
    recover(arm)
    assert.equal(" a a", evaluate(exec_str, "trace"))
    send("e_throw")
    exec_str("rfsm.reset(fsm) leaf = fsm._act_leaf")
    assert.equal("false", evaluate(exec_str, "leaf"))
  end)

  it("has regions that go on if a callback of one raised it", function()
    local REGION = [[state { one = leaf "one", two = leaf "two",
      trans { src = "initial", tgt = "one" },
      trans { src = "one", tgt = "two", events = { "e_in" }, effect = throw },
      trans { src = "two", tgt = "one", events = { "e_in" } } }, ]]
    local arm, exec_str, send = launched("par = rfsm.seqand { r = " .. REGION
      .. " s = state { x = leaf 'x', trans { src = 'initial', "
      .. "tgt = 'x' }, trans { src = 'x', tgt = 'x', events = { 'e_in' } } } }, "
      .. "trans { src = 'a', tgt = 'par', events = { 'e_par' } }, "
      .. "trans { src = 'par', tgt = 'a', events = { 'e_leave' } }, ")
    send("e_par")
    send("e_in")
    recover(arm)
    send("e_in")
    send("e_in")
    recover(arm)
    send("e_leave")
    assert.equal(" a one x two x one x two x a", evaluate(exec_str, "trace"))
  end)

  it("has a leaf whose doo has failed if that raised it", function()
    local arm, exec_str, send = launched([[
      c = state { doo = function() rfsm.yield() throw() end },
      trans { src = "a", tgt = "c", events = { "e_doo" } },
      trans { src = "c", tgt = "b", events = { "e_done" } },
      trans { src = "c", tgt = "a", events = { "e_go" } }, ]])
    send("e_doo")
    send("e_none")
    recover(arm)
    send("e_none")
    assert.equal("root.c done", evaluate(exec_str, "fsm._act_leaf._fqn, fsm.c._mode"))
    assert.equal(1, #logged("doo program of state 'root.c' failed"))
    send("e_go")
    assert.equal(" a a", evaluate(exec_str, "trace"))
  end)

  it("reads its ports if its first entry, in startHook, raised it", function()
    local arm, _, send = launched("entry = throw,", { enter = "start" })
    assert.equal("Exception", arm:getState())
    recover(arm)
    local exec_str = arm:getOperation("exec_str")
    exec_str("fsm[2].effect = nil")
    send("e_throw")
    assert.equal(" a b", evaluate(exec_str, "trace"))
  end)

  it("goes on if its program has the updateHook, which runs the machine", function()
    for _, code in ipairs { "trigger()", "rfsm.run(fsm)", "rfsm.step(fsm)" } do
      local arm, exec_str, send = launched(nil, {
        poststr = "function updateHook() " .. code .. " end" })
      send("e_throw")
      recover(arm)
      for _ = 1, 2 do send("e_back") end
      assert.equal(" a b a", evaluate(exec_str, "trace"))
      assert.equal(1, failures(arm))
      begin()
    end
  end)

  it("goes on if it launches its machine itself, and is not configured anew", function()
    local arm, exec_str = load("arm")
    arm:getProperty("lua_file"):set(file_with(([[
function configureHook()
  return fsm ~= nil or require("rfsm.rtt").launch { fsmfile = %q }
end]]):format(chart_file())))
    assert(arm:configure())
    assert(arm:start())
    spin()
    exec_str("rfsm.send_events(fsm, 'e_throw')")
    arm:getOperation("trigger")()
    spin()
    recover(arm)
    assert.equal(" a b", evaluate(exec_str, "trace"))
  end)

  it("launches again if its launch raised it", function()
    local arm = load("arm")
    arm:getProperty("lua_file"):set(file_with(([[
function configureHook()
  times = (times or 0) + 1
  return require("rfsm.rtt").launch { fsmfile = %q,
    poststr = times == 1 and "rtt.standin.throw()" or nil }
end]]):format(chart_file())))
    assert.is_false(arm:configure())
    recover(arm)
    assert.equal(" a", evaluate(arm:getOperation("exec_str"), "trace"))
  end)

  it("has a step under way if a callback stops it, or calls trigger()", function()
    local arm, exec_str, send = launched()
    exec_str([[function fsm.a.exit()
      rtt.getTC():stop()
      trigger()
      trace = trace .. " exit"
    end
    fsm[2].effect = function() trace = trace .. " effect" end
    function stopHook() rfsm.step(fsm) end]])
    send("e_throw")
    assert.equal(" a exit effect b", evaluate(exec_str, "trace"))
    assert.equal(1, failures(arm))
    assert.equal(2, #logged("rfsm.step: the machine is in the middle of a step"))
    assert.same({}, logged("exception of C++"))
  end)
end)

describe("a service after an exception of C++", function()
  if not rtt_helper.is_standin then return pending "needs the stand-in" end

  local host, exec_str

  before_each(function()
    host = load("host", "OCL::HelloWorld")
    assert(deploy("loadService", "host", "Lua"))
    exec_str = host:provides("Lua"):getOperation("exec_str")
  end)

  it("goes on when its thread and its hook are started again", function()
    local events
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
    events = feed("host.events_in")
    rtt_helper.advance(0.2)
    events:write("e_throw")
    rtt_helper.advance(0.2)
    assert.equal(1, #logged("host caught a C++ exception, stopped thread !"))
    assert.equal(" a", evaluate(exec_str, "trace"))
    exec_str("eehook:enable()")
    host:activate()
    rtt_helper.advance(0.2)
    assert.equal(" a b", evaluate(exec_str, "trace"))
    events:write("e_back")
    rtt_helper.advance(0.2)
    assert.equal(" a b a", evaluate(exec_str, "trace"))
    assert.equal(1, failures(host))
  end)

  it("goes on at the second trigger() without a hook: the first one reports", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str)
    exec_str("trigger() rfsm.send_events(fsm, 'e_throw')")
    assert.is_false((pcall(exec_str, "trigger()")))
    exec_str("trigger()")
    assert.same({ REPORT }, logged("rfsm.rtt: an"))
    assert.equal(" a", evaluate(exec_str, "trace"))
    exec_str("trigger() rfsm.send_events(fsm, 'e_back') trigger()")
    assert.equal(" a b a", evaluate(exec_str, "trace"))
  end)

  it("is not disturbed by a callback that calls trigger()", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str)
    exec_str([[trigger()
      function fsm.a.exit() trigger() trace = trace .. " exit" end
      fsm[2].effect = function() trace = trace .. " effect" end
      for _, event in ipairs { "e_throw", "e_back", "e_throw", "e_back" } do
        rfsm.send_events(fsm, event)
        trigger()
      end]])
    assert.equal(" a exit effect b a exit effect b a", evaluate(exec_str, "trace"))
    assert.equal(2, failures(host))
  end)
end)
