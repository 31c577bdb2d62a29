-- What the specs of RTT share. They run on the stand-in in spec/support/rtt.lua. In a
-- rttlua (busted is a Lua program) they run on the real RTT.

local helper = require "spec.helper"

local real = rawget(_G, "rtt")
local rtt = real or require "spec.support.rtt"

package.loaded.rtt = rtt

local standin = rtt.standin

local rtt_helper = { rtt = rtt, is_standin = standin ~= nil }

local Variable = rtt.Variable.new

-- The process: time, the log, what is made and unmade -----------------------------

-- Gives the threads of the components the time to act.
function rtt_helper.spin()
  if standin then standin.spin() else rtt.sleep(0, 40e6) end
end

-- Lets time pass.
function rtt_helper.advance(seconds)
  rtt.sleep(math.floor(seconds), seconds % 1 * 1e9)
end

-- Lets time pass until an answer is true, for at most ten seconds.
function rtt_helper.wait_until(ask)
  for _ = 1, 1000 do
    if ask() then return end
    rtt_helper.advance(0.01)
  end
  error("the answer was never true", 2)
end

local LOG = "orocos.log" -- the real one writes it where it was started
local LEVELS = { ERROR = "Error", Warning = "Warning", Info = "Info" }
local log_start = 0

local function log_text()
  local file = io.open(LOG)
  local text = file and file:read("*a") or ""
  if file then file:close() end
  return text
end

-- The log since the last reset, as lines "Level: text".
local function log_lines()
  if standin then return standin.log end
  local lines = {}
  for line in log_text():sub(log_start + 1):gmatch("[^\n]+") do
    local level, text = line:match("%[%s*(%a+)%s*%]%[.-%] (.*)")
    lines[#lines + 1] = level and LEVELS[level] and LEVELS[level] .. ": " .. text
  end
  return lines
end

-- Lines of the log that hold `text`.
function rtt_helper.logged(text)
  local lines = {}
  for _, line in ipairs(log_lines()) do
    if line:find(text, 1, true) then lines[#lines + 1] = line end
  end
  return lines
end

function rtt_helper.deployer() return rtt.getTC():getPeer("Deployer") end

-- Calls an operation of the deployer.
function rtt_helper.deploy(name, ...)
  return rtt_helper.deployer():getOperation(name)(...)
end

-- Loads a component; returns it, and its operation exec_str if it has one.
function rtt_helper.load(name, kind)
  assert(rtt_helper.deploy("loadComponent", name, kind or "OCL::LuaComponent"))
  local component = rtt_helper.deployer():getPeer(name)
  return component, component:hasOperation("exec_str")
    and component:getOperation("exec_str")
end

-- Names of the components that the deployer has loaded.
function rtt_helper.loaded()
  local names = {}
  for _, name in ipairs(rtt_helper.deployer():getPeers()) do
    if name ~= "lua" then names[#names + 1] = name end
  end
  return names
end

-- Before and after each spec: as in a fresh process, and no file of the one before.
function rtt_helper.reset()
  if standin then
    local death = standin.death
    standin.reset()
    assert(not death, death)
  else
    for _, name in ipairs(rtt_helper.loaded()) do
      rtt_helper.deployer():getPeer(name):stop()
      assert(rtt_helper.deploy("unloadComponent", name))
    end
    for _, name in ipairs(rtt.getTC():getPortNames()) do
      local port = rtt.getTC():getPort(name)
      rtt.getTC():removePort(name)
      port:delete()
    end
    log_start = #log_text()
  end
  helper.remove_files()
end

-- Ports and Variables ------------------------------------------------------------

-- A ConnPolicy: a buffer (1), into which the last sample written before is put. Also a
-- sample of a type that Lua has none for, with members.
function rtt_helper.policy(size, kind)
  local cp = Variable("ConnPolicy")
  cp.type, cp.size, cp.init = kind or 1, size, true
  return cp
end

local port_count = 0

-- Makes a port of this program's component; returns it and its path.
local function new_port(direction, kind)
  port_count = port_count + 1
  local port = rtt[direction].new(kind or "string", "port" .. port_count)
  rtt.getTC():addPort(port)
  return port, "lua.port" .. port_count
end

function rtt_helper.input(kind) return new_port("InputPort", kind) end

function rtt_helper.output(kind) return new_port("OutputPort", kind) end

local function connect(from, to, policy)
  assert(rtt_helper.deploy("connect", from, to, policy or rtt_helper.policy(64)))
end

-- Makes an input port that reads what "component.port" writes, through a buffer.
function rtt_helper.listen(path)
  local into, name = rtt_helper.input()
  connect(path, name)
  return into
end

-- Makes an output port that writes to "component.port", through a buffer.
function rtt_helper.feed(path, size)
  local out, name = rtt_helper.output()
  connect(name, path, size and rtt_helper.policy(size))
  return out
end

-- An input port and the output port that feeds it.
function rtt_helper.connected(kind, policy)
  local into, to = rtt_helper.input(kind)
  local out, from = rtt_helper.output(kind)
  connect(from, to, policy)
  return into, out
end

-- Writes each argument.
function rtt_helper.write_all(port, ...)
  for i = 1, select("#", ...) do port:write((select(i, ...))) end
end

-- The new samples of a port.
function rtt_helper.samples(port)
  local values = {}
  local status, value = port:read()
  while status == "NewData" do
    values[#values + 1] = value
    status, value = port:read()
  end
  return values
end

-- The leaves that came from a port, such as "<none> a b".
function rtt_helper.leaves(port)
  return (table.concat(rtt_helper.samples(port), " "):gsub("root%.", ""))
end

-- How many Variables a call makes.
function rtt_helper.counting_variables(f)
  local count = 0
  helper.with(rtt.Variable, { new = function(...)
    count = count + 1
    return Variable(...)
  end }, f)
  return count
end

-- Charts and calls ------------------------------------------------------------------

-- The file of a chart, with more fields of the root:
-- (initial) -> a --e_go--> b --e_back--> a
function rtt_helper.chart_file(fields)
  return helper.file_with([[
local rfsm = require "rfsm"
return rfsm.state {
  ]] .. (fields or "") .. [[
  a = rfsm.state {}, b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_go" } },
  rfsm.trans { src = "b", tgt = "a", events = { "e_back" } },
}
]])
end

-- Values of another Lua, as text with blanks between.
function rtt_helper.evaluate(exec_str, expressions)
  local name = helper.file_with("")
  assert(exec_str(([[
local function texts(...)
  local list = { ... }
  for i = 1, select("#", ...) do list[i] = tostring(list[i]) end
  return list
end
local file = assert(io.open(%q, "w"))
file:write(table.concat(texts(%s), " "))
file:close()]]):format(name, expressions)))
  return helper.content(name)
end

return rtt_helper
