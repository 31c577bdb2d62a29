-- Prints how many KiB a module or a chart adds to the live heap when it is loaded.
-- `rfsm size` runs this program in a new Lua process:
--
--   LUA measure.lua source|stripped PATH module NAME
--   LUA measure.lua source|stripped PATH chart FILE [stub]

local form, path, kind, name, has_stubs = ...
if form ~= "source" and form ~= "stripped" then return {} end -- it is required

local version = _VERSION:match("[%d.]+$")
local execute, loadfile = os.execute, loadfile -- charts may get stubs for them later

package.path = path

-- In Lua 5.1 and 5.2 string.dump strips nothing, but luac does.
local function load_stripped(file)
  if rawget(_G, "jit") or version > "5.2" then
    local text = string.dump(assert(loadfile(file)), true)
    return assert((rawget(_G, "loadstring") or load)(text, "=?"))
  end
  local output = os.tmpname()
  execute(("luac%s -s -o '%s' '%s'"):format(version, output, file))
  local chunk = assert(loadfile(output))
  os.remove(output)
  return chunk
end

local function search(module)
  for template in package.path:gmatch("[^;]+") do
    local file = template:gsub("%?", (module:gsub("%.", "/")))
    local handle = file:find("%.lua$") and io.open(file)
    if handle then
      handle:close()
      return load_stripped(file)
    end
  end
end

if form == "stripped" then
  local searchers = rawget(package, "searchers") or rawget(package, "loaders")
  table.insert(searchers, 2, search)
end

local jit = rawget(_G, "jit")
if jit then jit.off() end -- traces come and go

local function kib()
  collectgarbage()
  collectgarbage()
  return collectgarbage("count")
end

local before = kib()

local function report(what)
  local now = kib()
  -- below 0 if the table of LuaJIT's texts has become smaller meanwhile
  print(("%s %.1f"):format(what, math.max(now - before, 0)))
  before = now
end

local rfsm = require "rfsm"
rfsm.save_memory() -- as rfsm.rtt does in a pool
require "rfsm.rtt"

if kind == "module" then
  before = kib()
  require(name)
  return report("module")
end

report("library")

local function fail(problem)
  print("problem " .. problem)
  os.exit(0)
end

-- Returns the model as tools load it: the file may be a program that makes machines,
-- and stubs may replace missing modules. Modules that only tools load, or `init` for
-- its warnings, are loaded first, so they are not measured.
local function load_as_tools()
  local chart = require "rfsm.shared.chart"
  for _, tool in ipairs { "rfsm.advice", "rfsmpp", "rfsm.monitor" } do require(tool) end
  before = kib()
  local model, problem = chart.load(name, has_stubs == "stub")
  return model or fail(problem)
end

-- Loads the model as `rfsm.rtt` does at a launch. If this fails, loads it as tools do.
local function load_model()
  if has_stubs then return load_as_tools() end
  local limit = require "rfsm.shared.limit"
  before = kib()
  local ok, model, is_late = limit.load(rfsm.load, name, { os.time })
  if is_late then fail(model) end
  return ok and model or load_as_tools()
end

-- Makes the machine and prints the number of its states and transitions. Returns the
-- KiB that the model, the machine and the modules of the chart take.
local function make_machine()
  local model = load_model()
  model.err, model.warn, model.info, model.dbg = false, false, false, false
  local fsm, _, problems = rfsm.init(model)
  if not fsm then fail(require("rfsm.shared.chart").line(name, problems[1])) end
  rfsm.prepare(fsm)
  require("rfsm.rtt").forget_modules() -- as a launch does
  print("states " .. #rfsm.elements(fsm, rfsm.is_state) - 1)
  print("transitions " .. #rfsm.elements(fsm, rfsm.is_trans))
  return kib() - before
end

local all = make_machine()
local modules = math.max(kib() - before, 0) -- they stay when the machine is garbage
print("modules " .. rfsm.number_text(modules, "%.1f"))
print("chart " .. rfsm.number_text(all - modules, "%.1f"))
