-- The trace of each example: what it prints for the commands that its comment proposes.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local timeevent = require "rfsm_timeevent"

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

local function content(name)
  local file = assert(io.open(name))
  local text = file:read("*a")
  file:close()
  return text
end

local function example_names()
  local pipe, names = assert(io.popen("ls examples/*.lua")), {}
  for line in pipe:lines() do names[#names + 1] = line:match("([^/]*)%.lua$") end
  pipe:close()
  return names
end

-- Runs `f` while `require(name)` gives `module`; returns what it returns.
local function with_module(name, module, f)
  local before = package.loaded[name]
  package.loaded[name] = module
  local ok, result = pcall(f)
  package.loaded[name] = before
  if not ok then error(result, 0) end
  return result
end

-- What the luv host needs of luv, on a clock that jumps to the next timer.
local function loop_on_a_false_clock()
  local loop, timers, now, is_stopped = {}, {}, 0, false
  local Timer = {}
  Timer.__index = Timer

  function Timer:start(after, again, f)
    self.at, self.again, self.f = now + after, again, f
  end

  function Timer:stop() self.at = nil end

  function loop.new_timer()
    timers[#timers + 1] = setmetatable({}, Timer)
    return timers[#timers]
  end

  function loop.hrtime() return now * 1000000 end

  function loop.update_time() end

  function loop.stop() is_stopped = true end

  local function next_timer()
    local found
    for _, timer in ipairs(timers) do
      if timer.at and (not found or timer.at < found.at) then found = timer end
    end
    return found
  end

  function loop.run()
    while not is_stopped do
      local timer = next_timer()
      now = timer.at
      timer.at = timer.again > 0 and now + timer.again or nil
      timer.f()
    end
  end

  return loop
end

local INFO = "INFO: created undeclared connector "

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

  it("await starts when all parts are ready, in any order, or when told so", function()
    assert.same({ "booting", "ready", "booting", "ready" },
      session("await", "e_camera", "e_arm", "e_base", "e_reboot", "e_arm", "e_force"))
  end)

  it("checks warns of the event that is misspelt", function()
    local function listen(fsm) fsm.warn = print end
    assert.same({ "dark", "bright", "WARNING: undeclared event e_pusch received" },
      session("checks", listen, "e_push", "e_pusch"))
  end)

  it("checks has a state that nothing leads to, with the reason", function()
    local model = rfsm.load("examples/checks.lua")
    assert.same({}, require("rfsm_checks").check(model))
    model.spare.checks = nil
    assert.same({ "examples/checks.lua:20: root.spare: unreachable, no path of "
      .. "transitions leads here [unreachable]" }, require("rfsm_checks").check(model))
  end)

  it("emem locks the door after the third wrong code, and counts anew", function()
    assert.same({ "closed", "locked", "closed", "open", "closed" },
      session("emem", "e_wrong", "e_wrong", "e_wrong", "e_reset", "e_wrong", "e_right",
        "e_close", "e_wrong", "e_wrong"))
  end)

  it("ext lands when a condition that it monitors holds", function()
    local lines = helper.printed(function()
      local fsm = helper.init(rfsm.load("examples/monitor.lua"))
      rfsm.step(fsm, 3)
      _G.drone.volt = 10 -- luacheck: ignore 143
      rfsm.run(fsm)
      _G.drone.volt = 12 -- luacheck: ignore 143
      rfsm.send_events(fsm, "e_repaired")
      rfsm.step(fsm)
    end)
    assert.same({ "flying", "landing", "flying" }, lines)
  end)

  it("preview warms the gripper up while an object is near", function()
    local function approach() _G.world.distance = 0.1 end -- luacheck: ignore 143
    assert.same({ "searching", "gripper warms up", "grasping", "searching",
      "gripper warms up", "gripper warms up", "gripper warms up" }, -- each iteration
      session("preview", approach, "e_grasp", "e_release"))
  end)

  it("seqand moves both arms, and begins anew", function()
    assert.same({
      INFO .. "root.initial", INFO .. "root.initial", -- of the two arms
      "right open", "left open", "right closed", "left closed", "right lets go",
      "left lets go", "stopped", "right open", "left open",
    }, session("seqand", "e_grasp", "e_stop", "e_start"))
  end)

  it("timeevent lights up in time", function()
    local now = 0
    timeevent.set_gettime_hook(function() return now, 0 end)
    local function wait(seconds) return function() now = now + seconds end end
    assert.same({
      "do not walk", "please wait", "walk", "do not walk", "dark", "do not walk",
      "dark",
    }, session("timeevent", "e_button", wait(0.3), wait(1), wait(59), wait(3),
      "e_fault"))
  end)

  it("luv_host sleeps until the next timer can fire", function()
    local lines = with_module("luv", loop_on_a_false_clock(), function()
      return helper.printed(function()
        loadfile("examples/hosts/luv_host.lua")()
      end)
    end)
    assert.same({
      INFO .. "root.initial", INFO .. "root.lights.initial", "do not walk",
      "please wait", "walk", "do not walk", "please wait", "walk", "do not walk",
      "please wait", "walk", "woken 9 times",
    }, lines)
  end)

  -- A name in quotes is a call of `session` or of `rfsm.load`.
  it("has an entry here, each of them", function()
    local text, missing = content("spec/examples_spec.lua"), {}
    for _, name in ipairs(example_names()) do
      if not (text:find('session("' .. name .. '"', 1, true)
        or text:find("examples/" .. name .. ".lua", 1, true)) then
        missing[#missing + 1] = name
      end
    end
    assert.same({}, missing)
  end)
end)

-- The C host, with each of the Lua libraries that are installed with their headers.
describe("the host in C", function()
  local function output_of(command)
    local pipe = assert(io.popen(command .. " 2>&1"))
    local text = pipe:read("*a")
    pipe:close()
    return text
  end

  for _, lib in ipairs { "lua5.1", "lua5.4" } do
    local flags = output_of("pkg-config --cflags --libs " .. lib):match("^%-[^\n]*")
    if not flags or output_of("command -v cc") == "" then
      print("skipped: the host in C with " .. lib .. ", its headers or cc are missing")
    else
      it("walks, drives and changes a machine with " .. lib, function()
        local program = os.tmpname()
        assert.equal("", output_of(("cc -Wall examples/hosts/c_host.c %s -o %s"):format(
          flags, program)))
        local output = output_of(program)
        os.remove(program)
        assert.equal("3 states, 2 transitions\ntransition 2 leaves root.off\n"
          .. "entered root.on\nactive: root.on.bright\n", output)
      end)
    end
  end
end)
