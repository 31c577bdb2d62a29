-- The trace of each example: what it prints for the commands that its comment proposes.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local servers = require "spec.support.servers"
local timeevent = require "rfsm_timeevent"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

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

local function example_names()
  local names = helper.lines_of("ls examples/*.lua")
  for i, name in ipairs(names) do names[i] = name:match("([^/]*)%.lua$") end
  return names
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

-- An action that sets a field of a global of the chart.
local function set(global, field, value)
  return function() rawget(_G, global)[field] = value end
end

local function again() end

local now = 0
local function wait(seconds) return function() now = now + seconds end end

-- The example, what it does, the lines that it prints, the actions.
local SESSIONS = {
  { "hello_world", "prints at an exit and an entry", { "hello", "world", "hello",
    "world" }, "e_restart" },
  { "on_off", "gives one event two meanings", { "dark", "bright", "dark" }, "e_push",
    "e_push" },
  { "lamp", "is dim first, and off from each light", { "light off", "light on",
    "full light", "light off" }, "e_switch", "e_more", "e_switch" },
  { "composite_nested", "leaves the composite last", { "amplifier on", "radio on",
    "radio off", "tape on", "tape off", "amplifier off" }, "e_power", "e_mode",
    "e_power" },
  { "connector_chain", "takes all of a path or nothing", { "oil checked",
    "pump primed", "ignition", "engine running" }, "e_start", set("tank", "fuel", 1),
    "e_start" },
  { "connector_split", "decides with a guard", { "to shelf a", "to shelf b" },
    "e_parcel", set("parcel", "kg", 30), "e_parcel" },
  { "exit_connector", "leaves by the way out that was taken inside",
    { "closing fingers", "grasp left", "going home", "closing fingers", "grasp left",
      "carrying" }, "e_slip", "e_again", "e_firm" },
  { "relative_refs", "layers transitions on a sub machine", { "slow", "backing off",
    "slow", "fast" }, "e_bump", "e_clear", "e_fast", "e_bump" },
  { "priorities", "lets the larger pn win, and an outer transition first", { "a", "c",
    "a", "halted" }, "e_go", "e_back", "e_stop" },
  { "doo_once", "goes on when its doo is done", { "calibrating", "ready" } },
  { "doo_busy", "runs to the end of its doo in one call", { "3", "2", "1",
    "lift off" } },
  { "doo_idle", "does one cycle per call", { "control cycle 1", "control cycle 2",
    "stopped" }, again, "e_stop" },
  { "guards_effects", "opens when enough is paid", { "paid 1", "paid 2",
    "please pass" }, "e_push", "e_coin", "e_coin", "e_push", "e_push" },
  { "getevents", "works off a mailbox", { "waiting", "working", "waiting" },
    set("mailbox", 1, "e_job") },
  { "compose", "mounts one chart twice", { "dark", "bright", "dark", "bright" },
    "e_push", "e_next", "e_push" },
  { "derive", "changes a base machine", { "dark", "brighter than ever", "dimmed",
    "dark" }, "e_push", "e_push", "e_push" },
  { "on_off", "is left as it is by derive", { "dark", "bright", "dark" }, "e_push",
    "e_push" },
  { "dynamic", "learns while it runs", { "resting", "learned to dance", "resting",
    "dancing", "resting" }, "e_music", "e_learn", "e_music" },
  { "ball_tracking", "follows the ball", { "components: configured", "camera: on",
    "head: sweep", "head: stop sweeping", "estimator: start", "head: follow",
    "estimator: stop", "head: sweep", "head: stop sweeping", "camera: off",
    "head: park" }, "e_ball", "e_lost", "e_stop" },
  { "rtt", "grasps, and lets go when something slips", { "fingers open",
    "fingers closing", "fingers open", "fingers closing", "motor holds", "motor off",
    "fingers open" }, "e_close", "e_open", "e_close", "e_contact", "e_slip" },
  { "failure_recovery", "reports, brakes and recovers", { "failure:  error executing "
    .. "entry of root.robot.working:  motor does not turn", "motor off", "brakes on",
    "brakes off", "motor turns", "motor off", "power cut" },
    set("motor", "is_broken", false), "e_repaired", "e_emergency" },
  { "deployer", "stops what it has begun when one of its programs fails", {
    "arm load", "camera load", "arm configure", "camera configure", "arm start",
    "camera start", "e_stop", "arm stop", "camera stop", "arm load", "camera load",
    "arm configure", "camera configure", "arm start",
    "root.deploying.starting: camera: no answer to start", "arm stop", "camera stop" },
    "e_stop", set("robot", "broken", "camera"), "e_up" },
  { "await", "starts when all parts are ready, in any order, or when told so",
    { "booting", "ready", "booting", "ready" }, "e_camera", "e_arm", "e_base",
    "e_reboot", "e_arm", "e_force" },
  { "checks", "warns of the event that is misspelt", { "dark", "bright",
    "WARNING: undeclared event e_pusch received" }, function(fsm) fsm.warn = print end,
    "e_push", "e_pusch" },
  { "emem", "locks the door after the third wrong code, and counts anew", { "closed",
    "locked", "closed", "open", "closed" }, "e_wrong", "e_wrong", "e_wrong", "e_reset",
    "e_wrong", "e_right", "e_close", "e_wrong", "e_wrong" },
  { "preview", "warms the gripper up while an object is near", { "searching",
    "gripper warms up", "grasping", "searching", "gripper warms up",
    "gripper warms up", "gripper warms up" }, -- each iteration
    set("world", "distance", 0.1), "e_grasp", "e_release" },
  { "seqand", "moves both arms, and begins anew", { "right open", "left open",
    "right closed", "left closed", "right lets go", "left lets go", "stopped",
    "right open", "left open" }, "e_grasp", "e_stop", "e_start" },
  { "timeevent", "lights up in time", { "do not walk", "please wait", "walk",
    "do not walk", "dark", "do not walk", "dark" }, "e_button", wait(0.3), wait(1),
    wait(59), wait(3), "e_short" },
}

describe("the example", function()
  for _, row in ipairs(SESSIONS) do
    it(row[1] .. " " .. row[2], function()
      timeevent.set_gettime_hook(function() return now, 0 end)
      assert.same(row[3], session(row[1], unpack(row, 4)))
    end)
  end

  it("doo_busy can be interrupted between two cycles", function()
    local lines = helper.printed(function()
      local fsm = helper.init(rfsm.load("examples/doo_busy.lua"))
      rfsm.step(fsm, 3)
      helper.post_and_run(fsm, "e_abort")
    end)
    assert.same({ "3", "2", "aborted" }, lines)
  end)

  it("checks has a state that nothing leads to, with the reason", function()
    local model = rfsm.load("examples/checks.lua")
    assert.same({}, require("rfsm_checks").check(model))
    model.spare.checks = nil
    assert.same({ "examples/checks.lua:20: root.spare: unreachable, no path of "
      .. "transitions leads here [unreachable]" }, require("rfsm_checks").check(model))
  end)

  it("monitor lands when a condition that it monitors holds", function()
    local lines = helper.printed(function()
      local fsm = helper.init(rfsm.load("examples/monitor.lua"))
      rfsm.step(fsm, 3)
      set("drone", "volt", 10)()
      rfsm.run(fsm)
      set("drone", "volt", 12)()
      rfsm.send_events(fsm, "e_repaired")
      rfsm.step(fsm)
    end)
    assert.same({ "flying", "landing", "flying" }, lines)
  end)

  it("luv_host sleeps until the next timer can fire", function()
    local lines
    helper.with(package.loaded, { luv = loop_on_a_false_clock() }, function()
      lines = helper.printed(function() loadfile("examples/hosts/luv_host.lua")() end)
    end)
    assert.same({
      INFO .. "root.initial", INFO .. "root.lights.initial", "do not walk",
      "please wait", "walk", "do not walk", "please wait", "walk", "do not walk",
      "please wait", "walk", "woken 9 times",
    }, lines)
  end)

  it("is played in LÖVE, where the guard gets no event but its own", function()
    -- A game of which no picture is drawn: ten seconds of 20 frames each.
    assert.equal("e_lost e_seen e_there", helper.output_of([[
      local quiet = function() end
      love = { window = { setMode = quiet }, event = { quit = quiet },
        mouse = { isDown = function() return false end } }
      package.path = "./?.lua;" .. package.path
      local rfsm, print, sent = require "rfsm", print, {}
      local send_events = rfsm.send_events
      function rfsm.send_events(fsm, ...)
        for i = 1, select("#", ...) do
          local event = select(i, ...)
          if event ~= nil then sent[tostring(event)] = true end
        end
        return send_events(fsm, ...)
      end
      _G.print = quiet
      dofile "examples/hosts/love/main.lua"
      for _ = 1, 200 do love.update(0.05) end
      print(table.concat(rfsm.sorted_keys(sent), " ")) ]]))
  end)

  it("has a session or a spec here, each of them", function()
    local text, missing = helper.content("spec/examples_spec.lua"), {}
    for _, name in ipairs(example_names()) do
      if not (text:find('  { "' .. name .. '", "', 1, true)
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
    return table.concat(helper.lines_of(command .. " 2>&1"), "\n")
  end

  for _, lib in ipairs { "lua5.1", "lua5.4" } do
    local flags = output_of("pkg-config --cflags --libs " .. lib):match("^%-[^\n]*")
    if not flags or output_of("command -v cc") == "" then
      pending("with " .. lib .. ": its headers, or cc, are missing")
    else
      it("walks, drives and changes a machine with " .. lib, function()
        local program = os.tmpname()
        assert.equal("", output_of(("cc -Wall examples/hosts/c_host.c %s -o %s"):format(
          flags, program)))
        local output = output_of(program)
        os.remove(program)
        assert.equal("3 states\nentered root.on\n"
          .. "active: root.on.bright after 4 turns", output)
      end)
    end
  end
end)

describe("the host in nginx", function()
  if not rawget(_G, "jit") then return end -- it has LuaJIT in it
  if servers.no_nginx() then return pending(servers.no_nginx()) end
  local http = require "socket.http"

  teardown(servers.stop_all)

  -- Calls f(url) while nginx runs; returns its log.
  local function with_nginx(f)
    local port, scratch = servers.free_port(), os.tmpname() .. "_nginx"
    local conf = helper.file_with((helper.content("examples/hosts/nginx.conf")
      :gsub("8090", port):gsub("/tmp/rfsm_nginx", scratch)))
    local server = servers.nginx(conf)
    local ok, problem = pcall(f, "http://127.0.0.1:" .. port .. "/")
    server:kill()
    os.remove(scratch)
    helper.remove_files()
    if not ok then error(tostring(problem) .. "\n" .. server:log(), 0) end
    return server:log()
  end

  -- Asks until the answer is the one expected.
  local function wait_for(url, leaf)
    for _ = 1, 1000 do
      local answer = http.request(url)
      if answer == leaf .. "\n" then return end
      require("socket").select(nil, nil, 0.01)
    end
    error("never in " .. leaf, 0)
  end

  it("takes events from requests, and time from nginx", function()
    local log = with_nginx(function(url)
      wait_for(url, "root.lights.stop")
      assert.equal("root.lights.wait\n", (http.request(url, "e_button")))
      wait_for(url, "root.lights.walk")
      wait_for(url, "root.lights.stop")
    end)
    local lines = {}
    for line in log:gmatch("timeevent%.lua:%d+: ([^,\n]*)") do
      lines[#lines + 1] = line:gsub("^%w+%(%): ", "") -- the function, if it has a name
    end
    assert.same({ "do not walk", "please wait", "walk", "do not walk" }, lines)
    assert.is_nil(log:match("writing a global"))
  end)
end)
