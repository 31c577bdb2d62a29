-- A host with a door for watchers: a lamp answers over UDP, and a subscriber, here in
-- the same process, asks for its graph, follows it and pushes the button.
--
--   lua examples/hosts/proto_host.lua             from the top of the checkout
--
-- It ends by itself. A host of yours opens the port and advances its machine; the
-- subscriber would be another program.

package.path = "./?.lua;" .. package.path

local has_socket, socket = pcall(require, "socket")
local has_json, json = pcall(require, "dkjson")
if not has_socket or not has_json then
  print("this host needs luasocket and dkjson; please install them "
    .. "(Debian: apt-get install lua-socket lua-dkjson)")
  return
end

local rfsm = require "rfsm"
local proto = require "rfsm.proto"

-- The host ---------------------------------------------------------------------

-- 0: any port that is free; watchers from elsewhere want a fixed one, such as 44044
local server = proto.install { port = 0, allow_send = true }

local fsm = assert(rfsm.init(rfsm.state {
  info = false,
  off = rfsm.state {}, on = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "off" },
  rfsm.trans { src = "off", tgt = "on", events = { "e_push" } },
  rfsm.trans { src = "on", tgt = "off", events = { "e_push" } },
}))

-- The subscriber ---------------------------------------------------------------

local udp = assert(socket.udp4())
udp:setpeername(server.host, server.port)
udp:settimeout(0)

local function send(message) udp:send(json.encode(message)) end

local ON = {} ---@type table<string, fun(message: table)?>

function ON.rfsm_model(message)
  local names = {}
  for _, node in ipairs(message.graph.subnodes) do
    if node.type == "state" then names[#names + 1] = node.id end
  end
  print("graph: " .. table.concat(names, ", "))
end

local shown

function ON.rfsm_active_state(message)
  if message.act_leaf == shown then return end -- one comes after each iteration
  shown = message.act_leaf
  print("active: " .. tostring(shown))
end

function ON.rfsm_error(message) print("error: " .. message.text) end

-- Handles what has arrived.
local function watch()
  for text in function() return (udp:receive(65507)) end do
    local message = json.decode(text)
    if ON[message.type] then ON[message.type](message) end
  end
end

-- Both ------------------------------------------------------------------------

send { type = "subscribe" }
for cycle = 1, 6 do
  if cycle == 3 or cycle == 5 then
    print("sends e_push")
    send { type = "event", event = "e_push" }
  end
  send { type = "heartbeat" } -- at least one in 3 seconds
  rfsm.run(fsm)
  watch()
end

udp:close()
server:close()
