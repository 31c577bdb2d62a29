-- A host: launches examples/rtt.lua in a component of Orocos RTT-Lua, writes events to
-- its port and reads from another what became of them.
--
--   rttlua examples/hosts/rtt_host.lua        on a robot
--   lua examples/hosts/rtt_host.lua           with the stand-in of the specs
--
-- Both from the top of the checkout.

package.path = "./?.lua;" .. package.path

local is_there, rtt = pcall(require, "rtt")
if not is_there then
  print("RTT is not here, its stand-in is used: spec/support/rtt.lua")
  rtt = require "spec.support.rtt"
  package.loaded.rtt = rtt
end

local rfsm_rtt = require "rfsm.rtt"

-- Gives the threads of the components the time to act.
local function wait()
  if rtt.standin then return rtt.standin.spin() end
  os.execute("sleep 0.1")
end

local own = rtt.getTC()
local deployer = own:getPeer("Deployer")
deployer:import("ocl")

local gripper = rfsm_rtt.component_launch_rfsm {
  name = "gripper", fsmfile = "examples/rtt.lua", deployer = deployer,
}

-- Ports of the host, connected to those of the component through buffers.
local buffered = rtt.Variable("ConnPolicy")
buffered.type, buffered.size, buffered.init = 1, 16, true

local events, names = rtt.OutputPort("string"), rtt.InputPort("string")
own:addPort(events, "events")
own:addPort(names, "names")
events:connect(gripper:getPort("rFSM_events"), buffered)
names:connect(gripper:getPort("rFSM_cur_fqn"), buffered)

local function show_names()
  local status, name = names:read()
  while status == "NewData" do
    print("gripper: " .. name)
    status, name = names:read()
  end
end

gripper:start()
wait()
show_names()

local raise_event = rfsm_rtt.gen_raise_event(events)
for _, event in ipairs { "e_close", "e_contact", "e_slip" } do
  raise_event(event)
  wait()
  show_names()
end

gripper:stop()
deployer:unloadComponent("gripper")
for _, port in ipairs { events, names } do
  own:removePort(port:info().name)
  port:delete()
end
