local helper = require "spec.helper"
local rfsm = require "rfsm"

-- (initial) -> a (with this doo) --e--> b --e_back--> a, entered
local function with_doo(doo)
  local fsm = helper.init(helper.chart("e", { a = rfsm.state { doo = doo } }))
  rfsm.step(fsm)
  return fsm
end

describe("a doo", function()
  it("runs one cycle a step", function()
    local trace = {}
    local fsm = with_doo(function()
      for i = 1, 3 do
        trace[#trace + 1] = i
        rfsm.yield()
      end
    end)
    rfsm.step(fsm)
    rfsm.step(fsm)
    assert.same({ 1, 2 }, trace)
  end)

  it("is idle after a true yield, not after a false one", function()
    assert.is_false(rfsm.step(with_doo(function() rfsm.yield(false) end)))
    assert.is_true(rfsm.step(with_doo(function() rfsm.yield("anything") end)))
  end)

  it("gets its arguments at the start and from each yield", function()
    local seen = {}
    local fsm = with_doo(function(...)
      seen[1] = { ... }
      seen[2] = { rfsm.yield() }
      rfsm.yield()
    end)
    rfsm.step(fsm, 2)
    for i = 1, 2 do
      assert.equal(fsm, seen[i][1])
      assert.equal(fsm.a, seen[i][2])
      assert.equal("doo", seen[i][3])
    end
  end)

  it("that returns makes its state done and sends e_done", function()
    local fsm = with_doo(function() end)
    assert.equal("active", rfsm.get_sta_mode(fsm.a))
    rfsm.step(fsm)
    assert.equal("done", rfsm.get_sta_mode(fsm.a))
    assert.same({ "e_done@root.a" }, fsm._intq)
  end)

  it("starts anew when its state is entered again", function()
    local starts = 0
    local fsm = with_doo(function()
      starts = starts + 1
      while true do rfsm.yield(true) end
    end)
    rfsm.run(fsm)
    rfsm.run(fsm)
    assert.equal(1, starts)
    helper.post_and_run(fsm, "e")
    helper.post_and_run(fsm, "e_back")
    assert.equal(2, starts)
  end)

  it("that fails is reported, its state done, without e_done", function()
    local fsm = with_doo(function() error("on purpose", 0) end)
    local said = helper.said(fsm, "err")
    assert.is_true(rfsm.run(fsm))
    assert.same({ "DOO doo program of state 'root.a' failed:  on purpose" }, said)
    assert.equal("done", rfsm.get_sta_mode(fsm.a))
    assert.same({}, fsm._intq)
  end)

  it("may be anything that can be called", function()
    local trace = {}
    rfsm.run(with_doo(setmetatable({}, { __call = helper.noting(trace, "called") })))
    assert.same({ "called" }, trace)
  end)

  it("waits while there are events to take", function()
    local trace = {}
    local fsm = with_doo(helper.noting(trace, "doo"))
    rfsm.send_events(fsm, "e")
    rfsm.step(fsm)
    assert.same({ {}, "root.b" }, { trace, rfsm.get_actleaf_fqn(fsm) })
  end)

  it("is dropped by reset", function()
    local fsm = with_doo(function() rfsm.yield() end)
    rfsm.step(fsm)
    rfsm.reset(fsm)
    assert.same({}, rfsm.get_active_conf(fsm))
    assert.same({ "e_init_fsm" }, fsm._intq)
    assert.is_nil(fsm.a._doo_co)
  end)
end)
