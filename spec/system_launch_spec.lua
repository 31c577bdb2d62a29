-- Systems launched in the stand-in for RTT: each machine in a component, each wire a
-- connection of its own. In a rttlua the specs run on the real RTT.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local rtt_helper = require "spec.support.rtt_helper"
local match = require "rfsm.shared.match"
local rfsm_rtt = require "rfsm.rtt"

local FOLDER = "examples/systems/"

-- Charts in files, and a system of them: `charts` has texts of the members of the root,
-- `wires` is the text of a list. Returns the file of the system.
local function written(charts, wires)
  local lines = { "local system = require 'rfsm.system'", "return system {" }
  for _, name in ipairs(rfsm.sorted_keys(charts)) do
    local file = helper.file_with(("require 'rfsm'; require 'rfsm_timeevent'; "
      .. "local state, trans = rfsm.state, rfsm.trans\n"
      .. "local function emits(...) local list = { ... }\n"
      .. "return function(fsm) for _, e in ipairs(list) do fsm.emit(e) end end end\n"
      .. "return state { info = false, warn = false, %s }"):format(charts[name]))
    lines[#lines + 1] = ("  %s = system.load %q,"):format(name, file)
  end
  lines[#lines + 1] = "  wires = { " .. wires .. " },"
  lines[#lines + 1] = "}"
  return helper.file_with(table.concat(lines, "\n"))
end

-- (initial) -> a, in which these events are emitted.
local function teller(...)
  local names = {}
  for i, name in ipairs { ... } do names[i] = ("%q"):format(name) end
  return ("a = state { final = true, entry = emits(%s) }, "
    .. "trans { src = 'initial', tgt = 'a' }"):format(table.concat(names, ", "))
end

-- A chain of states s0, s1 ..., each left by the next event.
local function taker(...)
  local texts = { "trans { src = 'initial', tgt = 's0' }, s0 = state {}" }
  for i, name in ipairs { ... } do
    texts[#texts + 1] = ("s%d = state {}, trans { src = 's%d', tgt = 's%d', "
      .. "events = { %q } }"):format(i, i - 1, i, name)
  end
  return table.concat(texts, ", ")
end

-- Launches a system; returns it, and a function that returns the leaves.
local function launched(file, options)
  local cell = rfsm_rtt.launch_system(file, options)
  local ports = {}
  for _, name in ipairs(cell.cell.names) do
    ports[name] = rtt_helper.listen(name .. ".fqn")
  end
  return cell, function()
    rtt_helper.spin()
    local texts = {}
    for i, name in ipairs(cell.cell.names) do
      texts[i] = name .. " " .. (rtt_helper.leaves(ports[name]):match("[%w_]*$"))
    end
    return table.concat(texts, ", ")
  end
end

-- The leaves of a system some time after its start.
local function ending(file, options)
  local cell, leaves = launched(file, options)
  cell:start()
  return leaves(), cell
end

local function refusal(...)
  local ok, problem = pcall(rfsm_rtt.launch_system, ...)
  assert.is_false(ok)
  return (problem:gsub("^%S+:%d+: ", ""):gsub("[^%s']*/tmp/[^%s':,]*", "FILE"))
end

describe("rfsm.rtt.launch_system", function()
  before_each(rtt_helper.reset)
  after_each(rtt_helper.reset)

  it("runs the mended examples to their ends", function()
    assert.equal("left parked, right parked, zone empty",
      (ending(FOLDER .. "zone/cell_mended.lua")))
    rtt_helper.reset()
    assert.equal("receiver full, sender sent",
      (ending(FOLDER .. "protocol/cell_mended.lua")))
    rtt_helper.reset()
    local cell, leaves = launched(FOLDER .. "stop/cell_mended.lua")
    local outside = rtt_helper.feed("supervisor.events_in")
    cell:start()
    leaves()
    outside:write("e_stop")
    assert.equal("arm halted, base halted, supervisor stopped", leaves())
    assert.same({ "arm", "base", "supervisor" }, cell.order)
  end)

  it("shows the defect of examples", function()
    assert.equal("left parked, right asking, zone free",
      (ending(FOLDER .. "zone/cell.lua")))
    rtt_helper.reset()
    assert.matches("^receiver %a+, sender half$", -- how far it comes, threads decide
      (ending(FOLDER .. "protocol/cell.lua")))
  end)

  it("has a connection for each wire, also two of data between one pair", function()
    local function told(wires)
      return (ending(written({ boss = teller("e_homed", "e_powered"),
        zoo = taker("e_homed") .. ", s2 = state {}, s3 = state {}, "
          .. "trans { src = 's1', tgt = 's2', events = { 'e_powered' } }, "
          .. "trans { src = 's0', tgt = 's3', events = { 'e_powered' } }, "
          .. "read = 'one'" }, wires)))
    end
    assert.equal("boss a, zoo s2", told("{ from = 'boss', event = 'e_homed', "
      .. "to = 'zoo', kind = 'data' }, { from = 'boss', event = 'e_powered', "
      .. "to = 'zoo', kind = 'data' }"))
    rtt_helper.reset()
    assert.equal("boss a, zoo s3", told("{ from = 'boss', events = { 'e_homed', "
      .. "'e_powered' }, to = 'zoo', kind = 'data' }"))
  end)

  it("sends events nowhere that no wire carries", function()
    assert.equal("arm s1, boss a, ui s2", (ending(written({
      boss = teller("e_progress", "e_progress", "e_none", "e_none", "e_halt"),
      arm = taker("e_halt"), ui = taker("e_progress", "e_progress") .. ", read = 'one'",
    }, "{ from = 'boss', event = 'e_progress', to = 'ui', size = 2 }, "
      .. "{ from = 'boss', event = 'e_halt', to = 'arm', size = 1 }"))))
  end)

  it("loses what is too much for a buffer", function()
    assert.equal("arm s2, boss a", (ending(written({ boss = teller("e", "e", "e"),
      arm = taker("e", "e", "e") .. ", read = 'one'" },
      "{ from = 'boss', event = 'e', to = 'arm', size = 2 }"), {
        machines = { arm = { after = { "boss" } } } })))
  end)

  it("loses nothing that comes before a machine runs", function()
    local file = written({ tx = teller("e_hello"), rx = taker("e_hello") },
      "{ from = 'tx', event = 'e_hello', to = 'rx' }")
    local leaves, cell = ending(file, { machines = { rx = { after = { "tx" } } } })
    assert.same({ "rx s1, tx a", { "tx", "rx" } }, { leaves, cell.order })
  end)

  it("keeps the order of a sender, one event an iteration", function()
    local file = written({ tx = teller("e_two", "e_one", "e_two"),
      rx = taker("e_two", "e_one", "e_two") .. ", read = 'one'" },
      "{ from = 'tx', events = { 'e_one', 'e_two' }, to = 'rx' }")
    assert.equal("rx s3, tx a", (ending(file)))
  end)

  it("reads one wire after the other, so that none is neglected", function()
    local file = written({ a = teller("e_x", "e_x", "e_x"), b = teller("e_y", "e_y"),
      rx = taker("e_x", "e_y", "e_x", "e_y", "e_x") .. ", read = 'one'" },
      "{ from = 'a', event = 'e_x', to = 'rx' }, "
        .. "{ from = 'b', event = 'e_y', to = 'rx' }")
    assert.equal("a a, b a, rx s5", (ending(file, {
      machines = { rx = { after = { "a", "b" } } } })))
  end)

  it("wakes a component for a time event, unless it has a period", function()
    local file = written({ a = taker("e_after(1)"), b = taker("e_after(0.5)") }, "")
    local cell, leaves = launched(file, { machines = { b = { period = 0.1 } } })
    cell:start()
    assert.equal("a s0, b s0", leaves())
    rtt_helper.advance(1.2)
    assert.equal("a s1, b s1", leaves())
    assert.same({ "a", "a_timer", "b" }, rtt_helper.loaded())
    cell:unload()
    assert.same({}, rtt_helper.loaded())
  end)

  it("takes events from outside behind those of wires", function()
    local file = written({ tx = teller("e_x"),
      rx = taker("e_x", "e_out") .. ", read = 'one'" },
      "{ from = 'tx', event = 'e_x', to = 'rx' }")
    local cell, leaves = launched(file)
    rtt_helper.feed("rx.events_in"):write("e_out")
    rtt_helper.feed("rx.wire1_in"):write("e_x") -- tx may begin after rx
    cell:start()
    assert.equal("rx s2, tx a", leaves())
  end)

  it("stops and starts, and launches in components that are there", function()
    local file = written({ tx = teller("e_x"), rx = taker("e_x") },
      "{ from = 'tx', event = 'e_x', to = 'rx' }")
    rtt_helper.load("rx")
    local leaves, cell = ending(file, { machines = { rx = { component = true } } })
    assert.equal("rx s1, tx a", leaves)
    cell:stop()
    assert.equal("Stopped", cell.components.rx:getState())
    cell:unload()
    assert.same({ "rx" }, rtt_helper.loaded())
    assert.same({}, rtt_helper.deployer():getPeer("rx"):getPortNames())
    cell = rfsm_rtt.launch_system(file, { machines = { rx = { component = true } } })
    cell:start()
    cell:unload()
    assert.same({ "rx" }, rtt_helper.loaded())
  end)

  it("stops and unloads the others if a component was unloaded", function()
    for _, options in ipairs { {}, { machines = { rx = { component = true } } } } do
      local file = written({ tx = teller("e_x"), rx = taker("e_x") },
        "{ from = 'tx', event = 'e_x', to = 'rx' }")
      if options.machines then rtt_helper.load("rx") end
      local cell = rfsm_rtt.launch_system(file, options)
      cell:start()
      cell.components.rx:stop()
      rtt_helper.deployer():getOperation("unloadComponent")("rx")
      cell:stop()
      assert.equal("Stopped", cell.components.tx:getState())
      assert.matches(":%d: 'rx' is not there, it was unloaded$",
        select(2, pcall(cell.start, cell)))
      assert.equal("Stopped", cell.components.tx:getState())
      cell:unload()
      assert.same({}, rtt_helper.loaded())
    end
  end)

  it("hands options that are tables to a component that is there", function()
    local file = written({ tx = teller("e_x"), rx = taker("e_x", "boss_e_out") },
      "{ from = 'tx', event = 'e_x', to = 'rx' }")
    rtt_helper.load("rx")
    local cell = rfsm_rtt.launch_system(file, { machines = { rx = { component = true,
      ports = { { "stop_in", prefix = "boss" } } } } })
    assert.truthy(match.has(cell.components.rx:getPortNames(), "stop_in"))
    cell:unload()
  end)

  it("reports all that is wrong at its line, and makes nothing", function()
    local data = [[a = state { entry = function(fsm) fsm.emit("e_held", { force = 3 })
      fsm.emit "e_x" end }, trans { src = 'initial', tgt = 'a' }]]
    local file = written({ arm = data, boss = taker("e_held", "e_x"),
      cam = "a = state {}, trans { src = 'initial', tgt = 'a' }, "
        .. "trans { src = 'a', tgt = 'a', events = { rfsm.named 'e_x' } }" },
      "{ from = 'arm', event = 'e_held', to = 'boss', size = 3e9 }, "
        .. "{ from = 'arm', event = 'e_x', to = 'cam' }")
    rtt_helper.load("cam")
    rtt_helper.load("plain", "OCL::HelloWorld")
    -- luacheck: push no max line length
    assert.equal([[
rfsm.rtt.launch_system: the system is not launched
  FILE: machines: no machine is named 'bos' (did you mean 'boss'?)
  FILE:3: arm: name: not an option here, it is the name of the machine
  FILE:3: arm: period: seconds expected, got string 'x'
  FILE:3: arm: samples: not an option here, it is the wires
  FILE:4: boss: component: the deployer has no component 'boss'
  FILE:5: cam: the deployer has a component 'cam' (component = true takes it)
  FILE:3: arm: after: no machine is named 'bos' (did you mean 'boss'?)
  FILE:4: boss: after: a cycle, boss after cam after boss
  FILE:6: wires[1].size: a policy of RTT has at most 2147483647, got 3000000000
  FILE:6: wires[1]: a string port carries no data, and 'arm' emits 'e_held' with data
  FILE:6: wires[2]: a string port carries no data, and 'cam' takes 'e_x' with data only]],
      refusal(file, { machines = { bos = {}, arm = { name = "x", samples = 3,
        period = "x", after = { "bos" } }, boss = { component = true,
        after = { "cam" } }, cam = { after = { "boss" } } } }))
    -- luacheck: pop
    assert.same({ "cam", "plain" }, rtt_helper.loaded())
  end)

  it("needs a file for each chart, which the system has not changed", function()
    local chart = helper.file_with("return require 'rfsm'.state { info = false, "
      .. "a = rfsm.state {}, rfsm.trans { src = 'initial', tgt = 'a' } }")
    local file = helper.file_with(([[
local system = require "rfsm.system"
local slow = system.load %q
slow.read = "one"
return system { slow = slow,
  here = require("rfsm").load %q,
  wires = {} }]]):format(chart, chart))
    assert.equal([[
rfsm.rtt.launch_system: the system is not launched
  FILE:5: here: its component loads the chart, expected system.load 'FILE'
  FILE:4: slow: the system has changed the chart of FILE, which its component loads]],
      refusal(file))
    assert.equal("rfsm.rtt.launch_system: file of a system expected, 'FILE' returns a "
      .. "chart", refusal(chart))
  end)

  it("leaves nothing half made", function()
    local file = written({ arm = taker("e_x"), boss = teller("e_x") },
      "{ from = 'boss', event = 'e_x', to = 'arm' }")
    assert.equal("rfsm.rtt.launch_system: FILE:4: boss: the deployer loads no 'boss' "
      .. "of type 'OCL::None', RTT's log has the reason",
      refusal(file, { machines = { boss = { luatype = "OCL::None" } } }))
    assert.same({}, rtt_helper.loaded())
    assert.matches("FILE:4: boss: launch of 'FILE': .*too late", refusal(file, {
      machines = { boss = { poststr = "error 'too late'" } } }))
    assert.same({}, rtt_helper.loaded())
    assert.equal("rfsm.rtt.launch_system: FILE:3: arm: unknown option 'timr' (did you "
      .. "mean 'timer'?), expected: ", refusal(file, { machines = {
        arm = { timr = true } } }):match("^.-expected: "))
    assert.same({}, rtt_helper.loaded())
    assert.equal("rfsm.rtt.launch_system: FILE:4: boss: the component is not "
      .. "configured, RTT's log has the reason", refusal(file, { machines = { boss = {
        prestr = "function configureHook() return false end" } } }))
    assert.same({}, rtt_helper.loaded())
    rtt_helper.load("boss", "OCL::HelloWorld")
    assert.equal("rfsm.rtt.launch_system: the system is not launched\n  FILE:4: boss: "
      .. "component: the deployer has no Lua component 'boss'",
      refusal(file, { machines = { boss = { component = true } } }))
    assert.same({ "boss" }, rtt_helper.loaded())
  end)

  it("keeps the ports of a component that is there, but not of another type", function()
    local file = written({ arm = taker("e_x"), boss = teller("e_x") },
      "{ from = 'boss', event = 'e_x', to = 'arm' }")
    local _, exec_str = rtt_helper.load("boss")
    exec_str("rtt.getTC():addPort(rtt.OutputPort.new('double', 'wire1_out'))")
    local problem = refusal(file, { machines = { boss = { component = true } } })
    assert.equal("rfsm.rtt.launch_system: FILE:4: boss: RTT's log has the reason",
      problem)
    assert.equal(1, #rtt_helper.logged("port 'wire1_out': output port of type string "
      .. "expected, got an output port of type double"))
    assert.same({ "boss" }, rtt_helper.loaded())
    assert.same({ "wire1_out" }, rtt_helper.deployer():getPeer("boss"):getPortNames())
  end)

  it("refuses other options, and needs a deployer", function()
    local file = FOLDER .. "zone/cell.lua"
    assert.equal("rfsm.rtt.launch_system: unknown option 'machine' (did you mean "
      .. "'machines'?), expected: deployer, machines", refusal(file, { machine = {} }))
    assert.equal("rfsm.rtt.launch_system: deployer: a deployer or the name of a peer "
      .. "expected, got string 'Nobody'", refusal(file, { deployer = "Nobody" }))
  end)
end)

describe("the ports of a launched system", function()
  local ports = require "rfsm.rtt.launch_system_ports"

  before_each(rtt_helper.reset)
  after_each(function()
    rawset(_G, "fsm", nil)
    rtt_helper.reset()
  end)

  local rtt = rtt_helper.rtt

  -- Makes a port of this program. Returns an object that is read as the port, after a
  -- call of its field `before`: so another thread writes in between.
  local function input(name)
    local real, port = rtt.InputPort.new("string", name), {}
    rtt.getTC():addPort(real)
    function port.info() return real:info() end
    function port.read(_, ...)
      if port.before then port.before() end
      return real:read(...)
    end
    return port
  end

  -- A machine of this Lua with wires 1 and 2; returns it, the ports from which these
  -- are read, and functions that write to them.
  local function joined(read, kind)
    local fsm = helper.init(rfsm.state { info = false, warn = function() end,
      read = read, a = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" } })
    rawset(_G, "fsm", fsm)
    local incoming, into, out, of = {}, {}, {}, {}
    for i = 1, 2 do
      local name = "wire" .. i .. "_in"
      incoming[i] = { port = name, desc = "", kind = kind or "buffer", size = 4 }
      into[i] = input(name)
      out[i], of[name] = rtt_helper.feed("lua." .. name), into[i]
    end
    local component = { getPort = function(_, name) return of[name] end,
      hasOperation = function() return false end }
    helper.with(rtt, { getTC = function() return component end }, function()
      ports.join({}, incoming)
    end)
    return fsm, into, out
  end

  -- Has `f` called before the first read of a port.
  local function before_read(port, f)
    function port.before()
      port.before = nil
      f()
    end
  end

  it("are read at one moment", function()
    local fsm, into, out = joined()
    before_read(into[2], function()
      out[1]:write("e_first")
      out[2]:write("e_second")
    end)
    assert.same({ "e_first", "e_second" }, fsm.getevents())
    assert.same({}, fsm.getevents())
  end)

  it("have the newest sample of data", function()
    local fsm, into, out = joined(nil, "data")
    out[1]:write("e_old")
    before_read(into[2], function() out[1]:write("e_new") end)
    assert.same({ "e_new" }, fsm.getevents())
  end)

  it("are not read for ever, and a warning says so", function()
    local fsm, into, out = joined()
    local texts = {}
    fsm.warn = function(text) texts[#texts + 1] = text end
    into[2].before = function() out[1]:write("e_x") end
    out[1]:write("e_x")
    assert.equal(64, #fsm.getevents())
    fsm.getevents()
    assert.same({ "WARNING: events come faster than all ports are read" }, texts)
  end)

  it("are not read while an event waits in a machine that takes one", function()
    local fsm, _, out = joined("one")
    rfsm.run(fsm)
    out[1]:write("e_x")
    rfsm.send_events(fsm, "e_own")
    assert.same({}, fsm.getevents())
    rfsm.run(fsm)
    out[1]:write("e_y")
    out[2]:write("e_z")
    assert.same({ { "e_z" } }, { { fsm.getevents()[1] } })
    assert.same({ "e_y" }, fsm.getevents())
    assert.same({}, fsm.getevents())
  end)

  it("carry an event without its data, with one warning", function()
    local fsm, texts = helper.init(rfsm.state { info = false, a = rfsm.state {},
      rfsm.trans { src = "initial", tgt = "a" } }), {}
    fsm.warn = function(text) texts[#texts + 1] = text end
    rawset(_G, "fsm", fsm)
    ports.join({ { port = "wire1_out", desc = "", events = { "e_x" } } }, {})
    local into = rtt_helper.listen("lua.wire1_out")
    for _ = 1, 2 do fsm.emit("e_x", 7) end
    fsm.emit("e_y", 7)
    assert.same({ "NewData", "e_x" }, { into:read() })
    assert.same({ "WARNING: a string port carries 'e_x' without its data" }, texts)
  end)
end)
