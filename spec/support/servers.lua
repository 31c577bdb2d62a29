-- Servers that specs start and stop again; charts that they run.

local helper = require "spec.helper"

local servers = {}

-- even --e_tick--> odd --e_tick--> even, counted
servers.COUNTER = [[
return rfsm.state {
  keep = { "n", "list" }, n = 0, even = rfsm.state {}, odd = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "even" },
  rfsm.trans { src = "even", tgt = "odd", events = { "e_tick" },
    effect = function(fsm) fsm.n = fsm.n + 1 end },
  rfsm.trans { src = "odd", tgt = "even", events = { "e_tick" },
    effect = function(fsm) fsm.n = fsm.n + 1 end },
}]]

--- Returns a new version of it: its effects add `by`; `more` are states.
function servers.counter(by, more)
  return (servers.COUNTER:gsub("n %+ 1", "n + " .. by):gsub("odd = ", (more or "")
    .. "odd = "))
end

--- Returns off --e_on--> on --e_off or so many seconds--> off --e_busy--> busy; `more`
-- are states and transitions.
function servers.lamp(seconds, more)
  return ([[
return rfsm.state {
  keep = { "owner" },
  off = rfsm.state { entry = function(fsm)
    fsm.times = (fsm.times or 0) + 1 -- not kept
    fsm.emit("off", { times = fsm.times, owner = fsm.owner })
  end },
  on = rfsm.state { entry = function() error("no bulb", 0) end },
  busy = rfsm.state { doo = function() while true do rfsm.yield() end end },
  rfsm.trans { src = "initial", tgt = "off" },
  rfsm.trans { src = "off", tgt = "on", events = { "e_on" },
    guard = function(tr) return tr._fsm.owner ~= "ghost" end },
  rfsm.trans { src = "on", tgt = "off", events = { "e_off", "e_after(%s)" } },
  rfsm.trans { src = "off", tgt = "busy", events = { "e_busy" } },
  %s
}]]):format(seconds, more or "")
end

-- RFSM_EVENTS=100000 makes the storms longer. They run under one Lua: what matters is
-- that many come at once.
servers.EVENTS = tonumber(os.getenv("RFSM_EVENTS"))
servers.HAS_STORMS = servers.EVENTS ~= nil or rawget(_G, "jit") ~= nil

--- Runs a command of the shell; returns its output.
function servers.output_of(command) return helper.text_of(command .. " 2>&1") end

--- Runs a script of the shell at the same time; returns a function that waits for its
-- end, and returns the output.
function servers.beside(script)
  local pipe = assert(io.popen(script .. " 2>&1"))
  return function()
    local output = pipe:read("*a")
    pipe:close()
    return output
  end
end

local running = {} -- what is to be stopped

--- Starts a server in a new folder: one of a class with `launch` and `kill`.
function servers.start(class, server)
  server.folder = servers.output_of("mktemp -d"):match("%S+")
  running[#running + 1] = setmetatable(server, class)
  server:launch()
  return server
end

--- Stops all servers, and removes what they wrote.
function servers.stop_all()
  for i = #running, 1, -1 do
    running[i]:kill()
    servers.output_of("rm -rf " .. running[i].folder)
    running[i] = nil
  end
end

return servers
