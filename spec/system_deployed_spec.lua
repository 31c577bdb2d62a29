-- rfsm check --deployed: what a deployment by hand does not do as its system says.

local commands = require "spec.support.commands"
local deployments = require "rfsm.rtt.launch_system_files"
local helper = require "spec.helper"

local written = {}

-- Writes a file with this ending; returns its name.
local function file_with(text, ending)
  local name = helper.file_with("") .. ending
  written[#written + 1] = name
  helper.write(name, text)
  return name
end

-- A system: boss tells arm by one or two wires, and ui.
local function system_file(wires)
  return file_with(([[
local rfsm, system = require "rfsm", require "rfsm.system"
local function taker(...)
  return rfsm.state { info = false, warn = false, a = rfsm.state { final = true },
    rfsm.trans { src = "initial", tgt = "a" },
    rfsm.trans { src = "a", tgt = "a", events = { ... } } }
end
local function tell(fsm) fsm.emit "e_on" fsm.emit "e_halt" fsm.emit "e_shown" end
return system {
  boss = rfsm.state { info = false, a = rfsm.state { final = true, entry = tell },
    rfsm.trans { src = "initial", tgt = "a" } },
  arm = taker("e_on", "e_halt"), ui = taker("e_shown"),
  wires = { %s },
}]]):format(wires), ".lua")
end

local TWO = [[{ from = "boss", event = "e_on", to = "arm", kind = "data" },
  { from = "boss", event = "e_halt", to = "arm", size = 4 }, ]]
local ONE = [[{ from = "boss", events = { "e_on", "e_halt" }, to = "arm", size = 4 }, ]]
local UI = [[{ from = "boss", event = "e_shown", to = "ui", size = 4 } ]]

-- The findings of `rfsm check --static --deployed`, without the names of files.
local function found(wires, deployed, ending)
  local file = file_with(deployed, ending)
  local out = commands.run(("check --static --deployed %s %s"):format(file,
    system_file(wires)))
  return (out:gsub("%S*/tmp/[%w_]+", "FILE"):gsub(" %(launch the system[^\n]*", ""))
end

local OPS = [[
import("ocl")
loadComponent("boss", "OCL::LuaComponent")
loadComponent("arm", "OCL::LuaComponent")
loadComponent("ui", "OCL::LuaComponent")
boss.exec_str("require('rfsm.rtt').launch { fsmfile = 'boss.lua', ev_outport = true }")
arm.lua_string = "rfsm_launch = { fsmfile = 'arm.lua', enter = 'start' }"
var ConnPolicy p
p.type = BUFFER
p.size = 4
# connect("boss.events_out", "nobody.events_in", p)
connect("boss.events_out", "arm.events_in", p) // not ui
]]

describe("rfsm check --deployed", function()
  after_each(function()
    for _, name in ipairs(written) do os.remove(name) end
    written = {}
    helper.remove_files()
  end)

  -- luacheck: push no max line length
  it("names wires that share a connection, foreign events and late entries", function()
    assert.equal([[
FILE.ops:2: warning: boss: it is entered in its first update, and loses what comes before that
FILE.ops:4: warning: ui: it is entered in its first update, and loses what comes before that
FILE.ops:11: warning: wires[1], wires[2]: they share boss.events_out -> arm.events_in, so they are one queue
FILE.ops:11: warning: boss.events_out -> arm.events_in: 'e_shown' goes to 'arm', and no wire carries it
FILE.ops:2: warning: wires[3]: no connection leads from 'boss' to 'ui'
]], found(TWO .. UI, OPS, ".ops"))
  end)

  it("names policies that are others, and connections that are double", function()
    local ops = OPS:gsub("// not ui", "\np.type = DATA\n"
      .. "connect(\"boss.events_out\", \"ui.events_in\", p)\n"
      .. "ui.lua_string = \"rfsm_launch = { enter = 'start', fsmfile = 'ui.lua' }\"\n"
      .. "boss.exec_str(\"x = { enter = 'start' }\")")
    assert.equal([[
FILE.ops:11: warning: boss.events_out -> arm.events_in: 'e_shown' goes to 'arm', and no wire carries it
FILE.ops:13: warning: wires[2]: boss.events_out -> ui.events_in is data, not buffer of 4
FILE.ops:13: warning: boss.events_out -> ui.events_in: 'e_on' goes to 'ui', and no wire carries it
FILE.ops:13: warning: boss.events_out -> ui.events_in: 'e_halt' goes to 'ui', and no wire carries it
]], found(ONE .. UI, ops, ".ops"))
    assert.matches("boss.events_out %-> arm.events_in: with boss.events_out %-> "
      .. "arm.events_in each event comes twice", found(ONE .. UI, ops
      .. "\nconnect(\"boss.events_out\", \"arm.events_in\", p)", ".ops"))
  end)

  it("reads XML", function()
    if not pcall(require, "lxp") then return pending("lua-expat is missing") end
    local function component(name, port, connection, launch)
      return ([[<struct name="%s" type="OCL::LuaComponent">
  <struct name="Properties" type="PropertyBag">
    <simple name="lua_string" type="string"><value>rfsm_launch = { %s }</value></simple>
  </struct>
  <struct name="Ports" type="PropertyBag"><simple name="%s" type="string"><value>%s]]
  .. [[</value></simple></struct>
</struct>
]]):format(name, launch, port, connection)
    end
    assert.equal([[
FILE.xml:7: warning: arm: it is entered in its first update, and loses what comes before that
FILE.xml:1: warning: wires[1]: boss.told -> arm.events_in is buffer of 8, not buffer of 4
FILE.xml:1: warning: boss.told -> arm.events_in: 'e_shown' goes to 'arm', and no wire carries it
]], found(ONE, "<properties>" .. component("boss", "told", "c", "enter = &quot;start&quot;, ev_outport = "
      .. "'told'") .. component("arm", "events_in", "c", "") .. "<!-- "
      .. component("cam", "events_in", "c", "") .. " -->"
      .. component("ui", "x", "d", "enter = 'start'") .. [[
<struct name="c" type="ConnPolicy"><simple name="type" type="short"><value>1</value>
</simple><simple name="size" type="short"><value>8</value></simple></struct>
</properties>]], ".xml"))
    local file = file_with("<properties>\n</struct>", ".xml")
    local ok, problem = pcall(deployments.read, file)
    assert.same({ false, file .. ":2: mismatched tag" }, { ok, problem })
  end)

  it("names the package that it needs for XML", function()
    local file = file_with("<properties/>", ".xml")
    assert.equal("rfsm check --deployed: the package luaexpat is missing (on Debian: "
      .. "apt-get install lua-expat)", helper.with(package.preload, { lxp = error },
      function()
        return helper.with(package.loaded, { lxp = false }, function()
          return select(2, pcall(deployments.read, file))
        end)
      end))
  end)

  it("reads a table, and has nothing to say of a deployment that is right", function()
    assert.equal("FILE.lua: ok\n", found(TWO .. UI, [[
return { components = { boss = { enter = "start" }, arm = { enter = "start" },
    ui = { enter = "start" } },
  connections = { { from = "boss.on", to = "arm.on", kind = "data" },
    { from = "boss.halt", to = "arm.halt", size = 4 },
    { from = "boss.shown", to = "ui.shown", kind = "buffer", size = 4 } } }]], ".lua"))
    assert.equal([[
FILE.lua:1: warning: arm: no component has this name
FILE.lua:1: warning: boss: no component has this name
FILE.lua:1: warning: ui: no component has this name
FILE.lua:1: warning: wires[1]: no connection leads from 'boss' to 'arm'
]], found(ONE, "return { components = {}, connections = {} }", ".lua"))
  end)
  -- luacheck: pop

  it("follows a file that a component executes", function()
    local launch = file_with("rfsm_launch = { fsmfile = 'x', enter = 'start' }", ".lua")
    local deployed = deployments.read(file_with(("loadComponent(\"a\", \"X\")\n"
      .. "a.exec_file(\"%s\")"):format(launch), ".ops"))
    assert.is_true(deployed.components.a.enters_at_start)
  end)

  it("says what is wrong with the file, and is for systems", function()
    local function said(file, chart)
      local out, err = commands.run("check --static --deployed " .. file .. " "
        .. (chart or system_file(ONE)))
      return ((out .. err):gsub("%S*/tmp/[%w_]+", "FILE"))
    end
    assert.equal("FILE.lua: FILE.txt: a file .xml, .cpf, .ops or .lua expected\n",
      said(file_with("", ".txt")))
    assert.matches("none.ops: No such file", said "none.ops")
    assert.equal("FILE.lua: FILE.lua: table with components and connections "
      .. "expected, got 5\n", said(file_with("return 5", ".lua")))
    assert.matches("%-%-deployed is for a system, not for a chart",
      said("none.ops", "examples/systems/stop/arm.lua"))
  end)
end)
