-- A host: a heating controller on MQTT, spoken by Mosquitto's own clients, which luv
-- starts. The state is retained, and the last will is the state "offline".
--
--   lua examples/hosts/mqtt_host.lua [PORT]          from the top of the checkout
--   mosquitto_sub -v -t 'heating/#' & mosquitto_pub -t heating/room -m 17.5

package.path = "./?.lua;" .. package.path

local uv = require "luv"
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans
local port, clients, inputs = arg[1] or "1883", {}, {}

require("rfsm_timeevent").set_gettime_hook(uv.hrtime) -- nanoseconds, monotonic

local fsm = assert(rfsm.init(state { info = false,
  off = state {}, heating = state {}, airing = state {}, blind = state {},
  trans { src = "initial", tgt = "off" },
  trans { src = "off", tgt = "heating", events = { "e_cold" } },
  trans { src = "heating", tgt = "off", events = { "e_warm" } },
  trans { src = "heating", tgt = "heating", events = { "e_mild", "e_cold" } },
  trans { src = "heating", tgt = "blind", events = { "e_after(900)" } },
  trans { src = "blind", tgt = "off", events = { "e_cold", "e_mild", "e_warm" } },
  trans { src = "off", tgt = "airing", events = { "open" } },
  trans { src = "heating", tgt = "airing", events = { "open" } },
  trans { src = "airing", tgt = "off", events = { "shut", "e_after(600)" } },
}))

local function advance(event)
  rfsm.send_events(fsm, event)
  rfsm.run(fsm)
  inputs.mosquitto_pub:write(rfsm.get_actleaf_fqn(fsm):match("[^.]*$") .. "\n")
end

local function receive(_, data) -- degrees; "open" and "shut" are events as they are
  for payload in (data or ""):gmatch("[^\n]+") do
    local t = tonumber(payload)
    advance(t and (t < 18 and "e_cold" or t > 21 and "e_warm" or "e_mild") or payload)
  end
end

-- Starts a client; starts it again a second after it has ended, for want of a broker.
local function start(client, args)
  local input, output, again = uv.new_pipe(), uv.new_pipe(), uv.new_timer()
  inputs[client] = input
  local options = { args = args, stdio = { input, output } }
  clients[client] = uv.spawn(client, options, function()
    again:start(1000, 0, function() start(client, args) end)
  end)
  output:read_start(receive)
end

start("mosquitto_pub", { "-p", port, "-t", "heating/state", "-r", "-l" })
start("mosquitto_sub", { "-p", port, "-t", "heating/room", "-t", "heating/window",
  "--will-topic", "heating/state", "--will-payload", "offline", "--will-retain" })
-- Once a second is enough for these timers, and gives a new broker the state.
local clock, signal = uv.new_timer(), uv.new_signal()
clock:start(0, 1000, function() advance() end)
signal:start("sigterm", function() os.exit(clients.mosquitto_sub:kill "sigkill") end)
uv.run()
