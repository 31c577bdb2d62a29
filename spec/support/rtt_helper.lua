-- What the specs of RTT share: ports that are connected, charts as files, what was
-- logged, and the stand-in for RTT as the module `rtt`.

local helper = require "spec.helper"
local rtt = require "spec.support.rtt"

package.loaded.rtt = rtt

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local standin = rtt.standin

local rtt_helper = {}

local BUFFER = 1

-- A ConnPolicy: a buffer, into which the last sample written before is put.
function rtt_helper.policy(size, kind)
  local cp = rtt.Variable("ConnPolicy")
  cp.type, cp.size, cp.init = kind or BUFFER, size, true
  return cp
end

-- An input port and the output port that feeds it, through a buffer.
function rtt_helper.connected(kind, size)
  local into, out = rtt.InputPort(kind, "into"), rtt.OutputPort(kind, "out")
  assert(out:connect(into, rtt_helper.policy(size or 16)))
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

-- Text of the error that f raises, which must blame its caller: this file.
function rtt_helper.refusal(f, ...)
  local arguments, n = { ... }, select("#", ...)
  local ok, problem = pcall(function() f(unpack(arguments, 1, n)) end)
  if ok then return "accepted" end
  local text = tostring(problem):match("^[^:\n]*rtt_helper%.lua:%d+: (.*)$")
  return text or "blames another: " .. tostring(problem)
end

-- How many Variables a call makes.
function rtt_helper.counting_variables(f)
  local before = standin.variables
  f()
  return standin.variables - before
end

-- A sample of a type that Lua has none for.
function rtt_helper.pose(x, y)
  local var = rtt.Variable("Pose")
  var.x, var.y = x, y
  return var
end

rtt_helper.file_with = helper.file_with

-- Before each spec: a fresh process, and no file of the one before.
function rtt_helper.reset()
  standin.reset()
  standin.add_type("Pose", { x = "double", y = "double" })
  helper.remove_files()
end

-- The file of a chart, with more fields of the root:
-- (initial) -> a --e_go--> b --e_back--> a
function rtt_helper.chart_file(fields)
  return rtt_helper.file_with([[
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

-- Lines of the log that hold `text`.
function rtt_helper.logged(text)
  local lines = {}
  for _, line in ipairs(standin.log) do
    if line:find(text, 1, true) then lines[#lines + 1] = line end
  end
  return lines
end

-- Connects ports to those of a component: what to write to, what to read from.
function rtt_helper.wire(component, events_name)
  local events, names = rtt.OutputPort("string"), rtt.InputPort("string")
  local cp = rtt_helper.policy(16)
  if events_name ~= false then
    assert(events:connect(component:getPort(events_name or "rFSM_events"), cp))
  end
  assert(names:connect(component:getPort("rFSM_cur_fqn"), cp))
  return events, names
end

-- A value of another Lua, as text: what its print says.
function rtt_helper.evaluate(exec_str, expression)
  local lines = helper.printed(function()
    exec_str("print(" .. expression .. ")")
  end)
  return lines[1]
end

return rtt_helper
