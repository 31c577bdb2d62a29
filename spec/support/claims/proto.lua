-- rfsm.proto: what a client sees is what the machine did, iteration by iteration.

local dkjson = require "dkjson"
local drive = require "spec.support.drive"
local kept = require "spec.support.kept"
local new_random = require "spec.support.random"
local proto = require "rfsm.proto"
local rfsm = require "rfsm"
local socket = require "socket"

-- Appends what the client has received.
local function drain(udp, list)
  while true do
    local text = udp:receive(65507)
    if not text then return end
    local message = dkjson.decode(text)
    if message.type == "rfsm_active_state" and message.fsm == 1 then
      list[#list + 1] = ("%s %s %s"):format(tostring(message.act_leaf),
        tostring(message.act_leaf_state), tostring(message.path))
    end
  end
end

local function check(seed)
  local random, done, seen, path = new_random(seed), {}, {}, "false"
  local fsm = assert(rfsm.init(kept.model(seed)))
  local server = proto.install { port = 0, fsm = fsm, allow_send = true,
    clock = function() return 0 end }
  local udp = assert(socket.udp4())
  udp:setpeername(server.host, server.port)
  udp:settimeout(0)
  fsm.dbg = function(id, text)
    if id == "EXEC_PATH" then path = text end
  end
  local function note()
    local leaf = fsm._act_leaf
    done[#done + 1] = ("%s %s %s"):format(tostring(leaf and leaf._fqn),
      leaf and leaf._mode or "false", path)
    path = "false"
  end
  rfsm.post_step_hook_add(fsm, note)
  rfsm.reset_hook_add(fsm, note)
  udp:send('{"type":"subscribe","fsm":1,"path":true}')
  socket.select({ server.udp }, nil, 5)
  for _ = 1, 20 do
    if random(3) == 1 then
      udp:send(dkjson.encode { type = "event", event = random:pick(drive.EVENTS) })
    end
    rfsm.step(fsm, random(3))
    drain(udp, seen)
  end
  for _ = 1, 50 do -- what is on its way
    if #seen >= #done then break end
    socket.select({ udp }, nil, 0.02)
    drain(udp, seen)
  end
  udp:close()
  server:close()
  local expected, got = table.concat(done, "\n"), table.concat(seen, "\n")
  if expected ~= got then return "done:\n" .. expected .. "\nseen:\n" .. got end
end

return { name = "proto", run = drive.each(check) }
