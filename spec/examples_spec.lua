-- The trace of each example: what it prints for the commands that its comment proposes.

local helper = require "spec.helper"
local rfsm = require "rfsm"

-- What is printed by running the chart and then by each further action: a string is an
-- event to send before `run`, a function is called with the machine.
local function session(name, ...)
  local actions = { ... }
  return helper.printed(function()
    local fsm = helper.init(rfsm.load("examples/" .. name .. ".lua"))
    rfsm.run(fsm)
    for i = 1, #actions do
      local action = actions[i]
      if type(action) == "function" then
        action(fsm)
        rfsm.run(fsm)
      else
        helper.post_and_run(fsm, action)
      end
    end
  end)
end

describe("the example", function()
  it("hello_world prints at an exit and an entry", function()
    assert.same({ "hello", "world", "hello", "world" },
      session("hello_world", "e_restart"))
  end)

  it("on_off gives one event two meanings", function()
    assert.same({ "dark", "bright", "dark" }, session("on_off", "e_push", "e_push"))
  end)

  it("composite_nested leaves the composite last", function()
    assert.same({
      "amplifier on", "radio on", "radio off", "tape on", "tape off", "amplifier off",
    }, session("composite_nested", "e_power", "e_mode", "e_power"))
  end)

  it("connector_chain takes all of a path or nothing", function()
    local function fill() _G.tank.fuel = 1 end -- luacheck: ignore 143
    assert.same({ "oil checked", "pump primed", "ignition", "engine running" },
      session("connector_chain", "e_start", fill, "e_start"))
  end)

  it("connector_split decides with a guard", function()
    local function weigh_in() _G.parcel.kg = 30 end -- luacheck: ignore 143
    assert.same({ "to shelf a", "to shelf b" },
      session("connector_split", "e_parcel", weigh_in, "e_parcel"))
  end)

  it("exit_connector leaves by the way out that was taken inside", function()
    assert.same({
      "closing fingers", "grasp left", "going home", "closing fingers", "grasp left",
      "carrying",
    }, session("exit_connector", "e_slip", "e_again", "e_firm"))
  end)

  it("relative_refs layers transitions on a sub machine", function()
    assert.same({ "slow", "backing off", "slow", "fast" },
      session("relative_refs", "e_bump", "e_clear", "e_fast", "e_bump"))
  end)

  it("priorities lets the larger pn win, and an outer transition first", function()
    assert.same({ "a", "c", "a", "halted" },
      session("priorities", "e_go", "e_back", "e_stop"))
  end)

  it("doo_once goes on when its doo is done", function()
    assert.same({ "calibrating", "ready" }, session("doo_once"))
  end)

  it("doo_busy runs to the end of its doo in one call", function()
    assert.same({ "3", "2", "1", "lift off" }, session("doo_busy"))
  end)

  it("doo_busy can be interrupted between two cycles", function()
    local lines = helper.printed(function()
      local fsm = helper.init(rfsm.load("examples/doo_busy.lua"))
      rfsm.step(fsm, 3)
      helper.post_and_run(fsm, "e_abort")
    end)
    assert.same({ "3", "2", "aborted" }, lines)
  end)

  it("doo_idle does one cycle per call", function()
    local function again() end
    assert.same({ "control cycle 1", "control cycle 2", "stopped" },
      session("doo_idle", again, "e_stop"))
  end)

  it("guards_effects opens when enough is paid", function()
    assert.same({ "paid 1", "paid 2", "please pass" },
      session("guards_effects", "e_push", "e_coin", "e_coin", "e_push", "e_push"))
  end)

  it("getevents works off a mailbox", function()
    local function put_in() _G.mailbox[1] = "e_job" end -- luacheck: ignore 143
    assert.same({ "waiting", "working", "waiting" }, session("getevents", put_in))
  end)

  it("compose mounts one chart twice", function()
    assert.same({ "dark", "bright", "dark", "bright" },
      session("compose", "e_push", "e_next", "e_push"))
  end)

  it("derive changes a base machine", function()
    assert.same({ "dark", "brighter than ever", "dimmed", "dark" },
      session("derive", "e_push", "e_push", "e_push"))
  end)

  it("derive leaves the base as it is", function()
    assert.same({ "dark", "bright", "dark" }, session("on_off", "e_push", "e_push"))
  end)

  it("dynamic learns while it runs", function()
    assert.same({ "resting", "learned to dance", "resting", "dancing", "resting" },
      session("dynamic", "e_music", "e_learn", "e_music"))
  end)

  it("ball_tracking follows the ball", function()
    assert.same({
      "components: configured", "camera: on", "head: sweep", "head: stop sweeping",
      "estimator: start", "head: follow", "estimator: stop", "head: sweep",
      "head: stop sweeping", "camera: off", "head: park",
    }, session("ball_tracking", "e_ball", "e_lost", "e_stop"))
  end)

  it("rtt grasps, and lets go when something slips", function()
    assert.same({
      "fingers open", "fingers closing", "fingers open", "fingers closing",
      "motor holds", "motor off", "fingers open",
    }, session("rtt", "e_close", "e_open", "e_close", "e_contact", "e_slip"))
  end)

  it("failure_recovery reports, brakes and recovers", function()
    local function repair() _G.motor.is_broken = false end -- luacheck: ignore 143
    assert.same({
      "failure:  error executing entry of root.robot.working:  motor does not turn",
      "motor off", "brakes on", "brakes off", "motor turns", "motor off", "power cut",
    }, session("failure_recovery", repair, "e_repaired", "e_emergency"))
  end)
end)
