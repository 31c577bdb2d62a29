-- Modules without debug information, which `make install` makes for robots: a launch in
-- a pool, or with `stripped = true`. On the stand-in in spec/support/rtt.lua.

local helper = require "spec.helper"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local function lines_of(command)
  local pipe, lines = io.popen(command .. " 2>&1"), {}
  for line in pipe:lines() do lines[#lines + 1] = line end
  pipe:close()
  return lines
end

-- Prints from which source the library is, and fails in a callback of the chart.
local CHART = [[
local rfsm = require "rfsm"
return rfsm.state { info = false, a = rfsm.state { entry = function(fsm)
  print((debug.getinfo(rfsm.step, "S").source:match("[^/]*$")))
  rfsm.gen_nothing(fsm)
end }, rfsm.trans { src = "initial", tgt = "a" } }
]]

-- The deployer's program: `launch(fields)` launches the chart in a component, `show`
-- has its machine entered, and prints the errors in the log.
local PROGRAM = [[
package.path = %q .. "/?.lua;./?.lua"
local FOLDER, CHART = %q, %q
rtt = require "spec.support.rtt"
package.loaded.rtt = rtt
local deployer = rtt.getTC():getPeer("Deployer")
local function launch(fields)
  local launched = require("rfsm.rtt").component_launch_rfsm
  fields.name, fields.fsmfile, fields.deployer = "arm", CHART, deployer
  return select(2, pcall(launched, fields))
end
local function component(kind)
  deployer:getOperation("loadComponent")("arm", kind or "OCL::LuaComponent")
  return deployer:getPeer("arm")
end
local function show(arm)
  arm:getOperation("exec_str")("trigger()")
  for _, line in ipairs(rtt.standin.log) do
    if line:find("^Error") then print((line:gsub(CHART, "CHART"))) end
  end
end
%s]]

-- The program of a component of its own whose launch has this option `stripped`. It
-- prints whether the component is configured, or why it is not.
local function own_launch(kind, stripped)
  return (([[
local arm = component(KIND)
local exec_str = arm:getOperation("exec_str")
exec_str(("function configureHook() return require('rfsm.rtt').launch { fsmfile = %q, "
  .. "stripped = STRIPPED } end"):format(CHART))
print(arm:configure() or rtt.standin.log[#rtt.standin.log]:match("stripped: .*"))]])
    :gsub("KIND", kind):gsub("STRIPPED", stripped))
end

describe("stripped modules", function()
  local folder

  setup(function()
    local name = os.tmpname()
    os.remove(name)
    if not lines_of("command -v luac5.1 && command -v lua5.1")[2] then return end
    folder = name .. "/share/lua/5.1"
    lines_of(("make -s install PREFIX=%s LUADIRS=%s"):format(name, folder))
  end)

  teardown(function()
    if folder then os.execute("rm -rf " .. folder:match("^(.*)/share/")) end
  end)
  after_each(helper.remove_files)

  -- The lines that a program of the deployer prints, nil without a Lua 5.1.
  local function printed(program, path, text_of_chart)
    if not folder then return nil end
    local chart = helper.file_with(text_of_chart or CHART)
    local text = PROGRAM:format(path or folder, folder, chart, program)
    return lines_of("lua5.1 " .. helper.file_with(text))
  end

  local FAILED = "Error: ENTRY error executing entry of root.a:  CHART:4: attempt to "
    .. "call field 'gen_nothing' (a nil value)"

  local function check(expected, program, path)
    local lines = printed(program, path)
    if lines then assert.same(expected, lines) end
  end

  it("are those of a launch that asks for them; lines of the chart stay", function()
    check({ "=?", FAILED }, "show(launch { stripped = true })")
    check({ "rfsm.lua", FAILED }, "show(launch {})")
  end)

  it("are those of a service, and of program.lua", function()
    check({ "=?", FAILED }, [[
local arm = component()
deployer:getOperation("loadService")("arm", "Lua")
local exec_str = arm:provides("Lua"):getOperation("exec_str")
require("rfsm.rtt").service_launch_rfsm(CHART, exec_str, false, nil,
  { stripped = true })
exec_str("trigger()")
show { getOperation = function() return exec_str end }]])
    check({ "=?", FAILED }, [[
local arm = component()
arm:getProperty("lua_file"):set(FOLDER .. "/rfsm/rtt/program.lua")
arm:getProperty("lua_string"):set(("rfsm_launch = { fsmfile = %q, stripped = true }")
  :format(CHART))
arm:configure()
show(arm)]])
  end)

  it("are those of a pool, unless the launch or the program refuses them", function()
    local POOL = "luatype = 'OCL::LuaTLSFComponent', "
    check({ "=?", FAILED, "stripped" }, ("show(launch { %s })\n%s"):format(POOL,
      "print(table.concat(rtt.standin.log):match('fast, (stripped)'))"))
    for _, field in ipairs { "stripped = false", "env = { RFSM_STRIPPED = false }" } do
      check({ "rfsm.lua", FAILED }, ("show(launch { %s%s })"):format(POOL, field))
    end
    for _, case in ipairs { { "", "=?" }, { "stripped = false", "rfsm.lua" } } do
      check({ case[2], FAILED }, ([[
local arm = component "OCL::LuaTLSFComponent"
arm:getProperty("lua_file"):set(FOLDER .. "/rfsm/rtt/program.lua")
arm:getProperty("lua_string"):set(("rfsm_launch = { fsmfile = %%q, %s }"):format(CHART))
arm:configure()
show(arm)]]):format(case[1]))
    end
  end)

  it("say file and line of a mistake in a chart, as the source does", function()
    local lines = printed([[
for _, is_stripped in ipairs { true, false } do
  local text = launch { stripped = is_stripped }
  print((text:gsub("^[^:]*:%d+: ", ""):gsub(CHART, "CHART")))
end]], nil, [[
local rfsm = require "rfsm"
return rfsm.state {
  a = rfsm.state { entry = 3 },
  rfsm.trans { src = "initial",
    tgt = "b" } }]])
    if not lines then return end
    assert.same({ unpack(lines, 4) }, { unpack(lines, 1, 3) })
    assert.matches("^  CHART:3: root%.a%.entry: function expected, got", lines[2])
    assert.matches("^  CHART:4: root%.trans%[1%] %(initial %-> b%): tgt", lines[3])
  end)

  it("are refused by a component of its own that has them already", function()
    check({ "stripped: the library has been loaded without debug information "
      .. "(RFSM_STRIPPED = false before that)" },
      own_launch('"OCL::LuaTLSFComponent"', "false"))
  end)

  it("launch from a pool with the library of that pool", function()
    check({ "=?", "true" }, [[
RFSM_STRIPPED = true
local rfsm_rtt = require "rfsm.rtt"
local arm = launch {}
local exec_str = arm:getOperation("exec_str")
print(debug.getinfo(rfsm_rtt.launch, "S").source)
exec_str("print(package.path:sub(1, " .. #FOLDER .. ") == '" .. FOLDER .. "')")]])
  end)

  local NONE = "stripped: no modules in rfsm/stripped beside the library, or it was "
    .. "loaded before from source"

  it("are missed in a checkout, or if the library is loaded already", function()
    check({ NONE, "nil" }, ([[
local why = launch { stripped = true }
print(why:match("stripped: .*"))
print(deployer.peers.arm)]]), ".")
    check({ NONE }, own_launch("", "true"))
  end)

  it("are removed by make uninstall, and not made with STRIP=0", function()
    if not folder then return end
    local prefix = folder:match("^(.*)/share/")
    local function stripped()
      return lines_of(("test -e %s/rfsm/stripped && echo yes"):format(folder))[1]
    end
    assert.equal("yes", stripped())
    lines_of(("make -s uninstall PREFIX=%s LUADIRS=%s"):format(prefix, folder))
    assert.is_nil(stripped())
    lines_of(("make -s install STRIP=0 PREFIX=%s LUADIRS=%s"):format(prefix, folder))
    assert.is_nil(stripped())
  end)
end)
