-- How long an update takes: a machine of 20 states, each with a timer, in a component
-- of Orocos RTT at 1 kHz. Mean, slowest, a histogram, memory.
--
--   rttlua bench/rtt.lua
--
-- SECONDS (60), STATES (20) and TYPE (OCL::LuaTLSFComponent) are settings. STRIPPED=1
-- or 0 takes or refuses the modules without debug information, POOL more KiB. The
-- thread has a real-time priority if the process may have one. All that is used the
-- original has, too: it is measured if its folder is on LUA_PATH.

-- A component loads this file as its chart: a ring of states, 10 ms in each.
local function new_chart(n)
  local rfsm = require "rfsm"
  local root = { info = false, warn = false,
    rfsm.trans { src = "initial", tgt = "s1" } }
  for i = 1, n do
    root["s" .. i] = rfsm.state {}
    root[#root + 1] = rfsm.trans { src = "s" .. i, tgt = "s" .. i % n + 1,
      events = { "e_after(0.01)" } }
  end
  return rfsm.state(root)
end

local states = rawget(_G, "BENCH_STATES")
if states then return new_chart(states) end

local rtt = rawget(_G, "rtt")
if not rtt then
  io.stderr:write("bench/rtt.lua: RTT expected: rttlua bench/rtt.lua\n")
  os.exit(1)
end

local seconds = tonumber(os.getenv("SECONDS") or 60)
local kind = os.getenv("TYPE") or "OCL::LuaTLSFComponent"

-- Both kinds of clock hooks that there are understand nanoseconds in one number.
local BEFORE = ("BENCH_STATES = %d "):format(os.getenv("STATES") or 20) .. [[
require("rfsm.timeevent").set_gettime_hook(function()
  local s, ns = rtt.getTime()
  return s * 1e9 + ns
end)]]

-- Measures each update. The first 10,000 are counted apart from the later ones.
local AFTER = [[
local edges = { 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, math.huge }
local first, later, gettime, inner, count = {}, {}, rtt.getTime, updateHook, 0
for i = 1, #edges do first[i], later[i] = 0, 0 end
for _, list in ipairs { first, later } do list.sum, list.slowest, list.at = 0, 0, 0 end
function updateHook()
  local s, ns = gettime()
  inner()
  local s2, ns2 = gettime()
  local us, list = (s2 - s) * 1e6 + (ns2 - ns) / 1e3, count < 10000 and first or later
  count, list.sum = count + 1, list.sum + us
  if us > list.slowest then list.slowest, list.at = us, count end
  for i = 1, #edges do
    if us <= edges[i] then
      list[i] = list[i] + 1
      break
    end
  end
end
function print_live(when)
  collectgarbage()
  collectgarbage()
  local used = tlsf and tlsf.stats() or 0
  print(("live %s: %.0f KiB, of the pool %.0f"):format(when, collectgarbage("count"),
    used / 1024))
end
function report()
  local function row(name, list)
    local n, cells = 0, {}
    for i = 1, #edges do
      n, cells[i] = n + list[i], ("%7d"):format(list[i])
    end
    print(("%-13s %6d updates, mean %.1f us, slowest %.0f us (update %d)"):format(name,
      n, list.sum / math.max(n, 1), list.slowest, list.at))
    print("  updates   " .. table.concat(cells))
  end
  local cells = {}
  for i = 1, #edges do cells[i] = ("%7g"):format(edges[i]) end
  print("  us, up to " .. table.concat(cells))
  row("first 10,000:", first)
  row("later:", later)
  if tlsf then
    local used, most, size = tlsf.stats()
    print(("pool: %.0f KiB in use, %.0f at most, of %.0f"):format(used / 1024,
      most / 1024, size / 1024))
  end
  print_live("at the end")
  print("now in " .. (rfsm.get_actleaf_fqn and rfsm.get_actleaf_fqn(fsm) or "a state"))
  io.stdout:flush()
end]]

require "rttlib"
local deployer = rtt.getTC():getPeer("Deployer")
local component = require("rfsm.rtt").component_launch_rfsm {
  name = "bench", fsmfile = "bench/rtt.lua", deployer = deployer, luatype = kind,
  ev_inport = true, prestr = BEFORE, poststr = AFTER,
  stripped = ({ ["0"] = false, ["1"] = true })[os.getenv("STRIPPED") or ""],
  pool = tonumber(os.getenv("POOL")),
}
local REAL_TIME, PRIORITY = 1, 80
deployer:getOperation("setActivity")("bench", 0.001, PRIORITY, REAL_TIME)
component:configure()
local exec_str = component:getOperation("exec_str")
exec_str("print_live('at the start')")
component:start()
rtt.sleep(seconds, 0)
component:stop()
exec_str("report()")
