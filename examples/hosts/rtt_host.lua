-- A host: launches examples/rtt.lua in a component of Orocos RTT-Lua, writes events to
-- its port and reads the FQNs of its states from another one.
--
--   rttlua examples/hosts/rtt_host.lua        on a robot
--   lua examples/hosts/rtt_host.lua           with the stand-in of the specs
--
-- Both from the top of the checkout.

package.path = "./?.lua;" .. package.path

if not package.loaded.rtt then
  print("RTT is not here, its stand-in is used: spec/support/rtt.lua")
  package.loaded.rtt = require "spec.support.rtt"
end

local rtt = package.loaded.rtt
local rfsm_rtt = require "rfsm.rtt"

local own = rtt.getTC() -- the component of this program, its name is "lua"
local deployer = own:getPeer("Deployer")

local gripper = rfsm_rtt.component_launch_rfsm {
  name = "gripper", fsmfile = "examples/rtt.lua", deployer = deployer,
}

-- Ports of the host. The deployer connects them through buffers: `port:connect` would
-- ignore the policy, and events that come together would be lost.
local events = rtt.OutputPort.new("string", "events")
local names = rtt.InputPort.new("string", "names")
own:addPort(events)
own:addPort(names)

local buffered = rtt.Variable.new("ConnPolicy")
buffered.type, buffered.size, buffered.init = 1, 16, true

local connect = deployer:getOperation("connect")
connect("lua.events", "gripper.events_in", buffered)
connect("gripper.fqn", "lua.names", buffered)

-- Gives the component the time to act, then shows where it has been.
local function show_names()
  rtt.sleep(0, 100000000)
  local status, name = names:read()
  while status == "NewData" do
    print("gripper: " .. name)
    status, name = names:read()
  end
end

gripper:configure()
gripper:start()
show_names()

local raise_event = rfsm_rtt.gen_raise_event(events)
for _, event in ipairs { "e_close", "e_contact", "e_slip" } do
  raise_event(event)
  show_names()
end

gripper:stop()
deployer:getOperation("unloadComponent")("gripper")
for _, port in ipairs { events, names } do
  own:removePort(port:info().name)
  port:delete()
end
